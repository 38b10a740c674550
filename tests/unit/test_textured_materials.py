"""Material files with pictures: `convert` keeps them, and glass means the same in glTF as here."""

import base64
import io
import itertools
import json
import os
from urllib.parse import quote

import numpy as np
import pytest
import textured_meshes as made
from exchange_programs import assert_valid
from PIL import Image

import diffshade as ds
from diffshade.cli import main
from diffshade.exchange.base_colours import ColourPicture
from diffshade.exchange.material_files import read_textured

MTL = "newmtl wall\nKd 0.5 0.6 0.7\nmap_Kd {0}tile.png\nbump b.png\nnewmtl plain\nKd 1 0 0\n"


@pytest.fixture
def converted(capfd):
    """Run `diffshade convert`, and return all that it says."""

    def run(*words):
        with pytest.raises(SystemExit) as end:
            main(["convert", *map(str, words)])
        said = "".join(capfd.readouterr())
        assert end.value.code == 0, said
        return said

    return run


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "in").mkdir()
    (tmp_path / "out").mkdir()
    (tmp_path / "in" / "tile.png").write_bytes(made.pictures()["many"].png())
    (tmp_path / "in" / "a.mtl").write_text(MTL.format("-clamp on -s 2 3 1 -o 0.25 0.5 0 "))
    return tmp_path


def bases(path):
    return read_textured(path)[1]


def pictures(path):
    """The pictures of base colours, by material."""
    return {name: base.picture for name, base in bases(path).items() if base.picture is not None}


def test_a_picture_goes_through_every_format_and_back(folder, converted, caplog):
    """In one folder its name stays; in another it lies beside the file, once, and its place is the same."""
    chain = ["in/a.mtl", "in/b.gltf", "out/c.json", "out/d.gltf", "in/e.mtl"]
    given = pictures(folder / chain[0])["wall"]
    for one, other in itertools.pairwise(chain):
        converted(folder / one, folder / other)
        found = pictures(folder / other)
        assert list(found) == ["wall"]
        picture = found["wall"]
        assert (picture.uri, picture.wrap, picture.read()) == ("tile.png", given.wrap, given.read())
        np.testing.assert_allclose(picture.place, given.place, atol=1e-12)
        if one == chain[0]:
            assert "'wall': texture maps are not read, only those of the base colour: 'bump'." in caplog.text
    assert "map_Kd -clamp on -s 2.0 3.0 1 -o 0.25 0.5 0 tile.png" in (folder / "in" / "e.mtl").read_text()
    assert sorted(os.listdir(folder / "out")) == ["c.json", "d.gltf", "tile.png"]
    assert read_textured(folder / "in" / "e.mtl")[0]["wall"].k_d == pytest.approx([0.5, 0.6, 0.7], abs=0.01)


def test_another_picture_of_its_name_is_not_replaced(folder, converted):
    (folder / "out" / "tile.png").write_bytes(b"another")
    converted(folder / "in" / "a.mtl", folder / "out" / "c.mtl")
    assert (folder / "out" / "tile.png").read_bytes() == b"another"
    assert pictures(folder / "out" / "c.mtl")["wall"].uri == "c_wall.png"
    (folder / "in" / "far.mtl").write_text(MTL.format("").replace("tile.png", f"{folder}/in/tile.png"))
    converted(folder / "in" / "far.mtl", folder / "out" / "f.mtl")
    assert f"map_Kd {folder}/in/tile.png" in (folder / "out" / "f.mtl").read_text()  # it leads there from anywhere


def test_what_is_packed_stays_packed_where_a_format_can(folder, converted):
    made.write(folder / "in" / "m.glb", metallic=0.0)
    converted(folder / "in" / "m.glb", folder / "out" / "m.gltf", folder / "out" / "m.json")
    many = made.pictures()["many"].png()
    for name in ("m.gltf", "m.json"):
        shown = pictures(folder / "out" / name)
        assert shown["opaque"].is_packed
        assert shown["opaque"].read() == many
        assert shown["wrapped"].wrap == ("mirror", "clamp")
        found = bases(folder / "out" / name)
        assert (found["mask"].cutoff, found["blend"].blends) == (0.3, True)
    assert sorted(os.listdir(folder / "out")) == ["m.gltf", "m.json"]
    np.testing.assert_allclose(
        pictures(folder / "out" / "m.gltf")["turned"].place,
        pictures(folder / "in" / "m.glb")["turned"].place,
        atol=1e-12,
    )
    said = converted(folder / "out" / "m.gltf", folder / "out" / "m.mtl")
    assert "turned: MTL does not turn pictures" in said
    assert "wrapped: MTL does not mirror pictures" in said
    assert "mask and blend: MTL draws the clear points of its picture as well." in said
    assert pictures(folder / "out" / "m.mtl")["opaque"].read() == many


