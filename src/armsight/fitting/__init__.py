"""The one least-squares engine: problem, solve, covariance, robust loss, report."""

from armsight.fitting.problem import Evaluation as Evaluation
from armsight.fitting.problem import Loss as Loss
from armsight.fitting.problem import LossKind as LossKind
from armsight.fitting.problem import NormalEquations as NormalEquations
from armsight.fitting.problem import Prior as Prior
from armsight.fitting.problem import Problem as Problem
from armsight.fitting.solve import Fit as Fit
from armsight.fitting.solve import Settings as Settings
from armsight.fitting.solve import StopReason as StopReason
from armsight.fitting.solve import inverse_information as inverse_information
from armsight.fitting.solve import solve as solve
