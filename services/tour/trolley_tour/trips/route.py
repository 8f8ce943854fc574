"""In which order a trip visits its stops."""


def lap_stops(num_stops: int, there_and_back: bool, lap: int) -> list[int]:
    """The stops that a lap visits, as indices into the tour.

    There and back, a lap goes to the last stop and returns to the first, where the next one begins:
    stops 0 1 2 give 0 1 2 1 0, then 1 2 1 0.
    """
    forward = list(range(num_stops))
    if not there_and_back or num_stops < 2:
        return forward
    return forward[min(lap, 1) :] + forward[-2::-1]
