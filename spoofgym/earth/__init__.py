"""The Earth: the WGS-84 ellipsoid and its gravity, frames, and attitude."""
