"""armsight servo."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from armsight.cli.command_ui import CommandUI
from armsight.cli.options import KNOWN_ARM, AsJson, OutFolder, quantity
from armsight.cli.robot import RobotName
from armsight.cli.tables import figure
from armsight.units import DEG, MM, MS

if TYPE_CHECKING:
    from armsight.app.schemas.servo import ServoOutput
    from armsight.control.status import RobotStatus

LINE_EVERY_S, DRAW_EVERY_S = 5.0, 0.1
"""How often the line is told where there is no terminal, and drawn where there is one."""
CAMERAS, ARM, SIMULATED = "Cameras", "Arm and guard", "Simulated cell"


def servo(
    robot: RobotName,
    rig: Annotated[Path, typer.Option(help="rig.yaml of the cameras.")],
    target: Annotated[Path, typer.Option(help="target.yaml of the lights that are followed.")],
    handeye: Annotated[Path, typer.Option(help="handeye.yaml: where the cameras are, on the flange or on the base.")],
    out: OutFolder,
    distance: Annotated[
        float, typer.Option(help="How far along that axis the target is wanted.", **quantity("m"))
    ] = 0.6,
    at: Annotated[str, typer.Option(help="Whose axis the target is wanted on: camera or tool.")] = "camera",
    gain: Annotated[
        float | None, typer.Option(help="Gain in 1/s. [default: the largest without overshoot at the measured delay]")
    ] = None,
    rotation: Annotated[
        str,
        typer.Option(
            metavar="align|keep|hold",
            help="align: turn until the target's axes are those of --at. keep: as the target first stood to it. "
            "hold: do not turn.",
        ),
    ] = "align",
    no_prediction: Annotated[
        bool, typer.Option("--no-prediction", help="The law alone, which lags behind by speed over gain.")
    ] = False,
    seconds: Annotated[float | None, typer.Option(help="End after so long. [default: Ctrl-C]")] = None,
    left: Annotated[
        str | None, typer.Option(metavar="SRC", help="Left camera, camera:NAME.", rich_help_panel=CAMERAS)
    ] = None,
    right: Annotated[
        str | None, typer.Option(metavar="SRC", help="Right camera, camera:NAME.", rich_help_panel=CAMERAS)
    ] = None,
    image: Annotated[
        str | None,
        typer.Option(metavar="SRC", help="The one camera of a mirror rig, camera:NAME.", rich_help_panel=CAMERAS),
    ] = None,
    latency: Annotated[
        float, typer.Option(help="From exposure to the frame in memory, s.", rich_help_panel=CAMERAS)
    ] = 0.03,
    exposure: Annotated[float | None, typer.Option(help="Exposure, s.", rich_help_panel=CAMERAS)] = None,
    arm: Annotated[
        Path | None,
        typer.Option(metavar="ARM", help=f"{KNOWN_ARM}; needed unless the robot tells it.", rich_help_panel=ARM),
    ] = None,
    limits: Annotated[
        Path | None, typer.Option(help="limits.yaml: what the guard keeps. [default: its own]", rich_help_panel=ARM)
    ] = None,
    speed: Annotated[
        float, typer.Option(metavar="SHARE", help="Share of the limits' speeds, up to 1.", rich_help_panel=ARM)
    ] = 1.0,
    arm_lag: Annotated[
        float | None,
        typer.Option(help="From a command to the arm's motion, s. [default: two cycles]", rich_help_panel=ARM),
    ] = None,
    resume_mm: Annotated[
        float, typer.Option(help="A target that jumped is followed again by itself so near to where it would be.")
    ] = 20.0,
    resume_deg: Annotated[float, typer.Option(help="The same for its rotation.")] = 3.0,
    hand: Annotated[
        str | None,
        typer.Option(
            help="How the target is led: still, circle, trapezium or random. [default: as the scenario has it]",
            rich_help_panel=SIMULATED,
        ),
    ] = None,
    hand_speed: Annotated[float, typer.Option(help="How fast.", rich_help_panel=SIMULATED, **quantity("m/s"))] = 0.05,
    yes: Annotated[bool, typer.Option("--yes", help="Move without asking.")] = False,
    json: AsJson = False,
) -> None:
    """Follow a target that the cameras see, through the guard. Ctrl-C brings the arm to rest."""
    with CommandUI(as_json=json, until_stopped=seconds is None) as face:
        from armsight.app.servo.run_servo import run_servo
        from armsight.app.servo.servo_job import ServoJob

        job = ServoJob(
            robot=robot,
            rig=rig,
            target=target,
            handeye=handeye,
            out=out,
            left=left,
            right=right,
            image=image,
            at=at,
            distance_m=distance,
            gain=gain,
            rotation=rotation,
            predict=not no_prediction,
            arm=arm,
            limits=limits,
            speed=speed,
            arm_lag_s=arm_lag,
            latency_s=latency,
            exposure_s=exposure,
            seconds_s=seconds,
            hand=hand,
            hand_speed_m_s=hand_speed,
            resume_m=resume_mm * MM,
            resume_rad=resume_deg * DEG,
        )

        def confirm(question: str) -> bool:
            face.say(question)
            try:
                return yes or typer.confirm("Move?", err=True)
            except typer.Abort:  # nobody there to ask
                return False

        done = run_servo(job, confirm, ServoLine(face).show, face.progress("servo"))
        servo_tables(face, done)
        face.result(done)


class ServoLine:
    """One line on the terminal, drawn again and again; elsewhere a line now and then, and at every change of state."""

    def __init__(self, face: CommandUI) -> None:
        self._console = face.console
        self._told_s = 0.0
        self._before = ""

    def show(self, status: RobotStatus, error_m: float | None) -> None:
        """Tell of a cycle."""
        now_s, state = time.monotonic(), f"{status.guard}{status.why.split(',')[0]}"
        every_s = DRAW_EVERY_S if self._console.is_terminal else LINE_EVERY_S
        if state == self._before and now_s - self._told_s < every_s:
            return
        self._told_s, self._before = now_s, state
        told = f"{status.guard.upper():9} "
        told += (
            f"{error_m / MM:.2f} mm from where it is wanted" if error_m is not None and not status.why else status.why
        )
        if self._console.is_terminal:
            width = self._console.width - 1
            self._console.print(told[:width].ljust(width), end="\r", markup=False, soft_wrap=True)
        else:
            self._console.print(told, markup=False, soft_wrap=True)


def servo_tables(face: CommandUI, done: ServoOutput) -> None:
    """Print what a servo came to."""
    if done.gain.note:
        face.say(f"note: {done.gain.note}")
    face.say(
        f"{done.n_cycles} cycles, {done.late} late, {done.missed} missed; {done.n_frames} pairs of frames, {done.n_ok} "
        f"whole, {done.n_position_only} place only, {done.n_lost} without the target; ended by: {done.stopped_by}"
    )
    if done.error.rms_m is not None and done.error.max_m is not None and done.error.last_m is not None:
        face.say(
            f"followed in {100.0 * done.followed:.0f} % of the cycles; {figure(done.error.rms_m / MM)} mm RMS from "
            f"where it is wanted, {figure(done.error.max_m / MM)} mm at most, {figure(done.error.last_m / MM)} mm and "
            f"{figure((done.error.last_rad or 0.0) / DEG)} deg at the end"
        )
    for why in done.holds:
        face.say(f"  it held: {why}")
    face.say(
        f"gain {figure(done.gain.used)} 1/s; delay {done.delay.camera_s / MS:.0f} ms of the cameras, "
        f"{done.delay.arm_s / MS:.0f} ms of the arm. Recording: {done.recording}"
    )
