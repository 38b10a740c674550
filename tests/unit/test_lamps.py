"""Lamps: files of measured photometry, the light they make, and the simple models that stand for them."""

import dataclasses
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_jvp, check_vjp
from lamp_files import VERTICAL, beam, ies, ldt
from measured import measured

import diffshade as ds
from diffshade.scenes import stack_scene
from diffshade.vectors import Vec3

# the time goes into compiling, not into running
QUICK = {"xla_backend_optimization_level": 0, "xla_disable_hlo_passes": "fusion"}
TABLE = ds.Profile(
    [0, 20, 50, 90, 130],
    [0, 45, 180, 360],
    [[1, 0.9, 0.5, 0.2, 0], [1, 0.7, 0.6, 0.1, 0], [1, 0.8, 0.2, 0.1, 0], [1, 0.9, 0.5, 0.2, 0]],
)
LAMP = ds.MeasuredLight((0.3, 2, 0.4), (0.1, -1, 0.2), TABLE, (4, 2, 1), ds.RadialAttenuation(0.2, 0.1, 1), (1, 0.2, 0))


def write(folder, name, text):
    (folder / name).write_bytes(text.encode())
    return folder / name


def looked_up(light, points):
    return np.asarray(jax.jit(lambda light, p: light.path(Vec3.of(p)).f_ang)(light, points))


def towards(gamma, C):
    """Points below a lamp at the origin that shines down, C = 0 to +x: C grows as seen from above, from +x to -z."""
    gamma, C = np.broadcast_arrays(np.deg2rad(gamma), np.deg2rad(C))
    return np.stack([np.sin(gamma) * np.cos(C), -np.cos(gamma), -np.sin(gamma) * np.sin(C)], -1)


def test_a_profile_is_linear_between_its_angles():
    light = ds.MeasuredLight((0, 0, 0), (0, -1, 0), TABLE)
    gamma, C = np.meshgrid(np.linspace(0.0, 129.9, 77), np.linspace(0.1, 359.9, 61))
    expected = [
        np.interp(g, TABLE.vertical, [np.interp(c, TABLE.horizontal, column) for column in TABLE.values.T])
        for g, c in zip(gamma.ravel(), C.ravel(), strict=True)
    ]
    np.testing.assert_allclose(looked_up(light, 3 * towards(gamma, C)).ravel(), expected, atol=1e-12)
    np.testing.assert_array_equal(looked_up(light, towards([131.0, 170.0, 180.0], 20.0)), 0)  # beyond the table
    np.testing.assert_array_equal(looked_up(light, np.zeros((1, 3))), 1)  # at the lamp: finite, and it has no distance


def test_where_the_planes_of_a_table_meet_there_is_one_value():
    table = ds.Profile([0, 90], [0, 180, 360], [[1.0, 0], [0.5, 0], [1.0, 0]])
    light = ds.MeasuredLight((0, 0, 0), (0, -1, 0), table)
    np.testing.assert_allclose(looked_up(light, towards(1e-6, [0.0, 90, 180, 270])), 0.75, rtol=1e-7)


def test_what_arrives():
    light = dataclasses.replace(LAMP, position=(0, 0, 0), direction=(0, -1, 0), side=(1, 0, 0))
    p = 2 * towards([20.0], [0.0])
    l, intensity = jax.jit(lambda light, p: light.arriving(Vec3.of(p)))(light, p)
    np.testing.assert_allclose(l.stack(), -p / 2, rtol=1e-12)
    np.testing.assert_allclose(intensity.stack(), [np.array([4, 2, 1]) * 0.9 / (0.2 + 0.2 + 4)], rtol=1e-12)


def test_derivatives_are_those_of_finite_differences():
    points = np.array([[0.5, 0.1, 0.9], [-0.4, 0.3, 0.2], [1.4, 1.2, -0.5]])

    def total(position, direction, side, intensity):
        light = dataclasses.replace(LAMP, position=position, direction=direction, side=side, intensity=intensity)
        _, arriving = light.arriving(Vec3.of(points))
        return arriving.stack()

    at = tuple(jnp.asarray(x) for x in (LAMP.position, LAMP.direction, LAMP.side, LAMP.intensity))
    program = jax.jit(total)
    forward = jax.jit(lambda p, t: jax.jvp(total, p, t), compiler_options=QUICK)
    check_jvp(program, forward, at, atol=1e-6, rtol=1e-6)
    check_vjp(program, lambda *p: jax.vjp(program, *p), at, atol=1e-6, rtol=1e-6)


