"""Airspeed and wind of flights without an airspeed sensor, from velocity over the ground in turns."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

from skdgp._compute.typing import Matrix, Vector
from skdgp._flight.channels import EARTH_VELOCITY, EULER
from skdgp._flight.checks import check_columns, check_table
from skdgp._flight.clock import flight_rows
from skdgp._flight.frames import euler_to_matrix

# a flight is averaged over so many blocks, each of so many seconds or more
MOST_BLOCKS, SHORTEST_BLOCK = (200, 1.0)
# Correlation times [s] of gusts (as of `FlightPathReconstruction`), of the mean wind, of the
# airspeed; guesses
GUST_TIME, CHANGE_TIME, SPEED_TIME = 10.0, 3600.0, 15.0
# Prior standard deviations: mean wind, its change [m/s], mean airspeed [m/s], heading offset [rad];
# guesses
MEAN_WIND_STD, CHANGE_STD, MEAN_SPEED_STD, HEADING_STD = 30.0, 0.5, 100.0, 0.05
# Logarithms of the usual standard deviations [m/s] of gusts (.1 times 7.7 m/s, the light turbulence
# of MIL-F-8785C), of the airspeed, and of the residuals across and along the direction of flight in
# the mean of a block; guesses
USUAL = np.log([0.77, 1.0, 0.5, 0.1])
LOG_STD = np.array(
    [0.7, 2.0, 2.0, 2.0]
)  # how well these are known: gusts within a factor of two, the rest hardly
# steps of the linearisation; it ends when the wind changes by less than this [m/s]
MOST_STEPS, SETTLED = (10, 0.02)
# sine: nearer to the horizontal, the plane of symmetry does not tell the direction of flight
LEAST_TILT = 0.25
# relative standard deviation of airspeeds that are of use: one of dynamic pressure of 20 %
LARGEST_ERROR = 0.1


class Blocks(NamedTuple):
    """Means over blocks of a flight, n."""

    time: Vector  # (n,)
    along: Matrix  # (n, 2) unit vector of flight through the air, horizontal
    across: Matrix  # (n, 2) to the right
    velocity: Matrix  # (n, 2) over the ground: along, across


def airspeed_from_turns(flight: pd.DataFrame) -> pd.DataFrame:
    r"""Return airspeed and wind of flights without an airspeed sensor, from their velocity over the ground.

    Wind triangle: with velocity over the ground v, wind w, and the horizontal direction of flight
    through the air e, with n to its right,

    .. math:: e^T v = V_0 + \delta V + e^T w, \quad n^T v = n^T (w + g) + V_0 b + \epsilon, \quad V = |v - w - g|,

    with a constant airspeed V_0 and its slow changes, gusts g, an offset b of the heading and
    sideslip epsilon. In turns e points everywhere, which separates the wind from the airspeed. Of
    the attitude, e is in the plane of symmetry and sinks as fast as the aircraft; without attitude,
    e is the direction of v - w, and the first equation alone remains. The unknowns are Gaussian
    processes in time, with the standard deviations of largest posterior density (Rasmussen &
    Williams 2006, section 2.7; Langelaan, Alley & Neidhoefer 2011, without a sensor of airspeed).

    Parameters
    ----------
    flight : DataFrame
        Columns ``time`` [s], ``v_north``, ``v_east``, ``v_down`` [m/s]; ``flight`` where there are
        several, each by itself; ``phi``, ``theta``, ``psi`` [rad] where there are. Velocity is not
        used where a component is NaN.

    Returns
    -------
    DataFrame
        Columns ``airspeed``, ``airspeed_std`` (errors are correlated for about ten seconds),
        ``wind_north``, ``wind_east`` [m/s] with the flight's index. NaN where the deviation exceeds
        a tenth of the airspeed.

    Raises
    ------
    ValueError
        If a column is missing, or a flight does not tell its airspeed to a tenth anywhere: it has
        no turn.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> from skdgp.preprocessing import airspeed_from_turns
    >>> t = np.arange(0, 60, 0.1)
    >>> psi = 0.2 * t                                                   # circles at 15 m/s in wind of 4 m/s
    >>> flight = pd.DataFrame({"time": t, "v_north": 15 * np.cos(psi) + 4, "v_east": 15 * np.sin(psi), "v_down": 0.0})
    >>> found = airspeed_from_turns(flight)
    >>> found[["airspeed", "wind_north", "wind_east"]].mean().round(1).abs().tolist()
    [15.0, 4.0, 0.0]
    """
    check_columns(check_table(flight), ["time", *EARTH_VELOCITY])
    estimates = np.full((len(flight), 4), np.nan)
    rows = flight_rows(flight["flight"]) if "flight" in flight else {"": np.arange(len(flight))}
    for name, part in rows.items():
        estimates[part] = _of_flight(flight.iloc[part], f"flight {name!r}" if name else "a flight")
    return pd.DataFrame(
        estimates,
        columns=["airspeed", "airspeed_std", "wind_north", "wind_east"],
        index=flight.index,
    )


def _of_flight(flight: pd.DataFrame, name: str) -> Matrix:
    names = [*EARTH_VELOCITY, *(EULER if set(EULER) <= set(flight) else ())]
    values = flight[["time", *names]].to_numpy(float, na_value=np.nan)
    result, sampled = np.full((len(flight), 4), np.nan), np.isfinite(values).all(axis=1)
    time, velocity, sink, angles = (
        values[sampled, 0],
        values[sampled, 1:3],
        values[sampled, 3],
        values[sampled, 4:],
    )
    if len(time) > 3 and np.ptp(time) > SHORTEST_BLOCK:
        result[sampled] = _solved(
            time, velocity, sink, euler_to_matrix(*angles.T) if angles.size else None
        )
    accurate = result[:, 1] < LARGEST_ERROR * result[:, 0]
    if not accurate.any():
        off = np.nanmin(result[:, 1], initial=np.inf)
        raise ValueError(
            f"Got {name} without airspeed, whose velocity over the ground tells it to {off:.2g} "
            f"m/s, but expected a "
            "tenth of it or better: fly a circle or two (of some 30 s, any bank), or fit an "
            "airspeed sensor."
        )
    result[~accurate] = np.nan
    return result


def _solved(time: Vector, velocity: Matrix, sink: Vector, attitude: Matrix | None) -> Matrix:
    """Return airspeed, its standard deviation and wind, (n, 4)."""
    wind, speed, logs = np.zeros((len(time), 2)), float(np.hypot(*velocity.T).mean()), USUAL
    for _ in range(MOST_STEPS):
        before, through = wind, np.column_stack([velocity - wind, sink])
        airspeed = np.linalg.norm(through, axis=1)
        along = through[:, :2] if attitude is None else _in_symmetry(attitude, sink / airspeed)
        along = along / np.linalg.norm(along, axis=1)[:, None]
        blocks = _blocks(time, velocity, along)
        if len(blocks.time) < 2:
            return np.full((len(time), 4), np.nan)
        logs, speed, winds, covariance = _posterior(blocks, speed, logs, attitude is not None)
        wind = np.column_stack([np.interp(time, blocks.time, column) for column in winds.T])
        if np.abs(wind - before).max() < SETTLED:
            break
    of_row = np.column_stack(
        [np.interp(time, blocks.time, column) for column in covariance.reshape(len(winds), 4).T]
    )
    variance = np.einsum("ni,nij,nj->n", along, of_row.reshape(-1, 2, 2), along)
    variance += np.mean(np.diff(velocity, 3, axis=0) ** 2) / 20  # noise of a sample; 1 + 9 + 9 + 1
    return np.column_stack(
        [np.hypot(np.linalg.norm(velocity - wind, axis=1), sink), np.sqrt(variance), wind]
    )


def _in_symmetry(attitude: Matrix, sink: Vector) -> Matrix:
    """Return the horizontal part (n, 2) of the unit vectors in the plane x-z of the body that sink as fast, or NaN.

    cos(alpha) x + sin(alpha) z, with alpha from its component down, A sin(alpha - theta').
    """
    x, z = attitude[..., 0], attitude[..., 2]
    tilt = np.hypot(x[:, 2], z[:, 2])
    alpha = np.arctan2(-x[:, 2], z[:, 2]) + np.arcsin(
        np.clip(sink / np.maximum(tilt, LEAST_TILT), -1, 1)
    )
    return np.where(
        tilt > LEAST_TILT, np.cos(alpha) * x[:, :2].T + np.sin(alpha) * z[:, :2].T, np.nan
    ).T


def _blocks(time: Vector, velocity: Matrix, along: Matrix) -> Blocks:
    sampled = np.isfinite(along).all(axis=1)
    time, velocity, along = time[sampled], velocity[sampled], along[sampled]
    across = np.column_stack([-along[:, 1], along[:, 0]])
    count = min(MOST_BLOCKS, max(1, int(np.ptp(time) / SHORTEST_BLOCK)))
    number = np.minimum(count * (time - time[0]) / np.ptp(time), count - 1).astype(int)
    parts = [
        time,
        *along.T,
        *across.T,
        (velocity * along).sum(axis=1),
        (velocity * across).sum(axis=1),
    ]
    means = (
        pd.DataFrame(np.column_stack(parts)).groupby(number).mean().to_numpy()
    )  # of blocks that are not empty
    return Blocks(means[:, 0], means[:, 1:3], means[:, 3:5], means[:, 5:])


def _posterior(
    blocks: Blocks, speed: float, logs: Vector, headed: bool
) -> tuple[Vector, float, Matrix, Matrix]:
    """Return logarithms of standard deviations, mean airspeed, winds (n, 2) and their covariances (n, 2, 2)."""
    n = len(blocks.time)
    lag = np.abs(blocks.time[:, None] - blocks.time)
    gust, change, slow = (np.exp(-lag / scale) for scale in (GUST_TIME, CHANGE_TIME, SPEED_TIME))
    sides = (0, 1) if headed else (0,)
    y = np.concatenate([blocks.velocity[:, k] for k in sides])
    directions = np.concatenate([(blocks.along, blocks.across)[k] for k in sides])
    times = np.tile(np.arange(n), len(sides))
    of_wind = MEAN_WIND_STD**2 + CHANGE_STD**2 * change
    shape = np.zeros(
        (len(y), 2)
    )  # of the mean airspeed, along, and the offset of the heading, across
    shape[:n, 0], shape[n:, 1] = MEAN_SPEED_STD, HEADING_STD * speed
    fixed = directions @ directions.T * of_wind[np.ix_(times, times)] + shape @ shape.T

    def factor(logs):
        of_gust, of_speed, left_across, left_along = np.exp(2 * logs)
        K = fixed.copy()
        K[:n, :n] += of_speed * slow + left_along * np.eye(n)
        if headed:
            K[n:, n:] += of_gust * (blocks.across @ blocks.across.T) * gust + left_across * np.eye(
                n
            )
        return cho_factor(K, lower=True, check_finite=False)

    def cost(logs):
        L = factor(logs)
        fit = y @ cho_solve(L, y) / 2 + np.log(L[0].diagonal()).sum()
        return fit + np.sum(((logs - USUAL) / LOG_STD) ** 2) / 2

    logs = minimize(cost, logs, method="L-BFGS-B", options={"maxiter": 30}).x
    L, of_gust = factor(logs), np.exp(2 * logs[0])
    weights = cho_solve(L, y)
    cross = np.stack(
        [of_wind[:, times] * component for component in directions.T]
    )  # wind and y, (2, n, len(y))
    cross[:, :, n:] += of_gust * gust[:, : len(y) - n] * directions.T[:, None, n:]
    inner = [cho_solve(L, row.T) for row in cross]
    covariance = np.array([[-np.einsum("nm,mn->n", a, b) for b in inner] for a in cross])
    covariance += np.eye(2)[..., None] * (MEAN_WIND_STD**2 + CHANGE_STD**2 + of_gust)
    mean_speed = MEAN_SPEED_STD * shape[:, 0] @ weights
    return logs, float(mean_speed), (cross @ weights).T, covariance.transpose(2, 0, 1)
