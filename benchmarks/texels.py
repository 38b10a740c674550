"""Texel fits beside what a user would write: a loop of SciPy, vmapped optimistix, a loop of numba on all cores.

Everyone fits k_d, k_s and log n_s at every texel, in float64, by least squares over its observations. The others are
given the angles ready-made and begin within a tenth of the truth; diffshade begins at nothing and is timed twice:
"angles to numbers" is its compiled program alone, which makes standard errors and a status too, and `ds.fit_texels` the
whole call from images to maps. Rates are texels a second; ratios are those of one run, round by round.

The arithmetic bound is what the exponentials and the sums of products alone would take, of all passes that a texel
takes, at the speed at which this machine makes them in a cache.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx
from rich.console import Console
from rich.table import Table
from scipy.optimize import least_squares
from timing import conditions, medians, take_turns

import diffshade as ds
from diffshade.parallel.threads import on_all_cores
from diffshade.texels.estimates import estimate
from diffshade.texels.lighting import lighting_setup
from diffshade.texels.prediction import FitOptions, KnownCoefficients
from diffshade.texels.run import FIRST_STEPS
from diffshade.texels.status import TypicalResidual
from diffshade.texels.tiles import BLOCK, ViewReader

SCIPY, OPTIMISTIX, NUMBA = "SciPy least_squares, lm, a loop", "optimistix LM, vmapped", "numba LM, all cores"
PROGRAM, CALL = "diffshade, angles to numbers", "ds.fit_texels, images to maps"
CASES = ((12, 1), (32, 3))  # lights, channels
PASSES = 7 + 7 + 3  # a grid of n_s, steps, and the fit without a highlight


class Problem(NamedTuple):
    """Texels whose normals and materials are drawn at random, under lights about them."""

    scene: ds.Scene
    views: list[ds.View]
    u: np.ndarray
    """(n.l)_+ and log cos, (lights, texels); y, (lights, channels, texels); the truth, (2 channels + 1, texels)."""
    log: np.ndarray
    y: np.ndarray
    truth: np.ndarray


def problem(lights: int, channels: int, texels: int) -> Problem:
    """Return texels with n_s of 5 to 100, all with a highlight that the lights can show."""
    rng = np.random.default_rng(0)
    i = np.arange(lights) + 0.5
    polar, azimuth = np.deg2rad(60 * np.sqrt(i / lights)), np.pi * (3 - np.sqrt(5)) * i
    l = np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], -1)
    tilt, turn = np.deg2rad(25 * np.sqrt(rng.random(texels))), 2 * np.pi * rng.random(texels)
    n = np.stack([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)])
    k = rng.uniform(0.2, 0.8, (2 * channels, texels))
    n_s = np.exp(rng.uniform(np.log(5), np.log(100), texels))
    n_l = l @ n
    cosine = 2 * n_l * n[2] - l[:, 2:]
    log = np.where((n_l > 0) & (cosine > 0), np.log(np.maximum(cosine, 1e-12)), -1e4)
    u = np.maximum(n_l, 0)
    y = k[:channels] * u[:, None] + k[channels:] * np.exp(n_s * log)[:, None]
    y = y + 0.005 * rng.standard_normal(y.shape)
    camera = ds.OrthographicCamera((0, 0, 1), shape=(texels // 1024, 1024), local_viewer=False)
    surface = ds.GBuffer(n.T.reshape(*camera.shape, 3))
    scene = ds.Scene(ds.Object(surface), [ds.DirectionalLight(-d) for d in l])
    images = [of.T.reshape(*camera.shape, channels) for of in y.astype(np.float32)]
    views = [ds.View(image, camera, lit=(k,)) for k, image in enumerate(images)]
    return Problem(scene, views, u, log, y, np.concatenate([k, np.log(n_s)[None]]))


def start(p: Problem) -> np.ndarray:
    """Return where the others begin: coefficients and n_s a tenth above the truth."""
    channels = p.y.shape[1]
    return np.concatenate([1.1 * p.truth[: 2 * channels], p.truth[2 * channels :] + np.log(1.1)])


def scipy_loop(p: Problem, texels: int) -> Callable[[], Any]:
    """Levenberg and Marquardt of MINPACK with the exact Jacobian, texel by texel."""
    channels, begin = p.y.shape[1], start(p)

    def one(t: int) -> Any:
        u, log, y = p.u[:, t], np.maximum(p.log[:, t], -700.0), p.y[..., t]

        def residuals(q: np.ndarray) -> np.ndarray:
            s = np.exp(np.exp(min(q[-1], 9.0)) * log)
            return (q[:channels] * u[:, None] + q[channels:-1] * s[:, None] - y).ravel()

        def jacobian(q: np.ndarray) -> np.ndarray:
            s = np.exp(np.exp(min(q[-1], 9.0)) * log)
            J = np.zeros((len(u), channels, 2 * channels + 1))
            for c in range(channels):
                J[:, c, c], J[:, c, channels + c] = u, s
                J[:, c, -1] = q[channels + c] * s * log * np.exp(q[-1])
            return J.reshape(-1, 2 * channels + 1)

        return least_squares(residuals, begin[:, t], jac=jacobian, method="lm").x

    return lambda: [one(t) for t in range(texels)]


def optimistix_vmapped(p: Problem, texels: int) -> Callable[[], Any]:
    """Its Levenberg-Marquardt by Cholesky on the normal equations, its fastest here, over a block of texels."""
    channels = p.y.shape[1]
    solver = optx.LevenbergMarquardt(rtol=1e-6, atol=1e-8, linear_solver=lx.Normal(lx.Cholesky()))

    def residuals(q: Any, data: Any) -> Any:
        u, log, y = data
        s = jnp.exp(jnp.exp(q[-1]) * log)
        return q[None, :channels] * u[:, None] + q[None, channels:-1] * s[:, None] - y

    def one(q: Any, u: Any, log: Any, y: Any) -> Any:
        return optx.least_squares(residuals, solver, q, (u, log, y), throw=False, max_steps=64).value

    run = jax.jit(jax.vmap(one))
    with jax.enable_x64(True):
        data = [jnp.asarray(np.moveaxis(of[..., :texels], -1, 0)) for of in (start(p), p.u, p.log, p.y)]

    def all_of_them() -> Any:
        with jax.enable_x64(True):
            return run(*data)

    return all_of_them


def numba_loop(p: Problem, texels: int) -> Callable[[], Any] | None:
    """A Levenberg-Marquardt of one's own, compiled, a texel a task on all cores."""
    try:
        import numba
    except ImportError:
        return None

    @numba.njit(parallel=True, fastmath=True)
    def fit(begin: np.ndarray, u: np.ndarray, log: np.ndarray, y: np.ndarray) -> np.ndarray:
        lights, channels = y.shape[1], y.shape[2]
        size = 2 * channels + 1
        found = begin.copy()
        for t in numba.prange(len(begin)):
            q, damping, cost = begin[t].copy(), 1e-3, np.inf
            H, g = np.zeros((size, size)), np.zeros(size)
            best = q.copy()
            for _ in range(30):
                new, G, b = 0.0, np.zeros((size, size)), np.zeros(size)
                n_s = np.exp(q[-1])
                for l in range(lights):
                    s = np.exp(n_s * log[t, l])
                    slope = s * log[t, l] * n_s
                    for c in range(channels):
                        r = q[c] * u[t, l] + q[channels + c] * s - y[t, l, c]
                        d = q[channels + c] * slope
                        new += r * r
                        b[c] += r * u[t, l]
                        b[channels + c] += r * s
                        b[-1] += r * d
                        G[c, c] += u[t, l] ** 2
                        G[channels + c, c] += s * u[t, l]
                        G[channels + c, channels + c] += s * s
                        G[-1, c] += d * u[t, l]
                        G[-1, channels + c] += d * s
                        G[-1, -1] += d * d
                if new < cost:
                    done = cost - new < 1e-6 * new
                    cost, damping = new, damping * 0.2
                    best[:] = q
                    H, g = G, b
                    if done:
                        break
                else:
                    damping = damping * 5 + 1e-6
                A = H + H.T
                for i in range(size):
                    A[i, i] = H[i, i] * (1 + damping) + 1e-12
                q = best - np.linalg.solve(A, g)
                q[-1] = min(max(q[-1], -2.0), 9.0)
            found[t] = best
        return found

    data = [np.ascontiguousarray(np.moveaxis(of[..., :texels], -1, 0)) for of in (start(p), p.u, p.log, p.y)]
    return lambda: fit(*data)


