"""`clunk verify`: one study by both methods."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from clunk.cli import tables, terminal
from clunk.cli.options import EXIT_FAILED_CELLS, EXIT_MISMATCH, PATH, json_option, set_option, workers_option


@click.command()
@click.argument("config", type=PATH)
@set_option
@workers_option
@json_option
def verify(config: Path, overrides: tuple[str, ...], workers: int | None, as_json: bool) -> None:
    """Run a config by both methods and compare the results.

    The methods are rk4 (A) and exact (B), and what is printed is what clunk compare prints of their maps. Exact is
    guarded: it cannot skip an event, to rounding, for this model. Where labels differ in a cell that it does not flag
    (undecided or grazing), the exit code is 4, and a smaller solver.step may mend it. A config without axes is a map
    of one cell.

    \b
    Examples:
      clunk verify configs/smoke.toml
      clunk verify configs/figure_3_4.toml --set solver.step=5e-5
    """
    import clunk
    from clunk.analysis.comparison import METHODS

    study = clunk.load_study(config, overrides)
    terminal.warn_of_coarse_step(study, "rk4")
    comparison = clunk.verify(study, workers=workers, progress=True)
    tables.tell(comparison, as_json)
    for method, results in zip(METHODS, comparison.maps, strict=True):
        terminal.report_failures(results, f" by {method}")
    if comparison.differing_elsewhere:
        sys.exit(EXIT_MISMATCH)
    if any(comparison.failed.values()):
        sys.exit(EXIT_FAILED_CELLS)
