"""Materials in the files of other programs: what keeps its meaning, what is refitted, and what is said of it."""

import dataclasses
import json
import logging
import re

import jax
import numpy as np
import own_parts
import pytest
from exchange_formulas import gl_calls, three_code, written_materials

import diffshade as ds
from diffshade.exchange import threejs
from diffshade.exchange.metallic_roughness import MetallicRoughness, ggx, kept
from diffshade.exchange.reference import Reference, differences, radiance, reference, reference_of
from diffshade.exchange.threejs import from_hex, to_hex

PHONG = ds.Material((0.1, 0.05, 0.02), (0.7, 0.25, 0.2), 0.4, 40, k_e=(0, 0.1, 0))
BLINN = dataclasses.replace(PHONG, lobe=ds.Blinn(), n_s=77.3, k_s=(0.3, 0.5, 0.1))
GREY_BLINN = dataclasses.replace(BLINN, k_s=0.31)
UNLIT = dataclasses.replace(PHONG, k_e=0)
GLASS = {"k_t": 0.7, "eta": 1.5}
SAME = {
    "mtl": (".mtl", BLINN),
    "mtl, sharp": (".mtl", dataclasses.replace(BLINN, n_s=1000)),
    "mtl, flat": (".mtl", dataclasses.replace(BLINN, n_s=0)),
    "mtl, matte": (".mtl", ds.Material(0.1, 0.5, lobe=ds.Blinn())),
    "mtl, glass": (".mtl", dataclasses.replace(BLINN, **GLASS)),
    "mtl, coloured glass": (".mtl", dataclasses.replace(BLINN, k_t=(0.7, 0.35, 0), eta=1.3)),
    "opengl": (".c", BLINN),
    "opengl, clear": (".c", dataclasses.replace(BLINN, k_t=0.25)),
    "vtk": (".py", UNLIT),
    "vtk, clear": (".py", dataclasses.replace(UNLIT, k_t=0.25)),
    "povray, phong": (".inc", PHONG),
    "povray, blinn": (".inc", GREY_BLINN),
    "povray, no diffuse": (".inc", dataclasses.replace(PHONG, k_d=0)),
    "povray, glass": (".inc", dataclasses.replace(GREY_BLINN, **GLASS)),
}


def assert_same(one, other, tolerance=1e-6):
    assert type(one.lobe) is type(other.lobe)
    for name in ("k_a", "k_d", "k_s", "k_e", "n_s", "k_t", "eta"):
        a, b = getattr(one, name), getattr(other, name)
        if a is None or b is None:
            assert a is b, name
        else:
            np.testing.assert_allclose(a, b, rtol=tolerance, atol=tolerance, err_msg=name)


@pytest.mark.parametrize("case", SAME)
def test_formats_of_the_same_lobe_keep_a_material(case, tmp_path):
    suffix, material = SAME[case]
    written = ds.exchange.write_material(tmp_path / f"ball{suffix}", material)
    assert (written.rms, written.largest) == (0, 0)
    assert "written exactly" in str(written)
    (found,) = written_materials(written.path).values()
    if not np.any(material.k_s):  # MTL says illum 1, and no exponent then matters
        material = dataclasses.replace(material, n_s=found.n_s)
    assert_same(found, material)


REFITTED = {
    "mtl": (".mtl", PHONG),
    "mtl, sharp": (".mtl", dataclasses.replace(BLINN, n_s=3000)),
    "opengl": (".c", PHONG),
    "vtk": (".py", dataclasses.replace(BLINN, k_e=0)),
    "vtk, bright": (".py", dataclasses.replace(UNLIT, k_s=1.3, k_d=1.2, n_s=300)),
    "povray, coloured": (".inc", dataclasses.replace(PHONG, k_s=(0.4, 0.2, 0.3))),
    "three.js": (".js", BLINN),
    "three.js, bytes": (".json", BLINN),
}


