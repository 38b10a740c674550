"""Near lamps from two mirror balls and the object between them: positions, the object's width, and the folder."""

from __future__ import annotations

import numpy as np
import pytest
from directions import unit

import diffshade as ds
from diffshade.inverse.data.photographs import read_folder

PIXELS = 25.0  # a scene unit
APART, WIDE = 6.0, 5.0
FRAME = (176, 276)
SPREAD = 0.05  # radians of a lamp seen from the ball


LAMPS = unit(np.array([(x, y, 1.2) for x in (-0.9, -0.3, 0.3, 0.9) for y in (-0.7, 0.0, 0.7)])) * np.random.default_rng(
    0
).uniform(22.0, 30.0, (12, 1))


def points(shape: tuple[int, int] = FRAME) -> np.ndarray:
    """Return x and y of a picture's pixels around its middle."""
    row, column = np.indices(shape) + 0.5
    return np.stack([column - shape[1] / 2, shape[0] / 2 - row], -1) / PIXELS


def ball_under(lamp: np.ndarray, x: float) -> np.ndarray:
    """Return a photograph of a mirror ball of radius 1 at (x, 0, 0), before a grey wall."""
    off = points() - (x, 0.0)
    inside = (off**2).sum(-1) < 1.0
    n = np.concatenate([off, np.sqrt(np.maximum(1.0 - (off**2).sum(-1, keepdims=True), 0.0))], -1)
    mirrored = 2.0 * n[..., 2:] * n - (0.0, 0.0, 1.0)
    to_lamp = unit(lamp - n - (x, 0.0, 0.0))
    shine = np.exp(-((mirrored - to_lamp) ** 2).sum(-1) / SPREAD**2)
    return np.where(inside, 0.01 + 0.95 * shine, 0.25)[..., None] * np.ones(3)


def object_under(lamp: np.ndarray) -> np.ndarray:
    """Return a photograph of a matte relief as wide as WIDE, before black."""
    p = points()
    height = 0.15 * np.sin(2.0 * p[..., 0]) * np.cos(2.5 * p[..., 1])
    slope = np.stack(
        [
            0.3 * np.cos(2.0 * p[..., 0]) * np.cos(2.5 * p[..., 1]),
            -0.375 * np.sin(2.0 * p[..., 0]) * np.sin(2.5 * p[..., 1]),
        ],
        -1,
    )
    n = unit(np.concatenate([-slope, np.ones((*FRAME, 1))], -1))
    to = lamp - np.concatenate([p, height[..., None]], -1)
    distance = np.linalg.norm(to, axis=-1)
    shading = np.maximum((n * to).sum(-1) / distance, 0.0) * (np.linalg.norm(lamp) / distance) ** 2
    k_d = 0.5 + 0.2 * np.sin(7.0 * p[..., 0] + 3.0 * p[..., 1])
    inside = (np.abs(p[..., 0]) < WIDE / 2) & (np.abs(p[..., 1]) < WIDE / 2.2)
    return (inside * k_d * shading)[..., None] * np.ones(3)


def shots(folder, images, crop=(slice(None), slice(None))):
    folder.mkdir()
    for i, image in enumerate(images):
        ds.write_image(folder / f"shot_{i:02d}.png", np.clip(image[crop], 0.0, 1.0), srgb=False, bits=16)


@pytest.fixture(scope="module")
def frames():
    """The photographs of both balls and of the object, whole."""
    return tuple(
        [np.float32(picture(lamp)) for lamp in LAMPS]
        for picture in (lambda lamp: ball_under(lamp, -3.0), lambda lamp: ball_under(lamp, 3.0), object_under)
    )


def applied_to(folder, frames, crops, **lengths):
    for name, images, crop in zip(("left", "right", "object"), frames, crops, strict=True):
        shots(folder / name, images, crop)
    balls = [ds.lights.calibrate(folder / name, ball="mirror", srgb=False) for name in ("left", "right")]
    return ds.lights.apply_lights(balls, folder / "object", srgb=False, **lengths)


CROPS = (  # of the left ball, the right ball and the object
    (slice(44, 132), slice(20, 108)),
    (slice(44, 132), slice(165, 258)),
    (slice(13, 163), slice(63, 213)),
)


def test_cropped_photographs_say_where_the_lamps_are(frames, tmp_path):
    applied = applied_to(tmp_path, frames, CROPS, apart=APART)
    assert np.isfinite(applied.positions).all()
    scores = (applied.positions - LAMPS) / applied.position_errors
    assert np.sqrt(np.mean(scores**2)) < 1.5
    assert np.abs(applied.positions - LAMPS).max() < 4.0
    width = applied.lights.picture_height / 150 * WIDE * PIXELS  # of the object, scene units
    assert width == pytest.approx(WIDE, rel=0.25)  # it is found by its photographs, which show it as flat
    applied.write(tmp_path / "ready")
    scene, views = ds.read_photographs(tmp_path / "ready", normals=False)
    lamps = [lamp for lamp in scene.lights if isinstance(lamp, ds.PointLight)]
    assert len(lamps) == len(LAMPS)
    unit_of_file = 2.2 / applied.lights.picture_height
    np.testing.assert_allclose([np.asarray(l.position) for l in lamps], applied.positions * unit_of_file, rtol=1e-6)
    np.testing.assert_allclose(
        read_folder(tmp_path / "ready", normals=False, exif=True).distances,
        np.linalg.norm(applied.positions, axis=-1) / applied.lights.picture_height,
    )
    held = [3, 8]
    seen = [view for i, view in enumerate(views) if i not in held]
    near = ds.fit_texels(scene, seen, free=("k_d", "normal"), loss="cauchy")
    assert max(near.relative_errors([views[i] for i in held])) < 0.015  # .023 with directions alone


def test_whole_photographs_say_how_far_apart_the_balls_stood(frames, tmp_path):
    applied = applied_to(tmp_path, frames, [(slice(None), slice(None))] * 3)
    assert "taken not to be cropped" in str(applied)
    scores = (applied.positions - LAMPS) / applied.position_errors
    assert np.sqrt(np.mean(scores**2)) < 1.5
    assert applied.lights.picture_height == pytest.approx(FRAME[0] / PIXELS, rel=0.02)


def test_lamps_far_away_keep_directions_alone(tmp_path):
    far = [1e4 * lamp for lamp in LAMPS]
    frames = (
        [ball_under(lamp, -3.0) for lamp in far],
        [ball_under(lamp, 3.0) for lamp in far],
        [object_under(lamp) for lamp in far],
    )
    applied = applied_to(tmp_path, frames, CROPS)
    assert np.isnan(applied.positions).all()
    np.testing.assert_allclose(applied.directions, unit(LAMPS), atol=0.03)
