"""ICC profiles and files that state a curve, written by hand from the specifications."""

import io
import struct

import cv2
import numpy as np
from image_files import png_chunk
from PIL import Image

# XYZ of red, green and blue as columns, under D50, as the profiles of HP and Adobe have them.
SRGB_XYZ = np.array([[0.43607, 0.38515, 0.14307], [0.22249, 0.71687, 0.06061], [0.01392, 0.09708, 0.71410]])
ADOBE_XYZ = np.array([[0.60974, 0.20528, 0.14919], [0.31111, 0.62567, 0.06322], [0.01947, 0.06087, 0.74457]])
ADOBE_GAMMA = 563 / 256
EXIF_SRGB, EXIF_ADOBE, EXIF_OTHER = 1, 2, 0xFFFF


def _fixed(*numbers: float) -> bytes:
    return struct.pack(f">{len(numbers)}i", *(round(number * 65536) for number in numbers))


def gamma(value: float) -> bytes:
    return b"curv\0\0\0\0" + struct.pack(">IH", 1, round(value * 256))


def table(values) -> bytes:
    values = np.rint(np.asarray(values) * 65535).astype(">u2")
    return b"curv\0\0\0\0" + struct.pack(">I", len(values)) + values.tobytes()


def parametric(kind: int, *numbers: float) -> bytes:
    return b"para\0\0\0\0" + struct.pack(">HH", kind, 0) + _fixed(*numbers)


def profile(name: str, curve: bytes, xyz: np.ndarray | None = SRGB_XYZ, *, kind: bytes = b"") -> bytes:
    """Return a profile of one curve, and of primaries; without them a grey one. `kind` is another kind of colours."""
    described = b"desc\0\0\0\0" + struct.pack(">I", len(name) + 1) + name.encode() + bytes(1 + 78)
    white = b"XYZ \0\0\0\0" + _fixed(0.9642, 1, 0.8249)
    tags = [(b"desc", described), (b"cprt", b"text\0\0\0\0(none)\0"), (b"wtpt", white)]
    if xyz is None:
        tags += [(b"kTRC", curve)]
    else:
        tags += [(c + b"XYZ", b"XYZ \0\0\0\0" + _fixed(*of)) for c, of in zip((b"r", b"g", b"b"), xyz.T, strict=True)]
        tags += [(c + b"TRC", curve) for c in (b"r", b"g", b"b")]
    at = 132 + 12 * len(tags)
    entries, data = b"", b""
    for tag, body in tags:
        entries += tag + struct.pack(">II", at + len(data), len(body))
        data += body + bytes(-len(body) % 4)
    head = bytearray(128)
    head[:4] = struct.pack(">I", at + len(data))
    head[8:40] = b"\x02\x10\0\0mntr" + (kind or (b"GRAY" if xyz is None else b"RGB ") + b"XYZ ") + bytes(12) + b"acsp"
    head[24:36] = struct.pack(">6H", 2020, 1, 1, 0, 0, 0)
    head[68:80] = _fixed(0.9642, 1, 0.8249)
    return bytes(head) + struct.pack(">I", len(tags)) + entries + data


def chunk(data: bytes, kind: bytes, body: bytes) -> bytes:
    """Return a PNG with one more chunk, after its header."""
    return data[:33] + png_chunk(kind, body) + data[33:]


def chromaticities(*xy: float) -> bytes:
    """Return the body of cHRM: x y of white, red, green and blue."""
    return struct.pack(">8I", *(round(1e5 * number) for number in xy))


CHRM_SRGB = chromaticities(0.3127, 0.329, 0.64, 0.33, 0.3, 0.6, 0.15, 0.06)


def png(encoded: np.ndarray, bits: int, *chunks: tuple[bytes, bytes]) -> bytes:
    """Return a PNG of numbers from 0 to 1, with chunks."""
    full, dtype = (255, np.uint8) if bits == 8 else (65535, np.uint16)
    data = cv2.imencode(".png", np.rint(full * encoded).astype(dtype)[..., ::-1])[1].tobytes()
    for kind, body in chunks:
        data = chunk(data, kind, body)
    return data


def saved(encoded: np.ndarray, kind: str, **options) -> bytes:
    """Return a file of 8 bits as Pillow writes it."""
    file = io.BytesIO()
    more = {"JPEG": {"quality": 98, "subsampling": 0}, "WEBP": {"lossless": True}}.get(kind, {})
    Image.fromarray(np.rint(255 * encoded).astype(np.uint8)).save(file, kind, **more, **options)
    return file.getvalue()


def exif(*, orientation: int | None = None, space: int | None = None, interoperability: str | None = None) -> bytes:
    """Return EXIF that states an orientation or a colour space."""
    tags = Image.Exif()
    if orientation is not None:
        tags[0x0112] = orientation
    if space is not None:
        tags.get_ifd(0x8769)[0xA001] = space
    if interoperability is not None:
        tags.get_ifd(0x8769)[0xA005] = {1: interoperability}
    return tags.tobytes()
