"""Pachidis et al. 2005: poses of a lit target, at rest and led along paths, by a mirror rig at a robot's flange."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from armsight.arrays import Array
from armsight.columns import POSE6
from armsight.drivers import read_image
from armsight.errors import NotEnoughData
from armsight.geometry import euler_rad
from armsight.optics import Rig
from armsight.records import Target
from armsight.store import read_poses, read_rig, read_target, read_times
from armsight.store.arm_file import read_arm
from armsight.store.tracks import read_joints
from armsight.units import DEG, MM
from armsight_sim.papers import pachidis2005 as paper
from armsight_sim.reproduce.page import ComparedRow, ComparisonTable, Curve, Panel, PaperFigure, Reproduction
from armsight_sim.reproduce.stage import Stage
from armsight_sim.reproduce.tracks import (
    SHOWN,
    PoseTracks,
    joined,
    measured_poses,
    pose_differences,
    statistic_rows,
    time_panel,
)

EXPERIMENTS = ("static", "circle", "trapezium")
LEAST_FRAMES = 6
THRESHOLD = 40.0
MASK_PX = (160.0, 70.0)
"""Half sizes, along u and v, of the part of the image about its middle in which areas are looked for."""
UNITS = (MM, MM, MM, DEG, DEG, DEG)
NAMES = ("truth", "the paper's method", "armsight")

PRINTED: Mapping[str, Mapping[str, Sequence[float]]] = {
    "table1": {
        "me": (1.13e-13, -4.3e-15, 2.44e-14, -6.1e-16, 1.0e-15, -8.8e-15),
        "mae": (0.0089, 0.0412, 0.0949, 0.0056, 0.0026, 0.0039),
        "max": (0.0369, 0.1403, 0.352, 0.2972, 0.1401, 0.2041),
        "sd": (0.0116, 0.0508, 0.1170, 0.0290, 0.0137, 0.0199),
    },
    "table2": {
        "me": (0.0436, 0.1093, -0.294, 0.1795, -0.0472, -0.1662),
        "mae": (0.2466, 0.4843, 0.3048, 0.6212, 0.4581, 0.4313),
        "max": (1.1477, 1.7052, 1.0210, 1.8740, 1.7380, 0.8604),
    },
    "table3": {
        "me": (0.1376, -0.428, -4e-4, 7e-4, -7e-4, 8e-4),
        "mae": (0.9949, 0.7873, 0.392, 0.822, 0.8333, 1.0736),
        "max": (3.934, 3.8898, 1.344, 3.181, 2.588, 3.276),
    },
}
"""As printed: mm and degrees."""

ASSUMPTIONS = (
    "Calibration of the camera, of the mirrors and of the hand-eye pose is exact for both methods.",
    "Tables 1 to 3 place both methods' poses by the true arm at the controller's joint readings, since the paper's "
    "real state was itself estimated by PSVS through its robot, so that its errors do not hold the arm's. The tables "
    "named accuracy take the nominal arm, from which the true one differs by 0.3 mm and 0.02 degrees (chosen).",
    "Trembling of the flange by 0.02 mm and joint readings of 0.009 degrees (both chosen) are in all tables.",
    "Camera, lens, baseline, the lights' spacing and the hand-eye pose are not printed; see the emulated hardware.",
    "The room is dark: the paper's binary images hold the six lit areas only, which lamps would not allow.",
    "The paper's method: areas above a grey level of 40 in the middle of the image that a cross of 5 pixels fits into "
    "(its 9 do not fit the small lights here), means of their pixels, eq. (4) with printed m and l, eqs. (7) and (8).",
    "Table 1 is computed as the paper did: errors about the mean of the recorded vectors. Tables 2 and 3 are recorded "
    "minus true poses; the paper's truth is the path that the operator was to follow, so its errors hold his hand's.",
    "The following of the target is the simulation's own, a controller with the paper's delay of 70 ms.",
    "Angles: rotation vectors between recorded and true pose, which small yaw, pitch and roll are (MATH 3.2).",
)
DOUBTS = (
    "Table 1's mean errors of 1e-13 show errors about the sample's own mean: precision, not accuracy (MATH 3.4).",
    "Table 1's angles: one outlier among 106 values, 105 of them equal, gives all six printed MAE and SD digit for "
    "digit. They seem frozen or dead-banded, and are no target for an orientation's accuracy (MATH 3.4).",
    "Table 1 heads angle errors with mm; they are degrees (MATH B9). Mean errors in Table 3 of 7e-4 degrees beside "
    "mean absolute ones of 0.8 suggest that its angles and z are about their own mean too.",
    "The servo law has the wrong sign and no lever arm, and A33 of eq. (1) must be 1 (MATH B1, B7, B8).",
    "The printed l of eq. (6) is not the optical shift of the plate: up to 0.8 mm of depth (MATH B3, 3.1).",
)
MISSING = (
    "Following by armsight servo and recording by armsight teach are not run here: the simulation follows the target, "
    "and the recorded poses of the moved target stand for the taught path.",
    "Playing the path back (Fig. 9b to 9d, the tool tip in real time) is armsight play; drawn is the recorded path.",
    "The needle's calibration before the third experiment is armsight calibrate tooltip; here the path is that of the "
    "target's origin.",
    "Figs. 1 to 6 and 10 are drawings, templates and screens.",
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Vision:
    """What both methods measure with."""

    rig: Rig
    target: Target


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Recorded:
    """The recorded poses as the true arm places them (tables 1 to 3), and as the nominal arm does."""

    true_arm: PoseTracks
    nominal_arm: PoseTracks


def reproduce_pachidis(stage: Stage) -> Reproduction:
    """Return tables and figures of the paper. Raises UsageError for too few frames, what measure raises."""
    recorded = {name: _record(stage, name) for name in EXPERIMENTS}
    tracks = {name: item.true_arm for name, item in recorded.items()}
    static = tracks["static"]
    about_mean = [_about_mean(poses) for poses in (static.method, static.ours)]
    text = f"{len(static.frame)} recorded vectors about their own mean; the paper has 106."
    tables = [_table("table1", "Table 1: target at rest", text, *about_mean)]
    for name, key, title in (
        ("circle", "table2", "Table 2: target on a circle"),
        ("trapezium", "table3", "Table 3: target along a trapezium"),
    ):
        track = tracks[name]
        text = f"Recorded minus true pose in the world, over {len(track.frame)} vectors."
        tables.append(_table(key, title, text, track.errors(track.method), track.errors(track.ours)))
    tables += [_accuracy(name, item.nominal_arm) for name, item in recorded.items()]
    return Reproduction(
        paper="pachidis2005",
        title="Pachidis et al. 2005, reproduced",
        source="Robot path generation method for a welding system based on pseudo stereo visual servo control",
        seed=stage.seed,
        tables=tuple(tables),
        figures=_figures(tracks),
        assumptions=ASSUMPTIONS,
        doubts=DOUBTS,
        missing=MISSING,
        settings=tuple(stage.settings),
    )


def _record(stage: Stage, name: str) -> _Recorded:
    """Return the recorded poses of one experiment by both methods; armsight's files are written."""
    folder = stage.simulate(f"pachidis2005-{name}", least=LEAST_FRAMES, room="dark")
    out = stage.out / f"pachidis2005-{name}-measured"
    rig, target, times = (folder / name for name in ("rig.yaml", "target.yaml", "times.csv"))
    stage.measure(rig=rig, target=target, image=str(folder / "image"), times=times, out=out)
    times_s = read_times(folder / "times.csv")
    seen = _by_paper(folder, _Vision(rig=read_rig(folder / "rig.yaml"), target=read_target(folder / "target.yaml")))
    measured = measured_poses(out / "poses.csv")
    motion = read_joints(folder / "joints.csv")
    q = motion.q[np.abs(motion.t_s[None] - times_s[:, None]).argmin(axis=1)]
    truth = [pose.T_parent_target for pose in read_poses(folder / "truth_world.csv", parent="world", measured=False)]
    true = np.array([T for T in truth if T is not None])
    placed = []
    for name_of_arm in ("arm_true", "arm"):
        T_world_rig = read_arm(folder / f"{name_of_arm}.yaml").fk(q)
        method, ours = ({i: T_world_rig[i] @ T for i, T in poses.items()} for poses in (seen, measured))
        placed.append(joined(times_s, method, ours, true))
    return _Recorded(true_arm=placed[0], nominal_arm=placed[1])


