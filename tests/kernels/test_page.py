"""The kernel of the page adding.md passes every test of the contract."""

import importlib.util
import re
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

HERE = Path(__file__).parent
PAGE = HERE.parents[1] / "docs" / "adding.md"
NAME = "the kernel of the page"


def module(name, path):
    spec = importlib.util.spec_from_file_location(name, path)
    made = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(made)
    return made


def kernel_of_the_page():
    """Its first block of code, as a module, since instances are pickled by the name of their class."""
    code = re.search(r"^```python\n(.*?)^```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)[1]
    made = sys.modules.setdefault("kernel_of_the_page", ModuleType("kernel_of_the_page"))
    exec(compile(code, PAGE.name, "exec"), vars(made))
    rng = np.random.default_rng(0)
    P, d, n = 3, 2, 2
    return made.PeriodicTrend(
        n, rng.uniform(0.5, 2, P), rng.uniform(0.5, 2, (P, 2 * n * d)), center=rng.normal(size=2 * n * d)
    )


contract = module("contract_of_kernels", HERE / "test_contract.py")
contract.KERNELS[NAME] = kernel_of_the_page()


class TestContractOfThePage(contract.TestContract):
    @pytest.fixture
    def name(self):
        return NAME

    @pytest.fixture
    def kernel(self):
        return contract.KERNELS[NAME]


def test_a_whole_turn_changes_nothing():
    kernel = contract.KERNELS[NAME]
    X = np.random.default_rng(1).normal(size=(4, 2))
    np.testing.assert_allclose(kernel(X, X + 2 * np.pi), kernel(X), atol=1e-12)
