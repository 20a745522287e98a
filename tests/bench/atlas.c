/* tests/bench/atlas.c - the stability atlas: where each model and solver, and each of the methods that one would take
   instead (tests/baseline), is right, wrong or lost. The maps, what happens in a cell and how right is measured are in
   tests/stability.h. Every cell is judged against finite elements or an exact solution, ours and the others' by the
   same rule; solver "own" is a baseline's.

   Writes CSV (map,method,solver,x,y,cell,error,iterations,ms) to the first argument and prints, for every map and
   method, one letter a cell (g green, y yellow, R red), x along a word, a word for each y. error: see tests/stability.h
   (inf: lost); iterations: mean of a step; ms: processor time of the cell's steps, one thread. Rows of map "elements"
   say how far the finite elements are from a mesh of half their size in the first and the last cell of a map; their
   cell is green below 2 %. Second argument: quick (about two minutes) or full (about ten). Third: one
   map only. Drawn by atlas.gp. */
#define PERI_IMPLEMENTATION
#include "../../peri.h"
#include "../stability.h"
#include "bench.h"

enum { MOST = 12 };

typedef struct axis {
    int count;
    double at[MOST];
} axis;

static const axis quick_x[MAPS] = {
    {5, {1e4, 1e5, 1e6, 1e7, 1e8}}, {5, {0, 0.25, 0.4, 0.49, 0.499}}, {5, {0.5, 0.7, 1, 1.5, 2.2}},
    {4, {1e-2, 1, 100, 1e4}}, {4, {1, 10, 100, 1e3}}, {5, {1, 2, 3, 4, 5}}, {4, {1, 2, 3, 4}},
    {5, {0, 0.2, 0.4, 0.6, 0.8}}};
static const axis quick_y[MAPS] = {
    {4, {1. / 240, 1. / 30, 0.1, 1}}, {2, {1. / 240, 1. / 30}}, {3, {0.5, 0.7, 1}}, {2, {1. / 240, 1. / 30}},
    {2, {1. / 60, 0.1}}, {2, {1. / 240, 1. / 30}}, {4, {1, 2, 3, 4}}, {4, {1.01, 1.45, 1.75, 3.01}}};
static const axis full_x[MAPS] = {
    {7, {1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9}}, {7, {-0.5, 0, 0.25, 0.4, 0.45, 0.49, 0.499}},
    {9, {0.35, 0.5, 0.6, 0.7, 0.85, 1, 1.5, 2, 2.4}}, {7, {1e-4, 1e-2, 1, 10, 100, 1e3, 1e4}},
    {5, {1, 10, 100, 1e3, 1e4}}, {5, {1, 2, 3, 4, 5}}, {4, {1, 2, 3, 4}}, {5, {0, 0.2, 0.4, 0.6, 0.8}}};
static const axis full_y[MAPS] = {
    {7, {1. / 1000, 1. / 240, 1. / 60, 1. / 30, 0.1, 1, 10}}, {4, {1. / 240, 1. / 60, 1. / 30, 0.1}},
    {5, {0.35, 0.5, 0.6, 0.7, 1}}, {4, {1. / 240, 1. / 60, 1. / 30, 0.1}}, {3, {1. / 60, 1. / 30, 0.1}},
    {7, {1. / 1000, 1. / 240, 1. / 60, 1. / 30, 0.1, 1, 10}}, {4, {1, 2, 3, 4}}, {5, {1.01, 1.45, 1.75, 2.1, 3.01}}};

/* What is judged: each model with each solver, then the baselines. Cholesky is what AUTO takes in bodies so small.
   quick: each model under AUTO, in five maps neo-Hookean under all. full: neo-Hookean under all in every map, the
   others under the slow solvers in four or five. */
enum { SOLVERS = 5, SUBJECTS = MODELS * SOLVERS + BASELINE_METHODS };
static const peri_solver solvers[SOLVERS] = {PERI_SOLVER_AUTO, PERI_SOLVER_TWO_LEVEL, PERI_SOLVER_JACOBI,
                                             PERI_SOLVER_CHEBYSHEV, PERI_SOLVER_POSITION};

static int method_of(int q) {
    return q < MODELS * SOLVERS ? q / SOLVERS : MODELS + q - MODELS * SOLVERS;
}
static peri_solver solver_of(int q) {
    return q < MODELS * SOLVERS ? solvers[q % SOLVERS] : PERI_SOLVER_AUTO;
}
static const char *solver_text(int q) {
    return q < MODELS * SOLVERS ? solver_name[solver_of(q)] : "own";
}

static int takes_part(map m, int q, int full) {
    int method = method_of(q);
    if (!map_takes(m, method)) return 0;
    if (method >= MODELS || q % SOLVERS == 0) return 1;
    if (method == NEO_HOOKEAN) return full || (m != MAP_MASS && m != MAP_SECTION && m != MAP_REMOVED);
    return full && (q % SOLVERS == 1 || m == MAP_MODULUS || m == MAP_POISSON || m == MAP_COLLAPSE || m == MAP_CONTACT ||
                    (m == MAP_STRETCH && method == PROJECTIVE));
}

