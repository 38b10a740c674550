"""Files of strangers: a good one for each reader, and what every answer to a bad one must be."""

import builtins
import io
import math
import struct
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import colour_profiles
import mesh_files
import numpy as np
import pytest
import scipy.io
import textured_meshes
from hypothesis import HealthCheck, Phase, seed, settings
from lamp_files import VERTICAL, beam, ies, ldt
from PIL import Image

import diffshade as ds


def of_strangers(examples, start):
    """Run a test on so many generated files, the same ones each time; a file is not made smaller where one fails."""
    return lambda run: seed(start)(
        settings(
            max_examples=examples,
            deadline=None,
            database=None,
            phases=[Phase.generate],
            suppress_health_check=(HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.large_base_example),
        )(run)
    )


PLAIN = ds.Material((0.1, 0.05, 0.02), (0.7, 0.25, 0.2), 0.4, 40)
CAMERA = ds.Camera((0.2, 0.3, 3), fov=35, shape=(6, 7))
SECONDS = 20  # for any file of these sizes
SCENE = """ambient = 0.5
[camera]
eye = [0, 0, 4]
[atmosphere]
type = "Fog"
density = 0.1
[[objects]]
surface = "Sphere"
material = { k_a = 0.1, k_d = [0.7, 0.2, 0.1], lobe = "Blinn", k_s = { a = 0.1, b = 0.9 } }
[[lights]]
type = "MeasuredLight"
position = [0, 2, 0]
direction = [0, -1, 0]
profile = { vertical = [0, 45, 90], horizontal = [0], values = [[1, 0.5, 0]] }
attenuation = { quadratic = 1.0 }
"""


def first_rows(path: Path) -> None:
    """Open an image and read a band of it, unless it is large: pieces that a file leaves out are 0."""
    image = ds.open_image(path)
    if math.prod(image.shape) < 1e6:
        image[0 : min(image.shape[0], 9)]


def _folder(path: Path) -> None:
    ds.read_photographs(path.parent)


def _unshaped(path: Path) -> None:
    ds.read_photographs(path.parent, normals=False)


def _mesh(path: Path) -> None:
    """Read a mesh in parts: where there is one, its numbers are sound."""
    for part in ds.exchange.read_mesh_parts(path, CAMERA).values():
        assert np.isfinite(np.asarray(part.normal)).all()
        assert np.isfinite(np.asarray(part.position)).all()
    ds.exchange.read_mesh(path, None)


def _objects(path: Path) -> None:
    """Read a mesh in its own materials, beside which its pictures lie."""
    for item in ds.exchange.read_mesh_objects(path, CAMERA):
        assert all(np.isfinite(np.asarray(of)).all() for of in item.material.coefficients.values() if of is not None)


def _mesh_of(path: Path) -> Path:
    """Return the mesh that names a file of materials."""
    return path.with_suffix(".obj") if path.suffix == ".mtl" else path


MESHES = ("a.obj", "b.obj", "a.ply", "b.ply", "c.ply", "a.stl", "b.stl", "a.glb", "b.glb", "a.gltf", "a.off")
TEXTS: dict[str, tuple[Callable[[Path], Any], ...]] = {
    **dict.fromkeys((".mtl", ".json", ".gltf", ".glb"), (ds.exchange.read_materials,)),
    **dict.fromkeys((".ies", ".ldt"), (ds.lamps.read_lamp,)),
    ".toml": (ds.read_scene, ds.read_camera),
}
# A file in the folder that `write_good` writes, and what reads it, or the folder it is in.
OTHERS: dict[str, tuple[Callable[[Path], Any], ...]] = {
    **dict.fromkeys(("8.png", "16.png", "p.png", "a.jpg", "p.jpg", "a.tga", "32.tif"), (ds.read_image,)),
    **dict.fromkeys(("a.webp", "a.bmp", "a.ppm", "a.pgm", "a.pfm", "a.hdr", "a.heic"), (ds.read_image,)),
    **dict.fromkeys(("icc.png", "icc.jpg", "icc.tif", "icc.webp"), (ds.read_image,)),
    **dict.fromkeys(("32.exr", "16.exr"), (ds.read_image, ds.read_mask)),
    **dict.fromkeys(("a.npy", "8.tif", "16.tif", "tiles.tif"), (ds.read_image, first_rows)),
    **dict.fromkeys(("a.zarr/zarr.json", "b.zarr/.zarray", "b.zarr/0.0"), (lambda path: first_rows(path.parent),)),
    **dict.fromkeys(("ball/filenames.txt", "ball/light_directions.txt", "ball/normal_gt.npy"), (_folder,)),
    "list/dirs.lp": (_unshaped,),
    "m.glb": (ds.exchange.read_materials,),
    **dict.fromkeys(("mat/Normal_gt.mat", "text/normal.txt"), (_folder,)),
    **dict.fromkeys(("rgb.ptm", "lrgb.ptm", "a.rti", "b.rti"), (ds.exchange.read_rti,)),
    "maps/maps.toml": (lambda path: ds.read_maps(path.parent),),
    "maps/k_d.npy": (lambda path: ds.read_maps(path.parent),),
    "maps/scene.toml": (lambda path: ds.read_maps(path.parent),),
    **dict.fromkeys(MESHES, (_mesh,)),
    **dict.fromkeys(("textured.gltf", "textured.obj", "textured.mtl"), (lambda path: _objects(_mesh_of(path)),)),
}


