/* tests/baseline/tets.h - linear tetrahedra with implicit Euler by Newton (newton.h), mass at the nodes. Included by
   baseline.h.

   St. Venant-Kirchhoff (Picinbono et al. 2003; the course of Sifakis and Barbic 2012). plain 0 is what programs do
   today: each tetrahedron's stiffness made definite (Teran et al. 2005), line search. plain 1 is the exact stiffness
   and whole steps. The law itself is lost either way where matter is compressed to 0.58 and below: its force goes down
   again, is zero for a flat tetrahedron, and a mirrored one is at rest.
   Corotated (Mueller and Gross 2004): warped stiffness R K R^T, rotation by SVD with det R = 1, so that an inverted
   tetrahedron finds back (Irving et al. 2004). One linear step, as in the paper, is max_iterations 1 and plain 1.

   A cell is cut into the six tetrahedra along the ways from its first corner to the opposite one. Linear tetrahedra are
   too stiff in bending, the more the fewer they are, and lock near Poisson's ratio 1/2. */
#ifndef PERI_BASELINE_TETS_H
#define PERI_BASELINE_TETS_H

typedef struct baseline__tets {
    baseline__newton newton;
    baseline__blocks stiffness;
    baseline__law *law;
    double mu, lambda, volume;          /* volume: of a tetrahedron */
    double gradient[6][12];             /* of the four shape functions, for each of the six kinds */
    int count, *node;                   /* 4 count; tetrahedron t is of kind t % 6 */
} baseline__tets;

/* Kind k goes from the corner along axis a, then b, then c. The nodes on its way are v0 .. v3; with xi in [0, 1]^3 the
   shape functions are 1 - xi_a, xi_a - xi_b, xi_b - xi_c, xi_c. */
static void baseline__tets_cut(baseline__tets *o, const baseline_def *def) {
    static const int way[6][3] = {{0, 1, 2}, {1, 2, 0}, {2, 0, 1}, {0, 2, 1}, {2, 1, 0}, {1, 0, 2}};
    int n[3], stride[3], k, a, i, j, l, *node = o->node;
    for (a = 0; a < 3; a++) n[a] = baseline__cells(def, a);
    stride[0] = 1;
    stride[1] = n[0] + 1;
    stride[2] = (n[0] + 1) * (n[1] + 1);
    memset(o->gradient, 0, sizeof o->gradient);
    for (k = 0; k < 6; k++)
        for (a = 0; a < 3; a++) {
            o->gradient[k][3 * a + way[k][a]] -= 1 / def->spacing;
            o->gradient[k][3 * (a + 1) + way[k][a]] += 1 / def->spacing;
        }
    for (l = 0; l < n[2]; l++)
        for (j = 0; j < n[1]; j++)
            for (i = 0; i < n[0]; i++)
                for (k = 0; k < 6; k++, node += 4) {
                    node[0] = i + stride[1] * j + stride[2] * l;
                    for (a = 0; a < 3; a++) node[a + 1] = node[a] + stride[way[k][a]];
                }
}

/* F of a tetrahedron: sum of x_a g_a^T. */
static void baseline__tet_map(const double *x, const int node[4], const double g[12], double f[9]) {
    int a, i, j;
    memset(f, 0, 9 * sizeof(double));
    for (a = 0; a < 4; a++)
        for (i = 0; i < 3; i++)
            for (j = 0; j < 3; j++) f[3 * i + j] += x[3 * node[a] + i] * g[3 * a + j];
}

static double baseline__tets_energy(baseline *b, const double *x, double *gradient) {
    const baseline__tets *o = (const baseline__tets *)b->own;
    double energy = 0, f[9], u[9], s[3], v[9], p[9];
    baseline__principal psi;
    int t, a, i;
    if (gradient) memset(gradient, 0, 3 * (size_t)b->count * sizeof(double));
    for (t = 0; t < o->count; t++) {
        const int *node = o->node + 4 * (size_t)t;
        const double *g = o->gradient[t % 6];
        baseline__tet_map(x, node, g, f);
        peri_svd3(f, u, s, v);
        o->law(s, o->mu, o->lambda, &psi);
        energy += o->volume * psi.energy;
        if (!gradient) continue;
        baseline__stress(u, v, psi.first, p);
        for (a = 0; a < 4; a++)
            for (i = 0; i < 3; i++)
                gradient[3 * node[a] + i] += o->volume * (p[3 * i] * g[3 * a] + p[3 * i + 1] * g[3 * a + 1] +
                                                          p[3 * i + 2] * g[3 * a + 2]);
    }
    return energy;
}

