"""Scene files: a scene and its camera as TOML that people read and write.

Numbers of every pixel (a G-buffer, maps of a coefficient) are .npy files beside it, which it names.
"""

from __future__ import annotations

import dataclasses
import inspect
import tomllib
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

import equinox as eqx
import numpy as np

from ..core.fields import is_over_pixels
from ..core.words import did_you_mean, errors_at
from ..model.area_lights import AreaLight
from ..model.attenuation import DepthCueing, Fog, RadialAttenuation
from ..model.cameras import AbstractCamera, Camera, OrthographicCamera
from ..model.flaps import Flaps
from ..model.fresnel import Dielectric, NoFresnel, Schlick
from ..model.gbuffers import GBuffer
from ..model.lights import DirectionalLight, PointLight, SpotLight
from ..model.lobes import Blinn, Brushed, Phong
from ..model.materials import Highlight, Material
from ..model.measured_lights import LampLabel, MeasuredLight, Profile
from ..model.named_materials import material_names
from ..model.patterns import Chequer
from ..model.scenes import Object, Scene
from ..model.surfaces import Box, Plane, Sphere
from .arrays import read_array, write_array
from .files import writable, write_file
from .lamps.lamp_files import read_lamp

# The classes of a table by its key; where there is a choice, `type` names one, the first by default.
_TYPES: dict[str, tuple[type[eqx.Module], ...]] = {
    "camera": (Camera, OrthographicCamera),
    "objects": (Object,),
    "surface": (Sphere, Plane, Box, GBuffer),
    "material": (Material,),
    "lobe": (Phong, Blinn, Brushed),
    "highlights": (Highlight,),
    "fresnel": (NoFresnel, Schlick, Dielectric),
    "lights": (PointLight, DirectionalLight, SpotLight, AreaLight, MeasuredLight),
    "attenuation": (RadialAttenuation,),
    "flaps": (Flaps,),
    "profile": (Profile,),
    "label": (LampLabel,),
    "atmosphere": (DepthCueing, Fog),
    **dict.fromkeys(("k_a", "k_d", "k_s", "k_e", "k_t"), (Chequer,)),
}
# may be an array over the pixels
_MAPPED = ("k_a", "k_d", "k_s", "k_e", "k_t", "n_s", "normal", "position", "mask")
_SEVERAL = ("objects", "lights", "highlights")
_PRODUCTS = ("k_a", "k_d", "k_s")  # of a table foley


def read_scene(path: str | Path) -> Scene:
    """Read the scene of a TOML file: `ambient`, `background`, `bands`, `[atmosphere]`, `[[objects]]`, `[[lights]]`.

    Names are those of the classes and their fields; where there is a choice of classes, `type` names one. A light with
    `file = "lamp.ies"`, a path from the scene's folder, is that lamp; `direction`, `side`, `lamp_set` and `tilt` (a
    path too) are those of `read_lamp`, and its table's other keys replace the lamp's fields. A table
    `[objects.material.foley]` of O_d, O_s, k_a, k_d and k_s stands for their products, as in `Material.foley`.

    Args:
        path: The TOML file; its table `[camera]` is ignored.

    Returns:
        The scene.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: The file is not a valid scene; one sentence names the file, the table and the key.
    """
    document = _load(path)
    document.pop("camera", None)
    if isinstance(document.get("lights"), list):
        document["lights"] = [_with_lamp(light, Path(path), i) for i, light in enumerate(document["lights"])]
    return _build(Scene, document, f"{path}")


def read_camera(path: str | Path) -> AbstractCamera:
    """Read the camera of a TOML scene file, its table `[camera]`.

    Args:
        path: The TOML file; `type` in its table is "Camera" (default) or "OrthographicCamera".

    Returns:
        The camera.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: The file has no valid camera; one sentence names the file, the table and the key.
    """
    document = _load(path)
    if "camera" not in document:
        raise ValueError(f"{path} has no table [camera]. Add one, for example with eye = [0, 0, 4] and fov = 35.")
    return _value("camera", document["camera"], f"{path}: camera")


def write_scene(path: str | Path, scene: Scene, *, camera: AbstractCamera | None = None) -> list[Path]:
    """Write a scene, and optionally a camera, as TOML that `read_scene` and `read_camera` read back exactly.

    Args:
        path: The TOML file. Arrays over the pixels, such as those of a G-buffer, are written beside it, as for example
            `scene.objects.0.surface.normal.npy`.
        scene: The scene.
        camera: The camera; none is written by default.

    Returns:
        The paths of the files.

    Raises:
        ValueError: The scene cannot be written as TOML, for example because it contains a `Texture`.
        FileNotFoundError: The folder does not exist.
        PermissionError: The folder is not writable.
        IsADirectoryError: `path` is a folder.
    """
    import tomli_w

    path = Path(path)
    document, arrays = scene_document(scene, camera, stem=path.stem)
    writable(path)
    for name, array in arrays.items():
        write_array(path.with_name(name), array)
    write_file(path, tomli_w.dumps(document))
    return [*(path.with_name(name) for name in arrays), path]


