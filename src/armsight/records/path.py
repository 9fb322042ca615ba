"""A path of the tool's tip, as it was taught or made: places, times, speeds and tags."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.errors import Inconsistent
from armsight.records.by_value import Saveable
from armsight.records.checks import checked_array, checked_poses, frozen_array, real_array, require_kind, require_texts

WELD_ON, WELD_OFF = "weld_on", "weld_off"
"""Tags that playing acts on; any other word, or none, is kept and means nothing to it."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TaughtPath(Saveable):
    """Poses of the tip one after the other.

    T_world_tip (n, 4, 4); t_s (n,): when each was taught, growing, or NaN where it was not; speed_m_s (n,): at which it
    is to be passed, NaN where that is open; tags (n,): one word each, empty for none. parent: the frame of the poses,
    world or base.
    """

    T_world_tip: Array
    t_s: Array
    speed_m_s: Array
    tags: tuple[str, ...]
    parent: str = "world"

    def __post_init__(self) -> None:
        object.__setattr__(self, "tags", require_texts("tags", self.tags))
        require_kind("parent", self.parent, str, cure="Name the frame of the poses")
        n = len(self.tags)
        T = frozen_array("T_world_tip", checked_poses("T_world_tip", self.T_world_tip, n), (n, 4, 4))
        object.__setattr__(self, "T_world_tip", T)
        for name in ("t_s", "speed_m_s"):
            values = checked_array(name, getattr(self, name), (n,), nan=True).copy()
            values.setflags(write=False)
            object.__setattr__(self, name, values)
        known = self.t_s[np.isfinite(self.t_s)]
        if np.any(np.diff(known) <= 0.0):
            raise Inconsistent(
                "the times of a path do not grow", consequence="It is not used", cure="Put its rows into their order"
            )
        if np.any(self.speed_m_s[np.isfinite(self.speed_m_s)] <= 0.0):
            raise Inconsistent(
                "a speed of a path is not positive", consequence="It is not used", cure="Give m/s, or NaN for any"
            )

    @classmethod
    def of_poses(
        cls,
        poses: RigidTransform | ArrayLike,
        *,
        t_s: Array | None = None,
        speed_m_s: float | Array = np.nan,
        parent: str = "world",
    ) -> TaughtPath:
        """Return the path through poses, RigidTransform (n) or (n, 4, 4), without tags."""
        T = checked_poses("poses", poses.as_matrix() if isinstance(poses, RigidTransform) else poses)
        n, speeds = len(T), real_array("speed_m_s", speed_m_s)
        return cls(
            T_world_tip=T,
            t_s=np.full(n, np.nan) if t_s is None else t_s,
            speed_m_s=np.full(n, speeds) if speeds.ndim == 0 else speeds,
            tags=("",) * n,
            parent=parent,
        )

    def __len__(self) -> int:
        return len(self.tags)

    @property
    def xyz_m(self) -> Array:
        """Places of the tip (n, 3)."""
        return np.asarray(self.T_world_tip[:, :3, 3])

    @property
    def poses(self) -> RigidTransform:
        """The poses (n)."""
        return RigidTransform.from_matrix(self.T_world_tip)

    @property
    def length_m(self) -> Array:
        """Length along the path up to each pose (n,), 0 at the first."""
        return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(self.xyz_m, axis=0), axis=1))])
