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
    from clunk.analysis.boundaries import BoundaryError
    from clunk.analysis.fitparts import FitError
    from clunk.analysis.fitted import Fitted
    from clunk.analysis.fittedstudy import fitted_study
    from clunk.analysis.measurements import ExperimentError
    from clunk.analysis.quantiles import threshold_quantiles
    from clunk.analysis.sobol import Sensitivity, SensitivityError, sensitivity
    from clunk.analysis.thresholds import ThresholdError, Thresholds, thresholds
    from clunk.analysis.verification import Verification
    from clunk.api import draw, fit, run_points, sweep, tolerance_map, verify
    from clunk.explorer.server import Explorer, explore
    from clunk.explorer.subject import ExplorerError
    from clunk.plot import PlotError
    from clunk.results.boundaries import Boundaries
    from clunk.results.datasets import open_results, to_dataset
    from clunk.results.regimemap import Results
    from clunk.results.store import StoreError, read_tolerance_map
    from clunk.results.store import read as read_results
    from clunk.results.store import write as write_results
    from clunk.results.targets import TargetError
    from clunk.results.tolerancemap import ToleranceMap
    from clunk.simulation.trajectory import SimulationError, Trajectory, simulate
    from clunk.study.config import load_study, study_from_text
    from clunk.study.errors import ClunkError, ClunkWarning
    from clunk.study.problems import ConfigError
    from clunk.study.study import Study, replace_values
    from clunk.sweeping.engines import EngineError
    from clunk.sweeping.parts import PartsError
    from clunk.sweeping.reduction import SweepError

__all__ = [
    "Boundaries",
    "BoundaryError",
    "ClunkError",
    "ClunkWarning",
    "ConfigError",
    "EngineError",
    "ExperimentError",
    "Explorer",
    "ExplorerError",
    "FitError",
    "Fitted",
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
    "ThresholdError",
    "Thresholds",
    "ToleranceMap",
    "Trajectory",
    "Verification",
    "draw",
    "explore",
    "fit",
    "fitted_study",
    "load_study",
    "open_results",
    "plot",
    "read_results",
    "read_tolerance_map",
    "replace_values",
    "run_points",
    "sensitivity",
    "simulate",
    "study_from_text",
    "sweep",
    "threshold_quantiles",
    "thresholds",
    "to_dataset",
    "tolerance_map",
    "verify",
    "write_results",
]

# Public name -> where it is: its module, and its name there if that is another.
_HOME = {
    "Boundaries": "results.boundaries",
    "BoundaryError": "analysis.boundaries",
    "ClunkError": "study.errors",
    "ClunkWarning": "study.errors",
    "ConfigError": "study.problems",
    "EngineError": "sweeping.engines",
    "ExperimentError": "analysis.measurements",
    "Explorer": "explorer.server",
    "ExplorerError": "explorer.subject",
    "FitError": "analysis.fitparts",
    "Fitted": "analysis.fitted",
    "PartsError": "sweeping.parts",
    "PlotError": "plot",
    "Results": "results.regimemap",
    "Sensitivity": "analysis.sobol",
    "SensitivityError": "analysis.sobol",
    "SimulationError": "simulation.trajectory",
    "StoreError": "results.store",
    "Study": "study.study",
    "SweepError": "sweeping.reduction",
    "TargetError": "results.targets",
    "ThresholdError": "analysis.thresholds",
    "Thresholds": "analysis.thresholds",
    "ToleranceMap": "results.tolerancemap",
    "Trajectory": "simulation.trajectory",
    "Verification": "analysis.verification",
    "draw": "api",
    "explore": "explorer.server",
    "fit": "api",
    "fitted_study": "analysis.fittedstudy",
    "load_study": "study.config",
    "open_results": "results.datasets",
    "read_results": "results.store:read",
    "read_tolerance_map": "results.store",
    "replace_values": "study.study",
    "run_points": "api",
    "sensitivity": "analysis.sobol",
    "simulate": "simulation.trajectory",
    "study_from_text": "study.config",
    "sweep": "api",
    "threshold_quantiles": "analysis.quantiles",
    "thresholds": "analysis.thresholds",
    "to_dataset": "results.datasets",
    "tolerance_map": "api",
    "verify": "api",
    "write_results": "results.store:write",
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
