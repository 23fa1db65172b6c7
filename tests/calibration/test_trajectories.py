"""What bands of whole trajectories promise, on exchangeable flights without an aircraft."""

import numpy as np
import pandas as pd
import pytest
from scipy.stats import norm

from skdgp.calibration import CalibratedBands

TIME = 0.1 * np.arange(6)
STATES = ("q", "theta")


def walk(rng):
    return 0.1 * np.vstack([np.zeros(2), np.cumsum(rng.normal(size=(len(TIME) - 1, 2)), axis=0)])


def table(values, **more):
    return pd.DataFrame({"time": TIME, **more}).assign(**dict(zip(STATES, values.T, strict=True)))


def ensemble(n, rng, n_paths=12):
    paths = [table(walk(rng), start=s, path=p, ended="") for s in range(n) for p in range(n_paths)]
    return pd.concat(paths, ignore_index=True)


@pytest.fixture
def rng():
    return np.random.default_rng(0)


def stay(bands, recorded, names):
    """Whether the recorded states are inside of their bands from the first time to the last."""
    inside = [
        recorded[n].between(bands[f"{n}_low"] - 1e-12, bands[f"{n}_high"] + 1e-12).to_numpy()
        for n in names
    ]
    return np.all(inside)


@pytest.mark.parametrize(("n_others", "level"), [(9, 0.9), (9, 0.5), (4, 0.8)])
def test_of_exchangeable_flights_exactly_the_level_is_held(rng, n_others, level):
    """Each of n + 1 flights held out in turn: those with the ceil((n + 1) level) smallest scores are inside."""
    paths, recorded = (
        ensemble(n_others + 1, rng),
        [table(3 * walk(rng), flight=k) for k in range(n_others + 1)],
    )
    held = []
    for k in range(n_others + 1):
        others = [part for j, part in enumerate(recorded) if j != k]
        calibrated = CalibratedBands.from_flights(paths[paths["start"] != k], others)
        held.append(stay(calibrated.bands(paths[paths["start"] == k], level), recorded[k], ["q"]))
    assert np.mean(held) == np.ceil((n_others + 1) * level - 1e-9) / (n_others + 1)


def test_each_flight_counts_once(rng):
    """A flight of many segments weighs as much as one of few."""
    recorded = [
        table(k * walk(rng), flight=name)
        for name, n in (("a", 1), ("b", 7), ("c", 3))
        for k in range(1, n + 1)
    ]
    calibrated = CalibratedBands.from_flights(ensemble(11, rng), recorded)
    scores, units = calibrated.scores["rates"], calibrated.units

    def share(q):
        return sum(np.mean(scores[units == k] <= q) for k in range(3)) / 4

    assert calibrated.max_level == 0.75
    assert calibrated.factors(0.6)["rates"] == min(q for q in scores if share(q) >= 0.6)


def test_too_few_flights_say_so_and_assume_a_distribution(rng):
    """Of lognormal scores the fallback holds the level, though few flights guarantee less; levels are in order."""
    n, level = 4, 0.95
    held = []
    for log_scores in rng.normal(1.0, 0.5, (200, n)):
        calibrated = CalibratedBands(
            pd.DataFrame({"rates": np.exp(log_scores)}), np.arange(n), "flight", {}, {}
        )
        with pytest.warns(
            UserWarning, match=r"4 flights guarantee no more than 0.8.*Calibrate on 19.*level=0.8\."
        ):
            q = calibrated.factors(level)["rates"]
        assert q >= calibrated.factors(0.8)["rates"]
        held.append(norm.cdf(np.log(q), 1.0, 0.5))
    assert level - 3 * np.std(held) / np.sqrt(200) < np.mean(held) < 0.5 + 0.5 * level


def test_segments_of_one_flight_replace_flights(rng):
    with pytest.warns(UserWarning, match=r"one flight, so its 3 segments"):
        calibrated = CalibratedBands.from_flights(
            ensemble(3, rng), [table(walk(rng)) for _ in range(3)]
        )
    assert (calibrated.unit, calibrated.n_units) == ("segment", 3)


def test_angles_are_compared_on_the_circle_and_gaps_are_left_out(rng):
    paths, recorded = ensemble(2, rng), [table(walk(rng), flight=k) for k in range(2)]
    turned = [part.assign(theta=part["theta"] + 2 * np.pi) for part in recorded]
    first, second = (
        CalibratedBands.from_flights(paths, parts).scores for parts in (recorded, turned)
    )
    np.testing.assert_allclose(first, second)
    recorded[0].loc[2, "q"] = np.nan
    assert np.isfinite(CalibratedBands.from_flights(paths, recorded).scores).all(axis=None)


def test_noise_of_the_records_widens_bands_and_lowers_scores(rng):
    paths, recorded = ensemble(2, rng), [table(walk(rng), flight=k) for k in range(2)]
    exact, noisy = (
        CalibratedBands.from_flights(paths, recorded, noise=n) for n in (None, {"q": 0.3})
    )
    assert (noisy.scores["rates"] < exact.scores["rates"]).all()
    np.testing.assert_array_equal(noisy.scores["attitude"], exact.scores["attitude"])
    at_start = noisy.bands(paths, level=0.6).query("time == 0")
    np.testing.assert_allclose(at_start["q_high"], 0.3 * noisy.factors(0.6)["rates"])


def test_a_trajectory_that_ended_is_no_band(rng):
    paths = ensemble(3, rng)
    paths.loc[(paths["start"] == 0) & (paths["time"] > 0.3), list(STATES)] = np.nan
    calibrated = CalibratedBands.from_flights(paths, [table(walk(rng), flight=k) for k in range(3)])
    assert calibrated.factors(0.75)["rates"] == np.inf


def test_what_cannot_be_calibrated_is_said(rng):
    paths, recorded = ensemble(2, rng), [table(walk(rng), flight=k) for k in range(2)]
    for flights, message in (
        (recorded[:1], "one segment for each start"),
        ([part.iloc[:3] for part in recorded], "records to its end"),
        ([part.assign(q=np.nan) for part in recorded], "without a value of q"),
        ([recorded[0], recorded[1].drop(columns="q")], "lacks the columns"),
    ):
        with pytest.raises(ValueError, match=message):
            CalibratedBands.from_flights(paths, flights)
    with pytest.raises(ValueError, match="at least two"):
        CalibratedBands.from_flights(paths[paths["start"] == 0], recorded[:1])
    with pytest.raises(ValueError, match="does not spread"):
        CalibratedBands.from_flights(paths[paths["path"] == 0], recorded)
    with pytest.raises(ValueError, match="probability inside"):
        CalibratedBands.from_flights(paths, recorded).factors(95)
