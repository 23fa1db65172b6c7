"""Findings of flights and of models of aircraft: a row for each kind, with its one wording and its severity."""

from __future__ import annotations

from skdgp._compute.findings import Finding as Finding
from skdgp._compute.findings import Kind, Severity
from skdgp._compute.findings import clauses_of as clauses_of
from skdgp._compute.findings import texts_of as texts_of
from skdgp._compute.findings import with_codes as with_codes

NOTE = Severity.NOTE
ASSUMPTION = Severity.ASSUMPTION
DOUBT = Severity.DOUBT
PLACE = " ({start:.2f} to {end:.2f} s, {samples} samples)"
NOT_MEASURED = ": not measured"


class Code(Kind):
    """Kinds of findings; a new check adds its row."""

    # faults of a channel of a log
    GAP = "[flight {flight}: ]{channel} jumps forward {times} x, by {longest:.3g} s at most" + PLACE
    MISSING = (
        "[flight {flight}: ]{channel} has no value in {times} gap(s) of at most {longest:.2g} s"
        + PLACE
    )
    NEVER_MEASURED = "[flight {flight}: ]{channel} has no value" + PLACE
    STUCK = (
        "[flight {flight}: ]{channel} is stuck at {value:.4g}"
        + PLACE
        + NOT_MEASURED
        + "; where it truly stood still, name the column in ignore"
    )
    IMPOSSIBLE = (
        "[flight {flight}: ]{channel} has impossible values, such as {value:.4g}"
        + PLACE
        + NOT_MEASURED
        + "; write missing values as empty cells"
    )
    SPIKE = (
        "[flight {flight}: ]{channel} leaps from its neighbours and back {times} x"
        + PLACE
        + NOT_MEASURED
    )
    CLIPPED = (
        "[flight {flight}: ]{channel} is cut off at {value:.4g}"
        + PLACE
        + NOT_MEASURED
        + "; the range of the sensor, or of the recorder, ends there"
    )
    CONSTANT = (
        "[flight {flight}: ]{channel} never changes, while {moving:short} moved"
        + PLACE
        + ": a dead sensor, or none: drop the column unless the flight was simulated so"
    )
    JUMP = (
        "[flight {flight}: ]{channel} jumps by up to {size:.2g} rad within a step, which the gyros do not show"
        + PLACE
        + ": a reset of the attitude, another estimator, or another flight; leave out the rows around it, or name "
        "the flights in a column flight"
    )
    # all faults of a log, by their treatment
    FAULTS_BRIDGED = (
        "faults in the log: {faults:grouped}",
        "Faulty values are NaN, gaps up to {longest_bridge:g} s are interpolated; "
        "skdgp.preprocessing.inspect_flight shows all.",
    )
    FAULTS_EXCLUDED = (
        "faults in the log: {faults:grouped}",
        "The coefficients are not known there (NaN); skdgp.preprocessing.inspect_flight shows all.",
    )

    # flights
    CONTRADICTION = (
        "[flight {flight}: ]{channels: or } is probably wrong: "
        "[the slope of {y} over {x} is {slope:.3g} ± {std:.2g}, but expected {expected}]"
        "[{y} is {lag:.2g} ± {std:.2g} s late against {x}][: {causes: or }?]"
        " (t = {t:.1f}, correlation {correlation:.2f}, {effective_samples:.0f} effective samples)",
        "[{is_turned:A turned sign in a table is mended by table.NAME *= -1 and table.to_csv of pandas.}]"
        "[{is_surface: Of surfaces of an autopilot's log by servos 'full throw, reversed NAME', or NAME = \"-25 deg\" "
        "in the servo file.}]",
    )
    CHANNELS_TOGETHER = (
        "[flight {flight}: ]channels are probably[ exchanged ({exchanged:, })][ of the other sign ({turned:, })]"
        "[ late by about {lag:.2g} s ({late:, })][, as in axes {axes}]",
        "[{is_frame:Body axes are forward, right, down, those of the earth north, east, down.}]"
        "[ Signs of {turned:, } in a table are turned by table.NAME *= -1 and table.to_csv of pandas.]"
        "[{from_east: The heading counts from north to the right: write pi/2 - psi.}]"
        "[Bring {late:, } to the clock of the others: numpy.interp(time + delay, time, column).]",
    )
    WRONG_CLOCK = (
        "[flight {flight}: ]time is probably wrong: rows come at {rate:.3g} Hz by time, "
        "at {true_rate:.3g} Hz by the motion",
        "Gyros against attitude, and velocities against accelerometers or positions, differ by this one factor.",
    )
    STUCK_SURFACE = (
        "[flight {flight}: ]{channels: or } may be stuck: it stands still in {percent:.0f} % of the rows, where "
        "{y} differs {ratio:.2g} times as much from what explains it elsewhere",
        "Leave out these rows, unless the surface stood still in gusts.",
    )
    LARGE_SURFACES = (
        "got surfaces in rad up to {largest:.2f}, more than most servos reach",
        "If these are commands from -1 to 1, multiply each by its largest deflection [rad].",
    )
    SLOW_LOG = (
        "flights have only {rate:.2g} rows a second",
        "The fast modes and lags of surfaces need 20 or more, so derivatives of the rates are not known from them: "
        "read the log on board in place of telemetry.",
    )
    TIMES_RESTORED = (
        "times of flight {flight!r} are rounded to about {resolution:.2g} s",
        "They are put on the uniform clock that they were rounded from.",
        NOTE,
    )
    ON_GROUND = (
        "of {flight!r} {percent:.0f} % of the rows stand on the ground, and are left out",
        "read_flight(path, airborne=False) keeps them.",
    )
    NO_ELEVATOR = (
        "got flights without an elevator",
        "Its effect goes into the coefficients of alpha and q, so Cm_q and Cm_alpha may be wrong, even in "
        "sign. Give the column elevator.",
    )
    ROWS_LEFT_OUT = (
        "flight {flight!r}: {left_out} of {rows} rows are left out[, because regressors are missing there "
        "(by rows: {missing})][; {alone} stand alone between gaps]",
        "If these are many, bring slow sensors to the clock of the others, and look at those that stood still.",
    )
    SENSOR_POSITIONS_DIFFER = (
        "flight {flight!r} states inertial sensors {distance:.2g} m from where the aircraft of the model has "
        "them (the centre of gravity, if it states no position)",
        "The flight's position counts. Correct the wrong one, or learn the model again.",
    )
    SLOW_CHANNELS = (
        "channels have slower clocks than the log [Hz]: {rates:.3g}",
        "A repeated sample counts once, and controls are splines between samples.",
        NOTE,
    )

    # assumptions
    ENGINE_UNEXPLAINED = (
        "got thrust=None for flights with {names: and }: the coefficients include the thrust, and no "
        "regressor explains it",
        "Name regressors with {names: or } and 'airspeed', or give the thrust.",
    )
    FULL_THROWS = (
        "surfaces are in parts of their full throw, as no servo file gives angles",
        "Effects are of a full throw.",
        ASSUMPTION,
    )
    SURFACES_ABSENT = (
        "the aircraft has no {names: and no }, as the flights have no such column",
        "If it has, give the column: the coefficients of what moves with it take its effect.",
        ASSUMPTION,
    )
    SIZES_QUESTIONED = (
        "no aeroplane has these sizes[, by flight {flight}]",
        "Outside of the limits: {laws}. Check that they are of this aircraft, and their units: is it {asked}?",
        DOUBT,
    )
    BROKEN_LAW = "{channel} is {value:.3g}, but of aeroplanes {least:g} to {most:g}"
    ASKED_SIZE = "{channel} {given:.4g} [{unit}, which is {value:.4g} ]{si_unit}"
    SIZES_ESTIMATED = (
        "sizes of the aircraft, with standard deviations: {sizes:.3g}",
        "Their part in errors of derivatives: the column ± of aircraft (std_aircraft).",
        ASSUMPTION,
    )
    SIZES_SOURCES = "sources of estimates: {sources}", "", ASSUMPTION
    THRUST_IN_COEFFICIENTS = (
        "neither columns (thrust, or thrust_x, thrust_y, thrust_z) nor a propeller and its speed give the "
        "thrust, so it is part of the coefficients: CX is thrust less drag, which the model does not tell apart",
        "Throttle and airspeed are regressors if held-out parts show them.",
        ASSUMPTION,
    )

    # training and test
    ALREADY_LEARNED = (
        "the model learned from a flight {flight!r}",
        "If it is this one, its errors say nothing about others.",
    )
    HELD_OUT_FLIGHT = (
        "no test flight was named: the last flight, {flight}, is held out and tested on",
        "",
        ASSUMPTION,
    )
    HELD_OUT_QUARTER = (
        "no test flight was named: the last quarter of {flight} is held out and tested on",
        "",
        ASSUMPTION,
    )
    OTHER_VERSIONS = (
        "got {path}, written with {differences}: its predictions may differ",
        "Compare a few, fit it again, or install those versions.",
    )
    FLIGHT_TWICE = (
        "flight {flight!r} repeats flight {other!r} (its rows or its attitude), and counts once"
    )
    COPY_LEFT_OUT = (
        "test flight {flight!r} repeats training flight {other!r} (its rows or its attitude), "
        "and is left out"
    )
    TESTED_ON_COPY = (
        "test flight {flight!r} repeats training flight {other!r} (its rows or its attitude)",
        "Its errors say nothing about other flights: test on another one.",
    )

    # changes since the training flights
    CHANGED = (
        "flight {flight}: the aircraft has changed (p = {p:.2g}; ± one standard deviation)[, likely all forces "
        "{forces:+.0%} (mass, wing area or airspeed?)][, likely {likely:+.2g}]",
        "",
        NOTE,
    )
    CHANGE_UNKNOWN = (
        "flight {flight}: whether the aircraft has changed is not known, as it or the training flights are too short",
        "",
        NOTE,
    )
    NO_CHANGE = (
        "flight {flight}: no change found (p = {p:.2g})[; smaller changes of controls than these would not show: "
        "{hidden:.0%}]",
        "",
        NOTE,
    )

    # transformers
    AIRSPEED_CORRECTED = (
        "the airspeed has an error of {percent:+.3g} ± {std_percent:.2g} %, by the velocity over the ground "
        "in a steady wind, and is corrected",
        "Calibrate the pitot tube, or check the density.",
        NOTE,
    )
    VIBRATION = (
        "the specific forces vibrate beyond {band:.2g} Hz, where the aircraft does not move",
        "Coefficients and regressors were filtered to that frequency, and errors of test flights are within it.",
        NOTE,
    )
    AIR_NOT_CONVERGED = (
        "the estimate of the motion of the air did not converge",
        "[Channels contradict each other: {contradictions}.]"
        "[{agrees:The channels agree by physics. Give longer flights with inputs of every surface, and look at "
        "vibration of the accelerometers, whether velocity and attitude are of one estimator, and whether the "
        "inertial sensors stand in the axes of the attitude (ArduPilot's AHRS_TRIM).}]",
        NOTE,
    )
    AIR_NOT_ESTIMATED = "{error}"
    SENSORS_ELSEWHERE = (
        "by the motion of the flights the inertial sensors are {distance:.2g} m from the position that was "
        "given, or from the centre of gravity if none was given",
        "Bands are wider by it: measure the position.",
    )
    TRUTH_AS_REGRESSORS = (
        "regressors {names!r} are noise-free truth of a simulation, which no aircraft has",
        "Use them only to score, or to measure the effect of sensor noise.",
    )
    CONSTANT_REGRESSORS = (
        "in the training flights {names!r} never change, so the model cannot learn their effects",
        "Fly manoeuvres that move them, or leave them out of the regressors.",
    )
    GUSTS_UNKNOWN = (
        "gusts without vanes are not known: {cause}",
        "{cause:advice}[{angles_lack_gusts: alpha and beta lack them.}]"
        "[{general_bands: Bands of derivatives are those of small aircraft in general.}]",
        DOUBT,
    )
    NO_AIRCRAFT = "no sensor measures alpha and beta, and no aircraft is given"
    LAG_UNKNOWN = (
        "surfaces are taken for deflections on the clock of the inertial unit, as flights do not show their lag"
        "[ (± {std:.2g} s)]",
        "Move each surface in steps, in records of 20 s or more with 20 rows a second or more, or give a measured lag "
        "to LagCorrector.",
        ASSUMPTION,
    )
    LAGS_CORRECTED = (
        "lags against the inertial unit, positive where late, are corrected: {lags:+.3f} [s]",
        "[{commands:The logged surfaces are commands of slower servos.}]",
        NOTE,
    )
    PATHS_NOT_CONVERGED = (
        "the paths of these flights did not converge: {flights:short}",
        "[Channels contradict each other: {contradictions}.]"
        "[{agrees:The channels agree by physics. Look at vibration, resets of the attitude, or a velocity of another "
        "source.}]",
        DOUBT,
    )
    PATHS_RECONSTRUCTED = (
        "flight paths are reconstructed from all sensors[, alpha and beta by the motion that gusts cause: "
        "{air}][, although sensors contradict each other: {contradictions}]",
        "",
        NOTE,
    )
    PATHS_SMOOTHED = (
        "flight paths are only smoothed, not reconstructed[: the flights lack {missing}]"
        "[: sensors contradict each other: {contradictions}]",
        "",
        NOTE,
    )
    SENSORS_DISAGREE = (
        "sensors contradict each other, so flight paths are not reconstructed: {contradictions}",
        "[Inertial sensors at {arm:.1f} m from the centre of gravity, or farther, explain it: give the aircraft their "
        "sensor_position.][{is_unexplained:Look at their axes, units and clocks, and at vibration.}]",
        DOUBT,
    )
    SENSOR_CONTRADICTS = (
        "{channel}[{is_smoothed: is smoothed, so its noise is not known}]"
        " (residual {residual:.2g}, noise {noise:.2g})"
    )
    SENSORS_MISSING = (
        "got flights without {names!r}, which those of the fit had: they are smoothed channel by channel "
        "(FlightSmoother), not reconstructed",
        "Expect larger errors than with those sensors.",
    )

    # fit and scores
    BANDS_TOO_NARROW = "95 % bands are too narrow: they hold {coverages:.1%} of the measured values"
    BANDS_TOO_WIDE = "95 % bands are too wide: they hold {coverages:.1%} of the measured values"
    BANDS_DO_NOT_HOLD = (
        "the bands do not hold on the test flights: {coverages:.1%} of the measured values",
        "",
        NOTE,
    )
    BY_CONSTRUCTION = (
        "{names: and } cannot be judged without {vanes: and }: the angles follow from the same accelerometers",
        "",
        NOTE,
    )
    DIVERGING = "the error is {error:.3g} of the spread, so a constant predicts better", "", NOTE
    ERRORS_SMALL = "errors are {smallest:.2f} to {largest:.2f} of the spread", "", NOTE
    ERRORS_TOO_LARGE = (
        "[only {good: } are predicted well; ]errors or bands of {poor: } are too large[: errors {errors:.2f} of the "
        "spread]"
        "[; 95 % bands hold {coverages:.1%}]",
        "",
        NOTE,
    )
    ALL_ERRORS_TOO_LARGE = ERRORS_TOO_LARGE
    LEAST_SQUARES_BETTER = (
        "least squares is better in {worse} of {coefficients} coefficients[: {names: }]"
    )
    MOMENTS_UNEXPLAINED = (
        "errors over the spread of the test flights are {errors:.2f}: what else turned the aircraft, such as "
        "gusts, may bias derivatives",
        "",
        NOTE,
    )
    NOTHING_JUDGED = "no coefficient can be judged", "", NOTE
    NOT_VARYING = (
        "in the test flights {names: } vary by less than their noise, so their errors tell nothing",
        "Test on a flight with inputs of every surface.",
    )
    TOO_LITTLE_FLOWN = (
        "learned from {seconds:.3g} s and {each:.2g} rows for each regressor: a judgement needs "
        "{least_seconds:g} s and {least_rows:g} rows",
        "",
        NOTE,
    )

    # flight mechanics
    CONTROLS_KNOWN = (
        "controls and fast modes are known to {width:.0%} or better ({widest})",
        "",
        NOTE,
    )
    CONTROLS_MISSING = (
        "no effect of the controls elevator, aileron, rudder at a trim is known",
        "",
        NOTE,
    )
    CONTROLS_TOO_UNCERTAIN = (
        "not known well enough, half of the 95 % interval over the value: {widths:.0%}",
        "",
        NOTE,
    )
    NO_DERIVATIVES = "no derivatives: {error}", "", NOTE
    NO_TRIM = (
        "no steady flight was found[ at {airspeed:.3g} m/s]",
        "The reference is the median state, and there are no modes.",
        NOTE,
    )
    TRIM_BEYOND = "the trim is outside the flown range in {names}", "", NOTE
    SIGNS_UNKNOWN = (
        "the signs of these derivatives are not known, as their 95 % bands hold zero: {values:+.2g}",
        "Fly larger inputs of every surface.",
    )
    WRONG_SIGNS = (
        "signs are not as on a conventional stable aircraft: {values:+.2g}",
        "Look at the signs of the log's surfaces and rates, at the place and the signs of the "
        "accelerometers, and at gusts without vanes.",
    )

    # simulation
    ACCELERATIONS_AS_REGRESSORS = (
        "the regressors {names} are known only after a flight",
        "",
        NOTE,
    )
    FOLLOWS = "it follows the test flights for the {horizon:.2g} s that were simulated", "", NOTE
    FOLLOWS_SHORTLY = (
        "it follows the test flights for {seconds:.2g} of {horizon:.2g} s: {late:.2g} s",
        "",
        NOTE,
    )
    FOLLOWS_TOO_SHORTLY = FOLLOWS_SHORTLY
    GUSTS_HIDE_ERRORS = (
        "not testable without their wind and gusts, which are not estimated: it follows the test flights for "
        "{seconds:.2g} s",
        "",
        NOTE,
    )
    NOT_SIMULATED = "no simulation: {error}", "", NOTE
