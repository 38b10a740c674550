"""An independent oracle: the model E1-E14 in plain Python, one pixel, light and channel at a time.

Written from the equations of the design, not from the library, which it does not import. Scenes are plain dicts:
`{"objects": [{"type", ..., "material"}], "lights": [...], "ambient", "background", "atmosphere"}`; what is left out is
not there; angles are in degrees. A colour of a material is three numbers or the dict of a chequer.
"""

import math

import numpy as np


def dot(a, b):
    return sum(x * y for x, y in zip(a, b, strict=True))


def add(a, b, s=1.0):
    """a + s b"""
    return [x + s * y for x, y in zip(a, b, strict=True)]


def unit(a):
    length = math.sqrt(dot(a, a))
    return [x / length for x in a] if length > 0 else [0.0, 0.0, 0.0]


def cross(a, b):
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def power(x, n):
    """(x)_+^n: dark for x <= 0 even at n = 0."""
    return x**n if x > 0 else 0.0


def radial(light, d):
    """E2"""
    a0, a1, a2 = light.get("attenuation", (1, 0, 0))
    d = max(d, 1e-6)
    f = 1 / (a0 + a1 * d + a2 * d**2)
    return min(1.0, f) if light.get("clamp", False) else f


def cos_degrees(angle):
    return 0.0 if angle == 90 else math.cos(math.radians(angle))


def angular(light, l):
    """E3"""
    if light["type"] != "spot":
        return 1.0
    cos_phi = -dot(l, unit(light["direction"]))
    cutoff, softness = light["cutoff"], light.get("softness", 0)
    edge = max(cos_degrees(cutoff), 0.0)
    if cos_phi < edge:
        return 0.0
    f = max(cos_phi, 0.0) ** light["exponent"]  # Python's 0 ** 0 is 1, as on the lit side
    if softness > 0:
        t = (cos_phi - edge) / (cos_degrees(cutoff - softness) - edge)
        t = min(max(t, 0.0), 1.0)
        f *= t * t * (3 - 2 * t)
    return f


def flaps(light, p):
    """E3: each flap that is given keeps the light on its side of a plane, faded over `softness` within it."""
    given, f = light.get("flaps", {}), 1.0
    width = given.get("softness", 0)
    for name, limit in given.items():
        if name == "softness":
            continue
        inside = p["xyz".index(name[0])] - limit
        inside = inside if name.endswith("min") else -inside
        if inside < 0:
            return 0.0
        t = min(inside / width, 1.0) if width > 0 else 1.0
        f *= t * t * (3 - 2 * t)
    return f


def emitters(light):
    """E11: an area light is a grid of spots at the centres of its cells, which share its intensity."""
    if light["type"] != "area":
        return [light]
    n_u, n_v = light["samples"]
    grid = []
    for i in range(n_u):
        for j in range(n_v):
            position = add(light["corner"], light["edge_u"], (i + 0.5) / n_u)
            spot = {
                "type": "spot",
                "position": add(position, light["edge_v"], (j + 0.5) / n_v),
                "direction": cross(light["edge_u"], light["edge_v"]),
                "intensity": [x / (n_u * n_v) for x in light["intensity"]],
                "cutoff": light.get("cutoff", 90),
                "exponent": light.get("exponent", 1),
                "attenuation": light.get("attenuation", (1, 0, 0)),
                "clamp": light.get("clamp", False),
                "flaps": light.get("flaps", {}),
            }
            grid.append(spot)
    return grid


def arriving(light, p):
    """Direction l to the light, and the factor f_rad f_ang, with that of the flaps."""
    if light["type"] == "directional":
        return unit([-x for x in light["direction"]]), 1.0
    to_light = add(light["position"], p, -1)
    l = unit(to_light)
    return l, radial(light, math.sqrt(dot(to_light, to_light))) * angular(light, l) * flaps(light, p)


def colour_at(colour, p):
    """A colour of a material at a point: a chequer changes over the surface."""
    if not isinstance(colour, dict):
        return colour
    x, y = (2 * math.pi * dot(p, colour.get(k, axis)) / colour["period"] for k, axis in AXES.items())
    wave = math.sin(x) * math.sin(y)
    share = (1 + wave) / 2 if colour.get("smooth", False) else float(wave > 0)
    return [share * a + (1 - share) * b for a, b in zip(colour["a"], colour["b"], strict=True)]


AXES = {"u": (1, 0, 0), "v": (0, 1, 0)}


def coefficients(material, p):
    """What a material is at a point, its patterns resolved; E10: Foley's colours O_d and O_s are factors."""
    at = dict(material)
    for name in ("k_a", "k_d", "k_s", "k_e", "k_t"):
        at[name] = colour_at(material.get(name) or (0, 0, 0), p)
    for name, colour in (("k_a", "O_d"), ("k_d", "O_d"), ("k_s", "O_s")):
        at[name] = [k * o for k, o in zip(at[name], material.get(colour, (1, 1, 1)), strict=True)]
    return at


