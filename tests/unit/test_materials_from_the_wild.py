"""Materials as real programs write them: nothing is lost without a word, and any name is written."""

import dataclasses
import json
import logging

import numpy as np
import pytest
from exchange_formulas import fresh_points, shown, three_code, written_k_d
from hostile import glb

import diffshade as ds
from diffshade.exchange.metallic_roughness import surface_of
from diffshade.exchange.reference import differences, radiance, reference


@pytest.fixture
def read(tmp_path, caplog):
    """Read the materials of a text, and what is said of them."""

    def of(name, text):
        (tmp_path / name).write_bytes(text if isinstance(text, bytes) else text.encode())
        caplog.clear()
        with caplog.at_level(logging.WARNING):
            found = ds.exchange.read_materials(tmp_path / name)
        return found, caplog.text.replace(f"{tmp_path}/", "")

    return of


SAID = {
    "unknown keys": ("Kx 3\nfoo", "unknown keys are not read: 'Kx', 'foo'."),
    "maps": ("map_Kd a.png\nnorm b.png", "texture maps are not read, only colours: 'map_Kd', 'norm'."),
    "classic beside PBR": ("Ks 1 1 1\nNs 9\nPr .5\nPm 0", "Pr and Pm describe the surface for PBR programs; Ks and Ns"),
    "brushing": ("aniso 0.5", "aniso, brushing, is not modelled."),
    "a mirror": ("Ks 1 1 1\nillum 3", "illum 3 mirrors what surrounds it, which is not modelled; its other terms"),
    "no such illum": ("illum 12", "illum 12 is no illumination model, 0 to 10; it is read as 2."),
    "clear and opaque": ("Tr 1\nillum 2", "Tr 1 with the opaque illum 2 is read as opaque"),
    "dissolved and opaque": ("d 0\nillum 2", "d 0 with the opaque illum 2 is read as opaque"),
    "a filter of nothing": ("Tf 0.4 0.4 0.4\nillum 2", "Tf filters what passes through, and by d and Tr nothing does"),
    "a contradiction": ("d 0.5\nTr 0.2", "Tr 0.2 contradicts d 0.5; d is read."),
    "halo": ("d -halo 0.5", "-halo makes the middle of a surface clearer"),
    "a clamped exponent": ("Ns -1.960784", "Ns -1.96078 is below 0; it is read as 0, as programs clamp it."),
    "no index": ("Ni 0", "Ni 0 is no index of refraction, 0.1 to 10; it is not read."),
}


@pytest.mark.parametrize("case", SAID)
def test_what_an_mtl_loses_is_said_in_one_line(case, read):
    rows, sentence = SAID[case]
    found, said = read("a.mtl", f"newmtl a\nKd 1 1 1\n{rows}\n")
    assert sentence in said
    assert len([line for line in said.splitlines() if "a.mtl" in line]) == 1
    k_t = {"halo": 0.5, "a contradiction": 0.5}.get(case)
    np.testing.assert_array_equal(found["a"].k_t, k_t and [k_t] * 3)


def test_a_plain_mtl_is_read_without_a_word(read):
    blender = (
        "newmtl Material.003\nNs 250\nKa 0.8 0.1 0.1\nKd 0.8 0.1 0.1\nKs 0.5 0.5 0.5\nKe 0 0 0\nNi 1.45\nd 1\nillum 2\n"
    )
    found, said = read("a.mtl", blender)
    assert list(found) == ["Material.003"]
    assert said == ""


def test_what_blender_writes_of_ambient_light_is_no_glow_elsewhere(read, tmp_path):
    text = "# Blender 4.1.0 MTL File: 'None'\nnewmtl a\nKa 1.000000 1.000000 1.000000\nKd 0.8 0.2 0.1\nillum 1\n"
    found, said = read("a.mtl", text)
    assert not np.any(found["a"].k_a)
    assert "Ka 1 1 1 all the same; it is not read" in said
    ds.exchange.write_material(tmp_path / "a.json", found)
    assert json.loads((tmp_path / "a.json").read_text())["emissive"] == 0
    found, said = read("b.mtl", text.replace("Ka 1.000000", "Ka 0.5"))
    assert np.any(found["a"].k_a)
    assert not said


