"""What a service has of the bus."""

import dataclasses

from trolley.runtime.context import Context
from trolley.runtime.health import HealthReporter
from trolley.runtime.receiving import Receiver
from trolley.runtime.serving import Server


@dataclasses.dataclass(frozen=True)
class Wire:
    """A service's end of the bus."""

    context: Context
    """Names, clocks, counters, and requests to others."""
    receiver: Receiver
    """What it watches and reads."""
    server: Server
    """What it publishes and answers."""
    health: HealthReporter
    """What it says about itself."""
