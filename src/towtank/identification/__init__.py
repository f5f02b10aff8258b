"""From commands and motion to coefficients: regression estimators, the paper's chain, the learner."""

from towtank.identification.learner import Learner
from towtank.identification.least_squares.batch import learn_paper
from towtank.identification.least_squares.rls import (
    BatchLeastSquares,
    NormalizedGradient,
    RecursiveLeastSquares,
    RegressionEstimator,
)
from towtank.identification.logs import learn_recordings
from towtank.identification.online.least_squares import PaperLearner
from towtank.identification.posterior.assembly import LogLearning
from towtank.identification.posterior.estimate import AxisReport, Estimate, Learned, SumOfInertias

__all__ = [
    "AxisReport",
    "BatchLeastSquares",
    "Estimate",
    "Learned",
    "Learner",
    "LogLearning",
    "NormalizedGradient",
    "PaperLearner",
    "RecursiveLeastSquares",
    "RegressionEstimator",
    "SumOfInertias",
    "learn_paper",
    "learn_recordings",
]