def test_white_ambient_light_of_every_colour_is_what_exporters_write(read, tmp_path):
    """Of white without a picture, or beside a map_Ka or another Ka, or in a file of ours, it may be meant."""
    red, blue = "newmtl a\nKa 1 1 1\nKd 0.8 0.2 0.1\nillum 1\n", "newmtl b\nKa 1.0 1.0 1.0\nKd 0 0 1\nillum 1\n"
    scanned = red.replace("0.8 0.2 0.1", "1 1 1") + "map_Kd scan.jpg\n"  # as photogrammetry writes it
    for text in (red, "# Maya\n" + red + blue, scanned):
        found, said = read("a.mtl", text)
        assert not any(np.any(material.k_a) for material in found.values())
        assert (
            "Ka 1 1 1 of every material, whatever its colour, is what exporters write that know no ambient light"
            in said
        )
    for text in (
        red.replace("0.8 0.2 0.1", "1 1 1"),
        scanned + "map_Ka scan.jpg\n",
        red + blue.replace("Ka 1.0", "Ka 0.5"),
        red + "newmtl c\nKd 1 0 0\n",
        "# written by diffshade\n" + red,
    ):
        found, said = read("b.mtl", text)
        np.testing.assert_array_equal(found["a"].k_a, [1.0] * 3)
        assert "Ka 1 1 1" not in said
    ds.exchange.write_material(tmp_path / "c.mtl", ds.Material(1.0, (0.8, 0.2, 0.1)))
    np.testing.assert_array_equal(ds.exchange.read_material(tmp_path / "c.mtl").k_a, [1.0] * 3)


def test_a_colour_that_is_not_given_is_said(read):
    found, said = read("a.mtl", "newmtl a\nmap_Kd a.png\nnewmtl b\nKs 1 1 1\nnewmtl c\nKd 0 0 0\n")
    assert [float(m.k_d[0]) for m in found.values()] == [1, 0, 0]
    assert "'a': map_Kd stands without Kd; it is read as 1, which the map multiplies." in said
    assert "'b': it has no Kd, for which each program has a grey of its own; it is read as 0." in said
    assert "'c'" not in said


def test_a_hash_within_a_name_is_no_comment(read):
    found, said = read("a.mtl", "newmtl <M#1> # one\nKd 1 0 0\t# red\nnewmtl <M#2>\nKd 0 1 0\n#newmtl c\n")
    assert list(found) == ["<M#1>", "<M#2>"]
    assert said == ""


def test_glass_that_lets_all_through_is_written_and_read(tmp_path):
    written = ds.exchange.write_material(
        tmp_path / "a.mtl", ds.Material(0.1, 0.2, 0.3, 10, ds.Blinn(), k_t=1.0, eta=1.5)
    )
    np.testing.assert_array_equal(ds.exchange.read_material(written.path).k_t, 1.0)


def test_what_most_programs_mean(read):
    found, said = read("a.mtl", "NEWMTL a\nKD 1 0 0\nnewmtl\nKd 0 1 0\nnewmtl a\nKd 0 0 1\n")
    np.testing.assert_array_equal([found["a"].k_d, found["material"].k_d], [(0, 0, 1), (0, 1, 0)])
    for sentence in ("'NEWMTL' is read as newmtl", "has no name; it is named 'material'", "defined more than once"):
        assert sentence in said


def test_one_bad_material_does_not_lose_a_file(read, tmp_path):
    rows = "\n".join(f"newmtl m{i}\nKd 0.5 0.5 {'x' if i == 7 else i / 40}" for i in range(40))
    found, said = read("a.mtl", rows)
    assert len(found) == 39
    assert "'m7': Kd must be a finite number; got 'x'. Correct the file. This material is left out." in said
    with pytest.raises(ValueError, match="'m7': Kd must be a finite number"):
        ds.exchange.read_material(tmp_path / "a.mtl", name="m7")
    assert float(ds.exchange.read_material(tmp_path / "a.mtl", name="m20").k_d[2]) == 0.5


