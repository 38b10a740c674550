"""The figures of a lecture on the illumination model, each drawn by the model itself."""

from .report.lecture import draw_figure as draw_figure
from .report.lecture import write_figures as write_figures