def _by_paper(folder: Path, vision: _Vision) -> dict[int, Array]:
    """Return T_rig_target (4, 4) by frame as the paper's method gives it; frames without six areas are left out."""
    psvs, rig = _psvs(vision.rig), vision.rig
    rows, columns = np.mgrid[0 : rig.left.height, 0 : rig.left.width]
    mask = (np.abs(columns - psvs.u0_px) < MASK_PX[0]) & (np.abs(rows - psvs.v0_px) < MASK_PX[1])
    out: dict[int, Array] = {}
    order = [vision.target.names.index(name) for name in "ABC"]
    for i, path in enumerate(sorted((folder / "image").glob("*.png"))):
        try:
            left, right = paper.light_pairs(paper.lit_areas(read_image(path), THRESHOLD, mask))
        except NotEnoughData:
            continue
        out[i] = paper.pose_of_three(psvs.positions(left, right), vision.target.xyz_m[order])
    return out


def _psvs(rig: Rig) -> paper.Psvs:
    """Return the rig in the paper's terms."""
    au, av, u0, v0 = rig.right.intrinsics[:4]
    plate = rig.left.plate
    m, shift = paper.plate_shift(plate.thickness_m, plate.index) if plate else (0.0, 0.0)
    baseline_m = 2.0 * float(rig.T_rig_right.translation[0])
    return paper.Psvs(au_px=au, av_px=av, u0_px=u0, v0_px=v0, baseline_m=baseline_m, m_m=m, l_m=shift)


