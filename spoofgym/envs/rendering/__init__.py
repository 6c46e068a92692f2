"""Pictures of a running episode; physics knows nothing of them."""

from .animation import save_animation
from .figure import Painter
from .history import CoreRecorder, RenderHistory
from .screen import RENDER_MODES, Screen

__all__ = ["RENDER_MODES", "CoreRecorder", "Painter", "RenderHistory", "Screen", "save_animation"]
