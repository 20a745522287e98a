/* tests/test_solver.c - peri_solver.h alone: small algebra, sparse solvers, L-BFGS.

   u stands for the unit roundoff (2^-24 or 2^-53). Tolerances come from backward error bounds: Higham, "Accuracy and
   Stability of Numerical Algorithms" (2nd ed.). */
#define PERI_IMPLEMENTATION
#include "../peri_solver.h"

#include <float.h>

#include "test.h"

#define EPS DBL_EPSILON /* 2 u of double */
#ifdef PERI_DOUBLE
#define U (0.5 * DBL_EPSILON)
#else
#define U (0.5 * (double)FLT_EPSILON)
#endif

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

static int same_bits(const peri_real *a, const peri_real *b, int n) {
    return memcmp(a, b, (size_t)n * sizeof *a) == 0;
}

/* A hook that runs pieces of three grains, the last one first. */
static int hook_calls;

static void run_backwards(int count, int grain, peri_task *task, void *context, void *user) {
    int begin = (count - 1) / (3 * grain) * 3 * grain;
    hook_calls += user == &hook_calls;
    for (; begin >= 0; begin -= 3 * grain) task(begin, begin + 3 * grain < count ? begin + 3 * grain : count, context);
}

/* Serial, OpenMP with 1, 2, 4 and any threads (serial where it is not compiled in), a hook. */
enum { WAYS = 6 };

static const peri_parallel *way(int k) {
    static peri_parallel par;
    static const int threads[WAYS] = {1, 1, 2, 4, 0, 1};
    par.run = k == WAYS - 1 ? run_backwards : NULL;
    par.user = &hook_calls;
    par.threads = threads[k];
    return k == 0 ? NULL : &par;
}

/* ---- the quick start of the header ------------------------------------------------------------------------------- */

static void quick_start(void) {
    int row[] = {0, 1, 3, 4}, col[] = {1, 0, 2, 1}, i, done = 0;
    peri_real off[] = {-1, -1, -1, -1}, diag[] = {2, 2, 2};
    peri_real b[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1}, work[18];
    static const double inverse[9] = {0.75, 0.5, 0.25, 0.5, 1, 0.5, 0.25, 0.5, 0.75};
    peri_matrix a;
    peri_cholesky *f = NULL;
    peri_error err;
    a.n = 3;
    a.row = row;
    a.col = col;
    a.value = off;
    a.diagonal = diag;
    if (peri_cholesky_create(&a, NULL, NULL, &f, &err) == PERI_OK && peri_cholesky_factor(f, &a, &err) == PERI_OK) {
        peri_cholesky_solve(f, 3, b, work);
        done = 1;
    }
    CHECK(done && err.code == PERI_OK && err.text[0] == 0);
    peri_cholesky_destroy(f);
    for (i = 0; i < 9; i++) NEAR(b[i], inverse[i], 20 * U); /* condition 5.8, 3 rows */
}

/* ---- log, exp ---------------------------------------------------------------------------------------------------- */

/* Distance in units of the last place of what is wanted; the reference is long double, where that is longer. */
static double ulps(double value, long double wanted) {
    int e;
    frexp((double)wanted, &e);
    return (double)(fabsl((long double)value - wanted) / (long double)ldexp(1, e - 53 < -1074 ? -1074 : e - 53));
}

#define ULPS (LDBL_MANT_DIG > 53 ? 2.0 : 3.0) /* the reference may itself be one off */

static void logarithm(void) {
    double worst = 0, x, e;
    int k, i;
    for (k = -1074; k < 1024; k++)
        for (i = 0; i < 40; i++) {
            x = ldexp(1 + chance(), k);
            e = ulps(peri_log(x), logl((long double)x));
            if (e > worst) worst = e;
        }
    for (k = 1; k < 53; k++)
        for (i = -1; i < 2; i += 2) { /* around 1, and around the border of the argument reduction */
            x = 1 + i * ldexp(1, -k);
            e = ulps(peri_log(x), logl((long double)x));
            if (e > worst) worst = e;
            x *= 1.4142135623730951;
            e = ulps(peri_log(x), logl((long double)x));
            if (e > worst) worst = e;
        }
    NEAR(worst, 0, ULPS);
    CHECK(peri_log(1) == 0);
    NEAR(ulps(peri_log(DBL_MAX), logl((long double)DBL_MAX)), 0, ULPS);
    CHECK(!peri__finite(peri_log(0)) && !peri__finite(peri_log(-1)) && !peri__finite(peri_log(HUGE_VAL)));
    CHECK(!peri__finite(peri_log(peri__from_bits(PERI__NAN))));
}

static void exponential(void) {
    double worst = 0, x, e;
    int i;
    for (i = 0; i < 100000; i++) {
        x = i < 40000 ? -745.1 + 1454.8 * chance() : i < 80000 ? 3 * spread() : spread() * ldexp(1, -i % 60);
        e = ulps(peri_exp(x), expl((long double)x));
        if (e > worst) worst = e;
    }
    NEAR(worst, 0, ULPS);
    CHECK(peri_exp(0) == 1);
    CHECK(peri_exp(-1000) == 0 && peri_exp(-HUGE_VAL) == 0);
    CHECK(peri_exp(1000) > DBL_MAX && peri_exp(HUGE_VAL) > DBL_MAX);
    CHECK(peri_exp(709.78) < DBL_MAX && peri_exp(-745.13) > 0);
    CHECK(!peri__finite(peri_exp(peri__from_bits(PERI__NAN))));
    for (i = -700; i < 700; i++) NEAR(peri_log(peri_exp(i + 0.25)), i + 0.25, 2 * EPS * (1 + fabs(i + 0.25)));
}

/* ---- 3x3 and 6x6 ------------------------------------------------------------------------------------------------- */

static double norm9(const double a[9]) {
    double s = 0;
    int i;
    for (i = 0; i < 9; i++) s = fabs(a[i]) > s ? fabs(a[i]) : s;
    return s;
}

/* c = a diag(d) b^T */
static void compose(const double a[9], const double d[3], const double b[9], double c[9]) {
    int i, j, k;
    for (i = 0; i < 3; i++)
        for (j = 0; j < 3; j++) {
            c[3 * i + j] = 0;
            for (k = 0; k < 3; k++) c[3 * i + j] += a[3 * i + k] * d[k] * b[3 * j + k];
        }
}

static void check_rotation(const double r[9]) {
    static const double one[3] = {1, 1, 1};
    double rr[9];
    int i;
    compose(r, one, r, rr);
    /* A dozen rotations (three sweeps), each off by a few units of roundoff: Higham, lemma 19.8. */
    for (i = 0; i < 9; i++) NEAR(rr[i], i % 4 == 0, 40 * EPS);
    NEAR(peri_det3(r), 1, 60 * EPS);
}

static void random_rotation(double r[9]) {
    double q[4], s = 0;
    int i;
    do {
        for (s = 0, i = 0; i < 4; i++) {
            q[i] = spread();
            s += q[i] * q[i];
        }
    } while (s > 1 || s < 0.01);
    for (i = 0; i < 4; i++) q[i] /= sqrt(s);
    r[0] = 1 - 2 * (q[2] * q[2] + q[3] * q[3]);
    r[1] = 2 * (q[1] * q[2] - q[0] * q[3]);
    r[2] = 2 * (q[1] * q[3] + q[0] * q[2]);
    r[3] = 2 * (q[1] * q[2] + q[0] * q[3]);
    r[4] = 1 - 2 * (q[1] * q[1] + q[3] * q[3]);
    r[5] = 2 * (q[2] * q[3] - q[0] * q[1]);
    r[6] = 2 * (q[1] * q[3] - q[0] * q[2]);
    r[7] = 2 * (q[2] * q[3] + q[0] * q[1]);
    r[8] = 1 - 2 * (q[1] * q[1] + q[2] * q[2]);
}

static void determinant_adjugate_product(void) {
    int i, k;
    for (k = 0; k < 100; k++) {
        double a[9], c[9], p[9], d;
        for (i = 0; i < 9; i++) a[i] = spread();
        peri_adjugate3(a, c);
        d = peri_det3(a);
        peri_mul3(a, c, p);
        for (i = 0; i < 9; i++) NEAR(p[i], i % 4 == 0 ? d : 0, 20 * EPS); /* sums of 6 products of 3 numbers below 1 */
        peri_mul3(c, a, p);
        for (i = 0; i < 9; i++) NEAR(p[i], i % 4 == 0 ? d : 0, 20 * EPS);
    }
    {
        static const double a[9] = {1, 2, 3, 4, 5, 6, 7, 8, 10}, b[9] = {0, 1, 0, 0, 0, 1, 1, 0, 0};
        static const double ab[9] = {3, 1, 2, 6, 4, 5, 10, 7, 8};
        double c[9];
        CHECK(peri_det3(a) == -3);
        peri_mul3(a, b, c);
        CHECK(memcmp(c, ab, sizeof c) == 0);
    }
}

static void check_eigen(const double s[6]) {
    static const int voigt[9] = {0, 5, 4, 5, 1, 3, 4, 3, 2};
    double value[3], v[9], back[9], scale = 0;
    int i;
    for (i = 0; i < 6; i++) scale = fabs(s[i]) > scale ? fabs(s[i]) : scale;
    peri_eigen3(s, value, v);
    compose(v, value, v, back);
    for (i = 0; i < 9; i++) NEAR(back[i], s[voigt[i]], 80 * EPS * scale);
    CHECK(value[0] <= value[1] && value[1] <= value[2]);
    check_rotation(v);
}

