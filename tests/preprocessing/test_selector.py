"""Which regressors are chosen, which may be absent, and what is said when one is not there."""

import numpy as np
import pandas as pd
import pytest
from numpy.random import default_rng
from pandas.testing import assert_frame_equal

from skdgp.preprocessing import FlightSmoother, RateNondimensionalizer, RegressorSelector

CLASSICAL = [
    "alpha",
    "beta",
    "p",
    "q",
    "r",
    "alpha_dot",
    "beta_dot",
    "elevator",
    "aileron",
    "rudder",
    "throttle",
]
PAPER = [
    "ax", "ay", "az", "p", "q", "r", "p_dot", "q_dot", "r_dot", "alpha_dot", "beta_dot",
    "throttle", "elevator", "aileron", "rudder",
]  # fmt: skip
QUASI_STEADY = [name for name in CLASSICAL if name not in ("alpha_dot", "beta_dot")]
NUMBERS = [*dict.fromkeys(CLASSICAL + PAPER), "alpha_true"]
EVERY = pd.DataFrame(default_rng(0).normal(size=(6, len(NUMBERS))), columns=NUMBERS)
EVERY = EVERY.assign(airspeed=30.0, flight="one")


@pytest.mark.parametrize(
    ("name", "columns"),
    [
        ((), QUASI_STEADY),
        (["quasi-steady"], QUASI_STEADY),
        (["classical"], CLASSICAL),
        (["paper"], PAPER),
    ],
)
def test_named_sets(name, columns):
    selector = RegressorSelector(*name).fit(EVERY)
    assert selector.regressors_ == columns
    assert selector.absent_ == []
    assert_frame_equal(selector.transform(EVERY), EVERY[columns])


@pytest.mark.parametrize(
    ("motion", "expected"),
    [(0.0, set()), (0.009, {"airspeed"}), (0.011, {"throttle", "airspeed"})],
)
def test_an_engine_brings_the_airspeed_among_the_regressors(motion, expected):
    """One that moves by less than a hundredth above zero too: its thrust depends on the airspeed."""
    throttle = 60 * motion + motion * np.resize([1.0, -1.0], 6)
    selector = RegressorSelector(engine=True).fit(EVERY.assign(throttle=throttle))
    assert {"throttle", "airspeed"} & {*selector.regressors_} == expected


@pytest.mark.parametrize(("motion", "expected"), [(0.009, []), (0.011, ["flap"])])
def test_flaps_that_move_are_among_the_regressors(motion, expected):
    flown = EVERY.assign(flap=motion * np.resize([1.0, -1.0], 6))
    assert RegressorSelector().fit(flown).regressors_ == [*QUASI_STEADY, *expected]


def test_nondimensional_rates_take_the_place_of_rates():
    table = RateNondimensionalizer(span=2.0, chord=1.0).fit_transform(EVERY)
    chosen = RegressorSelector("classical").fit(table).regressors_
    assert chosen == [
        "alpha", "beta", "p_hat", "q_hat", "r_hat", "alpha_dot_hat", "beta_dot_hat",
        "elevator", "aileron", "rudder", "throttle",
    ]  # fmt: skip


def test_ranges_are_those_of_the_channels_in_rows_with_a_target():
    table = pd.DataFrame({
        "flight": list("aaab"), "alpha": [0.0, 0.1, 0.3, 9.0], "phi": [-0.5, np.nan, 0.2, 9.0],
        "alpha_true": 1.0, "mine": 2.0,
    })  # fmt: skip
    targets = np.column_stack([[1.0, np.nan, 0.0, np.nan], [1.0, 2.0, 0.0, np.nan]])
    selector = RegressorSelector(["alpha"]).fit(table, targets)
    assert selector.ranges_ == {"alpha": (0.0, 0.3), "phi": (-0.5, 0.2)}


def test_limits_are_those_of_rows_with_all_regressors_of_any_type():
    table = pd.DataFrame({"q_hat": [1.0, 3.0, 99.0], "alpha": [0.2, 0.1, np.nan]}).assign(
        gear=[True, False, True]
    )
    limits = RegressorSelector(["alpha", "q_hat", "gear"]).fit(table).in_simulation()["limits"]
    np.testing.assert_array_equal(limits, [[0.1, 1.0, 0.0], [0.2, 3.0, 1.0]])


def test_truth_only_by_name_and_with_a_warning():
    with pytest.warns(UserWarning, match=r"\['alpha_true'\] are noise-free truth"):
        RegressorSelector(["alpha_true", "q"]).fit(EVERY)
    with pytest.raises(ValueError, match="lacks the columns 'alpha'"):
        RegressorSelector("classical").fit(
            EVERY.drop(columns="alpha")
        )  # alpha_true does not stand in


def test_holes_are_refused_by_the_names_of_regressors():
    table = EVERY.copy()
    table.loc[[1, 2], "q"] = np.nan
    table.loc[3, "beta"] = np.inf
    table = RateNondimensionalizer(span=2.0, chord=1.0).fit_transform(table)
    selector = RegressorSelector("classical").fit(table)
    with pytest.raises(ValueError, match=r"3 of 6 rows .*'beta': 1, 'q_hat': 2.*drop these rows"):
        selector.transform(table)


@pytest.mark.parametrize(("regressors", "change", "match"), [
    ("classical", lambda table: table.rename(columns={"throttle": "Throttle"}), r"'throttle' \(nearest: 'Throttle'\)"),
    ("classical", lambda table: table.drop(columns=["alpha_dot", "beta_dot"]),
     r"'alpha_dot', 'beta_dot'.*FlightSmoother\(\) before"),
    ("classical", lambda table: table.drop(columns=["elevator", "aileron"]).assign(elevon_left=0.0, elevon_right=0.1),
     r"ElevonSplitter\(\) before"),
    (["alpha", "q", "alpha"], lambda table: table, "each once"),

    ("modern", lambda table: table, "parameter of RegressorSelector must be"),
])  # fmt: skip
def test_what_cannot_be_selected(regressors, change, match):
    with pytest.raises(ValueError, match=match):
        RegressorSelector(regressors).fit(change(EVERY))


@pytest.mark.filterwarnings("ignore:Got flights without an elevator")
@pytest.mark.parametrize(
    "absent", [["throttle"], ["elevator"], ["rudder"], ["throttle", "aileron", "rudder"]]
)
def test_controls_that_the_aircraft_does_not_have(absent):
    selector = RegressorSelector("classical").fit(EVERY.drop(columns=absent))
    assert sorted(selector.absent_) == sorted(absent)
    assert selector.regressors_ == [name for name in CLASSICAL if name not in absent]


def test_flights_without_an_elevator_are_told():
    with pytest.warns(UserWarning, match="without an elevator"):
        RegressorSelector().fit(EVERY.drop(columns="elevator"))


def test_a_rate_of_change_without_neighbours():
    flight = pd.concat([EVERY] * 5, ignore_index=True).drop(columns=["alpha_dot", "beta_dot"])
    flight["time"] = np.r_[0:20, 90, 180:189]
    made = FlightSmoother(cutoff=None, columns=["alpha", "beta"]).fit_transform(flight)
    with pytest.raises(ValueError, match=r"1 of 30 rows.*'alpha_dot': 1.*isolated rows"):
        RegressorSelector("classical").fit_transform(made)
