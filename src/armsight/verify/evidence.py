"""The residuals of a fit as linear models see them: base and tool, every joint, the links' geometry."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from armsight.calibrate.arm import ArmModel, Tolerance
from armsight.kinematics import Arm, fk_jacobian, parameter_jacobian, parameter_names
from armsight.verify.effects import Effect
from armsight.verify.left_out import Fitted, Linear, fit_linear, jackknife_std
from armsight.verify.model import Expected, Model, ModelFit, Mounts, Noise, fit_model
from armsight.verify.records import Measured
from armsight.verify.statistics import inflation

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Case:
    """An arm (bare: without base and tool), its joints q (m, n), what was measured there, and which parameters of base
    and tool are free; block (m,): rows left out together."""

    bare: Arm
    q: Array
    measured: Measured
    free: tuple[str, ...]
    block: NDArray[np.intp]

    def expected(self, effect: Effect | None) -> Expected:
        """Return the flange's poses as a function of an effect's parameters."""
        basis = np.zeros((len(self.q), 0)) if effect is None else effect.basis

        def expected(p: Array) -> tuple[Array, Array]:
            q = self.q
            if effect is not None:
                q = q.copy()
                q[:, effect.joint] += basis @ p
            F, J = fk_jacobian(self.bare, q)
            turn = J[:, :, 0] if effect is None else J[:, :, effect.joint]
            return F, turn[:, :, None] * basis[:, None, :]

        return expected

    def fit(self, mounts: Array, effect: Effect | None) -> ModelFit:
        """Return the fit of base and tool, and of an effect's parameters where one is given."""
        names = () if effect is None else effect.names
        model = Model(measured=self.measured, expected=self.expected(effect), extra=names)
        return fit_model(model, np.append(mounts, np.zeros(len(names))), (*self.free, *names))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Evidence:
    """Whitened residuals (m, rows) at a fit, and columns (m, rows, ...): of base and tool with the fitted effect, of
    each joint (m, rows, n), of the geometry without zeros (m, rows, g) with its tolerances (g,)."""

    linear: Linear
    joints: Array
    geometry: Array
    tolerance: Array

    @classmethod
    def at(cls, case: Case, fitted: ModelFit, effect: Effect | None, noise: Noise) -> Evidence:
        """Return the evidence at a fit with this effect."""
        names = () if effect is None else effect.names
        model = Model(measured=case.measured, expected=case.expected(effect), extra=names)
        residual, J = model.linearised(fitted.p)
        index = [model.names.index(name) for name in (*case.free, *names)]
        q = case.q.copy()
        if effect is not None:
            q[:, effect.joint] += effect.basis @ fitted.p[model.n_mounts :]
        joints, geometry, tolerance = _columns(case, q, Mounts.of(fitted.p, len(case.measured.labels)))
        r = noise.whiten(residual)
        linear = Linear(residual=r, fixed=noise.whiten(J[:, :, index]), block=case.block, inflation=inflation(r))
        return cls(
            linear=linear,
            joints=noise.whiten(joints[:, : model.rows]),
            geometry=noise.whiten(geometry[:, : model.rows]),
            tolerance=tolerance,
        )

    @property
    def none(self) -> Array:
        """No column (m, rows, 0)."""
        return self.joints[:, :, :0]

    def columns(self, effect: Effect) -> Array:
        """Return the columns (m, rows, k) of an effect."""
        return self.joints[:, :, effect.joint, None] * effect.basis[:, None, :]

    def plain(self) -> Fitted:
        """Return the fit of base and tool (and the effect that was fitted)."""
        return fit_linear(self.linear, self.none)

    def with_joints(self, which: NDArray[np.intp]) -> Fitted:
        """Return the fit with the zeros of these joints."""
        return fit_linear(self.linear, self.joints[:, :, which])

    def std(self, which: NDArray[np.intp], region: NDArray[np.intp], *, geometry: bool = False) -> Array:
        """Return the standard deviations of these joints' zeros that regions left out show; geometry: freed as well."""
        added, prior = self.joints[:, :, which], None
        if geometry:
            added = np.concatenate([added, self.geometry], axis=2)
            prior = np.concatenate([np.full(len(which), np.inf), self.tolerance])
        return jackknife_std(self.linear, added, region, prior)[: len(which)]

    def with_geometry(self, *more: Array) -> Fitted:
        """Return the fit with the links' geometry, within its tolerances, and with more columns before it."""
        added = np.concatenate([*more, self.geometry], axis=2)
        free = np.full(added.shape[2] - len(self.tolerance), np.inf)
        return fit_linear(self.linear, added, np.concatenate([free, self.tolerance]))


def _columns(case: Case, q: Array, mounts: Mounts) -> tuple[Array, Array, Array]:
    """Return how the tool's pose follows each joint (m, 6, n) and the geometry (m, 6, g), and the tolerances (g,)."""
    bare, measured = case.bare, case.measured
    names = parameter_names(bare)
    model = ArmModel(arm=bare, labels=measured.labels, turned=measured.rotation is not None)
    zeros = {f"{j.name}.{'theta_rad' if r else 'd_m'}" for j, r in zip(bare.joints, bare.revolute, strict=True)}
    chosen = [name for name in model.geometry if name not in zeros]
    index = [names.index(name) for name in chosen]
    drive = [
        names.index(f"{j.name}.{'theta_rad' if r else 'd_m'}") for j, r in zip(bare.joints, bare.revolute, strict=True)
    ]
    sign = np.array([joint.sign for joint in bare.joints])
    joints, geometry = np.empty((len(q), 6, bare.n)), np.empty((len(q), 6, len(index)))
    for k, tool in enumerate(mounts.tools):
        rows = measured.which == k
        _, J = parameter_jacobian(replace(bare, T_world_base=mounts.base, T_flange_tool=tool), q[rows])
        joints[rows], geometry[rows] = J[:, :, drive] * sign, J[:, :, index]
    tolerance = Tolerance()
    return joints, geometry, np.array([tolerance.of(name) for name in chosen])
