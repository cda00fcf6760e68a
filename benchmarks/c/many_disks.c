/* Hard disks of diameter and mass 1 in a periodic box, any number of them, with k tangent vectors: an event-driven
 * algorithm that does as little as it can.
 *
 * Comoving coordinates. Between rebasings the position of a disk is q + t p, and q, p are what is stored: free flight
 * changes nothing, neither in the state nor in the frame, and a collision changes the rows of two disks only.
 *
 * Lazy schedule. Every disk has a row of predicted contacts with all disks, the time since when the row is good
 * (`made`), its rank among the predictions (`rank`), and the first event of the row. Of the two predictions for a pair
 * the later one holds: where the partner of a disk's first event has been predicted anew since, the disk takes the
 * first of those partners that have not; the others have it in their rows. Only the colliders' rows are predicted anew.
 *
 * State first, frame later. The collisions do not depend on the frame, so BATCH of them are found before the frame
 * follows, in strips of COLUMNS columns: a strip stays in the cache for all of them and for the flight at the end.
 *
 * Orthonormalisation. Block Gram-Schmidt by vectors, faster than LAPACK's QR (dgeqrf, dorgqr) by a factor of ten at 16
 * columns, of three to four at 64 and 256 and of 1.5 to 2 at 1024; it loses orthogonality in proportion to the
 * condition of the frame, as all Gram-Schmidt does. With pointers to LAPACK's functions, which is what JAX calls on
 * CPUs, these are used instead.
 *
 * Explicit vectors, because what the compiler vectorises by itself depends on its version and the slightest change.
 */
#include <limits.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#if defined(__AVX512F__) && defined(__GNUC__) && !defined(__clang__)
#pragma GCC target("prefer-vector-width=512") /* compilers hesitate, because of processors of 2017 */
#endif

#ifdef __AVX512F__
enum { LANES = 8 };
#define EACH_LANE {0, 1, 2, 3, 4, 5, 6, 7}
#else
enum { LANES = 4 };
#define EACH_LANE {0, 1, 2, 3}
#endif
enum { WIDTH = 2, COLUMNS = WIDTH * LANES, BATCH = 64 };

#define SIGMA 1.0

typedef double Vec __attribute__((vector_size(LANES * sizeof(double)), may_alias));
typedef long Mask __attribute__((vector_size(LANES * sizeof(long)), may_alias));

static const Mask LANE = EACH_LANE;

typedef void Factorise(int *, int *, double *, int *, double *, double *, int *, int *);
typedef void Generate(int *, int *, int *, double *, int *, double *, double *, int *, int *);

typedef struct {
    double t, q[2], p[2], approach, inverse; /* q, p: b minus a, before; approach = q.p; inverse = 1 / approach */
    long a, b;
} Collision;

typedef struct {
    long n, lanes; /* lanes: n in whole vectors */
    double box[2], per_box[2], horizon;
    int crowded; /* a side is shorter than 2 sigma: a disk's images overlap as obstacles */
    double *q[2], *p[2]; /* lanes each; the lanes without a disk have p = NaN and meet nobody */
    double *times;       /* n rows of lanes: predicted contacts, from `made` on */
    double *made, *rank, *next; /* next: the time of the first event */
    long *partner;              /* of the first event; -1: nobody comes within the horizon */
    double predictions;
} Disks;

typedef Vec Row[WIDTH];

typedef struct {
    long rows, k, strips;
    Row *y;          /* strips of COLUMNS columns, one after the other; the last one is filled up with zeros */
    double *columns; /* the frame column by column, for LAPACK, with its tau and workspace */
    double *tau, *work;
    int work_size;
    double *volume; /* the product of R_jj^2 since it was last turned into a logarithm */
    Factorise *geqrf;
    Generate *orgqr;
} Frame;

static inline Vec pick(Mask where, Vec yes, Vec no)
{
    return (Vec)((where & (Mask)yes) | (~where & (Mask)no));
}

