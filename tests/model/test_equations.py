"""Every equation E1-E14 is right: beside the oracle, which shares nothing with the library, closed forms, and what
OpenGL, POV-Ray and VTK render. Pictures are rendered operation by operation here, and compiled in studies/.
"""

import io

import jax
import numpy as np
import oracle
import pytest
from equations import FILES, TERMS, Comparison, comparisons, picture, reference, table
from oracle_scenes import (
    LOBES,
    LONG_TO_RENDER,
    OFF_AXIS,
    ONE_OF_EACH,
    SCENES,
    assert_same,
    chequer,
    directional,
    fog,
    library_camera,
    library_scene,
    orthographic,
    perspective,
    point,
    scene_of,
    sphere,
    spot,
)
from reference_files import PROGRAMS
from rich.console import Console

import diffshade as ds

QUICK = ("gl_02", "gl_04", "gl_05", "gl_07", "gl_11", "pov_03", "pov_05", "pov_08", "vtk_03", "refraction_01")
# What there is to compare each equation with, at least: of E7, E10 and E11 no other program's render is at hand.
EVERYTHING = {"oracle", "closed form", "OpenGL", "POV-Ray", "VTK"}
WITNESSES = {equation: {"oracle", "closed form"} for equation in TERMS} | {
    "E1": EVERYTHING,
    "E2": EVERYTHING,
    "E3": {"oracle", "closed form", "OpenGL", "POV-Ray"},
    "E4": EVERYTHING,
    "E5": {"oracle", "closed form", "POV-Ray", "VTK"},
    "E6": {"oracle", "closed form", "OpenGL", "POV-Ray"},
    "E8": {"oracle", "OpenGL", "POV-Ray", "VTK"},
    "E9": {"oracle", "closed form", "OpenGL"},
    "E12": {"oracle", "closed form", "POV-Ray"},
    "E14": {"oracle", "closed form", "OpenGL"},
}


@pytest.fixture(autouse=True)
def _operation_by_operation():
    with jax.disable_jit():
        yield


@pytest.mark.parametrize("name", [name for name in SCENES if name not in LONG_TO_RENDER])
def test_a_picture_is_that_of_the_oracle(name):
    assert_same(*picture(name, compiled=False))


def test_the_references_are_there():
    assert {path.name.split("_")[0] for path in FILES} == set(PROGRAMS)
    assert len(FILES) >= 21


@pytest.mark.parametrize("path", [path for path in FILES if path.name.startswith(QUICK)], ids=lambda path: path.stem)
def test_a_picture_is_that_of_another_program(path):
    expected, found = reference(path, compiled=False)
    assert expected.mask.any()
    assert np.isfinite(found[expected.mask]).all()
    difference = np.abs(found - expected.expected)[expected.mask]
    assert difference.max() <= expected.tolerance, f"{(difference.max(-1) > expected.tolerance).sum()} points differ"


@pytest.fixture(scope="module")
def found() -> list[Comparison]:
    return list(comparisons(leave_out=LONG_TO_RENDER, files=[path for path in FILES if path.name.startswith(QUICK)]))


@pytest.mark.parametrize("equation", [f"E{i}" for i in range(1, 15)])
def test_an_equation_is_right_and_has_its_witnesses(found, equation):
    here = [c for c in found if c.equation == equation]
    assert {c.witness for c in here} >= WITNESSES[equation]
    assert all(c.numbers > 0 for c in here)
    assert not [c for c in here if not c.error <= c.tolerance]


def test_the_table_has_a_row_for_each_and_says_which_is_wrong(found):
    def printed(comparisons):
        text = io.StringIO()
        Console(file=text, width=132).print(table(comparisons))
        return text.getvalue()

    lines = printed(found).splitlines()
    for equation, term in TERMS.items():
        (row,) = [line for line in lines if f" {equation} " in line]
        assert term in row
        assert "yes" in row
    assert "NO" not in printed(found)
    for wrong in (1e-11, float("nan")):
        assert "NO" in printed([*found, Comparison("E3", "oracle", 1, wrong, 1e-12)])


# --- other ways to the same picture


def test_the_order_of_transparent_objects_changes_nothing():
    scene, camera = SCENES["two kinds of glass"]
    reordered = scene | {"objects": scene["objects"][::-1]}
    image = ds.render(library_scene(reordered), library_camera(camera))
    np.testing.assert_allclose(image, picture("two kinds of glass", compiled=False)[0], rtol=1e-14, atol=0)


@pytest.mark.parametrize("lit", [(), (0,), (1,), (2, 0), (0, 1, 2, 3)])
def test_only_the_lights_that_are_lit(lit):
    scene, camera = scene_of([sphere()], ONE_OF_EACH), perspective()
    expected = oracle.render(scene | {"lights": [ONE_OF_EACH[i] for i in lit]}, camera)
    assert_same(ds.render(library_scene(scene), library_camera(camera), lit=lit), expected)


