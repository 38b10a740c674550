"""What freeing directions, exposures, intensities and a second highlight takes off the residuals of real photographs.

One material is fitted to every other photograph of a folder in DiLiGenT's layout, and the others are predicted, under
the lights that the folder states. Relative RMSE is that over the root mean square of the photographs. The directions
are also fitted from two disjoint halves of the pixels, squares of 8 x 8 in turn: if they follow the lights and not what
the material leaves out, the two agree within 1.96 combined errors for 85 % of the lights, which is what two directions
of a light do whose errors are Gaussian and right.
"""

from __future__ import annotations

import argparse
import dataclasses
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import numpy as np
from rich.console import Console
from rich.table import Table

import diffshade as ds

MATERIAL = ("k_a", "k_d", "k_s", "n_s")
DEGREES, RELATIVE, SQUARE = 2.0, 0.05, 8
DIRECTIONS: dict[str, Any] = {"free": (*MATERIAL, "direction"), "light_error": DEGREES}
EXPOSURES: dict[str, Any] = {"priors": {"exposure": (1.0, RELATIVE)}}
VARIANTS: dict[str, dict[str, Any]] = {
    "the material": {"free": MATERIAL},
    "and directions": DIRECTIONS,
    "and exposures": {"free": (*MATERIAL, "exposure"), **EXPOSURES},
    "and intensities": {"free": (*MATERIAL, "intensity"), "intensity_error": RELATIVE},  # of each channel
    "and both": {"free": (*MATERIAL, "direction", "exposure"), "light_error": DEGREES, **EXPOSURES},
}


def relative_rmse(fit: ds.Fit, views: Sequence[ds.View]) -> np.ndarray:
    """Return the relative RMSE of each photograph."""
    found = [fit.predict(view) for view in views]
    return np.array([p.rmse / np.sqrt(np.mean(p.target[p.counts] ** 2)) for p in found])


def towards(scene: ds.Scene) -> np.ndarray:
    """Return the unit directions to the lights."""
    found = np.array([-np.asarray(light.direction, float) for light in scene.lights])  # pyright: ignore
    return found / np.linalg.norm(found, axis=-1, keepdims=True)


def degrees_between(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the angles between unit vectors."""
    return np.rad2deg(2.0 * np.arcsin(np.clip(0.5 * np.linalg.norm(one - other, axis=-1), 0.0, 1.0)))


def with_second_highlight(scene: ds.Scene) -> ds.Scene:
    """Return the scene with a second highlight to be fitted."""
    second = ds.Highlight(k_s=0.1, n_s=5.0)
    return eqx.tree_at(lambda s: s.objects[0].material.highlights, scene, (second,))


def halves(views: Sequence[ds.View]) -> list[list[ds.View]]:
    """Return the photographs with every other square of pixels, and with the others."""
    row, column = np.mgrid[: views[0].camera.shape[0], : views[0].camera.shape[1]] // SQUARE
    odd = (row + column) % 2 == 1
    masks = [np.ones(odd.shape, bool) if view.mask is None else np.asarray(view.mask) for view in views]
    return [
        [dataclasses.replace(view, mask=mask & (odd == which)) for view, mask in zip(views, masks, strict=True)]
        for which in (False, True)
    ]


def main() -> None:
    """Print the table, the photographs one by one, and how well the halves agree."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="folder of photographs in DiLiGenT's layout")
    parser.add_argument("--quick", action="store_true", help="without the second highlight, which takes minutes")
    arguments = parser.parse_args()
    scene, views = ds.read_photographs(arguments.folder)
    console, on = Console(width=120), [view.lit[0] for view in views if view.lit]
    table = Table("fitted", "seconds", "RMSE seen", "unseen", "lights moved: median", "most, degrees")
    of_view: dict[str, np.ndarray] = {}
    for name, options in VARIANTS.items():
        for with_second in (False, True) if name == "the material" and not arguments.quick else (False,):
            began = time.perf_counter()
            fit = ds.fit(with_second_highlight(scene) if with_second else scene, views[::2], **options)
            took = time.perf_counter() - began
            seen, unseen = (relative_rmse(fit, of) for of in (views[::2], views[1::2]))
            moved = degrees_between(towards(fit.scene), towards(scene))[on[::2]]
            label = f"{name}{', second highlight' if with_second else ''}"
            of_view[label] = np.stack([seen, unseen])
            rms = [f"{np.sqrt(np.mean(of**2)):.4f}" for of in (seen, unseen)]
            table.add_row(label, f"{took:.1f}", *rms, f"{np.median(moved):.2f}", f"{moved.max():.2f}")
            console.print(f"{label}: {took:.1f} s")
    console.print(table)
    base, both = of_view["the material"], of_view["and both"]
    each = Table("photograph", "seen", "and both freed", "photograph", "unseen")
    for k in range(base.shape[1]):
        each.add_row(f"{2 * k + 1}", f"{base[0, k]:.3f}", f"{both[0, k]:.3f}", f"{2 * k + 2}", f"{base[1, k]:.3f}")
    console.print(each)
    found = [ds.fit(scene, of, **DIRECTIONS) for of in halves(views)]
    apart = degrees_between(*(towards(fit.scene) for fit in found))[on]
    errors = []
    for fit in found:
        of_light = dict(zip(fit.names, fit.errors, strict=True))
        errors.append([[of_light[f"lights.{i}.direction.{axis}"] for axis in "xyz"] for i in on])
    per_axis = np.rad2deg(np.sqrt((np.array(errors) ** 2).sum(-1) / 2.0))  # of the two axes across the direction
    combined = np.sqrt((per_axis**2).sum(0))
    console.print(
        f"halves of the pixels: directions {np.median(apart):.3f} degrees apart in the median, combined errors "
        f"{np.median(combined):.3f}; {np.mean(apart <= 1.96 * combined):.0%} within 1.96 of them"
    )


if __name__ == "__main__":
    main()
