"""Receivers on a GPU, imported where ``device="cuda"`` requests it; it needs the extra ``cuda``."""

from .vector_env import CudaVectorEnv

__all__ = ["CudaVectorEnv"]
