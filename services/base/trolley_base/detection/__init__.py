"""Which board and which lidar are plugged in, and where: what `trolley detect` finds out."""
