/* FMI 3.0 for co-simulation. Declarations as in the standard, section 2.2. */
#include <stdbool.h>
#include <stddef.h>

typedef void (*fmi_logger)(void *environment, int status, const char *category, const char *text);
typedef void (*fmi_callback)(void *environment, double time, bool set_inputs, bool get, bool step_finished,
                             bool can_return, bool *return_requested, double *return_time);
#define SAY(i, status, text)                                                                                           \
    ((i)->logger != NULL && (i)->logging                                                                               \
         ? (i)->logger((i)->environment, status, status == ERROR ? "logStatusError" : "logStatusDiscard", text)        \
         : (void)0)
#define CONTINUOUS(i, time)                                                                                            \
    do {                                                                                                               \
        bool wants_return = false;                                                                                     \
        double return_time = 0;                                                                                        \
        if ((i)->callback != NULL)                                                                                     \
            (i)->callback((i)->environment, time, true, false, false, false, &wants_return, &return_time);             \
    } while (0)
#include "fmu.c"

API const char *fmi3GetVersion(void)
{
    return "3.0";
}

API int fmi3SetDebugLogging(void *c, bool on, size_t n, const char *const categories[])
{
    return set_logging(c, __func__, on, n, categories);
}

/* -- instances -------------------------------------------------------------------------------------------------- */

static void *refuse_interface(fmi_logger logger, void *environment, bool logging)
{
    if (logger != NULL && logging)
        logger(environment, ERROR, "logStatusError", "instantiate: this FMU is for co-simulation without event mode");
    return NULL;
}

API void *fmi3InstantiateModelExchange(const char *name, const char *token, const char *resources, bool visible,
                                       bool logging, void *environment, fmi_logger logger)
{
    (void)name;
    (void)token;
    (void)resources;
    (void)visible;
    return refuse_interface(logger, environment, logging);
}

API void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources, bool visible,
                                      bool logging, bool events, bool early_return, const uint32_t intermediate[],
                                      size_t n_intermediate, void *environment, fmi_logger logger,
                                      fmi_callback callback)
{
    instance *i;
    (void)resources;
    (void)visible;
    (void)intermediate;
    (void)n_intermediate;
    if (events)
        return refuse_interface(logger, environment, logging);
    i = create(name, token, logger, environment, logging);
    if (i != NULL)
        i->callback = callback, i->early_return = early_return;
    return i;
}

API void *fmi3InstantiateScheduledExecution(const char *name, const char *token, const char *resources, bool visible,
                                            bool logging, void *environment, fmi_logger logger,
                                            void (*clock)(void *), void (*lock)(void), void (*unlock)(void))
{
    (void)clock;
    (void)lock;
    (void)unlock;
    return fmi3InstantiateModelExchange(name, token, resources, visible, logging, environment, logger);
}

API void fmi3FreeInstance(void *c)
{
    free(c);
}

API int fmi3EnterInitializationMode(void *c, bool has_tolerance, double tolerance, double start_time, bool has_stop,
                                   double stop_time)
{
    const int status = enter(c, __func__, start_time);
    (void)has_tolerance;
    (void)tolerance;
    (void)has_stop;
    (void)stop_time;
    return status == OK ? change(c, __func__, INSTANTIATED, INITIALIZING) : status;
}

API int fmi3ExitInitializationMode(void *c)
{
    return leave_initialization(c, __func__);
}

API int fmi3Terminate(void *c)
{
    return terminate(c, __func__);
}

API int fmi3Reset(void *c)
{
    return reset(c, __func__);
}

/* -- values ----------------------------------------------------------------------------------------------------- */

API int fmi3GetFloat64(void *c, const uint32_t vr[], size_t n, double value[], size_t m)
{
    return m == n ? get_values(c, __func__, vr, n, value) : refuse(c, __func__, "got other numbers of values");
}

API int fmi3SetFloat64(void *c, const uint32_t vr[], size_t n, const double value[], size_t m)
{
    return m == n ? set_values(c, __func__, vr, n, value) : refuse(c, __func__, "got other numbers of values");
}

