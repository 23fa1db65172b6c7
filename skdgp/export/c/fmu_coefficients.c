/* Coefficients and their standard deviations, of flight data. Nothing moves by itself. */
#include "aero.c"

#define FMU_TOKEN "${token}"
#define FMU_STATES 1 /* C has no empty arrays */

/* Variables in the order of their value references. Kinds: t time, i input, o output, d deviation. */
${tables}

static double largest_step(const double v[])
{
    (void)v;
    return HUGE_VAL;
}

static void begin(const double v[], double x[])
{
    (void)v;
    x[0] = 0;
}

static const char *arrive(double v[], const double x[])
{
    (void)v;
    (void)x;
    return NULL;
}

static const char *flow(double v[], const double slope[], const double x[], double rate[])
{
    (void)slope;
    rate[0] = 0;
    return arrive(v, x);
}

static void observe(double v[], const double slope[], const double x[], int deviations)
{
    double source[AERO_SOURCES], input[AERO_INPUTS];
    unsigned long outside;
    int k;
    (void)slope;
    (void)x;
    for (k = 0; k < AERO_SOURCES; k++)
        source[k] = v[place[k]];
    aero_inputs(source, input);
    aero_predict(input, &v[FIRST_COEFFICIENT], deviations ? &v[FIRST_DEVIATION] : NULL);
    v[V_beyond] = 0;
    for (outside = aero_beyond(input); outside; outside &= outside - 1)
        v[V_beyond]++;
}
