/* The aircraft: six degrees of freedom over a flat earth, with the coefficients of aero.c.
 *
 * The equations, their units and signs are those of skdgp.dynamics.simulate. The state x is: position north, east,
 * down; velocity over the ground in body axes; quaternion body to earth, scalar first; rates.
 */
#include "aero.c"

#define FMU_TOKEN "${token}"
#define FMU_STATES 13
#define IMPLICIT ${n_implicit} /* regressors that follow from the loads */
#define ACCELERATIONS 8        /* alpha_dot beta_dot p_dot q_dot r_dot ax ay az */
#define MOST_ITERATIONS 60
#define GRAVITY 9.80665

/* Variables in the order of their value references. Kinds: t time, s start and state, p parameter, i input, o output,
 * d deviation. */
${tables}

static double largest_step(const double v[])
{
    return v[V_dt];
}

/* a in earth axes for a in body axes, or the reverse with sign -1. */
static void turn(const double q[4], double sign, const double a[3], double b[3])
{
    const double w = q[0], x = sign * q[1], y = sign * q[2], z = sign * q[3];
    const double s = 2 / (w * w + x * x + y * y + z * z);
    const double cx = s * (y * a[2] - z * a[1]), cy = s * (z * a[0] - x * a[2]), cz = s * (x * a[1] - y * a[0]);
    b[0] = a[0] + w * cx + y * cz - z * cy;
    b[1] = a[1] + w * cy + z * cx - x * cz;
    b[2] = a[2] + w * cz + x * cy - y * cx;
}

static void cross(const double a[3], const double b[3], double c[3])
{
    c[0] = a[1] * b[2] - a[2] * b[1];
    c[1] = a[2] * b[0] - a[0] * b[2];
    c[2] = a[0] * b[1] - a[1] * b[0];
}

/* Density of the International Standard Atmosphere, NaN outside of it. */
static double air_density(double altitude)
{
    static const double base[] = ${base}, lapse[] = ${lapse};
    static const double temperature[] = ${temperature}, pressure[] = ${pressure};
    const int layer = (altitude > base[1]) + (altitude > base[2]);
    const double rise = altitude - base[layer];
    const double power = -${gas} / ${gravity} * lapse[layer];
    const double depth = -rise / (${gas} * temperature[layer] / ${gravity});
    const double ratio = power == 0 ? exp(depth) : exp(log1p(power * depth) / power);
    if (!(altitude > ${lowest} && altitude < ${highest}))
        return NAN;
    return pressure[layer] * ratio / (${gas} * (temperature[layer] + lapse[layer] * rise));
}

/* Velocity relative to the air, and the wind, in body axes. */
static void air(const double v[], const double x[], double velocity[3], double wind[3])
{
    int k;
    turn(x + 6, -1, &v[V_wind_north], wind);
    for (k = 0; k < 3; k++)
        velocity[k] = x[3 + k] - wind[k];
}

/* The state of the start values. */
static void begin(const double v[], double x[])
{
    const double c1 = cos(v[V_phi] / 2), c2 = cos(v[V_theta] / 2), c3 = cos(v[V_psi] / 2);
    const double s1 = sin(v[V_phi] / 2), s2 = sin(v[V_theta] / 2), s3 = sin(v[V_psi] / 2);
    int k;
    for (k = 0; k < 6; k++)
        x[k] = v[V_north + k];
    x[6] = c1 * c2 * c3 + s1 * s2 * s3;
    x[7] = s1 * c2 * c3 - c1 * s2 * s3;
    x[8] = c1 * s2 * c3 + s1 * c2 * s3;
    x[9] = c1 * c2 * s3 - s1 * s2 * c3;
    for (k = 0; k < 3; k++)
        x[10 + k] = v[V_p + k];
}

