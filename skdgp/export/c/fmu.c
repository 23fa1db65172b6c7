/* An instance of the model: its variables, its modes and its steps, the same for every version of FMI.
 *
 * fmi2.c or fmi3.c includes this file, and this file the model: one translation unit, which exports the functions of
 * FMI alone. A version defines SAY(i, status, text), and CONTINUOUS(i, time), which may set the inputs of that time.
 */
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#if defined _WIN32
#define API __declspec(dllexport)
#elif defined __GNUC__
#define API __attribute__((visibility("default")))
#pragma GCC visibility push(hidden)
#else
#define API
#endif
#include "model.c"
#if defined __GNUC__ && !defined _WIN32
#pragma GCC visibility pop
#endif

#define MOST_STEPS 1e7 /* of the integrator in one communication step */
#define TIME 0         /* value reference */

enum { OK, WARNING, DISCARD, ERROR };
enum { INSTANTIATED = 1, INITIALIZING = 2, READY = 4, INTERMEDIATE = 8, TERMINATED = 16 };

/* Everything that the future depends on. */
typedef struct {
    char token[sizeof FMU_TOKEN];
    int mode, ended;
    int known; /* 0: outputs are to be computed, 1: all but the deviations are known, 2: all are */
    int past;  /* whether the slopes are those of the last step, which outputs still show */
    double value[FMU_VARIABLES], slope[FMU_VARIABLES]; /* slopes of inputs */
    double state[FMU_STATES];
} memory;

typedef struct {
    memory now;
    fmi_logger logger;
    fmi_callback callback;
    void *environment;
    int logging, early_return;
    char name[];
} instance;

static void say(instance *i, int status, const char *function, const char *text)
{
    char message[512], *c;
    snprintf(message, sizeof message, "%s: %s", function, text);
    for (c = message; *c; c++)
        if (*c == '%')
            *c = '_'; /* FMI 2.0 reads the message as a format */
    SAY(i, status, message);
}

static int refuse(void *component, const char *function, const char *text)
{
    if (component != NULL)
        say(component, ERROR, function, text);
    return ERROR;
}

static const char *mode_name(int mode)
{
    return mode == INSTANTIATED   ? "instantiated"
           : mode == INITIALIZING ? "in initialization mode"
           : mode == READY        ? "ready for a step"
           : mode == TERMINATED   ? "terminated"
                                  : "within a step";
}

/* Whether the instance is in one of the modes; says so if it is not. */
static int is_in(void *component, const char *function, int modes)
{
    instance *i = component;
    char text[128];
    if (i == NULL)
        return 0;
    if (i->now.mode & modes)
        return 1;
    snprintf(text, sizeof text, "not allowed while the instance is %s", mode_name(i->now.mode));
    refuse(i, function, text);
    return 0;
}

/* Returns OK from the mode "from", and is then in the mode "to". */
static int change(void *component, const char *function, int from, int to)
{
    if (!is_in(component, function, from))
        return ERROR;
    ((instance *)component)->now.mode = to;
    return OK;
}

/* An unsupported function, or variables of a type that there are none of. */
static int none(void *component, const char *function, size_t n, ...)
{
    return component != NULL && n == 0 ? OK : refuse(component, function, "this FMU has nothing of that kind");
}

static void clear(memory *m)
{
    memset(m, 0, sizeof *m);
    memcpy(m->token, FMU_TOKEN, sizeof m->token);
    memcpy(m->value, start, sizeof m->value);
    m->mode = INSTANTIATED;
}

static instance *create(const char *name, const char *token, fmi_logger logger, void *environment, int logging)
{
    static const char *const function = "instantiate";
    const size_t length = name == NULL ? 0 : strlen(name);
    instance *i = calloc(1, sizeof *i + length + 1);
    if (i == NULL)
        return NULL;
    i->logger = logger, i->environment = environment, i->logging = logging;
    if (length > 0)
        memcpy(i->name, name, length);
    clear(&i->now);
    if (length > 0 && token != NULL && strcmp(token, FMU_TOKEN) == 0)
        return i;
    say(i, ERROR, function, length ? "the token is not that of modelDescription.xml" : "the instance has no name");
    free(i);
    return NULL;
}

/* Says what is wrong with a value. */
static int refuse_value(instance *i, int status, const char *function, uint32_t reference, const char *what)
{
    char text[256];
    const char *name = reference < FMU_VARIABLES ? names[reference] : "unknown";
    snprintf(text, sizeof text, "value reference %lu (%.100s): %s", (unsigned long)reference, name, what);
    say(i, status, function, text);
    return status;
}

static int has_arrays(void *component, const char *function, const void *references, size_t n, const void *values)
{
    if (n == 0 || (references != NULL && values != NULL))
        return 1;
    refuse(component, function, "got no arrays");
    return 0;
}

static int set_logging(void *component, const char *function, int on, size_t n, const char *const categories[])
{
    size_t k;
    if (component == NULL || !has_arrays(component, function, categories, n, categories))
        return ERROR;
    for (k = 0; k < n; k++)
        if (strcmp(categories[k], "logStatusError") != 0 && strcmp(categories[k], "logStatusDiscard") != 0)
            return refuse(component, function, "there is no such category");
    ((instance *)component)->logging = on;
    return OK;
}

