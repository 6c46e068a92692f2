"""Worlds, players, and what they did in one run."""
