"""The README's programs, run in order as they stand there, but for the size of the pictures."""

import re
from pathlib import Path
from typing import Any

import numpy as np
from textured import lights_about, textured_ball

import diffshade as ds

README = Path(__file__).parents[1] / "README.md"
TEXT = README.read_text(encoding="utf-8").replace("shape=(256, 256)", "shape=(48, 48)")
PROGRAMS = re.findall(r"^```python\n(.*?)^```", TEXT, re.MULTILINE | re.DOTALL)


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


def test_they_run_one_after_the_other(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert len(PROGRAMS) >= 4
    names: dict[str, Any] = {"photographs": ["0.exr", "1.exr"]}
    exec(PROGRAMS[0], names)
    scene, camera = names["scene"], names["camera"]
    random = np.random.default_rng(0)
    for i, path in enumerate(names["photographs"]):
        image = np.asarray(ds.render(scene, camera, lit=i))  # pyright: ignore[reportArgumentType]
        noisy = image + 0.002 * random.standard_normal(image.shape)
        ds.write_image(path, noisy)
        np.save(f"{i}.npy", noisy)
    names["folder"] = unknown_shape(tmp_path / "ball")
    balls_under_lights(tmp_path)
    exec(PROGRAMS[1], names)
    exec(PROGRAMS[2], names)
    fit = names["fit"]
    assert isinstance(fit, ds.Fit)
    assert fit.determined.all()
    off = (fit.values - fit.values_in(scene)) / fit.plain_errors  # pyright: ignore[reportArgumentType]
    assert np.abs(off).max() < 5
    for program in PROGRAMS[3:]:
        exec(program, names)
    assert names["fit"].converged  # pyright: ignore[reportAttributeAccessIssue]
    assert Path("sphere.png").is_file()
    assert Path("comparison.png").is_file()
