"""The 24 materials of the OpenGL teapots, by name."""

from re import escape

import numpy as np
import pytest

import diffshade as ds


def test_there_are_24():
    names = ds.material_names()
    assert len(names) == len(set(names)) == 24
    assert {"emerald", "jade", "pearl", "gold", "cyan_plastic", "yellow_rubber"} <= set(names)
    for name in names:
        material = ds.material(name)
        assert isinstance(material.lobe, ds.Blinn)
        assert 10 <= material.n_s <= 76.8
        assert material.k_t is None


@pytest.mark.parametrize(
    ("name", "k_a", "k_d", "k_s", "n_s"),
    [  # from teapots.c of the OpenGL Programming Guide; n_s is 128 times 0.6, 0.4, 0.25 and 0.078125
        ("emerald", (0.0215, 0.1745, 0.0215), (0.07568, 0.61424, 0.07568), (0.633, 0.727811, 0.633), 76.8),
        ("gold", (0.24725, 0.1995, 0.0745), (0.75164, 0.60648, 0.22648), (0.628281, 0.555802, 0.366065), 51.2),
        ("red_plastic", (0, 0, 0), (0.5, 0, 0), (0.7, 0.6, 0.6), 32),
        ("black_rubber", (0.02, 0.02, 0.02), (0.01, 0.01, 0.01), (0.4, 0.4, 0.4), 10),
    ],
)
def test_a_material_by_name(name, k_a, k_d, k_s, n_s):
    material = ds.material(name)
    for found, expected in zip((material.k_a, material.k_d, material.k_s), (k_a, k_d, k_s), strict=True):
        np.testing.assert_array_equal(found, expected)
    np.testing.assert_allclose(material.n_s, n_s, rtol=1e-12)


@pytest.mark.parametrize(("name", "meant"), [("emrald", "emerald"), ("Gold", "gold"), ("black rubber", "black_rubber")])
def test_a_wrong_name_is_met_with_the_right_one(name, meant):
    message = f"no material is named '{name}'. Did you mean '{meant}'?"
    with pytest.raises(ValueError, match=f"^{escape(message)}$"):
        ds.material(name)


def test_a_name_like_none_is_met_with_all():
    with pytest.raises(
        ValueError, match=r"^no material is named 'xyz'\. Known names: black_plastic, .*, yellow_rubber\.$"
    ):
        ds.material("xyz")
