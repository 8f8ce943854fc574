"""The base service: hardware or simulated world, odometry, robot time, commands and stop field."""
