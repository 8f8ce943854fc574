"""Compile what the mapper uses."""


def warm_up() -> None:
    """Compile all kernels."""
