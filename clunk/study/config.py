"""A config becomes a `Study`: parse, merge preset and overrides, fill in what axes imply, validate, or report.

    text ──parse──▶ document ──preset, --set, axes──▶ whole document ──models, rules──▶ Study

In a `Study` names are resolved to numbers and every default is filled in, so that `to_toml` writes all there is to know
about a run.
"""

import copy
import tomllib
import warnings
from collections.abc import Container, Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

from clunk.study.document import (
    Document,
    FilePath,
    Place,
    assign,
    dotted,
    items_of,
    key_lines,
    parse_override,
    parse_toml,
    read_text,
    value_at,
)
from clunk.study.errors import ClunkWarning, ConfigError, Problem, listing, report, shorten
from clunk.study.keys import PRESETS, validated, with_tuples, wrong_value
from clunk.study.loads import PROFILES, STEP_KEYS, TORQUES, read_trace, uses
from clunk.study.parameters import Names, names_of, parameter_at, place_of
from clunk.study.rules import doubts, varied_tables
from clunk.study.study import Study
from clunk.study.tables import OTHER_UNITS, Finding, is_number, position_of

# Pairs of groups of keys in a table of which only one group may be given. A key and its variant in another unit
# (`OTHER_UNITS`) exclude each other likewise.
_ALTERNATIVES: tuple[tuple[Place, tuple[tuple[str, ...], tuple[str, ...]]], ...] = (
    (("load",), TORQUES),
    (("load",), (("times", "torques"), ("file",))),
    (("sweep", "axes"), (("values",), ("start", "stop", "count", "scale"))),
)


def load_study(path: FilePath, overrides: str | Sequence[str] = ()) -> Study:
    """Load the study of a config file.

    Parameters
    ----------
    path : path of a TOML file
    overrides : str or sequence of str, "load.ratio=7"; the values are TOML, and paths in them begin in the current
        directory

    Raises
    ------
    ConfigError
        Where the file cannot be read, or the config has errors; the text lists all of them.

    Warns
    -----
    ClunkWarning
        Where the file has fewer shafts than its preset, all of which they replace, or where values are allowed but
        implausible (`clunk.study.rules.doubts`).

    Examples
    --------
    >>> import clunk
    >>> clunk.load_study("configs/smoke.toml", ["load.static_torque=-2.0"])
    <clunk.Study 'Smoke test: a coarse Figure 3.4'>
      driveline  4 inertias, 4 shafts
      lash 1     between 3 and 4
      contact    indentation
      load       step on inertia 1
      solver     rk4, to 2 s
      swept      load.ratio: 0 to 10, 21 values
      swept      lash.backlash_deg: 0 to 20, 21 values
    """
    return study_from_text(read_text(path), str(path), overrides, Path(path).parent)


def study_from_text(
    text: str, source: str = "<text>", overrides: str | Sequence[str] = (), folder: FilePath = "."
) -> Study:
    """Load the study of a config that is given as TOML text, with the errors and warnings of `load_study`.

    Parameters
    ----------
    text : TOML
    source : name of the text in a report
    overrides : str or sequence of str, "load.ratio=7"
    folder : path, to which paths of files in the text are relative; those in overrides are relative to the current
        directory

    Examples
    --------
    >>> import clunk
    >>> clunk.study_from_text('driveline.preset = "boere-2008"').load.ratio
    5.0
    """
    raw = parse_toml(text, source)
    assignments: dict[Place, Any] = {}
    malformed = []
    for override in [overrides] if isinstance(overrides, str) else overrides:
        try:
            place, value = parse_override(override)
        except ValueError as error:
            malformed.append(Problem(shorten(override), None, str(error), override=True))
        else:
            assignments.pop(place, None)  # of several overrides of a key the last one counts
            assignments[place] = value
    preset_name, preset, findings = _preset(raw, assignments)
    document = _merged(preset, raw)
    _unwrap_lash(document)
    file = ("load", "file")
    findings += _load_trace(document, folder) if file not in assignments else []
    assigned: list[Place] = []
    # load.file comes first, since other overrides may set items of the lists that are read from it
    for place, value in sorted(assignments.items(), key=lambda item: item[0] != file):
        known = names_of(document)
        resolved = place_of(dotted(place), known)
        _displace(document, resolved or place, value, kept={*assignments, *assigned})
        if resolved is None or not assign(document, resolved, value):
            named = [name for key, items in known.items() if dotted(place).startswith(key) for name in items if name]
            by_name = f", or by name: {listing([*map(shorten, named)])}" if named else ""
            findings.append((place, f"there is no such place; items of a list go by their number from 1{by_name}"))
        assigned.append(resolved or place)
        findings += _load_trace(document, ".") if place == file else []
        _unwrap_lash(document)
    if isinstance(document.get("driveline"), dict):
        document["driveline"].pop("preset", None)
    findings += _fill_in(document, assigned)
    study, wrong = validated(Study, with_tuples(document))
    findings += wrong
    if study is not None and not findings and not malformed:
        of_file = raw.get("load", {}) if ("load", "profile") not in assignments else {}
        given = {*of_file, *(place[1] for place in assignments if place[:1] == ("load",) and len(place) > 1)}
        for doubt in doubts(study, given):
            warnings.warn(doubt, ClunkWarning, stacklevel=2)
        return study
    lines, problems = key_lines(text), {}
    for place, finding in findings:
        if any(place[:k] in problems for k in range(1, len(place) + 1)):
            continue  # a later finding at or below a place follows from the first one there
        is_new = value_at(raw, place) is None
        is_set = any(
            place[: len(target)] == target or (is_new and target[: len(place)] == place)
            for target in (*assignments, *assigned)
        )
        is_of_preset = is_new and not is_set and value_at(preset, place) == value_at(document, place) is not None
        line = next((lines[place[:k]] for k in range(len(place), 0, -1) if place[:k] in lines), None)
        message = finding + f" (the value is that of preset {shorten(preset_name)})" * is_of_preset
        problems[place] = Problem(dotted(place), None if is_set else line, message, override=is_set)
    raise report(source, [*problems.values(), *malformed])


