"""Configurations: what they hold repeats a run, words win over them, and what is wrong with one is told in a line."""

import json
import re
import shlex
import tomllib
from argparse import Namespace

import numpy as np
import pandas as pd
import pytest

from skdgp._cli import COMMANDS, main
from skdgp._cli._options import FileName
from skdgp._cli._output import table_writer


def parse(command, *words):
    return vars(COMMANDS[command].parse([str(word) for word in words]))


@pytest.fixture
def config(tmp_path):
    def write(text):
        path = tmp_path / "config.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return write


class TestRepeat:
    @pytest.mark.usefixtures("no_report", "short_fits")
    def test_of_identify(self, identified, tmp_path, monkeypatch, capsys):
        monkeypatch.chdir(tmp_path)  # files are found from anywhere
        output, _, metrics = identified
        assert main(["identify", "--config", str(output / "config.toml"), "-o", "again"]) == 0
        again = json.loads((tmp_path / "again" / "metrics.json").read_text())
        assert again["test"] == metrics["test"]
        assert again["options"] == metrics["options"]
        assert capsys.readouterr().out.startswith("brumby: fitted in")
        first, second = (
            (folder / "config.toml").read_text() for folder in (output, tmp_path / "again")
        )
        assert first == second

    @pytest.mark.parametrize(
        ("command", "words", "table"),
        [
            ("predict", ["test.csv", "--include-noise", "-o", "{}/out.csv"], "out.csv"),
            ("simulate", shlex.split("--trim 35 --wind -3 1 0 --paths 3 --duration .2 -o {}"), "bands.csv"),
            ("derivatives", ["--airspeed", "34", "36", "--paths", "5", "-o", "{}"], "derivatives.csv"),
        ],
    )  # fmt: skip
    def test_of_what_uses_a_model(self, command, words, table, identified, tmp_path, capsys):
        first, second = tmp_path / "first", tmp_path / "second"
        assert (
            main(
                [
                    command,
                    str(identified[0] / "model.joblib"),
                    *(word.format(first) for word in words),
                ]
            )
            == 0
        )
        kept = next(first.glob("*.toml"))
        output = second / words[-1].format("").lstrip("/")
        assert main([command, "--config", str(kept), "-o", str(output)]) == 0
        assert (second / table).read_bytes() == (first / table).read_bytes()
        assert (second / kept.name).read_text() == kept.read_text()
        capsys.readouterr()

    @pytest.mark.parametrize(
        "words",
        [
            ["demo"],
            [
                "identify",
                "a.csv",
                "--aircraft",
                "u.json",
                "--samples",
                "all",
                "--regressors",
                "alpha,q_hat",
            ],
            [
                "validate",
                "m.joblib",
                "a.csv",
                "--external-forces",
                "tether",
                "--horizons",
                "1",
                ".1",
            ],
            ["predict", "m.joblib", "a.csv", "b.csv", "--include-noise"],
            ["simulate", "m.joblib", "--trim", "35", "--wind", "-3", "1e-3", "0", "--bank", "-.1"],
            ["derivatives", "m.joblib", "--airspeed", "30", "35.5", "--json"],
            shlex.split(
                "plan m --airspeed 30 --seconds 9 --axes rudder --full rudder=1 --beta -.1 .1"
            ),
        ],
        ids=lambda words: words[0],
    )
    def test_all_options_of_a_command_come_back(self, words, config):
        output = ["-o", "out.csv"]
        command = COMMANDS[words[0]]
        kept = command.config_text(command.parse([*words[1:], *output]))
        again = command.parse(["--config", str(config(kept)), *output])
        assert command.config_text(again) == kept

    def test_every_value_comes_back(self):
        values = {
            "text": 'a "b" \\ é \n\x7f',
            "number": 0.1 + 0.2,
            "whole": 755,
            "yes": True,
            "several": [1.5, 2.0],
        }
        options = Namespace(traceback=True, nothing=None, output="out", **values)
        kept = tomllib.loads(COMMANDS["simulate"].config_text(options))
        assert kept.pop("command") == "simulate"
        assert "skdgp" in kept.pop("versions")
        assert kept == values

    def test_files_are_kept_by_their_whole_path(self, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)
        kept = tomllib.loads(COMMANDS["identify"].config_text(Namespace(train=[FileName("a.csv")])))
        assert kept["train"] == [str(tmp_path / "a.csv")]