@pytest.mark.parametrize("case", REFITTED)
def test_what_is_refitted_states_its_error(case, tmp_path, caplog):
    suffix, material = REFITTED[case]
    written = ds.exchange.write_material(tmp_path / f"ball{suffix}", material)
    assert 0 < written.rms < written.largest
    stated = re.search(r"the radiance differs by ([\d.e-]+) \(rms\) and ([\d.e-]+) \(at most\)", str(written))
    assert stated
    np.testing.assert_allclose([float(x) for x in stated.groups()], [written.rms, written.largest], rtol=0.05)
    assert stated.group() in written.path.read_text()
    if suffix in (".mtl", ".c", ".py"):  # what was written is of this library's own lobes
        (found,), points = written_materials(written.path).values(), reference_of(material)
        again = differences(radiance(material, points), radiance(found, points))
        np.testing.assert_allclose(again, [written.rms, written.largest], rtol=1e-6)
    glow = np.asarray(material.k_e) + np.asarray(material.k_a)
    if suffix == ".json":
        with caplog.at_level(logging.WARNING):
            found = ds.exchange.read_material(written.path)
        assert "MeshPhongMaterial is refitted as Blinn" in caplog.text
        np.testing.assert_allclose(np.asarray(found.k_s) / np.asarray(material.k_s), 1, atol=0.05)
        np.testing.assert_allclose(found.k_e, glow, atol=3e-3)
    if suffix == ".js":
        (code,) = three_code(written.path.read_text()).values()
        np.testing.assert_allclose(code["emissive"], glow, rtol=1e-6)
        np.testing.assert_allclose(code["color"], material.k_d, rtol=1e-6)


@pytest.mark.parametrize("n_s", [0.5, 50, *(pytest.param(n, marks=pytest.mark.thorough) for n in (3, 27, 1000))])
def test_phong_becomes_blinn_and_back(n_s):
    """About 4 n_s, less where the highlight is wide; the way back finds the exponent again."""
    phong = ds.Material(0.1, 0.5, (0.8, 0.4, 0.2), n_s)
    blinn = ds.exchange.with_lobe(phong, ds.Blinn())
    assert isinstance(blinn.material.lobe, ds.Blinn)
    assert 3.5 * n_s < blinn.material.n_s < (4.3 * n_s if n_s > 1 else 9 * n_s)
    np.testing.assert_allclose(np.asarray(blinn.material.k_s) / np.asarray(phong.k_s), blinn.material.k_s[0] / 0.8)
    back = ds.exchange.with_lobe(blinn.material, ds.Phong())
    np.testing.assert_allclose(back.material.n_s, n_s, rtol=0.02 if n_s > 1 else 0.6)
    assert 0 < blinn.rms < blinn.largest
    assert str(blinn).startswith(f"the highlight, Phong with n_s {n_s:g}, becomes Blinn with n_s")
    points = reference_of(phong)  # and there is no better one
    m = blinn.material
    for of_n, of_k in ((1.01, 1.0), (0.99, 1.0), (1.0, 1.01), (1.0, 0.99)):
        other = dataclasses.replace(m, n_s=m.n_s * of_n, k_s=m.k_s * of_k)
        assert differences(radiance(phong, points), radiance(other, points))[0] > blinn.rms


def test_what_is_within_the_limits_is_left_alone_and_what_is_not_is_refitted():
    refit = ds.exchange.with_lobe(PHONG, ds.Phong(), highest_n_s=40, highest_k=0.7)
    assert (refit.rms, refit.largest, str(refit)) == (0, 0, "the highlight is unchanged.")
    assert_same(refit.material, PHONG, 0)
    same = ds.exchange.with_lobe(dataclasses.replace(PHONG, n_s=(40, 40, 40)), ds.Phong())
    assert float(same.material.n_s) == 40
    schlick = ds.exchange.with_lobe(ds.Material(0, 0.4, 0.04, 60, fresnel=ds.Schlick()), ds.Phong())
    assert isinstance(schlick.material.fresnel, ds.NoFresnel)
    assert "Schlick's weight" in str(schlick)
    assert 0 < schlick.rms < 1e-3
    tinted = ds.exchange.with_lobe(dataclasses.replace(PHONG, n_s=(20, 40, 80)), ds.Phong())
    assert 20 < float(tinted.material.n_s) < 80
    assert "n_s 20, 40, 80" in str(tinted)
    for limits in ({"highest_n_s": 39}, {"highest_k": 0.69}):
        less = ds.exchange.with_lobe(PHONG, ds.Phong(), **limits)
        assert less.material.n_s <= limits.get("highest_n_s", 1e5)
        assert np.max(less.material.k_d) <= limits.get("highest_k", 1)
        assert less.rms > 0


