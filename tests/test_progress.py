"""Listening to a fit."""

import pytest

from skdgp._compute.progress import listening, notify
from skdgp._compute.threads import thread_map


def test_nobody_listens():
    notify("fit", 1, 0.0)


def test_listener_hears_until_the_block_ends():
    heard = []
    with listening(lambda *news: heard.append(news)):
        notify("fit", 1, -3.0)
    notify("fit", 2, -2.0)
    assert heard == [("fit", 1, -3.0)]


def test_the_inner_listener_hears_and_the_outer_one_again():
    outer, inner = [], []
    with listening(lambda *news: outer.append(news)):
        with listening(lambda *news: inner.append(news)):
            notify("a", 1, 0.0)
        notify("b", 2, 0.0)
    assert [stage for stage, *_ in inner] == ["a"]
    assert [stage for stage, *_ in outer] == ["b"]


def test_listener_goes_when_the_block_fails():
    heard = []
    with pytest.raises(ArithmeticError), listening(lambda *news: heard.append(news)):
        raise ArithmeticError
    notify("fit", 1, 0.0)
    assert heard == []


def test_worker_threads_are_heard():
    heard = []
    with listening(lambda *news: heard.append(news)):
        thread_map(lambda n: notify("tile", n, 0.0), range(5))
    assert sorted(n for _, n, _ in heard) == [0, 1, 2, 3, 4]


def test_what_a_listener_raises_reaches_the_fit():
    def refuse(*news):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), listening(refuse):
        notify("fit", 1, 0.0)
