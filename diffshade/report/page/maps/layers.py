"""Layers: numbers of every texel as integers of a few bits, in lossless WebP files that a browser decodes."""

from __future__ import annotations

import base64
import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, UInt16

from ....io.image_formats import encode
from .numbers import Numbers

LIMIT = 33e6  # bytes of all layers, which base64 makes 4/3 of
LINEAR, SQUARE, SIGNED_SQUARE, LOGARITHMIC = range(4)  # as `decode.glsl` has them
UNKNOWN_ERROR = 255  # where an error is infinite: the level above those of numbers
ERRORS = (("k_d", "k_s", "normal"), ("n_s", "height", "residual"))  # three to a layer


class Quality(NamedTuple):
    """How finely numbers are kept."""

    most_texels: float
    geometry: int
    """Bits of a normal's two numbers and of a height."""
    coefficients: int
    beyond: int
    """Bits of the light beyond the model."""
    parts: int
    """How many parts of the light beyond the model are kept at least, the largest first."""
    coarser: int
    """How many texels a number of the light beyond the model, or an error, is wide."""


QUALITIES = (
    Quality(1 << 19, geometry=16, coefficients=12, beyond=12, parts=9, coarser=1),
    Quality(1 << 21, geometry=14, coefficients=10, beyond=10, parts=6, coarser=2),
    Quality(np.inf, geometry=12, coefficients=8, beyond=8, parts=3, coarser=2),
    Quality(np.inf, geometry=12, coefficients=8, beyond=8, parts=3, coarser=4),
)


