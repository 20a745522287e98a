/* tests/test_iterative.c - peri_solver.h: solvers of A x = b that iterate, preconditioners, line search, minimisation,
   Anderson acceleration.

   u stands for the unit roundoff. The chain with diagonal 2 and bonds -1 has D^-1 A with the eigenvalues
   1 - cos(k pi / (n + 1)), so rates can be held against theory. */
#include <stdlib.h>

static int allocations;

static void *count_realloc(void *ptr, size_t bytes) {
    allocations++;
    return realloc(ptr, bytes);
}

#define realloc(ptr, bytes) count_realloc(ptr, bytes)
#define PERI_IMPLEMENTATION
#include "../peri_solver.h"
#undef realloc

#include <float.h>

#include "test.h"

#ifdef PERI_DOUBLE
#define U (0.5 * DBL_EPSILON)
#define SMALL_TOLERANCE 1e-11
#else
#define U (0.5 * (double)FLT_EPSILON)
#define SMALL_TOLERANCE 2e-6
#endif
#define PI 3.14159265358979323846

static uint64_t seed = 1;

/* Uniform in [0, 1), from Knuth's MMIX generator. */
static double chance(void) {
    seed = seed * 6364136223846793005ULL + 1442695040888963407ULL;
    return (double)(seed >> 11) / 9007199254740992.0;
}

static double spread(void) { return 2 * chance() - 1; }

static void *grab(size_t count, size_t bytes) {
    void *p = calloc(count ? count : 1, bytes);
    if (!p) exit(2);
    return p;
}

/* ---- systems ----------------------------------------------------------------------------------------------------- */

typedef struct sparse {
    int n, *row, *col;
    peri_real *value, *diagonal;
    peri_matrix a;
} sparse;

static void sparse_begin(sparse *m, int n, int entries) {
    m->n = n;
    m->row = (int *)grab((size_t)n + 1, sizeof(int));
    m->col = (int *)grab((size_t)entries, sizeof(int));
    m->value = (peri_real *)grab((size_t)entries, sizeof(peri_real));
    m->diagonal = (peri_real *)grab((size_t)n, sizeof(peri_real));
    m->a.n = n;
    m->a.row = m->row;
    m->a.col = m->col;
    m->a.value = m->value;
    m->a.diagonal = m->diagonal;
}

static void sparse_end(sparse *m) {
    free(m->row);
    free(m->col);
    free(m->value);
    free(m->diagonal);
}

static double bond(int i, int j) {
    unsigned low = (unsigned)(i < j ? i : j), high = (unsigned)(i < j ? j : i);
    unsigned h = (low * 2654435761u) ^ (high * 2246822519u);
    h = (h ^ (h >> 15)) * 2654435761u;
    return -0.1 - (h >> 8) / 16777216.0;
}

/* Boxes of nx ny nz points with bonds to the 26 around, `boxes` apart from each other; diagonal: sum + shift. */
static void lattice(sparse *m, int nx, int ny, int nz, int boxes, double shift) {
    int box = nx * ny * nz, i, k = 0, x, y, z;
    sparse_begin(m, box * boxes, 26 * box * boxes);
    for (i = 0; i < m->n; i++) {
        int p = i % box, px = p % nx, py = p / nx % ny, pz = p / nx / ny;
        double sum = shift;
        for (z = pz - 1; z <= pz + 1; z++)
            for (y = py - 1; y <= py + 1; y++)
                for (x = px - 1; x <= px + 1; x++) {
                    int j = i / box * box + (z * ny + y) * nx + x;
                    if (x < 0 || y < 0 || z < 0 || x >= nx || y >= ny || z >= nz || j == i) continue;
                    m->col[k] = j;
                    m->value[k] = (peri_real)bond(i, j);
                    sum += fabs((double)m->value[k++]);
                }
        m->diagonal[i] = (peri_real)sum;
        m->row[i + 1] = k;
    }
}

static void chain(sparse *m, int n) {
    int i, k = 0;
    sparse_begin(m, n, 2 * n);
    for (i = 0; i < n; i++) {
        if (i > 0) m->col[k] = i - 1, m->value[k++] = -1;
        if (i < n - 1) m->col[k] = i + 1, m->value[k++] = -1;
        m->diagonal[i] = 2;
        m->row[i + 1] = k;
    }
}

/* Everybody bonded to everybody by `off`, diagonal 1: eigenvalues 1 - off and 1 + (n - 1) off. */
static void complete(sparse *m, int n, double off) {
    int i, j, k = 0;
    sparse_begin(m, n, n * n);
    for (i = 0; i < n; i++) {
        for (j = 0; j < n; j++)
            if (j != i) m->col[k] = j, m->value[k++] = (peri_real)off;
        m->diagonal[i] = 1;
        m->row[i + 1] = k;
    }
}

/* Kershaw's (1978): positive definite, and its incomplete factor has a negative pivot. */
static void kershaw(sparse *m) {
    static const int col[8] = {1, 3, 0, 2, 1, 3, 0, 2};
    static const int value[8] = {-2, 2, -2, -2, -2, -2, 2, -2};
    int i;
    sparse_begin(m, 4, 8);
    for (i = 0; i < 8; i++) {
        m->col[i] = col[i];
        m->value[i] = (peri_real)value[i];
    }
    for (i = 0; i < 4; i++) {
        m->diagonal[i] = 3;
        m->row[i + 1] = 2 * i + 2;
    }
}

static double norm(int n, const peri_real *x) {
    double sum = 0;
    int i;
    for (i = 0; i < n; i++) sum += (double)x[i] * (double)x[i];
    return sqrt(sum);
}

/* |b - A x| / |b|, without the library; *noise: what rounding in double may make of it, 30 terms a row and the sum */
static double residual_noise(const sparse *m, int rhs, const peri_real *b, const peri_real *x, double *noise) {
    double sum = 0, size = 0;
    int i, k, c;
    for (i = 0; i < m->n; i++)
        for (c = 0; c < rhs; c++) {
            double r = (double)b[rhs * i + c] - (double)m->diagonal[i] * (double)x[rhs * i + c];
            double w = fabs((double)m->diagonal[i] * (double)x[rhs * i + c]);
            for (k = m->row[i]; k < m->row[i + 1]; k++) {
                r -= (double)m->value[k] * (double)x[rhs * m->col[k] + c];
                w += fabs((double)m->value[k] * (double)x[rhs * m->col[k] + c]);
            }
            sum += r * r;
            size += w * w;
        }
    *noise = 30 * DBL_EPSILON * sqrt(size) / norm(rhs * m->n, b) + 1e-11 * sqrt(sum) / norm(rhs * m->n, b);
    return sqrt(sum) / norm(rhs * m->n, b);
}

static double residual(const sparse *m, int rhs, const peri_real *b, const peri_real *x) {
    double noise;
    return residual_noise(m, rhs, b, x, &noise);
}

typedef struct call {
    sparse m;
    int rhs, n;
    peri_real *b, *x, *work, *extra; /* extra: 2 n, for preconditioners */
    peri_iteration o;
    peri_report report;
    peri_error err;
} call;

static void call_begin(call *c, int rhs) {
    int i;
    c->rhs = rhs;
    c->n = rhs * c->m.n;
    c->b = (peri_real *)grab((size_t)c->n, sizeof(peri_real));
    c->x = (peri_real *)grab((size_t)c->n, sizeof(peri_real));
    c->extra = (peri_real *)grab(2 * (size_t)c->n, sizeof(peri_real));
    c->work = (peri_real *)grab(peri_solve_work(c->m.n, rhs), sizeof(peri_real));
    for (i = 0; i < c->n; i++) c->b[i] = (peri_real)spread();
    c->o = peri_default_iteration();
}

static void call_end(call *c) {
    free(c->b);
    free(c->x);
    free(c->extra);
    free(c->work);
    sparse_end(&c->m);
}

static peri_result solve(call *c, peri_solve *solver) {
    return solver(&c->m.a, c->rhs, c->b, c->x, c->work, &c->o, &c->report, &c->err);
}

static peri_result solve_from_zero(call *c, peri_solve *solver) {
    memset(c->x, 0, (size_t)c->n * sizeof *c->x);
    return solve(c, solver);
}

enum { SOLVERS = 3 };
static peri_solve *const solvers[SOLVERS] = {peri_solve_jacobi, peri_solve_chebyshev, peri_solve_cg};

/* It said so, and it is so. */
static void check_solved(const call *c, peri_result result) {
    double noise, found = residual_noise(&c->m, c->rhs, c->b, c->x, &noise);
    CHECK(result == PERI_OK && c->report.result == PERI_OK && c->err.code == PERI_OK);
    CHECK(c->report.residual <= c->o.tolerance);
    NEAR(found, c->report.residual, noise);
}

/* ---- A x = b ----------------------------------------------------------------------------------------------------- */

/* Of dominant matrices no eigenvalue is below the shift, so the error is at most residual |b| / shift. */
static void solves_dense(void) {
    call c;
    double l[60 * 60], y[60];
    int rhs, s, i, j, k, q;
    for (rhs = 1; rhs <= 3; rhs++) {
        lattice(&c.m, 5, 4, 3, 1, 1);
        call_begin(&c, rhs);
        memset(l, 0, sizeof l);
        for (i = 0; i < 60; i++) {
            l[60 * i + i] = (double)c.m.diagonal[i];
            for (k = c.m.row[i]; k < c.m.row[i + 1]; k++) l[60 * i + c.m.col[k]] = (double)c.m.value[k];
        }
        for (j = 0; j < 60; j++)
            for (i = j; i < 60; i++) {
                for (k = 0; k < j; k++) l[60 * i + j] -= l[60 * i + k] * l[60 * j + k];
                l[60 * i + j] = i == j ? sqrt(l[60 * j + j]) : l[60 * i + j] / l[60 * j + j];
            }
        c.o.tolerance = SMALL_TOLERANCE;
        for (s = 0; s < SOLVERS; s++) {
            check_solved(&c, solve_from_zero(&c, solvers[s]));
            for (q = 0; q < rhs; q++) {
                for (i = 0; i < 60; i++) {
                    for (y[i] = (double)c.b[rhs * i + q], k = 0; k < i; k++) y[i] -= l[60 * i + k] * y[k];
                    y[i] /= l[60 * i + i];
                }
                for (i = 59; i >= 0; i--) {
                    for (k = i + 1; k < 60; k++) y[i] -= l[60 * k + i] * y[k];
                    y[i] /= l[60 * i + i];
                    NEAR(c.x[rhs * i + q], y[i], c.o.tolerance * norm(c.n, c.b) + 1e-12);
                }
            }
        }
        call_end(&c);
    }
}

/* In as many steps as D^-1 A has different eigenvalues; in double rounding does not spoil that for few rows. */
static void cg_ends(void) {
    call c;
    int n;
    complete(&c.m, 50, 0.3);
    call_begin(&c, 3);
    c.o.tolerance = 1e-5;
    check_solved(&c, solve_from_zero(&c, peri_solve_cg));
    CHECK(c.report.iterations <= 2);
    call_end(&c);
    for (n = 1; n <= 12; n++) {
        chain(&c.m, n);
        call_begin(&c, 1);
        c.o.tolerance = SMALL_TOLERANCE;
        check_solved(&c, solve_from_zero(&c, peri_solve_cg));
        CHECK(c.report.iterations <= n);
        call_end(&c);
    }
}

