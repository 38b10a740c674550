"""Images, folders of photographs and meshes of strangers: a result or one sentence, soon, and in bounded memory.

What a file may hold is made of a good file: bytes and numbers in it are others, pieces are moved, left out, repeated;
the chunks of a PNG get the checksums they should have. The thorough tier takes seconds; `-m slow` spends half an hour,
or DIFFSHADE_FUZZ_SECONDS.
"""

import io
import json
import os
import pickle
import shutil
import struct
import time
import zlib

import numpy as np
import pytest
from hostile import CAMERA, OTHERS, check_reading, first_rows, of_strangers, watch_opening, write_good
from hypothesis import given
from hypothesis import strategies as st
from memory import CLEAR, forget_the_peak, peak
from PIL import Image

import diffshade as ds

# Memory: so many times what the bytes could become, and what any call takes. A sample is at most 64 bytes while it is
# read; of deflate a byte becomes 1032 at most, of JPEG 512 pixels, of a run of TGA 64, of BMP 128, of Radiance 16. WebP
# and HEIC have no such limit; they are refused beyond 32,768 pixels a byte.
MULTIPLE, CONSTANT = 64, 48 * 2**20
NUMBERS = (0, 1, 2, 7, 255, 256, 2**15, 2**16 - 1, 2**24, 2**31 - 1, 2**31, 2**32 - 1, 2**40, 2**63, 2**64 - 1)
WORDS = (
    *("nan", "inf", "-1", "1e999", "99999999999", "../../x", "/etc/passwd", "\0", "\n", "9" * 500, "[" * 500, "'", '"'),
    *("(60000, 60000, 3)", "'|O'", "'<c16'", "[('a', '<f8')]", "null", "{}", "mtllib ../x", "f 1 2 3", "v nan 0 1e400"),
)


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    """A folder with a small good file for each reader."""
    pytest.importorskip("trimesh")
    pytest.importorskip("zarr")
    pytest.importorskip("pillow_heif")
    folder = tmp_path_factory.mktemp("good")
    write_good(folder)
    return folder


@st.composite
def mutated(draw, base: bytes):
    """A file of which a few pieces are others."""
    data = base
    for _ in range(draw(st.integers(1, 3))):
        a = draw(st.integers(0, min(len(data), draw(st.sampled_from([64, 10**9])))))
        way = draw(st.integers(0, 5))
        if way < 2:
            number = draw(st.sampled_from(NUMBERS) | st.integers(0, 300))
            size = draw(st.sampled_from([1, 2, 4, 8]))
            piece = (number % 2 ** (8 * size)).to_bytes(size, draw(st.sampled_from(["little", "big"])))
            data = data[:a] + piece + data[a + size :]
        elif way == 2:
            piece = draw(st.sampled_from(WORDS)).encode()
            data = data[:a] + piece + data[a + draw(st.sampled_from([0, 1, 4, 40])) :]
        elif way == 3:
            data = data[:a] + draw(st.binary(max_size=8)) + data[a + draw(st.integers(0, 8)) :]
        elif way == 4:
            b = a + draw(st.sampled_from([1, 4, 12, 100]))
            data = data[:a] + data[a:b] * draw(st.sampled_from([0, 2, 50])) + data[b:]
        else:
            data = data[:a]
    return with_checksums(data) if data.startswith(b"\x89PNG") and draw(st.booleans()) else data


def with_checksums(data: bytes) -> bytes:
    """Return a PNG whose chunks have the checksums of what they hold."""
    out, at = [data[:8]], 8
    while at + 8 <= len(data):
        (length,) = struct.unpack_from(">I", data, at)
        body = data[at + 4 : at + 8 + length]
        out.append(data[at : at + 4] + body + struct.pack(">I", zlib.crc32(body)))
        at += 12 + length
    return b"".join(out)


def fuzz(name, folder, examples, *, start=0):
    path = folder / name
    base = path.read_bytes()

    @of_strangers(examples, start)
    @given(mutated(base))
    def run(data):
        before = forget_the_peak() if CLEAR.exists() else 0
        check_reading(OTHERS[name], path, data)
        most = 3 * {".jpg": 512, ".tga": 512, ".webp": 2**15, ".heic": 2**15}.get(path.suffix, 1032)
        if CLEAR.exists():
            assert peak() - before <= MULTIPLE * most * len(data) + CONSTANT

    try:
        run()
    finally:
        path.write_bytes(base)


@pytest.mark.parametrize("name", OTHERS)
def test_any_file_gives_a_result_or_one_sentence(name, good):
    check_reading(OTHERS[name], good / name, (good / name).read_bytes())
    fuzz(name, good, 30)


def tiff(size, bits, pixels, *, tile=None, more=()):
    """Return a deflated RGB TIFF of which one strip or tile lies in the file."""
    where = (322, tile), (323, tile), (324, None), (325, len(pixels))
    where = where if tile else ((278, size), (273, None), (279, len(pixels)))
    tags = [(256, size), (257, size), (258, bits), (259, 8), (262, 2), (277, 3), (284, 1), *where]
    entries = sorted([(tag, 4, 1, value) for tag, value in tags] + list(more))
    at = 8 + 2 + 12 * len(entries) + 4
    packed = [struct.pack("<HHII", *entry[:3], at if entry[3] is None else entry[3]) for entry in entries]
    return b"II*\0" + struct.pack("<IH", 8, len(entries)) + b"".join(packed) + bytes(4) + pixels


