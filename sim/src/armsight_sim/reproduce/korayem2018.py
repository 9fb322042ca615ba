"""Korayem et al. 2018: the tool's pose of a 6R arm over a quarter turn, from two parallel webcams."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from armsight.arrays import Array
from armsight.drivers import read_image
from armsight.errors import NotEnoughData
from armsight.geometry import euler_rad
from armsight.kinematics import Arm
from armsight.optics import SIDES, Rig
from armsight.records import Target
from armsight.store import read_poses, read_rig, read_target, read_times, read_world
from armsight.store.arm_file import read_arm
from armsight.store.tracks import read_joints
from armsight.units import DEG, MM
from armsight_sim.papers import korayem2018, pachidis2005
from armsight_sim.reproduce.page import ComparedRow, ComparisonTable, Curve, Panel, PaperFigure, Reproduction
from armsight_sim.reproduce.stage import Stage
from armsight_sim.reproduce.tracks import (
    SHOWN,
    PoseTracks,
    joined,
    measured_poses,
    spots_by_frame,
    statistic_rows,
    time_panel,
)

SCENARIO = "korayem2018-circle"
LEAST_FRAMES = 6
PIXEL_M = 3e-6
"""Table 1."""
NAMES = ("desired", "the paper's method", "armsight")

ASSUMPTIONS = (
    "The paper prints its results as curves; there is no figure in its text that an error could be held against. Both "
    "methods are compared with the simulation's truth.",
    "Calibration of the cameras and of their place is exact for both methods: the paper gives no residuals.",
    "Two LEDs fix no pose; three are used (MATH 2.3). The paper's method takes the mean pixel of the area above half "
    "of a LED's height, eq. (10) with cameras at -B/2 and +B/2 (MATH A17), and the frame that three points span.",
    "Which light is which is taken from armsight for both methods: the paper does not say how its LEDs are told apart.",
    "The desired trajectory is the nominal arm at the controller's joint readings. The true arm differs from it by "
    "what the scenario gives (0.3 mm, 0.05 degrees), which the paper would see as the robot's error.",
    "Angles are those of the tool against its first desired pose, about the world's axes (R = Rz Ry Rx).",
    "The errors in joint space are those of measuring: inverse kinematics of the measured pose minus that of the true "
    "one, both with Table 2's arm; the paper's inverse is used as corrected (MATH 2.2).",
)
DOUBTS = (
    "Three frames a second and a sampling time of 20 ms contradict each other (MATH A20).",
    "Eqs. (1) to (9) mix two senses of the cameras' places and print two wrong signs (MATH A11 to A17); the forward "
    "kinematics has a wrong sign in a_y, the inverse lacks a1 and branches (MATH A2, A6 to A9).",
    "The image's centre is given as (638, 350), and the sensor as 1296 x 810 pixels of 3 um, while HD video has 1280 x "
    "720; focal length, baseline and the LEDs' places are not given.",
    "A set-up of two LEDs, as the conclusion speaks of, gives two of three angles; the third's origin is not said.",
)
MISSING = ("Figs. 1 to 5 are photographs and drawings. The rotary base did not turn during this experiment.",)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Run:
    """Poses in world over time, desired ones (n, 4, 4), joint readings (n, 6), and the nominal arm."""

    tracks: PoseTracks
    desired: Array
    q: Array
    arm: Arm


def reproduce_korayem(stage: Stage) -> Reproduction:
    """Return tables and figures of the paper. Raises UsageError for too few frames, what measure raises."""
    folder = stage.simulate(SCENARIO, least=LEAST_FRAMES)
    run = _measure(stage, folder)
    tracks = run.tracks
    pose_rows = statistic_rows(tracks.errors(tracks.method), tracks.errors(tracks.ours), ("rms", "max"))
    return Reproduction(
        paper="korayem2018",
        title="Korayem et al. 2018, reproduced",
        source="Determining position and orientation of 6R robot using image processing",
        seed=stage.seed,
        tables=(
            ComparisonTable(
                name="pose",
                title="Errors of the measured pose (Figs. 6 to 9, 11, 12)",
                text="Measured minus true pose of the tool's target, over all frames.",
                rows=pose_rows,
            ),
            _trajectory(tracks),
            _joints(run),
        ),
        figures=_figures(run),
        assumptions=ASSUMPTIONS,
        doubts=DOUBTS,
        missing=MISSING,
        settings=tuple(stage.settings),
    )


def _measure(stage: Stage, folder: Path) -> _Run:
    """Return the poses by both methods; armsight's files are written."""
    out = stage.out / "korayem2018-measured"
    stage.measure(
        rig=folder / "rig.yaml",
        target=folder / "target.yaml",
        world=folder / "world.yaml",
        times=folder / "times.csv",
        left=str(folder / "left"),
        right=str(folder / "right"),
        out=out,
    )
    times_s = read_times(folder / "times.csv")
    T_world_rig = read_world(folder / "world.yaml").T_parent_rig.as_matrix()
    seen = spots_by_frame(out / "spots.csv", times_s)
    method = _by_paper(folder, seen, len(times_s), read_rig(folder / "rig.yaml"), read_target(folder / "target.yaml"))
    truth = [pose.T_parent_target for pose in read_poses(folder / "truth_world.csv", parent="world", measured=False)]
    true = np.array([T for T in truth if T is not None])
    placed = {i: T_world_rig @ T for i, T in method.items()}
    tracks = joined(times_s, placed, measured_poses(out / "poses.csv"), true)
    arm, motion = read_arm(folder / "arm.yaml"), read_joints(folder / "joints.csv")
    nearest = np.abs(motion.t_s[None] - tracks.t_s[:, None]).argmin(axis=1)
    q = motion.q[nearest]
    return _Run(tracks=tracks, desired=arm.fk(q), q=q, arm=arm)


