"""The README's programs, run in order as they stand there, but for the size of the pictures."""

import re
from pathlib import Path

import numpy as np

import diffshade as ds

README = Path(__file__).parents[1] / "README.md"
TEXT = README.read_text(encoding="utf-8").replace("shape=(256, 256)", "shape=(48, 48)")
PROGRAMS = re.findall(r"^```python\n(.*?)^```", TEXT, re.MULTILINE | re.DOTALL)


def test_they_run_one_after_the_other(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert len(PROGRAMS) >= 4
    names = {"photographs": ["0.exr", "1.exr"]}
    exec(PROGRAMS[0], names)
    scene, camera = names["scene"], names["camera"]
    random = np.random.default_rng(0)
    for i, path in enumerate(names["photographs"]):
        image = np.asarray(ds.render(scene, camera, lit=i))  # pyright: ignore[reportArgumentType]
        noisy = image + 0.002 * random.standard_normal(image.shape)
        ds.write_image(path, noisy)
        np.save(f"{i}.npy", noisy)
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
