"""From the web server's threads to the service's, where everything else runs."""

from collections.abc import Callable

Post = Callable[[Callable[[], None]], None]
"""Hands a call to the service's thread."""
