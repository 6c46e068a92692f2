"""What the paper claims, what we found, and how we read it."""

TITLE = "Ke et al. (2022)"
CLAIMS = "to be written"
FOUND = "to be written"
READINGS = "to be written"
