"""armsight calibrate camera, stereo, zoom-rig, mirrors, target and timing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from armsight.app import requests
from armsight.cli.actions import add_action, show
from armsight.cli.command import calibrate, command
from armsight.cli.command_ui import CommandUI
from armsight.cli.tables import figure
from armsight.ops.calibrate_cameras import calibrate_camera, calibrate_stereo, calibrate_zoom_rig
from armsight.ops.calibrate_rig import calibrate_target, calibrate_timing
from armsight.shown import REJECTED_SHOWN
from armsight.units import MM

if TYPE_CHECKING:
    from armsight.app.calibrate.results import CheckedAlignment, MirrorAlignment, MirrorCheckOutput, MirrorsOutput

MRAD = 1e-3


def noise_alone(face: CommandUI, asked: Mapping[str, Any]) -> bool:
    """Find a camera's noise where nothing else was given, and tell whether that is so."""
    if asked.get("noise") is None or any(asked.get(name) is not None for name in ("images", "board", "zoom")):
        return False
    from armsight.app.calibrate.camera_noise import run_noise
    from armsight.app.requests.calibrate_cameras import NoiseJob

    job = NoiseJob(
        frames=asked["noise"],
        out=asked["out"],
        side=asked.get("side"),
        every=asked["every"],
        limit=asked.get("frames"),
        camera_settings=asked["camera_settings"],
    )
    found = run_noise(job, face.progress("calibrating"))
    show(face, found, asked["out"])
    return True


@command(calibrate, filed="calibrate mirrors")
def mirrors(face: CommandUI, job: requests.calibrate_cameras.MirrorsJob) -> None:
    """Calibrate a rig of one camera and four mirrors, or check that its mirrors still stand as they did."""
    from armsight.app.calibrate.cameras import report_path
    from armsight.app.calibrate.mirrors import run_mirrors
    from armsight.app.calibrate.mirrors_check import run_check
    from armsight.config import load_settings

    job = replace(job, workers=load_settings().workers if job.workers is None else job.workers)
    if job.check:
        found = run_check(job, face.progress("checking"))
        check_tables(face, found)
        face.result(found)
        return
    done = run_mirrors(job, face.progress("calibrating"))
    if job.out is not None:
        stereo_lines(face, done, job.out) if job.target is None else lit_table(face, done)
        alignment_tables(face, done)
        face.say(f"Written: {job.out}; open {report_path(job.out)}")
    face.result(done)


def stereo_lines(face: CommandUI, done: MirrorsOutput, out: Path) -> None:
    """Print how well the two views fit."""
    for one in done.shown_fit():
        if isinstance(one, str):
            face.say(one.replace("{out}", str(out)))
        else:
            face.table(*one)


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


add_action(calibrate, calibrate_camera, noise_alone, filed="calibrate camera", judged=True)
add_action(calibrate, calibrate_stereo, filed="calibrate stereo", judged=True)
add_action(calibrate, calibrate_zoom_rig)
add_action(calibrate, calibrate_target, judged=True)
add_action(calibrate, calibrate_timing, in_place=True, judged=True)
