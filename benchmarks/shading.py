"""Compare the forward render, and the gradient, with what a user would write instead: NumPy, PyTorch, numba.

One sphere under one point light with a local viewer, float32. Forward: everyone is given the same positions, normals
and mask, as arrays of their own on the device, and makes a picture (H, W, 3); `ds.shade` is the public call, checks
included, and "in your own jit" the same call as a part of a caller's compiled program. Gradient: the sum of squares
against a target and its derivatives by k_a, k_d, k_s, n_s, linear and quadratic, 12 numbers.

Where JAX finds a GPU the same commands run there; PyTorch too if it has one. `of the copy bound` is how near the
forward render comes to reading its 25 bytes a pixel and writing 12 at the speed at which a copy runs: 1 is as fast as
memory lets it. On a CPU with few cores arithmetic is the bound, not memory.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import shading_peers as peers
from rich.console import Console
from rich.table import Table
from timing import Seconds, conditions, medians, ratio, take_turns

import diffshade as ds

SIZES = (128, 256, 512, 1024)
BYTES = 12 + 12 + 1 + 12  # a pixel: normal, position and mask in, colour out
CALL, INSIDE = "ds.shade", "ds.shade in your own jit"
NUMPY, NUMPY_EINSUM, NUMPY_APART = "NumPy", "NumPy, einsum", "NumPy, x y z apart"
TORCH, TORCH_APART, TORCH_COMPILED = "PyTorch", "PyTorch, x y z apart", "torch.compile, x y z apart"
NUMBA = "numba, all cores"
COPY = "copy of as many bytes"


def main() -> None:
    """Time every size and print a table for each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", nargs="+", type=int, default=SIZES, help="pixels on a side (default: 128 to 1024)")
    parser.add_argument("--rounds", type=int, default=25, help="rounds in which all take turns (default: 25)")
    parser.add_argument("--cpu", action="store_true", help="time what all threads compute, not what a clock shows")
    parser.add_argument("--no-compile", action="store_true", help="leave torch.compile out, which needs a C++ compiler")
    parser.add_argument("--json", type=Path, help="write every number to this file too")
    arguments = parser.parse_args()
    for name, there in (("PyTorch", peers.HAS_TORCH), ("numba", peers.HAS_NUMBA)):
        if not there:
            print(
                f"{name} is left out: it is not installed. pip install 'diffshade[bench]' brings it.", file=sys.stderr
            )
    found = {}
    for size in arguments.sizes:
        for what, programs in (("forward", forward), ("gradient", gradient)):
            made = programs(size, compiled=not arguments.no_compile)
            clock = time.process_time if arguments.cpu else time.perf_counter
            seconds = take_turns(made, arguments.rounds, f"{what} {size}", clock)
            found[f"{what} {size}"] = seconds
            show(f"{what}, {size} x {size}{', processor time' * arguments.cpu}, {conditions()}", size, seconds)
        if arguments.json:
            arguments.json.write_text(json.dumps(found, indent=1), encoding="utf-8")


def show(title: str, size: int, seconds: Seconds) -> None:
    """Print the table of one size: medians, and ratios to the public call of diffshade."""
    middle = medians(seconds)
    first = next(iter(seconds))
    table = Table(title=title)
    for heading in ("", "ms", "ratio", "Mpixels/s"):
        table.add_column(heading, justify="left" if not heading else "right")
    for name, of in middle.items():
        table.add_row(name, f"{1e3 * of:.2f}", f"{ratio(seconds, name, first):.1f}", f"{size**2 / of / 1e6:.0f}")
    Console(width=110).print(table)
    if COPY in seconds:
        rate = BYTES * size**2 / middle[COPY] / 1e9
        share = ratio(seconds, COPY, INSIDE)
        print(f"copy: {rate:.1f} GB/s; {INSIDE}: {share:.2f} of the copy bound, {BYTES} bytes a pixel")


def problem(size: int) -> tuple[ds.Scene, ds.Camera, ds.GBuffer]:
    """Return the scene, and what its camera sees: positions, normals and mask on JAX's device."""
    material = ds.Material(k_a=0.05, k_d=(0.70, 0.25, 0.20), k_s=0.4, n_s=40)
    light = ds.PointLight((2, 3, 4), intensity=10, attenuation=ds.RadialAttenuation(1.0, 0.1, 0.5))
    scene = ds.Scene(ds.Object(ds.Sphere(), material), light)
    camera = ds.Camera(eye=(0, 0, 4), fov=30, shape=(size, size))
    return scene, camera, ds.intersect(scene, camera)


