"""Check diffshade on a GPU, and time it there: renders beside the CPU's, then one table of renders, fits and texels.

`of the memory bound` is the share of the time in which a copy on the same device moves the bytes that the work reads
and writes at least once: 1 is as fast as memory lets it. A fit passes over its pixels some ten times.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from itertools import chain
from typing import NamedTuple

import compare_fits
import jax
import numpy as np
import problem
import shading
import texels
from timing import conditions, medians, ratio, take_turns

import diffshade as ds

GRADIENT = "diffshade, jax.grad"
PIXEL_OF_FIT = 49  # bytes: n.l, log cos, distance and three samples in float64, and a flag
FURTHEST = {np.float32: 1e-5, np.float64: 1e-12}  # from the CPU's picture, of a radiance of 1


class Sizes(NamedTuple):
    """Pixels on a side of renders and fits, blocks of texels, and rounds in which all take turns."""

    renders: tuple[int, ...] = (1024, 2048, 4096)
    fits: tuple[str, ...] = ("512x8", "2048x1")
    blocks: int = 512
    rounds: int = 15


SMALL = Sizes((128,), ("64x2",), 2, 3)


class Row(NamedTuple):
    """One line of the table."""

    what: str
    seconds: float
    items: float
    share: float | None


def main() -> None:
    """Check the renders, time everything, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rehearse", action="store_true", help="small sizes, on whatever device there is")
    rehearse = parser.parse_args().rehearse
    if jax.default_backend() != "gpu" and not rehearse:
        parser.error(
            f"JAX finds no GPU, only {jax.devices()[0]}. Install jax[cuda13], or give --rehearse to try it here."
        )
    sizes = SMALL if rehearse else Sizes()
    print(conditions())
    for kind, furthest in FURTHEST.items():
        print(f"renders, {np.dtype(kind).name}: {_off(kind, furthest):.1e} from the CPU's at most, {furthest} allowed")
    print(f"{'':50}{'ms':>10}{'millions a second':>20}{'of the memory bound':>22}")
    # each line when it is known, so that a run that is stopped has told something
    for what, seconds, items, share in chain(_renders(sizes), _fits(sizes), _texels(sizes)):
        bound = "" if share is None else f"{share:.2f}"
        print(f"{what:50}{1e3 * seconds:10.2f}{items / seconds / 1e6:20.3g}{bound:>22}", flush=True)


def _off(kind: type, furthest: float) -> float:
    """Return how far renders are from the CPU's at most; too far is an error."""
    scene = ds.Scene(
        [
            ds.Object(ds.Sphere(), ds.Material(k_a=0.05, k_d=(0.7, 0.25, 0.2), k_s=0.4, n_s=40)),
            ds.Object(
                ds.Box((1.2, -1.0, -0.5), (2.0, 0.2, 0.5)), ds.Material(k_d=0.6, k_s=0.3, n_s=200, lobe=ds.Blinn())
            ),
        ],
        [
            ds.PointLight((2, 3, 4), intensity=10, attenuation=ds.RadialAttenuation(1.0, 0.1, 0.5)),
            ds.DirectionalLight((1, -1, -1), intensity=0.3),
        ],
    )
    camera = ds.Camera(eye=(0, 0, 6), fov=35, shape=(256, 256))
    pictures = []
    for device in (jax.devices()[0], jax.devices("cpu")[0]):
        with jax.default_device(device), jax.enable_x64(kind is np.float64):
            made = jax.tree.map(lambda number: jax.numpy.asarray(number, kind), (scene, camera))
            pictures.append(np.asarray(ds.render(*made)))
    # where two surfaces meet, rounding decides which of them a pixel shows
    off = float(np.quantile(np.abs(pictures[0] - pictures[1]), 0.9999))
    if not off <= furthest:
        raise SystemExit(f"renders in {np.dtype(kind).name} are {off:.1e} from the CPU's: {furthest} is allowed.")
    return off


def _renders(sizes: Sizes) -> Iterator[Row]:
    for size in sizes.renders:
        copied = shading.BYTES * size**2
        made = shading.forward(size, compiled=False)
        seconds = take_turns({name: made[name] for name in (shading.CALL, shading.INSIDE, shading.COPY)}, sizes.rounds)
        rate = copied / medians(seconds)[shading.COPY]
        for name in (shading.CALL, shading.INSIDE):
            share = ratio(seconds, shading.COPY, name)
            yield Row(f"{name}, {size} x {size}", medians(seconds)[name], size**2, share)
        gradient = take_turns({GRADIENT: shading.gradient(size, compiled=False)[GRADIENT]}, sizes.rounds)
        least = (25 + 12) * size**2 / rate  # the G-buffer and the target
        spent = medians(gradient)[GRADIENT]
        yield Row(f"{GRADIENT}, {size} x {size}", spent, size**2, least / spent)


def _fits(sizes: Sizes) -> Iterator[Row]:
    for size in sizes.fits:
        pixels, views = map(int, size.split("x"))
        made = problem.make(pixels, views)
        started = time.perf_counter()
        fit = compare_fits.of_problem(made)
        print(f"ds.fit, {size}: the first takes {time.perf_counter() - started:.1f} s; {fit.counts.pixels:,} pixels")
        seconds = take_turns({"fit": lambda made=made: compare_fits.of_problem(made).values}, sizes.rounds // 3)
        copy = _copy_rate(PIXEL_OF_FIT * fit.counts.pixels)
        spent = medians(seconds)["fit"]
        share = PIXEL_OF_FIT * fit.counts.pixels / copy / spent
        yield Row(f"ds.fit, {views} views of {pixels} x {pixels}", spent, fit.counts.pixels, share)


def _copy_rate(size: int) -> float:
    """Return the bytes a second that a copy reads and writes."""
    source = jax.numpy.zeros(size // 8, np.float32)
    copy = jax.jit(lambda a, by: a + by)
    return size / medians(take_turns({"copy": lambda: copy(source, 1.0)}, 5))["copy"]


def _texels(sizes: Sizes) -> Iterator[Row]:
    for lights, channels in texels.CASES:
        p = texels.problem(lights, channels, sizes.blocks * texels.BLOCK)
        count = p.y.shape[-1]
        made = {texels.PROGRAM: texels.program(p), texels.CALL: lambda p=p: ds.fit_texels(p.scene, p.views)}
        for name, of in medians(take_turns(made, max(sizes.rounds // 5, 1))).items():
            yield Row(f"{name}, {lights * channels} observations", of, count, None)


if __name__ == "__main__":
    main()
