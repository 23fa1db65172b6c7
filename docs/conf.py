"""The site: Markdown pages, the reference from docstrings, the examples as a gallery.

python -m sphinx -W -b html docs docs/_build/html        # all of it; the examples run, some minutes
python -m sphinx -W -b html -D plot_gallery=0 docs docs/_build/html        # they do not
"""

import sys
from importlib.metadata import version as version_of
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "_extensions"))

project = "skdgp"
copyright = author = "the skdgp developers"
version = release = version_of("skdgp")

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "numpydoc",
    "sphinx_gallery.gen_gallery",
    "mathml",
    "members",
]
exclude_patterns = ["_build"]
templates_path = ["_templates"]

myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3

autodoc_typehints = "none"  # numpydoc's sections say types in words
numpydoc_show_class_members = False  # the template of a class shows its own, below its docstring

sphinx_gallery_conf = {
    "examples_dirs": "../examples",
    "gallery_dirs": "gallery",
    "filename_pattern": r"\.py$",
    "reset_argv": "examples_in_gallery.arguments",
    "image_scrapers": ("examples_in_gallery.pictures",),
    "download_all_examples": False,
    "show_signature": False,
    "thumbnail_size": (560, 400),
    "write_computation_times": False,
    "notebook_extensions": set(),  # the examples are commands
}

html_theme = "furo"
html_title = "skdgp"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_copy_source = False
html_math_renderer = "mathml"
