"""Set points of a planned path, or of a joint motion that was planned, one a cycle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from ruckig import ControlInterface, InputParameter, Result, Ruckig, Trajectory
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.control.play.plan import PathPlan
from armsight.control.play.timing import ARM_M, StraightSegment, Way
from armsight.control.setpoints import CycleState, Finished, Hold, JointGoal, JointVelocity, SetPoint, ToolPose
from armsight.errors import UsageError
from armsight.geometry.kernels import rotvec
from armsight.records import Motion
from armsight.units import MM

AT_REST = 1e-6
"""Joints slower than this (rad/s or m/s) stand."""
NEAR_M = 1e-6
"""From within this of its path an arm goes on along it as it is."""
BEHIND_M = 1e-5
"""An arm further from the set point than this has not followed: the path stands until it is NEAR_M and rests, so that
no corner is cut. Set points that the guard need not limit are met to 0.1 um."""
REJOIN_M = 0.02
"""An arm further from the path than this is not brought back to it by itself."""
REJOIN_SPEED_M_S = 0.01
TRIES = 3
"""A position that the guard refused so often is not tried again until resume() is called."""
TRIED_M = 1e-3
"""So much further along, refusals are counted anew."""
CALM_S = 1.0
"""After so long without motion tries are counted anew; one that was given up waits for the operator's resume()."""
CLOSE = 2e-3
"""rad or m: an arm so near to a joint motion goes along with it; one further off goes there first."""
ASTRAY = 0.02
"""Further from the motion than this the motion waits until the arm is back on it."""
ARRIVED = 1e-5
PULL_PER_S = 4.0
"""How quickly what an arm is off the motion is taken back."""
RAMP_S = 0.5
"""Time in which the motion gathers its full speed, and gives it up where it is paused."""


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

    An override and a pause change how fast the plan's time passes, within rates that the plan has room for, and never
    where the tip goes. Where the guard did not follow, time stands, and goes on from there once the arm was brought
    back to the path, slowly and straight.
    """

    name = "path"

    def __init__(self, plan: PathPlan, *, override: float = 1.0) -> None:
        """override: share of the planned speed, 0.01 to 1. Raises UsageError for another."""
        self.plan = plan
        self._ways: tuple[Way, ...] = plan.ways
        self._override = checked_override(override)
        self._paused = False
        self._stage = 0
        self._rejoin: StraightSegment | None = None
        self._clock = (0.0, self._override, 0.0)  # time of the way that is run, its rate, and how that changes
        self._kept_s = 0.0  # where on its way the path waits while the arm comes back to it
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
        self._override = checked_override(share)

    @property
    def paused(self) -> bool:
        """Whether it is paused."""
        return self._paused

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
        stage, rejoins, (t_s, rate, _) = self._stage, self._rejoin is not None, self._clock
        s_m, speed = (0.0, 0.0) if stage > last else self._ways[stage].along(self._kept_s if rejoins else t_s)
        if rejoins or self._stood:
            rate = 0.0
        s_m = self.plan.length_m if stage > last else s_m if stage == last else 0.0
        return PlayProgress(
            stage="finished" if stage > last else "path" if stage == last else "approach",
            share=s_m / self.plan.length_m,
            s_m=s_m,
            length_m=self.plan.length_m,
            speed_m_s=rate * speed,
            paused=self._paused,
            waiting=self._waiting,
            welding=stage == last and rate * speed > AT_REST and self._welds_at(s_m),
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
        pose = way.pose(self._clock[0])
        self._sent = pose
        if self._clock[0] >= way.duration_s:
            self._arrived()
        return ToolPose(T_base_tool=pose)

    def warm_up(self) -> None:
        """Run once what a cycle runs."""
        Ruckig(1, 0.01).calculate(_rate(self._ways[0], (0.0, 0.0, 0.0), 1.0), Trajectory(1))
        for way in self._ways:
            way.pose(0.0)
            way.along(0.0)

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
            self._kept_s = self._clock[0]
        self._clock = (self._clock[0], 0.0, 0.0)
        return Hold(why=self._given_up) if self._given_up else Hold()

    def _count_try(self) -> None:
        """Count that the path's own set point was refused; an enable that was let go of is no refusal."""
        kept_s = self._clock[0] if self._rejoin is None else self._kept_s
        position = (self._stage, self._ways[self._stage].along(kept_s)[0])
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
        back = StraightSegment(now.T_base_tool, way.pose(self._kept_s), REJOIN_SPEED_M_S)
        if back.length_m > REJOIN_M:
            return f"the tip is {back.length_m / MM:.0f} mm from the path: begin it anew"
        self._rejoin = back if back.length_m > NEAR_M else None
        # a way begins from rest by itself, in the midst of one its time gathers speed
        at_s = self._kept_s if self._rejoin is None else 0.0
        self._clock = (at_s, 0.0 if at_s > 0.0 or self._paused else self._override, 0.0)
        self._stood, self._sent = False, None
        return ""

    def _advance(self, way: Way, now: CycleState) -> None:
        """Go on along the way by a cycle; an arm that did not follow is waited for."""
        if self._ruckig is None or now.cycle_s != self._cycle_s:
            self._ruckig, self._cycle_s = Ruckig(1, now.cycle_s), now.cycle_s
        self._waiting = self._behind(now)
        trajectory = Trajectory(1)
        wanted = _rate(way, self._clock, 0.0 if self._paused else self._override)
        if self._waiting or self._ruckig.calculate(wanted, trajectory) not in (Result.Working, Result.Finished):
            self._clock = (self._clock[0], 0.0, 0.0)
            return
        t_s, rate, change = (float(value[0]) for value in trajectory.at_time(now.cycle_s))
        rate = rate if rate > AT_REST else 0.0
        self._clock = (min(max(t_s, self._clock[0]), way.duration_s), rate, change)

    def _behind(self, now: CycleState) -> bool:
        """Tell whether the arm did not follow the newest set point, or has not come to it since."""
        if self._sent is None:
            return False
        here, there = now.T_base_tool.as_matrix(), self._sent.as_matrix()
        off_m = float(np.linalg.norm(here[:3, 3] - there[:3, 3]))
        if len(now.q) >= 6:  # joints too few to turn the tool at will meet the position
            off_m = max(off_m, ARM_M * float(np.linalg.norm(rotvec(here[:3, :3] @ there[:3, :3].T))))
        if self._waiting:
            return off_m > NEAR_M or float(np.abs(now.qd_sent).max()) > AT_REST
        return off_m > BEHIND_M

    def _arrived(self) -> None:
        if self._rejoin is not None:
            self._rejoin = None
            self._clock = (self._kept_s, 0.0, 0.0)
            return
        self._stage += 1
        # the rate goes on, as both ways rest here; how it changes was within the limits of this way, not of the next
        self._clock, self._kept_s = (0.0, self._clock[1], 0.0), 0.0

    def _welds_at(self, s_m: float) -> bool:
        on = False
        for at_m, state in self.plan.welds:
            if at_m <= s_m:
                on = state
        return on


