"""Views larger than memory, whose rows are made when they are read.

python generated.py SIZE MEMORY OUT fits 8 views of SIZE x SIZE and writes OUT.npz: the answer, and by how many bytes
the process's own memory (RssAnon) grew in the fit.
"""

from __future__ import annotations

import sys
from typing import Any

import jax
import numpy as np
import synthetic
from memory import watched

import diffshade as ds

FOV = 60.0  # the ball fills a sixth of a view
SMALL = ds.Camera(eye=(0, 0, 4), fov=FOV, shape=(64, 64))
NOISE = 37  # rows of noise, which come again


class Generated:
    """A render drawn larger, pixel by pixel, with noise: any slice of rows is the same numbers."""

    def __init__(self, render: np.ndarray, size: int, seed: int):
        self.shape, self.dtype, self.ndim = (size, size, 3), np.dtype(np.float32), 3
        self.row, column = (np.arange(size) * len(render) // size for _ in range(2))
        self.render = render.astype(np.float32)[:, column]
        self.noise = 0.005 * np.random.default_rng(seed).standard_normal((NOISE, size, 1)).astype(np.float32)

    def __getitem__(self, rows: slice) -> np.ndarray:
        index = np.arange(*rows.indices(self.shape[0]))
        return self.render[self.row[index]] + self.noise[index % NOISE]


def views(size: int) -> list[ds.View]:
    """Return 8 views of size x size, 96 size^2 bytes in all."""
    renders = synthetic.photographs(synthetic.standard_scene(), SMALL)
    camera = ds.Camera(eye=(0, 0, 4), fov=FOV, shape=(size, size))
    return synthetic.one_light_each([Generated(image, size, k) for k, image in enumerate(renders)], camera)


def fit(size: int, **options: Any) -> ds.Fit:
    """Fit k_d, k_s and n_s of the standard problem."""
    return ds.fit(synthetic.standard_scene(), views(size), free=("k_d", "k_s", "n_s"), **options)


def main() -> None:
    """Fit, and watch the memory meanwhile."""
    size, memory, out = int(sys.argv[1]), float(sys.argv[2]), sys.argv[3]
    jax.block_until_ready(jax.numpy.zeros(3))
    grown, found = watched(lambda: fit(size, memory=memory))
    np.savez(out, values=found.values, errors=found.plain_errors, pixels=found.counts.pixels, grown=grown)


if __name__ == "__main__":
    main()
