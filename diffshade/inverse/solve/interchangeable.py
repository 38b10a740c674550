"""Interchangeable highlights: of one lobe, so that exchanging their k_s and n_s changes no image."""

from __future__ import annotations

from collections.abc import Sequence

import equinox as eqx
import numpy as np
from jaxtyping import Float

from ...core.words import Note, listing
from ...model.scenes import Scene
from ..unknowns.places import Place
from ..unknowns.unknown import Unknown

Highlights = list[list[int]]  # for each highlight the unknowns of its k_s and, last, of its n_s


def interchangeable(scene: Scene, unknowns: Sequence[Unknown]) -> list[Highlights]:
    """Return for each object the highlights that a fit cannot tell apart.

    They have the same lobe, and all of their numbers are free in the same range, each an unknown of its own.
    """
    at = {place: j for j, unknown in enumerate(unknowns) for place in unknown.places}
    found = []
    for i, item in enumerate(scene.objects):
        m = item.material
        lobes = [m.lobe, *(more.lobe for more in m.highlights)]
        starts = [("material",), *(("material", "highlights", k) for k in range(len(m.highlights)))]
        members = []
        for start, lobe in zip(starts, lobes, strict=True):
            k_s, n_s = (Place("objects", i, (*start, name)) for name in ("k_s", "n_s"))
            indices = [at.get(of, -1) for of in (*(k_s.at(c) for c in range(len(scene.channels))), n_s.at(0))]
            if min(indices) >= 0 and eqx.tree_equal(lobe, lobes[0]) and np.ndim(m.n_s) == 0:
                members.append(list(dict.fromkeys(indices)))
        alike = {tuple((unknowns[j].lower, unknowns[j].upper, unknowns[j].prior) for j in of) for of in members}
        of_several = len({j for of in members for j in of}) < sum(map(len, members))
        if len(members) > 1 and len(alike) == 1 and not of_several:
            found.append(members)
    return found


def by_rising_exponent(
    theta: Float[np.ndarray, " p"], scene: Scene, unknowns: Sequence[Unknown]
) -> Float[np.ndarray, " p"]:
    """Return a point with interchangeable highlights in the order of their n_s."""
    theta = np.array(theta)
    for members in interchangeable(scene, unknowns):
        order = sorted(members, key=lambda of: theta[of[-1]])
        values = [theta[of] for of in order]
        for of, new in zip(members, values, strict=True):
            theta[of] = new
    return theta


def note_order(scene: Scene, unknowns: Sequence[Unknown]) -> list[Note]:
    """Say that interchangeable highlights are listed by rising n_s."""
    names = [tuple(unknowns[of[-1]].name for of in members) for members in interchangeable(scene, unknowns)]
    said = "exchanging the highlights of {} changes no image, so they are listed by rising n_s."
    return [Note(said.format(listing(list(of))), "interchangeable", of) for of in names]
