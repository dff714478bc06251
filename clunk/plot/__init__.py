"""Figures of values that are handed in: regime maps like the report's Figure 3.4, severity maps like its Figure 3.7.

Cells are samples: a regime is known at the swept values and nowhere between. Maps are drawn with the exact lines
between their regimes where these have been traced, and else as cells.

`layers` is what a figure of a plane (`maps`) needs of a map, whatever its quantity; `labelling` writes names and
measured labels on it; `comparisons` draws two maps as one, `drawing` strips and points, and chooses. Figures of
runs are in `histories`, of thresholds in `thresholds`, of fits, sensitivities and optima in `analyses`. `page` puts the
figures of a file on one page.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from clunk.plot.maps import default_quantities, draw
    from clunk.plot.style import PlotError, save

__all__ = [
    "PlotError",
    "default_quantities",
    "draw",
    "save",
]

_HOME = {
    "PlotError": "style",
    "default_quantities": "maps",
    "draw": "maps",
    "save": "style",
}


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used: the explorer has colours on its page before matplotlib is there."""
    if name not in _HOME:
        raise AttributeError(f"module 'clunk.plot' has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(f"clunk.plot.{_HOME[name]}"), name)
