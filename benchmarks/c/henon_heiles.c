/* Henon-Heiles by SBAB2 with its corrector, and the tangent map of that step; modified Gram-Schmidt every few steps.
 *
 * H = (px^2 + py^2)/2 + V, V = (x^2 + y^2)/2 + x^2 y - y^3/3. Layout: frame[i][j] is component i of column j, in the
 * order (x, y, px, py), so that a row is one AVX register.
 */
#include <math.h>
#include <string.h>

enum { N = 4 };

typedef struct {
    double x[N];
    double frame[N][N];
} Tangent;

/* q += h p */
static inline void drift(double h, Tangent *u)
{
    for (int i = 0; i < 2; i++) {
        u->x[i] += h * u->x[2 + i];
        for (int j = 0; j < N; j++) u->frame[i][j] += h * u->frame[2 + i][j];
    }
}

/* p -= h grad V */
static inline void kick(double h, Tangent *u)
{
    const double x = u->x[0], y = u->x[1];
    const double xx = 1 + 2 * y, xy = 2 * x, yy = 1 - 2 * y;
    u->x[2] -= h * (x * xx);
    u->x[3] -= h * (y + x * x - y * y);
    for (int j = 0; j < N; j++) {
        const double dx = u->frame[0][j], dy = u->frame[1][j];
        u->frame[2][j] -= h * (xx * dx + xy * dy);
        u->frame[3][j] -= h * (xy * dx + yy * dy);
    }
}

/* p += h grad (|grad V|^2 / 2) */
static inline void correct(double h, Tangent *u)
{
    const double x = u->x[0], y = u->x[1];
    const double xx = 1 + 6 * x * x + 6 * y + 2 * y * y, xy = 6 * x + 4 * x * y;
    const double yy = 1 - 6 * y + 6 * y * y + 2 * x * x;
    u->x[2] += h * (x * (1 + 2 * x * x + 6 * y + 2 * y * y));
    u->x[3] += h * (y - 3 * y * y + 2 * y * y * y + 3 * x * x + 2 * x * x * y);
    for (int j = 0; j < N; j++) {
        const double dx = u->frame[0][j], dy = u->frame[1][j];
        u->frame[2][j] += h * (xx * dx + xy * dy);
        u->frame[3][j] += h * (xy * dx + yy * dy);
    }
}

static inline void step(double h, Tangent *u)
{
    const double strength = h * h * h / 72; /* (g/2) h^3 grad |grad V|^2, g = 1/72 */
    correct(strength, u);
    kick(h / 6, u);
    drift(h / 2, u);
    kick(2 * h / 3, u);
    drift(h / 2, u);
    kick(h / 6, u);
    correct(strength, u);
}

/* Modified Gram-Schmidt on the columns; adds ln R_jj to sums. */
static inline void orthonormalise(double y[N][N], double sums[N])
{
    for (int j = 0; j < N; j++) {
        double square = 0;
        for (int i = 0; i < N; i++) square += y[i][j] * y[i][j];
        const double length = sqrt(square), inverse = 1 / length;
        sums[j] += log(length);
        for (int i = 0; i < N; i++) y[i][j] *= inverse;
        for (int l = j + 1; l < N; l++) {
            double overlap = 0;
            for (int i = 0; i < N; i++) overlap += y[i][j] * y[i][l];
            for (int i = 0; i < N; i++) y[i][l] -= overlap * y[i][j];
        }
    }
}

/* Takes `steps` steps of h, orthonormalising after each `every` and at the end; returns the steps taken. */
long henon_heiles(long steps, long every, double h, double x[4], double frame[16], double sums[4])
{
    Tangent u;
    memcpy(u.x, x, sizeof u.x);
    memcpy(u.frame, frame, sizeof u.frame);
    for (long done = 0; done < steps;) {
        const long stop = done + every < steps ? done + every : steps;
        for (; done < stop; done++) step(h, &u);
        orthonormalise(u.frame, sums);
    }
    memcpy(x, u.x, sizeof u.x);
    memcpy(frame, u.frame, sizeof u.frame);
    return steps;
}