def test_a_metal_and_what_has_no_light_keep_what_their_pictures_colour(folder, converted):
    """The highlight, by specularColorTexture or map_Ks; the emission alone. three.js has highlights of one colour."""
    made.write(folder / "in" / "m.glb")
    for name in ("m.gltf", "m.mtl", "m.json"):
        said = converted(folder / "in" / "m.glb", folder / "out" / name)
        materials, found = read_textured(folder / "out" / name)
        assert ("metal: its picture colours a metal's highlight" in said) == (name == "m.json")
        assert found["metal"].is_metal == (name != "m.json")
        assert found["unlit"].fields == ("k_e",)
        assert found["unlit"].picture is not None
        np.testing.assert_allclose(materials["unlit"].k_e, made.FACTOR[:3], atol=0.003)
    (folder / "in" / "a.mtl").write_text("newmtl lit\nKd 0.5 0 0\nKe 1 1 1\nmap_Ke tile.png\n")
    for name, key in (("e.gltf", "emissiveTexture"), ("e.json", "emissiveMap")):
        converted(folder / "in" / "a.mtl", folder / "out" / name)
        document = json.loads((folder / "out" / name).read_text())
        assert key in (document["materials"][0] if name == "e.gltf" else document)


def test_a_whole_path_becomes_a_name_that_leads_there(folder, converted):
    """One of another machine, of which the last name is beside the file, and one that a URI would start at a server."""
    for written in ("C:\\art\\tile.png", f"{folder}/in/tile.png"):
        (folder / "in" / "a.mtl").write_text(MTL.format("").replace("tile.png", written))
        converted(folder / "in" / "a.mtl", folder / "in" / "b.gltf", folder / "in" / "b.json")
        for name, key in (("b.gltf", "uri"), ("b.json", "url")):
            assert [of[key] for of in json.loads((folder / "in" / name).read_text())["images"]] == ["tile.png"]
    assert sorted(os.listdir(folder / "in")) == ["a.mtl", "b.gltf", "b.json", "tile.png"]


@pytest.mark.parametrize("suffix", [".c", ".py", ".inc", ".js"])
def test_formats_without_pictures_say_so(suffix, folder, converted):
    said = converted(folder / "in" / "a.mtl", folder / "out" / f"a{suffix}")
    assert f"wall: {suffix} names no pictures; the colour of the material is written." in said
    assert os.listdir(folder / "out") == [f"a{suffix}"]


def test_a_picture_that_is_not_there_is_said_and_its_name_kept(folder, converted):
    (folder / "in" / "tile.png").unlink()
    said = converted(folder / "in" / "a.mtl", folder / "out" / "a.gltf")
    assert "wall: there is no picture 'tile.png' in its folder. Put it beside the file. Its name is written" in said
    assert json.loads((folder / "out" / "a.gltf").read_text())["images"] == [{"uri": "tile.png"}]


def test_a_name_of_two_lines_writes_no_second_row(folder, converted):
    document = {"asset": {"version": "2.0"}, "images": [{"uri": "x%0ANs%205.png"}], "textures": [{"source": 0}]}
    (folder / "in" / "x\nNs 5.png").write_bytes(made.pictures()["many"].png())
    row = {"name": "a", "pbrMetallicRoughness": {"metallicFactor": 0, "baseColorTexture": {"index": 0}}}
    (folder / "in" / "x.gltf").write_text(json.dumps(document | {"materials": [row]}))
    converted(folder / "in" / "x.gltf", folder / "out" / "x.mtl")
    assert "map_Kd x_a.png\n" in (folder / "out" / "x.mtl").read_text()


def encoded(kind):
    file = io.BytesIO()
    Image.fromarray(made.pictures()["many"].texels).save(file, kind, **({"lossless": True} if kind == "WEBP" else {}))
    return file.getvalue()


@pytest.mark.parametrize(
    ("kind", "to", "changed"),
    [
        ("WEBP", ".gltf", True),
        ("WEBP", ".json", False),
        ("WEBP", ".mtl", False),
        ("TGA", ".gltf", True),
        ("TGA", ".json", True),
        ("TGA", ".mtl", False),
    ],
)
def test_a_picture_that_not_every_program_shows_becomes_png(kind, to, changed, folder, converted):
    """Its pixels are the same, and the picture that is there stays."""
    name = f"tile.{kind.lower()}"
    (folder / "in" / name).write_bytes(encoded(kind))
    (folder / "in" / "tile.png").write_bytes(b"another")
    (folder / "in" / "a.mtl").write_text(MTL.format("").replace("tile.png", name))
    for place in ("in", "out"):
        said = converted(folder / "in" / "a.mtl", folder / place / f"b{to}")
        picture = pictures(folder / place / f"b{to}")["wall"]
        assert picture.uri == (("b_wall.png" if place == "in" else "tile.png") if changed else name)
        assert (f"wall: its picture is written as PNG: not all programs that read {to} show" in said) == changed
        if changed:
            assert picture.read().startswith(b"\x89PNG")
        np.testing.assert_array_equal(picture.texels().stored, made.pictures()["many"].texels)
    assert (folder / "in" / "tile.png").read_bytes() == b"another"


