"""CSV files hold no formulas, and their texts come back."""

import csv
import re
from pathlib import Path

import pandas as pd
from hypothesis import given
from hypothesis import strategies as st

import skdgp
from skdgp._compute.files import csv_writer, guarded, unguarded

TEXTS = st.text("'=+-@\t\ra1.e", max_size=5) | st.text(max_size=5)


@given(TEXTS)
def test_texts_come_back(text):
    assert unguarded(guarded(text)) == text


@given(TEXTS)
def test_no_text_is_a_formula(text):
    written = guarded(text)
    if written[:1] in {*"=+-@\t\r"} - {""}:
        float(written)


def test_every_csv_is_written_so():
    source = Path(skdgp.__file__).parent
    writers = [
        path.name
        for path in source.rglob("*.py")
        if re.search(r"\bto_csv\(", path.read_text(encoding="utf-8"))
    ]
    assert writers == ["files.py"]


def test_numbers_and_words_stay(tmp_path):
    table = pd.DataFrame(
        {"flight": ["=cmd|x", "-1", "a", None], "@sum": [-1.5, 2.0, 0.1 + 0.2, 1e-300], "ok": True}
    )
    csv_writer(table)(tmp_path / "a.csv")
    with open(tmp_path / "a.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.reader(file))
    assert rows[0] == ["flight", "'@sum", "ok"]
    assert [row[0] for row in rows[1:]] == ["'=cmd|x", "-1", "a", ""]
    assert [float(row[1]) for row in rows[1:]] == table["@sum"].tolist()
    assert {row[2] for row in rows[1:]} == {"True"}
