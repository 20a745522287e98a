/* tests/test_stability.c - where other methods are lost and ours is right: cells of the stability atlas (stability.h
   says what happens in them, and when a cell is green or red; build/bench/atlas draws them all). Each test is one map
   and one of the methods of tests/baseline: in every cell of its list the baseline must be red and ours (correspondence
   neo-Hookean, solver AUTO, as they come) green. A cell that nothing fails on is in no list: it is not hard enough.

   The lists are red cells of the atlas that ours survives, at most three of a map and method,
   the quickest. The yardstick is tested first: the finite elements against CalculiX and FEniCS, and that a body of a
   wrong modulus or Poisson's ratio is not called right. */
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

typedef struct hard {
    map m;
    baseline_method method;
    double x, y;
} hard;

static const hard cells[] = {
    {MAP_MODULUS, BASELINE_EXPLICIT, 1e+06, 1},
    {MAP_MODULUS, BASELINE_EXPLICIT, 1e+07, 1},
    {MAP_MODULUS, BASELINE_EXPLICIT, 1e+08, 1. / 10},
    {MAP_MODULUS, BASELINE_SHAPE, 1e+06, 1},
    {MAP_MODULUS, BASELINE_SHAPE, 1e+07, 1},
    {MAP_MODULUS, BASELINE_SHAPE, 1e+08, 1. / 10},
    {MAP_MODULUS, BASELINE_XPBD, 1e+06, 1},
    {MAP_MODULUS, BASELINE_XPBD, 1e+07, 1. / 10},
    {MAP_MODULUS, BASELINE_XPBD, 1e+08, 1. / 30},
    {MAP_POISSON, BASELINE_EXPLICIT, 0, 1. / 30},
    {MAP_POISSON, BASELINE_EXPLICIT, 0.25, 1. / 10},
    {MAP_POISSON, BASELINE_EXPLICIT, 0.4, 1. / 10},
    {MAP_POISSON, BASELINE_SHAPE, 0, 1. / 30},
    {MAP_POISSON, BASELINE_SHAPE, 0.25, 1. / 10},
    {MAP_POISSON, BASELINE_SHAPE, 0.4, 1. / 10},
    {MAP_MASS, BASELINE_EXPLICIT, 1, 1. / 240},
    {MAP_MASS, BASELINE_EXPLICIT, 100, 1. / 240},
    {MAP_MASS, BASELINE_EXPLICIT, 10000, 1. / 240},
    {MAP_MASS, BASELINE_SHAPE, 1, 1. / 30},
    {MAP_MASS, BASELINE_SHAPE, 100, 1. / 240},
    {MAP_MASS, BASELINE_SHAPE, 10000, 1. / 240},
    {MAP_MASS, BASELINE_XPBD, 100, 1. / 30},
    {MAP_MASS, BASELINE_XPBD, 10000, 1. / 30},
    {MAP_COLLAPSE, BASELINE_EXPLICIT, 1, 1},
    {MAP_COLLAPSE, BASELINE_EXPLICIT, 2, 1},
    {MAP_COLLAPSE, BASELINE_EXPLICIT, 3, 1. / 240},
    {MAP_COLLAPSE, BASELINE_SPRINGS, 1, 1. / 240},
    {MAP_COLLAPSE, BASELINE_SPRINGS, 2, 1. / 240},
    {MAP_COLLAPSE, BASELINE_SPRINGS, 3, 1. / 30},
    {MAP_COLLAPSE, BASELINE_MLS, 2, 1. / 30},
    {MAP_COLLAPSE, BASELINE_MLS, 3, 1. / 30},
    {MAP_COLLAPSE, BASELINE_MLS, 5, 1. / 240},
    {MAP_COLLAPSE, BASELINE_STVK, 2, 1. / 240},
    {MAP_COLLAPSE, BASELINE_STVK, 3, 1. / 30},
    {MAP_COLLAPSE, BASELINE_STVK, 4, 1. / 30},
    {MAP_COLLAPSE, BASELINE_XPBD, 1, 1. / 30},
    {MAP_COLLAPSE, BASELINE_XPBD, 2, 1. / 30},
    {MAP_COLLAPSE, BASELINE_XPBD, 3, 1. / 30},
    {MAP_SECTION, BASELINE_MLS, 1, 1},
    {MAP_SECTION, BASELINE_MLS, 1, 2},
    {MAP_SECTION, BASELINE_MLS, 2, 1},
    {MAP_SECTION, BASELINE_SHAPE, 1, 1},
    {MAP_SECTION, BASELINE_SHAPE, 1, 2},
    {MAP_SECTION, BASELINE_SHAPE, 2, 1}
};

static void survive(map m, baseline_method method) {
    size_t k, count = 0;
    for (k = 0; k < sizeof cells / sizeof *cells; k++) {
        const hard *h = &cells[k];
        guide g[2];
        cell theirs, mine;
        if (h->m != m || h->method != method) continue;
        guides_begin(g, m, h->x, h->y);
        theirs = map_cell(m, h->x, h->y, MODELS + (int)method, PERI_SOLVER_AUTO, g);
        mine = ours(m, h->x, h->y, g);
        printf("    %s %g, %.4g: %s %c %.3g, ours %c %.3g\n", map_name[m], h->x, h->y, baseline_name(method),
               theirs.colour, theirs.error, mine.colour, mine.error);
        CHECK(theirs.colour == 'r');
        CHECK(mine.colour == 'g');
        guides_end(g);
        count++;
    }
    CHECK(count > 0);
}

#define LOST(map, method, MAP, METHOD) \
    static void map##_##method(void) { survive(MAP, METHOD); }
LOST(modulus, explicit, MAP_MODULUS, BASELINE_EXPLICIT)
LOST(modulus, shape, MAP_MODULUS, BASELINE_SHAPE)
LOST(modulus, xpbd, MAP_MODULUS, BASELINE_XPBD)
LOST(poisson, explicit, MAP_POISSON, BASELINE_EXPLICIT)
LOST(poisson, shape, MAP_POISSON, BASELINE_SHAPE)
LOST(mass, explicit, MAP_MASS, BASELINE_EXPLICIT)
LOST(mass, shape, MAP_MASS, BASELINE_SHAPE)
LOST(mass, xpbd, MAP_MASS, BASELINE_XPBD)
LOST(collapse, explicit, MAP_COLLAPSE, BASELINE_EXPLICIT)
LOST(collapse, springs, MAP_COLLAPSE, BASELINE_SPRINGS)
LOST(collapse, mls, MAP_COLLAPSE, BASELINE_MLS)
LOST(collapse, stvk, MAP_COLLAPSE, BASELINE_STVK)
LOST(collapse, xpbd, MAP_COLLAPSE, BASELINE_XPBD)
LOST(section, mls, MAP_SECTION, BASELINE_MLS)
LOST(section, shape, MAP_SECTION, BASELINE_SHAPE)

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(elements_against_others);
    RUN(elements_move);
    RUN(wrong_is_seen);
    RUN(modulus_explicit);
    RUN(modulus_shape);
    RUN(modulus_xpbd);
    RUN(poisson_explicit);
    RUN(poisson_shape);
    RUN(mass_explicit);
    RUN(mass_shape);
    RUN(mass_xpbd);
    RUN(collapse_explicit);
    RUN(collapse_springs);
    RUN(collapse_mls);
    RUN(collapse_stvk);
    RUN(collapse_xpbd);
    RUN(section_mls);
    RUN(section_shape);
    return test_end();
}
