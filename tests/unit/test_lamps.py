"""Lamps: files of measured photometry, the light they make, and the simple models that stand for them."""

import dataclasses
import re

import equinox as eqx
import jax
import numpy as np
import pytest
from lamp_files import LAMP, TABLE, VERTICAL, beam, ies, ldt, towards
from measured import measured

import diffshade as ds
from diffshade.model.scenes import stack_scene
from diffshade.model.vectors import Vec3

# the time goes into compiling, not into running
QUICK = {"xla_backend_optimization_level": 0, "xla_disable_hlo_passes": "fusion"}


def write(folder, name, text):
    (folder / name).write_bytes(text.encode())
    return folder / name


def looked_up(light, points):
    return np.asarray(jax.jit(lambda light, p: light.path(Vec3.of(p)).f_ang)(light, points))


@pytest.mark.thorough
def test_a_profile_is_linear_between_its_angles():
    light = ds.lamps.MeasuredLight((0, 0, 0), (0, -1, 0), TABLE)
    gamma, C = np.meshgrid(np.linspace(0.0, 129.9, 77), np.linspace(0.1, 359.9, 61))
    expected = [
        np.interp(g, TABLE.vertical, [np.interp(c, TABLE.horizontal, column) for column in TABLE.values.T])
        for g, c in zip(gamma.ravel(), C.ravel(), strict=True)
    ]
    beyond, at_the_lamp = towards([131.0, 170.0, 180.0], 20.0), np.zeros((1, 3))
    found = looked_up(light, np.concatenate([3 * towards(gamma, C).reshape(-1, 3), beyond, at_the_lamp]))
    np.testing.assert_allclose(found[:-4], expected, atol=1e-12)
    np.testing.assert_array_equal(found[-4:], [0, 0, 0, 1])  # dark beyond the table; the lamp itself is finite
    two = ds.lamps.Profile([0, 90], [0, 180, 360], [[1.0, 0], [0.5, 0], [1.0, 0]])  # planes that meet at another value
    light = ds.lamps.MeasuredLight((0, 0, 0), (0, -1, 0), two)
    np.testing.assert_allclose(looked_up(light, towards(1e-6, [0.0, 90, 180, 270])), 0.75, rtol=1e-7)
    straight = ds.lamps.MeasuredLight((0, 0, 0), (0, -1, 0), ds.lamps.Profile([0, 90, 180], [0], [[1.0, 0.5, 0.0]]))
    np.testing.assert_allclose(looked_up(straight, np.array([[2.0, 0, 0]])), 0.5, rtol=1e-12)  # 90 degrees exactly


def test_what_arrives():
    light = dataclasses.replace(LAMP, position=(0, 0, 0), direction=(0, -1, 0), side=(1, 0, 0))
    p = 2 * towards([20.0], [0.0])
    l, intensity = jax.jit(lambda light, p: light.arriving(Vec3.of(p)))(light, p)
    np.testing.assert_allclose(l.stack(), -p / 2, rtol=1e-12)
    np.testing.assert_allclose(intensity.stack(), [np.array([4, 2, 1]) * 0.9 / (0.2 + 0.2 + 4)], rtol=1e-12)
    assert light.is_local


