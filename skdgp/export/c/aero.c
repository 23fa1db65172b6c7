/* See aero.h. */
#include "aero.h"

#include <math.h>
#include <stddef.h>
#include <stdint.h>

#define MEMBERS ${members} /* of the mixture: the part k * AERO_OUTPUTS + i is member k of output i */
#define FUNCTIONS ${functions} /* of the largest basis, at least 1 */
#define FULL ${full} /* whether F is a matrix, (n_used, n_used), or its diagonal */
#define ROUNDING 2.220446049250313e-16

/* A packed triangle: in full, or rounded to 32 bits and scaled by row and column. */
typedef struct {
    const double *full;
    const int32_t *rounded;
    const double *row_scale, *column_scale;
} triangle;

/* Gaussian functions gain * exp(-|F (z - shift - centre)|^2 / 2) of some inputs, one for each centre. */
typedef struct {
    int column, size, n_used;
    const unsigned char *used;
    const double *centres, *shift, *root;
    double gain;
} block;

${tables}

static void scaled(const aero_real x[], double z[])
{
    int k;
    for (k = 0; k < AERO_INPUTS; k++)
        z[k] = (x[k] - shift[k]) / scale[k];
}

/* The exponential of one function and, unless away is NULL, away = F F^T (z - shift - centre). */
static double exponential(const block *b, int c, const double u[], double away[])
{
    const double *centre = b->centres + (size_t)c * (size_t)b->n_used;
    double square = 0;
    int k;
#if FULL
    int l;
    if (away != NULL)
        for (k = 0; k < b->n_used; k++)
            away[k] = 0;
    for (l = 0; l < b->n_used; l++) {
        double a = 0;
        for (k = 0; k < b->n_used; k++)
            a += (u[k] - centre[k]) * b->root[k * b->n_used + l];
        if (away != NULL)
            for (k = 0; k < b->n_used; k++)
                away[k] += a * b->root[k * b->n_used + l];
        square += a * a;
    }
#else
    for (k = 0; k < b->n_used; k++) {
        const double a = (u[k] - centre[k]) * b->root[k];
        if (away != NULL)
            away[k] = a * b->root[k];
        square += a * a;
    }
#endif
    return b->gain * exp(-square / 2);
}

static void relative(const block *b, const double z[], double u[])
{
    int k;
    for (k = 0; k < b->n_used; k++)
        u[k] = z[b->used[k]] - b->shift[k];
}

void aero_inputs(const aero_real source[AERO_SOURCES], aero_real x[AERO_INPUTS])
{
${formulas}
}

/* The normalised mean of a part and, unless variance is NULL, its variance; g has space for its basis. */
static double part(int j, const double z[], const double p[], double g[], double *variance)
{
    const int n = n_functions[j], rank = n_columns[j];
    const double *T = trend_root[j], *U = root[j].full;
    const int32_t *R = root[j].rounded;
    double u[AERO_INPUTS], value = 0, prior = prior_variance[j], explained = 0;
    int b, c, k, r;
    for (c = 0; c < n; c++)
        g[c] = 0;
    for (b = first_block[j]; b < first_block[j + 1]; b++) {
        relative(&blocks[b], z, u);
        for (c = 0; c < blocks[b].size; c++)
            g[blocks[b].column + c] += exponential(&blocks[b], c, u, NULL);
    }
    for (k = 0; k <= AERO_INPUTS; k++)
        value += p[k] * trend_weights[j][k];
    for (c = 0; c < n; c++)
        value += g[c] * weights[j][c];
    if (variance == NULL)
        return value;
    for (k = 0; k <= AERO_INPUTS; k++) {
        const double t = p[k] * trend_scale[j][k];
        prior += t * t;
    }
    for (c = 0; R != NULL && c < n; c++)
        g[c] *= root[j].row_scale[c];
    for (r = 0; r < rank; r++) {
        const int length = r + 1 - (rank - n); /* functions in this column of the triangle */
        double half = 0, sum = 0;
        for (k = 0; k <= AERO_INPUTS; k++)
            half += p[k] * *T++;
        if (R == NULL)
            for (c = 0; c < length; c++)
                sum += g[c] * *U++;
        else
            for (c = 0; c < length; c++)
                sum += g[c] * *R++;
        if (R != NULL && length > 0)
            sum *= root[j].column_scale[length - 1];
        explained += (half + sum) * (half + sum);
    }
    *variance = prior - explained > ROUNDING * prior ? prior - explained : ROUNDING * prior;
    return value;
}

void aero_predict(const aero_real x[AERO_INPUTS], aero_real mean[AERO_OUTPUTS], aero_real std[AERO_OUTPUTS])
{
    double z[AERO_INPUTS], p[AERO_INPUTS + 1], g[FUNCTIONS] = {0}, value[MEMBERS], variance[MEMBERS];
    int i, k, m;
    scaled(x, z);
    p[0] = 1;
    for (k = 0; k < AERO_INPUTS; k++)
        p[k + 1] = z[k] - trend_center[k];
    for (i = 0; i < AERO_OUTPUTS; i++) {
        double total = 0, spread = 0;
        for (m = 0; m < MEMBERS; m++) {
            value[m] = part(m * AERO_OUTPUTS + i, z, p, g, std == NULL ? NULL : &variance[m]);
            total += mixture[m][i] * value[m];
        }
        mean[i] = (aero_real)(center[i] + output_scale[i] * total);
        if (std == NULL)
            continue;
        for (m = 0; m < MEMBERS; m++)
            spread += mixture[m][i] * (variance[m] + (value[m] - total) * (value[m] - total));
        std[i] = (aero_real)(deviation_scale[i] * sqrt(spread));
    }
}

void aero_gradient(const aero_real x[AERO_INPUTS], aero_real slope[AERO_OUTPUTS][AERO_INPUTS])
{
    double z[AERO_INPUTS], u[AERO_INPUTS], away[AERO_INPUTS], sum[AERO_INPUTS];
    int i, j, b, c, k;
    scaled(x, z);
    for (i = 0; i < AERO_OUTPUTS; i++) {
        for (k = 0; k < AERO_INPUTS; k++)
            sum[k] = 0;
        for (j = i; j < MEMBERS * AERO_OUTPUTS; j += AERO_OUTPUTS) {
            const double share = mixture[j / AERO_OUTPUTS][i];
            for (k = 0; k < AERO_INPUTS; k++)
                sum[k] += share * trend_weights[j][k + 1];
            for (b = first_block[j]; b < first_block[j + 1]; b++) {
                const block *of = &blocks[b];
                relative(of, z, u);
                for (c = 0; c < of->size; c++) {
                    const double e = share * weights[j][of->column + c] * exponential(of, c, u, away);
                    for (k = 0; k < of->n_used; k++)
                        sum[of->used[k]] -= e * away[k];
                }
            }
        }
        for (k = 0; k < AERO_INPUTS; k++)
            slope[i][k] = (aero_real)(sum[k] * output_scale[i] / scale[k]);
    }
}

unsigned long aero_beyond(const aero_real x[AERO_INPUTS])
{
    unsigned long found = 0;
    int k;
    for (k = 0; k < AERO_INPUTS; k++)
        if (!(x[k] >= aero_low[k] && x[k] <= aero_high[k]))
            found |= 1UL << k;
    return found;
}
