"""A board with a print on each side: where the back is behind the front, and the front's pose in views of the back.

Cameras that see one side at one moment are joined by it. Where such a group sees both sides at once, the back follows;
where no group does, it follows as a tool on a robot's hand does, from two groups that see a side each while the board
turns: T_a_front T_front_back = T_a_b T_b_back (Shah 2013, the Kronecker product's largest singular value).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array
from armsight.calibrate.cameras.graph import LEAST_SHARED, MOVING, edges_of, tree_from
from armsight.calibrate.cameras.observations import Observations
from armsight.calibrate.cameras.pairing import AGREEING, SAME_ANGLE_RAD, SAME_SHARE, as_pose, consensus
from armsight.errors import Inconsistent, NotEnoughData, UsageError
from armsight.records import Target, TargetKind

TURNS = 0.97
"""Second singular value over the largest from which the board is taken to have turned about one axis only: with 15
degrees (root mean square) about the second one it is 0.95."""
ROUNDS = 10


class TwoSided(NamedTuple):
    """A plate with a print on each side; in views of the back its points are numbered after the front's."""

    front: Target
    back: Target


def require_two_sides(front: Target, back: Target) -> None:
    """Raise UsageError where an image would not tell which side it shows."""
    marked = (TargetKind.CHARUCO, TargetKind.APRILGRID)
    if front.kind in marked and back.kind in marked and front.dictionary != back.dictionary:
        return
    raise UsageError(
        "an image does not tell which side of the board it shows: "
        + (
            "both have markers of one dictionary"
            if front.kind in marked and back.kind in marked
            else "it has no markers"
        ),
        consequence="A front taken for a back would place cameras wrongly, and nothing was calibrated",
        cure="Print ChArUco boards of two dictionaries, or a ChArUco board and an AprilGrid",
    )


def with_the_back(observations: Observations, poses: Array) -> tuple[Array, Array]:
    """Return T_camera_front (G, C, 2, 6) of all views, and T_front_back (6,), of T_camera_side (G, C, 2, 6).

    Of a board with one side the poses as they are. Raises NotEnoughData where nothing tells where the back is,
    Inconsistent where the moments do not agree on it.
    """
    if observations.n_front is None:
        return poses, np.zeros(0)
    back = observations.shows_back
    for side, seen in (("front", ~back), ("back", back)):
        if not (np.isfinite(poses[:, :, 0, 0]) & seen).any():
            raise NotEnoughData(
                f"no camera sees the {side} of the board",
                consequence="Nothing was calibrated",
                cure="Check what is said of that side, and turn the board; or say that it has one side",
            )
    fronts, backs = (np.where(one[..., None], poses[:, :, 0], np.nan) for one in (~back, back))
    slack = 1.0 if observations.t_s is None else MOVING
    edges = [*edges_of(fronts, np.eye(3)[None], slack), *edges_of(backs, np.eye(3)[None], slack)]
    T: dict[int, RigidTransform] = {}
    groups: list[tuple[int, ...]] = []
    for c in range(observations.n_cameras):
        if c not in T:
            _, found = tree_from(edges, c)
            groups.append(tuple(sorted(found)))
            T |= found
    shown = [[_in_group(one, group, T) for group in groups] for one in (fronts, backs)]
    Y = _between(observations, groups, shown, slack)
    turned = poses.copy()
    for g, c in zip(*np.nonzero(back), strict=True):
        for tilt in range(poses.shape[2]):
            turned[g, c, tilt] = _vector(as_pose(poses[g, c, tilt]) * Y.inv())
    return turned, _vector(Y)


def _in_group(poses: Array, group: tuple[int, ...], T: dict[int, RigidTransform]) -> Array:
    """Return the board's pose (G, 6) in axes of a group's root, by the first of its cameras that saw it."""
    out = np.full((len(poses), 6), np.nan)
    for g, seen in enumerate(np.isfinite(poses[:, :, 0])):
        c = next((c for c in group if seen[c]), None)
        if c is not None:
            out[g] = _vector(T[c] * as_pose(poses[g, c]))
    return out


