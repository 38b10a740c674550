"""Lobes, lights, patterns and surfaces of one's own: rendered, fitted, written and reported as the library's are."""

import dataclasses
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path as FilePath
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import own_parts
import pytest
import synthetic
from changed_fits import with_problem

import diffshade as ds
from diffshade.extension import (
    AbstractEmitter,
    AbstractLamp,
    AbstractLobe,
    AbstractPattern,
    AbstractPowerLobe,
    Colour,
    Path,
    RadialAttenuation,
    Scalar,
    Vec3,
    Vector,
    colour,
    dot,
    length,
    normalize,
    number,
    vector,
)
from diffshade.inverse.verdicts.stability import angle_to_highlight
from diffshade.report.page.ball import ball_scene

CAMERA = ds.Camera(eye=(0, 0, 4), fov=32, shape=(24, 24))


def own_scene(lobe: Any = None, light: Any = None, k_d: Any = 0.5) -> ds.Scene:
    material = ds.Material(0.1, k_d, 0.2, 20, lobe=lobe or own_parts.MicroFacets(0.3))
    return ds.Scene(ds.Object(ds.Sphere(), material), light or own_parts.TubeLight((-1, 2, 3), (2, 2, 3), 2.0))


@pytest.fixture(scope="module")
def fit():
    """The width of an own lobe and an own law of attenuation, under an own lamp and two that have the law."""
    law = own_parts.HazyAttenuation(0.3)
    lights = (own_parts.FadingLamp((1, 2, 3)), ds.PointLight((-1, 1, 2), 1.0, law), ds.PointLight((1, -1, 3), 2.0, law))
    scene = synthetic.standard_scene(ds.Material(0.1, 0.5, 0.2, lobe=own_parts.MicroFacets(0.2)), lights)
    views = synthetic.one_light_each(synthetic.noisy(synthetic.photographs(scene), 0.002, 0))

    def unknown(s):
        return [s.objects[0].material.lobe.m, *(light.attenuation.rho for light in s.lights[1:])]

    wrong = eqx.tree_at(unknown, scene, [np.asarray(1.5), *[np.asarray(0.1)] * 2])
    return ds.fit(wrong, views, free=("k_a", "k_d", "k_s", "m", "attenuation"), tied=("attenuation",))


DISTANCES = (2.0, 3.0, 4.5)


def attenuated(law: Any, distances: Sequence[float] = DISTANCES) -> ds.Scene:
    """A ball under a lamp at some distances."""
    lamps = [ds.PointLight(d * np.array((2, 2, 3)) / 17**0.5, attenuation=law) for d in distances]
    return synthetic.standard_scene(ds.Material(0.1, 0.5, 0.3, 20), lamps)


def fit_law(law: Any, told: Any, free: Sequence[str], distances: Sequence[float] = DISTANCES) -> ds.Fit:
    """The fit of a law, told another one, from a photograph at each distance."""
    images = synthetic.noisy(synthetic.photographs(attenuated(law, distances)), 0.002, 0)
    views = synthetic.one_light_each(images)
    return ds.fit(attenuated(told, distances), views, free=("k_a", "k_d", "k_s", "n_s", *free), tied=free)


@pytest.mark.thorough
def test_an_own_law_of_attenuation_is_searched_for_as_it_says():
    searched = fit_law(own_parts.PowerAttenuation(1.0, 0.6), own_parts.PowerAttenuation(1.0, 5.0), ("p",))
    assert abs(searched.values[-1] - 0.6) < 4 * searched.errors[-1] < 0.02


@pytest.mark.thorough
def test_what_photographs_cannot_tell_of_an_own_law_is_said():
    told = own_parts.PowerAttenuation(1.0, 1.3)
    scaled = fit_law(told, told, ("attenuation", "a"))
    assert dict(zip(scaled.names, scaled.determined, strict=True))["p"]
    assert not scaled.determined[scaled.names.index("a")]
    (note,) = scaled.notes
    assert "cannot separate k_d and k_s from a: scaling all of them together leaves" in note
    assert note.endswith("Fix one, for example a.")
    far = fit_law(own_parts.HazyAttenuation(1e-3), own_parts.HazyAttenuation(), ("rho",), (1e3,))
    assert not far.determined[far.names.index("rho")]
    assert "rho" in " ".join(far.notes)
    assert "Fix one, for example" in " ".join(far.notes)
    none = fit_law(own_parts.HazyAttenuation(0.0), own_parts.HazyAttenuation(), ("rho",))
    assert none.values[-1] < 1e-3