typedef struct curve {
    int count, last;
    double value[2000];
} curve;

static void record(int iteration, double value, void *user) {
    curve *c = (curve *)user;
    if (iteration < 2000) c->value[iteration] = value;
    c->count++;
    c->last = iteration;
}

/* The error in energy falls at least as 2 ((sqrt k - 1) / (sqrt k + 1))^j; the residual is at most sqrt k times it. */
static void cg_rate(void) {
    call c;
    int n = 150;
    double low = 1 - cos(PI / (n + 1)), high = 1 + cos(PI / (n + 1)), root = sqrt(high / low), bound;
    chain(&c.m, n);
    call_begin(&c, 2);
    c.o.tolerance = sizeof(peri_real) > 4 ? 1e-6 : 1e-2;
    bound = log(2 * root / c.o.tolerance) / log((root + 1) / (root - 1));
    check_solved(&c, solve_from_zero(&c, peri_solve_cg));
    CHECK(c.report.iterations <= bound && c.report.iterations >= 10);
    call_end(&c);
}

static double chebyshev(int n, double x) { return cosh(n * acosh(x)); }

/* Given the interval, every residual is below its bound; on the slowest eigenvector it is the bound. */
static void chebyshev_rate(void) {
    call c;
    peri_spectrum spectrum;
    curve seen;
    int n = 30, k, i, which;
    double y;
    chain(&c.m, n);
    call_begin(&c, 1);
    memset(&spectrum, 0, sizeof spectrum);
    spectrum.low = 1 - cos(PI / (n + 1));
    spectrum.high = 1 + cos(PI / (n + 1));
    y = (spectrum.high + spectrum.low) / (spectrum.high - spectrum.low);
    c.o.spectrum = &spectrum;
    c.o.watch = record;
    c.o.user = &seen;
    c.o.tolerance = sizeof(peri_real) > 4 ? 1e-9 : 1e-3;
    for (which = 0; which < 2; which++) {
        memset(&seen, 0, sizeof seen);
        for (i = 0; i < n && which; i++) c.b[i] = (peri_real)sin((i + 1) * PI / (n + 1));
        check_solved(&c, solve_from_zero(&c, peri_solve_chebyshev));
        CHECK(c.report.restarts == 0 && c.report.fallbacks == 0 && spectrum.products == 0);
        CHECK(seen.last == c.report.iterations && seen.count == seen.last && seen.last > 40 && seen.last < 2000);
        for (k = 1; k <= seen.last; k++) {
            /* x has entries below 200 |b| / n; each iteration rounds it once */
            CHECK(seen.value[k] <= 1 / chebyshev(k, y) + 200 * 4 * U * k);
            if (which) NEAR(seen.value[k], 1 / chebyshev(k, y), 200 * 4 * U * k);
        }
    }
    CHECK(chebyshev(c.report.iterations - 1, y) < 1.01 / c.o.tolerance); /* it stops as soon as it may */
    call_end(&c);
}

static void estimates_spectrum(void) {
    call c;
    peri_spectrum s;
    int n, steps;
    for (n = 1; n <= 64; n *= 2)
        for (steps = 8; steps <= 64; steps *= 2) {
            double low = 1 - cos(PI / (n + 1)), high = 1 + cos(PI / (n + 1));
            chain(&c.m, n);
            call_begin(&c, 1);
            memset(&s, 0, sizeof s);
            CHECK(peri_spectrum_estimate(&s, &c.m.a, steps, c.work, NULL, &c.err) == PERI_OK && c.err.code == PERI_OK);
            CHECK(s.products >= 1 && s.products <= steps);
            NEAR(s.bound_high, n == 1 ? 1 : n == 2 ? 1.5 : 2, 4 * U);
            NEAR(s.bound_low, n == 1 ? 1 : n == 2 ? 0.5 : 0, 4 * U);
            CHECK(s.high <= s.bound_high && s.low >= s.bound_low && s.low <= s.high);
            CHECK(s.high >= 0.99 * high); /* Ritz values come from within, 5 % are added */
            CHECK(s.low >= 0.94 * low);
            if (steps >= n) { /* Lanczos has seen them all */
                NEAR(s.low, 0.95 * low > s.bound_low ? 0.95 * low : s.bound_low, 2e-3 * low + 100 * U);
                CHECK(s.high >= high * (1 - 1e-3) && s.high <= 1.051 * high);
            }
            call_end(&c);
        }
}

/* ---- never diverging --------------------------------------------------------------------------------------------- */

/* x += p(b - A x) with the polynomial of a wrong interval, as the solver would without its looks: grows. */
static double blind(const call *c, double low, double high) {
    peri_polynomial q;
    peri_real *w = (peri_real *)grab(5 * (size_t)c->n, sizeof *w), *r = w, *p = w + c->n, *x = p + c->n;
    double end;
    int cycle, i, k, d;
    q.a = &c->m.a;
    q.rhs = c->rhs;
    q.sweeps = 16;
    q.low = low;
    q.high = high;
    q.parallel = NULL;
    q.work = x + c->n;
    for (cycle = 0; cycle < 6; cycle++) {
        for (i = 0; i < c->m.n; i++)
            for (d = 0; d < c->rhs; d++) {
                double sum = (double)c->b[c->rhs * i + d] - (double)c->m.diagonal[i] * (double)x[c->rhs * i + d];
                for (k = c->m.row[i]; k < c->m.row[i + 1]; k++)
                    sum -= (double)c->m.value[k] * (double)x[c->rhs * c->m.col[k] + d];
                r[c->rhs * i + d] = (peri_real)sum;
            }
        peri_polynomial_apply(r, p, &q);
        for (i = 0; i < c->n; i++) x[i] += p[i];
    }
    end = residual(&c->m, c->rhs, c->b, x);
    free(w);
    return end;
}

static void never_diverges(void) {
    static const double high[4] = {0.2, 0.5, 0.8, 0.9}, low[4] = {1, 30, 300, 0.01};
    call c;
    peri_spectrum exact, s;
    int i, k, wrong, tried = 0;
    lattice(&c.m, 12, 11, 10, 1, 0.1);
    call_begin(&c, 3);
    memset(&exact, 0, sizeof exact);
    CHECK(peri_spectrum_estimate(&exact, &c.m.a, 64, c.work, NULL, NULL) == PERI_OK);
    CHECK(blind(&c, exact.low, exact.high) < 0.5);
    c.o.tolerance = sizeof(peri_real) > 4 ? 1e-9 : 1e-4;
    for (i = 0; i < 4; i++)
        for (k = 0; k < 4; k++) {
            s = exact;
            s.high = high[i] * exact.high;
            s.low = low[k] * exact.low < 0.9 * s.high ? low[k] * exact.low : 0.9 * s.high;
            wrong = 0.85 * exact.high > s.low + s.high; /* T(n, y) outgrows T(n, y0) above low + high */
            if (wrong) CHECK(!(blind(&c, s.low, s.high) < 1));
            tried += wrong;
            c.o.spectrum = &s;
            check_solved(&c, solve_from_zero(&c, peri_solve_chebyshev));
            CHECK(c.report.restarts >= wrong && c.report.restarts <= 16);
            if (c.report.fallbacks) continue;
            check_solved(&c, solve_from_zero(&c, peri_solve_chebyshev)); /* what it has learnt holds */
            CHECK(c.report.restarts <= 1 && c.report.fallbacks == 0);
        }
    CHECK(tried >= 6);
    call_end(&c);
}

/* Numbers that are no interval are estimated anew. */
static void odd_spectrum(void) {
    static const double odd[6][2] = {{0, 0}, {-1, 1}, {1, -1}, {2, 1}, {1, HUGE_VAL}, {0, 1}};
    call c;
    peri_spectrum s;
    int k;
    lattice(&c.m, 6, 6, 6, 1, 0.1);
    call_begin(&c, 1);
    for (k = 0; k < 7; k++) {
        memset(&s, 0, sizeof s);
        s.low = k < 6 ? odd[k][0] : peri__from_bits(PERI__NAN);
        s.high = k < 6 ? odd[k][1] : peri__from_bits(PERI__NAN);
        c.o.spectrum = &s;
        check_solved(&c, solve_from_zero(&c, peri_solve_chebyshev));
        CHECK(s.products > 0 && s.low > 0 && s.high >= s.low && s.high <= s.bound_high);
    }
    call_end(&c);
}

/* A stiffer, a softer matrix with the same spectrum: the solver finds its way. */
static void spectrum_of_changing_matrix(void) {
    call c;
    peri_spectrum s;
    int step, i;
    memset(&s, 0, sizeof s);
    lattice(&c.m, 10, 10, 10, 1, 1);
    call_begin(&c, 3);
    c.o.spectrum = &s;
    for (step = 0; step < 8; step++) {
        /* a chequerboard's bonds turn positive, which takes the top of the spectrum up; the shift goes down */
        for (i = 0; i < c.m.n; i++) c.m.diagonal[i] = (peri_real)((double)c.m.diagonal[i] - (step < 4 ? 0.2 : -0.2));
        for (i = 0; i < c.m.row[c.m.n]; i++)
            if (step % 3 == 1) c.m.value[i] = -c.m.value[i];
        check_solved(&c, solve_from_zero(&c, peri_solve_chebyshev));
    }
    CHECK(s.products <= 20); /* one estimate */
    call_end(&c);
}

/* Eigenvalues 0.2 and 8.2: plain Jacobi multiplies the error by 7.2 in each iteration. */
static void jacobi_is_damped(void) {
    call c;
    int s;
    complete(&c.m, 10, 0.8);
    call_begin(&c, 2);
    c.o.tolerance = 1e-4;
    for (s = 0; s < SOLVERS; s++) {
        check_solved(&c, solve_from_zero(&c, solvers[s]));
        if (s == 0) CHECK(c.report.restarts >= 1 && c.report.fallbacks == 0);
    }
    CHECK(c.report.iterations <= 2); /* CG: two eigenvalues */
    call_end(&c);
}

/* Positive diagonal, eigenvalues 3 and -1: refused in words, and x is not thrown away. */
static void indefinite(void) {
    call c;
    int s, i;
    complete(&c.m, 2, 2);
    call_begin(&c, 1);
    c.b[0] = 1;
    c.b[1] = (peri_real)-0.5;
    for (s = 0; s < SOLVERS; s++) {
        CHECK(solve_from_zero(&c, solvers[s]) == PERI_ERROR_PIVOT && c.err.code == PERI_ERROR_PIVOT);
        CHECK(strstr(c.err.text, "not symmetric positive definite") && c.report.result == PERI_ERROR_PIVOT);
        for (i = 0; i < 2; i++) CHECK(peri__finite((double)c.x[i]));
    }
    call_end(&c);
}

/* A tolerance beyond rounding ends, in words, with the residual that the x returned has. */
static void rounding(void) {
    call c;
    double noise, found;
    int s;
    lattice(&c.m, 8, 8, 8, 1, 0.01);
    call_begin(&c, 3);
    c.o.tolerance = 1e-25;
    c.o.max_iterations = 100000;
    for (s = 1; s < SOLVERS; s++) {
        CHECK(solve_from_zero(&c, solvers[s]) == PERI_ERROR_CONVERGENCE && strstr(c.err.text, "rounding"));
        found = residual_noise(&c.m, 3, c.b, c.x, &noise);
        NEAR(found, c.report.residual, noise);
        CHECK(c.report.residual < 2e4 * U); /* condition 3000 or so */
        CHECK(c.report.iterations < 5000);
    }
    call_end(&c);
}

