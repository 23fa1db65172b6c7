"""Time stamps: one clock for all topics; restarts found, impossible and repeated stamps left out.

Single stamps may be wrong; the median of the messages that stand together in the file hardly ever is.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from skdgp.io._autopilot.topics import Topic

BLOCK = 25
"""Messages whose median time is compared with that of the next."""
BACK = 5.0
"""A clock that goes back by more than this was set back or restarted [s]; messages out of order are not so late."""
MARGIN = 5.0
"""Stamps may lie this far outside of the medians of a part [s]."""
STEP = 60.0
"""Longest step between medians that widens this margin [s]."""


def clock_parts(topics: dict[str, Topic]) -> tuple[list[dict[str, Topic]], list[str]]:
    """Split topics where the clock was set back, and sort each part by time.

    Returns
    -------
    parts : list of dict of str to Topic
        Times strictly increasing in each topic.
    remarks : list of str
        What was wrong with the clock.
    """
    order = np.concatenate([topic.order for topic in topics.values()])
    rows = np.argsort(order, kind="stable")
    order, time = order[rows], np.concatenate([topic.time for topic in topics.values()])[rows]
    centres = _medians(time)
    edges = [0, *_restarts(time, centres), len(time)]
    parts, remarks, dropped, disordered = [], [], {}, 0
    for first, last in pairwise(edges):
        low, high = _span(_medians(time[first:last]))
        place = order[first], order[last - 1]
        part = {}
        for name, topic in topics.items():
            inside = (topic.order >= place[0]) & (topic.order <= place[1])
            believed = inside & (topic.time >= low) & (topic.time <= high)
            here = topic.taken(believed)
            disordered += int((np.diff(here.time) < 0).sum())
            here = here.taken(np.unique(here.time, return_index=True)[1])
            dropped[name] = dropped.get(name, 0) + int(inside.sum() - believed.sum())
            if len(here):
                part[name] = here
        parts.append(part)
    if len(parts) > 1:
        said = ", ".join(f"from {time[edge - 1]:.1f} s to {time[edge]:.1f} s" for edge in edges[1:-1][:4])
        remarks.append(f"the clock was set back {len(parts) - 1} times ({said}): what follows is a flight of its own")
    if any(dropped.values()):
        worst = max(dropped, key=dropped.get)
        remarks.append(
            f"{sum(dropped.values())} of {len(time)} messages have a time that cannot be ({dropped[worst]} of {worst})"
        )
    if disordered:
        remarks.append(f"{disordered} messages stand out of order in time, and were sorted")
    return parts, remarks


def _medians(time):
    """Return the median of each block of messages, (m,)."""
    whole = len(time) // BLOCK * BLOCK
    if not whole:
        return np.array([np.median(time)])
    return np.median(time[:whole].reshape(-1, BLOCK), axis=1)


def _without_outliers(centres):
    """Return the median of five neighbours, the ends repeated.

    Not ``scipy.ndimage.median_filter``: of a single value, versions 1.15.0 to 1.15.2 overwrite memory and 1.15.3
    returns 0.
    """
    return np.median(sliding_window_view(np.pad(centres, 2, mode="edge"), 5), axis=1)


def _restarts(time, centres) -> list[int]:
    """Return the messages with which a clock that was set back begins."""
    steady = _without_outliers(centres)
    found = []
    for block in np.flatnonzero(np.diff(steady) < -BACK):
        window = slice(max(block - 3, 0) * BLOCK, (block + 5) * BLOCK)
        later = np.where(time[window] > (steady[block] + steady[block + 1]) / 2, 1, -1)
        found.append(window.start + int(np.argmax(np.cumsum(later))) + 1)
    return sorted(set(found) - {len(time)})


def _span(centres):
    """Return the least and the greatest time that is believed."""
    steady = _without_outliers(centres)
    step = np.abs(np.diff(steady)).max(initial=0.0)
    margin = MARGIN + min(step, STEP)
    return steady.min() - margin, steady.max() + margin
