/* tests/bench/cholesky/solver.h - what the Cholesky benchmark asks of every solver, and the matrices it gives them. */
#ifndef BENCH_CHOLESKY_SOLVER_H
#define BENCH_CHOLESKY_SOLVER_H

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

/* A = diag(m) + L, m = 1, L the weighted Laplacian of all pairs of lattice points closer than the horizon. As in
   peri_matrix: the diagonal apart, both halves stored, columns ascending. */
typedef struct problem {
    int n;
    int *row, *col;
    double *value, *diagonal;
    double *xyz; /* 3 n, in spacings */
} problem;

enum { CUBE, BALL, BEAM, SHEET };

/* About `count` points, numbered along x first: a cube, a ball, a beam of 8:1:1 or a square sheet of one layer. The
   values are left to problem_set. */
void problem_create(problem *p, int shape, int count, double horizon);

/* Weights of 1 +- 10 %, a hash of the pair, scaled so that the stiffness of a row, its sum, has the mean kappa. */
void problem_set(problem *p, double kappa);

/* r = b - A x, 3 right-hand sides side by side. Returns the largest of their |r| / |b|; 1e30: one is not finite. */
double problem_residual(const problem *p, const double *b, const double *x, double *r);

void problem_destroy(problem *p);

/* What is known after analyse (bytes: after factor). */
typedef struct facts {
    double entries;    /* of L, without the zeros that supernodes may store */
    double operations; /* sum of the squares of L's column lengths */
    double bytes;
} facts;

/* A solver. Only analyse, factor and solve are timed; the others carry numbers between the benchmark's arrays and
   those that the solver likes best. */
typedef struct solver {
    const char *name, *precision;
    int method;                                  /* which ordering and so on, for open */
    void *(*open)(int method, const problem *p); /* of p, values and all */
    int (*analyse)(void *state);                 /* 0: it failed */
    void (*load)(void *state, const problem *p); /* copies the values */
    int (*factor)(void *state);                  /* 0: it failed */
    void (*set)(void *state, const double *b);   /* b: 3 n, right-hand sides side by side */
    void (*solve)(void *state);
    void (*get)(const void *state, double *x);
    facts (*ask)(const void *state);
    void (*close)(void *state);
} solver;

extern const solver bench_peri_double, bench_peri_float, bench_peri_double_degree;
extern const solver bench_cholmod_metis, bench_cholmod_amd, bench_cholmod_simplicial;
extern const solver bench_eigen_llt;

/* Gives CHOLMOD the fastest kernels and one thread of OpenBLAS; returns what its BLAS says of itself. An OpenBLAS older
   than the processor takes kernels without AVX, half as fast, and reads its environment only at the program's start:
   so this starts the program anew unless OPENBLAS_CORETYPE is set. Call it before all else. */
const char *bench_cholmod_begin(char **argv);

#ifdef __cplusplus
}
#endif
#endif
