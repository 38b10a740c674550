"""The reader of what OpenGL, POV-Ray and VTK render; that this renders it too is in model/test_equations.py."""

import json
from typing import Any

import jax
import numpy as np
import pytest
from reference_files import Refraction, Shading, read_reference
from refusals import refuses

import diffshade as ds

WHITE = {"diffuse": [1, 1, 1], "specular": [1, 1, 1]}
POINT = {"type": "point", "position": [0, 0, 2], **WHITE}
SPOT = {**POINT, "type": "pov_spot", "spot_direction": [0, 0, -2], "radius_deg": 9, "falloff_deg": 12, "tightness": 3}


@pytest.fixture(autouse=True)
def _operation_by_operation():
    with jax.disable_jit():
        yield


def write(path, lights=(POINT,), emission=0.0, eye=(0, 0, 4), **params):
    """One point that faces the viewer and the light."""
    material = {"ambient": [0.1] * 3, "diffuse": [0.5] * 3, "specular": [0.2] * 3, "shininess": 4}
    params = {
        "model": "phong",
        "material": {**material, "emission": [emission] * 3},
        "global_ambient": [1, 1, 1],
        "lights": lights,
        "local_viewer": True,
        "view": [0, 0, 1],
        "camera": {"type": "ortho", "half": 1.1},
        **params,
    }
    point, n = np.zeros((1, 1, 3)), np.array([[[0.0, 0.0, 1.0]]])
    arrays = {"P": point, "N": n, "mask": np.ones((1, 1), bool), "eye": np.array(eye, float), "rgb": point}
    np.savez(path / "gl_a.npz", **arrays, params=np.array(json.dumps(params)))
    return path / "gl_a.npz"


def read_shading(path):
    reference = read_reference(path)
    assert isinstance(reference, Shading)
    return reference


def only_light(path, light, **options) -> Any:
    return read_shading(write(path, [light], **options)).scene.lights[0]


def numbers(attenuation):
    return attenuation.constant, attenuation.linear, attenuation.quadratic


def test_spots_of_both_kinds_and_a_fade(tmp_path):
    spot = only_light(tmp_path, {**SPOT, "pov_fade": {"fade_distance": 2, "fade_power": 2}})
    assert isinstance(spot, ds.SpotLight)
    assert (spot.cutoff, spot.softness, spot.exponent, *numbers(spot.attenuation)) == (12, 3, 3, 0.5, 0, 0.125)
    hard = {**POINT, "type": "spot", "attenuation": [0.5, 0.2, 0.1], "spot_direction": [0, 0, -2]}
    spot = only_light(tmp_path, hard | {"spot_cutoff_deg": 20, "spot_exponent": 7})
    assert (spot.cutoff, spot.softness, spot.exponent, *numbers(spot.attenuation)) == (20, 0, 7, 0.5, 0.2, 0.1)
    np.testing.assert_array_equal(spot.direction, [0, 0, -2])


def test_an_area_light(tmp_path):
    sides = {"corner": [-1, 1, 2], "edge_u": [0, -2, 0], "edge_v": [2, 0, 0]}
    lamp = only_light(tmp_path, {"type": "area", "samples": [4, 3], **sides, **WHITE})
    assert (lamp.samples, lamp.cutoff, lamp.exponent) == ((4, 3), 90, 1)
    np.testing.assert_array_equal([lamp.corner, lamp.edge_u, lamp.edge_v], list(sides.values()))


def test_two_colours_and_emission(tmp_path):
    reference = read_shading(write(tmp_path, [{**POINT, "specular": [0, 0, 1]}], emission=0.1))
    np.testing.assert_allclose(reference.found(), [[[0.7, 0.7, 0.9]]], rtol=1e-14)


def test_three_mixed_lights_and_ambient_ones(tmp_path):
    """Each of them shines straight at the point, which faces it."""
    lights = [
        {"type": "directional", "to_light": [0, 0, 3], "diffuse": [1, 0, 0], "specular": [1, 0, 0]},
        {**POINT, "diffuse": [0, 1, 0], "specular": [0, 1, 0], "attenuation": [0, 1, 0]},
        {**SPOT, "diffuse": [0, 0, 1], "specular": [0, 0, 1], "attenuation": [0, 0, 1]},
    ]
    found = read_reference(write(tmp_path, lights)).found()
    np.testing.assert_allclose(found, [[[0.1 + 0.7, 0.1 + 0.7 / 2, 0.1 + 0.7 / 4]]], rtol=1e-13)
    lights = [{**lights[0], "ambient": [1, 1, 1]}, {**lights[1], "ambient": [0, 0.5, 1]}]
    found = read_reference(write(tmp_path, lights)).found()  # k_a is .1, and the second light is 2 away
    np.testing.assert_allclose(found, [[[0.2 + 0.7, 0.2 + 0.025 + 0.35, 0.2 + 0.05]]], rtol=1e-13)


# The point is 4 from the eye; white with a grey fog: s + (1 - s)/2.
FOGS = {
    "linear": ({"mode": "linear", "start": 3, "end": 7}, 0.75),
    "linear, beyond": ({"mode": "linear", "start": 1, "end": 3}, 0.0),
    "linear, before": ({"mode": "linear", "start": 5, "end": 6}, 1.0),
    "exp": ({"mode": "exp", "density": 0.2}, np.exp(-0.8)),
    "exp2": ({"mode": "exp2", "density": 0.2}, np.exp(-0.64)),
}


