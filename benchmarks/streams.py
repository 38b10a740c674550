"""Show that fits of photographs larger than memory take time in proportion to the pixels, and flat memory.

`ds.fit`: one material from one view of a ball, 10 unknowns, photographs made row by row as they are read, of which an
even part fits into `memory`. `ds.fit_texels`: k_d, k_s and n_s at every texel from 12 grey views of a
plane, the maps written to files. Every count runs in a process of its own, after small ones that compile the programs;
memory is by how much the process's own (RssAnon) grows at most.

python benchmarks/streams.py [--most 100000000]
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

import diffshade as ds

COUNTS = (100_000, 1_000_000, 10_000_000, 100_000_000)
CALLS = ("fit", "fit_texels")
MEMORY = {"fit": 1 << 26, "fit_texels": 1 << 27}
NOISE = 37  # rows of noise, which come again
WIDTH = 1000


class Enlarged:
    """An image drawn larger with noise, made row by row as it is read."""

    def __init__(self, image: np.ndarray, height: int, width: int, seed: int):
        self.shape, self.dtype, self.ndim = (height, width, image.shape[2]), np.dtype(np.float32), 3
        self.row, column = (np.arange(n) * of // n for n, of in ((height, len(image)), (width, image.shape[1])))
        self.image = image.astype(np.float32)[:, column]
        self.noise = 0.005 * np.random.default_rng(seed).standard_normal((NOISE, width, 1)).astype(np.float32)

    def __getitem__(self, rows: slice) -> np.ndarray:
        index = np.arange(*rows.indices(self.shape[0]))
        return self.image[self.row[index]] + self.noise[index % NOISE]


def one_ball(pixels: int) -> Callable[[], Any]:
    """Return a fit of one material to a view with about so many pixels of a ball."""
    side = round((pixels / 0.66) ** 0.5)
    scene = ds.Scene(
        ds.Object(ds.Sphere(), ds.Material(k_a=0.1, k_d=(0.6, 0.4, 0.25), k_s=0.5, n_s=30)), ds.PointLight((2, 2, 3))
    )
    small, large = (ds.Camera(eye=(0, 0, 4), fov=32, shape=(n, n)) for n in (256, side))
    view = ds.View(Enlarged(np.asarray(ds.render(scene, small)), side, side, 0), large)
    return lambda: ds.fit(scene, view, free=("k_a", "k_d", "k_s", "n_s"), memory=MEMORY["fit"])


def many_texels(texels: int) -> Callable[[], Any]:
    """Return a fit of so many texels of a plane under 12 lights."""
    i = np.arange(12) + 0.5
    polar, azimuth = np.deg2rad(60 * np.sqrt(i / 12)), 2.4 * i
    l = np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], -1)
    scene = ds.Scene(ds.Object(ds.Plane((0, 0, 0), (0, 0, 1))), [ds.DirectionalLight(-d) for d in l])
    camera = ds.OrthographicCamera((0, 0, 1), shape=(texels // WIDTH, WIDTH), local_viewer=False)
    wave = 0.5 + 0.2 * np.sin(np.arange(100.0))[:, None, None] * np.ones((1, 50, 1))
    shine = 0.4 * l[:, 2, None, None, None] ** (20.0 + 10.0 * wave)
    images = [wave * z + s for z, s in zip(l[:, 2], shine, strict=True)]
    views = [ds.View(Enlarged(im, *camera.shape, k), camera, lit=k) for k, im in enumerate(images)]

    def run() -> None:
        with tempfile.TemporaryDirectory() as folder:
            ds.fit_texels(scene, views, memory=MEMORY["fit_texels"], out=Path(folder) / "maps")

    return run


def measure(call: str, count: int) -> dict[str, float]:
    """Return the seconds of a call whose programs are compiled, and by how many MB the process grew meanwhile."""
    from timing import memory

    make = {"fit": one_ball, "fit_texels": many_texels}[call]
    make(2 * COUNTS[0] if call == "fit" else COUNTS[0])()
    make(count if count <= COUNTS[1] else COUNTS[1])()
    run = make(count)
    before, most, over = memory("RssAnon"), 0.0, threading.Event()

    def watch() -> None:
        nonlocal most
        while not over.wait(0.01):
            most = max(most, memory("RssAnon"))

    watching = threading.Thread(target=watch)
    watching.start()
    begun = time.perf_counter()
    run()
    seconds = time.perf_counter() - begun
    over.set()
    watching.join()
    return {"seconds": seconds, "grown": most - before}


def main() -> None:
    """Run every count of both calls and print a table for each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--most", type=int, default=10_000_000, help="leave out counts above this (default: 10^7)")
    parser.add_argument("--only", choices=CALLS, nargs="+", default=CALLS, help="which call (default: both)")
    parser.add_argument("--one", nargs=2, metavar=("CALL", "COUNT"), help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.one:
        print(json.dumps(measure(arguments.one[0], int(arguments.one[1]))))
        return
    from slopes import growth, plain_slope
    from timing import conditions, in_a_process

    counts = [n for n in COUNTS if n <= arguments.most]
    if len(counts) < 3:
        sys.exit(f"--most must leave at least 3 counts; got {arguments.most}. Give 10000000 or more.")
    for call in arguments.only:
        found = {}
        for n in track(counts, description=call, console=Console(stderr=True), transient=True):
            found[n] = in_a_process(__file__, "--one", call, str(n))
        table = Table(title=f"ds.{call}, {conditions()}")
        for heading in ("pixels", "seconds", "ns a pixel", "MB grown"):
            table.add_column(heading, justify="right")
        for n, row in found.items():
            each = 1e9 * row["seconds"] / n
            table.add_row(f"{n:,}", f"{row['seconds']:.2f}", f"{each:,.0f}", f"{row['grown']:,.0f}")
        Console(width=110).print(table)
        n, t = np.array(counts, float), np.array([row["seconds"] for row in found.values()])
        a, b, s = growth(n, t)
        print(f"{a:.2f} s + {1e9 * b:.3g} ns x n^{s:.2f}; plain slope of the upper half {plain_slope(n, t):.2f}")


if __name__ == "__main__":
    main()
