"""Coefficients that somebody names: those are learned, what is hardly known is not thrown away, all else stays."""

from __future__ import annotations

import pytest

from towtank.errors import InputError
from towtank.identification import LogLearning, learn_recordings
from towtank.identification.model.prior import prior_of
from towtank.recording import Recording
from towtank.simulation import Mocap, OrnsteinUhlenbeck, manoeuvre, simulate
from towtank.vehicle import Coefficient, load_vehicle

from .runs import TRUTH, box, unknown, waves

TANK = OrnsteinUhlenbeck(std=(0.5, 0.5, 0.5, 0.05, 0.05, 0.05))
NAMES = ("X_udot", "X_uu")
OTHERS = {name: value for name, value in TRUTH.items() if name not in NAMES}


def surge(push: float, seed: int, seconds: float = 10.0) -> Recording:
    """Surge pushed to and fro, in disturbed water; it turns about no axis but by that."""
    wrench = waves(round(100 * seconds), 0.01, (0, push, 1.2), square=True)
    return simulate(box(), wrench=wrench, sensors=Mocap(), seed=seed, disturbance=TANK)


def learn(log: Recording, **more: tuple[str, ...]) -> LogLearning:
    guess = {"X_uu": Coefficient(value=-15.0, std=30.0)}
    return learn_recordings(unknown(box(), **OTHERS).with_coefficients(guess), [log], delay=0.0, **more)


@pytest.mark.parametrize("seed", range(4))
def test_what_is_asked_for_is_identified_where_the_data_narrow_it(seed: int) -> None:
    learning = learn(surge(10.0, seed), free=NAMES)
    for name in NAMES:
        found = learning.estimate[name]
        assert found.identified
        assert learning.narrowed[name] < 0.5
        assert abs(found.value - TRUTH[name]) < 3.5 * found.std


def test_what_is_hardly_known_stays_as_fitted_and_says_so() -> None:
    """It hardly rolls: of its roll damping the prior is nearly all that is known."""
    vehicle = unknown(box(), **{name: value for name, value in TRUTH.items() if name != "K_pp"})
    learning = learn_recordings(vehicle, [surge(10.0, 2)], free=(*NAMES, "K_pp"), delay=0.0)
    prior = prior_of(vehicle, commands=False).only(("K_pp",))
    found = learning.estimate["K_pp"]
    assert not found.identified
    share = learning.narrowed["K_pp"]
    assert 0.5 < share <= 1.0
    assert found.std == pytest.approx(share * prior.std[0])
    assert abs(found.value - prior.mean[0]) < 3.0 * prior.std[0]
    assert learning.model.coefficient("K_pp") == found.value  # others were fitted beside this, not beside none
    assert learning.model.deviation("K_pp") == found.std
    assert str(found.reason).startswith(f"the data leave {100.0 * share:.0f} % of the prior's deviation")


@pytest.mark.parametrize("seed", range(3))
def test_a_delay_and_a_lag_that_are_hardly_known_do_no_harm(seed: int) -> None:
    truth = load_vehicle("vlbv300")
    commands = manoeuvre("surge-sine", truth, duration=4.0, dt=0.01).commands
    assert commands is not None
    log = simulate(truth, commands=0.3 * commands, dt=0.01, sensors=Mocap(), seed=seed, disturbance=TANK)
    learning = learn_recordings(truth, [log], free=(*NAMES, "lag"))
    assert set(learning.estimate.names) == set(NAMES)
    assert learning.delay_std > 0.02
    assert learning.lag_std > 0.0
    assert learning.delay < 4.0 * learning.delay_std  # there is none


def test_everything_else_is_left_as_it_was_supposed() -> None:
    learning = learn(surge(10.0, 0), free=NAMES)
    before = prior_of(unknown(box(), **OTHERS, X_uu=-15.0), commands=False).vehicle_values
    for name, value in before.items():
        if name not in NAMES:
            assert learning.model.coefficient(name) == value, name
            assert name not in learning.estimate.names
    assert set(learning.narrowed) == set(NAMES)  # the delay was given
    assert learning.remarks[0] == "free: X_udot, X_uu; everything else is fixed at the prior's mean"
    posterior = learning.model.posterior
    assert posterior is not None
    assert set(posterior.names) == set(NAMES)


def test_a_name_that_the_prior_does_not_know_is_refused_with_the_nearest() -> None:
    for name, nearest in (("X_udto", "X_udot"), ("gain_left", "")):
        with pytest.raises(InputError, match=f'free: "{name}" is not a coefficient of the prior.*{nearest}'):
            learn(surge(2.5, 0), free=(name,))


def test_what_is_known_beside_them_counts() -> None:
    """With everything else known, the filter's own deviations are smaller than with everything unknown."""
    log = surge(10.0, 1)
    named, whole = (learn(log, **more) for more in ({"free": NAMES}, {}))
    assert named.model.posterior is not None
    assert whole.model.posterior is not None
    assert len(whole.narrowed) > 40
    for name in NAMES:
        found, all_free = named.estimate[name], whole.estimate[name]
        assert found.std < 1.5 * all_free.std  # each is widened by what its own windows contradict each other
        assert abs(found.value - all_free.value) < 3.0 * max(found.std, all_free.std)
