"""A board that moves before cameras whose clocks differ: its pose at each image's time, and each camera's delay.

Each view has a pose of its own, which follows from the board's: by the time of its image, and of one that shows the
back by where that is behind the front.

The board's poses at the moments are the nodes of its motion; between them it follows the polynomial through the four
nearest, of the position and of the rotation vector from the nearest node (a cumulative curve on SO(3) in one chart).
Nodes of a stretch of time are eliminated together, as a board's pose is where it stands still.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from armsight.arrays import Array, Index
from armsight.calibrate.cameras.kernels import move_poses
from armsight.calibrate.cameras.observations import Observations
from armsight.fitting import Evaluation, Fit, NormalEquations

GAP = 2.5
"""Over so many times the usual interval nothing is known of how the board moved."""
LONGEST = 16
"""Moments whose poses are eliminated together: longer motions are cut."""
NEAREST = 4
"""Nodes of the polynomial that the board follows: a cubic errs by the fourth power of the interval."""
SMALL = 1e-4
"""Angle, rad, below which a series stands for the quotients of SO(3)."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Motion:
    """Which nodes of the motion V views, each of one camera, follow.

    views: each view as a group of its own. moment, camera, segment, t_s (V,); at_s (V,): where the polynomials coef
    (V, P, P) by nodes and powers of (time - at_s) count from; window (V, P): their nodes in the segment; base (V,):
    where in the window the one of most weight is. place (G, 2): segment and node of each moment. shape: segments,
    nodes. back (V,): whether the view shows the board's back. line (V,): where in the picture its points are, as the
    observations have it: points of a picture that counts as exposed at several times are as many views. own: how many
    numbers of the back, delays and read-outs are the shared parameters beyond those of the cameras.
    """

    views: Observations
    moment: Index
    camera: Index
    segment: Index
    t_s: Array
    at_s: Array
    coef: Array
    window: Index
    base: Index
    place: Index
    shape: tuple[int, int]
    back: NDArray[np.bool_]
    line: Array
    own: tuple[int, int, int]

    @property
    def n_empty(self) -> int:
        """Numbers of the nodes that stand for no moment."""
        return 6 * (self.shape[0] * self.shape[1] - len(self.place))

    def nodes_of(self, poses: Array) -> Array:
        """Return the local parameters (segments, 6 nodes) of the moments' poses (G, 6)."""
        out = np.zeros((*self.shape, 6))
        out[self.place[:, 0], self.place[:, 1]] = poses
        return out.reshape(self.shape[0], -1)

    def of_moments(self, fit: Fit) -> Fit:
        """Return the fit with a pose, and its covariance, for each moment."""
        s, k = self.place.T
        n = self.shape[1]
        covariance = fit.local_covariance.reshape(-1, n, 6, n, 6)[s, k, :, k]
        return replace(fit, local=fit.local.reshape(*self.shape, 6)[s, k], local_covariance=covariance)

    def retract(
        self, still: Callable[..., tuple[Array, Array]], shared: Array, local: Array, by_shared: Array, by_local: Array
    ) -> tuple[Array, Array]:
        """Return both after a step; still: moves what is the cameras' and the board's."""
        n = len(shared) - sum(self.own)
        moved, poses = still(shared[:n], local.reshape(-1, 6), by_shared[:n], by_local.reshape(-1, 6))
        own, step, end = shared[n:] + by_shared[n:], by_shared[n:], self.own[0]
        move_poses(
            shared[n : n + end].reshape(-1, 6).copy(), step[:end].reshape(-1, 6).copy(), own[:end].reshape(-1, 6)
        )
        return np.concatenate([moved, own]), poses.reshape(local.shape)

    def evaluate(self, still: Callable[[Array, Array], Evaluation], shared: Array, local: Array) -> Evaluation:
        """Return the normal equations by cameras, back, delays and nodes from those of every view's own pose."""
        n, E = len(shared) - sum(self.own), sum(self.own)
        poses, by_nodes, by_own, _ = self.along(local.reshape(*self.shape, 6), shared[n:])
        here = still(shared[:n], poses)
        residuals = np.zeros((len(self.place), here.residuals.shape[1]))
        np.add.at(residuals, self.moment, here.residuals)
        (one,) = [each for each in (here.condensed,) if each is not None]
        A, b = np.zeros((n + E, n + E)), np.zeros(n + E)
        A[:n, :n], b[:n] = one.A, one.b
        # what moves a view's pose acts through the view's own equations, by the chain rule
        flat = by_own.reshape(-1, E)
        A[:n, n:] = one.W.transpose(1, 0, 2).reshape(n, -1) @ flat
        A[n:, :n] = A[:n, n:].T
        pushed = one.C @ by_own
        A[n:, n:] = flat.T @ pushed.reshape(-1, E)
        b[n:] = flat.T @ one.c.ravel()
        V, S, L = len(by_nodes), self.shape[0], 6 * self.shape[1]
        M = np.zeros((V, 6, self.shape[1], 6))
        for k in range(self.window.shape[1]):
            M[np.arange(V), :, self.window[:, k]] += by_nodes[:, :, k]
        # each view follows a few nodes only
        near = by_nodes.reshape(V, 6, -1)
        at = (self.segment[:, None] * L + 6 * self.window[:, :, None].repeat(6, axis=2).reshape(V, -1)) + np.tile(
            np.arange(6), self.window.shape[1]
        )
        place = at[:, :, None] * L + at[:, None, :] % L
        blocks = near.transpose(0, 2, 1) @ (one.C @ near)
        C = np.bincount(place.ravel(), blocks.ravel(), S * L * L).reshape(S, L, L)
        c, W = np.zeros((S, L)), np.zeros((S, len(b), L))
        ends = np.searchsorted(self.segment, np.arange(S + 1))
        for s in range(S):
            part = slice(ends[s], ends[s + 1])
            own_nodes = M[part].reshape(-1, L)
            c[s] = one.c[part].ravel() @ own_nodes
            W[s, :n] = one.W[part].transpose(1, 0, 2).reshape(n, -1) @ own_nodes
            W[s, n:] = pushed[part].reshape(-1, E).T @ own_nodes
        empty = np.ones(self.shape)  # nodes of no moment are held where they are
        empty[self.place[:, 0], self.place[:, 1]] = 0.0
        C[:, np.arange(L), np.arange(L)] += np.repeat(empty, 6, axis=1)
        return replace(here, residuals=residuals, condensed=NormalEquations(A=A, b=b, C=np.asarray(C, float), c=c, W=W))

    def along(self, nodes: Array, own: Array) -> tuple[Array, Array, Array, Array]:
        """Return the views' poses (V, 6), and their derivatives by steps of the nodes in window (V, 6, P, 6), of what
        else is theirs (V, 6, E), which is own (E,), and by time (V, 6)."""
        V, P = self.window.shape
        rows, (behind, late, rolled) = np.arange(V), np.split(own, np.cumsum(self.own[:2]))
        late = np.concatenate([[0.0], late]) if len(late) else np.zeros(self.views.n_cameras)
        rolled = rolled if len(rolled) else np.zeros(self.views.n_cameras)
        x = (self.t_s + late[self.camera] + rolled[self.camera] * self.line - self.at_s)[:, None]
        power = np.arange(P)
        w = np.einsum("vkp,vp->vk", self.coef, x**power)
        dw = np.einsum("vkp,vp->vk", self.coef[:, :, 1:], power[1:] * x ** power[:-1])
        near = nodes[self.segment[:, None], self.window]  # (V, P, 6)
        R_base = Rotation.from_rotvec(near[rows, self.base, 3:])
        turn = Rotation.from_rotvec(near[:, :, 3:].reshape(-1, 3)) * R_base[np.repeat(rows, P)].inv()
        delta = turn.as_rotvec().reshape(V, P, 3)
        s = np.einsum("vk,vki->vi", w, delta)
        turned = Rotation.from_rotvec(s)
        poses = np.concatenate([np.einsum("vk,vki->vi", w, near[:, :, :3]), (turned * R_base).as_rotvec()], axis=1)
        J, J_inv = _left_jacobian(s), np.linalg.inv(_left_jacobian(delta))
        rate = np.concatenate(
            [
                np.einsum("vk,vki->vi", dw, near[:, :, :3]),
                np.einsum("vij,vk,vkj->vi", J, dw, delta),
            ],
            axis=1,
        )
        by = np.zeros((V, 6, P, 6))
        by[:, :3, :, :3] = w[:, None, :, None] * np.eye(3)[:, None]
        by[:, 3:, :, 3:] = np.einsum("vij,vk,vkjl->vikl", J, w, J_inv)
        # Log(R_k R_base') moves by Jl^-1 of the node's own step and against it by Jr^-1 = Jl^-1' of the base's
        back = np.einsum("vk,vkji->vij", w, J_inv)
        by[rows, 3:, self.base, 3:] += turned.as_matrix() - J @ back
        by_own = np.zeros((V, 6, sum(self.own)))
        if self.own[0]:
            self._behind(behind, poses, by, rate, by_own)
        # a delay moves its camera's views along the board's motion
        late_of = np.flatnonzero(self.camera) if self.own[1] else rows[:0]
        by_own[late_of, :, self.own[0] + self.camera[late_of] - 1] = rate[late_of]
        if self.own[2]:
            by_own[rows, :, sum(self.own[:2]) + self.camera] = self.line[:, None] * rate
        return poses, by, by_own, rate

    def _behind(self, back: Array, poses: Array, by: Array, rate: Array, by_own: Array) -> None:
        """Make of the poses of views that show the back, and of their derivatives, those of the back, in place."""
        v = np.flatnonzero(self.back)
        R = Rotation.from_rotvec(poses[v, 3:])
        arm = R.as_matrix() @ back[:3]
        # t + R t_back turns with the front about its middle: dw x arm
        turn = np.tile(np.eye(6), (len(v), 1, 1))
        turn[:, :3, 3:] = -_cross(arm)
        poses[v, :3] += arm
        poses[v, 3:] = (R * Rotation.from_rotvec(np.array(back[3:]))).as_rotvec()
        by[v] = (turn @ by[v].reshape(len(v), 6, -1)).reshape(by[v].shape)
        rate[v] = np.einsum("vij,vj->vi", turn, rate[v])
        by_own[v, :3, :3] = by_own[v, 3:, 3:6] = R.as_matrix()


