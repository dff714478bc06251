"""The config: TOML in, a validated and frozen `Study` out; or a report of everything that is wrong with it.

    text ──parse──▶ document ──preset, --set──▶ resolved document ──rules, types──▶ Study

In a `Study` names are resolved to numbers and every default is filled in, so that `to_toml` writes all there is to know
about a run.

What may be swept and replaced: every key that measures something (those with a `Quantity` in `configmodels`), by its
dotted name, items of a list by number from 1 (an inertia by its name, too: ``driveline.inertias[ring]``). The loaded
inertia and the inertia of the severity are among them, by number. ``solver.max_events`` is not: it is a limit, not
physics. Neither are the ends of shafts and lash: another topology is another study.
"""

import copy
import difflib
import functools
import hashlib
import json
import tomllib
import unicodedata
from collections.abc import Iterable, Mapping, Sequence
from importlib.resources import files
from os import PathLike
from typing import Any, TypeVar

import tomli_w
from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from clunk.study.configfile import (
    ConfigError,
    KeyLines,
    Place,
    Problem,
    dotted,
    nearest,
    parse_override,
    parse_toml,
    read_text,
    report,
    shorten,
)
from clunk.study.configmodels import (
    Axis,
    Contact,
    Draw,
    DrivelineConfig,
    Impacts,
    Lash,
    Load,
    Sampling,
    Shaft,
    Solver,
    Study,
    Sweep,
    schema,
)
from clunk.study.configrules import (
    ITEM,
    RATIO_TORQUES,
    STEP_TORQUES,
    Finding,
    Key,
    Quantity,
    axes_of,
    draws_of,
    findings,
    first_value,
    items_of,
    key_at,
    number,
    number_of,
    parameter_complaint,
    place_of,
    references,
    sweep_findings,
    value_at,
    with_value,
)

__all__ = [
    "PRESETS",
    "Axis",
    "ConfigError",
    "Contact",
    "Draw",
    "DrivelineConfig",
    "Impacts",
    "Lash",
    "Load",
    "Problem",
    "Quantity",
    "Sampling",
    "Shaft",
    "Solver",
    "Study",
    "Sweep",
    "content",
    "digest",
    "get_value",
    "load_study",
    "quantity",
    "replace_values",
    "study_from_text",
    "to_toml",
]

PRESETS = ("boere-2008", "boere-2008-as-printed")

Model = TypeVar("Model", bound=BaseModel)


# --- A config file -> Study ------------------------------------------------------------------------------------------


def load_study(path: str | PathLike[str], overrides: Sequence[str] = ()) -> Study:
    """The study of a config file.

    Parameters
    ----------
    path : path of a TOML file
    overrides : sequence of str, "load.ratio=7"; the values are TOML

    Raises
    ------
    ConfigError
        With everything that is wrong.

    Examples
    --------
    >>> import clunk
    >>> clunk.load_study("configs/smoke.toml", ["load.static_torque=-2.0"])
    <clunk.Study 'Smoke test: a coarse Figure 3.4'>
      driveline  4 inertias, 4 shafts
      backlash   between 3 and 4: swept
      contact    indentation, separation by gap
      load       tip-out on inertia 1: Ts = -2 N m, σr swept
      solver     rk4, step 0.0002 s, to 2 s
      swept      load.ratio: 0 to 10, 21 values
      swept      lash.backlash_deg: 0 to 20, 21 values
    """
    return study_from_text(read_text(path), str(path), overrides)


def study_from_text(text: str, source: str = "<text>", overrides: Sequence[str] = ()) -> Study:
    """The study of a config's text; `source` is what to call it in a report. As `load_study` otherwise.

    Examples
    --------
    >>> import clunk
    >>> clunk.study_from_text('driveline.preset = "boere-2008"').load.ratio
    5.0
    """
    return _Resolution(parse_toml(text, source), overrides).study(source, text)


