"""A file is written whole or not at all."""

import os
import stat

import pytest

from skdgp._files import write_atomically


def names(folder):
    return sorted(file.name for file in folder.iterdir())


def test_writes_and_replaces(tmp_path):
    target = tmp_path / "model.joblib"
    assert write_atomically(target, lambda path: path.write_bytes(b"one")) == target
    write_atomically(str(target), lambda path: path.write_bytes(b"two"))
    assert target.read_bytes() == b"two"
    assert names(tmp_path) == ["model.joblib"]


def test_writer_gets_a_path_beside_the_target_with_its_suffix(tmp_path):
    seen = []
    write_atomically(tmp_path / "a.json", lambda path: (seen.append(path), path.write_text("{}")))
    assert seen[0].parent == tmp_path.resolve()
    assert seen[0].suffix == ".json"
    assert seen[0].name != "a.json"


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


def test_failure_before_anything_was_written(tmp_path):
    with pytest.raises(FileNotFoundError):
        write_atomically(tmp_path / "a.txt", lambda path: None)
    assert names(tmp_path) == []


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
