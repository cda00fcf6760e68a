/* Example 5.1 of Linh, Truong & Tuyen (doi:10.52825/dae-p.v3i.2632): a mass on a nonlinear spring with a damper and a
 * disk that rolls without slip, E x' = f(x) with E = diag(1, 1, 0, 0), by the discrete and the continuous QR method.
 *
 * Both integrate by the half-explicit Dormand-Prince pair 5(4). As E1 = [I 0], the first two components of a stage are
 * those of an explicit method, and the constraints f2(x) = 0 are two equations for the other two. The frame goes
 * through the same stages as the state: its last two rows follow from the first two by A2 Y = 0.
 */
#include <math.h>
#include <string.h>
#if defined(__SSE2__)
#include <xmmintrin.h>
#endif

#define INLINE static inline __attribute__((always_inline))

#define SAFETY 0.9
#define SHRINK 0.2
#define GROW 5.0
#define ORDER 5
#define FIRST_STEP 1e-3

#define ITERATIONS 12       /* of Newton's, before a step is given up */
#define NEAR 1e-2           /* ... which end at a correction below this times sqrt(tol): the next would be its square */

enum { D = 2, ALGEBRAIC = 2, N = D + ALGEBRAIC, K = 2, STAGES = 7 };

typedef double Row __attribute__((vector_size(K * sizeof(double)))); /* a component of all columns */

static const double A[STAGES][STAGES - 1] = {
    {0},
    {1.0 / 5},
    {3.0 / 40, 9.0 / 40},
    {44.0 / 45, -56.0 / 15, 32.0 / 9},
    {19372.0 / 6561, -25360.0 / 2187, 64448.0 / 6561, -212.0 / 729},
    {9017.0 / 3168, -355.0 / 33, 46732.0 / 5247, 49.0 / 176, -5103.0 / 18656},
    {35.0 / 384, 0, 500.0 / 1113, 125.0 / 192, -2187.0 / 6784, 11.0 / 84}, /* the weights: FSAL */
};
/* For equal steps the estimate that our side takes from diffrax: two thirds of what Dormand and Prince have. */
static const double E[STAGES] = {
    71.0 / 86400, 0, -142.0 / 50085, 71.0 / 2880, -5751.0 / 169600, 44.0 / 1575, -1.0 / 60};

/* x2' = -linear x1 - cubic x1^3 - damping x2 + push x4,  0 = x2 - radius x3,
 * 0 = -linear x1 - cubic x1^3 + drive x2 + weight x4 */
typedef struct {
    double linear, cubic, damping, push, radius, drive, weight;
} System;

/* From k1, k2, b, r, M and J. */
INLINE System system_of(const double parameters[6])
{
    const double b = parameters[2], r = parameters[3], push = 1 / parameters[4], lever = r * r / parameters[5];
    return (System){
        parameters[0] * push, parameters[1] * push, b * push, push, r, (2 * lever - push) * b, lever + push};
}

/* ---- the problem: f1 and f2, A1 and A2, and how A2 changes along the motion ------------------------------------- */

INLINE double spring(const System *p, double x) { return (p->linear + p->cubic * x * x) * x; }

INLINE double spring_slope(const System *p, double x) { return p->linear + 3 * p->cubic * x * x; }

INLINE void differential(const System *p, const double x[N], double f[D])
{
    f[0] = x[1];
    f[1] = -spring(p, x[0]) - p->damping * x[1] + p->push * x[3];
}

INLINE void constraints(const System *p, const double x[N], double f[ALGEBRAIC])
{
    f[0] = x[1] - p->radius * x[2];
    f[1] = -spring(p, x[0]) + p->drive * x[1] + p->weight * x[3];
}

/* A2 in two parts: to the left the derivatives by the differential components, to the right the others. */
INLINE void constraint_slopes(
    const System *p, const double x[N], double left[ALGEBRAIC][D], double right[ALGEBRAIC][ALGEBRAIC])
{
    left[0][0] = 0, left[0][1] = 1;
    left[1][0] = -spring_slope(p, x[0]), left[1][1] = p->drive;
    right[0][0] = -p->radius, right[0][1] = 0;
    right[1][0] = 0, right[1][1] = p->weight;
}

/* A1 Y */
INLINE void linearised(const System *p, const double x[N], const Row y[N], Row out[D])
{
    out[0] = y[1];
    out[1] = -spring_slope(p, x[0]) * y[0] - p->damping * y[1] + p->push * y[3];
}

