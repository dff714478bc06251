"""`clunk optimize`: the values of some keys that make a quantity least while others hold."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from clunk.cli import tables, terminal
from clunk.cli.options import PATH, json_option, lash_option, set_option, workers_option


@click.command()
@click.argument("config", type=PATH)
@set_option
@click.option("-o", "--output", type=PATH, help="Also write the config with the best values (.toml).")
@click.option("--front", "traded", metavar="QUANTITY", help="The least value for bounds on a quantity, too.")
@click.option("--plot", "picture", type=PATH, help="Draw the run before and after, or the front: .png .svg .pdf.")
@lash_option
@workers_option
@json_option
def optimize(
    config: Path,
    overrides: tuple[str, ...],
    output: Path | None,
    traded: str | None,
    picture: Path | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Find the values of keys that make a quantity least.

    What is minimised, what must hold and which keys are free stands in [optimize] of CONFIG. With --front each point of
    the trade-off is a config, FILE-1.toml and so on.

    \b
    Examples:
      clunk optimize configs/shaped_release.toml -o best.toml
      clunk optimize configs/car_release.toml --front severity --plot front.png
    """
    from clunk.analysis import optimisation
    from clunk.results import files
    from clunk.results.files import write_text
    from clunk.simulation.history import sample
    from clunk.simulation.trajectory import simulate
    from clunk.study.config import load_study
    from clunk.study.study import to_toml

    study = load_study(config, overrides)
    for path, suffixes in ((output, (".toml",)), (picture, files.PICTURES)):
        if path is not None:
            files.check(path, suffixes, reads=config)
    terminal.warn_of_coarse_step(study, study.solver.method)
    options["progress"] = True
    try:
        found = optimisation.front(study, traded, **options) if traded else optimisation.optimize(study, **options)
    except KeyboardInterrupt as stopped:
        for best in stopped.args:
            tables.tell(best, as_json)
        raise
    tables.tell(found, as_json)
    points = found.points if isinstance(found, optimisation.Front) else (found,)
    for k, best in enumerate(points, 1):
        if output is not None:
            path = output.with_stem(f"{output.stem}-{k}") if traded else output
            write_text(path, to_toml(best.study))
            terminal.say_written(path)
    if picture is not None:
        from clunk.plot import analyses, histories

        if isinstance(found, optimisation.Front):
            figure = analyses.trade_off(found)
        else:
            runs = {"as it is": study, "best": found.study}
            figure = histories.history_figure(
                [sample(simulate(each.model_copy(update={"sweep": None})), name=name) for name, each in runs.items()]
            )
        terminal.save_picture(figure, picture)