class _Resolution:
    """From what a file and the command line say to the whole config, collecting what is wrong on the way."""

    def __init__(self, raw: dict[str, Any], overrides: Sequence[str]) -> None:
        self._found: list[tuple[Place, str]] = []
        self._malformed: list[Problem] = []
        self._implied: set[Place] = set()  # places that this class fills in: their errors follow from another one
        self._raw = raw
        self._preset_name, self._preset = "", dict[str, Any]()
        self._assigned: dict[Place, Any] = {}
        self._set: list[Place] = []  # where the assignments went, names resolved
        for override in overrides:
            self._parse(override)
        self.document: dict[str, Any] = {}

    def study(self, source: str, text: str) -> Study:
        """The study, or a ConfigError with everything that has been found."""
        self._expand_preset()
        for place, value in self._assigned.items():
            self._assign(place, value)
        if isinstance(self.document.get("driveline"), dict):
            self.document["driveline"].pop("preset", None)
        self._stand_in_for_swept_keys()
        self._resolve_names()
        self._find(findings(self.document))
        self._find(sweep_findings(self.document, schema()))
        self._refuse_setting_a_swept_key()
        self._check_text()
        study, wrong = _validated(Study, self.document, ())
        self._find((place, message) for place, message in wrong if place not in self._implied)
        if study is not None and not self._found and not self._malformed:
            return study
        if not self._found and not self._malformed:
            self._find(wrong)
        lines = KeyLines(text)
        raise report(
            source, [*(self._problem(place, message, lines) for place, message in self._found), *self._malformed]
        )

    def _find(self, found: Iterable[Finding]) -> None:
        """One finding a place: the first says what is wrong, a second would follow from it."""
        known = {place for place, _ in self._found}
        for place, message in found:
            if all(place[:k] not in known for k in range(1, len(place) + 1)):
                known.add(place)
                self._found.append((place, message))

    def _problem(self, place: Place, message: str, lines: KeyLines) -> Problem:
        for assigned in [*self._assigned, *self._set]:
            is_inside = place[: len(assigned)] == assigned
            is_made = assigned[: len(place)] == place and value_at(self._raw, place) is None
            if is_inside or (is_made and place not in {("load",), ("lash",), ("driveline",)}):
                return Problem(dotted(place), None, message, override=True)
        if value_at(self._preset, place) is not None and value_at(self._raw, place) is None:
            message += f" (the value is that of preset {shorten(self._preset_name)})"
        return Problem(dotted(place), lines.find(place), message)

    def _parse(self, override: str) -> None:
        try:
            place, value = parse_override(override)
        except ValueError as error:
            self._malformed.append(Problem(shorten(override), None, str(error), override=True))
        else:
            self._assigned.pop(place, None)  # the last one counts, and comes last
            self._assigned[place] = value

    def _expand_preset(self) -> None:
        """What the file leaves out comes from its preset; a list that the file gives replaces the preset's."""
        place: Place = ("driveline", "preset")
        name = value_at(self._raw, place)
        if place in self._assigned:
            name = self._assigned.pop(place)
            self._set.append(place)
        if name is None:
            self.document = copy.deepcopy(self._raw)
            return
        if name not in PRESETS:
            likely = nearest(name, PRESETS) if isinstance(name, str) else None
            hint = f"did you mean {shorten(likely)}? The presets are " if likely else "must be one of "
            listed = ", ".join(shorten(preset) for preset in PRESETS)
            self._found.append((place, f"found {shorten(name)}; {hint}{listed}"))
            name = PRESETS[0]  # so that the rest of the file can be checked
        self._preset_name, preset = name, _preset(name)
        given = {key for key in STEP_TORQUES + RATIO_TORQUES if self._gives(("load", key))}
        swept = [axis.get("parameter") for _, axis in axes_of(self._raw)]
        if given & set(STEP_TORQUES) or all(f"load.{key}" in swept for key in STEP_TORQUES):
            for key in RATIO_TORQUES:
                preset["load"].pop(key)
        self._preset = preset
        self.document = _merged(preset, self._raw)

    def _gives(self, place: Place) -> bool:
        return place in self._assigned or value_at(self._raw, place) is not None

    def _assign(self, place: Place, value: Any) -> None:
        resolved = place_of(dotted(place), self.document)
        if resolved is None:
            self._find([(place, "no inertia has this name")])
            return
        self._set.append(resolved)
        node: Any = self.document
        for k, step in enumerate(resolved[:-1]):
            if isinstance(step, str) and isinstance(node, dict):
                node = node.setdefault(step, {})
            elif isinstance(step, int) and step < len(items_of(node)):
                node = node[step]
            else:
                self._find([(place, self._no_item(resolved[: k + 1]))])
                return
        last = resolved[-1]
        if isinstance(node, dict) if isinstance(last, str) else last < len(items_of(node)):
            node[last] = value
        else:
            self._find([(place, self._no_item(resolved))])

    def _no_item(self, place: Place) -> str:
        around, name = value_at(self.document, place[:-1]), dotted(place[:-1])
        if isinstance(around, list) and isinstance(place[-1], int):
            return f"there is no {dotted(place)}; {name} has {len(around)} items"
        if isinstance(around, list):
            return f"{name} is a list; its items are {name}[1] and so on"
        return f"{name} is no {'list' if isinstance(place[-1], int) else 'table'}"

    def _stand_in_for_swept_keys(self) -> None:
        """A key that an axis sweeps may be left out: the axis's first value takes its place."""
        for _, draw in draws_of(self.document):
            parameter = draw.get("parameter")
            place = place_of(parameter, self.document) if isinstance(parameter, str) else None
            if place is not None:
                draw["parameter"] = dotted(place)
        for _, axis in axes_of(self.document):
            parameter = axis.get("parameter")
            place = place_of(parameter, self.document) if isinstance(parameter, str) else None
            if place is None or parameter_complaint(str(parameter), schema(), self.document):
                continue
            axis["parameter"] = dotted(place)  # an inertia's name in brackets is its number from here on
            if isinstance(place[-1], int) or value_at(self.document, place) is not None:
                continue
            others = {**dict.fromkeys(RATIO_TORQUES, STEP_TORQUES), **dict.fromkeys(STEP_TORQUES, RATIO_TORQUES)}
            if place[0] == "load" and place[1] in others and self._is_given(others[str(place[1])]):
                continue  # it would not apply, as the axis's own error says
            node: Any = self.document
            for step in place[:-1]:
                if isinstance(node, dict):
                    node = node.setdefault(step, {})
                else:
                    node = node[step] if isinstance(step, int) and step < len(items_of(node)) else None
            value = first_value(axis)
            self._implied.add(place)
            if isinstance(node, dict) and value is not None:
                key = key_at(schema(), place)
                node[place[-1]] = int(value) if key is not None and key.whole and value.is_integer() else value

    def _is_given(self, pair: tuple[str, str]) -> bool:
        """Whether the load is given by this pair of torques: one of them is there that no axis put there."""
        return any(
            value_at(self.document, ("load", key)) is not None and ("load", key) not in self._implied for key in pair
        )

    def _resolve_names(self) -> None:
        """Numbers for names, so that nothing downstream sees a name."""
        for place, value, ground in list(references(self.document)):
            is_name = isinstance(value, str) and not (ground and value == "ground")
            found = number_of(self.document, value) if is_name else None
            if found is not None:
                value_at(self.document, place[:-1])[place[-1]] = found
        impacts = self.document.setdefault("impacts", {})
        if isinstance(impacts, dict) and "acceleration_of" not in impacts:
            self._implied.add(("impacts", "acceleration_of"))
            ends = items_of(value_at(self.document, ("lash", "between")))
            first = [end for end in ends if isinstance(end, int)]
            if first:
                impacts["acceleration_of"] = first[0]

    def _refuse_setting_a_swept_key(self) -> None:
        for k, axis in axes_of(self.document):
            for place in self._set:
                if axis.get("parameter") == dotted(place):
                    complaint = f"sweep.axes[{k + 1}] sweeps this key; set the axis instead, "
                    key = "start" if axis.get("values") is None else "values"
                    self._find([(place, f"{complaint}for example sweep.axes[{k + 1}].{key}")])

    def _check_text(self) -> None:
        """Control characters and broken Unicode can be written neither to a terminal nor to a results file."""
        names = enumerate(items_of(value_at(self.document, ("driveline", "names"))))
        texts: list[tuple[Place, Any]] = [(("title",), self.document.get("title"))]
        texts += [(("driveline", "names", k), name) for k, name in names]
        for place, text in texts:
            if isinstance(text, str) and any(unicodedata.category(c) in {"Cc", "Cs"} for c in text):
                self._find([(place, f"found {shorten(text)}; must be text on one line")])


