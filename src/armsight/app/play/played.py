"""A path as it is played: its set points into the recording, its events told, held against the cameras."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from armsight.app.schemas.play import PlayMeasuredOutput, PlayOutput
from armsight.control.events import QueueSink
from armsight.control.guard import GuardState
from armsight.control.play import PathSource, PlayProgress, PlayWatch, WatchFigures
from armsight.control.setpoints import CycleState, Hold, SetPoint, ToolPose
from armsight.control.status import RobotStatus, Timing
from armsight.geometry import xyz_quat
from armsight.records import PoseStatus

STUCK_S = 5.0
"""A path that the guard has held for so long, though the operator's enable was there, is given up."""

Show = Callable[[RobotStatus, PlayProgress, WatchFigures | None], None]
"""Is told now and then of a cycle, of where the path is, and of what the cameras saw."""


class PlayedSource:
    """A path whose set points and events go into the recording, and its commands to the watch."""

    def __init__(self, source: PathSource, sink: QueueSink, watch: PlayWatch | None) -> None:
        self.name = source.name
        self._source, self._sink, self._watch = source, sink, watch
        self._before = ("", False, False, False)

    def next(self, now: CycleState) -> SetPoint:
        """Return the set point, and queue it."""
        if self._watch is not None:
            self._watch.cycle(now)
        wanted = self._source.next(now)
        if isinstance(wanted, ToolPose):
            xyz, quat = xyz_quat(wanted.T_base_tool)
            self._sink.command(now.t_s, "set_point", {"xyz_m": list(xyz), "quat_xyzw": list(quat)})
        else:
            self._sink.command(now.t_s, "set_point", {"hold": wanted.why if isinstance(wanted, Hold) else ""})
        self._tell(now.t_s)
        return wanted

    def warm_up(self) -> None:
        """Run once what a cycle runs."""
        self._source.warm_up()

    def _tell(self, t_s: float) -> None:
        """Tell what changed along the path."""
        at = self._source.progress
        stage, paused, waiting, welding = self._before
        self._before = (at.stage, at.paused, at.waiting, at.welding)
        changes = (
            (at.stage != stage, at.stage),
            (at.paused != paused, "paused" if at.paused else "resumed"),
            (at.waiting != waiting, "waits for the arm" if at.waiting else "goes on"),
            (at.welding != welding, "weld_on" if at.welding else "weld_off"),
        )
        for changed, text in changes:
            if changed:
                self._sink.event(t_s, f"{text} at {at.s_m:.4f} m", "info", "play")


class PlayTally:
    """Counts cycles as the loop does them; given to it as what may end it."""

    def __init__(self, source: PathSource, watch: PlayWatch | None, cancelled: Callable[[], bool]) -> None:
        self.cycles = 0
        self.holds: list[str] = []
        self.last: RobotStatus | None = None
        self.began_s: float | None = None
        self._source, self._watch, self._cancelled = source, watch, cancelled
        self._held_s: float | None = None
        self._stuck = False

    def __call__(self, status: RobotStatus) -> bool:
        """Take a cycle; tell whether it was the last: at the end, let go of, stopped, or held for too long."""
        self.last = status
        self.cycles += 1
        self.began_s = status.t_s if self.began_s is None else self.began_s
        if status.why and status.reason not in self.holds:
            self.holds.append(status.reason)
        if status.guard is not GuardState.HOLDING:
            self._held_s = None
        elif self._held_s is None:
            self._held_s = status.t_s
        self._stuck = self._held_s is not None and status.t_s - self._held_s > STUCK_S
        return status.finished or self._cancelled() or status.guard is GuardState.STOPPED or self._stuck

    @property
    def took_s(self) -> float:
        """Time since the first cycle."""
        return 0.0 if self.last is None or self.began_s is None else self.last.t_s - self.began_s

    @property
    def finished(self) -> bool:
        """Whether the path was run to its end."""
        return self._source.progress.stage == "finished"

    def stopped_by(self) -> str:
        """Return why the loop ended."""
        if self._watch is not None and self._watch.exceeded:
            return self._watch.exceeded
        if self.finished:
            return "end"
        if self._cancelled():
            return "operator"
        return "" if self.last is None else self.last.why or (self.holds[-1] if self.holds else "")


def play_output(
    tally: PlayTally,
    timing: Timing,
    source: PathSource,
    watch: PlayWatch | None,
    counts: Mapping[PoseStatus, int] | None,
    recording: str,
    outside: str,
) -> PlayOutput:
    """Return the figures of a path that ended."""
    plan = source.plan
    return PlayOutput(
        state="disabled" if tally.last is None else tally.last.guard.value,
        n_cycles=timing.n_cycles,
        late=timing.late,
        missed=timing.missed,
        stopped_by=tally.stopped_by(),
        finished=tally.finished,
        share=source.progress.share,
        length_m=plan.length_m,
        planned_s=plan.time_s,
        took_s=tally.took_s,
        slowest=plan.slowest,
        planned_fastest_m_s=plan.fastest_m_s,
        rounded_m=plan.rounded_m,
        measured=None if watch is None or counts is None else _measured(watch, counts),
        outside=outside,
        holds=tally.holds,
        recording=recording,
    )


def _measured(watch: PlayWatch, counts: Mapping[PoseStatus, int]) -> PlayMeasuredOutput:
    seen = watch.figures
    return PlayMeasuredOutput(
        n=seen.n,
        rms_m=seen.rms_m,
        max_m=seen.max_m,
        last_m=seen.last_m,
        mean_m=None if seen.mean_m is None else seen.mean_m.tolist(),
        arm_lag_s=watch.arm_lag_s,
        n_doubtful=counts[PoseStatus.DOUBTFUL],
        n_position_only=counts[PoseStatus.POSITION_ONLY],
        n_lost=counts[PoseStatus.LOST],
    )
