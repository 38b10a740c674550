"""Names of materials in other programs: identifiers where a language needs them, and the original beside them."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Callable, Iterable

from ..core.words import MAX_LETTERS, unused

# Words of POV-Ray and JavaScript that a material could be named, and that their languages reserve.
RESERVED = re.compile(
    "agate|all|aoi|average|bevelled|black|bozo|brick|bumps|camera|checker|clock|color|colour|cone|crackle|cubic|"
    "cylinder|dents|disc|emission|fade|filter|finish|fog|gradient|granite|gray|grey|height|hexagon|interior|"
    "julia|leopard|light|light_source|linear|mandel|marble|material|media|mesh|metallic|mirror|no|normal|object|"
    "off|on|onion|pattern|phong|pigment|planar|plane|quilted|radial|red|green|blue|reflection|ripples|rough|"
    "roughness|scale|sky|smooth|specular|sphere|spherical|spiral|spotted|text|texture|tiles|torus|transmit|"
    "translate|true|false|turbulence|union|waves|wood|wrinkles|yes|arguments|await|break|case|catch|class|const|"
    "continue|debugger|default|delete|do|else|enum|eval|export|extends|finally|for|function|if|implements|import|"
    "in|instanceof|interface|let|new|null|package|private|protected|public|return|static|super|switch|this|throw|"
    "try|typeof|undefined|var|void|while|with|yield|THREE"
)


def identifiers(names: Iterable[str]) -> dict[str, str]:
    """Return an identifier of letters, digits and _ for each name, valid in C, Python, JavaScript and POV-Ray."""

    def identifier(name: str) -> str:
        plain = unicodedata.normalize("NFKD", name).encode("ascii", "ignore" if name.isascii() else "replace").decode()
        word = re.sub(r"\W+", "_", plain.replace("?", "_"), flags=re.ASCII).strip("_")[:MAX_LETTERS] or "material"
        return f"_{word}" if word[0].isdigit() else f"{word}_" if RESERVED.fullmatch(word) else word

    return _distinct(names, identifier)


def words(names: Iterable[str]) -> dict[str, str]:
    """Return one word for each name, as MTL has it: without spaces, # and characters that no line holds."""
    return _distinct(names, lambda name: re.sub(r"[\s#]+", "_", printable(name)).strip("_") or "material")


def same_name(name: str, others: Iterable[str]) -> str | None:
    """Return the one of other names that is this one, or this one as a format writes it, or the reverse; else None."""
    others = list(others)
    alike = [other for other in others if _letters(other) == _letters(name)] if _letters(name) else []
    return name if name in others else alike[0] if len(alike) == 1 else None


def _letters(name: str) -> str:
    """Return a name with one _ for all that is neither letter nor digit, and none at its ends."""
    return re.sub(r"[\W_]+", "_", name).strip("_")


def printable(name: str) -> str:
    """Return a name on one line."""
    return "".join(c if c.isprintable() else " " for c in name)


def original(name: str, written: str) -> list[str]:
    """Return the note that keeps a name that is written as another one."""
    return [] if name == written else [f"the name '{printable(name)}' is written as '{written}'."]


def _distinct(names: Iterable[str], change: Callable[[str], str]) -> dict[str, str]:
    """Change names to others, each of them once; names that need no change keep theirs."""
    found = {name: name for name in names if change(name) == name}
    taken = set(found)
    for name in names:
        if name not in found:
            found[name] = unused(change(name), taken)
            taken.add(found[name])
    return {name: found[name] for name in names}
