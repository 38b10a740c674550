"""Names become unknowns: which numbers a name frees, what they are called, where they start and what they may be."""

import jax
import numpy as np
import own_parts
import pytest
from refusals import refuses
from synthetic import light_positions, standard_scene

import diffshade as ds
from diffshade.inverse.forward.rendered import prepare
from diffshade.inverse.unknowns.parameters import find_unknowns
from diffshade.inverse.unknowns.slots import put_back, slots_of, values_in
from diffshade.inverse.unknowns.unknown import coordinates, free_places, natural

SPOT = ds.SpotLight((0, 3, 3), (0, -1, -1), 2.0, 40.0, 3.0, ds.RadialAttenuation(1.0, 0.3, 0.2), softness=5.0)
MANY_KINDS = ds.Scene(
    [
        ds.Object(ds.Sphere(), ds.Material(0.1, (0.6, 0.4, 0.2), 0.3, 20)),
        ds.Object(ds.Sphere((1, 2, 3), 0.5), ds.Material(0.2, 0.5, (0.1, 0.2, 0.3), 80, lobe=ds.Blinn())),
    ],
    [
        ds.PointLight((2, 3, 4), (1, 2, 3), ds.RadialAttenuation(1.0, 0.1, 0.05)),
        ds.DirectionalLight((1, -1, -1), 0.3),
        SPOT,
        ds.PointLight((-2, 3, 4), 5.0, ds.RadialAttenuation(2.0, 0.2, 0.1)),
    ],
    ambient=(0.9, 0.8, 0.7),
)
ONE = ds.Scene(ds.Object(ds.Sphere(), ds.Material(0.1, 0.6, 0.3, 20)), [ds.PointLight((2, 3, 4), 5.0)])


VIEWS = tuple(ds.View(np.full((2, 2), 0.5), ds.Camera((0, 0, 4), shape=(2, 2)), exposure=2.0) for _ in range(2))


def find(scene, free, *options, **more):
    return find_unknowns(scene, VIEWS, free, *options, **more)


def places(unknown):
    """The paths and channels of what holds an unknown."""
    return [(place.path, place.channel) for place in unknown.places]


def names(scene, free, tied=(), **options):
    return [unknown.name for unknown in find(scene, free, tied, **options)]


def unknown(scene, name, free, **options):
    return next(u for u in find(scene, free, **options) if u.name == name)


@pytest.mark.parametrize(
    ("free", "expected"),
    [
        *((free, ["k_d.r", "k_d.g", "k_d.b"]) for free in ("k_d", ("material.k_d",), ("0.material.k_d",))),
        (("k_d", "material.k_d", "objects.0.material.k_d"), ["k_d.r", "k_d.g", "k_d.b"]),  # freed once
        (("material",), [*(f"{k}.{c}" for k in ("k_a", "k_d", "k_s") for c in "rgb"), "n_s"]),
        (("attenuation",), ["linear", "quadratic"]),
        *(((free,), ["constant"]) for free in ("constant", "attenuation.constant", "lights.0.attenuation.constant")),
    ],
)
def test_any_run_of_whole_segments_names_a_parameter_and_all_below_it(free, expected):
    assert names(ONE, free) == expected
    assert "constant" not in names(ONE, ("lights",))  # freed by its own name only


@pytest.mark.parametrize("name", ["d", "_d", "k_d.material", "objects.material", "material.k", "k_d."])
def test_a_part_of_a_segment_or_a_run_with_a_hole_names_nothing(name):
    refuses(lambda: find(ONE, (name,)), "no parameter is named")


def test_a_name_frees_every_path_that_holds_it_in_the_order_of_the_scene():
    for free in (("n_s", "lights.2.exponent"), ("lights.2.exponent", "n_s")):
        assert names(MANY_KINDS, free) == ["objects.0.material.n_s", "objects.1.material.n_s", "exponent"]


