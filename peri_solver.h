/* peri_solver.h - v0.3.0 - numbers: small algebra, sparse SPD solvers - MIT licence

   The first of peri's three floors. It knows nothing of physics: real numbers, 3x3 and 6x6 algebra, hooks for memory
   and threads, and solvers for A x = b with A symmetric positive definite, given as compressed rows. Alone it is a
   single-header sparse solver.

   USE
       #define PERI_IMPLEMENTATION      in ONE translation unit, before the include
       #include "peri_solver.h"

   QUICK START (three unknowns in a row; the lower triangle as triplets; one right-hand side)
       int i[] = {0, 1, 2, 1, 2}, j[] = {0, 1, 2, 0, 1};
       peri_real value[] = {2, 2, 2, -1, -1}, b[3] = {1, 0, 0}, work[6];
       peri_sparse *a = NULL;  peri_cholesky *f = NULL;  peri_error err;
       if (peri_sparse_from_triplets(3, 5, i, j, PERI_TRIANGLE_LOWER, NULL, &a, &err) == PERI_OK &&
           peri_sparse_set(a, value, &err) == PERI_OK &&
           peri_cholesky_create(peri_sparse_matrix(a), NULL, NULL, &f, &err) == PERI_OK &&
           peri_cholesky_factor(f, peri_sparse_matrix(a), &err) == PERI_OK)
           peri_cholesky_solve(f, 1, b, work);          (b now holds x = 3/4, 1/2, 1/4)
       peri_cholesky_destroy(f);

   or by conjugate gradients over an incomplete factor (every iterative solver is called like this)
       peri_real x[3] = {0}, room[12];     (12: peri_solve_work of 3 rows and one right-hand side)
       peri_iteration o = peri_default_iteration();
       peri_report report;  peri_incomplete *ic = NULL;
       if (peri_incomplete_create(peri_sparse_matrix(a), 1, NULL, &ic, &err) == PERI_OK &&
           peri_incomplete_factor(ic, peri_sparse_matrix(a), &err) == PERI_OK) {
           o.precondition = peri_incomplete_apply;
           o.context = ic;
           peri_solve_cg(peri_sparse_matrix(a), 1, b, x, room, &o, &report, &err);  (report: iterations, residual)
       }
       peri_incomplete_destroy(ic);
       peri_sparse_destroy(a);
   Values change, the pattern stays: peri_sparse_set and peri_cholesky_factor again. A few rows change:
   peri_cholesky_update. A guess is known, or double precision wanted of float: peri_cholesky_refine.

   DOES       sparse Cholesky with nested dissection or minimum degree, float or double; Jacobi, Jacobi + Chebyshev with
              the spectrum estimated, conjugate gradients over Jacobi, IC(0), polynomials, two levels or an old factor;
              L-BFGS over any preconditioner, line search, a minimiser of both; Anderson acceleration of fixed points;
              3x3 eigenvalues, SVD, polar; 6x6 inverse; reproducible log and exp.
   DOES NOT   handle unsymmetric or indefinite matrices (the failing pivot is reported); run on a GPU.

   OPTIONS (define before including, the same in every translation unit)
       PERI_DOUBLE         peri_real is double instead of float; checked at link time (one symbol is renamed)
       PERI_STATIC         every function is static: private to this translation unit
       PERI_ASSERT(x)      misuse checks; default assert(); the code stays safe when it is empty
       PERI_NO_CHOLESKY    leaves the Cholesky factorisation out of the binary

   MEMORY        only functions with a peri_allocator allocate (NULL: realloc and free), and only when they create.
                 Iterations work in what the caller passes; functions ending in _work say how much.
   THREADS       functions work on what they are passed; nothing is global. Calls on different objects may run at once.
                 Work is handed to peri_parallel in chunks whose bounds depend on the size alone.
   DETERMINISM   sums run over fixed blocks in a fixed order: the same bits for any number of threads. With
                 -ffp-contract=off also across compilers and optimisation levels of one architecture.
   ERRORS        functions that can fail return peri_result and fill a peri_error (may be NULL): code and one sentence.

   CONTENTS
       1  configuration, numbers, results
       2  hooks: memory, threads
       3  small algebra
       4  sparse matrices and iterative solvers
       5  sparse Cholesky
       6  L-BFGS
       7  line search, minimisation
       8  Anderson acceleration
       9  two-level preconditioner
       implementation in the same order

   HISTORY
       0.3.0  matrices from triplets; supernodal Cholesky in registers, threads, update, refinement; solvers with one
              calling convention, IC(0), line search, Anderson, two levels
       0.1.0  first version
*/
#ifndef PERI_SOLVER_H
#define PERI_SOLVER_H

#include <stddef.h>
#include <stdint.h>

/* ---- 1  configuration, numbers, results -------------------------------------------------------------------------- */

#define PERI_VERSION_MAJOR 0
#define PERI_VERSION_MINOR 3
#define PERI_VERSION_PATCH 0
#define PERI_VERSION "0.3.0"

#ifdef __cplusplus
#define PERI__EXTERN extern "C"
#else
#define PERI__EXTERN extern
#endif
#ifdef PERI_STATIC
#if defined(__GNUC__) || defined(__clang__)
#define PERI_DEF static __attribute__((unused))
#else
#define PERI_DEF static
#endif
#else
#define PERI_DEF PERI__EXTERN
#endif

#ifdef PERI_DOUBLE
typedef double peri_real;
/* A float caller linked with a double implementation must not link: one symbol of each floor differs. */
#define peri_world_create peri_world_create_double
#define peri_cholesky_create peri_cholesky_create_double
#define peri_sparse_set peri_sparse_set_double
#define peri_material_check peri_material_check_double
#else
typedef float peri_real;
#endif

/* What a function answers: 0 is success. */
typedef enum peri_result {
    PERI_OK = 0,
    PERI_ERROR_ARGUMENT,    /* null pointer, missing cookie, unknown enumerator */
    PERI_ERROR_VALUE,       /* NaN, infinity, or a number outside its range */
    PERI_ERROR_INDEX,       /* index outside its array */
    PERI_ERROR_ID,          /* id of something removed, or never made */
    PERI_ERROR_GEOMETRY,    /* open mesh, coincident points, empty body */
    PERI_ERROR_LIMIT,       /* a limit of the world's definition, or 32 bits, would be passed */
    PERI_ERROR_MEMORY,      /* the allocator returned nothing */
    PERI_ERROR_PIVOT,       /* the matrix is not positive definite */
    PERI_ERROR_NUMERIC,     /* a step met a number that is not finite */
    PERI_ERROR_CONVERGENCE  /* a step did not reach its tolerance and the world asks for that */
} peri_result;

/* Why a call failed: the code and one sentence that names the argument and its value, and the remedy. */
typedef struct peri_error {
    peri_result code;
    char text[240];
} peri_error;

typedef struct peri_vec3 {
    peri_real x, y, z;
} peri_vec3;

/* ---- 2  hooks: memory, threads ----------------------------------------------------------------------------------- */

/* Memory. realloc-like: ptr NULL allocates, new_bytes 0 frees (and returns NULL), old_bytes is what was asked for
   before. Must return memory aligned for double, or NULL. Called from the thread that calls peri, never from tasks. */
typedef struct peri_allocator {
    void *(*resize)(void *ptr, size_t old_bytes, size_t new_bytes, void *user);
    void *user;
} peri_allocator;

/* A piece of a loop: handles [begin, end). Pieces of one loop never write to the same place. */
typedef void peri_task(int begin, int end, void *context);

/* Threads. run must call task for consecutive pieces that cover [0, count), cut at multiples of grain, in any order
   and on any thread, and return when all are done. run NULL: OpenMP with `threads` threads where it is compiled in
   (threads 0: as many as OpenMP likes), else serial. */
typedef struct peri_parallel {
    void (*run)(int count, int grain, peri_task *task, void *context, void *user);
    void *user;
    int threads;
} peri_parallel;

/* Runs task over [0, count) in pieces of grain (the last one shorter). par NULL: serial. */
PERI_DEF void peri_parallel_for(const peri_parallel *par, int count, int grain, peri_task *task, void *context);

/* Sum of a[k]*b[k], k < n, in double, by fixed blocks: the same bits whatever the threads. */
PERI_DEF double peri_dot(const peri_parallel *par, int n, const peri_real *a, const peri_real *b);

/* ---- 3  small algebra (double: accuracy matters more than speed here) -------------------------------------------- */
/* 3x3 matrices are 9 doubles in rows. Symmetric ones are 6 in Voigt order: 00, 11, 22, 12, 02, 01. */

/* Natural logarithm, x > 0 and finite: the same bits under every libm. Error below 2 ulp. */
PERI_DEF double peri_log(double x);
/* Exponential, where the result is finite; in the same way. */
PERI_DEF double peri_exp(double x);

/* Determinant. */
PERI_DEF double peri_det3(const double a[9]);
/* Inverse times determinant: the cofactors, transposed. c may not alias a. */
PERI_DEF void peri_adjugate3(const double a[9], double c[9]);
/* c = a b. c may not alias a or b. */
PERI_DEF void peri_mul3(const double a[9], const double b[9], double c[9]);

/* Eigenvalues (ascending) and orthonormal eigenvectors (columns of v, right-handed) of a symmetric matrix in Voigt
   order, by cyclic Jacobi: always converges, also for repeated eigenvalues. */
PERI_DEF void peri_eigen3(const double s[6], double value[3], double v[9]);

/* Singular values of f = u diag(sigma) v^T with u and v rotations: sigma descending, the last one carries the sign of
   det f. Never fails, whatever the rank. */
PERI_DEF void peri_svd3(const double f[9], double u[9], double sigma[3], double v[9]);

/* Rotation closest to f: u v^T of peri_svd3. */
PERI_DEF void peri_polar3(const double f[9], double r[9]);

/* Inverse of a symmetric positive definite 6x6 matrix, packed by rows of its lower triangle (21 numbers), in place.
   Returns 0 and leaves m alone when the smallest pivot is below `relative` times the largest diagonal entry. */
PERI_DEF int peri_invert6(double m[21], double relative);

/* ---- 4  sparse matrices and iterative solvers -------------------------------------------------------------------- */

/* A symmetric matrix in compressed rows, its diagonal apart: row i holds value[k] in column col[k] for
   row[i] <= k < row[i+1], col[k] != i, columns ascending, both (i, j) and (j, i) stored. Vectors of a solve hold
   `rhs` right-hand sides side by side: x[rhs*i + c]. Everything belongs to the caller. */
typedef struct peri_matrix {
    int n;
    const int *row;             /* n + 1 */
    const int *col;             /* row[n] */
    const peri_real *value;     /* row[n] */
    const peri_real *diagonal;  /* n */
} peri_matrix;

/* y = A x for 3 right-hand sides (x, y: 3 n). y may not alias x. */
PERI_DEF void peri_matrix_multiply3(const peri_matrix *a, const peri_parallel *par, const peri_real *x, peri_real *y);

/* x = D^-1 b for 3 right-hand sides, D = diagonal of A: one Jacobi sweep from zero (PP, section 4.2). */
PERI_DEF void peri_jacobi3(const peri_matrix *a, const peri_parallel *par, const peri_real *b, peri_real *x);

/* x = p(D^-1 A) D^-1 b with the Chebyshev polynomial p of degree sweeps - 1 for eigenvalues of D^-1 A in [low, high]:
   Jacobi with Chebyshev acceleration from zero (PP, section 4.2 after Wang 2015). A fixed linear, symmetric and
   positive operator, so fit as a preconditioner. sweeps >= 1: it multiplies with A sweeps - 1 times, and shrinks what
   lies in [low, high], 0 <= low <= high, by 1 / T(sweeps, (high + low) / (high - low)), T the Chebyshev polynomial.
   For a diagonally dominant A, high = 2 is safe and low is at least the smallest (row sum / diagonal); a larger low
   spends the sweeps on the short waves. Eigenvalues above high are blown up. b, x: 3 n; work: 6 n. */
PERI_DEF void peri_chebyshev3(const peri_matrix *a, const peri_parallel *par, int sweeps, double low, double high,
                              const peri_real *b, peri_real *x, peri_real *work);

/* -- solvers of A x = b, all called in the same way -- */

/* A preconditioner: p = P^-1 g, linear, symmetric and positive. g may not alias p; both as long as the vectors of the
   solve that calls it, on whose thread it runs. Ready ones: peri_incomplete_apply, peri_polynomial_apply,
   peri_factor_apply. */
typedef void peri_precondition(const peri_real *g, peri_real *p, void *context);

/* Where the eigenvalues of D^-1 A lie. Zeroed, it says that nothing is known. Kept by the caller from solve to solve,
   it saves the estimate; a solve that finds it wrong, as after a change of A, corrects it. Zero it after a large
   change. */
typedef struct peri_spectrum {
    double low, high;               /* estimate; high 0: none yet */
    double bound_low, bound_high;   /* Gershgorin's circles: none lies outside; bound_low 0: who knows */
    int products;                   /* multiplications with A, one right-hand side each, spent on it so far */
} peri_spectrum;

/* How to iterate: peri_default_iteration(), then change what you need. */
typedef struct peri_iteration {
    uint32_t cookie;                /* set by peri_default_iteration */
    double tolerance;               /* >= 0; 1e-4, in double 1e-8. Linear: ends at |b - A x| <= tolerance |b|, all
                                       right-hand sides together; floats stall where |A| |x| is 1e7 times that.
                                       peri_minimise: the largest entry of the correction, in the unit of x */
    int max_iterations;             /* >= 0; 1000. 0: only the residual is evaluated */
    const peri_parallel *parallel;  /* NULL: serial */
    peri_precondition *precondition; /* of CG and peri_minimise; NULL: Jacobi (CG), none (peri_minimise) */
    void *context;                  /* of precondition */
    int flexible;                   /* CG: 1 for a preconditioner that is not quite linear, as one that iterates */
    peri_spectrum *spectrum;        /* Chebyshev: kept between solves; NULL: estimated in each */
    void (*watch)(int iteration, double residual, void *user); /* told of each iteration; NULL: nobody */
    void *user;                     /* of watch */
} peri_iteration;

/* What a call did. Filled whatever the result. */
typedef struct peri_report {
    peri_result result;     /* what the function returned */
    int iterations;         /* changes of x (linear, peri_minimise), trials (peri_line_search) */
    int restarts;           /* Chebyshev, Jacobi: another interval; CG: anew from the true residual; peri_minimise: its
                               memory was dropped */
    int fallbacks;          /* Chebyshev, Jacobi: 1 when it ended as CG */
    int evaluations;        /* multiplications with A (rhs at a time), or gradients */
    double residual;        /* |b - A x| / |b| of the x returned, in double; peri_minimise: |g| / |g at first| */
    double correction;      /* peri_minimise: largest entry of the last correction */
} peri_report;

/* Defaults as written above. */
PERI_DEF peri_iteration peri_default_iteration(void);

/* Reals of work that each solver below takes: 4 rhs n; 0 when an argument is negative or the product passes size_t. */
PERI_DEF size_t peri_solve_work(int n, int rhs);

/* One calling convention: solves A x = b from the first guess in x (in and out, rhs*n; b: rhs*n; rhs 1 to 3; work:
   peri_solve_work reals). Nothing is allocated. report and err may be NULL. Calls with different x and work may run at
   once. Errors, x unchanged: ARGUMENT (NULL, cookie, rhs), INDEX (pattern), VALUE (not finite), PIVOT (a diagonal entry
   is not positive), LIMIT. Errors, x the best so far: CONVERGENCE (max_iterations, or rounding allows no better; the
   text gives the residual), PIVOT (A or the preconditioner turns out not to be positive definite). Jacobi and Chebyshev
   return no residual larger than the first, weighted by D^-1; CG goes down in the energy of the error. */
typedef peri_result peri_solve(const peri_matrix *a, int rhs, const peri_real *b, peri_real *x, peri_real *work,
                               const peri_iteration *o, peri_report *report, peri_error *err);

/* Jacobi: x += D^-1 (b - A x). Where the residual grows (D^-1 A has eigenvalues above 2) it goes on damped, by a factor
   from Gershgorin's bound, and when that does not help either as CG. */
PERI_DEF peri_result peri_solve_jacobi(const peri_matrix *a, int rhs, const peri_real *b, peri_real *x, peri_real *work,
                                       const peri_iteration *o, peri_report *report, peri_error *err);

/* Jacobi with Chebyshev acceleration (Golub & Varga 1961; PP section 4.2 after Wang 2015), one pass over the matrix an
   iteration, the residual in double. The interval is o->spectrum, or estimated. Every 16 iterations the fall of the
   residual is held against theory: when it grows, x goes back and the interval is widened upwards, at last to
   Gershgorin's bound; when it falls too slowly, downwards, by the eigenvalue that explains the rate (after Manteuffel
   1977); when that does not help, it ends as CG. So it never diverges. */
PERI_DEF peri_result peri_solve_chebyshev(const peri_matrix *a, int rhs, const peri_real *b, peri_real *x,
                                          peri_real *work, const peri_iteration *o, peri_report *report,
                                          peri_error *err);

/* Preconditioned conjugate gradients (Hestenes & Stiefel 1952; Saad, algorithm 9.1): the right-hand sides make one long
   vector, so a preconditioner may couple them. Ends on the true residual, from which it starts anew when that differs
   from the one carried along. */
PERI_DEF peri_result peri_solve_cg(const peri_matrix *a, int rhs, const peri_real *b, peri_real *x, peri_real *work,
                                   const peri_iteration *o, peri_report *report, peri_error *err);

/* Estimates the interval by `steps` (1 to 64; 20 is good) steps of CG on a fixed random vector, whose coefficients are
   those of Lanczos (Saad, section 6.7.3), widened by 5 % and kept within Gershgorin's bound. The low end comes out too
   high where there are many small eigenvalues; the solver finds out. work: 4 n reals. Errors as of peri_solve. */
PERI_DEF peri_result peri_spectrum_estimate(peri_spectrum *s, const peri_matrix *a, int steps, peri_real *work,
                                            const peri_parallel *par, peri_error *err);

/* -- preconditioners -- */

/* peri_chebyshev3 for 1 to 3 right-hand sides as a preconditioner; the caller fills it. sweeps 1: Jacobi. */
typedef struct peri_polynomial {
    const peri_matrix *a;
    int rhs, sweeps;
    double low, high;               /* 0 <= low <= high > 0, as from peri_spectrum */
    const peri_parallel *parallel;  /* NULL: serial */
    peri_real *work;                /* 2 rhs n */
} peri_polynomial;

/* A peri_precondition; context: a peri_polynomial. */
PERI_DEF void peri_polynomial_apply(const peri_real *g, peri_real *p, void *polynomial);

/* Incomplete Cholesky factor without fill, IC(0) (Meijerink & van der Vorst 1977): A ~ L L', L on the lower pattern of
   A. A fifth of the iterations of Jacobi-CG on stiff lattices, for about the work of two multiplications each. */
typedef struct peri_incomplete peri_incomplete;

/* Allocates for the pattern of a, and for vectors of rhs (1 to 3) right-hand sides. memory NULL: realloc and free; it
   must outlive the factor. Errors: ARGUMENT, INDEX, LIMIT, MEMORY. */
PERI_DEF peri_result peri_incomplete_create(const peri_matrix *a, int rhs, const peri_allocator *memory,
                                            peri_incomplete **out, peri_error *err);

/* Computes L from the values of a, whose pattern must be that of create (else ARGUMENT); may be called again, allocates
   nothing. Where a pivot fails, which for matrices with positive entries beside the diagonal may happen though A is
   positive definite, it begins anew with A + shift D, shift 1e-3 and then four times as much each time (Manteuffel
   1980). Errors: VALUE (not finite), PIVOT (a diagonal entry is not positive). */
PERI_DEF peri_result peri_incomplete_factor(peri_incomplete *f, const peri_matrix *a, peri_error *err);

/* The shift that the last factorisation took; 0 is none. */
PERI_DEF double peri_incomplete_shift(const peri_incomplete *f);
/* Bytes held. */
PERI_DEF size_t peri_incomplete_bytes(const peri_incomplete *f);

/* p = (L L')^-1 g, a peri_precondition; context: the peri_incomplete, factored. Serial; only reads the factor, so
   several threads may apply one. */
PERI_DEF void peri_incomplete_apply(const peri_real *g, peri_real *p, void *incomplete);

/* Frees; NULL is fine. */
PERI_DEF void peri_incomplete_destroy(peri_incomplete *f);

/* ---- 5  sparse Cholesky ------------------------------------------------------------------------------------------ */

/* Which entries (i, j) off the diagonal a caller hands over; the others of the two are ignored. */
typedef enum peri_triangle {
    PERI_TRIANGLE_LOWER,    /* i > j */
    PERI_TRIANGLE_UPPER,    /* i < j */
    PERI_TRIANGLE_BOTH      /* each entry and its mirror image, which must have the same value */
} peri_triangle;

typedef struct peri_sparse peri_sparse;

/* The pattern of a symmetric matrix from `count` triplets: entry k stands at (i[k], j[k]), in any order; entries at the
   same place are added. memory NULL: realloc and free; it must outlive the matrix. Errors: ARGUMENT, INDEX, LIMIT
   (above 2^31 entries), MEMORY. */
PERI_DEF peri_result peri_sparse_from_triplets(int n, int count, const int *i, const int *j, peri_triangle triangle,
                                               const peri_allocator *memory, peri_sparse **out, peri_error *err);

/* The same from compressed columns (or, the matrix being symmetric, rows): entry k, start[j] <= k < start[j + 1],
   stands at (row[k], j). Rows of a column in any order. */
PERI_DEF peri_result peri_sparse_from_columns(int n, const int *start, const int *row, peri_triangle triangle,
                                              const peri_allocator *memory, peri_sparse **out, peri_error *err);

/* Sets the values, in the order of the entries that the pattern was made from; as often as wanted. VALUE: one is not
   finite, or (PERI_TRIANGLE_BOTH) two mirror images differ; the old values then stay. */
PERI_DEF peri_result peri_sparse_set(peri_sparse *s, const peri_real *value, peri_error *err);

/* The matrix, until s is destroyed; zero before peri_sparse_set. */
PERI_DEF const peri_matrix *peri_sparse_matrix(const peri_sparse *s);
/* Frees; NULL is fine. */
PERI_DEF void peri_sparse_destroy(peri_sparse *s);

#ifndef PERI_NO_CHOLESKY

typedef struct peri_cholesky peri_cholesky;

/* Analyses the pattern of a (values are not read): ordering, elimination tree, column counts. xyz: 3 n coordinates
   (nested dissection by position, leaves by minimum degree) or NULL (minimum degree on the graph). memory NULL: realloc
   and free; it must outlive the factor. Errors: ARGUMENT, INDEX (pattern), VALUE (a coordinate is not finite), LIMIT
   (factor beyond 2^31 entries), MEMORY. */
PERI_DEF peri_result peri_cholesky_create(const peri_matrix *a, const peri_real *xyz, const peri_allocator *memory,
                                          peri_cholesky **out, peri_error *err);

/* A factor for another matrix of the same pattern: shares the analysis of `other`, which may be destroyed first. Not
   while another thread creates or destroys one that shares it. */
PERI_DEF peri_result peri_cholesky_create_like(const peri_cholesky *other, const peri_allocator *memory,
                                               peri_cholesky **out, peri_error *err);

/* Lets factor and solve use threads (NULL: none, as at first); the same bits whatever their number. */
PERI_DEF void peri_cholesky_threads(peri_cholesky *f, const peri_parallel *par);

/* What the analysis alone says: entries of L and operations of a factorisation, without room for L. Errors as
   create. */
PERI_DEF peri_result peri_cholesky_estimate(const peri_matrix *a, const peri_real *xyz, const peri_allocator *memory,
                                            size_t *entries, double *operations, peri_error *err);

/* Computes L from the values of a, whose pattern must be the one analysed (else ARGUMENT); may be called again.
   PERI_ERROR_PIVOT names the first row whose pivot is not positive; the factor is then unusable until it succeeds. */
PERI_DEF peri_result peri_cholesky_factor(peri_cholesky *f, const peri_matrix *a, peri_error *err);

/* The same where only entries of the `count` rows named (and of their columns) have changed since the last success:
   computes only what depends on them. INDEX: a row outside [0, n). */
PERI_DEF peri_result peri_cholesky_update(peri_cholesky *f, const peri_matrix *a, int count, const int *rows,
                                          peri_error *err);

/* Overwrites x (rhs * n, in: b, out: the solution), any number of right-hand sides, three at a time. work: 2 * n *
   min(rhs, 3). Reads f only: may run at once on several threads with different x and work. */
PERI_DEF void peri_cholesky_solve(const peri_cholesky *f, int rhs, peri_real *x, peri_real *work);

/* One step of iterative refinement: x += solution of A y = b - A x, the residual in double. From a warm start a float
   factor leaves 1e-6 after one step and 1e-9 after two, up to conditions of about 1e5. work: n * (rhs + 2 min(rhs, 3)).
   Returns |b - A x| / |b| of the x passed in (of b = 0: |A x|); -1 when f is not ready. */
PERI_DEF double peri_cholesky_refine(const peri_cholesky *f, const peri_matrix *a, int rhs, const double *b, double *x,
                                     peri_real *work);

/* The row whose pivot was not positive, or -1. */
PERI_DEF int peri_cholesky_pivot(const peri_cholesky *f);
/* Entries of L, without the zeros that widen its columns. */
PERI_DEF size_t peri_cholesky_entries(const peri_cholesky *f);
/* Bytes held by the factor; what create_like shares counts for each. */
PERI_DEF size_t peri_cholesky_bytes(const peri_cholesky *f);

/* Multiplications and additions of one factorisation, counted from the pattern. */
PERI_DEF double peri_cholesky_operations(const peri_cholesky *f);

/* Frees; NULL is fine. */
PERI_DEF void peri_cholesky_destroy(peri_cholesky *f);

#endif

/* ---- 6  L-BFGS --------------------------------------------------------------------------------------------------- */
#define PERI_LBFGS_MAX 8

/* The memory of the last `m` steps; vectors belong to the caller: 2 * m * n reals. */
typedef struct peri_lbfgs {
    int n, m, used, head;
    peri_real *s, *y;           /* m vectors of n each */
    double rho[PERI_LBFGS_MAX];
} peri_lbfgs;

/* Starts with no memory. m at most PERI_LBFGS_MAX; m = 0 makes apply the bare preconditioner. */
PERI_DEF void peri_lbfgs_begin(peri_lbfgs *l, int n, int m, peri_real *vectors);

/* Remembers a step s and the change y of the gradient over it in place of the oldest pair, when s.y is clearly
   positive; else drops the pair, and with it the oldest one of a full memory. */
PERI_DEF void peri_lbfgs_push(peri_lbfgs *l, const peri_parallel *par, const peri_real *s, const peri_real *y);

/* p = -H g with H the two-loop recursion around the preconditioner (Nocedal 1980); precondition NULL: the identity.
   p may not alias g. work: n. */
PERI_DEF void peri_lbfgs_apply(const peri_lbfgs *l, const peri_parallel *par, const peri_real *g, peri_real *p,
                               peri_real *work, peri_precondition *precondition, void *context);

#ifndef PERI_NO_CHOLESKY
/* A Cholesky factor as a preconditioner, also one of an older matrix: after a few changes, as broken bonds, CG with it
   takes few iterations more than changes. The caller fills it. */
typedef struct peri_factor_use {
    const peri_cholesky *factor;
    int n, rhs;                     /* rows, right-hand sides (1 to 3) */
    peri_real *work;                /* 2 n rhs */
} peri_factor_use;

/* A peri_precondition; context: a peri_factor_use. */
PERI_DEF void peri_factor_apply(const peri_real *g, peri_real *p, void *factor_use);
#endif

/* ---- 7  line search, minimisation -------------------------------------------------------------------------------- */

/* What a search asks at a share of the step: *slope, the gradient there times the step; *energy, unless NULL. Returns 0
   where they are not defined (inverted, outside, not finite), which makes the search shrink. */
typedef int peri_trial(double share, double *slope, double *energy, void *context);

/* A function along a step: begins at share 0 with slope (< 0) and energy. */
typedef struct peri_line {
    peri_trial *trial;
    void *context;
    double slope, energy;
} peri_line;

/* How to search: peri_default_search(), then change what you need. */
typedef struct peri_search {
    uint32_t cookie;        /* set by peri_default_search */
    double first;           /* share that is tried first, > 0; 1 */
    double accept;          /* a share is taken when slope there <= accept |slope at 0|, 0 to 2; 0.9. Above 1 steps that
                               overshoot pass, which L-BFGS repairs and plain iterations do not */
    int energetic;          /* 1: and when the energy did not rise by more than noise; 0: slopes alone, which carry
                               through where rounding hides what a step gains, as with floats; 0 */
    double noise;           /* of the energy, in its unit; 0 */
    int max_trials;         /* 1 to 100; 14 */
} peri_search;

/* Defaults as written above. */
PERI_DEF peri_search peri_default_search(void);

/* Finds a share of a step that goes down, by slopes: takes the first share if it can, else shrinks to where the secant
   of the slopes has its zero, within 0.1 to 0.6 of the last share (0.5 where the energy alone is against it, 0.25 where
   the trial is not defined). The last trial was at the share returned. Errors, *share 0: ARGUMENT, VALUE (the line does
   not go down, or is not finite), CONVERGENCE (no share will do within max_trials). report: iterations are trials,
   residual is |slope| there over that at 0. */
PERI_DEF peri_result peri_line_search(const peri_line *line, double *share, const peri_search *o, peri_report *report,
                                      peri_error *err);

/* The gradient of what is to be minimised (x, g: n) and, unless NULL, its energy. Returns 0 where it is not defined. */
typedef int peri_gradient(const peri_real *x, peri_real *g, double *energy, void *context);

typedef struct peri_objective {
    int n;
    peri_gradient *gradient;
    void *context;
    int memory;             /* steps that L-BFGS remembers, 0 to PERI_LBFGS_MAX; 5 is good */
    peri_search search;
} peri_objective;

/* Reals of work that peri_minimise takes: (2 memory + 5) n; 0 when that is no size. */
PERI_DEF size_t peri_minimise_work(int n, int memory);

/* Minimises from the first guess in x (in and out, n) by L-BFGS over o->precondition, with a line search. Ends when no
   entry of the correction is larger than o->tolerance, or the gradient is zero. Nothing is allocated. Errors: ARGUMENT,
   VALUE (the gradient at the first guess is not defined or not finite); CONVERGENCE (max_iterations, or no share of the
   correction goes down) and PIVOT (the preconditioner is not positive), x the last accepted. */
PERI_DEF peri_result peri_minimise(const peri_objective *f, peri_real *x, peri_real *work, const peri_iteration *o,
                                   peri_report *report, peri_error *err);

/* ---- 8  Anderson acceleration ------------------------------------------------------------------------------------ */
#define PERI_ANDERSON_MAX 8

/* Of a fixed-point iteration x <- G(x), as local/global: from the last m + 1 images the combination whose changes
   G(x) - x cancel best (Anderson 1965, type II; Walker & Ni 2011). On a linear G it is GMRES (Walker & Ni, theorem
   2.2). Vectors belong to the caller: 2 (m + 1) n reals. */
typedef struct peri_anderson {
    int n, m, used, head;
    int started;                /* an image is there */
    int resets;                 /* how often the memory was dropped */
    double norm;                /* |G(x) - x| of the last push */
    peri_real *image, *change;  /* n each: G(x) and G(x) - x of the last push */
    peri_real *images, *changes; /* m vectors of n each: their differences */
    double gram[PERI_ANDERSON_MAX][PERI_ANDERSON_MAX], right[PERI_ANDERSON_MAX];
} peri_anderson;

/* Starts with no memory. m at most PERI_ANDERSON_MAX; 5 is good; m = 0: the plain iteration. */
PERI_DEF void peri_anderson_begin(peri_anderson *q, int n, int m, peri_real *vectors);

/* Tells of the image gx = G(x). Returns 1; or 0 when x, which came out of the acceleration, was worse than what went
   before (|G(x) - x| has doubled, or is not finite): then the memory is dropped, and the next apply gives the last good
   image, as if the plain iteration had been made. x, gx: n, in. */
PERI_DEF int peri_anderson_push(peri_anderson *q, const peri_parallel *par, const peri_real *x, const peri_real *gx);

/* x (n, out) is where to evaluate G next; gx of the last push may be given as x. */
PERI_DEF void peri_anderson_apply(const peri_anderson *q, const peri_parallel *par, peri_real *x);

#ifndef PERI_NO_CHOLESKY
/* ---- 9  two-level preconditioner --------------------------------------------------------------------------------- */

/* P^-1 = D^-1 + Q (Q^T A Q)^-1 Q^T: Jacobi for what changes from row to row, and a factor of the matrix of the nodes of
   a coarse grid for what is smooth (Q: rows between nodes are linear between them; Bramble, Pasciak & Xu 1990, with two
   levels). Against a full factor, in three dimensions, it takes up to a quarter more iterations, each a sixth of the
   time with 10 000 rows and a tenth with 25 000; making it takes a quarter and an eighth of the time, and a sixth and
   an eighth of the memory. */
typedef struct peri_two_level peri_two_level;

