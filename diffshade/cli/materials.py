"""Materials by name, from any file, and into any file: what `new`, `fit` and `convert` share."""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ..exchange.material_files import Exported
    from ..model.materials import Material

STARTER = """\
# A scene for diffshade: {about}
# Lengths are in units of your own, angles in degrees, colours linear: three numbers (R, G, B), or one for grey.
# Render it with: diffshade render {quoted}

ambient = 1.0      # the light that comes from everywhere
background = 0.0   # what a ray sees that meets nothing

[camera]
eye = [0, 0, 4]    # x right, y up, z towards you; it looks at target = [0, 0, 0]
fov = 35           # the full vertical angle
shape = [256, 256] # height and width in pixels; of a photograph, its own

[[objects]]        # surface may also be a Plane or a Box; write [[objects]] again for another object
surface = {{ type = "Sphere", center = [0, 0, 0], radius = 1.0 }}

[objects.material]
{material}

[[lights]]         # type: PointLight, DirectionalLight, SpotLight or AreaLight
type = "PointLight"
position = [2, 3, 4]
intensity = 0.6
# 1 / (constant + linear d + quadratic d^2) of the distance d
attenuation = {{ constant = 1.0, linear = 0.0, quadratic = 0.0 }}
"""

SAID = ("k_a", "k_d", "k_s", "n_s", "lobe")  # whatever they are; the rest where it is not as usual


def find_material(word: str) -> Material:
    """Return the material of a file, or the named one of the OpenGL teapots."""
    import diffshade as ds

    return ds.read_material(word) if Path(word).suffix else ds.material(word)


def starter(file: Path, material: Material, about: str) -> str:
    """Return a commented scene: a ball of a material under one lamp."""
    from ..io.scene_files import material_table
    from ..model.materials import Material

    usual, table = material_table(Material()), material_table(material)
    lines = [f"{key} = {_inline(value)}" for key, value in table.items() if key in SAID or value != usual.get(key)]
    return STARTER.format(quoted=shlex.quote(file.name), about=about, material="\n".join(lines))


def _inline(value: Any) -> str:
    """Return a value as TOML on one line; a colour of three equal numbers is grey."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {_inline(item)}" for key, item in value.items()) + " }"
    if isinstance(value, list) and len(value) == 3 and len(set(value)) == 1:
        value = value[0]
    return json.dumps(value)


def check_out(paths: Iterable[Path], given: Iterable[Path]) -> None:
    """Refuse, before any work, what cannot be written, is no material's file, or is what is read."""
    from ..exchange.material_files import check_format
    from ..io.files import writable

    read = {path.resolve() for path in given}
    for path in paths:
        if path.suffix.lower() != ".toml":
            check_format(path, also=(".toml",))
        if path.resolve() in read:
            raise ValueError(f"{path} is what is read. Give another name to write to.")
        writable(path)


def put_material(path: Path, material: Material, *, name: str = "", about: str = "") -> Exported | Path:
    """Write a material by its file's suffix: for another program, or (.toml) on a ball in a scene of its own."""
    import diffshade as ds

    from ..io.files import replacing

    if path.suffix.lower() != ".toml":
        return ds.write_material(path, material, name=name or word_of(path))
    text = starter(path, material, about or f"a ball of {word_of(path)}.")
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return path


def word_of(path: Path) -> str:
    """Return a file's stem as a name that every format takes."""
    word = re.sub(r"\W+", "_", path.stem, flags=re.ASCII).strip("_") or "material"
    return (word if word[0].isalpha() or word[0] == "_" else f"_{word}")[:60]
