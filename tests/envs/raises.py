"""A module of a user's own that can't be imported."""

raise RuntimeError("no such luck")
