"""The command `diffshade`, typed as a user types it, in this process; what needs one of its own is in studies."""

import dataclasses
import html
import json
import re
import shutil
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mesh_files
import numpy as np
import pytest
import synthetic
from click.shell_completion import BashComplete
from exchange_formulas import written_k_d, written_materials
from folders import ball_under_distant_lights

import diffshade as ds
from diffshade.cli import main
from diffshade.cli.commands import diffshade
from diffshade.cli.domes import dome
from diffshade.core import progress
from diffshade.io import scene_files

COMMANDS = tuple(diffshade.commands)
PHOTOS = tuple(f"{i}.exr" for i in range(synthetic.COUNT))
UNKNOWN = ("--free", ",".join(synthetic.FREE), "--tied", "attenuation")


class Outcome:
    """What a command printed, and its status."""

    def __init__(self, status: int, out: str, err: str):
        self.status, self.out, self.err = status, out, err

    @property
    def refusal(self) -> str:
        """The one sentence of a command that failed."""
        assert self.status in (1, 2)
        assert self.out == ""
        assert self.err.startswith("diffshade: ")
        assert self.err.count("\n") == 1
        assert self.err.rstrip().endswith((".", "?"))
        assert "Traceback" not in self.err
        return self.err

    @property
    def told(self) -> dict[str, Any]:
        """The JSON of a command that succeeded."""
        assert self.status == 0, self.err
        return json.loads(self.out)


@pytest.fixture(scope="module")
def shot(tmp_path_factory) -> Path:
    """The standard problem as a scene file and photographs, a folder of photographs, and what is wrong with others."""
    here = tmp_path_factory.mktemp("shot")
    scene = synthetic.standard_scene()
    ds.write_scene(here / "ball.toml", scene, camera=synthetic.CAMERA)
    images = synthetic.noisy(synthetic.photographs(scene), 0.003, 0)
    for name, image in zip(PHOTOS, images, strict=True):
        ds.write_image(here / name, image)
    ball_under_distant_lights(here / "photographs")
    text = (here / "ball.toml").read_text()
    (here / "negative.toml").write_text(re.sub(r"n_s = .*", "n_s = -1.0", text))
    (here / "misspelt.toml").write_text(text.replace("background", "backgrund"))
    ds.write_image(here / "small.exr", images[0][1:])
    images[0][12, 13, 1] = np.nan
    np.save(here / "nan.npy", images[0])
    ds.write_image(here / "black.png", np.zeros((24, 24, 1)))
    ds.write_image(here / "half.png", np.indices((24, 24))[0][..., None] < 12.0)
    ball = ds.read_mask(here / "photographs" / "mask.png")
    ds.write_image(here / "half_ball.png", (ball & (np.indices((24, 24))[0] < 12))[..., None] * 1.0)
    ds.write_image(here / "cut.png", images[1].clip(0.0, 1.0))
    (here / "cut.png").write_bytes((here / "cut.png").read_bytes()[:300])
    ds.exchange.write_material(here / "gold.mtl", ds.material("gold"), name="gold")
    return here