@pytest.mark.thorough
def test_derivatives_are_those_of_finite_differences_and_finite_at_the_poles_the_kinks_and_the_lamp():
    special = np.array([*(towards(g, C) for g in (0.0, 1e-9, 20, 90, 130, 180) for C in (0.0, 45, 180)), (0.0, 0, 0)])
    anywhere = np.array([[0.5, -0.1, 0.9], [-0.4, -0.3, 0.2], [1.4, 1.2, -1.5]])
    at = (np.zeros(3), np.array([0.0, -1, 0]), np.array([1.0, 0, 0]))

    def arriving(position, direction, side, p):
        return dataclasses.replace(LAMP, position=position, direction=direction, side=side).arriving(Vec3.of(p))[1].x

    def both(position, direction, side, p):
        return arriving(position, direction, side, p), jax.jacfwd(arriving, (0, 1, 2, 3))(position, direction, side, p)

    program = jax.jit(jax.vmap(both, (None, None, None, 0)), compiler_options=QUICK)
    slopes = program(*at, np.concatenate([anywhere, special]))[1]
    assert all(np.isfinite(slope).all() for slope in slopes)
    assert all(np.abs(slope).max() < 1e3 for slope in slopes[:3])
    everywhere = np.concatenate([anywhere, special])
    for k in range(3):
        for step in 1e-6 * np.eye(3):
            moved = [[x + sign * step * (i == k) for i, x in enumerate(at)] for sign in (1, -1)]
            ahead, behind = (program(*to, everywhere)[0] for to in moved)
            np.testing.assert_allclose(slopes[k][:3] @ step, (ahead - behind)[:3] / 2, atol=1e-12)


def test_lamps_of_one_table_are_stacked_and_of_two_are_not():
    narrow = dataclasses.replace(LAMP, profile=ds.lamps.Profile([0, 40], [0], [[1, 0]]))
    lamps = [LAMP, dataclasses.replace(LAMP, position=(1, 2, 0)), narrow]
    assert len(stack_scene(ds.Scene(ds.Object(ds.Sphere()), lamps)).lights) == 2


def test_a_scene_file_keeps_a_lamp(tmp_path):
    scene = ds.Scene(ds.Object(ds.Sphere(), ds.Material(k_d=0.7)), LAMP)
    ds.write_scene(tmp_path / "a.toml", scene)
    same = jax.tree.map(np.array_equal, ds.read_scene(tmp_path / "a.toml"), scene)
    assert all(jax.tree.leaves(same))


@pytest.mark.thorough
def test_a_material_is_fitted_under_a_lamp():
    """By the fast form of a fit, which knows the lamp's beam as a field."""
    camera = ds.Camera((0, 0, 4), fov=32, shape=(24, 24))
    lamp = dataclasses.replace(LAMP, position=(1, 2, 2), direction=(-1, -2, -2))
    truth = ds.Scene(ds.Object(ds.Sphere(), ds.Material(0.1, (0.6, 0.4, 0.25), 0.5, 20)), lamp)
    view = ds.View(np.asarray(ds.render(truth, camera)), camera)
    fit = ds.fit(ds.Scene(ds.Object(ds.Sphere()), lamp), view, free=("k_a", "k_d", "k_s", "n_s"))
    np.testing.assert_allclose(fit.material.k_d, (0.6, 0.4, 0.25), rtol=1e-4)
    np.testing.assert_allclose([float(fit.material.n_s), *fit.material.k_s], [20, 0.5, 0.5, 0.5], rtol=1e-3)


ROW = beam(0, VERTICAL)[None]
CIRCLE = np.arange(0, 360, 22.5)
IES_SYMMETRIES = {
    "none": (np.arange(0, 361, 22.5), ()),
    "halves": (np.arange(0, 181, 22.5), (0,)),
    "halves about 90": (np.arange(90, 271, 22.5), (90,)),
    "quarters": (np.arange(0, 91, 22.5), (0, 90)),
}
LDT_SYMMETRIES = {
    0: (CIRCLE, ()),
    2: (np.arange(0, 181, 22.5), (0,)),
    3: (np.r_[np.arange(270, 360, 22.5), np.arange(0, 91, 22.5)], (90,)),
    4: (np.arange(0, 91, 22.5), (0, 90)),
}


def check_table(lamp, about):
    expected = beam(np.append(CIRCLE, 360)[:, None], VERTICAL, about=about)
    np.testing.assert_allclose(lamp.profile.horizontal, np.append(CIRCLE, 360))
    np.testing.assert_allclose(lamp.profile.vertical, VERTICAL)
    np.testing.assert_allclose(lamp.profile.values * lamp.intensity[0], expected, rtol=1e-9, atol=1e-7)


