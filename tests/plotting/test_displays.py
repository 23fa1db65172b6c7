"""Displays: what is drawn is what was given, wherever it is drawn, and nothing breaks on poor data."""

from types import SimpleNamespace

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest
from matplotlib.collections import Collection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from scipy.stats import norm
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, WhiteKernel

from skdgp._flight.channels import COEFFICIENTS
from skdgp.plotting import (
    CalibrationDisplay,
    CoefficientDisplay,
    EnvelopeDisplay,
    FlightDisplay,
    StateDisplay,
)


def outputs(n=200, n_outputs=6, seed=0):
    """Return time, measured, mean and std of outputs whose intervals are honest."""
    rng = np.random.default_rng(seed)
    time = np.arange(n) / 40.0
    mean = np.sin(time[:, None] * np.arange(1, n_outputs + 1))
    std = np.full((n, n_outputs), 0.2)
    return time, mean + std * rng.normal(size=mean.shape), mean, std


def flight(n=400, seed=0):
    rng = np.random.default_rng(seed)
    t = np.arange(n) / 10.0
    return pd.DataFrame(
        {
            "time": t,
            "throttle": 0.6,
            "elevator": 0.05 * np.sin(t),
            "aileron": 0.02 * rng.normal(size=n),
            "rudder": 0.1 * np.cos(t),
            "v_north": 40 * np.cos(t / 5),
            "v_east": 40 * np.sin(t / 5),
            "altitude": 300 + 2 * t,
        }
    )


def coefficients(n, ax, corrupt=lambda values: values):
    time, measured, mean, std = outputs(n)
    return CoefficientDisplay.from_predictions(
        time, corrupt(measured), mean, std, truth=mean, ax=ax
    )


