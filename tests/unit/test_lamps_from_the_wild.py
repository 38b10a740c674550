"""Lamp files as makers write them: other types of photometry, tilt, open circles, several sets, and what is said."""

import json
import logging
from typing import Any

import numpy as np
import pytest
from lamp_files import VERTICAL, beam, ies, ldt
from measured import measured

import diffshade as ds
from diffshade.cli import main
from diffshade.report.lamp_picture import _round_numbers, light_on_plane

ROW = beam(0, VERTICAL)[None]


def write(folder, name, text):
    (folder / name).write_text(text)
    return folder / name


H, V = np.linspace(-60, 60, 61), np.linspace(-50, 50, 51)


def floodlight(right, up):
    """Candela in a direction to the right and up of the axis, by its slopes: neither round nor symmetrical."""
    return 1000 * np.exp(-(((right - 0.1) / 0.5) ** 2) - ((up + 0.2) / 0.3) ** 2)


def table_of(kind):
    h, v = np.deg2rad(H)[:, None], np.deg2rad(V)
    if kind == 2:  # B: planes through the horizontal axis
        x, y, z = np.sin(h), np.cos(h) * np.sin(v), np.cos(h) * np.cos(v)
    else:  # A: planes through the vertical axis
        x, y, z = np.cos(v) * np.sin(h), np.sin(v) + 0 * h, np.cos(v) * np.cos(h)
    return floodlight(x / z, y / z)


@pytest.mark.thorough
@pytest.mark.parametrize("kind", [2, 3])
def test_a_floodlight_of_type_a_or_b_lights_a_wall_as_a_rotation_by_hand(kind, tmp_path):
    """A wall at 4 m, lamp aimed at it: candela of the direction, times cos^3 over the squared distance."""
    path = write(tmp_path, "a.ies", ies(H, table_of(kind), V, kind=kind))
    lamp = ds.lamps.read_lamp(path, position=(0, 0, 0), direction=(0, 0, -1), side=(1, 0, 0))
    x, y = np.meshgrid(np.linspace(-3, 3, 41), np.linspace(2.5, -2.5, 31))  # right and up, seen from behind the lamp
    p = np.stack([x, y, np.full_like(x, -4.0)], -1)
    wall = ds.GBuffer(np.broadcast_to([0.0, 0, 1], p.shape), p)
    camera = ds.OrthographicCamera((0, 0, 4), shape=x.shape)
    image = ds.render(ds.Scene(ds.Object(wall, ds.Material(k_d=1)), lamp), camera)
    cosine = 4 / np.sqrt(x**2 + y**2 + 16)
    lux = floodlight(x / 4, y / 4) * cosine**3 / 16
    np.testing.assert_allclose(np.asarray(image)[..., 0], lux, atol=0.01 * lux.max())
    assert "no symmetry" in str(lamp)


def test_a_floodlight_of_one_quarter_is_mirrored_and_keeps_its_flux(tmp_path):
    angles = np.arange(0, 91, 3.0)
    h, v = np.deg2rad(angles)[:, None], np.deg2rad(angles)
    values = 500 * np.cos(h) ** 3 * np.cos(v)
    lamp = ds.lamps.read_lamp(write(tmp_path, "a.ies", ies(angles, values, angles, kind=2)))
    # by the solid angle cos H dH dV of type B, over all four quarters
    expected = 4 * 500 * np.trapezoid(np.trapezoid(np.cos(h[:, 0]) ** 4 * np.ones(31)[:, None], h[:, 0]) * np.cos(v), v)
    flux = float(str(lamp).split("flux")[1].split("lm")[0])
    np.testing.assert_allclose(flux, expected, rtol=0.01)
    assert "mirrored about C0 and C90" in str(lamp)


def test_a_circle_that_leaves_out_its_end_is_closed(tmp_path):
    C = np.arange(0, 346, 15.0)
    lamp = ds.lamps.read_lamp(write(tmp_path, "a.ies", ies(C, beam(C[:, None], VERTICAL))))
    np.testing.assert_allclose(lamp.profile.horizontal, [*C, 360])
    np.testing.assert_allclose(lamp.profile.values[0], lamp.profile.values[-1])
    with pytest.raises(ValueError, match="the horizontal angles must go from 0 to 0, 90, 180 or 360"):
        ds.lamps.read_lamp(write(tmp_path, "b.ies", ies([0, 15, 100], beam(np.array([[0], [15], [100]]), VERTICAL))))


