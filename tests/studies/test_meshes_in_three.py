"""Mesh files with maps in three.js: its pictures are those of `TexelMaps.shade`, to the error that is stated."""

import dataclasses
import json

import numpy as np
import pytest
from exchange_programs import HERE, in_browser
from handmade_maps import JUDGED, bumpy, judged

import diffshade as ds
from diffshade.exchange.map_textures import LIGHTS

# Pixels of a picture for each texel, of which the middle one is compared: three.js widens a highlight by how far the
# mesh's normal turns within a pixel, which at the edges of a coin is 80 degrees within a texel.
ZOOM = 33


def test_three_js_shows_the_maps(tmp_path):
    """Full meshes and decimated ones, with emission, in each format, under the three lights of the stated error."""
    maps, heights = bumpy(64)
    item = maps.scene.objects[0]
    glowing = dataclasses.replace(item, material=dataclasses.replace(item.material, k_e=(0.05, 0.02, 0.0)))
    maps = dataclasses.replace(maps, scene=dataclasses.replace(maps.scene, objects=(glowing,)))
    meshes = {"": ds.heights.height_mesh(heights), "small_": ds.heights.height_mesh(heights, tolerance=0.004)}
    assert len(meshes["small_"].face) < 0.5 * len(meshes[""].face)
    assert_shown(
        tmp_path, maps, {start: (mesh, ("a.glb", "b.gltf", "c.obj", "d.json")) for start, mesh in meshes.items()}
    )


@pytest.mark.parametrize("name", [JUDGED[0], *(pytest.param(of, marks=pytest.mark.slow) for of in JUDGED[1:])])
def test_three_js_shows_objects_that_no_setting_was_chosen_on(name, tmp_path):
    """Not as .obj: three.js has another highlight, and does not read that of each texel."""
    maps, heights, _ = judged(name, 48)
    assert_shown(tmp_path, maps, {"": (ds.heights.height_mesh(heights), ("a.glb", "d.json"))})


def assert_shown(folder, maps, meshes):
    """Assert that three.js's pictures of meshes of maps are as near to the maps as is stated."""
    stated = {}
    for start, (mesh, names) in meshes.items():
        for name in names:
            stated[f"{start}{name}"] = ds.exchange.write_mesh(folder / f"{start}{name}", mesh, maps=maps).difference
    rows, columns = maps.status.shape
    cases = {
        "files": list(stated),
        "lights": LIGHTS,
        "zoom": ZOOM,
        "rows": rows,
        "columns": columns,
        "extent": 2.2,
    }
    (folder / "cases.json").write_text(json.dumps(cases))
    answer = json.loads(in_browser(folder, HERE / "mesh_three.js"))
    assert answer["said"] == []
    for file, pictures in answer["found"].items():
        off, size = [], []
        for light, picture in zip(LIGHTS, pictures, strict=True):
            seen = np.array(picture).reshape(rows, columns, 4)[::-1]
            inside = (seen[..., 3] > 0) & (maps.status > 0)
            assert inside.sum() > 0.9 * (maps.status > 0).sum()
            drawn = maps.shade(ds.DirectionalLight(tuple(-x for x in light)))
            off.append((seen[..., :3] - drawn)[inside])
            size.append(drawn[inside])
        rms, whole = (np.sqrt(np.mean(np.concatenate(of) ** 2)) for of in (off, size))
        print(f"{file}: {rms:.4f} rms where {stated[file].rms:.4f} is stated, of {whole:.3f}")
        if file.endswith(".obj"):  # three.js: another highlight, without Ns; Ks and Ke as sRGB
            assert rms < 0.13 * whole
        else:
            assert rms < 1.1 * stated[file].rms + 0.005 * whole
