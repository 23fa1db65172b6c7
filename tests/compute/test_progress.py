"""Listening to a fit."""

import pytest

from skdgp import listening
from skdgp._compute.messages import notify


def test_listener_is_called_until_the_block_ends():
    calls = []
    with listening(lambda *news: calls.append(news)):
        notify("fit", 1, -3.0)
    notify("fit", 2, -2.0)  # without a listener nothing happens
    assert calls == [("fit", 1, -3.0)]


def test_listener_goes_when_the_block_fails():
    calls = []
    with pytest.raises(ArithmeticError), listening(lambda *news: calls.append(news)):
        raise ArithmeticError
    notify("fit", 1, 0.0)
    assert calls == []


def test_what_a_listener_raises_reaches_the_fit():
    def refuse(*news):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), listening(refuse):
        notify("fit", 1, 0.0)
