"""The site builds without a warning, so links lead somewhere, and every public name is in the reference."""

import importlib
import pkgutil
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import skdgp

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
MADE = ("_build", "gallery", "generated", "sg_execution_times.rst")  # by a build
MODULES = ["skdgp"] + [
    module.name
    for module in pkgutil.walk_packages(skdgp.__path__, "skdgp.")
    if not any(part.startswith("_") for part in module.name.split("."))
]


def test_every_public_name_is_in_the_reference():
    for module in MODULES:
        text = (DOCS / "api" / f"{module}.md").read_text(encoding="utf-8")
        named = set(re.findall(r"^   (\w+)$", text, flags=re.MULTILINE)) | set(
            re.findall(rf"^\.\. data:: {re.escape(module)}\.(\w+)$", text, flags=re.MULTILINE)
        )
        assert named == set(importlib.import_module(module).__all__), module


def test_the_site_builds_without_a_warning(tmp_path):
    """All but the running of examples and the writing of HTML, in a copy, since a build writes beside its sources."""
    for name in ("sphinx", "myst_parser", "sphinx_gallery", "numpydoc", "furo"):
        pytest.importorskip(name, reason='builds the site: pip install -e ".[docs]"')
    shutil.copytree(DOCS, tmp_path / "docs", ignore=shutil.ignore_patterns(*MADE))
    for name in ("skdgp", "examples", "README.md"):
        (tmp_path / name).symlink_to(ROOT / name)
    command = [
        sys.executable,
        "-m",
        "sphinx",
        "-W",
        "--keep-going",
        "-q",
        "-b",
        "dummy",
        "-D",
        "plot_gallery=0",
    ]
    done = subprocess.run(
        [*command, "docs", "built"], cwd=tmp_path, capture_output=True, text=True, timeout=540
    )
    assert done.returncode == 0, done.stderr[-5000:]