@pytest.mark.parametrize("kind", IES_SYMMETRIES)
def test_symmetries_of_ies(tmp_path, kind):
    horizontal, about = IES_SYMMETRIES[kind]
    text = ies(horizontal, beam(horizontal[:, None], VERTICAL, about=about) / 2, scale=2)
    check_table(ds.lamps.read_lamp(write(tmp_path, "a.ies", text)), about)


@pytest.mark.parametrize("symmetry", LDT_SYMMETRIES)
def test_symmetries_of_eulumdat(tmp_path, symmetry):
    stored, about = LDT_SYMMETRIES[symmetry]
    text = ldt(symmetry, 16, beam(stored[:, None], VERTICAL, about=about) / 4, flux=2000, factor=2)
    check_table(ds.lamps.read_lamp(write(tmp_path, "a.ldt", text)), about)


def test_a_lamp_that_is_the_same_all_around(tmp_path):
    row = beam(0, VERTICAL)[None]
    for name, text in (
        ("a.ies", ies([0], row)),
        ("a.ldt", ldt(1, 24, row)),
        ("b.LDT", ldt(1, 1, row).replace(".", ",")),
    ):
        lamp = ds.lamps.read_lamp(write(tmp_path, name, text), position=(0, 3, 0), direction=(0, 0, -1))
        assert lamp.profile.values.shape == (1, 6)
        np.testing.assert_allclose(lamp.profile.values * lamp.intensity[0], row, rtol=1e-9, atol=1e-9)
        np.testing.assert_array_equal([lamp.position, lamp.direction], [(0, 3, 0), (0, 0, -1)])
        assert eqx.tree_equal(lamp.attenuation, ds.RadialAttenuation(0.0, 0.0, 1.0))


def test_planes_that_leave_out_0_are_closed_between_their_neighbours(tmp_path):
    horizontal = np.array([90.0, 170, 270])  # about 90 the planes are 10, 90, 170 and 270
    lamp = ds.lamps.read_lamp(write(tmp_path, "a.ies", ies(horizontal, np.outer([1, 2, 4], ROW))))
    np.testing.assert_array_equal(lamp.profile.horizontal, [0, 10, 90, 170, 270, 360])
    relative = np.array([0.9 * 2 + 0.1 * 4, 2, 1, 2, 4, 0.9 * 2 + 0.1 * 4]) / 4
    np.testing.assert_allclose(lamp.profile.values, np.outer(relative, ROW / ROW.max()))


