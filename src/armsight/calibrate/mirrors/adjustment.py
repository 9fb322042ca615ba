"""How to turn a mirror rig's outer mirrors until its virtual optical axes are parallel (Pachidis 2005, section 2).

Parallel axes leave three angles to be brought to zero: convergence, vertical and roll. A mirror that turns by an angle
turns its virtual camera by twice as much about the same axis: mirror 2 about the vertical answers for the convergence,
and mirrors 2 and 4, tilted about the lines in their faces square to it, for the sum and the difference of the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from armsight.arrays import Array
from armsight.calibrate.mirrors.diagnosis import MIRRORS, POSE, STEP_RAD, predicted_change, relative_rig
from armsight.errors import NotEnoughData
from armsight.fields import Doc
from armsight.optics import Camera, Rig
from armsight.optics.mirrors import Mirrors
from armsight.optics.parallelism import Parallelism, parallelism
from armsight.records import BoardView, Target
from armsight.records.output import Output, output

ROUNDS = 4
CERTAIN = 16.3
"""Chi-square of three angles, 1e-3 by chance, beyond which axes are not parallel as far as the views tell."""
FREE = ((1, 0), (1, 1), (3, 1))
"""What is turned: mirror 2 about the vertical and across, mirror 4 across (mirrors counted from 0)."""


@output
class MirrorTurn(Output):
    """How a mirror is to be turned so that the virtual optical axes become parallel."""

    mirror: Annotated[int, Doc("1 to 4.")]
    turn_rad: Annotated[float, Doc("About the vertical y (down): positive is clockwise seen from above.")]
    tilt_rad: Annotated[
        float,
        Doc("About the line in its face square to y: positive brings its upper edge back, to the camera's side."),
    ]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Adjustment:
    """How far the axes are from parallel, and the turns that make them so.

    rotation_rad (3,): the rotation vector of T_left_right, 0 where they are parallel, with std_rad (3,), in left axes.
    turns: of mirrors 2 and 4, with turn_std_rad (3,) of mirror 2's turn, its tilt, and mirror 4's tilt.
    """

    now: Parallelism
    rig: Rig
    rotation_rad: Array
    std_rad: Array
    turns: tuple[MirrorTurn, MirrorTurn]
    turn_std_rad: Array
    chi2: float
    n_views: int

    @property
    def parallel(self) -> bool:
        """Whether the views' noise alone could have made the angles."""
        return self.chi2 <= CERTAIN

    def advice(self) -> str:
        """Return what to do, in words."""
        if self.parallel:
            return "the virtual optical axes are parallel as far as the views tell"
        second, fourth = self.turns
        return (
            f"turn mirror 2 by {1e3 * second.turn_rad:+.2f} mrad about the vertical and {1e3 * second.tilt_rad:+.2f} "
            f"mrad across, and mirror 4 by {1e3 * fourth.tilt_rad:+.2f} mrad across"
        )


def adjust_to_parallel(
    camera: Camera, design: Mirrors, left: Sequence[BoardView], right: Sequence[BoardView], board: Target
) -> Adjustment:
    """Return how the mirrors must be turned, from views of a board (one pair is enough) through a lens that is known.

    design: where the mirrors should stand. Raises NotEnoughData without views, Inconsistent for another size of image.
    """
    if not left or len(left) != len(right):
        raise NotEnoughData("the board is not seen in both views", cure="Show the board to both views")
    now = relative_rig(design.rig(camera), left, right, board)
    if now.covariance is None:
        raise NotEnoughData("the views leave nothing to find the noise by", cure="Show the whole board")
    T_left_right = now.T_rig_left.inv() * now.T_rig_right
    rotation, C = T_left_right.rotation.as_rotvec(), now.covariance.block(POSE[3:])
    stands, J = _stands(design, rotation)
    # three turns make three angles: as many as are measured, so that the turns' covariance is that of the angles
    # carried back
    inverse = np.linalg.inv(J)
    std = np.sqrt(np.diag(inverse @ C @ inverse.T))
    turns = (
        MirrorTurn(mirror=2, turn_rad=float(-stands[0]), tilt_rad=float(-stands[1])),
        MirrorTurn(mirror=4, turn_rad=0.0, tilt_rad=float(-stands[2])),
    )
    return Adjustment(
        now=parallelism(now),
        rig=now,
        rotation_rad=rotation,
        std_rad=np.sqrt(np.diag(C)),
        turns=turns,
        turn_std_rad=std,
        chi2=float(rotation @ np.linalg.solve(C, rotation)),
        n_views=len(left),
    )


def _stands(design: Mirrors, rotation: Array) -> tuple[Array, Array]:
    """Return by how much (3,) the FREE turns are off that make this rotation (3,), and their Jacobian (3, 3)."""
    x, J = np.zeros(3), np.eye(3)
    # Newton, on three angles that are nearly linear in the turns
    for _ in range(ROUNDS):
        J = np.column_stack(
            [(_made(design, x + s) - _made(design, x - s)) / (2 * STEP_RAD) for s in STEP_RAD * np.eye(3)]
        )
        x = x - np.linalg.solve(J, _made(design, x) - rotation)
    return x, J


def _made(design: Mirrors, x: Array) -> Array:
    """Return the rotation vector (3,) of T_left_right that the FREE turns make."""
    tilts = np.zeros((MIRRORS, 2))
    for (mirror, which), angle in zip(FREE, x, strict=True):
        tilts[mirror, which] = angle
    return predicted_change(design, tilts)[3:]
