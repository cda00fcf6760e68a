/* The impact oscillator x'' + 2 zeta x' + x = cos(omega t), x <= 0, v -> -e v at the wall, with two tangent columns.
 *
 * The loop: a state-only trial step; reject (adaptive only), or land if the guard crossed, or advance. Tangents are
 * carried by the same Runge-Kutta scheme, for accepted steps only. The Jacobian of this field is constant, so the
 * tangent pass has no use for the stages of the state.
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

typedef struct {
    double zeta, omega, restitution;
} Oscillator;

typedef struct {
    double t, x[2], f[2];   /* f is the field at (t, x), carried from step to step */
} Point;

typedef struct {
    Point end;
    double error[2];        /* the embedded estimate; zero for RK4 */
} Trial;

typedef struct {
    double h, rtol, atol;
    long steps, impacts, rejected;
    double sums[2];
} Run;

/* ---- the field -------------------------------------------------------------------------------------------------- */

/* Called as a method calls any field: it knows nothing of the stages around it. */
INLINE void field(const Oscillator *p, double t, const double x[2], double f[2])
{
    f[0] = x[1];
    f[1] = cos(p->omega * t) - 2 * p->zeta * x[1] - x[0];
}

/* Row i of y holds component i of both columns: dy = Df y. */
INLINE void linear_field(const Oscillator *p, const double y[2][2], double dy[2][2])
{
    for (int j = 0; j < 2; j++) {
        dy[0][j] = y[1][j];
        dy[1][j] = -2 * p->zeta * y[1][j] - y[0][j];
    }
}

/* ---- RK4 -------------------------------------------------------------------------------------------------------- */

INLINE Trial rk4(const Oscillator *p, const Point *a, double h)
{
    double k2[2], k3[2], k4[2], v[2];
    Trial trial = {.end.t = a->t + h};
    for (int i = 0; i < 2; i++) v[i] = a->x[i] + h / 2 * a->f[i];
    field(p, a->t + h / 2, v, k2);
    for (int i = 0; i < 2; i++) v[i] = a->x[i] + h / 2 * k2[i];
    field(p, a->t + h / 2, v, k3);
    for (int i = 0; i < 2; i++) v[i] = a->x[i] + h * k3[i];
    field(p, a->t + h, v, k4);
    for (int i = 0; i < 2; i++) trial.end.x[i] = a->x[i] + h / 6 * (a->f[i] + 2 * (k2[i] + k3[i]) + k4[i]);
    field(p, trial.end.t, trial.end.x, trial.end.f);
    return trial;
}

INLINE void shift(const double y[2][2], double c, const double dy[2][2], double out[2][2])
{
    for (int i = 0; i < 2; i++)
        for (int j = 0; j < 2; j++) out[i][j] = y[i][j] + c * dy[i][j];
}

