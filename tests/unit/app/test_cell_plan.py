"""A motion that calibrates a cell: planned within the limits and in view, run through the guard, or refused."""

from __future__ import annotations

from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from armsight.clock import ManualClock
from armsight.control.guard import Box, JointLimit, Limits
from armsight.control.play.path_source import JointMotionSource
from armsight.errors import ArmsightError, Cancelled, Inconsistent, NotEnoughData, UsageError
from armsight.kinematics import Arm
from armsight.ops import robots
from armsight.ops.arm_files import load_arm
from armsight.ops.robot.opening import ClockedRobot, open_robot
from armsight.ops.robot.run_motion import RunMotionOutput
from armsight.ops.simulation.run import simulate
from armsight.records import Motion
from armsight.store import read_target
from armsight.store.limits_file import write_limits
from armsight.store.tracks import read_joints, write_joints
from armsight_lab.cell_plan import plan as plan_module
from armsight_lab.cell_plan import run as run_module
from armsight_lab.cell_plan.cautious import CAUTIOUS_RAD, cautious_motion
from armsight_lab.cell_plan.information import known_before, motion_information
from armsight_lab.cell_plan.plan import CellPlan, PlanSettings, plan_motion
from armsight_lab.cell_plan.request import CellPlanJob
from armsight_lab.cell_plan.run import free_of, links_of, motion_bounds, run_cell_plan, scene_of
from armsight_lab.cell_plan.scene import Scene, places, roadmap
from armsight_lab.cell_plan.tour import longest
from refusals import refuses
from robot_runs import acted

START = "-0.0078,-1.0686,1.6257,-0.5679,1.7323,0.1617"
Q = np.array([float(value) for value in START.split(",")])
VOLUME = ((-0.95, -0.75), (-0.3, 0.05), (0.1, 0.4))
ROOM = Limits(workspace=Box(lower_m=[-1.4, -1.2, -0.1], upper_m=[-0.4, 1.0, 1.0], name="cell"))
QUICK = PlanSettings(duration_s=30.0, rate_hz=50.0, trials=3)


@pytest.fixture(autouse=True)
def few_trials(monkeypatch: pytest.MonkeyPatch) -> None:
    """Three exchanges of places for thirty: docs/guide/cell-plan.md plans in full."""
    monkeypatch.setattr(run_module, "PlanSettings", partial(PlanSettings, trials=3))


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("cell") / "webcam"
    simulate("webcam-cell", out, frames=3, room="dark")
    return out


def job(cell: Path, folder: Path, **more: object) -> CellPlanJob:
    known: dict[str, object] = {
        "model": str(cell / "arm.yaml"),
        "rig": cell / "rig.yaml",
        "world": cell / "world.yaml",
        "target": cell / "target.yaml",
        "volume": VOLUME,
        "start": START,
        "duration_s": 30.0,
        "facing_rad": 1.05,
        "rate_hz": 50.0,
    }
    return CellPlanJob(**({"out": folder / "motion.csv"} | known | more))


def scene(cell: Path, limits: Limits = ROOM, **more: object) -> Scene:
    wanted = job(cell, cell, **more)
    arm = load_arm(wanted.model)
    target = read_target(cell / "target.yaml")
    made = scene_of(wanted, arm, motion_bounds(arm, limits), limits, target, arm.T_flange_tool)
    assert made.seen(Q[None])[0]
    return made


@cache
def quick(cell: Path) -> CellPlan:
    """Return the motion where nothing stands in the way."""
    tool = load_arm(str(cell / "arm.yaml")).T_flange_tool
    return plan_motion(scene(cell), read_target(cell / "target.yaml"), tool, QUICK, start=Q)


def tool_and_flange(arm: Arm, q: NDArray[np.float64]) -> NDArray[np.float64]:
    T = arm.fk(arm.values(q))
    flange = T @ arm.T_flange_tool.inv().as_matrix()
    return np.concatenate([T[:, :3, 3], flange[:, :3, 3]])