def _split(
    observations: Observations, place: NDArray[np.intp]
) -> tuple[Observations, NDArray[np.intp], NDArray[np.intp], Array]:
    """Return a view for each picture and time of its points, of what moment and camera it is, and its line."""
    line = np.zeros(observations.weight.shape) if observations.line is None else observations.line
    there = np.argwhere(observations.weight > 0.0)
    # by segment, so that each one's views stand together; a picture is one view for each time of its points
    of = np.column_stack([place[there[:, 0]], there[:, :2], line[tuple(there.T)]])
    rows, member = np.unique(of, axis=0, return_inverse=True)
    g, c, at_line = rows[:, 2].astype(np.intp), rows[:, 3].astype(np.intp), rows[:, 4]
    shown = np.zeros((len(g), *observations.weight.shape[1:]))
    shown[member.ravel(), there[:, 1], there[:, 2]] = observations.weight[tuple(there.T)]
    views = replace(
        observations,
        uv=np.ascontiguousarray(observations.uv[g]),
        weight=shown,
        sources=tuple(observations.sources[k] for k in g),
        t_s=None,
        line=None,
        known=None,
    )
    return views, g, c, at_line


def motion_of(observations: Observations, delays_s: Array, readouts_s: Array | None = None) -> Motion:
    """Return how the moments hang together by their times, with delays (C - 1,) and read-outs (C,) known so far.

    Without times each moment is one by itself.
    """
    seen = np.asarray((observations.weight > 0.0).any(axis=2))  # (G, C)
    timed = observations.t_s is not None
    late = np.concatenate([[0.0], delays_s]) if timed else np.zeros(seen.shape[1])
    t_s = np.zeros(seen.shape) if observations.t_s is None else observations.t_s
    if timed:
        node_s = np.where(seen, t_s + late, 0.0).sum(axis=1) / np.maximum(seen.sum(axis=1), 1)
        place, times = _segments(node_s)
    else:
        place, times = np.column_stack([np.arange(len(seen)), np.zeros(len(seen), np.intp)]), [np.zeros(1)] * len(seen)
    views, g, c, at_line = _split(observations, place)
    asked = observations.line is not None and readouts_s is not None
    at = t_s[g, c] + late[c] + (readouts_s[c] * at_line if asked and readouts_s is not None else 0.0)
    # Lagrange's polynomial through the nodes nearest in time: their pose's share of the view's, by powers of time
    coef, window = np.zeros((len(g), NEAREST, NEAREST)), np.zeros((len(g), NEAREST), np.intp)
    for segment, nodes_s in enumerate(times):
        own = np.flatnonzero(place[g, 0] == segment)
        n = min(NEAREST, len(nodes_s))
        coef[own, :n, :n], window[own, :n] = _through(nodes_s, at[own], n)
    return Motion(
        views=views,
        moment=g,
        camera=c,
        segment=place[g, 0],
        t_s=t_s[g, c],
        at_s=at,
        coef=coef,
        window=window,
        base=np.argmax(coef[:, :, 0], axis=1),
        place=place,
        shape=(len(times), max(map(len, times))),
        back=observations.shows_back[g, c],
        line=at_line,
        own=(0 if observations.n_front is None else 6, len(late) - 1 if timed else 0, len(late) if asked else 0),
    )


