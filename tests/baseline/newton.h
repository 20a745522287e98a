/* tests/baseline/newton.h - implicit Euler by Newton with conjugate gradients: what mass-spring, tetrahedra and the
   least-squares gradient share. Included by baseline.h.

   A step minimises |x - x*|_M^2 / 2 h^2 + E(x), x* = x + h v + h^2 g (Martin et al. 2011). Each iteration solves
   (M / h^2 + K) p = - gradient by conjugate gradients over the inverse of the 3x3 diagonal blocks, to a thousandth of
   the gradient in the preconditioner's norm, starting from zero; then x moves by p. Two ways, by def.plain:
     0   K made definite by the method, and p halved until the sum goes down (Armijo 1e-4): what careful programs do
         since Teran et al. 2005
     1   K as it is, p whole, no look at the sum: the textbook's Newton. A direction of negative curvature is a failure
         of the linear solve, as a failing pivot would be of a direct one.
   The first guess is x or x*, whichever has the smaller sum (plain: x). */
#ifndef PERI_BASELINE_NEWTON_H
#define PERI_BASELINE_NEWTON_H

/* ---- symmetric matrices of 3x3 blocks, all blocks stored, in compressed rows ------------------------------------- */

typedef struct baseline__blocks {
    int n, size, *row, *col;            /* n + 1, row[n]; columns ascend */
    double *value;                      /* size row[n]; size 9, or what else a method keeps by pairs */
} baseline__blocks;

static void baseline__blocks_destroy(baseline__blocks *m) {
    free(m->row);
    free(m->col);
    free(m->value);
}

/* Blocks at the diagonal and at (a, b) and (b, a) of each pair, no pair twice. 0 on success. */
static int baseline__blocks_create(baseline__blocks *m, int size, int n, int pairs, const int *a, const int *b) {
    int i, k, *end = (int *)malloc((size_t)n * sizeof(int));
    m->n = n;
    m->size = size;
    m->row = (int *)calloc((size_t)n + 1, sizeof(int));
    m->col = (int *)malloc(((size_t)n + 2 * (size_t)pairs) * sizeof(int));
    m->value = (double *)calloc((size_t)size * ((size_t)n + 2 * (size_t)pairs), sizeof(double));
    if (!end || !m->row || !m->col || !m->value) {
        free(end);
        return 1;
    }
    for (k = 0; k < pairs; k++) m->row[a[k] + 1]++, m->row[b[k] + 1]++;
    for (i = 0; i < n; i++) m->row[i + 1] += m->row[i] + 1;
    for (i = 0; i < n; i++) m->col[end[i] = m->row[i]] = i, end[i]++;
    for (k = 0; k < pairs; k++) m->col[end[a[k]]++] = b[k], m->col[end[b[k]]++] = a[k];
    for (i = 0; i < n; i++)
        for (k = m->row[i] + 1; k < m->row[i + 1]; k++) {
            int c = m->col[k], at = k;
            for (; at > m->row[i] && m->col[at - 1] > c; at--) m->col[at] = m->col[at - 1];
            m->col[at] = c;
        }
    free(end);
    return 0;
}

static void baseline__blocks_zero(baseline__blocks *m) {
    memset(m->value, 0, (size_t)m->size * (size_t)m->row[m->n] * sizeof(double));
}

static double *baseline__block(const baseline__blocks *m, int i, int j) {
    int k = m->row[i];
    while (m->col[k] != j) k++;
    return m->value + (size_t)m->size * (size_t)k;
}

static void baseline__blocks_add(baseline__blocks *m, int i, int j, const double block[9]) {
    double *v = baseline__block(m, i, j);
    int c;
    for (c = 0; c < 9; c++) v[c] += block[c];
}

static void baseline__blocks_multiply(const baseline__blocks *m, const double *p, double *q) {
    int i, k;
    for (i = 0; i < m->n; i++) {
        double x = 0, y = 0, z = 0;
        for (k = m->row[i]; k < m->row[i + 1]; k++) {
            const double *v = m->value + 9 * (size_t)k, *a = p + 3 * m->col[k];
            x += v[0] * a[0] + v[1] * a[1] + v[2] * a[2];
            y += v[3] * a[0] + v[4] * a[1] + v[5] * a[2];
            z += v[6] * a[0] + v[7] * a[1] + v[8] * a[2];
        }
        q[3 * i] = x;
        q[3 * i + 1] = y;
        q[3 * i + 2] = z;
    }
}

