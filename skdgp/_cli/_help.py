"""Help texts of the commands."""

DESCRIPTION = """\
Learn an aircraft's six aerodynamic coefficients from flight logs.

  python -m skdgp demo                                     simulated example flights, nothing else needed
  python -m skdgp inspect log.ulg                          what a log holds, and lacks for which step
  python -m skdgp identify a.csv b.csv --aircraft uav.json -o results
  python -m skdgp validate results/model.joblib c.csv      is the model right about another flight?
  python -m skdgp predict results/model.joblib c.csv -o coefficients.csv
  python -m skdgp simulate results/model.joblib --trim 35 -o flown
  python -m skdgp derivatives results/model.joblib --airspeed 30 35 40

COMMAND --help teaches each. SI units and radians throughout. Exit codes: 0 done, 1 an error, told in one line, 2 wrong
usage, 130 stopped by Ctrl-C.
"""

IDENTIFY = """\
Learn the coefficients CX CY CZ Cl Cm Cn from the flights TRAIN, and try the model on other flights.

 1. Inverse dynamics: forces and moments from accelerations and rates, less thrust and other known loads, over
    rho V^2 S / 2.
 2. The path of each flight is reconstructed from all its sensors, and a dependent Gaussian process learns all six
    coefficients at once from --samples rows spread over the flights.
 3. On flights it has not seen its coefficients are compared with the measured ones and flown: integrated from
    the measured state, which is taken anew every --horizons seconds.

Writes into DIR, all or none:
  report.html    tables and pictures; open it in a browser, print it
  metrics.json   the same numbers for other programs
  model.joblib   the model with its aircraft, for the other commands and skdgp.identification.load_model
  config.toml    all options of this run: --config DIR/config.toml -o ELSEWHERE runs the same again
"""

TABLES = """\
flight tables:
  CSV, Parquet or MATLAB (v7), one row per sample, SI units and radians (or units in the header, as in "alpha [deg]"):
  time, airspeed, density, alpha, beta, p, q, r, ax, ay, az (specific force, what accelerometers read),
  elevator, aileron, rudder (or elevon_left, elevon_right), throttle, and thrust_x, thrust_y, thrust_z
  (or propeller_speed, with a propeller in the aircraft's file). For the replay also phi, theta, psi,
  v_north, v_east, v_down. A column "flight" tells several flights in one file apart.
  Logs of autopilots, PX4 (.ulg) and ArduPilot (.bin), are read too; --servos tells the angles of their surfaces.

aircraft file:
  {"name": "uav", "mass": 12.0, "inertia": [[1.1, 0, -0.1], [0, 2.3, 0], [-0.1, 0, 3.1]],
   "wing_area": 1.3, "span": 2.6, "chord": 0.55}
  kg, m, kg m^2 about the centre of gravity; off the diagonal MINUS the products of inertia. Or TOML.

examples:
  python -m skdgp identify train.csv --aircraft uav.json --test test.csv -o results
  python -m skdgp identify mon.parquet tue.parquet --aircraft uav.toml -o results    (holds out the last flight)
  python -m skdgp identify kite.csv --aircraft kite.json --thrust none --external-forces tether -o results

Ctrl-C during the fit keeps the best model so far and goes on; a second one stops, and nothing is written.
A fit that is killed goes on where it was when the same command is run again: DIR/checkpoint holds what it needs.
"""

INSPECT = """\
Say what a log holds: vehicle, firmware, topics with rates and gaps, the columns that a flight table gets and where
they are from, stretches of flight, and what is missing for coefficients, reconstruction, regressors, replay.

LOG is a PX4 ULog (.ulg), an ArduPilot DataFlash log (.bin), or a table (.csv, .parquet, .mat).
"""

DEMO = """\
Do what identify does on the example flights: a simulated delta-wing UAV of 45 kg in turbulence, whose true
coefficients are known. Two flights to learn from, one to be tested on. About a minute on two cores.
"""

INSPECT_EXAMPLES = """\
examples:
  python -m skdgp inspect log.ulg
  python -m skdgp inspect log.bin --servo-template servo.toml
"""

DEMO_EXAMPLES = """\
examples:
  python -m skdgp demo
  python -m skdgp demo --samples 250 --inference exact -o quick
"""

PREDICT = """\
Write what a model says of flights: a table with flight, time, CX CY CZ Cl Cm Cn, and their standard deviations CX_std
... Cn_std, which are wider in rougher air. Rows whose regressors were not sampled are left out, with a warning.

Beside OUT.csv stands OUT.config.toml, all options of this run.
"""

PREDICT_EXAMPLES = """\
examples:
  python -m skdgp predict results/model.joblib wednesday.csv -o coefficients.csv
  python -m skdgp predict results/model.joblib a.csv b.csv -o coefficients.parquet --include-noise
"""

VALIDATE = """\
Try a model on flights that it has not seen, as identify does on its test flights: its coefficients are compared with
the measured ones, and flown: integrated from the measured state, which is taken anew every --horizons seconds.

Prints the scores, and with -o writes report.html, metrics.json and config.toml into DIR, all or none.
"""

VALIDATE_EXAMPLES = """\
examples:
  python -m skdgp validate results/model.joblib thursday.csv
  python -m skdgp validate results/model.joblib thursday.csv friday.csv -o validation --horizons 5
  python -m skdgp validate results/model.joblib thursday.csv --aircraft heavier.json --json
"""

SIMULATE = """\
Fly a model: from a moment of a log, with the controls that were logged from there on, or from a trim, with its controls
held. The mean of the model is flown, and functions drawn from its posterior, each an aircraft that the data allow:
where 95 % of them are is how sure the trajectory is. --controls TABLE flies other controls: columns time [s], the first
row the start, elevator, aileron, rudder [rad], throttle; from a trim, what the table lacks is held.

Writes into DIR, all or none:
  trajectory.csv    a flight table of the mean; "beyond" names a regressor outside of what the model was learned from,
                    "ended" says why a trajectory is over
  bands.csv         median, 2.5 % and 97.5 % of the paths over time
  trajectory.png    a picture
  simulation.json   start, end, when it ended or left what was learned from
  config.toml       all options of this run

The air is still, unless --wind says otherwise, or the log tells its wind.
"""

SIMULATE_EXAMPLES = """\
examples:
  python -m skdgp simulate results/model.joblib --flight wednesday.csv --at 120 --duration 5 -o flown
  python -m skdgp simulate results/model.joblib --trim 35 --altitude 200 --bank 0.5 -o turn
  python -m skdgp simulate results/model.joblib --trim 35 --controls doublet.csv --paths 100 -o doublet
"""

DERIVATIVES = """\
Trim the aircraft in level flight at each airspeed, and print there the stability and control derivatives of the model
(CL_alpha, Cm_q, Cn_rudder ..., rates non-dimensional: pb/2V, qc/2V, rb/2V), and the modes of its motion, each with the
standard deviation that functions drawn from the posterior tell.

With -o writes derivatives.csv, modes.csv, trims.csv, derivatives.json, config.toml and, of several airspeeds, a picture
derivatives.png into DIR, all or none.
"""

DERIVATIVES_EXAMPLES = """\
examples:
  python -m skdgp derivatives results/model.joblib --airspeed 35
  python -m skdgp derivatives results/model.joblib --airspeed 30 35 40 --axes stability -o sweep
"""
