"""Plans: the errors they promise are those that refits then have, and their first choice is the best."""

import itertools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from shots import with_shot
from synthetic import (
    ATTENUATION,
    CAMERA,
    FREE,
    TIED,
    forget,
    noisy,
    one_light_each,
    photograph,
    photographs,
    seen_by,
    standard_scene,
)

import diffshade as ds
from diffshade.inverse.unknowns.unknown import natural

pytestmark = pytest.mark.slow

SIGMA = 0.002
LAMPS = ((1.0, 1.0, 1.6), (-2.5, 0.5, 3.5), (0.5, -2.0, 1.8), (1.5, 2.5, 5.0))
SCENE = standard_scene(lights=[ds.PointLight(p, 1.0, ATTENUATION) for p in LAMPS])
# of the lamp only where it is: its attenuation is what the fit finds
SHOTS = (
    ds.Shot(light=ds.PointLight((0, 0, 3)), name="in front"),
    ds.Shot(light=ds.PointLight((0, 0, 8)), name="far"),
    ds.Shot(light=ds.PointLight((2.0, 0, 1.0)), exposure=2.0, name="at the side"),
    ds.Shot(light=ds.PointLight((-1.2, 1.2, 1.2)), exposure=0.7, name="near"),
    ds.Shot(camera=ds.Camera((2, 0, 4), fov=32, shape=(24, 24)), name="from the side"),
    ds.Shot(light=ds.PointLight((3, 3, 4)), camera=ds.Camera((0, -3, 3), fov=32, shape=(24, 24)), name="from below"),
)


@pytest.fixture(scope="module")
def fit():
    return ds.fit(forget(SCENE), one_light_each(noisy(photographs(SCENE), SIGMA, 0)), free=FREE, tied=TIED)


def refits_with(shot: ds.Shot, draws: int) -> np.ndarray:
    """What fits find with the shot among the views, each time with new noise."""
    scene, view = with_shot(SCENE, shot)
    clean = ds.fit(scene, [*one_light_each(photographs(SCENE)), view], free=FREE, tied=TIED)
    found = []
    with jax.enable_x64(True):
        laid = clean.solved.laid_out()
        log = np.array([u.logarithmic for u in clean.unknowns])
        for draw in range(draws):
            random = np.random.default_rng(draw)  # the same noise in the views that all candidates share

            def scattered(chunk, random=random):
                noise = SIGMA * random.standard_normal(chunk.observed.target.shape)
                target = chunk.observed.target + noise * np.asarray(chunk.points.counts)[:, None]
                return eqx.tree_at(lambda c: c.observed.target, chunk, jnp.asarray(target))

            end = laid.minimise({}, laid.theta, [scattered(chunk) for chunk in laid.chunks], rtol=1e-9)
            assert not end.message
            found.append(np.asarray(natural(end.theta, log)))
    return np.array(found)


def test_the_first_choice_is_the_best_and_the_errors_are_those_of_refits(fit):
    """Spread of the first choice over the smallest of all, and predicted over observed spread."""
    found = [refits_with(shot, draws=200) for shot in SHOTS]
    p = len(fit.values)
    report = []
    for name in ("n_s", "k_s.r", "quadratic", "linear"):
        plan = ds.plan(fit, SHOTS, aim=name)
        j = fit.names.index(name)
        spread = np.array([values[:, j].std(ddof=1) for values in found])
        report.append((name, spread[plan.order[0]] / spread.min(), plan.errors[:, j] / spread))
    plan = ds.plan(fit, SHOTS)
    relative = [values / fit.values for values in found]
    spread = np.exp([np.linalg.slogdet(np.cov(values.T))[1] / (2 * p) for values in relative])
    now = np.linalg.slogdet(fit.covariance / np.outer(fit.values, fit.values))[1]
    predicted = np.exp((now - plan.gain) / (2 * p))
    report.append(("det^(1/2p)", spread[plan.order[0]] / spread.min(), predicted / spread))
    for name, first, ratio in report:
        print(f"{name}: first choice over the smallest {first:.3f}, predicted/observed {np.round(ratio, 3)}")
        assert first <= 1.1, name
        assert np.all((ratio > 0.8) & (ratio < 1.25)), name


