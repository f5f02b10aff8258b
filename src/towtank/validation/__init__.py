"""Judging models by free-running prediction: how good, what the errors are, which is better, how they generalise."""

from towtank.validation.comparison import ChannelComparison, Comparison, Contest, compare
from towtank.validation.cross_validation import CrossValidation, Fold, FoldedCoefficient, cross_validate
from towtank.validation.prediction import CHANNELS, Prediction, predict
from towtank.validation.residuals import Residual, residuals
from towtank.validation.scores import Validation, fit_percent, score, validate
from towtank.validation.usability import AxisUse, Usability, usability

__all__ = [
    "CHANNELS",
    "AxisUse",
    "ChannelComparison",
    "Comparison",
    "Contest",
    "CrossValidation",
    "Fold",
    "FoldedCoefficient",
    "Prediction",
    "Residual",
    "Usability",
    "Validation",
    "compare",
    "cross_validate",
    "fit_percent",
    "predict",
    "residuals",
    "score",
    "usability",
    "validate",
]
