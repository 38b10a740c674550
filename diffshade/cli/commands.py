"""The commands of `diffshade`, in the order of the workflow."""

from __future__ import annotations

import importlib
import os
import sys
from typing import Any

import click

from .exchange import convert, lamp
from .fits import compare, fit, plan, report
from .lights import calibrate, find_lights, mask
from .map_uses import relight
from .maps import texels
from .scenes import figures, new, render
from .terminal import WithoutHelp, stops


class InOrder(WithoutHelp, click.Group):
    """Commands in the order of the workflow."""

    def make_context(self, *arguments: Any, **more: Any) -> click.Context:
        with stops():
            return super().make_context(*arguments, **more)

    def invoke(self, ctx: click.Context) -> object:
        with stops():
            return super().invoke(ctx)

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(self.commands)


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
