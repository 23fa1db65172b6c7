"""Thinned targets: which rows stay observed."""

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_array_equal

from skdgp.model_selection import thin_targets


def observed(Y):
    values = np.asarray(Y, dtype=float).reshape(len(Y), -1)
    return np.flatnonzero(~np.isnan(values).all(axis=1))


@pytest.mark.parametrize(("n", "n_samples"), [(14_400, 755), (100, 99), (100, 100), (7, 3), (5, 1)])
def test_as_many_as_asked_for_evenly_spread(n, n_samples):
    rows = observed(thin_targets(np.arange(n, dtype=float), n_samples))
    assert len(rows) == n_samples
    if n_samples > 1:
        assert np.ptp(np.diff(rows)) <= 1
    assert rows[0] <= n / n_samples
    assert n - 1 - rows[-1] <= n / n_samples


def test_rows_that_were_never_observed_do_not_count():
    Y = np.arange(1000.0)
    Y[:600] = np.nan
    rows = observed(thin_targets(Y, 40))
    assert len(rows) == 40
    assert rows.min() >= 600
    assert np.ptp(np.diff(rows)) == 0


def test_row_observed_in_one_output_only_counts_and_keeps_its_hole():
    Y = np.column_stack([np.full(10, np.nan), np.arange(10.0)])
    thin = thin_targets(Y, 5)
    assert len(observed(thin)) == 5
    assert np.isnan(thin[:, 0]).all()


def test_kept_rows_keep_their_values_and_the_original_is_untouched():
    Y = default_rng(0).normal(size=(50, 6))
    before = Y.copy()
    thin = thin_targets(Y, 10)
    assert_array_equal(thin[observed(thin)], Y[observed(thin)])
    assert_array_equal(Y, before)


@pytest.mark.parametrize("n_samples", [0, -3, 2.5, "all", True])
def test_senseless_numbers(n_samples):
    with pytest.raises(ValueError, match="expected a positive number of rows"):
        thin_targets([1.0, 2.0], n_samples)
