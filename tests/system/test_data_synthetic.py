"""The committed targets are what the generator writes today, and the truth beside them is what a fit finds."""

import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest

import diffshade as ds

HERE = Path(__file__).parents[2] / "data_synthetic"
SCENES = sorted(path.stem for path in (HERE / "scenes").glob("*.toml"))


@pytest.fixture(scope="module")
def again(tmp_path_factory):
    out = tmp_path_factory.mktemp("targets")
    command = [sys.executable, "-W", "error", HERE / "generate.py", "--out", out]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return out


def test_the_set_is_small():
    sizes = [path.stat().st_size for path in (HERE / "targets").rglob("*") if path.is_file()]
    assert len(SCENES) == 3
    assert sum(sizes) < 2_000_000


@pytest.mark.parametrize("name", SCENES)
def test_a_target_is_what_the_library_renders(name):
    folder = HERE / "targets" / name
    with jax.enable_x64(True):
        image = np.asarray(
            ds.render(ds.read_scene(folder / "truth.toml"), ds.read_camera(folder / "truth.toml"), lit=2)
        )
    np.testing.assert_allclose(image, ds.read_image(folder / "clean_2.exr"), atol=2e-6)


@pytest.mark.thorough
@pytest.mark.parametrize("name", SCENES)
def test_rendering_again_gives_the_same_targets(again, name):
    committed = sorted(path.name for path in (HERE / "targets" / name).iterdir())
    assert committed == sorted(path.name for path in (again / name).iterdir())
    assert (again / name / "truth.toml").read_text() == (HERE / "targets" / name / "truth.toml").read_text()
    for file in (file for file in committed if not file.endswith("toml")):
        old, new = ds.read_image(HERE / "targets" / name / file), ds.read_image(again / name / file)
        # another processor may round the last bit of a float32, and so a level of 8 bits, the other way
        np.testing.assert_allclose(new, old, atol=2e-6 if file.endswith("exr") else 0.009, err_msg=file)


KINDS = {"clean": "exr", "noisy": "exr", "photo": "png"}


@pytest.mark.thorough
@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("kind", KINDS)
def test_a_fit_finds_the_truth(name, kind):
    folder = HERE / "targets" / name
    scene, camera = ds.read_scene(folder / "truth.toml"), ds.read_camera(folder / "truth.toml")
    views = [ds.View(ds.read_image(folder / f"{kind}_{i}.{KINDS[kind]}"), camera, lit=(i,)) for i in range(3)]
    fit = ds.fit(scene, views, free=("k_a", "k_d", "k_s", "n_s", "attenuation"), tied=("attenuation",))
    truth = fit.values_in(scene)
    if kind == "clean":
        np.testing.assert_allclose(fit.values, truth, rtol=2e-7)  # float32 files
    else:
        assert np.abs((fit.values - truth) / fit.plain_errors).max() < 4.0
    # brass is so bright that its photographs clip, and the clipped samples are left out
    assert (fit.counts.clipped > 100) == (kind == "photo" and name == "brass")
