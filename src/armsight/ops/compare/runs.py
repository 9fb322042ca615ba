"""Two measurements pose by pose, and two verifications figure by figure."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import bdtr

from armsight.arrays import Array
from armsight.columns import POSE6
from armsight.errors import BadFile, NotEnoughData
from armsight.file_names import MEASURE
from armsight.measure.results import MadeWith
from armsight.measure.series import INSIDE_95
from armsight.ops.compare.calibrations import Compared, Effect
from armsight.ops.verification.run import MAX_SUMMARY_BYTES, read_run
from armsight.records import PoseStatus, TargetPose
from armsight.records.result_parts import Difference
from armsight.store import read_poses
from armsight.store.atomic import read_bytes
from armsight.store.codec import read_output
from armsight.verify.iso9283.figure import unit_of


@dataclass(frozen=True, slots=True)
class Shared:
    """Whether two measurements were made with one rig and one target; None: not recorded of one of them."""

    rig: bool | None
    target: bool | None

    @property
    def warning(self) -> str:
        """What the verdict must add: empty where nothing is known to differ."""
        other = [name for name, same in (("rig", self.rig), ("target", self.target)) if same is False]
        return f"They were measured with another {' and another '.join(other)}." if other else ""

    @property
    def notes(self) -> list[str]:
        """What to know of the comparison."""
        if self.rig is None:
            return [
                "Not recorded of both: which rig and target they were measured with (no measure.json beside poses.csv)."
            ]
        words = {
            (True, True): "One rig and one target: what is wrong with either is in both, and is not seen here.",
            (
                False,
                True,
            ): "Two rigs, or one calibrated anew: each brings its own errors, and its own axes where no world "
            "is given.",
            (
                True,
                False,
            ): "Two targets, or one measured anew: each has its own axes, and poses of two targets differ by that.",
            (False, False): "Two rigs and two targets: their axes and errors are in the differences.",
        }
        return [words[self.rig, bool(self.target)]]


def shared(a: Path, b: Path) -> Shared:
    """Tell of two poses.csv what their measurements share. Raises BadFile for a measure.json that is none."""
    first, second = _made_with(a.with_name(MEASURE)), _made_with(b.with_name(MEASURE))
    if first is None or second is None:
        return Shared(None, None)
    return Shared(first.rig == second.rig, first.target == second.target)


def _made_with(path: Path) -> MadeWith | None:
    """Return what measure.json keeps of rig and target; None where it, or they in it, are not there."""
    if not path.exists():
        return None
    data = read_bytes(path, limit=MAX_SUMMARY_BYTES)
    try:
        held = json.loads(data)
        made = held.get("made_with") if isinstance(held, dict) else None
        return None if made is None else read_output(MadeWith, made, path.name)
    except (ValueError, BadFile, RecursionError) as error:
        raise BadFile(
            f"{path}: not the summary of a measurement ({str(error).splitlines()[0]})",
            consequence="Whether both runs had one rig and target cannot be told",
            cure="Give the folder that `armsight measure -o` wrote, or poses.csv copied out of it",
        ) from error


TOO_FEW_INSIDE = 0.005
"""Two measurements disagree where chance leaves so few differences inside their ellipsoid less often than this."""

APART = 0.25
"""Share of the frames' interval up to which two times are one moment."""

