"""Renders by other programs, tests/references/*.npz: the one place that knows their format.

The format is described in the README of the references: points, normals, a mask and the colours that OpenGL (gl_),
POV-Ray (pov_) or VTK (vtk_) gave them, with the scene in JSON.
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import diffshade as ds

FOLDER = Path(__file__).parent / "references"
TOLERANCES = {"gl": 2e-5, "pov": 2e-5, "vtk": 3e-5}  # the other programs' own float32 and 16-bit rounding
LOBES = {"blinn": ds.Blinn, "phong": ds.Phong}
MATERIAL = {"ambient", "diffuse", "specular", "shininess", "emission", "transmit"}
LIGHTS = {
    "directional": {"to_light"},
    "point": {"position", "attenuation", "pov_fade"},
    "spot": {"position", "attenuation", "spot_direction", "spot_cutoff_deg", "spot_exponent"},
    "pov_spot": {"position", "attenuation", "pov_fade", "spot_direction", "radius_deg", "falloff_deg", "tightness"},
}


@dataclass(frozen=True)
class Reference:
    """What another program rendered: the sum of `scenes`, each shaded at the points of `gbuffer`, plus `add_after`.

    Two scenes where a light has one colour for the diffuse term and another for the highlight. `rgb` is linear and NaN
    outside the mask.
    """

    scenes: tuple[ds.Scene, ...]
    gbuffer: ds.GBuffer
    camera: ds.Camera | ds.OrthographicCamera
    add_after: np.ndarray
    rgb: np.ndarray
    tolerance: float


def read_reference(path: Path) -> Reference:
    """Read one file. Raises NotImplementedError for what the model does not have yet."""
    with np.load(path) as file:
        params = json.loads(str(file["params"]))
        position, normal, mask, eye, rgb = (file[name] for name in ("P", "N", "mask", "eye", "rgb"))
    if "fog" in params:
        raise NotImplementedError(f"{path.name} has fog, which the model does not have yet.")
    gbuffer = ds.GBuffer(normal, position, mask)
    add_after = np.asarray(params.get("add_after", (0.0, 0.0, 0.0)))
    return Reference(
        _scenes(path.name, params, gbuffer),
        gbuffer,
        _camera(params, eye, mask.shape),
        add_after,
        rgb,
        TOLERANCES[path.name.split("_")[0]],
    )


def _camera(params: dict, eye: np.ndarray, shape: tuple[int, int]) -> ds.Camera | ds.OrthographicCamera:
    """Only the viewer matters: the points are given. With `local_viewer` false it is `view`, the backward axis."""
    view = np.asarray(params["view"], float)
    up = (0, 0, 1) if np.allclose(np.cross(view, (0, 1, 0)), 0) else (0, 1, 0)
    here = {"eye": eye, "target": eye - view, "up": up, "shape": shape, "local_viewer": params["local_viewer"]}
    camera = params["camera"]
    if camera["type"] == "ortho":
        return ds.OrthographicCamera(**here, height=2 * camera["half"])
    return ds.Camera(**here, fov=2 * np.rad2deg(np.arctan(camera["tan_half"])))


def _scenes(name: str, params: dict, gbuffer: ds.GBuffer) -> tuple[ds.Scene, ...]:
    given, lights, lobe = params["material"], params["lights"], LOBES[params["model"]]()
    _refuse_unknown(f"{name}: material", given, MATERIAL)
    if any(given.get("emission", ())):
        raise NotImplementedError(f"{name} has emission, which the model does not have yet.")
    material: dict[str, Any] = {
        "k_a": given["ambient"],
        "k_d": given["diffuse"],
        "k_s": given["specular"],
        "n_s": given["shininess"],
    }

    def scene(colour: str, **changes: Any) -> ds.Scene:
        return ds.Scene(
            ds.Object(gbuffer, ds.Material(**material | changes, lobe=lobe)),
            [_light(f"{name}: lights[{i}]", light, colour) for i, light in enumerate(lights)],
            params["global_ambient"],
        )

    if all(light["diffuse"] == light["specular"] for light in lights):
        return (scene("diffuse"),)
    return scene("diffuse", k_s=0), scene("specular", k_a=0, k_d=0)


def _light(name: str, light: dict, colour: str) -> ds.PointLight | ds.DirectionalLight | ds.SpotLight:
    if light["type"] not in LIGHTS:
        raise NotImplementedError(f"{name} is of type {light['type']}, which the model does not have yet.")
    _refuse_unknown(name, light, LIGHTS[light["type"]] | {"type", "diffuse", "specular", "ambient"})
    if any(light.get("ambient", ())):
        raise NotImplementedError(f"{name} has an ambient colour of its own, which the model does not have.")
    intensity = light[colour]
    match light["type"]:
        case "directional":
            return ds.DirectionalLight(-np.asarray(light["to_light"], float), intensity)
        case "point":
            return ds.PointLight(light["position"], intensity, _attenuation(name, light))
        case "spot":
            cutoff, exponent, softness = light["spot_cutoff_deg"], light["spot_exponent"], 0.0
        case _:  # pov_spot
            cutoff, exponent = light["falloff_deg"], light["tightness"]
            softness = cutoff - light["radius_deg"]
    direction, attenuation = light["spot_direction"], _attenuation(name, light)
    return ds.SpotLight(light["position"], direction, intensity, cutoff, exponent, attenuation, softness)


def _attenuation(name: str, light: dict) -> ds.RadialAttenuation:
    if "pov_fade" not in light:
        return ds.RadialAttenuation(*light.get("attenuation", (1, 0, 0)))
    fade = light["pov_fade"]
    if fade["fade_power"] != 2:
        raise NotImplementedError(f"{name} fades with the power {fade['fade_power']}; the reader knows the power 2.")
    return ds.RadialAttenuation(0.5, 0, 0.5 / fade["fade_distance"] ** 2)  # 2/(1 + (d/fade_distance)^2)


def _refuse_unknown(name: str, table: dict, known: set[str]) -> None:
    unknown = sorted(set(table) - known)
    if unknown:
        raise NotImplementedError(f"{name} has {', '.join(unknown)}, which the reader does not know yet.")
