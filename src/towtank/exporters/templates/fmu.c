/*
 * The model of model.h as a functional mock-up unit for co-simulation, FMI 2.0 or 3.0 (FMI = 2 or 3).
 *
 * Every variable is a real number in one array, and its value reference is its place there: inputs, parameters, outputs.
 * Commands, wrench and current are held over a communication step, which is cut into equal steps of at most `step` s.
 */
#include "model.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#if FMI == 3
#include <stdbool.h>
#include <stdint.h>
#endif

#if defined _WIN32
#define EXPORTED __declspec(dllexport)
#else
#define EXPORTED __attribute__((visibility("default")))
#endif

enum {
    COMMANDS = 0, VOLTAGE = COMMANDS + TT_THRUSTERS, WRENCH = VOLTAGE + 1, CURRENT = WRENCH + 6,
    INPUTS_END = CURRENT + 3, STEP = INPUTS_END, START = STEP + 1, PARAMETERS = START + 12,
    OUTPUTS = PARAMETERS + @fields@, POSE = OUTPUTS, QUATERNION = POSE + 6, VELOCITY = QUATERNION + 4,
    FORCES = VELOCITY + 6, VALUES = FORCES + TT_THRUSTERS
};
enum { OK = 0, DISCARD = 2, ERROR = 3 };

/* What is saved and restored as the unit's state. */
typedef struct {
    double values[VALUES], x[TT_STATES], forces[TT_COLUMNS], time; /* x: velocity over ground */
    tt_model model;
    int stale; /* a parameter was changed since the model was prepared */
} State;

typedef struct {
    State state;
    void *environment;
    int logging;
    char name[128];
    const void *callbacks;
} Unit;

static const double defaults[VALUES] = {
@defaults@
};

static void say(const Unit *unit, int status, const char *message);

static void compute_outputs(State *state)
{
    double *v = state->values;
    int k;
    memcpy(v + POSE, state->x, 3 * sizeof(double));
    tt_euler(state->x + 3, v + POSE + 3);
    memcpy(v + QUATERNION, state->x + 3, 4 * sizeof(double));
    memcpy(v + VELOCITY, state->x + 7, 6 * sizeof(double));
    for (k = 0; k < TT_THRUSTERS; k++) {
        v[FORCES + k] = state->forces[k];
    }
}

static void take_start(State *state)
{
    const double *v = state->values;
    memcpy(state->x, v + START, 3 * sizeof(double));
    tt_quaternion(v + START + 3, state->x + 3);
    memcpy(state->x + 7, v + START + 6, 6 * sizeof(double));
    compute_outputs(state);
}

static void reset(Unit *unit)
{
    memset(&unit->state, 0, sizeof unit->state);
    memcpy(unit->state.values, defaults, sizeof defaults);
    unit->state.stale = 1;
    take_start(&unit->state);
}

static int prepared(Unit *unit)
{
    if (unit->state.stale) {
        tt_parameters parameters;
        memcpy(&parameters, unit->state.values + PARAMETERS, sizeof parameters);
        if (tt_prepare(&parameters, &unit->state.model) != 0) {
            say(unit, ERROR, "the total mass matrix of these parameters is not positive definite; mend mass, inertia or added mass");
            return ERROR;
        }
        unit->state.stale = 0;
    }
    return OK;
}

