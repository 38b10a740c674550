"""Photographs under lights that no view had, as the views of the same object teach to predict them."""

import jax
import numpy as np
import pytest

from diffshade.inverse.data.relightable import dome
from diffshade.texels.between_lights import from_leaves, learned_between, lights_between
from diffshade.texels.unexplained import Smoothing, interpolation_of

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


@pytest.mark.parametrize("texels", [1, 2, 200])
def test_of_black_texels_nothing_is_learned(texels):
    lights = dome(24, 0.2)
    model, beyond = shadows(lights, texels)
    assert learned_between(lights, 0.0 * beyond, 0.0 * model, SMOOTHING) is None
    model[..., ::2], beyond[..., ::2] = 0.0, 0.0
    learned_between(lights, beyond, model, SMOOTHING)


def test_a_photograph_that_is_given_twice_teaches_nothing():
    lights = dome(24, 0.2)
    beside = lights[:1] + np.random.default_rng(0).normal(0.0, 1e-3, 3)
    model, beyond = shadows(lights, 300)
    beyond, model = (np.concatenate([of, of[:1]]) for of in (beyond, model))
    for twin in (lights[:1], beside / np.linalg.norm(beside)):
        assert learned_between(np.concatenate([lights, twin]), beyond, model, SMOOTHING) is None


def test_lights_between_are_not_far_from_those_of_the_views():
    lights = dome(24, 0.2)
    new = lights_between(lights)
    assert len(new) > 24
    assert new[:, 2].min() > -0.2


@pytest.mark.parametrize("kinds", [0, 1, 2])
def test_what_a_run_keeps_is_what_it_learned(kinds):
    """Arrays alone are kept: nothing, an interpolation, and what was learned of the lights between."""
    lights = dome(40, 0.2)
    model, beyond = shadows(lights, 300)
    interpolation = interpolation_of(lights, beyond[:, 0], SMOOTHING, 9) if kinds else None
    between = learned_between(lights, beyond, model, SMOOTHING) if kinds > 1 else None
    assert (between is not None) == (kinds > 1)
    _, found = both = from_leaves([np.asarray(leaf) for leaf in jax.tree.leaves((interpolation, between))])
    assert jax.tree.structure(both) == jax.tree.structure((interpolation, between))
    if found is not None and between is not None:
        new = np.full((len(between.toward), 1, 300), 0.5, np.float32)
        np.testing.assert_array_equal(found.beyond(beyond, new), between.beyond(beyond, new))


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
