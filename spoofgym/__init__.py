"""GNSS spoofing and its detection as a game."""

__version__ = "0.1.0"
