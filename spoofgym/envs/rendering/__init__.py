"""Pictures of a running episode; physics knows nothing of them."""

from .animation import save_animation
from .history import CoreRecorder, RenderHistory
from .screen import RENDER_MODES, Painter, Screen

__all__ = ["RENDER_MODES", "CoreRecorder", "Painter", "RenderHistory", "Screen", "save_animation"]