static inline Mask pick_index(Mask where, Mask yes, Mask no)
{
    return (where & yes) | (~where & no);
}

static inline Vec fill(double value)
{
    return value - (Vec){0};
}

static inline Vec square_roots(Vec v)
{
    double x[LANES] __attribute__((aligned(64)));
    memcpy(x, &v, sizeof v);
    for (int l = 0; l < LANES; l++) x[l] = sqrt(x[l]);
    memcpy(&v, x, sizeof v);
    return v;
}

static inline Vec nearest_integers(Vec v)
{
    double x[LANES] __attribute__((aligned(64)));
    memcpy(x, &v, sizeof v);
    for (int l = 0; l < LANES; l++) x[l] = rint(x[l]);
    memcpy(&v, x, sizeof v);
    return v;
}

static inline Vec with_sign(double size, Vec sign)
{
    return (Vec)(((Mask)sign & LONG_MIN) | (Mask)fill(size));
}

/* Lane l of the result is lane l ^ width of v. */
static inline Vec swap(Vec v, int width)
{
#ifdef __clang__
    Vec swapped;
    for (int l = 0; l < LANES; l++) swapped[l] = v[l ^ width];
    return swapped;
#else
    return __builtin_shuffle(v, LANE ^ width);
#endif
}

/* Sets one element by writing its whole vector: a vector that is loaded soon after a smaller store has to wait for it
 * (measured: a tenth of the time of four disks). */
static inline void put(double *array, long i, double value)
{
    Vec *v = (Vec *)array + i / LANES;
    *v = pick(LANE == i % LANES, fill(value), *v);
}

static void *doubles(long count)
{
    const size_t bytes = (count * sizeof(double) + 63) / 64 * 64;
    return memset(aligned_alloc(64, bytes), 0, bytes);
}

/* Times from t on to the contacts of disk i with all others, when no two images of a disk overlap as obstacles (sides
 * of at least 2 sigma).
 *
 * Within the horizon the nearest image can be met, and per axis the one that the motion heads to. Obstacles that do
 * not overlap are met in the order of their centres along the path, so that the first that is hit is known before any
 * root is taken. It is hit if |q x p| < sigma |p| and q.p < 0. No branches: all lanes do the same. A disk has no speed
 * relative to itself, and is not met. */
static inline void contacts(const Disks *d, long i, double t, Vec *restrict times)
{
    const Vec *restrict qx = (Vec *)d->q[0], *restrict qy = (Vec *)d->q[1];
    const Vec *restrict px = (Vec *)d->p[0], *restrict py = (Vec *)d->p[1];
    const long vectors = d->lanes / LANES;
    const double qx_i = d->q[0][i], qy_i = d->q[1][i], px_i = d->p[0][i], py_i = d->p[1][i];
    const double width = d->box[0], height = d->box[1], per_width = d->per_box[0], per_height = d->per_box[1];
    for (long j = 0; j < vectors; j++) {
        const Vec vx = px[j] - px_i, vy = py[j] - py_i, limit = SIGMA * SIGMA * (vx * vx + vy * vy);
        Vec x = qx[j] - qx_i + vx * t, y = qy[j] - qy_i + vy * t;
        x -= width * nearest_integers(x * per_width);
        y -= height * nearest_integers(y * per_height);
        const Vec x_back = x - with_sign(width, vx), y_back = y - with_sign(height, vy);
        const Vec along = x * vx, along_back = x_back * vx, up = y * vy, up_back = y_back * vy;
        const Vec cross = x * vy, cross_back = x_back * vy, turn = y * vx, turn_back = y_back * vx;
        const Vec c00 = cross - turn, c10 = cross_back - turn, c01 = cross - turn_back;
        const Mask hit00 = (c00 * c00 < limit) & (along + up < 0);
        const Mask hit10 = (c10 * c10 < limit) & (along_back + up < 0);
        const Mask hit01 = (c01 * c01 < limit) & (along + up_back < 0);
        const Mask first10 = hit10 & ~(hit01 & (along + up_back > along_back + up));
        const Vec qx_hit = pick(hit00 | (hit01 & ~first10), x, x_back);
        const Vec qy_hit = pick(hit00 | first10, y, y_back);
        const Vec approach = qx_hit * vx + qy_hit * vy, c = qx_hit * vy - qy_hit * vx;
        const Vec gap = qx_hit * qx_hit + qy_hit * qy_hit - SIGMA * SIGMA, discriminant = limit - c * c;
        /* Not (-approach - root) / speed2: that cancels. Without its sign a negative discriminant, which is not a
         * contact, does no harm. */
        const Vec contact = gap / (square_roots((Vec)((Mask)discriminant & LONG_MAX)) - approach);
        times[j] = pick((approach < 0) & (discriminant > 0), contact, fill(INFINITY));
    }
}

