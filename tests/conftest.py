"""What every test may ask for."""

import importlib
import os
import re
import signal
import socket
import sys
import tempfile
import time
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from importlib.metadata import entry_points
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

import joblib
import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from hypothesis.configuration import set_hypothesis_home_dir
from made_flights import LINEAR_GLIDER
from numpy.random import default_rng
from threadpoolctl import threadpool_limits

from skdgp import DependentGPRegressor, datasets
from skdgp.identification import FlightMechanics, Identification
from skdgp.inference import BlockSettings, SearchSettings

# Of processes that tests start, as _threads below for this one
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

ROOT = Path(__file__).resolve().parents[1]
SHARED_DATA = ROOT.parent / "shared" / "data"

# Nothing is written beside the tests
set_hypothesis_home_dir(Path(tempfile.gettempdir()) / "hypothesis")
settings.register_profile(
    "skdgp",
    derandomize=True,
    deadline=None,
    database=None,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("skdgp")

# As in the background of a shell: tests press Ctrl-C
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

collect_ignore = ["benchmarks"]  # scripts, which find each other only when they are run


@pytest.fixture(scope="session")
def glider():
    return LINEAR_GLIDER


@pytest.fixture(scope="session")
def central_difference():
    """Return d function / d x along a new last axis, of fourth order, for a function of a vector x."""

    def difference(function, x, step=1e-3):
        x = np.asarray(x, dtype=float)
        columns = []
        for unit in step * np.eye(len(x)):
            near = function(x + unit) - function(x - unit)
            far = function(x + 2 * unit) - function(x - 2 * unit)
            columns.append((8 * near - far) / (12 * step))
        return np.stack(columns, axis=-1) if columns else np.empty((*np.shape(function(x)), 0))

    return difference


@pytest.fixture
def uneven():
    """Return three regressors and three outputs of very different scales, the outputs with gaps."""
    rng = default_rng(0)
    X = rng.normal(size=(60, 3)) * [1.0, 20.0, 0.01] + [0.0, 500.0, 1.0]
    Z = (X - X.mean(axis=0)) / X.std(axis=0)
    Y = np.column_stack(
        [np.sin(Z[:, 0]), 100 * np.cos(Z[:, 1]) + 3, 0.01 * Z[:, 2] + 0.002 * Z[:, 0] ** 2]
    )
    Y[rng.random(Y.shape) < 0.3] = np.nan
    return X, Y


@pytest.fixture(scope="session", autouse=True)
def _threads():
    """Hold BLAS to one thread, or as many as the environment says: small problems are faster so."""
    with threadpool_limits(int(os.environ.get("OPENBLAS_NUM_THREADS", "1"))):
        yield


@pytest.fixture(scope="session")
def common_folder(tmp_path_factory) -> Path:
    """Return the folder of all processes of this test run."""
    folder = tmp_path_factory.getbasetemp()
    return folder.parent if "PYTEST_XDIST_WORKER" in os.environ else folder


@pytest.fixture(scope="session")
def once(common_folder):
    """Return a function to a folder of the test run that the first process to ask for it fills, while others wait."""

    def once(name, write):
        folder = common_folder / name
        done = common_folder / f"{name}.done"
        try:
            folder.mkdir()
        except FileExistsError:
            for _ in range(3000):  # five minutes: a process may have been killed
                if done.exists():
                    break
                time.sleep(0.1)
            return folder
        try:
            write(folder)
        finally:
            done.touch()
        return folder

    return once


@pytest.fixture(scope="session")
def made_once(once):
    """Return a function to what a function makes, under a name, made by the first process to ask for it."""

    def made_once(name, make):
        folder = once(name, lambda folder: joblib.dump(make(), folder / "made"))
        return joblib.load(folder / "made")

    return made_once


@pytest.fixture(scope="session")
def command():
    """Return the command ``skdgp`` as a function of its words, texts, numbers or paths, to its exit code."""
    (entry,) = entry_points(group="console_scripts", name="skdgp")
    main = entry.load()
    return lambda words: main([*map(str, words)])


@pytest.fixture
def the_error(capsys):
    """Return a function to the one line of an error that was printed, after warnings."""

    def the_error():
        lines = capsys.readouterr().err.splitlines()
        (error,) = [line for line in lines if not line.startswith("warning: ")]
        return error

    return the_error


@pytest.fixture(scope="session")
def blocks_of():
    """Return a function of a page under docs, a language and a heading: the blocks of code of the page or section."""

    def blocks_of(page, language="python", heading=None):
        text = (ROOT / "docs" / page).read_text(encoding="utf-8")
        if heading is not None:
            _, found, text = text.partition(f"\n## {heading}\n")
            assert found, heading
            text = text.partition("\n## ")[0]
        return re.findall(rf"^```{language}\n(.*?)^```", text, re.DOTALL | re.MULTILINE)

    return blocks_of


@pytest.fixture(scope="session")
def kernel_of_the_page(blocks_of):
    """Return the class of kernels.md, in a module, since instances are pickled by the name of their class."""
    made = sys.modules.setdefault("kernels_of_the_page", ModuleType("kernels_of_the_page"))
    for code in blocks_of("kernels.md"):
        if "\nclass " in code:
            exec(compile(code, "kernels.md", "exec"), vars(made))
    return made.SharedMatern


@pytest.fixture(scope="session")
def example():
    """Return a function to an example of the project by name, as a module."""

    def load(name):
        spec = spec_from_file_location(name, ROOT / "examples" / f"{name}.py")
        module = module_from_spec(spec)
        spec.loader.exec_module(module)
        return module

    return load


@pytest.fixture
def port():
    """Return a port that nobody uses."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]


@pytest.fixture(scope="session")
def first_minute(made_once):
    """Return a function to the first minute of the example flights, flown once by one of the processes."""
    fly = partial(datasets.load_example_flights, duration=60.0)
    return lambda: made_once("first minute", fly)


@pytest.fixture(scope="module")
def latlon(first_minute):
    """Return a minute of the example flight in which all controls move."""
    train = first_minute().train
    return train[train["flight"] == "latlon"].reset_index(drop=True)


@pytest.fixture(scope="session")
def jsbsim_maker():
    """Return the module that flies JSBSim."""
    pytest.importorskip("jsbsim", reason="flies JSBSim, which is not installed")
    return importlib.import_module("jsbsim_flight")


@pytest.fixture(scope="session")
def jsbsim_flight(jsbsim_maker, made_once):
    """Return a function from a model of JSBSim and its air to 40 s of a flight with truth, flown once."""

    def flight(model, air):
        fly = partial(jsbsim_maker.flight_of, model, 1, air, 1, duration=40.0)
        table, _ = made_once(f"{model} in {air} air", fly)
        return table

    return flight


@pytest.fixture
def short_flights(monkeypatch, request):
    """Let pages, examples and the command ``demo`` have the first 25 s of each example flight, or other rows."""
    n_rows = getattr(request, "param", 1000)
    defaults = datasets.load_example_flights.__wrapped__.__kwdefaults__
    monkeypatch.setitem(defaults, "duration", n_rows / 40)


@pytest.fixture(scope="session")
def cut_short():
    """Return a context, for fixtures that tests share, that cuts short what ``max_iter`` does not rule.

    Fits of each output alone, one search from one width, few rows: for tests of what is done with a model,
    whatever it learned. Other settings of the regressor are given by name.
    """

    @contextmanager
    def cut_short(**others):
        blocks = BlockSettings(values=240, series_values=300, series_blocks=1)
        search = SearchSettings(blocks=blocks, widths=(1.0,), noises=(1.0,), exact_iterations=2)
        short = replace(DependentGPRegressor.settings, search=search, **others)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(DependentGPRegressor, "settings", short)
            yield

    return cut_short


@pytest.fixture
def short_fits(cut_short):
    """Fit as in `cut_short` in one test."""
    with cut_short():
        yield


@pytest.fixture
def hasty_fits(monkeypatch, cut_short):
    """Stop every search after two iterations; few inducing inputs, no average.

    For pages and commands that only use what was learned.
    """
    for name, value in {"n_inducing": 24, "structure": "joint", "max_iter": 2}.items():
        monkeypatch.setitem(DependentGPRegressor.__init__.__kwdefaults__, name, value)
    with cut_short():
        yield


@pytest.fixture(scope="session")
def slope_std():
    """Return a function of a joint covariance and a point (d,): deviations (P, d) of slopes, by quotients."""

    def of(covariance, x, step=1e-3):
        variances = []
        for move in step * np.eye(len(x)):
            K = covariance(np.stack([x + move, x - move]))
            K = K.reshape(len(K) // 2, 2, -1, 2)
            quotient = np.array([0.5, -0.5]) / step
            variances.append(np.einsum("iaib,a,b->i", K, quotient, quotient))
        return np.sqrt(np.stack(variances, axis=-1))

    return of


@pytest.fixture(scope="session")
def manoeuvres_of():
    """Return a context in which plans choose from manoeuvres of some widths and multisines alone."""

    @contextmanager
    def manoeuvres_of(widths=(1.0,), multisines=()):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("skdgp.design._manoeuvres.WIDTHS", widths)
            patch.setattr("skdgp.design._manoeuvres.MULTISINES", multisines)
            yield

    return manoeuvres_of


@pytest.fixture
def few_manoeuvres(manoeuvres_of):
    """Let plans of pages and of the command line choose from few candidates."""
    with manoeuvres_of():
        yield


@pytest.fixture
def no_pictures(monkeypatch):
    """As where matplotlib is not installed: of pages the words alone, in a fraction of the time."""
    monkeypatch.setitem(sys.modules, "matplotlib", None)


@pytest.fixture
def no_mechanics(monkeypatch):
    """Leave trim, derivatives and simulations of identified models out: for tests of other numbers and of files."""
    monkeypatch.setattr(Identification, "mechanics", FlightMechanics())


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Return the folder of shared flights and benchmarks, or skip where it is absent."""
    if not SHARED_DATA.is_dir():
        pytest.skip(
            f"the shared flight data are not beside the project ({SHARED_DATA.name} folder absent)"
        )
    return SHARED_DATA
