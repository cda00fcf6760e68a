/* Forced oscillators with an event, x'' + damping x' + (a force of x and t) = 0, with two tangent columns.
 *
 * The loop: a state-only trial step; reject (adaptive only), or land if the guard crossed, or advance. Tangents are
 * carried by the same Runge-Kutta scheme, for accepted steps only. Whoever includes this says what the oscillator is:
 * the struct System and the functions declared below.
 */
#include <math.h>

/* Step-size controller, in powers of the error ratio: h *= SAFETY * ratio^-PI_NOW * last_ratio^PI_LAST. */
#define SAFETY 0.8
#define SHRINK 0.2
#define GROW 10.0
#define PI_NOW (0.7 / 5)
#define PI_LAST (0.4 / 5)
#define REJECTED_POWER (1.0 / 5)

#define EVERY 10            /* accepted steps between orthonormalisations */
#define GUARD_TOLERANCE 0.02
#define PROBE 0.21132486540518713 /* where the slope of a cubic interpolant errs most */
#define LANDED 1e-5         /* |g / g'| within this part of the step: near enough for the polish */
#define HERMITE_ITERATIONS 6
#define MAX_RESTEPS 8
#define POLISHES 2

enum { ADAPTIVE_STAGES = 7 };

#define INLINE static inline __attribute__((always_inline))

typedef struct System System;

typedef struct {
    double t, x[2], f[2];   /* f is the field at (t, x), carried from step to step */
    double k;               /* -d f[1] / d x[0] there, if the field has to say so */
} Point;

typedef struct {
    Point end;
    double error[2];             /* the embedded estimate; zero for RK4 */
    double k[ADAPTIVE_STAGES];   /* the stiffness at the stages: all that their tangents need */
} Trial;

typedef struct {
    double h, rtol, atol, end;
    long steps, events, losses, rejected;
    double sums[2];
} Run;

/* ---- what the oscillator is ------------------------------------------------------------------------------------- */

/* f, and k where it varies, from t and x. Called as a method calls any field: it knows nothing of the stages. */
INLINE void field(const System *p, Point *a);
INLINE double damping(const System *p);
INLINE double stiffness(const Point *a);
INLINE double forcing_rate(const System *p, double t);
/* Falls through 0 at an event; linear, so that the guard of f is the rate of the guard. */
INLINE double guard(const System *p, const double x[2]);
/* Before the first step: the field. */
INLINE void begin(System *p, Run *run, Point *a, double y[2][2]);
/* Crosses the event, with orthonormal columns before and after; leaves the point on the guard. */
INLINE void cross(System *p, Run *run, Point *a, double y[2][2]);

/* Row i of y holds component i of both columns: dy = Df y. */
INLINE void linear_field(const System *p, double k, const double y[2][2], double dy[2][2])
{
    for (int j = 0; j < 2; j++) {
        dy[0][j] = y[1][j];
        dy[1][j] = -damping(p) * y[1][j] - k * y[0][j];
    }
}

/* ---- RK4 -------------------------------------------------------------------------------------------------------- */

INLINE Trial rk4(const System *p, const Point *a, double h)
{
    Point b = {.t = a->t + h / 2}, c = {.t = a->t + h / 2}, d = {.t = a->t + h};
    for (int i = 0; i < 2; i++) b.x[i] = a->x[i] + h / 2 * a->f[i];
    field(p, &b);
    for (int i = 0; i < 2; i++) c.x[i] = a->x[i] + h / 2 * b.f[i];
    field(p, &c);
    for (int i = 0; i < 2; i++) d.x[i] = a->x[i] + h * c.f[i];
    field(p, &d);
    Trial trial = {.end.t = a->t + h, .k = {stiffness(a), stiffness(&b), stiffness(&c), stiffness(&d)}};
    for (int i = 0; i < 2; i++) trial.end.x[i] = a->x[i] + h / 6 * (a->f[i] + 2 * (b.f[i] + c.f[i]) + d.f[i]);
    field(p, &trial.end);
    return trial;
}

INLINE void shift(const double y[2][2], double c, const double dy[2][2], double out[2][2])
{
    for (int i = 0; i < 2; i++)
        for (int j = 0; j < 2; j++) out[i][j] = y[i][j] + c * dy[i][j];
}

INLINE void tangent_rk4(const System *p, const Trial *trial, double h, const double y[2][2], double out[2][2])
{
    double k1[2][2], k2[2][2], k3[2][2], k4[2][2], v[2][2];
    linear_field(p, trial->k[0], y, k1);
    shift(y, h / 2, k1, v);
    linear_field(p, trial->k[1], v, k2);
    shift(y, h / 2, k2, v);
    linear_field(p, trial->k[2], v, k3);
    shift(y, h, k3, v);
    linear_field(p, trial->k[3], v, k4);
    for (int i = 0; i < 2; i++)
        for (int j = 0; j < 2; j++)
            out[i][j] = y[i][j] + h / 6 * (k1[i][j] + 2 * (k2[i][j] + k3[i][j]) + k4[i][j]);
}