def test_the_geometry_of_a_pattern_is_freed_by_its_own_names_only():
    wall = ds.Object(ds.Plane(), ds.Material(k_a=ds.Chequer(0.1, 0.9, smooth=True), k_t=ds.Chequer(0.1, 0.9)), "wall")
    scene = ds.Scene(wall, ds.PointLight((2, 3, 4)))
    colours = [f"k_a.{c}.{channel}" for c in "ab" for channel in "rgb"]
    assert names(scene, "k_a") == colours
    assert names(scene, ("k_a.period", "k_a.u")) == ["k_a.period", "k_a.u.x", "k_a.u.y", "k_a.u.z"]
    assert [u.upper for u in find(scene, "k_t")] == [1.0] * 6  # the range of k_t, not of a colour


def test_k_s_beside_dielectric_is_not_freed_with_the_rest_of_its_material():
    coat = ds.Material(k_d=0.4, eta=1.5, fresnel=ds.Dielectric())
    scene = ds.Scene([ds.Object(ds.Sphere(), coat), ds.Object(ds.Plane())], ds.PointLight((2, 3, 4)))
    freed = {name.rpartition(".")[0] for name in names(scene, "material")}
    assert "objects.1.material.k_s" in freed or "1.material.k_s" in freed
    assert not any("0.material.k_s" in name for name in freed)


@pytest.mark.parametrize(("name", "where"), [("exposure", (0, 1)), ("views.1.exposure", (1,)), ("views.0.black", (0,))])
def test_a_number_of_a_view_is_freed_by_its_own_name_only(name, where):
    unknowns = find(ONE, (name,))
    last = name.split(".")[-1]
    assert [places(u) for u in unknowns] == [[(f"views.{i}.{last}", 0)] for i in where]
    assert [u.name for u in unknowns] == [f"views.{i}.{last}" for i in where]
    refuses(lambda: find(ONE, ("k_d", "views.0"), ("views.0",)), "names 'views.0'", "not free")


def test_an_exposure_starts_at_the_views_own_and_black_may_be_negative():
    exposure, black = find(ONE, ("views.0.exposure", "views.0.black"))
    assert (exposure.start, exposure.lower, exposure.upper) == (2.0, 1e-9, np.inf)
    assert (black.start, black.lower, black.upper) == (0.0, -np.inf, np.inf)
    (tied,) = find(ONE, ("exposure",), ("exposure",))
    assert places(tied) == [("views.0.exposure", 0), ("views.1.exposure", 0)]


@pytest.mark.parametrize(("n_s", "expected"), [(20, ["n_s"]), ((20, 30, 40), ["n_s.r", "n_s.g", "n_s.b"])])
def test_n_s_is_as_many_unknowns_as_the_scene_gives_it_numbers(n_s, expected):
    scene = standard_scene(ds.Material(0.1, 0.6, 0.3, n_s))
    unknowns = find(scene, ("n_s",), from_scene=True)
    assert [u.name for u in unknowns] == expected
    assert [u.start for u in unknowns] == np.ravel(n_s).tolist()
    assert all(u.logarithmic and u.lower == 0.1 for u in unknowns)
    assert names(scene, ("n_s",), constraints=[ds.Grey("n_s")]) == ["n_s"]


def test_names_are_as_short_as_tells_them_apart():
    assert names(MANY_KINDS, ("objects.1.material.k_s",)) == [f"objects.1.material.k_s.{c}" for c in "rgb"]
    assert names(MANY_KINDS, ("cutoff", "exponent")) == ["cutoff", "exponent"]
    assert names(MANY_KINDS, ("lights.0.position",)) == [f"lights.0.position.{c}" for c in "xyz"]
    everything = names(MANY_KINDS, ("objects", "lights", "ambient", "background", "constant"))
    assert len(set(everything)) == len(everything)


def test_a_short_name_names_its_own_unknown_and_no_other():
    scene = MANY_KINDS
    for u in find(scene, ("objects", "lights", "ambient", "constant")):
        again = find(scene, (u.quantity,))
        assert free_places(again) == free_places([u])


def test_a_direction_is_the_three_numbers_of_a_unit_vector():
    """Its length is no unknown: it starts at 1 whatever the scene says, and the solver holds it there."""
    unknowns = find(MANY_KINDS, ("k_d", "direction"), from_scene=True)
    assert [u.name for u in unknowns][6:] == [f"lights.{i}.direction.{c}" for i in (1, 2) for c in "xyz"]
    starts = np.array([u.start for u in unknowns[6:]]).reshape(2, 3)
    np.testing.assert_allclose(starts, [np.array((1, -1, -1)) / 3**0.5, np.array((0, -1, -1)) / 2**0.5], rtol=1e-15)
    assert slots_of(MANY_KINDS, VIEWS, unknowns).units.tolist() == [[6, 7, 8], [9, 10, 11]]
    assert slots_of(MANY_KINDS, VIEWS, find(MANY_KINDS, ("position",))).units.shape == (0, 3)


