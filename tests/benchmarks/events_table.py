"""The 400 runs that methods are compared on, and the stored table of their events.

The report's driveline over 20 load ratios from 0 to 10 and 20 backlashes from 1 to 20 degrees, 1.5 s after the load
step, indentation model, separation by gap. `reference_events.npz` holds what happens in them, as
`reference_events.py` computes it.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from clunk.simulation.load import loads_of
from clunk.study.config import study_from_text
from clunk.study.study import Study

PATH = Path(__file__).with_name("reference_events.npz")
RATIOS = np.linspace(0.0, 10.0, 20)
BACKLASHES_DEG = np.linspace(1.0, 20.0, 20)
Axes = tuple[np.ndarray, np.ndarray]
END_TIME = 1.5  # s after the load step; the last event of any run is at 0.992 s
CONFIG = """
[driveline]
preset = "boere-2008"
[solver]
method = "{method}"
step = 1e-4
end_time = {end_time!r}
[[sweep.axes]]
parameter = "load.ratio"
values = {ratios}
[[sweep.axes]]
parameter = "lash.backlash_deg"
values = {backlashes}
"""


class EventTable(NamedTuple):
    """Events of all runs in order: the cells of the grid in C order, each one's events in order of time.

    ratio : (400,) float64; backlash_deg : (400,) float64  [degrees]
    first : (401,) int64, run k owns the events first[k] to first[k + 1]
    time : (E,) float64  [s after the load step], nearest to the exact one; remainder : (E,) float64, what it leaves
    kind : (E,) int8, as in clunk.core.events: 1 touch, 2 separation
    side : (E,) int8, sign of q = θi - θj on the flank concerned
    speed : (E,) float64  [rad/s], q' just before
    primary : (E,) bool, whether it is a primary impact
    severity : (P,) float64  [rad/s2], Q_i of the primary impacts, in order
    label : (400,) str
    """

    ratio: np.ndarray
    backlash_deg: np.ndarray
    first: np.ndarray
    time: np.ndarray
    remainder: np.ndarray
    kind: np.ndarray
    side: np.ndarray
    speed: np.ndarray
    primary: np.ndarray
    severity: np.ndarray
    label: np.ndarray

    def of(self, run: int) -> slice:
        """Where the events of a run are."""
        return slice(int(self.first[run]), int(self.first[run + 1]))

    def every(self, step: int) -> "EventTable":
        """The table of each so many-th run."""
        runs = range(0, self.label.size, step)
        rows = [self.of(run) for run in runs]
        return EventTable(
            self.ratio[::step],
            self.backlash_deg[::step],
            np.cumsum([0, *(row.stop - row.start for row in rows)]),
            *(np.concatenate([getattr(self, name)[row] for row in rows]) for name in self._fields[3:9]),
            np.concatenate([self.severity_of(run) for run in runs]),
            self.label[::step],
        )

    def severity_of(self, run: int) -> np.ndarray:
        """Q_i of a run's primary impacts  [rad/s2]."""
        before = int(np.count_nonzero(self.primary[: self.first[run]]))
        return self.severity[before : before + int(np.count_nonzero(self.primary[self.of(run)]))]


def read(path: Path = PATH) -> EventTable:
    """The stored table."""
    with np.load(path, allow_pickle=False) as file:
        return EventTable(**{name: file[name] for name in EventTable._fields})


def study(method: str = "rk4", axes: Axes = (RATIOS, BACKLASHES_DEG)) -> Study:
    """The sweep of the 400 runs, or of others between their ends."""
    ratios, backlashes = (values.tolist() for values in axes)
    return study_from_text(CONFIG.format(method=method, end_time=END_TIME, ratios=ratios, backlashes=backlashes))


def grid() -> tuple[np.ndarray, np.ndarray]:
    """Load ratio and backlash [degrees] of the 400 runs, each (400,)."""
    ratio, backlash = np.meshgrid(RATIOS, BACKLASHES_DEG, indexing="ij")
    return ratio.ravel(), backlash.ravel()


def preload(study, driveline):
    """Half gap [rad] (400,), angles at rest on the flank that carries the load before the step (n, 400), its side."""
    ratio, backlash_deg = grid()
    half_gaps = np.deg2rad(backlash_deg) / 2
    before = loads_of(study.load, ratio.size, ratio=ratio)[0]
    lash, stiffness = driveline.lashes[0], driveline.contact_stiffnesses[0]
    closed = driveline.matrices(closed=False)[1] + stiffness * np.outer(lash, lash)
    side = np.where(np.linalg.solve(closed, driveline.load) @ lash * before > 0.0, 1.0, -1.0)
    forces = np.outer(driveline.load, before) + stiffness * np.outer(lash, side * half_gaps)
    return half_gaps, np.linalg.solve(closed, forces), side
