"""Types of arguments, and the output as text or JSON, shared by all commands."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import click
from click.shell_completion import CompletionItem

FILE = click.Path(dir_okay=False, path_type=Path)
FOLDER = click.Path(file_okay=False, path_type=Path)

LINES = 24  # of a screen, which a command's help fits


class Stopped(BaseException):
    """Ctrl-C, which click would answer with an empty line."""


@contextlib.contextmanager
def stops() -> Iterator[None]:
    """Raise Stopped on Ctrl-C."""
    try:
        yield
    except KeyboardInterrupt:
        raise Stopped from None


class WithoutHelp(click.Command):
    """A command whose help does not list -h, which whoever reads it has typed: a screen's lines are for the rest."""

    def get_help_option(self, ctx: click.Context) -> click.Option | None:
        option = super().get_help_option(ctx)
        if option is not None:
            option.hidden = True
        return option


class Command(WithoutHelp):
    """A command whose help fits a screen."""

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        formatter.write(f"\n  {self.epilog}\n" if self.epilog else "")

    def get_help(self, ctx: click.Context) -> str:
        lines = super().get_help(ctx).splitlines()
        while len(lines) > LINES and "" in lines:
            del lines[-1 - lines[::-1].index("")]
        return "\n".join(lines)


SETTINGS: Any = {"cls": Command, "context_settings": {"help_option_names": ["-h", "--help"]}}


class Typed(click.ParamType):
    """What a function reads from a word, which raises ValueError for a wrong one; `wrong` then says what is right.

    A value that is no word, such as a default, stays what it is.
    """

    def __init__(self, name: str, read: Callable[[str], Any], wrong: str, example: str):
        self.name, self.read, self.wrong, self.example = name, read, wrong, example

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        try:
            return self.read(value) if isinstance(value, str) else value
        except ValueError:
            self.fail(f"{self.wrong}; got '{value}'. Give {self.example}.", param, ctx)


def _names(word: str) -> tuple[str, ...]:
    if not (names := tuple(name for part in word.split(",") if (name := part.strip()))):
        raise ValueError
    return names


def _bounds(word: str) -> tuple[str, list[float]]:
    name, _, ends = word.partition("=")
    low, high = (float(end) for end in ends.split(":"))
    return name.strip(), [low, high]


def _lights_on(word: str) -> Any:
    if word in ("each", "all"):
        return word
    return tuple(tuple(int(light) for light in one.split("+")) for one in word.split(","))


def _circle(word: str) -> tuple[float, ...]:
    column, row, radius = (float(number) for number in word.split(","))
    return column, row, radius


def _size(word: str) -> tuple[int, int]:
    width, height = (int(number) for number in word.lower().split("x"))
    if width < 1 or height < 1:
        raise ValueError
    return width, height


def _toward_light(word: str) -> tuple[tuple[float, ...], tuple[float, ...]]:
    place, equals, intensity = word.partition("=")
    toward = tuple(float(number) for number in place.split(","))
    colour = tuple(float(number) for number in intensity.split(",")) if equals else (1.0,)
    if len(toward) != 3 or len(colour) not in (1, 3):
        raise ValueError
    return toward, colour


NAMES = Typed("names", _names, "names must be separated by commas", "for example k_d,n_s")
BOUNDS = Typed("name=low:high", _bounds, "bounds must have the form NAME=LOW:HIGH", "for example k_s=0:1")
LIGHTS_ON = Typed(
    "lights", _lights_on, "lights must be each, all, or indices for each photograph", "for example 0,1,0+1"
)
INDICES = Typed(
    "lights", lambda word: [int(index) for index in word.split(",")], "lights must be indices from 0", "for example 0,2"
)
CIRCLE = Typed("x,y,r", _circle, "a circle is column, row and radius, pixels", "for example 320,240,100")
EXPOSURE = Typed(
    "x|auto",
    lambda word: word if word == "auto" else float(word),
    "an exposure is a number or auto",
    "1 for unscaled radiance",
)
SIZE = Typed("WxH", _size, "a size must have the form WIDTHxHEIGHT in pixels", "for example 640x480")
TOWARD_LIGHT = Typed(
    "x,y,z=intensity",
    _toward_light,
    "a light must have the form X,Y,Z or X,Y,Z=INTENSITY, X,Y,Z toward it",
    "for example 1,1,2 or -1,0,1=0.5",
)


class OneOf(click.Choice):
    """One of several words, which the option's help names."""

    def get_metavar(self, param: click.Parameter, ctx: click.Context) -> str:
        return "NAME"

    def get_invalid_choice_message(self, value: Any, ctx: click.Context | None) -> str:
        from ..core.words import did_you_mean

        return f"'{value}' is not known. {did_you_mean(value, self.choices)}"


def completions(words: Iterable[str], incomplete: str) -> list[CompletionItem]:
    """Return the words that complete a beginning, for the shell."""
    return [CompletionItem(word) for word in words if word.startswith(incomplete)]


JSON = "diffshade.json"  # where click keeps, for `answer`, whether JSON is asked for
with_json = click.option(
    "--json",
    is_flag=True,
    expose_value=False,
    callback=lambda ctx, _, value: ctx.meta.update({JSON: value}),
    help="Print JSON, for other programs",
)


def answer(lines: Iterable[object], *data: Any) -> None:
    """Print what a command found.

    Args:
        lines: What is shown as text, one below the other; None shows nothing.
        data: What is shown as one JSON object instead: the fields of results, and the keys of mappings.
    """
    from ..core.tables import as_json

    if click.get_current_context().meta[JSON]:
        found = {key: value for of in data for key, value in as_json(of).items()}
        click.echo(json.dumps(found, indent=2, allow_nan=False, ensure_ascii=False))
    else:
        click.echo("\n".join(str(line) for line in lines if line is not None))
