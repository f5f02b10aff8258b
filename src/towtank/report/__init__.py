"""Reports: one self-contained page on what was learned, or on how well a model predicts; as HTML or PDF."""

from towtank.report.facts import LearnFacts, LogFile, Origin, PlanFacts, ValidateFacts

__all__ = ["LearnFacts", "LogFile", "Origin", "PlanFacts", "ValidateFacts"]
