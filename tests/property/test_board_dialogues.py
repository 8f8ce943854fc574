"""Whatever arrives: nothing raises, nothing is commanded to a board that has not said who it is."""

from hypothesis import given
from hypothesis import strategies as st
from support.fake_boards import frame, slow_frames

from trolley.config.hardware import ChassisConfig, InputsConfig, WheelsConfig
from trolley.geometry import Twist2D
from trolley_base.drivers.boards import make_board

MS = 1_000_000
WHEELS = WheelsConfig(ticks_per_revolution=1200.0, diameter_m=0.065, track_m=0.2)
IDS = st.sampled_from([0, 1, 2, 6, 7, 10, 11, 100, 101, 125, 126]) | st.integers(0, 0xFFFF)
FRAMES = st.builds(frame, IDS, st.binary(max_size=80))
LINES = st.sampled_from(
    [b"57600", b" 57600", b"OK", b"1", b"0", b"1023", b"12 -7", b"Invalid Command"]
).map(lambda line: line + b"\r\n")
STEP = st.tuples(st.integers(0, 700), st.binary(max_size=30) | FRAMES | LINES)


@given(st.lists(STEP, max_size=40))
def test_a_linorobot_that_never_announced_anything_is_never_commanded(
    steps: list[tuple[int, bytes]],
) -> None:
    dialogue = make_board(ChassisConfig(board="linorobot"), "differential")
    dialogue.begin(0)
    now_ns = 0
    for wait_ms, data in steps:
        now_ns += wait_ms * MS
        dialogue.receive(data, now_ns)
        dialogue.drive(Twist2D(0.3, 0.0, 0.0))
        # 0 asks for topics, 10 answers with the time.
        assert {topic_id for topic_id, _ in slow_frames(dialogue.outgoing(now_ns))} <= {0, 10}
        assert dialogue.status(now_ns).state != "up"
        dialogue.take(now_ns)


@given(st.lists(STEP, max_size=60))
def test_an_arduino_gets_whole_lines_and_stops_while_it_does_not_report(
    steps: list[tuple[int, bytes]],
) -> None:
    config = ChassisConfig(
        board="arduino_bridge",
        wheels=WHEELS,
        inputs=InputsConfig(bumper_pins=[4], battery_pin=0),
    )
    dialogue = make_board(config, "differential")
    dialogue.begin(0)
    now_ns = 0
    for wait_ms, data in steps:
        now_ns += wait_ms * MS
        dialogue.receive(data, now_ns)
        dialogue.drive(Twist2D(0.3, 0.0, 0.0))
        out = dialogue.outgoing(now_ns)
        assert out == b"" or out.endswith(b"\r")
        is_up = dialogue.status(now_ns).state == "up"
        for line in out.split(b"\r"):
            assert not line.startswith(b"m") or line == b"m 0 0" or is_up
        dialogue.take(now_ns)