def test_the_reference_is_what_the_library_renders():
    points = reference(40.0)
    assert (points.n_v > 0).all()
    np.testing.assert_allclose(np.linalg.norm(points.n, axis=-1), 1)
    light = points.l[-1]
    n = points.n[(points.l == light).all(-1)][None]
    scene = ds.Scene(ds.Object(ds.GBuffer(n), dataclasses.replace(PHONG, k_e=0)), ds.DirectionalLight(-light), 0)
    camera = ds.OrthographicCamera((0, 0, 4), shape=n.shape[:2], height=2, local_viewer=False)
    with jax.enable_x64(True):
        image = np.asarray(ds.render(scene, camera))[0]
    np.testing.assert_allclose(radiance(PHONG, points)[(points.l == light).all(-1)], image, atol=1e-12)
    wide = reference(0.0)  # twice 256 normals evenly over a half sphere, of which all are seen
    np.testing.assert_allclose(np.sort(wide.n_h[:512]), np.repeat((np.arange(256) + 0.5) / 256, 2), atol=1e-12)
    assert 512 * 3 < len(wide.n) < 512 * 5


def test_ggx_keeps_light():
    """Of a nearly smooth surface all, of a rough one less, and no more than all."""
    n_v = np.linspace(0.1, 1, 10)
    np.testing.assert_allclose(kept(n_v, 0.05**2), 1, atol=0.01)
    rough = kept(n_v, 1.0)
    assert (rough < 1).all()
    assert (rough > 0.3).all()
    flat = MetallicRoughness(1.0, np.full(3, 0.5), np.zeros(3), 0.0)
    points = reference(10.0)
    np.testing.assert_allclose(flat.reflected(points), 0.5 * points.n_l[:, None] * np.ones(3))
    assert np.isfinite(ggx(points, 0.05**2)).all()
    i = np.arange(20_000)  # directions to the light evenly over a sphere: the integral itself
    z, turn = 1 - (2 * i + 1) / len(i), np.pi * (3 - np.sqrt(5)) * i
    l = np.stack([np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z], -1)
    for cosine, alpha in ((0.3, 0.5), (0.8, 0.5), (0.6, 1.0)):
        around = Reference(np.broadcast_to([np.sqrt(1 - cosine**2), 0, cosine], l.shape), l)
        lit = around.n_l > 0
        expected = 4 * np.mean(np.where(lit, ggx(around, alpha) * around.n_l, 0.0))
        np.testing.assert_allclose(kept(np.array([cosine]), alpha), expected, rtol=0.01)


def test_vtk_says_what_its_ambient_term_loses(tmp_path):
    written = ds.exchange.write_material(
        tmp_path / "a.py", dataclasses.replace(UNLIT, k_a=(0.8, 0.5, 0.1), k_e=(0.5, 0.1, 0))
    )
    assert "VTK clamps the ambient term at 1" in str(written)
    assert "k_e is added to k_a" in str(written)
    np.testing.assert_allclose([written.rms, written.largest], [0.3 / np.sqrt(3), 0.3], rtol=1e-12)
    (found,) = written_materials(written.path).values()
    np.testing.assert_allclose(found.k_a, (1, 0.6, 0.1), rtol=1e-12)


def test_several_materials_in_one_mtl(tmp_path):
    many = {"gold": ds.material("gold"), "emerald": ds.material("emerald"), "ball.1": PHONG}
    written = ds.exchange.write_material(tmp_path / "a.mtl", many)
    assert [note.split(":")[0] for note in written.notes] == ["ball.1"]
    found = ds.exchange.read_materials(tmp_path / "a.mtl")
    assert list(found) == list(many)
    assert_same(found["gold"], many["gold"])
    assert_same(ds.exchange.read_material(tmp_path / "a.mtl", name="emerald"), many["emerald"])
    with pytest.raises(ValueError, match=r"has no material 'emrald'\. Did you mean 'emerald'\?"):
        ds.exchange.read_material(tmp_path / "a.mtl", name="emrald")
    with pytest.raises(ValueError, match=r"holds 3 materials\. Name one, for example name='gold'"):
        ds.exchange.read_material(tmp_path / "a.mtl")


