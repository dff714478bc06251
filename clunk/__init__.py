"""Impact regime maps of drivelines with backlash.

>>> import clunk
>>> study = clunk.load_study("configs/nominal.toml")
>>> clunk.simulate(study).label
'DS(1)SS(1)'
"""

from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from clunk import plot as plot
    from clunk.analysis.comparison import Comparison as Comparison, compare as compare, verify as verify
    from clunk.analysis.fitted import Fitted as Fitted, fitted_study as fitted_study
    from clunk.analysis.fitting import fit as fit
    from clunk.analysis.optimisation import optimize as optimize
    from clunk.analysis.sobol import Sensitivity as Sensitivity, sensitivity as sensitivity
    from clunk.analysis.thresholds import (
        Thresholds as Thresholds,
        threshold_quantiles as threshold_quantiles,
        thresholds as thresholds,
    )
    from clunk.api import draw as draw, run_points as run_points, sweep as sweep, tolerance_map as tolerance_map
    from clunk.explorer.server import Explorer as Explorer, explore as explore
    from clunk.plot import PlotError as PlotError
    from clunk.results.boundaries import Boundaries as Boundaries
    from clunk.results.maps import Results as Results, ToleranceMap as ToleranceMap
    from clunk.results.netcdf import StoreError as StoreError
    from clunk.results.store import (
        open_results as open_results,
        read_map as read_map,
        read_results as read_results,
        to_dataset as to_dataset,
        write_results as write_results,
    )
    from clunk.simulation.trajectory import Trajectory as Trajectory, simulate as simulate
    from clunk.study.config import load_study as load_study, study_from_text as study_from_text
    from clunk.study.errors import ClunkError as ClunkError, ClunkWarning as ClunkWarning, ConfigError as ConfigError
    from clunk.study.study import Study as Study, replace_values as replace_values
    from clunk.sweeping.engines import EngineError as EngineError
    from clunk.sweeping.parts import PartsError as PartsError
    from clunk.sweeping.runner import Runner as Runner

# Public names, listed by the module that defines them; the public name `plot` is the module `clunk.plot` itself.
_NAMES = {
    "analysis.comparison": "Comparison compare verify",
    "analysis.fitted": "Fitted fitted_study",
    "analysis.fitting": "fit",
    "analysis.optimisation": "optimize",
    "analysis.sobol": "Sensitivity sensitivity",
    "analysis.thresholds": "Thresholds threshold_quantiles thresholds",
    "api": "draw run_points sweep tolerance_map",
    "explorer.server": "Explorer explore",
    "plot": "PlotError plot",
    "results.boundaries": "Boundaries",
    "results.maps": "Results ToleranceMap",
    "results.netcdf": "StoreError",
    "results.store": "open_results read_map read_results to_dataset write_results",
    "simulation.trajectory": "Trajectory simulate",
    "study.config": "load_study study_from_text",
    "study.errors": "ClunkError ClunkWarning ConfigError",
    "study.study": "Study replace_values",
    "sweeping.engines": "EngineError",
    "sweeping.parts": "PartsError",
    "sweeping.runner": "Runner",
}
_HOME = {name: module for module, names in _NAMES.items() for name in names.split()}
__all__ = list(_HOME)


def __getattr__(name: str) -> Any:
    """Import a public name on its first use, so that `clunk --help` need not wait for numba and pydantic to load."""
    if name not in _HOME:
        raise AttributeError(f"module 'clunk' has no attribute {name!r}")
    from importlib import import_module

    return import_module("clunk.plot") if name == "plot" else getattr(import_module(f"clunk.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
