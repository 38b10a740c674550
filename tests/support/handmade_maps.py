"""Maps made by hand: known exactly, and quickly."""

import numpy as np

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
