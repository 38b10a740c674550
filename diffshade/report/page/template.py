"""Template: a page filled in; all values are escaped, and only the page's own scripts and styles may run."""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent


def fill(template: str, styles: Sequence[str], scripts: Sequence[str], **what: Any) -> str:
    """Return a page; template, styles and scripts are files, seen from this folder."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader(HERE),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    texts = {
        kind: [(HERE / name).read_text(encoding="utf-8") for name in names]
        for kind, names in (("styles", styles), ("scripts", scripts))
    }
    allowed = {kind: " ".join(f"'sha256-{_digest(text)}'" for text in of) for kind, of in texts.items()}
    return environment.get_template(template).render(**what, **texts, allowed=allowed)


def as_script(data: Any) -> str:
    """Return data as JSON within a script element, which only "<" could end or start."""
    return json.dumps(data, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")


def _digest(text: str) -> str:
    return base64.b64encode(hashlib.sha256(text.encode()).digest()).decode("ascii")