def alone(observations: Observations, delays_s: Array) -> NDArray[np.bool_]:
    """Tell which moments (G,) no other is near enough to in time to know how the board moved."""
    place = motion_of(observations, delays_s).place
    return np.asarray(np.bincount(place[:, 0])[place[:, 0]] == 1)


def _segments(node_s: Array) -> tuple[Index, list[Array]]:
    """Return segment and node (G, 2) of each moment, and the times of each segment's nodes."""
    order = np.argsort(node_s, kind="stable")
    apart = np.diff(node_s[order])
    # a pause in the film: nothing tells the motion across it
    runs = np.split(order, 1 + np.flatnonzero(apart > GAP * np.median(apart))) if len(order) > 1 else [order]
    parts = [part for run in runs for part in np.array_split(run, -(-len(run) // LONGEST))]
    place = np.empty((len(order), 2), np.intp)
    for s, part in enumerate(parts):
        place[part, 0], place[part, 1] = s, np.arange(len(part))
    return place, [node_s[part] for part in parts]


def _through(nodes_s: Array, at_s: Array, n: int) -> tuple[Array, Index]:
    """Return coef (v, n, n) and window (v, n) of the polynomials through the n nodes nearest to each time (v,)."""
    first = np.clip(np.searchsorted(nodes_s, at_s) - n // 2, 0, len(nodes_s) - n)
    window = first[:, None] + np.arange(n)
    x = nodes_s[window] - at_s[:, None]
    # weights w of the nodes meet every power: sum w_k x_k^p = x^p
    powers = x[:, :, None] ** np.arange(n)
    return np.linalg.inv(powers.transpose(0, 2, 1)), window


def _left_jacobian(v: Array) -> Array:
    """Return d Exp(v + e) = Exp(J e) Exp(v) of rotation vectors (..., 3): (..., 3, 3) (Barfoot 2017, equation 7.77)."""
    angle = np.linalg.norm(v, axis=-1)[..., None, None]
    small = angle < SMALL
    t = np.where(small, 1.0, angle)
    K = _cross(v)
    half = np.where(small, 0.5, (1.0 - np.cos(t)) / t**2)
    sixth = np.where(small, 1.0 / 6.0, (t - np.sin(t)) / t**3)
    return np.asarray(np.eye(3) + half * K + sixth * K @ K)


def _cross(v: Array) -> Array:
    """Return the matrices (..., 3, 3) with K x = v x x of vectors (..., 3)."""
    K = np.zeros((*v.shape[:-1], 3, 3))
    K[..., 0, 1], K[..., 0, 2], K[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    return K - np.swapaxes(K, -1, -2)