/* The same for smaller boxes, where obstacles overlap: the earliest of four roots. */
static void contacts_crowded(const Disks *d, long i, double t, double *restrict times)
{
    const double *qx = d->q[0], *qy = d->q[1], *px = d->p[0], *py = d->p[1];
    for (long j = 0; j < d->lanes; j++) {
        const double vx = px[j] - px[i], vy = py[j] - py[i], limit = SIGMA * SIGMA * (vx * vx + vy * vy);
        double x = qx[j] - qx[i] + vx * t, y = qy[j] - qy[i] + vy * t, earliest = INFINITY;
        x -= d->box[0] * rint(x / d->box[0]);
        y -= d->box[1] * rint(y / d->box[1]);
        for (int image = 0; image < 4; image++) {
            const double x_hit = image & 1 ? x - copysign(d->box[0], vx) : x;
            const double y_hit = image & 2 ? y - copysign(d->box[1], vy) : y;
            const double approach = x_hit * vx + y_hit * vy, c = x_hit * vy - y_hit * vx;
            const double gap = x_hit * x_hit + y_hit * y_hit - SIGMA * SIGMA, discriminant = limit - c * c;
            const double time = gap / (sqrt(discriminant > 0 ? discriminant : 0) - approach);
            if (approach < 0 && discriminant > 0 && time < earliest) earliest = time;
        }
        times[j] = earliest;
    }
}

typedef struct {
    double value;
    long index;
} Least;

/* The smallest of all lanes, without a branch: which lane it is is unpredictable (measured: a sixth of the time of
 * sixteen disks). `at` is the vector that each lane was found in. */
static inline Least least_lane(Vec best, Mask at)
{
    at = at * LANES + LANE;
    for (int width = LANES / 2; width > 0; width /= 2) {
        const Vec other = swap(best, width);
        const Mask index = (Mask)swap((Vec)at, width), better = other < best;
        best = pick(better, other, best);
        at = pick_index(better, index, at);
    }
    return (Least){best[0], at[0]};
}

/* The first event in the row of disk i, among the partners that were not predicted after it. */
static inline void choose(Disks *d, long i)
{
    const Vec *times = (Vec *)(d->times + i * d->lanes), *rank = (Vec *)d->rank, own = fill(d->rank[i]);
    Vec best = fill(INFINITY);
    Mask at = {0};
    for (long j = 0; j < d->lanes / LANES; j++) {
        const Mask better = (times[j] < best) & (rank[j] <= own);
        best = pick(better, times[j], best);
        at = pick_index(better, j - (Mask){0}, at);
    }
    const Least first = least_lane(best, at);
    const int within = first.value < d->horizon;
    const double dt = within ? first.value : d->horizon;
    put(d->next, i, d->made[i] + (dt > 0 ? dt : 0)); /* disks that overlap by rounding meet at once */
    d->partner[i] = within ? first.index : -1;
}

