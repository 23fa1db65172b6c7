"""The kernels of the page kernels.md pass every test of the contract."""

import importlib.util
import re
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from skdgp.kernels import prior_paths

HERE = Path(__file__).parent
PAGE = HERE.parents[1] / "docs" / "kernels.md"
NAMES = ["four methods, of the page", "trend of the page"]


def module(name, path):
    spec = importlib.util.spec_from_file_location(name, path)
    made = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(made)
    return made


def kernels_of_the_page():
    """The classes of its code, as a module, since instances are pickled by the name of their class."""
    blocks = re.findall(
        r"^```python\n(.*?)^```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE
    )
    made = sys.modules.setdefault("kernels_of_the_page", ModuleType("kernels_of_the_page"))
    for code in blocks:
        if "\nclass " in code:
            exec(compile(code, PAGE.name, "exec"), vars(made))
    rng = np.random.default_rng(0)
    P, d, n = 3, 2, 2
    scales = rng.uniform(0.5, 2, P), rng.uniform(0.5, 2, (P, 2 * n * d))
    return [
        made.SharedMatern(rng.normal(size=P), rng.uniform(0.7, 1.6, d)),
        made.PeriodicTrend(n, *scales, center=rng.normal(size=2 * n * d)),
    ]


contract = module("contract_of_kernels", HERE / "test_contract.py")
contract.KERNELS.update(zip(NAMES, kernels_of_the_page(), strict=True))


class TestContractOfThePage(contract.TestContract):
    @pytest.fixture(params=NAMES)
    def name(self, request):
        return request.param

    @pytest.fixture
    def kernel(self, name):
        return contract.KERNELS[name]


def test_a_whole_turn_changes_nothing():
    kernel = contract.KERNELS["trend of the page"]
    X = np.random.default_rng(1).normal(size=(4, 2))
    np.testing.assert_allclose(kernel(X, X + 2 * np.pi), kernel(X), atol=1e-12)


def test_paths_that_a_kernel_lacks_are_said_to_be_missing():
    with pytest.raises(NotImplementedError, match="sample_y"):
        prior_paths(contract.KERNELS["four methods, of the page"], 1, 4, None)
