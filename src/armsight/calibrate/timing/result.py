"""What the calibration of the timing returns."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Annotated

import numpy as np

from armsight.fields import Doc
from armsight.optics import SIDES, Rig
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


def time_names(names: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names of what is fitted of cameras: delay and drift of all but the first, of which left and right
    need not say whose they are, and the read-outs."""
    whose = {name: "" if names == SIDES else f"{name}." for name in names}
    return (*(f"{whose[name]}{key}" for name in names[1:] for key in CLOCK), *(f"{name}.readout_s" for name in names))


FORETOLD = 2.0
"""What a path through the other cameras' views leaves of one camera's, over its own residuals: 1.0 to 1.3 of an exact
rig."""


@output
class CameraClock(Output):
    """When a camera of a rig exposes, by the clock of the rig's first one."""

    delay_s: Annotated[
        float, Doc("t_first = t + delay_s + 1e-6 drift_ppm t turns its stamps t into the first camera's, s.")
    ]
    drift_ppm: Annotated[float, Doc("How much faster the first camera's clock runs, parts in a million.")]
    readout_s: Annotated[float, Doc("From the first line's exposure to the last one's; 0: global shutter.")]
    jitter_s: Annotated[float, Doc("Standard deviation of a single stamp about the camera's steady clock.")]
    period_s: Annotated[float, Doc("From frame to frame, by the camera's own stamps.")]
    lost: Annotated[int, Doc("Frames missing, recognised from the spacing of the stamps.")]
    middle_s: Annotated[float, Doc("Its stamp in the middle of the recording, where the delay is known best, s.")]
    std_middle_s: Annotated[float, Doc("Standard deviation of t_first there, s.")]
    common_s: Annotated[float, Doc("From its first view of a light that another camera saw too to its last one, s.")]
    wider: Annotated[
        float, Doc("By how much std_middle_s is wider because residuals hang together over time; 1: they do not.")
    ]
    residual_px: Annotated[float, Doc("RMS residual of a spot's coordinate.")]
    left_out_px: Annotated[
        float | None,
        Doc("The same of stretches of its views left out of the fit by turns, while two others looked on."),
    ]


@output
class _Timing(Output, Saveable):
    """given: the rig that was calibrated. clocks: of each camera, in its order. covariance: of the names in std."""

    given: Rig
    clocks: dict[str, CameraClock]
    covariance: NamedCovariance

    @property
    def rig(self) -> Rig:
        """The rig with its cameras' timing; exposures that it knew of are kept, and cameras of which nothing is
        known."""
        found = dict(zip(self.clocks, self.cameras(), strict=True))
        return self.given.with_each(
            timing=[
                one.timing
                if one.name not in found
                else found[one.name]
                if one.timing is None
                else replace(found[one.name], exposure_s=one.timing.exposure_s)
                for one in self.given.cameras
            ]
        )

    def cameras(self) -> tuple[CameraTiming, ...]:
        """Return the timing of each camera as files hold it."""
        names, out = tuple(self.clocks), []
        clocks = iter(time_names(names)[: -len(names)])
        for k, (name, one) in enumerate(self.clocks.items()):
            whose = (*((next(clocks), next(clocks)) if k else ()), f"{name}.readout_s", f"{name}.jitter_s")
            short = tuple(each.rpartition(".")[2] for each in whose)
            covariance = NamedCovariance(names=short, matrix=np.array(self.covariance.block(whose)))
            times = {"readout_s": one.readout_s, "jitter_s": one.jitter_s}
            out.append(CameraTiming(delay_s=one.delay_s, drift_ppm=one.drift_ppm, covariance=covariance, **times))
        return tuple(out)

    @figure("Standard deviations by name: of delay_s and drift_ppm, readout_s and jitter_s of each camera.")
    def std(self) -> dict[str, float]:
        return self.covariance.std()

    @figure("Standard deviation of the least known clock against the first one, in the middle of the recording, s.")
    def std_middle_s(self) -> float:
        return max(one.std_middle_s for one in self.clocks.values())

    @figure("What would make the result surer.")
    def advice(self) -> tuple[str, ...]:
        each, out = self.clocks, []
        pair = tuple(each) == SIDES
        residual = {name: one.residual_px for name, one in each.items()}
        most, least = max(residual.values()), min(residual.values())
        if most > LARGE_RESIDUAL_PX:
            out.append(
                f"{most:.2g} px RMS remain: check that rig.yaml is of these cameras as they stand now, and that "
                "exposures are short"
            )
        elif most > max(UNEVEN * least, UNEVEN_PX):
            side = max(residual, key=residual.__getitem__)
            out.append(
                f"{most:.2g} px RMS remain in the {side} view beside {least:.2g}: its frames are not exposed when "
                "their stamps say, and the standard deviations do not hold; record with the camera's own stamps"
            )
        told = {name: one.left_out_px for name, one in each.items() if one.left_out_px is not None}
        odd = {name: px for name, px in told.items() if px > max(FORETOLD * residual[name], UNEVEN_PX)}
        if odd:
            side = max(odd, key=odd.__getitem__)
            out.append(
                f"views of {side} that were left out are foretold to {odd[side]:.2g} px beside {residual[side]:.2g}: "
                "rig.yaml, or what it takes for a light's middle, is less exact than the spots; calibrate the rig anew"
            )
        if self.std_middle_s > GOOD_DELAY_S:
            late = max(each, key=lambda name: each[name].std_middle_s)
            out.append(
                f"the delay{'' if pair else f' of {late}'} is known to {1e3 * self.std_middle_s:.2g} ms only: wave "
                "faster, and up and down as well, for 20 s"
            )
        return (*out, *self._of_rig(), *self._read_outs())

    def _of_rig(self) -> Iterator[str]:
        yield from ()

    def _read_outs(self) -> Iterator[str]:
        names, pair = tuple(f"{name}.readout_s" for name in self.clocks), tuple(self.clocks) == SIDES
        C = self.covariance.block(names)
        if np.sqrt(C.diagonal().max()) <= GOOD_READOUT_S:
            return
        apart = np.sqrt(np.maximum(C[0, 0] + C.diagonal() - 2.0 * C[0], 0.0)).max()
        differ = "their difference is firm" if pair else "their differences are firm"
        known = " and ".join(f"{1e3 * self.std[name]:.2g}" for name in names)
        yield (
            f"the read-outs are known to {known} ms only{f'; {differ}' if apart <= GOOD_READOUT_S else ''}: wave a "
            f"target of three lights, up and down, over the whole height of {'both' if pair else 'all'} images"
        )

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


