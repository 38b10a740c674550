"""Textured models in three.js: its pictures have the colours of ours, by its own filter."""

import json

import numpy as np
import pytest
import textured_meshes as made
from exchange_programs import HERE, in_browser

import diffshade as ds

pytest.importorskip("embreex")


def test_three_js_shows_the_colours_of_a_model(tmp_path):
    """Packed as .glb and .gltf, and with pictures beside it: all but the highlight of the metal, which is refitted."""
    files = {"a.glb": True, "b.gltf": True, "c.gltf": False}
    height, width = made.CAMERA.shape
    (tmp_path / "cases.json").write_text(
        json.dumps({"files": list(files), "width": width, "height": height, "extent": 2.0})
    )
    for name, packed in files.items():
        made.write(tmp_path / name, packed=packed)
    answer = json.loads(in_browser(tmp_path, HERE / "model_three.js"))
    assert answer["said"] == []
    right = made.right_colours()
    for name in files:
        shown = np.array(answer["found"][name]).reshape(height, width, 4)[::-1, :, :3]
        objects = ds.exchange.read_mesh_objects(tmp_path / name, made.CAMERA)
        drawn = ds.render(ds.Scene(objects, ds.DirectionalLight((0, 0, -1))), made.CAMERA)
        for part in made.NAMES:
            ours, theirs = made.square(drawn, part), made.square(shown, part)
            if part in right:
                np.testing.assert_allclose(ours, right[part], atol=2e-5)
            if part == "metal":  # seen head-on; the largest difference that is stated is .25
                assert np.abs(ours - theirs).max() < 0.25
                assert (
                    np.corrcoef(ours.ravel(), theirs.ravel())[0, 1] > 0.99
                )  # light that GGX scatters twice is tinted twice
            else:
                np.testing.assert_allclose(ours, theirs, atol=1e-3, err_msg=part)