static void eigenvalues(void) {
    static const double fixed[8][6] = {{0, 0, 0, 0, 0, 0}, {2, 2, 2, 0, 0, 0},  {1, 1, 1, 1, 1, 1},
                                       {3, 1, 2, 0, 0, 0}, {0, 0, 0, 0, 0, 1},  {1, 1e-20, 1e-20, 1e-20, 0, 0},
                                       {2, 2, 5, 0, 0, 1}, {1e150, -3e150, 0, 2e150, 1e150, 5e149}};
    double s[6], value[3], v[9];
    int i, k;
    for (k = 0; k < 8; k++) check_eigen(fixed[k]);
    for (k = 0; k < 2000; k++) {
        double r[9], d[3], a[9];
        random_rotation(r);
        for (i = 0; i < 3; i++) d[i] = k % 3 == 0 && i > 0 ? d[0] + (k % 2) * 1e-9 * i : spread();
        compose(r, d, r, a);
        s[0] = a[0];
        s[1] = a[4];
        s[2] = a[8];
        s[3] = a[5];
        s[4] = a[2];
        s[5] = a[1];
        check_eigen(s);
        peri_eigen3(s, value, v);
        /* Weyl: eigenvalues move by no more than the perturbation, here the rounding of `compose` and of the method */
        NEAR(value[0] + value[1] + value[2], d[0] + d[1] + d[2], 60 * EPS);
        NEAR(value[0] * value[1] * value[2], d[0] * d[1] * d[2], 60 * EPS);
    }
    for (i = 0; i < 6; i++) s[i] = peri__from_bits(PERI__NAN);
    peri_eigen3(s, value, v); /* just ends */
    CHECK(!peri__finite(value[0]));
}

static void check_svd(const double f[9], const double *expect) {
    double u[9], v[9], sigma[3], back[9], scale = norm9(f);
    int i;
    peri_svd3(f, u, sigma, v);
    compose(u, sigma, v, back);
    for (i = 0; i < 9; i++) NEAR(back[i], f[i], 60 * EPS * scale);
    CHECK(sigma[0] >= sigma[1] && sigma[1] >= fabs(sigma[2]));
    check_rotation(u);
    check_rotation(v);
    for (i = 0; i < 3 && expect; i++) NEAR(sigma[i], expect[i], 60 * EPS * scale);
}

static void singular_values(void) {
    static const double fixed[11][9] = {
        {0, 0, 0, 0, 0, 0, 0, 0, 0}, {1, 0, 0, 0, 1, 0, 0, 0, 1},    {-1, 0, 0, 0, 1, 0, 0, 0, 1},
        {0, 0, 0, 0, 0, 0, 0, 0, 7}, {0, 0, 3, 0, 0, 0, 0, 0, 0},    {1, 1, 1, 1, 1, 1, 1, 1, 1},
        {1, 2, 3, 4, 5, 6, 7, 8, 9}, {-1, 0, 0, 0, -1, 0, 0, 0, -1}, {0, 1, 0, 0, 0, 1, 1, 0, 0},
        {1, 1, 0, 1, 1, 0, 0, 0, 0}, {0, 0, 0, 1e-310, 0, 0, 0, 0, 1e-320}};
    static const double values[6][3] = {{1, 1e-8, 1e-14}, {1, 1, 1},  {2, 1, -1},
                                        {1, 1e-17, 0},    {1, 1, 0},  {5, 1e-3, -1e-12}};
    double f[9], u[9], v[9], sigma[3];
    int i, k;
    for (k = 0; k < 11; k++) check_svd(fixed[k], NULL);
    for (k = 0; k < 3000; k++) {
        double scale = k % 5 == 0 ? 1e150 : k % 5 == 1 ? 1e-150 : 1;
        for (i = 0; i < 3; i++) sigma[i] = scale * values[k % 6][i];
        random_rotation(u);
        random_rotation(v);
        compose(u, sigma, v, f);
        check_svd(f, sigma);
        for (i = 0; i < 9; i++) f[i] = scale * spread();
        check_svd(f, NULL);
        for (i = 6; i < 9; i++) f[i] = f[i - 3]; /* rank 2 exactly */
        check_svd(f, NULL);
        peri_svd3(f, u, sigma, v);
        NEAR(sigma[2], 0, 20 * EPS * scale);
    }
    for (k = 0; k < 200; k++) { /* graded columns: every singular value is good to its own size (Demmel & Veselic) */
        static const double grade[3] = {1, 1e-10, 1e-20};
        double b[9], det;
        do {
            for (i = 0; i < 9; i++) b[i] = spread();
            det = peri_det3(b);
        } while (fabs(det) < 0.3); /* columns no longer than sqrt 3: condition below 30 */
        for (i = 0; i < 9; i++) f[i] = b[i] * grade[i % 3];
        peri_svd3(f, u, sigma, v);
        NEAR(sigma[0] * (sigma[1] * 1e10) * (sigma[2] * 1e20), det, 30 * 60 * EPS * fabs(det));
    }
    for (k = 0; k < 2; k++) {
        for (i = 0; i < 9; i++) f[i] = i == 4 ? peri__from_bits(k ? PERI__NAN : PERI__INFINITY) : i;
        peri_svd3(f, u, sigma, v);
        CHECK(!peri__finite(sigma[0]) && !peri__finite(sigma[1]) && !peri__finite(sigma[2]));
        check_rotation(u);
        check_rotation(v);
    }
}

static void polar(void) {
    int i, j, k;
    for (k = 0; k < 1000; k++) {
        double r[9], q[9], f[9], d[3], s[9], got[9];
        random_rotation(r);
        random_rotation(q);
        for (i = 0; i < 3; i++) d[i] = 0.1 + chance();
        compose(q, d, q, s);
        peri_mul3(r, s, f);
        peri_polar3(f, got);
        /* The rotation moves by at most 2 / (sigma2 + sigma3) <= 10 times the perturbation (Higham 2008, ch. 8). */
        for (i = 0; i < 9; i++) NEAR(got[i], r[i], 10 * 100 * EPS);
        for (i = 0; i < 9; i++) f[i] = k == 0 ? 0 : k % 3 == 0 ? -f[i] : k % 3 == 1 ? spread() : i < 3 ? 0 : f[i];
        peri_polar3(f, got);
        check_rotation(got);
        for (i = 0; i < 3; i++)
            for (j = 0; j < 3; j++) q[3 * i + j] = got[i] * f[j] + got[3 + i] * f[3 + j] + got[6 + i] * f[6 + j];
        for (i = 0; i < 3; i++)
            for (j = 0; j < i; j++) NEAR(q[3 * i + j], q[3 * j + i], 200 * EPS); /* r^T f is symmetric */
        CHECK(q[0] + q[4] + q[8] > -200 * EPS); /* sigma1 + sigma2 + sigma3, the last no larger than the others */
    }
}

static void inverse6(void) {
    double m[21], a[21], b[36];
    int i, j, k, rep;
    for (rep = 0; rep < 300; rep++) {
        for (i = 0; i < 36; i++) b[i] = spread();
        for (i = 0; i < 6; i++)
            for (j = 0; j <= i; j++) {
                a[i * (i + 1) / 2 + j] = i == j; /* eigenvalues between 1 and 37 */
                for (k = 0; k < 6; k++) a[i * (i + 1) / 2 + j] += b[6 * i + k] * b[6 * j + k];
            }
        memcpy(m, a, sizeof m);
        CHECK(peri_invert6(m, 1e-12) == 1);
        for (i = 0; i < 6; i++)
            for (j = 0; j < 6; j++) {
                double s = 0;
                for (k = 0; k < 6; k++)
                    s += a[i > k ? i * (i + 1) / 2 + k : k * (k + 1) / 2 + i] *
                         m[k > j ? k * (k + 1) / 2 + j : j * (j + 1) / 2 + k];
                NEAR(s, i == j, 6 * 37 * 8 * EPS); /* n cond u, times a small constant: Higham, section 14.3 */
            }
    }
    memset(a, 0, sizeof a);
    for (i = 0; i < 6; i++) a[i * (i + 1) / 2 + i] = i == 4 ? 1e-3 : 1;
    memcpy(m, a, sizeof m);
    CHECK(peri_invert6(m, 1.1e-3) == 0 && memcmp(m, a, sizeof m) == 0);
    CHECK(peri_invert6(m, 0.9e-3) == 1);
    NEAR(m[14], 1000, 1e-12);
    a[14] = 0;
    memcpy(m, a, sizeof m);
    CHECK(peri_invert6(m, 0) == 0 && memcmp(m, a, sizeof m) == 0);
    a[14] = 1;
    a[10] = 2; /* indefinite: entry (4, 0) */
    memcpy(m, a, sizeof m);
    CHECK(peri_invert6(m, 0) == 0 && memcmp(m, a, sizeof m) == 0);
    a[10] = peri__from_bits(PERI__NAN);
    memcpy(m, a, sizeof m);
    CHECK(peri_invert6(m, 1e-9) == 0 && memcmp(m, a, sizeof m) == 0);
}

/* ---- threads ----------------------------------------------------------------------------------------------------- */

enum { COUNTED = 1000 };
static int counted[COUNTED], cut_badly;

static void count_task(int begin, int end, void *context) {
    int i, grain = *(int *)context;
    if (begin % grain != 0 || end <= begin) cut_badly++;
    for (i = begin; i < end; i++) counted[i]++;
}

static void parallel_for(void) {
    static const int counts[6] = {0, 1, 7, 64, 65, COUNTED}, grains[5] = {1, 7, 64, 2000, 0x7fffffff};
    int k, c, g, i, grain;
    for (k = 0; k < WAYS; k++)
        for (c = 0; c < 6; c++)
            for (g = 0; g < 5; g++) {
                if (k == WAYS - 1 && g > 2) continue; /* the test's hook multiplies grain by 3 */
                memset(counted, 0, sizeof counted);
                grain = grains[g];
                peri_parallel_for(way(k), counts[c], grain, count_task, &grain);
                for (i = 0; i < COUNTED; i++) CHECK(counted[i] == (i < counts[c]));
            }
    CHECK(cut_badly == 0);
    CHECK(hook_calls > 0);
    grain = 1;
    peri_parallel_for(NULL, -5, 1, count_task, &grain);
    peri_parallel_for(NULL, 1, 0, count_task, &grain);
    CHECK(counted[0] == 2);
}

static void dot(void) {
    static const int sizes[] = {0, 1, 3, 4, 5, 4095, 4096, 4097, 20000, 262144, 262145, 300001};
    int n = 300001, i, k, s;
    peri_real *a = (peri_real *)grab((size_t)n, sizeof *a), *b = (peri_real *)grab((size_t)n, sizeof *b);
    for (i = 0; i < n; i++) {
        a[i] = (peri_real)spread();
        b[i] = (peri_real)spread();
    }
    for (s = 0; s < 12; s++) {
        long double exact = 0, size = 0;
        double first = peri_dot(NULL, sizes[s], a, b);
        for (i = 0; i < sizes[s]; i++) {
            exact += (long double)a[i] * (long double)b[i];
            size += fabsl((long double)a[i] * (long double)b[i]);
        }
        /* The longest chain of additions: a quarter of a block, then the blocks (Higham, section 4.2). */
        NEAR(first, (double)exact, (double)size * 0.5 * EPS * (sizes[s] / 64 / 4 + 1024 + 4 + 64));
        for (k = 0; k < WAYS; k++) CHECK(peri_dot(way(k), sizes[s], a, b) == first);
    }
    free(a);
    free(b);
}