/* The nodes of a grid of side `cell` from the smallest coordinates of xyz (3 n) on, as far as rows are near: 3 spacings
   are good, 2 make the factor six times as large, 4 one fifth. It is for `rhs` right-hand sides, 1 to 3, and holds its
   own work: one thread at a time may apply it. memory NULL: realloc and free. Errors: ARGUMENT, INDEX (pattern), VALUE
   (a coordinate is not finite, cell not positive), LIMIT, MEMORY. */
PERI_DEF peri_result peri_two_level_create(const peri_matrix *a, const peri_real *xyz, double cell, int rhs,
                                           const peri_allocator *memory, peri_two_level **out, peri_error *err);

/* Takes the values of a, whose pattern must be that of create. Rows that store nothing but zeros stand by themselves.
   PIVOT: a diagonal entry is not positive, or the matrix of the nodes is not positive definite. */
PERI_DEF peri_result peri_two_level_factor(peri_two_level *t, const peri_matrix *a, peri_error *err);

/* Threads for apply and factor, as peri_cholesky_threads. */
PERI_DEF void peri_two_level_threads(peri_two_level *t, const peri_parallel *par);

/* A peri_precondition: p = P^-1 g; context: a peri_two_level. */
PERI_DEF void peri_two_level_apply(const peri_real *g, peri_real *p, void *two_level);

/* Nodes. */
PERI_DEF int peri_two_level_nodes(const peri_two_level *t);
/* Bytes held. */
PERI_DEF size_t peri_two_level_bytes(const peri_two_level *t);
/* Entries of the factor of the nodes. */
PERI_DEF size_t peri_two_level_entries(const peri_two_level *t);
/* Operations of making it. */
PERI_DEF double peri_two_level_operations(const peri_two_level *t);

/* Frees; NULL is fine. */
PERI_DEF void peri_two_level_destroy(peri_two_level *t);
#endif

#endif /* PERI_SOLVER_H */
/* Stop here if you only want the API. */

/* ================================================================================================================== */
#ifdef PERI_IMPLEMENTATION
#ifndef PERI_SOLVER_IMPLEMENTED
#define PERI_SOLVER_IMPLEMENTED

#include <limits.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#ifdef _OPENMP
#include <omp.h>
#endif
#ifndef PERI_ASSERT
#include <assert.h>
#define PERI_ASSERT(x) assert(x)
#endif

/* Helpers that the upper floors share may go unused here; PERI__RESTRICT tells that outputs do not overlap inputs. */
#if defined(__GNUC__) || defined(__clang__)
#define PERI__SHARED static __attribute__((unused))
#define PERI__FORMAT(a, b) __attribute__((format(printf, a, b)))
#define PERI__RESTRICT __restrict
#else
#define PERI__SHARED static
#define PERI__FORMAT(a, b)
#ifdef _MSC_VER
#define PERI__RESTRICT __restrict
#else
#define PERI__RESTRICT
#endif
#endif

/* ---- 1  results, numbers ----------------------------------------------------------------------------------------- */

PERI__SHARED peri_result peri__fail(peri_error *err, peri_result code, const char *format, ...) PERI__FORMAT(3, 4);

/* Fills err (when there is one) and returns the code. */
PERI__SHARED peri_result peri__fail(peri_error *err, peri_result code, const char *format, ...) {
    if (err) {
        va_list list;
        err->code = code;
        va_start(list, format);
        vsnprintf(err->text, sizeof err->text, format, list);
        va_end(list);
    }
    return code;
}

PERI__SHARED peri_result peri__succeed(peri_error *err) {
    if (err) {
        err->code = PERI_OK;
        err->text[0] = 0;
    }
    return PERI_OK;
}

static uint64_t peri__bits(double x) {
    uint64_t bits;
    memcpy(&bits, &x, sizeof bits);
    return bits;
}

static double peri__from_bits(uint64_t bits) {
    double x;
    memcpy(&x, &bits, sizeof x);
    return x;
}

/* By the exponent's bits, since -ffast-math lets a compiler assume x == x. */
PERI__SHARED int peri__finite(double x) { return (peri__bits(x) >> 52 & 0x7ff) != 0x7ff; }

/* ---- 2  hooks ---------------------------------------------------------------------------------------------------- */

PERI__SHARED void *peri__resize(const peri_allocator *memory, void *ptr, size_t old_bytes, size_t new_bytes) {
    if (memory && memory->resize) return memory->resize(ptr, old_bytes, new_bytes, memory->user);
    if (new_bytes) return realloc(ptr, new_bytes);
    free(ptr);
    return NULL;
}

/* *out = a b; 0 when that does not fit. */
PERI__SHARED int peri__mul_size(size_t a, size_t b, size_t *out) {
    *out = a * b;
    return b == 0 || a <= (size_t)-1 / b;
}

static void peri__piece(int piece, int count, int grain, peri_task *task, void *context) {
    int begin = piece * grain;
    task(begin, count - begin > grain ? begin + grain : count, context);
}

void peri_parallel_for(const peri_parallel *par, int count, int grain, peri_task *task, void *context) {
    int piece, pieces;
    if (grain < 1) grain = 1;
    pieces = count > 0 ? (count - 1) / grain + 1 : 0;
    if (par && pieces > 1) {
        if (par->run) {
            par->run(count, grain, task, context, par->user);
            return;
        }
#ifdef _OPENMP
        if (par->threads != 1) {
            int threads = par->threads > 0 ? par->threads : omp_get_max_threads();
#pragma omp parallel for schedule(static) num_threads(threads)
            for (piece = 0; piece < pieces; piece++) peri__piece(piece, count, grain, task, context);
            return;
        }
#endif
    }
    for (piece = 0; piece < pieces; piece++) peri__piece(piece, count, grain, task, context);
}

#define PERI__BLOCKS 64 /* partial sums of a dot product */
#define PERI__GRAIN 256 /* rows in a piece of a loop over a matrix */
#define PERI__RUN 4096  /* numbers in a piece of a loop over vectors, and the shortest block of a dot product */

/* Sixteen interleaved sums hide the latency of the addition and fill registers; their order is as fixed as that of one.
   Runs of sixteen: a length that compilers know is vectorised at plain -O2, too. */
static double peri__dot_run(int n, const peri_real *a, const peri_real *b) {
    double s[16] = {0};
    int i, k;
    for (i = 0; i + 15 < n; i += 16)
        for (k = 0; k < 16; k++) s[k] += (double)a[i + k] * (double)b[i + k];
    for (k = 0; i < n; i++, k++) s[k] += (double)a[i] * (double)b[i];
    for (i = 8; i > 0; i /= 2)
        for (k = 0; k < i; k++) s[k] += s[k + i];
    return s[0];
}

/* y = keep y + factor x. */
static void peri__combine_run(int n, double keep, peri_real *PERI__RESTRICT y, double factor,
                              const peri_real *PERI__RESTRICT x) {
    peri_real c = (peri_real)keep, f = (peri_real)factor;
    int i, k;
    for (i = 0; i + 15 < n; i += 16)
        for (k = 0; k < 16; k++) y[i + k] = c * y[i + k] + f * x[i + k];
    for (; i < n; i++) y[i] = c * y[i] + f * x[i];
}

/* A pass over vectors: y = keep y + factor x where there is an x, then the sum of y and z where there is a z. A block
   is still near when its sum is taken. */
typedef struct peri__vectors {
    int n, block;
    double keep, factor;
    const peri_real *x, *z;
    peri_real *y;
    double sum[PERI__BLOCKS];
} peri__vectors;

static void peri__vectors_run(int begin, int end, void *context) {
    peri__vectors *t = (peri__vectors *)context;
    int block;
    for (block = begin; block < end; block++) {
        ptrdiff_t at = (ptrdiff_t)block * t->block, left = t->n - at;
        int n = left < t->block ? (int)left : t->block;
        if (t->x) peri__combine_run(n, t->keep, t->y + at, t->factor, t->x + at);
        if (t->z) t->sum[block] = peri__dot_run(n, t->y + at, t->z + at);
    }
}

/* Numbers, or rows, in each of at most PERI__BLOCKS blocks, which depend on n alone. */
static int peri__block(int n, int least) {
    int block = (n - 1) / PERI__BLOCKS + 1;
    return block < least ? least : block;
}

static double peri__sum_blocks(const double *sum, int blocks) {
    double all = 0;
    int block;
    for (block = 0; block < blocks; block++) all += sum[block];
    return all;
}

/* y = keep y + factor x; returns y.z of the new y, in one pass. z NULL: no sum; z may be y. */
static double peri__combine_dot(const peri_parallel *par, int n, double keep, peri_real *y, double factor,
                                const peri_real *x, const peri_real *z) {
    peri__vectors t;
    int blocks;
    if (n <= 0) return 0;
    t.n = n;
    t.block = peri__block(n, PERI__RUN);
    t.keep = keep;
    t.factor = factor;
    t.x = x;
    t.y = y;
    t.z = z;
    blocks = (n - 1) / t.block + 1;
    peri_parallel_for(par, blocks, 1, peri__vectors_run, &t);
    return z ? peri__sum_blocks(t.sum, blocks) : 0;
}

double peri_dot(const peri_parallel *par, int n, const peri_real *a, const peri_real *b) {
    return peri__combine_dot(par, n, 1, (peri_real *)(uintptr_t)a, 0, NULL, b);
}

/* ---- 3  small algebra -------------------------------------------------------------------------------------------- */

/* ln 2 in two parts: the first has 33 bits, so a multiple by an exponent is exact (Cody & Waite 1980). */
#define PERI__LN2_HIGH 6.93147180369123816490e-01
#define PERI__LN2_LOW 1.90821492927058770002e-10
#define PERI__NAN 0x7ff8000000000000ULL
#define PERI__INFINITY 0x7ff0000000000000ULL

/* x = 2^k (1 + f) with 1 + f in [sqrt(1/2), sqrt 2]; log(1 + f) = 2 atanh(s), s = f / (2 + f), as the odd series in s.
   2 s is rewritten as f - f^2/2 + s f^2/2, so that the leading term f is exact (the arrangement of fdlibm).
   |s| < 0.172: ten terms leave less than 1e-18 of the result. */
double peri_log(double x) {
    static const double term[10] = {2.0 / 21, 2.0 / 19, 2.0 / 17, 2.0 / 15, 2.0 / 13,
                                    2.0 / 11, 2.0 / 9,  2.0 / 7,  2.0 / 5,  2.0 / 3};
    double f, s, z, r = 0, half;
    uint64_t bits;
    int i, k = -1023;
    if (!(x > 0) || !peri__finite(x)) return peri__from_bits(PERI__NAN);
    if (peri__bits(x) >> 52 == 0) { /* subnormal */
        x *= 18014398509481984.0;
        k -= 54;
    }
    bits = peri__bits(x);
    k += (int)(bits >> 52);
    x = peri__from_bits((bits & 0x000fffffffffffffULL) | 0x3ff0000000000000ULL);
    if (x > 1.4142135623730951) {
        x *= 0.5;
        k++;
    }
    f = x - 1;
    s = f / (2 + f);
    z = s * s;
    for (i = 0; i < 10; i++) r = z * (term[i] + r);
    half = 0.5 * f * f;
    return k * PERI__LN2_HIGH - ((half - (s * (half + r) + k * PERI__LN2_LOW)) - f);
}

/* exp(x) = 2^k exp(r), |r| <= ln 2 / 2, Taylor to r^13: remainder below 5e-18. 2^k in two factors, since k reaches
   beyond the exponents of normal numbers. */
double peri_exp(double x) {
    static const double inverse_factorial[12] = {
        1.0 / 6227020800.0, 1.0 / 479001600.0, 1.0 / 39916800.0, 1.0 / 3628800.0, 1.0 / 362880.0, 1.0 / 40320.0,
        1.0 / 5040.0,       1.0 / 720.0,       1.0 / 120.0,      1.0 / 24.0,      1.0 / 6.0,      0.5};
    double high, low, r, p = 0;
    int i, k, first;
    if (x > 709.79) return peri__from_bits(PERI__INFINITY);
    if (x < -745.2) return 0;
    if (!peri__finite(x)) return x;
    k = (int)floor(x * 1.4426950408889634 + 0.5);
    high = x - k * PERI__LN2_HIGH;
    low = k * PERI__LN2_LOW;
    r = high - low;
    for (i = 0; i < 12; i++) p = p * r + inverse_factorial[i];
    p = 1 + (high + (r * r * p - low));
    first = k / 2;
    return p * peri__from_bits((uint64_t)(first + 1023) << 52) * peri__from_bits((uint64_t)(k - first + 1023) << 52);
}

void peri_adjugate3(const double a[9], double c[9]) {
    c[0] = a[4] * a[8] - a[5] * a[7];
    c[1] = a[2] * a[7] - a[1] * a[8];
    c[2] = a[1] * a[5] - a[2] * a[4];
    c[3] = a[5] * a[6] - a[3] * a[8];
    c[4] = a[0] * a[8] - a[2] * a[6];
    c[5] = a[2] * a[3] - a[0] * a[5];
    c[6] = a[3] * a[7] - a[4] * a[6];
    c[7] = a[1] * a[6] - a[0] * a[7];
    c[8] = a[0] * a[4] - a[1] * a[3];
}

double peri_det3(const double a[9]) {
    return a[0] * (a[4] * a[8] - a[5] * a[7]) + a[1] * (a[5] * a[6] - a[3] * a[8]) + a[2] * (a[3] * a[7] - a[4] * a[6]);
}

void peri_mul3(const double a[9], const double b[9], double c[9]) {
    int i, j;
    for (i = 0; i < 3; i++)
        for (j = 0; j < 3; j++) c[3 * i + j] = a[3 * i] * b[j] + a[3 * i + 1] * b[3 + j] + a[3 * i + 2] * b[6 + j];
}

/* Columns p and q of m, turned: (c p - s q, s p + c q). */
static void peri__turn(double m[9], int p, int q, double c, double s) {
    int i;
    for (i = 0; i < 9; i += 3) {
        double x = m[i + p], y = m[i + q];
        m[i + p] = c * x - s * y;
        m[i + q] = s * x + c * y;
    }
}

/* Cosine and sine of the Jacobi rotation that makes [a b; b d] diagonal; the tangent is the smaller root (Golub & Van
   Loan, section 8.5). */
static double peri__jacobi_angle(double a, double b, double d, double *c, double *s) {
    double theta = (d - a) / (2 * b), t = 1 / (fabs(theta) + sqrt(theta * theta + 1));
    if (theta < 0) t = -t;
    *c = 1 / sqrt(t * t + 1);
    *s = t * *c;
    return t;
}

/* Sorts value (ascending) with the columns of v, and of w when there is one. A quarter turn swaps two columns and
   keeps the determinant. */
static void peri__sort3(double value[3], double *v, double *w) {
    static const int pair[3] = {0, 1, 0};
    int i;
    for (i = 0; i < 3; i++) {
        int p = pair[i];
        double x = value[p];
        if (!(x > value[p + 1])) continue;
        value[p] = value[p + 1];
        value[p + 1] = x;
        peri__turn(v, p, p + 1, 0, 1);
        if (w) peri__turn(w, p, p + 1, 0, 1);
    }
}

static void peri__identity3(double m[9]) {
    int i;
    for (i = 0; i < 9; i++) m[i] = i % 4 == 0;
}

/* Sixteen sweeps are far more than quadratic convergence takes: they only bound the loop when there are NaNs. An
   entry below 2^-60 of its diagonal is nothing. */
void peri_eigen3(const double s[6], double value[3], double v[9]) {
    double a[9];
    int sweep, p, q, turned = 1, i;
    a[0] = s[0];
    a[4] = s[1];
    a[8] = s[2];
    a[5] = a[7] = s[3];
    a[2] = a[6] = s[4];
    a[1] = a[3] = s[5];
    peri__identity3(v);
    for (sweep = 0; sweep < 16 && turned; sweep++) {
        turned = 0;
        for (p = 0; p < 2; p++)
            for (q = p + 1; q < 3; q++) {
                int r = 3 - p - q;
                double b = a[3 * p + q], cosine, sine, t, x = a[3 * r + p], y = a[3 * r + q];
                if (fabs(b) <= 8.7e-19 * (fabs(a[4 * p]) + fabs(a[4 * q]))) continue;
                t = peri__jacobi_angle(a[4 * p], b, a[4 * q], &cosine, &sine);
                a[4 * p] -= t * b;
                a[4 * q] += t * b;
                a[3 * p + q] = a[3 * q + p] = 0;
                a[3 * r + p] = a[3 * p + r] = cosine * x - sine * y;
                a[3 * r + q] = a[3 * q + r] = sine * x + cosine * y;
                peri__turn(v, p, q, cosine, sine);
                turned = 1;
            }
    }
    for (i = 0; i < 3; i++) value[i] = a[4 * i];
    peri__sort3(value, v, NULL);
}

static double peri__column_dot(const double m[9], int p, int q) {
    return m[p] * m[q] + m[3 + p] * m[3 + q] + m[6 + p] * m[6 + q];
}

/* Turns pairs of columns of g (and of v) until they are orthogonal: one-sided Jacobi (Hestenes 1958; Demmel & Veselic
   1992 on its accuracy for small singular values). Columns shorter than 1e-145 count as zero: their squares would
   underflow. */
static void peri__orthogonalise(double g[9], double v[9]) {
    int sweep, p, q, turned = 1;
    for (sweep = 0; sweep < 24 && turned; sweep++) {
        turned = 0;
        for (p = 0; p < 2; p++)
            for (q = p + 1; q < 3; q++) {
                double a = peri__column_dot(g, p, p), b = peri__column_dot(g, p, q), d = peri__column_dot(g, q, q);
                double cosine, sine;
                if (a < 1e-290 || d < 1e-290 || fabs(b) <= 4e-16 * sqrt(a) * sqrt(d)) continue;
                peri__jacobi_angle(a, b, d, &cosine, &sine);
                peri__turn(g, p, q, cosine, sine);
                peri__turn(v, p, q, cosine, sine);
                turned = 1;
            }
    }
}

/* A unit vector across the unit vector a: a x e with e the axis that a leans to least. */
static void peri__across(const double a[3], double b[3]) {
    int i = fabs(a[0]) < fabs(a[1]) ? 0 : 1, j, k;
    double length;
    if (fabs(a[2]) < fabs(a[i])) i = 2;
    j = (i + 1) % 3;
    k = (i + 2) % 3;
    length = sqrt(a[j] * a[j] + a[k] * a[k]);
    b[i] = 0;
    b[j] = a[k] / length;
    b[k] = -a[j] / length;
}

/* Unit vectors u0 along column 0 of g, u1 along what column 1 has across u0, u2 = u0 x u1; any where a column is 0. */
static void peri__frame(const double g[9], double u[9]) {
    double a[3], b[3], length, along;
    int i;
    length = sqrt(peri__column_dot(g, 0, 0));
    for (i = 0; i < 3; i++) a[i] = length > 1e-145 ? g[3 * i] / length : (i == 0 ? 1.0 : 0.0);
    length = sqrt(peri__column_dot(g, 1, 1));
    if (length > 1e-145) {
        for (i = 0; i < 3; i++) b[i] = g[3 * i + 1] / length;
        along = a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        for (i = 0; i < 3; i++) b[i] -= along * a[i];
        length = sqrt(b[0] * b[0] + b[1] * b[1] + b[2] * b[2]);
        for (i = 0; i < 3; i++) b[i] /= length;
    } else {
        peri__across(a, b);
    }
    for (i = 0; i < 3; i++) {
        int j = (i + 1) % 3, k = (i + 2) % 3;
        u[3 * i] = a[i];
        u[3 * i + 1] = b[i];
        u[3 * i + 2] = a[j] * b[k] - a[k] * b[j];
    }
}

/* One-sided Jacobi: f v = g with orthogonal columns, whose lengths are the singular values; all turns, so det v = 1.
   The scale is a power of two, so dividing by it is exact. */
void peri_svd3(const double f[9], double u[9], double sigma[3], double v[9]) {
    double g[9], length[3], scale = 0;
    int i;
    peri__identity3(u);
    peri__identity3(v);
    sigma[0] = sigma[1] = sigma[2] = 0;
    for (i = 0; i < 9; i++) {
        if (!peri__finite(f[i])) sigma[0] = sigma[1] = sigma[2] = peri__from_bits(PERI__NAN);
        if (fabs(f[i]) > scale) scale = fabs(f[i]);
    }
    if (!(scale > 0) || !peri__finite(sigma[0])) return;
    if (peri__bits(scale) >> 52) scale = peri__from_bits(peri__bits(scale) >> 52 << 52);
    for (i = 0; i < 9; i++) g[i] = f[i] / scale;
    peri__orthogonalise(g, v);
    for (i = 0; i < 3; i++) length[i] = -sqrt(peri__column_dot(g, i, i));
    peri__sort3(length, v, g);
    peri__frame(g, u);
    for (i = 0; i < 3; i++) sigma[i] = scale * (u[i] * g[i] + u[3 + i] * g[3 + i] + u[6 + i] * g[6 + i]);
    if (sigma[1] > sigma[0]) sigma[1] = sigma[0]; /* equal but for rounding */
    if (fabs(sigma[2]) > sigma[1]) sigma[2] = sigma[2] > 0 ? sigma[1] : -sigma[1];
}

void peri_polar3(const double f[9], double r[9]) {
    double u[9], v[9], sigma[3];
    int i, j;
    peri_svd3(f, u, sigma, v);
    for (i = 0; i < 3; i++)
        for (j = 0; j < 3; j++)
            r[3 * i + j] = u[3 * i] * v[3 * j] + u[3 * i + 1] * v[3 * j + 1] + u[3 * i + 2] * v[3 * j + 2];
}

#define PERI__AT(i, j) ((i) * ((i) + 1) / 2 + (j)) /* packed lower triangle, j <= i */

/* m = L L^T, then K = L^-1 in place of L, then K^T K. */
int peri_invert6(double m[21], double relative) {
    double l[21], largest = 0;
    int i, j, k;
    for (i = 0; i < 6; i++)
        if (m[PERI__AT(i, i)] > largest) largest = m[PERI__AT(i, i)];
    for (i = 0; i < 6; i++)
        for (j = 0; j <= i; j++) {
            double x = m[PERI__AT(i, j)];
            for (k = 0; k < j; k++) x -= l[PERI__AT(i, k)] * l[PERI__AT(j, k)];
            if (j < i) {
                l[PERI__AT(i, j)] = x / l[PERI__AT(j, j)];
            } else {
                if (!(x > 0) || x < relative * largest || !peri__finite(x)) return 0;
                l[PERI__AT(i, i)] = sqrt(x);
            }
        }
    for (j = 0; j < 6; j++) {
        l[PERI__AT(j, j)] = 1 / l[PERI__AT(j, j)];
        for (i = j + 1; i < 6; i++) {
            double x = 0;
            for (k = j; k < i; k++) x -= l[PERI__AT(i, k)] * l[PERI__AT(k, j)];
            l[PERI__AT(i, j)] = x / l[PERI__AT(i, i)];
        }
    }
    for (i = 0; i < 6; i++)
        for (j = 0; j <= i; j++) {
            double x = 0;
            for (k = i; k < 6; k++) x += l[PERI__AT(k, i)] * l[PERI__AT(k, j)];
            m[PERI__AT(i, j)] = x;
        }
    return 1;
}

/* ---- 4  sparse matrices and iterative solvers -------------------------------------------------------------------- */

/* Row i of A x, summed in double whatever peri_real is: a residual is a small difference. */
static void peri__row3(const peri_matrix *a, const peri_real *PERI__RESTRICT x, int i, double y[3]) {
    const int *PERI__RESTRICT col = a->col;
    const peri_real *PERI__RESTRICT value = a->value, *z = x + 3 * (ptrdiff_t)i;
    double d = (double)a->diagonal[i], y0 = d * (double)z[0], y1 = d * (double)z[1], y2 = d * (double)z[2];
    int k, end = a->row[i + 1];
    for (k = a->row[i]; k < end; k++) {
        double v = (double)value[k];
        z = x + 3 * (ptrdiff_t)col[k];
        y0 += v * (double)z[0];
        y1 += v * (double)z[1];
        y2 += v * (double)z[2];
    }
    y[0] = y0;
    y[1] = y1;
    y[2] = y2;
}

static double peri__row1(const peri_matrix *a, int rhs, const peri_real *PERI__RESTRICT x, int i) {
    double y = (double)a->diagonal[i] * (double)x[rhs * (ptrdiff_t)i];
    int k, end = a->row[i + 1];
    for (k = a->row[i]; k < end; k++) y += (double)a->value[k] * (double)x[rhs * (ptrdiff_t)a->col[k]];
    return y;
}

static void peri__row_times(const peri_matrix *a, int rhs, const peri_real *x, int i, double y[3]) {
    int c;
    if (rhs == 3) {
        peri__row3(a, x, i, y);
        return;
    }
    for (c = 0; c < rhs; c++) y[c] = peri__row1(a, rhs, x + c, i);
}

/* A pass over the rows of a matrix; each of the functions below uses some of it. */
typedef struct peri__sweep {
    const peri_matrix *a;
    const peri_real *in, *b;
    peri_real *out, *residual, *step;
    double keep, add; /* step = keep step + add residual */
    int rhs, block;
    double sum[PERI__BLOCKS], scaled[PERI__BLOCKS];
} peri__sweep;

static void peri__sweep_begin(peri__sweep *t, const peri_matrix *a, int rhs) {
    memset(t, 0, offsetof(peri__sweep, sum));
    t->a = a;
    t->rhs = rhs;
    t->block = peri__block(a->n, PERI__GRAIN);
}

/* Runs task over the blocks, as which its sums are then added up in order. */
static void peri__sweep_blocks(const peri_parallel *par, peri__sweep *t, peri_task *task, double *sum, double *scaled) {
    int blocks = t->a->n > 0 ? (t->a->n - 1) / t->block + 1 : 0;
    peri_parallel_for(par, blocks, 1, task, t);
    if (sum) *sum = peri__sum_blocks(t->sum, blocks);
    if (scaled) *scaled = peri__sum_blocks(t->scaled, blocks);
}

static int peri__sweep_end(const peri__sweep *t, int block) {
    return t->a->n - block * t->block > t->block ? (block + 1) * t->block : t->a->n;
}

static void peri__multiply_rows(int begin, int end, void *context) {
    peri__sweep *t = (peri__sweep *)context;
    int i, c;
    for (i = begin; i < end; i++) {
        peri_real *out = t->out + 3 * (ptrdiff_t)i;
        double y[3];
        peri__row3(t->a, t->in, i, y);
        for (c = 0; c < 3; c++) out[c] = (peri_real)y[c];
    }
}

void peri_matrix_multiply3(const peri_matrix *a, const peri_parallel *par, const peri_real *x, peri_real *y) {
    peri__sweep t;
    PERI_ASSERT(a && (a->n == 0 || x != y));
    peri__sweep_begin(&t, a, 3);
    t.in = x;
    t.out = y;
    peri_parallel_for(par, a->n, PERI__GRAIN, peri__multiply_rows, &t);
}

static void peri__jacobi_rows(int begin, int end, void *context) {
    peri__sweep *t = (peri__sweep *)context;
    int i, c;
    for (i = begin; i < end; i++) {
        const peri_real *in = t->in + t->rhs * (ptrdiff_t)i;
        peri_real *out = t->out + t->rhs * (ptrdiff_t)i;
        double inverse = 1 / (double)t->a->diagonal[i];
        for (c = 0; c < t->rhs; c++) out[c] = (peri_real)((double)in[c] * inverse);
    }
}

static void peri__jacobi(const peri_matrix *a, int rhs, const peri_parallel *par, const peri_real *b, peri_real *x) {
    peri__sweep t;
    peri__sweep_begin(&t, a, rhs);
    t.in = b;
    t.out = x;
    peri_parallel_for(par, a->n, PERI__GRAIN, peri__jacobi_rows, &t);
}

void peri_jacobi3(const peri_matrix *a, const peri_parallel *par, const peri_real *b, peri_real *x) {
    PERI_ASSERT(a);
    peri__jacobi(a, 3, par, b, x);
}

/* -- Chebyshev's recurrence: Saad, "Iterative Methods for Sparse Linear Systems", algorithm 12.1, for D^-1 A: with
   theta and delta the middle and half the width of [low, high], rho' = 1 / (2 theta/delta - rho), step' = rho' rho step
   + (2 rho'/delta) residual. Written with f = 1 / (2 theta - delta rho), so that delta = 0 is
   plain damped Jacobi. -- */

typedef struct peri__recurrence {
    double theta, delta, rho, keep, add;
} peri__recurrence;

static void peri__recurrence_begin(peri__recurrence *c, double low, double high) {
    c->theta = 0.5 * (high + low);
    c->delta = 0.5 * (high - low);
    c->rho = c->delta / c->theta;
    c->keep = 0;
    c->add = 1 / c->theta;
}

static void peri__recurrence_next(peri__recurrence *c) {
    double f = 1 / (2 * c->theta - c->delta * c->rho);
    c->keep = c->delta * f * c->rho;
    c->add = 2 * f;
    c->rho = c->delta * f;
}

static void peri__chebyshev_residual(int begin, int end, void *context) {
    peri__sweep *t = (peri__sweep *)context;
    int i, c;
    for (i = begin; i < end; i++) {
        peri_real *r = t->residual + t->rhs * (ptrdiff_t)i;
        double y[3], inverse = 1 / (double)t->a->diagonal[i];
        peri__row_times(t->a, t->rhs, t->step, i, y);
        for (c = 0; c < t->rhs; c++) r[c] = (peri_real)((double)r[c] - y[c] * inverse);
    }
}

static void peri__chebyshev_step(int begin, int end, void *context) {
    peri__sweep *t = (peri__sweep *)context;
    ptrdiff_t i;
    for (i = t->rhs * (ptrdiff_t)begin; i < t->rhs * (ptrdiff_t)end; i++) {
        t->step[i] = (peri_real)(t->keep * (double)t->step[i] + t->add * (double)t->residual[i]);
        t->out[i] += t->step[i];
    }
}

static void peri__polynomial(const peri_polynomial *q, const peri_real *b, peri_real *x) {
    size_t n = (size_t)q->rhs * (size_t)q->a->n;
    peri__recurrence c;
    peri__sweep t;
    int sweep;
    peri__recurrence_begin(&c, q->low, q->high);
    peri__sweep_begin(&t, q->a, q->rhs);
    t.residual = q->work;
    t.step = q->work + n;
    t.out = x;
    peri__jacobi(q->a, q->rhs, q->parallel, b, t.residual);
    memset(x, 0, n * sizeof *x);
    memset(t.step, 0, n * sizeof *x);
    for (sweep = 0; sweep < q->sweeps; sweep++) {
        if (sweep > 0) {
            peri_parallel_for(q->parallel, q->a->n, PERI__GRAIN, peri__chebyshev_residual, &t);
            peri__recurrence_next(&c);
        }
        t.keep = c.keep;
        t.add = c.add;
        peri_parallel_for(q->parallel, q->a->n, PERI__GRAIN, peri__chebyshev_step, &t);
    }
}

void peri_chebyshev3(const peri_matrix *a, const peri_parallel *par, int sweeps, double low, double high,
                     const peri_real *b, peri_real *x, peri_real *work) {
    peri_polynomial q;
    PERI_ASSERT(a && sweeps >= 1 && low >= 0 && high >= low && high > 0);
    if (a->n <= 0) return;
    q.a = a;
    q.rhs = 3;
    q.sweeps = sweeps;
    q.low = low;
    q.high = high;
    q.parallel = par;
    q.work = work;
    peri__polynomial(&q, b, x);
}

void peri_polynomial_apply(const peri_real *g, peri_real *p, void *polynomial) {
    const peri_polynomial *q = (const peri_polynomial *)polynomial;
    PERI_ASSERT(q && q->a && q->rhs >= 1 && q->rhs <= 3 && q->sweeps >= 1 && q->low >= 0 && q->high >= q->low);
    PERI_ASSERT(q->high > 0);
    if (q->a->n > 0) peri__polynomial(q, g, p);
}

/* -- what the solvers have in common -- */

#define PERI__SOLVER_COOKIE 0x70657300u

peri_iteration peri_default_iteration(void) {
    peri_iteration o;
    memset(&o, 0, sizeof o);
    o.cookie = PERI__SOLVER_COOKIE + 1;
    o.tolerance = sizeof(peri_real) > 4 ? 1e-8 : 1e-4;
    o.max_iterations = 1000;
    return o;
}

size_t peri_solve_work(int n, int rhs) {
    size_t reals, bytes;
    if (n < 0 || rhs < 0 || !peri__mul_size((size_t)n, 4 * (size_t)rhs, &reals)) return 0;
    return peri__mul_size(reals, sizeof(peri_real), &bytes) ? reals : 0;
}

/* A call in progress. */
typedef struct peri__linear {
    const char *name;
    const peri_matrix *a;
    int rhs, n;             /* n: numbers in a vector, rhs times rows */
    const peri_real *b;
    peri_real *x, *work;
    const peri_iteration *o;
    peri_report *report;
    peri_error *err;
    double scale;           /* |b| */
    peri_report none;       /* where nobody asks for a report */
} peri__linear;

