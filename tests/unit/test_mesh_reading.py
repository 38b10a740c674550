"""Mesh files as their formats define them: normals, indices, polygons, materials; what is wrong in one is refused."""

import logging
import struct

import jax
import mesh_files as made
import numpy as np
import pytest

import diffshade as ds
from diffshade.io.polygons import Polygons, triangulated
from diffshade.io.vertex_normals import corner_normals

trimesh = pytest.importorskip("trimesh")
pytest.importorskip("embreex")
pytest.importorskip("mapbox_earcut")

CAMERA = ds.OrthographicCamera((0, 0, 4), height=4.0, shape=(80, 80))
ROW = [20, 40, 59]


def read(folder, name, content, camera=CAMERA, **how):
    (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    return ds.exchange.read_mesh(folder / name, camera, **how)


def area(buffer):
    return int(np.asarray(buffer.mask).sum()) / 400.0


def angles(a, b):
    return np.rad2deg(np.arccos(np.clip((np.asarray(a) * np.asarray(b)).sum(-1), -1.0, 1.0)))


TILTED = {
    "q.obj": made.QUAD + made.TILTED + "f 1//1 2//2 3//3\nf 1//1 3//3 4//4\n",
    "quad.obj": made.QUAD + made.TILTED + "f 1//1 2//2 3//3 4//4\n",
    "vt.obj": made.QUAD + made.TILTED + "vt 0 0\nvt 1 0\n" + "f 1/1/1 2/2/2 3/2/3\nf 1/2/1 3/1/3 4/1/4\n",
    "order.obj": made.QUAD + "vn 0 0 1\n" + made.TILTED + "f 1//2 2//3 3//4\nf 1//2 3//4 4//5\n",
    "relative.obj": made.QUAD + made.TILTED + "f -4//-4 -3//-3 -2//-2 -1//-1\n",
    "long.obj": made.QUAD + made.TILTED.replace("0.6", "6").replace("0.8", "8") + "f 1//1 2//2 3//3 4//4\n",
    "wound.obj": made.QUAD + made.TILTED + "f 4//4 3//3 2//2 1//1\n",
    "ascii.ply": made.ply("ascii", [(0, 1, 2), (0, 2, 3)]),
    "crlf.ply": made.ply("ascii", [(0, 1, 2, 3)], "vertex_index", "\r\n"),
    "mixed.ply": made.ply("binary_little_endian", [(0, 1, 2, 3), (0, 1, 2)]),
    "big.ply": made.ply("binary_big_endian", [(0, 1, 2), (0, 2, 3)]),
    "q.glb": made.gltf(
        [{"attributes": {"POSITION": 0, "NORMAL": 1}, "indices": 2}],
        [
            (made.POINTS.astype("<f4"), "VEC3"),
            (made.NORMALS.astype("<f4"), "VEC3"),
            (np.array([0, 1, 2, 0, 2, 3], "<u2"), "SCALAR"),
        ],
    ),
}


@pytest.mark.parametrize("name", TILTED)
def test_the_normals_of_the_file_are_kept(name, tmp_path):
    """At the middles of the left half, of the whole and of the right half of a square."""
    seen = read(tmp_path, name, TILTED[name])
    assert area(seen) == 4.0
    x = (np.array(ROW) + 0.5 - 40) / 20
    n = np.stack([0.6 * x, 0 * x, 0 * x + 0.8], -1)
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    np.testing.assert_allclose(np.asarray(seen.normal)[40, ROW], n, atol=1e-6)
    mesh = ds.exchange.read_mesh(tmp_path / name, None)
    rays = ds.intersect(ds.Scene(ds.Object(mesh)), CAMERA)
    np.testing.assert_allclose(rays.normal, seen.normal, atol=1e-5)
    flat = np.asarray(ds.exchange.read_mesh(tmp_path / name, CAMERA, smooth=False).normal)
    np.testing.assert_allclose(flat[40, ROW], np.broadcast_to((0.0, 0.0, 1.0), (3, 3)), atol=1e-12)


def test_indices_that_count_backward(tmp_path):
    for name, text in (("absolute.obj", made.ABSOLUTE), ("relative.obj", made.RELATIVE)):
        for of in (text, text.replace("usemtl red\n", "").replace("usemtl blue\n", "")):
            assert area(read(tmp_path, name, of)) == 8.0
    parts = ds.exchange.read_mesh_parts(tmp_path / "relative.obj", CAMERA)
    assert list(parts) == [""]
    (tmp_path / "relative.obj").write_text(made.RELATIVE)
    parts = ds.exchange.read_mesh_parts(tmp_path / "relative.obj", CAMERA)
    assert {name: area(part) for name, part in parts.items()} == {"red": 4.0, "blue": 4.0}
    assert np.asarray(parts["red"].mask)[:, :40].sum() == 1600


@pytest.mark.parametrize(
    "text",
    [
        "\ufeff" + made.ABSOLUTE,
        made.ABSOLUTE.replace(" ", "\t"),
        made.ABSOLUTE.replace(" ", "  \t ").replace("\n", " # red\n"),
        made.ABSOLUTE.replace("\n", "\r\n"),
        made.ABSOLUTE.replace("\n", "\r"),
        made.ABSOLUTE.replace("f 1 2", "f 1 \\\n 2").replace("\n", "\r\n"),
        made.ABSOLUTE.replace("v -2 -1 0", "v -2 -1 0 1.0 0.5 0.5 0.5#c"),
        made.ABSOLUTE.rstrip("\n"),
    ],
)
def test_white_space_comments_and_ends_of_lines(text, tmp_path):
    (tmp_path / "a.obj").write_bytes(text.encode())
    parts = ds.exchange.read_mesh_parts(tmp_path / "a.obj", CAMERA)
    assert {name: area(part) for name, part in parts.items()} == {"red": 4.0, "blue": 4.0}


@pytest.mark.parametrize(("text", "right"), [(made.NOTCH, 2.5), (made.WALL, 16.0)])
def test_faces_with_notches_and_windows(text, right, tmp_path):
    camera = ds.OrthographicCamera((3, 1.5, 4), target=(3, 1.5, 0), height=8.0, shape=(160, 160))
    seen = read(tmp_path, "a.obj", text, camera)
    assert area(seen) == pytest.approx(right, abs=0.02)
    np.testing.assert_allclose(np.asarray(seen.normal)[np.asarray(seen.mask)][:, 2], 1.0)
    points = [line.split()[1:] for line in text.splitlines() if line[0] == "v"]
    lists = [[int(i) - 1 for i in line.split()[1:]] for line in text.splitlines() if line[0] == "f"]
    head = f"ply\nformat ascii 1.0\nelement vertex {len(points)}\n" + "".join(f"property float {x}\n" for x in "xyz")
    head += f"element face {len(lists)}\nproperty list uchar int vertex_indices\nend_header\n"
    rows = [*points, *([len(face), *face] for face in lists)]
    text = head + "\n".join(" ".join(map(str, row)) for row in rows)
    assert area(read(tmp_path, "a.ply", text, camera)) == pytest.approx(right, abs=0.02)


def test_faces_back_to_back_have_each_their_own_normal(tmp_path):
    for z in (4, -4):
        camera = ds.OrthographicCamera((0, 0, z), height=4.0, shape=(40, 40))
        seen = read(tmp_path, "card.obj", made.CARD, camera)
        np.testing.assert_array_equal(np.asarray(seen.normal)[np.asarray(seen.mask)][:, 2], np.sign(z))
        mesh = ds.intersect(ds.Scene(ds.Object(ds.exchange.read_mesh(tmp_path / "card.obj", None))), camera)
        np.testing.assert_array_equal(np.asarray(mesh.normal)[np.asarray(mesh.mask)][:, 2], np.sign(z))


@pytest.mark.parametrize("name", ["sheet.obj", "sheet.ply"])
def test_a_bent_sheet_with_two_sides_is_as_smooth_as_with_one(name, tmp_path):
    """A quarter of a cylinder, of quads in OBJ and triangles in PLY."""
    t = np.linspace(-0.7, 0.7, 6)
    points = np.stack([np.repeat(np.sin(t), 2), np.tile((-1.0, 1.0), 6), np.repeat(np.cos(t), 2)], -1)
    quads = [(2 * i, 2 * i + 2, 2 * i + 3, 2 * i + 1) for i in range(5)]
    head = "".join("v {} {} {}\n".format(*p) for p in points)
    one = "".join("f {} {} {} {}\n".format(*(i + 1 for i in q)) for q in quads)
    other = "".join("f {} {} {} {}\n".format(*(i + 1 for i in q[::-1])) for q in quads)
    right = np.asarray(read(tmp_path, "one.obj", head + one).normal)
    if name == "sheet.obj":
        both = read(tmp_path, name, head + one + other)
    else:
        faces = np.array([f for a, b, c, d in quads for f in ((a, b, c), (a, c, d))])
        mesh = trimesh.Trimesh(points, np.concatenate([faces, faces[:, ::-1]]), process=False)
        both = read(tmp_path, name, mesh.export(file_type="ply", vertex_normal=False))
    assert area(both) == area(ds.exchange.read_mesh(tmp_path / "one.obj", CAMERA)) > 2
    assert angles(both.normal, right)[np.asarray(both.mask)].max() < 1e-3


LOST = "has no area or fewer than three corners; it is left out."


def test_triangles_without_area_are_left_out_and_said_once(tmp_path, caplog):
    box = trimesh.creation.box()
    head = "".join("v {} {} {}\n".format(*v) for v in box.vertices) + "v 0 0 2\nv 0 0 3\nv 0 0 4\n"
    faces = "".join("f {} {} {}\n".format(*(f + 1)) for f in box.faces)
    right = read(tmp_path, "a.obj", head + faces)
    assert not caplog.messages
    for more in ("f 9 9 9\n", "f 9 10 11\n", "f 1 2\n", "f 9 10 10 11\n"):
        with caplog.at_level(logging.WARNING, logger="diffshade"):
            seen = read(tmp_path, "a.obj", head + more + faces)
        assert caplog.messages == [f"{tmp_path / 'a.obj'}: face 1 of 13 {LOST}"]
        caplog.clear()
        np.testing.assert_array_equal(seen.mask, right.mask)
        np.testing.assert_allclose(seen.normal, right.normal, atol=1e-9)
        assert ds.exchange.read_mesh(tmp_path / "a.obj", None).extent() == pytest.approx(0.75**0.5)
        assert ds.exchange.frame_mesh(tmp_path / "a.obj").target == pytest.approx(np.zeros(3))
        caplog.clear()
    with pytest.raises(ValueError, match=r"has no triangle with an area\."):
        read(tmp_path, "none.obj", head + "f 9 10 11\n")


def ball(part, texture=False, normals=False):
    """A ball of 320 triangles as OBJ; `part`: material of a triangle by the place of its middle."""
    mesh = trimesh.creation.icosphere(2)
    rows = ["v {:.9f} {:.9f} {:.9f}".format(*v) for v in mesh.vertices]
    rows += ["vn {:.9f} {:.9f} {:.9f}".format(*v) for v in mesh.vertices] if normals else []
    named = [part(x) for x in mesh.triangles_center]
    if texture:  # a seam at x = 0, where positions are written twice
        rows += ["v {:.9f} {:.9f} {:.9f}".format(*v) for v in mesh.vertices]
    for name in dict.fromkeys(named):
        rows.append(f"usemtl {name}")
        for face, of in zip(mesh.faces, named, strict=True):
            places = face + 1 + (len(mesh.vertices) if texture and of == "b" else 0)
            rows.append(
                "f " + " ".join(f"{p}//{i + 1}" if normals else f"{p}" for p, i in zip(places, face, strict=True))
            )
    return "\n".join(rows)


@pytest.mark.parametrize("texture", [False, True])
def test_normals_at_borders_and_seams_are_those_of_the_whole(texture, tmp_path):
    whole = read(tmp_path, "one.obj", ball(lambda _: "a"))
    (tmp_path / "two.obj").write_text(ball(lambda x: "a" if x[0] < 0 else "b", texture))
    seamed, parts = (
        ds.exchange.read_mesh(tmp_path / "two.obj", CAMERA),
        ds.exchange.read_mesh_parts(tmp_path / "two.obj", CAMERA),
    )
    assert list(parts) == ["a", "b"]
    inside = np.asarray(whole.mask)
    assert angles(seamed.normal, whole.normal)[inside].max() < 1e-3
    depth = [np.where(part.mask, np.asarray(part.position)[..., 2], -9.0) for part in parts.values()]
    front = np.where((depth[0] > depth[1])[..., None], *(np.asarray(part.normal) for part in parts.values()))
    assert angles(front, whole.normal)[inside].max() < 1e-3


def test_creases_are_where_the_file_says_so(tmp_path):
    """A prism of 8 sides: smooth by its smoothing group or normals, flat with `s off`, and the top is flat always."""
    t = np.arange(8) * np.pi / 4
    ring = np.stack([np.cos(t), np.sin(t)], -1)
    head = "".join(f"v {x} {y} {z}\n" for z in (0, 1) for x, y in ring)
    sides = "".join(f"f {i + 1} {(i + 1) % 8 + 1} {(i + 1) % 8 + 9} {i + 9}\n" for i in range(8))
    top = "f 9 10 11 12 13 14 15 16\n"
    camera = ds.OrthographicCamera((4, 0, 0.5), target=(0, 0, 0.5), up=(0, 0, 1), height=4.0, shape=(80, 80))
    above = ds.OrthographicCamera((0, 0, 4), height=4.0, shape=(80, 80))

    def y_at_edge(text):
        seen = read(tmp_path, "a.obj", text, camera)
        upper = np.asarray(ds.exchange.read_mesh(tmp_path / "a.obj", above).normal)
        return np.asarray(seen.normal)[40, 53, 1], upper[40, 58, 2]

    smooth, flat = np.sin(np.pi / 4), np.sin(np.pi / 8)
    y, z = y_at_edge(head + "s 1\n" + sides + "s 2\n" + top)
    assert y == pytest.approx(smooth, abs=0.05)
    assert z == 1.0
    y, z = y_at_edge(head + "s off\n" + sides + top)
    assert y == pytest.approx(flat, abs=1e-6)
    assert z == 1.0
    y, z = y_at_edge(head + sides + top)  # nothing is said: one smooth surface
    assert z < 0.95
    vn = "".join(f"vn {x} {y} 0\n" for x, y in ring) + "vn 0 0 1\n"
    pairs = [(i + 1, (i + 1) % 8 + 1) for i in range(8)]
    of = "".join(f"f {a}//{a} {b}//{b} {b + 8}//{b} {a + 8}//{a}\n" for a, b in pairs)
    y, z = y_at_edge(head + vn + of + "f " + " ".join(f"{i}//9" for i in range(9, 17)))
    assert y == pytest.approx(smooth, abs=0.05)
    assert z == 1.0


def test_normals_that_are_none_are_computed_and_said(tmp_path, caplog):
    text = ball(lambda _: "a", normals=True)
    right = read(tmp_path, "a.obj", text)
    rows = text.splitlines()
    index = next(i for i, row in enumerate(rows) if row.startswith("vn"))
    for wrong in ("vn 0 0 0", "vn 0.0 -0.0 0", "vn nan nan nan", "vn -1.#IND 0 0", "vn -nan(ind) inf 0"):
        with caplog.at_level(logging.WARNING, logger="diffshade"):
            seen = read(tmp_path, "b.obj", "\n".join([*rows[:index], wrong, *rows[index + 1 :]]))
        assert caplog.messages == [
            f"{tmp_path / 'b.obj'}: the normals at 5 corners of triangles are missing or have no direction; "
            "they are computed."
        ]
        caplog.clear()
        assert angles(seen.normal, right.normal)[np.asarray(right.mask)].max() < 1.0
    some = [
        row.split("//")[0] + " " + " ".join(w.split("//")[0] for w in row.split()[2:])
        if row[0] == "f" and i % 2
        else row
        for i, row in enumerate(rows)
    ]
    seen = read(tmp_path, "some.obj", "\n".join(some))
    assert angles(seen.normal, right.normal)[np.asarray(right.mask)].max() < 1.0


def test_normals_that_faces_name_and_the_file_lacks_are_computed_and_said(tmp_path, caplog):
    with caplog.at_level(logging.WARNING, logger="diffshade"):
        seen = read(tmp_path, "a.obj", made.QUAD + "f 1//1 2//2 3//3 4//4\n")
    assert "the normals at 6 corners of triangles are missing" in caplog.text
    np.testing.assert_allclose(np.asarray(seen.normal)[np.asarray(seen.mask)], [[0, 0, 1]] * int(seen.mask.sum()))


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.obj", ("\ufeff" + made.QUAD + "f 1 2 3 4\n").encode("utf-16-be")),
        ("a.obj", made.QUAD + "fo 1 2 3 4\n"),
        ("a.ply", made.ply("ascii", [(0, 1, 2, 3)]).replace(b"comment made here", b"made by an old program")),
    ],
)
def test_files_of_old_and_odd_programs(name, content, tmp_path):
    assert area(read(tmp_path, name, content)) == pytest.approx(4.0, abs=0.1)


