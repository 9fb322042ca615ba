"""Kapucu and Baysec 2005: an unknown arm of two turning joints and a slide from a beacon seen by two cameras."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from armsight.arrays import Array
from armsight.calibrate.identify import Identification, Sweeps, identify
from armsight.drivers import read_image
from armsight.errors import Inconsistent
from armsight.ops.identification.solve import BeaconFrames
from armsight.optics import Rig
from armsight.report.arm_report import identify_report
from armsight.store import read_poses, read_rig, read_target, read_world, write_text
from armsight.store.arm_file import write_arm
from armsight.store.arm_points import read_sweep_joints, write_sweeps
from armsight.units import DEG
from armsight_sim.papers import kapucu2005 as paper
from armsight_sim.papers.kapucu2005 import PathJoint
from armsight_sim.reproduce.page import ComparedRow, ComparisonTable, Curve, Panel, PaperFigure, Reproduction
from armsight_sim.reproduce.stage import Stage

SCENARIO = "kapucu2005-rrp"
READINGS = 30
CM = 1e-2
TOLERANCE_RAD = 0.02
"""What the paper says of its twist angles: within 0.02 rad."""

ASSUMPTIONS = (
    "Calibration of the cameras and of their place in the world is exact for both methods: the paper calibrates by "
    "hand and gives no residuals. Errors here are those of finding the beacon and of the geometry only.",
    "The beacon's colour is not defined in print: red that exceeds green and blue by 60 levels.",
    "The three points that set the plane of a path (step 1: any) are the first, the middle and the last; a path is "
    "straight where its mean distance from the line through its ends is at most 15 % of its length; none is printed.",
    "The steps are used as corrected: eq. (2) transposed, the third point turned into the x-y plane, the inverse with "
    "the translation (MATH C1 to C5). As printed they miss noise-free circles by half their radius.",
    "Axes become Table 1 by their common normals, the slide's axis through the beacon. The paper's a1 is the X of its "
    "first centre instead (MATH C9).",
    "armsight knows the commanded increments, as the paper's control computer does; the paper does not use them.",
    "The second joint's arc is 120 degrees, which fits the printed errors (MATH 4.4).",
)
DOUBTS = (
    "a1 = -0.28 cm is the X of the first circle's centre. With the paper's own centres and twists the common normal of "
    "axes 1 and 2 is 7.9 cm, or 7.3 from the world's Z (MATH C9).",
    "a2 = 9.78 cm in Table 1, while the text gives 18.0 and 11.52 cm for the same offset (MATH C10).",
    "a1, a2 and d2 within 0.31 cm together have a probability of 1e-7 to 2e-5 beside its circle errors (MATH 4.4).",
    "The first circle's height is 146 cm in the text, and 65 + 78.5 = 143.5 cm by its own figures; the second centre's "
    "Y is -5.5 cm, and d2 -5.0 cm; 6.29 of 127 cm is 4.95 %, not 5.5 % (MATH C11).",
    "The camera frame is called right-handed; x right, y up, z outward is left-handed (MATH C8).",
)
MISSING = (
    "Fig. 16 is the model's drawing; the identified arm's own report is kapucu2005-arm.report.html beside this one.",
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Run:
    """What was seen. All (30, 3) in world, in the order of the readings, unless it says camera or px."""

    rig: Rig
    T_world_rig: Array
    sweeps: Sweeps
    left_px: Array
    right_px: Array
    method_m: Array
    ours_m: Array
    true_m: Array
    result: Identification

    def rows(self, joint: int) -> NDArray[np.intp]:
        """Return the rows of a joint (from 0) in the order of its positive motion."""
        rows = self.sweeps.rows(joint)
        return rows[np.argsort(self.sweeps.q[rows, joint])]


def reproduce_kapucu(stage: Stage) -> Reproduction:
    """Return tables and figures of the paper. Raises UsageError for fewer than 30 frames, what identify raises."""
    folder = stage.simulate(SCENARIO, least=READINGS, most=READINGS)
    run = _measure(stage, folder)
    method = [paper.joint_of_path(run.method_m[run.rows(j)]) for j in range(3)]
    ours = [paper.joint_of_path(run.ours_m[run.rows(j)]) for j in range(3)]
    true = [paper.joint_of_path(run.true_m[run.rows(j)]) for j in range(3)]
    tables = (_parameters(run, (method, ours, true)), _circles(method, ours, true), _paths(run))
    return Reproduction(
        paper="kapucu2005",
        title="Kapucu and Baysec 2005, reproduced",
        source="Determination of the geometric parameters of a robot manipulator by visual data",
        seed=stage.seed,
        tables=tables,
        figures=_figures(run),
        assumptions=ASSUMPTIONS,
        doubts=DOUBTS,
        missing=MISSING,
        settings=tuple(stage.settings),
    )


def _measure(stage: Stage, folder: Path) -> _Run:
    """Return the beacon's places by both methods, and the identified arm; armsight's files are written."""
    out, joints = stage.out / "kapucu2005-arm.yaml", folder / "sweep_joints.csv"
    target = read_target(folder / "target.yaml")
    frames = BeaconFrames(target=target, left=str(folder / "left"), right=str(folder / "right"), joints=joints)
    rig, T_world_rig = read_rig(folder / "rig.yaml"), read_world(folder / "world.yaml").T_parent_rig
    sweeps, notes = frames.sweeps(rig, stage.progress)
    if len(sweeps) < READINGS:
        raise Inconsistent(
            f"the beacon is found in {len(sweeps)} of {READINGS} pairs: {'; '.join(notes)}",
            consequence="The methods cannot be compared reading by reading",
            cure="Take another seed",
        )
    result = identify(sweeps, rig=rig, base=T_world_rig.inv().as_matrix(), name=out.stem)
    write_sweeps(out.with_suffix(".sweep.csv"), sweeps)
    write_arm(out, result.arm)
    write_text(out.with_suffix(".report.html"), identify_report(result))
    px = [_centroids(folder / side, read_sweep_joints(joints)[0]) for side in ("left", "right")]
    T = T_world_rig.as_matrix()
    poses = read_poses(folder / "truth_world.csv", parent="world", measured=False)
    return _Run(
        rig=rig,
        T_world_rig=T,
        sweeps=sweeps,
        left_px=px[0],
        right_px=px[1],
        method_m=paper.to_world(rig, T, paper.camera_places(rig, px[0], px[1])),
        ours_m=result.predicted_m @ T[:3, :3].T + T[:3, 3],
        true_m=np.array([pose.T_parent_target[:3, 3] for pose in poses if pose.T_parent_target is not None]),
        result=result,
    )


def _centroids(folder: Path, frames: NDArray[np.intp]) -> Array:
    names = sorted(folder.glob("*.png"))
    return np.array([paper.beacon_centroid(read_image(names[frame], colour=True)) for frame in frames])


def _printed_table() -> Mapping[str, tuple[float | None, float | None, bool, str]]:
    """Return each entry of Table 1: as printed, as measured on the paper's rig, whether credible, and why not."""
    tolerance = "the paper's error is its stated tolerance of 0.02 rad"
    return {
        "a1_m": (-0.28 * CM, 0.0, False, "the printed figure is another quantity, see the doubts"),
        "d1_m": (120.71 * CM, 1.27, True, ""),
        "alpha1_rad": (90.0 * DEG, 90.0 * DEG, True, tolerance),
        "a2_m": (9.78 * CM, 0.1, False, "contradicted in the text, see the doubts"),
        "d2_m": (-4.69 * CM, -0.05, False, "improbably small error, see the doubts"),
        "alpha2_rad": (90.0 * DEG, 90.0 * DEG, True, tolerance),
        "theta2_rad": (106.7 * DEG, None, False, "the arbitrary first reading; here that of the third joint's sweep"),
        "d3_at_start_m": (None, None, False, "not printed"),
        "d3_travel_m": (46.3 * CM, None, False, "printed without a truth to compare with"),
    }


