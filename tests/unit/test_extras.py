"""A package that is missing is named with the extra that brings it, before anything is written."""

import re
import sys

import numpy as np
import pytest

import diffshade as ds
from diffshade.core.extras import check_extra, needing
from diffshade.inverse.data.masks import find_mask
from diffshade.report.page.colours import BELOW_TO_ABOVE, LOW_TO_HIGH, colours_of


def test_a_missing_package_is_named_with_its_extra():
    message = "cannot read a.x without the package no-such-package. Install it: pip install 'diffshade[mesh]'."
    with pytest.raises(ImportError, match=f"^{re.escape(message)}$"), needing("mesh", "cannot read a.x"):
        import no_such_package  # noqa: F401  # pyright: ignore[reportMissingImports]
    with pytest.raises(ImportError, match=f"^{re.escape(message)}$"):
        check_extra("mesh", "cannot read a.x", "numpy", "no_such_package")


def test_other_errors_pass():
    with pytest.raises(ValueError, match=r"^x$"), needing("mesh", "cannot read a.x"):
        raise ValueError("x")


GREY, FLAT = np.full((4, 4), 0.5), np.broadcast_to(np.array([0.0, 0.0, 1.0]), (8, 8, 3))
CALLS = {
    "OpenEXR: exr": lambda folder: ds.write_image(folder / "a.exr", GREY),
    "cv2: photographs": lambda folder: ds.write_image(folder / "a.tif", GREY),
    "cv2 : photographs": lambda folder: find_mask([GREY]),
    "pyamg: photographs": lambda folder: ds.heights.integrate_normals(
        FLAT, ds.OrthographicCamera((0, 0, 4), shape=(8, 8))
    ),
    "matplotlib: figures": lambda folder: ds.lecture.write_figures(folder / "figures"),
}


@pytest.mark.parametrize("case", CALLS)
def test_what_needs_an_extra_says_so_and_writes_nothing(monkeypatch, tmp_path, case):
    package, extra = case.split(": ")
    monkeypatch.setitem(sys.modules, package.strip(), None)
    with pytest.raises(ImportError, match=rf"{package.strip()}.*pip install 'diffshade\[{extra}\]'"):
        CALLS[case](tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("which", "name"), [(LOW_TO_HIGH, "viridis"), (BELOW_TO_ABOVE, "RdBu_r")])
def test_colours_of_numbers_are_those_of_matplotlib(which, name):
    from matplotlib import colormaps

    there = 255.0 * colormaps[name](np.linspace(0.0, 1.0, 65))[:, :3]
    np.testing.assert_allclose(colours_of(which, 65), there, atol=6)
