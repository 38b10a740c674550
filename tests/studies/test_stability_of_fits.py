"""Examinations of many fits: what depends on the data kept is not determined, and what does not is."""

import numpy as np
import pytest
from measured import measured
from synthetic import FREE, TIED, forget, noisy, one_light_each, photographs, standard_scene

import diffshade as ds

pytestmark = pytest.mark.slow

MATERIAL_ALONE = ("k_a", "k_d", "k_s", "n_s")


@pytest.mark.parametrize(("sigma", "seed"), [(0.02, 1), (0.02, 2)])
def test_of_the_model_itself_nothing_moves(sigma, seed):
    views = one_light_each(noisy(photographs(standard_scene()), sigma, seed))
    fit = ds.fit(forget(standard_scene()), views, free=FREE, tied=TIED)
    examination = ds.examine(fit)
    assert examination.determined.all()
    assert not any(refit.moved.any() for refit in examination.refits)
    assert not any("depends on which" in note for note in examination.notes)


@pytest.mark.parametrize("clipped", ["hinge", "exclude"])
@pytest.mark.parametrize("seed", [0, 1])
def test_of_clipped_photographs_of_the_model_nothing_moves(clipped, seed):
    scene = standard_scene()
    images = [np.minimum(image, 0.45) for image in noisy(photographs(scene), 0.01, seed)]
    fit = ds.fit(forget(scene), one_light_each(images, saturation=0.45), free=MATERIAL_ALONE, clipped=clipped)
    examination = ds.examine(fit)
    assert any("saturated" in refit.without for refit in examination.refits)
    assert not any(refit.moved.any() for refit in examination.refits)
    assert examination.determined.all() or clipped == "exclude"  # with the highlights' tops goes much of k_s


@pytest.mark.parametrize("count", [1, 8])
def test_of_photographs_without_noise_nothing_is_said_to_move(count):
    scene = standard_scene()
    fit = ds.fit(forget(scene), one_light_each(photographs(scene)[:count]), free=MATERIAL_ALONE)
    examination = ds.examine(fit)
    assert examination.determined.all()
    assert not any("depends on which" in note for note in examination.notes)
    np.testing.assert_allclose(examination.interval_95.mean(1), fit.values, rtol=1e-6)


def test_a_highlight_of_another_shape_is_not_determined_and_its_second_part_is_named():
    """A core of its own, as of a coat of varnish: n_s is what the core says, or what the rest says."""
    scene = standard_scene(ds.Material((0.1, 0.08, 0.06), (0.6, 0.4, 0.25), 0.15, 8))
    core = ds.Scene(ds.Object(ds.Sphere(), ds.Material(0, 0, 1.5, 600)), scene.lights)
    camera = ds.Camera(eye=(0, 0, 4), fov=32, shape=(64, 64))
    both = [a + b for a, b in zip(photographs(scene, camera), photographs(core, camera), strict=True)]
    fit = ds.fit(forget(scene), one_light_each(noisy(both, 0.003, 0), camera), free=("k_a", "k_d", "k_s", "n_s"))
    examination = ds.examine(fit)
    lost = {name.rsplit(".", 1)[0] for name, known in zip(fit.names, examination.determined, strict=True) if not known}
    assert [refit.without for refit in examination.refits][:5] == [
        "the odd views",
        "the even views",
        "the brightest half of the highlight",
        "2 degrees around the highlight",
        "5 degrees around the highlight",
    ]
    assert "n_s" in lost
    assert not fit.determined[[fit.names.index(f"k_s.{c}") for c in "rgb"]].any()
    assert any("second, wider part" in note for note in examination.notes)  # which moves k_d, too
    assert "k_d" in lost
    (note,) = [note for note in examination.notes if note.startswith("n_s depends on which data")]
    assert "highlight" in note
    assert "not determined" in next(line for line in str(examination).splitlines() if line.startswith("n_s"))


def test_the_ball_has_a_diffuse_colour_and_no_exponent():
    fit = ds.fit(*ds.read_photographs(measured("diligent_ball")), free=("k_a", "k_d", "k_s", "n_s"))
    examination = ds.examine(fit)
    known = dict(zip(fit.names, examination.determined, strict=True))
    assert not known["n_s"]
    assert known["k_d.r"]
    assert known["k_d.g"]
    assert known["k_d.b"]
    assert any(note.startswith("n_s depends on which data") for note in examination.notes)
    k_d = [fit.names.index(f"k_d.{c}") for c in "rgb"]
    np.testing.assert_allclose(fit.values[k_d], (0.164, 0.138, 0.090), rtol=0.02)
