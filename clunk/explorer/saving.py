"""Files that are saved from the page: pictures of what is seen, the run as CSV, and the config that makes it again."""

from __future__ import annotations

import base64
import io
import threading
from collections.abc import Sequence
from dataclasses import replace
from pathlib import PurePath
from typing import NamedTuple

from clunk.explorer.variations import Variations
from clunk.results.tolerancemap import AnyMap
from clunk.simulation.energy import EnergyBalance
from clunk.simulation.history import History

NAMES = ("map.png", "map.svg", "run.png", "run.svg", "run.csv", "config.toml")
_TYPES = {"png": "image/png", "svg": "image/svg+xml", "csv": "text/csv", "toml": "application/toml"}
_drawing = threading.Lock()  # matplotlib's style is one for all threads

Cell = tuple[float, ...]  # values of the map's axes


class Shown(NamedTuple):
    """A run on the page, with what it takes to make it again."""

    cell: Cell
    values: dict[str, float]  # of all axes
    numbers: dict[str, float]
    history: History
    energy: EnergyBalance
    place: str  # values and numbers in words


def download(
    name: str, runs: Sequence[Shown], variations: Variations, results: AnyMap, quantity: str
) -> dict[str, list[str]]:
    """One of `NAMES` as the browser is handed it: its name, its type, and its content in base 64.

    runs : the one that is shown, and those that are pinned
    results, quantity : of one lash's map
    """
    from clunk.analysis.small_gap import thresholds_of
    from clunk.plot.drawing import draw
    from clunk.plot.histories import history_figure
    from clunk.plot.style import encode
    from clunk.results.historyfile import write_csv

    target = io.BytesIO()
    what, _, suffix = name.partition(".")
    with _drawing:
        if name == "config.toml":
            target.write(variations.config(runs[0].values, runs[0].numbers).encode())
        elif name == "run.csv":
            write_csv(target, runs[0].history)
        elif what == "map":
            encode(draw(results, quantity, thresholds_of(results)), suffix, target)
        else:
            encode(history_figure([replace(run.history, name=run.place) for run in runs]), suffix, target)
    stem = PurePath(variations.subject.name).stem or "map"
    content = base64.b64encode(target.getvalue()).decode()
    return {"name": [f"{stem}-{name}"], "type": [_TYPES[suffix]], "content": [content]}
