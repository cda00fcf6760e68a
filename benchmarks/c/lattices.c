/* Disordered chains of n sites with fixed ends, and the tangent maps of their splitting schemes.
 *
 * Klein-Gordon: H = sum p^2/2 + stiffness q^2/2 + g q^4/4 + bond (difference of neighbours)^2/2; drifts and kicks in turn.
 * Schrodinger: H = sum level (q^2 + p^2)/2 + g (q^2 + p^2)^2/8 - q q_next - p p_next; three parts: turn, drift, kick.
 *
 * Columns of a site lie side by side; one site that does not move stands beyond each end. The number of columns is a
 * constant where it is 1 or 8: loops over it are then unrolled, and those over the sites vectorised.
 */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#define INLINE static inline __attribute__((always_inline))

typedef struct {
    long n, k;
    double *q, *p, *dq, *dp; /* (n + 2), (n + 2), (n + 2) k, (n + 2) k */
} Chain;

static Chain chain(long n, long k, const double *x, const double *frame)
{
    Chain c = {n, k, calloc(n + 2, 8), calloc(n + 2, 8), calloc((n + 2) * k, 8), calloc((n + 2) * k, 8)};
    memcpy(c.q + 1, x, n * 8);
    memcpy(c.p + 1, x + n, n * 8);
    memcpy(c.dq + k, frame, n * k * 8);
    memcpy(c.dp + k, frame + n * k, n * k * 8);
    return c;
}

static void done_with(Chain *c, double *x, double *frame)
{
    const long n = c->n, k = c->k;
    memcpy(x, c->q + 1, n * 8);
    memcpy(x + n, c->p + 1, n * 8);
    memcpy(frame, c->dq + k, n * k * 8);
    memcpy(frame + n * k, c->dp + k, n * k * 8);
    free(c->q), free(c->p), free(c->dq), free(c->dp);
}

/* Modified Gram-Schmidt on the columns; adds ln R_jj to sums. */
INLINE void orthonormalise(Chain *c, long k, double *sums)
{
    const long from = k, to = (c->n + 1) * k;
    double *restrict dq = c->dq, *restrict dp = c->dp;
    for (long j = 0; j < k; j++) {
        double square = 0;
        for (long i = from + j; i < to; i += k) square += dq[i] * dq[i] + dp[i] * dp[i];
        const double length = sqrt(square), inverse = 1 / length;
        sums[j] += log(length);
        for (long i = from + j; i < to; i += k) dq[i] *= inverse, dp[i] *= inverse;
        double overlap[k];
        memset(overlap, 0, sizeof overlap);
        for (long i = from; i < to; i += k)
            for (long l = j + 1; l < k; l++) overlap[l] += dq[i + j] * dq[i + l] + dp[i + j] * dp[i + l];
        for (long i = from; i < to; i += k)
            for (long l = j + 1; l < k; l++) dq[i + l] -= overlap[l] * dq[i + j], dp[i + l] -= overlap[l] * dp[i + j];
    }
}

/* q += h p */
INLINE void drift(Chain *c, long k, double h)
{
    double *restrict q = c->q, *restrict p = c->p, *restrict dq = c->dq, *restrict dp = c->dp;
    for (long i = 1; i <= c->n; i++) q[i] += h * p[i];
    for (long i = k; i < (c->n + 1) * k; i++) dq[i] += h * dp[i];
}

/* p -= h dV/dq */
INLINE void kick(Chain *c, long k, double h, const double *stiffness, double bond, double g)
{
    double *restrict q = c->q, *restrict p = c->p, *restrict dq = c->dq, *restrict dp = c->dp;
    for (long i = 1; i <= c->n; i++) {
        const double site = stiffness[i - 1] + 2 * bond, square = g * q[i] * q[i], own = site + 3 * square;
        p[i] -= h * ((site + square) * q[i] - bond * (q[i - 1] + q[i + 1]));
        for (long j = i * k; j < (i + 1) * k; j++) dp[j] -= h * (own * dq[j] - bond * (dq[j - k] + dq[j + k]));
    }
}

/* to += h (neighbours of from) */
INLINE void exchange(Chain *c, long k, double h, double *restrict to, double *restrict from, double *restrict dto,
                     double *restrict dfrom)
{
    for (long i = 1; i <= c->n; i++) to[i] += h * (from[i - 1] + from[i + 1]);
    for (long j = k; j < (c->n + 1) * k; j++) dto[j] += h * (dfrom[j - k] + dfrom[j + k]);
}

INLINE void turn(Chain *c, long k, double h, const double *levels, double g)
{
    double *restrict q = c->q, *restrict p = c->p, *restrict dq = c->dq, *restrict dp = c->dp;
    for (long i = 1; i <= c->n; i++) {
        const double a = q[i], b = p[i], angle = h * (levels[i - 1] + g * (a * a + b * b) / 2);
        const double co = cos(angle), si = sin(angle);
        q[i] = co * a + si * b;
        p[i] = co * b - si * a;
        for (long j = i * k; j < (i + 1) * k; j++) {
            const double u = dq[j], v = dp[j], more = h * g * (a * u + b * v);
            dq[j] = co * u + si * v + p[i] * more;
            dp[j] = co * v - si * u - q[i] * more;
        }
    }
}

typedef struct {
    double h;
    long moves;
    const int64_t *parts; /* of Schrodinger's */
    const double *shares, *sites;
    double bond, g;
} Scheme;

INLINE void step(Chain *c, long k, const Scheme *s)
{
    for (long m = 0; m < s->moves; m++) {
        const double by = s->h * s->shares[m];
        if (!s->parts && m % 2 == 0) drift(c, k, by);
        else if (!s->parts) kick(c, k, by, s->sites, s->bond, s->g);
        else if (s->parts[m] == 0) turn(c, k, by, s->sites, s->g);
        else if (s->parts[m] == 1) exchange(c, k, -by, c->q, c->p, c->dq, c->dp);
        else exchange(c, k, by, c->p, c->q, c->dp, c->dq);
    }
}

INLINE void march(Chain *c, long k, const Scheme *s, long steps, long every, double *sums)
{
    for (long done = 0; done < steps;) {
        const long stop = done + every < steps ? done + every : steps;
        for (; done < stop; done++) step(c, k, s);
        orthonormalise(c, k, sums);
    }
}

static int64_t run(int64_t n, int64_t k, const Scheme *s, int64_t steps, int64_t every, double *x, double *frame,
                   double *sums)
{
    Chain c = chain(n, k, x, frame);
    if (k == 1) march(&c, 1, s, steps, every, sums);
    else if (k == 8) march(&c, 8, s, steps, every, sums);
    else march(&c, k, s, steps, every, sums);
    done_with(&c, x, frame);
    return steps;
}

/* `steps` steps of h, orthonormalising after each `every` and at the end. Returns the steps taken. */
int64_t klein_gordon(int64_t n, int64_t k, int64_t steps, int64_t every, double h, int64_t moves, const double *shares,
                     const double *stiffness, double bond, double g, double *x, double *frame, double *sums)
{
    const Scheme s = {h, moves, NULL, shares, stiffness, bond, g};
    return run(n, k, &s, steps, every, x, frame, sums);
}

int64_t schroedinger(int64_t n, int64_t k, int64_t steps, int64_t every, double h, int64_t moves, const int64_t *parts,
                     const double *shares, const double *levels, double g, double *x, double *frame, double *sums)
{
    const Scheme s = {h, moves, parts, shares, levels, 0, g};
    return run(n, k, &s, steps, every, x, frame, sums);
}
