"""What base has found wrong with robot.toml, on the page."""

from typing import TYPE_CHECKING

import numpy as np
import pytest
from support.pages import page_of

from trolley import topics
from trolley.geometry import Pose2D
from trolley.messages import Proposal, Proposals
from trolley_base.odometry.wheel_scales import WheelScales
from trolley_base.upkeep.evidence import ANGULAR, BEND, LINEAR, YAW, Errors, X
from trolley_base.upkeep.findings import InForce, find_proposals
from trolley_viz.features.diagnosis.proposals import HEADLINE, card
from trolley_viz.languages.translator import translator_of

if TYPE_CHECKING:
    from ...conftest import Stage

WORN = Proposal(
    id="wheels",
    message="The left wheel is 2.1 % smaller than robot.toml says. Take it over?",
    settings={"base.odometry.wheel_ratio": 0.979},
)
LOOSE = Proposal(id="odometry", message="Wheels and lidar no longer fit each other.")


def test_a_worn_tyre_is_told_with_what_to_do(stage: "Stage") -> None:
    stage.browse()
    stage.runtime.run(2.0)
    more = page_of(stage).within("More")
    assert HEADLINE not in more.text()
    stage.robot.publish(topics.PROPOSALS, Proposals(stamp_ns=1, proposals=[WORN]))
    stage.runtime.run(2.0)
    assert "The left wheel is 2.1 % smaller" in more.text()
    assert "trolley calibrate proposed --accept wheels" in more.text()
    more.press_lead("Do not propose it again")
    stage.runtime.run(2.0)
    assert stage.robot.dismissed == ["wheels"]
    assert HEADLINE not in more.text()


def test_what_has_to_be_repaired_offers_nothing_to_accept() -> None:
    assert "--accept" not in card([LOOSE], may_dismiss=False)


def test_what_a_program_says_there_is_text() -> None:
    assert "<b>x</b>" not in card([Proposal(id="x", message="<b>x</b>")], may_dismiss=False)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("off", [[YAW], [X], [YAW, X], [LINEAR], [ANGULAR], [BEND], []])
@pytest.mark.parametrize("track_m", [None, 0.2])
def test_each_proposal_is_said_in_german(
    off: list[int], sign: float, track_m: float | None
) -> None:
    values = np.zeros(6)
    values[off] = 0.1 * sign
    errors = Errors(values, 1e-8 * np.eye(6), 99.0, 0.0 if off else 99.0)
    in_force = InForce(Pose2D(0.1, 0.0, 0.0), WheelScales(track_m=track_m), 0.1)
    words = translator_of("de")
    assert words is not None
    proposals = find_proposals(errors, in_force)
    assert proposals
    for one in proposals:
        assert not {"The", "Take", "says", "Push", "Look", "proposed"} & set(
            words.text(one.message).replace(".", " ").split()
        )
