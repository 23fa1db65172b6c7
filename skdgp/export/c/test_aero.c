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

/* Root mean square changes of mean and deviation from the pipeline, in its deviations; 1 if one is not allowed. */
static int lossy(void)
{
    double square[2][AERO_OUTPUTS] = {{0}};
    int wrong = 0;
    for (int n = 0; n < VECTORS; n++) {
        double mean[AERO_OUTPUTS], std[AERO_OUTPUTS];
        aero_predict(at[n], mean, std);
        for (int i = 0; i < AERO_OUTPUTS; i++) {
            const double moved = (mean[i] - pipeline_mean[n][i]) / pipeline_std[n][i];
            const double wider = std[i] / pipeline_std[n][i] - 1;
            square[0][i] += moved * moved / VECTORS;
            square[1][i] += wider * wider / VECTORS;
        }
    }
    for (int i = 0; i < AERO_OUTPUTS; i++)
        for (int m = 0; m < 2; m++)
            wrong |= !(sqrt(square[m][i]) <= allowed[m][i]);
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
        printf("FAILED: the pipeline differs by more than the stated losses\n");
        return 1;
    }
    printf("passed: ${n} points, with the values of ${source}\n");
    return 0;
}
