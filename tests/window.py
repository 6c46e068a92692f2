"""A backend of matplotlib for tests, whose windows are on no screen."""

from matplotlib.backend_bases import FigureManagerBase
from matplotlib.backends.backend_agg import FigureCanvasAgg


class FigureManager(FigureManagerBase):
    def show(self):
        """Show nothing."""


class FigureCanvas(FigureCanvasAgg):
    required_interactive_framework = "headless"
    manager_class = FigureManager
    drawn = 0

    def draw(self):
        super().draw()
        type(self).drawn += 1
