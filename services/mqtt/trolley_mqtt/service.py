"""Placeholder while the environment is made."""
