"""Impact regime maps of drivelines with backlash.

>>> import clunk
>>> study = clunk.load_study("configs/nominal.toml")
>>> clunk.simulate(study).label
'DS(1)SS(1)'
"""

from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from clunk import plot
    from clunk.api import draw, sweep, tolerance_map, verify
    from clunk.config import ConfigError, Study, load_study, replace_values, study_from_text
    from clunk.datasets import open_results, to_dataset
    from clunk.engines import EngineError
    from clunk.parts import PartsError
    from clunk.plot import PlotError
    from clunk.results import Results
    from clunk.simulation import SimulationError, Trajectory, simulate
    from clunk.sobol import Sensitivity, SensitivityError, sensitivity
    from clunk.store import StoreError
    from clunk.store import read as read_results
    from clunk.store import write as write_results
    from clunk.sweeping import SweepError
    from clunk.targets import TargetError
    from clunk.tolerancefile import read as read_tolerance_map
    from clunk.tolerancemap import ToleranceMap
    from clunk.verification import Verification

__all__ = [
    "ConfigError",
    "EngineError",
    "PartsError",
    "PlotError",
    "Results",
    "Sensitivity",
    "SensitivityError",
    "SimulationError",
    "StoreError",
    "Study",
    "SweepError",
    "TargetError",
    "ToleranceMap",
    "Trajectory",
    "Verification",
    "draw",
    "load_study",
    "open_results",
    "plot",
    "read_results",
    "read_tolerance_map",
    "replace_values",
    "sensitivity",
    "simulate",
    "study_from_text",
    "sweep",
    "to_dataset",
    "tolerance_map",
    "verify",
    "write_results",
]

# Public name -> where it is: its module, and its name there if that is another.
_HOME = {
    "ConfigError": "config",
    "EngineError": "engines",
    "PartsError": "parts",
    "PlotError": "plot",
    "Results": "results",
    "Sensitivity": "sobol",
    "SensitivityError": "sobol",
    "SimulationError": "simulation",
    "StoreError": "store",
    "Study": "config",
    "SweepError": "sweeping",
    "TargetError": "targets",
    "ToleranceMap": "tolerancemap",
    "Trajectory": "simulation",
    "Verification": "verification",
    "draw": "api",
    "load_study": "config",
    "open_results": "datasets",
    "read_results": "store:read",
    "read_tolerance_map": "tolerancefile:read",
    "replace_values": "config",
    "sensitivity": "sobol",
    "simulate": "simulation",
    "study_from_text": "config",
    "sweep": "api",
    "to_dataset": "datasets",
    "tolerance_map": "api",
    "verify": "api",
    "write_results": "store:write",
}


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used: `clunk --help` waits for neither numba nor pydantic."""
    if name not in __all__:
        raise AttributeError(f"module 'clunk' has no attribute {name!r}")
    from importlib import import_module

    if name == "plot":
        return import_module("clunk.plot")
    module, _, there = _HOME[name].partition(":")
    return getattr(import_module(f"clunk.{module}"), there or name)


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
