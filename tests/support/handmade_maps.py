"""Maps made by hand: known exactly, and quickly."""

import numpy as np
import reliefs
from textured import lights_about

import diffshade as ds
from diffshade.texels.maps import SharedHighlight


def bumpy(size: int, *, shared: bool = False) -> tuple[ds.TexelMaps, ds.heights.HeightMap]:
    """Return the maps of a ball with bumps, of two colours and a highlight, and its heights."""
    camera = ds.OrthographicCamera((0, 0, 4), height=2.2, shape=(size, size + 6), local_viewer=False)
    pixel = 2.2 / size
    row, column = np.indices(camera.shape) + 0.5
    x, y = (column - camera.shape[1] / 2) * pixel, (camera.shape[0] / 2 - row) * pixel
    mask = x**2 + y**2 < 0.8
    z = np.sqrt(np.maximum(1.0 - x**2 - y**2, 0.0)) + 0.02 * np.sin(9 * x) * np.sin(7 * y)
    surface = ds.height_map(z, camera, mask=mask)
    left = (x < 0)[..., None]
    values = {
        "k_d": np.where(left, (0.7, 0.3, 0.2), (0.2, 0.4, 0.6)),
        "k_s": np.where(left, 0.3, 0.1) * np.ones(3),
        "n_s": np.where(left, 30.0, 60.0),
        "normal": np.asarray(surface.normal),
    }
    values = {name: np.where(mask[..., None], value, 0.0).astype(np.float32) for name, value in values.items()}
    errors = {name: 0.01 * value[..., :1] + 0.1 for name, value in values.items()}
    scene = ds.Scene(ds.Object(surface, ds.Material(lobe=ds.Blinn())), ds.DirectionalLight((0, 0, -1)))
    highlights = (SharedHighlight(0.6, 16.0), SharedHighlight(0.4, 128.0)) if shared else ()
    maps = ds.TexelMaps(
        values, errors, mask.astype(np.uint8), 0.0 * x.astype(np.float32), scene, camera, (), {}, highlights
    )
    return maps, ds.heights.integrate_normals(values["normal"], camera, mask=mask, errors=np.where(mask, 0.1, np.inf))


JUDGED = ("glossy relief", "vase of two materials", "coin")


def judged(name: str, size: int) -> tuple[ds.TexelMaps, ds.heights.HeightMap, list[ds.View]]:
    """Return maps, heights and photographs of one of the objects that no setting was chosen on."""
    x, y = reliefs.grid(size)
    grain = (0.8 + 0.2 * np.sin(31 * x) * np.cos(23 * y))[..., None]
    upper, radius = (y > 0.2)[..., None], np.hypot(x, y)[..., None]
    of, k_d, k_s, n_s = {
        "glossy relief": (
            reliefs.relief(size, reliefs.waves),
            grain * (0.1, 0.25, 0.15),
            0.6 * np.ones(3),
            60.0 + 40.0 * (grain > 0.8),
        ),
        "vase of two materials": (
            reliefs.vase(size),
            np.where(upper, (0.6, 0.45, 0.3) * grain, (0.15, 0.2, 0.5)),
            np.where(upper, 0.05, 0.4) * np.ones(3),
            np.where(upper, 8.0, 80.0),
        ),
        "coin": (
            reliefs.relief(size, reliefs.coin, mask=radius[..., 0] < 1.0),
            np.where(radius < 0.5, (0.12, 0.08, 0.04), (0.2, 0.15, 0.07)) * grain,
            np.ones(3) * (0.5, 0.4, 0.2),
            25.0 + 10.0 * radius,
        ),
    }[name]
    camera, mask = of.camera, of.mask
    values = {"k_d": k_d, "k_s": k_s, "n_s": n_s, "normal": of.normal}
    width = {key: 1 if key == "n_s" else 3 for key in values}
    values = {
        key: np.where(mask[..., None], np.broadcast_to(value, (size, size, width[key])), 0.0).astype(np.float32)
        for key, value in values.items()
    }
    errors = {key: 0.01 * value[..., :1] + 0.1 for key, value in values.items()}
    position = np.stack([x, y, of.z], -1)
    lights = [ds.DirectionalLight(-toward) for toward in lights_about(6)]
    item = ds.Object(ds.GBuffer(of.normal, position, mask), ds.Material(lobe=ds.Blinn()))
    nothing = np.zeros(mask.shape, np.float32)
    scene = ds.Scene(item, lights)
    camera = ds.OrthographicCamera((0, 0, 4), height=2.2, shape=mask.shape, local_viewer=False)
    maps = ds.TexelMaps(values, errors, mask.astype(np.uint8), nothing, scene, camera, (), {})
    heights = ds.heights.integrate_normals(values["normal"], camera, mask=mask, errors=np.where(mask, 0.1, np.inf))
    return maps, heights, [ds.View(maps.shade(lit=i), camera, mask, lit=(i,)) for i in range(6)]
