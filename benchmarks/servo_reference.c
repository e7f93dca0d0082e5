/* A servo in C, written a second time from the same rules: what the compiled loop is measured against, and
 * what its guard must agree with bit for bit.
 *
 *   gcc -O2 -ffp-contract=off servo_reference.c -lm -o servo_reference
 *   ./servo_reference PERIOD_NS TICKS      median, p99, p99.9, max of |period error| [us] and missed ticks
 *   ./servo_reference step COUNT           mean time of one force step [ns]
 *
 * As a shared library it exports reference_guard and reference_law.
 */
#define _GNU_SOURCE
#include <math.h>
#include <sched.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <time.h>

/* memory and limits of the guard: tissueid/haptics/guard.py, tissueid/haptics/limits.py */
enum { STATE, FAULT, LAMPS, PREVIOUS, FAULT_FORCE = 6, FAULT_AGE = 9, VELOCITY, GAIN = 13, PHASE, RISE_RATE,
       PENDING, DAMPED, WANTED, READY, PENETRATION, SILENT = 23, STILL, STILL_FORCE, STILL_CHANGE = 28, MEAN_SQUARE,
       LET_GO, DELAYED = 32 };
enum { CLAMP, SLEW, RMS_LIMIT, RMS_WINDOW, RAMP, RECOVERY, FAULT_RAMP, DAMPING, DAMPING_TIME, ENGAGE_BELOW,
       STALL = 19, DEAD_MAN_TIME = 22, PAUSE = 24, PAUSE_RAMP, DELAY };
enum { CLOSED, ARMED = 4, ENGAGED, FAULTED };
enum { RISING, RELEASING, RECOVERING, YIELDING };
enum { CLIPPED = 1, SLEWED = 2, STALLED = 32, RMS_LIMITED = 64, DEAD_MAN = 128, RAMPING = 256, QUIET = 4096, LATENCY = 8192 };
enum { NOT_A_NUMBER = 7, OVERHEATED = 11 };

static double most(double a, double b) { return a > b ? a : b; }
static double least(double a, double b) { return a < b ? a : b; }

static double length(const double *v) {
    if (most(most(fabs(v[0]), fabs(v[1])), fabs(v[2])) > 1e150) return INFINITY;
    return sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
}

static void fail(double *m, double fault) {
    if (m[STATE] == FAULTED || m[STATE] == CLOSED) return;
    m[STATE] = FAULTED; m[FAULT] = fault; m[FAULT_AGE] = 0.0; m[WANTED] = 0.0;
    memcpy(m + FAULT_FORCE, m + PREVIOUS, 3 * sizeof(double));
}

static void engage(double *m, const double *l) {
    m[STATE] = ENGAGED; m[PHASE] = RISING; m[GAIN] = 0.0; m[RISE_RATE] = 1.0 / l[RAMP];
    m[STILL] = 0.0; m[STILL_CHANGE] = 0.0;
    for (int i = 0; i < 3; i++) m[PREVIOUS + i] = m[STILL_FORCE + i] = 0.0;
}

static void gain_moves(double *m, const double *l, double step, int stalled) {
    if (stalled && m[PHASE] == RISING) {
        m[PHASE] = RECOVERING;
        if (m[GAIN] >= 1.0) m[RISE_RATE] = 1.0 / l[RECOVERY];
    }
    if (m[PHASE] == RISING) {
        double risen = least(l[DELAY] / (l[DELAY] + m[DELAYED]), m[GAIN] + step * m[RISE_RATE]);
        m[GAIN] = most(risen, m[GAIN] - step / l[RECOVERY]);
        return;
    }
    int silent = m[SILENT] >= l[PAUSE];
    m[GAIN] -= step / (silent ? l[PAUSE_RAMP] : m[PHASE] == RELEASING ? l[DEAD_MAN_TIME] : l[FAULT_RAMP]);
    if (m[GAIN] > 0.0) return;
    m[GAIN] = 0.0;
    if (m[PHASE] == RELEASING) m[STATE] = ARMED;
    else if (m[PHASE] == RECOVERING) m[PHASE] = RISING;
    else { m[DAMPED] += step; if (m[DAMPED] >= l[DAMPING_TIME]) fail(m, m[PENDING]); }
}

