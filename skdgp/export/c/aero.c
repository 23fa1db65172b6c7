/* See aero.h. */
#include "aero.h"

#include <math.h>
#include <stddef.h>

#define COMPONENTS ${components} /* of the average: part k * AERO_OUTPUTS + i is component k of output i */
#define FUNCTIONS ${functions} /* of the largest basis, at least 1 */
#define ROUNDING 2.220446049250313e-16

/* Gaussian functions gain * exp(-|f z - centre|^2 / 2), one for each of size centres from a place on. */
typedef struct {
    int first, size, place;
    double gain;
} term;

/* Posterior of an output by a component: its terms, functions, columns of T and R, and arrays of the portable model. */
typedef struct {
    int first_term, last_term, n_functions, n_columns, n_prior;
    const double *weights, *root, *trend_prior, *trend_root;
} posterior;

${tables}

static void scaled(const double x[], double z[])
{
    for (int k = 0; k < AERO_INPUTS; k++)
        z[k] = (x[k] - shift[k]) / scale[k];
}

/* u = f z, f of term b */
static void projected(int b, const double z[], double u[])
{
    for (int k = 0; k < AERO_INPUTS; k++)
        u[k] = term_inverse_widths[b][k] * z[k];
}

/* Function c of term b at u. */
static double function(int b, int c, const double u[])
{
    const double *centre = centres[terms[b].place + c];
    double square = 0;
    for (int k = 0; k < AERO_INPUTS; k++)
        square += (u[k] - centre[k]) * (u[k] - centre[k]);
    return terms[b].gain * exp(-square / 2);
}

void aero_inputs(const double source[AERO_SOURCES], double x[AERO_INPUTS])
{
${formulas}
}

/* The normalised mean of a part and, unless variance is NULL, its variance; g has space for its basis. */
static double part(int j, const double z[], const double p[], double g[], double *variance)
{
    const posterior *q = &parts[j];
    const int n = q->n_functions, rank = q->n_columns;
    const double *R = q->trend_prior, *T = q->trend_root, *U = q->root;
    double u[AERO_INPUTS], value = 0, prior = prior_variance[j], explained = 0;
    for (int c = 0; c < n; c++)
        g[c] = 0;
    for (int b = q->first_term; b < q->last_term; b++) {
        projected(b, z, u);
        for (int c = 0; c < terms[b].size; c++)
            g[terms[b].first + c] += function(b, c, u);
    }
    for (int k = 0; k <= AERO_INPUTS; k++)
        value += p[k] * trend_weights[j][k];
    for (int c = 0; c < n; c++)
        value += g[c] * q->weights[c];
    if (variance == NULL)
        return value;
    for (int r = 0; r < q->n_prior; r++) {
        double half = 0;
        for (int k = 0; k <= AERO_INPUTS; k++)
            half += p[k] * *R++;
        prior += half * half;
    }
    for (int r = 0; r < rank; r++) {
        double half = 0;
        for (int k = 0; k <= AERO_INPUTS; k++)
            half += p[k] * *T++;
        for (int c = 0; c <= r - (rank - n); c++) /* a column of the triangle */
            half += g[c] * *U++;
        explained += half * half;
    }
    *variance = prior - explained > ROUNDING * prior ? prior - explained : ROUNDING * prior;
    return value;
}

void aero_predict(const double x[AERO_INPUTS], double mean[AERO_OUTPUTS], double std[AERO_OUTPUTS])
{
    double z[AERO_INPUTS], p[AERO_INPUTS + 1], g[FUNCTIONS] = {0}, value[COMPONENTS], variance[COMPONENTS];
    scaled(x, z);
    p[0] = 1;
    for (int k = 0; k < AERO_INPUTS; k++)
        p[k + 1] = z[k];
    for (int i = 0; i < AERO_OUTPUTS; i++) {
        double total = 0, spread = 0;
        for (int m = 0; m < COMPONENTS; m++) {
            value[m] = part(m * AERO_OUTPUTS + i, z, p, g, std == NULL ? NULL : &variance[m]);
            total += mixture[m][i] * value[m];
        }
        mean[i] = center[i] + output_scale[i] * total;
        if (std == NULL)
            continue;
        for (int m = 0; m < COMPONENTS; m++)
            spread += mixture[m][i] * (variance[m] + (value[m] - total) * (value[m] - total));
        std[i] = output_scale[i] * sqrt(spread);
    }
}

void aero_gradient(const double x[AERO_INPUTS], double slope[AERO_OUTPUTS][AERO_INPUTS])
{
    double z[AERO_INPUTS], u[AERO_INPUTS], pull[AERO_INPUTS], sum[AERO_INPUTS];
    scaled(x, z);
    for (int i = 0; i < AERO_OUTPUTS; i++) {
        for (int k = 0; k < AERO_INPUTS; k++)
            sum[k] = 0;
        for (int j = i; j < COMPONENTS * AERO_OUTPUTS; j += AERO_OUTPUTS) {
            const double weight = mixture[j / AERO_OUTPUTS][i];
            for (int k = 0; k < AERO_INPUTS; k++)
                sum[k] += weight * trend_weights[j][k + 1];
            for (int b = parts[j].first_term; b < parts[j].last_term; b++) {
                const term *t = &terms[b];
                projected(b, z, u);
                for (int k = 0; k < AERO_INPUTS; k++)
                    pull[k] = 0;
                for (int c = 0; c < t->size; c++) {
                    const double e = weight * parts[j].weights[t->first + c] * function(b, c, u);
                    for (int k = 0; k < AERO_INPUTS; k++)
                        pull[k] += e * (centres[t->place + c][k] - u[k]);
                }
                for (int k = 0; k < AERO_INPUTS; k++)
                    sum[k] += term_inverse_widths[b][k] * pull[k];
            }
        }
        for (int k = 0; k < AERO_INPUTS; k++)
            slope[i][k] = sum[k] * output_scale[i] / scale[k];
    }
}
