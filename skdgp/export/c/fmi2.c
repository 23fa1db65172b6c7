/* FMI 2.0 for co-simulation. Declarations as in the standard, section 2.1 and 4.2, "default" platform. */
#include <stddef.h>

typedef void (*fmi_logger)(void *environment, const char *name, int status, const char *category, const char *text,
                           ...);
typedef int fmi_callback; /* there is none */
#define SAY(i, status, text)                                                                                           \
    ((i)->logger != NULL ? (i)->logger((i)->environment, (i)->name, status,                                            \
                                       status == ERROR ? "logStatusError" : "logStatusDiscard", text)                  \
                         : (void)0)
#define CONTINUOUS(i, time) (void)0 /* inputs come with slopes */
#include "fmu.c"

typedef struct {
    fmi_logger logger;
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void (*step_finished)(void *, int);
    void *environment;
} fmi2CallbackFunctions;

enum { MODEL_EXCHANGE, CO_SIMULATION };
enum { LAST_SUCCESSFUL_TIME = 2, TERMINATED_STATUS = 3 };

API const char *fmi2GetTypesPlatform(void)
{
    return "default";
}

API const char *fmi2GetVersion(void)
{
    return "2.0";
}

API int fmi2SetDebugLogging(void *c, int on, size_t n, const char *const categories[])
{
    return set_logging(c, __func__, on, n, categories);
}

API void *fmi2Instantiate(const char *name, int type, const char *guid, const char *resources,
                          const fmi2CallbackFunctions *functions, int visible, int logging)
{
    instance *i;
    (void)resources;
    (void)visible;
    if (functions == NULL)
        return NULL;
    i = create(name, guid, functions->logger, functions->environment, logging);
    if (i == NULL || type == CO_SIMULATION)
        return i;
    refuse(i, __func__, "this FMU is for co-simulation");
    free(i);
    return NULL;
}

API void fmi2FreeInstance(void *c)
{
    free(c);
}

API int fmi2SetupExperiment(void *c, int has_tolerance, double tolerance, double start_time, int has_stop, double stop)
{
    (void)has_tolerance;
    (void)tolerance;
    (void)has_stop;
    (void)stop;
    return enter(c, __func__, start_time);
}

API int fmi2EnterInitializationMode(void *c)
{
    return change(c, __func__, INSTANTIATED, INITIALIZING);
}

API int fmi2ExitInitializationMode(void *c)
{
    return leave_initialization(c, __func__);
}

API int fmi2Terminate(void *c)
{
    return terminate(c, __func__);
}

API int fmi2Reset(void *c)
{
    return reset(c, __func__);
}

/* -- values ----------------------------------------------------------------------------------------------------- */

API int fmi2GetReal(void *c, const unsigned int vr[], size_t n, double value[])
{
    return get_values(c, __func__, vr, n, value);
}

API int fmi2SetReal(void *c, const unsigned int vr[], size_t n, const double value[])
{
    return set_values(c, __func__, vr, n, value);
}

#define NO_VARIABLES(type, number)                                                                                     \
    API int fmi2Get##type(void *c, const unsigned int vr[], size_t n, number value[])                                  \
    {                                                                                                                  \
        return none(c, __func__, n, vr, value);                                                                        \
    }                                                                                                                  \
    API int fmi2Set##type(void *c, const unsigned int vr[], size_t n, number const value[])                            \
    {                                                                                                                  \
        return none(c, __func__, n, vr, value);                                                                        \
    }

NO_VARIABLES(Integer, int)
NO_VARIABLES(Boolean, int)
NO_VARIABLES(String, const char *)

/* First derivatives of inputs, for the next step. */
API int fmi2SetRealInputDerivatives(void *c, const unsigned int vr[], size_t n, const int order[], const double value[])
{
    instance *i = c;
    size_t k;
    if (!is_in(i, __func__, INITIALIZING | READY) || !has_arrays(i, __func__, vr, n, value) ||
        !has_arrays(i, __func__, order, n, order))
        return ERROR;
    for (k = 0; k < n; k++) {
        if (vr[k] >= FMU_VARIABLES || kind[vr[k]] != 'i')
            return refuse_value(i, ERROR, __func__, vr[k], "it is no input");
        if (order[k] != 1 || !isfinite(value[k]))
            return refuse_value(i, ERROR, __func__, vr[k], "the order is not 1, or the derivative is not finite");
    }
    forget_slopes(&i->now);
    for (k = 0; k < n; k++)
        i->now.slope[vr[k]] = value[k];
    i->now.known = 0;
    return OK;
}

API int fmi2GetRealOutputDerivatives(void *c, const unsigned int vr[], size_t n, const int order[], double value[])
{
    return none(c, __func__, n, vr, order, value);
}

API int fmi2GetDirectionalDerivative(void *c, const unsigned int unknown[], size_t n, const unsigned int known[],
                                    size_t m, const double direction[], double value[])
{
    return none(c, __func__, n + 1, unknown, known, m, direction, value);
}

/* -- state ------------------------------------------------------------------------------------------------------ */

API int fmi2GetFMUstate(void *c, void **state)
{
    return save(c, __func__, state);
}

API int fmi2SetFMUstate(void *c, void *state)
{
    return restore(c, __func__, state);
}

API int fmi2FreeFMUstate(void *c, void **state)
{
    return forget(c, state);
}

API int fmi2SerializedFMUstateSize(void *c, void *state, size_t *size)
{
    return size_of_state(c, __func__, state, size);
}

API int fmi2SerializeFMUstate(void *c, void *state, char bytes[], size_t size)
{
    return to_bytes(c, __func__, state, bytes, size);
}

API int fmi2DeSerializeFMUstate(void *c, const char bytes[], size_t size, void **state)
{
    return from_bytes(c, __func__, bytes, size, state);
}

/* -- steps ------------------------------------------------------------------------------------------------------ */

API int fmi2DoStep(void *c, double time, double step_size, int no_return)
{
    (void)no_return;
    return step(c, __func__, time, step_size);
}

API int fmi2CancelStep(void *c)
{
    return refuse(c, __func__, "no step runs");
}

API int fmi2GetStatus(void *c, int what, int *value)
{
    return none(c, __func__, 1, what, value);
}

API int fmi2GetRealStatus(void *c, int what, double *value)
{
    if (c == NULL || what != LAST_SUCCESSFUL_TIME || value == NULL)
        return none(c, __func__, 1);
    *value = ((instance *)c)->now.value[TIME];
    return OK;
}

API int fmi2GetIntegerStatus(void *c, int what, int *value)
{
    return none(c, __func__, 1, what, value);
}

API int fmi2GetBooleanStatus(void *c, int what, int *value)
{
    if (c == NULL || what != TERMINATED_STATUS || value == NULL)
        return none(c, __func__, 1);
    *value = ((instance *)c)->now.ended;
    return OK;
}

API int fmi2GetStringStatus(void *c, int what, const char **value)
{
    return none(c, __func__, 1, what, value);
}
