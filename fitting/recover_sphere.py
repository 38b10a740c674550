"""Recover a material from a sphere: render 8 views, add noise, fit, and print truth, estimate and error bar."""

import argparse
import sys
from pathlib import Path

import numpy as np

import diffshade as ds

FREE = ("k_a", "k_d", "k_s", "n_s", "attenuation")  # its constant stays fixed: it only scales k_d and k_s


def sphere_under_a_lamp() -> ds.Scene:
    """Return a glossy sphere and one lamp in 8 places, 2, 3 and 5 units away from it: one light a place."""
    distances = np.array([2.0, 3.0, 5.0, 2.0, 3.0, 5.0, 2.0, 3.0])
    around, off_axis = np.deg2rad(45.0 * np.arange(8)), np.deg2rad([20, 50, 35, 55, 30, 45, 40, 25])
    places = np.stack([np.sin(off_axis) * np.cos(around), np.sin(off_axis) * np.sin(around), np.cos(off_axis)], -1)
    material = ds.Material(k_a=(0.10, 0.06, 0.05), k_d=(0.60, 0.25, 0.15), k_s=(0.50, 0.45, 0.40), n_s=50)
    attenuation = ds.RadialAttenuation(constant=1.0, linear=0.09, quadratic=0.032)
    lights = [ds.PointLight(d * place, attenuation=attenuation) for d, place in zip(distances, places, strict=True)]
    return ds.Scene(ds.Object(ds.Sphere(radius=1.0), material), lights)


def main() -> None:
    """Run the whole loop once."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter)
    parser.add_argument("--size", type=int, default=128, help="height and width of a view, pixels")
    parser.add_argument("--sigma", type=float, default=0.005, help="standard deviation of the noise, 1 is white")
    parser.add_argument("--seed", type=int, default=0, help="seed of the noise")
    parser.add_argument("--out", type=Path, default=Path("output"), help="folder for the picture and the page")
    arguments = parser.parse_args()

    if arguments.sigma < 0 or arguments.seed < 0:
        raise ValueError(
            f"--sigma and --seed must be at least 0; got {arguments.sigma} and {arguments.seed}. Give 0 for no noise."
        )

    truth = sphere_under_a_lamp()
    camera = ds.Camera(eye=(0, 0, 4), fov=32, shape=(arguments.size, arguments.size))
    noise = np.random.default_rng(arguments.seed)
    views = []
    for i in range(len(truth.lights)):
        clean = np.asarray(ds.render(truth, camera, lit=(i,)))
        views.append(ds.View(clean + noise.normal(0.0, arguments.sigma, clean.shape), camera, lit=(i,)))

    fit = ds.fit(truth, views, free=FREE, tied=("attenuation",), progress=True)
    print(f"{'parameter':<10} {'truth':>10} {'estimate':>10} {'error bar':>10} {'(estimate - truth)/error bar':>29}")
    for name, known, value, error in zip(fit.names, fit.values_in(truth), fit.values, fit.errors, strict=True):
        print(f"{name:<10} {known:>10.5f} {value:>10.5f} {error:>10.5f} {(value - known) / error:>29.2f}")
    print(f"RMSE {fit.rmse:.5f} after {fit.steps} steps; the noise was {arguments.sigma}")
    for note in fit.notes:
        print(note)

    arguments.out.mkdir(parents=True, exist_ok=True)
    picture = arguments.out / "recover_sphere.png"
    ds.write_figure(picture, ds.draw_comparison(fit, views[:3], titles=[f"lamp {d} units away" for d in (2, 3, 5)]))
    ds.write_report(arguments.out / "report.html", fit, progress=True)
    print(f"target, fit and difference of three of the views: {picture}")
    print(f"all of it on a page for the browser: {arguments.out / 'report.html'}")


if __name__ == "__main__":
    try:
        main()
    except (OSError, ValueError, TypeError, ArithmeticError, RuntimeError) as error:
        sys.exit(f"recover_sphere: {error}")
