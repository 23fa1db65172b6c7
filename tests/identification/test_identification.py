"""The pipeline from flights to coefficients, and the file that keeps it."""

import hashlib
import json
import pickle
import subprocess
import sys
from unittest.mock import patch

import joblib
import numpy as np
import pandas as pd
import pytest
from flight_columns import COEFFICIENTS
from numpy.random import default_rng
from numpy.testing import assert_allclose
from sklearn.base import clone
from sklearn.exceptions import ConvergenceWarning, NotFittedError
from sklearn.linear_model import LinearRegression
from sklearn.model_selection import GridSearchCV, LeaveOneGroupOut
from sklearn.preprocessing import StandardScaler

from skdgp import DependentGPRegressor, FewRowsWarning, listening, make_identification_pipeline
from skdgp.dynamics import Aircraft, aerodynamic_coefficients
from skdgp.identification import (
    ModelFileError,
    identify,
    load_model,
    named_flights,
    save_model,
)
from skdgp.metrics import SCORERS
from skdgp.model_selection import thin_targets
from skdgp.report import save_report

GLIDER = Aircraft.estimate(3.0, 1.8)
QUICK = DependentGPRegressor(structure="joint", n_latent=1, max_iter=3, random_state=0)
AVERAGE = clone(QUICK).set_params(structure="average")


@pytest.fixture(scope="module")
def fitted(
    flights,
    delta,
):
    table, Y = flights()
    learned = thin_targets(Y, 60)
    model = make_identification_pipeline(delta, cutoff=3.0, regressor=QUICK).fit(table, learned)
    return model, table, Y, learned


class TestPipeline:
    def test_learns_what_elevons_and_rates_do(self, fitted):
        model, table, Y, _ = fitted
        assert model["regressorselector"].regressors_ == [
            "alpha", "beta", "p_hat", "q_hat", "r_hat", "elevator", "aileron", "rudder", "throttle",
        ]  # fmt: skip
        assert ((Y - model.predict(table)).std() < [0.015, 0.005]).all()

    @pytest.mark.usefixtures("short_fits")
    def test_a_grid_reaches_every_step(self, tmp_path, flights, delta):
        table, Y = flights(150)
        model = make_identification_pipeline(delta, regressor=QUICK)
        model.set_params(memory=str(tmp_path))
        grid = [
            {
                "flightsmoother__cutoff": [cutoff],
                "regressorselector__regressors": [regressors],
                "dependentgpregressor__trend": ["linear"],
            }
            for cutoff, regressors in ((2.0, "classical"), (4.0, "paper"))
        ]
        search = GridSearchCV(
            model, grid, scoring=SCORERS["log_predictive_density"], cv=LeaveOneGroupOut()
        )
        search.fit(table, thin_targets(Y, 40), groups=table["flight"])
        assert np.isfinite(search.cv_results_["mean_test_score"]).all()
        assert (search.best_estimator_[-1].drift_variance_ > 0).all()

    def test_a_list_of_regressors_asks_for_no_other_column(self, flights, delta):
        table, Y = flights()
        table = table.drop(columns=["beta", "p", "r", "throttle"])
        model = make_identification_pipeline(
            delta,
            regressors=["alpha", "q_hat", "alpha_dot_hat", "elevator"],
            cutoff=3.0,
            regressor=LinearRegression(),
        )
        assert model.fit(table, Y).predict(table).shape == (600, 2)
        with pytest.raises(TypeError, match="return_std"):
            model.predict(table, return_std=True)

    def test_refuses_what_is_no_aircraft(self):
        with pytest.raises(
            TypeError, match=r"Got dict for aircraft, but expected .*Aircraft.from_file"
        ):
            make_identification_pipeline({"span": 2.6, "chord": 0.55})


@pytest.fixture(scope="module")
def example(first_minute):
    """Return short example flights: two to learn from, one to test."""
    data = first_minute()
    return data.aircraft, data.train[data.train["time"] < 10], data.test[data.test["time"] < 6]