def weight(material, c, cos_i):
    """E7: W of channel c where the light comes in at an angle of that cosine."""
    k_s, kind = material["k_s"][c], material.get("fresnel", "none")
    if kind == "none":
        return k_s
    if kind == "schlick":
        return k_s + (1 - k_s) * (1 - cos_i) ** 5
    eta = material["eta"]  # Snell's sine in the material, then Fresnel's two polarisations
    sin2_t = (1 - cos_i**2) / eta**2
    if sin2_t >= 1:
        return 1.0
    cos_t = math.sqrt(1 - sin2_t)
    r_s = (cos_i - eta * cos_t) / (cos_i + eta * cos_t)
    r_p = (eta * cos_i - cos_t) / (eta * cos_i + cos_t)
    return (r_s**2 + r_p**2) / 2


def highlight(material, n_s, n, l, v):
    """E5, E6: the factor of W."""
    n_l = dot(n, l)
    if n_l <= 0:
        return 0.0
    if material["lobe"] == "phong":
        r = [2 * n_l * n[i] - l[i] for i in range(3)]
        cosine = dot(v, r)
    else:
        cosine = dot(n, unit(add(l, v)))
    return power(cosine, n_s)


def point(scene, material, p, n, v):
    """E9: the colour of one point."""
    material = coefficients(material, p)
    colour = []
    for c in range(3):
        value = material["k_e"][c] + material["k_a"][c] * scene["ambient"][c]
        n_s = material["n_s"][c] if isinstance(material["n_s"], tuple) else material["n_s"]
        for light in scene["lights"]:
            for emitter in emitters(light):
                l, f = arriving(emitter, p)
                n_l = max(dot(n, l), 0.0)
                diffuse = material["k_d"][c] * n_l
                specular = weight(material, c, n_l) * highlight(material, n_s, n, l, v)
                value += f * emitter["intensity"][c] * (diffuse + specular)
        colour.append(value)
    return colour


def visibility(air, z):
    """E14: s at the distance z."""
    if air["type"] == "depth cueing":
        z_f, z_b, s_f, s_b = (air[name] for name in ("z_f", "z_b", "s_f", "s_b"))
        if z <= z_f:
            return s_f
        if z >= z_b:
            return s_b
        return s_f + (s_b - s_f) * (z - z_f) / (z_b - z_f)
    x = air["density"] * max(z, 0.0)
    return math.exp(-(x**2)) if air.get("squared", False) else math.exp(-x)


def fogged(scene, camera, colour, p):
    """E14: what is left of the colour of the point p after its way through the air to the eye."""
    air = scene.get("atmosphere")
    if air is None:
        return colour
    from_eye = add(p, camera["eye"], -1)
    z = -dot(from_eye, axes(camera)[2])
    if air.get("radial", False) and "fov" in camera:  # the rays of an orthographic camera are along its axis
        z = math.sqrt(dot(from_eye, from_eye))
    s = visibility(air, z)
    return [s * colour[c] + (1 - s) * air["I_dc"][c] for c in range(3)]


def axes(camera):
    backward = unit(add(camera["eye"], camera["target"], -1))
    right = unit(cross(camera["up"], backward))
    return right, cross(backward, right), backward


def viewer(camera, p):
    """E8"""
    return unit(add(camera["eye"], p, -1)) if camera["local_viewer"] else axes(camera)[2]


def ray(camera, row, column):
    """Origin and unit direction of the ray through the centre of a pixel."""
    height, width = camera["shape"]
    right, up, backward = axes(camera)
    # from -1 at the left and bottom border to 1 at the right and top one, the x axis in units of the half height
    x = (2 * (column + 0.5) / width - 1) * width / height
    y = 1 - 2 * (row + 0.5) / height
    if "fov" in camera:
        half = math.tan(math.radians(camera["fov"]) / 2)
        direction = add(add([-b for b in backward], right, x * half), up, y * half)
        return list(camera["eye"]), unit(direction)
    half = camera["height"] / 2
    return add(add(camera["eye"], right, x * half), up, y * half), [-b for b in backward]


def turned(a, degrees):
    """Turn a about the x, then the y, then the z axis, right-handed."""
    for axis, angle in enumerate(degrees):
        i, j = (axis + 1) % 3, (axis + 2) % 3
        cos, sin = math.cos(math.radians(angle)), math.sin(math.radians(angle))
        a = list(a)
        a[i], a[j] = cos * a[i] - sin * a[j], sin * a[i] + cos * a[j]
    return a


