"""What the demo says: what is simulated, how well it was learned, what to do next."""

from __future__ import annotations

from pathlib import Path

from towtank.app.demo.progress import LearningCurve
from towtank.digits import short
from towtank.simulation.tank import DELAY, DISTURBANCE, MOCAP, SEED, Session
from towtank.validation import Validation

__all__ = ["LOG", "MODEL", "UNSEEN", "commands", "fit_text", "plan", "setting", "verdict"]

MODEL, LOG, UNSEEN = "vlbv300_learned.toml", "tank_session.parquet", "unseen_session.parquet"
_POSE = ("x", "y", "z", "phi", "theta", "psi")


def plan(session: Session, fast: bool) -> str:
    """Return what is about to happen."""
    duration = session.recording.duration
    pace = "as fast as the machine can" if fast else f"in real time, {duration:g} s (--fast does not wait)"
    return (
        f"{duration:g} s, all axes in turn{_payload(session)}, {MOCAP.rate:g} poses a second with "
        f"{MOCAP.noise_mm:g} mm and {MOCAP.noise_mrad:g} mrad of noise and marker jumps, random forces of "
        f"{DISTURBANCE.deviations[0]:g} N, a delay of {1e3 * DELAY:g} ms; {pace}"
    )


def _payload(session: Session) -> str:
    return "" if session.later is None else f" and then at once, a payload taken up after {session.changed:g} s"


def setting(session: Session) -> str:
    """Return what was simulated, in full."""
    jumps = f"{MOCAP.jump_mm[0]:g} to {MOCAP.jump_mm[1]:g} mm"
    force, moment = DISTURBANCE.deviations[0], DISTURBANCE.deviations[3]
    if session.later is None:
        passes = (
            "the table and the model are those of a second pass over the recording, which is what towtank learn does "
            "with a log."
        )
    else:
        passes = "so are the table and the model, which follow the vehicle as it changes."
    return (
        f"Vehicle vlbv300, {session.recording.duration:g} s of motion capture at {MOCAP.rate:g} Hz, seed {SEED}. Noise "
        f"{MOCAP.noise_mm:g} mm and {MOCAP.noise_mrad:g} mrad, markers hidden {100.0 * MOCAP.jump_fraction:g} % of the "
        f"time (jumps of {jumps}), random forces of {force:g} N and moments of {moment:g} N m, {1e3 * DELAY:g} ms from "
        f"command to thrust{_payload(session)}. The learner was told the rigid body and the thrusters. It took one "
        f"sample at a time, as live data come (the curves); {passes}"
    )


def verdict(curve: LearningCurve) -> str:
    """Return the accuracy in one sentence."""
    worst: dict[str, float] = {}
    identified, furthest = 0, 0.0
    for quantity, value, std in curve.latest():
        if value == value:
            identified += 1
            error = abs(100.0 * (value / quantity.truth - 1.0)) if quantity.truth else 0.0
            worst[quantity.kind] = max(worst.get(quantity.kind, 0.0), error)
            furthest = max(furthest, abs(value - quantity.truth) / std)
    if not identified:
        return "Nothing could be identified: the session is too short"
    names = {"inertia": "inertias", "drag": "drags", "moment": "righting moment", "weight": "net weight"}
    parts = [f"{names[kind]} within {short(error, 2)} %" for kind, error in worst.items()]
    return (
        f"{identified} of {len(curve.learned)} coefficients learned: {', '.join(parts)} of the truth, none further "
        f"from it than {furthest:.1f} of its own standard deviations"
    )


def fit_text(judged: Validation) -> str:
    """Return how well the model predicts."""
    fits = [f"{name} {value:.0f} %" for name in _POSE if (value := judged.fit.get(name)) is not None]
    duration = judged.window[1] - judged.window[0]
    return f"free-running prediction of {duration:.0f} s never seen, from the commands alone: fit {', '.join(fits)}"


def commands(output: Path) -> list[tuple[str, str]]:
    """Return what to type next, each command after what it does, the most useful first; `output` is the folder."""
    model, log, unseen = output / MODEL, output / LOG, output / UNSEEN
    return [
        ("learn your own vehicle from its log", "towtank learn YOUR_LOG --vehicle YOUR_VEHICLE.toml -o learned.toml"),
        ("judge the learned model on the session it never saw", f"towtank validate {model} {unseen}"),
        ("learn this session again, as a log", f"towtank learn {log} --vehicle {model} -o again.toml"),
        ("vehicles to start from", "towtank vehicle list"),
    ]
