"""Set points of a planned path, one a cycle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from ruckig import ControlInterface, InputParameter, Result, Ruckig, Trajectory
from scipy.spatial.transform import RigidTransform

from armsight.control.play.plan import PathPlan
from armsight.control.play.track import ARM_M, PATH_ACCELERATION_M_S2, PATH_JERK_M_S3, Leg, Way
from armsight.control.setpoints import CycleState, Finished, Hold, SetPoint, ToolPose
from armsight.errors import UsageError
from armsight.geometry import pose_difference
from armsight.units import MM

AT_REST = 1e-6
"""Joints slower than this (rad/s or m/s) stand."""
ARRIVED_M = 1e-7
BEHIND_M, CLOSE_M = 5e-4, 1e-4
"""An arm that is further behind the set point than the first makes the path wait until it is nearer than the second."""
REJOIN_M = 0.02
"""An arm further from the path than this is not brought back to it by itself."""
REJOIN_SPEED_M_S = 0.01
TRIES = 3
"""A position that the guard refused so often is not tried again until resume() is called."""
TRIED_M = 1e-3
"""So much further along, refusals are counted anew."""
CALM_S = 1.0
"""After so long without motion tries are counted anew; one that was given up waits for the operator's resume()."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PlayProgress:
    """Where a path is. stage: approach, path or finished. share: of the path, 0 to 1. s_m of length_m: along it.

    waiting: it stands until the guard lets it go on, or the arm has caught up. welding: where the path welds, while the
    tip goes along it.
    """

    stage: str
    share: float
    s_m: float
    length_m: float
    speed_m_s: float
    paused: bool
    waiting: bool
    welding: bool