@pytest.mark.parametrize(
    ("word", "flat"),
    [("OFF", True), ("null", True), ("0", True), ("", True), ("on", False), ("1", False), ("hull", False)],
)
def test_the_words_of_smoothing_groups(word, flat, tmp_path):
    roof = "v -1 -1 0\nv 0 -1 1\nv 0 1 1\nv -1 1 0\nv 1 -1 0\nv 1 1 0\nv nan 0 1.#INF\n"
    seen = read(tmp_path, "a.obj", roof + f"s {word}\nf 1 2 3 4\nf 2 5 6 3\n")
    slope = np.asarray(seen.normal)[40, 38, 0]
    assert slope == pytest.approx(-(0.5**0.5)) if flat else abs(slope) < 0.2


def test_a_face_whose_edges_cross_is_said(tmp_path, caplog):
    for square, bent in (
        ("v 0 0 0\nv 4 0 1\nv 4 4 0\nv 0 4 1\n", True),
        ("v 0 0 0\nv 4 4 0\nv 4 0 0\nv 0 4 0\n", False),
    ):
        with caplog.at_level(logging.WARNING, logger="diffshade"):
            read(tmp_path, "a.obj", square + "f 1 2 3\nf 1 2 3 4\n")
        assert (not caplog.messages) == bent
    assert caplog.messages == [f"{tmp_path / 'a.obj'}: face 2 of 2 has edges that cross; it is drawn with overlaps."]