def test_an_mtl_by_hand(tmp_path, caplog):
    text = (
        "# by hand\r\nnewmtl a b\n\tKd 0.5\nKs 1 1 1 \\\n\nNs 5e1 # wide\nillum 1\nTr 0.25\nmap_Kd ../../etc/passwd\n"
    )
    (tmp_path / "a.mtl").write_text(text + "newmtl flat\nillum 0\nKd 1 0 0\nd -halo 1\nTf 1 1 1\n")
    with caplog.at_level(logging.WARNING):
        found = ds.exchange.read_materials(tmp_path / "a.mtl")
    assert "'a b': texture maps are not read, only colours: 'map_Kd'." in caplog.text
    assert "'a b': illum 1 has no highlight; Ks is not read." in caplog.text
    assert "'flat': -halo makes the middle of a surface clearer" in caplog.text
    assert_same(found["a b"], ds.Material(0, 0.5, 0, 50, ds.Blinn(), k_t=0.25))
    assert_same(found["flat"], ds.Material(n_s=10, lobe=ds.Blinn(), k_e=(1, 0, 0)))


LIGHTS = (
    ds.PointLight((2, 3, 4), (6, 5, 4), ds.RadialAttenuation(1, 0.1, 0.05)),
    ds.DirectionalLight((1, -2, -2), 0.3),
    ds.SpotLight((-1, 1, 3), (0.3, -0.4, -1), (3, 2, 4), 25, 6, ds.RadialAttenuation(0.5, 0.2, 0.1)),
    ds.PointLight((0, 1, 2), 0.5, ambient=(0.1, 0.2, 0.3), specular=(1, 0, 0.25)),
)


# what OpenGL is told of each, besides what it is told of none
CALLS = (
    {"POSITION": (2, 3, 4, 1), "DIFFUSE": (6, 5, 4, 1), "LINEAR_ATTENUATION": 0.1, "QUADRATIC_ATTENUATION": 0.05},
    {"POSITION": (-1 / 3, 2 / 3, 2 / 3, 0), "DIFFUSE": (0.3, 0.3, 0.3, 1)},
    {"POSITION": (-1, 1, 3, 1), "DIFFUSE": (3, 2, 4, 1), "SPOT_DIRECTION": (0.3, -0.4, -1), "SPOT_CUTOFF": 25}
    | {"SPOT_EXPONENT": 6, "CONSTANT_ATTENUATION": 0.5, "LINEAR_ATTENUATION": 0.2, "QUADRATIC_ATTENUATION": 0.1},
    {"POSITION": (0, 1, 2, 1), "DIFFUSE": (0.5, 0.5, 0.5, 1)}
    | {"AMBIENT": (0.1, 0.2, 0.3, 1), "SPECULAR": (1, 0, 0.25, 1)},
)


def test_opengl_is_told_all_of_a_light(tmp_path):
    ds.exchange.write_material(tmp_path / "a.c", BLINN, lights=LIGHTS)
    text = (tmp_path / "a.c").read_text()
    told = gl_calls(text, "Light")
    assert list(told) == [f"LIGHT{i}" for i in range(4)]
    for i, expected in enumerate(CALLS):
        usual = {"AMBIENT": (0, 0, 0, 1), "SPECULAR": expected["DIFFUSE"]}
        if i != 1:
            usual |= {"CONSTANT_ATTENUATION": 1, "LINEAR_ATTENUATION": 0, "QUADRATIC_ATTENUATION": 0}
        assert told[f"LIGHT{i}"].keys() == {**usual, **expected}.keys()
        for key, numbers in {**usual, **expected}.items():
            np.testing.assert_allclose(told[f"LIGHT{i}"][key], np.ravel(numbers), rtol=1e-6, err_msg=f"{i} {key}")
        assert f"glEnable(GL_LIGHT{i});" in text


LOST = {
    ".c": "OpenGL does not refract light: eta 1.5 is not written.",
    ".py": "VTK does not refract light: eta 1.5 is not written.",
    ".js": "MeshPhongMaterial has one opacity for all colours: k_t (0.9, 0.6, 0.3) is written as its mean.",
    ".gltf": "glTF has no ambient reflection: k_a (0.1, 0.05, 0.02) is not written.",
    ".inc": "the mean of k_t is written.",
}


@pytest.mark.parametrize("suffix", LOST)
def test_what_is_lost_is_said(suffix, tmp_path):
    glass = dataclasses.replace(PHONG, k_e=0, k_t=(0.9, 0.6, 0.3), eta=1.5)
    written = ds.exchange.write_material(tmp_path / f"a{suffix}", glass, lights=LIGHTS)
    assert LOST[suffix] in str(written)
    assert LOST[suffix] in written.path.read_text().replace("\\n", " ")
    if suffix != ".c":
        assert "the lights and their attenuation" in str(written)