static inline void predict(Disks *d, long i, double t)
{
    double *times = d->times + i * d->lanes;
    if (d->crowded)
        contacts_crowded(d, i, t, times);
    else
        contacts(d, i, t, (Vec *)times);
    d->made[i] = t;
    put(d->rank, i, ++d->predictions);
}

static inline long first_disk(const Disks *d)
{
    const Vec *next = (Vec *)d->next;
    Vec best = next[0];
    Mask at = {0};
    for (long j = 1; j < d->lanes / LANES; j++) {
        const Mask better = next[j] < best;
        best = pick(better, next[j], best);
        at = pick_index(better, j - (Mask){0}, at);
    }
    return least_lane(best, at).index;
}

/* From disk a to the image of disk b that it touches at time t. In small boxes this need not be the nearest. */
static inline void displacement(const Disks *d, long a, long b, double t, double q[2])
{
    double nearest[2], p[2];
    for (int i = 0; i < 2; i++) {
        p[i] = d->p[i][b] - d->p[i][a];
        const double apart = d->q[i][b] - d->q[i][a] + t * p[i];
        q[i] = nearest[i] = apart - d->box[i] * rint(apart * d->per_box[i]);
    }
    if (!d->crowded) return;
    double miss = INFINITY;
    for (int image = 0; image < 9; image++) {
        const double x = nearest[0] + (image / 3 - 1) * d->box[0], y = nearest[1] + (image % 3 - 1) * d->box[1];
        const double off = fabs(x * x + y * y - SIGMA * SIGMA);
        if (x * p[0] + y * p[1] < 0 && off < miss) miss = off, q[0] = x, q[1] = y;
    }
}

/* Elastic reflection, in comoving coordinates: p_a += (p.q) q and q_a -= t (p.q) q, and the opposite for b. */
static inline Collision collide(Disks *d, long a, long b, double t)
{
    Collision c = {.t = t, .a = a, .b = b};
    displacement(d, a, b, t, c.q);
    for (int i = 0; i < 2; i++) c.p[i] = d->p[i][b] - d->p[i][a];
    c.approach = c.q[0] * c.p[0] + c.q[1] * c.p[1];
    c.inverse = 1 / c.approach;
    for (int i = 0; i < 2; i++) {
        const double kick = c.approach * c.q[i];
        put(d->p[i], a, d->p[i][a] + kick);
        put(d->p[i], b, d->p[i][b] - kick);
        put(d->q[i], a, d->q[i][a] - t * kick);
        put(d->q[i], b, d->q[i][b] + t * kick);
    }
    return c;
}

/* At most `most` collisions before t1, into `done`. Returns how many. */
static long advance(Disks *d, double t1, long most, Collision *done)
{
    long count = 0;
    while (count < most) {
        const long i = first_disk(d), j = d->partner[i];
        const double t = d->next[i];
        if (t >= t1) break;
        if (j < 0) {
            predict(d, i, t);
            choose(d, i);
        } else if (d->rank[j] > d->rank[i]) {
            choose(d, i);
        } else {
            const long a = i < j ? i : j, b = i < j ? j : i;
            done[count++] = collide(d, a, b, t);
            predict(d, a, t);
            predict(d, b, t);
            choose(d, a);
            choose(d, b);
        }
    }
    return count;
}

/* The saltation matrix on the columns of a strip: in ordinary coordinates
 *     dq_a += (q.dq) q,  dp_a += (dp.q + dq_c.p) q + (p.q) dq_c =: u,  dq_c = dq - p (dq.q) / (p.q)
 * and the opposite for b (q, p, dq, dp are b minus a, sigma = m = 1); in comoving ones dq = dq_0 + t dp before, and
 * t u is to be taken from the new dq_a. */
