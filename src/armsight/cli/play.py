"""armsight play."""

from __future__ import annotations

import time
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from armsight.cli.command_ui import CommandUI
from armsight.cli.options import KNOWN_ARM, AsJson, OutFolder, quantity
from armsight.cli.robot import RobotName
from armsight.cli.servo import ARM, CAMERAS, DRAW_EVERY_S, LINE_EVERY_S
from armsight.cli.tables import figure
from armsight.units import MM, MS

if TYPE_CHECKING:
    from collections.abc import Callable

    from armsight.app.schemas.play import PlayOutput
    from armsight.control.play import PathSource, PlayProgress, WatchFigures
    from armsight.control.status import RobotStatus

WAY = "Way"
KEYS = "space: pause and go on; + and -: faster and slower by a tenth of the planned speed"
STEP = 0.1


def play(
    robot: RobotName,
    path: Annotated[Path, typer.Option(help="path.csv of the tip.")],
    out: OutFolder,
    arm: Annotated[
        Path | None,
        typer.Option(metavar="ARM", help=f"{KNOWN_ARM}, calibrated; needed unless the robot tells it."),
    ] = None,
    tip: Annotated[
        Path | None, typer.Option(help="tip.yaml of the tool, in flange axes. [default: the arm's tool frame]")
    ] = None,
    limits: Annotated[Path | None, typer.Option(help="limits.yaml: what the guard keeps. [default: its own]")] = None,
    override: Annotated[float, typer.Option(metavar="SHARE", help="Share of the planned speed, 0.01 to 1.")] = 1.0,
    weave: Annotated[
        str,
        typer.Option(help="none, sine:AMPLITUDE:WAVELENGTH or zigzag:AMPLITUDE:WAVELENGTH, m.", rich_help_panel=WAY),
    ] = "none",
    path_speed: Annotated[
        float, typer.Option(help="Speed along the path where it says none.", rich_help_panel=WAY, **quantity("m/s"))
    ] = 0.01,
    blend: Annotated[
        float, typer.Option(help="Length over which corners are rounded.", rich_help_panel=WAY, **quantity("m"))
    ] = 0.003,
    approach_speed: Annotated[
        float, typer.Option(help="Speed of the way to the path's start.", rich_help_panel=WAY, **quantity("m/s"))
    ] = 0.02,
    retract: Annotated[
        float,
        typer.Option(
            help="The start is neared from so far before it along the tool's axis.",
            rich_help_panel=WAY,
            **quantity("m"),
        ),
    ] = 0.05,
    keep_rotation: Annotated[
        bool, typer.Option("--keep-rotation", help="The tool keeps the rotation it has.", rich_help_panel=WAY)
    ] = False,
    frame: Annotated[str, typer.Option(help="Frame of the path: world or base.", rich_help_panel=WAY)] = "world",
    speed: Annotated[
        float, typer.Option(metavar="SHARE", help="Share of the limits' speeds, up to 1.", rich_help_panel=ARM)
    ] = 1.0,
    rig: Annotated[Path | None, typer.Option(help="rig.yaml of cameras that watch.", rich_help_panel=CAMERAS)] = None,
    target: Annotated[Path | None, typer.Option(help="target.yaml they see.", rich_help_panel=CAMERAS)] = None,
    handeye: Annotated[Path | None, typer.Option(help="handeye.yaml of them.", rich_help_panel=CAMERAS)] = None,
    left: Annotated[
        str | None, typer.Option(metavar="SRC", help="Left camera, camera:NAME.", rich_help_panel=CAMERAS)
    ] = None,
    right: Annotated[
        str | None, typer.Option(metavar="SRC", help="Right camera, camera:NAME.", rich_help_panel=CAMERAS)
    ] = None,
    image: Annotated[
        str | None, typer.Option(metavar="SRC", help="The one camera of a mirror rig.", rich_help_panel=CAMERAS)
    ] = None,
    latency: Annotated[
        float, typer.Option(help="From exposure to the frame in memory, s.", rich_help_panel=CAMERAS)
    ] = 0.03,
    exposure: Annotated[float | None, typer.Option(help="Exposure, s.", rich_help_panel=CAMERAS)] = None,
    stop_at: Annotated[
        float,
        typer.Option(
            help="Stop where the tip is seen so far from where it was told.", rich_help_panel=CAMERAS, **quantity("m")
        ),
    ] = 0.01,
    yes: Annotated[bool, typer.Option("--yes", help="Move without asking.")] = False,
    json: AsJson = False,
) -> None:
    """Run a path with the tip of the tool, through the guard. Ctrl-C brings the arm to rest.

    The whole way is checked first; before anything moves it is told in mm and degrees, and asked for.
    """
    with CommandUI(as_json=json) as face, ExitStack() as stack:
        from armsight.app.play.play_job import PlayJob
        from armsight.app.play.play_path import run_play
        from armsight.app.robot.jog_by_hand import listening

        job = PlayJob(
            robot=robot,
            path=path,
            out=out,
            arm=arm,
            limits=limits,
            tip=tip,
            rig=rig,
            target=target,
            handeye=handeye,
            left=left,
            right=right,
            image=image,
            exposure_s=exposure,
            latency_s=latency,
            frame=frame,
            weave=weave,
            override=override,
            path_speed_m_s=path_speed,
            blend_m=blend,
            approach_speed_m_s=approach_speed,
            retract_m=retract,
            keep_rotation=keep_rotation,
            speed=speed,
            stop_m=stop_at,
        )

        def confirm(question: str) -> bool:
            face.say(question)
            try:
                return yes or typer.confirm("Move?", err=True)
            except typer.Abort:  # nobody there to ask
                return False

        def begun(source: PathSource) -> None:
            face.say(KEYS)
            stack.enter_context(listening(key_actions(source)))

        done = run_play(job, confirm, PlayLine(face).show, face.progress("playing"), begun=begun)
        play_tables(face, done)
        face.result(done)


