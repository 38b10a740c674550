"""Meshes in their own materials: base colours of pictures and vertices, alpha modes, wrap modes; what lacks is said."""

import logging

import handmade_maps
import jax
import mesh_files
import numpy as np
import pytest
import textured_meshes as made
from memory import forget_the_peak, peak
from PIL import Image

import diffshade as ds
from diffshade.exchange.base_colours import ColourPicture
from diffshade.exchange.mesh_objects import objects_seen
from diffshade.io.encodings import srgb_decode

pytest.importorskip("trimesh")
pytest.importorskip("embreex")
pytest.importorskip("mapbox_earcut")

HEAD_ON = ds.DirectionalLight((0, 0, -1))


def test_a_model_has_its_own_colours_at_the_centres_of_its_texels(tmp_path):
    objects = ds.exchange.read_mesh_objects(made.write(tmp_path / "a.glb"), made.CAMERA)
    drawn = [item for item in objects if item.name != "metal"]  # with a highlight, which takes long to compile
    image = ds.render(ds.Scene(drawn, HEAD_ON), made.CAMERA)
    for part, right in made.right_colours().items():
        np.testing.assert_allclose(made.square(image, part), right, atol=2e-5, err_msg=part)
    metal = next(item.material for item in objects if item.name == "metal")
    one = ds.exchange.read_materials(tmp_path / "a.glb")["metal"]
    np.testing.assert_allclose(
        made.square(metal.k_s, "metal"), one.k_s * made.pictures()["many"].linear[..., :3], atol=1e-5
    )
    assert not np.asarray(image)[made.SIZE + 1 :].any()


OBJ = mesh_files.QUAD + "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nmtllib my lib.mtl\nusemtl {0}\nf 1/1 2/2 3/3 4/4\n"


def of_obj(folder, rows, camera):
    (folder / "my lib.mtl").write_text(f"newmtl a\nKd 0.5 1 1\nillum 1\n{rows}\n")
    (folder / "a.obj").write_text(OBJ.format("a"))
    (item,) = ds.exchange.read_mesh_objects(folder / "a.obj", camera)
    return item.material


def test_pictures_of_mtl_beside_an_obj(tmp_path, caplog):
    camera = ds.OrthographicCamera((0, 0, 4), height=2.0, shape=(2, 2), local_viewer=False)
    Image.fromarray(np.array([[[255, 0, 0], [0, 255, 0]], [[0, 0, 255], [255] * 3]], np.uint8)).save(
        tmp_path / "p q.png"
    )
    np.save(tmp_path / "odd.npy", [[[0.5, np.nan, 0.1]]])
    right = np.array([[[0.5, 0, 0], [0, 1, 0]], [[0, 0, 1], [0.5, 1, 1]]])
    for rows in ("map_Kd p q.png", "map_kd -blendu on -s 1 1 1 p q.png", "map_Kd C:\\of\\others\\p q.png"):
        np.testing.assert_allclose(of_obj(tmp_path, rows, camera).k_d, right, atol=1e-6)
    moved = of_obj(tmp_path, "map_Kd -o 0.5 0 p q.png", camera).k_d
    np.testing.assert_allclose(moved, right[:, ::-1], atol=1e-6)
    both = of_obj(tmp_path, "Ka 1 1 1\nmap_Ka p q.png\nmap_Kd p q.png", camera)
    np.testing.assert_allclose(both.k_a, right / [0.5, 1, 1], atol=1e-6)
    assert not caplog.messages
    for rows, said in (
        (
            "map_Kd none.png",
            "'a': there is no picture 'none.png' in its folder. Put it beside the file. Its colour alone",
        ),
        ("map_Kd ../x.png", "there is no picture '../x.png' in its folder."),
        (f"map_Kd {'x' * 5000}", f"there is no picture '{'x' * 80}' in its folder."),
        ("map_Kd data:image/png;base64,@", "what follows base64 in a name of data: is no base64. Export the file"),
        ("map_Kd odd.npy", "cannot read odd.npy: a pixel is below 0 or not finite. Give it a colour. Its colour"),
        ("map_Kd a.obj", "a.obj has the suffix '.obj', which is not a known image"),
        ("map_Kd p q.png\nbump p q.png", "texture maps are not read, only those of the base colour: 'bump'."),
    ):
        caplog.clear()
        with caplog.at_level(logging.WARNING, logger="diffshade"):
            of_obj(tmp_path, rows, camera)
        assert said in caplog.text


def test_faces_without_a_material_are_grey(tmp_path, caplog):
    camera = ds.OrthographicCamera((0, 0, 4), height=2.0, shape=(2, 2), local_viewer=False)
    (tmp_path / "a.obj").write_text(OBJ.format("a"))
    with caplog.at_level(logging.WARNING, logger="diffshade"):
        (item,) = ds.exchange.read_mesh_objects(tmp_path / "a.obj", camera)
    assert "names the materials of my lib.mtl, which is not beside it; they are grey." in caplog.text
    assert item.material.k_d.tolist() == [0.7] * 3
    points = [(mesh_files.POINTS.astype("<f4"), "VEC3"), (np.array([0, 1, 2, 3], "<u1"), "SCALAR")]
    colours = (np.tile([[1, 0, 0.2]], (4, 1)).astype("<f4"), "VEC3")
    row = {"attributes": {"POSITION": 0, "COLOR_0": 2}, "indices": 1, "mode": 6}
    (tmp_path / "a.glb").write_bytes(mesh_files.gltf([row], [*points, colours]))
    (item,) = ds.exchange.read_mesh_objects(tmp_path / "a.glb", camera)
    np.testing.assert_allclose(item.material.k_a, np.full((2, 2, 3), (0.7, 0, 0.14)), atol=1e-7)


