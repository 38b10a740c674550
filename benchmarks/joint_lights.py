"""Fit the directions of all lights with the material: time by the number of views, beside known lights and Ceres.

A ball under one distant light in each view, stated 2 degrees off about each axis, noise of .5 %.
Ceres (through pyceres) minimises the same sum of squares by `DENSE_SCHUR`, its solver for such problems, with the
residuals and the exact Jacobian of each view once by a loop that numba compiles, on all cores, and once in NumPy, as a
user may write them; it is given the normals of every pixel and a start, and gives no error bars. `ds.fit` is the whole
call, from photographs to error bars; the solver alone is timed beside it, from the photographs' samples to the minimum,
with laying out, from the same start.
"""

from __future__ import annotations

import argparse
import dataclasses
import os
import time
from collections.abc import Callable
from typing import Any

import equinox as eqx
import numba
import numpy as np
from rich.console import Console
from rich.table import Table
from timing import medians, take_turns

import diffshade as ds

MATERIAL = ("k_d", "k_s", "n_s")
DEGREES, NOISE, SIZE = 2.0, 0.005, 64  # SIZE: pixels along a side, where no other is asked for
START = np.array([0.3] * 6 + [np.log(10.0)])


def towards_lights(count: int) -> np.ndarray:
    """Return directions that cover the half sphere in front evenly."""
    i = np.arange(count) + 0.5
    polar, around = np.arccos(1.0 - 0.5 * i / count), np.pi * (3.0 - np.sqrt(5.0)) * i
    return np.stack([np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)], -1)


def make(count: int, size: int = SIZE) -> tuple[ds.Scene, list[ds.View], np.ndarray]:
    """Return the scene with its lights as stated, the photographs, and the true directions to the lights."""
    random, towards = np.random.default_rng(0), towards_lights(count)
    camera = ds.OrthographicCamera((0.0, 0.0, 4.0), shape=(size, size), height=2.2, local_viewer=False)
    ball = ds.Object(ds.Sphere(), ds.Material(k_a=0.0, k_d=(0.5, 0.4, 0.3), k_s=0.3, n_s=20.0))
    true = ds.Scene(ball, [ds.DirectionalLight(-l) for l in towards])
    views = []
    for k in range(count):
        image = np.asarray(ds.render(true, camera, lit=k), np.float64)
        views.append(ds.View(image + NOISE * random.standard_normal(image.shape), camera, lit=k))
    stated = towards + np.deg2rad(DEGREES) * random.standard_normal(towards.shape)
    stated /= np.linalg.norm(stated, axis=-1, keepdims=True)
    return ds.Scene(ball, [ds.DirectionalLight(-l) for l in stated]), views, towards


@numba.njit(nogil=True, error_model="numpy")
def of_view(material, toward, image, n, r, by_material, by_light):
    """Write the residuals of one view (3 a pixel) and their derivatives, for Ceres."""
    length = np.sqrt(toward[0] ** 2 + toward[1] ** 2 + toward[2] ** 2)
    l, n_s = toward / length, np.exp(material[6])
    for k in range(len(n)):
        n_l = n[k, 0] * l[0] + n[k, 1] * l[1] + n[k, 2] * l[2]
        cosine, lit = 2.0 * n_l * n[k, 2] - l[2], 1.0 if n_l > 0 else 0.0
        shines = n_l > 0 and cosine > 0
        log = np.log(cosine) if shines else 0.0
        highlight = np.exp(n_s * log) if shines else 0.0
        steep = n_s * highlight / cosine if shines else 0.0
        for c in range(3):
            row, k_d, k_s = 3 * k + c, material[c], material[3 + c]
            r[row] = k_d * lit * n_l + k_s * highlight - image[k, c]
            by_material[row] = 0.0
            by_material[row, c], by_material[row, 3 + c] = lit * n_l, highlight
            by_material[row, 6] = k_s * highlight * n_s * log
            along = 0.0
            for x in range(3):
                by_light[row, x] = (k_d * lit + 2.0 * k_s * steep * n[k, 2]) * n[k, x]
                by_light[row, x] -= k_s * steep if x == 2 else 0.0
                along += by_light[row, x] * l[x]
            for x in range(3):
                by_light[row, x] = (by_light[row, x] - along * l[x]) / length


