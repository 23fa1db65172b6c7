"""The kernel of the page kernels.md passes every test of the contract."""

import importlib.util
from pathlib import Path

import pytest
from numpy.random import default_rng

NAME = "five methods, of the page"
spec = importlib.util.spec_from_file_location(
    "contract_of_kernels", Path(__file__).with_name("test_contract.py")
)
contract = importlib.util.module_from_spec(spec)
spec.loader.exec_module(contract)
gradient_by_differences = contract.gradient_by_differences  # a fixture


class TestContractOfThePage(contract.TestContract):
    @pytest.fixture
    def name(self):
        return NAME

    @pytest.fixture
    def kernel(self, name, kernel_of_the_page):
        rng = default_rng(0)
        made = kernel_of_the_page(rng.normal(size=3), rng.uniform(0.7, 1.6, 2))
        return contract.KERNELS.setdefault(name, made)