/* A2' Y, where the state moves by dx. */
INLINE void turning(const System *p, const double x[N], const double dx[N], const Row y[N], Row out[ALGEBRAIC])
{
    out[0] = (Row){0};
    out[1] = -6 * p->cubic * x[0] * dx[0] * y[0];
}

/* ---- points on the constraints ---------------------------------------------------------------------------------- */

/* [E1; A2]^-1 = [I 0; content constraint] */
typedef struct {
    double content[ALGEBRAIC][D], constraint[ALGEBRAIC][ALGEBRAIC], determinant;
} Lift;

typedef struct {
    double x[N], f[D];      /* f is f1 at x */
    Lift lift;
} Point;

INLINE Lift lift_at(const System *p, const double x[N])
{
    double left[ALGEBRAIC][D], a[ALGEBRAIC][ALGEBRAIC];
    constraint_slopes(p, x, left, a);
    Lift lift = {.determinant = a[0][0] * a[1][1] - a[0][1] * a[1][0]};
    const double r = 1 / lift.determinant;
    const double inverse[ALGEBRAIC][ALGEBRAIC] = {{a[1][1] * r, -a[0][1] * r}, {-a[1][0] * r, a[0][0] * r}};
    memcpy(lift.constraint, inverse, sizeof inverse);
    for (int i = 0; i < ALGEBRAIC; i++)
        for (int j = 0; j < D; j++) lift.content[i][j] = -inverse[i][0] * left[0][j] - inverse[i][1] * left[1][j];
    return lift;
}

/* The algebraic rows of what has the first D rows of y and lies in the kernel of A2. */
INLINE void lifted(const double lift[ALGEBRAIC][2], Row y[N])
{
    for (int i = 0; i < ALGEBRAIC; i++) y[D + i] = lift[i][0] * y[0] + lift[i][1] * y[1];
}

INLINE void lifted_vector(const double lift[ALGEBRAIC][2], double x[N])
{
    for (int i = 0; i < ALGEBRAIC; i++) x[D + i] = lift[i][0] * x[0] + lift[i][1] * x[1];
}

/* Newton's method for f2(x) = 0 in the algebraic components, from the guess that is there; 0 where it fails. */
INLINE int solve(const System *p, double near, double x[N])
{
    for (int tries = 0; tries < ITERATIONS; tries++) {
        double f[ALGEBRAIC];
        const Lift lift = lift_at(p, x);
        int is_near = 1;
        constraints(p, x, f);
        for (int i = 0; i < ALGEBRAIC; i++) {
            const double dx = -lift.constraint[i][0] * f[0] - lift.constraint[i][1] * f[1];
            is_near &= fabs(dx) <= near * (1 + fabs(x[D + i]));
            x[D + i] += dx;
        }
        if (is_near) return 1;
    }
    return 0;
}

/* Brings a point to the content w; the guess is along the lift. 0 where Newton's method fails, or where the
 * determinant has changed its sign: then there was a singular point on the way. */
INLINE int move(const System *p, double near, const double w[D], Point *a)
{
    double change[N];
    for (int i = 0; i < D; i++) change[i] = w[i] - a->x[i], a->x[i] = w[i];
    lifted_vector(a->lift.content, change);
    for (int i = D; i < N; i++) a->x[i] += change[i];
    if (!solve(p, near, a->x)) return 0;
    const double before = a->lift.determinant;
    a->lift = lift_at(p, a->x);
    differential(p, a->x, a->f);
    return (a->lift.determinant < 0) == (before < 0);
}

/* ---- frames ----------------------------------------------------------------------------------------------------- */

/* Modified Gram-Schmidt; returns R_jj. */
INLINE Row orthonormalise(Row y[N])
{
    double first = 0, overlap = 0, second = 0;
    for (int i = 0; i < N; i++) first += y[i][0] * y[i][0], overlap += y[i][0] * y[i][1];
    overlap /= first;
    for (int i = 0; i < N; i++) y[i][1] -= overlap * y[i][0], second += y[i][1] * y[i][1];
    const Row r = {sqrt(first), sqrt(second)};
    for (int i = 0; i < N; i++) y[i] /= r;
    return r;
}

