"""Grams of views, written out whole."""

import numpy as np

from diffshade.inverse.forward.gram import ByView, Gram


def by_view(H: np.ndarray, g: np.ndarray) -> ByView:
    """Return what views say that all show every unknown."""
    return ByView(np.zeros(len(H)), g, H, None)


def whole(views: ByView, p: int) -> Gram:
    """Return the Gram of each view for all p unknowns, 0 where the view shows none of it."""
    gradient, hessian = np.zeros((len(views.cost), p)), np.zeros((len(views.cost), p, p))
    for v, (index, H, g) in enumerate(views.parts(np.ones(p, bool))):
        gradient[v, index] = g
        hessian[v][np.ix_(index, index)] = H
    return Gram(np.asarray(views.cost), gradient, hessian)
