"""What a log holds, and its sources and faults."""

import json

import numpy as np
import pandas as pd
import pytest
from flight_columns import EULER, FORCES, RATES, VELOCITY
from made_flights import make_flight
from numpy.random import default_rng
from numpy.testing import assert_allclose

from skdgp.identification import named_flights
from skdgp.io import FlightReadError, inspect_log, read_flight


@pytest.fixture
def whole(write, px4):
    return write(px4, "whole.ulg")


class TestSummary:
    def test_a_log_that_lacks_nothing(self, whole, px4_servos):
        summary = inspect_log(whole, servos=px4_servos)
        assert (summary.format, summary.vehicle) == ("PX4 ULog", "fixed wing")
        assert set(px4_servos) < set(summary.columns.index)
        assert summary.remarks == ()
        (flight,) = summary.flights.itertuples()
        time = read_flight(whole).time
        assert (flight.begin, flight.end) == (time.iloc[0], time.iloc[-1])
        assert_allclose(flight.airspeed, 18, rtol=0, atol=1)
        rates = summary.columns["rate"]
        assert_allclose(rates["p"], 200, rtol=1e-3)
        assert_allclose(rates["altitude"], 10, rtol=1e-3)
        assert_allclose(summary.topics.loc["vehicle_acceleration", "rate"], 100, rtol=1e-3)
        physics = summary.columns["physics"]
        assert set(physics[[*EULER, "q"]]) == {"confirmed"}
        assert physics["rudder"] == ""

    def test_a_multicopter_is_called_one(self, write, ulog):
        t = np.arange(0, 20, 0.02)
        quad = write(ulog(MAV_TYPE=2).gyros(t, np.sin(t)))
        refusal = inspect_log(quad).remarks[-1]
        assert "a multicopter, but expected a fixed wing" in refusal
        assert "airborne" not in refusal
        for airborne in (True, False):
            with pytest.raises(
                FlightReadError, match="a log of a multicopter, but expected a fixed wing"
            ):
                read_flight(quad, airborne=airborne)

    def test_one_elevon_alone(self, write):
        """A sign that it might have does not need the other one."""
        levels = {"alpha q elevon_left": (0, 0.1, 0), "airspeed": (30.5, 0.1, 0)}
        table = make_flight(levels, 50, 0.02)
        table.loc[::10, "airspeed"] = -999.0  # marks of missing values
        summary = inspect_log(write(table))
        assert "elevon_left" in summary.columns.index
        assert 30 < summary.flights.airspeed.item() < 31

    def test_the_faults_of_a_table_at_its_own_times(self, write):
        table = make_flight({"alpha": (0.1, 0.0, 0.01)}, 500, 0.02).assign(flight="a")
        table["time"] += 1.7e9
        table.loc[200:260, "alpha"] = table.alpha[200]
        summary = inspect_log(write(table))
        (remark,) = summary.remarks
        assert "flight a: alpha is stuck at" in remark
        assert "(1700000004.02 to 1700000005.20 s, 60 samples)" in remark
        assert remark[:30] in str(summary)

    def test_a_slow_flight_among_faster_ones(self, write):
        slow, fast = (make_flight({"airspeed": (20, 1, 0.1)}, n, 25 / n) for n in (100, 500))
        both = pd.concat([slow.assign(flight="slow"), fast.assign(flight="fast")])
        (remark,) = inspect_log(write(both)).remarks
        assert "only 4 rows a second" in remark


def test_what_was_not_measured_contradicts_nothing(write, flight):
    """Of a sound flight: the IMU ends at 27 s, and its columns are zero from there."""
    time = flight.time(50)
    names = [*RATES, *FORCES, *EULER, *VELOCITY]
    table = pd.DataFrame(flight.at(time, *names), columns=names)
    table += default_rng(0).normal(0, 0.003, table.shape)
    table.loc[time > 27, names[:6]] = 0.0
    remarks = inspect_log(write(table.assign(time=time))).remarks
    assert [remark.split()[2] for remark in remarks] == names[:6]
    assert all("is stuck at 0 " in remark for remark in remarks)


