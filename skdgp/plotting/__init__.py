"""Figures in scikit-learn's manner: a Display holds the data and draws them, one panel for each key.

A method ``from_...`` computes and draws (not with ``ax=False``); ``plot(ax)`` draws again;
``draw(ax, key)`` draws one panel, of ``keys``, into an Axes. They raise ValueError if shapes, names,
columns or values are wrong. The parameters of the constructor, the panels ``axes_`` and ``figure_`` are attributes.
Bands hold 95 %. Colours are safe for colour-blind readers. Needs matplotlib: ``pip install
"skdgp[plot]"``.

An option that the displays share:

ax : Figure, SubFigure or False, optional
    Where to draw; default: a new pyplot figure. False: do not draw.
"""

from skdgp.plotting._display import Display as Display
from skdgp.plotting._display import display_unit as display_unit
from skdgp.plotting._display import units_shown as units_shown
from skdgp.plotting._effects import EffectsDisplay
from skdgp.plotting._time_histories import TimeHistoryDisplay

__all__ = [
    "EffectsDisplay",
    "TimeHistoryDisplay",
]
