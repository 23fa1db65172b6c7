"""The site builds without a warning, so links lead somewhere."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
MADE = ("_build", "gallery", "generated", "sg_execution_times.rst")  # by a build


@pytest.mark.slow
def test_the_site_builds_without_a_warning(tmp_path):
    """All but the running of examples and the writing of HTML, in a copy, since a build writes beside its sources."""
    for name in ("sphinx", "myst_parser", "sphinx_gallery", "numpydoc", "furo"):
        pytest.importorskip(name, reason='builds the site: pip install -e ".[docs]"')
    shutil.copytree(DOCS, tmp_path / "docs", ignore=shutil.ignore_patterns(*MADE))
    for name in ("skdgp", "examples", "README.md"):
        (tmp_path / name).symlink_to(ROOT / name)
    options = ["-W", "--keep-going", "-q", "-b", "dummy", "-D", "plot_gallery=0"]
    done = subprocess.run(
        [sys.executable, "-m", "sphinx", *options, "docs", "built"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=540,
    )
    assert done.returncode == 0, done.stderr[-5000:]
