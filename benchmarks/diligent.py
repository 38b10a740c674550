"""Normals of real objects: photographs in DiLiGenT's layout with `normal_gt.npy`, or an RTI list with `normals.png`.

python benchmarks/diligent.py FOLDER... [--twelve] [--light-error DEGREES]
python benchmarks/diligent.py FOLDER... --speed

One line an object, all by the same defaults: the mean angular error of plain least squares (Woodham 1980), of
`ds.fit_texels`, and what was published for all 96 photographs of the object (Shi et al. 2016); how many of the true
normals lie within the stated 68 % and 95 % angles, and Spearman's correlation of stated and true error; the median
error of the difference of neighbouring normals at borders between statuses, relative to that elsewhere (a seam has far
more than 1); the relative error of photographs that were left out, each as root mean square, its median, mean and
maximum over the photographs, by least squares and by the maps; and seconds. The first run in a process compiles; the
second is timed.

With `--speed`, texels a second alone: of 24 spread photographs, where there are as many; of 96, which are the object's
and, as far as there are too few, these again and again, with all numbers times 1.001, 1.002, ... (a photograph that is
given twice teaches nothing of the lights between, so nothing is learned there); and of 96 pictures that the maps
show under as many different lights. "learned" says that something was.
"""

from __future__ import annotations

import dataclasses
import itertools
import time
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.stats import spearmanr

import diffshade as ds
from diffshade.inverse.data.relightable import dome
from diffshade.inverse.data.views import lights_on

FREE = ("k_d", "k_s", "n_s", "normal")
PUBLISHED = {  # least squares, best classical, a dictionary of BRDFs (HS17), best learned; Shi et al. 2016 and its site
    "ball": (4.10, 1.74, 1.33, 2.03),
    "cat": (8.41, 6.12, 4.88, 4.33),
    "harvest": (30.62, 25.44, 15.81, 12.0),
}


FEW, MANY = 24, 96  # photographs whose speed is measured
LOWEST = 0.2  # z of the lowest of the different lights


class Object(NamedTuple):
    """Photographs of an object whose normals are known."""

    name: str
    scene: ds.Scene
    views: list[ds.View]
    truth: np.ndarray
    mask: np.ndarray


def read(folder: Path) -> Object:
    """Read photographs and true normals in one of the two layouts."""
    if (folder / "normal_gt.npy").exists():
        scene, views = ds.read_photographs(folder, normals=False)
        return Object(
            folder.name, scene, list(views), np.load(folder / "normal_gt.npy"), ds.read_mask(folder / "mask.png")
        )
    lines = [line.split() for line in (folder / "dirs.lp").read_text().splitlines()[1:] if line.strip()]
    mask = ds.read_mask(folder / "mask.png")
    truth = np.asarray(ds.read_image(folder / "normals.png", srgb=False)) * 2.0 - 1.0
    camera = ds.OrthographicCamera((0, 0, 4), shape=mask.shape, local_viewer=False)
    facing = np.broadcast_to(np.array([0.0, 0.0, 1.0]), (*mask.shape, 3))
    lights = [ds.DirectionalLight(tuple(-float(x) for x in line[1:4])) for line in lines]
    scene = ds.Scene(ds.Object(ds.GBuffer(facing, None, mask), ds.Material(k_d=0.5)), lights)
    views = [ds.View(ds.read_image(folder / line[0], srgb=False), camera, mask, lit=k) for k, line in enumerate(lines)]
    return Object(folder.name, scene, views, truth, mask)


def directions(given: Object, views: list[ds.View]) -> np.ndarray:
    """Return the light of each view as a vector for each channel, (views, 3, 3): direction times intensity."""
    found = []
    for view in views:
        k = lights_on(given.scene, view)[0]
        light = given.scene.lights[k]
        if not isinstance(light, ds.DirectionalLight):
            raise SystemExit(f"{given.name}: lights[{k}] must be a DirectionalLight; got a {type(light).__name__}.")
        toward = -np.asarray(light.direction, np.float64)
        toward = toward / np.linalg.norm(toward)
        found.append(np.broadcast_to(np.asarray(light.intensity), (3,))[:, None] * toward)
    return np.array(found)


