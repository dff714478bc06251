"""Figures of given results: regime maps like the report's Figure 3.4, severity maps like its Figure 3.7.

Cells are samples: a regime is known at the swept values and nowhere between. Maps are drawn with the exact lines
between their regimes where these have been traced, and else as cells.

`layers` prepares any quantity of a map for drawing, in a view of the map's axes (`plane`); `maps` draws these layers,
and `labelling` writes names and measured labels on them. Figures of runs are in `histories`; those of comparisons,
thresholds, fits, sensitivities and optima are in `analyses`. `page` puts the figures of a results file on one page.
"""

from clunk.plot.maps import default_quantities, draw
from clunk.plot.style import PlotError, save

__all__ = [
    "PlotError",
    "default_quantities",
    "draw",
    "save",
]
