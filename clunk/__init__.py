"""Impact regime maps of drivelines with backlash.

study = clunk.load_study("configs/nominal.toml")
clunk.simulate(study).label
"""

from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from clunk.config import ConfigError, Study, load_study
    from clunk.results import Results
    from clunk.simulation import SimulationError, Trajectory, simulate
    from clunk.sobol import Sensitivity, SensitivityError, sensitivity
    from clunk.store import StoreError
    from clunk.sweeping import SweepError, sweep

__all__ = [
    "ConfigError",
    "Results",
    "Sensitivity",
    "SensitivityError",
    "SimulationError",
    "StoreError",
    "Study",
    "SweepError",
    "Trajectory",
    "load_study",
    "sensitivity",
    "simulate",
    "sweep",
]

_HOME = {
    "ConfigError": "config",
    "Results": "results",
    "Sensitivity": "sobol",
    "SensitivityError": "sobol",
    "SimulationError": "simulation",
    "StoreError": "store",
    "Study": "config",
    "SweepError": "sweeping",
    "Trajectory": "simulation",
    "load_study": "config",
    "sensitivity": "sobol",
    "simulate": "simulation",
    "sweep": "sweeping",
}


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used: `clunk --help` waits for neither numba nor pydantic."""
    if name not in _HOME:
        raise AttributeError(f"module 'clunk' has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(f"clunk.{_HOME[name]}"), name)
