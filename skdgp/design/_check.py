"""A plan and the model after its flight: promised standard deviations, and those found."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pandas as pd
from sklearn.base import BaseEstimator

from skdgp._compute.typing import Matrix
from skdgp._display.page import number, section, table, text
from skdgp.dynamics import Aerodynamics, Aircraft, stability_derivatives


@dataclass(frozen=True)
class PromiseSettings:
    """Scatter of standard deviations found about those promised.

    Parameters
    ----------
    low, high : float
        10 and 90 % of found over promised, of nine simulated aircraft in light and rough air. The
        quantiles of eight aircraft hold 80 % of the ninth (tests/benchmarks/plans.py).
    """

    low: float = 0.65
    high: float = 1.9


PROMISE = PromiseSettings()


def with_range(errors: pd.DataFrame) -> pd.DataFrame:
    """Return the table with the ends ``low`` and ``high`` between which 80 % of what is found lies."""
    promised = errors["promised"]
    return errors.assign(low=PROMISE.low * promised, high=PROMISE.high * promised)


def errors_table(errors: pd.DataFrame, caption: str) -> str:
    """Return standard deviations by derivative, HTML."""
    rows = []
    for name, row in errors.iterrows():
        rows.append([text(name), *(number(value, ".2g") for value in row)])
    return table(["derivative", *errors], rows, caption=caption, classes="narrow")


def std_at(
    model: Aerodynamics | BaseEstimator,
    aircraft: Aircraft,
    trim: Mapping[str, Any],
    thrust: Any,
    added: Matrix | None = None,
) -> pd.Series:
    """Return the standard deviations of `stability_derivatives` by name, empty for a model without a posterior.

    The trim has "state" and "controls".
    """
    state = np.array(trim["state"], dtype=float)
    derivatives = stability_derivatives(
        model, aircraft, state, trim["controls"], thrust=thrust, added=added
    )
    return derivatives.get("std", pd.Series(dtype=float))


@dataclass(frozen=True, eq=False)
class PlanCheck:
    """Standard deviations of derivatives promised by a plan, and of a model learned after its flight.

    Parameters
    ----------
    errors : DataFrame
        By derivative of the goal: ``before``, ``promised``, ``low`` and ``high``, of the plan;
        ``found``, of the model, at the trim of the plan.
    """

    name: ClassVar[str] = "plan"
    errors: pd.DataFrame

    @classmethod
    def from_file(
        cls,
        path: str | os.PathLike[str],
        model: Aerodynamics | BaseEstimator,
        aircraft: Aircraft,
        *,
        thrust: Any = "auto",
    ) -> PlanCheck:
        """Compare a model with the plan.json of ``skdgp plan``.

        Raises FileNotFoundError if there is no such file, ValueError if it is no plan, or the model
        has no standard deviations of a derivative of its goal.

        Parameters
        ----------
        path : path-like
        model, aircraft, thrust
            As for :func:`skdgp.dynamics.stability_derivatives`; the model has learned from the
            planned flight too.

        Returns
        -------
        PlanCheck
        """
        try:
            plan = json.loads(Path(path).read_text(encoding="utf-8"))
            rows = {}
            for name, row in plan["errors"].items():
                rows[name] = [float(row["before"]), float(row["promised"])]
            errors = pd.DataFrame(rows, index=["before", "promised"]).T
            std = std_at(model, aircraft, plan["trim"], thrust)
        except (KeyError, TypeError, AttributeError, UnicodeDecodeError, json.JSONDecodeError):
            raise ValueError(
                f"Got {path} as the plan, but expected the plan.json that skdgp plan writes: copy it "
                f"again, or plan again."
            ) from None
        if lacking := [name for name in errors.index if name not in std]:
            raise ValueError(
                f"Got a plan for {lacking}, but the model has no standard deviations of them: "
                f"judge a model with the regressors that the plan was made with."
            )
        return cls(with_range(errors).assign(found=std.reindex(errors.index)))

    @property
    def remaining(self) -> dict[str, float]:
        """Geometric mean of ``promised`` and ``found`` over ``before``."""
        ratios = self.errors[["promised", "found"]].div(self.errors["before"], axis=0)
        means = np.exp(np.log(ratios).mean())
        return {"promised": float(means["promised"]), "found": float(means["found"])}

    @property
    def _ratios(self) -> str:
        return "promised {promised:.0%}, found {found:.0%}".format(**self.remaining)

    @property
    def n_within(self) -> int:
        """Number of derivatives found between ``low`` and ``high``."""
        errors = self.errors
        return int(errors["found"].between(errors["low"], errors["high"]).sum())

    def summary(self) -> list[str]:
        """Return promised and found values in one line."""
        return [
            f"standard deviations of the plan's goal, of those before it: {self._ratios}; "
            f"{self.n_within} of {len(self.errors)} within the range of the promise"
        ]

    def section(self) -> str:
        """Return its section of the report, HTML."""
        caption = (
            f"Standard deviations of derivatives at the trim of the plan: before its flight, "
            f"promised by the plan, with the range that holds 80 %, and found in this model. "
            f"Geometric mean, of those before: {self._ratios}."
        )
        return section("The plan and this model", errors_table(self.errors, caption))

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain values."""
        return {"remaining": self.remaining, "errors": self.errors.to_dict("index")}
