"""What other programs compute from written files of materials, by their documents, and points to compare at."""

import json
import re
from unittest.mock import MagicMock

import numpy as np

import diffshade as ds
from diffshade.exchange.metallic_roughness import MetallicRoughness
from diffshade.exchange.povray import tint
from diffshade.exchange.reference import ANGLES, EDGE, Reference, radiance
from diffshade.exchange.threejs import from_hex


def fresh_points(material, count=4096):
    """Points drawn at random as the reference spreads them: half over the highlight, half over the hemisphere."""
    rng = np.random.default_rng(5)
    n_s = float(np.min(material.n_s)) * (4.0 if isinstance(material.lobe, ds.Phong) else 1.0)
    normals, lights = [], []
    for angle in np.deg2rad(ANGLES):
        h = np.array([np.sin(angle / 2), 0.0, np.cos(angle / 2)])
        x, y = np.array([h[2], 0.0, -h[0]]), np.array([0.0, 1.0, 0.0])
        for least in (EDGE ** (1.0 / n_s) if n_s > 0 else 0.0, 0.0):
            cosine = 1.0 - (1.0 - least) * rng.random(count)
            sine, turn = np.sqrt(1.0 - cosine**2), 2 * np.pi * rng.random(count)
            n = cosine[:, None] * h + sine[:, None] * (np.cos(turn)[:, None] * x + np.sin(turn)[:, None] * y)
            l = np.broadcast_to([np.sin(angle), 0.0, np.cos(angle)], n.shape)
            seen = (n[:, 2] > EDGE) & (np.abs((n * l).sum(-1)) > EDGE)
            normals.append(n[seen])
            lights.append(l[seen])
    return Reference(np.concatenate(normals), np.concatenate(lights))


def shown(path, points):
    """Return the radiance that the file's program computes, without its ambient and emissive terms."""
    text = path.read_text()
    if path.suffix in (".js", ".json"):
        return _three(text, points, path.suffix)
    if path.suffix == ".gltf":
        row = json.loads(text)["materials"][0]
        pbr, specular = row["pbrMetallicRoughness"], row["extensions"]["KHR_materials_specular"]
        head_on = np.minimum(0.04 * np.array(specular.get("specularColorFactor", [1] * 3)), 1)
        head_on = head_on * specular["specularFactor"]
        base = np.array(pbr["baseColorFactor"][:3])
        return MetallicRoughness(pbr["roughnessFactor"], base, head_on, specular["specularFactor"]).reflected(points)
    if path.suffix == ".inc":
        return _povray(text, points)
    (material,) = written_materials(path).values()
    return radiance(material, points)  # OpenGL, MTL and VTK compute this library's own terms


def _three(text, points, suffix):
    if suffix == ".json":
        found = json.loads(text)
        colour, specular = from_hex(found["color"]), from_hex(found["specular"])
    else:
        (found,) = three_code(text).values()
        colour, specular = found["color"], found["specular"]
    weight = (2.0 ** ((-5.55473 * points.v_h - 6.98316) * points.v_h))[:, None]
    F, n = specular * (1.0 - weight) + weight, found["shininess"]
    return points.n_l[:, None] * (colour + F * (0.25 * (0.5 * n + 1.0) * points.n_h**n)[:, None])


def _povray(text, points):
    ((pigment, one, _),) = povray_textures(text).values()
    lobe = ds.Phong() if "phong" in one else ds.Blinn()
    n_s = one["phong_size"] if "phong" in one else 1.0 / one.get("roughness", 1.0)
    shine = points.highlights(lobe)(n_s)[:, None] * (one.get("phong", 0.0) + one.get("specular", 0.0))
    hue = tint(pigment[:3], one.get("metallic", 0.0), points.n_l)
    return points.n_l[:, None] * one["diffuse"] * pigment[:3] + shine * hue


def written_materials(path):
    """Return the materials that `write_material` wrote, by name; code is parsed as it alone writes it."""
    code = {".c": _of_opengl, ".py": _of_vtk, ".inc": _of_povray}.get(path.suffix)
    return code(path.read_text()) if code else ds.exchange.read_materials(path)


def written_k_d(path):
    """Return the diffuse colours that `write_material` wrote, by name."""
    if path.suffix == ".js":
        return {name: code["color"] for name, code in three_code(path.read_text()).items()}
    return {name: material.k_d for name, material in written_materials(path).items()}