static int limited(const double *m, const double *l, const double *force, double *out) {
    double damping = (1.0 - m[GAIN]) * l[DAMPING];
    for (int i = 0; i < 3; i++) out[i] = m[GAIN] * force[i] - damping * m[VELOCITY + i];
    int lamps = m[GAIN] < 1.0 ? RAMPING : 0;
    double size = length(out);
    if (size == INFINITY) {
        double largest = most(most(fabs(out[0]), fabs(out[1])), fabs(out[2]));
        for (int i = 0; i < 3; i++) out[i] = out[i] / largest * (2.0 * l[CLAMP]);
        size = length(out);
    }
    double bound = size;
    if (bound > l[CLAMP]) { bound = l[CLAMP]; lamps |= CLIPPED; }
    if (size > 0.0) {
        double along = (m[PREVIOUS] * out[0] + m[PREVIOUS + 1] * out[1] + m[PREVIOUS + 2] * out[2]) / size;
        double risen = most(along, 0.0) + l[SLEW];
        if (bound > risen) { bound = risen; lamps |= SLEWED; }
    }
    double share = m[MEAN_SQUARE] / (l[RMS_LIMIT] * l[RMS_LIMIT]);
    double fold = least(most((share - 0.8) / (1.0 - 0.8), 0.0), 1.0);
    double sustained = l[CLAMP] - fold * (l[CLAMP] - least(l[RMS_LIMIT], l[CLAMP]));
    if (bound > sustained) { bound = sustained; lamps |= RMS_LIMITED; }
    if (bound < size) { double scale = bound / size; for (int i = 0; i < 3; i++) out[i] = out[i] * scale; }
    return lamps;
}

void reference_guard(double *m, const double *l, const double *force, double dt, double *out) {
    int stalled = !(dt > 0.0 && dt <= l[STALL]);
    double step = stalled ? l[STALL] : dt;
    int lamps = (stalled ? STALLED : 0) | (m[LET_GO] != 0.0 ? DEAD_MAN : 0) | (m[SILENT] >= l[PAUSE] ? QUIET : 0)
        | (m[DELAYED] > 0.0 ? LATENCY : 0);
    int finite = isfinite(force[0]) && isfinite(force[1]) && isfinite(force[2]);
    out[0] = out[1] = out[2] = 0.0;
    int is_free = m[PENETRATION] <= 0.0 || (finite && length(force) < l[ENGAGE_BELOW]);
    if (m[STATE] == ARMED && m[READY] != 0.0 && is_free) engage(m, l);
    if (m[STATE] == ENGAGED) { if (finite) gain_moves(m, l, step, stalled); else fail(m, NOT_A_NUMBER); }
    if (m[STATE] == ENGAGED) lamps |= limited(m, l, force, out);
    if (m[STATE] == FAULTED) {
        m[FAULT_AGE] += dt > step ? least(dt, 1.0) : step;
        double left = 1.0 - m[FAULT_AGE] / l[m[SILENT] >= l[PAUSE] ? PAUSE_RAMP : FAULT_RAMP];
        if (left >= 1e-9) { lamps |= RAMPING; for (int i = 0; i < 3; i++) out[i] = left * m[FAULT_FORCE + i]; }
    }
    double square = 0.0;
    for (int i = 0; i < 3; i++) { m[PREVIOUS + i] = out[i]; square += out[i] * out[i]; }
    m[MEAN_SQUARE] += (square - m[MEAN_SQUARE]) * least(step / l[RMS_WINDOW], 1.0);
    if (m[MEAN_SQUARE] > 1.25 * l[RMS_LIMIT] * l[RMS_LIMIT]) fail(m, OVERHEATED);
    m[LAMPS] = lamps;
}