def good_texts(folder: Path) -> dict[str, bytes]:
    """Return a file of each text format that is read."""
    row, C = beam(0, VERTICAL)[None], np.arange(0, 91, 22.5)
    files = {".toml": SCENE, ".ies": ies([0], row), ".ldt": ldt(4, 16, beam(C[:, None], VERTICAL, about=(0, 90)))}
    for suffix in (".mtl", ".json", ".gltf"):
        files[suffix] = ds.exchange.write_material(folder / f"good{suffix}", PLAIN).path.read_text()
    return {suffix: text.encode() for suffix, text in files.items()} | {".glb": glb(files[".gltf"].encode())}


def glb(text: bytes) -> bytes:
    """Return glTF's JSON in its binary form, with an empty buffer."""
    text += b" " * (-len(text) % 4)
    body = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", 0, b"BIN\0")
    return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body


def write_good(folder: Path) -> None:
    """Write a small good file of each name of `OTHERS`, and what it needs beside it."""
    import pillow_heif
    import tifffile
    import trimesh
    import zarr

    textured_meshes.write_unlit(folder / "textured.gltf")
    (folder / "textured.mtl").write_text("newmtl a\nKd 1 1 1\nmap_Kd -s 2 2 1 -clamp on smooth.png\nillum 1\n")
    places = "vt 0 0\nvt 1 0\nvt 1 1\nmtllib textured.mtl\nusemtl a\nf 1/1 2/2 3/3\n"
    (folder / "textured.obj").write_text(mesh_files.QUAD + places)
    image = np.random.default_rng(0).random((6, 7, 3))
    eight = (255 * image).astype(np.uint8)
    integers = {"8.png": 8, "16.png": 16, "a.tga": 8, "a.bmp": 8, "a.ppm": 16, "8.tif": 8, "16.tif": 16, "32.tif": 32}
    for name, bits in integers.items():
        ds.write_image(folder / name, image, bits=bits)
    for name, bits in {"32.exr": 32, "16.exr": 16}.items():
        ds.write_image(folder / name, image[..., :1], bits=bits)
    for name in ("a.webp", "a.pfm", "a.hdr"):
        ds.write_image(folder / name, image)
    ds.write_image(folder / "a.pgm", image[..., :1])
    pillow_heif.from_pillow(Image.fromarray(eight)).save(folder / "a.heic")
    adobe = colour_profiles.profile("Adobe", colour_profiles.parametric(0, 2.2), colour_profiles.ADOBE_XYZ)
    for name in ("icc.png", "icc.jpg", "icc.tif", "icc.webp"):
        tags = colour_profiles.exif(orientation=6, space=1)
        Image.fromarray(eight).save(folder / name, icc_profile=adobe, exif=tags)
    np.save(folder / "a.npy", image.astype(np.float32))
    Image.fromarray(eight).quantize(8).save(folder / "p.png")
    for name, more in {"a.jpg": {}, "p.jpg": {"progressive": True, "exif": b"Exif\0\0II*\0\x08\0\0\0\0\0"}}.items():
        Image.fromarray(eight).save(folder / name, **more)
    tifffile.imwrite(folder / "tiles.tif", eight, tile=(16, 16), compression="zlib", photometric="rgb")
    zarr.create_array(folder / "a.zarr", data=eight, chunks=(4, 7, 3))
    zarr.create_array(folder / "b.zarr", data=eight[..., 0], chunks=(6, 7), zarr_format=2)
    normal = np.broadcast_to((0.0, 0.6, 0.8), (6, 7, 3))
    for name in ("ball", "mat", "text"):
        (folder / name).mkdir()
        for of in "01":
            ds.write_image(folder / name / f"{of}.png", image, bits=16)
        ds.write_image(folder / name / "mask.png", np.ones((6, 7)))
        (folder / name / "filenames.txt").write_text("0.png\n1.png\n")
        (folder / name / "light_directions.txt").write_text("0 0 1\n0 0.6 0.8\n")
        (folder / name / "light_intensities.txt").write_text("1\n1\n")
    (folder / "list").mkdir()
    for of in "01":
        ds.write_image(folder / "list" / f"{of}.png", image, bits=16)
    (folder / "list" / "dirs.lp").write_text("2\n0.png 0 0 1\n1.png 0 0.6 0.8\n")
    np.save(folder / "ball" / "normal_gt.npy", normal)
    scipy.io.savemat(folder / "mat" / "Normal_gt.mat", {"Normal_gt": normal}, do_compression=True)
    np.savetxt(folder / "text" / "normal.txt", normal.reshape(-1, 3), "%.1f")
    for kind, size in {"RGB": 18, "LRGB": 9}.items():
        head = f"PTM_1.2\nPTM_FORMAT_{kind}\n7\n6\n1 1 1 1 1 1\n9 9 9 9 9 9\n".encode()
        (folder / f"{kind.lower()}.ptm").write_bytes(head + bytes(range(42)) * size)
    tail = np.ones(8, "<f4").tobytes() + bytes(12 * 42)
    (folder / "a.rti").write_bytes(b"#HSH1.2\n" + np.array((7, 6, 3, 2), "<i4").tobytes() + tail)
    (folder / "b.rti").write_bytes(b"#HSH1.2\n3\n7 6 3\n4 2 1\n" + tail)
    k_d = {"k_d": image.astype(np.float32)}
    scene = ds.Scene(ds.Object(ds.GBuffer(normal)), ds.DirectionalLight((0, 0, -1)))
    camera = ds.OrthographicCamera((0, 0, 4), shape=(6, 7))
    maps = ds.TexelMaps(k_d, k_d, np.ones((6, 7), np.uint8), image[..., 0].astype(np.float32), scene, camera)
    maps.write(folder / "maps", suffix=".npy")
    text = ds.exchange.write_material(folder / "m.gltf", PLAIN).path.read_bytes()
    text += b" " * (-len(text) % 4)
    chunk = struct.pack("<I4s", len(text), b"JSON") + text
    (folder / "m.glb").write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunk)) + chunk)
    box = trimesh.creation.box((1, 1, 1))
    for kind in ("obj", "ply", "stl", "glb", "off"):
        box.export(folder / f"a.{kind}")
    box.export(folder / "b.ply", encoding="ascii")
    (folder / "c.ply").write_bytes(mesh_files.ply("binary_big_endian", [(0, 1, 2, 3), (0, 1, 2)]))
    box.export(folder / "b.stl", file_type="stl_ascii")
    normals = "f 1//1 2//2 3//3 4//4\ns 1\nf 1 2 3\n"
    (folder / "b.obj").write_text(mesh_files.QUAD + mesh_files.TILTED + normals + mesh_files.CARD + mesh_files.WALL)
    strip = [(mesh_files.POINTS.astype("<f4"), "VEC3"), (np.array([0, 1, 3, 2], "<u1"), "SCALAR")]
    primitive = {"attributes": {"POSITION": 0, "NORMAL": 0}, "indices": 1, "mode": 5, "material": 0}
    node = {"scale": [1, -1, 1], "translation": [0, 0, 0.5]}
    (folder / "b.glb").write_bytes(mesh_files.gltf([primitive], strip, node, materials=[{"name": "red"}]))
    gltf: Any = box.scene().export(file_type="gltf")
    for name, data in gltf.items():
        (folder / name.replace("model", "a")).write_bytes(data)


def check_reading(readers: tuple[Callable[[Path], Any], ...], path: Path, data: bytes) -> None:
    """Read a file: a result, or one sentence of ValueError or OSError, soon."""
    path.write_bytes(data)
    for read in readers:
        began, said = time.perf_counter(), "a result"
        try:
            with warnings.catch_warnings(action="ignore"):
                read(path)
        except (ValueError, OSError) as error:
            said = str(error)
        assert said
        assert "\n" not in said
        assert len(said) < 2000 + 2 * len(data)
        assert time.perf_counter() - began < SECONDS


def watch_opening(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return a list to which the name of each file is added that Python opens in this test."""
    opened, real = [], io.open

    def watched(file, *args, **options):
        opened.append(f"{file}")
        return real(file, *args, **options)

    monkeypatch.setattr(builtins, "open", watched)
    monkeypatch.setattr(io, "open", watched)
    return opened
