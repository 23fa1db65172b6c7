import pytest

from skdgp.datasets import load_example_flights


@pytest.fixture(scope="session")
def data():
    return load_example_flights(duration=60.0)
