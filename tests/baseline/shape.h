/* tests/baseline/shape.h - shape matching (Mueller, Heidelberger, Teschner and Gross 2005) in overlapping clusters of
   2 x 2 x 2 particles, masses shared between a particle's clusters so that momentum is kept (Rivers and James 2007).
   Included by baseline.h.

   Positions are predicted, each cluster finds the rigid motion closest to them, and each particle goes the share alpha
   of the way to the mean of its goals. That is a force of alpha m / h^2 times the way, so that under F a cell stores
   (alpha rho d^2 / 8 h^2) |F - R|^2 a volume: mu = alpha rho d^2 / 8 h^2, Poisson's ratio 0, and
       alpha = 4 E h^2 / (rho d^2), at most 1.
   Where that is 1 the body has Young's modulus rho d^2 / 4 h^2, whatever was asked: its stiffness hangs on time step
   and spacing, the method's known flaw. A block one cell thin has no cluster. */
#ifndef PERI_BASELINE_SHAPE_H
#define PERI_BASELINE_SHAPE_H

typedef struct baseline__shape {
    int count, *member;                 /* clusters; 8 count, -1 where a cell is empty */
    int *clusters;                      /* of a particle */
    double *start, *goal;               /* 3 b->count; goal: sum over the clusters */
} baseline__shape;

static int baseline__shape_create(baseline *b) {
    baseline__shape *o = (baseline__shape *)calloc(1, sizeof *o);
    int n[3], a, i, j, k, c;
    if (!(b->own = o)) return 1;
    for (a = 0; a < 3; a++) n[a] = baseline__cells(&b->def, a);
    if (!(o->count = (n[0] - 1) * (n[1] - 1) * (n[2] - 1))) return 1;
    o->member = (int *)malloc(8 * (size_t)o->count * sizeof(int));
    o->clusters = (int *)calloc((size_t)b->count, sizeof(int));
    o->start = (double *)malloc(3 * (size_t)b->count * sizeof(double));
    o->goal = (double *)malloc(3 * (size_t)b->count * sizeof(double));
    if (!o->member || !o->clusters || !o->start || !o->goal) return 1;
    for (a = 0, k = 0; k < n[2] - 1; k++)
        for (j = 0; j < n[1] - 1; j++)
            for (i = 0; i < n[0] - 1; i++)
                for (c = 0; c < 8; c++, a++) {
                    int at = i + (c & 1) + n[0] * (j + (c >> 1 & 1) + n[1] * (k + (c >> 2)));
                    int empty = b->def.removed && b->def.removed[at];
                    o->member[a] = empty ? -1 : at;
                    if (!empty) o->clusters[at]++;
                }
    return 0;
}

static void baseline__shape_destroy(baseline *b) {
    baseline__shape *o = (baseline__shape *)b->own;
    free(o->member);
    free(o->clusters);
    free(o->start);
    free(o->goal);
}

/* Adds where the rigid motion closest to x takes the cluster's particles to their goals. */
static void baseline__shape_match(const baseline__shape *o, const baseline *b, const int *eight) {
    double now[3] = {0}, rest[3] = {0}, map[9] = {0}, r[9], m, total = 0;
    int member[8], count = 0, k, c, e;
    for (k = 0; k < 8; k++)
        if (eight[k] >= 0) member[count++] = eight[k];
    if (!count) return;
    for (k = 0; k < count; k++) {
        total += m = b->mass[member[k]] / o->clusters[member[k]];
        for (c = 0; c < 3; c++) {
            now[c] += m * b->x[3 * member[k] + c];
            rest[c] += m * b->rest[3 * member[k] + c];
        }
    }
    for (c = 0; c < 3; c++) {
        now[c] /= total;
        rest[c] /= total;
    }
    for (k = 0; k < count; k++)
        for (m = b->mass[member[k]] / o->clusters[member[k]] / total, c = 0; c < 3; c++)
            for (e = 0; e < 3; e++)
                map[3 * c + e] += m * (b->x[3 * member[k] + c] - now[c]) * (b->rest[3 * member[k] + e] - rest[e]);
    peri_polar3(map, r);
    for (k = 0; k < count; k++)
        for (c = 0; c < 3; c++)
            for (o->goal[3 * member[k] + c] += now[c], e = 0; e < 3; e++)
                o->goal[3 * member[k] + c] += r[3 * c + e] * (b->rest[3 * member[k] + e] - rest[e]);
}

static double baseline__shape_alpha(const baseline *b, double h) {
    return fmin(1, 4 * b->def.young * h * h / (b->def.density * b->def.spacing * b->def.spacing));
}

static int baseline__shape_step(baseline *b, double h) {
    baseline__shape *o = (baseline__shape *)b->own;
    double alpha = baseline__shape_alpha(b, h);
    int k, n = 3 * b->count;
    memcpy(o->start, b->x, (size_t)n * sizeof(double));
    memset(o->goal, 0, (size_t)n * sizeof(double));
    for (k = 0; k < n; k++)
        if (!b->fixed[k / 3]) b->x[k] += h * (b->v[k] + h * b->def.gravity[k % 3]);
    for (k = 0; k < o->count; k++) baseline__shape_match(o, b, o->member + 8 * (size_t)k);
    for (k = 0; k < n; k++) {
        if (b->fixed[k / 3]) continue;
        b->x[k] += alpha * (o->goal[k] / o->clusters[k / 3] - b->x[k]);
        b->v[k] = (b->x[k] - o->start[k]) / h;
    }
    b->iterations = 1;
    return 0;
}

#endif
