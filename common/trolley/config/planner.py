"""Settings of the planner: `[planner]` in robot.toml."""

from typing import Annotated, Literal

from msgspec import Meta, Struct

Speed = Annotated[float, Meta(gt=0.0, le=5.0)]
Rate = Annotated[float, Meta(gt=0.0, le=20.0)]
Distance = Annotated[float, Meta(gt=0.0, le=100.0)]
Margin = Annotated[float, Meta(ge=0.0, le=1.0)]
Seconds = Annotated[float, Meta(gt=0.0, le=3600.0)]


class PlannerConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How the planner drives; the base reports its own limits of speed, turn rate and braking."""

    frame: Literal["map", "odom"] = "map"
    """Frame of goals: `map` needs a map and a pose on it; `odom` needs only the lidar."""
    turn_to_find: bool = False
    """Whether a robot that does not know where it is may turn on the spot once to find out."""

    max_speed_mps: Speed = 0.5
    """Highest speed of the planner; the base's own limit applies as well."""
    max_turn_radps: Rate = 1.5
    """Highest turn rate."""
    acceleration_mps2: Rate = 0.6
    """How fast the speed may change, up and down."""
    angular_acceleration_radps2: Rate = 3.0
    """How fast the turn rate may change."""
    slow_speed_mps: Speed = 0.15
    """Speed right beside an obstacle; in a tight place up to twice as much, the more of
    `clearance_m` it keeps, and three times with 2 cm more."""
    unsure_speed_mps: Speed = 0.15
    """Highest speed while the pose is `unsure`."""
    caution_distance_m: Distance = 0.35
    """Clearance below which the robot slows down [m]."""
    clearance_m: Margin = 0.03
    """Distance that the footprint keeps from obstacles if there is room; best below the stop margin
    [m]."""

    unknown_is_free: bool = False
    """Whether paths may lead through unknown cells of the map (in `odom` they may)."""
    inflation_falloff_m: Distance = 0.15
    """Distance over which the cost of passing an obstacle falls to 1/e [m]."""
    inflation_height: Annotated[float, Meta(ge=0.0, le=30.0)] = 8.0
    """Cost of touching an obstacle; open floor costs 1 per metre."""
    odom_size_m: Annotated[float, Meta(ge=4.0, le=200.0)] = 40.0
    """Edge of the square costmap around the robot in frame `odom` [m]."""
    odom_resolution_m: Annotated[float, Meta(ge=0.01, le=0.5)] = 0.05
    """Cell edge of the costmap in frame `odom`; in frame `map` it is the map's [m]."""

    mark_range_m: Distance = 6.0
    """Echoes farther away are not put into the costmap [m]."""
    clear_range_m: Distance = 8.0
    """Beams clear the costmap up to here [m]."""
    mirror_tolerance_m: Margin = 0.12
    """How far an echo or a beam may miss a mirror's line because of pose error [m]."""
    fade_s: Seconds = 3.0
    """How long an obstacle seen once is remembered while it is out of sight."""
    fade_per_sighting_s: Seconds = 0.5
    """How much longer it is remembered for each scan that confirmed it."""
    fade_max_s: Seconds = 60.0
    """Longest time for which an obstacle out of sight is remembered."""

    controller: Literal["mppi", "pursuit"] = "mppi"
    """How it steers where something is near or somebody walks: by comparing many simulated
    trajectories (MPPI), or by pure pursuit (cheap). Elsewhere it follows the path itself."""
    control_rate_hz: Annotated[float, Meta(ge=5.0, le=30.0)] = 20.0
    """Commands per second."""
    horizon_s: Annotated[float, Meta(ge=0.5, le=6.0)] = 2.4
    """How far ahead the controller looks."""
    rollouts: Annotated[int, Meta(ge=32, le=4000)] = 512
    """Trajectories that the controller compares for each command."""
    seed: Annotated[int, Meta(ge=0, le=2**31 - 1)] = 0
    """Seed of the controller's samples."""

    replan_s: Seconds = 1.0
    """Time between searches for a better path; a blocked one is replaced at once."""
    progress_distance_m: Distance = 0.15
    """Progress that the robot must make within `progress_s` (or turn half a radian) [m]."""
    progress_s: Seconds = 6.0
    """Time without progress by `progress_distance_m` after which the robot tries to free itself."""
    patience_s: Seconds = 5.0
    """How long the robot waits at a blocked path before it takes a much longer one; if there is
    none, it waits three times as long at a distance, before it comes closer and tries to free
    itself. For somebody who was seen to walk or to stir there it waits for `give_up_s`."""
    back_up_m: Annotated[float, Meta(ge=0.0, le=2.0)] = 0.4
    """How far the robot backs up along its own path to free itself [m]."""
    give_up_s: Seconds = 60.0
    """How long the robot tries to free itself, or waits for its pose or for somebody in the only
    way, before the goal fails."""
