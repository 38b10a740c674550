"""Lights found from all texels of real objects: how far off, and what the normals are under them.

Each folder is in DiLiGenT's layout with its normals. Its directions are made wrong by 3 degrees about each axis, its
intensities by 5 %; then both are found. After that nothing but the intensities is given. The true directions are those
of the folder, which are themselves not exact.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import equinox as eqx
import numpy as np
from rich.console import Console
from rich.table import Table

import diffshade as ds

DEGREES, RELATIVE = 3.0, 0.05
FREE = ("k_d", "k_s", "n_s", "normal")


def unit(v: np.ndarray) -> np.ndarray:
    """Return vectors of length 1."""
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def degrees(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the angles between unit vectors."""
    return np.rad2deg(2.0 * np.arcsin(np.clip(0.5 * np.linalg.norm(a - b, axis=-1), 0.0, 1.0)))


def main() -> None:
    """Print a row for each folder and for each thing that is known."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path, help="folders in DiLiGenT's layout, with normals")
    arguments = parser.parse_args()
    table = Table(
        "object", "known", "seconds", "lights off before", "after", "within 1.96 errors", "normals, mean", "median"
    )
    for folder in arguments.folders:
        scene, views = ds.read_photographs(folder, normals=False)
        shape, _ = ds.read_photographs(folder)
        truth, mask = np.asarray(shape.objects[0].surface.normal), np.asarray(scene.objects[0].surface.mask)  # pyright: ignore
        true = unit(np.array([-np.asarray(light.direction) for light in scene.lights]))  # pyright: ignore
        intensities = np.array([np.asarray(light.intensity) for light in scene.lights])  # pyright: ignore

        def with_lights(
            towards: np.ndarray, gain: np.ndarray, scene: ds.Scene = scene, intensities: np.ndarray = intensities
        ) -> ds.Scene:
            lamps = [ds.DirectionalLight(-l, g * i) for l, g, i in zip(towards, gain, intensities, strict=True)]
            return eqx.tree_at(lambda s: s.lights, scene, tuple(lamps))

        def normals(scene: ds.Scene, views: tuple = views, mask: np.ndarray = mask, truth: np.ndarray = truth) -> list:
            maps = ds.fit_texels(scene, views, free=FREE)
            off = degrees(maps.values["normal"][mask], truth[mask])
            return [f"{off.mean():.2f}", f"{np.median(off):.2f}"]

        random, ones = np.random.default_rng(0), np.ones(len(true))
        off = unit(true + np.deg2rad(DEGREES) * random.standard_normal(true.shape))
        gain = np.exp(RELATIVE * random.standard_normal(len(true)))
        table.add_row(folder.name, "the folder's lights", "", "", "", "", *normals(scene))
        wrong = with_lights(off, gain)
        table.add_row("", "3 degrees, 5 % off", "", "", "", "", *normals(wrong))
        nothing = with_lights(np.tile([0.0, 0.0, 1.0], (len(true), 1)), ones)
        for known, told, options in (
            ("to 3 degrees, 5 %", wrong, {"light_error": DEGREES, "intensity_error": RELATIVE}),
            ("intensities", nothing, {}),
        ):
            began = time.perf_counter()
            found = ds.lights.find_lights(told, views, **options)
            took = time.perf_counter() - began
            after = degrees(found.directions, true)
            before = f"{degrees(off, true).mean():.2f}" if options else ""
            # 1.96 errors about each of two axes hold 95 % where 2.45 of one length do
            within = f"{np.mean(after <= 2.45 * found.errors):.0%}" if options else "unknown"
            table.add_row(
                "", f"{known}, found", f"{took:.0f}", before, f"{after.mean():.2f}", within, *normals(found.scene)
            )
    Console(width=140).print(table)


if __name__ == "__main__":
    main()