def _rate(way: Way, clock: tuple[float, float, float], wanted: float) -> InputParameter:
    asked = InputParameter(1)
    asked.control_interface = ControlInterface.Velocity
    asked.current_position, asked.current_velocity, asked.current_acceleration = ([value] for value in clock)
    asked.target_velocity, asked.target_acceleration = [wanted], [0.0]
    asked.max_acceleration, asked.max_jerk = ([value] for value in way.rates)
    return asked


def checked_override(share: float, consequence: str = "It is left as it is") -> float:
    """Return a share of the planned speed. Raises UsageError for another than 0.01 to 1."""
    if not 0.01 <= share <= 1.0:
        raise UsageError(
            f"an override of {share:g} is no share from 0.01 to 1",
            consequence=consequence,
            cure="Give for instance 0.5 (--override)",
        )
    return float(share)


class JointMotionSource:
    """Runs a motion of the joints: to its first reading as the guard goes there, then along it by its own times.

    Where the guard does not follow, the motion stands still, and goes on from the same reading once the arm was brought
    back to it. next is for the loop; pause, resume and override may be called from any thread.
    """

    name = "joint motion"

    def __init__(self, motion: Motion, *, override: float = 1.0) -> None:
        """override: share of the planned speed, 0.01 to 1. Raises UsageError for another."""
        self.override = checked_override(override, "Nothing is moved")
        self._t_s = motion.t_s - motion.t_s[0]
        self._spline = CubicSpline(self._t_s, motion.q)
        self._speed = self._spline.derivative()
        self._at_s, self._rate = 0.0, 0.0
        self._on_it, self._paused, self._finished = False, False, False

    @property
    def length_s(self) -> float:
        """How long the motion takes at full override."""
        return float(self._t_s[-1])

    @property
    def at_s(self) -> float:
        """How far along it the motion is, s of its own time."""
        return self._at_s

    @property
    def stage(self) -> str:
        """approach, motion or finished."""
        return "finished" if self._finished else "motion" if self._on_it or self._at_s > 0.0 else "approach"

    @property
    def paused(self) -> bool:
        """Whether it was told to wait."""
        return self._paused

    def pause(self) -> None:
        """Come to rest along the motion, and wait there."""
        self._paused = True

    def resume(self) -> None:
        """Go on."""
        self._paused = False

    def next(self, now: CycleState) -> SetPoint:
        """Return the joints' velocity along the motion; a goal where the arm is beside it; Finished at its end."""
        if self._finished:
            return Finished()
        if len(now.q_sent) != self._spline.c.shape[2]:
            return JointGoal(q=np.asarray(self._spline(0.0)))  # the guard refuses it, and says why
        goal = np.asarray(self._spline(self._at_s))
        off = float(np.abs(goal - now.q_sent).max())
        still = float(np.abs(now.qd_sent).max())
        if not now.running or (self._on_it and off > ASTRAY):
            self._on_it, self._rate = False, 0.0
        if not self._on_it:
            if not now.running or off > CLOSE or still > ARRIVED:
                return JointGoal(q=goal)
            self._on_it = True
        if self._paused and self._rate == 0.0:
            return Hold()
        return self._along(now, goal)

    def _along(self, now: CycleState, goal: Array) -> SetPoint:
        """Go on by a cycle, at a rate that grows and falls evenly; back towards the motion where it is beside it."""
        wanted = 0.0 if self._paused else self.override
        most = now.cycle_s / RAMP_S
        self._rate += float(np.clip(wanted - self._rate, -most, most))
        before, self._at_s = self._at_s, min(self._at_s + self._rate * now.cycle_s, self.length_s)
        if before >= self.length_s:
            if np.abs(goal - now.q_sent).max() < ARRIVED and np.abs(now.qd_sent).max() < ARRIVED:
                self._finished = True
                return Finished()
            return JointGoal(q=goal)
        pull = PULL_PER_S * (goal - now.q_sent)
        return JointVelocity(qd=np.asarray(self._rate * self._speed(self._at_s) + pull))
