"""Relighting: photographs that were left out, ten at a time, predicted by texels, PTM, HSH and radial basis functions.

    .venv/bin/python benchmarks/relighting.py FOLDER [--sRGB] [--page]

The peak signal-to-noise ratio is over the mask, of the numbers as they are stored, 1 the brightest. PTM and HSH are
fitted by least squares to each texel and channel, as RTI programs do; radial basis functions are thin plate splines of
the lights' directions (SciPy).

With --page, the page of each group's maps is opened in headless Chromium, and the picture that it draws in the light of
each photograph that was left out is compared as well: a pixel for each texel, every control as a reader finds it, but
for the exposure, which is lowered until the largest number of a file is not clipped. Needs Chromium and its driver.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, nullcontext
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import RBFInterpolator

import diffshade as ds
from diffshade.io.rti_files import terms

SUPPORT = Path(__file__).parent.parent / "tests" / "support"
FOLDS = 5
RING = 0.05  # lights whose z is within so much of the lowest one's are the lowest ring


def by_basis(basis: str, count: int, seen: np.ndarray, images: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return photographs under other lights, from a fit of a basis to the ones that were seen."""
    A, B = (np.stack([terms(basis, count, l) for l in lights]) for lights in (seen, others))
    return np.tensordot(B @ np.linalg.pinv(A), images, 1)


def by_splines(seen: np.ndarray, images: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return photographs under other lights, by interpolation between the ones that were seen."""
    weights = RBFInterpolator(seen, np.eye(len(seen)))(others)
    return np.tensordot(weights, images, 1)


@contextmanager
def page_opener() -> Iterator[Callable[[Path], Any]]:
    """Start Chromium, and give what opens a page of maps in it; only this needs what the tests need."""
    sys.path.insert(0, str(SUPPORT))
    import pytest
    from browser import chromium
    from maps_stage import Stage

    with tempfile.TemporaryDirectory() as profile, ExitStack() as stack:
        try:
            browser = stack.enter_context(chromium(Path(profile)))
        except pytest.skip.Exception as missing:
            raise SystemExit(f"{missing}".replace("this test", "--page")) from None
        yield partial(Stage, browser)


def by_page(
    open_page: Callable[[Path], Any], maps: ds.TexelMaps, seen: Sequence[ds.View], left_out: Sequence[ds.View]
) -> np.ndarray:
    """Return what the page of maps draws in the light of each photograph that was left out, linear."""
    with tempfile.TemporaryDirectory() as folder:
        ds.write_report(Path(folder) / "maps.html", maps, views=seen, held_out=left_out)
        stage, mask = open_page(Path(folder) / "maps.html"), np.asarray(left_out[0].mask)
        if (stage.height, stage.width) != mask.shape:
            raise SystemExit(
                f"the page has {stage.height} x {stage.width} texels and the photographs {mask.shape[0]} x "
                f"{mask.shape[1]} pixels, so they cannot be compared. Give smaller photographs."
            )
        stops = min(0.0, -float(np.log2(max(view["gain"] for view in stage.told["views"]))))
        drawn = []
        for i in range(len(seen), len(seen) + len(left_out)):
            picture = stage.draw(view=str(i), exposure=stops)
            drawn.append(stage.radiance(picture, i, 2.0**stops)[mask])
    return np.stack(drawn)


def psnr(shown: np.ndarray, image: np.ndarray) -> float:
    """Return the peak signal-to-noise ratio of a picture, dB."""
    return float(-10.0 * np.log10(np.mean((np.clip(shown, 0.0, 1.0) - image) ** 2)))


def main(folder: Path, srgb: bool, open_page: Callable[[Path], Any] | None) -> None:
    """Print the ratio for each light and method, and their means; with what opens pages, that of the page."""
    scene, views = ds.read_photographs(folder, normals=False, srgb=srgb)
    directions = [light.direction for light in scene.lights if isinstance(light, ds.DirectionalLight)]
    if len(directions) < len(scene.lights):
        raise SystemExit(f"{folder} has lamps at places; give photographs under distant lights.")
    toward = -np.stack([np.asarray(direction) for direction in directions])
    mask = np.asarray(views[0].mask)
    stored = np.stack([np.asarray(view.image)[mask] for view in views])
    found: dict[str, np.ndarray] = {}
    for fold in range(FOLDS):
        out = np.arange(len(views)) % FOLDS == fold
        seen, images, others = toward[~out], stored[~out], toward[out]
        fitted, left_out = ([v for v, o in zip(views, out, strict=True) if o == which] for which in (False, True))
        maps = ds.fit_texels(scene, fitted, free=("k_d", "k_s", "n_s", "normal"))
        shown = {
            "texels": np.stack([maps.shade(lit=int(i))[mask] for i in np.flatnonzero(out)]),
            "PTM": by_basis("ptm", 6, seen, images, others),
            "HSH 9": by_basis("hsh", 9, seen, images, others),
            "HSH 16": by_basis("hsh", 16, seen, images, others),
            "RBF": by_splines(seen, images, others),
        }
        if open_page is not None:
            shown = {"page": by_page(open_page, maps, fitted, left_out), **shown}
        for name, pictures in shown.items():
            row = found.setdefault(name, np.zeros(len(views)))
            row[out] = [psnr(picture, image) for picture, image in zip(pictures, stored[out], strict=True)]
        print(f"fold {fold}: " + ", ".join(f"{name} {row[out].mean():.2f}" for name, row in found.items()), flush=True)
    low = toward[:, 2] < toward[:, 2].min() + RING
    ours = next(iter(found))
    best = np.max([row for name, row in found.items() if name not in ("page", "texels")], axis=0)
    print("| light | z | " + " | ".join(found) + " |")
    for i in np.argsort(toward[:, 2]):
        print(f"| {i} | {toward[i, 2]:.2f} | " + " | ".join(f"{row[i]:.1f}" for row in found.values()) + " |")
    for name, row in found.items():
        wins = int((found[ours] > row).sum())
        print(
            f"{name}: mean {row.mean():.2f}, lowest ring {row[low].mean():.2f}; {ours} better for {wins} of {len(row)}"
        )
    if ours == "page":
        print(f"page and texels differ by {np.abs(found['page'] - found['texels']).max():.3f} dB at most")
    wins = int((found[ours] > best).sum())
    print(f"{ours} better than all others for {wins} of {len(best)} lights; {low.sum()} lights in the lowest ring")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--sRGB", dest="srgb", action="store_true", help="decode the photographs; by default linear")
    parser.add_argument("--page", action="store_true", help="compare what the page draws as well")
    given = parser.parse_args()
    with page_opener() if given.page else nullcontext() as open_page:
        main(given.folder, given.srgb, open_page)
