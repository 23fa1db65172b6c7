"""A file is written whole or not at all, and read or refused."""

import errno
import os
import stat
import subprocess
import sys
import time

import numpy as np
import pytest

from skdgp._compute.files import LARGEST, read_json, read_toml, write_atomically


def names(folder):
    return sorted(file.name for file in folder.iterdir())


def test_writes_and_replaces(tmp_path):
    target = tmp_path / "model.joblib"
    assert write_atomically(target, lambda path: path.write_bytes(b"one")) == target
    write_atomically(str(target), lambda path: path.write_bytes(b"two"))
    assert target.read_bytes() == b"two"
    assert names(tmp_path) == ["model.joblib"]


@pytest.mark.parametrize("failure", [ValueError, KeyboardInterrupt])
def test_failure_leaves_the_old_file_and_no_rubbish(tmp_path, failure):
    target = tmp_path / "report.html"
    target.write_text("old")

    def write(path):
        path.write_text("half of the n")
        raise failure("stopped")

    with pytest.raises(failure, match="stopped"):
        write_atomically(target, write)
    assert target.read_text() == "old"
    assert names(tmp_path) == ["report.html"]


@pytest.mark.skipif(os.name == "nt", reason="processes are killed otherwise there")
def test_a_killed_process_leaves_the_old_file_or_the_new_one(tmp_path):
    """Kill -9, at moments drawn by chance."""
    code = """
from itertools import count
from skdgp._compute.files import write_atomically
for number in count():
    write_atomically("numbers.txt", lambda path: path.write_text(f"{number}\\n" * 200_000))
    print(flush=True)
"""
    for moment in np.random.default_rng(3).uniform(0.0, 0.05, 4):
        with subprocess.Popen(
            [sys.executable, "-c", code], cwd=tmp_path, stdout=subprocess.PIPE
        ) as writer:
            writer.stdout.readline()  # the first file is in its place
            time.sleep(moment)
            writer.kill()
        lines = (tmp_path / "numbers.txt").read_text().splitlines()
        assert len(lines) == 200_000
        assert len(set(lines)) == 1


def test_readable_as_any_file_of_this_user(tmp_path):
    (tmp_path / "plain").write_text("")
    write_atomically(tmp_path / "atomic", lambda path: path.write_text(""))
    modes = [stat.S_IMODE(os.stat(tmp_path / name).st_mode) for name in ("plain", "atomic")]
    assert modes[0] == modes[1]


def test_follows_a_link(tmp_path):
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "real.txt").write_text("old")
    link = tmp_path / "link.txt"
    try:
        link.symlink_to(tmp_path / "folder" / "real.txt")
    except OSError:
        pytest.skip("this file system has no symbolic links")
    write_atomically(link, lambda path: path.write_text("new"))
    assert link.is_symlink()
    assert (tmp_path / "folder" / "real.txt").read_text() == "new"


def test_says_what_is_wrong_with_the_place(tmp_path):
    with pytest.raises(FileNotFoundError, match="does not exist"):
        write_atomically(tmp_path / "absent" / "a.txt", lambda path: path.write_text(""))
    with pytest.raises(IsADirectoryError, match="name a file inside it"):
        write_atomically(tmp_path, lambda path: path.write_text(""))