static void baseline__blocks_diagonal(const baseline__blocks *m, double *block) {
    int i;
    for (i = 0; i < m->n; i++) memcpy(block + 9 * (size_t)i, baseline__block(m, i, i), 9 * sizeof(double));
}

/* ---- the step ---------------------------------------------------------------------------------------------------- */

/* What a method brings. energy: as in baseline__method. linearise: makes K of positions x, positive semidefinite when
   asked. multiply: q = K p. diagonal: the 3x3 blocks of K's diagonal, 9 count. */
typedef struct baseline__newton_methods {
    double (*energy)(baseline *b, const double *x, double *gradient);
    void (*linearise)(baseline *b, const double *x, int definite);
    void (*multiply)(const baseline *b, const double *p, double *q);
    void (*diagonal)(const baseline *b, double *block);
} baseline__newton_methods;

typedef struct baseline__newton {
    const baseline__newton_methods *methods;
    int solves;                         /* iterations of conjugate gradients in the last step */
    double *start, *trial, *gradient, *p, *r, *z, *s, *q;   /* 3 count */
    double *inverse;                    /* 9 count: of the diagonal blocks */
} baseline__newton;

static int baseline__newton_create(baseline__newton *o, const baseline *b, const baseline__newton_methods *methods) {
    size_t n = 3 * (size_t)b->count;
    o->methods = methods;
    if (!(o->start = (double *)calloc(11 * n, sizeof(double)))) return 1;
    o->trial = o->start + n;
    o->gradient = o->start + 2 * n;
    o->p = o->start + 3 * n;
    o->r = o->start + 4 * n;
    o->z = o->start + 5 * n;
    o->s = o->start + 6 * n;
    o->q = o->start + 7 * n;
    o->inverse = o->start + 8 * n;
    return 0;
}

static void baseline__newton_destroy(baseline__newton *o) { free(o->start); }

/* The sum that the step minimises, less a constant, and its gradient (0 at fixed particles) when not NULL. Written in
   the way from `start`, so that large steps lose no digits. */
static double baseline__objective(baseline__newton *o, baseline *b, double h, const double *x, double *gradient) {
    double sum = o->methods->energy(b, x, gradient);
    int i, c;
    for (i = 0; i < b->count; i++)
        for (c = 0; c < 3; c++) {
            int k = 3 * i + c;
            double way = x[k] - o->start[k], pull = b->v[k] / h + b->def.gravity[c];
            if (b->fixed[i]) {
                if (gradient) gradient[k] = 0;
                continue;
            }
            sum += b->mass[i] * way * (0.5 * way / (h * h) - pull);
            if (gradient) gradient[k] += b->mass[i] * (way / (h * h) - pull);
        }
    return sum;
}

static void baseline__precondition(const baseline__newton *o, const baseline *b, const double *r, double *z) {
    int i, c;
    for (i = 0; i < b->count; i++)
        for (c = 0; c < 3; c++) {
            const double *a = o->inverse + 9 * (size_t)i + 3 * c;
            z[3 * i + c] = a[0] * r[3 * i] + a[1] * r[3 * i + 1] + a[2] * r[3 * i + 2];
        }
}

/* The inverses of the diagonal blocks of M / h^2 + K; 0 for a fixed particle. */
static void baseline__invert_diagonal(baseline__newton *o, const baseline *b, double h) {
    int i, c;
    o->methods->diagonal(b, o->inverse);
    for (i = 0; i < b->count; i++) {
        double *block = o->inverse + 9 * (size_t)i, adjugate[9], det;
        for (c = 0; c < 9; c += 4) block[c] += b->mass[i] / (h * h);
        peri_adjugate3(block, adjugate);
        det = peri_det3(block);
        for (c = 0; c < 9; c++) block[c] = b->fixed[i] ? 0 : adjugate[c] / det;
    }
}

static double baseline__dot(const baseline *b, const double *p, const double *q) {
    double sum = 0;
    int k;
    for (k = 0; k < 3 * b->count; k++) sum += p[k] * q[k];
    return sum;
}

