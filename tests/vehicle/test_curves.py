"""Thruster curves: published numbers, dead bands, limits, voltage, and the way back."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from towtank.vehicle import (
    PolynomialCurve,
    QuadraticCurve,
    TableCurve,
    Voltage,
    curve_command,
    curve_force,
    force_range,
)

PAPER = PolynomialCurve(coefficients=(0.0684, -0.03366, 0.006736), dead_band=5.0, limits=(-102.0, 102.0))
T200 = PolynomialCurve(
    neutral=1500.0,
    scale=400.0,
    dead_band=28.0,
    coefficients=(-2.441, 26.101, 29.535),
    reverse=(-1.995, 21.498, 21.943),
    limits=(1100.0, 1900.0),
    voltage=Voltage(nominal=16.0, exponent=1.20, reverse_exponent=1.13),
)
TABLE = TableCurve(command=(1100.0, 1400.0, 1480.0, 1520.0, 1900.0), force=(-40.0, -5.0, 0.0, 0.0, 50.0))
FALLING = TableCurve(command=(1100.0, 1511.0, 1900.0), force=(55.23, 0.0, -27.566))
ROTOR = QuadraticCurve(forward=2e-4, reverse=1e-4, limits=(-500.0, 500.0))
OPEN = QuadraticCurve(forward=2e-4)


def test_paper_polynomial():
    assert curve_force(PAPER, 30.0) == pytest.approx(0.006736 * 900 - 0.03366 * 30 + 0.0684)
    commands = np.array([-200.0, -102.0, -60.0, -4.9, 0.0, 4.9, 60.0, 102.0, 200.0])
    forces = curve_force(PAPER, commands)
    np.testing.assert_allclose(forces, -forces[::-1], atol=0)
    assert np.all(forces[3:6] == 0.0)
    assert forces[-1] == forces[-2]


def test_t200_curve_at_its_ends_and_in_its_dead_band():
    np.testing.assert_allclose(curve_force(T200, [1100.0, 1500.0, 1900.0]), [-41.446, 0.0, 53.195], atol=1e-9)
    near = curve_force(T200, np.arange(1470.0, 1535.0))
    assert np.all(near[(np.arange(1470, 1535) > 1472) & (np.arange(1470, 1535) < 1528)] == 0.0)
    assert np.all(np.diff(curve_force(T200, np.linspace(1100, 1900, 801))) >= 0.0)


def test_voltage_scales_each_direction_by_its_exponent():
    forward = curve_force(T200, 1900.0, [10.0, 16.0, 20.0]) / curve_force(T200, 1900.0)
    np.testing.assert_allclose(forward, [(10 / 16) ** 1.2, 1.0, (20 / 16) ** 1.2])
    assert curve_force(T200, 1100.0, 20.0) / curve_force(T200, 1100.0) == pytest.approx((20 / 16) ** 1.13)
    assert np.isnan(curve_force(T200, 1900.0, np.nan))
    assert curve_force(T200, 1900.0, 0.0) == 0.0
    assert curve_force(PAPER, 30.0, 12.0) == curve_force(PAPER, 30.0)


def test_even_polynomial_and_reverse_polynomial():
    plain = PolynomialCurve(coefficients=(1.0, 2.0, 3.0), odd=False)
    np.testing.assert_allclose(curve_force(plain, [-2.0, 0.0, 2.0]), [9.0, 1.0, 17.0])
    twice = PolynomialCurve(coefficients=(0.0, 2.0), reverse=(0.0, 1.0))
    np.testing.assert_allclose(curve_force(twice, [-3.0, 0.0, 3.0]), [-3.0, 0.0, 6.0])
    backwards = PolynomialCurve(coefficients=(0.0, -2.0))
    np.testing.assert_allclose(curve_force(backwards, [-3.0, 3.0]), [6.0, -6.0])


def test_table_and_quadratic():
    np.testing.assert_allclose(curve_force(TABLE, [1000, 1250, 1500, 1710, 2000]), [-40, -22.5, 0, 25, 50])
    assert TABLE.rest == 1500.0
    assert FALLING.rest == 1511.0
    np.testing.assert_allclose(curve_force(ROTOR, [-600, -100, 100, 600]), [-25.0, -1.0, 2.0, 50.0])
    assert TableCurve(command=(0.0, 4.0), force=(-1.0, 3.0)).rest == 1.0


@pytest.mark.parametrize("curve", [PAPER, T200, TABLE, FALLING, ROTOR, OPEN], ids=lambda c: c.kind)
def test_nan_stays_and_shapes_stay(curve):
    assert np.isnan(curve_force(curve, np.nan))
    assert np.isnan(curve_command(curve, np.nan))
    assert curve_force(curve, np.ones((2, 3))).shape == (2, 3)
    assert curve_command(curve, np.ones((2, 3))).shape == (2, 3)
    assert curve_command(curve, 0.0) == curve.rest


@settings(max_examples=100, deadline=None)
@given(st.sampled_from([PAPER, T200, TABLE, FALLING, ROTOR]), st.floats(-80, 80), st.sampled_from([None, 11.0, 16.0]))
def test_inverse_gives_the_force_or_the_nearest(curve, wanted, voltage):
    low, high = force_range(curve, voltage)
    command = curve_command(curve, wanted, voltage)
    got = float(curve_force(curve, command, voltage))
    if wanted > high or wanted < low:
        assert got == pytest.approx(high if wanted > high else low, rel=1e-12)
    else:  # the first step of the paper's polynomial, at the edge of its dead band, is 0.0685 N
        assert got == pytest.approx(wanted, rel=1e-9, abs=0.0343 if curve is PAPER else 1e-9)
    if curve.limits is not None:
        assert curve.limits[0] <= command <= curve.limits[1]


def test_inverse_respects_the_dead_band():
    step = float(curve_force(PAPER, 5.0))
    assert step > 0.0
    np.testing.assert_array_equal(curve_command(PAPER, np.array([0.4, 0.6, -0.6]) * step), [0.0, 5.0, -5.0])


def test_inverse_without_limits_and_beyond_them():
    assert curve_command(OPEN, 1e6) == pytest.approx(np.sqrt(1e6 / 2e-4))
    assert curve_command(OPEN, -2.0) == pytest.approx(-100.0)
    assert curve_command(PAPER, 1e9) == 102.0
    assert curve_command(PAPER, np.inf) == 102.0
    assert force_range(OPEN) == (-np.inf, np.inf)


def test_inverse_of_one_direction_only():
    ahead = TableCurve(command=(0.0, 1.0), force=(0.0, 30.0))
    assert force_range(ahead) == (0.0, 30.0)
    np.testing.assert_allclose(curve_command(ahead, [-5.0, 15.0, 99.0]), [0.0, 0.5, 1.0], atol=1e-12)
    dead = PolynomialCurve(coefficients=(0.0,))
    assert force_range(dead) == (0.0, 0.0)
    assert curve_command(dead, 5.0) == 0.0


def test_inverse_of_a_polynomial_that_dips_takes_the_first_command():
    dipping = PolynomialCurve(coefficients=(0.0, 3.0, -3.0, 1.0), limits=(-3.0, 3.0), odd=True)
    command = curve_command(dipping, 0.5)
    assert curve_force(dipping, command) == pytest.approx(0.5)
    assert command < 1.0
