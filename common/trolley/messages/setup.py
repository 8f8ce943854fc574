"""What `trolley setup` says and asks."""

from typing import Literal

from msgspec import Struct

from trolley.messages.types import Finite, Point, Positive, StampNs

AnswerKind = Literal["choice", "name", "text", "number", "whole", "hold"]
SetupOutcome = Literal["running", "interrupted", "done", "ended"]


class SetupChoice(Struct, frozen=True, kw_only=True):
    """One of several answers: what is sent, and what people read."""

    answer: str
    label: str


class SetupQuestion(Struct, frozen=True, kw_only=True):
    """What setup waits for; `number` tells it from all other questions of the run.

    `kind` says what answers it: one of `choices`; a robot's `name`; `text`; a `number` or a `whole`
    number from `least` to `greatest` (`is_above`: above `least`, not equal to it). One of kind
    `hold` is asked while wheels turn: it is to be answered with `hold` every 0.2 s by whoever
    answered the question before it. If they fall silent, or anybody stops the robot, it stands.
    """

    text: str
    kind: AnswerKind
    number: int = 0
    choices: list[SetupChoice] = []
    default: str = ""
    least: Finite | None = None
    greatest: Finite | None = None
    is_above: bool = False


class SetupSight(Struct, frozen=True, kw_only=True):
    """What the lidar sees around the robot, for a person to compare with the room.

    `points` are echoes in `base_link`, `outline` is that of the robot, `laser` where the lidar
    sits. `room_m` has to be free all round. Before the drive it is mounted as `robot.toml` says;
    `is_measured` once it is as was found.
    """

    points: list[Point]
    outline: list[Point]
    laser: Point
    room_m: Positive
    is_measured: bool = False


class SetupState(Struct, frozen=True, kw_only=True):
    """How far `trolley setup --page` is. Owned by it, on change and at 2 Hz.

    `run` is new each time it is started. `step` of `steps` has the title `title`; `said` is what
    was said in it so far, `sight` what the lidar sees, and `doing` what the robot does now.
    `outcome` is `interrupted` when a step was refused or stopped, `done` when everything is
    written, `ended` when setup is leaving.
    """

    stamp_ns: StampNs
    run: str
    step: int
    steps: int
    title: str
    said: list[str] = []
    doing: str = ""
    sight: SetupSight | None = None
    question: SetupQuestion | None = None
    outcome: SetupOutcome = "running"
