"""A file is written whole or not at all, and read or refused: files of models and of aircraft."""

import errno
import re

import pytest
from sklearn.linear_model import LinearRegression

from skdgp.dynamics import Aircraft
from skdgp.identification import load_model, save_model

AIRCRAFT = Aircraft.estimate(3.0, 1.8)
FITTED = LinearRegression().fit([[0.0], [1.0]], [0.0, 1.0])


def save(path, note=None):
    return save_model(path, FITTED, AIRCRAFT, note=note)


def names(folder):
    return sorted(file.name for file in folder.iterdir())


class Failing:
    """A note that cannot be written: pickle calls a function instead."""

    def __init__(self, fail):
        self.fail = fail

    def __reduce__(self):
        self.fail()
        return str, ()


def failing(error):
    def fail():
        raise error

    return Failing(fail)


@pytest.fixture
def target(tmp_path):
    """Return the path of a model, in a folder that holds nothing else."""
    return tmp_path / "model.joblib"


class TestWriting:
    def test_replaces(self, target):
        for note in ("one", "two"):
            assert save(str(target), note) == target
            assert load_model(target).note == note
        assert names(target.parent) == ["model.joblib"]

    @pytest.mark.parametrize("failure", [ValueError, KeyboardInterrupt])
    def test_a_failure_leaves_the_old_file_and_no_rubbish(self, target, failure):
        save(target, "old")
        with pytest.raises(failure, match="stopped"):
            save(target, failing(failure("stopped")))
        assert load_model(target).note == "old"
        assert names(target.parent) == ["model.joblib"]

    def test_says_what_is_wrong_with_the_place(self, tmp_path):
        assert save(tmp_path / "absent" / "model.joblib").exists()
        with pytest.raises(IsADirectoryError, match="name a file inside it"):
            save(tmp_path)

    @pytest.mark.parametrize(
        "error",
        [
            OSError(errno.ENOSPC, "No space left on device"),
            OSError("4096 requested and 512 written"),  # of numpy.ndarray.tofile
            PermissionError(errno.EACCES, "Permission denied", None),
        ],
    )
    def test_errors_name_the_file_that_was_asked_for(self, target, error):
        with pytest.raises(type(error)) as caught:
            save(target, failing(error))
        assert caught.value.filename == str(target)
        assert caught.value.errno == error.errno
        assert caught.value.strerror == (error.strerror or str(error))
        assert names(target.parent) == []


class TestReading:
    """JSON and TOML that people write, and what is not: one line that names the file."""

    @pytest.mark.parametrize(
        ("suffix", "content", "message"),
        [
            ("json", b"[" * 100_000, "not a JSON file: it is nested too deeply"),
            ("toml", b"a = " + b"[" * 100_000, "not a TOML file: it is nested too deeply"),
            ("json", b'{"a": {"mass": 1, "mass": 2}}', "the key 'mass' stands twice"),
            ("toml", b"mass = 1\nmass = 2", "not a TOML file: Cannot overwrite"),
            ("json", b"1" * 5000, "not a JSON file: Exceeds the limit"),
            ("json", b"", "not a JSON file: Expecting value"),
            ("json", b"\xff\xfe{\x00}\x00", "not a JSON file: 'utf-8' codec can't decode"),
            (
                "toml",
                "name = 'Jäger'".encode("latin-1"),
                "not a TOML file: 'utf-8' codec can't decode",
            ),
        ],
    )
    def test_refused(self, suffix, content, message, tmp_path):
        path = tmp_path / f"uav.{suffix}"
        path.write_bytes(content)
        with pytest.raises(ValueError, match=f"^{re.escape(str(path))}.*{message}.*$"):
            Aircraft.from_file(path)

    @pytest.mark.parametrize("suffix", ["json", "toml"])
    def test_no_file(self, suffix, tmp_path):
        (tmp_path / f"folder.{suffix}").mkdir()
        with pytest.raises(IsADirectoryError):
            Aircraft.from_file(tmp_path / f"folder.{suffix}")
        with pytest.raises(FileNotFoundError):
            Aircraft.from_file(tmp_path / f"absent.{suffix}")
