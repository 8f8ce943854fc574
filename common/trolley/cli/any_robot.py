"""Which of several robots goes: the nearest one that is free."""

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor

from trolley import codes, requests
from trolley.codes import SENTENCES, Refused
from trolley.connection import Connection, RobotUnreachable
from trolley.messages import Offer, request_params

MOST_ASKED = 16
"""How many robots are asked at the same time."""


def ask_offers(connection: Connection, goal: request_params.SendGoal) -> dict[str, Offer]:
    """Ask every robot how soon it could be at a goal; one that does not answer offers nothing."""
    params = request_params.AskOffer(pose=goal.pose, name=goal.name)

    def ask(robot: str) -> Offer:
        try:
            return connection.ask(robot, requests.TOUR_OFFER, params)
        except Refused as refused:
            return Offer(free=False, reason=refused.code)
        except RobotUnreachable:
            return Offer(free=False, reason=codes.NOT_READY)

    names = connection.robots()
    if not names:
        raise RobotUnreachable(f"no robot is at {', '.join(connection.endpoints)}")
    with ThreadPoolExecutor(MOST_ASKED) as pool:
        return dict(zip(names, pool.map(ask, names), strict=True))


def in_order(offers: Mapping[str, Offer]) -> list[str]:
    """The names of those that could go now, the one that is there first at the beginning.

    Raises:
        Refused: `busy`, saying of each why it cannot.
    """
    able = [
        (offer.seconds, name)
        for name, offer in offers.items()
        if offer.free and offer.seconds is not None
    ]
    if not able:
        reasons = {name: offer.reason or codes.BUSY for name, offer in offers.items()}
        reasons_text = " ".join(
            f"{name}: {SENTENCES.get(code, code)}" for name, code in sorted(reasons.items())
        )
        raise Refused(codes.BUSY, f"No robot can go there now. {reasons_text}", robots=reasons)
    return [name for _, name in sorted(able)]
