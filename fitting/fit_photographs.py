"""Fit one material to a folder of photographs in DiLiGenT's layout, each under one distant light.

The folder holds filenames.txt, light_directions.txt (towards the light), light_intensities.txt, mask.png, and normals
as normal_gt.npy, Normal_gt.mat or normal.txt. Some photographs are held out of the fit and predicted.
"""

import argparse
import sys
from pathlib import Path

import equinox as eqx
import numpy as np

import diffshade as ds

LOBES = {"phong": ds.Phong(), "blinn": ds.Blinn()}


def main() -> None:
    """Read, fit, print, predict what was held out, draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="folder of photographs")
    parser.add_argument("--lobe", choices=LOBES, default="phong", help="shape of the highlight (default: phong)")
    parser.add_argument("--hold-out", type=int, default=8, help="photographs to hold out, evenly spread (default: 8)")
    parser.add_argument("--out", type=Path, default=Path("output"), help="folder to write to (default: output)")
    arguments = parser.parse_args()

    scene, views = ds.read_photographs(arguments.folder)
    scene = eqx.tree_at(lambda s: s.objects[0].material.lobe, scene, LOBES[arguments.lobe])
    if not 0 <= arguments.hold_out < len(views):
        raise ValueError(
            f"--hold-out must be from 0 to {len(views) - 1}, one less than the photographs; got {arguments.hold_out}. "
            "Hold out fewer."
        )
    held_out = {int(i) for i in (np.arange(arguments.hold_out) + 0.5) * len(views) / max(arguments.hold_out, 1)}
    fitted = [view for i, view in enumerate(views) if i not in held_out]

    fit = ds.fit(scene, fitted, free=("k_a", "k_d", "k_s", "n_s"), progress=True)
    print(fit)
    predictions = [fit.predict(views[i]) for i in sorted(held_out)]
    if predictions:
        rmse = np.sqrt(np.mean([p.rmse**2 for p in predictions]))
        brightness = np.mean([p.target[p.counts].mean() for p in predictions])
        print(f"held-out RMSE {rmse:.4g} over {len(predictions)} photographs of mean brightness {brightness:.4g}")

    shown = [*sorted(held_out), *range(len(views))][:3]
    arguments.out.mkdir(parents=True, exist_ok=True)
    picture = arguments.out / "fit_photographs.png"
    titles = [f"photograph {i + 1}{', held out' if i in held_out else ''}" for i in shown]
    ds.write_figure(picture, ds.draw_comparison(fit, [views[i] for i in shown], titles=titles))
    names = [f"photograph {i + 1}" for i in range(len(views)) if i not in held_out]
    ds.write_report(arguments.out / "report.html", fit, titles=names, progress=True)
    print(f"photograph, fit and difference of three of them: {picture}")
    print(f"all of it on a page for the browser: {arguments.out / 'report.html'}")


if __name__ == "__main__":
    try:
        main()
    except (OSError, ValueError, TypeError, ArithmeticError, RuntimeError) as error:
        sys.exit(f"fit_photographs: {error}")