def _of_opengl(text):
    found = {}
    for name, body in _named(r"static void (\w+)_material\(", text):
        at = gl_calls(body, "Material")["FRONT_AND_BACK"]
        (n_s,), alphas = at.pop("SHININESS"), {float(colour[3]) for colour in at.values()}
        (alpha,) = alphas
        k_a, k_d, k_s, k_e = (at[key][:3] for key in ("AMBIENT", "DIFFUSE", "SPECULAR", "EMISSION"))
        found[name] = ds.Material(k_a, k_d, k_s, n_s, ds.Blinn(), k_e=k_e, k_t=(1.0 - alpha) or None)
    return found


def _of_vtk(text):
    code, found = {}, {}
    exec(text, code)
    for word in [word for word in code if word.startswith("set_")]:
        property_ = MagicMock()
        code[word](property_)
        given = {name.removeprefix("Set"): np.array(values) for name, values, _ in property_.method_calls}
        assert "InterpolationToPhong" in given
        k_a, k_d, k_s = (given[term] * given[f"{term}Color"] for term in ("Ambient", "Diffuse", "Specular"))
        (n_s,), (opacity,) = given["SpecularPower"], given["Opacity"]
        found[word.removeprefix("set_")] = ds.Material(k_a, k_d, k_s, n_s, ds.Phong(), k_t=(1.0 - opacity) or None)
    return found


def _of_povray(text):
    """Of highlights without a tint."""
    found = {}
    for name, (pigment, one, (k_a, k_e)) in povray_textures(text).items():
        assert "metallic" not in one
        shine = [ds.Highlight(one["phong"], one["phong_size"], ds.Phong())] if "phong" in one else []
        shine += [ds.Highlight(one["specular"], 1 / one["roughness"], ds.Blinn())] if "specular" in one else []
        first, *others = shine or [ds.Highlight(0.0)]
        more = {"k_e": k_e * pigment[:3], "k_t": pigment[3] or None, "eta": one.get("ior"), "highlights": tuple(others)}
        k_d = one["diffuse"] * pigment[:3]
        found[name] = ds.Material(k_a * pigment[:3], k_d, first.k_s, first.n_s, first.lobe, **more)
    return found


def povray_textures(text):
    """Return the pigment of each texture, with transmit, its single numbers, and its ambient and emission."""
    interiors = dict(re.findall(r"#declare (\w+)_interior = interior { (.*) }", text))
    found = {}
    for name, body in _named(r"#declare (\w+) = texture", text):
        single = re.findall(r"\b([a-z_]+) ([\d.e+-]+)", body.partition("#declare")[0] + interiors.get(name, ""))
        glow = [_numbers(inside) for inside in re.findall(r"rgb <([^>]*)>", body)]
        pigment = _numbers(re.findall(r"rgbt <([^>]*)>", body)[0])
        found[name] = pigment, {key: float(number) for key, number in single}, glow
    return found


def three_code(text):
    """Return the linear colours and the numbers of each material in code of three.js."""
    found = {}
    for name, body in _named(r"export const (\w+) = new", text):
        colours = re.findall(r"(\w+): new THREE.Color\(\).setRGB\((.*), THREE.LinearSRGBColorSpace\)", body)
        numbers = re.findall(r"^  (\w+): ([\d.e+-]+),$", body, re.MULTILINE)
        found[name] = {key: _numbers(of) for key, of in colours} | {key: float(of) for key, of in numbers}
    return found


def gl_calls(text, kind):
    """Return what calls of glMaterial or glLight set, by target and key."""
    found = {}
    for target, key, numbers in re.findall(rf"gl{kind}fv?\(GL_(\w+), GL_(\w+), (?:\(GLfloat\[\]\))?(.*)\);", text):
        found.setdefault(target, {})[key] = _numbers(numbers.strip("{}").replace("f", ""))
    return found


def _named(declared, text):
    """Return the names that lines of code declare, and the code after each."""
    _, *parts = re.split(f"^{declared}", text, flags=re.MULTILINE)
    return list(zip(parts[::2], parts[1::2], strict=True))


def _numbers(text):
    return np.array([float(word) for word in text.split(",")])
