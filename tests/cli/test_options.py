"""Options: what each value may be, what is wrong with one in a line, and help that explains them."""

import re
import shlex

import pytest

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
    options = parse(
        shlex.split("simulate m --trim 35 --wind -3 1e-3 0 --doublet elevator=.03 -o x")
    )
    assert (options.wind, options.doublet) == ([-3.0, 1e-3, 0.0], [("elevator", 0.03)])
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
        ("demo --n-jobs 0", "got 0, but expected a number of processes, 1 or more, or -1"),
        ("demo --sampels 40", "unrecognized arguments --sampels 40: did you mean --samples?"),
        ("demo --xyz 1", "unrecognized arguments --xyz 1: --help lists the options"),
        ("demo --config run.toml", "unrecognized arguments"),
        (
            "identify a --mass 3x",
            "got 3x, but expected a number > 0, or with its standard deviation",
        ),
        ("identify a --mass 3+--1", "but expected a number > 0, or with its standard deviation"),
        ("identify a --mass 3 --propeller 10", "got 10, but expected two numbers > 0"),
        ("identify a.csv", "got no aircraft, but expected --aircraft FILE, or --mass and --span"),
        ("identify a --mass 3 --span 2 --motor 9x9", "got --motor without --propeller"),
        ("identify a --mass 3 --aircraft b.json", "got --aircraft --mass, but expected"),
        ("identify a --aircrat=b.json", "did you mean --aircraft?"),
        ("identify a --test t\udcff.csv", r"got 't\udcff.csv', but expected a name in UTF-8"),
        ("identify", "required: TRAIN"),
        ("predict m a.csv -o out.xlsx", "but expected a name that ends in .csv or .parquet"),
        ("simulate m --doublet elevator", "got elevator, but expected AXIS=NUMBER"),
        ("simulate m --trim 35 --paths 1", "got 1, but expected 0, or 2 or more"),
        ("simulate m --trim 35", "required: -o/--output"),
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
