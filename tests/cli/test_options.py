"""Options of the command line, and the page that shows them."""

import re
import shlex
import sys
from pathlib import Path
from unittest.mock import patch

import pandas as pd
import pytest

PAGE = Path(__file__).parents[2] / "docs" / "identification.md"
NAMES = [
    "inspect",
    "identify",
    "demo",
    "validate",
    "predict",
    "derivatives",
    "plan",
    "export",
    "margins",
    "fly",
]


@pytest.fixture
def usage_error(command, capsys):
    """Return what wrong usage says."""

    def usage_error(words):
        with pytest.raises(SystemExit) as end:
            command(shlex.split(words))
        assert end.value.code == 2
        return capsys.readouterr().err.splitlines()[-1]

    return usage_error


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("demo --samples 1", "got 1, but expected a whole number >= 2"),
        (f"demo --seed {'9' * 400}", "but expected a whole number"),
        ("demo --horizon nan", "got nan, but expected a number > 0"),
        ("demo --sampels 40", "unrecognized arguments: --sampels 40"),
        ("identify a --mass 3+--1", "but expected a number > 0, or with its standard deviation"),
        ("identify a --mass 3 --propeller 10", "got 10, but expected two numbers > 0"),
        ("identify a.csv", "got no aircraft, but expected --aircraft FILE, or --mass and --span"),
        ("identify a --mass 3 --span 2 --motor 9x9", "got --motor without --propeller"),
        ("identify a --mass 3 --aircraft b.json", "got --aircraft --mass, but expected"),
        ("identify", "required: TRAIN"),
        ("predict m a.csv -o out.xlsx", "but expected a name that ends in .csv"),
        ("plan m --full elevator", "got elevator, but expected AXIS=NUMBER"),
        ("derivatives m --airspeed 35 --paths 1", "got 1, but expected 0, or 2 or more"),
        ("export m --to c", "required: -o/--output"),
        ("soar m", "invalid choice: 'soar'"),
        ("", "required: COMMAND"),
    ],
)
def test_wrong_usage_is_one_line(words, message, usage_error):
    assert message in usage_error(words)


def test_these_are_all_commands(usage_error):
    choices = usage_error("soar m").partition("choose from")[2]
    assert sorted(re.findall(r"\w+", choices)) == sorted(NAMES)


@pytest.fixture
def help_of(command, capsys):
    def help_of(*words):
        with pytest.raises(SystemExit) as end:
            command([*words, "--help"])
        assert end.value.code == 0
        return capsys.readouterr().out

    return help_of


@pytest.mark.parametrize("name", [None, *NAMES])
def test_examples_of_the_help_are_right(name, help_of):
    text = help_of(*[name] * (name is not None))
    examples = [line.strip() for line in text.splitlines() if line.startswith("  skdgp ")]
    assert examples
    for example in examples:
        _, command, *words = shlex.split(re.split(r"\s{2,}", example)[0])
        assert name in (None, command)
        options = re.findall(r"-[\w-]+", help_of(command).partition("\n\n")[0])
        assert {word for word in words if word.startswith("-")} <= {*options}


QUICK = {
    "identify": ["--samples", "40"],
    "derivatives": ["--paths", "4"],
    "plan": shlex.split("--seconds 10 --axes rudder --limits rudder=0.1 --growth 2"),
}


@pytest.mark.slow
@pytest.mark.usefixtures("hasty_fits", "few_manoeuvres", "no_mechanics")
@pytest.mark.filterwarnings("ignore:Flight 'two_altitudes' lasts 7.48 s")
def test_commands_and_code_of_the_page_run(folder, tmp_path, monkeypatch, command, blocks_of):
    monkeypatch.chdir(tmp_path)
    for ours, theirs in {"lateral": "monday", "latlon": "tuesday", "test": "wednesday"}.items():
        table = pd.read_csv(folder / f"{ours}.csv")
        table.assign(time=table["time"] + 30.0).to_csv(f"{theirs}.csv", index=False)
    (tmp_path / "uav.json").write_bytes((folder / "uav.json").read_bytes())
    with patch.dict(sys.modules, {"matplotlib": None}):
        for line in "".join(blocks_of(PAGE.name, "sh")).splitlines():
            words = shlex.split(line)[1:]
            assert command([*words, *QUICK.get(words[0], [])]) == 0, line
    assert (tmp_path / "sweep" / "modes.csv").is_file()
    names = {}
    for block in blocks_of(PAGE.name):
        exec(compile(block, PAGE.name, "exec"), names)


@pytest.mark.parametrize("name", NAMES)
def test_help_explains_every_option(name, help_of):
    text = help_of(name)
    usage, _, rest = text.partition("\n\n")
    explained = re.findall(r"^  (?:-\w.*?, )?(--[\w-]+|[A-Z]+)[^\n]*?(?:  +|\n +)\S", rest, re.M)
    assert set(re.findall(r"--[\w-]+", usage)) <= {*explained}
    assert ("loading runs code" in " ".join(text.split())) == ("MODEL" in usage)