/* Rows and columns within bounds: what a loop over the matrix needs to be safe, and what finds typing errors. */
static peri_result peri__check_rows(const char *name, const peri_matrix *a, peri_error *err) {
    int i, k;
    if (!a) return peri__fail(err, PERI_ERROR_ARGUMENT, "%s: the matrix is NULL", name);
    if (a->n < 0) return peri__fail(err, PERI_ERROR_INDEX, "%s: n is %d; it must not be negative", name, a->n);
    if (a->n == 0) return PERI_OK;
    if (!a->row) return peri__fail(err, PERI_ERROR_ARGUMENT, "%s: row is NULL; it must hold n + 1 numbers", name);
    if (a->row[0] != 0) return peri__fail(err, PERI_ERROR_INDEX, "%s: row[0] is %d; it must be 0", name, a->row[0]);
    for (i = 0; i < a->n; i++)
        if (a->row[i + 1] < a->row[i])
            return peri__fail(err, PERI_ERROR_INDEX, "%s: row %d ends at %d, before it begins at %d", name, i,
                              a->row[i + 1], a->row[i]);
    if (!a->col && a->row[a->n] > 0)
        return peri__fail(err, PERI_ERROR_ARGUMENT, "%s: col is NULL; it must hold row[n] numbers", name);
    for (i = 0; i < a->n; i++)
        for (k = a->row[i]; k < a->row[i + 1]; k++) {
            int j = a->col[k];
            if (j < 0 || j >= a->n)
                return peri__fail(err, PERI_ERROR_INDEX, "%s: row %d stores column %d, outside [0, %d)", name, i, j,
                                  a->n);
            if (j == i)
                return peri__fail(err, PERI_ERROR_INDEX,
                                  "%s: row %d stores its diagonal, column %d; that belongs into diagonal", name, i, j);
            if (k > a->row[i] && j <= a->col[k - 1])
                return peri__fail(err, PERI_ERROR_INDEX,
                                  "%s: row %d stores column %d after column %d; columns must ascend", name, i, j,
                                  a->col[k - 1]);
        }
    return PERI_OK;
}

static peri_result peri__check_values(const char *name, const peri_matrix *a, peri_error *err) {
    int i, k;
    if (a->n == 0) return PERI_OK;
    if (!a->diagonal || (!a->value && a->row[a->n] > 0))
        return peri__fail(err, PERI_ERROR_ARGUMENT, "%s: the matrix has no %s", name,
                          a->diagonal ? "value" : "diagonal");
    for (i = 0; i < a->n; i++) {
        double d = (double)a->diagonal[i];
        if (!peri__finite(d)) return peri__fail(err, PERI_ERROR_VALUE, "%s: diagonal[%d] is not finite", name, i);
        if (!(d > 0))
            return peri__fail(err, PERI_ERROR_PIVOT,
                              "%s: diagonal[%d] is %g; a positive definite matrix has a positive diagonal", name, i, d);
        for (k = a->row[i]; k < a->row[i + 1]; k++)
            if (!peri__finite((double)a->value[k]))
                return peri__fail(err, PERI_ERROR_VALUE, "%s: value[%d], in row %d, is not finite", name, k, i);
    }
    return PERI_OK;
}

/* The norm in double, and refusal of what is not finite, or whose squares leave the range of double. */
static peri_result peri__check_vector(const char *name, const char *what, int n, const peri_real *x, double least,
                                      double *norm, peri_error *err) {
    double largest = 0;
    int i;
    if (!x && n > 0) return peri__fail(err, PERI_ERROR_ARGUMENT, "%s: %s is NULL", name, what);
    for (i = 0; i < n; i++) {
        if (!peri__finite((double)x[i]))
            return peri__fail(err, PERI_ERROR_VALUE, "%s: %s[%d] is not finite", name, what, i);
        if (fabs((double)x[i]) > largest) largest = fabs((double)x[i]);
    }
    if (largest > 1e140 || (largest > 0 && largest < least))
        return peri__fail(err, PERI_ERROR_VALUE, "%s: the largest entry of %s is %g; scale it into 1e-140 to 1e140",
                          name, what, largest);
    *norm = sqrt(peri_dot(NULL, n, x, x));
    return PERI_OK;
}

static peri_result peri__check_iteration(const char *name, const peri_iteration *o, peri_error *err) {
    if (!o || o->cookie != PERI__SOLVER_COOKIE + 1)
        return peri__fail(err, PERI_ERROR_ARGUMENT, "%s: the options %s", name,
                          o ? "do not come from peri_default_iteration()" : "are NULL; pass peri_default_iteration()");
    if (!(o->tolerance >= 0) || !peri__finite(o->tolerance))
        return peri__fail(err, PERI_ERROR_VALUE, "%s: tolerance is %g; it must be finite and not negative", name,
                          o->tolerance);
    if (o->max_iterations < 0)
        return peri__fail(err, PERI_ERROR_VALUE, "%s: max_iterations is %d; it must not be negative", name,
                          o->max_iterations);
    return PERI_OK;
}

/* Everything that can be refused before x is touched. */
static peri_result peri__linear_begin(peri__linear *s) {
    double ignored;
    peri_result bad;
    memset(s->report, 0, sizeof *s->report);
    bad = peri__check_iteration(s->name, s->o, s->err);
    if (!bad) bad = peri__check_rows(s->name, s->a, s->err);
    if (bad) return bad;
    if (s->rhs < 1 || s->rhs > 3)
        return peri__fail(s->err, PERI_ERROR_ARGUMENT, "%s: rhs is %d; it must be 1 to 3", s->name, s->rhs);
    if (s->a->n > 0x7fffffff / s->rhs)
        return peri__fail(s->err, PERI_ERROR_LIMIT, "%s: %d rows times %d right-hand sides pass 2^31", s->name, s->a->n,
                          s->rhs);
    s->n = s->rhs * s->a->n;
    if (s->n > 0 && !s->work) return peri__fail(s->err, PERI_ERROR_ARGUMENT, "%s: work is NULL", s->name);
    bad = peri__check_values(s->name, s->a, s->err);
    if (!bad) bad = peri__check_vector(s->name, "b", s->n, s->b, 1e-140, &s->scale, s->err);
    if (!bad) bad = peri__check_vector(s->name, "x", s->n, s->x, 0, &ignored, s->err);
    return bad;
}

static peri_result peri__stalled(const peri__linear *s, const char *why) {
    return peri__fail(s->err, PERI_ERROR_CONVERGENCE,
                      "%s: after %d iterations the residual is %.3g of b, not %.3g: %s", s->name, s->report->iterations,
                      s->report->residual, s->o->tolerance, why);
}

static const char *const peri__more = "raise max_iterations or tolerance";

static void peri__tell(const peri__linear *s, double residual) {
    if (s->o->watch) s->o->watch(s->report->iterations, residual, s->o->user);
}

/* -- conjugate gradients -- */

static void peri__cg_residual_rows(int begin, int end, void *context) {
    peri__sweep *t = (peri__sweep *)context;
    int block, i, c;
    for (block = begin; block < end; block++) {
        double sum = 0;
        for (i = block * t->block; i < peri__sweep_end(t, block); i++) {
            ptrdiff_t at = t->rhs * (ptrdiff_t)i;
            double y[3];
            peri__row_times(t->a, t->rhs, t->in, i, y);
            for (c = 0; c < t->rhs; c++) {
                double r = (double)t->b[at + c] - y[c];
                t->out[at + c] = (peri_real)r;
                sum += r * r;
            }
        }
        t->sum[block] = sum;
    }
}

/* out = b - A x; returns its norm. */
static double peri__cg_residual(const peri__linear *s, peri_real *out) {
    peri__sweep t;
    double sum;
    peri__sweep_begin(&t, s->a, s->rhs);
    t.in = s->x;
    t.b = s->b;
    t.out = out;
    peri__sweep_blocks(s->o->parallel, &t, peri__cg_residual_rows, &sum, NULL);
    s->report->evaluations++;
    return sqrt(sum);
}

static void peri__cg_product_rows(int begin, int end, void *context) {
    peri__sweep *t = (peri__sweep *)context;
    int block, i, c;
    for (block = begin; block < end; block++) {
        double sum = 0;
        for (i = block * t->block; i < peri__sweep_end(t, block); i++) {
            ptrdiff_t at = t->rhs * (ptrdiff_t)i;
            double y[3];
            peri__row_times(t->a, t->rhs, t->in, i, y);
            for (c = 0; c < t->rhs; c++) {
                t->out[at + c] = (peri_real)y[c];
                sum += y[c] * (double)t->in[at + c];
            }
        }
        t->sum[block] = sum;
    }
}

/* q = A p; returns p.q. */
static double peri__cg_product(const peri__linear *s, const peri_real *p, peri_real *q) {
    peri__sweep t;
    double sum;
    peri__sweep_begin(&t, s->a, s->rhs);
    t.in = p;
    t.out = q;
    peri__sweep_blocks(s->o->parallel, &t, peri__cg_product_rows, &sum, NULL);
    s->report->evaluations++;
    return sum;
}

/* z = P^-1 r; returns z.r. */
static double peri__preconditioned(const peri__linear *s, const peri_real *r, peri_real *z) {
    if (s->o->precondition)
        s->o->precondition(r, z, s->o->context);
    else
        peri__jacobi(s->a, s->rhs, s->o->parallel, r, z);
    return peri_dot(s->o->parallel, s->n, z, r);
}

static peri_result peri__indefinite(const peri__linear *s, const char *what, double value) {
    return peri__fail(s->err, PERI_ERROR_PIVOT,
                      "%s: in iteration %d %s is %g, not positive: the %s is not symmetric positive definite", s->name,
                      s->report->iterations + 1, what, value, what[0] == 'p' ? "matrix" : "preconditioner");
}

/* The coefficients of a run: they are those of Lanczos. */
typedef struct peri__lanczos {
    int count;
    double alpha[64], beta[64];
} peri__lanczos;

/* Iterates from r until the r carried along has the norm `target`, or the cap. x NULL: only for the coefficients. */
static peri_result peri__cg_run(peri__linear *s, double target, peri__lanczos *record) {
    const peri_parallel *par = s->o->parallel;
    peri_real *r = s->work, *z = r + s->n, *p = z + s->n, *q = p + s->n;
    double rz = peri__preconditioned(s, r, z), rr, pq, alpha, beta;
    memcpy(p, z, (size_t)s->n * sizeof *p);
    while (s->report->iterations < s->o->max_iterations) {
        if (!(rz > 0) || !peri__finite(rz)) return peri__indefinite(s, "r.P^-1 r", rz);
        pq = peri__cg_product(s, p, q);
        alpha = rz / pq;
        if (!(pq > 0) || !peri__finite(pq) || !peri__finite(alpha)) return peri__indefinite(s, "p.A p", pq);
        if (s->x) peri__combine_dot(par, s->n, 1, s->x, alpha, p, NULL);
        rr = peri__combine_dot(par, s->n, 1, r, -alpha, q, r);
        s->report->iterations++;
        if (s->x) peri__tell(s, sqrt(rr) / s->scale);
        if (record) record->alpha[record->count] = alpha;
        if (!(sqrt(rr) > target)) {
            if (record) record->beta[record->count++] = 0;
            break;
        }
        beta = peri__preconditioned(s, r, z) / rz;
        rz *= beta;
        if (s->o->flexible) beta = -alpha * peri_dot(par, s->n, z, q) / (rz / beta); /* Polak-Ribiere */
        if (record) record->beta[record->count++] = beta;
        peri__combine_dot(par, s->n, beta, p, 1, z, NULL);
    }
    return PERI_OK;
}

/* Runs until the true residual is small enough; a run that does not halve it was the last. */
static peri_result peri__cg(peri__linear *s) {
    double target = s->o->tolerance * s->scale, last = 0, norm, low;
    peri_result bad = PERI_OK;
    int run;
    for (run = 0;; run++) {
        norm = peri__cg_residual(s, s->work);
        s->report->residual = norm / s->scale;
        if (!peri__finite(norm)) return peri__indefinite(s, "p.A p", norm);
        if (norm <= target) return peri__succeed(s->err);
        if (bad) return bad;
        if (s->report->iterations >= s->o->max_iterations) return peri__stalled(s, peri__more);
        if (run > 0 && norm > 0.5 * last)
            return peri__stalled(s, "rounding allows no better: raise tolerance, or compile with PERI_DOUBLE");
        if (run > 0) s->report->restarts++;
        last = norm;
        /* no run can tell more than rounding lets it */
        low = 1e-2 * norm * (sizeof(peri_real) > 4 ? 1.1e-16 : 6e-8);
        bad = peri__cg_run(s, low > target ? low : target, NULL);
    }
}

/* b = 0 is solved by 0 to any tolerance. */
static peri_result peri__linear_run(peri__linear *s, peri_result (*run)(peri__linear *s)) {
    peri_result result;
    if (!s->report) s->report = &s->none;
    result = peri__linear_begin(s);
    if (!result && s->n > 0 && s->scale > 0) result = run(s);
    else if (!result) {
        if (s->n > 0) memset(s->x, 0, (size_t)s->n * sizeof *s->x);
        result = peri__succeed(s->err);
    }
    s->report->result = result;
    return result;
}

static void peri__linear_set(peri__linear *s, const char *name, const peri_matrix *a, int rhs, const peri_real *b) {
    memset(s, 0, sizeof *s);
    s->name = name;
    s->a = a;
    s->rhs = rhs;
    s->b = b;
}

peri_result peri_solve_cg(const peri_matrix *a, int rhs, const peri_real *b, peri_real *x, peri_real *work,
                          const peri_iteration *o, peri_report *report, peri_error *err) {
    peri__linear s;
    peri__linear_set(&s, "cg", a, rhs, b);
    s.x = x;
    s.work = work;
    s.o = o;
    s.report = report;
    s.err = err;
    return peri__linear_run(&s, peri__cg);
}

/* -- the interval of the eigenvalues of D^-1 A -- */

static void peri__gershgorin(const peri_matrix *a, peri_spectrum *s) {
    double largest = 0, sum;
    int i, k;
    for (i = 0; i < a->n; i++) {
        for (sum = 0, k = a->row[i]; k < a->row[i + 1]; k++) sum += fabs((double)a->value[k]);
        sum /= (double)a->diagonal[i];
        if (sum > largest) largest = sum;
    }
    s->bound_low = largest < 1 ? 1 - largest : 0;
    s->bound_high = 1 + largest;
}

/* How many eigenvalues of the tridiagonal matrix (d, e squared) lie below x: Sturm (Golub & Van Loan, section 8.4). */
static int peri__sturm(int n, const double *d, const double *e2, double x) {
    double q = 1;
    int i, below = 0;
    for (i = 0; i < n; i++) {
        q = d[i] - x - (i > 0 ? e2[i - 1] / q : 0);
        if (q == 0) q = 1e-300;
        below += q < 0;
    }
    return below;
}

/* The smallest (last 0) or largest eigenvalue, by bisection from [0, high]. */
static double peri__spectrum_extreme(int n, const double *d, const double *e2, double high, int last) {
    double low = 0;
    int i;
    for (i = 0; i < 60; i++) {
        double middle = 0.5 * (low + high);
        if (peri__sturm(n, d, e2, middle) > (last ? n - 1 : 0)) high = middle; else low = middle;
    }
    return 0.5 * (low + high);
}

/* T from the coefficients of CG: Saad, (6.103). */
static void peri__ritz(const peri__lanczos *c, peri_spectrum *s) {
    double d[64], e2[64], high = 2 * s->bound_high;
    int k;
    for (k = 0; k < c->count; k++) {
        d[k] = 1 / c->alpha[k] + (k > 0 ? c->beta[k - 1] / c->alpha[k - 1] : 0);
        e2[k] = c->beta[k] / (c->alpha[k] * c->alpha[k]);
    }
    s->low = 0.95 * peri__spectrum_extreme(c->count, d, e2, high, 0);
    s->high = 1.05 * peri__spectrum_extreme(c->count, d, e2, high, 1);
}

/* Keeps the estimate within what is certain, and in order. */
static void peri__spectrum_clamp(peri_spectrum *s) {
    if (!(s->high < s->bound_high)) s->high = s->bound_high;
    if (!(s->low > s->bound_low)) s->low = s->bound_low;
    if (!(s->low > 1e-9 * s->high)) s->low = 1e-9 * s->high;
    if (s->low > s->high) s->low = s->high;
}

static peri_result peri__spectrum_run(peri_spectrum *s, const peri_matrix *a, int steps, peri_real *work,
                                  const peri_parallel *par, peri_error *err) {
    peri_iteration o = peri_default_iteration();
    peri_report report;
    peri__lanczos record;
    peri__linear run;
    peri_result bad;
    uint32_t seed = 12345;
    int i;
    peri__gershgorin(a, s);
    for (i = 0; i < a->n; i++) { /* Numerical Recipes' generator, in (-1, 1), scaled so that all rows weigh the same */
        seed = seed * 1664525u + 1013904223u;
        work[i] = (peri_real)(((double)(seed >> 8) / 8388608.0 - 1) * sqrt((double)a->diagonal[i]));
    }
    memset(&report, 0, sizeof report);
    record.count = 0;
    o.max_iterations = steps;
    o.parallel = par;
    peri__linear_set(&run, "spectrum", a, 1, NULL);
    run.n = a->n;
    run.work = work;
    run.o = &o;
    run.report = &report;
    run.err = err;
    bad = peri__cg_run(&run, (sizeof(peri_real) > 4 ? 1e-12 : 1e-5) * sqrt(peri_dot(par, a->n, work, work)), &record);
    s->products += report.evaluations;
    if (bad) return bad;
    peri__ritz(&record, s);
    peri__spectrum_clamp(s);
    return PERI_OK;
}

peri_result peri_spectrum_estimate(peri_spectrum *s, const peri_matrix *a, int steps, peri_real *work,
                                   const peri_parallel *par, peri_error *err) {
    peri_result bad = peri__check_rows("spectrum", a, err);
    if (!bad) bad = peri__check_values("spectrum", a, err);
    if (bad) return bad;
    if (!s || (!work && a->n > 0))
        return peri__fail(err, PERI_ERROR_ARGUMENT, "spectrum: %s is NULL", s ? "work" : "the spectrum");
    if (steps < 1 || steps > 64)
        return peri__fail(err, PERI_ERROR_VALUE, "spectrum: steps is %d; it must be 1 to 64", steps);
    if (a->n > 0) bad = peri__spectrum_run(s, a, steps, work, par, err);
    return bad ? bad : peri__succeed(err);
}

/* -- Jacobi and Chebyshev -- */

#define PERI__CYCLE 16 /* iterations between looks at the rate */

/* r = b - A x, step = keep step + add D^-1 r, out = x + step, in one pass. Sums |r|^2, and r.D^-1 r: in that norm the
   method obeys its polynomial whatever the diagonal. */
static void peri__relax_rows(int begin, int end, void *context) {
    peri__sweep *t = (peri__sweep *)context;
    int block, i, c;
    for (block = begin; block < end; block++) {
        double sum = 0, scaled = 0;
        for (i = block * t->block; i < peri__sweep_end(t, block); i++) {
            ptrdiff_t at = t->rhs * (ptrdiff_t)i;
            double y[3], inverse = 1 / (double)t->a->diagonal[i], square = 0;
            peri__row_times(t->a, t->rhs, t->in, i, y);
            for (c = 0; c < t->rhs; c++) {
                double r = (double)t->b[at + c] - y[c];
                square += r * r;
                t->step[at + c] = (peri_real)(t->keep * (double)t->step[at + c] + t->add * (r * inverse));
                t->out[at + c] = (peri_real)((double)t->in[at + c] + (double)t->step[at + c]);
            }
            sum += square;
            scaled += square * inverse;
        }
        t->sum[block] = sum;
        t->scaled[block] = scaled;
    }
}

typedef struct peri__relax {
    peri__linear *s;
    peri_spectrum *spectrum;
    peri__recurrence c;
    peri__sweep t;
    peri_real *now, *next, *step, *best;
    int accelerate;
    int age;                        /* iterations since the recurrence began */
    int widened, lowered, slow;
    double start, mark, least;      /* |r| in D^-1: when it began, at the last look, of `best` */
    double least_residual;
} peri__relax;

static void peri__relax_begin(peri__relax *k) {
    peri__recurrence_begin(&k->c, k->spectrum->low, k->spectrum->high);
    k->age = 0;
    memset(k->step, 0, (size_t)k->s->n * sizeof *k->step);
}

static void peri__relax_swap(peri__relax *k) {
    peri_real *now = k->now;
    k->now = k->next;
    k->next = now;
}

/* log of the decay that theory promises for each iteration, and the eigenvalue on this side of the interval that goes
   down by only e^-rate (for rate below 0: grows): T(n, y) ~ exp(n acosh y) / 2 on both. */
static double peri__acosh(double y) { return y > 1 ? peri_log(y + sqrt(y * y - 1)) : 0; }

static double peri__relax_decay(const peri__relax *k) {
    return k->c.delta > 0 ? peri__acosh(k->c.theta / k->c.delta) : 700;
}

static double peri__relax_culprit(const peri__relax *k, double rate, int side) {
    double e, grown = peri_exp(-rate);
    if (!(k->c.delta > 0)) return k->c.theta * (1 + side * grown);
    e = peri__relax_decay(k) - rate;
    e = peri_exp(e > 0 ? e : 0);
    return k->c.theta + side * k->c.delta * 0.5 * (e + 1 / e);
}

/* Something above the interval grows: go back to the best x and widen. 0 when the interval is already certain. */
static int peri__relax_widen(peri__relax *k, double rate) {
    peri_spectrum *q = k->spectrum;
    double high = peri__relax_culprit(k, rate, 1), was = q->high;
    peri__gershgorin(k->s->a, q);
    if (!(was < 0.999 * q->bound_high) || k->widened > (k->accelerate ? 4 : 0)) return 0;
    if (!(high > 1.1 * was)) high = 1.1 * was;
    q->high = ++k->widened < 3 && peri__finite(high) ? 1.05 * high : q->bound_high;
    if (k->accelerate) {
        peri__spectrum_clamp(q);
    } else {
        q->low = q->high = 0.55 * q->bound_high; /* damped: no eigenvalue's error shrinks by less than 1 - 1/0.55 */
    }
    memcpy(k->now, k->best, (size_t)k->s->n * sizeof *k->now);
    k->s->report->restarts++;
    peri__relax_begin(k);
    return 1;
}

/* It falls too slowly: something below the interval, by the rate that is seen. */
static int peri__relax_lower(peri__relax *k, double rate) {
    double low = 0.9 * peri__relax_culprit(k, rate, -1);
    if (!k->accelerate || k->lowered >= 8 || k->age < 2 * PERI__CYCLE) return 0;
    if (!(low > 0)) low = 0.1 * k->spectrum->low;
    if (low < k->spectrum->bound_low) low = k->spectrum->bound_low;
    if (!(low < 0.8 * k->spectrum->low)) return 0;
    k->lowered++;
    k->spectrum->low = low;
    peri__spectrum_clamp(k->spectrum);
    k->s->report->restarts++;
    peri__relax_begin(k);
    return 1;
}

/* Looks at the rate, norm being |r| in D^-1. 0: give up. */
static int peri__relax_look(peri__relax *k, double norm, double residual) {
    int cycle = k->age % PERI__CYCLE ? k->age % PERI__CYCLE : PERI__CYCLE, grew = !peri__finite(norm);
    double rate = norm > 0 && !grew ? peri_log(k->mark / norm) / cycle : -700, bound;
    if (k->age == 0) {
        k->start = k->mark = norm;
        if (norm < k->least || k->least < 0) {
            memcpy(k->best, k->now, (size_t)k->s->n * sizeof *k->now);
            k->least = norm;
            k->least_residual = residual;
        }
        return !grew;
    }
    /* inside the interval 2 exp(-age decay) of the start is the most that may be left; below it all only goes down */
    bound = 2 * peri_exp(-k->age * peri__relax_decay(k)) * k->start;
    if (norm > 1.5 * k->start) grew = 1;
    if (k->age % PERI__CYCLE == 0 && norm > 1.05 * k->mark && norm > 1.05 * bound) grew = 1;
    if (grew) return peri__relax_widen(k, rate);
    if (k->age % PERI__CYCLE) return 1;
    if (norm < k->least) {
        memcpy(k->best, k->now, (size_t)k->s->n * sizeof *k->now);
        k->least = norm;
        k->least_residual = residual;
    }
    k->slow = norm > 0.9999 * k->mark ? k->slow + 1 : 0;
    if (k->slow > 3) return 0;
    if (rate < 0.8 * peri__relax_decay(k) && norm > bound) peri__relax_lower(k, rate);
    k->mark = norm;
    return 1;
}

/* x is what the residual is of. */
static void peri__relax_keep(peri__relax *k, const peri_real *x, double residual) {
    if (x != k->s->x) memcpy(k->s->x, x, (size_t)k->s->n * sizeof *x);
    k->s->report->residual = residual;
}

static peri_result peri__relax_run(peri__relax *k) {
    peri__linear *s = k->s;
    double sum, scaled, residual;
    k->least = -1;
    memcpy(k->best, k->now, (size_t)s->n * sizeof *k->now);
    peri__sweep_begin(&k->t, s->a, s->rhs);
    peri__relax_begin(k);
    for (;;) {
        int age = k->age;
        k->t.in = k->now;
        k->t.b = s->b;
        k->t.out = k->next;
        k->t.step = k->step;
        k->t.keep = k->c.keep;
        k->t.add = k->c.add;
        peri__sweep_blocks(s->o->parallel, &k->t, peri__relax_rows, &sum, &scaled);
        s->report->evaluations++;
        residual = sqrt(sum) / s->scale;
        if (s->report->iterations > 0) peri__tell(s, residual);
        if (residual <= s->o->tolerance) {
            peri__relax_keep(k, k->now, residual);
            return peri__succeed(s->err);
        }
        if (!peri__relax_look(k, sqrt(scaled), residual)) break;
        if (s->report->iterations >= s->o->max_iterations) {
            if (sqrt(scaled) < k->least) peri__relax_keep(k, k->now, residual);
            else peri__relax_keep(k, k->best, k->least_residual);
            return peri__stalled(s, peri__more);
        }
        if (age > 0 && k->age == 0) continue; /* begun anew: the pass was made with the old interval */
        peri__relax_swap(k);
        peri__recurrence_next(&k->c);
        k->age++;
        s->report->iterations++;
    }
    peri__relax_keep(k, k->best, k->least_residual);
    s->report->fallbacks = 1;
    return peri__cg(s);
}

static void peri__relax_set(peri__relax *k, peri__linear *s, peri_spectrum *spectrum, int accelerate) {
    memset(k, 0, sizeof *k);
    k->s = s;
    k->spectrum = spectrum;
    k->accelerate = accelerate;
    k->now = s->x;
    k->next = s->work;
    k->step = k->next + s->n;
    k->best = k->step + s->n;
}

static peri_result peri__jacobi_run(peri__linear *s) {
    peri_spectrum spectrum;
    peri__relax k;
    memset(&spectrum, 0, sizeof spectrum);
    spectrum.low = spectrum.high = 1;
    peri__relax_set(&k, s, &spectrum, 0);
    return peri__relax_run(&k);
}

static peri_result peri__chebyshev_run(peri__linear *s) {
    peri_spectrum own, *spectrum = s->o->spectrum ? s->o->spectrum : &own;
    peri_result bad = PERI_OK;
    peri__relax k;
    if (!s->o->spectrum) memset(&own, 0, sizeof own);
    if (!(spectrum->high > 0) || !(spectrum->low > 0) || !(spectrum->low <= spectrum->high) ||
        !peri__finite(spectrum->high))
        bad = peri__spectrum_run(spectrum, s->a, 20, s->work, s->o->parallel, s->err);
    if (bad) return bad;
    peri__relax_set(&k, s, spectrum, 1);
    return peri__relax_run(&k);
}

peri_result peri_solve_jacobi(const peri_matrix *a, int rhs, const peri_real *b, peri_real *x, peri_real *work,
                              const peri_iteration *o, peri_report *report, peri_error *err) {
    peri__linear s;
    peri__linear_set(&s, "jacobi", a, rhs, b);
    s.x = x;
    s.work = work;
    s.o = o;
    s.report = report;
    s.err = err;
    return peri__linear_run(&s, peri__jacobi_run);
}

peri_result peri_solve_chebyshev(const peri_matrix *a, int rhs, const peri_real *b, peri_real *x, peri_real *work,
                                 const peri_iteration *o, peri_report *report, peri_error *err) {
    peri__linear s;
    peri__linear_set(&s, "chebyshev", a, rhs, b);
    s.x = x;
    s.work = work;
    s.o = o;
    s.report = report;
    s.err = err;
    return peri__linear_run(&s, peri__chebyshev_run);
}

/* -- incomplete Cholesky -- */

/* The lower pattern by rows; the diagonal of L is kept inverted. */
struct peri_incomplete {
    peri_allocator memory;
    size_t bytes;
    int n, rhs, ready;
    double shift;
    int *row, *col, *at;        /* n + 1; entries; n, scratch: where a column's entry of the present row is */
    peri_real *value, *inverse; /* entries; n */
};

/* Entries below the diagonal; columns ascend, so they come first in their row. */
static int peri__lower_end(const peri_matrix *a, int i) {
    int low = a->row[i], high = a->row[i + 1];
    while (low < high) {
        int middle = low + (high - low) / 2;
        if (a->col[middle] < i) low = middle + 1; else high = middle;
    }
    return low;
}

/* One block: the struct, reals, integers. */
static size_t peri__incomplete_layout(size_t n, size_t entries, peri_incomplete *f) {
    size_t reals = (sizeof(peri_incomplete) + 15) / 16 * 16, ints = reals + (n + entries) * sizeof(peri_real);
    if (f) {
        f->value = (peri_real *)(void *)((char *)f + reals);
        f->inverse = f->value + entries;
        f->row = (int *)(void *)((char *)f + ints);
        f->col = f->row + n + 1;
        f->at = f->col + entries;
    }
    return ints + (2 * n + 1 + entries) * sizeof(int);
}

peri_result peri_incomplete_create(const peri_matrix *a, int rhs, const peri_allocator *memory, peri_incomplete **out,
                                   peri_error *err) {
    peri_result bad;
    peri_incomplete *f;
    size_t entries = 0, bytes;
    int i, k, e = 0;
    if (out) *out = NULL;
    if (!out) return peri__fail(err, PERI_ERROR_ARGUMENT, "incomplete: out is NULL");
    if (rhs < 1 || rhs > 3)
        return peri__fail(err, PERI_ERROR_ARGUMENT, "incomplete: rhs is %d; it must be 1 to 3", rhs);
    bad = peri__check_rows("incomplete", a, err);
    if (bad) return bad;
    for (i = 0; i < a->n; i++) entries += (size_t)(peri__lower_end(a, i) - a->row[i]);
    if (entries + 2 * (size_t)a->n > (size_t)-1 / 32)
        return peri__fail(err, PERI_ERROR_LIMIT, "incomplete: %d rows are more than memory can have", a->n);
    bytes = peri__incomplete_layout((size_t)a->n, entries, NULL);
    f = (peri_incomplete *)peri__resize(memory, NULL, 0, bytes);
    if (!f) return peri__fail(err, PERI_ERROR_MEMORY, "incomplete: no memory for %.0f bytes", (double)bytes);
    memset(f, 0, sizeof *f);
    if (memory) f->memory = *memory;
    f->bytes = bytes;
    f->n = a->n;
    f->rhs = rhs;
    peri__incomplete_layout((size_t)a->n, entries, f);
    for (f->row[0] = 0, i = 0; i < a->n; i++) {
        for (k = a->row[i]; k < peri__lower_end(a, i); k++) f->col[e++] = a->col[k];
        f->row[i + 1] = e;
    }
    *out = f;
    return peri__succeed(err);
}

void peri_incomplete_destroy(peri_incomplete *f) {
    peri_allocator memory;
    if (!f) return;
    memory = f->memory;
    peri__resize(&memory, f, f->bytes, 0);
}

double peri_incomplete_shift(const peri_incomplete *f) { return f ? f->shift : 0; }
size_t peri_incomplete_bytes(const peri_incomplete *f) { return f ? f->bytes : 0; }

/* Row i: L(i, j) = (A(i, j) - sum over c < j of L(i, c) L(j, c)) / L(j, j) for what the pattern has. at[c] is a place
   of row i only when it is not before it, so nothing needs clearing. 0 when the pivot is not clearly positive. */
static int peri__incomplete_row(peri_incomplete *f, const peri_matrix *a, int i) {
    const peri_real *in = a->value ? a->value + a->row[i] : NULL;
    double d = (double)a->diagonal[i] * (1 + f->shift), pivot = d;
    int begin = f->row[i], end = f->row[i + 1], e, k;
    for (e = begin; e < end; e++) f->at[f->col[e]] = e;
    for (e = begin; e < end; e++) {
        int j = f->col[e];
        double sum = (double)in[e - begin];
        for (k = f->row[j]; k < f->row[j + 1]; k++) {
            int at = f->at[f->col[k]];
            if (at >= begin) sum -= (double)f->value[k] * (double)f->value[at];
        }
        sum *= (double)f->inverse[j];
        f->value[e] = (peri_real)sum;
        pivot -= sum * sum;
    }
    if (!(pivot > (sizeof(peri_real) > 4 ? 1e-12 : 1e-6) * d) || !peri__finite(pivot)) return 0;
    f->inverse[i] = (peri_real)(1 / sqrt(pivot));
    return 1;
}

static int peri__incomplete_matches(const peri_incomplete *f, const peri_matrix *a) {
    int i, count;
    if (a->n != f->n) return 0;
    for (i = 0; i < f->n; i++) {
        count = f->row[i + 1] - f->row[i];
        if (peri__lower_end(a, i) - a->row[i] != count) return 0;
        if (count && memcmp(a->col + a->row[i], f->col + f->row[i], (size_t)count * sizeof(int)) != 0) return 0;
    }
    return 1;
}

