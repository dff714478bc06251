"""Sliders with boxes to type into, for the values of a map's axes and for other numbers of the config."""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np
from bokeh.models import Column, Div, NumericInput, Row, Select, Slider

from clunk.explorer.figures import WIDE, title_of
from clunk.explorer.subject import Numbers
from clunk.study.axes import RUN, ResultAxis
from clunk.study.designs import is_unused
from clunk.study.keys import Key
from clunk.study.parameters import located, nominal_value, parameters, quantity
from clunk.study.study import Study
from clunk.study.tables import LARGEST_SIZE

# Keys whose sliders come first, in this order, as far as the config has them; a key of `lash` stands for each lash's.
_FIRST = (
    "load.ratio",
    "lash.backlash_deg",
    "load.duration",
    "load.time_constant",
    "lash.contact.stiffness",
    "lash.contact.damping",
    "lash.contact.restitution",
    "driveline.shafts[1].stiffness",
    "load.static_torque",
)
_STEPS = 50  # least number of steps of a slider
_FEWEST = 5  # least number of steps of a slider for whole numbers


def adjustable(study: Study, swept: Sequence[str]) -> Numbers:
    """Key -> nominal value of the numbers of a study that a slider may change, the keys of `_FIRST` first.

    Left out are swept keys, keys without a finite value, and keys that change nothing in the study's contact model.
    """
    values = {key: nominal_value(study, key) for key in parameters(study) if key not in swept}
    known = {key: value for key, value in values.items() if math.isfinite(value) and not is_unused(study, key)}

    def rank(key: str) -> int:
        plain = re.sub(r"^lash\[\d+\]", "lash", key)
        return _FIRST.index(plain) if plain in _FIRST else len(_FIRST)

    return {key: known[key] for key in sorted(known, key=rank)}


def slider_range(value: float, key: Key) -> tuple[float, float, float]:
    """Start, end and step of a slider for a number: from 0 to 2.5 times the value, within the key's bounds.

    For the value 0 it is from 0 to 1. A bound that is itself excluded is missed by a step.
    """
    low, high = sorted((0.0, 2.5 * value)) if value else (0.0, 1.0)
    low, high = max(low, key.lowest), min(high, key.highest)
    step = 10.0 ** math.floor(math.log10((high - low) / _STEPS)) if high > low else 1.0
    if key.whole:
        low, high, step = math.ceil(low), max(math.floor(high), math.ceil(low) + _FEWEST), max(step, 1.0)
    return (low + step if key.above else low), high, step


class Controls:
    """A column of sliders with boxes to type into, for the axes of a map and for numbers of the config.

    axes : each begins at the config's own value if that lies within the axis, otherwise at its middle value
    swept : keys that differ from cell to cell, which have no slider of a number
    on_change : called when the user has changed a value
    shown : how many numbers have sliders at first
    """

    def __init__(
        self, study: Study, axes: Sequence[ResultAxis], swept: Sequence[str], on_change: Callable[[], None], shown: int
    ) -> None:
        self._study, self._on_change, self._is_setting = study, on_change, False
        self._config = adjustable(study, swept)
        self._values: Numbers = {}
        self._changes: dict[str, Callable[[float | None], None]] = {}
        self._more = Select(name="more", **WIDE)
        self._more.on_change("value", lambda _attribute, _old, key: self._add(key))
        self.layout = Column(sizing_mode="stretch_width")
        for axis in axes:
            self._add_axis(axis)
        for key in list(self._config)[:shown]:
            self._add(key)

    @property
    def cell(self) -> Numbers:
        """Chosen value of each axis, by parameter."""
        return {key: value for key, value in self._values.items() if key not in self._config}

    @property
    def numbers(self) -> Numbers:
        """Present values of the numbers that differ from the config's, by key."""
        return {key: value for key, value in self._values.items() if value != self._config.get(key, value)}

    def set(self, values: Mapping[str, float]) -> None:
        """Set axes to their values nearest to these, and numbers to these where allowed; `on_change` is not called.

        A number gets a slider if it has none. Keys that are neither an axis nor a number of the config are ignored.
        """
        self._is_setting = True
        for key, value in values.items():
            self._add(key)
            if key in self._changes:
                self._changes[key](value)
        self._is_setting = False

    def _add_axis(self, axis: ResultAxis) -> None:
        values, nominal = axis.values, math.nan if axis.parameter == RUN else nominal_value(self._study, axis.parameter)
        lowest, highest = axis.ends
        first = nominal if lowest <= nominal <= highest else values[len(values) // 2]
        self._add_row(
            axis.parameter,
            title_of(axis),
            lambda _: (0, len(values) - 1, 1),
            first,
            lambda value: axis.nearest(np.clip(value, lowest, highest)),
            lambda at: float(values[int(at)]),
            math.isfinite,
        )

    def _add(self, key: str) -> None:
        """Add a slider for a number of the config, unless it has one, and remove it from the choice of others."""
        if key not in self._config or key in self._changes:
            return
        _, allowed, value = located(self._study, key)
        exact: Callable[[float], float] = (lambda number: float(round(number))) if allowed.whole else float

        def is_allowed(number: float) -> bool:
            return allowed.allows(number) and (number == 0.0 or 1.0 / LARGEST_SIZE <= abs(number) <= LARGEST_SIZE)

        self._add_row(key, title_of(quantity(key)), partial(slider_range, key=allowed), value, exact, exact, is_allowed)
        names = [(each, f"{quantity(each).name}  ({each})") for each in self._config if each not in self._changes]
        self._more.update(options=[("", "another number …"), *names], value="", visible=bool(names))
        self.layout.children = [*(row for row in self.layout.children if row is not self._more), self._more]

    def _add_row(
        self,
        key: str,
        name: str,
        limits_for: Callable[[float], tuple[float, float, float]],
        first: float,
        place: Callable[[float], float],
        value_at: Callable[[float], float],
        is_allowed: Callable[[float], bool],
    ) -> None:
        """Add a row of a title, a slider and a box to type into.

        limits_for : start, end and step of the slider for a value; a typed value sets them anew
        first : value to begin with
        place, value_at : position of the slider for a value, and value at a position
        is_allowed : whether a value may be set; one that is not leaves the present value
        """
        title = Div(text=name, render_as_text=True, width=250, margin=(6, 4, 0, 6))
        start, end, step = limits_for(first)
        slider = Slider(start=start, end=end, step=step, value=place(first), show_value=False, name=f"slider {key}")
        slider.update(sizing_mode="stretch_width", margin=(6, 12, 0, 6))
        self._values[key] = value_at(place(first))
        box = NumericInput(value=self._values[key], mode="float", width=112, margin=(0, 6, 0, 0), name=f"number {key}")

        def change(new: float | None, is_typed: bool = True) -> None:
            value = value_at(place(new)) if new is not None and is_allowed(new) else self._values[key]
            is_changed = value != self._values[key]
            self._values[key] = value
            if is_changed and is_typed:
                start, end, step = limits_for(value)
                slider.update(start=start, end=end, step=step)
            slider.value = place(value)
            box.value = value
            if is_changed and not self._is_setting:
                self._on_change()

        slider.on_change("value", lambda _attribute, _old, at: change(value_at(at), False))
        box.on_change("value", lambda _attribute, _old, new: change(new))
        self._changes[key] = change
        self.layout.children = [*self.layout.children, Row(children=[title, slider, box], sizing_mode="stretch_width")]
