"""Changes of several models that reach the browser in one message: it draws once, not once for each."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.resources import files
from typing import Any

from bokeh.models import ColumnDataSource, CustomJS, Model

Changes = Mapping[str, Mapping[str, Any]]  # name of a model -> property -> value


class Message:
    """Changes of models, which the server's own copies of them do not have.

    models : by the names that changes have
    source : what carries them; it has to be in the document
    """

    def __init__(self, **models: Model) -> None:
        self.source = ColumnDataSource(data={})
        self.source.js_on_change("data", CustomJS(args={"models": models}, code=asset("message.js")))

    def send(self, changes: Changes) -> None:
        """Change the models in the browser."""
        self.source.data = {name: [properties] for name, properties in changes.items()}


def source(*names: str) -> ColumnDataSource:
    """Columns of these names, still empty."""
    return ColumnDataSource(data={name: [] for name in names})


def asset(name: str) -> str:
    """Text of a file of the explorer."""
    return files(__package__).joinpath(name).read_text("utf-8")