def _entries(run: _Run, found: Sequence[PathJoint], positions: Array) -> dict[str, float]:
    """Return the entries of Table 1 from joints and the beacon's places (30, 3) in world."""
    lines = [(joint.point_m, joint.direction) for joint in found]
    slide = run.rows(2)
    one, two, d3 = paper.rrp_links(lines, positions[slide[0]], np.array([1.0, 0.0, 0.0]))
    return {
        "a1_m": one.a_m,
        "d1_m": one.d_m,
        "alpha1_rad": one.alpha_rad,
        "a2_m": two.a_m,
        "d2_m": two.d_m,
        "alpha2_rad": two.alpha_rad,
        "theta2_rad": two.theta_rad % (2.0 * np.pi),
        "d3_at_start_m": d3,
        "d3_travel_m": float(np.linalg.norm(positions[slide[-1]] - positions[slide[0]])),
    }


def _parameters(run: _Run, joints: Sequence[Sequence[PathJoint]]) -> ComparisonTable:
    """Return Table 1 by both methods and in truth."""
    positions = (run.method_m, run.ours_m, run.true_m)
    method, ours, true = (_entries(run, found, at) for found, at in zip(joints, positions, strict=True))
    rows = [
        ComparedRow(
            name=name,
            label=name.rpartition("_")[0].replace("_", " "),
            unit=name.rpartition("_")[2],
            paper=printed,
            paper_method=method[name],
            armsight=ours[name],
            truth=true[name],
            paper_truth=held,
            paper_error=TOLERANCE_RAD if name.startswith("alpha") else None,
            credible=credible,
            note=note,
        )
        for name, (printed, held, credible, note) in _printed_table().items()
    ]
    return ComparisonTable(
        name="table1",
        title="Table 1: Denavit-Hartenberg parameters",
        text="alpha3, a3 and theta3 are zero by construction: the third frame is put on the beacon.",
        rows=tuple(rows),
    )