def test_many_faces_back_to_back_have_each_their_own_side():
    n = 40
    g = np.arange(n * n).reshape(n, n)
    quads = np.stack([g[:-1, :-1], g[:-1, 1:], g[1:, 1:], g[1:, :-1]], -1).reshape(-1, 4)
    at = np.concatenate([quads, quads[:, ::-1]])
    x, y = np.indices((n, n)).reshape(2, -1) * 1.0
    none = np.zeros(len(at), int)
    of = Polygons(np.stack([y, x, 0 * x], -1), none + 4, at.ravel(), np.full((at.size, 3), np.nan), none, none)
    corner, face = triangulated(of)
    normal = corner_normals(of, corner, face)
    np.testing.assert_array_equal(normal[:, 0, 2], np.where(face < len(quads), 1.0, -1.0))


FACES = np.array([0, 1, 2, 0, 2, 3])
FOUR = (made.POINTS.astype("<f4"), "VEC3")


def of_points(mode, order, **node):
    index = (np.array(order, "<u1"), "SCALAR")
    return made.gltf([{"attributes": {"POSITION": 0}, "indices": 1, "mode": mode}], [FOUR, index], node)


@pytest.mark.parametrize(
    ("content", "right"),
    [
        (of_points(4, FACES), 4.0),
        (of_points(5, [0, 1, 3, 2]), 4.0),
        (of_points(6, [0, 1, 2, 3]), 4.0),
        (of_points(4, FACES, scale=[-1, 0.5, 1]), 2.0),
        (of_points(4, FACES, rotation=[0, 0, np.sqrt(0.5), np.sqrt(0.5)], scale=[0.5, 1, 1]), 2.0),
        (of_points(4, FACES, matrix=[0.5, 0, 0, 0, 0, 0.5, 0, 0, 0, 0, 1, 0, 0.25, 0, 0, 1]), 1.0),
        (of_points(4, FACES, mesh=0, children=[]), 4.0),
    ],
)
def test_gltf_strips_fans_and_nodes(content, right, tmp_path):
    seen = read(tmp_path, "a.glb", content)
    assert area(seen) == right
    np.testing.assert_allclose(np.asarray(seen.normal)[np.asarray(seen.mask)][:, 2], 1.0)


