/* Hard disks of diameter and mass 1 in a periodic box, with the full tangent dynamics: a naive event-driven algorithm.
 *
 * At every event all pairs and the 3 x 3 images round the nearest one are searched for the earliest collision, every
 * disk and every column flies there, the pair collides. The state is (q_0x, q_0y, q_1x, ..., p_0x, p_0y, ...).
 *
 * frame[i][j] is component i of column j: all loops over columns have a fixed length and no reduction, so that the
 * compiler vectorises them without -ffast-math.
 */
#include <math.h>
#include <string.h>

enum { DISKS = 4, HALF = 2 * DISKS, DIMENSION = 2 * HALF, PAIRS = 6, LANES = 8, IMAGES = 9, BLOCK = 4 };

#define SIGMA 1.0

/* Pairs fill LANES = two AVX registers; the two lanes left over repeat the last pair. */
static const int FIRST[LANES] = {0, 0, 0, 1, 1, 2, 2, 2};
static const int SECOND[LANES] = {1, 2, 3, 2, 3, 3, 3, 3};

typedef double Block __attribute__((vector_size(BLOCK * sizeof(double)), may_alias));

typedef struct {
    double dt, q[2]; /* q: from disk `first` to the image of disk `second` that it meets, at present */
    int first, second;
} Event;

/* From disk FIRST[n] to the nearest image of disk SECOND[n], and their relative momentum. */
static inline void compare_pairs(
    const double x[DIMENSION], const double box[2], double nearest[2][LANES], double p[2][LANES])
{
    for (int i = 0; i < 2; i++) {
        const double inverse = 1 / box[i];
        for (int n = 0; n < LANES; n++) {
            const int a = 2 * FIRST[n] + i, b = 2 * SECOND[n] + i;
            const double apart = x[b] - x[a];
            nearest[i][n] = apart - box[i] * rint(apart * inverse);
            p[i][n] = x[HALF + b] - x[HALF + a];
        }
    }
}

/* The earliest approaching contact of all pairs with all images. The 3 x 3 images round the nearest one are enough
 * for as long as no relative displacement exceeds 1.5 L_min - sigma: a flight that would be longer is cut there
 * (first = -1) and predicted again.
 *
 * All times are computed without a branch, one register of pairs after the other: which images approach is
 * unpredictable, and mispredicted branches cost more than the square roots they save (measured: half the time). */
static inline Event next_event(const double x[DIMENSION], const double box[2])
{
    double nearest[2][LANES], p[2][LANES], speed2[LANES], times[IMAGES][LANES], earliest[LANES];
    compare_pairs(x, box, nearest, p);
    for (int n = 0; n < LANES; n++) {
        speed2[n] = p[0][n] * p[0][n] + p[1][n] * p[1][n];
        earliest[n] = INFINITY;
    }
    for (int image = 0; image < IMAGES; image++) {
        const double shift0 = (image / 3 - 1) * box[0], shift1 = (image % 3 - 1) * box[1];
        for (int n = 0; n < LANES; n++) {
            const double q0 = nearest[0][n] + shift0, q1 = nearest[1][n] + shift1;
            const double approach = q0 * p[0][n] + q1 * p[1][n];
            const double gap = q0 * q0 + q1 * q1 - SIGMA * SIGMA;
            const double discriminant = approach * approach - speed2[n] * gap;
            /* Not (-approach - root) / speed2: that cancels. Disks that overlap by rounding meet at once. */
            const double root = gap / (sqrt(discriminant > 0 ? discriminant : 0) - approach);
            const double contact = root > 0 ? root : 0;
            times[image][n] = (approach < 0) & (discriminant > 0) ? contact : INFINITY;
        }
    }
    for (int image = 0; image < IMAGES; image++)
        for (int n = 0; n < LANES; n++)
            earliest[n] = times[image][n] < earliest[n] ? times[image][n] : earliest[n];

    double dt = INFINITY, fastest2 = 0;
    for (int n = 0; n < PAIRS; n++) {
        dt = earliest[n] < dt ? earliest[n] : dt;
        fastest2 = speed2[n] > fastest2 ? speed2[n] : fastest2;
    }
    const double longest = (1.5 * (box[0] < box[1] ? box[0] : box[1]) - SIGMA) / sqrt(fastest2);
    if (dt > longest) return (Event){.dt = longest, .first = -1};
    int n = 0, image = 0;
    while (earliest[n] != dt) n++;
    while (times[image][n] != dt) image++;
    const double q[2] = {nearest[0][n] + (image / 3 - 1) * box[0], nearest[1][n] + (image % 3 - 1) * box[1]};
    return (Event){dt, {q[0], q[1]}, FIRST[n], SECOND[n]};
}

static inline void fly(double x[DIMENSION], double y[DIMENSION][DIMENSION], double dt)
{
    for (int i = 0; i < HALF; i++) {
        x[i] += dt * x[HALF + i];
        for (int j = 0; j < DIMENSION; j++) y[i][j] += dt * y[HALF + i][j];
    }
}

