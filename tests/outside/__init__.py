"""Detectors as somebody outside of the package writes them."""