def test_gltf_skins_and_morphs_are_said_and_a_skinned_nodes_matrix_is_not_applied(tmp_path, caplog):
    with caplog.at_level(logging.WARNING, logger="diffshade"):
        assert area(read(tmp_path, "a.glb", of_points(4, FACES, weights=[0, 0]))) == 4.0
        assert not caplog.messages
        seen = read(tmp_path, "a.glb", of_points(4, FACES, skin=0, scale=[0.5, 1, 1], weights=[0, 0.5]))
    assert area(seen) == 4.0
    assert [message.split("a.glb: ")[1] for message in caplog.messages] == [
        f"1 {what} is not applied; the mesh is drawn as the file stores it."
        for what in ("skin", "set of morph weights")
    ]


def test_gltf_normals_of_a_stretched_node(tmp_path):
    """A plane z = x, squeezed to z = 2 x: its normal is not stretched as the plane is."""
    points = made.POINTS.copy()
    points[:, 2] = points[:, 0]
    normal = np.broadcast_to(np.array([-1, 0, 1]) / np.sqrt(2), (4, 3))
    arrays = [(points.astype("<f4"), "VEC3"), (normal.astype("<f4"), "VEC3"), (FACES.astype("<u4"), "SCALAR")]
    for scale, right in (([0.5, 1, 1], (-2, 0, 1)), ([-0.5, 1, 1], (2, 0, 1))):
        content = made.gltf([{"attributes": {"POSITION": 0, "NORMAL": 1}, "indices": 2}], arrays, {"scale": scale})
        seen = read(tmp_path, "a.glb", content)
        assert angles(np.asarray(seen.normal)[40, 40], np.array(right) / np.sqrt(5)) < 1e-3


