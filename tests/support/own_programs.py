"""Every public function that computes, called with objects that stand as constants in a program of the user's own.

python own_programs.py jit|grad|vmap|float64 [NAME ...]

JAX remembers the precision in which it shipped a constant for as long as the program lives. Each function is called
twice after a program of the user's own ("float64": one that was made within `jax.enable_x64`) that holds the same
camera, scene, lights and G-buffer, and with objects that no program knows; what it returns must not differ by a digit
that counts. Prints a line for each function, and ends with status 1 where one fails. The flag is as JAX has it: off.
"""

from __future__ import annotations

import contextlib
import dataclasses
import sys
import tempfile
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxlib.version import __version__ as jaxlib_version

import diffshade as ds

SHAPE = (24, 24)
FREE = ("k_a", "k_d", "k_s", "n_s")
TOLERANCE = 1e-7  # what float32 would change is more
PROGRAMS: list[Any] = []  # the user's own, which live on


def camera() -> ds.Camera:
    return ds.Camera(eye=(0.1, 0.2, 4.3), fov=33, shape=SHAPE)


def scene() -> ds.Scene:
    """A ball under three near lamps, with numbers that float32 does not hold exactly."""
    lamps = [
        ds.PointLight(p, 10.1, ds.RadialAttenuation(1.0, 0.1, 0.03)) for p in ((2, 3, 4), (-3, 1.1, 3), (1, -2, 3.7))
    ]
    return ds.Scene(ds.Object(ds.Sphere((0.01, 0.02, 0.03)), ds.Material(0.07, (0.61, 0.4, 0.3), 0.37, 19.3)), lamps)


def photographs(scene: ds.Scene, camera: Any) -> list[np.ndarray]:
    random = np.random.default_rng(0)
    images = [np.asarray(ds.render(scene, camera, lit=i), np.float64) for i in range(len(scene.lights))]
    return [image + 0.002 * random.standard_normal(image.shape) for image in images]


IMAGES = photographs(scene(), camera())
FAR = ds.OrthographicCamera((0, 0, 4), height=2.2, shape=SHAPE, local_viewer=False)
LAMPS = ((0.3, 0.2, 1), (-0.5, 0.4, 1), (0.1, -0.6, 1), (0.6, 0.5, 1), (-0.4, -0.5, 1))


def far_scene() -> ds.Scene:
    lights = [ds.DirectionalLight(-np.array(l), 0.9) for l in LAMPS]
    return ds.Scene(ds.Object(ds.Sphere(), ds.Material(0.0, (0.61, 0.4, 0.3), 0.37, 9.3)), lights)


FAR_IMAGES = photographs(far_scene(), FAR)


@dataclasses.dataclass(frozen=True)
class Given:
    """What a user has made."""

    scene: ds.Scene
    camera: ds.Camera
    gbuffer: ds.GBuffer
    views: tuple[ds.View, ...]
    shaded: ds.Scene
    """A scene that shows the G-buffer."""
    seen: tuple[ds.View, ...]
    """Its photographs."""
    far: ds.Scene
    far_camera: ds.OrthographicCamera
    far_views: tuple[ds.View, ...]
    fit: ds.Fit | None = None
    other: ds.Fit | None = None
    maps: ds.TexelMaps | None = None
    shot: ds.Shot | None = None
    lamp: ds.lamps.MeasuredLight | None = None


def given() -> Given:
    """Make them anew: objects that no program knows."""
    eye, ball, far, lights = camera(), scene(), far_scene(), scene().lights
    seen = ds.intersect(ball, eye)
    gbuffer = ds.GBuffer(*(np.array(a) for a in (seen.normal, seen.position, seen.mask)))
    views = tuple(ds.View(image, eye, lit=i) for i, image in enumerate(IMAGES))
    far_camera = dataclasses.replace(FAR, eye=(0, 0, 4), target=(0, 0, 0), up=(0, 1, 0), height=2.2)
    return Given(
        ball,
        eye,
        gbuffer,
        views,
        ds.Scene(ds.Object(gbuffer, ball.objects[0].material), lights),
        tuple(ds.View(image, eye, lit=i) for i, image in enumerate(IMAGES)),
        far,
        far_camera,
        tuple(ds.View(image, far_camera, lit=i) for i, image in enumerate(FAR_IMAGES)),
        shot=ds.Shot(light=ds.PointLight((0.3, 0.1, 3.1)), camera=eye),
        lamp=ds.lamps.MeasuredLight((2, 3, 4), (-2, -3, -4), ds.lamps.Profile([0, 45, 90], [0], [[1, 0.6, 0]]), 3.3),
    )


