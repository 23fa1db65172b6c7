"""The pages say what is true: their code runs, their names exist, their links lead somewhere."""

import importlib
import inspect
import re
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from skdgp._flight.channels import CHANNELS
from skdgp.datasets import _example_flights
from skdgp.datasets._brumby import REGRESSORS, brumby_coefficients, brumby_derivatives
from skdgp.dynamics import Aerodynamics, stability_derivatives

ROOT = Path(__file__).resolve().parents[1]
KNOWN = Aerodynamics(
    brumby_coefficients,
    [name if CHANNELS[name].unit == "rad" else f"{name}_hat" for name in REGRESSORS],
    gradient=brumby_derivatives,
)
"""The example aircraft as it is."""
RUN_ELSEWHERE = {
    "README.md": "test_docs.py",  # its code is judged below
    # its code needs jsbsim, or a model: export/portable/test_command.py
    "export.md": "export/test_jsbsim.py",
    "identification.md": "cli/test_identify.py",  # its code reads logs, which that test lays ready
    "logs.md": "io/test_page.py",  # its code reads a log, which that test lays ready
    "scaling.md": "compute/test_dask.py",  # its code needs dask.distributed
}
UNJUDGED = {"ten_minutes.md"}  # what their models learned matters little: short fits do
SHORT = {"ten_minutes.md"}  # and short flights
SECONDS = {
    "preprocessing.md": 40.0,
    "simulation.md": 90.0,
    "design.md": 60.0,
}  # of flights, as far as pages use them
PAGES = [
    path for path in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))) if path.is_file()
]


def blocks(page, language="python"):
    return re.findall(
        rf"^```{language}\n(.*?)^```",
        page.read_text(encoding="utf-8"),
        flags=re.DOTALL | re.MULTILINE,
    )


RUN_HERE = [page for page in PAGES if blocks(page) and page.name not in RUN_ELSEWHERE]


@pytest.mark.parametrize("page", RUN_HERE, ids=lambda page: page.name)
def test_code_of_the_page_runs_from_top_to_bottom(page, tmp_path, monkeypatch, request):
    """In one namespace, in an empty folder; what a page writes, it writes there."""
    if page.name in UNJUDGED:
        request.getfixturevalue("hasty_fits")
        request.getfixturevalue("no_mechanics")
    if page.name in SHORT:
        request.getfixturevalue("short_flights")
    if page.name == "design.md":
        request.getfixturevalue("few_manoeuvres")
    if page.name in SECONDS:
        made = partial(_example_flights._flights, duration=SECONDS[page.name])
        monkeypatch.setattr(_example_flights, "_flights", made)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    names = {}
    for number, block in enumerate(blocks(page), start=1):
        exec(compile(block, f"{page.name}, block {number}", "exec"), names)
    if "matplotlib" in page.read_text(encoding="utf-8"):
        plt = pytest.importorskip("matplotlib.pyplot")
        plt.close("all")


@pytest.mark.usefixtures("short_flights", "hasty_fits")
@pytest.mark.parametrize(("short_flights", "hasty_fits"), [(800, 6)], indirect=True)
def test_front_page_shows_the_known_derivatives(capsys):
    """What its code prints, of the first 20 s of each flight, and what its text says that it prints."""
    page, names = ROOT / "README.md", {}
    (code,) = blocks(page)
    exec(compile(code, page.name, "exec"), names)
    printed = re.findall(r"^(C\w+_\w+) +(\S+) +(\S+)$", capsys.readouterr().out, re.MULTILINE)
    known = stability_derivatives(KNOWN, names["aircraft"], names["point"])["value"]
    assert len(printed) == 3
    for name, value, std in printed:
        assert abs(float(value) - known[name]) < 2 * float(std) < 0.4 * abs(known[name]), name
    (text,) = re.findall(
        r"^The known derivatives .*$", page.read_text(encoding="utf-8"), re.MULTILINE
    )
    known_words, found_words = text.split("The model finds")
    stated = [float(word) for word in re.findall(r"-?\.\d+", known_words)]
    assert stated == pytest.approx([known[name] for name, *_ in printed], rel=0.03)
    found = [
        (float(value), float(std)) for value, std in re.findall(r"(-?\.\d+) ± (\.\d+)", found_words)
    ]
    for truth, (value, std) in zip(stated, found, strict=True):
        assert abs(value - truth) < 2 * std < 0.4 * abs(truth)


def test_code_of_every_page_runs_somewhere():
    assert len(RUN_HERE) >= 7
    for page, runner in RUN_ELSEWHERE.items():
        assert page in (ROOT / "tests" / runner).read_text(encoding="utf-8")


def found_on_pages(pattern):
    """Return (page, match) of every match of a pattern."""
    return [
        (page, found)
        for page in PAGES
        for found in set(re.findall(pattern, page.read_text(encoding="utf-8")))
    ]


def test_links_between_pages_lead_somewhere():
    links = found_on_pages(r"\]\(([^)#\s]+)(?:#[^)]*)?\)")
    inside = [
        (page, target)
        for page, target in links
        if "://" not in target and not target.startswith("mailto:")
    ]
    assert [
        (page.name, target) for page, target in inside if not (page.parent / target).exists()
    ] == []


