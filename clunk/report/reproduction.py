"""What `clunk reproduce` leaves behind: the report's figures and tables, redrawn, and its claims as data."""

import json
from collections.abc import Callable, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from clunk import plot
from clunk.analysis.comparison import compare
from clunk.analysis.measurements import read_experiment
from clunk.analysis.trends import compare_experiment
from clunk.plot import comparisons, histories, profiles
from clunk.plot.small_gap import small_gap
from clunk.report.claims import MAPS, NOMINAL_RATIO, RATIOS, Claim, Evidence
from clunk.report.tables import TABLES
from clunk.results.files import reason, write_whole
from clunk.results.store import StoreError, write
from clunk.simulation.history import sample
from clunk.simulation.linear import one_mode_thresholds
from clunk.simulation.recording import Recording
from clunk.simulation.small_gap import SmallGap
from clunk.simulation.trajectory import Trajectory

Job = tuple[str, Callable[[], Figure]]

_NAMES = {"indentation": "IFM", "restitution": "RCM"}


def save_all(
    jobs: Sequence[Job],
    evidence: Evidence,
    found: Sequence[Claim],
    directory: Path,
    progress: Callable[[int, int], None] | None = None,
) -> list[Path]:
    """Write the figures, the results files behind them and the claims into `directory`; return their paths."""
    directory.mkdir(parents=True, exist_ok=True)
    written = []
    for k, (name, make) in enumerate(jobs):
        written.append(directory / f"{name}.png")
        plot.save(make(), written[-1])
        if progress is not None:
            progress(k + 1, len(jobs))
    for name in MAPS:
        written.append(directory / f"{name}.h5")
        write(written[-1], getattr(evidence.maps, name))
    written.append(directory / "claims.json")
    records = [claim.record() for claim in found]
    text = json.dumps(records, indent=1, ensure_ascii=False) + "\n"
    try:
        write_whole(written[-1], lambda file: file.write(text.encode()))
    except OSError as error:
        raise StoreError(f"{written[-1]} cannot be written: {reason(error)}.") from error
    return written


def figures(e: Evidence) -> list[Job]:
    """Every figure of the report and of what bears on it: a file name's stem, and how to draw it."""
    thresholds = [float(ratio) for ratio in one_mode_thresholds(e.study)]
    maps, nominal = e.maps, e.runs["indentation"][NOMINAL_RATIO]
    both = [_drawn(e.runs[model][NOMINAL_RATIO], name) for model, name in _NAMES.items()]
    all_runs = [
        _drawn(e.runs[model][ratio], f"{name}, σr = {ratio:g}") for ratio in RATIOS for model, name in _NAMES.items()
    ]
    measured = compare_experiment(maps.indentation, read_experiment("table_4_1", TABLES))
    between = compare(maps.indentation, maps.restitution)
    return [
        ("figure_3_1", lambda: histories.angles([_drawn(nominal, "IFM")])),
        ("figure_3_2", lambda: histories.backlash(all_runs)),
        ("figure_3_3", lambda: histories.closeup(both, 0.22, 0.1)),
        ("figure_3_4", lambda: plot.regime_map(maps.indentation, thresholds)),
        ("figure_3_4_restitution", lambda: plot.regime_map(maps.restitution, thresholds)),
        (
            "figure_3_4_difference",
            lambda: comparisons.difference_map(maps.indentation, maps.restitution, between),
        ),
        ("figure_3_4_as_printed", lambda: plot.regime_map(maps.as_printed)),
        ("figure_3_5", lambda: small_gap(e.study.title, SmallGap.of(e.study))),
        ("figure_3_6", lambda: histories.acceleration([_drawn(nominal, "IFM", until=1.5)])),
        ("figure_3_7", lambda: plot.severity_map(maps.indentation)),
        ("figure_3_7_by_force", lambda: plot.severity_map(maps.by_force)),
        ("figure_3_7_velocity", lambda: plot.quantity_map(maps.indentation, "approach_velocity")),
        ("figure_3_7_velocity_restitution", lambda: plot.quantity_map(maps.restitution, "approach_velocity")),
        ("figure_4_4_trend", lambda: profiles.severity_profiles(maps.indentation, (2.5, 4.6, 6.7, 8.5, 10.0))),
        ("table_4_1", lambda: comparisons.experiment_map(maps.indentation, measured)),
    ]


def _drawn(run: Trajectory, name: str, until: float = 1.0) -> Recording:
    return Recording(name, run, sample(run, until=until))
