"""The command `diffshade`, typed as a user types it."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

import diffshade as ds
from diffshade.cli import diffshade, main
from diffshade.cli.domes import dome

COMMANDS = tuple(diffshade.commands)
PROGRAM = (sys.executable, "-m", "diffshade")
LIGHTS = ((2, 3, 4), (-3, 2, 4), (0, -3, 5))
SIZE = 40


class Outcome:
    """What a command printed, and its status."""

    def __init__(self, status: int, out: str, err: str):
        self.status, self.out, self.err = status, out, err

    @property
    def refusal(self) -> str:
        """The one sentence of a command that failed."""
        assert self.status != 0
        assert self.out == ""
        assert self.err.startswith("diffshade: ")
        assert self.err.count("\n") == 1
        assert self.err.rstrip().endswith((".", "?"))
        assert "Traceback" not in self.err
        return self.err


@pytest.fixture
def typed(capfd, tmp_path, monkeypatch):
    """Run a command line in an empty folder, in this process."""
    monkeypatch.chdir(tmp_path)

    def run(*words: object) -> Outcome:
        capfd.readouterr()
        with pytest.raises(SystemExit) as end:
            main([str(word) for word in words])
        out, err = capfd.readouterr()
        assert isinstance(end.value.code, int)
        return Outcome(end.value.code, out, err)

    return run


def in_its_own_process(*words: object, **options) -> subprocess.CompletedProcess:
    return subprocess.run([*PROGRAM, *map(str, words)], capture_output=True, text=True, check=False, **options)


def write_scene(path: Path, lights: Sequence[tuple[float, float, float]] = LIGHTS) -> ds.Scene:
    ball = ds.Object(ds.Sphere(), ds.Material(k_a=0.05, k_d=(0.6, 0.3, 0.2), k_s=0.5, n_s=30))
    scene = ds.Scene(ball, [ds.PointLight(place, intensity=0.5) for place in lights])
    ds.write_scene(path, scene, camera=ds.Camera(eye=(0, 0, 4), fov=35, shape=(SIZE, SIZE)))
    return scene


@pytest.fixture
def photographed(tmp_path) -> list[str]:
    """A scene file and three photographs, each under one of its lights; their names, as they are typed."""
    scene = write_scene(tmp_path / "ball.toml")
    camera, noise = ds.read_camera(tmp_path / "ball.toml"), np.random.default_rng(0)
    for i in range(3):
        image = np.asarray(ds.render(scene, camera, lit=i))
        ds.write_image(tmp_path / f"{i}.exr", image + 0.003 * noise.standard_normal(image.shape))
    return ["ball.toml", "0.exr", "1.exr", "2.exr"]


@pytest.fixture
def folder(tmp_path) -> Path:
    """A folder of eight photographs of a ball under distant lights, with its normals."""
    folder = tmp_path / "photographs"
    folder.mkdir()
    y, x = np.mgrid[1:-1:32j, -1:1:32j] * 1.05
    z2 = 1.0 - x**2 - y**2
    normals = np.stack([x, y, np.sqrt(np.maximum(z2, 0.0))], -1)
    around = np.deg2rad(45.0 * np.arange(8))
    towards = np.stack([0.6 * np.cos(around), 0.6 * np.sin(around), np.full(8, 0.8)], -1)
    lights = [ds.DirectionalLight(-l) for l in towards]
    gbuffer = ds.GBuffer(np.where((z2 > 0)[..., None], normals, (0.0, 0.0, 1.0)), mask=z2 > 0.0)
    scene = ds.Scene(ds.Object(gbuffer, ds.Material(k_a=0.0, k_d=(0.4, 0.3, 0.2), k_s=0.3, n_s=20)), lights)
    camera, noise = ds.OrthographicCamera((0, 0, 1), shape=(32, 32), local_viewer=False), np.random.default_rng(0)
    for i in range(8):
        image = np.asarray(ds.render(scene, camera, lit=i))
        ds.write_image(folder / f"{i}.exr", image + 0.002 * noise.standard_normal(image.shape))
    ds.write_image(folder / "mask.png", (z2 > 0)[..., None] * 1.0, srgb=False)
    np.save(folder / "normal_gt.npy", normals)
    (folder / "filenames.txt").write_text("\n".join(f"{i}.exr" for i in range(8)))
    np.savetxt(folder / "light_directions.txt", towards)
    np.savetxt(folder / "light_intensities.txt", np.ones((8, 3)))
    return folder


def values(found: dict) -> dict[str, float]:
    return {parameter["name"]: parameter["value"] for parameter in found["parameters"]}


@pytest.mark.parametrize("command", ["", *COMMANDS])
def test_help_fits_a_screen_and_has_an_example(typed, command):
    done = typed(*command.split(), "--help")
    assert done.status == 0
    lines = done.out.splitlines()
    assert len(lines) <= 24
    assert max(map(len, lines)) <= 80
    assert re.search(rf"^ *Example: diffshade {command}", done.out, re.MULTILINE)


@pytest.mark.parametrize("command", COMMANDS)
def test_the_example_of_the_help_is_what_the_command_takes(command):
    """Every option of an example is one, and there are as many words as arguments."""
    epilog = diffshade.commands[command].epilog
    assert epilog
    words = epilog.split()[3:]
    context = diffshade.commands[command].make_context(command, words, resilient_parsing=False)
    assert context.params


def test_help_and_completion_answer_without_jax():
    program = "import sys; from diffshade.cli import main\ntry: main(['fit', '--help'])\nexcept SystemExit: pass\n"
    done = subprocess.run(
        [sys.executable, "-c", program + "print('jax' in sys.modules)"], capture_output=True, text=True, check=True
    )
    assert done.stdout.endswith("False\n")


def completed(words: str) -> list[str]:
    environment = {"_DIFFSHADE_COMPLETE": "bash_complete", "COMP_WORDS": words, "COMP_CWORD": str(words.count(" "))}
    done = subprocess.run(
        [sys.executable, "-c", "import sys; sys.argv[0] = 'diffshade'; from diffshade.cli import main; main()"],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | environment,
    )
    return [line.partition(",")[2] for line in done.stdout.splitlines()]


def test_the_shell_completes():
    assert completed("diffshade re") == ["render", "report"]
    assert completed("diffshade new x.toml --material em") == ["emerald"]
    assert completed("diffshade fit ball.toml --loss ge") == ["geman-mcclure"]
    assert "--checkpoint" in completed("diffshade fit --ch")


def test_a_new_scene_renders(typed, tmp_path):
    assert typed("new", "ball.toml").status == 0
    assert "#" in Path("ball.toml").read_text()
    done = typed("render", "ball.toml", "--size", "48x32", "--json")
    assert done.status == 0
    told = json.loads(done.out)
    assert told["shape"] == [32, 48, 3]
    assert ds.read_image("ball.png").shape == (32, 48, 3)
    before = Path("ball.toml").read_bytes()
    assert "ball.toml is there already" in typed("new", "ball.toml", "--material", "gold").refusal
    assert Path("ball.toml").read_bytes() == before
    assert typed("new", "ball.toml", "--material", "gold", "--force").status == 0
    assert ds.read_scene("ball.toml").objects[0].material.n_s == ds.material("gold").n_s


def test_a_render_is_the_librarys(typed, photographed):
    done = typed("render", "ball.toml", "--lit", "0,2", "--exposure", "0.5", "-o", "out.exr")
    assert done.status == 0
    assert done.err == ""
    scene, camera = ds.read_scene("ball.toml"), ds.read_camera("ball.toml")
    expected = 0.5 * np.asarray(ds.render(scene, camera, lit=(0, 2)))
    assert np.allclose(ds.read_image("out.exr"), expected, atol=1e-6)


def test_a_fit_prints_its_table_and_writes_scene_and_materials(typed, photographed):
    done = typed("fit", *photographed, "-o", "fitted.toml", "-o", "ball.mtl", "-o", "ball.json")
    assert done.status == 0
    assert done.err == ""  # no progress where nobody looks
    assert "n_s" in done.out
    told = json.loads(typed("fit", *photographed, "--json").out)
    assert values(told)["n_s"] == pytest.approx(30, rel=0.1)
    assert values(told)["k_d.r"] == pytest.approx(0.6, rel=0.05)
    assert told["photographs"] == photographed[1:]
    fitted = ds.read_scene("fitted.toml").objects[0].material
    assert fitted.n_s == pytest.approx(values(told)["n_s"])
    assert len(ds.read_scene("fitted.toml").lights) == 3
    assert np.allclose(ds.read_material("ball.mtl").k_d, fitted.k_d)
    assert typed("render", "fitted.toml").status == 0


def test_what_is_said_of_a_fit_changes_it(typed, photographed):
    options = [
        "--free",
        "k_d,k_s,n_s",
        "--grey",
        "k_s",
        "--bounds",
        "n_s=0.1:10",
        "--noise",
        "0.003",
        "--lobe",
        "blinn",
    ]
    told = json.loads(typed("fit", *photographed, *options, "--json").out)
    found = values(told)
    assert found["n_s"] == 10
    assert "k_s" in found
    assert "k_s.r" not in found
    assert "k_a.r" not in found
    assert told["rmse"] > 1  # in units of the noise
    ds.write_image("half.png", np.repeat(np.arange(SIZE)[:, None] < SIZE // 2, SIZE, 1)[..., None] * 1.0, srgb=False)
    masked = json.loads(typed("fit", *photographed, "--mask", "half.png", "--json").out)
    assert masked["pixels"] < 0.6 * told["pixels"]


def test_lights_of_each_photograph(typed, photographed):
    scene, camera = ds.read_scene("ball.toml"), ds.read_camera("ball.toml")
    ds.write_image("both.exr", np.asarray(ds.render(scene, camera, lit=(0, 1))))
    told = json.loads(typed("fit", "ball.toml", "2.exr", "both.exr", "--lit", "2,0+1", "--json").out)
    assert values(told)["n_s"] == pytest.approx(30, rel=0.1)


def test_a_folder_of_photographs_to_a_page_and_materials(typed, folder):
    done = typed("report", folder, "-o", "ball.html")
    assert done.status == 0, done.err
    page = Path("ball.html").read_text(encoding="utf-8")
    assert "<h1>Fit of 8 photographs</h1>" in page
    assert "degrees off" in page  # the next photograph
    assert "blinn" in page  # which model
    done = typed("fit", folder, "-o", "ball.mtl", "-o", "ball.js", "-o", "ball.toml")
    assert done.status == 0
    assert ds.read_material("ball.toml").n_s == pytest.approx(20, rel=0.1)
    assert Path("ball.js").is_file()


def test_models_are_compared(typed, folder):
    told = json.loads(typed("compare", folder, "--model", "phong,matte", "--json").out)
    assert told["best"] == "phong"
    assert told["choice"]["names"] == ["phong", "matte"]
    assert "no model is named 'fong'" in typed("compare", folder, "--model", "fong,matte").refusal
    assert "two or more" in typed("compare", folder, "--model", "matte").refusal


def test_a_matte_model_takes_what_is_said_of_the_highlight_away(typed, folder):
    words = ["--grey", "k_s", "--bounds", "n_s=1:100", "--model", "phong,matte", "--json"]
    assert json.loads(typed("compare", folder, *words).out)["best"] == "phong"


def test_a_page_and_its_json_agree(typed, photographed):
    told = json.loads(typed("report", *photographed, "-o", "ball.html", "--json").out)
    page = Path("ball.html").read_text(encoding="utf-8")
    for parameter in told["parameters"]:
        low, high = parameter["95%"]
        assert low <= parameter["value"] <= high
        assert parameter["name"] in page
    assert told["page"] == "ball.html"


def test_the_next_photograph(typed, photographed):
    told = json.loads(typed("plan", *photographed, "--aim", "n_s", "--lights", "ball.toml", "--json").out)
    assert len(told["order"]) == 3
    assert told["order"][0].startswith("light at ")
    now, best = (dict(zip(told["unknowns"], row, strict=True)) for row in (told["now"], told["errors"][0]))
    assert best["objects.0.material.n_s"] < now["objects.0.material.n_s"] if "objects.0.material.n_s" in now else True
    assert told["errors"][0] < told["now"] or told["gain"][0] > 0


def test_the_dome_surrounds_what_the_camera_sees(photographed, tmp_path):
    scene, camera = ds.read_scene(tmp_path / "ball.toml"), ds.read_camera(tmp_path / "ball.toml")
    views = [ds.View(ds.read_image(tmp_path / f"{i}.exr"), camera, lit=i) for i in range(3)]
    shots = dome(ds.fit(scene, views, free=("k_d",)))
    assert len(shots) == len({shot.name for shot in shots}) == 27
    places = np.array([shot.light.position for shot in shots if isinstance(shot.light, ds.PointLight)])
    assert len(places) == 27
    assert (places[:, 2] > 0).all()  # none behind the ball
    assert np.abs(places[:, :2].sum(0)).max() < 0.2 * np.abs(places).max()


def test_texels(typed, folder):
    (folder / "normal_gt.npy").unlink()
    done = typed("texels", folder, "-o", "maps", "--suffix", ".png", "--json")
    assert done.status == 0
    told = json.loads(done.out)
    assert told["status"]["determined"] > 100
    assert told["medians"]["k_d"] == pytest.approx([0.4, 0.3, 0.2], rel=0.05)
    assert Path("maps/k_d.npy").is_file()
    assert Path("maps/k_d.png").is_file()
    assert told["medians"]["normal"][2] > 0.5  # of which no file told
    assert told["medians"]["n_s"][0] == pytest.approx(20, rel=0.2)  # where a highlight was seen


def test_materials_are_converted(typed):
    ds.write_material("gold.mtl", ds.material("gold"), name="gold")
    done = typed("convert", "gold.mtl", "gold.c", "gold.toml", "gold.gltf", "--name", "gold")
    assert done.status == 0
    assert "gold.gltf: the highlight" in done.out
    assert np.allclose(ds.read_material("gold.toml").k_s, ds.material("gold").k_s)
    assert np.allclose(ds.read_material("gold.c").k_s, ds.material("gold").k_s)


def test_nothing_is_written_where_one_of_several_cannot_be(typed):
    ds.write_material("gold.mtl", ds.material("gold"), name="gold")
    assert "'.foo'" in typed("convert", "gold.mtl", "gold.c", "gold.foo").refusal
    assert "no folder" in typed("convert", "gold.mtl", "gold.c", "nowhere/gold.c").refusal
    assert "gold.mtl is what is read" in typed("convert", "gold.mtl", "gold.mtl").refusal
    assert [path.name for path in Path.cwd().iterdir()] == ["gold.mtl"]


def test_figures(typed):
    done = typed("figures", "lecture", "--only", "snell")
    assert done.status == 0
    assert done.out.split() == [str(Path("lecture/19_snell.png"))]
    assert Path("lecture/19_snell.png").is_file()


def spoil(text: str, old: str, new: str) -> str:
    assert old in text
    return text.replace(old, new, 1)


BAD = {
    # what is wrong, what is typed, and what the sentence must hold
    "a scene that is missing": (["render", "nowhere.toml"], "there is no scene file nowhere.toml"),
    "a photograph that is missing": (["fit", "ball.toml", "nowhere.png"], "there is no file nowhere.png"),
    "image and camera of different size": (
        ["fit", "ball.toml", "small.exr"],
        "small.exr: View.image must have the camera",
    ),
    "a pixel that is not a number": (["fit", "ball.toml", "nan.npy"], "nan.npy: the image must be finite"),
    "an unknown parameter": (["fit", "ball.toml", "0.exr", "--lit", "0", "--free", "kd"], "Did you mean 'k_d'?"),
    "all pixels masked": (["fit", "ball.toml", "0.exr", "--lit", "0", "--mask", "black.png"], "0.exr: no pixel"),
    "fewer photographs than lights": (["fit", "ball.toml", "0.exr", "1.exr"], "2 photographs, each under one light"),
    "a light that is not there": (["fit", "ball.toml", "0.exr", "--lit", "7"], "0.exr: lit must hold indices"),
    "a PNG that is cut off": (["fit", "ball.toml", "cut.png", "--lit", "0"], "cut.png"),
    "a negative n_s": (["render", "negative.toml"], "Material.n_s must be at least 0"),
    "a misspelt key": (["render", "misspelt.toml"], "has no key 'backgrund'. Did you mean 'background'?"),
    "no photographs": (["fit", "ball.toml"], "ball.toml needs photographs"),
    "no source": (["fit", "nowhere"], "nowhere is not there"),
    "a page of another kind": (["report", "ball.toml", "0.exr", "--lit", "0", "-o", "page.pdf"], "Use .html."),
    "a folder that is missing": (["render", "ball.toml", "-o", "nowhere/ball.exr"], "there is no folder"),
    "noise of nothing": (["fit", "ball.toml", "0.exr", "--lit", "0", "--noise", "0"], "--noise must be above 0"),
    "no memory": (["fit", "ball.toml", "0.exr", "--lit", "0", "--memory", "0"], "--memory must be above 0"),
    "a photograph for a scene": (["fit", "0.exr", "1.exr"], "0.exr is neither"),
    "a picture larger than any": (["render", "ball.toml", "--size", "100000x100000"], "10,000,000,000 pixels"),
    "an exposure below 0": (["render", "ball.toml", "--exposure", "-1"], "--exposure must be above 0"),
    "an exposure that is not finite": (["render", "ball.toml", "--exposure", "inf"], "--exposure must be above 0"),
    "bits that no PNG has": (["render", "ball.toml", "--bits", "9"], "9"),
    "the scene for the picture": (["fit", "ball.toml", "0.exr", "--lit", "0", "-o", "ball.toml"], "is what is read"),
    "nothing free": (["fit", "ball.toml", "0.exr", "--free", ","], "names are typed with commas"),
    "the photographs' own folder": (["calibrate", ".", "--ball", "matte", "-o", "."], "holds other files"),
    "a file for a folder": (["calibrate", "0.exr", "--ball", "matte", "-o", "1.exr"], "1.exr"),
    "a group for a matte model": (
        ["compare", "ball.toml", "0.exr", "--lit", "0", "--model", "phong,matte", "--free", "material"],
        "got --free material",
    ),
    "nothing for a matte model": (
        ["compare", "ball.toml", "0.exr", "--lit", "0", "--model", "phong,matte", "--free", "n_s"],
        "nothing free but k_s and n_s",
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


@pytest.mark.parametrize("name", BAD)
def test_bad_input_is_one_sentence_and_a_status(typed, photographed, tmp_path, name):
    words, message = BAD[name]
    text = Path("ball.toml").read_text()
    Path("negative.toml").write_text(re.sub(r"n_s = .*", "n_s = -1.0", text))
    Path("misspelt.toml").write_text(spoil(text, "background", "backgrund"))
    image = ds.read_image("0.exr")
    ds.write_image("small.exr", image[1:])
    broken = image.copy()
    broken[20, 17, 1] = np.nan
    np.save("nan.npy", broken)
    ds.write_image("black.png", np.zeros((SIZE, SIZE, 1)))
    ds.write_image("cut.png", np.clip(image, 0.0, 1.0))
    Path("cut.png").write_bytes(Path("cut.png").read_bytes()[:300])
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    if "--lit" not in words and name in ("image and camera of different size", "a pixel that is not a number"):
        words = [*words, "--lit", "0"]
    assert message in typed(*words).refusal
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


def test_a_damaged_photograph_names_its_pixel(typed, photographed):
    broken = ds.read_image("0.exr")
    broken[20, 17, 1] = np.nan
    np.save("nan.npy", broken)
    refusal = typed("fit", "ball.toml", "nan.npy", "--lit", "0").refusal
    assert "nan.npy" in refusal
    assert "row 20, column 17" in refusal


@pytest.mark.skipif(os.name == "nt", reason="there are no such signals on Windows.")
def test_ctrl_c_leaves_no_half_written_file(tmp_path):
    (tmp_path / "lecture").mkdir()
    with subprocess.Popen(
        [*PROGRAM, "figures", "lecture"], cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as running:
        while running.poll() is None and not list((tmp_path / "lecture").glob("[0-9]*.png")):  # at work
            time.sleep(0.05)
        running.send_signal(signal.SIGINT)
        out, err = running.communicate(timeout=120)
    assert running.returncode == 130
    assert out == ""
    assert err.lstrip("\n") == "diffshade: stopped; what was being written is as it was before.\n"
    left = list((tmp_path / "lecture").iterdir())
    assert 0 < len(left) < 24
    for path in left:
        assert re.fullmatch(r"\d\d_\w+\.png", path.name)
        assert ds.read_image(path).size


def test_it_ends_quietly_where_nobody_reads_on(tmp_path):
    command = " ".join(PROGRAM) + " --help | head -1; echo ${PIPESTATUS[0]}"
    shut = subprocess.run(
        ["bash", "-c", " ".join(PROGRAM) + " new ball.toml | true; exit ${PIPESTATUS[0]}"],
        capture_output=True,
        check=False,
        cwd=tmp_path,
    )
    assert (shut.returncode, shut.stderr) == (0, b"")
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=True, cwd=tmp_path)
    assert done.stdout.splitlines() == ["Usage: diffshade [OPTIONS] COMMAND [ARGS]...", "0"]
    assert done.stderr == ""


def test_without_a_command_it_shows_its_help():
    done = in_its_own_process()
    assert done.returncode == 0
    assert "Commands:" in done.stdout
    version = in_its_own_process("--version")
    assert re.fullmatch(r"diffshade, version \d+\.\d+\.\d+\n", version.stdout)


def test_from_photographs_of_a_ball_alone_to_a_page_and_materials(typed, tmp_path):
    """A folder of photographs, and nothing known but that it is a ball: the README's commands."""
    ball = ds.Object(ds.Sphere(), ds.Material(k_d=(0.5, 0.4, 0.3), k_s=0.2, n_s=15))
    camera = ds.OrthographicCamera((0, 0, 4), shape=(48, 48), local_viewer=False)
    around = np.deg2rad(120.0 * np.arange(3))
    towards = np.stack([0.5 * np.cos(around), 0.5 * np.sin(around), np.full(3, np.sqrt(0.75))], -1)
    scene = ds.Scene(ball, [ds.DirectionalLight(-l) for l in towards], ambient=0.0)
    (tmp_path / "photographs").mkdir()
    noise = np.random.default_rng(0)
    for i in range(3):
        image = np.asarray(ds.render(scene, camera, lit=i))
        ds.write_image(tmp_path / "photographs" / f"{i}.exr", image + 0.002 * noise.standard_normal(image.shape))
    done = typed("calibrate", "photographs", "--ball", "glossy", "-o", "ready", "--json")
    assert done.status == 0, done.err
    told = json.loads(done.out)
    cosines = np.sum(np.array(told["directions"]) * towards, -1)
    assert np.rad2deg(np.arccos(np.minimum(cosines, 1.0))).max() < 1.0
    assert typed("report", "ready", "--quick", "-o", "ball.html").status == 0
    assert typed("fit", "ready", "-o", "ball.mtl", "-o", "ball.json").status == 0
    assert Path("ball.html").is_file()
    assert ds.read_material("ball.mtl").k_d == pytest.approx([0.5, 0.4, 0.3], rel=0.05)


def test_a_balls_lights_are_compared_with_a_list(typed, folder):
    np.savetxt("list.txt", np.loadtxt(folder / "light_directions.txt"))
    told = json.loads(typed("calibrate", folder, "--ball", "matte", "--against", "list.txt", "--json").out)
    assert max(told["against"]["degrees"]) < 10
    known = json.loads(typed("calibrate", folder, "--ball", "matte", "--directions", "list.txt", "--json").out)
    assert np.allclose(known["directions"], np.loadtxt("list.txt"), atol=1e-6)
    assert "Did you mean 'mirror'?" in typed("calibrate", folder, "--ball", "miror").refusal
    assert (
        "there is no file nowhere.txt"
        in typed("calibrate", folder, "--ball", "matte", "--directions", "nowhere.txt").refusal
    )