/* ---- Dormand-Prince 5(4) ---------------------------------------------------------------------------------------- */

static const double A[ADAPTIVE_STAGES][ADAPTIVE_STAGES - 1] = {
    {0},
    {1.0 / 5},
    {3.0 / 40, 9.0 / 40},
    {44.0 / 45, -56.0 / 15, 32.0 / 9},
    {19372.0 / 6561, -25360.0 / 2187, 64448.0 / 6561, -212.0 / 729},
    {9017.0 / 3168, -355.0 / 33, 46732.0 / 5247, 49.0 / 176, -5103.0 / 18656},
    {35.0 / 384, 0, 500.0 / 1113, 125.0 / 192, -2187.0 / 6784, 11.0 / 84}, /* the weights: FSAL */
};
static const double C[ADAPTIVE_STAGES] = {0, 1.0 / 5, 3.0 / 10, 4.0 / 5, 8.0 / 9, 1, 1};
/* The estimate of diffrax, two thirds of Dormand and Prince's: by theirs the steps would be 8 % shorter than ours. */
static const double E[ADAPTIVE_STAGES] = {
    71.0 / 86400, 0, -142.0 / 50085, 71.0 / 2880, -5751.0 / 169600, 44.0 / 1575, -1.0 / 60};

INLINE Trial dopri5(const System *p, const Point *a, double h)
{
    double f[ADAPTIVE_STAGES][2] = {{a->f[0], a->f[1]}};
    Trial trial = {.k = {stiffness(a)}};
#pragma GCC unroll 7
    for (int s = 1; s < ADAPTIVE_STAGES; s++) {
        trial.end.t = a->t + C[s] * h;
        for (int i = 0; i < 2; i++) {
            double sum = 0;
#pragma GCC unroll 7
            for (int r = 0; r < s; r++)
                if (A[s][r] != 0) sum += A[s][r] * f[r][i];
            trial.end.x[i] = a->x[i] + h * sum;
        }
        field(p, &trial.end);
        trial.k[s] = stiffness(&trial.end);
        for (int i = 0; i < 2; i++) f[s][i] = trial.end.f[i];
    }
    for (int i = 0; i < 2; i++) {
        double sum = 0;
#pragma GCC unroll 7
        for (int r = 0; r < ADAPTIVE_STAGES; r++)
            if (E[r] != 0) sum += E[r] * f[r][i];
        trial.error[i] = h * sum;
    }
    return trial;
}

INLINE void tangent_dopri5(
    const System *p, const Trial *trial, double h, const double y[2][2], double out[2][2], double error[2][2])
{
    double dy[ADAPTIVE_STAGES][2][2];
    linear_field(p, trial->k[0], y, dy[0]);
#pragma GCC unroll 7
    for (int s = 1; s < ADAPTIVE_STAGES; s++) {
        for (int i = 0; i < 2; i++)
            for (int j = 0; j < 2; j++) {
                double sum = 0;
#pragma GCC unroll 7
                for (int r = 0; r < s; r++)
                    if (A[s][r] != 0) sum += A[s][r] * dy[r][i][j];
                out[i][j] = y[i][j] + h * sum;
            }
        linear_field(p, trial->k[s], out, dy[s]);
    }
    for (int i = 0; i < 2; i++)
        for (int j = 0; j < 2; j++) {
            double sum = 0;
#pragma GCC unroll 7
            for (int r = 0; r < ADAPTIVE_STAGES; r++)
                if (E[r] != 0) sum += E[r] * dy[r][i][j];
            error[i][j] = h * sum;
        }
}

/* ---- error control ---------------------------------------------------------------------------------------------- */

/* Maximum norms. */
INLINE double state_ratio(const Run *run, const Point *a, const Trial *trial)
{
    double worst = 0;
    for (int i = 0; i < 2; i++) {
        const double scale = run->atol + run->rtol * fmax(fabs(a->x[i]), fabs(trial->end.x[i]));
        worst = fmax(worst, fabs(trial->error[i]) / scale);
    }
    return worst;
}