def images(given: Object, views: list[ds.View]) -> np.ndarray:
    """Return what the views show of the object, (views, texels, 3)."""
    return np.stack([np.asarray(view.image, np.float64)[given.mask][..., :3] for view in views])


def least_squares(given: Object, views: list[ds.View], others: list[ds.View]) -> tuple[np.ndarray, np.ndarray]:
    """Return normals by least squares on the grey photographs, and predictions of other photographs."""
    light, y = directions(given, views), images(given, views)
    per_channel = [np.linalg.lstsq(light[:, c], y[..., c], rcond=None)[0] for c in range(3)]
    grey = np.linalg.lstsq(light.mean(1), y.mean(-1), rcond=None)[0].T
    normals = grey / np.linalg.norm(grey, axis=1, keepdims=True)
    light = directions(given, others)
    shown = [np.maximum(light[:, c] @ per_channel[c], 0.0) for c in range(3)]
    return normals, np.stack(shown, -1)


def angles(normals: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Return the angles between normals, degrees."""
    length = np.linalg.norm(truth, axis=-1)
    return np.rad2deg(np.arccos(np.clip(np.sum(normals * truth, -1) / length, -1.0, 1.0)))


def relative(shown: np.ndarray, images: np.ndarray) -> np.ndarray:
    """Return the relative root mean square error of each photograph."""
    return np.sqrt(np.mean((shown - images) ** 2, (1, 2)) / np.mean(images**2, (1, 2)))


def seam(maps: ds.TexelMaps, given: Object) -> float:
    """Return the median error of the difference of neighbours of two statuses, relative to that of other neighbours."""
    length = np.linalg.norm(given.truth, axis=-1, keepdims=True)
    wrong = maps.values["normal"] - given.truth / np.where(length > 0, length, 1.0)  # 0 outside the mask
    changes, off = [], []
    for here, there in ((np.s_[:-1], np.s_[1:]), (np.s_[:, :-1], np.s_[:, 1:])):
        both = given.mask[here] & given.mask[there]
        changes.append((maps.status[here] != maps.status[there])[both])
        off.append(np.linalg.norm(wrong[here] - wrong[there], axis=-1)[both])
    change, error = np.concatenate(changes), np.concatenate(off)
    return float(np.median(error[change]) / np.median(error[~change])) if change.any() else 0.0


def line(given: Object, light_error: float | None) -> list[str]:
    """Fit an object and return its line of the table."""
    mask, truth = given.mask, given.truth[given.mask]

    def fit(views: list[ds.View]) -> ds.TexelMaps:
        return ds.fit_texels(given.scene, views, free=FREE, light_error=light_error)

    fit(given.views)
    begin = time.perf_counter()
    maps = fit(given.views)
    seconds = time.perf_counter() - begin
    seen, others = given.views[::2], given.views[1::2]
    half, y = fit(seen), images(given, others)
    shown = np.stack([half.shade(lit=view.lit)[mask] for view in others])
    ours, plain = relative(shown, y), relative(least_squares(given, seen, others)[1], y)
    off = angles(maps.values["normal"][mask], truth)
    stated = maps.errors["normal"][mask][:, 0]
    known = np.isfinite(stated)
    within = [np.mean(off <= limit) for limit in (stated, maps.errors_95["normal"][mask][:, 0])]
    rank = spearmanr(np.where(known, stated, 180.0), off)[0]
    by_name = next((numbers for name, numbers in PUBLISHED.items() if name in given.name), None)
    sure = off[maps.known[mask]].mean() if maps.known[mask].any() else np.nan
    return [
        given.name,
        f"{len(given.views)}",
        f"{angles(least_squares(given, given.views, others)[0], truth).mean():.2f}",
        f"{off.mean():.2f} / {np.median(off):.2f}",
        f"{sure:.2f} of {np.mean(maps.known[mask]):.0%}",
        " ".join(f"{x:g}" for x in by_name) if by_name else "",
        f"{within[0]:.0%} {within[1]:.0%}",
        f"{rank:.2f}",
        f"{seam(maps, given):.2f}",
        " ".join(f"{x:.3f}" for x in (np.median(plain), plain.mean(), plain.max())),
        " ".join(f"{x:.3f}" for x in (np.median(ours), ours.mean(), ours.max())),
        f"{seconds:.1f}",
        f"{mask.sum() / seconds:,.0f}",
    ]


def spread_over(views: int, count: int) -> np.ndarray:
    """Return the indices of so many views, spread over all."""
    return np.round(np.linspace(0, views - 1, count)).astype(int)


def repeated(given: Object, count: int) -> Object:
    """Return an object with so many photographs: its own, and as far as there are too few these again, brighter."""
    views = [
        dataclasses.replace(view, image=np.asarray(view.image) * (1.0 + 0.001 * (k // len(given.views))))
        for k, view in enumerate(itertools.islice(itertools.cycle(given.views), count))
    ]
    return given._replace(views=views)


def shown(given: Object, maps: ds.TexelMaps, count: int) -> Object:
    """Return an object whose photographs are what maps show under different lights."""
    lights = [ds.DirectionalLight(tuple(-toward)) for toward in dome(count, LOWEST)]
    camera = given.views[0].camera
    views = [ds.View(maps.shade(light).astype(np.float32), camera, given.mask, lit=k) for k, light in enumerate(lights)]
    return given._replace(scene=dataclasses.replace(given.scene, lights=tuple(lights)), views=views)


def rate(given: Object) -> tuple[str, ds.TexelMaps]:
    """Return texels a second, whether anything was learned of the lights between, and the maps."""
    ds.fit_texels(given.scene, given.views, free=FREE)
    begin = time.perf_counter()
    maps = ds.fit_texels(given.scene, given.views, free=FREE)
    seconds = time.perf_counter() - begin
    beyond = maps.unexplained
    learned = beyond is not None and len(beyond.interpolation.toward) > len(given.views)
    return f"{given.mask.sum() / seconds:,.0f}{', learned' if learned else ''}", maps


def speed_line(given: Object) -> list[str]:
    """Return an object's line of the table of speeds."""
    count = len(given.views)
    found, maps = rate(given)
    fewer = rate(given._replace(views=[given.views[i] for i in spread_over(count, FEW)]))[0] if count >= FEW else ""
    others = (repeated(given, MANY), shown(given, maps, MANY))
    return [given.name, f"{count}", found, fewer, *(rate(other)[0] for other in others)]


@click.command()
@click.argument("folders", nargs=-1, required=True, type=click.Path(exists=True, path_type=Path))
@click.option("--twelve", is_flag=True, help="Use twelve spread photographs only")
@click.option("--light-error", type=float, help="Standard deviation of the lights' directions, degrees")
@click.option("--speed", is_flag=True, help=f"Texels a second alone, with {FEW} and {MANY} photographs")
def main(folders: tuple[Path, ...], twelve: bool, light_error: float | None, speed: bool) -> None:
    """Compare normals of the objects in FOLDERS with the truth."""
    if speed and (twelve or light_error is not None):
        raise click.UsageError("--speed takes no --twelve or --light-error: it has its own numbers of photographs.")
    table = Table(box=None)
    heads = (
        "object", "views", "LS", "ours mean / median", "known", "published LS, classical, HS17, learned", "68 95",
        "rank", "seam", "left out, LS", "left out, ours", "s", "texels/s",
    )  # fmt: skip
    if speed:
        heads = ("object", "views", "texels/s", f"{FEW} of them", f"{MANY}, repeated", f"{MANY} different lights")
    for head in heads:
        table.add_column(head)
    for folder in folders:
        given = read(folder)
        if twelve:
            given = given._replace(views=[given.views[i] for i in spread_over(len(given.views), 12)])
        table.add_row(*(speed_line(given) if speed else line(given, light_error)))
        Console(width=220).print(table)


if __name__ == "__main__":
    main()
