"""Blocks in time: what is held out, at what distance, and that whole pipelines live with it."""

import numpy as np
import pandas as pd
import pytest
import sklearn
from sklearn.base import clone
from sklearn.linear_model import LinearRegression
from sklearn.model_selection import LeaveOneGroupOut, cross_validate

from skdgp.metrics import SCORERS, score_outputs
from skdgp.model_selection import BlockSplit, thin_targets
from skdgp.preprocessing import FlightSmoother


def clock(lengths=(200, 90), step=0.1):
    """Flights of some rows, one after the other, none beginning at zero."""
    tables = [
        pd.DataFrame({"time": 100.0 * k + step * np.arange(n), "flight": f"f{k}"})
        for k, n in enumerate(lengths)
    ]
    return pd.concat(tables, ignore_index=True)


@pytest.mark.parametrize("n_splits", [2, 5, 7])
@pytest.mark.parametrize("gap", [0, 0.55, 1.5])
class TestWhatIsHeldOut:
    def test_every_row_is_tested_once_in_blocks_of_its_flight(self, n_splits, gap):
        table = clock()
        tests = [test for _, test in BlockSplit(n_splits, gap=gap).split(table)]
        np.testing.assert_array_equal(np.sort(np.concatenate(tests)), np.arange(len(table)))
        for test in tests:
            for _, rows in table.iloc[test].groupby("flight"):
                assert (np.diff(rows.index) == 1).all()
        sizes = [table.iloc[test].groupby("flight").size() for test in tests]
        assert np.ptp(sizes, axis=0).max() <= 1

    def test_training_rows_are_all_that_keep_the_distance(self, n_splits, gap):
        table = clock()
        time, flight = table["time"].to_numpy(), table["flight"].to_numpy()
        between = np.where(flight[:, None] == flight, np.abs(time[:, None] - time), np.inf)
        for train, test in BlockSplit(n_splits, gap=gap).split(table):
            nearest = between[:, test].min(axis=1)
            apart = np.flatnonzero((nearest >= gap) & (nearest > 0))
            np.testing.assert_array_equal(train, apart)

    def test_flights_interleaved_or_named_by_groups_are_cut_the_same(self, n_splits, gap):
        table = clock()
        expected = list(BlockSplit(n_splits, gap=gap).split(table))
        by_groups = BlockSplit(n_splits, gap=gap).split(
            table.drop(columns="flight"), groups=table["flight"]
        )
        order = np.argsort(table["time"] % 100, kind="stable")
        mixed = BlockSplit(n_splits, gap=gap).split(table.iloc[order])
        for (train, test), named, (mixed_train, mixed_test) in zip(
            expected, by_groups, mixed, strict=True
        ):
            np.testing.assert_array_equal(named[0], train)
            np.testing.assert_array_equal(named[1], test)
            np.testing.assert_array_equal(np.sort(order[mixed_train]), train)
            np.testing.assert_array_equal(np.sort(order[mixed_test]), test)


class TestProtocol:
    @pytest.mark.parametrize("routing", [True, False])
    def test_groups_with_and_without_routing(self, flights, model, routing):
        table, Y = flights()
        words = {
            "params" if routing else "groups": {"groups": table["flight"]}
            if routing
            else table["flight"]
        }
        with sklearn.config_context(enable_metadata_routing=routing):
            model = clone(model).set_params(dependentgpregressor=LinearRegression())
            for more in (words, {}):
                found = cross_validate(
                    model, table, Y, cv=BlockSplit(3), error_score="raise", **more
                )
                assert (found["test_score"] > 0.9).all()

    @pytest.mark.parametrize(
        ("splitter", "message"),
        [
            (BlockSplit(1), "Got n_splits=1, but expected a number of blocks"),
            (BlockSplit(2.0), "Got n_splits=2.0"),
            (BlockSplit(True), "Got n_splits=True"),
            (BlockSplit(gap=-1), "Got gap=-1, but expected seconds"),
            (BlockSplit(gap=np.nan), "Got gap=nan"),
            (BlockSplit(40), "Got 90 rows of flight 'f1' for n_splits=40 blocks"),
            (BlockSplit(2, gap=30), "no row of any flight is so far"),
        ],
    )
    def test_senseless_numbers(self, splitter, message):
        with pytest.raises(ValueError, match=message):
            list(splitter.split(clock()))


