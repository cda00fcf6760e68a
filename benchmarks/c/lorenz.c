/* Lorenz63 with its full variational equations, both by the same RK4; modified Gram-Schmidt every few steps.
 *
 * Layout: frame[i][j] is component i of column j, rows padded to WIDTH so that a row is one AVX register.
 * Every loop over columns has a fixed length and no reduction: the compiler vectorises it without -ffast-math.
 */
#include <math.h>
#include <string.h>

enum { N = 3, WIDTH = 4 }; /* the fourth column is zero and stays zero */

typedef struct {
    double x[N];
    double frame[N][WIDTH];
} Tangent;

static inline void field(const double p[3], const Tangent *u, Tangent *du)
{
    const double sigma = p[0], rho = p[1], beta = p[2];
    const double x = u->x[0], y = u->x[1], z = u->x[2];
    du->x[0] = sigma * (y - x);
    du->x[1] = x * (rho - z) - y;
    du->x[2] = x * y - beta * z;
    for (int j = 0; j < WIDTH; j++) {
        const double dx = u->frame[0][j], dy = u->frame[1][j], dz = u->frame[2][j];
        du->frame[0][j] = sigma * (dy - dx);
        du->frame[1][j] = (rho - z) * dx - dy - x * dz;
        du->frame[2][j] = y * dx + x * dy - beta * dz;
    }
}

/* out = u + c du */
static inline void shift(const Tangent *u, double c, const Tangent *du, Tangent *out)
{
    for (int i = 0; i < N; i++) {
        out->x[i] = u->x[i] + c * du->x[i];
        for (int j = 0; j < WIDTH; j++) out->frame[i][j] = u->frame[i][j] + c * du->frame[i][j];
    }
}

static inline void rk4(const double p[3], double h, Tangent *u)
{
    Tangent k1, k2, k3, k4, v;
    field(p, u, &k1);
    shift(u, h / 2, &k1, &v);
    field(p, &v, &k2);
    shift(u, h / 2, &k2, &v);
    field(p, &v, &k3);
    shift(u, h, &k3, &v);
    field(p, &v, &k4);
    for (int i = 0; i < N; i++) {
        u->x[i] += h / 6 * (k1.x[i] + 2 * (k2.x[i] + k3.x[i]) + k4.x[i]);
        for (int j = 0; j < WIDTH; j++)
            u->frame[i][j] += h / 6 * (k1.frame[i][j] + 2 * (k2.frame[i][j] + k3.frame[i][j]) + k4.frame[i][j]);
    }
}

/* Modified Gram-Schmidt on the columns; adds ln R_jj to sums. */
static inline void orthonormalise(double y[N][WIDTH], double sums[N])
{
    for (int j = 0; j < N; j++) {
        const double length = sqrt(y[0][j] * y[0][j] + y[1][j] * y[1][j] + y[2][j] * y[2][j]);
        sums[j] += log(length);
        const double inverse = 1 / length;
        for (int i = 0; i < N; i++) y[i][j] *= inverse;
        for (int l = j + 1; l < N; l++) {
            const double overlap = y[0][j] * y[0][l] + y[1][j] * y[1][l] + y[2][j] * y[2][l];
            for (int i = 0; i < N; i++) y[i][l] -= overlap * y[i][j];
        }
    }
}

/* Takes `steps` steps of h, orthonormalising after each `every` and at the end; returns the steps taken. */
long lorenz(long steps, long every, double h, const double parameters[3], double x[3], double frame[9], double sums[3])
{
    Tangent u = {0};
    memcpy(u.x, x, sizeof u.x);
    for (int i = 0; i < N; i++) memcpy(u.frame[i], frame + N * i, N * sizeof(double));

    for (long done = 0; done < steps;) {
        const long stop = done + every < steps ? done + every : steps;
        for (; done < stop; done++) rk4(parameters, h, &u);
        orthonormalise(u.frame, sums);
    }

    memcpy(x, u.x, sizeof u.x);
    for (int i = 0; i < N; i++) memcpy(frame + N * i, u.frame[i], N * sizeof(double));
    return steps;
}
