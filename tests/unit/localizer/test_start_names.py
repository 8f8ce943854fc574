"""The saved place that robot.toml names as the start."""

from trolley.geometry import Pose2D
from trolley.messages import SavedPose, SavedPoses
from trolley_localizer.start_pose import find_saved

DOCK = Pose2D(1.0, 2.0, 0.5)


def test_a_start_is_found_by_its_name_as_macos_writes_accents() -> None:
    poses = SavedPoses(stamp_ns=1, poses=[SavedPose(name="K\u00fcche", map="home", pose=DOCK)])
    for name in ("K\u00fcche", "Ku\u0308che"):
        assert find_saved(poses, name, "home") == DOCK
    assert find_saved(poses, "K\u00fcche", "attic") is None
