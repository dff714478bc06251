"""`clunk info`: what a results file holds; its map as text, a letter for each cell."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from string import ascii_letters
from typing import TYPE_CHECKING, Any

import click

from clunk.cli import tables
from clunk.cli.options import PATH, json_option
from clunk.study.records import fill

if TYPE_CHECKING:
    from clunk.results.maps import AnyMap
    from clunk.study.arrays import Positions
    from clunk.study.axes import ResultAxis

_COLUMNS, _ROWS = 64, 20  # of a map, beside the numbers of its upward axis
_WIDEST = 3  # columns of a cell
_NO_BREAK = "\N{NO-BREAK SPACE}"
_SYMBOLS = {"NI": ".", "failed": "?"}  # of other labels letters, and # where there are no more


@click.command()
@click.argument("file", type=PATH)
@click.option("--config", "show_config", is_flag=True, help="Print the whole resolved config (TOML) instead.")
@click.option("--map", "show_map", is_flag=True, help="Also print the map, a letter for each cell.")
@click.option("--check", is_flag=True, help="Also say that its bytes match their checksum.")
@json_option
def info(file: Path, show_config: bool, show_map: bool, check: bool, as_json: bool) -> None:
    """Say what a results file holds.

    Prints its axes, load, versions and how many cells each label has.

    \b
    Examples:
      clunk info results/figure_3_4.h5 --check
      clunk info results/figure_3_4.h5 --map
    """
    from clunk.results import store
    from clunk.study.loads import PROFILES, numbers

    results = store.read_map(file)
    if show_map and as_json:
        raise click.UsageError("--map is for people and does not go with --json; clunk export writes each cell.")
    if show_map and not _is_drawable(results.axes[:-1] if results.lashes else results.axes):
        raise click.UsageError("--map shows one axis or two; of more, clunk plot --at draws a slice.")
    if show_config:
        click.echo(results.config, nl=not results.config.endswith("\n"))
        return
    if as_json:
        axes = [
            {"parameter": axis.parameter, "unit": axis.unit}
            | {"start": axis.values[0], "stop": axis.values[-1], "count": len(axis.values)}
            for axis in results.axes
            if not axis.words
        ]
        coordinates = [
            {"parameter": axis.parameter, "unit": axis.unit, "lowest": axis.values.min(), "highest": axis.values.max()}
            for axis in results.coordinates
        ]
        record: dict[str, Any] = {"title": results.title, "axes": axes}
        record |= {"coordinates": coordinates} if coordinates else {}
        record |= tables.outcomes(results)
        if results.boundaries is not None:
            record |= {"boundaries": tables.boundary_record(results.boundaries)}
        record |= {"caveats": results.caveats, "config_digest": results.config_digest}
        checked: dict[str, Any] = {"checked": {"data": True, "bytes": True}} if check else {}
        tables.print_record(record | results.attributes | checked)
        return
    rows = [*results.summary()]
    load = results.setting("load")
    if load is not None:
        swept = {axis.parameter for axis in results.parameters}
        rows.append(("load", ", ".join([PROFILES[load["profile"]].name, *numbers(load, swept)])))
    rows.append(("config", f"{results.config_digest[:16]}…"))
    rows += [(name.removesuffix("_version"), str(value)) for name, value in results.attributes.items()]
    if check:
        rows.append(("checked", "the bytes match their checksum"))
    click.echo(f"{results.title}\n")
    tables.print_values(rows)
    click.echo()
    tables.print_outcomes(results)
    if results.boundaries is not None:
        click.echo()
        tables.print_boundaries(results.boundaries)
    for caveat in results.caveats:
        click.echo(fill(f"note: {caveat}"))
    if show_map:
        click.echo()
        for part in tables.by_lash(results):
            click.echo("\n".join(_text_map(part)))


def _is_drawable(axes: Sequence[ResultAxis]) -> bool:
    """Whether at most two axes have several values, and of two neither is that of the runs, which have no order."""
    from clunk.study.axes import RUN

    names = [axis.parameter for axis in axes if len(axis.values) > 1]
    return len(names) < 2 or (len(names) == 2 and RUN not in names)


def _text_map(results: AnyMap) -> list[str]:
    """Lines of the map of one lash, for whose axes `_is_drawable` holds: letters, the axes' values, and a legend.

    The load ratio, or else the first axis, goes from left to right. Of an axis with more values than there is room for,
    evenly spread ones are shown. Of a tolerance map the labels are the most likely ones.
    """
    import numpy as np

    from clunk.results.labels import FAILED

    swept = [axis for axis in results.axes if len(axis.values) > 1] or [results.axes[0]]
    codes = results.sequence.reshape([len(axis.values) for axis in swept])
    if len(swept) == 2 and swept[1].parameter == "load.ratio":
        swept, codes = swept[::-1], codes.T
    x, *upward = swept
    columns, rows = _shown(x, _COLUMNS), _shown(upward[0], _ROWS)[::-1] if upward else np.zeros(1, np.intp)
    names = np.array([*results.labels, FAILED])  # the code of failed cells, -1, is the last
    shown = names[codes.reshape(len(x.values), -1)[np.ix_(columns, rows)]]
    labels = [name for name in names.tolist() if name in shown]
    lettered = [name for name in labels if name not in _SYMBOLS]
    symbols = _SYMBOLS | dict.fromkeys(lettered, "#") | dict(zip(lettered, ascii_letters, strict=False))
    wide = min(_WIDEST, _COLUMNS // len(columns))
    ticks = [f"{value:.4g}" for value in upward[0].values[rows]] if upward else [""]
    margin = max(map(len, ticks))
    lines = [_heading(axis) for axis in upward]
    for tick, of_row in zip(ticks, shown.T.tolist(), strict=True):
        lines.append(f"{tick:>{margin}} |{''.join(symbols[name] * wide for name in of_row)}")
    first, last = (f"{x.values[columns[k]]:.4g}" for k in (0, -1))
    below = f"{first:<{max(len(columns) * wide - len(last), 0)}} {last}", _heading(x)
    lines += [" " * (margin + 2) + line for line in below]
    legend = fill("   ".join(f"{symbols[name]}{_NO_BREAK}{name}" for name in labels))
    return [*lines, "", *legend.replace(_NO_BREAK, " ").splitlines()]


def _shown(axis: ResultAxis, most: int) -> Positions:
    """Positions of at most so many of an axis's values, evenly spread, the values ascending."""
    import numpy as np

    count = len(axis.values)
    places = np.linspace(0, count - 1, min(count, most)).round().astype(np.intp)
    return np.argsort(axis.values, kind="stable")[places]


def _heading(axis: ResultAxis) -> str:
    return axis.parameter + ("" if axis.unit == "1" else f" [{axis.unit}]")
