"""Lights and lobes of one's own: fitted, examined and reported as those of the library are."""

import equinox as eqx
import jax
import numpy as np
import pytest
import synthetic

import diffshade as ds
from diffshade.core.fields import Colour, Vector, as_colour, as_vector
from diffshade.inverse.verdicts.stability import angle_to_highlight
from diffshade.model.lights import AbstractEmitter, Path
from diffshade.model.materials import AbstractLobe
from diffshade.model.vectors import Vec3, dot, length, normalize, reflect


class Lamp(AbstractEmitter):
    """A lamp that fades with 1/d."""

    position: Vector = eqx.field(converter=as_vector)
    intensity: Colour = eqx.field(converter=as_colour, default=1.0)

    @property
    def is_local(self):
        return True

    def path(self, p: Vec3 | None) -> Path:
        assert p is not None
        to_light = Vec3.of(self.position) - p
        return Path(normalize(to_light), length(to_light), None)

    def arriving(self, p):
        l, d, _ = self.path(p)
        assert d is not None
        return l, Vec3.of(self.intensity) * (1.0 / d)


class Wide(AbstractLobe):
    """A highlight that reaches round to the dark side of r."""

    def cosine(self, n, l, v):
        return 0.5 + 0.5 * dot(v, reflect(l, n))


@pytest.fixture(scope="module")
def fit():
    """A material of an own lobe under an own lamp and two others, in three photographs."""
    lights = (Lamp((1, 2, 3)), *synthetic.point_lights()[:2])
    material = ds.Material(0.1, 0.5, 0.3, 15, lobe=Wide())
    scene = synthetic.standard_scene(material, lights)
    views = synthetic.one_light_each(synthetic.noisy(synthetic.photographs(scene), 0.002, 0))
    return ds.fit(scene, views, free=("k_a", "k_d", "k_s", "n_s"))


def test_they_are_fitted(fit):
    truth = np.array([*[0.1] * 3, *[0.5] * 3, *[0.3] * 3, 15.0])
    assert np.abs((fit.values - truth) / fit.plain_errors).max() < 4.5


def test_the_highlight_of_an_own_lamp_is_where_a_point_lights_is(fit):
    with jax.enable_x64(True):
        own = angle_to_highlight(fit.scene, fit.views[0])
        lights = (ds.PointLight((1, 2, 3)), *fit.scene.lights[1:])
        same = angle_to_highlight(eqx.tree_at(lambda s: s.lights, fit.scene, lights), fit.views[0])
    assert own.min() < 20
    np.testing.assert_allclose(own, same, atol=1e-6)


def test_the_page_says_what_its_ball_shows_instead(fit, tmp_path):
    ds.write_report(tmp_path / "fit.html", fit)
    page = (tmp_path / "fit.html").read_text(encoding="utf-8")
    assert "the lobe Wide (shown as Phong" in page
    assert "the light of lights.0" in page