def test_skdgp_names_on_pages_exist():
    """Every dotted name in backticks that begins with skdgp."""
    for page, name in found_on_pages(r"`(skdgp(?:\.\w+)+)[`(]"):
        module, _, attribute = name.rpartition(".")
        try:
            importlib.import_module(name)
        except ImportError:
            assert hasattr(importlib.import_module(module), attribute), (
                f"{page.name} speaks of {name}"
            )


class TestNotation:
    page = ROOT / "docs" / "notation.md"

    @pytest.fixture
    def rows(self):
        """Cells of each table row, by heading."""
        found, heading = {}, None
        for line in self.page.read_text(encoding="utf-8").splitlines():
            if line.startswith("## "):
                heading = line[3:]
            elif line.startswith("|") and not set(line) <= set("|-: "):
                found.setdefault(heading, []).append(
                    [c.strip() for c in re.split(r"(?<!\\)\|", line)[1:-1]]
                )
        return {heading: cells[1:] for heading, cells in found.items()}

    def test_columns_of_a_flight_table_are_the_vocabulary_with_unit_and_meaning(self, rows):
        expected = [
            [f"`{name}`", channel.unit or "-", channel.meaning]
            for name, channel in CHANNELS.items()
        ]
        assert [row[:3] for row in rows["Columns of a flight table"]] == expected

    def test_every_code_name_exists(self, rows):
        from skdgp import DependentGPRegressor
        from skdgp.dynamics import Aircraft
        from skdgp.inference import Data, ExactPosterior
        from skdgp.kernels import ConvolvedGaussian, Features, LinearTrend, MultiOutputKernel

        x = np.linspace(0, 1, 8)[:, None]
        fitted = DependentGPRegressor(structure="joint", max_iter=1).fit(x, np.hstack([x, x**2]))
        things = {
            "DependentGPRegressor": fitted,
            "ConvolvedGaussian": fitted.kernel_.stationary_part(),
            "LinearTrend": fitted.kernel_.k1,
            "ExactPosterior": fitted.posterior_,
            "MultiOutputKernel": MultiOutputKernel,
            "Features": Features,
            "Data": Data,
            "Aircraft": Aircraft,
        }
        assert isinstance(things["ConvolvedGaussian"], ConvolvedGaussian)
        assert isinstance(things["LinearTrend"], LinearTrend)
        assert isinstance(things["ExactPosterior"], ExactPosterior)
        named = re.findall(r"`([A-Z]\w+)\.(\w+)`", self.page.read_text(encoding="utf-8"))
        assert len(named) > 30
        for thing, name in named:
            fields = getattr(things[thing], "__annotations__", {})
            assert hasattr(things[thing], name) or name in fields, f"{thing}.{name}"

    def test_shapes_are_as_stated(self):
        from skdgp import DependentGPRegressor
        from skdgp.kernels import inducing_features

        rng = np.random.default_rng(0)
        n, d, P = 12, 3, 2
        M = 2 + P
        X, Y = rng.normal(size=(n, d)), rng.normal(size=(n, P))
        for kind, A in (("diag", (M, P, d)), ("full", (M, P, d, d))):
            options = {"structure": "joint", "max_iter": 1, "random_state": 0}
            model = DependentGPRegressor(n_latent=2, covariance_type=kind, **options).fit(X, Y)
            kernel, trend = model.kernel_.stationary_part(), model.kernel_.k1
            assert kernel.A.shape == A
            assert kernel.v.shape == kernel.amplitude.shape == (M, P)
            assert kernel.mu.shape == kernel.length_scale.shape == (M, P, d)
            assert trend.intercept_scale.shape == (P,)
            assert trend.slope_scale.shape == (P, d)
            assert trend.center.shape == (d,)
            assert model.posterior_.L.shape == (n * P, n * P)
            assert model.posterior_.alpha.shape == (n * P,)
            assert model.predict_gradient(X).shape == (n, P, d)
            assert [z.shape for z in inducing_features(kernel, X[:5]).Z] == [(5, d)] * M
        assert np.shape(kernel.shear) == (M, P, d * (d - 1) // 2)


def test_limits_on_the_page_are_those_of_the_code():
    from skdgp._compute.linalg import JITTER_FIRST, JITTER_LAST
    from skdgp._regressor._estimator import EXACT_LIMIT, LOG_LIMIT

    text = (ROOT / "docs" / "inference.md").read_text(encoding="utf-8")
    assert f"Above {EXACT_LIMIT} observed values, {LOG_LIMIT} of a log" in text
    assert f"by {JITTER_FIRST:.0e} of its".replace("e-0", "e-") in text
    assert f"up to {JITTER_LAST:.0e}".replace("e-0", "e-") in text


def test_every_part_of_the_house_is_on_its_page():
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    rooms = [
        path
        for path in (ROOT / "skdgp").iterdir()
        if path.suffix == ".py" or any(path.glob("*.py"))
    ]
    parts = {path.name.removesuffix(".py") for path in rooms}
    missing = [part for part in parts if f"`{part}`" not in text]
    assert missing == []


def test_every_public_estimator_and_kernel_is_on_a_page():
    text = "\n".join(page.read_text(encoding="utf-8") for page in PAGES)
    for module in (
        "skdgp",
        "skdgp.kernels",
        "skdgp.inference",
        "skdgp.preprocessing",
        "skdgp.dynamics",
    ):
        for name in importlib.import_module(module).__all__:
            obj = getattr(importlib.import_module(module), name)
            if inspect.isclass(obj) and name not in ("Fit", "Optimum", "Sum"):
                assert name in text, f"{module}.{name} is on no page"
