"""What a user would write instead of `ds.shade`: one point light on a G-buffer, in NumPy, PyTorch and numba.

Every program is given the same positions, normals and mask, float32, and returns the same picture (H, W, 3): E1, E2,
E4, E5 with v towards the eye. NumPy and PyTorch come in two forms: with a trailing axis of 3, as one writes it, and
with x, y and z apart, as one writes it when it is too slow.
"""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

HAS_TORCH, HAS_NUMBA = (importlib.util.find_spec(name) is not None for name in ("torch", "numba"))
UNKNOWNS = ("k_a", "k_d", "k_s", "n_s", "linear", "quadratic")


class Given(NamedTuple):
    """What every program is given: arrays of NumPy or PyTorch, float32."""

    normal: Any
    position: Any
    mask: Any
    light: Any
    eye: Any
    intensity: Any
    k_a: Any
    k_d: Any
    k_s: Any
    n_s: Any
    linear: Any
    quadratic: Any


def numpy_plain(g: Given) -> np.ndarray:
    """NumPy as one first writes it: `np.linalg.norm` and `np.sum` over a trailing axis."""
    to_light, to_eye = g.light - g.position, g.eye - g.position
    d = np.linalg.norm(to_light, axis=-1, keepdims=True)
    l = to_light / d
    v = to_eye / np.linalg.norm(to_eye, axis=-1, keepdims=True)
    n_l = np.sum(g.normal * l, axis=-1, keepdims=True)
    r = 2 * n_l * g.normal - l
    cosine = np.maximum(np.sum(r * v, axis=-1, keepdims=True), 0)
    f = g.intensity / (1 + d * (g.linear + d * g.quadratic))
    lit = g.mask[..., None] & (n_l > 0)
    image = g.k_a + np.where(lit, f * (g.k_d * n_l + g.k_s * cosine**g.n_s), 0)
    return np.where(g.mask[..., None], image, 0)


def numpy_einsum(g: Given) -> np.ndarray:
    """NumPy with `einsum` over a trailing axis, and colours last."""
    to_light, v = g.light - g.position, g.eye - g.position
    d = np.sqrt(np.einsum("...i,...i", to_light, to_light))
    l = to_light / d[..., None]
    v /= np.sqrt(np.einsum("...i,...i", v, v))[..., None]
    n_l = np.einsum("...i,...i", g.normal, l)
    r = 2 * n_l[..., None] * g.normal - l
    cosine = np.maximum(np.einsum("...i,...i", r, v), 0)
    lit = g.mask & (n_l > 0)
    f = 1 / (1 + d * (g.linear + d * g.quadratic))
    diffuse, highlight = np.where(lit, f * n_l, 0), np.where(lit, f * cosine**g.n_s, 0)
    image = g.k_a + g.intensity * (diffuse[..., None] * g.k_d + highlight[..., None] * g.k_s)
    image[~g.mask] = 0
    return image


def numpy_apart(g: Given) -> np.ndarray:
    """NumPy, components apart."""
    (nx, ny, nz), (px, py, pz) = (np.moveaxis(a, -1, 0) for a in (g.normal, g.position))
    lx, ly, lz = (c - p for c, p in zip(g.light, (px, py, pz), strict=True))
    vx, vy, vz = (c - p for c, p in zip(g.eye, (px, py, pz), strict=True))
    d = np.sqrt(lx * lx + ly * ly + lz * lz)
    n_l = (nx * lx + ny * ly + nz * lz) / d
    n_v = nx * vx + ny * vy + nz * vz
    l_v = (lx * vx + ly * vy + lz * vz) / d
    cosine = np.maximum((2 * n_l * n_v - l_v) / np.sqrt(vx * vx + vy * vy + vz * vz), 0)
    lit = g.mask & (n_l > 0)
    f = 1 / (1 + d * (g.linear + d * g.quadratic))
    diffuse, highlight = np.where(lit, f * n_l, 0), np.where(lit, f * cosine**g.n_s, 0)
    image = np.empty_like(g.normal)
    for c in range(3):
        image[..., c] = g.k_a[c] + g.intensity[c] * (diffuse * g.k_d[c] + highlight * g.k_s[c])
    image[~g.mask] = 0
    return image


