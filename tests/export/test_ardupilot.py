"""ArduPilot's plane and Gazebo's AdvancedLiftDrag, as their sources compute them, from the files."""

import json
import xml.etree.ElementTree as ET

import numpy as np
import pytest

from skdgp.export import write_ardupilot, write_gazebo


@pytest.fixture(scope="module")
def model(fitted):
    return fitted("trend")


def plane(c, X):
    """Return body-axis coefficients (n, 6) of SITL's plane below stall; its controls are from -1 to 1."""
    alpha, beta, p, q, r, elevator, aileron, rudder = np.asarray(X).T
    e, a, d = -elevator / c["deltae_max"], aileron / c["deltaa_max"], -rudder / c["deltar_max"]
    polar = c["c_lift_0"] + c["c_lift_a"] * alpha
    lift = polar + c["c_lift_q"] * q + c["c_lift_deltae"] * e
    drag = (
        c["c_drag_p"] + polar**2 / (np.pi * c["oswald"] * c["b"] ** 2 / c["s"]) + c["c_drag_q"] * q
    )

    def lateral(k):
        return (
            c[f"c_{k}_0"] + c[f"c_{k}_b"] * beta + c[f"c_{k}_p"] * p + c[f"c_{k}_r"] * r
            + c[f"c_{k}_deltaa"] * a + c[f"c_{k}_deltar"] * d
        )  # fmt: skip

    pitch = c["c_m_0"] + c["c_m_a"] * alpha + c["c_m_q"] * q + c["c_m_deltae"] * e
    sine, cosine = np.sin(alpha), np.cos(alpha)
    return np.stack([
        lift * sine - drag * cosine, lateral("y"), -lift * cosine - drag * sine, lateral("l"), pitch, lateral("n"),
    ], axis=-1)  # fmt: skip


def test_stated_loss_of_the_plane_is_that_of_the_file(model, uav, regressors, tmp_path):
    loss = write_ardupilot(tmp_path / "uav.json", model, uav)
    values = json.loads((tmp_path / "uav.json").read_text())
    off = plane(values, regressors) - model.predict(regressors)
    np.testing.assert_allclose(
        np.sqrt(np.mean(off**2, axis=0)), loss["loss"], rtol=1e-6, atol=1e-12
    )
    assert values["loss"]["Cm"]["loss"] == pytest.approx(loss.loc["Cm", "loss"])
    assert (
        loss.loc[["CY", "Cl", "Cm", "Cn"], "loss"]
        < 0.1 * loss.loc[["CY", "Cl", "Cm", "Cn"], "spread"]
    ).all()


def test_controls_of_the_plane_have_ardupilots_signs(model, uav, tmp_path):
    """Elevator raises the nose, aileron rolls right, rudder yaws right; and the aircraft is stable."""
    write_ardupilot(tmp_path / "uav.json", model, uav)
    values = json.loads((tmp_path / "uav.json").read_text())
    assert all(
        values[name] > 0 for name in ("c_m_deltae", "c_l_deltaa", "c_n_deltar", "c_lift_a", "c_n_b")
    )
    assert all(values[name] < 0 for name in ("c_m_a", "c_m_q", "c_l_p", "c_n_r", "c_y_b"))


def test_gazebo_has_the_stated_loss_and_the_inertia(model, uav, regressors, tmp_path):
    loss = write_gazebo(tmp_path / "uav.sdf", model, uav)
    root = ET.parse(tmp_path / "uav.sdf").getroot()
    plugin = root.find("model/plugin")
    c = {element.tag: float(element.text) for element in plugin if element.text.strip() and element[:] == []
         and element.tag not in ("forward", "upward", "cp", "link_name")}  # fmt: skip
    X = regressors.to_numpy()
    alpha, beta, p, q, r = X[:, :5].T
    deflection = dict(zip(("elevator", "aileron", "rudder"), X[:, 5:].T, strict=True))
    assert [place.find("name").text for place in plugin.iter("control_surface")] == list(deflection)

    def total(key, rates=True):
        found = c.get(f"{key}0", 0.0) + c.get(f"{key}a", 0.0) * alpha + c.get(f"{key}b", 0.0) * beta
        for place in plugin.iter("control_surface"):
            found = found + float(place.find(f"{key}_ctrl").text) * np.degrees(
                deflection[place.find("name").text]
            )
        return found + rates * (c[f"{key}p"] * p + c[f"{key}q"] * q + c[f"{key}r"] * r)

    lift = total("CL")
    drag = total("CD") + total("CL", rates=False) ** 2 / (np.pi * c["AR"] * c["eff"])
    sine, cosine = np.sin(alpha), np.cos(alpha)
    found = np.stack([lift * sine - drag * cosine, total("CY"), -lift * cosine - drag * sine,
                      total("Cell"), total("Cem"), total("Cen")], axis=-1)  # fmt: skip
    off = found - model.predict(regressors)
    np.testing.assert_allclose(
        np.sqrt(np.mean(off**2, axis=0)), loss["loss"], rtol=1e-6, atol=1e-12
    )
    inertia = {e.tag: float(e.text) for e in root.find("model/link/inertial/inertia")}
    assert inertia["ixz"] == pytest.approx(
        -uav.inertia[0, 2]
    )  # the axes are x forward, y left, z up
    assert inertia["iyz"] == pytest.approx(uav.inertia[1, 2])
    assert float(root.find("model/link/inertial/mass").text) == uav.mass