class TestErrorsOfWriting:
    """They name the file that was asked for, not the temporary one, nor none."""

    @pytest.mark.parametrize(
        "error",
        [
            OSError(errno.ENOSPC, "No space left on device"),
            OSError("4096 requested and 512 written"),  # of numpy.ndarray.tofile
            PermissionError(errno.EACCES, "Permission denied", None),
        ],
    )
    def test_without_a_file(self, tmp_path, error):
        def write(path):
            raise error

        with pytest.raises(type(error)) as caught:
            write_atomically(tmp_path / "a.txt", write)
        assert caught.value.filename == str(tmp_path / "a.txt")
        assert caught.value.errno == error.errno
        assert caught.value.strerror == (error.strerror or str(error))

    @pytest.mark.skipif(not os.path.exists("/dev/full"), reason="there is no /dev/full here")
    def test_of_a_full_disk(self, tmp_path):
        def write(path):
            path.symlink_to("/dev/full")
            path.write_text("x" * 10000)

        with pytest.raises(OSError, match="No space left on device") as caught:
            write_atomically(tmp_path / "a.txt", write)
        assert caught.value.filename == str(tmp_path / "a.txt")
        assert names(tmp_path) == []

    def test_of_the_temporary_file(self, tmp_path):
        with pytest.raises(FileNotFoundError) as caught:
            write_atomically(tmp_path / "a.txt", lambda path: path.rename(tmp_path / "elsewhere"))
        assert caught.value.filename == str(tmp_path / "a.txt")

    def test_of_another_file_stay(self, tmp_path):
        with pytest.raises(FileNotFoundError) as caught:
            write_atomically(
                tmp_path / "a.txt", lambda path: path.write_text((tmp_path / "absent").read_text())
            )
        assert caught.value.filename == str(tmp_path / "absent")


class TestReading:
    """JSON and TOML that people write, and what is not: one line that names the file."""

    @pytest.mark.parametrize(
        ("reader", "content", "message"),
        [
            (read_json, b"[" * 100_000, "not a JSON file: it is nested too deeply"),
            (read_json, b'{"a":' * 100_000, "not a JSON file: it is nested too deeply"),
            (read_toml, b"a = " + b"[" * 100_000, "not a TOML file: it is nested too deeply"),
            (read_toml, b"a" + b".a" * 2000 + b" = " + b"[" * 2000, "not a TOML file: "),
            (read_json, b'{"a": {"mass": 1, "mass": 2}}', "the key 'mass' stands twice"),
            (read_toml, b"mass = 1\nmass = 2", "not a TOML file: Cannot overwrite"),
            (read_json, b"1" * 5000, "not a JSON file: Exceeds the limit"),
            (read_toml, b"a = " + b"1" * 5000, "not a TOML file: Exceeds the limit"),
            (read_json, b"", "not a JSON file: Expecting value"),
            (read_json, b"\x00" * 100, "not a JSON file: Expecting value"),
            (read_json, b"\xff\xfe{\x00}\x00", "not a text in UTF-8"),
            (read_toml, "name = 'Jäger'".encode("latin-1"), "not a text in UTF-8"),
            (read_json, b" " * (LARGEST + 1), "17 MB, but expected a file of at most 16 MB"),
        ],
    )
    def test_refused(self, reader, content, message, tmp_path):
        (tmp_path / "uav.json").write_bytes(content)
        with pytest.raises(ValueError, match=message) as caught:
            reader(tmp_path / "uav.json")
        assert str(tmp_path / "uav.json") in str(caught.value)
        assert "\n" not in str(caught.value)

    @pytest.mark.parametrize("reader", [read_json, read_toml])
    def test_no_file(self, reader, tmp_path):
        with pytest.raises(ValueError, match="which is a folder or a device, but expected a file"):
            reader(tmp_path)
        with pytest.raises(FileNotFoundError):
            reader(tmp_path / "absent")

    @pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no pipes with names here")
    def test_a_pipe_is_not_waited_for(self, tmp_path):
        os.mkfifo(tmp_path / "pipe.json")
        began = time.monotonic()
        with pytest.raises(ValueError, match="a folder or a device"):
            read_json(tmp_path / "pipe.json")
        assert time.monotonic() - began < 5

    def test_with_the_mark_of_windows_editors(self, tmp_path):
        (tmp_path / "a").write_bytes(b"\xef\xbb\xbf" + b'{"a": 1}')
        assert read_json(tmp_path / "a") == {"a": 1}
        (tmp_path / "a").write_bytes(b"\xef\xbb\xbf" + b"a = 1")
        assert read_toml(tmp_path / "a") == {"a": 1}
