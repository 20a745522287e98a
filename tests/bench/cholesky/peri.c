/* tests/bench/cholesky/peri.c - peri's Cholesky for the benchmark. Compiled twice, without and with PERI_DOUBLE; all of
   peri is private to each of the two, so that one program holds both. */
#define PERI_STATIC
#define PERI_IMPLEMENTATION
#include "../../../peri_solver.h"
#include "../bench.h"
#include "solver.h"

enum { BY_POSITION, BY_DEGREE };

typedef struct state {
    int method;
    peri_matrix a;
    peri_real *value, *diagonal, *xyz, *x, *work;
    peri_cholesky *f;
} state;

static void *start(int method, const problem *p) {
    state *s = (state *)bench_obtain(sizeof *s);
    size_t n = (size_t)p->n, i;
    s->method = method;
    s->f = NULL;
    s->value = (peri_real *)bench_obtain(sizeof(peri_real) * (size_t)p->row[n]);
    s->diagonal = (peri_real *)bench_obtain(sizeof(peri_real) * n);
    s->xyz = (peri_real *)bench_obtain(sizeof(peri_real) * 6 * n);
    s->x = (peri_real *)bench_obtain(sizeof(peri_real) * 6 * n);
    s->work = (peri_real *)bench_obtain(sizeof(peri_real) * 6 * n);
    for (i = 0; i < 3 * n; i++) s->xyz[i] = (peri_real)p->xyz[i];
    s->a.n = p->n;
    s->a.row = p->row;
    s->a.col = p->col;
    s->a.value = s->value;
    s->a.diagonal = s->diagonal;
    return s;
}

static int complain(const peri_error *err) {
    printf("peri: %s\n", err->text);
    return 0;
}

static int analyse(void *of) {
    state *s = (state *)of;
    peri_error err;
    const peri_real *xyz = s->method == BY_POSITION ? s->xyz : NULL;
    return peri_cholesky_create(&s->a, xyz, NULL, &s->f, &err) == PERI_OK || complain(&err);
}

static void load(void *of, const problem *p) {
    state *s = (state *)of;
    int i;
    for (i = 0; i < p->row[p->n]; i++) s->value[i] = (peri_real)p->value[i];
    for (i = 0; i < p->n; i++) s->diagonal[i] = (peri_real)p->diagonal[i];
}

static int factor(void *of) {
    state *s = (state *)of;
    peri_error err;
    return peri_cholesky_factor(s->f, &s->a, &err) == PERI_OK || complain(&err);
}

static void set(void *of, const double *b) {
    state *s = (state *)of;
    size_t i;
    for (i = 0; i < 3 * (size_t)s->a.n; i++) s->x[i] = (peri_real)b[i];
}

static void solve(void *of) {
    state *s = (state *)of;
    peri_cholesky_solve(s->f, 3, s->x, s->work);
}

static void get(const void *of, double *x) {
    const state *s = (const state *)of;
    size_t i;
    for (i = 0; i < 3 * (size_t)s->a.n; i++) x[i] = (double)s->x[i];
}

static facts ask(const void *of) {
    const state *s = (const state *)of;
    facts f;
    f.entries = (double)peri_cholesky_entries(s->f);
    f.operations = peri_cholesky_operations(s->f);
    f.bytes = (double)peri_cholesky_bytes(s->f);
    return f;
}

static void stop(void *of) {
    state *s = (state *)of;
    peri_cholesky_destroy(s->f);
    free(s->value);
    free(s->diagonal);
    free(s->xyz);
    free(s->x);
    free(s->work);
    free(s);
}

#define SOLVER(name, precision, method) \
    {name, precision, method, start, analyse, load, factor, set, solve, get, ask, stop}
#ifdef PERI_DOUBLE
const solver bench_peri_double = SOLVER("peri", "double", BY_POSITION);
const solver bench_peri_double_degree = SOLVER("peri by degree", "double", BY_DEGREE);
#else
const solver bench_peri_float = SOLVER("peri", "float", BY_POSITION);
#endif
