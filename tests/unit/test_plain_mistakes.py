"""Plain mistakes in what a fit and a folder are given: the message says what it is, and what to do."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import diffshade as ds

CAMERA = ds.Camera(eye=(0, 0, 5), shape=(8, 10))
SCENE = ds.Scene(ds.Object(ds.Sphere()), ds.DirectionalLight((0, 0, -1)))
IMAGE = np.full((8, 10, 3), 0.5)


@pytest.mark.parametrize(
    ("arguments", "options", "said"),
    [
        ((SCENE, SCENE), {}, "views must be a View, or several; got"),
        ((SCENE, ds.View(IMAGE, CAMERA)), {"free": "k_a, k_d"}, r"several names in one, .* \('k_a', 'k_d'\)"),
    ],
    ids=["no views", "names"],
)
def test_arguments_of_a_fit(arguments, options, said):
    with pytest.raises((TypeError, ValueError), match=said):
        ds.fit(*arguments, **{"free": ("k_a", "k_d"), **options})


@pytest.mark.parametrize(
    ("image", "said"),
    [
        (np.moveaxis(IMAGE, -1, 0), r"channels last, shape \(8, 10, 3\); got \(3, 8, 10\). Move the colours"),
        (np.swapaxes(IMAGE, 0, 1), r"transposed. Give np.swapaxes\(image, 0, 1\), or the camera shape=\(10, 8\)"),
        (IMAGE[:5], r"Give the camera shape=\(5, 10\)"),
    ],
    ids=["channels first", "transposed", "another size"],
)
def test_the_shape_of_an_image(image, said):
    with pytest.raises(ValueError, match=said):
        ds.View(image, CAMERA)


def folder(at: Path, **others: Any) -> Path:
    """A folder of two photographs of a ball."""
    row, column = np.mgrid[:12, :12] - 5.5
    x, y = column / 5.0, -row / 5.0
    inside = x**2 + y**2 < 0.9
    normals = np.stack([x, y, np.sqrt(np.maximum(1.0 - x**2 - y**2, 0.0))], -1) * inside[..., None]
    of = {"mask": inside, "normals": normals, "intensities": "1 1 1\n1 1 1\n", **others}
    for name in ("1.npy", "2.npy"):
        np.save(at / name, np.where(inside[..., None], 0.3, 0.0) * np.ones(3))
    ds.write_image(at / "mask.png", np.repeat(of["mask"][..., None], 3, -1) * 1.0, srgb=False)
    np.save(at / "normal_gt.npy", of["normals"])
    (at / "light_directions.txt").write_text("0 0 1\n0 .6 .8\n")
    (at / "light_intensities.txt").write_text(of["intensities"])
    return at


def test_a_folder_with_a_wrong_file_says_which_and_what_is_wrong(tmp_path):
    ds.read_photographs(folder(tmp_path))
    right, mask = np.load(tmp_path / "normal_gt.npy"), np.asarray(ds.read_mask(tmp_path / "mask.png"))
    for others, said in (
        ({"mask": ~mask}, r"none inside the mask, .*mask\.png, but outside of it: it is inverted. Invert it\."),
        ({"normals": 0.5 * right + 0.5}, r"normal_gt\.npy: they are stored from 0 to 1, as in pictures. Write 2 n - 1"),
        ({"normals": 2.0 * right}, r"normal_gt\.npy: GBuffer needs a unit normal"),
        ({"intensities": "1 1 1\n1 nan 1\n"}, r"light_intensities\.txt must hold numbers only: got nan on line 2"),
    ):
        with pytest.raises(ValueError, match=said):
            ds.read_photographs(folder(tmp_path, **others))
