"""What is wrong with a robot or its computer, and what to do about it.

Checks are pure functions of facts; what gathers the facts reads files, asks systemd, and listens
to the network. Nothing here opens a serial port: that would reset the board of a running robot.
"""

from trolley.doctor.finding import Finding, Level

__all__ = ["Finding", "Level"]
