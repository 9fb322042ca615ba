"""poses.csv, points.csv, spots.csv, joints.csv, times.csv and TUM."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array
from armsight.clock import Clock
from armsight.columns import POSE6_STD, POSITION, QUATERNION
from armsight.errors import BadFile
from armsight.geometry import pose_from_quat, quat_of_matrix, xyz_quat
from armsight.geometry.poses import QUAT_NORM_TOLERANCE
from armsight.records import Motion, Points, PoseStatus, Spots, TargetPose
from armsight.store import covariances
from armsight.store.atomic import RowFile, read_bytes, write_text
from armsight.store.codec import LARGEST, named
from armsight.store.interpret import OURS, TableFormat
from armsight.store.lost import lost_rows, lost_words, without_lost
from armsight.store.tables import MAX_BYTES, Table, cells, in_time, number, parse_table, word

IDENTITY = (0.0, 0.0, 0.0, 1.0)
POINT_COLUMNS = ("t_s", "spot", *POSITION, *POSE6_STD[:3])
LATEST_S = 1e11
"""No time of a frame is later: clocks of today count 1.8e9 s since 1970, which are 1.8e12 ms and 1.8e18 ns."""
SPOT_COLUMNS = ("t_s", "camera", "spot", "u_px", "v_px", "su_px", "sv_px")


class _Writer(RowFile):
    columns: tuple[str, ...]

    def __init__(self, path: Path, *, clock: Clock | None = None) -> None:
        super().__init__(path, ",".join(self.columns), clock=clock)


class PosesWriter(_Writer):
    """poses.csv, row by row: an interrupted run leaves what was measured."""

    columns = (
        *covariances.POSE_COLUMNS,
        *(name for name in covariances.POSE_EXTRAS if name not in (*covariances.VELOCITY, *covariances.VELOCITY_STD)),
    )

    def write(self, pose: TargetPose) -> None:
        """Add one pose."""
        self.add(pose_row(pose))


class MovingPosesWriter(_Writer):
    """poses.csv with velocities, m/s and rad/s in the poses' frame, and their standard deviations behind."""

    columns = (*covariances.POSE_COLUMNS, *covariances.POSE_EXTRAS)

    def write(self, pose: TargetPose, velocity: Array | None, std: Array | None) -> None:
        """Add one pose with velocity (6,) and its standard deviations (6,); None where they are not known."""
        known = velocity is not None and std is not None
        values = np.concatenate([velocity, std]).tolist() if known else [math.nan] * 12
        self.add(f"{_pose_cells(pose)},{cells(values)},{_covariance_cells(pose)}")


class PointsWriter(_Writer):
    """points.csv, row by row."""

    columns = (*POINT_COLUMNS, *covariances.POINT_COVARIANCE, "status")

    def write(self, t_s: float, points: Points, *, status: PoseStatus = PoseStatus.OK) -> None:
        """Add the points of one moment, in rig axes; status: DOUBTFUL where they are not to be acted on."""
        if not len(points):
            return
        deviation = np.sqrt(np.diagonal(points.covariance_m2, axis1=1, axis2=2))  # (n, 3)
        related = points.covariance_m2[:, (0, 0, 1), (1, 2, 2)].tolist()  # xy, xz, yz
        rows = zip(points.names, points.xyz_m.tolist(), deviation.tolist(), related, strict=True)
        for name, xyz, std, off in rows:
            self.add(f"{number(t_s)},{word(name)},{cells(xyz)},{cells(std)},{cells(off)},{status.value}")


def restate_points(path: Path, status: Mapping[float, PoseStatus]) -> None:
    """Give the rows of a points.csv the status of their moment, by t_s."""
    head, *rows = path.read_text(encoding="utf-8").splitlines()  # our own, of any size
    words = {number(t_s): one.value for t_s, one in status.items()}
    lines = (f"{row.rpartition(',')[0]},{words.get(row.partition(',')[0], row.rpartition(',')[2])}" for row in rows)
    write_text(path, "\n".join([head, *lines]) + "\n")


