"""Folders whose files state a curve, primaries or an orientation: the material that a fit finds, and what is said."""

import json
import logging

import colour_profiles as by
import numpy as np
import pytest

import diffshade as ds
from diffshade.cli import main

K_D = (0.6, 0.35, 0.15)
Z = np.tile([0.6, 0.8], 4)
L = np.stack(
    [np.sqrt(1 - Z**2) * np.cos(np.arange(8) * np.pi / 4), np.sqrt(1 - Z**2) * np.sin(np.arange(8) * np.pi / 4), Z], -1
)
CAMERA = ds.OrthographicCamera((0, 0, 4), height=2.4, shape=(32, 40), local_viewer=False)
TO_ADOBE = np.linalg.inv(by.ADOBE_XYZ) @ by.SRGB_XYZ
ADOBE = by.profile("Adobe-like", by.gamma(by.ADOBE_GAMMA), by.ADOBE_XYZ)


@pytest.fixture(scope="module")
def ball():
    """The photographs of a ball, linear, and its normals and mask."""
    scenes = [
        ds.Scene(ds.Object(ds.Sphere(), ds.Material(0.02, K_D, 0.2, 25)), ds.DirectionalLight(tuple(-l))) for l in L
    ]
    buffer = ds.intersect(scenes[0], CAMERA)
    return [np.asarray(ds.render(scene, CAMERA)).clip(0, 1) for scene in scenes], buffer


def jpeg(x, **options):
    return by.saved(ds.srgb_encode(x), "JPEG", **options)


def adobe(x):
    return by.saved(np.clip(x @ TO_ADOBE.T, 0, 1) ** (1 / by.ADOBE_GAMMA), "JPEG", icc_profile=ADOBE)


KINDS = {
    "Adobe RGB": (".jpg", lambda i, x: adobe(x), "8 photographs state Adobe-like, and are read so"),
    "linear PNG": (
        ".png",
        lambda i, x: by.png(x, 8, (b"gAMA", (100_000).to_bytes(4, "big"))),
        "8 photographs state linear, and are read so; such files are otherwise read as sRGB",
    ),
    "16-bit sRGB": (
        ".png",
        lambda i, x: by.png(ds.srgb_encode(x), 16, (b"sRGB", b"\0")),
        "8 photographs state sRGB, and are read so; such files are otherwise read as linear",
    ),
    "one of another profile": (
        ".jpg",
        lambda i, x: adobe(x) if i == 3 else jpeg(x),
        "3.jpg is read as Adobe-like, as stated, and the others as sRGB",
    ),
    "all of orientation 1": (".jpg", lambda i, x: jpeg(x, exif=by.exif(orientation=1)), ""),
    "one upside down": (
        ".jpg",
        lambda i, x: jpeg(x, exif=by.exif(orientation=3)) if i == 5 else jpeg(x),
        "5.jpg states the EXIF orientation 3, and the others 1. One camera has one orientation",
    ),
    "one on its side": (
        ".jpg",
        lambda i, x: jpeg(x, exif=by.exif(orientation=6)) if i == 5 else jpeg(x, exif=by.exif(orientation=1)),
        "5.jpg states the EXIF orientation 6, and the others 1. One camera has one orientation",
    ),
    "all on their side": (
        ".jpg",
        lambda i, x: jpeg(x, exif=by.exif(orientation=6)),
        "state the EXIF orientation 6, but the mask or camera has the size of what is stored: they are not turned",
    ),
}


def write_folder(folder, ball, suffix, write):
    images, buffer = ball
    for i, image in enumerate(images):
        (folder / f"{i}{suffix}").write_bytes(write(i, image))
    ds.write_image(folder / "mask.png", np.asarray(buffer.mask) * 1.0, srgb=False)
    np.savetxt(folder / "light_directions.txt", L)
    np.savetxt(folder / "light_intensities.txt", np.ones(8))
    np.save(folder / "normal_gt.npy", np.asarray(buffer.normal))


@pytest.mark.parametrize("kind", KINDS)
def test_the_photographs_are_right_and_what_is_unusual_is_said_once(tmp_path, ball, kind, caplog):
    suffix, write, said = KINDS[kind]
    write_folder(tmp_path, ball, suffix, write)
    _, views = ds.read_photographs(tmp_path)
    for view, image in zip(views, ball[0], strict=True):
        assert np.abs(view.image - image)[np.asarray(ball[1].mask)].mean() < 0.005
    warnings = [record.getMessage() for record in caplog.records if record.levelno == logging.WARNING]
    assert len(warnings) == bool(said)
    assert all(said in message for message in warnings)


@pytest.mark.thorough
@pytest.mark.parametrize("kind", KINDS)
def test_the_material_is_right(tmp_path, ball, kind):
    suffix, write, _ = KINDS[kind]
    write_folder(tmp_path, ball, suffix, write)
    fit = ds.fit(*ds.read_photographs(tmp_path), free=("k_a", "k_d", "k_s", "n_s"))
    np.testing.assert_allclose(fit.material.k_d, K_D, atol=0.004)
    np.testing.assert_allclose(fit.material.k_s, 0.2, atol=0.01)
    assert abs(float(fit.material.n_s) - 25) < 1


@pytest.mark.thorough
def test_the_command_says_so_and_a_flag_wins(tmp_path, ball, capfd, caplog):
    suffix, write, said = KINDS["Adobe RGB"]
    write_folder(tmp_path, ball, suffix, write)

    def run(*flags):
        caplog.clear()
        with pytest.raises(SystemExit) as end:
            main(["fit", f"{tmp_path}", *flags])
        assert end.value.code == 0
        return capfd.readouterr().out

    assert run().startswith(
        "photographs read as Adobe-like: 8 JPEG (as the files state; --srgb or --linear to change)\n"
    )
    assert said in caplog.text
    told = json.loads(run("--srgb", "--json"))
    assert told["read_as"] == ["sRGB"] * 8
    assert "8 photographs state Adobe-like; read as sRGB, as requested." in caplog.text
