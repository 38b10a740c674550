"""Checks: photographs and heights that do not belong to the maps of a report are refused."""

from __future__ import annotations

from collections.abc import Sequence

from ....core.fields import check_kind
from ....inverse.data.views import View
from ....model.rendering import select
from ....texels.heights.map import HeightMap
from ....texels.maps import TexelMaps
from ..checks import check_titles
from .numbers import doublings


def check_maps(
    maps: TexelMaps,
    views: Sequence[View],
    held_out: Sequence[View],
    heights: HeightMap | None,
    titles: Sequence[str],
) -> None:
    """Refuse photographs of another shape or other lights, heights of another shape, and wrong titles."""
    shape = maps.status.shape
    if not maps.status.any():
        raise ValueError("the maps have no texel inside: their status is outside everywhere. Give maps of an object.")
    for name, given in (("views", views), ("held_out", held_out)):
        for i, view in enumerate(given):
            check_kind(f"{name}[{i}]", view, View, "View(image, camera, lit=0)")
            if view.camera.shape != shape:
                raise ValueError(
                    f"{name}[{i}] must have the shape of the maps, {shape}; got {view.camera.shape}. Give photographs "
                    "by the camera of the fit."
                )
            try:
                select(maps.scene, view.lit)
            except ValueError as error:
                raise ValueError(f"{name}[{i}].{error}") from None
    powers = [n_s / maps.highlights[0].n_s for _, n_s in maps.highlights]
    if any(abs(2.0 ** doublings(ratio) - ratio) > 1e-6 * ratio or ratio < 1.0 for ratio in powers):
        raise ValueError(
            f"maps.highlights must have exponents that are the first one doubled; got "
            f"{[n_s for _, n_s in maps.highlights]}. Give maps of ds.fit_texels."
        )
    if heights is not None:
        check_kind("heights", heights, HeightMap, "ds.heights.integrate_normals(maps.values['normal'], maps.camera)")
        if heights.height.shape != shape:
            raise ValueError(
                f"heights must have the shape of the maps, {shape}; got {heights.height.shape}. Leave them out, or "
                "integrate the maps' normals."
            )
    check_titles(titles, len(views) + len(held_out), "the")