/* All values are set, or none. */
static int set_values(void *component, const char *function, const uint32_t reference[], size_t n, const double value[])
{
    instance *i = component;
    size_t k;
    if (!is_in(i, function, INSTANTIATED | INITIALIZING | READY | INTERMEDIATE) ||
        !has_arrays(i, function, reference, n, value))
        return ERROR;
    for (k = 0; k < n; k++) {
        const int setup = i->now.mode & (INSTANTIATED | INITIALIZING);
        if (reference[k] >= FMU_VARIABLES)
            return refuse_value(i, ERROR, function, reference[k], "there is no such variable");
        if (kind[reference[k]] != 'i' && !(setup && (kind[reference[k]] == 's' || kind[reference[k]] == 'p')))
            return refuse_value(i, ERROR, function, reference[k], "it cannot be set here");
        if (!isfinite(value[k]))
            return refuse_value(i, ERROR, function, reference[k], "the value is not finite");
        if (kind[reference[k]] == 'p' && !(value[k] > 0))
            return refuse_value(i, ERROR, function, reference[k], "the value is not > 0");
    }
    for (k = 0; k < n; k++) {
        i->now.value[reference[k]] = value[k];
        i->now.slope[reference[k]] = 0;
    }
    i->now.known = 0;
    return OK;
}

/* Makes the outputs known; in initialization mode those of the start values. */
static void look(memory *m, int deviations)
{
    double value[FMU_VARIABLES], first[FMU_STATES];
    const int setup = m->mode == INITIALIZING;
    int k;
    if (m->known > deviations)
        return;
    if (setup)
        begin(m->value, first);
    for (k = 0; k < FMU_VARIABLES; k++)
        value[k] = kind[k] == 'o' || kind[k] == 'd' ? NAN : m->value[k]; /* where a state has none */
    observe(value, m->slope, setup ? first : m->state, deviations);
    for (k = 0; k < FMU_VARIABLES; k++)
        if (kind[k] != 's' || !setup)
            m->value[k] = value[k];
    m->known = 1 + deviations;
}

static int get_values(void *component, const char *function, const uint32_t reference[], size_t n, double value[])
{
    instance *i = component;
    int status = OK;
    size_t k;
    if (!is_in(i, function, ~INTERMEDIATE) || !has_arrays(i, function, reference, n, value))
        return ERROR;
    for (k = 0; k < n; k++) {
        char what;
        if (reference[k] >= FMU_VARIABLES)
            return refuse_value(i, ERROR, function, reference[k], "there is no such variable");
        what = kind[reference[k]];
        if (i->now.mode == INSTANTIATED && (what == 'o' || what == 'd'))
            return refuse_value(i, ERROR, function, reference[k], "it is not known before the initialization");
        if (what == 'o' || what == 'd' || (what == 's' && !(i->now.mode & (INSTANTIATED | INITIALIZING))))
            look(&i->now, what == 'd');
        value[k] = i->now.value[reference[k]];
        if (!isfinite(value[k]))
            status = refuse_value(i, DISCARD, function, reference[k], "no value at this state");
    }
    return status;
}

static int enter(void *component, const char *function, double start_time)
{
    instance *i = component;
    if (!is_in(i, function, INSTANTIATED))
        return ERROR;
    if (!isfinite(start_time))
        return refuse(i, function, "the start time is not finite");
    i->now.value[TIME] = start_time;
    return OK;
}

/* Begins at the start values. */
static int leave_initialization(void *component, const char *function)
{
    instance *i = component;
    double rates[FMU_STATES], value[FMU_VARIABLES];
    const char *reason;
    if (!is_in(i, function, INITIALIZING))
        return ERROR;
    memcpy(value, i->now.value, sizeof value);
    begin(i->now.value, i->now.state);
    reason = flow(value, i->now.slope, i->now.state, rates);
    if (reason != NULL)
        return refuse(i, function, reason);
    i->now.mode = READY;
    i->now.known = 0;
    return OK;
}

/* Slopes hold for one step. */
static void forget_slopes(memory *m)
{
    if (m->past)
        memset(m->slope, 0, sizeof m->slope);
    m->past = 0;
}

/* Sets the inputs to those at a time of the step. */
static void inputs_at(instance *i, double since, double value[])
{
    int k;
    if (since > 0)
        CONTINUOUS(i, i->now.value[TIME] + since);
    for (k = 0; k < FMU_VARIABLES; k++)
        if (kind[k] == 'i')
            value[k] = i->now.value[k] + since * i->now.slope[k];
}

