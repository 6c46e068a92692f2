"""Receiver autonomous integrity monitoring: whether the pseudoranges of an epoch agree."""

from .residual import Raim
from .residual_vectors import SrvRaim
from .traversal import TraversalRaim

__all__ = ["Raim", "SrvRaim", "TraversalRaim"]
