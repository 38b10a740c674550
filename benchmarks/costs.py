"""Count what the compiled programs do for each pixel: flops, exponentials and the like, bytes read and written.

From XLA's own analysis of the compiled program (`compiled.cost_analysis()`, `memory_analysis()`), beside the least that
must be moved: what goes in and what comes out. XLA counts the body of a loop once: the pass of a fit is analysed for a
chunk of one block.
"""

from __future__ import annotations

import time
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from rich.console import Console
from rich.table import Table
from shading import problem as shading_problem
from timing import conditions, medians, take_turns

import diffshade as ds

SIZE = 256


def main() -> None:
    """Analyse each program and print a table."""
    scene, camera, gbuffer = shading_problem(SIZE)
    shade = jax.jit(lambda scene, gbuffer: ds.shade(scene, gbuffer, camera))
    render = jax.jit(lambda scene: ds.render(scene, camera))
    squares = jax.jit(jax.value_and_grad(lambda scene, gbuffer: jnp.sum(ds.shade(scene, gbuffer, camera) ** 2)))
    numbers = jax.tree.map(jnp.asarray, scene)
    rows = {
        "ds.shade, one point light, float32": (shade.lower(numbers, gbuffer), SIZE**2, 12 + 12 + 1 + 12),
        "ds.render of a sphere, float32": (render.lower(numbers), SIZE**2, 12),
        "gradient by all of the scene, float32": (squares.lower(numbers, gbuffer), SIZE**2, 12 + 12 + 1),
        "pass of ds.fit, 12 unknowns, float64": fit_pass(),
    }
    table = Table(title=f"for each pixel, {conditions()}")
    for heading in ("", "flops", "exp, log, sqrt", "bytes, least", "bytes, XLA", "temporary bytes"):
        table.add_column(heading, justify="left" if not heading else "right")
    for name, (lowered, pixels, least) in rows.items():
        compiled = lowered.compile()
        found, memory = compiled.cost_analysis(), compiled.memory_analysis()
        counts = (found["flops"], found.get("transcendentals", 0.0))
        each = [f"{of / pixels:.0f}" for of in (*counts, least * pixels, found["bytes accessed"])]
        table.add_row(name, *each, f"{memory.temp_size_in_bytes / pixels:.0f}")
    Console(width=110).print(table)
    each, passes = time_of_a_pass()
    print(f"a pass of a fit over 1024 x 1024: {each:.1f} ns of processor time a pixel; passes over all: {passes}")


def fit_pass() -> tuple[Any, int, int]:
    """Return a pass over one block, its pixels, and the bytes that it reads of each: three fields, three samples."""
    from diffshade.core.backend import PLAINLY
    from diffshade.inverse.problem import PART
    from diffshade.inverse.solve import solvers

    with jax.enable_x64(True):
        fit = problem_of(SIZE)
        block = jax.tree.map(lambda leaf: leaf[:1], fit.chunks(PART)[0])
        task = fit.task(1.0)
        theta = np.array([u.start for u in fit.unknowns])
        program = jax.jit(solvers._summarise, static_argnums=0, compiler_options=PLAINLY)  # as solvers compiles it
        lowered = program.lower(task.model_structure, task.model_leaves, theta, block)
        return lowered, fit.block_size, 6 * 8 + 1


def time_of_a_pass() -> tuple[float, int]:
    """Return the processor time of a pass over a megapixel, in ns a pixel that counts, and how many a solve takes."""
    from diffshade.inverse.solve import solvers
    from diffshade.inverse.solving import solve

    with jax.enable_x64(True):
        fit = problem_of(1024)
        laid, end = solve(fit)
        task = laid.task
        look = {"pass": lambda: solvers.evaluate(end.theta, task, laid.chunks)}
        seconds = medians(take_turns(look, 15, clock=time.process_time))["pass"]
    return 1e9 * seconds / fit.counts.pixels, end.steps


def problem_of(size: int) -> Any:
    """Return the fit of the other benchmarks."""
    import problem

    from diffshade.inverse.data.view_sets import ViewSet
    from diffshade.inverse.fitting import new_problem
    from diffshade.inverse.unknowns.parameters import find_unknowns

    made = problem.make(size, 1)
    unknowns = find_unknowns(made.scene, made.views, problem.FREE, problem.TIED)
    return new_problem(made.scene, ViewSet.of(made.scene, made.views), unknowns, "squares", "hinge")


if __name__ == "__main__":
    main()
