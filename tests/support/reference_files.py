"""Renders by other programs, tests/support/references/*.npz: the one place that knows their format.

The format is described in the README of the references. `gl_`, `pov_` and `vtk_` hold points, normals, a mask and the
colours that OpenGL, POV-Ray or VTK gave them, with the scene in JSON; `refraction_` holds where bent rays end.
"""

import json
from dataclasses import dataclass
from pathlib import Path

import jax
import numpy as np

import diffshade as ds
from diffshade.model.cameras import AbstractCamera
from diffshade.model.lights import AbstractLight
from diffshade.model.rendering import pixel_rays
from diffshade.model.surfaces import AbstractSolid
from diffshade.model.transmission import bend
from diffshade.model.vectors import where

FOLDER = Path(__file__).parent / "references"
# the other programs' own float32 and 16-bit rounding
TOLERANCES = {"gl": 2e-5, "pov": 2e-5, "vtk": 3e-5, "refraction": 6.2e-5}
PROGRAMS = {"gl": "OpenGL", "pov": "POV-Ray", "vtk": "VTK", "refraction": "POV-Ray"}
LOBES = {"blinn": ds.Blinn, "phong": ds.Phong}
MATERIAL = {"ambient", "diffuse", "specular", "shininess", "emission", "transmit"}
LIGHTS = {
    "directional": {"to_light"},
    "point": {"position", "attenuation", "pov_fade"},
    "spot": {"position", "attenuation", "spot_direction", "spot_cutoff_deg", "spot_exponent"},
    "pov_spot": {"position", "attenuation", "pov_fade", "spot_direction", "radius_deg", "falloff_deg", "tightness"},
    "area": {"corner", "edge_u", "edge_v", "samples", "attenuation", "pov_fade", "spot_cutoff_deg", "spot_exponent"},
}
FOG = {"mode", "start", "end", "density", "color", "distance"}


@dataclass(frozen=True)
class Shading:
    """What another program rendered: `scene`, shaded at the points of `gbuffer`, plus `add_after`.

    `expected` is linear and NaN outside the mask.
    """

    program: str
    tolerance: float
    expected: np.ndarray
    mask: np.ndarray
    scene: ds.Scene
    gbuffer: ds.GBuffer
    camera: AbstractCamera
    add_after: np.ndarray

    def found(self) -> np.ndarray:
        """Return what the library renders."""
        return np.asarray(ds.shade(self.scene, self.gbuffer, self.camera)) + self.add_after


@dataclass(frozen=True)
class Refraction:
    """Where another program saw each pixel's ray, bent by a solid of index `eta`, meet a plane: x and y there."""

    program: str
    tolerance: float
    expected: np.ndarray
    mask: np.ndarray
    solid: AbstractSolid
    eta: np.ndarray
    plane: ds.Plane
    camera: AbstractCamera

    def found(self) -> np.ndarray:
        """Return where the library's rays meet it."""
        return np.asarray(_ends(self.solid, self.eta, self.plane, self.camera))


@jax.jit
def _ends(solid, eta, plane, camera):
    rays = pixel_rays(camera.projection(), camera.shape)
    hit = solid.intersect(rays)
    way, through = bend(solid, rays, hit, eta)
    p = plane.intersect(where(hit.inside, way.outer, rays)).p.stack()
    nowhere = (hit.inside & ~through)[..., None]
    return jax.numpy.where(nowhere, jax.numpy.nan, p[..., :2])


def read_reference(path: Path) -> Shading | Refraction:
    """Read one file. Raises NotImplementedError for what the model does not have, or this reader does not know."""
    kind = path.name.split("_")[0]
    if kind not in PROGRAMS:
        raise NotImplementedError(f"{path.name} begins with none of {', '.join(PROGRAMS)}.")
    with np.load(path) as file:
        params = json.loads(str(file["params"]))
        arrays = {name: file[name] for name in file.files if name != "params"}
    program, tolerance = PROGRAMS[kind], TOLERANCES[kind]
    if kind == "refraction":
        solid, mask = _solid(path.name, params), arrays["mask"]
        plane = ds.Plane((0, 0, params["plane_z"]), (0, 0, 1))
        eye = np.asarray(params["eye"], float)
        camera = _camera({**params, "view": (0, 0, 1), "local_viewer": True}, eye, mask)
        return Refraction(
            program, tolerance, arrays["hit"], mask, solid, np.asarray(params["eta"], float), plane, camera
        )
    gbuffer = ds.GBuffer(arrays["N"], arrays["P"], arrays["mask"])
    mask = np.asarray(gbuffer.mask)
    camera = _camera(params, arrays["eye"], mask)
    scene = _scene(path.name, params, gbuffer)
    add_after = np.asarray(params.get("add_after", (0.0, 0.0, 0.0)))
    return Shading(program, tolerance, arrays["rgb"], mask, scene, gbuffer, camera, add_after)


