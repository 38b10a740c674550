"""An independent oracle: the model E1-E6, E8, E9 in plain Python, one pixel, light and channel at a time.

Written from the equations of the design, not from the library, which it does not import. Scenes are plain dicts:
`{"objects": [{"center", "radius", "material"}], "lights": [...], "ambient", "background"}`; angles are in degrees.
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


def arriving(light, p):
    """Direction l to the light, and the factor f_rad f_ang."""
    if light["type"] == "directional":
        return unit([-x for x in light["direction"]]), 1.0
    to_light = add(light["position"], p, -1)
    l = unit(to_light)
    return l, radial(light, math.sqrt(dot(to_light, to_light))) * angular(light, l)


def highlight(material, n, l, v):
    """E5, E6: the factor of k_s."""
    n_l = dot(n, l)
    if n_l <= 0:
        return 0.0
    if material["lobe"] == "phong":
        r = [2 * n_l * n[i] - l[i] for i in range(3)]
        cosine = dot(v, r)
    else:
        cosine = dot(n, unit(add(l, v)))
    return power(cosine, material["n_s"])


def point(scene, material, p, n, v):
    """E9: the colour of one point."""
    colour = []
    for c in range(3):
        value = material["k_a"][c] * scene["ambient"][c]
        for light in scene["lights"]:
            l, f = arriving(light, p)
            diffuse = material["k_d"][c] * max(dot(n, l), 0.0)
            specular = material["k_s"][c] * highlight(material, n, l, v)
            value += f * light["intensity"][c] * (diffuse + specular)
        colour.append(value)
    return colour


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


def hit_sphere(item, origin, direction):
    """Distance to the first point of a sphere in front of the origin, or None."""
    o = add(origin, item["center"], -1)
    b, c = dot(o, direction), dot(o, o) - item["radius"] ** 2
    discriminant = b * b - c
    if discriminant <= 0:
        return None
    ahead = [t for t in (-b - math.sqrt(discriminant), -b + math.sqrt(discriminant)) if t > 0]
    return min(ahead) if ahead else None


def first_hit(scene, camera, row, column):
    """Material, point and normal that a pixel sees, or None."""
    origin, direction = ray(camera, row, column)
    hits = [(hit_sphere(item, origin, direction), item) for item in scene["objects"]]
    hits = [(t, item) for t, item in hits if t is not None]
    if not hits:
        return None
    t, item = min(hits, key=lambda hit: hit[0])
    p = add(origin, direction, t)
    n = unit(add(p, item["center"], -1))
    if dot(n, direction) > 0:  # seen from inside: the normal on the viewer's side
        n = [-x for x in n]
    return item["material"], p, n


def render(scene, camera):
    image = np.empty((*camera["shape"], 3))
    for row in range(camera["shape"][0]):
        for column in range(camera["shape"][1]):
            hit = first_hit(scene, camera, row, column)
            if hit is None:
                image[row, column] = scene["background"]
            else:
                material, p, n = hit
                image[row, column] = point(scene, material, p, n, viewer(camera, p))
    return image


def shade(scene, normal, position, mask, camera):
    """Shade given points with the material of the first object."""
    image = np.empty((*camera["shape"], 3))
    for row in range(camera["shape"][0]):
        for column in range(camera["shape"][1]):
            if mask[row, column]:
                p, n = position[row, column].tolist(), normal[row, column].tolist()
                image[row, column] = point(scene, scene["objects"][0]["material"], p, n, viewer(camera, p))
            else:
                image[row, column] = scene["background"]
    return image
