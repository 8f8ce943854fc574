"""Base notices while it drives that the lidar no longer sits as robot.toml says."""

import math
from pathlib import Path

import pytest
from support.upkeep import save_turned_lidar

from trolley import codes, requests, topics
from trolley.geometry import Pose2D
from trolley.messages import PoseEstimate, Proposals
from trolley.messages.request_params import WhichProposal
from trolley_base.commands.odometry_file import write_proposed
from trolley_base.upkeep_watch import UPKEEP_FILE

from .conftest import MakeRig, Rig

TURNED = Pose2D(0.0, 0.0, math.radians(3.0))
SURE = [1e-4, 0.0, 0.0, 0.0, 1e-4, 0.0, 0.0, 0.0, 1e-4]


def state_folder(rig: Rig) -> Path:
    return rig.lockstep.state / rig.config.robot.name


Turned = tuple[Rig, list[Proposals]]


@pytest.fixture
def turned(make_rig: MakeRig) -> Turned:
    """A robot that has seen for long that its lidar is turned, restarted; and what it proposes."""
    rig = make_rig()
    heard: list[Proposals] = rig.lockstep.record(topics.PROPOSALS)
    save_turned_lidar(rig.config, state_folder(rig), TURNED.yaw)
    rig.restart()
    rig.run(0.2)
    return rig, heard


def drive_about(rig: Rig, seconds: float, moved: Pose2D) -> None:
    """Drive circles both ways, with poses as a localizer gives them by a lidar that was moved."""
    for number in range(round(seconds * 5)):
        rig.drive(0.2, 0.4, 0.8 if number % 80 < 40 else -0.8)
        truth = rig.truth
        rig.lockstep.publish(
            topics.POSE,
            PoseEstimate(
                stamp_ns=truth.stamp_ns,
                map="hall",
                match=1.0,
                spread=0.0,
                pose=truth.pose @ moved,
                state="localized",
                covariance=SURE,
            ),
        )


@pytest.mark.slow
def test_a_turned_lidar_is_proposed_and_a_restart_does_not_forget_it(make_rig: MakeRig) -> None:
    rig = make_rig()
    heard: list[Proposals] = rig.lockstep.record(topics.PROPOSALS)
    drive_about(rig, 40.0, Pose2D.identity())
    assert not any(one.proposals for one in heard)
    drive_about(rig, 130.0, TURNED)
    (proposal,) = heard[-1].proposals
    assert proposal.id == "lidar"
    assert "turned by" in proposal.message
    assert proposal.right_until is not None
    rig.run(65.0)
    rig.restart()
    drive_about(rig, 15.0, TURNED)
    assert [one.id for one in heard[-1].proposals] == ["lidar"]


def test_what_is_accepted_is_written_and_the_comments_stay(tmp_path: Path) -> None:
    path = tmp_path / "robot.toml"
    path.write_text(
        '[robot]\nname = "r"\nfootprint = { length_m = 0.3, width_m = 0.24 }\n'
        "[base.lidar]  # on top\npose = { x = 0.1, y = 0.0, yaw = 0.0 }  # measured\n"
    )
    write_proposed(
        path,
        {"base.lidar.pose.x": 0.1, "base.lidar.pose.y": 0.0, "base.lidar.pose.yaw": 0.0524}
        | {"base.odometry.linear_scale": 0.985},
    )
    text = path.read_text()
    assert "# on top" in text
    assert "yaw = 0.0524" in text
    assert "linear_scale = 0.985" in text


def test_what_was_proposed_before_a_restart_still_is(turned: Turned) -> None:
    _, heard = turned
    assert [one.id for one in heard[-1].proposals] == ["lidar"]


def test_a_dismissed_proposal_stays_away_over_a_restart(turned: Turned) -> None:
    rig, heard = turned
    answer = rig.lockstep.ask(requests.PROPOSALS_DISMISS, WhichProposal(id="lidar"))
    assert "turned by 3.0°" in answer.message
    assert heard[-1].proposals == []
    drive_about(rig, 15.0, TURNED)
    rig.restart()
    rig.run(0.2)
    assert heard[-1].proposals == []
    with pytest.raises(codes.Refused, match="No correction 'lidar' is proposed"):
        rig.lockstep.ask(requests.PROPOSALS_DISMISS, WhichProposal(id="lidar"))


@pytest.mark.slow
def test_what_was_dismissed_is_proposed_again_after_it_was_right(turned: Turned) -> None:
    rig, heard = turned
    rig.lockstep.ask(requests.PROPOSALS_DISMISS, WhichProposal(id="lidar"))
    # Somebody has pushed it back; by what was seen of that it must be let go again.
    save_turned_lidar(rig.config, state_folder(rig), 0.0, num_legs=30.0)
    rig.restart()
    drive_about(rig, 15.0, Pose2D.identity())
    assert heard[-1].proposals == []
    drive_about(rig, 130.0, TURNED)
    assert [one.id for one in heard[-1].proposals] == ["lidar"]


def test_what_cannot_be_written_to_disk_is_not_dismissed(turned: Turned) -> None:
    rig, heard = turned
    path = state_folder(rig) / UPKEEP_FILE
    path.unlink()
    path.mkdir()
    with pytest.raises(codes.Refused, match="could not be written"):
        rig.lockstep.ask(requests.PROPOSALS_DISMISS, WhichProposal(id="lidar"))
    assert [one.id for one in heard[-1].proposals] == ["lidar"]
