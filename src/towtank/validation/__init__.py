"""Judging a model by free-running prediction against the measurement."""

from towtank.validation.prediction import Prediction, predict
from towtank.validation.scores import CHANNELS, Validation, fit_percent, validate

__all__ = ["CHANNELS", "Prediction", "Validation", "fit_percent", "predict", "validate"]
