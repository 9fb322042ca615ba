"""Online supervision: one measured pose against the expected one, both with their uncertainty, and when to raise alarm.

A level is raised only where the error is beyond it by more than measurement and expectation together can be off.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Annotated

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array
from armsight.errors import UsageError
from armsight.fields import Doc
from armsight.fitting.quantiles import chi2_ppf
from armsight.geometry.poses import skew
from armsight.kinematics import Arm, fk_jacobian, parameter_jacobian, parameter_names
from armsight.records import PoseStatus, TargetPose
from armsight.records.motion import JointsAt
from armsight.records.output import Output, output
from armsight.units import DEG, MM

FALSE_ALARM = 1e-9
"""Probability that noise alone lifts one decision over a level: at 60 a second one in half a year."""
BEYOND = float(np.sqrt(chi2_ppf(1.0 - FALSE_ALARM, 3)))
"""... in standard deviations of a vector's length."""
WINDOW = 10
"""Poses in a row that are judged together as well: their mean shows errors that noise hides in one."""
WINDOW_S = 0.5
"""Poses further apart in time do not belong together."""
CALM = 15
"""Poses in a row below a level before a warning ends."""
COVERAGE = 2.0
"""Standard deviations by which an error must stay below a level to be called within it (ISO 14253-1)."""


class Level(IntEnum):
    """How far off the arm is."""

    GOOD = 0
    WARN = 1
    STOP = 2

    @property
    def word(self) -> str:
        """Its name in files."""
        return self.name.lower()


def never() -> float | None:
    """Return the level that nothing reaches; made, so that programs are always told of it."""
    return None


