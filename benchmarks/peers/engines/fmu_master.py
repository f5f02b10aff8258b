"""Runs in an environment with FMPy, libcosim and Ecos: validates units, and steps them by independent masters.

    python fmu_master.py FOLDER

FOLDER/runs.json lists the runs: unit, step [s], commands by name for every step, start values, outputs. Each run's
motion by every master is written to FOLDER/<run>.npz, what validation says to FOLDER/said.json.
"""

from __future__ import annotations

import ctypes
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave
from fmpy.validation import validate_fmu
from libcosimpy.CosimExecution import CosimExecution
from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
from libcosimpy.CosimManipulator import CosimManipulator
from libcosimpy.CosimObserver import CosimObserver
from libcosimpy.CosimSlave import CosimLocalSlave


def by_fmpy(run: dict[str, Any]) -> np.ndarray:
    """Return the outputs (steps, outputs) after every step."""
    description = read_model_description(run["unit"])
    three = description.fmiVersion.startswith("3")
    kind = FMU3Slave if three else FMU2Slave
    references = {each.name: each.valueReference for each in description.modelVariables}
    unit = kind(
        guid=description.guid if not three else description.instantiationToken,
        unzipDirectory=extract(run["unit"]),
        modelIdentifier=description.coSimulation.modelIdentifier,
        instanceName="tank",
    )
    unit.instantiate()
    put, get = (unit.setFloat64, unit.getFloat64) if three else (unit.setReal, unit.getReal)
    if not three:
        unit.setupExperiment(startTime=0.0)
    put([references[name] for name in run["start"]], list(run["start"].values()))
    unit.enterInitializationMode()
    unit.exitInitializationMode()
    commanded = [references[name] for name in run["commands"]]
    wanted = [references[name] for name in run["outputs"]]
    rows = []
    for k, row in enumerate(zip(*run["commands"].values(), strict=True)):
        put(commanded, list(row))
        unit.doStep(currentCommunicationPoint=k * run["step"], communicationStepSize=run["step"])
        rows.append(list(get(wanted)))
    unit.terminate()
    unit.freeInstance()
    return np.array(rows)


def by_libcosim(run: dict[str, Any]) -> np.ndarray:
    """The same by libcosim."""
    execution = CosimExecution.from_step_size(step_size=round(run["step"] * 1e9))
    slave = CosimLocalSlave(fmu_path=run["unit"], instance_name="tank")
    index = execution.add_local_slave(slave)
    references = {each.name.decode(): each.reference for each in execution.slave_variables(index)}
    for name, value in run["start"].items():
        execution.real_initial_value(index, references[name], value)
    observer, hand = CosimObserver.create_last_value(), CosimManipulator.create_override()
    execution.add_observer(observer)
    execution.add_manipulator(hand)
    wanted = [references[name] for name in run["outputs"]]
    rows = []
    for row in zip(*run["commands"].values(), strict=True):
        hand.slave_real_values(index, [references[name] for name in run["commands"]], list(row))
        execution.step()
        rows.append(list(observer.last_real_values(index, wanted)))
    return np.array(rows)


def by_ecos(run: dict[str, Any]) -> np.ndarray:
    """The same by Ecos, which steps FMI 3.0 as well. Its library asks for TBB, which pip puts where no loader looks."""
    ctypes.CDLL(str(Path(sys.prefix, "lib", "libtbb.so.12")), ctypes.RTLD_GLOBAL)
    from ecospy import EcosSimulation, EcosSimulationStructure

    with EcosSimulationStructure() as structure:
        structure.add_model("tank", run["unit"])
        structure.add_parameter_set("start", {f"tank::{name}": value for name, value in run["start"].items()})
        rows = []
        with EcosSimulation(structure=structure, step_size=run["step"]) as simulation:
            if not simulation.init(parameter_set="start"):
                raise SystemExit(f"Ecos cannot begin {run['name']}")
            for row in zip(*run["commands"].values(), strict=True):
                for name, value in zip(run["commands"], row, strict=True):
                    simulation.set_real(f"tank::{name}", value)
                simulation.step()
                rows.append([simulation.get_real(f"tank::{name}") for name in run["outputs"]])
    return np.array(rows)


def main() -> None:
    """Do all runs of a folder."""
    log_output_level(CosimLogLevel.ERROR)
    folder = Path(sys.argv[1])
    said = {}
    for run in json.loads((folder / "runs.json").read_text()):
        said[run["name"]] = [str(each) for each in validate_fmu(run["unit"])]
        found = {"FMPy": by_fmpy(run), "Ecos": by_ecos(run)}
        if run["version"] == "2.0":  # libcosim knows no other standard
            found["libcosim"] = by_libcosim(run)
        np.savez(folder / f"{run['name']}.npz", **found)
    (folder / "said.json").write_text(json.dumps(said))


if __name__ == "__main__":
    main()