/* One step of the method of Runge and Kutta; the reason why there is none, and then no change. */
static const char *advance(instance *i, double since, double h)
{
    double value[FMU_VARIABLES], x[FMU_STATES], rate[4][FMU_STATES];
    double *const state = i->now.state;
    const char *reason;
    int k, n;
    memcpy(value, i->now.value, sizeof value);
    for (n = 0; n < 4; n++) {
        const double part = n == 0 ? 0 : n == 3 ? h : 0.5 * h;
        if (n != 2)
            inputs_at(i, since + part, value);
        for (k = 0; k < FMU_STATES; k++)
            x[k] = n == 0 ? state[k] : state[k] + part * rate[n - 1][k];
        reason = flow(value, i->now.slope, x, rate[n]);
        if (reason != NULL)
            return reason;
    }
    for (k = 0; k < FMU_STATES; k++)
        x[k] = state[k] + (h / 6) * (rate[0][k] + 2 * (rate[1][k] + rate[2][k]) + rate[3][k]);
    reason = arrive(value, x);
    if (reason == NULL)
        memcpy(state, x, sizeof x);
    return reason;
}

/* A communication step, in equal steps of the integrator. DISCARD: the flight has ended, at the time that is set. */
static int step(void *component, const char *function, double time, double h)
{
    instance *i = component;
    memory *m;
    const char *reason = NULL;
    double n, steps, done;
    int k;
    if (!is_in(i, function, READY))
        return ERROR;
    m = &i->now;
    if (!(h > 0 && isfinite(h)))
        return refuse(i, function, "the step size is not > 0 and finite");
    if (!(fabs(time - m->value[TIME]) <= 1e-6 * h + 1e-12 * fabs(time)))
        return refuse(i, function, "the step does not begin at the time of the instance");
    steps = ceil(h / largest_step(m->value) - 1e-6);
    if (!(steps <= MOST_STEPS))
        return refuse(i, function, "the step size is more than 1e7 steps of the integrator");
    steps = steps < 1 ? 1 : steps;
    forget_slopes(m);
    m->mode = INTERMEDIATE;
    for (n = 0; n < steps && reason == NULL; n++)
        reason = advance(i, n * h / steps, h / steps);
    m->mode = READY;
    m->known = 0;
    m->ended = reason != NULL;
    done = m->ended ? (n - 1) * h / steps : h;
    for (k = 0; k < FMU_VARIABLES; k++)
        m->value[k] += done * m->slope[k];
    m->past = 1;
    m->value[TIME] = m->ended ? m->value[TIME] + done : time + h;
    if (reason != NULL)
        say(i, DISCARD, function, reason);
    return reason == NULL ? OK : DISCARD;
}

static int terminate(void *component, const char *function)
{
    return change(component, function, READY, TERMINATED);
}

static int reset(void *component, const char *function)
{
    instance *i = component;
    if (!is_in(i, function, INSTANTIATED | INITIALIZING | READY | TERMINATED))
        return ERROR;
    clear(&i->now);
    return OK;
}

/* -- copies of the memory, which a user keeps ------------------------------------------------------------------- */

static int save(void *component, const char *function, void **copy)
{
    instance *i = component;
    if (!is_in(i, function, ~INTERMEDIATE))
        return ERROR;
    if (copy == NULL)
        return refuse(i, function, "got no place for the state");
    if (*copy == NULL)
        *copy = malloc(sizeof(memory));
    if (*copy == NULL)
        return refuse(i, function, "out of memory");
    memcpy(*copy, &i->now, sizeof(memory));
    return OK;
}

static int restore(void *component, const char *function, const void *copy)
{
    instance *i = component;
    if (!is_in(i, function, ~INTERMEDIATE))
        return ERROR;
    if (copy == NULL)
        return refuse(i, function, "got no state");
    memcpy(&i->now, copy, sizeof(memory));
    return OK;
}

static int forget(void *component, void **copy)
{
    if (component == NULL)
        return ERROR;
    if (copy != NULL) {
        free(*copy);
        *copy = NULL;
    }
    return OK;
}

static int size_of_state(void *component, const char *function, const void *copy, size_t *size)
{
    if (component == NULL || copy == NULL || size == NULL)
        return refuse(component, function, "got no state, or no place for its size");
    *size = sizeof(memory);
    return OK;
}

static int to_bytes(void *component, const char *function, const void *copy, void *bytes, size_t size)
{
    if (component == NULL || copy == NULL || bytes == NULL || size < sizeof(memory))
        return refuse(component, function, "got no state, or too few bytes");
    memcpy(bytes, copy, sizeof(memory));
    return OK;
}

static int from_bytes(void *component, const char *function, const void *bytes, size_t size, void **copy)
{
    memory found;
    if (component == NULL || bytes == NULL || copy == NULL || size != sizeof(memory))
        return refuse(component, function, "the bytes are no state of this FMU");
    memcpy(&found, bytes, sizeof found);
    found.known = 0;
    if (memcmp(found.token, FMU_TOKEN, sizeof found.token) != 0 ||
        !(found.mode == INSTANTIATED || found.mode == INITIALIZING || found.mode == READY || found.mode == TERMINATED))
        return refuse(component, function, "the bytes are no state of this FMU");
    if (*copy == NULL)
        *copy = malloc(sizeof(memory));
    if (*copy == NULL)
        return refuse(component, function, "out of memory");
    memcpy(*copy, &found, sizeof found);
    return OK;
}
