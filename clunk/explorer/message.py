"""Changes of several models that reach the browser in one message: it draws once, not once for each."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bokeh.models import ColumnDataSource, CustomJS, Model

Changes = dict[str, Mapping[str, Any]]  # name of a model -> property -> value

# The server, which asks for it, need not hear of the changes again.
_CHANGE = "for (const [name, [values]] of Object.entries(cb_obj.data)) models[name].setv(values, {sync: false});"


class Message:
    """Changes of models, which the server's own copies of them do not have.

    models : by the names that changes have
    source : what carries them; it has to be in the document
    """

    def __init__(self, models: Mapping[str, Model]) -> None:
        self.source = ColumnDataSource(data={})
        self.source.js_on_change("data", CustomJS(args={"models": dict(models)}, code=_CHANGE))

    def send(self, changes: Changes) -> None:
        """Change the models in the browser."""
        self.source.data = {name: [properties] for name, properties in changes.items()}


def source(names: str) -> ColumnDataSource:
    """Columns of these names, separated by blanks, still empty."""
    return ColumnDataSource(**columns(names, []))


def columns(names: str, rows: list[tuple[Any, ...]]) -> Mapping[str, Any]:
    """The data of a source with columns of these names, separated by blanks."""
    return {"data": {name: [row[k] for row in rows] for k, name in enumerate(names.split())}}