static inline void jump(const Collision *c, Row *strip, long half)
{
    Row *qa = strip + 2 * c->a, *qb = strip + 2 * c->b, *pa = qa + half, *pb = qb + half;
    const double t = c->t, q0 = c->q[0], q1 = c->q[1], p0 = c->p[0], p1 = c->p[1];
    const double approach = c->approach, inverse = c->inverse;
    for (int j = 0; j < WIDTH; j++) {
        const Vec dp0 = pb[0][j] - pa[0][j], dp1 = pb[1][j] - pa[1][j];
        const Vec dq0 = qb[0][j] - qa[0][j] + t * dp0, dq1 = qb[1][j] - qa[1][j] + t * dp1;
        const Vec normal = q0 * dq0 + q1 * dq1, delay = -inverse * normal;
        const Vec c0 = dq0 + p0 * delay, c1 = dq1 + p1 * delay;
        const Vec kick = q0 * dp0 + q1 * dp1 + p0 * c0 + p1 * c1;
        const Vec u0 = q0 * kick + approach * c0, u1 = q1 * kick + approach * c1;
        const Vec move0 = q0 * normal - t * u0, move1 = q1 * normal - t * u1;
        qa[0][j] += move0;
        qa[1][j] += move1;
        qb[0][j] -= move0;
        qb[1][j] -= move1;
        pa[0][j] += u0;
        pa[1][j] += u1;
        pb[0][j] -= u0;
        pb[1][j] -= u1;
    }
}

/* The frame follows the collisions and the flight to t, and is in ordinary coordinates then. */
static void follow(Frame *f, const Collision *done, long count, double t)
{
    const long half = f->rows / 2;
    for (long s = 0; s < f->strips; s++) {
        Row *strip = f->y + s * f->rows;
        for (long event = 0; event < count; event++) jump(done + event, strip, half);
        for (long i = 0; i < half; i++)
            for (int j = 0; j < WIDTH; j++) strip[i][j] += t * strip[half + i][j];
    }
}

/* The state flies to t, and time starts there. */
static void rebase(Disks *d, double t)
{
    for (int i = 0; i < 2; i++)
        for (long j = 0; j < d->n; j++) d->q[i][j] += t * d->p[i][j];
    for (long j = 0; j < d->n; j++) {
        d->made[j] -= t;
        d->next[j] -= t;
    }
}

static double *element(const Frame *f, long i, long j)
{
    return (double *)(f->y + j / COLUMNS * f->rows + i) + j % COLUMNS;
}

static Frame new_frame(long rows, long k, const double *frame, Factorise *geqrf, Generate *orgqr)
{
    Frame f = {.rows = rows, .k = k, .strips = (k + COLUMNS - 1) / COLUMNS, .geqrf = geqrf, .orgqr = orgqr};
    f.y = doubles(rows * f.strips * COLUMNS);
    f.volume = doubles(f.strips * COLUMNS);
    for (long j = 0; j < f.strips * COLUMNS; j++) f.volume[j] = 1;
    for (long i = 0; i < rows; i++)
        for (long j = 0; j < k; j++) *element(&f, i, j) = frame[i * k + j];
    if (!geqrf) return f;
    f.columns = doubles(rows * k);
    f.tau = doubles(k);
    f.work_size = 64 * k;
    f.work = doubles(f.work_size);
    return f;
}

static void free_frame(Frame *f, double *frame)
{
    for (long i = 0; i < f->rows; i++)
        for (long j = 0; j < f->k; j++) frame[i * f->k + j] = *element(f, i, j);
    free(f->y);
    free(f->volume);
    free(f->columns);
    free(f->tau);
    free(f->work);
}

/* Column c of vector w of a row. */
static inline double lane(const Row *y, int w, long c)
{
    return ((const double *)&(*y)[w])[c];
}

/* Modified Gram-Schmidt of `width` columns, vector w of a strip: step c removes column c from all later ones at once,
 * and finds the overlaps of the next one on the way. All are scaled at the end, where the roots can be taken together.
 * Multiplies volume by R_cc^2. */
