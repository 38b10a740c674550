"""The fast form of a fit is the generic form: the same sums over the pixels, and the best linear unknowns exactly."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import own_parts
import pytest
from float64 import float64  # noqa: F401
from grams import whole
from synthetic import light_positions, seen_by, standard_scene

import diffshade as ds
from diffshade.core.backend import jit_quickly
from diffshade.inverse.data.view_sets import ViewSet
from diffshade.inverse.fitting import new_problem
from diffshade.inverse.forward.features import FeatureModel, features_can_serve
from diffshade.inverse.forward.gram import Gram
from diffshade.inverse.forward.rendered import RenderedModel
from diffshade.inverse.pixels.blocks import total
from diffshade.inverse.problem import FitProblem, fit_problem
from diffshade.inverse.solve.solvers import evaluate
from diffshade.inverse.unknowns.parameters import find_unknowns
from diffshade.inverse.unknowns.unknown import coordinates

SMALL = ds.Camera(eye=(0, 0, 4), fov=32, shape=(8, 9))
ATTENUATION = ds.RadialAttenuation(1.0, 0.1, 0.05)
P = light_positions(6)
POINT = ds.PointLight(P[0], (1.0, 0.8, 0.6), ATTENUATION)
POINT_2 = ds.PointLight(P[1], 1.5, ATTENUATION)
SPOT = ds.SpotLight(P[2], -P[2], 2.0, 35.0, 2.0, ATTENUATION, softness=10.0)
SUN = ds.DirectionalLight((-0.3, -0.5, -1.0), (0.4, 0.5, 0.6))
CLAMPED = ds.PointLight(2.6 * P[3] / np.linalg.norm(P[3]), 1.2, ds.RadialAttenuation(0.5, 0.1, 0.05, clamp=True))
PHONG = ds.Material((0.1, 0.08, 0.06), (0.6, 0.4, 0.25), (0.5, 0.4, 0.3), 20)
BLINN = ds.Material((0.1, 0.08, 0.06), (0.6, 0.4, 0.25), (0.5, 0.4, 0.3), 20, lobe=ds.Blinn())
BOUNDS = {"k_d": (0.05, 0.3), "k_s": (0.1, 0.9), "k_s/k_d": (0.3, 2.0)}  # some of which hold, and none is dark
ATTENUATED = ("k_a", "k_d", "k_s", "n_s", "attenuation")


class Case(NamedTuple):
    scene: ds.Scene
    views: list[ds.View]
    free: tuple[str, ...]
    tied: tuple[str, ...] = ()
    constraints: tuple = ()
    loss: str = "squares"
    clipped: str = "hinge"
    shared: bool = True
    bounds: tuple[str, ...] = ("k_d", "k_s")

    def problem(self, *, rendered: bool) -> FitProblem:
        data = ViewSet.of(self.scene, self.views)
        bounds = {name: BOUNDS[name] for name in self.bounds} if self.shared else None
        options = (self.free, self.tied, bounds, self.constraints)
        unknowns = find_unknowns(self.scene, self.views, *options, grey=bool(data.grey))
        data = new_problem(self.scene, data, unknowns, self.loss, self.clipped).data
        problem = fit_problem(self.scene, data, unknowns, self.loss, rendered=rendered)
        return problem.with_scale(0.2 if self.loss != "squares" else 1.0, self.loss)


def noise(seed: int, *channels: int) -> np.ndarray:
    """A photograph of noise, so that residuals are large and of both signs."""
    return np.random.default_rng(seed).uniform(0.0, 1.0, (*SMALL.shape, *channels))


def view(lit: Any = None, seed: int = 0, channels: tuple[int, ...] = (3,), **options: Any) -> ds.View:
    return ds.View(noise(seed, *channels), SMALL, lit=lit, **options)


def all_kinds_of_lights_and_blinn():
    """None, one, two and three lights lit at once; every coefficient of light is free, one constant among them.

    Some of what the first one lights is so near that its attenuation is clamped, where its derivatives are 0.
    """
    scene = standard_scene(BLINN, [CLAMPED, SUN, SPOT])
    mask = noise(9) > 0.3
    views = [view(0), view((2, 1), 1, exposure=0.4), view((), 2, black=0.1), view(None, 3, mask=mask, exposure=2.0)]
    everything = (*ATTENUATED, "lights.0.attenuation.constant", "intensity", "ambient", "views.1.exposure")
    return Case(scene, views, (*everything, "views.1.black", "views.2.black"))


def tied_attenuation_with_its_constant_free():
    scene = standard_scene(PHONG, [POINT, POINT_2, ds.PointLight(P[4], 2.0, ATTENUATION)])
    views = [view((0, 1, 2)), view((0, 2), 1), view(1, 2)]
    return Case(scene, views, (*ATTENUATED, "constant", "exposure"), ("attenuation", "exposure"))


def constraints_and_a_factor():
    scene = standard_scene(PHONG, [POINT, POINT_2, SUN])
    constraints = (ds.Grey("k_d"), ds.Proportional("k_s", "k_d"), ds.Proportional("k_a", "k_d", 0.2))
    free = ("k_d", "k_s", "n_s", "quadratic")
    return Case(scene, [view(0), view((1, 2), 1)], free, ("quadratic",), constraints, bounds=("k_s/k_d",))


def grey_views():
    scene = standard_scene(PHONG, [POINT, SUN])
    views = [view(0, 0, ()), view((0, 1), 1, (2,), exposure=0.5), view(1, 2, (1,))]
    return Case(scene, views, (*ATTENUATED, "intensity", "black"))


def grey_and_colour_views_of_known_noise():
    scene = standard_scene(PHONG, [POINT, SUN])
    views = [view(0, 0, (), noise=0.1), view((0, 1), 1, noise=0.02), view(1, 2, noise=ds.Noise(read=0.1, levels=20))]
    return Case(scene, views, (*ATTENUATED, "ambient", "views.0.exposure"))


def a_g_buffer_with_a_mask_and_a_highlight_of_its_own_colour():
    scene = ds.Scene(ds.Object(seen_by(SMALL), BLINN), [POINT, SPOT])
    constraints = (ds.Proportional("k_s", "k_d", 0.7), ds.Grey("k_a"), ds.Grey("intensity"))
    views = [view(0, mask=noise(9) > 0.4), view((0, 1), 1)]
    return Case(scene, views, ("k_a", "k_d", "n_s", "lights.1.intensity"), (), constraints, bounds=("k_d",))


def robust_grey_normals_without_positions_and_n_s_known():
    flat = ds.OrthographicCamera((0, 0, 4), shape=SMALL.shape, local_viewer=False)
    scene = ds.Scene(ds.Object(ds.GBuffer(seen_by(flat).normal), PHONG), [SUN, ds.DirectionalLight((1, 0, -1))])
    views = [ds.View(noise(0), flat, lit=(0, 1)), ds.View(noise(1, 1), flat, lit=1)]
    return Case(scene, views, ("k_d", "k_s"), loss="geman-mcclure", shared=False)


def huber_and_clipped_samples():
    scene = standard_scene(BLINN, [POINT, SPOT])
    views = [view(0, saturation=0.8), view(1, 1, (), floor=0.2), view((), 2), view(None, 3, exposure=2.0)]
    return Case(scene, views, (*ATTENUATED, "intensity", "black"), loss="huber", shared=False)


def clipped_samples_of_known_noise():
    """Of a size that grows with the light."""
    shot = ds.Noise(read=0.3, shot=0.4)
    scene = standard_scene(PHONG, [CLAMPED, ds.PointLight(P[5], 1.5, CLAMPED.attenuation)])
    views = [view(0, saturation=0.8, noise=shot), view((0, 1), 1, floor=0.2, noise=shot)]
    return Case(scene, views, (*ATTENUATED, "constant"), ("attenuation",), clipped="tobit", shared=False)


def lights_that_move_and_one_that_does_not():
    """Of each kind, on together and alone, one view with none; what a view does not show is not asked of it."""
    scene = standard_scene(BLINN, [CLAMPED, SUN, SPOT, POINT_2])
    views = [view(0), view((2, 1), 1, exposure=0.4), view((), 2), view((0, 3), 3), view(3, 4, ())]
    free = (*ATTENUATED, "position", "lights.1.direction", "lights.1.intensity", "exposure")
    return Case(scene, views, free, ("attenuation",), (ds.Grey("intensity"),))


def own_laws_of_attenuation(*moving: str):
    """Beside the library's, and a light that none attenuates; an amplitude is free."""
    exponential = ds.PointLight(P[0], 1.5, own_parts.HazyAttenuation(0.3))
    power = ds.SpotLight(P[1], -P[1], 2.0, 40.0, 1.0, own_parts.PowerAttenuation(0.5, 1.2), softness=10.0)
    scene = standard_scene(PHONG, [exponential, power, SUN, CLAMPED])
    views = [view(0), view((0, 1, 2), 1), view((1, 3), 2, exposure=0.5)]
    return Case(scene, views, (*ATTENUATED, "a", "lights.1.intensity", *moving))


