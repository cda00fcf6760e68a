/* The impact oscillator x'' + 2 zeta x' + x = cos(omega t), x <= 0, v -> -e v at the wall, with two tangent columns.
 *
 * The Jacobian of this field is constant, so the tangent pass has no use for the stages of the state.
 */
#include "planar.h"

struct System {
    double zeta, omega, restitution;
};

INLINE void field(const System *p, Point *a)
{
    a->f[0] = a->x[1];
    a->f[1] = cos(p->omega * a->t) - 2 * p->zeta * a->x[1] - a->x[0];
}

INLINE double damping(const System *p) { return 2 * p->zeta; }

INLINE double stiffness(const Point *a) { return (void)a, 1; }

INLINE double forcing_rate(const System *p, double t) { return -p->omega * sin(p->omega * t); }

INLINE double guard(const System *p, const double x[2]) { return (void)p, -x[0]; }

INLINE void begin(System *p, Run *run, Point *a, double y[2][2])
{
    (void)run, (void)y;
    field(p, a);
}

/* v -> -e v, and S = Dg + (f+ - Dg f-) grad h / (grad h . f-) on every column; h = -x. */
INLINE void cross(System *p, Run *run, Point *a, double y[2][2])
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
    orthonormalise(y, run->sums);
    run->events++;
}

/* Runs for a time t1 at the fixed step h; counts: impacts, losses and rejected steps (none). Returns the steps taken. */
long impact_fixed(
    double t1, double h, const double parameters[3], double *t, double x[2], double frame[4], double sums[2],
    long counts[3])
{
    System p = {parameters[0], parameters[1], parameters[2]};
    return go(&p, (Run){.h = h, .end = *t + t1}, t, x, frame, sums, counts, 0);
}

/* Runs for a time t1 with error control on state, frame and guard, h being the first step. Returns the steps taken. */
long impact_adaptive(
    double t1, double h, double rtol, double atol, const double parameters[3], double *t, double x[2], double frame[4],
    double sums[2], long counts[3])
{
    System p = {parameters[0], parameters[1], parameters[2]};
    return go(&p, (Run){.h = h, .rtol = rtol, .atol = atol, .end = *t + t1}, t, x, frame, sums, counts, 1);
}
