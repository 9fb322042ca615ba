"""armsight verify --live and armsight verify --mastering: their options, added to those of verify."""

from __future__ import annotations

import functools
import inspect
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import typer

from armsight.cli.camera_options import OPTIONS as CAMERA_OPTIONS
from armsight.cli.camera_options import CameraOptions
from armsight.cli.command_ui import CommandUI
from armsight.cli.tables import figure
from armsight.errors import UsageError
from armsight.units import DEG, MM

if TYPE_CHECKING:
    from armsight.records import TargetPose
    from armsight.verify.results import VerifyLiveOutput
    from armsight.verify.supervision import Compared, Level

LIVE, MASTERING = "With --live", "With --mastering"
LINE_EVERY_S, DRAW_EVERY_S = 5.0, 0.1
"""How often the line is told where there is no terminal, and drawn where there is one."""


def _option(*flags: str, panel: str = LIVE, **more: Any) -> Any:
    return typer.Option(*flags, rich_help_panel=panel, **more)


LIVE_OPTIONS: dict[str, tuple[Any, Any]] = {
    "live": (
        Annotated[
            bool, _option("--live", help="Supervise a running arm before two live cameras, with --arm, --world.")
        ],
        False,
    ),
    "robot": (
        Annotated[str | None, _option("--robot", metavar="DRIVER:DEVICE", help="Whose joints are read.")],
        None,
    ),
    "left": (Annotated[str | None, _option("--left", metavar="SRC", help="The left camera: camera:NAME.")], None),
    "right": (Annotated[str | None, _option("--right", metavar="SRC", help="The right camera.")], None),
    "rig": (Annotated[Path | None, _option("--rig", help="rig.yaml of the two cameras.")], None),
    "target": (Annotated[Path | None, _option("--target", help="target.yaml of the lights on the tool.")], None),
    "warn_mm": (Annotated[float | None, _option("--warn-mm", help="Error of place that warns.")], None),
    "stop_mm": (Annotated[float | None, _option("--stop-mm", help="Error of place that stops the robot.")], None),
    "warn_deg": (Annotated[float | None, _option("--warn-deg", help="Error of rotation that warns.")], None),
    "stop_deg": (Annotated[float | None, _option("--stop-deg", help="Error of rotation that stops the robot.")], None),
    "stop_blind": (
        Annotated[float | None, _option("--stop-blind", metavar="S", help="Stop where nothing is seen for so long.")],
        None,
    ),
    "joint_std": (
        Annotated[
            float | None, _option("--joint-std", help="Of a joint reading, deg (a slide: m x 57). [default: 0.001]")
        ],
        None,
    ),
    "latency": (
        Annotated[float | None, _option("--latency", help="From exposure to frame in memory, s. [default: 0.03]")],
        None,
    ),
    "latency_std": (
        Annotated[float | None, _option("--latency-std", help="How well that is known, s. [default: 0.01]")],
        None,
    ),
    "seconds": (Annotated[float | None, _option("--seconds", min=0.0, help="End after so long.")], None),
    "frames": (Annotated[int | None, _option("--frames", min=1, help="End after so many pairs.")], None),
    "keep_frames": (Annotated[bool, _option("--keep-frames", help="Keep the images in the recording too.")], False),
    "play": (Annotated[bool, _option("--play", help="A simulated robot goes its scenario's way by itself.")], False),
}
MASTERING_OPTIONS: dict[str, tuple[Any, Any]] = {
    "mastering": (
        Annotated[
            bool,
            _option(
                "--mastering", panel=MASTERING, help="After a crash: propose ten poses; with --measured, judge them."
            ),
        ],
        False,
    ),
    "around": (
        Annotated[
            str | None,
            _option(
                "--around",
                panel=MASTERING,
                metavar="Q1,..,QN",
                help="Propose poses about these joints, rad or m (or 90deg).",
            ),
        ],
        None,
    ),
    "span": (
        Annotated[
            float | None,
            _option("--span", panel=MASTERING, help="How far joints may go from there, deg. [default: 30]"),
        ],
        None,
    ),
    "tool": (
        Annotated[
            str | None,
            _option(
                "--tool",
                panel=MASTERING,
                metavar="fixed|free",
                help="Whether the tool is known from before. [default: fixed with --world, else free]",
            ),
        ],
        None,
    ),
}
OPTIONS = {**LIVE_OPTIONS, **MASTERING_OPTIONS}
LIVE_KNOWN = {*LIVE_OPTIONS, *CAMERA_OPTIONS, "arm", "world", "out", "json"}
MASTERING_KNOWN = {*MASTERING_OPTIONS, "measured", "joints", "arm", "world", "rig", "target", "out", "json"}
NEEDED = ("robot", "left", "right", "rig", "target", "arm", "world", "out")


