"""The build-up: exact where the model is a trend or additive, linear in the posterior, honest about its loss."""

import json

import numpy as np
import pandas as pd
import pytest
from scipy.interpolate import RegularGridInterpolator
from sklearn.linear_model import LinearRegression

from skdgp._effects import effects
from skdgp.calibration import CalibratedRegressor
from skdgp.export import Table, build_up, write_build_up

COEFFICIENTS = ["CX", "CY", "CZ", "Cl", "Cm", "Cn"]


def test_a_trend_is_its_derivatives_everywhere(built, fitted, regressors):
    found, far = built("trend"), 3.0 * regressors + 0.1
    assert not any(found.tables.values())
    np.testing.assert_allclose(found.evaluate(far), fitted("trend").predict(far), atol=1e-9)
    assert (found.loss["loss"] < 1e-9).all()
    std = found.evaluate(far, return_std=True)[1]
    expected = fitted("trend").predict(far, return_std=True)[1]
    np.testing.assert_allclose(std, expected, rtol=1e-4)
    slopes, slopes_std = fitted("trend")[-1].predict_gradient(
        fitted("trend")[:-1].transform(far)[:1], return_std=True
    )
    scale = fitted("trend")[0].scale_
    np.testing.assert_allclose(found.derivatives, slopes[0] / scale, atol=1e-9)
    np.testing.assert_allclose(found.derivatives_std, slopes_std[0] / scale, rtol=1e-4)


@pytest.mark.parametrize("name", ["additive", "joint", "sparse", "average", "sparse-average"])
def test_sum_is_the_model_within_its_deviation(name, built, fitted, regressors):
    found = built(name)
    off = found.evaluate(regressors) - fitted(name).predict(regressors)
    np.testing.assert_allclose(
        np.sqrt(np.mean(off**2, axis=0)), found.loss["loss"], rtol=1e-6, atol=1e-12
    )
    deviation = fitted(name)[-1].predict(fitted(name)[:-1].transform(regressors), return_std=True)[
        1
    ]
    np.testing.assert_allclose(
        np.sqrt(np.mean(deviation**2, axis=0)), found.loss["deviation"], rtol=1e-6
    )
    if name == "additive":
        assert (found.loss["loss"] < 0.5 * found.loss["deviation"]).all()


def test_main_effects_of_an_additive_model_are_its_tables(built, fitted, regressors):
    found, curves = built("additive"), effects(fitted("additive")).curves
    assert any(table.regressors == ("alpha",) for table in found.tables["CZ"])
    at = pd.DataFrame(np.tile(regressors.mean(), (30, 1)), columns=regressors.columns)
    at["alpha"] = curves["alpha"].at
    values, expected = found.evaluate(at), curves["alpha"].mean
    off = (values - values.mean(axis=0)) - (expected - expected.mean(axis=0))
    assert (np.abs(off) < 1.5 * found.loss["deviation"].to_numpy()).all()


@pytest.mark.parametrize("name", ["sparse", "average"])
def test_deviations_are_those_of_drawn_aircraft(name, built, regressors):
    """At each row and, of an average, over all rows: a rare member that differs much is in few draws."""
    found = built(name)
    drawn = np.stack([each.evaluate(regressors[:20]) for each in found.sample(300, random_state=0)])
    mean, std = found.evaluate(regressors[:20], return_std=True)
    of_draws = drawn.std(axis=0)
    if "average" in name:
        of_draws, over_rows = (np.sqrt(np.mean(values**2, axis=0)) for values in (of_draws, std))
        np.testing.assert_allclose(of_draws, over_rows, rtol=0.2)
    else:
        np.testing.assert_allclose(of_draws, std, rtol=0.2)
    assert (np.abs(drawn.mean(axis=0) - mean) < 0.2 * std).all()


def test_cells_have_the_deviation_of_the_posterior(built, fitted, regressors):
    """A table of one regressor at a time: L K L^T with the posterior covariance K of a dense computation."""
    found, model = built("additive"), fitted("additive")
    for table in found.tables["CZ"]:
        assert (
            table.values.shape
            == table.std.shape
            == tuple(len(points) for points in table.breakpoints)
        )
        assert all((np.diff(points) > 0).all() for points in table.breakpoints)
    inside = regressors[:40]
    std = found.evaluate(inside, return_std=True)[1]
    expected = model.predict(inside, return_std=True)[1]
    ratio = np.sqrt(np.mean(std**2, axis=0) / np.mean(expected**2, axis=0))
    assert ((ratio > 0.8) & (ratio < 1.05)).all()