def test_a_lamp_that_is_tilted_gives_its_factor(tmp_path, caplog):
    factors = "\n1\n3\n0 45 90\n1 0.8 0.5"
    included = write(tmp_path, "a.ies", ies([0], ROW, tilt="TILT=INCLUDE" + factors))
    for direction, factor in (((0, -1, 0), 1.0), ((1, -1, 0), 0.8), ((0, 0, 2), 0.5)):
        side = (0, 0, 1) if direction[2] == 0 else (1, 0, 0)
        lamp = ds.lamps.read_lamp(included, direction=direction, side=side)
        np.testing.assert_allclose(lamp.intensity, factor * ROW.max())
    named, tilt = write(tmp_path, "b.ies", ies([0], ROW, tilt="TILT=b.tlt")), write(tmp_path, "b.tlt", factors)
    with caplog.at_level(logging.WARNING):
        untilted = ds.lamps.read_lamp(named, direction=(1, 0, 0), side=(0, 0, 1))
    assert "TILT names the file 'b.tlt', which is not opened; give tilt= if the lamp is tilted." in caplog.text
    caplog.clear()
    tilted = ds.lamps.read_lamp(named, direction=(1, 0, 0), side=(0, 0, 1), tilt=tilt)
    assert caplog.text == ""
    np.testing.assert_allclose(np.asarray(tilted.intensity) / untilted.intensity, 0.5)


def test_sets_of_lamps_are_chosen_or_added(tmp_path, caplog):
    one = ["1", "LED", "1000.0", "4000", "80", "10"]
    two = ["1", "LED plus", "2500.0", "3000", "90", "30"]
    text = ldt(1, 1, ROW).replace("\r\n".join(one), "\r\n".join([*one, *two])).split("\r\n")
    text[25] = "2"
    path = write(tmp_path, "a.ldt", "\n".join(text) + "printed by a program\n")
    with caplog.at_level(logging.WARNING):
        first = ds.lamps.read_lamp(path)
    assert (
        "it has 2 sets of lamps, of which the first is lit (0 'LED', 1 'LED plus'); choose by lamp_set=." in caplog.text
    )
    assert "what stands after the data is not read: 'printed by a program'." in caplog.text
    choices: tuple[tuple[Any, float, float], ...] = ((0, 1, 10), (1, 2.5, 30), ("all", 3.5, 40))
    for chosen, flux, watts in choices:
        lamp = ds.lamps.read_lamp(path, lamp_set=chosen)
        np.testing.assert_allclose(np.asarray(lamp.intensity) / first.intensity, flux)
        assert lamp.label.watts == watts
    with pytest.raises(ValueError, match=r"has 2 sets of lamps; got lamp_set=2\. Give 0 to 1, or 'all'"):
        ds.lamps.read_lamp(path, lamp_set=2)


def test_text_after_the_data_of_an_ies_file_is_said(tmp_path, caplog):
    with caplog.at_level(logging.WARNING):
        lamp = ds.lamps.read_lamp(write(tmp_path, "a.ies", ies([0], ROW) + "[END] of 1 file\n"))
    assert lamp.profile.values.shape == (1, 6)
    assert "what stands after the data is not read: '[END] of 1 file'." in caplog.text


def test_a_lamp_is_summed_up(tmp_path):
    """A Lambertian disc: its flux is pi times its peak, and it is half as bright at 60 degrees."""
    gamma = np.arange(0, 90.5, 0.5)
    text = ies([0], 100 * np.cos(np.deg2rad(gamma))[None], gamma, before="[MANUFAC] Maker\n[LUMINAIRE]  Disc\n")
    said = str(ds.lamps.read_lamp(write(tmp_path, "a.ies", text))).splitlines()
    assert said == [
        "Maker, Disc",
        "flux        314.2 lm integrated",
        "peak        100 cd at gamma 0",
        "beam angle  120 degrees",
        "power       10 W, 31.4 lm/W",
        "symmetry    the same all around",
    ]
    too_much = text.replace("1 -1 1", "2 100 1", 1)
    said = str(ds.lamps.read_lamp(write(tmp_path, "b.ies", too_much)))
    assert "314.2 lm integrated, 200 lm of its lamps" in said
    assert "The file contradicts itself: its table has more than the 200 lm of its lamps." in said
    stated = text.replace("[MANUFAC]", "[_ABSOLUTELUMENS] 314\n[MANUFAC]")
    said = str(ds.lamps.read_lamp(write(tmp_path, "d.ies", stated)))
    assert "314.2 lm integrated, 314 lm stated" in said
    assert "contradicts" not in said
    less = ldt(1, 1, 100 * np.cos(np.deg2rad(gamma))[None], gamma)
    assert "table is -69 % off the 1000 lm that it states" in str(ds.lamps.read_lamp(write(tmp_path, "c.ldt", less)))
    assert str(ds.lamps.MeasuredLight((0, 0, 0), (0, -1, 0), ds.lamps.Profile([0, 90], [0], [[1, 0]]))).startswith(
        "a lamp\nflux"
    )


STATED = {"rab_5.ies": 753.8, "rab_7.ies": 531.98, "ledvance_sym_30.ldt": 80919.0}