def of_view_in_numpy(material, toward, image, n, r, by_material, by_light):
    """Do what `of_view` does, a statement for all pixels."""
    length = np.sqrt(toward @ toward)
    l, n_s, pixels, channels = toward / length, np.exp(material[6]), len(n), np.arange(3)
    n_l = n @ l
    cosine, lit = 2.0 * n_l * n[:, 2] - l[2], n_l > 0
    shines = lit & (cosine > 0)
    safe = np.where(shines, cosine, 1.0)
    log, diffuse = np.log(safe), np.where(lit, n_l, 0.0)
    highlight = np.where(shines, np.exp(n_s * log), 0.0)
    r[:] = (np.outer(diffuse, material[:3]) + np.outer(highlight, material[3:6]) - image).reshape(-1)
    J = by_material.reshape(pixels, 3, 7)
    J[:] = 0.0
    J[:, channels, channels], J[:, channels, 3 + channels] = diffuse[:, None], highlight[:, None]
    J[:, :, 6] = np.outer(highlight * n_s * log, material[3:6])
    steep = np.outer(n_s * highlight / safe, material[3:6])
    along = (np.outer(lit, material[:3]) + 2.0 * steep * n[:, 2:])[:, :, None] * n[:, None]
    along[:, :, 2] -= steep
    by_light.reshape(pixels, 3, 3)[:] = (along - (along @ l)[:, :, None] * l) / length


def ceres(scene: ds.Scene, views: list[ds.View], of_view: Callable = of_view) -> tuple[np.ndarray, np.ndarray]:
    """Return the material and the directions to the lights by Ceres' `DENSE_SCHUR`."""
    import pyceres

    seen = ds.intersect(scene, views[0].camera)
    inside = np.asarray(seen.mask)
    n = np.ascontiguousarray(np.asarray(seen.normal, float)[inside])
    stated = np.array([-np.asarray(light.direction, float) for light in scene.lights])  # pyright: ignore

    class OfView(pyceres.CostFunction):
        def __init__(self, image: np.ndarray):
            super().__init__()
            self.image = np.ascontiguousarray(image[inside])
            self.set_num_residuals(self.image.size)
            self.set_parameter_block_sizes([7, 3])

        def Evaluate(self, parameters, out, jacobians):  # noqa: N802
            into = [np.empty((self.image.size, columns)) for columns in (7, 3)]
            for k, jacobian in enumerate(jacobians or ()):
                if jacobian is not None:
                    into[k] = np.asarray(jacobian).reshape(into[k].shape)
            of_view(np.asarray(parameters[0]), np.asarray(parameters[1]), self.image, n, out, *into)
            return True

    class Stated(pyceres.CostFunction):
        """What is known of a direction: the stated one to its error, and a length of 1."""

        def __init__(self, toward: np.ndarray):
            super().__init__()
            self.toward = toward
            self.set_num_residuals(4)
            self.set_parameter_block_sizes([3])

        def Evaluate(self, parameters, out, jacobians):  # noqa: N802
            weight, d = NOISE / np.deg2rad(DEGREES), np.asarray(parameters[0])
            out[:] = np.append(weight * (d - self.toward), 0.5 * (d @ d - 1.0))
            if jacobians is not None:
                jacobians[0][:] = np.concatenate([weight * np.eye(3), d[None]]).reshape(-1)
            return True

    material, directions = START.copy(), [d.copy() for d in stated]
    problem, options, summary = pyceres.Problem(), pyceres.SolverOptions(), pyceres.SolverSummary()
    for view, toward, said in zip(views, directions, stated, strict=True):
        problem.add_residual_block(OfView(np.asarray(view.image)), None, [material, toward])
        problem.add_residual_block(Stated(said), None, [toward])
    options.linear_solver_type = pyceres.LinearSolverType.DENSE_SCHUR
    options.function_tolerance = options.parameter_tolerance = 1e-10
    options.max_num_iterations = 200
    options.num_threads = os.cpu_count() or 1
    options.minimizer_progress_to_stdout = False
    options.logging_type = pyceres.LoggingType.SILENT
    pyceres.solve(options, problem, summary)
    return material, np.array([d / np.linalg.norm(d) for d in directions])


