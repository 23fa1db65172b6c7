"""Restart windows cover every step of every run once, in order, and never longer than the horizon."""

from itertools import pairwise

import numpy as np
import pytest

from skdgp.dynamics._replay import restart_windows


@pytest.mark.parametrize("horizon", [0.05, 0.3, 1.0, 100.0, np.inf])
def test_windows_cover_every_step_once(horizon):
    time = np.cumsum(np.random.default_rng(0).uniform(0.08, 0.12, 60))
    rows = restart_windows(time, [slice(3, 20), slice(20, 21), slice(25, 60)], horizon)
    steps = sorted((a, b) for window in rows for a, b in pairwise(window.tolist()) if a != b)
    assert steps == [(k, k + 1) for k in [*range(3, 19), *range(25, 59)]]
    if horizon >= 0.12:
        assert (time[rows[:, -1]] - time[rows[:, 0]]).max() <= horizon + 1e-9


def test_stored_clocks_that_were_rounded_give_full_windows():
    time = (np.arange(401) * 0.025).astype(np.float32).astype(float)
    rows = restart_windows(time, [slice(0, 401)], 2.0)
    assert rows.shape == (5, 81)


def test_windows_start_where_the_state_is_known_and_cover_what_they_can():
    time, known = np.arange(20) * 0.1, np.zeros(20, dtype=bool)
    known[[2, 7, 11, 13]] = True
    rows = restart_windows(time, [slice(0, 20)], 0.6, known)
    assert [sorted(set(window.tolist())) for window in rows] == [
        list(range(2, 8)),
        list(range(7, 14)),
        list(range(13, 20)),
    ]
    sparse = np.zeros(20, dtype=bool)
    sparse[[0, 15]] = True
    rows = restart_windows(time, [slice(0, 20)], 0.6, sparse)
    assert [sorted(set(window.tolist())) for window in rows] == [
        list(range(7)),
        list(range(15, 20)),
    ]
