/* tests/bench/cholesky.c - peri's sparse Cholesky beside CHOLMOD (supernodal with METIS and with AMD, simplicial with
   AMD) and Eigen (SimplicialLLT), both optional, on peri's matrices, in one run and one thread.

       apt-get install libsuitesparse-dev libopenblas-dev libeigen3-dev
       make bench BENCH=cholesky CFLAGS="-O3 -march=native"     (SIZE=quick: a minute; SIZE=full: a quarter hour)

   Matrices: cholesky/solver.h, with kappa 1000. Times are CPU time of the thread, the minimum over repetitions; factor
   is a refactorisation, the pattern as before and the values changed; solve3 is of 3 right-hand sides. CHOLMOD's speed
   is that of its BLAS, named in the first line; OPENBLAS_CORETYPE chooses other kernels of OpenBLAS. nnz(L): the peers'
   leaves out zeros that they store for speed, peri's is peri_cholesky_entries. Bytes: of peri peri_cholesky_bytes, of
   the peers the lengths of their factor's arrays. residual: |b - A x| / |b| of one cold solve, the worst of the 3.

   Prints a table for each matrix, what float reaches with residuals in double, and ratios with their targets: of each
   the worst case, named, and the median. Writes all of the tables as CSV to the file named as the first argument.
   Ends with 1 when a solution is wrong. A solver whose last speed predicts too long a factorisation only analyses, and
   shows dashes: 3 s for a peer, 20 s for peri and for CHOLMOD with METIS (quick: 1.2 s and 4 s).
   Without peers: make bench BENCH=cholesky CHOLMOD= EIGEN= */
#define _POSIX_C_SOURCE 200112L
#include "bench.h"
#include "cholesky/solver.h"
#include <math.h>

/* Rows of `solvers`; those after SOLVERS stand for several. */
enum { PERI, PERI_FLOAT, PERI_DEGREE, METIS, AMD, SIMPLICIAL, EIGEN, SOLVERS, BEST_CHOLMOD = SOLVERS };

static const solver *const solvers[SOLVERS] = {
    &bench_peri_double, &bench_peri_float, &bench_peri_double_degree,
#ifdef BENCH_CHOLMOD
    &bench_cholmod_metis, &bench_cholmod_amd, &bench_cholmod_simplicial,
#else
    NULL, NULL, NULL,
#endif
#ifdef BENCH_EIGEN
    &bench_eigen_llt,
#else
    NULL,
#endif
};

/* -- the matrices -- */

static const char *const shape_names[] = {"cube", "ball", "beam", "sheet"};

/* Thousands of points, up to a 0. Neighbours: 26 at horizon 2.00, 32 at 2.10, 122 at 3.01 (a sheet: 8, 12, 28). */
static const struct {
    int shape;
    double horizon;
    int quick[4], full[7];
} groups[] = {
    {CUBE, 2.00, {1, 5, 10}, {1, 5, 10, 25, 50, 100}},
    {CUBE, 2.10, {5}, {1, 5, 10, 25}},
    {CUBE, 3.01, {5}, {1, 5, 10, 25}},
    {BALL, 2.00, {10}, {1, 5, 10, 25, 50}},
    {BALL, 3.01, {0}, {10}},
    {BEAM, 2.00, {10}, {1, 5, 10, 25, 50}},
    {BEAM, 3.01, {0}, {10}},
    {SHEET, 2.00, {1, 10}, {1, 5, 10, 25, 50, 100}},
    {SHEET, 3.01, {0}, {10}},
};
enum { GROUPS = sizeof groups / sizeof *groups, MOST_CASES = 7 * GROUPS };

/* -- measuring -- */

enum { ENTRIES, ANALYSE, FACTOR, SOLVE, BYTES, RESIDUAL, MEASURES };

/* What was measured of a matrix; below 0: was not. */
typedef struct result {
    int shape, n;
    double horizon;
    double of[SOLVERS][MEASURES];
} result;

/* How long, in ms: repetitions of one measurement; a factorisation by a peer; by peri or the best peer. */
typedef struct budget {
    double repeat, peer, chief;
} budget;

