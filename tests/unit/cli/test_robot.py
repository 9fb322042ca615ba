"""robot test and robot jog, as a person and as a program would call them."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

from armsight.cli.commands import app
from armsight.clock import ManualClock
from armsight.control.guard import GuardState
from armsight.errors import Inconsistent, StaleData, UsageError
from armsight.ops import robots
from armsight.ops.robot.jog import _Watcher
from armsight.ops.robot.opening import ClockedRobot, open_robot
from armsight.records import JointReading
from armsight.store.tracks import read_joints
from refusals import names_it
from robot_runs import acted

SIM = "sim:webcam-cell"


def yes(_: str) -> bool:
    return True


def jog(clock: ManualClock | None = None, confirm=yes, progress=None, **job):
    clock = clock or ManualClock()
    robot = job.pop("robot", None) or open_robot(SIM, clock)
    asked = {"confirm": confirm, "progress": progress, **job}
    return acted(robots.jog, robot=ClockedRobot(robot=robot, clock=clock, called=SIM), **asked)


def read_link(for_s: float, clock: ManualClock, robot=None, **job):
    given = ClockedRobot(robot=robot or open_robot(SIM, clock), clock=clock, called=SIM)
    return acted(robots.check_robot, robot=given, for_s=for_s, **job)


def test_a_link_test_moves_nothing() -> None:
    done = read_link(0.4, ManualClock())
    assert done.driver == "sim"
    assert done.cycle_s == pytest.approx(0.008)
    assert (done.n_cycles, done.late, done.missed) == (50, 0, 0)
    assert done.period_ms.median == pytest.approx(8.0)
    assert done.q[1] == pytest.approx(-1.0472, abs=1e-4)
    assert done.state == "ready"


def test_the_readings_of_a_link_test_are_kept_up_to_a_failure_and_replace_nothing(tmp_path) -> None:
    done = read_link(0.4, ManualClock(), record=tmp_path / "joints.csv")
    kept = read_joints(tmp_path / "joints.csv")
    np.testing.assert_allclose(np.diff(kept.t_s), 0.008, atol=1e-9)
    assert (len(kept.t_s), kept.t_s[0], kept.q[-1].tolist()) == (51, 0.0, done.q)
    with pytest.raises(UsageError, match="already"):
        read_link(0.4, ManualClock(), record=tmp_path / "joints.csv")


def test_a_link_that_falls_silent_is_a_failure(tmp_path) -> None:
    clock = ManualClock()
    robot = open_robot(SIM, clock)
    robot.fault("frozen")
    with pytest.raises(StaleData):
        read_link(2.0, clock, robot, record=tmp_path / "joints.csv")
    assert len(read_joints(tmp_path / "joints.csv").t_s) >= 1


def test_readings_that_stop_for_a_moment_are_told_and_the_test_goes_on() -> None:
    clock = ManualClock()
    robot = open_robot(SIM, clock)
    read, begun_s = robot.read, clock.now_s()

    def halting() -> JointReading:
        if 0.2 < clock.now_s() - begun_s < 0.5:
            raise StaleData("the newest reading is old")
        return read()

    robot.read = halting  # type: ignore[method-assign]
    done = read_link(1.0, clock, robot)
    assert done.n_cycles == 125
    assert done.silence_ms == pytest.approx(304.0, abs=8.1)


def test_a_jog_goes_where_it_was_asked_to_and_tells() -> None:
    asked = []

    def confirm(question: str) -> bool:
        asked.append(question)
        return True

    done = jog(confirm=confirm, joint=2, by=0.1)
    assert names_it(asked[0], "+5.73 deg", "-60.00", "-54.27 deg")
    assert done.sent[1] == pytest.approx(-1.0472 + 0.1, abs=1e-4)
    assert np.abs(np.array(done.reached) - done.sent).max() < 1e-4
    assert done.state == "ready"


@pytest.mark.parametrize(
    ("job", "error"),
    [
        ({"joint": 7, "by": 0.1}, UsageError),
        ({"joint": 0, "by": 0.1}, UsageError),
        ({"joint": 1, "by": float("nan")}, UsageError),
        ({"joint": 1, "by": 0.0}, UsageError),
        ({"joint": 1, "by": 0.1, "speed": 0.0}, UsageError),
        ({"joint": 1, "by": 99.0}, Inconsistent),
    ],
)
def test_what_cannot_be_is_refused_before_anything_moves(job, error) -> None:
    def never(_: str) -> bool:
        raise AssertionError("it asked")

    with pytest.raises(error):
        jog(confirm=never, **job)


def test_the_commands_answer_programs_and_have_exit_codes() -> None:
    run = CliRunner().invoke
    done = run(app, ["robot", "test", "--robot", SIM, "--for", "0.05", "--json"])
    assert done.exit_code == 0
    assert json.loads(done.stdout)["driver"] == "sim"
    assert run(app, ["robot", "test", "--robot", "sim"]).exit_code == 2
    assert run(app, ["robot", "test", "--robot", "nosuch:1"]).exit_code == 4
    assert run(app, ["robot", "jog", "--robot", SIM, "--joint", "9", "--by", "0.1", "--yes"]).exit_code == 2
    assert run(app, ["robot", "jog", "--robot", SIM, "--joint", "3", "--by", "6", "--yes"]).exit_code == 3
    assert run(app, ["robot", "jog", "--robot", SIM, "--joint", "1", "--by", "0.1"], input="n\n").exit_code == 130


@pytest.mark.parametrize(("step_rad", "stuck"), [(0.0, True), (1e-16, True), (1e-7, False)])
def test_steps_that_lead_nowhere_end_a_jog(step_rad: float, stuck: bool) -> None:
    """Held joints differ by rounding from cycle to cycle; what moves, however slowly, is not stuck."""
    watcher = _Watcher(0.01)
    q = np.array([0.3, -1.2, 1.1])
    for cycle in range(150):
        moved = q + np.array([0.0, 0.0, step_rad * (cycle if step_rad > 1e-12 else cycle % 2)])
        status = SimpleNamespace(limited=(), finished=False, guard=GuardState.RUNNING, at_rest=False, q_sent=moved)
        watcher(status)  # type: ignore[arg-type]  # what it looks at of a status
    assert watcher.stuck is stuck