def torch_trailing(g: Given) -> Any:
    """PyTorch, vectors along a trailing axis."""
    import torch

    to_light = g.light - g.position
    d = torch.linalg.vector_norm(to_light, dim=-1)
    l = to_light / d[..., None]
    v = torch.nn.functional.normalize(g.eye - g.position, dim=-1)
    n_l = (g.normal * l).sum(-1)
    r = 2 * n_l[..., None] * g.normal - l
    return _torch_colours(g, d, n_l, (r * v).sum(-1))


def torch_apart(g: Given) -> Any:
    """PyTorch, components apart."""
    (nx, ny, nz), (px, py, pz) = g.normal.unbind(-1), g.position.unbind(-1)
    lx, ly, lz = (c - p for c, p in zip(g.light, (px, py, pz), strict=True))
    vx, vy, vz = (c - p for c, p in zip(g.eye, (px, py, pz), strict=True))
    d = (lx * lx + ly * ly + lz * lz).sqrt()
    n_l = (nx * lx + ny * ly + nz * lz) / d
    n_v = nx * vx + ny * vy + nz * vz
    l_v = (lx * vx + ly * vy + lz * vz) / d
    return _torch_colours(g, d, n_l, (2 * n_l * n_v - l_v) * (vx * vx + vy * vy + vz * vz).rsqrt())


def _torch_colours(g: Given, d: Any, n_l: Any, cosine: Any) -> Any:
    import torch

    f = 1 / (1 + d * (g.linear + d * g.quadratic))
    lit = g.mask & (n_l > 0)
    bright = lit & (cosine > 0)
    diffuse = torch.where(lit, f * n_l, 0.0)
    highlight = torch.where(bright, f * torch.where(bright, cosine, 1.0) ** g.n_s, 0.0)
    image = g.k_a + g.intensity * (diffuse[..., None] * g.k_d + highlight[..., None] * g.k_s)
    return torch.where(g.mask[..., None], image, 0.0)


def numba_loop() -> Callable[[Given], np.ndarray]:
    """Return the shading as numba compiles it: one loop over the pixels, on all cores."""
    import numba

    one, two, zero = np.float32(1), np.float32(2), np.float32(0)

    @numba.njit(parallel=True, fastmath=True)
    def shade(normal, position, mask, light, eye, intensity, k_a, k_d, k_s, n_s, linear, quadratic):
        image = np.zeros_like(normal)
        for i in numba.prange(normal.shape[0]):
            for j in range(normal.shape[1]):
                if not mask[i, j]:
                    continue
                nx, ny, nz = normal[i, j, 0], normal[i, j, 1], normal[i, j, 2]
                px, py, pz = position[i, j, 0], position[i, j, 1], position[i, j, 2]
                lx, ly, lz = light[0] - px, light[1] - py, light[2] - pz
                vx, vy, vz = eye[0] - px, eye[1] - py, eye[2] - pz
                d = math.sqrt(lx * lx + ly * ly + lz * lz)
                n_l = (nx * lx + ny * ly + nz * lz) / d
                diffuse = highlight = zero
                if n_l > zero:
                    n_v = nx * vx + ny * vy + nz * vz
                    l_v = (lx * vx + ly * vy + lz * vz) / d
                    cosine = (two * n_l * n_v - l_v) / math.sqrt(vx * vx + vy * vy + vz * vz)
                    f = one / (one + d * (linear + d * quadratic))
                    diffuse = f * n_l
                    if cosine > zero:
                        highlight = f * math.exp(n_s * math.log(cosine))
                for c in range(3):
                    image[i, j, c] = k_a[c] + intensity[c] * (diffuse * k_d[c] + highlight * k_s[c])
        return image

    return lambda g: shade(*g)


def to_torch(g: Given) -> Given:
    """Return the same as PyTorch's tensors, on the GPU where PyTorch finds one."""
    import torch

    device = "cuda" if torch.cuda.is_available() else "cpu"
    return Given(*(torch.as_tensor(np.asarray(a), device=device) for a in g))


def torch_gradient(shade: Callable[[Given], Any], g: Given, target: Any) -> Callable[[], Any]:
    """Return what computes the sum of squares against a target and its derivatives by the unknowns."""
    import torch

    unknown = {name: getattr(g, name).clone().requires_grad_() for name in UNKNOWNS}

    def run() -> tuple:
        loss = ((shade(g._replace(**unknown)) - target) ** 2).sum()
        slopes = torch.autograd.grad(loss, list(unknown.values()))
        return loss, slopes

    return run
