"""An emulated Universal Robots controller without its sockets: registers, the program that runs, and the arm."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from armsight.arrays import Array
from armsight_sim.arms import Drive, Servo, SimArm
from armsight_sim.twins.base import RIGHT, Wrong
from armsight_sim.twins.rtde_wire import INPUTS, OUTPUTS, REGISTERS
from armsight_sim.twins.urscript import Program, Routine, ScriptError

STOPPED, PLAYING = 1, 2
"""runtime_state."""

POWER_ON, PROGRAM_RUNNING = 1, 2
"""Bits of robot_status_bits."""

REST = 1e-5
"""Joints nearer to their goal than this, in rad, have arrived."""


class UrController:
    """The arm, the registers, and the program; `cycle` is what it does each cycle.

    Powers, currents, temperatures and forces are zero: nothing of that is emulated.
    """

    def __init__(self, *, arm: SimArm, drive: Drive, home: ArrayLike) -> None:
        self.arm = arm
        self.messages: list[str] = []
        """Why a program was refused or stopped."""
        self.wrong: Wrong = RIGHT
        self._drive = drive
        self._servo = Servo(drive, home, keep=1000)
        self._first: Array | None = None
        self._cycles = 0
        self._program: Program | None = None
        self._inputs: dict[str, list[float]] = {}
        self._int_out = [0] * REGISTERS
        self._double_out = [0.0] * REGISTERS
        self._watchdog: tuple[str, float] | None = None
        self._written_s: dict[str, float] = {}
        self._rows: dict[str, list[float]] = {}

    @property
    def cycle_s(self) -> float:
        """Time between two cycles."""
        return self._drive.cycle_s

    @property
    def time_s(self) -> float:
        """Time since its start."""
        return self._cycles * self._drive.cycle_s

    @property
    def q(self) -> Array:
        """Where the joints are, (n,) in rad."""
        return np.asarray(self._servo.at(self._servo.t_s)[0])

    @property
    def running(self) -> bool:
        """Whether a program runs."""
        return self._program is not None

    def play(self, text: str) -> None:
        """Run a program in place of the one before; a text that is none is told in messages."""
        self.halt("another program came")
        self._first = None
        try:
            self._program = Program(text, self._calls(), self._waits())
        except ScriptError as error:
            self.messages.append(f"refused: {error}")

    def halt(self, why: str) -> None:
        """Stop the program and the arm."""
        if self._program is not None:
            self.messages.append(f"stopped: {why}")
        self._program, self._watchdog = None, None
        self._servo.halt()

    def write(self, name: str, values: list[float]) -> None:
        """Set an input."""
        self._inputs[name] = values
        self._written_s[name] = self.time_s

    def cycle(self) -> None:
        """Run the program for one cycle, and move."""
        self._cycles += 1
        if self._watchdog is not None:
            name, longest_s = self._watchdog
            if self.time_s - self._written_s.get(name, 0.0) > longest_s:
                self.halt(f"nothing was written to {name}")
        if self._program is not None:
            try:
                if not self._program.step():
                    self.halt("it came to its end")
            except ScriptError as error:
                self.halt(str(error))
        self._servo.advance(self.time_s)
        self._rows.clear()

    def output(self, name: str) -> list[float]:
        """Return the numbers of a variable that can be received."""
        row = self._rows.get(name)
        if row is None:
            row = self._rows[name] = self._output(name)
        return row

    def _output(self, name: str) -> list[float]:
        kind, _, number = name.rpartition("_register_")
        if kind == "output_int":
            return [self._int_out[int(number)]]
        if kind == "output_double":
            return [self._double_out[int(number)]]
        if kind:
            return self._inputs.get(name, [0])
        known: dict[str, Callable[[], list[float]]] = {
            "timestamp": lambda: [self.time_s],
            "actual_q": lambda: self._read().tolist(),
            "target_q": lambda: self._servo.goal.tolist(),
            "actual_qd": lambda: self._speed().tolist(),
            "target_qd": lambda: self._speed().tolist(),
            "actual_TCP_pose": lambda: self._pose(self._read()),
            "target_TCP_pose": lambda: self._pose(self._servo.goal),
            "runtime_state": lambda: [PLAYING if self.running else STOPPED],
            "robot_status_bits": lambda: [POWER_ON | (PROGRAM_RUNNING if self.running else 0)],
            "safety_status_bits": lambda: [1],
            "safety_mode": lambda: [1],
            "robot_mode": lambda: [7],
            "joint_mode": lambda: [253] * 6,
            "speed_scaling": lambda: [1.0],
            "target_speed_fraction": lambda: [1.0],
        }
        zeros = {"VECTOR6D": 6, "VECTOR3D": 3}
        return known[name]() if name in known else [0] * zeros.get(OUTPUTS[name], 1)

    def _read(self) -> Array:
        return np.asarray(self._servo.read(self._servo.t_s)[0])

    def _speed(self) -> Array:
        before, now = self._servo.at([self._servo.t_s - self.cycle_s, self._servo.t_s])
        return np.asarray((now - before) / self.cycle_s)

    def _pose(self, q: Array) -> list[float]:
        pose = self.arm.frames(q)[-1]
        return [*pose[:3, 3].tolist(), *Rotation.from_matrix(pose[:3, :3]).as_rotvec().tolist()]

    def _calls(self) -> dict[str, Callable[..., Any]]:
        """Return the functions of URScript that take no time."""
        return {
            "textmsg": lambda *parts: None,  # goes to the pendant's log, which is not emulated
            "read_input_integer_register": lambda i: int(self._register("int", i)),
            "read_input_float_register": lambda i: float(self._register("double", i)),
            "write_output_integer_register": lambda i, value: self._int_out.__setitem__(_index(i), int(value)),
            "write_output_float_register": lambda i, value: self._double_out.__setitem__(_index(i), float(value)),
            "get_actual_joint_positions": lambda: self._read().tolist(),
            "get_target_joint_positions": lambda: self._servo.goal.tolist(),
            "get_forward_kin": lambda *q: self._pose(np.array(q[0]) if q else self._read()),
            "get_steptime": lambda: self.cycle_s,
            "is_steady": lambda: bool(np.abs(self._servo.goal - self.q).max() < REST),
            "rtde_set_watchdog": self._set_watchdog,
            # the emulated arm feels no forces: what tunes force control changes nothing
            "force_mode_set_gain_scaling": lambda value: None,
            "force_mode_set_damping": lambda value: None,
        }

    def _waits(self) -> dict[str, Callable[..., Routine]]:
        """Return the functions of URScript that take time."""
        return {
            "sync": lambda: self._sleep(self.cycle_s),
            "sleep": self._sleep,
            "servoj": self._servoj,
            "speedj": self._speedj,
            "movej": self._movej,
            "stopj": self._stop,
            "stopl": self._stop,
        }

    def _register(self, kind: str, number: Any) -> float:
        return self._inputs.get(f"input_{kind}_register_{_index(number)}", [0])[0]

    def _set_watchdog(self, name: str, frequency: float, action: str = "pause") -> None:
        if name not in INPUTS or not (math.isfinite(frequency) and frequency >= 0.0):
            raise ScriptError(f"no watchdog of {name} at {frequency} Hz")
        # a frequency of zero takes the watchdog away; whichever action is asked for, the program ends here
        self._watchdog = (name, 1.0 / frequency) if frequency > 0.0 and action != "ignore" else None
        self._written_s[name] = self.time_s

    def _go(self, q: Any) -> None:
        goal = np.asarray(q, dtype=float)
        if goal.shape != (self.arm.n,) or not np.isfinite(goal).all():
            raise ScriptError(f"no joint positions: {q}")
        self._first = goal if self._first is None else self._first
        goal = self.wrong.guided(goal, self._first, self._servo.goal)
        low, high = (np.array([getattr(joint, end) for joint in self.arm.joints]) for end in ("lower", "upper"))
        if not ((low <= goal) & (goal <= high)).all():
            raise ScriptError(f"joint positions out of range: {np.round(goal, 3).tolist()}")
        self._servo.command(self._servo.t_s, goal)

    def _sleep(self, time_s: float) -> Routine:
        for _ in range(max(1, round(time_s / self.cycle_s))):
            yield

    def _servoj(
        self, q: Any, a: float = 0, v: float = 0, t: float = 0.002, lookahead_time: float = 0.1, gain: float = 300
    ) -> Routine:
        if not (0.03 <= lookahead_time <= 0.2 and 100 <= gain <= 2000 and t > 0.0):
            raise ScriptError(f"servoj with t {t}, lookahead_time {lookahead_time}, gain {gain}")
        self._go(q)
        yield from self._sleep(t)

    def _speedj(self, qd: Any, a: float = 1.4, t: float = 0.0) -> Routine:
        cycles = max(1, round(t / self.cycle_s))
        for _ in range(cycles):
            self._go(self._servo.goal + np.asarray(qd, dtype=float) * self.cycle_s)
            yield

    def _movej(self, q: Any, a: float = 1.4, v: float = 1.05, t: float = 0.0, r: float = 0.0) -> Routine:
        goal, start = np.asarray(q, dtype=float), self._servo.goal
        cycles = max(1, math.ceil(float(np.abs(goal - start).max()) / (max(v, 1e-6) * self.cycle_s)))
        for i in range(1, cycles + 1):
            self._go(start + (goal - start) * i / cycles)
            yield
        while np.abs(goal - self.q).max() > REST:
            yield

    def _stop(self, a: float = 2.0, arot: float = 0.0) -> Routine:
        self._servo.halt()
        yield


def _index(number: Any) -> int:
    if not (isinstance(number, int) and 0 <= number < REGISTERS):
        raise ScriptError(f"there is no register {number}")
    return number
