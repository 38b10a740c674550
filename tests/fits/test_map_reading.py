"""Maps come back whole from the folder that a fit, or `write`, has written; what is damaged is one sentence."""

import dataclasses
import shutil

import equinox as eqx
import jax
import numpy as np
import pytest
from textured import textured_ball

import diffshade as ds
from diffshade.texels.maps import SharedHighlight
from diffshade.texels.unexplained import Interpolation, Unexplained

LIGHTS = (ds.DirectionalLight((-1, -1, -2), (0.5, 0.4, 0.3)), ds.DirectionalLight((1, 0, -1), 0.5))


@pytest.fixture(scope="module")
def fitted(tmp_path_factory):
    """Maps of a fit, and the folder that it wrote."""
    ball, folder = textured_ball(16), tmp_path_factory.mktemp("maps") / "maps"
    return ds.fit_texels(ball.scene, ball.views, free="k_d", out=folder), folder


@pytest.fixture(scope="module")
def shared(fitted):
    """Maps of all kinds: a highlight that two regions share differently, unexplained light, and positions."""
    maps, _ = fitted
    rng, shape = np.random.default_rng(0), maps.status.shape
    weight = rng.uniform(0.2, 0.8, (*shape, 1))
    toward = rng.standard_normal((5, 3))
    toward /= np.linalg.norm(toward, axis=-1, keepdims=True)
    interpolation = Interpolation(toward, 0.4, rng.standard_normal((2, 5)), rng.standard_normal((5, 2)))
    parts = (0.05 * rng.standard_normal((*shape, 6))).astype(np.float16)
    inside = maps.status != 0
    normal = np.broadcast_to(np.array((0.0, 0.6, 0.8), np.float32), (*shape, 3))
    surface = ds.GBuffer(normal, rng.random((*shape, 3)), inside)
    values = {
        "k_d": maps.values["k_d"],
        "k_s": weight.astype(np.float32) * np.array((1.0, 0.5, 0.2), np.float32),
        "normal": normal,
    }
    values["n_s"] = np.full((*shape, 1), 20.0, np.float32)
    return dataclasses.replace(
        maps,
        values=values,
        errors={name: 0.1 * value[..., :1] if name == "normal" else 0.1 * value for name, value in values.items()},
        scene=eqx.tree_at(lambda s: s.objects[0].surface, maps.scene, surface),
        notes=("a note", "another"),
        times_95={"k_d": 2.5, "k_s": 3.1, "n_s": 1 / 3, "normal": 1.7},
        highlights=(SharedHighlight(weight, 16.0), SharedHighlight(1.0 - weight, 128.0)),
        unexplained=Unexplained(interpolation, parts),
    )


def assert_same(found, maps):
    for name, value in maps.values.items():
        np.testing.assert_array_equal(found.values[name], value)
        np.testing.assert_array_equal(found.errors[name], maps.errors[name])
        np.testing.assert_array_equal(found.errors_95[name], maps.errors_95[name])
        assert found.values[name].dtype == value.dtype
    assert list(found.values) == list(maps.values)
    np.testing.assert_array_equal(found.status, maps.status)
    np.testing.assert_array_equal(found.residual, maps.residual)
    for one, other in ((found.scene, maps.scene), (found.camera, maps.camera)):
        assert jax.tree.structure(one) == jax.tree.structure(other)
        for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
            np.testing.assert_array_equal(a, b)
    assert found.notes == maps.notes
    assert len(found.highlights) == len(maps.highlights)
    assert str(found) == str(maps)
    # NumPy's products of matrices differ in the last digit with where their numbers lie in memory
    np.testing.assert_allclose(found.shade(LIGHTS), maps.shade(LIGHTS), rtol=1e-13)


def test_the_folder_of_a_fit_is_read(fitted):
    maps, folder = fitted
    found = ds.read_maps(folder)
    assert_same(found, maps)
    assert isinstance(found.values["k_d"], np.memmap)
    assert ds.read_scene(folder / "scene.toml").lights


