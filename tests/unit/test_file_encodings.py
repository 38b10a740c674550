"""Whether photographs are linear or sRGB: said where they show it, and never wrongly."""

import io

import numpy as np
import pytest
from bumpy import bumpy
from measured import measured
from PIL import Image
from textured import lights_about, textured_ball

import diffshade as ds
from diffshade.texels.lights.encoding import FileEncoding, judge_encoding

OBJECTS = ("diligent_ball", "diligent_cat", "diligent_harvest")


def as_jpeg(linear: np.ndarray, quality: int) -> np.ndarray:
    held = io.BytesIO()
    Image.fromarray(np.rint(255.0 * np.asarray(ds.srgb_encode(linear))).astype(np.uint8)).save(
        held, "JPEG", quality=quality
    )
    return np.asarray(Image.open(held), np.float64) / 255.0


def in_8_bits(linear: np.ndarray) -> np.ndarray:
    return np.rint(255.0 * linear) / 255.0


def judged(images: list[np.ndarray], mask: np.ndarray, towards: np.ndarray) -> FileEncoding:
    found = judge_encoding(images, mask, towards)
    assert found is not None
    return found


@pytest.mark.parametrize("material", ["matte", "glossy"])
@pytest.mark.parametrize("count", [12, 24])
def test_a_drawn_object_is_never_taken_for_the_other(material, count):
    found = bumpy(material, count, 50.0, off=1.0)
    images = [np.asarray(view.image) for view in found.views]
    linear = judged([in_8_bits(image) for image in images], found.mask, found.to_light)
    curved = judged([as_jpeg(image, 90) for image in images], found.mask, found.to_light)
    assert not (linear.clear and linear.srgb)
    assert not (curved.clear and not curved.srgb)
    assert linear.misfits[0] < linear.misfits[1]
    assert curved.misfits[1] < curved.misfits[0]


@pytest.mark.parametrize("curved", [False, True])
def test_exact_photographs_show_their_curve_and_what_the_other_would_turn(curved):
    ball, lights = textured_ball(64, 12, noise=0.002, gloss=0.0), lights_about(12)
    images = [np.clip(np.asarray(view.image), 0.0, 1.0) for view in ball.views]
    found = judged([np.asarray(ds.srgb_encode(i)) for i in images] if curved else images, ball.mask, lights)
    assert found.clear
    assert found.srgb == curved
    assert 5.0 < found.turned < 40.0


def test_too_few_photographs_are_not_judged():
    ball = textured_ball(64, 5, gloss=0.0)
    images = [np.clip(np.asarray(view.image), 0.0, 1.0) for view in ball.views]
    assert judge_encoding(images, ball.mask, lights_about(5)) is None


@pytest.mark.thorough
@pytest.mark.parametrize("name", OBJECTS)
@pytest.mark.parametrize("some", [np.s_[:], np.s_[::4], np.s_[:12]])
def test_measured_photographs_are_never_taken_for_the_other(name, some):
    folder = measured(name)
    names = (folder / "filenames.txt").read_text().split()[some]
    images = [ds.read_image(folder / of, srgb=False) for of in names]
    mask, towards = ds.read_mask(folder / "mask.png"), np.loadtxt(folder / "light_directions.txt")[some]
    top = max(float(np.quantile(image[mask], 0.998)) for image in images)
    bright = [np.clip(image / top, 0.0, 1.0) for image in images]
    for linear in (images, [in_8_bits(image) for image in bright]):
        found = judged(linear, mask, towards)
        assert not (found.clear and found.srgb)
    for quality in (95, 85):
        found = judged([as_jpeg(image, quality) for image in bright], mask, towards)
        assert not (found.clear and not found.srgb)


def test_a_grey_ball_that_is_nearly_linear_is_not_called_srgb():
    folder = measured("uw_spheres")
    images = [ds.read_image(folder / "gray" / f"gray.{i}.tga", srgb=False) for i in range(12)]
    mask = ds.read_mask(folder / "gray" / "gray.mask.tga")
    found = judged(images, mask, np.loadtxt(folder / "lights_from_chrome_highlight.txt"))
    assert not (found.clear and found.srgb)
