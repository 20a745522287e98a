/* tests/test_stability.c - where other methods are lost and ours is not: every cell of the stability atlas's quick grid
   (stability.h says what happens in a cell and when it is green, yellow or red) that is red for one of the methods of
   tests/baseline. Both are run there: the baseline must be red, and ours, correspondence neo-Hookean under AUTO as they
   come, must be what is recorded or better; where ours is recorded red, nothing is claimed, and the cell is counted.
   Ours is run in all other cells, too.

   The record is stability_cells.h: what build/bench/atlas printed (its head says how to renew it). Cells where ours has
   become better are printed. The yardstick is tested first: the finite elements against CalculiX and FEniCS, and that a
   body of a wrong modulus or Poisson's ratio is not called right. */
#define PERI_IMPLEMENTATION
#include "../peri.h"
#include "stability.h"
#include "test.h"

/* ---- the yardstick ----------------------------------------------------------------------------------------------- */

/* Displacement of the end of the cantilever of test_accuracy.c, 1 x 0.2 x 0.2 m, E 1e5 Pa, 1000 kg/m^3. */
static void elements_bend(double poisson, double g, double tip[3]) {
    static const int elements[3] = {8, 2, 2};
    static const double size[3] = {1, 0.2, 0.2}, end[3] = {1, 0.1, 0.1};
    double gravity[3] = {0, 0, 0};
    fem f;
    int i, load;
    fem_begin(&f, elements, size, FEM_NEO_HOOKEAN, 1e5, poisson);
    for (i = 0; i < f.nodes; i++) f.held[i] = f.rest[3 * i] < 1e-9;
    for (load = 1; load <= 4; load++) {
        gravity[2] = -g * load / 4;
        memset(f.mass, 0, (size_t)f.nodes * (size_t)(f.band + 1) * sizeof *f.mass);
        fem_mass(&f, 1000, 1000, gravity);
        CHECK(fem_step(&f, 0) == 0);
    }
    fem_at(f.x, &f, end, tip);
    for (i = 0; i < 3; i++) tip[i] -= end[i];
    fem_end(&f);
}

/* References as in test_accuracy.c. 2 %: a fifth of what the atlas calls right. */
static void elements_against_others(void) {
    static const double nu[3] = {0, 0.25, 0.4}, small[3] = {-0.0193458, -0.01925507, -0.01893276};
    double tip[3];
    int k;
    for (k = 0; k < 3; k++) {
        elements_bend(nu[k], 0.05, tip);
        printf("    nu %.2f: tip over CalculiX %.4f\n", nu[k], tip[2] / small[k]);
        NEAR(tip[2] / small[k], 1, 0.02);
    }
    elements_bend(0.25, 2.4525, tip);
    printf("    large: over FEniCS %.4f, %.4f\n", tip[0] / -0.2595843, tip[2] / -0.6490298);
    NEAR(tip[0] / -0.2595843, 1, 0.02);
    NEAR(tip[2] / -0.6490298, 1, 0.02);
}

/* A step of the elements is one of backward Euler: a bar let fly keeps its momentum, and gravity adds g dt. */
static void elements_move(void) {
    static const int elements[3] = {3, 1, 1};
    static const double size[3] = {0.3, 0.1, 0.1}, gravity[3] = {0, 0, -9.81};
    double *momentum, sum[3] = {0}, mass = 0;
    fem f;
    int i, k;
    fem_begin(&f, elements, size, FEM_NEO_HOOKEAN, 1e5, 0.25);
    fem_mass(&f, 1000, 1000, gravity);
    momentum = fem_room(3 * (size_t)f.nodes);
    for (i = 0; i < f.nodes; i++) f.x[3 * i] *= 1.1;
    for (k = 0; k < 10; k++) CHECK(fem_step(&f, 0.01) == 0);
    fem_times_mass(&f, f.v, momentum);
    for (i = 0; i < 3 * f.nodes; i++) sum[i % 3] += momentum[i];
    for (i = 0; i < 3 * f.nodes; i++) f.v[i] = 1;
    fem_times_mass(&f, f.v, momentum);
    for (i = 0; i < f.nodes; i++) mass += momentum[3 * i];
    NEAR(mass, 3, 1e-9);
    NEAR(sum[0], 0, 1e-4);
    NEAR(sum[2], -9.81 * 0.1 * mass, 1e-4);
    free(momentum);
    fem_end(&f);
}

static cell ours(map m, double x, double y, const guide *g) {
    return map_cell(m, x, y, NEO_HOOKEAN, PERI_SOLVER_AUTO, g);
}