def test_tied_makes_one_unknown_of_paths_that_are_equal_after_the_run():
    scene = MANY_KINDS
    tied = find(scene, ("attenuation",), ("attenuation",))
    assert [u.name for u in tied] == ["linear", "quadratic"]
    assert [[place.path for place in u.places] for u in tied] == [
        [f"lights.{i}.attenuation.{name}" for i in (0, 2, 3)] for name in ("linear", "quadratic")
    ]


def test_tied_colours_share_channel_by_channel():
    tied = find(MANY_KINDS, ("k_d", "k_s"), ("k_d",))
    assert [places(u) for u in tied if u.name.startswith("k_d")] == [
        [("objects.0.material.k_d", c), ("objects.1.material.k_d", c)] for c in range(3)
    ]
    assert len(tied) == 3 + 6  # k_s is not tied


def test_tied_ties_only_what_is_free():
    (linear,) = find(MANY_KINDS, ("lights.0.attenuation.linear",), ("attenuation",))
    assert places(linear) == [("lights.0.attenuation.linear", 0)]


@pytest.mark.parametrize(
    ("scene", "name", "said"),
    [(ONE, "k_s", True), (ONE, "attenuation", False), (MANY_KINDS, "k_s", False), (ONE, "exposure", False)],
)
def test_a_colour_that_ties_nothing_is_said(scene, name, said, caplog):
    find(scene, ("k_s", "attenuation", "exposure"), name)
    assert [f"'{name}', which one object alone has" in message for message in caplog.messages] == [True] * said


def test_in_a_grey_fit_a_colour_is_one_unknown_and_a_position_three():
    grey = find(ONE, ("k_d", "position"), grey=True)
    assert [u.name for u in grey] == ["k_d", "position.x", "position.y", "position.z"]
    assert places(grey[0]) == [("objects.0.material.k_d", c) for c in range(3)]


def test_a_material_and_an_attenuation_start_at_fixed_values_and_all_else_at_the_scenes():
    light = ds.PointLight((2, 3, 4), (1, 2, 3), ds.RadialAttenuation(1.0, 0.4, 0.4))
    scene = ds.Scene(ds.Object(ds.Sphere()), [light, ds.SpotLight((0, 3, 3), (0, -1, -1), exponent=3)], (0.9, 0.8, 0.7))
    free = ("k_a", "k_d", "k_s", "n_s", "lights.0.attenuation", "lights.0.intensity", "lights.0.position", "exponent")
    found = {u.name: u.start for u in find(scene, (*free, "radius", "ambient"))}
    assert {name: found[name] for name in ("k_a.r", "k_d.g", "k_s.b", "n_s")} == {
        **dict.fromkeys(("k_a.r", "k_d.g", "k_s.b"), 0.3),
        "n_s": 10.0,
    }
    starts = {name.rpartition("attenuation.")[2]: start for name, start in found.items()}
    assert (starts["linear"], starts["radius"], starts["ambient.b"], starts["exponent"]) == (0.0, 1.0, 0.7, 3)
    assert [u.start for u in find(scene, ("lights.0.intensity", "lights.0.position"))] == [2, 3, 4, 1, 2, 3]


def test_an_attenuation_whose_constant_is_zero_does_not_start_at_zero():
    """1/d^2 is `RadialAttenuation(0, 0, 1)`; with linear = quadratic = 0 it would divide by zero."""
    light = ds.PointLight((2, 3, 4), 1.0, ds.RadialAttenuation(0.0, 0.0, 1.0))
    assert max(u.start for u in find(standard_scene(lights=[light]), ("attenuation",))) > 0


