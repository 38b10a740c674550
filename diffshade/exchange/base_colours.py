"""Base colours: what a picture, and the colours of vertices, multiply a material's colour by at each point."""

from __future__ import annotations

import dataclasses
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int, Shaped

from ..core.fields import Array
from ..core.thresholds import MOST
from ..io.encodings import srgb_decode
from ..io.gltf_files import beside, data_bytes, picture_bytes
from ..io.images import as_fractions, load_stored
from ..model.materials import Material

# The first bytes of a file's kinds.
STARTS = {b"\x89PNG": ".png", b"\xff\xd8\xff": ".jpg", b"RIFF": ".webp", b"BM": ".bmp"}
REPEAT, CLAMP, MIRROR = "repeat", "clamp", "mirror"  # what is beyond the edge of a picture
RANGE = np.iinfo(np.int32).min, np.iinfo(np.int32).max  # of the index of a pixel
Place = tuple[tuple[float, float, float], tuple[float, float, float]]


def place_of(*rows: Any) -> Place:
    """Return the place of a picture; refuse numbers that are none."""
    u, v = np.array(rows, float).tolist()
    if len(u) != 3 or not np.isfinite([*u, *v]).all():
        raise ValueError("a picture must be placed by finite numbers. Correct the file.")
    return (u[0], u[1], u[2]), (v[0], v[1], v[2])


class Texels(NamedTuple):
    """The pixels of a picture as they are stored, on the curve of sRGB (glTF 2.0, 3.9.2)."""

    stored: Shaped[np.ndarray, "h w c"]
    levels: Float[np.ndarray, " n"] | None
    """The linear colour of each number that is stored; None where these are floats."""

    @classmethod
    def of(cls, stored: Shaped[np.ndarray, "h w c"]) -> Texels:
        """Return pixels; those that are no integers become linear."""
        if stored.dtype.kind == "u":
            most = np.iinfo(stored.dtype).max
            return cls(stored, srgb_decode(np.arange(most + 1) / most))
        linear = stored.astype(np.float32)
        n = stored.shape[-1] - (stored.shape[-1] in (2, 4))
        linear[..., :n] = srgb_decode(linear[..., :n])
        return cls(linear, None)

    def at(self, row: Int[np.ndarray, "*s"], column: Int[np.ndarray, "*s"]) -> Float[np.ndarray, "*s 4"]:
        """Return the linear colours and alpha of pixels."""
        stored = self.stored[row, column]
        found = np.ones((*stored.shape[:-1], 4))
        if stored.shape[-1] in (2, 4):
            found[..., 3] = stored[..., -1] if self.levels is None else stored[..., -1] / (len(self.levels) - 1.0)
            stored = stored[..., :-1]
        found[..., :3] = stored if self.levels is None else self.levels[stored]
        return found


class ColourPicture(NamedTuple):
    """A picture that a material's file names or holds."""

    source: Path
    """The file of the material."""
    uri: str = ""
    """Its name there, in which it may be packed (data:)."""
    image: int = 0
    """Its number among the images of a glTF file that packs it without a name."""
    wrap: tuple[str, str] = (REPEAT, REPEAT)
    """What is beyond its edges, along u and along v."""
    nearest: bool = False
    """Whether a point has the colour of the nearest pixel, and not one between four of them."""
    place: Place = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    """From (u, v, 1) of the mesh to those of the picture."""

    @property
    def is_packed(self) -> bool:
        """Whether the file of the material holds the picture itself."""
        return not self.uri or self.uri.startswith("data:")

    def suffix_of(self, data: bytes) -> str:
        """Return the suffix of a file that holds its bytes: what the first of them are, else as it is named."""
        named = "" if self.is_packed else Path(self.uri).suffix.lower()
        return next((suffix for start, suffix in STARTS.items() if data.startswith(start)), named)

    def file(self) -> Path:
        """Return the file that it names: in the same folder or below it; of a longer path, by its last name too.

        Raises:
            ValueError: There is no such file.
        """
        name = self.uri.replace("\\", "/")  # as MTL of Windows has it
        try:
            return beside(name, self.source.parent, "picture")
        except ValueError as error:
            try:
                return beside(name.rpartition("/")[2], self.source.parent, "picture")
            except ValueError:
                raise error from None

    def read(self) -> bytes:
        """Return its bytes.

        Raises:
            ValueError: There is no such picture.
        """
        if self.uri.startswith("data:"):
            return data_bytes(self.uri)
        return self.file().read_bytes() if self.uri else picture_bytes(self.source, self.image)

    def stored(self, data: bytes) -> Shaped[np.ndarray, "h w c"]:
        """Return the numbers of its pixels, which its bytes hold: grey or colours, with alpha or without.

        Raises:
            ValueError: It cannot be read.
        """
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"picture{self.suffix_of(data)}"
            path.write_bytes(data)
            try:
                found = load_stored(path, orientation=1)
                as_fractions(path, found[:1])
                if found.shape[-1] > 4:
                    raise ValueError(f"cannot read {path}: it has {found.shape[-1]} bands. Give one of 1 to 4.")
                if found.dtype.kind == "f" and not ((found >= 0.0) & (found < np.inf)).all():
                    raise ValueError(f"cannot read {path}: a pixel is below 0 or not finite. Give it a colour.")
                return np.array(found) if isinstance(found, np.memmap) else found
            except (OSError, ImportError, ValueError) as error:
                called = "its picture" if self.is_packed else self.uri[:80]
                raise ValueError(f"{error}".replace(f"{path}", called)) from None

    def texels(self) -> Texels:
        """Return its pixels.

        Raises:
            ValueError: There is no such picture, or it cannot be read.
        """
        return Texels.of(self.stored(self.read()))

    def at(self, texels: Texels, uv: Float[np.ndarray, "*s 2"]) -> Float[np.ndarray, "*s 4"]:
        """Return the picture at texture coordinates, between the centres of four pixels; 1 where they are NaN."""
        known = np.asarray(np.isfinite(uv).all(-1))
        u, v = np.moveaxis(np.where(known[..., None], uv, 0.0) @ np.array(self.place)[:, :2].T, -1, 0)
        found = np.zeros((*known.shape, 4))
        corners = []
        for size, x, wrap, shift in zip(
            texels.stored.shape[1::-1], (u, v), self.wrap, np.array(self.place)[:, 2], strict=True
        ):
            x = np.clip(np.nan_to_num((x + shift) * size - 0.5), *RANGE)
            first = np.floor(x)
            part = x - first if not self.nearest else x - first >= 0.5
            corners.append([(_within(first.astype(int) + k, size, wrap), np.abs(1 - k - part)) for k in (0, 1)])
        for column, across in corners[0]:
            for row, down in corners[1]:
                found += texels.at(row, column) * (across * down)[..., None]
        return np.where(known[..., None], found, 1.0)


