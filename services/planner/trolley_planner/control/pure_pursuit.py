"""Regulated pure pursuit: the cheap controller, with plain motions where it would collide.

Source:
    Macenski, Singh, Martin, Gines, Regulated Pure Pursuit for Robot Path Tracking (2023).
    Deviation: the carrot lies down the local costmap's cost-to-go, which leads around what stands
    on the path, and the speed beside obstacles is that of the rollouts.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.config import PlannerConfig
from trolley.geometry import Twist2D
from trolley.jit import kernel
from trolley_planner.control.controller import Motion, first_step, limits_here, state_of
from trolley_planner.control.critics import Target, downhill_point
from trolley_planner.control.local_costmap import LocalCostmap
from trolley_planner.control.mppi import best_plain_into
from trolley_planner.control.path_tracking import track_into
from trolley_planner.control.robot_motion import (
    DT_S,
    Limits,
    advance,
    allowed_speed,
    followed,
    trace_into,
)
from trolley_planner.control.rollout import ROLLOUT, Scene, rollout
from trolley_planner.costmap.footprint import clearance_at
from trolley_planner.sensing.beams import wrapped


class PursuitParams(NamedTuple):
    """Lookahead and regulation; by hand."""

    lookahead_s: float = 1.0
    """Time that the carrot lies ahead of the robot at its present speed."""
    least_lookahead_m: float = 0.35
    """Least distance from the robot to the carrot."""
    most_lookahead_m: float = 1.2
    """Greatest distance from the robot to the carrot."""
    turn_in_place_rad: float = 0.7
    """The robot turns before it drives if the carrot is farther off its heading than this."""
    tight_radius_m: float = 0.6
    """On arcs tighter than this the speed falls in proportion."""


PURSUIT = PursuitParams()
LOOKAHEAD_SHARES = (1.0, 0.6, 0.35)
"""Shares of the lookahead distance that are tried in turn until a drive would not collide."""


class PurePursuit:
    """Steers for a carrot: a fiftieth of the work of `Mppi`, with less foresight.

    Args:
        config: horizon.
    """

    def __init__(self, config: PlannerConfig) -> None:
        self._controls = np.zeros((max(5, round(config.horizon_s / DT_S)), 2))
        self.reset()

    def reset(self) -> None:
        """Forget what the last command led to."""
        self.trajectory = np.empty((0, 3), dtype=np.float32)

    def command(
        self,
        motion: Motion,
        local_costmap: LocalCostmap,
        limits: Limits,
        target: Target,
        path: NDArray[np.float64],
        elapsed_s: float,
    ) -> Twist2D | None:
        """Return the velocity to drive now; see `Controller`."""
        limits = limits_here(limits, local_costmap, motion.pose)
        scene = Scene(local_costmap.field, local_costmap.body, limits, target)
        start = state_of(motion)
        cost = 0.0
        if not track_into(self._controls, start, scene, path):
            cost = pursue_freely_into(self._controls, start, scene)
        self.trajectory = np.empty((len(self._controls) + 1, 3), dtype=np.float32)
        trace_into(self.trajectory, self._controls, start, DT_S)
        if cost >= ROLLOUT.collision_cost:
            return None
        return first_step(motion, self._controls, elapsed_s)


@kernel
def pursue_freely_into(
    out_controls: NDArray[np.float64], start: NDArray[np.float64], scene: Scene
) -> float:
    """Write the commands (steps, 2) of a drive that does not collide, if any; return its cost."""
    for share in LOOKAHEAD_SHARES:
        pursue_into(out_controls, start, scene, share)
        cost = rollout(out_controls, start, scene)
        if cost < ROLLOUT.collision_cost:
            return cost
    return best_plain_into(out_controls, start, scene)


@kernel
def pursue_into(
    out_controls: NDArray[np.float64], start: NDArray[np.float64], scene: Scene, share: float
) -> None:
    """Write the commands (steps, 2) that follow the carrot.

    Args:
        out_controls: (steps, 2), overwritten.
        start: (5,) state.
        scene: what rollouts need.
        share: of the usual lookahead; less cuts corners less.
    """
    field, body, limits, target = scene.field, scene.body, scene.limits, scene.target
    state = start.copy()
    for step in range(out_controls.shape[0]):
        clearance = clearance_at(field, body, state[0], state[1], state[2], limits.caution_m)
        allowed = allowed_speed(field, limits, state[0], state[1], clearance)
        ahead = min(
            max(PURSUIT.lookahead_s * abs(state[3]), PURSUIT.least_lookahead_m),
            PURSUIT.most_lookahead_m,
        )
        x, y = downhill_point(field, state[0], state[1], share * ahead)
        dx, dy = x - state[0], y - state[1]
        distance = math.hypot(dx, dy)
        wanted_v, wanted_w = 0.0, 0.0
        if distance > field.coarse_m:
            bearing = wrapped(math.atan2(dy, dx) - state[2])
            if abs(bearing) > PURSUIT.turn_in_place_rad:
                rate = math.sqrt(1.6 * limits.turn_acceleration * abs(bearing))
                wanted_w = math.copysign(min(rate, limits.max_turn), bearing)
            else:
                curvature = 2.0 * math.sin(bearing) / distance
                wanted_v = regulated(allowed, curvature, limits)
                if not target.goes_on:
                    left = math.hypot(target.x - state[0], target.y - state[1])
                    wanted_v = min(wanted_v, math.sqrt(limits.deceleration * left) + 0.02)
                wanted_w = max(state[3], 0.05) * curvature
        state[3], state[4] = followed(state[3], state[4], (wanted_v, wanted_w), limits, allowed)
        out_controls[step, 0], out_controls[step, 1] = state[3], state[4]
        advance(state, limits.dt)


@kernel
def regulated(allowed: float, curvature: float, limits: Limits) -> float:
    """Return the speed on an arc: less where it is tight, and where the turn rate would not do."""
    bend = abs(curvature)
    speed = allowed / max(1.0, PURSUIT.tight_radius_m * bend)
    return min(speed, limits.max_turn / bend) if bend > 0.0 else speed