@pytest.mark.parametrize("single", [False, True])
def test_derivatives_are_finite_at_the_poles_the_kinks_and_the_lamp(single):
    table = ds.Profile([0, 20, 90, 180], [0], [[1, 0.9, 0.2, 0.3]]) if single else TABLE
    special = [towards(g, C) for g in (0.0, 1e-9, 20.0, 90.0, 130.0, 180.0) for C in (0.0, 45.0, 180.0)]
    points = np.array([*special, (0.0, 0, 0)])

    def arriving(position, direction, side, p):
        light = ds.MeasuredLight(position, direction, table, side=side)
        return light.arriving(Vec3.of(p))[1].x

    at = (np.zeros(3), np.array([0.0, -1, 0]), np.array([1.0, 0, 0]))
    for jacobian in (jax.jacfwd, jax.jacrev):
        slope_at = jax.vmap(jacobian(arriving, (0, 1, 2, 3)), (None, None, None, 0))
        slopes = jax.jit(slope_at, compiler_options=QUICK)(*at, points)
        assert all(np.isfinite(slope).all() for slope in slopes)
        assert all(np.abs(slope).max() < 1e3 for slope in slopes[:3])


def test_lamps_of_one_table_are_stacked_and_of_two_are_not():
    narrow = dataclasses.replace(LAMP, profile=ds.Profile([0, 40], [0], [[1, 0]]))
    lamps = [LAMP, dataclasses.replace(LAMP, position=(1, 2, 0)), narrow]
    item = ds.Object(ds.Sphere(), ds.Material(k_d=0.7))
    assert len(stack_scene(ds.Scene(item, lamps)).lights) == 2
    camera = ds.Camera((0, 0, 4), fov=35, shape=(12, 12))
    together = np.asarray(ds.render(ds.Scene(item, lamps), camera))
    alone = sum(np.asarray(ds.render(ds.Scene(item, lamp), camera)) for lamp in lamps)
    np.testing.assert_allclose(together, alone, rtol=1e-12, atol=1e-12)
    assert together.max() > 0


def test_a_scene_file_keeps_a_lamp(tmp_path):
    scene = ds.Scene(ds.Object(ds.Sphere(), ds.Material(k_d=0.7)), LAMP)
    ds.write_scene(tmp_path / "a.toml", scene)
    same = jax.tree.map(np.array_equal, ds.read_scene(tmp_path / "a.toml"), scene)
    assert all(jax.tree.leaves(same))


def test_a_lamp_is_fitted():
    """Its place, axis and intensity, from a photograph of a slope that it lights."""
    surface = ds.Object(ds.Plane((0, 0, 0), (0, 1, 0.4)), ds.Material(k_d=0.8))
    true = dataclasses.replace(LAMP, attenuation=ds.RadialAttenuation(0, 0, 1))
    camera = ds.Camera((0, 3, 4), fov=60, shape=(24, 24))
    views = [ds.View(np.asarray(ds.render(ds.Scene(surface, true), camera)), camera)]
    told = ds.Scene(surface, dataclasses.replace(true, position=(0.1, 1.8, 0.5), direction=(0, -1, 0.1), intensity=1))
    fit = ds.fit(told, views, free=("position", "direction", "intensity"), start="scene")
    (lamp,) = fit.scene.lights
    assert isinstance(lamp, ds.MeasuredLight)
    np.testing.assert_allclose(lamp.position, true.position, atol=1e-6)
    np.testing.assert_allclose(lamp.direction, true.direction / np.linalg.norm(true.direction), atol=1e-6)
    np.testing.assert_allclose(lamp.intensity, true.intensity, rtol=1e-6)


def test_a_material_is_fitted_under_a_lamp():
    """By the fast form of a fit, which knows the lamp's beam as a field."""
    camera = ds.Camera((0, 0, 4), fov=32, shape=(16, 16))
    lamp = dataclasses.replace(LAMP, position=(1, 2, 2), direction=(-1, -2, -2))
    truth = ds.Scene(ds.Object(ds.Sphere(), ds.Material(0.1, (0.6, 0.4, 0.25), 0.5, 20)), lamp)
    view = ds.View(np.asarray(ds.render(truth, camera)), camera)
    fit = ds.fit(ds.Scene(ds.Object(ds.Sphere()), lamp), view, free=("k_a", "k_d", "k_s", "n_s"))
    np.testing.assert_allclose(fit.material.k_d, (0.6, 0.4, 0.25), rtol=1e-4)
    np.testing.assert_allclose([float(fit.material.n_s), *fit.material.k_s], [20, 0.5, 0.5, 0.5], rtol=1e-3)


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
    check_table(ds.read_lamp(write(tmp_path, "a.ies", text)), about)


