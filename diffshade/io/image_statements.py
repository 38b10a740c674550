"""Statements: the encoding and the orientation that an image file states, from its header.

PNG: the chunks cICP, iCCP, sRGB, gAMA and cHRM, in this order of precedence (PNG, section 4.3), and eXIf. JPEG, TIFF,
WebP and HEIC: the ICC profile, else EXIF ColorSpace; HEIC also the codes of its video codec. OpenEXR and Radiance: the
primaries. What BMP, TGA and Radiance state of a curve is said and not used. Each part is read apart from the others: a
damaged one is said, and does not hide them.
"""

from __future__ import annotations

import mmap
import struct
import warnings
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from PIL.ExifTags import IFD, Base

from ..core.extras import needing
from .encodings import ADOBE, LINEAR, PRIMARIES, SRGB, Encoding, encoding, power, xyz_of
from .heic_files import SUFFIXES as HEIC_SUFFIXES
from .heic_files import opened_heic, orientation_of_heic
from .icc_profiles import encoding_of_profile, profile_name
from .image_headers import radiance_header, tags_of_tiff
from .parsing import LARGEST
from .raw_files import SUFFIXES as RAW_SUFFIXES
from .raw_files import orientation_of_raw

# Codes of ITU-T H.273 for primaries, and for the curves that are those of a picture, not of a broadcast.
CODED_PRIMARIES = {1: "the primaries of sRGB", 9: "BT.2020", 12: "Display P3"}
CODED_CURVES = {8: LINEAR.curves, 13: SRGB.curves}


class Statement(NamedTuple):
    """What a file states."""

    encoding: Encoding | None = None
    unused: str = ""
    """What it states of its encoding that is not used, as the object of a sentence."""
    orientation: int = 1
    """How the stored picture is turned, 1 to 8, as in EXIF and TIFF (tag 274)."""
    size: tuple[int, int] | None = None
    """Height and width as stored, where the file can be turned."""


def statement_of(path: Path) -> Statement:
    """Return what a file states; nothing for a damaged file, which its reader names."""
    suffix = path.suffix.lower()
    try:
        if suffix in RAW_SUFFIXES:
            orientation, size = orientation_of_raw(path)
            return Statement(orientation=orientation, size=size)
        with warnings.catch_warnings():  # of Pillow about damaged EXIF
            warnings.simplefilter("ignore", UserWarning)
            return _READERS[suffix](path) if suffix in _READERS else Statement()
    except ImportError:
        raise
    except Exception:
        return Statement()


def _of_png(path: Path) -> Statement:
    from PIL import Image

    chunks = _chunks_of_png(path)
    exif: Any = Image.Exif()
    width, height = struct.unpack_from(">II", chunks[b"IHDR"])
    if b"eXIf" in chunks:
        exif = _or(None, lambda: exif.load(chunks[b"eXIf"]) or exif)
    where = next((of for name, of in ((b"cICP", "a cICP"), (b"iCCP", "an iCCP")) if name in chunks), "a gAMA or cHRM")
    stated, unused = _or((None, f"{where} chunk that is damaged"), lambda: _colours_of_png(chunks, exif))
    return Statement(
        stated, unused or ("EXIF that is damaged" if exif is None else ""), _orientation(exif), (height, width)
    )


def _chunks_of_png(path: Path) -> dict[bytes, bytes]:
    """Return the chunks of a PNG but its pixels, which are not read."""
    chunks: dict[bytes, bytes] = {}
    with path.open("rb") as file:
        file.seek(8)
        while len(head := file.read(8)) == 8 and head[4:] != b"IEND":
            length, name = struct.unpack(">I4s", head)
            if name in (b"IHDR", b"cICP", b"iCCP", b"sRGB", b"gAMA", b"cHRM", b"eXIf"):
                chunks.setdefault(name, file.read(length))
                length = 0
            file.seek(length + 4, 1)
    return chunks