def _circles(method: Sequence[PathJoint], ours: Sequence[PathJoint], true: Sequence[PathJoint]) -> ComparisonTable:
    """Return what the text gives of the circles, and the joints' types."""
    sets = (method, ours, true)
    off1 = [float(np.linalg.norm((found[0].point_m - true[0].point_m)[:2])) for found in sets]
    off2 = [float(np.linalg.norm(found[1].point_m - true[1].point_m)) for found in sets]
    printed1 = float(np.hypot(0.28, 4.29)) * CM
    printed2 = float(np.linalg.norm([6.73, -8.51 + 5.5, 120.70 - 127.0])) * CM
    height1, height2 = ([float(found[j].point_m[2]) for found in sets] for j in (0, 1))
    radius1, radius2 = ([found[j].radius_m for found in sets] for j in (0, 1))
    doubtful = "printed as read off Fig. 9; contradicted by 143.5 cm, see the doubts"
    rows = (
        _length("circle1_centre_error_m", "circle 1, centre's error in X and Y", printed1, off1, 0.0),
        _length("circle1_radius_m", "circle 1, radius", 95.75 * CM, radius1, 0.96),
        replace(_length("circle1_height_m", "circle 1, height", 1.46, height1, None), credible=False, note=doubtful),
        _length("circle2_centre_error_m", "circle 2, centre's error", printed2, off2, 0.0),
        _length("circle2_height_m", "circle 2, centre's Z", 120.70 * CM, height2, 1.27),
        _length("circle2_radius_m", "circle 2, radius", 90.34 * CM, radius2, 0.96),
    )
    return ComparisonTable(
        name="circles",
        title="The circles of joints 1 and 2",
        text=(
            "Centres and radii as the text gives them. Types found by the paper's method: "
            f"{_types(method)}; by armsight: {_types(ours)}; the arm is {_types(true)}."
        ),
        rows=rows,
    )


