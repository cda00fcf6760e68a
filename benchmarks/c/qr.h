
static double *element(const Frame *f, long i, long j)
{
    return (double *)(f->y + j / COLUMNS * f->rows + i) + j % COLUMNS;
}

static Frame new_frame(long rows, long k, const double *frame, Factorise *geqrf, Generate *orgqr)
{
    Frame f = {.rows = rows, .k = k, .strips = (k + COLUMNS - 1) / COLUMNS, .geqrf = geqrf, .orgqr = orgqr};
    f.y = doubles(rows * f.strips * COLUMNS);
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
    free(f->columns);
    free(f->tau);
    free(f->work);
}

static inline double lane(const Row *y, int w, long c)
{
    return ((const double *)&(*y)[w])[c];
}

/* Modified Gram-Schmidt of `width` columns, vector w of a strip: step c removes column c from all later ones at once,
 * and finds the overlaps of the next one on the way. Adds ln R_cc to sums. */
static inline void panel_gs(Row *y, int w, long rows, long width, double *sums)
{
    Vec sum[4] = {0}; /* several sums: less waiting for additions; rows = 4n */
    for (long i = 0; i < rows; i += 4)
        for (int u = 0; u < 4; u++) sum[u] += y[i + u][w] * lane(y + i + u, w, 0);
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
                Row *v = y + i + u;
                const Vec left = (*v)[w] - remove * lane(v, w, c);
                (*v)[w] = left;
                sum[u] += left * lane(v, w, next);
            }
    }
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

static void block_gs(Frame *f, double *sums)
{
    for (long s = 0; s < f->strips; s++) {
        Row *y = f->y + s * f->rows;
        for (long before = 0; before < s; before++)
            for (int v = 0; v < WIDTH; v++) project(f->y + before * f->rows, v, y, 0, f->rows);
        for (int w = 0; w < WIDTH; w++) {
            const long from = s * COLUMNS + w * LANES, left = f->k - from;
            if (w == 1) project(y, 0, y, 1, f->rows);
            if (left > 0) panel_gs(y, w, f->rows, left < LANES ? left : LANES, sums + from);
        }
    }
}

static void lapack_qr(Frame *f, double *sums)
{
    int k = f->k, rows = f->rows, info;
    for (long j = 0; j < k; j++)
        for (long i = 0; i < rows; i++) f->columns[j * rows + i] = *element(f, i, j);
    f->geqrf(&rows, &k, f->columns, &rows, f->tau, f->work, &f->work_size, &info);
    for (long j = 0; j < k; j++) sums[j] += log(fabs(f->columns[j * rows + j]));
    f->orgqr(&rows, &k, &k, f->columns, &rows, f->tau, f->work, &f->work_size, &info);
    for (long j = 0; j < k; j++)
        for (long i = 0; i < rows; i++) *element(f, i, j) = f->columns[j * rows + i];
}

static void orthonormalise(Frame *f, double *sums)
{
    if (f->geqrf)
        lapack_qr(f, sums);
    else
        block_gs(f, sums);
}
