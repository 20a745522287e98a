/* tests/bench/convergence.c - residual over time, after figure 7 of the projective paper: a beam of 61 x 22 x 22 =
   29 524 particles of the projective model, one end held, gravity switched on at rest, h = 1/30 s, E = 1e5 Pa.

   Two problems, both from the first step of that beam:
   "step"    the whole local/global iteration (the paper's): the step is made from the same start with max_iterations 2,
             4, 8, ..., by the world's global steps: direct, Jacobi, Jacobi + Chebyshev (12 sweeps), position-based
             averaging, as the paper has them (no memory, matrix scale 1), and the library's own, direct under L-BFGS.
             residual: |gradient| / (particle's weight sqrt n); error: rms distance to the converged step (direct under
             L-BFGS, 400 iterations), over the rms motion. ms: the step without factorisation. A step that is cut off
             with more energy than it began with is begun anew from rest; caps so low that nothing comes of that (error
             above 0.9) are left out.
   "linear"  one global step A x = b, A the world's matrix, b the weight, x = 0 at first: the solvers of peri_solver.h,
             each iteration as it goes. residual: |b - A x| / |b|. ms: with the estimate of the spectrum, without
             factorisations, which are printed beside; direct: iteration 1 is the solve, 2 refined once.
   Writes CSV (problem,solver,iteration,ms,residual,error) to the first argument and prints a table. ms is processor
   time, one thread. Second argument full: that beam; quick: 31 x 11 x 11. */
#define PERI_IMPLEMENTATION
#include "../../peri.h"
#include "bench.h"

typedef struct bench {
    FILE *csv;
    int along, across, n;
    double weight; /* of a particle, N */
    double *reference, *start;
} bench;

static void row(bench *b, const char *problem, const char *solver, int iteration, double ms, double residual,
                double error) {
    if (!b->csv) return;
    fprintf(b->csv, "%s,%s,%d,%.4g,%.4g,", problem, solver, iteration, ms, residual);
    if (error >= 0) fprintf(b->csv, "%.4g", error);
    fprintf(b->csv, "\n");
}

/* The beam at rest; the world is the caller's to destroy. */
static peri_world *beam(bench *b, const peri_world_def *wd, peri_body_id *id) {
    peri_world *world = peri_world_create(wd, NULL);
    peri_material m = peri_material_projective(1e5f, 0.5f, 1000);
    peri_body_def bd = peri_default_body_def();
    int i, j, k, c = 0, n = b->along * b->across * b->across;
    peri_real *points = (peri_real *)bench_zeros(3 * (size_t)n, sizeof *points);
    unsigned char *fixed = (unsigned char *)bench_zeros((size_t)n, 1);
    bd.spacing = (peri_real)(0.98 / b->along);
    for (k = 0; k < b->across; k++)
        for (j = 0; j < b->across; j++)
            for (i = 0; i < b->along; i++, c++) {
                points[3 * c] = (peri_real)(i + 0.5) * bd.spacing;
                points[3 * c + 1] = (peri_real)(j + 0.5) * bd.spacing;
                points[3 * c + 2] = (peri_real)(k + 0.5) * bd.spacing;
                fixed[c] = i == 0;
            }
    bd.points = points;
    bd.fixed = fixed;
    bd.count = b->n = n;
    bd.material = peri_material_create(world, &m);
    *id = peri_body_create(world, &bd);
    b->weight = 9.81 * 1000 * pow((double)bd.spacing, 3);
    free(points);
    free(fixed);
    if (!id->index1) exit(2);
    return world;
}

/* ---- the whole step ---------------------------------------------------------------------------------------------- */

typedef struct variant {
    const char *name;
    peri_solver solver;
    int lbfgs;
    double scale;
} variant;

/* rms distance to the reference over rms motion; keeps the positions as the reference when asked. */
static double distance(bench *b, const peri_real *x, int keep) {
    double away = 0, moved = 0;
    int k;
    for (k = 0; k < 3 * b->n; k++) {
        double to = (double)x[k];
        if (keep) b->reference[k] = to;
        away += (to - b->reference[k]) * (to - b->reference[k]);
        moved += (b->reference[k] - b->start[k]) * (b->reference[k] - b->start[k]);
    }
    return sqrt(away / moved);
}

