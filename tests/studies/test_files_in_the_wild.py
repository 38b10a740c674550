"""Files of public repositories, none of which is kept here: each is read, or refused, as the documentation says.

They are looked for as wild/REPOSITORY/FILE among the measured data.
"""

import logging
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from measured import measured
from PIL import Image

import diffshade as ds

PAGE = Path(__file__).parents[2] / "docs" / "studies" / "2026-11-26-files-in-the-wild.md"
SECTION = re.compile(r"^## ([^\n]+)$(.*?)(?=^## |\Z)", re.MULTILINE | re.DOTALL)
ROW = re.compile(r"^\| (\S+) \| `([^`]+)` \| (.+) \|$", re.MULTILINE)
ROWS = [
    (section, *row) for section, text in SECTION.findall(PAGE.read_text(encoding="utf-8")) for row in ROW.findall(text)
]
MESHES = ("OBJ", "PLY", "STL and OFF", "glTF meshes")
LISTS = "Lists of lights"
IMAGES = "Plain images"


def found(section: str, path: Path, folder: Path) -> str:
    """What the table says of a file."""
    if section in MESHES:
        return found_of_mesh(path)
    if section == LISTS:
        return found_of_list(path, folder)
    if section == IMAGES:
        image = ds.read_image(path)
        return f"{image.shape[1]} x {image.shape[0]}, mean {np.mean(image):.4f}"
    if path.suffix == ".ts":  # an IES file as a string of TypeScript
        text = path.read_text(encoding="utf-8")
        path = folder / "a.ies"
        path.write_text(text[text.index("IESNA") :].partition("`")[0], encoding="utf-8")
    if path.suffix.lower() in (".ies", ".ldt"):
        return str(ds.lamps.read_lamp(path)).splitlines()[1][12:]
    number = len(ds.exchange.read_materials(path))
    return f"{number} material{'s' if number > 1 else ''}"


def found_of_mesh(path: Path) -> str:
    """Read a mesh: its area, how many parts it has, and how far its normals are from its faces on the mean."""
    mesh = ds.exchange.read_mesh(path, None)
    corners = np.reshape(mesh.corners, (-1, 3, 3))
    kept = len(corners)
    while kept > 1 and (corners[kept - 1] == corners[kept - 2]).all():
        kept -= 1  # the last triangle is repeated to fill its box
    corners = corners[:kept]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(across, axis=-1) / 2
    parts = len(ds.exchange.read_mesh_parts(path, ds.exchange.frame_mesh(path, shape=(48, 48))))
    said = f"area {area.sum():.5g}" + (f", {parts} parts" if parts > 1 else "")
    if mesh.normals is None:
        return said
    real = area > 1e-12 * area.max()
    normals = np.reshape(mesh.normals, (-1, 3, 3))[:kept]
    bend = angle(normals[real], across[real][:, None]).mean(-1)
    mean = (bend * area[real]).sum() / area[real].sum()
    return said + (f", normals {mean:.1f} degrees from the faces" if mean > 0.05 else "")


def angle(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Angles between vectors, degrees, accurate near 0."""
    a, b = (x / np.linalg.norm(x, axis=-1, keepdims=True) for x in (a, b))
    return np.degrees(2 * np.arctan2(np.linalg.norm(a - b, axis=-1), np.linalg.norm(a + b, axis=-1)))


def found_of_list(path: Path, folder: Path) -> str:
    """Read a list beside photographs of the names in it, or of as many names as it has lines."""
    text = path.read_text(encoding="utf-8")
    lp = path.suffix.lower() == ".lp"
    (folder / (path.name if lp else "light_directions.txt")).write_text(text, encoding="utf-8")
    if lp:
        named = [re.split(r"[/\\]", line.split()[0])[-1] for line in text.splitlines() if len(line.split()) == 4]
    else:
        named = [f"photo_{k:03d}.png" for k in range(lights_in(text))]
    for name in named:
        Image.fromarray(np.full((6, 6), 128, np.uint8)).save(folder / name)
    Image.fromarray(np.full((6, 6), 255, np.uint8)).save(folder / "mask.png")
    scene, views = ds.read_photographs(folder, normals=False)
    lights: Any = scene.lights
    mean = -np.mean([light.direction for light in lights], 0)
    return f"{len(views)} lights, mean ({', '.join(f'{round(x, 3) + 0.0:.3f}' for x in mean)})"


def lights_in(text: str) -> int:
    """How many lights a list without names has: rows of three numbers, or three rows, or 12 where it is no table."""
    rows = [line.split() for line in text.splitlines() if line.strip()]
    wide = {len(row) for row in rows[1:]}
    if len(wide) != 1 or any(not re.fullmatch(r"[-+.\deE]+", word) for row in rows for word in row):
        return 12
    (columns,) = wide
    return columns if len(rows) == 3 and columns != 3 else len(rows) - (len(rows[0]) == 1)


def test_the_table_has_what_was_asked_for():
    kinds = [Path(file).suffix.lower() for _, _, file, _ in ROWS]
    assert kinds.count(".mtl") >= 40
    assert len({repository for _, repository, file, _ in ROWS if file.endswith(".mtl")}) >= 30
    assert kinds.count(".gltf") + kinds.count(".glb") >= 20
    assert kinds.count(".json") >= 7
    assert sum(kinds.count(kind) for kind in (".ies", ".ldt", ".ts")) >= 20
    assert sum(section in (*MESHES, LISTS, IMAGES) for section, *_ in ROWS) >= 60


@pytest.mark.parametrize(("section", "repository", "file", "expected"), ROWS)
def test_a_file_is_read_as_the_table_says(section, repository, file, expected, caplog, tmp_path):
    caplog.set_level(logging.ERROR, "diffshade")
    wild = measured("wild")
    path = wild / repository / file
    if not path.is_file():
        pytest.skip(f"{repository} {file} is not among the measured data.")
    if not expected.startswith("refused: "):
        assert found(section, path, tmp_path) == expected
        return
    with pytest.raises((ValueError, OSError)) as refused:
        found(section, path, tmp_path)
    said = re.sub(r"\s+", " ", str(refused.value)).replace(f"{wild}/", "").replace("|", "/")
    assert expected.removeprefix("refused: ") in said
