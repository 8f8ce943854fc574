"""Base notices while it drives that the lidar no longer sits as robot.toml says."""

import math
from pathlib import Path

import pytest

from trolley import topics
from trolley.geometry import Pose2D
from trolley.messages import PoseEstimate, Proposals
from trolley_base.commands.odometry_file import write_proposed

from .conftest import MakeRig, Rig

TURNED = Pose2D(0.0, 0.0, math.radians(3.0))
SURE = [1e-4, 0.0, 0.0, 0.0, 1e-4, 0.0, 0.0, 0.0, 1e-4]


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