IES, LDT, PLANES = ies([0], ROW), ldt(1, 1, ROW), "\r\n1\r\n360"
BAD = [
    ("a.ies", "IESNA\n1 2 3", "is not an IES file: it has no line TILT=. Give"),
    ("a.ies", IES[:-20], "must have 26 numbers after TILT, for 6 vertical and 1 horizontal angles; got 2"),
    ("a.ies", "TILT=NONE\n1 2 3", "ends after TILT at '1 2 3'. Give the whole"),
    ("a.ies", ies([0], ROW, kind=2), "type B must have two vertical and two horizontal angles or more."),
    ("a.ies", ies([0], ROW, kind=4), "must be of photometric type 1 (C), 2 (B) or 3 (A); got 4."),
    ("a.ies", ies([10, 90], [ROW[0]] * 2, kind=3), "angles of type A must rise from 0 or less"),
    ("a.ies", ies([0], ROW, tilt="TILT=INCLUDE\n1\n3\n0 90 45\n1 0.9 0.8"), "3 tilt angles must increase"),
    (
        "a.ies",
        IES.replace("45", "4_5"),
        "an angle or a candela value must be a finite number; got '4_5'. Correct the file.",
    ),
    ("a.ies", IES.replace("45", "1e999"), "must be a finite number; got '1e999'"),
    ("a.ies", ies([0, 100], [ROW[0], ROW[0]]), "horizontal angles must go from 0 to 0, 90, 180 or 360 degrees"),
    ("a.ies", ies([0, 0, 90], [ROW[0]] * 3), "the horizontal angles must differ and be at most 360 degrees"),
    ("a.ies", ies([0], ROW, VERTICAL[::-1]), "Profile.vertical must be angles that increase"),
    ("a.ies", ies([0], 0 * ROW), "the intensities must be finite, at least 0 and not all 0."),
    ("a.ies", ies([0], -ROW), "the intensities must be finite, at least 0 and not all 0."),
    ("a.ies", "TILT=NONE\n1 1 1 1e9 1e9 1 1 0 0 0 1 1 1", "must have 1000000002000000013 numbers"),
    ("a.ies", "TILT=NONE\0", "it holds zero bytes"),
    ("a.ldt", "maker\n2\n1\n", "ends before line 4, Mc. Give the whole"),
    ("a.ldt", LDT.replace("\r\n1\r\n1\r\nLED", "\r\n1e15\r\n1\r\nLED"), "ends before line 6000"),
    ("a.ldt", LDT[: LDT[:-2].rindex("\r\n")], "the last intensity. Give the whole"),
    ("a.ldt", LDT + "3\n", "goes on after its 6 intensities."),
    ("a.ldt", ldt(5, 4, ROW), "line 3, the symmetry, must be 0 to 4 and its planes"),
    ("a.ldt", ldt(4, 6, ROW), "its planes must divide the circle; got 4 with 6 planes"),
    ("a.ldt", ldt(2, 5, ROW), "its planes must divide the circle; got 2 with 5 planes"),
    ("a.ldt", LDT.replace(PLANES, "\r\n1.5\r\n360"), "line 4, Mc, must be a whole number of at least 1; got '1.5'"),
    ("a.ldt", LDT.replace(PLANES, "\r\n0\r\n360"), "line 4, Mc, must be a whole number of at least 1; got '0'"),
    ("a.txt", "", "a lamp file must end in .ies or .ldt; got '.txt'."),
]


@pytest.mark.parametrize(("file", "text", "message"), BAD)
def test_a_bad_file_is_refused_in_one_sentence(tmp_path, file, text, message):
    with pytest.raises(ValueError, match=re.escape(message)) as caught:
        ds.lamps.read_lamp(write(tmp_path, file, text))
    assert "\n" not in str(caught.value)