/* Starts afresh each time; leaves the last state, analysed, in *state (NULL: it failed). */
static double time_analyse(const solver *s, const problem *p, double repeat, void **state) {
    double best = 1e30, spent = 0;
    int k;
    *state = NULL;
    for (k = 0; k < 2 || spent < repeat; k++) {
        double t;
        if (*state) s->close(*state);
        if ((*state = s->open(s->method, p)) == NULL) return -1;
        t = bench_thread();
        if (!s->analyse(*state)) {
            s->close(*state);
            *state = NULL;
            return -1;
        }
        t = bench_thread() - t;
        spent += t;
        if (t < best) best = t;
    }
    return best;
}

/* The first of at least two finds its memory new and is not counted. Ends with the values of kappa 1000. */
static double time_factor(const solver *s, problem *p, double repeat, void *state) {
    double best = 1e30, spent = 0;
    int k, last = 0;
    for (k = 0; !last; k++) {
        double t;
        last = k > 0 && spent >= repeat;
        problem_set(p, last || k % 2 ? 1000 : 1001);
        s->load(state, p);
        t = bench_thread();
        if (!s->factor(state)) return -1;
        t = bench_thread() - t;
        spent += t;
        if (k > 0 && t < best) best = t;
    }
    return best;
}

static double time_solve(const solver *s, const double *b, double repeat, void *state) {
    double best = 1e30, spent = 0;
    int k;
    for (k = 0; k < 3 || spent < repeat; k++) {
        double t;
        s->set(state, b);
        t = bench_thread();
        s->solve(state);
        t = bench_thread() - t;
        spent += t;
        if (t < best) best = t;
    }
    return best;
}

/* speed: operations per ms of the solver's last factorisation, 0 before its first. */
static void measure(const solver *s, problem *p, const double *b, budget most, double *speed, double of[MEASURES]) {
    void *state;
    double *x = (double *)bench_obtain(6 * sizeof *x * (size_t)p->n), limit;
    facts f;
    of[ANALYSE] = time_analyse(s, p, most.repeat, &state);
    if (state) {
        f = s->ask(state);
        of[ENTRIES] = f.entries;
        limit = s == solvers[PERI] || s == solvers[PERI_FLOAT] || s == solvers[METIS] ? most.chief : most.peer;
        if (!(*speed > 0 && f.operations / *speed > limit)) of[FACTOR] = time_factor(s, p, most.repeat, state);
        if (of[FACTOR] >= 0) {
            *speed = f.operations / of[FACTOR];
            of[BYTES] = s->ask(state).bytes;
            of[SOLVE] = time_solve(s, b, most.repeat, state);
            s->get(state, x);
            of[RESIDUAL] = problem_residual(p, b, x, x + 3 * (size_t)p->n);
        }
        s->close(state);
    }
    free(x);
}

/* -- a displacement to be found -- */

/* Waves about as long as the body, and noise of 1 %; x0: what is known of it, 5 % wrong by other waves. */
static void displacement(const problem *p, double *x, double *x0) {
    double longest = 0;
    unsigned noise = 1;
    int i, c;
    for (i = 0; i < 3 * p->n; i++)
        if (p->xyz[i] > longest) longest = p->xyz[i];
    for (i = 0; i < p->n; i++)
        for (c = 0; c < 3; c++) {
            const double *at = p->xyz + 3 * (size_t)i;
            size_t k = 3 * (size_t)i + (size_t)c;
            double u = 3.0 * at[c] / longest, v = 5.0 * at[(c + 1) % 3] / longest, w = 4.0 * at[(c + 2) % 3] / longest;
            noise = 1664525u * noise + 1013904223u;
            x[k] = sin(u + c) + 0.5 * cos(v - c) + 0.01 * (2.0 * (noise >> 8 & 0xffff) / 0xffff - 1);
            x0[k] = x[k] - 0.05 * cos(w + u + c);
        }
}

/* b = A x: what remains of a right-hand side of zero, with the sign changed. */
static void right_hand_side(const problem *p, const double *x, double *b) {
    double *zero = (double *)calloc(3 * (size_t)p->n, sizeof *zero);
    size_t i;
    if (!zero) exit(1);
    problem_residual(p, zero, x, b);
    for (i = 0; i < 3 * (size_t)p->n; i++) b[i] = -b[i];
    free(zero);
}

/* -- float with residuals in double -- */

static const char *verdict(double value, double target) { return value <= target ? "reached" : "MISSED"; }

/* x += what the factor makes of b - A x. Returns the residual before. */
static double refine(const solver *s, void *state, const problem *p, const double *b, double *x, double *work) {
    double *r = work, *d = work + 3 * (size_t)p->n, before = problem_residual(p, b, x, r);
    int i;
    s->set(state, r);
    s->solve(state);
    s->get(state, d);
    for (i = 0; i < 3 * p->n; i++) x[i] += d[i];
    return before;
}

