"""Standard output and error of any kind, and Ctrl-C at any moment: outputs are written, nobody sees a traceback."""

import io
import os
import sys
import warnings

import pytest

from skdgp._cli import _use, main

FULL = "/dev/full"
needs_full = pytest.mark.skipif(not os.path.exists(FULL), reason=f"there is no {FULL} here")


@pytest.fixture
def predict(identified, tmp_path):
    """Predict a flight into a folder whose name is not ASCII; return the exit code."""

    def predict():
        return main(
            [
                "predict",
                str(identified[0] / "model.joblib"),
                "test.csv",
                "-o",
                str(tmp_path / "Flüge_α.csv"),
            ]
        )

    return predict


class TestOutput:
    @pytest.mark.parametrize("encoding", ["ascii", "cp1252", "latin-1", "utf-16"])
    def test_of_any_encoding(self, encoding, predict, tmp_path, monkeypatch):
        printed = io.TextIOWrapper(io.BytesIO(), encoding=encoding)
        monkeypatch.setattr(sys, "stdout", printed)
        assert predict() == 0
        text = printed.buffer.getvalue().decode(encoding)
        assert ("Flüge_α" if encoding == "utf-16" else r"ge_\u03b1.csv") in text
        assert (tmp_path / "Flüge_α.csv").exists()

    @needs_full
    def test_that_is_full(self, predict, tmp_path, monkeypatch, capsys):
        with open(FULL, "w") as full:
            monkeypatch.setattr(sys, "stdout", full)
            assert predict() == 1
        assert capsys.readouterr().err == "error: No space left on device\n"
        assert (tmp_path / "Flüge_α.csv").exists()

    def test_that_nobody_reads(self, predict, monkeypatch, capsys):
        ours, theirs = os.pipe()
        os.close(ours)
        with os.fdopen(theirs, "w", encoding="utf-8") as pipe:
            monkeypatch.setattr(sys, "stdout", pipe)
            assert predict() == 0
        assert capsys.readouterr().err == ""

    def test_that_is_closed(self, predict, tmp_path, monkeypatch):
        monkeypatch.setattr(sys, "stdout", None)
        monkeypatch.setattr(sys, "stderr", None)
        assert predict() == 0
        assert (tmp_path / "Flüge_α.csv").exists()
        sys.stdout.close()
        sys.stderr.close()


@needs_full
class TestErrors:
    def test_a_warning_that_nobody_sees_ends_nothing(self, predict, monkeypatch):
        monkeypatch.setattr(_use, "_predictions", warned(_use._predictions))
        with open(FULL, "w") as full:
            monkeypatch.setattr(sys, "stderr", full)
            assert predict() == 0


def warned(function):
    def run(*arguments, **options):
        warnings.warn("look", UserWarning, stacklevel=2)
        return function(*arguments, **options)

    return run