class TestReading:
    def test_words_win(self, config):
        path = config(
            'model = "m.joblib"\nflight = ["a.csv"]\ninclude-noise = true\noutput = "out.csv"\n'
        )
        assert parse("predict", "--config", path)["flight"] == ["a.csv"]
        assert parse("predict", f"--config={path}")["output"] == "out.csv"
        found = parse("predict", "other.joblib", "--config", path, "b.csv", "-o", "b.csv", "c.csv")
        assert found["model"] == "other.joblib"
        assert found["flight"] == ["b.csv", "c.csv"]
        assert found["output"] == "b.csv"
        assert found["include_noise"] is True

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ("sampels = 40", "unknown option 'sampels' in .*config.toml: did you mean 'samples'"),
            ("weather = 1", "unknown option 'weather' in .*: known options are .*horizons"),
            (
                "samples = 1",
                "samples = 1 in .*: got 1, but expected a whole number, 2 or more, or all",
            ),
            ("inference = 'magic'", 'inference = "magic" in .*invalid choice'),
            ("seed = true", "seed = true in .*: expected text or numbers"),
            ("json = 1", "json = 1 in .*: expected true or false"),
            ("horizons = [[1]]", "horizons = .*: expected text or numbers"),
            ("samples = ", "config.toml is not a TOML file"),
            pytest.param(
                "samples = " + "[" * 50_000,
                "config.toml is not a TOML file: it is nested too deeply",
                id="deep",
            ),
            ("versions = 3", "Got versions = 3 in .*config.toml, but expected a table"),
            ("seed = inf", "seed = Infinity in .*: got inf, but expected a whole number"),
            pytest.param(f"seed = 0x{'f' * 5000}", "Exceeds the limit", id="huge"),
            ("seed = 1\nseed = 2", "config.toml is not a TOML file: Cannot overwrite"),
            ("seed = 1979-05-27", "got 1979-05-27, but expected a whole number"),
            ("command = 'predict'", "of the command predict, but the command is demo: say predict"),
        ],
    )
    def test_what_is_wrong_is_told_in_one_line(self, config, text, message, tmp_path, capsys):
        assert main(["demo", "--config", str(config(text)), "-o", str(tmp_path / "out")]) == 1
        (line,) = capsys.readouterr().err.splitlines()
        assert re.search(f"^error: .*({message})", line)
        assert not (tmp_path / "out").exists()

    def test_other_versions_are_remarked_on(self, config, capsys):
        path = config('model = "none.joblib"\nflight = ["a.csv"]\n\n[versions]\nnumpy = "1.0"\n')
        assert main(["predict", "--config", str(path), "-o", "out.csv"]) == 1
        said = capsys.readouterr().err
        assert "is of a run with numpy 1.0, and this is" in said
        assert "Got none.joblib, but there is no such file" in said

    def test_what_is_still_missing_is_wrong_usage(self, config, capsys):
        with pytest.raises(SystemExit) as end:
            main(["identify", "--config", str(config("samples = 40")), "a.csv", "-o", "out"])
        assert end.value.code == 2
        assert "--aircraft" in capsys.readouterr().err


class TestHelp:
    @pytest.mark.parametrize("command", COMMANDS)
    def test_explains_every_option(self, command, capsys):
        with pytest.raises(SystemExit) as end:
            main([command, "--help"])
        assert end.value.code == 0
        words = capsys.readouterr().out
        for option in COMMANDS[command].all_options:
            assert option.keywords["help"], option.key
            assert option.keywords.get("metavar", option.key) or option.key in words
            assert all(name in words for name in option.names if name.startswith("-"))

    @pytest.mark.parametrize("command", [None, *COMMANDS])
    def test_its_examples_are_right(self, command, capsys):
        with pytest.raises(SystemExit):
            main([*([command] if command else []), "--help"])
        text = capsys.readouterr().out
        examples = [line.strip() for line in text.splitlines() if line.startswith("  skdgp ")]
        assert examples
        for example in examples:
            name, *words = shlex.split(re.split(r"\s{2,}", example)[0])[1:]
            assert command in (None, name)
            COMMANDS[name].parse(words)


def test_tables_of_a_repeat_have_every_digit(tmp_path):
    table = pd.DataFrame(
        {"time": np.arange(3) * 0.1, "CX": np.random.default_rng(0).normal(size=3), "ended": ""}
    )
    for suffix, read in ((".csv", pd.read_csv), (".parquet", pd.read_parquet)):
        table_writer(table, suffix)(tmp_path / f"table{suffix}")
        found = read(tmp_path / f"table{suffix}")
        np.testing.assert_array_equal(found[["time", "CX"]], table[["time", "CX"]])