def moved(motion: Path, out: Path, *, confirm=lambda _: True, **more: object) -> RunMotionOutput:
    clock = ManualClock()
    robot = ClockedRobot(robot=open_robot("sim:webcam-cell", clock), clock=clock, called="sim:webcam-cell")
    return acted(robots.run_motion, robot=robot, motion=motion, out=out, confirm=confirm, **more)


def test_a_motion_keeps_the_limits_in_view_and_a_robot_runs_it_through_the_guard(cell: Path, tmp_path: Path) -> None:
    write_limits(tmp_path / "limits.yaml", ROOM)
    done = run_cell_plan(job(cell, tmp_path, limits=tmp_path / "limits.yaml"))
    motion = read_joints(tmp_path / "motion.csv")
    arm, made = load_arm(str(cell / "arm.yaml")), scene(cell)
    bounds = made.bounds
    dt = motion.t_s[1]
    assert done.kind == "planned" and (done.n_rows, motion.t_s[-1]) == (1501, 30.0)
    assert made.seen(motion.q[::10]).mean() == pytest.approx(done.seen, abs=0.05) and done.seen > 0.8
    assert np.allclose(motion.q[[0, -1]], Q)
    assert bounds.within(motion.q).all() and np.abs(motion.q - Q).max() <= np.pi / 2.0
    speed = np.diff(motion.q, axis=0) / dt
    assert (np.abs(speed) <= bounds.speed).all() and np.abs(speed).max() > 0.1
    assert (np.abs(np.diff(speed, axis=0) / dt) <= bounds.acceleration).all()
    tool = np.linalg.norm(np.diff(arm.fk(arm.values(motion.q))[:, :3, 3], axis=0), axis=1) / dt
    assert 0.5 * ROOM.speed_m_s < tool.max() <= ROOM.speed_m_s
    at = tool_and_flange(arm, motion.q)
    assert ((at > ROOM.workspace.lower_m) & (at < ROOM.workspace.upper_m)).all()
    assert done.measured_least_m is not None and 0.0 < done.measured_least_m < done.measured_after_m
    assert done.measured_after_m is not None and done.measured_after_m < 0.05 * done.measured_before_m
    assert done.measured_least_m < 0.8 * done.measured_after_m and not any("--prior" in note for note in done.notes)
    # and as it is run
    ran = moved(tmp_path / "motion.csv", tmp_path / "moved", limits=tmp_path / "limits.yaml")
    assert ran.finished and not ran.holds and ran.stopped_by == "end" and ran.missed == 0
    read = read_joints(tmp_path / "moved" / "joints.csv")
    along = read.q[read.t_s > read.t_s[0] + 3.0]
    assert cKDTree(motion.q).query(along)[0].max() < 0.02
    assert ran.took_s == pytest.approx(30.0, abs=3.0)


def test_a_box_that_only_an_elbow_would_hit_is_gone_round_and_one_at_the_start_is_refused_by_name(
    cell: Path, tmp_path: Path
) -> None:
    arm = load_arm(str(cell / "arm.yaml"))
    write_limits(tmp_path / "limits.yaml", ROOM)
    run_cell_plan(job(cell, tmp_path, limits=tmp_path / "limits.yaml", link_radius_m=0.0))
    bare = read_joints(tmp_path / "motion.csv").q
    elbow = links_of(arm, ROOM, 0.02, 0.06).chain(bare)[:, 4]
    far = elbow[np.linalg.norm(elbow - elbow[0], axis=1).argmax()]
    away = far + 0.06 * (far - elbow[0]) / np.linalg.norm(far - elbow[0])
    limits = Limits(workspace=ROOM.workspace, forbidden=(Box(lower_m=away - 0.02, upper_m=away + 0.02, name="post"),))
    links = links_of(arm, limits, 0.02, 0.06)
    assert free_of(arm, limits, np.empty((0, 3)), 0.02)(bare).all(), "tool and flange keep clear of it"
    assert not links(bare).all() and links(Q[None])[0]
    write_limits(tmp_path / "post.yaml", limits)
    run_cell_plan(job(cell, tmp_path, limits=tmp_path / "post.yaml"))
    round_it = read_joints(tmp_path / "motion.csv").q
    assert links(round_it).all() and not links_of(arm, limits, 0.02, 0.2)(round_it).all()
    at_it = Limits(forbidden=(Box(lower_m=elbow[0] - 0.02, upper_m=elbow[0] + 0.02, name="lamp"),))
    write_limits(tmp_path / "lamp.yaml", at_it)
    for known in ({}, {"rig": None, "world": None, "target": None, "volume": None}):
        with refuses(Inconsistent, ("j2 to j3", "lamp", "--link-radius-mm")):
            run_cell_plan(job(cell, tmp_path, limits=tmp_path / "lamp.yaml", **known))