def with_live(command: Callable[..., None]) -> Callable[..., None]:
    """Give verify the options of --live; with it, the supervision runs in place of the command."""
    own, kinds = inspect.signature(command), get_type_hints(command, include_extras=True)
    added = {**OPTIONS, **{name: (kind, None) for name, kind in CAMERA_OPTIONS.items()}}
    parameters = [
        one.replace(
            kind=inspect.Parameter.KEYWORD_ONLY,
            annotation=kinds[name],
        )
        for name, one in own.parameters.items()
    ]
    parameters += [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=kind)
        for name, (kind, default) in added.items()
    ]

    @functools.wraps(command)
    def run(**given: Any) -> None:
        extra = {name: given.pop(name) for name in added}
        every = {**given, **extra}
        if extra["live"] or extra["mastering"]:
            known = LIVE_KNOWN if extra["live"] else MASTERING_KNOWN
            foreign = [name for name in every if name not in known and every[name] != added.get(name, ("", None))[1]]
            (_live if extra["live"] else _mastering)(every, foreign)
            return
        with CommandUI(as_json=bool(given.get("json"))):
            _check_plain({name: value for name, value in extra.items() if value != added[name][1]})
        command(**given)

    run.__signature__ = own.replace(parameters=parameters)  # type: ignore[attr-defined]  # a wrapper's own parameters
    run.__annotations__ = {one.name: one.annotation for one in parameters}
    return run


def flag(name: str) -> str:
    """Return an option as it is written."""
    return "--" + name.replace("_", "-")


def _check_plain(extra: Mapping[str, Any]) -> None:
    """Raise UsageError for options of the modes without one."""
    if extra:
        named = ", ".join(flag(name) for name in extra)
        raise UsageError(f"{named} only means something with --live or --mastering", cure="Add one, or leave it out")


def check_options(mode: str, given: Mapping[str, Any], needed: Sequence[str], foreign: Sequence[str]) -> None:
    """Raise UsageError where options are missing that a mode needs, or given that it knows nothing of."""
    missing = [flag(name) for name in needed if given[name] is None]
    if missing:
        raise UsageError(f"{mode} lacks something", cure=f"Give {', '.join(missing)} with it")
    odd = [flag(name) for name in foreign if given[name] not in (None, False)]
    if odd:
        raise UsageError(f"{', '.join(odd)} means nothing with {mode}", cure="Leave it away")


def _live(given: Mapping[str, Any], foreign: list[str]) -> None:
    until_stopped = given["frames"] is None and given["seconds"] is None
    with CommandUI(as_json=given["json"], until_stopped=until_stopped) as face:
        from armsight.app.verify.live import run_verify_live
        from armsight.app.verify.supervising import JOINT_STD, LATENCY_S, LATENCY_STD_S, LiveVerifyJob
        from armsight.verify.supervision import Limits

        check_options("--live", given, NEEDED, foreign)

        def scaled(name: str, unit: float) -> float | None:
            return None if given[name] is None else unit * given[name]

        def or_default(name: str, default: float, unit: float = 1.0) -> float:
            return default if given[name] is None else unit * given[name]

        job = LiveVerifyJob(
            **{name: given[name] for name in NEEDED},
            limits=Limits(
                warn_m=scaled("warn_mm", MM),
                stop_m=scaled("stop_mm", MM),
                warn_rad=scaled("warn_deg", DEG),
                stop_rad=scaled("stop_deg", DEG),
            ),
            joint_std=or_default("joint_std", JOINT_STD, DEG),
            latency_s=or_default("latency", LATENCY_S),
            latency_std_s=or_default("latency_std", LATENCY_STD_S),
            blind_stop_s=given["stop_blind"],
            frames=given["keep_frames"],
            limit=given["frames"],
            seconds_s=given["seconds"],
            play=given["play"],
            camera_settings=CameraOptions(**{name: given[name] for name in CAMERA_OPTIONS}).settings(),
        )
        line = LiveLine(face)
        done = run_verify_live(job, line.show, face.progress("supervising"))
        live_tables(face, done, job.out)
        face.result(done)


