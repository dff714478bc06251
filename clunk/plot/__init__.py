"""Figures of values that are handed in: regime maps like the report's Figure 3.4, severity maps like its Figure 3.7.

Cells are samples: a regime is known at the swept values and nowhere between. Maps are drawn with the exact lines
between their regimes where these have been traced, and else as cells.

`layers` is what a figure of a plane (`maps`) needs of a map, whatever its quantity, in a view of its axes (`plane`);
`labelling` writes names and measured labels on it. Figures of runs are in `histories`, of comparisons, thresholds,
fits, sensitivities and optima in `analyses`. `page` puts the figures of a file on one page.
"""

from clunk.plot.maps import default_quantities, draw
from clunk.plot.style import PlotError, save

__all__ = [
    "PlotError",
    "default_quantities",
    "draw",
    "save",
]