def test_it_tells_more_than_a_motion_through_places_at_random_and_is_the_same_again(cell: Path) -> None:
    made, target, arm = scene(cell), read_target(cell / "target.yaml"), load_arm(str(cell / "arm.yaml"))
    plan = quick(cell)
    again = plan_motion(made, target, arm.T_flange_tool, QUICK, start=Q)
    assert np.array_equal(plan.motion.q, again.motion.q)
    rng = np.random.default_rng(7)
    road = roadmap(made, places(made, rng, Q))
    known = known_before(made, target, arm.T_flange_tool, road.q, QUICK.tolerance, QUICK.spot_px)

    def foretold(motion: Motion) -> float:
        information = motion_information(made, known, motion, QUICK.spot_px, QUICK.frames_hz)
        return known.worth(known.information + information)

    others = []
    for _ in range(4):
        order = 1 + rng.permutation(len(road.q) - 1)
        tour = longest(made, road, order.tolist(), QUICK.duration_s)
        if tour is not None:
            others.append(foretold(tour.way.motion(QUICK.duration_s, QUICK.rate_hz)))
    assert others and foretold(plan.motion) < 0.7 * min(others)


def test_what_no_motion_tells_is_said_where_hardly_anything_else_is_left() -> None:
    assert any("--prior" in note for note in plan_module._at_floor((3.1e-4, 3.0e-4), (3.0e-4, 2.9e-4)))
    assert plan_module._at_floor((6.0e-4, 6.0e-4), (3.0e-4, 3.0e-4)) == ()


def test_small_moves_where_nothing_is_known_stay_near(cell: Path, tmp_path: Path) -> None:
    nothing = {"rig": None, "world": None, "target": None, "volume": None}
    done = run_cell_plan(job(cell, tmp_path, **nothing))
    motion, arm = read_joints(tmp_path / "motion.csv"), load_arm(str(cell / "arm.yaml"))
    at = tool_and_flange(arm, motion.q)[len(motion.q) :]
    assert done.kind == "cautious" and np.linalg.norm(at - at[0], axis=1).max() < 0.25
    assert (np.ptp(motion.q, axis=0) > 0.05).all() and np.abs(motion.q - Q).max() < CAUTIOUS_RAD
    assert np.allclose(motion.q[[0, -1]], Q)
    tool = np.linalg.norm(np.diff(at, axis=0), axis=1) / motion.t_s[1]
    assert 0.5 * Limits().speed_m_s < tool.max() < Limits().speed_m_s
    # it stops and goes, by which clocks are found, and its joints do not move alike
    assert (tool < 0.1 * tool.max()).mean() > 0.1
    assert np.abs(np.corrcoef(motion.q.T) - np.eye(6)).max() < 0.95
    bounds = motion_bounds(arm, Limits())
    with refuses(Inconsistent, "smallest"):
        cautious_motion(arm, bounds, lambda q: np.abs(q - Q).max(axis=1) < 1e-4, Q)


AWAY = ((-0.3, -0.1), (-0.1, 0.1), (1.2, 1.35))