@output
class Limits(Output):
    """The levels as they were set; null: none."""

    warn_m: Annotated[float | None, Doc("Error of place that warns, m.")] = field(default_factory=never)
    stop_m: Annotated[float | None, Doc("Error of place that stops, m.")] = field(default_factory=never)
    warn_rad: Annotated[float | None, Doc("Error of rotation that warns, rad.")] = field(default_factory=never)
    stop_rad: Annotated[float | None, Doc("Error of rotation that stops, rad.")] = field(default_factory=never)

    def __post_init__(self) -> None:
        for warn, stop, unit in ((self.warn_m, self.stop_m, "mm"), (self.warn_rad, self.stop_rad, "deg")):
            for value in (warn, stop):
                if value is not None and not (np.isfinite(value) and value > 0.0):
                    raise UsageError(f"a level of {value} in m or rad is none", cure="Give a positive number")
            if warn is not None and stop is not None and warn > stop:
                raise UsageError(
                    f"--warn-{unit} is above --stop-{unit}",
                    consequence="The arm would stop before it warns",
                    cure="Give a warning level below the one that stops",
                )

    @property
    def stops(self) -> bool:
        """Whether anything stops the robot."""
        return self.stop_m is not None or self.stop_rad is not None

    @property
    def all(self) -> tuple[tuple[Level, int, float], ...]:
        """Return what is set, the gravest first: the level, which half of the error (0 position, 1 turn), its size."""
        levels = (
            (Level.STOP, 0, self.stop_m),
            (Level.STOP, 1, self.stop_rad),
            (Level.WARN, 0, self.warn_m),
            (Level.WARN, 1, self.warn_rad),
        )
        return tuple((level, half, value) for level, half, value in levels if value is not None)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Compared:
    """One moment. error (6,): measured minus expected, m and rotation vector in rad, in the parent's axes. random (6,
    6): covariance of what changes from pose to pose; systematic (6, 6): of what stays. expected_std (6,):
    of the expected pose by itself."""

    t_s: float
    error: Array
    random: Array
    systematic: Array
    expected_std: Array

    @property
    def error_m(self) -> float:
        """Length of the error of position."""
        return float(np.linalg.norm(self.error[:3]))

    @property
    def error_rad(self) -> float:
        """Angle of the error of rotation."""
        return float(np.linalg.norm(self.error[3:]))

    @property
    def std_m(self) -> float:
        """Standard deviation of the error of position along its own direction: measurement and expectation."""
        return _along(self.error[:3], (self.random + self.systematic)[:3, :3])

    @property
    def std_rad(self) -> float:
        """... of the error of rotation about its own axis."""
        return _along(self.error[3:], (self.random + self.systematic)[3:, 3:])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PredictedPose:
    """What is expected and how well that is known.

    arm: its tool is the target; T_world_base is that of the frame the rig's place T_parent_rig is given in.
    rig_covariance (6, 6): of T_parent_rig, None where not known. joint_std: of a reading, rad or m. time_std_s: of the
    exposure on the robot's clock. turns (s, 4, 4): of the target's axes, by which it looks the same; of these the one
    nearest to what is expected is taken, since no picture tells them apart.
    """

    arm: Arm
    T_parent_rig: RigidTransform
    rig_covariance: Array | None = None
    joint_std: float = 0.0
    time_std_s: float = 0.0
    turns: Array = field(default_factory=lambda: np.eye(4)[None])

    def compare(self, pose: TargetPose, joints: JointsAt) -> Compared:
        """Return a measured pose (status ok, in rig axes) beside the one expected at these joints.

        Raises UsageError for a pose without rotation.
        """
        if pose.status is not PoseStatus.OK or pose.T_parent_target is None or pose.covariance is None:
            raise UsageError("only a whole pose can be compared")
        P = self.T_parent_rig.as_matrix()
        E, changing, staying = self._expected(joints)
        counted = P @ pose.T_parent_target  # (4, 4), its axes as the picture had them
        T = max(counted @ self.turns, key=lambda one: float((one[:3, :3] * E[:3, :3]).sum()))
        turned = lever(T[:3, 3] - counted[:3, 3]) @ np.kron(np.eye(2), P[:3, :3])  # (6, 6): rig axes to the parent's
        own = turned @ pose.covariance @ turned.T
        lasting = np.zeros((6, 6))
        if pose.systematic_covariance is not None:
            lasting = turned @ pose.systematic_covariance @ turned.T
        measured = own + self._placed(T[:3, 3] - P[:3, 3])
        turn = Rotation.from_matrix(T[:3, :3] @ E[:3, :3].T).as_rotvec()
        return Compared(
            t_s=pose.t_s,
            error=np.concatenate([T[:3, 3] - E[:3, 3], turn]),
            random=own - lasting + changing,
            systematic=measured - own + lasting + staying,
            expected_std=np.sqrt(np.diag(changing + staying)),
        )

    def _placed(self, way: Array) -> Array:
        """Return (6, 6) what the rig's uncertain position does to a target that is way (3,) from it."""
        if self.rig_covariance is None:
            return np.zeros((6, 6))
        moved = lever(way)
        return np.asarray(moved @ self.rig_covariance @ moved.T)

    def _expected(self, joints: JointsAt) -> tuple[Array, Array, Array]:
        """Return the expected pose (4, 4) and the covariances (6, 6) of what changes in it and of what stays."""
        arm = self.arm
        q = arm.values(joints.q)
        T, J = fk_jacobian(arm, q)  # (4, 4), (6, n)
        J = J @ arm.gearing
        bend = J * joints.bend  # straight lines between readings err to one side while the arm turns round
        noise = self.joint_std**2 * (J @ J.T)
        late = self.time_std_s * (J @ joints.speed)  # (6,)
        staying = bend @ bend.T + np.outer(late, late)
        if arm.covariance is not None:
            columns = parameter_jacobian(arm, q)[1]
            names = parameter_names(arm)
            chosen = [k for k, name in enumerate(arm.covariance.names) if name in names]
            C = columns[:, [names.index(arm.covariance.names[k]) for k in chosen]]
            staying = staying + C @ arm.covariance.matrix[np.ix_(chosen, chosen)] @ C.T
        return T, noise, staying


def lever(way: Array) -> Array:
    """Return (6, 6): how a pose's error moves a point that is way (3,) from its origin and turns with it."""
    out = np.eye(6)
    out[:3, 3:] = -skew(way)
    return out


@dataclass(frozen=True, slots=True, kw_only=True)
class Alarm:
    """A level newly raised, since when, and why in words."""

    level: Level
    t_s: float
    why: str