def _merged(preset: dict[str, Any], given: dict[str, Any]) -> dict[str, Any]:
    merged = dict(preset)
    for key, value in given.items():
        below = merged.get(key)
        merged[key] = (
            _merged(below, value) if isinstance(below, dict) and isinstance(value, dict) else copy.deepcopy(value)
        )
    return merged


def _preset(name: str) -> dict[str, Any]:
    return tomllib.loads(files("clunk.study.presets").joinpath(f"{name}.toml").read_text(encoding="utf-8"))


# --- Types and ranges: pydantic's errors as sentences ----------------------------------------------------------------


def _validated(model: type[Model], document: Any, at: Place) -> tuple[Model | None, list[Finding]]:
    """The model of what stands at a place of a document, or what is wrong with it."""
    try:
        return model.model_validate(_with_tuples(document)), []
    except ValidationError as error:
        errors = [(tuple(at) + tuple(e["loc"]), e) for e in error.errors(include_url=False)]
    wrong: list[Finding] = []
    guessed: set[Place] = set()
    for place, detail in errors:
        if detail["type"] == "extra_forbidden":
            likely = _likely_key(place)
            guessed.add(likely or ())
            wrong.append((place, _unknown_key(place, likely)))
        elif detail["type"] == "clunk_rules":
            wrong += detail["ctx"]["findings"]
    for place, detail in errors:
        # one mistake, one error: a misspelt key is not missing too, nor a list of wrong items too short
        follows = place in guessed or (detail["type"] == "too_short" and bool(detail["input"]))
        if detail["type"] not in {"extra_forbidden", "clunk_rules"} and not follows:
            wrong.append((place, _type_message(place, detail)))
    return None, wrong


