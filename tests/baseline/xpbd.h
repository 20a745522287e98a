/* tests/baseline/xpbd.h - extended position-based dynamics (Macklin, Mueller and Chentanez 2016): the springs of
   bonds.h as distance constraints of compliance 1 / stiffness, Gauss-Seidel sweeps. Included by baseline.h.

   Sweeps end when none of a sweep's corrections passes the tolerance, or after max_iterations. In the limit of many
   sweeps this is implicit Euler of the springs but for the turning of the constraints within the step; one sweep and
   many substeps (Macklin et al. 2019) is max_iterations 1 and substeps n. Stiff or fine bodies need more sweeps than a
   frame has, and are too soft without them. */
#ifndef PERI_BASELINE_XPBD_H
#define PERI_BASELINE_XPBD_H

typedef struct baseline__xpbd {
    baseline__bonds bonds;              /* first: see baseline__bond_energy */
    double *start, *lambda;             /* 3 count; bonds.count */
} baseline__xpbd;

static int baseline__xpbd_create(baseline *b) {
    baseline__xpbd *o = (baseline__xpbd *)calloc(1, sizeof *o);
    if (!(b->own = o) || baseline__bonds_create(&o->bonds, b)) return 1;
    o->start = (double *)malloc(3 * (size_t)b->count * sizeof(double));
    o->lambda = (double *)malloc(((size_t)o->bonds.count + 1) * sizeof(double));
    return !o->start || !o->lambda;
}

static void baseline__xpbd_destroy(baseline *b) {
    baseline__xpbd *o = (baseline__xpbd *)b->own;
    baseline__bonds_destroy(&o->bonds);
    free(o->start);
    free(o->lambda);
}

/* One sweep over the constraints; returns the largest correction, m. */
static double baseline__xpbd_sweep(baseline *b, double h) {
    const baseline__xpbd *o = (const baseline__xpbd *)b->own;
    const baseline__bonds *s = &o->bonds;
    double largest = 0, y[3];
    int k, c;
    for (k = 0; k < s->count; k++) {
        int i = s->a[k], j = s->b[k];
        double wi = b->fixed[i] ? 0 : 1 / b->mass[i], wj = b->fixed[j] ? 0 : 1 / b->mass[j];
        double length = baseline__length(b->x + 3 * i, b->x + 3 * j, y), give = 1 / (s->stiffness[k] * h * h), step;
        if (wi + wj == 0 || !(length > 0)) continue;
        step = (s->rest[k] - length - give * o->lambda[k]) / (wi + wj + give);
        o->lambda[k] += step;
        largest = fmax(largest, fabs(step) * fmax(wi, wj));
        for (c = 0; c < 3; c++) {
            b->x[3 * i + c] -= wi * step * y[c] / length;
            b->x[3 * j + c] += wj * step * y[c] / length;
        }
    }
    return largest;
}

static int baseline__xpbd_step(baseline *b, double h) {
    baseline__xpbd *o = (baseline__xpbd *)b->own;
    int k, result = 1, n = 3 * b->count;
    memcpy(o->start, b->x, (size_t)n * sizeof(double));
    memset(o->lambda, 0, (size_t)o->bonds.count * sizeof(double));
    for (k = 0; k < n; k++)
        if (!b->fixed[k / 3]) b->x[k] += h * (b->v[k] + h * b->def.gravity[k % 3]);
    for (b->iterations = 0; result == 1 && b->iterations < b->def.max_iterations; b->iterations++)
        if (baseline__xpbd_sweep(b, h) < b->def.tolerance * b->def.spacing) result = 0;
    for (k = 0; k < n; k++)
        if (!b->fixed[k / 3]) b->v[k] = (b->x[k] - o->start[k]) / h;
    return result;
}

#endif
