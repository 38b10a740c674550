"""What two RTI viewers show of a folder, by the formulas of their sources, written here again from what they document.

OpenLIME (`LayerRTI`, `ShaderRTI`; layout "image", colour space "rgb"): `info.json` names `type`, `colorspace`,
`nplanes` and `materials[0]` with `scale` and `bias`; `plane_K.jpg` are textures of three numbers from 0 to 1,
ceil(nplanes / 3) of them, top row first. The light is a point of the unit disc, y up; points outside are moved onto its
edge. HSH are drawn under no light lower than .15 radians. What is summed goes to the screen as it is.

Relight (`Rti::load`, `Rti::render`): bytes v count as 255 (v / 255 - bias) scale, the terms of a PTM go by degree, HSH
are drawn under no light lower than .01 radians, and the sum is truncated to a byte.
"""

import json
from pathlib import Path

import numpy as np
from PIL import Image

LOWEST = {"OpenLIME": 0.15, "Relight": 0.01}  # radians above the horizon


def harmonics(x, y, lowest):
    """The nine terms of HSH, in the order of both viewers."""
    phi, theta = np.arctan2(y, x), min(np.arccos(np.sqrt(max(0.0, 1.0 - x * x - y * y))), np.pi / 2 - lowest)
    c = np.cos(theta)
    root = np.sqrt(c - c * c)
    return [
        1 / np.sqrt(2 * np.pi),
        np.sqrt(6 / np.pi) * np.cos(phi) * root,
        np.sqrt(3 / (2 * np.pi)) * (2 * c - 1),
        np.sqrt(6 / np.pi) * np.sin(phi) * root,
        np.sqrt(30 / np.pi) * np.cos(2 * phi) * (c * c - c),
        np.sqrt(30 / np.pi) * np.cos(phi) * (2 * c - 1) * root,
        np.sqrt(5 / (2 * np.pi)) * (1 - 6 * c + 6 * c * c),
        np.sqrt(30 / np.pi) * np.sin(phi) * (2 * c - 1) * root,
        np.sqrt(30 / np.pi) * np.sin(2 * phi) * (c * c - c),
    ]


def shown(folder: Path, light, viewer):
    """The picture on the screen under a light at (x, y) of the disc, from 0 to 1."""
    info = json.loads((folder / "info.json").read_text(encoding="utf-8"))
    assert (info["colorspace"], info["format"], len(info["materials"])) == ("rgb", "jpg", 1)
    size, (material,) = (info["height"], info["width"], 3), info["materials"]
    count = info["nplanes"]
    assert len(material["scale"]) == len(material["bias"]) == count
    x, y = np.array(light) / max(1.0, np.hypot(*light))
    weights = {
        "ptm": [1.0, x, y, x * x, x * y, y * y],
        "hsh": harmonics(x, y, LOWEST[viewer]),
    }[info["type"]]
    total = np.zeros(size)
    for plane in range(-(-count // 3)):
        with Image.open(folder / f"plane_{plane}.jpg") as image:
            assert (image.format, image.mode, image.size) == ("JPEG", "RGB", (info["width"], info["height"]))
            stored = np.asarray(image) / 255.0
        for channel in range(3):
            at = 3 * plane + channel
            total[..., channel] += (
                weights[plane] * (stored[..., channel] - material["bias"][at]) * material["scale"][at]
            )
    return np.clip(total if viewer == "OpenLIME" else np.floor(255.0 * total) / 255.0, 0.0, 1.0)