static inline void panel_gs(Row *y, int w, long rows, long width, Vec *volume)
{
    Vec sum[4] = {0}, square = fill(1); /* several sums: less waiting for additions; rows = 4n */
    for (long i = 0; i < rows; i += 4)
        for (int u = 0; u < 4; u++) sum[u] += y[i + u][w] * lane(y + i + u, w, 0);
    for (long c = 0; c < width; c++) {
        const Vec overlap = (sum[0] + sum[1]) + (sum[2] + sum[3]);
        square = pick(LANE == c, overlap, square);
        if (c + 1 == width) break;
        const Vec remove = pick(LANE > c, overlap * (1 / overlap[c]), fill(0));
        for (int u = 0; u < 4; u++) sum[u] = (Vec){0};
        for (long i = 0; i < rows; i += 4)
            for (int u = 0; u < 4; u++) {
                Row *v = y + i + u;
                const Vec left = (*v)[w] - remove * lane(v, w, c);
                (*v)[w] = left;
                sum[u] += left * lane(v, w, c + 1);
            }
    }
    double scale[LANES] __attribute__((aligned(64)));
    memcpy(scale, &square, sizeof scale);
    for (int l = 0; l < LANES; l++) scale[l] = 1 / sqrt(scale[l]);
    for (long i = 0; i < rows; i++) y[i][w] *= *(Vec *)scale;
    *volume *= square;
}

/* y -= P (P^T y): takes the orthonormal columns P, vector v of a strip, out of the vectors from w on of another. */
static inline void project(const Row *panel, int v, Row *y, int w, long rows)
{
    Vec overlap[LANES][WIDTH] = {0};
    for (long i = 0; i < rows; i++)
        for (int c = 0; c < LANES; c++)
            for (int j = w; j < WIDTH; j++) overlap[c][j] += lane(panel + i, v, c) * y[i][j];
    for (long i = 0; i < rows; i++)
        for (int j = w; j < WIDTH; j++) {
            Vec left = y[i][j];
            for (int c = 0; c < LANES; c++) left -= lane(panel + i, v, c) * overlap[c][j];
            y[i][j] = left;
        }
}

/* Strip after strip, so that it stays in the cache while all earlier columns are taken out of it. */
static void block_gs(Frame *f)
{
    for (long s = 0; s < f->strips; s++) {
        Row *y = f->y + s * f->rows;
        for (long before = 0; before < s; before++)
            for (int v = 0; v < WIDTH; v++) project(f->y + before * f->rows, v, y, 0, f->rows);
        for (int w = 0; w < WIDTH; w++) {
            const long from = s * COLUMNS + w * LANES, left = f->k - from;
            if (left <= 0) break;
            panel_gs(y, w, f->rows, left < LANES ? left : LANES, (Vec *)(f->volume + from));
            if (w + 1 < WIDTH) project(y, w, y, w + 1, f->rows);
        }
    }
}

static void lapack_qr(Frame *f)
{
    int k = f->k, rows = f->rows, info;
    for (long j = 0; j < k; j++)
        for (long i = 0; i < rows; i++) f->columns[j * rows + i] = *element(f, i, j);
    f->geqrf(&rows, &k, f->columns, &rows, f->tau, f->work, &f->work_size, &info);
    for (long j = 0; j < k; j++) f->volume[j] *= f->columns[j * rows + j] * f->columns[j * rows + j];
    f->orgqr(&rows, &k, &k, f->columns, &rows, f->tau, f->work, &f->work_size, &info);
    for (long j = 0; j < k; j++)
        for (long i = 0; i < rows; i++) *element(f, i, j) = f->columns[j * rows + i];
}

/* Adds ln R_jj to sums. */
static void take_logarithms(Frame *f, double *sums)
{
    for (long j = 0; j < f->k; j++) {
        sums[j] += log(f->volume[j]) / 2;
        f->volume[j] = 1;
    }
}