def crossings(item, origin, direction):
    """Every (t, outward normal) where the line origin + t direction goes through a surface, ahead or behind."""
    match item["type"]:
        case "sphere":
            o = add(origin, item["center"], -1)
            b, c = dot(o, direction), dot(o, o) - item["radius"] ** 2
            discriminant = b * b - c
            if discriminant <= 0:
                return []
            found = [-b - math.sqrt(discriminant), -b + math.sqrt(discriminant)]
            return [(t, unit(add(add(origin, direction, t), item["center"], -1))) for t in found]
        case "plane":
            n = unit(item["normal"])
            if dot(n, direction) == 0:
                return []
            return [(dot(add(item["point"], origin, -1), n) / dot(direction, n), n)]
        case _:  # box: each of the six faces is a rectangle
            faces = [turned(axis, item.get("rotation", (0, 0, 0))) for axis in ((1, 0, 0), (0, 1, 0), (0, 0, 1))]
            o = add(origin, item["center"], -1)
            found = []
            for i in range(3):
                for side in (1, -1):
                    n = [side * x for x in faces[i]]
                    if dot(n, direction) == 0:
                        continue
                    t = (item["size"][i] / 2 - dot(o, n)) / dot(direction, n)
                    p = add(o, direction, t)
                    if all(abs(dot(p, faces[j])) <= item["size"][j] / 2 for j in range(3) if j != i):
                        found.append((t, n))
            return found


def hit(item, origin, direction):
    """Distance to the first point of a surface in front of the origin, and the normal on the viewer's side; or None."""
    ahead = [(t, n) for t, n in crossings(item, origin, direction) if t > 0]
    if not ahead:
        return None
    t, n = min(ahead)
    return t, n if dot(n, direction) < 0 else [-x for x in n]


def leave(item, origin, direction):
    """Distance to the last point of a solid, and its outward normal."""
    return max(crossings(item, origin, direction))


def refract(direction, n, ratio):
    """E12: the direction after Snell's law, with n on the side the ray comes from; None at total reflection."""
    l = [-x for x in direction]
    cos_i = dot(n, l)
    sin2_r = ratio**2 * (1 - cos_i**2)
    if sin2_r >= 1:
        return None
    cos_r = math.sqrt(1 - sin2_r)
    return [(ratio * cos_i - cos_r) * n[i] - ratio * l[i] for i in range(3)]


def through(item, origin, direction, p, n):
    """E12: the ray inside a solid that it meets at p, and the ray that comes out of it, each (origin, direction).

    None where there is total internal reflection. The first is None for a ray that begins within the solid.
    """
    within = len([t for t, _ in crossings(item, origin, direction) if t > 0]) == 1
    if within:
        inside, q, outward = None, p, [-x for x in n]
        bent = direction
    else:
        bent = refract(direction, n, 1 / item["material"].get("eta", 1))
        if bent is None:
            return None
        t, outward = leave(item, p, bent)
        inside, q = (p, bent), add(p, bent, t)
    out = refract(bent, [-x for x in outward], item["material"].get("eta", 1))
    return None if out is None else (inside, (q, out))


def trace(scene, camera, origin, direction, met=frozenset(), solid=None):
    """E13: the colour that comes along a ray that has met some objects; each counts once, at its first hit.

    `solid`: (how far it goes on, the ray that it comes out as) of a ray within glass. What the glass holds is seen on
    the way; media do not nest: what is met within another solid bends nothing.
    """
    end = math.inf if solid is None else solid[0]
    hits = [(hit(item, origin, direction), i) for i, item in enumerate(scene["objects"]) if i not in met]
    hits = [(*found, i) for found, i in hits if found is not None and found[0] < end]
    if not hits:
        if solid is None:
            return list(scene["background"])
        origin, direction = solid[1]
        return trace(scene, camera, origin, direction, met)
    t, n, i = min(hits)
    item = scene["objects"][i]
    p = add(origin, direction, t)
    colour = fogged(scene, camera, point(scene, item["material"], p, n, viewer(camera, p)), p)
    k_t = coefficients(item["material"], p)["k_t"]
    if not any(k_t):
        return colour
    if item["type"] in ("sphere", "box") and solid is None:
        way = through(item, origin, direction, p, n)
        if way is None:  # Snell's law has no solution
            return colour
        inside, outside = way
        if inside is None:
            behind = trace(scene, camera, *outside, met | {i})
        else:
            length = leave(item, *inside)[0]
            behind = trace(scene, camera, *inside, met | {i}, (length, outside))
    else:
        rest = None if solid is None else (solid[0] - t, solid[1])
        behind = trace(scene, camera, p, direction, met | {i}, rest)
    return [(1 - k_t[c]) * colour[c] + k_t[c] * behind[c] for c in range(3)]


def render(scene, camera):
    image = np.empty((*camera["shape"], 3))
    for row in range(camera["shape"][0]):
        for column in range(camera["shape"][1]):
            image[row, column] = trace(scene, camera, *ray(camera, row, column))
    return image


def shade(scene, normal, position, mask, camera):
    """Shade given points with the material of the first object."""
    image = np.empty((*camera["shape"], 3))
    for row in range(camera["shape"][0]):
        for column in range(camera["shape"][1]):
            if mask[row, column]:
                p, n = position[row, column].tolist(), normal[row, column].tolist()
                colour = point(scene, scene["objects"][0]["material"], p, n, viewer(camera, p))
                image[row, column] = fogged(scene, camera, colour, p)
            else:
                image[row, column] = scene["background"]
    return image
