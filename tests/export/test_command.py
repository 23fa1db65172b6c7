"""The command ``export``: a model that leaves Python."""

import json
import re

import numpy as np
import pytest

from skdgp.identification import save_model


@pytest.fixture
def path(fitted, tmp_path):
    """Return a model file."""
    return save_model(tmp_path / "model.joblib", **fitted("sparse-joint"), flights=["monday"])


@pytest.fixture
def run(command, tmp_path, capsys):
    """Run a command; return the numbers that it printed, and its folder."""

    def run(model, *words):
        folder = tmp_path / "out"
        assert command(["export", model, *words, "-o", folder, "--json"]) == 0
        return json.loads(capsys.readouterr().out, parse_constant=pytest.fail), folder

    return run


def test_portable(run, path):
    numbers, folder = run(path, "--to", "portable")
    assert numbers["files"] == {"model.npz": (folder / "model.npz").stat().st_size}
    with np.load(folder / "model.npz") as file:
        head = json.loads(file["model.json"])
    assert head["provenance"]["flights"] == ["monday"]
    assert head["provenance"]["versions"]["numpy"] == np.__version__


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--to", "c", "--aircraft", "no.json"], "no.json"),
        (["--to", "c", "--full", "elevator=0.4"], "for the format c, but only jsbsim has commands"),
    ],
)
def test_what_cannot_be_exported(command, path, words, message, tmp_path, the_error):
    assert command(["export", path, *words, "-o", tmp_path / "new" / "out"]) == 1
    assert re.search(f"error: .*{message}", the_error())
    assert not (tmp_path / "new").exists()


def test_code_of_the_page_runs(fitted, blocks_of, tmp_path, monkeypatch):
    """The Python of the section of export.md, in one namespace."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "results").mkdir()
    save_model("results/model.joblib", **fitted("sparse"))
    exec("\n".join(blocks_of("export.md", heading="The portable model")), {})
    assert (tmp_path / "model.npz").stat().st_size > 0
