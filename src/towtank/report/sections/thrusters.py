"""From command to thrust: delay, lag, gains; and how late sensors are."""

from __future__ import annotations

import math

from towtank.digits import measured, short
from towtank.identification.posterior.wording import surer_together
from towtank.printable import escaped
from towtank.report.elements import facts as pairs_of
from towtank.report.elements import number, section
from towtank.report.facts import LearnFacts

__all__ = ["input_section"]


def input_section(facts: LearnFacts) -> str:
    """Return what was found of the way from command to thrust."""
    scale = facts.vehicle.scale_std
    return section(
        "input",
        "From command to thrust",
        pairs_of(
            [
                ("Delay", _delay(facts)),
                ("Lag of the thrusters", _lag(facts)),
                ("Both together", _together(facts)),
                ("Gain of each thruster, relative to its curve", _gains(facts)),
                ("Sensors that are late", _latencies(facts)),
                (
                    "Scale of thrust",
                    f"known to {100.0 * scale:.3g} %, within every deviation above" if scale else "",
                ),
            ]
        ),
    )


def _delay(facts: LearnFacts) -> str:
    if math.isnan(facts.delay):
        return "not known yet"
    std = facts.delay_std
    spread = "" if std is None else f" ± {number(std, f'{1e3 * std:.1f}', key='delay_std_s')}"
    found = "given" if facts.delay_given else "found from the log"
    return f"{number(facts.delay, f'{1e3 * facts.delay:.1f}', key='delay_s')}{spread} ms, {found}"


def _lag(facts: LearnFacts) -> str:
    if math.isfinite(facts.lag):
        value, std = measured(1e3 * facts.lag, 1e3 * facts.lag_std)
        spread = f" ± {number(facts.lag_std, std, key='lag_std_s')}" if std else ""
        return f"{number(facts.lag, value, key='lag_s')}{spread} ms, first order, found from the log"
    lags = sorted({thruster.time_constant for thruster in facts.vehicle.thrusters if thruster.time_constant})
    return f"{', '.join(short(1e3 * lag) for lag in lags)} ms, first order, of the vehicle file" if lags else ""


def _together(facts: LearnFacts) -> str:
    found = surer_together(facts.delay_std, facts.together)
    if found is None or facts.together is None:
        return ""
    value, std = (
        number(each, text, key=f"delay_and_lag_s/{key}")
        for each, text, key in zip(facts.together, found, ("value", "std"), strict=True)
    )
    return f"{value} ± {std} ms; how much of that is lag is less sure"


def _latencies(facts: LearnFacts) -> str:
    out = []
    for name, (value, std) in facts.latency.items():
        shown, spread = f"{1e3 * value:.1f}", f"{1e3 * std:.1f}"
        late = number(value, shown, key=f"latency_s/{name}/value")
        out.append(f"{escaped(name.replace('_', ' '))} {late} ± {number(std, spread, key=f'latency_s/{name}/std')} ms")
    return ", ".join(out)


def _gains(facts: LearnFacts) -> str:
    gains = []
    for name, (gain, std) in facts.gains.items():
        value = number(gain, f"{gain:.3f}", key=f"gains/{name}/value")
        gains.append(f"{escaped(name)} {value} ± {number(std, f'{std:.3f}', key=f'gains/{name}/std')}")
    return ", ".join(gains)
