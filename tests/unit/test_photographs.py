"""A folder of photographs: read whole, and each thing that can be wrong with it said in one sentence."""

import shutil
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from measured import measured

import diffshade as ds


def test_the_ball_is_read_as_16_bits_with_lights_that_travel_away_from_where_they_are():
    folder = measured("diligent_ball")
    scene, views = ds.read_photographs(folder)
    assert len(views) == len(scene.lights) == 48
    levels = views[0].image * 65535
    np.testing.assert_allclose(levels, np.rint(levels), atol=1e-6)
    assert np.mean(np.rint(levels) % 257 != 0) > 0.9  # what was cut to 8 bits has only multiples of 257
    first = np.loadtxt(folder / "light_directions.txt")[0]
    assert isinstance(scene.lights[0], ds.DirectionalLight)
    np.testing.assert_allclose(scene.lights[0].direction, -first)
    assert views[3].lit == (3,)


def test_the_ball_has_the_diffuse_colour_that_others_found_and_is_predicted_where_held_out():
    scene, views = ds.read_photographs(measured("diligent_ball"))
    fit = ds.fit(scene, views[::2], free=("k_a", "k_d", "k_s", "n_s"))
    np.testing.assert_allclose(fit.material.k_d, (0.164, 0.138, 0.090), rtol=0.05)
    assert fit.counts.clipped > 300
    assert fit.errors is not None
    n_s = fit.names.index("n_s")
    assert fit.errors[n_s] > 10 * fit.plain_errors[n_s]  # photographs: the residuals are model error, not noise
    held_out = [fit.predict(view).rmse for view in views[1::2]]
    assert np.sqrt(np.mean(np.square(held_out))) < 0.012


@pytest.fixture
def folder(tmp_path):
    """A small folder in the layout of the benchmark: a hemisphere of 12 x 10 pixels under three lights."""
    row, column = np.mgrid[:10, :12]
    x, y = (column - 5.5) / 5, -(row - 4.5) / 5
    inside = x**2 + y**2 < 0.9
    normal = np.where(inside[..., None], np.stack([x, y, np.sqrt(np.maximum(1 - x**2 - y**2, 0))], -1), 0)
    to_light = np.array([[0, 0, 1], [0.6, 0, 0.8], [0, 0.6, 0.8]])
    for i, l in enumerate(to_light):
        ds.write_image(tmp_path / f"{i}.png", 0.5 * np.maximum(normal @ l, 0)[..., None] * np.ones(3), bits=16)
    (tmp_path / "filenames.txt").write_text("0.png\n1.png\n2.png\n")
    np.savetxt(tmp_path / "light_directions.txt", to_light)
    np.savetxt(tmp_path / "light_intensities.txt", np.ones((3, 3)))
    ds.write_image(tmp_path / "mask.png", inside * 1.0)
    np.save(tmp_path / "normal_gt.npy", normal)
    return tmp_path


def _use_mat(folder: Path, normal: np.ndarray) -> None:
    scipy.io.savemat(folder / "Normal_gt.mat", {"Normal_gt": normal})


def _use_text(folder: Path, normal: np.ndarray) -> None:
    np.savetxt(folder / "normal.txt", normal.reshape(-1, 3))


@pytest.mark.parametrize("use", [None, _use_mat, _use_text])
def test_every_form_of_the_normals_gives_the_same_fit(folder, use):
    if use is not None:
        normal = np.load(folder / "normal_gt.npy")
        (folder / "normal_gt.npy").unlink()
        use(folder, normal)
    scene, views = ds.read_photographs(folder)
    fit = ds.fit(scene, views, free=("k_d",))
    np.testing.assert_allclose(fit.material.k_d, 0.5, rtol=1e-4)


def _remove(name):
    return lambda folder: (folder / name).unlink()


def _write(name, text):
    return lambda folder: (folder / name).write_text(text)


BAD = {
    "no folder": (shutil.rmtree, "there is no folder .*Give a folder of photographs"),
    "no list": (_remove("filenames.txt"), "there is no file .*filenames.txt"),
    "empty list": (_write("filenames.txt", "\n"), "filenames.txt names no photograph"),
    "no photograph": (_remove("1.png"), "there is no file .*1.png"),
    "photograph of another size": (
        lambda folder: ds.write_image(folder / "1.png", np.zeros((4, 4, 3)), bits=16),
        r"1.png: View.image must have the camera's shape \(10, 12\); got \(4, 4\)",
    ),
    "too few lights": (
        _write("light_directions.txt", "0 0 1\n1 0 1\n"),
        "light_directions.txt must have one line for each of the 3 photographs in filenames.txt; got 2",
    ),
    "too many intensities": (_write("light_intensities.txt", "1 1 1\n" * 4), "light_intensities.txt .*; got 4"),
    "two numbers": (_write("light_directions.txt", "0 0 1\n0 1\n0 0 1\n"), "3 numbers a line; got 2 on line 2"),
    "a word": (_write("light_directions.txt", "0 0 1\n0 up 1\n0 0 1\n"), "must hold numbers only: .*'up'"),
    "a light from nowhere": (_write("light_directions.txt", "0 0 1\n0 0 0\n0 0 1\n"), "zero vector"),
    "no mask": (_remove("mask.png"), "there is no file .*mask.png"),
    "no normals": (_remove("normal_gt.npy"), "has no normals. Add one of normal_gt.npy, Normal_gt.mat, normal.txt"),
    "normals of another size": (
        lambda folder: np.save(folder / "normal_gt.npy", np.zeros((4, 4, 3))),
        r"normal_gt.npy must have the mask's shape \(10, 12, 3\); got \(4, 4, 3\)",
    ),
    "normals that are none": (_write("normal_gt.npy", "nonsense"), "normal_gt.npy holds no normals"),
    "normals of length 0": (
        lambda folder: np.save(folder / "normal_gt.npy", np.zeros((10, 12, 3))),
        "unit normal .* at every pixel of its mask; at row 0",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_what_is_wrong_with_a_folder_is_one_sentence_that_names_it(folder, case):
    spoil, message = BAD[case]
    spoil(folder)
    with pytest.raises((OSError, ValueError), match=message) as caught:
        ds.read_photographs(folder)
    assert "\n" not in str(caught.value)