static void step(bench *b, const variant *v, int most, int reference) {
    peri_world_def wd = peri_default_world_def();
    peri_world *world;
    peri_body_id id;
    peri_stats q;
    const peri_real *x;
    double error;
    int k;
    wd.solver = v->solver;
    wd.lbfgs = v->lbfgs;
    wd.matrix_scale = (peri_real)v->scale;
    wd.max_iterations = most;
    wd.tolerance = (peri_real)1e-6;
    world = beam(b, &wd, &id);
    if (!b->reference) {
        b->reference = (double *)bench_zeros(3 * (size_t)b->n, sizeof(double));
        b->start = (double *)bench_zeros(3 * (size_t)b->n, sizeof(double));
    }
    for (x = peri_body_positions(world, id), k = 0; k < 3 * b->n; k++) b->start[k] = (double)x[k];
    if (peri_world_step(world, (peri_real)(1.0 / 30))) {
        printf("%s: %s\n", v->name, peri_last_error(world)->text);
        exit(1);
    }
    q = peri_world_stats(world);
    error = distance(b, peri_body_positions(world, id), reference);
    if (!reference && error < 0.9) {
        double ms = q.profile.total - q.profile.factor, residual = (double)q.residual / b->weight;
        row(b, "step", v->name, q.iterations, ms, residual, error);
        printf("%-8s %-18s %9d %10.1f %10.2e %10.2e\n", "step", v->name, q.iterations, ms, residual, error);
        fflush(stdout);
    }
    peri_world_destroy(world);
}

/* ---- one global step --------------------------------------------------------------------------------------------- */

typedef struct watcher {
    bench *b;
    const char *name;
    double start;
    double at[3]; /* ms to a residual of 1e-1, 1e-2, 1e-3 */
    const peri_matrix *a;
    const peri_real *right;
} watcher;

static void watch(int iteration, double residual, void *user) {
    watcher *w = (watcher *)user;
    double ms = bench_cpu() - w->start;
    int k;
    for (k = 0; k < 3; k++)
        if (w->at[k] < 0 && residual <= pow(10, -1 - k)) w->at[k] = ms;
    row(w->b, "linear", w->name, iteration, ms, residual, -1);
}

static void watch_from(watcher *w, const char *name) {
    w->name = name;
    w->at[0] = w->at[1] = w->at[2] = -1;
    w->start = bench_cpu();
}

static void told(const watcher *w, const peri_report *r) {
    int k;
    printf("%-8s %-18s %9d %10.1f %10.2e   ", "linear", w->name, r->iterations, bench_cpu() - w->start, r->residual);
    for (k = 0; k < 3; k++)
        if (w->at[k] < 0) printf("        -"); else printf(" %8.1f", w->at[k]);
    printf("\n");
    fflush(stdout);
}

static int gradient(const peri_real *x, peri_real *g, double *energy, void *context) {
    watcher *w = (watcher *)context;
    int k;
    (void)energy;
    peri_matrix_multiply3(w->a, NULL, x, g);
    for (k = 0; k < 3 * w->a->n; k++) g[k] -= w->right[k];
    return 1;
}

static void diagonal(const peri_real *g, peri_real *p, void *context) {
    peri_jacobi3(((watcher *)context)->a, NULL, g, p);
}

static void direct(watcher *w, const peri_matrix *a, peri_real *x, peri_real *work, const peri_real *xyz) {
    peri_cholesky *f = NULL;
    peri_real *r = work, *y = r + 3 * (size_t)a->n;
    double begin = bench_cpu(), size = sqrt(peri_dot(NULL, 3 * a->n, w->right, w->right));
    peri_report report;
    int pass, k;
    if (peri_cholesky_create(a, xyz, NULL, &f, NULL) || peri_cholesky_factor(f, a, NULL)) exit(2);
    printf("%-8s factorisation: %.1f ms\n", "linear", bench_cpu() - begin);
    memset(x, 0, 3 * (size_t)a->n * sizeof *x);
    memset(&report, 0, sizeof report);
    watch_from(w, "direct");
    for (pass = 0; pass < 3; pass++) {
        gradient(x, r, NULL, w);
        report.residual = sqrt(peri_dot(NULL, 3 * a->n, r, r)) / size;
        if (pass) watch(pass, report.residual, w);
        if (pass == 2) break;
        peri_cholesky_solve(f, 3, r, y);
        for (k = 0; k < 3 * a->n; k++) x[k] -= r[k];
        report.iterations++;
    }
    told(w, &report);
    peri_cholesky_destroy(f);
}

