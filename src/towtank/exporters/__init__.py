"""Exporters: a model into simulators, controllers and programs, and vehicles out of simulators' files."""

from towtank.exporters.export import Exported, export
from towtank.exporters.importing.guarded import Imported
from towtank.exporters.importing.sources import SOURCES, import_vehicle
from towtank.exporters.targets import TARGETS, Target

__all__ = ["SOURCES", "TARGETS", "Exported", "Imported", "Target", "export", "import_vehicle"]
