"""What docs/plotting.md shows runs as it stands."""

import re
from pathlib import Path

import matplotlib
import pytest

PAGE = Path(__file__).parents[2] / "docs" / "plotting.md"


def test_code_of_the_page_runs(tmp_path, monkeypatch):
    if not PAGE.is_file():
        pytest.skip("docs/plotting.md is not beside the tests")
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    names = {}
    for block in blocks:
        exec(compile(block, str(PAGE), "exec"), names)
    plt.close("all")
    assert {file.name for file in tmp_path.iterdir()} == {"coefficients.png", "coefficients.pdf", "report.html"}
