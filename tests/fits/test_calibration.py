"""Balls in photographs: where they are, and the lights that they tell, beside the truth and measured photographs."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from balls import DIRECTIONS, FAR, NEAR, SHAPE, K, disc, lit_by, photographs, silhouette
from measured import measured

import diffshade as ds
from diffshade.calibration.balls import find_ball
from diffshade.calibration.photographs import gather
from diffshade.calibration.result import degrees
from diffshade.inverse.data import photographs as reading

CHROME, MATTE = ds.Material(k_s=1.0, n_s=400), ds.Material(k_d=0.8)


# Outlines


def test_a_circle_is_found_to_a_small_part_of_a_pixel():
    random = np.random.default_rng(0)
    for _ in range(6):
        column, row, radius = 64 + random.uniform(-8, 8), 60 + random.uniform(-8, 8), random.uniform(25, 48)
        ball = find_ball(disc(column, row, radius), None, 2.0)
        np.testing.assert_allclose([*ball.middle, ball.radius], [column, row, radius], atol=0.1)
        np.testing.assert_allclose(ball.sphere.center, 0, atol=1e-9)
        np.testing.assert_allclose(ball.sphere.radius, 2.0)
        assert np.mean(ball.mask != disc(column, row, radius)) < 1e-3


def test_what_stands_before_or_beside_a_ball_moves_it_little():
    mask = disc(64, 60, 40)
    mask[95:, 55:75] = True  # a stand
    mask[30:60, 90:] = False  # something in front
    ball = find_ball(mask, None, 1.0)
    np.testing.assert_allclose([*ball.middle, ball.radius], [64, 60, 40], atol=0.25)
    assert not ball.mask[115, 60]


@pytest.mark.parametrize("at", [(0.1, -0.05, -5), (0.9, 0.7, -4.5), (-0.6, -0.7, -6.1)])
def test_through_a_pinhole_the_sphere_is_where_it_was(at):
    """Off the axis its outline is an ellipse, about another point than its centre, and here the picture ends in one."""
    camera = ds.Camera.from_intrinsics(K, shape=SHAPE, eye=(1, 2, 3), target=(1.2, 2.1, 0))
    forward = np.array([0.2, 0.1, -3]) / np.linalg.norm([0.2, 0.1, -3])
    right = np.cross(forward, (0, 1, 0))
    right /= np.linalg.norm(right)
    center = np.array([1, 2, 3]) + at[0] * right + at[1] * np.cross(right, forward) - at[2] * forward
    ball = find_ball(silhouette(camera, ds.Sphere(center, 0.8)), camera, 0.8)
    np.testing.assert_allclose(ball.sphere.center, center, atol=0.03)
    step = ball.sphere.center - center
    assert abs(step @ right) < 3 * ball.errors[0]
    assert np.linalg.norm(step - (step @ forward) * forward) < 0.1 * ball.pixel


def test_no_mask_in_a_list_is_refused_and_each_is_read_once(tmp_path, monkeypatch):
    with pytest.raises(ValueError, match=r"^mask must hold at least one; got none\. Give a mask"):
        gather(np.zeros((6, 8)), [], None)
    read = []
    monkeypatch.setattr(reading, "read_mask", lambda path: read.append(path) or np.ones((6, 8), bool))
    gather(np.zeros((6, 8)), ["a.png", "b.png"], None)
    assert read == ["a.png", "b.png"]


def test_a_ball_is_found_without_a_mask_and_in_its_own_shadow():
    image = photographs(lit_by(DIRECTIONS[3:], ds.Material(k_d=0.8)), FAR)[0] + 0.004
    found = ds.lights.calibrate(image, ball="matte")
    pixel = 2.6 / SHAPE[0]
    truth = (64 - 0.1 / pixel, 60 + 0.05 / pixel, 1 / pixel)
    np.testing.assert_allclose([*found.balls[0].middle, found.balls[0].radius], truth, atol=1.2)
    assert any("found by brightness" in note for note in found.notes)
    assert degrees(found.directions, DIRECTIONS[3:]) < 2


# Mirrors


def test_a_mirror_ball_far_away():
    images = photographs(lit_by(DIRECTIONS, CHROME), FAR)
    found = ds.lights.calibrate(images, ball="mirror", mask=silhouette(FAR, ds.Sphere()))
    angles = degrees(found.directions, DIRECTIONS)
    assert angles.max() < 0.25
    assert (angles < 3 * found.errors).all()
    np.testing.assert_allclose(np.linalg.norm(found.directions, axis=-1), 1)
    assert found.intensities is None
    assert any("not how far" in note for note in found.notes)


def test_two_mirror_balls_tell_where_the_lights_are():
    places = np.array([(0.6, 1.0, -2.0), (-0.8, 0.3, -1.0), (0.2, -0.9, -1.5)])
    balls = ds.Sphere((-0.55, -0.1, -5), 0.5), ds.Sphere((0.6, 0.2, -4.6), 0.4)
    camera = ds.Camera.from_intrinsics(np.array(K) * [[3], [3], [1]], shape=(360, 384))
    scene = ds.Scene([ds.Object(ball, CHROME) for ball in balls], [ds.PointLight(place, 1.0) for place in places])
    masks = [silhouette(camera, ball) for ball in balls]
    found = ds.lights.calibrate(photographs(scene, camera), ball="mirror", mask=masks, camera=camera, radius=(0.5, 0.4))
    assert found.positions is not None
    assert found.position_errors is not None
    off = np.abs(found.positions - places)
    assert off.max() < 0.05
    assert (off < 3 * found.position_errors).all()
    np.testing.assert_allclose([light.position for light in found.scene.lights], found.positions)  # pyright: ignore
    assert "position" in str(found)
    distant = ds.Scene(scene.objects, ds.DirectionalLight(-DIRECTIONS[0]))
    found = ds.lights.calibrate(
        photographs(distant, camera), ball="mirror", mask=masks, camera=camera, radius=(0.5, 0.4)
    )
    assert isinstance(found.scene.lights[0], ds.DirectionalLight)
    assert degrees(found.directions, DIRECTIONS[:1]) < 0.3
    assert any("far away" in note for note in found.notes)


# Matte balls


def test_a_matte_ball_tells_directions_and_intensities_in_colour():
    colours = np.array([(0.6, 0.5, 0.4), (0.7, 0.7, 0.7), (0.3, 0.5, 0.8), (0.9, 0.8, 0.7)])
    lights = [ds.DirectionalLight(-l, colour) for l, colour in zip(DIRECTIONS, colours, strict=True)]
    scene = ds.Scene(ds.Object(ds.Sphere(), ds.Material(k_a=0.03, k_d=1.0)), lights)
    images = photographs(scene, FAR, noise=0.01, bits=8)
    found = ds.lights.calibrate(list(images), ball="matte", mask=silhouette(FAR, ds.Sphere()))
    angles = degrees(found.directions, DIRECTIONS)
    assert angles.max() < 0.3
    assert (angles < 3 * found.errors).all()
    assert found.intensities is not None
    np.testing.assert_allclose(found.intensities, colours, rtol=0.02)
    known = ds.lights.calibrate(list(images), ball="matte", mask=silhouette(FAR, ds.Sphere()), directions=DIRECTIONS)
    np.testing.assert_allclose(known.directions, DIRECTIONS)
    assert known.intensities is not None
    np.testing.assert_allclose(known.intensities, colours, rtol=0.02)


def test_a_law_that_is_not_lamberts_and_clipped_pixels_turn_no_light():
    """A rough ball, brighter at its rim, with a highlight, in photographs that are clipped."""
    mask = disc(64, 60, 40)
    n = find_ball(mask, None, 1.0).normals()
    u = np.maximum(n @ DIRECTIONS.T, 0)
    h = DIRECTIONS + np.array([0, 0, 1])
    shine = 0.6 * np.maximum(n @ (h / np.linalg.norm(h, axis=-1, keepdims=True)).T, 0) ** 200
    images = np.moveaxis(1.05 * (u**0.8 * (1 + 0.2 * (1 - n[..., 2:])) + shine), -1, 0).clip(0, 1)
    found = ds.lights.calibrate(images[..., None], ball="matte", mask=mask)
    assert degrees(found.directions, DIRECTIONS).max() < 1.2
    assert (degrees(found.directions, DIRECTIONS) < 2 * found.errors).all()
    assert any("Lambert" in note for note in found.notes)


def test_a_photograph_with_a_second_light_is_named():
    images = photographs(lit_by(DIRECTIONS, ds.Material(k_d=0.6)), FAR, noise=0.003)
    images[2] += 0.3 * photographs(lit_by(-DIRECTIONS[2:3] * [1, 1, -1], ds.Material(k_d=0.6)), FAR)[0]
    images = np.concatenate([images, images[[0, 1, 3]] * 0.9])
    found = ds.lights.calibrate(images, ball="matte", mask=silhouette(FAR, ds.Sphere()))
    assert [note.split(" is ")[0] for note in found.notes if "second light" in note] == ["photograph 2"]


# Measured photographs


def test_the_chrome_ball_of_washington():
    folder = measured("uw_spheres")
    found = ds.lights.calibrate(folder / "chrome", ball="mirror")
    assert found.names[2] == "chrome.2.tga"
    other = found.compare(folder / "lights_from_chrome_highlight.txt")
    assert other.angles.max() < 0.8
    assert other.disagrees == []
    assert str(other).startswith("lights_from_chrome_highlight.txt agrees within two errors in every photograph")
    assert found.compare(folder / "lights.txt").angles.max() > 8
    turned = found.compare(np.roll(found.directions, 1, axis=0), name="mixed.txt")
    assert str(turned).startswith("mixed.txt disagrees in all 12 photographs, by ")


# Glossy balls: how well they are fitted is in studies/test_glossy_balls.py


def test_the_fit_of_a_glossy_ball_begins_at_its_outline_and_shading(monkeypatch):
    class Stopped(Exception):
        pass

    def fit(scene, views, **options):
        raise Stopped(scene, views, options)

    monkeypatch.setattr("diffshade.calibration.glossy.fit", fit)
    sphere, glossy = ds.Sphere((0.1, -0.2, -5.5), 0.8), ds.Material(k_a=0.02, k_d=0.6, k_s=0.2, n_s=20)
    for camera, surface, free in ((FAR, ds.Sphere(), True), (NEAR, sphere, False)):
        images = photographs(lit_by(DIRECTIONS[:2], glossy, surface), camera, noise=0.002)
        given = None if camera is FAR else camera
        with pytest.raises(Stopped) as stopped:
            ds.lights.calibrate(
                images, ball="glossy", mask=silhouette(camera, surface), camera=given, radius=float(surface.radius)
            )
        scene, views, options = stopped.value.args
        begun = -np.array([light.direction for light in scene.lights])
        assert degrees(begun, DIRECTIONS[:2]).max() < 4  # a matte ball's, which this is not
        assert [view.lit for view in views] == [(0,), (1,)]
        assert set(options["free"]) - {"radius"} == {
            *("center", "k_a", "k_d", "k_s", "n_s", "direction", "lights.1.intensity")
        }
        assert ("radius" in options["free"]) == ("radius" in options["priors"]) == free
        for axis, truth in zip("xyz", np.asarray(surface.center) * (not free), strict=True):
            value, error = options["priors"][f"center.{axis}"]
            assert abs(value - truth) < 3 * error < (0.3 if axis == "z" else 0.05)


# Folders, files and arrays


def test_a_folder_of_photographs_and_what_is_written_of_it(tmp_path):
    images = photographs(lit_by(DIRECTIONS, ds.Material(k_a=0.02, k_d=(0.6, 0.5, 0.4))), FAR, noise=0.002)
    source = tmp_path / "shots"
    source.mkdir()
    for i, image in enumerate(images):
        ds.write_image(source / f"shot{i + 8}.png", image, srgb=False, bits=16)
    ds.write_image(source / "mask.png", silhouette(FAR, ds.Sphere()) * 1.0, srgb=False)
    found = ds.lights.calibrate(source, ball="matte")
    assert found.names == ("shot8.png", "shot9.png", "shot10.png", "shot11.png")  # as people count
    assert degrees(found.directions, DIRECTIONS).max() < 0.3
    found.write(tmp_path / "out")
    scene, views = ds.read_photographs(tmp_path / "out")
    np.testing.assert_allclose([-light.direction for light in scene.lights], found.directions, atol=1e-6)  # pyright: ignore
    np.testing.assert_allclose([light.intensity for light in scene.lights], found.intensities, rtol=1e-6)  # pyright: ignore
    assert [view.lit for view in views] == [view.lit for view in found.views]
    for view, own, image in zip(views, found.views, images, strict=True):
        np.testing.assert_allclose(view.image[:], image.clip(0, 1), atol=1e-5)
        np.testing.assert_allclose(own.image[:], image.clip(0, 1), atol=1e-5)
    again = ds.lights.calibrate(tmp_path / "out", ball="matte")
    np.testing.assert_allclose(again.directions, found.directions, atol=1e-3)
    back = ds.read_scene(tmp_path / "out" / "scene.toml")
    np.testing.assert_array_equal([-l.direction for l in back.lights], found.directions)  # pyright: ignore
    assert ds.read_camera(tmp_path / "out" / "scene.toml").shape == SHAPE
    assert "shot8.png" in str(found)
    assert found.compare(found).angles.max() < 1e-12


def test_images_that_pass_1_and_cameras_near_by_are_written_too(tmp_path):
    sphere = ds.Sphere((0, 0, -5.5))
    images = photographs(lit_by(DIRECTIONS[:2], ds.Material(k_d=2.0), sphere), NEAR)
    found = ds.lights.calibrate(images, ball="matte", mask=silhouette(NEAR, sphere), camera=NEAR)
    assert degrees(found.directions, DIRECTIONS[:2]).max() < 0.2
    found.write(tmp_path)
    names = ["000.npy", "001.npy", "filenames.txt", "mask.png", "scene.toml"]
    assert sorted(path.name for path in tmp_path.iterdir()) == names
    np.testing.assert_array_equal(ds.read_image(tmp_path / "001.npy"), images[1])


def test_a_folder_holds_one_calibration_and_nothing_else(tmp_path):
    folder, other = tmp_path / "one", tmp_path / "other"
    images = photographs(lit_by(DIRECTIONS[:3], MATTE), FAR)
    far = ds.lights.calibrate(images, ball="matte", mask=silhouette(FAR, ds.Sphere()))
    far.write(folder)
    near = ds.lights.calibrate(images[:2], ball="matte", mask=silhouette(FAR, ds.Sphere()), camera=NEAR)
    near.write(folder)  # of the other layout: nothing of the first is left to be read for its lights
    assert not (folder / "light_directions.txt").exists()
    assert (folder / "filenames.txt").read_text().split() == ["000.png", "001.png"]
    other.mkdir()
    (other / "000.png").write_bytes(b"the only copy")
    with pytest.raises(FileExistsError, match=re.escape("holds other files, such as 000.png")):
        far.write(other)
    assert (other / "000.png").read_bytes() == b"the only copy"


def test_what_is_taken_for_granted_of_the_camera_is_said():
    images = photographs(lit_by(DIRECTIONS[:2], MATTE), FAR)
    found = ds.lights.calibrate(images, ball="matte", mask=silhouette(FAR, ds.Sphere()))
    assert any("camera was assumed to be far away" in note for note in found.notes)
    assert not any(
        "camera was assumed to be far away" in note
        for note in ds.lights.calibrate(images, ball="matte", mask=silhouette(FAR, ds.Sphere()), camera=NEAR).notes
    )
    height, width = SHAPE
    whole = ds.Camera.from_intrinsics([[4000, 0, 2000], [0, 4000, 1500], [0, 0, 1]], shape=(height, width))
    notes = ds.lights.calibrate(images, ball="matte", mask=silhouette(FAR, ds.Sphere()), camera=whole).notes
    assert any("principal point" in note and "another size" in note for note in notes)


def test_of_two_highlights_the_brightest_is_taken_and_the_other_said():
    normals = find_ball(MASK, None, 1.0).normals()

    def glint(l: np.ndarray, level: float) -> np.ndarray:
        h = l + np.array([0.0, 0.0, 1.0])
        h /= np.linalg.norm(h)
        return level * np.exp(-(1.0 - normals @ h) * 4000.0) * MASK

    one, other = np.array([0.48, 0.0, 0.877]), np.array([-0.4, 0.3, 0.866])
    found = ds.lights.calibrate(glint(one, 0.9) + glint(other, 0.85), ball="mirror", mask=MASK)
    assert degrees(found.directions, (one / np.linalg.norm(one))[None]).max() < 1.0
    assert found.errors.max() < 2.0
    assert any("more than one highlight" in note for note in found.notes)
    alone = ds.lights.calibrate(glint(one, 0.9), ball="mirror", mask=MASK)
    assert not any("more than one highlight" in note for note in alone.notes)


MASK = disc(64, 60, 40)
IMAGE = np.maximum(find_ball(MASK, None, 1.0).normals() @ DIRECTIONS[0], 0)
SQUARE = np.zeros(SHAPE, bool)
SQUARE[20:100, 30:110] = True
BROKEN = IMAGE.copy()
BROKEN[64, 60] = np.nan
INTRINSICS = ds.Camera.from_intrinsics(K, shape=(4, 5))
BAD: dict[str, tuple[dict[str, Any], str]] = {
    "a pixel that is not finite": (
        {"photographs": BROKEN},
        "photograph 0 must be finite; got [nan] at row 64, column 60",
    ),
    "a mask of everything": ({"mask": np.ones(SHAPE, bool)}, "the mask covers the whole picture"),
    "a direction that is not finite": ({"directions": [[np.inf, 0, 1]]}, "directions must be finite and not zero"),
    "a direction of nothing": ({"directions": [[0, 0, 0]]}, "directions must be finite and not zero"),
    "another kind of ball": ({"ball": "chrome"}, "'mirror', 'matte', 'glossy'; got 'chrome'"),
    "a square": ({"mask": SQUARE}, "the mask shows no ball: "),
    "an empty mask": ({"mask": np.zeros(SHAPE, bool)}, "the mask shows no ball: its edge has 0 points"),
    "half a ball": ({"mask": disc(64, -30, 50)}, "the mask shows too little of a ball: its outline covers "),
    "a mask of another size": ({"mask": np.ones((4, 5), bool)}, "mask must have the photographs' shape (120, 128)"),
    "a camera of another size": ({"camera": INTRINSICS}, "camera.shape must be that of the photographs, (120, 128)"),
    "no radius": ({"radius": 0}, "radius must be a number above 0, or one per mask; got 0"),
    "no number for a radius": ({"radius": "big"}, "radius must be an array of real numbers; got str of <U3"),
    "two radii of one ball": ({"radius": (1, 2)}, "radius must be a number above 0, or one per mask; got (1, 2)"),
    "nothing but a highlight": ({"ball": "mirror"}, "photograph 0: the ball shows no highlight: "),
    "a mirror without a mask": ({"ball": "mirror", "mask": None}, "the ball's outline was not found: "),
    "two balls far away": ({"ball": "mirror", "mask": (MASK, MASK)}, "several masks (2) need mirror balls"),
    "directions that do not match": ({"directions": DIRECTIONS}, "each of the 1 photographs; got shape (4, 3)"),
    "directions for a mirror": (
        {"ball": "mirror", "directions": DIRECTIONS[:1]},
        "directions are for a matte ball, to find the intensities; got ball='mirror'",
    ),
    "nothing bright": ({"mask": None, "photographs": np.full((*SHAPE, 3), 0.5)}, "no ball stands out"),
    "a black photograph": ({"photographs": np.zeros(SHAPE)}, "photograph 0 is black, or clipped, all over the ball"),
    "a ball that is lit evenly": ({"photographs": MASK * 0.5}, "photograph 0 shows no light on the ball"),
    "no photograph": ({"photographs": []}, "photographs must hold at least one; got none"),
    "what is none": ({"photographs": 3}, "photographs must be a folder, files or arrays; got int"),
    "integers": (
        {"photographs": np.ones(SHAPE, np.uint8)},
        "photograph 0 must be linear radiance in floats; got uint8",
    ),
    "sizes that differ": ({"photographs": [np.ones(SHAPE), np.ones((4, 5))]}, "photograph 1 of (4, 5)"),
    "a file that is not there": ({"photographs": "no.png"}, "there is no file no.png. Add"),
}


@pytest.mark.parametrize("case", BAD)
def test_what_cannot_be_is_said_in_one_sentence(case):
    change, message = BAD[case]
    options = {"photographs": IMAGE, "ball": "matte", "mask": MASK} | change
    with pytest.raises((ValueError, TypeError, FileNotFoundError), match=f"{re.escape(message)}[^\n]*$") as refused:
        ds.lights.calibrate(options.pop("photographs"), **options)
    assert "\n" not in str(refused.value)


def test_folders_that_cannot_be(tmp_path):
    with pytest.raises(ValueError, match=r"holds no photograph\. Give a folder with images"):
        ds.lights.calibrate(tmp_path, ball="matte")
    for name in ("a.png", "mask.png", "mask2.png"):
        ds.write_image(tmp_path / name, IMAGE)
    with pytest.raises(ValueError, match=r"holds several masks, mask\.png, mask2\.png\. Choose one with mask="):
        ds.lights.calibrate(tmp_path, ball="matte")
    (tmp_path / "filenames.txt").write_text("a.png\n")
    assert ds.lights.calibrate(tmp_path, ball="matte", mask=tmp_path / "mask.png").names == ("a.png",)


def test_lists_that_cannot_be_compared(tmp_path):
    found = ds.lights.calibrate(IMAGE * 0.9, ball="matte", mask=MASK)
    with pytest.raises(ValueError, match=r"one vector for each of the 1 photographs; got shape \(4, 3\)"):
        found.compare(DIRECTIONS)
    with pytest.raises(FileNotFoundError, match=r"there is no list of lights .*no\.txt\. Give"):
        found.compare(Path("no.txt"))
    (tmp_path / "list.txt").write_text("1\n0 0\n")
    with pytest.raises(ValueError, match=r"list\.txt must hold three numbers per line"):
        found.compare(tmp_path / "list.txt")
