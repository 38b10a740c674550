"""What OpenGL, POV-Ray and VTK render, this renders too."""

import json

import numpy as np
import pytest
from reference_files import FOLDER, PROGRAMS, Refraction, Shading, read_reference

import diffshade as ds

FILES = sorted(FOLDER.glob("*.npz"))


def test_the_files_are_there():
    assert {path.name.split("_")[0] for path in FILES} == set(PROGRAMS)
    assert len(FILES) >= 21


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_reference(path):
    reference = read_reference(path)
    found, expected, mask = reference.found(), reference.expected, reference.mask
    assert mask.any()
    assert np.isfinite(expected[mask]).all()
    assert np.isfinite(found[mask]).all()
    difference = np.where(mask[..., None], np.abs(found - expected), 0)
    row, column, channel = np.unravel_index(difference.argmax(), difference.shape)
    assert difference.max() <= reference.tolerance, (
        f"{path.stem} differs by {difference.max():.2e} at row {row}, column {column}, channel {channel}: "
        f"{found[row, column]} for {expected[row, column]}; "
        f"{(difference.max(-1) > reference.tolerance).sum()} of {mask.sum()} points differ by more than "
        f"{reference.tolerance:g}"
    )


WHITE = {"diffuse": [1, 1, 1], "specular": [1, 1, 1]}
POINT = {"type": "point", "position": [0, 0, 2], **WHITE}
SPOT = {**POINT, "type": "pov_spot", "spot_direction": [0, 0, -2], "radius_deg": 9, "falloff_deg": 12, "tightness": 3}


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
    np.savez(path, **arrays, params=np.array(json.dumps(params)))
    return path


def read_shading(path):
    reference = read_reference(path)
    assert isinstance(reference, Shading)
    return reference


def test_a_soft_pov_spot_and_a_fade(tmp_path):
    light = {**SPOT, "pov_fade": {"fade_distance": 2, "fade_power": 2}}
    (scene,) = read_shading(write(tmp_path / "pov_a.npz", [light])).scenes
    (spot,) = scene.lights
    assert isinstance(spot, ds.SpotLight)
    assert (spot.cutoff, spot.softness, spot.exponent) == (12, 3, 3)
    assert (spot.attenuation.constant, spot.attenuation.linear, spot.attenuation.quadratic) == (0.5, 0, 0.125)


def test_two_colours_are_two_shadings(tmp_path):
    light = {**POINT, "specular": [0, 0, 1]}
    reference = read_shading(write(tmp_path / "gl_a.npz", [light], emission=0.1))
    images = [np.asarray(ds.shade(scene, reference.gbuffer, reference.camera)) for scene in reference.scenes]
    np.testing.assert_allclose(images, [[[[0.7, 0.7, 0.7]]], [[[0, 0, 0.2]]]], rtol=1e-14, atol=1e-16)
    np.testing.assert_allclose(reference.found(), [[[0.7, 0.7, 0.9]]], rtol=1e-14)


def test_emission(tmp_path):
    (scene,) = read_shading(write(tmp_path / "gl_a.npz", emission=0.3)).scenes
    np.testing.assert_array_equal(scene.objects[0].material.k_e, [0.3, 0.3, 0.3])


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
    """Also where the light's two colours make two shadings."""
    fog = {**fog, "color": [0.5, 0.6, 0.7], "distance": "eye_z"}
    light, after = {**POINT, "specular": specular}, [0.25, 0, 0]
    path = write(tmp_path / "gl_a.npz", [light], 0.05, fog=fog, add_after=after, background=[0.5, 0.6, 0.7])
    shaded = 0.05 + 0.1 + 0.5 + 0.2 * np.array(specular)
    found = read_reference(path).found()[0, 0]
    np.testing.assert_allclose(found, s * shaded + (1 - s) * np.array([0.5, 0.6, 0.7]) + after, rtol=1e-13)