def states(n, ax, corrupt=lambda values: values):
    time, measured, mean, std = outputs(n, 3)
    return replayed(time, corrupt(measured), corrupt(mean), std, (time // 2).astype(int), ax=ax)


def replayed(time, measured, mean, std=None, window=0, **options):
    """Return the display of states as `replay` and a flight hold them."""
    table, flight = (
        pd.DataFrame(values, columns=["v_east", "p", "r"]) for values in (mean, measured)
    )
    table = table.assign(time=time, window=window, horizon=10.0)
    if std is not None:
        table[["v_east_std", "p_std", "r_std"]] = std
    return StateDisplay.from_replay(table, flight, **options)


def calibration(n, ax, corrupt=lambda values: values):
    _, measured, mean, std = outputs(n)
    return CalibrationDisplay.from_predictions(corrupt(measured), mean, std, ax=ax)


def transforms(n, ax, corrupt=lambda values: values):
    _, measured, mean, std = outputs(n)
    return CalibrationDisplay.from_predictions(corrupt(measured), mean, std, ax=ax, kind="pit")


def knowledge(n, ax, corrupt=lambda values: values):
    """Return the envelope of n samples and of another flight."""
    rng = np.random.default_rng(0)
    flown = pd.DataFrame(rng.normal(size=(n, 2)), columns=["alpha", "beta"])
    axis = np.linspace(-5.0, 5.0, 6)
    return EnvelopeDisplay(
        flown=flown,
        pairs=[("alpha", "beta")],
        points=[(axis, axis)],
        variance=np.hypot(*np.meshgrid(axis, axis))[None, :, :, None] / 8,
        flown_variance=np.ones(1),
        output_names=("CZ",),
        path=flown.assign(alpha=corrupt(flown[["alpha"]].to_numpy())),
    ).plot(ax)


def corrupted_flight(n, corrupt):
    table = flight(n)
    table[["elevator", "v_east"]] = corrupt(table[["elevator", "v_east"]].to_numpy())
    return table


def inputs(n, ax, corrupt=lambda values: values):
    return FlightDisplay.from_flights({"a": corrupted_flight(n, corrupt), "b": flight(n)}, ax=ax)


def path(n, ax, corrupt=lambda values: values):
    return FlightDisplay.from_flights({"a": corrupted_flight(n, corrupt)}, kind="path", ax=ax)


DISPLAYS = [coefficients, states, calibration, transforms, knowledge, inputs, path]
MULTIPLE = {coefficients: (3, 2), transforms: (3, 2), states: (3, 1), inputs: (4, 2)}


def holes(values):
    values = values.copy()
    values[: len(values) // 2 + 1] = np.nan
    return values


def nothing(values):
    return np.full_like(values, np.nan)


def constant(values):
    return np.zeros_like(values)


def n_points(display):
    """Return how many vertices all lines and areas of a figure have."""
    display.figure_.canvas.draw()
    artists = [artist for ax in display.figure_.axes for artist in ax.get_children()]
    lines = sum(len(artist.get_xdata()) for artist in artists if isinstance(artist, Line2D))
    areas = [
        one for artist in artists if isinstance(artist, Collection) for one in artist.get_paths()
    ]
    return lines + sum(len(area.vertices) for area in areas)


def assert_drawn(display, full):
    """Assert that a display has the panels and labels of another one, and finite limits."""
    display.figure_.draw_without_rendering()
    panels, others = (
        [ax for ax in one.figure_.axes if ax.get_visible()] for one in (display, full)
    )
    assert [(ax.get_xlabel(), ax.get_ylabel()) for ax in panels] == [
        (ax.get_xlabel(), ax.get_ylabel()) for ax in others
    ]
    assert np.isfinite([[*ax.get_xlim(), *ax.get_ylim()] for ax in panels]).all()


@pytest.mark.parametrize("make", DISPLAYS)
class TestEveryDisplay:
    def test_draws_into_a_given_figure_or_a_new_one_of_pyplot(self, make):
        before = set(plt.get_fignums())
        figure = Figure()
        assert make(200, figure).figure_ is figure
        assert set(plt.get_fignums()) == before
        figure.canvas.draw()
        display = make(50, None)
        assert {display.figure_.number} == set(plt.get_fignums()) - before
        plt.close(display.figure_)

    def test_poor_data_leave_labelled_panels(self, make):
        full = make(50, Figure())
        for corrupt in (holes, nothing, constant):
            assert_drawn(make(50, Figure(), corrupt), full)

    def test_names_the_extra_when_matplotlib_is_absent(self, make, monkeypatch):
        monkeypatch.setitem(__import__("sys").modules, "matplotlib", None)
        with pytest.raises(ImportError, match=r'pip install "skdgp\[plot\]"'):
            make(10, None)


@pytest.mark.parametrize("make", [coefficients, states, inputs, path, knowledge])
def test_a_long_record_is_drawn_with_few_points(make):
    few, many = (n_points(make(n, Figure())) for n in (3000, 60_000))
    assert few > 300
    assert many < 4.1 * few


@pytest.mark.parametrize("make", MULTIPLE)
def test_panels_go_into_given_axes(make):
    figure = Figure()
    axes = figure.subplots(*MULTIPLE[make])
    display = make(100, axes)
    assert [id(ax) for ax in display.axes_.flat] == [id(ax) for ax in axes.flat]
    with pytest.raises(ValueError, match="Got 2 axes, but expected"):
        make(100, Figure().subplots(1, 2))


class TestCoefficients:
    def test_lines_are_the_data(self):
        time, measured, mean, std = outputs()
        display = CoefficientDisplay.from_predictions(
            time, measured, mean, std, truth=2 * mean, ax=Figure()
        )
        for k in range(6):
            np.testing.assert_array_equal(display.measured_[k].get_ydata(), measured[:, k])
            np.testing.assert_array_equal(display.mean_[k].get_ydata(), mean[:, k])
            np.testing.assert_array_equal(display.truth_[k].get_ydata(), 2 * mean[:, k])
            np.testing.assert_array_equal(display.mean_[k].get_xdata(), time)
        assert display.output_names == COEFFICIENTS

    def test_the_band_is_the_interval(self):
        time, measured, mean, std = outputs()
        display = CoefficientDisplay.from_predictions(
            time, measured, mean, std, level=0.9, ax=Figure()
        )
        half = norm.ppf(0.95) * std[:, 1]
        corners = display.bands_[1].get_paths()[0].vertices
        for edge in (mean[:, 1] - half, mean[:, 1] + half):
            points = np.column_stack([time, edge])
            assert {tuple(row) for row in points.round(9)} <= {
                tuple(row) for row in corners.round(9)
            }

    def test_residuals_alone_or_beneath_the_values(self):
        time, measured, mean, std = outputs()
        given = {"truth": mean, "kind": "residuals", "ax": Figure()}
        display = CoefficientDisplay.from_predictions(time, measured, mean, std, **given)
        np.testing.assert_allclose(display.measured_[2].get_ydata(), (measured - mean)[:, 2])
        np.testing.assert_array_equal(display.truth_[2].get_ydata(), 0)
        np.testing.assert_array_equal(display.mean_[2].get_ydata(), 0)
        display.plot(Figure(), kind="both", outputs=["CX", "Cm"])
        assert [ax.get_ylabel() for ax in display.axes_.T.flat] == [
            "$C_X$",
            "residual",
            "$C_m$",
            "residual",
        ][: display.axes_.size]
        np.testing.assert_array_equal(display.measured_[2].get_ydata(), measured[:, 4])
        np.testing.assert_allclose(display.measured_[3].get_ydata(), (measured - mean)[:, 4])
        assert [band is None for band in display.bands_] == [True, False, True, False]
        low = display.bands_[3].get_paths()[0].vertices[:, 1].min()
        assert low == pytest.approx(-norm.ppf(0.975) * std.max())

    def test_part_of_the_record_and_of_the_outputs(self):
        time, measured, mean, _ = outputs()
        display = CoefficientDisplay.from_predictions(
            time, measured, mean, outputs=["Cm"], time_span=(1.0, 2.0), ax=Figure()
        )
        assert display.axes_.shape == (1, 1)
        shown = display.mean_[0]
        assert (shown.get_xdata()[0], shown.get_xdata()[-1]) == (1.0, 2.0)
        np.testing.assert_array_equal(shown.get_ydata(), mean[(time >= 1) & (time <= 2), 4])
        assert display.bands_ == [None]
        assert display.truth_ == [None]

    def test_from_estimator(self):
        time, measured, _, _ = outputs(60, 2)
        X = pd.DataFrame({"time": time, "alpha": np.sin(time)})
        Y = pd.DataFrame(measured, columns=["CX", "Cm"])
        model = GaussianProcessRegressor(RBF() + WhiteKernel(0.1), optimizer=None).fit(X, Y)
        display = CoefficientDisplay.from_estimator(model, X, Y, ax=Figure())
        mean, std = model.predict(X, return_std=True)
        np.testing.assert_array_equal(display.mean, mean)
        np.testing.assert_array_equal(display.std, std)
        assert display.output_names == ("CX", "Cm")
        with pytest.raises(ValueError, match="without a column 'time'"):
            CoefficientDisplay.from_estimator(model, X.to_numpy(), Y)

    def test_noise_is_asked_for_only_when_wanted(self):
        time, measured, mean, std = outputs()
        asked = []

        def predict(X, **words):
            asked.append(words)
            return mean, std

        model = SimpleNamespace(predict=predict, output_names_=COEFFICIENTS)
        for include_noise in (False, True):
            CoefficientDisplay.from_estimator(
                model, None, measured, time=time, include_noise=include_noise, ax=Figure()
            )
        assert asked == [
            {"return_std": True},
            {"return_std": True, "include_noise": True, "include_input_noise": True},
        ]

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"mean": np.zeros((3, 6))}, r"mean of shape \(3, 6\), but expected \(200, 6\)"),
            ({"std": -np.ones((200, 6))}, "expected none below 0"),
            ({"time": np.zeros(3)}, "Got 3 times for 200 samples"),
            ({"time": np.full(200, np.nan)}, "200 values that are not finite"),
            ({"output_names": ["a", "b"]}, "for 6 outputs"),
            ({"outputs": ["CQ"]}, r"Got the outputs \['CQ'\]"),
            ({"level": 95}, "expected a probability"),
            ({"kind": "ratio"}, "expected 'values', 'residuals' or 'both'"),
            ({"time_span": (900, 901)}, "choose a span inside"),
        ],
    )
    def test_says_what_is_wrong(self, change, message):
        time, measured, mean, std = outputs()
        given = {
            "time": time,
            "measured": measured,
            "mean": mean,
            "std": std,
            "ax": Figure(),
            **change,
        }
        with pytest.raises(ValueError, match=message):
            CoefficientDisplay.from_predictions(**given)


