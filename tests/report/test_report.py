"""The report: whole, self-contained, readable, true to the numbers it is given."""

import re
import unicodedata
from base64 import b64decode
from dataclasses import replace
from html.parser import HTMLParser
from types import SimpleNamespace

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest
from made_flights import make_flight
from numpy.random import default_rng
from sklearn.exceptions import UndefinedMetricWarning

from skdgp import DependentGPRegressor
from skdgp.identification import Evaluation, FlightMechanics, Use, Verdict
from skdgp.metrics import normalized_rmse
from skdgp.plotting import EffectsDisplay
from skdgp.report import render_report

VOID = {"meta", "br", "hr", "img", "input", "link"}
LOADED = ("src", "href", "data", "action")


class Page(HTMLParser):
    """Check that elements close in order, and collect what a reader sees and what a browser would load."""

    def __init__(self, html):
        super().__init__(convert_charrefs=True)
        self.open = []
        self.text = []
        self.tags = []
        self.loads = []
        self.ids = []
        self.feed(html)
        self.close()
        assert self.open == [], f"never closed: {self.open}"

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        values = dict(attributes)
        self.loads += [values[name] for name in LOADED if name in values]
        self.ids += [values["id"]] if "id" in values else []
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        self.handle_starttag(tag, attributes)
        if tag not in VOID:
            self.handle_endtag(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if not {"style", "script"} & set(self.open):
            self.text.append(data)

    @property
    def words(self):
        return " ".join(" ".join(self.text).split())


def table(n, seed=0):
    return make_flight({
        "throttle": (0.5, 0, 0), "elevator aileron rudder": (0, 0.05, 0), "p r": (0, 1, 0),
        "v_north v_east": (0, 40, 0), "altitude": (300, 5, 0),
    }, n, 1 / 40, seed=seed)  # fmt: skip


def result(n=800, **changes):
    """Return an evaluation of a flight whose errors are twice their deviations."""
    rng = default_rng(0)
    flight = table(n)
    mean = 0.1 * np.sin(np.outer(flight["time"], np.arange(1, 7))) + 0.01
    std = np.full((n, 6), 0.01)
    given = {
        "name": "test",
        "measured": mean + 0.02 * rng.normal(size=(n, 6)),
        "mean": mean,
        "std": std,
        "prediction_std": 2 * std,
        "regressors": mean,
        "baseline": mean,
        "truth": mean + 0.01 * rng.normal(size=(n, 6)),
        "table": flight,
        "states": flight,
    }
    return Evaluation(**given | changes)


@pytest.fixture(scope="module")
def effects():
    """Return the effects of a model of three regressors."""
    X = pd.DataFrame(default_rng(0).normal(size=(30, 3)), columns=["alpha", "q_hat", "elevator"])
    Y = np.sin(X @ np.ones((3, 2))).set_axis(["CZ", "Cm"], axis=1)
    model = DependentGPRegressor(structure="joint", n_latent=1, optimizer=None, random_state=0)
    return EffectsDisplay.from_estimator(model.fit(X, Y), X, ax=False)


def said(text):
    """Return a stand-in for a finding."""
    known = {"text": text, "clause": text, "numbers": {"text": text}}
    return SimpleNamespace(code=None, channel=None, **known)


def verdict(error=0.131, coverage=0.972, linear=0.191, **changes):
    """Return a verdict of a mean error and coverage."""
    given = {
        "error": error,
        "coverage": coverage,
        "least_squares_error": linear,
        "unvarying": (),
        "uses": (
            Use("predict coefficients", "yes", (said("errors are small"),)),
            Use("simulate", "partly", (said("for 5 s"),)),
        ),
        "findings": tuple(map(said, ("one!", "two!", "three!", "four!"))),
    }
    return Verdict(**given | changes)


def render(effects=None, **changes):
    """Return the report of a flight, or of other content."""
    given = {
        "title": "Brumby, six flights",
        "verdict": verdict(),
        "mechanics": FlightMechanics(),
        "train": {"train": table(800, 1)},
        "evaluations": [result()],
        "facts": {"Mass": "45 kg", "Samples": "755 of 14,400", "Kernel": ""},
        "aircraft": SimpleNamespace(name="brumby"),
        "pipeline": SimpleNamespace(control_units=None),
        "created": "2026-05-04T12:30:00",
        "changes": None,
        "assumed": [],
        "command": None,
    }
    return render_report(SimpleNamespace(**given | changes), effects)


def words_of(**changes):
    return Page(render(**changes)).words


@pytest.fixture(scope="module")
def html(effects):
    """Return a report with all kinds of figures."""
    return render(effects=effects)


class TestPage:
    def test_is_well_formed(self, html):
        page = Page(html)
        assert page.tags[0] == "html"
        assert html.startswith("<!DOCTYPE html>")
        assert len(page.ids) == len(set(page.ids))

    def test_needs_nothing_else_and_runs_no_script(self, html):
        page = Page(html)
        assert all(load.startswith("data:image/svg+xml;base64,") for load in page.loads)
        assert not {"link", "script", "iframe", "object"} & set(page.tags)
        assert "default-src 'none'; style-src 'unsafe-inline'; img-src data:" in html
        assert "://" not in re.sub(r'src="[^"]*"', "", html)

    def test_pictures_have_no_accents_apart_from_their_letters(self, html):
        pictures = [b64decode(load.partition(",")[2]).decode() for load in Page(html).loads]
        assert pictures
        assert not any(map(unicodedata.combining, "".join(pictures)))

    def test_a_second_time_gives_the_same_bytes_and_leaves_pyplot_alone(self):
        before = plt.get_fignums()
        setting = plt.rcParams["svg.fonttype"]
        content = {"evaluations": [], "train": {"train": table(100)}}
        assert render(**content) == render(**content)
        assert plt.get_fignums() == before
        assert plt.rcParams["svg.fonttype"] == setting


class TestWords:
    def test_the_verdict_stands_first_with_thresholds(self, no_pictures):
        page = render(mechanics=FlightMechanics(notes=(said("none"),)))
        titles = re.findall(r"<h2>(.*?)</h2>", page)
        assert titles[0] == "Verdict"
        assert titles[-2:] == ["What was done", "How to read"]
        words = Page(page).words
        first = words[: words.index("What was done")]
        for piece in (
            "error 0.131", "97.2 %",
            "least squares on the same rows has an error of 0.191", "simulate ◐ partly for 5 s",
            "one!", "two!", "three!", "four!",
        ):  # fmt: skip
            assert piece in first

    def test_many_flights_are_a_table_and_the_three_worst_have_figures(self):
        good = result(100)
        bad = replace(good, mean=good.mean + 10 * default_rng(0).normal(size=(100, 6)))
        flights = {"a": replace(good, mean=good.measured), "b": good, "c": bad, "d": good}
        tested = [replace(flight, name=name) for name, flight in flights.items()]
        html = render(evaluations=tested, train={})
        assert "Coefficients of c" in html
        assert "Coefficients of a" not in html
        assert "Means of the test flights." in html

    def test_derivatives_have_standard_deviations(self, no_pictures):
        rows = {
            "Cm": (0.0, 0.1, "Cm", ""),
            "Cm_alpha": (-0.2, 0.05, "Cm", "alpha"),
            "Cm_q": (-1.0, 0.7, "Cm", "q"),
            "Cm_throttle": (0.1, 0.3, "Cm", "throttle"),
            "Cl_aileron": (0.3, 0.1, "Cl", "aileron"),
        }
        columns = ["value", "std", "coefficient", "regressor"]
        values = pd.DataFrame.from_dict(rows, orient="index", columns=columns)
        half = 1.96 * values["std"]
        values = values.assign(lower=values["value"] - half, upper=values["value"] + half)
        words = words_of(mechanics=FlightMechanics(derivatives=values))
        assert "Cm_alpha −0.2 ± 0.05" in words
        assert "Cm_q ▼ −1 ± 0.7" in words
        assert "Cl_aileron 0.3 ± 0.1" in words
        assert "Cm_throttle ▼ 0.1 ± 0.3" in words

    def test_tables_hold_every_score(self, html):
        flight = result()
        _, rows = Page(html).words.split("NRMSE of truth ")
        cells = np.reshape(rows.split()[:36], (6, 6))  # name, two errors, coverage, two errors
        for column, values in {2: flight.measured, 5: flight.truth}.items():
            errors = normalized_rmse(values, flight.mean, multioutput="raw_values")
            assert [*cells[:, column]] == [f"{error:.3g}" for error in errors]

    def test_bands_are_judged_against_measured_values_alone(self, no_pictures):
        """The standard deviations of the function do not know of gusts: none of these bands holds the truth."""
        words = words_of(evaluations=[result(std=np.full((800, 6), 1e-9))])
        assert "▼" not in words.replace("▼ covers", "")
        assert "no band promises" in words

    def test_escapes_what_comes_from_outside(self):
        """Markup, and dollars, which are no templates and no mathematics."""
        evil = '<script>alert("&")</script> $title $$ ${body} $x^{'
        html = render(
            title=evil, train={evil: table(100)}, evaluations=[result(100, name=evil)],
            subtitle=evil, facts={evil: evil}, assumed=[evil], command=evil,
            verdict=verdict(findings=(said(evil),)),
        )  # fmt: skip
        page = Page(html)
        assert "script" not in page.tags
        assert evil in page.words

    @pytest.mark.parametrize(("factor", "mark"), [(0.1, "▼"), (100, "▲")])
    def test_marks_dishonest_bands(self, no_pictures, factor, mark):
        flight = result(truth=None)
        words = words_of(evaluations=[replace(flight, prediction_std=factor * flight.std)])
        assert re.search(rf" {mark} [0-9.]+ CY ", words)


class TestPoorContent:
    def test_without_matplotlib_the_numbers_remain(self, no_pictures):
        page = Page(render())
        assert "img" not in page.tags
        assert 'pip install "skdgp[plot]"' in page.words
        assert page.tags.count("table") == 3  # of uses, errors, and what was done

    def test_an_output_never_observed(self, no_pictures):
        flight = result(400, truth=None)
        flight.measured[:, 3] = np.nan
        with pytest.warns(UndefinedMetricWarning, match="never observed"):
            words = words_of(evaluations=[flight])
        assert "–" in words
