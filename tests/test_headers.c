/* tests/test_headers.c - the quick starts of the three headers, with what they must come to; two translation units.

   The texts are those of the headers' comments. `make matrix` compiles the comments themselves; this file says that the
   numbers are right. */
#define PERI_IMPLEMENTATION
#include "../peri_solver.h"
#include "../peri_material.h"
#include "../peri.h"
#include "../peri.h" /* twice is fine */

#include "test.h"

int unit2_counts(const peri_shape *shape, peri_real spacing);
size_t unit2_world_bytes(void);
const char *unit2_version(void);
uint64_t unit2_falls(int steps);

static void quick_start_of_solver(void) {
    int k, solved = 0;
    int i[] = {0, 1, 2, 1, 2}, j[] = {0, 1, 2, 0, 1};
    peri_real value[] = {2, 2, 2, -1, -1}, b[3] = {1, 0, 0}, work[6];
    peri_sparse *a = NULL;  peri_cholesky *f = NULL;  peri_error err;
    if (peri_sparse_from_triplets(3, 5, i, j, PERI_TRIANGLE_LOWER, NULL, &a, &err) == PERI_OK &&
        peri_sparse_set(a, value, &err) == PERI_OK &&
        peri_cholesky_create(peri_sparse_matrix(a), NULL, NULL, &f, &err) == PERI_OK &&
        peri_cholesky_factor(f, peri_sparse_matrix(a), &err) == PERI_OK)
        peri_cholesky_solve(f, 1, b, work), solved = 1;
    peri_cholesky_destroy(f);
    peri_real x[3] = {0}, room[12];
    peri_iteration o = peri_default_iteration();
    peri_report report;  peri_incomplete *ic = NULL;
    if (peri_incomplete_create(peri_sparse_matrix(a), 1, NULL, &ic, &err) == PERI_OK &&
        peri_incomplete_factor(ic, peri_sparse_matrix(a), &err) == PERI_OK) {
        o.precondition = peri_incomplete_apply;
        o.context = ic;
        peri_solve_cg(peri_sparse_matrix(a), 1, b, x, room, &o, &report, &err);
    }
    peri_incomplete_destroy(ic);
    peri_sparse_destroy(a);
    CHECK(solved);
    for (k = 0; k < 3; k++) NEAR(b[k], (3 - k) / 4.0, 1e-6);
    /* the factor of a tridiagonal matrix has no fill: one step is exact */
    CHECK(report.result == PERI_OK && report.iterations == 1 && peri_solve_work(3, 1) == 12);
    NEAR(x[0], 0.875, 1e-5);
    NEAR(x[1], 1, 1e-5);
    NEAR(x[2], 0.625, 1e-5);
}

static void quick_start_of_material(void) {
    /* simple shear g keeps the volume: energy mu/2 g^2, stress mu (F - F^-T) */
    double mu = 1e5 / (2 * 1.45), g = 0.5;
    peri_material m = peri_material_neo_hookean(1e5f, 0.45f, 1000);
    double f[9] = {1, 0.5, 0,  0, 1, 0,  0, 0, 1}, p[9];
    double energy = peri_material_point(&m, f, p);
    NEAR(energy, mu * g * g / 2, 2e-5 * mu); /* the integral over the sphere is good to 1e-6, Poisson's ratio to float */
    NEAR(p[1], mu * g, 2e-5 * mu);
    NEAR(p[3], mu * g, 2e-5 * mu);
    NEAR(p[0], 0, 2e-5 * mu);
    NEAR(p[8], 0, 2e-5 * mu);
}

static void quick_start_of_world(void) {
    peri_world_def wd = peri_default_world_def();
    peri_world *world = peri_world_create(&wd, NULL);
    peri_material rubber = peri_material_neo_hookean(1e5f, 0.3f, 1000);
    peri_collider_def floor_def = peri_default_collider_def();
    peri_body_def bd = peri_default_body_def();
    peri_shape cube = peri_shape_box(0.25f, 0.25f, 0.25f);
    peri_real points[3 * 1000];
    int count = 0, frame;
    peri_measure m, before;
    bd.spacing = 0.05f;
    peri_sample(&cube, bd.spacing, points, 1000, &count, NULL);
    bd.points = points;
    bd.count = count;
    bd.position.z = 1;
    bd.material = peri_material_create(world, &rubber);
    peri_body_create(world, &bd);
    peri_collider_create(world, &floor_def);
    CHECK(count == 1000);
    CHECK(peri_body_measure(world, (peri_body_id){0, 0}, &before) == PERI_OK);
    NEAR(before.mass, 125, 0.01);
    NEAR(before.centre[2], 1, 1e-5);
    for (frame = 0; frame < 60; frame++) CHECK(peri_world_step(world, 1.0f / 30) == PERI_OK);
    CHECK(peri_body_measure(world, (peri_body_id){0, 0}, &m) == PERI_OK);
    /* at rest its weight has lowered the centre by at most rho g L^2 / 3E = 0.8 cm, less as it cannot slide sideways */
    NEAR(m.centre[2], 0.2435, 0.004);
    NEAR(m.centre[0], 0, 1e-3);
    CHECK(m.lower[2] > 0 && peri_world_stats(world).contacts > 0);
    peri_world_destroy(world);
}

static void two_units(void) {
    peri_shape ball = peri_shape_ball(1);
    int count = 0;
    CHECK(peri_sample(&ball, (peri_real)0.25, NULL, 0, &count, NULL) == PERI_OK);
    CHECK(count > 200 && unit2_counts(&ball, (peri_real)0.25) == count);
    CHECK(unit2_world_bytes() == sizeof(peri_world_def) + sizeof(peri_body_def) + sizeof(peri_material) +
                                     sizeof(peri_stats) + sizeof(peri_real));
    CHECK(unit2_falls(0) != unit2_falls(3));
    CHECK(unit2_falls(3) == unit2_falls(3)); /* same calls, same bits */
}

static void version(void) {
    char text[32];
    snprintf(text, sizeof text, "%d.%d.%d", PERI_VERSION_MAJOR, PERI_VERSION_MINOR, PERI_VERSION_PATCH);
    CHECK(strcmp(text, PERI_VERSION) == 0);
    CHECK(strcmp(text, unit2_version()) == 0);
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(quick_start_of_solver);
    RUN(quick_start_of_material);
    RUN(quick_start_of_world);
    RUN(two_units);
    RUN(version);
    return test_end();
}
