"""Bad input ends in one clear sentence that names the thing, the value and the remedy."""

import inspect
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import equinox as eqx
import numpy as np
import pytest

import diffshade as ds

CAMERA = ds.Camera(eye=(0, 0, 4), fov=32, shape=(10, 12))
SCENE = ds.Scene(ds.Object(ds.Sphere()), [ds.PointLight((2, 3, 4)), ds.PointLight((-2, 3, 4))])
IMAGE = np.full((10, 12, 3), 0.5)
VIEW = ds.View(IMAGE, CAMERA)


def only(*pixels: tuple[int, int]) -> np.ndarray:
    mask = np.zeros((10, 12), bool)
    for pixel in pixels:
        mask[pixel] = True
    return mask


def with_nan() -> np.ndarray:
    image = IMAGE.copy()
    image[4, 7, 1] = np.nan
    return image


def fit(*views: ds.View, free: Any = ("k_d", "n_s"), scene: ds.Scene = SCENE, **options: Any) -> Callable[[], object]:
    return lambda: ds.fit(scene, views, free=free, **options)


def gbuffer_scene(height: int, width: int) -> ds.Scene:
    normal = np.zeros((height, width, 3))
    normal[..., 2] = 1.0
    return ds.Scene(ds.Object(ds.GBuffer(normal)), ds.DirectionalLight((0, 0, -1)))


def mask_with_nan() -> np.ndarray:
    mask = np.ones((10, 12))
    mask[3, 5] = np.nan
    return mask


def unknown_start() -> None:
    # past the type checker of these tests, which refuses what is not one of the two before the library can
    inspect.unwrap(ds.fit)(SCENE, VIEW, free="k_d", start="truth")  # pyright: ignore[reportArgumentType]


def relief() -> ds.GBuffer:
    return ds.GBuffer(np.full((10, 12, 3), (0.0, 0.0, 1.0)), np.zeros((10, 12, 3)))


def glass(eta: float = 1.5, name: str = "") -> ds.Object:
    return ds.Object(ds.Sphere(), ds.Material(k_t=0.9, eta=eta), name)


def none(leaf: object) -> bool:
    return leaf is None


NORMALS = ds.GBuffer(np.full((10, 12, 3), (0.0, 0.0, 1.0)))
WITH_A_DIRECTION = ds.Scene(ds.Object(ds.Sphere()), ds.DirectionalLight((0, 0, -1)))
GLOSSY = ds.Material(k_d=0.4, eta=1.5, fresnel=ds.Dielectric())
PARALLEL = ds.OrthographicCamera((0, 0, 4), shape=(10, 12), local_viewer=False)