/* Sets the variables that follow from the state and the wind; returns why the flight cannot go on, or NULL. */
static const char *arrive(double v[], const double x[])
{
    const double q0 = x[6], q1 = x[7], q2 = x[8], q3 = x[9];
    const double sine = 2 * (q0 * q2 - q1 * q3) / (q0 * q0 + q1 * q1 + q2 * q2 + q3 * q3);
    double a[3], wind[3];
    int k, fine = 1;
    for (k = 0; k < 6; k++)
        v[V_north + k] = x[k];
    for (k = 0; k < 3; k++)
        v[V_p + k] = x[10 + k];
    v[V_phi] = atan2(2 * (q0 * q1 + q2 * q3), q0 * q0 - q1 * q1 - q2 * q2 + q3 * q3);
    v[V_theta] = asin(sine > 1 ? 1 : sine < -1 ? -1 : sine);
    v[V_psi] = atan2(2 * (q0 * q3 + q1 * q2), q0 * q0 + q1 * q1 - q2 * q2 - q3 * q3);
    turn(x + 6, 1, x + 3, &v[V_v_north]);
    air(v, x, a, wind);
    v[V_airspeed] = sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2]);
    v[V_alpha] = atan2(a[2], a[0]);
    v[V_beta] = atan2(a[1], hypot(a[0], a[2]));
    v[V_altitude] = -x[2];
    v[V_density] = air_density(v[V_altitude]);
    for (k = 0; k < FMU_STATES; k++)
        fine = fine && isfinite(x[k]);
    for (k = 0; k < 3; k++)
        fine = fine && fabs(x[3 + k]) < ${fastest} && fabs(x[10 + k]) < ${spinning};
    return !fine                           ? "the flight has ended: it diverged"
           : v[V_airspeed] < ${slowest}    ? "the flight has ended: airspeed under ${slowest} m/s"
           : isnan(v[V_density])           ? "the flight has ended: outside of the atmosphere"
                                           : NULL;
}

/* Force and moment of the propulsion. */
static void propulsion(const double v[], double force[3], double moment[3])
{
    static const double direction[3] = ${direction}, arm[3] = ${arm};
    double thrust = 0, torque = 0;
    int k;
${propulsion}
    for (k = 0; k < 3; k++) {
        force[k] = thrust * direction[k] + v[V_thrust_x + k];
        moment[k] = thrust * arm[k] + torque * direction[k] + v[V_thrust_l + k];
    }
}

/* Regressors of the variables. */
static void regressors(const double v[], double input[])
{
    double source[AERO_SOURCES];
    int k;
    for (k = 0; k < AERO_SOURCES; k++)
        source[k] = v[place[k]];
    aero_inputs(source, input);
}

/* Newton and Euler: sets the coefficients, the rates of the state, and the accelerations that follow from them. */
static void respond(double v[], const double slope[], const double x[], double rate[], double found[])
{
    static const double inertia[3][3] = ${inertia}, inverse[3][3] = ${inverse};
    const double *velocity = x + 3, *omega = x + 10;
    const double load = 0.5 * v[V_density] * v[V_airspeed] * v[V_airspeed] * AERO_WING_AREA;
    const double length[3] = {AERO_SPAN, AERO_CHORD, AERO_SPAN};
    const double q0 = x[6], q1 = x[7], q2 = x[8], q3 = x[9], s = 2 / (q0 * q0 + q1 * q1 + q2 * q2 + q3 * q3);
    const double down[3] = {s * (q1 * q3 - q2 * q0), s * (q2 * q3 + q1 * q0), 1 - s * (q1 * q1 + q2 * q2)};
    double input[AERO_INPUTS], mean[AERO_OUTPUTS], force[3], moment[3], spin[3] = {0, 0, 0}, turning[3], gyro[3];
    double a[3], wind[3], carried[3], blow[3], across, along;
    int k, l;
    regressors(v, input);
    aero_predict(input, mean, NULL);
    for (k = 0; k < 6; k++)
        v[V_CX + k] = mean[coefficient[k]];
    propulsion(v, force, moment);
    for (k = 0; k < 3; k++) {
        force[k] += load * v[V_CX + k];
        moment[k] += load * length[k] * v[V_Cl + k];
        for (l = 0; l < 3; l++)
            spin[k] += inertia[k][l] * omega[l];
    }
    cross(omega, velocity, turning);
    cross(omega, spin, gyro);
    turn(x + 6, 1, velocity, rate);
    for (k = 0; k < 3; k++) {
        rate[3 + k] = force[k] / AERO_MASS + GRAVITY * down[k] - turning[k];
        rate[10 + k] = 0;
        for (l = 0; l < 3; l++)
            rate[10 + k] += inverse[k][l] * (moment[l] - gyro[l]);
    }
    rate[6] = -0.5 * (q1 * omega[0] + q2 * omega[1] + q3 * omega[2]);
    rate[7] = 0.5 * (q0 * omega[0] + q2 * omega[2] - q3 * omega[1]);
    rate[8] = 0.5 * (q0 * omega[1] + q3 * omega[0] - q1 * omega[2]);
    rate[9] = 0.5 * (q0 * omega[2] + q1 * omega[1] - q2 * omega[0]);
    /* The acceleration relative to the air, and with it alpha_dot and beta_dot. */
    air(v, x, a, wind);
    cross(omega, wind, carried);
    turn(x + 6, -1, &slope[V_wind_north], blow);
    for (k = 0; k < 3; k++)
        carried[k] += rate[3 + k] - blow[k];
    across = hypot(a[0], a[2]);
    along = (a[0] * carried[0] + a[1] * carried[1] + a[2] * carried[2]) / (v[V_airspeed] * v[V_airspeed]);
    found[0] = (a[0] * carried[2] - a[2] * carried[0]) / (across * across);
    found[1] = (carried[1] - a[1] * along) / across;
    for (k = 0; k < 3; k++) {
        found[2 + k] = rate[10 + k];
        found[5 + k] = force[k] / AERO_MASS;
    }
}