static void cap(void) {
    call c;
    char words[40];
    int s, most;
    lattice(&c.m, 9, 8, 7, 1, 0.01);
    call_begin(&c, 2);
    c.o.tolerance = 1e-6;
    for (s = 0; s < SOLVERS; s++)
        for (most = 0; most < 40; most += 13) {
            c.o.max_iterations = most;
            CHECK(solve_from_zero(&c, solvers[s]) == PERI_ERROR_CONVERGENCE && c.report.iterations == most);
            NEAR(residual(&c.m, 2, c.b, c.x), c.report.residual, 1e-9);
            sprintf(words, "after %d iterations", most);
            CHECK(strstr(c.err.text, words) && strstr(c.err.text, "max_iterations"));
            if (s < 2) CHECK(c.report.residual <= 1.0000001);
        }
    call_end(&c);
}

/* ---- starts, edges, errors --------------------------------------------------------------------------------------- */

static void warm_starts(void) {
    call c;
    int s, cold;
    lattice(&c.m, 8, 8, 8, 1, 0.05);
    call_begin(&c, 3);
    c.o.max_iterations = 20000;
    for (s = 0; s < SOLVERS; s++) {
        check_solved(&c, solve_from_zero(&c, solvers[s]));
        cold = c.report.iterations;
        check_solved(&c, solve(&c, solvers[s]));
        CHECK(c.report.iterations == 0 && c.report.evaluations == 1);
        c.x[17] += (peri_real)(30 * c.o.tolerance);
        check_solved(&c, solve(&c, solvers[s]));
        CHECK(c.report.iterations > 0 && 2 * c.report.iterations < cold + 8);
    }
    call_end(&c);
}

static void edges(void) {
    static const peri_matrix none = {0, NULL, NULL, NULL, NULL};
    call c;
    peri_spectrum spectrum = {0, 0, 0, 0, 0};
    peri_incomplete *f = NULL;
    int s, i;
    for (s = 0; s < SOLVERS; s++) {
        c.o = peri_default_iteration();
        CHECK(solvers[s](&none, 3, NULL, NULL, NULL, &c.o, &c.report, &c.err) == PERI_OK && c.report.iterations == 0);
        chain(&c.m, 1);
        call_begin(&c, 3);
        c.o.tolerance = 4 * U;
        check_solved(&c, solve_from_zero(&c, solvers[s]));
        CHECK(c.report.iterations <= 1);
        for (i = 0; i < 3; i++) CHECK(c.x[i] == c.b[i] / 2);
        memset(c.b, 0, 3 * sizeof *c.b); /* b = 0, from a guess that is not: x = 0 */
        CHECK(solve(&c, solvers[s]) == PERI_OK && c.report.residual == 0);
        for (i = 0; i < 3; i++) CHECK(c.x[i] == 0);
        call_end(&c);
        lattice(&c.m, 4, 3, 2, 5, 0.3); /* five boxes apart, then rows of their own */
        call_begin(&c, 2);
        c.o.tolerance = SMALL_TOLERANCE;
        check_solved(&c, solve_from_zero(&c, solvers[s]));
        memset(c.m.row, 0, ((size_t)c.m.n + 1) * sizeof(int));
        check_solved(&c, solve_from_zero(&c, solvers[s]));
        CHECK(c.report.iterations <= 1);
        CHECK(solvers[s](&c.m.a, 2, c.b, c.x, c.work, &c.o, NULL, NULL) == PERI_OK); /* report and err may be NULL */
        call_end(&c);
    }
    CHECK(peri_spectrum_estimate(&spectrum, &none, 20, NULL, NULL, NULL) == PERI_OK && spectrum.products == 0);
    CHECK(peri_incomplete_create(&none, 3, NULL, &f, NULL) == PERI_OK);
    CHECK(peri_incomplete_factor(f, &none, NULL) == PERI_OK);
    peri_incomplete_apply(NULL, NULL, f);
    peri_incomplete_destroy(f);
    peri_incomplete_destroy(NULL);
    CHECK(peri_incomplete_shift(NULL) == 0 && peri_incomplete_bytes(NULL) == 0);
    CHECK(peri_solve_work(-1, 3) == 0 && peri_solve_work(3, -1) == 0 && peri_solve_work(7, 2) == 56);
}

static void refuse(call *c, peri_result result, const char *words) {
    int s;
    for (s = 0; s < SOLVERS; s++) {
        c->x[0] = 5;
        CHECK(solve(c, solvers[s]) == result && c->err.code == result && c->report.result == result);
        CHECK(c->x[0] == 5 && c->report.iterations == 0);
        if (strstr(c->err.text, words)) continue;
        test_complain(__FILE__, __LINE__, words);
        test_complain(__FILE__, __LINE__, c->err.text);
    }
}

#define SWAP(place, bad, result, words) \
    do { \
        memcpy(keep, &(place), sizeof(place)); \
        (place) = (bad); \
        refuse(&c, result, words); \
        memcpy(&(place), keep, sizeof(place)); \
    } while (0)

static void errors(void) {
    call c;
    char keep[64];
    peri_real nan = (peri_real)peri__from_bits(PERI__NAN), infinity = (peri_real)HUGE_VAL;
    peri_iteration odd;
    int s;
    lattice(&c.m, 4, 4, 4, 1, 1);
    call_begin(&c, 2);
    SWAP(c.o.cookie, 0, PERI_ERROR_ARGUMENT, "peri_default_iteration");
    SWAP(c.o.tolerance, -1e-3, PERI_ERROR_VALUE, "tolerance is -0.001");
    SWAP(c.o.tolerance, (double)nan, PERI_ERROR_VALUE, "tolerance");
    SWAP(c.o.max_iterations, -2, PERI_ERROR_VALUE, "max_iterations is -2");
    SWAP(c.rhs, 0, PERI_ERROR_ARGUMENT, "rhs is 0");
    SWAP(c.rhs, 4, PERI_ERROR_ARGUMENT, "rhs is 4");
    SWAP(c.work, NULL, PERI_ERROR_ARGUMENT, "work is NULL");
    SWAP(c.b, NULL, PERI_ERROR_ARGUMENT, "b is NULL");
    SWAP(c.m.a.n, -3, PERI_ERROR_INDEX, "n is -3");
    SWAP(c.m.a.row, NULL, PERI_ERROR_ARGUMENT, "row is NULL");
    SWAP(c.m.a.col, NULL, PERI_ERROR_ARGUMENT, "col is NULL");
    SWAP(c.m.a.value, NULL, PERI_ERROR_ARGUMENT, "no value");
    SWAP(c.m.a.diagonal, NULL, PERI_ERROR_ARGUMENT, "no diagonal");
    SWAP(c.m.row[0], 1, PERI_ERROR_INDEX, "row[0] is 1");
    SWAP(c.m.row[2], 0, PERI_ERROR_INDEX, "row 1 ends at 0");
    SWAP(c.m.col[3], 64, PERI_ERROR_INDEX, "row 0 stores column 64");
    SWAP(c.m.col[3], -1, PERI_ERROR_INDEX, "row 0 stores column -1");
    SWAP(c.m.col[0], 0, PERI_ERROR_INDEX, "row 0 stores its diagonal");
    SWAP(c.m.col[1], c.m.col[0], PERI_ERROR_INDEX, "ascend");
    SWAP(c.m.value[5], nan, PERI_ERROR_VALUE, "value[5]");
    SWAP(c.m.value[5], infinity, PERI_ERROR_VALUE, "value[5]");
    SWAP(c.m.diagonal[7], nan, PERI_ERROR_VALUE, "diagonal[7]");
    SWAP(c.m.diagonal[7], 0, PERI_ERROR_PIVOT, "diagonal[7] is 0");
    SWAP(c.m.diagonal[7], -2, PERI_ERROR_PIVOT, "diagonal[7] is -2");
    SWAP(c.b[9], nan, PERI_ERROR_VALUE, "b[9]");
    SWAP(c.b[9], infinity, PERI_ERROR_VALUE, "b[9]");
    SWAP(c.x[9], nan, PERI_ERROR_VALUE, "x[9]");
#ifdef PERI_DOUBLE
    SWAP(c.b[9], 1e200, PERI_ERROR_VALUE, "1e+200");
#endif
    for (s = 0; s < SOLVERS; s++) {
        CHECK(solvers[s](NULL, 2, c.b, c.x, c.work, &c.o, &c.report, &c.err) == PERI_ERROR_ARGUMENT);
        CHECK(solvers[s](&c.m.a, 2, c.b, NULL, c.work, &c.o, &c.report, &c.err) == PERI_ERROR_ARGUMENT);
        CHECK(solvers[s](&c.m.a, 2, c.b, c.x, c.work, NULL, &c.report, &c.err) == PERI_ERROR_ARGUMENT);
        CHECK(strstr(c.err.text, "options are NULL") != NULL);
    }
    odd = c.o;
    memset(&odd, 0, sizeof odd); /* zeroed options are no defaults */
    CHECK(peri_solve_cg(&c.m.a, 2, c.b, c.x, c.work, &odd, NULL, NULL) == PERI_ERROR_ARGUMENT);
    c.x[0] = 0;
    check_solved(&c, solve_from_zero(&c, peri_solve_cg)); /* nothing of this has stayed */
    call_end(&c);
}

static void spectrum_errors(void) {
    call c;
    peri_spectrum s = {0, 0, 0, 0, 0};
    chain(&c.m, 5);
    call_begin(&c, 1);
    CHECK(peri_spectrum_estimate(NULL, &c.m.a, 9, c.work, NULL, &c.err) == PERI_ERROR_ARGUMENT);
    CHECK(peri_spectrum_estimate(&s, NULL, 9, c.work, NULL, &c.err) == PERI_ERROR_ARGUMENT);
    CHECK(peri_spectrum_estimate(&s, &c.m.a, 9, NULL, NULL, &c.err) == PERI_ERROR_ARGUMENT);
    CHECK(peri_spectrum_estimate(&s, &c.m.a, 0, c.work, NULL, &c.err) == PERI_ERROR_VALUE);
    CHECK(peri_spectrum_estimate(&s, &c.m.a, 65, c.work, NULL, &c.err) == PERI_ERROR_VALUE && strstr(c.err.text, "65"));
    c.m.diagonal[3] = -1;
    CHECK(peri_spectrum_estimate(&s, &c.m.a, 9, c.work, NULL, &c.err) == PERI_ERROR_PIVOT);
    c.m.diagonal[3] = (peri_real)0.1;
    CHECK(peri_spectrum_estimate(&s, &c.m.a, 9, c.work, NULL, &c.err) == PERI_ERROR_PIVOT);
    call_end(&c);
}

/* ---- threads ----------------------------------------------------------------------------------------------------- */

static void run_backwards(int count, int grain, peri_task *task, void *context, void *user) {
    int begin = (count - 1) / (3 * grain) * 3 * grain;
    (void)user;
    for (; begin >= 0; begin -= 3 * grain) task(begin, begin + 3 * grain < count ? begin + 3 * grain : count, context);
}

/* Serial, OpenMP with 1, 2, 4 and any threads (serial where it is not compiled in), a hook. */
enum { WAYS = 6 };

