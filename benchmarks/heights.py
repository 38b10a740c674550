"""The time of `ds.heights.integrate_normals`, errors included: a ball, and a relief with a step that fades out.

python benchmarks/heights.py [--size 1000]

Normals have an error of 1 degree. The ball has no discontinuity, and no search for any begins; the relief has one. Each
runs once in full; most of it computes on one core. Accuracy and coverage stand beside the times, because a fast wrong
result is worth nothing.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table
from timing import conditions, memory

import diffshade as ds

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "support"))
import reliefs

NOISE = 1.0  # degrees


def surfaces(size: int) -> dict[str, reliefs.Relief]:
    """Return the surfaces by name, each about the square of `size` texels."""
    over = round(size * 2.2 / float(np.sqrt(np.pi)))  # the ball covers a part of its image
    return {
        "ball": reliefs.sphere(over),
        "ball, perspective": reliefs.sphere(round(over * 2.4 / 2.2), perspective=True),
        "step that fades out": reliefs.relief(size, reliefs.stepped(0.3)),
    }


def main() -> None:
    """Time each surface and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=1000, help="side of the square of texels (default: 1000)")
    arguments = parser.parse_args()
    print(conditions())
    ds.heights.integrate_normals(reliefs.sphere(32).normal, reliefs.sphere(32).camera)  # imports and compiles
    table = Table(title=f"{arguments.size**2:,} texels, normals with an error of {NOISE:g} degree")
    for column in ("", "texels", "seconds", "heights off, % of the range", "within 95 %", "jumps", "peak MB"):
        table.add_column(column, justify="left" if not column else "right")
    for name, relief in surfaces(arguments.size).items():
        normals = relief.noisy(NOISE)
        begun = time.perf_counter()
        found = ds.heights.integrate_normals(
            normals, relief.camera, mask=relief.mask, errors=np.full(relief.mask.shape, NOISE), progress=True
        )
        seconds = time.perf_counter() - begun
        off = reliefs.off(found, relief)
        table.add_row(
            name,
            f"{found.mask.sum():,}",
            f"{seconds:.1f}",
            f"{100 * reliefs.relative(found, relief):.3f}",
            f"{100 * np.mean(np.abs(off) < 1.96 * found.errors[found.mask]):.1f} %",
            f"{int(found.jump_right.sum() + found.jump_below.sum()):,}",
            f"{memory('VmHWM'):,.0f}",
        )
    Console().print(table)


if __name__ == "__main__":
    main()
