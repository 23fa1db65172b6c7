"""Samples in the page: what comes out is what went in."""

import base64
import json
import zlib

import numpy as np
import pytest

from skdgp.report._figures import LEVELS, Panel, Series, chart, pack, thinned


def unpacked(scale, data):
    """Undo the packing, from its description."""
    low, step, size = scale
    planes = np.frombuffer(data, np.uint8).reshape(size, -1).astype(np.int64)
    count = np.cumsum(256 ** np.arange(size) @ planes) % 256**size
    return np.where(count == 0, np.nan, low + (count - 1) * step)


@pytest.mark.parametrize(
    "values",
    [
        np.random.default_rng(0).normal(size=500).cumsum(),
        np.array([-1e-9, 3e-9, np.nan, 2e-9]),
        np.array([np.nan, 5.0, np.inf, 5.0]),
        np.array([7.0]),
    ],
)
def test_values_come_back_within_half_a_step(values):
    back = unpacked(*pack(values))
    known = np.isfinite(values)
    np.testing.assert_array_equal(np.isnan(back), ~known)
    assert np.abs(back - values)[known].max() <= 0.5001 * np.ptp(values[known]) / LEVELS


def test_nothing_known_comes_back_as_nothing():
    assert np.isnan(unpacked(*pack(np.full(5, np.nan)))).all()


def test_time_keeps_its_resolution_over_an_hour():
    time = 1.7e9 + np.arange(0, 3600, 0.025)
    assert np.abs(unpacked(*pack(time, step=1e-4)) - time).max() < 1e-4


@pytest.mark.parametrize("every", [1, 2, 3, 7])
@pytest.mark.parametrize("n", [1, 5, 1000, 1003])
def test_thinning_keeps_every_extreme(every, n):
    values = np.random.default_rng(n).normal(size=n)
    values[n // 3] = np.nan
    few = thinned(values, every)
    assert set(few[np.isfinite(few)]) <= set(values)
    assert len(few) <= n / every + 2
    for begin in range(0, n - 2 * every, 2 * every):
        group, kept = values[begin : begin + 2 * every], few[begin // every : begin // every + 2]
        if np.isfinite(group).any():
            assert (np.nanmin(kept), np.nanmax(kept)) == (np.nanmin(group), np.nanmax(group))


def one_panel(time, every=1, **series):
    panel = Panel("", "a", "", [Series("a", "blue", **series)])
    return chart("a", "</script>", time, [panel], every=every)


def spec_of(html):
    return json.loads(
        html.removeprefix('<script type="application/json">').removesuffix("</script>")
    )


@pytest.mark.parametrize("every", [1, 4])
def test_every_column_of_a_chart_is_as_long_as_its_time(every):
    n = 1003
    time = np.arange(n) / 40.0
    values = np.sin(time)
    spec = spec_of(one_panel(time, every, values=values, std=0.1 + 0 * time))
    data = zlib.decompress(base64.b64decode(spec["data"]))
    ends = np.cumsum([spec["n"] * size for *_, size in spec["columns"]])
    assert len(data) == ends[-1]
    columns = [
        unpacked(scale, data[end - spec["n"] * scale[2] : end])
        for scale, end in zip(spec["columns"], ends, strict=True)
    ]
    assert spec["n"] == pytest.approx(n / every, abs=2)
    assert np.abs(columns[0] - time[::every][: spec["n"]]).max() < 1e-4
    # A thinned value is one of its neighbourhood.
    assert np.abs(columns[1] - np.sin(columns[0])).max() < 2 * every / 40.0 + 1e-3


def test_names_do_not_end_the_element():
    html = one_panel(np.arange(3.0), values=np.zeros(3))
    assert html.count("</script>") == 1
    assert spec_of(html)["link"] == "</script>"


@pytest.mark.parametrize("time", [[0.0], [0.0, 1.0, 1.0], [0.0, 2.0, 1.0]])
def test_no_chart_where_time_does_not_go_on(time):
    assert one_panel(np.array(time), values=np.zeros(len(time))) == ""