@pytest.mark.parametrize("suffix", [".npy", ".exr"])
def test_what_is_shared_and_unexplained_comes_back_too(shared, tmp_path, suffix):
    shared.write(tmp_path / "maps", suffix=suffix)
    found = ds.read_maps(tmp_path / "maps")
    assert_same(found, shared)
    assert found.unexplained is not None
    assert shared.unexplained is not None
    for one, other in zip(found.unexplained.interpolation, shared.unexplained.interpolation, strict=True):
        np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(found.unexplained.parts, shared.unexplained.parts)
    found.write(tmp_path / "again", suffix=suffix)
    assert_same(ds.read_maps(tmp_path / "again"), shared)
    plain = dataclasses.replace(found, highlights=(SharedHighlight(1.0, 16.0),), unexplained=None)
    plain.write(tmp_path / "maps", suffix=suffix)  # over the old ones, whose files are no part of it
    assert_same(ds.read_maps(tmp_path / "maps"), plain)


def test_pngs_alone_are_no_maps_but_may_stand_beside_them(fitted, tmp_path):
    maps, folder = fitted
    maps.write(tmp_path / "pictures", suffix=".png")
    with pytest.raises(ValueError, match=r"pictures holds maps as PNGs alone.* Write them as \.npy or \.exr\.$"):
        ds.read_maps(tmp_path / "pictures")
    shutil.copytree(folder, tmp_path / "both")
    maps.write(tmp_path / "both", suffix=".png")
    assert_same(ds.read_maps(tmp_path / "both"), maps)


def test_what_is_damaged_is_one_sentence(shared, tmp_path):
    whole = tmp_path / "whole"
    shared.write(whole, suffix=".npy")
    cases = {
        "maps.toml": (b"[[", "maps.toml is damaged"),
        "k_d.npy": (b"\x93NUMPY", "k_d.npy is damaged"),
        "k_s_error.npy": (None, "k_s_error.npy"),
        "scene.toml": (b"lights = 3", "scene.toml"),
        "status.png": (b"\x89PNG", "status.png"),
        "unexplained.npy": ((whole / "k_d.npy").read_bytes(), "do not belong together"),
        "unexplained_lights.npy": ((whole / "k_d.npy").read_bytes(), "do not belong together"),
        "highlight_weights.npy": ((whole / "k_d.npy").read_bytes(), "highlight_weights.npy has the shape"),
        "residual.npy": ((whole / "residual.npy").read_bytes()[:-9], "residual.npy is damaged"),
    }
    for name, (data, words) in cases.items():
        folder = tmp_path / "damaged"
        shutil.copytree(whole, folder)
        (folder / name).unlink() if data is None else (folder / name).write_bytes(data)
        with pytest.raises((ValueError, OSError)) as caught:
            ds.read_maps(folder)
        assert words in str(caught.value)
        assert "\n" not in str(caught.value)
        shutil.rmtree(folder)
    about = (whole / "maps.toml").read_text()
    for old, new, words in (
        ("format = 2", "format = 1", "has the format 1, and this version of diffshade reads 2. Fit the photographs"),
        ("width = ", "w = ", "maps.toml is damaged: KeyError('width')"),
        ('"k_d",', '"k_a",', "k_a.npy"),
    ):
        (whole / "maps.toml").write_text(about.replace(old, new))
        with pytest.raises((ValueError, OSError)) as caught:
            ds.read_maps(whole)
        assert words in str(caught.value)
    (whole / "maps.toml").unlink()
    with pytest.raises(ValueError, match=r"holds no maps\.toml, so no maps"):
        ds.read_maps(whole)
    (whole / "run.json").write_text("{}")
    with pytest.raises(
        ValueError, match=r"holds the maps of an unfinished fit of texels\. Finish it with the command or call that"
    ):
        ds.read_maps(whole)
    with pytest.raises(FileNotFoundError, match="there is no folder"):
        ds.read_maps(tmp_path / "nowhere")
