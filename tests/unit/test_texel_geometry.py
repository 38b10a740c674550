"""What the lights around a texel determine of its normal: lights in one plane, in one direction, and others."""

import jax.numpy as jnp
import numpy as np
import pytest
from textured import facing_us, lights_about, textured_ball

from diffshade.core.progress import silent
from diffshade.texels.estimates import _distance
from diffshade.texels.light_directions import light_distribution, note_on_normals, out_of_plane
from diffshade.texels.run import TexelRun
from diffshade.texels.tile_runner import TileRunner

COUNT = 12
AROUND = np.linspace(-1.0, 1.0, COUNT)


def test_the_angle_to_the_nearest_plane_is_the_smallest_singular_value():
    rng = np.random.default_rng(0)
    l = rng.standard_normal((50, 6, 3)) * np.array([1.0, 0.5, 0.0]) + rng.uniform(0, 0.1, (50, 1, 1)) * rng.random(3)
    l[0] = 0.0  # a texel that no light reaches
    S = np.einsum("tvi,tvj->ijt", l, l)
    found = np.asarray(out_of_plane([list(map(jnp.asarray, row)) for row in S]))
    values = np.linalg.svd(l[1:], compute_uv=False)
    np.testing.assert_allclose(found[1:], values[:, 2] / np.linalg.norm(l[1:], axis=(1, 2)), atol=1e-7)
    assert found[0] == 0.0


def spread(directions: np.ndarray) -> np.ndarray:
    l = directions / np.linalg.norm(directions, axis=-1)[:, None]
    return (l.T @ l)[..., None]


def test_lights_in_a_plane_and_on_a_line_are_reported_with_the_remedy():
    lights = light_distribution(spread(np.stack([AROUND, 0.4 * np.ones(COUNT), 0.8 * np.ones(COUNT)], -1)))
    note = note_on_normals(lights)
    assert note is not None
    np.testing.assert_allclose(np.abs(lights.plane_normal), (0.0, 0.8944, 0.4472), atol=1e-3)
    assert "in one plane" in note
    assert "(-0, -0.89, 0.45)" in note or "(0, -0.89, 0.45)" in note
    assert "or give the normals" in note
    upright = np.stack([AROUND, 1e-4 * np.cos(9 * AROUND), 0.8 * np.ones(COUNT)], -1)  # the plane holds the z axis
    each = np.concatenate([spread(upright + 1e-5 * np.array([0.0, k, 0.0])) for k in range(-9, 10)], -1)
    np.testing.assert_allclose(np.abs(light_distribution(each).plane_normal), (0.0, 1.0, 0.0), atol=1e-3)
    line = note_on_normals(light_distribution(spread(np.ones((COUNT, 3)) + 1e-3 * AROUND[:, None] * (1.0, 0.0, 0.0))))
    assert line is not None
    assert "one direction" in line
    assert note_on_normals(light_distribution(spread(lights_about(COUNT)))) is None
    assert note_on_normals(light_distribution(np.zeros((3, 3, 0)))) is None
    one_of_many = np.concatenate([spread(upright), *[spread(lights_about(COUNT))] * 200], -1)
    assert note_on_normals(light_distribution(one_of_many)) is None  # "0% of the texels" would tell nothing


@pytest.mark.parametrize("narrow", [False, True])
def test_lights_near_each_other_are_noticed(narrow):
    l = lights_about(COUNT) * ((0.1, 0.1, 1.0) if narrow else (1.0, 1.0, 1.0))
    assert light_distribution(spread(l)).narrow is narrow


def test_lamps_on_a_line_in_space_lie_in_a_plane_with_every_texel_and_those_of_a_ceiling_with_none():
    line = np.stack([3.0 * AROUND, 1.5 + 0.0 * AROUND, 2.5 + 0.0 * AROUND], -1)
    ceiling = 2.5 * lights_about(COUNT)
    ceiling[:, 2] = 2.5
    for at, share in ((line, 1.0), (ceiling, 0.0)):
        ball = textured_ball(12, at=at)
        scene = facing_us(ball)
        tiles = TileRunner(scene, ball.views, "", silent, out=None, memory=1 << 28, devices=None)
        run = TexelRun(scene, ball.views, ("k_d", "normal"), "squares", None, tiles)
        assert run.lights().coplanar == share


def test_the_distance_of_two_normals_is_the_angle_between_them():
    angle, about = np.radians(3.0), np.radians(40.0)
    turned = np.array([np.sin(angle) * np.cos(about), np.sin(angle) * np.sin(about), np.cos(angle)])[:, None]
    off = _distance({"normal": jnp.asarray(turned)}, {"normal": jnp.asarray([[0.0], [0.0], [1.0]])})
    np.testing.assert_allclose(off["normal"], [[3.0]], rtol=1e-3)