class Watch:
    """Judges compared poses in the order of time; a stop holds, a warning ends after CALM poses below it."""

    def __init__(self, limits: Limits) -> None:
        """Begin at good."""
        self._limits = limits
        self._recent: deque[Compared] = deque(maxlen=WINDOW)
        self._calm = 0
        self.level = Level.GOOD

    def add(self, seen: Compared) -> Alarm | None:
        """Judge one more pose; return the alarm where the level rises."""
        while self._recent and seen.t_s - self._recent[0].t_s > WINDOW_S:
            self._recent.popleft()
        self._recent.append(seen)
        level, why = self._judged()
        if level > self.level:
            self.level, self._calm = level, 0
            return Alarm(level=level, t_s=seen.t_s, why=why)
        self._calm = 0 if level == self.level else self._calm + 1
        if self.level is Level.WARN and self._calm >= CALM:
            self.level = Level.GOOD
        return None

    def _judged(self) -> tuple[Level, str]:
        """Return the gravest level that the newest pose, or the mean of the last ones, is beyond for sure."""
        newest = self._recent[-1]
        means = [(newest.error, newest.random + newest.systematic, 1)]
        if len(self._recent) == WINDOW:
            error = np.mean([one.error for one in self._recent], axis=0)
            random = np.mean([one.random for one in self._recent], axis=0) / WINDOW
            means.append((error, random + np.mean([one.systematic for one in self._recent], axis=0), WINDOW))
        for level, half, limit in self._limits.all:
            part = slice(3 * half, 3 * half + 3)
            for error, covariance, n in means:
                size, std = float(np.linalg.norm(error[part])), _along(error[part], covariance[part, part])
                if size - BEYOND * std > limit:
                    return level, _exceedance_text(level, half, size, std, limit, n)
        return Level.GOOD, ""


def surely_within(seen: Compared, limits: Limits) -> bool:
    """Tell whether the newest error is below every level that is set by more than its doubt, in whatever direction.

    The doubt along a small error says nothing of the error across, where two cameras see far less well into the depth.
    That no level is raised says less: a measurement worth nothing raises none. Without any level: False.
    """
    doubt = seen.random + seen.systematic  # (6, 6)
    sizes = ((seen.error_m, _widest(doubt[:3, :3])), (seen.error_rad, _widest(doubt[3:, 3:])))
    return bool(limits.all) and all(
        sizes[half][0] + COVERAGE * sizes[half][1] <= limit for _, half, limit in limits.all
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Seen:
    """A measured pose and what was made of it. at_s: of the exposure, on time.monotonic; lost: why nothing is compared.

    limits: the levels that it was judged by; level: the gravest now, and why in words. blind: whether nothing was
    compared for longer than a few pictures.
    """

    pose: TargetPose
    compared: Compared | None
    level: Level
    why: str
    limits: Limits
    lost: str
    at_s: float
    blind: bool = False

    @property
    def in_tolerance(self) -> bool | None:
        """Whether the arm is within its levels for sure (True), or beyond one (False); None where that is not known."""
        if self.compared is None:
            return None
        if self.level is not Level.GOOD:
            return False
        return True if surely_within(self.compared, self.limits) else None


def _widest(covariance: Array) -> float:
    """Return the standard deviation of a vector (3,) in the direction in which it is known worst."""
    return float(np.sqrt(np.linalg.norm(covariance, 2)))


def _along(error: Array, covariance: Array) -> float:
    """Return the standard deviation of a vector (3,) along itself; across where it is zero, the largest."""
    size = float(np.linalg.norm(error))
    if not size > 0.0:
        return _widest(covariance)
    variance = float(error @ covariance @ error)
    return float(np.sqrt(max(variance, 0.0)) / size)


def _exceedance_text(level: Level, half: int, size: float, std: float, limit: float, n: int) -> str:
    factor, unit, what = ((MM, "mm", "place"), (DEG, "deg", "rotation"))[half]
    of = "" if n == 1 else f", mean of {n} poses"
    return (
        f"{level.word}: the {what} is off by {size / factor:.3g} +- {std / factor:.2g} {unit}{of}; "
        f"the level is {limit / factor:.3g} {unit}"
    )