def test_a_packed_picture_becomes_png_too_or_is_left_out(folder, converted):
    for data, said in ((encoded("WEBP"), "is written as PNG"), (b"GIF89a", "It is left out.")):
        (folder / "in" / "a.gltf").write_text(gltf_of("wall", data))
        assert f"{said}" in converted(folder / "in" / "a.gltf", folder / "out" / "b.gltf")
        document = json.loads((folder / "out" / "b.gltf").read_text())
        found = [of["uri"][:22] for of in document.get("images", [])]
        assert found == (["data:image/png;base64,"] if data.startswith(b"RIFF") else [])


def test_names_that_a_uri_writes_otherwise(folder, converted):
    """`#`, `%` and `?` have a meaning in a URI, and none in a name; what is on the web stays as it is."""
    name = "50%41 #1?.png"
    (folder / "in" / name).write_bytes(made.pictures()["many"].png())
    (folder / "in" / "a.gltf").write_text(gltf_of("wall", b"").replace("data:image/png;base64,", quote(name)))
    for one, other in (("in/a.gltf", "in/b.json"), ("in/b.json", "out/c.gltf"), ("out/c.gltf", "in/d.json")):
        converted(folder / one, folder / other)
        assert pictures(folder / other)["wall"].uri == name
        document = json.loads((folder / other).read_text())
        assert [of.get("uri", of.get("url")) for of in document["images"]] == ["50%2541%20%231%3F.png"]
    converted(folder / "in" / "d.json", folder / "out" / "e.mtl")
    assert pictures(folder / "out" / "e.mtl")["wall"].uri == "e_wall.png"
    far = "https://example.org/a%20b.png?v=1"
    (folder / "in" / "a.gltf").write_text(gltf_of("wall", b"").replace("data:image/png;base64,", far))
    converted(folder / "in" / "a.gltf", folder / "out" / "f.json")
    assert json.loads((folder / "out" / "f.json").read_text())["images"][0]["url"] == far


def test_what_of_a_texture_is_not_applied_is_named(folder, converted, caplog):
    row = {"name": "a", "emissiveTexture": {"index": 0}, "normalTexture": {"index": 0}}
    row["occlusionTexture"] = {"index": 0}
    row["pbrMetallicRoughness"] = {"metallicRoughnessTexture": {"index": 0}, "metallicFactor": 0}
    (folder / "in" / "a.gltf").write_text(json.dumps({"asset": {"version": "2.0"}, "materials": [row]}))
    converted(folder / "in" / "a.gltf", folder / "out" / "b.mtl")
    for name in ("emissiveTexture", "normalTexture", "occlusionTexture", "metallicRoughnessTexture"):
        assert f"'{name}'" in caplog.text
    converted(folder / "in" / "a.mtl", folder / "in" / "b.json")
    document = json.loads((folder / "in" / "b.json").read_text())
    document["textures"][0] |= {"rotation": 0.5, "flipY": False}
    (folder / "in" / "b.json").write_text(json.dumps(document))
    caplog.clear()
    converted(folder / "in" / "b.json", folder / "out" / "c.mtl")
    assert "its map has rotation 0.5 and flipY false, which are not read; its colour alone is." in caplog.text
    assert "names no picture" not in caplog.text


def test_a_picture_is_read_once(folder, converted, monkeypatch):
    made.write(folder / "in" / "m.glb", metallic=0.0)
    reads, read = [], ColourPicture.read
    monkeypatch.setattr(ColourPicture, "read", lambda self: reads.append(self.image) or read(self))
    converted(folder / "in" / "m.glb", folder / "out" / "m.gltf")
    assert sorted(reads) == [0, 1]


