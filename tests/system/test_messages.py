"""Bad input ends in one clear sentence that names the thing, the value and the remedy."""

import inspect
from collections.abc import Callable
from typing import Any

import equinox as eqx
import numpy as np
import pytest
from refusals import untyped

import diffshade as ds

CAMERA = ds.Camera(eye=(0, 0, 4), fov=32, shape=(10, 12))
SCENE = ds.Scene(ds.Object(ds.Sphere()), [ds.PointLight((2, 3, 4)), ds.PointLight((-2, 3, 4))])
IMAGE = np.full((10, 12, 3), 0.5)
VIEW = ds.View(IMAGE, CAMERA)
NORMALS = ds.GBuffer(np.full((10, 12, 3), (0.0, 0.0, 1.0)))
RELIEF = ds.GBuffer(NORMALS.normal, np.zeros((10, 12, 3)))
SPHERE = ds.Object(ds.Sphere())
GLOSSY = ds.Object(ds.Sphere(), ds.Material(k_d=0.4, eta=1.5, fresnel=ds.Dielectric()))
PARALLEL = ds.OrthographicCamera((0, 0, 4), shape=(10, 12), local_viewer=False)
FLAPPED = ds.Scene(SPHERE, ds.PointLight((0, 0, 4), flaps=ds.Flaps(x_min=-0.5)))
HARD_SPOT = ds.Scene(SPHERE, ds.SpotLight((0, 0, 4), (0, 0, -1)))
NEGATIVE = eqx.tree_at(lambda s: s.objects[0].material.n_s, SCENE, np.array(-1.0))


def changed(array: np.ndarray, pixel: tuple[int, ...], value: float) -> np.ndarray:
    array = array.copy()
    array[pixel] = value
    return array


def only(*pixels: tuple[int, int]) -> np.ndarray:
    return np.isin(np.arange(120), [12 * row + column for row, column in pixels]).reshape(10, 12)


def view(image: np.ndarray = IMAGE, camera: Any = CAMERA, **options: Any) -> Callable[[], ds.View]:
    return lambda: ds.View(image, camera, **options)


def fit(*views: ds.View, free: Any = ("k_d", "n_s"), scene: ds.Scene = SCENE, **options: Any) -> Callable[[], object]:
    call: Any = inspect.unwrap(ds.fit)  # past type checks around it, which refuse before the library can
    return lambda: call(scene, views or (VIEW,), free=free, **options)


def masked(*pixels: tuple[int, int]) -> ds.View:
    return ds.View(IMAGE, CAMERA, mask=only(*pixels))


def on_normals(height: int = 10, width: int = 12, *, light: Any = None, **options: Any) -> ds.Scene:
    surface = ds.GBuffer(np.full((height, width, 3), (0.0, 0.0, 1.0)))
    return ds.Scene(ds.Object(surface), light or ds.DirectionalLight((0, 0, -1)), **options)


def area(u: Any = (1, 0, 0), v: Any = (0, 1, 0), **options: Any) -> ds.AreaLight:
    return ds.AreaLight((0, 0, 1), u, v, **options)


def glass(eta: float = 1.5, name: str = "") -> ds.Object:
    return ds.Object(ds.Sphere(), ds.Material(k_t=0.9, eta=eta), name)


