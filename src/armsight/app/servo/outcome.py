"""What a servo came to: its cycles counted while it runs, then told."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from armsight.app.schemas.servo import (
    ServoDelayOutput,
    ServoErrorOutput,
    ServoGainOutput,
    ServoOutput,
    ServoTimeOutput,
)
from armsight.app.servo.vision import Vision
from armsight.control.events import QueueSink
from armsight.control.guard import GuardState, TargetState
from armsight.control.servo import Gain, ServoSource
from armsight.control.setpoints import CycleState, Hold, SetPoint, ToolTwist
from armsight.control.status import RobotStatus, Timing
from armsight.records import PoseStatus

Show = Callable[[RobotStatus, float | None], None]
"""Is told now and then of a cycle, and of the error of place in m where the target is followed."""


class RecordedSource:
    """A servo whose set points go into the recording."""

    name = "servo"

    def __init__(self, source: ServoSource, sink: QueueSink) -> None:
        self._source, self._sink = source, sink

    def next(self, now: CycleState) -> SetPoint:
        """Return the set point, and queue it."""
        wanted = self._source.next(now)
        self._sink.command(now.t_s, "set_point", told(wanted))
        return wanted

    def target(self, now_s: float) -> tuple[TargetState, float | None]:
        """Return what is known of the target, and the age in s of the newest frame that shows it."""
        return self._source.target(now_s)

    def warm_up(self) -> None:
        """Run once what a cycle runs."""
        self._source.warm_up()


def told(wanted: SetPoint) -> Mapping[str, Any]:
    """Return a servo's set point as JSON knows it."""
    if isinstance(wanted, ToolTwist):
        return {"velocity_m_s": wanted.velocity_m_s.tolist(), "angular_rad_s": wanted.angular_rad_s.tolist()}
    return {"hold": wanted.why if isinstance(wanted, Hold) else ""}


class Tally:
    """Counts cycles as the loop does them; given to it as what may end it."""

    def __init__(self, source: ServoSource, cancelled: Callable[[], bool]) -> None:
        self.cycles = self.followed = 0
        self.holds: list[str] = []
        self.last: RobotStatus | None = None
        self.last_m = self.last_rad = 0.0
        self._source = source
        self._cancelled = cancelled
        self._sum_m2 = self._max_m = 0.0

    def __call__(self, status: RobotStatus) -> bool:
        """Take a cycle; tell whether it was the last one: the operator let go, or the guard stopped."""
        self.last = status
        self.cycles += 1
        error = self._source.error
        if status.guard is GuardState.RUNNING and error is not None:
            self.followed += 1
            self.last_m = float(np.linalg.norm(error.translation_m))
            self.last_rad = float(np.linalg.norm(error.rotation_rad))
            self._sum_m2 += self.last_m**2
            self._max_m = max(self._max_m, self.last_m)
        elif status.why and status.reason not in self.holds:
            self.holds.append(status.reason)
        return self._cancelled() or status.guard is GuardState.STOPPED

    @property
    def error_m(self) -> float | None:
        """The error of place just now; None where the target is not followed."""
        error = self._source.error
        return None if error is None else float(np.linalg.norm(error.translation_m))

    @property
    def error(self) -> ServoErrorOutput:
        """How far the target was from where it is wanted."""
        if not self.followed:
            return ServoErrorOutput(rms_m=None, max_m=None, last_m=None, last_rad=None)
        return ServoErrorOutput(
            rms_m=float(np.sqrt(self._sum_m2 / self.followed)),
            max_m=self._max_m,
            last_m=self.last_m,
            last_rad=self.last_rad,
        )

    def stopped_by(self) -> str:
        """Return why the loop ended."""
        if self._cancelled():
            return "operator"
        stopped = self.last is not None and self.last.guard is GuardState.STOPPED
        return self.last.why if stopped and self.last is not None else "time"


def servo_output(
    tally: Tally, timing: Timing, vision: Vision, source: ServoSource, gain: Gain, recording: str, outside: str
) -> ServoOutput:
    """Return the figures of a servo that ended."""
    took = np.array(vision.took_ms)
    counts = vision.counts
    return ServoOutput(
        state="disabled" if tally.last is None else tally.last.guard.value,
        n_cycles=timing.n_cycles,
        late=timing.late,
        missed=timing.missed,
        stopped_by=tally.stopped_by(),
        n_frames=sum(counts.values()),
        n_ok=counts[PoseStatus.OK],
        n_doubtful=counts[PoseStatus.DOUBTFUL],
        n_position_only=counts[PoseStatus.POSITION_ONLY],
        n_lost=counts[PoseStatus.LOST],
        gain=ServoGainOutput(
            used=gain.used,
            no_overshoot=gain.no_overshoot,
            stable=gain.stable,
            cycle_s=gain.cycle_s,
            n_delay=gain.n,
            note=gain.note,
        ),
        delay=ServoDelayOutput(camera_s=source.camera_delay_s, arm_s=source.arm_lag_s),
        error=tally.error,
        followed=tally.followed / max(tally.cycles, 1),
        outside=outside,
        holds=tally.holds,
        vision_ms=ServoTimeOutput(median=float(np.median(took)), p99=float(np.percentile(took, 99)))
        if len(took)
        else None,
        recording=recording,
    )