def assert_shaded_as_the_oracle_does(scene, camera, normal, position, mask=None):
    everywhere = np.ones(np.shape(normal)[:2], bool) if mask is None else mask
    expected = oracle.shade(scene, normal, position, everywhere, camera)
    image = ds.shade(library_scene(scene), ds.GBuffer(normal, position, mask), library_camera(camera))
    assert_same(image, expected)


@pytest.mark.parametrize(
    ("lobe", "local_viewer", "air"), [("phong", True, None), ("blinn", False, None), ("phong", True, fog())]
)
def test_shade_a_gbuffer(lobe, local_viewer, air):
    random = np.random.default_rng(7)
    normal = random.normal(size=(12, 16, 3))  # to all sides: a G-buffer's normals are never flipped
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    position, mask = random.normal(size=normal.shape), random.random((12, 16)) < 0.7
    normal[~mask] = position[~mask] = np.nan
    lights = [*ONE_OF_EACH, spot((-3, 0, 1), (3, 0, -1), cutoff=40, softness=3)]
    scene = scene_of([sphere(lobe=lobe, k_d=chequer())], lights, atmosphere=air)
    assert_shaded_as_the_oracle_does(scene, perspective(**OFF_AXIS, local_viewer=local_viewer), normal, position, mask)


def test_shade_normals_alone():
    normal = np.array([[(0, 0, 1), (0.6, 0, 0.8), (0, 0, -1), (0, 0, 0)]], float)
    scene = scene_of([sphere(n_s=3)], [directional((-1, -1, -1)), directional((1, 0, 0))])
    camera = orthographic(local_viewer=False, shape=(1, 4))
    expected = oracle.shade(scene, normal, 0 * normal, np.array([[True, True, True, False]]), camera)
    assert_same(ds.shade(library_scene(scene), ds.GBuffer(normal), library_camera(camera)), expected)


# One point in an exact position to one light and the viewer: n, l, v and d at the edges of every definition.
UP, DOWN, RIGHT, LEFT = (0, 0, 1), (0, 0, -1), (1, 0, 0), (-1, 0, 0)
CORNERS = {
    "light on the point": (UP, point((0, 0, 0), attenuation=(0, 0, 1)), UP),
    "light nearly on the point": (UP, point((0, 0, 1e-7), attenuation=(0, 0, 1)), UP),
    "light grazes": (UP, point((2, 0, 0)), UP),
    "light behind": (UP, point((0, 0, -2)), UP),
    "l = v = n": (UP, point((0, 0, 3)), UP),
    "l = -v": (UP, point((0, 0, 4)), DOWN),  # lengths of 2^k: l + v is exactly 0
    "v.r = 0": (UP, point((0, 0, 3)), RIGHT),
    "n.h = 0": (UP, point((4, 0, 4)), (1, 0, -1)),
    "viewer behind": (UP, point((3, 0, 1)), (-1, 0, -2)),
    "n.l > 0, mirror direction away from the viewer": (UP, point((3, 0, 1)), (3, 0, 1)),
    "cutoff 0, on the axis": (UP, spot((0, 0, 2), DOWN, cutoff=0, exponent=3), UP),
    "cutoff 0, off the axis": (UP, spot((0.1, 0, 2), DOWN, cutoff=0), UP),
    "cutoff 90, at 90 degrees, exponent 0": (LEFT, spot((-2, 0, 0), UP, cutoff=90), LEFT),
    "cutoff 90, at 90 degrees, exponent 2": (LEFT, spot((-2, 0, 0), UP, cutoff=90, exponent=2), LEFT),
    "cutoff 90, soft, at 90 degrees": (LEFT, spot((-2, 0, 0), UP, cutoff=90, softness=5), LEFT),
    "cutoff 90, on the axis": (UP, spot((0, 0, 2), DOWN, cutoff=90, exponent=4), UP),
    "cutoff 90, behind the spot": (UP, spot((0, 0, 2), UP, cutoff=90), UP),
    "cutoff 90, all of it soft": (UP, spot((1, 0, 2), DOWN, cutoff=90, softness=90), UP),
    "spot on the point": (UP, spot((0, 0, 0), DOWN, cutoff=90), UP),
    "attenuation of exactly 1": (UP, point((0, 0, 2), attenuation=(0, 0, 0.25), clamp=True), UP),
    "attenuation clamped on the point's own skin": (UP, point((0, 0, 1e-3), attenuation=(0, 0, 1), clamp=True), UP),
}


@pytest.mark.parametrize(("n", "light", "towards_viewer"), CORNERS.values(), ids=CORNERS)
def test_corner(n, light, towards_viewer):
    camera = orthographic(eye=tuple(4 * x for x in towards_viewer), up=(0, 1, 0), shape=(1, 1))
    normal = np.array([[n]], float)
    for lobe in LOBES:
        scene = scene_of([sphere(lobe=lobe, n_s=(0.0, 0.5, 30.0))], [light])
        assert_shaded_as_the_oracle_does(scene, camera, normal, 0 * normal)
