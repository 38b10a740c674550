"""Lights of photographs: where they are, how bright, and how the photographs encode it.

`calibrate` finds them by a ball. `apply_lights` puts them beside the photographs of an object, whose `write` makes a
folder for `read_photographs`; `draw_calibration` shows what was found. `find_lights` finds them by an object of unknown
shape, and `find_response` the curve of its photographs.
"""

from .calibration.applying import apply_lights as apply_lights
from .calibration.calibrating import calibrate as calibrate
from .calibration.result import Calibration as Calibration
from .report.calibration_picture import draw_calibration as draw_calibration
from .texels.lights.finding import find_lights as find_lights
from .texels.lights.response import find_response as find_response