def _with_tuples(node: Any) -> Any:
    """Lists as tuples: strict models take no lists for tuples."""
    if isinstance(node, dict):
        return {key: _with_tuples(value) for key, value in node.items()}
    return tuple(_with_tuples(item) for item in node) if isinstance(node, list | tuple) else node


def _likely_key(place: Place) -> Place | None:
    """The key that an unknown one was meant to be: a neighbour, or one of that name in another table."""
    around = key_at(schema(), place[:-1])
    name, table = str(place[-1]), place[:-1]
    known = [] if around is None else [*around.children, *(["preset"] if table == ("driveline",) else [])]
    near = nearest(name, known)
    homes = [pattern for pattern in [("driveline", "preset"), *schema()] if len(pattern) > 1 and pattern[-1] != ITEM]
    far = nearest(name, [str(pattern[-1]) for pattern in homes])
    if far is not None and _likeness(name, far) > max(0.75, _likeness(name, near or "")):
        # of several tables that have such a key, the one below this table
        return max((home for home in homes if home[-1] == far), key=lambda home: home[: len(table)] == table)
    return None if near is None else (*table, near)


def _likeness(name: str, other: str) -> float:
    return difflib.SequenceMatcher(None, name[:100], other).ratio()


def _unknown_key(place: Place, likely: Place | None) -> str:
    if likely is None:
        around = key_at(schema(), place[:-1])
        return f"unknown key; allowed here: {', '.join(around.children) if around is not None else 'none'}"
    if likely[:-1] == place[:-1]:
        return f"unknown key; did you mean {shorten(likely[-1])}?"
    table = dotted(tuple(step for step in likely[:-1] if step != ITEM))
    return f"unknown key; did you mean {shorten(likely[-1])} in {f'[[{table}]]' if ITEM in likely else f'[{table}]'}?"


def _type_message(place: Place, detail: ErrorDetails) -> str:
    key = key_at(schema(), place)
    must_be = key.must_be if key is not None else detail["msg"].lower()
    if detail["type"] == "missing":
        if place == ("driveline",):
            return f"missing; give driveline.preset ({' or '.join(PRESETS)}), or inertias and shafts"
        return (
            f"missing; a config needs the table [{dotted(place)}]"
            if key and key.children
            else f"missing; must be {must_be}"
        )
    found = detail["input"]
    if detail["type"] == "finite_number":
        must_be = must_be.replace("a number", "a finite number")
    if key is not None and key.choices and isinstance(found, str):
        likely = nearest(found, key.choices)
        return f"found {shorten(found)}; must be {must_be}" + (f"; did you mean {shorten(likely)}?" if likely else "")
    return f"found {shorten(found)}; must be {must_be}"


# --- Study -> values, text, digest -----------------------------------------------------------------------------------


def quantity(parameter: str) -> Quantity:
    """What a parameter measures; the unit is one that udunits reads.

    Raises
    ------
    ConfigError
        Where there is no such parameter.
    """
    place = place_of(parameter, {})
    key = None if place is None else key_at(schema(), place)
    if place is None or key is None or key.quantity is None:
        document = {"driveline": {"inertias": [1.0], "shafts": [{}]}}
        raise _refusal(parameter, parameter_complaint(parameter, schema(), document))
    item = next((step + 1 for step in place if isinstance(step, int)), "")
    found = key.quantity
    return Quantity(found.name.format(item), found.symbol.format(item), found.unit)