@pytest.mark.parametrize("file", STATED)
def test_the_flux_of_real_lamps_is_that_of_other_programs(file):
    """By Photometric Toolbox for the IES files, and by the LDT's own light output ratio."""
    lamp = ds.lamps.read_lamp(measured("lamps") / file)
    flux = float(str(lamp).split("flux")[1].split("lm")[0])
    np.testing.assert_allclose(flux, STATED[file], rtol=0.005)
    assert "contradicts" not in str(lamp)


SCENE = """
[[objects]]
surface = "Sphere"
[[lights]]
file = "lamps/a.ies"
position = [0, 3, 0]
intensity = 2.0
"""


def test_a_scene_names_a_lamps_file(tmp_path):
    (tmp_path / "lamps").mkdir()
    path = write(tmp_path / "lamps", "a.ies", ies([0], ROW, before="[MANUFAC] Maker\n"))
    lamp: Any
    lamp, expected = ds.read_scene(write(tmp_path, "a.toml", SCENE)).lights[0], ds.lamps.read_lamp(path)
    np.testing.assert_array_equal(lamp.profile.values, expected.profile.values)
    np.testing.assert_array_equal([*lamp.position, *lamp.intensity], [0, 3, 0, 2, 2, 2])
    assert lamp.label.maker == "Maker"
    assert float(lamp.attenuation.quadratic) == 1
    ds.write_scene(tmp_path / "b.toml", ds.read_scene(tmp_path / "a.toml"))
    again: Any = ds.read_scene(tmp_path / "b.toml").lights[0]
    assert again.label == lamp.label
    for text, message in (
        (SCENE.replace("a.ies", "no.ies"), "there is no lamp file"),
        (SCENE.replace('"lamps/a.ies"', "3"), r"lights\[0\].file must be the name of a file; got 3"),
        (SCENE.replace("file", 'type = "SpotLight"\nfile'), "has a file, which is a MeasuredLight"),
        (SCENE.replace("intensity", "intensty"), "has no key 'intensty'. Did you mean 'intensity'"),
    ):
        with pytest.raises((ValueError, FileNotFoundError), match=message):
            ds.read_scene(write(tmp_path, "c.toml", text))


def test_a_scene_chooses_the_set_and_the_tilt_of_its_lamp(tmp_path):
    C = np.arange(0, 361, 22.5)
    write(tmp_path, "a.ies", ies(C, beam(C[:, None], VERTICAL), tilt="TILT=a.tlt"))
    write(tmp_path, "a.tlt", "1\n3\n0 45 90\n1 0.8 0.5")
    two = ["1", "LED", "1000.0", "4000", "80", "10", "1", "LED plus", "2500.0", "3000", "90", "30"]
    text = ldt(1, 1, ROW).replace("\r\n".join(two[:6]), "\r\n".join(two)).split("\r\n")
    text[25] = "2"
    write(tmp_path, "b.ldt", "\n".join(text))
    rows = 'direction = [1, 0, 0]\nside = [0, 0, 1]\ntilt = "a.tlt"\n[[lights]]\nfile = "b.ldt"\nlamp_set = "all"\n'
    scene = '[[objects]]\nsurface = "Sphere"\n[[lights]]\nfile = "a.ies"\n' + rows
    lamps: Any = ds.read_scene(write(tmp_path, "a.toml", scene)).lights
    tilted = ds.lamps.read_lamp(tmp_path / "a.ies", direction=(1, 0, 0), side=(0, 0, 1), tilt=tmp_path / "a.tlt")
    np.testing.assert_array_equal([*lamps[0].intensity, *lamps[0].side], [*tilted.intensity, *tilted.side])
    np.testing.assert_allclose(tilted.intensity, 0.5 * ds.lamps.read_lamp(tmp_path / "a.ies").intensity)
    np.testing.assert_array_equal(lamps[1].intensity, ds.lamps.read_lamp(tmp_path / "b.ldt", lamp_set="all").intensity)
    for old, new, message in (
        ('"all"', "2", r"lights\[1\]: .*b\.ldt has 2 sets of lamps; got lamp_set=2"),
        ('"a.tlt"', "3", r"lights\[0\]\.tilt must be the name of a file; got 3"),
        ("tilt =", "tlit =", r"lights\[0\] has no key 'tlit'"),
    ):
        with pytest.raises(ValueError, match=message):
            ds.read_scene(write(tmp_path, "c.toml", scene.replace(old, new)))


def test_a_suffix_of_no_figure_is_told_before_the_lamp_is_read(tmp_path, capfd):
    with pytest.raises(SystemExit):
        main(["lamp", str(tmp_path / "none.ies"), "-o", str(tmp_path / "a.gif")])
    assert "a figure is written as .png, .pdf, .svg" in capfd.readouterr().err


