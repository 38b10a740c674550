"""Scenes of a dozen structures, so that few programs compile, with drawn values, extremes among them.

The scenes of one structure run as one batch. No image and no derivative may hold a NaN or an infinity.
"""

from typing import Any

import equinox as eqx
import jax
import numpy as np

import diffshade as ds

SHAPE = (5, 7)  # odd, so that one ray runs exactly along the view axis
BATCH = 17
AXES = [np.array(axis, float) for axis in ((1, 0, 0), (0, 1, 0), (0, 0, 1), (-1, 0, 0), (0, -1, 0), (0, 0, -1))]


class Draw:
    """Random values of everything in a scene; about one in three is an extreme.

    Two scenes in five are drawn along one axis and in quarters of a unit, so that rays run exactly along surfaces and
    normals; in half of these a ray meets the first object head on, where as a rule a light is too.
    """

    def __init__(self, seed):
        self.random = np.random.default_rng(seed)
        self.places = [np.zeros(3)]  # where something is: centres, points on surfaces
        self.exact = self.random.random() < 0.4
        self.axis = AXES[self.random.integers(6)]
        self.aligned = self.exact and self.random.random() < 0.5
        self.front = None  # of the first object, the point that a ray along the axis meets

    def one_of(self, *extremes, low=0.0, high=1.0, size=None) -> Any:
        if self.random.random() < 0.35:
            return extremes[self.random.integers(len(extremes))]
        return self.random.uniform(low, high, size)

    def direction(self):
        if self.exact or self.random.random() < 0.2:
            return self.axis if self.random.random() < 0.6 else AXES[self.random.integers(6)]
        d = self.random.normal(size=3)
        return d / np.linalg.norm(d)

    def place(self, reach=3.0):
        """A point: on or in some object, or anywhere."""
        if self.aligned and self.front is not None and self.random.random() < 0.5:
            return self.front
        if self.random.random() < (0.7 if self.exact else 0.35):
            return self.places[self.random.integers(len(self.places))]
        p = self.random.uniform(-reach, reach, 3)
        return np.round(4 * p) / 4 if self.exact else p

    def meet(self, front):
        self.front = front if self.front is None else self.front

    def length(self, *extremes, size=None):
        value = self.one_of(*extremes, low=0.3, high=2, size=size)
        return np.ceil(4 * value) / 4 if self.exact else value

    def colour(self, *extremes, high=1.0):
        return self.one_of(*(extremes or (0.0, 1.0)), high=high, size=3)

    def sphere(self):
        center, radius = self.place(1), self.length(1.0, 0.5, 1e-3)
        self.places += [center, *(center + radius * self.direction() for _ in range(2)), center + 0.25 * radius]
        self.meet(center + radius * self.axis)
        return ds.Sphere(center, radius)

    def box(self):
        center, size = self.place(1), self.length(np.ones(3), size=3)
        turn = self.one_of(np.zeros(3), np.array([0, 90.0, 0]), np.array([45.0, 0, 45]), low=-180, high=180, size=3)
        turn = 0 * turn if self.exact else turn
        # the middle of a face, an edge and a corner where it is not turned, a point within
        parts = np.array([0.5 * self.axis, [0.5, 0.5, 0], [0.5, 0.5, 0.5], [0.25, 0.125, 0.25]])
        self.places += [center, *(center + parts * size)]
        self.meet(center + 0.5 * size * self.axis)
        return ds.Box(center, size, turn)

    def plane(self):
        point = self.place(2)
        self.places += [point]
        self.meet(point)
        return ds.Plane(point, self.one_of(1e-3, 1e3, low=0.5) * self.direction())

    def n_s(self, size=None):
        return self.one_of(0.0, 1.0, 0.5, 1e4, low=0, high=300, size=size) * np.ones(size or ())

    def chequer(self, smooth):
        period = self.one_of(1e-2, 1e2, low=0.2, high=5)
        return ds.Chequer(self.colour(), self.colour(), period, smooth, self.direction(), self.direction())

    def material(self, lobe, fresnel=None, *, clear=False, bends=True, channels=None, pattern=None):
        """A material; `pattern` is whether the chequer of its k_d, and of k_t where it is clear, is smooth."""
        fresnel = fresnel or ds.NoFresnel()
        k_s = 0.0 if isinstance(fresnel, ds.Dielectric) else self.colour()
        k_d = self.colour() if pattern is None else self.chequer(pattern)
        k_t = (self.colour() if pattern is None else self.chequer(pattern)) if clear else None
        eta = self.one_of(1.0, 0.1, 10.0, 0.7, 1.5, low=0.1, high=3) if bends else 1.0
        return ds.Material(
            self.colour(), k_d, k_s, self.n_s(channels), lobe, fresnel, k_e=self.colour(), k_t=k_t, eta=eta
        )

    def attenuation(self, clamp):
        a, b, c = self.one_of(*np.eye(3), high=1, size=3)
        return ds.RadialAttenuation(a, b, c, clamp=clamp)

    def point(self, *, clamp=False):
        return ds.PointLight(self.place(), self.colour(0.0, 10.0), self.attenuation(clamp))

    def directional(self):
        return ds.DirectionalLight(self.direction() * self.one_of(1e-3, 1e3, low=0.5), self.colour())

    def spot(self, *, clamp=False):
        cutoff = self.one_of(0.0, 90.0, low=1, high=90)
        softness = self.one_of(0.0, cutoff, low=0, high=cutoff)
        exponent = self.one_of(0.0, 1.0, 0.5, 128.0, low=0, high=20)
        fade = self.attenuation(clamp)
        return ds.SpotLight(self.place(), self.direction(), self.colour(), cutoff, exponent, fade, softness)

    def area(self, samples=(2, 2)):
        u = self.direction()
        v = np.roll(u, 1) if self.exact else np.cross(u, self.random.normal(size=3))
        size, exponent = self.one_of(1.0, 1e-3, high=2), self.one_of(0.0, 1.0, low=0, high=5)
        # the corner so that an emitter of two by two is on a place
        corner = self.place() - size * (0.25 * u + 0.25 * v)
        cutoff, fade = self.one_of(0.0, 90.0, low=1, high=90), self.attenuation(False)
        return ds.AreaLight(corner, size * u, size * v, self.colour(), cutoff, exponent, fade, samples)

    def fog(self, **kind):
        return ds.Fog(self.one_of(0.0, 100.0, low=0, high=2), I_dc=self.colour(), **kind)

    def cueing(self, **kind):
        z_f = self.one_of(0.0, 3.0, low=-1, high=5)
        z_b = z_f + self.one_of(1e-6, 2.0, low=0.1, high=5)
        return ds.DepthCueing(
            z_f, z_b, s_f=self.one_of(0.0, 1.0), s_b=self.one_of(0.0, 1.0), I_dc=self.colour(), **kind
        )

    def camera(self, kind, **options):
        """A camera that looks at a place, or past it, from outside or from another place."""
        target = self.place()
        away = self.direction() * self.one_of(1.0, 3.0, 1e3, low=0.5, high=6)
        eye = self.place() if self.random.random() < 0.4 else target + away
        if np.linalg.norm(eye - target) < 1e-2:
            eye = target + away
        if self.aligned and self.front is not None:
            eye, target = self.front + 2 * self.axis, self.front
        sight = (eye - target) / np.linalg.norm(eye - target)
        up = next(axis for axis in AXES[self.random.integers(3) :] if abs(np.dot(axis, sight)) < 0.9)
        perspective = kind is ds.Camera
        field = (
            self.one_of(1.0, 90.0, 170.0, low=20, high=90) if perspective else self.one_of(2.5, 5.0, low=0.5, high=5)
        )
        return kind(eye, target=target, up=up, shape=SHAPE, **{"fov" if perspective else "height": field}, **options)

    def scene(self, surfaces, materials, lights, atmosphere=None):
        objects = [ds.Object(*both) for both in zip(surfaces, materials, strict=True)]
        return ds.Scene(objects, lights, self.colour(), self.colour(), atmosphere)

    def relief(self):
        """A G-buffer of the picture's shape: normals that turn away too, positions anywhere, one in five masked out."""
        n, p = self.random.normal(size=(*SHAPE, 3)), self.random.normal(size=(*SHAPE, 3))
        n[0], n[1], p[0], p[1:3] = self.direction(), AXES[2], self.places[0], self.place()
        return ds.GBuffer(n / np.linalg.norm(n, axis=-1, keepdims=True), p, self.random.random(SHAPE) < 0.8)