/* Residuals: r[0] of one cold solve, r[1] of the warm start, r[2] after a solve from there, r[3] after one more. */
static int accuracy_of(const solver *s, const problem *p, double r[4]) {
    size_t n = 3 * (size_t)p->n, i;
    double *b = (double *)bench_obtain(6 * n * sizeof *b), *x = b + n, *x0 = x + n, *cold = x0 + n, *work = cold + n;
    void *state = s->open(s->method, p);
    int good = state && s->analyse(state);
    displacement(p, x, x0);
    right_hand_side(p, x, b);
    for (i = 0; i < n; i++) cold[i] = 0;
    if (good) s->load(state, p);
    good = good && s->factor(state);
    if (good) {
        refine(s, state, p, b, cold, work);
        r[0] = problem_residual(p, b, cold, work);
        r[1] = refine(s, state, p, b, x0, work);
        r[2] = refine(s, state, p, b, x0, work);
        r[3] = problem_residual(p, b, x0, work);
    }
    if (state) s->close(state);
    free(b);
    return good;
}

static void accuracy(int quick) {
    int g, k;
    printf("\nfloat with residuals in double (relative residual; warm: 95 %% of the solution is known; row stiffness is"
           " kappa times the mass)\n");
    printf("  %-6s %7s %6s %6s %9s %9s %9s %9s\n", "", "horizon", "n", "kappa", "cold", "warm", "1 solve", "2 solves");
    for (g = 0; g < GROUPS; g++)
        for (k = 3; k <= 7; k += 2) {
            problem p;
            double r[4];
            if (quick && g > 0) continue;
            problem_create(&p, groups[g].shape, 10000, groups[g].horizon);
            problem_set(&p, pow(10, k));
            printf("  %-6s %7.2f %6d    1e%d", shape_names[groups[g].shape], groups[g].horizon, p.n, k);
            if (!accuracy_of(&bench_peri_float, &p, r)) printf(" failed\n");
            else {
                printf(" %9.1e %9.1e %9.1e %9.1e   1 solve <= 1e-6: %s", r[0], r[1], r[2], r[3], verdict(r[2], 1e-6));
                if (k == 5) printf(", 2 solves <= 1e-9: %s", verdict(r[3], 1e-9));
                printf("\n");
            }
            fflush(stdout);
            problem_destroy(&p);
        }
}

/* -- tables -- */

static void print_number(const char *format, int width, double value) {
    if (value < 0) printf(" %*s", width, "-");
    else printf(format, width, value);
}

static void print_row(const solver *s, const double of[MEASURES]) {
    printf("  %-24s %-6s", s->name, s->precision);
    print_number(" %*.0f", 10, of[ENTRIES]);
    print_number(" %*.2f", 10, of[ANALYSE]);
    print_number(" %*.3f", 10, of[FACTOR]);
    print_number(" %*.3f", 9, of[SOLVE]);
    print_number(" %*.2f", 7, of[BYTES] < 0 ? -1 : 1e-6 * of[BYTES]);
    print_number(" %*.1e", 9, of[RESIDUAL]);
    printf("\n");
    fflush(stdout);
}

static void write_number(FILE *csv, double value) {
    if (value < 0) fprintf(csv, ",");
    else fprintf(csv, ",%.6g", value);
}

static void write_row(FILE *csv, const result *r, int s, int threads) {
    static const int order[] = {ANALYSE, FACTOR, SOLVE, BYTES, RESIDUAL};
    int k;
    fprintf(csv, "%s,%.2f,%d,%s,%s,%d", shape_names[r->shape], r->horizon, r->n, solvers[s]->name,
            solvers[s]->precision, threads);
    if (r->of[s][ENTRIES] < 0) fprintf(csv, ",");
    else fprintf(csv, ",%.0f", r->of[s][ENTRIES]);
    for (k = 0; k < (int)(sizeof order / sizeof *order); k++) write_number(csv, r->of[s][order[k]]);
    fprintf(csv, "\n");
}

/* One matrix, all solvers, one thread: the column is there for rows of peri's with more. Returns 0 when a solution is
   wrong: a component lost, say, leaves a residual of 0.01. */
