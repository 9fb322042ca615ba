"""The one least-squares engine: problem, solve, covariance, robust loss, report."""

from armsight.fitting.problem import Evaluation, Loss, LossKind, NormalEquations, Prior, Problem
from armsight.fitting.solve import Fit, Settings, StopReason, inverse_information, solve

__all__ = [
    "Evaluation",
    "Fit",
    "Loss",
    "LossKind",
    "NormalEquations",
    "Prior",
    "Problem",
    "Settings",
    "StopReason",
    "inverse_information",
    "solve",
]
