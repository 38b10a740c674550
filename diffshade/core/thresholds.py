"""The thresholds that the rooms share: what rounding leaves, what is small, what is most, and what is clear.

A number that only one place needs stands there, with its own reason.
"""

from __future__ import annotations

import math

TINY = 1e-12  # relative: it keeps a singular matrix regular, and no digit that counts changes
ROUNDING = 1e-10  # of a cost or a sum of squares: what double precision leaves of it after a whole fit
SINGLE = 1e-6  # relative: positions in files and numbers in single precision are known no better
NEGLIGIBLE = 1e-3  # relative: no picture and no table shows it
SLIGHT = 0.01  # relative: values that differ by less count as alike
MINOR = 0.05  # a share that is left out of account: one in twenty
SMALL = 0.1  # a share that begins to count
MOST = 0.5  # a share from which it is most of a thing
CLEARLY = 1.5  # a ratio from which one of two is clearly the larger
FAR_MORE = 2.0  # a ratio from which one stands out among many

INTERVALS = (0.68, 1.0 - MINOR)  # the share of the time that an error, and an interval, holds the true value
MAX_STEPS = 200  # of an iteration that ends by itself: one that takes more has failed
FEW = 8  # observations: fewer tell little of how all of them scatter
SIDE = 400  # pixels at most of small pictures, in which objects are looked for
VAGUE = 0.3  # an error relative to the value, above which a number says little
UNCLIPPED_PERCENT = 99.5  # of the values, which a picture holds without clipping
BLACK = 0.2  # of an object's brightness: a background as dark shows nothing
GREY_LEVEL = 1.0 / 255.0  # the step of a file of 8 bits: less is not seen
DEGREE = math.radians(1.0)  # how well directions are known, of lamps and of normals
