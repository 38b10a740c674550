"""Checks: what no report can be written from is refused before any work."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ...io.files import writable


def check_page(path: Any) -> None:
    """Refuse, before any work, a path that is not a page or cannot be written."""
    if not isinstance(path, str | Path):
        raise TypeError(f"path must be a path; got {path!r}. Give for example 'fit.html'.")
    if Path(path).suffix.lower() not in (".html", ".htm"):
        raise ValueError(f"{path} has the suffix '{Path(path).suffix}'; a report is an HTML file. Use .html.")
    writable(path)


def check_titles(titles: Sequence[str], views: int, whose: str) -> None:
    """Refuse titles that are not one name for each view."""
    if isinstance(titles, str) or not all(isinstance(title, str) for title in titles):
        raise TypeError(f"titles must hold a string for each view; got {titles!r}. Give for example ['lamp near'].")
    if titles and len(titles) != views:
        raise ValueError(f"titles must be one for each of {whose} {views} views; got {len(titles)}. Leave them out.")
