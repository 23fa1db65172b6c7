"""How the gallery runs examples, which are commands: smaller than by default, and the picture they write is shown."""

import shutil
import tempfile
import time
from pathlib import Path

from sphinx_gallery.scrapers import figure_rst

from skdgp import DependentGPRegressor, make_identification_pipeline
from skdgp.datasets import load_example_flights
from skdgp.dynamics import aerodynamic_coefficients
from skdgp.export import portable_model, save_portable
from skdgp.model_selection import thin_targets

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
    name = Path(script_vars["src_file"]).name
    if name == "read_portable.py":
        return [str(portable_file()), "--output", "portable.png"]
    return SMALLER.get(name, [])


def portable_file():
    """Write a portable model of the example flights, and return its path."""
    flights = load_example_flights()
    train = flights.train
    Y = thin_targets(aerodynamic_coefficients(train, flights.aircraft), 300)
    regressor = DependentGPRegressor(structure="trend", random_state=0)
    model = make_identification_pipeline(flights.aircraft, regressor=regressor).fit(train, Y)
    path = Path(tempfile.mkdtemp()) / "model.npz"
    return save_portable(path, portable_model(model, aircraft=flights.aircraft))


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