INLINE void tangent_rk4(const Oscillator *p, double h, const double y[2][2], double out[2][2])
{
    double k1[2][2], k2[2][2], k3[2][2], k4[2][2], v[2][2];
    linear_field(p, y, k1);
    shift(y, h / 2, k1, v);
    linear_field(p, v, k2);
    shift(y, h / 2, k2, v);
    linear_field(p, v, k3);
    shift(y, h, k3, v);
    linear_field(p, v, k4);
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
static const double E[ADAPTIVE_STAGES] = {
    71.0 / 57600, 0, -71.0 / 16695, 71.0 / 1920, -17253.0 / 339200, 22.0 / 525, -1.0 / 40};

INLINE Trial dopri5(const Oscillator *p, const Point *a, double h)
{
    double k[ADAPTIVE_STAGES][2] = {{a->f[0], a->f[1]}};
    Trial trial = {.end.t = a->t + h};
#pragma GCC unroll 7
    for (int s = 1; s < ADAPTIVE_STAGES; s++) {
        for (int i = 0; i < 2; i++) {
            double sum = 0;
#pragma GCC unroll 7
            for (int r = 0; r < s; r++)
                if (A[s][r] != 0) sum += A[s][r] * k[r][i];
            trial.end.x[i] = a->x[i] + h * sum;
        }
        field(p, a->t + C[s] * h, trial.end.x, k[s]);
    }
    for (int i = 0; i < 2; i++) {
        double sum = 0;
#pragma GCC unroll 7
        for (int r = 0; r < ADAPTIVE_STAGES; r++)
            if (E[r] != 0) sum += E[r] * k[r][i];
        trial.error[i] = h * sum;
        trial.end.f[i] = k[ADAPTIVE_STAGES - 1][i];
    }
    return trial;
}

INLINE void tangent_dopri5(const Oscillator *p, double h, const double y[2][2], double out[2][2], double error[2][2])
{
    double k[ADAPTIVE_STAGES][2][2];
    linear_field(p, y, k[0]);
#pragma GCC unroll 7
    for (int s = 1; s < ADAPTIVE_STAGES; s++) {
        for (int i = 0; i < 2; i++)
            for (int j = 0; j < 2; j++) {
                double sum = 0;
#pragma GCC unroll 7
                for (int r = 0; r < s; r++)
                    if (A[s][r] != 0) sum += A[s][r] * k[r][i][j];
                out[i][j] = y[i][j] + h * sum;
            }
        linear_field(p, out, k[s]);
    }
    for (int i = 0; i < 2; i++)
        for (int j = 0; j < 2; j++) {
            double sum = 0;
#pragma GCC unroll 7
            for (int r = 0; r < ADAPTIVE_STAGES; r++)
                if (E[r] != 0) sum += E[r] * k[r][i][j];
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
INLINE double guard_ratio(const Oscillator *p, const Run *run, const Point *a, const Point *b, double h)
{
    const double s = PROBE, r = 1 - s, g0 = -a->x[0], g1 = -b->x[0], d0 = -h * a->f[0], d1 = -h * b->f[0];
    double x[2], f[2];
    for (int i = 0; i < 2; i++)
        x[i] = r * r * ((1 + 2 * s) * a->x[i] + s * h * a->f[i]) + s * s * ((3 - 2 * s) * b->x[i] - r * h * b->f[i]);
    field(p, a->t + s * h, x, f);
    const double c3 = d0 + d1 - 2 * (g1 - g0), c2 = g1 - g0 - d0 - c3;
    const double miss = fabs(-h * f[0] - (d0 + s * (2 * c2 + s * 3 * c3))) / 3.0792;
    const double size = fabs(g0) + fabs(g1) + (fabs(d0) + fabs(d1)) / 4;
    return miss / (GUARD_TOLERANCE * size + 1e3 * run->atol);
}

INLINE double clip(double factor) { return fmin(GROW, fmax(SHRINK, factor)); }

/* ---- events ----------------------------------------------------------------------------------------------------- */

/* Whether g = -x falls through 0 in the step, or dips below it; then *theta is where, as a part of the step.
 * on_guard: the step starts at g = 0, rising; that root is divided out. */
INLINE int crossing(const Point *a, const Point *b, double h, int on_guard, double *theta)
{
    const double g0 = on_guard ? 0 : -a->x[0], g1 = -b->x[0], d0 = -h * a->f[0], d1 = -h * b->f[0];
    const int dips = d0 < 0 && d1 > 0;
    if (g1 > 0 && !dips) return 0;
    double c0 = g0, c1 = d0, c2 = 3 * (g1 - g0) - 2 * d0 - d1, c3 = 2 * (g0 - g1) + d0 + d1;
    double low = 0, high = 1;
    if (g1 > 0) {
        high = -c1 / (c2 + sqrt(fmax(0, c2 * c2 - 3 * c1 * c3)));
        if (c0 + high * (c1 + high * (c2 + high * c3)) > 0) return 0;
    }
    if (on_guard) c0 = c1, c1 = c2, c2 = c3, c3 = 0;
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
INLINE void polish(const Oscillator *p, Point *a, double y[2][2])
{
    const double g = -a->x[0], rate = -a->f[0], curvature = -a->f[1];
    double d = -g / rate;
    d -= curvature * d * d / (2 * rate);
    const double jerk = -2 * p->zeta * a->f[1] - a->f[0] - p->omega * sin(p->omega * a->t);
    a->x[0] += d * (a->f[0] + d / 2 * a->f[1]);
    a->x[1] += d * (a->f[1] + d / 2 * jerk);
    a->t += d;
    field(p, a->t, a->x, a->f);
    double dy[2][2];
    linear_field(p, y, dy);
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

/* v -> -e v, and S = Dg + (f+ - Dg f-) grad h / (grad h . f-) on every column; h = -x. */
INLINE void impact(const Oscillator *p, Point *a, double y[2][2])
{
    const double before[2] = {a->f[0], a->f[1]};
    a->x[1] *= -p->restitution;
    /* The forcing is the same on both sides: only the damping term changes. */
    a->f[0] = a->x[1];
    a->f[1] = before[1] - 2 * p->zeta * (a->x[1] - before[0]);
    const double jump[2] = {a->f[0] - before[0], a->f[1] + p->restitution * before[1]};
    for (int j = 0; j < 2; j++) {
        const double delay = -y[0][j] / -before[0]; /* grad h . y / grad h . f- */
        y[0][j] += jump[0] * delay;
        y[1][j] = -p->restitution * y[1][j] + jump[1] * delay;
    }
}

/* ---- the loop --------------------------------------------------------------------------------------------------- */

INLINE Trial try_step(const Oscillator *p, const Point *a, double h, int adaptive)
{
    return adaptive ? dopri5(p, a, h) : rk4(p, a, h);
}

INLINE void carry(
    const Oscillator *p, double h, int adaptive, const double y[2][2], double out[2][2], double error[2][2])
{
    if (adaptive) tangent_dopri5(p, h, y, out, error);
    else tangent_rk4(p, h, y, out);
}

/* Steps to the root from the same base, crosses the wall, and leaves the point on the guard. */
static __attribute__((noinline)) void land(
    const Oscillator *p, Run *run, Point *a, double y[2][2], double h, double theta, int adaptive)
{
    double tau = theta * h, next[2][2], unused[2][2];
    Trial trial = try_step(p, a, tau, adaptive);
    for (int i = 0; i < MAX_RESTEPS && fabs(trial.end.x[0] / trial.end.f[0]) > LANDED * h; i++) {
        tau -= trial.end.x[0] / trial.end.f[0];
        trial = try_step(p, a, tau, adaptive);
    }
    carry(p, tau, adaptive, y, next, unused);
    *a = trial.end;
    for (int i = 0; i < POLISHES; i++) polish(p, a, next);
    orthonormalise(next, run->sums);
    impact(p, a, next);
    orthonormalise(next, run->sums);
    for (int i = 0; i < 2; i++)
        for (int j = 0; j < 2; j++) y[i][j] = next[i][j];
    run->impacts++;
    run->steps++;
}

INLINE void integrate(const Oscillator *p, Run *run, Point *a, double y[2][2], double t1, int adaptive)
{
    const double end = a->t + t1;
    double last_log_ratio = 0, next[2][2], error[2][2];
    /* After an impact, and at the start, the guard may be 0 to rounding and rising: no crossing there. */
    int on_guard = fabs(a->x[0]) <= 1e-9 * fabs(a->f[0]) * run->h;
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
        if (__builtin_expect(crossing(a, &trial.end, h, on_guard, &theta), 0)) {
            land(p, run, a, y, h, theta, adaptive); /* h outlives the event untouched */
            on_guard = 1;
            since = 0;
            continue;
        }
        carry(p, h, adaptive, y, next, error);
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
    orthonormalise(y, run->sums);
}

INLINE long start(
    double t1, double h, double rtol, double atol, const double parameters[3], double *t, double x[2], double frame[4],
    double sums[2], long counts[2], int adaptive)
{
    const Oscillator p = {parameters[0], parameters[1], parameters[2]};
    Run run = {.h = h, .rtol = rtol, .atol = atol};
    Point a = {.t = *t, .x = {x[0], x[1]}};
    double y[2][2] = {{frame[0], frame[1]}, {frame[2], frame[3]}};
    field(&p, a.t, a.x, a.f);
    integrate(&p, &run, &a, y, t1, adaptive);
    *t = a.t;
    for (int i = 0; i < 2; i++) {
        x[i] = a.x[i];
        sums[i] = run.sums[i];
        for (int j = 0; j < 2; j++) frame[2 * i + j] = y[i][j];
    }
    counts[0] = run.impacts, counts[1] = run.rejected;
    return run.steps;
}

/* Runs for a time t1 at the fixed step h; counts: impacts, rejected steps (none). Returns the steps taken. */
long impact_fixed(
    double t1, double h, const double parameters[3], double *t, double x[2], double frame[4], double sums[2],
    long counts[2])
{
    return start(t1, h, 0, 0, parameters, t, x, frame, sums, counts, 0);
}

/* Runs for a time t1 with error control on state, frame and guard, h being the first step. Returns the steps taken. */
long impact_adaptive(
    double t1, double h, double rtol, double atol, const double parameters[3], double *t, double x[2], double frame[4],
    double sums[2], long counts[2])
{
    return start(t1, h, rtol, atol, parameters, t, x, frame, sums, counts, 1);
}