def fitted(have: Given) -> Given:
    """Fit what the functions of a fit are called with."""
    ball = have.scene.objects[0]
    blinn = ds.Scene(ds.Object(ball.surface, dataclasses.replace(ball.material, lobe=ds.Blinn())), have.scene.lights)
    return dataclasses.replace(
        have,
        fit=ds.fit(have.scene, have.views, free=FREE),
        other=ds.fit(blinn, have.views, free=FREE),
        maps=ds.fit_texels(have.far, have.far_views, free=("k_d", "k_s", "n_s")),
    )


def own_program(how: str, have: Given) -> None:
    """Make and run a program of the user's own in which all of these are constants."""
    trees: list[Any] = [
        have.scene,
        have.camera,
        have.gbuffer,
        have.shaded,
        have.far,
        have.far_camera,
        have.shot,
        have.lamp,
    ]
    trees += [(view.camera, view.exposure, view.black) for view in (*have.views, *have.seen, *have.far_views)]
    if have.fit is not None and have.other is not None and have.maps is not None:
        for fit in (have.fit, have.other):
            trees += [
                fit.scene,
                [(view.camera, view.exposure, view.black) for view in fit.views],
                fit.values,
                fit.errors,
            ]
            trees += [leaf for leaf in vars(fit.evidence).values() if isinstance(leaf, np.ndarray)]
        trees += [have.maps.scene, have.maps.camera]
    leaves = [leaf for leaf in jax.tree.leaves(trees) if isinstance(leaf, np.ndarray) and leaf.dtype == np.float64]

    def number(x: Any) -> Any:
        picture = ds.shade(have.scene, have.gbuffer, have.camera)
        return x * sum(jnp.sum(part) for part in (picture, *leaves))

    ways: dict[str, Callable] = {
        "jit": jax.jit(number),
        "float64": jax.jit(number),
        "grad": jax.jit(jax.value_and_grad(number)),
        "vmap": jax.jit(jax.vmap(number)),
    }
    unjitted = {"grad": jax.value_and_grad(jax.jit(number)), "vmap": jax.vmap(jax.jit(number))}
    with jax.enable_x64(True) if how == "float64" else contextlib.nullcontext():
        for program in (ways[how], *([unjitted[how]] if how in unjitted else [])):
            jax.block_until_ready(program(jnp.arange(1.0, 3.0) if how == "vmap" else jnp.asarray(1.5)))
            PROGRAMS.append((program, number))


def remembered(have: Given) -> int:
    """Count the numbers of the camera that JAX remembers: a bare operation on them has a wrong precision."""
    count = 0
    for flag in (True, False):
        with jax.enable_x64(flag):
            negative = [jax.lax.neg(leaf) for leaf in jax.tree.leaves(have.camera)]
            count += sum(array.dtype != (np.float64 if flag else np.float32) for array in negative)
    return count


def _written(write: Callable[[Path], Any], name: str) -> int:
    with tempfile.TemporaryDirectory() as folder:
        write(Path(folder) / name)
        return (Path(folder) / name).stat().st_size > 0


def _mesh(h: Given) -> Any:
    corners = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv -1 -1 0.5\nf 1 2 3\nf 1 3 4\n"
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "mesh.obj"
        path.write_text(corners)
        seen = ds.exchange.read_mesh(path, h.camera, smooth=False)
        return seen.normal, seen.position


