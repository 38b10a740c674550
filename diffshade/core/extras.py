"""Extras: packages that only a part of the library needs, and that are not installed by default."""

from __future__ import annotations

import contextlib
import importlib
from collections.abc import Iterator


@contextlib.contextmanager
def needing(extra: str, task: str) -> Iterator[None]:
    """Import packages of an extra in this block, or say what is impossible without them.

    Raises:
        ImportError: A package is not installed.
    """
    try:
        yield
    except ImportError as error:
        package = (error.name or f"{error}").replace("_", "-")
        message = f"{task} without the package {package}. Install it: pip install 'diffshade[{extra}]'."
        raise ImportError(message) from None


def check_extra(extra: str, task: str, *packages: str) -> None:
    """Raise the ImportError of `needing` before work that will need packages begins."""
    with needing(extra, task):
        for package in packages:
            importlib.import_module(package)