/* One branch, in contact: F = F_s(x) + K s with the exact recursion of s. */
double reference_law(double *state, double *depth, double x, double dt) {
    const double tau = 0.021;
    double ratio = dt / tau, a = exp(-ratio), phi = -expm1(-ratio) / ratio;
    *state = a * *state + phi * (x - *depth);
    *depth = x;
    return x * (47.42 + x * (-5.577 + x * 0.3804)) + 63.62 * *state;
}

static int64_t now(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec * 1000000000LL + t.tv_nsec;
}

static const double LIMITS[27] = {5.0, 0.5, 5.0, 30.0, 1.0, 0.1, 0.02, 2.0, 0.1, 0.2, 50, 1.5, 200, 0.001, 0.1,
                                  10, 0.2, 0.2, 0.5, 0.005, 0.0, 4.0, 0.1, 4095.0, 0.008, 0.01, 1.5};
static double memory[33];

static void step(double *state, double *depth, double x, double dt) {
    double force[3] = {0.0, 0.0, 0.01 * reference_law(state, depth, x, dt)}, out[3];
    reference_guard(memory, LIMITS, force, dt, out);
}

static int compare(const void *a, const void *b) {
    int64_t x = *(const int64_t *)a, y = *(const int64_t *)b;
    return (x > y) - (x < y);
}

static void punctual(void) {
    struct sched_param priority = {.sched_priority = 80};
    cpu_set_t set;
    int last = 0;
    prctl(PR_SET_TIMERSLACK, 1, 0, 0, 0);
    sched_getaffinity(0, sizeof set, &set);
    for (int i = 0; i < CPU_SETSIZE; i++) if (CPU_ISSET(i, &set)) last = i;
    CPU_ZERO(&set);
    CPU_SET(last, &set);
    sched_setaffinity(0, sizeof set, &set);
    if (mlockall(MCL_CURRENT | MCL_FUTURE) != 0) fprintf(stderr, "memory is not locked\n");
    if (sched_setscheduler(0, SCHED_FIFO, &priority) != 0) fprintf(stderr, "no real-time priority\n");
}

int main(int count, char **words) {
    double state = 0.0, depth = 0.0;
    if (count != 3) return 2;
    memory[STATE] = ENGAGED; memory[GAIN] = 1.0;
    if (strcmp(words[1], "step") == 0) {
        long steps = atol(words[2]);
        int64_t begun = now();
        for (long k = 0; k < steps; k++) step(&state, &depth, 1.0 + 1e-9 * k, 1e-3);
        printf("%.2f\n", (double)(now() - begun) / steps);
        return memory[STATE] == ENGAGED ? 0 : 1;
    }
    int64_t period = atoll(words[1]), ticks = atoll(words[2]), missed = 0;
    int64_t *errors = malloc(ticks * sizeof *errors);
    punctual();
    int64_t last = now(), deadline = last + period;
    for (int64_t k = 0; k < ticks; k++) {
        struct timespec until = {deadline / 1000000000LL, deadline % 1000000000LL};
        while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, NULL) != 0) { }
        int64_t t = now();
        errors[k] = llabs(t - last - period);
        step(&state, &depth, 1.0 + 0.5 * sin(1e-9 * t), 1e-9 * (t - last));
        last = t;
        deadline += period;
        if ((t = now()) > deadline) {
            int64_t behind = (t - deadline) / period;
            missed += behind; deadline += behind * period;
        }
    }
    qsort(errors, ticks, sizeof *errors, compare);
    printf("%.3f %.3f %.3f %.3f %lld\n", errors[ticks / 2] * 1e-3, errors[ticks * 99 / 100] * 1e-3,
           errors[ticks * 999 / 1000] * 1e-3, errors[ticks - 1] * 1e-3, (long long)missed);
    free(errors);
    return 0;
}