@pytest.fixture
def typed(shot, capfd, tmp_path, monkeypatch):
    """Run a command line in a folder that has the photographs, in this process."""
    shutil.copytree(shot, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(progress, "BETWEEN", 3600.0)  # a machine that is busy says nothing else

    def run(*words: object) -> Outcome:
        capfd.readouterr()
        with pytest.raises(SystemExit) as end:
            main([str(word) for word in words])
        out, err = capfd.readouterr()
        assert isinstance(end.value.code, int)
        return Outcome(end.value.code, out, err)

    return run


def files(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def values(told: dict) -> dict[str, float]:
    return {parameter["name"]: parameter["value"] for parameter in told["parameters"]}


@pytest.mark.parametrize("command", ["", *COMMANDS])
def test_help_fits_a_screen_and_has_an_example_that_the_command_takes(typed, command):
    done = typed(*command.split(), "--help")
    assert done.status == 0
    lines = done.out.splitlines()
    assert len(lines) <= 24
    assert max(map(len, lines)) <= 80
    assert re.search(rf"^ *Example: diffshade {command}", done.out, re.MULTILINE)
    if command:
        words = (diffshade.commands[command].epilog or "").split()[3:]
        assert diffshade.commands[command].make_context(command, words).params


def test_without_a_command_it_shows_its_help_and_it_has_a_version(typed):
    assert "Commands:" in typed().out
    assert re.fullmatch(r"diffshade, version \d+\.\d+\.\d+\n", typed("--version").out)


def test_the_shell_completes():
    def completed(words: str) -> list[str]:
        *given, begun = words.split()
        return [item.value for item in BashComplete(diffshade, {}, "diffshade", "_D").get_completions(given, begun)]

    assert completed("re") == ["render", "report", "relight"]
    assert completed("new x.toml --material em") == ["emerald"]
    assert completed("fit ball.toml --loss ge") == ["geman-mcclure"]
    assert completed("figures out --only sn") == ["snell"]
    assert "--memory" in completed("fit --me")


def test_a_new_scene_renders(typed):
    assert typed("new", "new.toml").status == 0
    assert "# Render it with: diffshade render new.toml" in Path("new.toml").read_text()
    told = typed("render", "new.toml", "--size", "24x16", "--json").told
    assert told["shape"] == [16, 24, 3]
    assert ds.read_image("new.png").shape == (16, 24, 3)
    assert typed("new", "new.toml", "--material", "gold", "--force").status == 0
    assert ds.read_scene("new.toml").objects[0].material.n_s == ds.material("gold").n_s


def test_a_new_scene_names_every_key_and_each_can_be_uncommented(typed):
    typed("new", "all.toml")
    lines = Path("all.toml").read_text().splitlines()
    types = {cls for of in scene_files._TYPES.values() for cls in of}
    for cls in types:
        for field in dataclasses.fields(cls):
            assert re.search(rf"\b{field.name}\b", "\n".join(lines)), (cls, field.name)
        silent = (
            "Scene",
            "Material",
            "Object",
            "Camera",
            "Highlight",
            "Profile",
            "RadialAttenuation",
            "Flaps",
            "LampLabel",
        )
        assert cls.__name__ in silent or cls.__name__ in "\n".join(lines)
    tried = 0
    for i, line in enumerate(lines):
        key = re.match(r"# (\w+) = ", line)
        if not key or key.group(1) in ("type", "height"):
            continue
        start = max(k for k in range(i + 1) if k == 0 or re.match(r"(# )?\[", lines[k]))
        end = next((k for k in range(i, len(lines)) if lines[k].startswith("[")), len(lines))
        text = [row for k, row in enumerate(lines) if not (start <= k < end and row.startswith(f"{key.group(1)} = "))]
        table = [row for k, row in enumerate(lines[start:end]) if lines[start].startswith("# [")]
        if table:  # a light as a whole
            block = lines[start : next(k for k in range(i, len(lines) + 1) if k == len(lines) or not lines[k])]
            text = [*lines, *(row[2:] for row in block)]
        else:
            text.insert(text.index(line), line[2:])
        Path("one.toml").write_text("\n".join(text))
        ds.read_scene("one.toml")
        ds.read_camera("one.toml")
        tried += 1
    assert tried > 40


@pytest.mark.thorough
def test_a_mesh_is_rendered_in_its_materials(typed):
    pytest.importorskip("embreex")
    quad = "v {0} -1 0\nv {1} -1 0\nv {1} 1 0\nv {0} 1 0\n"
    faces = "usemtl red one\nf 1 2 3 4\nusemtl blue\nf 5 6 7 8\n"
    Path("two.obj").write_text("mtllib no.mtl\n" + quad.format(-2, 0) + quad.format(0, 2) + faces)
    Path("two.mtl").write_text("newmtl red one\nKd 1 0 0\nillum 1\nnewmtl blue\nKd 0 0 1\nillum 1\n")
    assert typed("render", "two.obj", "--material", "two.mtl", "--size", "32x24", "-o", "two.exr").status == 0
    image = ds.read_image("two.exr")
    assert image.shape == (24, 32, 3)
    left, right = image[12, 8], image[12, 24]
    assert left[0] > 0.3 > 1e-6 > left[2]
    assert right[2] > 0.3 > 1e-6 > right[0]
    assert not image[[0, -1]].any()  # framed
    assert not image[:, [0, -1]].any()
    assert typed("render", "two.obj", "--material", "emerald", "--size", "8x8", "-o", "one.exr").status == 0
    Path("less.mtl").write_text("newmtl red\nKd 1 0 0\nnewmtl blue\nKd 0 0 1\n")
    assert (
        "names the material 'red one', which less.mtl lacks"
        in typed("render", "two.obj", "--material", "less.mtl", "-o", "no.exr").refusal
    )
    assert "--material is for a mesh" in typed("render", "ball.toml", "--material", "gold").refusal


def test_meshes_are_drawn_as_their_formats_define_them(typed):
    """Pixels of each in one size, so that they are one compiled program."""
    pytest.importorskip("embreex")
    Path("two.mtl").write_text(mesh_files.TWO_MTL)
    files = {
        "absolute": (mesh_files.ABSOLUTE, "two.mtl"),
        "relative": (mesh_files.RELATIVE, "two.mtl"),
        "tabs": ("\ufeff" + mesh_files.RELATIVE.replace(" ", "\t"), "two.mtl"),
        "one": (mesh_files.RELATIVE.replace("usemtl", "#"), "emerald"),
        "notch": (mesh_files.NOTCH, "emerald"),
        "wall": (mesh_files.WALL, "emerald"),
        "card": (mesh_files.CARD, "emerald"),
    }
    lit = {}
    for name, (text, material) in files.items():
        Path(f"{name}.obj").write_text(text, encoding="utf-8")
        words = ("render", f"{name}.obj", "--material", material, "--size", "32x32", "-o", f"{name}.exr")
        assert typed(*words, "--samples", "1").status == 0
        lit[name] = int((ds.read_image(f"{name}.exr").max(-1) > 0).sum())
    assert (lit["wall"], lit["card"]) == pytest.approx((279, 196), abs=3)
    assert typed("render", "wall.obj", "--material", "emerald", "--size", "32x32", "-o", "smooth.exr").status == 0
    one, smooth = (ds.read_image(f"{name}.exr").max(-1) for name in ("wall", "smooth"))
    assert smooth.sum() == pytest.approx(one.sum(), rel=0.03)
    assert ((smooth > 0) & (smooth < 0.8 * one.max()) & (one == 0)).sum() > 20  # edges that are partly covered
    assert lit["absolute"] == lit["relative"] == lit["tabs"] == lit["one"] > 150
    Path("plain.obj").write_text(mesh_files.NOTCH.replace("f 1 2 3 4 5", "f 1 2 4\nf 2 3 4\nf 1 4 5"))
    typed("render", "plain.obj", "--material", "emerald", "--size", "32x32", "--samples", "1", "-o", "plain.exr")
    np.testing.assert_allclose(ds.read_image("plain.exr"), ds.read_image("notch.exr"), atol=1e-6)
    points = [(mesh_files.POINTS.astype("<f4"), "VEC3"), (np.array([0, 1, 2, 3], "<u1"), "SCALAR")]
    row = {"attributes": {"POSITION": 0}, "indices": 1, "mode": 6}
    materials = [{"name": "red", "pbrMetallicRoughness": {"baseColorFactor": [1, 0, 0, 1]}}, {"name": "blue"}]
    Path("x.glb").write_bytes(mesh_files.gltf([row | {"material": 0}], points, materials=materials))
    assert typed("render", "x.glb", "--material", "x.glb", "--size", "32x32", "-o", "x.exr").status == 0
    red = ds.read_image("x.exr")[16, 16]
    assert red[0] > 5 * red[2] > 0
    assert typed("render", "x.glb", "--size", "32x32", "-o", "own.exr").status == 0
    np.testing.assert_array_equal(ds.read_image("own.exr"), ds.read_image("x.exr"))
    Path("bare.glb").write_bytes(mesh_files.gltf([row], points, materials=materials))
    refusal = typed("render", "bare.glb", "--material", "x.glb", "--size", "32x32", "-o", "bare.exr").refusal
    assert "faces of bare.glb name no material, and x.glb has 2" in refusal
    assert not Path("bare.exr").exists()


def test_meshes_are_shaded_by_their_own_normals(typed, caplog):
    """A tilted square in three formats; in OBJ at a map's coordinates, in two materials and with a face of no area."""
    pytest.importorskip("embreex")
    far = "".join(f"v {500_000 + x:.0f} {5_400_000 + y:.0f} 300\n" for x, y, _ in mesh_files.POINTS)
    faces = "f 1//1 1//1 1//1\nusemtl red\nf 1//1 2//2 3//3\nusemtl blue\nf 1//1 3//3 4//4\n"
    Path("q.obj").write_text(far + mesh_files.TILTED + faces)
    Path("q.mtl").write_text(mesh_files.TWO_MTL.replace("0.8 0.1 0.1", "0.1 0.1 0.8"))
    Path("q.ply").write_bytes(mesh_files.ply("ascii", [(0, 1, 2), (0, 2, 3)]))
    kinds = ((mesh_files.POINTS, "VEC3"), (mesh_files.NORMALS, "VEC3"))
    row = {"attributes": {"POSITION": 0, "NORMAL": 1}, "indices": 2, "mode": 6}
    order = (np.array([0, 1, 2, 3], "<u1"), "SCALAR")
    Path("q.glb").write_bytes(mesh_files.gltf([row], [*((of.astype("<f4"), kind) for of, kind in kinds), order]))
    Path("one.mtl").write_text("newmtl blue\nKd 0.1 0.1 0.8\nillum 1\n")
    images = []
    for name, material in (("q.obj", "q.mtl"), ("q.ply", "one.mtl"), ("q.glb", "one.mtl")):
        done = typed("render", name, "--material", material, "--size", "32x32", "-o", "q.exr")
        assert done.status == 0, done.err
        images.append(ds.read_image("q.exr"))
    assert caplog.messages == ["q.obj: face 1 of 3 has no area or fewer than three corners; it is left out."]
    for image in images[1:]:
        np.testing.assert_allclose(image, images[0], atol=1e-4)
    assert np.ptp(images[0][16, 10:22, 2]) > 0.02  # a flat square has one shade


def test_a_render_is_the_librarys(typed):
    done = typed("render", "ball.toml", "--lit", "0,2", "--exposure", "0.5", "-o", "out.exr")
    assert (done.status, done.err) == (0, "")
    scene, camera = ds.read_scene("ball.toml"), ds.read_camera("ball.toml")
    expected = 0.5 * np.asarray(ds.render(scene, camera, lit=(0, 2), samples=4))
    np.testing.assert_allclose(ds.read_image("out.exr"), expected, atol=1e-6)
    assert f"radiance 0 to {expected.max():.3g}" in done.out


def test_one_ray_a_pixel_and_an_exposure_that_is_found(typed):
    done = typed("render", "ball.toml", "--samples", "1", "--exposure", "auto", "-o", "auto.exr")
    assert (done.status, done.err) == (0, "")
    radiance = np.asarray(ds.render(ds.read_scene("ball.toml"), ds.read_camera("ball.toml")))
    found = ds.read_image("auto.exr")
    factor = found.sum() / radiance.sum()
    np.testing.assert_allclose(found, factor * radiance, rtol=1e-5, atol=1e-7)
    lit = found.max(-1)[found.max(-1) > 0]
    assert np.mean(lit > 1.0) == pytest.approx(0.005, abs=1.0 / lit.size)
    assert f"exposure {factor:.4g}: 99.5 % of the pixels" in done.out
    done = typed("render", "ball.toml", "--samples", "1", "--exposure", "auto", "-o", "auto.png", "--json")
    assert done.told["exposure"] == pytest.approx(factor)
    assert done.err == ""  # what it makes white is no warning


def test_a_fit_prints_its_table_and_writes_scene_and_materials(typed):
    done = typed("fit", "ball.toml", *PHOTOS, *UNKNOWN, "-o", "fitted.toml", "-o", "ball.mtl", "-o", "ball.json")
    assert (done.status, done.err) == (0, "")  # no progress where nobody looks
    assert re.search(r"^n_s +(49|50)", done.out, re.MULTILINE)
    told = typed("fit", "ball.toml", *PHOTOS, *UNKNOWN, "--json").told
    found = values(told)
    for name, truth in (("n_s", 50), ("k_d.r", 0.6), ("k_s.b", 0.45), ("quadratic", 0.032)):
        assert found[name] == pytest.approx(truth, rel=0.03)
    assert all(parameter["determined"] and not parameter["at_bound"] for parameter in told["parameters"])
    assert told["photographs"] == list(PHOTOS)
    assert told["rmse"] == pytest.approx(0.003, rel=0.05)
    assert told["errors"].startswith("for independent noise")
    errors = [parameter["plain_error"] for parameter in told["parameters"]]
    np.testing.assert_allclose(np.sqrt(np.diag(told["covariance"])), errors, rtol=1e-12)
    fitted = ds.read_scene("fitted.toml")
    assert fitted.objects[0].material.n_s == pytest.approx(found["n_s"])
    assert len(fitted.lights) == 8
    np.testing.assert_allclose(ds.exchange.read_material("ball.mtl").k_d, fitted.objects[0].material.k_d)


class Stopped(ValueError):
    """Thrown instead of fitting, with what was to be fitted."""


def asked(typed, monkeypatch, *words: object) -> tuple[ds.Scene, Any, dict[str, Any]]:
    """What a command asks of the library."""
    calls = []

    def fit(scene, views, **options):
        calls.append((scene, views, options))
        raise Stopped("views[1] was looked at")

    with monkeypatch.context() as patch:
        patch.setattr(ds, "fit", fit)
        assert "1.exr was looked at" in typed(*words).refusal  # called by its name
    return calls[0]


def test_what_is_said_of_a_fit_reaches_it(typed, monkeypatch):
    options = ["--free", "k_d,k_s,n_s", "--grey", "k_s", "--bounds", "n_s=0.1:10", "--bounds", "k_s=0:1"]
    options += ["--noise", "0.003", "--lobe", "blinn", "--loss", "huber", "--memory", "0.5", "--mask", "half.png"]
    scene, views, given = asked(typed, monkeypatch, "fit", "ball.toml", *PHOTOS, *options)
    assert isinstance(scene.objects[0].material.lobe, ds.Blinn)
    assert [view.lit for view in views] == [(i,) for i in range(8)]
    np.testing.assert_array_equal(views[3].mask, np.indices((24, 24))[0] < 12)
    assert views[0].noise.read == pytest.approx(0.003)
    assert given["free"] == ("k_d", "k_s", "n_s")
    assert given["bounds"] == {"n_s": [0.1, 10.0], "k_s": [0.0, 1.0]}
    assert [type(constraint) for constraint in given["constraints"]] == [ds.Grey]
    assert (given["loss"], given["memory"]) == ("huber", 0.5e9)
    _, views, given = asked(typed, monkeypatch, "fit", "ball.toml", "2.exr", "1.exr", "--lit", "2,0+1")
    assert [view.lit for view in views] == [(2,), (0, 1)]
    np.testing.assert_array_equal(views[0].image, ds.read_image("2.exr"))
    assert given["free"] == ("k_a", "k_d", "k_s", "n_s")
    assert (given["light_error"], given["intensity_error"]) == (None, None)
    lights = ["--free", "k_d,position,intensity", "--light-error", "2", "--intensity-error", "0.05"]
    _, _, given = asked(typed, monkeypatch, "fit", "ball.toml", *PHOTOS, *lights)
    assert (given["light_error"], given["intensity_error"]) == (2.0, 0.05)
    _, views, _ = asked(typed, monkeypatch, "fit", "ball.toml", "2.exr", "1.exr", "--lit", "all")
    assert [view.lit for view in views] == [None, None]


def test_a_folder_is_a_scene_and_its_photographs(typed, monkeypatch):
    scene, views, _ = asked(typed, monkeypatch, "fit", "photographs", "--mask", "half_ball.png", "--noise", "0.01")
    expected, of_folder = ds.read_photographs("photographs")
    assert len(views) == len(scene.lights) == len(expected.lights) == 8
    np.testing.assert_array_equal(views[5].image[:], of_folder[5].image[:])
    assert views[5].noise.read == pytest.approx(0.01)
    np.testing.assert_array_equal(views[5].mask, ds.read_mask("half_ball.png"))


def test_the_errors_of_a_folders_lights_are_its_files_unless_others_are_typed(typed, monkeypatch):
    Path("photographs/light_errors.txt").write_text("\n".join(f"{0.5 + 0.1 * i}" for i in range(8)))
    _, _, given = asked(typed, monkeypatch, "fit", "photographs", "--free", "k_d,direction")
    np.testing.assert_allclose(given["light_error"], 0.5 + 0.1 * np.arange(8))
    _, _, given = asked(typed, monkeypatch, "fit", "photographs", "--free", "k_d,direction", "--light-error", "3")
    assert given["light_error"] == 3.0
    refusal = typed("fit", "photographs", "--free", "k_d,direction", "--light-error", "0").refusal
    assert "is free, but light_error says that it is exact" in refusal


def test_models_are_compared(typed, monkeypatch):
    """Of which matte has no highlight, whatever is said of it."""
    fits, compared = [], {}
    monkeypatch.setattr(ds, "fit", lambda scene, views, **options: fits.append((scene, options)) or len(fits))
    monkeypatch.setattr(ds, "compare", lambda found, **_: compared.update(found) or SimpleNamespace(best="blinn"))
    words = ["--grey", "k_s", "--bounds", "n_s=1:100", "--bounds", "k_d=0:1", "--model", "phong,blinn,matte"]
    assert typed("compare", "ball.toml", *PHOTOS, *UNKNOWN, *words, "--json").told["best"] == "blinn"
    assert compared == {"phong": 1, "blinn": 2, "matte": 3}
    (phong, of_phong), (blinn, _), (matte, of_matte) = fits
    assert [type(scene.objects[0].material.lobe) for scene in (phong, blinn)] == [ds.Phong, ds.Blinn]
    assert np.all(phong.objects[0].material.k_s > 0)
    assert np.all(matte.objects[0].material.k_s == 0)
    assert (of_phong["free"], of_phong["bounds"]) == (synthetic.FREE, {"n_s": [1.0, 100.0], "k_d": [0.0, 1.0]})
    assert (of_matte["free"], of_matte["bounds"]) == (("k_a", "k_d", "attenuation"), {"k_d": [0.0, 1.0]})
    assert (len(of_phong["constraints"]), len(of_matte["constraints"])) == (1, 0)


def test_a_page_and_its_json_agree(typed):
    told = typed("report", "ball.toml", *PHOTOS, *UNKNOWN, "--quick", "-o", "ball.html", "--json").told
    page = Path("ball.html").read_text(encoding="utf-8")
    assert "<h1>Fit of 8 photographs</h1>" in page
    assert all(parameter["name"] in page for parameter in told["parameters"])
    assert all(f">{name}<" in page for name in PHOTOS)
    assert told["page"] == "ball.html"


@pytest.mark.slow
def test_what_a_fit_says_of_a_photograph_that_is_too_bright_is_said_everywhere(typed):
    ds.write_image(PHOTOS[0], 1.2 * ds.read_image(PHOTOS[0]))
    words = ("ball.toml", *PHOTOS, "--free", "k_a,k_d,k_s,n_s")
    told, printed = typed("fit", *words, "--json").told, typed("fit", *words).out
    camera, images = ds.read_camera("ball.toml"), [ds.read_image(name) for name in PHOTOS]
    views = [ds.View(image, camera, lit=(i,)) for i, image in enumerate(images)]
    examined = ds.examine(ds.fit(ds.read_scene("ball.toml"), views, free=("k_a", "k_d", "k_s", "n_s")))
    paged = typed("report", *words, "--quick", "-o", "ball.html", "--json").told
    page = html.unescape(Path("ball.html").read_text(encoding="utf-8"))
    (cause,) = [note for note in told["notes"] if "as bright" in note]
    assert cause.startswith("the residuals are not noise: 0.exr is 1.19 times as bright as the other views predict")
    assert {*told["notes"]} == {*paged["notes"]} <= {re.sub(r"views\[(\d)]", r"\1.exr", n) for n in examined.notes}
    assert all(note in page for note in told["notes"])
    assert " ".join(printed.split()).count(cause) == 1
    withheld = [{p["name"] for p in of["parameters"] if not p["determined"]} for of in (told, paged)]
    assert withheld[0] == withheld[1]
    assert withheld[0] <= {n for n, sure in zip(examined.fit.names, examined.determined, strict=True) if not sure}


def test_the_next_photograph(typed):
    told = typed("plan", "ball.toml", *PHOTOS, *UNKNOWN, "--aim", "n_s", "--lights", "ball.toml", "--json").told
    assert len(told["order"]) == 8
    place = np.round(synthetic.light_positions()[0], 3) + 0.0
    assert f"light at {place[0]:g}, {place[1]:g}, {place[2]:g}" in told["order"]
    at = told["unknowns"].index("n_s")
    aimed = [row[at] for row in told["errors"]]
    assert aimed[0] == min(aimed) <= max(aimed) < told["now"][at]


def test_the_dome_surrounds_what_the_camera_sees():
    scene = synthetic.standard_scene()
    shots = dome(SimpleNamespace(scene=scene, views=[ds.View(np.ones((24, 24, 3)), synthetic.CAMERA)]))  # pyright: ignore
    assert len(shots) == len({shot.name for shot in shots}) == 27
    places = np.array([shot.light.position for shot in shots if isinstance(shot.light, ds.PointLight)])
    assert len(places) == 27
    assert (places[:, 2] > 0).all()  # none behind the ball
    assert np.abs(places[:, :2].sum(0)).max() < 0.2 * np.abs(places).max()
    away = np.array([float(shot.name.split()[-2]) for shot in shots])
    center = places[1] - [0.0, 0.0, away[1]]
    np.testing.assert_allclose(center, 0.0, atol=1e-9)  # of the ball
    np.testing.assert_allclose(np.linalg.norm(places - center, axis=-1), away, rtol=2e-3)
    np.testing.assert_allclose(away.reshape(9, 3) / away[1], [[0.6, 1.0, 2.0]] * 9, rtol=2e-3)
    assert shots[4].name.startswith("right, 30 degrees off, ")
    assert places[4, 0] - center[0] == pytest.approx(away[1] * np.sin(np.pi / 6), rel=1e-3)


def test_texels(typed):
    told = typed("texels", "photographs", "-o", "maps", "--free", "k_d", "--suffix", ".png", "--json").told
    assert told["status"]["determined"] > 200
    assert told["medians"]["k_d"] == pytest.approx([0.4, 0.3, 0.2], rel=0.1)  # of a ball with a highlight
    assert Path("maps/k_d.npy").is_file()
    assert Path("maps/k_d.png").is_file()
    assert told["heights"] is None
    words = ("relight", "maps", "--light", "1,1,2", "--light=-1,0,1=0.5,0.2,0.1", "-o", "lit.npy")
    assert typed(*words, "--json").told["shape"] == [24, 24, 3]
    lights = [ds.DirectionalLight((-1, -1, -2)), ds.DirectionalLight((1, 0, -1), (0.5, 0.2, 0.1))]
    np.testing.assert_array_equal(np.load("lit.npy"), ds.read_maps("maps").shade(lights))
    assert "relight needs a light" in typed("relight", "maps", "-o", "none.png").refusal
    assert (
        "photographs holds no maps.toml" in typed("relight", "photographs", "--light", "0,0,1", "-o", "n.png").refusal
    )
    assert "X,Y,Z toward it; got '1,2'" in typed("relight", "maps", "--light", "1,2", "-o", "none.png").err
    assert not Path("none.png").exists()
    pytest.importorskip("trimesh")
    assert "triangles" in typed("convert", "maps", "relief.ply").out
    assert "triangles" in typed("convert", "maps", "solid.ply", "--watertight", "--brighten").out
    assert "HSH of 9 terms" in typed("convert", "maps", "viewer").out
    assert "relief.ptm: PTM of 6 terms" in typed("convert", "maps", "relief.ptm").out
    assert Path("viewer/info.json").is_file()
    assert "viewer exists already" in typed("convert", "maps", "viewer").refusal
    assert "'.stl' is not the suffix of a mesh" in typed("convert", "maps", "relief.stl").refusal
    assert "--tolerance is for meshes" in typed("convert", "brass.mtl", "b.json", "--tolerance", "1").refusal


def test_too_few_photographs_to_leave_one_out(typed):
    outcome = typed("texels", "photographs", "-o", "maps", "--hold-out", "99")
    assert outcome.status != 0
    assert "--hold-out must be from 2 to the number of photographs" in outcome.err
    assert "got no --hold-out" in typed("texels", "photographs", "-o", "maps", "--bands").err
    assert "at least 8 different lights; got 6" in typed("fit", "photographs", "--hold-out", "4").err
    assert not Path("maps").exists()


def test_heights_of_texels(typed):
    words = ("texels", "photographs", "-o", "relief", "--free", "k_d", "--heights")
    told = typed(*words, "--json").told
    assert told["heights"]["parts"] >= 1
    assert any("no errors were given" in note for note in told["heights"]["notes"])  # those of the folder have none
    assert np.load("relief/height.npy").shape == (24, 24)
    assert Path("relief/heights.toml").is_file()
    assert str(Path("relief/height.npy")) in told["written"]
    assert "standard error" in typed(*words).out
    shot = ("texels", "ball.toml", *PHOTOS, "-o", "none", "--free", "k_d", "--heights")
    assert "Add normal to --free" in typed(*shot).refusal
    assert not Path("none").exists()


def test_a_balls_lights_are_found_and_compared_with_a_list(typed):
    shutil.copy("photographs/light_directions.txt", "list.txt")
    words = ["calibrate", "photographs", "--ball", "matte"]
    told = typed(*words, "--against", "list.txt", "-o", "ready", "--json").told
    assert max(told["against"]["degrees"]) < 10
    assert told["photographs"] == list(PHOTOS)
    assert told["balls"] == [{key: told[key] for key in told["balls"][0]}]
    np.testing.assert_allclose(np.loadtxt("ready/light_directions.txt"), told["directions"], atol=1e-6)
    known = typed(*words, "--directions", "list.txt", "--json").told
    np.testing.assert_allclose(known["directions"], np.loadtxt("list.txt"), atol=1e-6)
    rows, columns = np.nonzero(ds.read_mask("photographs/mask.png"))
    circle = f"{columns.mean() + 0.5},{rows.mean() + 0.5},{np.sqrt(len(rows) / np.pi)}"
    by_circle = typed(*words, "--circle", circle, "--json").told
    np.testing.assert_allclose(by_circle["directions"], told["directions"], atol=0.05)


@pytest.mark.thorough
def test_lights_are_found_from_the_object_and_written_as_a_folder(typed):
    words = ("find-lights", "photographs", "--light-error", "2")
    told = typed(*words, "-o", "refined", "--json").told
    listed = np.loadtxt("photographs/light_directions.txt")
    assert np.abs(np.asarray(told["directions"]) - listed).max() < 0.1
    np.testing.assert_allclose(np.loadtxt("refined/light_directions.txt"), told["directions"], atol=1e-12)
    np.testing.assert_allclose(np.loadtxt("refined/light_errors.txt"), told["errors"], rtol=1e-5)
    np.testing.assert_array_equal(np.loadtxt("refined/light_intensities.txt"), np.ones((8, 3)))
    assert len(typed("fit", "refined", "--free", "k_d,k_s,n_s", "--json").told["photographs"]) == 8
    assert "is the folder of the photographs" in typed(*words[:2], "-o", "photographs").refusal
    assert "does not say how exact its directions are" in typed("find-lights", "photographs").refusal
    assert "light_error must be one number" in typed("find-lights", "photographs", "--light-error", "-2").refusal
    assert "there is no folder nowhere" in typed("find-lights", "nowhere", "--unknown").refusal


def test_a_mask_is_found_and_written_once(typed):
    told = typed("mask", "photographs", "-o", "found.png", "--json").told
    drawn = ds.read_mask("photographs/mask.png")
    assert np.mean(ds.read_mask("found.png") == drawn) > 0.9
    assert told["share"] == pytest.approx(np.mean(ds.read_mask("found.png")))
    assert "exists already" in typed("mask", "photographs").refusal


def test_a_ball_is_applied_to_an_object(typed):
    words = ("calibrate", "photographs", "--ball", "matte", "--apply", "photographs")
    told = typed(*words, "-o", "applied", "--json").told["applied"]
    assert told["read_as"] == ["linear"] * 8
    np.testing.assert_allclose(np.loadtxt("applied/light_directions.txt"), told["directions"], atol=1e-12)
    assert ds.read_image("applied/lights-shown.png").shape[2] >= 3
    assert "needs a folder to write" in typed(*words).refusal
    assert "balls beside one object" in typed("calibrate", "photographs", "photographs", "--ball", "matte").refusal


def test_materials_are_converted(typed):
    done = typed("convert", "gold.mtl", "gold.c", "gold.toml", "gold.gltf", "--name", "gold")
    assert done.status == 0
    assert "gold.gltf: the highlight" in done.out
    for name in ("gold.toml", "gold.c"):
        (again,) = written_materials(Path(name)).values()
        np.testing.assert_allclose(again.k_s, ds.material("gold").k_s, rtol=1e-6)
    assert "no material can be read from '.c'" in typed("convert", "gold.c", "again.mtl").refusal


def test_all_materials_of_a_file_are_converted(typed):
    rows = "".join(f"newmtl Material.{i:03}\nKd 0.5 0.5 {i / 4}\nNs 20\nillum 1\n" for i in range(4))
    Path("four.mtl").write_text(rows)
    wanted = [f"four{suffix}" for suffix in (".c", ".json", ".js", ".py", ".inc", ".gltf", ".toml")]
    done = typed("convert", "four.mtl", *wanted)
    assert done.status == 0
    for name in wanted:
        assert f"{name}: 4 materials" in done.out
        again = written_k_d(Path(name))
        assert [of.replace("_", ".") for of in again] == [f"Material.{i:03}" for i in range(4)]
        np.testing.assert_allclose([k_d[2] for k_d in again.values()], [0, 0.25, 0.5, 0.75], atol=0.01)
    assert "# Material_003 is 'Material.003'" in Path("four.toml").read_text()
    assert ds.read_camera("four.toml").shape == (192, 192)


def test_figures(typed, monkeypatch):
    drawn = {}
    write = lambda folder, **given: drawn.update(given, folder=folder) or [folder]  # noqa: E731
    monkeypatch.setattr(ds.lecture, "write_figures", write)
    words = ("figures", "lecture", "--only", "snell,lobes", "--suffix", ".svg", "--dark", "--scale", "2")
    assert typed(*words).out == "lecture\n"
    assert (drawn["folder"], drawn["only"]) == (Path("lecture"), ("snell", "lobes"))
    assert (drawn["suffix"], drawn["dark"], drawn["scale"]) == (".svg", True, 2)


BAD = {
    # what is wrong, what is typed, and what the sentence must hold
    "a scene that is missing": (["render", "nowhere.toml"], "there is no scene file nowhere.toml"),
    "a photograph that is missing": (["fit", "ball.toml", "nowhere.png"], "there is no file nowhere.png"),
    "image and camera of different size": (["fit", "ball.toml", "small.exr", "--lit", "0"], "small.exr: View.image"),
    "a pixel that is not a number": (
        ["fit", "ball.toml", "nan.npy", "--lit", "0"],
        "nan.npy: the image must be finite inside the mask; got [0.",
    ),
    "which pixel": (["fit", "ball.toml", "nan.npy", "--lit", "0"], "row 12, column 13"),
    "an unknown parameter": (["fit", "ball.toml", "0.exr", "--lit", "0", "--free", "kd"], "Did you mean 'k_d'?"),
    "all pixels masked": (["fit", "ball.toml", "0.exr", "--lit", "0", "--mask", "black.png"], "0.exr: no pixel"),
    "fewer photographs than lights": (["fit", "ball.toml", "0.exr", "1.exr"], "2 photographs with one light each"),
    "lights for other photographs": (["fit", "ball.toml", "0.exr", "--lit", "0,1"], "each of the 1 photographs; got 2"),
    "a folder and photographs": (["fit", "photographs", "0.exr"], "PHOTOS cannot be combined with a folder"),
    "a folder and lights": (["fit", "photographs", "--lit", "0"], "--lit cannot be combined with a folder"),
    "lights for a render": (["render", "ball.toml", "--lit", "left"], "lights must be indices from 0; got 'left'"),
    "a scene for a scene": (["new", "ball.toml"], "ball.toml exists already"),
    "a scene that is no scene": (["new", "ball.png"], "has the suffix '.png'"),
    "a model that there is not": (["compare", "photographs", "--model", "fong,matte"], "no model is named 'fong'"),
    "one model": (["compare", "photographs", "--model", "matte"], "two or more"),
    "one model twice": (["compare", "photographs", "--model", "matte,matte"], "two or more"),
    "a ball that there is not": (["calibrate", "photographs", "--ball", "miror"], "Did you mean 'mirror'?"),
    "no circle": (["calibrate", "photographs", "--ball", "matte", "--circle", "3,4"], "got '3,4'"),
    "a mask and a circle": (
        ["calibrate", "photographs", "--ball", "matte", "--circle", "3,4,5", "--mask", "photographs/mask.png"],
        "--mask and --circle both say where",
    ),
    "a list that is missing": (
        ["calibrate", "photographs", "--ball", "matte", "--directions", "no.txt"],
        "there is no list of lights no.txt",
    ),
    "one of several materials": (["convert", "gold.mtl", "gold.c", "gold.foo"], "'.foo'"),
    "a folder for a material": (["convert", "gold.mtl", "gold.c", "nowhere/gold.c"], "no folder"),
    "what is read": (["convert", "gold.mtl", "gold.mtl"], "gold.mtl is an input file"),
    "a light that is not there": (["fit", "ball.toml", "0.exr", "--lit", "8"], "0.exr: lit must hold indices"),
    "a PNG that is cut off": (["fit", "ball.toml", "cut.png", "--lit", "0"], "cut.png"),
    "a negative n_s": (["render", "negative.toml"], "Material.n_s must be at least 0"),
    "a misspelt key": (["render", "misspelt.toml"], "has no key 'backgrund'. Did you mean 'background'?"),
    "no photographs": (["fit", "ball.toml"], "ball.toml needs photographs"),
    "no source": (["fit", "nowhere"], "nowhere does not exist"),
    "a page of another kind": (["report", "ball.toml", "0.exr", "--lit", "0", "-o", "page.pdf"], "Use .html."),
    "a folder that is missing": (["render", "ball.toml", "-o", "nowhere/ball.exr"], "there is no folder"),
    "noise of nothing": (["fit", "ball.toml", "0.exr", "--lit", "0", "--noise", "0"], "--noise must be above 0"),
    "no memory": (["fit", "ball.toml", "0.exr", "--lit", "0", "--memory", "0"], "--memory must be above 0"),
    "a photograph for a scene": (["fit", "0.exr", "1.exr"], "0.exr is neither"),
    "a picture larger than any": (["render", "ball.toml", "--size", "100000x100000"], "10,000,000,000 pixels"),
    "an exposure below 0": (["render", "ball.toml", "--exposure", "-1"], "--exposure must be above 0"),
    "an exposure that is a word": (["render", "ball.toml", "--exposure", "bright"], "a number or auto; got 'bright'"),
    "no samples": (["render", "ball.toml", "--samples", "0"], "x>=1"),
    "an exposure that is not finite": (["render", "ball.toml", "--exposure", "inf"], "--exposure must be above 0"),
    "bits that no PNG has": (["render", "ball.toml", "--bits", "9"], "9"),
    "the scene for the picture": (["fit", "ball.toml", "0.exr", "--lit", "0", "-o", "ball.toml"], "is an input file"),
    "nothing free": (["fit", "ball.toml", "0.exr", "--free", ","], "names must be separated by commas"),
    "the photographs' own folder": (["calibrate", ".", "--ball", "matte", "-o", "."], "holds other files"),
    "a file for a folder": (["calibrate", "0.exr", "--ball", "matte", "-o", "1.exr"], "1.exr"),
    "a group for a matte model": (
        ["compare", "ball.toml", "0.exr", "--lit", "0", "--model", "phong,matte", "--free", "material"],
        "got --free material",
    ),
    "nothing for a matte model": (
        ["compare", "ball.toml", "0.exr", "--lit", "0", "--model", "phong,matte", "--free", "n_s"],
        "needs a free parameter besides k_s and n_s",
    ),
    "a size of one number": (["render", "ball.toml", "--size", "64"], "640x480"),
    "a size of nothing": (["render", "ball.toml", "--size", "0x3"], "640x480"),
    "bounds of one number": (["fit", "ball.toml", "0.exr", "--bounds", "k_s=1"], "k_s=0:1"),
    "lights that are no numbers": (["fit", "ball.toml", "0.exr", "--lit", "left"], "each, all"),
    "an unknown loss": (["fit", "ball.toml", "0.exr", "--loss", "hubber"], "Did you mean 'huber'?"),
    "an unknown command": (["rendr", "ball.toml"], "Did you mean 'render'?"),
    "an unknown option": (["render", "ball.toml", "--seize", "3x3"], "No such option '--seize'"),
    "a word too few": (["render"], "Missing argument 'SCENE'"),
    "no material": (["convert", "0.exr", "ball.mtl"], "no material can be read from '.exr'"),
    "an unknown figure": (["figures", "out", "--only", "snel"], "Did you mean 'snell'?"),
    "an unknown material": (["new", "gold.toml", "--material", "gould"], "Did you mean 'gold'?"),
}


def test_bad_input_is_one_sentence_and_a_status_and_nothing_is_written(typed, tmp_path):
    before = files(tmp_path)
    for name, (words, message) in BAD.items():
        done = typed(*words)
        assert done.status, name
        assert message in done.refusal, name
        assert files(tmp_path) == before, name


def test_a_stop_waits_for_the_import_of_a_library_and_for_no_other(typed, tmp_path, monkeypatch):
    look = "import sys, diffshade.cli\nwaits = diffshade.cli._imports_a_library(sys._getframe())\n"
    libraries = tmp_path / "site-packages"
    libraries.mkdir()
    monkeypatch.syspath_prepend(libraries)
    (libraries / "a_library.py").write_text(look)
    Path("a_helper.py").write_text(look)
    Path("a_module.py").write_text(f"import a_library, a_helper\n{look}")
    typed("--import", "a_module.py", "render", "ball.toml", "-o", "new.png")
    waits = {name: sys.modules.pop(name).waits for name in ("a_library", "a_helper", "a_module")}
    assert waits == {"a_library": True, "a_helper": False, "a_module": False}


@pytest.mark.parametrize("wrapped", [False, True], ids=["as it is", "within a class that is made"])
def test_a_stop_is_told_in_one_sentence(typed, monkeypatch, wrapped):
    ended = []

    def stop(*arguments: Any, **options: Any) -> None:
        if wrapped:  # as Python 3.11 raises what interrupts __set_name__
            raise RuntimeError("Error calling __set_name__ on 'Field'") from KeyboardInterrupt()
        raise KeyboardInterrupt

    def end(status: int) -> None:
        ended.append(status)
        raise SystemExit(status)

    monkeypatch.setattr("diffshade.model.rendering.render_once", stop)
    monkeypatch.setattr("os._exit", end)
    done = typed("render", "ball.toml", "-o", "new.png")
    assert ended == [130]
    assert (done.status, done.out) == (130, "")
    assert done.err.lstrip("\n") == "diffshade: stopped; unfinished files are left as they were.\n"
    assert not Path("new.png").exists()
