"""The one entry into float64: new arrays for the caller's objects, nothing copied, nothing else enters."""

import dataclasses
import re
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import diffshade as ds
from diffshade.core.backend import in_float64, with_new_arrays
from diffshade.core.fields import check
from diffshade.model import gbuffers

CAMERA = ds.Camera((0.1, 0.2, 4.3), fov=33, shape=(5, 7))


@dataclasses.dataclass(frozen=True)
class Holder:
    """What is no tree of JAX's, as a `Fit` is none."""

    camera: ds.Camera
    values: np.ndarray
    word: str


def test_nothing_else_enters_float64():
    root = Path(ds.__file__).parent
    entered = [f.name for f in root.rglob("*.py") if re.search(r"enable_x64\(", f.read_text(encoding="utf-8"))]
    assert entered == ["backend.py"]


def test_new_arrays_are_other_objects_that_show_the_same_memory():
    image = np.zeros((5, 7, 3))
    held = Holder(CAMERA, np.arange(3.0), "word")
    view, new = with_new_arrays((ds.View(image, CAMERA), held))
    for old, other in ((image, view.image), (CAMERA.eye, view.camera.eye), (held.values, new.values)):
        assert old is not other
        assert np.shares_memory(old, other)
    assert new.camera.eye is not CAMERA.eye
    assert new.word == "word"
    assert view.camera.shape == CAMERA.shape


def test_a_constant_of_a_users_program_is_float64_in_float64():
    constant = np.array([0.1, 0.2, 0.3])
    with jax.enable_x64(False):
        program = jax.jit(lambda x: x * jnp.sum(constant))
        program(jnp.float32(1.0))
        assert jax.lax.neg(constant).dtype == np.float32
    with in_float64(constant) as own:
        negative = np.asarray(jax.lax.neg(own))
    assert negative.dtype == np.float64
    np.testing.assert_array_equal(negative, -constant)


@pytest.mark.thorough
def test_a_picture_in_the_other_precision_after_a_users_program():
    camera = ds.Camera((0.1, 0.2, 4.3), fov=33, shape=(5, 9))  # of a shape that no other test compiles for
    scene = ds.Scene(ds.Object(ds.Sphere(), ds.Material(k_d=0.6)), ds.PointLight((2, 3, 4)))
    with jax.enable_x64(False):
        program = jax.jit(lambda x: x * sum(jnp.sum(leaf) for leaf in jax.tree.leaves((camera, scene))))
        program(jnp.float32(1.0))
    with jax.enable_x64(True):
        image, seen = ds.render(scene, camera), ds.intersect(scene, camera)
    assert image.dtype == seen.normal.dtype == np.float64


def test_a_gbuffer_that_was_looked_at_is_known_in_new_arrays(monkeypatch):
    normal = np.zeros((4, 6, 3))
    normal[..., 2] = 1.0
    buffer = with_new_arrays(ds.GBuffer(normal))
    monkeypatch.setattr(gbuffers, "_remember", None)  # what a new look would call
    check(buffer)


def test_a_part_of_a_sound_gbuffer_is_not_taken_for_the_whole():
    normal = np.zeros((4, 6, 3))
    normal[..., 2] = 1.0
    part = ds.GBuffer(normal).normal[:2]
    assert gbuffers._owner(part) is part