/* Logarithms only before a product overflows: one in many is as good. */
static void orthonormalise(Frame *f, double *sums)
{
    if (f->geqrf)
        lapack_qr(f);
    else
        block_gs(f);
    long extreme = 0;
    for (long j = 0; j < f->k; j++) extreme |= !((f->volume[j] > 1e-100) & (f->volume[j] < 1e100));
    if (extreme) take_logarithms(f, sums);
}

static Disks new_disks(long n, const double box[2], const double *x)
{
    const long lanes = (n + LANES - 1) / LANES * LANES;
    Disks d = {.n = n, .lanes = lanes, .box = {box[0], box[1]}};
    double energy = 0;
    for (int i = 0; i < 2; i++) {
        d.per_box[i] = 1 / box[i];
        d.crowded |= box[i] < 2 * SIGMA;
        d.q[i] = doubles(lanes);
        d.p[i] = doubles(lanes);
        for (long j = 0; j < lanes; j++) {
            d.q[i][j] = j < n ? x[2 * j + i] : 0;
            d.p[i][j] = j < n ? x[2 * (n + j) + i] : NAN;
            if (j < n) energy += d.p[i][j] * d.p[i][j] / 2;
        }
    }
    /* No relative displacement may exceed 1.5 L_min - sigma; no relative speed exceeds 2 sqrt(energy). */
    d.horizon = (1.5 * fmin(box[0], box[1]) - SIGMA) / (2 * sqrt(energy));
    d.times = doubles(n * lanes);
    d.made = doubles(lanes);
    d.rank = doubles(lanes);
    d.next = doubles(lanes);
    d.partner = doubles(lanes);
    for (long j = 0; j < lanes; j++) d.next[j] = INFINITY;
    for (long j = 0; j < n; j++) predict(&d, j, 0);
    for (long j = 0; j < n; j++) choose(&d, j);
    return d;
}

static void free_disks(Disks *d, double *x)
{
    for (int i = 0; i < 2; i++) {
        for (long j = 0; j < d->n; j++) {
            x[2 * j + i] = d->q[i][j];
            x[2 * (d->n + j) + i] = d->p[i][j];
        }
        free(d->q[i]);
        free(d->p[i]);
    }
    free(d->times);
    free(d->made);
    free(d->rank);
    free(d->next);
    free(d->partner);
}

/* Runs for a time t1 or for `most` collisions, whichever is first, orthonormalising after each `every` collisions and
 * at the end; every = 0: never.
 *
 * x (4n), frame (4n x k, row by row) and sums (k) are updated, time (1) is set; the first `log_size` collisions are
 * written to log_times and log_pairs. Positions are not wrapped. Returns the number of collisions. */
long many_disks(
    long n, long k, double t1, long most, long every, const double box[2], double *x, double *frame, double *sums,
    double *time, long log_size, double *log_times, long *log_pairs, Factorise *geqrf, Generate *orgqr)
{
    Disks d = new_disks(n, box, x);
    Frame f = new_frame(4 * n, k, frame, geqrf, orgqr);
    Collision done[BATCH];
    double start = 0;
    long collisions = 0, since = 0;
    for (int running = most > 0; running;) {
        long room = most - collisions < BATCH ? most - collisions : BATCH;
        if (every > 0 && every - since < room) room = every - since;
        const long count = advance(&d, t1 - start, room, done);
        const double t = count < room ? t1 - start : done[count - 1].t;
        follow(&f, done, count, t);
        rebase(&d, t);
        for (long event = 0; event < count && collisions + event < log_size; event++) {
            log_times[collisions + event] = start + done[event].t;
            log_pairs[2 * (collisions + event)] = done[event].a;
            log_pairs[2 * (collisions + event) + 1] = done[event].b;
        }
        start += t;
        collisions += count;
        since += count;
        running = count == room && collisions < most;
        if (every > 0 && (since == every || !running)) {
            orthonormalise(&f, sums);
            since = 0;
        }
    }
    *time = start;
    take_logarithms(&f, sums);
    free_disks(&d, x);
    free_frame(&f, frame);
    return collisions;
}
