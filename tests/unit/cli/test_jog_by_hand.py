"""An arm moved by keys and by a gamepad: what is read of them, and that the arm stands where nobody holds them."""

import os
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from typer.testing import CliRunner

from armsight.cli.commands import app
from armsight.clock import ManualClock
from armsight.drivers.jog_inputs import GamepadInput, JogAxes, KeyboardInput, open_jog_input
from armsight.errors import Cancelled, DeviceFailed, DeviceNotFound, UsageError
from armsight.ops import robots
from armsight.ops.robot.opening import ClockedRobot, open_robot
from refusals import refuses
from robot_runs import acted

SIM = "sim:webcam-cell"


@pytest.fixture
def pipe() -> Iterator[tuple[int, int]]:
    ends = os.pipe()
    os.set_blocking(ends[0], False)
    yield ends
    for end in ends:
        try:
            os.close(end)
        except OSError:  # closed by the test
            continue


def event(kind: int, number: int, value: int) -> bytes:
    """Return a js_event as the kernel's documentation has it: u32 time, s16 value, u8 type, u8 number."""
    return struct.pack("<IhBB", 12345, value, kind, number)


def test_a_column_of_keys_is_an_axis_and_every_other_key_lets_go(pipe):
    keys = KeyboardInput(pipe[0], 6)

    def press(text: str) -> JogAxes | None:
        os.write(pipe[1], text.encode())
        return keys.wait(1.0)

    assert press("q") == JogAxes((1.0, 0.0, 0.0, 0.0, 0.0, 0.0), enabled=True)
    assert press("qqqH") == JogAxes((0.0, 0.0, 0.0, 0.0, 0.0, -1.0), enabled=True), "the newest key counts"
    assert press("z") == press("y") == JogAxes((0.0, 0.0, 0.0, 0.0, 0.0, 1.0), enabled=True)
    for other in (" ", "u", "\x1b[A", "é"):
        assert press(other) == JogAxes((0.0,) * 6, enabled=False), other
    assert press("x").ended
    assert press("\x1b").ended
    assert keys.wait(0.0) is None
    os.close(pipe[1])
    assert keys.wait(1.0).ended, "a terminal that is gone"


def test_sticks_count_with_the_enable_and_a_gamepad_pulled_out_is_an_error(pipe):
    pad = GamepadInput(pipe[0], 6)
    os.write(pipe[1], event(0x82, 1, 0) + event(2, 1, -32767) + event(2, 3, 16384) + event(1, 0, 1))
    seen = pad.wait(1.0)
    assert seen.axes == pytest.approx((1.0, 0.0, 0.0, -0.5, 0.0, 0.0), abs=1e-4)
    assert not seen.enabled, "button 0 is no enable"
    os.write(pipe[1], event(1, 5, 1))
    assert pad.wait(1.0).enabled
    assert pad.wait(0.0).enabled, "a held button sends nothing new"
    os.write(pipe[1], event(1, 5, 0))
    assert not pad.wait(1.0).enabled
    os.write(pipe[1], event(1, 7, 1))
    assert pad.wait(1.0).ended
    os.close(pipe[1])
    with refuses(DeviceFailed, "gamepad", "gone"):
        pad.wait(1.0)


class Hand:
    """Holds the first axis until `until` says so, and then does what `then` says."""

    def __init__(self, until: Callable[[], bool], then: Callable[[], JogAxes]) -> None:
        self.until, self.then = until, then

    def help(self) -> str:
        return "Hold it."

    def wait(self, timeout_s: float) -> JogAxes:
        return self.then() if self.until() else JogAxes((1.0, 0.0, 0.0, 0.0, 0.0, 0.0), enabled=True)


def moved(then: Callable[[], JogAxes], by: float = 0.02, **job):
    clock = ManualClock()
    robot = open_robot(SIM, clock)
    asked: list[str] = []
    first: list[np.ndarray] = []

    def until() -> bool:
        q = robot.read().q
        first.append(q)
        return abs(q - first[0]).max() > by

    @contextmanager
    def inputs(name: str, n: int):
        assert (name, n) == ("keyboard", 6)
        yield Hand(until, then)

    confirmed = job.pop("confirmed", True)

    def confirm(question: str) -> bool:
        asked.append(question)
        return confirmed

    given = ClockedRobot(robot=robot, clock=clock, called=SIM)
    done = acted(robots.jog, robot=given, hand="keyboard", confirm=confirm, inputs=inputs, **job)
    return done, first[0], asked


def ended() -> JogAxes:
    return JogAxes((0.0,) * 6, enabled=False, ended=True)


def test_the_arm_moves_while_the_key_is_held_and_stands_when_the_person_is_done():
    done, start, asked = moved(ended)
    assert done.asked is None
    assert done.sent[0] - start[0] > 0.015
    assert done.sent[1:] == pytest.approx(start[1:], abs=1e-3)
    assert done.state == "ready"
    assert "deg/s" in asked[0]
    assert "Hold it." in asked[0]


def test_an_input_that_fails_brings_the_arm_to_rest_and_is_told():
    def gone() -> JogAxes:
        raise DeviceFailed("the gamepad is gone", consequence="The robot came to rest", cure="Plug it in")

    with refuses(DeviceFailed, "gamepad", "gone"):
        moved(gone)


def test_nothing_moves_unasked_or_by_what_is_not_there():
    with pytest.raises(Cancelled):
        moved(ended, confirmed=False)
    with pytest.raises(UsageError, match="--frame"):
        moved(ended, frame="wrist")
    with pytest.raises(UsageError, match="--with"), open_jog_input("joystick", 6):
        pass
    with refuses(DeviceNotFound, "/dev/input/js99"), open_jog_input("gamepad:/dev/input/js99", 6):
        pass
    with pytest.raises(UsageError, match="9 axes"):
        KeyboardInput(0, 9)


def test_the_command_refuses_what_is_not_clear():
    run = CliRunner().invoke
    for more in ([], ["--joint", "1"], ["--with", "keyboard", "--joint", "1", "--by", "0.1"], ["--with", "keyboard"]):
        done = run(app, ["robot", "jog", "--robot", SIM, "--yes", *more])
        assert done.exit_code == 2, more  # the last: no terminal
