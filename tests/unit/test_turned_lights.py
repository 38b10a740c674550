"""Turned lights: what a photograph's texels say of its light."""

import numpy as np

from diffshade.texels.robust.turned_lights import MatteTexels, _in_words, _seen_in


def test_a_light_is_where_most_texels_say():
    random = np.random.default_rng(0)
    facing = random.standard_normal((3, 400)) * 0.5 + [[0.0], [0.0], [1.0]]
    said, true = np.array([0.0, 0.0, 1.0]), np.array([0.3, 0.0, 0.95])
    shown = true @ facing
    shown[:80] = 0.0  # in shadow
    toward = np.broadcast_to(said[:, None, None], (3, 1, 400))
    counts = (true @ facing > 0.1)[None]
    texels = MatteTexels(facing, shown[None], counts, toward, (said @ facing)[None], 0.0 * shown[None])
    found = _seen_in(texels, 0)
    np.testing.assert_allclose(found, true / np.linalg.norm(true), atol=1e-3)
    np.testing.assert_allclose(_seen_in(texels._replace(counts=counts & False), 0), said)


def test_two_photographs_that_show_each_others_light_are_swapped():
    said = np.array([[0.0, 0.0, 1.0], [0.6, 0.0, 0.8], [0.0, 0.6, 0.8]])
    off = np.deg2rad([0.0, 47.0, 47.0])
    far = np.array([1, 2])
    assert "views[1] and views[2] each show the other's light" in _in_words(far, said[[0, 2, 1]], said, off)
    assert "views[1] by 47 degrees, views[2] by 47 degrees" in _in_words(far, said[[0, 0, 0]], said, off)
