"""Sentences for people about what is the matter with the pose or the map."""

BLIND = "the lidar sees too little"
PAUSED = "paused: the map does not grow"
LOST = "the scan does not match the map: the robot is lost and the map does not grow"
UNSURE = "checking the pose: drive on a little, then the map grows again"
SLIPS = "the wheels slip: they turn farther than the robot moves"