def _mastering(given: Mapping[str, Any], foreign: list[str]) -> None:
    with CommandUI(as_json=given["json"]) as face:
        from armsight.app.verify.mastering import MasteringJob, propose_mastering, run_mastering

        check_options("--mastering", given, ("arm", "out"), foreign)
        names = ("arm", "out", "world", "tool", "measured", "joints", "around", "rig", "target")
        span = {} if given["span"] is None else {"span_rad": DEG * given["span"]}
        job = MasteringJob(**{name: given[name] for name in names}, **span)
        if job.measured is None:
            plan = propose_mastering(job)
            rows = [
                [f"{k}", *(f"{value:.4f}" for value in pose.q), " ".join(pose.decides)]
                for k, pose in enumerate(plan.poses, 1)
            ]
            header = ["pose", *(f"q{i + 1}" for i in range(len(plan.poses[0].q))), "decides"]
            face.table("Poses to measure, rad or m", header, rows)
            for note in plan.notes:
                face.say(f"- {note}")
            face.say(f"Drive to each and measure there; then give --measured poses.csv --joints {plan.file}")
            face.result(plan)
            return
        done = run_mastering(job)
        rows = []
        for joint in done.joints:
            shown = [figure(None if v is None else v / DEG) for v in (joint.offset_rad, joint.std_rad)]
            rows.append([f"{joint.index} {joint.name}", *shown, joint.why])
        face.table("Zeros, each taken alone", ["joint", "deg", "+-", ""], rows)
        for left in done.rejected:
            face.say(f"  left out: row {left.row}: {left.why}")
        for text in done.doubts:
            face.say(f"  {text}")
        face.say(f"Cause: {done.cause}. {done.verdict}")
        face.say(f"Results: {job.out}; open {job.out / 'report.html'}")
        face.result(done)


class LiveLine:
    """One line on the terminal, drawn again and again; elsewhere a line now and then, and at every change of level."""

    def __init__(self, face: CommandUI) -> None:
        self._console = face.console
        self._told_s = 0.0
        self._before: tuple[int, bool] | None = None

    def show(self, pose: TargetPose, compared: Compared | None, level: Level, lost: str) -> None:
        """Tell of a pair."""
        now_s, state = time.monotonic(), (int(level), bool(lost))
        every_s = DRAW_EVERY_S if self._console.is_terminal else LINE_EVERY_S
        if state == self._before and now_s - self._told_s < every_s:
            return
        self._told_s, self._before = now_s, state
        told = f"{pose.t_s:9.3f} s  "
        if compared is None:
            told += f"LOST  {lost}"
        else:
            place, turn = (
                (compared.error_m / MM, compared.std_m / MM),
                (compared.error_rad / DEG, compared.std_rad / DEG),
            )
            told += f"{level.word.upper():4}  {place[0]:.3f} +- {place[1]:.3f} mm  {turn[0]:.3f} +- {turn[1]:.3f} deg"
        if self._console.is_terminal:
            width = self._console.width - 1
            self._console.print(told[:width].ljust(width), end="\r", markup=False, soft_wrap=True)
        else:
            self._console.print(told, markup=False, soft_wrap=True)


def live_tables(face: CommandUI, done: VerifyLiveOutput, out: Path) -> None:
    """Print what a supervision came to."""
    for alarm in done.alarms:
        face.say(f"  {alarm.t_s:.3f} s: {alarm.why}")
    rate = "-" if done.rate_hz is None else f"{done.rate_hz:.1f} a second"
    ms = "" if done.decision_ms is None else f"; decided in {figure(done.decision_ms.median)} ms (median)"
    face.say(
        f"{done.n} pairs, {rate}: {done.n_compared} compared, {done.n_lost} without the target, {done.n_stale} without "
        f"joints, {done.missed} never came{ms}"
    )
    if done.errors.rms_m is not None and done.errors.std_m is not None:
        face.say(
            f"Error of place {figure(done.errors.rms_m / MM)} mm RMS, of which noise explains "
            f"{figure(done.errors.std_m / MM)} mm; the decision's clock begins with a frame in memory"
        )
    for text in done.doubts:
        face.say(f"  {text}")
    face.say(done.verdict)
    face.say(f"Results: {out}; open {out / 'report.html'}")