def given(scene: ds.Scene, camera: ds.Camera, gbuffer: ds.GBuffer) -> peers.Given:
    """Return the same numbers as NumPy arrays, float32."""
    light, material = scene.lights[0], scene.objects[0].material
    assert isinstance(light, ds.PointLight)
    fade = light.attenuation
    numbers = (light.position, camera.eye, light.intensity, material.k_a, material.k_d, material.k_s, material.n_s)
    surface = (np.array(gbuffer.normal), np.array(gbuffer.position), np.array(gbuffer.mask))
    return peers.Given(*surface, *(np.float32(a) for a in (*numbers, fade.linear, fade.quadratic)))


def forward(size: int, *, compiled: bool) -> dict[str, Callable]:
    """Return what renders the sphere from its G-buffer; all give the same picture, which is checked."""
    scene, camera, gbuffer = problem(size)
    g = given(scene, camera, gbuffer)
    inside = jax.jit(lambda scene, gbuffer: ds.shade(scene, gbuffer, camera))
    source = jnp.zeros(BYTES * size**2 // 8, jnp.float32)  # a copy reads and writes: half as much each way
    copy = jax.jit(lambda a, by: a + by)
    programs: dict[str, Callable] = {
        CALL: lambda: ds.shade(scene, gbuffer, camera),
        INSIDE: lambda: inside(scene, gbuffer),
        NUMPY: lambda: peers.numpy_plain(g),
        NUMPY_EINSUM: lambda: peers.numpy_einsum(g),
        NUMPY_APART: lambda: peers.numpy_apart(g),
    }
    if peers.HAS_TORCH:
        t = peers.to_torch(g)
        programs[TORCH] = _finished(lambda: peers.torch_trailing(t))
        programs[TORCH_APART] = _finished(lambda: peers.torch_apart(t))
        if compiled:
            import torch

            fused = torch.compile(peers.torch_apart)
            programs[TORCH_COMPILED] = _finished(lambda: fused(t))
    if peers.HAS_NUMBA:
        loop = peers.numba_loop()
        programs[NUMBA] = lambda: loop(g)
    image = np.asarray(ds.shade(scene, gbuffer, camera))
    for name, run in programs.items():
        got = run()
        np.testing.assert_allclose(got.cpu() if hasattr(got, "cpu") else got, image, atol=2e-5, err_msg=name)
    return {**programs, COPY: lambda: copy(source, 1.0)}


def gradient(size: int, *, compiled: bool) -> dict[str, Callable]:
    """Return what gives the sum of squares and its slopes, which are compared."""
    scene, camera, gbuffer = problem(size)
    g = given(scene, camera, gbuffer)
    target = np.asarray(ds.shade(scene, gbuffer, camera)) * np.float32(0.9) + np.float32(0.01)
    on_device = jnp.asarray(target)
    unknown = {name: getattr(g, name) for name in peers.UNKNOWNS}

    def loss(unknown: dict, gbuffer: ds.GBuffer, target: jax.Array) -> jax.Array:
        of = {name: unknown[name] for name in ("k_a", "k_d", "k_s", "n_s")}
        fade = ds.RadialAttenuation(1.0, unknown["linear"], unknown["quadratic"])
        lamp = ds.PointLight(g.light, g.intensity, fade)
        image = ds.shade(ds.Scene(ds.Object(ds.Sphere(), ds.Material(**of)), lamp), gbuffer, camera)
        return jnp.sum((image - target) ** 2)

    reverse = jax.jit(jax.value_and_grad(loss))
    programs: dict[str, Callable] = {"diffshade, jax.grad": lambda: reverse(unknown, gbuffer, on_device)}
    if peers.HAS_TORCH:
        import torch

        t = peers.to_torch(g)
        aim = torch.as_tensor(target, device=t.normal.device)
        programs[TORCH] = _finished(peers.torch_gradient(peers.torch_trailing, t, aim))
        programs[TORCH_APART] = _finished(peers.torch_gradient(peers.torch_apart, t, aim))
        if compiled:
            programs[TORCH_COMPILED] = _finished(peers.torch_gradient(torch.compile(peers.torch_apart), t, aim))
    slopes = programs["diffshade, jax.grad"]()[1]
    for name, run in list(programs.items())[1:]:
        for key, slope in zip(peers.UNKNOWNS, run()[1], strict=True):
            np.testing.assert_allclose(slope.cpu(), slopes[key], rtol=2e-3, err_msg=f"{name}, {key}")
    return programs


def _finished(run: Callable) -> Callable:
    """Return what runs a program of PyTorch and waits for the GPU, where there is one."""
    import torch

    if not torch.cuda.is_available():
        return run

    def wait() -> object:
        got = run()
        torch.cuda.synchronize()
        return got

    return wait


if __name__ == "__main__":
    main()
