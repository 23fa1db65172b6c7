"""How the gallery runs examples, which are commands: smaller than by default, and the picture they write is shown."""

import shutil
import time
from pathlib import Path

from sphinx_gallery.scrapers import figure_rst

STARTED = time.time()
SMALLER = {
    "after_the_model.py": ["--samples", "400", "--paths", "30"],
    "closed_loop.py": ["--rounds", "1"],
    "fly_the_model.py": ["--samples", "400", "--paths", "30"],
    "grid_search_flights.py": [
        "--days",
        "1",
        "--samples",
        "200",
        "--max-iter",
        "10",
        "--n-jobs",
        "1",
    ],
}


def arguments(gallery_conf, script_vars):
    """Return the command line of one example."""
    return SMALLER.get(Path(script_vars["src_file"]).name, [])


def pictures(block, block_vars, gallery_conf):
    """Move the pictures that a block wrote beside its script into the gallery."""
    written = [
        path
        for path in Path(block_vars["src_file"]).parent.glob("*.png")
        if path.stat().st_mtime >= STARTED
    ]
    places = [next(block_vars["image_path_iterator"]) for _ in written]
    for path, place in zip(sorted(written), places, strict=True):
        shutil.move(path, place)
    return figure_rst(places, gallery_conf["src_dir"])