static int run(result *r, int shape, int count, double horizon, budget most, double speed[SOLVERS], FILE *csv) {
    problem p;
    double *b, *x;
    int s, k, good = 1;
    problem_create(&p, shape, count, horizon);
    problem_set(&p, 1000);
    r->shape = shape;
    r->n = p.n;
    r->horizon = horizon;
    b = (double *)bench_obtain(9 * sizeof *b * (size_t)p.n);
    x = b + 3 * (size_t)p.n;
    displacement(&p, x, x + 3 * (size_t)p.n);
    right_hand_side(&p, x, b);
    printf("%s, horizon %.2f, n %d, entries of A %d\n", shape_names[shape], horizon, p.n, p.n + p.row[p.n]);
    printf("  %-24s %-6s %10s %10s %10s %9s %7s %9s\n", "", "", "nnz(L)", "analyse ms", "factor ms", "solve3 ms", "MB",
           "residual");
    for (s = 0; s < SOLVERS; s++) {
        double *of = r->of[s];
        for (k = 0; k < MEASURES; k++) of[k] = -1;
        if (!solvers[s]) continue;
        measure(solvers[s], &p, b, most, &speed[s], of);
        print_row(solvers[s], of);
        if (csv) write_row(csv, r, s, 1);
        if (of[RESIDUAL] > (solvers[s]->precision[0] == 'd' ? 1e-10 : 1e-3)) good = 0;
    }
    free(b);
    problem_destroy(&p);
    if (!good) printf("  WRONG: a residual is too large\n");
    return good;
}

/* -- ratios -- */

/* Classes of matrices that a target is for. */
enum { SOLID = 1, FLAT = 2, NEAR = 4, FAR = 8, LARGE = 16, REST = 32 };

/* of[measure] of `over` divided by that of `under`. target 0: only to be known. */
typedef struct ratio {
    int measure, over, under, where;
    double target;
} ratio;

static const ratio ratios[] = {
    {ENTRIES, PERI, AMD, SOLID | LARGE | NEAR, 0.85},
    {ENTRIES, PERI, AMD, SOLID | LARGE | FAR, 0},
    {ENTRIES, PERI, METIS, SOLID | LARGE | NEAR, 1.05},
    {ENTRIES, PERI, METIS, SOLID | LARGE | FAR, 0},
    {ENTRIES, PERI, AMD, FLAT, 1.05},
    {ENTRIES, PERI_DEGREE, AMD, 0, 0},
    {ANALYSE, PERI, METIS, 0, 0.20},
    {ANALYSE, PERI_DEGREE, AMD, 0, 0},
    {FACTOR, PERI, METIS, NEAR, 0.60},
    {FACTOR, PERI, METIS, FAR, 1.00},
    {FACTOR, PERI_FLOAT, METIS, NEAR, 0.35},
    {FACTOR, PERI_FLOAT, METIS, FAR, 0.50},
    {FACTOR, PERI, EIGEN, SOLID | LARGE, 0.10},
    {FACTOR, PERI, BEST_CHOLMOD, 0, 0},
    {SOLVE, PERI, METIS, SOLID | LARGE, 0.60},
    {SOLVE, PERI, METIS, REST, 0.60},
    {SOLVE, PERI_FLOAT, METIS, SOLID | LARGE, 0.30},
    {SOLVE, PERI_FLOAT, METIS, REST, 0.30},
    {SOLVE, PERI, EIGEN, SOLID | LARGE, 0.25},
    {SOLVE, PERI, EIGEN, REST, 0.25},
    {SOLVE, PERI_FLOAT, EIGEN, SOLID | LARGE, 0.12},
    {SOLVE, PERI_FLOAT, EIGEN, REST, 0.12},
    {SOLVE, PERI, BEST_CHOLMOD, 0, 0},
    {BYTES, PERI, METIS, 0, 0},
    {BYTES, PERI_FLOAT, METIS, 0, 0.60},
};

static int belongs(const result *r, int where) {
    int solid = r->shape != SHEET, near = r->horizon < 2.05, large = r->n > 4500; /* 17^3 counts as 5 thousand */
    if (where & SOLID && !solid) return 0;
    if (where & FLAT && solid) return 0;
    if (where & NEAR && !near) return 0;
    if (where & FAR && near) return 0;
    if (where & LARGE && !large) return 0;
    return !(where & REST && solid && large);
}

