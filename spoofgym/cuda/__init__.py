"""Receivers on a GPU: the library's own functions compiled again for a thread a receiver.

Imported on request alone, by ``SpoofVectorEnv(device="cuda")``; it needs the extra ``cuda``.
"""

from .vector_env import CudaVectorEnv

__all__ = ["CudaVectorEnv"]