/* Elastic reflection, and the saltation matrix applied to every column:
 *     dq_a += (q.dq) q,  dp_a += (dp.q + dq_c.p) q + (p.q) dq_c,  dq_c = dq - p (dq.q) / (p.q)
 * and the opposite for b; q, p, dq, dp are b minus a, sigma = m = 1. */
static inline void collide(double x[DIMENSION], double y[DIMENSION][DIMENSION], const Event *event)
{
    const int a = 2 * event->first, b = 2 * event->second;
    double p[2], q[2];
    for (int i = 0; i < 2; i++) {
        p[i] = x[HALF + b + i] - x[HALF + a + i];
        q[i] = event->q[i] + event->dt * p[i];
    }
    const double approach = q[0] * p[0] + q[1] * p[1];

    const double inverse = 1 / approach;
    for (int j = 0; j < DIMENSION; j++) {
        const double dq0 = y[b][j] - y[a][j], dq1 = y[b + 1][j] - y[a + 1][j];
        const double dp0 = y[HALF + b][j] - y[HALF + a][j], dp1 = y[HALF + b + 1][j] - y[HALF + a + 1][j];
        const double normal = q[0] * dq0 + q[1] * dq1;
        const double delay = -normal * inverse;
        const double c0 = dq0 + p[0] * delay, c1 = dq1 + p[1] * delay;
        const double kick = dp0 * q[0] + dp1 * q[1] + c0 * p[0] + c1 * p[1];
        y[a][j] += normal * q[0];
        y[a + 1][j] += normal * q[1];
        y[b][j] -= normal * q[0];
        y[b + 1][j] -= normal * q[1];
        y[HALF + a][j] += kick * q[0] + approach * c0;
        y[HALF + a + 1][j] += kick * q[1] + approach * c1;
        y[HALF + b][j] -= kick * q[0] + approach * c0;
        y[HALF + b + 1][j] -= kick * q[1] + approach * c1;
    }
    for (int i = 0; i < 2; i++) {
        x[HALF + a + i] += approach * q[i];
        x[HALF + b + i] -= approach * q[i];
    }
}

/* Modified Gram-Schmidt: step j removes column j from all later ones at once. Adds ln R_jj to sums.
 *
 * By registers of BLOCK columns, from the one that holds column j on: left to itself the compiler keeps the overlaps
 * in memory, at twice the time. */
static void orthonormalise(double y[DIMENSION][DIMENSION], double sums[DIMENSION])
{
    for (int j = 0; j < DIMENSION; j++) {
        double column[DIMENSION], overlap[DIMENSION] __attribute__((aligned(32)));
        for (int i = 0; i < DIMENSION; i++) column[i] = y[i][j];
        for (int l = j / BLOCK * BLOCK; l < DIMENSION; l += BLOCK) {
            Block even = {0}, odd = {0}; /* two sums: half the wait for additions */
            for (int i = 0; i < DIMENSION; i += 2) {
                even += column[i] * *(Block *)(y[i] + l);
                odd += column[i + 1] * *(Block *)(y[i + 1] + l);
            }
            *(Block *)(overlap + l) = even + odd;
        }
        const double square = overlap[j], length = sqrt(square), inverse = 1 / square;
        sums[j] += log(length);
        for (int l = 0; l < DIMENSION; l++) overlap[l] *= l > j ? inverse : 0;
        overlap[j] = 1 - 1 / length; /* scales the column itself */
        for (int l = j / BLOCK * BLOCK; l < DIMENSION; l += BLOCK) {
            const Block remove = *(Block *)(overlap + l);
            for (int i = 0; i < DIMENSION; i++) *(Block *)(y[i] + l) -= remove * column[i];
        }
    }
}

/* Runs for a time t1, orthonormalising after each `every` collisions and at the end.
 *
 * x (16), frame (16 x 16, row by row) and sums (16) are updated; the first `log_size` collisions are written to
 * log_times and log_pairs. Positions are not wrapped. Returns the number of collisions. */
long hard_disks(
    double t1, long every, const double box[2], double x[DIMENSION], double frame[DIMENSION * DIMENSION],
    double sums[DIMENSION], long log_size, double *log_times, long *log_pairs)
{
    double y[DIMENSION][DIMENSION] __attribute__((aligned(32)));
    memcpy(y, frame, sizeof y);
    double t = 0;
    long collisions = 0, since = 0;
    for (;;) {
        const Event event = next_event(x, box);
        if (t + event.dt >= t1) break;
        fly(x, y, event.dt);
        t += event.dt;
        if (event.first < 0) continue;
        collide(x, y, &event);
        if (collisions < log_size) {
            log_times[collisions] = t;
            log_pairs[2 * collisions] = event.first;
            log_pairs[2 * collisions + 1] = event.second;
        }
        collisions++;
        if (++since == every) {
            orthonormalise(y, sums);
            since = 0;
        }
    }
    fly(x, y, t1 - t);
    orthonormalise(y, sums);
    memcpy(frame, y, sizeof y);
    return collisions;
}
