"""Fits as text for 80 columns and as records for JSON."""

from __future__ import annotations

from collections.abc import Iterator

from clunk.analysis.fitruns import label_of
from clunk.analysis.fitted import UNDETERMINED, Fitted
from clunk.cli import phrases


def report(fitted: Fitted) -> Iterator[str]:
    """A fit as lines for 80 columns."""
    yield from _labels_met(fitted)
    yield ""
    yield from _parameters(fitted)
    yield ""
    yield from _predictions(fitted)
    yield ""
    yield from _not_met(fitted)


def _labels_met(fitted: Fitted) -> Iterator[str]:
    count = len(fitted.points)
    met, before = fitted.met, fitted.hits(fitted.nominal_matches["pattern"])
    yield f"labels met      {met} of {count} by the best candidate; {before} by the config as it is"
    pairs = zip(fitted.probabilities, fitted.experiment.measurements, strict=True)
    likely = sum(next(iter(shares)) == measurement.label for shares, measurement in pairs)
    yield f"                {likely} of {count} are the most probable label of the ensemble"
    yield f"ensemble        {len(fitted.weights):,} draws, effectively {fitted.effective:.0f}"


def _parameters(fitted: Fitted) -> Iterator[str]:
    rows = [["parameter", "", "estimate", "5 %", "95 %", "prior 5 %", "95 %"]]
    for prior, estimate, interval, before in zip(
        fitted.priors, fitted.estimate, fitted.intervals(), fitted.prior_intervals(), strict=True
    ):
        numbers = [f"{number:.4g}" for number in (estimate, *interval, *before)]
        rows.append([prior.parameter, prior.draws, *numbers])
    yield from phrases.table(rows, [False, False] + [True] * 5)
    yield from _undetermined(fitted)


def _undetermined(fitted: Fitted) -> Iterator[str]:
    spreads, directions = fitted.combinations
    for spread, direction in zip(spreads, directions, strict=True):
        if spread >= UNDETERMINED:
            largest = direction[abs(direction).argmax()]
            parts = [
                f"{share * (1.0 if largest > 0.0 else -1.0):+.2f} {prior.parameter}"
                for share, prior in zip(direction, fitted.priors, strict=True)
                if abs(share) > 0.2 * abs(largest)
            ]
            left = f"{spread:.0%} of the prior's spread is left"
            text = f"undetermined: {' '.join(parts)} (in the priors' standard deviations), {left}"
            yield phrases.fill(text, "  ", "    ")


def _predictions(fitted: Fitted) -> Iterator[str]:
    count = len(fitted.points)
    rows = [["left out at a time", "predicted", "most frequent", "nearest", "effective draws"]]
    for each in fitted.predictions:
        hits = [str(fitted.hits(labels)) for labels in (each.predicted, each.majority, each.nearest)]
        left_out = "a measurement" if each.left_out == "measurement" else f"a value of {each.left_out}"
        rows.append([left_out, *hits, f"{each.effective:.0f}"])
    yield f"labels predicted from the other measurements, of {count}"
    yield from phrases.table(rows, [False] + [True] * 4)
    if fitted.fewer:
        yield ""
        yield "fits of fewer parameters, the others as in the config"
        rows = [["parameters", "most met", "predicted", "effective draws"]]
        for few in fitted.fewer:
            rows.append([str(few.parameters), str(few.met), str(few.predicted), f"{few.effective:.0f}"])
        yield from phrases.table(rows, [True] * 4)


def _not_met(fitted: Fitted) -> Iterator[str]:
    """Measurements that the best candidate does not meet, and what would have to change."""
    if not fitted.reasons:
        yield "The best candidate meets all labels."
        return
    yield "not met by the best candidate"
    for k, reason in fitted.reasons.items():
        measurement, match = fitted.experiment.measurements[k], fitted.estimate_matches[k]
        at = ", ".join(f"{axis} = {value:g}" for axis, value in zip(fitted.axes, measurement.values, strict=True))
        nobody = "" if fitted.best_distances[k] == 0.0 else "; no candidate meets it"
        computed = label_of(int(match["pattern"]))
        yield phrases.fill(f"{at}: measured {measurement.label}, computed {computed}{nobody}", "  ", "    ")
        yield phrases.fill(reason, "    ", "    ")


def as_record(fitted: Fitted) -> dict[str, object]:
    """A fit for JSON."""
    wanted = fitted.wanted
    return {
        "title": fitted.study.title,
        "measurements": fitted.experiment.name,
        "points": len(wanted),
        "met": fitted.met,
        "met_by_config": fitted.hits(fitted.nominal_matches["pattern"]),
        "candidates": fitted.candidates,
        "draws": len(fitted.weights),
        "effective_draws": fitted.effective,
        "parameters": [
            prior.model_dump(exclude_none=True)
            | {"estimate": float(estimate), "interval": interval.tolist(), "prior_interval": before.tolist()}
            for prior, estimate, interval, before in zip(
                fitted.priors, fitted.estimate, fitted.intervals(), fitted.prior_intervals(), strict=True
            )
        ],
        "combinations": [
            {"spread": float(spread), "direction": direction.tolist()}
            for spread, direction in zip(*fitted.combinations, strict=True)
        ],
        "predictions": [
            {"left_out": each.left_out, "effective_draws": each.effective}
            | {name: fitted.hits(getattr(each, name)) for name in ("predicted", "majority", "nearest")}
            for each in fitted.predictions
        ],
        "fewer": [vars(each) for each in fitted.fewer],
        "measured": [
            {
                "at": dict(zip(fitted.axes, measurement.values, strict=True)),
                "label": measurement.label,
                "computed": label_of(int(match["pattern"])),
                "probabilities": shares,
                "met_by_some": bool(best == 0.0),
            }
            | ({"reason": fitted.reasons[k]} if k in fitted.reasons else {})
            for k, (measurement, match, shares, best) in enumerate(
                zip(
                    fitted.experiment.measurements,
                    fitted.estimate_matches,
                    fitted.probabilities,
                    fitted.best_distances,
                    strict=True,
                )
            )
        ],
        "warnings": fitted.warnings(),
    }