class SpotsWriter(_Writer):
    """spots.csv, row by row."""

    columns = SPOT_COLUMNS

    def write(self, t_s: float, camera: str, names: Sequence[str], spots: Spots) -> None:
        """Add the spots of one image, named in their order; camera is 'left' or 'right'."""
        if not len(spots):
            return
        deviation = np.sqrt(np.diagonal(spots.covariance_px2, axis1=1, axis2=2))  # (n, 2)
        for name, uv, std in zip(names, spots.uv_px.tolist(), deviation.tolist(), strict=True):
            self.add(f"{number(t_s)},{word(camera)},{word(name)},{cells(uv)},{cells(std)}")


def pose_row(pose: TargetPose) -> str:
    """Return one row of poses.csv: cells that mean nothing are empty, spots are separated by spaces.

    ok, doubtful: all cells but lights_... and slights_.... position_only: the target's origin is not known, those are
    the mean of the lights seen and its standard deviations; where the origin is known after all, its position, no
    quaternion, no srx..srz. lost: only t_s, status, spots. sys_...: the standard deviations of what repeats from
    frame to frame (rig and target), empty where nothing is known of it. cov_..., sys_cov_...: what stands beside
    these on the diagonal; of a position three cells.
    """
    return f"{_pose_cells(pose)},{_covariance_cells(pose)}"


def _covariance_cells(pose: TargetPose) -> str:
    own_origin = pose.status is not PoseStatus.POSITION_ONLY or pose.origin_known
    systematic = pose.systematic_covariance if own_origin else None
    return cells([*covariances.above_diagonal(pose.covariance), *covariances.above_diagonal(systematic)])


def _pose_cells(pose: TargetPose) -> str:
    values, systematic, lights = [math.nan] * 13, [math.nan] * 6, [math.nan] * 6
    T = pose.T_parent_target
    if pose.status is PoseStatus.POSITION_ONLY and not pose.origin_known:
        if T is not None and pose.covariance is not None:
            lights = [*T[:3, 3].tolist(), *(math.sqrt(v) for v in pose.covariance.diagonal().tolist())]
    elif T is not None and pose.covariance is not None:
        values[:3] = T[:3, 3].tolist()
        variances = pose.covariance.diagonal().tolist()
        values[7 : 7 + len(variances)] = [math.sqrt(v) for v in variances]
        if pose.status.size == 6:
            values[3:7] = quat_of_matrix(T)
        if pose.systematic_covariance is not None:
            variances = pose.systematic_covariance.diagonal().tolist()
            systematic[: len(variances)] = [math.sqrt(max(v, 0.0)) for v in variances]
    row = f"{number(pose.t_s)},{cells(values)},{pose.status.value},{word(' '.join(pose.spots))}"
    return f"{row},{cells(systematic)},{cells(lights)}"


def write_poses(path: Path, poses: Iterable[TargetPose]) -> None:
    """Write poses.csv in one step."""
    write_text(path, "\n".join([",".join(PosesWriter.columns), *(pose_row(pose) for pose in poses)]) + "\n")


def read_poses(
    path: Path,
    *,
    parent: str = "rig",
    format_: TableFormat = OURS,
    timed: bool = True,
    stream: bool = False,
    measured: bool = True,
) -> tuple[TargetPose, ...]:
    """Return the poses in a poses.csv, or in a file that can be understood as one, in the frame parent.

    timed: times are needed; else rows without them are counted. See parse_poses and interpret.
    """
    from armsight.store.interpret.read import standard_bytes  # in functions, as most commands read no table

    data = standard_bytes(path, "poses" if timed else "untimed-poses", format_)
    return parse_poses(data, str(path), parent=parent, notify=format_.notify, stream=stream, measured=measured)


