"""The report's measured tables, which come with clunk as CSV files."""

from importlib.resources import files
from importlib.resources.abc import Traversable

TABLES: dict[str, Traversable] = {"table_4_1": files("clunk.report") / "table_4_1.csv"}
