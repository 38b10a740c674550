"""Render the targets of every scene in data_synthetic/scenes: one view a light, the truth beside them.

For scene NAME and light I, three files in OUT/NAME: clean_I.exr (32-bit float), noisy_I.exr (with Gaussian noise) and
photo_I.png (the noisy one clipped to 8-bit sRGB, as a camera would). truth.toml is the scene and its camera.
"""

import argparse
import logging
import sys
from pathlib import Path

import jax
import numpy as np
from rich.progress import track

import diffshade as ds

HERE = Path(__file__).parent
SIGMA, SEED = 0.005, 20140929


def generate(scene_file: Path, folder: Path) -> None:
    """Write the targets of one scene; its noise depends on its name alone."""
    scene, camera = ds.read_scene(scene_file), ds.read_camera(scene_file)
    noise = np.random.default_rng([SEED, *scene_file.stem.encode()])
    folder.mkdir(parents=True, exist_ok=True)
    ds.write_scene(folder / "truth.toml", scene, camera=camera)
    for i in range(len(scene.lights)):
        with jax.enable_x64(True):
            clean = np.asarray(ds.render(scene, camera, lit=(i,)))
        noisy = clean + noise.normal(0.0, SIGMA, clean.shape)
        ds.write_image(folder / f"clean_{i}.exr", clean)
        ds.write_image(folder / f"noisy_{i}.exr", noisy)
        ds.write_image(folder / f"photo_{i}.png", noisy)


def main() -> None:
    """Generate every scene."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=Path, default=HERE / "scenes", help="folder of scenes (default: %(default)s)")
    parser.add_argument("--out", type=Path, default=HERE / "targets", help="folder to write to (default: %(default)s)")
    arguments = parser.parse_args()
    logging.getLogger("diffshade").setLevel(logging.ERROR)  # that noise passes below 0 and brass above 1 is meant
    scenes = sorted(arguments.scenes.glob("*.toml"))
    if not scenes:
        raise FileNotFoundError(f"there is no scene, a .toml file, in {arguments.scenes}. Give another --scenes.")
    for scene_file in track(scenes, "scenes", disable=not sys.stderr.isatty()):
        generate(scene_file, arguments.out / scene_file.stem)
    print(f"{len(scenes)} scenes in {arguments.out}")


if __name__ == "__main__":
    try:
        main()
    except (OSError, ValueError, TypeError, ArithmeticError, RuntimeError) as error:
        sys.exit(f"generate: {error}")
