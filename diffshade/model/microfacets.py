"""Microfacets: GGX and its Smith term, without units: 1 / pi is left out of D.

Walter, Marschner, Li and Torrance 2007, "Microfacet Models for Refraction through Rough Surfaces", eq. 33 and 34; Heitz
2014, "Understanding the Masking-Shadowing Function in Microfacet-Based BRDFs".
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np


class Microfacets(NamedTuple):
    """GGX of one roughness, or of several."""

    alpha: Any
    """The square of a material's roughness."""

    def distribution(self, n_h: Any) -> Any:
        """Return pi D, how many facets face the half vector."""
        return self.alpha**2 / (n_h**2 * (self.alpha**2 - 1.0) + 1.0) ** 2

    def visibility(self, n_l: Any, n_v: Any) -> Any:
        """Return V, the fraction that is neither shadowed nor masked, over 4 (n.l)(n.v)."""
        a2 = self.alpha * self.alpha
        return 0.5 / (n_l * np.sqrt(a2 + (1 - a2) * n_v**2) + n_v * np.sqrt(a2 + (1 - a2) * n_l**2))