def _about_mean(poses: Array) -> Array:
    """Return poses (n, 4, 4) minus their mean, (n, 6)."""
    mean = np.eye(4)
    mean[:3, :3] = Rotation.from_matrix(poses[:, :3, :3]).mean().as_matrix()
    mean[:3, 3] = poses[:, :3, 3].mean(axis=0)
    off = pose_differences(poses, np.tile(mean, (len(poses), 1, 1)))
    return np.asarray(off - off.mean(axis=0))


def _table(name: str, title: str, text: str, method: Array, ours: Array) -> ComparisonTable:
    """Return a printed table beside the same figures of errors (n, 6) by both methods."""
    take = {
        "me": lambda e: e.mean(axis=0),
        "mae": lambda e: np.abs(e).mean(axis=0),
        "max": lambda e: np.abs(e).max(axis=0),
        "sd": lambda e: e.std(axis=0, ddof=1),
    }
    rows = []
    for kind, printed in PRINTED[name].items():
        values = take[kind](method), take[kind](ours)
        for k, coordinate in enumerate(POSE6):
            stem, _, unit = coordinate.rpartition("_")
            credible, note = _belief(name, kind, k)
            rows.append(
                ComparedRow(
                    name=f"{stem}_{kind}_{unit}",
                    label=f"{stem}, {kind.upper()}",
                    unit=unit,
                    paper=printed[k] * UNITS[k],
                    paper_method=float(values[0][k]),
                    armsight=float(values[1][k]),
                    truth=0.0,
                    paper_truth=0.0,
                    credible=credible,
                    note=note,
                )
            )
    return ComparisonTable(name=name, title=title, text=text, rows=tuple(rows))


def _belief(table: str, kind: str, k: int) -> tuple[bool, str]:
    """Return whether a printed figure of coordinate k can be believed as what it is called, and why not."""
    if table == "table1" and kind == "me":
        return False, "about the own mean: zero by construction"
    if table == "table1" and k >= 3:
        return False, "the printed angles seem frozen, see the doubts"
    if table == "table3" and kind == "me" and k >= 2:
        return False, "the printed mean seems to be about itself, see the doubts"
    return True, ""


def _accuracy(name: str, track: PoseTracks) -> ComparisonTable:
    """Return the errors against the truth, which the paper does not print in this form."""
    rows = statistic_rows(track.errors(track.method), track.errors(track.ours), ("rms",))
    return ComparisonTable(
        name=f"accuracy_{name}",
        title=f"Accuracy in the world: {name}",
        text=f"Recorded minus true pose over {len(track.frame)} frames, RMS; the arm's own errors are in both.",
        rows=rows,
    )


def _figures(tracks: Mapping[str, PoseTracks]) -> tuple[PaperFigure, ...]:
    static, circle, trapezium = (tracks[name] for name in EXPERIMENTS)
    return (
        PaperFigure(
            name="Fig. 7: target at rest",
            text="Recorded places about the true one.",
            panels=(_plane(static, 0, 1, static.true[0, :3, 3]), _plane(static, 1, 2, static.true[0, :3, 3])),
        ),
        PaperFigure(
            name="Fig. 8: target on a circle",
            text="The generated arc, positions and rotations over time (against the first true pose).",
            panels=(_plane(circle, 0, 1), *_over_time(circle)),
        ),
        PaperFigure(
            name="Fig. 9: target along a trapezium",
            text="The generated path, in two planes, and the angles over time (against the first true pose).",
            panels=(_plane(trapezium, 0, 1), _plane(trapezium, 1, 2), *_over_time(trapezium)[3:]),
        ),
    )


def _plane(track: PoseTracks, h: int, v: int, about: Array | None = None) -> Panel:
    zero = np.zeros(3) if about is None else about
    curves = []
    for name, poses, who in zip(
        NAMES, (track.true, track.method, track.ours), ("truth", "method", "ours"), strict=True
    ):
        xyz = (poses[:, :3, 3] - zero) / MM
        mode = "lines+markers" if who == "truth" else "markers"
        curves.append(Curve(name=name, x=xyz[:, h], y=xyz[:, v], who=who, mode=mode))
    off = "" if about is None else " minus true"
    return Panel(x_title=f"{'xyz'[h]}{off}, mm", y_title=f"{'xyz'[v]}{off}, mm", curves=tuple(curves), equal=True)


def _over_time(track: PoseTracks) -> list[Panel]:
    columns = [_columns(poses, track.true[0]) for poses in (track.true, track.method, track.ours)]
    units = ("mm", "mm", "mm", "°", "°", "°")
    return [
        time_panel(f"{SHOWN[k]}, {units[k]}", track.t_s, [column[:, k] for column in columns], NAMES) for k in range(6)
    ]


def _columns(poses: Array, first: Array) -> Array:
    turned = Rotation.from_matrix(poses[:, :3, :3] @ first[:3, :3].T)
    return np.hstack([poses[:, :3, 3] / MM, np.unwrap(euler_rad(turned), axis=0) / DEG])