@pytest.mark.parametrize("symmetry", LDT_SYMMETRIES)
def test_symmetries_of_eulumdat(tmp_path, symmetry):
    stored, about = LDT_SYMMETRIES[symmetry]
    text = ldt(symmetry, 16, beam(stored[:, None], VERTICAL, about=about) / 4, flux=2000, factor=2)
    check_table(ds.read_lamp(write(tmp_path, "a.ldt", text)), about)


def test_a_lamp_that_is_the_same_all_around(tmp_path):
    row = beam(0, VERTICAL)[None]
    for name, text in (
        ("a.ies", ies([0], row)),
        ("a.ldt", ldt(1, 24, row)),
        ("b.LDT", ldt(1, 1, row).replace(".", ",")),
    ):
        lamp = ds.read_lamp(write(tmp_path, name, text), position=(0, 3, 0), direction=(0, 0, -1))
        assert lamp.profile.values.shape == (1, 6)
        np.testing.assert_allclose(lamp.profile.values * lamp.intensity[0], row, rtol=1e-9, atol=1e-9)
        np.testing.assert_array_equal([lamp.position, lamp.direction], [(0, 3, 0), (0, 0, -1)])
        assert float(lamp.attenuation.quadratic) == 1
        assert float(lamp.attenuation.constant) == 0


def test_tilt_factors_are_passed_over(tmp_path):
    text = ies([0], beam(0, VERTICAL)[None], tilt="TILT=INCLUDE\n1\n3\n0 45 90\n1 0.9 0.8", before="")
    np.testing.assert_allclose(ds.read_lamp(write(tmp_path, "a.ies", text)).intensity, beam(0, VERTICAL).max())


