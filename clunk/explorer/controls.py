"""Sliders for values of a map's further axes and for other numbers of the config, and boxes for those of a cell."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial

from bokeh.models import Column, Div, NumericInput, Row, Select, Slider, TextInput

from clunk.explorer.mapfigure import title_of
from clunk.plot.plane import number_text
from clunk.plot.style import bare
from clunk.study.axes import ResultAxis
from clunk.study.designs import is_unused
from clunk.study.keys import Key
from clunk.study.parameters import complaint, located, nominal_value, parameters, quantity
from clunk.study.study import Study

# In this order, those that the config has; a lash's stand for those of each lash.
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
_STEPS = 200  # of a slider

OnNumber = Callable[[str, float], None]


def adjustable(study: Study, swept: set[str]) -> dict[str, float]:
    """Keys of a study that a slider may change, with their values; those that are looked for first come first."""
    document = study.model_dump()
    keys = [key for key in parameters(document) if key not in swept and complaint(key, document) is None]
    values = {key: nominal_value(study, key) for key in keys}
    known = {key: value for key, value in values.items() if math.isfinite(value) and not is_unused(study, key)}

    def rank(key: str) -> int:
        plain = re.sub(r"^lash\[\d+\]", "lash", key)
        return _FIRST.index(plain) if plain in _FIRST else len(_FIRST)

    return dict(sorted(known.items(), key=lambda item: rank(item[0])))


def slider_range(value: float, key: Key) -> tuple[float, float, float]:
    """Start, end and step of a slider for a number: from nothing to twice and a half of it, within what is allowed."""
    low, high = sorted((0.0, 2.5 * value)) if value else (0.0, 1.0)
    low, high = max(low, key.lowest), min(high, key.highest)
    rough = (high - low) / _STEPS
    power = 10.0 ** math.floor(math.log10(rough)) if rough > 0.0 else 1.0
    step = next((k * power for k in (1.0, 2.0, 5.0) if k * power >= rough), 10.0 * power)
    step = max(step, 1.0) if key.whole else step
    return (low + step if key.above else low), high, step


class Controls:
    """A column of sliders.

    on_slice, on_number : called with a key and its new value
    shown : numbers that have sliders to begin with
    """

    def __init__(
        self,
        study: Study,
        slices: tuple[ResultAxis, ...],
        swept: set[str],
        on_slice: OnNumber,
        on_number: OnNumber,
        shown: int,
    ) -> None:
        self._study, self._on_number = study, on_number
        self._values = adjustable(study, swept)
        self._slices: dict[str, tuple[Slider, ResultAxis]] = {}
        self._rows = [self._slice(axis, on_slice) for axis in slices]
        self._shown: dict[str, Row] = {}
        self._inputs: dict[str, tuple[Slider, NumericInput]] = {}
        self._more = Select(title="", options=[], name="more", sizing_mode="stretch_width", margin=(2, 6, 2, 6))
        self._more.on_change("value", self._on_more)
        self.layout = Column(children=[], name="controls", sizing_mode="stretch_width")
        for key in list(self._values)[:shown]:
            self._add(key)
        self._arrange()

    def reset(self) -> None:
        """Put all numbers back to those of the config."""
        for key, (slider, box) in self._inputs.items():
            slider.value = box.value = self._values[key]

    def set(self, values: Mapping[str, float]) -> None:
        """Move sliders to values of further axes and to other numbers; what has no slider is left out."""
        for key, value in values.items():
            if key in self._slices:
                slider, axis = self._slices[key]
                slider.value = axis.nearest(value)
            elif key in self._values:
                self._on_more("", "", key)
                self._inputs[key][1].value = value

    def _slice(self, axis: ResultAxis, on_slice: OnNumber) -> Row:
        title = Div(text="", render_as_text=True, width=250, margin=(6, 4, 0, 6))
        last = len(axis.values) - 1
        slider = Slider(start=0, end=max(last, 1), step=1, value=last // 2, show_value=False, title="")
        slider.update(sizing_mode="stretch_width", margin=(6, 12, 0, 6), name=f"slice {axis.parameter}")

        def change(_attribute: str, _old: int, position: int) -> None:
            value = float(axis.values[min(position, last)])
            title.text = f"{title_of(axis.name or axis.parameter, axis.symbol, axis.unit)} = {number_text(value)}"
            on_slice(axis.parameter, value)

        change("value", 0, last // 2)
        slider.on_change("value", change)
        self._slices[axis.parameter] = slider, axis
        return Row(children=[title, slider], sizing_mode="stretch_width")

    def _add(self, key: str) -> None:
        described, (_, allowed, value) = quantity(key), located(self._study, key)
        start, end, step = slider_range(value, allowed)
        name = title_of(described.name, described.symbol, described.unit)
        title = Div(text=name, render_as_text=True, width=250, margin=(6, 4, 0, 6))
        slider = Slider(
            start=min(start, value), end=max(end, value), step=step, value=value, show_value=False, title=""
        )
        slider.update(sizing_mode="stretch_width", margin=(6, 12, 0, 6), name=f"slider {key}")
        box = NumericInput(value=value, mode="float", width=112, margin=(0, 6, 0, 0), name=f"number {key}")

        def change(source: str, _attribute: str, _old: float, new: float | None) -> None:
            if new is None or not allowed.allows(new):
                box.value = slider.value
                return
            if source == "box":
                slider.update(start=min(slider.start, new), end=max(slider.end, new))
            slider.value = box.value = new
            self._on_number(key, new)

        slider.on_change("value", partial(change, "slider"))
        box.on_change("value", partial(change, "box"))
        self._inputs[key] = slider, box
        self._shown[key] = Row(children=[title, slider, box], sizing_mode="stretch_width")

    def _on_more(self, _attribute: str, _old: str, key: str) -> None:
        if key in self._values and key not in self._shown:
            self._add(key)
            self._arrange()

    def _arrange(self) -> None:
        names: Mapping[str, str] = {key: quantity(key).name for key in self._values if key not in self._shown}
        self._more.options = [("", "another number …"), *((key, f"{name}  ({key})") for key, name in names.items())]
        self._more.value = ""
        self.layout.children = [*self._rows, *self._shown.values(), *([self._more] if names else [])]


class CellBoxes:
    """A box for each axis of the map, with the value in the cell that was chosen last.

    on_values : called with the values when one was typed
    """

    def __init__(self, axes: Sequence[ResultAxis], on_values: Callable[[list[float]], None]) -> None:
        self._on_values, self._is_setting = on_values, False
        names = [bare(axis.symbol) or axis.name or axis.parameter for axis in axes]
        look = {"width": 110, "height": 30, "margin": (0, 0, 4, 6)}
        self.boxes = [
            TextInput(prefix=name, name=f"at {axis.parameter}", **look) for axis, name in zip(axes, names, strict=True)
        ]
        for box in self.boxes:
            box.on_change("value", self._on_change)

    def show(self, cell: Sequence[float]) -> None:
        """Show the values in a cell."""
        self._cell, self._is_setting = cell, True
        for box, value in zip(self.boxes, cell, strict=True):
            box.value = f"{value:.6g}"
        self._is_setting = False

    def _on_change(self, _attribute: str, _old: str, _new: str) -> None:
        if self._is_setting:
            return
        try:
            values = [float(box.value) for box in self.boxes]
        except ValueError:
            values = list(self._cell)
        self._on_values(values)
        self.show(self._cell)  # of a value that is no cell's, the nearest one; of none, the one before