/* Rates of the state; regressors that follow from the loads by the method of Broyden (1965). */
static const char *flow(double v[], const double slope[], const double x[], double rate[])
{
    double found[ACCELERATIONS];
    const char *reason = arrive(v, x);
    int k;
    if (reason != NULL)
        return reason;
#if IMPLICIT
    double off[IMPLICIT] = {0}, last[IMPLICIT], move[IMPLICIT] = {0}, inverse[IMPLICIT][IMPLICIT] = {{0}}, worst = 0;
    int l, n;
    for (k = 0; k < IMPLICIT; k++)
        if (!isfinite(v[V_alpha_dot + implicit[k]]))
            v[V_alpha_dot + implicit[k]] = 0;
    for (n = 0; n < MOST_ITERATIONS; n++) {
        respond(v, slope, x, rate, found);
        worst = 0;
        for (k = 0; k < IMPLICIT; k++) {
            last[k] = off[k];
            off[k] = found[implicit[k]] - v[V_alpha_dot + implicit[k]];
            worst = fmax(worst, fabs(off[k]) / (1 + fabs(found[implicit[k]])));
            worst = isfinite(off[k]) ? worst : HUGE_VAL;
        }
        if (worst < 1e-12 || worst == HUGE_VAL)
            break;
        if (n == 0)
            for (k = 0; k < IMPLICIT; k++)
                inverse[k][k] = -1;
        else { /* the inverse of the slopes, such that it explains the last change */
            double change[IMPLICIT], row[IMPLICIT], size = 0;
            for (k = 0; k < IMPLICIT; k++) {
                change[k] = move[k];
                row[k] = 0;
                for (l = 0; l < IMPLICIT; l++) {
                    change[k] -= inverse[k][l] * (off[l] - last[l]);
                    row[k] += move[l] * inverse[l][k];
                }
            }
            for (k = 0; k < IMPLICIT; k++)
                size += row[k] * (off[k] - last[k]);
            for (k = 0; size != 0 && k < IMPLICIT; k++)
                for (l = 0; l < IMPLICIT; l++)
                    inverse[k][l] += change[k] * row[l] / size;
        }
        for (k = 0; k < IMPLICIT; k++) {
            move[k] = 0;
            for (l = 0; l < IMPLICIT; l++)
                move[k] -= inverse[k][l] * off[l];
        }
        for (k = 0; k < IMPLICIT; k++)
            v[V_alpha_dot + implicit[k]] += move[k];
    }
    if (!(worst < 1e-10))
        return "the flight has ended: no fixed point of the regressors that follow from the loads";
#else
    respond(v, slope, x, rate, found);
#endif
    for (k = 0; k < ACCELERATIONS; k++)
        v[V_alpha_dot + k] = found[k];
    for (k = 0; k < FMU_STATES; k++)
        if (!isfinite(rate[k]))
            return "the flight has ended: it diverged";
    return NULL;
}

static void observe(double v[], const double slope[], const double x[], int deviations)
{
    double rate[FMU_STATES], input[AERO_INPUTS], mean[AERO_OUTPUTS], std[AERO_OUTPUTS];
    unsigned long outside;
    int k;
    if (flow(v, slope, x, rate) != NULL)
        return;
    regressors(v, input);
    v[V_beyond] = 0;
    for (outside = aero_beyond(input); outside; outside &= outside - 1)
        v[V_beyond]++;
    if (!deviations)
        return;
    aero_predict(input, mean, std);
    for (k = 0; k < 6; k++)
        v[V_CX_std + k] = std[coefficient[k]];
}
