"""Lamp files written out of a beam, in every symmetry that IES and EULUMDAT know."""

import numpy as np

import diffshade as ds

TABLE = ds.lamps.Profile(
    [0, 20, 50, 90, 130],
    [0, 45, 180, 360],
    [[1, 0.9, 0.5, 0.2, 0], [1, 0.7, 0.6, 0.1, 0], [1, 0.8, 0.2, 0.1, 0], [1, 0.9, 0.5, 0.2, 0]],
)
LAMP = ds.lamps.MeasuredLight(
    (0.3, 2, 0.4), (0.1, -1, 0.2), TABLE, (4, 2, 1), ds.RadialAttenuation(0.2, 0.1, 1), (1, 0.2, 0)
)
VERTICAL = np.array([0.0, 10, 25, 45, 70, 90])


def beam(C, gamma, *, about=()):
    """A beam of any shape that mirrors itself about some planes: about 0 it is even in sin C, about 90 in cos C."""
    C, gamma = np.deg2rad(C), np.deg2rad(gamma)
    sine = 0.4 * np.sin(C) ** 2 if 0 in about else 0.4 * np.sin(C)
    cosine = 0.3 * np.cos(C) ** 2 if 90 in about else 0.3 * np.cos(C)
    return 100 * np.cos(gamma) * (1 + np.sin(gamma) * (sine + cosine))


def ies(
    horizontal, values, vertical=VERTICAL, *, before="IESNA:LM-63-2002\n[TEST]1\n", tilt="TILT=NONE", scale=1, kind=1
):
    rows = ["1 -1 " + f"{scale} {len(vertical)} {len(horizontal)} {kind} 2 0 0 0", "1 1 10"]
    rows += [" ".join(f"{x:.10g}" for x in row) for row in (vertical, horizontal, *values)]
    return before + tilt + "\n" + "\n".join(rows) + "\n"


def ldt(symmetry, planes, values, vertical=VERTICAL, *, flux=1000.0, factor=1.0):
    C = np.arange(planes) * 360.0 / planes
    head = ["maker", 2, symmetry, planes, 360 / planes, len(vertical), 0, "report", "name", 1, "file", "date"]
    head += [0] * 9 + [100, 100, factor, 0, 1, 1, "LED", flux, 4000, 80, 10] + [0] * 10
    return "\r\n".join(str(x) for x in [*head, *C, *vertical, *np.ravel(values)]) + "\r\n"


def towards(gamma, C):
    """Points below a lamp at the origin that shines down, C = 0 to +x: C grows as seen from above, from +x to -z."""
    gamma, C = np.broadcast_arrays(np.deg2rad(gamma), np.deg2rad(C))
    return np.stack([np.sin(gamma) * np.cos(C), -np.cos(gamma), -np.sin(gamma) * np.sin(C)], -1)