/* A shift beyond the largest (sum of a row's absolute values) / diagonal makes A + shift D dominant, where no pivot
   fails (Meijerink & van der Vorst): so the loop ends. */
peri_result peri_incomplete_factor(peri_incomplete *f, const peri_matrix *a, peri_error *err) {
    peri_result bad;
    int i, tries;
    if (!f) return peri__fail(err, PERI_ERROR_ARGUMENT, "incomplete: the factor is NULL");
    f->ready = 0;
    bad = peri__check_rows("incomplete", a, err);
    if (!bad && !peri__incomplete_matches(f, a))
        bad = peri__fail(err, PERI_ERROR_ARGUMENT,
                         "incomplete: the matrix (n is %d) has another pattern than the one of create (n is %d)", a->n,
                         f->n);
    if (!bad) bad = peri__check_values("incomplete", a, err);
    if (bad) return bad;
    for (tries = 0; tries < 64; tries++) {
        f->shift = tries == 0 ? 0 : tries == 1 ? 1e-3 : 4 * f->shift;
        for (i = 0; i < f->n; i++) f->at[i] = -1;
        for (i = 0; i < f->n; i++)
            if (!peri__incomplete_row(f, a, i)) break;
        if (i == f->n) {
            f->ready = 1;
            return peri__succeed(err);
        }
    }
    return peri__fail(err, PERI_ERROR_PIVOT, "incomplete: no shift makes the pivot of row %d positive", i);
}

static void peri__incomplete_solve3(const peri_incomplete *f, peri_real *p) {
    int i, e;
    for (i = 0; i < f->n; i++) {
        peri_real *z = p + 3 * (ptrdiff_t)i;
        double y0 = (double)z[0], y1 = (double)z[1], y2 = (double)z[2], d = (double)f->inverse[i];
        for (e = f->row[i]; e < f->row[i + 1]; e++) {
            const peri_real *from = p + 3 * (ptrdiff_t)f->col[e];
            double v = (double)f->value[e];
            y0 -= v * (double)from[0];
            y1 -= v * (double)from[1];
            y2 -= v * (double)from[2];
        }
        z[0] = (peri_real)(y0 * d);
        z[1] = (peri_real)(y1 * d);
        z[2] = (peri_real)(y2 * d);
    }
    for (i = f->n - 1; i >= 0; i--) {
        peri_real *z = p + 3 * (ptrdiff_t)i, d = f->inverse[i], z0 = z[0] * d, z1 = z[1] * d, z2 = z[2] * d;
        z[0] = z0;
        z[1] = z1;
        z[2] = z2;
        for (e = f->row[i]; e < f->row[i + 1]; e++) {
            peri_real *to = p + 3 * (ptrdiff_t)f->col[e], v = f->value[e];
            to[0] -= v * z0;
            to[1] -= v * z1;
            to[2] -= v * z2;
        }
    }
}

static void peri__incomplete_solve1(const peri_incomplete *f, int rhs, peri_real *p) {
    int i, e;
    for (i = 0; i < f->n; i++) {
        double y = (double)p[rhs * (ptrdiff_t)i];
        for (e = f->row[i]; e < f->row[i + 1]; e++) y -= (double)f->value[e] * (double)p[rhs * (ptrdiff_t)f->col[e]];
        p[rhs * (ptrdiff_t)i] = (peri_real)(y * (double)f->inverse[i]);
    }
    for (i = f->n - 1; i >= 0; i--) {
        peri_real z = p[rhs * (ptrdiff_t)i] * f->inverse[i];
        p[rhs * (ptrdiff_t)i] = z;
        for (e = f->row[i]; e < f->row[i + 1]; e++) p[rhs * (ptrdiff_t)f->col[e]] -= f->value[e] * z;
    }
}

void peri_incomplete_apply(const peri_real *g, peri_real *p, void *incomplete) {
    const peri_incomplete *f = (const peri_incomplete *)incomplete;
    int c;
    PERI_ASSERT(f && f->ready);
    if (!f || !f->n) return;
    memcpy(p, g, (size_t)f->rhs * (size_t)f->n * sizeof *p);
    if (!f->ready) return;
    if (f->rhs == 3) peri__incomplete_solve3(f, p);
    for (c = 0; c < f->rhs && f->rhs < 3; c++) peri__incomplete_solve1(f, f->rhs, p + c);
}

/* ---- 5  sparse matrices from triplets ---------------------------------------------------------------------------- */

/* slot: where the value of entry k goes: its place in the rows, ~row for the diagonal, or PERI__IGNORED. mirror: the
   place of the mirror image. */
struct peri_sparse {
    peri_allocator memory;
    peri_matrix a;
    size_t bytes;
    int count, both;
    int *row, *col, *slot, *mirror;
    peri_real *value, *diagonal;
    double *sum;            /* scratch of peri_sparse_set: rows, then diagonal */
};

#define PERI__IGNORED INT_MAX

typedef struct peri__entries {
    int n, count;
    const int *i, *j;       /* j NULL: entries stand in columns, and start says in which */
    const int *start;
    peri_triangle triangle;
} peri__entries;

/* Is entry k, in column j, one that counts? */
static int peri__wanted(const peri__entries *e, int i, int j) {
    return e->triangle == PERI_TRIANGLE_LOWER ? i >= j : e->triangle == PERI_TRIANGLE_UPPER ? i <= j : 1;
}

/* Goes through the entries in turn; returns 0 when there are no more. *k, *j: -1 and 0 at first. */
static int peri__entry_next(const peri__entries *e, int *k, int *i, int *j) {
    if (++*k >= e->count) return 0;
    *i = e->i[*k];
    if (e->j) *j = e->j[*k];
    else while (e->start[*j + 1] <= *k) ++*j;
    return 1;
}

static peri_result peri__entries_check(const peri__entries *e, peri_error *err) {
    int k = -1, i, j = 0;
    while (peri__entry_next(e, &k, &i, &j))
        if (i < 0 || i >= e->n || j < 0 || j >= e->n)
            return peri__fail(err, PERI_ERROR_INDEX, "sparse: entry %d stands at (%d, %d), outside %d rows", k, i, j,
                              e->n);
    return PERI_OK;
}

/* Sorts a row and drops what it holds twice; returns its length. Rows are short. */
static int peri__row_sort(int *col, int n) {
    int k, m, kept = 0;
    for (k = 1; k < n; k++) {
        int c = col[k];
        for (m = k; m > 0 && col[m - 1] > c; m--) col[m] = col[m - 1];
        col[m] = c;
    }
    for (k = 0; k < n; k++)
        if (k == 0 || col[k] != col[kept - 1]) col[kept++] = col[k];
    return kept;
}

/* Rows from the entries: counted, filled, sorted, packed. */
static void peri__sparse_rows(peri_sparse *s, const peri__entries *e) {
    int k = -1, i, j = 0, at, begin = 0;
    memset(s->row, 0, ((size_t)e->n + 1) * sizeof *s->row);
    while (peri__entry_next(e, &k, &i, &j)) {
        if (i == j || !peri__wanted(e, i, j)) continue;
        s->row[i + 1]++;
        if (e->triangle != PERI_TRIANGLE_BOTH) s->row[j + 1]++;
    }
    for (i = 0; i < e->n; i++) s->row[i + 1] += s->row[i];
    for (k = -1, j = 0; peri__entry_next(e, &k, &i, &j);) {
        if (i == j || !peri__wanted(e, i, j)) continue;
        s->col[s->row[i]++] = j;
        if (e->triangle != PERI_TRIANGLE_BOTH) s->col[s->row[j]++] = i;
    }
    for (i = 0, at = 0; i < e->n; i++) { /* row[i] has become the end of row i */
        int end = s->row[i], n = peri__row_sort(s->col + begin, end - begin);
        memmove(s->col + at, s->col + begin, (size_t)n * sizeof *s->col);
        begin = end;
        s->row[i] = at;
        at += n;
    }
    s->row[e->n] = at;
}

static int peri__find(const int *row, const int *col, int i, int j) {
    int low = row[i], high = row[i + 1];
    while (low < high) {
        int middle = low + (high - low) / 2;
        if (col[middle] < j) low = middle + 1; else high = middle;
    }
    return low < row[i + 1] && col[low] == j ? low : -1;
}

static peri_result peri__sparse_slots(peri_sparse *s, const peri__entries *e, peri_error *err) {
    int k = -1, i, j = 0;
    while (peri__entry_next(e, &k, &i, &j)) {
        s->slot[k] = s->mirror[k] = PERI__IGNORED;
        if (!peri__wanted(e, i, j)) continue;
        if (i == j) {
            s->slot[k] = ~i;
            continue;
        }
        s->slot[k] = peri__find(s->row, s->col, i, j);
        s->mirror[k] = peri__find(s->row, s->col, j, i);
        if (s->mirror[k] < 0)
            return peri__fail(err, PERI_ERROR_INDEX,
                              "sparse: entry %d stands at (%d, %d), but there is none at (%d, %d); hand over one "
                              "triangle, and say which", k, i, j, j, i);
    }
    return PERI_OK;
}

static peri_result peri__sparse_make(const peri__entries *e, const peri_allocator *memory, peri_sparse **out,
                                     peri_error *err) {
    peri_allocator hook;
    peri_sparse *s;
    size_t n, slots, bytes;
    peri_result bad = peri__entries_check(e, err);
    if (bad) return bad;
    if (e->count > 0x3fffffff)
        return peri__fail(err, PERI_ERROR_LIMIT, "sparse: %d entries and their mirror images are above 2^31", e->count);
    memset(&hook, 0, sizeof hook);
    if (memory) hook = *memory;
    n = (size_t)e->n + 1;
    slots = (size_t)e->count * (e->triangle == PERI_TRIANGLE_BOTH ? 1 : 2) + 1;
    bytes = sizeof *s + (slots + n) * (sizeof(double) + sizeof(peri_real));
    bytes += (n + slots + 2 * (size_t)e->count) * sizeof(int);
    s = (double)bytes < (double)slots * 16 ? NULL : (peri_sparse *)peri__resize(&hook, NULL, 0, bytes); /* 32 bits */
    if (!s) return peri__fail(err, PERI_ERROR_MEMORY, "sparse: no memory for %d entries", e->count);
    memset(s, 0, sizeof *s);
    s->memory = hook;
    s->bytes = bytes;
    s->count = e->count;
    s->both = e->triangle == PERI_TRIANGLE_BOTH;
    s->sum = (double *)(void *)(s + 1);
    s->value = (peri_real *)(void *)(s->sum + slots + n);
    s->diagonal = s->value + slots;
    s->row = (int *)(void *)(s->diagonal + n);
    s->col = s->row + n;
    s->slot = s->col + slots;
    s->mirror = s->slot + e->count;
    memset(s->value, 0, (slots + n) * sizeof *s->value);
    peri__sparse_rows(s, e);
    bad = peri__sparse_slots(s, e, err);
    if (bad) {
        peri_sparse_destroy(s);
        return bad;
    }
    s->a.n = e->n;
    s->a.row = s->row;
    s->a.col = s->col;
    s->a.value = s->value;
    s->a.diagonal = s->diagonal;
    *out = s;
    return peri__succeed(err);
}

peri_result peri_sparse_from_triplets(int n, int count, const int *i, const int *j, peri_triangle triangle,
                                      const peri_allocator *memory, peri_sparse **out, peri_error *err) {
    peri__entries e;
    if (out) *out = NULL;
    if (!out || ((!i || !j) && count > 0))
        return peri__fail(err, PERI_ERROR_ARGUMENT, "sparse: %s is NULL", !out ? "out" : !i ? "i" : "j");
    if (n < 0 || count < 0)
        return peri__fail(err, PERI_ERROR_INDEX, "sparse: n is %d and count %d; neither may be negative", n, count);
    memset(&e, 0, sizeof e);
    e.n = n;
    e.count = count;
    e.i = i;
    e.j = j;
    e.triangle = triangle;
    return peri__sparse_make(&e, memory, out, err);
}

peri_result peri_sparse_from_columns(int n, const int *start, const int *row, peri_triangle triangle,
                                     const peri_allocator *memory, peri_sparse **out, peri_error *err) {
    peri__entries e;
    int j;
    if (out) *out = NULL;
    if (!out || !start || (!row && n > 0 && start[n] > 0))
        return peri__fail(err, PERI_ERROR_ARGUMENT, "sparse: %s is NULL", !out ? "out" : !start ? "start" : "row");
    if (n < 0 || start[0] != 0)
        return peri__fail(err, PERI_ERROR_INDEX, "sparse: n is %d and start[0] %d; they must be at least 0, and 0", n,
                          n < 0 ? 0 : start[0]);
    for (j = 0; j < n; j++)
        if (start[j + 1] < start[j])
            return peri__fail(err, PERI_ERROR_INDEX, "sparse: column %d ends at %d, before it begins at %d", j,
                              start[j + 1], start[j]);
    memset(&e, 0, sizeof e);
    e.n = n;
    e.count = start[n];
    e.i = row;
    e.start = start;
    e.triangle = triangle;
    return peri__sparse_make(&e, memory, out, err);
}

/* Entries at one place are added in their order, in double. */
peri_result peri_sparse_set(peri_sparse *s, const peri_real *value, peri_error *err) {
    double *diagonal;
    int k, i, stored;
    if (!s || (!value && s->count > 0))
        return peri__fail(err, PERI_ERROR_ARGUMENT, "sparse: %s is NULL", s ? "value" : "the matrix");
    stored = s->row[s->a.n];
    diagonal = s->sum + stored;
    memset(s->sum, 0, ((size_t)stored + (size_t)s->a.n) * sizeof *s->sum);
    for (k = 0; k < s->count; k++) {
        if (s->slot[k] == PERI__IGNORED) continue;
        if (!peri__finite((double)value[k]))
            return peri__fail(err, PERI_ERROR_VALUE, "sparse: the value of entry %d is not finite", k);
        if (s->slot[k] < 0) diagonal[~s->slot[k]] += (double)value[k];
        else s->sum[s->slot[k]] += (double)value[k];
        if (s->slot[k] >= 0 && !s->both) s->sum[s->mirror[k]] += (double)value[k];
    }
    for (k = 0; k < s->count && s->both; k++)
        if (s->slot[k] >= 0 && s->slot[k] != PERI__IGNORED &&
            (s->sum[s->slot[k]] < s->sum[s->mirror[k]] || s->sum[s->slot[k]] > s->sum[s->mirror[k]]))
            return peri__fail(err, PERI_ERROR_VALUE,
                              "sparse: entry %d and its mirror image sum up to %g and %g; the matrix must be "
                              "symmetric", k, s->sum[s->slot[k]], s->sum[s->mirror[k]]);
    for (i = 0; i < stored; i++) s->value[i] = (peri_real)s->sum[i];
    for (i = 0; i < s->a.n; i++) s->diagonal[i] = (peri_real)diagonal[i];
    return peri__succeed(err);
}

const peri_matrix *peri_sparse_matrix(const peri_sparse *s) { return s ? &s->a : NULL; }

void peri_sparse_destroy(peri_sparse *s) {
    peri_allocator memory;
    if (!s) return;
    memory = s->memory;
    peri__resize(&memory, s, s->bytes, 0);
}

/* ---- 5  sparse Cholesky ------------------------------------------------------------------------------------------
   A = P^T L L^T P. Analysis: ordering, elimination tree, column counts, supernodes, panels. Numbers: panel by panel,
   left-looking, in registers. */
#ifndef PERI_NO_CHOLESKY

/* -- a register full of reals; one real where the compiler has no such type -- */

#if defined(__GNUC__) || defined(__clang__)
#if defined(__AVX512F__)
#define PERI__VECTOR 64 /* bytes */
#define PERI__TILE 8    /* columns that a tile of accumulators has: two registers each must fit */
#elif defined(__AVX__)
#define PERI__VECTOR 32
#define PERI__TILE 4
#elif defined(__SSE2__) || defined(__ARM_NEON) || defined(__wasm_simd128__) || defined(__VSX__)
#define PERI__VECTOR 16
#define PERI__TILE 4
#endif
#define PERI__INLINE static inline __attribute__((always_inline, unused))
#define PERI__PREFETCH(at) __builtin_prefetch(at);
#else
#define PERI__INLINE static
#define PERI__PREFETCH(at)
#endif
#ifdef PERI__VECTOR
typedef peri_real peri__reg __attribute__((vector_size(PERI__VECTOR), may_alias));
#define PERI__REGISTER ((int)(PERI__VECTOR / sizeof(peri_real)))
#ifdef PERI_DOUBLE
typedef int64_t peri__mask_of;
#else
typedef int32_t peri__mask_of;
#endif
typedef peri__mask_of peri__mask __attribute__((vector_size(PERI__VECTOR), may_alias));
#else
typedef peri_real peri__reg;
#define PERI__TILE 4
#define PERI__REGISTER 1
#endif

#ifdef __AVX__
#include <immintrin.h>
#endif

PERI__INLINE peri__reg peri__splat(peri_real x) {
#ifdef PERI__VECTOR
    peri__reg zero = {0};
    return x - zero; /* which a compiler may drop, unlike x + 0 */
#else
    return x;
#endif
}

/* c - a b; fused where the processor has that in its baseline, whatever the compiler thinks of contraction. */
PERI__INLINE peri__reg peri__less(peri__reg c, peri__reg a, peri__reg b) {
#if defined(PERI__VECTOR) && defined(__AVX512F__) && defined(PERI_DOUBLE)
    return (peri__reg)_mm512_fnmadd_pd((__m512d)a, (__m512d)b, (__m512d)c);
#elif defined(PERI__VECTOR) && defined(__AVX512F__)
    return (peri__reg)_mm512_fnmadd_ps((__m512)a, (__m512)b, (__m512)c);
#elif defined(PERI__VECTOR) && defined(__FMA__) && defined(PERI_DOUBLE)
    return (peri__reg)_mm256_fnmadd_pd((__m256d)a, (__m256d)b, (__m256d)c);
#elif defined(PERI__VECTOR) && defined(__FMA__)
    return (peri__reg)_mm256_fnmadd_ps((__m256)a, (__m256)b, (__m256)c);
#else
    return c - a * b;
#endif
}

#define PERI__LEAF 48   /* vertices that are not worth dissecting */
#define PERI__BINS 256  /* of a histogram of positions */
#define PERI__WIDTH 128 /* columns of a panel, at most: a multiple of the lanes */
#define PERI__PARTS 4   /* groups of subtrees of the elimination tree that may run at once */

/* Columns of L with the same rows below them form a supernode, and PERI__WIDTH columns of it at most a panel: column c
   of the panel has the rows[row + k], k < height, of which the first `width` are the panel's own columns. Its values
   stand in blocks of PERI__REGISTER rows, in a block column by column: entry (k, c) is
   value[at + (k / lanes * width + c) * lanes + k % lanes]. What lies above the diagonal is 0; on it stand the inverses
   of its blocks of PERI__TILE columns. */
typedef struct peri__panel {
    int first, width, height;
    int inner;                  /* rows of its own part; the others are of the top */
    int part;                   /* which part it runs in; PERI__PARTS: the top, after all of them */
    size_t row, at;
} peri__panel;

/* Panel `from` has, from its row k on, rows among the columns of the panel whose list this stands in. */
typedef struct peri__pair {
    int from, row;
} peri__pair;

/* What a pattern says: shared by all factors of matrices that have it. One block. */
typedef struct peri__symbolic {
    peri_allocator memory;
    size_t bytes;
    uint64_t pattern;           /* hash of the pattern analysed */
    int users, n, panels, tallest;
    int part[PERI__PARTS + 1];  /* first column of a part, the last one being the top */
    int begin[PERI__PARTS + 2]; /* first panel of a part */
    size_t bytes_rows, bytes_pair;
    size_t entries;             /* of L, without zeros that make supernodes wider */
    size_t values;              /* reals that L takes */
    double operations;
    int *order, *place;         /* the row of a that comes k-th, and where row i of a went */
    int *rows;
    peri__panel *panel;
    size_t *pairs;              /* panels + 1: where the list of a panel begins */
    peri__pair *pair;
} peri__symbolic;

struct peri_cholesky {
    peri_allocator memory;
    peri__symbolic *s;
    size_t bytes;
    peri_parallel parallel;
    int ready, failed;          /* failed: the row whose pivot was not positive, or -1 */
    peri_real *value;           /* aligned to a register */
    char *block, *scratch;
    unsigned char *mark;        /* panels: to be made anew */
};

/* What a part needs to work: where each row stands in the panel in the making, and small blocks that stay in cache. */
typedef struct peri__bench {
    peri_real *tile;    /* 2 * PERI__TILE registers: products on their way to scattered rows; one before, one after */
    peri_real *right;   /* PERI__WIDTH * PERI__TILE: rows of the other factor, side by side */
    int *place, *top;   /* offset of a row in the panel; of the top's rows, from the first on, one for each part */
    int failed;         /* column whose pivot was not positive, or -1 */
    double pivot;
} peri__bench;

#define PERI__TILE_BYTES ((2 * PERI__TILE + 2) * PERI__REGISTER * sizeof(peri_real))
#define PERI__RIGHT_BYTES (PERI__WIDTH * PERI__TILE * sizeof(peri_real))

static size_t peri__align(size_t bytes) { return (bytes + 63) / 64 * 64; }

/* Of one part's bench; before all of them stands the place of each row, and without parts there is one. */
static size_t peri__bench_bytes(const peri__symbolic *s) {
    size_t tall = s->begin[PERI__PARTS] > 0 ? (size_t)(s->n - s->part[PERI__PARTS]) : 0;
    return peri__align(PERI__TILE_BYTES) + peri__align(PERI__RIGHT_BYTES) + peri__align(tall * sizeof(int));
}

static size_t peri__scratch_bytes(const peri__symbolic *s) {
    size_t benches = s->begin[PERI__PARTS] > 0 ? PERI__PARTS : 1;
    return peri__align((size_t)s->n * sizeof(int)) + peri__bench_bytes(s) * benches;
}

static peri__bench peri__bench_of(const peri_cholesky *f, int part) {
    char *at = f->scratch + peri__align((size_t)f->s->n * sizeof(int)) + peri__bench_bytes(f->s) * (size_t)part;
    peri__bench w;
    w.failed = -1;
    w.pivot = 0;
    w.tile = (peri_real *)(void *)at + PERI__REGISTER;
    w.right = (peri_real *)(void *)(at + peri__align(PERI__TILE_BYTES));
    w.place = (int *)(void *)f->scratch;
    w.top = (int *)(void *)(at + peri__align(PERI__TILE_BYTES) + peri__align(PERI__RIGHT_BYTES));
    return w;
}

/* FNV-1a by words, four side by side: a factor refuses a matrix with other entries. */
static uint64_t peri__hash_ints(uint64_t seed, const int *v, int n) {
    uint64_t h[4], hash = seed;
    int i, k;
    for (k = 0; k < 4; k++) h[k] = seed + (uint64_t)k;
    for (i = 0; i + 4 <= n; i += 4)
        for (k = 0; k < 4; k++) h[k] = (h[k] ^ (uint32_t)v[i + k]) * 1099511628211ULL;
    for (; i < n; i++) h[0] = (h[0] ^ (uint32_t)v[i]) * 1099511628211ULL;
    for (k = 0; k < 4; k++) hash = (hash ^ (h[k] >> 32) ^ h[k]) * 1099511628211ULL;
    return hash;
}

static uint64_t peri__pattern(const peri_matrix *a) {
    uint64_t hash = 14695981039346656037ULL;
    return a->n > 0 ? peri__hash_ints(peri__hash_ints(hash, a->row + 1, a->n), a->col, a->row[a->n]) : hash;
}

/* Rows in order meet the entries of every column in order, so that each finds its mirror image in one pass. Returns
   the row whose entry *k has none, or n. */
static int peri__asymmetric(const peri_matrix *a, int *next, int *k) {
    int i;
    for (i = 0; i < a->n; i++) next[i] = a->row[i];
    for (i = 0; i < a->n; i++)
        for (*k = a->row[i]; *k < a->row[i + 1]; ++*k) {
            int j = a->col[*k];
            if (next[j] >= a->row[j + 1] || a->col[next[j]] != i) return i;
            next[j]++;
        }
    return a->n;
}

static peri_result peri__check_pattern(const peri_matrix *a, const peri_allocator *memory, peri_error *err) {
    size_t bytes = (size_t)(a->n > 0 ? a->n : 1) * sizeof(int);
    peri_result bad = peri__check_rows("matrix", a, err);
    int i, k, *next;
    if (bad || a->n == 0) return bad;
    next = (int *)peri__resize(memory, NULL, 0, bytes);
    if (!next) return peri__fail(err, PERI_ERROR_MEMORY, "cholesky: no memory to check %d rows", a->n);
    i = peri__asymmetric(a, next, &k);
    peri__resize(memory, next, bytes, 0);
    if (i == a->n) return PERI_OK;
    for (i = 0; i < a->n; i++) /* the first that lacks its mirror image, which need not be where that showed */
        for (k = a->row[i]; k < a->row[i + 1]; k++)
            if (peri__find(a->row, a->col, a->col[k], i) < 0)
                return peri__fail(err, PERI_ERROR_INDEX,
                                  "matrix: row %d stores column %d, but row %d does not store column %d", i, a->col[k],
                                  a->col[k], i);
    return PERI_OK;
}

/* -- ordering: nested dissection by position (George 1973; Heath & Raghavan 1995) -- */

typedef struct peri__dissection {
    const peri_matrix *a;
    const peri_real *xyz;
    int *order, *spare, *part; /* part[v] is one stamp for side A of the last cut of v, the next stamp for side B */
    unsigned char *halo;       /* 1: in a separator */
    int stamp;
} peri__dissection;

static double peri__coordinate(const peri__dissection *d, int k, int axis) {
    return (double)d->xyz[3 * (ptrdiff_t)d->order[k] + axis];
}

/* Cuts order[begin, end) across its longest axis at the border of a histogram that comes nearest to the median, so
   that the planes of a lattice stay whole; where all stand on one spot, in the order they have. */
static void peri__cut(peri__dissection *d, int begin, int end) {
    int bin[PERI__BINS], k, axis, longest = 0, border = 0, count = 0, best = 0, n = end - begin;
    double low = 0, extent = -1;
    for (axis = 0; axis < 3; axis++) {
        double lo = peri__coordinate(d, begin, axis), hi = lo;
        for (k = begin + 1; k < end; k++) {
            double x = peri__coordinate(d, k, axis);
            if (x < lo) lo = x;
            if (x > hi) hi = x;
        }
        if (hi - lo > extent) {
            extent = hi - lo;
            low = lo;
            longest = axis;
        }
    }
    memset(bin, 0, sizeof bin);
    for (k = begin; k < end; k++) {
        double x = extent > 0 ? (peri__coordinate(d, k, longest) - low) / extent * PERI__BINS : 0;
        d->part[d->order[k]] = x < PERI__BINS - 1 ? (int)x : PERI__BINS - 1;
        bin[d->part[d->order[k]]]++;
    }
    for (k = 0; k < PERI__BINS; k++) {
        count += bin[k];
        if (abs(2 * count - n) < abs(2 * best - n)) {
            best = count;
            border = k + 1;
        }
    }
    for (k = begin; k < end; k++) {
        int v = d->order[k];
        int side = best < n / 4 || n - best < n / 4 ? k - begin >= n / 2 : d->part[v] >= border;
        d->part[v] = d->stamp + side;
    }
}

/* The separator is whichever side's vertices along the cut are fewer; they come last. Returns the sizes of the rest. */
static void peri__separate(peri__dissection *d, int begin, int end, int size[2]) {
    int k, e, edge[2] = {0, 0}, thin, at[3];
    size[0] = size[1] = 0;
    for (k = begin; k < end; k++) {
        int v = d->order[k], side = d->part[v] - d->stamp;
        size[side]++;
        for (e = d->a->row[v]; e < d->a->row[v + 1]; e++)
            if (d->part[d->a->col[e]] == d->stamp + 1 - side) break;
        if (e < d->a->row[v + 1]) {
            edge[side]++;
            d->order[k] = ~v; /* along the cut */
        }
    }
    thin = edge[1] < edge[0];
    size[thin] -= edge[thin];
    at[0] = begin;
    at[1] = begin + size[0];
    at[2] = at[1] + size[1];
    for (k = begin; k < end; k++) {
        int v = d->order[k] < 0 ? ~d->order[k] : d->order[k], side = d->part[v] - d->stamp;
        if (d->order[k] < 0 && side == thin) side = 2;
        d->spare[at[side]++] = v;
    }
    memcpy(d->order + begin, d->spare + begin, (size_t)(end - begin) * sizeof *d->order);
}

/* A side has at most 3/4 of the vertices: the recursion is shallow. */
static void peri__dissect(peri__dissection *d, int begin, int end) {
    while (end - begin > PERI__LEAF) {
        int size[2], k;
        d->stamp += 2;
        peri__cut(d, begin, end);
        peri__separate(d, begin, end, size);
        for (k = begin + size[0] + size[1]; k < end; k++) d->halo[d->order[k]] = 1;
        peri__dissect(d, begin, begin + size[0]);
        begin += size[0];
        end = begin + size[1];
    }
}

/* -- ordering, second part: approximate minimum degree on the quotient graph (Amestoy, Davis & Duff 1996), of the
   vertices that dissection left together. The others, the separators, come last as they are, but count as neighbours:
   so leaves are ordered with their halo in view (Pellegrini, Roman & Amestoy 2000). -- */

enum { PERI__VARIABLE, PERI__ELEMENT, PERI__ABSORBED };

/* The pool holds, for a variable, its neighbours and then its elements; for an element, its variables. Variables that
   cannot be told apart are one, of their common weight; what was absorbed has weight 0. */
typedef struct peri__degrees {
    int n, left, lowest, stamp, mark, pivots;   /* left: weight not eliminated */
    int *head, *next, *prev, *degree;           /* variables by degree: doubly linked; of an element its weight */
    int *kind, *size, *elements, *weight;       /* size: all entries in the pool; elements: how many of them are */
    int *seen, *outside, *marked;               /* outside: weight of an element that the new element does not have */
    int *follow, *last;                         /* chains of variables that are one */
    int *hash;                                  /* head of the variables with one hash */
    const unsigned char *halo;
    int *order, *pool;
    size_t *begin, used;
} peri__degrees;

static void peri__degree_insert(peri__degrees *d, int v, int degree) {
    d->degree[v] = degree;
    if (d->halo[v]) return;
    d->prev[v] = -1;
    d->next[v] = d->head[degree];
    if (d->head[degree] >= 0) d->prev[d->head[degree]] = v;
    d->head[degree] = v;
    if (degree < d->lowest) d->lowest = degree;
}

static void peri__degree_remove(peri__degrees *d, int v) {
    if (d->halo[v]) return;
    if (d->prev[v] >= 0) d->next[d->prev[v]] = d->next[v]; else d->head[d->degree[v]] = d->next[v];
    if (d->next[v] >= 0) d->prev[d->next[v]] = d->prev[v];
}

/* Moves what is alive to the front of the pool: variables keep the order of their numbers, elements follow by age. */
static void peri__degree_compact(peri__degrees *d) {
    int v, k;
    d->used = 0;
    for (k = 0; k < d->n + d->pivots; k++) {
        v = k < d->n ? k : d->order[k - d->n];
        if (d->kind[v] != (k < d->n ? PERI__VARIABLE : PERI__ELEMENT)) continue;
        memmove(d->pool + d->used, d->pool + d->begin[v], (size_t)d->size[v] * sizeof *d->pool);
        d->begin[v] = d->used;
        d->used += (size_t)d->size[v];
    }
}

/* Turns variable p into an element: the union of its neighbours and of its elements, which it absorbs. */
static void peri__degree_element(peri__degrees *d, int p) {
    const int *list = d->pool + d->begin[p];
    int *out = d->pool + d->used;
    int k, m, size = 0, weight = 0, plain = d->size[p] - d->elements[p];
    d->seen[p] = ++d->stamp;
    for (k = 0; k < d->size[p]; k++) {
        const int *from = k < plain ? list + k : d->pool + d->begin[list[k]];
        int count = k < plain ? 1 : d->size[list[k]];
        if (k >= plain && d->kind[list[k]] != PERI__ELEMENT) continue;
        for (m = 0; m < count; m++) {
            int v = from[m];
            if (d->seen[v] == d->stamp || d->weight[v] == 0) continue;
            d->seen[v] = d->stamp;
            weight += d->weight[v];
            out[size++] = v;
        }
        if (k >= plain) d->kind[list[k]] = PERI__ABSORBED;
    }
    d->kind[p] = PERI__ELEMENT;
    d->begin[p] = d->used;
    d->size[p] = size;
    d->degree[p] = weight;
    d->used += (size_t)size;
}

/* For every element next to the new one, the weight of what it has outside. */
static void peri__degree_outside(peri__degrees *d, int p) {
    int k, m;
    for (k = 0; k < d->size[p]; k++) {
        int v = d->pool[d->begin[p] + (size_t)k];
        const int *from = d->pool + d->begin[v];
        for (m = d->size[v] - d->elements[v]; m < d->size[v]; m++) {
            int e = from[m];
            if (d->kind[e] != PERI__ELEMENT) continue;
            if (d->seen[e] != d->stamp) {
                d->seen[e] = d->stamp;
                d->outside[e] = d->degree[e];
            }
            d->outside[e] -= d->weight[v];
        }
    }
}

