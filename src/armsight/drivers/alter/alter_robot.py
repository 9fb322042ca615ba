"""A robot behind real-time path control over a serial line."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Mapping
from typing import Any

import numpy as np
import serial
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array
from armsight.clock import Clock, SystemClock
from armsight.defaults import STALE_CYCLES
from armsight.drivers.alter.frames import SEQUENCES, AlterSettings, FrameSplitter, StateFrame, answer
from armsight.drivers.cyclic import CyclicRobot
from armsight.drivers.goals import PoseGoals, away, between
from armsight.drivers.link_settings import ArmOnLink
from armsight.drivers.pace import ControllerClock, LinkCounts, LinkTimes, possible
from armsight.drivers.proof import Probe, Proof, ProofState, flange_and_joint_probe, flange_probe
from armsight.drivers.protocols import PROVING, Sent
from armsight.errors import DeviceFailed, DeviceNotFound, Inconsistent, UsageError
from armsight.priority import control_first
from armsight.records import JointReading
from armsight.units import DEG, MM

SILENT_CYCLES = 10.0
"""A link that was silent for so many cycles is lost, and stays so until it is opened again: the controller ends path
control after as many late answers in a row."""

MOST_MISSED = 50
"""Frames farther ahead than this are those of a controller that has started anew."""

RESTART_FRAMES = 3
"""So many frames in a row, not newer than the newest, are those of a controller that has started anew."""

PARTS = 6
"""A joint step is shortened so often, by its flange's way, before it is given up."""

OTHER_ARM = (5.0 * MM, 0.5 * DEG)
"""An arm's file whose flange is farther from the controller's than this, in m or rad, is of another arm."""


