"""Sentences for people about what is the matter with the pose or the map."""

BLIND = "the lidar sees too little"
PAUSED = "paused: the map does not grow"
LOST = (
    "this part is not joined to the map yet: drive on to a place that the map shows, "
    "or say where the robot is"
)
CUT = (
    "this part was joined to the map in a wrong place and is cut off again: "
    "drive on to a place that the map shows"
)
OTHER_FLOOR = (
    "the walls are not those of the map since the robot stood, as after a lift ride: "
    "what is seen now is mapped apart"
)
UNSURE = "checking the pose: drive on a little, then the map grows again"
SLIPS = "the wheels slip: they turn farther than the robot moves"
