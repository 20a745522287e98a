/* tests/bench/cholesky/cholmod.c - CHOLMOD for the Cholesky benchmark, set up in its own favour: the half of A that
   each method permutes with the least work, L L^T, vectors and workspace kept between solves, one ordering tried. */
#define _POSIX_C_SOURCE 200112L
#include "solver.h"
#include <dlfcn.h>
#include <stdlib.h>
#include <string.h>
#include <suitesparse/cholmod.h>
#include <unistd.h>

enum { SUPERNODAL_METIS, SUPERNODAL_AMD, SIMPLICIAL_AMD };

typedef struct state {
    int n;
    cholmod_common common;
    cholmod_sparse *a;
    cholmod_factor *l;
    cholmod_dense *b, *x, *y, *e;
} state;

/* A function of the program or its libraries, into *function; 0: there is none. Through memcpy, as C99 does not turn
   objects into functions. */
static int find(const char *name, void *function, size_t bytes) {
    void *at = dlsym(dlopen(NULL, RTLD_NOW), name);
    if (at) memcpy(function, &at, bytes);
    return at != NULL;
}

/* CHOLMOD's own loops take 4 threads of OpenMP, whatever else it is told: a clock of one thread misses work, and one
   that shares few cores waits, so that a factorisation takes twice as long. */
static void openmp_levels(int levels) {
    void (*set_levels)(int);
    if (find("omp_set_max_active_levels", &set_levels, sizeof set_levels)) set_levels(levels);
}

const char *bench_cholmod_begin(char **argv) {
    void (*set_threads)(int);
    char *(*config)(void);
    const char *core = NULL;
#if defined(__GNUC__) && (defined(__x86_64__) || defined(__i386__))
    if (__builtin_cpu_supports("avx2")) core = "Haswell";
    if (__builtin_cpu_supports("avx512dq")) core = "SkylakeX";
#endif
    if (core && !getenv("OPENBLAS_CORETYPE")) {
        setenv("OPENBLAS_CORETYPE", core, 1);
        execvp(argv[0], argv); /* returns only when it cannot: then OpenBLAS keeps its own choice */
    }
    if (!find("openblas_set_num_threads", &set_threads, sizeof set_threads))
        return "not OpenBLAS, so slower than it could be (libopenblas-dev), or with more threads than one";
    set_threads(1);
    return find("openblas_get_config", &config, sizeof config) ? config() : "OpenBLAS";
}

static void settings(cholmod_common *c, int method) {
    cholmod_start(c);
    c->print = 0;
    c->supernodal = method == SIMPLICIAL_AMD ? CHOLMOD_SIMPLICIAL : CHOLMOD_SUPERNODAL;
    c->final_ll = 1;
    c->nmethods = 1;
    c->method[0].ordering = method == SUPERNODAL_METIS ? CHOLMOD_METIS : CHOLMOD_AMD;
    c->postorder = 1;
}

static int put(cholmod_sparse *a, int at, int i, double value) {
    ((int *)a->i)[at] = i;
    ((double *)a->x)[at] = value;
    return at + 1;
}

/* Column i of the upper half is what stands left of the diagonal in row i, of the lower half what stands right. */
static void load(void *of, const problem *p) {
    cholmod_sparse *a = ((state *)of)->a;
    int i, k, at = 0, upper = a->stype > 0;
    for (i = 0; i < p->n; i++) {
        ((int *)a->p)[i] = at;
        if (!upper) at = put(a, at, i, p->diagonal[i]);
        for (k = p->row[i]; k < p->row[i + 1]; k++)
            if ((p->col[k] < i) == upper) at = put(a, at, p->col[k], p->value[k]);
        if (upper) at = put(a, at, i, p->diagonal[i]);
    }
    ((int *)a->p)[p->n] = at;
}

static void *start(int method, const problem *p) {
    state *s = (state *)calloc(1, sizeof *s);
    size_t n = (size_t)p->n, entries = n + (size_t)p->row[p->n] / 2;
    int half = method == SIMPLICIAL_AMD ? -1 : 1; /* the lower, the upper */
    if (!s) return NULL;
    s->n = p->n;
    openmp_levels(0);
    settings(&s->common, method);
    s->a = cholmod_allocate_sparse(n, n, entries, 1, 1, half, CHOLMOD_REAL, &s->common);
    s->b = cholmod_allocate_dense(n, 3, n, CHOLMOD_REAL, &s->common);
    if (!s->a || !s->b) return NULL;
    load(s, p);
    return s;
}

static int analyse(void *of) {
    state *s = (state *)of;
    s->l = cholmod_analyze(s->a, &s->common);
    return s->l != NULL;
}

static int factor(void *of) {
    state *s = (state *)of;
    return cholmod_factorize(s->a, s->l, &s->common) && s->common.status == CHOLMOD_OK;
}

static void set(void *of, const double *b) {
    state *s = (state *)of;
    double *to = (double *)s->b->x;
    int i, c;
    for (c = 0; c < 3; c++)
        for (i = 0; i < s->n; i++) to[(size_t)c * (size_t)s->n + (size_t)i] = b[3 * (size_t)i + (size_t)c];
}

static void solve(void *of) {
    state *s = (state *)of;
    cholmod_solve2(CHOLMOD_A, s->l, s->b, NULL, &s->x, NULL, &s->y, &s->e, &s->common);
}

static void get(const void *of, double *x) {
    const state *s = (const state *)of;
    const double *from = (const double *)s->x->x;
    int i, c;
    for (c = 0; c < 3; c++)
        for (i = 0; i < s->n; i++) x[3 * (size_t)i + (size_t)c] = from[(size_t)c * (size_t)s->n + (size_t)i];
}

/* Bytes of the factor's own arrays; those of cholmod_common, which every factorisation shares, are not counted. */
static double bytes_of(const cholmod_factor *l) {
    double n = (double)l->n, real = sizeof(double), index = sizeof(int);
    double both = 2 * n * index; /* Perm, ColCount */
    if (l->is_super)
        return both + (double)l->xsize * real + (double)l->ssize * index + 3 * ((double)l->nsuper + 1) * index;
    return both + (double)l->nzmax * (real + index) + (4 * n + 5) * index; /* p, nz, next, prev */
}

static facts ask(const void *of) {
    const state *s = (const state *)of;
    facts f;
    f.entries = s->common.lnz;
    f.operations = s->common.fl;
    f.bytes = bytes_of(s->l);
    return f;
}

static void stop(void *of) {
    state *s = (state *)of;
    cholmod_free_sparse(&s->a, &s->common);
    cholmod_free_factor(&s->l, &s->common);
    cholmod_free_dense(&s->b, &s->common);
    cholmod_free_dense(&s->x, &s->common);
    cholmod_free_dense(&s->y, &s->common);
    cholmod_free_dense(&s->e, &s->common);
    cholmod_finish(&s->common);
    openmp_levels(1);
    free(s);
}

#define SOLVER(name, method) \
    {name, "double", method, start, analyse, load, factor, set, solve, get, ask, stop}
const solver bench_cholmod_metis = SOLVER("CHOLMOD supernodal METIS", SUPERNODAL_METIS);
const solver bench_cholmod_amd = SOLVER("CHOLMOD supernodal AMD", SUPERNODAL_AMD);
const solver bench_cholmod_simplicial = SOLVER("CHOLMOD simplicial AMD", SIMPLICIAL_AMD);