def test_an_opacity_beyond_its_range_is_refused_by_its_key(read):
    found, said = read("a.mtl", "newmtl a\nKd 1 1 1\nnewmtl b\nd 1.5\nnewmtl c\nTr -0.1\n")
    assert list(found) == ["a"]
    assert "'b': d must be 0 to 1; got 1.5. Correct the file." in said
    assert "'c': Tr must be 0 to 1; got -0.1. Correct the file." in said


def test_one_sentence_is_said_once_of_many_materials(read):
    _, said = read("a.mtl", "\n".join(f"newmtl m{i}\nmap_Kd {i}.png" for i in range(40)))
    assert said.count("texture maps are not read") == 1
    assert "40 materials: texture maps" in said


NAMES = ("Material.003", "Wall-inner", "Terraindæk", "Terraindåk", "a b", "1st", "wood", "default", "x#y\n\u2028z")
CODE = {".c": "{}_material(", ".js": "const {} =", ".py": "def set_{}(", ".inc": "#declare {} ="}


@pytest.mark.thorough
@pytest.mark.parametrize("suffix", [".mtl", ".c", ".json", ".js", ".py", ".inc", ".gltf"])
def test_every_material_is_written_under_any_name(suffix, tmp_path):
    shine = 0.0 if suffix == ".gltf" else 0.2  # a matte material takes no fit
    many = {name: ds.Material(0, 0.1 + 0.08 * i, shine, 20, ds.Blinn()) for i, name in enumerate(NAMES)}
    written = ds.exchange.write_material(tmp_path / f"a{suffix}", many)
    text = written.path.read_text(encoding="utf-8")
    found = written_k_d(written.path)
    for (name, truth), (again, k_d) in zip(many.items(), found.items(), strict=True):
        np.testing.assert_allclose(k_d, truth.k_d, rtol=0.2, err_msg=name)
        if suffix in (".json", ".gltf"):
            assert again == name
        elif suffix in CODE:
            assert again.isidentifier()
            assert again.isascii()
            assert CODE[suffix].format(again) in text
        assert suffix in (".json", ".gltf") or name == again or f"is written as '{again}'" in text
    if suffix == ".mtl":
        assert list(found)[:3] == list(NAMES[:3])
        assert "a_b" in found
    if suffix in (".inc", ".js"):
        assert not {"wood", "default"} & set(found)


METAL = {"pbrMetallicRoughness": {"baseColorFactor": [0.9, 0.6, 0.3, 1], "metallicFactor": 1, "roughnessFactor": 0.4}}


def gltf(*materials):
    return json.dumps({"asset": {"version": "2.0"}, "materials": materials})