/* Rewrites the lists of variable v of the new element p, and bounds its degree outside p from above. An element that
   lies inside p goes. The list never grows: p takes the place of what led to v. *hash: of the list. */
static void peri__degree_update(peri__degrees *d, int v, int p, uint32_t *hash) {
    int *list = d->pool + d->begin[v];
    int k, kept = 0, plain = d->size[v] - d->elements[v];
    double degree = 0;
    uint32_t sum = (uint32_t)p;
    for (k = 0; k < plain; k++) {
        if (d->seen[list[k]] == d->stamp || d->weight[list[k]] == 0) continue;
        degree += d->weight[list[k]];
        sum += (uint32_t)list[k];
        list[kept++] = list[k];
    }
    plain = kept;
    for (k = d->size[v] - d->elements[v]; k < d->size[v]; k++) {
        int e = list[k];
        if (d->kind[e] != PERI__ELEMENT || e == p) continue;
        if (d->outside[e] == 0) {
            d->kind[e] = PERI__ABSORBED;
            continue;
        }
        degree += d->outside[e];
        sum += (uint32_t)e;
        list[kept++] = e;
    }
    list[kept++] = p;
    d->size[v] = kept;
    d->elements[v] = kept - plain;
    d->outside[v] = degree < d->n ? (int)degree : d->n;
    *hash = sum;
}

/* b becomes part of a. */
static void peri__degree_join(peri__degrees *d, int a, int b) {
    d->follow[d->last[a]] = b;
    d->last[a] = d->last[b];
    if (d->kind[a] == PERI__VARIABLE) d->weight[a] += d->weight[b];
    d->weight[b] = 0;
    d->kind[b] = PERI__ABSORBED;
}

/* Among the variables of one bucket, v first, joins to v those whose lists are the same. */
static void peri__degree_alike(peri__degrees *d, int v) {
    int k, u, before = v;
    d->mark++;
    for (k = 0; k < d->size[v]; k++) d->marked[d->pool[d->begin[v] + (size_t)k]] = d->mark;
    for (u = d->next[v]; u >= 0; u = d->next[u]) {
        int same = d->size[u] == d->size[v] && d->elements[u] == d->elements[v] && d->halo[u] == d->halo[v];
        for (k = 0; k < d->size[u] && same; k++) same = d->marked[d->pool[d->begin[u] + (size_t)k]] == d->mark;
        if (same) {
            peri__degree_join(d, v, u);
            d->next[before] = d->next[u];
        } else {
            before = u;
        }
    }
}

static void peri__degree_eliminate(peri__degrees *d, int p) {
    int *list, k, v, kept = 0, size;
    peri__degree_remove(d, p);
    d->left -= d->weight[p];
    peri__degree_element(d, p);
    peri__degree_outside(d, p);
    list = d->pool + d->begin[p];
    size = d->size[p];
    for (k = 0; k < size; k++) peri__degree_remove(d, list[k]);
    for (k = 0; k < size; k++) {
        uint32_t hash;
        v = list[k];
        peri__degree_update(d, v, p, &hash);
        if (d->size[v] == 1 && !d->halo[v]) { /* nothing but p: it goes with p, without more fill */
            d->left -= d->weight[v];
            d->degree[p] -= d->weight[v];
            peri__degree_join(d, p, v);
            continue;
        }
        hash %= (uint32_t)d->n;
        d->prev[v] = (int)hash;
        d->next[v] = d->hash[hash];
        d->hash[hash] = v;
    }
    for (k = 0; k < size; k++) { /* each bucket once */
        int u;
        if (d->weight[list[k]] == 0) continue;
        u = d->hash[d->prev[list[k]]];
        d->hash[d->prev[list[k]]] = -1;
        for (; u >= 0; u = d->next[u]) peri__degree_alike(d, u);
    }
    for (k = 0; k < size; k++) {
        int rest, degree;
        v = list[k];
        if (d->weight[v] == 0) continue;
        list[kept++] = v;
        rest = d->degree[p] - d->weight[v];
        degree = d->outside[v] < d->degree[v] ? d->outside[v] : d->degree[v];
        degree = degree < d->left - d->weight[v] - rest ? degree : d->left - d->weight[v] - rest;
        peri__degree_insert(d, v, (degree > 0 ? degree : 0) + rest);
    }
    d->size[p] = kept;
    d->used = d->begin[p] + (size_t)kept;
    d->order[d->pivots++] = p;
}

/* Orders the vertices whose halo is 0 by minimum degree, into order; 0 when memory runs out. */
static int peri__minimum_degree(const peri_matrix *a, const unsigned char *halo, const peri_allocator *memory,
                                int *order) {
    peri__degrees d;
    size_t bytes, n = (size_t)a->n, pool = (size_t)a->row[a->n], room = pool + pool / 4 + 2 * n;
    int v, k, done = 0, *block;
    memset(&d, 0, sizeof d);
    bytes = n * sizeof(size_t) + (15 * n + room) * sizeof(int);
    if ((double)bytes < (double)n * 60 + (double)pool * 5) return 0; /* 32 bits */
    d.begin = (size_t *)peri__resize(memory, NULL, 0, bytes);
    if (!d.begin) return 0;
    block = (int *)(d.begin + n);
    d.head = block;
    d.next = block + n;
    d.prev = block + 2 * n;
    d.degree = block + 3 * n;
    d.kind = block + 4 * n;
    d.size = block + 5 * n;
    d.elements = block + 6 * n;
    d.weight = block + 7 * n;
    d.seen = block + 8 * n;
    d.outside = block + 9 * n;
    d.marked = block + 10 * n;
    d.follow = block + 11 * n;
    d.last = block + 12 * n;
    d.hash = block + 13 * n;
    d.order = block + 14 * n;
    d.pool = block + 15 * n;
    d.n = d.left = a->n;
    d.halo = halo;
    d.used = pool;
    if (pool) memcpy(d.pool, a->col, pool * sizeof *d.pool);
    for (v = 0; v < d.n; v++) {
        d.head[v] = d.hash[v] = d.follow[v] = -1;
        d.last[v] = v;
        d.weight[v] = 1;
        d.kind[v] = PERI__VARIABLE;
        d.elements[v] = d.seen[v] = d.marked[v] = 0;
        d.begin[v] = (size_t)a->row[v];
        d.size[v] = a->row[v + 1] - a->row[v];
    }
    for (v = d.n - 1; v >= 0; v--) peri__degree_insert(&d, v, d.size[v]);
    for (d.lowest = 0; d.lowest < d.n;) {
        if (d.head[d.lowest] < 0) {
            d.lowest++;
            continue;
        }
        if (d.used + (size_t)d.left > room) peri__degree_compact(&d);
        peri__degree_eliminate(&d, d.head[d.lowest]);
    }
    for (k = 0; k < d.pivots; k++)
        for (v = d.order[k]; v >= 0; v = d.follow[v]) order[done++] = v;
    peri__resize(memory, d.begin, bytes, 0);
    return 1;
}

/* -- analysis: elimination tree, column counts, supernodes, panels -- */

/* A supernode in the making. */
typedef struct peri__group {
    int first, width, height, up, part;
    double zeros, cost;     /* entries that are explicitly 0; operations of its subtree */
} peri__group;

/* Scratch of the analysis, n or n + 1 numbers each. */
typedef struct peri__plan {
    peri_cholesky *f;
    peri__symbolic *s;
    const peri_matrix *a;
    int n, count_groups;
    peri__group *groups, *sorted;       /* supernodes; room for them in another order */
    size_t *list;                       /* of groups: where their rows begin */
    int *order, *place;                 /* of s */
    int *parent, *count, *group;        /* of a column */
    int *u, *v, *w, *z;                 /* free for each pass */
    unsigned char *halo;
} peri__plan;

/* Liu 1990; Davis, "Direct Methods for Sparse Linear Systems", section 4.1. ancestor: path compression. */
static void peri__tree(const peri__plan *p, int *ancestor) {
    int i, e;
    for (i = 0; i < p->n; i++) p->place[p->order[i]] = i;
    for (i = 0; i < p->n; i++) {
        int row = p->order[i];
        p->parent[i] = ancestor[i] = -1;
        for (e = p->a->row[row]; e < p->a->row[row + 1]; e++) {
            int k = p->place[p->a->col[e]];
            while (k >= 0 && k < i) {
                int up = ancestor[k];
                ancestor[k] = i;
                if (up < 0) p->parent[k] = i;
                k = up;
            }
        }
    }
}

/* Column i becomes name[i]. */
static void peri__rename(const peri__plan *p, const int *name, int *spare) {
    int i;
    for (i = 0; i < p->n; i++) spare[name[i]] = p->parent[i] < 0 ? -1 : name[p->parent[i]];
    memcpy(p->parent, spare, (size_t)p->n * sizeof *spare);
    for (i = 0; i < p->n; i++) spare[name[i]] = p->order[i];
    memcpy(p->order, spare, (size_t)p->n * sizeof *spare);
    for (i = 0; i < p->n; i++) p->place[p->order[i]] = i;
}

/* Renumbers the tree depth first, so that the columns of a supernode become neighbours. */
static void peri__postorder(const peri__plan *p, int *child, int *sibling, int *name) {
    int i, done = 0;
    for (i = 0; i < p->n; i++) child[i] = -1;
    for (i = p->n - 1; i >= 0; i--) {
        int up = p->parent[i];
        if (up < 0) continue;
        sibling[i] = child[up];
        child[up] = i;
    }
    for (i = 0; i < p->n; i++) {
        int k = i;
        if (p->parent[i] >= 0) continue;
        while (k >= 0) { /* down to a leaf, or take k and go back up */
            int down = child[k];
            if (down >= 0) {
                child[k] = sibling[down];
                k = down;
            } else {
                name[k] = done++;
                k = p->parent[k];
            }
        }
    }
    peri__rename(p, name, sibling);
}

/* Entries of each column (Gilbert, Ng & Peyton 1994): row i of L is a subtree whose leaves are entries of A; a column
   has one entry for each leaf below it, less one wherever two of a row's paths meet. low: first descendant;
   last: the leaf of row i before, and where its first descendant was; root: of the tree so far, compressed. */
static void peri__count(const peri__plan *p, int *low, int *last, int *before, int *root) {
    int *count = p->count;
    int i, j, k, e;
    for (i = 0; i < p->n; i++) {
        low[i] = last[i] = before[i] = -1;
        root[i] = i;
    }
    for (k = 0; k < p->n; k++) {
        count[k] = low[k] < 0; /* a leaf of the tree */
        for (j = k; j >= 0 && low[j] < 0; j = p->parent[j]) low[j] = k;
    }
    for (j = 0; j < p->n; j++) {
        int row = p->order[j];
        if (p->parent[j] >= 0) count[p->parent[j]]--;
        for (e = p->a->row[row]; e < p->a->row[row + 1]; e++) {
            i = p->place[p->a->col[e]];
            if (i <= j || low[j] <= last[i]) continue; /* not a leaf of row i */
            last[i] = low[j];
            count[j]++;
            if (before[i] >= 0) { /* the paths meet in the root of the leaf before */
                int meet = before[i], next;
                while (meet != root[meet]) meet = root[meet];
                for (k = before[i]; k != meet; k = next) {
                    next = root[k];
                    root[k] = meet;
                }
                count[meet]--;
            }
            before[i] = j;
        }
        if (p->parent[j] >= 0) root[j] = p->parent[j];
    }
    for (j = 0; j < p->n; j++)
        if (p->parent[j] >= 0) count[p->parent[j]] += count[j];
}

/* What a supernode costs a solve, in reals of L that go by: itself with its blocks filled up, to move its rows, and to
   begin. The two weights are measured: halves or doubles of them change times by a few hundredths, and memory more. */
static double peri__group_cost(int width, int height) {
    int filled = (height + PERI__REGISTER - 1) / PERI__REGISTER * PERI__REGISTER;
    return (double)filled * width + 3.0 * height + 80;
}

/* Supernode g joins the one after, its parent, where that costs less than the two, or no zeros (Ashcraft & Grimes
   1989). */
static void peri__group_relax(const peri__plan *p, peri__group *g) {
    int up = p->parent[g->first + g->width - 1], w = g->width + g[1].width, h = g->width + g[1].height;
    double zeros = g[1].zeros + (double)g->width * (h - g->height);
    if (up < 0 || up >= g[1].first + g[1].width) return;
    if (zeros > 0 && peri__group_cost(w, h) >
                         peri__group_cost(g->width, g->height) + peri__group_cost(g[1].width, g[1].height)) return;
    g->width = w;
    g->height = h;
    g->zeros = zeros;
    g[1].width = 0;
}

/* A column joins the one before when that is its child with just one row more; then supernodes join, the last first. */
static void peri__supernodes(peri__plan *p) {
    peri__group *g = p->groups;
    int j, k, total = 0, kept = 0;
    for (j = 0; j < p->n; j++) {
        if (j == 0 || p->parent[j - 1] != j || p->count[j - 1] != p->count[j] + 1) {
            g[total].first = j;
            g[total].height = p->count[j];
            g[total].width = 0;
            g[total++].zeros = 0;
        }
        g[total - 1].width++;
    }
    for (k = total - 2; k >= 0; k--) peri__group_relax(p, g + k);
    for (k = 0; k < total; k++)
        if (g[k].width) g[kept++] = g[k];
    p->count_groups = kept;
}

/* Names, parents and costs of the supernodes. */
static void peri__groups_link(peri__plan *p) {
    peri__group *g = p->groups;
    int j, k;
    for (k = 0; k < p->count_groups; k++)
        for (j = 0; j < g[k].width; j++) p->group[g[k].first + j] = k;
    for (k = 0; k < p->count_groups; k++) g[k].cost = 0;
    for (k = 0; k < p->count_groups; k++) {
        int up = p->parent[g[k].first + g[k].width - 1];
        for (j = 0; j < g[k].width; j++)
            g[k].cost += (double)p->count[g[k].first + j] * p->count[g[k].first + j];
        g[k].up = up < 0 ? -1 : p->group[up];
        if (up >= 0) g[g[k].up].cost += g[k].cost;
    }
}

/* Shares the tree out: supernodes whose subtree takes more than a piece of the work run after all others, as part
   PERI__PARTS; each subtree below them goes to whichever part has least. */
static void peri__share(peri__plan *p) {
    peri__group *g = p->groups;
    double load[PERI__PARTS] = {0}, total = 0;
    int k, part, top = 0;
    for (k = 0; k < p->count_groups; k++) total += g[k].up < 0 ? g[k].cost : 0;
    for (k = p->count_groups - 1; k >= 0; k--) {
        g[k].part = g[k].up >= 0 ? g[g[k].up].part : PERI__PARTS;
        if (g[k].part == PERI__PARTS && total > 1e6 && g[k].cost <= total / (3 * PERI__PARTS)) {
            for (g[k].part = 0, part = 1; part < PERI__PARTS; part++)
                if (load[part] < load[g[k].part]) g[k].part = part;
            load[g[k].part] += g[k].cost;
        }
        if (g[k].part == PERI__PARTS) top += g[k].width;
    }
    /* a solve has room for their sums of the top's rows as long as these are few */
    for (k = 0; k < p->count_groups && PERI__PARTS * top > p->n; k++) g[k].part = PERI__PARTS;
}

/* Renumbers columns so that parts come one after another. */
static void peri__parts(peri__plan *p) {
    peri__group *sorted = p->sorted;
    int k, j, part, kept = 0, done = 0;
    for (part = 0; part <= PERI__PARTS; part++) {
        p->s->part[part] = done;
        for (k = 0; k < p->count_groups; k++) {
            if (p->groups[k].part != part) continue;
            for (j = 0; j < p->groups[k].width; j++) p->u[p->groups[k].first + j] = done++;
            sorted[kept] = p->groups[k];
            sorted[kept].first = done - sorted[kept].width;
            kept++;
        }
    }
    memcpy(p->groups, sorted, (size_t)kept * sizeof *sorted);
    for (k = 0; k < p->n; k++) p->v[p->u[k]] = p->count[k];
    memcpy(p->count, p->v, (size_t)p->n * sizeof *p->v);
    peri__rename(p, p->u, p->v);
    peri__groups_link(p);
}

/* Rows of each supernode. Taking the rows of A in order keeps every list sorted. size, seen: one per supernode. */
static void peri__rows(const peri__plan *p, const size_t *list, int *size, int *seen) {
    int i, k, e;
    for (k = 0; k < p->count_groups; k++) {
        int *rows = p->s->rows + list[k];
        size[k] = p->groups[k].width;
        seen[k] = -1;
        for (i = 0; i < size[k]; i++) rows[i] = p->groups[k].first + i;
    }
    for (i = 0; i < p->n; i++) {
        int row = p->order[i], self = p->group[i];
        for (e = p->a->row[row]; e < p->a->row[row + 1]; e++) {
            int j = p->place[p->a->col[e]];
            if (j > i) continue;
            for (k = p->group[j]; k != self && seen[k] != i; k = p->groups[k].up) {
                seen[k] = i;
                p->s->rows[list[k] + (size_t)size[k]++] = i;
            }
        }
    }
}

/* How many panels a supernode makes, and the width of all but the last: whole registers, so that blocks of rows of one
   stand under those of the next. */
static int peri__panels_of(const peri__group *g, int *width) {
    int count = (g->width + PERI__WIDTH - 1) / PERI__WIDTH;
    *width = ((g->width + count - 1) / count + PERI__REGISTER - 1) / PERI__REGISTER * PERI__REGISTER;
    return (g->width + *width - 1) / *width;
}

static void peri__panels(const peri__plan *p, const size_t *list) {
    peri__symbolic *s = p->s;
    int k, c, width, count = 0;
    size_t at = 0;
    for (k = 0; k < p->count_groups; k++) {
        const peri__group *g = p->groups + k;
        peri__panels_of(g, &width);
        for (c = 0; c < g->width; c += width) {
            peri__panel *to = s->panel + count;
            to->first = g->first + c;
            to->width = g->width - c < width ? g->width - c : width;
            to->height = g->height - c;
            to->part = g->part;
            to->row = list[k] + (size_t)c;
            to->at = at;
            at += (size_t)((to->height + PERI__REGISTER - 1) / PERI__REGISTER * PERI__REGISTER) * (size_t)to->width;
            to->inner = to->part == PERI__PARTS ? to->height : to->width;
            while (to->inner < to->height && s->rows[to->row + (size_t)to->inner] < s->part[PERI__PARTS]) to->inner++;
            count++;
        }
    }
    s->panels = count;
    s->values = at;
    for (k = 0; k <= PERI__PARTS; k++)
        for (s->begin[k] = 0; s->begin[k] < count && s->panel[s->begin[k]].part < k;) s->begin[k]++;
    s->begin[PERI__PARTS + 1] = count;
}

/* Who gives to whom: every panel hands on, to each panel that its rows below belong to. counts: one per panel. With
   pair NULL it only counts. */
static void peri__pairs(peri__symbolic *s, const int *panel_of, size_t *fill) {
    int j, k;
    size_t sum = 0;
    for (j = 0; j <= s->panels; j++) fill[j] = 0;
    for (j = 0; j < s->panels; j++) {
        const peri__panel *p = s->panel + j;
        const int *rows = s->rows + p->row;
        for (k = p->width; k < p->height; k++) {
            int to = panel_of[rows[k]];
            if (k > p->width && panel_of[rows[k - 1]] == to) continue;
            if (s->pair) {
                s->pair[s->pairs[to] + fill[to]].from = j;
                s->pair[s->pairs[to] + fill[to]].row = k;
            }
            fill[to]++;
        }
    }
    for (j = 0; j <= s->panels && !s->pair; j++) {
        s->pairs[j] = sum;
        sum += fill[j];
    }
}

static peri_result peri__factor_refused(peri_error *err, int n) {
    return peri__fail(err, PERI_ERROR_MEMORY, "cholesky: no memory for the factor of %d rows", n);
}

/* Grows the symbolic factor's account by a block. */
static void *peri__symbolic_take(peri__symbolic *s, size_t bytes) {
    void *block = peri__resize(&s->memory, NULL, 0, bytes);
    if (block) s->bytes += bytes;
    return block;
}

/* Ordering, tree, counts, supernodes, parts. */
static peri_result peri__plan_make(peri__plan *p, const peri_real *xyz, peri_error *err) {
    int i, separators = 0;
    for (i = 0; i < p->n; i++) {
        p->order[i] = i;
        p->halo[i] = 0;
        p->v[i] = 0;
    }
    if (xyz) {
        peri__dissection d;
        d.a = p->a;
        d.xyz = xyz;
        d.order = p->order;
        d.spare = p->u;
        d.part = p->v;
        d.halo = p->halo;
        d.stamp = 0;
        peri__dissect(&d, 0, p->n);
    }
    for (i = 0; i < p->n; i++)
        if (p->halo[p->order[i]]) p->w[separators++] = p->order[i];
    if (p->n > separators && !peri__minimum_degree(p->a, p->halo, &p->s->memory, p->order))
        return peri__fail(err, PERI_ERROR_MEMORY, "cholesky: no memory to order %d rows", p->n);
    for (i = 0; i < separators; i++) p->order[p->n - separators + i] = p->w[i];
    peri__tree(p, p->u);
    peri__postorder(p, p->u, p->v, p->w);
    peri__count(p, p->u, p->v, p->w, p->z);
    for (i = 0; i < p->n; i++) {
        p->s->entries += (size_t)p->count[i];
        p->s->operations += (double)p->count[i] * p->count[i];
    }
    peri__supernodes(p);
    peri__groups_link(p);
    peri__share(p);
    peri__parts(p);
    if (p->s->entries > 0x7fffffff)
        return peri__fail(err, PERI_ERROR_LIMIT,
                          "cholesky: the factor of %d rows would have %.0f entries, above 2^31; use peri_solve_cg with "
                          "peri_two_level_apply or peri_incomplete_apply",
                          p->n, (double)p->s->entries);
    return PERI_OK;
}

/* Rows, panels, pairs. */
static peri_result peri__symbolic_make(peri__plan *p, peri_error *err) {
    peri__symbolic *s = p->s;
    size_t rows = 0, panels = 0;
    int k, j, width;
    for (k = 0; k < p->count_groups; k++) {
        p->list[k] = rows;
        rows += (size_t)p->groups[k].height;
        panels += (size_t)peri__panels_of(p->groups + k, &width);
    }
    s->bytes_rows = panels * sizeof *s->panel + (panels + 1) * sizeof *s->pairs +
                    (rows + PERI__REGISTER) * sizeof *s->rows;
    s->panel = (peri__panel *)peri__symbolic_take(s, s->bytes_rows);
    if (!s->panel) return peri__factor_refused(err, p->n);
    s->pairs = (size_t *)(void *)(s->panel + panels);
    s->rows = (int *)(void *)(s->pairs + panels + 1);
    memset(s->rows + rows, 0, PERI__REGISTER * sizeof *s->rows); /* a solve reads a list up to a whole block */
    peri__rows(p, p->list, p->u, p->v);
    peri__panels(p, p->list);
    for (k = 0; k < s->panels; k++) {
        const peri__panel *q = s->panel + k;
        for (j = 0; j < q->width; j++) p->u[q->first + j] = k;
        if (q->height > s->tallest) s->tallest = q->height;
    }
    peri__pairs(s, p->u, p->list);
    s->bytes_pair = (s->pairs[s->panels] + 1) * sizeof *s->pair;
    s->pair = (peri__pair *)peri__symbolic_take(s, s->bytes_pair);
    if (!s->pair) return peri__factor_refused(err, p->n);
    peri__pairs(s, p->u, p->list);
    return PERI_OK;
}

static void peri__symbolic_leave(peri__symbolic *s) {
    peri_allocator memory;
    if (!s || --s->users > 0) return;
    memory = s->memory;
    if (s->pair) peri__resize(&memory, s->pair, s->bytes_pair, 0);
    if (s->panel) peri__resize(&memory, s->panel, s->bytes_rows, 0);
    peri__resize(&memory, s, sizeof *s + 2 * (size_t)s->n * sizeof(int), 0);
}

/* The analysis of a's pattern; *out has one user. */
static peri_result peri__analyse(const peri_matrix *a, const peri_real *xyz, const peri_allocator *memory,
                                 peri__symbolic **out, peri_error *err) {
    peri__plan p;
    peri__symbolic *s;
    peri_result result;
    size_t n = (size_t)a->n, bytes = sizeof *s + 2 * n * sizeof(int);
    size_t scratch = 2 * (n + 1) * sizeof(peri__group) + (n + 1) * (sizeof(size_t) + 7 * sizeof(int)) + n;
    char *block;
    *out = s = (peri__symbolic *)peri__resize(memory, NULL, 0, bytes);
    if (!s) return peri__factor_refused(err, a->n);
    memset(s, 0, bytes);
    s->memory = *memory;
    s->bytes = bytes;
    s->users = 1;
    s->n = a->n;
    s->pattern = peri__pattern(a);
    s->order = (int *)(void *)(s + 1);
    s->place = s->order + n;
    memset(&p, 0, sizeof p);
    p.s = s;
    p.a = a;
    p.n = a->n;
    p.order = s->order;
    p.place = s->place;
    block = (char *)peri__resize(memory, NULL, 0, scratch);
    if (!block) return peri__factor_refused(err, a->n);
    p.groups = (peri__group *)(void *)block;
    p.sorted = p.groups + n + 1;
    p.list = (size_t *)(void *)(p.sorted + n + 1);
    p.parent = (int *)(void *)(p.list + n + 1);
    p.count = p.parent + n + 1;
    p.group = p.count + n + 1;
    p.u = p.group + n + 1;
    p.v = p.u + n + 1;
    p.w = p.v + n + 1;
    p.z = p.w + n + 1;
    p.halo = (unsigned char *)(p.z + n + 1);
    result = peri__plan_make(&p, xyz, err);
    if (!result) result = peri__symbolic_make(&p, err);
    peri__resize(memory, block, scratch, 0);
    return result;
}

/* A factor of what was analysed, which it joins. */
static peri_result peri__numbers(peri__symbolic *s, const peri_allocator *memory, peri_cholesky **out,
                                 peri_error *err) {
    peri_cholesky *f = (peri_cholesky *)peri__resize(memory, NULL, 0, sizeof *f);
    size_t values, scratch;
    char *block;
    if (!f) return peri__factor_refused(err, s->n);
    memset(f, 0, sizeof *f);
    f->memory = *memory;
    f->failed = -1;
    scratch = peri__scratch_bytes(s) + (size_t)s->panels;
    if (!peri__mul_size(s->values, sizeof *f->value, &values) || values > (size_t)-1 - scratch - 128 ||
        !(f->block = (char *)peri__resize(memory, NULL, 0, f->bytes = peri__align(values) + scratch + 64))) {
        peri__resize(memory, f, sizeof *f, 0);
        return peri__fail(err, PERI_ERROR_MEMORY, "cholesky: no memory for a factor of %.0f entries",
                          (double)s->entries);
    }
    block = f->block + (64 - (size_t)((uintptr_t)f->block % 64)) % 64;
    f->value = (peri_real *)(void *)block;
    f->scratch = block + peri__align(values);
    f->mark = (unsigned char *)f->scratch + (scratch - (size_t)s->panels);
    f->parallel.threads = 1;
    f->s = s;
    s->users++;
    *out = f;
    return peri__succeed(err);
}

static peri_allocator peri__memory_or_standard(const peri_allocator *memory) {
    peri_allocator standard;
    standard.resize = NULL;
    standard.user = NULL;
    return memory ? *memory : standard;
}

/* Checks, then analyses. */
static peri_result peri__analyse_checked(const peri_matrix *a, const peri_real *xyz, const peri_allocator *memory,
                                         peri__symbolic **out, peri_error *err) {
    peri_result bad = peri__check_pattern(a, memory, err);
    ptrdiff_t i;
    if (bad) return bad;
    for (i = 0; xyz && i < 3 * (ptrdiff_t)a->n; i++)
        if (!peri__finite((double)xyz[i]))
            return peri__fail(err, PERI_ERROR_VALUE, "cholesky: coordinate %c of row %d is not finite",
                              "xyz"[i % 3], (int)(i / 3));
    return peri__analyse(a, xyz, memory, out, err);
}

peri_result peri_cholesky_create(const peri_matrix *a, const peri_real *xyz, const peri_allocator *memory,
                                 peri_cholesky **out, peri_error *err) {
    peri_allocator hook = peri__memory_or_standard(memory);
    peri__symbolic *s = NULL;
    peri_result result;
    if (out) *out = NULL;
    if (!a || !out) return peri__fail(err, PERI_ERROR_ARGUMENT, "cholesky: %s is NULL", a ? "out" : "the matrix");
    result = peri__analyse_checked(a, xyz, &hook, &s, err);
    if (!result) result = peri__numbers(s, &hook, out, err);
    peri__symbolic_leave(s);
    return result;
}

peri_result peri_cholesky_estimate(const peri_matrix *a, const peri_real *xyz, const peri_allocator *memory,
                                   size_t *entries, double *operations, peri_error *err) {
    peri_allocator hook = peri__memory_or_standard(memory);
    peri__symbolic *s = NULL;
    peri_result result;
    if (!a || !entries || !operations)
        return peri__fail(err, PERI_ERROR_ARGUMENT, "cholesky: %s is NULL", a ? "entries or operations" : "the matrix");
    result = peri__analyse_checked(a, xyz, &hook, &s, err);
    if (!result) {
        *entries = s->entries;
        *operations = s->operations;
    }
    peri__symbolic_leave(s);
    return result ? result : peri__succeed(err);
}

peri_result peri_cholesky_create_like(const peri_cholesky *other, const peri_allocator *memory, peri_cholesky **out,
                                      peri_error *err) {
    peri_allocator hook = peri__memory_or_standard(memory);
    if (out) *out = NULL;
    if (!other || !out)
        return peri__fail(err, PERI_ERROR_ARGUMENT, "cholesky: %s is NULL", other ? "out" : "the other");
    return peri__numbers(other->s, &hook, out, err);
}

void peri_cholesky_destroy(peri_cholesky *f) {
    peri_allocator memory;
    if (!f) return;
    memory = f->memory;
    peri__symbolic_leave(f->s);
    peri__resize(&memory, f->block, f->bytes, 0);
    peri__resize(&memory, f, sizeof *f, 0);
}

size_t peri_cholesky_entries(const peri_cholesky *f) { return f ? f->s->entries : 0; }

double peri_cholesky_operations(const peri_cholesky *f) { return f ? f->s->operations : 0; }

int peri_cholesky_pivot(const peri_cholesky *f) { return f ? f->failed : -1; }

size_t peri_cholesky_bytes(const peri_cholesky *f) { return f ? sizeof *f + f->bytes + f->s->bytes : 0; }

/* -- numbers: left-looking by panels (Ng & Peyton 1993), a tile of accumulators at a time -- */

/* c = -a b (set) or c += -a b (add) for one or two blocks of rows by PERI__TILE columns: a has `depth` columns, b its
   rows one after another. Products are summed by themselves first: that loses fewer digits than taking each from c.
   Two blocks of rows go by while the next two come near. The accumulators have names, since compilers keep an array of
   them in memory. */
#if PERI__TILE == 8
#define PERI__COLUMNS(op) op(0) op(1) op(2) op(3) op(4) op(5) op(6) op(7)
#else
#define PERI__COLUMNS(op) op(0) op(1) op(2) op(3)
#endif
#define PERI__BEGIN2(k) peri__reg x##k = peri__splat(0), y##k = x##k;
#define PERI__STEP2(k) x##k = peri__less(x##k, u, peri__splat(b[k])); y##k = peri__less(y##k, v, peri__splat(b[k]));
#define PERI__SET2(k) c0[k] = x##k; c1[k] = y##k;
#define PERI__ADD2(k) c0[k] += x##k; c1[k] += y##k;
#define PERI__BEGIN1(k) peri__reg x##k = peri__splat(0);
#define PERI__STEP1(k) x##k = peri__less(x##k, u, peri__splat(b[k]));
#define PERI__SET1(k) c0[k] = x##k;
#define PERI__ADD1(k) c0[k] += x##k;

#define PERI__TILE_DEFINE(name, END2, END1) \
    static void peri__tile2_##name(int depth, const peri__reg *PERI__RESTRICT a0, const peri__reg *PERI__RESTRICT a1, \
                                   const peri_real *PERI__RESTRICT b, peri__reg *PERI__RESTRICT c0, \
                                   peri__reg *PERI__RESTRICT c1) { \
        int k; \
        PERI__COLUMNS(PERI__BEGIN2) \
        for (k = 0; k < depth; k++, b += PERI__TILE) { \
            peri__reg u = a0[k], v = a1[k]; \
            PERI__PREFETCH(a1 + (a1 - a0) + k) \
            PERI__PREFETCH(a1 + 2 * (a1 - a0) + k) \
            PERI__COLUMNS(PERI__STEP2) \
        } \
        PERI__COLUMNS(END2) \
    } \
    static void peri__tile1_##name(int depth, const peri__reg *PERI__RESTRICT a0, const peri_real *PERI__RESTRICT b, \
                                   peri__reg *PERI__RESTRICT c0) { \
        int k; \
        PERI__COLUMNS(PERI__BEGIN1) \
        for (k = 0; k < depth; k++, b += PERI__TILE) { \
            peri__reg u = a0[k]; \
            PERI__COLUMNS(PERI__STEP1) \
        } \
        PERI__COLUMNS(END1) \
    }

