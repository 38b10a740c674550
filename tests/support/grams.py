"""Grams of views, written out whole."""

import numpy as np

from diffshade.inverse.forward.gram import Gram, ViewGrams


def whole(views: ViewGrams, p: int) -> Gram:
    """Return the Gram of each view for all p unknowns, 0 where the view shows none of it."""
    cost, g, H = (np.asarray(of) for of in (views.of.cost, views.of.gradient, views.of.hessian))
    shown = np.broadcast_to(np.arange(p), g.shape) if views.shown is None else np.asarray(views.shown)
    gradient, hessian = np.zeros((len(g), p)), np.zeros((len(g), p, p))
    for v, index in enumerate(shown):
        here = index < p
        gradient[v, index[here]] = g[v, here]
        hessian[v][np.ix_(index[here], index[here])] = H[v][np.ix_(here, here)]
    return Gram(cost, gradient, hessian)