def test_the_order_of_the_shots_does_not_matter(fit):
    for aim in (None, "n_s"):
        ranked = [SHOTS[i].name for i in ds.plan(fit, SHOTS, aim=aim).order]
        for mixed in itertools.islice(itertools.permutations(SHOTS), 1, 720, 240):
            assert [mixed[i].name for i in ds.plan(fit, mixed, aim=aim).order] == ranked


def test_a_shot_like_the_views_adds_what_they_did(fit):
    """All views taken once more: every error shrinks by sqrt 2."""
    plans = [ds.plan(fit, ds.Shot(light=ds.PointLight(p))) for p in LAMPS]
    added = sum(np.exp(plan.gain[0]) for plan in plans)
    assert added > 3.0
    single_view = ds.fit(SCENE, one_light_each(photographs(SCENE))[0], free=("k_a", "k_d"), priors={})
    again = ds.plan(single_view, ds.Shot())
    np.testing.assert_allclose(again.errors[0], again.now / np.sqrt(2.0), rtol=1e-6)
    np.testing.assert_allclose(again.gain[0], 6 * np.log(2.0), rtol=1e-6)


# --- whose unknowns a lamp has


def test_a_lamp_of_another_kind_has_its_own_numbers(fit):
    lamps = [
        ds.SpotLight((0, 0, 8), (0, 0, -1), 1.0, 60.0, attenuation=ds.RadialAttenuation(1.0, 0.0, q))
        for q in (0.0, 2.0)
    ]
    plan = ds.plan(fit, [ds.Shot(light=lamp) for lamp in lamps], aim="quadratic")
    assert plan.gain[0] > plan.gain[1] > 0


def test_the_exposures_of_the_views_are_not_the_shots():
    views = one_light_each(noisy(photographs(SCENE), SIGMA, 0))
    fit = ds.fit(SCENE, views, free=("k_d", "views.0.exposure"), start="scene")
    plan = ds.plan(fit, SHOTS[0])
    j = fit.names.index("exposure") if "exposure" in fit.names else -1
    assert plan.errors[0, j] < plan.now[j]  # by k_d alone
    assert any("exposure of a view" in note for note in plan.notes)


# --- a present that is singular


AT_ONE_POINT = eqx.tree_at(lambda b: b.position, seen_by(CAMERA), replace_fn=np.zeros_like)


def at_one_distance() -> ds.Fit:
    """A small ball far from its lamp: all of it is as far away."""
    lamps = [ds.PointLight(3.0 * np.array(d), 1.0, ATTENUATION) for d in ((0.6, 0.0, 0.8), (0.0, 0.6, 0.8))]
    scene = ds.Scene(ds.Object(AT_ONE_POINT, ds.Material(k_a=0.1, k_d=0.5, k_s=0.0)), lamps)
    images = noisy(photographs(scene), 0.002, 0)
    return ds.fit(scene, one_light_each(images), free=("k_d", "linear", "quadratic"), tied=TIED)


def test_where_the_views_leave_something_open_what_settles_more_of_it_comes_first():
    fit = at_one_distance()
    assert not np.isfinite(fit.plain_errors).any()
    shots = [
        ds.Shot(light=ds.PointLight((0, 0, 3)), exposure=20.0, name="as far, and bright"),
        ds.Shot(light=ds.PointLight((0, 0, 6)), name="twice as far"),
        ds.Shot(light=ds.PointLight((0, 0, 12)), name="four times as far"),
    ]
    plan = ds.plan(fit, shots)
    assert plan.rank.tolist() == [0, 1, 1]
    assert plan.order[-1] == 0
    assert plan.gain[0] > 0
    text = str(plan)
    assert "none of these shots determines k_d, linear and quadratic" in text
    assert text.splitlines()[1].split()[-2:] == ["new", "gain"]