static void write_row(FILE *csv, map m, const char *method, const char *solver, double x, double y, const cell *c) {
    const char *colour = c->colour == 'g' ? "green" : c->colour == 'y' ? "yellow" : "red";
    if (!csv) return;
    fprintf(csv, "%s,%s,%s,%.12g,%.12g,%s,", map_name[m], method, solver, x, y, colour);
    if (c->error < HUGE_VAL) fprintf(csv, "%.4g,", c->error); else fprintf(csv, "inf,");
    fprintf(csv, "%.4g,%.4g\n", c->iterations, c->ms);
}

/* How far the reference is from one of half its mesh size, measured as a method is. */
static void check_elements(FILE *csv, map m, double x, double y) {
    plan p = plan_of(m, x, y);
    guide coarse, fine;
    subject s;
    cell c;
    int i;
    guide_begin(&coarse, &p, FEM_NEO_HOOKEAN, 0);
    guide_begin(&fine, &p, FEM_NEO_HOOKEAN, 1);
    memset(&c, 0, sizeof c);
    subject_begin(&s, &p, NEO_HOOKEAN, PERI_SOLVER_AUTO); /* its points only */
    for (s.weight = 1, i = 0; i < s.count; i++) fem_at(coarse.mean, &coarse.f, s.rest + 3 * i, s.mean + 3 * i);
    c.error = coarse.bad || fine.bad ? HUGE_VAL : field_error(&s, &fine);
    c.colour = c.error < 0.02 ? 'g' : c.error < HUGE_VAL ? 'y' : 'r';
    printf("%-10s %-39s at %g, %g: %.2g from a mesh twice as fine%s\n", map_name[m], "elements", x, y, c.error,
           coarse.bad || fine.bad ? " (NO SOLUTION)" : "");
    if (csv) {
        fprintf(csv, "elements,%s,own,%.12g,%.12g,%s,%.4g,0,0\n", map_name[m], x, y,
                c.colour == 'g' ? "green" : c.colour == 'y' ? "yellow" : "red", c.error);
    }
    subject_end(&s);
    guide_end(&coarse);
    guide_end(&fine);
}

/* One map: letters[subject][y][x] as they come. */
static void draw_map(FILE *csv, map m, const axis *ax, const axis *ay, int full) {
    static char letters[SUBJECTS][MOST][MOST];
    double begin = bench_cpu(), ms[SUBJECTS] = {0};
    int ix, iy, q;
    for (iy = 0; iy < ay->count; iy++)
        for (ix = 0; ix < ax->count; ix++) {
            guide g[2];
            guides_begin(g, m, ax->at[ix], ay->at[iy]);
            if (map_guided(m) && g[0].bad)
                printf("%s at %g, %g: the finite elements have no solution; the cell is left out\n", map_name[m],
                       ax->at[ix], ay->at[iy]);
            for (q = 0; q < SUBJECTS; q++) {
                cell c;
                letters[q][iy][ix] = '.';
                if (!takes_part(m, q, full) || (map_guided(m) && g[0].bad)) continue;
                c = map_cell(m, ax->at[ix], ay->at[iy], method_of(q), solver_of(q), g);
                letters[q][iy][ix] = (char)(c.colour == 'r' ? 'R' : c.colour);
                ms[q] += c.ms;
                write_row(csv, m, method_name(method_of(q)), solver_text(q), ax->at[ix], ay->at[iy], &c);
            }
            guides_end(g);
        }
    for (q = 0; q < SUBJECTS; q++) {
        if (!takes_part(m, q, full)) continue;
        printf("%-10s %-28s %-10s", map_name[m], method_name(method_of(q)), solver_text(q));
        for (iy = 0; iy < ay->count; iy++) printf(" %.*s", ax->count, letters[q][iy]);
        printf("  %.0f ms\n", ms[q]);
    }
    printf("%-10s took %.1f s\n", map_name[m], (bench_cpu() - begin) / 1e3);
    if (map_guided(m)) {
        check_elements(csv, m, ax->at[0], ay->at[0]);
        check_elements(csv, m, ax->at[ax->count - 1], ay->at[ay->count - 1]);
    }
    printf("\n");
    fflush(stdout);
}

int main(int argc, char **argv) {
    FILE *csv = bench_csv(argc, argv, "map,method,solver,x,y,cell,error,iterations,ms");
    int full = bench_full(argc, argv), m;
    for (m = 0; m < MAPS; m++) {
        if (argc > 3 && strcmp(argv[3], map_name[m]) != 0) continue;
        draw_map(csv, (map)m, full ? &full_x[m] : &quick_x[m], full ? &full_y[m] : &quick_y[m],
                 full);
    }
    if (csv) fclose(csv);
    return 0;
}
