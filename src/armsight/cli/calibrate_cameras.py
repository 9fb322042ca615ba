"""armsight calibrate camera, stereo, zoom-rig, mirrors, target and timing."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from armsight.app import requests
from armsight.cli.actions import add_action
from armsight.cli.command import calibrate, command
from armsight.cli.command_ui import CommandUI
from armsight.cli.tables import (
    camera_tables,
    figure,
    show,
    stereo_tables,
    zoom_rig_tables,
    zoom_tables,
)
from armsight.errors import UsageError
from armsight.ops.calibrate_cameras import calibrate_target, calibrate_timing
from armsight.shown import REJECTED_SHOWN
from armsight.units import MM

if TYPE_CHECKING:
    from armsight.app.calibrate.results import CheckedAlignment, MirrorAlignment, MirrorCheckOutput, MirrorsOutput

MRAD = 1e-3


@command(calibrate, filed="calibrate camera", judged=True)
def camera(face: CommandUI, job: requests.calibrate_cameras.CameraJob) -> None:
    """Find one camera's focal lengths, centre and distortion from images of a printed board, and its noise.

    --every and --frames are of the board's images; without them of the still frames.
    """
    from armsight.app.calibrate.camera_noise import run_noise
    from armsight.app.calibrate.cameras import calibrate_camera
    from armsight.calibrate.camera_noise.photon_transfer import noise_shown

    if job.noise is not None and job.noise_alone:
        how = {"side": job.side, "every": job.every, "limit": job.limit, "settings": job.asked}
        found = run_noise(job.noise, job.out, **how, progress=face.progress("calibrating"))  # type: ignore[arg-type]
        show(face, found.summary())
        face.say(f"Written: {job.out}")
        face.result(found)
        return
    _require_board(job)
    done = calibrate_camera(replace(job, workers=workers(job.workers)), face.progress("calibrating"))
    camera_tables(face, done, job.out)
    for line in done.advice:
        face.say(f"- {line}")
    if done.zoom is not None:
        zoom_tables(face, done.zoom)
    if done.noise is not None:
        show(face, noise_shown(done.noise))
        face.say(f"Written: {job.out}")
    face.result(done)


def workers(given: int | None) -> int | None:
    """Return how many threads read images: as given, else as the settings have it."""
    from armsight.config import load_settings

    return load_settings().workers if given is None else given


def _require_board(job: requests.calibrate_cameras.CameraJob) -> None:
    """Raise UsageError where a camera is to be calibrated from half of what that takes."""
    if not job.source or not job.board:
        raise UsageError(
            "the board, --board, is not given" if job.source else "the images of the board, SRC, are not given",
            cure="Give SRC and --board; or --noise FRAMES alone, with the file to add to as -o",
        )
    if job.side is not None:
        raise UsageError("--side is of a rig.yaml, and a board's images make a camera.yaml", cure="Leave --side away")


@command(calibrate, filed="calibrate stereo", judged=True)
def stereo(face: CommandUI, job: requests.calibrate_cameras.StereoJob) -> None:
    """Find both cameras of a pair and where they stand to each other, from pairs of images of a printed board."""
    from armsight.app.calibrate.cameras import calibrate_stereo

    done = calibrate_stereo(replace(job, workers=workers(job.workers)), face.progress("calibrating"))
    stereo_tables(face, done, job.out)
    for line in done.advice:
        face.say(f"- {line}")
    face.result(done)


@command(calibrate)
def zoom_rig(face: CommandUI, job: requests.calibrate_cameras.ZoomRigJob) -> None:
    """Give a calibrated rig the settings of its zoom lenses: `measure --zoom-left --zoom-right` then takes any of them.

    The right camera's place, found at one setting of each lens, holds for all of them.
    """
    from armsight.app.calibrate.zoom import zoom_rig as run

    done = run(job)
    zoom_rig_tables(face, done, job.out)
    face.result(done)


@command(calibrate, filed="calibrate mirrors")
def mirrors(face: CommandUI, job: requests.calibrate_cameras.MirrorsJob) -> None:
    """Calibrate a rig of one camera and four mirrors, or check that its mirrors still stand as they did."""
    from armsight.app.calibrate.cameras import report_path
    from armsight.app.calibrate.mirrors import run_mirrors
    from armsight.app.calibrate.mirrors_check import run_check

    job = replace(job, workers=workers(job.workers))
    if job.check:
        found = run_check(job, face.progress("checking"))
        check_tables(face, found)
        face.result(found)
        return
    done = run_mirrors(job, face.progress("calibrating"))
    if job.out is not None:
        stereo_tables(face, done, job.out) if job.target is None else lit_table(face, done)
        alignment_tables(face, done)
        face.say(f"Written: {job.out}; open {report_path(job.out)}")
    face.result(done)


def lit_table(face: CommandUI, done: MirrorsOutput) -> None:
    """Print a rig's calibration from the lit target, with the commonest reasons of images left out."""
    from armsight.app.calibrate.mirrors_lit_target import reasons
    from armsight.records import NotSeen

    rows = [
        ["baseline, mm", figure(done.baseline_m / MM, 6)],
        ["baseline +-, mm", figure(done.std["baseline_m"] / MM, 2)],
        ["reprojection, px RMS", figure(done.rms_px)],
        ["epipolar, px RMS", figure(done.epipolar_rms_px)],
    ]
    face.table(f"Rig, {done.n_used} of {done.n_pairs} images", ["", ""], rows)
    for seen, count in reasons([NotSeen(one.why) for one in done.rejected])[:REJECTED_SHOWN]:
        face.say(f"  {count} left out: {seen.why}")


def alignment_tables(face: CommandUI, done: MirrorsOutput) -> None:
    """Print how the virtual cameras of a calibrated rig stand to each other, its plate, and what to do."""
    plate = done.alignment.plate
    rows = [
        *_alignment_rows(done.alignment),
        ["plate, mm", figure(plate.thickness_m / MM)],
        ["its shift m = l, mm", figure(plate.m_m / MM)],
    ]
    face.table("Alignment", ["", ""], rows)
    for line in done.advice:
        face.say(f"- {line}")


def check_tables(face: CommandUI, found: MirrorCheckOutput) -> None:
    """Print how the virtual cameras stand to each other now, and which mirror to turn."""
    face.table("Alignment", ["", ""], _alignment_rows(found.alignment))
    if found.turns:
        rows = [
            [f"mirror {one.mirror}", figure(one.turn_rad / MRAD), figure(one.tilt_rad / MRAD)] for one in found.turns
        ]
        face.table("Turns that make the axes parallel", ["", "about the vertical, mrad", "across, mrad"], rows)
    if found.suspects:
        rows = [
            [f"mirror {one.mirror}", figure(one.turn_rad / MRAD), figure(one.tilt_rad / MRAD), figure(one.chi2)]
            for one in found.suspects
        ]
        face.table("Which mirror has moved", ["", "about the vertical, mrad", "across, mrad", "chi-square left"], rows)
    for line in found.advice:
        face.say(f"- {line}")


def _alignment_rows(found: MirrorAlignment | CheckedAlignment) -> list[list[str]]:
    return [
        ["axes turn towards each other, mrad", figure(found.convergence_rad / MRAD)],
        ["right image lower, px", figure(found.vertical_px)],
        ["right image turned, mrad", figure(found.roll_rad / MRAD)],
    ]


add_action(calibrate, calibrate_target, judged=True)
add_action(calibrate, calibrate_timing, in_place=True, judged=True)