@pytest.mark.thorough
def test_a_lamp_is_drawn_and_told_at_the_terminal(tmp_path, capfd, monkeypatch):
    monkeypatch.chdir(tmp_path)
    gamma = np.arange(0, 91, 1.0)
    write(tmp_path, "a.ies", ies([0], 100 * np.cos(np.deg2rad(gamma))[None], gamma))
    with pytest.raises(SystemExit) as end:
        main(["lamp", "a.ies", "--distance", "2", "--json"])
    assert end.value.code == 0
    told = json.loads(capfd.readouterr().out)
    assert (tmp_path / "a.png").stat().st_size > 10_000
    x, y = np.meshgrid(told["across"], told["across"])
    lambertian = 100 * 4 / (x**2 + y**2 + 4) ** 2  # cos^4 / d^2
    np.testing.assert_allclose(told["light"], lambertian, rtol=1e-3)
    for given, message in (
        (["--distance", "0"], "must be finite and not 0"),
        (["-o", "a.gif"], "is written as .png, .pdf, .svg"),
    ):
        with pytest.raises(SystemExit) as end:
            main(["lamp", "a.ies", *given])
        assert end.value.code == 1
        assert message in capfd.readouterr().err


@pytest.mark.thorough
def test_the_plane_is_seen_from_behind_the_lamp(tmp_path):
    """The bright side, C = 0, is on the right."""
    C = np.arange(0, 361, 22.5)
    lamp = ds.lamps.read_lamp(write(tmp_path, "a.ies", ies(C, beam(C[:, None], VERTICAL))))
    light = light_on_plane(lamp, 3.0, 5).light
    assert light[2, 4] > light[2, 0]
    assert light[0, 2] > light[4, 2]  # C = 90 up


@pytest.mark.thorough
def test_a_ceiling_is_a_plane_behind_the_lamp(tmp_path):
    """An uplight lights it as the same lamp, turned over, lights a floor; the sides of C0 and C90 stay."""
    C, gamma = np.arange(0, 361, 22.5), np.arange(0.0, 91, 5)
    values = beam(C[:, None], gamma)
    down = ds.lamps.read_lamp(write(tmp_path, "down.ies", ies(C, values, gamma)))
    up = ds.lamps.read_lamp(write(tmp_path, "up.ies", ies(C, values[:, ::-1], 180 - gamma[::-1])))
    np.testing.assert_allclose(light_on_plane(up, -2.0, 9).light, light_on_plane(down, 2.0, 9).light, rtol=1e-9)
    assert light_on_plane(up, 2.0, 9).light.max() == 0
    assert light_on_plane(up, -2.0, 9).across[0] == -2


def test_lines_of_equal_light_have_round_numbers():
    assert _round_numbers(0.7, 30.9) == [1, 2, 5, 10, 20]
    assert _round_numbers(80, 18220) == [500, 1000, 2000, 5000, 10000]
    assert _round_numbers(0.0, 0.5) == [0.01, 0.02, 0.05, 0.1, 0.2]
    assert _round_numbers(11, 19) == _round_numbers(0, 0) == _round_numbers(3, 3) == []


@pytest.mark.parametrize("behind", [False, True])
def test_a_picture_of_a_lamp_says_the_planes_and_no_label_is_on_a_curve(behind, tmp_path, monkeypatch):
    gamma = np.arange(0.0, 91, 5)
    row, angles = 100 * np.cos(np.deg2rad(gamma))[None], gamma
    if behind:
        row, angles = row[:, ::-1], 180 - gamma[::-1]
    name = "[MANUFAC] " + "A VERY LONG NAME OF A MAKER, " * 9
    lamp = ds.lamps.read_lamp(write(tmp_path, "a.ies", ies([0], row, angles, before=f"IESNA:LM-63-2002\n{name}\n")))
    figure = ds.lamps.draw_lamp(lamp, distance=-3 if behind else 3)
    ds.write_figure(tmp_path / "a.png", figure)
    polar, plane, _, summary = figure.axes
    assert (plane.get_xlabel(), plane.get_ylabel()) == ("along C0", "along C90")
    assert ("ceiling" in plane.get_title()) == behind
    assert polar.get_window_extent().width > 0.35 * figure.bbox.width  # however long the name is
    box = summary.texts[0].get_window_extent()
    assert 0 <= box.x0 < box.x1 <= figure.bbox.width
    assert 0 <= box.y0 < box.y1 < plane.get_window_extent().y0
    on_curves = np.concatenate([line.get_transform().transform(line.get_xydata()) for line in polar.lines])
    for label in polar.yaxis.get_ticklabels():
        box = label.get_window_extent()
        inside = (on_curves > (box.x0, box.y0)) & (on_curves < (box.x1, box.y1))
        assert not inside.all(1).any(), label.get_text()