def png(size, depth):
    header = struct.pack(">IIBBBBB", size, size, depth, 2, 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", zlib.compress(bytes(1000))), (b"IEND", b""))
    return with_checksums(
        b"\x89PNG\r\n\x1a\n" + b"".join(struct.pack(">I", len(b)) + k + b + bytes(4) for k, b in chunks)
    )


def npy(shape, dtype="<f8"):
    header = f"{{'descr': '{dtype}', 'fortran_order': False, 'shape': {shape}}}".encode().ljust(117) + b"\n"
    return b"\x93NUMPY\x01\0" + struct.pack("<H", len(header)) + header


def jpeg(size):
    file = io.BytesIO()
    Image.new("RGB", (16, 16)).save(file, "JPEG")
    head, rest = file.getvalue().split(b"\xff\xc0", 1)
    return head + b"\xff\xc0" + rest[:3] + struct.pack(">HH", size, size) + rest[7:]


def exr(size, good):
    data = (good / "16.exr").read_bytes()
    for name in (b"dataWindow\0box2i\0", b"displayWindow\0box2i\0"):
        at = data.index(name) + len(name) + 4
        data = data[:at] + struct.pack("<iiii", 0, 0, size - 1, 15) + data[at + 16 :]
    return data


def other_size(name, good, at, size):
    data = (good / name).read_bytes()
    return data[:at] + size + data[at + len(size) :]


def icc_bomb(good):
    """A PNG that is not sound, whose profile becomes 50 MB."""
    data, body = (good / "8.png").read_bytes(), b"iCCPx\0\0" + ZEROS
    return data[:33] + struct.pack(">I", len(body) - 4) + body + bytes(4) + data[33:]


TGA = struct.pack("<BBBHHBHHHHBB", 0, 0, 10, 0, 0, 0, 0, 0, 13_000, 13_000, 24, 0)
ZEROS = zlib.compress(bytes(5 * 10**7))
BOMBS = {  # each took gigabytes or minutes, or might have
    "60000.png": lambda good: png(60_000, 8),
    "13000.png": lambda good: png(13_000, 8),
    "deep.png": lambda good: png(13_000, 16),
    "8.tif": lambda good: tiff(13_000, 8, zlib.compress(bytes(1000))),
    "16.tif": lambda good: tiff(13_000, 16, zlib.compress(bytes(1000))),
    "tile.tif": lambda good: tiff(10, 8, zlib.compress(bytes(1000)), tile=16_000),
    "inflated.tif": lambda good: tiff(10, 16, ZEROS),
    "tags.tif": lambda good: tiff(10, 8, bytes(200_000), more=[(k, 3, 90_000, 300) for k in range(1000, 21_000)]),
    "same.tif": lambda good: tiff(10, 8, bytes(200_000), more=[(273, 4, 40_000, 300), (279, 4, 40_000, 300)]),
    "a.tga": lambda good: TGA + b"x" * 10,
    "a.jpg": lambda good: jpeg(13_000),
    "a.bmp": lambda good: other_size("a.bmp", good, 18, struct.pack("<ii", 12_000, 12_000)),
    "a.webp": lambda good: other_size("a.webp", good, 21, struct.pack("<I", 11_999 | 11_999 << 14)),
    "a.hdr": lambda good: (good / "a.hdr").read_bytes().replace(b"-Y 6 +X 7", b"-Y 9000 +X 9000"),
    "a.ppm": lambda good: (good / "a.ppm").read_bytes().replace(b"7 6", b"70000 60000"),
    "a.pfm": lambda good: (good / "a.pfm").read_bytes().replace(b"7 6", b"70000 60000"),
    "zeros.pgm": lambda good: b"P2 90000 90000 255 " + bytes(1000),
    "profile.png": lambda good: icc_bomb(good),
    "wide.exr": lambda good: exr(100_000_000, good),
    "large.exr": lambda good: exr(2**31 - 1, good),
    "long.npy": lambda good: npy("(2000000000000, 3)"),
    "overflow.npy": lambda good: npy("(4294967296, 4294967296, 3)"),
    "nested.npy": lambda good: npy("-" * 9000 + "1"),
    "item.npy": lambda good: npy("(1, 1)", "<V2000000000"),
}


@pytest.mark.parametrize("name", BOMBS)
def test_a_file_that_declares_more_than_it_holds_takes_no_memory(name, good, tmp_path):
    readers = (ds.read_image, first_rows) if name.endswith((".npy", ".tif")) else (ds.read_image,)
    data = BOMBS[name](good)
    (tmp_path / name).write_bytes(data)
    check_reading(readers, tmp_path / name, data)  # imports are no part of it
    before = forget_the_peak() if CLEAR.exists() else 0
    check_reading(readers, tmp_path / name, data)
    if CLEAR.exists():
        assert peak() - before <= 2 * 1032 * len(data) + 2**22
    if name != "inflated.tif":
        for read in readers:
            with pytest.raises((ValueError, OSError), match=name):
                read(tmp_path / name)


def test_names_in_a_folder_do_not_lead_out_of_it(good, tmp_path):
    shutil.copytree(good / "ball", tmp_path / "ball")
    names = tmp_path / "ball" / "filenames.txt"
    shutil.move(tmp_path / "ball" / "1.png", tmp_path / "1.png")
    for name in ("../1.png", f"{tmp_path / '1.png'}", "x/../../1.png"):
        names.write_text(f"0.png\n{name}\n")
        with pytest.raises(ValueError, match=r"filenames\.txt must name photographs in its own folder; got"):
            ds.read_photographs(names.parent)
    (tmp_path / "ball" / "1.png").symlink_to(tmp_path / "1.png")
    names.write_text("0.png\n./1.png\n")
    (tmp_path / "link").symlink_to(tmp_path / "ball")
    assert len(ds.read_photographs(tmp_path / "link")[1]) == 2


def test_a_mesh_opens_no_file_but_buffers_beside_it(good, tmp_path, monkeypatch):
    folder = tmp_path / "in"
    folder.mkdir()
    for name in ("a.obj", "b.ply", "a.gltf"):
        shutil.copy(good / name, folder)
    for place in (folder, tmp_path):
        (place / "x.mtl").write_text("newmtl a\nmap_Kd x.png\n")
        (place / "x.png").write_bytes(b"secret")
        (place / "gltf_buffer_0.bin").write_bytes((good / "gltf_buffer_0.bin").read_bytes())
        (place / "gltf_buffer_1.bin").write_bytes((good / "gltf_buffer_1.bin").read_bytes())
    obj, ply, gltf = ((folder / name).read_text() for name in ("a.obj", "b.ply", "a.gltf"))
    files = {"a.gltf": gltf}
    for i, path in enumerate(("../x.mtl", "x.mtl", f"{tmp_path / 'x.mtl'}")):
        files[f"{i}.obj"] = f"mtllib {path}\nusemtl a\n{obj}"
        files[f"{i}.ply"] = ply.replace("comment", f"comment TextureFile {path}\ncomment", 1)
    for name, text in files.items():
        (folder / name).write_text(text)
    opened = watch_opening(monkeypatch)
    for name in files:
        ds.exchange.read_mesh(folder / name, CAMERA)
    found = {path for path in opened if path.startswith(f"{tmp_path}")}
    buffers = {f"{folder / f'gltf_buffer_{i}.bin'}" for i in (0, 1)}
    assert found == {f"{folder / name}" for name in files} | buffers
    (folder / "gltf_buffer_0.bin").unlink()  # by its name alone it would be found here
    (folder / "b.gltf").write_text(gltf.replace("gltf_buffer_0", "../gltf_buffer_0"))
    with pytest.raises(ValueError, match=r"b\.gltf cannot be read as glTF 2\.0: there is no buffer .*gltf_buffer_0"):
        ds.exchange.read_mesh(folder / "b.gltf", CAMERA)


class Touch:
    """What makes a file when it is unpickled."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return open, (f"{self.path}", "w")


def test_nothing_is_unpickled(tmp_path):
    evil = pickle.dumps(Touch(tmp_path / "made"))
    np.save(tmp_path / "o.npy", np.array([Touch(tmp_path / "made")]), allow_pickle=True)
    (tmp_path / "p.npy").write_bytes(evil)
    array = {"zarr_format": 2, "shape": [1, 1], "chunks": [1, 1], "dtype": "<f8", "fill_value": 0, "order": "C"}
    codec, delta = {"id": "pickle"}, {"id": "delta", "dtype": "<f8"}
    for name, of in {
        "c": {"compressor": codec, "filters": None},
        "f": {"compressor": None, "filters": [delta, codec]},
        "o": {"compressor": None, "filters": [codec], "dtype": "|O"},
    }.items():
        (tmp_path / f"{name}.zarr").mkdir()
        (tmp_path / f"{name}.zarr" / ".zarray").write_text(json.dumps(array | of))
        (tmp_path / f"{name}.zarr" / "0.0").write_bytes(evil)
    for path in [*tmp_path.glob("*.npy"), *tmp_path.glob("*.zarr")]:
        for read in (ds.read_image, first_rows)[path.suffix == ".zarr" :]:
            with pytest.raises((ValueError, OSError)):
                read(path)
    assert not (tmp_path / "made").exists()


@pytest.mark.slow
def test_any_file_for_half_an_hour(good):
    end, rounds = time.monotonic() + float(os.environ.get("DIFFSHADE_FUZZ_SECONDS", "1800")), 0
    while time.monotonic() < end:
        rounds += 1
        for name in OTHERS:
            fuzz(name, good, 200, start=rounds)
    print(f"{200 * rounds} files of each of {len(OTHERS)} kinds")