def get_value(study: Study, parameter: str) -> float:
    """The value of a parameter, in its own unit.

    Raises
    ------
    ConfigError
        Where there is no such parameter, or it has no value in this study.
    """
    place, _ = _parameter(study, parameter)
    value: Any = study
    for step in place:
        value = value[step] if isinstance(step, int) else getattr(value, step)
    if value is None:
        raise _refusal(parameter, "has no value in this study")
    return float(value)


def replace_values(study: Study, values: Mapping[str, float]) -> Study:
    """The study with other values, each in its parameter's unit; its sweep is left alone.

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
    sections: dict[str, Any] = {}
    wrong: list[Finding] = []
    for parameter, value in values.items():
        place, key = _parameter(study, parameter)
        section = str(place[0])
        if section not in sections:
            sections[section] = getattr(study, section).model_dump()
        plain = number(value)
        if plain is not None and key.whole:
            plain = int(plain) if plain.is_integer() else plain
        sections[section] = with_value(sections[section], place[1:], value if plain is None else plain)
    models: dict[str, Any] = {}
    for section, content in sections.items():
        models[section], found = _validated(type(getattr(study, section)), content, (section,))
        wrong += found
    if not wrong:
        replaced = study.model_copy(update=models)
        wrong = list(findings({name: getattr(replaced, name).model_dump() for name in _RULED}))
        if not wrong:
            return replaced
    raise report("the study with these values", [Problem(dotted(place), None, message) for place, message in wrong])


_RULED = ("driveline", "lash", "load", "solver", "impacts")


def to_toml(study: Study) -> str:
    """The whole config: preset expanded, names resolved, defaults filled in. Loading it gives an equal study."""
    return tomli_w.dumps(content(study))


def content(study: Study) -> dict[str, Any]:
    """A study as plain tables, lists and values, without what is left out."""
    plain = study.model_dump(exclude_none=True)
    if study.sweep is not None:
        sweep = {key: value for key, value in plain["sweep"].items() if value != ()}
        if not {"samples", "tolerances"} & set(sweep):
            sweep.pop("sampling")
        plain["sweep"] = sweep
    return plain


def digest(study: Study) -> str:
    """SHA-256 of everything that decides the results: physics, solver and sweep; neither the title nor names.

    A swept key's own value does not count, since no cell has it.
    """
    decisive = content(study)
    del decisive["title"]
    decisive["driveline"].pop("names", None)
    if study.sweep is not None and study.sweep.design == "grid":
        del decisive["sweep"]["design"]  # sweeps of earlier versions know no other
    for axis in study.sweep.axes if study.sweep is not None else ():
        decisive = with_value(decisive, _parameter(study, axis.parameter)[0], None)
    canonical = json.dumps(_without_signed_zeros(decisive), sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(canonical.encode("utf-8")).hexdigest()


def _without_signed_zeros(node: Any) -> Any:
    if isinstance(node, dict):
        return {key: _without_signed_zeros(value) for key, value in node.items()}
    if isinstance(node, list | tuple):
        return [_without_signed_zeros(item) for item in node]
    return node + 0.0 if isinstance(node, float) else node


def _parameter(study: Study, parameter: str) -> tuple[Place, Key]:
    """The place of a parameter in a study."""
    place = _place(parameter, study.driveline.names)
    key = None if place is None else key_at(schema(), place)
    if place is None or key is None or key.quantity is None or not _has_item(study.driveline, place):
        raise _refusal(parameter, parameter_complaint(parameter, schema(), study.model_dump()))
    return place, key


def _has_item(driveline: DrivelineConfig, place: Place) -> bool:
    """Whether the inertia or shaft is there, if the place lies in one."""
    items = [step for step in place if isinstance(step, int)]
    return all(item < len(getattr(driveline, str(place[1]))) for item in items)


@functools.lru_cache(maxsize=1024)
def _place(parameter: str, names: tuple[str, ...] | None) -> Place | None:
    return place_of(parameter, {"driveline": {"names": names or ()}})


def _refusal(parameter: str, message: str | None) -> ConfigError:
    message = message or "is no quantity"
    return ConfigError(f"{parameter}: {message}", [Problem(parameter, None, message)])
