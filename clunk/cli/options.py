"""Arguments and options that several commands share, the cell that --at names, and exit codes."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from clunk.cli import terminal

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Sequence

    from clunk.study.axes import ResultAxis
    from clunk.study.study import Study

EXIT_USAGE = 2
EXIT_FAILED_CELLS = 3
EXIT_MISMATCH = 4
EXIT_INTERRUPTED = 130
EXIT_TERMINATED = 143
PATH = click.Path(path_type=Path)

path_argument = functools.partial(click.argument, type=PATH)
path_option = functools.partial(click.option, type=PATH)
flag_option = functools.partial(click.option, is_flag=True)
repeated_option = functools.partial(click.option, multiple=True)
file_argument = path_argument("file")
output_option = functools.partial(path_option, "-o", "--output")

set_option = repeated_option(
    "--set",
    "overrides",
    metavar="KEY=VALUE",
    help="Override a key of the config, for example --set load.ratio=7; a relative path is one from the current "
    "directory. May be repeated.",
)


def study_argument(command: Callable[..., None]) -> Callable[..., None]:
    """Decorate a command with the argument CONFIG, a config or a results file, and the option --set.

    The command is called with `config`, the path, and `study`, the study that both make.
    """

    @path_argument("config")
    @set_option
    @functools.wraps(command)
    def with_study(config: Path, overrides: tuple[str, ...], **options: Any) -> None:
        command(config=config, study=study_of(config, overrides), **options)

    return with_study


at_option = repeated_option(
    "--at",
    metavar="KEY=VALUE",
    help="Value of a swept key, the nearest that its axis has. May be repeated.",
)


lash_option = click.option(
    "--lash", metavar="NAME", help="The lash, by name or number, in a study of several [the first]."
)
json_option = flag_option("--json", "as_json", help="Print JSON for scripts.")
workers_option = click.option("--workers", type=click.IntRange(1, 1024), help="Threads [one for each core].")


def study_of(source: Path, overrides: Sequence[str]) -> Study:
    """The study of a config, or of the config in a results file, with KEY=VALUE overrides."""
    from clunk.study.config import load_study, study_from_text

    if source.suffix != ".h5":
        return load_study(source, overrides)
    from clunk.results.store import read_map

    return study_from_text(read_map(source).config, f"the config in {source}", overrides)


def cell_values(study: Study, at: tuple[str, ...], *, all_needed: bool, but: Collection[str] = ()) -> dict[str, float]:
    """Values of the swept keys that --at names, by key; a `run` that it names stands for the values of its coordinates.

    all_needed : whether --at has to name every swept key; otherwise a key that it does not name keeps the config's own
        value, and a note says so
    but : swept keys that need not be named, since they get their values elsewhere

    Raises UsageError where a swept key has to be named and is not, or as `nearest_values`.
    """
    from clunk.study.axes import RUN
    from clunk.study.designs import design_of
    from clunk.study.parameters import nominal_value

    design = design_of(study)
    named = nearest_values(design.axes, at, study)
    missing = [axis for axis in design.axes if axis.parameter not in (*named, *but)]
    if missing and all_needed:
        raise click.UsageError(f"Which cell? Also name by --at KEY=VALUE: {_spreads(missing)}.")
    unnamed = [each for axis in missing for each in axis.parameters]
    if unnamed:
        listed = ", ".join(f"{axis.parameter} = {nominal_value(study, axis.parameter):g}" for axis in unnamed)
        terminal.complain(f"note: without --at, as in the config: {listed}")
    run = named.pop(RUN, None)
    if run is not None:
        named |= {axis.parameter: axis.values[int(run) - 1] for axis in design.coordinates}
    return named


def nearest_values(axes: Sequence[ResultAxis], at: tuple[str, ...], document: Any) -> dict[str, float]:
    """Values that --at gives to axes, by parameter, each the nearest value of its axis; a note tells a rounded one.

    document : config that has the axes

    Raises UsageError where --at names no axis, one twice, or a value that is none or lies beyond the axis.
    """
    import numpy as np

    from clunk.study.document import assigned
    from clunk.study.errors import ClunkError
    from clunk.study.parameters import names_of, numbered, parameter_at

    swept = {axis.parameter: axis for axis in axes}
    inertias = names_of(document)["driveline.inertias"]
    values = {}
    for assignment in at:
        name, text = assigned(assignment)
        (key,) = numbered([name], document)
        if not axes:
            raise click.UsageError(f"--at {assignment}: nothing is swept; --set {assignment} gives a key its value.")
        try:
            axis = swept.pop(key)
            is_name = text in inertias and parameter_at(key, document)[1].whole
            number = inertias.index(text) + 1 if is_name else text
            wanted = text if text in axis.words else float(number or "")
        except (KeyError, ValueError):
            there = _spreads(axes)
            raise click.UsageError(
                f"--at {assignment}: must be KEY=VALUE of what is swept: {there}; each once."
            ) from None
        try:
            nearest = float(axis.values[axis.nearest(wanted)])
        except ClunkError as error:
            raise click.UsageError(f"--at {assignment}: {error}") from None
        values[key] = nearest
        if wanted != text and not np.isclose(nearest, wanted, rtol=1e-9, atol=0.0):
            terminal.complain(f"{key} = {nearest:.6g} is the nearest value of its axis")
    return values


def _spreads(axes: Sequence[ResultAxis]) -> str:
    return "; ".join(f"{axis.parameter}: {axis.spread}" for axis in axes)