CASES: dict[str, tuple[Callable[[], object], type[Exception], tuple[str, ...]]] = {
    # what was done: the call, the error, and what its message must hold: the thing, the value, the remedy
    "image and camera of different size": (
        lambda: ds.View(np.zeros((12, 10, 3)), CAMERA),
        ValueError,
        ("View.image", "(12, 10)", "(10, 12)", "Give the camera shape=(12, 10)."),
    ),
    "image of integers": (
        lambda: ds.View(np.zeros((10, 12, 3), np.uint8), CAMERA),
        ValueError,
        ("View.image", "uint8", "ds.read_image"),
    ),
    "mask of another size": (
        lambda: ds.View(IMAGE, CAMERA, mask=np.ones((12, 10), bool)),
        ValueError,
        ("View.mask", "(12, 10)", "Resize it."),
    ),
    "exposure of 0": (
        lambda: ds.View(IMAGE, CAMERA, exposure=0.0),
        ValueError,
        ("View.exposure", "0.0", "Give 1 if it is not known."),
    ),
    "NaN pixel": (
        fit(VIEW, ds.View(with_nan(), CAMERA)),
        ValueError,
        ("views[1]", "nan", "row 4, column 7", "Mask them out."),
    ),
    "all pixels masked": (
        fit(VIEW, ds.View(IMAGE, CAMERA, mask=only())),
        ValueError,
        ("views[1]", "no pixel is left to fit", "Check that the mask is white on the object"),
    ),
    "mask beside the object": (fit(ds.View(IMAGE, CAMERA, mask=only((0, 0)))), ValueError, ("views[0]", "no pixel")),
    "all pixels saturated": (
        fit(ds.View(np.ones((10, 12, 3)), CAMERA)),
        ValueError,
        ("views[0]", "saturated", "at least 1", "Give a shorter exposure."),
    ),
    "lit beyond the lights": (
        fit(VIEW, ds.View(IMAGE, CAMERA, lit=2)),
        ValueError,
        ("views[1]", "lit", "2 lights", "got 2", "Count the lights"),
    ),
    "negative lit": (fit(ds.View(IMAGE, CAMERA, lit=-1)), ValueError, ("views[0]", "lit", "got -1")),
    "unknown parameter": (
        fit(VIEW, free=("kd",)),
        ValueError,
        ("no parameter is named 'kd'", "Did you mean 'k_d'?"),
    ),
    "unknown parameter, tied": (
        fit(VIEW, tied=("atenuation",)),
        ValueError,
        ("no parameter is named 'atenuation'", "Did you mean 'attenuation'?"),
    ),
    "tied but not free": (fit(VIEW, tied=("k_s",)), ValueError, ("tied", "'k_s'", "not free", "Add it to free")),
    "bounds the wrong way round": (
        fit(VIEW, bounds={"k_d": (1.0, 0.0)}),
        ValueError,
        ("bounds of 'k_d'", "(1, 0)", "Swap or widen them."),
    ),
    "no views": (fit(), ValueError, ("at least one view", "got none", "Give a View for each photograph.")),
    "nothing free": (fit(VIEW, free=()), ValueError, ("free", "got none", "Give for example")),
    "fewer pixels than unknowns": (
        fit(ds.View(IMAGE, CAMERA, mask=only((4, 6), (4, 7), (5, 6))), free=("k_a", "k_d", "n_s")),
        ValueError,
        ("fewer pixels", "3 for 7", "Free fewer parameters or add views."),
    ),
    "nothing but clipped samples": (
        fit(ds.View(IMAGE, CAMERA, floor=100.0)),
        ValueError,
        ("fewer samples that are not clipped", "0 for 4", "Free fewer parameters or add views."),
    ),
    "a floor above the saturation": (
        lambda: ds.View(IMAGE, CAMERA, floor=0.6, saturation=0.5),
        ValueError,
        ("View.floor", "0.6 and 0.5", "Give the levels"),
    ),
    "half an sRGB curve": (lambda: ds.Noise(0.1, srgb=0.3), ValueError, ("Noise.srgb", "0 or 1", "0.3", "Give")),
    "a proportion of two known colours": (
        fit(VIEW, free="n_s", constraints=ds.Proportional("k_s", "k_d", 0.5)),
        ValueError,
        ("k_s", "k_d", "both known", "Free objects.0.material.k_d"),
    ),
    "a grey colour that follows another": (
        fit(VIEW, free=("k_s", "k_d"), constraints=(ds.Grey("k_s"), ds.Proportional("k_s", "k_d"))),
        ValueError,
        ("Grey", "'k_s'", "Proportional", "Name that instead."),
    ),
    "a prior outside of the bounds": (
        fit(VIEW, priors={"k_d": (-5.0, 0.1)}),
        ValueError,
        ("prior of 'k_d'", "[0, inf]", "-5", "Give a value in that range"),
    ),
    "bounds that hold no direction": (
        fit(VIEW, free="direction", bounds={"direction": (0.7, 1.0)}, scene=WITH_A_DIRECTION),
        ValueError,
        ("direction", "no unit vector", "Widen them"),
    ),
    "a moving surface without a mask": (
        fit(VIEW, free=("radius",)),
        ValueError,
        ("views[0]", "needs a mask", "got none", "Give View.mask."),
    ),
    "a hard edge's cutoff": (
        fit(VIEW, free="cutoff", scene=ds.Scene(ds.Object(ds.Sphere()), ds.SpotLight((0, 0, 4), (0, 0, -1)))),
        ValueError,
        ("lights.0.cutoff", "softness is 0", "Give lights.0.softness"),
    ),
    "all images black": (
        fit(ds.View(np.zeros((10, 12, 3)), CAMERA), ds.View(np.zeros((10, 12, 3)), CAMERA)),
        ValueError,
        ("the images are black", "above 0", "Check the files and masks."),
    ),
    "bounds that contradict each other": (
        fit(VIEW, bounds={"k_d": (0.5, 0.6), "material.k_d": (0.7, 0.8)}),
        ValueError,
        ("bounds", "k_d", "between 0.7 and 0.6", "Widen one of them."),
    ),
    "a bound that is no number": (
        fit(VIEW, bounds={"k_d": (float("nan"), 0.6)}),
        ValueError,
        ("bounds of 'k_d'", "nan", "0.6"),
    ),
    "a bound outside what the number can be": (
        fit(VIEW, bounds={"k_d": (-1.0, 0.6)}),
        ValueError,
        ("bounds of 'k_d'", "[0, inf]", "(-1, 0.6)", "Stay inside it."),
    ),
    "a prior of negative width": (
        fit(VIEW, priors={"k_d": (0.5, -0.1)}),
        ValueError,
        ("prior of 'k_d'", "above 0", "-0.1", "Give (value, standard deviation)."),
    ),
    "a prior of three numbers": (
        fit(VIEW, priors={"k_d": (0.5, 0.1, 0.2)}),
        ValueError,
        ("prior of 'k_d'", "two numbers", "(0.5, 0.1, 0.2)", "Give (value, standard deviation)."),
    ),
    "a prior of an exponent below 0": (
        fit(VIEW, priors={"n_s": (-3.0, 0.1)}),
        ValueError,
        ("prior of 'n_s'", "above 0", "-3"),
    ),
    "a prior of what is not free": (
        fit(VIEW, priors={"k_s": (0.5, 0.1)}),
        ValueError,
        ("priors", "'k_s'", "not free", "Add it to free"),
    ),
    "NaN in a mask": (
        lambda: ds.View(IMAGE, CAMERA, mask=mask_with_nan()),
        ValueError,
        ("View.mask", "nan", "row 3, column 5", "Give 0 or 1."),
    ),
    "fixed by a constraint and free": (
        fit(VIEW, free=("k_d", "k_s"), constraints=[ds.Proportional("k_s", "k_d", 0.5)]),
        ValueError,
        ("k_s", "is fixed by", "0.5", "free as well", "Leave it out of free"),
    ),
    "a constraint on what is not free": (
        fit(VIEW, constraints=[ds.Grey("k_s")]),
        ValueError,
        ("constraints", "'k_s'", "not free", "Add it to free, or leave it out."),
    ),
    "a constraint on what is not there": (
        fit(VIEW, constraints=[ds.Grey("kd")]),
        ValueError,
        ("no parameter is named 'kd'", "Did you mean 'k_d'?"),
    ),
    "a proportion of what is no colour": (
        fit(VIEW, constraints=[ds.Proportional("n_s", "k_d")]),
        ValueError,
        ("Proportional", "k_a, k_d and k_s", "'n_s'", "Name one of these."),
    ),
    "a position that is to be grey": (
        fit(VIEW, free=("k_d", "position"), constraints=[ds.Grey("position")]),
        ValueError,
        ("Grey", "'position'", "none", "Leave it out."),
    ),
    "bounds of what follows another": (
        fit(VIEW, free=("k_s", "k_d"), constraints=[ds.Proportional("k_s", "k_d")], bounds={"k_s": (0.0, 0.5)}),
        ValueError,
        ("bounds", "'k_s'", "follows objects.0.material.k_d", "Name that instead."),
    ),
    "a proportion below 0": (
        fit(VIEW, free="k_d", constraints=[ds.Proportional("k_s", "k_d", -1.0)]),
        ValueError,
        ("factor", "k_s", "at least 0", "-1.0"),
    ),
    "a colour in proportion to itself": (
        fit(VIEW, constraints=[ds.Proportional("k_d", "k_d")]),
        ValueError,
        ("k_d", "does not say", "Name one"),
    ),
    "unknown loss": (fit(VIEW, loss="tukey"), ValueError, ("loss", "'huber'", "'tukey'", "Give one of them.")),
    "unknown use of clipped samples": (
        fit(VIEW, clipped="ignore"),
        ValueError,
        ("clipped", "'leave out'", "'ignore'", "Give one of them."),
    ),
    "unknown start": (unknown_start, ValueError, ("start", "'search'", "'scene'", "'truth'", "Give one of them.")),
    "tobit without noise": (
        fit(VIEW, clipped="tobit"),
        ValueError,
        ("clipped='tobit'", "noise", "views[0] has none", "Give View.noise."),
    ),
    "noise of some views only": (
        fit(ds.View(IMAGE, CAMERA, noise=0.01), VIEW),
        ValueError,
        ("views[1] has no noise", "views[0] has", "Give all of them or none."),
    ),
    "noise that vanishes in the dark": (
        lambda: ds.Noise(shot=0.001),
        ValueError,
        ("Noise", "dark", "0.0", "Give the standard deviation"),
    ),
    "a negative noise": (lambda: ds.View(IMAGE, CAMERA, noise=-0.1), ValueError, ("Noise.read", "at least 0", "-0.1")),
    "a floor that is no number": (
        lambda: ds.View(IMAGE, CAMERA, floor=float("nan")),
        ValueError,
        ("View.floor", "nan", "Give the level in the image."),
    ),
    "G-buffer of another size than the photograph": (
        fit(ds.View(IMAGE, PARALLEL), scene=gbuffer_scene(9, 12)),
        ValueError,
        ("views[0]", "objects[0].surface", "(9, 12)", "(10, 12)", "Make the two the same."),
    ),
    "G-buffer without positions": (
        fit(VIEW, scene=gbuffer_scene(10, 12)),
        ValueError,
        ("views[0]", "GBuffer without positions", "Give GBuffer.position"),
    ),
    "negative n_s": (lambda: ds.Material(n_s=-1.0), ValueError, ("Material.n_s", "at least 0", "-1", "Give")),
    "negative n_s by tree_at": (
        fit(VIEW, scene=eqx.tree_at(lambda s: s.objects[0].material.n_s, SCENE, np.array(-1.0))),
        ValueError,
        ("Material.n_s", "at least 0", "-1"),
    ),
    "colour of two numbers": (
        lambda: ds.Material(k_d=(0.1, 0.2)),
        ValueError,
        ("Material.k_d", "shape (2,)", "Give one number (grey) or three (R, G, B)."),
    ),
    "colour that is not finite": (lambda: ds.Material(k_d=float("nan")), ValueError, ("Material.k_d", "finite", "nan")),
    "colour that is no number": (lambda: ds.Material(k_d="red"), TypeError, ("Material.k_d", "'red'", "Give")),
    "scene without objects": (lambda: ds.Scene(()), ValueError, ("Scene.objects", "got none", "Give one")),
    "k_s beside Fresnel's equations": (
        lambda: ds.Material(k_s=0.5, fresnel=ds.Dielectric()),
        ValueError,
        ("Material.k_s", "Dielectric", "0.5", "Leave k_s out, or use Schlick()."),
    ),
    "k_t above 1": (lambda: ds.Material(k_t=1.5), ValueError, ("Material.k_t", "between 0 and 1", "1.5", "Give")),
    "a plane that faces nowhere": (lambda: ds.Plane(normal=(0, 0, 0)), ValueError, ("Plane.normal", "zero", "Give")),
    "a flat box": (lambda: ds.Box(size=(1, 0, 1)), ValueError, ("Box.size", "above 0", "Give width")),
    "a chequer of no period": (lambda: ds.Chequer(0, 1, 0), ValueError, ("Chequer.period", "above 0", "Give")),
    "an area light of no samples": (
        lambda: ds.AreaLight((0, 0, 1), (1, 0, 0), (0, 1, 0), samples=0),
        ValueError,
        ("AreaLight.samples", "above 0", "(0, 0)", "Give (8, 8), or 8 for both."),
    ),
    "an area light of no area": (
        lambda: ds.AreaLight((0, 0, 1), (1, 0, 0), (-2, 0, 0)),
        ValueError,
        ("AreaLight.edge_u and edge_v", "rectangle", "Give two edges"),
    ),
    "depth cueing back to front": (
        lambda: ds.DepthCueing(5, 3),
        ValueError,
        ("DepthCueing.z_f", "5.0 and 3.0", "Give"),
    ),
    "a name of two words": (
        lambda: ds.Object(ds.Sphere(), name="my ball"),
        ValueError,
        ("Object.name", "one word", "'my ball'", "Rename it."),
    ),
    "one name twice": (
        lambda: ds.Scene([ds.Object(ds.Sphere(), name="a"), ds.Object(ds.Sphere(), name="a")]),
        ValueError,
        ("different names", "'a' twice", "Rename one"),
    ),
    "fog on normals alone": (
        lambda: ds.render(
            eqx.tree_at(lambda s: s.atmosphere, gbuffer_scene(10, 12), ds.Fog(0.1), is_leaf=none), PARALLEL
        ),
        ValueError,
        ("a Fog", "GBuffer without positions", "Give GBuffer.position"),
    ),
    "a pattern on normals alone": (
        lambda: ds.shade(ds.Scene(ds.Object(ds.Sphere(), ds.Material(k_a=ds.Chequer(0, 1)))), NORMALS, PARALLEL),
        ValueError,
        ("a Chequer", "GBuffer without positions", "Give GBuffer.position"),
    ),
    "a material of a wrong name": (
        lambda: ds.material("emerold"),
        ValueError,
        ("'emerold'", "Did you mean 'emerald'?"),
    ),
    "a mesh that is missing": (
        lambda: ds.read_mesh("nowhere.obj", CAMERA),
        FileNotFoundError,
        ("nowhere.obj", "no mesh file", "Give the path"),
    ),
    "a normal map that is none": (
        lambda: ds.normal_map(IMAGE),
        ValueError,
        ("normal map", "row 0, column 0", "without the sRGB curve"),
    ),
    "a height map of another size": (
        lambda: ds.height_map(np.zeros((12, 10)), PARALLEL),
        ValueError,
        ("height map", "(10, 12)", "(12, 10)", "Resize it."),
    ),
    "edges that are parallel but for a rounding": (
        lambda: ds.AreaLight((0, 0, 1), (0.1, 0.2, 0.3), (0.3, 0.6, 0.9)),
        ValueError,
        ("AreaLight.edge_u and edge_v", "Give two edges"),
    ),
    "samples that are a switch": (
        lambda: ds.AreaLight((0, 0, 1), (1, 0, 0), (0, 1, 0), samples=True),  # pyright: ignore[reportArgumentType]
        ValueError,
        ("AreaLight.samples", "got True", "Give (8, 8)"),
    ),
    "a pattern out of its field's range": (
        lambda: ds.Material(k_t=ds.Chequer(0, 3)),
        ValueError,
        ("Material.k_t.b must be between 0 and 1; got (3, 3, 3).", "Give a value in that range."),
    ),
    "a pattern of k_s beside Dielectric": (
        lambda: ds.Material(k_s=ds.Chequer(0, 1), eta=1.5, fresnel=ds.Dielectric()),
        ValueError,
        ("Material.k_s", "Dielectric()", "got a Chequer", "Leave k_s out"),
    ),
    "a pattern along nothing": (
        lambda: ds.Chequer(0, 1, u=(0, 0, 0)),
        ValueError,
        ("Chequer.u", "zero vector", "Give a direction"),
    ),
    "a G-buffer behind glass that bends": (
        lambda: ds.Scene([ds.Object(relief()), glass()]),
        ValueError,
        ("GBuffer", "got eta 1.5 in objects[1]", "Give eta=1, or a Sphere, Plane or Box"),
    ),
    "eta free beside a G-buffer": (
        fit(VIEW, free="eta", scene=ds.Scene([ds.Object(relief()), glass(1.0)])),
        ValueError,
        ("objects.1.material.eta cannot be freed", "GBuffer", "Leave eta out"),
    ),
    "k_s free beside Dielectric": (
        fit(VIEW, free=("k_d", "k_s"), scene=ds.Scene(ds.Object(ds.Sphere(), GLOSSY))),
        ValueError,
        ("objects.0.material.k_s cannot be freed", "Dielectric()", "Free eta instead"),
    ),
    "a name of an object without its material": (
        fit(VIEW, free="ball.k_t", scene=ds.Scene([glass(1.0, "ball"), ds.Object(ds.Plane())])),
        ValueError,
        ("no parameter is named 'ball.k_t'", "Did you mean 'ball.material.k_t'?"),
    ),
    "an area light on normals alone": (
        lambda: ds.render(
            ds.Scene(ds.Object(NORMALS), ds.AreaLight((0, 0, 1), (1, 0, 0), (0, 1, 0))),
            PARALLEL,
        ),
        ValueError,
        ("an AreaLight needs to know", "Give GBuffer.position"),
    ),
    "a normal map's mask of another size": (
        lambda: ds.normal_map(np.full((4, 4, 3), (0.5, 0.5, 1.0)), mask=np.ones((3, 4))),
        ValueError,
        ("mask of a normal map", "(4, 4)", "(3, 4)", "Resize it."),
    ),
    "a height map's mask of another size": (
        lambda: ds.height_map(np.zeros((10, 12)), PARALLEL, mask=np.ones((3, 4))),
        ValueError,
        ("mask of a height map", "(10, 12)", "(3, 4)", "Resize it."),
    ),
    "a hole in a height map": (
        lambda: ds.height_map(np.where(np.eye(10, 12) > 0, np.nan, 0.0), PARALLEL),
        ValueError,
        ("a height map must be finite", "nan at row 0, column 0", "Mask it out."),
    ),
    "surface for an object": (
        lambda: ds.Scene(ds.Sphere()),  # pyright: ignore[reportArgumentType]
        TypeError,
        ("Scene.objects[0]", "Sphere", "Object("),
    ),
    "object for a light": (
        lambda: ds.Scene(ds.Object(ds.Sphere()), ds.Object(ds.Sphere())),  # pyright: ignore[reportArgumentType]
        TypeError,
        ("Scene.lights[0]", "Object", "PointLight("),
    ),
}


