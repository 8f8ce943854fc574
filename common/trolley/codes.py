"""Every code of the wire with its sentence: error replies, goal, base and stop reasons.

Codes are stable: programs compare them. Sentences are for people; whoever raises a code may give a
more precise one.
"""

from typing import Any

from trolley.sanitize import shorten

# Common to all requests.
BAD_REQUEST = "bad_request"
UNKNOWN_NAME = "unknown_name"
TOO_LARGE = "too_large"
NOT_READY = "not_ready"
TIMEOUT = "timeout"
UNANSWERED = (NOT_READY, TIMEOUT)
"""Whoever is to answer is not there, not ready or late: it may pass by itself."""
INTERNAL = "internal"
# Poses and maps.
LOST = "lost"
STALE = "stale"
MOVING = "moving"
NOT_CONVERGED = "not_converged"
EXISTS = "exists"
OUTSIDE_MAP = "outside_map"
IN_OBSTACLE = "in_obstacle"
IN_PASSAGE = "in_passage"
WRONG_MAP = "wrong_map"
# Making maps.
MAPPING = "mapping"
NOT_MAPPING = "not_mapping"
NOT_LOOSE = "not_loose"
# Editing maps.
NO_MATCH = "no_match"
AMBIGUOUS = "ambiguous"
# Goals.
KEEPOUT = "keepout"
NO_PATH = "no_path"
NOT_LOCALIZED = "not_localized"
WRONG_FRAME = "wrong_frame"
STOPPED = "stopped"
TOUR_NOT_RUNNING = "tour_not_running"
NOT_CURRENT = "not_current"
REPLACED = "replaced"
CANCELED = "canceled"
PAUSED = "paused"
TAKEN_OVER = "taken_over"
BLOCKED = "blocked"
SLIP = "slip"
OSCILLATION = "oscillation"
WAITING = "waiting"
RESTARTED = "restarted"
NOBODY = "nobody"
PERSON_LOST = "person_lost"
OFF_MAP = "off_map"
# Trips.
NOT_DRIVING = "not_driving"
OTHER_GOAL = "other_goal"
NO_PLANNER = "no_planner"
ABORTED = "aborted"
SKIPPED = "skipped"
LOW_BATTERY = "low_battery"
# Offers.
BUSY = "busy"
CHARGING = "charging"
# Base.
BUTTON = "button"
STOP_FIELD = "stop_field"
BLIND = "blind"
OVERLOADED = "overloaded"
SCAN_LOST = "scan_lost"
LINK_LOST = "link_lost"
COMMAND_LOST = "command_lost"
COMMAND_LATE = "command_late"
BUMPER = "bumper"
CLIFF = "cliff"
BATTERY = "battery"
COLLISION = "collision"
SHUTDOWN = "shutdown"
DOES_NOT_OBEY = "does_not_obey"
# Storage.
NOT_SAVED = "not_saved"
# Settings.
ONLY_IN_FILE = "only_in_file"
FILE_CHANGED = "file_changed"