def test_a_number_that_stays_lost_in_the_noise_is_said_to():
    """The n_s of a ball that is all but matte."""
    scene = standard_scene(ds.Material(k_a=0.0, k_d=0.5, k_s=0.002, n_s=30), SCENE.lights)
    images = noisy(photographs(scene), 0.005, 0)
    fit = ds.fit(scene, one_light_each(images), free=("k_d", "n_s"), start="scene")
    assert not fit.determined[fit.names.index("n_s")]
    plan = ds.plan(fit, ds.Shot(light=ds.PointLight((0, 0, 3)), name="in front"), aim="n_s")
    assert "even with in front, n_s would be lost in the noise." in plan.notes


def test_what_a_shot_determines_that_the_views_do_not_is_said():
    lamp = ds.PointLight((1.8, 0.0, 2.4), 1.0, ATTENUATION)
    scene = ds.Scene(ds.Object(AT_ONE_POINT, ds.Material(k_a=0.1, k_d=0.5, k_s=0.0)), lamp)
    fit = ds.fit(scene, one_light_each(photographs(scene)), free=("k_d", "quadratic"))
    plan = ds.plan(fit, ds.Shot(light=ds.PointLight((0, 0, 6)), name="far"), aim="quadratic")
    assert plan.rank.tolist() == [1]
    assert "far determines k_d and quadratic, which the views do not." in plan.notes
    assert np.isfinite(plan.errors).all()


# --- pixels, noise and other scenes


def test_with_the_noise_known_a_shot_weighs_by_it():
    noise = ds.Noise(read=0.002, shot=1e-4)
    fit = ds.fit(SCENE, one_light_each(photographs(SCENE), noise=noise), free=("k_d", "n_s"), start="scene")
    shot = ds.Shot(light=ds.PointLight((0, 0, 3), 1.0, ATTENUATION))  # known in this fit
    scene, view = with_shot(SCENE, shot)
    after = ds.fit(
        scene, [*one_light_each(photographs(SCENE), noise=noise), eqx.tree_at(
            lambda v: v.noise, view, noise, is_leaf=lambda x: x is None)], free=("k_d", "n_s"), start="scene"
    )  # fmt: skip
    np.testing.assert_allclose(ds.plan(fit, shot).errors[0], after.plain_errors, rtol=1e-5)


def test_scenes_of_several_objects_are_planned_too():
    scene = ds.Scene(
        [ds.Object(ds.Sphere(), ds.Material(k_d=0.5, k_s=0.3, n_s=20)), ds.Object(ds.Plane((0, -1, 0), (0, 1, 0)))],
        ds.PointLight((1, 2, 3)),
    )
    image = noisy([photograph(scene)], 0.002, 0)
    fit = ds.fit(
        scene, ds.View(image[0], CAMERA), free=("objects.0.material.k_d", "objects.0.material.n_s"), start="scene"
    )
    plan = ds.plan(fit, [ds.Shot(light=ds.PointLight((0, 0, 3)), name="lamp"), ds.Shot(name="again")], aim="n_s")
    assert np.all(plan.errors < plan.now)
    np.testing.assert_allclose(plan.errors[1], plan.now / np.sqrt(2.0), rtol=1e-6)


def test_grey_photographs_are_planned_as_grey():
    views = [ds.View(v.image.mean(-1), CAMERA, lit=v.lit) for v in one_light_each(noisy(photographs(SCENE), SIGMA, 0))]
    fit = ds.fit(SCENE, views, free=("k_d", "n_s"), start="scene")
    plan = ds.plan(fit, ds.Shot(light=ds.PointLight((0, 0, 3), 1.0, ATTENUATION)))
    assert plan.errors.shape == (1, 2)
    assert np.all(plan.errors < plan.now)
