"""Fitting texels: a stack of photographs from one camera in, a map of every number of the material out."""

from __future__ import annotations

import contextlib
import difflib
import logging
import os
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jax.sharding import Mesh
from jaxtyping import Float, Int

from ..core.backend import check_backend, in_float64
from ..core.fields import as_float64, check, check_kind, refuse_traced
from ..core.progress import ReportProgress, showing
from ..inverse.data.views import View, is_grey
from ..inverse.fitting import check_scale
from ..inverse.forward.losses import LOSSES
from ..model.fresnel import NoFresnel
from ..model.materials import EXPONENT_RANGE
from ..model.rendering import select
from ..model.scenes import Scene, check_positions, check_shapes
from ..parallel.checkpoints import fingerprint
from ..parallel.devices import DeviceGroup
from ..parallel.run_store import RunStore
from ..parallel.threads import in_order, on_all_cores
from .descent import GRID
from .estimates import Choices, Estimates, Usual, estimate, residual_sizes
from .geometry import Plane, note_of, plane_of, scatter_of_block
from .lighting import LightingSetup, rig_of
from .maps import TexelMaps
from .normal_equations import COEFFICIENTS, Known
from .shared import MOST_PASSES, STILL, by_region, grid_costs, slopes, stepped
from .tiles import Source, Tile

_LOGGER = logging.getLogger("diffshade")
FREE = (*COEFFICIENTS, "n_s", "normal")
MEMORY = 1 << 28
QUICK, PATIENT = 8, 60  # steps for all texels, and for the few that need more
SAMPLED = 4096  # texels from which the scale of a robust loss is taken
FEW = 256  # texels from which it is taken how the lights lie about them, and what is left of most


def fit_texels(
    scene: Scene,
    views: Sequence[View] | View,
    *,
    free: Iterable[str] = ("k_d", "k_s", "n_s"),
    regions: Int[np.ndarray, "h w"] | None = None,
    loss: str = "squares",
    out: str | os.PathLike[str] | None = None,
    memory: int = MEMORY,
    mesh: Mesh | None = None,
    progress: bool = False,
) -> TexelMaps:
    r"""Fit a material of its own to every pixel of views that share a camera: maps of k_d, k_s, n_s and the normal.

    $$ \min \sum \rho(exposure \cdot radiance + black - image) $$

    at each texel, over all views, rho the square unless another `loss` is given: the coefficients exactly and never
    below 0, log n_s (and the normal) by Levenberg-Marquardt on what they leave (variable projection; Golub and Pereyra
    1973), in float64 whatever the global flag. It needs no start: n_s is searched for, the normal begins at photometric
    stereo (Woodham 1980) from the middle of each texel's observations. A texel has a highlight where one explains
    enough of what it shows; elsewhere k_s and n_s are 0, with infinite errors, and the map says so.

    `scene`: one opaque object, whose surface says where the texels are, and all the lights; what is free in it is not
    looked at. `views`: at least 2, with `lit`, exposure, black, noise, mask, saturation and floor as in `fit`, of one
    camera; an observation that the sensor clipped is left out, in all its channels, and 1 exactly is clipped where no
    saturation is given. `free`: "k_a", "k_d", "k_s", "n_s", "normal". `regions`: whole numbers from 0, (H, W); texels
    of one number share one n_s, so that zeros share it among all. `loss`: "squares", or "huber", "cauchy" or
    "geman-mcclure", which take an observation in shadow, say, for the outlier it is; all its channels have one say.
    `out`: a folder that the maps are written to as they come, `NAME.npy` and `NAME_error.npy`; the same call again goes
    on where it was stopped, at any moment. `memory`: bytes for photographs at work, more or less: larger ones are
    read in bands. `mesh`: devices to spread the work over; of several processes, joined by
    `jax.distributed.initialize`, each does its share, and all write to one `out`, on a disk of the machine they run
    on. `progress`: show a line on the terminal.

    Raises ValueError, TypeError: one sentence that names the view, pixel or parameter and the remedy; `LostProcess`
    where another process is gone; RuntimeError where this jaxlib adds up wrongly.
    """
    views = (views,) if isinstance(views, View) else tuple(views)
    check_scale(memory, out, mesh, "out")
    free = _checked(scene, views, free, regions, loss)
    check_backend()
    scene = jax.tree.map(as_float64, scene)
    with (
        showing("texels", show=progress) as report_progress,
        in_float64((scene, views)) as (scene, views),
    ):
        run = _Run(scene, views, free, regions, loss, out, memory, mesh, report_progress)
        with contextlib.closing(run.record):
            return run.maps()