NOTES = (
    "Standard deviations of the means are those of one pose: errors that all poses share do not average out.",
    "Poses of one recording share its noise, and agree more closely than two recordings do.",
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tracks:
    """Differences B less A (n, 6) in m and rad at t_s (n,), rotations as vectors in the parent's axes, and the standard
    deviations (n, 6) of them as of independent measurements. p: how often chance leaves so few inside; None: unknown.
    shared: whether both had one rig and one target.
    """

    compared: Compared
    t_s: Array
    values: Array
    std: Array
    p: float | None
    shared: Shared


def compare_tracks(a: Path, b: Path) -> Tracks:
    """Compare the full poses of two poses.csv that stand for one moment. Raises BadFile, NotEnoughData."""
    first, second = ([p for p in read_poses(file, timed=False) if p.status is PoseStatus.OK] for file in (a, b))
    rows = _together(np.array([p.t_s for p in first]), np.array([p.t_s for p in second]))
    if len(rows) < 2:
        raise NotEnoughData(
            f"{len(rows)} poses of {a} and {b} are of one moment",
            consequence="Nothing was compared",
            cure="Give two measurements of one recording, or of runs whose times begin together",
        )
    values = np.array([_difference(first[i], second[j]) for i, j in rows])
    covariance = np.array([_covariance(first[i]) + _covariance(second[j]) for i, j in rows])  # (n, 6, 6)
    variance = np.diagonal(covariance, axis1=1, axis2=2)
    known = np.asarray((variance > 0.0).all(axis=1))
    std = np.where(known[:, None], np.sqrt(variance), np.nan)
    p, inside = _judged(values[known], covariance[known])
    common = shared(a, b)
    return Tracks(
        compared=Compared(
            differences=_means(np.array([_six(first[i]) for i, _ in rows]), values, std[known]),
            covariances=(None, None),
            effects=_apart(values, inside),
            notes=(*common.notes, *NOTES),
        ),
        t_s=np.array([first[i].t_s for i, _ in rows]),
        values=values,
        std=std,
        p=p,
        shared=common,
    )


def _means(a: Array, values: Array, std: Array) -> list[Difference]:
    """Return the means of A's poses and of the differences (n, 6), beside the std (k, 6) of single differences."""
    typical = np.sqrt((std**2).mean(axis=0)) if len(std) else None
    start, off = a.mean(axis=0), values.mean(axis=0)
    return [
        Difference(
            name=f"mean {name}",
            unit="m" if k < 3 else "rad",
            a=float(start[k]),
            b=float(start[k] + off[k]),
            difference=float(off[k]),
            std=None if typical is None else float(typical[k]),
        )
        for k, name in enumerate(POSE6)
    ]


def _apart(values: Array, inside: float | None) -> list[Effect]:
    """Return how far the poses are apart, and the share of them inside the 95 % ellipsoid of the difference."""
    distance, turn = np.linalg.norm(values[:, :3], axis=1), np.linalg.norm(values[:, 3:], axis=1)
    return [
        Effect(name="place apart, RMS", value=float(np.sqrt(np.mean(distance**2))), unit="m"),
        Effect(name="place apart, largest", value=float(distance.max()), unit="m"),
        Effect(name="turned, RMS", value=float(np.sqrt(np.mean(turn**2))), unit="rad"),
        Effect(name="turned, largest", value=float(turn.max()), unit="rad"),
        *([] if inside is None else [Effect(name="inside their 95 % ellipsoid", value=inside, unit="1")]),
    ]


def _together(a: Array, b: Array) -> list[tuple[int, int]]:
    """Return the rows of both that are of one moment, each used once."""
    if len(a) == 0 or len(b) == 0:
        return []
    steps = np.concatenate([np.diff(a), np.diff(b)])
    apart = APART * float(np.median(steps)) if len(steps) else 0.0
    at = np.clip(np.searchsorted(b, a), 1, max(len(b) - 1, 1))
    after = np.minimum(at, len(b) - 1)
    near = np.where(np.abs(a - b[at - 1]) <= np.abs(b[after] - a), at - 1, after)
    pairs: dict[int, int] = {}
    for i, j in enumerate(near.tolist()):
        if abs(a[i] - b[j]) <= apart and (j not in pairs or abs(a[i] - b[j]) < abs(a[pairs[j]] - b[j])):
            pairs[j] = i
    return sorted((i, j) for j, i in pairs.items())


def _six(pose: TargetPose) -> Array:
    T = np.asarray(pose.T_parent_target)
    return np.concatenate([T[:3, 3], Rotation.from_matrix(T[:3, :3]).as_rotvec()])


def _difference(a: TargetPose, b: TargetPose) -> Array:
    A, B = np.asarray(a.T_parent_target), np.asarray(b.T_parent_target)
    return np.concatenate([B[:3, 3] - A[:3, 3], Rotation.from_matrix(B[:3, :3] @ A[:3, :3].T).as_rotvec()])


def _covariance(pose: TargetPose) -> Array:
    return np.zeros((6, 6)) if pose.covariance is None else pose.covariance


def _judged(values: Array, covariance: Array) -> tuple[float | None, float | None]:
    """Return how often chance leaves so few differences inside their 95 % ellipsoid, and the share that is inside."""
    n = len(values)
    if n == 0:
        return None, None
    std = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))  # scaled by it: metres and radians are far apart
    correlation = covariance / (std[:, :, None] * std[:, None, :])
    distance2 = np.einsum("ni,nij,nj->n", values / std, np.linalg.pinv(correlation, hermitian=True), values / std)
    inside = int(np.count_nonzero(distance2 <= INSIDE_95))
    return float(bdtr(inside, n, 0.95)), inside / n


def compare_verifications(a: Path, b: Path) -> Compared:
    """Compare the figures of two folders of `verify`. Raises BadFile, and NotEnoughData where no figure is in both."""
    first, second = read_run(a), read_run(b)
    found: list[Difference] = []
    for name, one in first.iso9283.items():
        other = second.iso9283.get(name)
        if other is not None and one.value is not None and other.value is not None:
            known = one.std is not None and other.std is not None
            std = float(np.hypot(one.std or 0.0, other.std or 0.0)) or None if known else None
            found.append(_of(name, one.value, other.value, std))
    for joint in first.joints:
        twin = next((each for each in second.joints if each.index == joint.index), None)
        if twin is None or joint.offset_rad is None or twin.offset_rad is None:
            continue
        known = joint.std_rad is not None and twin.std_rad is not None
        std = float(np.hypot(joint.std_rad or 0.0, twin.std_rad or 0.0)) or None if known else None
        found.append(_of(f"joint {joint.index} zero_rad", joint.offset_rad, twin.offset_rad, std))
    effects: list[Effect] = []
    if first.after is not None and second.after is not None:
        for key, words in (("rms_m", "error of place, RMS"), ("max_m", "error of place, largest")):
            for name, run in (("A", first.after), ("B", second.after)):
                effects.append(Effect(name=f"{words}, {name}", value=float(getattr(run, key)), unit="m"))
    if not found and not effects:
        raise NotEnoughData(
            f"{a} and {b} have no figure in common",
            consequence="Nothing was compared",
            cure="Give two runs of one test",
        )
    notes = [f"Cause in A: {first.cause}; in B: {second.cause}."] if first.cause or second.cause else []
    return Compared(differences=found, covariances=(None, None), effects=effects, notes=notes)


def _of(name: str, a: float, b: float, std: float | None) -> Difference:
    _, unit = unit_of(name if name.startswith("joint") else name.partition(" ")[0])
    return Difference(name=name, unit=unit, a=a, b=b, difference=b - a, std=std)
