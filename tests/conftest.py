"""What every test may ask for."""

import os
import signal
import tempfile
import time
from contextlib import contextmanager
from functools import lru_cache, partial
from pathlib import Path

import joblib
import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from hypothesis.configuration import set_hypothesis_home_dir
from threadpoolctl import threadpool_limits

from skdgp import DependentGPRegressor, datasets, design
from skdgp._cli import _learn, _use
from skdgp._compute.findings import Code, Finding
from skdgp._regressor import RegressorSettings
from skdgp.datasets import _example_flights
from skdgp.identification import _identification
from skdgp.inference import SearchSettings, _optimizer
from skdgp.report import FlightMechanics

os.environ.setdefault(
    "OPENBLAS_NUM_THREADS", "1"
)  # of processes that tests start, as _threads below for this one

MINUTE = 60.0  # of the example flights [s]
SHARED_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"

set_hypothesis_home_dir(
    Path(tempfile.gettempdir()) / "hypothesis"
)  # nothing is written beside the tests
settings.register_profile(
    "skdgp",
    derandomize=True,
    deadline=None,
    database=None,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("skdgp")

if (
    signal.getsignal(signal.SIGINT) is signal.SIG_IGN
):  # as in the background of a shell: tests press Ctrl-C
    signal.signal(signal.SIGINT, signal.default_int_handler)

collect_ignore = ["benchmarks"]  # scripts, which find each other only when they are run


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
def one_thread():
    """Hold BLAS, and with it the package, to one thread: evaluations come one after another, and can be counted."""
    with threadpool_limits(1):
        yield


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


@pytest.fixture(scope="session", autouse=True)
def _flown_once(once):
    """Let all processes of a test run share the example flights: to simulate them takes 10 s.

    A shorter flight is the beginning of the long one (test_example_flights), and is taken from it.
    """
    fly_here = _example_flights._flights.__wrapped__

    def fly(*how):
        name = "flown " + " ".join(map(str, how))
        return joblib.load(
            once(name, lambda folder: joblib.dump(fly_here(*how), folder / "flights")) / "flights"
        )

    whole = lru_cache(maxsize=1)(fly)

    def flights(*world, duration=_example_flights.DURATION):
        if world != (0, 1.0, 1.0) or duration == MINUTE:
            return fly(*world, duration)
        train, test = whole(*world)
        return train[train["time"] < duration].reset_index(drop=True), test[test["time"] < duration]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(_example_flights, "_flights", flights)
        yield flights


@pytest.fixture(scope="session")
def first_minute(_flown_once):
    """Return `load_example_flights` of the first minute alone, flown in a third of the time."""
    load = datasets.load_example_flights

    def first_minute(**options):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(_example_flights, "_flights", partial(_flown_once, duration=MINUTE))
            return load(**options)

    return first_minute


@pytest.fixture
def short_flights(monkeypatch, request, first_minute):
    """Let pages, examples and the command ``demo`` have the first 25 s of each example flight, or other rows."""
    n_rows = getattr(request, "param", 1000)

    def first(**options):
        data = first_minute(**options)
        data.train = data.train.groupby("flight", observed=True).head(n_rows)
        data.test = data.test.head(n_rows)
        return data

    for module in (datasets, _learn):
        monkeypatch.setattr(module, "load_example_flights", first)


@pytest.fixture(scope="session")
def cut_short():
    """Return a context, for fixtures that tests share, that cuts short what ``max_iter`` does not rule.

    Fits of each output alone, one search from one width, few rows: for tests of what is done with a model,
    whatever it learned.
    """

    @contextmanager
    def cut_short():
        with pytest.MonkeyPatch.context() as patch:
            search = SearchSettings(
                values=(300, 300), width_factors=(1.0,), trial_iterations=2, single_iterations=2
            )
            settings = RegressorSettings(n_searches=1, search=search)
            patch.setattr(DependentGPRegressor, "settings", settings)
            yield

    return cut_short


@pytest.fixture
def short_fits(cut_short):
    """Fit as in `cut_short` in one test."""
    with cut_short():
        yield


@pytest.fixture
def hasty_fits(monkeypatch, short_fits, request):
    """Stop every search of this process after two iterations, or another number; few inducing inputs, no average.

    For pages and commands that only use what was learned.
    """
    minimize, most = _optimizer.minimize, getattr(request, "param", 2)

    def hasty(*args, options, **more):
        return minimize(*args, options=options | {"maxiter": min(most, options["maxiter"])}, **more)

    monkeypatch.setattr(_optimizer, "minimize", hasty)
    for name, value in {"n_inducing": 24, "structure": "joint"}.items():
        monkeypatch.setitem(DependentGPRegressor.__init__.__kwdefaults__, name, value)


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


@pytest.fixture
def few_manoeuvres(monkeypatch):
    """Let plans of pages and of the command line choose from few candidates."""
    few = design.PlanSettings(widths=(1.0,), multisines=())
    plan = partial(design.plan, settings=few)
    monkeypatch.setattr(design, "plan", plan)
    monkeypatch.setattr(_use, "plan_flight", plan)


@pytest.fixture
def no_mechanics(monkeypatch):
    """Leave trim, derivatives and simulations of identified models out: for tests of other numbers and of files."""
    left_out = Finding(Code.NO_DERIVATIVES, numbers={"error": "left out"})
    monkeypatch.setattr(
        _identification, "flight_mechanics", lambda *_: FlightMechanics(notes=(left_out,))
    )


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Return the folder of shared flights and benchmarks, or skip where it is absent."""
    if not SHARED_DATA.is_dir():
        pytest.skip(
            f"the shared flight data are not beside the project ({SHARED_DATA.name} folder absent)"
        )
    return SHARED_DATA