def assert_one_clear_sentence(message: str) -> None:
    assert "\n" not in message
    assert message.endswith((".", "?"))
    assert ".." not in message  # such as a number's own point before the full stop
    assert len(message) < 300
    assert "Traceback" not in message


@pytest.mark.parametrize("name", CASES)
def test_bad_input_ends_in_a_sentence(name):
    call, error, parts = CASES[name]
    with pytest.raises(error) as refusal:
        call()
    message = str(refusal.value)
    assert_one_clear_sentence(message)
    for part in parts:
        assert part in message


WRONG_TYPES = {
    "ds.View(image, camera, lit=0.5)": "View.lit must hold indices of lights; got 0.5. Give for example (0, 2).",
    "fit(constraints=('k_s',))": "constraints[0] must be a Grey or a Proportional; got 'k_s'. "
    "Give for example Grey('k_s').",
    "fit(free=(3,))": "free must hold names of parameters; got 3. Give for example 'k_d'.",
    "fit(constraints=ds.Grey(3))": "constraints must hold names of parameters; got 3. Give for example 'k_d'.",
    "fit(bounds=[('k_d', (0, 1))])": "bounds must be a Mapping; got list. Give for example {'k_s': (0, 1)}.",
    "ds.Material(n_s=ds.Chequer(1, 2))": "Material.n_s must be 1 or 3 numbers; got a Chequer. "
    "Give one number, or one a channel (R, G, B).",
    "ds.material(3)": "the name of a material must be a word; got 3. Give for example 'emerald'.",
    "ds.read_mesh('ball.obj', 'camera')": "camera must be a Camera; got str. Give for example Camera(eye=(0, 0, 4)).",
    "ds.normal_map('map.png')": "a normal map must be an array; got the path 'map.png'. "
    "Read it with ds.read_image(path, srgb=False).",
    "ds.height_map(np.zeros((6, 6)), camera)": "camera must be an OrthographicCamera; got Camera. "
    "Give for example OrthographicCamera(eye=(0, 0, 4), height=2.2).",
    "ds.write_figures(3)": "folder must be a path; got 3. Give the name of a folder.",
    "ds.write_figures('figures', only=3)": "only must hold names of figures; got 3. "
    "Give for example 'diffuse_over_k_d'.",
    "ds.write_report(3, scene)": "path must be a path; got 3. Give for example 'fit.html'.",
    "ds.write_report('fit.html', scene)": "fit must be a Fit; got Scene. "
    "Give for example ds.fit(scene, views, free=('k_d',)).",
    "ds.sensitivity(scene, 'k_d')": "fit must be a Fit; got Scene. "
    "Give for example ds.fit(scene, views, free=('k_d',)).",
}


