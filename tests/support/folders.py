"""A folder of photographs in the layout of DiLiGenT: a ball under eight distant lights, with its normals."""

from pathlib import Path

import numpy as np

import diffshade as ds


def ball_under_distant_lights(folder: Path, size: int = 24, count: int = 8, suffix: str = ".exr") -> Path:
    """Render the ball, and write the folder."""
    folder.mkdir()
    y, x = np.mgrid[1 : -1 : size * 1j, -1 : 1 : size * 1j] * 1.05
    z2 = 1.0 - x**2 - y**2
    normals = np.stack([x, y, np.sqrt(np.maximum(z2, 0.0))], -1)
    around = np.deg2rad(360.0 / count * np.arange(count))
    towards = np.stack([0.6 * np.cos(around), 0.6 * np.sin(around), np.full(count, 0.8)], -1)
    lights = [ds.DirectionalLight(-l) for l in towards]
    gbuffer = ds.GBuffer(np.where((z2 > 0)[..., None], normals, (0.0, 0.0, 1.0)), mask=z2 > 0.0)
    scene = ds.Scene(ds.Object(gbuffer, ds.Material(k_a=0.0, k_d=(0.4, 0.3, 0.2), k_s=0.3, n_s=20)), lights)
    camera, noise = ds.OrthographicCamera((0, 0, 1), shape=(size, size), local_viewer=False), np.random.default_rng(0)
    for i in range(count):
        image = np.asarray(ds.render(scene, camera, lit=i))
        ds.write_image(folder / f"{i}{suffix}", image + 0.002 * noise.standard_normal(image.shape))
    ds.write_image(folder / "mask.png", (z2 > 0)[..., None] * 1.0, srgb=False)
    np.save(folder / "normal_gt.npy", normals)
    (folder / "filenames.txt").write_text("\n".join(f"{i}{suffix}" for i in range(count)))
    np.savetxt(folder / "light_directions.txt", towards)
    np.savetxt(folder / "light_intensities.txt", np.ones((count, 3)))
    return folder
