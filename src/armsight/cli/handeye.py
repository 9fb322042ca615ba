"""armsight calibrate handeye, armsight calibrate tooltip."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from armsight.cli.camera_options import NONE_GIVEN, CameraOptions, takes_cameras
from armsight.cli.command_ui import CommandUI
from armsight.cli.options import BOARD, SRC, AsJson, Bits, Quantity, Strict, Workers, quantity
from armsight.cli.table_options import NOTHING_STATED, TableOptions, takes_tables
from armsight.cli.tables import figure, pose_rows, tip_rows
from armsight.errors import UsageError
from armsight.units import MM

if TYPE_CHECKING:
    from armsight.calibrate.handeye import HandEye, Setup
    from armsight.calibrate.tooltip_result import TipCalibration

POINT_SIGMA_MM = 0.2
"""Standard deviation believed of a measured point unless another is given: a dot measured by two cameras at 0.6 m."""


@takes_tables
def handeye(
    out: Annotated[Path, typer.Option("-o", "--out", help="handeye.yaml to write.")],
    pairs: Annotated[Path | None, typer.Option(help="pairs.csv: robot pose and camera pose in every row.")] = None,
    images: Annotated[str | None, typer.Option(metavar="SRC", help=f"Images of the board: {SRC}.")] = None,
    camera: Annotated[Path | None, typer.Option(help="camera.yaml of the camera that took the images.")] = None,
    board: Annotated[str | None, typer.Option(metavar="BOARD", help=BOARD)] = None,
    robot: Annotated[
        Path | None, typer.Option(help="robot_poses.csv: file,x_m,..,qw, T_base_flange per image.")
    ] = None,
    robot_stream: Annotated[Path | None, typer.Option(help="poses.csv of the flange, time-stamped.")] = None,
    camera_stream: Annotated[Path | None, typer.Option(help="poses.csv of the target in the camera.")] = None,
    clocks_within: Annotated[
        float | None,
        typer.Option(
            min=0.0, metavar="SECONDS", help="With streams: their clocks differ by this at most; else by any."
        ),
    ] = None,
    setup: Annotated[str, typer.Option(help="eye-in-hand or eye-to-hand.")] = "eye-in-hand",
    free_camera: Annotated[
        bool, typer.Option("--free-camera", help="With images: refine the camera, if left-out images get better.")
    ] = False,
    propose: Annotated[int, typer.Option(min=0, help="Propose so many further poses.")] = 0,
    workers: Workers = None,
    bits: Bits = None,
    strict: Strict = False,
    json: AsJson = False,
    table_options: TableOptions = NOTHING_STATED,
) -> None:
    """Find where the camera is on the hand (or beside the robot), and say whether the answer is right."""
    with CommandUI(as_json=json) as face:
        from armsight.app.calibrate.handeye import HandEyeJob, calibrate_handeye

        job = HandEyeJob(
            out=out,
            setup=_setup(setup),
            pairs=pairs,
            images=images or "",
            camera=camera,
            board=board or "",
            robot=robot,
            robot_stream=robot_stream,
            camera_stream=camera_stream,
            clocks_within_s=clocks_within,
            free_camera=free_camera,
            propose=propose,
            workers=workers,
            table=table_options.format(face),
            bits=bits,
            strict=strict,
        )
        done = calibrate_handeye(job, face.progress("calibrating"))
        handeye_tables(face, done, out)
        face.result(done)


def _setup(name: str) -> Setup:
    from armsight.calibrate.handeye import Setup

    if name not in tuple(Setup):
        raise UsageError(f"no setup is called {name!r}; there are {', '.join(Setup)}")
    return Setup(name)


@takes_tables
def tooltip(
    poses: Annotated[Path, typer.Option(help="poses.csv of the target (or flange) while the tool pivots on a point.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="tip.yaml to write.")],
    point: Annotated[
        str | None, typer.Option(metavar="X,Y,Z", help="The point, m or with units (200mm), if it was measured.")
    ] = None,
    point_sigma: Annotated[
        float, typer.Option(help="Standard deviation of one coordinate of the measured point.", **quantity("m", 1e-9))
    ] = POINT_SIGMA_MM * MM,
    json: AsJson = False,
    table_options: TableOptions = NOTHING_STATED,
) -> None:
    """Find where the end of a tool is, from poses recorded while it was turned about its end."""
    with CommandUI(as_json=json) as face:
        from armsight.app.calibrate.handeye import calibrate_tip

        format_ = table_options.format(face)
        done = calibrate_tip(poses, out, point=_point(point), sigma_m=point_sigma, format_=format_)
        face.table("Tip", ["", "mm", "+-"], tip_rows(done.tip_m.tolist(), done.std_tip))
        face.say(f"{_worth(done)}, residual {figure(done.residual_rms_m / MM)} mm RMS{_left_out(done)}. Result: {out}")
        for note in done.notes:
            face.say(note)
        for item in done.rejected:
            face.say(f"  left out: row {item.row}: {item.why}")
        face.result(done)


@takes_cameras
def pivot(
    rig: Annotated[Path, typer.Option(help="rig.yaml of the two cameras.")],
    target: Annotated[Path, typer.Option(help="target.yaml of the target on the tool.")],
    left: Annotated[str, typer.Option(metavar="SRC", help=f"Left frames: {SRC}.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="tip.yaml to write.")],
    right: Annotated[str | None, typer.Option(metavar="SRC", help="Right frames, in step with the left ones.")] = None,
    goal: Annotated[
        float, typer.Option(help="Stop where the tip is known so well (one standard deviation).", **quantity("m", 1e-6))
    ] = 1e-4,
    point: Annotated[
        str | None, typer.Option(metavar="X,Y,Z", help="The point in rig axes, m or with units (200mm), if measured.")
    ] = None,
    point_sigma: Annotated[
        float, typer.Option(help="Standard deviation of one coordinate of the measured point.", **quantity("m", 1e-9))
    ] = POINT_SIGMA_MM * MM,
    json: AsJson = False,
    camera_options: CameraOptions = NONE_GIVEN,
) -> None:
    """Find a tool's tip while you pivot it before the cameras; ends when it is known well enough."""
    with CommandUI(as_json=json) as face:
        from armsight.app.calibrate.pivot import PivotJob, run_pivot

        job = PivotJob(
            rig=rig,
            target=target,
            out=out,
            left=left,
            right=right,
            goal_m=goal,
            point=_point(point),
            sigma_m=point_sigma,
            camera_settings=camera_options.settings(),
        )
        done = run_pivot(job, face.progress("pivoting"))
        face.table("Tip", ["", "mm", "+-"], tip_rows(done.tip_m.tolist(), done.std_tip))
        said = "good enough" if done.reached else "not yet as good as wanted: pivot on, or lower the goal"
        face.say(f"{_worth(done)}, {said}{_left_out(done)}. Result: {out}")
        for note in done.notes:
            face.say(note)
        face.result(done)