static const peri_parallel *way(int k) {
    static peri_parallel par;
    static const int threads[WAYS] = {1, 1, 2, 4, 0, 1};
    par.run = k == WAYS - 1 ? run_backwards : NULL;
    par.threads = threads[k];
    return k == 0 ? NULL : &par;
}

static void same_bits_with_threads(void) {
    call c;
    peri_real *first;
    peri_report report = {PERI_OK, 0, 0, 0, 0, 0, 0};
    int s, k;
    lattice(&c.m, 30, 20, 31, 1, 0.05); /* some blocks of rows are cut, the last one is short */
    call_begin(&c, 3);
    first = (peri_real *)grab((size_t)c.n, sizeof *first);
    c.o.max_iterations = 70;
    c.o.tolerance = 1e-12;
    for (s = 0; s < SOLVERS; s++)
        for (k = 0; k < WAYS; k++) {
            c.o.parallel = way(k);
            CHECK(solve_from_zero(&c, solvers[s]) == PERI_ERROR_CONVERGENCE);
            if (k == 0) {
                memcpy(first, c.x, (size_t)c.n * sizeof *first);
                report = c.report;
            }
            CHECK(memcmp(first, c.x, (size_t)c.n * sizeof *first) == 0);
            CHECK(report.residual == c.report.residual && report.restarts == c.report.restarts);
        }
    free(first);
    call_end(&c);
}

/* ---- preconditioners --------------------------------------------------------------------------------------------- */

/* (L L')(i, j) = A(i, j) wherever A has an entry, the diagonal with the shift: what makes it the incomplete factor. */
static void check_incomplete(const peri_incomplete *f, const sparse *m) {
    double *l = (double *)grab((size_t)m->n * (size_t)m->n, sizeof *l), sum;
    int i, j, k, e;
    for (i = 0; i < m->n; i++) {
        for (e = f->row[i]; e < f->row[i + 1]; e++) l[i * m->n + f->col[e]] = (double)f->value[e];
        l[i * m->n + i] = 1 / (double)f->inverse[i];
    }
    for (i = 0; i < m->n; i++)
        for (k = m->row[i] - 1; k < m->row[i + 1]; k++) {
            double wanted = k < m->row[i] ? (double)m->diagonal[i] * (1 + f->shift) : (double)m->value[k];
            int q;
            j = k < m->row[i] ? i : m->col[k];
            for (sum = 0, q = 0; q < m->n; q++) sum += l[i * m->n + q] * l[j * m->n + q];
            NEAR(sum, wanted, 20 * U * (double)m->diagonal[i]); /* a row's products sum up to at most its diagonal */
        }
    free(l);
}

static void incomplete_factor(void) {
    call c;
    int rhs, which, i, k;
    for (which = 0; which < 3; which++)
        for (rhs = 1; rhs <= 3; rhs++) {
            peri_incomplete *f = NULL;
            double forth = 0, back = 0, size;
            if (which == 0) chain(&c.m, 40);
            if (which == 1) lattice(&c.m, 7, 6, 5, 1, 0.2);
            if (which == 2) kershaw(&c.m);
            call_begin(&c, rhs);
            CHECK(peri_incomplete_create(&c.m.a, rhs, NULL, &f, &c.err) == PERI_OK && f && c.err.code == PERI_OK);
            for (k = 0; k < 2; k++) {
                CHECK(peri_incomplete_factor(f, &c.m.a, &c.err) == PERI_OK);
                CHECK((peri_incomplete_shift(f) > 0) == (which == 2) && peri_incomplete_shift(f) < 2);
                check_incomplete(f, &c.m);
            }
            peri_incomplete_apply(c.b, c.x, f);
            if (which == 0) NEAR(residual(&c.m, rhs, c.b, c.x), 0, 40 * 700 * U); /* no fill: exact; condition 680 */
            for (i = 0; i < c.n; i++) c.extra[i] = (peri_real)spread();
            peri_incomplete_apply(c.extra, c.work, f);
            for (size = 0, i = 0; i < c.n; i++) { /* symmetric */
                forth += (double)c.extra[i] * (double)c.x[i];
                back += (double)c.work[i] * (double)c.b[i];
                size += fabs((double)c.extra[i] * (double)c.x[i]);
            }
            NEAR(forth, back, 200 * U * size);
            c.o.precondition = peri_incomplete_apply;
            c.o.context = f;
            check_solved(&c, solve_from_zero(&c, peri_solve_cg));
            if (which == 0) CHECK(c.report.iterations <= 1 + (sizeof(peri_real) == 4));
            peri_incomplete_destroy(f);
            call_end(&c);
        }
}

/* A third of the iterations of Jacobi, as on the lattices measured (condition 1000: 46 and 15). */
static void incomplete_saves(void) {
    call c;
    peri_incomplete *f = NULL;
    int jacobi, before;
    lattice(&c.m, 18, 18, 18, 1, 0.02);
    call_begin(&c, 3);
    check_solved(&c, solve_from_zero(&c, peri_solve_cg));
    jacobi = c.report.iterations;
    CHECK(peri_incomplete_create(&c.m.a, 3, NULL, &f, NULL) == PERI_OK);
    CHECK(peri_incomplete_factor(f, &c.m.a, NULL) == PERI_OK);
    c.o.precondition = peri_incomplete_apply;
    c.o.context = f;
    before = allocations;
    check_solved(&c, solve_from_zero(&c, peri_solve_cg));
    CHECK(allocations == before);
    CHECK(2.5 * c.report.iterations < jacobi && jacobi > 20);
    c.o.flexible = 1; /* of a fixed preconditioner flexible CG is CG */
    before = c.report.iterations;
    check_solved(&c, solve_from_zero(&c, peri_solve_cg));
    CHECK(abs(c.report.iterations - before) <= 1);
    peri_incomplete_destroy(f);
    call_end(&c);
}

static void incomplete_errors(void) {
    call c;
    peri_incomplete *f = NULL;
    peri_real nan = (peri_real)peri__from_bits(PERI__NAN);
    lattice(&c.m, 4, 4, 4, 1, 1);
    call_begin(&c, 1);
    CHECK(peri_incomplete_create(&c.m.a, 1, NULL, NULL, &c.err) == PERI_ERROR_ARGUMENT && strstr(c.err.text, "out"));
    CHECK(peri_incomplete_create(NULL, 1, NULL, &f, &c.err) == PERI_ERROR_ARGUMENT && !f);
    CHECK(peri_incomplete_create(&c.m.a, 4, NULL, &f, &c.err) == PERI_ERROR_ARGUMENT && strstr(c.err.text, "rhs is 4"));
    c.m.col[2] = 99;
    CHECK(peri_incomplete_create(&c.m.a, 1, NULL, &f, &c.err) == PERI_ERROR_INDEX && !f);
    c.m.col[2] = 5;
    sparse_end(&c.m);
    lattice(&c.m, 4, 4, 4, 1, 1);
    CHECK(peri_incomplete_create(&c.m.a, 1, NULL, &f, &c.err) == PERI_OK);
    CHECK(peri_incomplete_factor(NULL, &c.m.a, &c.err) == PERI_ERROR_ARGUMENT);
    CHECK(peri_incomplete_factor(f, NULL, &c.err) == PERI_ERROR_ARGUMENT);
    c.m.a.n = 63;
    CHECK(peri_incomplete_factor(f, &c.m.a, &c.err) == PERI_ERROR_INDEX || c.err.code == PERI_ERROR_ARGUMENT);
    c.m.a.n = 64;
    c.m.value[3] = nan;
    CHECK(peri_incomplete_factor(f, &c.m.a, &c.err) == PERI_ERROR_VALUE && strstr(c.err.text, "value[3]"));
    c.m.value[3] = -1;
    c.m.diagonal[9] = -1;
    CHECK(peri_incomplete_factor(f, &c.m.a, &c.err) == PERI_ERROR_PIVOT && strstr(c.err.text, "diagonal[9]"));
    c.m.diagonal[9] = 30;
    CHECK(peri_incomplete_factor(f, &c.m.a, &c.err) == PERI_OK);
    sparse_end(&c.m);
    lattice(&c.m, 8, 4, 2, 1, 1); /* as many rows, another pattern */
    CHECK(peri_incomplete_factor(f, &c.m.a, &c.err) == PERI_ERROR_ARGUMENT && strstr(c.err.text, "another pattern"));
    peri_incomplete_destroy(f);
    sparse_end(&c.m);
    chain(&c.m, 3);
    CHECK(peri_incomplete_create(&c.m.a, 1, NULL, &f, NULL) == PERI_OK);
    c.m.col[3] = 0; /* row 2 stored column 1: as many entries below the diagonal */
    CHECK(peri_incomplete_factor(f, &c.m.a, &c.err) == PERI_ERROR_ARGUMENT && strstr(c.err.text, "another pattern"));
    peri_incomplete_destroy(f);
    call_end(&c);
}

typedef struct counter {
    int calls, fail;
    size_t live;
} counter;

static void *count_resize(void *ptr, size_t old_bytes, size_t new_bytes, void *user) {
    counter *c = (counter *)user;
    if (new_bytes && c->calls++ == c->fail) return NULL;
    c->live = c->live - old_bytes + new_bytes;
    if (new_bytes) return realloc(ptr, new_bytes);
    free(ptr);
    return NULL;
}

static void incomplete_memory(void) {
    sparse m;
    counter c = {0, 0, 0};
    peri_allocator hook;
    peri_incomplete *f = NULL;
    peri_error err;
    hook.resize = count_resize;
    hook.user = &c;
    lattice(&m, 5, 4, 3, 1, 1);
    CHECK(peri_incomplete_create(&m.a, 3, &hook, &f, &err) == PERI_ERROR_MEMORY && !f && c.live == 0);
    CHECK(peri_incomplete_create(&m.a, 3, &hook, &f, &err) == PERI_OK && c.calls == 2);
    CHECK(c.live == peri_incomplete_bytes(f) && c.live > 0);
    CHECK(peri_incomplete_factor(f, &m.a, &err) == PERI_OK && c.calls == 2);
    peri_incomplete_destroy(f);
    CHECK(c.live == 0);
    sparse_end(&m);
}

/* For 3 right-hand sides the very operator that the world uses; for one the same columns, in the same order. */
static void polynomial(void) {
    call c;
    peri_polynomial q;
    peri_real *three, *one, *column;
    int i, k, jacobi;
    lattice(&c.m, 9, 9, 9, 1, 0.05);
    call_begin(&c, 3);
    three = (peri_real *)grab(6 * (size_t)c.n, sizeof *three);
    one = three + c.n;
    column = one + c.n;
    q.a = &c.m.a;
    q.rhs = 3;
    q.sweeps = 6;
    q.low = 0.05;
    q.high = 2;
    q.parallel = NULL;
    q.work = c.extra;
    peri_chebyshev3(&c.m.a, NULL, 6, 0.05, 2, c.b, three, c.work);
    peri_polynomial_apply(c.b, one, &q);
    CHECK(memcmp(three, one, (size_t)c.n * sizeof *one) == 0);
    q.rhs = 1;
    for (k = 0; k < 3; k++) {
        for (i = 0; i < c.m.n; i++) column[i] = c.b[3 * i + k];
        peri_polynomial_apply(column, one, &q);
        for (i = 0; i < c.m.n; i++) CHECK(one[i] == three[3 * i + k]);
    }
    check_solved(&c, solve_from_zero(&c, peri_solve_cg));
    jacobi = c.report.iterations;
    q.rhs = 3;
    c.o.precondition = peri_polynomial_apply;
    c.o.context = &q;
    check_solved(&c, solve_from_zero(&c, peri_solve_cg));
    CHECK(2 * c.report.iterations < jacobi);
    free(three);
    call_end(&c);
}