#define NO_VARIABLES(type, number)                                                                                     \
    API int fmi3Get##type(void *c, const uint32_t vr[], size_t n, number value[], size_t m)                            \
    {                                                                                                                  \
        return none(c, __func__, n, vr, value, m);                                                                     \
    }                                                                                                                  \
    API int fmi3Set##type(void *c, const uint32_t vr[], size_t n, number const value[], size_t m)                      \
    {                                                                                                                  \
        return none(c, __func__, n, vr, value, m);                                                                     \
    }

NO_VARIABLES(Float32, float)
NO_VARIABLES(Int8, int8_t)
NO_VARIABLES(UInt8, uint8_t)
NO_VARIABLES(Int16, int16_t)
NO_VARIABLES(UInt16, uint16_t)
NO_VARIABLES(Int32, int32_t)
NO_VARIABLES(UInt32, uint32_t)
NO_VARIABLES(Int64, int64_t)
NO_VARIABLES(UInt64, uint64_t)
NO_VARIABLES(Boolean, bool)
NO_VARIABLES(String, const char *)

API int fmi3GetBinary(void *c, const uint32_t vr[], size_t n, size_t sizes[], const uint8_t *value[], size_t m)
{
    return none(c, __func__, n, vr, sizes, value, m);
}

API int fmi3SetBinary(void *c, const uint32_t vr[], size_t n, const size_t sizes[], const uint8_t *const value[],
                     size_t m)
{
    return none(c, __func__, n, vr, sizes, value, m);
}

API int fmi3GetClock(void *c, const uint32_t vr[], size_t n, bool value[])
{
    return none(c, __func__, n, vr, value);
}

API int fmi3SetClock(void *c, const uint32_t vr[], size_t n, const bool value[])
{
    return none(c, __func__, n, vr, value);
}

/* -- state ------------------------------------------------------------------------------------------------------ */

API int fmi3GetFMUState(void *c, void **state)
{
    return save(c, __func__, state);
}

API int fmi3SetFMUState(void *c, void *state)
{
    return restore(c, __func__, state);
}

API int fmi3FreeFMUState(void *c, void **state)
{
    return forget(c, state);
}

API int fmi3SerializedFMUStateSize(void *c, void *state, size_t *size)
{
    return size_of_state(c, __func__, state, size);
}

API int fmi3SerializeFMUState(void *c, void *state, uint8_t bytes[], size_t size)
{
    return to_bytes(c, __func__, state, bytes, size);
}

API int fmi3DeserializeFMUState(void *c, const uint8_t bytes[], size_t size, void **state)
{
    return from_bytes(c, __func__, bytes, size, state);
}

/* -- steps ------------------------------------------------------------------------------------------------------ */

API int fmi3DoStep(void *c, double time, double step_size, bool no_return, bool *event, bool *end, bool *early,
                  double *last_time)
{
    instance *i = c;
    int status;
    (void)no_return;
    if (c == NULL || event == NULL || end == NULL || early == NULL || last_time == NULL)
        return refuse(c, __func__, "got no places for the results");
    *event = *end = *early = false;
    status = step(c, __func__, time, step_size);
    *last_time = i->now.value[TIME];
    if (status != DISCARD)
        return status;
    *end = true;
    *early = i->early_return;
    return *early ? OK : DISCARD;
}

/* -- what this FMU has not -------------------------------------------------------------------------------------- */

#define UNSUPPORTED(function, arguments, ...)                                                                          \
    API int function arguments                                                                                         \
    {                                                                                                                  \
        return none(c, __func__, __VA_ARGS__);                                                                         \
    }

