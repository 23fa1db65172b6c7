/* Aerodynamic coefficients of ${aircraft}, with their standard deviations.
 *
 * Posterior mean and standard deviation of Gaussian processes, written by skdgp.
 * The model was created ${created}.
 *
 * SI units and radians, body axes x forward, y right, z down. Force = dynamic pressure * AERO_WING_AREA * coefficient;
 * moment = the same times AERO_SPAN (Cl, Cn) or AERO_CHORD (Cm). Every function is reentrant and allocates nothing.
 */
#ifndef AERO_H
#define AERO_H

#ifdef __cplusplus
extern "C" {
#endif

#define AERO_SOURCES ${n_sources}
#define AERO_INPUTS ${d}
#define AERO_OUTPUTS ${P}

/* Sources, columns of a flight: ${sources}
 * Inputs, regressors:           ${inputs}
 * Outputs, coefficients:        ${outputs} */

/* Smallest and largest value of each input in the training data: outside of them nothing was learned. */
extern const double aero_limits[2][AERO_INPUTS];

/* kg, m^2, m, m; the inertia tensor about the centre of gravity in kg m^2, off its diagonal minus the products; and lag T
 * and delay tau of the servos in s, and the limit of their rate, 0 if there is none: surfaces d follow commands c by
 * T d'(t) = c(t - tau) - d(t). */
#define AERO_MASS ${mass}
#define AERO_WING_AREA ${wing_area}
#define AERO_SPAN ${span}
#define AERO_CHORD ${chord}
#define AERO_IXX ${ixx}
#define AERO_IYY ${iyy}
#define AERO_IZZ ${izz}
#define AERO_IXY ${ixy}
#define AERO_IXZ ${ixz}
#define AERO_IYZ ${iyz}
#define AERO_SERVO_LAG ${lag}
#define AERO_SERVO_DELAY ${delay}
#define AERO_SERVO_RATE ${rate}

/* Inputs of the sources: non-dimensional rates, mixed controls. */
void aero_inputs(const double source[AERO_SOURCES], double x[AERO_INPUTS]);

/* Mean of every coefficient and, unless std is NULL, its standard deviation at exact inputs, as of a simulation.
 * Noise of measured inputs with covariance S adds slope S slope^T to the variance, on most flights its larger part. */
void aero_predict(const double x[AERO_INPUTS], double mean[AERO_OUTPUTS], double std[AERO_OUTPUTS]);

/* Slopes of the means, d mean[i] / d x[k]. */
void aero_gradient(const double x[AERO_INPUTS], double slope[AERO_OUTPUTS][AERO_INPUTS]);

#ifdef __cplusplus
}
#endif

#endif