def _preset(raw: Document, assignments: Mapping[Place, Any]) -> tuple[str, Document, list[Finding]]:
    """Name, tables and findings of the preset; empty without a preset.

    The tables lack the keys that the file replaces by alternative ones, such as gap_mm for backlash_deg.
    """
    place = ("driveline", "preset")
    name = assignments.get(place, value_at(raw, place))
    if name is None:
        return "", {}, []
    findings: list[Finding] = []
    if name not in PRESETS:
        findings.append((place, wrong_value(place, name)))
        name = PRESETS[0]  # so that the rest of the file can be checked
    preset = _read_preset(name)
    _warn_of_fewer_shafts(name, preset, raw)
    swept = [str(axis.get("parameter")).removeprefix("load.") for at, axis in varied_tables(raw) if at[1] == "axes"]
    of_file = [(table, key) for table in ("load", "lash") if isinstance(raw.get(table), dict) for key in raw[table]]
    for at in (*of_file, *(("load", key) for key in swept)):
        _displace(preset, at)
    profile: Place = ("load", "profile")
    word = assignments.get(profile, value_at(raw, profile))
    _displace(preset, profile, word)
    if isinstance(word, str) and word in PROFILES:  # drop what only the preset's profile uses
        preset["load"] = {key: value for key, value in preset["load"].items() if uses(word, key) or key == "profile"}
    if items_of(assignments.get(("lash",), raw.get("lash"))):  # an array of lashes replaces the preset's
        preset.get("impacts", {}).pop("acceleration_of", None)
    return name, preset, findings


def _read_preset(name: str) -> Document:
    """Tables of a preset, merged into those of the base preset that it names, if any."""
    tables = tomllib.loads(files("clunk.study.presets").joinpath(f"{name}.toml").read_text(encoding="utf-8"))
    base = tables["driveline"].pop("preset", None)
    return tables if base is None else _merged(_read_preset(base), tables)


def _warn_of_fewer_shafts(name: str, preset: Document, raw: Document) -> None:
    """Warn of a file with fewer shafts than its preset: they replace all of these, and do not add to or change them.

    A file that gives inertias, lash.between or an array of lashes describes another driveline, and gets no warning.
    """
    shafts, of_preset = items_of(value_at(raw, ("driveline", "shafts"))), preset["driveline"]["shafts"]
    topology = (("driveline", "inertias"), ("lash", "between"), ("lash", 0))
    if 0 < len(shafts) < len(of_preset) and all(value_at(raw, place) is None for place in topology):
        text = f"the file's [[driveline.shafts]] replace all {len(of_preset)} shafts of preset {shorten(name)}"
        hint = "--set 'driveline.shafts[1].stiffness=900', for example, changes one of them"
        warnings.warn(f"{text}; {hint}", ClunkWarning, stacklevel=4)


def _displace(document: Document, place: Place, value: Any = None, kept: Container[Place] = ()) -> None:
    """Remove the keys of a document that a key of a later layer (file, override) replaces, such as its other unit.

    place, value : of the key in the later layer
    kept : places that stay although they are replaced: validation then refuses both keys
    """
    names = STEP_KEYS if (place, value) == (("load", "profile"), "table") else _alternatives(place)
    table = value_at(document, place[:-1])
    for name in names if isinstance(table, dict) else ():
        if (*place[:-1], name) not in kept:
            table.pop(name, None)


def _alternatives(place: Place) -> list[str]:
    """Names of the keys in a key's table that may be given instead of it: another unit, the other torques and so on."""
    *table, name = place
    at = tuple(step for step in table if isinstance(step, str))
    pairs = [pair for pattern, pair in _ALTERNATIVES if pattern == at]
    pairs += [((one,), (other,)) for one, other in OTHER_UNITS.items()]
    return [other for pair in pairs for one, two in (pair, pair[::-1]) if name in one for other in two]