def test_opengl_says_what_of_a_light_it_lacks(tmp_path):
    fades = ds.RadialAttenuation(0, 0, 1, clamp=True)
    spot = ds.SpotLight((0, 0, 1), (0, 0, -1), 1, 30, 200, fades, softness=10, flaps=ds.Flaps(x_min=0))
    said = str(ds.exchange.write_material(tmp_path / "a.c", BLINN, lights=spot))
    assert "OpenGL does not clamp attenuation at 1, as lights[0] does." in said
    assert "softness of lights[0] is not written" in said
    assert "OpenGL has no flaps: those of lights[0] are not written." in said
    assert "the exponent of lights[0], 200, is written as 128" in said
    absorbed = ds.PointLight((0, 0, 1), attenuation=own_parts.HazyAttenuation(0.2))
    with pytest.raises(ValueError, match=r"no HazyAttenuation, as lights\[0\] has.*fit_falloff"):
        ds.exchange.write_material(tmp_path / "b.c", BLINN, lights=absorbed)
    assert not (tmp_path / "b.c").exists()


def test_gltf_is_what_the_specification_wants(tmp_path):
    written = ds.exchange.write_material(
        tmp_path / "a.gltf", dataclasses.replace(BLINN, k_e=2.0, k_t=0.25), name="ball"
    )
    document = json.loads(written.path.read_text())
    (found,) = document["materials"]
    assert document["asset"]["version"] == "2.0"
    assert set(document["extensionsUsed"]) == {"KHR_materials_specular", "KHR_materials_emissive_strength"}
    assert found["name"] == "ball"
    assert found["alphaMode"] == "BLEND"
    pbr, specular = found["pbrMetallicRoughness"], found["extensions"]["KHR_materials_specular"]
    assert all(0 <= x <= 1 for x in (*pbr["baseColorFactor"], pbr["roughnessFactor"], specular["specularFactor"]))
    assert pbr["baseColorFactor"][3] == 0.75
    assert found["emissiveFactor"] == [1, 1, 1]
    points = reference_of(BLINN)
    head_on = np.minimum(0.04 * np.array(specular["specularColorFactor"]), 1) * specular["specularFactor"]
    edge = specular["specularFactor"]
    surface = MetallicRoughness(pbr["roughnessFactor"], np.array(pbr["baseColorFactor"][:3]), head_on, edge)
    np.testing.assert_allclose(
        differences(radiance(BLINN, points), surface.reflected(points)), [written.rms, written.largest], rtol=1e-9
    )


def test_bytes_of_a_colour():
    assert to_hex(np.array([1.0, 0.0, 0.5])) == 0xFF00BC
    assert to_hex(np.array([2.0, -1.0, 0.0])) == 0xFF0000
    assert to_hex(from_hex(0x123456)) == 0x123456


AREA, CHEQUERED = ds.AreaLight((0, 0, 1), (1, 0, 0), (0, 1, 0)), ds.Material(k_d=ds.Chequer(0.1, 0.9))
WRONG = [
    ("a.obj", PHONG, {}, "'.obj' is not the suffix of a material format. Use one of .mtl, .c,"),
    ("a.c", PHONG, {"name": " "}, "a material's name must be a word; got ' '."),
    ("a.mtl", {}, {}, "needs at least one material; got none."),
    ("a.mtl", {"a": ds.Sphere()}, {}, "the material 'a' must be a Material; got Sphere"),
    ("a.c", PHONG, {"lights": LIGHTS[:3] * 3}, "OpenGL has 8 lights; got 9."),
    ("a.c", PHONG, {"lights": AREA}, "OpenGL has no AreaLight; got one as lights[0]."),
    *((f"a{of}", CHEQUERED, {}, "a material file holds colours; got a Chequer.") for of in (".mtl", ".gltf", ".js")),
]


@pytest.mark.parametrize(("file", "material", "options", "message"), WRONG)
def test_nothing_is_written_where_something_is_wrong(tmp_path, file, material, options, message):
    with pytest.raises((ValueError, TypeError), match=re.escape(message)) as caught:
        ds.exchange.write_material(tmp_path / file, material, **options)
    assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