@pytest.mark.parametrize(
    ("more", "limits", "kind", "names"),
    [
        ({"volume": AWAY}, Limits(), NotEnoughData, ("--volume", "0")),
        ({"facing_rad": 1e-3}, Limits(), NotEnoughData, ("cameras", "--facing-deg")),
        ({}, Limits(joints=(JointLimit(lower=0.1), *[JointLimit()] * 5)), Inconsistent, ("j1", "-0.0078")),
        ({}, Limits(workspace=Box(lower_m=[0.2, -1, 0], upper_m=[1.2, 1, 1])), Inconsistent, ("workspace", "stands")),
        ({"start": "0,1"}, Limits(), Inconsistent, ("2", "6")),
        ({"volume": None}, Limits(), UsageError, "--volume"),
        ({"volume": ((0.1, 0.1), (0, 1), (0, 1))}, Limits(), UsageError, "volume"),
        ({"out": Path("motion.txt")}, Limits(), UsageError, "motion.txt"),
        ({}, Limits(joints=(JointLimit(speed=1e-3),) * 6), Inconsistent, "--duration"),
    ],
)
def test_what_cannot_be_planned_is_refused(
    cell: Path, tmp_path: Path, more: dict, limits: Limits, kind: type[ArmsightError], names: object
) -> None:
    write_limits(tmp_path / "limits.yaml", limits)
    with refuses(kind, names) as refused:
        run_cell_plan(job(cell, tmp_path, limits=tmp_path / "limits.yaml", **more))
    assert refused.value.cure and not (tmp_path / "motion.csv").exists()


def test_an_arm_whose_limits_nobody_told_is_not_moved(cell: Path, tmp_path: Path) -> None:
    text = (cell / "arm.yaml").read_text()
    bare = tmp_path / "arm.yaml"
    bare.write_text(text.replace("lower: -6.283185307179586,", "lower: -.inf,", 1))
    with refuses(Inconsistent, "j1", "--limits"):
        run_cell_plan(job(cell, tmp_path, model=str(bare)))


def swing(joints: int = 6, by: float = 0.1) -> Motion:
    t = np.arange(500) / 100.0
    return Motion(t_s=t, q=np.tile(Q[:joints], (500, 1)) + by * np.sin(2.0 * np.pi * t / 5.0)[:, None] ** 2)


def test_a_motion_is_not_run_where_it_would_leave_the_limits_or_nobody_agrees(tmp_path: Path) -> None:
    asked: list[str] = []
    write_joints(tmp_path / "motion.csv", swing())
    with refuses(Cancelled):
        moved(tmp_path / "motion.csv", tmp_path / "out", confirm=lambda text: bool(asked.append(text)))
    assert "then over 6 deg" in asked[0]
    write_limits(tmp_path / "limits.yaml", Limits(joints=(*[JointLimit()] * 5, JointLimit(upper=0.2))))
    with refuses(Inconsistent, "joint 6", "upper"):
        moved(tmp_path / "motion.csv", tmp_path / "out", limits=tmp_path / "limits.yaml")
    write_joints(tmp_path / "five.csv", swing(5))
    with refuses(Inconsistent, "5", "6"):
        moved(tmp_path / "five.csv", tmp_path / "out")
    with refuses(UsageError, "3", "--override"):
        moved(tmp_path / "motion.csv", tmp_path / "out", override=3.0)


def test_a_motion_stands_still_while_the_enable_is_let_go_of_and_goes_on_from_there(tmp_path: Path) -> None:
    write_joints(tmp_path / "motion.csv", swing(by=0.05))
    sources: list[JointMotionSource] = []
    at_s: list[float] = []

    def enabled() -> bool:
        if sources and sources[0].stage == "motion":
            at_s.append(sources[0].at_s)
        return not 250 < len(at_s) <= 350

    done = moved(tmp_path / "motion.csv", tmp_path / "out", begun=sources.append, enabled=enabled)
    assert done.finished and done.holds == ["no enable from the operator"]
    assert at_s[245] < at_s[252] == at_s[350] < at_s[400], "it crept on while the arm was held"
