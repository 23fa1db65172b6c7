import pytest

from skdgp.datasets import load_example_flights


@pytest.fixture(scope="session")
def data():
    return load_example_flights()


@pytest.fixture(scope="session")
def flights(data):
    """Every flight as its own table: lateral, latlon, two_altitudes."""
    train = {str(name): table for name, table in data.train.groupby("flight", observed=True)}
    return train | {"two_altitudes": data.test}