def test_the_numbers_of_an_own_law_are_freed_by_name_and_its_amplitude_by_its_own_alone():
    scene = standard_scene(lights=[ds.PointLight((2, 3, 4), attenuation=own_parts.PowerAttenuation(0.7))])
    assert names(scene, ("attenuation",)) == names(scene, ("lights.0.attenuation", "p")) == ["p"]
    (a,) = find(scene, ("a",))
    assert (a.start, a.lower, a.parameter.gauge) == (0.7, 0.0, 1)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("k_d.r", (0.0, np.inf)),
        ("n_s", (0.1, 1e4)),
        ("linear", (0.0, np.inf)),
        ("quadratic", (0.0, np.inf)),
        ("constant", (0.0, np.inf)),
        ("intensity.b", (0.0, np.inf)),
        ("position.x", (-np.inf, np.inf)),
        ("cutoff", (0.0, 90.0)),
        ("exponent", (0.0, np.inf)),
        ("radius", (0.0, np.inf)),
    ],
)
def test_default_bounds(name, expected):
    scene = ds.Scene(ds.Object(ds.Sphere()), [SPOT])
    found = unknown(scene, name, (name.split(".")[0],))
    assert (found.lower, found.upper) == expected


@pytest.mark.parametrize("name", ["k_d", "material.k_d", "material"])
def test_bounds_are_named_by_any_run_too(name):
    low, high = (0.2, 0.8)
    for u in find(ONE, ("k_d",), bounds={name: (low, high)}):
        assert (u.lower, u.upper) == (low, high)


def test_bounds_of_one_object_leave_the_other_alone():
    unknowns = find(MANY_KINDS, ("n_s",), bounds={"objects.1.material.n_s": (5.0, 50.0)})
    assert [(u.lower, u.upper) for u in unknowns] == [(0.1, 1e4), (5.0, 50.0)]


def test_two_bounds_of_one_number_both_hold():
    bounds = {"n_s": (5.0, 500.0), "material.n_s": (1.0, 50.0)}
    (n_s,) = find(ONE, ("n_s",), bounds=bounds)
    assert (n_s.lower, n_s.upper) == (5.0, 50.0)


@pytest.mark.parametrize("place", [0, 1])
def test_bounds_of_any_one_place_bind_what_is_tied_to_it(place):
    bounds = {f"objects.{place}.material.n_s": (5.0, 50.0)}
    (n_s,) = find(MANY_KINDS, ("n_s",), ("n_s",), bounds)
    assert (n_s.lower, n_s.upper) == (5.0, 50.0)


def test_from_the_scene_all_starts_at_the_scenes_values():
    material = ds.Material((0.1, 0.2, 0.3), 0.7, 0.6, 33)
    scene = standard_scene(material, [ds.PointLight((2, 3, 4), 5.0, ds.RadialAttenuation(1.0, 0.4, 0.5))])
    unknowns = find(scene, ("material", "attenuation"), from_scene=True)
    np.testing.assert_allclose([u.start for u in unknowns], [0.1, 0.2, 0.3, *[0.7] * 3, *[0.6] * 3, 33, 0.4, 0.5])
    np.testing.assert_array_equal(values_in(scene, VIEWS, unknowns), [u.start for u in unknowns])


def test_a_prior_is_held_in_the_solvers_coordinates():
    priors = {"material": (0.5, 0.2), "n_s": (20.0, 0.1)}
    unknowns = find(ONE, ("k_d", "n_s", "linear"), priors=priors)
    assert [u.prior for u in unknowns] == [*[(0.5, 0.2)] * 3, (np.log(20.0), 0.1), None]


def test_a_start_is_clipped_into_the_bounds():
    bounds = {"k_d": (0.4, 0.9), "n_s": (0.1, 5.0), "linear": (0.01, 1.0)}
    starts = {u.name: u.start for u in find(ONE, ("k_d", "n_s", "linear"), bounds=bounds)}
    assert starts == {"k_d.r": 0.4, "k_d.g": 0.4, "k_d.b": 0.4, "n_s": 5.0, "linear": 0.01}


def test_only_n_s_is_solved_for_as_its_logarithm():
    logarithmic = {u.name for u in find(MANY_KINDS, ("objects", "lights")) if u.logarithmic}
    assert logarithmic == {"objects.0.material.n_s", "objects.1.material.n_s"}