def _within(index: np.ndarray, size: int, wrap: str) -> np.ndarray:
    """Return the index of a pixel of a picture for one that may be beyond its edge."""
    if wrap == CLAMP:
        return np.clip(index, 0, size - 1)
    if wrap == MIRROR:
        index = index % (2 * size)
        return np.minimum(index, 2 * size - 1 - index)
    return index % size


class BaseColour(NamedTuple):
    """How a file colours the points of a material."""

    picture: ColourPicture | None = None
    fields: tuple[str, ...] = ("k_d",)
    """What of the material the colour multiplies."""
    metal: Float[np.ndarray, "3"] | float = 0.0
    """The share of the highlights that it multiplies as well: 1 for a metal."""
    alpha: float = 1.0
    cutoff: float | None = None
    """Alpha from which a point is there at all; None: every point is."""
    blends: bool = False
    """Whether 1 - alpha of the light passes."""

    @property
    def is_metal(self) -> bool:
        """Whether the colour is that of the highlights above all."""
        return self.fields == ("k_d",) and bool(np.all(np.asarray(self.metal) > MOST))


class Look:
    """A material with its base colour."""

    def __init__(self, material: Material, base: BaseColour, texels: Texels | None = None):
        self.material, self.base, self.texels = material, base, texels

    def is_of(self, path: Path) -> bool:
        """Whether its picture is the file at a path."""
        picture = self.base.picture
        if self.texels is None or picture is None or picture.is_packed:
            return False
        return path.exists() and path.samefile(picture.file())

    def colour(self, look: Float[np.ndarray, "*s 6"]) -> Float[np.ndarray, "*s 4"]:
        """Return the colour and alpha at points of these looks."""
        colour = np.clip(np.nan_to_num(look[..., 2:]), 0.0, 1.0)
        if self.texels is None or self.base.picture is None:
            return colour
        return colour * self.base.picture.at(self.texels, look[..., :2])

    def shows(self, look: Float[np.ndarray, "points 6"]) -> Any:
        """Return which points of these looks are there."""
        return self.colour(look)[:, 3] * self.base.alpha >= (self.base.cutoff or 0.0)

    def over(self, look: Float[np.ndarray, "h w 6"] | None) -> Material:
        """Return the material at pixels of these looks: its coefficients times the colour there."""
        if look is None or (self.texels is None and (look[..., 2:] == 1.0).all()):
            return self.material
        m, rgba = self.material, self.colour(look)
        colour, alpha = rgba[..., :3], rgba[..., 3:]
        tint = 1.0 - self.base.metal + self.base.metal * colour
        changed: dict[str, Any] = {name: _times(getattr(m, name), colour) for name in self.base.fields}
        if np.any(self.base.metal):
            changed["k_s"] = _times(m.k_s, tint)
            changed["highlights"] = tuple(dataclasses.replace(of, k_s=_times(of.k_s, tint)) for of in m.highlights)
        if self.base.blends:
            k_t = changed.get("k_t", m.k_t)
            changed["k_t"] = 1.0 - (1.0 - (0.0 if k_t is None else k_t)) * alpha * np.ones(3)
        return dataclasses.replace(m, **changed)


def _times(coefficient: Any, colour: Array) -> Any:
    """Return a coefficient times a colour; one that is 0 or None stays a single one."""
    return coefficient if coefficient is None or not np.any(coefficient) else coefficient * colour
