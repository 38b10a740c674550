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
    """Read one file."""
    kind = path.name.split("_")[0]
    with np.load(path) as file:
        params = json.loads(str(file["params"]))
        arrays = {name: file[name] for name in file.files if name != "params"}
    program, tolerance = PROGRAMS[kind], TOLERANCES[kind]
    if kind == "refraction":
        solid, mask = _solid(params), arrays["mask"]
        plane = ds.Plane((0, 0, params["plane_z"]), (0, 0, 1))
        eye = np.asarray(params["eye"], float)
        camera = _camera({**params, "view": (0, 0, 1), "local_viewer": True}, eye, mask)
        return Refraction(
            program, tolerance, arrays["hit"], mask, solid, np.asarray(params["eta"], float), plane, camera
        )
    gbuffer = ds.GBuffer(arrays["N"], arrays["P"], arrays["mask"])
    mask = np.asarray(gbuffer.mask)
    camera = _camera(params, arrays["eye"], mask)
    scene = _scene(params, gbuffer)
    add_after = np.asarray(params.get("add_after", (0.0, 0.0, 0.0)))
    return Shading(program, tolerance, arrays["rgb"], mask, scene, gbuffer, camera, add_after)


def _solid(params: dict) -> AbstractSolid:
    if params["solid"] == "sphere":
        return ds.Sphere()
    top, bottom = max(params["slab"]), min(params["slab"])
    return ds.Box((0, 0, (top + bottom) / 2), (1e3, 1e3, top - bottom))


def _camera(params: dict, eye: np.ndarray, mask: np.ndarray) -> AbstractCamera:
    """Where points are given, only the viewer matters and how deep they lie along `view`, the backward axis."""
    view = np.asarray(params["view"], float)
    up = (0, 0, 1) if np.allclose(np.cross(view, (0, 1, 0)), 0) else (0, 1, 0)
    here = {"eye": eye, "target": eye - view, "up": up, "shape": mask.shape, "local_viewer": params["local_viewer"]}
    camera = params["camera"]
    if camera["type"] == "ortho":
        return ds.OrthographicCamera(**here, height=2 * camera["half"])
    return ds.Camera(**here, fov=2 * np.rad2deg(np.arctan(camera["tan_half"])))


def _scene(params: dict, gbuffer: ds.GBuffer) -> ds.Scene:
    given = params["material"]
    material = ds.Material(
        k_a=given["ambient"],
        k_d=given["diffuse"],
        k_s=given["specular"],
        n_s=given["shininess"],
        k_e=given.get("emission", 0.0),
        lobe=LOBES[params["model"]](),
    )
    fog = params.get("fog")
    air = ds.DepthCueing(fog["start"], fog["end"], I_dc=fog["color"]) if fog else None
    lights = [_light(light) for light in params["lights"]]
    return ds.Scene(ds.Object(gbuffer, material), lights, params["global_ambient"], atmosphere=air)


def _light(light: dict) -> AbstractLight:
    intensity = light["diffuse"]
    apart = {} if light["specular"] == intensity else {"specular": light["specular"]}
    match light["type"]:
        case "directional":
            return ds.DirectionalLight(-np.asarray(light["to_light"], float), intensity, **apart)
        case "point":
            return ds.PointLight(light["position"], intensity, _attenuation(light), **apart)
        case "spot":
            cutoff, exponent, softness = light["spot_cutoff_deg"], light["spot_exponent"], 0.0
        case _:  # pov_spot
            cutoff, exponent = light["falloff_deg"], light["tightness"]
            softness = cutoff - light["radius_deg"]
    direction, attenuation = light["spot_direction"], _attenuation(light)
    return ds.SpotLight(light["position"], direction, intensity, cutoff, exponent, attenuation, softness, **apart)


def _attenuation(light: dict) -> ds.RadialAttenuation:
    if "pov_fade" not in light:
        return ds.RadialAttenuation(*light.get("attenuation", (1, 0, 0)))
    return ds.RadialAttenuation(0.5, 0, 0.5 / light["pov_fade"]["fade_distance"] ** 2)  # 2/(1 + (d/fade_distance)^2)
