/* Compares aero.c with the values of the pipeline. */
#include "aero.h"

#include <math.h>
#include <stddef.h>
#include <stdio.h>

#define VECTORS ${n}
#define TOLERANCE ${tolerance}

${tables}

static double larger(double worst, double error, double size)
{
    error = fabs(error) / size;
    return error > worst || error != error ? error : worst; /* NaN is an error */
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
            std_error = larger(std_error, std[i] - expected_std[n][i], std_size[i]);
            for (int k = 0; k < AERO_INPUTS; k++)
                slope_error = larger(slope_error, slope[i][k] - expected_slope[n][i][k], slope_size[i][k]);
        }
    }
    printf("largest relative errors: mean %.2g, deviation %.2g, slope %.2g\n", mean_error, std_error, slope_error);
    if (wrong || !(mean_error < TOLERANCE && std_error < TOLERANCE && slope_error < TOLERANCE)) {
        printf("FAILED: %d other values differ, and errors are to be below %g\n", wrong, TOLERANCE);
        return 1;
    }
    printf("passed: ${n} points, with the values of the pipeline\n");
    return 0;
}
