/* tests/baseline/bonds.h - springs from each particle of the lattice to its 26 neighbours: what explicit bonds, the
   mass-spring method and XPBD share. Included by baseline.h.

   Along an edge, a face diagonal and a space diagonal of the cell the stiffness is f, e, c (N/m). Under a strain eps
   the energy density is sum k r^2 (n.eps n)^2 / 2 d^3 over the 13 directions, so C1111 = (f + 2 e + 4/3 c) / d and
   C1122 = (e + 4/3 c) / d. Isotropy asks C1111 = 3 C1122, that is f = e + 8/3 c, and then lambda = mu = C1122 = 0.4 E:
   Poisson's ratio 1/4 (Born and Huang 1954). With c = e / 2: e = 0.24 E d, c = 0.12 E d, f = 0.56 E d, exact inside.
   A particle at the surface lacks bonds, and its share of matter would be too soft: the usual correction of
   peridynamics (Le and Bobaru 2018, "volume method") multiplies a bond by the mean of its ends' (sum k r^2 of a whole
   family) / (sum k r^2 of its own). A bar 4 to 8 across then
   bends 13 % too stiffly; without it, 45 to 19 % too softly. */
#ifndef PERI_BASELINE_BONDS_H
#define PERI_BASELINE_BONDS_H

typedef struct baseline__bonds {
    int count, *a, *b;
    double *rest, *stiffness;           /* m, N/m */
} baseline__bonds;

static void baseline__bonds_destroy(baseline__bonds *s) {
    free(s->a);
    free(s->b);
    free(s->rest);
    free(s->stiffness);
}

/* The pairs (a < b) of lattice neighbours; returns how many. a and b may be NULL. */
static int baseline__pairs(const baseline_def *def, int extra, int *a, int *b) {
    int n[3], at[3], o[3], c, count = 0;
    for (c = 0; c < 3; c++) n[c] = baseline__cells(def, c) + extra;
    for (at[2] = 0; at[2] < n[2]; at[2]++)
        for (at[1] = 0; at[1] < n[1]; at[1]++)
            for (at[0] = 0; at[0] < n[0]; at[0]++)
                for (c = 14; c < 27; c++) {     /* of the 27 offsets, those that come after the middle one */
                    o[0] = at[0] + c % 3 - 1;
                    o[1] = at[1] + c / 3 % 3 - 1;
                    o[2] = at[2] + c / 9 - 1;
                    if (o[0] < 0 || o[0] >= n[0] || o[1] < 0 || o[1] >= n[1] || o[2] >= n[2]) continue;
                    if (a) a[count] = at[0] + n[0] * (at[1] + n[1] * at[2]);
                    if (b) b[count] = o[0] + n[0] * (o[1] + n[1] * o[2]);
                    count++;
                }
    return count;
}

static double baseline__length(const double *p, const double *q, double y[3]) {
    y[0] = q[0] - p[0];
    y[1] = q[1] - p[1];
    y[2] = q[2] - p[2];
    return sqrt(y[0] * y[0] + y[1] * y[1] + y[2] * y[2]);
}

/* Returns 0 on success. */
static int baseline__bonds_create(baseline__bonds *s, const baseline *b) {
    static const double share[4] = {0, 0.56, 0.24, 0.12};
    double d = b->def.spacing, y[3], *sum = (double *)calloc((size_t)b->count, sizeof(double));
    double whole = b->def.young * d * d * d * (6 * 0.56 + 12 * 2 * 0.24 + 8 * 3 * 0.12);
    size_t room = (size_t)(s->count = baseline__pairs(&b->def, 0, NULL, NULL)) + 1;
    int k;
    s->a = (int *)malloc(room * sizeof(int));
    s->b = (int *)malloc(room * sizeof(int));
    s->rest = (double *)malloc(room * sizeof(double));
    s->stiffness = (double *)malloc(room * sizeof(double));
    if (!sum || !s->a || !s->b || !s->rest || !s->stiffness) {
        free(sum);
        return 1;
    }
    baseline__pairs(&b->def, 0, s->a, s->b);
    for (k = 0; k < s->count; k++) {
        double r = s->rest[k] = baseline__length(b->rest + 3 * s->a[k], b->rest + 3 * s->b[k], y);
        s->stiffness[k] = share[(int)(r * r / (d * d) + 0.5)] * b->def.young * d;
        sum[s->a[k]] += s->stiffness[k] * r * r;
        sum[s->b[k]] += s->stiffness[k] * r * r;
    }
    for (k = 0; k < s->count; k++) s->stiffness[k] *= 0.5 * whole * (1 / sum[s->a[k]] + 1 / sum[s->b[k]]);
    free(sum);
    return 0;
}

/* Energy sum k (|y| - r)^2 / 2 and its gradient. own begins with the bonds. */
static double baseline__bond_energy(baseline *b, const double *x, double *gradient) {
    const baseline__bonds *s = (const baseline__bonds *)b->own;
    double energy = 0, y[3];
    int k, c;
    if (gradient) memset(gradient, 0, 3 * (size_t)b->count * sizeof(double));
    for (k = 0; k < s->count; k++) {
        double length = baseline__length(x + 3 * s->a[k], x + 3 * s->b[k], y), e = length - s->rest[k];
        energy += 0.5 * s->stiffness[k] * e * e;
        if (!gradient || !(length > 0)) continue;
        for (c = 0; c < 3; c++) {
            double f = s->stiffness[k] * e / length * y[c];
            gradient[3 * s->a[k] + c] -= f;
            gradient[3 * s->b[k] + c] += f;
        }
    }
    return energy;
}

#endif
