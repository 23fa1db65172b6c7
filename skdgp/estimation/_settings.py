"""Settings of the algorithms of state estimation, each number with its unit and source."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class PathSettings:
    """Settings of the path over the ground, `estimate_path`, and of what is judged by it.

    Settings of contradictions among sensors and of `airspeed_scale` follow those of the path.
    The sources "guess" and "trials" say whether a number was varied on simulated flights.
    """

    # correlation time of gusts [s]; guess, docs/preprocessing.md
    gust_time: float = 10.0
    # airspeed below which vanes show no angle [m/s]; guess
    least_airspeed: float = 3.0
    # prior standard deviation of the velocity where a segment begins [m/s]; wide
    start_velocity: float = 100.0
    # prior standard deviation of the attitude where a segment begins [rad]; wide
    start_attitude: float = 1.0
    # residuals that the initial noise of a sensor counts for, where a flight shows nothing; guess
    prior_count: float = 10.0
    # least noise of a sensor, as a fraction of the usual one: recorders smooth, and errors last; guess
    least_noise: float = 0.2
    # Gauss-Newton steps that may change lags by whole samples; trials
    delay_steps: int = 6
    # Gauss-Newton steps at most; trials
    max_steps: int = 40
    # steps that change the noise in full; later ones ever less, so that the search does not oscillate; trials
    full_steps: float = 10.0
    # fraction of a step that the next one takes back, above which steps are halved; trials
    overshoot: float = 0.5
    # largest change of the logarithm of a noise, and of a state in standard deviations, at the end
    tolerance: float = 0.02
    # draws from the posterior that estimate traces, an even number; trials
    n_draws: int = 32
    # weight of the gusts of the training flights [s of flight]: 2 and 5 have the best median scores
    gust_prior_seconds: float = 2.0

    # of contradictions among sensors

    # residual over the noise of a sensor of air data, above which it contradicts the others; trials
    air_ratio: float = 1.4
    # as above, of an inertial sensor: 30 s of sound sensors show up to 4.4; trials
    inertial_ratio: float = 6.0

    # of `airspeed_scale`, whose blocks have the length ``gust_time``

    # prior standard deviation of the relative error of the airspeed; guess
    airspeed_scale: float = 0.03
    # least variance of the unit vector forward that shows it: gusts turn a straight flight; a circle has 1; guess
    least_turning: float = 0.1
    # errors of the airspeed below this many standard deviations are not removed; convention
    significance: float = 2.0


@dataclass(frozen=True)
class LagSettings:
    """Settings of `estimate_lags`."""

    # lags below this many standard deviations are not removed; convention
    significance: float = 3.0
    # lags below this do not change a model [s]; trials
    least_lag: float = 0.01
    # first seconds of each flight that show lags of attitude and GPS to the millisecond [s]; trials
    path_seconds: float = 120.0
    # first rows of each flight, of 20 kB each, for these lags
    path_rows: int = 32768
    # frequencies of the response to surfaces and gusts, between trim and noise [Hz]; trials
    band: tuple[float, float] = (0.3, 4.0)
    # upper end of the band at most, over the rate of the samples
    highest: float = 0.2
    # airspeed at least, over its median: none in which rates over V diverge
    least_speed: float = 0.1
    # airspeed below this frequency scales accelerations to coefficients [Hz]; below the band
    steady_frequency: float = 0.2
    # either end of a segment that the filter or a lag may distort [s]
    edge: float = 1.5
    # least length of a segment [s], and without its ends of one with linear models of its own
    shortest: float = 6.0
    long: float = 17.0
    # longest times by which surfaces and vanes are early, and servos late [s], and by which these are late
    largest: float = 0.3
    latest: float = 0.6
    # of vanes behind the motion: factor of the standard deviation by the residuals, and error [s] for vanes that
    # motion does not explain; trials on 54 flights of small aircraft in gusts
    lack_of_motion: float = 3.0
    error_by_gusts: float = 0.1
    # step of the scan over lags [s]
    step: float = 0.02
    # precision of the lag of servos and their delay [s]; far below the step of a log
    precision: float = 1e-3
    # time within which surfaces explain a response [s], of the lag of servos; at most ``edge``
    memory: float = 1.5
    # step of the surfaces within it [s]; half a period of the upper end of the band
    memory_step: float = 0.125
    # least gain in twice the log likelihood by a delay of servos that is removed, or a limit of their rate:
    # delays of 30 to 60 ms gain 260 to 440, limits that are reached 60 to 196, others 3, vibration 18 at most;
    # trials on four aircraft
    delay_evidence: float = 40.0
    # lags and limits of the rate that are scanned, over the lag and the largest rate without a limit
    limited_lags: tuple[float, ...] = (1.0, 0.75, 0.5)
    limits: tuple[float, ...] = (0.8, 0.62, 0.47, 0.37, 0.28, 0.22, 0.17, 0.13, 0.1)
    # predictors nearer than this to a combination of others are left out, relative
    rank_tolerance: float = 1e-6
    # samples in a period of the upper end of the band
    oversampling: float = 6.0
    # pieces of all flights, each with a lag of its own
    n_pieces: int = 8
    # least number of pieces that show a standard error
    least_pieces: int = 3
    # least length of a piece [s]
    shortest_piece: float = 10.0


@dataclass(frozen=True)
class AirSettings:
    """Settings of `estimate_air_motion`."""

    # passes at most of one attempt
    max_passes: int = 45
    # samples to learn from at most, of all records
    most_samples: int = 12000
    # damping of the first step, over the information (Levenberg 1944)
    first_damping: float = 0.3


@dataclass(frozen=True)
class FilterSettings:
    """Constants of the filter-error method, chosen on simulated flights of six aircraft unless said."""

    # samples of a shortest record of flights to learn from
    fewest_samples: int = 100
    # the same of flights of a known aircraft: a step
    fewest_known: int = 2
    # rate of samples [Hz]; faster logs are thinned to 50 to 100 Hz
    sample_rate: float = 50.0
    # samples of each record, from its middle, that show the noises
    noise_samples: int = 2000

    # correlation time of errors of the path [s]; guess
    path_time: float = 10.0
    # variance of the rates of the first sample [(rad/s)^2]; wide
    start_rate_variance: float = 0.1
    # standard deviation of the mean vertical gust of a record [m/s]
    mean_gust: float = 0.2
    # slope of lift by alpha for `mean_gust` [1/rad]; typical
    lift_slope: float = 4.5
    # length of a moving mean that is longer than gusts last [s]
    gust_window: float = 20.0
    # mean airspeed of a flight times the root of its samples, standard deviation [m/s]; typical
    pitot_noise: float = 10.0
    # half of the moving mean of the rates before they are differentiated in steady wind [s]
    rate_window: float = 0.05
    # least error of a sample of the airspeed [m/s]
    least_pitot_std: float = 0.1
    # Gauss-Newton steps for the steady wind
    wind_steps: int = 5
    # least noise of accelerometers and gyros [SI]
    least_noise: float = 1e-4

    # correlation time of the motion that surfaces cause [s]
    response_time: float = 4.0
    # longest delay of the surfaces' answers to gusts [s]
    answer_time: float = 8.0
    # bins of these delays, wider the longer
    answer_bins: int = 16
    # bins of the period after a sample: surfaces between samples of a slow clock look ahead
    later_bins: int = 2
    # longest period of the samples of surfaces that their values do not show [rows]
    unseen_period: float = 4.0
    # least singular value of the instruments, relative to the largest
    least_direction: float = 1e-6

    # passes before the instruments are used, whose slopes are small far from the solution; the
    # second number where the first attempt diverges, or goes back to an earlier pass
    attempts: tuple[int, ...] = (0, 6)
    # last passes of a search that did not converge, whose spread is an error
    last_passes: int = 15
    # factor of the standard deviations of such a search; trials on flights with vibration
    unfinished: float = 2.0
    # factor of the damping from step to step
    less_damping: float = 0.25
    # factor of the fraction of a step that is taken, where steps turn back; least fraction; else
    shorter: float = 0.5
    least_fraction: float = 0.25
    longer: float = 1.4
    # squared length of the last two steps, in standard deviations of all parameters
    tolerance: float = 0.5
    # squared length of the last step of the noises
    noise_tolerance: float = 5.0
    # log likelihood for each sample that a solution may lie below the best pass: sound ones of simulated flights
    # lie up to 0.65 below, of a log 0.59, false ones 0.25 and 1.6
    lost_likelihood: float = 1.0
    # damping of steps of the noises, over the information
    noise_damping: float = 0.02
    # largest step of the logarithm of a noise; factors of this limit where steps turn back, and else
    largest_noise_step: float = 0.7
    shorter_noise_step: float = 0.5
    longer_noise_step: float = 1.3
    # farthest that the logarithm of a noise moves from its prior mean, in standard deviations: noise of
    # slow sensors resembles fast gusts
    noise_reach: float = 2.0
    # largest step of a derivative, in standard deviations of its prior
    largest_step: float = 2.0

    # variance of vibration in its second direction, over the usual noise: 18 flights that vibrate have 13 and
    # more, in 18 others fast motion has up to 5
    least_vibration: float = 10.0
    # the same over the third direction: 2.7 and more; errors of the attitude are alike in three, 1.5 at most
    vibration_ratio: float = 2.0
    # sum of the two largest eigenvalues of their correlations, of 6: 4.1 and more where an oscillation is in all,
    # 2.1 of separate noises
    least_shared: float = 3.5
    # least rate of samples [Hz]: at slower ones third differences show motion too; of 12 flights without
    # vibration 3 were taken for it at 25 Hz, none at 50 Hz
    least_vibration_rate: float = 40.0
    # factor of the standard deviations where flights vibrate; trials on these flights
    vibrating: float = 1.5

    # length of the sums of scores whose covariance is taken [s]
    block: float = 2.0
    # standard deviation of the delay of the servos [s]: those of `estimate_lags` are 3 to 5 ms
    delay_error: float = 0.005
    # correlation of errors of surfaces between samples with the motion by the surfaces; trials on two
    # aircraft with surfaces at 10 Hz, 0.05 in one
    surface_correlation: float = 0.03
    # standard deviation by effects that the model lacks, over a derivative; each of six aircraft left
    # out in turn, docs/preprocessing.md
    model_error: float = 0.04
    # errors of the path [m/s], rates [rad/s] and surfaces [rad] that look like motion; guesses
    velocity_error: float = 0.02
    rate_error: float = 0.002
    surface_error: float = 0.001
    # the same of thrust over dynamic pressure and wing area; guess
    thrust_error: float = 0.001


PATH_SETTINGS = PathSettings()
LAG_SETTINGS = LagSettings()
AIR_SETTINGS = AirSettings()
FILTER_SETTINGS = FilterSettings()
