"""A study: a validated config, the values in it, its whole text and its digest."""

import hashlib
import json
import re
from collections.abc import Callable, Mapping
from functools import wraps
from typing import Any, TypeVar, cast

import tomli_w

from clunk.study.document import Document, dotted, items_of, with_value
from clunk.study.errors import ClunkError, Problem, report
from clunk.study.keys import validated
from clunk.study.models import NOT_OF_A_RUN, Config
from clunk.study.parameters import located, with_values
from clunk.study.records import as_text
from clunk.study.rules import broken_rules
from clunk.study.tables import Findings


class Study(Config):
    """A config that has passed all rules: everything that decides what a run or a sweep computes.

    Made by `load_study`, `study_from_text` and `replace_values`; built by hand, it is held to the same rules.
    """

    def contradictions(self) -> Findings:
        """Require the rules that tie tables to one another; see `clunk.study.rules`."""
        yield from broken_rules(self)

    def __repr__(self) -> str:
        load, solver, sweep = self.load, self.solver, self.swept
        rows = [
            ("driveline", f"{len(self.driveline.inertias)} inertias, {len(self.driveline.shafts)} shafts"),
            *(
                (name, f"between {lash.between[0]} and {lash.between[1]}")
                for name, lash in zip(self.lash_names, self.lashes, strict=True)
            ),
            ("contact", self.lashes[0].contact.model),
            ("load", f"{load.profile} on inertia {load.on}"),
            ("solver", f"{solver.method}, to {solver.end_time:g} s"),
        ]
        rows += [
            ("swept", f"{axis.parameter}: {axis.grid[0]:g} to {axis.grid[-1]:g}, {axis.count_of_values} values")
            for axis in sweep.axes
        ]
        rows += [("drawn", f"{draw.parameter}: {draw.distribution}") for draw in (*sweep.samples, *sweep.tolerances)]
        return as_text(f"clunk.Study {self.title!r}", rows)

    __str__ = __repr__


Function = TypeVar("Function", bound=Callable[..., Any])


def takes_study(function: Function) -> Function:
    """Decorate a function whose first argument is a study: anything else raises a ClunkError."""

    @wraps(function)
    def checked(study: Study, *rest: Any, **options: Any) -> Any:
        if not isinstance(study, Study):
            type_name = type(study).__name__
            raise ClunkError(f"{function.__name__} takes a study, not a {type_name}; clunk.load_study(path) reads one.")
        return function(study, *rest, **options)

    return cast(Function, checked)


@takes_study
def replace_values(study: Study, values: Mapping[str, float]) -> Study:
    """The study with other values of some parameters; its sweep, fit and optimisation stay as they are.

    values : parameter -> value, in its key's unit

    Raises
    ------
    ConfigError
        Where a parameter does not exist, or a value breaks the rules of a config file.

    Examples
    --------
    >>> import clunk
    >>> study = clunk.load_study("configs/nominal.toml")
    >>> [clunk.simulate(clunk.replace_values(study, {"load.ratio": ratio})).label for ratio in (1.0, 2.0, 5.0)]
    ['NI', 'SS(1)', 'DS(1)SS(1)']
    """
    document, _ = with_values(study, values)
    return study_of_document(document).but(**{name: getattr(study, name) for name in NOT_OF_A_RUN})


def study_of_document(document: Document) -> Study:
    """Validate a study given as plain tables, lists and values. Raises ConfigError where they break a rule."""
    study, findings = validated(Study, document)
    if study is None:
        raise report("the study with these values", [Problem(dotted(place), None, text) for place, text in findings])
    return study


def content(study: Study) -> Document:
    """A study as plain tables, lists and values, without keys that are None and empty tuples of the sweep."""
    plain = study.model_dump(exclude_none=True)
    if study.sweep is not None:
        plain["sweep"] = {key: value for key, value in plain["sweep"].items() if value != ()}
    return plain


def to_toml(study: Study) -> str:
    """TOML of the whole config: preset expanded, names resolved, defaults filled in. It loads as an equal study."""
    return tomli_w.dumps(content(study))


def decisive_content(study: Study) -> Document:
    """The part of a study that decides the results: physics, solver, measures and sweep.

    Left out are the title, the tables of a fit and an optimisation, sweep.boundaries, and all names but those of lashes
    and shafts that measures refer to. The config's value of a swept key is None, since no cell has it.
    """
    decisive = content(study)
    del decisive["title"]
    for table in NOT_OF_A_RUN - {"sweep"}:
        decisive.pop(table, None)
    decisive.get("sweep", {}).pop("boundaries", None)
    decisive["driveline"].pop("names", None)
    measured = {each.of for each in study.measures}  # names of lashes and shafts among them
    for named in (*(items_of(decisive["lash"]) or [decisive["lash"]]), *decisive["driveline"]["shafts"]):
        if named.get("name") not in measured:
            named.pop("name", None)
    for axis in study.swept.axes:
        decisive = with_value(decisive, located(study, axis.parameter)[0], None)
    return decisive


def digest(study: Study) -> str:
    """SHA-256 of everything that decides the results."""
    canonical = json.dumps(decisive_content(study), sort_keys=True, separators=(",", ":"), allow_nan=False)
    canonical = re.sub(r"-0\.0(?=[,\]}])", "0.0", canonical)  # zeros are equal, whatever their signs
    return hashlib.sha256(canonical.encode("utf-8")).hexdigest()
