"""The README's programs, run in order as they stand there, but for the size of the pictures."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from textured import lights_about, textured_ball

import diffshade as ds
from diffshade.cli import diffshade

README = Path(__file__).parents[2] / "README.md"
TEXT = README.read_text(encoding="utf-8").replace("(256, 256", "(48, 48")
PROGRAMS = re.findall(r"^```python\n(.*?)^```", TEXT, re.MULTILINE | re.DOTALL)
FIRST_FIT = next(i for i, program in enumerate(PROGRAMS) if "photographs" in program)
COMMANDS = re.findall(r"^diffshade (.+)$", TEXT, re.MULTILINE)


def unknown_shape(folder: Path) -> Path:
    """Write a folder of photographs of a ball, one a light, in the layout of DiLiGenT."""
    ball = textured_ball(size=24, lights=8)
    folder.mkdir()
    names = [f"{i}.exr" for i in range(8)]
    for name, view in zip(names, ball.views, strict=True):
        ds.write_image(folder / name, view.image)
    ds.write_image(folder / "mask.png", ball.mask[..., None] * 1.0, srgb=False)
    (folder / "filenames.txt").write_text("\n".join(names))
    np.savetxt(folder / "light_directions.txt", lights_about(8))
    np.savetxt(folder / "light_intensities.txt", np.ones((8, 3)))
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
    assert re.findall(r"^\| `diffshade (\w+)`", TEXT, re.MULTILINE) == list(diffshade.commands)


@pytest.mark.thorough
def test_they_run_one_after_the_other(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert len(PROGRAMS) >= 4
    names: dict[str, Any] = {"photographs": ["0.exr", "1.exr"]}
    for program in PROGRAMS[:FIRST_FIT]:
        exec(program, names)
    assert np.isfinite(names["value"])
    scene, camera = names["scene"], names["camera"]
    random = np.random.default_rng(0)
    for i, path in enumerate(names["photographs"]):
        image = np.asarray(ds.render(scene, camera, lit=i))  # pyright: ignore[reportArgumentType]
        noisy = image + 0.002 * random.standard_normal(image.shape)
        ds.write_image(path, noisy)
        np.save(f"{i}.npy", noisy)
    names["folder"] = unknown_shape(tmp_path / "ball")
    balls_under_lights(tmp_path)
    exec(PROGRAMS[FIRST_FIT], names)
    exec(PROGRAMS[FIRST_FIT + 1], names)
    fit = names["fit"]
    assert isinstance(fit, ds.Fit)
    assert fit.determined.all()
    off = (fit.values - fit.values_in(scene)) / fit.plain_errors  # pyright: ignore[reportArgumentType]
    assert np.abs(off).max() < 5
    for program in PROGRAMS[FIRST_FIT + 2 :]:
        exec(program, names)
    assert names["fit"].converged  # pyright: ignore[reportAttributeAccessIssue]
    assert Path("sphere.png").is_file()
    assert Path("comparison.png").is_file()
