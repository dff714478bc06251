"""Figures for people: regime maps like the report's Figure 3.4, severity maps like its Figure 3.7.

Cells are samples: a regime is known at the swept values and nowhere between. Regions are drawn from the first to the
last value, with smooth boundaries that pass between the same samples as they do in the data, so that every sample lies
in a region of its own label however small that is.

Figures of runs are in `histories` and `small_gap`, of comparisons in `comparisons`, of severities in `profiles`: what
they draw takes longer to import than the maps do.
"""

from clunk.plot.drawing import default_quantities, draw
from clunk.plot.facets import MOST_VALUES, facet_map, shown_values
from clunk.plot.maps import QUANTITIES, quantity_map, regime_map, severity_map, strip
from clunk.plot.plane import x_axis
from clunk.plot.scatter import scatter_curve, scatter_map
from clunk.plot.style import PlotError, save

__all__ = [
    "MOST_VALUES",
    "QUANTITIES",
    "PlotError",
    "default_quantities",
    "draw",
    "facet_map",
    "quantity_map",
    "regime_map",
    "save",
    "scatter_curve",
    "scatter_map",
    "severity_map",
    "shown_values",
    "strip",
    "x_axis",
]