/* All iterate to 1e-4, Jacobi to its cap. */
static void iterate(watcher *w, const peri_matrix *a, peri_real *x, peri_real *work) {
    static const char *const names[5] = {"jacobi", "jacobi+chebyshev", "cg+jacobi", "cg+ic(0)", "l-bfgs+jacobi"};
    size_t bytes = 3 * (size_t)a->n * sizeof *x;
    int k;
    for (k = 0; k < 5; k++) {
        peri_iteration o = peri_default_iteration();
        peri_report report;
        peri_error err;
        peri_incomplete *f = NULL;
        peri_objective q;
        double begin;
        o.watch = watch;
        o.user = w;
        o.max_iterations = 2000;
        memset(x, 0, bytes);
        if (k == 3) {
            begin = bench_cpu();
            if (peri_incomplete_create(a, 3, NULL, &f, &err) || peri_incomplete_factor(f, a, &err)) exit(2);
            printf("%-8s incomplete factorisation: %.1f ms\n", "linear", bench_cpu() - begin);
            o.precondition = peri_incomplete_apply;
            o.context = f;
        }
        watch_from(w, names[k]);
        if (k == 0) peri_solve_jacobi(a, 3, w->right, x, work, &o, &report, &err);
        if (k == 1) peri_solve_chebyshev(a, 3, w->right, x, work, &o, &report, &err);
        if (k == 2 || k == 3) peri_solve_cg(a, 3, w->right, x, work, &o, &report, &err);
        if (k == 4) {
            q.n = 3 * a->n;
            q.gradient = gradient;
            q.context = w;
            q.memory = 5;
            q.search = peri_default_search();
            o.precondition = diagonal;
            o.context = w;
            o.tolerance = 1e-7; /* m */
            peri_minimise(&q, x, work, &o, &report, &err);
        }
        told(w, &report);
        peri_incomplete_destroy(f);
    }
}

static void linear(bench *b) {
    peri_world_def wd = peri_default_world_def();
    peri_world *world;
    peri_body_id id;
    peri_matrix a;
    watcher w;
    size_t n;
    peri_real *x, *right, *work;
    int k;
    wd.solver = PERI_SOLVER_CHOLESKY;
    wd.max_iterations = 1;
    world = beam(b, &wd, &id);
    peri_world_step(world, (peri_real)(1.0 / 30)); /* makes the matrix */
    a = peri__matrix(peri__body_at(world, (int)id.index1 - 1));
    n = 3 * (size_t)a.n;
    x = (peri_real *)bench_zeros(n, sizeof *x);
    right = (peri_real *)bench_zeros(n, sizeof *x);
    work = (peri_real *)bench_zeros(peri_minimise_work((int)n, 5), sizeof *x);
    for (k = 0; k < a.n; k++) right[3 * k + 2] = (peri_real)(k % b->along ? -b->weight : 0);
    memset(&w, 0, sizeof w);
    w.b = b;
    w.a = &a;
    w.right = right;
    printf("\n%-8s %-18s %9s %10s %10s    ms to 1e-1    1e-2     1e-3\n", "problem", "solver", "iteration", "ms",
           "residual");
    direct(&w, &a, x, work, peri_body_positions(world, id));
    iterate(&w, &a, x, work);
    free(x);
    free(right);
    free(work);
    peri_world_destroy(world);
}

int main(int argc, char **argv) {
    static const variant variants[5] = {{"direct", PERI_SOLVER_CHOLESKY, 0, 1},
                                        {"jacobi", PERI_SOLVER_JACOBI, 0, 1},
                                        {"jacobi+chebyshev", PERI_SOLVER_CHEBYSHEV, 0, 1},
                                        {"position-based", PERI_SOLVER_POSITION, 0, 1},
                                        {"direct+l-bfgs", PERI_SOLVER_CHOLESKY, 5, 0.6}};
    int quick = !bench_full(argc, argv), v, most;
    bench b;
    memset(&b, 0, sizeof b);
    b.csv = bench_csv(argc, argv, "problem,solver,iteration,ms,residual,error");
    b.along = quick ? 31 : 61;
    b.across = quick ? 11 : 22;
    printf("%-8s %-18s %9s %10s %10s %10s\n", "problem", "solver", "iteration", "ms", "residual", "error");
    step(&b, &variants[4], 400, 1);
    for (v = 0; v < 5; v++)
        for (most = 2; most <= (v == 4 ? 32 : v == 0 ? 128 : 256); most *= 2) step(&b, &variants[v], most, 0);
    linear(&b);
    if (b.csv) fclose(b.csv);
    free(b.reference);
    free(b.start);
    return 0;
}
