"""The command `diffshade` from photographs to a page, maps and materials, and in processes of its own."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from folders import ball_under_distant_lights
from small_blocks import small_blocks  # noqa: F401

import diffshade as ds
from diffshade.cli import main

PROGRAM = (sys.executable, "-m", "diffshade")


@pytest.fixture
def typed(capfd, tmp_path, monkeypatch):
    """Run a command line in an empty folder, in this process; return what it printed."""
    monkeypatch.chdir(tmp_path)

    def run(*words: object) -> str:
        capfd.readouterr()
        with pytest.raises(SystemExit) as end:
            main([str(word) for word in words])
        out, err = capfd.readouterr()
        assert end.value.code == 0, err
        return out

    return run


@pytest.fixture
def folder(tmp_path) -> Path:
    return ball_under_distant_lights(tmp_path / "photographs", 32)


def test_a_folder_of_photographs_to_a_page_and_materials(typed, folder):
    told = json.loads(typed("report", folder, "-o", "ball.html", "--json"))
    page = Path("ball.html").read_text(encoding="utf-8")
    assert "<h1>Fit of 8 photographs</h1>" in page
    assert "degrees off" in page  # the next photograph
    assert "blinn" in page  # which model
    for parameter in told["parameters"]:
        low, high = parameter["95%"]
        assert low <= parameter["value"] <= high
        assert parameter["name"] in page
    typed("fit", folder, "-o", "ball.mtl", "-o", "ball.js", "-o", "ball.toml")
    assert ds.exchange.read_material("ball.toml").n_s == pytest.approx(20, rel=0.1)
    assert Path("ball.js").is_file()


@pytest.mark.slow
def test_texels(typed, folder):
    (folder / "normal_gt.npy").unlink()
    told = json.loads(typed("texels", folder, "-o", "maps", "--suffix", ".png", "--json"))
    assert told["status"]["determined"] > 100
    assert told["medians"]["k_d"] == pytest.approx([0.4, 0.3, 0.2], rel=0.05)
    assert Path("maps/k_d.npy").is_file()
    assert Path("maps/k_d.png").is_file()
    assert told["medians"]["normal"][2] > 0.5  # of which no file told
    assert any("the highlight is Blinn's" in note for note in told["notes"])
    assert told["medians"]["n_s"][0] / 4 == pytest.approx(20, rel=0.2)  # by Phong


def test_photographs_left_out_of_texels_are_predicted(typed, folder):
    told = json.loads(typed("texels", folder, "-o", "maps", "--hold-out", "4", "--json"))
    count = len(told["photographs"]) + len(told["left_out"])
    assert len(told["left_out"]) == count // 4
    assert not set(told["photographs"]) & set(told["left_out"])
    assert all(0.0 <= error < 0.2 for error in told["left_out"].values())
    assert "at most (" in typed("texels", folder, "-o", "more", "--hold-out", "4")


@pytest.mark.slow
def test_bands_of_photographs_left_out(typed, tmp_path):
    folder = ball_under_distant_lights(tmp_path / "twelve", 24, 12)
    for words in (("fit", folder), ("texels", folder, "-o", "maps", "--free", "k_d,k_s,n_s", "--bands")):
        told = json.loads(typed(*words, "--hold-out", "4", "--json"))["bands"]
        assert told["level"] == 0.9
        assert sorted(told["inside"]) == ["11.exr", "3.exr", "7.exr"]
        assert 0.8 < np.mean(list(told["inside"].values())) < 0.97
    said = typed("fit", folder, "--hold-out", "4", "-o", "ball.toml")
    assert re.search(r"from 9 photographs left out in 8 groups: they hold \d+% of those of the 3 photographs", said)
    assert Path("ball.toml").is_file()
    assert "% inside bands" in Path("maps/bands.html").read_text(encoding="utf-8")


def test_models_are_compared(typed, folder):
    """Of which matte has no highlight, whatever is said of it."""
    words = ["--grey", "k_s", "--bounds", "n_s=1:100", "--model", "phong,matte", "--json"]
    told = json.loads(typed("compare", folder, *words))
    assert told["best"] == "phong"
    assert told["choice"]["names"] == ["phong", "matte"]


@pytest.mark.slow
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
    told = json.loads(typed("calibrate", "photographs", "--ball", "glossy", "-o", "ready", "--json"))
    cosines = np.sum(np.array(told["directions"]) * towards, -1)
    assert np.rad2deg(np.arccos(np.minimum(cosines, 1.0))).max() < 1.0
    typed("report", "ready", "--quick", "-o", "ball.html")
    typed("fit", "ready", "-o", "ball.mtl", "-o", "ball.json")
    assert Path("ball.html").is_file()
    assert ds.exchange.read_material("ball.mtl").k_d == pytest.approx([0.5, 0.4, 0.3], rel=0.05)


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
    assert completed("diffshade re") == ["render", "report", "relight"]
    assert completed("diffshade new x.toml --material em") == ["emerald"]


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
