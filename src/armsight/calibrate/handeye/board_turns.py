"""Which way round a board that looks the same turned was in each image: the robot's poses tell.

A checkerboard of 8x6 inner corners is half a turn off without a trace, and detectors number it by what is right in the
image. Of every image all turns that leave the print unchanged are tried, in samples of pairs; what most images then
agree on fixes the turn of each.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array
from armsight.calibrate.handeye.consensus import LEAST_SHARE
from armsight.calibrate.handeye.image_model import poses_of_views
from armsight.calibrate.handeye.kernels import closed_forms
from armsight.calibrate.handeye.pairs import MIN_PAIRS, Setup, stack
from armsight.optics import Camera
from armsight.records import BoardView, Target
from armsight.records.views import symmetries
from armsight.units import DEG

SAMPLE, SAMPLES, SEED = 4, 30, 17
"""Images a sample, their number and the seed: a sample of four has one rotation to spare."""
ROUNDS = 5
"""Rounds of fitting all and choosing again."""
AGREE_RAD = 5.0 * DEG
"""Rotations of the right turns agree to a degree with the worst robots; a wrong one is off by 90 or 180 degrees."""


def turned_views(
    views: Sequence[BoardView], T_base_flange: Sequence[RigidTransform], camera: Camera, board: Target, setup: Setup
) -> tuple[list[BoardView], int]:
    """Return the views numbered the same way round, and how many were turned; as they are where nothing tells."""
    turns = symmetries(board)
    if len(turns) == 1 or len(views) < MIN_PAIRS:
        return list(views), 0
    F = stack(T_base_flange)
    RF = (F if setup is Setup.EYE_IN_HAND else F.inv()).rotation.as_matrix()
    RB = poses_of_views(views, camera, board).T_camera_target.rotation.as_matrix()
    G = np.stack([_rotation(board, turn) for turn in turns])  # (S, 3, 3)
    chosen = _chosen(RF, np.einsum("nij,sjk->nsik", RB, G))
    out = [
        view if s == 0 else replace(view, index=turns[s][view.index])
        for view, s in zip(views, chosen.tolist(), strict=True)
    ]
    return out, int(np.count_nonzero(chosen))


def _rotation(board: Target, turn: NDArray[np.intp]) -> Array:
    """Return what (3, 3) the board's rotation is multiplied by from the right where its points are renumbered so."""
    X = board.xyz_m - board.xyz_m.mean(axis=0)
    return np.asarray(Rotation.align_vectors(X, X[turn])[0].as_matrix())


def _chosen(RF: Array, RB: Array) -> NDArray[np.intp]:
    """Return the turn (n,) of each image, RB (n, S, 3, 3) its rotation by each; all 0 where too few agree on any."""
    n, S = RB.shape[:2]
    rng = np.random.default_rng(SEED)
    best, chosen = np.inf, np.zeros(n, np.intp)
    for _ in range(SAMPLES):
        rows = np.argsort(rng.random(n))[:SAMPLE]
        for rest in product(range(S), repeat=SAMPLE - 1):
            errors = _errors(RF, RB, rows, np.array([0, *rest]))
            score = float((np.minimum(errors.min(axis=1), AGREE_RAD) ** 2).sum())
            if score < best:
                best, chosen = score, errors.argmin(axis=1)
    agree = np.ones(n, bool)
    for _ in range(ROUNDS):
        errors = _errors(RF, RB, np.flatnonzero(agree), chosen[agree])
        chosen, agree = errors.argmin(axis=1), errors.min(axis=1) < AGREE_RAD
        if np.count_nonzero(agree) < LEAST_SHARE * n:
            return np.zeros(n, np.intp)
    # the turns are a cycle: one turn more of all of them is the same answer with the board's axes turned
    return np.asarray((chosen - np.bincount(chosen, minlength=S).argmax()) % S)


def _errors(RF: Array, RB: Array, rows: NDArray[np.intp], turns: NDArray[np.intp]) -> Array:
    """Return the angle (n, S) that each turn of each image leaves to what some rows, turned so, agree on."""
    of = np.ascontiguousarray(RB[rows, turns])
    RX, RZ = closed_forms.shah_rotations(np.ascontiguousarray(RF[rows]), of, np.ones(len(rows), bool))
    trace = np.einsum("nij,jk,nskl,il->ns", RF, RX, RB, RZ, optimize=True)
    return np.asarray(np.arccos(np.clip(0.5 * (trace - 1.0), -1.0, 1.0)))
