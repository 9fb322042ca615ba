"""Set points of the servo: the arm keeps the target, or a tool keeps the target's position, where it is wanted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.control.guard import TargetState
from armsight.control.guard.space import pose_difference
from armsight.control.servo import law
from armsight.control.servo.premise import LEVER_M, PremiseWatch
from armsight.control.servo.premise_bank import INVERTED, Premise, impossible_pose, joint_reversed
from armsight.control.servo.target_track import LOST_S, TargetMotion, TargetTrack, Tracked
from armsight.control.setpoints import CycleState, Hold, SetPoint, ToolTwist
from armsight.errors import StaleData
from armsight.kinematics import Arm
from armsight.optics import Rig
from armsight.records import JointReading, PoseStatus, Target, TargetPose
from armsight.records.motion import JointHistory
from armsight.units import DEG, MM, MS

STALE_S = 0.15
"""A target whose last frame is older is not followed: four frames of a webcam."""
FIRST_M = 0.01
"""Beyond this way the speed may grow with the way that nothing contradicts: twofold after 20 mm."""
WHY = {
    TargetState.LOST: "the target is lost",
    TargetState.STALE: "the last frame with the target is too old",
    TargetState.JUMPED: "the target jumped",
}
ANEW = "let the enable go and give it anew"
NAMED_S = 0.5
"""A contradiction holds the arm at once; what it comes from is told when it stands and the last pictures have come."""
CONTRADICTED = "the target does not move as the arm's motion has to make it"
NOT_SEEN, SETTLING = "the target was not seen yet", "the target was seen only just now"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Seen:
    """The newest pose (4, 4) as it was measured, in flange axes at its exposure; has_rotation: with its rotation."""

    T_flange_target: Array
    has_rotation: bool


class ServoSource:
    """Follows a target. `observe` is for the thread that measures, `next` and `target` for the control loop.

    Neither waits for the other: the loop looks at one record that each frame replaces. Positions alone, of one or two
    lights, move the arm without turning it.
    """

    name = "servo"

    def __init__(self, arm: Arm, rig: Rig, target: Target, settings: law.ServoSettings, cycle_s: float) -> None:
        """cycle_s: of the loop. arm: whose T_flange_tool is the tool that set points are of."""
        self.settings = settings
        self._arm = arm
        self._rig = rig
        self._target = target
        self._cycle_s = cycle_s
        self._T_tool_flange = arm.T_flange_tool.inv().as_matrix()
        self._T_base_world = arm.T_world_base.inv().as_matrix()
        self._T_parent_camera = settings.T_parent_camera.as_matrix()
        self._T_flange_desired = settings.T_flange_desired.as_matrix()
        self._turn_wanted = settings.turning is not law.Turning.KEEP
        self._tool_m = np.array(arm.T_flange_tool.translation)
        self._track = TargetTrack(rig)
        self.history = JointHistory(cycle_s)
        self._camera = law.CameraDelay()
        self._lag = law.ArmLag(settings.arm_lag_s, cycle_s)
        self._seen: Seen | None = None
        self._unplaced = ""
        self._before_jump: Tracked | None = None
        self._reaction = law.Reaction(settings.chase_m)
        self._premise = PremiseWatch((*map(joint_reversed, range(arm.n)), INVERTED))
        self._T_camera_parent = law.inverse(self._T_parent_camera)
        self._q_begun = np.zeros(arm.n)
        self._contradicted_s = np.inf
        self.contradiction = ""
        self.error: law.ServoError | None = None

    @property
    def _turns(self) -> bool:
        return self._turn_wanted and self.settings.turning is not law.Turning.HOLD

    @property
    def camera_delay_s(self) -> float:
        """From exposure to the pose in memory, the median of the newest frames; 0 before the first."""
        return self._camera.delay_s

    @property
    def arm_lag_s(self) -> float:
        """From a command to the arm's motion: as assumed, then as measured."""
        return self._lag.lag_s

    @property
    def delay_s(self) -> float:
        """From exposure to the arm's motion."""
        return self._camera.delay_s + self._lag.lag_s

    @property
    def servo_cycle_s(self) -> float:
        """Time between two errors that the law gets: of the cameras or of the loop, the longer one."""
        return max(self._cycle_s, self._camera.period_s)

    @property
    def tracked(self) -> Tracked | None:
        """What is known of the target's motion in base axes; None before it was seen."""
        return self._track.now

    @property
    def wrong(self) -> Premise | None:
        """What the target's motion contradicts of what is believed; None where nothing."""
        return self._premise.wrong

    def observe(self, pose: TargetPose, exposed_s: float, now_s: float) -> None:
        """Take what a frame shows, in rig axes, exposed at exposed_s and known at now_s, both on the loop's clock."""
        self._camera.add(exposed_s, now_s)
        self._lag.estimate(now_s)
        T_rig_target, covariance = pose.T_parent_target, pose.covariance
        if T_rig_target is None or covariance is None:
            return
        impossible = impossible_pose(pose.status, float(T_rig_target[2, 3]))
        if impossible is not None:  # as good as not seen
            self._premise.refuse(impossible)
            return
        try:
            q = self.history.at(exposed_s).q
        except StaleData as error:
            self._unplaced = error.cause
            return
        self._unplaced = ""
        T_base_flange = self._flange(q)
        on_flange = self.settings.mount is law.Mount.EYE_IN_HAND
        T_base_rig = T_base_flange @ self._T_parent_camera if on_flange else self._T_parent_camera
        T_base_target, R = T_base_rig @ T_rig_target, T_base_rig[:3, :3]
        has_rotation = pose.status is PoseStatus.OK
        before = self._track.now
        if has_rotation:
            turned = np.zeros((6, 6))
            turned[:3, :3] = turned[3:, 3:] = R
            self._track.add(exposed_s, T_base_target, turned @ covariance @ turned.T)
        else:
            centre_m = self._middle(pose.spots)
            if centre_m is None:
                return
            self._track.add_position(exposed_s, T_base_target[:3, 3], R @ covariance @ R.T, centre_m)
        now = self._track.now
        if on_flange:
            begun = before is None or now is None or now.begun_s != before.begun_s
            self._held_against_arm(pose, exposed_s, q, T_base_flange, begun=begun)
        jumps = before is not None and now is not None and now.jumped and not before.jumped
        if jumps and self._before_jump is None:  # a second jump, near where the first led, is none back
            self._before_jump = before
        if not self.settings.predict:
            self._seen = Seen(T_flange_target=law.inverse(T_base_flange) @ T_base_target, has_rotation=has_rotation)

    def _held_against_arm(
        self, pose: TargetPose, exposed_s: float, q: Array, T_base_flange: Array, *, begun: bool
    ) -> None:
        T_rig_target, covariance = pose.T_parent_target, pose.covariance
        if T_rig_target is None or covariance is None:
            return
        T_base_rig = T_base_flange @ self._T_parent_camera
        sigma = np.full(6, np.inf)
        sigma[: len(covariance)] = np.sqrt(np.diag(covariance))
        self._reaction.see(T_base_rig, T_rig_target, sigma)
        if pose.status is not PoseStatus.OK:
            return
        if begun:
            self._premise.begin()
            self._q_begun = q
        others = self._elsewhere(q, T_base_flange)
        self._premise.see(exposed_s, T_base_rig, T_rig_target[:3, 3], sigma[:3], others)

    def target(self, now_s: float) -> tuple[TargetState, float | None]:
        """Return what is known of the target, and the age in s of the newest frame that shows it."""
        tracked = self._track.now
        if tracked is None:
            return TargetState.LOST, None
        age_s = now_s - tracked.seen_s
        if age_s > LOST_S:
            return TargetState.LOST, age_s
        if tracked.jumped or self._jumped_away(tracked):
            return TargetState.JUMPED, age_s
        return (TargetState.STALE if age_s > STALE_S else TargetState.FRESH), age_s

    def next(self, now: CycleState) -> SetPoint:
        """Return the tool's twist towards where the target is wanted; Hold, with why, where it is not followed."""
        if now.q_s is not None and self.history.add(JointReading(q=now.q, t_s=now.q_s, sequence=0, source=self.name)):
            self._lag.add(now.t_s, now.q_s, now.q, now.q_sent)
        self._name(now.t_s)
        if not now.enabled:  # who gives the enable anew has looked where the target is
            self._before_jump = None
            self._reaction.forget()
            self._premise.forget()
        tracked, why = self._track.now, self._why_not(now.t_s)
        if why or tracked is None:
            self.error = None
            return Hold(why=why or NOT_SEEN)
        T_base_tool = now.T_base_tool.as_matrix()
        T_base_flange = T_base_tool @ self._T_tool_flange
        if not self.settings.predict and self._seen is not None:
            self._keep(self._seen.T_flange_target, self._seen.has_rotation)
            twist = self._twist(T_base_flange, self._seen.T_flange_target, self._seen.has_rotation)
            return self._held_back(twist, T_base_flange, T_base_tool[:3, 3])
        motion = tracked.at(now.t_s - self._cycle_s + self._lag.lag_s)  # when the arm is where it was last told to be
        T_flange_target = law.inverse(T_base_flange) @ motion.T_base_target
        self._keep(T_flange_target, motion.has_rotation)
        twist = self._twist(T_base_flange, T_flange_target, motion.has_rotation)
        return self._held_back(self._fed_forward(twist, motion, T_base_tool[:3, 3]), T_base_flange, T_base_tool[:3, 3])

    def warm_up(self) -> None:
        """Run once what a cycle runs, so that no cycle waits for the compiler."""
        other = ServoSource(self._arm, self._rig, self._target, self.settings, self._cycle_s)
        q = np.clip(np.zeros(self._arm.n), self._arm.lower, self._arm.upper)
        T_base_tool = RigidTransform.from_matrix(self._T_base_world @ self._arm.fk(self._arm.values(q)))
        T = RigidTransform.from_translation([0.0, 0.0, 0.5]).as_matrix()
        for k in range(20):
            t_s = 0.02 * k
            now = CycleState(t_s=t_s, cycle_s=0.02, q=q, q_sent=q, qd_sent=q, T_base_tool=T_base_tool, q_s=t_s)
            other.next(now)
            seen = TargetPose(
                t_s=t_s, status=PoseStatus.OK, parent="rig", T_parent_target=T, covariance=1e-8 * np.eye(6)
            )
            other.observe(seen, t_s, t_s)
            other.target(t_s)

    def _name(self, now_s: float) -> None:
        """Tell what is contradicted once the arm had time to stand."""
        wrong = self.wrong
        self._contradicted_s = np.inf if wrong is None else min(self._contradicted_s, now_s)
        named = wrong is not None and now_s - self._contradicted_s > NAMED_S
        self.contradiction = wrong.text if named and wrong is not None else ""

    def _why_not(self, now_s: float) -> str:
        if self._unplaced:
            return self._unplaced
        if self._reaction.missing:
            return f"the target stays in the picture as the camera moves: a picture that stands? {ANEW}"
        if self.wrong is not None:
            return self.contradiction or CONTRADICTED
        state, age_s = self.target(now_s)
        tracked = self._track.now
        if state is TargetState.JUMPED and tracked is not None and tracked.settled:
            way, turn = (float(np.linalg.norm(part)) for part in self._jump(tracked))
            return f"the target jumped by {way / MM:.0f} mm and {turn / DEG:.0f} deg, and stays so: {ANEW}"
        if state is not TargetState.FRESH:
            return NOT_SEEN if age_s is None else WHY[state]
        if tracked is None or not tracked.settled:
            return SETTLING
        n = law.delay_cycles(self.delay_s, self.servo_cycle_s)
        if max(self.settings.gain_t, self.settings.gain_r) >= law.stability_gain(self.servo_cycle_s, n):
            return f"the delay has grown to {self.delay_s / MS:.0f} ms, at which the gain is not stable"
        return ""

    def _jumped_away(self, tracked: Tracked) -> bool:
        """Tell whether the target stands elsewhere since a jump; one that came back is where it was."""
        if self._before_jump is None or not tracked.settled:
            return False
        way_m, turn = self._jump(tracked)
        near = float(np.linalg.norm(way_m)) <= self.settings.resume_m
        if near and (not tracked.has_rotation or float(np.linalg.norm(turn)) <= self.settings.resume_rad):
            self._before_jump = None
            return False
        return True

    def _jump(self, tracked: Tracked) -> tuple[Array, Array]:
        """Return the way (3,) in m and the rotation vector (3,) from where the target would have been but for the jump.

        It is told where the new track begins: how a motion goes on is known for a moment only, and not over a loss.
        """
        before = self._before_jump
        if before is None:
            return np.zeros(3), np.zeros(3)
        lost = tracked.begun_s - before.seen_s > LOST_S
        return pose_difference(tracked.T_begun, before.at(before.seen_s if lost else tracked.begun_s).T_base_target)

    def _keep(self, T_flange_target: Array, has_rotation: bool) -> None:
        if has_rotation and not self._turn_wanted:
            self._T_flange_desired[:3, :3] = T_flange_target[:3, :3]
            self._turn_wanted = True

    def _twist(self, T_base_flange: Array, T_flange_target: Array, has_rotation: bool) -> ToolTwist:
        settings = self.settings
        error = law.servo_error(T_flange_target, self._T_flange_desired)
        self.error = error
        gain_r = settings.gain_r if has_rotation and self._turns else 0.0
        v, omega = law.servo_twist(error, self._T_flange_desired[:3, 3], settings.gain_t, gain_r)
        R = T_base_flange[:3, :3]
        return ToolTwist(velocity_m_s=R @ (v + law.cross(omega, self._tool_m)), angular_rad_s=R @ omega)

    def _fed_forward(self, twist: ToolTwist, motion: TargetMotion, tool_m: Array) -> ToolTwist:
        """Return a twist with that of a tool fixed to the target added, which keeps up with it; tool_m: in base."""
        turning = motion.angular_rad_s if motion.has_rotation and self._turns else np.zeros(3)
        carried = motion.velocity_m_s + law.cross(turning, tool_m - motion.T_base_target[:3, 3])
        return ToolTwist(
            velocity_m_s=twist.velocity_m_s + carried,
            angular_rad_s=twist.angular_rad_s + turning,
        )

    def _held_back(self, twist: ToolTwist, T_base_flange: Array, tool_m: Array) -> ToolTwist:
        """Return a twist as slow as what is not tested yet has to be; tool_m (3,): in base."""
        if self.settings.mount is not law.Mount.EYE_IN_HAND:  # these cameras do not see what the arm does
            return twist
        camera_m = (T_base_flange @ self._T_parent_camera)[:3, 3]
        swung = twist.velocity_m_s + law.cross(twist.angular_rad_s, camera_m - tool_m)
        speeds = (twist.velocity_m_s, swung, LEVER_M * twist.angular_rad_s)
        fastest = max(float(np.linalg.norm(speed)) for speed in speeds)
        share = self.settings.first_m_s * max(1.0, self._premise.way_m / FIRST_M) / max(fastest, 1e-9)
        if share >= 1.0:
            return twist
        return ToolTwist(velocity_m_s=share * twist.velocity_m_s, angular_rad_s=share * twist.angular_rad_s)

    def _elsewhere(self, q: Array, T_base_flange: Array) -> Array:
        """Return where the rig is (n + 1, 4, 4) were each joint reversed, or the hand-eye calibration inverted."""
        opposite = np.tile(q, (len(q), 1)) + np.diag(2.0 * (self._q_begun - q))
        reversed_ = self._flange(opposite) @ self._T_parent_camera
        return np.concatenate([reversed_, (T_base_flange @ self._T_camera_parent)[None]])

    def _middle(self, names: tuple[str, ...]) -> Array | None:
        """Return the middle (3,) of lights in target axes; None where some were not told apart."""
        known = self._target.names
        if set(names) <= set(known):
            return np.asarray(self._target.xyz_m[[known.index(name) for name in names]].mean(axis=0))
        return np.asarray(self._target.xyz_m.mean(axis=0)) if len(names) == len(known) else None

    def _flange(self, q: Array) -> Array:
        return np.asarray(self._T_base_world @ self._arm.fk(self._arm.values(q)) @ self._T_tool_flange)
