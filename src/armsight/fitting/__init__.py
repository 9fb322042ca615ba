"""The one least-squares engine: problem, solve, covariance, robust loss, report."""

from armsight.fitting.loss import Loss, LossKind
from armsight.fitting.normal import NormalEquations
from armsight.fitting.problem import Evaluation, Prior, Problem
from armsight.fitting.result import Fit, StopReason
from armsight.fitting.solve import Settings, solve

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
    "solve",
]