def _colours_of_png(chunks: Mapping[bytes, bytes], exif: Any) -> tuple[Encoding | None, str]:
    if b"cICP" in chunks:
        primaries, curve, _, full = chunks[b"cICP"]
        return _coded(primaries, curve, "cICP chunk", full=bool(full))
    if b"iCCP" in chunks:
        packed = chunks[b"iCCP"].split(b"\0", 1)[1][1:]  # a name, the method 0, deflated bytes
        return _profiled(zlib.decompressobj().decompress(packed, LARGEST))
    if b"sRGB" in chunks:
        return SRGB, ""
    primaries = None
    if b"cHRM" in chunks:
        white, colours = (chunks[b"cHRM"][i:j] for i, j in ((0, 8), (8, 32)))
        primaries = [n / 1e5 for n in struct.unpack(">8I", colours + white)]
    if b"gAMA" not in chunks:
        stated, unused = _of_exif(exif)
        other = primaries is not None and encoding("", LINEAR.curves, xyz_of(primaries)).to_srgb is not None
        return stated, unused or ("primaries other than sRGB's without a curve (cHRM chunk)" if other else "")
    gamma = 1e5 / struct.unpack(">I", chunks[b"gAMA"])[0]
    found = encoding(f"gamma {gamma:.3g}", (power(gamma),), None if primaries is None else xyz_of(primaries))
    # 1/2.2 and the primaries of sRGB are how PNG, section 11.3.2.5, says sRGB to readers that do not know its chunk.
    return (SRGB if primaries is not None and found.to_srgb is None and abs(gamma - 2.2) < 1e-3 else found), ""


def _of_tiff(path: Path) -> Statement:
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        size = tags_of_tiff(data, (256, 257))
        damaged = {Base.Orientation: (0,)}
        turned = _or(damaged, lambda: tags_of_tiff(data, (Base.Orientation,))).get(Base.Orientation, (1,))[0]
        stated, unused = _colours_of_tiff(data)
    if not 1 <= turned <= 8:
        turned, unused = 1, unused or "an orientation that is damaged"
    return Statement(stated, unused, turned, (size[257][0], size[256][0]))


def _colours_of_tiff(data: Any) -> tuple[Encoding | None, str]:
    profile = _or(None, lambda: tags_of_tiff(data, (Base.InterColorProfile,)))
    if profile is None or profile:
        damaged = None, "a colour profile that is damaged"
        return _profiled(bytes(profile[Base.InterColorProfile])) if profile else damaged
    if _or({Base.TransferFunction: ()}, lambda: tags_of_tiff(data, (Base.TransferFunction,))):
        return None, "a curve in its tag TransferFunction"

    def of_camera() -> tuple[Encoding | None, str]:
        camera = tags_of_tiff(data, (IFD.Exif,))
        space = tags_of_tiff(data, (Base.ColorSpace,), camera[IFD.Exif][0]) if camera else {}
        return _colour_space(space.get(Base.ColorSpace, (None,))[0])

    return _or((None, "EXIF that is damaged"), of_camera)


def _of_pillow(path: Path) -> Statement:
    from PIL import Image

    with Image.open(path) as image:
        size, profile = (image.height, image.width), image.info.get("icc_profile")
        exif = _or(None, image.getexif)
    stated, unused = _profiled(profile) if profile else _of_exif(exif)
    return Statement(stated, unused, _orientation(exif), size)


def _of_bmp(path: Path) -> Statement:
    """Return what a header of version 4 or 5 says: its kind of colours, and the curves of the kind 0."""
    with path.open("rb") as file:
        head = file.read(122)
    if struct.unpack_from("<I", head, 14)[0] < 108:
        return Statement()
    kind = head[70:74]
    if kind in (b"DEBM", b"KNIL"):
        return Statement(unused="a colour profile")
    return Statement(unused="curves and primaries of its own" if kind == bytes(4) and any(head[110:122]) else "")


