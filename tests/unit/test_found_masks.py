"""Masks that are found in photographs: of objects before black, before walls, and where no way is sure."""

import json

import cv2
import numpy as np
import pytest
from measured import measured

import diffshade as ds
from diffshade.cli import main
from diffshade.inverse.data.folders import list_folder
from diffshade.inverse.data.masks import find_mask, overlap

SIDE, RADIUS = 96, 0.5
X, Y = np.meshgrid(np.linspace(-1, 1, SIDE), np.linspace(1, -1, SIDE))


def photographed(ball, wall, *, at=(0.1, 0.0), count=8, ambient=0.02):
    """A ball before a wall that is lit, with the shadow that it casts; the photographs and the true mask."""
    x, y = X - at[0], Y - at[1]
    inside = np.hypot(x, y) < RADIUS
    z = np.where(inside, np.sqrt(np.clip(RADIUS**2 - x * x - y * y, 0, None)), -0.7)
    normal = np.where(inside[..., None], np.stack([x, y, z], -1) / RADIUS, (0.0, 0.0, 1.0))
    random, images = np.random.default_rng(5), []
    albedo = np.where(inside[..., None], ball, np.multiply(wall, 1 + 0.04 * random.normal(size=(SIDE, SIDE, 1))))
    for angle in np.linspace(0, 2 * np.pi, count, endpoint=False):
        l = np.array([0.6 * np.cos(angle), 0.6 * np.sin(angle), 0.8])
        point = np.stack([x, y, z], -1)
        along = point @ l
        shadow = ~inside & (np.linalg.norm(point - along[..., None] * l, axis=-1) < RADIUS)
        lit = np.where(shadow, 0.0, np.clip(normal @ l, 0, None))
        image = cv2.GaussianBlur(albedo * (lit[..., None] + ambient), (0, 0), 0.6)
        images.append(np.clip(image + random.normal(scale=0.004, size=image.shape), 0, 1))
    return images, inside


SCENES = {  # and what the brightest region alone, which was the only way, overlaps with the truth
    "before black": ((0.5, 0.4, 0.3), (0.005, 0.005, 0.005)),
    "before a dark wall": ((0.5, 0.4, 0.3), (0.1, 0.1, 0.1)),
    "before a bright wall": ((0.5, 0.4, 0.3), (0.8, 0.8, 0.8)),
    "before a wall of its own colour": ((0.5, 0.5, 0.5), (0.45, 0.45, 0.45)),
    "of another colour": ((0.3, 0.4, 0.5), (0.5, 0.2, 0.15)),
    "dark before a wall": ((0.2, 0.2, 0.2), (0.7, 0.7, 0.7)),
}


@pytest.mark.parametrize("name", SCENES)
def test_an_object_is_found(name):
    images, inside = photographed(*SCENES[name])
    found = find_mask(images)
    assert overlap(found.mask, inside) > (0.93 if name != "before a wall of its own colour" else 0.85)
    assert len(found.agreeing) >= 2
    assert not any("border" in note for note in found.notes)
    if name != "before a wall of its own colour":
        assert found.notes == ()
        assert found.agreement > 0.8


def test_brightness_alone_gives_the_outline_of_the_whole_picture():
    row, column = np.indices((900, 700))
    inside = (row - 450) ** 2 + (column - 300) ** 2 < 200**2
    found = find_mask([np.where(inside, 0.4, 0.01), np.where(inside & (row < 450), 0.1, 0.01)])
    np.testing.assert_array_equal(found.mask, inside)
    assert max(found.picture.shape) == 400


def test_a_mask_that_touches_the_border_is_said():
    images, inside = photographed((0.5, 0.4, 0.3), (0.05, 0.05, 0.05), at=(0.0, -0.8))
    found = find_mask(images)
    assert overlap(found.mask, inside) > 0.9
    assert any("% of the picture's border" in note for note in found.notes)


@pytest.mark.parametrize("frame", [0.0, 0.05, 0.5, 1.0])
@pytest.mark.parametrize("width", [(12, 12, 12, 12), (1, 1, 1, 1), (4, 8, 4, 5)])
@pytest.mark.parametrize("name", ["before black", "before a wall of its own colour", "of another colour"])
def test_a_picture_within_a_frame_is_said(name, width, frame):
    """The whole picture stands out from the frame more than its object from the wall."""
    images, inside = photographed(*SCENES[name])
    top, bottom, left, right = width
    around = (top, bottom), (left, right)
    found = find_mask([np.pad(image, (*around, (0, 0)), constant_values=frame) for image in images])
    is_object = overlap(found.mask, np.pad(inside, around)) > 0.8
    assert is_object or found.notes
    assert not (is_object and any("rectangle" in note for note in found.notes))


def test_a_picture_within_a_frame_that_shadows_cut_is_said():
    """The mask is the picture without a shadow, which is no whole rectangle, but has most of one's border."""
    row, column = np.indices((200, 300))
    picture = (abs(row - 100) < 90) & (abs(column - 150) < 135) & (np.hypot(row - 190, column - 150) > 60)
    found = find_mask([picture * level for level in (0.4, 0.3, 0.5)])
    assert overlap(found.mask, picture) > 0.95
    assert any("rectangle" in note for note in found.notes)


def test_what_is_no_object_is_refused():
    with pytest.raises(ValueError, match=r"no object was found before a background.* Draw a mask"):
        find_mask([np.zeros((60, 60))])
    with pytest.raises(ValueError, match="photographs must have one size"):
        find_mask([np.zeros((60, 60)), np.zeros((60, 50))])


def test_noise_is_no_object_or_the_ways_disagree():
    random = np.random.default_rng(0)
    try:
        found = find_mask([random.uniform(0.2, 0.4, (64, 64, 3)) for _ in range(6)])
    except ValueError:
        return
    assert any("disagree" in note and "Draw a mask" in note for note in found.notes)


def test_the_command_writes_a_picture_beside(tmp_path, capsys):
    images, inside = photographed(*SCENES["before a bright wall"])
    for i, image in enumerate(images):
        ds.write_image(tmp_path / f"{i}.png", image, srgb=False)
    with pytest.raises(SystemExit, match="0"):
        main(["mask", str(tmp_path), "--json"])
    told = json.loads(capsys.readouterr().out)
    assert overlap(np.asarray(ds.read_mask(tmp_path / "mask.png")), inside) > 0.93
    assert told["agreement"] > 0.8
    assert (tmp_path / "mask-shown.png").is_file()
    listed = list_folder(tmp_path)
    assert listed.masks == (tmp_path / "mask.png",)
    assert len(listed.names) == len(images)


@pytest.mark.parametrize("name", ["diligent_cat", "diligent_harvest", "uw_spheres/gray"])
def test_of_measured_objects(name):
    folder = measured(name)
    mask = next(file for file in folder.iterdir() if "mask" in file.name)
    files = sorted(f for f in folder.iterdir() if f.suffix in (".png", ".tga") and "mask" not in f.name)
    found = find_mask([ds.read_image(file, srgb=False) for file in files[:: 1 if name.startswith("uw") else 4]])
    assert overlap(found.mask, np.asarray(ds.read_mask(mask))) > 0.94
    assert bool(found.notes) == (name == "uw_spheres/gray")  # a screw and cloth: two ways see them