/* Of a row of `solvers`, or of the CHOLMOD that did best. */
static double value_of(const result *r, int s, int measure) {
    double best = -1;
    int k;
    if (s < SOLVERS) return r->of[s][measure];
    for (k = METIS; k <= SIMPLICIAL; k++)
        if (r->of[k][measure] >= 0 && (best < 0 || r->of[k][measure] < best)) best = r->of[k][measure];
    return best;
}

static void print_title(const ratio *t) {
    static const char *const measures[] = {"nnz(L)", "analyse", "refactor", "solve3", "bytes"};
    static const char *const names[] = {"peri double", "peri float",     "peri by degree", "CHOLMOD METIS",
                                        "CHOLMOD AMD", "CHOLMOD simpl.", "Eigen LLT",      "best CHOLMOD"};
    char where[60];
    sprintf(where, "%s%s%s%s%s", t->where & SOLID ? "3-D " : "", t->where & FLAT ? "sheets " : "",
            t->where & LARGE ? "n >= 5k " : "", t->where & REST ? "sheets, n < 5k " : "",
            t->where & NEAR ? "horizon 2" : t->where & FAR ? "other horizons" : "");
    printf("  %-8s %-14s / %-14s %-26s", measures[t->measure], names[t->over], names[t->under], where);
}

/* Returns whether the target is reached, -1 where there is none or nothing was measured. */
static int print_ratio(const ratio *t, const result *r, int cases) {
    double q[MOST_CASES], worst = -1;
    int k, count = 0, at = 0;
    for (k = 0; k < cases; k++) {
        double over = value_of(&r[k], t->over, t->measure), under = value_of(&r[k], t->under, t->measure);
        if (!belongs(&r[k], t->where) || over < 0 || under <= 0) continue;
        q[count++] = over / under;
        if (over / under <= worst) continue;
        worst = over / under;
        at = k;
    }
    print_title(t);
    if (t->target > 0) printf(" %6.2f", t->target);
    else printf(" %6s", "");
    if (!count) {
        printf("  not measured\n");
        return -1;
    }
    printf(" %6.3f %6.3f  %-7s %s %.2f %d\n", bench_median(q, count, NULL), worst,
           t->target > 0 ? verdict(worst, t->target) : "", shape_names[r[at].shape], r[at].horizon, r[at].n);
    return t->target > 0 ? worst <= t->target : -1;
}

static void print_ratios(const result *r, int cases) {
    int reached = 0, targets = 0;
    size_t k;
    printf("\n%-69s target median  worst\n", "ratios");
    for (k = 0; k < sizeof ratios / sizeof *ratios; k++) {
        int mark = print_ratio(&ratios[k], r, cases);
        reached += mark > 0;
        targets += mark >= 0;
    }
    printf("%d of %d targets reached\n", reached, targets);
}

static void begin_peers(char **argv) {
#ifdef BENCH_CHOLMOD
    printf("CHOLMOD's BLAS: %s\n", bench_cholmod_begin(argv));
#else
    (void)argv;
    printf("skipped: CHOLMOD is not installed (libsuitesparse-dev, with libopenblas-dev)\n");
#endif
#ifndef BENCH_EIGEN
    printf("skipped: Eigen is not installed (libeigen3-dev, and a C++ compiler)\n");
#endif
}

int main(int argc, char **argv) {
    int full = bench_full(argc, argv), g, k, cases = 0, total = 0, good = 1;
    static const budget quick_budget = {80, 1200, 4000}, full_budget = {300, 3000, 20000};
    static const char columns[] = "shape,horizon,n,solver,precision,threads,nnz_l,analyse_ms,factor_ms,solve3_ms,bytes,"
                                  "residual";
    static result results[MOST_CASES];
    double speed[SOLVERS] = {0};
    FILE *csv;
    begin_peers(argv);
    csv = bench_csv(argc, argv, columns);
    for (g = 0; g < GROUPS; g++)
        for (k = 0; (full ? groups[g].full : groups[g].quick)[k]; k++) total++;
    for (g = 0; g < GROUPS; g++) {
        const int *thousands = full ? groups[g].full : groups[g].quick;
        for (k = 0; thousands[k]; k++) {
            printf("\n[%d of %d] ", cases + 1, total);
            if (!run(&results[cases++], groups[g].shape, 1000 * thousands[k], groups[g].horizon,
                     full ? full_budget : quick_budget, speed, csv))
                good = 0;
        }
    }
    accuracy(!full);
    print_ratios(results, cases);
    if (csv) fclose(csv);
    return good ? 0 : 1;
}