/* Each column against its own length: the frame grows, so that an absolute tolerance means nothing for it. */
INLINE double frame_ratio(const Run *run, const double y[2][2], const double next[2][2], const double error[2][2])
{
    double worst = 0;
    for (int j = 0; j < 2; j++) {
        double length = 0, largest = 0;
        for (int i = 0; i < 2; i++) {
            length += fmax(y[i][j] * y[i][j], next[i][j] * next[i][j]);
            largest = fmax(largest, fabs(error[i][j]));
        }
        worst = fmax(worst, largest / sqrt(length / 2));
    }
    return worst / run->rtol;
}

/* The slope of the guard, a part PROBE into the step, against that of the cubic that its root is sought on. */
INLINE double guard_ratio(const System *p, const Run *run, const Point *a, const Point *b, double h)
{
    const double s = PROBE, r = 1 - s, g0 = guard(p, a->x), g1 = guard(p, b->x);
    const double d0 = h * guard(p, a->f), d1 = h * guard(p, b->f);
    Point c = {.t = a->t + s * h};
    for (int i = 0; i < 2; i++)
        c.x[i] = r * r * ((1 + 2 * s) * a->x[i] + s * h * a->f[i]) + s * s * ((3 - 2 * s) * b->x[i] - r * h * b->f[i]);
    field(p, &c);
    const double c3 = d0 + d1 - 2 * (g1 - g0), c2 = g1 - g0 - d0 - c3;
    const double miss = fabs(h * guard(p, c.f) - (d0 + s * (2 * c2 + s * 3 * c3))) / 3.0792;
    const double size = fabs(g0) + fabs(g1) + (fabs(d0) + fabs(d1)) / 4;
    return miss / (GUARD_TOLERANCE * size + 1e3 * run->atol);
}

INLINE double clip(double factor) { return fmin(GROW, fmax(SHRINK, factor)); }

/* ---- events ----------------------------------------------------------------------------------------------------- */

/* Whether the guard falls through 0 in the step, or dips below it; then *theta is where, as a part of the step.
 * on_guard: the step starts at g = 0, rising; that root is divided out, and once more where it is a double one. */
INLINE int crossing(const System *p, const Point *a, const Point *b, double h, int on_guard, double *theta)
{
    const double g0 = on_guard ? 0 : guard(p, a->x), g1 = guard(p, b->x);
    const double d0 = h * guard(p, a->f), d1 = h * guard(p, b->f);
    const int dips = d0 < 0 && d1 > 0;
    if (g1 > 0 && !dips) return 0;
    double c0 = g0, c1 = d0, c2 = 3 * (g1 - g0) - 2 * d0 - d1, c3 = 2 * (g0 - g1) + d0 + d1;
    double low = 0, high = 1;
    if (g1 > 0) {
        high = -c1 / (c2 + sqrt(fmax(0, c2 * c2 - 3 * c1 * c3)));
        if (c0 + high * (c1 + high * (c2 + high * c3)) > 0) return 0;
    }
    if (on_guard) c0 = c1, c1 = c2, c2 = c3, c3 = 0;
    if (on_guard && c0 == 0) c0 = c1, c1 = c2, c2 = 0;
    const double at_high = c0 + high * (c1 + high * (c2 + high * c3));
    double root = high * c0 / (c0 - at_high);
    for (int i = 0; i < HERMITE_ITERATIONS; i++) {
        const double value = c0 + root * (c1 + root * (c2 + root * c3));
        const double slope = c1 + root * (2 * c2 + root * 3 * c3);
        if (value > 0) low = root; else high = root;
        root -= value / slope;
        if (!(root > low && root < high)) root = (low + high) / 2;
    }
    *theta = root;
    return 1;
}

/* Two more terms of the flow bring the point onto the guard: the error is of third order in g. */
INLINE void polish(const System *p, Point *a, double y[2][2])
{
    const double k = stiffness(a), jerk = -damping(p) * a->f[1] - k * a->f[0] + forcing_rate(p, a->t);
    const double second[2] = {a->f[1], jerk}, rate = guard(p, a->f);
    double d = -guard(p, a->x) / rate, dy[2][2];
    d -= guard(p, second) * d * d / (2 * rate);
    linear_field(p, k, y, dy);
    for (int i = 0; i < 2; i++) a->x[i] += d * (a->f[i] + d / 2 * second[i]);
    a->t += d;
    field(p, a);
    shift(y, d, dy, y);
}

/* Modified Gram-Schmidt; adds ln R_jj to sums. */
INLINE void orthonormalise(double y[2][2], double sums[2])
{
    const double r0 = sqrt(y[0][0] * y[0][0] + y[1][0] * y[1][0]);
    y[0][0] /= r0, y[1][0] /= r0;
    const double overlap = y[0][0] * y[0][1] + y[1][0] * y[1][1];
    y[0][1] -= overlap * y[0][0], y[1][1] -= overlap * y[1][0];
    const double r1 = sqrt(y[0][1] * y[0][1] + y[1][1] * y[1][1]);
    y[0][1] /= r1, y[1][1] /= r1;
    sums[0] += log(r0), sums[1] += log(r1);
}

