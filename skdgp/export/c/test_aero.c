/* Compares aero.c with the model that wrote it, and measures the time of a row. */
#include "aero.h"

#include <math.h>
#include <stddef.h>
#include <stdio.h>
#include <time.h>

#define VECTORS ${n}
#define TOLERANCE ${tolerance}

${tables}

static double larger(double worst, double error, double size)
{
    error = fabs(error) / size;
    return error > worst || error != error ? error : worst; /* NaN is an error */
}

static double microseconds(int with_std)
{
    double mean[AERO_OUTPUTS], std[AERO_OUTPUTS];
    const clock_t start = clock();
    int rows = 0;
    for (; clock() - start < CLOCKS_PER_SEC / 10; rows++)
        aero_predict(at[rows % VECTORS], mean, with_std ? std : NULL);
    return 1e6 * (double)(clock() - start) / CLOCKS_PER_SEC / rows;
}

int main(void)
{
    double mean_error = 0, std_error = 0, slope_error = 0;
    int n, i, k, wrong = 0;
    for (n = 0; n < VECTORS; n++) {
        double mean[AERO_OUTPUTS], alone[AERO_OUTPUTS], std[AERO_OUTPUTS], slope[AERO_OUTPUTS][AERO_INPUTS];
        aero_predict(at[n], mean, std);
        aero_predict(at[n], alone, NULL);
        aero_gradient(at[n], slope);
        wrong += aero_beyond(at[n]) != beyond[n];
        for (i = 0; i < AERO_OUTPUTS; i++) {
            wrong += alone[i] != mean[i];
            mean_error = larger(mean_error, mean[i] - model_mean[n][i], mean_size[i]);
            std_error = larger(std_error, std[i] - model_std[n][i], std_size[n][i]);
            for (k = 0; k < AERO_INPUTS; k++)
                slope_error = larger(slope_error, slope[i][k] - model_slope[n][i][k], slope_size[i][k]);
        }
    }
    printf("largest relative errors: mean %.2g, deviation %.2g, slope %.2g\n", mean_error, std_error, slope_error);
    printf("time of a row: mean %.3g us, with deviation %.3g us\n", microseconds(0), microseconds(1));
    if (wrong || !(mean_error < TOLERANCE && std_error < TOLERANCE && slope_error < TOLERANCE)) {
        printf("FAILED: %d other values differ, and errors are to be below %g\n", wrong, TOLERANCE);
        return 1;
    }
    printf("passed: ${n} points\n");
    return 0;
}
