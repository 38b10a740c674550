"""Lamps as their makers measure them: luminous intensity by direction, in files of IES and EULUMDAT.

`read_lamp` reads one, as a `MeasuredLight` for a scene; `draw_lamp` draws its page, and `as_spot` finds the spot light
nearest to it. `fit_falloff` finds the attenuation of a lamp from readings of a light meter.
"""

from .exchange.lamps.falloff import fit_falloff as fit_falloff
from .exchange.lamps.spots import as_spot as as_spot
from .io.lamps.lamp_files import read_lamp as read_lamp
from .model.measured_lights import LampLabel as LampLabel
from .model.measured_lights import MeasuredLight as MeasuredLight
from .model.measured_lights import Profile as Profile
from .report.lamp_picture import draw_lamp as draw_lamp