class AlterRobot(CyclicRobot):
    """An arm whose controller sends a state each cycle over a serial line and takes the way to go as its answer.

    device: the serial port. settings: see AlterSettings. Raises UsageError for a setting that cannot be.
    """

    takes_poses = True

    def __init__(self, device: str, *, settings: Mapping[str, Any] | None = None, clock: Clock | None = None) -> None:
        self.settings = AlterSettings.checked(settings)
        self.port = device
        cycle_s = self.settings.cycle_s
        times = LinkTimes(cycle_s=cycle_s, stale_s=STALE_CYCLES * cycle_s, silent_s=SILENT_CYCLES * cycle_s)
        name = f"alter:{device}"
        poses = PoseGoals(name, self.settings.speed_m_s, self.settings.speed_rad_s, cycle_s)
        super().__init__(
            name, limits=self.settings.joint_limits(6), times=times, clock=clock or SystemClock(), poses=poses
        )
        self._arm: ArmOnLink | None = self.settings.arm
        self.counts = LinkCounts()
        self._last: StateFrame | None = None
        self._nominal = self._model_offset = self._base_pose = self._in_force = RigidTransform.identity()
        self._controller_clock = ControllerClock(cycle_s, numbered=True, own=True)
        self._proof = Proof(cycle_s, lags=False)

    def step_joints(self, step: Array) -> Sent:
        """Move on by step (6,) in rad; without the arm's geometry only a step of zeros, which asks for nothing."""
        with self._lock:
            reading = self._ready()
            if self._arm is None:
                if np.shape(step) != (6,) or np.any(step):  # not a number is not zero
                    raise UsageError(
                        f"{self.name} does not know the arm's geometry, and its controller takes poses",
                        cure="Give the arm's file, or send poses",
                    )
                return self._note(reading.q, self._poses.next, ())
            asked, limited = self._goals.step(step, reading.q)
            if self._proving(asks=bool((asked != self._goals.sent).any())):
                return self._note(self._base_q, self._base_pose, (PROVING, *limited))
            asked, pose, cut = self._agreed(self._arm, asked, reading)
            return self._note(asked, pose, (*limited, *cut))

    def move_pose(self, T_base_flange: RigidTransform) -> Sent:
        """Move towards a pose of the flange by the controller's geometry, as far as one cycle allows.

        Without the arm's geometry the joint values of the answer are those read last.
        """
        with self._lock:
            reading = self._ready()
            pose, limited = self._poses.go(T_base_flange, self._flange_read(reading))
            if self._proving(asks=bool(np.concatenate(between(self._poses.sent, pose)).any())):
                q = reading.q if self._arm is None else self._base_q
                return self._note(q, self._base_pose, (PROVING, *limited))
            if self._arm is None:
                return self._note(reading.q, pose, limited)
            try:
                goal = self._arm.ik(self._model_offset * pose, self._goals.sent)
                self._goals.hold()
                q, slow = self._goals.step(goal - self._goals.sent, reading.q)
                q, pose, cut = self._agreed(self._arm, q, reading)
            except Exception:
                self._goals.hold()
                self._poses.hold()
                raise
            return self._note(q, pose, tuple(dict.fromkeys((*limited, *slow, *cut))))

    def _flange(self, arm: ArmOnLink, q: Array) -> RigidTransform:
        """Return T_base_flange as the controller has it, by the arm's file laid onto it where the link was opened."""
        return self._model_offset.inv() * arm.fk(q)

    def _flange_read(self, reading: JointReading) -> RigidTransform:
        """Return where the flange is by the newest reading; without the arm's geometry, where it is told to be."""
        if self._arm is not None:
            return self._flange(self._arm, reading.q)
        return self._poses.sent if self._last is None else self._last.T_base_flange

    def _agreed(
        self, arm: ArmOnLink, asked: Array, reading: JointReading
    ) -> tuple[Array, RigidTransform, tuple[str, ...]]:
        """Return joints (6,) on the way to those asked whose flange is within a cycle's way, that pose, and what cut.

        The pose is what goes out; it belongs to the joints exactly. Where no part of the step will do, none is taken.
        """
        start, here, q = self._goals.sent, self._flange_read(reading), asked
        words: tuple[str, ...] = ()
        for _ in range(PARTS):
            goal = self._flange(arm, q)
            pose, cut = self._poses.go(goal, here)
            if not cut:
                return q, pose, words
            words = words or cut
            full, part = (between(self._poses.sent, end) for end in (goal, pose))
            shares = [_length(p) / _length(w) for p, w in zip(part, full, strict=True) if _length(w) > 1e-9]
            self._goals.hold()
            q, _ = self._goals.step(0.99 * min(1.0, *shares, 1.0) * (q - start), start)
        self._goals.hold()
        self._poses.hold()
        return self._goals.sent, self._poses.sent, words

    def _start(self) -> None:
        self.counts = LinkCounts()
        self._last, self._mismatch = None, ""
        self._behind, self._first_late = 0, 0
        self._answered: int | None = None
        self._numbers, self._answers, self._obeyed = 0, 0, False
        self._splitter = FrameSplitter()
        self._closing = False
        self._line = self._open_line()
        self._first = threading.Event()
        self._thread = threading.Thread(target=self._run, name=self.name, daemon=True)
        self._thread.start()
        if not self._first.wait(self.settings.open_s) or self._unfit():
            self._finish()
            if unfit := self._unfit():
                raise DeviceFailed(f"{self.name}: {unfit[0]}", cure=unfit[1])
            why = self._mismatch or f"no controller has sent a state within {self.settings.open_s:g} s"
            heard = f" ({self.counts.garbage_bytes} bytes were none)" if self.counts.garbage_bytes else ""
            raise DeviceNotFound(
                f"{self.name}: {why}{heard}",
                cure="Check cable and baud, and start real-time path control on the controller as it is set here",
            )

    def _open_line(self) -> serial.Serial:
        cycle_s = self.cycle_s
        try:
            line = serial.Serial(
                self.port, self.settings.baud, timeout=cycle_s, write_timeout=0.5 * cycle_s, exclusive=True
            )
        except (serial.SerialException, ValueError, OSError) as error:
            raise DeviceFailed(
                f"the serial port {self.port} cannot be opened: {error}",
                consequence="The robot is not opened: one program at a time may drive it",
                cure="Check its name and your rights to it, or stop the other program",
            ) from error
        with contextlib.suppress(Exception):  # not every adapter can; without it some hold bytes back for 16 ms
            line.set_low_latency_mode(True)
        line.reset_input_buffer()
        return line

    def _finish(self) -> None:
        self._closing = True
        self._thread.join()
        with contextlib.suppress(OSError):
            self._line.close()

    def _run(self) -> None:
        control_first()
        while not self._closing:
            try:
                data = self._line.read(self._line.in_waiting or 1)
                if self._stood_still():  # what has come is of the past, and a full line has dropped what followed it
                    while waiting := self._line.in_waiting:
                        self._line.read(waiting)
                    data = self._splitter.clear()
            except (serial.SerialException, OSError, TypeError):
                self._lose("its serial port is gone")
                return
            states = self._splitter.feed(data)
            self.counts.garbage_bytes = self._splitter.garbage_bytes
            for state in states:
                self._take(state, newest=state is states[-1])
            if self._fallen_silent():
                self._lose("its controller has fallen silent")

    def _take(self, state: StateFrame, *, newest: bool) -> None:
        if self._last is None:
            if not self._may_begin(state):
                return
        elif not self._follows(state, self._last):
            return
        if not self._reachable_since(state):
            self.counts.refused += 1
            return
        cycles = 1 if self._last is None else (state.sequence - self._last.sequence) % SEQUENCES
        unheard_s = 0.0 if self._last is None else self._unheard_s()
        self._hear(state)
        if unheard_s > self._times.silent_s:
            self._check_session(state)
        self._numbers += cycles
        self._hear_clock(self._clock.now_s(), self._numbers)
        if newest and not self._lost:
            self._obeyed = self._obeyed or self._answered == state.taken
            self._tick(cycles, taken=self._answered in (None, state.taken))
            self._answered = None
            if state.on:
                self._answer(state)
        self.counts.heard += 1
        clock = self._controller_clock
        if (clock.wrong and clock.sure) or (self._measured() and not self._unfit()):
            self._first.set()

    def _unfit(self) -> tuple[str, str] | None:
        if clock := self._controller_clock.wrong:
            return clock, self._controller_clock.cure
        if self._obeyed or not self._answers:
            return None
        return (
            f"its controller takes none of our answers, {self._answers} so far",
            "Each comes after its cycle, or does not get through: check the line, its baud, and what is between",
        )

    def _may_begin(self, state: StateFrame) -> bool:
        """Note where the ways begin; False where that cannot be told from this state."""
        if (state.cumulative, state.tool) != (self.settings.cumulative, self.settings.axes == "tool"):
            how = f"{'' if state.cumulative else 'not '}cumulative, {'tool' if state.tool else 'world'} axes"
            self._mismatch = f"path control is {how} on the controller, and set otherwise here"
            return False
        if not state.on or state.corrected:
            # a whole way that another program has given would be taken back by an answer of zero
            self._mismatch = "path control is off on the controller, or still holds another program's way"
            return False
        if self._arm is not None:
            model = self._arm.fk(state.q)
            way_m, turn = between(state.T_base_flange, model)
            if float(np.linalg.norm(way_m)) > OTHER_ARM[0] or float(np.linalg.norm(turn)) > OTHER_ARM[1]:
                self._mismatch = "the arm's file is of another arm: its flange is elsewhere than the controller says"
                return False
            self._model_offset = model * state.T_base_flange.inv()
        self._nominal = state.T_base_flange
        self._first_late = state.n_late
        return True

    def _follows(self, state: StateFrame, last: StateFrame) -> bool:
        """Tell whether a state is newer than the last; several that are not mean a controller that started anew."""
        ahead = (state.sequence - last.sequence) % SEQUENCES
        if 0 < ahead <= MOST_MISSED + round(self._unheard_s() / self.cycle_s):
            self._behind = 0
            self.counts.missed += ahead - 1
            return True
        self.counts.repeated += 1
        self._heard_s = self._clock.now_s()
        if ahead:
            self._behind += 1
            if self._behind >= RESTART_FRAMES:
                self._lose("its controller, or path control on it, has started anew (the numbering went back)")
        return False

    def _check_session(self, state: StateFrame) -> None:
        """Begin anew where the controller had no answer for as long as it waits: it has ended path control by then.

        A whole way that is still in force would be taken back by one from here: that session goes on.
        """
        if not state.corrected:
            self._begin_anew("path control on its controller has started anew meanwhile", state.q)
            self._nominal = state.T_base_flange

    def _reachable_since(self, state: StateFrame) -> bool:
        last = self._last
        return last is None or possible(state.q, last.q, (state.sequence - last.sequence) % SEQUENCES, self.cycle_s)

    def _hear(self, state: StateFrame) -> None:
        self.counts.late = (state.n_late - self._first_late) % SEQUENCES
        self._last = state
        if not state.on or self._held:
            self._halt("" if state.on else "path control is off on the controller", state.q)
            self._nominal = state.T_base_flange
        self._heard(state.q, self._clock.now_s())

    def _answer(self, state: StateFrame) -> None:
        """Answer with the way from where the controller is told to be to the goal, no longer than a cycle allows."""
        with self._lock:
            # a controller that is not proven may go the other way: what leads back from where it says it is leads on
            heres = {ProofState.PASSED: state.T_base_flange, ProofState.RUNNING: self._in_force}
            here = heres.get(self._proof.state, self._poses.sent)
            goal = self._within_a_cycle(here, self._poses.sent)
            start = here if self.settings.cumulative else self._nominal
            tool = self.settings.axes == "tool"
            way_m, turn = between(start, goal)
            if tool:
                way_m, turn = (start.rotation.inv().apply(vector) for vector in (way_m, turn))
            hold = bool(self._stopped)
        if self._outlived():
            return
        with contextlib.suppress(Inconsistent, serial.SerialException, OSError):
            # an answer that cannot go out is a late one to the controller; a port that is gone is told by reading
            self._line.write(
                answer(state.sequence, way_m, turn, cumulative=self.settings.cumulative, tool=tool, hold=hold)
            )
            self._answered = state.sequence
            self._answers += 1

    def _within_a_cycle(self, here: RigidTransform, goal: RigidTransform) -> RigidTransform:
        way_m, turn = between(here, goal)
        speeds = (self.settings.speed_m_s, self.settings.speed_rad_s)
        longest = [1.01 * speed * self.cycle_s for speed in speeds]
        share = min(
            1.0, *(m / max(float(np.linalg.norm(v)), 1e-300) for v, m in zip((way_m, turn), longest, strict=True))
        )
        return RigidTransform.from_components(
            np.asarray(here.translation) + share * way_m, Rotation.from_rotvec(share * turn) * here.rotation
        )

    def _rebase(self, q: Array) -> None:
        super()._rebase(q)
        if self._last is not None:
            self._poses.start(self._last.T_base_flange)
            self._unprove()
            if self._arm is not None:
                self._model_offset = self._arm.fk(q) * self._last.T_base_flange.inv()

    def _unprove(self) -> None:
        super()._unprove()
        self._base_pose = self._in_force = self._poses.sent

    def _probe(self) -> Probe:
        """Move the flange by what the controller tells of it; with the arm's geometry the joints, and watch both."""
        arm, base = self._arm, self._base_pose
        if arm is None:
            return flange_probe(self.n_joints)
        return flange_and_joint_probe(
            *self._goals.room(), lambda by: np.concatenate(between(base, self._flange(arm, self._base_q + by)))
        )

    def _axes(self) -> Array:
        """Return the flange's way and turn as the controller tells them, and the joints (12,)."""
        here = self._base_pose if self._last is None else self._last.T_base_flange
        return np.concatenate([*between(self._base_pose, here), super()._axes()])

    def _put(self, offset: Array) -> None:
        self._in_force = self._pose_of(self._proof.in_force)
        if self._arm is not None:
            super()._put(offset[6:])
        self._poses.start(self._pose_of(offset))

    def _pose_of(self, offset: Array) -> RigidTransform:
        """Return the flange's pose of a probe moved by (12,)."""
        if self._arm is None:
            return away(self._base_pose, offset[:6])
        return self._flange(self._arm, self._base_q + offset[6:])

    def _off(self, reading: JointReading) -> float:
        if self._arm is not None:
            return super()._off(reading)
        last = self._last
        if last is None:
            return 0.0
        way_m, turn = between(last.T_base_flange, self._poses.sent)
        return float(max(np.abs(way_m).max(), np.abs(turn).max()))


def _length(vector: Array) -> float:
    return float(np.linalg.norm(vector))
