"""Subject of the explorer: results, and which of their axes a map of them has; of a single cell only its run.

It imports nothing that runs, validates or draws: the stored map is on the page before these are there.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

from clunk.results.labels import FAILED
from clunk.results.maps import parameters_of, values_at
from clunk.results.tolerancemap import AnyMap, ToleranceMap
from clunk.study.axes import LASH, RUN, ResultAxis
from clunk.study.errors import ClunkError

_USUAL = ("load.ratio", "lash.backlash_deg")  # stay on the map where there are more axes

Numbers = Mapping[str, float]  # dotted key -> value, in its unit


class ExplorerError(ClunkError):
    """Something that cannot be explored; its text is one sentence for the user."""


@dataclass(frozen=True, eq=False)
class Subject:
    """Results, and the axes of the map.

    results : of all axes and lashes
    name : for files that are saved
    """

    results: AnyMap
    name: str

    @classmethod
    def of(cls, results: AnyMap, name: str | os.PathLike[str] = "map") -> Subject:
        """The subject of some results. Raises ExplorerError where no run can be made of a cell."""
        if not results.config:
            raise ExplorerError("These results have no config, so that no run can be made of a cell.")
        return cls(results, str(name))

    @property
    def title(self) -> str:
        """Title of the results."""
        return self.results.title.strip() or "Impact regimes"

    @cached_property
    def plane(self) -> tuple[ResultAxis, ...]:
        """The axes of the map, x first: two, one where no more than one changes, or none where there is one cell."""
        ranked = sorted(self._changing, key=lambda axis: (axis.parameter == RUN, axis.parameter not in _USUAL))
        chosen = [axis for k, axis in enumerate(ranked[:2]) if k == 0 or axis.parameter != RUN]  # runs have no order
        return tuple(sorted(chosen, key=lambda axis: (axis.parameter != "load.ratio", self._axes.index(axis))))

    @cached_property
    def slices(self) -> tuple[ResultAxis, ...]:
        """The further axes, of which the map shows one value each."""
        return tuple(axis for axis in self._changing if axis not in self.plane)

    @cached_property
    def fixed(self) -> dict[str, float]:
        """Values of the keys that are axes of one value."""
        alone = [axis for axis in self._axes if axis not in self._changing and axis.parameter != RUN]
        return {axis.parameter: float(axis.values[0]) for axis in alone}

    @property
    def swept(self) -> tuple[ResultAxis, ...]:
        """The parameters that differ from cell to cell."""
        return tuple(axis for axis in self.results.parameters if len(axis.values) > 1 and axis.parameter != LASH)

    @property
    def has_runs(self) -> bool:
        """Whether some parameters lie together along `run`."""
        return any(axis.parameter == RUN for axis in self.results.axes)

    def stored(self, slices: Numbers) -> AnyMap:
        """The stored map at values of the further axes."""
        return self.results.at(slices) if slices else self.results

    def likelihood(self, cell: Numbers, lash: str) -> str:
        """The probability of each label in a cell of a tolerance map; empty for a regime map."""
        if not isinstance(self.results, ToleranceMap):
            return ""
        part = self.results.of_lash(lash)
        at = tuple(axis.nearest(cell.get(axis.parameter, axis.values[0])) for axis in part.axes)
        shares = zip((*part.labels, FAILED), part.probability[at].tolist(), strict=True)
        likely = sorted(((share, label) for label, share in shares if share), reverse=True)
        return f"of {part.draws:,} draws: " + ", ".join(f"{label} {100.0 * share:.3g} %" for share, label in likely)

    def values(self, cell: Numbers) -> dict[str, float]:
        """Values of the swept keys in a cell, from values of the axes, `run` included."""
        at = [axis.nearest(cell.get(axis.parameter, axis.values[0])) for axis in self._axes]
        swept = values_at(self._axes, at, self.results.coordinates)
        names = [axis.parameter for axis in parameters_of(self._axes, self.results.coordinates)]
        return dict(zip(names, swept, strict=True))

    @cached_property
    def _changing(self) -> tuple[ResultAxis, ...]:
        return tuple(axis for axis in self._axes if len(axis.values) > 1)

    @cached_property
    def _axes(self) -> tuple[ResultAxis, ...]:
        return tuple(axis for axis in self.results.axes if axis.parameter != LASH)