def program(p: Problem) -> Callable[[], Any]:
    """The compiled program of `ds.fit_texels` on its blocks, laid out, on all cores."""
    source = ViewReader(p.scene, p.views)
    tile = source.read(0, source.shape[0], source.shape[0])
    blocks = [source.lay_out(piece) for piece in source.pieces(tile, np.zeros((2, len(tile.pixels))))]
    zero = np.zeros(p.y.shape[1])
    known, setup = KnownCoefficients(zero, None, None, zero), lighting_setup(p.scene, p.views)
    choices = FitOptions(("k_d", "k_s", "n_s"), "squares", True, False)
    sigma, patience = np.asarray(1.0), np.asarray(FIRST_STEPS)
    any_residual = TypicalResidual(np.asarray(np.inf), np.asarray(np.inf))
    return lambda: on_all_cores(lambda b: estimate(setup, known, b, sigma, any_residual, patience, choices), blocks)


def bound(lights: int, channels: int) -> float:
    """Return the seconds that the exponentials and sums of a texel's passes take at the speed of this machine."""
    with jax.enable_x64(True):
        x = jnp.linspace(-1.0, 0.0, BLOCK)

        def repeated(body: Callable[[Any], Any]) -> Callable[[], Any]:
            run = jax.jit(lambda x: jax.lax.fori_loop(0, 400, lambda _, v: body(v), x))
            return lambda: on_all_cores(run, [x, x])

        made = {"exp": repeated(lambda v: jnp.exp(v) - 1.0), "sums": repeated(lambda v: v * 0.999 + 1e-9)}
        seconds = {name: of / (2 * 400 * BLOCK) for name, of in medians(take_turns(made, 15)).items()}
    products = 5 + 3 * channels  # of u, v and dv/dlog n_s with each other and with y
    return PASSES * lights * (seconds["exp"] + products * seconds["sums"])


