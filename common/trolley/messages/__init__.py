"""Every message of the wire: msgspec structs, sent as maps with field names.

One module per subject; numbers are SI, angles counter-clockwise in radians, frames after REP-105.
Decoding checks bounds; arrays travel as little-endian bytes (`floats_to_bytes`,
`floats_from_bytes`).
"""

from trolley.geometry.pose import Pose2D, Twist2D
from trolley.messages.changing import ChangeKind, MapChange, MapChanges
from trolley.messages.drawing import Choice, Marker, Overlay, OverlayRule
from trolley.messages.driving import GoalState, GoalStatus, Path
from trolley.messages.map_making import MappingState, MappingStatus
from trolley.messages.mapping import (
    Candidate,
    MapInfo,
    OccupancyGrid,
    ParticleCloud,
    PoseEstimate,
    PoseState,
    Zone,
    Zones,
)
from trolley.messages.motion import (
    BaseState,
    Battery,
    Clock,
    Imu,
    Link,
    Odometry,
    Robot,
    Transform,
    Truth,
    VelocityCommand,
)
from trolley.messages.sensing import (
    BEHIND_MIRROR,
    EXPLAINED,
    NOT_ON_MAP,
    SUSPECTED,
    UNUSED,
    BeamClasses,
    Scan,
    SuspectLine,
    Suspects,
)
from trolley.messages.system import Alive, ErrorReply, Health
from trolley.messages.touring import (
    CapturedPose,
    Offer,
    PastTrip,
    SavedPose,
    SavedPoses,
    ScheduleEntry,
    Stop,
    StopResult,
    Tour,
    Tours,
    TourStatus,
)
from trolley.messages.types import floats_from_bytes, floats_to_bytes, name_problem

__all__ = [
    "BEHIND_MIRROR",
    "EXPLAINED",
    "NOT_ON_MAP",
    "SUSPECTED",
    "UNUSED",
    "Alive",
    "BaseState",
    "Battery",
    "BeamClasses",
    "Candidate",
    "CapturedPose",
    "ChangeKind",
    "Choice",
    "Clock",
    "ErrorReply",
    "GoalState",
    "GoalStatus",
    "Health",
    "Imu",
    "Link",
    "MapChange",
    "MapChanges",
    "MapInfo",
    "MappingState",
    "MappingStatus",
    "Marker",
    "OccupancyGrid",
    "Odometry",
    "Offer",
    "Overlay",
    "OverlayRule",
    "ParticleCloud",
    "PastTrip",
    "Path",
    "Pose2D",
    "PoseEstimate",
    "PoseState",
    "Robot",
    "SavedPose",
    "SavedPoses",
    "Scan",
    "ScheduleEntry",
    "Stop",
    "StopResult",
    "SuspectLine",
    "Suspects",
    "Tour",
    "TourStatus",
    "Tours",
    "Transform",
    "Truth",
    "Twist2D",
    "VelocityCommand",
    "Zone",
    "Zones",
    "floats_from_bytes",
    "floats_to_bytes",
    "name_problem",
]