class TestStates:
    def test_degrees_are_drawn_from_radians(self):
        time, measured, mean, std = outputs(100, 3)
        display = replayed(time, measured, mean, std, ax=Figure())
        np.testing.assert_array_equal(display.measured_[0].get_ydata(), measured[:, 0])
        np.testing.assert_allclose(display.replayed_[1].get_ydata(), np.rad2deg(mean[:, 1]))
        top = display.bands_[2].get_paths()[0].vertices[:, 1].max()
        assert top == pytest.approx(np.rad2deg(mean[:, 2] + norm.ppf(0.975) * std[:, 2]).max())

    def test_lines_break_between_windows(self):
        time, measured, mean, _ = outputs(100, 3)
        window = np.arange(100) // 25
        display = replayed(time, measured, mean, window=window, ax=Figure())
        for line in display.replayed_:
            assert np.isnan(line.get_ydata()).sum() == 3

    def trajectory(self, time, horizon):
        window = (time // horizon).astype(int)
        columns = {
            "time": time,
            "horizon": horizon,
            "window": window,
            "p": np.cos(time),
            "p_std": 0.1,
        }
        return pd.DataFrame(columns)

    def test_from_replay_takes_the_longest_horizon_or_the_one_asked_for(self):
        time = np.arange(400) / 10.0
        both = pd.concat([self.trajectory(time, 2.0), self.trajectory(time, 10.0)])
        table = pd.DataFrame({"time": time, "p": np.sin(time)})
        longest = StateDisplay.from_replay(both, table, states=["p"], ax=Figure())
        assert len(np.unique(longest.window)) == 4
        asked = StateDisplay.from_replay(both, table, states=["p"], horizon=2.0, ax=Figure())
        assert len(np.unique(asked.window)) == 20
        np.testing.assert_array_equal(asked.std[:, 0], 0.1)
        with pytest.raises(ValueError, match=r"holds \[2.0, 10.0\] s"):
            StateDisplay.from_replay(both, table, states=["p"], horizon=3.0)
        with pytest.raises(ValueError, match="with all its rows"):
            StateDisplay.from_replay(both, table.iloc[1:], states=["p"])


class TestCalibration:
    def test_coverage_against_the_definition(self):
        _, measured, mean, std = outputs(300)
        measured[::7, 2] = np.nan
        display = CalibrationDisplay.from_predictions(
            measured, mean, std, levels=[0.5, 0.95], ax=Figure()
        )
        for row, level in enumerate([0.5, 0.95]):
            half = norm.ppf((1 + level) / 2) * std
            for k in range(6):
                seen = ~np.isnan(measured[:, k])
                inside = np.abs(measured - mean)[seen, k] <= half[seen, k]
                assert display.observed[row, k] == inside.mean()

    def test_from_estimator_asks_for_noise(self):
        _, measured, mean, std = outputs(50)
        asked = []

        def predict(X, **words):
            asked.append(words)
            return mean, std

        CalibrationDisplay.from_estimator(
            SimpleNamespace(predict=predict), None, measured, ax=Figure()
        )
        assert asked == [{"return_std": True, "include_noise": True, "include_input_noise": True}]

    def test_transform_against_the_definition(self):
        _, measured, mean, std = outputs(300)
        measured[::7, 2] = np.nan
        display = CalibrationDisplay.from_predictions(measured, mean, std, kind="pit", ax=Figure())
        for k in range(6):
            seen = ~np.isnan(measured[:, k])
            values = norm.cdf(measured[seen, k], mean[seen, k], std[seen, k])
            expected, _ = np.histogram(values, 20, (0, 1), density=True)
            np.testing.assert_allclose(display.pit[:, k], expected)
            np.testing.assert_allclose(display.bars_[k].get_data().values, expected)

    @pytest.mark.parametrize("levels", [[0.0], [95], [np.nan]])
    def test_says_what_a_level_is(self, levels):
        _, measured, mean, std = outputs(50)
        with pytest.raises(ValueError, match="expected probabilities"):
            CalibrationDisplay.from_predictions(measured, mean, std, levels=levels)


class TestFlight:
    def test_one_column_per_flight_and_one_row_per_input(self):
        display = FlightDisplay.from_flights(
            {"train": flight(), "test": flight(200, seed=1)}, ax=Figure()
        )
        assert [ax.get_title(loc="left") for ax in display.axes_[0]] == ["train", "test"]
        labels = [ax.get_ylabel() for ax in display.axes_[:, 0]]
        assert labels == ["throttle", "elevator [deg]", "aileron [deg]", "rudder [deg]"]
        np.testing.assert_allclose(display.lines_[1].get_ydata(), np.rad2deg(flight()["elevator"]))

    def test_an_input_that_one_flight_lacks_is_said_so(self):
        both = {"a": flight(), "b": flight().drop(columns="rudder")}
        display = FlightDisplay.from_flights(both, ax=Figure())
        assert display.axes_[3, 1].texts[0].get_text() == "not recorded"

    def test_one_table_is_divided_by_flight(self):
        table = pd.concat([flight().assign(flight="one"), flight(100).assign(flight="two")])
        assert list(FlightDisplay.from_flights(table, ax=Figure()).flights) == ["one", "two"]

    def test_velocities_are_integrated_to_a_circle(self):
        n = 4000
        t = np.linspace(0, 10 * np.pi, n)
        table = pd.DataFrame(
            {"time": t, "v_north": 40 * np.cos(t / 5), "v_east": 40 * np.sin(t / 5)}
        )
        display = FlightDisplay.from_flights({"a": table}, kind="path", ax=Figure())
        east, north = display.lines_[0].get_data()
        np.testing.assert_allclose(np.hypot(north, east - 200), 200, rtol=1e-4)
        assert len(east) <= 600

    def test_recorded_positions_are_taken(self):
        table = flight().assign(north=np.arange(400.0) + 7, east=np.arange(400.0) * 2)
        display = FlightDisplay.from_flights({"a": table}, kind="path", ax=Figure())
        assert display.lines_[0].get_ydata()[0] == 7
        assert display.lines_[0].get_xdata()[-1] == 798

    def test_the_marker_of_one_start_does_not_cover_that_of_another(self):
        both = {"train": flight(), "test": flight(seed=1)}
        starts = FlightDisplay.from_flights(both, kind="path", ax=Figure()).starts_
        assert {marker.get_markerfacecolor() for marker in starts} == {"none"}
        assert starts[0].get_markersize() > 1.3 * starts[1].get_markersize()
        assert starts[0].get_marker() != starts[1].get_marker()

    def test_any_name_may_be_drawn(self):
        names = ["$x^", "_hidden", "a & <b>"]
        for kind in ("inputs", "path"):
            display = FlightDisplay.from_flights(
                {name: flight(50) for name in names}, kind=kind, ax=Figure()
            )
            display.figure_.canvas.draw()
        assert len(display.axes_[0, 0].get_legend().texts) == 3

    @pytest.mark.parametrize(
        ("flights", "options", "message"),
        [
            ({}, {}, "Got no flights"),
            ({"a": flight().drop(columns="time")}, {}, "flight 'a' lacks the columns 'time'"),
            ({"a": flight()[["time"]]}, {}, "without any of"),
            ({"a": flight()[["time"]]}, {"kind": "path"}, "lacks the columns 'v_north'"),
            ({"a": flight()}, {"kind": "speed"}, "expected 'inputs' or 'path'"),
        ],
    )
    def test_says_what_is_wrong(self, flights, options, message):
        with pytest.raises(ValueError, match=message):
            FlightDisplay.from_flights(flights, ax=Figure(), **options)
