"""What the calibration of some cameras returns."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.calibrate.cameras.bundle_adjustment import BACK, DELAY, READOUT, poses_of_boards, residuals_px
from armsight.calibrate.cameras.calibrate import rms, view_rms
from armsight.calibrate.cameras.many import ManySolved
from armsight.calibrate.cameras.observations import Observations
from armsight.calibrate.cameras.outlier_rejection import named
from armsight.calibrate.cameras.pairing import as_pose
from armsight.calibrate.cameras.preconditions import images_doubted, images_verdict
from armsight.calibrate.cameras.result import FromBoards, left_out_words, std_by_key
from armsight.fields import Doc
from armsight.optics import Camera, Rig
from armsight.optics.mounted import MountedCamera
from armsight.records.output import Row, figure, output, with_std
from armsight.records.result_parts import MEANING, RejectedFile, Verdict
from armsight.shown import WRITTEN, Shown, Table, digits, rejected_lines
from armsight.units import MM


@output
class CamerasCalibration(FromBoards):
    """armsight calibrate cameras: a rig of some cameras, how sure it is, and what it rests on.

    rig: its covariance inside. solved: the fit. fixed: cameras that were there before and stayed as they were.
    """

    rms_px: Annotated[float, Doc("Reprojection residual of the fit, RMS, px.")]
    n_moments: Annotated[int, Doc("Moments read.")]
    n_used: Annotated[int, Doc("Moments that the result rests on.")]
    rejected: Annotated[tuple[RejectedFile, ...], Doc("Images left out.")]
    holdout_rms_px: Annotated[
        float | None, Doc("Reprojection residual on moments left out of the fit, or blocks of time, RMS, px.")
    ]
    advice: Annotated[tuple[str, ...], Doc("What would make the result surer.")]
    rig: Rig
    solved: ManySolved
    fixed: frozenset[str] = frozenset()

    @property
    def noun(self) -> str:
        """What is left out to see how well the rest foretells it."""
        return "moments"

    @property
    def used(self) -> Observations:
        """What went into the fit."""
        return self.solved.observations

    @property
    def cameras(self) -> dict[str, Camera]:
        """The cameras that saw the board, by name."""
        return self.solved.cameras

    @figure("Moments in which each camera saw the board.")
    def n_views(self) -> dict[str, int]:
        return dict(zip(self.used.cameras, (self.used.weight > 0.0).any(axis=2).sum(axis=0).tolist(), strict=True))

    @figure("Reprojection residual of each camera, RMS, px.")
    def camera_rms_px(self) -> dict[str, float]:
        seen, residual = self.used.weight > 0.0, residuals_px(self.used, self.solved.robust.fit)
        return {name: rms(residual[:, c], seen[:, c]) for c, name in enumerate(self.used.cameras)}

    @figure("Place of each camera in axes of the rig, m.")
    def position_m(self) -> dict[str, list[float]]:
        return {name: np.asarray(self.rig.T_rig_camera(name).translation).tolist() for name in self.rig.names}

    @figure("By how much each camera's clock is late behind the first one's, s; null where held at zero.")
    def delay_s(self) -> dict[str, float | None]:
        std = self.solved.covariance.std()
        found = zip(self.used.cameras, self.solved.delays_s.tolist(), strict=True)
        return {name: late if f"{name}.{DELAY}" in std else None for name, late in found}

    @figure("How long each camera takes from its first row to its last, s; null where held at zero.")
    def readout_s(self) -> dict[str, float | None]:
        std = self.solved.covariance.std()
        found = zip(self.used.cameras, self.solved.readouts_s.tolist(), strict=True)
        return {name: took if took or f"{name}.{READOUT}" in std else None for name, took in found}

    @figure("Of a board with two sides: the back's middle in axes of the front's, m.", optional=True)
    def back_m(self) -> list[float] | None:
        found = self.solved.state.back
        return found[:3].tolist() if len(found) else None

    @figure(
        "Standard deviations by name: NAME.fx_px ... NAME.k3, NAME.tx_m ... NAME.rz_rad, NAME.delay_s, NAME.readout_s."
    )
    def std(self) -> dict[str, float]:
        return std_by_key(self.solved.covariance)

    @figure(MEANING, optional=True)
    def verdict_(self) -> Verdict:
        found = (
            f"{self.n_used} of {self.n_moments} moments fit to {self.rms_px:.3g} px RMS{left_out_words(self)}; "
            f"{len(self.used.cameras)} cameras, {min(self.n_views.values())} to {max(self.n_views.values())} views each"
        )
        own = {name: uv for name, (uv, _) in self.clouds().items() if name not in self.solved.known}
        seen = {name: (self.cameras[name], uv) for name, uv in own.items()}
        doubts = images_doubted(self.n_used, self.n_moments, self.rms_px, self.holdout_rms_px, seen, noun="moments")
        return images_verdict(found, doubts, self.advice, squares=False, noun="moments")

    @property
    def sources(self) -> tuple[tuple[str, ...], ...]:
        """Names of the images of each moment used, those that there are."""
        return tuple(tuple(named(self.used, g).split(" / ")) for g in range(self.used.n_views))

    @property
    def view_rms_px(self) -> tuple[float, ...]:
        """RMS of each moment used."""
        return view_rms(residuals_px(self.used, self.solved.robust.fit), self.used.weight > 0.0)

    @property
    def T_first_board(self) -> Array:
        """Where the moments show the board (G, 4, 4), in axes of the first camera."""
        return poses_of_boards(self.used, self.solved.robust.fit)

    def clouds(self) -> dict[str, tuple[Array, Array]]:
        """Return every point used and its residual (n, 2), px, by camera."""
        residual, seen = residuals_px(self.used, self.solved.robust.fit), self.used.weight > 0.0
        each = enumerate(self.used.cameras)
        return {name: (self.used.uv[:, c][seen[:, c]], residual[:, c][seen[:, c]]) for c, name in each}

    @property
    def title(self) -> str:
        """What it is, in a few words."""
        return f"Rig of {len(self.rig.names)} cameras from {self.n_used} moments"

    def rows(self) -> list[Row]:
        """Return places, focal lengths and delays with standard deviations, and how well they fit."""
        rows: list[Row] = []
        for name, camera in self.cameras.items():
            rows.append((f"{name} fx", with_std(float(camera.intrinsics[0]), self.std.get(f"{name}.fx_px"), "px")))
            for axis, at in zip("xyz", self.position_m[name], strict=True):
                rows.append((f"{name} {axis}", with_std(at, self.std.get(f"{name}.t{axis}_m"), "mm", scale=1e3)))
            late = self.delay_s[name]
            if late is not None:
                rows.append((f"{name} late by", with_std(late, self.std.get(f"{name}.delay_s"), "ms", scale=1e3)))
            took = self.readout_s[name]
            if took is not None:
                rows.append((f"{name} read-out", with_std(took, self.std.get(f"{name}.readout_s"), "ms", scale=1e3)))
        return [*rows, *self._fit_rows()]

    def summary(self) -> Iterator[Shown]:
        """Yield the cameras, how well they fit, the images left out, and what would make it surer."""
        clocks = {"late by, ms": ("delay_s", self.delay_s), "read-out": ("readout_s", self.readout_s)}
        clocks = {head: (key, of) for head, (key, of) in clocks.items() if any(one is not None for one in of.values())}
        rows = []
        for name in self.used.cameras:
            place = [f"{at / MM:.2f}" for at in self.position_m[name]]
            spread = max((self.std.get(f"{name}.t{axis}_m", 0.0) for axis in "xyz"), default=0.0)
            lens = "stays" if name in self.fixed else "given" if name in self.solved.known else "found"
            seen = [str(self.n_views[name]), digits(self.camera_rms_px[name])]
            times = [_time_ms(of[name], self.std.get(f"{name}.{key}")) for key, of in clocks.values()]
            rows.append([name, lens, *seen, *place, digits(spread / MM, 2) if spread else "", *times])
        head = ["camera", "lens", "views", "px RMS", "x, mm", "y", "z", "+-", *clocks]
        yield Table(f"Rig of {len(self.rig.names)} cameras, {self.n_used} of {self.n_moments} moments", head, rows)
        if self.back_m is not None:
            doubt = max(self.std.get(f"{BACK}.t{axis}_m", 0.0) for axis in "xyz")
            behind = ", ".join(digits(at / MM) for at in self.back_m)
            yield f"The back's middle is at ({behind}) mm from the front's, +- {digits(doubt / MM, 2)} mm"
        yield f"Reprojection {digits(self.rms_px)} px RMS; {digits(self.holdout_rms_px)} px on left-out moments"
        yield from rejected_lines(self.rejected)
        yield WRITTEN
        yield from (f"- {text}" for text in self.advice)


def _time_ms(found_s: float | None, std_s: float | None) -> str:
    """Return a time in ms with its deviation; empty where it is held."""
    if found_s is None:
        return ""
    return f"{digits(1e3 * found_s)} +- {digits(None if std_s is None else 1e3 * std_s, 2)}"


def result_of(
    done: ManySolved, n_moments: int, rig: Rig | None = None, fixed: frozenset[str] = frozenset()
) -> CamerasCalibration:
    """Return the result of a fit to so many moments. rig: that it extended, in place of its own cameras alone."""
    overall = rms(residuals_px(done.observations, done.robust.fit), done.observations.weight > 0.0)
    return CamerasCalibration(
        rms_px=overall,
        n_moments=n_moments,
        n_used=done.observations.n_views,
        rejected=tuple(map(RejectedFile._make, done.rejected)),
        holdout_rms_px=done.holdout_rms_px,
        advice=done.advice,
        rig=rig_of(done, overall) if rig is None else rig,
        solved=done,
        fixed=fixed,
    )


def rig_of(done: ManySolved, rms_px: float) -> Rig:
    """Return the rig in axes of its first camera."""
    poses = [RigidTransform.identity(), *map(as_pose, done.state.sides)]
    mounted = [
        MountedCamera(name=name, camera=camera, T_rig_camera=T)
        for (name, camera), T in zip(done.cameras.items(), poses, strict=True)
    ]
    return Rig(cameras=mounted, covariance=done.of_cameras, rms_px=rms_px)
