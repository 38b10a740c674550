"""From folders of mirror balls to a folder of an object: outline, mask, encoding and lights, no file by hand."""

from __future__ import annotations

import numpy as np
import pytest
from balls import FAR, lit_by, photographs

import diffshade as ds
from diffshade.calibration.object_lights import between
from diffshade.inverse.data.photographs import read_folder
from tests.support.textured import lights_about, textured_ball

COUNT = 8
GLINT = ds.Material(k_a=0.0, k_d=0.004, k_s=1.0, n_s=900)


def write_shots(folder, images, *, srgb=False, pattern="shot_{:02d}.png"):
    folder.mkdir()
    for i, image in enumerate(images):
        ds.write_image(folder / pattern.format(i), np.clip(image, 0.0, 1.0), srgb=srgb, bits=8)


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """Two mirror balls before a grey wall and a matte object, under the same lights; pictures of the room."""
    here, lights = tmp_path_factory.mktemp("shots"), lights_about(COUNT)
    inside = np.asarray(ds.intersect(lit_by(lights, GLINT), FAR).mask)
    for name, turn in (("left", 0.03), ("right", -0.03)):
        directions = lights + np.array([turn, 0.0, 0.0])
        directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
        images = photographs(lit_by(directions, GLINT), FAR)
        images = np.where(inside[None, ..., None], images, 0.02)
        write_shots(here / name, images, srgb=True, pattern="shot_{:02d}.jpg")
        room = np.where(inside[..., None], 0.05, 0.7) * np.ones(3)
        ds.write_image(here / name / "room.jpg", room)
    ball = textured_ball(64, COUNT, noise=0.002, gloss=0.0)
    write_shots(here / "object", [np.asarray(view.image) for view in ball.views])
    return here, ball


@pytest.fixture(scope="module")
def balls(folders):
    mask = ds.intersect(lit_by(lights_about(COUNT), GLINT), FAR).mask
    return [ds.lights.calibrate(folders[0] / name, ball="mirror", mask=mask) for name in ("left", "right")]


@pytest.mark.thorough
def test_a_ball_without_a_mask_is_found_and_said(folders, balls):
    found, true = ds.lights.calibrate(folders[0] / "left", ball="mirror"), balls[0]
    column, row = found.balls[0].middle
    assert np.allclose((column, row), true.balls[0].middle, atol=0.7)
    assert abs(found.balls[0].radius - true.balls[0].radius) < 0.7
    assert any("found by its edge" in note for note in found.notes)
    assert len(found.names) == COUNT  # without the picture of the room


def test_lights_are_carried_to_an_object(folders, balls, tmp_path):
    here, ball = folders
    applied = ds.lights.apply_lights(balls, here / "object")
    off = np.rad2deg(np.arccos(np.clip((applied.directions * lights_about(COUNT)).sum(-1), -1, 1)))
    assert off.mean() < 1.5
    assert np.mean(off <= 2.45 * applied.errors / np.sqrt(2.0)) >= 0.8
    assert np.mean(applied.mask == ball.mask) > 0.98
    text = str(applied)
    assert "taken to be linear, as they show" in text  # against the type of the file
    assert "the other choice turns normals by" in text
    assert "in the middle between the balls" in text
    assert "all 8 lamps are near" in text
    assert "the intensity 1" in text
    assert "paired in their order" not in text
    applied.write(tmp_path / "ready")
    scene, views = ds.read_photographs(tmp_path / "ready", normals=False)
    assert len(views) == COUNT
    positions = np.array([np.asarray(l.position) for l in scene.lights])  # pyright: ignore[reportAttributeAccessIssue]
    unit = float(views[0].camera.height) / applied.lights.picture_height  # pyright: ignore[reportAttributeAccessIssue]
    np.testing.assert_allclose(positions, applied.positions * unit, rtol=1e-8)
    kept = read_folder(tmp_path / "ready", normals=False, exif=True).light_errors
    assert kept is not None
    np.testing.assert_allclose(kept, applied.light_error, rtol=1e-5)
    np.testing.assert_allclose(views[0].image, ds.read_image(here / "object" / "shot_00.png", srgb=False), atol=1e-4)
    applied.write(tmp_path / "ready")  # again
    ds.write_figure(tmp_path / "shown.png", ds.lights.draw_calibration(balls))
    assert ds.read_image(tmp_path / "shown.png").shape[0] > 500


@pytest.mark.thorough
def test_photographs_beyond_1_are_carried_as_they_are(folders, balls, tmp_path):
    ball = folders[1]
    bright = tmp_path / "bright"
    write_shots(bright, [np.asarray(view.image) for view in ball.views])
    np.save(bright / "shot_00.npy", 3.0 * ds.read_image(bright / "shot_00.png", srgb=False))
    (bright / "shot_00.png").unlink()
    ds.lights.apply_lights(balls[0], bright, srgb=False).write(tmp_path / "brighter")
    held = ds.read_photographs(tmp_path / "brighter", normals=False)[1][0].image[:]
    np.testing.assert_allclose(held, np.load(bright / "shot_00.npy"))


def test_one_ball_says_where_the_object_is_taken_to_stand(balls):
    ball = balls[0]
    directions, errors, said = between([ball])
    np.testing.assert_allclose(directions, ball.directions)
    np.testing.assert_allclose(errors, ball.errors)
    assert "where the ball stood" in said[0]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda folder: (folder / "shot_07.png").unlink(), "has 7 photographs, and the ball 8"),
        (lambda folder: ds.write_image(folder / "shot_03.png", np.zeros((9, 9, 3))), "photographs of sizes"),
        (lambda folder: ds.write_image(folder / "mask.png", np.ones((9, 9, 1))), "the mask must have the photographs'"),
    ],
)
def test_an_object_that_does_not_fit_is_refused(folders, balls, tmp_path, change, said):
    ball = folders[1]
    write_shots(tmp_path / "object", [np.asarray(view.image) for view in ball.views])
    change(tmp_path / "object")
    with pytest.raises(ValueError, match=said):
        ds.lights.apply_lights(balls[0], tmp_path / "object")


def test_photographs_that_do_not_show_their_curve_ask_for_it(folders, balls, tmp_path):
    """Each light's photograph is of another object: no reading explains them."""
    random = np.random.default_rng(0)
    inside = np.hypot(*(np.indices((40, 40)) - 20.0)) < 18.0
    images = [np.where(inside[..., None], random.uniform(0.3, 0.6, (40, 40, 3)), 0.0) for _ in range(COUNT)]
    write_shots(tmp_path / "object", images, srgb=True)
    text = str(ds.lights.apply_lights(balls[0], tmp_path / "object", mask=inside))
    assert "do not show it clearly" in text
    assert "Say which they are, with --srgb or --linear" in text
    assert "do not show it" not in str(ds.lights.apply_lights(balls[0], tmp_path / "object", mask=inside, srgb=True))
