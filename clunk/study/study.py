"""A study: a validated config, the values in it, its whole text and its digest."""

import hashlib
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import tomli_w

from clunk.study.arrays import Floats
from clunk.study.document import dotted, items_of, with_value
from clunk.study.errors import Problem, report
from clunk.study.keys import validated
from clunk.study.loads import numbers
from clunk.study.models import NOT_OF_A_RUN, Config, Contact, Lash
from clunk.study.parameters import located, plain_number
from clunk.study.records import Rows, as_text, counted
from clunk.study.rules import broken_rules
from clunk.study.tables import Finding


class Study(Config):
    """A config that has passed all rules: everything that decides what a run or a sweep computes.

    Made by `load_study`, `study_from_text` and `replace_values`; built by hand, it is held to the same rules.
    """

    def contradictions(self) -> Iterator[Finding]:
        """Require the rules that tie tables to one another; see `clunk.study.rules`."""
        yield from broken_rules(self)

    def summary(self) -> Rows:
        """Summary of the study for people, as (name, value) pairs."""
        load, solver = self.load, self.solver
        axes = self.sweep.axes if self.sweep is not None else ()
        swept = {axis.parameter for axis in axes}
        models = dict.fromkeys(_model(lash.contact) for lash in self.lashes)
        names = self.lash_names if len(self.lashes) > 1 else ("backlash",)
        joints = zip(names, self.lashes, self.lash_places, strict=True)
        points = [f"{len(load.times)} times and torques"] if load.profile == "table" and load.times else []
        points += [counted(len(load.levels), "level")] if load.profile == "steps" and load.levels else []
        step = f", step {solver.step:g} s" if solver.method == "rk4" else ""
        rows = [
            ("driveline", f"{len(self.driveline.inertias)} inertias, {len(self.driveline.shafts)} shafts"),
            *((name, _gap(lash, dotted((*place, "backlash_deg")) in swept)) for name, lash, place in joints),
            ("contact", "; ".join(models)),
            ("load", f"{load.profile} on inertia {load.on}: {', '.join([*points, *numbers(dict(load), swept)])}"),
            ("solver", f"{solver.method}{step}, to {solver.end_time:g} s"),
        ]
        for axis in axes:
            spread = f"{axis.grid[0]:g} to {axis.grid[-1]:g}, {axis.count_of_values} values"
            rows.append(("swept", f"{axis.parameter}: {spread}"))
        if self.sweep is not None:
            for draw in (*self.sweep.samples, *self.sweep.tolerances):
                rows.append(("drawn", f"{draw.parameter}: {draw.distribution}, {self.sweep.sampling.count} draws"))
        return rows

    def __repr__(self) -> str:
        return as_text(f"clunk.Study {self.title!r}", self.summary())

    __str__ = __repr__


def _model(contact: Contact) -> str:
    if contact.model == "indentation":
        return f"indentation, separation by {contact.separation}"
    return f"restitution, e = {contact.restitution:g}"


def _gap(lash: Lash, is_swept: bool) -> str:
    """Ends, backlash and ratio of a lash for people."""
    ratio = f", ratio {lash.ratio:g}" if lash.ratio != 1.0 else ""
    gap = "swept" if is_swept else f"{lash.backlash_deg:g} degrees"
    return f"between {lash.between[0]} and {lash.between[1]}: {gap}{ratio}"


def replace_values(study: Study, values: Mapping[str, float]) -> Study:
    """The study with other values, each in its parameter's unit; its sweep and fit are left alone.

    Raises
    ------
    ConfigError
        Where a value is not allowed, by the rules of a config file.

    Examples
    --------
    >>> import clunk
    >>> study = clunk.load_study("configs/nominal.toml")
    >>> [clunk.simulate(clunk.replace_values(study, {"load.ratio": ratio})).label for ratio in (1.0, 2.0, 5.0)]
    ['NI', 'SS(1)', 'DS(1)SS(1)']
    """
    document = study.model_dump(exclude=NOT_OF_A_RUN)
    for parameter, value in values.items():
        place, key, _ = located(study, parameter)
        document = with_value(document, place, plain_number(key, value))
    replaced, findings = validated(Study, document)
    if replaced is None:
        raise report("the study with these values", [Problem(dotted(place), None, text) for place, text in findings])
    return replaced.model_copy(update={name: getattr(study, name) for name in NOT_OF_A_RUN})


def refuse_points(study: Study, parameters: Sequence[str], values: Floats) -> None:
    """Refuse values, (points, parameters), of which one is not allowed: the first, as `replace_values` would.

    All are looked at together, by the least and the greatest of each parameter; only where one of these may not be,
    each point by itself.
    """
    ends = zip(parameters, values.min(axis=0).tolist(), values.max(axis=0).tolist(), strict=True) if values.size else ()
    axes = tuple({"parameter": parameter, "values": (least, greatest)} for parameter, least, greatest in ends)
    document = study.model_dump(exclude=NOT_OF_A_RUN)
    if validated(Study, {**document, "sweep": {"design": "zip", "axes": axes}})[0] is None:
        for point in values.tolist():
            replace_values(study, dict(zip(parameters, point, strict=True)))


def content(study: Study) -> dict[str, Any]:
    """A study as plain tables, lists and values, without what has no value."""
    plain = study.model_dump(exclude_none=True)
    if study.sweep is not None:
        plain["sweep"] = {key: value for key, value in plain["sweep"].items() if value != ()}
    return plain


def _lash_tables(plain: Mapping[str, Any]) -> Sequence[dict[str, Any]]:
    return items_of(plain["lash"]) or (plain["lash"],)


def to_toml(study: Study) -> str:
    """TOML of the whole config: preset expanded, names resolved, defaults filled in. Loaded, it is an equal study."""
    return tomli_w.dumps(content(study))


def decisive_content(study: Study) -> dict[str, Any]:
    """The part of a study that decides the results: physics, solver and sweep; not the title, names, lines or a fit.

    A swept key's own value does not count, since no cell has it: it is None.
    """
    decisive = content(study)
    del decisive["title"]
    for table in NOT_OF_A_RUN - {"sweep"}:
        decisive.pop(table, None)
    decisive.get("sweep", {}).pop("boundaries", None)
    decisive["driveline"].pop("names", None)
    for lash in _lash_tables(decisive):
        lash.pop("name", None)
    for shaft in decisive["driveline"]["shafts"]:
        shaft.pop("name", None)
    for axis in study.sweep.axes if study.sweep is not None else ():
        decisive = with_value(decisive, located(study, axis.parameter)[0], None)
    return decisive


def digest(study: Study) -> str:
    """SHA-256 of everything that decides the results."""
    decisive = decisive_content(study)
    canonical = json.dumps(decisive, sort_keys=True, separators=(",", ":"), allow_nan=False)
    canonical = re.sub(r"-0\.0(?=[,\]}])", "0.0", canonical)  # zeros are equal, whatever their signs
    return hashlib.sha256(canonical.encode("utf-8")).hexdigest()