/* A step of the unit; on DISCARD and ERROR its state is what it was. */
static int stepped(Unit *unit, double h)
{
    State *state = &unit->state;
    const double *v = state->values;
    double x[TT_STATES], forces[TT_COLUMNS], water[3];
    long i, n;
    int k, status = prepared(unit);
    if (status != OK) {
        return status;
    }
    if (!(h > 0.0) || !(v[STEP] > 0.0) || h / v[STEP] > 1e7) {
        say(unit, ERROR, "the communication step and the parameter step must be above 0, with 1e7 steps at most");
        return ERROR;
    }
    n = (long)ceil(h / v[STEP] * (1.0 - 1e-9));
    n = n < 1 ? 1 : n;
    memcpy(x, state->x, sizeof x);
    memcpy(forces, state->forces, sizeof forces);
    tt_into_body(x + 3, v + CURRENT, water);
    for (k = 0; k < 3; k++) {
        x[7 + k] -= water[k];
    }
    for (i = 0; i < n; i++) {
#if @has_thrusters@
        status = tt_step_commands(&state->model, x, forces, v + COMMANDS, v[VOLTAGE], v + WRENCH, v + CURRENT, h / (double)n);
#else
        status = tt_step(&state->model, x, v + WRENCH, v + CURRENT, h / (double)n);
#endif
        if (status != 0) {
            say(unit, DISCARD, "the motion is not finite; the step is taken back: try a smaller step, or look at the parameters");
            return DISCARD;
        }
    }
    tt_into_body(x + 3, v + CURRENT, water);
    for (k = 0; k < 3; k++) {
        x[7 + k] += water[k];
    }
    memcpy(state->x, x, sizeof x);
    memcpy(state->forces, forces, sizeof forces);
    state->time += h;
    compute_outputs(state);
    return OK;
}

/* Set variables: none of them where one is not finite or is an output. */
static int set_values(Unit *unit, const unsigned int *references, size_t n, const double *values)
{
    char message[160];
    size_t i;
    int started = 0;
    for (i = 0; i < n; i++) {
        if (references[i] >= OUTPUTS) {
            (void)snprintf(message, sizeof message, "variable %u is no input or parameter; it cannot be set", references[i]);
            say(unit, ERROR, message);
            return ERROR;
        }
        if (!(values[i] - values[i] == 0.0)) {
            (void)snprintf(message, sizeof message, "variable %u: the value is not finite; it is discarded", references[i]);
            say(unit, DISCARD, message);
            return DISCARD;
        }
    }
    for (i = 0; i < n; i++) {
        unit->state.values[references[i]] = values[i];
        unit->state.stale |= references[i] >= PARAMETERS;
        started |= references[i] >= START && references[i] < PARAMETERS;
    }
    if (started) {
        take_start(&unit->state);
    }
    return OK;
}

static int get_values(Unit *unit, const unsigned int *references, size_t n, double *values)
{
    size_t i;
    for (i = 0; i < n; i++) {
        if (references[i] >= VALUES) {
            say(unit, ERROR, "there is no such variable");
            return ERROR;
        }
        values[i] = unit->state.values[references[i]];
    }
    return OK;
}

static Unit *made(const char *name, const char *token, const void *callbacks, void *environment, int logging)
{
    Unit *unit = (Unit *)calloc(1, sizeof *unit);
    if (unit == NULL) {
        return NULL;
    }
    unit->callbacks = callbacks;
    unit->environment = environment;
    unit->logging = logging;
    (void)snprintf(unit->name, sizeof unit->name, "%s", name == NULL ? "" : name);
    reset(unit);
    if (token == NULL || strcmp(token, "@token@") != 0) {
        unit->logging = 1;
        say(unit, ERROR, "the token is not that of this unit: its description and its binary are of two exports");
        free(unit);
        return NULL;
    }
    return unit;
}

#if FMI == 2

typedef void *fmi2Component;
typedef unsigned int fmi2ValueReference;
typedef void (*Logger)(void *, const char *, int, const char *, const char *, ...);
typedef struct {
    Logger logger;
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void (*step_finished)(void *, int);
    void *environment;
} Callbacks;

static void say(const Unit *unit, int status, const char *message)
{
    const Callbacks *callbacks = (const Callbacks *)unit->callbacks;
    if (callbacks != NULL && callbacks->logger != NULL) {
        callbacks->logger(unit->environment, unit->name, status, status == DISCARD ? "logStatusDiscard" : "logStatusError", "%s", message);
    }
}