P, G = ds.Proportional, ds.Grey
HOLED = changed(IMAGE, (4, 7, 1), np.nan)
FROM_AFAR = ds.Scene(SPHERE, ds.DirectionalLight((0, 0, -1)))
BESIDE_GLASS = ds.Scene([ds.Object(RELIEF), glass(1.0)])
NAMED = ds.Scene([glass(1.0, "ball"), ds.Object(ds.Plane())])
TWO: dict[str, Any] = {"free": ("k_s", "k_d")}
UPRIGHT = np.full((4, 4, 3), (0.5, 0.5, 1.0))
CASES: dict[str, tuple[Callable[[], object], str]] = {
    # what was done: the call, and what its message must hold: the thing, the value, the remedy
    "image of integers": (view(np.zeros((10, 12, 3), np.uint8)), "View.image | uint8 | ds.read_image"),
    "mask of another size": (view(mask=np.ones((12, 10), bool)), "View.mask | image's shape | (12, 10) | Resize"),
    "NaN in a mask": (view(mask=changed(np.ones((10, 12)), (3, 5), np.nan)), "View.mask | nan | row 3, column 5"),
    "exposure of 0": (view(exposure=0.0), "View.exposure | 0.0 | Give 1"),
    "a floor above the saturation": (view(floor=0.6, saturation=0.5), "View.floor | 0.6 and 0.5 | Give the levels"),
    "a floor that is no number": (view(floor=float("nan")), "View.floor | number or None | nan | Give the level"),
    "a negative noise": (view(noise=-0.1), "Noise.read | at least 0 | -0.1"),
    "noise that vanishes": (lambda: ds.Noise(shot=0.001), "Noise | dark | 0.0 | Give the standard deviation"),
    "half an sRGB curve": (lambda: ds.Noise(0.1, srgb=0.3), "Noise.srgb | 0 or 1 | 0.3 | Give"),
    "NaN pixel": (fit(VIEW, ds.View(HOLED, CAMERA)), "views[1] | nan | row 4, column 7 | Mask them out"),
    "all pixels masked": (fit(VIEW, masked()), "views[1] | no pixel | the mask is white on the object"),
    "mask beside the object": (fit(masked((0, 0))), "views[0] | no pixel"),
    "all saturated": (fit(ds.View(2 * IMAGE, CAMERA)), "views[0] | saturated | at least 1 | Give a shorter exposure"),
    "all as bright as can be": (
        fit(VIEW, ds.View(IMAGE, CAMERA, saturation=0.5)),
        "views[1] | saturated | 0.5 | shorter",
    ),
    "lit beyond the lights": (fit(VIEW, ds.View(IMAGE, CAMERA, lit=2)), "views[1] | lit | 2 lights | got 2 | Count"),
    "negative lit": (fit(ds.View(IMAGE, CAMERA, lit=-1)), "views[0] | lit | got -1"),
    "unknown parameter": (fit(free=("kd",)), "no parameter is named 'kd' | Did you mean 'k_d'?"),
    "unknown, tied": (fit(tied=("atenuation",)), "no parameter is named 'atenuation' | Did you mean 'attenuation'?"),
    "unknown, constrained": (fit(constraints=[G("kd")]), "no parameter is named 'kd' | Did you mean 'k_d'?"),
    "an object's name": (fit(free="ball.k_t", scene=NAMED), "'ball.k_t' | Did you mean 'ball.material.k_t'?"),
    "tied but not free": (fit(tied=("k_s",)), "tied | 'k_s' | not free | Add it to free"),
    "a light that is on twice": (
        lambda: ds.View(IMAGE, CAMERA, lit=(0, 0)),
        "View.lit | each light once | (0, 0) | Name",
    ),
    "a light that is rendered twice": (
        lambda: ds.render(SCENE, CAMERA, lit=(1, 1)),
        "lit | each light once | [1, 1] | Name",
    ),
    "no views": (lambda: ds.fit(SCENE, (), free="k_d"), "at least one view | got none | Give a View"),
    "nothing free": (fit(free=()), "free | got none | Give for example"),
    "few pixels": (fit(masked((4, 6), (4, 7), (5, 6)), free=("k_a", "k_d", "n_s")), "fewer | 3 for 7 | add views"),
    "nothing but clipped": (fit(ds.View(IMAGE, CAMERA, floor=9.0)), "fewer samples that are not clipped | 0 for 4"),
    "all images black": (fit(ds.View(0 * IMAGE, CAMERA)), "the images are black | above 0 | Check the files and masks"),
    "unknown loss": (fit(loss="cube"), "loss | 'huber' | 'cube' | Give one"),
    "unknown use of clipped samples": (fit(clipped="ignore"), "clipped | 'exclude' | 'ignore' | Give one"),
    "unknown start": (fit(start="truth"), "start | 'search' | 'scene' | 'truth' | Give one"),
    "tobit without noise": (fit(clipped="tobit"), "clipped='tobit' | views[0] has none | Give View.noise"),
    "noise of some": (
        fit(ds.View(IMAGE, CAMERA, noise=1.0), VIEW),
        "views[1] has no noise | views[0] has | Give noise for all",
    ),
    "a moving surface without a mask": (fit(free=("radius",)), "views[0] | needs a mask | got none | Give View.mask"),
    "a hard edge's cutoff": (fit(free="cutoff", scene=HARD_SPOT), "lights.0.cutoff | is 0 | Give lights.0.softness"),
    "a hard flap": (
        fit(free="x_min", scene=FLAPPED),
        "flaps.x_min | is 0 | Give lights.0.flaps.softness | scene units",
    ),
    "eta beside a G-buffer": (fit(free="eta", scene=BESIDE_GLASS), "material.eta cannot be freed | GBuffer | Leave"),
    "k_s beside Dielectric": (fit(free="k_s", scene=ds.Scene(GLOSSY)), "k_s cannot be freed | Dielectric() | Free eta"),
    "bounds the wrong way round": (fit(bounds={"k_d": (1.0, 0.0)}), "bounds of 'k_d' | (1, 0) | Swap or widen them"),
    "contradiction": (fit(bounds={"k_d": (0.5, 0.6), "material.k_d": (0.7, 0.8)}), "k_d | between 0.7 and 0.6 | Widen"),
    "a bound that is no number": (fit(bounds={"k_d": (float("nan"), 0.6)}), "bounds of 'k_d' | nan | 0.6"),
    "a bound outside": (fit(bounds={"k_d": (-1.0, 0.6)}), "bounds of 'k_d' | [0, inf] | (-1, 0.6) | Stay inside"),
    "no direction": (fit(free="direction", bounds={"direction": (0.7, 1.0)}, scene=FROM_AFAR), "no unit vector"),
    "of a follower": (fit(bounds={"k_s": (0, 0.5)}, constraints=P("k_s", "k_d"), **TWO), "'k_s' | follows objects.0"),
    "a prior outside": (fit(priors={"k_d": (-5.0, 0.1)}), "prior of 'k_d' | [0, inf] | -5 | Give a value"),
    "a prior of negative width": (fit(priors={"k_d": (0.5, -0.1)}), "prior of 'k_d' | above 0 | -0.1 | Give (value,"),
    "a prior of three": (fit(priors={"k_d": (0.5, 0.1, 0.2)}), "prior of 'k_d' | two numbers | (0.5, 0.1, 0.2) | Give"),
    "a prior of an exponent below 0": (fit(priors={"n_s": (-3.0, 0.1)}), "prior of 'n_s' | above 0 | -3"),
    "a prior of what is not free": (fit(priors={"k_s": (0.5, 0.1)}), "priors | 'k_s' | not free | Add it to free"),
    "two known colours": (fit(free="n_s", constraints=P("k_s", "k_d", 0.5)), "k_s | both known | Free objects.0"),
    "a grey follower": (fit(**TWO, constraints=(G("k_s"), P("k_s", "k_d"))), "'k_s' | Proportional | Name that"),
    "fixed and free": (fit(**TWO, constraints=[P("k_s", "k_d", 0.5)]), "k_s | is fixed by | 0.5 | free as well"),
    "constrained, not free": (fit(constraints=[G("k_s")]), "constraints | 'k_s' | not free | Add it to free"),
    "a proportion of n_s": (fit(constraints=[P("n_s", "k_d")]), "k_a, k_d and k_s | 'n_s' | Name one of these"),
    "a grey position": (fit(free=("k_d", "position"), constraints=[G("position")]), "Grey | 'position' | Leave it out"),
    "a proportion below 0": (fit(free="k_d", constraints=[P("k_s", "k_d", -1.0)]), "factor | k_s | at least 0 | -1.0"),
    "a colour in proportion to itself": (fit(constraints=[P("k_d", "k_d")]), "k_d | does not say | Name one"),
    "G-buffer of another size": (fit(ds.View(IMAGE, PARALLEL), scene=on_normals(9)), "views[0] | (9, 12) | (10, 12)"),
    "no positions": (fit(scene=on_normals()), "views[0] | GBuffer without positions | Give GBuffer.position"),
    "negative n_s by tree_at": (fit(scene=NEGATIVE), "Material.n_s | at least 0 | -1"),
    "scene without objects": (lambda: ds.Scene([]), "Scene.objects | at least one Object | got none | Give one"),
    "one name twice": (lambda: ds.Scene([glass(name="a")] * 2), "different names | 'a' twice | Rename one"),
    "a plane that faces nowhere": (lambda: ds.Plane(normal=(0, 0, 0)), "Plane.normal | zero vector | [0, 0, 0] | Give"),
    "samples that are a switch": (lambda: area(samples=True), "AreaLight.samples | got True | Give (8, 8)"),
    "edges that are nearly parallel": (
        lambda: area((0.1, 0.2, 0.3), (0.3, 0.6, 0.9)),
        "edge_u and edge_v | rectangle | Give two",
    ),
    "an area light": (lambda: ds.render(on_normals(light=area()), PARALLEL), "an AreaLight | Give GBuffer.position"),
    "a map behind glass": (lambda: ds.Scene([ds.Object(RELIEF), glass()]), "GBuffer | eta 1.5 in objects[1] | Give"),
    "a pattern out of range": (lambda: ds.Material(k_t=ds.Chequer(0, 3)), "Material.k_t.b | between 0 and 1 | (3, 3"),
    "a pattern along nothing": (lambda: ds.Chequer(0, 1, u=(0, 0, 0)), "Chequer.u | zero vector | Give a direction"),
    "a normal map that is none": (lambda: ds.normal_map(IMAGE), "normal map | row 0, column 0 | without the sRGB"),
    "a map's mask": (lambda: ds.normal_map(UPRIGHT, mask=np.ones((3, 4))), "mask of a normal map | (4, 4) | (3, 4)"),
    "a height map": (lambda: ds.height_map(np.zeros((12, 10)), PARALLEL), "height map | (10, 12) | (12, 10) | Resize"),
    "a hill's mask": (lambda: ds.height_map(IMAGE[..., 0], PARALLEL, mask=np.ones(3)), "mask of | (10, 12) | (3,)"),
    "a hole": (lambda: ds.height_map(HOLED[..., 1], PARALLEL), "finite | nan at row 4, column 7 | Mask it out"),
}