/* Y' = [E1; A2]^-1 [A1; -A2'] Y; out holds A1 Y already. */
INLINE void derivative(const System *p, const Point *a, const Row y[N], Row out[N])
{
    double dx[N] = {a->f[0], a->f[1]};
    Row turned[ALGEBRAIC];
    lifted_vector(a->lift.content, dx);
    turning(p, a->x, dx, y, turned);
    lifted(a->lift.content, out);
    for (int i = 0; i < ALGEBRAIC; i++)
        out[D + i] -= a->lift.constraint[i][0] * turned[0] + a->lift.constraint[i][1] * turned[1];
}

/* Of W = Q^T Y' the diagonal, which is the growth; and (E1 Q)' = A1 Q - E1 Q B with B = upp(W) + low(W)^T. */
INLINE Row keep_orthonormal(const System *p, const Point *a, const Row q[N], Row dq[N])
{
    Row rates = {0}, off = {0};
    derivative(p, a, q, dq);
    for (int i = 0; i < N; i++) rates += q[i] * dq[i], off += q[i] * (Row){dq[i][1], dq[i][0]};
    for (int i = 0; i < D; i++) dq[i] -= q[i] * rates + (Row){0, q[i][0] * (off[0] + off[1])};
    return rates;
}

/* (E1 Y)' of the frame of either method, and the rates of growth of the continuous one. */
INLINE Row slopes_at(const System *p, const Point *a, int continuous, const Row y[N], Row dy[D])
{
    Row slope[N], rates = {0};
    linearised(p, a->x, y, slope);
    if (continuous) rates = keep_orthonormal(p, a, y, slope);
    memcpy(dy, slope, D * sizeof *dy);
    return rates;
}

/* ---- a step ----------------------------------------------------------------------------------------------------- */

typedef struct {
    double f[STAGES][D];
    Row dy[STAGES][D], rates[STAGES];
} Stages;

INLINE double larger(double a, double b) { return a > b ? a : b; }

/* The largest error of a component in units of 1 + |x|, or of 1 + |y|: columns start with length one. */
INLINE double error_of(const Stages *stage, double h, const Point *b, const Row y[N])
{
    double of_state[N] = {0}, worst[1 + K] = {0};
    Row of_frame[N] = {{0}};
#pragma GCC unroll 7
    for (int r = 0; r < STAGES; r++)
        if (E[r] != 0)
            for (int i = 0; i < D; i++)
                of_state[i] += E[r] * stage->f[r][i], of_frame[i] += E[r] * stage->dy[r][i];
    lifted_vector(b->lift.content, of_state);
    lifted(b->lift.content, of_frame);
    for (int i = 0; i < N; i++) {
        worst[K] = larger(worst[K], fabs(of_state[i]) / (1 + fabs(b->x[i])));
        for (int j = 0; j < K; j++) worst[j] = larger(worst[j], fabs(of_frame[i][j]) / (1 + fabs(y[i][j])));
    }
    return h * larger(worst[K], larger(worst[0], worst[1]));
}

/* Growth is the integral of the rates. Its error counts in units of h + the largest growth: exponents are means. */
INLINE double error_of_growth(const Stages *stage, double h, Row *growth)
{
    Row sum = {0}, miss = {0};
#pragma GCC unroll 7
    for (int r = 0; r < STAGES; r++) {
        if (r + 1 < STAGES && A[STAGES - 1][r] != 0) sum += A[STAGES - 1][r] * stage->rates[r];
        if (E[r] != 0) miss += E[r] * stage->rates[r];
    }
    *growth = h * sum;
    return larger(fabs(miss[0]), fabs(miss[1])) / (1 + larger(fabs(sum[0]), fabs(sum[1])));
}

/* From a and y over h to b and next; returns the error, infinite where there is no such point. */
INLINE double step(
    const System *p, double near, double h, int continuous, const Point *a, const Row y[N], Point *b, Row next[N],
    Row *growth)
{
    Stages stage;
    *b = *a;
    memcpy(stage.f[0], a->f, sizeof a->f);
    stage.rates[0] = slopes_at(p, a, continuous, y, stage.dy[0]);
#pragma GCC unroll 7
    for (int s = 1; s < STAGES; s++) {
        double w[D];
        for (int i = 0; i < D; i++) {
            w[i] = a->x[i], next[i] = y[i];
#pragma GCC unroll 7
            for (int r = 0; r < s; r++)
                if (A[s][r] != 0) w[i] += h * A[s][r] * stage.f[r][i], next[i] += h * A[s][r] * stage.dy[r][i];
        }
        if (!move(p, near, w, b)) return INFINITY;
        lifted(b->lift.content, next);
        memcpy(stage.f[s], b->f, sizeof b->f);
        stage.rates[s] = slopes_at(p, b, continuous, next, stage.dy[s]);
    }
    const double error = error_of(&stage, h, b, next);
    return continuous ? larger(error, error_of_growth(&stage, h, growth)) : error;
}

