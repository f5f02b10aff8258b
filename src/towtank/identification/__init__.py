"""From commands and motion to coefficients: learners for streams, and for whole recordings."""

from towtank.identification.learner import Learner
from towtank.identification.least_squares.batch import learn_paper
from towtank.identification.least_squares.rls import RecursiveLeastSquares
from towtank.identification.logs import learn_recordings
from towtank.identification.online.least_squares import PaperLearner
from towtank.identification.posterior.assembly import LogLearning
from towtank.identification.posterior.estimate import AxisReport, Estimate, Learned, SumOfInertias

__all__ = [
    "AxisReport",
    "Estimate",
    "Learned",
    "Learner",
    "LogLearning",
    "PaperLearner",
    "RecursiveLeastSquares",
    "SumOfInertias",
    "learn_paper",
    "learn_recordings",
]