@pytest.mark.parametrize(("distance", "z"), [("eye_z", 4.0), ("radial", 5.0)])
@pytest.mark.parametrize("mode", ["linear", "exp", "exp2"])
def test_fog_along_the_axis_or_the_ray(tmp_path, distance, z, mode):
    """The eye is 3 to the side of the point and 4 in front of it, and looks straight ahead."""
    fog = {"mode": mode, "start": 2, "end": 6, "density": 0.2, "color": [1, 1, 1], "distance": distance}
    path = write(tmp_path / "gl_a.npz", (), fog=fog, eye=(3, 0, 4))
    s = {"linear": (6 - z) / 4, "exp": np.exp(-0.2 * z), "exp2": np.exp(-((0.2 * z) ** 2))}[mode]
    np.testing.assert_allclose(read_reference(path).found(), np.full((1, 1, 3), 1 - 0.9 * s), rtol=1e-13)


def test_an_ambient_light_that_is_the_same_everywhere(tmp_path):
    lights = [{**POINT, "ambient": [0, 0.5, 1]}, {"type": "directional", "to_light": [0, 0, 1], **WHITE}]
    lights[1]["ambient"] = [1, 1, 1]
    (scene,) = read_shading(write(tmp_path / "gl_a.npz", lights)).scenes
    np.testing.assert_array_equal(scene.ambient, [2, 2.5, 3])


def test_a_spot_with_everything(tmp_path):
    light = {**POINT, "type": "spot", "attenuation": [0.5, 0.2, 0.1], "spot_direction": [0, 0, -2]}
    light |= {"spot_cutoff_deg": 20, "spot_exponent": 7}
    (scene,) = read_shading(write(tmp_path / "gl_a.npz", [light])).scenes
    (spot,) = scene.lights
    assert isinstance(spot, ds.SpotLight)
    assert (spot.cutoff, spot.softness, spot.exponent) == (20, 0, 7)
    assert (spot.attenuation.constant, spot.attenuation.linear, spot.attenuation.quadratic) == (0.5, 0.2, 0.1)
    np.testing.assert_array_equal(spot.direction, [0, 0, -2])


def test_an_area_light(tmp_path):
    light = {
        "type": "area",
        "corner": [-1, 1, 2],
        "edge_u": [0, -2, 0],
        "edge_v": [2, 0, 0],
        "samples": [4, 3],
        **WHITE,
    }
    (scene,) = read_shading(write(tmp_path / "gl_a.npz", [light])).scenes
    (lamp,) = scene.lights
    assert isinstance(lamp, ds.AreaLight)
    assert (lamp.samples, lamp.cutoff, lamp.exponent) == ((4, 3), 90, 1)
    np.testing.assert_array_equal([lamp.corner, lamp.edge_u, lamp.edge_v], [(-1, 1, 2), (0, -2, 0), (2, 0, 0)])


def test_three_mixed_lights(tmp_path):
    """Each of them shines straight at the point, which faces it."""
    lights = [
        {"type": "directional", "to_light": [0, 0, 3], "diffuse": [1, 0, 0], "specular": [1, 0, 0]},
        {**POINT, "diffuse": [0, 1, 0], "specular": [0, 1, 0], "attenuation": [0, 1, 0]},
        {**SPOT, "diffuse": [0, 0, 1], "specular": [0, 0, 1], "attenuation": [0, 0, 1]},
    ]
    found = read_reference(write(tmp_path / "gl_a.npz", lights)).found()
    np.testing.assert_allclose(found, [[[0.1 + 0.7, 0.1 + 0.7 / 2, 0.1 + 0.7 / 4]]], rtol=1e-13)


SLAB = {"solid": "slab", "slab": [0.5, -0.5], "eta": 1.61}
SPHERE = {"solid": "sphere", "eta": 1.5}


def write_map(path, camera, **params):
    """Two pixels, half a unit to either side of the axis at the origin."""
    params = {"plane_z": -1.5, "eye": [0, 0, 4], "camera": camera, **params}
    mask = np.ones((1, 2), bool)
    np.savez(path, hit=np.zeros((1, 2, 2)), mask=mask, params=np.array(json.dumps(params)))
    return path


