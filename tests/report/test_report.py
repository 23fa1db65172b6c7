"""The report: whole, self-contained, readable, true to the numbers it is given."""

import base64
import hashlib
import re
from dataclasses import replace
from datetime import datetime
from html.parser import HTMLParser

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest
from sklearn.exceptions import UndefinedMetricWarning

from skdgp._display import page as page_module
from skdgp._effects import Curve
from skdgp._flight.channels import COEFFICIENTS
from skdgp.metrics import interval_coverage, median_relative_error, normalized_rmse
from skdgp.plotting import EffectsDisplay, EnvelopeDisplay
from skdgp.report import (
    FlightMechanics,
    FlightResult,
    ModelSummary,
    ReportContent,
    Use,
    Verdict,
    render_report,
    write_report,
)
from skdgp.report._figures import thinning
from skdgp.report._page import flights, flown_tables
from skdgp.report._tables import SCORES, Score

VOID = {"meta", "br", "hr", "img", "input", "link"}


class Page(HTMLParser):
    """Check that elements close in order, and collect what a reader sees and what a browser would load."""

    def __init__(self, html):
        super().__init__(convert_charrefs=True)
        self.open, self.text, self.tags, self.loads, self.ids = [], [], [], [], []
        self.feed(html)
        self.close()
        assert self.open == [], f"never closed: {self.open}"

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        self.loads += [
            value for name, value in attributes if name in ("src", "href", "data", "action")
        ]
        self.ids += [value for name, value in attributes if name == "id"]
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
    rng = np.random.default_rng(seed)
    t = np.arange(n) / 40.0
    columns = {
        "time": t,
        "throttle": 0.5 + 0 * t,
        "elevator": 0.05 * np.sin(t),
        "aileron": 0.01 * rng.normal(size=n),
        "rudder": 0.1 * np.cos(t),
        "v_north": 40 * np.cos(t / 9),
        "v_east": 40 * np.sin(t / 9),
        "altitude": 300 + t,
        "p": np.sin(t),
        "r": np.cos(t),
    }
    return pd.DataFrame(columns)


