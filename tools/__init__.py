"""Tools for the development of spoofgym; not installed with it."""