def test_a_map_of_rays_through_a_slab(tmp_path):
    """Each ray is shifted by t sin(i - r)/cos r across itself, that is by t (tan i - tan r) in the plane."""
    path = write_map(tmp_path / "refraction_a.npz", {"type": "perspective", "tan_half": 0.4}, **SLAB)
    reference = read_reference(path)
    assert isinstance(reference, Refraction)
    i = np.arctan(0.4)
    r = np.arcsin(np.sin(i) / 1.61)
    x = 5.5 * np.tan(i) - (np.tan(i) - np.tan(r))
    np.testing.assert_allclose(reference.found(), [[(-x, 0), (x, 0)]], rtol=1e-13, atol=1e-14)
    assert abs(x - 5.5 * np.tan(i)) > 0.1


def test_a_map_of_rays_through_a_sphere(tmp_path):
    """A parallel ray at height sin i is turned twice by i - r, and leaves at height sin(2 r - i)."""
    path = write_map(tmp_path / "refraction_a.npz", {"type": "ortho", "half": 0.6}, **SPHERE)
    i = np.arcsin(0.6)
    r = np.arcsin(0.6 / 1.5)
    turn = 2 * (i - r)
    out = np.array([np.sin(2 * r - i), -np.cos(2 * r - i)])
    x = out[0] - (out[1] + 1.5) * np.tan(turn)
    np.testing.assert_allclose(read_reference(path).found(), [[(-x, 0), (x, 0)]], rtol=1e-13, atol=1e-14)


def test_a_map_of_rays_beside_the_sphere(tmp_path):
    path = write_map(tmp_path / "refraction_a.npz", {"type": "ortho", "half": 1.5}, **SPHERE)
    np.testing.assert_allclose(read_reference(path).found(), [[(-1.5, 0), (1.5, 0)]], rtol=1e-13, atol=1e-14)


@pytest.mark.parametrize("view", [(0, 0, 1), (0, 1, 0), (0.6, 0, 0.8)])
def test_a_viewer_at_infinity_is_where_view_says(tmp_path, view):
    camera = read_shading(write(tmp_path / "gl_a.npz", local_viewer=False, view=view)).camera
    np.testing.assert_allclose(camera.eye - camera.target, view, atol=1e-15)
    assert not camera.local_viewer


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"fog": {"mode": "power"}}, r"^gl_a\.npz: fog has the mode power; the reader knows linear, exp and exp2\.$"),
        ({"fog": {"mode": "exp", "distance": "x"}}, r"^gl_a\.npz: fog has the distance x; the reader knows eye_z and"),
        ({"fog": {"mode": "exp", "height": 1}}, r"^gl_a\.npz: fog has height, which the reader does not know yet\.$"),
        ({"lights": [{**POINT, "type": "tube"}]}, r"^gl_a\.npz: lights\[0\] is of type tube; the reader knows"),
        ({"lights": [{**SPOT, "ambient": [0, 0.1, 0]}]}, r"lights\[0\] has an ambient colour that is attenuated"),
        (
            {"lights": [{**POINT, "ambient": [0, 0.1, 0], "attenuation": [1, 0, 1]}]},
            r"lights\[0\] has an ambient colour that is attenuated",
        ),
        ({"material": {"gloss": 1}}, r"^gl_a\.npz: material has gloss, which the reader does not know yet\.$"),
        ({"lights": [POINT, {**POINT, "lamp": "x.ies"}]}, r"lights\[1\] has lamp, which the reader does not know yet"),
        ({"lights": [{**POINT, "pov_fade": {"fade_distance": 1, "fade_power": 1}}]}, "fades with the power 1"),
    ],
)
def test_what_the_model_lacks_is_refused(tmp_path, more, message):
    with pytest.raises(NotImplementedError, match=message):
        read_reference(write(tmp_path / "gl_a.npz", **more))


def test_what_the_reader_does_not_know_is_refused(tmp_path):
    with pytest.raises(NotImplementedError, match=r"^maya_a\.npz begins with none of gl, pov, vtk, refraction\.$"):
        read_reference(write(tmp_path / "maya_a.npz"))
    path = write_map(tmp_path / "refraction_a.npz", {"type": "ortho", "half": 1}, solid="prism", eta=1.5)
    with pytest.raises(NotImplementedError, match=r"^refraction_a\.npz has the solid prism; the reader knows sphere "):
        read_reference(path)
