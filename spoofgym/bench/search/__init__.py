"""Searches for attacks."""
