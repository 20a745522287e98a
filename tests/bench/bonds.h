/* tests/bench/bonds.h - what the benchmarks of the hot loops share: a shaken block in one of the layouts, single passes
   over its bonds, its matrix and its preconditioners. Include it after peri.h (with PERI_IMPLEMENTATION): it reaches
   into the library. */
#ifndef PERI_BENCH_BONDS_H
#define PERI_BENCH_BONDS_H

#include "bench.h"

enum { SCALAR, LOCKSTEP, LATTICE, LAYOUTS };
BENCH_MAY const char *const layout_name[LAYOUTS] = {"scalar", "lockstep", "lattice"};

typedef struct bonds_scene {
    peri_world *w;
    peri__body *b;
    peri__pass p;
    peri_real *f;
    int layout;
    double create;      /* ms that peri_body_create took */
} bonds_scene;

/* n^3 particles on a lattice, in the layout asked for; 0 when it cannot be had. */
BENCH_MAY int bonds_make(bonds_scene *s, int n, double horizon, const peri_material *m, int layout) {
    peri_world_def wd = peri_default_world_def();
    peri_body_def bd = peri_default_body_def();
    int i, j, k, c = 0, count = n * n * n;
    peri_real *x = (peri_real *)malloc(3 * sizeof *x * (size_t)count);
    unsigned seed = 1;
    s->w = peri_world_create(&wd, NULL);
    bd.spacing = (peri_real)(1.0 / n);
    bd.horizon = (peri_real)horizon;
    if (horizon > 2) bd.kernel_power = 1;
    for (k = 0; k < n; k++)
        for (j = 0; j < n; j++)
            for (i = 0; i < n; i++, c++) {
                x[3 * c] = (peri_real)i * bd.spacing;
                x[3 * c + 1] = (peri_real)j * bd.spacing;
                x[3 * c + 2] = (peri_real)k * bd.spacing;
            }
    bd.points = x;
    bd.count = count;
    bd.material = peri_material_create(s->w, m);
    s->create = bench_thread();
    if (!peri_body_create(s->w, &bd).index1) return 0;
    s->create = bench_thread() - s->create;
    s->b = peri__body_at(s->w, 0);
    for (i = 0; i < 3 * count; i++) {
        seed = seed * 1664525u + 1013904223u;
        s->w->x[i] += 0.1 / n * ((seed >> 8) / 16777216.0 - 0.5);
    }
    if (layout == LOCKSTEP && peri__lanes_leave(s->w, s->b)) return 0;
    if (layout == SCALAR) s->b->lanes.blocks = 0;       /* reads what is laid out for lanes */
    s->f = x;
    s->layout = layout;
    peri__pass_begin(&s->p, s->w, s->b, x);
    if (layout != SCALAR && (!peri__lanes_place(s->w, s->b, s->p.x) || s->b->lanes.lattice != (layout == LATTICE)))
        return 0;
    return 1;
}

BENCH_MAY void bonds_unmake(bonds_scene *s) {
    free(s->f);
    peri_world_destroy(s->w);
}

static volatile double bonds_sink;

/* One pass: 0 local, 1 local with energy, 2 force, 3 positions into lanes, 4 a whole evaluation. */
BENCH_MAY void bonds_pass(bonds_scene *s, int kind) {
    peri__lanes *t = &s->b->lanes;
    int n = s->b->count;
    if (kind == 4) {
        bonds_sink = peri__pass_run(&s->p);
    } else if (kind == 3) {
        bonds_sink = peri__lanes_place(s->w, s->b, s->p.x);
    } else if (s->layout == SCALAR) {
        if (kind == 2) s->p.row->force(s->p.bonds, &s->b->matter, s->p.x, 0, n, peri__coef(s->w, s->b), s->f);
        else bonds_sink = s->p.row->local(s->p.bonds, &s->b->matter, s->p.x, 0, n, peri__coef(s->w, s->b), kind);
    } else {
        if (kind == 2) s->p.row->lanes_force(s->p.bonds, t, &s->b->matter, 0, t->blocks, s->f);
        else bonds_sink = s->p.row->lanes_local(s->p.bonds, t, &s->b->matter, 0, t->blocks, kind);
    }
}

/* ---- the matrix of a step, its preconditioners, vectors ---- */

enum { BENCH_SWEEPS = 12, BENCH_MEMORY = 5 };

typedef struct matrix_scene {
    bonds_scene s;
    peri_matrix a;
    peri_cholesky *factor;
    peri_two_level *levels;
    peri_lbfgs memory;
    peri_real *x, *y, *work;    /* 3 n, 3 n, 12 n */
} matrix_scene;

/* A block with the matrix of a step of 1/60 s. */
BENCH_MAY int matrix_make(matrix_scene *l, int n, peri_solver solver) {
    peri_material m = peri_material_neo_hookean(1e5f, 0.3f, 1000);
    size_t reals, i;
    memset(l, 0, sizeof *l);
    if (!bonds_make(&l->s, n, 1.75, &m, LATTICE)) return 0;
    l->s.w->def.solver = solver;
    if (peri_world_step(l->s.w, (peri_real)(1.0 / 60))) return printf("%s\n", peri_last_error(l->s.w)->text), 0;
    l->a = peri__matrix(l->s.b);
    if (l->s.b->factor) l->factor = l->s.b->factor->l, l->levels = l->s.b->factor->levels;
    reals = 3 * (size_t)l->a.n;
    l->x = (peri_real *)bench_obtain((6 + 2 * BENCH_MEMORY) * reals * sizeof(peri_real));
    l->y = l->x + reals;
    l->work = l->y + reals;
    for (i = 0; i < reals; i++) l->x[i] = (peri_real)(i % 17) - 8;
    peri_lbfgs_begin(&l->memory, (int)reals, BENCH_MEMORY, l->work + 4 * reals);
    for (i = 0; i < BENCH_MEMORY; i++) peri_lbfgs_push(&l->memory, NULL, l->x, l->x);
    return 1;
}

BENCH_MAY void matrix_unmake(matrix_scene *l) {
    free(l->x);
    bonds_unmake(&l->s);
}

BENCH_MAY void multiply_run(void *context) {
    matrix_scene *l = (matrix_scene *)context;
    peri_matrix_multiply3(&l->a, NULL, l->x, l->y);
}

BENCH_MAY void chebyshev_run(void *context) {
    matrix_scene *l = (matrix_scene *)context;
    peri_chebyshev3(&l->a, NULL, BENCH_SWEEPS, 0.1, 2, l->x, l->y, l->work);
}

BENCH_MAY void triangles_run(void *context) {
    matrix_scene *l = (matrix_scene *)context;
    memcpy(l->y, l->x, 3 * (size_t)l->a.n * sizeof *l->y);
    peri_cholesky_solve(l->factor, 3, l->y, l->work);
}

BENCH_MAY void transfer_run(void *context) {
    matrix_scene *l = (matrix_scene *)context;
    peri__levels q;
    q.t = l->levels;
    q.g = l->x;
    q.p = l->y;
    peri__gather_task(0, l->levels->parts, &q);
    peri__spread_task(0, l->levels->n, &q);
}

BENCH_MAY void levels_run(void *context) {
    matrix_scene *l = (matrix_scene *)context;
    peri_two_level_apply(l->x, l->y, l->levels);
}

BENCH_MAY void lbfgs_run(void *context) {
    matrix_scene *l = (matrix_scene *)context;
    peri_lbfgs_apply(&l->memory, NULL, l->x, l->y, l->work, NULL, NULL);
}

#endif
