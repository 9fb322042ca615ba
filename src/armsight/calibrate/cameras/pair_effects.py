"""What all points of a pair have in common that a rigid rig has not: a shift of one image, or a turn of one camera.

A mount that creeps, images that are not of one moment, a board that a hand moves between them: each pair then has an
error of its own that its many points do not average out. It is a random effect of every pair with a variance for each
direction, by restricted likelihood (Patterson, Thompson 1971; Henderson 1975 for its algebra). The pairs are weighed by
it, and what is not known of the variances widens the answer.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from armsight.arrays import Array
from armsight.calibrate.cameras.bundle_adjustment import BoardEquations, bundle_of, problem_of
from armsight.calibrate.cameras.observations import Observations
from armsight.fitting import Fit
from armsight.records import NamedCovariance
from armsight.units import DEG

EFFECTS = {"shift": ("right.cx", "right.cy"), "turn": ("right.rx", "right.ry", "right.rz")}
"""What may differ from pair to pair, as a step of parameters of the right camera: its image, or how it stands."""
BY_CHANCE = 0.01
"""Pairs are taken to agree as one rigid rig where chance makes them look as different as this often."""
COARSE = np.concatenate([[0.0], np.geomspace(0.1, 1e6, 11)])
"""Variances of an effect over that of its own error from the points of one pair, first looked through."""
FINE = np.exp(np.linspace(-2.0, 2.0, 9))
"""Factors about the best ones, over which the answer is averaged."""
ROUNDS = 3
"""Steps of Gauss and Newton: the third moves nothing that could be seen."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PairEffects:
    """A pair of cameras fitted to pairs of images that differ from each other.

    fit: the shared parameters, with residuals of the rigid rig; covariance: of the free ones. freed: the observations
    without what each pair has of its own. kind: of EFFECTS. std: (q,) its standard deviations, px or rad. gain: by how
    much twice the log likelihood of the residuals is larger with it.
    """

    fit: Fit
    covariance: NamedCovariance
    freed: Observations
    kind: str
    std: Array
    gain: float

    def advice(self, noise_px: float) -> str:
        """Return what is wrong with the pairs, and what to do. noise_px: of a point."""
        if self.kind == "shift":
            what = (
                f"their images are shifted against each other by {_each(self.std)} px (along and across the rows, RMS)"
            )
        else:
            what = f"one camera turns against the other by {_each(self.std / DEG)} degrees (about x, y and z, RMS)"
        return (
            f"the pairs do not agree as one rigid rig: {what} from pair to pair, more than points of {noise_px:.2g} px "
            "can. The deviations allow for it. A mount gives way, the two images are not of one moment, or the board "
            "moved between them: fix both cameras to one stiff bar, expose them at once, hold the board still"
        )


def _each(values: Array) -> str:
    return " and ".join(f"{value:.2g}" for value in values)