class TestCommand:
    def test_json(self, command, whole, capsys):
        assert command(["inspect", whole, "--json"]) == 0
        assert json.loads(capsys.readouterr().out)["vehicle"] == "fixed wing"

    def test_identify_reads_logs_by_the_servo_file_and_tables_without_it(
        self, whole, px4_servos, tmp_path
    ):
        table = tmp_path / "table.csv"
        table.write_text("time,alpha\n0,0\n0.1,0\n")
        flights = named_flights([whole, table], servos=px4_servos)
        assert set(px4_servos) <= set(flights["whole"].table.columns)
        assert set(flights["table"].table.columns) == {"time", "flight", "alpha"}

    def test_identify_is_told_what_of_a_log_is_a_flight(self, command, whole, tmp_path, capsys):
        for airborne in (True, False):
            flight = named_flights([whole], airborne=airborne)["whole"]
            assert len(flight.table) == len(read_flight(whole, airborne=airborne)) > 0
        sizes = ["--mass", "3", "--span", "1.8", "-o", tmp_path / "out"]
        assert command(["identify", whole, *sizes]) == 1
        assert "CA_SV_CSn_TRQ_R" in capsys.readouterr().err
        sizes += ["--airborne", "300", "--regressors", "alpha,q_hat"]
        assert command(["identify", whole, *sizes]) == 1
        assert "--airborne all" in capsys.readouterr().err
        assert not (tmp_path / "out").exists()


@pytest.fixture
def bench(write, dataflash):
    """Return a log of a bench: the safety switch is on, so no pulses go out; nothing blows into the pitot tube."""
    time = 0.04 * np.arange(500)
    log = dataflash("ArduPlane V4.0.6 (abcdef01)", SERVO2_FUNCTION=19.0)
    log.gyros(time, 0.0, I=("B", 0), AccX=0.0, AccY=0.0, AccZ=-9.8)
    log.topic("ARSP", time, I=("B", 0), Airspeed=1.0, H=("B", 0), U=("B", 1))
    log.topic("AETR", time, Elev=("h", 4500 * np.sin(time)))
    log.topic("RCOU", time, C2=("H", 0))
    return write(log, "bench.bin")


def test_an_airspeed_that_is_never_valid(bench):
    summary = inspect_log(bench)
    assert "neither a valid airspeed nor a ground speed" in summary.remarks[-1]
    assert any(
        "airspeed of ARSP: 100 % of the messages are left out, as the log calls them no measurement"
        in remark
        for remark in summary.remarks
    )


def test_servos_that_were_switched_off(bench):
    pulses = {"elevator": {"channel": "RCOU.C2", "points": [[1100, -0.35], [1900, 0.35]]}}
    said = inspect_log(bench, servos=pulses).remarks
    assert "RCOU.C2 sends no pulse, so there is no elevator" in said
    commands = {"elevator": {"channel": "AETR.Elev", "points": [[-4500, 0.35], [4500, -0.35]]}}
    elevator = inspect_log(bench, servos=commands).columns.loc["elevator"]
    assert_allclose(elevator["rate"], 25, rtol=0.01)


def test_a_flight_that_is_in_a_table_twice(write):
    """As where one was downloaded again, on another clock."""
    time = 0.05 * np.arange(800)
    noise = 0.1 * default_rng(0).normal(size=(800, 6))
    monday = pd.DataFrame(noise, columns=[*RATES, *FORCES]).assign(time=time, flight="monday")
    tuesday = monday.assign(time=time + 1000.0, flight="tuesday")
    remarks = inspect_log(write(pd.concat([monday, tuesday]), "twice.csv")).remarks
    assert any("'tuesday' repeats flight 'monday'" in remark for remark in remarks)