class _Run:
    """One fit of texels at work: what is known, what is read, and what was found."""

    def __init__(
        self,
        scene: Scene,
        views: Sequence[View],
        free: tuple[str, ...],
        regions: np.ndarray | None,
        loss: str,
        out: str | os.PathLike[str] | None,
        memory: int,
        mesh: Mesh | None,
        report_progress: ReportProgress,
    ):
        self.scene, self.free, self.report_progress = scene, free, report_progress
        self.source = Source(scene, views)
        known_noise = views[0].noise is not None
        homoscedastic = all(view.noise is None or view.noise.is_uniform for view in views)
        self.choices = Choices(free, loss, homoscedastic, known_noise)
        self.setup: LightingSetup = rig_of(scene, views)
        self.known = _known(scene, free, self.source.channels)
        # numbered from 0 without gaps
        self.regions = None if regions is None else np.unique(np.asarray(regions), return_inverse=True)[1].reshape(-1)
        height = self.source.shape[0]
        self.device_group = None if mesh is None else DeviceGroup(mesh)
        if self.device_group is not None and self.device_group.several and out is None:
            raise ValueError(
                "several processes need one folder for their maps; got out=None. Give out a shared folder."
            )
        problem = "" if out is None else fingerprint(scene, views, free, self.regions, loss)
        rows = self.source.rows_of(memory)
        if self.device_group is not None:  # no device without a tile
            rows = min(rows, -(-height // self.device_group.count))
        self.record = RunStore(out, problem, rows, lambda rows: -(-height // rows), self.device_group)
        self.rows = self.record.rows
        self.count = len(self.record.done)
        self.own = range(self.count)
        if self.device_group is not None:
            device_group = self.device_group
            self.own = [t for t in range(self.count) if t % device_group.count in device_group.own]
        self.log_n_s = float(np.log(np.maximum(scene.objects[0].material.n_s, EXPONENT_RANGE[0])))

    def maps(self) -> TexelMaps:
        """Find the maps, tile by tile."""
        some = self.source.sample(FEW)
        plane = self.lights_about(some) if "normal" in self.free else None
        notes = () if plane is None or (note := note_of(plane)) is None else (note,)
        for note in notes:  # before the work begins
            _LOGGER.warning(note)
        sigma = np.asarray(1.0 if self.choices.known_noise or self.choices.loss == "squares" else self._scale())
        x, error = (None, None) if self.regions is None else self._exponents(sigma)
        choices = self.choices
        if x is not None:
            choices = choices._replace(free=tuple(name for name in self.free if name != "n_s"), shared=True)

        if plane is not None:
            choices = choices._replace(narrow=plane.narrow)
        usual = self._usual(some, choices, sigma, self._exponent_of(some, x, error))

        def fit(tile: Tile) -> None:
            if not len(tile.pixels):
                return
            log_n_s = self._exponent_of(tile, x, error)
            found = self._fit(tile, choices, sigma, usual, log_n_s, QUICK)
            slow = np.flatnonzero(~found.done)
            if len(slow):
                again = self._fit(tile, choices, sigma, usual, log_n_s, PATIENT, slow)
                jax.tree.map(lambda all_, some: all_.__setitem__((..., slow), some), found, again)
            self._write(tile, found)

        for name in (*self._names(), "status", "residual"):
            self._map(name)
            if name in self.free:
                self._map(f"{name}_error")
        self._over_tiles(fit, self.record.done, "fitted", self.record.finish)
        self.record.meet()
        if not np.any(self._map("status")):
            raise ValueError(
                "no pixel is left to fit: the masks, alpha channels and the object's silhouette have none in common. "
                "Check that the masks are white on the object, and the camera."
            )
        values, errors = ({name: self.record.read(name + end) for name in self._names()} for end in ("", "_error"))
        status, residual = (self.record.read(name)[..., 0] for name in ("status", "residual"))
        maps = TexelMaps(values, errors, status, residual, self.scene, self.source.camera, notes)
        if self.record.folder is not None and self.record.first:
            maps.describe(self.record.folder)
        return maps

    def _over_tiles(
        self, work: Callable[[Tile], Any], done: np.ndarray, verb: str, finish: Callable[[int], None]
    ) -> None:
        """Read every tile that is not done, work on it, and mark it."""
        height = self.source.shape[0]
        todo = [t for t in self.own if not done[t]]

        def read(t: int) -> tuple[int, Tile]:
            first = t * self.rows
            return t, self.source.read(first, min(first + self.rows, height), self.rows)

        for k, (t, tile) in enumerate(in_order(read, todo, threads=1, ahead=1)):
            work(tile)
            finish(t)
            self.report_progress(verb, (len(self.own) - len(todo) + k + 1) / len(self.own))

    def _on_devices(self, work: Callable[[Any], Any], blocks: Sequence[Any]) -> list[Any]:
        """Return what each block gives, in order: on all cores, or each on the next device of the mesh."""
        if self.device_group is None:
            return on_all_cores(work, blocks)
        devices = list(self.device_group.here.devices.flat)

        def on_device(item: tuple[int, Any]) -> Any:
            k, block = item
            with jax.default_device(devices[k % len(devices)]):
                return work(block)

        return on_all_cores(on_device, list(enumerate(blocks)))

    def lights_about(self, some: Tile) -> Plane:
        """Return how the lights lie about some texels."""

        def of_block(cut: Any) -> np.ndarray:
            part, laid = cut
            block = self.source.lay_out(*laid)
            return np.asarray(scatter_of_block(self.setup, block, "k_a" in self.free))[..., : len(part)]

        found = self._on_devices(of_block, self.source.blocks(some, self._exponent_of(some)))
        return plane_of(np.concatenate([np.zeros((3, 3, 0)), *found], -1))

    def _usual(self, some: Tile, choices: Choices, sigma: np.ndarray, log_n_s: np.ndarray) -> Usual:
        """Return what is left of most texels, at some of them."""
        any_ = Usual(np.asarray(np.inf), np.asarray(np.inf))
        if not len(some.pixels):
            return any_
        found = self._fit(some, choices, sigma, any_, log_n_s, QUICK)
        free = np.isfinite(found.variance) & (found.level > 0.0)
        if not free.any():
            return any_
        variance, level = found.variance[free], found.level[free]
        return Usual(np.median(variance), np.median(variance / level))

    def _fit(
        self,
        tile: Tile,
        choices: Choices,
        sigma: np.ndarray,
        usual: Usual,
        log_n_s: np.ndarray,
        patience: int,
        which: Any = None,
    ) -> Estimates:
        """Return the estimates of a tile, or of some of its texels."""

        def of_block(cut: Any) -> Estimates:
            part, laid = cut
            block = self.source.lay_out(*laid)
            found = estimate(self.setup, self.known, block, sigma, usual, np.asarray(patience), choices)
            return jax.tree.map(lambda leaf: np.asarray(leaf)[..., : len(part)], found)

        found = self._on_devices(of_block, self.source.blocks(tile, log_n_s, which))
        return jax.tree.map(lambda *parts: np.concatenate(parts, -1), *found)

    def _scale(self) -> float:
        """Return the scale of the residuals of a robust loss: the median of their size at some texels."""
        self.report_progress("judging the residuals")
        some = self.source.sample(SAMPLED)
        sigma, choices = 1.0, self.choices._replace(loss="squares")
        for _ in range(4):
            sizes = self._sizes(some, choices, sigma)
            new = float(np.median(sizes)) if len(sizes) else 1.0
            if abs(new - sigma) <= 0.01 * new:
                break
            sigma, choices = max(new, 1e-12), self.choices._replace(loss="huber")
        return sigma

    def _sizes(self, tile: Tile, choices: Choices, sigma: float) -> np.ndarray:
        """Return the sizes of the residuals of a tile, in all channels together."""

        def of_block(cut: Any) -> np.ndarray:
            part, laid = cut
            block = self.source.lay_out(*laid)
            size = residual_sizes(self.setup, self.known, block, np.asarray(sigma), np.asarray(PATIENT), choices)
            return np.asarray(size)[:, : len(part)][block.seen.counts[:, : len(part)]]

        found = self._on_devices(of_block, self.source.blocks(tile, self._exponent_of(tile)))
        return np.concatenate(found or [np.zeros(0)])

    def _exponents(self, sigma: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return log n_s of each region, and its standard error."""
        assert self.regions is not None
        regions = int(self.regions.max()) + 1
        costs = self._pass(
            "search", len(GRID), regions, lambda block: grid_costs(self.setup, self.known, block, self.choices)
        )
        x = GRID[np.argmin(costs, 0)]
        error, moved = np.full(regions, np.inf), np.full(regions, np.inf)
        patience = np.asarray(PATIENT)
        for k in range(MOST_PASSES):
            at = x
            sums = self._pass(
                f"pass_{k}",
                4,
                regions,
                lambda block: slopes(self.setup, self.known, block, sigma, patience, self.choices),
                at,
            )
            x, error = stepped(at, sums)
            moved = np.abs(x - at)
            if (moved <= STILL).all():
                break
        return x, np.maximum(error, moved)  # where it still moves, by that it is not known

    def _pass(
        self, name: str, rows: int, regions: int, program: Callable[[Any], Any], x: np.ndarray | None = None
    ) -> np.ndarray:
        """Add up what a program says of every texel, region by region; each tile's share is kept in the record."""
        assert self.regions is not None
        shares = self.record.array(f"{name}_sums", (self.count, rows, regions), np.float64)
        done = self.record.array(f"{name}_done", (self.count,), np.uint8)
        now = iter(())

        def work(tile: Tile) -> None:
            nonlocal now
            log_n_s = self._exponent_of(tile, x)
            region = self.regions[tile.pixels]  # type: ignore[index]

            def of_block(cut: Any) -> np.ndarray:
                part, laid = cut
                values = np.asarray(program(self.source.lay_out(*laid)))[:, : len(part)]
                return by_region(values, region[part], regions)

            blocks = self.source.blocks(tile, log_n_s)  # none in a band that shows no object
            now = iter([sum(self._on_devices(of_block, blocks), np.zeros((rows, regions)))])

        def finish(t: int) -> None:
            shares[t] = next(now)
            self.record.finish(t, name=f"{name}_done")

        self._over_tiles(work, done, f"n_s of the regions, {name.replace('_', ' ')}:", finish)
        if self.device_group is None or not self.device_group.several:
            return shares.sum(0)
        mine = np.zeros((rows, regions)) + sum(shares[t] for t in self.own)
        return self.device_group.total([mine, *[np.zeros_like(mine)] * (len(self.device_group.own) - 1)])

    def _exponent_of(
        self, tile: Tile, x: np.ndarray | None = None, error: np.ndarray | None = None
    ) -> Float[np.ndarray, "2 n"]:
        """Return log n_s of each texel of a tile where it is not one of its own unknowns, and its error."""
        known = np.zeros((2, len(tile.pixels)))
        known[0] = self.log_n_s
        if x is not None and self.regions is not None:
            known[0] = x[self.regions[tile.pixels]]
        if error is not None and self.regions is not None:
            known[1] = error[self.regions[tile.pixels]]
        return known

    def _names(self) -> tuple[str, ...]:
        return tuple(name for name in FREE if name in self.free)

    def _map(self, name: str) -> np.ndarray:
        """Return a map, (H, W, C)."""
        base = name.removesuffix("_error")
        width = {"n_s": 1, "status": 1, "residual": 1, "normal": 1 if name != base else 3}.get(
            base, self.source.channels
        )
        return self.record.array(name, (*self.source.shape, width), np.uint8 if name == "status" else np.float32)

    def _write(self, tile: Tile, found: Estimates) -> None:
        """Write a tile's numbers to the maps."""
        numbers = {"status": found.status[None], "residual": found.residual[None], **found.values}
        numbers |= {f"{name}_error": error for name, error in found.errors.items()}
        for name, value in numbers.items():
            whole = self._map(name)
            with np.errstate(over="ignore"):  # an error too large for float32 is infinite there
                whole.reshape(-1, whole.shape[2])[tile.pixels] = value.T


def _known(scene: Scene, free: tuple[str, ...], channels: int) -> Known:
    """Return the coefficients that are not free."""
    material = scene.objects[0].material

    def of(name: str) -> np.ndarray:
        colour = np.asarray(getattr(material, name), np.float64)
        if channels == 3:
            return colour
        if name == "k_a" and np.any(scene.ambient):  # a grey photograph shows the mean of k_a I_a
            return np.mean(colour * scene.ambient, keepdims=True) / np.mean(scene.ambient)
        return colour.mean(keepdims=True)

    k_a, k_d, k_s = (None if name in free else of(name) for name in COEFFICIENTS)
    return Known(k_a, k_d, k_s, of("k_e"))


def _checked(scene: Any, views: Sequence[Any], free: Iterable[str], regions: Any, loss: Any) -> tuple[str, ...]:
    """Refuse what cannot be fitted, in one sentence; return the names of what is free."""
    if len(views) < 2:
        raise ValueError(f"fit_texels needs at least two views; got {len(views)}. Give a View for each photograph.")
    check_kind("scene", scene, Scene, "Scene(Object(Sphere()), PointLight((2, 3, 4)))")
    for i, view in enumerate(views):
        check_kind(f"views[{i}]", view, View, "View(image, camera)")
    refuse_traced("a fit", "Fit outside.", scene=scene, views=tuple(views))
    check((scene, tuple(views)))
    free = (free,) if isinstance(free, str) else tuple(free)
    for name in free:
        if name not in FREE:
            close = difflib.get_close_matches(str(name), FREE, 1)
            hint = f"Did you mean '{close[0]}'?" if close else "Give some of them."
            raise ValueError(f"free must hold names among {', '.join(FREE)}; got {name!r}. {hint}")
    if not free:
        raise ValueError("free must name at least one map; got none. Give for example free=('k_d', 'k_s', 'n_s').")
    free = tuple(name for name in FREE if name in free)
    if not isinstance(loss, str) or loss not in LOSSES:
        raise ValueError(f"loss must be one of {', '.join(LOSSES)}; got {loss!r}. Give one of them.")
    _check_scene(scene, free)
    _check_views(scene, views, free)
    if regions is None:
        return free
    regions = np.asarray(regions)
    if "n_s" not in free:
        raise ValueError("regions share n_s, which is not free. Add 'n_s' to free, or leave regions out.")
    if regions.shape != views[0].camera.shape or not np.issubdtype(regions.dtype, np.integer) or regions.min() < 0:
        raise ValueError(
            f"regions must be whole numbers from 0 of the camera's shape {views[0].camera.shape}; got {regions.dtype} "
            f"of shape {regions.shape}. Give np.zeros(shape, int) for one n_s."
        )
    return free


def _check_scene(scene: Scene, free: tuple[str, ...]) -> None:
    """Refuse a scene whose texels are more than reflection of light."""
    if len(scene.objects) != 1:
        raise ValueError(
            f"fit_texels needs a scene of one object; got {len(scene.objects)}. Leave the others out and mask them."
        )
    material = scene.objects[0].material
    for wrong, what, remedy in (
        (scene.atmosphere is not None, "an atmosphere", "Leave it out."),
        (material.k_t is not None, "k_t, a material that light passes through", "Leave it out."),
        (not isinstance(material.fresnel, NoFresnel), f"fresnel={material.fresnel!r}", "Leave it out."),
        (bool(material.patterns), "a pattern among the coefficients", "Give plain colours."),
        (np.ndim(material.n_s) > 0, "an n_s for each channel", "Give one n_s."),
        (not scene.lights, "a scene without lights", "Give the lights of the photographs."),
    ):
        if wrong:
            raise ValueError(f"fit_texels does not know {what}. {remedy}")
    if "n_s" in free and "k_s" not in free and not np.any(material.k_s):
        raise ValueError("n_s is free, but k_s is neither free nor above 0. Add 'k_s' to free.")
    if "normal" in free and "k_d" not in free and not np.any(material.k_d):
        raise ValueError("normal is free, but k_d is neither free nor above 0. Add 'k_d' to free.")
    if material.n_s < EXPONENT_RANGE[0] and "n_s" not in free and ("k_s" in free or np.any(material.k_s)):
        raise ValueError(
            f"Material.n_s must be at least {EXPONENT_RANGE[0]} in a fit of texels; got {material.n_s}. Raise it."
        )
    if "k_a" in free and not np.all(scene.ambient > 0):
        raise ValueError(f"k_a is free, but scene.ambient is {scene.ambient}. Give the ambient light, above 0.")


def _check_views(scene: Scene, views: Sequence[View], free: tuple[str, ...]) -> None:
    """Refuse views that do not show one texel at one pixel."""
    first = views[0]
    for i, view in enumerate(views):
        if not eqx.tree_equal(jax.tree.map(np.asarray, first.camera), jax.tree.map(np.asarray, view.camera)):
            raise ValueError(
                f"views[{i}] has another camera than views[0]: a texel must be at one pixel in all. Give the views one "
                "camera, or use ds.fit."
            )
        if is_grey(view) != is_grey(first):
            raise ValueError(f"views[{i}] and views[0] must both be grey or both be colour. Convert one of them.")
        if (view.noise is None) != (first.noise is None):
            raise ValueError(f"views[{i}] and views[0] must both have noise or neither. Give all of them or none.")
        try:
            select(scene, view.lit)
        except ValueError as error:
            raise ValueError(f"views[{i}].{error}") from None
    material, lights = scene.objects[0].material, [np.ravel(getattr(light, "intensity", 1.0)) for light in scene.lights]
    for name in ("k_d", "k_s"):
        coloured = np.ptp(getattr(material, name)) > 0 and any(np.ptp(light) > 0 for light in lights)
        if is_grey(first) and name not in free and coloured:
            raise ValueError(
                f"grey photographs under coloured lights cannot have a coloured {name} that is known; got "
                f"{getattr(material, name)}. Give it one number, or let it be free."
            )
    check_shapes(scene, first.camera)
    check_positions(scene, first.camera)