def _of_tga(path: Path) -> Statement:
    """Return what the extension area says of the curve (TGA 2.0, field 20)."""
    data = path.read_bytes()
    if data[-18:] != b"TRUEVISION-XFILE.\0" or not (at := struct.unpack_from("<I", data, len(data) - 26)[0]):
        return Statement()
    above, below = struct.unpack_from("<HH", data, at + 478)
    return Statement(unused="" if below == 0 or above in (0, below) else f"a gamma of {above / below:.3g}")


def _of_heic(path: Path) -> Statement:
    with opened_heic(path) as image:
        orientation, size, info = orientation_of_heic(path), (image.height, image.width), image.info  # size as shown
        exif = _or(None, image.getexif)
    if profile := info.get("icc_profile"):
        stated, unused = _profiled(profile)
    elif coded := info.get("nclx_profile"):
        stated, unused = _coded(coded["color_primaries"], coded["transfer_characteristics"], "nclx profile")
    else:
        stated, unused = _of_exif(exif)
    return Statement(stated, unused, orientation, size[::-1] if orientation > 4 else size)


def _of_exr(path: Path) -> Statement:
    with needing("exr", f"cannot read {path}"):
        import OpenEXR
    with OpenEXR.File(str(path), header_only=True) as file:
        return _of_primaries(file.header().get("chromaticities"))


def _of_radiance(path: Path) -> Statement:
    with path.open("rb") as file:
        header = radiance_header(file.read(2**16))
    return _of_primaries(header.primaries)._replace(unused=header.unused)


def _of_primaries(chromaticities: Any) -> Statement:
    """Return the statement of a linear file."""
    if chromaticities is None:
        return Statement()
    return Statement(encoding("linear in primaries of its own", LINEAR.curves, xyz_of(chromaticities)))


def _or(damaged: Any, read: Callable[[], Any]) -> Any:
    """Return what a part of a file says, or what stands for a damaged one, of which readers raise anything."""
    try:
        return read()
    except Exception:
        return damaged


def _profiled(profile: bytes) -> tuple[Encoding | None, str]:
    def read() -> tuple[Encoding | None, str]:
        stated = encoding_of_profile(profile)
        return stated, "" if stated else f"the colour profile '{profile_name(profile)}'"

    return _or((None, "a colour profile that is damaged"), read)


def _coded(primaries: int, curve: int, where: str, *, full: bool = True) -> tuple[Encoding | None, str]:
    if primaries in CODED_PRIMARIES and curve in CODED_CURVES and full:
        name = CODED_PRIMARIES[primaries]
        return encoding(name, CODED_CURVES[curve], xyz_of(PRIMARIES[name])), ""
    if curve in (2, 6) or (primaries, curve) == (1, 1):
        return None, ""  # not specified, or what encoders of video write unasked
    return None, f"the primaries {primaries} and the curve {curve} in its {where}"


def _of_exif(exif: Any) -> tuple[Encoding | None, str]:
    """Return what EXIF states; None for EXIF stands for damaged tags."""
    if exif is None:
        return None, "EXIF that is damaged"
    space = _or(None, lambda: exif.get_ifd(IFD.Exif).get(Base.ColorSpace))
    interoperable = _or(None, lambda: exif.get_ifd(IFD.Interop).get(1))
    return (ADOBE, "") if interoperable == "R03" else _colour_space(space)  # R03: the DCF's optional colour space


def _colour_space(stated: Any) -> tuple[Encoding | None, str]:
    known = {1: SRGB, 2: ADOBE}.get(stated)
    return known, "a colour space other than sRGB, not which (EXIF ColorSpace)" if stated == 0xFFFF else ""


def _orientation(exif: Any) -> int:
    found: Any = None if exif is None else exif.get(Base.Orientation)
    return found if found in range(1, 9) else 1


_READERS = {
    ".png": _of_png,
    ".exr": _of_exr,
    ".hdr": _of_radiance,
    **dict.fromkeys((".tif", ".tiff"), _of_tiff),
    ".bmp": _of_bmp,
    ".tga": _of_tga,
    **dict.fromkeys((".jpg", ".jpeg", ".webp"), _of_pillow),
    **dict.fromkeys(HEIC_SUFFIXES, _of_heic),
}