/* Each broken bond changes A by rank one, so the old factor leaves all eigenvalues at 1 but that many. */
static void old_factor(void) {
    static const int broken[6] = {5, 900, 901, 2044, 3000, 3701};
    call c;
    peri_cholesky *f = NULL;
    peri_factor_use use;
    int k, e, i, j, jacobi;
    lattice(&c.m, 8, 8, 8, 1, 0.01);
    call_begin(&c, 3);
    CHECK(peri_cholesky_create(&c.m.a, NULL, NULL, &f, NULL) == PERI_OK);
    CHECK(peri_cholesky_factor(f, &c.m.a, NULL) == PERI_OK);
    for (k = 0; k < 6; k++) {
        for (e = broken[k], i = 0; c.m.row[i + 1] <= e; i++) {}
        j = c.m.col[e];
        c.m.diagonal[i] += c.m.value[e];
        c.m.diagonal[j] += c.m.value[e];
        c.m.value[e] = 0;
        for (e = c.m.row[j]; c.m.col[e] != i; e++) {}
        c.m.value[e] = 0;
    }
    check_solved(&c, solve_from_zero(&c, peri_solve_cg));
    jacobi = c.report.iterations;
    use.factor = f;
    use.n = c.m.n;
    use.rhs = 3;
    use.work = c.extra;
    c.o.precondition = peri_factor_apply;
    c.o.context = &use;
    check_solved(&c, solve_from_zero(&c, peri_solve_cg));
    CHECK(c.report.iterations <= 7 && jacobi > 20);
    peri_cholesky_destroy(f);
    call_end(&c);
}

static void negative(const peri_real *g, peri_real *p, void *context) {
    int i, n = *(int *)context;
    for (i = 0; i < n; i++) p[i] = -g[i];
}

static void bad_preconditioner(void) {
    call c;
    chain(&c.m, 9);
    call_begin(&c, 1);
    c.o.precondition = negative;
    c.o.context = &c.n;
    CHECK(solve_from_zero(&c, peri_solve_cg) == PERI_ERROR_PIVOT && strstr(c.err.text, "preconditioner is not"));
    call_end(&c);
}

/* ---- L-BFGS ------------------------------------------------------------------------------------------------------ */

/* The recursion written down plainly: one product or one combination a pass. The fused one gives the same numbers. */
static void lbfgs_plain(const peri_lbfgs *l, const peri_real *g, peri_real *p, peri_real *w) {
    double alpha[PERI_LBFGS_MAX], beta;
    int i, j, k, n = l->n;
    memcpy(w, g, (size_t)n * sizeof *w);
    for (i = 1; i <= l->used; i++) {
        k = (l->head - i + l->m) % l->m;
        alpha[k] = l->rho[k] * peri_dot(NULL, n, l->s + k * n, w);
        for (j = 0; j < n; j++) w[j] = (peri_real)((double)w[j] - alpha[k] * (double)l->y[k * n + j]);
    }
    memcpy(p, w, (size_t)n * sizeof *w);
    for (i = l->used; i >= 1; i--) {
        k = (l->head - i + l->m) % l->m;
        beta = l->rho[k] * peri_dot(NULL, n, l->y + k * n, p);
        for (j = 0; j < n; j++) p[j] = (peri_real)((double)p[j] + (alpha[k] - beta) * (double)l->s[k * n + j]);
    }
    for (j = 0; j < n; j++) p[j] = -p[j];
}

static void lbfgs_fused(void) {
    static const int sizes[5] = {1, 15, 4097, 20000, 300001};
    int s, m, i, k, w;
    for (s = 0; s < 5; s++)
        for (m = 0; m < 9; m += 2) {
            int n = sizes[s];
            peri_real *v = (peri_real *)grab((2 * (size_t)m + 5) * (size_t)n, sizeof *v), *g = v + 2 * m * n;
            peri_real *p = g + n, *q = p + n, *work = q + n, *y = work + n;
            peri_lbfgs l;
            peri_lbfgs_begin(&l, n, m, v);
            for (k = 0; k < m + 1; k++) {
                for (i = 0; i < n; i++) {
                    g[i] = (peri_real)spread();
                    y[i] = g[i] * (peri_real)(1 + 0.1 * (i % 7));
                }
                peri_lbfgs_push(&l, way(k % WAYS), g, y);
            }
            CHECK(l.used == m);
            lbfgs_plain(&l, y, q, work);
            for (w = 0; w < WAYS; w++) {
                peri_lbfgs_apply(&l, way(w), y, p, work, NULL, NULL);
                for (i = 0; i < n; i++)
                    if (!(p[i] == q[i])) break;
                CHECK(i == n);
            }
            free(v);
        }
}

/* ---- line search ------------------------------------------------------------------------------------------------- */

/* f(t) and its slope along the line, defined below `wall`. */
typedef struct valley {
    int kind, calls;
    double wall;
} valley;

static int valley_trial(double t, double *slope, double *energy, void *context) {
    valley *v = (valley *)context;
    double e = 0;
    v->calls++;
    if (t >= v->wall) {
        if (v->kind != 5) return 0;
        *slope = peri__from_bits(PERI__NAN); /* said to be defined, and is not */
        return 1;
    }
    switch (v->kind) {
    case 0: case 5: *slope = t - 1, e = t * t / 2 - t; break;           /* the model's own */
    case 1: *slope = 100 * t - 1, e = 50 * t * t - t; break;            /* a hundred times as stiff: best at 0.01 */
    case 2: *slope = -1 + 1 / (1 - t), e = -t - log(1 - t); break;      /* a barrier at 1 */
    case 3: *slope = -1 + t * t * t * 1000, e = -t + 250 * t * t * t * t; break;
    case 4: *slope = t < 0.5 ? -1 + 8 * t : -1 - 2 * (t - 0.5), e = t < 0.5 ? -t + 4 * t * t : 0.5 - t; break;
    default: *slope = 1; break;
    }
    if (energy) *energy = e;
    return 1;
}

static double search(valley *v, peri_search *o, peri_report *report, peri_error *err) {
    peri_line line;
    double share = -1;
    line.trial = valley_trial;
    line.context = v;
    line.slope = -1;
    line.energy = 0;
    v->calls = 0;
    peri_line_search(&line, &share, o, report, err);
    CHECK(report->iterations == v->calls && report->evaluations == v->calls);
    return share;
}

static void line_search(void) {
    peri_search o = peri_default_search();
    peri_report report;
    peri_error err;
    valley v = {0, 0, HUGE_VAL};
    double share;
    CHECK(search(&v, &o, &report, &err) == 1 && v.calls == 1 && report.residual == 0 && err.code == PERI_OK);
    v.wall = 0.2; /* inverted beyond: quarters until it is defined */
    CHECK(search(&v, &o, &report, &err) == 0.0625 && v.calls == 3);
    v.kind = 5;
    CHECK(search(&v, &o, &report, &err) == 0.0625 && v.calls == 3);
    v.kind = 1;
    v.wall = HUGE_VAL; /* secants of a parabola: exact but for the limit of a tenth */
    share = search(&v, &o, &report, &err);
    NEAR(share, 0.01, 1e-15);
    CHECK(v.calls == 3 && report.residual < 1e-12);
    v.kind = 2;
    v.wall = 1;
    o.first = 8;
    share = search(&v, &o, &report, &err);
    CHECK(share == 0.5 * 1 || (share > 0 && share < 1));
    CHECK(fabs(-1 + 1 / (1 - share)) <= 0.9 + 1e-12 && v.calls <= 4);
    o.first = 1;
    v.kind = 3;
    v.wall = HUGE_VAL;
    share = search(&v, &o, &report, &err); /* at most 0.9 of the slope: 1000 t^3 <= 1.9 */
    CHECK(share > 0.01 && 1000 * share * share * share <= 1.9 + 1e-9);
    v.kind = 4; /* beyond 0.5 it goes steeply down, after a hill that ends higher */
    o.first = 0.6;
    CHECK(search(&v, &o, &report, &err) == 0.6 && v.calls == 1);
    v.wall = 0.55;
    o.first = 0.25;
    o.accept = 0.5; /* slope 1 there: the secant's 0.5 of 0.25 */
    NEAR(search(&v, &o, &report, &err), 0.125, 1e-15);
}

static int hill_trial(double t, double *slope, double *energy, void *context) {
    (void)context;
    *slope = t > 0.4 ? -0.1 : -1 + 4 * t;
    if (energy) *energy = t > 0.4 ? 1 : -t + 2 * t * t;
    return 1;
}

static void line_search_energy(void) {
    peri_search o = peri_default_search();
    peri_line line = {hill_trial, NULL, -1, 0};
    peri_report report;
    double share;
    CHECK(peri_line_search(&line, &share, &o, &report, NULL) == PERI_OK && share == 1);
    o.energetic = 1;
    CHECK(peri_line_search(&line, &share, &o, &report, NULL) == PERI_OK && share == 0.25);
    o.noise = 2;
    CHECK(peri_line_search(&line, &share, &o, &report, NULL) == PERI_OK && share == 1);
}

static void line_search_errors(void) {
    peri_search o = peri_default_search(), bad;
    valley v = {6, 0, HUGE_VAL}; /* goes up wherever one looks */
    peri_line line = {valley_trial, NULL, -1, 0};
    peri_report report;
    peri_error err;
    double share = 3;
    line.context = &v;
    CHECK(peri_line_search(&line, &share, &o, &report, &err) == PERI_ERROR_CONVERGENCE && share == 0);
    CHECK(v.calls == 14 && report.iterations == 14 && report.result == PERI_ERROR_CONVERGENCE);
    o.max_trials = 1;
    CHECK(peri_line_search(&line, &share, &o, NULL, NULL) == PERI_ERROR_CONVERGENCE && v.calls == 15);
    CHECK(peri_line_search(NULL, &share, &o, &report, &err) == PERI_ERROR_ARGUMENT);
    CHECK(peri_line_search(&line, NULL, &o, &report, &err) == PERI_ERROR_ARGUMENT);
    CHECK(peri_line_search(&line, &share, NULL, &report, &err) == PERI_ERROR_ARGUMENT);
    line.trial = NULL;
    CHECK(peri_line_search(&line, &share, &o, &report, &err) == PERI_ERROR_ARGUMENT && strstr(err.text, "trial"));
    line.trial = valley_trial;
    line.slope = 0;
    CHECK(peri_line_search(&line, &share, &o, &report, &err) == PERI_ERROR_VALUE && strstr(err.text, "slope 0"));
    line.slope = peri__from_bits(PERI__NAN);
    CHECK(peri_line_search(&line, &share, &o, &report, &err) == PERI_ERROR_VALUE);
    line.slope = -1;
    bad = o;
    bad.cookie = 0;
    CHECK(peri_line_search(&line, &share, &bad, &report, &err) == PERI_ERROR_ARGUMENT);
    bad = o;
    bad.first = 0;
    CHECK(peri_line_search(&line, &share, &bad, &report, &err) == PERI_ERROR_VALUE);
    bad = o;
    bad.accept = 2.5;
    CHECK(peri_line_search(&line, &share, &bad, &report, &err) == PERI_ERROR_VALUE);
    bad = o;
    bad.max_trials = 0;
    CHECK(peri_line_search(&line, &share, &bad, &report, &err) == PERI_ERROR_VALUE && v.calls == 15);
}

