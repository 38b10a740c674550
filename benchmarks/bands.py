"""Time a ball of 31 bands beside one of red, green and blue: a render, and a fit of k_a, k_d, k_s and n_s, a channel.

Usage: python benchmarks/bands.py [--pixels 256] [--rounds 9]
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any

import numpy as np
from timing import conditions, medians, ratio, take_turns

import diffshade as ds

WAVELENGTHS = np.arange(400, 701, 10)
SIGMA = 0.002


def ball(bands: np.ndarray | None) -> ds.Scene:
    """A ball whose k_d and k_s differ from channel to channel."""
    k_d, k_s = np.random.default_rng(0).uniform(0.1, 0.6, (2, 3 if bands is None else len(bands)))
    material = ds.Material(0.1, k_d, k_s, 30)
    return ds.Scene(ds.Object(ds.Sphere(), material), ds.PointLight((2, 3, 4)), bands=bands)


def programs(pixels: int) -> dict[str, dict[str, Callable[[], Any]]]:
    """Return what is timed: a render and a fit, of 31 bands and of RGB."""
    camera = ds.Camera(eye=(0, 0, 4), fov=32, shape=(pixels, pixels))
    rng = np.random.default_rng(1)
    found: dict[str, dict[str, Callable[[], Any]]] = {"render": {}, "fit": {}}
    for name, bands in (("31 bands", WAVELENGTHS), ("RGB", None)):
        scene = ball(bands)
        image = np.asarray(ds.render(scene, camera), np.float64)
        view = ds.View(image + rng.normal(0.0, SIGMA, image.shape), camera)
        found["render"][name] = lambda scene=scene: ds.render(scene, camera)
        found["fit"][name] = lambda scene=scene, view=view: (
            ds.fit(scene, view, free=("k_a", "k_d", "k_s", "n_s")).values
        )
    return found


def band_ratios(pixels: int = 256, rounds: int = 9) -> dict[str, float]:
    """Return the time of a band over that of a channel of RGB."""
    found = {}
    for what, of in programs(pixels).items():
        seconds = take_turns(of, rounds, what)
        found[f"bands, {what} {pixels}: a band of 31 / a channel of RGB"] = ratio(seconds, "31 bands", "RGB") * 3 / 31
        print(", ".join(f"{what} of {name} {1e3 * t:.1f} ms" for name, t in medians(seconds).items()))
    return found


def main() -> None:
    """Print the ratios."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pixels", type=int, default=256, help="side of the image")
    parser.add_argument("--rounds", type=int, default=9)
    asked = parser.parse_args()
    print(conditions())
    for name, value in band_ratios(asked.pixels, asked.rounds).items():
        print(f"{name}: {value:.2f}")


if __name__ == "__main__":
    main()
