"""The kernel of the page kernels.md passes every test of the contract."""

import importlib.util
import re
import sys
from pathlib import Path
from types import ModuleType

import pytest
from numpy.random import default_rng

HERE = Path(__file__).parent
PAGE = HERE.parents[1] / "docs" / "kernels.md"
NAME = "five methods, of the page"


def module(name, path):
    spec = importlib.util.spec_from_file_location(name, path)
    made = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(made)
    return made


def kernel_of_the_page():
    """The class of its code, in a module, since instances are pickled by the name of their class."""
    blocks = re.findall(
        r"^```python\n(.*?)^```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE
    )
    made = sys.modules.setdefault("kernels_of_the_page", ModuleType("kernels_of_the_page"))
    for code in blocks:
        if "\nclass " in code:
            exec(compile(code, PAGE.name, "exec"), vars(made))
    rng = default_rng(0)
    return made.SharedMatern(rng.normal(size=3), rng.uniform(0.7, 1.6, 2))


contract = module("contract_of_kernels", HERE / "test_contract.py")
contract.KERNELS[NAME] = kernel_of_the_page()
gradient_by_differences = contract.gradient_by_differences  # a fixture


class TestContractOfThePage(contract.TestContract):
    @pytest.fixture(params=[NAME])
    def name(self, request):
        return request.param

    @pytest.fixture
    def kernel(self, name):
        return contract.KERNELS[name]
