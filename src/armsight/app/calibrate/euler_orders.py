"""Robot poses that contradict the camera's because their Euler angles were read in another order than theirs."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import permutations
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.calibrate.handeye import (
    HandEye,
    ImageHandEye,
    PosePairs,
    Setup,
    calibrate_eye_in_hand,
    calibrate_eye_to_hand,
    calibrate_from_views,
)
from armsight.calibrate.handeye.consensus import RIGHT, consensus
from armsight.calibrate.handeye.image_model import poses_of_views
from armsight.errors import ArmsightError, Inconsistent
from armsight.optics import Camera
from armsight.records import BoardView, Target
from armsight.store.handeye_file import read_pairs
from armsight.store.interpret import TableFormat

SAME = 1e-9
"""Rotation matrices that differ by less are of one reading."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ViewsOfHand:
    """A board seen with a hand: what a calibration from images is made of, but the robot's poses."""

    views: Sequence[BoardView]
    camera: Camera
    board: Target
    setup: Setup
    free_camera: bool = False

    def calibrated(
        self,
        robot: Mapping[str, RigidTransform],
        table: TableFormat,
        again: Callable[[TableFormat], Mapping[str, RigidTransform]],
    ) -> ImageHandEye:
        """Return the calibration. robot: T_base_flange by the image's name; again: reads it in another format.

        Raises as calibrate_from_views; Inconsistent with the order of Euler angles that fits where one does.
        """
        names = [Path(view.source).name for view in self.views]
        poses = [robot[name] for name in names]
        try:
            return calibrate_from_views(
                self.views, poses, self.camera, self.board, self.setup, free_camera=self.free_camera
            )
        except Inconsistent as error:
            seen = poses_of_views(self.views, self.camera, self.board).T_camera_target
            targets = [seen[i] for i in range(len(names))]

            def read(other: TableFormat) -> PosePairs:
                found = again(other)
                return PosePairs.of([found[name] for name in names], targets)

            raise _with_order(error, read, self.setup, table) from error


def calibrated_pairs(path: Path, table: TableFormat, setup: Setup) -> HandEye:
    """Return the calibration from a pairs.csv. Raises as ViewsOfHand.calibrated."""
    pairs = read_pairs(path, table)
    try:
        return solve_pose_pairs(pairs, setup)
    except Inconsistent as error:
        raise _with_order(error, lambda other: read_pairs(path, other), setup, table) from error


def solve_pose_pairs(pairs: PosePairs, setup: Setup) -> HandEye:
    """Return the calibration from pairs. Raises as calibrate_eye_in_hand."""
    return calibrate_eye_in_hand(pairs) if setup is Setup.EYE_IN_HAND else calibrate_eye_to_hand(pairs)


def _with_order(
    error: Inconsistent, read: Callable[[TableFormat], PosePairs], setup: Setup, table: TableFormat
) -> Inconsistent:
    """Return the refusal of poses, with the order of Euler angles that makes them agree where one does.

    read: gives the pairs of the same file in another format. Tables without Euler angles are the same in every order.
    """
    tried: list[np.ndarray] = []
    fits = []
    given = read(replace(table, notify=lambda text: None)).T_base_flange.rotation.as_matrix()
    for order in orders():
        try:
            pairs = read(replace(table, euler=order, notify=lambda text: None))
        except ArmsightError:  # out of the range of this order, or columns that it does not have
            continue
        R = pairs.T_base_flange.rotation.as_matrix()
        if any(np.abs(R - other).max() < SAME for other in tried):
            continue
        tried.append(R)
        found = consensus(pairs.arrays(setup))
        if found.share < RIGHT:
            fits.append((found.score, order, bool(np.abs(R - given).max() < SAME)))
    if len(tried) < 2 or not fits:
        return error
    _, order, as_given = min(fits)
    if as_given:  # what is wrong is not the order
        return error
    stated = f" read as {table.order}" if table.order else ""
    return Inconsistent(
        f"the robot's Euler angles{stated} contradict the camera's poses; read as {order} they agree",
        consequence="Read as they are, they are other rotations; no calibration is given",
        cure=f"Give --euler {order}",
    )


def orders() -> Iterator[str]:
    """Yield the twelve orders of Euler angles, each about axes that stand and about axes carried along."""
    for kind in ("", "-fixed"):
        for axes in permutations("xyz"):
            yield "".join(axes) + kind
        for first, second in permutations("xyz", 2):
            yield first + second + first + kind
