"""A simulated arm that moves by itself, supervised on a clock that only the test moves; faults are planted."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from armsight.clock import ManualClock
from armsight.drivers import RobotState
from armsight.errors import DeviceFailed, NotEnoughData, UsageError
from armsight.ops.simulation.scenarios import load_scenario
from armsight.ops.verification.supervising import Supervised
from armsight.ops.verify import supervise
from armsight.records import spot_target
from armsight.store import rig_from_mapping, target_from_mapping, write_rig, write_target
from armsight.store.arm_file import arm_from_mapping, write_arm
from armsight.store.recording import Recording
from armsight.store.rigs import World, write_world
from armsight_plant.options import FoxgloveOptions, PlantOptions
from armsight_plant.publishing import Publishing
from armsight_plant.state import PlantState, conditions
from armsight_sim.live import live_cell
from armsight_sim.robot import RobotFault
from armsight_sim.scenario_builder import build_world
from refusals import refuses


class Ticking(ManualClock):
    """A clock that passes through every few milliseconds, and calls what wants to be called."""

    def __init__(self) -> None:
        super().__init__(10.0)
        self.calls: list[Callable[[], None]] = []

    def sleep_until(self, t_s: float) -> None:
        while self.now_s() < t_s:
            super().sleep_until(min(self.now_s() + 0.004, t_s))
            for call in self.calls:
                call()


class Cell:
    """The webcam cell in the dark at half the size, and its files."""

    def __init__(self, folder: Path, events: list[dict[str, Any]]) -> None:
        model = load_scenario("webcam-cell")[0]
        keys = model.model_dump()
        keys |= {"room": "dark", "events": events}
        cameras = keys["cameras"] | {"width": 640, "height": 360, "pipeline": "ideal"}
        for side in ("left", "right"):
            cameras[side] |= {key: 0.5 * cameras[side][key] for key in ("fx", "fy", "cx", "cy")}
        keys["cameras"] = cameras
        keys["target"]["sigma_px"] = 1.3
        model = type(model).model_validate(keys)
        self.clock, self.folder = Ticking(), folder
        self.cell = live_cell(model, self.clock, play=True)
        world = build_world(model, frames=1)
        write_rig(folder / "rig.yaml", rig_from_mapping(self.cell.rig, "rig"))
        write_target(folder / "target.yaml", target_from_mapping(self.cell.target, "target"))
        write_world(folder / "world.yaml", World(parent="world", T_parent_rig=world.T_base_rig))
        content = {"format": "armsight/arm", "version": 1, **world.true.mapping(world.T_flange_tool)}
        write_arm(folder / "arm.yaml", arm_from_mapping(content, "arm"))

    def run(self, **more: Any) -> dict[str, Any]:
        """Supervise; return the summary."""
        devices = Supervised(
            robot=self.cell.robot,
            pairs=self.cell.pairs,
            origin_s=lambda: self.cell.origin_s,
            on_step=self.clock.calls.append,
        )
        files = {name: self.folder / f"{name}.yaml" for name in ("rig", "target", "arm", "world")}
        given = {
            "robot": "here",
            "left": "here:left",
            "right": "here:right",
            "out": self.folder / "out",
            **files,
            **more,
        }
        return supervise(**given, clock=self.clock, devices=devices).to_dict()


def test_a_good_arm_raises_nothing_though_it_moves(tmp_path: Path) -> None:
    done = Cell(tmp_path, []).run(warn_m=5e-4, stop_m=2e-3, frames=60)
    assert done["level"] == "good" and not done["stopped"] and done["alarms"] == []
    assert done["n"] == 60 and done["n_compared"] >= 58 and done["missed"] == 0
    assert done["errors"]["max_m"] < 5e-4
    assert len((tmp_path / "out" / "errors.csv").read_text().splitlines()) == 61


def test_two_lights_which_show_no_rotation_are_refused_before_anything_is_opened(tmp_path: Path) -> None:
    cell = Cell(tmp_path, [])
    write_target(tmp_path / "target.yaml", spot_target({"A": (0.0, 0.0, 0.0), "B": (0.1, 0.0, 0.0)}))
    with refuses(UsageError, "2 lights", "rotation", "supervised", "three lights"):
        cell.run(stop_m=2e-3, frames=5)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "event",
    [
        {"kind": "jump", "at_s": 0.5, "for_s": 9.0, "by_m": [0.005, 0.0, 0.0]},
        {"kind": "encoder_jump", "at_s": 0.5, "for_s": 9.0, "joint": 2, "by": 0.5},
    ],
    ids=["tool knocked", "encoder"],
)
def test_a_fault_stops_the_robot_and_is_in_the_recording(tmp_path: Path, event: dict[str, Any]) -> None:
    cell = Cell(tmp_path, [event])
    stopped_at: list[float] = []
    stop = cell.cell.robot.stop
    cell.cell.robot.stop = lambda: (stopped_at.append(cell.clock.now_s()), stop())[1]
    done = cell.run(warn_m=5e-4, stop_m=2e-3, frames=200)
    assert done["level"] == "stop" and done["stopped"]
    first = done["alarms"][0]
    assert 0.5 <= first["t_s"] <= 0.56, "no alarm before the fault, and one within some frames of it"
    assert stopped_at and stopped_at[0] - cell.cell.origin_s < 0.65
    assert done["duration_s"] < 1.7
    with Recording(tmp_path / "out" / "live.mcap") as recording:
        told = [item.message for item in recording.events()]
    assert any("stop" in text for text in told)


def test_what_is_lost_is_told_and_never_counted_as_good(tmp_path: Path) -> None:
    cell = Cell(tmp_path, [])
    seen: list[str] = []

    def show(pose: Any, compared: Any, level: Any, lost: str) -> None:
        seen.append(lost)
        if len(seen) == 20:
            cell.cell.pairs.cover()

    done = cell.run(stop_m=2e-3, frames=80, blind_stop_s=0.8, show=show)
    assert done["n_lost"] >= 40 and done["n_compared"] <= 20 and done["blind_s"] >= 0.8
    assert [alarm["level"] for alarm in done["alarms"]] == ["blind", "stop"] and done["stopped"]
    assert f"{done['n_lost']} of {done['n_lost'] + done['n_compared']} pairs" in done["verdict"]


def test_joints_that_stand_still_in_the_link_are_stale_not_good(tmp_path: Path) -> None:
    cell = Cell(tmp_path, [])
    with cell.cell.robot:
        cell.cell.robot.fault(RobotFault.FROZEN)
    with pytest.raises(NotEnoughData, match="joints"):
        cell.run(warn_m=1e-3, frames=20)
    summary = json.loads((tmp_path / "out" / "verify.json").read_text())
    assert summary["level"] == "unknown" and summary["n_compared"] == 0 and summary["n_stale"] == 20


def test_a_robot_by_its_own_program_takes_no_commands_until_stopped(tmp_path: Path) -> None:
    robot = Cell(tmp_path, []).cell.robot
    with robot:
        with refuses(DeviceFailed, "own program"):
            robot.step_joints(np.zeros(6))
        robot.stop()
        robot.reset()
        robot.step_joints(np.zeros(6))
        assert robot.state is not RobotState.STOPPED


NOTE = "somebody was kept out"


class PublishedValue:
    """Stands for the publishers: looks at each pair as their thread would, and answers with a note."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.states: list[PlantState] = []
        self.log: Callable[[str, str], None] = lambda *_: None
        monkeypatch.setattr("armsight_plant.publishing.published", self.published)

    @contextmanager
    def published(self, options: PlantOptions, source: Callable[[], PlantState], log: Any) -> Iterator[dict[str, int]]:
        self.source, self.log = source, log
        yield {"foxglove": 8767}

    def look(self, *_: Any) -> None:
        self.states.append(self.source())


