"""What stands still while the target moves is not the target: lamps, screens and reflections before a standing rig."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from armsight.records import Spots

REACH_PX = 1.0
"""A spot within this of another frame's stands where that one stood."""
STANDING_SHARE = 0.6
FEWEST_FRAMES = 5
"""Share of the frames in which something must be seen at one place to count as standing, and frames needed to tell: a
beacon on the last joint's axis rests for one sweep of several, a target that is shown rests for a frame or two."""


def without_standing(frames: Sequence[Spots]) -> list[Spots]:
    """Return the spots of each frame of one camera that stand still, less those seen at one place in most of them.

    A frame is left as it is where it would lose all of its spots, and so are all where there are too few to tell.
    """
    n = len(frames)
    of = np.repeat(np.arange(n), [len(spots) for spots in frames])
    if n < FEWEST_FRAMES or not len(of):
        return list(frames)
    positions = np.concatenate([spots.uv_px for spots in frames])
    near = cKDTree(positions).query_ball_point(positions, REACH_PX)
    standing = np.array([len(set(of[others].tolist())) >= STANDING_SHARE * n for others in near])
    out = []
    for k, spots in enumerate(frames):
        moving = np.flatnonzero(~standing[of == k])
        out.append(spots.take(moving) if len(moving) else spots)
    return out