def replay(flight):
    tables = []
    for horizon in (2.0, 10.0):
        window = (flight["time"] // horizon).astype(int)
        columns = {name: 1.01 * flight[name] for name in ("v_east", "p", "r")}
        bands = {f"{name}_std": 0.1 for name in columns}
        elapsed = flight["time"] - horizon * window
        tables.append(
            flight[["time"]].assign(
                horizon=horizon, window=window, elapsed=elapsed, **columns, **bands
            )
        )
    return pd.concat(tables)


def result(n=2400, name="test", truth=True, seed=0, **changes):
    rng = np.random.default_rng(seed)
    flight = table(n, seed)
    mean = 0.1 * np.sin(flight["time"].to_numpy()[:, None] * np.arange(1, 7)) + 0.01
    std = np.full((n, 6), 0.01)
    given = {
        "name": name,
        "time": flight["time"].to_numpy(),
        "measured": mean + 0.02 * rng.normal(size=(n, 6)),
        "mean": mean,
        "std": std,
        "measured_std": 2 * std,
        "truth": mean + 0.01 * rng.normal(size=(n, 6)) if truth else None,
        "table": flight,
        "replay": replay(flight),
        "replay_errors": pd.DataFrame(
            {
                "state": ["v_east", "p"],
                "horizon": 2.0,
                "median": [0.47, 0.0155],
                "at_end": [1.0, 0.02],
                "coverage": 0.9,
            }
        ),
    }
    return FlightResult(**{**given, **changes})


def envelope():
    """Return the envelope of a model that knows the middle, with a path that leaves it."""
    axis = np.linspace(-0.3, 0.3, 5)
    flown = pd.DataFrame(
        0.05 * np.random.default_rng(0).normal(size=(200, 2)), columns=["alpha", "beta"]
    )
    return EnvelopeDisplay(
        flown=flown,
        pairs=[("alpha", "beta")],
        points=[(axis, axis)],
        variance=np.hypot(*np.meshgrid(axis, axis))[None, :, :, None].repeat(6, axis=3),
        flown_variance=np.ones(6),
        output_names=COEFFICIENTS,
        path=2 * flown,
    )


def effects():
    """Return the effects of two regressors, and a joint term."""
    at = np.linspace(-0.1, 0.1, 5)
    curve = Curve(at, np.outer(at, np.arange(6)), np.full((5, 6), 0.01))
    names = ["alpha", "beta"]
    return EffectsDisplay(
        curves=dict.fromkeys(names, curve),
        importance=pd.DataFrame(0.1, index=[*names, "joint"], columns=COEFFICIENTS),
        samples=pd.DataFrame(np.column_stack([at, at]), columns=names),
    )


def verdict(**changes):
    given = {
        "learned": "Six coefficients, learned from 6.0 minutes of 2 flights.",
        "error": 0.131,
        "coverage": 0.972,
        "least_squares_error": 0.191,
        "better": ("CX", "CY"),
        "worse": ("Cn",),
        "uses": (
            Use("predict coefficients", "yes", "errors are small"),
            Use("simulate", "partly", "for 5 s"),
        ),
        "warnings": ("one!", "two!", "three!", "four!"),
        "flights": pd.DataFrame(),
    }
    return Verdict(**{**given, **changes})


def content(**changes):
    given = {
        "title": "Brumby, six flights",
        "train": {"train": table(800, 1)},
        "test": [result()],
        "model": ModelSummary(
            n_samples=755,
            n_available=14400,
            regressors=["alpha", "beta"],
            n_latent=2,
            n_private=6,
            log_marginal_likelihood=-1234.5,
            fit_seconds=12.34,
            noise_std=np.arange(1, 7) * 1e-3,
            correlation=np.eye(6),
            versions={"skdgp": "0.1.0"},
        ),
        "aircraft": {"Aircraft": "brumby", "Mass": "45 kg"},
        "envelope": envelope(),
        "effects": effects(),
        "messages": ["The optimiser stopped early."],
        "created": datetime(2026, 5, 4, 12, 30),
    }
    return ReportContent(**{**given, **changes})


@pytest.fixture(scope="module")
def html():
    return render_report(content())


@pytest.fixture
def numbers_only(monkeypatch):
    """Leave the pictures out, as where matplotlib is absent: what is tested is text."""
    monkeypatch.setattr(page_module, "find_spec", lambda name: None)


class TestPage:
    def test_is_well_formed(self, html):
        page = Page(html)
        assert page.tags[0] == "html"
        assert html.startswith("<!DOCTYPE html>")
        assert len(page.ids) == len(set(page.ids))

    def test_needs_nothing_else(self, html):
        page = Page(html)
        assert all(load.startswith("#") for load in page.loads)
        assert {load[1:] for load in page.loads} <= set(page.ids)
        assert set(re.findall(r"url\(#([^)]+)\)", html)) <= set(page.ids)
        assert not {"link", "img", "iframe", "object"} & set(page.tags)
        assert "://" not in html
        assert "@import" not in html
        assert "font-face" not in html

    def test_every_colour_variable_is_defined_for_light_and_dark(self, html):
        light, dark = (
            set(re.findall(r"--([a-z]+):", rules))
            for rules in re.findall(r":root \{(.*?)\}", html, re.S)
        )
        used = set(re.findall(r"var\(--([a-z]+)\)", html)) - {"rows", "press"}
        used |= set(re.findall(r'"color": "([a-z]+)"', html))
        assert used <= light
        assert light == dark

    def test_a_second_time_gives_the_same_bytes_and_leaves_pyplot_alone(self, html):
        before, setting = plt.get_fignums(), plt.rcParams["svg.fonttype"]
        assert render_report(content()) == html
        assert plt.get_fignums() == before
        assert plt.rcParams["svg.fonttype"] == setting

    def test_long_flights_stay_under_five_megabytes(self, html):
        flight = result(28_800)
        for n_flights in (1, 3):
            many = content(test=n_flights * [flight])
            sections = flights(many, thinning(many), draw=True)
            assert len(html.encode()) + sum(len(section.encode()) for section in sections) < 5e6

    def test_allows_its_own_script_and_nothing_else(self, html):
        policy = re.search(r'Content-Security-Policy" content="([^"]*)"', html)[1]
        script = re.search(r"<script>(.*?)</script>", html, re.DOTALL)[1]
        digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
        assert policy.startswith("default-src 'none'")
        assert policy.endswith(f"script-src 'sha256-{digest}'")


class TestWords:
    def test_says_what_was_done(self, html):
        words = Page(html).words
        for piece in (
            "Brumby, six flights",
            "04 May 2026, 12:30",
            "755 of 14 400",
            "alpha, beta",
            "2 shared, 6 private",
            "−1 234.5",
            "12.3 s",
            "skdgp 0.1.0",
            "45 kg",
            "The optimiser stopped early.",
        ):
            assert piece in words

    def test_the_verdict_stands_first_with_its_thresholds(self, numbers_only):
        words = Page(render_report(content(verdict=verdict(), mechanics=FlightMechanics()))).words
        first = words[words.index("Verdict") : words.index("What was done")]
        for piece in (
            "from 6.0 minutes of 2 flights",
            "0.131",
            "97.2 %",
            "least squares 0.191",
            "better in CX CY, equal in CZ Cl Cm, worse in Cn",
            "simulate ◐ partly for 5 s",
            "hold at least 90 %",
            "errors of at most 0.5 of the spread",
        ):
            assert piece in first
        # Three warnings come first, in their order; the fourth stands below.
        assert (
            first.index("one!")
            < first.index("two!")
            < first.index("three!")
            < first.index("Further warnings")
        )
        assert first.index("Further warnings") < first.index("four!")

    def test_many_flights_are_a_table_and_only_the_worst_is_open(self, numbers_only):
        few = content(test=[result(100, name="a"), result(100, name="b")])
        assert "<details" not in render_report(few)
        noise = np.random.default_rng(0).normal(size=(100, 6))
        bad = result(100, name="c", mean=result(100).mean + 10 * noise)
        many = content(test=[*few.test, bad, result(100, name="d"), result(100, name="e")])
        html = render_report(many)
        assert html.count("<details open") == 1
        assert "Test flight c" in html[html.index("<details open") :][:100]
        error = normalized_rmse(bad.measured, bad.mean, multioutput="raw_values").mean()
        table_ = re.search(r"<table[^>]*><caption>Test flights.*?</table>", html, re.DOTALL)[0]
        assert len(re.findall('<th scope="row">', table_)) == 5
        assert f"<td>{error:.3f}</td>" in table_

    def test_derivatives_whose_sign_is_open_are_marked(self, numbers_only):
        table_ = pd.DataFrame(
            {
                "value": [0.0, -0.2, -1.0, 0.3],
                "std": [0.1, 0.05, 0.7, 0.1],
                "coefficient": ["Cm", "Cm", "Cm", "Cl"],
            },
            index=["Cm", "Cm_alpha", "Cm_q", "Cl_aileron"],
        ).assign(regressor=["", "alpha", "q", "aileron"])
        table_ = table_.assign(
            lower=table_["value"] - 1.96 * table_["std"],
            upper=table_["value"] + 1.96 * table_["std"],
        )
        linear = pd.DataFrame({"value": [0.0, -0.25, -1.5, 0.25], "std": 0.01}, index=table_.index)
        found = FlightMechanics(derivatives=table_, least_squares=linear)
        words = Page(render_report(content(verdict=verdict(), mechanics=found))).words
        assert "C m α −0.200 ± 0.098 −0.250 ± 0.020" in words
        assert "C m q ▼ −1.0 ± 1.4 −1.500 ± 0.020" in words
        assert "C l aileron 0.30 ± 0.20" in words

    def test_modes_and_how_long_a_simulation_follows(self, numbers_only):
        columns = ["frequency", "frequency_std", "damping", "damping_std", "time_constant"]
        rows = [[7.0, 0.1, 0.5, 0.02, 0.25], [0.01, 0.01, 1.0, 0.5, 90.0]]
        modes = pd.DataFrame(rows, index=["short period", "spiral"], columns=columns).assign(
            time_constant_lower=[0.2, 50.0], time_constant_upper=[0.3, np.inf], eigenvalue=1j
        )
        simulation = pd.DataFrame(
            {"spread": 0.1, "limit": 0.05, "error": 0.08, "lasts": [3.2, 9.8], "horizon": 9.8},
            index=["theta", "p"],
        )
        found = FlightMechanics(modes=modes, simulation=simulation)
        words = Page(render_report(content(verdict=verdict(), mechanics=found))).words
        assert "short period 7.00 ± 0.20 0.500 ± 0.039 0.25" in words
        assert "spiral 0.010 ± 0.020 – ▼ 90" in words  # it may diverge
        assert "theta deg 5.73 2.86 4.58 3.2" in words
        assert "p deg/s 5.73 2.86 4.58 all 9.8" in words

    def test_tables_hold_every_score(self, html):
        flight = result()
        words = Page(html).words
        for values in (flight.measured, flight.truth):
            for error in median_relative_error(values, flight.mean, multioutput="raw_values"):
                assert f"{100 * error:.1f}" in words
            for error in normalized_rmse(values, flight.mean, multioutput="raw_values"):
                assert f"{error:.3f}" in words
        for share in interval_coverage(
            flight.measured, flight.mean, flight.measured_std, multioutput="raw_values"
        ):
            assert f"{100 * share:.1f}" in words

    def test_bands_are_judged_against_measured_values_alone(self, numbers_only):
        # The standard deviations of the function do not know of gusts: none of these bands holds
        # the truth.
        flight = result(std=np.full((2400, 6), 1e-9), measured_std=np.full((2400, 6), 0.02))
        words = Page(render_report(content(test=[flight]))).words
        assert "▼" not in words.replace("▼ covers", "").replace("▼ where", "")
        assert "no band promises" in words
        assert (
            "no band promises" not in Page(render_report(content(test=[result(truth=False)]))).words
        )

    @pytest.mark.parametrize(
        ("n_iter", "converged", "shown"),
        [
            (60, True, "60 (limit reached)"),
            (60, False, "60 (not converged: raise max_iter)"),
            (59, True, "59 Time"),
        ],
    )
    def test_says_when_the_limit_of_iterations_was_reached(
        self, n_iter, converged, shown, numbers_only
    ):
        model = ModelSummary(n_iter=n_iter, max_iter=60, converged=converged, fit_seconds=1.0)
        words = Page(render_report(content(model=model))).words
        assert f"Iterations {shown}" in words

    def test_shows_where_the_model_knows(self, html):
        assert "beta against alpha: where samples were flown" in html
        words = Page(html).words
        assert "test flights" in words[words.index("Where the model knows") :]
        without = content(envelope=None, test=(), train={})
        assert "Where the model knows" not in Page(render_report(without)).words

    def test_effects(self, html):
        words = Page(html).words
        section = words[words.index("Effects") :]
        assert section.count("by α") == 6
        assert "What no single regressor explains" in section
        straight = replace(effects(), importance=effects().importance.loc[["alpha", "beta"]])
        words = Page(render_report(ReportContent(title="lines", effects=straight))).words
        assert words.count("by β") == 6
        assert "no single regressor" not in words
        assert "by β" not in Page(render_report(ReportContent(title="none"))).words

    def test_one_line_is_one_more_column(self, numbers_only, monkeypatch):
        score = Score(
            lambda y_true, y_pred, multioutput: np.full(6, 0.777), "mean error", "{:.4f}".format
        )
        monkeypatch.setitem(SCORES, "mean_error", score)
        words = Page(render_report(content())).words
        assert (
            words.count("mean error") == 3
        )  # of flights, against measured values and against truth
        assert words.count("0.7770") == 1 + 2 * (6 + 2)  # coefficients and means of their groups

    def test_marks_dishonest_bands(self, numbers_only):
        flight = result()
        too_sure = Page(render_report(content(test=[result(measured_std=0.1 * flight.std)])))
        too_wide = Page(
            render_report(content(test=[result(measured_std=100 * flight.std, truth=False)]))
        )
        assert "▼" in too_sure.words
        assert "▲ 100.0" in too_wide.words

    def test_escapes_what_comes_from_outside(self):
        evil = '<script>alert("&")</script>'
        page = render_report(
            content(
                title=evil,
                train={evil: table(100)},
                test=[result(100, name=evil)],
                aircraft={evil: evil, "Aircraft": evil},
                messages=[evil],
                command=evil,
                model=ModelSummary(
                    regressors=[evil], versions={evil: evil}, extra={evil: evil}, kernel=evil
                ),
            )
        )
        assert "<script>alert" not in page
        assert evil in Page(page).words
        # The samples of the charts, and the page's own.
        assert Page(page).tags.count("script") == page.count('<script type="application/json">') + 1

    def test_dollars_are_no_templates_and_no_mathematics(self):
        page = render_report(
            content(title="$title $$ ${body} $x^", test=[result(100, name="$x^{", replay=None)])
        )
        assert "$title $$ ${body} $x^" in Page(page).words

    def test_says_when_nothing_went_wrong_and_when_nothing_was_tested(self):
        page = Page(render_report(content(messages=(), test=())))
        assert "No warning arose" in page.words
        assert "No test flight was given" in page.words


class TestPoorContent:
    def test_the_least(self):
        assert "Title" in Page(render_report(ReportContent(title="Title"))).words

    def test_one_sample(self):
        one = {"metrics": {}, "truth": None}
        Page(render_report(content(test=[result(1, **one)], train={"a": table(1)})))

    def test_an_output_never_observed(self):
        flight = result()
        measured = flight.measured.copy()
        measured[:, 3] = np.nan
        with pytest.warns(UndefinedMetricWarning, match="never observed"):
            html = render_report(
                content(test=[result(measured=measured, truth=None, replay=None)], envelope=None)
            )
        assert "–" in Page(html).words

    def test_no_table_no_replay(self):
        bare = result(table=None, replay=None, replay_errors=None, measured_std=None, truth=None)
        words = Page(render_report(content(test=[bare], train={}))).words
        assert "Replayed" not in words
        assert "What was flown" not in words

    def test_a_flight_without_velocities_has_no_path(self):
        flight = table(200).drop(columns=["v_north", "v_east"])
        page = render_report(content(train={"a": flight}, test=()))
        assert "Path over the ground" not in page
        assert "Inputs of a" in page

    def test_two_flights_of_one_name_are_both_shown(self):
        twins = [result(100), result(100, seed=1)]
        assert list(flown_tables(content(test=twins))) == [
            "train (train)",
            "test (test)",
            "test (test) no. 2",
        ]

    def test_without_matplotlib_the_numbers_remain(self, numbers_only):
        page = Page(render_report(content()))
        assert "svg" not in page.tags
        assert 'pip install "skdgp[plot]"' in page.words
        assert (
            page.tags.count("table") == 4
        )  # of flights, errors against measured values and truth, replays

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            (
                {"mean": np.zeros((3, 6))},
                r"Got mean of shape \(3, 6\) for flight 'test', but expected \(2400, 6\)",
            ),
            ({"std": np.zeros(2400)}, "Got std of shape"),
            ({"table": None}, "without its table"),
            ({"time": np.full(2400, np.inf)}, "not finite"),
        ],
    )
    def test_says_what_does_not_fit(self, change, message):
        with pytest.raises(ValueError, match=message):
            result(**change)


class TestFile:
    def test_is_written(self, tmp_path, numbers_only):
        path = write_report(tmp_path / "report.html", content())
        assert path.read_text(encoding="utf-8") == render_report(content())
        assert [file.name for file in tmp_path.iterdir()] == ["report.html"]
