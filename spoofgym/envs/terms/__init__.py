"""Terms of observation, action, reward and end: small objects that make up an environment."""

from .registry import TERMS as TERMS
from .registry import make_terms as make_terms
from .registry import written as written