EXPORTED const char *fmi2GetTypesPlatform(void) { return "default"; }
EXPORTED const char *fmi2GetVersion(void) { return "2.0"; }
EXPORTED int fmi2SetDebugLogging(fmi2Component c, int on, size_t n, const char *const categories[])
{
    (void)n; (void)categories;
    ((Unit *)c)->logging = on;
    return OK;
}
EXPORTED fmi2Component fmi2Instantiate(const char *name, int kind, const char *token, const char *resources,
                                       const Callbacks *callbacks, int visible, int logging)
{
    (void)resources; (void)visible;
    return kind == 1 ? made(name, token, callbacks, callbacks == NULL ? NULL : callbacks->environment, logging) : NULL;
}
EXPORTED void fmi2FreeInstance(fmi2Component c) { free(c); }
EXPORTED int fmi2SetupExperiment(fmi2Component c, int has_tolerance, double tolerance, double start, int has_stop, double stop)
{
    (void)has_tolerance; (void)tolerance; (void)has_stop; (void)stop;
    ((Unit *)c)->state.time = start;
    return OK;
}
EXPORTED int fmi2EnterInitializationMode(fmi2Component c) { (void)c; return OK; }
EXPORTED int fmi2ExitInitializationMode(fmi2Component c) { return prepared((Unit *)c); }
EXPORTED int fmi2Terminate(fmi2Component c) { (void)c; return OK; }
EXPORTED int fmi2Reset(fmi2Component c) { reset((Unit *)c); return OK; }
EXPORTED int fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, double values[])
{
    return get_values((Unit *)c, vr, n, values);
}
EXPORTED int fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const double values[])
{
    return set_values((Unit *)c, vr, n, values);
}
#define NO_SUCH(type, word) \
    EXPORTED int fmi2Get##word(fmi2Component c, const fmi2ValueReference vr[], size_t n, type values[]) \
    { (void)c; (void)vr; (void)values; return n == 0 ? OK : ERROR; } \
    EXPORTED int fmi2Set##word(fmi2Component c, const fmi2ValueReference vr[], size_t n, const type values[]) \
    { (void)c; (void)vr; (void)values; return n == 0 ? OK : ERROR; }
typedef const char *Text;
NO_SUCH(int, Integer)
NO_SUCH(int, Boolean)
NO_SUCH(Text, String)
EXPORTED int fmi2GetFMUstate(fmi2Component c, void **state)
{
    if (*state == NULL && (*state = malloc(sizeof(State))) == NULL) {
        return ERROR;
    }
    memcpy(*state, &((Unit *)c)->state, sizeof(State));
    return OK;
}
EXPORTED int fmi2SetFMUstate(fmi2Component c, void *state) { memcpy(&((Unit *)c)->state, state, sizeof(State)); return OK; }
EXPORTED int fmi2FreeFMUstate(fmi2Component c, void **state) { (void)c; free(*state); *state = NULL; return OK; }
EXPORTED int fmi2SerializedFMUstateSize(fmi2Component c, void *state, size_t *size)
{
    (void)c; (void)state;
    *size = sizeof(State);
    return OK;
}
EXPORTED int fmi2SerializeFMUstate(fmi2Component c, void *state, char bytes[], size_t size)
{
    (void)c;
    if (size < sizeof(State)) {
        return ERROR;
    }
    memcpy(bytes, state, sizeof(State));
    return OK;
}
EXPORTED int fmi2DeSerializeFMUstate(fmi2Component c, const char bytes[], size_t size, void **state)
{
    (void)c;
    if (size != sizeof(State) || (*state == NULL && (*state = malloc(sizeof(State))) == NULL)) {
        return ERROR;
    }
    memcpy(*state, bytes, sizeof(State));
    return OK;
}
EXPORTED int fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference u[], size_t nu, const fmi2ValueReference k[],
                                          size_t nk, const double dv[], double out[])
{
    (void)c; (void)u; (void)nu; (void)k; (void)nk; (void)dv; (void)out;
    return ERROR;
}
EXPORTED int fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n, const int order[], const double v[])
{
    (void)c; (void)vr; (void)order; (void)v;
    return n == 0 ? OK : ERROR;
}
EXPORTED int fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n, const int order[], double v[])
{
    (void)c; (void)vr; (void)order; (void)v;
    return n == 0 ? OK : ERROR;
}
EXPORTED int fmi2DoStep(fmi2Component c, double time, double h, int no_set_state)
{
    (void)time; (void)no_set_state;
    return stepped((Unit *)c, h);
}
EXPORTED int fmi2CancelStep(fmi2Component c) { (void)c; return ERROR; }
EXPORTED int fmi2GetStatus(fmi2Component c, int kind, int *value) { (void)c; (void)kind; (void)value; return DISCARD; }
EXPORTED int fmi2GetRealStatus(fmi2Component c, int kind, double *value)
{
    *value = ((Unit *)c)->state.time;
    return kind == 2 ? OK : DISCARD; /* the last time that a step succeeded */
}
EXPORTED int fmi2GetIntegerStatus(fmi2Component c, int kind, int *value) { (void)c; (void)kind; (void)value; return DISCARD; }
EXPORTED int fmi2GetBooleanStatus(fmi2Component c, int kind, int *value)
{
    (void)c;
    *value = 0;
    return kind == 3 ? OK : DISCARD; /* it does not wish to end */
}
EXPORTED int fmi2GetStringStatus(fmi2Component c, int kind, const char **value) { (void)c; (void)kind; (void)value; return DISCARD; }

