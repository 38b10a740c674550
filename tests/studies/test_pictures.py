"""All the oracle's scenes and references, compiled as users render them; and the scenes show what their names say."""

import functools

import numpy as np
import oracle
import pytest
from equations import FILES, picture, reference
from oracle_scenes import LONG_TO_RENDER, SCENES, assert_same, needed


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_a_compiled_picture_is_that_of_the_oracle(name):
    assert_same(*picture(name, compiled=True))


@pytest.mark.parametrize("name", sorted(LONG_TO_RENDER))
def test_a_picture_that_the_default_tier_leaves_out_is_that_of_the_oracle(name):
    assert_same(*picture(name, compiled=False))


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_a_compiled_picture_is_that_of_another_program(path):
    expected, found = reference(path, compiled=True)
    assert np.abs(found - expected.expected)[expected.mask].max() <= expected.tolerance


@functools.cache
def right(name):
    return oracle.render(*SCENES[name])


def share_of_points_that_change(name, **changes):
    scene, camera = SCENES[name]
    image = right(name)
    changed = oracle.render(scene | {"lights": [light | changes for light in scene["lights"]]}, camera)
    inside = (image != scene["background"]).any(-1)
    return (image != changed).any(-1)[inside].mean()


def test_the_scenes_show_what_their_names_say():
    dark = {"intensity": (0, 0, 0)}
    lit = share_of_points_that_change("point, clamped here and there", **dark)
    clamped = share_of_points_that_change("point, clamped here and there", clamp=False)
    assert 0.1 < clamped < lit - 0.1
    for name in ("hard spot", "hard spot with exponent", "soft spot", "spot soft up to its axis"):
        assert share_of_points_that_change(name, **dark) > 0.2
        assert share_of_points_that_change(name, cutoff=90, softness=0) > 0.2
    for name, least in (("one sphere before the other", 10), ("three overlap", 5)):
        scene, camera = SCENES[name]
        alone = [oracle.render(scene | {"objects": [item]}, camera) for item in scene["objects"]]
        assert np.all([(image != scene["background"]).any(-1) for image in alone], 0).sum() > least
        assert all((image != right(name)).any(-1).sum() > 10 for image in alone)
    for name in ("depth cueing", "depth cueing, along the ray"):
        scene, camera = SCENES[name]
        beyond, image = scene["atmosphere"]["I_dc"], right(name)
        nothing = (image == scene["background"]).all(-1)
        near = (oracle.render(without(scene, "atmosphere"), camera) == image).all(-1) & ~nothing
        far = (image == beyond).all(-1)
        assert min(near.sum(), far.sum()) > 3  # nearer than z_f, and beyond z_b
        assert (~near & ~far & ~nothing).sum() > 10


def without(part, *names):
    return {k: v for k, v in part.items() if k not in names}


def with_materials(scene, change):
    return scene | {"objects": [item | {"material": change(item["material"])} for item in scene["objects"]]}


# For each equation that the first scenes do without: the scene as it would be without that equation.
LESS = {
    "E7": lambda scene: with_materials(scene, lambda m: without(m, "fresnel")),
    "E10": lambda scene: with_materials(scene, lambda m: without(m, "O_d", "O_s")),
    "E11": lambda scene: (
        scene
        | {"lights": [light | {"samples": (1, 1)} if light["type"] == "area" else light for light in scene["lights"]]}
    ),
    "E12": lambda scene: with_materials(scene, lambda m: m | {"eta": 1.0}),
    "E13": lambda scene: with_materials(scene, lambda m: without(m, "k_t")),
    "E14": lambda scene: without(scene, "atmosphere"),
}


@pytest.mark.parametrize("equation", LESS)
def test_a_scene_that_needs_an_equation_would_look_different_without_it(equation):
    of_it = [name for name in SCENES if equation in needed(SCENES[name][0])]
    assert of_it
    for name in of_it:
        scene, camera = SCENES[name]
        less = oracle.render(LESS[equation](scene), camera)
        assert (np.abs(right(name) - less) > 1e-4).any(-1).mean() > 0.05, name


@pytest.mark.parametrize(
    ("name", "least"),
    [
        ("a bubble before a wall", 11),
        ("a glass box before a wall", 11),
        ("a box thinner than air before a wall", 4),
        ("camera in a glass box", 11),
        ("a glass ball before a wall", 0),
        ("a slab before a wall", 0),
    ],
)
def test_total_reflection_is_seen_on_the_rim_of_a_bubble_and_in_a_glass_box_and_nowhere_in_a_ball(name, least):
    """The pixels that show the first object and nothing behind it."""
    scene, camera = SCENES[name]
    alone = scene | {"objects": scene["objects"][:1]}
    black, white = (oracle.render(alone | {"background": (x,) * 3}, camera) for x in (0, 9))
    solid = oracle.render(with_materials(alone, lambda m: without(m, "k_t")) | {"background": (9,) * 3}, camera)
    opaque = ((black == white) & (solid != 9)).all(-1).sum()
    assert opaque >= least
    assert least > 0 or opaque == 0
