"""Triangle meshes as G-buffers: a mesh of a sphere is nearly the sphere."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest

import diffshade as ds

trimesh = pytest.importorskip("trimesh")
pytest.importorskip("embreex")

CAMERA = ds.Camera((1, 2, 3), fov=35, shape=(60, 70))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Meshes of a unit sphere whose middle is at (0.1, 0.2, -0.1)."""
    folder = tmp_path_factory.mktemp("meshes")
    ball = trimesh.creation.icosphere(subdivisions=5)
    ball.apply_translation((0.1, 0.2, -0.1))
    for kind in ("obj", "ply", "stl", "glb"):
        ball.export(folder / f"ball.{kind}")
    trimesh.creation.box((1, 2, 3)).export(folder / "box.ply")
    trimesh.PointCloud(np.eye(3)).export(folder / "points.ply")
    (folder / "notes.txt").write_text("no mesh")
    (folder / "broken.ply").write_text("no mesh")
    return folder


KINDS = ["ply", "stl", *(pytest.param(kind, marks=pytest.mark.thorough) for kind in ("obj", "glb"))]


@pytest.mark.thorough
@pytest.mark.parametrize("kind", KINDS)
def test_a_fine_mesh_of_a_sphere_is_nearly_the_sphere(folder, kind):
    """Edges of 0.035 at radius 1: facets lie up to 2e-4 below the sphere and 0.02 off its direction."""
    sphere = ds.intersect(ds.Scene(ds.Object(ds.Sphere((0.1, 0.2, -0.1)))), CAMERA)
    mesh = ds.exchange.read_mesh(folder / f"ball.{kind}", CAMERA)
    assert sphere.position is not None
    assert mesh.position is not None
    both = np.asarray(sphere.mask) & np.asarray(mesh.mask)
    assert both.sum() > 1000
    assert (np.asarray(sphere.mask) ^ np.asarray(mesh.mask)).sum() <= 0.005 * both.sum()
    radius = np.linalg.norm(np.asarray(mesh.position)[both] - (0.1, 0.2, -0.1), axis=-1)
    assert (np.abs(radius - 1) < 3e-4).all()
    normals = np.abs(np.asarray(mesh.normal) - np.asarray(sphere.normal))[both]
    facing = np.asarray(sphere.normal)[both] @ (np.array([1, 2, 3]) / np.sqrt(14)) > 0.5
    assert normals[facing].max() < (0.05 if kind in ("stl", "glb") else 2e-3)  # flat: an STL, and glTF without normals
    np.testing.assert_allclose(np.linalg.norm(np.asarray(mesh.normal)[both], axis=-1), 1, rtol=1e-12)


def test_flat_normals_are_those_of_the_triangles(folder):
    mesh = ds.exchange.read_mesh(folder / "box.ply", CAMERA, smooth=False)
    box = ds.intersect(ds.Scene(ds.Object(ds.Box(size=(1, 2, 3)))), CAMERA)
    np.testing.assert_array_equal(mesh.mask, box.mask)
    same = np.isclose(mesh.normal, box.normal, atol=1e-6).all(-1)
    assert same.mean() > 0.99  # at an edge float32 may find the other face
    smooth = ds.exchange.read_mesh(folder / "box.ply", CAMERA)
    assert not np.isclose(smooth.normal, box.normal, atol=0.1).all()


def test_a_mesh_that_is_none(folder, monkeypatch):
    for name, error, message in (
        ("ball.3ds", FileNotFoundError, r"there is no mesh file .*ball\.3ds\. Give the path of an OBJ, PLY"),
        ("points.ply", ValueError, r"points\.ply has no triangles\. Export the surface as triangles"),
        ("notes.txt", ValueError, r"notes\.txt is no mesh that trimesh can read: .* Export it as OBJ, PLY or GLB\."),
        ("broken.ply", ValueError, r"broken\.ply is no PLY file: it lacks the lines from ply to end_header\."),
    ):
        with pytest.raises(error, match=message) as caught:
            ds.exchange.read_mesh(folder / name, CAMERA)
        assert "\n" not in str(caught.value)
    (folder / "a.off").write_text("OFF")
    for corners, face in ((np.eye(3), [0, 1, 3]), (np.eye(3), [-1, 0, 1])):
        made = SimpleNamespace(vertices=corners, faces=[face])
        monkeypatch.setattr(trimesh, "load_mesh", lambda *_, made=made, **__: made)
        with pytest.raises(ValueError, match=r"a\.off has 3 vertices, and a face names number (4|0)\."):
            ds.exchange.read_mesh(folder / "a.off", CAMERA)


def test_without_trimesh(folder, monkeypatch):
    monkeypatch.setitem(sys.modules, "trimesh", None)
    with pytest.raises(
        ImportError, match=r"ball\.ply without the package trimesh\. Install it: .*'diffshade\[mesh\]'\.$"
    ):
        ds.exchange.read_mesh(folder / "ball.ply", CAMERA)