/* ---- sparse matrices --------------------------------------------------------------------------------------------- */

typedef struct sparse {
    int n, *row, *col;
    peri_real *value, *diagonal, *xyz;
    peri_matrix a;
} sparse;

static void sparse_begin(sparse *m, int n, int entries) {
    m->n = n;
    m->row = (int *)grab((size_t)n + 1, sizeof(int));
    m->col = (int *)grab((size_t)entries, sizeof(int));
    m->value = (peri_real *)grab((size_t)entries, sizeof(peri_real));
    m->diagonal = (peri_real *)grab((size_t)n, sizeof(peri_real));
    m->xyz = (peri_real *)grab(3 * (size_t)n, sizeof(peri_real));
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
    free(m->xyz);
}

/* A weight for the pair i, j that is the same both ways, in (0.1, 1.1), with either sign when `mixed`. */
static double weight(int i, int j, int mixed) {
    unsigned low = (unsigned)(i < j ? i : j), high = (unsigned)(i < j ? j : i);
    unsigned h = (low * 2654435761u) ^ (high * 2246822519u);
    h = (h ^ (h >> 15)) * 2654435761u;
    return (0.1 + (h >> 8) / 16777216.0) * (mixed && (h & 16) ? 1 : -1);
}

/* Boxes of nx ny nz points, bonds up to `reach` cells along each axis, `boxes` of them side by side, numbers shuffled
   when asked. Diagonal: sum of |bonds| + shift. */
static void lattice(sparse *m, int nx, int ny, int nz, int reach, int boxes, int shuffled, double shift) {
    int box = nx * ny * nz, n = box * boxes, i, j, k = 0, x, y, z, side = 2 * reach + 1;
    int *to = (int *)grab((size_t)n, sizeof(int)), *from = (int *)grab((size_t)n, sizeof(int));
    sparse_begin(m, n, n * side * side * side);
    for (i = 0; i < n; i++) from[i] = i;
    for (i = n - 1; i > 0 && shuffled; i--) {
        j = (int)(chance() * (i + 1));
        k = from[i];
        from[i] = from[j];
        from[j] = k;
    }
    for (i = 0; i < n; i++) to[from[i]] = i;
    for (k = i = 0; i < n; i++) {
        int b = from[i] / box, p = from[i] % box, start = k, q;
        int px = p % nx, py = p / nx % ny, pz = p / nx / ny;
        double sum = shift;
        m->xyz[3 * i] = (peri_real)(px + 100 * b);
        m->xyz[3 * i + 1] = (peri_real)py;
        m->xyz[3 * i + 2] = (peri_real)pz;
        for (z = pz - reach; z <= pz + reach; z++)
            for (y = py - reach; y <= py + reach; y++)
                for (x = px - reach; x <= px + reach; x++) {
                    if (x < 0 || y < 0 || z < 0 || x >= nx || y >= ny || z >= nz) continue;
                    j = to[b * box + (z * ny + y) * nx + x];
                    if (j == i) continue;
                    for (q = k++; q > start && m->col[q - 1] > j; q--) m->col[q] = m->col[q - 1];
                    m->col[q] = j;
                }
        for (q = start; q < k; q++) {
            m->value[q] = (peri_real)weight(i, m->col[q], shuffled);
            sum += fabs((double)m->value[q]);
        }
        m->diagonal[i] = (peri_real)sum;
        m->row[i + 1] = k;
    }
    free(to);
    free(from);
}

/* From the upper triangle of a dense pattern: on[n i + j] != 0 for j > i. */
static void from_dense(sparse *m, int n, const char *on, double shift) {
    int i, j, k = 0;
    sparse_begin(m, n, n * n);
    for (i = 0; i < n; i++) {
        double sum = shift;
        for (j = 0; j < n; j++) {
            if (j == i || !on[i < j ? n * i + j : n * j + i]) continue;
            m->col[k] = j;
            m->value[k] = (peri_real)weight(i, j, 1);
            sum += fabs((double)m->value[k++]);
        }
        m->row[i + 1] = k;
        m->diagonal[i] = (peri_real)sum;
        for (j = 0; j < 3; j++) m->xyz[3 * i + j] = (peri_real)chance();
    }
}

static void multiply(void) {
    sparse m;
    double *dense;
    peri_real *x, *y, *z;
    int i, j, k, c, n;
    lattice(&m, 9, 8, 11, 1, 1, 1, 0.5);
    n = m.n;
    dense = (double *)grab((size_t)n * (size_t)n, sizeof *dense);
    x = (peri_real *)grab(9 * (size_t)n, sizeof *x);
    y = x + 3 * n;
    z = y + 3 * n;
    for (i = 0; i < n; i++) {
        dense[i * n + i] = (double)m.diagonal[i];
        for (k = m.row[i]; k < m.row[i + 1]; k++) dense[i * n + m.col[k]] = (double)m.value[k];
    }
    for (i = 0; i < 3 * n; i++) x[i] = (peri_real)spread();
    peri_matrix_multiply3(&m.a, NULL, x, y);
    for (i = 0; i < n; i++)
        for (c = 0; c < 3; c++) {
            double sum = 0, size = 0;
            for (j = 0; j < n; j++) {
                sum += dense[i * n + j] * (double)x[3 * j + c];
                size += fabs(dense[i * n + j] * (double)x[3 * j + c]);
            }
            NEAR(y[3 * i + c], sum, U * fabs(sum) + 27 * EPS * size); /* 27 terms in double, one rounding to real */
        }
    for (k = 0; k < WAYS; k++) {
        memset(z, 0, 3 * (size_t)n * sizeof *z);
        peri_matrix_multiply3(&m.a, way(k), x, z);
        CHECK(same_bits(y, z, 3 * n));
        peri_jacobi3(&m.a, way(k), x, z);
        for (i = 0; i < 3 * n; i++) NEAR(z[i] * m.diagonal[i / 3], x[i], 4 * U * fabs((double)x[i]));
    }
    m.a.n = 0;
    peri_matrix_multiply3(&m.a, NULL, NULL, NULL);
    peri_jacobi3(&m.a, NULL, NULL, NULL);
    peri_chebyshev3(&m.a, NULL, 3, 0.1, 2, NULL, NULL, NULL);
    free(dense);
    free(x);
    sparse_end(&m);
}

static double chebyshev_t(int k, double x) {
    double a = 1, b = x, c;
    for (; k > 0; k--) {
        c = 2 * x * b - a;
        a = b;
        b = c;
    }
    return a;
}

/* Two unknowns: eigenvectors (1, 1) and (1, -1) of D^-1 A with eigenvalues 1 -+ 0.75, so the polynomial can be read. */
static void chebyshev_polynomial(void) {
    int row[] = {0, 1, 2}, col[] = {1, 0}, sweeps, which;
    peri_real off[] = {-1.5, -1.5}, diag[] = {2, 2}, b[6] = {0}, x[6], work[12];
    peri_matrix a;
    a.n = 2;
    a.row = row;
    a.col = col;
    a.value = off;
    a.diagonal = diag;
    for (sweeps = 1; sweeps < 12; sweeps++)
        for (which = 0; which < 2; which++) {
            double lambda = which ? 1.75 : 0.25, low = 0.2, high = 1.8, half = 0.5 * (high - low);
            double rest = chebyshev_t(sweeps, (1 - lambda) / half) / chebyshev_t(sweeps, 1 / half);
            b[1] = 2;
            b[4] = which ? -2 : 2;
            peri_chebyshev3(&a, NULL, sweeps, low, high, b, x, work);
            /* each sweep rounds x, residual and step, all of the size of the solution 1 / lambda at most */
            NEAR(x[1], (1 - rest) / lambda, 6 * sweeps * U * 4);
            NEAR(x[4], (which ? -1 : 1) * (1 - rest) / lambda, 6 * sweeps * U * 4);
            CHECK(fabs((double)x[0]) + fabs((double)x[2]) + fabs((double)x[3]) + fabs((double)x[5]) <= 0);
            /* low = high: damped Jacobi, 1 - (1 - lambda / high)^sweeps */
            peri_chebyshev3(&a, NULL, sweeps, 2, 2, b, x, work);
            NEAR(x[1], (1 - pow(1 - lambda / 2, sweeps)) / lambda, 6 * sweeps * U * 4);
        }
}

/* On a diagonally dominant lattice: the error shrinks in the norm of A as 1 / T_k says, the operator is symmetric and
   positive, and threads change no bit. */
static void chebyshev_lattice(void) {
    sparse m;
    peri_real *w, *exact, *b, *x, *y, *q, *e, *ae;
    double low = 2;
    int i, k, n, sweeps;
    lattice(&m, 12, 11, 5, 1, 1, 0, 2);
    n = 3 * m.n;
    w = (peri_real *)grab(9 * (size_t)n, sizeof *w);
    exact = w + 2 * n;
    b = exact + n;
    x = b + n;
    y = x + n;
    q = y + n;
    e = q + n;
    ae = e + n;
    for (i = 0; i < m.n; i++)
        if (2 / (double)m.diagonal[i] < low) low = 2 / (double)m.diagonal[i];
    for (i = 0; i < n; i++) {
        exact[i] = (peri_real)(1 + 0.5 * spread());
        q[i] = (peri_real)spread();
    }
    peri_matrix_multiply3(&m.a, NULL, exact, b);
    for (sweeps = 1; sweeps < 10; sweeps++) {
        double before = peri_dot(NULL, n, exact, b), after, shrink, pq, qp, size;
        peri_chebyshev3(&m.a, NULL, sweeps, low, 2, b, x, w);
        for (i = 0; i < n; i++) e[i] = exact[i] - x[i];
        peri_matrix_multiply3(&m.a, NULL, e, ae);
        after = peri_dot(NULL, n, e, ae);
        shrink = 1 / chebyshev_t(sweeps, (2 + low) / (2 - low));
        CHECK(sqrt(after / before) <= shrink + 100 * sweeps * U); /* rounding: a few u / low (0.06) for each sweep */
        peri_chebyshev3(&m.a, NULL, sweeps, low, 2, q, y, w);
        pq = peri_dot(NULL, n, b, y);
        qp = peri_dot(NULL, n, q, x);
        size = sqrt(peri_dot(NULL, n, b, b) * peri_dot(NULL, n, y, y));
        NEAR(pq, qp, 100 * sweeps * U * size);
        CHECK(peri_dot(NULL, n, q, y) > 0 && peri_dot(NULL, n, b, x) > 0);
        for (k = 0; k < WAYS; k++) {
            peri_chebyshev3(&m.a, way(k), sweeps, low, 2, b, e, w);
            CHECK(same_bits(e, x, n));
        }
    }
    free(w);
    sparse_end(&m);
}

