"""Runs of a study at points of some of its keys: prepared once, and run batch after batch."""

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from contextlib import nullcontext
from functools import cached_property

import numpy as np
import numpy.typing as npt

from clunk.results.maps import Results
from clunk.study.arrays import Floats
from clunk.study.designs import Design, along_run, design_of_points
from clunk.study.errors import ConfigError
from clunk.study.parameters import distinct
from clunk.study.study import Study
from clunk.sweeping.cells import Grid
from clunk.sweeping.machine import provenance
from clunk.sweeping.progress import Progress, unseen
from clunk.sweeping.reduction import Reduction, regime_map
from clunk.sweeping.sweep import engine_of


class Runner:
    """Runs of a study at points of some of its keys, for optimisers, designs of experiments and custom searches.

    What does not depend on the keys is prepared once, and what does is prepared for all points of a call together. If
    all keys are of the load or a backlash, a call with few points takes some 0.5 ms in addition to its runs.

    Parameters
    ----------
    study : Study
        Gives the values of all other keys; its sweep, fit and optimisation are ignored.
    keys : of str
        Any numeric keys of the config, or one such key.
    workers : int, optional
        Number of threads; by default one for each core that this process may use.
    engine : optional
        An engine to use instead of threads, open already, see `clunk.sweeping.engines`.

    Raises
    ------
    ConfigError
        Where the study has no such key, a key is given twice, or no key is given.
    EngineError
        Where `workers` is less than 1.

    Examples
    --------
    >>> import clunk
    >>> runner = clunk.Runner(clunk.load_study("configs/nominal.toml"), ["load.ratio", "lash.backlash_deg"])
    >>> runs = runner([[1.0, 6.0], [2.0, 2.0], [5.0, 6.0]])
    >>> [str(label) for label in runs.label_map]
    ['NI', 'DS(1)', 'DS(1)SS(1)']
    >>> runs.severity.round(1)  # rad/s²
    array([   0. , 2184.9, 9299.7])
    """

    def __init__(
        self, study: Study, keys: Sequence[str] | str, *, workers: int | None = None, engine: Executor | None = None
    ) -> None:
        self.study = study.alone
        self.keys = distinct(study, [keys] if isinstance(keys, str) else keys)
        if not self.keys:
            raise ConfigError("A Runner needs a key or more, in which its runs differ.")
        self.grid = Grid(self.study, self._design(np.zeros((1, len(self.keys)))))
        self.grid.shared()  # prepared once, for all points
        self._engine, self._workers = engine, workers
        if engine is None:
            self._workers = engine_of(None, workers)._max_workers  # type: ignore[attr-defined]  # all engines have it
        self._allowed = np.zeros((0, len(self.keys)))  # least and greatest values that were checked

    def __call__(self, points: npt.ArrayLike, *, progress: Progress = unseen) -> Results:
        """Run the study at points of the keys.

        Parameters
        ----------
        points : (n, keys) float, each in its key's unit
        progress : callable(done, total), optional
            Called in this thread with the numbers of finished and of all runs, at the beginning and after each tile.

        Returns
        -------
        Results
            Results along one axis, `run`, with the keys as coordinates on it; bit for bit equal to those of a sweep's
            cells with these values.

        Raises
        ------
        ConfigError
            Where the points have another shape, or a value is not one that a config may hold.
        """
        return self.run(self.checked(points), progress)

    def run(self, values: Floats, progress: Progress = unseen) -> Results:
        """Run points, (n, keys), as `checked` returns them; raises ConfigError where a driveline is refused."""
        reduction = Reduction(self.grid.with_design(self._design(values)))
        # threads of a call's own: a Runner can be pickled, and used after a fork
        with nullcontext(self._engine) if self._engine else engine_of(None, self._workers) as engine:
            reduction.run(engine, progress)
        return regime_map(reduction, self._attributes)

    def values(self, columns: Mapping[str, npt.ArrayLike]) -> Floats:
        """Points, (n, keys), from the values of each key, (n,) or one value for all points."""
        return np.stack(np.broadcast_arrays(*(np.asarray(columns[key], np.float64) for key in self.keys)), axis=-1)

    def checked(self, points: npt.ArrayLike) -> Floats:
        """Points as an array, (n, keys). Raises ConfigError where they have another shape or a value is not allowed."""
        values = np.asarray(points, np.float64)
        if values.ndim != 2 or values.shape[1] != len(self.keys) or not len(values):
            raise ConfigError(
                f"Points are one row or more of {len(self.keys)} values, of {', '.join(self.keys)}; their array has "
                f"the shape {values.shape}."
            )
        if self.grid.structural:  # allowed values may not be allowed together, nor values between them
            self._check(values)
            return values
        known = np.concatenate([values, self._allowed])
        ends = np.stack([known.min(axis=0), known.max(axis=0)])
        if not np.array_equal(ends, self._allowed):
            try:
                self._check(ends)
            except ConfigError:  # a point is not allowed, or only these bounds are not
                self._check(values)
            else:
                self._allowed = ends
        return values

    def _check(self, values: Floats) -> None:
        design_of_points(self.study, dict(zip(self.keys, values.T, strict=True)))

    def _design(self, values: Floats) -> Design:
        return along_run(zip(self.keys, values.T, strict=True))

    @cached_property
    def _attributes(self) -> dict[str, str]:
        return provenance(self._engine)
