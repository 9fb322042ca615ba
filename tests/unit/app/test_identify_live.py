"""An arm identified online on the simulated cell, on a clock that only the test moves."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from armsight.clock import ManualClock
from armsight.control.joint_sweep import Pace
from armsight.drivers import RobotState
from armsight.errors import (
    Cancelled,
    DeviceFailed,
    DeviceLost,
    Inconsistent,
    NotEnoughData,
    StaleData,
    UsageError,
)
from armsight.ops.arm_files import load_arm
from armsight.ops.identification.left_out import FirstJoints, read_limits
from armsight.ops.identification.live import Known, LiveSweeps, OperatorCallbacks, identify_live
from armsight.ops.requests.motion import RobotJob
from armsight.ops.saving import write_with_page
from armsight.ops.simulation.scenarios import load_scenario
from armsight.records import Frame, TargetKind, board_target, spot_target
from armsight.store import (
    read_rig,
    read_target,
    read_world,
    rig_from_mapping,
    target_from_mapping,
    write_rig,
    write_target,
)
from armsight.store.arm_file import read_arm
from armsight.store.arm_points import read_sweeps
from armsight.store.rigs import World, write_world
from armsight_sim.live import live_cell
from armsight_sim.scenario_builder import build_world
from refusals import refuses

LIMITS = np.array([[-0.5, 5.2], [-0.4, 1.9], [0.3, 1.1]])
TEXT = "-0.5:5.2,-0.4:1.9,0.3:1.1"
LIMITS = read_limits(TEXT)
TRUE = {(0, "d_m"): 1.27, (0, "a_m"): 0.0, (0, "alpha_rad"): np.pi / 2, (1, "d_m"): -0.05, (1, "a_m"): 0.1,
        (1, "alpha_rad"): np.pi / 2}  # fmt: skip
YES = OperatorCallbacks(confirm=lambda _: True)


class Cell:
    """The scenario after Kapucu and Baysec, its images of a quarter's size, and files of its rig, target and place."""

    def __init__(self, folder: Path, lag_s: float = 0.05) -> None:
        model = load_scenario("kapucu2005-rrp")[0]
        keys = model.model_dump()
        cameras = keys["cameras"]
        cameras |= {"width": 320, "height": 240, "colour": False}
        for side in ("left", "right"):
            cameras[side] |= {"fx": 378.8, "fy": 374.45, "cx": 159.5, "cy": 119.5}
        keys["arm"]["lag_s"] = lag_s
        keys["room"] = "dark"  # a grey beacon among a room's lights could be any of them
        for joint in keys["arm"]["joints"]:
            joint["radius_m"] = 0.0  # whether the arm hides the beacon takes longer to work out than the image
        keys["target"] |= {"sigma_px": 1.5, "colour": None, "level": 120.0}
        keys["cameras"]["sensor"] |= {"read_noise_level": 4.0, "ambient_level": 12.0}
        model = type(model).model_validate(keys)
        self.clock = ManualClock(10.0)
        cell = live_cell(model, self.clock)
        self.robot, self.pairs = cell.robot, cell.pairs
        write_rig(folder / "rig.yaml", rig_from_mapping(cell.rig, "rig"))
        write_target(folder / "target.yaml", target_from_mapping(cell.target, "target"))
        world = build_world(model, frames=1)
        write_world(folder / "world.yaml", World(parent="world", T_parent_rig=world.T_base_rig))
        self.folder = folder
        self.asked: list[np.ndarray] = []
        self.moved_at_once = 0
        send = self.robot.step_joints

        def watched(step: np.ndarray) -> Any:
            self.moved_at_once = max(self.moved_at_once, int((np.abs(step) > 0.0).sum()))
            sent = send(step)
            self.asked.append(sent.q)
            return sent

        self.robot.step_joints = watched  # type: ignore[method-assign]

    def run(
        self,
        person: OperatorCallbacks = YES,
        progress: Any = None,
        *,
        model: Path | None = None,
        nominal: str | None = None,
        pairs: Any = None,
        **more: Any,
    ) -> Any:
        """Identify this arm, quickly, and write what was found."""
        rig, target, world = (self.folder / f"{name}.yaml" for name in ("rig", "target", "world"))
        out = self.folder / "arm.yaml"
        sweeps = LiveSweeps(**({"limits": LIMITS, "pace": Pace(speed=1.0, frames_per_reading=1), "out": out} | more))
        arms = [None if one is None else load_arm(str(one)) for one in (model, nominal)]
        known = Known(rig=read_rig(rig), world=read_world(world), model=arms[0], nominal=arms[1])
        done = identify_live(
            sweeps,
            known,
            read_target(target),
            RobotJob(robot="here"),
            {"left": "here:left", "right": "here:right"},
            person,
            progress=progress,
            clock=self.clock,
            devices=(self.robot, pairs or self.pairs),
        )
        write_with_page(out, done, [rig, target, world], {"out": out})
        return done


