/* tests/baseline/mls.h - points with a deformation gradient by moving least squares, implicit Euler by Newton (Mueller,
   Keiser, Nealen, Pauly, Gross and Alexa 2004). Included by baseline.h.

   F_i = (sum w (x_j - x_i) xi^T) (sum w xi xi^T)^-1 over the neighbours, w = (1 - r^2 / 4 d^2)^3, neo-Hookean energy
   V Psi(F_i), forces its exact derivative. Inversion by signed singular values and an energy continued below stretch
   0.25 (Irving et al. 2004, Stomakhin et al. 2012). Nothing stabilises: inside a lattice x_i itself drops out of F_i,
   and motion that alternates from point to point costs nothing (Ganzenmueller 2015 names the remedies). A
   particle whose neighbours lie in a plane has no F, and no volume for it; a block of nothing else is not made. */
#ifndef PERI_BASELINE_MLS_H
#define PERI_BASELINE_MLS_H

typedef struct baseline__mls {
    baseline__newton newton;
    baseline__blocks map;               /* row i holds the vectors a_ik of F_i = sum_k x_k a_ik^T, i among them */
    double mu, lambda;
    double *tangent;                    /* 81 count */
    baseline__frame *frame;             /* count: of the positions whose gradient was asked for last */
} baseline__mls;

static void baseline__mls_map(const baseline__mls *o, const double *x, int i, double f[9]) {
    int k, c, e;
    memset(f, 0, 9 * sizeof(double));
    for (k = o->map.row[i]; k < o->map.row[i + 1]; k++) {
        const double *a = o->map.value + 3 * (size_t)k, *p = x + 3 * o->map.col[k];
        for (c = 0; c < 3; c++)
            for (e = 0; e < 3; e++) f[3 * c + e] += p[c] * a[e];
    }
}

/* gradient_k += p a_ik for all k. */
static void baseline__mls_spread(const baseline__mls *o, const double p[9], int i, double *gradient) {
    int k, c;
    for (k = o->map.row[i]; k < o->map.row[i + 1]; k++) {
        const double *a = o->map.value + 3 * (size_t)k;
        double *g = gradient + 3 * o->map.col[k];
        for (c = 0; c < 3; c++) g[c] += p[3 * c] * a[0] + p[3 * c + 1] * a[1] + p[3 * c + 2] * a[2];
    }
}

static double baseline__mls_energy(baseline *b, const double *x, double *gradient) {
    const baseline__mls *o = (const baseline__mls *)b->own;
    double energy = 0, f[9], p[9];
    baseline__principal psi;
    baseline__frame frame;
    int i, c;
    if (gradient) memset(gradient, 0, 3 * (size_t)b->count * sizeof(double));
    for (i = 0; i < b->count; i++) {
        baseline__mls_map(o, x, i, f);
        peri_svd3(f, frame.u, frame.s, frame.v);
        baseline__neo_hookean(frame.s, o->mu, o->lambda, &psi);
        energy += b->volume[i] * psi.energy;
        if (!gradient) continue;
        o->frame[i] = frame;
        baseline__stress(&frame, psi.first, p);
        for (c = 0; c < 9; c++) p[c] *= b->volume[i];
        baseline__mls_spread(o, p, i, gradient);
    }
    return energy;
}

static void baseline__mls_linearise(baseline *b, const double *x, int definite) {
    const baseline__mls *o = (const baseline__mls *)b->own;
    baseline__principal psi;
    int i;
    (void)x;
    for (i = 0; i < b->count; i++) {
        baseline__neo_hookean(o->frame[i].s, o->mu, o->lambda, &psi);
        if (definite) baseline__make_definite(&psi);
        baseline__tangent(o->frame + i, &psi, o->tangent + 81 * (size_t)i);
    }
}

static void baseline__mls_multiply(const baseline *b, const double *p, double *q) {
    const baseline__mls *o = (const baseline__mls *)b->own;
    double df[9], dp[9];
    int i, c, e;
    memset(q, 0, 3 * (size_t)b->count * sizeof(double));
    for (i = 0; i < b->count; i++) {
        const double *h = o->tangent + 81 * (size_t)i;
        baseline__mls_map(o, p, i, df);
        for (c = 0; c < 9; c++)
            for (dp[c] = 0, e = 0; e < 9; e++) dp[c] += b->volume[i] * h[9 * c + e] * df[e];
        baseline__mls_spread(o, dp, i, q);
    }
}