@pytest.mark.parametrize(("fog", "s"), FOGS.values(), ids=FOGS)
@pytest.mark.parametrize("specular", [[1, 1, 1], [0, 0.5, 1]])
def test_fog_is_mixed_in_once_and_before_what_is_added_after(tmp_path, fog, s, specular):
    """Also where the light's colours are apart."""
    fog = {**fog, "color": [0.5, 0.6, 0.7], "distance": "eye_z"}
    light, after = {**POINT, "specular": specular}, [0.25, 0, 0]
    path = write(tmp_path, [light], 0.05, fog=fog, add_after=after, background=[0.5, 0.6, 0.7])
    shaded = 0.05 + 0.1 + 0.5 + 0.2 * np.array(specular)
    found = read_reference(path).found()[0, 0]
    np.testing.assert_allclose(found, s * shaded + (1 - s) * np.array([0.5, 0.6, 0.7]) + after, rtol=1e-13)


@pytest.mark.parametrize(("distance", "z"), [("eye_z", 4.0), ("radial", 5.0)])
@pytest.mark.parametrize("mode", ["linear", "exp", "exp2"])
def test_fog_along_the_axis_or_the_ray(tmp_path, distance, z, mode):
    """The eye is 3 to the side of the point and 4 in front of it, and looks straight ahead."""
    fog = {"mode": mode, "start": 2, "end": 6, "density": 0.2, "color": [1, 1, 1], "distance": distance}
    camera = {"type": "perspective", "tan_half": 0.5}
    path = write(tmp_path, (), fog=fog, eye=(3, 0, 4), camera=camera)
    s = {"linear": (6 - z) / 4, "exp": np.exp(-0.2 * z), "exp2": np.exp(-((0.2 * z) ** 2))}[mode]
    np.testing.assert_allclose(read_reference(path).found(), np.full((1, 1, 3), 1 - 0.9 * s), rtol=1e-13)


SLAB = {"solid": "slab", "slab": [0.5, -0.5], "eta": 1.61}
SPHERE = {"solid": "sphere", "eta": 1.5}


def write_map(path, camera, **params):
    """Two pixels, half a unit to either side of the axis at the origin."""
    params = {"plane_z": -1.5, "eye": [0, 0, 4], "camera": camera, **params}
    mask = np.ones((1, 2), bool)
    np.savez(path / "refraction_a.npz", hit=np.zeros((1, 2, 2)), mask=mask, params=np.array(json.dumps(params)))
    return path / "refraction_a.npz"


def slab_shift():
    """Each ray is shifted by t sin(i - r)/cos r across itself, that is by t (tan i - tan r) in the plane."""
    i = np.arctan(0.4)
    r = np.arcsin(np.sin(i) / 1.61)
    return 5.5 * np.tan(i) - (np.tan(i) - np.tan(r))


def sphere_turn():
    """A parallel ray at height sin i is turned twice by i - r, and leaves at height sin(2 r - i)."""
    i, r = np.arcsin(0.6), np.arcsin(0.6 / 1.5)
    return np.sin(2 * r - i) - (1.5 - np.cos(2 * r - i)) * np.tan(2 * (i - r))


@pytest.mark.parametrize(
    ("camera", "solid", "x"),
    [
        ({"type": "perspective", "tan_half": 0.4}, SLAB, slab_shift()),
        ({"type": "ortho", "half": 0.6}, SPHERE, sphere_turn()),
        ({"type": "ortho", "half": 1.5}, SPHERE, 1.5),  # beside the sphere
    ],
    ids=["slab", "sphere", "beside"],
)
def test_a_map_of_bent_rays(tmp_path, camera, solid, x):
    reference = read_reference(write_map(tmp_path, camera, **solid))
    assert isinstance(reference, Refraction)
    np.testing.assert_allclose(reference.found(), [[(-x, 0), (x, 0)]], rtol=1e-13, atol=1e-14)


@pytest.mark.parametrize("view", [(0, 0, 1), (0, 1, 0), (0.6, 0, 0.8)])
def test_a_viewer_at_infinity_is_where_view_says(tmp_path, view):
    camera = read_shading(write(tmp_path, local_viewer=False, view=view)).camera
    np.testing.assert_allclose(camera.eye - camera.target, view, atol=1e-15)
    assert not camera.local_viewer


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"fog": {"mode": "power"}}, ("gl_a.npz: fog", "power", "linear, exp and exp2")),
        ({"fog": {"mode": "exp", "distance": "x"}}, ("gl_a.npz: fog", "distance x", "eye_z and")),
        ({"fog": {"mode": "exp", "height": 1}}, ("gl_a.npz: fog", "height")),
        ({"lights": [{**POINT, "type": "tube"}]}, ("lights[0]", "tube", "directional")),
        ({"material": {"gloss": 1}}, ("gl_a.npz: material", "gloss")),
        ({"lights": [POINT, {**POINT, "lamp": "x.ies"}]}, ("lights[1]", "lamp")),
        ({"lights": [{**POINT, "pov_fade": {"fade_distance": 1, "fade_power": 1}}]}, ("power 1", "power 2")),
    ],
)
def test_what_the_model_lacks_is_refused(tmp_path, more, words):
    refuses(lambda: read_reference(write(tmp_path, **more)), *words, error=NotImplementedError)


def test_what_the_reader_does_not_know_is_refused(tmp_path):
    other = write(tmp_path).rename(tmp_path / "maya_a.npz")
    refuses(lambda: read_reference(other), "maya_a.npz", "gl, pov, vtk", error=NotImplementedError)
    prism = write_map(tmp_path, {"type": "ortho", "half": 1}, solid="prism", eta=1.5)
    refuses(lambda: read_reference(prism), "refraction_a.npz", "prism", "sphere and slab", error=NotImplementedError)
