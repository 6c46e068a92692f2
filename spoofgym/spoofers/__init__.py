"""Spoofers: they decide what the attack does, one idea per file, behind the contract of `base`."""

from ..policies.onnx_file import SUFFIX
from .base import KNOWLEDGE, ScriptedSpoofer, Spoofer, SpooferContext
from .build import SPOOFERS, make_spoofer
from .feedback import Feedback, FeedbackProfile, ThresholdRider
from .learned import OnnxPolicy
from .profile import ActionCurves, OpenLoop, Profile
from .ramps import AcceleratingRamp, Dash, Intermittent, NoSpoofer, Ramp, Step
from .scaled import Scaled

__all__ = [
    "KNOWLEDGE",
    "SPOOFERS",
    "SUFFIX",
    "AcceleratingRamp",
    "ActionCurves",
    "Dash",
    "Feedback",
    "FeedbackProfile",
    "Intermittent",
    "NoSpoofer",
    "OnnxPolicy",
    "OpenLoop",
    "Profile",
    "Ramp",
    "Scaled",
    "ScriptedSpoofer",
    "Spoofer",
    "SpooferContext",
    "Step",
    "ThresholdRider",
    "make_spoofer",
]