def own_laws_of_lights_that_move():
    return own_laws_of_attenuation("lights.0.position")


def directions_of_clipped_photographs():
    flat = ds.OrthographicCamera((0, 0, 4), shape=SMALL.shape, local_viewer=False)
    lights = [SUN, ds.DirectionalLight((1, 0, -1)), ds.DirectionalLight((0, -1, -1))]
    scene = ds.Scene(ds.Object(ds.GBuffer(seen_by(flat).normal), PHONG), lights)
    views = [ds.View(noise(i), flat, lit=i, saturation=0.8) for i in range(3)]
    return Case(scene, views, ("k_a", "k_d", "k_s", "n_s", "direction"), loss="cauchy", shared=False)


CASES = [
    all_kinds_of_lights_and_blinn,
    lights_that_move_and_one_that_does_not,
    directions_of_clipped_photographs,
    constraints_and_a_factor,
    grey_and_colour_views_of_known_noise,
    robust_grey_normals_without_positions_and_n_s_known,
    *(
        pytest.param(case, marks=pytest.mark.thorough)
        for case in (
            tied_attenuation_with_its_constant_free,
            grey_views,
            a_g_buffer_with_a_mask_and_a_highlight_of_its_own_colour,
            huber_and_clipped_samples,
            clipped_samples_of_known_noise,
            own_laws_of_attenuation,
            own_laws_of_lights_that_move,
        )
    ),
]


