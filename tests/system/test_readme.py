"""The programs of the README and of the documentation's pages, run in order as written, with smaller pictures."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from small_blocks import small_blocks  # noqa: F401
from textured import lights_about, textured_ball

import diffshade as ds
from diffshade.cli.commands import diffshade

ROOT = Path(__file__).parents[2]
README = ROOT / "README.md"
PAGES = ROOT / "docs" / "pages"
# the pages with programs, in an order in which each finds the names that the ones before it define
ORDER = (
    "objective",
    "render",
    "fit",
    "trust",
    "calibration",
    "texels",
    "heights",
    "large-images",
    "exchange",
    "extend",
)


# programs of half a minute or more, by page and number: what they call is in fits/, and they run here in the slow tier
LONG = {("objective", 1), ("objective", 2), ("fit", 1), ("trust", 1), ("calibration", 1), ("calibration", 2)}


def blocks(page: Path, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)


def programs(page: Path) -> list[str]:
    return blocks(page, "python")


def run(page: Path, names: dict[str, Any], *, every: bool) -> None:
    for i, program in enumerate(programs(page)):
        if every or (page.stem, i) not in LONG:
            exec(program.replace("(256, 256", "(48, 48"), names)


COMMANDS = [
    command
    for page in sorted(PAGES.glob("*.md"))
    for command in re.findall(r"^diffshade (.+)$", "".join(blocks(page, "sh")), re.MULTILINE)
]


def unknown_shape(folder: Path) -> Path:
    """Write a folder of photographs of a ball, one a light, in the layout of DiLiGenT."""
    ball = textured_ball(size=16, lights=12)
    folder.mkdir()
    names = [f"{i}.exr" for i in range(12)]
    for name, view in zip(names, ball.views, strict=True):
        ds.write_image(folder / name, view.image)
    ds.write_image(folder / "mask.png", ball.mask[..., None] * 1.0, srgb=False)
    (folder / "filenames.txt").write_text("\n".join(names))
    np.savetxt(folder / "light_directions.txt", lights_about(12))
    np.savetxt(folder / "light_intensities.txt", np.ones((12, 3)))
    return folder


def balls_under_lights(folder: Path) -> None:
    """Write photographs of a mirror ball and of another one, under the same three lights, and their masks."""
    camera = ds.OrthographicCamera((0, 0, 4), height=2.4, shape=(72, 72), local_viewer=False)
    lights = [ds.DirectionalLight(-l) for l in lights_about(3)]
    materials = {"chrome": ds.Material(k_s=1.0, n_s=300), "gray": ds.Material(k_a=0.02, k_d=0.5, k_s=0.3, n_s=20)}
    for name, material in materials.items():
        (folder / name).mkdir()
        scene = ds.Scene(ds.Object(ds.Sphere(), material), lights)
        for i in range(3):
            ds.write_image(folder / name / f"{i}.exr", np.asarray(ds.render(scene, camera, lit=i)))
        ds.write_image(folder / name / "mask.png", np.asarray(ds.intersect(scene, camera).mask) * 1.0, srgb=False)


@pytest.mark.parametrize("command", COMMANDS)
def test_the_commands_are_what_the_command_line_takes(command):
    """What they do is in test_cli.py."""
    name, *words = command.split()
    assert diffshade.commands[name].make_context(name, words).params


def test_the_table_names_every_command():
    table = (PAGES / "command-line.md").read_text(encoding="utf-8")
    assert re.findall(r"^\| `diffshade ([\w-]+)`", table, re.MULTILINE) == list(diffshade.commands)


def test_the_readme_is_short():
    assert len(README.read_text(encoding="utf-8").splitlines()) <= 120


def test_a_program_stands_on_no_page_that_is_not_run():
    assert sorted(page.stem for page in PAGES.glob("*.md") if programs(page)) == sorted(ORDER)


@pytest.mark.thorough
def test_the_table_is_what_the_program_prints(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    for program in programs(README):
        exec(program, names)
    (shown,) = blocks(README, "text")
    printed = capsys.readouterr().out
    number = r"\d[\d,]*(?:\.\d+)?(?:e[-+]?\d+)?"
    assert re.sub(number, "0", printed).split() == re.sub(number, "0", shown).split()
    fit = names["fit"]
    rows = dict(re.findall(r"^([\w.]+) +([\d.]+) +[-\d.e]+$", shown, re.MULTILINE))
    assert tuple(rows) == fit.names
    np.testing.assert_array_less(np.abs(fit.values - [float(value) for value in rows.values()]), 0.1 * fit.errors)
    (steps,) = re.findall(r"steps (\d+)", shown)
    assert abs(fit.steps - int(steps)) <= 1  # the last one may be within rounding
    alone = ds.fit(names["scene"], names["views"][:1], free=("k_a", "k_d", "k_s", "n_s", "attenuation"))
    undetermined = {name for name, known in zip(alone.names, alone.determined, strict=True) if not known}
    assert undetermined == {"k_d.r", "k_d.g", "k_d.b", "k_s.r", "k_s.g", "k_s.b", "linear", "quadratic"}


@pytest.mark.thorough
@pytest.mark.parametrize("every", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_they_run_one_after_the_other(every, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    run(README, names, every=every)
    scene, camera = names["scene"], names["camera"]
    names["photographs"] = ["0.exr", "1.exr"]
    random = np.random.default_rng(0)
    for i, path in enumerate(names["photographs"]):
        image = np.asarray(ds.render(scene, camera, lit=i))
        noisy = image + 0.002 * random.standard_normal(image.shape)
        ds.write_image(path, noisy)
        np.save(f"{i}.npy", noisy)
    names["folder"] = unknown_shape(tmp_path / "ball")
    balls_under_lights(tmp_path)
    (tmp_path / "coin.ptm").write_bytes(
        b"PTM_1.2\nPTM_FORMAT_LRGB\n8\n8\n1 1 1 1 1 1\n0 0 0 0 0 0\n" + bytes(64 * [9] * 9)
    )
    run(PAGES / "objective.md", names, every=every)
    assert np.isfinite(names["value"])
    for page in ORDER[1:]:
        run(PAGES / f"{page}.md", names, every=every)
        if page == "fit":
            fit = names["fit"]
            assert isinstance(fit, ds.Fit)
            assert fit.determined.all()
            off = (fit.values - fit.values_in(scene)) / fit.plain_errors
            assert np.abs(off).max() < 5
    assert names["fit"].converged
    assert Path("sphere.png").is_file()
    assert Path("comparison.png").is_file()
