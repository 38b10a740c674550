"""Photographs of mirror balls drawn with NumPy: a dark one, a bright one, over a table, cut by the frame, or two."""

from typing import NamedTuple

import numpy as np
from scipy import ndimage

KINDS = ("dark", "bright", "table", "cut", "two")
HEIGHT, WIDTH, LIGHTS, FINE = 240, 320, 9, 2  # pixels, photographs, and samples along a pixel


class MirrorBall(NamedTuple):
    photographs: np.ndarray
    """Linear, (photographs, H, W)."""
    circles: np.ndarray
    """Column, row and radius of each ball."""
    directions: np.ndarray


def mirror_ball(kind: str, seed: int) -> MirrorBall:
    """Draw a ball before a spotted wall on which its shadow falls, as 8-bit files with a curve would show it."""
    random = np.random.default_rng((KINDS.index(kind), seed))
    circles = _circles(kind, random)
    tilt, turn = random.uniform(0.15, 1.1, LIGHTS), random.uniform(0.0, 2.0 * np.pi, LIGHTS)
    l = np.stack([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)], -1)
    level = float(random.choice([0.01, 0.1, 0.3]))
    level = {"dark": 0.02, "bright": 0.1}[kind] if kind in ("dark", "bright") else level
    reflected = {"dark": 0.25 * level, "bright": 0.3}[kind] if kind in ("dark", "bright") else 0.8 * level
    table = min(4.0 * level, 0.45) if kind == "table" else random.uniform(0.5, 2.0) * level
    size = random.uniform(0.02, 0.05)  # of a lamp, radians
    rows, columns = (np.indices((HEIGHT * FINE, WIDTH * FINE)) + 0.5) / FINE
    spots = 0.8 * ndimage.gaussian_filter(random.standard_normal(rows.shape), 4.0)
    wall = level * (1.0 + 0.3 * np.sin(columns / random.uniform(20.0, 80.0)) + spots)
    behind = np.where(rows > random.uniform(circles[0, 1] + 0.6 * circles[0, 2], HEIGHT), table, wall)
    photographs = []
    for x, y, z in l:
        across = 2.0 * (columns / WIDTH - 0.5) * x - 2.0 * (rows / HEIGHT - 0.5) * y
        lit = behind * (0.6 + 0.8 * np.clip(across + 0.5, 0.0, 1.0))
        for column, row, radius in circles:
            off = np.hypot(columns - column + 0.8 * radius * x, rows - row - 0.8 * radius * y)
            lit = lit * np.where(off < 1.05 * radius, 0.5, 1.0)
        for column, row, radius in circles:
            n = np.stack([(columns - column) / radius, (row - rows) / radius, np.zeros(rows.shape)], -1)
            rest = 1.0 - (n**2).sum(-1)
            n[..., 2] = np.sqrt(np.maximum(rest, 0.0))
            to = 2.0 * n[..., 2:] * n - np.array([0.0, 0.0, 1.0])
            room = reflected * (1.0 + 0.3 * np.sin(4.0 * to[..., 0] + seed) * np.cos(3.0 * to[..., 1]))
            room = np.where(to[..., 1] < -0.5, 0.8 * table, room) if kind == "table" else room
            off2 = ((to - (x, y, z)) ** 2).sum(-1)
            glint = 5.0 * np.exp(-off2 / (2.0 * size**2)) + 0.02 * np.exp(-off2 / (50.0 * size**2))
            lit = np.where(rest > 0.0, room + glint, lit)
        lit = ndimage.gaussian_filter(lit.reshape(HEIGHT, FINE, WIDTH, FINE).mean((1, 3)), 0.7)
        lit = lit + (0.002 + 0.01 * np.sqrt(lit)) * random.standard_normal(lit.shape)
        photographs.append((np.rint(255.0 * np.clip(lit, 0.0, 1.0) ** (1.0 / 2.2)) / 255.0) ** 2.2)
    return MirrorBall(np.array(photographs), circles, l)


def _circles(kind: str, random: np.random.Generator) -> np.ndarray:
    radius = random.uniform(0.1, 0.3) * HEIGHT * (1.3 if kind == "cut" else 1.0)
    column = random.uniform(radius + 6.0, (WIDTH / 2 if kind == "two" else WIDTH) - radius - 6.0)
    row = random.uniform(radius + 6.0, HEIGHT - radius - 6.0)
    if kind == "cut":
        row = random.uniform(0.3, 0.7) * radius
    circles = [(column, row, radius)]
    if kind == "two":
        circles.append((WIDTH - 0.9 * column, row + 0.1 * radius, 0.85 * min(radius, column)))
    return np.array(circles)
