"""What a learned policy is, of a spoofer or of a detector: card, contract, ONNX model, zoo."""

from .card import Card, DetectorCard, SpooferCard
from .zoo import card_of, shipped

__all__ = ["Card", "DetectorCard", "SpooferCard", "card_of", "shipped"]
