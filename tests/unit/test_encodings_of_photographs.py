"""What photographs are taken for: the kind of file decides, --srgb and --linear overrule it, and a line says so."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import diffshade as ds
from diffshade.cli.sources import Encodings, Options
from diffshade.inverse.data import photograph_files
from diffshade.io.images import read_as

LEVEL = 0.2  # linear; .484 behind the sRGB curve


def write_folder(folder: Path, name: str, **options) -> Path:
    """Write a folder of three photographs of a flat patch, of one kind of file."""
    folder.mkdir()
    names = [name.format(i) for i in range(3)]
    for each in names:
        ds.write_image(folder / each, np.full((6, 8, 3), LEVEL), **options)
    (folder / "filenames.txt").write_text("\n".join(names))
    np.savetxt(folder / "light_directions.txt", [[0, 0, 1], [0.6, 0, 0.8], [0, 0.6, 0.8]])
    np.savetxt(folder / "light_intensities.txt", np.ones((3, 3)))
    ds.write_image(folder / "mask.png", np.ones((6, 8, 1)), srgb=False)
    return folder


KINDS = {
    "{}.jpg": ({}, "3 JPEG", True),
    "{}.png": ({"bits": 8}, "3 8-bit PNG", True),
    "{}_16.png": ({"bits": 16}, "3 16-bit PNG", False),
    "{}.tif": ({}, "3 TIFF", False),
    "{}.exr": ({}, "3 EXR", False),
    "{}.npy": ({}, "3 NPY", False),
}


@pytest.mark.parametrize("name", KINDS)
def test_the_kind_of_file_decides_how_a_folder_is_read(tmp_path, name):
    options, kind, srgb = KINDS[name]
    folder = write_folder(tmp_path / "photographs", name, **options)
    read = Options(folder, ()).read(normals=False)
    assert abs(read.views[0].image[:].mean() - LEVEL) < 0.003
    said = f"{read.encodings}"
    assert f"{'sRGB' if srgb else 'linear'}: {kind}" in said
    assert ("--linear" if srgb else "--srgb") in said
    assert "\n" not in said


@pytest.mark.parametrize("as_files", [False, True])
@pytest.mark.parametrize("srgb", [False, True])
def test_a_flag_is_honoured_for_folders_and_for_files(tmp_path, srgb, as_files):
    other = {} if srgb else {"srgb": True}  # encoded otherwise than the kind of file says
    folder = write_folder(
        tmp_path / "photographs", "{}.tif" if srgb else "{}.jpg", **({"srgb": True} if srgb else other)
    )
    if not srgb:
        for path in folder.glob("*.jpg"):
            ds.write_image(path, np.full((6, 8, 3), LEVEL), srgb=False)
    source, photos = folder, ()
    if as_files:
        source, photos = tmp_path / "flat.toml", tuple(sorted(path for path in folder.iterdir() if path.stem.isdigit()))
        camera = ds.OrthographicCamera((0, 0, 1), shape=(6, 8))
        lights = [ds.DirectionalLight((0, 0, -1))] * 3
        ds.write_scene(source, ds.Scene(ds.Object(ds.Sphere()), lights), camera=camera)
    read = Options(source, photos, srgb=srgb).read(normals=False)
    assert abs(read.views[0].image[:].mean() - LEVEL) < 0.003
    assert read.encodings.names == (("sRGB" if srgb else "linear"),) * 3
    assert "as requested" in f"{read.encodings}"


def test_the_folder_of_a_camera_near_by_takes_the_flag_too(tmp_path):
    folder = write_folder(tmp_path / "photographs", "{}.jpg")
    (folder / "light_directions.txt").unlink()
    camera = ds.Camera(eye=(0, 0, 4), fov=30, shape=(6, 8))
    lights = [ds.DirectionalLight((0, 0, -1))] * 3
    ds.write_scene(folder / "scene.toml", ds.Scene(ds.Object(ds.Sphere()), lights), camera=camera)
    for srgb, level in ((None, LEVEL), (True, LEVEL), (False, float(ds.srgb_encode(LEVEL)))):
        assert abs(Options(folder, (), srgb=srgb).read().views[0].image[:].mean() - level) < 0.003


def test_headers_are_read_once_and_notes_name_the_folder(tmp_path, caplog, monkeypatch):
    folder = write_folder(tmp_path / "photographs", "{}.jpg")
    photos = [file for file in sorted(folder.glob("*.jpg")) if "mask" not in file.stem]
    for file in photos:
        Image.open(file).save(file, icc_profile=b"nonsense")
    camera = ds.Camera(eye=(0, 0, 4), fov=30, shape=(6, 8))
    lights = [ds.DirectionalLight((0, 0, -1))] * len(photos)
    ds.write_scene(tmp_path / "scene.toml", ds.Scene(ds.Object(ds.Sphere()), lights), camera=camera)
    read = []
    monkeypatch.setattr(photograph_files, "read_as", lambda file, srgb: read.append(file) or read_as(file, srgb=srgb))
    Options(tmp_path / "scene.toml", tuple(photos)).read()
    assert read == photos
    assert f"{folder}: {len(photos)} photographs state a colour profile that is damaged" in caplog.text


def test_what_is_mixed_is_said_of_each(tmp_path):
    for name in ("a.jpg", "b.jpg", "c.exr"):
        ds.write_image(tmp_path / name, np.full((6, 8, 3), LEVEL))
    said = f"{Encodings.of([read_as(tmp_path / name) for name in ('a.jpg', 'b.jpg', 'c.exr')], None)}"
    assert "sRGB: 2 JPEG; as linear: 1 EXR" in said


def test_the_librarys_folder_is_read_alike(tmp_path):
    folder = write_folder(tmp_path / "photographs", "{}.jpg")
    for srgb, level in ((None, LEVEL), (True, LEVEL), (False, float(ds.srgb_encode(LEVEL)))):
        _, views = ds.read_photographs(folder, normals=False, srgb=srgb)
        assert abs(views[1].image.mean() - level) < 0.003
