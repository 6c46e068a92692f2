"""From a model to an ONNX file with its card.

>>> import spoofgym.export
>>> card = spoofgym.export.onnx(model, env, "mine.onnx")  # doctest: +SKIP

The file is self-contained and is run by onnxruntime, on any machine and by any detector's side: the
deterministic action, with the normalization of observations folded in, and nothing of the value
function.  It is compared with the model before it is written.  This package is the one that needs
torch; install it with the extra ``train``.
"""

from .detectors import detector
from .spoofers import onnx
from .tracing import traced

__all__ = ["detector", "onnx", "traced"]
