"""Time a fit from a cold process: from before `import diffshade` to the first finished `ds.fit` of one photograph.

Each start is a process of its own: without JAX's persistent compilation cache, which is how the library comes, with an
empty one, which it fills, and with a full one. They take turns. `cpu` is what all threads of the process computed, up
to the end of the fit: it hardly depends on who else uses the machine. `best` is the nearest to a quiet machine.
`stderr` is how many bytes the process wrote there: a cache that warns at every start is no help to a person.

`--views 5 6 7 9` times instead, in one process, the first and the second fit of each number of photographs with the
directions of all lights free, and counts what the first one compiles.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

SIZE = 256
FREE = ("k_a", "k_d", "k_s", "n_s")
WAYS = ("without a cache", "filling a cache", "from a full cache")


def main() -> None:
    """Start processes of each way in turn and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=5, help="processes of each way (default: 5)")
    parser.add_argument("--size", type=int, default=SIZE, help="pixels on a side (default: %(default)s)")
    parser.add_argument("--views", type=int, nargs="+", metavar="N", help="time fits of these numbers of views")
    parser.add_argument("--light-error", type=float, metavar="DEGREES", help="stated error of their lights")
    parser.add_argument("--one", type=Path, metavar="IMAGE", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.one:
        print(json.dumps(start(arguments.one)))
        return
    import numpy as np
    from rich.console import Console
    from rich.table import Table
    from timing import conditions

    if arguments.views:
        table = Table(title=f"lights of 48 x 48 views free, s of processor time, {conditions()}")
        for heading in ("views", "first fit", "second fit", "beyond it", "programs compiled", "s of compiling"):
            table.add_column(heading, justify="right")
        for row in of_views(arguments.views, arguments.light_error):
            table.add_row(*map(str, row))
        Console(width=110).print(table)
        return
    found = measure(arguments.rounds, arguments.size)
    table = Table(title=f"a cold fit of {arguments.size} x {arguments.size}, {conditions()}")
    for heading in ("", "import, s", "fit, s", "total, s", "cpu, s", "best total, s", "stderr, bytes"):
        table.add_column(heading, justify="left" if not heading else "right")
    for way, runs in found.items():
        middle = [float(np.median([run[key] for run in runs])) for key in ("import", "fit", "total", "cpu")]
        best, said = min(run["total"] for run in runs), max(run["stderr"] for run in runs)
        table.add_row(way, *(f"{of:.2f}" for of in (*middle, best)), str(said))
    Console(width=110).print(table)


def measure(rounds: int, size: int = SIZE, ways: tuple[str, ...] = WAYS) -> dict[str, list[dict]]:
    """Return what each start of each way took."""
    import numpy as np
    from timing import in_a_process

    found: dict[str, list[dict]] = {way: [] for way in ways}
    with tempfile.TemporaryDirectory() as folder:
        image = Path(folder) / "photograph.npy"
        np.save(image, photograph(size))
        for k in range(rounds):
            cache = Path(folder) / f"cache{k}"
            for way in ways:
                with_cache = {
                    "JAX_COMPILATION_CACHE_DIR": str(cache),
                    "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
                    "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
                }
                environment = {} if way == WAYS[0] else with_cache
                found[way].append(in_a_process(__file__, "--one", str(image), environment=environment))
    return found


def of_views(counts: list[int], light_error: float | None) -> Iterator[tuple]:
    """Yield for each number of views the processor time of its first and second fit, and what the first compiles."""
    import jax
    import numpy as np

    import diffshade as ds

    compiled: list[float] = []
    jax.monitoring.register_event_duration_secs_listener(
        lambda event, duration_secs, **_: (
            compiled.append(duration_secs) if event.endswith("backend_compile_duration") else None
        )
    )
    camera, random = ds.Camera(eye=(0, 0, 4), fov=32, shape=(48, 48)), np.random.default_rng(0)
    material = ds.Material(k_a=(0.10, 0.08, 0.06), k_d=(0.6, 0.4, 0.25), k_s=(0.5, 0.5, 0.45), n_s=50)
    for count in counts:
        i = np.arange(count)
        azimuth, polar = 2.0 * np.pi * i / count, np.deg2rad(20.0 + 5.0 * (5 * i % 8))
        towards = np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], -1)
        scene = ds.Scene(ds.Object(ds.Sphere(), material), [*map(ds.DirectionalLight, towards)])
        clean = [np.asarray(ds.render(scene, camera, lit=k), float) for k in range(count)]
        views = [ds.View(of + 0.005 * random.standard_normal(of.shape), camera, lit=k) for k, of in enumerate(clean)]
        told = ds.Scene(scene.objects, [ds.DirectionalLight(d + 0.02 * random.standard_normal(3)) for d in towards])
        took = []
        for _ in range(2):
            compiled.clear()
            began = time.process_time()
            ds.fit(told, views, free=(*FREE, "direction"), light_error=light_error)
            took.append((time.process_time() - began, len(compiled), sum(compiled)))
        (first, programs, seconds), (second, *_) = took
        yield count, f"{first:.2f}", f"{second:.2f}", f"{first - second:.2f}", programs, f"{seconds:.2f}"


def photograph(size: int) -> Any:
    """Return a ball under a lamp, with noise, as NumPy makes it: the processes render nothing but in their fits."""
    import numpy as np

    y, x = np.mgrid[1 : -1 : size * 1j, -1 : 1 : size * 1j]
    z = np.sqrt(np.clip(0.7 - x * x - y * y, 0, None))
    n = np.stack([x, y, z], -1) / np.sqrt(0.7)
    n_l = np.clip(n @ np.array([0.4, 0.5, 0.77]), 0, None)[..., None]
    image = 0.05 + n_l * (0.70, 0.25, 0.20) + 0.4 * n_l**60
    return image + 0.005 * np.random.default_rng(0).standard_normal(image.shape)


def start(image: Path) -> dict:
    """Import, fit and say how long each took."""
    started = time.perf_counter()
    import numpy as np

    import diffshade as ds

    imported = time.perf_counter()
    target = np.load(image)
    camera = ds.Camera(eye=(0, 0, 4), fov=35, shape=target.shape[:2])
    fade = ds.RadialAttenuation(1.0, 0.1, 0.5)
    scene = ds.Scene(ds.Object(ds.Sphere()), ds.PointLight((2, 3, 4), intensity=10, attenuation=fade))
    ds.fit(scene, ds.View(target, camera), free=FREE)
    done, times = time.perf_counter(), os.times()
    return {
        "import": imported - started,
        "fit": done - imported,
        "total": done - started,
        "cpu": times.user + times.system,
    }


if __name__ == "__main__":
    main()
