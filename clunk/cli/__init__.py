"""The command line: commands, tables, JSON records and exit codes."""

from clunk.cli.commands import main

__all__ = ["main"]