static void baseline__tets_linearise(baseline *b, const double *x, int definite) {
    baseline__tets *o = (baseline__tets *)b->own;
    double f[9], u[9], s[3], v[9], h[81], block[9];
    baseline__principal psi;
    int t, c, e;
    baseline__blocks_zero(&o->stiffness);
    for (t = 0; t < o->count; t++) {
        const int *node = o->node + 4 * (size_t)t;
        const double *g = o->gradient[t % 6];
        baseline__tet_map(x, node, g, f);
        peri_svd3(f, u, s, v);
        o->law(s, o->mu, o->lambda, &psi);
        if (definite) baseline__make_definite(&psi);
        baseline__tangent(u, v, &psi, h);
        for (c = 0; c < 4; c++)
            for (e = 0; e < 4; e++) {
                baseline__sandwich(h, o->volume, g + 3 * c, g + 3 * e, block);
                baseline__blocks_add(&o->stiffness, node[c], node[e], block);
            }
    }
}

static void baseline__tets_multiply(const baseline *b, const double *p, double *q) {
    baseline__blocks_multiply(&((const baseline__tets *)b->own)->stiffness, p, q);
}

static void baseline__tets_diagonal(const baseline *b, double *block) {
    baseline__blocks_diagonal(&((const baseline__tets *)b->own)->stiffness, block);
}

static const baseline__newton_methods baseline__tets_methods = {
    baseline__tets_energy, baseline__tets_linearise, baseline__tets_multiply, baseline__tets_diagonal};

/* Nodes share a tetrahedron when one comes after the other along every axis. */
static int baseline__tets_pattern(baseline__tets *o, const baseline *b) {
    int all = baseline__pairs(&b->def, 1, NULL, NULL), kept = 0, k, c, result;
    int *first = (int *)malloc((size_t)all * sizeof(int)), *second = (int *)malloc((size_t)all * sizeof(int));
    if (first && second) baseline__pairs(&b->def, 1, first, second);
    for (k = 0; first && second && k < all; k++) {
        int after = 1;
        for (c = 0; c < 3; c++) after &= b->rest[3 * second[k] + c] >= b->rest[3 * first[k] + c];
        first[kept] = first[k];
        second[kept] = second[k];
        kept += after;
    }
    result = !first || !second || baseline__blocks_create(&o->stiffness, 9, b->count, kept, first, second);
    free(first);
    free(second);
    return result;
}

static int baseline__tets_create(baseline *b) {
    baseline__tets *o = (baseline__tets *)calloc(1, sizeof *o);
    int k, t;
    if (!(b->own = o)) return 1;
    o->law = b->def.method == BASELINE_STVK ? baseline__stvk : baseline__corotated;
    o->count = 6 * baseline__cells(&b->def, 0) * baseline__cells(&b->def, 1) * baseline__cells(&b->def, 2);
    o->volume = b->def.spacing * b->def.spacing * b->def.spacing / 6;
    baseline__lame(&b->def, &o->mu, &o->lambda);
    if (!(o->node = (int *)malloc(4 * (size_t)o->count * sizeof(int)))) return 1;
    baseline__tets_cut(o, &b->def);
    memset(b->volume, 0, (size_t)b->count * sizeof(double));
    for (t = 0; t < 4 * o->count; t++) b->volume[o->node[t]] += o->volume / 4;
    for (k = 0; k < b->count; k++) b->mass[k] = b->def.density * b->volume[k];
    return baseline__newton_create(&o->newton, b, &baseline__tets_methods) || baseline__tets_pattern(o, b);
}

static void baseline__tets_destroy(baseline *b) {
    baseline__tets *o = (baseline__tets *)b->own;
    baseline__newton_destroy(&o->newton);
    baseline__blocks_destroy(&o->stiffness);
    free(o->node);
}

static int baseline__tets_step(baseline *b, double h) {
    return baseline__newton_run(&((baseline__tets *)b->own)->newton, b, h);
}

#endif
