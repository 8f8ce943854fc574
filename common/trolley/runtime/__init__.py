"""What runs a service: the bus, the clock, the node, and the two runtimes (Zenoh and lock-step).

`service` is all that a service sees; `process` runs it over Zenoh, `lockstep` in simulated time.
"""