class PathSource:
    """Runs a plan: to the path's start, then along it. next is for the loop; all else may be called from any thread.

    Speed along each way changes with bounded acceleration and jerk. Where the guard did not follow, the path stands
    still, and goes on from the same position once the arm was brought back to it, slowly and straight.
    """

    name = "path"

    def __init__(self, plan: PathPlan, *, override: float = 1.0) -> None:
        """override: share of the planned speed, 0.01 to 1. Raises UsageError for another."""
        self.plan = plan
        self._ways: tuple[Way, ...] = plan.ways
        self._override = _checked_override(override)
        self._paused = False
        self._stage = 0
        self._rejoin: Leg | None = None
        self._state = (0.0, 0.0, 0.0)  # length, speed, acceleration along the way that is run
        self._kept_m = 0.0  # where on its way the path waits while the arm comes back to it
        self._sent: RigidTransform | None = None
        self._stood = True
        self._waiting = False
        self._tries, self._tried_at, self._still_s = 0, (0, 0.0), 0.0
        self._cycle_s = 0.0
        self._ruckig: Ruckig | None = None

    @property
    def override(self) -> float:
        """Share of the planned speed."""
        return self._override

    @override.setter
    def override(self, share: float) -> None:
        self._override = _checked_override(share)

    def pause(self) -> None:
        """Come to rest along the path, and wait there."""
        self._paused = True

    def resume(self) -> None:
        """Go on, also from a position that was given up."""
        self._paused = False
        self._tries = 0

    @property
    def progress(self) -> PlayProgress:
        """Where the path is."""
        last = len(self._ways) - 1
        stage = self._stage
        s_m = (self._kept_m if self._rejoin is not None else self._state[0]) if stage == last else 0.0
        s_m = self.plan.length_m if stage > last else s_m
        return PlayProgress(
            stage="finished" if stage > last else "path" if stage == last else "approach",
            share=s_m / self.plan.length_m,
            s_m=s_m,
            length_m=self.plan.length_m,
            speed_m_s=self._state[1],
            paused=self._paused,
            waiting=self._waiting,
            welding=stage == last and self._moves_along and self._welds_at(s_m),
        )

    def next(self, now: CycleState) -> SetPoint:
        """Return the tip's pose at the end of this cycle; Finished at the end, Hold where the guard did not follow."""
        if self._stage >= len(self._ways):
            return Finished()
        if not now.running:
            return self._stand(now)
        if self._stood:
            if float(np.abs(now.qd_sent).max()) > AT_REST:
                return Hold()
            why = self._begin_again(now)
            if why:
                return Hold(why=why)
        way = self._way
        self._advance(way, now)
        pose = way.pose(self._state[0])
        self._sent = pose
        if self._state[0] >= way.length_m - ARRIVED_M and self._state[1] <= ARRIVED_M:
            self._arrived()
        return ToolPose(T_base_tool=pose)

    def warm_up(self) -> None:
        """Run once what a cycle runs."""
        trajectory = Trajectory(1)
        Ruckig(1, 0.01).calculate(_along(self._ways[0], (0.0, 0.0, 0.0), 1.0, wait=False), trajectory)
        for way in self._ways:
            way.pose(0.0)
            way.speed_at(0.0)

    @property
    def _moves_along(self) -> bool:
        """Whether the tip goes along the path now: one that rests, or comes back to it, does not weld."""
        return self._rejoin is None and not self._stood and self._state[1] > 0.0

    @property
    def _way(self) -> Way:
        return self._ways[self._stage] if self._rejoin is None else self._rejoin

    def _stand(self, now: CycleState) -> SetPoint:
        """Stay on the path where it was: the guard brings the arm to rest in its own way."""
        if not self._stood:
            self._stood, self._still_s = True, now.t_s
            if now.refused:
                self._count_try()
        if now.t_s - self._still_s > CALM_S and not self._given_up:
            self._tries = 0
        self._waiting = True
        if self._rejoin is None:
            self._kept_m = self._state[0]
        self._state = (self._state[0], 0.0, 0.0)
        return Hold(why=self._given_up) if self._given_up else Hold()

    def _count_try(self) -> None:
        """Count that the path's own set point was refused; an enable that was let go of is no refusal."""
        position = (self._stage, self._state[0] if self._rejoin is None else self._kept_m)
        further = position[0] != self._tried_at[0] or abs(position[1] - self._tried_at[1]) > TRIED_M
        self._tries = 1 if further else self._tries + 1
        self._tried_at = position

    @property
    def _given_up(self) -> str:
        return "the guard refused the path here again and again" if self._tries >= TRIES else ""

    def _begin_again(self, now: CycleState) -> str:
        """Go on from where the arm stands; return why that is not done, or nothing."""
        if self._given_up:
            return self._given_up
        way = self._ways[self._stage]
        back = Leg(now.T_base_tool, way.pose(self._kept_m), REJOIN_SPEED_M_S)
        if back.length_m > REJOIN_M:
            return f"the tip is {back.length_m / MM:.0f} mm from the path: begin it anew"
        self._rejoin = back if back.length_m > 1e-5 else None
        self._state = (0.0 if self._rejoin is not None else self._kept_m, 0.0, 0.0)
        self._stood, self._sent = False, None
        return ""

    def _advance(self, way: Way, now: CycleState) -> None:
        """Go on along the way by a cycle."""
        if self._ruckig is None or now.cycle_s != self._cycle_s:
            self._ruckig, self._cycle_s = Ruckig(1, now.cycle_s), now.cycle_s
        self._waiting = self._behind(now)
        wanted = _along(way, self._state, self._override, wait=self._paused or self._waiting)
        trajectory = Trajectory(1)
        if self._ruckig.calculate(wanted, trajectory) not in (Result.Working, Result.Finished):
            self._state = (self._state[0], 0.0, 0.0)
            return
        s, v, a = (float(value[0]) for value in trajectory.at_time(now.cycle_s))
        self._state = (min(max(s, self._state[0]), way.length_m), max(v, 0.0), a)

    def _behind(self, now: CycleState) -> bool:
        """Tell whether the arm is too far from the newest set point for the path to go on."""
        if self._sent is None:
            return False
        off = pose_difference(now.T_base_tool, self._sent)
        off_m = max(float(np.linalg.norm(off[:3])), ARM_M * float(np.linalg.norm(off[3:])))
        return off_m > (CLOSE_M if self._waiting else BEHIND_M)

    def _arrived(self) -> None:
        """Go on to the next way, from rest."""
        if self._rejoin is not None:
            self._rejoin = None
            self._state = (self._kept_m, 0.0, 0.0)
            return
        self._stage += 1
        self._state, self._kept_m = (0.0, 0.0, 0.0), 0.0

    def _welds_at(self, s_m: float) -> bool:
        on = False
        for at_m, state in self.plan.welds:
            if at_m <= s_m:
                on = state
        return on


def _along(way: Way, state: tuple[float, float, float], override: float, *, wait: bool) -> InputParameter:
    """Return what ruckig is asked for one way: to its end, or to rest where it is to wait."""
    wanted = InputParameter(1)
    wanted.current_position, wanted.current_velocity, wanted.current_acceleration = ([value] for value in state)
    wanted.target_velocity = wanted.target_acceleration = [0.0]
    wanted.max_velocity = [max(override * way.speed_at(state[0]), 1e-5)]
    wanted.max_acceleration, wanted.max_jerk = [PATH_ACCELERATION_M_S2], [PATH_JERK_M_S3]
    if wait:
        wanted.control_interface = ControlInterface.Velocity
    else:
        wanted.target_position = [way.length_m]
    return wanted


def _checked_override(share: float) -> float:
    if not 0.01 <= share <= 1.0:
        raise UsageError(
            f"an override of {share:g} is no share from 0.01 to 1",
            consequence="It is left as it is",
            cure="Give for instance 0.5 (--override)",
        )
    return float(share)
