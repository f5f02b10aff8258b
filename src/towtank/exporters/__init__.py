"""Exporters: a model into simulators, controllers and programs, and vehicles out of simulators' files."""

from towtank.exporters.export import Exported, export
from towtank.exporters.targets import TARGETS, Target

__all__ = ["TARGETS", "Exported", "Target", "export"]
