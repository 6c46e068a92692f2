"""The authentic world: flights, inertial sensors, clocks, satellites, GNSS errors.

Truth lives here; nothing that a detector sees comes from here unmeasured.
"""