def test_a_render_is_differentiable_in_a_factor_of_k_d(tmp_path):
    camera = ds.OrthographicCamera((0, 0, 4), height=2.0, shape=(2, 2), local_viewer=False)
    picture = np.array([[[255, 0, 0], [0, 255, 0]], [[0, 0, 255], [255] * 3]], np.uint8)
    Image.fromarray(picture).save(tmp_path / "p.png")
    (tmp_path / "my lib.mtl").write_text("newmtl a\nKd 1 1 1\nmap_Kd p.png\n")
    (tmp_path / "a.obj").write_text(OBJ.format("a"))
    (item,) = ds.exchange.read_mesh_objects(tmp_path / "a.obj", camera)

    def total(factor):
        material = ds.Material(k_d=item.material.k_d * factor[None, None])
        return ds.render(ds.Scene(ds.Object(item.surface, material), HEAD_ON), camera).sum((0, 1))

    np.testing.assert_allclose(jax.jacobian(total)(jax.numpy.ones(3)), 2 * np.eye(3), rtol=1e-5)


def test_a_picture_without_places_on_its_faces_is_said(tmp_path, caplog):
    Image.fromarray(np.full((2, 2, 3), 99, np.uint8)).save(tmp_path / "p.png")
    (tmp_path / "a.mtl").write_text("newmtl a\nKd 1 1 1\nmap_Kd p.png\nnewmtl b\nKd 1 0 0\n")
    camera = ds.OrthographicCamera((0, 0, 4), height=2.0, shape=(2, 2), local_viewer=False)
    bare = mesh_files.QUAD + "mtllib a.mtl\nvt 0 0\nusemtl {}\n"
    for name, faces, said in (
        ("a", "f 1 2 3 4\n", "a.obj: 'a': its triangles have no texture coordinates; its picture is not shown there."),
        ("a", "f 1/1 2/1 3/1\nf 1 3 4\n", "'a': 1 of its 2 triangles have no texture coordinates"),
        ("a", "f 1/1 2/1 3/1 4/1\n", ""),
        ("b", "f 1 2 3 4\n", ""),
    ):
        caplog.clear()
        (tmp_path / "a.obj").write_text(bare.format(name) + faces)
        ds.exchange.read_mesh_objects(tmp_path / "a.obj", camera)
        assert (said in caplog.text) if said else not caplog.messages


def test_a_name_that_a_format_changed_is_the_same_name(tmp_path, caplog):
    camera = ds.OrthographicCamera((0, 0, 4), height=2.0, shape=(2, 4), local_viewer=False)
    for of_mesh, of_file in (("half red", "half_red"), ("half_red", "half red"), ("Wand.001", "Wand_001")):
        (tmp_path / "m.mtl").write_text(f"newmtl {of_file}\nKd 1 0 0\nillum 1\nnewmtl blue\nKd 0 0 1\nillum 1\n")
        (tmp_path / "a.obj").write_text(mesh_files.TWO.format("1 2 3 4", "5 6 7 8").replace("red", of_mesh))
        red, blue = objects_seen(tmp_path / "a.obj", str(tmp_path / "m.mtl"))(camera)
        assert (red.material.k_d.tolist(), blue.material.k_d.tolist()) == ([1, 0, 0], [0, 0, 1])
    (tmp_path / "m.mtl").write_text("newmtl half_rot\nKd 1 0 0\nnewmtl blue\nKd 0 0 1\n")
    (tmp_path / "a.obj").write_text(mesh_files.TWO.format("1 2 3 4", "5 6 7 8").replace("red", "half red"))
    with pytest.raises(ValueError, match=r"'half red', which .*m.mtl lacks. Add it. Did you mean 'half_rot'\?"):
        objects_seen(tmp_path / "a.obj", str(tmp_path / "m.mtl"))
    (tmp_path / "a.obj").write_text("mtllib m.mtl\n" + (tmp_path / "a.obj").read_text())
    objects_seen(tmp_path / "a.obj")
    said = f"{tmp_path}/a.obj: faces name the material 'half red', which its files lack; they are grey."
    assert caplog.messages == [said]


def test_a_large_picture_takes_a_few_times_its_bytes(tmp_path):
    n = 3000
    Image.fromarray(np.tile(np.arange(n, dtype=np.uint8)[:, None, None], (1, n, 4))).save(tmp_path / "p.png")
    picture = ColourPicture(tmp_path / "a.mtl", "p.png")
    start = forget_the_peak()
    texels = picture.texels()
    assert peak() - start < 6 * 4 * n * n  # 0.9 GB for 6000 x 6000
    right = srgb_decode(np.array([3, 4]) / 255)
    at = np.array([[0.5, 3.5 / n], [0.5, 4.0 / n]])
    np.testing.assert_allclose(picture.at(texels, at)[:, 0], [right[0], right.mean()], atol=1e-12)


@pytest.mark.thorough
@pytest.mark.parametrize("name", handmade_maps.JUDGED)
def test_meshes_of_maps_have_their_k_d_again(name, tmp_path):
    """As they were written, in bytes of sRGB, at the middles of the texels; of a step, the mesh is beside it."""
    maps, heights, _ = handmade_maps.judged(name, 48)
    inside = maps.status > 0
    ds.exchange.write_mesh(tmp_path / "a.obj", ds.heights.height_mesh(heights), maps=maps)
    (item,) = ds.exchange.read_mesh_objects(tmp_path / "a.obj", maps.camera)
    off = np.abs(ds.srgb_encode(item.material.k_d) - ds.srgb_encode(maps.values["k_d"]))[inside]
    assert np.quantile(off, 0.98) < 1.01 / 255
