"""Materials by name or from files, and their files: shared by `new`, `fit` and `convert`."""

from __future__ import annotations

import json
import math
import re
import shlex
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import diffshade as ds

    from ..exchange.base_colours import BaseColour
    from ..exchange.material_files import Exported

STARTER = """\
# A scene for diffshade: {about}
# Lengths are in any unit, angles in degrees. Colours are linear: three numbers (R, G, B), or one for grey.
# Lines after a # that look like keys are all that a scene may have, with their defaults where there are some.
# Render it with: diffshade render {quoted}

ambient = 1.0      # the ambient light
background = 0.0   # the radiance of a ray that hits nothing
# bands = [650, 550, 450]  # the channels in place of R, G, B: wavelengths in nm, names, or how many (up to 40)
# shadows = true     # a light reaches a point only if nothing opaque stands between
# atmosphere = {{ type = "Fog", density = 0.1, I_dc = 0.0, squared = false, radial = false }}
# atmosphere = {{ type = "DepthCueing", z_f = 1.0, z_b = 10.0, s_f = 1.0, s_b = 0.0, I_dc = 0.0, radial = false }}

[camera]
eye = [0, 0, 4]    # x right, y up, z towards you
fov = 35           # the full vertical angle
shape = [256, 256] # height and width in pixels; for a fit, those of the photograph
# target = [0, 0, 0]
# up = [0, 1, 0]
# local_viewer = true             # false: the viewer is far away for the shading
# principal_point = [128, 128]    # column and row of the pixel that the axis meets
# aspect = 1.0                    # width over height of a pixel
# In place of fov: a camera far away, which sees a part of the scene of this height.
# type = "OrthographicCamera"
# height = 2.2

[[objects]]        # write [[objects]] again for another object
# name = "ball"    # in the names of a fit's parameters
surface = {{ type = "Sphere", center = [0, 0, 0], radius = 1.0 }}
# surface = {{ type = "Plane", point = [0, 0, 0], normal = [0, 1, 0] }}
# surface = {{ type = "Box", center = [0, 0, 0], size = [1, 1, 1], rotation = [0, 0, 0] }}
#                      # or of every pixel: {{ type = "GBuffer", normal = "n.npy", position = "p.npy", mask = "m.npy" }}

[objects.material]
{material}
# in place of k_a, k_d, k_s their products: foley = {{ O_d = [0.7, 0.2, 0.1], O_s = 1, k_a = 0.1, k_d = 1, k_s = 0.4 }}
# k_d = {{ type = "Chequer", a = 0.1, b = 0.9, period = 1.0, smooth = false, u = [1, 0, 0], v = [0, 1, 0] }}
# lobe = {{ type = "Brushed", along = [1, 0, 0], n_v = 10.0 }}    # or "Phong", "Blinn"
# fresnel = "Schlick"                # or "NoFresnel"; "Dielectric" with eta and without k_s
# k_e = 0.0                          # emission
# k_t = 0.5                          # transmission
# eta = 1.5                          # index of refraction
# highlights = [{{ k_s = 0.2, n_s = 200.0, lobe = "Blinn" }}]
# normal = [[[0.0, 0.0, 1.0]]]       # of every pixel of the camera

[[lights]]
type = "PointLight"
position = [2, 3, 4]
intensity = 0.6
# specular = 0.6     # colour of the highlights; that of the intensity where it is left out
# ambient = 0.1      # the light's own ambient, which k_a reflects wherever the light reaches
# 1 / (constant + linear d + quadratic d^2) of the distance d; clamp: at most 1
attenuation = {{ constant = 1.0, linear = 0.0, quadratic = 0.0, clamp = false }}

# [[lights]]
# type = "DirectionalLight"
# direction = [1, -1, -1]            # in which the light travels
# intensity = 0.6

# [[lights]]
# type = "SpotLight"
# position = [2, 3, 4]
# direction = [-2, -3, -4]
# intensity = 0.6
# cutoff = 45.0                      # the half angle
# exponent = 0.0                     # of the cosine off the axis
# softness = 0.0                     # degrees within the cutoff over which the light fades
# attenuation = {{ constant = 1.0 }}
# flaps = {{ x_min = -1.0, x_max = 1.0, softness = 0.1 }}  # also y_min, y_max, z_min, z_max; point and area lights too

# [[lights]]
# type = "AreaLight"
# corner = [-1, 3, 1]
# edge_u = [2, 0, 0]
# edge_v = [0, 0, 2]                 # it shines along edge_u x edge_v
# intensity = 0.6
# cutoff = 90.0
# exponent = 1.0
# samples = [8, 8]
# attenuation = {{ constant = 1.0 }}

# [[lights]]                         # a lamp; in place of profile and label that of a file:
#                                    # file = "lamp.ies", lamp_set = 0 (of a .ldt; or "all"), tilt = "lamp.tlt"
# type = "MeasuredLight"
# position = [0, 3, 0]
# direction = [0, -1, 0]
# profile = {{ vertical = [0, 45, 90], horizontal = [0], values = [[1.0, 0.5, 0.0]] }}
# intensity = 10.0
# attenuation = {{ constant = 0.0, quadratic = 1.0 }}
# side = [1, 0, 0]                   # of the plane C = 0
# label = {{ maker = "", name = "", source = "", watts = 10.0, lumens = 800.0, source_lumens = 1000.0, unit = "cd" }}
"""

