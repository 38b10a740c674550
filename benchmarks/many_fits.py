"""The time of many small fits under `jax.vmap`, beside a loop of `ds.fit`, and how many end above the truth's cost.

python benchmarks/many_fits.py [--fits 1000] [--side 32]

Grey photographs of a ball under two lights with noise of 0.01; k_a, k_d, k_s and n_s are drawn and found without a
start.
"""

from __future__ import annotations

import argparse
import time

import jax
import numpy as np
from timing import conditions

import diffshade as ds

FREE = ("k_a", "k_d", "k_s", "n_s")
LIGHTS = (ds.PointLight((2, 3, 4), 20, ds.RadialAttenuation(1, 0.1, 0.5)), ds.DirectionalLight((1, -1, -1), 0.3))
LOOPED = 20  # fits of the loop


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--fits", type=int, default=1000)
    parser.add_argument("--side", type=int, default=32)
    asked = parser.parse_args()
    random = np.random.default_rng(0)
    camera = ds.Camera(eye=(0, 0, 4), fov=35, shape=(asked.side, asked.side))
    told = ds.Scene(ds.Object(ds.Sphere(), ds.Material()), LIGHTS)
    drawn = np.exp(random.uniform(np.log((0.02, 0.2, 0.1, 3)), np.log((0.2, 0.8, 0.6, 200)), (asked.fits, 4)))
    scenes = [ds.Scene(ds.Object(ds.Sphere(), ds.Material(*of)), LIGHTS) for of in drawn]
    clean = np.stack([np.asarray(ds.render(scene, camera)).mean(-1) for scene in scenes])
    noise = random.normal(0, 0.01, clean.shape)
    images, inside = clean + noise, np.asarray(ds.intersect(told, camera).mask)
    of_truth = 0.5 * (noise[:, inside] ** 2).sum(-1)

    def loop() -> None:
        for image in images[:LOOPED]:
            ds.fit(told, ds.View(image, camera), free=FREE)

    with jax.enable_x64(True):
        many = jax.jit(jax.vmap(ds.fit_function(told, ds.View(images[0], camera), free=FREE)))
        found = many(images)
        together = best_of(5, lambda: jax.block_until_ready(many(images))) / asked.fits
    loop()
    alone = best_of(2, loop) / LOOPED
    print(conditions())
    print(f"{1e3 * together:.3f} ms each under vmap, {1e3 * alone:.1f} ms each by ds.fit: {alone / together:.0f} times")
    print(f"{(np.asarray(found.cost) > of_truth).sum()} of {asked.fits} end above the cost of the truth")


def best_of(times: int, run) -> float:
    """Return the shortest of some times."""
    took = []
    for _ in range(times):
        begin = time.perf_counter()
        run()
        took.append(time.perf_counter() - begin)
    return min(took)


if __name__ == "__main__":
    main()