PHONG, BLINN, SCHLICK, DIELECTRIC = ds.Phong(), ds.Blinn(), ds.Schlick(), ds.Dielectric()
PINHOLE, PARALLEL = ds.Camera, ds.OrthographicCamera


def sphere_under_points(draw):
    scene = draw.scene([draw.sphere()], [draw.material(PHONG)], [draw.point(), draw.point(clamp=True), draw.point()])
    return scene, draw.camera(PINHOLE)


def sphere_under_spots(draw):
    scene = draw.scene([draw.sphere()], [draw.material(BLINN)], [draw.spot(), draw.spot(), draw.spot(clamp=True)])
    return scene, draw.camera(PARALLEL)


def ball_on_a_floor_under_an_area_light(draw):
    materials = [draw.material(BLINN, SCHLICK), draw.material(BLINN, SCHLICK, pattern=False)]
    scene = draw.scene([draw.sphere(), draw.plane()], materials, [draw.area()], draw.cueing())
    return scene, draw.camera(PINHOLE)


def dielectric_box_seen_from_infinity(draw):
    lights = [draw.directional(), draw.point()]
    scene = draw.scene([draw.box()], [draw.material(PHONG, DIELECTRIC)], lights, draw.fog())
    return scene, draw.camera(PARALLEL, local_viewer=False)


def glass_ball_before_a_chequer(draw):
    materials = [draw.material(PHONG, DIELECTRIC, clear=True), draw.material(PHONG, DIELECTRIC, pattern=True)]
    scene = draw.scene([draw.sphere(), draw.plane()], materials, [draw.point()], draw.fog(radial=True))
    return scene, draw.camera(PINHOLE)


