"""The command line: parse, call the library, print. Data goes to stdout, everything else to stderr.

The module of a command is imported when the command is named, and the parts of the library that it needs are imported
inside the command, so that `--help` and `--version` wait for neither numba nor matplotlib.
"""

import atexit
import gc
import io
import signal
import sys
import warnings
from importlib import import_module
from typing import Any, NoReturn

import click

from clunk import __version__
from clunk.cli import terminal
from clunk.cli.options import EXIT_INTERRUPTED, EXIT_TERMINATED, EXIT_USAGE
from clunk.study.errors import ClunkError, ClunkWarning, nearest

_COMMANDS = (
    *("sweep", "plot", "explore", "simulate", "modes", "info", "report", "export", "init", "help"),
    *("compare", "fit", "verify", "sensitivity", "thresholds", "optimize", "reproduce"),
)

# Command -> module, of commands that share a module; every other command has a module of its name.
_MODULES = {"verify": "compare", **dict.fromkeys(("fit", "optimize", "sensitivity", "thresholds"), "analyses")}


class _Commands(click.Group):
    """Group whose commands are imported from their modules when they are named."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names of all commands, sorted."""
        return sorted(_COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import a command's module and return the command."""
        if cmd_name not in _COMMANDS:
            return None
        return getattr(import_module(f"clunk.cli.{_MODULES.get(cmd_name, cmd_name)}"), cmd_name)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """The command that a command line names; where there is none, a UsageError proposes the nearest one."""
        if args and args[0] not in _COMMANDS and (likely := nearest(args[0], _COMMANDS)):
            ctx.fail(f"No such command {args[0]!r}; did you mean {likely}?")
        return super().resolve_command(ctx, args)


def main() -> NoReturn:
    """Entry point: run the command, and turn every error that a user can cause into one message and an exit code."""
    # The imported modules are many objects that are never freed: garbage collections that look through them, while
    # more are imported and at exit, take 0.2 s.
    gc.set_threshold(100_000)
    atexit.register(gc.freeze)
    for number in (signal.SIGTERM, getattr(signal, "SIGHUP", signal.SIGTERM)):  # no SIGHUP on Windows
        if signal.getsignal(number) != signal.SIG_IGN:  # ignored, as by nohup
            signal.signal(number, _terminate)
    warnings.simplefilter("default", ClunkWarning)
    warnings.showwarning = _warn
    sys.stdout, sys.stderr = sys.stdout or io.StringIO(), sys.stderr or io.StringIO()  # a closed stream is None
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal without σ shows a ? instead of a traceback
    try:
        cli.main(standalone_mode=False)
    except click.exceptions.Exit as error:
        sys.exit(error.exit_code)
    except click.UsageError as error:
        command = error.ctx.command_path if error.ctx else "clunk"
        terminal.complain(f"{error.format_message()}\nTry '{command} --help'.")
    except click.ClickException as error:
        terminal.complain(error.format_message())
    except (click.Abort, KeyboardInterrupt) as stopped:
        cause = stopped.__cause__ or stopped
        is_terminated = isinstance(cause, _Terminated)
        _tell_notes(cause)
        terminal.complain("terminated" if is_terminated else "interrupted")
        sys.exit(EXIT_TERMINATED if is_terminated else EXIT_INTERRUPTED)
    except ClunkError as error:
        terminal.complain(str(error))
        _tell_notes(error)
    except OSError as error:  # for example where a file's name is too long
        terminal.complain(f"{error.filename or 'A file'} cannot be used: {error.strerror or error}.")
    else:
        sys.exit(0)
    sys.exit(EXIT_USAGE)


def _tell_notes(stopped: BaseException) -> None:
    """Print the notes of the exception that stopped a command, which say what is kept of its work."""
    for note in getattr(stopped, "__notes__", ()):
        terminal.complain(f"stopped: {note}")


def _warn(message: Warning | str, category: type[Warning], *place: Any, **more: Any) -> None:
    """Print a warning: of clunk's own the message alone, of others also the place in the code that raised it."""
    if issubclass(category, ClunkWarning):
        terminal.complain(f"warning: {message}")
    else:
        click.echo(warnings.formatwarning(message, category, *place[:2]), err=True, nl=False)


class _Terminated(KeyboardInterrupt):
    """Raised on SIGTERM, and on SIGHUP as the terminal closes; these stop a command as Ctrl-C does."""


def _terminate(_signal: int, _frame: object) -> NoReturn:
    raise _Terminated  # prints nothing here: the signal may come in the middle of another message


@click.group(cls=_Commands, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 80})
@click.version_option(__version__, prog_name="clunk")
@click.pass_context
def cli(context: click.Context) -> None:
    """Impact regime maps of drivelines with backlash.

    \b
    clunk init study.toml          write a commented starter config
    clunk sweep study.toml         run its grid
    clunk plot results/study.h5    draw the regime and severity maps
    clunk help words               what labels, symbols and terms mean
    """
    context.with_resource(terminal.safe_output())