/* ---- sparse Cholesky --------------------------------------------------------------------------------------------- */

/* The inverse of the n x n block on the diagonal from column c of a panel, as stored, is that of L. */
static void small_block(const peri_cholesky *f, const peri__panel *p, int c, int n, double l[PERI__TILE][PERI__TILE]) {
    double m[PERI__TILE][PERI__TILE];
    int i, j, k;
    for (i = 0; i < n; i++)
        for (j = 0; j < n; j++) {
            m[i][j] = (double)f->value[p->at + peri__entry(p, c + i, c + j)];
            if (j > i) CHECK(fabs(m[i][j]) <= 0);
        }
    for (j = 0; j < n; j++)
        for (i = 0; i < n; i++) {
            l[i][j] = i == j;
            for (k = j; k < i; k++) l[i][j] -= m[i][k] * l[k][j];
            l[i][j] = i < j ? 0 : l[i][j] / m[i][i];
        }
}

/* Column j of L: its rows and values; returns how many. Also *worst: the largest norm of |L| |L^-1| of a block on the
   diagonal, which says how many digits a solve loses by having its inverse. */
static int column(const peri_cholesky *f, int j, int *rows, double *value, double *worst) {
    const peri__panel *p = f->s->panel + peri__panel_of(f->s, j);
    int c = (j - p->first) / PERI__TILE * PERI__TILE, n = p->width - c < PERI__TILE ? p->width - c : PERI__TILE, i, k;
    double l[PERI__TILE][PERI__TILE];
    small_block(f, p, c, n, l);
    for (i = 0; i < n; i++) {
        double sum = 0;
        int m, q;
        for (m = 0; m <= i; m++)
            for (q = m; q <= i; q++)
                sum += fabs(l[i][q]) * fabs((double)f->value[p->at + peri__entry(p, c + q, c + m)]);
        if (worst && sum > *worst) *worst = sum;
    }
    for (i = 0, k = j - p->first; k < p->height; k++, i++) {
        rows[i] = f->s->rows[p->row + (size_t)k];
        value[i] = k < c + n ? l[k - c][j - p->first - c] : (double)f->value[p->at + peri__entry(p, k, j - p->first)];
    }
    return i;
}

/* Entries of L by elimination on a dense pattern. */
static size_t dense_fill(const peri_cholesky *f, const sparse *m) {
    int n = m->n, i, j, k, e;
    size_t sum = 0;
    char *on = (char *)grab((size_t)n * (size_t)n, 1);
    for (i = 0; i < n; i++)
        for (e = m->row[i]; e < m->row[i + 1]; e++) on[f->s->place[i] * n + f->s->place[m->col[e]]] = 1;
    for (j = 0; j < n; j++, sum++)
        for (i = j + 1; i < n; i++)
            for (sum += on[i * n + j] != 0, k = j + 1; k < i && on[i * n + j]; k++)
                if (on[k * n + j]) on[i * n + k] = on[k * n + i] = 1;
    free(on);
    return sum;
}

/* How L, as stored, differs from A: |L L^T - A| <= (n + 1) u |L| |L^T| (Higham, theorem 10.3), and |L| |L^T| <=
   sqrt(a_ii a_jj); where the inverse of a block stands for it, PERI__TILE u |L| |L^-1| more. n small: dense. */
static void check_factor(const peri_cholesky *f, const sparse *m) {
    int n = m->n, i, j, k, count, *rows = (int *)grab((size_t)n, sizeof *rows);
    double *l = (double *)grab((size_t)n * (size_t)n, sizeof *l), *a = (double *)grab((size_t)n * (size_t)n, sizeof *a);
    double *value = (double *)grab((size_t)n, sizeof *value), worst = 1;
    for (j = 0; j < n; j++) {
        count = column(f, j, rows, value, &worst);
        for (k = 0; k < count; k++) l[rows[k] * n + j] = value[k];
    }
    for (i = 0; i < n; i++) {
        int row = f->s->order[i];
        a[i * n + i] = (double)m->diagonal[row];
        for (k = m->row[row]; k < m->row[row + 1]; k++) a[i * n + f->s->place[m->col[k]]] = (double)m->value[k];
    }
    for (i = 0; i < n; i++)
        for (j = 0; j <= i; j++) {
            double sum = 0, tolerance = sqrt(a[i * n + i] * a[j * n + j]) * (n + 1 + PERI__TILE * worst) * U;
            for (k = 0; k <= j; k++) sum += l[i * n + k] * l[j * n + k];
            NEAR(sum, a[i * n + j], tolerance);
        }
    free(rows);
    free(value);
    free(l);
    free(a);
}

/* |b - A x| <= c u |L| |L^T| |x|, c = three times the longest row or column of L (Higham, theorem 10.4), by component,
   and again as much times |L| |L^-1| of the blocks on the diagonal, whose inverses are stored; x and b have `rhs` sides,
   n rows. */
static void check_residual(const peri_cholesky *f, const sparse *m, int rhs, const peri_real *x, const peri_real *b) {
    int n = m->n, i, j, k, c, q, count, longest = 4;
    double *t = (double *)grab((size_t)n, sizeof *t), *g = (double *)grab((size_t)n, sizeof *g);
    double *value = (double *)grab((size_t)n, sizeof *value), worst = 1;
    int *length = (int *)grab((size_t)n, sizeof *length), *rows = (int *)grab((size_t)n, sizeof *rows);
    for (c = 0; c < rhs; c++) {
        for (i = 0; i < n; i++) t[i] = g[i] = length[i] = 0;
        for (j = 0; j < n; j++) { /* t = |L^T| |x|, g = |L| t */
            count = column(f, j, rows, value, &worst);
            for (q = 0; q < count; q++) t[j] += fabs(value[q]) * fabs((double)x[rhs * f->s->order[rows[q]] + c]);
            for (q = 0; q < count; q++) g[rows[q]] += fabs(value[q]) * t[j];
            for (q = 0; q < count; q++) length[rows[q]]++;
            if (count > longest) longest = count;
        }
        for (i = 0; i < n; i++) longest = length[i] > longest ? length[i] : longest;
        for (i = 0; i < n; i++) {
            int row = f->s->order[i];
            double r = (double)b[rhs * row + c] - (double)m->diagonal[row] * (double)x[rhs * row + c];
            for (k = m->row[row]; k < m->row[row + 1]; k++)
                r -= (double)m->value[k] * (double)x[rhs * m->col[k] + c];
            NEAR(r, 0, 3 * longest * (1 + worst) * U * g[i]);
        }
    }
    free(rows);
    free(value);
    free(t);
    free(g);
    free(length);
}

static void check_cholesky(const sparse *m, int dense) {
    int n = m->n, which, rhs, i, rep, *seen = (int *)grab((size_t)n, sizeof *seen);
    size_t room = 5 * (size_t)n;
    peri_real *x = (peri_real *)grab(5 * room, sizeof *x), *b = x + room, *first = b + room, *work = first + room;
    for (which = 0; which < 2; which++) {
        peri_cholesky *f;
        peri_error err;
        CHECK(peri_cholesky_create(&m->a, which ? m->xyz : NULL, NULL, &f, &err) == PERI_OK && f);
        if (!f) continue;
        memset(seen, 0, (size_t)n * sizeof *seen);
        for (i = 0; i < n; i++) seen[f->s->order[i]]++;
        for (i = 0; i < n; i++) CHECK(seen[i] == 1);
        for (rep = 0; rep < 2; rep++) {
            CHECK(peri_cholesky_factor(f, &m->a, &err) == PERI_OK);
            if (dense) check_factor(f, m);
            if (n < 150) CHECK(peri_cholesky_entries(f) == dense_fill(f, m));
            for (rhs = 1; rhs <= 5; rhs++) {
                for (i = 0; i < rhs * n; i++) x[i] = b[i] = (peri_real)spread();
                peri_cholesky_solve(f, rhs, x, work);
                check_residual(f, m, rhs, x, b);
            }
        }
        memcpy(first, b, room * sizeof *b); /* factored anew, with whatever threads, the same bits */
        peri_cholesky_threads(f, way(which));
        CHECK(peri_cholesky_factor(f, &m->a, NULL) == PERI_OK);
        peri_cholesky_solve(f, 5, first, work);
        CHECK(same_bits(first, x, 5 * n));
        CHECK(peri_cholesky_entries(f) >= (size_t)n + (size_t)m->row[n] / 2);
        CHECK(peri_cholesky_bytes(f) >= peri_cholesky_entries(f) * sizeof(peri_real));
        peri_cholesky_destroy(f);
    }
    free(seen);
    free(x);
}

static void cholesky_lattices(void) {
    static const int box[10][6] = {{7, 7, 7, 1, 1, 0},  {7, 6, 8, 1, 1, 1}, {20, 20, 1, 1, 1, 1}, {20, 19, 1, 3, 1, 0},
                                   {60, 3, 3, 1, 1, 1}, {60, 3, 3, 2, 1, 0}, {4, 4, 4, 1, 4, 1},  {300, 1, 1, 1, 1, 1},
                                   {3, 1, 1, 0, 9, 0},  {6, 6, 6, 3, 1, 1}};
    int k;
    for (k = 0; k < 10; k++) {
        sparse m;
        lattice(&m, box[k][0], box[k][1], box[k][2], box[k][3], box[k][4], box[k][5], 0.05);
        check_cholesky(&m, m.n < 400);
        sparse_end(&m);
    }
}