PERI__TILE_DEFINE(set, PERI__SET2, PERI__SET1)
PERI__TILE_DEFINE(add, PERI__ADD2, PERI__ADD1)

/* Where entry (row, c) of a panel stands. */
PERI__INLINE size_t peri__entry(const peri__panel *p, int row, int c) {
    size_t block = (size_t)(row / PERI__REGISTER), lane = (size_t)(row % PERI__REGISTER);
    return (block * (size_t)p->width + (size_t)c) * PERI__REGISTER + lane;
}

/* Rows row .. row + count - 1 of a panel's first `depth` columns, side by side; what lacks to a tile is 0. */
static void peri__pack(const peri_real *value, const peri__panel *p, int depth, int row, int count,
                       peri_real *PERI__RESTRICT b) {
    int k, j;
    for (j = 0; j < PERI__TILE; j++) {
        const peri_real *from;
        if (j >= count) {
            for (k = 0; k < depth; k++) b[k * PERI__TILE + j] = 0;
            continue;
        }
        from = value + peri__entry(p, row + j, 0);
        for (k = 0; k < depth; k++) b[k * PERI__TILE + j] = from[k * PERI__REGISTER];
    }
}

/* Adds `count` columns of a block in the tile to the rows where they belong: rows k .. end - 1 of the block. A whole
   tile of neighbouring columns is what most products are. */
static void peri__scatter(const peri_real *PERI__RESTRICT tile, const int *rows, int k, int end, int count,
                          const int *PERI__RESTRICT place, int from, peri_real *PERI__RESTRICT to,
                          const int *column) {
    int j;
    if (count == PERI__TILE && column[count - 1] - column[0] == count - 1) {
        for (; k < end; k++) {
            peri_real *PERI__RESTRICT at = to + place[rows[k] - from];
            for (j = 0; j < PERI__TILE; j++) at[j * PERI__REGISTER] += tile[j * PERI__REGISTER + k];
        }
        return;
    }
    for (; k < end; k++) {
        peri_real *at = to + place[rows[k] - from];
        for (j = 0; j < count; j++) at[(column[j] - column[0]) * PERI__REGISTER] += tile[j * PERI__REGISTER + k];
    }
}

/* Products of the rows from `row` on, by a tile of columns, straight to where they belong: the rows of both panels are
   the same, `shift` registers apart. */
static void peri__update_straight(const peri_real *value, const peri__panel *p, int depth, peri_real *target,
                                  const peri__panel *to, int row, int shift, const peri_real *right) {
    const peri__reg *a = (const peri__reg *)(const void *)value;
    int block = row / PERI__REGISTER, blocks = (p->height + PERI__REGISTER - 1) / PERI__REGISTER;
    ptrdiff_t from = p->width, step = to->width;
    peri__reg *c = (peri__reg *)(void *)target + (block - shift) * step + (row - shift * PERI__REGISTER);
    a += block * from;
    for (; block + 1 < blocks; block += 2, a += 2 * from, c += 2 * step)
        peri__tile2_add(depth, a, a + from, right, c, c + step);
    if (block < blocks) peri__tile1_add(depth, a, right, c);
}

/* Adds `count` columns of a whole block in the tile whose rows follow each other in the other panel too, the first one
   in `lane` of a block there, at `to`; the next block stands `next` registers on. Whole registers are added, of which
   some lanes go to one block and the others to the next. */
static void peri__scatter_run(const peri_real *tile, int count, peri_real *to, ptrdiff_t next, int lane,
                              const int *column) {
    int j;
    to -= lane;
    for (j = 0; j < count; j++, tile += PERI__REGISTER) {
        peri__reg *at = (peri__reg *)(void *)(to + (column[j] - column[0]) * PERI__REGISTER);
#ifdef PERI__VECTOR
        static const peri__mask_of upper[32] = {0,  0,  0,  0,  0,  0,  0,  0,  0,  0,  0,  0,  0,  0,  0,  0,
                                                -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1};
        if (lane) {
            peri__mask mask, low, high;
            memcpy(&mask, upper + 16 - lane, sizeof mask);
            memcpy(&low, tile - lane, sizeof low);
            memcpy(&high, tile - lane + PERI__REGISTER, sizeof high);
            at[0] += (peri__reg)(low & mask);
            at[next] += (peri__reg)(high & ~mask);
            continue;
        }
#endif
        at[0] += *(const peri__reg *)(const void *)tile;
    }
    (void)next;     /* registers of one number have no lanes to share out */
}

/* Adds rows k .. end - 1 of a block in the tile; those from row `inner` of the block on are of the top. */
static void peri__scatter_block(const peri_cholesky *f, const peri_real *tile, const int *rows, int k, int end,
                                int inner, int count, const peri__bench *w, const peri__panel *p, peri_real *to,
                                const int *column) {
    inner = inner < k ? k : inner > end ? end : inner;
    if (end - k == PERI__REGISTER && rows[end - 1] - rows[k] == end - 1 - k && (inner == k || inner == end)) {
        int at = inner == end ? w->place[rows[k]] : w->top[rows[k] - f->s->part[PERI__PARTS]];
        peri__scatter_run(tile, count, to + at, p->width, at % PERI__REGISTER, column);
        return;
    }
    if (k < inner) peri__scatter(tile, rows, k, inner, count, w->place, 0, to, column);
    if (inner < end) peri__scatter(tile, rows, inner, end, count, w->top, f->s->part[PERI__PARTS], to, column);
}

static void peri__update_scattered(const peri_cholesky *f, const peri__panel *p, const peri__panel *to, int row,
                                   int count, const peri__bench *w) {
    const peri__reg *a = (const peri__reg *)(const void *)(f->value + p->at);
    const int *rows = f->s->rows + p->row;
    peri_real *target = f->value + to->at + (rows[row] - to->first) * PERI__REGISTER;
    peri__reg *tile = (peri__reg *)(void *)w->tile;
    int block, blocks = (p->height + PERI__REGISTER - 1) / PERI__REGISTER, k;
    int inner = to->part == PERI__PARTS ? p->height : p->inner;
    for (block = row / PERI__REGISTER; block < blocks; block += 2) {
        int begin = block * PERI__REGISTER, half = begin + PERI__REGISTER, first = row > begin ? row - begin : 0;
        if (block + 1 < blocks) {
            peri__tile2_set(p->width, a + (ptrdiff_t)block * p->width, a + (ptrdiff_t)(block + 1) * p->width, w->right,
                            tile, tile + PERI__TILE);
            k = p->height - half < PERI__REGISTER ? p->height - half : PERI__REGISTER;
            peri__scatter_block(f, w->tile + PERI__TILE * PERI__REGISTER, rows + half, 0, k, inner - half, count, w,
                                to, target, rows + row);
        } else {
            peri__tile1_set(p->width, a + (ptrdiff_t)block * p->width, w->right, tile);
        }
        k = p->height - begin < PERI__REGISTER ? p->height - begin : PERI__REGISTER;
        peri__scatter_block(f, w->tile, rows + begin, first, k, inner - begin, count, w, to, target, rows + row);
    }
}

/* Takes from columns begin .. end - 1 of panel `to` what an earlier one gives them. */
static void peri__update(const peri_cholesky *f, const peri__panel *to, const peri__pair *pair, int begin, int end,
                         const peri__bench *w) {
    const peri__panel *p = f->s->panel + pair->from;
    const int *rows = f->s->rows + p->row;
    int row = pair->row, count = 0, shift, same, j;
    while (row < p->height && rows[row] < begin) row++;
    while (row + count < p->height && rows[row + count] < end) count++;
    if (!count) return;
    shift = row - (rows[row] - to->first);
    same = shift % PERI__REGISTER == 0 && p->height - row == to->height - (rows[row] - to->first);
    for (j = 0; j < count; j += PERI__TILE) {
        int n = count - j < PERI__TILE ? count - j : PERI__TILE;
        peri__pack(f->value + p->at, p, p->width, row + j, n, w->right);
        if (same && n == PERI__TILE)
            peri__update_straight(f->value + p->at, p, p->width, f->value + to->at, to, row + j, shift / PERI__REGISTER,
                                  w->right);
        else peri__update_scattered(f, p, to, row + j, n, w);
    }
}

/* The lower triangle of A's columns into a cleared panel, and the places of its rows. */
static void peri__assemble(const peri_cholesky *f, const peri_matrix *a, const peri__panel *p, const peri__bench *w) {
    const peri__symbolic *s = f->s;
    const int *rows = s->rows + p->row;
    peri_real *value = f->value + p->at;
    int blocks = (p->height + PERI__REGISTER - 1) / PERI__REGISTER, k, c, e, *place = w->place;
    int from = p->part == PERI__PARTS ? s->n : s->part[PERI__PARTS]; /* the first row whose place is in w->top */
    memset(value, 0, (size_t)blocks * (size_t)p->width * PERI__REGISTER * sizeof *value);
    for (k = 0; k < p->inner; k++) place[rows[k]] = (int)peri__entry(p, k, 0);
    for (; k < p->height; k++) w->top[rows[k] - from] = (int)peri__entry(p, k, 0);
    for (c = 0; c < p->width; c++) {
        int row = s->order[p->first + c];
        value[place[p->first + c] + c * PERI__REGISTER] = a->diagonal[row];
        for (e = a->row[row]; e < a->row[row + 1]; e++) {
            int i = s->place[a->col[e]];
            if (i >= from) value[w->top[i - from] + c * PERI__REGISTER] = a->value[e];
            else if (i > p->first + c) value[place[i] + c * PERI__REGISTER] = a->value[e];
        }
    }
}

/* Cholesky of the n x n block at (c, c) of a panel, into l, with the inverses of its diagonal; returns the column whose
   pivot is not positive, or n. */
static int peri__small_factor(const peri_real *value, const peri__panel *p, int c, int n,
                              peri_real l[PERI__TILE][PERI__TILE], peri_real inverse[PERI__TILE], double *pivot) {
    int i, j, k;
    for (j = 0; j < n; j++)
        for (i = j; i < n; i++) {
            double x = (double)value[peri__entry(p, c + i, c + j)];
            for (k = 0; k < j; k++) x -= (double)l[i][k] * (double)l[j][k];
            if (i > j) {
                l[i][j] = (peri_real)(x * (double)inverse[j]);
                continue;
            }
            *pivot = x;
            inverse[j] = (peri_real)(1 / sqrt(x));
            if (!(x > 0) || !peri__finite(x) || !peri__finite((double)inverse[j])) return j;
        }
    return n;
}

/* The inverse of l in its place in the panel: a solve multiplies with it, which needs no column to wait for another. */
static void peri__small_invert(peri_real *value, const peri__panel *p, int c, int n,
                               peri_real l[PERI__TILE][PERI__TILE], const peri_real inverse[PERI__TILE]) {
    double m[PERI__TILE][PERI__TILE];
    int i, j, k;
    for (j = 0; j < n; j++) {
        m[j][j] = (double)inverse[j];
        for (i = j + 1; i < n; i++) {
            double x = 0;
            for (k = j; k < i; k++) x -= (double)l[i][k] * m[k][j];
            m[i][j] = x * (double)inverse[i];
        }
        for (i = 0; i < n; i++) value[peri__entry(p, c + i, c + j)] = i < j ? 0 : (peri_real)m[i][j];
    }
}

/* Rows of `n` columns of a panel, from the block of row c on, times the inverse of l^T. */
static void peri__small_solve(peri__reg *x, int step, int blocks, int n, peri_real l[PERI__TILE][PERI__TILE],
                              const peri_real inverse[PERI__TILE]) {
    int j, k;
    for (; blocks > 0; blocks--, x += step)
        for (j = 0; j < n; j++) {
            peri__reg t = x[j];
            for (k = 0; k < j; k++) t = peri__less(t, x[k], peri__splat(l[j][k]));
            x[j] = t * peri__splat(inverse[j]);
        }
}

/* Takes from columns c .. c + n - 1 of a panel what its columns before them give. */
static void peri__panel_update(peri_real *value, const peri__panel *p, int c, int n, const peri__bench *w) {
    const peri__reg *a = (const peri__reg *)(const void *)value;
    peri__reg *tile = (peri__reg *)(void *)w->tile, *to = (peri__reg *)(void *)value + c;
    ptrdiff_t step = p->width;
    int block = c / PERI__REGISTER, blocks = (p->height + PERI__REGISTER - 1) / PERI__REGISTER, j;
    peri__pack(value, p, c, c, n, w->right);
    if (n == PERI__TILE) {
        peri__update_straight(value, p, c, value, p, c, 0, w->right);
        return;
    }
    for (; block < blocks; block++) {
        peri__tile1_set(c, a + block * step, w->right, tile);
        for (j = 0; j < n; j++) to[block * step + j] += tile[j];
    }
}

/* Factorises a panel that has all it gets from others; 0 when a pivot is not positive. */
static int peri__panel_factor(const peri_cholesky *f, const peri__panel *p, peri__bench *w) {
    peri_real *value = f->value + p->at, l[PERI__TILE][PERI__TILE], inverse[PERI__TILE];
    peri__reg *x = (peri__reg *)(void *)value;
    int blocks = (p->height + PERI__REGISTER - 1) / PERI__REGISTER, c, k, n;
    for (c = 0; c < p->width; c += PERI__TILE) {
        n = p->width - c < PERI__TILE ? p->width - c : PERI__TILE;
        if (c) peri__panel_update(value, p, c, n, w);
        k = peri__small_factor(value, p, c, n, l, inverse, &w->pivot);
        if (k < n) {
            w->failed = p->first + c + k;
            return 0;
        }
        k = c / PERI__REGISTER;
        peri__small_solve(x + (ptrdiff_t)k * p->width + c, p->width, blocks - k, n, l, inverse);
        peri__small_invert(value, p, c, n, l, inverse);
    }
    for (c = PERI__TILE; c < p->width; c++)
        for (k = 0; k < c / PERI__TILE * PERI__TILE; k++) value[peri__entry(p, k, c)] = 0;
    return 1;
}

/* A factorisation under way. */
typedef struct peri__factoring {
    peri_cholesky *f;
    const peri_matrix *a;
    const peri__panel *panel;       /* of the top */
    size_t pair, pair_end;
    peri__bench bench[PERI__PARTS];
} peri__factoring;

#define PERI__CHUNK (PERI__WIDTH / PERI__PARTS) /* columns of a panel of the top that one task updates */

static void peri__chunk_task(int begin, int end, void *context) {
    peri__factoring *t = (peri__factoring *)context;
    for (; begin < end; begin++) {
        peri__bench w = t->bench[begin];
        int first = t->panel->first + begin * PERI__CHUNK, last = t->panel->first + t->panel->width;
        size_t k;
        if (last > first + PERI__CHUNK) last = first + PERI__CHUNK;
        for (k = t->pair; k < t->pair_end; k++) peri__update(t->f, t->panel, t->f->s->pair + k, first, last, &w);
    }
}

/* Makes panel j. In the top, where panels follow from each other, its columns are shared out; so they are without
   threads, for the same bits. */
static int peri__panel_make(peri__factoring *t, int j, peri__bench *w) {
    const peri__symbolic *s = t->f->s;
    const peri__panel *p = s->panel + j;
    size_t k;
    peri__assemble(t->f, t->a, p, w);
    if (p->part == PERI__PARTS && s->begin[PERI__PARTS] > 0) {
        t->panel = p;
        t->pair = s->pairs[j];
        t->pair_end = s->pairs[j + 1];
        peri_parallel_for(&t->f->parallel, (p->width + PERI__CHUNK - 1) / PERI__CHUNK, 1, peri__chunk_task, t);
    } else {
        for (k = s->pairs[j]; k < s->pairs[j + 1]; k++)
            peri__update(t->f, p, s->pair + k, p->first, p->first + p->width, w);
    }
    return peri__panel_factor(t->f, p, w);
}

/* Parts, or the top: the panels that are marked. */
static void peri__part_task(int begin, int end, void *context) {
    peri__factoring *t = (peri__factoring *)context;
    for (; begin < end; begin++) {
        peri__bench *w = t->bench + begin % PERI__PARTS;
        int j, good = 1;
        for (j = t->f->s->begin[begin]; j < t->f->s->begin[begin + 1] && good; j++)
            if (t->f->mark[j]) good = peri__panel_make(t, j, w);
    }
}

/* Makes the marked panels. */
static peri_result peri__make(peri_cholesky *f, const peri_matrix *a, peri_error *err) {
    peri__factoring t;
    int k;
    memset(&t, 0, sizeof t);
    t.f = f;
    t.a = a;
    for (k = 0; k < PERI__PARTS; k++) t.bench[k] = peri__bench_of(f, f->s->begin[PERI__PARTS] > 0 ? k : 0);
    peri_parallel_for(&f->parallel, PERI__PARTS, 1, peri__part_task, &t);
    for (k = 0; k < PERI__PARTS && t.bench[k].failed < 0;) k++;
    if (k == PERI__PARTS) peri__part_task(PERI__PARTS, PERI__PARTS + 1, &t);
    for (k = 0; k < PERI__PARTS && t.bench[k].failed < 0;) k++;
    f->ready = k == PERI__PARTS;
    f->failed = f->ready ? -1 : f->s->order[t.bench[k].failed];
    if (f->ready) return peri__succeed(err);
    return peri__fail(err, PERI_ERROR_PIVOT,
                      "cholesky: the pivot of row %d is %g (its diagonal entry %g); the matrix is not positive "
                      "definite",
                      f->failed, t.bench[k].pivot, (double)a->diagonal[f->failed]);
}

static peri_result peri__factor_check(const peri_cholesky *f, const peri_matrix *a, peri_error *err) {
    if (!f || !a) return peri__fail(err, PERI_ERROR_ARGUMENT, "cholesky: %s is NULL", f ? "the matrix" : "the factor");
    if (a->n != f->s->n || peri__pattern(a) != f->s->pattern)
        return peri__fail(err, PERI_ERROR_ARGUMENT,
                          "cholesky: the matrix (n is %d) has another pattern than the one analysed (n is %d)", a->n,
                          f->s->n);
    if (a->n > 0 && (!a->diagonal || (!a->value && a->row[a->n] > 0)))
        return peri__fail(err, PERI_ERROR_ARGUMENT, "cholesky: the matrix has no %s",
                          a->diagonal ? "value" : "diagonal");
    return PERI_OK;
}

peri_result peri_cholesky_factor(peri_cholesky *f, const peri_matrix *a, peri_error *err) {
    peri_result bad;
    if (f) f->ready = 0;
    bad = peri__factor_check(f, a, err);
    if (bad) return bad;
    memset(f->mark, 1, (size_t)f->s->panels);
    return peri__make(f, a, err);
}

/* The panel that column j belongs to. */
static int peri__panel_of(const peri__symbolic *s, int j) {
    int low = 0, high = s->panels - 1;
    while (low < high) {
        int middle = (low + high + 1) / 2;
        if (s->panel[middle].first <= j) low = middle; else high = middle - 1;
    }
    return low;
}

peri_result peri_cholesky_update(peri_cholesky *f, const peri_matrix *a, int count, const int *rows, peri_error *err) {
    const peri__symbolic *s;
    peri_result bad = peri__factor_check(f, a, err);
    int i, j, k, e;
    if (bad) return bad;
    if (!rows && count > 0) return peri__fail(err, PERI_ERROR_ARGUMENT, "cholesky: rows is NULL");
    s = f->s;
    for (i = 0; i < count; i++)
        if (rows[i] < 0 || rows[i] >= s->n)
            return peri__fail(err, PERI_ERROR_INDEX, "cholesky: row %d is outside [0, %d)", rows[i], s->n);
    if (!f->ready) return peri_cholesky_factor(f, a, err);
    memset(f->mark, 0, (size_t)s->panels);
    for (i = 0; i < count; i++) { /* an entry stands in the earlier of its two columns */
        j = s->place[rows[i]];
        f->mark[peri__panel_of(s, j)] = 1;
        for (e = a->row[rows[i]]; e < a->row[rows[i] + 1]; e++)
            if (s->place[a->col[e]] < j) f->mark[peri__panel_of(s, s->place[a->col[e]])] = 1;
    }
    for (j = 0; j < s->panels; j++) { /* and what depends on it: up the tree */
        const peri__panel *p = s->panel + j;
        if (!f->mark[j] || p->height == p->width) continue;
        k = peri__panel_of(s, s->rows[p->row + (size_t)p->width]);
        f->mark[k] = 1;
    }
    return peri__make(f, a, err);
}

/* -- solves: L's blocks stream by once down and once up; of x, rows that a panel has are gathered and scattered -- */

#define PERI__SIDES 3   /* right-hand sides that go through L together */

/* Right-hand sides on their way through L, one (row i is x[i]) or three (row i is the quad x[4 i], whose last number
   stays 0: so a row is moved at once). Of `lines` tasks, which go down the parts by turns, each but the first has sums
   of its own for the rows of the top. */
typedef struct peri__sides {
    const peri_cholesky *f;
    peri_real *x, *top;     /* top: the second line's sums */
    int n, tall, row;       /* tall: rows of the top; row: numbers that a row has */
    int lines;
    void (*down)(const struct peri__sides *t, const peri__panel *p, peri_real *top);
    void (*up)(const struct peri__sides *t, const peri__panel *p);
} peri__sides;

/* The lanes of a block that hold rows below the panel's own: first .. end - 1. */
PERI__INLINE int peri__lanes_first(const peri__panel *p, int block) {
    return p->width > block * PERI__REGISTER ? p->width - block * PERI__REGISTER : 0;
}

PERI__INLINE int peri__lanes_end(const peri__panel *p, int block) {
    return p->height - block * PERI__REGISTER < PERI__REGISTER ? p->height - block * PERI__REGISTER : PERI__REGISTER;
}

PERI__INLINE int peri__blocks(int rows) { return (rows + PERI__REGISTER - 1) / PERI__REGISTER; }

/* How far row i < PERI__TILE of a tile is from its first: a tile fits into a block, or has several. */
#define PERI__BELOW(i, width) \
    (PERI__REGISTER >= PERI__TILE ? (i) : (i) / PERI__REGISTER * (width) * PERI__REGISTER + (i) % PERI__REGISTER)

/* One right-hand side: a register holds it in as many rows. */

/* out = -L y for two blocks of rows a and b. */
static void peri__product1(int width, const peri__reg *PERI__RESTRICT a, const peri__reg *PERI__RESTRICT b,
                           const peri_real *PERI__RESTRICT y, peri__reg *PERI__RESTRICT out) {
    peri__reg s = peri__splat(0), t = s;
    int c;
    for (c = 0; c < width; c++) {
        PERI__PREFETCH(a + c + 2 * width)
        PERI__PREFETCH(b + c + 2 * width)
        s = peri__less(s, a[c], peri__splat(y[c]));
        t = peri__less(t, b[c], peri__splat(y[c]));
    }
    out[0] = s;
    out[1] = t;
}

/* sum -= L^T x for the same. */
static void peri__dots1(int width, const peri__reg *PERI__RESTRICT a, const peri__reg *PERI__RESTRICT b,
                        const peri__reg *PERI__RESTRICT x, peri__reg *PERI__RESTRICT sum) {
    const peri__reg s = x[0], t = x[1];
    int c;
    for (c = 0; c < width; c++) {
        PERI__PREFETCH(a + c + 2 * width)
        PERI__PREFETCH(b + c + 2 * width)
        sum[c] = peri__less(peri__less(sum[c], a[c], s), b[c], t);
    }
}

/* x[rows] += v in the lanes that hold rows below. */
static void peri__block_add1(const int *PERI__RESTRICT rows, int first, int end, const peri__reg *v,
                             peri_real *PERI__RESTRICT x) {
    const peri_real *PERI__RESTRICT from = (const peri_real *)(const void *)v;
    int k;
    if (first == 0 && end == PERI__REGISTER && rows[end - 1] - rows[0] == end - 1) { /* neighbours */
        for (k = 0; k < PERI__REGISTER; k++) x[rows[0] + k] += from[k];
        return;
    }
    for (k = first; k < end; k++) x[rows[k]] += from[k];
}

/* v = x[rows], 0 in the lanes that do not hold rows below. */
static void peri__block_get1(const peri__sides *t, const peri__panel *p, int block, peri__reg *v) {
    const int *PERI__RESTRICT rows = t->f->s->rows + p->row + block * PERI__REGISTER;
    int first = peri__lanes_first(p, block), end = peri__lanes_end(p, block), k;
    peri_real *PERI__RESTRICT to = (peri_real *)(void *)v;
    if (first == 0 && end == PERI__REGISTER) {
        if (rows[end - 1] - rows[0] == end - 1) memcpy(to, t->x + rows[0], sizeof *v);
        else for (k = 0; k < PERI__REGISTER; k++) to[k] = t->x[rows[k]];
        return;
    }
    *v = peri__splat(0);
    for (k = first; k < end; k++) to[k] = t->x[rows[k]];
}

/* y = L^-1 y for the panel's own columns, a tile at a time. */
static void peri__own_down1(const peri__reg *value, int width, peri_real *y) {
    peri__reg out[2];
    peri_real z[PERI__TILE];
    const peri_real *lane = (const peri_real *)(const void *)out;
    int blocks = peri__blocks(width), c, b, k, n;
    for (c = 0; c < width; c += PERI__TILE) {
        n = width - c < PERI__TILE ? width - c : PERI__TILE;
        for (b = c / PERI__REGISTER; b * PERI__REGISTER < c + n; b++) { /* the inverse of its block */
            const peri__reg *v = value + (ptrdiff_t)b * width + c;
            int begin = b * PERI__REGISTER < c ? c - b * PERI__REGISTER : 0;
            int end = (b + 1) * PERI__REGISTER > c + n ? c + n - b * PERI__REGISTER : PERI__REGISTER;
            peri__product1(n, v, v, y + c, out);
            for (k = begin; k < end; k++) z[b * PERI__REGISTER + k - c] = -lane[k];
        }
        for (k = 0; k < n; k++) y[c + k] = z[k];
        for (b = (c + n) / PERI__REGISTER; b < blocks; b++) { /* what it gives to the columns after it */
            const peri__reg *v = value + (ptrdiff_t)b * width + c;
            peri__product1(n, v, v, y + c, out);
            for (k = b * PERI__REGISTER < c + n ? c + n - b * PERI__REGISTER : 0; k < PERI__REGISTER; k++)
                y[b * PERI__REGISTER + k] += lane[k];
        }
    }
}

/* x = L^-1 x: a panel's own columns, then the rows below, two blocks at a time. */
static void peri__down1(const peri__sides *t, const peri__panel *p, peri_real *top) {
    const peri__reg *value = (const peri__reg *)(const void *)(t->f->value + p->at);
    int blocks = peri__blocks(p->height), b, k;
    peri__reg own[PERI__WIDTH / PERI__REGISTER], out[2];
    peri_real *y = (peri_real *)(void *)own;
    memcpy(y, t->x + p->first, (size_t)p->width * sizeof *y);
    for (k = p->width; k % PERI__REGISTER; k++) y[k] = 0;
    peri__own_down1(value, p->width, y);
    memcpy(t->x + p->first, y, (size_t)p->width * sizeof *y);
    for (b = p->width / PERI__REGISTER; b < blocks; b += 2) {
        const peri__reg *one = value + (ptrdiff_t)b * p->width;
        peri__product1(p->width, one, b + 1 < blocks ? one + p->width : one, y, out);
        for (k = 0; k < 2 && b + k < blocks; k++) {
            const int *rows = t->f->s->rows + p->row + (b + k) * PERI__REGISTER;
            int first = peri__lanes_first(p, b + k), end = peri__lanes_end(p, b + k);
            int inner = p->inner - (b + k) * PERI__REGISTER;
            inner = inner < first ? first : inner > end ? end : inner;
            if (first < inner) peri__block_add1(rows, first, inner, out + k, t->x);
            if (inner < end) peri__block_add1(rows, inner, end, out + k, top);
        }
    }
}

/* Sum of the lanes, always in the same order. */
PERI__INLINE peri_real peri__lanes_sum(const peri__reg *v) {
#ifdef PERI__VECTOR
    typedef peri_real quarter __attribute__((vector_size(16), may_alias));
    const quarter *a = (const quarter *)(const void *)v;
    quarter s = a[0];
    if (PERI__VECTOR == 32) s = a[0] + a[PERI__VECTOR / 16 - 1];
    if (PERI__VECTOR == 64) s = (a[0] + a[PERI__VECTOR / 32]) + (a[PERI__VECTOR / 64] + a[PERI__VECTOR / 16 - 1]);
#ifdef PERI_DOUBLE
    return s[0] + s[1];
#else
    return (s[0] + s[2]) + (s[1] + s[3]);
#endif
#else
    return *v;
#endif
}

/* x = L^-T x: the rows below give to the panel's own columns, which then follow from each other by tiles, the last
   first. */
static void peri__up1(const peri__sides *t, const peri__panel *p) {
    const peri_real *value = t->f->value + p->at;
    const peri__reg *blocks_of = (const peri__reg *)(const void *)value;
    peri__reg sum[PERI__WIDTH], own[PERI__WIDTH / PERI__REGISTER], in[2];
    peri_real *done = (peri_real *)(void *)own, x[PERI__TILE]; /* done: 0 where not yet */
    int blocks = peri__blocks(p->height), inside = peri__blocks(p->width), b, c, n, i, k;
    memset(sum, 0, (size_t)p->width * sizeof *sum);
    memset(own, 0, (size_t)inside * sizeof *own);
    for (b = p->width / PERI__REGISTER; b < blocks; b += 2) {
        const peri__reg *one = blocks_of + (ptrdiff_t)b * p->width;
        peri__block_get1(t, p, b, in);
        if (b + 1 < blocks) peri__block_get1(t, p, b + 1, in + 1); else in[1] = peri__splat(0);
        peri__dots1(p->width, one, b + 1 < blocks ? one + p->width : one, in, sum);
    }
    for (c = (p->width - 1) / PERI__TILE * PERI__TILE; c >= 0; c -= PERI__TILE) {
        n = p->width - c < PERI__TILE ? p->width - c : PERI__TILE;
        for (b = (c + n) / PERI__REGISTER; b < inside; b += 2) {
            const peri__reg *one = blocks_of + (ptrdiff_t)b * p->width + c;
            in[0] = own[b];
            in[1] = b + 1 < inside ? own[b + 1] : peri__splat(0);
            peri__dots1(n, one, b + 1 < inside ? one + p->width : one, in, sum + c);
        }
        for (k = 0; k < n; k++) x[k] = t->x[p->first + c + k] + peri__lanes_sum(sum + c + k);
        for (k = 0; k < n; k++)
            for (i = k; i < n; i++)
                done[c + k] += value[peri__entry(p, c, c + k) + (size_t)PERI__BELOW(i, p->width)] * x[i];
    }
    memcpy(t->x + p->first, done, (size_t)p->width * sizeof *done);
}

/* Three right-hand sides: a register has PERI__GROUP quads, or a quad has PERI__SHARDS registers, so that products need
   no sums over lanes. The quads of a block's rows are four registers. */
#if defined(PERI__VECTOR) && defined(__AVX512F__) && !defined(PERI_DOUBLE)
#define PERI__GROUP 4
#elif defined(PERI__VECTOR) && (defined(__AVX512F__) || (defined(__AVX__) && !defined(PERI_DOUBLE)))
#define PERI__GROUP 2
#else
#define PERI__GROUP 1
#endif
#define PERI__SHARDS (PERI__GROUP > 1 || PERI__REGISTER >= 4 ? 1 : 4 / PERI__REGISTER)
#define PERI__BLOCK (4 * PERI__REGISTER) /* numbers in the quads of a block's rows */

#ifdef PERI__VECTOR
#define PERI__SHARD_BYTES (PERI__VECTOR < 4 * sizeof(peri_real) ? PERI__VECTOR : 4 * sizeof(peri_real))
typedef peri_real peri__shard __attribute__((vector_size(PERI__SHARD_BYTES), aligned(sizeof(peri_real)), may_alias));
#else
typedef peri_real peri__shard;
#endif

/* SPREAD: row of a block's column that the register r of its quads is about, four times each. EVERY: shard h of a quad,
   for each row. GATHER: register r of the quads at x[0], x[1] .. (maskz, all lanes: in the forms without, g++ finds
   something uninitialised.) */
#if PERI__GROUP == 4
#define PERI__SPREAD_BY const __m512i by = _mm512_set_epi32(3, 3, 3, 3, 2, 2, 2, 2, 1, 1, 1, 1, 0, 0, 0, 0);
#define PERI__SPREAD(l, r) \
    (peri__reg)_mm512_maskz_permutevar_ps(65535, _mm512_maskz_broadcast_f32x4(65535, _mm_loadu_ps((l) + 4 * (r))), by)
#define PERI__EVERY(y, h) (peri__reg)_mm512_maskz_broadcast_f32x4(65535, _mm_loadu_ps(y))
#define PERI__GATHER(x, r) \
    (peri__reg)_mm512_insertf32x4(_mm512_insertf32x4(_mm512_insertf32x4(_mm512_castps128_ps512(_mm_loadu_ps((x)[0])), \
    _mm_loadu_ps((x)[1]), 1), _mm_loadu_ps((x)[2]), 2), _mm_loadu_ps((x)[3]), 3)
#elif PERI__GROUP == 2 && defined(PERI_DOUBLE)
#define PERI__SPREAD_BY const __m512i by = _mm512_set_epi64(1, 1, 1, 1, 0, 0, 0, 0);
#define PERI__SPREAD(l, r) \
    (peri__reg)_mm512_maskz_permutexvar_pd(255, _mm512_add_epi64(by, _mm512_set1_epi64(2 * (r))), _mm512_loadu_pd(l))
