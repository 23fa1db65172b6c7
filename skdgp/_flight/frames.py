"""Frames (Euler angles, quaternions, rotation matrices), air data and standard atmosphere, over leading axes.

Body axes: x forward, y right, z down. Earth axes: north, east, down (NED), flat and not rotating.
Quaternions are scalar first and rotate body vectors into NED axes; ``q`` and ``-q`` are the same
attitude. A quaternion need not have unit length: all functions divide by its length.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from skdgp._compute.typing import Matrix

# [m/s^2]
STANDARD_GRAVITY = 9.80665
# altitudes of the standard atmosphere here [m]
LOWEST = -5000.0
HIGHEST = 20000.0
# [kg/m^3], [Pa]
SEA_LEVEL_DENSITY = 1.225
SEA_LEVEL_PRESSURE = 101325.0


def euler_to_quaternion(phi: ArrayLike, theta: ArrayLike, psi: ArrayLike) -> np.ndarray:
    """Return the unit quaternions (..., 4), body to NED, of roll, pitch and heading [rad].

    The rotation order is yaw, pitch, roll (Stevens, Lewis & Johnson 2016, section 1.8).

    Examples
    --------
    >>> from skdgp.dynamics import euler_to_quaternion, quaternion_to_euler
    >>> quaternion_to_euler(euler_to_quaternion(0.3, -0.2, 1.5)).round(12)
    array([ 0.3, -0.2,  1.5])
    """
    roll = np.multiply(0.5, phi)
    pitch = np.multiply(0.5, theta)
    yaw = np.multiply(0.5, psi)
    c_phi = np.cos(roll)
    s_phi = np.sin(roll)
    c_theta = np.cos(pitch)
    s_theta = np.sin(pitch)
    c_psi = np.cos(yaw)
    s_psi = np.sin(yaw)
    q0 = c_phi * c_theta * c_psi + s_phi * s_theta * s_psi
    q1 = s_phi * c_theta * c_psi - c_phi * s_theta * s_psi
    q2 = c_phi * s_theta * c_psi + s_phi * c_theta * s_psi
    q3 = c_phi * c_theta * s_psi - s_phi * s_theta * c_psi
    return vector_of(q0, q1, q2, q3)


def quaternion_to_euler(quaternion: ArrayLike) -> np.ndarray:
    """Return (phi, theta, psi) [rad], (..., 3), of quaternions (..., 4).

    Roll and heading lie in [-pi, pi], pitch in [-pi/2, pi/2].
    """
    north, east, down = rotation_rows(*components(quaternion))
    phi = np.arctan2(down[1], down[2])
    theta = np.arcsin(np.clip(0.0 - down[0], -1.0, 1.0))
    psi = np.arctan2(east[0], north[0])
    return vector_of(phi, theta, psi)


def quaternion_to_matrix(quaternion: ArrayLike) -> np.ndarray:
    """Return the rotation matrices (..., 3, 3) that take body vectors to NED, of quaternions (..., 4)."""
    rows = rotation_rows(*components(quaternion))
    return np.stack([vector_of(*row) for row in rows], axis=-2)


def rotation_rows(q0: Any, e1: Any, e2: Any, e3: Any) -> tuple[tuple, tuple, tuple]:
    """Return the rows of the rotation matrix body to NED of a quaternion of any length.

    1 + s (q0 [e] + [e] [e]), with the vector part e and s = 2 / (q . q) (Rodrigues), from one shared
    set of products: this runs four times in every step of every simulation.
    """
    s = 2.0 / (q0 * q0 + e1 * e1 + e2 * e2 + e3 * e3)
    s1, s2, s3 = s * e1, s * e2, s * e3
    x1, x2, x3 = s1 * q0, s2 * q0, s3 * q0
    y11, y22, y33 = s1 * e1, s2 * e2, s3 * e3
    y12, y13, y23 = s1 * e2, s1 * e3, s2 * e3
    north = (1.0 - y22 - y33, y12 - x3, y13 + x2)
    east = (y12 + x3, 1.0 - y11 - y33, y23 - x1)
    down = (y13 - x2, y23 + x1, 1.0 - y11 - y22)
    return north, east, down


def euler_to_matrix(phi: ArrayLike, theta: ArrayLike, psi: ArrayLike) -> np.ndarray:
    """Return the rotation matrices (..., 3, 3) that take body vectors to NED, of Euler angles [rad]."""
    return quaternion_to_matrix(euler_to_quaternion(phi, theta, psi))


def euler_to_rotation(angles: Matrix) -> Rotation:
    """Return the attitudes, body to NED, of roll, pitch and heading (n, 3) [rad]."""
    return Rotation.from_euler("ZYX", angles[:, ::-1])


def rotation_to_euler(attitude: Rotation) -> Matrix:
    """Return roll, pitch and heading (n, 3) [rad] of attitudes, body to NED."""
    return attitude.as_euler("ZYX")[:, ::-1]


def body_to_ned(quaternion: ArrayLike, vector: ArrayLike) -> np.ndarray:
    """Return body vectors (..., 3) in NED axes, at the attitude of ``quaternion`` (..., 4)."""
    return product(rotation_rows(*components(quaternion)), vector)


def ned_to_body(quaternion: ArrayLike, vector: ArrayLike) -> np.ndarray:
    """Return NED vectors (..., 3) in body axes, at the attitude of ``quaternion`` (..., 4)."""
    q0, q1, q2, q3 = components(quaternion)
    return product(rotation_rows(-q0, q1, q2, q3), vector)


def euler_per_rotation(phi: ArrayLike, theta: ArrayLike) -> np.ndarray:
    """Return d (phi, theta, psi) / d (small body rotation), (..., 3, 3): of body rates it makes Euler angles' rates."""
    phi, theta = np.broadcast_arrays(phi, theta)
    sine = np.sin(phi)
    cosine = np.cos(phi)
    tangent = np.tan(theta)
    roll = vector_of(1.0, sine * tangent, cosine * tangent)
    pitch = vector_of(0.0, cosine, -sine)
    yaw = vector_of(0.0, sine, cosine) / np.cos(theta)[..., None]
    return np.stack([roll, pitch, yaw], axis=-2)


