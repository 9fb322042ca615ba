"""What the calibration of the timing returns."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Annotated

import numpy as np

from armsight.fields import Doc
from armsight.optics import Rig
from armsight.records import CameraTiming, NamedCovariance
from armsight.records.by_value import Saveable
from armsight.records.camera import CLOCK
from armsight.records.output import Output, figure, output
from armsight.records.result_parts import MEANING, BothCounts, BothPixels, BothSeconds, Verdict
from armsight.shown import Shown, Table, digits
from armsight.units import MS

GOOD_DELAY_S = 1e-3
"""At 0.5 m/s this is half a millimetre."""
GOOD_READOUT_S = 1e-3
LARGE_RESIDUAL_PX = 0.5
"""Lights are found to 0.02 to 0.1 px."""
UNEVEN, UNEVEN_PX = 4.0, 0.2
"""Residuals of one camera over the other's, and their size: exposures that are not at their stamps, by 2 ms at 0.4 m/s,
leave 0.33 px beside 0.04."""


@output
class TimingResult(Output, Saveable):
    """armsight calibrate timing.

    t_left = t_right + delay_s + 1e-6 drift_ppm t_right. given: the rig that was calibrated. covariance: of the names
    that std has.
    """

    given: Rig

    delay_s: Annotated[
        float, Doc("t_left = t_right + delay_s + 1e-6 drift_ppm t_right turns the right stamps into left ones, s.")
    ]
    drift_ppm: Annotated[float, Doc("How much faster the left camera's clock runs, parts in a million.")]
    readout_s: Annotated[BothSeconds, Doc("From the first line's exposure to the last one's; 0: global shutter.")]
    jitter_s: Annotated[BothSeconds, Doc("Standard deviation of a single stamp about the camera's steady clock.")]
    period_s: Annotated[BothSeconds, Doc("From frame to frame, by the camera's own stamps.")]
    covariance: NamedCovariance
    n_frames: Annotated[int, Doc("Frames of both cameras together.")]
    lost: Annotated[BothCounts, Doc("Frames missing, recognised from the spacing of the stamps.")]
    middle_s: Annotated[float, Doc("Right stamp in the middle of the recording, where the delay is known best, s.")]
    common_s: Annotated[float, Doc("How long both cameras saw the lights, s.")]
    residual_px: Annotated[BothPixels, Doc("RMS residual of a spot's coordinate.")]
    lights: Annotated[tuple[str, ...], Doc("Lights used.")]

    @figure(
        "Standard deviations by name: delay_s, drift_ppm, left.readout_s, right.readout_s, left.jitter_s, "
        "right.jitter_s."
    )
    def std(self) -> dict[str, float]:
        return self.covariance.std()

    @figure("Standard deviation of t_left there, s.")
    def std_middle_s(self) -> float:
        return float(self.cameras()[1].clock_std_s([self.middle_s])[0])

    @property
    def rig(self) -> Rig:
        """The rig with its cameras' timing; exposures that it knew of are kept."""
        left, right = (
            found if before is None else replace(found, exposure_s=before.exposure_s)
            for found, before in zip(self.cameras(), self.given.timing, strict=True)
        )
        return self.given.with_each(timing=(left, right))

    def cameras(self) -> tuple[CameraTiming, CameraTiming]:
        """Return the timing of the left and the right camera as files hold it."""
        names = ("left.readout_s", "left.jitter_s")
        left = CameraTiming(readout_s=self.readout_s[0], jitter_s=self.jitter_s[0], covariance=self._named(names))
        right = CameraTiming(
            readout_s=self.readout_s[1],
            jitter_s=self.jitter_s[1],
            delay_s=self.delay_s,
            drift_ppm=self.drift_ppm,
            covariance=self._named((*CLOCK, "right.readout_s", "right.jitter_s")),
        )
        return left, right

    def _named(self, names: tuple[str, ...]) -> NamedCovariance:
        short = tuple(name.rpartition(".")[2] for name in names)
        return NamedCovariance(names=short, matrix=np.array(self.covariance.block(names)))

    @figure("What would make the result surer.")
    def advice(self) -> tuple[str, ...]:
        std, out = self.std, []
        if max(self.residual_px) > LARGE_RESIDUAL_PX:
            out.append(
                f"{max(self.residual_px):.2g} px RMS remain: check that rig.yaml is of these cameras as they stand "
                "now, and that exposures are short"
            )
        elif max(self.residual_px) > max(UNEVEN * min(self.residual_px), UNEVEN_PX):
            side = "left" if self.residual_px[0] > self.residual_px[1] else "right"
            out.append(
                f"{max(self.residual_px):.2g} px RMS remain in the {side} view beside {min(self.residual_px):.2g}: its "
                "frames are not exposed when their stamps say, and the standard deviations do not hold; record with "
                "the camera's own stamps"
            )
        if self.std_middle_s > GOOD_DELAY_S:
            out.append(
                f"the delay is known to {1e3 * self.std_middle_s:.2g} ms only: wave faster, and up and down as well, "
                "for 20 s"
            )
        if max(std["left.readout_s"], std["right.readout_s"]) > GOOD_READOUT_S:
            difference = self.covariance.block(("left.readout_s", "right.readout_s"))
            apart = float(np.sqrt(max(difference[0, 0] + difference[1, 1] - 2.0 * difference[0, 1], 0.0)))
            firm = "; their difference is firm" if apart <= GOOD_READOUT_S else ""
            known = " and ".join(f"{1e3 * std[f'{side}.readout_s']:.2g}" for side in ("left", "right"))
            out.append(
                f"the read-outs are known to {known} ms only{firm}: wave a target of three lights, up and down, "
                "over the whole height of both images"
            )
        return tuple(out)

    @figure("Whether the result can be trusted, in words.")
    def verdict(self) -> str:
        weak = self.verdict_.level != "good"
        return f"weak: {'; '.join(self.advice)}" if weak else f"good: clocks to {1e3 * self.std_middle_s:.2g} ms"

    @figure(MEANING, optional=True)
    def verdict_(self) -> Verdict:
        said = f"The clocks are known to each other to {1e3 * self.std_middle_s:.2g} ms (one standard deviation)."
        if self.advice:
            return Verdict(level="care", headline="Weak", reasons=[said], next=[f"{self.advice[0]}."])
        todo = "Use it; calibrate again when a camera's rate, exposure or resolution was changed."
        return Verdict(level="good", headline="Good", reasons=[said], next=[todo])

    def summary(self) -> Iterator[Shown]:
        """Yield the cameras' times, the clocks, and what they rest on."""
        std, sides = self.std, ("left", "right")
        rows = [
            [what, *(f"{digits(getattr(b, s) / MS, 4)} +- {digits(std[f'{s}.{key}'] / MS, 2)}" for s in sides)]
            for what, b, key in (("read-out ms", self.readout_s, "readout_s"), ("jitter ms", self.jitter_s, "jitter_s"))
        ]
        rows.append(["period ms", *(digits(getattr(self.period_s, s) / MS, 6) for s in sides)])
        rows.append(["frames lost", str(self.lost.left), str(self.lost.right)])
        yield Table("Cameras", ["", *sides], rows)
        shift = (self.delay_s + 1e-6 * self.drift_ppm * self.middle_s) / MS
        rows = [
            ["delay ms", f"{self.delay_s / MS:.3f}", digits(std["delay_s"] / MS, 2)],
            ["drift ppm", f"{self.drift_ppm:.2f}", digits(std["drift_ppm"], 2)],
            [f"t_left - t_right ms, at {self.middle_s:.1f} s", f"{shift:.3f}", digits(self.std_middle_s / MS, 2)],
        ]
        yield Table("Right stamps to left ones", ["", "", "+-"], rows)
        yield f"{self.n_frames} frames, {self.common_s:.1f} s seen by both cameras, lights: {', '.join(self.lights)}"
        yield f"Residual {digits(self.residual_px.left)} and {digits(self.residual_px.right)} px RMS"
        yield f"Verdict: {self.verdict}"
