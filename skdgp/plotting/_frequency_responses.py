"""FrequencyDisplay: frequency responses of a flight beside the model's."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
import pandas as pd

from skdgp.plotting._display import Display
from skdgp.plotting._style import ROLES, symbol

UNITS = {"gain": "dB", "phase": "deg"}
#: Least number of excited frequencies of a response that is drawn
FEWEST = 3


@dataclass(kw_only=True, eq=False, repr=False)
class FrequencyDisplay(Display):
    """Gain, or phase, by frequency: of a flight where it excites the response, and of a model.

    Parameters
    ----------
    responses : DataFrame
        Of :func:`skdgp.dynamics.frequency_response` with a linear model.
    quantity : {"gain", "phase"}

    Examples
    --------
    >>> import pandas as pd
    >>> from matplotlib.figure import Figure
    >>> from skdgp.plotting import FrequencyDisplay
    >>> index = pd.MultiIndex.from_product([["p"], ["aileron"], [1.0, 2.0, 4.0]],
    ...                                    names=["output", "input", "frequency"])
    >>> table = pd.DataFrame({"gain": [3.0, 2.0, 0.0], "phase": [-20.0, -40.0, -60.0], "excited": True,
    ...                       "model_gain": [3.2, 2.1, 0.1], "model_phase": [-18.0, -41.0, -62.0]}, index=index)
    >>> FrequencyDisplay(responses=table).plot(Figure()).keys
    [('p', 'aileron')]
    """

    responses: pd.DataFrame
    quantity: str = "gain"
    size = (3.0, 1.9)

    @property
    def n_columns(self) -> int:
        """Number of columns of panels."""
        return len(self.keys)

    @property
    def keys(self) -> list[tuple[str, str]]:
        """Output and input of each response with several excited frequencies."""
        pairs = self.responses.groupby(level=["output", "input"], sort=False)
        n_excited = pairs["excited"].sum()
        return [tuple(pair) for pair in n_excited.index[n_excited >= FEWEST]]

    def phases(self) -> Self:
        """Return the display of the phases."""
        return replace(self, quantity="phase")

    def draw(self, ax: Any, key: tuple[str, str]) -> None:
        """Draw the measured response, and the model's with its band."""
        name = self.quantity
        table: Any = self.responses.loc[key]
        model = table[f"model_{name}"]
        shown = model
        measured = table[name]
        if name == "phase":
            shown = pd.Series(np.unwrap(model, period=360.0), table.index)
            measured = shown + _wrapped(measured - shown)
        if f"model_{name}_lower" in table:
            edges = [table[f"model_{name}_{edge}"] + shown - model for edge in ("lower", "upper")]
            style = {"color": ROLES["band"], "alpha": 0.35, "linewidth": 0}
            ax.fill_between(table.index, *edges, label="95 % band", **style)
        ax.plot(shown, color=ROLES["mean"], linewidth=0.9, label="model")
        flown = measured[table["excited"].astype(bool)]
        marks = {"marker": "o", "markersize": 2.5, "linestyle": "None"}
        ax.plot(flown, color=ROLES["measured"], label="flight", **marks)
        ax.set_xscale("log")
        ax.tick_params(which="minor", labelbottom=False)
        label = f"{symbol(key[0])} by {key[1]} [{UNITS[name]}]"
        ax.set(xlabel="frequency [rad/s]", ylabel=label)


def _wrapped(degrees: Any) -> Any:
    """Return angles from -180 to 180 degrees."""
    return (degrees + 180.0) % 360.0 - 180.0
