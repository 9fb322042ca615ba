"""The one least-squares engine: problem, solve, covariance, robust loss, report."""

from armsight.fitting.loss import Loss, LossKind
from armsight.fitting.problem import EvaluatedNormalEquations, Evaluation, Prior, Problem
from armsight.fitting.result import Fit, StopReason
from armsight.fitting.solve import Settings, solve

__all__ = [
    "EvaluatedNormalEquations",
    "Evaluation",
    "Fit",
    "Loss",
    "LossKind",
    "Prior",
    "Problem",
    "Settings",
    "StopReason",
    "solve",
]
