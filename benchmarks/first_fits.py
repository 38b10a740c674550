"""Time the first and the second fit of each number of photographs in one process, with all lights free.

What the first takes more is compiling: programs serve all numbers of photographs up to one of a few sizes (4, 6, 8, 12,
16, 24, ...), so that 11 photographs after 12, or after 10, should add next to nothing.
"""

from __future__ import annotations

import argparse
import time

from problem import make
from rich.console import Console
from rich.table import Table
from timing import conditions

import diffshade as ds

FREE = ("k_d", "k_s", "n_s", "position")
MORE = (12, 11, 10, 9, 24, 23, 20, 17)


def seconds(count: int, size: int) -> tuple[float, float]:
    """Return how long the first and the second fit take."""
    scene, views = make(size, count)
    marks = [time.perf_counter()]
    for _ in range(2):
        ds.fit(scene, views, free=FREE, light_error=2.0)
        marks.append(time.perf_counter())
    return marks[1] - marks[0], marks[2] - marks[1]


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--views", nargs="+", type=int, default=MORE, help="in this order (default: %(default)s)")
    parser.add_argument("--size", type=int, default=128, help="pixels on a side (default: %(default)s)")
    arguments = parser.parse_args()
    table = Table("photographs", "first fit, s", "second, s", "more, s", title=conditions())
    for count in arguments.views:
        first, second = seconds(count, arguments.size)
        table.add_row(str(count), f"{first:.2f}", f"{second:.2f}", f"{first - second:.2f}")
    Console().print(table)


if __name__ == "__main__":
    main()