HARD = ds.Scene(ds.Object(ds.Sphere()), [ds.SpotLight((0, 3, 3), (0, -1, -1))])


def test_bounds_of_a_direction_that_hold_a_unit_vector_will_do():
    view = ds.View(np.zeros((4, 4, 3)), ds.Camera((0, 0, 4), fov=32, shape=(4, 4)))
    found = find_unknowns(HARD, [view], ("direction",), bounds={"direction": (-0.9, 0.9)})
    assert [(u.lower, u.upper) for u in found] == [(-0.9, 0.9)] * 3


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"free": ("ns",)}, ("'ns'", "Did you mean 'n_s'?")),
        ({"free": ("attenuations",)}, ("'attenuations'", "Did you mean 'attenuation'?")),
        ({"free": ("lights.0.intensty",)}, ("'lights.0.intensty'", "Did you mean 'lights.0.intensity'?")),
        ({"bounds": {"kd": (0.0, 1.0)}}, ("no parameter is named 'kd'",)),
        ({"free": ("0",)}, ("free names '0'", "a number alone", "Name what it counts")),
        ({"free": ("0.0",)}, ("free names '0.0'", "a number alone")),
        ({"bounds": {"k_s": (0.0, 1.0)}}, ("bounds names 'k_s'", "not free", "Add it to free")),
        ({"bounds": {"k_d": (0.5, 0.5)}}, ("bounds of 'k_d'", "lower < upper", "(0.5, 0.5)")),
        ({"bounds": {"k_d": (np.nan, 1.0)}}, ("bounds of 'k_d'", "lower < upper")),
        ({"free": ("n_s",), "priors": {"n_s": (0.5, 0.0)}}, ("prior of 'n_s'", "above 0", "(0.5, 0)")),
        ({"free": ("n_s",), "priors": {"n_s": (np.nan, 1.0)}}, ("prior of 'n_s'", "finite", "(nan, 1)")),
        ({"free": ("n_s",), "priors": {"n_s": (1.0,)}}, ("prior of 'n_s'", "two numbers")),
        (
            {"free": ("direction",), "scene": HARD, "bounds": {"direction": (-0.5, 0.5)}},
            ("direction", "no unit vector"),
        ),
    ],
)
def test_what_names_nothing_or_is_no_range_is_refused(options, words):
    refuses(lambda: find_unknowns(**({"scene": ONE, "views": VIEWS, "free": ("k_d",)} | options)), *words)


def test_the_cutoff_of_a_soft_edge_can_be_freed():
    assert names(ds.Scene(ds.Object(ds.Sphere()), [SPOT]), ("cutoff",)) == ["cutoff"]


CONSTRAINTS = (
    ds.Grey("k_a"),
    ds.Proportional("objects.0.material.k_s", "objects.0.material.k_d"),
    ds.Proportional("objects.1.material.k_s", "objects.1.material.k_a", 0.5),
)


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("tied", "constraints"),
    [((), ()), (("attenuation", "k_d", "exposure"), ()), ((), CONSTRAINTS)],
    ids=["free", "tied", "constrained"],
)
def test_what_is_put_back_is_what_the_solver_inserts_and_is_read_again(tied, constraints):
    """`insert`, on stacked lights inside jit, and `put_back`, on the user's scene, must mean the same places."""
    free = ["material.k_a", "k_d", "n_s", "surface", "lights.0.position", "lights.1.direction", "lights.2"]
    free += ["intensity", "attenuation", "constant", "ambient", "exposure", "views.1.black"]
    free += ["objects.0.material.k_s"] if constraints else ["k_s"]
    unknowns = find(MANY_KINDS, free, tied, constraints=constraints)
    values = np.random.default_rng(0).uniform(1.0, 2.0, len(unknowns))
    for unit in slots_of(MANY_KINDS, VIEWS, unknowns).units:
        values[unit] /= np.linalg.norm(values[unit])
    scene, views = put_back(MANY_KINDS, VIEWS, unknowns, values)
    np.testing.assert_allclose(values_in(scene, views, unknowns), values, rtol=1e-15)
    with jax.enable_x64(True):
        problem = prepare(MANY_KINDS, VIEWS, unknowns)
        inserted = problem.slots.insert(coordinates(values, unknowns), problem.setup)
        after = prepare(scene, views, unknowns).setup
        for a, b in zip(jax.tree.leaves(inserted), jax.tree.leaves(after), strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-15)
        assert [float(view.exposure) != 2.0 for view in views] == [True, True]
        assert [float(view.black) != 0.0 for view in views] == [False, True]


