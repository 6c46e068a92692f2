"""Pictures of a running episode; physics knows nothing of them."""

from .animation import save_animation
from .history import RenderHistory
from .painter import Painter
from .recorders import CoreRecorder, Recorder
from .screen import RENDER_MODES, Screen

__all__ = [
    "RENDER_MODES",
    "CoreRecorder",
    "Painter",
    "Recorder",
    "RenderHistory",
    "Screen",
    "save_animation",
]
