"""Warnings are recorded and silenced for one caller alone: no filter of the process changes."""

import sys
import threading
import warnings

import pytest

from skdgp import DependentGPRegressor
from skdgp._compute.findings import Code, Finding
from skdgp._compute.messages import (
    FindingWarning,
    recorded_warnings,
    report,
    warn,
    without_warnings,
)
from skdgp._compute.wording import REASONS, TEXTS, texts_of
from skdgp.identification import identify

KMEANS = "skdgp._compute.linalg"  # KMeans of scikit-learn has no other way to be silent


class Late(UserWarning):
    """A category of its own."""


def test_recorded_warnings_are_shown_and_kept_once():
    with recorded_warnings() as outer, recorded_warnings() as inner:
        for _ in range(2):
            with pytest.warns(Late, match="^a  gap$"):
                warn("a  gap", Late)
    assert texts_of(inner.findings) == texts_of(outer.findings) == ("a gap",)


def test_ignored_warnings_are_neither_shown_nor_recorded():
    with recorded_warnings() as outer, without_warnings(Late):
        warn("late", Late)
        with pytest.warns(UserWarning, match="other"):
            warn("other")
    assert texts_of(outer.findings) == ("other",)
    with recorded_warnings() as record:
        record.ignore(Code.FULL_THROWS)
        report(Finding(Code.FULL_THROWS))
        with pytest.warns(FindingWarning, match="Give the column elevator") as shown:
            report(Finding(Code.NO_ELEVATOR))
    assert record.findings == [shown[0].message.finding] == [Finding(Code.NO_ELEVATOR)]


@pytest.mark.parametrize("code", Code)
def test_every_finding_has_a_text(code):
    assert code in {**TEXTS, **REASONS}


def test_another_thread_is_not_silenced():
    raised = []

    def warning():
        try:
            warn("from another thread", Late)  # an error, as every warning of the test run
        except Late as error:
            raised.append(str(error))

    with without_warnings(), recorded_warnings() as record:
        thread = threading.Thread(target=warning)
        thread.start()
        thread.join()
    assert raised == ["from another thread"]
    assert record.findings == []


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_an_identification_changes_no_filter(monkeypatch, first_minute):
    callers = set()

    def watched(name):
        original = getattr(warnings, name)

        def call(*args, **options):
            callers.add(sys._getframe(1).f_globals["__name__"])
            return original(*args, **options)

        return call

    for name in ("catch_warnings", "simplefilter", "filterwarnings", "resetwarnings"):
        monkeypatch.setattr(warnings, name, watched(name))
    show = warnings.showwarning
    example = first_minute()
    result = identify(
        example.train[example.train["time"] < 20],
        example.aircraft,
        test=example.test[example.test["time"] < 10],
        samples=40,
        regressor=DependentGPRegressor(structure="trend", max_iter=5, random_state=0),
        horizons=[2.0],
    )
    assert result.verdict.uses
    assert callers  # scikit-learn's own
    assert not {name for name in callers if name.startswith("skdgp")} - {KMEANS}
    assert warnings.showwarning is show