def pair_effects(observations: Observations, fit: Fit) -> PairEffects | None:
    """Return the fit with what differs from pair to pair in it; None where the pairs agree as one rigid rig.

    fit: of the rigid rig, at its minimum, by plain squares.
    """
    if fit.covariance is None or observations.one_lens:
        return None
    names = fit.covariance.names
    start = _At(shared=fit.shared, local=fit.local, own=np.zeros((observations.n_views, 0)))
    found = None
    for kind, effect in EFFECTS.items():
        model = _Model.of(observations, fit, names, effect)
        system = model.system(replace(start, own=np.zeros((observations.n_views, len(effect)))))
        best = system.best()
        gain = float(system.solved(np.zeros((1, len(effect))))[0][0] - system.solved(best[None])[0][0])
        if gain > chdtri(len(effect), BY_CHANCE) and (found is None or gain > found[0]):
            found = gain, kind, model, best
    if found is None:
        return None
    # the ratios are those of the rigid rig's residuals, which hold the effects whole: they stay as the answer moves
    gain, kind, model, best = found
    at = replace(start, own=np.zeros((observations.n_views, len(EFFECTS[kind]))))
    for _ in range(ROUNDS):
        system = model.system(at)
        step, C, std = system.averaged(best)
        at = model.moved(at, system, step, best)
    whole = problem_of(observations, bundle_of(fit, 2), frozenset()).evaluate(at.shared, at.local)
    freed = model.freed(at)
    return PairEffects(
        fit=replace(fit, shared=at.shared, local=at.local, residuals=whole.residuals),
        covariance=NamedCovariance(names=names, matrix=C),
        freed=freed,
        kind=kind,
        std=std,
        gain=gain,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _At:
    """A state: shared (S,), boards' poses (G, 6), and every pair's own effect (G, q)."""

    shared: Array
    local: Array
    own: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Model:
    """Equations of every pair by itself, and which of the shared parameters are free and which are the effect."""

    views: tuple[BoardEquations, ...]
    observations: Observations
    free: NDArray[np.intp]
    effect: NDArray[np.intp]
    dof: int

    @staticmethod
    def of(observations: Observations, fit: Fit, names: tuple[str, ...], effect: tuple[str, ...]) -> _Model:
        at = {name: k for k, name in enumerate(fit.names)}
        return _Model(
            views=tuple(BoardEquations(observations.take([g])) for g in range(observations.n_views)),
            observations=observations,
            free=np.array([at[name] for name in names], np.intp),
            effect=np.array([at[name] for name in effect], np.intp),
            dof=fit.dof,
        )

    def shared_of(self, at: _At, g: int) -> Array:
        """Return the shared parameters as pair g has them."""
        step = np.zeros(len(at.shared))
        step[self.effect] = at.own[g]
        return self.views[g].retract(at.shared, at.local[[g]], step, np.zeros((1, at.local.shape[1])))[0]

    def system(self, at: _At) -> _System:
        """Return the equations of all pairs at a state, the boards' poses eliminated pair by pair."""
        A, b, back, ahead, cost = [], [], [], [], 0.0
        for g, view in enumerate(self.views):
            here = view.evaluate(self.shared_of(at, g), at.local[[g]])
            (normal,) = [one for one in (here.condensed,) if one is not None]
            # a board's pose concerns its own pair alone, and takes up what it can of what the pair has of its own
            Ci_Wt = np.linalg.solve(normal.C[0], normal.W[0].T)
            Ci_c = np.linalg.solve(normal.C[0], normal.c[0])
            A.append(normal.A - normal.W[0] @ Ci_Wt)
            b.append(normal.b - normal.W[0] @ Ci_c)
            cost += float(np.vdot(here.residuals, here.residuals) - normal.c[0] @ Ci_c)
            back.append(Ci_Wt)
            ahead.append(Ci_c)
        f, u, all_A, all_b = self.free, self.effect, np.array(A), np.array(b)
        size = 1.0 / all_A[:, u, u].mean(axis=0)
        return _System(
            S=all_A[:, f[:, None], f].sum(axis=0),
            g=all_b[:, f].sum(axis=0),
            mixed=all_A[:, f[:, None], u],
            own=all_A[:, u[:, None], u],
            pull=all_b[:, u],
            at=at.own,
            cost=cost,
            dof=self.dof,
            size=size,
            poses=(np.array(back), np.array(ahead)),
        )

    def moved(self, at: _At, system: _System, step: Array, best: Array) -> _At:
        """Return the state after a step of the free parameters, effects and poses following it."""
        own = system.effects(step, best)
        back, ahead = system.poses
        by = np.zeros((len(own), len(at.shared)))
        by[:, self.free] += step
        by[:, self.effect] += own
        full = np.zeros(len(at.shared))
        full[self.free] = step
        shared, local = self.views[0].retract(at.shared, at.local, full, -(ahead + np.einsum("gls,gs->gl", back, by)))
        return _At(shared=shared, local=local, own=at.own + own)

    def freed(self, at: _At) -> Observations:
        """Return the observations as one rigid rig would have seen them: less what each pair has of its own."""
        uv = self.observations.uv.copy()
        for g, view in enumerate(self.views):
            weight = view.observations.weight[0, 1]
            own, rigid = (view.evaluate(shared, at.local[[g]]) for shared in (self.shared_of(at, g), at.shared))
            moved = (own.residuals - rigid.residuals).reshape(2, -1, 2)[1]
            uv[g, 1] -= np.divide(moved, weight[:, None], out=np.zeros_like(moved), where=weight[:, None] > 0.0)
        return replace(self.observations, uv=uv)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _System:
    """Normal equations of the free parameters S (F, F), g (F,); of each pair's effect own (G, q, q), pull (G, q); mixed
    (G, F, q). at (G, q): effects so far. cost: sum of squares. size (q,): variance of an effect from one pair's points.
    poses: how these follow."""

    S: Array
    g: Array
    mixed: Array
    own: Array
    pull: Array
    at: Array
    cost: float
    dof: int
    size: Array
    poses: tuple[Array, Array]

    def solved(self, ratio: Array) -> tuple[Array, Array, Array, Array]:
        """Return the answers for effects of variances ratio (k, q) times `size`, each zero in all k or in none, in
        units of the points' noise: -2 log of the restricted likelihood (k,); the step (k, F) of the free parameters and
        its covariance (k, F, F); the variance (k,) of the points' noise over what they are believed to have."""
        used = ratio[0] > 0.0
        precision = 1.0 / (ratio[:, used] * self.size[used])  # (k, u)
        mixed, at = self.mixed[:, :, used], self.at[:, used]
        # a random effect is a parameter with a prior of mean zero: eliminated pair by pair, as the poses are
        D = self.own[:, used][:, :, used] + (precision[:, :, None] * np.eye(used.sum()))[:, None]  # (k, G, u, u)
        pull = self.pull[:, used] + at * precision[:, None]  # (k, G, u)
        Di_M, Di_p = np.linalg.solve(D, mixed.transpose(0, 2, 1)), np.linalg.solve(D, pull[..., None])
        rows = mixed.swapaxes(0, 1).reshape(len(self.S), -1)  # (F, G u)
        S = self.S - rows @ Di_M.reshape(len(ratio), -1, len(self.S))
        g = self.g - Di_p.reshape(len(ratio), -1) @ rows.T
        # px, m and rad differ by orders of magnitude: in units of each one's own influence rounding is alike for all
        scale = 1.0 / np.sqrt(np.diag(self.S))
        inverse = np.linalg.inv(S * np.outer(scale, scale)) * np.outer(scale, scale)
        step = -(inverse @ g[..., None])[..., 0]
        cost = self.cost + np.einsum("gq,kq->k", at**2, precision) + np.einsum("kf,kf->k", g, step)
        cost -= np.einsum("kgq,kgq->k", pull, Di_p[..., 0])
        noise2 = np.maximum(cost, 1e-300) / self.dof
        worse = np.linalg.slogdet(D)[1].sum(axis=1) - D.shape[1] * np.log(precision).sum(axis=1)
        worse += np.linalg.slogdet(S * np.outer(scale, scale))[1] + self.dof * np.log(noise2)
        return worse, step, noise2[:, None, None] * inverse, noise2

    def best(self) -> Array:
        """Return the likeliest ratios (q,), looked for one after the other, twice."""
        best = np.zeros(len(self.size))
        for _ in range(2):
            for k in range(len(best)):
                tries = [np.where(np.arange(len(best)) == k, ratio, best) for ratio in COARSE]
                best = min(tries, key=lambda ratio: float(self.solved(ratio[None])[0][0]))
        return best

    def averaged(self, best: Array) -> tuple[Array, Array, Array]:
        """Return step and covariance over all ratios about the best, weighed by likelihood, and the deviations (q,)."""
        # those that are zero stay zero
        ratios = best * np.array([*product(*[FINE if ratio > 0.0 else np.ones(1) for ratio in best])])
        worse, steps, covariances, noise2 = self.solved(ratios)
        weight = np.exp(-0.5 * (worse - worse.min()))
        weight = weight / weight.sum()
        step = weight @ steps
        spread = steps - step
        C = np.einsum("k,kab->ab", weight, covariances) + (spread.T * weight) @ spread
        variance = weight @ (ratios * noise2[:, None])
        return step, 0.5 * (C + C.T), np.sqrt(variance * self.size)

    def effects(self, step: Array, ratio: Array) -> Array:
        """Return by how much each pair's effect (G, q) follows a step."""
        used = ratio > 0.0
        precision = 1.0 / (ratio[used] * self.size[used])
        D = self.own[:, used][:, :, used] + np.diag(precision)
        pull = self.pull[:, used] + self.at[:, used] * precision + np.einsum("gfq,f->gq", self.mixed[:, :, used], step)
        own = np.zeros_like(self.at)
        own[:, used] = -np.linalg.solve(D, pull[..., None])[..., 0]
        return own
