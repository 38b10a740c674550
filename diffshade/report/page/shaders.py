"""Shaders: GLSL sources put together from the files that they share."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

HERE = Path(__file__).parent
INCLUDE = "// include "


def shader(name: str, lobes: Sequence[tuple[str, str]] = ()) -> str:
    """Return a shader with the files that it includes, and the highlights of own lobes.

    Args:
        name: The file, seen from this folder.
        lobes: The name and the function body of each lobe that is not the library's Phong or Blinn.
    """
    functions = [f"vec3 own_{k}(vec3 n, vec3 l, vec3 v, vec3 n_s) {{\n{body}\n}}" for k, (_, body) in enumerate(lobes)]
    calls = [f"if (lobe == {k + 2}) return own_{k}(n, l, v, n_s);" for k in range(len(functions))]
    text = _with_includes(name).replace("// own functions", "\n".join(functions))
    return text.replace("// own calls", "\n  ".join(calls))


def _with_includes(name: str) -> str:
    lines = (HERE / name).read_text(encoding="utf-8").splitlines()
    return "\n".join(_with_includes(of.removeprefix(INCLUDE)) if of.startswith(INCLUDE) else of for of in lines)