@jit_quickly
def _summary(theta, form, chunk):
    return form.summary(theta, chunk)


def rendered_gram(theta: np.ndarray, work: FitProblem) -> Gram:
    """Return the Gram of each view by rendering; compiled without optimisation, which takes half the time."""
    summary = total([_summary(jnp.asarray(theta), work.model, chunk) for chunk in work.chunks()])
    return whole(work.model.gram(jnp.asarray(theta), summary), len(theta))


def random_values(work: FitProblem, random: np.random.Generator) -> np.ndarray:
    """Unknowns of the size that they have in a scene, in the solver's coordinates."""
    values = random.uniform(0.2, 0.9, len(work.unknowns))
    small = np.array([u.kind in ("constant", "linear", "quadratic") for u in work.unknowns])
    values = np.where(small, 0.4 * values, values)
    near = np.array([u.start for u in work.unknowns]) + random.uniform(-0.1, 0.1, len(values))
    values = np.where([u.parameter.role in ("position", "direction") for u in work.unknowns], near, values)
    values = np.where([u.logarithmic for u in work.unknowns], random.uniform(3.0, 40.0, len(values)), values)
    return coordinates(values, work.unknowns)


def assert_agree(fast: Gram, generic: Gram) -> None:
    """To 1e-8 of the lengths of the Jacobian's columns and of the residual."""
    assert np.all(generic.cost > 0)
    np.testing.assert_allclose(fast.cost, generic.cost, rtol=1e-8)
    length = np.sqrt(np.diagonal(generic.hessian, axis1=1, axis2=2))
    assert np.all(length.max(0) > 0)  # every unknown is seen in some view
    apart = np.abs(fast.hessian - generic.hessian)
    assert np.all(apart <= 1e-8 * length[:, :, None] * length[:, None, :])
    residual = np.sqrt(2.0 * generic.cost)
    assert np.all(np.abs(fast.gradient - generic.gradient) <= 1e-8 * length * residual[:, None])


@pytest.mark.thorough
@pytest.mark.parametrize("make", CASES)
def test_the_fast_form_adds_up_what_the_generic_form_does_and_its_linear_unknowns_are_the_best(make):
    """The cost is quadratic in them, so that the best within their bounds is where no slope leads down.

    Where one pass serves at any linear unknowns, the fast form looks at the best; it passed at others.
    """
    case = make()
    fast, generic = (case.problem(rendered=rendered) for rendered in (False, True))
    assert isinstance(fast.model, FeatureModel)
    assert isinstance(generic.model, RenderedModel)
    assert fast.model.shared == fast.model.projects == case.shared
    box = [np.asarray(end) for end in (fast.box.lower, fast.box.upper)]
    linear = np.array([u.parameter.linear for u in fast.unknowns])
    chunks = fast.chunks()
    held, moved = 0, 0.0
    for seed in range(2):
        theta = np.clip(random_values(fast, np.random.default_rng(seed)), *box)
        point = evaluate(theta, fast.task(1.0), chunks)
        found = np.asarray(point.theta)
        views = rendered_gram(found, generic)
        assert_agree(whole(point.views, len(found)), views)
        if not case.shared:
            np.testing.assert_array_equal(found, theta)
            continue
        np.testing.assert_array_equal(found[~linear], theta[~linear])
        slope, low, high = views.gradient.sum(0), found < box[0] + 1e-9, found > box[1] - 1e-9
        small = 1e-8 * np.sqrt(np.diag(views.hessian.sum(0)) * 2.0 * views.cost.sum())
        assert np.all((slope > -small) | ~linear | high)
        assert np.all((slope < small) | ~linear | low)
        held += int((linear & (low | high)).sum())
        moved = max(moved, np.abs(found - theta)[linear].max())
    assert moved > 0.01 or not case.shared
    assert held > 0 or not (case.shared and "k_d" in case.bounds)


