/* tests/baseline/springs.h - the mass-spring lattice with implicit Euler (Baraff and Witkin 1998), solved to the end by
   Newton (newton.h) instead of one linear step. Included by baseline.h.

   Springs to the 26 neighbours with the stiffness of bonds.h. A compressed spring has negative stiffness across itself;
   it is left out (Choi and Ko 2002) unless def.plain asks for the exact one. */
#ifndef PERI_BASELINE_SPRINGS_H
#define PERI_BASELINE_SPRINGS_H

typedef struct baseline__springs {
    baseline__bonds bonds;              /* first: see baseline__bond_energy */
    baseline__newton newton;
    baseline__blocks stiffness;
} baseline__springs;

static void baseline__springs_linearise(baseline *b, const double *x, int definite) {
    baseline__springs *o = (baseline__springs *)b->own;
    const baseline__bonds *s = &o->bonds;
    double y[3], block[9], minus[9];
    int k, c, e;
    baseline__blocks_zero(&o->stiffness);
    for (k = 0; k < s->count; k++) {
        double length = baseline__length(x + 3 * s->a[k], x + 3 * s->b[k], y), across;
        if (!(length > 0)) continue;
        across = 1 - s->rest[k] / length;
        if (definite && across < 0) across = 0;
        for (c = 0; c < 3; c++)
            for (e = 0; e < 3; e++) {
                double along = y[c] * y[e] / (length * length);
                block[3 * c + e] = s->stiffness[k] * (along + across * ((c == e) - along));
                minus[3 * c + e] = -block[3 * c + e];
            }
        baseline__blocks_add(&o->stiffness, s->a[k], s->a[k], block);
        baseline__blocks_add(&o->stiffness, s->b[k], s->b[k], block);
        baseline__blocks_add(&o->stiffness, s->a[k], s->b[k], minus);
        baseline__blocks_add(&o->stiffness, s->b[k], s->a[k], minus);
    }
}

static void baseline__springs_multiply(const baseline *b, const double *p, double *q) {
    baseline__blocks_multiply(&((const baseline__springs *)b->own)->stiffness, p, q);
}

static void baseline__springs_diagonal(const baseline *b, double *block) {
    baseline__blocks_diagonal(&((const baseline__springs *)b->own)->stiffness, block);
}

static const baseline__newton_methods baseline__springs_methods = {
    baseline__bond_energy, baseline__springs_linearise, baseline__springs_multiply, baseline__springs_diagonal};

static int baseline__springs_create(baseline *b) {
    baseline__springs *o = (baseline__springs *)calloc(1, sizeof *o);
    if (!(b->own = o)) return 1;
    return baseline__bonds_create(&o->bonds, b) || baseline__newton_create(&o->newton, b, &baseline__springs_methods) ||
           baseline__blocks_create(&o->stiffness, 9, b->count, o->bonds.count, o->bonds.a, o->bonds.b);
}

static void baseline__springs_destroy(baseline *b) {
    baseline__springs *o = (baseline__springs *)b->own;
    baseline__bonds_destroy(&o->bonds);
    baseline__newton_destroy(&o->newton);
    baseline__blocks_destroy(&o->stiffness);
}

static int baseline__springs_step(baseline *b, double h) {
    return baseline__newton_run(&((baseline__springs *)b->own)->newton, b, h);
}

#endif
