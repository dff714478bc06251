"""The report against the computation: every claim has the verdict that it is known to deserve, and can lose it."""

import json
import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from helpers import reference
from helpers.maps import with_arrays

from clunk.report import claims, reproduction
from clunk.report.claims import Claim, Verdict
from clunk.report.evidence import Evidence, run_maps
from clunk.results.files import write_text
from clunk.simulation.driveline import Driveline
from clunk.simulation.small_gap import (
    one_mode_thresholds,
    periods_in_envelope,
    rigid_contact_thresholds,
)
from clunk.simulation.trajectory import simulate
from clunk.study.config import study_from_text
from clunk.study.errors import ClunkError
from clunk.study.study import replace_values

COARSE = 10  # 21 x 21 and 11 x 11: every region of Figure 3.4 has cells


@pytest.fixture(scope="module")
def evidence():
    return Evidence(run_maps(COARSE))


@pytest.fixture(scope="module")
def found(evidence):
    return claims.claims(evidence)


def test_no_claim_that_is_known_to_agree_has_stopped_agreeing(found):
    assert [claim for claim in found if claim.failed] == []


def test_claims_that_are_known_not_to_agree_are_still_shown_not_to(found):
    # a claim that comes to agree is good news, but then `known` and the README have to say so
    assert [claim for claim in found if claim.verdict != claim.known] == []


def test_every_figure_table_and_erratum_of_the_report_has_a_claim(found):
    places = " ".join(claim.where for claim in found)
    for place in ("Table 2.2", "Eq. 2.5", "Eq. 2.8", "Figure 3.1", "Figure 3.2", "Figure 3.3", "Eq. 3.1", "Table 3.1"):
        assert place in places
    for place in ("Figure 3.4", "Figure 3.6", "Figure 3.7", "Table 4.1", "§4.2.2", "Figure 4.3"):
        assert place in places


@pytest.mark.parametrize(
    ("field", "value", "place"),
    [("severity", 0.0, "§3.3.2"), ("severity", 1.0, "§3.3.2")],
)
def test_a_map_without_its_severity_fails_the_claims_about_it(evidence, field, value, place):
    flat = getattr(evidence.maps["indentation"], field) * 0.0 + value
    maps = evidence.maps | {"indentation": with_arrays(evidence.maps["indentation"], **{field: flat})}
    failed = [claim for claim in claims.claims(Evidence(maps)) if claim.failed]
    assert failed
    assert any(place in claim.where for claim in failed)


def test_swapped_models_fail_the_claim_about_their_chatter(evidence):
    swapped = Evidence(evidence.maps)
    swapped.runs = {"indentation": evidence.runs["restitution"], "restitution": evidence.runs["indentation"]}
    failed = [claim for claim in claims._time_histories(swapped) if claim.failed]
    assert any("delay" in claim.report for claim in failed)


@pytest.mark.parametrize(
    ("preset", "reports"),
    [
        ("boere-2008", ["c34 acts in the gap", "stiffness in N/m", "unit m/s²", "text: from D(1)+S(1) to"]),
        ("boere-2008-as-printed", ["n_c = ln(σr)/ζ", "0.5 < n_c > 1.5"]),
    ],
)
def test_errors_of_the_report_are_computed_and_not_asserted(evidence, preset, reports):
    """Other evidence does not show them: a lash at 1 m, no damping in the gap, another table, other inertias."""
    at_one_metre = ["lash.radius=1.0", "lash.contact.stiffness=2618.88", "lash.contact.damping=0.6016"]
    run = simulate(study_from_text(f'[driveline]\npreset = "{preset}"\n', overrides=at_one_metre))
    wrong = Evidence(evidence.maps)
    wrong.runs["indentation"][claims.NOMINAL_RATIO] = wrong.damped_in_the_gap = run
    points = evidence.measured.points
    wrong.measured = replace(evidence.measured, points=tuple(replace(point, measured="NI") for point in points))
    by_evidence = zip(claims.claims(evidence), claims.claims(wrong), strict=True)
    lost = [claim.report for claim, other in by_evidence if (claim.verdict, other.verdict) == (CONTRADICTS, DIFFERS)]
    for report in reports:
        assert any(each.startswith(report) for each in lost), report


CONTRADICTS, DIFFERS = Verdict.CONTRADICTS, Verdict.DIFFERS
README = Path(__file__).parent.parent / "results" / "README.md"


def rows(path):
    return re.findall(r"^\| (.+) \| (.+) \| (.+) \|$", path.read_text("utf-8"), flags=re.MULTILINE)


def test_the_tables_of_the_results_have_every_claim_of_the_report(found, tmp_path):
    copy = tmp_path / "README.md"
    copy.write_text(README.read_text("utf-8"), "utf-8")
    write_text(copy, reproduction.with_tables(copy, found))
    written = {(where, report): ours for where, report, ours in rows(copy)}
    assert {(claim.where, claim.report): claim.ours for claim in found}.items() <= written.items()
    assert written.keys() == {(where, report) for where, report, _ in rows(README)}


@pytest.mark.slow
def test_the_tables_of_the_results_are_what_reproduce_computes(tmp_path):
    copy = tmp_path / "README.md"
    copy.write_text(README.read_text("utf-8"), "utf-8")
    write_text(copy, reproduction.with_tables(copy, claims.claims(Evidence(run_maps()))))
    assert copy.read_text("utf-8") == README.read_text("utf-8")


