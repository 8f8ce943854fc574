"""From what the wheels and the gyro report to where the robot is."""