def test_tables_are_linear_between_breakpoints_and_constant_beyond():
    one = Table(("alpha",), (np.array([0.0, 1.0, 3.0]),), np.array([0.0, 2.0, 6.0]), np.zeros(3))
    np.testing.assert_allclose(one(np.array([[-1.0], [0.5], [2.0], [9.0]])), [0.0, 1.0, 4.0, 6.0])
    axes = (np.array([0.0, 1.0]), np.array([0.0, 2.0]))
    two = Table(("alpha", "beta"), axes, np.array([[0.0, 2.0], [4.0, 10.0]]), np.zeros((2, 2)))
    np.testing.assert_allclose(two(np.array([[0.5, 1.0], [2.0, 5.0]])), [4.0, 10.0])


@pytest.mark.filterwarnings("ignore:Got one flight", "ignore:Got level")
def test_a_calibrated_model_has_calibrated_deviations(fitted, uav, regressors):
    plain = fitted("trend")
    model = type(plain)([("scale", plain[0]), ("calibrated", CalibratedRegressor(plain[-1], cv=2))])
    Y = pd.DataFrame(plain.predict(regressors), columns=COEFFICIENTS) + 1e-3 * np.sin(
        7 * regressors.to_numpy()[:, :1]
    )
    model.fit(regressors, Y)
    inner = model[-1].estimator_.predict(model[:-1].transform(regressors), return_std=True)[1]
    std = build_up(model, uav).evaluate(regressors, return_std=True)[1]
    np.testing.assert_allclose(std, inner * model[-1].std_scale_, rtol=1e-3)


def test_file_holds_all_that_a_reader_needs(built, tmp_path):
    """Coefficients by NumPy and the file alone."""
    found = built("joint")
    write_build_up(tmp_path / "build_up.json", found)
    file = json.loads((tmp_path / "build_up.json").read_text())
    X = dict(zip(file["regressors"], found.samples[:5].T, strict=True))
    for k, (name, entry) in enumerate(file["coefficients"].items()):
        value = entry["constant"] + sum(
            entry["derivatives"][r] * (x - file["regressors"][r]["reference"]) for r, x in X.items()
        )
        for table in entry["tables"]:
            points, cells = table["breakpoints"], np.array(table["values"])
            assert cells.shape == np.shape(table["std"]) == tuple(map(len, points))
            at = [
                np.clip(X[r], p[0], p[-1]) for r, p in zip(table["regressors"], points, strict=True)
            ]
            value = value + RegularGridInterpolator(points, cells)(np.stack(at, axis=-1))
        np.testing.assert_allclose(value, found.evaluate(found.samples[:5])[:, k], atol=1e-12)
        assert {key: entry[key] for key in ("loss", "deviation")} == found.loss.loc[name].to_dict()
    assert file["aircraft"] == {"name": "uav", "span": 2.6, "chord": 0.5}


def test_effects_are_parts_of_the_sum(built):
    """Means zero over the samples; together with their mean they are the build-up; deviations as in a trend."""
    found = built("joint")
    for k, name in enumerate(COEFFICIENTS):
        effect, terms = found.effects(name), [(r,) for r in found.regressors]
        terms += [t.regressors for t in found.tables[name] if len(t.regressors) == 2]
        columns = [[found.regressors.index(r) for r in term] for term in terms]
        parts = [
            effect(term, found.samples[:, c])[0] for term, c in zip(terms, columns, strict=True)
        ]
        np.testing.assert_allclose(np.mean(parts, axis=1), 0.0, atol=1e-9)
        whole = found.evaluate(found.samples)[:, k]
        np.testing.assert_allclose(sum(parts), whole - whole.mean(), atol=1e-9)
    trend = built("trend")
    mean, std = trend.effects("Cm")(("alpha",), np.array([[0.1]]))
    away = 0.1 - trend.samples[:, 0].mean()
    np.testing.assert_allclose(mean, trend.derivatives.loc["Cm", "alpha"] * away)
    np.testing.assert_allclose(std, trend.derivatives_std.loc["Cm", "alpha"] * abs(away))


class TestBadInput:
    def test_loss_is_refused_with_its_figure(self, fitted, uav):
        with pytest.raises(ValueError, match=r"change by \{.*'\w+': '\d.*expected at most 1e-06"):
            build_up(fitted("sparse"), uav, max_loss=1e-6)

    @pytest.mark.parametrize(
        ("options", "match"),
        [({"pairs": "beta"}, "expected 'all'"), ({"tolerance": 0.0}, "positive fractions")],
    )
    def test_options(self, fitted, uav, options, match):
        with pytest.raises(ValueError, match=match):
            build_up(fitted("trend"), uav, **options)

    def test_another_estimator(self, uav, regressors):
        model = LinearRegression().fit(regressors, np.ones((len(regressors), 6)))
        with pytest.raises(TypeError, match="expected a fitted DependentGPRegressor"):
            build_up(model, uav)
