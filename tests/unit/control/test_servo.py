"""The servo's set points: what it makes of poses in time, and why it holds."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.control.guard import TargetState
from armsight.control.servo import Mount, ServoSettings, ServoSource, Turning, on_axis
from armsight.control.servo.law import STANDS, ArmLag, Reaction
from armsight.control.servo.target_track import CALM_S, LOST_S, TargetTrack
from armsight.control.setpoints import CycleState, Hold, ToolTwist
from armsight.kinematics import presets
from armsight.optics import Camera, parallel_rig
from armsight.records import PoseStatus, TargetPose, spot_target

ARM = presets.ur10()
RIG = parallel_rig(Camera.pinhole(640, 480, 500.0, 500.0, 320.0, 240.0), 0.1)
TARGET = spot_target({"A": (-0.05, 0.0, 0.0), "B": (0.05, 0.04, 0.0), "C": (0.03, -0.04, 0.0)})
Q = np.array([0.0, -1.0, 1.5, -0.5, 1.5, 0.0])
CYCLE_S, FRAME_S, LATE_S = 0.01, 0.05, 0.04
COVARIANCE = np.diag(np.square([1e-5, 1e-5, 1e-4, 1e-3, 1e-3, 1e-4]))
T_FLANGE_CAMERA = RigidTransform.from_components([0.05, 0.0, 0.06], Rotation.from_rotvec([0.0, 0.1, 0.4]))
T_BASE_CAMERA = RigidTransform.from_components([-0.5, 0.3, 0.8], Rotation.from_rotvec([0.0, -1.5, 0.0]))
V = np.array([0.06, -0.03, 0.02])


def settings(mount: Mount = Mount.EYE_IN_HAND, **more) -> ServoSettings:
    inside = mount is Mount.EYE_IN_HAND
    known = {
        "mount": mount,
        "T_parent_camera": T_FLANGE_CAMERA if inside else T_BASE_CAMERA,
        "T_flange_desired": on_axis(T_FLANGE_CAMERA if inside else ARM.T_flange_tool, 0.5),
        "gain_t": 2.0,
        "gain_r": 2.0,
        "first_m_s": math.inf,  # the arm here stands, and would be slow for ever
    }
    return ServoSettings(**{**known, **more})


class Bench:
    """An arm at rest, of which the servo knows readings, and a target that moves before its cameras."""

    def __init__(self, source: ServoSource) -> None:
        self.source = source
        self.T_base_flange = RigidTransform.from_matrix(ARM.fk(Q))
        self.start = self.T_base_flange * source.settings.T_flange_desired
        self.t_s = 0.0
        self.frame = 1
        self.wanted: object = None
        self.enabled = True

    def target_at(self, t_s: float) -> RigidTransform:
        return RigidTransform.from_translation(V * t_s) * self.start

    def seen(self, t_s: float) -> TargetPose:
        source = self.source.settings
        inside = source.mount is Mount.EYE_IN_HAND
        T_base_camera = self.T_base_flange * source.T_parent_camera if inside else source.T_parent_camera
        T = (T_base_camera.inv() * self.target_at(t_s)).as_matrix()
        return TargetPose(
            t_s=t_s, status=PoseStatus.OK, parent="rig", spots=("A", "B", "C"), T_parent_target=T, covariance=COVARIANCE
        )

    def run(self, until_s: float, pose=None) -> object:
        """Let cycles and frames go on; pose: makes another pose of the one that is right, None for no frame."""
        while self.t_s < until_s - 1e-9:
            self.t_s += CYCLE_S
            while self.frame * FRAME_S + LATE_S <= self.t_s + 1e-9:
                at_s = self.frame * FRAME_S
                self.frame += 1
                shown = self.seen(at_s) if pose is None else pose(self.seen(at_s))
                if shown is not None:
                    self.source.observe(shown, at_s, self.t_s)
            now = CycleState(
                t_s=self.t_s,
                cycle_s=CYCLE_S,
                q=Q,
                q_sent=Q,
                qd_sent=np.zeros(6),
                T_base_tool=self.T_base_flange,
                q_s=self.t_s,
                enabled=self.enabled,
            )
            self.wanted = self.source.next(now)
        return self.wanted


def bench(**more) -> Bench:
    return Bench(ServoSource(ARM, RIG, TARGET, settings(**more), CYCLE_S))


@pytest.mark.parametrize("mount", list(Mount))
def test_a_moving_target_is_met_where_it_will_be_with_its_velocity_fed_forward(mount):
    setup = bench(mount=mount, arm_lag_s=0.1)
    twist = setup.run(2.0)
    assert isinstance(twist, ToolTwist)
    ahead_m = V * (
        2.0 + 0.1 - CYCLE_S
    )  # the arm stands: since the beginning the target went on, and goes on for the lag
    assert twist.velocity_m_s == pytest.approx(V + 2.0 * ahead_m, abs=2e-3)
    assert twist.angular_rad_s == pytest.approx(np.zeros(3), abs=5e-3)
    assert setup.source.target(setup.t_s) == (TargetState.FRESH, pytest.approx(0.05, abs=0.051))
    assert setup.source.camera_delay_s == pytest.approx(LATE_S)


@pytest.mark.parametrize(("mount", "most_m_s"), [(Mount.EYE_IN_HAND, 0.04), (Mount.EYE_TO_HAND, math.inf)])
def test_a_camera_on_the_flange_goes_its_first_centimetre_slowly(mount, most_m_s):
    twist = bench(mount=mount, first_m_s=0.04).run(2.0)
    assert isinstance(twist, ToolTwist)
    assert np.linalg.norm(twist.velocity_m_s) == pytest.approx(min(most_m_s, np.linalg.norm(V + 4.0 * V)), rel=0.1)


def test_the_tool_and_not_the_flange_is_told_to_move():
    tool = replace(ARM, T_flange_tool=RigidTransform.from_translation([0.0, 0.0, 0.2]))
    plain, tooled = (ServoSource(arm, RIG, TARGET, settings(), CYCLE_S) for arm in (ARM, tool))
    turned = RigidTransform.from_rotation(Rotation.from_rotvec([0.0, 0.1, 0.0]))
    T_base_flange = ARM.fk(Q)
    seen = (turned * settings().T_flange_desired).as_matrix()
    by_flange = plain._twist(T_base_flange, seen, True)
    by_tool = tooled._twist(T_base_flange, seen, True)
    arm_m = T_base_flange[:3, :3] @ [0.0, 0.0, 0.2]
    assert by_tool.angular_rad_s == pytest.approx(by_flange.angular_rad_s)
    expected = by_flange.velocity_m_s + np.cross(by_flange.angular_rad_s, arm_m)
    assert by_tool.velocity_m_s == pytest.approx(expected)


@pytest.mark.parametrize("predict", [True, False])
def test_the_rotation_first_seen_is_kept_and_none_is_held(predict):
    away = RigidTransform.from_rotation(Rotation.from_rotvec([2.5, 0.3, 0.0]))

    def turned(pose: TargetPose) -> TargetPose:
        return replace(pose, T_parent_target=pose.T_parent_target @ away.as_matrix())

    for turning, keeps_still in ((Turning.KEEP, True), (Turning.HOLD, True), (Turning.ALIGN, False)):
        twist = bench(turning=turning, predict=predict).run(2.0, turned)
        assert isinstance(twist, ToolTwist)
        assert (np.linalg.norm(twist.angular_rad_s) < 0.02) == keeps_still, turning


def place_only(names: tuple[str, ...]):
    """Return what makes a pose one of which only the middle of these lights is known."""

    def change(pose: TargetPose) -> TargetPose:
        T = np.array(pose.T_parent_target)
        centre = np.mean([TARGET.xyz_m[TARGET.names.index(name)] for name in names], axis=0)
        middle = np.eye(4)
        middle[:3, 3] = T[:3, :3] @ centre + T[:3, 3]
        return TargetPose(
            t_s=pose.t_s,
            status=PoseStatus.POSITION_ONLY,
            parent="rig",
            spots=names,
            T_parent_target=middle,
            covariance=COVARIANCE[:3, :3],
        )

    return change


def test_with_two_lights_the_place_is_followed_and_the_rotation_held():
    setup = bench()
    whole = setup.run(1.0)
    twist = setup.run(1.6, place_only(("A", "B")))
    assert isinstance(whole, ToolTwist)
    assert isinstance(twist, ToolTwist)
    assert not twist.angular_rad_s.any()
    assert twist.velocity_m_s == pytest.approx(V + 2.0 * V * (1.6 - CYCLE_S), abs=3e-3)
    assert setup.source.target(setup.t_s)[0] is TargetState.FRESH, "the middle of two lights is no jump"


def unnamed(names: tuple[str, ...]):
    """Return what makes a pose one of these lights of which nobody knows which is which."""
    change = place_only(names)
    return lambda pose: replace(change(pose), spots=("?",) * len(names))


def test_lights_that_were_not_told_apart_are_followed_only_where_they_are_all():
    setup = bench()
    setup.run(1.0)
    seen = setup.source.tracked
    setup.run(1.1, unnamed(("A", "B")))
    assert setup.source.tracked is seen
    twist = setup.run(1.7, unnamed(("A", "B", "C")))
    assert isinstance(twist, ToolTwist)
    assert not twist.angular_rad_s.any()
    assert twist.velocity_m_s == pytest.approx(V + 2.0 * V * (1.7 - CYCLE_S), abs=3e-3)


def why(wanted: object) -> str:
    assert isinstance(wanted, Hold)
    return wanted.why


def test_nothing_seen_stale_and_lost_are_holds_that_say_so():
    setup = bench()
    assert "not seen yet" in why(setup.run(0.2, lambda pose: None))
    assert "only just now" in why(setup.run(0.35))
    assert isinstance(setup.run(1.0), ToolTwist)
    assert "too old" in why(setup.run(1.2, lambda pose: None))
    assert setup.source.target(setup.t_s)[0] is TargetState.STALE
    assert "lost" in why(setup.run(1.0 + LOST_S + 0.2, lambda pose: None))
    assert setup.source.target(setup.t_s)[0] is TargetState.LOST
    assert setup.source.error is None
    assert isinstance(setup.run(2.5), ToolTwist)


def test_a_doubtful_pose_is_not_followed():
    setup = bench()
    assert "not seen yet" in why(setup.run(0.6, lambda pose: replace(pose, status=PoseStatus.DOUBTFUL)))
    assert isinstance(setup.run(1.5), ToolTwist)
    assert "too old" in why(setup.run(1.7, lambda pose: replace(pose, status=PoseStatus.DOUBTFUL)))


def moved(by_m: float):
    def change(pose: TargetPose) -> TargetPose:
        T = np.array(pose.T_parent_target)
        T[0, 3] += by_m
        return replace(pose, T_parent_target=T)

    return change


def turned_over(pose: TargetPose) -> TargetPose:
    """The other pose that a flat target may be seen at."""
    return replace(pose, T_parent_target=pose.T_parent_target @ np.diag([1.0, -1.0, -1.0, 1.0]))


@pytest.mark.parametrize("lie", [moved(0.2), turned_over], ids=["moved", "turned over"])
def test_after_a_jump_elsewhere_only_a_fresh_enable_goes_on(lie):
    setup = bench()
    assert isinstance(setup.run(1.0), ToolTwist)
    assert "jumped" in why(setup.run(1.1, lie))
    assert setup.source.target(setup.t_s)[0] is TargetState.JUMPED
    assert "enable" in why(setup.run(1.1 + 4 * CALM_S, lie))
    setup.enabled = False
    setup.run(setup.t_s + CYCLE_S, lie)
    setup.enabled = True
    assert isinstance(setup.run(setup.t_s + 0.1, lie), ToolTwist)


def test_after_a_jump_and_back_it_goes_on_by_itself():
    setup = bench()
    setup.run(1.0)
    assert "jumped" in why(setup.run(1.3, moved(0.2)))
    assert isinstance(setup.run(1.4 + 2 * CALM_S), ToolTwist)


def test_a_target_behind_the_camera_is_not_seen():
    def behind(pose: TargetPose) -> TargetPose:
        return replace(pose, T_parent_target=np.diag([1.0, 1.0, -1.0, 1.0]) @ pose.T_parent_target)

    setup = bench()
    setup.run(1.0)
    assert "too old" in why(setup.run(1.3, behind))


SIGMA = np.sqrt(np.diag(COVARIANCE))


PLACE_ONLY = np.array([*SIGMA[:3], np.inf, np.inf, np.inf])


def seen_by_a_moving_camera(
    reaction: Reaction, share: float, noise: float, n: int = 60, sigma: np.ndarray = SIGMA
) -> list[bool]:
    """Let a camera go 1 mm a frame; share: of its way by which the target moves before it, beside noise in sigmas."""
    rng, missing = np.random.default_rng(1), []
    for k in range(n):
        rig, seen = np.eye(4), np.eye(4)
        off = noise * SIGMA * rng.normal(size=6)
        rig[0, 3] = 1e-3 * k
        seen[:3, :3] = Rotation.from_rotvec(off[3:]).as_matrix()
        seen[:3, 3] = off[:3] + np.array([-share * rig[0, 3], 0.0, 0.5])
        reaction.see(rig, seen, sigma)
        missing.append(reaction.missing)
    return missing


@pytest.mark.parametrize("sigma", [SIGMA, PLACE_ONLY], ids=["pose", "place only"])
def test_a_pose_that_only_scatters_by_its_noise_as_the_camera_goes_10_mm_is_not_followed(sigma):
    reaction = Reaction(0.01)
    missing = seen_by_a_moving_camera(reaction, 0.0, 1.0, sigma=sigma)
    assert 9 <= missing.index(True) <= 12
    reaction.forget()
    assert not reaction.missing
    assert not any(seen_by_a_moving_camera(Reaction(0.01), 1.0, 1.0)), "a target at rest"
    assert not any(seen_by_a_moving_camera(Reaction(0.01), 0.05, 1.0)), "a target that is followed well"


def test_one_picture_may_be_sent_twice_and_not_four_times():
    missing = seen_by_a_moving_camera(Reaction(0.01), 0.0, 0.0)
    assert missing.index(True) == STANDS
    reaction = Reaction(0.01)
    seen_by_a_moving_camera(reaction, 0.0, 0.0, STANDS)
    assert not seen_by_a_moving_camera(reaction, 0.05, 1.0, 1)[0]


def test_a_motion_that_no_hand_makes_is_a_jump_where_a_knock_could_have_made_it():
    track = TargetTrack(RIG)
    rested, knocked = np.eye(4), np.eye(4)
    knocked[0, 3] = 0.06
    for k in range(20):
        track.add(0.07 * k, rested, COVARIANCE)
    track.add(1.4, knocked, COVARIANCE)
    assert track.now is not None
    assert track.now.jumped


def test_a_delay_that_grows_beyond_what_the_gain_is_stable_at_is_a_hold():
    setup = bench(gain_t=9.0, gain_r=2.0)
    assert isinstance(setup.run(1.0), ToolTwist)
    setup.source._lag.lag_s = 0.4
    assert "delay" in why(setup.run(1.1))


def test_a_frame_from_before_the_readings_is_not_placed():
    source = bench().source
    pose = bench().seen(0.0)
    source.observe(pose, 0.0, 0.01)
    assert source.tracked is None
    now = CycleState(
        t_s=0.02,
        cycle_s=CYCLE_S,
        q=Q,
        q_sent=Q,
        qd_sent=np.zeros(6),
        T_base_tool=RigidTransform.from_matrix(ARM.fk(Q)),
        q_s=0.02,
    )
    assert "joint readings" in why(source.next(now))


def test_an_older_pose_is_left_out_and_one_after_a_long_while_begins_anew():
    track = TargetTrack(RIG)
    for k in range(10):
        track.add(0.1 * k, np.eye(4), COVARIANCE)
    before = track.now
    track.add(0.5, np.eye(4), COVARIANCE)
    assert track.now is before
    away = np.eye(4)
    away[0, 3] = 0.5
    track.add(0.9 + LOST_S + 0.1, away, COVARIANCE)
    assert track.now is not None
    assert not track.now.jumped
    assert not track.now.settled


def test_the_arms_lag_is_found_from_readings_of_an_arm_that_drags_behind():
    cycle_s, tau_s = 0.008, 0.06
    lag = ArmLag(0.016, cycle_s)
    for k in range(600):
        now_s = cycle_s * k
        told = np.array([0.3 * np.sin(1.5 * (now_s - cycle_s)), 0.1])
        is_at = np.array([0.3 * np.sin(1.5 * (now_s - tau_s)), 0.1])
        lag.add(now_s, now_s, is_at, told)
        lag.estimate(now_s)
    assert lag.lag_s == pytest.approx(tau_s, abs=1e-3)
