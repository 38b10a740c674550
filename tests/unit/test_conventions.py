"""Conventions: lights in other axes, or in another order than the photographs, are named; right ones are not."""

from __future__ import annotations

from functools import cache

import equinox as eqx
import numpy as np
import pytest
from synthetic import CAMERA, MATERIAL, forget, noisy, one_light_each, photographs, point_lights, standard_scene

import diffshade as ds
from diffshade.inverse.misfit.conventions import axes_in_words, orders

FREE = ("k_a", "k_d", "k_s", "n_s")
N = len(point_lights())
DIRECTIONS = ((-0.5, -0.3, -1.0), (0.7, -0.2, -0.8), (0.1, 0.6, -0.9))


@cache
def images() -> list[np.ndarray]:
    return noisy(photographs(standard_scene()), 0.005, 0)


def fitted(axes=None, order=range(N)) -> ds.Fit:
    """Fit the photographs by a scene with its lights in other axes, and each under the light of another one."""
    scene = forget(standard_scene())
    if axes is not None:
        places = [np.asarray(axes, float) @ np.asarray(light.position) for light in point_lights()]
        scene = eqx.tree_at(lambda s: [light.position for light in s.lights], scene, places)
    views = [eqx.tree_at(lambda v: v.image, one_light_each(images())[k], images()[i]) for i, k in enumerate(order)]
    return ds.fit(scene, views, free=FREE)


def said(fit: ds.Fit) -> str:
    (note,) = [note for note in fit.notes if note.kind in ("cause", "misfit")]
    assert note.names == ("convention",)
    assert not fit.determined.any()
    return note


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("axes", "words"),
    [
        (np.diag([1, -1, 1]), "with y negated"),
        pytest.param(np.diag([1, 1, -1]), "with z negated", marks=pytest.mark.slow),
        pytest.param(np.eye(3)[[1, 0, 2]], "with x and y swapped", marks=pytest.mark.slow),
    ],
    ids=["y", "z", "xy"],
)
def test_other_axes_are_named(axes, words):
    assert words in said(fitted(axes))


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("order", "words"),
    [
        (range(N - 1, -1, -1), "in the reverse order"),
        pytest.param([*range(1, N), 0], "one too late", marks=pytest.mark.slow),
        ([N - 1, *range(N - 1)], "one too early"),
        ([0, 1, 5, 3, 4, 2, *range(6, N)], "views[2] and views[5] seem to be swapped"),
    ],
    ids=["reversed", "late", "early", "two swapped"],
)
def test_otherorders_are_named(order, words):
    assert words in said(fitted(order=order))


@pytest.mark.parametrize(
    ("count", "axes", "words"),
    [
        (1, -np.eye(3), "with x, y and z negated"),
        (2, np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]]), "with y and z swapped and z negated"),
        (3, np.diag([-1, 1, 1]), "with x negated"),
    ],
    ids=["the sign of a sun", "z up", "mirrored"],
)
def test_a_few_photographs_tell_other_axes_too(count, axes, words):
    """k_a alone was determined, eight errors off; of one light directions are looked at that are reversed."""
    right = ds.Scene(ds.Object(ds.Sphere(), MATERIAL), [ds.DirectionalLight(d) for d in DIRECTIONS[:count]])
    views = one_light_each(noisy(photographs(right), 0.003, 0))
    turned = [ds.DirectionalLight(tuple(axes.T @ np.array(d, float))) for d in DIRECTIONS[:count]]
    assert words in said(ds.fit(forget(ds.Scene(right.objects, turned)), views, free=FREE))


@pytest.mark.parametrize("count", [1, 2])
def test_a_light_that_is_far_off_is_in_no_other_axes(count):
    right = ds.Scene(ds.Object(ds.Sphere(), MATERIAL), [ds.DirectionalLight(d) for d in DIRECTIONS[:count]])
    views = one_light_each(noisy(photographs(right), 0.003, 0))
    off = [ds.DirectionalLight(tuple(np.add(d, (0.9, -0.7, 0.3)))) for d in DIRECTIONS[:count]]
    fit = ds.fit(forget(ds.Scene(right.objects, off)), views, free=FREE)
    assert not [note for note in fit.notes if "convention" in note.names]


def test_a_right_set_up_is_in_no_other_convention():
    fit = fitted()
    assert fit.determined.all()
    assert not [note for note in fit.notes if note.kind in ("cause", "misfit")]
    assert MATERIAL.n_s == pytest.approx(float(fit.material.n_s), rel=0.05)
    assert fit.views[0].camera.shape == CAMERA.shape


def test_orders_are_those_of_lists_that_were_sorted_as_text_or_shifted():
    found = dict(orders(12))
    assert len(found) == 5
    as_text = next(order for words, order in found.items() if "the lights by number" in words)
    assert as_text[:5] == [0, 1, 10, 11, 2]
    back = next(order for words, order in found.items() if "the photographs by number" in words)
    assert [back[k] for k in as_text] == [*range(12)]
    assert len(dict(orders(8))) == 3  # as text they are sorted alike


def test_axes_are_said_in_words():
    assert axes_in_words(np.diag([1.0, -1.0, -1.0])).endswith("with y and z negated")
    assert axes_in_words(np.eye(3)[[0, 2, 1]]).endswith("with y and z swapped")
    assert axes_in_words(np.eye(3)[[1, 2, 0]]).endswith("with x, y and z in the order yzx")


def test_axes_of_which_one_is_right_are_said_in_one_sentence():
    y, x = np.diag([1.0, -1.0, 1.0]), np.diag([-1.0, 1.0, 1.0])
    assert axes_in_words(y, x).endswith("in other axes than the photographs, with y negated or with x negated")
