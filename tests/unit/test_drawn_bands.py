"""Which bands of a scene pictures draw as red, green and blue."""

from __future__ import annotations

import numpy as np
import pytest

import diffshade as ds
from diffshade.report.drawn_bands import drawn_bands

EVERY_TEN = tuple(f"{nm}nm" for nm in range(400, 701, 10))


@pytest.mark.parametrize(
    ("bands", "channels", "says"),
    [
        ((), (0, 1, 2), ""),
        (("850nm",), (0, 0, 0), "the band 850nm in grey"),
        (("450nm", "850nm"), (1, 0, 0), "both bands, 850nm as red, 450nm as green and blue: false colours"),
        (EVERY_TEN, (21, 15, 6), "3 of the 31 bands, 610nm as red, 550nm as green, 460nm as blue: near the colours"),
        (("450nm", "550nm", "620nm"), (2, 1, 0), "the three bands, 620nm as red"),
        (
            tuple(f"{nm}nm" for nm in range(700, 1001, 50)),
            (5, 3, 1),
            "950nm as red, 850nm as green, 750nm as blue: fal",
        ),
        (("blue", "green", "nir", "red"), (3, 1, 0), "red as red, green as green, blue as blue: as their names say"),
        (("u", "v", "w"), (0, 1, 2), "u as red, v as green, w as blue: false colours"),
    ],
)
def test_the_bands_that_are_drawn(bands, channels, says):
    drawn = drawn_bands(bands)
    assert drawn.channels == channels
    assert says in drawn.words


def test_what_is_drawn_of_a_scene_renders_as_its_bands_do():
    nm = np.arange(400, 701, 10)
    spectrum = 0.1 + 0.5 * np.exp(-(((nm - 620) / 60.0) ** 2))
    scene = ds.Scene(
        ds.Object(ds.Sphere(), ds.Material(0.1, spectrum, 0.3, 20 * (1 + spectrum))),
        ds.PointLight((2, 3, 4), 1 + spectrum, ambient=0.1 * spectrum),
        background=spectrum,
        atmosphere=ds.Fog(0.05, I_dc=spectrum),
        bands=nm,
    )
    camera = ds.Camera(eye=(0, 0, 4), fov=40, shape=(8, 9))
    drawn = drawn_bands(scene.bands)
    whole, shown = (np.asarray(ds.render(of, camera)) for of in (scene, drawn.scene(scene)))
    assert drawn.scene(scene).bands == ()
    np.testing.assert_allclose(shown, drawn.of(whole), atol=1e-12)