/* p = - (M / h^2 + K)^-1 gradient. Returns -1 where the matrix is seen not to be positive definite. */
static int baseline__solve(baseline__newton *o, const baseline *b, double h) {
    int n = 3 * b->count, most = 10 * n + 100, k, turn;
    double rho, first, curvature;
    baseline__invert_diagonal(o, b, h);
    memset(o->p, 0, (size_t)n * sizeof(double));
    for (k = 0; k < n; k++) o->r[k] = -o->gradient[k];
    baseline__precondition(o, b, o->r, o->z);
    memcpy(o->s, o->z, (size_t)n * sizeof(double));
    first = rho = baseline__dot(b, o->r, o->z);
    for (turn = 0; turn < most && rho > 1e-6 * first; turn++, o->solves++) {
        double step, old = rho;
        o->methods->multiply(b, o->s, o->q);
        for (k = 0; k < n; k++) o->q[k] = b->fixed[k / 3] ? 0 : o->q[k] + b->mass[k / 3] / (h * h) * o->s[k];
        curvature = baseline__dot(b, o->s, o->q);
        if (!(curvature > 0)) return -1;
        step = rho / curvature;
        for (k = 0; k < n; k++) {
            o->p[k] += step * o->s[k];
            o->r[k] -= step * o->q[k];
        }
        baseline__precondition(o, b, o->r, o->z);
        rho = baseline__dot(b, o->r, o->z);
        for (k = 0; k < n; k++) o->s[k] = o->z[k] + rho / old * o->s[k];
    }
    return rho >= 0 ? 0 : -1;           /* an indefinite preconditioner, or NaN */
}

/* x += share p where that lowers the sum enough; returns the new sum, or NAN when nothing does. */
static double baseline__descend(baseline__newton *o, baseline *b, double h, double sum) {
    double slope = baseline__dot(b, o->gradient, o->p), share = 1, new_sum;
    int k, halving;
    for (halving = 0; halving < 40; halving++, share /= 2) {
        for (k = 0; k < 3 * b->count; k++) o->trial[k] = b->x[k] + share * o->p[k];
        new_sum = baseline__objective(o, b, h, o->trial, NULL);
        if (!(new_sum <= sum + 1e-4 * share * slope)) continue;
        memcpy(b->x, o->trial, 3 * (size_t)b->count * sizeof(double));
        return new_sum;
    }
    return (double)NAN;
}

static void baseline__first_guess(baseline__newton *o, baseline *b, double h) {
    int k, n = 3 * b->count;
    memcpy(o->start, b->x, (size_t)n * sizeof(double));
    if (b->def.plain) return;
    for (k = 0; k < n; k++) o->trial[k] = b->x[k] + (b->fixed[k / 3] ? 0 : h * (b->v[k] + h * b->def.gravity[k % 3]));
    if (baseline__objective(o, b, h, o->trial, NULL) < baseline__objective(o, b, h, b->x, NULL))
        memcpy(b->x, o->trial, (size_t)n * sizeof(double));
}

/* One step of implicit Euler; returns as baseline_step. */
static int baseline__newton_run(baseline__newton *o, baseline *b, double h) {
    int k, n = 3 * b->count, result = 1;
    double correction;
    o->solves = 0;
    baseline__first_guess(o, b, h);
    for (b->iterations = 0; result == 1 && b->iterations < b->def.max_iterations; b->iterations++) {
        double sum = baseline__objective(o, b, h, b->x, o->gradient);
        o->methods->linearise(b, b->x, !b->def.plain);
        if (!isfinite(sum) || baseline__solve(o, b, h)) return -1;
        for (correction = 0, k = 0; k < n; k++) correction = fmax(correction, fabs(o->p[k]));
        if (correction < b->def.tolerance * b->def.spacing) result = 0;
        if (b->def.plain)
            for (k = 0; k < n; k++) b->x[k] += o->p[k];
        else if (isnan(baseline__descend(o, b, h, sum)))
            break;                      /* no way down: at the limit of rounding this is success */
    }
    for (k = 0; k < n; k++)
        if (!b->fixed[k / 3]) b->v[k] = (b->x[k] - o->start[k]) / h;
    return result;
}

#endif
