"""OpenGL's fixed function as C: glMaterial and glLight (OpenGL 1.0 to 3.0; Blinn's lobe, shininess 0 to 128).

It computes exactly E1 to E6 and E9, at the vertices of the mesh.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..model.attenuation import RadialAttenuation
from ..model.lights import AbstractLight, DirectionalLight, PointLight, SpotLight
from ..model.lobes import Blinn
from ..model.materials import Material
from .exports import Draft, comment, notes_on_glass, notes_on_refit, opacity, plain, together
from .lobe_refits import with_lobe
from .names import identifiers, original

MAX_N_S = 128.0  # GL_SHININESS and GL_SPOT_EXPONENT at most
MAX_LIGHTS = 8
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