@pytest.fixture(scope="module")
def result(example, cut_short):
    aircraft, train, test = example
    with pytest.warns((FewRowsWarning, ConvergenceWarning)), cut_short():
        found = identify(train, aircraft, test=test, samples=40, regressor=QUICK, horizon=1.0)
    assert found.metrics["flight_mechanics"]["derivatives"]
    return found


@pytest.fixture(scope="module")
def averaged(example, cut_short):
    """Return what comes of tables by name and no test flight, with an average, and what was warned of."""
    aircraft, train, _ = example
    flights = train.groupby("flight", observed=True)
    tables = {name: table.drop(columns="flight") for name, table in flights}
    with pytest.warns() as shown, cut_short():
        found = identify(tables, aircraft, samples=40, regressor=AVERAGE, horizon=1.0)
    return found, shown


@pytest.fixture(scope="module")
def stopped(result, tmp_path_factory):
    """Return a result whose fit has not converged, and the folder where it is saved, without pictures."""
    assert not result.fit.converged
    with patch.dict(sys.modules, {"matplotlib": None}):
        return result, save_report(result, tmp_path_factory.mktemp("saved") / "new" / "folder")


def of_code(result, name):
    """Return the findings of a code."""
    return [finding for finding in result.findings if finding.code.name == name]


BARE = pd.DataFrame({"time": [0.0, 0.1], "flight": "bare", "alpha": 0.0})


@pytest.mark.usefixtures("short_fits", "no_mechanics")
class TestIdentify:
    def test_gives_a_model_its_scores_and_its_facts(self, result):
        assert result.fit.samples == result.options["samples"] == 40
        assert {name: len(flight) for name, flight in result.train.items()} == {
            "lateral": 400,
            "latlon": 400,
        }
        assert not of_code(result, "HELD_OUT_FLIGHT")

    def test_saves_what_load_model_reads(self, stopped):
        result, folder = stopped
        assert folder.parts[-2:] == ("new", "folder")
        assert {path.name for path in folder.iterdir()} == {
            "model.joblib",
            "metrics.json",
            "report.html",
        }
        assert load_model(folder / "model.joblib").fit == result.metrics["fit"]
        assert json.loads((folder / "metrics.json").read_text()) == result.metrics
        assert "two_altitudes" in (folder / "report.html").read_text(encoding="utf-8")

    def test_takes_tables_by_name_and_holds_out_the_last(self, averaged):
        found, shown = averaged
        (held_out,) = of_code(found, "HELD_OUT_FLIGHT")
        assert held_out.flight == "latlon"
        assert list(found.train) == ["lateral"]
        assert list(found.metrics["test"]) == ["latlon"]
        assert {" ".join(str(one.message).split()) for one in shown} == {
            finding.text for finding in found.findings
        }
        for words in ("No test flight was named", "Got 40 rows"):
            assert sum(words in finding.text for finding in found.findings) == 1

    @pytest.mark.parametrize(
        ("change", "error", "message"),
        [
            ({"regressor": LinearRegression()}, TypeError, "expected a DependentGPRegressor"),
            ({"aircraft": {"mass": 3.0}}, TypeError, "Got dict for aircraft"),
            ({"aircraft": "uav.yaml"}, ValueError, "ends in .json or .toml"),
            ({"flights": []}, ValueError, "Got no flight"),
            ({"flights": 7}, TypeError, "Got .*int.* for flight"),
            ({"thrust": "rocket"}, ValueError, "rocket"),
            ({"test": BARE}, ValueError, "The flight 'bare' lacks the columns 'airspeed'"),
        ],
    )
    def test_refuses_what_cannot_be_before_the_fit(self, example, change, error, message):
        aircraft, train, test = example
        given = {"flights": train, "aircraft": aircraft, "test": test, "regressor": QUICK}
        stages = []
        with (
            listening(lambda stage, *_: stages.append(stage)),
            pytest.raises(error, match=message),
        ):
            identify(**given | change)
        assert not {"fit", "output 1"} & set(stages)

    def test_says_the_weights_of_the_average(self, averaged):
        weights = averaged[0].metrics["fit"]["weights"]
        assert list(weights) == ["joint", "trend"]
        for name in COEFFICIENTS:
            assert_allclose(sum(of[name] for of in weights.values()), 1.0)

    def test_bands_of_the_truth_have_the_errors_of_the_log(self, result, example):
        (flight,) = result.evaluations
        _, std = result.pipeline.predict(example[2], return_std=True)
        assert_allclose(flight.std, std, rtol=1e-6)
        noise = result.pipeline[-1].noise_variance_
        by_log = result.pipeline.log_errors_.variance(flight.regressors)
        expected = np.maximum(flight.std**2 - by_log, 0.0) + noise
        assert_allclose(flight.prediction_std**2, expected, rtol=1e-6)

    @pytest.mark.filterwarnings("ignore")
    def test_targets_without_names_are_the_coefficients(self, example):
        aircraft, train, test = example
        train = train[train["time"] < 6]
        model = make_identification_pipeline(aircraft, regressor=QUICK, samples=40)
        Y = aerodynamic_coefficients(train, aircraft)
        model.fit(train, Y.to_numpy())
        expected = clone(model).fit(train, Y).predict(test, return_std=True)
        assert_allclose(model.predict(test, return_std=True), expected, rtol=1e-12)

    @pytest.mark.filterwarnings("ignore")
    def test_says_that_a_lag_is_unknown(self, first_minute):
        """Records of 18 s, longer than a judgement needs in all, have no pieces to compare."""
        example = first_minute()
        short = example.train[example.train["time"] < 18.0]
        found = identify(short, example.aircraft, test=short, regressor=QUICK, samples=40)
        (lag,) = of_code(found, "LAG_UNKNOWN")
        assert found.fit.lags["applied"]["surfaces"] == 0.0
        assert not found.fit.lags["std"]["surfaces"] < 0.05
        assert "do not show their lag" in lag.text

    def test_names_tables_that_have_no_names(self, example):
        bare = example[2].drop(columns="flight")
        assert list(named_flights([bare, bare])) == ["flight 1", "flight 2"]
        assert list(named_flights(bare, default="test flight")) == ["test flight 1"]

    def test_refuses_surfaces_in_two_units(self, example):
        aircraft, train, test = example
        with pytest.raises(ValueError, match="expected one unit"):
            identify(train, aircraft, test=test.assign(full_throw=1.0))

    def test_refuses_a_flight_that_comes_twice(self, example):
        aircraft, train, test = example
        with pytest.raises(ValueError, match=r"'lateral' in table 1 and in table 2.*give a dict"):
            identify([train, train], aircraft, test=test)
        with pytest.raises(ValueError, match="Got 2 flights in the table 'both'"):
            identify({"both": train}, aircraft, test=test)