def when(condition: Callable[[int], bool], act: Callable[[], None]) -> Any:
    """A Progress that acts once on the first reading for which the condition holds, counted from 1 over all sweeps."""
    state = SimpleNamespace(n=0, done=False)

    def update(done: float, total: float, note: str = "") -> None:
        state.n += total > 0  # else it is prepared
        if not state.done and condition(state.n):
            state.done = True
            act()

    return SimpleNamespace(update=update, cancelled=lambda: False)


@pytest.fixture(scope="module")
def complete(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Cell, dict[str, Any], dict[str, Any], int]]:
    """One complete identification: cell, result, the plan as it was shown, commands sent until then."""
    cell = Cell(tmp_path_factory.mktemp("live"))
    shown: list[tuple[dict[str, Any], int]] = []
    person = OperatorCallbacks(
        confirm=lambda _: True, show=lambda plan: shown.append((plan.to_dict(), len(cell.asked)))
    )
    content = cell.run(person).to_dict()
    assert len(shown) == 1
    yield cell, content, *shown[0]


def test_the_arm_is_found_within_its_deviations(complete: Any) -> None:
    cell, content, _, _ = complete
    assert [joint["type"] for joint in content["joints"]] == ["revolute", "revolute", "prismatic"]
    for (j, key), true in TRUE.items():
        found, std = content["joints"][j][key], content["joints"][j]["std"][key]
        assert abs(found - true) < 4.0 * std, (j, key, found, std)
        assert std < 2e-3, (j, key)
    assert read_arm(cell.folder / "arm.yaml").n == 3
    seen = read_sweeps(cell.folder / "arm.sweep.csv")
    left_out = [note for note in content["notes"] if "behind the beacon" in note]
    assert seen.std_px is not None and len(seen) == 30 - len(left_out) >= 24
    for name in ("arm.probe.csv", "arm.report.html"):
        assert (cell.folder / name).stat().st_size > 0


def test_the_accuracy_told_before_moving_is_that_claimed_afterwards(complete: Any) -> None:
    _, content, plan, sent = complete
    assert sent < len(complete[0].asked)
    compared = 0
    for joint, expected in zip(content["joints"], plan["expected_std"], strict=True):
        for key, claimed in joint["std"].items():
            assert (claimed is None) == (expected[key] is None), (joint["index"], key)
            if claimed:
                assert 0.5 < expected[key] / claimed < 2.0, (joint["index"], key)
                compared += 1
    assert compared == 9


def test_limits_are_kept_and_one_joint_moves_at_a_time(complete: Any) -> None:
    cell, _, plan, sent = complete
    asked = np.array(cell.asked)
    assert (asked >= LIMITS[:, 0] - 1e-9).all() and (asked <= LIMITS[:, 1] + 1e-9).all()
    assert cell.moved_at_once == 1
    assert (np.abs(np.diff(asked, axis=0)) > 1e-12).sum(axis=1).max() == 1
    assert cell.robot.state is RobotState.CLOSED
    # the probe stays near the start, the sweeps use what the limits give
    probed, swept = np.ptp(asked[:sent], axis=0), np.ptp(asked, axis=0)
    assert (probed <= 0.4 * np.ptp(LIMITS, axis=1) + 1e-6).all()
    assert (swept > 0.8 * np.ptp(LIMITS, axis=1)).all()
    assert sorted(sweep["joint"] for sweep in plan["sweeps"]) == [1, 2, 3]


def test_a_lost_beacon_stops_the_robot_and_what_was_read_stays(tmp_path: Path) -> None:
    cell = Cell(tmp_path)
    model = nearly_right(tmp_path)
    progress = when(lambda n: n == 10, lambda: cell.pairs.cover())
    stopped: list[tuple[int, bool]] = []
    stop = cell.robot.stop

    def noted_stop() -> None:
        stopped.append((len(cell.asked), (tmp_path / "arm.sweep.csv").exists()))
        stop()

    cell.robot.stop = noted_stop  # type: ignore[method-assign]
    with refuses(NotEnoughData, "beacon", "lost") as caught:
        cell.run(progress=progress, model=model, pace=Pace(speed=0.2, frames_per_reading=1))
    assert "10 readings" in caught.value.consequence and "stopped" in caught.value.consequence
    assert len(read_sweeps(tmp_path / "arm.sweep.csv")) == 10
    assert not (tmp_path / "arm.yaml").exists()
    assert stopped[0] == (len(cell.asked), False), "stopped before anything else is done, and sent nothing after"


