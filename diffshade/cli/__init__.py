"""The command `diffshade`: the library at the terminal and for other programs.

Only click is imported before a command runs, so that help and completion are fast.
"""

from __future__ import annotations

import contextlib
import importlib
import logging
import os
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Sequence

import click

from .exchange import convert, lamp
from .fits import compare, fit, plan, report
from .lights import calibrate, find_lights, mask
from .map_uses import relight
from .maps import texels
from .scenes import figures, new, render

STOPPED = 130  # the exit status after Ctrl-C, as in shells

ERRORS = (OSError, ValueError, TypeError, ArithmeticError, RuntimeError, ImportError, MemoryError)


class InOrder(click.Group):
    """Commands in the order of the workflow."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(self.commands)

    def get_help_option(self, ctx: click.Context) -> click.Option | None:
        option = super().get_help_option(ctx)
        if option is not None:
            option.hidden = True  # whoever reads it has typed it, and the commands fill a screen
        return option


# The example stands beside the first sentence, so that the help fits a screen; \b keeps their lines.
HELP = """\b
Render pictures; find materials and lamps from photographs, with errors.
Example: diffshade new ball.toml && diffshade render ball.toml
"""


@click.group(
    cls=InOrder,
    help=HELP,
    commands=[
        new,
        render,
        calibrate,
        mask,
        find_lights,
        fit,
        report,
        compare,
        plan,
        texels,
        relight,
        convert,
        lamp,
        figures,
    ],
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.version_option(package_name="diffshade")
@click.option(
    "--import",
    "modules",
    metavar="MODULE",
    multiple=True,
    help="Import a module whose classes scene files name.",
)
def diffshade(modules: tuple[str, ...] = ()) -> None:
    """Render pictures; find materials and lamps from photographs, with errors."""
    if modules:
        sys.path.insert(0, os.getcwd())  # where an installed command does not look
    for module in modules:
        importlib.import_module(module.removesuffix(".py"))


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command and end the process: status 0, or one sentence on standard error and another status.

    The status is 1 if the input is wrong, 2 if the command line is wrong, and 130 after Ctrl-C. Every file is either
    written completely or left as it was.
    """
    _quiet_the_libraries()
    sys.unraisablehook = _ignore_stops
    before = signal.signal(signal.SIGINT, _stop)
    try:
        status = _status_of(lambda: diffshade.main(arguments, prog_name="diffshade", standalone_mode=False))
    finally:
        signal.signal(signal.SIGINT, before)
    sys.exit(status)


def _quiet_the_libraries() -> None:
    """Show warnings of diffshade, and of other libraries only errors."""
    logging.basicConfig(format="diffshade: %(message)s", level=logging.WARNING)
    for noisy in ("jax", "matplotlib"):
        logging.getLogger(noisy).setLevel(logging.ERROR)
    if not sys.warnoptions:
        warnings.simplefilter("ignore")


def _status_of(command: Callable[[], object]) -> int:
    """Run a command, print its error as one sentence, and return the exit status."""
    try:
        command()
        sys.stdout.flush()
    except click.exceptions.NoArgsIsHelpError as help_asked:
        click.echo(help_asked.ctx.get_help())
    except click.ClickException as error:
        return _refuse_typing(error)
    except (click.Abort, KeyboardInterrupt):
        _end_at_once()
    except (BrokenPipeError, SystemExit):  # the reader, such as head, has closed the pipe; click raises SystemExit then
        _discard_output()
    except ERRORS as error:
        _print_error(_sentence(str(error) or type(error).__name__))
        return 1
    return 0


def _refuse_typing(error: click.ClickException) -> int:
    """Print what is wrong with the command line, and where its help is."""
    where = error.ctx.command_path if isinstance(error, click.UsageError) and error.ctx else "diffshade"
    _print_error(f"{_sentence(error.format_message())} See '{where} --help'.")
    return error.exit_code


def _end_at_once() -> None:
    """End the process after Ctrl-C without the interpreter's own shutdown, which threads in XLA do not survive."""
    _print_error("stopped; unfinished files are left as they were.")
    sys.stdout.flush()
    os._exit(STOPPED)


def _discard_output() -> None:
    """Send further output to nowhere, so that closing it raises nothing."""
    with contextlib.suppress(OSError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _print_error(sentence: str) -> None:
    click.echo(f"diffshade: {sentence}", err=True)


def _stop(signum: int, frame: object) -> None:
    """Raise KeyboardInterrupt, repeatedly, since a callback of C code drops it."""
    again = threading.Timer(1.0, signal.raise_signal, (signum,))
    again.daemon = True
    again.start()
    raise KeyboardInterrupt


def _ignore_stops(found: sys.UnraisableHookArgs) -> None:
    """Report exceptions that Python cannot raise, except Ctrl-C, which is repeated."""
    if not issubclass(found.exc_type, KeyboardInterrupt):
        sys.__unraisablehook__(found)


def _sentence(message: str) -> str:
    """Return a message as one line that ends with a full stop or question mark."""
    line = " ".join(message.split())
    return line if line.endswith((".", "?", "!")) else f"{line}."