/* References of another material: what is right for 1e5 Pa is wrong for 1.3e5, and 0.1 is not 0.3. */
static void wrong_is_seen(void) {
    plan p = plan_of(MAP_MODULUS, 1e5, 0.1), q = plan_of(MAP_POISSON, 0.1, 0.1);
    guide g[2], h[2];
    memset(g, 0, sizeof g);
    memset(h, 0, sizeof h);
    p.young *= 1.3;
    q.poisson = 0.3;
    guide_begin(&g[0], &p, FEM_NEO_HOOKEAN, 0);
    guide_begin(&h[0], &q, FEM_NEO_HOOKEAN, 0);
    CHECK(ours(MAP_MODULUS, 1e5, 0.1, g).colour == 'y');
    CHECK(ours(MAP_POISSON, 0.1, 0.1, h).colour != 'g');
    guides_end(g);
    guides_end(h);
}

/* ---- the cells --------------------------------------------------------------------------------------------------- */

/* One line a map and method; a word for each y, a letter for each x. */
typedef struct record {
    const char *map, *method, *letters;
} record;
static const record records[] = {
#include "stability_cells.h"
};

static const char *letters_of(map m, int method) {
    const grid *g = &quick_grid[m];
    size_t k, length = (size_t)(g->y.count * (g->x.count + 1) - 1);
    for (k = 0; k < sizeof records / sizeof *records; k++) {
        const record *r = &records[k];
        if (strcmp(r->map, map_name[m]) != 0 || strcmp(r->method, method_name(method)) != 0) continue;
        if (strlen(r->letters) == length) return r->letters;
    }
    printf("    %s, %s: not recorded, or for another grid\n", map_name[m], method_name(method));
    exit(1);
}

static int is_red(char letter) { return letter == 'R' || letter == 'r'; }
static int rank(char letter) { return letter == 'g' ? 0 : letter == 'y' ? 1 : 2; }

static int cells_lost = 0, cells_right = 0, cells_wrong = 0, cells_shared = 0;

/* One cell of ours, beside each method that is recorded red there. */
static void survive(map m, double x, double y, int at) {
    char recorded = letters_of(m, NEO_HOOKEAN)[at];
    int method, better;
    cell mine, theirs;
    guide g[2];
    guides_begin(g, m, x, y);
    mine = ours(m, x, y, g);
    better = rank(recorded) - rank(mine.colour);
    if (better)
        printf("    %s %g, %.4g: ours %c %.3g, recorded %c\n", map_name[m], x, y, mine.colour, mine.error, recorded);
    CHECK(better >= 0);
    for (method = MODELS; method < METHODS && m != MAP_CONTACT; method++) {
        if (!is_red(letters_of(m, method)[at])) continue;
        cells_shared += is_red(mine.colour);
        if (is_red(mine.colour)) continue;
        theirs = map_cell(m, x, y, method, PERI_SOLVER_AUTO, g);
        if (!is_red(theirs.colour))
            printf("    %s %g, %.4g: %s %c %.3g, recorded R\n", map_name[m], x, y, method_name(method), theirs.colour,
                   theirs.error);
        CHECK(is_red(theirs.colour));
        cells_lost++;
        if (mine.colour == 'g') cells_right++; else cells_wrong++;
    }
    guides_end(g);
}

static void walk(map m) {
    const grid *g = &quick_grid[m];
    int before = cells_lost, right = cells_right, ix, iy;
    for (iy = 0; iy < g->y.count; iy++)
        for (ix = 0; ix < g->x.count; ix++) survive(m, g->x.at[ix], g->y.at[iy], iy * (g->x.count + 1) + ix);
    printf("    %s: %d red cells of baselines, ours green in %d; ours alone in all %d\n", map_name[m],
           cells_lost - before, cells_right - right, g->x.count * g->y.count);
}

static void modulus(void) { walk(MAP_MODULUS); }
static void poisson(void) { walk(MAP_POISSON); }
static void stretch(void) { walk(MAP_STRETCH); }
static void mass(void) { walk(MAP_MASS); }
static void contact(void) { walk(MAP_CONTACT); }
static void collapsed(void) { walk(MAP_COLLAPSE); }
static void section(void) { walk(MAP_SECTION); }
static void removed(void) { walk(MAP_REMOVED); }

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(elements_against_others);
    RUN(elements_move);
    RUN(wrong_is_seen);
    RUN(modulus);
    RUN(poisson);
    RUN(stretch);
    RUN(mass);
    RUN(contact);
    RUN(collapsed);
    RUN(section);
    RUN(removed);
    printf("    %d red cells of baselines: ours green in %d, yellow in %d; red in %d more\n", cells_lost, cells_right,
           cells_wrong, cells_shared);
    return test_end();
}