def _fit(scene: ds.Scene, views: Any, **options: Any) -> Any:
    fit = ds.fit(scene, views, free=FREE, **options)
    return fit.values, fit.plain_errors


def _texels(h: Given) -> Any:
    maps = ds.fit_texels(h.far, h.far_views, free=("k_d", "k_s", "n_s"))
    return list(maps.values.values())


def _normals(h: Given) -> tuple[np.ndarray, ds.Camera]:
    return np.array(h.gbuffer.normal, np.float64), h.camera


def _calibrate(ball: str, h: Given) -> Any:
    inside = np.asarray(ds.intersect(h.far, h.far_camera).mask)
    found = ds.lights.calibrate(list(FAR_IMAGES[:2]), ball=ball, mask=inside)
    return [light.direction for light in found.scene.lights]  # pyright: ignore[reportAttributeAccessIssue]


def _calibrated(h: Given) -> Any:
    found = ds.lights.calibrate(IMAGES[:1], ball="glossy", mask=np.asarray(h.gbuffer.mask), camera=h.camera)
    return [light.direction for light in found.scene.lights]  # pyright: ignore[reportAttributeAccessIssue]


def _in_float64(work: Callable[[Given], Any]) -> Callable[[Given], Any]:
    def run(h: Given) -> Any:
        with jax.enable_x64(True):
            return np.asarray(work(h))

    return run


def _spot(h: Given) -> Any:
    assert h.lamp is not None
    return ds.lamps.as_spot(h.lamp).light.exponent


def _buffer(g: ds.GBuffer) -> Any:
    return g.normal, g.position, g.mask


# Every public function that computes with what a user has made, and what of its result is compared.
FUNCTIONS: dict[str, Callable[[Given], Any]] = {
    "render": lambda h: ds.render(h.scene, h.camera),
    "render a G-buffer": lambda h: ds.render(h.shaded, h.camera),
    "render, lit": lambda h: ds.render(h.scene, h.camera, lit=1),
    "render, lamp": lambda h: ds.render(ds.Scene(h.scene.objects, h.lamp), h.camera),
    "shade": lambda h: ds.shade(h.scene, h.gbuffer, h.camera),
    "intersect": lambda h: _buffer(ds.intersect(h.scene, h.camera)),
    "render in float64": _in_float64(lambda h: ds.render(h.scene, h.camera)),
    "shade in float64": _in_float64(lambda h: ds.shade(h.scene, h.gbuffer, h.camera)),
    "intersect in float64": _in_float64(lambda h: ds.intersect(h.scene, h.camera).normal),
    "height_map": lambda h: _buffer(ds.height_map(np.zeros(SHAPE), h.far_camera)),
    "read_mesh": _mesh,
    "fit": lambda h: _fit(h.scene, h.views),
    "fit, one view": lambda h: _fit(h.scene, h.views[0]),
    "fit, robust": lambda h: _fit(h.scene, h.views, loss="cauchy"),
    "fit a light's place": lambda h: ds.fit(h.scene, h.views, free=("k_d", "lights.0.position")).values,
    "fit a G-buffer": lambda h: _fit(h.shaded, h.seen),
    "fit directions": lambda h: _fit(h.far, h.far_views),
    "fit of some pixels": lambda h: _fit(h.scene, h.views, memory=1e5),
    "fit on a mesh": lambda h: _fit(h.scene, h.views, devices=jax.make_mesh((1,), ("a",))),
    "fit_texels": _texels,
    "integrate_normals": lambda h: (m := ds.heights.integrate_normals(*_normals(h)), m.height, m.position)[1:],
    "forecast": lambda h: ds.forecast(h.scene, h.views, free=FREE).errors,
    "forecast a G-buffer": lambda h: ds.forecast(h.shaded, h.seen, free=FREE).errors,
    "calibrate, matte": lambda h: _calibrate("matte", h),
    "calibrate, glossy": lambda h: _calibrate("glossy", h),
    "calibrate with a camera": _calibrated,
    "with_lobe": lambda h: ds.exchange.with_lobe(h.scene.objects[0].material, ds.Blinn()).material.n_s,
    "as_spot": _spot,
    **{
        f"write_material, {name}": lambda h, name=name: _written(
            lambda path: ds.exchange.write_material(path, h.scene.objects[0].material), name
        )
        for name in ("m.mtl", "m.json", "m.gltf")
    },
    "write_scene": lambda h: _written(lambda path: ds.write_scene(path, h.scene, camera=h.camera), "scene.toml"),
}
# Those of a fit or of maps, which the user's program knows too.
FUNCTIONS_OF_A_FIT: dict[str, Callable[[Any], Any]] = {
    "render what was fitted": lambda h: ds.render(h.fit.scene, h.fit.views[0].camera),
    "Fit.predict": lambda h: h.fit.predict(h.views[0]).image,
    "Fit.values_in": lambda h: h.fit.values_in(h.scene),
    "fit again": lambda h: _fit(h.fit.scene, h.fit.views, start="scene"),
    "sensitivity": lambda h: ds.sensitivity(h.fit, "ambient"),
    "image_sensitivity": lambda h: ds.image_sensitivity(h.fit, 0),
    "examine": lambda h: (e := ds.examine(h.fit), e.errors, e.interval_95)[1:],
    "compare": lambda h: ds.compare({"Phong": h.fit, "Blinn": h.other}).rmse,
    "plan": lambda h: ds.plan(h.fit, h.shot).errors,
    "bootstrap": lambda h: ds.bootstrap(h.fit, draws=3),
    "write_report": lambda h: _written(lambda path: ds.write_report(path, h.fit), "report.html"),
    "draw_comparison": lambda h: _written(
        lambda path: ds.write_figure(path, ds.draw_comparison(h.fit, h.views)), "comparison.png"
    ),
    "TexelMaps.shade": lambda h: h.maps.shade(),
    "TexelMaps.shade, a light": lambda h: h.maps.shade(h.far.lights[0]),
    "TexelMaps.write": lambda h: _written(h.maps.write, "maps"),
}


