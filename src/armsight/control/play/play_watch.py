"""A path held against the cameras while it is run: where the tip is seen, and where it was told to be."""

from __future__ import annotations

import math
import threading
from collections import deque
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.control.servo import Mount
from armsight.control.servo.law import ArmLag
from armsight.control.servo.premise import PremiseWatch
from armsight.control.servo.premise_bank import Premise
from armsight.control.setpoints import CycleState
from armsight.errors import StaleData
from armsight.kinematics import Arm
from armsight.records import JointReading, PoseStatus, TargetPose
from armsight.records.motion import JointHistory
from armsight.units import MM

KEPT = 4000
"""Cycles remembered: 16 s at 4 ms, more than any camera is late."""
AGREE = 2
"""So many frames one after the other must be off before the arm is stopped: one alone may be a reflection."""
LATE_S = 0.12
"""Pictures may be so much older than their times: --latency is seldom measured, and a path needs no better."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraPlacement:
    """How the cameras tell where the flange is.

    On the flange (EYE_IN_HAND) they see a target that stands: T_parent_camera in flange, T_parent_target in base.
    Beside the robot (EYE_TO_HAND) they see one that it carries: camera in base, target in flange.
    """

    mount: Mount
    T_parent_camera: RigidTransform
    T_parent_target: RigidTransform

    def flange(self, T_rig_target: RigidTransform) -> RigidTransform:
        """Return T_base_flange from a pose of the target in rig axes."""
        if self.mount is Mount.EYE_IN_HAND:
            return self.T_parent_target * T_rig_target.inv() * self.T_parent_camera.inv()
        return self.T_parent_camera * T_rig_target * self.T_parent_target.inv()

    def rig(self, T_base_flange: RigidTransform) -> RigidTransform:
        """Return the rig's pose in the axes in which the target stands: those of the base, or of the flange."""
        on_flange = self.mount is Mount.EYE_IN_HAND
        return (T_base_flange if on_flange else T_base_flange.inv()) * self.T_parent_camera


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WatchFigures:
    """How far the tip is from where it was told, m: of n frames, mean_m (3,) in base; last_s: the newest's exposure."""

    n: int
    rms_m: float | None = None
    max_m: float | None = None
    last_m: float | None = None
    last_s: float | None = None
    mean_m: Array | None = None


class PlayWatch:
    """Compares at each exposure. `cycle` is for the control loop, `observe` for the thread that measures."""

    def __init__(
        self, sight: CameraPlacement, arm: Arm, *, stop_m: float | None, arm_lag_s: float, cycle_s: float
    ) -> None:
        """arm: its tool is the tip. stop_m: beyond it the arm is to stop, None: only told. arm_lag_s: at first."""
        self._sight, self._arm, self._stop_m = sight, arm, stop_m
        self._T_base_world = arm.T_world_base.inv()
        self._premise = PremiseWatch(late_s=LATE_S)
        self._history = JointHistory(cycle_s)
        self._lag = ArmLag(arm_lag_s, cycle_s)
        self._commanded: deque[tuple[float, Array]] = deque(maxlen=KEPT)
        self._lock = threading.Lock()
        self._n, self._sum2, self._max = 0, 0.0, 0.0
        self._sum = np.zeros(3)
        self._last: tuple[float, float] | None = None
        self._far = 0
        self.exceeded = ""
        self.tip: RigidTransform | None = None

    @property
    def arm_lag_s(self) -> float:
        """From a command to the arm's motion: as assumed, then as measured."""
        return self._lag.lag_s

    @property
    def figures(self) -> WatchFigures:
        """What was seen so far."""
        with self._lock:
            if not self._n or self._last is None:
                return WatchFigures(n=0)
            return WatchFigures(
                n=self._n,
                rms_m=math.sqrt(self._sum2 / self._n),
                max_m=self._max,
                last_m=self._last[1],
                last_s=self._last[0],
                mean_m=self._sum / self._n,
            )

    def cycle(self, now: CycleState) -> None:
        """Take where the tip was told to be at the end of the cycle before; T_base_tool is of the tip."""
        self._commanded.append((now.t_s - now.cycle_s, np.asarray(now.T_base_tool.translation)))
        if now.q_s is not None:
            self._history.add(JointReading(q=now.q, t_s=now.q_s, sequence=0, source="play"))
            self._lag.add(now.t_s, now.q_s, now.q, now.q_sent)

    def observe(self, pose: TargetPose, exposed_s: float, now_s: float) -> None:
        """Take what a frame shows, in rig axes, exposed at exposed_s on the loop's clock; whole poses count."""
        self._lag.estimate(now_s)
        if pose.status is not PoseStatus.OK or pose.T_parent_target is None:
            self.tip = None
            return
        self._hold_against_arm(pose, exposed_s)
        tip = self._sight.flange(RigidTransform.from_matrix(pose.T_parent_target)) * self._arm.T_flange_tool
        self.tip = tip
        commanded = self._commanded_at(exposed_s - self._lag.lag_s)
        if commanded is not None:
            self._compare(np.asarray(tip.translation) - commanded, exposed_s)

    @property
    def wrong(self) -> Premise | None:
        """What the target's motion contradicts of what is believed; None where nothing."""
        return self._premise.wrong

    def _hold_against_arm(self, pose: TargetPose, exposed_s: float) -> None:
        """Hold how the target moves in the pictures against how the arm's readings say that it has to."""
        if pose.T_parent_target is None or pose.covariance is None:
            return
        arm = self._arm
        try:
            T_world_tip = RigidTransform.from_matrix(arm.fk(arm.values(self._history.at(exposed_s).q)))
        except StaleData:
            return
        T_base_flange = self._T_base_world * T_world_tip * arm.T_flange_tool.inv()
        sigma_m = np.sqrt(np.diag(pose.covariance)[:3])
        T_frame_rig = self._sight.rig(T_base_flange).as_matrix()
        self._premise.see(exposed_s, T_frame_rig, pose.T_parent_target[:3, 3], sigma_m)
        if self.wrong is not None:
            self.exceeded = self.exceeded or self.wrong.text

    def _commanded_at(self, t_s: float) -> Array | None:
        """Return where the tip (3,) was told to be at a time; None where that is not known."""
        known = list(self._commanded)
        if len(known) < 2 or not known[0][0] <= t_s <= known[-1][0]:
            return None
        t = np.array([moment for moment, _ in known])
        k = min(max(int(np.searchsorted(t, t_s)), 1), len(t) - 1)
        share = (t_s - t[k - 1]) / (t[k] - t[k - 1])
        return np.asarray(known[k - 1][1] + share * (known[k][1] - known[k - 1][1]))

    def _compare(self, off: Array, exposed_s: float) -> None:
        size = float(np.linalg.norm(off))
        with self._lock:
            self._n += 1
            self._sum2 += size**2
            self._sum = self._sum + off
            self._max = max(self._max, size)
            self._last = (exposed_s, size)
        self._far = self._far + 1 if self._stop_m is not None and size > self._stop_m else 0
        if self._far >= AGREE and not self.exceeded and self._stop_m is not None:
            self.exceeded = (
                f"the cameras see the tip {size / MM:.1f} mm from where it was told to be; "
                f"{self._stop_m / MM:.1f} mm are allowed"
            )