def parse_poses(
    data: bytes,
    where: str,
    *,
    parent: str = "rig",
    notify: Callable[[str], None] = OURS.notify,
    stream: bool = False,
    measured: bool = True,
) -> tuple[TargetPose, ...]:
    """Return the poses in the bytes of a poses.csv, in the frame parent.

    The covariances come back whole; diagonal in files of standard deviations only (has_correlations tells), zero where
    the standard deviations' cells or columns are empty. The columns from sx_m on may be missing (status is then ok). A
    position_only row has the mean of its lights in lights_...; in files of earlier versions, which lack these columns,
    in x_m to z_m. Rows in which nothing was measured (lost_rows) come back as lost; measured: False for poses that are
    asked for. stream: times must increase; rows that repeat the row before, stamp and all, and lost ones of what was
    measured are left out. Raises BadFile, naming file, line and column.
    """
    table = parse_table(
        data,
        where,
        covariances.POSE_COLUMNS[:8],
        optional=(*covariances.POSE_COLUMNS[8:], *covariances.POSE_EXTRAS),
        text=("status", "spots"),
        blank=(*covariances.POSE_COLUMNS[1:14], *covariances.POSE_EXTRAS),
    )
    if stream and measured:
        table = without_lost(table, notify)
    table = in_time(table, notify) if stream else table
    lost = {} if stream and measured else lost_rows(table, measured=measured)
    if lost:
        notify(f"{where}: {lost_words(lost, table)}")
    statuses = [PoseStatus.LOST if row in lost else _status(table, row) for row in range(len(table))]
    seen = [row for row, status in enumerate(statuses) if status is not PoseStatus.LOST]
    apart = [row for row in seen if statuses[row] is PoseStatus.POSITION_ONLY]
    of_lights = {row for row in apart if _has(table, row, covariances.LIGHTS)}
    xyz = [_full(table, row, covariances.LIGHTS if row in of_lights else POSITION) for row in seen]
    quat = [_full(table, row, QUATERNION) if statuses[row].size == 6 else IDENTITY for row in seen]
    T = _stack(np.array(xyz), np.array(quat), [table.location(row) for row in seen]).as_matrix() if seen else ()
    poses = dict(zip(seen, T, strict=True))
    known = covariances.pose_covariances(table, [status.size for status in statuses], of_lights)
    return tuple(
        _target_pose(table, row, statuses[row], poses.get(row), parent, known.get(row), of_lights=row in of_lights)
        for row in range(len(table))
    )


def _has(table: Table, row: int, names: Sequence[str]) -> bool:
    return any(name in table.numbers and not np.isnan(table.numbers[name][row]) for name in names)


def _status(table: Table, row: int) -> PoseStatus:
    word = table.text["status"][row] if "status" in table.text else "ok"
    try:
        return PoseStatus(word)
    except ValueError:
        raise BadFile(
            f"{table.location(row)}, column status: {word[:40]!r}", cure=f"Write one of {', '.join(PoseStatus)}"
        ) from None


def _stack(xyz_m: Array, quat_xyzw: Array, locations: Sequence[str]) -> RigidTransform:
    """Return the poses as a stack, made at once; BadFile, with the row's place, where a quaternion is none."""
    far = np.abs(np.linalg.norm(np.clip(quat_xyzw, -LARGEST, LARGEST), axis=1) - 1.0) > QUAT_NORM_TOLERANCE
    for row in np.flatnonzero(far).tolist():
        with named(locations[row]):
            pose_from_quat(xyz_m[row], quat_xyzw[row])
    return RigidTransform.from_components(xyz_m, Rotation.from_quat(quat_xyzw))


def _target_pose(
    table: Table,
    row: int,
    status: PoseStatus,
    T: Array | None,
    parent: str,
    known: tuple[Array, Array | None] | None,
    *,
    of_lights: bool,
) -> TargetPose:
    covariance, systematic = (None, None) if known is None else known
    with named(table.location(row)):
        return TargetPose(
            t_s=float(table.numbers["t_s"][row]),
            status=status,
            parent=parent,
            spots=tuple(table.text["spots"][row].split()) if "spots" in table.text else (),
            T_parent_target=T,
            covariance=covariance,
            systematic_covariance=systematic,
            origin_known=status.size == 6
            or (status is PoseStatus.POSITION_ONLY and not of_lights and covariances.LIGHTS[0] in table.numbers),
        )