def _solid(name: str, params: dict) -> AbstractSolid:
    if params["solid"] == "sphere":
        return ds.Sphere()
    if params["solid"] == "slab":
        top, bottom = max(params["slab"]), min(params["slab"])
        return ds.Box((0, 0, (top + bottom) / 2), (1e3, 1e3, top - bottom))
    raise NotImplementedError(f"{name} has the solid {params['solid']}; the reader knows sphere and slab.")


def _camera(params: dict, eye: np.ndarray, mask: np.ndarray) -> AbstractCamera:
    """Where points are given, only the viewer matters and how deep they lie along `view`, the backward axis."""
    view = np.asarray(params["view"], float)
    up = (0, 0, 1) if np.allclose(np.cross(view, (0, 1, 0)), 0) else (0, 1, 0)
    here = {"eye": eye, "target": eye - view, "up": up, "shape": mask.shape, "local_viewer": params["local_viewer"]}
    camera = params["camera"]
    if camera["type"] == "ortho":
        return ds.OrthographicCamera(**here, height=2 * camera["half"])
    return ds.Camera(**here, fov=2 * np.rad2deg(np.arctan(camera["tan_half"])))


def _scene(name: str, params: dict, gbuffer: ds.GBuffer) -> ds.Scene:
    given = params["material"]
    _refuse_unknown(f"{name}: material", given, MATERIAL)
    material = ds.Material(
        k_a=given["ambient"],
        k_d=given["diffuse"],
        k_s=given["specular"],
        n_s=given["shininess"],
        k_e=given.get("emission", 0.0),
        lobe=LOBES[params["model"]](),
    )
    air = _fog(f"{name}: fog", params["fog"]) if params.get("fog") else None
    lights = [_light(f"{name}: lights[{i}]", light) for i, light in enumerate(params["lights"])]
    return ds.Scene(ds.Object(gbuffer, material), lights, params["global_ambient"], atmosphere=air)


def _fog(name: str, fog: dict) -> ds.DepthCueing | ds.Fog:
    _refuse_unknown(name, fog, FOG)
    mode, distance = fog["mode"], fog.get("distance", "eye_z")
    if distance not in ("eye_z", "radial"):
        raise NotImplementedError(f"{name} has the distance {distance}; the reader knows eye_z and radial.")
    if mode == "linear":
        return ds.DepthCueing(fog["start"], fog["end"], I_dc=fog["color"], radial=distance == "radial")
    if mode not in ("exp", "exp2"):
        raise NotImplementedError(f"{name} has the mode {mode}; the reader knows linear, exp and exp2.")
    return ds.Fog(fog["density"], I_dc=fog["color"], squared=mode == "exp2", radial=distance == "radial")


def _light(name: str, light: dict) -> AbstractLight:
    if light["type"] not in LIGHTS:
        raise NotImplementedError(f"{name} is of type {light['type']}; the reader knows {', '.join(LIGHTS)}.")
    _refuse_unknown(name, light, LIGHTS[light["type"]] | {"type", "diffuse", "specular", "ambient"})
    intensity = light["diffuse"]
    apart = {} if light["specular"] == intensity else {"specular": light["specular"]}
    apart |= {"ambient": light["ambient"]} if any(light.get("ambient", ())) else {}
    match light["type"]:
        case "directional":
            return ds.DirectionalLight(-np.asarray(light["to_light"], float), intensity, **apart)
        case "point":
            return ds.PointLight(light["position"], intensity, _attenuation(name, light), **apart)
        case "area":
            where = (light["corner"], light["edge_u"], light["edge_v"])
            cone = {"cutoff": light.get("spot_cutoff_deg", 90.0), "exponent": light.get("spot_exponent", 1.0)}
            more = {"attenuation": _attenuation(name, light), "samples": tuple(light["samples"])}
            return ds.AreaLight(*where, intensity, **cone, **more, **apart)
        case "spot":
            cutoff, exponent, softness = light["spot_cutoff_deg"], light["spot_exponent"], 0.0
        case _:  # pov_spot
            cutoff, exponent = light["falloff_deg"], light["tightness"]
            softness = cutoff - light["radius_deg"]
    direction, attenuation = light["spot_direction"], _attenuation(name, light)
    return ds.SpotLight(light["position"], direction, intensity, cutoff, exponent, attenuation, softness, **apart)


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
