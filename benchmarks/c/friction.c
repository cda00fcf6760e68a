/* The pendulum with dry friction, with two tangent columns:
 *
 *     theta'' + beta theta' + lambda sin(theta) + alpha sgn(theta') = amplitude sin(omega t).
 *
 * At v = 0 the motion sticks while the force F = amplitude sin(omega t) - lambda sin(theta) is at most alpha, and else
 * goes on to the other side of v = 0.
 */
#include "planar.h"

#define PI 3.14159265358979323846

struct System {
    double beta, alpha, lambda, amplitude, omega;
    double sign;            /* of v: the mode */
};

/* The cosine comes nearly free with the sine (the compiler makes one call of both), and tangents need it. */
INLINE void field(const System *p, Point *a)
{
    a->f[0] = a->x[1];
    a->f[1] = p->amplitude * sin(p->omega * a->t) - p->beta * a->x[1] - p->lambda * sin(a->x[0]) - p->alpha * p->sign;
    a->k = p->lambda * cos(a->x[0]);
}

INLINE double damping(const System *p) { return p->beta; }

INLINE double stiffness(const Point *a) { return a->k; }

INLINE double forcing_rate(const System *p, double t) { return p->amplitude * p->omega * cos(p->omega * t); }

INLINE double guard(const System *p, const double x[2]) { return p->sign * x[1]; }

INLINE double force(const System *p, const Point *a)
{
    return p->amplitude * sin(p->omega * a->t) - p->lambda * sin(a->x[0]);
}

/* Waits at theta until F = +-alpha, or until the end of the run, and goes to the side to which F then points. There the
 * acceleration is 0. v takes no part in the motion that sticks: its direction is lost, and starts anew. */
static __attribute__((noinline)) void stick(System *p, Run *run, Point *a, double y[2][2])
{
    const double pull = p->lambda * sin(a->x[0]), turn = 2 * PI, phase = fmod(p->omega * a->t, turn);
    double wait = INFINITY;
    for (int s = -1; s <= 1; s += 2) {
        const double first = asin((pull + s * p->alpha) / p->amplitude); /* nan if F never gets there */
        for (int side = 0; side < 2; side++) {
            const double ahead = fmod((side ? PI - first : first) - phase + 2 * turn, turn);
            if (ahead < wait) wait = ahead, p->sign = s;
        }
    }
    a->x[1] = 0;
    a->t = fmin(a->t + wait / p->omega, run->end);
    field(p, a);
    a->f[1] = 0;
    const double length = fabs(y[0][0]);
    run->sums[0] += log(length);
    y[0][0] /= length, y[1][0] = 0;
    y[0][1] = 0, y[1][1] = 1;
}

INLINE void begin(System *p, Run *run, Point *a, double y[2][2])
{
    const double f = force(p, a);
    p->sign = a->x[1] > 0 || (a->x[1] == 0 && f > 0) ? 1 : -1;
    if (a->x[1] == 0 && fabs(f) <= p->alpha) stick(p, run, a, y);
    else field(p, a);
}

/* To the other side, S = I + (f+ - f-) grad h / (grad h . f-) on every column, h = v; or sticks, losing a column. */
INLINE void cross(System *p, Run *run, Point *a, double y[2][2])
{
    const double f = force(p, a), before = a->f[1];
    a->x[1] = a->f[0] = 0;
    run->events++;
    if (fabs(f) <= p->alpha) {
        stick(p, run, a, y);
        run->losses++;
        run->events += a->t < run->end;
        return;
    }
    p->sign = -p->sign;
    a->f[1] = before + 2 * p->alpha * -p->sign; /* nothing but the friction changes */
    for (int j = 0; j < 2; j++) {
        const double delay = y[1][j] / before; /* grad h . y / grad h . f- */
        y[1][j] += (a->f[1] - before) * delay;
    }
    orthonormalise(y, run->sums);
}

/* Runs for a time t1 at the fixed step h; counts: events, sticks, rejected steps (none). Returns the steps taken. */
long friction_fixed(
    double t1, double h, const double parameters[5], double *t, double x[2], double frame[4], double sums[2],
    long counts[3])
{
    System p = {parameters[0], parameters[1], parameters[2], parameters[3], parameters[4], 0};
    return go(&p, (Run){.h = h, .end = *t + t1}, t, x, frame, sums, counts, 0);
}

/* Runs for a time t1 with error control on state, frame and guard, h being the first step. Returns the steps taken. */
long friction_adaptive(
    double t1, double h, double rtol, double atol, const double parameters[5], double *t, double x[2], double frame[4],
    double sums[2], long counts[3])
{
    System p = {parameters[0], parameters[1], parameters[2], parameters[3], parameters[4], 0};
    return go(&p, (Run){.h = h, .rtol = rtol, .atol = atol, .end = *t + t1}, t, x, frame, sums, counts, 1);
}