/* ---- minimisation ------------------------------------------------------------------------------------------------ */

static peri_objective objective(int n, peri_gradient *gradient, void *context) {
    peri_objective f;
    f.n = n;
    f.gradient = gradient;
    f.context = context;
    f.memory = 5;
    f.search = peri_default_search();
    return f;
}

/* x.A x / 2 - b.x of a call's system */
static int quadratic(const peri_real *x, peri_real *g, double *energy, void *context) {
    call *c = (call *)context;
    int i;
    peri_matrix_multiply3(&c->m.a, NULL, x, g);
    if (energy) *energy = 0.5 * peri_dot(NULL, c->n, x, g) - peri_dot(NULL, c->n, x, c->b);
    for (i = 0; i < c->n; i++) g[i] -= c->b[i];
    return 1;
}

static void jacobi_of_call(const peri_real *g, peri_real *p, void *context) {
    const call *c = (const call *)context;
    peri_jacobi3(&c->m.a, NULL, g, p);
}

/* Stops on the correction: with P near A that is nearly the error, here within the condition number. */
static void minimise_quadratic(void) {
    call c;
    peri_objective f;
    peri_real *work, *first;
    int memory, plain = 0, k, energetic;
    lattice(&c.m, 9, 8, 7, 1, 1);
    call_begin(&c, 3);
    work = (peri_real *)grab(peri_minimise_work(c.n, 8) + (size_t)c.n, sizeof *work);
    first = work + peri_minimise_work(c.n, 8);
    CHECK(peri_minimise_work(c.n, 5) == 15 * (size_t)c.n && peri_minimise_work(-1, 5) == 0);
    CHECK(peri_minimise_work(1, 9) == 0 && peri_minimise_work(1, -1) == 0);
    f = objective(c.n, quadratic, &c);
    c.o.tolerance = sizeof(peri_real) > 4 ? 1e-9 : 1e-5;
    c.o.precondition = jacobi_of_call;
    c.o.context = &c;
    for (energetic = 0; energetic < (sizeof(peri_real) > 4 ? 2 : 1); energetic++)
        for (memory = 0; memory <= 8; memory += 4) {
            int before = allocations;
            f.memory = memory;
            f.search.energetic = energetic;
            f.search.noise = 1e-12;
            memset(c.x, 0, (size_t)c.n * sizeof *c.x);
            CHECK(peri_minimise(&f, c.x, work, &c.o, &c.report, &c.err) == PERI_OK && c.err.code == PERI_OK);
            CHECK(c.report.correction <= c.o.tolerance && c.report.evaluations > c.report.iterations);
            CHECK(allocations == before);
            NEAR(residual(&c.m, 3, c.b, c.x), c.report.residual, 1e-3 * c.report.residual + 20 * U);
            CHECK(c.report.residual < 100 * c.o.tolerance); /* D is below 20, |b| above 20 */
            if (memory == 0) plain = c.report.iterations;
            else CHECK(c.report.iterations < plain);
        }
    memcpy(first, c.x, (size_t)c.n * sizeof *first);
    for (k = 0; k < WAYS; k++) {
        c.o.parallel = way(k);
        memset(c.x, 0, (size_t)c.n * sizeof *c.x);
        CHECK(peri_minimise(&f, c.x, work, &c.o, &c.report, &c.err) == PERI_OK);
        CHECK(memcmp(first, c.x, (size_t)c.n * sizeof *first) == 0);
    }
    free(work);
    call_end(&c);
}

/* 100 (y - x^2)^2 + (1 - x)^2 */
static int rosenbrock(const peri_real *x, peri_real *g, double *energy, void *context) {
    double a = (double)x[0], b = (double)x[1] - a * a;
    (void)context;
    g[0] = (peri_real)(-400 * a * b - 2 * (1 - a));
    g[1] = (peri_real)(200 * b);
    if (energy) *energy = 100 * b * b + (1 - a) * (1 - a);
    return 1;
}

/* sum of k x - log x: defined for x > 0, least at 1 / k */
static int barrier(const peri_real *x, peri_real *g, double *energy, void *context) {
    int i, n = *(int *)context;
    double sum = 0;
    for (i = 0; i < n; i++) {
        if (!((double)x[i] > 0)) {
            if (i % 2) return 0;
            g[i] = (peri_real)peri__from_bits(PERI__NAN); /* or says so only by its value */
            continue;
        }
        g[i] = (peri_real)(i + 1 - 1 / (double)x[i]);
        sum += (i + 1) * (double)x[i] - log((double)x[i]);
    }
    if (energy) *energy = sum;
    return 1;
}

static void minimise_wild(void) {
    peri_real x[4], work[2 * 8 * 4 + 20];
    peri_iteration o = peri_default_iteration();
    peri_objective f = objective(2, rosenbrock, NULL);
    peri_report report;
    peri_error err;
    static const double start[4][2] = {{-1.2, 1}, {20, -30}, {0, 0}, {-300, 4000}};
    int k, i, n = 4;
    o.tolerance = sizeof(peri_real) > 4 ? 1e-9 : 1e-5;
    for (k = 0; k < 4; k++) {
        x[0] = (peri_real)start[k][0];
        x[1] = (peri_real)start[k][1];
        f.search.energetic = 1;
        f.search.max_trials = 40;
        CHECK(peri_minimise(&f, x, work, &o, &report, &err) == PERI_OK);
        /* curvature 0.4 along the valley: a gradient of 1e-5 leaves 2.5e-5, and floats round it by 400 u */
        NEAR(x[0], 1, 10 * o.tolerance + 2000 * U);
        NEAR(x[1], 1, 20 * o.tolerance + 4000 * U);
    }
    f = objective(n, barrier, &n);
    f.search.max_trials = 40;
    for (k = 0; k < 4; k++) {
        for (i = 0; i < n; i++) x[i] = (peri_real)(k == 0 ? 1 : k == 1 ? 1e-3 : k == 2 ? 50 : 1e-2 * (i + 1));
        CHECK(peri_minimise(&f, x, work, &o, &report, &err) == PERI_OK && report.iterations > 0);
        for (i = 0; i < n; i++) NEAR(x[i], 1.0 / (i + 1), 20 * o.tolerance);
    }
}

/* Says that the gradient is far larger than it is: no share of the step does. */
static int stubborn(const peri_real *x, peri_real *g, double *energy, void *context) {
    int *calls = (int *)context;
    (void)x;
    (void)energy;
    g[0] = (*calls)++ == 0 ? (peri_real)1 : (peri_real)-1;
    return 1;
}

static void minimise_errors(void) {
    peri_real x[3] = {1, 1, 1}, work[60];
    peri_iteration o = peri_default_iteration(), odd = o;
    peri_report report;
    peri_error err;
    int n = 3, calls = 0;
    peri_objective f = objective(3, barrier, &n), bad;
    CHECK(peri_minimise(NULL, x, work, &o, &report, &err) == PERI_ERROR_ARGUMENT);
    CHECK(peri_minimise(&f, NULL, work, &o, &report, &err) == PERI_ERROR_ARGUMENT && strstr(err.text, "x is NULL"));
    CHECK(peri_minimise(&f, x, NULL, &o, &report, &err) == PERI_ERROR_ARGUMENT && strstr(err.text, "work is NULL"));
    CHECK(peri_minimise(&f, x, work, NULL, &report, &err) == PERI_ERROR_ARGUMENT);
    odd.cookie = 7;
    CHECK(peri_minimise(&f, x, work, &odd, &report, &err) == PERI_ERROR_ARGUMENT);
    bad = f;
    bad.memory = 9;
    CHECK(peri_minimise(&bad, x, work, &o, &report, &err) == PERI_ERROR_ARGUMENT && strstr(err.text, "here 9"));
    bad = f;
    bad.gradient = NULL;
    CHECK(peri_minimise(&bad, x, work, &o, &report, &err) == PERI_ERROR_ARGUMENT);
    bad = f;
    memset(&bad.search, 0, sizeof bad.search);
    CHECK(peri_minimise(&bad, x, work, &o, &report, &err) == PERI_ERROR_ARGUMENT);
    CHECK(strstr(err.text, "peri_default_search") != NULL);
    bad = f;
    bad.n = 0;
    CHECK(peri_minimise(&bad, NULL, NULL, &o, &report, &err) == PERI_OK && report.iterations == 0);
    x[1] = -1;
    CHECK(peri_minimise(&f, x, work, &o, &report, &err) == PERI_ERROR_VALUE && strstr(err.text, "not defined"));
    x[1] = 1;
    x[0] = -1; /* "defined", and not finite */
    CHECK(peri_minimise(&f, x, work, &o, &report, &err) == PERI_ERROR_VALUE && strstr(err.text, "not finite"));
    x[2] = (peri_real)peri__from_bits(PERI__NAN);
    CHECK(peri_minimise(&f, x, work, &o, &report, &err) == PERI_ERROR_VALUE);
    x[0] = x[1] = x[2] = 1;
    o.max_iterations = 2;
    o.tolerance = 1e-7;
    CHECK(peri_minimise(&f, x, work, &o, &report, &err) == PERI_ERROR_CONVERGENCE && report.iterations == 2);
    CHECK(report.residual > 0 && report.residual < 1 && x[1] < 1 && strstr(err.text, "after 2 iterations"));
    o.max_iterations = 100;
    o.precondition = negative;
    o.context = &n;
    CHECK(peri_minimise(&f, x, work, &o, &report, &err) == PERI_ERROR_PIVOT);
    o.precondition = NULL;
    f = objective(1, stubborn, &calls);
    x[0] = 9;
    CHECK(peri_minimise(&f, x, work, &o, &report, &err) == PERI_ERROR_CONVERGENCE && x[0] == 9);
    CHECK(strstr(err.text, "no share") && calls == 15);
}

/* ---- Anderson ---------------------------------------------------------------------------------------------------- */

enum { FEW = 7 };

/* G(x) = M x + c, M symmetric, its eigenvalues below 1 in size */
static void linear_map(const double m[FEW][FEW], const double c[FEW], const peri_real *x, peri_real *gx) {
    int i, j;
    for (i = 0; i < FEW; i++) {
        double sum = c[i];
        for (j = 0; j < FEW; j++) sum += m[i][j] * (double)x[j];
        gx[i] = (peri_real)sum;
    }
}

/* r less its projection onto the span of (I - M) r0, (I - M)^2 r0, ..., k of them: the residual of GMRES after k. */
static void gmres(const double m[FEW][FEW], const double r0[FEW], int k, double r[FEW]) {
    double q[FEW][FEW], v[FEW];
    int i, j, s;
    memcpy(r, r0, sizeof(double) * FEW);
    memcpy(v, r0, sizeof v);
    for (s = 0; s < k; s++) {
        double w[FEW], length = 0, dot;
        int pass, t;
        for (i = 0; i < FEW; i++)
            for (w[i] = v[i], j = 0; j < FEW; j++) w[i] -= m[i][j] * v[j];
        for (pass = 0; pass < 2; pass++)
            for (t = 0; t < s; t++) {
                for (dot = 0, i = 0; i < FEW; i++) dot += w[i] * q[t][i];
                for (i = 0; i < FEW; i++) w[i] -= dot * q[t][i];
            }
        for (i = 0; i < FEW; i++) length += w[i] * w[i];
        for (i = 0; i < FEW; i++) q[s][i] = v[i] = w[i] / sqrt(length);
        for (dot = 0, i = 0; i < FEW; i++) dot += r[i] * q[s][i];
        for (i = 0; i < FEW; i++) r[i] -= dot * q[s][i];
    }
}