def seconds_of_solver(scene: ds.Scene, views: list[ds.View], clock: Callable[[], float]) -> float:
    """Return the seconds of `ds.fit` from its samples to the minimum, from the start that Ceres is given.

    Reading, checks and error bars, which Ceres does not have, are left out, and so are the places
    where lights are tried once more.
    """
    from diffshade.inverse import fitting, solving

    def begun(s: ds.Scene) -> tuple:
        material = s.objects[0].material
        return material.k_d, material.k_s, material.n_s

    given = eqx.tree_at(begun, scene, (START[:3], START[3:6], np.exp(START[6])))
    stated = [dataclasses.replace(view, noise=NOISE) for view in views]  # which Ceres is given too
    whole, elsewhere, taken = solving.solve, solving._with_lights_elsewhere, []

    def timed(*of: Any, **options: Any) -> Any:
        began = clock()
        found = whole(*of, **options)
        taken.append(clock() - began)
        return found

    fitting.solve = timed  # pyright: ignore[reportPrivateImportUsage]
    solving._with_lights_elsewhere = lambda laid, end, report_progress: end
    try:
        ds.fit(given, stated, free=(*MATERIAL, "direction"), light_error=DEGREES, start="scene")
    finally:
        fitting.solve = whole  # pyright: ignore[reportPrivateImportUsage]
        solving._with_lights_elsewhere = elsewhere
    (seconds,) = taken
    return seconds


def beside_the_solver(
    scene: ds.Scene, views: list[ds.View], rounds: int, clock: Callable[[], float]
) -> tuple[float, float]:
    """Return the time of Ceres over that of the solver, with compiled callbacks and with NumPy's, in the same rounds.

    Each runs twice in its turn, of which the second time counts, as `take_turns` has it.
    """

    def seconds(of: Callable) -> float:
        began = clock()
        ceres(scene, views, of)
        return clock() - began

    turns = (
        lambda: seconds(of_view),
        lambda: seconds(of_view_in_numpy),
        lambda: seconds_of_solver(scene, views, clock),
    )
    times = np.array([[[turn() for _ in range(2)][-1] for turn in turns] for _ in range(1 + rounds)])[1:]
    compiled, in_numpy = np.median(times[:, :2] / times[:, 2:], 0)
    return float(compiled), float(in_numpy)


def main() -> None:
    """Print the times by the number of views, and how far the directions are from the truth and from Ceres'."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--views", nargs="+", type=int, default=(12, 24, 48, 96, 192), help="(default: %(default)s)")
    parser.add_argument("--size", type=int, default=SIZE, help="pixels along a side of a view (default: %(default)s)")
    parser.add_argument("--rounds", type=int, default=3, help="rounds, whose median counts (default: %(default)s)")
    parser.add_argument("--cpu", action="store_true", help="processor time, which others' load hardly changes")
    arguments = parser.parse_args()
    clock = time.process_time if arguments.cpu else time.perf_counter
    table = Table(
        "views",
        "known lights, s",
        "free, s",
        "free / known",
        "Ceres / free",
        "Ceres / solver",
        "Ceres in NumPy / solver",
        "off, degrees",
        "off Ceres'",
    )
    times = []
    for count in arguments.views:
        scene, views, towards = make(count, arguments.size)

        def free(scene: ds.Scene = scene, views: list[ds.View] = views) -> ds.Fit:
            return ds.fit(scene, views, free=(*MATERIAL, "direction"), light_error=DEGREES)

        def known(scene: ds.Scene = scene, views: list[ds.View] = views) -> ds.Fit:
            return ds.fit(scene, views, free=MATERIAL)

        made = {
            "known": lambda k=known: k().values,
            "free": lambda f=free: f().values,
            "Ceres": lambda s=scene, v=views: ceres(s, v)[0],
        }
        seconds = take_turns(made, arguments.rounds, clock=clock)
        found = medians(seconds)
        fit, of_ceres, (material, by_ceres) = free(), found["Ceres"], ceres(scene, views)
        ours = np.array([-np.asarray(light.direction) for light in fit.scene.lights])  # pyright: ignore
        off, apart = (np.rad2deg(np.arccos(np.clip((ours * of).sum(-1), -1, 1))) for of in (towards, by_ceres))
        assert np.allclose(fit.values[:6], material[:6], rtol=1e-3), "the two end at different materials"
        assert np.allclose(ceres(scene, views, of_view_in_numpy)[0], material, rtol=1e-6), "Ceres' two differ"
        times.append((count, found["free"]))
        table.add_row(
            str(count),
            f"{found['known']:.2f}",
            f"{found['free']:.2f}",
            f"{found['free'] / found['known']:.1f}",
            f"{of_ceres / found['free']:.1f}",
            *(f"{ratio:.1f}" for ratio in beside_the_solver(scene, views, arguments.rounds, clock)),
            f"{off.max():.3f}",
            f"{apart.max():.1e}",
        )
    Console().print(table)
    if len(times) > 1:
        views, seconds = np.log(np.array(times)).T
        slope = np.polyfit(views, seconds, 1)[0]
        print(f"time grows with the views to the power of {slope:.2f}")


if __name__ == "__main__":
    main()
