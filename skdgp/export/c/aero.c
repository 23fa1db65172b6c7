/* See aero.h. */
#include "aero.h"

#include <math.h>
#include <stddef.h>

#define COMPONENTS ${components} /* of the average: part k * AERO_OUTPUTS + i is component k of output i */
#define FUNCTIONS ${functions} /* of the largest basis, at least 1 */
#define ROUNDING 2.220446049250313e-16

/* Gaussian functions gain * exp(-|root^T z - centre|^2 / 2) of some inputs, one for each of size centres. */
typedef struct {
    int first, size, n_used, rank;
    const unsigned char *used;
    const double *root, *centres;
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

/* u = root^T z */
static void projected(const term *t, const double z[], double u[])
{
    for (int l = 0; l < t->rank; l++) {
        u[l] = 0;
        for (int k = 0; k < t->n_used; k++)
            u[l] += t->root[k * t->rank + l] * z[t->used[k]];
    }
}

/* Function c of a term at u. */
static double function(const term *t, int c, const double u[])
{
    const double *centre = t->centres + (size_t)c * (size_t)t->rank;
    double square = 0;
    for (int l = 0; l < t->rank; l++)
        square += (u[l] - centre[l]) * (u[l] - centre[l]);
    return t->gain * exp(-square / 2);
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
        projected(&terms[b], z, u);
        for (int c = 0; c < terms[b].size; c++)
            g[terms[b].first + c] += function(&terms[b], c, u);
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
        p[k + 1] = z[k] - trend_center[k];
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
                projected(t, z, u);
                for (int l = 0; l < t->rank; l++)
                    pull[l] = 0;
                for (int c = 0; c < t->size; c++) {
                    const double e = weight * parts[j].weights[t->first + c] * function(t, c, u);
                    for (int l = 0; l < t->rank; l++)
                        pull[l] += e * (t->centres[c * t->rank + l] - u[l]);
                }
                for (int k = 0; k < t->n_used; k++)
                    for (int l = 0; l < t->rank; l++)
                        sum[t->used[k]] += t->root[k * t->rank + l] * pull[l];
            }
        }
        for (int k = 0; k < AERO_INPUTS; k++)
            slope[i][k] = sum[k] * output_scale[i] / scale[k];
    }
}
