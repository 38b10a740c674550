"""The command `diffshade`: what the library does, for people at a terminal and for other programs.

Nothing but click is imported before a command runs, so that help and completion answer at once.
"""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import sys
import threading
import warnings
from collections.abc import Sequence

import click

from .exchange import convert
from .fits import compare, fit, plan, report
from .lights import calibrate
from .maps import texels
from .scenes import figures, new, render

STOPPED = 130  # as shells have it for what Ctrl-C ended


class InOrder(click.Group):
    """Commands in the order in which they are met."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(self.commands)


@click.group(
    cls=InOrder,
    commands=[new, render, calibrate, fit, report, compare, plan, texels, convert, figures],
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="Example: diffshade new ball.toml && diffshade render ball.toml",
)
@click.version_option(package_name="diffshade")
def diffshade() -> None:
    """The classic illumination model, forwards and backwards.

    Render a scene; or find k_a, k_d, k_s, n_s and what a lamp does from photographs, with error bars and a plain word
    about what they cannot tell.
    """


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command and end the process: status 0, or one sentence on standard error and another status.

    1: something is wrong with what was given; 2: with how the command was typed; 130: stopped by Ctrl-C. Whatever
    happens, a file is there whole or as it was.
    """
    logging.basicConfig(format="diffshade: %(message)s", level=logging.WARNING)
    for noisy in ("jax", "matplotlib"):
        logging.getLogger(noisy).setLevel(logging.ERROR)
    if not sys.warnoptions:
        warnings.simplefilter("ignore")
    sys.unraisablehook = _without_stops
    before = signal.signal(signal.SIGINT, _stop)
    try:
        diffshade.main(arguments, prog_name="diffshade", standalone_mode=False)
        sys.stdout.flush()
        status = 0
    except click.exceptions.NoArgsIsHelpError as help_asked:
        click.echo(help_asked.ctx.get_help())
        status = 0
    except click.ClickException as error:
        where = error.ctx.command_path if isinstance(error, click.UsageError) and error.ctx else "diffshade"
        status = _refused(_sentence(error.format_message()), error.exit_code, f"See '{where} --help'.")
    except (click.Abort, KeyboardInterrupt):
        _refused("stopped; what was being written is as it was before.", STOPPED)
        sys.stdout.flush()
        os._exit(STOPPED)  # at once: threads at work in XLA do not bear the interpreter's own end
    except (BrokenPipeError, SystemExit):  # of a reader that has enough, such as head: click ends so too
        with contextlib.suppress(OSError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        status = 0
    except (OSError, ValueError, TypeError, ArithmeticError, RuntimeError, ImportError, MemoryError) as error:
        status = _refused(_sentence(str(error) or type(error).__name__), 1)
    finally:
        signal.signal(signal.SIGINT, before)
    sys.exit(status)


def _refused(sentence: str, status: int, remedy: str = "") -> int:
    click.echo(f"diffshade: {sentence} {remedy}".rstrip(), err=True)
    return status


def _stop(signum: int, frame: object) -> None:
    """Raise KeyboardInterrupt, and again until it is heard: what falls into a callback of C code is dropped there."""
    again = threading.Timer(1.0, signal.raise_signal, (signum,))
    again.daemon = True
    again.start()
    raise KeyboardInterrupt


def _without_stops(found: sys.UnraisableHookArgs) -> None:
    """Say what Python could not raise, but for a Ctrl-C, which comes again."""
    if not issubclass(found.exc_type, KeyboardInterrupt):
        sys.__unraisablehook__(found)


def _sentence(message: str) -> str:
    """Return a message as one line that ends like a sentence."""
    line = " ".join(message.split())
    return line if line.endswith((".", "?", "!")) else f"{line}."
