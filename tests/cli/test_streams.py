"""Standard output and error of any kind: outputs are written, nobody sees a traceback."""

import io
import os
import re
import sys
import threading
from contextlib import redirect_stderr, redirect_stdout
from types import SimpleNamespace

import pytest

from skdgp.__main__ import main
from skdgp._cli import Console
from skdgp._compute.messages import Progress

FULL = "/dev/full"
needs_full = pytest.mark.skipif(not os.path.exists(FULL), reason=f"there is no {FULL} here")


@pytest.fixture
def written(tmp_path):
    """Return a file whose name is not ASCII."""
    return tmp_path / "Flüge_α.csv"


@pytest.fixture
def predict(identified, written, command, monkeypatch):
    """Predict a flight into the file; return the exit code. A slow machine would write progress."""
    monkeypatch.setattr("skdgp._cli._shared.LINE_SECONDS", 60.0)
    model = identified.output / "model.joblib"
    return lambda flight="test.csv": command(["predict", model, flight, "-o", written])


@pytest.mark.parametrize("encoding", ["ascii", "utf-16"])
def test_output_of_any_encoding(encoding, predict, written):
    printed = io.TextIOWrapper(io.BytesIO(), encoding=encoding)
    with redirect_stdout(printed):
        assert predict() == 0
    text = printed.buffer.getvalue().decode(encoding)
    assert ("Flüge_α" if encoding == "utf-16" else r"ge_\u03b1.csv") in text
    assert written.exists()


@needs_full
def test_output_that_is_full(predict, written, capsys):
    with open(FULL, "w") as full, redirect_stdout(full):
        assert predict() == 1
    assert capsys.readouterr().err == "error: No space left on device\n"
    assert written.exists()


def test_output_that_nobody_reads(predict, capsys):
    ours, theirs = os.pipe()
    os.close(ours)
    with os.fdopen(theirs, "w", encoding="utf-8") as pipe, redirect_stdout(pipe):
        assert predict() == 0
    assert capsys.readouterr().err == ""


def test_output_that_is_closed(predict, written):
    with redirect_stdout(None), redirect_stderr(None):
        assert predict() == 0
        sys.stdout.close()
        sys.stderr.close()
    assert written.exists()


class Interrupted:
    """A module during whose import Ctrl-C comes."""

    @property
    def main(self):
        raise KeyboardInterrupt


def test_imports_that_are_stopped(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "skdgp._cli", Interrupted())
    assert main([]) == 130
    assert capsys.readouterr().err == "stopped\n"


def test_steps_of_a_stage_have_a_bar_and_the_time_that_is_left(watched):
    stream = watched("3 of 8", False)
    with Console(stream, period=0.01) as console:
        console.progress("transforming", 0, float("nan"))
        for done in range(4):
            console.progress(Progress("estimating the air", done, 8), 0, float("nan"))
        assert stream.was_written.wait(30.0)
    pattern = r"transforming · estimating the air \[####-{6}\] 3 of 8, about \d+ s left · \d+ s"
    assert re.search(pattern, stream.getvalue())


@pytest.mark.parametrize("first", [0, 1])
def test_the_time_that_is_left_is_by_the_rate_of_the_steps_since_the_first_notice(
    first, monkeypatch
):
    seconds = iter(range(100))
    clock = SimpleNamespace(monotonic=lambda: next(seconds))
    stream = io.StringIO()
    with Console(stream, period=1000.0) as console:
        monkeypatch.setattr("skdgp._cli._shared.time", clock)
        left = []
        for done in range(first, first + 3):
            console._count_steps(Progress("estimating the air", done, 100))
            left += re.findall(r", about (\d+) s left", console._steps)
    assert left == [str(99 - first), str(98 - first)]


@pytest.mark.parametrize("is_terminal", [True, False])
def test_a_stage_that_lasts_is_shown_with_its_seconds(is_terminal, watched):
    """The waits end with the event, so their limits, in seconds, only count where the test fails."""
    stream = watched(" · ", is_terminal)
    before = {*threading.enumerate()}
    with Console(stream, period=0.01) as console:
        (thread,) = {*threading.enumerate()} - before
        console.stage("flight 'a'")
        assert stream.was_written.wait(30.0)
    thread.join(30.0)
    assert not thread.is_alive()
    assert re.search(r"flight 'a' · \d+ s", stream.getvalue())
    assert thread.daemon  # a command that fails does not wait for it
