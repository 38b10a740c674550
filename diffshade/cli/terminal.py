"""Types of arguments, and the output as text or JSON, shared by all commands."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterable, Iterator
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


class Command(click.Command):
    """A command whose help leaves a screen's lines to its options: -h is not listed among them."""

    def get_help_option(self, ctx: click.Context) -> click.Option | None:
        option = super().get_help_option(ctx)
        if option is not None:
            option.hidden = True
        return option

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        formatter.write(f"\n  {self.epilog}\n" if self.epilog else "")

    def get_help(self, ctx: click.Context) -> str:
        lines = super().get_help(ctx).splitlines()
        while len(lines) > LINES and "" in lines:
            del lines[-1 - lines[::-1].index("")]
        return "\n".join(lines)


SETTINGS: Any = {"cls": Command, "context_settings": {"help_option_names": ["-h", "--help"]}}


class Names(click.ParamType):
    """Names separated by commas."""

    name = "names"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[str, ...]:
        if isinstance(value, tuple):
            return value
        names = tuple(word for part in value.split(",") if (word := part.strip()))
        return names or self.fail(
            f"names must be separated by commas; got '{value}'. Give for example k_d,n_s.", param, ctx
        )


class OneOf(click.ParamType):
    """One of several words."""

    name = "name"

    def __init__(self, words: tuple[str, ...]):
        self.words = words

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        from ..core.words import did_you_mean

        if value not in self.words:
            self.fail(f"'{value}' is not known. {did_you_mean(value, self.words)}", param, ctx)
        return value

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        return completions(self.words, incomplete)


class Bounds(click.ParamType):
    """A name and its bounds."""

    name = "name=low:high"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[str, list[float]]:
        if isinstance(value, tuple):
            return value
        name, _, ends = value.partition("=")
        try:
            low, high = (float(end) for end in ends.split(":"))
        except ValueError:
            self.fail(f"bounds must have the form NAME=LOW:HIGH; got '{value}'. Give for example k_s=0:1.", param, ctx)
        return name.strip(), [low, high]


class LightsOn(click.ParamType):
    """The lights that were on: a word, or the lights of each photograph."""

    name = "lights"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if value in ("each", "all") or not isinstance(value, str):
            return value
        try:
            return tuple(tuple(int(light) for light in one.split("+")) for one in value.split(","))
        except ValueError:
            self.fail(
                f"lights must be each, all, or indices for each photograph; got '{value}'. Give for example 0,1,0+1.",
                param,
                ctx,
            )


class Circle(click.ParamType):
    """Column, row and radius of a circle."""

    name = "x,y,r"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[float, ...]:
        if isinstance(value, tuple):
            return value
        try:
            column, row, radius = (float(number) for number in value.split(","))
        except ValueError:
            self.fail(
                f"a circle is column, row and radius, pixels; got '{value}'. Give for example 320,240,100.", param, ctx
            )
        return column, row, radius


class Exposure(click.ParamType):
    """A factor, or auto."""

    name = "x|auto"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float | str:
        try:
            return value if value == "auto" else float(value)
        except ValueError:
            self.fail(f"an exposure is a number or auto; got '{value}'. Give 1 for unscaled radiance.", param, ctx)


class Size(click.ParamType):
    """Width and height of a picture."""

    name = "WxH"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, int]:
        if isinstance(value, tuple):
            return value
        try:
            width, height = (int(number) for number in value.lower().split("x"))
        except ValueError:
            width, height = 0, 0
        if width < 1 or height < 1:
            self.fail(
                f"a size must have the form WIDTHxHEIGHT in pixels; got '{value}'. Give for example 640x480.",
                param,
                ctx,
            )
        return width, height


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