#else

typedef void *fmi3Instance;
typedef uint32_t fmi3ValueReference;
typedef void (*Logger)(void *, int, const char *, const char *);

static void say(const Unit *unit, int status, const char *message)
{
    Logger logger;
    memcpy(&logger, &unit->callbacks, sizeof logger);
    if (logger != NULL) {
        logger(unit->environment, status, status == DISCARD ? "logStatusDiscard" : "logStatusError", message);
    }
}

EXPORTED const char *fmi3GetVersion(void) { return "3.0"; }
EXPORTED int fmi3SetDebugLogging(fmi3Instance c, bool on, size_t n, const char *const categories[])
{
    (void)n; (void)categories;
    ((Unit *)c)->logging = on;
    return OK;
}
EXPORTED fmi3Instance fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources, bool visible,
                                                  bool logging, bool events, bool early, const fmi3ValueReference required[],
                                                  size_t n, void *environment, Logger logger, void *intermediate)
{
    const void *callbacks;
    (void)resources; (void)visible; (void)events; (void)early; (void)required; (void)n; (void)intermediate;
    memcpy(&callbacks, &logger, sizeof callbacks);
    return made(name, token, callbacks, environment, logging);
}
EXPORTED fmi3Instance fmi3InstantiateModelExchange(const char *name, const char *token, const char *resources, bool visible,
                                                   bool logging, void *environment, Logger logger)
{
    (void)name; (void)token; (void)resources; (void)visible; (void)logging; (void)environment; (void)logger;
    return NULL;
}
EXPORTED fmi3Instance fmi3InstantiateScheduledExecution(const char *name, const char *token, const char *resources, bool visible,
                                                        bool logging, void *environment, Logger logger, void *clock, void *lock, void *unlock)
{
    (void)name; (void)token; (void)resources; (void)visible; (void)logging; (void)environment; (void)logger; (void)clock; (void)lock; (void)unlock;
    return NULL;
}
EXPORTED void fmi3FreeInstance(fmi3Instance c) { free(c); }
EXPORTED int fmi3EnterInitializationMode(fmi3Instance c, bool has_tolerance, double tolerance, double start, bool has_stop, double stop)
{
    (void)has_tolerance; (void)tolerance; (void)has_stop; (void)stop;
    ((Unit *)c)->state.time = start;
    return OK;
}
EXPORTED int fmi3ExitInitializationMode(fmi3Instance c) { return prepared((Unit *)c); }
EXPORTED int fmi3Terminate(fmi3Instance c) { (void)c; return OK; }
EXPORTED int fmi3Reset(fmi3Instance c) { reset((Unit *)c); return OK; }
EXPORTED int fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, double values[], size_t count)
{
    return n == count ? get_values((Unit *)c, vr, n, values) : ERROR;
}
EXPORTED int fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const double values[], size_t count)
{
    return n == count ? set_values((Unit *)c, vr, n, values) : ERROR;
}
#define NO_SUCH(type, word) \
    EXPORTED int fmi3Get##word(fmi3Instance c, const fmi3ValueReference vr[], size_t n, type values[], size_t count) \
    { (void)c; (void)vr; (void)values; (void)count; return n == 0 ? OK : ERROR; } \
    EXPORTED int fmi3Set##word(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const type values[], size_t count) \
    { (void)c; (void)vr; (void)values; (void)count; return n == 0 ? OK : ERROR; }
