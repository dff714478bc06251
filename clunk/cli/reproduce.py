"""`clunk reproduce`: recompute the report of 2008."""

import sys
from pathlib import Path

import click

from clunk.cli import tables, terminal
from clunk.cli.options import EXIT_MISMATCH, json_option, output_option, path_option, workers_option


@click.command()
@output_option(default="results/reproduction", help="Directory of the figures.")
@workers_option
@click.option(
    "--coarsen",
    type=click.Choice(["1", "2", "5", "10"]),  # each keeps every load ratio and backlash that the report names
    default="1",
    help="Run the maps with only every n-th value of their axes [1].",
)
@path_option("--table", help="Also write the claims into this Markdown file.")
@json_option
def reproduce(output: Path, workers: int | None, coarsen: str, table: Path | None, as_json: bool) -> None:
    """Recompute the report that clunk is built on.

    Prints every number and claim of the report beside clunk's own, and draws every figure again. Exits with 4 if a
    claim that is known to agree no longer does. The file of --table has to have the comments <!-- claims: errors -->
    and <!-- claims: agrees -->, each with an <!-- end --> after it; the tables are written between them.

    \b
    Examples:
      clunk reproduce
      clunk reproduce --table results/README.md
    """
    from clunk.report import reproduction
    from clunk.report.claims import claims as claims_of
    from clunk.report.evidence import Evidence, run_maps
    from clunk.results import files

    files.check(output / "figure_3_1.png", files.PICTURES)
    if table is not None:
        reproduction.with_tables(table, ())  # raises before the runs where the file has no place for the tables
    evidence = Evidence(run_maps(int(coarsen), workers, progress=True))
    claims = claims_of(evidence)
    if as_json:
        tables.print_record(claims)
    else:
        for claim in claims:
            tables.tell(claim, as_json)
            click.echo()
    if coarsen != "1":
        click.echo(f"note: maps have one of {coarsen} values an axis, on which shares and thresholds depend", err=True)
    reproduction.save_all(evidence, claims, output)
    if table is not None:
        files.write_text(table, reproduction.with_tables(table, claims))
    terminal.say_written(output)
    failed = [claim for claim in claims if claim.failed]
    if failed:
        click.echo(f"{len(failed)} of {len(claims)} claims no longer agree (!)", err=True)
        sys.exit(EXIT_MISMATCH)