def test_gltf_and_glb_are_read(read):
    texture = {"name": "brick", "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "roughnessFactor": 0.9}}
    bad = {"name": "bad", "pbrMetallicRoughness": {"roughnessFactor": "rough"}}
    clear = {"alphaMode": "BLEND", "pbrMetallicRoughness": {"baseColorFactor": [1, 0.5, 0.5, 0.25]}}
    unlit = {"name": "unlit", "extensions": {"KHR_materials_unlit": {}, "KHR_materials_sheen": {}}}
    text = gltf({"name": "gold", **METAL}, texture, bad, clear, unlit)
    for name, data in (("a.gltf", text), ("a.glb", glb(text.encode()))):
        found, said = read(name, data)
        assert list(found) == ["gold", "brick", "material_3", "unlit"]
        assert "'bad': roughnessFactor must be a finite number; got" in said
        assert "'brick': texture maps are not read, only colours: 'baseColorTexture'." in said
        assert "'unlit': the extension 'KHR_materials_sheen' is not read." in said
        np.testing.assert_array_equal(found["material_3"].k_t, 0.75)
        np.testing.assert_array_equal(found["unlit"].k_e, 1)
        gold = np.asarray(found["gold"].k_s)
        np.testing.assert_allclose(gold[1:] / gold[0], [0.667, 0.333], rtol=0.1)
    np.testing.assert_array_equal(found["unlit"].k_d, 0)
    glowing, _ = read("a.gltf", gltf({"emissiveFactor": [1, 0.5, 0], **METAL}))
    np.testing.assert_array_equal(glowing["material_0"].k_e, (1, 0.5, 0))


def test_what_a_gltf_material_loses_is_said(read):
    sheen = {"KHR_materials_clearcoat": {"clearcoatFactor": 0.5, "clearcoatTint": 1}, "KHR_materials_unlit": {}}
    strange = {"name": "a", "pbrMetallicRoughness": {"roughnesFactor": 1}, "extensions": sheen, "colour": [1, 0, 0]}
    glowing = {"name": "b", "extensions": {"KHR_materials_unlit": {}}, "emissiveFactor": [1, 1, 1]}
    found, said = read("a.gltf", gltf(strange, {"name": "c", "pbrMetallicRoughness": [1]}, 3, glowing))
    assert "'a': unknown keys are not read: 'colour', 'roughnesFactor', 'clearcoatTint'." in said
    assert "'c': pbrMetallicRoughness must be a table; got '[1]'. Correct the file. This material is left out." in said
    assert "'material_2': material must be a table; got '3'. Correct the file." in said
    np.testing.assert_array_equal(found["b"].k_e, 1)


def test_two_highlights_stand_for_one_that_phong_cannot_show(read):
    shiny = {"pbrMetallicRoughness": {"metallicFactor": 0, "roughnessFactor": 0.2}}
    found, said = read("a.gltf", gltf({"name": "shiny", **shiny}, {"name": "rough", "pbrMetallicRoughness": {}}))
    assert len(found["shiny"].highlights) == 1
    assert "and 1 further highlight" in said
    assert float(found["shiny"].n_s) < float(found["shiny"].highlights[0].n_s)


JSON = {
    "metadata": {"version": 4.5, "type": "Object"},
    "materials": [
        {
            "uuid": "1",
            "type": "MeshStandardMaterial",
            "name": "steel",
            "color": 11184810,
            "metalness": 1,
            "roughness": 0.3,
        },
        {"uuid": "2", "type": "MeshLambertMaterial", "name": "wall", "color": "#667eea", "map": "x", "blending": 2},
        {"uuid": "3", "type": "MeshBasicMaterial", "color": [1, 0.5, 0]},
        {"uuid": "4", "type": "MeshPhongMaterial", "name": "glass", "opacity": 0.5, "transparent": False, "sheen": 1},
        {"uuid": "5", "type": "ShaderMaterial", "name": "own"},
        {
            "uuid": "6",
            "type": "MeshPhysicalMaterial",
            "name": "car",
            "clearcoat": 1,
            "roughness": 0.6,
            "depthWrite": True,
        },
    ],
    "object": {"type": "Scene", "children": [{"type": "Mesh", "material": "1"}]},
}


def test_scenes_of_three_js_are_read(read):
    found, said = read("a.json", json.dumps(JSON))
    assert list(found) == ["steel", "wall", "3", "glass", "car"]
    np.testing.assert_allclose(found["wall"].k_d, [0.133, 0.209, 0.823], atol=1e-3)
    assert not np.any(found["wall"].k_s)
    np.testing.assert_array_equal(found["3"].k_e, (1, 0.5, 0))
    assert found["glass"].k_t is None
    assert "'wall': texture maps are not read, only colours: 'map'." in said
    assert "'glass': opacity 0.5 has no effect in three.js unless transparent is true; it is not read." in said
    assert "'glass': settings that are not read: 'sheen'." in said
    assert "'own': a ShaderMaterial is not read." in said
    assert "'wall': settings that are not read: 'blending'." in said
    assert "depthWrite" not in said


def test_a_matte_material_becomes_one_without_a_highlight(read, tmp_path):
    matte = ds.Material(0.1, (0.5, 0.25, 0.1), k_e=0.2)
    for suffix in (".json", ".js"):
        written = ds.exchange.write_material(tmp_path / f"a{suffix}", matte)
        assert "MeshLambertMaterial" in written.path.read_text()
        assert written.largest < (0.01 if suffix == ".json" else 1e-12)
        if suffix == ".js":
            (code,) = three_code(written.path.read_text()).values()
            assert "specular" not in code
            np.testing.assert_allclose(code["color"], matte.k_d, rtol=1e-12)
            continue
        again = ds.exchange.read_material(written.path)
        assert not np.any(again.k_s)
        np.testing.assert_allclose(again.k_d, matte.k_d, rtol=0.02)
    gltf = ds.exchange.write_material(tmp_path / "a.gltf", dataclasses.replace(matte, k_a=0))
    assert gltf.largest == 0
    assert (
        json.loads(gltf.path.read_text())["materials"][0]["extensions"]["KHR_materials_specular"]["specularFactor"] == 0
    )


def test_pbr_keys_of_an_mtl_are_refitted(read):
    found, said = read("a.mtl", "newmtl a\nKd 0.5 0.3 0.2\nPr 0.5\nPm 0.25\nPc 0.5\nPcr 0.1\n")
    points = reference(100.0)
    surface = surface_of(np.array([0.5, 0.3, 0.2]), 0.25, 0.5, coat=0.5, coat_roughness=0.1)
    rms, _ = differences(surface.reflected(points), radiance(found["a"], points))
    assert rms < 3
    assert "the surface of roughness 0.5 and metalness 0.25 becomes" in said


def random_materials(count):
    rng = np.random.default_rng(0)
    for i in range(count):
        lobe = (ds.Phong(), ds.Blinn())[i % 2]
        n_s, k_s = float(np.exp(rng.uniform(0, 6))), rng.uniform(0, 0.6, 3 if i % 3 else 1) * np.ones(3)
        yield ds.Material(rng.uniform(0, 0.2, 3), rng.uniform(0, 0.9, 3), k_s, n_s, lobe)


FORMATS = [".mtl", ".c", ".py", ".inc", ".js", ".json", ".gltf"]


@pytest.mark.thorough
@pytest.mark.parametrize("suffix", FORMATS)
@pytest.mark.parametrize("count", [3, pytest.param(100, marks=pytest.mark.slow)])
def test_stated_errors_are_those_of_other_points(suffix, count, tmp_path):
    """The program's own formula, from what the file holds, over points drawn at random around each reference."""
    ratios = []
    for material in random_materials(count):
        written = ds.exchange.write_material(tmp_path / f"a{suffix}", material)
        points = fresh_points(material)
        rms, largest = differences(radiance(material, points), shown(written.path, points))
        if written.rms == 0:
            assert largest < 1e-9
        else:
            ratios.append((rms / written.rms, largest / written.largest))
    assert (np.abs(np.array(ratios)[:, 0] - 1) < 0.15).all()
    assert (np.array(ratios)[:, 1] < 1.3).all()


@pytest.mark.parametrize("count", [2, pytest.param(100, marks=pytest.mark.slow)])
def test_stated_errors_of_what_is_read_are_those_of_other_points(count, read):
    rng, rows = np.random.default_rng(1), {}
    for i in range(count):
        base = [*map(float, rng.uniform(0, 1, 3)), 1]
        pbr = {
            "baseColorFactor": base,
            "metallicFactor": float(rng.integers(0, 2)),
            "roughnessFactor": rng.uniform(0.15, 1),
        }
        rows[f"m{i}"] = pbr
    found, said = read("a.gltf", gltf(*({"name": name, "pbrMetallicRoughness": pbr} for name, pbr in rows.items())))
    for line in said.splitlines():
        name = line.split("'")[1]
        pbr, stated = rows[name], float(line.split("differs by ")[1].split()[0])
        surface = surface_of(np.array(pbr["baseColorFactor"][:3]), pbr["metallicFactor"], pbr["roughnessFactor"])
        points = fresh_points(ds.Material(n_s=min(2 / pbr["roughnessFactor"] ** 4, 1e5), lobe=ds.Blinn()))
        rms, _ = differences(surface.reflected(points), radiance(found[name], points))
        assert 0.8 < rms / stated < 1.2