ROW = beam(0, VERTICAL)[None]
BAD = {
    "no tilt": ("a.ies", "IESNA\n1 2 3", "is no IES file: it has no line TILT=."),
    "cut off": ("a.ies", ies([0], ROW)[:-20], "must have 26 numbers after TILT, for 6 vertical and 1 horizontal"),
    "ends early": ("a.ies", "TILT=NONE\n1 2 3", "ends after TILT at '1 2 3'. It is cut off"),
    "type B": ("a.ies", ies([0], ROW, kind=2), "is of photometric type B; only C is read."),
    "a word": (
        "a.ies",
        ies([0], ROW).replace("45", "4_5"),
        "an angle or a candela value must be a finite number; got '4_5'",
    ),
    "infinite": ("a.ies", ies([0], ROW).replace("45", "1e999"), "must be a finite number; got '1e999'"),
    "open": ("a.ies", ies([0, 100], [ROW[0], ROW[0]]), "horizontal angles must go from 0 to 0, 90, 180 or 360 degrees"),
    "unsorted": ("a.ies", ies([0], ROW, VERTICAL[::-1]), "Profile.vertical must be angles that increase"),
    "dark": ("a.ies", ies([0], 0 * ROW), "the intensities must be finite, at least 0 and not all 0."),
    "negative": ("a.ies", ies([0], -ROW), "the intensities must be finite, at least 0 and not all 0."),
    "huge": ("a.ies", "TILT=NONE\n1 1 1 1e9 1e9 1 1 0 0 0 1 1 1", "must have 1000000002000000013 numbers"),
    "short ldt": ("a.ldt", "maker\n2\n1\n", "ends before line 4, Mc. It is cut off"),
    "many sets": (
        "a.ldt",
        ldt(1, 1, ROW).replace("\r\n1\r\n1\r\nLED", "\r\n1e15\r\n1\r\nLED"),
        "ends before line 6000",
    ),
    "long ldt": ("a.ldt", ldt(1, 1, ROW) + "3\n", "goes on after its 6 intensities."),
    "symmetry": ("a.ldt", ldt(5, 4, ROW), "line 3, the symmetry, must be 0 to 4"),
    "planes": ("a.ldt", ldt(4, 6, ROW), "its planes must divide the circle; got 4 with 6 planes"),
    "half a plane": (
        "a.ldt",
        ldt(1, 1, ROW).replace("\r\n1\r\n360", "\r\n1.5\r\n360"),
        "line 4, Mc, must be a whole number",
    ),
    "suffix": ("a.txt", "", "a lamp's file must end in .ies or .ldt; got '.txt'."),
    "zero bytes": ("a.ies", "TILT=NONE\0", "it holds zero bytes"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_file_is_refused_in_one_sentence(tmp_path, name):
    file, text, message = BAD[name]
    with pytest.raises(ValueError, match=re.escape(message)) as caught:
        ds.read_lamp(write(tmp_path, file, text))
    assert "\n" not in str(caught.value)


def test_a_missing_or_huge_file_is_refused(tmp_path, monkeypatch):
    with pytest.raises(FileNotFoundError, match="there is no lamp file"):
        ds.read_lamp(tmp_path / "none.ies")
    monkeypatch.setattr("diffshade.exchange.texts.LARGEST", 10)
    with pytest.raises(ValueError, match="too many for a lamp file; at most 10 are read"):
        ds.read_lamp(write(tmp_path, "a.ies", ies([0], ROW)))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: ds.Profile([0, 0], [0], [[1, 0]]), "Profile.vertical must be angles that increase"),
        (lambda: ds.Profile([0], [0], [[1]]), "Profile.vertical must hold two angles or more"),
        (lambda: ds.Profile([0, 90], [0, 180], [[1, 0], [1, 0]]), "Profile.horizontal must go from 0 to 360 degrees"),
        (lambda: ds.Profile([0, 90], [0], [[1, -1]]), "Profile.values must be finite numbers of at least 0, 1 x 2"),
        (lambda: ds.Profile([0, 90], [0], [[1, 1, 1]]), "got shape (1, 3)."),
        (lambda: dataclasses.replace(LAMP, side=(0.2, -2, 0.4)), "MeasuredLight.side must not be along direction"),
        (lambda: dataclasses.replace(LAMP, direction=(0, 0, 0)), "MeasuredLight.direction must not be the zero vector"),
    ],
)
def test_messages(make, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        make()


@pytest.mark.parametrize(("name", "exponent"), [("rab_5.ies", 1.3), ("rab_7.ies", 2.2), ("ledvance_sym_30.ldt", 14.4)])
def test_real_lamps_are_like_a_spot(name, exponent):
    found = ds.as_spot(ds.read_lamp(measured("lamps") / name))
    assert found.fits
    assert abs(float(found.light.exponent) / exponent - 1) < 0.02
    assert str(found).startswith(f"the lamp is like cos^{float(found.light.exponent):.3g} with a cutoff of 90 degrees")


def test_a_spot_is_found_again_with_its_cutoff():
    vertical = np.arange(0, 91.0)
    values = np.where(vertical <= 30, np.cos(np.deg2rad(vertical)) ** 3, 0)
    found = ds.as_spot(ds.MeasuredLight((1, 2, 3), (0, 0, -1), ds.Profile(vertical, [0], [values]), (3, 2, 1)))
    assert found.rms < 1e-6
    assert float(found.light.cutoff) == 30
    np.testing.assert_allclose(found.light.exponent, 3, rtol=1e-4)
    np.testing.assert_allclose(found.light.intensity, [3, 2, 1], rtol=1e-6)
    np.testing.assert_array_equal(found.light.position, [1, 2, 3])


def test_a_lamp_that_is_no_spot_is_said_to_be_none():
    wing = ds.Profile([0, 30, 60, 90], [0], [[0.3, 0.6, 1, 0]])  # a street light, brightest to its sides
    found = ds.as_spot(ds.MeasuredLight((0, 0, 0), (0, -1, 0), wing))
    assert not found.fits
    assert str(found).startswith("no cos^a fits this lamp: the nearest is cos^")


def test_the_falloff_of_a_real_lamp():
    table = np.loadtxt(measured("lamps") / "heig_falloff.csv", delimiter=",", skiprows=1)
    found = ds.fit_falloff(table[:, 0], table[:, 1])
    assert abs(found.slope + 1.93) < 0.005
    assert found.undetermined == ("constant", "linear")
    assert found.rms < 0.02
    assert "seven points do not separate constant and linear" in str(found)
    assert "quadratic 0.03863 +-0.004" in str(found)


def test_a_falloff_is_found_again_and_its_errors_hold():
    d = np.geomspace(0.1, 10, 12)
    true = np.array([0.5, 0.3, 0.2])
    rng = np.random.default_rng(0)
    lux = 1 / (true @ np.stack([d**0, d, d * d]))
    exact = ds.fit_falloff(d, lux)
    np.testing.assert_allclose([float(x) for x in jax.tree.leaves(exact.attenuation)], true, rtol=1e-9)
    scatter = []
    for _ in range(300):
        found = ds.fit_falloff(d, lux * (1 + 0.01 * rng.standard_normal(12)))
        scatter.append((np.array([float(x) for x in jax.tree.leaves(found.attenuation)]) - true) / found.errors)
        assert found.undetermined == ()
    assert (np.abs(np.std(scatter, 0) - np.sqrt(9 / 7)) < 0.15).all()  # Student's t of 12 - 3


@pytest.mark.parametrize("rows", [([1, 2, 3], [3, 2, 1]), ([1, 1, 2, 2], [3, 3, 2, 2]), ([1, 2, 3, -4], [4, 3, 2, 1])])
def test_a_table_that_is_none(rows):
    with pytest.raises(ValueError, match=r"at least four rows|must be a list of finite numbers above 0"):
        ds.fit_falloff(*rows)
