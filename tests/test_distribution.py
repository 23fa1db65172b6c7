"""What is distributed: all that the repository holds, and bounds of versions that were run."""

import re
import subprocess
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
NOT_RUN = {
    "skdgp",  # itself
    # tools that no test of the numerics needs
    "ruff", "hatchling", "mypy", "pandas-stubs", "scipy-stubs", "joblib-stubs", "pytest-cov",
    "jsbsim", "lupa",  # programs that read what is exported
}  # fmt: skip


def requirements(name=None):
    """Return what pyproject.toml requires, an extra or the package itself, as {name: lower bound}."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    lines = project["dependencies"] if name is None else project["optional-dependencies"][name]
    return dict(
        re.fullmatch(r"([\w-]+)(?:\[\w+\])?(?:>=([\w.]+))?", line).groups() for line in lines
    )


def test_the_oldest_versions_that_are_tested_are_the_bounds():
    pinned = dict(
        line.split("==")
        for line in (ROOT / "tests" / "oldest.txt").read_text().splitlines()
        if not line.startswith("#")
    )
    bounds = {}
    for extra in (None, "plot", "parquet", "logs", "dask", "test"):
        for name, bound in requirements(extra).items():
            assert bounds.setdefault(name, bound) == bound, f"{name} has two bounds"
    assert pinned == {name: bound for name, bound in bounds.items() if name not in NOT_RUN}


def tracked():
    """Return the files of the repository that git does not ignore, if this is one."""
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    try:
        listed = subprocess.run(
            command, cwd=ROOT, capture_output=True, text=True, check=True
        ).stdout
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("this is not a clone: its files are those that a distribution held")
    return {name for name in listed.split("\0") if (ROOT / name).is_file()}


class TestDistributions:
    @pytest.fixture(autouse=True)
    def _at_root(self, monkeypatch):
        monkeypatch.chdir(ROOT)

    def test_of_the_sources_hold_every_file(self, tmp_path):
        build = pytest.importorskip("hatchling.build", exc_type=ImportError)
        name = build.build_sdist(str(tmp_path))
        with tarfile.open(tmp_path / name) as archive:
            held = {member.name.partition("/")[2] for member in archive if member.isfile()}
        assert not tracked() - held
        assert {
            name for name in held if name.startswith(("skdgp", "tests", "docs", "examples"))
        } <= tracked()

    def test_to_install_hold_the_package_and_its_command_alone(self, tmp_path):
        build = pytest.importorskip("hatchling.build", exc_type=ImportError)
        with zipfile.ZipFile(tmp_path / build.build_wheel(str(tmp_path))) as archive:
            held = {name for name in archive.namelist() if ".dist-info/" not in name}
            (scripts,) = [name for name in archive.namelist() if name.endswith("entry_points.txt")]
            assert b"skdgp = skdgp.__main__:main" in archive.read(scripts)
        assert held == {name for name in tracked() if name.startswith("skdgp/")}
