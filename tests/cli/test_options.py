"""Options of the command line, and the page that shows them."""

import re
import shlex
from pathlib import Path

import pandas as pd
import pytest
from matplotlib.figure import Figure

from skdgp._cli import COMMANDS, main, parse

NAMES = [run.__name__ for run in COMMANDS]


def usage_error(capsys, *words):
    """Return what wrong usage says."""
    with pytest.raises(SystemExit) as end:
        main([*words])
    assert end.value.code == 2
    return capsys.readouterr().err.splitlines()[-1]


def test_values_are_of_their_types():
    options = parse(
        shlex.split("identify a.csv b.csv --mass 3.2+-0.05 --span 1.6 --propeller 10x5")
    )
    assert options.train == ["a.csv", "b.csv"]
    assert (options.mass, options.span, options.propeller) == ((3.2, 0.05), (1.6, 0.0), (10.0, 5.0))
    words = (
        "plan m --airspeed 35 --seconds 9 --axes elevator --alpha -3 1e-3 --full elevator=.03 -o x"
    )
    options = parse(shlex.split(words))
    assert (options.alpha, options.full) == ([-3.0, 1e-3], [("elevator", 0.03)])
    options = parse(shlex.split("identify a --samples all --regressors alpha,q_hat --airborne 9"))
    assert (options.samples, options.regressors) == ("all", ["alpha", "q_hat"])
    assert options.airborne == 9.0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("demo --samples 1", "got 1, but expected a whole number, 2 or more, or all"),
        ("demo --seed inf", "got inf, but expected a whole number, 0 or more"),
        (f"demo --seed {'9' * 400}", "but expected a whole number"),
        ("demo --seed 0x10", "got 0x10, but expected a whole number"),
        ("demo --inference magic", "invalid choice: 'magic'"),
        ("demo --horizons 1 nan", "got nan, but expected seconds > 0"),
        ("demo --sampels 40", "unrecognized arguments: --sampels 40"),
        (
            "identify a --mass 3x",
            "got 3x, but expected a number > 0, or with its standard deviation",
        ),
        ("identify a --mass 3+--1", "but expected a number > 0, or with its standard deviation"),
        ("identify a --mass 3 --propeller 10", "got 10, but expected two numbers > 0"),
        ("identify a.csv", "got no aircraft, but expected --aircraft FILE, or --mass and --span"),
        ("identify a --mass 3 --span 2 --motor 9x9", "got --motor without --propeller"),
        ("identify a --mass 3 --aircraft b.json", "got --aircraft --mass, but expected"),
        ("identify a --test t\udcff.csv", r"got 't\udcff.csv', but expected a name in UTF-8"),
        ("identify", "required: TRAIN"),
        ("predict m a.csv -o out.xlsx", "but expected a name that ends in .csv"),
        ("plan m --full elevator", "got elevator, but expected AXIS=NUMBER"),
        ("derivatives m --airspeed 35 --paths 1", "got 1, but expected 0, or 2 or more"),
        ("export m --to c", "required: -o/--output"),
        ("fly m", "invalid choice: 'fly'"),
        ("", "required: COMMAND"),
    ],
)
def test_wrong_usage_is_one_line(words, message, capsys):
    assert message in usage_error(capsys, *shlex.split(words))


def help_of(capsys, *words):
    with pytest.raises(SystemExit) as end:
        main([*words, "--help"])
    assert end.value.code == 0
    return capsys.readouterr().out


@pytest.mark.parametrize("run", COMMANDS, ids=NAMES)
def test_help_explains_every_option(run, capsys):
    text = help_of(capsys, run.__name__)
    groups = COMMANDS[run].values()
    assert all(keywords["help"] for group in groups for keywords in group.values())
    options = [name for group in groups for name in group]
    assert all((name if name.startswith("-") else name.upper()) in text for name in options)
    reads_a_model = "model" in options
    assert ("loading runs code" in " ".join(text.split())) == reads_a_model


@pytest.mark.parametrize("name", [None, *NAMES])
def test_examples_of_the_help_are_right(name, capsys):
    text = help_of(capsys, *[name] * (name is not None))
    examples = [line.strip() for line in text.splitlines() if line.startswith("  skdgp ")]
    assert examples
    for example in examples:
        words = shlex.split(re.split(r"\s{2,}", example)[0])[1:]
        assert name in (None, words[0])
        assert parse(words).command == words[0]


def test_version(capsys):
    with pytest.raises(SystemExit) as end:
        main(["--version"])
    assert end.value.code == 0
    assert re.fullmatch(r"skdgp \d+\.\d+\.\d+\n", capsys.readouterr().out)


PAGE = Path(__file__).parents[2] / "docs" / "identification.md"
QUICK = {
    "identify": ["--samples", "40", "--latents", "1", "--structure", "joint"],
    "derivatives": ["--paths", "4"],
    "plan": shlex.split("--seconds 10 --axes rudder --limits rudder=0.1 --growth 2"),
}


@pytest.fixture
def page():
    return PAGE.read_text(encoding="utf-8")


def blocks(page, language):
    return re.findall(rf"^```{language}\n(.*?)^```", page, flags=re.DOTALL | re.MULTILINE)


@pytest.mark.usefixtures("hasty_fits", "few_manoeuvres", "no_report")
@pytest.mark.filterwarnings("ignore:Flight 'two_altitudes' lasts 7.48 s")
def test_its_commands_and_code_run(page, folder, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(Figure, "savefig", lambda figure, path, **options: Path(path).touch())
    for ours, theirs in {"lateral": "monday", "latlon": "tuesday", "test": "wednesday"}.items():
        table = pd.read_csv(folder / f"{ours}.csv")
        table.assign(time=table["time"] + 30.0).to_csv(f"{theirs}.csv", index=False)
    (tmp_path / "uav.json").write_bytes((folder / "uav.json").read_bytes())
    for line in "".join(blocks(page, "sh")).splitlines():
        words = shlex.split(line)[1:]
        assert main([*words, *QUICK.get(words[0], [])]) == 0, line
    assert (tmp_path / "sweep" / "modes.csv").is_file()
    names = {}
    for block in blocks(page, "python"):
        exec(compile(block, PAGE.name, "exec"), names)


def test_every_command_is_on_it(page):
    section = page.partition("\n## Use the model\n")[2].partition("\n## ")[0]
    assert set(re.findall(r"^\| `(\w+)", section, flags=re.MULTILINE)) == {
        run.__name__ for run in COMMANDS
    }
