"""Options that several commands share, and the exit codes."""

from __future__ import annotations

from pathlib import Path

import click

from clunk.cli import completion

EXIT_INTERNAL = 1
EXIT_USAGE = 2
EXIT_FAILED_CELLS = 3
EXIT_MISMATCH = 4
EXIT_INTERRUPTED = 130
EXIT_TERMINATED = 143
PATH = click.Path(path_type=Path)

set_option = click.option(
    "--set",
    "overrides",
    multiple=True,
    metavar="KEY=VALUE",
    shell_complete=completion.assignments,
    help="Override a key of the config, for example --set load.ratio=7; a path begins in the current directory. May be "
    "repeated.",
)


at_option = click.option(
    "--at",
    "at",
    multiple=True,
    metavar="KEY=VALUE",
    shell_complete=completion.places,
    help="Value of a swept key, the nearest that its axis has. May be repeated.",
)


lash_option = click.option(
    "--lash", metavar="NAME", help="Of several lashes, the one that is meant, by name or number [the first]."
)
json_option = click.option("--json", "as_json", is_flag=True, help="Print JSON for scripts.")
workers_option = click.option("--workers", type=click.IntRange(1, 1024), help="Threads [one for each core].")
