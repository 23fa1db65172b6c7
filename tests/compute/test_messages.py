"""Warnings are recorded and silenced for one caller alone; a listener hears of a fit until its block ends."""

import threading
from dataclasses import replace

import numpy as np
import pytest
from made_flights import GLIDER
from numpy.random import default_rng
from sklearn.model_selection import cross_val_score

from skdgp import DependentGPRegressor, listening
from skdgp._compute.findings import clauses_of, texts_of
from skdgp._compute.messages import (
    FindingWarning,
    recorded_findings,
    report,
    warn,
)
from skdgp._flight.findings import Code, Finding


class Late(UserWarning):
    """A category of its own."""


def test_recorded_warnings_are_shown_and_kept_once():
    with recorded_findings() as findings:
        for _ in range(2):
            with pytest.warns(Late, match="^a  gap$"):
                warn("a  gap", Late)
        with pytest.warns(FindingWarning, match="Give the column elevator"):
            report(Finding(Code.NO_ELEVATOR))
    assert texts_of(findings[:1]) == ("a gap.",)
    assert findings[1:] == [Finding(Code.NO_ELEVATOR)]


def test_parts_of_a_text_whose_values_are_unknown_are_left_out():
    numbers = {
        "channels": ["q", "r"], "y": "y", "x": "x", "std": 0.1, "t": 6.0, "causes": [], "correlation": 0.9,
        "effective_samples": 20.0,
    }  # fmt: skip
    of_slope = numbers | {"slope": 0.0, "expected": "1"}
    slope = "the slope of y over x is 0 ± 0.1, but expected 1"
    lag = "y is 0.3 ± 0.1 s late against x"
    end = " (t = 6.0, correlation 0.90, 20 effective samples)"
    begin = "q or r is probably wrong: "
    assert Finding(Code.CONTRADICTION, **of_slope).clause == begin + slope + end
    of_lag = numbers | {"lag": 0.3, "causes": ["a magnetic heading"]}
    text = Finding(Code.CONTRADICTION, "a", **of_lag).text
    assert text == f"flight a: {begin}{lag}: a magnetic heading?{end}."


def test_findings_of_one_kind_are_one_clause_with_the_channels_of_the_others():
    found = [
        Finding(Code.NEVER_MEASURED, channel=name, start=0.0, end=1.0, samples=2)
        for name in ("q", "beta")
    ]
    told = "q has no value (0.00 to 1.00 s, 2 samples) (1 more of this kind: beta)"
    assert clauses_of(found) == told


def test_the_advice_of_a_cause_follows_the_statement():
    cause = Finding(Code.AIR_NOT_CONVERGED, contradictions=[], agrees=True)
    finding = Finding(Code.GUSTS_UNKNOWN, cause=cause, angles_lack_gusts=True)
    begin, end = "Gusts without vanes are not known: ", " alpha and beta lack them."
    assert Code.AIR_NOT_CONVERGED.statement in finding.clause
    advice = " The channels agree by physics. Give "
    assert finding.text.index(begin) < finding.text.index(advice) < finding.text.index(end)


FEW = default_rng(0).normal(size=(12, 4))
MODEL = DependentGPRegressor(random_state=0)
USES = {
    "fit": (lambda: MODEL.fit(FEW, FEW[:, 0]), "Got 12 rows"),
    "search": (lambda: cross_val_score(MODEL, FEW, FEW[:, 0], cv=2), "Got 6 rows"),
    "copy": (lambda: replace(GLIDER, inertia=np.diag([0.2, 0.2, 1.0])), "inertia"),
}


@pytest.mark.parametrize("use", USES)
def test_a_warning_shows_the_line_of_the_user(use):
    call, words = USES[use]
    with pytest.warns(UserWarning, match=words) as shown:
        call()
    assert {warning.filename for warning in shown} == {__file__}


def test_another_thread_is_not_recorded():
    raised = []

    def warning():
        try:
            warn("from another thread", Late)  # an error, as every warning of the test run
        except Late as error:
            raised.append(str(error))

    with recorded_findings() as findings:
        thread = threading.Thread(target=warning)
        thread.start()
        thread.join()
    assert raised == ["from another thread"]
    assert findings == []


def fit():
    x = np.linspace(0.0, 6.0, 12)[:, None]
    DependentGPRegressor(n_latent=1, max_iter=1, random_state=0).fit(x, np.sin(x[:, 0]))


class TestListening:
    """What a listener raises, and when it is called, in a fit."""

    @pytest.mark.parametrize("error", [None, ArithmeticError])
    def test_ends_with_the_block(self, error):
        calls = []
        try:
            with listening(lambda *news: calls.append(news)):
                fit()
                if error is not None:
                    raise error
        except ArithmeticError:
            pass
        n_calls = len(calls)
        assert n_calls > 0
        fit()
        assert len(calls) == n_calls