def test_gltf_quantised_and_sparse_numbers(tmp_path):
    far = made.POINTS + np.array([50, 0, 0])
    sparse = {"count": 4, "indices": {"bufferView": 2, "componentType": 5121}, "values": {"bufferView": 3}}
    arrays = [
        (far.astype("<f4"), "VEC3"),
        (FACES.astype("<u1"), "SCALAR"),
        (np.arange(4, dtype="<u1"), "SCALAR"),
        FOUR,
    ]
    first = {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3", "sparse": sparse}
    second = {"bufferView": 1, "componentType": 5121, "count": 6, "type": "SCALAR"}
    for row in (first, {key: value for key, value in first.items() if key != "bufferView"}):
        content = made.gltf([{"attributes": {"POSITION": 0}, "indices": 1}], arrays, accessors=[row, second])
        assert area(read(tmp_path, "a.glb", content)) == 4.0
    points = (made.POINTS * 127).astype("i1")
    whole = {"bufferView": 0, "componentType": 5120, "count": 4, "type": "VEC3", "normalized": True}
    content = made.gltf(
        [{"attributes": {"POSITION": 0}, "indices": 1}], [(points, "VEC3"), arrays[1]], accessors=[whole, second]
    )
    assert area(read(tmp_path, "a.glb", content)) == 4.0


def test_the_materials_that_primitives_of_gltf_name(tmp_path):
    primitives = [{"attributes": {"POSITION": 0}, "indices": i + 1, "material": i} for i in range(2)]
    arrays = [FOUR, (FACES[:3].astype("<u1"), "SCALAR"), (FACES[3:].astype("<u1"), "SCALAR")]
    for materials, names in (
        ([{"name": "red"}, {"name": "blue"}], ["red", "blue"]),
        ([{}, {}], ["material_0", "material_1"]),
    ):
        (tmp_path / "a.glb").write_bytes(made.gltf(primitives, arrays, materials=materials))
        parts = ds.exchange.read_mesh_parts(tmp_path / "a.glb", CAMERA)
        assert list(parts) == names == list(ds.exchange.read_materials(tmp_path / "a.glb"))
        assert sum(area(part) for part in parts.values()) == pytest.approx(4.0, abs=0.2)  # both have the diagonal


TRIANGLE = "facet normal 0 0 1\nouter loop\nvertex -1 -1 0\nvertex 1 -1 0\nvertex 1 1 0\nendloop\nendfacet\n"
RECORD = struct.pack("<12fH", 0, 0, -1, -1, -1, 0, 1, -1, 0, 1, 1, 0, 0)


@pytest.mark.parametrize(
    "content",
    [
        f"solid vertex of a part\n{TRIANGLE}endsolid vertex of a part\n",
        f"solid\n{TRIANGLE.upper()}endsolid\n".replace("\n", "\r"),
        b"solid".ljust(80) + struct.pack("<I", 1) + RECORD,
        b"solid".ljust(80, b"\0") + struct.pack("<I", 1) + RECORD + bytes(7),
    ],
)
def test_stl_ascii_and_binary(content, tmp_path):
    seen = read(tmp_path, "a.stl", content)
    assert area(seen) == pytest.approx(2.0, abs=0.06)
    np.testing.assert_array_equal(np.asarray(seen.normal)[np.asarray(seen.mask)][:, 2], 1.0)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.obj", made.QUAD + "f 1 2 5\n", r"a\.obj has 4 vertices, and a face names number 5\."),
        ("a.obj", made.QUAD + "f -5 1 2\n", r"a\.obj: 'f -5 1 2' has the index '-5'; 4 are defined before it\."),
        ("a.obj", made.QUAD + "f 0 1 2\n", r"has the index '0'"),
        ("a.obj", made.QUAD + "v 1 nan 0\nf 1 2 5\n", r"a\.obj has a face with a corner that is not finite"),
        ("a.obj", made.QUAD + "v 1 2\nf 1 2 3\n", r"'v 1 2' must have three numbers"),
        ("a.obj", b"v 0 0 0\0", r"a\.obj is not a Wavefront OBJ file: it holds zero bytes"),
        ("a.ply", made.ply("ascii", [(0, 1, 4)]), r"a\.ply has 4 vertices, and a face names number 5"),
        ("a.ply", made.ply("ascii", [(0, 1, 2)])[:-4], r"a\.ply does not hold the 1 rows of its element face"),
        ("a.ply", made.ply("binary_big_endian", [(0, 1, 2)])[:-1], r"does not hold the 1 rows of its element face"),
        ("a.ply", made.ply("ascii", [(0, 1, 2)]).replace(b"0.6", b"0.x"), r"a word where a number must be"),
        ("a.ply", made.ply("ascii", []), r"a\.ply has no triangles\."),
        (
            "a.ply",
            made.ply("ascii", [(0, 1, 2)]).replace(b"element edge", b"element tristrips"),
            r"triangles as strips",
        ),
        ("a.stl", b"x".ljust(80, b"\0") + struct.pack("<I", 3) + RECORD, r"134 bytes, fewer than its 3 triangles take"),
        ("a.stl", f"solid\n{TRIANGLE}", r"lacks a line endsolid"),
        (
            "a.glb",
            of_points(4, [0, 1, 9]),
            r"a\.glb cannot be read as glTF 2\.0: a primitive has 4 vertices, and a face names number 10",
        ),
        ("a.glb", of_points(4, FACES)[:-9], r"a buffer has \d+ of its \d+ bytes"),
        ("a.glb", of_points(4, FACES, children=[0]), r"node 0 is reached twice: it has two parents, or is its own"),
        (
            "a.glb",
            made.gltf([], [], extensionsRequired=["KHR_draco_mesh_compression"]),
            r"it needs the extension KHR_draco_mesh_compression, which is not read",
        ),
    ],
)
def test_files_that_contradict_themselves_are_refused(name, content, message, tmp_path):
    with pytest.raises(ValueError, match=message):
        read(tmp_path, name, content)