static void baseline__mls_diagonal(const baseline *b, double *block) {
    const baseline__mls *o = (const baseline__mls *)b->own;
    double half[27], part[9];
    int i, k, c;
    memset(block, 0, 9 * (size_t)b->count * sizeof(double));
    for (i = 0; i < b->count; i++)
        for (k = o->map.row[i]; k < o->map.row[i + 1]; k++) {
            const double *a = o->map.value + 3 * (size_t)k;
            baseline__half(o->tangent + 81 * (size_t)i, a, half);
            baseline__whole(half, b->volume[i], a, part);
            for (c = 0; c < 9; c++) block[9 * (size_t)o->map.col[k] + (size_t)c] += part[c];
        }
}

static const baseline__newton_methods baseline__mls_methods = {
    baseline__mls_energy, baseline__mls_linearise, baseline__mls_multiply, baseline__mls_diagonal};

/* The vectors a_ik of particle i. Returns 1 where the neighbours lie in a plane. */
static int baseline__mls_weigh(baseline__mls *o, const baseline *b, int i) {
    double d = b->def.spacing, moment[9] = {0}, inverse[9], det, y[3], *own = baseline__block(&o->map, i, i);
    int k, c, e, pass;
    for (pass = 0; pass < 2; pass++) {
        for (k = o->map.row[i]; k < o->map.row[i + 1]; k++) {
            double r = baseline__length(b->rest + 3 * i, b->rest + 3 * o->map.col[k], y) / (2 * d);
            double w = (1 - r * r) * (1 - r * r) * (1 - r * r), *a = o->map.value + 3 * (size_t)k;
            for (c = 0; c < 3 && a != own; c++)
                for (e = 0; e < 3; e++) {
                    if (!pass) moment[3 * c + e] += w * y[c] * y[e] / (d * d);
                    else a[c] += inverse[3 * c + e] * w * y[e] / (d * d);
                }
            for (c = 0; c < 3 && pass && a != own; c++) own[c] -= a[c];
        }
        if (pass) return 0;
        det = peri_det3(moment);
        if (!(det > 1e-9)) return 1;
        peri_adjugate3(moment, inverse);
        for (c = 0; c < 9; c++) inverse[c] /= det;
    }
    return 0;
}

static int baseline__mls_create(baseline *b) {
    baseline__mls *o = (baseline__mls *)calloc(1, sizeof *o);
    int pairs = baseline__pairs(&b->def, 0, NULL, NULL), some = 0, i, bad;
    int *first = (int *)malloc(((size_t)pairs + 1) * sizeof(int));
    int *second = (int *)malloc(((size_t)pairs + 1) * sizeof(int));
    b->own = o;
    bad = !o || !first || !second;
    if (!bad) {
        baseline__pairs(&b->def, 0, first, second);
        baseline__lame(&b->def, &o->mu, &o->lambda);
        o->tangent = (double *)malloc(81 * (size_t)b->count * sizeof(double));
        o->frame = (baseline__frame *)malloc((size_t)b->count * sizeof *o->frame);
        bad = !o->tangent || !o->frame || baseline__newton_create(&o->newton, b, &baseline__mls_methods) ||
              baseline__blocks_create(&o->map, 3, b->count, pairs, first, second);
    }
    free(first);
    free(second);
    for (i = 0; !bad && i < b->count; i++) {
        if (b->volume[i] > 0 && baseline__mls_weigh(o, b, i)) b->volume[i] = 0;
        some += b->volume[i] > 0;
    }
    return bad || !some;
}

static void baseline__mls_destroy(baseline *b) {
    baseline__mls *o = (baseline__mls *)b->own;
    baseline__newton_destroy(&o->newton);
    baseline__blocks_destroy(&o->map);
    free(o->tangent);
    free(o->frame);
}

static int baseline__mls_step(baseline *b, double h) {
    return baseline__newton_run(&((baseline__mls *)b->own)->newton, b, h);
}

#endif