def numbers(found: Any) -> list[np.ndarray]:
    return [np.asarray(leaf, np.float64) for leaf in jax.tree.leaves(found)]


def same(one: list[np.ndarray], other: list[np.ndarray]) -> bool:
    """Whether numbers agree, NaN with NaN and infinite with infinite."""
    return len(one) == len(other) and all(
        np.allclose(a, b, rtol=TOLERANCE, atol=TOLERANCE * np.abs(a[np.isfinite(a)]).max(initial=0.0), equal_nan=True)
        for a, b in zip(one, other, strict=True)
    )


def tried(function: Callable[[Any], Any], how: str, known: Any, fresh: Any) -> str:
    """Return what is wrong with a function, or how many numbers JAX remembered before it was called."""
    # what is compiled already does not meet the memory
    PROGRAMS.clear()
    jax.clear_caches()
    own_program(how, known)
    count = remembered(known)
    found = []
    for turn in ("first", "second"):
        try:
            found.append(numbers(function(known)))
        except Exception:
            return f"WRONG, {turn} call: {traceback.format_exc(limit=-3)}"
    right = numbers(function(fresh))
    wrong = next((f"WRONG: {right} became {after}" for after in found if not same(right, after)), "")
    return wrong or f"right, where JAX remembered {count} numbers"


def main(how: str, names: list[str]) -> int:
    assert not jax.config.jax_enable_x64  # pyright: ignore[reportAttributeAccessIssue]
    print(f"jax {jax.__version__}, jaxlib {jaxlib_version}, {how}", flush=True)
    wrong = 0
    for functions, made in ((FUNCTIONS, given), (FUNCTIONS_OF_A_FIT, lambda: fitted(given()))):
        chosen = {name: f for name, f in functions.items() if not names or name in names}
        if not chosen:
            continue
        known, fresh = made(), made()
        for name, function in chosen.items():
            outcome = tried(function, how, known, fresh)
            wrong += outcome.startswith("WRONG")
            print(f"{name}: {outcome}", flush=True)
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], sys.argv[2:]))