@pytest.fixture
def model_file(fitted, tmp_path, delta):
    return save_model(tmp_path / "model.joblib", fitted[0], delta, options={"thrust": None})


def closed(data, model=None, **changes):
    """Return a model file as bytes, with another model or header, and the checksum that fits."""
    pickled, _, closing = data[:-64].rpartition(b"\n")
    closing = json.dumps(json.loads(closing) | changes).encode()
    content = (pickled if model is None else model) + b"\n" + closing
    return content + hashlib.sha256(content).hexdigest().encode()


def another_model(data, *change):
    """Return the file with other bytes of the model, and a checksum that fits."""
    return closed(data, data[:-64].rpartition(b"\n")[0].replace(*change))


RUBBISH = b"[" * 10000, b'{"format": 2, "versions": 7, "bytes": 1}'
DAMAGED = [
    *((lambda data, share=share: data[: int(share * len(data))], r"not a whole skdgp model.*cut off")
      for share in (0.5, 0.999)),
    *((lambda data, rubbish=rubbish: data + rubbish, "not a whole skdgp model")
      for rubbish in RUBBISH),
    *((lambda data, content=content: content, f"{len(content)} bytes.*Expected a file that skdgp")
      for content in (b"", b"time,alpha\n0,1\n")),
    (lambda data: closed(data, format=99), r"format 99.*reads format 15: fit it again"),
    (lambda data: another_model(data, b"skdgp._regressor", b"skdgp._regresser"),
     r"written with skdgp .*cannot be read by skdgp .*No module"),
]  # fmt: skip


