#ifndef QR
#define QR 0 /* 0 block GS, 1 LQ, 2 QR with transposition, 3 block GS with panels twice */
#endif
#ifndef WIDE
#define WIDE 2
#endif

static Frame new_frame(long rows, long k, const double *frame, Factorise *gelqf, Generate *orglq)
{
    Frame f = {.rows = rows, .k = k, .stride = (k + LANES - 1) / LANES * LANES, .gelqf = gelqf, .orglq = orglq};
#ifndef NOPAD
    if (f.stride % 64 == 0) f.stride += LANES; /* rows a multiple of 512 bytes apart evict each other */
#endif
    f.y = doubles(rows * f.stride);
    f.tau = doubles(k);
    f.work_size = 64 * (rows + k);
    f.work = doubles(f.work_size + (QR == 2 ? rows * (k+8) : 0));
    for (long i = 0; i < rows; i++) memcpy(f.y + i * f.stride, frame + i * k, k * sizeof(double));
    return f;
}

static void free_frame(Frame *f, double *frame)
{
    for (long i = 0; i < f->rows; i++) memcpy(frame + i * f->k, f->y + i * f->stride, f->k * sizeof(double));
    free(f->y);
    free(f->tau);
    free(f->work);
}

/* Modified Gram-Schmidt of the `width` columns of a panel: step c removes column c from all later ones at once, and
 * finds the overlaps of the next one on the way. Adds ln R_cc to sums. */
static inline void panel_gs(Vec *y, long rows, long row, long width, double *sums)
{
    Vec sum[4] = {0};
    for (long i = 0; i < rows; i += 4)
        for (int u = 0; u < 4; u++) sum[u] += y[(i + u) * row] * ((double *)(y + (i + u) * row))[0];
    for (long c = 0; c < width; c++) {
        Vec remove = (sum[0] + sum[1]) + (sum[2] + sum[3]);
        const double square = remove[c], length = sqrt(square), inverse = 1 / square;
        sums[c] += log(length);
        for (int l = 0; l < LANES; l++) remove[l] *= l > c ? inverse : 0;
        remove[c] = 1 - 1 / length; /* scales the column itself */
        const long next = c + 1 < width ? c + 1 : c;
        for (int u = 0; u < 4; u++) sum[u] = (Vec){0};
        for (long i = 0; i < rows; i += 4)
            for (int u = 0; u < 4; u++) {
                Vec *v = y + (i + u) * row;
                const Vec left = *v - remove * ((double *)v)[c];
                *v = left;
                sum[u] += left * ((double *)v)[next];
            }
    }
}

/* y -= P (P^T y) for WIDE vectors of columns. */
static inline void project(const Vec *panel, Vec *y, long rows, long row, int wide)
{
    Vec overlap[LANES][WIDE] = {0};
    for (long i = 0; i < rows; i++)
        for (int c = 0; c < LANES; c++)
            for (int l = 0; l < wide; l++) overlap[c][l] += ((double *)(panel + i * row))[c] * y[i * row + l];
    for (long i = 0; i < rows; i++)
        for (int l = 0; l < wide; l++) {
            Vec even = {0}, odd = {0};
            for (int c = 0; c < LANES; c += 2) {
                even += ((double *)(panel + i * row))[c] * overlap[c][l];
                odd += ((double *)(panel + i * row))[c + 1] * overlap[c + 1][l];
            }
            y[i * row + l] -= even + odd;
        }
}

static void block_gs(Frame *f, double *sums)
{
    const long row = f->stride / LANES, last = (f->k + LANES - 1) / LANES;
    Vec *y = (Vec *)f->y;
    for (long j = 0; j < last; j++) {
        const long width = f->k - j * LANES < LANES ? f->k - j * LANES : LANES;
        panel_gs(y + j, f->rows, row, width, sums + j * LANES);
        if (QR == 3) panel_gs(y + j, f->rows, row, width, sums + j * LANES);
        long l = j + 1;
        for (; l + WIDE <= last; l += WIDE) project(y + j, y + l, f->rows, row, WIDE);
        for (; l < last; l++) project(y + j, y + l, f->rows, row, 1);
    }
}

static void lq(Frame *f, double *sums)
{
    int k = f->k, rows = f->rows, stride = f->stride, info;
    f->gelqf(&k, &rows, f->y, &stride, f->tau, f->work, &f->work_size, &info);
    for (long j = 0; j < f->k; j++) sums[j] += log(fabs(f->y[j * f->stride + j]));
    f->orglq(&k, &rows, &k, f->y, &stride, f->tau, f->work, &f->work_size, &info);
}

static void transposed_qr(Frame *f, double *sums)
{
    int k = f->k, rows = f->rows, ld = rows + 8, info;
    double *z = f->work + f->work_size;
    for (long i = 0; i < rows; i += 8) for (long j = 0; j < k; j += 8)
        for (int u = 0; u < 8; u++) for (int v = 0; v < 8; v++) z[(j + v) * ld + i + u] = f->y[(i + u) * f->stride + j + v];
    f->gelqf(&rows, &k, z, &ld, f->tau, f->work, &f->work_size, &info);
    for (long j = 0; j < f->k; j++) sums[j] += log(fabs(z[j * ld + j]));
    f->orglq(&rows, &k, &k, z, &ld, f->tau, f->work, &f->work_size, &info);
    for (long i = 0; i < rows; i += 8) for (long j = 0; j < k; j += 8)
        for (int u = 0; u < 8; u++) for (int v = 0; v < 8; v++) f->y[(i + u) * f->stride + j + v] = z[(j + v) * ld + i + u];
}

static void orthonormalise(Frame *f, double *sums)
{
    if (QR == 0 || QR == 3) block_gs(f, sums);
    if (QR == 1) lq(f, sums);
    if (QR == 2) transposed_qr(f, sums);
}
