"""What every test may ask for."""

from pathlib import Path

import pytest

SHARED_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Return the folder of shared flights and benchmarks, or skip where it is absent."""
    if not SHARED_DATA.is_dir():
        pytest.skip(f"the shared flight data are not beside the project ({SHARED_DATA.name} folder absent)")
    return SHARED_DATA