def test_values_of_the_wrong_type_end_in_a_sentence():
    """In a program of its own, without the checks that these tests put around every call."""
    program = f"""
import numpy as np
import diffshade as ds
camera = ds.Camera((0, 0, 4), shape=(6, 6))
image = np.full((6, 6, 3), 0.5)
scene = ds.Scene(ds.Object(ds.Sphere(radius=2)), ds.DirectionalLight((0, 0, -1)))
fit = lambda **options: ds.fit(scene, ds.View(image, camera), **({{"free": "k_d"}} | options))
for call in {list(WRONG_TYPES)}:
    try:
        eval(call)
    except TypeError as error:
        print(error)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert done.stderr == ""
    assert done.stdout.splitlines() == list(WRONG_TYPES.values())


def test_a_file_that_is_missing(tmp_path: Path):
    with pytest.raises(FileNotFoundError) as refusal:
        ds.read_image(tmp_path / "ball.png")
    assert_one_clear_sentence(str(refusal.value))
    assert str(tmp_path / "ball.png") in str(refusal.value)


@pytest.mark.parametrize("kept", [0, 20, 0.5, 0.99])
def test_a_png_that_is_cut_off(tmp_path: Path, kept):
    path = tmp_path / "ball.png"
    ds.write_image(path, np.random.default_rng(0).uniform(0.0, 1.0, (10, 12, 3)))
    data = path.read_bytes()
    path.write_bytes(data[: kept if kept in (0, 20) else int(kept * len(data))])
    with pytest.raises(OSError, match=r"ball\.png") as refusal:
        ds.read_image(path)
    assert_one_clear_sentence(str(refusal.value))
