"""Places: where each number of a scene and its views is, how its path reads, and what is beside it."""

import numpy as np
import pytest

import diffshade as ds
from diffshade.inverse.unknowns.names import is_named, means, rest_after
from diffshade.inverse.unknowns.parameters import find_unknowns
from diffshade.inverse.unknowns.places import Place, everything

TWO_LOBES = ds.Material(0.1, 0.5, 0.3, 20, highlights=[ds.Highlight(0.2, 80)])
SCENE = ds.Scene(
    [ds.Object(ds.Sphere(), TWO_LOBES, "ball"), ds.Object(ds.Plane())],
    [ds.PointLight((2, 3, 4))],
    atmosphere=ds.Fog(density=0.1, I_dc=0.5),
)
CAMERA = ds.Camera((0, 0, 4), shape=(2, 2))
VIEWS = (ds.View(np.full((2, 2), 0.5), CAMERA), ds.View(np.full((2, 2), 0.5), CAMERA, sensor=ds.Sensor(gamma=2.2)))
K_S = Place("objects", 0, ("material", "highlights", 0, "k_s"), name="ball")


def test_every_place_has_its_value_and_its_path_names_it_alone():
    found = list(everything(SCENE, VIEWS))
    assert len({place for place, _, _ in found}) == len({place.path for place, _, _ in found}) == len(found)
    assert all(place.value_in(SCENE, VIEWS) is value for place, value, _ in found)
    for of, _, _ in found:
        assert [place for place, _, _ in found if rest_after(of.path, place) == ""] == [of]


@pytest.mark.parametrize(
    ("place", "path"),
    [
        (K_S, "objects.ball.material.highlights.0.k_s"),
        (Place("lights", 0, ("attenuation", "linear")), "lights.0.attenuation.linear"),
        (Place("views", 1, ("sensor", "vignetting", "second")), "views.1.sensor.vignetting.second"),
        (Place("scene", None, ("ambient",)), "ambient"),
        (Place("scene", None, ("atmosphere", "density")), "atmosphere.density"),
    ],
)
def test_a_path_is_the_printed_form_of_a_place(place, path):
    assert str(place) == str(place.at(1)) == path
    assert path in [str(place) for place, _, _ in everything(SCENE, VIEWS)]


def test_views_have_no_gains_of_red_and_blue_in_bands():
    view = ds.View(np.full((2, 2), 0.5), CAMERA, sensor=ds.Sensor())
    bands = ds.Scene(ds.Object(ds.Sphere()), bands=4)
    names = [{str(place.field) for place, _, _ in everything(scene, [view])} for scene in (SCENE, bands)]
    assert names[0] >= {"red", "blue", "gamma"}
    assert names[1] & {"red", "blue", "gamma"} == {"gamma"}


def test_a_place_tells_what_it_is_in_and_what_is_beside_it():
    assert (K_S.part, K_S.field) == ("material", "k_s")
    assert K_S.beside("n_s") == Place("objects", 0, ("material", "highlights", 0, "n_s"))
    assert K_S.beside("n_s").holder == K_S.holder != Place("objects", 0, ("material", "k_s")).holder
    assert K_S.at(2) != K_S == K_S.at(2).whole
    assert Place("objects", 0, K_S.fields) == K_S  # whatever the object is called


def test_a_name_is_a_run_of_whole_segments_with_the_channel_or_without():
    green = find_unknowns(SCENE, VIEWS, ("highlights.0.k_s",))[1]
    (place,) = green.places
    for name in ("k_s", "highlights", "ball.material", "0.k_s", "objects.ball.material.highlights.0.k_s", "k_s.g"):
        assert is_named(name, green), name
    for name in ("k_s.r", "g", "s", "material.k_s", "objects.0", "k_s.", ""):
        assert not is_named(name, green), name
    assert rest_after("material", place) == "highlights.0.k_s"


def test_ambient_is_the_scenes_alone():
    assert means("ambient", Place("scene", None, ("ambient",)))
    assert not means("ambient", Place("lights", 0, ("ambient",)))
    assert means("lights.0.ambient", Place("lights", 0, ("ambient",)))


def test_an_intensity_that_is_solved_for_as_its_logarithm_stays_above_a_millionth():
    (intensity,) = find_unknowns(SCENE, VIEWS, ("intensity",), intensity_error=0.05, grey=True)
    assert intensity.logarithmic
    assert (intensity.lower, intensity.prior) == (1e-6, (0.0, 0.05))
    dark = ds.Scene(SCENE.objects, [ds.PointLight((2, 3, 4), 0.0)])
    with pytest.raises(ValueError, match="no error is relative"):
        find_unknowns(dark, VIEWS, ("intensity",), intensity_error=0.05)
