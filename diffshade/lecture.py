"""The figures of a lecture on the illumination model, each drawn by the model itself.

`draw_figure` returns one of them, as a notebook shows it; `write_figures` writes all of them, or some, to a folder.
"""

from .report.lecture import draw_figure as draw_figure
from .report.lecture import write_figures as write_figures
