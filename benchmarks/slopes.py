"""Show how time and memory of `ds.render` and `ds.fit` grow with pixels, views, lights and unknowns, and plot it.

The ball under a lamp of the other benchmarks (problem.py), in float64 fits. Every count runs in a process of its own,
cold once and then warm several times; counts take turns, round after round, and what counts is the median.

The slope s is that of t = a + b n^s, all three fitted to the logarithms of the times: a is what does not depend on n
(the call, and what a search for a start does on a part of the pixels), and s = 1 is linear. Beside it is the plain
slope of log t over log n in the upper half of the counts, which is below 1 where a still counts. Memory is the peak of
the first call beyond what the process held before it, the photographs: of a fit, which is cold, with what the compiler
took. On a GPU it is the peak of the device. `cpu` is what all threads computed: others' load hardly changes it, and on
a GPU it says nothing.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

COUNTS = {
    "pixels": (10_000, 31_684, 100_489, 315_844, 1_000_000),  # squares of whole numbers
    "views": (1, 2, 4, 8, 16, 32),
    "lights": (1, 2, 4, 8, 16, 32),
    "unknowns": (10, 14, 18, 26, 42, 74),
}
LARGE = {**COUNTS, "pixels": (10_000, 100_489, 1_000_000, 9_998_244, 100_000_000), "views": (1, 4, 16, 64, 256)}
SIDE = 128  # pixels on a side where it is not pixels that grow
CALLS = ("render", "fit")


def main() -> None:
    """Run every count of every kind, print a table for each and plot them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=COUNTS, default=list(COUNTS), help="what grows (default: all)")
    parser.add_argument("--large", action="store_true", help="to 10^8 pixels and 256 views: minutes to hours, 16 GB")
    parser.add_argument("--most", type=int, help="leave out counts above this")
    parser.add_argument("--rounds", type=int, default=2, help="processes for each count (default: 2)")
    parser.add_argument("--repeats", type=int, default=5, help="warm calls in each (default: 5)")
    parser.add_argument(
        "--out", type=Path, default=Path("output/slopes"), help="folder for plots (default: %(default)s)"
    )
    parser.add_argument("--one", nargs=2, metavar=("KIND", "COUNT"), help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.one:
        print(json.dumps(measure(arguments.one[0], int(arguments.one[1]), arguments.repeats)))
        return
    from timing import conditions, in_a_process

    arguments.out.mkdir(parents=True, exist_ok=True)
    found = {"measured": conditions()}
    for kind in arguments.only:
        counts = [n for n in (LARGE if arguments.large else COUNTS)[kind] if n <= (arguments.most or np.inf)]
        if len(counts) < 4:
            sys.exit(f"--most must leave at least 4 counts of {kind}; got {arguments.most}, which leaves {counts}.")
        runs: dict[int, list[dict]] = {n: [] for n in counts}
        jobs = [n for _ in range(arguments.rounds) for n in counts]
        for n in track(jobs, description=kind, console=Console(stderr=True), transient=True):
            given = ("--one", kind, str(n), "--repeats", str(arguments.repeats))
            runs[n].append(in_a_process(__file__, *given))
        rows = {n: {key: float(np.median([r[key] for r in of])) for key in of[0]} for n, of in runs.items()}
        found[kind] = rows
        show(kind, rows)
        plot(arguments.out / f"{kind}.png", kind, rows)
        (arguments.out / "slopes.json").write_text(json.dumps(found, indent=1), encoding="utf-8")
    print(f"{found['measured']}; plots and numbers in {arguments.out}")


def growth(n: np.ndarray, t: np.ndarray) -> tuple[float, float, float]:
    """Return a, b and s of t = a + b n^s, which leave the smallest squares of log t."""
    from scipy.optimize import least_squares

    def misfit(x: np.ndarray) -> np.ndarray:
        return np.log(np.exp(x[0]) + np.exp(x[1]) * (n / n[-1]) ** x[2]) - np.log(t)

    starts = [(np.log(t[0] * share), np.log(t[-1]), slope) for share in (1e-3, 0.5, 0.9) for slope in (0.7, 1.0, 1.5)]
    best = min((least_squares(misfit, x) for x in starts), key=lambda end: end.cost)
    a, b, s = np.exp(best.x[0]), np.exp(best.x[1]), best.x[2]
    return float(a), float(b / n[-1] ** s), float(s)


def plain_slope(n: np.ndarray, t: np.ndarray) -> float:
    """Return the slope of log t over log n in the upper half of the counts."""
    half = len(n) // 2
    return float(np.polyfit(np.log(n[half:]), np.log(t[half:]), 1)[0])


def show(kind: str, rows: dict[int, dict]) -> None:
    """Print the table of one kind, and the growth of each call."""
    n = np.array(list(rows), float)
    table = Table(title=kind)
    for heading in (kind, "render, ms", "fit, ms", "render, cpu ms", "fit, cpu ms", "render, MB", "fit, MB"):
        table.add_column(heading, justify="right")
    for count, row in rows.items():
        times = (f"{1e3 * row[f'{call}{kind}']:.2f}" for kind in ("", " cpu") for call in CALLS)
        table.add_row(f"{count}", *times, *(f"{row[f'{call} memory']:.0f}" for call in CALLS))
    Console(width=110).print(table)
    for call in ("render", "fit", "render cpu", "fit cpu"):
        t = np.array([row[call] for row in rows.values()])
        a, b, s = growth(n, t)
        print(f"{call}: {1e3 * a:.2f} ms + {1e9 * b:.3g} ns x n^{s:.2f}; plain slope {plain_slope(n, t):.2f}")


def plot(path: Path, kind: str, rows: dict[int, dict]) -> None:
    """Plot time and memory over the counts, both logarithmic, with the fitted growth."""
    from matplotlib.figure import Figure

    n = np.array(list(rows), float)
    figure = Figure((9, 3.6), layout="constrained")
    time_axes, memory_axes = figure.subplots(1, 2)
    for call, colour in zip(CALLS, ("tab:blue", "tab:orange"), strict=True):
        t = np.array([row[call] for row in rows.values()])
        a, b, s = growth(n, t)
        along = np.geomspace(n[0], n[-1], 50)
        time_axes.loglog(n, t, "o", color=colour, label=f"ds.{call}")
        time_axes.loglog(along, a + b * along**s, color=colour, lw=1, label=f"{a:.2g} s + {b:.2g} s n^{s:.2f}")
        memory_axes.loglog(
            n, [max(row[f"{call} memory"], 1) for row in rows.values()], "o-", color=colour, label=f"ds.{call}"
        )
    time_axes.set(xlabel=kind, ylabel="seconds, warm")
    memory_axes.set(xlabel=kind, ylabel="MB at the peak of the first call")
    for axes in (time_axes, memory_axes):
        axes.legend(fontsize=8)
        axes.grid(alpha=0.3)
    figure.savefig(path, dpi=130)


def measure(kind: str, count: int, repeats: int) -> dict[str, float]:
    """Return the warm seconds of a render of all views and of a fit, and the memory of the first of each."""
    from timing import forget_peak, memory

    found: dict[str, float] = {}
    for call, run in zip(CALLS, programs(kind, count), strict=True):
        forget_peak()
        before = memory("VmRSS")
        run()
        found[f"{call} memory"] = _device_peak() or memory("VmHWM") - before
        found[call], found[f"{call} cpu"] = np.median([_seconds(run) for _ in range(repeats)], 0).tolist()
    return found


def programs(kind: str, count: int) -> tuple[Callable, Callable]:
    """Return what renders all views of a problem, and what fits it."""
    import problem

    import diffshade as ds

    side = round(count**0.5) if kind == "pixels" else SIDE
    views = {"pixels": 1, "lights": 1, "views": count, "unknowns": 64}[kind]
    made = problem.make(64 if kind == "unknowns" else side, views)
    scene, free = made.scene, problem.FREE[:4]
    photographs = made.views
    if kind == "lights":
        camera = photographs[0].camera
        scene = problem.make(2, count).scene
        dimmed = [ds.PointLight(l.position, 1 / count, l.attenuation) for l in scene.lights]  # pyright: ignore
        scene = ds.Scene(scene.objects, dimmed)
        noise = problem.SIGMA * np.random.default_rng(0).standard_normal((side, side, 3))
        photographs = [ds.View(np.asarray(ds.render(scene, camera), np.float64) + noise, camera)]
    if kind == "unknowns":  # k_a, k_d, k_s and n_s are 10
        free = (*free, *(f"views.{k}.exposure" for k in range(count - 10)))
    lit = [view.lit for view in photographs]

    def render() -> None:
        for view, on in zip(photographs, lit, strict=True):
            np.asarray(ds.render(scene, view.camera, lit=on))

    return render, lambda: ds.fit(scene, photographs, free=free)


def _seconds(run: Callable) -> tuple[float, float]:
    """Return the time of a call, and what all threads computed in it."""
    started, computed = time.perf_counter(), time.process_time()
    run()
    return time.perf_counter() - started, time.process_time() - computed


def _device_peak() -> float:
    """Return the peak of the GPU's memory in MB, 0 where there is none."""
    import jax

    statistics = jax.devices()[0].memory_stats() if jax.default_backend() != "cpu" else None
    return (statistics or {}).get("peak_bytes_in_use", 0) / 2**20


if __name__ == "__main__":
    main()