def _full(table: Table, row: int, names: Sequence[str]) -> Array:
    """Return the cells of one row, none of which may be empty."""
    values = np.array([table.numbers[name][row] for name in names])
    for name, value in zip(names, values, strict=True):
        if np.isnan(value):
            raise BadFile(
                f"{table.location(row)}, column {name}: empty, though the status is not lost",
                cure="Fill the cell, or set the status to lost",
            )
    return values


def read_tum(path: Path) -> tuple[TargetPose, ...]:
    """Return the poses in a TUM file (t x y z qx qy qz qw), as they stand there; see read_poses."""
    columns = TableFormat(columns="t_s,xyz_m,quat_xyzw", as_stated=True)
    return read_poses(path, parent="world", format_=columns, measured=False)


def read_joints(path: Path, format_: TableFormat = OURS, *, timed: bool = True, measured: bool = False) -> Motion:
    """Return the joint values in a joints.csv (t_s, q1, ..., qn; rad, m), or a file that can be understood as one.

    timed: times are needed; else rows without them are counted. measured: it is the log of an arm, whose lost rows
    (lost_rows) are left out; where it is asked for, every row counts. Raises BadFile that names line and column,
    Inconsistent for degrees where radians are meant.
    """
    from armsight.store.interpret.read import standard_bytes

    data = standard_bytes(path, "joints" if timed else "untimed-joints", format_)
    return parse_joints(data, str(path), format_, measured=measured)


def parse_joints(data: bytes, where: str, format_: TableFormat = OURS, *, measured: bool = False) -> Motion:
    """Return the joint values in the bytes of a joints.csv; see read_joints."""
    from armsight.store.interpret.read import check_joint_values

    table = parse_table(data, where, ("t_s", "q1"), series="q", blank=("q",) if measured else ())
    table = in_time(without_lost(table, format_.notify) if measured else table, format_.notify)
    check_joint_values(table.stacked(table.series("q")), where, format_)
    q = table.stacked(table.series("q"))
    if measured:
        from armsight.calibrate.timing.sampling import without_seams  # with all of the clocks, which few commands need

        q = without_seams(q)
    with named(where):
        return Motion(t_s=table.numbers["t_s"], q=q)


def write_joints(path: Path, motion: Motion) -> None:
    """Write joints.csv in one step."""
    header = ",".join(["t_s", *(f"q{i + 1}" for i in range(motion.q.shape[1]))])
    rows = (f"{number(t)},{cells(q)}" for t, q in zip(motion.t_s, motion.q, strict=True))
    write_text(path, "\n".join([header, *rows]) + "\n")


def read_times(path: Path) -> Array:
    """Return the frames' times (n,) in s from a times.csv (column t_s, increasing, one row per frame)."""
    return parse_times(read_bytes(path, limit=MAX_BYTES), str(path))


def parse_times(data: bytes, where: str) -> Array:
    """Return the times in the bytes of a times.csv; see read_times."""
    table = parse_table(data, where, ("t_s",), optional=("frame",))
    t_s = table.numbers["t_s"]
    far = np.flatnonzero(np.abs(t_s) > LATEST_S)
    if far.size:
        raise BadFile(
            f"{table.location(int(far[0]))}, column t_s: {t_s[far[0]]:g} s is more than 3000 years",
            consequence="This is no time in seconds",
            cure="Give seconds; milliseconds are divided by 1e3, nanoseconds by 1e9",
        )
    late = np.flatnonzero(np.diff(t_s) <= 0.0)
    if late.size:
        raise BadFile(
            f"{table.location(int(late[0]) + 1)}, column t_s: the time does not increase",
            consequence="The frames have no order",
            cure="Give one row per frame, in the order of the frames",
        )
    return t_s


def write_tum(path: Path, poses: Iterable[TargetPose]) -> int:
    """Write the poses of status ok as TUM (t x y z qx qy qz qw, for evo); return how many there were."""
    rows = []
    for pose in poses:
        if pose.status is PoseStatus.OK and pose.pose is not None:
            xyz, quat = xyz_quat(pose.pose)
            rows.append(" ".join(number(value) for value in (pose.t_s, *xyz, *quat)))
    write_text(path, "\n".join(["# t_s x_m y_m z_m qx qy qz qw", *rows]) + "\n")
    return len(rows)
