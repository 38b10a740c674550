"""What other programs compute from files of materials, by their documents, and points to compare at."""

import json
import re

import numpy as np

import diffshade as ds
from diffshade.exchange.hex_colours import from_hex
from diffshade.exchange.metallic_roughness import MetallicRoughness
from diffshade.exchange.povray import tint
from diffshade.exchange.reference import ANGLES, EDGE, Reference, radiance


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
    return radiance(ds.exchange.read_material(path), points)  # OpenGL, MTL and VTK compute this library's own terms


def _three(text, points, suffix):
    if suffix == ".json":
        found = json.loads(text)
        colour, specular = from_hex(found["color"]), from_hex(found["specular"])
        n = found["shininess"]
    else:
        colour, _, specular = (
            np.array([float(x) for x in inside.split(",")[:3]]) for inside in re.findall(r"setRGB\((.*?)\)", text)
        )
        n = float(re.findall(r"shininess: ([^,]+)", text)[0])
    weight = (2.0 ** ((-5.55473 * points.v_h - 6.98316) * points.v_h))[:, None]
    F = specular * (1.0 - weight) + weight
    return points.n_l[:, None] * (colour + F * (0.25 * (0.5 * n + 1.0) * points.n_h**n)[:, None])


def _povray(text, points):
    pigment = np.array([float(x) for x in re.findall(r"rgbt <([^>]*)>", text)[0].split(",")[:3]])

    def one(key):
        found = re.findall(rf"\b{key} ([\d.e+-]+)", text)
        return float(found[0]) if found else 0.0

    lobe = ds.Phong() if one("phong") else ds.Blinn()
    n_s = one("phong_size") if one("phong") else 1.0 / (one("roughness") or 1.0)
    shine = points.highlights(lobe)(n_s)[:, None] * (one("phong") + one("specular"))
    hue = tint(pigment, one("metallic"), points.n_l)
    return points.n_l[:, None] * one("diffuse") * pigment + shine * hue