BETWEEN, PIXELS = 2.5, 96  # scene units and pixels from ball to ball, where a file's materials become a scene
ALWAYS = ("k_a", "k_d", "k_s", "n_s", "lobe")  # written always; other keys only if they are not the default


def find_material(word: str) -> ds.Material:
    """Return the material of a file, or the one that `ds.material` has by this name."""
    import diffshade as ds

    return ds.exchange.read_material(word) if Path(word).suffix else ds.material(word)


def starter(file: Path, material: ds.Material, about: str) -> str:
    """Return a commented scene: a ball of this material under one lamp."""
    import diffshade as ds

    from ..io.scene_files import material_table

    default, table = material_table(ds.Material()), material_table(material)
    lines = [f"{key} = {_inline(value)}" for key, value in table.items() if key in ALWAYS or value != default.get(key)]
    return STARTER.format(quoted=shlex.quote(file.name), about=about, material="\n".join(lines))


def _inline(value: Any) -> str:
    """Return a value as TOML on one line; a colour of three equal numbers is written as one number."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {_inline(item)}" for key, item in value.items()) + " }"
    if isinstance(value, list) and len(value) == 3 and len(set(value)) == 1:
        value = value[0]
    return json.dumps(value)


def check_out(paths: Iterable[Path], given: Iterable[Path]) -> None:
    """Refuse, before any work, outputs that cannot be written, have no material format, or are inputs too."""
    from ..exchange.material_files import check_format
    from ..io.files import writable

    read = {path.resolve() for path in given}
    for path in paths:
        if path.suffix.lower() != ".toml":
            check_format(path, also=(".toml",))
        if path.resolve() in read:
            raise ValueError(f"{path} is an input file. Give another name for the output.")
        writable(path)


def put_material(path: Path, material: ds.Material, *, about: str = "") -> Exported | Path:
    """Write a material as `put_materials` does, by the name of the file."""
    return put_materials(path, {word_of(path): material}, {}, about=about)


def put_materials(
    path: Path, materials: Mapping[str, ds.Material], bases: Mapping[str, BaseColour], *, about: str = ""
) -> Exported | Path:
    """Write materials for another program, or (.toml) on balls in a scene, depending on the suffix."""
    from ..exchange.material_files import write_textured
    from ..io.files import write_file

    if path.suffix.lower() != ".toml":
        return write_textured(path, materials, bases)
    if len(materials) > 1:
        return _put_balls(path, materials)
    write_file(path, starter(path, next(iter(materials.values())), about or f"a ball of {word_of(path)}."))
    return path


def _put_balls(path: Path, materials: Mapping[str, ds.Material]) -> Path:
    """Write a scene with a ball of each material, in rows, under one light; comments keep names that are changed."""
    import diffshade as ds

    from ..exchange.names import identifiers, printable
    from ..io.files import replacing

    names, columns = identifiers(materials), math.ceil(math.sqrt(len(materials)))
    rows = -(-len(materials) // columns)
    balls = []
    for i, (name, material) in enumerate(materials.items()):
        center = (BETWEEN * (i % columns - (columns - 1) / 2), BETWEEN * ((rows - 1) / 2 - i // columns), 0.0)
        balls.append(ds.Object(ds.Sphere(center, 1.0), material, names[name]))
    scene = ds.Scene(balls, ds.DirectionalLight((-1.0, -1.5, -2.0)), ambient=0.2)
    shape = (round(PIXELS * rows), round(PIXELS * columns))
    camera = ds.OrthographicCamera((0.0, 0.0, 4.0), height=BETWEEN * rows, shape=shape)
    changed = [f"# {word} is '{printable(name)}'\n" for name, word in names.items() if name != word]
    with replacing(path) as temporary:
        ds.write_scene(temporary, scene, camera=camera)
        temporary.write_text("".join(changed) + temporary.read_text(encoding="utf-8"), encoding="utf-8")
    return path


def word_of(path: Path) -> str:
    """Return a file's stem as a name that is valid in every format."""
    word = re.sub(r"\W+", "_", path.stem, flags=re.ASCII).strip("_") or "material"
    return (word if word[0].isalpha() or word[0] == "_" else f"_{word}")[:60]