def test_a_constraint_holds_wherever_the_unknowns_go():
    free = ("k_a", "k_d", "objects.0.material.k_s")
    unknowns = find(MANY_KINDS, free, constraints=CONSTRAINTS)
    assert len(unknowns) == 2 + 6 + 1  # k_a grey, k_d, the factor
    scene, _ = put_back(MANY_KINDS, VIEWS, unknowns, np.linspace(0.1, 0.9, len(unknowns)))
    first, second = (item.material for item in scene.objects)
    for material in (first, second):
        assert len(set(np.asarray(material.k_a).tolist())) == 1
    np.testing.assert_allclose(first.k_s, 0.9 * np.asarray(first.k_d), rtol=1e-15)
    np.testing.assert_allclose(second.k_s, 0.5 * np.asarray(second.k_a), rtol=1e-15)


def test_a_factor_is_named_by_the_two_that_it_relates_as_briefly_as_other_unknowns():
    assert names(ONE, ("k_s", "k_d"), constraints=[ds.Proportional("k_s", "k_d")])[-1] == "k_s/k_d"
    found = names(MANY_KINDS, ("k_s", "k_d"), constraints=CONSTRAINTS[1:2])
    assert found[-1] == "objects.0.material.k_s/objects.0.material.k_d"


def test_put_back_keeps_the_kinds_of_lights_lobes_and_float64():
    unknowns = find(MANY_KINDS, ("k_d", "views.0.exposure"))
    values = np.linspace(0.1, 0.7, 7)
    changed, views = put_back(MANY_KINDS, VIEWS, unknowns, values)
    assert jax.tree.structure((changed, views)) == jax.tree.structure((MANY_KINDS, VIEWS))
    assert all(isinstance(leaf, np.ndarray) and leaf.dtype == np.float64 for leaf in jax.tree.leaves((changed, views)))
    np.testing.assert_allclose(changed.objects[1].material.k_d, [0.4, 0.5, 0.6], rtol=1e-15)
    assert float(views[0].exposure) == values[6]
    assert float(VIEWS[0].exposure) == 2.0  # the originals are untouched
    np.testing.assert_array_equal(MANY_KINDS.objects[1].material.k_d, [0.5, 0.5, 0.5])


def test_a_known_leaf_is_not_differentiated_through():
    slots = slots_of(ONE, VIEWS, find(ONE, ("k_d",)))
    assert [np.asarray(i).tolist() for i in jax.tree.leaves(slots.indices)] == [[0, 1, 2]]


def test_the_solvers_coordinate_of_n_s_is_its_logarithm_and_natural_undoes_it():
    unknowns = find(ONE, ("k_d", "n_s"))
    values = np.array([0.5, -0.1, 0.0, 40.0])
    theta = coordinates(values, unknowns)
    np.testing.assert_allclose(theta, [0.5, -0.1, 0.0, np.log(40.0)], rtol=1e-15)
    with jax.enable_x64(True):
        np.testing.assert_allclose(natural(theta, np.array([u.logarithmic for u in unknowns])), values, rtol=1e-15)


@pytest.mark.thorough
def test_lights_keep_their_indices_when_kinds_are_stacked():
    """The light positions of an interleaved scene must reach the right light."""
    positions = light_positions(4)
    lights = [ds.PointLight(positions[0]), SPOT, ds.PointLight(positions[1]), ds.DirectionalLight((0, 0, -1))]
    scene = standard_scene(lights=lights)
    unknowns = find(scene, ("lights.2.position",))
    moved, _ = put_back(scene, VIEWS, unknowns, np.array([7.0, 8.0, 9.0]))
    np.testing.assert_array_equal(moved.lights[0].position, positions[0])  # pyright: ignore[reportAttributeAccessIssue]
    np.testing.assert_array_equal(moved.lights[2].position, [7, 8, 9])  # pyright: ignore[reportAttributeAccessIssue]
