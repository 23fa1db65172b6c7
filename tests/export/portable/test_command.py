"""The command ``export``: a model that leaves Python."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from skdgp._cli import main
from skdgp._flight.channels import COEFFICIENTS
from skdgp.export import FORMATS, load_portable, portable_model
from skdgp.identification import load_model, save_model


@pytest.fixture
def path(fitted_of, tmp_path):
    """Return a model file."""
    return str(save_model(tmp_path / "model.joblib", **fitted_of("sparse"), flights=["monday"]))


@pytest.fixture
def run(tmp_path, capsys):
    """Run a command; return the numbers that it printed."""

    def run(model, *words, output="out"):
        assert (
            main(["export", str(model), *map(str, words), "-o", str(tmp_path / output), "--json"])
            == 0
        )
        return json.loads(capsys.readouterr().out, parse_constant=pytest.fail)

    return run


def names(folder):
    return {path.name for path in folder.iterdir()}


def test_portable(run, path, tmp_path):
    said = run(path, "--to", "portable")
    assert names(tmp_path / "out") == {"model.npz"}
    assert said["files"] == {"model.npz": (tmp_path / "out" / "model.npz").stat().st_size}
    model, whole = load_portable(tmp_path / "out" / "model.npz"), portable_model(**load_model(path))
    assert model.content_hash == whole.content_hash
    assert model.provenance["flights"] == ["monday"]
    assert model.provenance["versions"]["numpy"] == np.__version__


def test_a_smaller_file_says_its_loss(run, path, tmp_path):
    most = 0.9 * run(path, "--to", "portable")["files"]["model.npz"] / 1024
    said = run(path, "--to", "portable", "--max-kb", most, output="small")
    assert said["files"]["model.npz"] <= 1024 * most
    assert set(said["loss"]) == set(COEFFICIENTS)
    assert load_portable(tmp_path / "small" / "model.npz").provenance["reduction"] == said["loss"]


def test_c_of_a_portable_model(run, path, tmp_path):
    run(path, "--to", "portable")
    run(tmp_path / "out" / "model.npz", "--to", "c", "--precision", "float", output="code")
    assert names(tmp_path / "code") == {"aero.h", "aero.c", "test_aero.c", "Makefile"}
    assert "typedef float aero_real" in (tmp_path / "code" / "aero.h").read_text()


@pytest.mark.parametrize(
    ("words", "file"),
    [
        (
            ["jsbsim", "--form", "tables", "--draws", 2],
            "{0}/{0}.xml {0}_001/{0}_001.xml {0}_002/{0}_002.xml",
        ),
        (["build-up"], "build_up.json"),
    ],
)
def test_of_samples(run, fitted_of, words, file, tmp_path, capsys):
    """Formats that are made from the samples say their loss, and refuse a portable model."""
    path = save_model(tmp_path / "model.joblib", **fitted_of("trend"))
    said = run(path, "--to", *words)
    name = load_model(path).aircraft.name
    assert {Path(written).name for written in said["files"]} == {
        Path(each).name for each in file.format(name).split()
    }
    assert all((tmp_path / "out" / written).stat().st_size for written in said["files"])
    assert words[0] == "jsbsim" or set(said["loss"]) == set(COEFFICIENTS)
    portable = str(Path(__file__).with_name("stored.npz"))
    assert main(["export", portable, "--to", words[0], "-o", str(tmp_path / "no")]) == 1
    assert "expected the model.joblib" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            ["--to", "portable", "--precision", "float"],
            r"options \['precision'\] for the format portable",
        ),
        (["--to", "c", "--max-kb", "1"], "smallest form of this model takes"),
        (["--to", "c", "--aircraft", "no.json"], "no.json"),
    ],
)
def test_what_cannot_be_exported(path, words, message, tmp_path, capsys):
    assert main(["export", path, *words, "-o", str(tmp_path / "new" / "out")]) == 1
    (error,) = [
        line for line in capsys.readouterr().err.splitlines() if not line.startswith("warning: ")
    ]
    assert re.search(f"error: .*{message}", error)
    assert not (tmp_path / "new").exists()


def test_what_is_no_model(path, tmp_path, capsys):
    (tmp_path / "model.npz").write_bytes(b"junk")
    for model, words, message in (
        (tmp_path / "model.npz", [], "is not a portable model"),
        (tmp_path / "none.npz", [], "there is no such file"),
        (tmp_path / "model.npz", ["--aircraft", "other.json"], "a portable model has its own"),
    ):
        assert main(["export", str(model), "--to", "c", *words, "-o", str(tmp_path / "out")]) == 1
        error = capsys.readouterr().err
        assert message in error
        assert error.count("\n") == 1
    with pytest.raises(SystemExit) as end:
        main(["export", path, "--to", "fortran", "-o", str(tmp_path / "out")])
    assert end.value.code == 2
    error = capsys.readouterr().err
    assert all(name in error for name in FORMATS)


def test_code_of_the_page_runs(fitted_of, flight, tmp_path, monkeypatch):
    """The Python of the section of export.md, in one namespace with a flight."""
    page = Path(__file__).parents[3] / "docs" / "export.md"
    monkeypatch.chdir(tmp_path)
    (tmp_path / "results").mkdir()
    save_model("results/model.joblib", **fitted_of("sparse"))
    names = {"flight": flight}
    section = (
        page.read_text(encoding="utf-8")
        .partition("\n## The portable model\n")[2]
        .partition("\n## ")[0]
    )
    for block in re.findall(r"^```python\n(.*?)^```", section, re.DOTALL | re.MULTILINE):
        exec(compile(block, "export.md", "exec"), names)
    assert names["slopes"].shape == (30, 6, 5)
    X = names["model"].regressor_values(flight)
    np.testing.assert_allclose(names["aerodynamics"](X), names["mean"], rtol=1e-9, atol=1e-10)
    np.testing.assert_allclose(
        names["aerodynamics"].gradient(X), names["slopes"], rtol=1e-9, atol=1e-10
    )
