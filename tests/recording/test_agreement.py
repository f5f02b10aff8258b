"""What two accounts say of each other, against plain arithmetic over every stretch and lag."""

from __future__ import annotations

import numpy as np
import pytest

from towtank.recording.consistency.accounts import Cells
from towtank.recording.consistency.agreement import _cause, _reading, _roughness, _sums

CELLS = Cells(np.zeros((4, 1)), 0.05, 0.02, 3, 40, np.ones(1))


def accounts() -> tuple[np.ndarray, np.ndarray]:
    """Five stretches of 40 cells with three more on either side, two columns; some cells are not known."""
    measured, derived = np.random.default_rng(3).normal(size=(2, 5, 46, 2)) + 0.7
    measured[1, 10, 0] = np.nan
    derived[2, 20, 1] = np.nan
    derived[3, :25] = np.nan  # fewer than twenty cells are left
    derived[4] = np.nan
    return measured, derived


def test_products_are_of_deviations_from_the_mean_over_the_cells_that_all_lags_know() -> None:
    measured, derived = accounts()
    sums = _sums(measured, derived, CELLS)
    assert sums.md.shape == sums.mm.shape == (5, 7, 2)
    for s in range(3):
        good = [
            n
            for n in range(40)
            if np.isfinite(derived[s, 3 + n]).all() and all(np.isfinite(measured[s, n + k]).all() for k in range(7))
        ]
        d = derived[s, 3:43][good]
        d = d - d.mean(axis=0)
        np.testing.assert_allclose(sums.dd[s], (d**2).sum(axis=0))
        for k in range(7):
            m = measured[s, k : k + 40][good]
            m = m - m.mean(axis=0)
            np.testing.assert_allclose(sums.md[s, k], (m * d).sum(axis=0), atol=1e-10)
            np.testing.assert_allclose(sums.mm[s, k], (m**2).sum(axis=0), atol=1e-10)
    assert not sums.md[3:].any()
    assert not sums.dd[3:].any()


def test_the_deviation_of_a_mean_is_that_of_the_textbook() -> None:
    sums = _sums(*accounts(), CELLS)
    values = np.array([1.0, 4.0, 2.0, 7.0, 3.0])
    found = sums.each_left_out(lambda _, rows: np.asarray(values[rows].mean()))
    assert float(found) == pytest.approx(values.std(ddof=1) / np.sqrt(5.0))


def test_the_lag_is_where_most_is_explained_and_between_cells_by_a_parabola() -> None:
    md = np.array([[1.0], [2.0], [4.0], [3.0], [1.0]])
    found = _reading(md, np.full((5, 1), 8.0), np.array([4.0]))
    assert found.lag == pytest.approx(0.5 * (4.0 - 9.0) / (4.0 - 32.0 + 9.0))
    assert (found.at_edge, found.low[0], found.high[0], found.share[0], found.against[0]) == (False, 1.0, 2.0, 0.5, 0.0)
    later = _reading(np.roll(md, 1, axis=0), np.full((5, 1), 8.0), np.array([4.0]))
    assert later.lag == pytest.approx(found.lag + 1.0)
    edge = _reading(md[::-1].cumsum(axis=0), np.full((5, 1), 200.0), np.array([4.0]))
    assert (edge.at_edge, edge.lag) == (True, 2.0)
    first = _reading(md[:, :] * np.array([[9.0], [1.0], [1.0], [1.0], [1.0]]), np.full((5, 1), 200.0), np.array([4.0]))
    assert (first.at_edge, first.lag) == (True, -2.0)


def test_the_other_sign_speaks_against_it() -> None:
    md = np.array([[1.0, -1.0], [2.0, -4.0], [-1.0, 3.0], [0.0, 0.0], [0.0, 0.0]])
    found = _reading(md, np.full((5, 2), 16.0), np.array([4.0, 4.0]))
    assert found.low.tolist() == [0.5, -1.0]
    assert found.high.tolist() == [8.0, -4.0]
    assert found.share.tolist() == [4.0 / 64.0, 16.0 / 64.0]
    assert found.against.tolist() == [1.0 / 64.0, 9.0 / 64.0]


def test_a_column_counts_by_how_much_moves_in_it() -> None:
    md = np.array([[0.0, 0.0], [0.3, 0.0], [0.0, 8.0], [0.0, 0.0]])
    mm, dd = np.array([[0.1, 100.0]] * 4), np.array([1.0, 100.0])
    assert _reading(md, mm, dd).lag == pytest.approx(-1.0 + 1.0 + 0.5, abs=1.0)
    large = _reading(md, mm, np.array([1.0, 1e4]))
    small = _reading(md, mm, np.array([1e4, 1.0]))
    assert round(small.lag) == 0
    assert round(large.lag) in (0, 1)


def test_what_smoothing_takes_out_is_roughness() -> None:
    cells = np.random.default_rng(3).normal(size=(3, 20, 2))
    smooth = 0.5 * cells[:, 2:-2]
    detail, left = cells[:, 2:-2] - smooth, smooth - smooth.mean(axis=(0, 1))
    expected = (detail**2).sum(axis=(0, 1)) / (left**2).sum(axis=(0, 1))
    np.testing.assert_allclose(_roughness(cells, smooth), expected)
    cells[1, 5] = np.nan
    known = np.ones((3, 16), dtype=np.bool_)
    known[1, 3] = False
    left = smooth - smooth[known].mean(axis=0)
    expected = ((cells[:, 2:-2] - smooth)[known] ** 2).sum(axis=0) / (left[known] ** 2).sum(axis=0)
    np.testing.assert_allclose(_roughness(cells, smooth), expected)


@pytest.mark.parametrize(
    "gain, spread, cause",
    [
        (1000.0, 1.02, "millimetres, not metres"),
        (1060.0, 1.005, "scale"),
        (1060.0, 1.03, "millimetres, not metres"),
        (-1.0, 1.0, "sign"),
        (-1.25, 1.0, "sign"),
        (-0.8, 1.0, "sign"),
        (-1.4, 1.0, "scale"),
        (-0.7, 1.0, "scale"),
        (2.0, 1.0, "knots, not m/s"),
        (2.05, 1.0, "scale"),
        (1.0, 1.0, "scale"),
        (-3.6, 1.0, "km/h, not m/s"),
        (3.4, 1.05, "feet, not metres"),
        (3.45, 1.05, "km/h, not m/s"),
    ],
)
def test_a_gain_has_the_cause_that_is_nearest(gain: float, spread: float, cause: str) -> None:
    assert _cause(gain, gain / spread, gain * spread)[0] == cause
