"""Folders that ulog2csv of pyulog wrote are read as the ULog itself."""

import pandas as pd
import pytest
from numpy.testing import assert_allclose
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
    names = {folder: "tables", folder / "sortie_vehicle_attitude_0.csv": "sortie"}
    for given, name in names.items():
        assert read_flight(given).flight.unique().tolist() == [name]


def test_a_folder_of_two_logs_is_ambiguous(converted):
    _, folder = converted
    text = (folder / "sortie_vehicle_attitude_0.csv").read_text()
    (folder / "other_vehicle_attitude_0.csv").write_text(text)
    with pytest.raises(FlightReadError, match=r"'other_', 'sortie_'.*expected one"):
        read_flight(folder)


def test_a_log_whose_name_begins_another_is_read_alone(converted):
    """The tables of the other one, half as fast, are not its topics."""
    path, folder = converted
    for file in [*folder.iterdir()]:
        rest = file.name.removeprefix("sortie_")
        table = pd.read_csv(file)
        if rest == "airspeed_0.csv":
            table["true_airspeed_m_s"] /= 2
        table.to_csv(folder / f"sortie_2_{rest}", index=False)
    whole = read_flight(path, flight="a")
    for name, factor in (("sortie_", 1.0), ("sortie_2_", 0.5)):
        given = folder / f"{name}vehicle_attitude_0.csv"
        table = read_flight(given, flight="a", airborne=False)
        kept = table.time.isin(whole.time)
        assert_allclose(table.airspeed[kept], factor * whole.airspeed, atol=1e-3)
        assert {*inspect_log(given).topics.index} == {*inspect_log(path).topics.index}


@pytest.mark.parametrize(("left_out", "instance"), [("vehicle_angular_velocity", 0), ("none", 1)])
def test_without_a_topic_and_with_other_instances(converted, left_out, instance):
    _, folder = converted
    (folder / f"sortie_{left_out}_0.csv").unlink(missing_ok=True)
    for topic in ("vehicle_attitude", "vehicle_acceleration"):
        file = folder / f"sortie_{topic}_0.csv"
        file.rename(folder / f"sortie_{topic}_{instance}.csv")
    table = read_flight(folder)
    assert {"phi", "ax", "v_north", "airspeed"} <= {*table}
    assert ("p" in table) == (left_out == "none")


def test_other_folders_are_no_logs(tmp_path):
    assert not is_log(tmp_path)
    with pytest.raises(FlightReadError, match="folder without tables of ulog2csv"):
        read_flight(tmp_path)