@pytest.mark.thorough
def test_they_are_fitted(fit):
    assert fit.names[-2:] == ("m", "rho")
    truth = np.array([*[0.1] * 3, *[0.5] * 3, *[0.2] * 3, 0.2, 0.3])
    assert fit.determined.all()
    assert not fit.notes
    assert np.abs((fit.values - truth) / fit.errors).max() < 4.0
    assert fit.errors[-2:].max() < 0.01


@pytest.mark.thorough
def test_a_power_lobe_of_ones_own_is_fitted():
    scene = synthetic.standard_scene(
        ds.Material(0.1, 0.5, 0.3, 15, lobe=own_parts.Wide()), synthetic.point_lights()[:3]
    )
    views = synthetic.one_light_each(synthetic.noisy(synthetic.photographs(scene), 0.002, 0))
    found = ds.fit(scene, views, free=("k_a", "k_d", "k_s", "n_s"))
    truth = np.array([*[0.1] * 3, *[0.5] * 3, *[0.3] * 3, 15.0])
    assert np.abs((found.values - truth) / found.plain_errors).max() < 4.5


def test_the_highlight_of_an_own_lamp_is_where_a_point_lights_is(fit):
    with jax.enable_x64(True):
        own = angle_to_highlight(fit.scene, fit.views[0])
        lights = (ds.PointLight((1, 2, 3)), *fit.scene.lights[1:])
        same = angle_to_highlight(eqx.tree_at(lambda s: s.lights, fit.scene, lights), fit.views[0])
    assert own.min() < 20
    np.testing.assert_allclose(own, same, atol=1e-6)


def test_the_page_draws_a_lobe_and_a_law_that_say_how_and_names_what_does_not(fit, tmp_path):
    ds.write_report(tmp_path / "fit.html", fit)
    page = (tmp_path / "fit.html").read_text(encoding="utf-8")
    assert "the light of lights.0" in page
    assert "the light of lights.0 and" not in page
    assert "the light of lights.0, lights" not in page
    assert "as <code>render</code> draws it" in page
    assert "the lobe MicroFacets" not in page
    assert "if (lobe == 2) return own_0(n, l, v, n_s);" in page
    assert f"float law_0(float d) {{\nreturn exp(-{fit.values[-1]:.9e} * d);\n}}" in page
    assert "if (law == 0) return law_0(d);" in page
    lamp, *lights = fit.scene.lights
    lights = [dataclasses.replace(light, attenuation=own_parts.PowerAttenuation()) for light in lights]
    scene = eqx.tree_at(lambda s: s.objects[0].material.lobe, fit.scene, own_parts.Wide())
    silent = with_problem(fit, scene=dataclasses.replace(scene, lights=(lamp, *lights)))
    missing = "; ".join(ball_scene(silent, ["a", "b", "c"], 1.0)[1])
    assert "the lobe Wide (shown as Phong" in missing
    assert "the light of lights.0, lights.1 and lights.2" in missing


@pytest.mark.parametrize(
    ("path", "lobe"),
    [
        ("wrap", own_parts.WrappedDiffuse()),  # of a scene that has the pattern and the light too
        ("radius", None),
        *(pytest.param(path, None, marks=pytest.mark.thorough) for path in ("k_d.turns", "rho", "lobe.m", "start")),
    ],
)
def test_they_render_and_differentiate(path, lobe):
    scene = own_scene(lobe, k_d=own_parts.Marble(0.8, 0.2))
    if path == "radius":
        scene = eqx.tree_at(lambda s: s.objects[0].surface, scene, own_parts.PlateDisc(0.9))

    if path == "rho":
        absorbed = own_parts.HazyAttenuation(0.4)
        lamps = (
            ds.PointLight((1, 2, 3), 2.0, absorbed),
            ds.AreaLight((-1, 2, 3), (1, 0, 0), (0, 1, 0), 1.0, samples=2),
        )
        scene = eqx.tree_at(lambda s: s.lights, scene, lamps)

    def where(s):
        item = s.objects[0]
        return {
            "lobe.m": lambda: item.material.lobe.m,
            "k_d.turns": lambda: item.material.k_d.turns,
            "start": lambda: s.lights[0].start,
            "rho": lambda: s.lights[0].attenuation.rho,
            "wrap": lambda: item.material.lobe.wrap,
            "radius": lambda: item.surface.radius,
        }[path]()

    with jax.enable_x64(True):
        value = jnp.asarray(where(scene))

        def total(x):
            return jnp.sum(ds.render(eqx.tree_at(where, scene, x), CAMERA) ** 2)

        step = 1e-6 * jnp.ones_like(value)
        slope = jax.grad(total)(value)
        assert np.isfinite(np.asarray(slope)).all()
        if path != "radius":  # the silhouette's jump has no derivative
            expected = (total(value + step) - total(value - step)) / 2e-6
            np.testing.assert_allclose(np.sum(np.asarray(slope)), float(expected), rtol=1e-5, atol=1e-7)
            forward = jax.jvp(total, (value,), (jnp.ones_like(value),))[1]
            np.testing.assert_allclose(np.sum(np.asarray(slope)), forward, rtol=1e-9)


