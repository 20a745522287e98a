/* tests/bench/atlas.c - the stability atlas: where each model and solver, and each of the methods that one would take
   instead (tests/baseline), is right, wrong or lost. The maps, what happens in a cell and how right is measured are in
   tests/stability.h. Every cell is judged against finite elements or an exact solution, ours and the others' by the
   same rule; solver "own" is a baseline's.

   Writes CSV (map,method,solver,x,y,cell,error,iterations,ms) to the first argument and prints, for every map and
   method, one letter a cell (g green, y yellow, R red, - no part in it, for the reason below), x along a word, a word
   for each y. error: see tests/stability.h (inf: lost); iterations: mean of a step; ms: processor time of the cell's
   steps, one thread. Rows of map "elements" say how far the finite elements are from a mesh of half their size in the
   first and the last cell of a map; their cell is green below 2 %. Second argument: quick (about two minutes) or full
   (about ten). Third: one map only, or all. Fourth: ours, for neo-Hookean under AUTO only. Drawn by atlas.gp.

   quick ends with the table that tests/test_stability.c reads; after a change of results on purpose
       build/bench/atlas build/bench/atlas.csv quick | grep '^    {' > tests/stability_cells.h */
#define PERI_IMPLEMENTATION
#include "../../peri.h"
#include "../stability.h"
#include "bench.h"

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

typedef struct run {
    FILE *csv;
    int full, ours; /* ours: neo-Hookean under AUTO only */
    char letters[MAPS][SUBJECTS][AXIS_MOST][AXIS_MOST + 1];
} run;

static int wanted(const char *only, int m) { return !only || strcmp(only, map_name[m]) == 0; }

static int takes_part(const run *r, map m, int q) {
    int method = method_of(q), full = r->full;
    if (r->ours) return q == 0;
    if (method >= MODELS && m == MAP_CONTACT) return 0; /* none has a part: no rows of nothing */
    if (method >= MODELS || q % SOLVERS == 0) return 1;
    if (method == NEO_HOOKEAN) return full || (m != MAP_MASS && m != MAP_SECTION && m != MAP_REMOVED);
    return full && (q % SOLVERS == 1 || m == MAP_MODULUS || m == MAP_POISSON || m == MAP_COLLAPSE || m == MAP_CONTACT ||
                    (m == MAP_STRETCH && method == PROJECTIVE));
}

static void write_row(FILE *csv, map m, const char *method, const char *solver, double x, double y, const cell *c) {
    const char *colour = c->colour == 'g' ? "green" : c->colour == 'y' ? "yellow" : c->colour == '-' ? "none" : "red";
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

/* A word of letters for each y. */
static void print_words(const run *r, map m, int q, const grid *g) {
    int iy;
    for (iy = 0; iy < g->y.count; iy++) printf("%s%s", iy ? " " : "", r->letters[m][q][iy]);
}

/* Who has no part in a map or some of its rows, and why. */
static void print_absent(map m, const grid *g) {
    const char *last = NULL;
    int method, iy;
    for (method = 0; method < METHODS; method++) {
        const char *why = NULL;
        for (iy = 0; iy < g->y.count && !why; iy++) why = cell_without(m, g->y.at[iy], method);
        if (last && why && strcmp(why, last) == 0) printf(", %s", method_name(method));
        else {
            if (last) printf(": %s\n", last);
            if (why) printf("%-10s - %s", map_name[m], method_name(method));
        }
        last = why;
    }
    if (last) printf(": %s\n", last);
}

/* One cell, of every method. */
static void draw_cell(run *r, map m, const grid *grids, int ix, int iy, double ms[SUBJECTS]) {
    double x = grids->x.at[ix], y = grids->y.at[iy];
    guide g[2];
    cell none, c;
    int q;
    memset(&none, 0, sizeof none);
    none.colour = '-';
    none.error = HUGE_VAL;
    guides_begin(g, m, x, y);
    if (map_guided(m) && g[0].bad)
        printf("%s at %g, %g: the finite elements have no solution; the cell is left out\n", map_name[m], x, y);
    for (q = 0; q < SUBJECTS; q++) {
        if (!takes_part(r, m, q)) continue;
        c = none;
        if (!cell_without(m, y, method_of(q)) && !(map_guided(m) && g[0].bad))
            c = map_cell(m, x, y, method_of(q), solver_of(q), g);
        r->letters[m][q][iy][ix] = (char)(c.colour == 'r' ? 'R' : c.colour);
        ms[q] += c.ms;
        write_row(r->csv, m, method_name(method_of(q)), solver_text(q), x, y, &c);
    }
    guides_end(g);
}

static void draw_map(run *r, map m, const grid *g) {
    double begin = bench_cpu(), ms[SUBJECTS] = {0};
    int ix, iy, q;
    for (iy = 0; iy < g->y.count; iy++)
        for (ix = 0; ix < g->x.count; ix++) draw_cell(r, m, g, ix, iy, ms);
    for (q = 0; q < SUBJECTS; q++) {
        if (!takes_part(r, m, q)) continue;
        printf("%-10s %-28s %-10s ", map_name[m], method_name(method_of(q)), solver_text(q));
        print_words(r, m, q, g);
        printf("  %.0f ms\n", ms[q]);
    }
    print_absent(m, g);
    printf("%-10s took %.1f s\n", map_name[m], (bench_cpu() - begin) / 1e3);
    if (map_guided(m)) {
        check_elements(r->csv, m, g->x.at[0], g->y.at[0]);
        check_elements(r->csv, m, g->x.at[g->x.count - 1], g->y.at[g->y.count - 1]);
    }
    printf("\n");
    fflush(stdout);
}

/* The table that the test has (tests/stability_cells.h). */
static void print_table(const run *r, const char *only) {
    int m, q;
    printf("Recorded for tests/test_stability.c in tests/stability_cells.h:\n");
    for (m = 0; m < MAPS; m++)
        for (q = 0; q < SUBJECTS; q++) {
            if (!wanted(only, m) || (q && q < MODELS * SOLVERS)) continue;
            if (!takes_part(r, (map)m, q)) continue;
            printf("    {\"%s\", \"%s\", \"", map_name[m], method_name(method_of(q)));
            print_words(r, (map)m, q, &quick_grid[m]);
            printf("\"},\n");
        }
}

int main(int argc, char **argv) {
    static run r;
    const char *only = argc > 3 && strcmp(argv[3], "all") != 0 ? argv[3] : NULL;
    int m;
    r.csv = bench_csv(argc, argv, "map,method,solver,x,y,cell,error,iterations,ms");
    r.full = bench_full(argc, argv);
    r.ours = argc > 4 && strcmp(argv[4], "ours") == 0;
    for (m = 0; m < MAPS; m++)
        if (wanted(only, m)) draw_map(&r, (map)m, r.full ? &full_grid[m] : &quick_grid[m]);
    if (!r.full) print_table(&r, only);
    if (r.csv) fclose(r.csv);
    return 0;
}
