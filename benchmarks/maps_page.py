"""The page of maps: the size of its file, and pictures a second in headless Chromium without a graphics card.

python benchmarks/maps_page.py [--side 2048] [--screen 1920x1080] [--seconds 5]

The maps are made up, with noise as photographs of things leave it; every number differs from its neighbours', so that
PNG finds little to compress. While the light moves, a machine that draws fewer than ten whole pictures a second draws
fewer pixels; how many they were is printed. Needs Chromium and its driver, as the tests do.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import diffshade as ds
from diffshade.texels.maps import SharedHighlight
from diffshade.texels.unexplained import Interpolation, Unexplained

sys.path.insert(0, str(Path(__file__).parent.parent / "tests" / "support"))
from browser import chromium

VIEWS, PARTS = 24, 9

DRAGGED = """
const done = arguments[arguments.length - 1], [seconds] = arguments, canvas = document.querySelector("#object canvas");
const box = canvas.getBoundingClientRect(), begun = performance.now(), gaps = [];
const at = (kind, x, y) => canvas.dispatchEvent(new PointerEvent(kind, {
  pointerId: 1, clientX: box.left + x, clientY: box.top + y, bubbles: true }));
canvas.setPointerCapture = () => {};
at("pointerdown", box.width / 2, box.height / 2);
let last = begun;
const step = (now) => {
  gaps.push(now - last);
  last = now;
  if (now - begun > 1000 * seconds) { at("pointerup", 0, 0); return done(gaps); }
  const angle = (now - begun) / 500;
  at("pointermove", box.width * (0.5 + 0.2 * Math.cos(angle)), box.height * (0.5 + 0.2 * Math.sin(angle)));
  requestAnimationFrame(step);
};
requestAnimationFrame(step);
"""


def noisy_maps(side: int) -> tuple[ds.TexelMaps, list[ds.View]]:
    """Return maps of a wavy object of this many texels a side, and photographs of it."""
    random = np.random.default_rng(0)
    y, x = np.mgrid[0.0:side, 0.0:side] / side
    waves = 0.15 * np.stack([np.cos(25 * x + 9 * y), np.sin(31 * y)], -1)
    normal = np.concatenate([waves + random.normal(0, 0.02, waves.shape), np.ones((side, side, 1))], -1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    inside = (x - 0.5) ** 2 + (y - 0.5) ** 2 < 0.245
    colour = 0.4 + 0.2 * np.sin(7 * x + np.arange(3)[:, None, None] + 5 * y).transpose(1, 2, 0).reshape(side, side, 3)
    k_d = np.maximum(colour * (1.0 + random.normal(0, 0.05, (side, side, 3))), 0.0)
    k_s = np.maximum(0.2 * colour * (1.0 + random.normal(0, 0.2, (side, side, 3))), 0.0)
    toward = random.normal((0.0, 0.0, 1.5), 1.0, (VIEWS, 3))
    toward[:, 2] = np.abs(toward[:, 2])
    toward /= np.linalg.norm(toward, axis=-1, keepdims=True)
    given = Interpolation(toward, 0.4, random.normal(size=(PARTS, VIEWS)), random.normal(0, 0.1, (VIEWS, PARTS)))
    parts = random.normal(0, 0.05, (side, side, 3 * PARTS)).astype(np.float16)
    camera = ds.OrthographicCamera((0.0, 0.0, 1.0), shape=(side, side), local_viewer=False)
    lights = [ds.DirectionalLight(-of) for of in toward]
    surface = ds.GBuffer(np.broadcast_to((0.0, 0.0, 1.0), (side, side, 3)), mask=inside)
    material = ds.Material(lobe=ds.Blinn())
    scene = ds.Scene(ds.Object(surface, material), lights)
    values = {"k_d": k_d, "k_s": k_s, "n_s": np.full((side, side, 1), 40.0), "normal": normal}
    values = {name: np.where(inside[..., None], of, 0.0).astype(np.float32) for name, of in values.items()}
    errors = {name: np.abs(random.normal(0.1, 0.02, (side, side, of.shape[2]))) for name, of in values.items()}
    errors["normal"] = errors["normal"][..., :1] * 30.0
    shape = tuple(SharedHighlight(w, n) for w, n in ((0.5, 8.0), (0.2, 32.0), (0.2, 128.0), (0.1, 1024.0)))
    maps = ds.TexelMaps(
        values, {name: of.astype(np.float32) for name, of in errors.items()},
        inside.astype(np.uint8), 0.01 * np.ones((side, side), np.float32), scene, camera,
        highlights=shape, unexplained=Unexplained(given, parts),
    )  # fmt: skip
    seen = np.where(inside[..., None], k_d * normal[..., 2:], 0.0).astype(np.float32)
    return maps, [ds.View(seen, camera, inside, lit=(i,)) for i in range(VIEWS)]


def heights_of(maps: ds.TexelMaps) -> ds.heights.HeightMap:
    """Return wavy heights; how they are integrated is measured by `heights.py`."""
    side = maps.status.shape[0]
    y, x = np.mgrid[0.0:side, 0.0:side] / side
    height = np.where(maps.status > 0, 0.05 * np.sin(25 * x) * np.cos(31 * y), 0.0)
    none = np.zeros(height.shape, bool)
    part = np.where(maps.status > 0, 0, -1)
    return ds.heights.HeightMap(
        height, 0.001 * np.ones_like(height), part, none, none, maps.values["normal"], maps.camera
    )


def rate(gaps: list[float]) -> str:
    """Return pictures a second, from the milliseconds between them."""
    return f"{1000.0 * len(gaps) / sum(gaps):.1f} pictures a second, the slowest after {max(gaps):.0f} ms"


def main() -> None:
    """Write a page and drag its light."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--side", type=int, default=2048)
    parser.add_argument("--screen", default="1920x1080")
    parser.add_argument("--seconds", type=float, default=5.0)
    given = parser.parse_args()
    width, height = map(int, given.screen.split("x"))
    maps, views = noisy_maps(given.side)
    with tempfile.TemporaryDirectory() as folder:
        page, begun = Path(folder) / "maps.html", time.perf_counter()
        ds.write_report(page, maps, views=views, heights=heights_of(maps))
        took = time.perf_counter() - begun
        print(f"{given.side} x {given.side} texels: {page.stat().st_size / 1e6:.1f} MB, written in {took:.0f} s")
        with chromium(Path(folder) / "profile") as browser:
            browser.set_page_load_timeout(300)
            browser.set_script_timeout(300)
            size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
            browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
            begun = time.perf_counter()
            browser.get(page.as_uri())
            script = "return document.querySelector('#object canvas').dataset.resting === 'true'"
            while not browser.execute_script(script):
                time.sleep(0.1)
            print(f"shown after {time.perf_counter() - begun:.1f} s")
            browser.execute_script(
                "const of = document.querySelector('.frame').style;"
                "Object.assign(of, {position: 'fixed', inset: '0', width: '100vw', height: '100vh'});"
            )
            time.sleep(1.0)
            seen = browser.execute_script(
                "const of = document.querySelector('canvas'); return [of.clientWidth, of.clientHeight]"
            )
            for shadows in ("photographed", "none", "cast"):
                browser.execute_script(f"document.querySelector('[name=shadows][value={shadows}]').click()")
                time.sleep(1.0)
                while not browser.execute_script(script):  # the picture at rest is no part of the pictures that follow
                    time.sleep(0.1)
                browser.execute_async_script(DRAGGED, 4.0)
                gaps = browser.execute_async_script(DRAGGED, given.seconds)
                drawn = browser.execute_script(
                    "const of = document.querySelector('canvas'); return [of.width, of.height]"
                )
                print(f"{seen[0]} x {seen[1]}, shadows {shadows}: {rate(gaps)}, of {drawn[0]} x {drawn[1]} pixels")
            print(f"console messages: {len(browser.get_log('browser'))}")


if __name__ == "__main__":
    main()
