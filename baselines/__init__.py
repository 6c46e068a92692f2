"""Baselines of the laboratory: what a learned spoofer has to reach before it may claim anything."""
