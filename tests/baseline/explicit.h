/* tests/baseline/explicit.h - bond-based peridynamics in small steps (Silling 2000; Silling and Askari 2005, prototype
   microelastic brittle without the breaking): each bond pulls with a force proportional to its stretch, symplectic
   Euler. Included by baseline.h.

   The horizon is the 26 neighbours, the weights those of bonds.h, so that space is as well resolved as in the others,
   and a step costs as little as a step can. Stable while the step is below 2 / (highest frequency). */
#ifndef PERI_BASELINE_EXPLICIT_H
#define PERI_BASELINE_EXPLICIT_H

typedef struct baseline__explicit {
    baseline__bonds bonds;              /* first: see baseline__bond_energy */
    double *gradient;
} baseline__explicit;

static int baseline__explicit_create(baseline *b) {
    baseline__explicit *o = (baseline__explicit *)calloc(1, sizeof *o);
    if (!(b->own = o)) return 1;
    o->gradient = (double *)malloc(3 * (size_t)b->count * sizeof(double));
    return !o->gradient || baseline__bonds_create(&o->bonds, b);
}

static void baseline__explicit_destroy(baseline *b) {
    baseline__explicit *o = (baseline__explicit *)b->own;
    baseline__bonds_destroy(&o->bonds);
    free(o->gradient);
}

static int baseline__explicit_step(baseline *b, double h) {
    const baseline__explicit *o = (const baseline__explicit *)b->own;
    int i, c;
    baseline__bond_energy(b, b->x, o->gradient);
    for (i = 0; i < b->count; i++)
        for (c = 0; c < 3 && !b->fixed[i]; c++) {
            b->v[3 * i + c] += h * (b->def.gravity[c] - o->gradient[3 * i + c] / b->mass[i]);
            b->x[3 * i + c] += h * b->v[3 * i + c];
        }
    b->iterations = 1;
    return 0;
}

/* A step that is stable for small strains: 2 / sqrt(highest eigenvalue of M^-1 K by Gershgorin's circles), which is at
   most a few per cent below the true limit of a lattice. */
BASELINE_MAY double baseline_explicit_limit(const baseline *b) {
    const baseline__bonds *s = &((const baseline__explicit *)b->own)->bonds;
    double *sum = (double *)calloc(9 * (size_t)b->count, sizeof(double)), highest = 0, y[3];
    int i, k, c, e;
    for (k = 0; sum && k < s->count; k++) {
        double r = baseline__length(b->rest + 3 * s->a[k], b->rest + 3 * s->b[k], y);
        for (c = 0; c < 3; c++)
            for (e = 0; e < 3; e++) {
                double f = 2 * s->stiffness[k] * fabs(y[c] * y[e]) / (r * r);
                sum[9 * s->a[k] + 3 * c + e] += f;
                sum[9 * s->b[k] + 3 * c + e] += f;
            }
    }
    for (i = 0; sum && i < b->count; i++)
        for (c = 0; c < 3; c++) {
            double row = sum[9 * i + 3 * c] + sum[9 * i + 3 * c + 1] + sum[9 * i + 3 * c + 2];
            highest = fmax(highest, row / b->mass[i]);
        }
    free(sum);
    return highest > 0 ? 2 / sqrt(highest) : 0;
}

#endif