/* Walker & Ni, theorem 2.2: the k-th iterate is G of GMRES's k-1st, so G(x) - x there is M r. All 7 eigenvalues differ
   and the 8th iterate is the solution. Normal equations square a condition that grows with each step: in double a
   hundred thousandth is left at the sixth, floats follow for three steps. */
static void anderson_is_gmres(void) {
    double m[FEW][FEW], c[FEW], r0[FEW], r[FEW], size = 0;
    peri_real x[FEW], gx[FEW], vectors[2 * 8 * FEW];
    peri_anderson q;
    int i, j, k, trust = sizeof(peri_real) > 4 ? 5 : 3;
    for (i = 0; i < FEW; i++)
        for (j = 0; j < FEW; j++) m[i][j] = 0;
    for (i = 0; i < FEW; i++) { /* a reflection of diag(0.9, 0.6, ..., -0.9) */
        for (j = 0; j < FEW; j++)
            for (k = 0; k < FEW; k++)
                m[i][j] += ((i == k) - 2.0 / FEW) * (0.9 - 0.3 * k) * ((j == k) - 2.0 / FEW);
        c[i] = spread();
        x[i] = 0;
        size += c[i] * c[i];
    }
    size = sqrt(size);
    memcpy(r0, c, sizeof r0);
    peri_anderson_begin(&q, FEW, FEW, vectors);
    for (k = 0; k < FEW + 2; k++) {
        linear_map((const double(*)[FEW])m, c, x, gx);
        if (k > 0 && k <= trust) {
            gmres((const double(*)[FEW])m, r0, k - 1, r);
            for (i = 0; i < FEW; i++) {
                double wanted = 0;
                for (j = 0; j < FEW; j++) wanted += m[i][j] * r[j];
                NEAR((double)gx[i] - (double)x[i], wanted, size * (sizeof(peri_real) > 4 ? 1e-8 : 1e-4));
            }
        }
        CHECK(peri_anderson_push(&q, NULL, x, gx) == 1);
        peri_anderson_apply(&q, NULL, x);
    }
    linear_map((const double(*)[FEW])m, c, x, gx);
    for (i = 0; i < FEW; i++) NEAR((double)gx[i] - (double)x[i], 0, size * (sizeof(peri_real) > 4 ? 1e-8 : 2e-4));
    CHECK(q.resets == 0 && q.used == FEW);
}

/* Jacobi on a lattice as the fixed-point iteration: with m = 5 at least three times fewer, as measured on local/global;
   m = 0 is the plain iteration to the bit. */
static int sweeps(call *c, int memory, const peri_parallel *par) {
    peri_real *v = (peri_real *)grab(2 * ((size_t)memory + 2) * (size_t)c->n, sizeof *v);
    peri_real *gx = v + 2 * (memory + 1) * c->n, *r = gx + c->n;
    peri_anderson q;
    int k, i;
    memset(c->x, 0, (size_t)c->n * sizeof *c->x);
    peri_anderson_begin(&q, c->n, memory, v);
    for (k = 0; k < 3000 && residual(&c->m, 3, c->b, c->x) > 1e-3; k++) {
        peri_matrix_multiply3(&c->m.a, NULL, c->x, r);
        for (i = 0; i < c->n; i++) gx[i] = c->x[i] + (c->b[i] - r[i]) / c->m.diagonal[i / 3];
        peri_anderson_push(&q, par, c->x, gx);
        peri_anderson_apply(&q, par, c->x);
        if (memory == 0) CHECK(memcmp(c->x, gx, (size_t)c->n * sizeof *gx) == 0);
    }
    free(v);
    return k;
}

static void anderson_accelerates(void) {
    call c;
    peri_real *first;
    int plain, five, k;
    lattice(&c.m, 14, 13, 12, 1, 0.3);
    call_begin(&c, 3);
    first = (peri_real *)grab((size_t)c.n, sizeof *first);
    plain = sweeps(&c, 0, NULL);
    five = sweeps(&c, 5, NULL);
    CHECK(plain < 3000 && 3 * five < plain);
    memcpy(first, c.x, (size_t)c.n * sizeof *first);
    for (k = 0; k < WAYS; k++) {
        CHECK(sweeps(&c, 5, way(k)) == five);
        CHECK(memcmp(first, c.x, (size_t)c.n * sizeof *first) == 0);
    }
    free(first);
    call_end(&c);
}

/* What worsens is not taken: the last good image comes back, and the memory is gone. */
static void anderson_resets(void) {
    peri_real x[2] = {0, 0}, gx[2], vectors[2 * 4 * 2], good[2];
    peri_anderson q;
    int k;
    peri_anderson_begin(&q, 2, 3, vectors);
    gx[0] = gx[1] = (peri_real)peri__from_bits(PERI__NAN);
    CHECK(peri_anderson_push(&q, NULL, x, gx) == 0 && !q.started);
    peri_anderson_apply(&q, NULL, x);
    CHECK(x[0] == 0 && x[1] == 0); /* there is no image yet */
    for (k = 0; k < 2; k++) {
        gx[0] = (peri_real)(0.5 * (double)x[0] + 1);
        gx[1] = (peri_real)(0.25 * (double)x[1] + 1);
        CHECK(peri_anderson_push(&q, NULL, x, gx) == 1);
        memcpy(good, gx, sizeof good);
        peri_anderson_apply(&q, NULL, x);
    }
    CHECK(q.used == 1 && q.resets == 0);
    gx[0] = x[0] + 100;
    gx[1] = x[1];
    CHECK(peri_anderson_push(&q, NULL, x, gx) == 0 && q.used == 0 && q.resets == 1);
    peri_anderson_apply(&q, NULL, x);
    CHECK(x[0] == good[0] && x[1] == good[1]);
    gx[0] = x[0] + 100; /* the plain iteration is taken as it is */
    CHECK(peri_anderson_push(&q, NULL, x, gx) == 1 && q.used == 1);
    gx[0] = (peri_real)HUGE_VAL;
    CHECK(peri_anderson_push(&q, NULL, x, gx) == 0 && q.used == 0 && q.resets == 2);
    gx[0] = x[0];
    gx[1] = x[1]; /* a fixed point: no division by nothing */
    for (k = 0; k < 5; k++) {
        CHECK(peri_anderson_push(&q, NULL, x, gx) == 1);
        peri_anderson_apply(&q, NULL, x);
        CHECK(x[0] == gx[0] && x[1] == gx[1]);
    }
    peri_anderson_begin(&q, 0, 3, NULL);
    CHECK(peri_anderson_push(&q, NULL, NULL, NULL) == 1);
    peri_anderson_apply(&q, NULL, NULL);
}

/* More memory than there are directions: the differences repeat each other, and at the end are rounding. A map that
   takes 0.9 of an error leaves 1 / (1 - 0.9) of its own rounding. */
static void anderson_repeats(void) {
    peri_real x[2], gx[2], vectors[2 * 9 * 2];
    double wanted;
    peri_anderson q;
    int k, i, map;
    for (map = 0; map < 3; map++) {
        peri_anderson_begin(&q, 2, 8, vectors);
        x[0] = (peri_real)0.3;
        x[1] = (peri_real)1.2;
        for (k = 0; k < 60; k++) {
            for (i = 0; i < 2; i++) {
                double t = (double)x[i];
                gx[i] = (peri_real)(map == 0 ? cos(t) : map == 1 ? 0.5 * t + 0.4 / t : 0.9 * t + 0.1 * (1 + 2 * i));
            }
            peri_anderson_push(&q, NULL, x, gx);
            peri_anderson_apply(&q, NULL, x);
            for (i = 0; i < 2 && k > 10; i++) {
                wanted = map == 0 ? 0.7390851332151607 : map == 1 ? sqrt(0.8) : 1 + 2 * i;
                NEAR(x[i], wanted, (map == 2 ? 60 : 20) * U);
            }
        }
    }
}

/* ---- two levels -------------------------------------------------------------------------------------------------- */

static peri_real *places(int nx, int ny, int nz) {
    peri_real *xyz = (peri_real *)grab(3 * (size_t)(nx * ny * nz), sizeof *xyz);
    int i;
    for (i = 0; i < nx * ny * nz; i++) {
        xyz[3 * i] = (peri_real)(i % nx);
        xyz[3 * i + 1] = (peri_real)(i / nx % ny);
        xyz[3 * i + 2] = (peri_real)(i / nx / ny);
    }
    return xyz;
}

#define SIDE 3      /* of a cell, in spacings */
#define NODES 64    /* of 4 x 4 x 4 at most */

/* Q of a lattice of spacing 1 that begins in 0: products of tents around the nodes, over the nodes that some row is
   nearest to, so that a row adds up to 1; then without rows that stand alone, and nodes nearest to no other. */
static void dense_weights(const peri_real *xyz, int n, const char *alone, double *q) {
    int i, k, c, near[NODES] = {0}, live[NODES] = {0};
    for (i = 0; i < n; i++) {
        for (k = c = 0; c < 3; c++) k = 4 * k + (int)((double)xyz[3 * i + c] / SIDE + 0.5);
        near[k] = 1;
        live[k] |= !alone[i];
    }
    for (i = 0; i < n; i++) {
        double sum = 0;
        for (k = 0; k < NODES; k++) {
            int at[3];
            at[0] = k / 16;
            at[1] = k / 4 % 4;
            at[2] = k % 4;
            for (q[i * NODES + k] = near[k], c = 0; c < 3; c++) {
                double away = fabs((double)xyz[3 * i + c] / SIDE - at[c]);
                q[i * NODES + k] *= away < 1 ? 1 - away : 0;
            }
            sum += q[i * NODES + k];
        }
        for (k = 0; k < NODES; k++) q[i * NODES + k] *= alone[i] || !live[k] ? 0 : 1 / sum;
    }
}

/* The operator written out: D^-1 + Q (Q^T A Q)^-1 Q^T. Dense inverse by Gauss-Jordan. */
static void dense_levels(const sparse *m, const peri_real *xyz, const char *alone, double *p) {
    int n = m->n, i, j, k, l, wide = 2 * NODES;
    double *c = (double *)grab((size_t)NODES * 2 * NODES, sizeof *c);
    double *q = (double *)grab((size_t)n * NODES, sizeof *q);
    dense_weights(xyz, n, alone, q);
    for (i = 0; i < n; i++)
        for (k = m->row[i] - 1; k < m->row[i + 1]; k++) {
            double value = (double)(k < m->row[i] ? m->diagonal[i] : m->value[k]);
            int to = k < m->row[i] ? i : m->col[k];
            for (j = 0; j < NODES; j++)
                for (l = 0; l < NODES; l++) c[j * wide + l] += q[i * NODES + j] * value * q[to * NODES + l];
        }
    for (i = 0; i < NODES; i++) {
        if (fabs(c[i * wide + i]) <= 0) c[i * wide + i] = 1;
        c[i * wide + NODES + i] = 1;
    }
    for (i = 0; i < NODES; i++) /* definite: no pivoting */
        for (j = 0; j < NODES; j++) {
            double f = c[j * wide + i] / c[i * wide + i];
            for (k = 0; k < wide && j != i; k++) c[j * wide + k] -= f * c[i * wide + k];
        }
    for (i = 0; i < n; i++)
        for (j = 0; j < n; j++) {
            p[i * n + j] = i == j ? 1 / (double)m->diagonal[i] : 0;
            for (k = 0; k < NODES; k++)
                for (l = 0; l < NODES; l++)
                    p[i * n + j] += q[i * NODES + k] * c[k * wide + NODES + l] / c[k * wide + k] * q[j * NODES + l];
        }
    free(c);
    free(q);
}

