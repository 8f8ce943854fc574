"""Compile or load all kernels before the first scan needs them."""

from trolley_base.world.warmup import warm_up

__all__ = ["warm_up"]