def test_a_clamped_attenuation_is_compared_on_both_sides_of_its_clamp():
    """At the values that the comparison above draws."""
    work = all_kinds_of_lights_and_blinn().problem(rendered=False)
    names = [u.name for u in work.unknowns]
    theta = random_values(work, np.random.default_rng(0))
    a0, a1, a2 = (theta[names.index(f"lights.0.attenuation.{name}")] for name in ("constant", "linear", "quadratic"))
    seen = seen_by(SMALL)
    to_light = CLAMPED.position - np.asarray(seen.position)
    d = np.linalg.norm(to_light, axis=-1)[(to_light * np.asarray(seen.normal)).sum(-1) > 0]
    f = 1.0 / (a0 + d * (a1 + d * a2))
    assert (f > 1.0).sum() > 3
    assert (f < 1.0).sum() > 3


FIVE = standard_scene(PHONG, [ds.PointLight(position, 1.0, ATTENUATION) for position in P[:5]])
TWO = ds.Scene([ds.Object(ds.Sphere()), ds.Object(ds.Sphere((1, 1, 1), 0.2))], [POINT])
BALL = standard_scene(PHONG, [POINT, SPOT, SUN])
OWN = standard_scene(PHONG, [ds.PointLight(P[0], 1.0, own_parts.HazyAttenuation()), POINT])
CHANNELS = ds.Material(0.1, 0.5, 0.3, (10, 20, 30))


@pytest.mark.parametrize(
    ("scene", "lit", "free", "has"),
    [
        pytest.param(BALL, None, ("material", "attenuation", "constant", "intensity", "ambient"), True, id="light"),
        pytest.param(OWN, None, ("k_d", "attenuation", "rho"), True, id="numbers of an own law"),
        pytest.param(BALL, None, ("k_d", "exposure", "black"), True, id="numbers of views"),
        pytest.param(BALL, None, ("lights.0.position",), True, id="a position"),
        pytest.param(BALL, None, ("k_d", "lights.2.direction"), True, id="a direction"),
        pytest.param(BALL, None, ("k_d", "center"), False, id="a centre"),
        pytest.param(BALL, None, ("k_d", "cutoff"), False, id="a cutoff"),
        pytest.param(BALL, None, ("k_d", "exponent"), False, id="an exponent of a spot"),
        pytest.param(BALL, None, ("k_d", "radius"), False, id="a radius"),
        pytest.param(TWO, None, ("k_d",), False, id="two objects"),
        pytest.param(standard_scene(CHANNELS, [POINT]), None, ("k_d",), False, id="n_s a channel"),
        pytest.param(standard_scene(CHANNELS, [POINT]), None, ("n_s",), False, id="n_s a channel, free"),
        pytest.param(FIVE, None, ("k_d",), False, id="five lights at once"),
        pytest.param(FIVE, (0, 1, 2, 3), ("k_d",), True, id="four of five lights"),
        pytest.param(standard_scene(ds.Material(n_s=0), [POINT]), None, ("k_d",), False, id="n_s = 0"),
        pytest.param(standard_scene(ds.Material(n_s=0), [POINT]), None, ("n_s",), True, id="n_s free from 0"),
        pytest.param(standard_scene(PHONG, []), None, ("k_a",), True, id="no light"),
    ],
)
def test_the_fast_form_serves_where_every_unknown_is_a_number_of_the_light(scene, lit, free, has):
    views = [view(0 if scene.lights else ()), view(lit, 1)]
    assert features_can_serve(scene, views, find_unknowns(scene, views, free)) is has


@pytest.mark.thorough
def test_an_ambient_scene_without_a_light_is_the_same_in_both_forms():
    case = Case(standard_scene(PHONG, []), [view()], ("k_a", "black"), bounds=())
    fast, generic = (case.problem(rendered=rendered) for rendered in (False, True))
    assert isinstance(fast.model, FeatureModel)
    point = evaluate(np.array([0.3, 0.2, 0.5, 0.1]), fast.task(1.0), fast.chunks())
    assert_agree(whole(point.views, 4), rendered_gram(np.asarray(point.theta), generic))