def glass_box_before_a_chequer(draw):
    materials = [draw.material(BLINN, clear=True), draw.material(BLINN, pattern=True)]
    scene = draw.scene([draw.box(), draw.plane()], materials, [draw.spot()], draw.cueing(radial=True))
    return scene, draw.camera(PINHOLE)


def nested_glass(draw):
    surfaces = [draw.sphere(), draw.sphere(), draw.box()]
    materials = [draw.material(PHONG, clear=clear) for clear in (True, True, False)]
    return draw.scene(surfaces, materials, [draw.point()]), draw.camera(PINHOLE)


def overlapping_glass_boxes(draw):
    surfaces = [draw.box(), draw.box()]
    materials = [draw.material(BLINN, SCHLICK, clear=True, channels=3) for _ in surfaces]
    return draw.scene(surfaces, materials, [draw.directional()], draw.fog(squared=True)), draw.camera(PARALLEL)


def panes_and_every_light(draw):
    materials = [draw.material(PHONG, clear=True), draw.material(PHONG, clear=True), draw.material(BLINN)]
    lights = [draw.point(), draw.directional(), draw.spot(), draw.area((2, 1))]
    scene = draw.scene([draw.plane(), draw.plane(), draw.sphere()], materials, lights)
    return scene, draw.camera(PINHOLE, local_viewer=False)


def ball_and_box_in_radial_fog(draw):
    materials = [draw.material(PHONG, channels=3), draw.material(PHONG, channels=3)]
    scene = draw.scene([draw.sphere(), draw.box()], materials, [draw.spot()], draw.fog(squared=True, radial=True))
    return scene, draw.camera(PINHOLE)


def relief_behind_glass(draw):
    materials = [draw.material(PHONG, clear=True, bends=False, pattern=True) for _ in range(2)]
    scene = draw.scene([draw.sphere(), draw.relief()], materials, [draw.point(), draw.spot()], draw.fog(radial=True))
    return scene, draw.camera(PARALLEL)


def relief_alone(draw):
    ball = draw.sphere()
    scene = draw.scene([ball], [draw.material(BLINN, DIELECTRIC)], [draw.area(), draw.directional()])
    return eqx.tree_at(lambda s: s.objects[0].surface, scene, draw.relief()), draw.camera(PINHOLE)


STRUCTURES = [
    sphere_under_points,
    sphere_under_spots,
    ball_on_a_floor_under_an_area_light,
    dielectric_box_seen_from_infinity,
    glass_ball_before_a_chequer,
    glass_box_before_a_chequer,
    nested_glass,
    overlapping_glass_boxes,
    panes_and_every_light,
    ball_and_box_in_radial_fog,
    relief_behind_glass,
    relief_alone,
]


def differentiable(leaf):
    return leaf.dtype != bool


def one(tree, tangent, weight):
    """The image, its derivative along the tangent, and the gradient of the weighted sum of its pixels."""
    numbers, rest = eqx.partition(tree, differentiable)

    def image(numbers):
        return ds.render(*eqx.combine(numbers, rest))

    value, slope = jax.jvp(image, (numbers,), (tangent,))
    return value, slope, jax.vjp(image, numbers)[1](weight)[0]


# without fusion: XLA's CPU compiler takes minutes over the reverse mode of transparent objects with it
QUICK = {"xla_backend_optimization_level": 0, "xla_disable_hlo_passes": "fusion"}
compiled = jax.jit(jax.vmap(one), compiler_options=QUICK)


def not_compiled(*batch):
    """Run operation by operation: a few scenes are not worth a compiler's time."""
    with jax.disable_jit():
        return jax.vmap(one)(*batch)


def seeds_of(structure, batch):
    first = 1_000_000 * STRUCTURES.index(structure) + BATCH * batch
    return list(range(first, first + BATCH))


def check_batch(program, structure, batch):
    """Look at the images and derivatives of a batch of scenes; a failure says which number of which scene it is."""
    seeds = seeds_of(structure, batch)
    scenes = [structure(Draw(seed)) for seed in seeds]
    trees = jax.tree.map(lambda *leaves: np.stack(leaves), *scenes)
    numbers = eqx.filter(trees, differentiable)
    random = np.random.default_rng(batch)
    tangents = jax.tree.map(lambda leaf: random.normal(size=leaf.shape), numbers)
    weights = random.normal(size=(BATCH, *SHAPE, 3))
    found = program(trees, tangents, weights)
    for what, derivative in zip(("image", "forward derivative", "gradient"), found, strict=True):
        for path, leaf in jax.tree.leaves_with_path(derivative):
            finite = np.isfinite(leaf).reshape(BATCH, -1).all(-1)
            name = f" with respect to {jax.tree_util.keystr(path, simple=True, separator='.')}" if path else ""
            wrong = [seeds[i] for i in np.flatnonzero(~finite)]
            assert not wrong, f"{structure.__name__}(Draw({wrong[0]})): the {what}{name} is not finite; so are {wrong}"