@pytest.mark.thorough
def test_a_line_of_one_sample_is_its_middle_and_of_two_shares_its_intensity():
    one = own_scene(light=own_parts.TubeLight((-1, 2, 3), (2, 2, 3), 2.0, samples=1))
    same = own_scene(light=ds.PointLight((0.5, 2, 3), 2.0))
    np.testing.assert_allclose(ds.render(one, CAMERA), ds.render(same, CAMERA), rtol=2e-6, atol=1e-7)
    middle: Any = one.lights[0].bare()
    np.testing.assert_allclose(middle.position, (0.5, 2, 3))
    assert middle.intensity.tolist() == [1, 1, 1]
    two = own_scene(light=own_parts.TubeLight((-1, 2, 3), (3, 2, 3), 2.0, samples=2))
    same = own_scene(light=[ds.PointLight(at, 1.0) for at in ((0, 2, 3), (2, 2, 3))])
    np.testing.assert_allclose(ds.render(two, CAMERA), ds.render(same, CAMERA), rtol=2e-6, atol=1e-7)


@pytest.mark.thorough
def test_a_lamp_by_its_path_alone_is_fitted_as_it_is_rendered():
    scene = own_scene(ds.Phong(), (own_parts.Lantern((1, 3, 3), 2.0), own_parts.Lantern((-2, 1, 4), 2.0)))
    views = [ds.View(synthetic.photograph(scene, CAMERA, (i,)), CAMERA, lit=i) for i in (0, 1)]
    found = ds.fit(scene, views, free=("k_a", "k_d", "k_s", "n_s"))
    truth = np.array([*[0.1] * 3, *[0.5] * 3, *[0.2] * 3, 20.0])
    np.testing.assert_allclose(found.values, truth, rtol=1e-6)


def test_a_scene_file_holds_them(tmp_path):
    lights = (*own_scene().lights, ds.PointLight((1, 2, 3), attenuation=own_parts.HazyAttenuation(0.25)))
    scene = own_scene(light=lights, k_d=own_parts.Marble((0.8, 0.7, 0.6), 0.2, 3.0))
    ds.write_scene(tmp_path / "own.toml", scene, camera=CAMERA)
    again = ds.read_scene(tmp_path / "own.toml")
    assert eqx.tree_equal(again, scene)
    text = (tmp_path / "own.toml").read_text(encoding="utf-8")
    assert 'type = "MicroFacets"' in text
    assert 'type = "HazyAttenuation"\nrho = 0.25' in text
    (tmp_path / "other.toml").write_text(text.replace("MicroFacets", "WardOfMine"), encoding="utf-8")
    with pytest.raises(ValueError, match=r"WardOfMine.*imported first"):
        ds.read_scene(tmp_path / "other.toml")


def test_what_cannot_take_them_says_so(tmp_path):
    scene = own_scene()
    views = [ds.View(np.ones((24, 24, 3)), CAMERA, lit=0)] * 2
    with pytest.raises(ValueError, match=r"MicroFacets.*AbstractPowerLobe"):
        ds.fit_texels(scene, views)
    with pytest.raises(ValueError, match=r"Marble"):
        ds.exchange.write_material(tmp_path / "m.mtl", ds.Material(k_d=own_parts.Marble(1, 0)))
    with pytest.raises(ValueError, match=r"TubeLight"):
        ds.exchange.write_material(tmp_path / "m.c", ds.Material(), lights=own_parts.TubeLight((0, 0, 1), (1, 0, 1)))
    with pytest.raises(TypeError, match=r"AbstractPowerLobe|PowerLobe"):
        ds.exchange.with_lobe(ds.Material(k_s=0.2), own_parts.MicroFacets())  # pyright: ignore[reportArgumentType]
    exported = ds.exchange.write_material(tmp_path / "m.mtl", scene.objects[0].material)
    assert "MicroFacets" in " ".join(exported.notes)
    assert exported.rms > 0
    with pytest.raises(ValueError, match=r"m must be between 0.02 and 2"):
        own_parts.MicroFacets(3.0)