def main() -> None:
    """Time both cases and print a table for each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=7, help="rounds in which all take turns (default: 7)")
    parser.add_argument("--blocks", type=int, default=32, help=f"blocks of {BLOCK} texels for diffshade (default: 32)")
    arguments = parser.parse_args()
    print(conditions())
    for lights, channels in CASES:
        rates, ratios, least = measured(lights, channels, arguments.blocks, arguments.rounds)
        table = Table(title=f"{lights * channels} observations, {2 * channels + 1} unknowns")
        for column in ("", "texels a second", "diffshade's program is"):
            table.add_column(column, justify="left" if not column else "right")
        for name, rate in rates.items():
            table.add_row(name, f"{rate:,.0f}", "" if name == PROGRAM else f"{ratios[name]:,.1f} times as fast")
        Console().print(table)
        print(f"arithmetic bound: {1 / least:,.0f} texels a second; the program reaches {rates[PROGRAM] * least:.0%}.")


def measured(lights: int, channels: int, blocks: int, rounds: int) -> tuple[dict[str, float], dict[str, float], float]:
    """Return the rates, how many times as fast diffshade's program is, and the arithmetic bound in seconds."""
    whole = blocks * BLOCK
    p = problem(lights, channels, whole)
    counts = {PROGRAM: whole, CALL: whole, SCIPY: 200, OPTIMISTIX: BLOCK, NUMBA: 4 * BLOCK}
    programs = {
        PROGRAM: program(p),
        CALL: lambda: ds.fit_texels(p.scene, p.views),
        SCIPY: scipy_loop(p, counts[SCIPY]),
        OPTIMISTIX: optimistix_vmapped(p, counts[OPTIMISTIX]),
        NUMBA: numba_loop(p, counts[NUMBA]),
    }
    there = {name: run for name, run in programs.items() if run is not None}
    seconds = take_turns(there, rounds, f"{lights * channels} observations")
    each = {name: np.array(of) / counts[name] for name, of in seconds.items()}
    ratios = {name: float(np.median(of / each[PROGRAM])) for name, of in each.items()}
    rates = {name: 1.0 / float(np.median(of)) for name, of in each.items()}
    return rates, ratios, bound(lights, channels)


if __name__ == "__main__":
    main()