UNSUPPORTED(fmi3EnterEventMode, (void *c), 1)
UNSUPPORTED(fmi3EnterStepMode, (void *c), 1)
UNSUPPORTED(fmi3EnterConfigurationMode, (void *c), 1)
UNSUPPORTED(fmi3ExitConfigurationMode, (void *c), 1)
UNSUPPORTED(fmi3EnterContinuousTimeMode, (void *c), 1)
UNSUPPORTED(fmi3EvaluateDiscreteStates, (void *c), 1)
UNSUPPORTED(fmi3UpdateDiscreteStates, (void *c, bool *a, bool *b, bool *d, bool *e, bool *f, double *t), 1, a, b, d, e,
            f, t)
UNSUPPORTED(fmi3CompletedIntegratorStep, (void *c, bool a, bool *b, bool *d), 1, a, b, d)
UNSUPPORTED(fmi3SetTime, (void *c, double time), 1, time)
UNSUPPORTED(fmi3SetContinuousStates, (void *c, const double x[], size_t n), n, x)
UNSUPPORTED(fmi3GetContinuousStateDerivatives, (void *c, double x[], size_t n), n, x)
UNSUPPORTED(fmi3GetContinuousStates, (void *c, double x[], size_t n), n, x)
UNSUPPORTED(fmi3GetNominalsOfContinuousStates, (void *c, double x[], size_t n), n, x)
UNSUPPORTED(fmi3GetEventIndicators, (void *c, double z[], size_t n), n, z)
UNSUPPORTED(fmi3GetNumberOfEventIndicators, (void *c, size_t *n), 1, n)
UNSUPPORTED(fmi3GetNumberOfContinuousStates, (void *c, size_t *n), 1, n)
UNSUPPORTED(fmi3ActivateModelPartition, (void *c, uint32_t clock, double time), 1, clock, time)
UNSUPPORTED(fmi3GetNumberOfVariableDependencies, (void *c, uint32_t vr, size_t *n), 1, vr, n)
UNSUPPORTED(fmi3GetVariableDependencies,
            (void *c, uint32_t vr, size_t a[], uint32_t b[], size_t d[], int kinds[], size_t n), 1, vr, a, b, d, kinds,
            n)
UNSUPPORTED(fmi3GetDirectionalDerivative,
            (void *c, const uint32_t unknown[], size_t n, const uint32_t known[], size_t m, const double seed[],
             size_t k, double value[], size_t l),
            1, unknown, n, known, m, seed, k, value, l)
UNSUPPORTED(fmi3GetAdjointDerivative,
            (void *c, const uint32_t unknown[], size_t n, const uint32_t known[], size_t m, const double seed[],
             size_t k, double value[], size_t l),
            1, unknown, n, known, m, seed, k, value, l)
UNSUPPORTED(fmi3GetOutputDerivatives,
            (void *c, const uint32_t vr[], size_t n, const int32_t order[], double value[], size_t m), n, vr, order,
            value, m)
UNSUPPORTED(fmi3GetIntervalDecimal, (void *c, const uint32_t vr[], size_t n, double value[], int what[]), n, vr, value,
            what)
UNSUPPORTED(fmi3GetIntervalFraction,
            (void *c, const uint32_t vr[], size_t n, uint64_t a[], uint64_t b[], int what[]), n, vr, a, b, what)
UNSUPPORTED(fmi3GetShiftDecimal, (void *c, const uint32_t vr[], size_t n, double value[]), n, vr, value)
UNSUPPORTED(fmi3GetShiftFraction, (void *c, const uint32_t vr[], size_t n, uint64_t a[], uint64_t b[]), n, vr, a, b)
UNSUPPORTED(fmi3SetIntervalDecimal, (void *c, const uint32_t vr[], size_t n, const double value[]), n, vr, value)
UNSUPPORTED(fmi3SetIntervalFraction,
            (void *c, const uint32_t vr[], size_t n, const uint64_t a[], const uint64_t b[]), n, vr, a, b)
UNSUPPORTED(fmi3SetShiftDecimal, (void *c, const uint32_t vr[], size_t n, const double value[]), n, vr, value)
UNSUPPORTED(fmi3SetShiftFraction,
            (void *c, const uint32_t vr[], size_t n, const uint64_t a[], const uint64_t b[]), n, vr, a, b)
