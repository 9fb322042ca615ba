"""path.csv: a path of the tool's tip; and plan.csv, which has its columns: the motions of an ISO 9283 test."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from armsight.columns import POSE7, POSITION, QUATERNION
from armsight.errors import BadFile, Inconsistent
from armsight.geometry import pose_from_quat, xyz_quat
from armsight.records import WELD_OFF, WELD_ON, TaughtPath
from armsight.store.atomic import read_bytes, write_text
from armsight.store.codec import named
from armsight.store.tables import MAX_BYTES, cells, number, parse_table, word
from armsight.verify.iso9283 import TestPlan

COLUMNS = ("index", "t_s", *POSITION, *QUATERNION, "speed_m_s", "tag")
SWITCHES = (WELD_ON, WELD_OFF)
TAG = re.compile(r"[\w.-]{0,40}")


def write_path(path: Path, taught: TaughtPath) -> None:
    """Write path.csv in one step."""
    write_text(path, path_text(taught))


def path_text(taught: TaughtPath) -> str:
    """Return a path.csv; what is not known (times, speeds) is left empty."""
    rows = [",".join(COLUMNS)]
    for i, pose in enumerate(taught.poses):
        xyz, quat = xyz_quat(pose)
        speed = number(taught.speed_m_s[i])
        rows.append(f"{i},{number(taught.t_s[i])},{cells([*xyz, *quat])},{speed},{word(taught.tags[i])}")
    return "\n".join(rows) + "\n"


def read_path(path: Path, *, parent: str = "world") -> TaughtPath:
    """Return the path in a path.csv, in the frame parent; see parse_path."""
    return parse_path(read_bytes(path, limit=MAX_BYTES), str(path), parent=parent)


def _check_tag(tag: str, where: str) -> None:
    """Raise BadFile for what is no tag, and for one that looks as though it switched the weld."""
    if not TAG.fullmatch(tag):
        raise BadFile(f"{where}, column tag: {tag[:40]!r} is not one word")
    meant = tag.lower().replace("-", "_")
    if tag not in SWITCHES and meant in SWITCHES:
        raise BadFile(
            f"{where}, column tag: {tag!r} is not {meant!r}",
            consequence="The weld would not be switched there",
            cure=f"Write {meant}",
        )


def parse_path(data: bytes, where: str, *, parent: str = "world") -> TaughtPath:
    """Return the path in the bytes of a path.csv.

    t_s, speed_m_s and tag may be missing or empty, and so may index, by which rows are in order otherwise. Raises
    BadFile that names file, line and column; NotEnoughData without a row.
    """
    table = parse_table(
        data,
        where,
        (*POSITION, *QUATERNION),
        optional=("index", "t_s", "speed_m_s", "tag"),
        text=("tag",),
        blank=("t_s", "speed_m_s"),
    )
    n = len(table)
    index = table.numbers.get("index")
    if index is not None and np.any(np.diff(index) <= 0.0):
        row = int(np.argmax(np.diff(index) <= 0.0)) + 1
        raise BadFile(f"{table.location(row)}, column index: {index[row]:g} does not follow {index[row - 1]:g}")
    tags = table.text.get("tag", ("",) * n)
    for row, tag in enumerate(tags):
        _check_tag(tag, table.location(row))
    T = np.empty((n, 4, 4))
    xyz, quat = table.stacked(POSITION), table.stacked(QUATERNION)
    for row in range(n):
        with named(table.location(row)):
            T[row] = pose_from_quat(xyz[row], quat[row]).as_matrix()
    nothing = np.full(n, np.nan)
    try:
        return TaughtPath(
            T_world_tip=T,
            t_s=table.numbers.get("t_s", nothing),
            speed_m_s=table.numbers.get("speed_m_s", nothing),
            tags=tuple(tags),
            parent=parent,
        )
    except Inconsistent as error:
        raise BadFile(f"{where}: {error.cause}", consequence=error.consequence, cure=error.cure) from None


PLAN_COLUMNS = ("index", *POSE7, "speed_m_s", "tag", "pose", "repeats")


def write_test_plan(path: Path, plan: TestPlan) -> None:
    """Write plan.csv in one step: one row per commanded pose, in world, in the order of the motions.

    tag: the motion's name; pose: P1 to P5, empty on the way; repeats: how often the whole motion is made. Raises
    DeviceFailed where the disk refuses.
    """
    n = plan.motions[0].q.shape[1]
    rows = [",".join([*PLAN_COLUMNS, *(f"q{i + 1}" for i in range(n))])]
    for motion in plan.motions:
        for name, xyz, q in zip(motion.names, motion.xyz_m, motion.q, strict=True):
            numbers = cells(np.concatenate([xyz, plan.quat_xyzw, [plan.speed_m_s]]))
            rows.append(f"{len(rows) - 1},{numbers},{motion.test},{name},{motion.repeats},{cells(q)}")
    write_text(path, "\n".join(rows) + "\n")
