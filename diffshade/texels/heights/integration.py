"""Integration: `integrate_normals` takes a map of normals to a height field with errors."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from jaxtyping import ArrayLike, Bool, Float

from ...core.extras import check_extra
from ...core.progress import ReportProgress, showing
from ...core.thresholds import FEW, SINGLE, SLIGHT, TINY
from ...core.words import Note, count
from ...model.cameras import AbstractCamera
from ...parallel.threads import ONE_BLAS_THREAD
from .checks import MAX_ERROR, Given, checked
from .curl import curls, noise_scale
from .differences import differences
from .discontinuities import MIN_CURL, contradict, discontinuities
from .errors import less_mean, shared_modes, standard_errors, unintegrable
from .map import HeightMap
from .parts import cut_weak_joints, labels
from .regions import connected, image_of
from .system import HeightGrid, HeightSystem
from .unknown import FilledNormals, fill

FIRST_SIGMA = 0.02  # radians: where the estimate of errors that are not given begins
ROUNDS = 5
MAX_RATIO = 1.2  # errors grow by what the curl says where it is larger than they say by more than this


def integrate_normals(
    normals: Float[ArrayLike, "h w 3"],
    camera: AbstractCamera,
    *,
    mask: Any = None,
    errors: Float[ArrayLike, "h w"] | None = None,
    shared_error: float | None = None,
    progress: bool = False,
) -> HeightMap:
    r"""Integrate a map of normals to a height field, with standard errors.

    $$ \min_u \sum_{pq} w_{pq} (u_q - u_p - d_{pq})^2, \quad (n_p + n_q) \cdot (P_q - P_p) = 0 $$

    over all pairs of neighbouring texels. The second equation gives the difference d: the chord between two points is
    perpendicular to the sum of their normals, exactly so on planes and spheres. For parallel rays u is the height z;
    for rays from the eye it is -log of the depth, as in Durou and Courteille (2007). The weight w is 1 over the
    variance that the errors of the two normals give d.

    Heights may jump between neighbours. Where the differences do not add up to 0 around four texels, pairs are cut
    along the lines that make the sum of log(1 + residual^2 / variance) small, by reweighted least squares. A jump that
    fades out within the image keeps its height. Bilateral normal integration (Cao et al. 2022) has the same aim, but
    its weights react only where a single residual is of about a texel's size. A jump of the same height all along a
    line from border to border leaves no trace in the normals: no method can see it.

    The linear systems are solved by conjugate gradients with algebraic multigrid (pyamg).

    Args:
        normals: Unit normals in world coordinates, pointing out of the surface, such as
            `TexelMaps.values["normal"]`. Those that face away from the camera, or at more than 89 degrees, count as not
            known.
        camera: Camera of the normals, `OrthographicCamera` or `Camera`; its shape is theirs.
        mask: Where the surface is; holes and several parts are allowed. By default, where the normal is not zero.
        errors: Standard errors of the normals, degrees, such as `TexelMaps.errors["normal"]`: the root mean square
            angle. Above 0; infinite, or over 40, where a normal is not known: it is interpolated then. By default one
            number for all, estimated from the curl of the differences; given ones are enlarged by a factor where the
            curl shows them to be too small. The errors of different texels are taken to be independent.
        shared_error: What all normals have in common beside that, about each axis, degrees, at least 0, such as
            `light_error` of `fit_texels`: n' = n + M n, whose nine numbers have this standard deviation. By default 1,
            as well as the directions of lights are mostly known. Where the curl is clearly smaller than `errors` say,
            neighbours have the rest in common, and the larger of both counts. 0: all errors are independent.
        progress: Show a line of progress on the terminal.

    Returns:
        The heights, their errors, the parts whose relative height is not determined, and notes about them.

    Raises:
        ValueError: An array has a wrong shape, a normal is not a unit vector, an error is not above 0, more than a
            fifth of the normals face away from the camera, or none is left; the message names the texel and the remedy.
        TypeError: An argument has the wrong type.
        ImportError: pyamg is not installed.
    """
    given = checked(normals, camera, mask, errors, shared_error)
    with showing("heights", show=progress) as report_progress, ONE_BLAS_THREAD:
        return _integrated(given, report_progress)


def heights_within(
    normals: Float[np.ndarray, "h w 3"],
    camera: AbstractCamera,
    mask: Bool[np.ndarray, "h w"],
    errors: Float[np.ndarray, "h w 1"],
    report_progress: ReportProgress,
) -> HeightMap:
    """Do as `integrate_normals` within work that shows progress of its own."""

    def report_heights(words: str, share: float | None = None) -> None:
        report_progress(f"heights, {words}", share)

    given = checked(normals, camera, mask, errors, None)
    with ONE_BLAS_THREAD:
        return _integrated(given, report_heights)


def _integrated(given: Given, report_progress: ReportProgress) -> HeightMap:
    """Integrate normals that have been checked."""
    check_extra("photographs", "cannot integrate normals", "pyamg")
    report_progress("differences")
    region = connected(given.inside)
    grid = HeightGrid.of(np.isin(region, region[given.known]))
    filled, scale, shared = _with_errors(given, grid.inside)
    pairs = differences(filled.normal, filled.sigma, grid, given.rays, filled.region > 0)
    modes = shared_modes(grid, pairs, filled, shared)
    broken = np.isinf(pairs.deviation)  # so steep that one of the two rays would see the back
    d, variance = pairs.value, np.where(broken, 1e300, pairs.deviation**2)
    jump = cut = np.zeros(d.shape, bool)
    u, shown = None, pairs.shown(MIN_CURL)
    levels = curls(grid, d, shown, modes)
    if contradict(levels):
        with_modes = variance + unintegrable(HeightSystem(grid, 1.0 / variance), modes)
        jump, u = discontinuities(grid, levels, d, with_modes, np.isfinite(shown), report_progress)
        report_progress("parts")
        cut = cut_weak_joints(grid, jump | broken, d, np.sqrt(with_modes), u)
    report_progress("heights")
    cut = cut | broken
    part = labels(grid, cut)
    system = HeightSystem(grid, np.where(cut, TINY, 1.0) / variance)
    u = less_mean(system.solve(d, u, tolerance=SLIGHT), part)
    deviation = standard_errors(system, pairs, filled, part, modes, report_progress)
    deviation = np.where(np.bincount(part)[part] < FEW, np.inf, deviation)
    if given.rays.parallel:
        height, error = u, deviation
    else:
        depth = given.rays.distance * np.exp(-u)
        height, error = given.rays.distance - depth, depth * deviation
    right, below = image_of(grid.pair, cut)
    without = np.where(given.inside & ~grid.inside, np.inf, 0.0)  # a part of the mask without a normal
    notes = (*_on_parts(given, part, jump), *_on_errors(given, scale, shared), *_on_unknown_normals(given, grid))
    return HeightMap(
        height=image_of(grid.inside, height),
        errors=np.where(grid.inside, image_of(grid.inside, error), without),
        part=image_of(grid.inside, part.astype(np.int32), -1),
        jump_right=right,
        jump_below=below,
        normal=np.where(grid.inside[..., None], filled.normal, 0.0),
        camera=given.camera,
        notes=notes,
    )


def _with_errors(given: Given, inside: Bool[np.ndarray, "h w"]) -> tuple[FilledNormals, float, float]:
    """Return normals and errors at every texel; the factor of the errors, or their size if none was given; and shared.

    Where the curl is clearly smaller than the errors say, neighbours have most of them in common: the rest of the
    errors is taken to be shared by all normals.
    """
    known = given.known & inside
    grid = HeightGrid.of(known)
    sigma = np.full(inside.shape, FIRST_SIGMA) if given.sigma is None else np.where(known, given.sigma, 1.0)
    factor, shared = 1.0, given.shared
    for _ in range(ROUNDS):  # what counts as steep depends on the errors
        change = noise_scale(grid, differences(given.normal, factor * sigma, grid, given.rays))
        if factor == 1.0 and given.sigma is not None and change <= MAX_RATIO:
            if shared > 0.0 and change < 1.0 / MAX_RATIO:
                shared = max(shared, float(np.median(sigma[known])) * np.sqrt(1.0 - change**2))
            break
        factor = max(factor * change, SINGLE / FIRST_SIGMA)
        if abs(change - 1.0) < 0.01:
            break
    filled = fill(given.normal, factor * sigma, inside, known)
    return filled, factor * FIRST_SIGMA if given.sigma is None else factor, shared


def _on_parts(given: Given, part: np.ndarray, jump: np.ndarray) -> Iterator[Note]:
    """Say which texels hang together, and where the height jumps."""
    sizes = np.bincount(part)
    large = sizes[sizes >= FEW]
    what = "heights" if given.rays.parallel else "scales"
    if len(large) > 1:
        named = ", ".join(f"{size:,}" for size in large[:3]) + ", ..." * (len(large) > 3)
        yield Note(
            f"the relative {what} of {count(len(large), 'part')}, of {named} texels, are not determined: "
            "no normals join them, or too few do beside a jump. Each has a mean of its own.",
            "parts",
        )
    if (few := int(sizes[sizes < FEW].sum())) > 0:
        yield Note(
            f"{count(few, 'texel')} in parts of fewer than {FEW} fit no neighbours: their errors are infinite.",
            "single texels",
        )
    if jump.any():
        yield Note(
            f"the height jumps between {count(int(jump.sum()), 'pair')} of neighbours, where the normals "
            "contradict a continuous surface.",
            "jumps",
        )


def _on_errors(given: Given, scale: float, shared: float) -> Iterator[Note]:
    """Say what the curl of the normals says of their errors."""
    if given.assumed or shared > given.shared:
        why = "as lights are mostly known" if shared == given.shared else "as their curl is smaller than their errors"
        yield Note(
            f"the errors contain {np.rad2deg(shared):.2g} degrees that all normals may have in common, {why}: "
            "shared_error=0 leaves it out.",
            "shared errors",
        )
    if given.sigma is None:
        degrees = np.rad2deg(max(scale, SINGLE)) * np.sqrt(2.0)
        yield Note(
            f"no errors were given: {degrees:.2g} degrees, the same everywhere, follow from the curl of the "
            "normals, which does not show errors that neighbours share.",
            "errors estimated",
        )
    elif scale > MAX_RATIO:
        yield Note(f"the normals' errors were multiplied by {scale:.2g}, which their curl asks for.", "errors enlarged")


def _on_unknown_normals(given: Given, grid: HeightGrid) -> Iterator[Note]:
    """Say which normals were not used, and which texels have no height for it."""
    if given.away:
        yield Note(
            f"{count(given.away, 'normal')} at 89 degrees from the camera or more were taken as not known.",
            "facing away",
        )
    if (unknown := int((given.inside & ~given.known).sum()) - given.away) > 0:
        yield Note(
            f"{count(unknown, 'normal')} with an error over {MAX_ERROR:g} degrees were interpolated from their "
            "neighbours.",
            "interpolated",
        )
    if (lost := int(given.inside.sum()) - grid.size) > 0:
        yield Note(
            f"{count(lost, 'texel')} have no height: they are in parts of the mask without a known normal.",
            "without normals",
        )