def _worth(done: TipCalibration) -> str:
    """Return how many poses there are, and how many independent ones those of a recording are worth, in words."""
    worth = "" if done.n_effective is None else f", worth {done.n_effective:.0f} independent ones"
    return f"{done.n_used} poses{worth}"


def _left_out(done: TipCalibration) -> str:
    return "" if done.loo_rms_m is None else f", left out {figure(done.loo_rms_m / MM)} mm"


def handeye_tables(face: CommandUI, done: HandEye, out: Path) -> None:
    """Print a hand-eye calibration."""
    poses = {
        "T_flange_camera": (done.T_flange_camera, done.std_camera),
        "T_base_target": (done.T_base_target, done.std_target),
        "T_base_camera": (done.T_base_camera, done.std_camera),
        "T_flange_target": (done.T_flange_target, done.std_target),
    }
    for name, (pose, std) in poses.items():
        if pose is not None:
            face.table(name, ["", "value", "+-"], pose_rows(pose, std))
    face.say(done.verdict)
    if done.comparison is not None:
        face.say(done.comparison.why)
    if done.camera_file is not None:
        face.say(f"The result belongs to the freed camera: {done.camera_file}")
    for text in done.advice:
        face.say(f"- {text}")
    for item in done.rejected[:8]:
        face.say(f"  left out: {item.name}: {item.why}")
    from armsight.geometry import xyz_quat

    for proposed in done.proposals or ():
        xyz, quat = (", ".join(f"{v:.4f}" for v in values) for values in xyz_quat(proposed.T_base_flange))
        face.say(f"  propose T_base_flange ({xyz}) m, ({quat}): then {figure(proposed.expected_std_m / MM, 2)} mm")
    face.say(f"Result: {out}; open {out.with_suffix('.report.html')}")


def add_to(calibrate: typer.Typer) -> None:
    """Add the commands to `armsight calibrate`."""
    calibrate.command("handeye")(handeye)
    calibrate.command("tooltip")(tooltip)
    calibrate.command("pivot")(pivot)


def _point(text: str | None) -> tuple[float, float, float] | None:
    if text is None:
        return None
    try:
        x, y, z = (Quantity("m")(cell) for cell in text.split(","))
    except (ValueError, typer.BadParameter):
        raise UsageError(f"the point {text!r} is not X,Y,Z", cure="Write for instance 0.2,1.25,0.08, in m") from None
    return x, y, z