SENTENCES: dict[str, str] = {
    BAD_REQUEST: "The request was not understood.",
    UNKNOWN_NAME: "There is nothing by that name.",
    TOO_LARGE: "The message is larger than allowed.",
    NOT_READY: "The service that answers this is not running or lacks something it needs.",
    TIMEOUT: "There was no answer in time.",
    INTERNAL: "The service had an internal error; its log has the details.",
    LOST: "The robot does not know where it is.",
    STALE: "The newest pose is too old.",
    MOVING: "The robot is moving; save the place when it stands still.",
    NOT_CONVERGED: "The pose is not certain enough yet; drive a little or set the pose.",
    EXISTS: "That name is taken; choose another one, or use `replace` to overwrite it.",
    OUTSIDE_MAP: "That place lies outside the map.",
    IN_OBSTACLE: "The robot does not fit there: something is in the way.",
    IN_PASSAGE: "That is a narrow passage: while the robot stands there, nobody gets past it.",
    WRONG_MAP: "That place belongs to another map.",
    MAPPING: "A map is being made; save it or cancel it first.",
    NOT_MAPPING: "No map is being made.",
    NOT_LOOSE: "What the robot maps is joined to the map already.",
    NO_MATCH: "The walls of the two maps match nowhere; say where the other map lies.",
    AMBIGUOUS: "The walls of the two maps match in several ways; say where the other map lies.",
    KEEPOUT: "That place lies in a no-go area.",
    NO_PATH: "There is no path there for a robot of this size.",
    NOT_LOCALIZED: "The robot does not know where it is yet; set its pose or let it search.",
    WRONG_FRAME: "Goals are accepted only in the planner's own frame.",
    STOPPED: "The robot is stopped; resume it first.",
    TOUR_NOT_RUNNING: "Place names need the tour service, which is not running.",
    NOT_CURRENT: "That is not the current goal, so nothing was changed.",
    REPLACED: "A newer goal replaced it.",
    CANCELED: "The goal was canceled.",
    PAUSED: "The goal is paused; resume it or send a new one.",
    TAKEN_OVER: "Somebody else is driving the robot; resume the goal to continue.",
    BLOCKED: "Something is in the way and does not move.",
    SLIP: "The wheels turn, but the robot does not move.",
    OSCILLATION: "The robot is going back and forth without getting closer.",
    WAITING: "The robot is waiting for its path to clear.",
    RESTARTED: "The service was restarted.",
    NOBODY: "The lidar sees nobody there to follow.",
    PERSON_LOST: "The person is out of sight, so the robot no longer follows them.",
    OFF_MAP: "The robot is off the map, and the path to the goal leads further off it.",
    NOT_DRIVING: "No trip is under way.",
    OTHER_GOAL: "Somebody sent the robot elsewhere; resume the tour to continue.",
    NO_PLANNER: "The planner is not running; the trip continues when it is back.",
    ABORTED: "The trip was given up after a stop failed.",
    SKIPPED: "The stop was skipped.",
    LOW_BATTERY: "The battery is low; charge it.",
    BUSY: "The robot is already on its way.",
    CHARGING: "The robot is charging.",
    BUTTON: "The stop button was pressed.",
    STOP_FIELD: "Something is too close in the direction of travel.",
    BLIND: "The lidar does not see where the robot would drive.",
    OVERLOADED: "The robot's computer is too slow or too busy to look where it drives.",
    SCAN_LOST: "The lidar is silent.",
    LINK_LOST: "The connection to the motor board is down.",
    COMMAND_LOST: "Velocity commands stopped arriving.",
    COMMAND_LATE: "Velocity commands are ignored, since they arrive more than half a second late "
    "or their time is not the robot's.",
    BUMPER: "The bumper was hit.",
    CLIFF: "A cliff sensor sees no floor.",
    BATTERY: "The battery is too low to drive.",
    COLLISION: "The robot touched something.",
    SHUTDOWN: "The base service is shutting down.",
    DOES_NOT_OBEY: "The motor board does not obey.",
    NOT_SAVED: "It could not be written to disk.",
    ONLY_IN_FILE: "That setting can only be changed in robot.toml itself, on the robot.",
    FILE_CHANGED: "Somebody has edited robot.toml meanwhile, so nothing was changed.",
}
"""One plain sentence per code."""


class Refused(Exception):
    """A request was refused: `code` is one of this module's, the message one plain sentence.

    Services raise it to refuse; in clients it is raised when a request was refused.
    """

    def __init__(self, code: str, message: str | None = None, **details: Any) -> None:
        """Make a refusal; without `message` it uses the code's own sentence.

        What was asked for stands in many sentences, and may be a name of a million letters.
        """
        self.code = code
        message = SENTENCES.get(code, code) if message is None else message
        self.message = shorten(message)
        self.details = details
        super().__init__(self.message)