def test_the_plant_is_told_of_each_pair_what_is_known_and_no_more(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told, said = PublishedValue(monkeypatch), []
    cell = Cell(tmp_path, [{"kind": "jump", "at_s": 0.3, "for_s": 9.0, "by_m": [0.005, 0.0, 0.0]}])
    told_of = Publishing(PlantOptions(foxglove=FoxgloveOptions(host="127.0.0.1", port=0)))

    def show(*_: Any) -> None:
        told.look()
        if len(told.states) == 3:
            told.log("warning", NOTE)
        if len(told.states) == 6:
            for number in range(1000):
                told.log("warning", f"{number}")
        if len(told.states) == 29:
            told.log("info", "later")

    cell.run(warn_m=2e-3, frames=30, plant=told_of, show=show, tell=said.append)
    tolerances = [one.seen.in_tolerance for one in told.states if one.seen is not None]
    assert len(told.states) == 30 and tolerances[-1] is False
    assert set(tolerances[: tolerances.index(False)]) <= {True, None} and True in tolerances
    last = told.states[-1]
    assert [one.name for one in conditions(last, stale_s=60.0)] == ["beyond-warn"]
    assert last.seen is not None and last.seen.pose.status.value == "ok"
    assert last.robot is not None and last.robot.reading is not None
    assert said[:2] == ["Foxglove: ws://127.0.0.1:8767", NOTE]
    assert "more warnings" in said[-1] and len(said) < 30
    with Recording(tmp_path / "out" / "live.mcap") as recording:
        assert NOTE in [item.message for item in recording.events()]


def test_the_plant_is_told_nothing_of_a_robot_whose_link_is_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told = PublishedValue(monkeypatch)
    cell = Cell(tmp_path, [])

    def show(*_: Any) -> None:
        told.look()
        if len(told.states) == 5:
            cell.cell.robot.fault(RobotFault.LINK_LOST)

    told_of = Publishing(PlantOptions(foxglove=FoxgloveOptions(host="127.0.0.1", port=0)))
    cell.run(warn_m=2e-3, blind_stop_s=0.2, frames=60, show=show, plant=told_of)
    last = told.states[-1]
    assert last.robot is None and last.why
    assert "robot" in [one.name for one in conditions(last)]
