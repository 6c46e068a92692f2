"""The duel of a spoofer and a detector agent, its PettingZoo forms, and views of one side.

What users need is in `spoofgym.duel_v0`.
"""
