/* Compares aero.c with the values of ${source}. */
#include "aero.h"

#include <math.h>
#include <stddef.h>
#include <stdio.h>

#define VECTORS ${n}
#define TOLERANCE ${tolerance}
#define REDUCED ${reduced} /* 1: also with those of the pipeline, within the losses of the reduced model */

${tables}

static double larger(double worst, double error, double size)
{
    error = fabs(error) / size;
    return error > worst || error != error ? error : worst; /* NaN is an error */
}

/* Whether more than half of the points differ from the pipeline by more than the root mean square loss. */
static int lossy(void)
{
    int beyond[2][AERO_OUTPUTS] = {{0}}, wrong = 0;
    for (int n = 0; n < VECTORS; n++) {
        double mean[AERO_OUTPUTS], std[AERO_OUTPUTS];
        aero_predict(at[n], mean, std);
        for (int i = 0; i < AERO_OUTPUTS; i++) {
            beyond[0][i] += !(fabs(mean[i] - pipeline_mean[n][i]) <= allowed[0][i] * pipeline_std[n][i]);
            beyond[1][i] += !(fabs(std[i] - pipeline_std[n][i]) <= allowed[1][i] * pipeline_std[n][i]);
        }
    }
    for (int i = 0; i < AERO_OUTPUTS; i++)
        wrong += beyond[0][i] > VECTORS / 2 || beyond[1][i] > VECTORS / 2;
    return wrong;
}

int main(void)
{
    double mean_error = 0, std_error = 0, slope_error = 0;
    int wrong = 0;
    for (int n = 0; n < VECTORS; n++) {
        double mean[AERO_OUTPUTS], alone[AERO_OUTPUTS], std[AERO_OUTPUTS], slope[AERO_OUTPUTS][AERO_INPUTS];
        aero_predict(at[n], mean, std);
        aero_predict(at[n], alone, NULL);
        aero_gradient(at[n], slope);
        for (int i = 0; i < AERO_OUTPUTS; i++) {
            wrong += alone[i] != mean[i];
            mean_error = larger(mean_error, mean[i] - expected_mean[n][i], mean_size[i]);
            std_error = larger(std_error, std[i] - expected_std[n][i], std_size[n][i]);
            for (int k = 0; k < AERO_INPUTS; k++)
                slope_error = larger(slope_error, slope[i][k] - expected_slope[n][i][k], slope_size[i][k]);
        }
    }
    printf("largest relative errors: mean %.2g, deviation %.2g, slope %.2g\n", mean_error, std_error, slope_error);
    if (wrong || !(mean_error < TOLERANCE && std_error < TOLERANCE && slope_error < TOLERANCE)) {
        printf("FAILED: %d other values differ, and errors are to be below %g\n", wrong, TOLERANCE);
        return 1;
    }
    if (REDUCED && lossy()) {
        printf("FAILED: %d outputs differ from the pipeline by more than the stated loss\n", lossy());
        return 1;
    }
    printf("passed: ${n} points, with the values of ${source}\n");
    return 0;
}
