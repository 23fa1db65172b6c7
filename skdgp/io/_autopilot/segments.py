"""Detection of the segments of a log that are flight."""

from __future__ import annotations

import numpy as np
import pandas as pd

from skdgp.io._autopilot.rules import LANDED, SLOWEST_AIRSPEED
from skdgp.io._autopilot.topics import Log, Topic

SHARE, USUAL = 0.7, 8.0
"""Airborne above this share of the slowest airspeed set on the autopilot; if none is set, above this [m/s]."""
DIP, SHORTEST = 2.0, 5.0
"""Slower for less than this is still flight [s]; faster for less than this is none [s]."""
EDGE = 1.0
"""Channels begin and end within this of each other [s]."""
NOT_FLYING_ON_WINGS = ("multicopter", "rover", "boat", "submarine", "antenna tracker")


def threshold(log: Log, airborne) -> float:
    """Return the airspeed [m/s] above which the aircraft is airborne."""
    if airborne is not True:
        return float(airborne)
    speeds = [log.parameters.get(name, np.nan) for name in SLOWEST_AIRSPEED.get(log.kind, ())]
    return next((SHARE * speed for speed in speeds if 0 < speed < 200), USUAL)


def find_segments(table: pd.DataFrame, log: Log, topics: dict[str, Topic], speed: float) -> list[slice]:
    """Return the rows of each flight: airspeed above a speed, and not on the ground where the autopilot tells.

    Without an airspeed the speed over ground is taken, unless the vehicle has no wings.
    """
    fast = _speed(table, log) > speed
    landed = _landed(table["time"].to_numpy(), log, topics)
    if landed is not None:
        fast &= ~landed
    time = table["time"].to_numpy()
    runs = _runs(fast, time)
    joined = runs[:1]
    for a, b in runs[1:]:
        if time[a] - time[joined[-1][1] - 1] < DIP:
            joined[-1][1] = b
        else:
            joined.append([a, b])
    return [slice(a, b) for a, b in joined if time[b - 1] - time[a] >= SHORTEST]


def trimmed(flight: pd.DataFrame) -> pd.DataFrame:
    """Return a flight without rows at its ends, up to a second of them, where slow channels have no value."""
    time, known = flight["time"].to_numpy(), flight.notna().to_numpy()
    known = known[:, known.any(axis=0)]
    begins, ends = time[known.argmax(axis=0)], time[len(time) - 1 - known[::-1].argmax(axis=0)]
    begin = begins[begins <= time[0] + EDGE].max()
    end = ends[ends >= time[-1] - EDGE].min()
    return flight[(time >= begin) & (time <= end)]


def no_flight_because(table: pd.DataFrame, log: Log, speed: float) -> str:
    """Return why a log holds no flight."""
    reasons = []
    if log.vehicle in NOT_FLYING_ON_WINGS:
        reasons.append(f"the vehicle is a {log.vehicle}")
    if "airspeed" not in table:
        reasons.append("there is no valid airspeed")
    highest = np.nanmax(_speed(table, log), initial=-np.inf)
    if np.isfinite(highest):
        what = "airspeed" if "airspeed" in table else "ground speed"
        reasons.append(f"{what} never stays above {speed:.3g} m/s in the air (highest {highest:.3g} m/s)")
    return ", ".join(reasons)


def _speed(table, log):
    if "airspeed" in table:
        return table["airspeed"].to_numpy()
    velocity = [name for name in ("v_north", "v_east") if name in table]
    if len(velocity) < 2 or log.vehicle in NOT_FLYING_ON_WINGS:
        return np.full(len(table), np.nan)
    return np.hypot(*table[velocity].to_numpy().T)


def _landed(time, log, topics):
    """Return whether the autopilot took itself for landed, (n,), or None where it does not tell."""
    name, field, value = LANDED.get(log.kind, ("", "", 0.0))
    topic = topics.get(name)
    if topic is None or field not in topic:
        return None
    last = np.searchsorted(topic.time, time, side="right") - 1
    return (topic[field] == value)[np.maximum(last, 0)]


def _runs(fast, time):
    """Return first and past-last rows of runs without a leap of time."""
    begins = fast & ~np.r_[False, fast[:-1] & (np.diff(time) < DIP)]
    ends = fast & np.r_[begins[1:] | ~fast[1:], True]
    return [[int(a), int(b) + 1] for a, b in zip(np.flatnonzero(begins), np.flatnonzero(ends), strict=True)]
