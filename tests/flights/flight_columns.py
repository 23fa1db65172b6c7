"""Columns of a flight table by groups: the words of the tests."""

COEFFICIENTS = ["CX", "CY", "CZ", "Cl", "Cm", "Cn"]
SURFACES = ["elevator", "aileron", "rudder"]
FORCES = ["ax", "ay", "az"]
RATES = ["p", "q", "r"]
SPIN = ["p_dot", "q_dot", "r_dot"]
EULER = ["phi", "theta", "psi"]
VELOCITY = ["v_north", "v_east", "v_down"]
AIR = ["airspeed", "alpha", "beta"]
WIND = ["wind_north", "wind_east", "wind_down"]
POSITION = ["sensor_position_x", "sensor_position_y", "sensor_position_z"]
