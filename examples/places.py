"""List the saved places, and how far each is from here."""

from trolley import Robot

with Robot() as robot:
    here = robot.pose().pose
    for name, place in robot.places().items():
        away = "" if here is None else f", {here.distance_to(place.pose):.1f} m away"
        print(f"{name} on the map {place.map}{away}")
