"""Shaders: GLSL sources put together from the files that they share."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

HERE = Path(__file__).parent
INCLUDE = "// include "


def shader(name: str, lobes: Sequence[tuple[str, str]] = (), laws: Sequence[str] = ()) -> str:
    """Return a shader with the files that it includes, the highlights of own lobes, and laws of attenuation.

    Args:
        name: The file, seen from this folder.
        lobes: The name and the function body of each lobe that is not the library's Phong or Blinn.
        laws: The function body of each law of attenuation, in the order of their numbers.
    """
    functions = [f"vec3 own_{k}(vec3 n, vec3 l, vec3 v, vec3 n_s) {{\n{body}\n}}" for k, (_, body) in enumerate(lobes)]
    calls = [f"if (lobe == {k + 2}) return own_{k}(n, l, v, n_s);" for k in range(len(functions))]
    fades = [f"float law_{k}(float d) {{\n{body}\n}}" for k, body in enumerate(laws)]
    fade_calls = [f"if (law == {k}) return law_{k}(d);" for k in range(len(laws))]
    text = _with_includes(name).replace("// own functions", "\n".join(functions))
    text = text.replace("// own calls", "\n  ".join(calls)).replace("// laws", "\n".join(fades))
    return text.replace("// calls of laws", "\n  ".join(fade_calls))


def _with_includes(name: str) -> str:
    lines = (HERE / name).read_text(encoding="utf-8").splitlines()
    return "\n".join(_with_includes(of.removeprefix(INCLUDE)) if of.startswith(INCLUDE) else of for of in lines)