def test_what_is_not_of_the_right_form_is_named():
    class Stacked(AbstractLobe):
        def highlight(self, n_s, n, l, v):
            return jnp.stack([dot(n, l)] * 3, -1)

    class StackedPower(AbstractPowerLobe):
        def cosine(self, n, l, v):
            return jnp.stack([dot(n, l)] * 3, -1)

    class Coloured(AbstractPattern):
        def __call__(self, p):
            stacked: Any = jnp.stack([p.x, p.y, p.z], -1)
            return stacked

    class Nameless(AbstractEmitter):
        power: Colour = colour(1.0)

        @property
        def is_local(self):
            return False

        def path(self, p):
            return Path(Vec3.of(np.array((0.0, 0.0, 1.0))), None, None)

        def arriving(self, p):
            return Vec3.of(np.array((0.0, 0.0, 1.0))), Vec3.of(self.power)

    for lobe, name in ((Stacked(), "Stacked.highlight"), (StackedPower(), "StackedPower.cosine")):
        with pytest.raises(TypeError, match=rf"{name}.*\(24, 24, 3\).*without a last axis"):
            ds.render(own_scene(lobe), CAMERA)
    with pytest.raises(TypeError, match=r"Coloured must return a Vec3"):
        ds.render(own_scene(k_d=Coloured()), CAMERA)
    with pytest.raises(TypeError, match=r"lights\[0\].*intensity.*Nameless"):
        own_scene(light=Nameless())
    with pytest.raises(ValueError, match=r"lower must be below upper; got 2 and 1"):
        number(1.5, lower=2, upper=1)


@pytest.mark.thorough
def test_the_command_line_imports_them_where_it_is_told_to(tmp_path):
    source = FilePath(own_parts.__file__).read_text(encoding="utf-8").replace("MicroFacets", "Cook")
    (tmp_path / "parts_of_mine.py").write_text(source, encoding="utf-8")
    ds.write_scene(tmp_path / "own.toml", own_scene(), camera=CAMERA)
    text = (tmp_path / "own.toml").read_text(encoding="utf-8").replace("MicroFacets", "Cook")
    (tmp_path / "own.toml").write_text(text, encoding="utf-8")
    command = [sys.executable, "-m", "diffshade"]
    asked = [*command, "--import", "parts_of_mine", "render", "own.toml", "-o", "own.png"]
    subprocess.run(asked, cwd=tmp_path, check=True)
    assert (tmp_path / "own.png").is_file()
    found = subprocess.run([*command, "render", "own.toml"], cwd=tmp_path, check=False, capture_output=True, text=True)
    assert found.returncode == 1
    assert "imported first" in found.stderr


@pytest.mark.thorough
def test_a_number_may_have_the_name_of_one_of_the_librarys():
    class HighLamp(AbstractLamp):
        position: Vector = vector(role="position")
        intensity: Colour = colour(1.0)
        attenuation: RadialAttenuation = eqx.field(default_factory=RadialAttenuation)
        linear: Scalar = number(0.2, lower=0)

        def path(self, p):
            assert p is not None
            to_light = Vec3.of(self.position) - p
            return Path(normalize(to_light), length(to_light), jnp.exp(-self.linear * p.y))

    truth = own_scene(ds.Phong(), (HighLamp((1, 2, 3), linear=0.5), HighLamp((-2, 1, 3), linear=0.3)))
    views = [ds.View(synthetic.photograph(truth, CAMERA, (i,)), CAMERA, lit=i) for i in (0, 1)]
    told = eqx.tree_at(lambda s: [light.linear for light in s.lights], truth, [np.asarray(0.2)] * 2)
    found = ds.fit(told, views, free=("k_d", "lights.0.linear", "lights.1.linear", "lights.0.intensity"))
    known = dict(zip(found.names, found.values, strict=True))
    np.testing.assert_allclose([known["lights.0.linear"], known["lights.1.linear"]], (0.5, 0.3), rtol=1e-5)
    np.testing.assert_allclose(known["lights.0.intensity.r"] * known["k_d.r"], 0.5, rtol=1e-5)