#define PERI__EVERY(y, h) (peri__reg)_mm512_maskz_broadcast_f64x4(255, _mm256_loadu_pd(y))
#define PERI__GATHER(x, r) \
    (peri__reg)_mm512_maskz_insertf64x4(255, _mm512_castpd256_pd512(_mm256_loadu_pd((x)[0])), \
    _mm256_loadu_pd((x)[1]), 1)
#elif PERI__GROUP == 2
#define PERI__SPREAD_BY \
    const __m256i by[2] = {_mm256_set_epi32(1, 1, 1, 1, 0, 0, 0, 0), _mm256_set_epi32(3, 3, 3, 3, 2, 2, 2, 2)};
#define PERI__SPREAD(l, r) \
    (peri__reg)_mm256_permutevar_ps(_mm256_broadcast_ps((const __m128 *)(const void *)((l) + (r) / 2 * 4)), by[(r) % 2])
#define PERI__EVERY(y, h) (peri__reg)_mm256_broadcast_ps((const __m128 *)(const void *)(y))
#define PERI__GATHER(x, r) \
    (peri__reg)_mm256_insertf128_ps(_mm256_castps128_ps256(_mm_loadu_ps((x)[0])), _mm_loadu_ps((x)[1]), 1)
#else
#define PERI__SPREAD_BY
#define PERI__SPREAD(l, r) peri__splat((l)[(r) / PERI__SHARDS])
#define PERI__EVERY(y, h) (peri__reg)*(const peri__shard *)(const void *)((y) + (h) * PERI__REGISTER)
#define PERI__GATHER(x, r) PERI__EVERY((x)[0], (r) % PERI__SHARDS)
#endif

#define PERI__ONE(x)
#define PERI__TWO(x) x
#define PERI__FOUR(op) op(0) op(1) op(2) op(3)
#define PERI__SUM_BEGIN(r) peri__reg s##r = peri__splat(0);
#define PERI__SUM_BEGIN2(r) peri__reg t##r = peri__splat(0);
#define PERI__SUM_STEP(r) s##r = peri__less(s##r, PERI__SPREAD(a, r), PERI__EVERY(y, r % PERI__SHARDS));
#define PERI__SUM_STEP2(r) t##r = peri__less(t##r, PERI__SPREAD(b, r), PERI__EVERY(y, r % PERI__SHARDS));
#define PERI__SUM_END(r) out[r] = s##r;
#define PERI__SUM_END2(r) out[4 + r] = t##r;
#define PERI__DOT_BEGIN(r) const peri__reg x##r = x[r];
#define PERI__DOT_BEGIN2(r) const peri__reg z##r = x[4 + r];
#define PERI__DOT_STEP(r) s[r % PERI__SHARDS] = peri__less(s[r % PERI__SHARDS], PERI__SPREAD(a, r), x##r);
#define PERI__DOT_STEP2(r) t[r % PERI__SHARDS] = peri__less(t[r % PERI__SHARDS], PERI__SPREAD(b, r), z##r);

/* out = -L y for a block of rows a, or two, a and b, and sum -= L^T x for them. */
#define PERI__QUADS_DEFINE(name, also) \
    static void peri__product##name(int width, const peri_real *PERI__RESTRICT a, const peri_real *PERI__RESTRICT b, \
                                    const peri_real *PERI__RESTRICT y, peri__reg *PERI__RESTRICT out) { \
        const ptrdiff_t ahead = 2 * (ptrdiff_t)width * PERI__REGISTER; \
        int c; \
        PERI__SPREAD_BY \
        PERI__FOUR(PERI__SUM_BEGIN) \
        also(PERI__FOUR(PERI__SUM_BEGIN2)) \
        (void)b; \
        (void)ahead; \
        for (c = 0; c < width; c++) { \
            PERI__PREFETCH(a + ahead) \
            also(PERI__PREFETCH(b + ahead)) \
            PERI__FOUR(PERI__SUM_STEP) \
            also(PERI__FOUR(PERI__SUM_STEP2)) \
            a += PERI__REGISTER; \
            also(b += PERI__REGISTER;) \
            y += 4; \
        } \
        PERI__FOUR(PERI__SUM_END) \
        also(PERI__FOUR(PERI__SUM_END2)) \
    } \
    static void peri__dots##name(int width, const peri_real *PERI__RESTRICT a, const peri_real *PERI__RESTRICT b, \
                                 const peri__reg *PERI__RESTRICT x, peri__reg *PERI__RESTRICT sum) { \
        const ptrdiff_t ahead = 2 * (ptrdiff_t)width * PERI__REGISTER; \
        int c, h; \
        PERI__SPREAD_BY \
        PERI__FOUR(PERI__DOT_BEGIN) \
        also(PERI__FOUR(PERI__DOT_BEGIN2)) \
        (void)b; \
        (void)ahead; \
        for (c = 0; c < width; c++) { \
            peri__reg s[PERI__SHARDS]; \
            also(peri__reg t[PERI__SHARDS];) \
            PERI__PREFETCH(a + ahead) \
            also(PERI__PREFETCH(b + ahead)) \
            for (h = 0; h < PERI__SHARDS; h++) s[h] = sum[h]; \
            also(for (h = 0; h < PERI__SHARDS; h++) t[h] = peri__splat(0);) \
            PERI__FOUR(PERI__DOT_STEP) \
            also(PERI__FOUR(PERI__DOT_STEP2)) \
            also(for (h = 0; h < PERI__SHARDS; h++) s[h] += t[h];) \
            for (h = 0; h < PERI__SHARDS; h++) sum[h] = s[h]; \
            a += PERI__REGISTER; \
            also(b += PERI__REGISTER;) \
            sum += PERI__SHARDS; \
        } \
    }

PERI__QUADS_DEFINE(3_one, PERI__ONE)
PERI__QUADS_DEFINE(3_two, PERI__TWO)

/* to += a; to = -a; to += l a, for quads; the last one for a sum in registers. */
typedef peri__shard peri__quad[PERI__SHARDS];

PERI__INLINE void peri__quad_add(peri_real *to, const peri_real *a) {
    peri__shard *into = (peri__shard *)(void *)to;
    const peri__shard *from = (const peri__shard *)(const void *)a;
    int h;
    for (h = 0; h < PERI__SHARDS; h++) into[h] += from[h];
}

PERI__INLINE void peri__quad_minus(peri_real *to, const peri_real *a) {
    peri__shard *into = (peri__shard *)(void *)to;
    const peri__shard *from = (const peri__shard *)(const void *)a;
    int h;
    for (h = 0; h < PERI__SHARDS; h++) into[h] = -from[h];
}

PERI__INLINE void peri__quad_share(peri__shard *to, peri_real l, const peri_real *a) {
    const peri__shard *from = (const peri__shard *)(const void *)a;
    int h;
    for (h = 0; h < PERI__SHARDS; h++) to[h] += l * from[h];
}

/* x[rows] += v for the rows begin .. end - 1 of a block. */
PERI__INLINE void peri__block_add3(const int *PERI__RESTRICT rows, int begin, int end, const peri__reg *v,
                                   peri_real *PERI__RESTRICT x) {
    const peri_real *PERI__RESTRICT from = (const peri_real *)(const void *)v;
    int k;
    if (end - begin == PERI__REGISTER)
        for (k = 0; k < PERI__REGISTER; k++) peri__quad_add(x + 4 * (ptrdiff_t)rows[k], from + 4 * k);
    else
        for (k = begin; k < end; k++) peri__quad_add(x + 4 * (ptrdiff_t)rows[k], from + 4 * k);
}

#ifdef PERI__VECTOR
#define PERI__QUAD_OF(i) i, i, i, i
#define PERI__QUADS_OF(i) PERI__QUAD_OF(i), PERI__QUAD_OF(i + 1), PERI__QUAD_OF(i + 2), PERI__QUAD_OF(i + 3)
#endif

/* v = x[rows] for the rows begin .. end - 1 of a block, 0 for the others, which are in the list too. */
PERI__INLINE void peri__block_get3(const peri_real *x, const int *rows, int begin, int end, peri__reg *v) {
    const peri_real *at[PERI__GROUP];
    int k, j;
    for (k = 0; k < 4; k++) {
        for (j = 0; j < PERI__GROUP; j++) at[j] = x + 4 * (ptrdiff_t)rows[PERI__GROUP * k / PERI__SHARDS + j];
        v[k] = PERI__GATHER(at, k);
    }
#ifdef PERI__VECTOR
    if (end - begin < PERI__REGISTER) {
        static const peri__mask_of row[64] = {PERI__QUADS_OF(0), PERI__QUADS_OF(4), PERI__QUADS_OF(8),
                                              PERI__QUADS_OF(12)};
        const peri__mask none = {0}, from = (peri__mask_of)begin - none, to = (peri__mask_of)end - none;
        for (k = 0; k < 4; k++) {
            peri__mask i;
            memcpy(&i, row + PERI__REGISTER * k, sizeof i);
            v[k] = (peri__reg)((peri__mask)v[k] & (peri__mask)(i >= from) & (peri__mask)(i < to));
        }
    }
#endif
}

/* y = L^-1 y for the panel's own columns, a tile at a time. */
static void peri__own_down3(const peri_real *value, int width, peri_real *y) {
    peri__reg out[4 * PERI__TILE];
    const peri_real *z = (const peri_real *)(const void *)out;
    int c, b, k, n;
    for (c = 0; c < width; c += PERI__TILE, y += 4 * PERI__TILE) {
        int begin = c / PERI__REGISTER * PERI__REGISTER;
        n = width - c < PERI__TILE ? width - c : PERI__TILE;
        for (b = c / PERI__REGISTER; b * PERI__REGISTER < c + n; b++) { /* the inverse of its block */
            const peri_real *v = value + ((ptrdiff_t)b * width + c) * PERI__REGISTER;
            peri__product3_one(n, v, v, y, out + 4 * (b - c / PERI__REGISTER));
        }
        for (k = 0; k < n; k++) peri__quad_minus(y + 4 * k, z + 4 * (c - begin + k));
        for (b = (c + n) / PERI__REGISTER; b * PERI__REGISTER < width && c + n < width; b++) { /* and the rest */
            const peri_real *v = value + ((ptrdiff_t)b * width + c) * PERI__REGISTER;
            int first = b * PERI__REGISTER < c + n ? c + n : b * PERI__REGISTER;
            int end = width < (b + 1) * PERI__REGISTER ? width : (b + 1) * PERI__REGISTER;
            peri__product3_one(n, v, v, y, out);
            for (k = first; k < end; k++) peri__quad_add(y + 4 * (k - c), z + 4 * (k - b * PERI__REGISTER));
        }
    }
}

static void peri__down3(const peri__sides *t, const peri__panel *p, peri_real *top) {
    const peri_real *value = t->f->value + p->at, *y = t->x + 4 * (ptrdiff_t)p->first;
    const int *list = t->f->s->rows + p->row;
    int blocks = peri__blocks(p->height), b, k;
    peri__reg out[8];
    peri__own_down3(value, p->width, t->x + 4 * (ptrdiff_t)p->first);
    if (p->width == p->height) return;
    for (b = p->width / PERI__REGISTER; b < blocks; b += 2) {
        const peri_real *one = value + (ptrdiff_t)b * p->width * PERI__REGISTER;
        if (b + 1 < blocks) peri__product3_two(p->width, one, one + p->width * PERI__REGISTER, y, out);
        else peri__product3_one(p->width, one, one, y, out);
        for (k = 0; k < 2 && b + k < blocks; k++) {
            const int *rows = list + (b + k) * PERI__REGISTER;
            int first = peri__lanes_first(p, b + k), end = peri__lanes_end(p, b + k);
            int inner = p->inner - (b + k) * PERI__REGISTER;
            inner = inner < first ? first : inner > end ? end : inner;
            if (first < inner) peri__block_add3(rows, first, inner, out + 4 * k, t->x);
            if (inner < end) peri__block_add3(rows, inner, end, out + 4 * k, top);
        }
    }
}

/* x = L^-T (x + sum) for a tile of n columns. */
PERI__INLINE void peri__tile_up3(const peri_real *value, const peri__panel *p, int c, int n, const peri__reg *sum,
                                 peri_real *x) {
    peri__shard z[PERI__SHARDS * PERI__TILE];
    peri_real *y = (peri_real *)(void *)z;
    int k, i, h;
    for (k = 0; k < n; k++) {
        const peri_real *part = (const peri_real *)(const void *)(sum + PERI__SHARDS * k);
        memcpy(y + 4 * k, x + 4 * k, 4 * sizeof *x);
        for (i = 0; i < PERI__GROUP; i++) peri__quad_add(y + 4 * k, part + 4 * i);
    }
    for (k = 0; k < n; k++) {
        const peri_real *l = value + peri__entry(p, c, c + k);
        for (h = 0; h < PERI__SHARDS; h++) {
            peri__shard s = l[0] * z[h];
            for (i = 1; i < n; i++) s += l[PERI__BELOW(i, p->width)] * z[PERI__SHARDS * i + h];
            memcpy(x + 4 * k + h * PERI__REGISTER, &s, sizeof s);
        }
    }
}

static void peri__up3(const peri__sides *t, const peri__panel *p) {
    const peri_real *value = t->f->value + p->at;
    const int *list = t->f->s->rows + p->row;
    peri_real *x = t->x + 4 * (ptrdiff_t)p->first;
    peri__reg sum[PERI__SHARDS * PERI__WIDTH], in[8];
    int blocks = peri__blocks(p->height), b, c, n;
    memset(sum, 0, PERI__SHARDS * (size_t)p->width * sizeof *sum);
    for (b = p->width / PERI__REGISTER; b < blocks && p->width < p->height; b += 2) {
        const peri_real *one = value + (ptrdiff_t)b * p->width * PERI__REGISTER;
        peri__block_get3(t->x, list + b * PERI__REGISTER, peri__lanes_first(p, b), peri__lanes_end(p, b), in);
        if (b + 1 < blocks) {
            peri__block_get3(t->x, list + (b + 1) * PERI__REGISTER, peri__lanes_first(p, b + 1),
                             peri__lanes_end(p, b + 1), in + 4);
            peri__dots3_two(p->width, one, one + p->width * PERI__REGISTER, in, sum);
        } else peri__dots3_one(p->width, one, one, in, sum);
    }
    for (c = (p->width - 1) / PERI__TILE * PERI__TILE; c >= 0; c -= PERI__TILE) {
        n = p->width - c < PERI__TILE ? p->width - c : PERI__TILE;
        for (b = (c + n) / PERI__REGISTER; b * PERI__REGISTER < p->width && c + n < p->width; b++) {
            const peri_real *one = value + ((ptrdiff_t)b * p->width + c) * PERI__REGISTER;
            int end = p->width - b * PERI__REGISTER, begin = c + n - b * PERI__REGISTER;
            peri__block_get3(t->x, list + b * PERI__REGISTER, begin < 0 ? 0 : begin,
                             end < PERI__REGISTER ? end : PERI__REGISTER, in);
            peri__dots3_one(n, one, one, in, sum + PERI__SHARDS * c);
        }
        peri__tile_up3(value, p, c, n, sum + PERI__SHARDS * c, x + 4 * c);
    }
}

/* Lines go down their parts, each with its sums of the top; what they are is added in order; then the top, and back. */
static void peri__down_task(int begin, int end, void *context) {
    const peri__sides *t = (const peri__sides *)context;
    const peri__symbolic *s = t->f->s;
    int j, part;
    for (; begin < end; begin++) {
        peri_real *top = t->x;
        if (begin) top = t->top + ((begin - 1) * (ptrdiff_t)t->tall - s->part[PERI__PARTS]) * t->row;
        for (part = begin; part < PERI__PARTS; part += t->lines)
            for (j = s->begin[part]; j < s->begin[part + 1]; j++) t->down(t, s->panel + j, top);
    }
}

static void peri__up_task(int begin, int end, void *context) {
    const peri__sides *t = (const peri__sides *)context;
    int j;
    for (; begin < end; begin++)
        for (j = t->f->s->begin[begin + 1] - 1; j >= t->f->s->begin[begin]; j--) t->up(t, t->f->s->panel + j);
}

static void peri__solve_sides(peri__sides *t) {
    const peri__symbolic *s = t->f->s;
    ptrdiff_t count = (ptrdiff_t)t->tall * t->row, i;
    int parts = s->begin[PERI__PARTS] > 0 ? PERI__PARTS : 0, j;
    peri_real *to = t->x + (ptrdiff_t)s->part[PERI__PARTS] * t->row;
    if (parts) {
        memset(t->top, 0, (size_t)(t->lines - 1) * (size_t)count * sizeof *t->top);
        peri_parallel_for(&t->f->parallel, t->lines, 1, peri__down_task, t);
        for (j = 0; j < t->lines - 1; j++)
            for (i = 0; i < count; i++) to[i] += t->top[j * count + i];
    }
    for (j = s->begin[PERI__PARTS]; j < s->panels; j++) t->down(t, s->panel + j, t->x);
    peri__up_task(PERI__PARTS, PERI__PARTS + 1, t);
    peri_parallel_for(&t->f->parallel, parts, 1, peri__up_task, t);
}

void peri_cholesky_solve(const peri_cholesky *f, int rhs, peri_real *x, peri_real *work) {
    peri__sides t;
    const int *order;
    int i, c, q, sides;
    PERI_ASSERT(f && f->ready && rhs >= 1);
    if (!f || !f->ready || !f->s->n) return;
    order = f->s->order;
    t.f = f;
    t.x = work;
    t.n = f->s->n;
    t.tall = t.n - f->s->part[PERI__PARTS];
    for (c = 0; c < rhs; c += sides) {
        sides = rhs - c >= PERI__SIDES ? PERI__SIDES : 1;
        t.row = sides == PERI__SIDES ? 4 : 1;
        t.down = sides == PERI__SIDES ? peri__down3 : peri__down1;
        t.up = sides == PERI__SIDES ? peri__up3 : peri__up1;
        t.lines = sides < PERI__SIDES || 6 * (ptrdiff_t)t.tall <= t.n ? PERI__PARTS : 2; /* as work has room for */
        t.top = work + (ptrdiff_t)t.row * t.n;
        for (i = 0; i < t.n; i++) {
            const peri_real *from = x + rhs * (ptrdiff_t)order[i] + c;
            for (q = 0; q < sides; q++) work[t.row * (ptrdiff_t)i + q] = from[q];
            if (t.row > sides) work[4 * (ptrdiff_t)i + 3] = 0;
        }
        peri__solve_sides(&t);
        for (i = 0; i < t.n; i++) {
            peri_real *to = x + rhs * (ptrdiff_t)order[i] + c;
            for (q = 0; q < sides; q++) to[q] = work[t.row * (ptrdiff_t)i + q];
        }
    }
}

double peri_cholesky_refine(const peri_cholesky *f, const peri_matrix *a, int rhs, const double *b, double *x,
                            peri_real *work) {
    double square = 0, size = 0;
    peri_real *r = work + 2 * (ptrdiff_t)(rhs < PERI__SIDES ? rhs : PERI__SIDES) * a->n;
    int i, k, c, n = a->n;
    PERI_ASSERT(f && f->ready && a->n == f->s->n);
    if (!f || !f->ready || a->n != f->s->n) return -1;
    for (i = 0; i < n; i++)
        for (c = 0; c < rhs; c++) {
            size_t at = (size_t)rhs * (size_t)i + (size_t)c;
            double sum = b[at] - (double)a->diagonal[i] * x[at];
            for (k = a->row[i]; k < a->row[i + 1]; k++)
                sum -= (double)a->value[k] * x[(size_t)rhs * (size_t)a->col[k] + (size_t)c];
            r[at] = (peri_real)sum;
            square += sum * sum;
            size += b[at] * b[at];
        }
    peri_cholesky_solve(f, rhs, r, work);
    for (i = 0; i < n; i++)
        for (c = 0; c < rhs; c++) {
            size_t at = (size_t)rhs * (size_t)i + (size_t)c;
            x[at] += (double)r[at];
        }
    return size > 0 ? sqrt(square / size) : sqrt(square);
}

void peri_cholesky_threads(peri_cholesky *f, const peri_parallel *par) {
    PERI_ASSERT(f);
    if (!f) return;
    memset(&f->parallel, 0, sizeof f->parallel);
    f->parallel.threads = 1;
    if (par) f->parallel = *par;
}

#endif /* PERI_NO_CHOLESKY */

/* ---- 6  L-BFGS --------------------------------------------------------------------------------------------------- */

void peri_lbfgs_begin(peri_lbfgs *l, int n, int m, peri_real *vectors) {
    PERI_ASSERT(l && n >= 0 && m >= 0 && m <= PERI_LBFGS_MAX);
    memset(l, 0, sizeof *l);
    l->n = n;
    l->m = m < 0 ? 0 : m > PERI_LBFGS_MAX ? PERI_LBFGS_MAX : m;
    l->s = vectors;
    l->y = vectors ? vectors + (ptrdiff_t)l->m * n : NULL;
}

/* A pair made where it will stay, s = share p and y = g1 - g (g NULL: p and g1 as they are), with its sums. */
typedef struct peri__pairing {
    int n, block;
    double share;
    const peri_real *p, *g, *g1;
    peri_real *s, *y;
    double sum[3][PERI__BLOCKS]; /* of s and y, s and s, y and y */
} peri__pairing;

static void peri__pairing_run(int begin, int end, void *context) {
    peri__pairing *t = (peri__pairing *)context;
    int block;
    for (block = begin; block < end; block++) {
        ptrdiff_t at = (ptrdiff_t)block * t->block, left = t->n - at;
        int n = left < t->block ? (int)left : t->block;
        peri_real *s = t->s + at, *y = t->y + at;
        memcpy(s, t->p + at, (size_t)n * sizeof *s);
        memcpy(y, t->g1 + at, (size_t)n * sizeof *y);
        if (t->g) {
            peri__combine_run(n, t->share, s, 0, t->p + at);
            peri__combine_run(n, 1, y, -1, t->g + at);
        }
        t->sum[0][block] = peri__dot_run(n, s, y);
        t->sum[1][block] = peri__dot_run(n, s, s);
        t->sum[2][block] = peri__dot_run(n, y, y);
    }
}

/* Remembers the pair in place of the oldest one. The cosine of s and y is at least 2 sqrt(k) / (1 + k) for a quadratic
   of condition k (Kantorovich): below 1e-8 it is rounding, or the energy is not convex there, and the pair is dropped,
   with the oldest one where the memory was full. */
static void peri__lbfgs_take(peri_lbfgs *l, const peri_parallel *par, double share, const peri_real *p,
                             const peri_real *g, const peri_real *g1) {
    peri__pairing t;
    double sum[3];
    int blocks, k;
    if (l->m == 0 || l->n <= 0) return;
    t.n = l->n;
    t.block = peri__block(l->n, PERI__RUN);
    t.share = share;
    t.p = p;
    t.g = g;
    t.g1 = g1;
    t.s = l->s + (ptrdiff_t)l->head * l->n;
    t.y = l->y + (ptrdiff_t)l->head * l->n;
    blocks = (l->n - 1) / t.block + 1;
    peri_parallel_for(par, blocks, 1, peri__pairing_run, &t);
    for (k = 0; k < 3; k++) sum[k] = peri__sum_blocks(t.sum[k], blocks);
    if (l->used == l->m) l->used--;
    if (!(sum[0] > 1e-8 * sqrt(sum[1]) * sqrt(sum[2])) || !peri__finite(1 / sum[0])) return;
    l->rho[l->head] = 1 / sum[0];
    l->head = (l->head + 1) % l->m;
    l->used++;
}

void peri_lbfgs_push(peri_lbfgs *l, const peri_parallel *par, const peri_real *s, const peri_real *y) {
    peri__lbfgs_take(l, par, 1, s, NULL, y);
}

static int peri__lbfgs_slot(const peri_lbfgs *l, int age) { return (l->head - age + l->m) % l->m; }

/* Newest pair first on the way in, oldest first on the way out (Nocedal 1980; Nocedal & Wright, algorithm 7.4). Each
   pass takes one pair off and multiplies with the next. */
void peri_lbfgs_apply(const peri_lbfgs *l, const peri_parallel *par, const peri_real *g, peri_real *p, peri_real *work,
                      peri_precondition *precondition, void *context) {
    double alpha[PERI_LBFGS_MAX], sum = 0;
    int i, k, n = l->n;
    if (n <= 0) return;
    memcpy(work, g, (size_t)n * sizeof *g);
    if (l->used > 0) sum = peri_dot(par, n, work, l->s + (ptrdiff_t)peri__lbfgs_slot(l, 1) * n);
    for (i = 1; i <= l->used; i++) {
        const peri_real *next = i < l->used ? l->s + (ptrdiff_t)peri__lbfgs_slot(l, i + 1) * n : NULL;
        k = peri__lbfgs_slot(l, i);
        alpha[k] = l->rho[k] * sum;
        sum = peri__combine_dot(par, n, 1, work, -alpha[k], l->y + (ptrdiff_t)k * n, next);
    }
    if (precondition)
        precondition(work, p, context);
    else
        memcpy(p, work, (size_t)n * sizeof *p);
    if (l->used > 0) sum = peri_dot(par, n, p, l->y + (ptrdiff_t)peri__lbfgs_slot(l, l->used) * n);
    for (i = l->used; i >= 1; i--) {
        const peri_real *next = i > 1 ? l->y + (ptrdiff_t)peri__lbfgs_slot(l, i - 1) * n : NULL;
        double sign = i > 1 ? 1 : -1, beta; /* the last one turns H g into -H g */
        k = peri__lbfgs_slot(l, i);
        beta = l->rho[k] * sum;
        sum = peri__combine_dot(par, n, sign, p, sign * (alpha[k] - beta), l->s + (ptrdiff_t)k * n, next);
    }
    if (l->used == 0) peri__combine_dot(par, n, -1, p, 0, work, NULL);
}

#ifndef PERI_NO_CHOLESKY
void peri_factor_apply(const peri_real *g, peri_real *p, void *factor_use) {
    const peri_factor_use *u = (const peri_factor_use *)factor_use;
    PERI_ASSERT(u && u->factor);
    if (!u || u->n <= 0) return;
    memcpy(p, g, (size_t)u->n * (size_t)u->rhs * sizeof *p);
    peri_cholesky_solve(u->factor, u->rhs, p, u->work);
}
#endif

/* ---- 7  line search, minimisation -------------------------------------------------------------------------------- */

peri_search peri_default_search(void) {
    peri_search o;
    memset(&o, 0, sizeof o);
    o.cookie = PERI__SOLVER_COOKIE + 2;
    o.first = 1;
    o.accept = 0.9;
    o.max_trials = 14;
    return o;
}

static peri_result peri__check_search(const peri_search *o, peri_error *err) {
    if (!o || o->cookie != PERI__SOLVER_COOKIE + 2)
        return peri__fail(err, PERI_ERROR_ARGUMENT, "line search: the options %s",
                          o ? "do not come from peri_default_search()" : "are NULL; pass peri_default_search()");
    if (!(o->first > 0) || !peri__finite(o->first) || !(o->accept >= 0 && o->accept <= 2) || !(o->noise >= 0))
        return peri__fail(err, PERI_ERROR_VALUE,
                          "line search: first is %g (> 0), accept %g (0 to 2), noise %g (>= 0)", o->first, o->accept,
                          o->noise);
    if (o->max_trials < 1 || o->max_trials > 100)
        return peri__fail(err, PERI_ERROR_VALUE, "line search: max_trials is %d; it must be 1 to 100", o->max_trials);
    return PERI_OK;
}

/* The share that is taken, or 0. */
static double peri__line_run(const peri_line *line, const peri_search *o, peri_report *report) {
    double share = o->first, slope, energy, shrink;
    while (report->iterations < o->max_trials) {
        int defined;
        slope = energy = 0;
        defined = line->trial(share, &slope, o->energetic ? &energy : NULL, line->context);
        report->iterations++;
        report->evaluations++;
        shrink = 0.25;
        if (defined && peri__finite(slope) && peri__finite(energy)) {
            if (slope <= o->accept * fabs(line->slope) && (!o->energetic || energy <= line->energy + o->noise)) {
                report->residual = fabs(slope / line->slope);
                return share;
            }
            shrink = slope > 0 ? line->slope / (line->slope - slope) : 0.5;
            shrink = shrink < 0.1 ? 0.1 : shrink > 0.6 ? 0.6 : shrink;
        }
        share *= shrink;
    }
    return 0;
}

peri_result peri_line_search(const peri_line *line, double *share, const peri_search *o, peri_report *report,
                             peri_error *err) {
    peri_report none;
    peri_result bad = peri__check_search(o, err);
    if (!report) report = &none;
    memset(report, 0, sizeof *report);
    report->residual = 1;
    if (share) *share = 0;
    if (!bad && (!line || !line->trial || !share))
        bad = peri__fail(err, PERI_ERROR_ARGUMENT, "line search: %s is NULL",
                         !line ? "the line" : share ? "trial" : "share");
    if (!bad && (!(line->slope < 0) || !peri__finite(line->slope) || (o->energetic && !peri__finite(line->energy))))
        bad = peri__fail(err, PERI_ERROR_VALUE, "line search: begins with slope %g and energy %g; the slope must be "
                         "negative", line->slope, line->energy);
    if (!bad) {
        *share = peri__line_run(line, o, report);
        bad = *share > 0 ? peri__succeed(err)
                         : peri__fail(err, PERI_ERROR_CONVERGENCE, "line search: no share goes down in %d trials",
                                      o->max_trials);
    }
    report->result = bad;
    return bad;
}

size_t peri_minimise_work(int n, int memory) {
    size_t reals, bytes;
    if (n < 0 || memory < 0 || memory > PERI_LBFGS_MAX) return 0;
    if (!peri__mul_size((size_t)n, 2 * (size_t)memory + 5, &reals)) return 0;
    return peri__mul_size(reals, sizeof(peri_real), &bytes) ? reals : 0;
}

typedef struct peri__minimise {
    const peri_objective *f;
    const peri_iteration *o;
    peri_report *report;
    peri_real *x, *g, *g1, *p, *base, *spare;
    peri_lbfgs lbfgs;
    double energy, energy1, first; /* first: |g| at the start */
} peri__minimise;

static int peri__all_finite(int n, const peri_real *g) {
    int i;
    for (i = 0; i < n; i++)
        if (!peri__finite((double)g[i])) return 0;
    return 1;
}

/* The gradient at x into g; 0 where it is not defined. */
static int peri__minimise_gradient(peri__minimise *m, peri_real *g, double *energy) {
    m->report->evaluations++;
    return m->f->gradient(m->x, g, m->f->search.energetic ? energy : NULL, m->f->context) &&
           peri__all_finite(m->f->n, g) && (!m->f->search.energetic || peri__finite(*energy));
}

static int peri__minimise_trial(double share, double *slope, double *energy, void *context) {
    peri__minimise *m = (peri__minimise *)context;
    memcpy(m->x, m->base, (size_t)m->f->n * sizeof *m->x);
    peri__combine_dot(m->o->parallel, m->f->n, 1, m->x, share, m->p, NULL);
    if (!peri__minimise_gradient(m, m->g1, &m->energy1)) return 0;
    *slope = peri_dot(m->o->parallel, m->f->n, m->g1, m->p);
    if (energy) *energy = m->energy1;
    return 1;
}

static void peri__minimise_forget(peri__minimise *m) {
    peri_lbfgs_begin(&m->lbfgs, m->f->n, m->f->memory, m->lbfgs.s);
    m->report->restarts++;
}

/* p, its slope, and its largest entry; the memory goes when p does not lead down. */
static double peri__minimise_direction(peri__minimise *m) {
    const peri_parallel *par = m->o->parallel;
    double slope;
    int i, n = m->f->n;
    for (;;) {
        peri_lbfgs_apply(&m->lbfgs, par, m->g, m->p, m->spare, m->o->precondition, m->o->context);
        slope = peri_dot(par, n, m->g, m->p);
        if ((slope < 0 && peri__finite(slope)) || !m->lbfgs.used) break;
        peri__minimise_forget(m);
    }
    for (m->report->correction = 0, i = 0; i < n; i++)
        if (fabs((double)m->p[i]) > m->report->correction) m->report->correction = fabs((double)m->p[i]);
    return slope;
}

/* Takes the trial at share: remembers the pair (s, y) and moves on. */
static void peri__minimise_take(peri__minimise *m, double share) {
    peri_real *g = m->g;
    int n = m->f->n;
    peri__lbfgs_take(&m->lbfgs, m->o->parallel, share, m->p, m->g, m->g1);
    m->g = m->g1;
    m->g1 = g;
    m->energy = m->energy1;
    m->report->iterations++;
    m->report->residual = sqrt(peri_dot(m->o->parallel, n, m->g, m->g)) / m->first;
    if (m->o->watch) m->o->watch(m->report->iterations, m->report->residual, m->o->user);
}

