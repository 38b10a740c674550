"""Photographs under lights that no view had, as the views of the same object teach to predict them."""

import numpy as np
import pytest

from diffshade.inverse.data.relightable import dome
from diffshade.texels.between_lights import learned_between, lights_between
from diffshade.texels.unexplained import Smoothing

pytestmark = pytest.mark.thorough
SMOOTHING = Smoothing(0.8, 0.03)


def shadows(lights: np.ndarray, texels: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a matte plane under lights, and what is missing of it where walls of random heights cast shadows."""
    rng = np.random.default_rng(0)
    turn, wall = rng.uniform(0.0, 2.0 * np.pi, texels), rng.uniform(0.3, 1.0, texels)
    toward_wall = lights[:, :2] @ np.stack([np.cos(turn), np.sin(turn)])
    model = np.broadcast_to(lights[:, 2:], toward_wall.shape)
    beyond = np.where(toward_wall > wall * lights[:, 2:], -model, 0.0)
    return model[:, None].astype(np.float32), beyond[:, None].astype(np.float32)


def test_edges_of_shadows_are_learned():
    lights = dome(48, 0.2)
    model, beyond = shadows(lights, 600)
    found = learned_between(lights, beyond, model, SMOOTHING)
    assert found is not None
    new = np.asarray(found.toward[48:], float)
    above = new[:, 2] > 0.3
    model, truth = shadows(np.concatenate([lights, new]), 900)
    predicted = np.asarray(found.beyond(truth[:48], model))
    np.testing.assert_array_equal(predicted[:48], truth[:48])
    interpolated = SMOOTHING.weights(lights, new) @ truth[:48, 0]
    off, plain = (np.mean((of[above] - truth[48:, 0][above]) ** 2) for of in (predicted[48:, 0], interpolated))
    assert off < 0.97 * plain


def test_nothing_is_learned_of_noise_or_of_few_views():
    lights = dome(24, 0.2)
    noise = np.random.default_rng(0).standard_normal((24, 1, 400)).astype(np.float32)
    model = np.broadcast_to(lights[:, 2:, None], noise.shape)
    assert learned_between(lights, noise, model, Smoothing(0.2, 10.0)) is None
    assert learned_between(lights[:8], noise[:8], model[:8], SMOOTHING) is None
    assert not len(lights_between(np.repeat(lights[:1], 9, 0)))


def test_lights_that_lie_beside_one_another_count_once():
    lights = dome(24, 0.2)
    beside = lights + np.random.default_rng(0).normal(0.0, 1e-3, lights.shape)
    twice = np.concatenate([lights, beside / np.linalg.norm(beside, axis=1, keepdims=True)])
    assert len(lights_between(twice)) == len(lights_between(lights)) > 24
    model, beyond = shadows(lights, 300)
    beyond, model = (np.concatenate([of, of[:1]]) for of in (beyond, model))
    for twin in (lights[:1], beside[:1] / np.linalg.norm(beside[0])):  # given twice, a photograph teaches nothing
        assert learned_between(np.concatenate([lights, twin]), beyond, model, SMOOTHING) is None


def test_what_is_black_stays_dark():
    """Noise about 0, whose mean is next to nothing, and may be negative."""
    lights = dome(40, 0.2)
    model, beyond = shadows(lights, 600)
    black = np.arange(600) % 20 == 0
    model, beyond = (np.where(black, 0.0, of).astype(np.float32) for of in (model, beyond))
    beyond += np.random.default_rng(0).normal(0.0, 1e-3, beyond.shape).astype(np.float32)
    found = learned_between(lights, beyond, model, SMOOTHING)
    assert found is not None
    everywhere = np.concatenate([model, np.broadcast_to(found.toward[40:, 2:, None], (len(found.toward) - 40, 1, 600))])
    everywhere = np.where(black, 0.0, np.maximum(everywhere, 0.0)).astype(np.float32)
    shown = everywhere + np.asarray(found.beyond(beyond, everywhere))
    assert 0.0 <= shown[40:][..., black].min() <= shown[40:][..., black].max() < 0.01
