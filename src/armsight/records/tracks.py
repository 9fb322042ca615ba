"""The spots that one camera saw over time, each frame with the camera's own stamp."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from armsight.arrays import Array, Index
from armsight.errors import Inconsistent
from armsight.records.checks import frozen_array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SpotTrack:
    """Stamps of one camera's frames in s (n,), growing, and the spots (m,) seen in them.

    frame (m,): the row of t_s that each spot belongs to, not falling. names (m,): which light it is; "" where nobody
    said. uv_px (m, 2), covariance_px2 (m, 2, 2): in the frame's own pixels, with the lens's distortion.
    """

    t_s: Array
    frame: Index
    names: tuple[str, ...]
    uv_px: Array
    covariance_px2: Array

    def __post_init__(self) -> None:
        m = len(self.names)
        object.__setattr__(self, "names", tuple(self.names))
        object.__setattr__(self, "t_s", frozen_array("t_s", self.t_s, (None,)))
        object.__setattr__(self, "uv_px", frozen_array("uv_px", self.uv_px, (m, 2)))
        object.__setattr__(self, "covariance_px2", frozen_array("covariance_px2", self.covariance_px2, (m, 2, 2)))
        frame = np.array(self.frame, dtype=np.intp)
        frame.setflags(write=False)
        object.__setattr__(self, "frame", frame)
        if frame.shape != (m,) or (
            m and not (frame[0] >= 0 and frame[-1] < len(self.t_s) and (np.diff(frame) >= 0).all())
        ):
            raise Inconsistent("each spot belongs to one of the frames, and spots come in the order of frames")
        if (np.diff(self.t_s) <= 0.0).any():
            raise Inconsistent(
                "the stamps of a camera's frames do not grow",
                consequence="The frames have no order",
                cure="Give each frame once, in the order of time",
            )

    def __len__(self) -> int:
        return len(self.t_s)

    @property
    def alone(self) -> bool:
        """Whether no frame holds more than one spot."""
        return len(np.unique(self.frame)) == len(self.frame)

    def light(self, name: str) -> Index:
        """Return the rows of the spots of one light."""
        return np.flatnonzero([each == name for each in self.names])

    def renamed(self, name: str) -> SpotTrack:
        """Return it with this name for all of its spots."""
        return SpotTrack(
            t_s=self.t_s,
            frame=self.frame,
            names=(name,) * len(self.names),
            uv_px=self.uv_px,
            covariance_px2=self.covariance_px2,
        )