def air_data(velocity: ArrayLike) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return airspeed [m/s], alpha and beta [rad] of body velocities (..., 3) relative to the air.

    ``V = |v|``, ``alpha = atan2(w, u)``, ``beta = asin(v / V)``.

    Examples
    --------
    >>> from skdgp.dynamics import air_data, air_velocity
    >>> [float(x.round(12)) for x in air_data(air_velocity(30.0, 0.1, -0.05))]
    [30.0, 0.1, -0.05]
    """
    u, v, w = components(velocity)
    across = u * u + w * w
    airspeed = np.sqrt(across + v * v)
    alpha = np.arctan2(w, u)
    # atan2 keeps beta accurate near 90 degrees and defined at rest, where asin(v / V) is neither.
    beta = np.arctan2(v, np.sqrt(across))
    return airspeed, alpha, beta


def air_data_slopes(velocity: ArrayLike, least_speed: float = 0.0) -> np.ndarray:
    """Return d (airspeed, alpha, beta) / d velocity, (..., 3, 3), at body velocities (..., 3) relative to the air.

    ``slopes @ acceleration`` are the rates of change, alpha_dot = (u w' - w u') / (u^2 + w^2) among
    them. Speeds below ``least_speed`` [m/s] count as that, which bounds the slopes.
    """
    u, v, w = components(velocity)
    speed = np.sqrt(u * u + v * v + w * w)
    airspeed = np.maximum(speed, least_speed)
    across = np.maximum(np.hypot(u, w), least_speed)
    factor = v / (airspeed**2 * across)
    of_airspeed = vector_of(u / airspeed, v / airspeed, w / airspeed)
    of_alpha = vector_of(-w / across**2, 0.0, u / across**2)
    of_beta = vector_of(-u * factor, 1 / across - v * factor, -w * factor)
    return np.stack([of_airspeed, of_alpha, of_beta], axis=-2)


def air_velocity(airspeed: ArrayLike, alpha: ArrayLike, beta: ArrayLike) -> np.ndarray:
    """Return the body velocity relative to the air, V (cos a cos b, sin b, sin a cos b), (..., 3) [m/s]."""
    in_plane = np.multiply(airspeed, np.cos(beta))
    u = in_plane * np.cos(alpha)
    v = np.multiply(airspeed, np.sin(beta))
    w = in_plane * np.sin(alpha)
    return vector_of(u, v, w)


def flow_angle_rates(
    velocity: ArrayLike,
    force: ArrayLike,
    rates: ArrayLike,
    attitude: ArrayLike,
    least_speed: float = 0.0,
) -> np.ndarray:
    r"""Return the rates of change of alpha and beta (..., 2) [rad/s] by the motion through steady air.

    Of body velocities v relative to the air, specific force f, angular rates and attitude (phi, theta),
    :math:`\dot v = f + g - \omega \times v` (Stevens, Lewis & Johnson 2016, section 1.7). Least speed: see
    `air_data_slopes`.
    """
    phi, theta = components(attitude)
    down = vector_of(-np.sin(theta), np.sin(phi) * np.cos(theta), np.cos(phi) * np.cos(theta))
    acceleration = np.asarray(force) + STANDARD_GRAVITY * down - cross(rates, velocity)
    slopes = air_data_slopes(velocity, least_speed)[..., 1:, :]
    return np.squeeze(slopes @ acceleration[..., None], -1)


def wind_origin(north: float, east: float) -> float:
    """Return where the wind comes from [deg], clockwise from north, 0 to 360, by its velocity."""
    return np.rad2deg(np.arctan2(-east, -north)) % 360


def components(vector: ArrayLike) -> tuple[Any, ...]:
    """Return the components along the last axis: of one vector plain numbers, which are fastest."""
    vector = np.asarray(vector, dtype=float)
    if vector.ndim == 1:
        return tuple(vector.tolist())
    return tuple([vector[..., k] for k in range(vector.shape[-1])])  # faster than moveaxis


def empty_vectors(shape: tuple[int, ...], size: int) -> np.ndarray:
    """Return vectors (*shape, size) without values, whose components are contiguous in memory.

    Operations on the components of some hundred vectors are then twice as fast.
    """
    vectors = np.empty((size, *shape))
    return vectors.transpose(*range(1, vectors.ndim), 0)


def by_components(vectors: np.ndarray) -> np.ndarray:
    """Return the vectors (..., k), with components contiguous in memory."""
    arranged = empty_vectors(vectors.shape[:-1], vectors.shape[-1])
    arranged[:] = vectors
    return arranged


def vector_of(*components: ArrayLike) -> np.ndarray:
    """Return the components as vectors (..., k)."""
    if all(isinstance(component, float) for component in components):
        return np.array(components)
    vector = empty_vectors(np.broadcast(*components).shape, len(components))
    for k, component in enumerate(components):
        vector[..., k] = component
    return vector


def product(rows: tuple[tuple, ...], vector: ArrayLike) -> np.ndarray:
    """Return the products of a matrix, by its rows, and vectors (..., 3)."""
    x, y, z = components(vector)
    return vector_of(*[first * x + second * y + third * z for first, second, third in rows])


def cross(a: ArrayLike, b: ArrayLike) -> np.ndarray:
    """Return a x b, (..., 3); numpy.cross takes five times as long on a few vectors."""
    a1, a2, a3 = components(a)
    b1, b2, b3 = components(b)
    x = a2 * b3 - a3 * b2
    y = a3 * b1 - a1 * b3
    z = a1 * b2 - a2 * b1
    return vector_of(x, y, z)


def cross_matrix(vector: ArrayLike) -> np.ndarray:
    """Return the matrices (..., 3, 3) of the products v x, of vectors (..., 3)."""
    x, y, z = components(vector)
    first = vector_of(0.0, -z, y)
    second = vector_of(z, 0.0, -x)
    third = vector_of(-y, x, 0.0)
    return np.stack([first, second, third], axis=-2)


def wrapped(angle: np.ndarray) -> np.ndarray:
    """Return angles within half a turn of zero."""
    return np.angle(np.exp(1j * angle))


def wrapped_near(angle: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Return angles shifted by multiples of 2 pi to less than pi from a reference, where this is finite."""
    near = reference + wrapped(angle - reference)
    return np.where(np.isfinite(near), near, angle)


