"""Pictures that need many programs: a mesh beside the sphere it stands for, and an exponent a channel."""

import numpy as np
import pytest

import diffshade as ds


@pytest.mark.parametrize("lobe", [ds.Phong(), ds.Blinn()])
def test_one_exponent_a_channel_renders_each_channel_as_that_exponent_alone_does(lobe):
    def image(n_s):
        material = ds.Material(0.1, (0.6, 0.4, 0.2), (0.5, 0.4, 0.3), n_s, lobe=lobe)
        camera = ds.Camera(eye=(0, 0, 4), fov=32, shape=(12, 12))
        return np.asarray(ds.render(ds.Scene(ds.Object(ds.Sphere(), material), ds.PointLight((1, 2, 4))), camera))

    exponents = (3.0, 20.0, 90.0)
    alone = [image(n_s) for n_s in exponents]
    np.testing.assert_allclose(image((20.0, 20.0, 20.0)), alone[1], rtol=1e-13)
    np.testing.assert_allclose(image(exponents), np.stack([alone[c][..., c] for c in range(3)], -1), rtol=1e-13)
    assert np.abs(alone[0] - alone[2]).max() > 0.1  # they could be told apart


def test_a_mesh_renders_as_the_sphere_does(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    pytest.importorskip("embreex")
    ball = trimesh.creation.icosphere(subdivisions=5)
    ball.apply_translation((0.1, 0.2, -0.1))
    ball.export(tmp_path / "ball.ply")
    camera = ds.Camera((1, 2, 3), fov=35, shape=(60, 70))
    material = ds.Material(0.1, (0.6, 0.4, 0.2), 0.3, 10)
    light = ds.PointLight((2, 3, 4), 2)
    images = [
        np.asarray(ds.render(ds.Scene(ds.Object(surface, material), light), camera))
        for surface in (ds.exchange.read_mesh(str(tmp_path / "ball.ply"), camera), ds.Sphere((0.1, 0.2, -0.1)))
    ]
    both = np.all(images, (0, -1))
    assert both.sum() > 1000
    difference = np.abs(images[0] - images[1])[both]
    assert np.quantile(difference, 0.95) < 2e-3
    assert difference.max() < 0.05
