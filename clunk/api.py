"""Functions for scripts and notebooks beside `load_study` and `simulate`: sweeps, maps, runs at points, figures."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from clunk.analysis.boundaries import is_traced, with_boundaries
from clunk.analysis.fitted import Fitted
from clunk.analysis.marks import thresholds_of
from clunk.results import files
from clunk.results.maps import AnyMap, Results, ToleranceMap
from clunk.simulation.trajectory import Trajectory
from clunk.study.designs import design_of_points
from clunk.study.document import FilePath
from clunk.study.errors import ClunkError, ConfigError
from clunk.study.study import Study, takes_study
from clunk.sweeping.progress import ShowProgress, reporting
from clunk.sweeping.runner import Runner
from clunk.sweeping.sweep import HAS_TOLERANCES, engine_of, opened

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@takes_study
def sweep(
    study: Study,
    output: FilePath | None = None,
    *,
    progress: ShowProgress = False,
    workers: int | None = None,
    scheduler: str | None = None,
    boundaries: bool | None = None,
    lash: str | int | None = None,
    restart: bool = False,
    force: bool = False,
) -> Results:
    """Run the grid of a study in parallel.

    Parameters
    ----------
    study : Study
        With at least one axis or sample.
    output : path of a results file (.h5), optional
        Written as ``clunk sweep`` writes it: finished cells are kept on the disk, a stopped sweep goes on when it is
        called again, and a sweep that is complete in the file is read instead of run.
    progress : bool or callable(done, total)
        True shows a bar in a terminal or a notebook, and prints a line every few seconds elsewhere. A function is
        called in this thread with the numbers of finished and of all cells, at the beginning and after each tile.
    workers : int, optional
        Number of threads; by default one for each core that this process may use.
    scheduler : str, optional
        Address of the dask scheduler on whose workers the cells run, such as ``tcp://host:8786``; or ``local``, to run
        them on `workers` processes of this machine.
    boundaries : bool, optional
        Whether to trace the curves between the labels on a map of two axes, too: `Results.boundaries`. By default as
        the study's ``[sweep] boundaries`` says; without that key, they are traced on every map that can have them.
    lash : str or int, optional
        Name or number of the lash whose boundaries are traced, of several lashes; by default the first.
    restart : bool
        Run all cells anew: neither go on with a stopped sweep nor keep a finished one.
    force : bool
        Overwrite a results file of another study.

    Returns
    -------
    Results
        The results of a cell depend only on its parameters: workers and interruptions change no bit of them.

    Raises
    ------
    ClunkError
        Where there is nothing to sweep, the grid does not fit in memory, no cell of it can run, or the file holds
        other results.
    StoreError, PartsError, ClunkError
        Where the file cannot be written, or finished cells cannot be kept on the disk or read back.
    EngineError
        Where the scheduler or its workers cannot start or go on; finished cells have been kept, as at an interrupt.
    ClunkError
        Where boundaries are asked for and the study's map cannot have them, or there is no such lash.
    KeyboardInterrupt
        Raised again after finished cells have been kept on the disk, if there is an output.

    Examples
    --------
    >>> import clunk
    >>> study = clunk.load_study("configs/smoke.toml", ["solver.method='exact'"])
    >>> results = clunk.sweep(study, "results/exact.h5", progress=True)
    >>> results.shape
    (21, 21)
    >>> results.counts()["DS(1)SS(1)"]
    160
    """
    if study.swept.tolerances:
        raise ClunkError(HAS_TOLERANCES)
    traces = is_traced(study, boundaries, lash)
    engine = engine_of(scheduler, workers)

    trace = partial(with_boundaries, study, lash=lash, workers=workers, progress=progress is True)
    results = _run(study, output, progress, engine, addition=trace if traces else None, restart=restart, force=force)
    assert isinstance(results, Results)
    return results


@takes_study
def tolerance_map(
    study: Study,
    output: FilePath | None = None,
    *,
    progress: ShowProgress = False,
    workers: int | None = None,
    scheduler: str | None = None,
    restart: bool = False,
    force: bool = False,
) -> ToleranceMap:
    """Run every cell of a study's grid for the same sample of its toleranced parameters.

    Parameters
    ----------
    study : Study
        With at least one axis or sample, and tolerances.
    output, progress, workers, scheduler, restart, force
        As for `sweep`.

    Returns
    -------
    ToleranceMap
        Probability of each label in each cell, and mean and quantiles of the cell's severity.

    Raises
    ------
    ClunkError
        Where the study has no tolerances. Other errors are those of `sweep`.

    Examples
    --------
    >>> import clunk
    >>> fewer = ["sweep.sampling.count=16", "sweep.axes[1].count=6", "sweep.axes[2].count=5"]
    >>> probabilities = clunk.tolerance_map(clunk.load_study("configs/tolerance.toml", fewer))
    >>> probabilities.runs.sum(axis=-1).min(), probabilities.draws
    (np.int64(16), 16)
    """
    if not study.swept.tolerances:
        raise ClunkError("The study has no [[sweep.tolerances]]: clunk.sweep runs it.")
    probabilities = _run(study, output, progress, engine_of(scheduler, workers), restart=restart, force=force)
    assert isinstance(probabilities, ToleranceMap)
    return probabilities


@takes_study
def run_points(
    study: Study,
    points: Mapping[str, npt.ArrayLike],
    *,
    progress: ShowProgress = False,
    workers: int | None = None,
    scheduler: str | None = None,
) -> Results:
    """Run a study at arbitrary points of its parameters, in parallel.

    Parameters
    ----------
    study : Study
        Gives the values of all other parameters; its sweep, if any, is ignored.
    points : parameter -> (n,) array of float, in the parameter's unit; also a DataFrame with such columns
        Values of any numeric keys of the config, in arrays of equal length: the k-th values together are the k-th run.
    progress, workers, scheduler
        As for `sweep`.

    Returns
    -------
    Results
        Results along one axis, `run`, with the parameters as coordinates on it; bit for bit equal to those of a sweep's
        cells with these values.

    Raises
    ------
    ConfigError
        Where a key or a value is not one that a config may hold, or the arrays are not equally long.
    ClunkError, EngineError, KeyboardInterrupt
        As for `sweep`.

    Examples
    --------
    >>> import clunk
    >>> study = clunk.load_study("configs/nominal.toml")
    >>> runs = clunk.run_points(study, {"load.ratio": [1.0, 2.0, 5.0], "lash.backlash_deg": [6.0, 2.0, 6.0]})
    >>> [str(label) for label in runs.label_map]
    ['NI', 'DS(1)', 'DS(1)SS(1)']
    >>> runs.severity.round(1)  # rad/s²
    array([   0. , 2184.9, 9299.7])
    """
    columns = dict(points.items())
    if not columns:
        raise ConfigError("There is nothing to run: points names no parameter, such as load.ratio.")
    design = design_of_points(study, columns)
    values = np.stack([axis.values for axis in design.coordinates], axis=-1)
    with engine_of(scheduler, workers) as engine:
        runner = Runner(study, [axis.parameter for axis in design.coordinates], engine=engine)
        with reporting(progress, runner.study) as report:
            return runner.run(values, report)


def draw(
    what: Results | ToleranceMap | Trajectory | Fitted, quantity: str = "regimes", *, lash: str | int | None = None
) -> Figure:
    """Draw the map of a sweep's results, the time history of a run, or the maps before and after a fit.

    Parameters
    ----------
    what : Results, ToleranceMap, Trajectory or Fitted
    quantity : str
        For a run or a fit, leave it out. For results: regimes, severity, touches, double_sided_impacts,
        severity<=8000 and so on, in the words of `clunk.results.quantities`. For a tolerance map: regimes, severity
        (its mean), severity_5, severity_50, severity_95, or the probability of double_sided and the like.
    lash : str or int, optional
        Name or number of the lash to draw, of a map of several lashes; by default the first.

    Returns
    -------
    matplotlib.figure.Figure
        A notebook shows the figure; `clunk.plot.save` writes it as PNG, SVG or PDF.

    Raises
    ------
    PlotError, ClunkError
        Where the results cannot be drawn with this quantity or lash, or one of these is given for a run or a fit.
    TypeError
        Where `what` is of another type, a Dataset for example.

    Examples
    --------
    >>> import clunk
    >>> results = clunk.sweep(clunk.load_study("configs/smoke.toml"))
    >>> figure = clunk.draw(results, "severity")
    >>> clunk.plot.save(figure, "severity.svg")
    """
    from clunk import plot

    if isinstance(what, Results | ToleranceMap):
        what = what.at_lash(lash)
        return plot.draw(what, quantity, thresholds_of(what))
    if not isinstance(what, Trajectory | Fitted):
        raise TypeError(
            f"draw takes a map, a run or a fit, not a {type(what).__name__}; clunk.read_results(path) gives Results."
        )
    if quantity != "regimes" or lash is not None:
        raise ClunkError("The picture of a run or a fit is of all quantities and lashes; name none.")
    if isinstance(what, Fitted):
        from clunk.plot.analyses import measured_on_maps

        return measured_on_maps(what)
    from clunk.plot.histories import history_figure
    from clunk.simulation.history import sample

    return history_figure([sample(what)])


def _run(
    study: Study,
    output: FilePath | None,
    progress: ShowProgress,
    engine: Executor,
    *,
    addition: Callable[[AnyMap], AnyMap] | None = None,
    restart: bool,
    force: bool,
) -> AnyMap:
    """Run a study's sweep, or read its map from a results file where that is complete.

    addition : makes of the finished map one with something added, such as its boundaries
    """
    path = None if output is None else Path(output)
    files.check(path, files.RESULTS)
    with opened(path, study, restart=restart, force=force) as job:
        result = job.held
        if result is None:
            with engine as executor:
                result = job.run(executor, progress=progress)
        return job.finish(result, addition)
