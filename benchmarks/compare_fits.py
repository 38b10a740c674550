"""Compare ds.fit with what a user would pick instead: time, ratios, memory, and what the answer costs.

Every solver runs in a process of its own, which makes the data, then solves it once cold (compilation included) and
several times warm. Solvers take turns, round after round, and a time is the median over the rounds: on a shared machine
compare ratios, not seconds. Peers are given the fields of every pixel ready-made and a start, keep no bounds, give no
error bars. `solve` is diffshade's share of that same work, with a start of its own; `fit` is the whole call, from
photographs to error bars. Memory is the peak of the first, cold solve, compiler included, beyond what the process held
before it. An earlier diffshade takes its turns too with `--before` and a checkout of it, such as `git worktree add`
makes.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table
from timing import forget_peak, in_a_process, memory

SIZES = ("128x1", "128x8", "512x1", "512x8", "2048x1", "2048x8")
FIT, RENDER, BEFORE = "diffshade, fit", "one forward render of all views", ", before"
OURS = ("diffshade, solve", FIT, RENDER)
ADAM_AT_MOST = 512 * 512
PEERS_AT_MOST = 2048 * 2048  # pixels: beyond, their Jacobians do not fit into memory


def main() -> None:
    """Run every solver on every size and print a table for each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", nargs="+", default=SIZES, help="SIZExVIEWS (default: %(default)s)")
    parser.add_argument("--rounds", type=int, default=3, help="rounds, each in new processes (default: 3)")
    parser.add_argument("--repeats", type=int, default=3, help="warm solves in each (default: 3)")
    parser.add_argument("--before", type=Path, help="checkout of an earlier diffshade, timed beside today's")
    parser.add_argument("--json", type=Path, help="write every number to this file too")
    parser.add_argument("--one", nargs=2, metavar=("SOLVER", "SIZE"), help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.one:
        name, size = arguments.one
        print(json.dumps(measure(name, size, arguments.repeats)))
        return
    if arguments.before is not None and not (arguments.before / "diffshade").is_dir():
        parser.error(f"--before {arguments.before} must be a checkout: it has no folder diffshade.")
    import peers

    found = {}
    for size in arguments.sizes:
        pixels, views = map(int, size.split("x"))
        others = [] if pixels**2 * views > PEERS_AT_MOST else list(peers.PEERS)
        ours = OURS if arguments.before is None else (*OURS, FIT + BEFORE, RENDER + BEFORE)
        names = [*ours, *(n for n in others if "Adam" not in n or pixels**2 * views <= ADAM_AT_MOST)]
        runs: dict[str, list[dict]] = {name: [] for name in names}
        jobs = [name for _ in range(arguments.rounds) for name in names]
        for name in track(jobs, description=size, console=Console(stderr=True), transient=True):
            of = {"PYTHONPATH": str(arguments.before.resolve())} if name.endswith(BEFORE) else None
            command = "--one", name.removesuffix(BEFORE), size, "--repeats", str(arguments.repeats)
            runs[name].append(in_a_process(__file__, *command, environment=of))
        found[size] = {name: _median(of) for name, of in runs.items()}
        show(size, found[size])
        if arguments.json:
            arguments.json.write_text(json.dumps(found, indent=1), encoding="utf-8")


def show(size: str, rows: dict[str, dict]) -> None:
    """Print the table of one size."""
    base = rows["diffshade, solve"]["warm"]
    best = min(row["cost"] for row in rows.values() if row["cost"] is not None)
    pixels, views = size.split("x")
    table = Table(title=f"{views} view{'s' * (views != '1')} of {pixels} x {pixels}, 12 unknowns, float64")
    for heading in ("", "warm, s", "ratio", "cold, s", "MB beyond the data", "cost above the best"):
        table.add_column(heading, justify="left" if not heading else "right")
    for name, row in rows.items():
        cost = "" if row["cost"] is None else f"{row['cost'] / best - 1:.1e}"
        cells = f"{row['warm']:.4f}", f"{row['warm'] / base:.1f}", f"{row['cold']:.2f}", f"{row['memory']:.0f}", cost
        table.add_row(name, *cells)
    Console(width=110).print(table)


def _median(runs: list[dict]) -> dict:
    return {key: None if runs[0][key] is None else float(np.median([run[key] for run in runs])) for key in runs[0]}


def measure(name: str, size: str, repeats: int) -> dict:
    """Solve once cold and several times warm; return times, memory beyond the data, and the cost of the answer."""
    import jax

    jax.config.update("jax_enable_x64", True)
    import peers
    import problem

    pixels, views = map(int, size.split("x"))
    made = problem.make(pixels, views)
    data = None if name == FIT or name.startswith("one") else problem.fields(made)
    if name in peers.PEERS:
        assert data is not None
        solver: Callable = lambda: peers.PEERS[name](data)  # noqa: E731
    elif name == "diffshade, solve":
        solver = _solve(made)
    elif name == FIT:
        solver = lambda: _theta(of_problem(made))  # noqa: E731
    else:
        solver = lambda: _render(made)  # noqa: E731
    forget_peak()
    before = memory("VmRSS")
    started = time.perf_counter()
    theta = solver()
    cold = time.perf_counter() - started
    peak = memory("VmHWM") - before
    times = []
    for _ in range(repeats):
        started = time.perf_counter()
        solver()
        times.append(time.perf_counter() - started)
    cost = None
    if theta is not None:
        cost = float(problem.compiled_cost(theta, data or problem.fields(made)))
    return {"cold": cold, "warm": float(np.median(times)), "memory": peak, "cost": cost}


def of_problem(made):
    """Return the fit of the problem that every solver has, by `ds.fit`."""
    from problem import FREE, TIED

    import diffshade as ds

    return ds.fit(made.scene, made.views, free=FREE, tied=TIED)


def _theta(fit) -> np.ndarray:
    return np.concatenate([fit.values[:9], [np.log(fit.values[9])], fit.values[10:]])


def _solve(made) -> Callable:
    """Lay the pixels out, as the peers' fields are, and return what solves."""
    from problem import FREE, TIED

    from diffshade.inverse.data.view_sets import ViewSet
    from diffshade.inverse.fitting import new_problem
    from diffshade.inverse.problem import PART
    from diffshade.inverse.solving import find_start, lay_out_part
    from diffshade.inverse.unknowns.parameters import find_unknowns

    unknowns = find_unknowns(made.scene, made.views, FREE, TIED)
    fit = new_problem(made.scene, ViewSet.of(made.scene, made.views), unknowns, "squares", "hinge")
    part, everything = lay_out_part(fit), fit.chunks()

    def solve() -> np.ndarray:
        start, damping = find_start(part)
        squares = start.squares * max(fit.data.counts.pixels / PART, 1.0)
        return dataclasses.replace(start, squares=squares, chunks=everything).minimise(damping=damping).theta

    return solve


def _render(made) -> None:
    import diffshade as ds

    for k, view in enumerate(made.views):
        np.asarray(ds.render(made.scene, view.camera, lit=k))


if __name__ == "__main__":
    main()
