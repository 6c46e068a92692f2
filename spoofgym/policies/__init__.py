"""What a learned policy is, of a spoofer or of a detector: card, contract, ONNX model, zoo."""

from .card import Card, DetectorCard, SpooferCard
from .zoo import list_shipped, load_card

__all__ = ["Card", "DetectorCard", "SpooferCard", "list_shipped", "load_card"]
