"""World files: what is read, and how what is wrong is named."""

import pytest

from trolley_base.world import WorldError, decode_world

START = 'map = "m.yaml"\nstart = {x = 0.0, y = 0.0, yaw = 0.0}\n'


def refusal(text: str) -> str:
    with pytest.raises(WorldError) as caught:
        decode_world(text, "flat.toml")
    return str(caught.value)


def test_a_start_may_be_given_with_a_quaternion() -> None:
    text = 'map = "m.yaml"\nstart = {x = 1.0, y = 2.0, orientation = [0, 0, 0.12859, 0.99170]}'
    pose = decode_world(text, "flat.toml").start.as_pose()
    assert (pose.x, pose.y) == (1.0, 2.0)
    assert pose.yaw == pytest.approx(0.2579, abs=1e-4)


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("start = {x = 0.0, y = 0.0, yaw = 0.0}", "map"),
        ('map = "m.yaml"', "start"),
        (START + "[[box]]\nx = 0\ny = 0\nlength_m = 1\n", "box[0]"),
        (START + "[[circle]]\nx = 0\ny = 0\nradius_m = -1\n", "circle[0].radius_m"),
        (START + "[[circle]]\nx = nan\ny = 0\nradius_m = 1\n", "circle[0].x"),
        (START + "[[mirror]]\npoints = [[0, 0]]\n", "mirror[0].points"),
        (START + "[[mirror]]\npoints = [[0, 0], [1, 0]]\nside = 'front'\n", "mirror[0].side"),
        (START + "[[glass]]\npoints = [[0, 0], [1, 0]]\ntransmission = 2\n", "transmission"),
        (START + "[[person]]\npath = []\n", "person[0].path"),
        (START + "[wheels]\nslip = 0.1\n", "slip"),
        (START + "[lidar]\nbeams = 0\n", "lidar.beams"),
        (START + "[lidar]\nrange_min_m = 9.0\n", "range_min_m"),
        (START + "[limits]\nmax_speed_mps = 'fast'\n", "limits.max_speed_mps"),
        (START + "[[table]]\nx = 0\n", "table"),
        ("map = ", "TOML"),
    ],
)
def test_what_is_wrong_is_named_with_file_and_key(text: str, named: str) -> None:
    message = refusal(text)
    assert message.startswith("flat.toml: ")
    assert named in message


def test_bytes_that_are_no_text_are_refused() -> None:
    with pytest.raises(WorldError, match=r"flat\.toml"):
        decode_world(b"\xff\xfe\x00", "flat.toml")
