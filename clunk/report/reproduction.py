"""The report's figures redrawn, and its claims written as JSON and as Markdown tables."""

import json
from collections.abc import Callable, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from clunk.analysis.comparison import compare
from clunk.plot import draw, save
from clunk.plot.analyses import difference_map, experiment_map, measured_on_maps
from clunk.plot.histories import history_figure, small_gap
from clunk.report.claims import Claim, Verdict
from clunk.report.evidence import NOMINAL_RATIO, RATIOS, Evidence
from clunk.results.files import write_text
from clunk.results.store import write_results
from clunk.simulation.history import History, sample
from clunk.simulation.small_gap import SmallGap, rigid_contact_thresholds
from clunk.study.document import read_text
from clunk.study.errors import ClunkError
from clunk.study.records import plain

_NAMES = {"indentation": "IFM", "restitution": "RCM"}


def save_all(evidence: Evidence, claims: Sequence[Claim], directory: Path) -> None:
    """Write the figures, the results files behind them and the claims into a directory."""
    for name, make in figures(evidence).items():
        save(make(), directory / f"{name}.png")
    for name, results in evidence.maps.items():
        write_results(directory / f"{name}.h5", results)
    write_text(directory / "claims.json", json.dumps(plain(claims), indent=1, ensure_ascii=False) + "\n")


def with_tables(path: Path, claims: Sequence[Claim]) -> str:
    """A Markdown file's text with the claims between its comments ``<!-- claims: errors -->`` … ``<!-- end -->``.

    The table ``errors`` has the claims that are known not to hold, ``agrees`` the others. Raises ClunkError.
    """
    text = read_text(path, "a page with the claims", "a Markdown file", ".")
    for name, agrees in (("errors", False), ("agrees", True)):
        begin = f"<!-- claims: {name} -->\n"
        rows = ["| where | the report | clunk |", "| --- | --- | --- |"]
        rows += [
            f"| {claim.where} | {claim.report} | {claim.ours}{' (no longer agrees)' if claim.failed else ''} |"
            for claim in claims
            if (claim.known == Verdict.AGREES) == agrees
        ]
        before, _, rest = text.partition(begin)
        _, end, after = rest.partition("<!-- end -->")
        if not end:
            raise ClunkError(f"{path} has no place for the claims: a line {begin.strip()}, and <!-- end --> after it.")
        text = before + begin + "\n".join([*rows, end]) + after
    return text


def figures(e: Evidence) -> dict[str, Callable[[], Figure]]:
    """Figures of the report, and further ones that bear on it: stem of a file's name -> function that draws it."""
    thresholds = rigid_contact_thresholds(e.study).tolist()
    maps = e.maps

    def run(name: str, ratio: float = NOMINAL_RATIO, until: float = 1.0) -> History:
        return sample(e.runs[name][ratio], until=until, name=_NAMES[name])

    both = [run(name) for name in _NAMES]
    all_runs = [run(name, ratio) for ratio in RATIOS for name in _NAMES]
    between = compare(maps["indentation"], maps["restitution"])
    return {
        "figure_3_1": lambda: history_figure([run("indentation")], "angles"),
        "figure_3_2": lambda: history_figure(all_runs, "backlash"),
        "figure_3_3": lambda: history_figure(both, "closeup"),
        "figure_3_4": lambda: draw(maps["indentation"], "regimes", thresholds),
        "figure_3_4_restitution": lambda: draw(maps["restitution"], "regimes", thresholds),
        "figure_3_4_difference": lambda: difference_map(between),
        "figure_3_4_as_printed": lambda: draw(maps["as_printed"], "regimes"),
        "figure_3_5": lambda: small_gap(e.study.title, SmallGap.of(e.study)),
        "figure_3_6": lambda: history_figure([run("indentation", until=1.5)], "acceleration"),
        "figure_3_7": lambda: draw(maps["indentation"], "severity"),
        "figure_3_7_by_force": lambda: draw(maps["by_force"], "severity"),
        "figure_3_7_velocity": lambda: draw(maps["indentation"], "approach_velocity"),
        "figure_3_7_velocity_restitution": lambda: draw(maps["restitution"], "approach_velocity"),
        "table_4_1": lambda: experiment_map(maps["indentation"], e.measured),
        "table_4_1_fitted": lambda: measured_on_maps(e.fitted),
    }