def nearly_right(folder: Path) -> Path:
    """An arm.yaml of the table, its lengths a few mm off."""
    path = folder / "model.yaml"
    path.write_text(
        "format: armsight/arm\nversion: 1\nconvention: standard\njoints:\n"
        "- {name: j1, type: revolute, a_m: 0.002, alpha_rad: 1.5708, d_m: 1.273, theta_rad: 0.0}\n"
        "- {name: j2, type: revolute, a_m: 0.098, alpha_rad: 1.5708, d_m: -0.051, theta_rad: 0.0}\n"
        "- {name: j3, type: prismatic, a_m: 0.0, alpha_rad: 0.0, d_m: 0.002, theta_rad: 0.0}\n"
    )
    return path


@pytest.mark.parametrize(
    ("fault", "kind", "said"),
    [
        ({"fault": "link_lost"}, DeviceLost, "lost"),
        ({"fault": "frozen"}, StaleData, "old"),
        ({"fault": "jump", "by": [0.0, 0.3, 0.0]}, DeviceFailed, ("joint 2", "sent", "stands")),
    ],
)
def test_a_robot_that_fails_is_stopped(fault: dict[str, Any], kind: type[Exception], said: str, tmp_path: Path) -> None:
    cell = Cell(tmp_path)
    progress = when(lambda n: n == 3, lambda: cell.robot.fault(**fault))
    with refuses(kind, said):
        cell.run(progress=progress, model=nearly_right(tmp_path))
    sent = len(cell.asked)
    cell.clock.advance(5.0)
    assert len(cell.asked) == sent
    assert len(read_sweeps(tmp_path / "arm.sweep.csv")) >= 3


class Late:
    """The pairs as drivers give them that stamp frames at their arrival, 0.18 s after they were taken, 30 a second."""

    name, total, skew = "late", None, None

    def __init__(self, cell: Cell) -> None:
        self._cell = cell

    def __enter__(self) -> Late:
        self._cell.pairs.__enter__()
        return self

    def __exit__(self, *ended: Any) -> None:
        self._cell.pairs.__exit__(*ended)

    def __iter__(self) -> Iterator[tuple[Frame, Frame]]:
        pairs, clock = self._cell.pairs, self._cell.clock
        path = pairs._path
        assert path is not None
        index = 6
        while True:
            index = max(index + 1, int(np.ceil(30.0 * (clock.now_s() - path.origin_s))))
            clock.sleep_until(path.origin_s + index / 30.0)
            taken = [pairs._frame(index, index / 30.0 - 0.18, side, path) for side in ("left", "right")]
            yield tuple(replace(frame, t_s=index / 30.0) for frame in taken)  # type: ignore[misc]


def test_frames_older_than_they_say_are_not_taken_for_the_present(tmp_path: Path) -> None:
    cell = Cell(tmp_path, lag_s=0.0)
    # each way takes a twentieth of a second
    content = cell.run(model=nearly_right(tmp_path), readings=20, pairs=Late(cell))
    assert max(joint.residual_rms_px for joint in content.joints) < 0.1
    assert not any(joint.discarded for joint in content.joints)


def test_a_limit_of_the_robot_s_own_is_told(tmp_path: Path) -> None:
    cell = Cell(tmp_path)
    with refuses(DeviceFailed, "joint 3", "range", "j3"):
        cell.run(limits=read_limits("-0.5:5.2,-0.4:1.9,0.3:1.6"), model=nearly_right(tmp_path))
    assert np.max(np.array(cell.asked)[:, 2]) <= 1.2


def test_limits_beyond_the_range_that_a_link_tells_are_refused_before_anything_moves(tmp_path: Path) -> None:
    cell = Cell(tmp_path)
    told = (np.array([-1.0, -1.0, 0.2]), np.array([6.0, 2.0, 1.2]))
    cell.robot.joint_range = told  # type: ignore[attr-defined]
    with refuses(UsageError, "joint 3", "1.6", "1.2", "0.3000:1.2000"):
        cell.run(limits=read_limits("-0.5:5.2,-0.4:1.9,0.3:1.6"))
    assert not cell.asked
    named = read_limits("-0.5:5.2,-0.4:1.9,0.3000:1.2000")
    plan = cell.run(OperatorCallbacks(), model=nearly_right(tmp_path), propose=True, limits=named).plan
    assert len(plan.sweeps) == 3
    first = FirstJoints(robot=cell.robot, m=2)
    assert np.array_equal(first.joint_range, np.array(told)[:, :2])  # type: ignore[arg-type]


