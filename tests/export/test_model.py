"""The portable model predicts what the pipeline predicts, for every kind of posterior."""

import copy
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose
from sklearn.linear_model import LinearRegression
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import (
    MaxAbsScaler,
    MinMaxScaler,
    RobustScaler,
    StandardScaler,
)

from skdgp import DependentGPRegressor
from skdgp.export import export_model, portable_model
from skdgp.preprocessing import ElevonSplitter, RegressorSelector


@pytest.mark.parametrize("noise", [1.0, 2.0, 0.0])
def test_equals_the_pipeline(case, noise, read):
    """As the example reads the file, with NumPy alone."""
    case.with_noise(noise).assert_moments(read(case.model).predict(case.X, noise))


def test_regressors_are_those_of_the_pipeline(fitted, portable_of, flight, read):
    expected = fitted("trend").pipeline[:-2].transform(flight)
    assert_allclose(read(portable_of("trend")).regressors(flight), expected, rtol=1e-12)


def test_parts_of_weight_zero_have_no_functions(fitted):
    fit = fitted("average")
    pipeline = copy.deepcopy(fit.pipeline)
    pipeline[-1].posterior_.mixture = np.repeat([[0.0], [1.0]], 6, axis=1)
    model = portable_model(pipeline, fit.aircraft)
    assert [len(part.terms) for part in model.parts[:6]] == [0] * 6


def test_the_reference_is_the_prediction_of_the_pipeline(case, central_difference):
    """At exact regressors, in and near the flights."""
    reference = case.model.reference
    assert reference.regressors.shape == (40, len(case.model.regressors))
    low, high = case.model.limits
    is_inside = ((low <= reference.regressors) & (reference.regressors <= high)).all(axis=1)
    assert 15 <= is_inside.sum() <= 40
    mean, std = case._replace(X=reference.regressors).predict(0.0)
    assert_allclose(reference.mean, mean, rtol=1e-10, atol=1e-12)
    assert_allclose(reference.std, std, rtol=1e-7)
    unit = reference.regressors.std(axis=0)

    def moved(move):
        return case._replace(X=reference.regressors + move * unit).predict(0.0)[0]

    slopes = reference.slopes * unit
    largest = np.abs(slopes).max(axis=(0, 1))
    found = central_difference(moved, np.zeros(len(unit)))
    assert_allclose(found / largest, slopes / largest, atol=1e-5)


def test_slopes_of_the_reference_are_in_the_order_of_the_outputs(in_another_order):
    """Differences of predictions behind the choice of regressors, for targets in another order than usual."""
    pipeline, aircraft = in_another_order
    reference = portable_model(pipeline, aircraft).reference
    behind = pipeline[1 + [*pipeline.named_steps].index("regressorselector") :]
    table = pd.DataFrame(reference.regressors, columns=behind.feature_names_in_)
    for k, name in enumerate(table):
        moved = table.assign(**{name: table[name] + 0.1})
        difference = (behind.predict(moved) - behind.predict(table)) / 0.1
        assert_allclose(difference, reference.slopes[..., k], rtol=1e-6, atol=1e-9)


START = DependentGPRegressor(optimizer=None)
OF_ALPHA = RegressorSelector(["alpha"])
FIRST = MinMaxScaler().set_output(transform="pandas")
TREND = DependentGPRegressor(structure="trend", max_iter=1)


def learned(steps, table):
    """Return a pipeline that learned six coefficients from its first column."""
    Y = np.sin(np.outer(10 * table.iloc[:, 0], np.arange(1, 7)))
    return make_pipeline(*steps).fit(table, Y)


@pytest.mark.parametrize(
    ("steps", "words"),
    [
        ([OF_ALPHA, LinearRegression()], "LinearRegression at the end"),
        ([FIRST, OF_ALPHA, START], "'MinMaxScaler'. before the choice of regressors"),
        (
            [OF_ALPHA, MinMaxScaler(clip=True), START],
            "behind the choice of regressors that is no linear scaler",
        ),
        (
            [RegressorSelector(["flap angle"]), TREND],
            r"\['flap angle'\], but exports need names of letters",
        ),
    ],
)
def test_what_has_no_form_is_refused(steps, words, flight, portable_of):
    model = learned(steps, flight[["alpha", "time"]].assign(**{"flap angle": flight["alpha"]}))
    with pytest.raises(ValueError, match=words):
        portable_model(model, portable_of("trend").aircraft)


def test_any_scaling_is_exported(flight, portable_of, read):
    scalers = (
        MinMaxScaler((-1, 2)), RobustScaler(with_centering=False), StandardScaler(with_std=False),
        MaxAbsScaler(),
    )  # fmt: skip
    model = learned([RegressorSelector(["alpha", "beta"]), *scalers, START], flight)
    reader = read(portable_model(model, portable_of("trend").aircraft))
    mean, _ = reader.predict(reader.regressors(flight))
    assert_allclose(mean, model.predict(flight), rtol=1e-9, atol=1e-9)


def test_a_control_asks_for_the_surfaces_that_move_it_alone(flight, portable_of):
    mixing = {"aileron": {"elevon_left": 0.5, "elevon_right": -0.5}, "elevator": {"rudder": 1.0}}
    model = learned([ElevonSplitter(mixing), RegressorSelector(["aileron"]), START], flight)
    (aileron,) = portable_model(model, portable_of("trend").aircraft).regressors
    assert dict(zip(aileron.sources, aileron.factors, strict=True)) == mixing["aileron"]


def test_the_reader_of_the_examples_imports_numpy_alone(example):
    text = Path(example("read_portable").__file__).read_text()
    imports = re.findall(r"^(?:import|from) (\w+)", text, re.MULTILINE)
    assert imports == ["argparse", "json", "numpy"]


def test_a_model_too_large_for_a_format_is_refused(tmp_path):
    with pytest.raises(ValueError, match="a model of 134 MB, but expected at most 67 MB"):
        export_model(tmp_path, SimpleNamespace(nbytes=2**27), "c")
