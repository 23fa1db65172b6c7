"""Servos: the first-order lag between commands and deflections of the control surfaces."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from skdgp._compute.typing import Array
from skdgp.dynamics._motion import PROPULSION, Motion


class Servos(NamedTuple):
    r"""Servos of the control surfaces with a first-order lag T: :math:`T \dot\delta = c - \delta`, commands c."""

    lag: float  #: T [s]
    surfaces: frozenset[str]  #: The controls that they move

    @classmethod
    def of(cls, motion: Motion) -> Servos:
        """Return the servos of an aircraft; they move nothing where its model has no lag."""
        lag = motion.aerodynamics.servo_lag
        surfaces = motion.inputs - {*PROPULSION, "gust"} if lag > 0 else frozenset()
        return cls(lag, surfaces)

    def deflected(
        self, commands: Mapping, elapsed: float, first: Mapping, begun: Mapping
    ) -> dict[str, Array]:
        r"""Return the controls, with the deflections of the surfaces, ``elapsed`` [s] after a step began.

        Commands were ``first`` then, and are linear since; ``begun`` are the deflections then, by
        default the commands:

        .. math:: \delta(t) = c(t) - T \dot c + (\delta_0 - c_0 + T \dot c) \, e^{-t / T}.

        `skdgp.estimation` has the same solution as a filter of whole time series, whose rounding
        differs.
        """
        controls = dict(commands)
        decay = np.exp(-elapsed / self.lag) if self.surfaces else 0.0
        for name in self.surfaces & commands.keys():
            change = commands[name] - first[name]
            behind = self.lag / elapsed * change if elapsed > 0 else 0.0
            late = begun.get(name, first[name]) - first[name] + behind
            controls[name] = commands[name] - behind + late * decay
        return controls