static peri_result peri__minimise_run(peri__minimise *m, peri_error *err) {
    peri_report searched;
    peri_line line;
    double share;
    if (!peri__minimise_gradient(m, m->g, &m->energy))
        return peri__fail(err, PERI_ERROR_VALUE,
                          "minimise: the gradient at the first guess is not defined, or not finite");
    m->first = sqrt(peri_dot(m->o->parallel, m->f->n, m->g, m->g));
    if (!(m->first > 0)) return peri__succeed(err);
    m->report->residual = 1;
    line.trial = peri__minimise_trial;
    line.context = m;
    for (;;) {
        line.slope = peri__minimise_direction(m);
        line.energy = m->energy;
        if (m->report->correction <= m->o->tolerance) return peri__succeed(err);
        if (!(line.slope < 0) || !peri__finite(line.slope))
            return peri__fail(err, PERI_ERROR_PIVOT, "minimise: g.P^-1 g is %g: the preconditioner is not positive",
                              -line.slope);
        if (m->report->iterations >= m->o->max_iterations) break;
        memcpy(m->base, m->x, (size_t)m->f->n * sizeof *m->x);
        peri_line_search(&line, &share, &m->f->search, &searched, NULL);
        if (share > 0) {
            peri__minimise_take(m, share);
            continue;
        }
        memcpy(m->x, m->base, (size_t)m->f->n * sizeof *m->x);
        if (!m->lbfgs.used) break;
        peri__minimise_forget(m);
    }
    return peri__fail(err, PERI_ERROR_CONVERGENCE,
                      "minimise: after %d iterations the correction is %.3g, not %.3g, and the gradient %.3g of the "
                      "first: %s", m->report->iterations, m->report->correction, m->o->tolerance, m->report->residual,
                      m->report->iterations >= m->o->max_iterations ? peri__more : "no share of it goes down");
}

static peri_result peri__minimise_check(const peri_objective *f, const peri_real *x, const peri_real *work,
                                        const peri_iteration *o, peri_error *err) {
    peri_result bad = peri__check_iteration("minimise", o, err);
    if (bad) return bad;
    if (!f || !f->gradient || f->n < 0 || f->memory < 0 || f->memory > PERI_LBFGS_MAX)
        return peri__fail(err, PERI_ERROR_ARGUMENT,
                          "minimise: needs a gradient, n >= 0 (here %d) and memory from 0 to %d (here %d)",
                          f ? f->n : 0, PERI_LBFGS_MAX, f ? f->memory : 0);
    if (f->n > 0 && (!x || !work))
        return peri__fail(err, PERI_ERROR_ARGUMENT, "minimise: %s is NULL", x ? "work" : "x");
    bad = peri__check_search(&f->search, err);
    if (!bad && !peri__all_finite(f->n, x))
        bad = peri__fail(err, PERI_ERROR_VALUE, "minimise: the first guess is not finite");
    return bad;
}

peri_result peri_minimise(const peri_objective *f, peri_real *x, peri_real *work, const peri_iteration *o,
                          peri_report *report, peri_error *err) {
    peri_report none;
    peri__minimise m;
    peri_result result = peri__minimise_check(f, x, work, o, err);
    if (!report) report = &none;
    memset(report, 0, sizeof *report);
    if (!result && f->n > 0) {
        size_t n = (size_t)f->n;
        memset(&m, 0, sizeof m);
        m.f = f;
        m.o = o;
        m.report = report;
        m.x = x;
        m.g = work;
        m.g1 = m.g + n;
        m.p = m.g1 + n;
        m.base = m.p + n;
        m.spare = m.base + n;
        peri_lbfgs_begin(&m.lbfgs, f->n, f->memory, m.spare + n);
        result = peri__minimise_run(&m, err);
    } else if (!result) {
        peri__succeed(err);
    }
    report->result = result;
    return result;
}

/* ---- 8  Anderson acceleration ------------------------------------------------------------------------------------ */

void peri_anderson_begin(peri_anderson *q, int n, int m, peri_real *vectors) {
    PERI_ASSERT(q && n >= 0 && m >= 0 && m <= PERI_ANDERSON_MAX);
    memset(q, 0, sizeof *q);
    q->n = n;
    q->m = m < 0 ? 0 : m > PERI_ANDERSON_MAX ? PERI_ANDERSON_MAX : m;
    if (!vectors) return;
    q->image = vectors;
    q->change = vectors + n;
    q->images = q->change + n;
    q->changes = q->images + (ptrdiff_t)q->m * n;
}

typedef struct peri__anderson_task {
    peri_anderson *q;
    const peri_real *x, *image;
    int block, pairs; /* pairs: the slots that hold differences, the new one included */
    double norm[PERI__BLOCKS], gram[PERI_ANDERSON_MAX][PERI__BLOCKS], right[PERI_ANDERSON_MAX][PERI__BLOCKS];
} peri__anderson_task;

static void peri__anderson_norm(int begin, int end, void *context) {
    peri__anderson_task *t = (peri__anderson_task *)context;
    int block, i;
    for (block = begin; block < end; block++) {
        int last = t->q->n - block * t->block > t->block ? (block + 1) * t->block : t->q->n;
        double sum = 0;
        for (i = block * t->block; i < last; i++) {
            double f = (double)t->image[i] - (double)t->x[i];
            sum += f * f;
        }
        t->norm[block] = sum;
    }
}

/* Takes the image in, puts the differences into the slot at head, and multiplies. */
static void peri__anderson_take(int begin, int end, void *context) {
    peri__anderson_task *t = (peri__anderson_task *)context;
    peri_anderson *q = t->q;
    int block, k, i;
    for (block = begin; block < end; block++) {
        ptrdiff_t at = (ptrdiff_t)block * t->block, slot = (ptrdiff_t)q->head * q->n + at;
        int n = q->n - block * t->block > t->block ? t->block : q->n - block * t->block;
        peri_real *image = q->image + at, *change = q->change + at;
        for (i = 0; i < n; i++) {
            peri_real g = t->image[at + i], f = g - t->x[at + i];
            if (t->pairs) {
                q->images[slot + i] = g - image[i];
                q->changes[slot + i] = f - change[i];
            }
            image[i] = g;
            change[i] = f;
        }
        for (k = 0; k < t->pairs; k++) {
            const peri_real *other = q->changes + (ptrdiff_t)k * q->n + at;
            t->gram[k][block] = peri__dot_run(n, other, q->changes + slot);
            t->right[k][block] = peri__dot_run(n, other, change);
        }
    }
}

int peri_anderson_push(peri_anderson *q, const peri_parallel *par, const peri_real *x, const peri_real *gx) {
    peri__anderson_task t;
    double norm;
    int blocks, k;
    PERI_ASSERT(q && (q->n == 0 || (x && gx && q->image)));
    if (q->n <= 0 || !q->image) return 1;
    t.q = q;
    t.x = x;
    t.image = gx;
    t.block = peri__block(q->n, PERI__RUN);
    blocks = (q->n - 1) / t.block + 1;
    peri_parallel_for(par, blocks, 1, peri__anderson_norm, &t);
    norm = sqrt(peri__sum_blocks(t.norm, blocks));
    if (!peri__finite(norm) || (q->used > 0 && norm > 2 * q->norm)) {
        q->resets += q->used > 0;
        q->used = q->head = 0;
        return 0;
    }
    t.pairs = !q->started || q->m == 0 ? 0 : q->used < q->m ? q->used + 1 : q->m;
    peri_parallel_for(par, blocks, 1, peri__anderson_take, &t);
    for (k = 0; k < t.pairs; k++) {
        q->gram[k][q->head] = q->gram[q->head][k] = peri__sum_blocks(t.gram[k], blocks);
        q->right[k] = peri__sum_blocks(t.right[k], blocks);
    }
    if (t.pairs) q->head = (q->head + 1) % q->m;
    q->used = t.pairs;
    q->started = 1;
    q->norm = norm;
    return 1;
}

/* weight minimises |change - changes weight|: normal equations in double, newest first. A difference that newer ones
   give but for 1e-6 of its length is left out: it would bring in rounding. */
static void peri__anderson_weights(const peri_anderson *q, double weight[PERI_ANDERSON_MAX]) {
    double l[PERI_ANDERSON_MAX][PERI_ANDERSON_MAX], y[PERI_ANDERSON_MAX];
    int slot[PERI_ANDERSON_MAX], kept = 0, age, i, j;
    for (i = 0; i < PERI_ANDERSON_MAX; i++) weight[i] = 0;
    for (age = 1; age <= q->used; age++) {
        int s = (q->head - age + q->m) % q->m;
        double pivot = q->gram[s][s], right = q->right[s];
        for (i = 0; i < kept; i++) {
            double sum = q->gram[s][slot[i]];
            for (j = 0; j < i; j++) sum -= l[kept][j] * l[i][j];
            l[kept][i] = sum / l[i][i];
            pivot -= l[kept][i] * l[kept][i];
            right -= l[kept][i] * y[i];
        }
        if (!(pivot > 1e-12 * q->gram[s][s])) continue;
        l[kept][kept] = sqrt(pivot);
        y[kept] = right / l[kept][kept];
        slot[kept++] = s;
    }
    for (i = kept - 1; i >= 0; i--) {
        for (j = i + 1; j < kept; j++) y[i] -= l[j][i] * y[j];
        y[i] /= l[i][i];
        weight[slot[i]] = y[i];
    }
}

void peri_anderson_apply(const peri_anderson *q, const peri_parallel *par, peri_real *x) {
    double weight[PERI_ANDERSON_MAX];
    int k;
    PERI_ASSERT(q);
    if (!q->started || q->n <= 0) return;
    memcpy(x, q->image, (size_t)q->n * sizeof *x);
    peri__anderson_weights(q, weight);
    for (k = 0; k < q->used; k++)
        if (weight[k] < 0 || weight[k] > 0)
            peri__combine_dot(par, q->n, 1, x, -weight[k], q->images + (ptrdiff_t)k * q->n, NULL);
}

#ifndef PERI_NO_CHOLESKY
/* ---- 9  two-level preconditioner --------------------------------------------------------------------------------- */

struct peri_two_level {
    peri_allocator memory;
    size_t bytes;
    uint64_t pattern;
    peri_parallel parallel;
    peri_cholesky *factor;
    peri_matrix coarse;
    int n, parts, rhs, ready;
    int *up, *node;                 /* of a row: its nodes, node[up[i]] .. node[up[i + 1] - 1], the nearest first, */
    peri_real *weight, *live;       /* their weights; those weights, 0 where the row or the node is left out */
    int *down, *member;             /* of a node: its entries of weight, member[down[k]] .. ; */
    int *which;                     /* and the rows of those; */
    peri_real *share;               /* live, in that order */
    int *row, *col, *place;         /* of the coarse matrix; place: scratch */
    peri_real *value, *diagonal, *inverse, *sum, *work;
    double *line, *reach;           /* scratch: a row of the coarse matrix, a row of Q^T A; */
    int *list, *stamp;              /* where that is not zero; which row it is of */
    unsigned char *alone;           /* rows that no other touches */
};

#define PERI__CORNERS 8

/* A corner of the cell that a row stands in: where, and how near. */
typedef struct peri__corner {
    int64_t key[3];
    peri_real weight;
    int row, node;
    int nearest;                    /* 1: of all the row's corners */
} peri__corner;

static int peri__corner_order(const void *a, const void *b) {
    const peri__corner *x = (const peri__corner *)a, *y = (const peri__corner *)b;
    int c;
    for (c = 2; c >= 0; c--)
        if (x->key[c] != y->key[c]) return x->key[c] < y->key[c] ? -1 : 1;
    return x->row < y->row ? -1 : x->row > y->row;
}

/* Where a coordinate, in cells, stands between two nodes: its share of the upper one. Nodes nearly met count as met. */
static double peri__between(double u, int64_t *low) {
    double base = floor(u), share = u - base;
    *low = (int64_t)base;
    if (share < 1.0 / 64) return 0;
    if (share <= 1 - 1.0 / 64) return share;
    (*low)++;
    return 0;
}

/* The corners of row i that have a weight; returns their number. */
static int peri__corners_of(const double u[3], int i, peri__corner *out) {
    int64_t low[3];
    double share[3];
    int k, c, count = 0, best = 0;
    for (c = 0; c < 3; c++) share[c] = peri__between(u[c], &low[c]);
    for (k = 0; k < PERI__CORNERS; k++) {
        peri__corner *o = &out[count];
        double weight = 1;
        for (c = 0; c < 3; c++) {
            weight *= k >> c & 1 ? share[c] : 1 - share[c];
            o->key[c] = low[c] + (k >> c & 1);
        }
        if (!(weight > 0)) continue;
        o->weight = (peri_real)weight;
        o->row = i;
        o->nearest = 0;
        if (o->weight > out[best].weight) best = count;
        count++;
    }
    out[best].nearest = 1;
    return count;
}

/* The corners of all rows; corner NULL only counts them. */
static size_t peri__corners(int n, const peri_real *xyz, double cell, peri__corner *corner) {
    peri__corner some[PERI__CORNERS];
    double low[3] = {0, 0, 0}, u[3];
    size_t count = 0;
    int i, c;
    memset(some, 0, sizeof some);
    for (c = 0; c < 3; c++)
        for (i = 0; i < n; i++)
            if (i == 0 || (double)xyz[3 * (ptrdiff_t)i + c] < low[c]) low[c] = (double)xyz[3 * (ptrdiff_t)i + c];
    for (i = 0; i < n; i++) {
        for (c = 0; c < 3; c++) u[c] = ((double)xyz[3 * (ptrdiff_t)i + c] - low[c]) / cell;
        count += (size_t)peri__corners_of(u, i, corner ? corner + count : some);
    }
    return count;
}

/* Numbers the nodes: of the corners those that are the nearest of some row. Others would hang on rows that have nodes
   enough, and make the coarse matrix singular. Leaves their corners only, sorted by node; returns how many nodes. */
static int peri__nodes(peri__corner *corner, size_t *count) {
    size_t k, i, end, kept = 0;
    int nodes = 0;
    qsort(corner, *count, sizeof *corner, peri__corner_order);
    for (k = 0; k < *count; k = end) {
        int wanted = 0;
        for (end = k; end < *count && corner[end].key[0] == corner[k].key[0] &&
                      corner[end].key[1] == corner[k].key[1] && corner[end].key[2] == corner[k].key[2]; end++)
            wanted |= corner[end].nearest;
        for (i = k; i < end && wanted; i++) {
            corner[kept] = corner[i];
            corner[kept++].node = nodes;
        }
        nodes += wanted;
    }
    *count = kept;
    return nodes;
}

/* The rows that node k reaches by A into t->list: their number. What A makes there of
   the node's weights goes into t->reach. stamp: not k before. */
static int peri__coarse_reach(peri_two_level *t, const peri_matrix *a, int k) {
    int m, e, count = 0;
    for (m = t->down[k]; m < t->down[k + 1]; m++) {
        int i = t->which[m];
        double weight = (double)t->share[m];
        for (e = a->row[i] - 1; e < a->row[i + 1]; e++) {
            int j = e < a->row[i] ? i : a->col[e];
            if (t->stamp[j] != k) {
                t->stamp[j] = k;
                t->reach[j] = 0;
                t->list[count++] = j;
            }
            t->reach[j] += weight * (double)(e < a->row[i] ? a->diagonal[i] : a->value[e]);
        }
    }
    return count;
}

/* Rows of the coarse pattern; with col NULL only their lengths. */
static void peri__coarse_pattern(peri_two_level *t, const peri_matrix *a) {
    int i, k, q, count = 0;
    for (i = 0; i < t->n; i++) t->stamp[i] = -1;
    for (k = 0; k < t->parts; k++) t->place[k] = -1;
    for (k = 0; k < t->parts; k++) {
        int begin = count, rows = peri__coarse_reach(t, a, k);
        t->place[k] = k;
        for (i = 0; i < rows; i++)
            for (q = t->up[t->list[i]]; q < t->up[t->list[i] + 1]; q++) {
                int to = t->node[q];
                if (t->place[to] == k) continue;
                t->place[to] = k;
                if (t->col) t->col[count] = to;
                count++;
            }
        if (t->col) peri__row_sort(t->col + begin, count - begin);
        t->row[k] = begin;
    }
    t->row[t->parts] = count;
}

/* Where everything stands in one block; block NULL only counts. The coarse matrix, whose size is known last, has a
   block of its own. */
static size_t peri__two_level_lay(peri_two_level *t, char *block, size_t corners) {
    size_t n = (size_t)t->n, parts = (size_t)t->parts, sides = (size_t)t->rhs, at = 0;
#define PERI__LAY(field, type, count) \
    if (block) t->field = (type *)(void *)(block + at); \
    at = peri__align(at + ((size_t)(count) + 1) * sizeof(type));
    PERI__LAY(line, double, parts)
    PERI__LAY(reach, double, n)
    PERI__LAY(inverse, peri_real, n)
    PERI__LAY(diagonal, peri_real, parts)
    PERI__LAY(sum, peri_real, sides * parts)
    PERI__LAY(work, peri_real, 2 * sides * parts)
    PERI__LAY(weight, peri_real, corners)
    PERI__LAY(live, peri_real, corners)
    PERI__LAY(share, peri_real, corners)
    PERI__LAY(node, int, corners)
    PERI__LAY(member, int, corners)
    PERI__LAY(which, int, corners)
    PERI__LAY(up, int, n + 1)
    PERI__LAY(down, int, parts + 1)
    PERI__LAY(row, int, parts + 1)
    PERI__LAY(place, int, parts)
    PERI__LAY(list, int, n)
    PERI__LAY(stamp, int, n)
    PERI__LAY(alone, unsigned char, n)
#undef PERI__LAY
    return at;
}

/* Q, by rows (the nearest node first) and by nodes; the weights of a row add up to 1. */
static void peri__two_level_weights(peri_two_level *t, const peri__corner *corner, size_t corners) {
    int i, k, m, count = (int)corners;
    memset(t->up, 0, ((size_t)t->n + 1) * sizeof *t->up);
    memset(t->down, 0, ((size_t)t->parts + 1) * sizeof *t->down);
    for (k = 0; k < count; k++) {
        t->up[corner[k].row + 1]++;
        t->down[corner[k].node + 1]++;
    }
    for (i = 0; i < t->n; i++) {
        t->up[i + 1] += t->up[i];
        t->list[i] = t->up[i];
    }
    for (k = 0; k < t->parts; k++) t->down[k + 1] += t->down[k];
    for (k = 0; k < count; k++) {
        m = t->list[corner[k].row]++;
        if (corner[k].nearest) {
            i = t->up[corner[k].row];
            t->node[m] = t->node[i];
            t->weight[m] = t->weight[i];
            m = i;
        }
        t->node[m] = corner[k].node;
        t->weight[m] = corner[k].weight;
    }
    for (k = 0; k < t->parts; k++) t->place[k] = t->down[k];
    for (i = 0; i < t->n; i++) {
        double sum = 0;
        for (k = t->up[i]; k < t->up[i + 1]; k++) sum += (double)t->weight[k];
        for (k = t->up[i]; k < t->up[i + 1]; k++) {
            t->weight[k] = (peri_real)((double)t->weight[k] / sum);
            m = t->place[t->node[k]]++;
            t->share[m] = t->weight[k];
            t->member[m] = k;
            t->which[m] = i;
        }
    }
}

static peri_result peri__two_level_refused(const peri_two_level *t, peri_error *err) {
    return peri__fail(err, PERI_ERROR_MEMORY, "two levels: no memory for %d rows", t->n);
}

/* Nodes, pattern and factor of their matrix. */
static peri_result peri__two_level_make(peri_two_level *t, const peri_matrix *a, const peri_real *xyz,
                                        const peri__corner *corner, size_t corners, peri_error *err) {
    size_t bytes = peri__two_level_lay(t, NULL, corners), entries, of = (3 * (size_t)t->parts + 1) * sizeof(peri_real);
    char *block = (char *)peri__resize(&t->memory, NULL, 0, bytes);
    peri_real *centre;
    peri_result bad;
    int k, c, m;
    if (!block) return peri__two_level_refused(t, err);
    t->bytes = bytes;
    peri__two_level_lay(t, block, corners);
    peri__two_level_weights(t, corner, corners);
    peri__coarse_pattern(t, a);
    entries = (size_t)t->row[t->parts];
    t->value = (peri_real *)peri__resize(&t->memory, NULL, 0, (entries + 1) * (sizeof *t->value + sizeof *t->col));
    if (!t->value) return peri__two_level_refused(t, err);
    t->col = (int *)(void *)(t->value + entries + 1);
    peri__coarse_pattern(t, a);
    t->coarse.n = t->parts;
    t->coarse.row = t->row;
    t->coarse.col = t->col;
    t->coarse.value = t->value;
    t->coarse.diagonal = t->diagonal;
    centre = (peri_real *)peri__resize(&t->memory, NULL, 0, of);
    if (!centre) return peri__two_level_refused(t, err);
    for (k = 0; k < t->parts; k++)
        for (c = 0; c < 3; c++) {
            double sum = 0;
            for (m = t->down[k]; m < t->down[k + 1]; m++) sum += (double)xyz[3 * (ptrdiff_t)t->which[m] + c];
            centre[3 * (ptrdiff_t)k + c] = (peri_real)(sum / (t->down[k + 1] - t->down[k]));
        }
    bad = peri_cholesky_create(&t->coarse, centre, &t->memory, &t->factor, err);
    peri__resize(&t->memory, centre, of, 0);
    return bad;
}

peri_result peri_two_level_create(const peri_matrix *a, const peri_real *xyz, double cell, int rhs,
                                  const peri_allocator *memory, peri_two_level **out, peri_error *err) {
    peri_allocator hook = peri__memory_or_standard(memory);
    peri_two_level *t;
    peri__corner *corner;
    peri_result bad;
    ptrdiff_t i;
    size_t room, corners;
    if (out) *out = NULL;
    if (!a || !xyz || !out || rhs < 1 || rhs > 3)
        return peri__fail(err, PERI_ERROR_ARGUMENT, "two levels: %s", !a ? "the matrix is NULL" : !xyz ? "xyz is NULL" :
                          !out ? "out is NULL" : "rhs must be 1, 2 or 3");
    if (!(cell > 0) || !peri__finite(cell))
        return peri__fail(err, PERI_ERROR_VALUE, "two levels: cell is %g; it must be a positive length", cell);
    bad = peri__check_pattern(a, &hook, err);
    if (bad) return bad;
    for (i = 0; i < 3 * (ptrdiff_t)a->n; i++)
        if (!(fabs((double)xyz[i]) < 1e15 * cell))
            return peri__fail(err, PERI_ERROR_VALUE, "two levels: coordinate %c of row %d is %g, in cells of %g",
                              "xyz"[i % 3], (int)(i / 3), (double)xyz[i], cell);
    t = (peri_two_level *)peri__resize(&hook, NULL, 0, sizeof *t);
    if (!t) return peri__fail(err, PERI_ERROR_MEMORY, "two levels: no memory for %d rows", a->n);
    memset(t, 0, sizeof *t);
    t->memory = hook;
    t->n = a->n;
    t->rhs = rhs;
    t->pattern = peri__pattern(a);
    t->parallel.threads = 1;
    corners = peri__corners(a->n, xyz, cell, NULL);
    room = (corners + 1) * sizeof *corner;
    corner = corners < 0x7fffffff ? (peri__corner *)peri__resize(&hook, NULL, 0, room) : NULL;
    if (corner) {
        peri__corners(a->n, xyz, cell, corner);
        t->parts = peri__nodes(corner, &corners);
        bad = a->n > 0 ? peri__two_level_make(t, a, xyz, corner, corners, err) : PERI_OK;
        peri__resize(&hook, corner, room, 0);
    } else {
        bad = peri__two_level_refused(t, err);
    }
    if (bad) {
        peri_two_level_destroy(t);
        return bad;
    }
    *out = t;
    return peri__succeed(err);
}

/* Rows that stand alone are left out, and nodes that are the nearest of no other: for what hangs on something held,
   such a node is held, too. */
static void peri__two_level_live(peri_two_level *t) {
    int i, k;
    for (k = 0; k < t->parts; k++) t->place[k] = 0;
    for (i = 0; i < t->n; i++) t->place[t->node[t->up[i]]] |= !t->alone[i];
    for (i = 0; i < t->n; i++)
        for (k = t->up[i]; k < t->up[i + 1]; k++)
            t->live[k] = t->alone[i] || !t->place[t->node[k]] ? 0 : t->weight[k];
    for (k = 0; k < t->up[t->n]; k++) t->share[k] = t->live[t->member[k]];
}

/* Row k of Q^T A Q, summed in double. */
static void peri__coarse_row(peri_two_level *t, const peri_matrix *a, int k) {
    int i, e, q, begin = t->row[k], count = t->row[k + 1] - begin, rows = peri__coarse_reach(t, a, k);
    double own;
    for (e = 0; e < count; e++) t->line[t->col[begin + e]] = 0;
    t->line[k] = 0;
    for (i = 0; i < rows; i++) {
        double value = t->reach[t->list[i]];
        for (q = t->up[t->list[i]]; q < t->up[t->list[i] + 1]; q++) t->line[t->node[q]] += value * (double)t->live[q];
    }
    for (e = 0; e < count; e++) t->value[begin + e] = (peri_real)t->line[t->col[begin + e]];
    own = t->line[k];
    t->diagonal[k] = own > 0 || own < 0 ? (peri_real)own : 1;   /* 1: it is left out */
}

peri_result peri_two_level_factor(peri_two_level *t, const peri_matrix *a, peri_error *err) {
    peri_result bad;
    int i, e;
    if (!t || !a)
        return peri__fail(err, PERI_ERROR_ARGUMENT, "two levels: %s is NULL", t ? "the matrix" : "the object");
    t->ready = 0;
    if (a->n != t->n || peri__pattern(a) != t->pattern)
        return peri__fail(err, PERI_ERROR_ARGUMENT, "two levels: the matrix (n is %d) has another pattern than the one "
                          "given to create (n is %d)", a->n, t->n);
    for (i = 0; i < t->n; i++) {
        double d = (double)a->diagonal[i];
        if (!(d > 0) || !peri__finite(1 / d) || !peri__finite(d))
            return peri__fail(err, PERI_ERROR_PIVOT,
                              "two levels: the diagonal entry of row %d is %g; it must be positive", i, d);
        t->inverse[i] = (peri_real)(1 / d);
        t->alone[i] = 1;
        for (e = a->row[i]; e < a->row[i + 1] && t->alone[i]; e++) t->alone[i] = fabs((double)a->value[e]) <= 0;
    }
    peri__two_level_live(t);
    for (i = 0; i < t->n; i++) t->stamp[i] = -1;
    for (i = 0; i < t->parts; i++) peri__coarse_row(t, a, i);
    bad = t->n > 0 ? peri_cholesky_factor(t->factor, &t->coarse, err) : PERI_OK;
    t->ready = !bad;
    return bad ? bad : peri__succeed(err);
}

typedef struct peri__levels {
    const peri_two_level *t;
    const peri_real *g;
    peri_real *p;
} peri__levels;

static void peri__gather_task(int begin, int end, void *context) {
    const peri__levels *l = (const peri__levels *)context;
    const peri_two_level *t = l->t;
    int m, q, sides = t->rhs;
    for (; begin < end; begin++) {
        peri_real sum[3] = {0, 0, 0};
        for (m = t->down[begin]; m < t->down[begin + 1]; m++)
            for (q = 0; q < sides; q++) sum[q] += t->share[m] * l->g[(ptrdiff_t)sides * t->which[m] + q];
        for (q = 0; q < sides; q++) t->sum[(ptrdiff_t)sides * begin + q] = sum[q];
    }
}

/* Three sides, by far the most frequent, go by quads: three numbers and one that counts for nothing, which is the next
   row's. The last row's quad would reach beyond g: it is a copy. */
static void peri__gather3_task(int begin, int end, void *context) {
    const peri__levels *l = (const peri__levels *)context;
    const peri_two_level *t = l->t;
    peri_real tail[4] = {0, 0, 0, 0};
    int m;
    memcpy(tail, l->g + 3 * (ptrdiff_t)(t->n - 1), 3 * sizeof *tail);
    for (; begin < end; begin++) {
        peri__quad sum;
        memset(sum, 0, sizeof sum);
        for (m = t->down[begin]; m < t->down[begin + 1]; m++) {
            int i = t->which[m];
            const peri_real *g = i < t->n - 1 ? l->g + 3 * (ptrdiff_t)i : tail;
            peri__quad_share(sum, t->share[m], g);
        }
        memcpy(t->sum + 3 * (ptrdiff_t)begin, sum, 3 * sizeof *tail);
    }
}

static void peri__spread_task(int begin, int end, void *context) {
    const peri__levels *l = (const peri__levels *)context;
    const peri_two_level *t = l->t;
    int m, q, sides = t->rhs;
    for (; begin < end; begin++) {
        peri_real all[3] = {0, 0, 0};
        for (m = t->up[begin]; m < t->up[begin + 1]; m++)
            for (q = 0; q < sides; q++) all[q] += t->live[m] * t->sum[(ptrdiff_t)sides * t->node[m] + q];
        for (q = 0; q < sides; q++) {
            ptrdiff_t k = (ptrdiff_t)sides * begin + q;
            l->p[k] = l->g[k] * t->inverse[begin] + all[q];
        }
    }
}

/* The nodes' sums have a number more than they need, for the last one's quad. */
static void peri__spread3_task(int begin, int end, void *context) {
    const peri__levels *l = (const peri__levels *)context;
    const peri_two_level *t = l->t;
    int m;
    for (; begin < end; begin++) {
        const peri_real *g = l->g + 3 * (ptrdiff_t)begin;
        peri_real *p = l->p + 3 * (ptrdiff_t)begin, all[4], d = t->inverse[begin];
        peri__quad sum;
        memset(sum, 0, sizeof sum);
        for (m = t->up[begin]; m < t->up[begin + 1]; m++)
            peri__quad_share(sum, t->live[m], t->sum + 3 * (ptrdiff_t)t->node[m]);
        memcpy(all, sum, sizeof all);
        p[0] = g[0] * d + all[0];
        p[1] = g[1] * d + all[1];
        p[2] = g[2] * d + all[2];
    }
}

void peri_two_level_apply(const peri_real *g, peri_real *p, void *two_level) {
    peri__levels l;
    l.t = (const peri_two_level *)two_level;
    l.g = g;
    l.p = p;
    PERI_ASSERT(l.t && l.t->ready);
    if (!l.t || !l.t->ready || !l.t->n) return;
    peri_parallel_for(&l.t->parallel, l.t->parts, PERI__GRAIN, l.t->rhs == 3 ? peri__gather3_task : peri__gather_task,
                      &l);
    peri_cholesky_solve(l.t->factor, l.t->rhs, l.t->sum, l.t->work);
    peri_parallel_for(&l.t->parallel, l.t->n, PERI__GRAIN, l.t->rhs == 3 ? peri__spread3_task : peri__spread_task, &l);
}

void peri_two_level_threads(peri_two_level *t, const peri_parallel *par) {
    PERI_ASSERT(t);
    if (!t) return;
    memset(&t->parallel, 0, sizeof t->parallel);
    t->parallel.threads = 1;
    if (par) t->parallel = *par;
    if (t->factor) peri_cholesky_threads(t->factor, par);
}

int peri_two_level_nodes(const peri_two_level *t) { return t ? t->parts : 0; }

size_t peri_two_level_bytes(const peri_two_level *t) {
    size_t entries = t && t->value ? (size_t)t->row[t->parts] + 1 : 0;
    return t ? sizeof *t + t->bytes + entries * (sizeof(peri_real) + sizeof(int)) + peri_cholesky_bytes(t->factor) : 0;
}

size_t peri_two_level_entries(const peri_two_level *t) { return t ? peri_cholesky_entries(t->factor) : 0; }

double peri_two_level_operations(const peri_two_level *t) { return t ? peri_cholesky_operations(t->factor) : 0; }

void peri_two_level_destroy(peri_two_level *t) {
    peri_allocator memory;
    if (!t) return;
    memory = t->memory;
    peri_cholesky_destroy(t->factor);
    if (t->value)
        peri__resize(&memory, t->value, ((size_t)t->row[t->parts] + 1) * (sizeof *t->value + sizeof *t->col), 0);
    if (t->line) peri__resize(&memory, t->line, t->bytes, 0);
    peri__resize(&memory, t, sizeof *t, 0);
}

#endif /* PERI_NO_CHOLESKY */

#endif /* PERI_SOLVER_IMPLEMENTED */
#endif /* PERI_IMPLEMENTATION */

/*
MIT License

Copyright (c) 2026 the peri authors

Permission is hereby granted, free of charge, to any person obtaining a copy of this software and associated
documentation files (the "Software"), to deal in the Software without restriction, including without limitation the
rights to use, copy, modify, merge, publish, distribute, sublicense, and/or sell copies of the Software, and to permit
persons to whom the Software is furnished to do so, subject to the following conditions:

The above copyright notice and this permission notice shall be included in all copies or substantial portions of the
Software.

THE SOFTWARE IS PROVIDED "AS IS", WITHOUT WARRANTY OF ANY KIND, EXPRESS OR IMPLIED, INCLUDING BUT NOT LIMITED TO THE
WARRANTIES OF MERCHANTABILITY, FITNESS FOR A PARTICULAR PURPOSE AND NONINFRINGEMENT. IN NO EVENT SHALL THE AUTHORS OR
COPYRIGHT HOLDERS BE LIABLE FOR ANY CLAIM, DAMAGES OR OTHER LIABILITY, WHETHER IN AN ACTION OF CONTRACT, TORT OR
OTHERWISE, ARISING FROM, OUT OF OR IN CONNECTION WITH THE SOFTWARE OR THE USE OR OTHER DEALINGS IN THE SOFTWARE.
*/
