"""Labels of sequences of impacts, such as DS(1)SS(2): their notation, their order, and the impacts that they count."""

import re
from functools import lru_cache
from itertools import groupby

FAILED = "failed"  # label of a run that failed
FAILED_CODE = -1


def double_sided(label: str) -> int:
    """Number of double-sided impacts in a label."""
    return sum(map(int, re.findall(r"DS\((\d+)\)", label)))


def primary_impacts(label: str) -> int:
    """Number of primary impacts in a label: two for each double-sided excursion, one for any other excursion."""
    return sum(map(int, re.findall(r"\((\d+)\)", label))) + double_sided(label)


@lru_cache(1 << 10)
def label_order(label: str) -> tuple[int, str]:
    """Key by which labels are sorted in files, tables and legends: the number of primary impacts, then the label."""
    return primary_impacts(label), label


def normalised_label(text: str) -> str:
    """Label in clunk's notation: "D(1)+S(1)" and "DS(1) SS(1)" are DS(1)SS(1), "S(1)+S(1)" is SS(2).

    Raises ValueError where the text is no label.
    """
    bare = re.sub(r"\s", "", text).upper()
    if bare == "NI":
        return bare
    term = r"(DS|SS|OS|CR|D|S)\(([1-9]\d{0,5})\)"
    if not re.fullmatch(rf"{term}(?:\+?{term})*", bare):
        raise ValueError(f"{text!r} is no label")
    full = {"D": "DS", "S": "SS"}
    terms = [(full.get(name, name), int(count)) for name, count in re.findall(term, bare)]
    runs = groupby(terms, key=lambda run: run[0])
    return "".join(f"{name}({sum(count for _, count in run)})" for name, run in runs)


def flanks_of_label(text: str) -> tuple[int, ...]:
    """Flanks of the primary impacts of a label in clunk's notation, +1 opposite and -1 initial; none of NI.

    Raises ValueError where no sequence of impacts has that label, as DS(1)OS(1).
    """
    from clunk.core.sequence import INITIAL, OPPOSITE, label  # numba's import takes a third of a second

    of_excursion = {"SS": (INITIAL,), "DS": (OPPOSITE, INITIAL), "OS": (OPPOSITE,), "CR": (OPPOSITE,)}
    terms = re.findall(r"(DS|SS|OS|CR)\((\d+)\)", text)
    flanks = tuple(flank for name, count in terms for flank in of_excursion[name] * int(count))
    if label(flanks) != text:
        raise ValueError(f"no sequence of impacts has the label {text}")
    return flanks
