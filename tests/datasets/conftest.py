import pytest


@pytest.fixture(scope="session")
def data(first_minute):
    return first_minute()
