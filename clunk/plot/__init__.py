"""Figures of values that are handed in: regime maps like the report's Figure 3.4, severity maps like its Figure 3.7.

Cells are samples: a regime is known at the swept values and nowhere between. Regions are drawn from the first to the
last value, with smooth boundaries that pass between the same samples as they do in the data, so that every sample lies
in a region of its own label however small that is.

`layers` is what the painter (`painting`) needs of a map; `notes` and `labelling` explain it; `maps`, `facets`,
`certainty`, `comparisons`, `strips` and `scatter` make the figures, and `drawing` chooses among them. Figures of runs
are in `histories` and `small_gap`, of severities in `profiles`, of sensitivities in `indices`. `page` puts the
figures of a file on one page.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from clunk.plot.drawing import default_quantities, draw
    from clunk.plot.facets import shown_values
    from clunk.plot.layers import QUANTITIES
    from clunk.plot.maps import quantity_map, regime_map
    from clunk.plot.plane import SurplusAxesError
    from clunk.plot.scatter import scatter_map
    from clunk.plot.strips import strip
    from clunk.plot.style import PlotError, save

__all__ = [
    "QUANTITIES",
    "PlotError",
    "SurplusAxesError",
    "default_quantities",
    "draw",
    "quantity_map",
    "regime_map",
    "save",
    "scatter_map",
    "shown_values",
    "strip",
]

_HOME = {
    "PlotError": "style",
    "QUANTITIES": "layers",
    "SurplusAxesError": "plane",
    "default_quantities": "drawing",
    "draw": "drawing",
    "quantity_map": "maps",
    "regime_map": "maps",
    "save": "style",
    "scatter_map": "scatter",
    "shown_values": "facets",
    "strip": "strips",
}


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used: the explorer has colours on its page before matplotlib is there."""
    if name not in _HOME:
        raise AttributeError(f"module 'clunk.plot' has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(f"clunk.plot.{_HOME[name]}"), name)