/* ---- the loop --------------------------------------------------------------------------------------------------- */

INLINE Trial try_step(const System *p, const Point *a, double h, int adaptive)
{
    return adaptive ? dopri5(p, a, h) : rk4(p, a, h);
}

INLINE void carry(
    const System *p, const Trial *trial, double h, int adaptive, const double y[2][2], double out[2][2],
    double error[2][2])
{
    if (adaptive) tangent_dopri5(p, trial, h, y, out, error);
    else tangent_rk4(p, trial, h, y, out);
}

/* Steps to the root from the same base, and crosses. */
static __attribute__((noinline)) void land(
    System *p, Run *run, Point *a, double y[2][2], double h, double theta, int adaptive)
{
    double tau = theta * h, next[2][2], unused[2][2];
    Trial trial = try_step(p, a, tau, adaptive);
    for (int i = 0; i < MAX_RESTEPS; i++) {
        const double behind = guard(p, trial.end.x) / guard(p, trial.end.f);
        if (fabs(behind) <= LANDED * h) break;
        tau -= behind;
        trial = try_step(p, a, tau, adaptive);
    }
    carry(p, &trial, tau, adaptive, y, next, unused);
    *a = trial.end;
    for (int i = 0; i < POLISHES; i++) polish(p, a, next);
    orthonormalise(next, run->sums);
    cross(p, run, a, next);
    for (int i = 0; i < 2; i++)
        for (int j = 0; j < 2; j++) y[i][j] = next[i][j];
    run->steps++;
}

INLINE void integrate(System *p, Run *run, Point *a, double y[2][2], int adaptive)
{
    const double end = run->end;
    double last_log_ratio = 0, next[2][2], error[2][2];
    /* After an event, and at the start, the guard may be 0 to rounding and rising: no crossing there. */
    int on_guard = fabs(guard(p, a->x)) <= 1e-9 * fabs(guard(p, a->f)) * run->h;
    long since = 0;
    while (end - a->t > 1e-12 * end) {
        const double h = fmin(run->h, end - a->t);
        const Trial trial = try_step(p, a, h, adaptive);
        double ratio = 0, theta;
        if (adaptive) {
            ratio = fmax(state_ratio(run, a, &trial), guard_ratio(p, run, a, &trial.end, h));
            if (!(ratio <= 1)) {
                run->h = h * clip(SAFETY * pow(ratio, -REJECTED_POWER));
                run->rejected++;
                continue;
            }
        }
        if (__builtin_expect(crossing(p, a, &trial.end, h, on_guard, &theta), 0)) {
            land(p, run, a, y, h, theta, adaptive); /* h outlives the event untouched */
            on_guard = 1;
            since = 0;
            continue;
        }
        carry(p, &trial, h, adaptive, y, next, error);
        if (adaptive) {
            ratio = fmax(ratio, frame_ratio(run, y, next, error));
            if (!(ratio <= 1)) {
                run->h = h * clip(SAFETY * pow(ratio, -REJECTED_POWER));
                run->rejected++;
                continue;
            }
            const double log_ratio = log(fmax(ratio, 1e-10));
            run->h = h * clip(SAFETY * exp(PI_LAST * last_log_ratio - PI_NOW * log_ratio));
            last_log_ratio = log_ratio;
        }
        *a = trial.end;
        for (int i = 0; i < 2; i++)
            for (int j = 0; j < 2; j++) y[i][j] = next[i][j];
        on_guard = 0;
        run->steps++;
        if (++since == EVERY) {
            orthonormalise(y, run->sums);
            since = 0;
        }
    }
}

/* Goes on from t, x and frame until run->end; counts: events, losses, rejected steps. Returns the steps taken. */
INLINE long go(
    System *p, Run run, double *t, double x[2], double frame[4], double sums[2], long counts[3], int adaptive)
{
    Point a = {.t = *t, .x = {x[0], x[1]}};
    double y[2][2] = {{frame[0], frame[1]}, {frame[2], frame[3]}};
    begin(p, &run, &a, y);
    integrate(p, &run, &a, y, adaptive);
    orthonormalise(y, run.sums);
    *t = a.t;
    for (int i = 0; i < 2; i++) {
        x[i] = a.x[i];
        sums[i] = run.sums[i];
        for (int j = 0; j < 2; j++) frame[2 * i + j] = y[i][j];
    }
    counts[0] = run.events, counts[1] = run.losses, counts[2] = run.rejected;
    return run.steps;
}
