"""A path planned and run: where the tip goes, how it waits and comes back, and what is refused before any motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.control.guard import Limits
from armsight.control.play import CameraPlacement, PathSource, PlaySettings, PlayWatch, Weave, plan_path
from armsight.control.servo import Mount
from armsight.control.setpoints import CycleState, Finished, Hold, ToolPose
from armsight.errors import Inconsistent, NotEnoughData, UsageError
from armsight.kinematics import presets
from armsight.records import PoseStatus, TargetPose, TaughtPath
from refusals import refuses

ARM = replace(presets.ur10(), T_flange_tool=RigidTransform.from_translation([0.0, 0.0, 0.15]))
Q = np.array([0.0, -1.0, 1.5, -0.5, 1.5, 0.0])
STAND = ARM.T_world_base.inv() * RigidTransform.from_matrix(ARM.fk(ARM.values(Q)))
CYCLE_S = 0.008
FAST = PlaySettings(speed_m_s=0.05, approach_speed_m_s=0.1, retract_m=0.01)


def through(xyz, *, stand: RigidTransform = STAND, tags=None, turn=None, **more) -> TaughtPath:
    """Return a path through places in the axes of the tool as it stands."""
    turns = Rotation.identity() if turn is None else turn
    rows = [(stand * RigidTransform.from_components(place, turns)).as_matrix() for place in np.asarray(xyz, float)]
    path = TaughtPath.of_poses(RigidTransform.from_matrix(np.array(rows)), parent="base", **more)
    return path if tags is None else replace(path, tags=tags)


LINE = through([[0.0, 0.0, 0.01], [0.03, 0.0, 0.01]])


class Follower:
    """An arm that is where it was told to be, and can be kept from following."""

    def __init__(self, source: PathSource) -> None:
        self.source = source
        self.t_s, self.T, self.running, self.refused = 0.0, STAND, True, True
        self.still = np.zeros(6)

    def cycle(self):
        now = CycleState(
            t_s=self.t_s,
            cycle_s=CYCLE_S,
            q=Q,
            q_sent=Q,
            qd_sent=self.still,
            T_base_tool=self.T,
            running=self.running,
            refused=self.refused and not self.running,
        )
        wanted = self.source.next(now)
        self.t_s += CYCLE_S
        if isinstance(wanted, ToolPose) and self.running:
            self.T = wanted.T_base_tool
        return wanted

    def until(self, done, most: int = 4000):
        tips = []
        for _ in range(most):
            wanted = self.cycle()
            tips.append(self.T.translation)
            if done(wanted):
                return np.array(tips)
        raise AssertionError("it did not come to that")


def planned(path: TaughtPath = LINE, settings: PlaySettings = FAST, **more) -> PathSource:
    return PathSource(plan_path(path, ARM, Limits(), Q, settings), **more)


def test_weaves() -> None:
    s = np.linspace(0.0, 0.02, 2001)
    sine, zigzag = (Weave.parse(f"{kind}:0.002:0.01").offset_m(s) for kind in ("sine", "zigzag"))
    assert np.allclose(sine, 0.002 * np.sin(2.0 * np.pi * s / 0.01))
    assert zigzag.max() == pytest.approx(0.002) and zigzag.min() == pytest.approx(-0.002)
    assert np.abs(np.diff(zigzag) / np.diff(s)).max() < 1.3 * 4.0 * 0.002 / 0.01
    assert np.abs(zigzag[[0, 500, 1000]]).max() < 1e-12
    assert not Weave.parse("none").offset_m(s).any()


def test_the_tip_goes_to_the_start_along_the_tools_axis_then_along_the_path_and_ends() -> None:
    source = planned(through([[0.02, 0.0, 0.03], [0.05, 0.0, 0.03]]))
    follower = Follower(source)
    tips = STAND.inv().apply(follower.until(lambda wanted: isinstance(wanted, Finished)))
    before = tips[np.argmin(np.linalg.norm(tips - [0.02, 0.0, 0.02], axis=1))]
    assert np.allclose(before, [0.02, 0.0, 0.02], atol=1e-6)  # retract_m before the start
    along = tips[tips[:, 0] > 0.02 + 1e-9]
    assert np.abs(along[:, 1:] - [0.0, 0.03]).max() < 1e-9
    assert np.allclose(tips[-1], [0.05, 0.0, 0.03], atol=1e-6)
    speed = np.linalg.norm(np.diff(along, axis=0), axis=1) / CYCLE_S
    assert speed.max() == pytest.approx(0.05, rel=1e-3)
    assert np.abs(np.diff(speed)).max() / CYCLE_S < 0.7 * Limits().acceleration_m_s2 + 1e-6
    assert source.progress.stage == "finished" and source.progress.share == 1.0


def test_a_pause_rests_on_the_path_with_the_weld_off_and_an_override_slows_it() -> None:
    source = planned(replace(LINE, tags=("weld_on", "")), override=0.5)
    follower = Follower(source)
    follower.until(lambda _: source.progress.s_m > 0.01)
    assert source.progress.speed_m_s == pytest.approx(0.025, rel=1e-3) and source.progress.welding
    source.pause()
    follower.until(lambda _: source.progress.speed_m_s == 0.0)
    rests_at = source.progress.s_m
    assert 0.01 < rests_at < 0.02 and source.progress.paused and not source.progress.welding
    for _ in range(20):
        follower.cycle()
    assert source.progress.s_m == rests_at
    source.resume()
    source.override = 1.0
    follower.until(lambda wanted: isinstance(wanted, Finished))
    for wrong in (0.0, 1.5, float("nan")):
        with pytest.raises(UsageError):
            source.override = wrong


def test_after_a_hold_the_tip_comes_back_to_the_path_before_it_goes_on() -> None:
    source = planned()
    follower = Follower(source)
    follower.until(lambda _: source.progress.s_m > 0.01)
    follower.running, left_at = False, source.progress.s_m
    assert isinstance(follower.cycle(), Hold) and source.progress.waiting
    follower.T = follower.T * RigidTransform.from_translation([0.004, 0.001, 0.0])  # brought to rest off the path
    follower.running, follower.still = True, np.full(6, 0.1)
    assert isinstance(follower.cycle(), Hold)  # it still moves
    follower.still = np.zeros(6)
    tips = STAND.inv().apply(follower.until(lambda wanted: isinstance(wanted, Finished)))
    back = np.argmin(np.linalg.norm(tips - [left_at, 0.0, 0.01], axis=1))
    assert np.allclose(tips[back], [left_at, 0.0, 0.01], atol=1e-6)
    speed = np.linalg.norm(np.diff(tips[: back + 1], axis=0), axis=1) / CYCLE_S
    assert speed.max() < 0.0101
    assert np.abs(tips[back:, 1]).max() < 1e-6


def test_an_arm_far_from_the_path_is_not_brought_back() -> None:
    source = planned()
    follower = Follower(source)
    follower.until(lambda _: source.progress.s_m > 0.01)
    follower.running = False
    follower.cycle()
    follower.running, follower.T = True, follower.T * RigidTransform.from_translation([0.0, 0.0, -0.05])
    wanted = follower.cycle()
    assert isinstance(wanted, Hold) and "50 mm" in wanted.why


def test_a_place_that_the_guard_refuses_again_and_again_is_given_up_until_it_is_resumed() -> None:
    source = planned()
    follower = Follower(source)
    follower.until(lambda _: source.progress.s_m > 0.01)

    def refused(cycles: int) -> list[str]:
        whys = []
        for _ in range(cycles):  # each set point is refused in the cycle after it, and so is a hold with a reason
            wanted = follower.cycle()
            follower.running = isinstance(wanted, Hold) and not wanted.why
            whys.append(wanted.why if isinstance(wanted, Hold) else "moves")
        return whys

    assert "again and again" in refused(40)[-1]
    assert set(refused(300)) == {"the guard refused the path here again and again"}
    source.resume()
    follower.running = True
    follower.until(lambda wanted: isinstance(wanted, Finished))


@pytest.mark.parametrize(
    ("path", "why"),
    [
        (through([[0.0, 0.0, 0.0], [0.0, 0.0, 3.0]]), "run it"),
        (through([[0.0, 0.0, 0.0], [0.02, 0.0, 0.0]], turn=Rotation.from_rotvec([0.0, 3.0, 0.0])), "run"),
    ],
)
def test_what_cannot_be_run_is_refused_before_any_motion(path: TaughtPath, why: str) -> None:
    with refuses(Inconsistent, why) as refused:
        plan_path(path, ARM, Limits(), Q, FAST)
    assert "Nothing is moved" in str(refused.value)


def test_a_turn_over_is_refused_and_one_place_is_no_path() -> None:
    T = LINE.T_world_tip.copy()
    T[1] = (
        RigidTransform.from_matrix(T[1]) * RigidTransform.from_rotation(Rotation.from_rotvec([2.0, 0, 0]))
    ).as_matrix()
    with refuses(Inconsistent, "115 deg", "row 1"):
        plan_path(replace(LINE, T_world_tip=T), ARM, Limits(), Q, FAST)
    kept = plan_path(replace(LINE, T_world_tip=T), ARM, Limits(), Q, replace(FAST, keep_rotation=True))
    assert (kept.track.pose(kept.track.duration_s).rotation * STAND.rotation.inv()).magnitude() < 1e-9
    with pytest.raises(NotEnoughData):
        plan_path(through([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]), ARM, Limits(), Q, FAST)
    along = through([[0.0, 0.0, 0.0], [0.0, 0.0, 0.02]])
    with refuses(Inconsistent, "tool's own"):
        plan_path(along, ARM, Limits(), Q, replace(FAST, weave=Weave.parse("sine:0.001:0.01")))


def test_the_weave_is_between_weld_on_and_weld_off() -> None:
    tags = ("", "weld_on", "weld_off", "")
    path = through([[0.0, 0.0, 0.0], [0.02, 0.0, 0.0], [0.06, 0.0, 0.0], [0.08, 0.0, 0.0]], tags=tags)
    plan = plan_path(path, ARM, Limits(), Q, replace(FAST, weave=Weave.parse("sine:0.002:0.008")))
    across = STAND.inv().apply(plan.tip_m)[:, 1]
    s = plan.s_m
    assert np.abs(across[(s < 0.012) | (s > 0.068)]).max() < 1e-9
    assert np.abs(across[(s > 0.03) & (s < 0.05)]).max() == pytest.approx(0.002, rel=1e-2)
    source = PathSource(plan)
    follower = Follower(source)
    follower.until(lambda _: source.progress.s_m > 0.03)
    assert source.progress.welding
    follower.until(lambda _: source.progress.s_m > 0.065)
    assert not source.progress.welding


def swung(mount: Mount, wrong: RigidTransform, late_s: float = 0.0) -> tuple[PlayWatch, float]:
    """Return a watch of an arm that moves, whose cameras are `wrong` from where they are believed, and its way in m."""
    camera = RigidTransform.from_components([0.2, 0.1, 0.3], Rotation.from_rotvec([0.2, 0.4, 0.1]))
    carried = mount is Mount.EYE_IN_HAND
    flange = RigidTransform.from_matrix(ARM.fk(Q)) * ARM.T_flange_tool.inv()
    believed = RigidTransform.from_translation([0.0, 0.0, 0.1]) if carried else camera
    there = RigidTransform.from_components([0.02, 0.05, 0.5], Rotation.from_rotvec([0.0, 0.2, 0.3]))
    target = flange * believed * there if carried else flange.inv() * believed * there
    sight = CameraPlacement(mount=mount, T_parent_camera=believed, T_parent_target=target)
    watch, rng = PlayWatch(sight, ARM, stop_m=None, arm_lag_s=0.03, cycle_s=0.01), np.random.default_rng(3)

    def joints(t_s: float) -> np.ndarray:
        return Q + 0.02 * np.sin(max(t_s - 0.3, 0.0) * np.array([1.0, 1.5, 2.0, 2.5, 1.2, 1.8]))

    def flange_at(t_s: float) -> RigidTransform:
        return RigidTransform.from_matrix(ARM.fk(joints(t_s))) * ARM.T_flange_tool.inv()

    noise = np.array([2e-5, 2e-5, 1.5e-4])
    for k in range(200):
        t_s = 0.01 * k
        tip = RigidTransform.from_matrix(ARM.fk(joints(t_s)))
        watch.cycle(
            CycleState(t_s=t_s, cycle_s=0.01, q=joints(t_s), q_sent=Q, qd_sent=np.zeros(6), T_base_tool=tip, q_s=t_s)
        )
        if k < 10 or k % 3:
            continue
        T = flange_at(t_s - 0.02 - late_s)
        start = flange * believed * wrong * there if carried else flange.inv() * believed * wrong * there
        seen = ((T if carried else T.inv()) * believed * wrong).inv() * start
        shown = RigidTransform.from_translation(noise * rng.normal(size=3)) * seen
        watch.observe(
            TargetPose(
                t_s=t_s,
                status=PoseStatus.OK,
                parent="rig",
                T_parent_target=shown.as_matrix(),
                covariance=np.diag([*noise**2, 1e-6, 1e-6, 1e-6]),
            ),
            t_s - 0.02,
            t_s,
        )
        if watch.exceeded:
            break
    return watch, float(np.linalg.norm((flange_at(t_s) * believed).translation - (flange * believed).translation))


@pytest.mark.parametrize("mount", list(Mount))
@pytest.mark.parametrize(
    ("axis", "deg", "late_s", "cause", "word"),
    [
        ("z", 180.0, 0.0, "hand-eye", "180 deg about their z"),
        ("x", 20.0, 0.0, "hand-eye", "deg about their"),
        ("x", 0.0, 0.5, "pictures", ""),
        ("x", 0.5, 0.03, None, ""),  # as good as hand-eye calibrations and --latency are
    ],
)
def test_the_watch_names_what_the_targets_motion_contradicts(mount, axis, deg, late_s, cause, word) -> None:
    watch, way_m = swung(mount, RigidTransform.from_rotation(Rotation.from_euler(axis, deg, degrees=True)), late_s)
    assert (None if watch.wrong is None else watch.wrong.cause.value) == cause, watch.exceeded
    assert bool(watch.exceeded) == (cause is not None) and word in watch.exceeded
    assert way_m < 0.014 or cause is None


@pytest.mark.parametrize("mount", list(Mount))
def test_the_watch_compares_the_tip_with_where_it_was_told_to_be_at_the_exposure(mount: Mount) -> None:
    camera = RigidTransform.from_components([0.2, 0.1, 0.3], Rotation.from_rotvec([0.2, 0.4, 0.1]))
    target = RigidTransform.from_components([0.0, 0.05, 0.6], Rotation.from_rotvec([0.0, 0.2, 0.3]))
    tip = RigidTransform.from_translation([0.0, 0.0, 0.15])
    sight = CameraPlacement(mount=mount, T_parent_camera=camera, T_parent_target=target)
    watch = PlayWatch(sight, replace(ARM, T_flange_tool=tip), stop_m=0.002, arm_lag_s=0.03, cycle_s=0.01)
    start = RigidTransform.from_components([0.5, 0.0, 0.4], Rotation.from_rotvec([3.0, 0.1, 0.0]))
    velocity = np.array([0.05, 0.0, 0.0])

    def flange(t_s: float) -> RigidTransform:
        return RigidTransform.from_translation(velocity * t_s) * start

    def shown(t_s: float, off=(0.0, 0.0, 0.0)) -> TargetPose:
        T = RigidTransform.from_translation(off) * flange(t_s)
        inside = mount is Mount.EYE_IN_HAND
        T_rig = (T * camera).inv() * target if inside else camera.inv() * T * target
        return TargetPose(
            t_s=t_s, status=PoseStatus.OK, parent="rig", T_parent_target=T_rig.as_matrix(), covariance=np.eye(6)
        )

    for k in range(40):
        now = CycleState(
            t_s=0.01 * (k + 1),
            cycle_s=0.01,
            q=Q,
            q_sent=Q,
            qd_sent=np.zeros(6),
            T_base_tool=flange(0.01 * k) * tip,
            q_s=0.01 * (k + 1),
        )
        watch.cycle(now)
    shifted = shown(0.17)  # told 30 ms before the exposure
    watch.observe(shifted, 0.2, 0.25)
    assert watch.figures.max_m == pytest.approx(0.0, abs=1e-12) and watch.figures.n == 1
    watch.observe(shown(0.27, off=[0.003, 0.0, 0.0]), 0.3, 0.35)
    assert watch.figures.last_m == pytest.approx(0.003) and not watch.exceeded  # one frame alone may be wrong
    watch.observe(shown(0.28, off=[0.003, 0.0, 0.0]), 0.31, 0.36)
    assert "3.0 mm" in watch.exceeded
    assert watch.figures.rms_m == pytest.approx(0.003 * np.sqrt(2.0 / 3.0))
    watch.observe(TargetPose(t_s=0.32, status=PoseStatus.LOST, parent="rig"), 0.32, 0.37)
    assert watch.figures.n == 3 and watch.tip is None