/* ---- the loop --------------------------------------------------------------------------------------------------- */

/* The motion decays to rest, and numbers below 2e-308 take the processor longer: a long run would last a third longer.
 * Here they are zeros, as they are in what our side is compiled to. */
#if defined(__SSE2__)
static unsigned long flush_tiny(void)
{
    const unsigned before = _mm_getcsr();
    _mm_setcsr(before | 0x8040); /* results and arguments */
    return before;
}
static void restore(unsigned long before) { _mm_setcsr((unsigned)before); }
#elif defined(__aarch64__)
static unsigned long flush_tiny(void)
{
    unsigned long before;
    __asm__ volatile("mrs %0, fpcr" : "=r"(before));
    __asm__ volatile("msr fpcr, %0" : : "r"(before | 1ul << 24));
    return before;
}
static void restore(unsigned long before) { __asm__ volatile("msr fpcr, %0" : : "r"(before)); }
#else
static unsigned long flush_tiny(void) { return 0; }
static void restore(unsigned long before) { (void)before; }
#endif

INLINE double clip(double factor) { return factor > GROW ? GROW : larger(factor, SHRINK); }

/* x lies on the constraints, the columns of y in their tangent space, orthonormal; both go on for t1. */
INLINE long integrate(
    const System *p, double t1, double tol, int continuous, double x[N], Row y[N], double sums[K], long *rejected)
{
    const double near = NEAR * sqrt(tol);
    double left = t1, h = FIRST_STEP;
    long steps = 0;
    Point a = {.lift = lift_at(p, x)};
    memcpy(a.x, x, sizeof a.x);
    differential(p, x, a.f);
    while (left > 1e-12 * t1) {
        Point b;
        Row next[N], growth = {0};
        h = h < left ? h : left;
        const double ratio = step(p, near, h, continuous, &a, y, &b, next, &growth) / tol;
        if (ratio <= 1) {
            const Row r = orthonormalise(next);
            for (int j = 0; j < K; j++) sums[j] += continuous ? growth[j] : log(r[j]);
            memcpy(y, next, sizeof next);
            a = b;
            left -= h;
            steps++;
        } else
            (*rejected)++;
        h *= clip(SAFETY * pow(ratio, -1.0 / ORDER));
    }
    memcpy(x, a.x, sizeof a.x);
    return steps;
}

INLINE long run(
    double t1, double tol, int continuous, const double parameters[6], double x[N], double frame[N * K],
    double sums[K], long counts[1])
{
    const System p = system_of(parameters);
    Row y[N];
    memcpy(y, frame, sizeof y);
    const unsigned long before = flush_tiny();
    const long steps = integrate(&p, t1, tol, continuous, x, y, sums, counts);
    restore(before);
    memcpy(frame, y, sizeof y);
    return steps;
}

/* Algorithm 3.1: the frame grows over a step, and is orthonormalised after it; sums of ln R_jj, counts: rejected. */
long spring_damper_discrete(
    double t1, double tol, const double parameters[6], double x[4], double frame[8], double sums[2], long counts[1])
{
    return run(t1, tol, 0, parameters, x, frame, sums, counts);
}

/* Algorithm 3.3: the frame stays orthonormal, and its growth is integrated. */
long spring_damper_continuous(
    double t1, double tol, const double parameters[6], double x[4], double frame[8], double sums[2], long counts[1])
{
    return run(t1, tol, 1, parameters, x, frame, sums, counts);
}

/* The discrete method for many parameters (lanes, 6), one after the other, from the same x1 and x2. */
long spring_damper_sweep(
    long lanes, double t1, double tol, const double *parameters, const double start[2], double *sums, long counts[1])
{
    const unsigned long before = flush_tiny();
    long steps = 0;
    for (long lane = 0; lane < lanes; lane++) {
        const System p = system_of(parameters + 6 * lane);
        double x[N] = {start[0], start[1]};
        Row y[N] = {{1, 0}, {0, 1}};
        solve(&p, NEAR * sqrt(tol), x);
        lifted(lift_at(&p, x).content, y);
        orthonormalise(y);
        steps += integrate(&p, t1, tol, 0, x, y, sums + K * lane, counts);
    }
    restore(before);
    return steps;
}
