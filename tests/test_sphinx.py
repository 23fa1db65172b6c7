"""The site builds without a warning, and every page and every public name has its place."""

import argparse
import importlib
import importlib.util
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


def pages(folder=DOCS):
    found = (path.relative_to(folder) for path in folder.rglob("*.md"))
    return sorted(path for path in found if not set(path.parts) & set(MADE))


def in_toctrees(page):
    """The documents that the toctrees of a page name."""
    text = (DOCS / page).read_text(encoding="utf-8")
    for body in re.findall(r"^```\{toctree\}\n(.*?)^```", text, flags=re.DOTALL | re.MULTILINE):
        for line in filter(None, body.splitlines()):
            if not line.startswith(":"):
                name = re.sub(r"^.*<(.*)>$", r"\1", line)
                yield (page.parent / f"{name}.md").as_posix()


def test_every_page_is_in_one_toctree():
    named = [name for page in pages() for name in in_toctrees(page)]
    assert len(named) == len(set(named))
    assert set(named) - {"gallery/index.md"} == {page.as_posix() for page in pages()} - {"index.md"}


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


def load(path):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(
    "path", sorted((ROOT / "examples").glob("*.py")), ids=lambda path: path.name
)
def test_the_gallery_gives_an_example_what_it_takes(path, monkeypatch):
    pytest.importorskip(
        "sphinx_gallery", reason='shows examples in a gallery: pip install -e ".[docs]"'
    )
    pytest.importorskip("matplotlib", reason="examples draw")
    words = load(DOCS / "_extensions" / "examples_in_gallery.py").arguments(
        {}, {"src_file": str(path)}
    )
    parse, parsed = argparse.ArgumentParser.parse_args, []

    def stop(self, arguments):
        parsed.append(parse(self, arguments))
        raise KeyboardInterrupt

    monkeypatch.setattr(argparse.ArgumentParser, "parse_args", stop)
    with pytest.raises(KeyboardInterrupt):
        load(path).main(words)
    assert getattr(parsed[0], "output", ".png").endswith(".png")  # of an example that draws


def test_citations_name_the_version():
    version = skdgp.__version__
    assert f"\nversion: {version}\n" in (DOCS / "CITATION.cff").read_text(encoding="utf-8")
    assert f"version = {{{version}}}" in (DOCS / "contributing.md").read_text(encoding="utf-8")