def test_a_target_without_a_light_to_follow_is_refused_before_anything_moves(tmp_path: Path) -> None:
    cell = Cell(tmp_path)
    one = (tmp_path / "target.yaml").read_text()
    write_target(tmp_path / "target.yaml", board_target(TargetKind.CHECKERBOARD, 9, 6, 0.025))
    with refuses(UsageError, "followed", "Nothing is moved", "one light"):
        cell.run()
    assert not cell.asked
    (tmp_path / "target.yaml").write_text(one)
    plan = cell.run(OperatorCallbacks(), model=nearly_right(tmp_path), propose=True).plan
    assert len(plan.sweeps) == 3


def test_sweeps_keep_the_whole_target_in_the_pictures(tmp_path: Path) -> None:
    """Which of its lights the beacon is, only a target tells that stays in view; the page proposes the same sweeps."""
    cell = Cell(tmp_path)

    def proposed(reach_m: float) -> int:
        write_target(
            tmp_path / "target.yaml", spot_target({"A": (0.0,) * 3, "B": (reach_m, 0.0, 0.0), "C": (0.0, 0.1, 0.0)})
        )
        return len(cell.run(OperatorCallbacks(), model=nearly_right(tmp_path), propose=True).plan.sweeps)

    assert proposed(0.3) == 3
    with refuses(NotEnoughData, "not surely", "start"):  # B is out of a picture if it is to the side of A
        proposed(0.6)
    assert not cell.asked


def test_nothing_moves_unless_confirmed_or_where_it_cannot(tmp_path: Path) -> None:
    cell = Cell(tmp_path)
    with refuses(Cancelled, "confirmed"):
        cell.run(OperatorCallbacks())
    with refuses(Inconsistent, "joint 2", "stands"):
        cell.run(limits=read_limits("-0.5:5.2,-0.4:1.2,0.3:1.1"))
    with refuses(UsageError, "limits", "3 joints", "lower"):
        cell.run(limits=read_limits("-0.5:5.2,-0.4:1.9"))
    plan = cell.run(OperatorCallbacks(), model=nearly_right(tmp_path), propose=True).plan
    assert len(plan.sweeps) == 3 and plan.expected_std[1].a_m < 2e-3
    assert not cell.asked, "a command was sent"


def test_ctrl_c_stops_it(tmp_path: Path) -> None:
    cell = Cell(tmp_path)
    calls = SimpleNamespace(n=0)

    def cancelled() -> bool:
        calls.n += 1
        return calls.n > 100

    progress = SimpleNamespace(update=lambda *_: None, cancelled=cancelled)
    with refuses(Cancelled, "stopped"):
        cell.run(progress=progress)
    assert calls.n == 101


def test_the_command_line_asks_and_moves_nothing_without_an_answer(tmp_path: Path) -> None:
    from typer.testing import CliRunner

    from armsight.cli.commands import app
    from armsight.ops.simulation.run import write_world_files

    model = load_scenario("kapucu2005-rrp")[0]
    write_world_files(build_world(model, frames=1), tmp_path)
    name = "sim:kapucu2005-rrp"
    words = ["identify", "--live", name, "--left", f"camera:{name}:left", "--right", f"camera:{name}:right"]
    words += ["--rig", str(tmp_path / "rig.yaml"), "--target", str(tmp_path / "target.yaml")]
    out = ["-o", str(tmp_path / "found.yaml")]
    assert CliRunner().invoke(app, [*words, *out]).exit_code == 2
    words += [f"--limits={TEXT}", "--world", str(tmp_path / "world.yaml")]
    assert CliRunner().invoke(app, [*words, *out, "--increments", "order"]).exit_code == 2
    asked = CliRunner().invoke(app, [*words, *out], input="n\n")
    assert asked.exit_code == 130 and "5%" in asked.output
    planned = CliRunner().invoke(app, [*words, "--model", str(tmp_path / "arm.yaml"), "--propose", *out])
    assert planned.exit_code == 0 and "Accuracy to expect" in planned.output
    assert not (tmp_path / "found.yaml").exists()