def _between(
    observations: Observations, groups: list[tuple[int, ...]], shown: list[list[Array]], slack: float
) -> RigidTransform:
    """Return T_front_back from the group, or the two, that show both sides at most moments."""
    count = np.array([[np.isfinite(f[:, 0] + b[:, 0]).sum() for b in shown[1]] for f in shown[0]])
    names = [", ".join(observations.cameras[c] for c in group) for group in groups]
    own = np.diag(count)
    if own.any():
        k = int(np.argmax(own))
        g = np.isfinite(shown[0][k][:, 0] + shown[1][k][:, 0])
        paired = consensus(_inverse(shown[0][k][g]), _inverse(shown[1][k][g]), np.eye(3)[None], slack)
        Y, agree = as_pose(paired.side_pose), float(paired.agreeing.mean())
        told = names[k]
    else:
        seen_by = [np.isfinite([one[:, 0] for one in side]).sum(axis=1) / len(shown[0][0]) for side in shown]
        likely = count + 0.25 * (seen_by[0][:, None] + seen_by[1]) - np.eye(len(count))
        a, b = np.unravel_index(int(np.argmax(likely)), count.shape)
        g = np.isfinite(shown[0][a][:, 0] + shown[1][b][:, 0])
        told = f"{names[a]} and {names[b]}"
        found = _hand_eye(shown[0][a][g], shown[1][b][g], slack) if g.sum() >= LEAST_SHARED else None
        if found is None:
            raise NotEnoughData(
                f"where the board's back is behind its front is open: {g.sum()} moments show the front to {names[a]} "
                f"and the back to {names[b]}"
                + (", and in them the board turns about one axis only" if g.sum() >= LEAST_SHARED else ""),
                consequence="How these cameras stand to each other is open, and nothing was calibrated",
                cure=f"Take ten and more pictures in which one of {names[a]} sees the front and one of {names[b]} the "
                "back, the board tilted by 20 degrees to all sides; or turn it so that two of a group see a side each",
            )
        Y, agree = found
    if agree < AGREEING:
        raise Inconsistent(
            f"the two sides of the board do not move as one: {told} see its back elsewhere from moment to moment",
            consequence="The prints are on two boards, or one is of another size; nothing was calibrated",
            cure="Glue both prints to one plate, measure their squares, and check that the lists are of one time",
        )
    return Y


def _hand_eye(front: Array, back: Array, slack: float) -> tuple[RigidTransform, float] | None:
    """Return T_front_back of the poses (n, 6) of either side in axes that stand still, and the share that agrees.

    None where the board turns about one axis only.
    """
    R_a, R_b = (Rotation.from_rotvec(one[:, 3:]).as_matrix() for one in (front, back))
    weight = np.ones(len(front))
    reach = 0.5 * float(np.linalg.norm(front[:, :3], axis=1).mean() + np.linalg.norm(back[:, :3], axis=1).mean())
    for _ in range(ROUNDS):
        K = np.einsum("g,gij,gkl->ikjl", weight, R_a, R_b).reshape(9, 9)  # K vec(R_Y) = n vec(R_X)
        U, size, Vt = np.linalg.svd(K)
        if size[1] > TURNS * size[0]:
            return None
        sign = np.sign(np.linalg.det(Vt[0].reshape(3, 3)))
        R_Y, R_X = (Rotation.from_matrix(sign * one.reshape(3, 3)) for one in (Vt[0], U[:, 0]))
        # t_a + R_a t_Y = t_X + R_X t_b
        rows = np.concatenate([R_a, np.tile(-np.eye(3), (len(R_a), 1, 1))], axis=2) * weight[:, None, None]
        right = (R_X.apply(back[:, :3]) - front[:, :3]) * weight[:, None]
        t, *_ = np.linalg.lstsq(rows.reshape(-1, 6), right.ravel(), rcond=None)
        off = R_a @ t[:3] - t[3:] - R_X.apply(back[:, :3]) + front[:, :3]
        turn = (Rotation.from_matrix(R_a) * R_Y * Rotation.from_matrix(R_b).inv() * R_X.inv()).magnitude()
        doubt = np.maximum(turn / SAME_ANGLE_RAD, np.linalg.norm(off, axis=1) / reach / SAME_SHARE) / slack
        weight = 1.0 / (1.0 + (4.0 * doubt) ** 2)  # a wrong tilt among many pulls little (Cauchy)
    return RigidTransform.from_components(t[:3], R_Y), float((doubt < 1.0).mean())


def _inverse(poses: Array) -> Array:
    return np.array([_vector(as_pose(one).inv()) for one in poses])


def _vector(T: RigidTransform) -> Array:
    return np.concatenate([T.translation, T.rotation.as_rotvec()])