def assert_one_clear_sentence(message: str, parts: str) -> None:
    assert "\n" not in message
    assert message.endswith((".", "?"))
    assert ".." not in message  # such as a number's own point before the full stop
    assert len(message) < 300
    for part in parts.split(" | "):
        assert part in message


@pytest.mark.parametrize("name", CASES)
def test_bad_input_ends_in_a_sentence(name):
    call, parts = CASES[name]
    with pytest.raises(ValueError) as refusal:  # noqa: PT011 (the sentence is looked at below)
        call()
    assert_one_clear_sentence(str(refusal.value), parts)


def fit_with(**options: Any) -> object:
    free = options.pop("free", "k_d")
    return fit(free=free, **options)()


WRONG_TYPES = {
    "ds.render(CAMERA, SCENE)": "scene must be a Scene | got | Give for example Scene(",
    "ds.render(SCENE, CAMERA, samples=2, key=0)": "key must be a key of JAX | got 0 | Give jax.random.key(0)",
    "ds.View(IMAGE, CAMERA, lit=0.5)": "View.lit | indices of lights | 0.5 | Give for example (0, 2)",
    "fit_with(constraints=('k_s',))": "constraints[0] | a Grey or a Proportional | 'k_s' | Grey('k_s')",
    "fit_with(free=(3,))": "free must hold names of parameters | got 3 | 'k_d'",
    "fit_with(constraints=ds.Grey(3))": "constraints must hold names of parameters | got 3 | 'k_d'",
    "fit_with(bounds=[('k_d', (0, 1))])": "bounds must be a Mapping | got list | {'k_s': (0, 1)}",
    "ds.Scene(ds.Sphere())": "Scene.objects[0] | an Object | Sphere | Object(",
    "ds.Scene(SPHERE, SPHERE)": "Scene.lights[0] | a Light | Object | PointLight(",
    "ds.Material(n_s=ds.Chequer(1, 2))": "Material.n_s must be a Texture | got Chequer | Texture(image)",
    "ds.material(3)": "the name of a material | got 3 | 'emerald'",
    "ds.exchange.read_mesh('ball.obj', 'camera')": "camera must be a Camera | got str | Camera(eye=(0, 0, 4))",
    "ds.normal_map('map.png')": "a normal map | the path 'map.png' | ds.read_image(path, srgb=False)",
    "ds.height_map(np.zeros((6, 6)), CAMERA)": "an OrthographicCamera | got Camera | OrthographicCamera(eye=",
    "ds.lecture.write_figures(3)": "folder must be a path | got 3 | Give the name of a folder",
    "ds.lecture.write_figures('figures', only=3)": "only must hold names of figures | got 3 | 'diffuse_over_k_d'",
    "ds.write_report(3, SCENE)": "path must be a path | got 3 | 'fit.html'",
    "ds.write_report('fit.html', SCENE)": "result must be a Fit | got Scene | ds.fit(scene, views, free=('k_d',))",
    "ds.sensitivity(SCENE, 'k_d')": "fit must be a Fit | got Scene | ds.fit(scene, views, free=('k_d',))",
}


@untyped
@pytest.mark.parametrize("call", WRONG_TYPES)
def test_values_of_the_wrong_type_end_in_a_sentence(call):
    with pytest.raises(TypeError) as refusal:
        eval(call)
    assert_one_clear_sentence(str(refusal.value), WRONG_TYPES[call])
