"""Everything compiled before the first sample is read."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import Any

from towtank.errors import InputError
from towtank.identification import Learner
from towtank.live.pipeline.instants import Instants, rows_of
from towtank.simulation import simulate
from towtank.vehicle import Vehicle

__all__ = ["new_learner", "warm_up"]

_SECONDS, _DT = 1.5, 0.01  # s


def new_learner(
    vehicle: Vehicle,
    method: str,
    free: Collection[str] | None = None,
    prior: Vehicle | None = None,
    *,
    background: bool = False,
    changes: bool = True,
    known: Mapping[str, Vehicle] | None = None,
) -> Learner:
    """Return the learner of a live session.

    Args:
        vehicle, method, free, prior: as of `Learner`.
        background: let its re-estimations run beside the stream, where it can do that.
        changes: of the vehicle are watched for, where the method can. known: configurations that it may become.

    Raises:
        InputError: an unknown method or name, or a prior or configurations that the method does not take.
    """
    settings: dict[str, Any] = {} if free is None else {"free": free}
    if prior is not None:
        if method != "joint":
            raise InputError(f"--prior: the method {method} takes none; use joint, or leave it out")
        settings["prior"] = prior
    if known and method != "joint":
        raise InputError(f"--configurations: the method {method} recognises none; use joint, or leave it out")
    if method == "joint":
        settings |= {"background": background, "changes": changes, "known": known}
    return Learner(vehicle, method, **settings)


def warm_up(vehicle: Vehicle, learner: Learner, progress: Callable[[str, float], None]) -> None:
    """Let a learner, which is of no use any more afterwards, go over a simulated second and a half."""
    import numpy as np

    n = round(_SECONDS / _DT)
    t = _DT * np.arange(n)
    wrench = np.sin(np.outer(t, 2.0 + np.arange(6)))
    run = simulate(vehicle, wrench=wrench * np.diag(vehicle.mass_matrix), dt=_DT, seed=0)
    instants = Instants(vehicle)
    commands = np.zeros(len(vehicle.thrusters))
    for k, (moment, names, values) in enumerate(rows_of(run)):
        arguments = instants.arguments(dict(zip(names, values, strict=True)))
        if len(commands):
            arguments.pop("wrench", None)
            arguments["commands"] = commands
        learner.update(moment, **arguments)
        progress("making ready", min(k / n, 1.0))
    learner.estimate  # noqa: B018