class Bomb:
    """What cannot be unpickled."""

    def __reduce__(self):
        return ModelFileError.__new__, ("unpickled",)


class TestModelFile:
    @pytest.mark.parametrize(("change", "match"), DAMAGED)
    def test_what_is_no_model(self, model_file, change, match):
        model_file.write_bytes(change(model_file.read_bytes()))
        with pytest.raises(ModelFileError, match=match):
            load_model(model_file)

    @pytest.mark.parametrize("load", [load_model, joblib.load])
    def test_holds_what_was_saved(self, model_file, delta, load):
        model = load(model_file)
        assert model.aircraft == delta
        assert model.options == {"thrust": None}
        assert set(model.versions) >= {"skdgp", "scikit-learn", "numpy", "python"}

    def test_a_fresh_process_predicts_the_same(self, model_file, fitted, tmp_path):
        fitted[1].to_pickle(tmp_path / "table.pkl")
        code = (
            "import sys, pandas, pickle; from skdgp.identification import load_model\n"
            "model = load_model('model.joblib').pipeline; table = pandas.read_pickle('table.pkl')\n"
            "pickle.dump(model.predict(table, return_std=True, include_noise=True), "
            "open('found.pkl', 'wb'))"
        )
        subprocess.run([sys.executable, "-W", "error", "-c", code], cwd=tmp_path, check=True)
        mean, std = pickle.loads((tmp_path / "found.pkl").read_bytes())
        expected = fitted[0].predict(fitted[1], return_std=True, include_noise=True)
        assert_allclose(mean, expected[0], rtol=1e-9, atol=1e-10)
        assert_allclose(std, expected[1], rtol=1e-9, atol=1e-10)

    def test_nothing_is_unpickled_of_a_damaged_file(self, fitted, tmp_path, delta):
        path = save_model(tmp_path / "model.joblib", fitted[0], delta, note=Bomb())
        with pytest.raises(ModelFileError, match="cannot be read by"):
            load_model(path)
        path.write_bytes(path.read_bytes().replace(b"skdgp._regressor", b"skdgp._regresser"))
        with pytest.raises(ModelFileError, match="not a whole skdgp model"):
            load_model(path)

    def test_another_version_is_read_with_a_warning(self, model_file, delta):
        versions = {"skdgp": "0.0.1", "scikit-learn": "1.6.0", "numpy": "1.26.4"}
        model_file.write_bytes(closed(model_file.read_bytes(), versions=versions))
        with pytest.warns(
            UserWarning,
            match=r"written with skdgp 0\.0\.1.*scikit-learn 1\.6\.0.*\(installed: .*may differ",
        ):
            assert load_model(model_file).aircraft == delta

    def test_a_single_flipped_bit(self, model_file):
        """In the checksum, the header, and many places of the model: what loads is what was saved."""
        data = model_file.read_bytes()
        model = 8 * data.rindex(b"\n")
        places = default_rng(0).integers(0, model, 30)
        for place in [*places, *range(model, 8 * len(data), 23)]:
            flipped = bytearray(data)
            flipped[place // 8] ^= 1 << place % 8
            model_file.write_bytes(flipped)
            with pytest.raises(ModelFileError, match="not a whole skdgp model"):
                load_model(model_file)

    @pytest.mark.parametrize(
        ("pipeline", "aircraft", "error", "match"),
        [
            (QUICK, GLIDER, NotFittedError, "not fitted yet"),
            (None, GLIDER, TypeError, "not an estimator"),
            (StandardScaler().fit([[0.0]]), None, TypeError, "Got NoneType for aircraft"),
        ],
    )
    def test_what_is_no_model_is_not_saved(self, tmp_path, pipeline, aircraft, error, match):
        with pytest.raises(error, match=match):
            save_model(tmp_path / "model.joblib", pipeline, aircraft)
        assert list(tmp_path.iterdir()) == []
