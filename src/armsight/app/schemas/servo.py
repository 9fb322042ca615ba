"""servo."""

from __future__ import annotations

from pydantic import Field

from armsight.app.schemas.base import Output


class ServoGainOutput(Output):
    """The gain, and what the measured delay allows (MATH 3.3)."""

    used: float = Field(description="Gain of translation and rotation, 1/s.")
    no_overshoot: float = Field(description="Up to this one the error decays without overshoot, 1/s.")
    stable: float = Field(description="From this one on the arm would swing up, 1/s; it is refused.")
    cycle_s: float = Field(description="The servo's cycle: the cameras' or the controller's, the longer one, s.")
    n_delay: int = Field(description="Cycles of delay, begun ones counted whole.")
    note: str = Field(description="What to know about the gain; empty for nothing.")


class ServoDelayOutput(Output):
    """Delays, measured while it ran."""

    camera_s: float = Field(description="From the middle of an exposure to its pose in memory, median, s.")
    arm_s: float = Field(description="From a command to the arm's motion, s.")


class ServoErrorOutput(Output):
    """How far the target was from where it is wanted, as the cameras and the arm's model tell."""

    rms_m: float | None = Field(description="RMS of the place while the target was followed, m; null: it never was.")
    max_m: float | None = Field(description="Largest error of the place, m.")
    last_m: float | None = Field(description="The last one, m.")
    last_rad: float | None = Field(description="The last error of the rotation, rad.")


class ServoTimeOutput(Output):
    """Time from a pair of frames in memory to its pose handed to the control loop, ms."""

    median: float = Field(description="Median, ms.")
    p99: float = Field(description="99 of 100 took less, ms.")


class ServoOutput(Output):
    """armsight servo."""

    state: str = Field(description="The guard's last state: running, holding, retreating, disabled or stopped.")
    n_cycles: int = Field(description="Cycles of the control loop.")
    late: int = Field(description="Cycles that began more than half a cycle too late.")
    missed: int = Field(description="Cycles that never began.")
    stopped_by: str = Field(description="Why it ended: time, operator, or in words what the guard stopped for.")
    n_frames: int = Field(description="Pairs of frames measured.")
    n_ok: int = Field(description="Pairs that showed the whole target.")
    n_doubtful: int = Field(description="Pairs whose pose does not fit the claims: not followed.")
    n_position_only: int = Field(description="Pairs that showed where it is, but not how it is turned.")
    n_lost: int = Field(description="Pairs that did not show it.")
    gain: ServoGainOutput = Field(description="The gain, and what the delay allows.")
    delay: ServoDelayOutput = Field(description="The delays that were measured.")
    error: ServoErrorOutput = Field(description="How far the target was from where it is wanted.")
    followed: float = Field(description="Share of the cycles in which the target was followed, 0 to 1.")
    outside: str = Field(description="Which limits the arm stood outside of at the start, by how much; empty: none.")
    holds: list[str] = Field(description="Why the arm held, each reason once.")
    vision_ms: ServoTimeOutput | None = Field(description="How long measuring took; null: no pair came.")
    recording: str = Field(description="The recording: set points, commands, readings, poses and events.")