def _by_paper(
    folder: Path, seen: Mapping[tuple[int, str], Mapping[str, Array]], n_frames: int, rig: Rig, target: Target
) -> dict[int, Array]:
    """Return T_rig_target (4, 4) by frame as the paper's method gives it; frames without all lights are left out."""
    files = {side: sorted((folder / side).glob("*.png")) for side in SIDES}
    out: dict[int, Array] = {}
    for frame in range(n_frames):
        spots = [seen.get((frame, side), {}) for side in SIDES]
        if any(name not in known for known in spots for name in target.names):
            continue
        images = [read_image(files[side][frame]) for side in SIDES]
        try:
            uv = [
                np.array([korayem2018.led_centroid(image, known[name]) for name in target.names])
                for image, known in zip(images, spots, strict=True)
            ]
        except NotEnoughData:
            continue
        out[frame] = pachidis2005.pose_of_three(positions(rig, uv[0], uv[1]), target.xyz_m)
    return out


def positions(rig: Rig, left_px: Array, right_px: Array) -> Array:
    """Return places (n, 3) in rig axes of pixels (n, 2) by eq. (10), the sensor's image inverted."""
    focal_m = float(rig.left.intrinsics[0]) * PIXEL_M
    baseline_m = rig.baseline_m
    centres = [camera.intrinsics[2:4] for camera in (rig.left, rig.right)]
    uv_m = [-(px - centre) * PIXEL_M for px, centre in zip((left_px, right_px), centres, strict=True)]
    XYZ = korayem2018.triangulate_parallel(focal_m, baseline_m, uv_m[0], uv_m[1])
    return np.asarray(XYZ + np.array([0.5 * baseline_m, 0.0, -focal_m]))


