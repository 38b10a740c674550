"""Fit the classic lobes to the 100 materials of the MERL database, and write diffshade/model/measured_materials.csv.

The materials are those of the ABC model (Löw, Kronander, Ynnerman and Unger 2012, BRDF Models for Accurate and
Efficient Rendering of Glossy Surfaces), whose parameters for the database (Matusik, Pfister, Brand and McMillan 2003)
are in dj_brdf.h (Jonathan Dupuy, public domain). With D = A / (1 + B (1 - n.h))^C, Fresnel's F of a dielectric, and G =
min(1, 2 (n.h)(n.l)/(v.h), 2 (n.h)(n.v)/(v.h)), it is f = (k + F D G / ((n.l)(n.v))) / pi.

A classic highlight carries no n.l, so what is fitted is f (n.l) pi: the radiance under a light of intensity 1, as this
library means it. Light and viewer are at most 75 degrees from the normal, and 0 to 80 degrees apart.

    python data_synthetic/measured_materials.py PATH/dj_brdf.h
"""

import csv
import re
import sys
from pathlib import Path

import numpy as np

import diffshade as ds
from diffshade.exchange.classic_fits import nearest
from diffshade.exchange.lobe_refits import N_S_RANGE
from diffshade.exchange.reference import Reference, radiance, reference

OUT = Path(ds.__file__).parent / "model" / "measured_materials.csv"
STEEPEST = np.cos(np.deg2rad(75.0))
NUMBERS = r"([-\d.e+, ]+)"
ROW = re.compile(rf'{{ "([\w-]+)", {{{NUMBERS}}}, {{{NUMBERS}}}, {NUMBERS} }}')


def fresnel(cosine: np.ndarray, ior: float) -> np.ndarray:
    """Return the unpolarised reflectance of a dielectric."""
    g = np.sqrt(ior**2 - 1.0 + cosine**2)
    ratio = (cosine * (g + cosine) - 1.0) / (cosine * (g - cosine) + 1.0)
    return 0.5 * ((g - cosine) / (g + cosine)) ** 2 * (1.0 + ratio**2)


def abc(points: Reference, k: np.ndarray, A: np.ndarray, B: float, C: float, ior: float) -> np.ndarray:
    """Return f (n.l) pi."""
    n_h, n_l, n_v, v_h = points.n_h, points.n_l, points.n_v, points.v_h
    D = A / ((1.0 + B * (1.0 - n_h)) ** C)[:, None]
    G = np.minimum(1.0, 2.0 * n_h * np.minimum(n_l, n_v) / v_h)
    return n_l[:, None] * k + D * (fresnel(v_h, ior) * G / n_v)[:, None]


def points_for(B: float, C: float) -> Reference:
    """Return points over the highlight, as wide as where D is half, over its tail, and over the hemisphere."""
    n_s = np.log(2.0) * B / (2.0 ** (1.0 / C) - 1.0)
    parts = [reference(float(np.clip(n, *N_S_RANGE))) for n in (n_s, n_s / 30.0)]
    all_ = Reference(*(np.concatenate([getattr(of, axis) for of in parts]) for axis in ("n", "l")))
    inside = (all_.n_l >= STEEPEST) & (all_.n_v >= STEEPEST)
    return Reference(all_.n[inside], all_.l[inside])


def main() -> None:
    """Write the table: for each material the nearest one of each lobe, with one and with up to two highlights."""
    rows = []
    for name, k, A, numbers in ROW.findall(Path(sys.argv[1]).read_text()):
        B, C, ior = (float(x) for x in numbers.split(","))
        points = points_for(B, C)
        diffuse, strength = (np.array([float(x) for x in of.split(",")]) for of in (k, A))
        target = abc(points, diffuse, strength, B, C, ior)
        weight = 1.0 / np.maximum(1.0, target.max(1, keepdims=True))
        for lobe in (ds.Phong(), ds.Blinn()):
            for most in (1, 2):
                found = nearest(target, points, (lobe,), most)
                off = (radiance(found.material(), points) - target) * weight
                numbers_ = [*found.k_d, *(x for of in found.highlights for x in (*np.asarray(of.k_s), float(of.n_s)))]
                numbers_ += [0.0] * (11 - len(numbers_))
                errors = [np.sqrt(np.mean(off**2)), np.abs(off).max(), target.max()]
                row = [f"{x:.5g}" for x in (*numbers_, *errors)]
                rows.append([f"merl_{name.replace('-', '_')}", type(lobe).__name__, most, *row])
        print(*rows[-1])
    terms = [f"k_d_{c}" for c in "rgb"] + [f"{x}{i}" for i in (1, 2) for x in ("k_s_r", "k_s_g", "k_s_b", "n_s")]
    with OUT.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["name", "lobe", "highlights", *terms, "rms", "largest", "peak"])
        writer.writerows(rows)


if __name__ == "__main__":
    main()