def scene_document(
    scene: Scene, camera: AbstractCamera | None = None, *, stem: str = "scene"
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Return a scene as the table that `read_scene` reads, and the arrays that it names by their files.

    Args:
        scene: The scene.
        camera: The camera; none by default.
        stem: What the names of the files begin with.

    Raises:
        ValueError: The scene cannot be written as TOML.
    """
    arrays: dict[str, np.ndarray] = {}
    document = _table(scene, stem, arrays)
    if camera is not None:
        document["camera"] = _plain("camera", camera, stem, arrays)
    return document, arrays


def material_table(material: Material) -> dict[str, Any]:
    """Return a material as the table that `read_scene` reads it from; refuse arrays over the pixels."""
    return _table(material, "", None)


def _load(path: str | Path) -> dict[str, Any]:
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"there is no scene file {path}. Give the path of a TOML file.")
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8"))
    except RecursionError:
        raise ValueError(f"{path} is no scene: its lists are nested too deeply. Write them flat.") from None
    except ValueError as error:  # invalid TOML, invalid UTF-8, or a number with too many digits
        raise ValueError(f"{path} is no TOML: {error}. Mend that line.") from None
    _check_keys(document, [*(field.name for field in dataclasses.fields(Scene)), "camera"], f"{path}")
    return _with_arrays(document, path)


def _with_arrays(value: Any, path: Path) -> Any:
    """Return a document with the arrays that it names by their files."""
    if isinstance(value, list):
        return [_with_arrays(item, path) for item in value]
    if not isinstance(value, dict):
        return value
    found = {}
    for key, item in value.items():
        if key in _MAPPED and isinstance(item, str) and item.endswith(".npy"):
            if Path(item).name != item:
                raise ValueError(f"{path}: {key} must be the name of a .npy file beside it; got {item!r}. Mend it.")
            found[key] = read_array(path.with_name(item))
        else:
            found[key] = _with_arrays(item, path)
    return found


def _with_lamp(light: Any, path: Path, i: int) -> Any:
    """Return a light's table, with the fields of the lamp file that it names."""
    if not isinstance(light, dict) or "file" not in light:
        return light
    where, own = f"{path}: lights[{i}]", {key: value for key, value in light.items() if key != "file"}
    if own.get("type", "MeasuredLight") != "MeasuredLight" or "profile" in own:
        raise ValueError(f"{where} has a file, which is a MeasuredLight with its profile. Leave out type and profile.")
    for key in ("file", "tilt"):
        if not isinstance(light.get(key, ""), str):
            raise ValueError(f"{where}.{key} must be the name of a file; got {light[key]!r}. Write it in quotes.")
    given = {key: own[key] for key in ("direction", "side") if key in own}
    given |= {key: own.pop(key) for key in ("lamp_set",) if key in own}
    given |= {"tilt": path.parent / own.pop("tilt")} if "tilt" in own else {}
    with errors_at(where):
        lamp = read_lamp(path.parent / light["file"], **given)
    return {"type": "MeasuredLight", **_table(lamp, "", None), **own}


def _check_keys(table: dict[str, Any], known: Collection[str], where: str) -> None:
    for key in table:
        if key not in known:
            raise ValueError(f"{where} has no key '{key}'. {did_you_mean(key, known)}")


def _build(cls: type, table: Any, where: str) -> Any:
    """Make a `cls` of a table whose keys are its fields."""
    fields = {field.name: field for field in dataclasses.fields(cls)}
    if not isinstance(table, dict):
        raise ValueError(f"{where} must be a table of {', '.join(fields)}; got {table!r}. Write it as [table].")
    _check_keys(table, fields, where)
    values, parameters = {}, inspect.signature(cls).parameters
    for key, field in fields.items():
        if key in table:
            values[key] = _value(key, table[key], f"{where}: {key}" if cls is Scene else f"{where}.{key}")
            if field.type in (str, "str") and not isinstance(values[key], str):
                raise ValueError(f"{where}.{key} must be a word; got {values[key]!r}. Write it in quotes.")
            if field.type in (bool, "bool") and not isinstance(values[key], bool):
                raise ValueError(f"{where}.{key} must be true or false; got {values[key]!r}. Write one of the two.")
        elif key in parameters and parameters[key].default is inspect.Parameter.empty:
            raise ValueError(f"{where} needs the key '{key}' of a {cls.__name__}. Add it.")
    with errors_at(where):
        return cls(**values)


def _value(key: str, value: Any, where: str) -> Any:
    """Make the value of a key: a module, several, or a plain value."""
    if key not in _TYPES or (key.startswith("k_") and not isinstance(value, dict)):
        if not isinstance(value, bool | int | float | str | list | np.ndarray):
            got = "a table" if isinstance(value, dict) else f"{value}"
            raise ValueError(f"{where} must be a number, a word or a list; got {got}. Write it as {key} = ...")
        return value
    if isinstance(value, list) and key in _SEVERAL:
        return tuple(_value(key, item, f"{where}[{i}]") for i, item in enumerate(value))
    types = _types_of(key)
    if key == "material" and isinstance(value, str) and value != "Material":  # probably the name of a material
        named = value if value in material_names() else "emerald"
        raise ValueError(
            f"{where} must be a table of coefficients; got '{value}'. Write them out, as write_scene does those of "
            f"material('{named}')."
        )
    if isinstance(value, str):
        value = {"type": value}
    name = value.get("type", next(iter(types))) if isinstance(value, dict) else next(iter(types))
    if not isinstance(name, str) or name not in types:
        own = " A class of your own must be imported first." if _bases(key) else ""
        raise ValueError(f"{where} has no type '{name}'. {did_you_mean(str(name), types)}{own}")
    if isinstance(value, dict) and "type" not in value:
        _check_default(value, types, where)
    table = {k: v for k, v in value.items() if k != "type"} if isinstance(value, dict) else value
    if types[name] is Material and isinstance(table, dict) and "foley" in table:
        table = _multiplied(table, where)
    return _build(types[name], table, where)


def _multiplied(table: dict[str, Any], where: str) -> dict[str, Any]:
    """Return a material's table with the products of its table `foley` in place of that (E10)."""
    form, own = table["foley"], {key: value for key, value in table.items() if key != "foley"}
    if not isinstance(form, dict) or "O_d" not in form:
        raise ValueError(f"{where}.foley must be a table with O_d, and O_s, k_a, k_d and k_s as needed. Write it so.")
    _check_keys(form, ("O_d", "O_s", *_PRODUCTS), f"{where}.foley")
    if twice := [key for key in _PRODUCTS if key in own]:
        raise ValueError(f"{where}.{twice[0]} is given beside foley, which makes it a product. Leave one of them out.")
    with errors_at(where):
        material = Material.foley(**form)
    return own | {key: getattr(material, key) for key in _PRODUCTS}


def _types_of(key: str) -> dict[str, type[eqx.Module]]:
    """Return the classes that may stand at a key, by name: the library's, the default first, and users' own."""
    own = {cls.__name__: cls for base in _bases(key)[-1:] for cls in _own_classes(base)}
    library = {cls.__name__: cls for cls in _TYPES[key]}
    return library | {name: cls for name, cls in own.items() if name not in library}


def _bases(key: str) -> list[type[eqx.Module]]:
    """Return the abstract classes of what stands at a key, the most general last; none where users derive no own."""
    return [base for base in _TYPES[key][0].__mro__ if inspect.isabstract(base) and issubclass(base, eqx.Module)]


def _own_classes(base: type[eqx.Module]) -> Iterator[type[eqx.Module]]:
    """Yield the classes outside this package that derive from a base and can be made."""
    for cls in base.__subclasses__():
        yield from _own_classes(cls)
        if not (inspect.isabstract(cls) or cls.__module__.startswith("diffshade.")):
            yield cls


def _check_default(table: dict[str, Any], types: dict[str, type], where: str) -> None:
    """Name the intended type if a table names none and its keys are those of a type other than the default."""
    keys = {name: {field.name for field in dataclasses.fields(cls)} for name, cls in types.items()}
    default, *others = keys
    strange = [key for key in table if key not in keys[default]]
    meant = [name for name in others if keys[name].issuperset(table)]
    if strange and meant:
        raise ValueError(
            f"{where} without a type is a {default}, which has no key '{strange[0]}'. Write type = \"{meant[0]}\"."
        )


def _table(module: eqx.Module, at: str, arrays: dict[str, np.ndarray] | None) -> dict[str, Any]:
    """Return a module as a table.

    Args:
        module: The module.
        at: Where it is in the document, for the names of files.
        arrays: Where arrays over the pixels are put, by the names of their files; None refuses them.
    """
    table: dict[str, Any] = {}
    for field in dataclasses.fields(module):
        value = getattr(module, field.name)
        if value is not None and not (isinstance(value, str | tuple) and not value):  # what is not given is left out
            table[field.name] = _plain(field.name, value, f"{at}.{field.name}", arrays)
    return table


def _plain(key: str, value: Any, at: str, arrays: dict[str, np.ndarray] | None) -> Any:
    if isinstance(value, tuple) and key in _TYPES:
        return [_plain(key, item, f"{at}.{i}", arrays) for i, item in enumerate(value)]
    if isinstance(value, eqx.Module):
        name = type(value).__name__
        if key not in _TYPES or type(value) is not _types_of(key).get(name):
            raise ValueError(f"a {name} has no form in TOML. Write its arrays with numpy.save, the rest as a scene.")
        fields = _table(value, at, arrays)
        if not fields:
            return name
        return {"type": name, **fields} if len(_TYPES[key]) > 1 or _bases(key) else fields
    if isinstance(value, bool | str):
        return value
    if is_over_pixels(value) and key in _MAPPED:
        if arrays is None:
            raise ValueError(
                f"{key} is an array over {np.shape(value)[:2]} pixels, which has no form in a table. Write it with "
                "numpy.save, and the rest as a scene."
            )
        arrays[f"{at}.npy"] = np.asarray(value)
        return f"{at}.npy"
    return np.asarray(value).tolist()