static void cholesky_random(void) {
    static const int sizes[12] = {1, 2, 3, 4, 5, 6, 9, 17, 33, 60, 100, 130};
    int k, d, i, j;
    for (k = 0; k < 12; k++)
        for (d = 0; d < 4; d++) { /* from no bond to all bonds */
            int n = sizes[k];
            char *on = (char *)grab((size_t)n * (size_t)n, 1);
            sparse m;
            for (i = 0; i < n; i++)
                for (j = i + 1; j < n; j++) on[n * i + j] = chance() < (d == 1 ? 2.0 / n : d == 2 ? 0.2 : d / 3.0);
            from_dense(&m, n, on, 0.01);
            if (k % 2) /* all on one spot: dissection falls back on the numbering */
                for (i = 0; i < 3 * n; i++) m.xyz[i] = 1;
            check_cholesky(&m, 1);
            sparse_end(&m);
            free(on);
        }
}

/* A small, badly conditioned chain against its exact solution: for K = tridiag(-1, 2, -1), K x = e_i is piecewise
   linear, x_j = min(i, j) (n + 1 - max(i, j)) / (n + 1), counted from 1. Condition about (2 (n + 1) / pi)^2 = 680. */
static void cholesky_chain(void) {
    int n = 40, i, c, which;
    for (which = 0; which < 2; which++) {
        sparse m;
        peri_cholesky *f = NULL;
        peri_real x[120], work[240];
        sparse_begin(&m, n, 2 * n);
        for (i = 0; i < n; i++) {
            int k = m.row[i];
            if (i > 0) m.col[k++] = i - 1;
            if (i + 1 < n) m.col[k++] = i + 1;
            m.row[i + 1] = k;
            m.diagonal[i] = 2;
            m.xyz[3 * i] = (peri_real)i;
        }
        for (i = 0; i < m.row[n]; i++) m.value[i] = -1;
        for (i = 0; i < 3 * n; i++) x[i] = i == 0 || i == 3 * 20 + 1 || i == 3 * 39 + 2;
        CHECK(peri_cholesky_create(&m.a, which ? m.xyz : NULL, NULL, &f, NULL) == PERI_OK);
        CHECK(peri_cholesky_factor(f, &m.a, NULL) == PERI_OK);
        peri_cholesky_solve(f, 3, x, work);
        for (i = 1; i <= n; i++)
            for (c = 0; c < 3; c++) {
                int p = c == 0 ? 1 : c == 1 ? 21 : 40, low = i < p ? i : p, high = i < p ? p : i;
                NEAR(x[3 * (i - 1) + c], low * (n + 1 - high) / (n + 1.0), 680 * 10 * U * 10.5);
            }
        peri_cholesky_destroy(f);
        sparse_end(&m);
    }
}

static void cholesky_empty(void) {
    peri_matrix a;
    peri_cholesky *f = NULL;
    peri_error err;
    memset(&a, 0, sizeof a);
    CHECK(peri_cholesky_create(&a, NULL, NULL, &f, &err) == PERI_OK && f);
    CHECK(peri_cholesky_factor(f, &a, &err) == PERI_OK);
    peri_cholesky_solve(f, 3, NULL, NULL);
    CHECK(peri_cholesky_entries(f) == 0 && peri_cholesky_bytes(f) > 0);
    peri_cholesky_destroy(f);
    peri_cholesky_destroy(NULL);
    CHECK(peri_cholesky_entries(NULL) == 0 && peri_cholesky_bytes(NULL) == 0);
}

/* Minimum degree eliminates leaves first: no tree fills in, whatever its numbering. */
static void minimum_degree_trees(void) {
    int k, i, n = 500;
    for (k = 0; k < 6; k++) {
        char *on = (char *)grab((size_t)n * (size_t)n, 1);
        int *name = (int *)grab((size_t)n, sizeof *name);
        sparse m;
        peri_cholesky *f = NULL;
        for (i = 0; i < n; i++) name[i] = i;
        for (i = n - 1; i > 0; i--) {
            int j = (int)(chance() * (i + 1)), t = name[i];
            name[i] = name[j];
            name[j] = t;
        }
        for (i = 1; i < n; i++) { /* a star, a path, random trees */
            int up = name[k == 0 ? 0 : k == 1 ? i - 1 : (int)(chance() * i)], down = name[i];
            on[up < down ? n * up + down : n * down + up] = 1;
        }
        from_dense(&m, n, on, 1);
        CHECK(peri_cholesky_create(&m.a, NULL, NULL, &f, NULL) == PERI_OK);
        CHECK(peri_cholesky_entries(f) == (size_t)(2 * n - 1));
        peri_cholesky_destroy(f);
        sparse_end(&m);
        free(on);
        free(name);
    }
}

/* In lattice order (a band) a sheet of k x k has k^2 (k + 2) entries at most, a cube k^3 (k^2 + k + 2); by separators
   the sheet needs at most 31/4 k^2 log2 k^2 (George 1973), the cube some multiple of k^4. The numbers are shuffled, so
   that the order given is worth nothing. */
static void orderings_save_fill(void) {
    sparse m;
    peri_cholesky *f = NULL;
    int which;
    for (which = 0; which < 2; which++) {
        double n = 60 * 60;
        lattice(&m, 60, 60, 1, 1, 1, 1, 1);
        CHECK(peri_cholesky_create(&m.a, which ? m.xyz : NULL, NULL, &f, NULL) == PERI_OK);
        CHECK((double)peri_cholesky_entries(f) < n * (60 + 2));
        CHECK((double)peri_cholesky_entries(f) < 31.0 / 4 * n * log(n) / log(2.0));
        peri_cholesky_destroy(f);
        sparse_end(&m);
        n = 14 * 14 * 14;
        lattice(&m, 14, 14, 14, 1, 1, 1, 1);
        CHECK(peri_cholesky_create(&m.a, which ? m.xyz : NULL, NULL, &f, NULL) == PERI_OK);
        CHECK((double)peri_cholesky_entries(f) < n * (14 * 14 + 14 + 2));
        peri_cholesky_destroy(f);
        sparse_end(&m);
    }
}

/* -- matrices from triplets and columns, factors that follow changes -- */

/* The entries of m as triplets in a random order: one triangle (the other is there too, to be ignored, with rubbish) or
   both; some split into two that add up. Returns their number. */
static int triplets(const sparse *m, peri_triangle triangle, int *i, int *j, peri_real *value) {
    int row, k, half, count = 0;
    for (row = 0; row < m->n; row++) {
        i[count] = j[count] = row;
        value[count++] = m->diagonal[row] - 1;
        i[count] = j[count] = row;
        value[count++] = 1;
        for (k = m->row[row]; k < m->row[row + 1]; k++)
            for (half = 0; half < 2; half++) {
                int counts = triangle == PERI_TRIANGLE_BOTH || (triangle == PERI_TRIANGLE_LOWER) == (row > m->col[k]);
                i[count] = row;
                j[count] = m->col[k];
                value[count++] = counts ? m->value[k] / 2 : 99;
            }
    }
    for (k = count - 1; k > 0; k--) {
        int to = (int)(chance() * (k + 1)), t = i[k];
        peri_real v = value[k];
        i[k] = i[to];
        i[to] = t;
        t = j[k];
        j[k] = j[to];
        j[to] = t;
        value[k] = value[to];
        value[to] = v;
    }
    return count;
}

static void check_same_matrix(const peri_matrix *a, const sparse *m) {
    int k;
    CHECK(a->n == m->n && !memcmp(a->row, m->row, ((size_t)m->n + 1) * sizeof *a->row));
    CHECK(!memcmp(a->col, m->col, (size_t)m->row[m->n] * sizeof *a->col));
    for (k = 0; k < m->row[m->n]; k++) NEAR(a->value[k], m->value[k], 0);
    for (k = 0; k < m->n; k++) NEAR(a->diagonal[k], m->diagonal[k], 2 * U * fabs((double)m->diagonal[k]));
}

static void sparse_from_entries(void) {
    int which, rep;
    for (which = 0; which < 3; which++) {
        peri_triangle triangle = (peri_triangle)which;
        peri_sparse *s = NULL;
        peri_error err;
        sparse m;
        int count, room, k, *i, *j, *start, *row;
        peri_real *value, *sorted;
        lattice(&m, 5, 6, 4, 1, 1, 1, 1);
        room = 2 * (m.n + m.row[m.n]);
        i = (int *)grab(3 * (size_t)room + (size_t)m.n + 2, sizeof *i);
        j = i + room;
        row = j + room;
        start = row + room;
        value = (peri_real *)grab(2 * (size_t)room, sizeof *value);
        sorted = value + room;
        count = triplets(&m, triangle, i, j, value);
        CHECK(count == room);
        CHECK(peri_sparse_from_triplets(m.n, count, i, j, triangle, NULL, &s, &err) == PERI_OK && s);
        for (rep = 0; rep < 2; rep++) { /* values may be set again */
            CHECK(peri_sparse_set(s, value, &err) == PERI_OK);
            check_same_matrix(peri_sparse_matrix(s), &m);
        }
        peri_sparse_destroy(s);
        for (k = 0; k < count; k++) start[j[k] + 1]++; /* the same by columns */
        for (k = 0; k < m.n; k++) start[k + 1] += start[k];
        for (k = 0; k < count; k++) {
            row[start[j[k]]] = i[k];
            sorted[start[j[k]]++] = value[k];
        }
        for (k = m.n; k > 0; k--) start[k] = start[k - 1];
        start[0] = 0;
        CHECK(peri_sparse_from_columns(m.n, start, row, triangle, NULL, &s, &err) == PERI_OK && s);
        CHECK(peri_sparse_set(s, sorted, &err) == PERI_OK);
        check_same_matrix(peri_sparse_matrix(s), &m);
        peri_sparse_destroy(s);
        free(i);
        free(value);
        sparse_end(&m);
    }
}

static void refuse_entries(peri_result got, peri_result code, const peri_error *err, const char *words) {
    CHECK(got == code && err->code == code);
    if (strstr(err->text, words)) return;
    test_complain(__FILE__, __LINE__, words);
    test_complain(__FILE__, __LINE__, err->text);
}