def _trajectory(tracks: PoseTracks) -> ComparisonTable:
    """Return the circle of Fig. 10 about the first axis, the world's z."""
    sets = [poses[:, :3, 3] for poses in (tracks.method, tracks.ours, tracks.true)]
    radii = [np.hypot(xyz[:, 0], xyz[:, 1]) for xyz in sets]
    angles = [np.unwrap(np.arctan2(xyz[:, 1], xyz[:, 0])) for xyz in sets]
    rows = (
        _row("radius_m", "mean radius", [float(r.mean()) for r in radii]),
        _row("radius_scatter_m", "scatter of the radius, standard deviation", [float(r.std()) for r in radii]),
        _row("height_m", "mean height", [float(xyz[:, 2].mean()) for xyz in sets]),
        _row("arc_rad", "arc", [float(np.ptp(a)) for a in angles]),
    )
    return ComparisonTable(
        name="trajectory",
        title="The circle that the tool draws (Fig. 10)",
        text="Distance from the first axis; the paper says a little more than a quarter of a circle, in words.",
        rows=rows,
    )


def _row(name: str, label: str, values: list[float]) -> ComparedRow:
    method, ours, true = values
    return ComparedRow(
        name=name,
        label=label,
        unit=name.rpartition("_")[2],
        paper=None,
        paper_method=method,
        armsight=ours,
        truth=true,
        credible=False,
    )


def _joints(run: _Run) -> ComparisonTable:
    """Return the errors in joint space (section 4's end)."""
    tracks = run.tracks
    T_tool_flange = run.arm.T_flange_tool.inv().as_matrix()
    T_base_world = run.arm.T_world_base.inv().as_matrix()
    paper = [
        korayem2018.nearest_solution(T_base_world @ T @ T_tool_flange, q)
        for T, q in zip(tracks.method, run.q, strict=True)
    ]
    ours = [run.arm.ik(T, near=q)[0].q for T, q in zip(tracks.ours, run.q, strict=True)]
    true = [run.arm.ik(T, near=q)[0].q for T, q in zip(tracks.true, run.q, strict=True)]
    names = [f"q{k}_rad" for k in range(1, 7)]
    method_off, ours_off = np.array(paper) - np.array(true), np.array(ours) - np.array(true)
    return ComparisonTable(
        name="joints",
        title="Errors in joint space",
        text="Joint values of the measured pose minus those of the true one.",
        rows=statistic_rows(method_off, ours_off, ("rms", "max"), names=names),
    )


def _figures(run: _Run) -> tuple[PaperFigure, ...]:
    tracks = run.tracks
    columns = [_columns(poses, run.desired[0]) for poses in (run.desired, tracks.method, tracks.ours)]
    out = []
    for k, number in enumerate((6, 7, 8, 9, 11, 12)):
        name, unit = SHOWN[k], "mm" if k < 3 else "°"
        values = [column[:, k] for column in columns]
        off = [column - values[0] for column in values]
        out.append(
            PaperFigure(
                name=f"Fig. {number}: {name} of the tool"
                if k < 3
                else f"Fig. {number}: angle of the tool about {name[1]}",
                text="On the left the figure itself, on the right the difference from the desired trajectory.",
                panels=(
                    time_panel(f"{name}, {unit}", tracks.t_s, values, NAMES),
                    time_panel(f"{name} minus desired, {unit}", tracks.t_s, off, NAMES),
                ),
            )
        )
    curves = tuple(
        Curve(name=name, x=column[:, 0], y=column[:, 1], who=who, mode=mode)
        for name, column, who, mode in zip(
            NAMES, columns, ("truth", "method", "ours"), ("lines", "markers", "markers"), strict=True
        )
    )
    trajectory = PaperFigure(
        name="Fig. 10: the tool's trajectory",
        text="Seen from above.",
        panels=(Panel(x_title="x, mm", y_title="y, mm", curves=curves, equal=True),),
    )
    return (*out[:4], trajectory, *out[4:])


def _columns(poses: Array, first: Array) -> Array:
    """Return x, y, z in mm and angles about x, y, z in degrees (n, 6) of poses (n, 4, 4), angles against `first`."""
    turned = Rotation.from_matrix(poses[:, :3, :3] @ first[:3, :3].T)
    return np.hstack([poses[:, :3, 3] / MM, np.unwrap(euler_rad(turned), axis=0) / DEG])
