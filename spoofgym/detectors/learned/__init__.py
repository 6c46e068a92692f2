"""Detectors that have learned: what they observe, how they decide, and files that hold them."""
