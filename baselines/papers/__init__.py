"""Reproductions of the five papers: ``python -m baselines.papers KEY``."""