def without_sign_changes(quaternions: np.ndarray) -> np.ndarray:
    """Return the same attitudes with signs such that neighbours are near each other; NaN rows stay."""
    sampled = np.isfinite(quaternions).all(axis=1)
    rotations = quaternions[sampled]
    is_opposite = np.sum(rotations[1:] * rotations[:-1], axis=1) < 0
    signs = np.cumprod(np.append(1.0, np.where(is_opposite, -1.0, 1.0)))
    result = quaternions.copy()
    result[sampled] = rotations * signs[:, None]
    return result


def standard_density(altitude: ArrayLike) -> np.ndarray:
    """Return the density [kg/m^3] of the International Standard Atmosphere at geopotential altitudes h [m].

    Up to 11 km (U.S. Standard Atmosphere 1976, section 1.3; ISO 2533:1975)

        T = T_0 - L h,   p = p_0 (T / T_0)^(g / (R L)),   rho = p / (R T),

    and above rho falls by exp(-g (h - 11 km) / (R T)). Geometric altitude z above the ellipsoid is
    more by z^2 / 6356766 m: 1.6 m at 3.2 km. NaN gives NaN; raises ValueError outside of -5 to
    20 km.

    Examples
    --------
    >>> from skdgp.dynamics import standard_density
    >>> standard_density([0.0, 1000.0]).round(3)
    array([1.225, 1.112])
    """
    altitude = np.asarray(altitude, dtype=float)
    density = density_or_nan(altitude)
    outside = np.isnan(density) & ~np.isnan(altitude)
    if outside.any():
        raise ValueError(
            f"Got altitude {altitude[outside].flat[0]:g} m, but expected {LOWEST:g} to "
            f"{HIGHEST:g} m, where the standard atmosphere is given: use metres above the sea, "
            f"upward, or density from elsewhere."
        )
    return density


def density_or_nan(altitude: np.ndarray) -> np.ndarray:
    """Return the density of `standard_density` [kg/m^3], NaN outside of the atmosphere."""
    is_inside = (altitude >= LOWEST) & (altitude <= HIGHEST)
    if not is_inside.all():
        altitude = np.where(is_inside, altitude, np.nan)
    sea_level_temperature = 288.15  # [K]
    tropopause = 11000.0  # [m]
    lapse = 0.0065  # [K/m] up to the tropopause, zero above
    gas_constant = 287.05287  # of dry air [J/(kg K)]
    temperature = sea_level_temperature - lapse * np.minimum(altitude, tropopause)
    exponent = STANDARD_GRAVITY / (gas_constant * lapse)
    sea_level_density = SEA_LEVEL_PRESSURE / (gas_constant * sea_level_temperature)
    density = sea_level_density * (temperature / sea_level_temperature) ** (exponent - 1.0)
    if (altitude > tropopause).any():
        height = np.maximum(altitude - tropopause, 0.0)
        density = density * np.exp(-STANDARD_GRAVITY * height / (gas_constant * temperature))
    return density
