"""What the paper claims, what we found, and how we read it."""

CLAIMS = """x"""
FOUND = """x"""
READINGS = """x"""