@output
class CamerasTiming(_Timing):
    """armsight calibrate timing --camera: of other cameras than left and right."""

    clocks: Annotated[dict[str, CameraClock], Doc("Clock and shutter of each camera.", key="cameras")]
    n_frames: Annotated[int, Doc("Frames of all cameras together.")]
    lights: Annotated[tuple[str, ...], Doc("Lights used.")]
    rig_off: Annotated[
        float, Doc("By how many standard deviations of its own the rig is off, and is taken to be; 1: within them.")
    ]

    def _of_rig(self) -> Iterator[str]:
        if self.rig_off > 1.0:
            yield (
                f"the lights pull the cameras {self.rig_off:.1f} standard deviations of rig.yaml off, which widens all "
                "that is claimed: calibrate the rig anew as it stands now"
            )

    def summary(self) -> Iterator[Shown]:
        """Yield the cameras' clocks and shutters, and what they rest on."""
        std, rows, first = self.std, [], next(iter(self.clocks))
        for name, one in self.clocks.items():
            shift = (one.delay_s + 1e-6 * one.drift_ppm * one.middle_s) / MS
            clock = [f"{shift:.3f} +- {digits(one.std_middle_s / MS, 2)}", f"{one.middle_s:.1f}"]
            drift = f"{one.drift_ppm:.2f} +- {digits(std.get(f'{name}.drift_ppm'), 2)}"
            read = f"{digits(one.readout_s / MS, 4)} +- {digits(std[f'{name}.readout_s'] / MS, 2)}"
            px = [digits(one.residual_px), digits(one.left_out_px)]
            own = ["", "", ""] if name == first else [*clock, drift]
            rows.append([name, *own, read, digits(one.jitter_s / MS, 2), f"{one.common_s:.1f}", str(one.lost), *px])
        head = [f"t_{first} - t, ms", "at s", "drift, ppm", "read-out, ms", "jitter, ms", "common, s", "lost"]
        yield Table("Clocks", ["camera", *head, "px RMS", "left out"], rows)
        yield f"{self.n_frames} frames, lights: {', '.join(self.lights)}"
        if self.given.covariance is None:
            yield "rig.yaml has no covariance: the rig is taken as exact"
        yield f"Verdict: {self.verdict}"


@output
class TimingResult(_Timing):
    """armsight calibrate timing.

    t_left = t_right + delay_s + 1e-6 drift_ppm t_right.
    """

    delay_s: Annotated[
        float, Doc("t_left = t_right + delay_s + 1e-6 drift_ppm t_right turns the right stamps into left ones, s.")
    ]
    drift_ppm: Annotated[float, Doc("How much faster the left camera's clock runs, parts in a million.")]
    readout_s: Annotated[BothSeconds, Doc("From the first line's exposure to the last one's; 0: global shutter.")]
    jitter_s: Annotated[BothSeconds, Doc("Standard deviation of a single stamp about the camera's steady clock.")]
    period_s: Annotated[BothSeconds, Doc("From frame to frame, by the camera's own stamps.")]
    n_frames: Annotated[int, Doc("Frames of both cameras together.")]
    lost: Annotated[BothCounts, Doc("Frames missing, recognised from the spacing of the stamps.")]
    middle_s: Annotated[float, Doc("Right stamp in the middle of the recording, where the delay is known best, s.")]
    common_s: Annotated[float, Doc("How long both cameras saw the lights, s.")]
    residual_px: Annotated[BothPixels, Doc("RMS residual of a spot's coordinate.")]
    lights: Annotated[tuple[str, ...], Doc("Lights used.")]

    @figure("Standard deviation of t_left there, s.")
    def std_middle_s(self) -> float:
        return self.clocks["right"].std_middle_s

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