GLASS = {
    "bends": ({"k_t": 0.9, "eta": 1.5}, {"transmission", "ior"}),
    "diffuses too": ({"k_d": 0.4, "k_t": 0.5, "eta": 1.3}, {"transmission", "ior"}),
    "has a colour": ({"k_t": (0.9, 0.5, 0.2)}, {"transmission"}),
    "glossy": ({"k_t": 0.5, "eta": 1.5, "k_s": 0.3, "n_s": 80}, {"transmission", "ior"}),
    "is thin": ({"k_d": 0.4, "k_t": 0.5}, set()),
    "has other colours": ({"k_d": (0.4, 0.2, 0.1), "k_t": 0.5, "eta": 1.5}, set()),
    "is opaque": ({"k_d": 0.3, "k_s": 0.2, "n_s": 30, "eta": 1.4}, {"ior"}),
}


@pytest.mark.parametrize("case", GLASS)
def test_glass_comes_back_from_gltf_as_it_was(case, tmp_path):
    given, extensions = GLASS[case]
    glass = ds.Material(**given)
    said = str(ds.exchange.write_material(tmp_path / "a.gltf", glass))
    (row,) = json.loads((tmp_path / "a.gltf").read_text())["materials"]
    assert {key.removeprefix("KHR_materials_") for key in row["extensions"]} == {"specular", *extensions}
    found = ds.exchange.read_material(tmp_path / "a.gltf")
    for name in ("k_d", "k_t"):
        one, other = (getattr(of, name) for of in (found, glass))
        assert (one is None and other is None) or np.abs(one - other).max() < 0.005
    np.testing.assert_allclose(found.k_s, glass.k_s, rtol=0.03)
    if "ior" in extensions:
        assert found.eta == glass.eta
    assert ("eta 1.5 is not written" in said) == (case == "has other colours")


@pytest.mark.thorough
def test_gltf_with_pictures_and_glass_is_valid(folder, converted):
    made.write(folder / "in" / "m.glb")
    assert_valid(folder / "in" / "m.glb")
    converted(folder / "in" / "m.glb", folder / "out" / "m.gltf")
    converted(folder / "in" / "a.mtl", folder / "out" / "a.gltf")
    for i, (given, _) in enumerate(GLASS.values()):
        ds.exchange.write_material(folder / "out" / f"{i}.gltf", ds.Material(**given))
    for path in (folder / "out").glob("*.gltf"):
        assert_valid(path)


def gltf_of(name, data):
    packed = "data:image/png;base64," + base64.b64encode(data).decode()
    base = {"baseColorTexture": {"index": 0}}
    return json.dumps(
        {
            "asset": {"version": "2.0"},
            "materials": [{"name": name, "pbrMetallicRoughness": base}],
            "textures": [{"source": 0}],
            "images": [{"uri": packed}],
        }
    )


def test_no_name_of_a_material_leads_out_of_the_folder_and_no_file_is_replaced(folder, converted):
    (folder / "profile.png").write_bytes(b"mine")
    (folder / "out" / "b_wall.png").write_bytes(b"mine too")
    picture = made.pictures()["many"].png()
    for stem, name, data in (("a", "/../../profile", picture), ("b", "wall", picture), ("c", "bad", b"echo owned")):
        (folder / "in" / f"{stem}.gltf").write_text(gltf_of(name, data))
        said = converted(folder / "in" / f"{stem}.gltf", folder / "out" / f"{stem}.mtl")
        assert ("no PNG, JPEG, WebP or BMP" in said) == (stem == "c")
    assert (folder / "profile.png").read_bytes() == b"mine"
    assert (folder / "out" / "b_wall.png").read_bytes() == b"mine too"
    assert (folder / "out" / "b_wall2.png").read_bytes() == picture
    assert sorted(os.listdir(folder / "out")) == [
        "a.mtl",
        "a_profile.png",
        "b.mtl",
        "b_wall.png",
        "b_wall2.png",
        "c.mtl",
    ]
    assert sorted(os.listdir(folder)) == ["in", "out", "profile.png"]


def test_a_link_leads_nowhere(folder, converted):
    (folder / "secret").write_bytes(b"secret")
    (folder / "in" / "tile.png").unlink()
    (folder / "in" / "tile.png").symlink_to(folder / "secret")
    assert "there is no picture 'tile.png' in its folder" in converted(
        folder / "in" / "a.mtl", folder / "out" / "c.gltf"
    )
    assert os.listdir(folder / "out") == ["c.gltf"]


def test_a_render_never_replaces_a_picture_of_its_mesh(folder, capfd):
    (folder / "in" / "tile.obj").write_text(
        "mtllib a.mtl\nusemtl wall\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n"
    )
    before = (folder / "in" / "tile.png").read_bytes()
    with pytest.raises(SystemExit):
        main(["render", str(folder / "in" / "tile.obj"), "--size", "16x16"])
    assert "is a picture of the materials" in capfd.readouterr().err
    assert (folder / "in" / "tile.png").read_bytes() == before