def test_a_missing_or_huge_file_is_refused(tmp_path, monkeypatch):
    with pytest.raises(FileNotFoundError, match="there is no lamp file"):
        ds.lamps.read_lamp(tmp_path / "none.ies")
    monkeypatch.setattr("diffshade.io.parsing.LARGEST", len(IES))
    assert ds.lamps.read_lamp(write(tmp_path, "a.ies", IES)).profile.values.shape == (1, 6)
    monkeypatch.setattr("diffshade.io.parsing.LARGEST", len(IES) - 1)
    with pytest.raises(ValueError, match=rf"too many for a lamp file\. Give one of at most {len(IES) - 1}\."):
        ds.lamps.read_lamp(tmp_path / "a.ies")


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: ds.lamps.Profile([0, 0], [0], [[1, 0]]), "Profile.vertical must be angles that increase"),
        (lambda: ds.lamps.Profile([0, 181], [0], [[1, 0]]), "Profile.vertical must be angles that increase"),
        (lambda: ds.lamps.Profile([-1, 90], [0], [[1, 0]]), "Profile.vertical must be angles that increase"),
        (lambda: ds.lamps.Profile([0], [0], [[1]]), "Profile.vertical must hold two angles or more"),
        (
            lambda: ds.lamps.Profile([0, 90], [0, 180], [[1, 0], [1, 0]]),
            "Profile.horizontal must go from 0 to 360 degrees",
        ),
        (
            lambda: ds.lamps.Profile([0, 90], [0], [[1, -1]]),
            "Profile.values must be finite numbers of at least 0, 1 x 2",
        ),
        (lambda: ds.lamps.Profile([0, 90], [0], [[1, 1, 1]]), "got shape (1, 3)."),
        (lambda: dataclasses.replace(LAMP, side=(0.2, -2, 0.4)), "MeasuredLight.side must not be along direction"),
        (lambda: dataclasses.replace(LAMP, direction=(0, 0, 0)), "MeasuredLight.direction must not be the zero vector"),
    ],
)
def test_a_profile_or_lamp_that_is_none(make, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        make()


def test_angles_may_be_as_close_as_one_likes():
    assert ds.lamps.Profile([0, 0.25, 0.5], [0], [[1, 0.9, 0.8]]).vertical[1] == 0.25


def test_a_spot_is_found_again_with_its_cutoff():
    vertical = np.arange(0, 91.0)
    values = np.where(vertical <= 30, np.cos(np.deg2rad(vertical)) ** 3, 0)
    found = ds.lamps.as_spot(
        ds.lamps.MeasuredLight((1, 2, 3), (0, 0, -1), ds.lamps.Profile(vertical, [0], [values]), (3, 2, 1))
    )
    assert found.rms < 1e-6
    assert float(found.light.cutoff) == 30
    np.testing.assert_allclose(found.light.exponent, 3, rtol=1e-4)
    np.testing.assert_allclose(found.light.intensity, [3, 2, 1], rtol=1e-6)
    np.testing.assert_array_equal(found.light.position, [1, 2, 3])


def test_a_lamp_that_is_no_spot_is_said_to_be_none():
    wing = ds.lamps.Profile([0, 30, 60, 90], [0], [[0.3, 0.6, 1, 0]])  # a street light, brightest to its sides
    found = ds.lamps.as_spot(ds.lamps.MeasuredLight((0, 0, 0), (0, -1, 0), wing))
    assert not found.fits
    assert str(found).startswith("no spot light fits this lamp; the nearest is cos^")


def test_the_falloff_of_a_real_lamp():
    table = np.loadtxt(measured("lamps") / "heig_falloff.csv", delimiter=",", skiprows=1)
    found = ds.lamps.fit_falloff(table[:, 0], table[:, 1])
    assert abs(found.slope + 1.93) < 0.005
    assert found.undetermined == ("constant", "linear")
    assert found.rms < 0.02
    assert "seven points do not separate constant and linear" in str(found)
    assert ["quadratic", "0.0386", "0.0040"] in [line.split() for line in str(found).splitlines()]


def test_a_falloff_is_found_again_and_its_errors_hold():
    d = np.geomspace(0.1, 10, 12)
    true = np.array([0.5, 0.3, 0.2])
    rng = np.random.default_rng(0)
    lux = 1 / (true @ np.stack([d**0, d, d * d]))
    exact = ds.lamps.fit_falloff(d, lux)
    np.testing.assert_allclose([float(x) for x in jax.tree.leaves(exact.attenuation)], true, rtol=1e-9)
    scatter = []
    for _ in range(300):
        found = ds.lamps.fit_falloff(d, lux * (1 + 0.01 * rng.standard_normal(12)))
        scatter.append((np.array([float(x) for x in jax.tree.leaves(found.attenuation)]) - true) / found.errors)
        assert found.undetermined == ()
    assert (np.abs(np.std(scatter, 0) - np.sqrt(9 / 7)) < 0.15).all()  # Student's t of 12 - 3


@pytest.mark.parametrize("rows", [([1, 2, 3], [3, 2, 1]), ([1, 1, 2, 2], [3, 3, 2, 2]), ([1, 2, 3, -4], [4, 3, 2, 1])])
def test_a_table_that_is_none(rows):
    with pytest.raises(ValueError, match=r"at least four rows|must be a list of finite numbers above 0"):
        ds.lamps.fit_falloff(*rows)
