"""Fitting a thruster curve: a bench that is known, a real one, and benches that are wrong."""

import numpy as np
import pytest

from towtank.errors import InputError
from towtank.vehicle import PolynomialCurve, TableCurve, Voltage, curve_force, curve_text, fit_thruster

TRUTH = PolynomialCurve(
    neutral=1500.0,
    scale=400.0,
    dead_band=30.0,
    coefficients=(-1.2, 20.0, 30.0),
    reverse=(-1.0, 15.0, 22.0),
    limits=(1100.0, 1900.0),
    voltage=Voltage(nominal=14.0, exponent=1.3, reverse_exponent=1.1),
)


def write(path, header, rows):
    path.write_text(header + "\n" + "\n".join(",".join(str(cell) for cell in row) for row in rows) + "\n")
    return path


@pytest.fixture
def bench(tmp_path):
    commands = np.arange(1100.0, 1901.0, 10.0)
    rows = [(v, c, float(curve_force(TRUTH, c, v))) for v in (10.0, 14.0, 18.0) for c in commands]
    return write(tmp_path / "bench.csv", "supply_V,pwm_us,force_N", rows)


def test_known_curve_is_found(bench):
    fit = fit_thruster(bench)
    curve = fit.curve
    assert isinstance(curve, PolynomialCurve)
    np.testing.assert_allclose(curve.coefficients, TRUTH.coefficients, atol=1e-6)
    np.testing.assert_allclose(curve.reverse, TRUTH.reverse, atol=1e-6)
    assert (curve.neutral, curve.scale, curve.limits) == (1500.0, 400.0, (1100.0, 1900.0))
    assert curve.voltage.exponent == pytest.approx(1.3)
    assert curve.voltage.reverse_exponent == pytest.approx(1.1)
    assert fit.dead_band == (1480.0, 1520.0)  # the first commands with force are 1470 and 1530
    assert fit.forward.r_squared == pytest.approx(1.0)
    assert fit.asymmetry == pytest.approx(48.8 / 36.0)
    assert fit.rmse < 1e-6
    assert [v.voltage for v in fit.voltages] == [10.0, 14.0, 18.0]
    assert fit.nominal_voltage == 14.0
    assert curve_text(curve).startswith('curve = {kind = "polynomial", ')


def test_table_passes_through_the_points(bench):
    fit = fit_thruster(bench, kind="table", nominal_voltage=18)
    assert isinstance(fit.curve, TableCurve)
    assert fit.nominal_voltage == 18.0
    assert fit.rmse < 1e-5
    assert fit.curve.rest == 1500.0


def test_other_units_and_names(tmp_path):
    path = write(tmp_path / "b.csv", "U,Thrust_kgf", [(u / 10, 2 * u * abs(u) / 100) for u in range(-10, 11)])
    fit = fit_thruster(path)
    assert fit.nominal_voltage is None
    assert fit.curve.voltage is None
    assert curve_force(fit.curve, 1.0) == pytest.approx(2 * 9.80665, rel=1e-6)
    renamed = write(tmp_path / "c.csv", "x,y", [(u, u) for u in range(-5, 6)])
    assert curve_force(fit_thruster(renamed, command="x", force="y", degree=1).curve, 3.0) == pytest.approx(3.0)


def test_thruster_of_one_direction_and_of_falling_force(tmp_path):
    one = fit_thruster(write(tmp_path / "one.csv", "command,force_N", [(u, u * u) for u in range(11)]))
    assert one.reverse is None
    assert one.asymmetry is None
    np.testing.assert_allclose(curve_force(one.curve, [-3.0, 5.0, 50.0]), [0.0, 25.0, 100.0], atol=1e-4)
    falling = fit_thruster(write(tmp_path / "f.csv", "pwm,force_N", [(1500 + u, -u / 4) for u in range(-400, 401, 50)]))
    np.testing.assert_allclose(curve_force(falling.curve, [1100, 1500, 1900]), [100, 0, -100], atol=1e-4)


@pytest.mark.parametrize(
    "content, message",
    [
        ("", "the file is empty"),
        ("t,thrust_N\n0,1\n", r"b\.csv:1: no column for the command: found t, thrust_N; expected pwm_us"),
        ("pwm,x\n0,1\n", r"b\.csv:1: no column for the force"),
        ("pwm,force_N\n1500,0\n1600,much\n", r'b\.csv:3:2: found "much" in column force_N, expected a number'),
        ("pwm,force_N\n1500\n", r"b\.csv:2: found 1 columns, expected 2"),
        ("pwm,force_N\n", "no rows with a command and a force"),
        ("pwm,force_N\nnan,1\n,2\n", "no rows with a command and a force"),
        ("pwm,force_N\n1500,0\n1600,0\n", "all forces are zero"),
        ("pwm,force_N\n1500,0\n1600,1\n1400,-1\n", "found 1 commands above neutral with force, expected at least 3"),
        ("pwm,force_N,voltage\n1500,0,0\n1600,1,0\n", "found 0 V, expected voltages above 0"),
    ],
)
def test_wrong_bench_is_told(tmp_path, content, message):
    (tmp_path / "b.csv").write_text(content)
    with pytest.raises(InputError, match=message):
        fit_thruster(tmp_path / "b.csv")


def test_wrong_arguments_are_told(bench, tmp_path):
    with pytest.raises(InputError, match="no such file"):
        fit_thruster(tmp_path / "nowhere.csv")
    with pytest.raises(InputError, match=r"nominal voltage 5 V was not measured; found 10, 14, 18 V"):
        fit_thruster(bench, nominal_voltage=5)
    with pytest.raises(InputError, match="degree: found 0"):
        fit_thruster(bench, degree=0)
    with pytest.raises(InputError, match='kind: found "spline"'):
        fit_thruster(bench, kind="spline")


def test_real_t200_bench(data):
    fit = fit_thruster(data / "thruster_bench" / "t200_bluerobotics_2019.csv")
    assert fit.nominal_voltage == 16.0
    np.testing.assert_allclose(fit.curve.coefficients, [-2.4, 26.1, 29.5], atol=0.06)
    np.testing.assert_allclose(fit.curve.reverse, [-2.0, 21.5, 21.9], atol=0.06)
    assert fit.forward.r_squared == pytest.approx(0.9996, abs=5e-5)
    assert fit.reverse.r_squared == pytest.approx(0.9993, abs=5e-5)
    assert fit.dead_band == (1472.0, 1528.0)
    assert fit.curve.voltage.exponent == pytest.approx(1.20, abs=0.005)
    assert fit.curve.voltage.reverse_exponent == pytest.approx(1.13, abs=0.005)
    assert 1.27 <= fit.asymmetry <= 1.33


@pytest.mark.parametrize(
    "name, r_squared",
    [
        ("t100_bluerobotics_12V.csv", 0.998),
        ("t200_firstgen_12V_2015.csv", 0.997),
        ("t200_linkoping_2016_normalised.csv", 0.997),
        ("ngs_rov_thruster_steady_2018.csv", 0.99),
    ],
)
def test_other_real_benches(data, name, r_squared):
    fit = fit_thruster(data / "thruster_bench" / name)
    assert min(fit.forward.r_squared, fit.reverse.r_squared) > r_squared