static void sparse_errors(void) {
    int i[] = {0, 1, 1}, j[] = {0, 1, 0}, start[] = {0, 2, 3};
    peri_real value[] = {2, 2, -1}, both[] = {2, 2, -1, -2};
    int i2[] = {0, 1, 1, 0}, j2[] = {0, 1, 0, 1};
    peri_sparse *s = NULL;
    peri_error err;
    peri_result r;
    r = peri_sparse_from_triplets(2, 3, NULL, j, PERI_TRIANGLE_LOWER, NULL, &s, &err);
    refuse_entries(r, PERI_ERROR_ARGUMENT, &err, "i is NULL");
    r = peri_sparse_from_triplets(2, 3, i, j, PERI_TRIANGLE_LOWER, NULL, NULL, &err);
    refuse_entries(r, PERI_ERROR_ARGUMENT, &err, "out is NULL");
    r = peri_sparse_from_triplets(-1, 3, i, j, PERI_TRIANGLE_LOWER, NULL, &s, &err);
    refuse_entries(r, PERI_ERROR_INDEX, &err, "n is -1");
    r = peri_sparse_from_triplets(1, 3, i, j, PERI_TRIANGLE_LOWER, NULL, &s, &err);
    refuse_entries(r, PERI_ERROR_INDEX, &err, "entry 1 stands at (1, 1), outside 1 rows");
    r = peri_sparse_from_triplets(2, 3, i, j, PERI_TRIANGLE_BOTH, NULL, &s, &err);
    refuse_entries(r, PERI_ERROR_INDEX, &err, "there is none at (0, 1)");
    start[1] = 4;
    r = peri_sparse_from_columns(2, start, i, PERI_TRIANGLE_LOWER, NULL, &s, &err);
    refuse_entries(r, PERI_ERROR_INDEX, &err, "column 1 ends at 3, before it begins at 4");
    r = peri_sparse_from_columns(2, NULL, i, PERI_TRIANGLE_LOWER, NULL, &s, &err);
    refuse_entries(r, PERI_ERROR_ARGUMENT, &err, "start is NULL");
    CHECK(peri_sparse_from_triplets(2, 3, i, j, PERI_TRIANGLE_LOWER, NULL, &s, &err) == PERI_OK);
    CHECK(peri_sparse_set(s, value, &err) == PERI_OK);
    value[0] = (peri_real)HUGE_VAL;
    refuse_entries(peri_sparse_set(s, value, &err), PERI_ERROR_VALUE, &err, "entry 0 is not finite");
    NEAR(peri_sparse_matrix(s)->diagonal[0], 2, 0); /* the old values stay */
    refuse_entries(peri_sparse_set(s, NULL, &err), PERI_ERROR_ARGUMENT, &err, "value is NULL");
    peri_sparse_destroy(s);
    CHECK(peri_sparse_from_triplets(2, 4, i2, j2, PERI_TRIANGLE_BOTH, NULL, &s, &err) == PERI_OK);
    refuse_entries(peri_sparse_set(s, both, &err), PERI_ERROR_VALUE, &err, "must be symmetric");
    peri_sparse_destroy(s);
    CHECK(peri_sparse_from_triplets(0, 0, NULL, NULL, PERI_TRIANGLE_BOTH, NULL, &s, &err) == PERI_OK);
    CHECK(peri_sparse_set(s, NULL, &err) == PERI_OK && peri_sparse_matrix(s)->n == 0);
    peri_sparse_destroy(s);
    peri_sparse_destroy(NULL);
}

/* Factors big enough for parts: any number of threads, an update, or a factor that shares the analysis: the same bits as
   the whole made anew. */
static void cholesky_follows(void) {
    sparse m;
    peri_cholesky *f = NULL, *g = NULL;
    peri_real *x, *y, *b, *work;
    int k, n, rows[3], which;
    lattice(&m, 26, 10, 10, 1, 1, 1, 1);
    n = 3 * m.n;
    x = (peri_real *)grab(5 * (size_t)n, sizeof *x);
    y = x + n;
    b = y + n;
    work = b + n;
    CHECK(peri_cholesky_create(&m.a, m.xyz, NULL, &f, NULL) == PERI_OK);
    CHECK(f->s->begin[PERI__PARTS] > 0 && f->s->part[PERI__PARTS] < m.n); /* there are parts, and a top */
    CHECK(peri_cholesky_create_like(f, NULL, &g, NULL) == PERI_OK);
    for (which = 0; which < 4; which++) { /* other values in a few rows */
        rows[0] = (int)(chance() * m.n);
        rows[1] = rows[0];
        rows[2] = (int)(chance() * m.n);
        for (k = 0; k < 3 && which; k++) {
            int e = m.row[rows[k]], other = m.col[e], back = peri__find(m.row, m.col, other, rows[k]);
            m.value[e] = m.value[back] = m.value[e] * (peri_real)0.5;
            m.diagonal[rows[k]] += 1;
        }
        CHECK(peri_cholesky_update(f, &m.a, 3, rows, NULL) == PERI_OK); /* at first the whole */
        peri_cholesky_threads(g, way(which + 1));
        CHECK(peri_cholesky_factor(g, &m.a, NULL) == PERI_OK);
        for (k = 0; k < n; k++) x[k] = y[k] = b[k] = (peri_real)spread();
        peri_cholesky_solve(f, 3, x, work);
        peri_cholesky_solve(g, 3, y, work);
        CHECK(same_bits(x, y, n));
        if (!which) check_residual(f, &m, 3, x, b);
        CHECK(!memcmp(f->value, g->value, f->s->values * sizeof *f->value));
    }
    rows[0] = m.n;
    CHECK(peri_cholesky_update(f, &m.a, 1, rows, NULL) == PERI_ERROR_INDEX);
    m.diagonal[5] = -1; /* fails in a part, whichever thread is first; the other factor lives on */
    CHECK(peri_cholesky_factor(f, &m.a, NULL) == PERI_ERROR_PIVOT && peri_cholesky_pivot(f) >= 0);
    CHECK(peri_cholesky_factor(g, &m.a, NULL) == PERI_ERROR_PIVOT && peri_cholesky_pivot(g) == peri_cholesky_pivot(f));
    peri_cholesky_destroy(f);
    m.diagonal[5] = 100;
    CHECK(peri_cholesky_factor(g, &m.a, NULL) == PERI_OK && peri_cholesky_pivot(g) == -1);
    peri_cholesky_destroy(g);
    free(x);
    sparse_end(&m);
}

/* From a guess that knows 95 %: 1e-6 after one step, 1e-9 after two at condition 1e5 (as the design asks), in float; in
   double rounding at once. Every component of every right-hand side. */
static void cholesky_refines(void) {
    sparse m;
    peri_cholesky *f = NULL;
    double *x, *b, *exact, first, second;
    peri_real *work;
    int k, n, c, e;
    lattice(&m, 12, 12, 12, 1, 1, 1, 1);
    for (k = 0; k < m.n; k++) { /* a Laplacian and a mass: condition at most twice the largest diagonal over the mass */
        double sum = 26 * 2e-5;
        for (e = m.row[k]; e < m.row[k + 1]; e++) {
            m.value[e] = -(peri_real)fabs((double)m.value[e]);
            sum -= (double)m.value[e];
        }
        m.diagonal[k] = (peri_real)sum;
    }
    n = 5 * m.n;
    x = (double *)grab(3 * (size_t)n, sizeof *x);
    b = x + n;
    exact = b + n;
    work = (peri_real *)grab(11 * (size_t)m.n, sizeof *work);
    for (k = 0; k < n; k++) exact[k] = spread();
    for (k = 0; k < m.n; k++)
        for (c = 0; c < 5; c++) {
            b[5 * k + c] = (double)m.diagonal[k] * exact[5 * k + c];
            for (e = m.row[k]; e < m.row[k + 1]; e++) b[5 * k + c] += (double)m.value[e] * exact[5 * m.col[e] + c];
        }
    for (k = 0; k < n; k++) x[k] = 0.95 * exact[k];
    CHECK(peri_cholesky_create(&m.a, m.xyz, NULL, &f, NULL) == PERI_OK);
    CHECK(peri_cholesky_factor(f, &m.a, NULL) == PERI_OK);
    NEAR(peri_cholesky_refine(f, &m.a, 5, b, x, work), 0.05, 1e-6);
    first = peri_cholesky_refine(f, &m.a, 5, b, x, work);
    second = peri_cholesky_refine(f, &m.a, 5, b, x, work);
    CHECK(first <= 1e-6 && second <= 1e-9);
    for (k = 0; k < n; k++) NEAR(x[k], exact[k], 1e-9 * 1e5 * sqrt(n / 3.0)); /* residual, condition, |x| */
    peri_cholesky_destroy(f);
    free(x);
    free(work);
    sparse_end(&m);
}

static void refuse(const peri_matrix *a, peri_result code, const char *words) {
    peri_cholesky *f = (peri_cholesky *)1;
    peri_error err;
    CHECK(peri_cholesky_create(a, NULL, NULL, &f, &err) == code && err.code == code && f == NULL);
    if (!strstr(err.text, words)) {
        test_complain(__FILE__, __LINE__, words);
        test_complain(__FILE__, __LINE__, err.text);
    }
    CHECK(peri_cholesky_create(a, NULL, NULL, &f, NULL) == code);
}

