"""OpenGL's fixed function as C: glMaterial and glLight (OpenGL 1.0 to 3.0; Blinn's lobe, shininess 0 to 128).

It computes exactly E1 to E6 and E9, at the vertices of the mesh.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from ..core.words import errors_at
from ..io.parsing import NUMBER, number, short, without_long_comments
from ..model.attenuation import RadialAttenuation
from ..model.lights import AbstractLight, DirectionalLight, PointLight, SpotLight
from ..model.lobes import Blinn
from ..model.materials import Material
from .exports import Draft, comment, notes_on_glass, notes_on_refit, opacity, plain, together
from .lobe_refits import with_lobe
from .names import identifiers, original
from .readings import Reading, read_declared

MAX_N_S = 128.0  # GL_SHININESS and GL_SPOT_EXPONENT at most
MAX_LIGHTS = 8
_ARRAY = re.compile(r"\b(\w{1,80})\s*\[\s*\d*\s*\]\s*=\s*\{([^{}]*)\}", re.ASCII)
_CALL = re.compile(r"\bgl(Material|Light)f(v?)\s*\(\s*(\w{1,80})\s*,\s*(\w{1,80})\s*,\s*([^;]{1,400})\)\s*;", re.ASCII)
_FUNCTION = re.compile(r"\bvoid\s{1,9}(\w{1,80})_material\s{0,9}\(", re.ASCII)
_COLOURS = {"GL_AMBIENT": "k_a", "GL_DIFFUSE": "k_d", "GL_SPECULAR": "k_s", "GL_EMISSION": "k_e"}


def write_opengl(materials: Mapping[str, Material], lights: Sequence[AbstractLight]) -> Draft:
    """Return the C functions `NAME_material` of each material and, with lights, `NAME_lights` of the first name."""
    names = identifiers(materials)
    draft = together({name: _written(name, names[name], material) for name, material in materials.items()}, "\n")
    if lights:
        calls, notes = _lights(lights)
        text = comment(notes, "//") if notes else ""
        text = f"{draft.text}\n{text}{_function(f'{next(iter(names.values()))}_lights', calls)}\n"
        draft = draft._replace(text=text, notes=(*draft.notes, *notes))
    return draft


def _written(name: str, word: str, material: Material) -> Draft:
    refit = with_lobe(material, Blinn(), highest_n_s=MAX_N_S)
    m, alpha = refit.material, opacity(material)
    notes = [*original(name, word), *notes_on_refit(refit)]
    notes += notes_on_glass(material, "OpenGL", colour=False, eta=False)
    if alpha < 1:
        notes.append("k_t is the alpha of GL_DIFFUSE: enable GL_BLEND, and draw transparent objects last.")
    calls = [
        _set(f"glMaterialfv(GL_FRONT_AND_BACK, {key}", [*np.asarray(getattr(m, field)), alpha])
        for key, field in _COLOURS.items()
    ]
    calls.append(f"    glMaterialf(GL_FRONT_AND_BACK, GL_SHININESS, {_floats(m.n_s)});")
    notes.append("k_a is for an ambient light of 1. OpenGL shades per vertex: use a fine mesh.")
    text = f"{comment(notes, '//')}\n{_function(f'{word}_material', calls)}\n"
    return Draft(text, refit.rms, refit.largest, tuple(notes))


def _function(name: str, body: list[str]) -> str:
    return "\n".join([f"static void {name}(void)", "{", *body, "}"])


def _set(call: str, values: Any) -> str:
    return f"    {call}, (GLfloat[]){{{_floats(values)}}});"


def _floats(values: Any) -> str:
    return plain(values, after="f")


def _lights(lights: Sequence[AbstractLight]) -> tuple[list[str], list[str]]:
    if len(lights) > MAX_LIGHTS:
        raise ValueError(f"OpenGL has {MAX_LIGHTS} lights; got {len(lights)}. Give the brightest {MAX_LIGHTS}.")
    calls, notes = ["    glLightModeli(GL_LIGHT_MODEL_LOCAL_VIEWER, GL_TRUE);"], []
    calls.append("    glLightModelfv(GL_LIGHT_MODEL_AMBIENT, (GLfloat[]){1.0f, 1.0f, 1.0f, 1.0f});")
    for i, light in enumerate(lights):
        if not isinstance(light, PointLight | DirectionalLight | SpotLight):
            raise ValueError(
                f"OpenGL has no {type(light).__name__}; got one as lights[{i}]. Give point, directional or spot "
                "lights, for example as_spot(lamp).light."
            )
        if isinstance(light, DirectionalLight):
            place = [*(-np.asarray(light.direction) / np.linalg.norm(light.direction)), 0.0]
        else:
            place = [*np.asarray(light.position), 1.0]
        specular = light.intensity if light.specular is None else light.specular
        ambient = np.zeros(3) if light.ambient is None else light.ambient
        colours = {"DIFFUSE": light.intensity, "SPECULAR": specular, "AMBIENT": ambient}
        vectors = {"POSITION": place, **{key: [*np.asarray(colour), 1.0] for key, colour in colours.items()}}
        single: dict[str, Any] = {}
        if not isinstance(light, DirectionalLight):
            law = light.attenuation
            if not isinstance(law, RadialAttenuation):
                raise ValueError(
                    f"OpenGL has no {type(law).__name__}, as lights[{i}] has. Give it the RadialAttenuation nearest to "
                    "it, for example fit_falloff(d, law(d)).attenuation."
                )
            single |= {f"{name.upper()}_ATTENUATION": getattr(law, name) for name in law.numbers()}
            notes += [f"OpenGL does not clamp attenuation at 1, as lights[{i}] does."] if law.clamp else []
            notes += [f"OpenGL has no flaps: those of lights[{i}] are not written."] if light.flaps is not None else []
        if isinstance(light, SpotLight):
            vectors["SPOT_DIRECTION"] = list(np.asarray(light.direction))
            single |= {"SPOT_CUTOFF": light.cutoff, "SPOT_EXPONENT": min(float(light.exponent), MAX_N_S)}
            if light.exponent > MAX_N_S:
                notes.append(
                    f"the exponent of lights[{i}], {float(light.exponent):g}, is written as 128, OpenGL's highest."
                )
            if light.softness > 0:
                notes.append(f"OpenGL's spots have a hard edge: the softness of lights[{i}] is not written.")
        calls += [_set(f"glLightfv(GL_LIGHT{i}, GL_{key}", value) for key, value in vectors.items()]
        calls += [f"    glLightf(GL_LIGHT{i}, GL_{key}, {_floats(value)});" for key, value in single.items()]
        calls.append(f"    glEnable(GL_LIGHT{i});")
    return calls, notes


def read_opengl(text: str, where: str) -> Reading:
    """Read the material that each function NAME_material sets by glMaterial, or else the one that all calls set.

    Other parameters have OpenGL's defaults.
    """
    return read_declared(text, _FUNCTION, where, _read)


def _read(text: str, where: str, note: Callable[[str], None]) -> Material:
    all_ = _calls(text, "Material", where)
    set_ = [call for call in all_ if call[0] != "GL_BACK"] or all_
    if len(set_) < len(all_):
        note("the material of GL_BACK is not read.")
    if not set_:
        raise ValueError(f"{where} has no call of glMaterial. Give C code with glMaterialfv(face, GL_DIFFUSE, ...).")
    values = {"GL_AMBIENT": [0.2] * 3, "GL_DIFFUSE": [0.8] * 3, "GL_SPECULAR": [0.0] * 3, "GL_EMISSION": [0.0] * 3}
    values["GL_SHININESS"] = [0.0]
    for _, key, value in set_:
        if key not in (*values, "GL_AMBIENT_AND_DIFFUSE"):
            note(f"{short(key)} is not read.")
        for name in ("GL_AMBIENT", "GL_DIFFUSE") if key == "GL_AMBIENT_AND_DIFFUSE" else (key,):
            values[name] = value
    for name in _COLOURS:
        if len(values[name]) not in (3, 4):
            raise ValueError(f"{where}: {name} must be four numbers; got {len(values[name])}. Give R, G, B and alpha.")
    n_s = values["GL_SHININESS"][0]
    if not 0 <= n_s <= MAX_N_S:
        raise ValueError(f"{where}: GL_SHININESS must be 0 to 128, as in OpenGL; got {n_s:g}. Correct the file.")
    alpha = values["GL_DIFFUSE"][3] if len(values["GL_DIFFUSE"]) == 4 else 1.0
    glass: dict[str, Any] = {"k_t": 1.0 - alpha} if alpha != 1 else {}
    given = {field: values[key][:3] for key, field in _COLOURS.items()}
    return Material(**given, n_s=n_s, lobe=Blinn(), **glass)


def read_opengl_lights(text: str, where: str) -> tuple[AbstractLight, ...]:
    """Read the lights that calls of glLight set, in the order of their numbers."""
    lights: dict[str, dict[str, list[float]]] = {}
    for target, key, value in _calls(text, "Light", where):
        lights.setdefault(target, {})[key] = value
    with errors_at(where):
        return tuple(_light(lights[target], float(target == "GL_LIGHT0")) for target in sorted(lights))


def _light(set_: dict[str, list[float]], white: float) -> AbstractLight:
    """Make a light of what is set; `white` is OpenGL's default of its diffuse and specular colours."""

    def one(key: str, default: float) -> float:
        return set_.get(f"GL_{key}", [default])[0]

    place = [*set_.get("GL_POSITION", [0.0, 0.0, 1.0, 0.0]), 0.0, 0.0, 0.0, 0.0][:4]
    rgb, specular, ambient = (
        [*set_.get(f"GL_{key}", [default] * 3), 0.0, 0.0, 0.0][:3]
        for key, default in (("DIFFUSE", white), ("SPECULAR", white), ("AMBIENT", 0.0))
    )
    apart: dict[str, Any] = {"specular": specular} if specular != rgb else {}
    apart |= {"ambient": ambient} if any(ambient) else {}
    if place[3] == 0:
        return DirectionalLight(-np.asarray(place[:3]), rgb, **apart)
    position = np.asarray(place[:3]) / place[3]
    names = RadialAttenuation.numbers()
    constant, linear, quadratic = (one(f"{name.upper()}_ATTENUATION", float(i == 0)) for i, name in enumerate(names))
    fades = RadialAttenuation(constant, linear, quadratic)
    cutoff = one("SPOT_CUTOFF", 180.0)
    if cutoff == 180:
        return PointLight(position, rgb, fades, **apart)
    axis = [*set_.get("GL_SPOT_DIRECTION", [0.0, 0.0, -1.0]), 0.0, 0.0, 0.0][:3]
    return SpotLight(position, axis, rgb, cutoff, one("SPOT_EXPONENT", 0.0), fades, **apart)


def _calls(text: str, of: str, where: str) -> list[tuple[str, str, list[float]]]:
    """Return the target, the name and the numbers of each call; an array is named, or written in the call."""
    text = re.sub(r"//[^\n]*", " ", without_long_comments(text))
    arrays = dict(_ARRAY.findall(text))
    found = []
    for kind, _, target, key, argument in _CALL.findall(text):
        if kind != of:
            continue
        argument = argument.strip()
        inside = argument.partition("{")[2].rpartition("}")[0] if "{" in argument else arrays.get(argument, argument)
        words = [word.strip().removesuffix("f").removesuffix("F") for word in inside.split(",") if word.strip()]
        if not words or not all(NUMBER.fullmatch(word) for word in words):
            raise ValueError(
                f"{where}: {key} must be given numbers; got {short(argument)}. Write them out in the array."
            )
        found.append((target, key, [number(word, f"{where}: {key}") for word in words]))
    return found
