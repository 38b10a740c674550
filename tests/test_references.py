"""What OpenGL, POV-Ray and VTK render, this renders too."""

import json

import numpy as np
import pytest
from reference_files import FOLDER, read_reference

import diffshade as ds

FILES = sorted(FOLDER.glob("*.npz"))


def test_the_files_are_there():
    assert {path.name.split("_")[0] for path in FILES} == {"gl", "pov", "vtk"}
    assert len(FILES) >= 18


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_reference(path):
    reference = read_reference(path)
    images = [np.asarray(ds.shade(scene, reference.gbuffer, reference.camera)) for scene in reference.scenes]
    image = np.sum(images, axis=0) + reference.add_after
    inside = np.asarray(reference.gbuffer.mask)
    assert inside.any()
    assert np.isfinite(reference.rgb[inside]).all()
    difference = np.where(inside[..., None], np.abs(image - reference.rgb), 0)
    row, column, channel = np.unravel_index(difference.argmax(), difference.shape)
    assert difference.max() <= reference.tolerance, (
        f"{path.stem} differs by {difference.max():.2e} at row {row}, column {column}, channel {channel}: "
        f"{image[row, column]} for {reference.rgb[row, column]}; "
        f"{(difference.max(-1) > reference.tolerance).sum()} of {inside.sum()} points differ by more than "
        f"{reference.tolerance:g}"
    )


POINT = {"type": "point", "position": [0, 0, 2], "diffuse": [1, 1, 1], "specular": [1, 1, 1]}
SPOT = {**POINT, "type": "pov_spot", "spot_direction": [0, 0, -2], "radius_deg": 9, "falloff_deg": 12, "tightness": 3}


def write(path, lights=(POINT,), emission=0, **params):
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
    arrays = {"P": point, "N": n, "mask": np.ones((1, 1), bool), "eye": np.array([0.0, 0, 4]), "rgb": point}
    np.savez(path, **arrays, params=np.array(json.dumps(params)))
    return path


def test_a_soft_pov_spot_and_a_fade(tmp_path):
    light = {**SPOT, "pov_fade": {"fade_distance": 2, "fade_power": 2}}
    (scene,) = read_reference(write(tmp_path / "pov_a.npz", [light])).scenes
    (spot,) = scene.lights
    assert isinstance(spot, ds.SpotLight)
    assert (spot.cutoff, spot.softness, spot.exponent) == (12, 3, 3)
    assert (spot.attenuation.constant, spot.attenuation.linear, spot.attenuation.quadratic) == (0.5, 0, 0.125)


def test_two_colours_are_two_shadings(tmp_path):
    light = {**POINT, "specular": [0, 0, 1]}
    reference = read_reference(write(tmp_path / "gl_a.npz", [light]))
    images = [np.asarray(ds.shade(scene, reference.gbuffer, reference.camera)) for scene in reference.scenes]
    np.testing.assert_allclose(images, [[[[0.6, 0.6, 0.6]]], [[[0, 0, 0.2]]]], rtol=1e-14, atol=1e-16)


@pytest.mark.parametrize("view", [(0, 0, 1), (0, 1, 0), (0.6, 0, 0.8)])
def test_a_viewer_at_infinity_is_where_view_says(tmp_path, view):
    camera = read_reference(write(tmp_path / "gl_a.npz", local_viewer=False, view=view)).camera
    np.testing.assert_allclose(camera.eye - camera.target, view, atol=1e-15)
    assert not camera.local_viewer


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"fog": {"mode": "exp"}}, r"^gl_a\.npz has fog, which the model does not have yet\.$"),
        ({"emission": 0.1}, r"^gl_a\.npz has emission, which the model does not have yet\.$"),
        ({"lights": [{**POINT, "type": "area"}]}, r"^gl_a\.npz: lights\[0\] is of type area, which"),
        ({"lights": [{**POINT, "ambient": [0, 0.1, 0]}]}, r"lights\[0\] has an ambient colour of its own"),
        ({"lights": [POINT, {**POINT, "lamp": "x.ies"}]}, r"lights\[1\] has lamp, which the reader does not know yet"),
        ({"lights": [{**POINT, "pov_fade": {"fade_distance": 1, "fade_power": 1}}]}, "fades with the power 1"),
    ],
)
def test_what_the_model_lacks_is_refused(tmp_path, more, message):
    with pytest.raises(NotImplementedError, match=message):
        read_reference(write(tmp_path / "gl_a.npz", **more))
