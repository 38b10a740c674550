"""Time a fit from a cold process: from before `import diffshade` to the first finished `ds.fit` of one photograph.

Each start is a process of its own: without JAX's persistent compilation cache, which is how the library comes, with an
empty one, which it fills, and with a full one; and without one, of a photograph under a lamp five degrees beside the
scene's, so that the fit looks for the cause, and compiles what that needs. They take turns. `cpu` is what all threads
computed, up to the end of the fit: it hardly depends on who else uses the machine. `best` is the nearest to a quiet
machine. `stderr` is how many bytes the process wrote there: a cache that warns at every start is no help to a person.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import tempfile
import time
from pathlib import Path
from typing import Any

SIZE = 256
FREE = ("k_a", "k_d", "k_s", "n_s")
WAYS = ("without a cache", "filling a cache", "from a full cache", "without a cache, lamp off")
OFF = 5.0  # degrees


def main() -> None:
    """Start processes of each way in turn and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=5, help="processes of each way (default: 5)")
    parser.add_argument("--size", type=int, default=SIZE, help="pixels on a side (default: %(default)s)")
    parser.add_argument("--one", type=Path, metavar="IMAGE", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.one:
        print(json.dumps(start(arguments.one)))
        return
    import numpy as np
    from rich.console import Console
    from rich.table import Table
    from timing import conditions

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
        images = {off: Path(folder) / f"photograph_{off:g}.npy" for off in (0.0, OFF)}
        for off, image in images.items():
            np.save(image, photograph(size, off))
        for k in range(rounds):
            cache = Path(folder) / f"cache{k}"
            for way in ways:
                with_cache = {
                    "JAX_COMPILATION_CACHE_DIR": str(cache),
                    "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
                    "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
                }
                environment = with_cache if way in WAYS[1:3] else {}
                image = images[OFF if way == WAYS[3] else 0.0]
                found[way].append(in_a_process(__file__, "--one", str(image), environment=environment))
    return found


def photograph(size: int, off: float) -> Any:
    """Return a glossy ball under a lamp, with noise; the lamp is turned by `off` degrees about the y axis."""
    import numpy as np

    import diffshade as ds

    scene, camera = setting(size)
    a = np.deg2rad(off)
    turn = np.array([[np.cos(a), 0.0, np.sin(a)], [0.0, 1.0, 0.0], [-np.sin(a), 0.0, np.cos(a)]])
    (lamp,), material = scene.lights, ds.Material(k_a=0.05, k_d=(0.70, 0.25, 0.20), k_s=0.4, n_s=30)
    lamp = dataclasses.replace(lamp, position=turn @ lamp.position)
    image = np.asarray(ds.render(ds.Scene(ds.Object(ds.Sphere(), material), lamp), camera), np.float64)
    return image + 0.005 * np.random.default_rng(0).standard_normal(image.shape)


def setting(size: int) -> tuple[Any, Any]:
    """Return the scene that is fitted, and its camera."""
    import diffshade as ds

    fade = ds.RadialAttenuation(1.0, 0.1, 0.5)
    scene = ds.Scene(ds.Object(ds.Sphere()), ds.PointLight((2, 3, 4), intensity=10, attenuation=fade))
    return scene, ds.Camera(eye=(0, 0, 4), fov=35, shape=(size, size))


def start(image: Path) -> dict:
    """Import, fit and say how long each took."""
    started = time.perf_counter()
    import numpy as np

    import diffshade as ds

    imported = time.perf_counter()
    target = np.load(image)
    scene, camera = setting(len(target))
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
