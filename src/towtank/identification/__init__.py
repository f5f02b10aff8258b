"""From commands and motion to coefficients: regression estimators, the paper's chain, the learner."""

from towtank.identification.estimate import AxisReport, Estimate, Learned, SumOfInertias
from towtank.identification.learner import Learner
from towtank.identification.logs import LogLearning, learn_recordings
from towtank.identification.regression import (
    BatchLeastSquares,
    NormalizedGradient,
    RecursiveLeastSquares,
    RegressionEstimator,
)

__all__ = [
    "AxisReport",
    "BatchLeastSquares",
    "Estimate",
    "Learned",
    "Learner",
    "LogLearning",
    "NormalizedGradient",
    "RecursiveLeastSquares",
    "RegressionEstimator",
    "SumOfInertias",
    "learn_recordings",
]
