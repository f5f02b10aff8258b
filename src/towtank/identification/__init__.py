"""From commands and motion to coefficients: regression estimators, the paper's chain, the learner."""

from towtank.identification.estimate import AxisReport, Estimate, Learned, SumOfInertias
from towtank.identification.learner import Learner
from towtank.identification.log_learning import LogLearning
from towtank.identification.logs import learn_recordings
from towtank.identification.paper_learner import PaperLearner
from towtank.identification.paper_logs import learn_paper
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
    "PaperLearner",
    "RecursiveLeastSquares",
    "RegressionEstimator",
    "SumOfInertias",
    "learn_paper",
    "learn_recordings",
]