@dataclass(frozen=True)
class Channel:
    """How an integer from 0 to `steps` becomes a number, by one of four curves of t, from 0 to 1.

    The curves are low + (high - low) t; high t^2; high s |s| with s = 2 t - 1; low (high / low)^t.
    """

    curve: int
    steps: int
    """The integer of t = 1; even, so that s = 0 is one of them."""
    low: float
    high: float

    @property
    def bits(self) -> int:
        """How many bits an integer has."""
        return self.steps.bit_length()

    def quantised(self, value: Float[np.ndarray, "..."]) -> UInt16[np.ndarray, "..."]:
        """Return the nearest integers."""
        if self.curve == LINEAR:
            t = (value - self.low) / (self.high - self.low)
        elif self.curve == SQUARE:
            t = np.sqrt(np.maximum(value, 0.0) / self.high)
        elif self.curve == SIGNED_SQUARE:
            t = 0.5 + 0.5 * np.sign(value) * np.sqrt(np.abs(value) / self.high)
        else:
            t = np.log(np.maximum(value, self.low) / self.low) / np.log(self.high / self.low)
        return np.rint(np.clip(t, 0.0, 1.0) * self.steps).astype(np.uint16)

    def number(self, integer: UInt16[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        """Return the numbers of integers."""
        t = integer / self.steps
        if self.curve == LINEAR:
            return self.low + (self.high - self.low) * t
        if self.curve == SQUARE:
            return self.high * t**2
        if self.curve == SIGNED_SQUARE:
            return self.high * (2.0 * t - 1.0) * np.abs(2.0 * t - 1.0)
        return self.low * (self.high / self.low) ** t


@dataclass(frozen=True, eq=False)
class Layer:
    """Up to three numbers of every texel as integers."""

    name: str
    channels: tuple[Channel, ...]
    integers: UInt16[np.ndarray, "h w 3"]
    coarser: int = 1
    """How many texels a number is wide."""

    @property
    def numbers(self) -> Float[np.ndarray, "h w _"]:
        """What the browser finds in it."""
        each = (channel.number(self.integers[..., i]) for i, channel in enumerate(self.channels))
        return np.stack(list(each), -1)

    def planes(self) -> list[bytes]:
        """Return files of the low bytes and, where an integer has more than 8 bits, of the high ones."""
        high = encode(".webp", (self.integers >> 8).astype(np.uint8))
        low = encode(".webp", (self.integers & 255).astype(np.uint8))
        return [low] if max(channel.bits for channel in self.channels) <= 8 else [low, high]

    def about(self) -> dict[str, Any]:
        """Return what decodes it, ready for JSON."""
        channels = [*self.channels, *[Channel(LINEAR, 254, 0.0, 1.0)] * (3 - len(self.channels))]
        return {
            "name": self.name,
            "size": self.integers.shape[1::-1],
            "coarser": self.coarser,
            "curve": [channel.curve for channel in channels],
            "steps": [channel.steps for channel in channels],
            "low": [channel.low for channel in channels],
            "high": [channel.high for channel in channels],
        }


def layers_of(numbers: Numbers, step: float | None) -> tuple[list[Layer], dict[str, list[str]]]:
    """Return the layers, and the files of each by its name in base64, as finely as the size of a page allows.

    Args:
        numbers: Of the texels.
        step: To what the light beyond the model is rounded, as a reflectance, in a page that is light; None keeps all
            that fits.
    """
    fitting = [quality for quality in QUALITIES if numbers.status.size <= quality.most_texels]
    if step is not None:
        fitting = [fitting[-2]._replace(coarser=1), *fitting[-2:]]
    layers, files = _encoded(numbers, fitting[0], step)
    for quality in fitting[1:]:
        if _size(files) <= LIMIT:
            break
        layers, files = _encoded(numbers, quality, step)
    encoded = {name: [base64.b64encode(file).decode("ascii") for file in planes] for name, planes in files.items()}
    return layers, encoded


def _encoded(numbers: Numbers, quality: Quality, step: float | None) -> tuple[list[Layer], dict[str, list[bytes]]]:
    """Return the layers and their files, with as many parts of the light beyond the model as fit."""
    layers = list(_layers(numbers, quality))
    files = {layer.name: layer.planes() for layer in layers}
    for k, layer in enumerate(_parts(numbers, quality, step)):
        planes = layer.planes()
        if k >= quality.parts and _size(files) + sum(map(len, planes)) > LIMIT:
            break
        layers.append(layer)
        files[layer.name] = planes
    return layers, files


def _size(files: Mapping[str, Sequence[bytes]]) -> int:
    return sum(len(file) for planes in files.values() for file in planes)


def _layers(numbers: Numbers, quality: Quality) -> Iterator[Layer]:
    inside, bits = numbers.inside, quality.coefficients
    height = np.zeros(inside.shape) if numbers.height is None else numbers.height
    octahedral = Channel(LINEAR, _steps(quality.geometry), -1.0, 1.0)
    heights = _channel(LINEAR, quality.geometry, height[inside])
    geometry = np.concatenate([folded(numbers.normal), height[..., None]], -1)
    yield _layer("geometry", geometry, (octahedral, octahedral, heights), inside)
    for name in ("k_d", "k_s", "own"):
        value = getattr(numbers, name)
        # one range for all channels, so that what is grey stays grey
        yield _layer(name, value, (_channel(SQUARE, bits, value[inside]),) * 3, inside)
    index = np.stack([numbers.n_s, numbers.status, numbers.region], -1)
    counts = Channel(LINEAR, 254, 0.0, 254.0)
    yield _layer("index", index, (_channel(LOGARITHMIC, bits, numbers.n_s[numbers.n_s > 0.0]), counts, counts), inside)
    for i, names in enumerate(ERRORS):
        yield _error_layer(f"errors{i}", names, numbers, quality.coarser)


def _parts(numbers: Numbers, quality: Quality, step: float | None) -> Iterator[Layer]:
    """Yield the parts of the light beyond the model, the largest first; with a step, all but the last that are 0."""
    if numbers.beyond is None:
        return
    inside, last = numbers.inside, numbers.beyond.shape[-1]
    everywhere = np.ones_like(thinned(inside, quality.coarser))  # 0 outside: the page interpolates
    if step is not None:
        seen = np.abs(numbers.beyond[inside]).max((0, 1)) > 0.5 * step
        last = int(np.flatnonzero(seen).max(initial=0)) + 1
    for k in range(last):
        part = thinned(np.where(inside[..., None], numbers.beyond[..., k], 0.0), quality.coarser)
        reach = _channel(SIGNED_SQUARE, quality.beyond, part) if step is None else _even(step, part)
        yield dataclasses.replace(_layer(f"beyond{k}", part, (reach,) * 3, everywhere), coarser=quality.coarser)


def _even(step: float, values: Float[np.ndarray, "..."]) -> Channel:
    """Return a channel of steps of one size, with 0 in the middle."""
    largest = float(np.abs(values).max())
    step = max(step, 2.0 * largest / _steps(16))
    most = max(int(np.ceil(largest / step)), 1)
    return Channel(LINEAR, 2 * most, -most * step, most * step)


def _error_layer(name: str, names: Sequence[str], numbers: Numbers, coarser: int) -> Layer:
    inside = thinned(numbers.inside, coarser)
    channels, integers = [], []
    for of in names:
        error = thinned(np.asarray(numbers.errors.get(of, np.zeros(numbers.status.shape))), coarser)
        known = inside & np.isfinite(error)
        positive = error[known & (error > 0.0)]
        ends = np.quantile(positive, (0.01, 0.99)) if positive.size else np.array([1.0, 2.0])
        channel = Channel(LOGARITHMIC, 254, float(ends[0]), float(max(ends[1], 1.01 * ends[0])))
        channels.append(channel)
        integers.append(np.where(known, channel.quantised(np.where(known, error, 1.0)), UNKNOWN_ERROR))
    return Layer(name, tuple(channels), np.stack(integers, -1).astype(np.uint16), coarser)


def _channel(curve: int, bits: int, values: Float[np.ndarray, "..."]) -> Channel:
    """Return a channel that holds these values."""
    values = values[np.isfinite(values)]
    low, high = (float(values.min()), float(values.max())) if values.size else (0.0, 1.0)
    if curve in (SQUARE, SIGNED_SQUARE):
        return Channel(curve, _steps(bits), 0.0, max(abs(low), abs(high)) or 1.0)
    low = max(low, 1e-3) if curve == LOGARITHMIC else low
    return Channel(curve, _steps(bits), low, high if high > low else low + 1.0)


def _steps(bits: int) -> int:
    return (1 << bits) - 2


def _layer(name: str, value: np.ndarray, channels: tuple[Channel, ...], inside: np.ndarray) -> Layer:
    integers = [channel.quantised(value[..., i]) for i, channel in enumerate(channels)]
    return Layer(name, channels, np.where(inside[..., None], np.stack(integers, -1), 0).astype(np.uint16))


def thinned(image: np.ndarray, factor: int) -> np.ndarray:
    """Return every `factor`-th texel of every `factor`-th row, from the middle of the squares that they stand for."""
    return image[factor // 2 :: factor, factor // 2 :: factor] if factor > 1 else image


def folded(normal: Float[np.ndarray, "h w 3"]) -> Float[np.ndarray, "h w 2"]:
    """Return unit vectors as points of a square: an octahedron unfolded (Cigolle et al. 2014)."""
    p = normal / np.maximum(np.abs(normal).sum(-1, keepdims=True), 1e-12)
    x, y, z = np.moveaxis(p, -1, 0)
    signs = np.where(p[..., :2] >= 0.0, 1.0, -1.0)
    return np.where((z < 0.0)[..., None], (1.0 - np.abs(np.stack([y, x], -1))) * signs, np.stack([x, y], -1))


def unfolded(square: Float[np.ndarray, "h w 2"]) -> Float[np.ndarray, "h w 3"]:
    """Return the unit vectors of points of the square."""
    z = 1.0 - np.abs(square).sum(-1, keepdims=True)
    signs = np.where(square >= 0.0, 1.0, -1.0)
    xy = np.where(z < 0.0, (1.0 - np.abs(square[..., ::-1])) * signs, square)
    vector = np.concatenate([xy, z], -1)
    return vector / np.linalg.norm(vector, axis=-1, keepdims=True)
