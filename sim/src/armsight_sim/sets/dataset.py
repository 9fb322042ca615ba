"""A simulated set: files as a person would have them, the truth, and the commands that read them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.errors import UsageError
from armsight.geometry import xyz_quat
from armsight.records import Frame

Table = tuple[Sequence[str], Sequence[Sequence[float | str]]]
"""Names of the columns, and the rows."""

QUATERNION = ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Dataset:
    """Files by name: rigs, cameras, targets and arms as their files have them, further documents, and tables.

    images: yields the name without ending, and the frame, of n_images pictures. commands: what reads the set, run
    in its folder. assumptions: every number that was chosen.
    """

    name: str
    seed: int
    commands: tuple[str, ...]
    assumptions: tuple[str, ...]
    rigs: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    cameras: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    targets: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    arms: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    truths: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    tables: Mapping[str, Table] = field(default_factory=dict)
    n_images: int = 0
    images: Callable[[], Iterator[tuple[str, Frame]]] = lambda: iter(())


def checked_size(size: int | None, usual: int, least: int, what: str) -> int:
    """Return how many are asked for, or the usual number. Raises UsageError for fewer than the least."""
    if size is not None and size < least:
        raise UsageError(f"{size} {what} are too few for the calibration", cure=f"Ask for {least} or more, or leave it")
    return usual if size is None else size


def row_of(pose: RigidTransform) -> list[float]:
    """Return a pose as the columns QUATERNION have it."""
    xyz, quat = xyz_quat(pose)
    return [*xyz.tolist(), *quat.tolist()]


def with_noise(pose: RigidTransform, rng: np.random.Generator, *, length_m: float, angle_rad: float) -> RigidTransform:
    """Return a pose as read with normal errors of so much along and about each axis of its own."""
    turn = Rotation.from_rotvec(rng.normal(0.0, angle_rad, 3))
    return pose * RigidTransform.from_components(rng.normal(0.0, length_m, 3), turn)
