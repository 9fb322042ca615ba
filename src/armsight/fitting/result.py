"""What a fit returns: values, their covariance, and why it stopped."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from armsight.records import NamedCovariance

Array = NDArray[np.float64]


class StopReason(StrEnum):
    """Why the solver stopped; the first three mean that it has an answer."""

    COST_SETTLED = "cost settled"
    STEP_SMALL = "step small"
    GRADIENT_ZERO = "gradient zero"
    ITERATION_LIMIT = "iteration limit"
    NO_DESCENT = "no descent"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fit:
    """The fitted parameters with their covariance.

    shared (S,), local (G, L): all parameters, fixed ones at their guess. covariance: of the free shared ones.
    local_covariance: (G, L, L). residuals: (G, m) whitened, without the robust weights. weights: (G, m) of
    the robust loss. cost: half the (robust) sum of squares with priors. scale: standard deviation of the
    whitened residuals, sqrt(2 cost / dof); covariances are already multiplied by scale^2 where the noise was
    estimated. undetermined: groups of names that the data cannot tell apart (their standard deviations are infinite).
    """

    names: tuple[str, ...]
    shared: Array
    local: Array
    covariance: NamedCovariance | None
    local_covariance: Array
    residuals: Array
    weights: Array
    cost: float
    scale: float
    dof: int
    n_residuals: int
    iterations: int
    reason: StopReason
    undetermined: tuple[tuple[str, ...], ...]

    @property
    def converged(self) -> bool:
        """Whether the solver stopped at a minimum."""
        return self.reason in (StopReason.COST_SETTLED, StopReason.STEP_SMALL, StopReason.GRADIENT_ZERO)

    def value(self, name: str) -> float:
        """Return the value of one shared parameter in its own unit."""
        return float(self.shared[self.names.index(name)])

    def std(self) -> dict[str, float]:
        """Return the standard deviations by name; infinite where the data cannot tell, absent for fixed ones."""
        known = {} if self.covariance is None else self.covariance.std()
        open_ = {name for group in self.undetermined for name in group}
        return {**known, **dict.fromkeys(open_, float("inf"))}

    def report(self) -> str:
        """Return a table of values and standard deviations with the reason for stopping, for people."""
        std = self.std()
        lines = [
            f"{self.n_residuals} residuals, {self.dof} degrees of freedom, scale {self.scale:.4g}, "
            f"{self.iterations} iterations, stopped: {self.reason.value}"
        ]
        for name, value in zip(self.names, self.shared, strict=True):
            uncertainty = f"+- {std[name]:.4g}" if name in std else "(fixed)"
            lines.append(f"  {name:<24} {value:>16.9g} {uncertainty}")
        return "\n".join(lines)
