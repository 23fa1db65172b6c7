"""Listening to a fit."""

import pytest

from skdgp import listening
from skdgp._compute.parallel import thread_map
from skdgp._compute.progress import notify


def test_listener_is_called_until_the_block_ends():
    calls = []
    with listening(lambda *news: calls.append(news)):
        notify("fit", 1, -3.0)
    notify("fit", 2, -2.0)  # without a listener nothing happens
    assert calls == [("fit", 1, -3.0)]


def test_the_inner_listener_replaces_the_outer_one():
    outer, inner = [], []
    with listening(lambda *news: outer.append(news)):
        with listening(lambda *news: inner.append(news)):
            notify("a", 1, 0.0)
        notify("b", 2, 0.0)
    assert [stage for stage, *_ in inner] == ["a"]
    assert [stage for stage, *_ in outer] == ["b"]


def test_listener_goes_when_the_block_fails():
    calls = []
    with pytest.raises(ArithmeticError), listening(lambda *news: calls.append(news)):
        raise ArithmeticError
    notify("fit", 1, 0.0)
    assert calls == []


def test_threads_call_the_listener():
    calls = []
    with listening(lambda *news: calls.append(news)):
        thread_map(lambda n: notify("tile", n, 0.0), range(5))
    assert sorted(n for _, n, _ in calls) == [0, 1, 2, 3, 4]


def test_what_a_listener_raises_reaches_the_fit():
    def refuse(*news):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), listening(refuse):
        notify("fit", 1, 0.0)
