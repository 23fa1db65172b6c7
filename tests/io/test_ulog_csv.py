"""Folders that ulog2csv of pyulog wrote are read as the ULog itself."""

import pytest
from pandas.testing import assert_frame_equal

from skdgp.io import FlightReadError, inspect_log, is_log, read_flight


@pytest.fixture
def converted(write, px4):
    """Return a ULog and the folder of its tables."""
    convert = pytest.importorskip("pyulog.ulog2csv").convert_ulog2csv
    path = write(px4, "sortie.ulg")
    folder = path.parent / "tables"
    folder.mkdir()
    convert(str(path), None, str(folder), ",", None, None)
    return path, folder


def test_the_folder_and_a_table_in_it_are_the_log(converted):
    path, folder = converted
    assert is_log(folder)
    whole = read_flight(path, flight="a")
    for given in (folder, folder / "sortie_vehicle_attitude_0.csv"):
        assert_frame_equal(read_flight(given, flight="a"), whole, atol=1e-5)
    assert inspect_log(folder).vehicle == "fixed wing"


def test_a_folder_of_two_logs_is_ambiguous(converted):
    _, folder = converted
    text = (folder / "sortie_vehicle_attitude_0.csv").read_text()
    (folder / "other_vehicle_attitude_0.csv").write_text(text)
    with pytest.raises(FlightReadError, match=r"'other_', 'sortie_'.*expected one"):
        read_flight(folder)


def test_other_folders_are_no_logs(tmp_path):
    assert not is_log(tmp_path)
    with pytest.raises(FlightReadError):
        read_flight(tmp_path)