def _merged(preset: Document, raw: Document) -> Document:
    """Tables of a preset overridden by those of a file, key by key; a list of the file replaces the whole list."""
    merged = dict(preset)
    for key, value in raw.items():
        below = merged.get(key)
        is_table = isinstance(below, dict) and isinstance(value, dict)
        merged[key] = _merged(preset[key], value) if is_table else copy.deepcopy(value)
    return merged


def _unwrap_lash(document: Document) -> None:
    """Replace an array of one lash by its table, so that keys are `lash.radius`, and not `lash[1].radius`."""
    if len(lashes := items_of(document.get("lash"))) == 1:
        document["lash"] = lashes[0]


def _load_trace(document: Document, folder: FilePath) -> list[Finding]:
    """Replace `load.file` by times and torques of that trace, and return findings on the file.

    Beside times or torques the key stays, to be refused by validation.
    """
    load: Any = document.get("load")
    file = value_at(load, ("file",))
    if not isinstance(file, str) or load.keys() & {"times", "torques"}:
        return []
    try:
        load["times"], load["torques"] = read_trace(Path(folder, file))
    except ConfigError as error:
        return [(("load", "file"), str(error).rstrip("."))]
    del load["file"]
    return []


def _fill_in(document: Document, assigned: Sequence[Place]) -> list[Finding]:
    """Fill in values that a document implies: those of swept keys without a default, and the severity's inertia.

    The inertia of the severity is filled in for a single lash only. The load profile "tip-out" becomes "step". Names in
    the parameters of sweep, fit and optimisation become numbers, and so do names of inertias among an axis's values.
    Returns findings on these parameters.

    assigned : keys that were set on the command line, which no axis may sweep
    """
    findings = []
    profile = str(value_at(document, ("load", "profile")) or "step")
    if profile == "tip-out":
        profile = document["load"]["profile"] = "step"
    names, optimize = names_of(document), value_at(document, ("optimize",))
    inertias = names["driveline.inertias"]
    for table, key in ((optimize, "minimize"), *((entry, "parameter") for _, entry in varied_tables(document))):
        if isinstance(table, dict) and key in table:
            table[key] = _numbered(table[key], names)
    if isinstance(document.setdefault("impacts", {}), dict) and not items_of(document.get("lash")):
        ends = items_of(value_at(document, ("lash", "between")))
        first_end = next((end for end in ends if type(end) is int or end in inertias), 1)
        document["impacts"].setdefault("acceleration_of", first_end)
    for at, entry in varied_tables(document):
        parameter = entry.get("parameter")
        if not isinstance(parameter, str):
            continue
        try:
            place, known = parameter_at(parameter, document)
        except ConfigError as error:
            findings.append(((*at, "parameter"), str(error)))
            continue
        instead = [(*place[:-1], name) for name in _alternatives(place)]
        if place[-1] == "radius" and value_at(document, (*place[:-1], "gap_mm")) is not None:
            text = f"{parameter} changes the angle of its gap_mm; give its backlash_deg to sweep or draw it"
            findings.append(((*at, "parameter"), text))
        if at[1] != "axes":
            continue
        if known.whole and items_of(entry.get("values")):
            numbers: list[Any] = []
            for k, value in enumerate(entry["values"]):
                try:
                    is_name = isinstance(value, str)
                    numbers.append(position_of(value, len(inertias), inertias, "inertia") + 1 if is_name else value)
                except ValueError as error:
                    findings.append(((*at, "values", k), str(error)))
            entry["values"] = numbers or [1]  # unknown names are already among the findings
        text = f"{dotted(at)} sweeps {parameter}: set the axis's values, or, of one run, choose one by --at"
        set_instead = instead if place[0] == "lash" else []  # else `complaint` reports the axis
        findings += [(each, text) for each in (place, *set_instead) if each in assigned]
        is_missing = not any(value_at(document, each) is not None for each in (place, *instead))
        is_needed = is_missing and not known.is_optional and isinstance(place[-1], str)
        if is_needed and (place[0] != "load" or uses(profile, str(place[-1]))):  # else `complaint` reports it
            # the axis's first value if it is allowed, else 1: errors of the axis itself are reported elsewhere
            first: Any = next(iter(items_of(entry.get("values"))), entry.get("start"))
            assign(document, place, first if is_number(first) and known.allows(first) and not known.whole else 1)
    return findings


def _numbered(parameter: Any, names: Names) -> Any:
    """A dotted key, or each of a list, with item names replaced by numbers; malformed and unknown keys unchanged."""
    if isinstance(parameter, list):
        return [_numbered(each, names) for each in parameter]
    place = place_of(parameter, names) if isinstance(parameter, str) else None
    return parameter if place is None else dotted(place)