def test_tables_are_written_between_the_marks_and_a_file_without_them_is_refused(tmp_path):
    path = tmp_path / "page.md"
    path.write_text("before\n<!-- claims: errors -->\nold\n<!-- end -->\n\n<!-- claims: agrees -->\n<!-- end -->\n")
    broken = Claim("§0", "two and two make four", "five", False, Verdict.AGREES)
    write_text(path, reproduction.with_tables(path, [broken, replace(broken, report="odd", known=Verdict.DIFFERS)]))
    once = path.read_text()
    assert [row for row in rows(path) if row[0] == "§0"] == [
        ("§0", "odd", "five"),
        ("§0", "two and two make four", "five (no longer agrees)"),
    ]
    assert "old" not in once
    assert once.startswith("before\n<!-- claims: errors -->\n| where")
    write_text(path, reproduction.with_tables(path, [broken, replace(broken, report="odd", known=Verdict.DIFFERS)]))
    assert path.read_text() == once
    path.write_text("no marks")
    for wrong, sentence in ((path, "has no place for the claims"), (tmp_path / "none.md", "does not exist")):
        with pytest.raises(ClunkError, match=sentence):
            write_text(wrong, reproduction.with_tables(wrong, [broken]))


def test_reproduce_writes_every_figure_and_exits_4_when_a_claim_stops_agreeing(tmp_path, monkeypatch, command):
    broken = Claim("§0", "two and two make four", "five", False, Verdict.AGREES)
    monkeypatch.setattr(claims, "claims", lambda _evidence: [broken])
    monkeypatch.setattr(reproduction, "figures", lambda e: {"figure_3_1": _figures(e)["figure_3_1"]})
    code, out, err = command("reproduce", "-o", tmp_path, "--coarsen", "10")
    assert code == 4
    assert "five" in out
    assert "1 of 1 claims no longer agree" in err
    (record,) = json.loads((tmp_path / "claims.json").read_text())
    assert record["verdict"] == "differs"
    assert (tmp_path / "figure_3_1.png").stat().st_size > 10_000
    assert (tmp_path / "restitution.h5").exists()


_figures = reproduction.figures


def test_every_figure_of_the_report_is_among_those_that_reproduce_draws(evidence):
    """They are all drawn where the README's command is run."""
    assert {f"figure_3_{k}" for k in range(1, 8)} | {"table_4_1"} <= reproduction.figures(evidence).keys()


# --- the linear view


def test_periods_in_the_envelope_pass_a_half_at_each_threshold(nominal):
    damping_ratio = Driveline.from_study(nominal).modes(closed=True).damping_ratio[0]
    for n, ratio in enumerate(one_mode_thresholds(nominal), start=1):
        assert periods_in_envelope(ratio, damping_ratio) == pytest.approx(n - 0.5, rel=1e-12)


def test_thresholds_of_random_chains_are_where_the_locked_model_gains_an_impact():
    rng = np.random.default_rng(5)
    checked = 0
    for _ in range(12):
        n = int(rng.integers(2, 6))
        lash = int(rng.integers(1, n))
        ends = [(k, k + 1) for k in range(1, n) if k != lash] + [(n, "ground")]
        shafts = [(*pair, 10 ** rng.uniform(0.5, 2.5), 10 ** rng.uniform(-2.5, -1.0)) for pair in ends]
        inertias = tuple(10 ** rng.uniform(-3, -1, n))
        chain = reference.Plant(
            inertias, shafts, (lash, lash + 1), backlash=0.0, acceleration_of=1, restitution=0.5, after=-1.0
        )
        study = reference.study_of(chain, "rk4", 2e-4, 20.0)
        thresholds = rigid_contact_thresholds(study, 4)
        thresholds = thresholds[thresholds < 50.0]
        for k, (low, high) in enumerate(pairwise(thresholds), start=1):
            if high / low > 1.002:  # halfway between two that are apart
                run = simulate(replace_values(study, {"load.initial_torque": -1.0 - float(np.sqrt(low * high))}))
                assert run.label == f"DS({k})"
                checked += 1
    assert checked >= 20


def test_a_driveline_whose_load_does_not_reach_the_lash_has_no_thresholds():
    plant = reference.Plant((1.0, 1.0), ((1, "ground", 10.0, 0.1),), (1, 2), acceleration_of=1)
    assert rigid_contact_thresholds(reference.study_of(plant, method="rk4")).size == 0


def test_an_impact_appears_at_the_exact_threshold_as_the_gap_vanishes(nominal):
    (first, second, *_) = rigid_contact_thresholds(nominal)
    study = study_from_text('[driveline]\npreset = "boere-2008"\n[lash.contact]\nmodel = "restitution"\n')
    for ratio, below, above in ((first, "NI", "DS(1)"), (second, "DS(1)", "DS(2)")):
        labels = [
            simulate(replace_values(study, {"load.ratio": ratio * factor, "lash.backlash_deg": 0.0})).label
            for factor in (1 - 1e-6, 1 + 1e-6)
        ]
        assert labels == [below, above]