def _length(name: str, label: str, printed: float, values: Sequence[float], held: float | None) -> ComparedRow:
    """Return a row in m; values: by the paper's method, by armsight, and in truth."""
    method, ours, true = values
    return ComparedRow(
        name=name,
        label=label,
        unit="m",
        paper=printed,
        paper_method=method,
        armsight=ours,
        truth=true,
        paper_truth=held,
    )


def _types(joints: Sequence[PathJoint]) -> str:
    return "".join("R" if joint.revolute else "P" for joint in joints)


def _paths(run: _Run) -> ComparisonTable:
    """Return how far the readings are from where the beacon was, RMS: what Figs. 8 to 15 show."""
    rows = []
    for j in range(3):
        where = run.rows(j)
        values = [float(np.sqrt(((p - run.true_m)[where] ** 2).sum(axis=1).mean())) for p in (run.method_m, run.ours_m)]
        rows.append(
            ComparedRow(
                name=f"joint{j + 1}_places_rms_m",
                label=f"joint {j + 1}, places, RMS error",
                unit="m",
                paper=None,
                paper_method=values[0],
                armsight=values[1],
                truth=0.0,
                credible=False,
            )
        )
    return ComparisonTable(
        name="places",
        title="Places of the beacon (Figs. 8, 9, 11, 12, 14, 15)",
        text="The paper draws them without figures. armsight's are those of the identified arm.",
        rows=tuple(rows),
    )


def _figures(run: _Run) -> tuple[PaperFigure, ...]:
    out = []
    in_camera = [paper.from_world(run.rig, run.T_world_rig, p) for p in (run.true_m, run.method_m, run.ours_m)]
    in_world = [run.true_m, run.method_m, run.ours_m]
    for j, number in enumerate((7, 10, 13)):
        rows = run.rows(j)
        out.append(
            PaperFigure(
                name=f"Fig. {number}: images of joint {j + 1}'s path",
                text="The beacon in the left and the right image: the paper's centroid, and armsight's spot.",
                panels=tuple(_image_panel(run, side, rows) for side in (0, 1)),
            )
        )
        for more, axes, positions in ((1, "c", in_camera), (2, "w", in_world)):
            frame = "camera" if axes == "c" else "world"
            out.append(
                PaperFigure(
                    name=f"Fig. {number + more}: joint {j + 1} in the {frame} frame",
                    text="Three views: the true places, the paper's method, and the arm that armsight identified.",
                    panels=_views([p[rows] / CM for p in positions], axes),
                )
            )
    return tuple(out)


def _image_panel(run: _Run, side: int, rows: NDArray[np.intp]) -> Panel:
    centroid = (run.left_px, run.right_px)[side][rows]
    spot = None if run.sweeps.uv_px is None else run.sweeps.uv_px[rows, side]
    curves = [Curve(name="the paper's method", x=centroid[:, 0], y=centroid[:, 1], who="method")]
    if spot is not None:
        curves.append(Curve(name="armsight", x=spot[:, 0], y=spot[:, 1], who="ours"))
    letter = "LR"[side]
    return Panel(x_title=f"X{letter}, px", y_title=f"Y{letter}, px", curves=tuple(curves), equal=True, downward=True)


def _views(positions: Sequence[Array], frame: str) -> tuple[Panel, ...]:
    """Return the three views of places in cm: true, by the paper's method, armsight's."""
    order = ((2, 1), (0, 1), (0, 2)) if frame == "c" else ((0, 2), (1, 2), (0, 1))
    panels = []
    for h, v in order:
        true, method, ours = (p[:, [h, v]].T for p in positions)
        curves = (
            Curve(name="truth", x=true[0], y=true[1], who="truth", mode="lines"),
            Curve(name="the paper's method", x=method[0], y=method[1], who="method"),
            Curve(name="armsight", x=ours[0], y=ours[1], who="ours"),
        )
        panels.append(
            Panel(x_title=f"{'XYZ'[h]}{frame}, cm", y_title=f"{'XYZ'[v]}{frame}, cm", curves=curves, equal=True)
        )
    return tuple(panels)
