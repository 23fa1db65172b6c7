"""Reader of logs of PX4 that ulog2csv of pyulog converted: a folder of one table for each topic and instance."""

from __future__ import annotations

import glob
import re
from dataclasses import replace
from pathlib import Path

import pandas as pd

from skdgp.io._log import Log, Topic, instance_name, numeric_fields
from skdgp.io._tables import FlightReadError
from skdgp.io._ulog import NAMING, px4_log, sampled

# one of these topics is in every log of a flight, and no other topic's name ends so: what stands
# before it is the log's name
ANCHORS = (
    "vehicle_attitude", "vehicle_angular_velocity", "vehicle_acceleration", "sensor_combined",
    "vehicle_local_position", "vehicle_global_position", "vehicle_gps_position",
    "estimator_attitude", "estimator_local_position",
)  # fmt: skip
ANCHOR = re.compile(rf"(.+_)?({'|'.join(ANCHORS)})_\d+\.csv")
TOPIC = re.compile(r"(.+)_(\d+)\.csv")


def is_ulog_csv(path: Path) -> bool:
    """Return whether this is a folder with tables of ulog2csv, or the table of one of the anchors."""
    if path.is_dir():
        return bool(_anchors(path))
    return ANCHOR.fullmatch(path.name) is not None


def _anchors(folder: Path) -> dict[str, str]:
    """Return a table of an anchor of each log in a folder, by what stands before the names of its topics."""
    anchors: dict[str, str] = {}
    for file in sorted(folder.iterdir()):
        match = ANCHOR.fullmatch(file.name)
        if match:
            anchors.setdefault(match[1] or "", file.name)
    return anchors


def read_ulog_csv(path: Path) -> Log:
    """Return the log in a folder, or the one that a table is of; raise FlightReadError if there are several."""
    folder = path if path.is_dir() else path.parent
    anchors = _anchors(folder)
    match = ANCHOR.fullmatch(path.name)
    if not match and len(anchors) > 1:
        raise FlightReadError(
            f"Got a folder with the logs {list(anchors)}, but expected one: give its file "
            f"{next(iter(anchors.values()))} or move it to a folder of its own."
        )
    log = (match[1] or "") if match else next(iter(anchors))
    others = tuple(prefix for prefix in anchors if len(prefix) > len(log))
    topics = {}
    for file in sorted(folder.glob(f"{glob.escape(log)}*.csv")):
        found = TOPIC.fullmatch(file.name.removeprefix(log))
        if found and not file.name.startswith(others):
            name, number = found.groups()
            topic = _topic(name, file)
            if topic is not None:
                topics[instance_name(name, int(number))] = topic
    converted = px4_log(topics, {}, kind="PX4 ULog as CSV", firmware="PX4")
    return replace(converted, naming=f"{NAMING} (ulog2csv writes no parameters: read the .ulg)")


def name_of_log(path: Path) -> str:
    """Return the name of a log: what stands before a table's topic, else the folder's."""
    match = ANCHOR.fullmatch(path.name)
    if match is None:
        return path.name
    return match[1].removesuffix("_") if match[1] else path.parent.name


def _topic(name: str, file: Path) -> Topic | None:
    """Return the messages of a topic; None of an empty table, or one without time."""
    try:
        table = pd.read_csv(file)
    except pd.errors.EmptyDataError:
        return None
    except (ValueError, UnicodeDecodeError) as error:
        raise FlightReadError(
            f"Got {file.name} that cannot be read, but expected a table of ulog2csv: {error}"
        ) from error
    if "timestamp" not in table or table.empty:
        return None
    fields = numeric_fields({str(column): table[column].to_numpy() for column in table})
    if "timestamp" not in fields:
        return None
    # in one file each: the places among other topics follow from the times of publication
    return Topic(sampled(name, fields) * 1e-6, fields["timestamp"] * 1e-6, fields)