@pytest.mark.parametrize(("table", "groups", "message"), [
    (np.zeros((50, 2)), None, "expected a pandas DataFrame"),
    (clock().drop(columns="time"), None, "lacks the columns 'time'"),
    (clock().iloc[::-1], None, "expected time to increase"),
    (clock().replace({"flight": {"f1": None}}), None, "rows without a flight"),
    (clock().drop(columns="flight"), [1, 2, 3], "Got 3 groups for 290 rows"),
])  # fmt: skip
def test_tables_without_a_clock(table, groups, message):
    with pytest.raises((ValueError, TypeError), match=message):
        list(BlockSplit().split(table, groups=groups))


class TestHoles:
    """What is left of a flight is two stretches, and nothing is smoothed or differentiated across the hole."""

    @pytest.mark.parametrize("gap", [0.0, 1.0])
    def test_two_sides_are_as_two_flights(self, flights, gap):
        table, _ = flights(names=("a",))
        for train, test in BlockSplit(3, gap=gap).split(table):
            rest = table.iloc[train]
            smoother = FlightSmoother(cutoff=3.0, derivatives=["alpha", "q"])
            apart = rest.assign(flight=np.where(train < test[0], "before", "after"))
            found, expected = smoother.fit_transform(rest), smoother.fit_transform(apart)
            columns = ["alpha", "q", "alpha_dot", "q_dot"]
            np.testing.assert_allclose(found[columns], expected[columns], rtol=1e-9, atol=1e-10)

    @pytest.mark.parametrize("cutoff", ["auto", 3.0])
    def test_a_step_behind_the_hole_is_not_felt_before_it(self, cutoff):
        time = np.arange(0, 60, 0.025)
        table = pd.DataFrame({"time": time, "alpha": np.where(time < 30, 0.1, 0.3)})
        train, test = list(BlockSplit(3, gap=0.0).split(table))[1]
        assert table["alpha"].iloc[test].nunique() == 2
        found = FlightSmoother(cutoff=cutoff, joint=None).fit_transform(table.iloc[train])
        np.testing.assert_allclose(found["alpha"], table["alpha"].iloc[train], atol=1e-9)
        np.testing.assert_allclose(found["alpha_dot"], 0.0, atol=1e-7)

    def test_the_smallest_block_leaves_a_hole_that_is_seen(self):
        table = clock((30,))
        table["alpha"] = np.where(table["time"] < 1.5, 0.1, 0.3)
        train, _ = list(BlockSplit(10, gap=0.0).split(table))[5]  # rows 15 to 17
        found = FlightSmoother(cutoff=2.0).fit_transform(table.iloc[train])
        np.testing.assert_allclose(found["alpha"], table["alpha"].iloc[train], atol=1e-12)


class TestWholePipeline:
    @pytest.mark.parametrize(
        "cv", [BlockSplit(3, gap=0.5), LeaveOneGroupOut()], ids=["blocks", "flights"]
    )
    def test_cross_validate_with_thinned_targets(self, flights, model, cv):
        table, Y = flights()
        found = cross_validate(
            *(model, table, thin_targets(Y, 60)),
            groups=table["flight"],
            cv=cv,
            scoring=SCORERS,
            error_score="raise",
        )
        n = cv.get_n_splits(table, groups=table["flight"])
        for name in SCORERS:
            assert found[f"test_{name}"].shape == (n,)
        assert (found["test_neg_normalized_rmse"] > -0.5).all()
        assert (found["test_interval_coverage"] > 0.3).all()  # nothing was optimised

    def test_the_models_of_the_folds_are_those_fitted_by_hand(self, flights, model):
        table, Y = flights()
        thin = thin_targets(Y, 40)
        found = cross_validate(model, table, thin, cv=BlockSplit(2), scoring=score_outputs)
        for k, (train, test) in enumerate(BlockSplit(2).split(table)):
            fitted = clone(model).fit(table.iloc[train], thin.iloc[train])
            by_hand = score_outputs(fitted, table.iloc[test], thin.iloc[test])
            assert by_hand == {
                name.removeprefix("test_"): found[name][k]
                for name in found
                if name.startswith("test_")
            }
