"""LagCorrector: estimates and removes lags of air data, surfaces, attitude and GPS."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import pandas as pd

from skdgp._compute.messages import warn
from skdgp._compute.sklearn_compat import StrOptions
from skdgp._compute.typing import Vector
from skdgp._flight.channels import (
    AIR_DATA,
    ALL_SURFACES,
    EARTH_VELOCITY,
    EULER,
    POSITION,
)
from skdgp._flight.clock import Clock, median_step, n_rows
from skdgp._flight.holds import without_repeats
from skdgp._flight.tables import (
    by_name,
    check_columns,
    check_number,
    interpolate_missing,
    numeric,
    unwrapped,
    with_sensor_position,
    wrap_near,
)
from skdgp.dynamics import Aircraft, Servos
from skdgp.estimation import (
    Lag,
    estimate_lags,
    removable,
    servo_output,
    without_lag,
)
from skdgp.preprocessing._table import TableTransformer, present, with_names

GROUPS = {
    "air": AIR_DATA,
    "surfaces": ALL_SURFACES,
    "servos": ALL_SURFACES,
    "attitude": EULER,
    "gps": (*EARTH_VELOCITY, *POSITION),
}
# channels without noise, where steps are common
CONTROLS = (*ALL_SURFACES, "throttle", "propeller_speed")
# channels that are unknown beyond the end of a segment
KINEMATIC = (*GROUPS["attitude"], *GROUPS["gps"])


class LagCorrector(TableTransformer):
    r"""Estimate the lags of air data, surfaces, attitude and GPS against the inertial unit, and remove them.

    A channel with lag tau shows at t its value at t - tau, so it is replaced by its value at t +
    tau, segment by segment. Beyond the end of a segment attitude and GPS are NaN, and the last value
    of others is repeated. Sensors are shifted in the frequency domain, which keeps white noise white
    for :class:`FlightSmoother`; controls, and channels of a jittered clock, by cubic splines. Use
    full-rate flights, before smoothing.

    Surfaces that are early are commands. They become the deflections :math:`\delta` of servos with
    a first-order lag T, :math:`T \dot\delta = c - \delta`, of commands c with a delay. Without vanes
    only a delay of a step of the log or more is removed, less two standard deviations or 10 ms: the rest is
    part of the lag that :class:`FlightPathReconstruction` removes, and surfaces that are too late follow
    the motion that an autopilot answers. A column ``servo_delay_std`` [s] tells the error of the rest to
    :func:`skdgp.estimation.estimate_air_motion`.

    Attitude and GPS follow from gyros and accelerometers by kinematics, as in
    :class:`FlightPathReconstruction`. Surfaces and vanes are related to them by a local linear
    model, without assumed derivatives: at the same time

    .. math:: \dot\omega / V^2 \approx B\,[\delta, \omega / V, f / V^2], \quad
              (\alpha, \beta) \approx C\,[f / V^2, \omega / V, \delta],

    all within the band from 0.3 to 4 Hz. Vanes of records from 6 s on are also compared with the motion of the
    aircraft, :math:`\dot\alpha = q + (a_z + g_z) / V`; the more certain lag counts. The lag maximises
    the profile likelihood of the residuals (Jategaonkar 2006, chapter 10). About eight pieces of the flights,
    each with its own B, C and lag, give its standard error: an error of the linear model moves them apart. Lags of
    throttle and propeller speed can be given, not estimated: engines respond slowly. T and the delay
    of servos are those of the largest likelihood of what the commands of the last 1.5 s explain
    (instrumental variables), which noise and gusts do not move. Raises
    ValueError if ``time`` is missing; if the table has no column of the groups; if ``lags`` names
    neither a group nor a column, or is not finite.

    Parameters
    ----------
    lags : {"auto"}, dict or None, default="auto"
        Estimated in ``fit``; or given [s], positive where late, by group (air: airspeed, alpha,
        beta; surfaces; servos: T, where surfaces are commands; attitude; gps) or column; or None
        for no change.
    aircraft : Aircraft, optional
        Its position of the inertial sensors, where flights do not state theirs.

    Attributes
    ----------
    servos_ : Servos
        Lag, delay and, where the flights reach it, limit of the rate of the servos, for simulations and
        margins, also where they are not removed. A limit is warned of.
    left_std_ : float
        Standard error [s] of the delay that is left beside the lag, of the column ``servo_delay_std``; 0 is none.
    lags_ : DataFrame
        By group or column: ``lag`` and ``std`` [s], NaN where it is given or flights do not show it,
        ``applied``, the lag that is removed [s], and a ``remark``.
        Of surfaces behind servos they are the delay, and the error of the time of lag and delay
        together. A lag below 3 standard deviations (a third of Student's quantile of equal
        probability for few pieces) or below 10 ms is not removed; of lag and delay of servos the sum
        counts.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> t = np.arange(0, 4, 0.02)
    >>> flight = pd.DataFrame({"time": t, "alpha": np.sin(t - 0.08), "q": np.cos(t)})
    >>> on_time = LagCorrector(lags={"air": 0.08}).fit_transform(flight)
    >>> bool(np.allclose(on_time.alpha[:-4], np.sin(t)[:-4], atol=1e-4))
    True
    """

    _parameter_constraints: dict = {
        "lags": [StrOptions({"auto"}), dict, None],
        "aircraft": [Aircraft, None],
    }

    def __init__(self, lags: Any = "auto", *, aircraft: Aircraft | None = None) -> None:
        self.lags = lags
        self.aircraft = aircraft

    def in_simulation(self) -> dict[str, Any]:
        """Return the servos."""
        return {"servos": self.servos_}

    def _fit_table(self, table):
        check_columns(table, ["time"])
        rate_limit, delay_std, self.left_std_ = np.inf, 0.0, 0.0
        if isinstance(self.lags, str):
            self._check_any(table, _columns_of(GROUPS))
            lags = estimate_lags(with_sensor_position(table, self.aircraft))
            rows = {group: _applied(lag) for group, lag in lags.items()}
            rate_limit, delay_std = lags["servos"].rate_limit, lags["servos"].delay_std
            self.left_std_ = lags["surfaces"].delay_std
            if np.isfinite(rate_limit):
                warn(
                    f"The servos reach a limit of their rate, {rate_limit:.2g} rad/s, in these flights: larger "
                    "motions of the surfaces have less margin than linear models say."
                )
        else:
            rows = self._given(table)
        columns = ["lag", "std", "applied", "remark"]
        self.lags_ = pd.DataFrame.from_dict(rows, orient="index", columns=columns)
        self.lags_ = self.lags_.rename_axis("group")
        known = self.lags_.drop(columns="remark").reindex(["surfaces", "servos"]).fillna(0.0)
        (surface_lag, _, applied), (lag, lag_std, _) = known.to_numpy(float).tolist()
        early = -(surface_lag if lag else applied)
        self.servos_ = Servos(lag, max(0.0, early), rate_limit, lag_std, delay_std)

    def _given(self, table):
        """Return the given lags; raise ValueError if one is not finite, or names neither a group nor a column."""
        rows = {}
        for name, lag in (self.lags or {}).items():
            if name not in GROUPS and name not in table:
                raise ValueError(
                    f"Got a lag of {name!r}, but expected groups {list(GROUPS)} or columns of the table."
                )
            is_servo = name == "servos"
            least = 0.0 if is_servo else -np.inf
            seconds = check_number(f"lag of {name}", lag, least, is_open=not is_servo, unit="s")
            rows[name] = (seconds, np.nan, seconds, "given")
        if rows:
            self._check_any(table, _columns_of(rows))
        return rows

    def _transform_table(self, table):
        check_columns(table, ["time"])
        time = numeric(table, ["time"])[:, 0]
        flight = table.get("flight")
        lags = self.lags_["applied"]
        fresh = without_repeats(table, (EULER, EARTH_VELOCITY))
        new = {}
        for group, lag in lags[lags != 0].drop("servos", errors="ignore").items():
            for name in present(_columns_of([group]), table):
                values = unwrapped(fresh, [name])[:, 0]
                noisy = name not in CONTROLS
                repeats = name not in KINEMATIC
                new[name] = without_lag(time, values, lag, flight, noisy=noisy, repeats=repeats)
        if lags.get("servos"):
            moved = table.assign(**new)
            new |= deflections(moved, lags["servos"], self.servos_.rate_limit)
        wrap_near(new, table)
        if self.left_std_:  # for `estimate_air_motion`
            new["servo_delay_std"] = np.full(len(table), self.left_std_)
        return table.assign(**new)

    def _columns_out(self, names):
        return with_names(names, ["servo_delay_std"] if self.left_std_ else [])


def deflections(table: pd.DataFrame, lag: float, rate_limit: float = np.inf) -> dict[str, Vector]:
    """Return the deflections of servos of a first-order lag by their commands, NaN where there is none.

    Servos begin each gap-free segment at rest.
    """
    surfaces = present(ALL_SURFACES, table)
    time = numeric(table, ["time"])[:, 0]
    commands = numeric(table, surfaces)
    late = interpolate_missing(time, commands)
    for run in Clock.of(time, table.get("flight")).segments:
        if n_rows(run) > 1:  # a single sample is at rest
            late[run] = servo_output(late[run], lag, median_step(time, [run]), rate_limit)
    late[np.isnan(commands)] = np.nan
    return by_name(surfaces, late)


def _columns_of(names: Iterable[Any]) -> list[str]:
    """Return the columns of groups and of single columns."""
    columns: list[str] = []
    for name in names:
        columns += GROUPS.get(name, (name,))
    return columns


def _applied(lag: Lag) -> tuple[float, float, float, str]:
    """Return a lag, its standard deviation, the lag to remove, and a remark."""
    applied = removable(lag)
    if applied:
        remark = "removed"
    elif lag.removal is not None and np.isfinite(lag.std):
        remark = "left to the reconstruction"
    elif lag.is_significant():
        remark = "negligible"
    else:
        remark = "not shown by these flights"
    return lag.value, lag.std, applied, remark
