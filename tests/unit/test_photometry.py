"""Beam angles at half of the peak, about each lobe of a lamp, whichever way it shines."""

import numpy as np
import pytest
from lamp_files import ies, ldt

import diffshade as ds
from diffshade.model.photometry import beam_angles

GAMMA = np.arange(0, 181, 5.0)
CIRCLE = np.arange(0, 361, 15.0)


def directions(C):
    """Unit vectors of a table: along C = 0, along C = 90 and along the axis."""
    C, gamma = np.deg2rad(np.reshape(C, (-1, 1))), np.deg2rad(GAMMA)
    return np.sin(gamma) * np.cos(C), np.sin(gamma) * np.sin(C), np.cos(gamma) + 0 * C


def lobe(C, *towards, power=20.0):
    """A beam cos^power about a direction: half of the peak is at 2 acos(0.5^(1/power)) across it."""
    cosine = sum(a * b for a, b in zip(directions(C), np.divide(towards, np.linalg.norm(towards)), strict=True))
    return 1000 * np.maximum(cosine, 0) ** power


WIDE = 2 * np.rad2deg(np.arccos(0.5 ** (1 / 20)))  # 30.0
AROUND = {
    "down": (lobe(0, 0, 0, 1, power=1), "120 degrees"),
    "up": (lobe(0, 0, 0, -1, power=1), "120 degrees"),
    "up and down": (1000 * np.cos(np.deg2rad(GAMMA))[None] ** 2, "90 + 90 degrees"),
    "a bare tube along the axis": (1000 * np.sin(np.deg2rad(GAMMA))[None], "120 + 120 degrees"),
    "to all sides": (np.ones((1, len(GAMMA))), "360 degrees"),
}
IN_PLANES = {
    "up": (lobe(CIRCLE, 0, 0, -1), f"{WIDE:.3g} across C0 and {WIDE:.3g} across C90", ()),
    "a wall-washer": (lobe(CIRCLE, 1, 0, 1), f"{WIDE:.3g} across C0 and - across C90", ("C90 no direction",)),
    "a batwing": (
        lobe(CIRCLE, 3**0.5, 0, 1) + lobe(CIRCLE, -(3**0.5), 0, 1),
        f"{WIDE:.3g} + {WIDE:.3g} across C0 and - across C90",
        ("C0 2 lobes", "C90 no direction"),
    ),
    "askew": (
        lobe(CIRCLE, 1, 1, 2**0.5),
        f"- across C0, - across C90 and {WIDE:.3g} across C45",
        ("C0 no direction", "C90 no direction"),
    ),
    "a bare tube along C0": (
        1000 * np.sqrt(1 - directions(CIRCLE)[0] ** 2),
        "120 + 120 across C0 and 360 across C90",
        (),
    ),
}


def summary(tmp_path, file, text):
    (tmp_path / file).write_text(text)
    return str(ds.lamps.read_lamp(tmp_path / file))


@pytest.mark.parametrize(("values", "beam"), AROUND.values(), ids=AROUND)
def test_lamps_that_are_the_same_all_around(tmp_path, values, beam):
    assert f"beam angle  {beam}\n" in summary(tmp_path, "a.ies", ies([0], values, GAMMA))
    assert f"beam angle  {beam}\n" in summary(tmp_path, "a.ldt", ldt(1, 1, values, GAMMA))


@pytest.mark.parametrize(("values", "beam", "said"), IN_PLANES.values(), ids=IN_PLANES)
def test_lamps_with_planes_of_their_own(tmp_path, values, beam, said):
    for file, text in (("a.ies", ies(CIRCLE, values, GAMMA)), ("a.ldt", ldt(0, 24, values[:-1], GAMMA))):
        found = summary(tmp_path, file, text)
        assert f"beam angle  {beam} degrees\n" in found
        assert all(f"Across {words}" in found for words in said)


def test_beyond_the_table_it_is_dark(tmp_path):
    """A lamp that shines evenly to 30 degrees and not beyond; one that shines up alone, whose table begins at 90."""
    assert "beam angle  60 degrees" in summary(tmp_path, "a.ies", ies([0], [[1, 0.8]], np.array([0, 30])))
    up = ies([0], [[0.2, 0.6, 1]], np.array([90, 150, 180]))  # half of the peak at 135
    assert "beam angle  90 degrees" in summary(tmp_path, "a.ies", up)


@pytest.mark.parametrize("planes", [[0.0], CIRCLE], ids=["the same all around", "planes"])
def test_a_dark_lamp_has_no_beam_angle(planes):
    planes, values = np.array(planes), np.zeros((len(planes), len(GAMMA)))
    assert len(beam_angles(GAMMA, planes, values, 0.0)) == 0


def test_a_lamp_of_one_plane_names_no_plane(tmp_path):
    found = summary(tmp_path, "a.ies", ies([0], 1000 * np.cos(np.deg2rad(GAMMA))[None] ** 2, GAMMA))
    assert "2 lobes reach half of the peak" in found
    assert "plane" not in found