static void two_levels_are_what_they_say(void) {
    int rhs, i, j, c, k;
    for (rhs = 1; rhs <= 3; rhs++) {
        sparse m;
        peri_two_level *t = NULL;
        peri_error err;
        peri_real *g, *p, *again, *xyz;
        double *dense, worst = 0;
        char *alone;
        lattice(&m, 5, 6, 4, 1, 0.05);
        xyz = places(5, 6, 4);
        alone = (char *)grab((size_t)m.n, 1);
        for (i = 0; i < m.n; i++) { /* what is held stands alone, as in a world; a whole cube of it, and single ones */
            alone[i] = (xyz[3 * i] < 2 && xyz[3 * i + 1] < 2 && xyz[3 * i + 2] < 2) || i % 17 == 3;
            for (k = m.row[i]; k < m.row[i + 1]; k++)
                if (alone[i]) m.value[k] = m.value[peri__find(m.row, m.col, m.col[k], i)] = 0;
        }
        g = (peri_real *)grab(3 * (size_t)(rhs * m.n), sizeof *g);
        p = g + rhs * m.n;
        again = p + rhs * m.n;
        dense = (double *)grab((size_t)m.n * (size_t)m.n, sizeof *dense);
        dense_levels(&m, xyz, alone, dense);
        for (i = 0; i < rhs * m.n; i++) g[i] = (peri_real)spread();
        CHECK(peri_two_level_create(&m.a, xyz, SIDE, rhs, NULL, &t, &err) == PERI_OK && t);
        CHECK(peri_two_level_nodes(t) == 2 * 3 * 2);
        CHECK(peri_two_level_factor(t, &m.a, &err) == PERI_OK);
        peri_two_level_apply(g, p, t);
        for (i = 0; i < m.n; i++)
            for (c = 0; c < rhs; c++) {
                double sum = 0, size = 0;
                for (j = 0; j < m.n; j++) {
                    sum += dense[i * m.n + j] * (double)g[rhs * j + c];
                    size += fabs(dense[i * m.n + j] * (double)g[rhs * j + c]);
                }
                sum = fabs(sum - (double)p[rhs * i + c]) / size;
                if (sum > worst) worst = sum;
            }
        NEAR(worst, 0, 1e3 * U); /* condition of the coarse matrix, at most some hundred */
        for (k = 0; k < 3; k++) { /* values anew, threads: the same bits */
            peri_parallel par;
            memset(&par, 0, sizeof par);
            par.threads = k + 1;
            peri_two_level_threads(t, k ? &par : NULL);
            CHECK(peri_two_level_factor(t, &m.a, NULL) == PERI_OK);
            peri_two_level_apply(g, again, t);
            CHECK(!memcmp(again, p, (size_t)(rhs * m.n) * sizeof *p));
        }
        peri_two_level_destroy(t);
        free(g);
        free(dense);
        free(alone);
        free(xyz);
        sparse_end(&m);
    }
}

/* Over two levels the count hardly grows with the lattice, where Jacobi's grows with its length. */
static void two_levels_scale(void) {
    int count[2][2], size, which;
    for (size = 0; size < 2; size++)
        for (which = 0; which < 2; which++) {
            peri_two_level *t = NULL;
            peri_real *xyz;
            call c;
            memset(&c, 0, sizeof c);
            lattice(&c.m, size ? 16 : 8, size ? 16 : 8, size ? 16 : 8, 1, 1e-3);
            xyz = places(size ? 16 : 8, size ? 16 : 8, size ? 16 : 8);
            call_begin(&c, 3);
            c.o.tolerance = 1e-4;
            CHECK(peri_two_level_create(&c.m.a, xyz, SIDE, 3, NULL, &t, NULL) == PERI_OK);
            CHECK(peri_two_level_factor(t, &c.m.a, NULL) == PERI_OK);
            if (which) c.o.precondition = peri_two_level_apply;
            c.o.context = t;
            CHECK(solve_from_zero(&c, peri_solve_cg) == PERI_OK);
            count[size][which] = c.report.iterations;
            peri_two_level_destroy(t);
            free(xyz);
            call_end(&c);
        }
    printf("    CG on 8^3 and 16^3: Jacobi %d and %d, two levels %d and %d iterations\n", count[0][0], count[1][0],
           count[0][1], count[1][1]);
    CHECK(2 * count[1][1] < count[1][0] && count[1][1] <= count[0][1] + 4);
}

/* c = Q (Q^T A Q)^-1 Q^T g. */
static void coarse_part(const sparse *m, peri_two_level *t, const peri_real *g, peri_real *c) {
    int i;
    peri_two_level_apply(g, c, t);
    for (i = 0; i < 3 * m->n; i++) c[i] -= g[i] / m->diagonal[i / 3];
}

/* Wherever rows stand, nodes do not hang on each other (lines, sheets and clouds, with rows that stand alone): that
   part of the operator, C, is a projection in the norm of A, C A C = C. */
static void two_levels_anywhere(void) {
    double worst = 0;
    int shape, i, k, c;
    for (shape = 0; shape < 24; shape++) {
        sparse m;
        peri_two_level *t = NULL;
        peri_error err;
        peri_real *xyz, *g, *once, *twice;
        double off = 0, size = 0;
        lattice(&m, 6, 6, 6, 1, 1e-3);
        xyz = places(6, 6, 6);
        g = (peri_real *)grab(9 * (size_t)m.n, sizeof *g);
        once = g + 3 * m.n;
        twice = once + 3 * m.n;
        for (i = 0; i < m.n; i++) {
            for (c = 0; c < 3; c++) xyz[3 * i + c] += (peri_real)((shape >= 8 ? 1.0 : 0.0) * spread());
            if (shape % 4 == 1) xyz[3 * i + 2] *= (peri_real)1e-3;
            if (shape % 4 == 2) xyz[3 * i] = xyz[3 * i + 1] = xyz[3 * i + 2] = (peri_real)i;
            if (shape % 4 == 3) xyz[3 * i + 1] = xyz[3 * i + 2] = 0;
        }
        for (i = 0; i < m.n && shape % 8 > 3; i++)
            for (k = m.row[i]; k < m.row[i + 1]; k++)
                if (i % 5) m.value[k] = m.value[peri__find(m.row, m.col, m.col[k], i)] = 0;
        CHECK(peri_two_level_create(&m.a, xyz, SIDE, 3, NULL, &t, &err) == PERI_OK);
        CHECK(peri_two_level_factor(t, &m.a, &err) == PERI_OK);
        for (i = 0; i < 3 * m.n; i++) g[i] = (peri_real)spread();
        coarse_part(&m, t, g, once);
        peri_matrix_multiply3(&m.a, NULL, once, g);
        coarse_part(&m, t, g, twice);
        for (i = 0; i < 3 * m.n; i++) {
            off += ((double)twice[i] - (double)once[i]) * ((double)twice[i] - (double)once[i]);
            size += (double)once[i] * (double)once[i];
        }
        if (sqrt(off / size) > worst) worst = sqrt(off / size);
        peri_two_level_destroy(t);
        free(g);
        free(xyz);
        sparse_end(&m);
    }
    NEAR(worst, 0, 1e4 * U);
}

static void two_levels_errors(void) {
    sparse m;
    peri_two_level *t = NULL;
    peri_error err;
    peri_real keep, *xyz;
    lattice(&m, 4, 4, 4, 1, 1);
    xyz = places(4, 4, 4);
    CHECK(peri_two_level_create(NULL, xyz, 2, 3, NULL, &t, &err) == PERI_ERROR_ARGUMENT && !t);
    CHECK(peri_two_level_create(&m.a, NULL, 2, 3, NULL, &t, &err) == PERI_ERROR_ARGUMENT && strstr(err.text, "xyz"));
    CHECK(peri_two_level_create(&m.a, xyz, 2, 4, NULL, &t, &err) == PERI_ERROR_ARGUMENT && strstr(err.text, "rhs"));
    CHECK(peri_two_level_create(&m.a, xyz, 0, 3, NULL, &t, &err) == PERI_ERROR_VALUE && strstr(err.text, "cell is 0"));
    keep = xyz[7];
    xyz[7] = (peri_real)HUGE_VAL;
    CHECK(peri_two_level_create(&m.a, xyz, 2, 3, NULL, &t, &err) == PERI_ERROR_VALUE && strstr(err.text, "row 2"));
    xyz[7] = keep;
    CHECK(peri_two_level_create(&m.a, xyz, 2, 3, NULL, &t, &err) == PERI_OK && t);
    CHECK(peri_two_level_factor(t, NULL, &err) == PERI_ERROR_ARGUMENT);
    keep = m.diagonal[9];
    m.diagonal[9] = -1;
    CHECK(peri_two_level_factor(t, &m.a, &err) == PERI_ERROR_PIVOT && strstr(err.text, "row 9"));
    m.diagonal[9] = keep;
    CHECK(peri_two_level_factor(t, &m.a, &err) == PERI_OK);
    m.a.n = 3;
    CHECK(peri_two_level_factor(t, &m.a, &err) == PERI_ERROR_ARGUMENT && strstr(err.text, "pattern"));
    m.a.n = 0;
    peri_two_level_destroy(t);
    CHECK(peri_two_level_create(&m.a, xyz, 2, 3, NULL, &t, &err) == PERI_OK && peri_two_level_nodes(t) == 0);
    peri_two_level_destroy(t);
    peri_two_level_destroy(NULL);
    m.a.n = 64;
    free(xyz);
    sparse_end(&m);
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(solves_dense);
    RUN(cg_ends);
    RUN(cg_rate);
    RUN(chebyshev_rate);
    RUN(estimates_spectrum);
    RUN(never_diverges);
    RUN(odd_spectrum);
    RUN(spectrum_of_changing_matrix);
    RUN(jacobi_is_damped);
    RUN(indefinite);
    RUN(rounding);
    RUN(cap);
    RUN(warm_starts);
    RUN(edges);
    RUN(errors);
    RUN(spectrum_errors);
    RUN(same_bits_with_threads);
    RUN(incomplete_factor);
    RUN(incomplete_saves);
    RUN(incomplete_errors);
    RUN(incomplete_memory);
    RUN(polynomial);
    RUN(old_factor);
    RUN(bad_preconditioner);
    RUN(lbfgs_fused);
    RUN(line_search);
    RUN(line_search_energy);
    RUN(line_search_errors);
    RUN(minimise_quadratic);
    RUN(minimise_wild);
    RUN(minimise_errors);
    RUN(anderson_is_gmres);
    RUN(anderson_accelerates);
    RUN(anderson_resets);
    RUN(anderson_repeats);
    RUN(two_levels_are_what_they_say);
    RUN(two_levels_scale);
    RUN(two_levels_anywhere);
    RUN(two_levels_errors);
    return test_end();
}
