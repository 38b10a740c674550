"""Show how the cost of a scene grows: with its lights, objects, area-light samples and pixels.

It is linear in lights, samples, pixels and opaque objects, and quadratic in transparent ones: behind each of them each
may come next. Beside it, under "infinity", what a viewer and a light at infinity save.

For each count the time of a render and of the gradient of its sum with respect to every number of the scene and the
camera: the median of several runs, compiled beforehand. `per unit` is the time of one more, (t - t of the row above)/(n
- n of the row above), over the same from the first to the last row: 1 throughout is a straight line. The exponent is
the slope of log t over log n in the upper half of the rows: 1 is linear; below 1, what does not depend on n still
counts. The gradients of several spheres are compiled without XLA's fusion, which takes minutes over them, and so are
renders of six transparent ones or more.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from pathlib import Path

import jax
import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table
from timing import medians, take_turns

import diffshade as ds

SIZE = 256
INFINITY = "infinity"
COUNTS = {
    "lights": (1, 2, 4, 8, 16, 32, 64),
    "samples of an area light": (1, 4, 16, 64, 256),
    "opaque spheres": (1, 2, 4, 8, 16, 32),
    "transparent spheres": (1, 2, 4, 8),
    "pixels": (128**2, 256**2, 512**2, 1024**2),
}
# of several objects XLA's CPU compiler fuses, and with it repeats, the reverse mode for minutes
UNFUSED = {"xla_disable_hlo_passes": "fusion"}


def main() -> None:
    """Time every count and print a table for each kind."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--only", nargs="+", choices=[*COUNTS, INFINITY], default=[*COUNTS, INFINITY], help="which to time"
    )
    parser.add_argument("--repeats", type=int, default=7, help="runs, of which the median counts (default: 7)")
    parser.add_argument("--size", type=int, default=SIZE, help="pixels on a side (default: %(default)s)")
    parser.add_argument("--json", type=Path, help="write every number to this file too")
    arguments = parser.parse_args()
    if arguments.repeats < 1 or arguments.size < 1:
        sys.exit(f"--repeats and --size must be at least 1; got {arguments.repeats} and {arguments.size}.")
    found = {}
    for kind in arguments.only:
        if kind == INFINITY:
            found[kind] = at_infinity(arguments.size, arguments.repeats)
            continue
        rows = []
        for count in track(COUNTS[kind], description=kind, console=Console(stderr=True), transient=True):
            scene, size = make(kind, count, arguments.size)
            options = UNFUSED if kind.endswith("spheres") else None
            rows.append((count, *times(scene, ds.Camera((0, 0, 6), shape=size), arguments.repeats, options)))
        found[kind] = rows
        show(kind, rows)
        if arguments.json:
            arguments.json.write_text(json.dumps(found, indent=1), encoding="utf-8")


def make(kind: str, count: int, size: int) -> tuple[ds.Scene, tuple[int, int]]:
    """Return the scene with a count of one kind, and its picture's shape."""
    shape = (round(count**0.5),) * 2 if kind == "pixels" else (size, size)
    lights = list(lamps(count if kind == "lights" else 1))
    if kind.startswith("samples"):
        n = round(count**0.5)
        lights = [ds.AreaLight((-1, 2, 2), (2, 0, 0), (0, 1, 1), attenuation=FADE, samples=(n, n))]
    spheres = count if kind.endswith("spheres") else 1
    k_t, eta = (0.6, 1.3) if kind.startswith("transparent") else (None, 1.0)
    return ds.Scene(list(balls(spheres, k_t, eta)), lights), shape


def at_infinity(size: int, repeats: int) -> list[tuple[str, str, float, float]]:
    """Time one v for all points and one l for all points, beside v and l from each; print and return the rows."""
    table = Table(title="viewer and light near or at infinity, one light")
    for heading in ("viewer", "light", "render, ms", "gradient, ms"):
        table.add_column(heading, justify="right")
    rows = []
    for viewer, local in (("near", True), ("at infinity", False)):
        camera = ds.OrthographicCamera((0, 0, 6), shape=(size, size), local_viewer=local)
        for light, lamp in (("near", ds.PointLight((0, 3, 3))), ("at infinity", ds.DirectionalLight((0, -1, -1)))):
            seconds = times(ds.Scene(list(balls(1, None, 1.0)), lamp), camera, repeats, None)
            rows.append((viewer, light, *seconds))
            table.add_row(viewer, light, *(f"{1e3 * t:.2f}" for t in seconds))
    Console(width=110).print(table)
    return rows


FADE = ds.RadialAttenuation(0.5, 0.2, 0.1)


def lamps(count: int) -> Iterator[ds.PointLight]:
    """Point lights on a circle."""
    for angle in 2 * np.pi * np.arange(count) / count:
        yield ds.PointLight((3 * np.cos(angle), 3 * np.sin(angle), 3), 1 / count, FADE)


def balls(count: int, k_t: float | None, eta: float) -> Iterator[ds.Object]:
    """Spheres in a spiral that overlap in the picture."""
    for i in range(count):
        center = (0.1 * i * np.cos(i), 0.1 * i * np.sin(i), -0.5 * i)
        material = ds.Material(0.1, (0.6, 0.4, 0.3), 0.4, 20, k_t=k_t, eta=eta)
        yield ds.Object(ds.Sphere(center, 1 + 0.02 * i), material)


def times(scene: ds.Scene, camera: ds.Camera, repeats: int, options: dict[str, str] | None) -> tuple[float, float]:
    """Return the median seconds of a render and of a gradient, which is compiled with the options."""

    def total(both: tuple[ds.Scene, ds.Camera]) -> jax.Array:
        return ds.render(*both).sum()

    gradient = jax.jit(jax.grad(total), compiler_options=options)
    runs = {"render": lambda: ds.render(scene, camera), "gradient": lambda: gradient((scene, camera))}
    middle = medians(take_turns(runs, repeats))
    return middle["render"], middle["gradient"]


def show(kind: str, rows: list[tuple[float, ...]]) -> None:
    """Print the table of one kind."""
    n, *columns = np.transpose(rows)
    exponents = [np.polyfit(np.log(n[len(n) // 2 :]), np.log(t[len(n) // 2 :]), 1)[0] for t in columns]
    table = Table(title=f"{kind}: exponents {exponents[0]:.2f} of a render, {exponents[1]:.2f} of a gradient")
    for heading in (kind, "render, ms", "per unit", "gradient, ms", "per unit"):
        table.add_column(heading, justify="right")
    for i, count in enumerate(n):
        cells = [f"{count:.0f}"]
        for t in columns:
            mean = (t[-1] - t[0]) / (n[-1] - n[0])
            cells += [f"{1e3 * t[i]:.2f}", f"{(t[i] - t[i - 1]) / (n[i] - n[i - 1]) / mean:.2f}" if i else ""]
        table.add_row(*cells)
    Console(width=110).print(table)


if __name__ == "__main__":
    main()
