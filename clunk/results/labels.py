"""Labels of sequences of impacts, such as DS(1)SS(2): how they are spelt, and what they count."""

from __future__ import annotations

import re
from itertools import groupby


def double_sided(label: str) -> int:
    """How many double-sided impacts a label has."""
    return sum(int(count) for count in re.findall(r"DS\((\d+)\)", label))


def excursions(label: str) -> int:
    """How many excursions from a flank a label has, of whatever kind."""
    return sum(int(count) for count in re.findall(r"\((\d+)\)", label))


def normalised_label(text: str) -> str:
    """A label in clunk's notation: "D(1)+S(1)" and "DS(1) SS(1)" are DS(1)SS(1), "S(1)+S(1)" is SS(2).

    Raises ValueError where it is none.
    """
    bare = re.sub(r"\s", "", text).upper()
    if bare == "NI":
        return bare
    term = r"(DS|SS|OS|CR|D|S)\(([1-9]\d{0,5})\)"
    if not re.fullmatch(rf"{term}(?:\+?{term})*", bare):
        raise ValueError(f"{text!r} is no label")
    full = {"D": "DS", "S": "SS"}
    terms = [(full.get(kind, kind), int(count)) for kind, count in re.findall(term, bare)]
    runs = groupby(terms, key=lambda run: run[0])
    return "".join(f"{kind}({sum(count for _, count in run)})" for kind, run in runs)