@pytest.mark.thorough
def test_coordinates_of_a_map(tmp_path):
    """A ball of a metre at (500000, 5400000, 300) is drawn as one at the origin, by its own rays and by any."""
    mesh, origin = trimesh.creation.icosphere(3), np.array([500_000.0, 5_400_000.0, 300.0])
    images = []
    for name, place in (("near.obj", 0 * origin), ("far.obj", origin)):
        rows = ["v {:.9f} {:.9f} {:.9f}".format(*(v + place)) for v in mesh.vertices]
        path = tmp_path / name
        path.write_text("\n".join([*rows, *("f {} {} {}".format(*(f + 1)) for f in mesh.faces)]))
        camera = ds.exchange.frame_mesh(path, shape=(40, 40))
        lights = ds.DirectionalLight((0.5, -1, -1)), ds.PointLight(place + np.array([2, 3, 2]))
        for surface in (ds.exchange.read_mesh(path, camera), ds.exchange.read_mesh(path, None)):
            scene = ds.Scene(ds.Object(surface, ds.Material(0.7, 0.7, 0.5, 60)), lights)
            with jax.enable_x64(False):
                images.append(np.asarray(ds.render(scene, camera)))
            assert images[-1].dtype == np.float32
    for near, far in zip(images[:2], images[2:], strict=True):
        np.testing.assert_allclose(far, near, atol=1e-4)
