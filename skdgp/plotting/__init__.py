"""Pictures in scikit-learn's manner: a Display holds the data, draws them, and keeps its artists.

Make a display with one of its methods ``from_...``, which raise ValueError if shapes, names,
columns or values are wrong. Draw it again with ``plot``. The parameters of the constructor, the
panels ``axes_`` (or ``ax_``) and ``figure_`` are attributes, and the artists: lists with one per
panel, None where there is nothing to draw. Colours are safe for colour-blind readers. Needs
matplotlib: ``pip install "skdgp[plot]"``.

Options that the displays share:

ax : Axes, Figure, SubFigure or array of Axes, optional
    Where to draw; default: a new pyplot figure.
outputs : str or list of str, optional
    Names of the outputs to draw, default all.
level : float, default=0.95
    Probability of the bands.
n_bins : int, default=2000
    Time slices of a long record: the lowest and the highest sample of each are drawn.
legend : bool, default=True
    Whether to draw a legend.
time_span : (begin, end), optional
    Part of a record to draw [s], default all.
"""

from skdgp.plotting._calibration import CalibrationDisplay
from skdgp.plotting._flight_envelope import EnvelopeDisplay
from skdgp.plotting._flights import FlightDisplay, TrajectoryDisplay
from skdgp.plotting._model import DerivativeDisplay, EffectsDisplay
from skdgp.plotting._time_histories import CoefficientDisplay, StateDisplay

__all__ = [
    "CalibrationDisplay", "CoefficientDisplay", "DerivativeDisplay", "EffectsDisplay",
    "EnvelopeDisplay", "FlightDisplay", "StateDisplay", "TrajectoryDisplay",
]  # fmt: skip
