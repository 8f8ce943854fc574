"""Commands of `trolley` that need the base service's code."""