typedef const char *Text;
NO_SUCH(float, Float32)
NO_SUCH(int8_t, Int8)
NO_SUCH(uint8_t, UInt8)
NO_SUCH(int16_t, Int16)
NO_SUCH(uint16_t, UInt16)
NO_SUCH(int32_t, Int32)
NO_SUCH(uint32_t, UInt32)
NO_SUCH(int64_t, Int64)
NO_SUCH(uint64_t, UInt64)
NO_SUCH(bool, Boolean)
NO_SUCH(Text, String)
EXPORTED int fmi3GetBinary(fmi3Instance c, const fmi3ValueReference vr[], size_t n, size_t sizes[], const uint8_t *values[], size_t count)
{
    (void)c; (void)vr; (void)sizes; (void)values; (void)count;
    return n == 0 ? OK : ERROR;
}
EXPORTED int fmi3SetBinary(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const size_t sizes[], const uint8_t *const values[], size_t count)
{
    (void)c; (void)vr; (void)sizes; (void)values; (void)count;
    return n == 0 ? OK : ERROR;
}
EXPORTED int fmi3GetClock(fmi3Instance c, const fmi3ValueReference vr[], size_t n, bool values[])
{
    (void)c; (void)vr; (void)values;
    return n == 0 ? OK : ERROR;
}
EXPORTED int fmi3SetClock(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const bool values[])
{
    (void)c; (void)vr; (void)values;
    return n == 0 ? OK : ERROR;
}
EXPORTED int fmi3GetFMUState(fmi3Instance c, void **state)
{
    if (*state == NULL && (*state = malloc(sizeof(State))) == NULL) {
        return ERROR;
    }
    memcpy(*state, &((Unit *)c)->state, sizeof(State));
    return OK;
}
EXPORTED int fmi3SetFMUState(fmi3Instance c, void *state) { memcpy(&((Unit *)c)->state, state, sizeof(State)); return OK; }
EXPORTED int fmi3FreeFMUState(fmi3Instance c, void **state) { (void)c; free(*state); *state = NULL; return OK; }
EXPORTED int fmi3SerializedFMUStateSize(fmi3Instance c, void *state, size_t *size)
{
    (void)c; (void)state;
    *size = sizeof(State);
    return OK;
}
EXPORTED int fmi3SerializeFMUState(fmi3Instance c, void *state, uint8_t bytes[], size_t size)
{
    (void)c;
    if (size < sizeof(State)) {
        return ERROR;
    }
    memcpy(bytes, state, sizeof(State));
    return OK;
}
EXPORTED int fmi3DeserializeFMUState(fmi3Instance c, const uint8_t bytes[], size_t size, void **state)
{
    (void)c;
    if (size != sizeof(State) || (*state == NULL && (*state = malloc(sizeof(State))) == NULL)) {
        return ERROR;
    }
    memcpy(*state, bytes, sizeof(State));
    return OK;
}
EXPORTED int fmi3DoStep(fmi3Instance c, double time, double h, bool no_set_state, bool *event, bool *terminate, bool *early, double *last)
{
    Unit *unit = (Unit *)c;
    const int status = stepped(unit, h);
    (void)no_set_state;
    *event = *terminate = *early = false;
    *last = status == OK ? time + h : time;
    return status;
}
/* What a unit without events, clocks, derivatives and modes of its own has no use for. */
#define UNUSED(name, arguments) EXPORTED int fmi3##name arguments { return ERROR; }
#if defined __GNUC__
#pragma GCC diagnostic ignored "-Wunused-parameter"
#endif
UNUSED(EnterEventMode, (fmi3Instance c))
UNUSED(EnterStepMode, (fmi3Instance c))
UNUSED(EnterConfigurationMode, (fmi3Instance c))
UNUSED(ExitConfigurationMode, (fmi3Instance c))
UNUSED(GetNumberOfVariableDependencies, (fmi3Instance c, fmi3ValueReference vr, size_t *n))
UNUSED(GetVariableDependencies, (fmi3Instance c, fmi3ValueReference vr, size_t *e, fmi3ValueReference *i, size_t *f, int *k, size_t n))
UNUSED(GetDirectionalDerivative, (fmi3Instance c, const fmi3ValueReference u[], size_t nu, const fmi3ValueReference k[], size_t nk, const double s[], size_t ns, double d[], size_t nd))
UNUSED(GetAdjointDerivative, (fmi3Instance c, const fmi3ValueReference u[], size_t nu, const fmi3ValueReference k[], size_t nk, const double s[], size_t ns, double d[], size_t nd))
UNUSED(GetIntervalDecimal, (fmi3Instance c, const fmi3ValueReference vr[], size_t n, double i[], int q[]))
UNUSED(GetIntervalFraction, (fmi3Instance c, const fmi3ValueReference vr[], size_t n, uint64_t i[], uint64_t r[], int q[]))
UNUSED(GetShiftDecimal, (fmi3Instance c, const fmi3ValueReference vr[], size_t n, double s[]))
UNUSED(GetShiftFraction, (fmi3Instance c, const fmi3ValueReference vr[], size_t n, uint64_t s[], uint64_t r[]))
UNUSED(SetIntervalDecimal, (fmi3Instance c, const fmi3ValueReference vr[], size_t n, const double i[]))
UNUSED(SetIntervalFraction, (fmi3Instance c, const fmi3ValueReference vr[], size_t n, const uint64_t i[], const uint64_t r[]))
UNUSED(SetShiftDecimal, (fmi3Instance c, const fmi3ValueReference vr[], size_t n, const double s[]))
UNUSED(SetShiftFraction, (fmi3Instance c, const fmi3ValueReference vr[], size_t n, const uint64_t s[], const uint64_t r[]))
UNUSED(EvaluateDiscreteStates, (fmi3Instance c))
UNUSED(UpdateDiscreteStates, (fmi3Instance c, bool *a, bool *b, bool *d, bool *e, bool *f, double *t))
UNUSED(EnterContinuousTimeMode, (fmi3Instance c))
UNUSED(CompletedIntegratorStep, (fmi3Instance c, bool a, bool *b, bool *d))
UNUSED(SetTime, (fmi3Instance c, double t))
UNUSED(SetContinuousStates, (fmi3Instance c, const double x[], size_t n))
UNUSED(GetContinuousStateDerivatives, (fmi3Instance c, double x[], size_t n))
UNUSED(GetEventIndicators, (fmi3Instance c, double x[], size_t n))
UNUSED(GetContinuousStates, (fmi3Instance c, double x[], size_t n))
UNUSED(GetNominalsOfContinuousStates, (fmi3Instance c, double x[], size_t n))
UNUSED(GetNumberOfEventIndicators, (fmi3Instance c, size_t *n))
UNUSED(GetNumberOfContinuousStates, (fmi3Instance c, size_t *n))
UNUSED(GetOutputDerivatives, (fmi3Instance c, const fmi3ValueReference vr[], size_t n, const int32_t o[], double v[], size_t m))
UNUSED(ActivateModelPartition, (fmi3Instance c, fmi3ValueReference vr, double t))

#endif
