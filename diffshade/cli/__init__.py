"""The command `diffshade`: the library at the terminal and for other programs.

Only click is imported before a command runs, so that help and completion are fast; and nothing that takes time before
Ctrl-C is heeded.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable, Sequence
from types import FrameType
from typing import TYPE_CHECKING, NoReturn

if TYPE_CHECKING:
    import click

SOON = 0.02  # seconds between two looks at whether an import has ended
STANDARD = os.path.dirname(os.__file__)  # the folder of Python's own modules
STOPPED = 130  # the exit status after Ctrl-C, as in shells

ERRORS = (OSError, ValueError, TypeError, ArithmeticError, RuntimeError, ImportError, MemoryError)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command and end the process: status 0, or one sentence on standard error and another status.

    The status is 1 if the input is wrong, 2 if the command line is wrong, and 130 after Ctrl-C. Every file is either
    written completely or left as it was.
    """
    sys.unraisablehook = _ignore_stops
    before = signal.signal(signal.SIGINT, _stop)
    try:
        _quiet_the_libraries()
        status = _status_of(lambda: _run(arguments))
    except KeyboardInterrupt:
        _end_at_once()
    finally:
        signal.signal(signal.SIGINT, before)
    sys.exit(status)


def _run(arguments: Sequence[str] | None) -> None:
    from .commands import diffshade

    diffshade.main(arguments, prog_name="diffshade", standalone_mode=False)


def _quiet_the_libraries() -> None:
    """Show warnings of diffshade, and of other libraries only errors."""
    import logging
    import warnings

    logging.basicConfig(format="diffshade: %(message)s", level=logging.WARNING)
    for noisy in ("jax", "matplotlib"):
        logging.getLogger(noisy).setLevel(logging.ERROR)
    if not sys.warnoptions:
        warnings.simplefilter("ignore")


def _status_of(command: Callable[[], object]) -> int:
    """Run a command, print its error as one sentence, and return the exit status."""
    import click

    from .terminal import Stopped

    try:
        command()
        sys.stdout.flush()
    except click.exceptions.NoArgsIsHelpError as help_asked:
        click.echo(help_asked.ctx.get_help())
    except click.ClickException as error:
        return _refuse_typing(error)
    except (click.Abort, Stopped):
        raise KeyboardInterrupt from None
    except (BrokenPipeError, SystemExit):  # the reader, such as head, has closed the pipe; click raises SystemExit then
        _discard_output()
    except ERRORS as error:
        if isinstance(error.__cause__, KeyboardInterrupt):  # Python 3.11 wraps what stops a class that is being made
            raise KeyboardInterrupt from None
        _print_error(_sentence(str(error) or type(error).__name__))
        return 1
    return 0


def _refuse_typing(error: click.ClickException) -> int:
    """Print what is wrong with the command line, and where its help is."""
    import click

    where = error.ctx.command_path if isinstance(error, click.UsageError) and error.ctx else "diffshade"
    _print_error(f"{_sentence(error.format_message())} See '{where} --help'.")
    return error.exit_code


def _end_at_once() -> NoReturn:
    """End the process after Ctrl-C without the interpreter's own shutdown, which threads in XLA do not survive."""
    _print_error("stopped; unfinished files are left as they were.")
    sys.stdout.flush()
    os._exit(STOPPED)


def _discard_output() -> None:
    """Send further output to nowhere, so that closing it raises nothing."""
    import contextlib

    with contextlib.suppress(OSError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _print_error(sentence: str) -> None:
    print(f"diffshade: {sentence}", file=sys.stderr, flush=True)


def _stop(signum: int, frame: FrameType | None) -> None:
    """Raise KeyboardInterrupt, repeatedly, since a callback of C code drops it; but not within a library's import."""
    import threading

    importing = _imports_a_library(frame)
    again = threading.Timer(SOON if importing else 1.0, signal.raise_signal, (signum,))
    again.daemon = True
    again.start()
    if not importing:
        raise KeyboardInterrupt


def _imports_a_library(frame: FrameType | None) -> bool:
    """Whether a frame is within the import of a library, not of a user's own module (--import), which may take long.

    Modules in C import others and print what stops them, or go on without.
    """
    while frame is not None and frame.f_code is not main.__code__:
        file = frame.f_code.co_filename
        if file.startswith("<frozen importlib"):
            return True
        if frame.f_code.co_name == "<module>":
            return file.startswith(("<frozen", STANDARD)) or "-packages" in file
        frame = frame.f_back
    return False


def _ignore_stops(found: sys.UnraisableHookArgs) -> None:
    """Report exceptions that Python cannot raise, except Ctrl-C, which is repeated."""
    if not issubclass(found.exc_type, KeyboardInterrupt):
        sys.__unraisablehook__(found)


def _sentence(message: str) -> str:
    """Return a message as one line that ends with a full stop or question mark."""
    line = " ".join(message.split())
    return line if line.endswith((".", "?", "!")) else f"{line}."
