"""Pictures of a running episode; physics knows nothing of them."""

from .animation import save_animation
from .history import RenderHistory
from .painter import Painter
from .recorders import GameRecorder, PlantRecorder, Recorder, Seen
from .screen import RENDER_MODES, Screen

__all__ = [
    "RENDER_MODES",
    "GameRecorder",
    "Painter",
    "PlantRecorder",
    "Recorder",
    "RenderHistory",
    "Screen",
    "Seen",
    "save_animation",
]