static void bad_patterns(void) {
    int row[] = {0, 2, 4, 6}, col[] = {1, 2, 0, 2, 0, 1};
    peri_real value[] = {-1, -1, -1, -1, -1, -1}, diagonal[] = {3, 3, 3}, xyz[9] = {0};
    peri_matrix a;
    peri_cholesky *f;
    peri_error err;
    a.n = 3;
    a.row = row;
    a.col = col;
    a.value = value;
    a.diagonal = diagonal;
    CHECK(peri_cholesky_create(&a, NULL, NULL, NULL, &err) == PERI_ERROR_ARGUMENT && strstr(err.text, "out is NULL"));
    refuse(NULL, PERI_ERROR_ARGUMENT, "the matrix is NULL");
    col[3] = 3;
    refuse(&a, PERI_ERROR_INDEX, "row 1 stores column 3, outside [0, 3)");
    col[3] = -7;
    refuse(&a, PERI_ERROR_INDEX, "row 1 stores column -7, outside");
    col[3] = 1;
    refuse(&a, PERI_ERROR_INDEX, "row 1 stores its diagonal");
    col[2] = 2;
    col[3] = 0;
    refuse(&a, PERI_ERROR_INDEX, "row 1 stores column 0 after column 2");
    col[3] = 2;
    refuse(&a, PERI_ERROR_INDEX, "row 1 stores column 2 after column 2");
    col[2] = 0;
    row[2] = 3;
    row[3] = 5;
    col[3] = 0;
    col[4] = 1;
    refuse(&a, PERI_ERROR_INDEX, "row 2 stores column 1, but row 1 does not store column 2");
    row[2] = 1;
    refuse(&a, PERI_ERROR_INDEX, "row 1 ends at 1, before it begins at 2");
    row[0] = 1;
    refuse(&a, PERI_ERROR_INDEX, "row[0] is 1");
    a.n = -4;
    refuse(&a, PERI_ERROR_INDEX, "n is -4");
    a.n = 3;
    a.row = NULL;
    refuse(&a, PERI_ERROR_ARGUMENT, "row is NULL");
    a.row = row;
    row[0] = 0;
    row[2] = 4;
    row[3] = 6;
    a.col = NULL;
    refuse(&a, PERI_ERROR_ARGUMENT, "col is NULL");
    a.col = col;
    col[3] = 2;
    col[4] = 0;
    col[5] = 1;
    xyz[7] = (peri_real)peri__from_bits(PERI__NAN);
    CHECK(peri_cholesky_create(&a, xyz, NULL, &f, &err) == PERI_ERROR_VALUE && !f);
    CHECK(strstr(err.text, "coordinate y of row 2") != NULL);
    xyz[7] = 0;
    CHECK(peri_cholesky_create(&a, xyz, NULL, &f, &err) == PERI_OK && f);
    CHECK(peri_cholesky_factor(NULL, &a, &err) == PERI_ERROR_ARGUMENT && strstr(err.text, "the factor is NULL"));
    CHECK(peri_cholesky_factor(f, NULL, &err) == PERI_ERROR_ARGUMENT && strstr(err.text, "the matrix is NULL"));
    a.value = NULL;
    CHECK(peri_cholesky_factor(f, &a, &err) == PERI_ERROR_ARGUMENT && strstr(err.text, "no value"));
    a.value = value;
    a.n = 2;
    CHECK(peri_cholesky_factor(f, &a, &err) == PERI_ERROR_ARGUMENT && strstr(err.text, "another pattern"));
    a.n = 3;
    row[1] = 1; /* the same columns, other rows */
    CHECK(peri_cholesky_factor(f, &a, &err) == PERI_ERROR_ARGUMENT && strstr(err.text, "another pattern"));
    row[1] = 2;
    CHECK(peri_cholesky_factor(f, &a, &err) == PERI_OK && err.code == PERI_OK);
    peri_cholesky_destroy(f);
}

static void refuse_values(peri_cholesky *f, const peri_matrix *a, const char *words) {
    peri_error err;
    CHECK(peri_cholesky_factor(f, a, &err) == PERI_ERROR_PIVOT && err.code == PERI_ERROR_PIVOT);
    if (!strstr(err.text, words)) {
        test_complain(__FILE__, __LINE__, words);
        test_complain(__FILE__, __LINE__, err.text);
    }
    CHECK(peri_cholesky_factor(f, a, NULL) == PERI_ERROR_PIVOT);
}

static void bad_pivots(void) {
    sparse m;
    int i, k, which, row = 77;
    char words[80];
    peri_real *x, *b, *work;
    for (which = 0; which < 2; which++) {
        peri_cholesky *f = NULL;
        peri_real keep;
        lattice(&m, 6, 5, 4, 1, 1, 1, 1);
        x = (peri_real *)grab(12 * (size_t)m.n, sizeof *x);
        b = x + 3 * m.n;
        work = b + 3 * m.n;
        CHECK(peri_cholesky_create(&m.a, which ? m.xyz : NULL, NULL, &f, NULL) == PERI_OK);
        sprintf(words, "pivot of row %d is ", row);
        keep = m.diagonal[row];
        m.diagonal[row] = -100;
        refuse_values(f, &m.a, words);
        m.diagonal[row] = 0;
        refuse_values(f, &m.a, words);
        m.diagonal[row] = (peri_real)peri__from_bits(PERI__NAN);
        refuse_values(f, &m.a, words);
        m.diagonal[row] = (peri_real)HUGE_VAL;
        refuse_values(f, &m.a, words);
        m.diagonal[row] = keep;
        for (k = 0; k < 3; k++) { /* one bond, both ways, not finite or too strong: the later of the two rows fails */
            int e = m.row[row] + 2, other = m.col[e], late = f->s->place[other] > f->s->place[row] ? other : row;
            peri_real bad = k == 0 ? (peri_real)peri__from_bits(PERI__NAN) : k == 1 ? (peri_real)HUGE_VAL : 1000;
            peri_real old = m.value[e];
            for (i = m.row[other]; m.col[i] != row; i++) {}
            m.value[e] = m.value[i] = bad;
            sprintf(words, "pivot of row %d is ", late);
            if (k == 2) refuse_values(f, &m.a, words);
            if (k < 2) refuse_values(f, &m.a, "not positive definite"); /* fill may spoil an earlier row */
            m.value[e] = m.value[i] = old;
        }
        CHECK(peri_cholesky_factor(f, &m.a, NULL) == PERI_OK); /* none of this stays */
        for (i = 0; i < 3 * m.n; i++) x[i] = b[i] = (peri_real)spread();
        peri_cholesky_solve(f, 3, x, work);
        check_residual(f, &m, 3, x, b);
        peri_cholesky_destroy(f);
        free(x);
        sparse_end(&m);
    }
}

/* realloc that counts, checks old_bytes and fails when its turn has come. */
typedef struct counter {
    int calls, fail_at, wrong;
    size_t live;
} counter;

static void *count_resize(void *ptr, size_t old_bytes, size_t new_bytes, void *user) {
    counter *c = (counter *)user;
    double *head = ptr ? (double *)ptr - 2 : NULL; /* two doubles before each block hold its size */
    if (head && memcmp(head, &old_bytes, sizeof old_bytes) != 0) c->wrong++;
    if (!head && old_bytes) c->wrong++;
    if (new_bytes && c->calls++ == c->fail_at) return NULL;
    c->live = c->live - old_bytes + new_bytes;
    if (!new_bytes) {
        free(head);
        return NULL;
    }
    head = (double *)realloc(head, new_bytes + 16);
    if (!head) exit(2);
    memcpy(head, &new_bytes, sizeof new_bytes);
    return head + 2;
}

static void memory(void) {
    sparse m;
    int which;
    lattice(&m, 5, 5, 5, 1, 1, 1, 1);
    for (which = 0; which < 2; which++) {
        counter c;
        peri_allocator hook;
        peri_cholesky *f = NULL;
        peri_error err;
        peri_result result = PERI_ERROR_MEMORY;
        int n, calls;
        hook.resize = count_resize;
        hook.user = &c;
        memset(&c, 0, sizeof c);
        for (n = 0; n < 100 && result != PERI_OK; n++) {
            c.calls = 0;
            c.fail_at = n;
            result = peri_cholesky_create(&m.a, which ? m.xyz : NULL, &hook, &f, &err);
            if (result == PERI_OK) break;
            CHECK(result == PERI_ERROR_MEMORY && err.code == result && strstr(err.text, "no memory") && !f);
            CHECK(c.live == 0);
        }
        CHECK(result == PERI_OK && n >= 4 && n < 20);
        CHECK(c.live == peri_cholesky_bytes(f));
        calls = c.calls;
        CHECK(peri_cholesky_factor(f, &m.a, &err) == PERI_OK && c.calls == calls);
        peri_cholesky_destroy(f);
        CHECK(c.live == 0 && c.wrong == 0);
    }
    sparse_end(&m);
}

/* Rows tied at random have no small separators, least of all by positions that mean nothing: half of them are the first,
   and L is dense there. What passes 32 bits is refused by the analysis, which keeps nothing. */
static void factor_limit(void) {
    enum { N = 120000, TIES = 3 };
    int *i = (int *)grab(TIES * N, sizeof *i), *j = (int *)grab(TIES * N, sizeof *j), k;
    peri_real *xyz = (peri_real *)grab(3 * N, sizeof *xyz);
    double entries = 0, operations;
    size_t count = 7;
    peri_sparse *m = NULL;
    peri_cholesky *f = (peri_cholesky *)1;
    peri_allocator hook;
    peri_error err;
    counter c;
    for (k = 0; k < TIES * N; k++) {
        int one = k / TIES, other = (int)(chance() * N);
        i[k] = one > other ? one : other;
        j[k] = one > other ? other : one;
    }
    for (k = 0; k < N; k++) xyz[3 * k] = (peri_real)chance();
    CHECK(peri_sparse_from_triplets(N, TIES * N, i, j, PERI_TRIANGLE_LOWER, NULL, &m, &err) == PERI_OK);
    hook.resize = count_resize;
    hook.user = &c;
    memset(&c, 0, sizeof c);
    c.fail_at = -1;
    CHECK(peri_cholesky_create(peri_sparse_matrix(m), xyz, &hook, &f, &err) == PERI_ERROR_LIMIT && !f);
    CHECK(err.code == PERI_ERROR_LIMIT && strstr(err.text, "above 2^31; use peri_solve_cg with"));
    CHECK(sscanf(err.text, "cholesky: the factor of 120000 rows would have %lf entries", &entries) == 1);
    printf("    entries: %.2f of 2^31\n", entries / 2147483648.0);
    CHECK(entries > 2147483647.0 && entries < 0.5 * N * (N + 1.0));
    CHECK(c.calls > 2 && c.live == 0 && c.wrong == 0);
    CHECK(peri_cholesky_estimate(peri_sparse_matrix(m), xyz, &hook, &count, &operations, NULL) == PERI_ERROR_LIMIT);
    CHECK(count == 7 && c.live == 0 && c.wrong == 0);
    peri_sparse_destroy(m);
    free(i);
    free(j);
    free(xyz);
}

