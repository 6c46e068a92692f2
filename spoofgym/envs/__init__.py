"""What Gymnasium sees: one step path over any victim, terms, wrappers, single and vector."""

from ..simulation import Domain, Engine, Setup, TightlyCoupledSetup, Timeline
from .core import SpoofCore
from .factory import VICTIMS
from .observer import Observer
from .offsets import offsets_action
from .spoofer_binding import attach
from .terms import TERMS, make_terms
from .terms.observation import default_terms
from .victims import SpoofEnv, SpoofVectorEnv

__all__ = [
    "TERMS",
    "VICTIMS",
    "Domain",
    "Engine",
    "Observer",
    "Setup",
    "SpoofCore",
    "SpoofEnv",
    "SpoofVectorEnv",
    "TightlyCoupledSetup",
    "Timeline",
    "attach",
    "default_terms",
    "make_terms",
    "offsets_action",
]
