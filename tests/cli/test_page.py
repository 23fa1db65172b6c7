"""The page identification.md: its commands and code run, and every command is on it."""

import re
import shlex
from pathlib import Path

import pandas as pd
import pytest
from matplotlib.figure import Figure

from skdgp._cli import COMMANDS, main

PAGE = Path(__file__).parents[2] / "docs" / "identification.md"
QUICK = {
    "identify": ["--samples", "40", "--latents", "1", "--structure", "joint"],
    "simulate": ["--duration", ".2", "--paths", "2"],
    "derivatives": ["--paths", "4"],
    "plan": shlex.split("--seconds 10 --axes rudder --limits rudder=0.1 --growth 2 --paths 20"),
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
    assert (tmp_path / "turn" / "bands.csv").is_file()
    names = {}
    for block in blocks(page, "python"):
        exec(compile(block, PAGE.name, "exec"), names)


def test_every_command_is_on_it(page):
    section = page.partition("\n## Use the model\n")[2].partition("\n## ")[0]
    assert set(re.findall(r"^\| `(\w+)", section, flags=re.MULTILINE)) == {
        run.__name__ for run in COMMANDS
    }
