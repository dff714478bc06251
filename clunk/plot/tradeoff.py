"""A trade-off: the least of one quantity for each bound on another."""

from matplotlib.figure import Figure

from clunk.analysis.optimisation import Front
from clunk.plot.style import INK, new_figure, styled


@styled()
def trade_off(front: Front) -> Figure:
    """What is minimised over the quantity that is bounded, a point for each optimum."""
    figure = new_figure()
    ax = figure.add_subplot()
    minimized, bounded = ([best.quantities[name] for best in front.points] for name in front.traded)
    ax.plot(bounded, minimized, "o-", color=INK)
    ax.set_ylabel(front.traded[0])
    ax.set_xlabel(front.traded[1])
    ax.set_title(front.points[0].study.title, loc="left", fontweight="bold")
    ax.spines[["top", "right"]].set_visible(False)
    return figure