def key_actions(source: PathSource) -> dict[str, Callable[[], None]]:
    """Return what each key does."""

    def space() -> None:
        if source.progress.paused:
            source.resume()
        else:
            source.pause()

    def by(step: float) -> None:
        source.override = min(max(source.override + step, STEP), 1.0)

    return {" ": space, "+": lambda: by(STEP), "-": lambda: by(-STEP)}


class PlayLine:
    """One line on the terminal, drawn again and again; elsewhere a line now and then, and at every change of state."""

    def __init__(self, face: CommandUI) -> None:
        self._console = face.console
        self._told_s = 0.0
        self._before = ""

    def show(self, status: RobotStatus, at: PlayProgress, seen: WatchFigures | None) -> None:
        """Tell of a cycle."""
        now_s, state = time.monotonic(), f"{status.guard}{at.stage}{at.paused}{status.why.split(',')[0]}"
        every_s = DRAW_EVERY_S if self._console.is_terminal else LINE_EVERY_S
        if state == self._before and now_s - self._told_s < every_s:
            return
        self._told_s, self._before = now_s, state
        told = f"{status.guard.upper():9} {at.stage}{' (paused)' if at.paused else ''} {100.0 * at.share:.0f} %"
        told += f", {at.s_m / MM:.1f} of {at.length_m / MM:.1f} mm at {at.speed_m_s / MM:.1f} mm/s"
        if seen is not None and seen.last_m is not None:
            told += f", seen {seen.last_m / MM:.2f} mm off"
        told += f": {status.why}" if status.why else ""
        if self._console.is_terminal:
            width = self._console.width - 1
            self._console.print(told[:width].ljust(width), end="\r", markup=False, soft_wrap=True)
        else:
            self._console.print(told, markup=False, soft_wrap=True)


def play_tables(face: CommandUI, done: PlayOutput) -> None:
    """Print what playing came to."""
    face.say(
        f"{100.0 * done.share:.0f} % of {done.length_m / MM:.1f} mm in {done.took_s:.1f} s; {done.n_cycles} cycles, "
        f"{done.late} late, {done.missed} missed; ended by: {done.stopped_by}"
    )
    seen = done.measured
    if seen is not None and seen.rms_m is not None and seen.max_m is not None:
        face.say(
            f"the cameras saw the tip {figure(seen.rms_m / MM)} mm RMS from where it was told to be, "
            f"{figure(seen.max_m / MM)} mm at most, in {seen.n} frames (the arm lags by {seen.arm_lag_s / MS:.0f} ms)"
        )
    elif seen is not None:
        face.say(f"note: no frame showed the tip ({seen.n_lost} without the target): it was not watched")
    for why in done.holds:
        face.say(f"  it held: {why}")
    face.say(f"Recording: {done.recording}")
