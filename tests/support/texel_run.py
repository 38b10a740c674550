"""A long run of `fit_texels` on photographs that are made as they are read, to be killed, limited and shared by tests.

python texel_run.py FOLDER HEIGHT WIDTH VIEWS SHARE [--memory BYTES] [--processes N --process I --port P]
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from pathlib import Path

import numpy as np

import diffshade as ds

sys.path.insert(0, str(Path(__file__).parent))
from memory import watched
from textured import lights_about


class Photograph:
    """A photograph of a plane of many colours, made row by row as it is read."""

    dtype = np.dtype(np.float32)
    ndim = 3

    def __init__(self, light: np.ndarray, shape: tuple[int, int]):
        self.light, self.shape = light, (*shape, 3)

    def __getitem__(self, rows: slice) -> np.ndarray:
        first, last, _ = rows.indices(self.shape[0])
        row, column = (
            np.arange(first, last, dtype=np.float32)[:, None],
            np.arange(self.shape[1], dtype=np.float32)[None],
        )
        wave = 0.5 + 0.25 * np.sin(0.37 * row + 0.11 * column)
        shine = np.float32(max(self.light[2], 0.0)) ** (np.float32(20.0) + 10.0 * wave)
        image = np.empty((last - first, self.shape[1], 3), np.float32)
        for channel, colour in enumerate((0.7, 0.4, 0.2)):
            image[..., channel] = colour * wave * self.light[2] + 0.3 * shine
        noise = np.sin((row * 12.9898 + column * 78.233 + 37.7 * self.light[0]) * np.float32(43758.5453))
        return image + np.float32(0.003) * noise[..., None].astype(np.float32)


def problem(height: int, width: int, count: int, share: float) -> tuple[ds.Scene, list[ds.View]]:
    """Return a plane under lights about it, and the views; `share` of the columns count."""
    lights = lights_about(count)
    camera = ds.OrthographicCamera((0.0, 0.0, 1.0), shape=(height, width), local_viewer=False)
    mask = np.zeros((height, width), bool)
    mask[:, : max(int(share * width), 1)] = True
    scene = ds.Scene(ds.Object(ds.Plane((0, 0, 0), (0, 0, 1))), [ds.DirectionalLight(-l) for l in lights])
    return scene, [ds.View(Photograph(l, (height, width)), camera, mask, lit=(i,)) for i, l in enumerate(lights)]


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("folder")
    for name, kind in (("height", int), ("width", int), ("views", int), ("share", float)):
        parser.add_argument(name, type=kind)
    parser.add_argument("--memory", type=int, default=1 << 25)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--process", type=int, default=0)
    parser.add_argument("--port", type=int, default=0)
    given = parser.parse_args()
    mesh = None
    if given.processes > 1:
        import jax

        jax.distributed.initialize(f"127.0.0.1:{given.port}", given.processes, given.process)
        mesh = jax.sharding.Mesh(np.array(jax.devices()), ("lane",))
    scene, views = problem(64, given.width, given.views, given.share)
    ds.fit_texels(scene, views, memory=given.memory)  # so that what follows compiles nothing
    scene, views = problem(given.height, given.width, given.views, given.share)
    print("begin", flush=True)
    begun = time.monotonic()
    grown, maps = watched(lambda: ds.fit_texels(scene, views, out=given.folder, memory=given.memory, devices=mesh))
    size = sum(4 * np.prod(view.image.shape) for view in views)
    print(f"grown {grown} of {size}, {time.monotonic() - begun:.1f} s", flush=True)
    print(f"determined {int(maps.determined.sum())}", flush=True)
    sys.stdout.flush()
    if given.processes > 1:
        os._exit(0)


if __name__ == "__main__":
    main()
