"""Rounding: which steps a file has, and what they make a fit's numbers vary by, beside rounding itself."""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from grams import by_view

import diffshade as ds
from diffshade.inverse.forward.interface import AbstractForwardModel
from diffshade.inverse.forward.losses import Likelihood
from diffshade.inverse.forward.rounding import Rounding, find_rounding, find_steps, no_rounding
from diffshade.inverse.forward.sums import waves
from diffshade.inverse.pixels.blocks import Block, Observed
from diffshade.inverse.statistics.clusters import compared, independent
from diffshade.inverse.statistics.evidence import Evidence

STEP = 1.0 / 255.0


# --- which steps


def radiance(count: int = 3000) -> np.ndarray:
    """The values of a ball: a dark side of one value, and a smooth bright one."""
    return np.concatenate([np.full(count // 3, 0.0712), 0.0712 + 0.8 * np.sin(np.linspace(0.0, 1.3, count)) ** 2])


@pytest.mark.parametrize("bits", [8, 10, 12, 14, 16])
@pytest.mark.parametrize("srgb", [False, True])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_steps_of_integers_are_found(bits, srgb, dtype):
    levels = 2**bits - 1
    stored = np.rint(levels * (ds.srgb_encode(radiance()) if srgb else radiance())) / levels
    values = (ds.srgb_decode(stored) if srgb else stored).astype(dtype).astype(float)
    assert find_steps(values) == (pytest.approx(1.0 / levels), srgb)
    assert find_steps(values[::97])[0] == pytest.approx(1.0 / levels)  # few values do


def test_steps_of_a_file_that_was_scaled_are_found():
    found, srgb = find_steps(np.rint(255 * radiance()) / 255 * 1.37 - 0.01)
    assert (found, srgb) == (pytest.approx(1.37 / 255), False)
    three = np.array([17.0, 101.0, 230.0])
    assert find_steps(three / 255) == (STEP, False)  # of three flat faces
    assert find_steps(ds.srgb_decode(three / 255)) == (STEP, True)
    assert find_steps(three[:2] / 255)[0] == 0.0
    assert find_steps(three[:1] / 99, levels=99.0) == (1 / 99, False)  # known
    assert find_steps(np.zeros(0))[0] == 0.0


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64])
def test_floats_have_none(dtype):
    random = np.random.default_rng(0)
    noisy = radiance() + 0.01 * random.standard_normal(len(radiance()))
    for values in (radiance(), noisy, random.uniform(size=9)):
        assert find_steps(values.astype(dtype).astype(float))[0] < 1e-4


def test_each_view_has_the_steps_of_its_own_values():
    values = np.rint(255 * radiance(96)) / 255
    found = find_rounding([values, np.sqrt(values), np.zeros(0)], [0.0, 0.0, 0.0])
    np.testing.assert_allclose(found.step, [STEP, 0.0, 0.0])
    assert found.exists
    assert str(found) == "255 steps"
    assert str(Rounding(np.array([STEP, 1 / 65535]), np.array([1.0, 0.0]), np.zeros(()))) == (
        "255 sRGB steps or 65,535 steps"
    )
    assert not no_rounding(2).exists


def test_values_without_steps_have_none_where_a_few_of_them_do():
    random, ramp = np.random.default_rng(1), radiance(1500)
    eighth = np.rint(255 * ramp) / 255
    coarse = np.where(np.arange(2000) < 1990, eighth, random.uniform(size=2000))  # steps in most of the values
    views = [eighth, ds.srgb_decode(eighth), 1.37 * eighth - 0.01, ramp, coarse, np.rint(99 * ramp) / 99]
    found = find_rounding([*views, np.full(2000, 0.5)], [0.0] * 5 + [99.0, 0.0])
    assert (found.step > 0).tolist() == [True, True, True, False, False, True, False]


# --- what they do


class Stand(eqx.Module):
    """What `waves` asks of a setting."""

    grey: Any
    rounding: Rounding
    shown: None = None


class Linear(AbstractForwardModel):
    """Views that show J theta, where `Block.points` is J."""

    setting: Any
    likelihood: Likelihood

    @property
    def projects(self) -> bool:
        return False

    @property
    def transparent(self) -> bool:
        return False

    def seen(self, pixels: Any, view: Any, counts: Any) -> Any:
        return pixels

    def lit(self, seen: Any, view: Any) -> Any:
        return seen

    def predict(self, theta: Any, block: Block) -> Any:
        return (block.points @ theta,)

    def summary(self, theta: Any, chunk: Block) -> Any:
        raise NotImplementedError

    def gram(self, theta: Any, summary: Any) -> Any:
        raise NotImplementedError


@jax.jit
def _waves(J: Any, theta: Any, rounding: Rounding) -> Any:
    model = Linear(Stand(jnp.zeros(len(J)), rounding), Likelihood(jnp.asarray(1.0)))
    seen = Observed(jnp.zeros((len(J), 1, J.shape[1])), jnp.ones((len(J), 1, J.shape[1])), None)
    return waves(theta, model, Block(jnp.arange(len(J)), J, seen))


def waves_of(J: np.ndarray, theta: np.ndarray, *, srgb: bool = False, noise: float = 0.0) -> np.ndarray:
    """Return A^T of views that show J theta: J (views, samples, numbers)."""
    with jax.enable_x64(True):
        return np.asarray(
            _waves(J, theta, Rounding(np.full(len(J), STEP), np.full(len(J), 1.0 * srgb), np.asarray(noise)))
        )


def rounded(values: np.ndarray, srgb: bool, higher: float = 0.0) -> np.ndarray:
    """Return values in 255 steps; `higher`, in steps: -.5 cuts off, 0 is to the nearest."""
    stored = np.rint(255 * (ds.srgb_encode(values) if srgb else values) + higher) / 255
    return ds.srgb_decode(stored) if srgb else stored


@pytest.mark.thorough
@pytest.mark.parametrize("srgb", [False, True])
@pytest.mark.parametrize("noise", [0.0, 0.15, 0.6])
def test_they_move_a_fit_as_the_formula_says(srgb, noise):
    """Half of the samples have one value, half lie on a ramp; truths anywhere between the steps, dither, any cut."""
    random = np.random.default_rng(0)
    flat, ramp = np.zeros(200), np.linspace(0.0, 0.3, 200)
    J = np.stack([np.ones(400), np.concatenate([flat, ramp])], 1)
    H = np.linalg.inv(J.T @ J)
    moves = []
    for _ in range(2000):
        theta = np.array([random.uniform(0.2, 0.25), random.uniform(0.9, 1.1)])
        truth = J @ theta
        noisy, higher = truth + noise * STEP * random.standard_normal(400), random.uniform(-0.5, 0.5)
        moves.append(H @ J.T @ (rounded(noisy, srgb, higher) - truth))
    at = np.array([0.225, 1.0])
    slope = 1.055 * 0.225 ** (1 / 2.4 - 1) / 2.4 if srgb else 1.0  # of the curve at the flat half
    A = H @ waves_of(J[None], at, srgb=srgb, noise=noise * STEP)[0]
    own = ((noise * STEP) ** 2 + (noise >= 0.5) * (STEP / slope) ** 2 / 12) * np.diag(H)
    expected = np.sqrt(np.sum(A**2, 1) + own)
    np.testing.assert_allclose(np.sqrt(np.mean(np.square(moves), 0)), expected, rtol=0.15)
    if noise == 0.0 and not srgb:  # one value, one error, however many the samples
        assert 0.7 < expected[0] / (STEP / np.sqrt(6)) < 1.1
        assert expected[0] > 5 * STEP / np.sqrt(12) * np.sqrt(H[0, 0])


# --- in the errors


def flat_views(views: int, seed: int, *, rounds: bool = True) -> tuple[Evidence, np.ndarray]:
    """Views of two numbers: the dark value that all of them share, and a brightness on a ramp, all rounded."""
    random = np.random.default_rng(seed)
    J = np.zeros((views, 120, 2))
    J[..., 0] = 1.0
    for v in range(views):
        J[v, 60:, 1] = np.linspace(0.0, random.uniform(0.2, 0.4), 60)
    truth = np.array([random.uniform(0.2, 0.25), random.uniform(0.9, 1.1)])
    y = rounded(J @ truth, False)
    values = np.linalg.lstsq(J.reshape(-1, 2), y.ravel(), rcond=None)[0]
    r = J @ values - y
    count, squares = float(r.size), float(np.sum(r**2))
    evidence = Evidence(
        by_view(np.einsum("vni,vnj->vij", J, J), np.einsum("vni,vn->vi", J, r)), np.zeros((2, 2)), np.zeros(2), values,
        np.zeros(2, bool), np.ones(2, bool), np.zeros((0, 3), int), squares / (count - 2),
        np.array([count, squares, squares, count, count]),
    )  # fmt: skip
    evidence = dataclasses.replace(evidence, waves=waves_of(J, values), steps="255 steps") if rounds else evidence
    return evidence, truth


@pytest.mark.thorough
def test_errors_with_rounding_hold_the_truth_and_views_are_not_said_to_disagree():
    found = [flat_views(6, seed) for seed in range(60)]
    clusters = [compared(evidence, 6, "6 views") for evidence, _ in found]
    off = np.array([(e.values - t) / c.wide_errors() for (e, t), c in zip(found, clusters, strict=True)])
    assert np.all(np.mean(np.abs(off) < 1.96, 0) > 0.92)
    assert 0.7 < np.sqrt(np.mean(off**2)) < 1.15
    assert np.mean([c.disagree for c in clusters]) < 0.06
    assert "for rounding to 255 steps" in clusters[0].sentence(["k_a", "k_d"])
    for c in clusters:
        np.testing.assert_allclose(
            c.rises(), c.evidence.sigma2 * (c.standard_errors() / c.evidence.plain_errors()) ** 2
        )
    short = np.array([(e.values - t) / e.plain_errors() for e, t in found])  # as if rounding were noise
    assert np.mean(np.abs(short) < 1.96) < 0.5


def test_without_rounding_nothing_is_added():
    evidence, _ = flat_views(3, 0, rounds=False)
    np.testing.assert_array_equal(evidence.rounding_errors(), 0.0)
    assert "rounding" not in independent(evidence, "1 view").sentence(["k_a", "k_d"])
    none = dataclasses.replace(evidence, waves=np.zeros((3, 2, 24)))
    assert none.scatter() == pytest.approx(evidence.scatter())
    np.testing.assert_allclose(none.independence_p_values(), evidence.independence_p_values())
    held = dataclasses.replace(flat_views(3, 0)[0], at_bound=np.array([False, True]))
    assert held.rounding_errors()[1] > 0