static void helpers(void) {
    size_t product;
    peri_error err;
    CHECK(peri__mul_size(6, 7, &product) == 1 && product == 42);
    CHECK(peri__mul_size(0, (size_t)-1, &product) == 1 && product == 0);
    CHECK(peri__mul_size((size_t)-1, 2, &product) == 0 && peri__mul_size((size_t)-1 / 2 + 1, 2, &product) == 0);
    CHECK(peri__mul_size((size_t)-1 / 2, 2, &product) == 1);
    CHECK(peri__finite(0) && peri__finite(DBL_MAX) && !peri__finite(-HUGE_VAL));
    CHECK(!peri__finite(peri__from_bits(PERI__NAN)));
    CHECK(peri__fail(NULL, PERI_ERROR_ID, "x") == PERI_ERROR_ID);
    CHECK(peri__fail(&err, PERI_ERROR_ID, "%d %0300d", 5, 1) == PERI_ERROR_ID);
    CHECK(err.code == PERI_ERROR_ID && strlen(err.text) == sizeof err.text - 1);
}

/* ---- L-BFGS ------------------------------------------------------------------------------------------------------ */

/* context: the diagonal of P^-1, after its length. */
typedef struct scaling {
    int n;
    const peri_real *inverse;
} scaling;

static void scale(const peri_real *g, peri_real *p, void *context) {
    const scaling *s = (const scaling *)context;
    int i;
    for (i = 0; i < s->n; i++) p[i] = s->inverse[i] * g[i];
}

enum { SMALL = 6 };

/* H = (I - rho s y^T) H (I - rho y s^T) + rho s s^T */
static void dense_bfgs(double h[SMALL][SMALL], const peri_real *s, const peri_real *y) {
    double v[SMALL][SMALL], t[SMALL][SMALL], rho = 0;
    int i, j, k;
    for (i = 0; i < SMALL; i++) rho += (double)s[i] * (double)y[i];
    rho = 1 / rho;
    for (i = 0; i < SMALL; i++)
        for (j = 0; j < SMALL; j++) v[i][j] = (i == j) - rho * (double)s[i] * (double)y[j];
    for (i = 0; i < SMALL; i++)
        for (j = 0; j < SMALL; j++)
            for (t[i][j] = 0, k = 0; k < SMALL; k++) t[i][j] += v[i][k] * h[k][j];
    for (i = 0; i < SMALL; i++)
        for (j = 0; j < SMALL; j++)
            for (h[i][j] = rho * (double)s[i] * (double)s[j], k = 0; k < SMALL; k++) h[i][j] += t[i][k] * v[j][k];
}

/* y = B s with B's condition 4: s and y meet at a cosine of at least 0.8, so a pair amplifies rounding by at most
   (1 + 1/0.8)^2 = 5, and four of them by 700. */
static void lbfgs_is_bfgs(void) {
    int m, pushed, i, j, k;
    for (m = 0; m <= 4; m++)
        for (pushed = 0; pushed < 8; pushed++) {
            peri_real s[8][SMALL], y[8][SMALL], g[SMALL], p[SMALL], q[SMALL], work[SMALL], inverse[SMALL];
            peri_real vectors[2 * 4 * SMALL];
            double h[SMALL][SMALL], size = 0;
            peri_lbfgs l;
            scaling context;
            peri_lbfgs_begin(&l, SMALL, m, vectors);
            for (i = 0; i < SMALL; i++) {
                inverse[i] = (peri_real)(0.5 + chance());
                g[i] = (peri_real)spread();
                for (j = 0; j < SMALL; j++) h[i][j] = i == j ? (double)inverse[i] : 0;
                size += fabs((double)g[i]);
            }
            context.n = SMALL;
            context.inverse = inverse;
            for (k = 0; k < pushed; k++) {
                for (i = 0; i < SMALL; i++) {
                    s[k][i] = (peri_real)spread();
                    y[k][i] = (peri_real)((1 + 3.0 * i / (SMALL - 1)) * (double)s[k][i]);
                }
                peri_lbfgs_push(&l, NULL, s[k], y[k]);
            }
            CHECK(l.used == (pushed < m ? pushed : m));
            for (k = pushed > m ? pushed - m : 0; k < pushed; k++) dense_bfgs(h, s[k], y[k]);
            peri_lbfgs_apply(&l, NULL, g, p, work, scale, &context);
            for (i = 0; i < SMALL; i++) {
                double wanted = 0;
                for (j = 0; j < SMALL; j++) wanted -= h[i][j] * (double)g[j];
                NEAR(p[i], wanted, 700 * 8 * U * size);
            }
            if (m > 0 && pushed > 0) { /* the secant equation: H y = s for the newest pair */
                peri_lbfgs_apply(&l, NULL, y[pushed - 1], q, work, scale, &context);
                for (i = 0; i < SMALL; i++) NEAR(q[i], -s[pushed - 1][i], 700 * 8 * U * 4);
            }
            if (m == 0) {
                for (i = 0; i < SMALL; i++) NEAR(p[i], -inverse[i] * g[i], 2 * U);
                peri_lbfgs_apply(&l, NULL, g, p, work, NULL, NULL);
                for (i = 0; i < SMALL; i++) NEAR(p[i], -g[i], 0);
            }
        }
}

static void lbfgs_refuses(void) {
    peri_real s[3] = {1, 2, 3}, y[3] = {1, 1, 1}, vectors[12];
    peri_lbfgs l;
    peri_lbfgs_begin(&l, 3, 2, vectors);
    y[2] = -1; /* s.y = 0 */
    peri_lbfgs_push(&l, NULL, s, y);
    y[2] = -5;
    peri_lbfgs_push(&l, NULL, s, y);
    y[2] = (peri_real)peri__from_bits(PERI__NAN);
    peri_lbfgs_push(&l, NULL, s, y);
    y[2] = (peri_real)HUGE_VAL;
    peri_lbfgs_push(&l, NULL, s, y);
    y[0] = y[1] = y[2] = 0;
    peri_lbfgs_push(&l, NULL, s, y);
#ifdef PERI_DOUBLE
    s[2] = y[2] = 1e-155; /* 1 / s.y overflows */
    s[0] = s[1] = 0;
    peri_lbfgs_push(&l, NULL, s, y);
#endif
    CHECK(l.used == 0);
    s[0] = 1;
    s[1] = 2;
    s[2] = 3;
    y[2] = 1;
    peri_lbfgs_push(&l, NULL, s, y);
    CHECK(l.used == 1);
    NEAR(l.rho[0], 1.0 / 3, EPS);
    peri_lbfgs_begin(&l, 3, 0, NULL);
    peri_lbfgs_push(&l, NULL, s, y);
    CHECK(l.used == 0);
}

/* Steps with exact line search until |g| has shrunk 1000 times, on x.A x / 2 - b.x; bits of x over all ways agree. */
static int minimise(const sparse *m, const peri_parallel *par, int memory_length, peri_real *x) {
    int n = 3 * m->n, i, k;
    peri_real *w = (peri_real *)grab(25 * (size_t)n, sizeof *w);
    peri_real *g = w + 16 * n, *p = g + n, *ap = p + n, *work = ap + n, *inverse = work + n;
    double begin;
    peri_lbfgs l;
    scaling context;
    peri_lbfgs_begin(&l, n, memory_length, w);
    context.n = n;
    context.inverse = inverse;
    for (i = 0; i < n; i++) {
        inverse[i] = 1 / m->diagonal[i / 3];
        x[i] = 0;
        g[i] = (peri_real)((i * 37 % 101) / -101.0);
    }
    begin = peri_dot(par, n, g, g);
    for (k = 0; k < 2000 && peri_dot(par, n, g, g) > 1e-6 * begin; k++) {
        double step;
        peri_lbfgs_apply(&l, par, g, p, work, scale, &context);
        peri_matrix_multiply3(&m->a, par, p, ap);
        step = -peri_dot(par, n, g, p) / peri_dot(par, n, p, ap);
        for (i = 0; i < n; i++) {
            p[i] = (peri_real)(step * (double)p[i]);
            ap[i] = (peri_real)(step * (double)ap[i]);
            x[i] += p[i];
            g[i] += ap[i];
        }
        peri_lbfgs_push(&l, par, p, ap);
    }
    free(w);
    return k;
}

/* With exact line searches steepest descent needs about condition / 4 ln(...) steps and BFGS those of conjugate
   gradients (Nazareth 1979), about its root: here conditions near 500. */
static void lbfgs_minimises(void) {
    sparse m;
    peri_real *x, *y;
    int plain, one, five, k;
    lattice(&m, 30, 20, 1, 1, 1, 0, 0.02);
    x = (peri_real *)grab(6 * (size_t)m.n, sizeof *x);
    y = x + 3 * m.n;
    plain = minimise(&m, NULL, 0, x);
    one = minimise(&m, NULL, 1, x);
    five = minimise(&m, NULL, 5, x);
    CHECK(five < 2000 && 3 * five < plain && one < plain);
    for (k = 0; k < WAYS; k++) {
        CHECK(minimise(&m, way(k), 5, y) == five);
        CHECK(same_bits(x, y, 3 * m.n));
    }
    free(x);
    sparse_end(&m);
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(quick_start);
    RUN(logarithm);
    RUN(exponential);
    RUN(determinant_adjugate_product);
    RUN(eigenvalues);
    RUN(singular_values);
    RUN(polar);
    RUN(inverse6);
    RUN(parallel_for);
    RUN(dot);
    RUN(multiply);
    RUN(chebyshev_polynomial);
    RUN(chebyshev_lattice);
    RUN(cholesky_lattices);
    RUN(cholesky_random);
    RUN(cholesky_chain);
    RUN(cholesky_empty);
    RUN(sparse_from_entries);
    RUN(sparse_errors);
    RUN(cholesky_follows);
    RUN(cholesky_refines);
    RUN(minimum_degree_trees);
    RUN(orderings_save_fill);
    RUN(bad_patterns);
    RUN(bad_pivots);
    RUN(memory);
    RUN(factor_limit);
    RUN(helpers);
    RUN(lbfgs_is_bfgs);
    RUN(lbfgs_refuses);
    RUN(lbfgs_minimises);
    return test_end();
}