BAD = [
    ("a.mtl", "Kd 1 1 1", "has no newmtl line, hence no material."),
    ("a.mtl", "newmtl a\nKd spectral /etc/passwd 1", "Spectral files and CIE XYZ are not read; write RGB."),
    ("a.mtl", "newmtl a\nKd 1 nan 1", "'a': Kd must be a finite number; got 'nan'."),
    ("a.mtl", "newmtl a\nKd 1 -1 1", "'a': Material.k_d must be at least 0; got (1, -1, 1)."),
    ("a.mtl", "newmtl a\nNs", "'a': Ns must be a finite number; got ''."),
    ("a.mtl", "newmtl a\nKd 1 1", "'a': Kd must be one number or three; got '1 1'."),
    ("a.json", "{", "is not JSON: "),
    ("a.json", "[]", "holds no material of three.js."),
    (
        "a.json",
        '{"type": "MeshPhongMaterial", "color": -1}',
        "color must be a colour, 0 to 16777215, '#rrggbb' or three numbers; got '-1'.",
    ),
    ("a.json", '{"type": "MeshPhongMaterial", "shininess": NaN}', "shininess must be a finite number; got 'nan'."),
    ("a.json", '{"type": "MeshPhongMaterial", "shininess": -1}', "shininess must be at least 0; got -1."),
    *(
        (f"a{of}", "", f"no material can be read from '{of}'. Use one of .mtl, .json, .gltf, .glb, .toml.")
        for of in (".txt", ".c", ".js", ".py", ".inc")
    ),
    ("a.gltf", "{}", "is not glTF 2.0; its asset has the version 'None'."),
    ("a.gltf", '{"asset": {"version": "2.0"}}', "has no materials."),
    ("a.glb", "glTF but no binary one", "is not binary glTF 2.0"),
]


@pytest.mark.parametrize(("file", "text", "message"), BAD)
def test_a_bad_file_is_refused_in_one_sentence(file, text, message, tmp_path):
    (tmp_path / file).write_text(text)
    with pytest.raises(ValueError, match=re.escape(message)) as caught:
        ds.exchange.read_material(tmp_path / file)
    assert "\n" not in str(caught.value)


def test_the_highlights_of_three_js_are_those_of_its_shader():
    """BRDF_BlinnPhong of three.js, with Schlick's weight as its F_Schlick has it, under a light of pi."""
    points, n, specular = reference(20.0), 20.0, np.array([0.7, 0.2, 0.0])
    weight = 2.0 ** ((-5.55473 * points.v_h - 6.98316) * points.v_h)
    F = specular * (1.0 - weight)[:, None] + weight[:, None]
    expected = F * (0.25 * (0.5 * n + 1.0) * points.n_h**n * points.n_l)[:, None]
    np.testing.assert_allclose(threejs.highlights(points).of(n, specular), expected, rtol=1e-12)


def test_a_shininess_below_1_is_read(tmp_path):
    (tmp_path / "a.json").write_text('{"type": "MeshPhongMaterial", "color": 255, "specular": 65793, "shininess": 0.5}')
    assert 0 < float(ds.exchange.read_material(tmp_path / "a.json").n_s) < 5


def test_povray_holds_a_highlight_of_each_lobe_and_other_formats_the_nearest_one(tmp_path):
    two = ds.Material(0.1, (0.5, 0.4, 0.3), 0.3, 20, highlights=ds.Highlight(0.2, 80, ds.Blinn()))
    exported = ds.exchange.write_material(tmp_path / "two.inc", two, name="two")
    assert exported.largest == 0
    assert "phong 0.3 phong_size 20.0 specular 0.2 roughness 0.0125" in exported.path.read_text()
    (again,) = written_materials(exported.path).values()
    (second,) = again.highlights
    assert (again.n_s, second.n_s) == (20, 80)
    assert (type(again.lobe), type(second.lobe)) == (ds.Phong, ds.Blinn)
    np.testing.assert_allclose(second.k_s, 0.2)
    for suffix, lobes in ((".mtl", (ds.Phong, ds.Blinn)), (".inc", (ds.Phong, ds.Phong))):
        alike = ds.Material(0.1, 0.4, 0.3, 20, lobes[0](), highlights=ds.Highlight(0.2, 80, lobes[1]()))
        nearest = ds.exchange.write_material(tmp_path / f"near{suffix}", alike, name="near")
        assert 0 < nearest.rms < nearest.largest
        assert "1 further highlight" in " ".join(nearest.notes)
        (one,) = written_materials(nearest.path).values()
        assert one.highlights == ()
