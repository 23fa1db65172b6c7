"""Flight tables of poses: the truth that the poses were made of comes back, and other frames are found out."""

from functools import cache

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from skdgp._flight.frames import air_data, quaternion_to_euler
from skdgp.io import flight_from_poses
from skdgp.io._poses import FRAMES

G = 9.80665
SPEED = 12.0


@cache
def flown(seconds=3.0, rate=100, *, heading=0.0, bank=0.6):
    """Return the truth of an aircraft whose lift n g turns it where it banks, and makes it climb and sink."""
    t = np.arange(0, seconds + 0.2, 0.001)
    phi, lift = bank * np.sin(2.0 * t), G * (1 + 0.3 * np.sin(3.0 * t))
    climb, psi = np.zeros_like(t), np.full_like(t, heading)
    for k in range(len(t) - 1):
        climb[k + 1] = climb[k] + 0.001 * (lift[k] * np.cos(phi[k]) - G * np.cos(climb[k])) / SPEED
        psi[k + 1] = psi[k] + 0.001 * lift[k] * np.sin(phi[k]) / (SPEED * np.cos(climb[k]))
    velocity = SPEED * np.stack(
        [np.cos(climb) * np.cos(psi), np.cos(climb) * np.sin(psi), -np.sin(climb)], axis=-1
    )
    position = np.concatenate(
        [np.zeros((1, 3)), np.cumsum((velocity[1:] + velocity[:-1]) * 0.0005, axis=0)]
    )
    attitude = Rotation.from_euler(
        "ZYX", np.stack([psi, climb + 0.05 + 0.04 * np.sin(4 * t), phi], axis=-1)
    )
    rates = np.gradient(attitude.as_matrix(), 0.001, axis=0)
    spin = np.einsum("nji,njk->nik", attitude.as_matrix(), rates)
    rates = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], axis=-1)
    force = attitude.inv().apply(np.gradient(velocity, 0.001, axis=0) - [0, 0, G])
    rows = slice(100, 100 + round(seconds * 1000), 1000 // rate)
    truth = dict(zip(["p", "q", "r"], rates[rows].T, strict=True))
    truth |= dict(
        zip(["p_dot", "q_dot", "r_dot"], np.gradient(rates, 0.001, axis=0)[rows].T, strict=True)
    )
    truth |= dict(zip(["ax", "ay", "az"], force[rows].T, strict=True))
    truth |= dict(zip(["u", "v", "w"], attitude.inv().apply(velocity)[rows].T, strict=True))
    truth |= dict(zip(["v_north", "v_east", "v_down"], velocity[rows].T, strict=True))
    truth |= dict(
        zip(
            ["phi", "theta", "psi"],
            quaternion_to_euler(scalar_first(attitude))[rows].T,
            strict=True,
        )
    )
    return t[rows] - t[rows][0], position[rows], attitude[rows], pd.DataFrame(truth)


@cache
def exact_table():
    """Return the table of exact poses."""
    time, position, attitude, _ = flown()
    return flight_from_poses(time, position, scalar_first(attitude), frame="NED/FRD")


@cache
def noisy_table(seconds):
    """Return noisy poses, and the table of them."""
    time, *poses, _ = flown(seconds)
    poses = noisy(*poses)
    return time, poses, flight_from_poses(time, poses[0], scalar_first(poses[1]), frame="NED/FRD")


def scalar_first(attitude):
    return attitude.as_quat()[:, [3, 0, 1, 2]]


def in_frame(frame, position, attitude):
    """Return north-east-down poses as they are logged in another frame."""
    earth, body = FRAMES[frame]
    return earth.inv().apply(position), scalar_first(earth.inv() * attitude * body.inv())


def noisy(position, attitude, seed=0):
    rng = np.random.default_rng(seed)
    shape = position.shape
    return position + rng.normal(0, 1e-3, shape), attitude * Rotation.from_rotvec(
        rng.normal(0, np.deg2rad(0.1), shape)
    )


def rms(error):
    return np.sqrt(np.mean(np.square(error)))


def test_frames_take_vectors_to_north_east_down():
    expected = {
        "NED": np.eye(3),
        "NWU": np.diag([1, -1, -1]),
        "ENU": [[0, 1, 0], [1, 0, 0], [0, 0, -1]],
    }
    for frame, (earth, body) in FRAMES.items():
        np.testing.assert_allclose(earth.as_matrix(), expected[frame[:3]], atol=1e-15)
        np.testing.assert_allclose(
            body.as_matrix(), np.diag([1, 1, 1] if "FRD" in frame else [1, -1, -1]), atol=1e-15
        )


def test_exact_poses_give_the_motion():
    table, truth = exact_table(), flown()[3]
    inner = slice(5, -5)
    for name, within in {
        "u": 1e-3,
        "w": 1e-3,
        "p": 2e-3,
        "r": 2e-3,
        "ax": 0.02,
        "ay": 0.02,
        "az": 0.05,
        "q_dot": 0.1,
    }.items():
        np.testing.assert_allclose(
            table[name][inner], truth[name][inner], atol=within, err_msg=name
        )
    np.testing.assert_allclose(np.exp(1j * table.psi), np.exp(1j * truth.psi), atol=1e-4)


def test_noise_of_a_millimetre_and_a_tenth_of_a_degree_in_records_of_three_seconds():
    """Ends included; the accuracies that docs/logs.md states are those of longer and rougher flights."""
    records = [flown(heading=heading) for heading in (0.0, 3.0)]
    tables = [
        noisy(position, attitude, seed) for seed, (_, position, attitude, _) in enumerate(records)
    ]
    time = np.concatenate([record[0] for record in records])
    position = np.concatenate([each[0] + 100 * k for k, each in enumerate(tables)])
    attitude = Rotation.concatenate([each[1] for each in tables])
    truth = pd.concat([record[3] for record in records], ignore_index=True)
    table = flight_from_poses(
        time, position, scalar_first(attitude), frame="NED/FRD", flight=np.repeat([*"ab"], 300)
    )
    limits = {
        "u": 0.01,
        "v": 0.02,
        "w": 0.02,
        "p": 0.03,
        "q": 0.03,
        "r": 0.03,
        "ax": 0.15,
        "ay": 0.15,
        "az": 0.3,
    }
    limits |= {"p_dot": 0.6, "q_dot": 0.6, "r_dot": 0.6, "v_down": 0.01}
    for name, limit in limits.items():
        assert rms(table[name] - truth[name]) < limit, name
    assert table.attrs["pose_noise"] == pytest.approx((1e-3, np.deg2rad(0.1)), rel=0.1)
    assert table.flight.unique().tolist() == ["a", "b"]


@pytest.mark.parametrize("frame", ["ENU/FLU", "NWU/FRD"])
def test_any_frame_gives_the_same_table(frame):
    time, poses, expected = noisy_table(1.0)
    table = flight_from_poses(time, *in_frame(frame, *poses), frame=frame)
    pd.testing.assert_frame_equal(table, expected, atol=1e-2)


def test_signs_of_quaternions_mean_nothing():
    time, position, attitude, _ = flown(1.0, heading=3.0)
    quaternion = scalar_first(attitude)
    signs = np.random.default_rng(0).choice([-1, 1], (len(time), 1))
    tables = [
        flight_from_poses(time, position, each, frame="NED/FRD")
        for each in (quaternion, signs * quaternion)
    ]
    pd.testing.assert_frame_equal(*tables, atol=1e-9)


@pytest.mark.parametrize("given", FRAMES)
@pytest.mark.parametrize("true", ["NED/FRD", "ENU/FRD"])
def test_a_wrong_frame_is_found_but_for_the_heading(true, given):
    time, position, attitude, _ = flown(2.0, 50)
    poses = in_frame(true, *noisy(position, attitude))
    if true[3:] == given[3:] and (true[:3] == "NED") == (given[:3] == "NED"):
        assert len(flight_from_poses(time, *poses, frame=given)) == len(time)
        return
    with pytest.raises(
        ValueError, match=f"frame='{given}' and poses with a .* try .*frame='{true}'"
    ):
        flight_from_poses(time, *poses, frame=given)


def test_level_flight_upside_down_flight_backward_and_conjugates():
    time, position, attitude, _ = flown(bank=0.0)
    turned = Rotation.from_rotvec([np.pi, 0, 0])
    with pytest.raises(ValueError, match=r"mean specific force of .10.* along the body's z axis"):
        flight_from_poses(time, position, scalar_first(attitude * turned), frame="NED/FRD")
    with pytest.raises(ValueError, match=r"mean velocity of -1.* along the nose"):
        flight_from_poses(time, -position * [1, 1, -1], scalar_first(attitude), frame="NED/FRD")
    time, position, attitude, _ = flown(heading=2.0)
    with pytest.raises(ValueError, match="try frame='NED/FRD' and conjugate quaternions"):
        flight_from_poses(time, position, scalar_first(attitude.inv()), frame="NED/FRD")


def test_a_steady_turn_names_every_frame_that_it_fits():
    """A constant bank cannot say to which side it turns the aircraft; the true frame is among those to try."""
    time = np.arange(0, 2, 0.01)
    north_west_up = np.stack(
        [5 * np.sin(time), 5 - 5 * np.cos(time), np.full(time.size, 1.5)], axis=-1
    )
    bank = np.full(time.size, -np.arctan(5 / G))
    earth, body = FRAMES["NWU/FLU"]
    attitude = earth * Rotation.from_euler("ZX", np.stack([time, bank], axis=-1)) * body
    poses = in_frame("ENU/FRD", earth.apply(north_west_up), attitude)
    with pytest.raises(
        ValueError, match=r"frame='ENU/FLU' and poses with a .* try .*frame='ENU/FRD'"
    ):
        flight_from_poses(time, *poses, frame="ENU/FLU")


def test_wind_changes_the_air_data_alone():
    time, position, attitude, truth = flown()
    wind = np.array([2.0, -1.0, 0.5])
    still = exact_table()
    windy = flight_from_poses(time, position, scalar_first(attitude), frame="NED/FRD", wind=wind)
    relative = attitude.inv().apply(truth[["v_north", "v_east", "v_down"]].to_numpy() - wind)
    for name, expected in zip(["airspeed", "alpha", "beta"], air_data(relative), strict=True):
        np.testing.assert_allclose(windy[name], expected, atol=2e-3)
    assert windy.wind_east.eq(-1.0).all()
    assert "wind_east" not in still
    same = [name for name in still if name not in ("airspeed", "alpha", "beta")]
    pd.testing.assert_frame_equal(still[same], windy[same])


def test_controls_and_density():
    time, position, attitude, _ = flown(1.0)
    controls = pd.DataFrame({"elevator": 0.3 * np.sin(time), "mode": "manual"}, index=time)
    table = flight_from_poses(
        time,
        position,
        scalar_first(attitude),
        frame="NED/FRD",
        controls=controls,
        altitude=1000.0,
        flight="x",
    )
    np.testing.assert_array_equal(table.elevator, 0.3 * np.sin(time))
    assert table["mode"].eq("manual").all()
    assert table.flight.eq("x").all()
    np.testing.assert_allclose(table.altitude, 1000 - table.down)
    np.testing.assert_allclose(table.density, 1.112, atol=5e-3)


def test_a_gap_is_not_differentiated_across():
    time, position, attitude, truth = flown()
    rows = np.r_[0:120, 180:300]
    moved = position[rows] + np.where(rows > 150, 50.0, 0.0)[:, None]
    table = flight_from_poses(time[rows], moved, scalar_first(attitude)[rows], frame="NED/FRD")
    np.testing.assert_allclose(table.v_north, truth.v_north[rows], atol=0.05)


def test_poses_that_were_not_measured_are_named():
    time, position, attitude, _ = flown()
    position, attitude = noisy(position, attitude)
    position[100:160] = position[100]
    with pytest.raises(ValueError, match=r"north is stuck .* east is stuck .* Drop these rows"):
        flight_from_poses(time, position, scalar_first(attitude), frame="NED/FRD")


def edit(name, change):
    time, position, attitude, _ = flown(1.0)
    poses = {
        "time": time,
        "position": position.copy(),
        "quaternion": scalar_first(attitude),
        "frame": "NED/FRD",
    }
    poses[name] = change(poses.get(name))
    return poses


def put(array, row, value):
    array = array.copy()
    array[row] = value
    return array


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("frame", lambda _: "FRD/NED", r"frame='FRD/NED', but expected one of \['NED/FRD'"),
        ("time", lambda t: put(t, 4, t[3]), "at row 4 .*expected time to increase"),
        (
            "time",
            lambda t: put(t, 4, np.nan),
            "time that is not finite in 1 of 100 rows .the first is row 4",
        ),
        ("time", lambda t: t[:, None], r"time of shape \(100, 1\), but expected \(100,\)"),
        ("time", lambda t: t[:5], r"position of shape \(100, 3\), but expected \(5, 3\)"),
        (
            "position",
            lambda x: put(x, 7, np.nan),
            "position that is not finite in 1 of 100 rows .the first is row 7",
        ),
        ("position", lambda x: x[:, :2], r"position of shape \(100, 2\)"),
        (
            "position",
            lambda x: np.repeat(x[::5], 5, axis=0),
            "position that repeats the row before in 81 % of the rows",
        ),
        (
            "quaternion",
            lambda q: np.repeat(q[::2], 2, axis=0),
            "quaternion that repeats the row before in 51 %",
        ),
        ("position", lambda x: 1000 * x, "divide positions in millimetres by 1000"),
        (
            "quaternion",
            lambda q: put(q, slice(3), 0.0),
            "quaternion of length 0 at row 0 .3 such rows",
        ),
        ("quaternion", lambda q: 2 * q, "length 2 at row 0 .100 such rows., but expected length 1"),
        (
            "flight",
            lambda _: np.r_[np.zeros(95), np.ones(5)],
            "5 samples of flight '1.0' from 0.95 s on",
        ),
        (
            "controls",
            lambda _: {"elevator": np.zeros(3)},
            r"controls\['elevator'\] of shape \(3,\)",
        ),
        ("controls", lambda _: {"p": np.zeros(100)}, r"controls with the columns \['p'\]"),
        ("controls", lambda _: {"elevator": np.full(100, 10.0)}, "these look like degrees"),
        ("controls", lambda _: {"time": np.zeros(100)}, r"controls with the columns \['time'\]"),
        (
            "flight",
            lambda _: ["a", "b"],
            r"flight of shape \(2,\), but expected one name or \(100,\)",
        ),
        ("wind", lambda _: 3.0, "wind=3.0, but expected three numbers"),
    ],
)
def test_bad_input(name, change, message):
    with pytest.raises(ValueError, match=message):
        flight_from_poses(**edit(name, change))
