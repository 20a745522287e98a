/* tests/test_errors.c - wrong calls, missing memory, failing steps: each is refused with its reason, nothing changes.

   Wrong calls are rows of the form WORLD(code, word, change): a good definition, one change, the code it must be
   refused with and a word that the sentence must hold (the argument's name). Every row also checks that the world's
   hash and counts are what they were and that the log was told once. */
#define PERI_IMPLEMENTATION
#include "../peri.h"

#include <float.h>
#include <limits.h>
#include <stdlib.h>

#include "test.h"

#define R(x) ((peri_real)(x))
#define BIG R(1e16) /* finite, but beyond what a coordinate may be */
#define SPACING 0.1
/* peri_solver.h: "PERI_ERROR_ARGUMENT: null pointer, missing cookie, unknown enumerator" */
#define UNKNOWN PERI_ERROR_ARGUMENT

static const peri_real nan_ = (peri_real)NAN, inf = (peri_real)INFINITY;
static int rows = 0; /* wrong calls made */

static peri_vec3 vec(double x, double y, double z) {
    peri_vec3 v;
    v.x = R(x);
    v.y = R(y);
    v.z = R(z);
    return v;
}

/* ---- a world to go wrong in ---------------------------------------------------------------------------------------- */

typedef struct scene {
    peri_world *world;
    peri_material_id soft;
    peri_body_id body, gone;        /* 27 particles, the first fixed; gone was in its place before */
    peri_collider_id floor, second;
    peri_skin_id skin;
    peri_real points[81], corners[9];
    int triangle[3];
    int told;
    char text[240];
} scene;

static scene S;

static void hear(const char *text, void *user) {
    scene *s = (scene *)user;
    s->told++;
    snprintf(s->text, sizeof s->text, "%s", text);
}

/* n x n x n points, x fastest. */
static void lattice(peri_real *points, int n) {
    int i;
    for (i = 0; i < n * n * n; i++) {
        points[3 * i] = R(SPACING * (i % n));
        points[3 * i + 1] = R(SPACING * (i / n % n));
        points[3 * i + 2] = R(SPACING * (i / n / n));
    }
}

static peri_world_def good_world(void) {
    peri_world_def d = peri_default_world_def();
    d.log = hear;
    d.user = &S;
    d.max_particles = 60;
    d.max_bonds = 700;
    d.max_bodies = 3;
    d.max_materials = 5;
    d.max_colliders = 3;
    d.max_skins = 2;
    return d;
}

static peri_material good_material(void) { return peri_material_neo_hookean(R(1e5), R(0.3), 1000); }

static peri_body_def good_body(void) {
    peri_body_def d = peri_default_body_def();
    d.points = S.points;
    d.count = 27;
    d.spacing = R(SPACING);
    d.material = S.soft;
    d.position.z = R(0.05);
    return d;
}

static void begin(void) {
    static const unsigned char fixed[27] = {1};
    peri_world_def wd = good_world();
    peri_material m = good_material();
    peri_collider_def cd = peri_default_collider_def();
    peri_body_def bd;
    memset(&S, 0, sizeof S);
    lattice(S.points, 3);
    memcpy(S.corners, S.points, sizeof S.corners);
    S.triangle[1] = 1;
    S.triangle[2] = 2;
    S.world = peri_world_create(&wd, NULL);
    S.soft = peri_material_create(S.world, &m);
    bd = good_body();
    S.gone = peri_body_create(S.world, &bd);
    CHECK(peri_body_destroy(S.world, S.gone) == PERI_OK);
    bd.fixed = fixed;
    S.body = peri_body_create(S.world, &bd);
    S.floor = peri_collider_create(S.world, &cd);
    cd.position.z = -5;
    S.second = peri_collider_create(S.world, &cd);
    S.skin = peri_skin_create(S.world, S.body, S.corners, 3, S.triangle, 1);
    CHECK(S.body.index1 && S.floor.index1 && S.second.index1 && S.skin.index1);
    CHECK(peri_world_step(S.world, R(1.0 / 30)) == PERI_OK);
    CHECK(S.told == 0);
}

static void end(void) {
    CHECK(peri_world_step(S.world, R(1.0 / 30)) == PERI_OK);
    CHECK(peri_world_step(S.world, R(1.0 / 30)) == PERI_OK);
    peri_world_destroy(S.world);
}

/* What must not change. Taken by PROBE before each wrong call. */
typedef struct probe {
    uint64_t hash;
    peri_stats stats;
    int told;
} probe;

static probe probe_now(void) {
    probe p;
    p.hash = peri_world_hash(S.world);
    p.stats = peri_world_stats(S.world);
    p.told = S.told;
    return p;
}

static void complain(int line, const char *what, const char *text) {
    char all[320];
    snprintf(all, sizeof all, "%s [%.200s]", what, text);
    test_complain("tests/test_errors.c", line, all);
}

static void unchanged(int line, const probe *before, const char *text) {
    peri_stats a = before->stats, b = peri_world_stats(S.world);
    if (peri_world_hash(S.world) != before->hash) complain(line, "the hash of the world has changed", text);
    if (a.bodies != b.bodies || a.particles != b.particles || a.bonds != b.bonds || a.colliders != b.colliders ||
        a.contacts != b.contacts || a.skins != b.skins)
        complain(line, "the counts of the world have changed", text);
}

static void sentence(int line, const peri_error *err, peri_result code, const char *word) {
    char wanted[80];
    snprintf(wanted, sizeof wanted, "code %d, wanted %d and '%s'", (int)err->code, (int)code, word);
    if (err->code != code || !strstr(err->text, word)) complain(line, wanted, err->text);
}

/* A call of the world's that must have been refused. */
static void refused(int line, const probe *before, int refusal, peri_result code, const char *word) {
    const peri_error *err = peri_last_error(S.world);
    rows++;
    if (!refusal) complain(line, "not refused, wanted", word);
    sentence(line, err, code, word);
    if (S.told != before->told + 1 || strcmp(S.text, err->text) != 0) complain(line, "the log was not told", err->text);
    unchanged(line, before, err->text);
}

/* A call that fills an error of the caller's. */
static void refused_err(int line, const peri_error *err, int refusal, peri_result code, const char *word) {
    rows++;
    if (!refusal) complain(line, "not refused, wanted", word);
    sentence(line, err, code, word);
}

#define CALL(code, word, call) \
    do { \
        probe p_ = probe_now(); \
        peri_result r_ = (call); \
        refused(__LINE__, &p_, r_ == (code), (code), word); \
    } while (0)
#define VALUE PERI_ERROR_VALUE
#define ARGUMENT PERI_ERROR_ARGUMENT
#define INDEX PERI_ERROR_INDEX
#define ID PERI_ERROR_ID
#define GEOMETRY PERI_ERROR_GEOMETRY
#define LIMIT PERI_ERROR_LIMIT

/* ---- worlds ------------------------------------------------------------------------------------------------------ */

#define WORLD(code, word, change) \
    do { \
        peri_world_def d = good_world(); \
        peri_error err; \
        memset(&err, 0, sizeof err); \
        change; \
        refused_err(__LINE__, &err, peri_world_create(&d, &err) == NULL, code, word); \
        CHECK(peri_world_create(&d, NULL) == NULL); \
        CHECK(peri_world_size(&d) == 0); \
    } while (0)

static void worlds(void) {
    peri_error err;
    memset(&err, 0, sizeof err);
    refused_err(__LINE__, &err, peri_world_create(NULL, &err) == NULL, ARGUMENT, "definition");
    CHECK(peri_world_size(NULL) == 0);
    WORLD(ARGUMENT, "peri_default_world_def", d.cookie = 0);
    WORLD(ARGUMENT, "peri_default_world_def", memset(&d, 0, sizeof d));
    WORLD(VALUE, "gravity", d.gravity.x = nan_);
    WORLD(VALUE, "gravity", d.gravity.z = -inf);
    WORLD(UNKNOWN, "integrator", d.integrator = (peri_integrator)2);
    WORLD(UNKNOWN, "solver", d.solver = (peri_solver)6);
    WORLD(VALUE, "sweeps", d.sweeps = 1);
    WORLD(VALUE, "sweeps", d.sweeps = 65);
    WORLD(VALUE, "lbfgs", d.lbfgs = -1);
    WORLD(VALUE, "lbfgs", d.lbfgs = 9);
    WORLD(VALUE, "tolerance", d.tolerance = 0);
    WORLD(VALUE, "tolerance", d.tolerance = nan_);
    WORLD(VALUE, "max_iterations", d.max_iterations = 0);
    WORLD(VALUE, "matrix_scale", d.matrix_scale = R(0.01));
    WORLD(VALUE, "matrix_scale", d.matrix_scale = inf);
    WORLD(VALUE, "max_particles", d.max_particles = 0);
    WORLD(VALUE, "max_particles", d.max_particles = INT_MAX);
    WORLD(VALUE, "max_bonds", d.max_bonds = -1);
    WORLD(VALUE, "max_bodies", d.max_bodies = 0);
    WORLD(VALUE, "max_materials", d.max_materials = -5);
    WORLD(VALUE, "max_colliders", d.max_colliders = -1);
    WORLD(VALUE, "max_skins", d.max_skins = 1 << 20);
    WORLD(VALUE, "threads", d.parallel.threads = -1);
}

static void steps(void) {
    begin();
    CALL(VALUE, "dt", peri_world_step(S.world, 0));
    CALL(VALUE, "dt", peri_world_step(S.world, R(-0.01)));
    CALL(VALUE, "dt", peri_world_step(S.world, nan_));
    CALL(VALUE, "dt", peri_world_step(S.world, inf));
    CALL(VALUE, "dt", peri_world_step(S.world, R(1e13)));
    CALL(VALUE, "gravity", peri_world_set_gravity(S.world, vec(NAN, 0, 0)));
    CALL(VALUE, "gravity", peri_world_set_gravity(S.world, vec(0, 0, -INFINITY)));
    CALL(VALUE, "gravity", peri_world_set_gravity(S.world, vec(0, 1e16, 0)));
    end();
}

/* Without a world there is no place for a sentence: the code alone answers. */
static void no_world(void) {
    peri_body_id body = {1, 1};
    peri_collider_id collider = {1, 1};
    peri_skin_id skin = {1, 1};
    peri_material m = good_material();
    peri_body_def bd = good_body();
    peri_collider_def cd = peri_default_collider_def();
    peri_quat q = {0, 0, 0, 1};
    peri_real x[3] = {0, 0, 0};
    peri_measure out;
    peri_draw draw;
    memset(&draw, 0, sizeof draw);
    draw.high = 1;
    CHECK(peri_world_step(NULL, 1) == ARGUMENT);
    CHECK(peri_world_set_gravity(NULL, vec(0, 0, 0)) == ARGUMENT);
    CHECK(peri_last_error(NULL) == NULL);
    CHECK(peri_world_hash(NULL) == 0 && peri_world_stats(NULL).bodies == 0);
    CHECK(!peri_material_create(NULL, &m).index1 && !peri_body_create(NULL, &bd).index1);
    CHECK(!peri_collider_create(NULL, &cd).index1 && !peri_skin_create(NULL, body, x, 1, NULL, 0).index1);
    CHECK(peri_body_destroy(NULL, body) == ARGUMENT && peri_collider_destroy(NULL, collider) == ARGUMENT);
    CHECK(peri_body_is_valid(NULL, body) == 0 && peri_body_count(NULL, body) == 0);
    CHECK(peri_body_positions(NULL, body) == NULL && peri_body_velocities(NULL, body) == NULL);
    CHECK(peri_body_set_positions(NULL, body, 0, 1, x) == ARGUMENT);
    CHECK(peri_body_set_velocities(NULL, body, 0, 1, x) == ARGUMENT);
    CHECK(peri_body_set_forces(NULL, body, 0, 1, x) == ARGUMENT);
    CHECK(peri_body_set_fixed(NULL, body, 0, 1) == ARGUMENT && peri_body_move(NULL, body, 0, vec(0, 0, 0)) == ARGUMENT);
    CHECK(peri_body_measure(NULL, body, &out) == ARGUMENT && peri_body_forces(NULL, body, x) == ARGUMENT);
    CHECK(peri_body_values(NULL, body, PERI_VALUE_SPEED, x) == ARGUMENT);
    CHECK(peri_body_stress(NULL, body, x) == ARGUMENT && peri_body_gradient(NULL, body, x) == ARGUMENT);
    CHECK(peri_collider_set_pose(NULL, collider, vec(0, 0, 0), q) == ARGUMENT);
    CHECK(peri_collider_set_velocity(NULL, collider, vec(0, 0, 0), vec(0, 0, 0)) == ARGUMENT);
    CHECK(peri_collider_pose(NULL, collider, NULL, NULL) == ARGUMENT);
    CHECK(peri_collider_impulse(NULL, collider, NULL, NULL) == ARGUMENT);
    CHECK(peri_skin_destroy(NULL, skin) == ARGUMENT && peri_skin_update(NULL, skin, x, NULL) == ARGUMENT);
    CHECK(peri_world_draw(NULL, &draw) == ARGUMENT);
    peri_world_destroy(NULL);
}

/* ---- materials --------------------------------------------------------------------------------------------------- */

static double bad_energy(double s, double *first, void *context) {
    (void)context;
    *first = 1; /* must be 0 at s = 1 */
    return s - 1;
}

static peri_material projective(void) { return peri_material_projective(R(1e5), R(0.5), 1000); }
static peri_material linear(void) { return peri_material_linear(R(1e5), R(0.3), 1000); }
static peri_material turned(void) {
    peri_material m = linear();
    m.anisotropic = 1;
    m.strength[0] = m.strength[1] = m.strength[2] = 1;
    memset(m.direction, 0, sizeof m.direction);
    m.direction[0] = m.direction[4] = m.direction[8] = 1;
    return m;
}

#define MATERIAL(code, word, make, change) \
    do { \
        peri_material m = make; \
        peri_error err; \
        probe p_; \
        change; \
        memset(&err, 0, sizeof err); \
        refused_err(__LINE__, &err, peri_material_check(&m, &err) == (code), code, word); \
        CHECK(peri_material_check(&m, NULL) == (code)); \
        p_ = probe_now(); \
        refused(__LINE__, &p_, peri_material_create(S.world, &m).index1 == 0, code, word); \
        rows--; \
    } while (0)

static void materials(void) {
    peri_material good;
    peri_error err;
    probe p;
    int k;
    begin();
    memset(&err, 0, sizeof err);
    refused_err(__LINE__, &err, peri_material_check(NULL, &err) == ARGUMENT, ARGUMENT, "material");
    p = probe_now();
    refused(__LINE__, &p, peri_material_create(S.world, NULL).index1 == 0, ARGUMENT, "material");
    MATERIAL(ARGUMENT, "preset", good_material(), memset(&m, 0, sizeof m));
    MATERIAL(UNKNOWN, "model", good_material(), m.model = (peri_model)3);
    MATERIAL(VALUE, "density", good_material(), m.density = 0);
    MATERIAL(VALUE, "density", peri_material_linear(R(1e5), R(0.3), nan_), (void)0);
    MATERIAL(VALUE, "young", peri_material_neo_hookean(-1, R(0.3), 1000), (void)0);
    MATERIAL(VALUE, "young", peri_material_stvk(inf, R(0.3), 1000), (void)0);
    MATERIAL(VALUE, "young", peri_material_projective(0, R(0.5), 1000), (void)0);
    MATERIAL(VALUE, "poisson", peri_material_neo_hookean(R(1e5), R(0.5), 1000), (void)0);
    MATERIAL(VALUE, "poisson", peri_material_neo_hookean_papers(R(1e5), -1, 1000), (void)0);
    MATERIAL(VALUE, "poisson", peri_material_stable_neo_hookean(R(1e5), nan_, 1000), (void)0);
    MATERIAL(VALUE, "b is", peri_material_projective(R(1e5), 2, 1000), (void)0);
    MATERIAL(VALUE, "a is", projective(), m.a = -1);
    MATERIAL(VALUE, "b is", projective(), m.b = nan_);
    MATERIAL(VALUE, "a and b", projective(), m.a = m.b = 0);
    MATERIAL(UNKNOWN, "law", good_material(), m.law = (peri_law)4);
    MATERIAL(ARGUMENT, "psi", peri_material_user(NULL, NULL, R(1e5), R(0.3), 1000), (void)0);
    MATERIAL(VALUE, "stabiliser", good_material(), m.stabiliser = 11);
    MATERIAL(VALUE, "stabiliser", good_material(), m.stabiliser = -1);
    MATERIAL(VALUE, "mu", good_material(), m.mu = 0);
    MATERIAL(VALUE, "lambda", good_material(), m.lambda = -m.mu);
    MATERIAL(VALUE, "ms", linear(), m.ms = 0);
    MATERIAL(VALUE, "ls", linear(), m.ls = -2 * m.ms);
    MATERIAL(VALUE, "A_n", linear(), m.g.a[3] = -1);
    MATERIAL(VALUE, "B_n", linear(), m.h.b[5] = nan_);
    MATERIAL(VALUE, "svk", linear(), m.h.svk = inf);
    MATERIAL(VALUE, "g has", linear(), memset(&m.g, 0, sizeof m.g));
    MATERIAL(VALUE, "h has", linear(), memset(&m.h, 0, sizeof m.h));
    MATERIAL(VALUE, "h.user", linear(), m.h.user = bad_energy);
    MATERIAL(VALUE, "direction", turned(), m.direction[1] = R(0.1));
    MATERIAL(VALUE, "direction", turned(), m.direction[8] = nan_);
    MATERIAL(VALUE, "strength", turned(), m.strength[0] = 0);
    MATERIAL(VALUE, "product", turned(), m.strength[2] = 2);
    MATERIAL(VALUE, "healthy_min", good_material(), m.healthy_min = 1);
    MATERIAL(VALUE, "healthy_max", good_material(), m.healthy_max = 1);
    MATERIAL(VALUE, "restore", good_material(), m.restore = -1);
    MATERIAL(VALUE, "restore", good_material(), m.restore = nan_);
    /* none of them took a place: one is used of five */
    good = good_material();
    for (k = 0; k < 4; k++) CHECK(peri_material_create(S.world, &good).index1 != 0);
    p = probe_now();
    refused(__LINE__, &p, peri_material_create(S.world, &good).index1 == 0, LIMIT, "max_materials");
    end();
}

/* ---- bodies ------------------------------------------------------------------------------------------------------ */

#define BODY(code, word, change) \
    do { \
        peri_body_def d = good_body(); \
        probe p_ = probe_now(); \
        peri_body_id id; \
        change; \
        id = peri_body_create(S.world, &d); \
        refused(__LINE__, &p_, id.index1 == 0 && id.generation == 0, code, word); \
    } while (0)

static void body_definitions(void) {
    peri_real points[3 * 64], volumes[27];
    probe p;
    int k;
    begin();
    memcpy(points, S.points, sizeof S.points);
    for (k = 0; k < 27; k++) volumes[k] = R(1e-3);
    p = probe_now();
    refused(__LINE__, &p, peri_body_create(S.world, NULL).index1 == 0, ARGUMENT, "definition");
    BODY(ARGUMENT, "peri_default_body_def", d.cookie++);
    BODY(ARGUMENT, "points", d.points = NULL);
    BODY(VALUE, "count", d.count = 0);
    BODY(VALUE, "count", d.count = INT_MIN);
    BODY(LIMIT, "max_particles", d.count = INT_MAX);
    BODY(VALUE, "spacing", d.spacing = 0);
    BODY(VALUE, "spacing", d.spacing = -1);
    BODY(VALUE, "spacing", d.spacing = nan_);
    BODY(VALUE, "horizon", d.horizon = R(0.9));
    BODY(VALUE, "horizon", d.horizon = 7);
    BODY(VALUE, "horizon", d.horizon = nan_);
    BODY(UNKNOWN, "kernel", d.kernel = (peri_kernel)6);
    BODY(VALUE, "kernel_power", d.kernel_power = 5);
    BODY(VALUE, "kernel_power", d.kernel_power = nan_);
    BODY(VALUE, "position", d.position.x = inf);
    BODY(VALUE, "position", d.position.y = BIG);
    BODY(VALUE, "rotation", memset(&d.rotation, 0, sizeof d.rotation));
    BODY(VALUE, "rotation", d.rotation.x = 1);
    BODY(VALUE, "rotation", d.rotation.w = nan_);
    BODY(VALUE, "velocity", d.velocity.z = nan_);
    BODY(VALUE, "spin", d.spin.y = -inf);
    BODY(VALUE, "contact_radius", d.contact_radius = -1);
    BODY(VALUE, "contact_radius", d.contact_radius = 3);
    BODY(ID, "material", memset(&d.material, 0, sizeof d.material));
    BODY(ID, "material", d.material.generation++);
    BODY(ID, "material", d.material.index1 = S.second.index1); /* the id of another kind of thing */
    BODY(ID, "material", d.material.index1 = UINT32_MAX);
    points[7] = nan_;
    BODY(VALUE, "points", d.points = points);
    points[7] = inf;
    BODY(VALUE, "points", d.points = points);
    points[7] = BIG;
    BODY(VALUE, "points", d.points = points);
    memcpy(points, S.points, sizeof S.points);
    memcpy(points + 30, points + 75, 3 * sizeof *points);
    BODY(GEOMETRY, "10 and 25", d.points = points);
    volumes[3] = 0;
    BODY(VALUE, "volumes[3]", d.volumes = volumes);
    volumes[3] = -1;
    BODY(VALUE, "volumes[3]", d.volumes = volumes);
    volumes[3] = nan_;
    BODY(VALUE, "volumes[3]", d.volumes = volumes);
    volumes[3] = inf;
    BODY(VALUE, "volumes[3]", d.volumes = volumes);
    lattice(points, 4);
    BODY(LIMIT, "max_particles", (d.points = points, d.count = 64)); /* 27 are there, 60 are allowed */
    BODY(LIMIT, "max_bonds", d.horizon = 3);
    end();
}

static void body_limit(void) {
    peri_body_def d;
    begin();
    d = good_body();
    d.count = 1;
    CHECK(peri_body_create(S.world, &d).index1 != 0);
    CHECK(peri_body_create(S.world, &d).index1 != 0);
    BODY(LIMIT, "max_bodies", d.count = 1);
    end();
}

/* A lattice of 3^3 has (3 3 - 2)^3 - 3^3 directed bonds at horizon 1.75. */
static void bond_limit(void) {
    peri_world_def wd;
    int spare;
    for (spare = -1; spare <= 0; spare++) {
        peri_body_def d;
        peri_material m = good_material();
        memset(&S, 0, sizeof S);
        lattice(S.points, 3);
        wd = good_world();
        wd.max_bonds = 316 + spare;
        wd.max_particles = 27;
        S.world = peri_world_create(&wd, NULL);
        S.soft = peri_material_create(S.world, &m);
        if (spare < 0) BODY(LIMIT, "max_bonds", (void)0);
        d = good_body();
        CHECK((peri_body_create(S.world, &d).index1 != 0) == (spare == 0));
        end();
    }
}

/* Every function of a body, by a wrong id. */
static void wrong_body(peri_body_id id) {
    peri_real x[9 * 27];
    peri_measure out;
    memset(x, 0, sizeof x);
    CALL(ID, "body", peri_body_destroy(S.world, id));
    CALL(ID, "body", peri_body_set_positions(S.world, id, 0, 1, x));
    CALL(ID, "body", peri_body_set_velocities(S.world, id, 0, 1, x));
    CALL(ID, "body", peri_body_set_forces(S.world, id, 0, 1, x));
    CALL(ID, "body", peri_body_set_fixed(S.world, id, 0, 1));
    CALL(ID, "body", peri_body_move(S.world, id, 0, vec(0, 0, 0)));
    CALL(ID, "body", peri_body_forces(S.world, id, x));
    CALL(ID, "body", peri_body_values(S.world, id, PERI_VALUE_STRESS, x));
    CALL(ID, "body", peri_body_stress(S.world, id, x));
    CALL(ID, "body", peri_body_gradient(S.world, id, x));
    if (id.index1) CALL(ID, "body", peri_body_measure(S.world, id, &out)); /* null: the whole world */
    CALL(ID, "body", peri_skin_create(S.world, id, S.corners, 3, S.triangle, 1).index1 ? PERI_OK : ID);
    CHECK(!peri_body_is_valid(S.world, id) && peri_body_count(S.world, id) == 0);
    CHECK(!peri_body_positions(S.world, id) && !peri_body_velocities(S.world, id));
}

static void body_ids(void) {
    peri_body_id id = {0, 0};
    begin();
    wrong_body(id);
    wrong_body(S.gone); /* removed, its place taken by another body */
    id.index1 = S.second.index1; /* a collider */
    id.generation = S.second.generation;
    wrong_body(id);
    id = S.body;
    id.generation += 7;
    wrong_body(id);
    id.index1 = UINT32_MAX;
    wrong_body(id);
    end();
}

static void body_arguments(void) {
    peri_real x[81], bad[81];
    begin();
    memcpy(x, S.points, sizeof x);
    memcpy(bad, x, sizeof x);
    bad[80] = nan_;
    CALL(INDEX, "particles", peri_body_set_positions(S.world, S.body, -1, 2, x));
    CALL(INDEX, "particles", peri_body_set_positions(S.world, S.body, 0, 28, x));
    CALL(INDEX, "particles", peri_body_set_positions(S.world, S.body, 27, 1, x));
    CALL(INDEX, "particles", peri_body_set_positions(S.world, S.body, 5, -1, x));
    CALL(INDEX, "particles", peri_body_set_positions(S.world, S.body, INT_MAX, 2, x)); /* their sum passes int */
    CALL(INDEX, "particles", peri_body_set_velocities(S.world, S.body, 1, 27, x));
    CALL(INDEX, "particles", peri_body_set_velocities(S.world, S.body, 1, INT_MAX, x));
    CALL(INDEX, "particles", peri_body_set_forces(S.world, S.body, 26, 2, x));
    CALL(INDEX, "particles", peri_body_set_forces(S.world, S.body, INT_MIN, INT_MIN, x));
    CALL(INDEX, "particles", peri_body_set_fixed(S.world, S.body, 27, 1));
    CALL(INDEX, "particles", peri_body_set_fixed(S.world, S.body, -1, 0));
    CALL(INDEX, "particles", peri_body_move(S.world, S.body, 27, vec(0, 0, 0)));
    CALL(ARGUMENT, "x is NULL", peri_body_set_positions(S.world, S.body, 0, 27, NULL));
    CALL(ARGUMENT, "v is NULL", peri_body_set_velocities(S.world, S.body, 0, 27, NULL));
    CALL(VALUE, "x: component 2 of entry 26", peri_body_set_positions(S.world, S.body, 0, 27, bad));
    CALL(VALUE, "v: component 2 of entry 26", peri_body_set_velocities(S.world, S.body, 0, 27, bad));
    CALL(VALUE, "f: component 2 of entry 26", peri_body_set_forces(S.world, S.body, 0, 27, bad));
    bad[80] = inf;
    CALL(VALUE, "x: ", peri_body_set_positions(S.world, S.body, 0, 27, bad));
    bad[80] = BIG;
    CALL(VALUE, "v: ", peri_body_set_velocities(S.world, S.body, 0, 27, bad));
    CALL(VALUE, "x: ", peri_body_move(S.world, S.body, 0, vec(NAN, 0, 0)));
    CALL(ARGUMENT, "particle 5 is free", peri_body_move(S.world, S.body, 5, vec(0, 0, 0)));
    CALL(ARGUMENT, "out", peri_body_measure(S.world, S.body, NULL));
    CALL(ARGUMENT, "f is NULL", peri_body_forces(S.world, S.body, NULL));
    CALL(ARGUMENT, "out", peri_body_values(S.world, S.body, PERI_VALUE_ENERGY, NULL));
    CALL(ARGUMENT, "out", peri_body_stress(S.world, S.body, NULL));
    CALL(ARGUMENT, "out", peri_body_gradient(S.world, S.body, NULL));
    CALL(UNKNOWN, "value", peri_body_values(S.world, S.body, (peri_value)(PERI_VALUE_SPEED + 1), bad));
    end();
}

/* ---- colliders --------------------------------------------------------------------------------------------------- */

static peri_real flat(peri_vec3 p, peri_vec3 *gradient, void *context) {
    (void)context;
    if (gradient) *gradient = vec(0, 0, 1);
    return p.z;
}

#define COLLIDER(code, word, change) \
    do { \
        peri_collider_def d = peri_default_collider_def(); \
        probe p_ = probe_now(); \
        change; \
        refused(__LINE__, &p_, peri_collider_create(S.world, &d).index1 == 0, code, word); \
    } while (0)

static void collider_definitions(void) {
    peri_collider_def good = peri_default_collider_def();
    probe p;
    begin();
    p = probe_now();
    refused(__LINE__, &p, peri_collider_create(S.world, NULL).index1 == 0, ARGUMENT, "definition");
    COLLIDER(ARGUMENT, "peri_default_collider_def", d.cookie = 1);
    COLLIDER(UNKNOWN, "kind", d.shape.kind = (peri_shape_kind)8);
    COLLIDER(ARGUMENT, "mesh", d.shape = peri_shape_mesh(S.corners, 3, S.triangle, 1));
    COLLIDER(ARGUMENT, "distance", d.shape = peri_shape_distance(NULL, NULL, vec(0, 0, 0), vec(1, 1, 1)));
    COLLIDER(VALUE, "half.x", d.shape = peri_shape_box(0, 1, 1));
    COLLIDER(VALUE, "half.y", d.shape = peri_shape_box(1, nan_, 1));
    COLLIDER(VALUE, "half.z", d.shape = peri_shape_box(1, 1, -1));
    COLLIDER(VALUE, "radius", d.shape = peri_shape_ball(0));
    COLLIDER(VALUE, "radius", d.shape = peri_shape_ball(inf));
    COLLIDER(VALUE, "radius", d.shape = peri_shape_cylinder(-1, 1));
    COLLIDER(VALUE, "half_length", d.shape = peri_shape_cylinder(1, 0));
    COLLIDER(VALUE, "half_length", d.shape = peri_shape_capsule(1, -1));
    COLLIDER(VALUE, "position", d.position.x = nan_);
    COLLIDER(VALUE, "rotation", d.rotation.w = 2);
    COLLIDER(VALUE, "velocity", d.velocity.y = inf);
    COLLIDER(VALUE, "spin", d.spin.z = nan_);
    COLLIDER(UNKNOWN, "type", d.type = (peri_friction)3);
    COLLIDER(VALUE, "friction", d.friction = -1);
    COLLIDER(VALUE, "friction", d.friction = nan_);
    good.shape = peri_shape_distance(flat, NULL, vec(0, 0, 0), vec(0, 0, 0)); /* no bounds are needed here */
    CHECK(peri_collider_create(S.world, &good).index1 != 0);
    COLLIDER(LIMIT, "max_colliders", (void)0);
    end();
}

static void wrong_collider(peri_collider_id id) {
    peri_quat q = {0, 0, 0, 1};
    probe p;
    CALL(ID, "collider", peri_collider_destroy(S.world, id));
    CALL(ID, "collider", peri_collider_set_pose(S.world, id, vec(0, 0, 0), q));
    CALL(ID, "collider", peri_collider_set_velocity(S.world, id, vec(0, 0, 0), vec(0, 0, 0)));
    p = probe_now(); /* these two look at a const world, which cannot take a sentence */
    CHECK(peri_collider_pose(S.world, id, NULL, NULL) == ID);
    CHECK(peri_collider_impulse(S.world, id, NULL, NULL) == ID);
    unchanged(__LINE__, &p, "pose and impulse");
}

static void colliders(void) {
    peri_collider_id id = {0, 0};
    peri_quat q = {0, 0, 0, 1}, zero = {0, 0, 0, 0};
    begin();
    wrong_collider(id);
    id = S.second;
    id.generation++;
    wrong_collider(id);
    CHECK(peri_collider_destroy(S.world, S.second) == PERI_OK);
    wrong_collider(S.second);
    CALL(VALUE, "position", peri_collider_set_pose(S.world, S.floor, vec(0, NAN, 0), q));
    CALL(VALUE, "rotation", peri_collider_set_pose(S.world, S.floor, vec(0, 0, 0), zero));
    CALL(VALUE, "velocity", peri_collider_set_velocity(S.world, S.floor, vec(INFINITY, 0, 0), vec(0, 0, 0)));
    CALL(VALUE, "spin", peri_collider_set_velocity(S.world, S.floor, vec(0, 0, 0), vec(0, 0, NAN)));
    end();
}

/* ---- sampling ---------------------------------------------------------------------------------------------------- */

static peri_real broken(peri_vec3 p, peri_vec3 *gradient, void *context) {
    (void)p;
    (void)gradient;
    (void)context;
    return nan_;
}

#define SAMPLE(code, word, shape_, change) \
    do { \
        peri_shape s = shape_; \
        peri_real d = R(0.25); \
        peri_error err; \
        int count = 9, capacity = 600; \
        peri_real *to = points; \
        change; \
        memset(&err, 0, sizeof err); \
        refused_err(__LINE__, &err, peri_sample(&s, d, to, capacity, &count, &err) == (code), code, word); \
        CHECK(peri_sample(&s, d, to, capacity, &count, NULL) == (code)); \
    } while (0)

static void sampling(void) {
    static const int cube[36] = {0,2,1, 1,2,3, 4,5,6, 5,7,6, 0,1,4, 1,5,4, 2,6,3, 3,6,7, 0,4,2, 2,4,6, 1,3,5, 3,7,5};
    static peri_real points[3 * 600];
    peri_real corners[24], bad[24];
    int wrong[36], count, k;
    peri_shape ball = peri_shape_ball(1);
    peri_error err;
    for (k = 0; k < 24; k++) bad[k] = corners[k] = R(k / 3 >> k % 3 & 1);
    memcpy(wrong, cube, sizeof cube);
    wrong[35] = 8;
    bad[5] = nan_;
    memset(&err, 0, sizeof err);
    refused_err(__LINE__, &err, peri_sample(NULL, 1, NULL, 0, &count, &err) == ARGUMENT, ARGUMENT, "shape");
    refused_err(__LINE__, &err, peri_sample(&ball, 1, NULL, 0, NULL, &err) == ARGUMENT, ARGUMENT, "count");
    SAMPLE(ARGUMENT, "plane", peri_shape_plane(), (void)0);
    SAMPLE(UNKNOWN, "kind", peri_shape_ball(1), s.kind = (peri_shape_kind)42);
    SAMPLE(VALUE, "spacing", peri_shape_ball(1), d = 0);
    SAMPLE(VALUE, "spacing", peri_shape_ball(1), d = nan_);
    SAMPLE(VALUE, "capacity", peri_shape_ball(1), capacity = -1);
    SAMPLE(LIMIT, "capacity", peri_shape_ball(1), capacity = 10);
    CHECK(peri_sample(&ball, R(0.25), points, 10, &count, NULL) == LIMIT && count > 200); /* how many it must be */
    SAMPLE(LIMIT, "spacing", peri_shape_ball(R(1e9)), d = R(1e-6));
    SAMPLE(GEOMETRY, "too coarse", peri_shape_distance(flat, NULL, vec(0, 0, 1), vec(1, 1, 2)), (void)0);
    SAMPLE(VALUE, "radius", peri_shape_ball(-1), (void)0);
    SAMPLE(VALUE, "half.z", peri_shape_box(1, 1, nan_), (void)0);
    SAMPLE(VALUE, "lower", peri_shape_distance(flat, NULL, vec(1, 1, 1), vec(0, 2, 2)), (void)0);
    SAMPLE(VALUE, "distance", peri_shape_distance(broken, NULL, vec(0, 0, 0), vec(1, 1, 1)), (void)0);
    SAMPLE(ARGUMENT, "distance", peri_shape_distance(NULL, NULL, vec(0, 0, 0), vec(1, 1, 1)), (void)0);
    SAMPLE(ARGUMENT, "vertices", peri_shape_mesh(NULL, 8, cube, 12), (void)0);
    SAMPLE(ARGUMENT, "triangles", peri_shape_mesh(corners, 8, NULL, 12), (void)0);
    SAMPLE(VALUE, "vertex_count", peri_shape_mesh(corners, 2, cube, 12), (void)0);
    SAMPLE(VALUE, "triangle_count", peri_shape_mesh(corners, 8, cube, 0), (void)0);
    SAMPLE(INDEX, "vertex 8", peri_shape_mesh(corners, 8, wrong, 12), (void)0);
    SAMPLE(VALUE, "vertex 1", peri_shape_mesh(bad, 8, cube, 12), (void)0);
    SAMPLE(GEOMETRY, "hole", peri_shape_mesh(corners, 8, cube, 10), (void)0);
    CHECK(peri_shape_evaluate(NULL, vec(0, 0, 0), NULL) == 0);
}

/* ---- skins and drawing ------------------------------------------------------------------------------------------- */

#define SKIN(code, word, ...) \
    CALL(code, word, peri_skin_create(S.world, S.body, __VA_ARGS__).index1 ? PERI_OK : (code))

static void skins(void) {
    peri_real bad[9], out[9];
    int wrong[3] = {0, 1, 3};
    peri_skin_id none = {0, 0}, stale;
    begin();
    memcpy(bad, S.corners, sizeof bad);
    SKIN(ARGUMENT, "vertices", NULL, 3, S.triangle, 1);
    SKIN(VALUE, "vertex_count", S.corners, 0, S.triangle, 1);
    SKIN(VALUE, "triangle_count", S.corners, 3, S.triangle, -1);
    SKIN(ARGUMENT, "triangles", S.corners, 3, NULL, 1);
    SKIN(INDEX, "vertex 3", S.corners, 3, wrong, 1);
    bad[4] = nan_;
    SKIN(VALUE, "vertex 1", bad, 3, S.triangle, 1);
    bad[4] = 2; /* 20 spacings off */
    SKIN(GEOMETRY, "vertex 1", bad, 3, S.triangle, 1);
    bad[4] = R(0.2 + 4.2 * SPACING); /* the limit is 4 */
    SKIN(GEOMETRY, "4 spacings", bad, 3, S.triangle, 1);
    bad[4] = BIG;
    SKIN(GEOMETRY, "vertex 1", bad, 3, S.triangle, 1);
    CALL(ARGUMENT, "positions", peri_skin_update(S.world, S.skin, NULL, NULL));
    CALL(ID, "skin", peri_skin_update(S.world, none, out, NULL));
    CALL(ID, "skin", peri_skin_destroy(S.world, none));
    stale = peri_skin_create(S.world, S.body, S.corners, 3, NULL, 0);
    CHECK(stale.index1 != 0 && peri_skin_update(S.world, stale, out, NULL) == PERI_OK);
    SKIN(LIMIT, "max_skins", S.corners, 3, S.triangle, 1);
    CHECK(peri_skin_destroy(S.world, stale) == PERI_OK);
    CALL(ID, "skin", peri_skin_update(S.world, stale, out, NULL));
    CALL(ID, "skin", peri_skin_destroy(S.world, stale));
    stale = S.skin; /* a body takes its skins with it */
    CHECK(peri_body_destroy(S.world, S.body) == PERI_OK);
    CALL(ID, "skin", peri_skin_update(S.world, stale, out, NULL));
    end();
}

#define DRAW(code, word, change) \
    do { \
        peri_draw d; \
        memset(&d, 0, sizeof d); \
        d.high = 1; \
        change; \
        CALL(code, word, peri_world_draw(S.world, &d)); \
    } while (0)

static void drawing(void) {
    begin();
    CALL(ARGUMENT, "draw", peri_world_draw(S.world, NULL));
    DRAW(UNKNOWN, "value", d.value = (peri_value)9);
    DRAW(VALUE, "high", d.high = 0);
    DRAW(VALUE, "high", d.high = nan_);
    DRAW(VALUE, "low", d.low = nan_);
    DRAW(VALUE, "low", d.low = -inf); /* t would not be a number */
    DRAW(VALUE, "high", d.high = inf);
    end();
}

/* ---- the solver -------------------------------------------------------------------------------------------------- */

#define MATRIX(code, word, change) \
    do { \
        int row[4] = {0, 1, 3, 4}, col[4] = {1, 0, 2, 1}; \
        peri_real off[4] = {-1, -1, -1, -1}, diagonal[3] = {2, 2, 2}, xyz[9] = {0, 0, 0, 1, 0, 0, 2, 0, 0}; \
        peri_matrix a; \
        peri_cholesky *f = NULL; \
        peri_error err; \
        peri_result r; \
        a.n = 3; \
        a.row = row; \
        a.col = col; \
        a.value = off; \
        a.diagonal = diagonal; \
        (void)xyz; \
        change; \
        memset(&err, 0, sizeof err); \
        r = peri_cholesky_create(&a, xyz, NULL, &f, &err); \
        CHECK(!r == (f != NULL)); \
        if (!r) r = peri_cholesky_factor(f, &a, &err); \
        refused_err(__LINE__, &err, r == (code), code, word); \
        peri_cholesky_destroy(f); \
    } while (0)

static void matrices(void) {
    int row[2] = {0, 0}, row2[3] = {0, 0, 0};
    peri_real diagonal[2] = {1, 1};
    peri_matrix a;
    peri_cholesky *f = NULL;
    peri_error err;
    memset(&err, 0, sizeof err);
    memset(&a, 0, sizeof a);
    refused_err(__LINE__, &err, peri_cholesky_create(NULL, NULL, NULL, &f, &err) == ARGUMENT, ARGUMENT, "matrix");
    refused_err(__LINE__, &err, peri_cholesky_create(&a, NULL, NULL, NULL, &err) == ARGUMENT, ARGUMENT, "out");
    refused_err(__LINE__, &err, peri_cholesky_factor(NULL, &a, &err) == ARGUMENT, ARGUMENT, "factor");
    MATRIX(INDEX, "n is", a.n = -1);
    MATRIX(ARGUMENT, "row is NULL", a.row = NULL);
    MATRIX(ARGUMENT, "col is NULL", a.col = NULL);
    MATRIX(ARGUMENT, "value", a.value = NULL);
    MATRIX(ARGUMENT, "diagonal", a.diagonal = NULL);
    MATRIX(INDEX, "row[0]", row[0] = 1);
    MATRIX(INDEX, "row 1", row[2] = 0);
    MATRIX(INDEX, "column 3", col[2] = 3);
    MATRIX(INDEX, "column -1", col[0] = -1);
    MATRIX(INDEX, "diagonal", col[0] = 0);
    MATRIX(INDEX, "ascend", (col[1] = 2, col[2] = 0));
    MATRIX(INDEX, "does not store", col[0] = 2);
    MATRIX(VALUE, "coordinate y of row 2", xyz[7] = nan_);
    MATRIX(PERI_ERROR_PIVOT, "not positive definite", diagonal[1] = R(0.5));
    MATRIX(PERI_ERROR_PIVOT, "row 0", diagonal[0] = -1);
    MATRIX(PERI_ERROR_PIVOT, "not positive definite", diagonal[1] = nan_);
    MATRIX(PERI_ERROR_PIVOT, "not positive definite", off[1] = off[0] = nan_);
    a.n = 1;
    a.row = row;
    a.diagonal = diagonal;
    CHECK(peri_cholesky_create(&a, NULL, NULL, &f, &err) == PERI_OK);
    a.n = 2;
    a.row = row2;
    refused_err(__LINE__, &err, peri_cholesky_factor(f, &a, &err) == ARGUMENT, ARGUMENT, "pattern");
    peri_cholesky_destroy(f);
    peri_cholesky_destroy(NULL);
}

/* ---- steps that fail --------------------------------------------------------------------------------------------- */

static int poison;

/* mu/2 |C - 1|^2, or nothing that is a number. */
static double law(const double c[6], double dpsi[6], void *context) {
    double energy = 0;
    int k;
    (void)context;
    for (k = 0; k < 6; k++) {
        double e = c[k] - (k < 3);
        dpsi[k] = poison == 2 ? (double)NAN : 2e4 * e;
        energy += (k < 3 ? 1 : 2) * 1e4 * e * e;
    }
    return poison == 1 ? (double)NAN : energy;
}

/* A world that met failing steps goes on with the same bits as its twin that met none. */
static void failing_law(void) {
    uint64_t hash[2];
    int twin, k;
    for (twin = 0; twin < 2; twin++) {
        peri_material m = peri_material_user(law, NULL, R(4e4), 0, 1000);
        peri_body_def d;
        poison = 0;
        begin();
        d = good_body();
        d.position.x = 1;
        d.material = peri_material_create(S.world, &m);
        CHECK(peri_body_create(S.world, &d).index1 != 0);
        CHECK(peri_world_step(S.world, R(1.0 / 30)) == PERI_OK);
        for (poison = twin ? 3 : 1; poison <= 2; poison++) {
            probe p = probe_now();
            peri_result r = peri_world_step(S.world, R(1.0 / 30));
            refused(__LINE__, &p, r == PERI_ERROR_NUMERIC, PERI_ERROR_NUMERIC, "not finite");
            CHECK(peri_world_stats(S.world).undone == poison);
            memcpy(S.points, peri_body_positions(S.world, S.body), sizeof S.points); /* readable, and a number */
            CHECK(S.points[80] > -10 && S.points[80] < 10);
        }
        poison = 0;
        for (k = 0; k < 3; k++) CHECK(peri_world_step(S.world, R(1.0 / 30)) == PERI_OK);
        CHECK(peri_world_stats(S.world).undone == (twin ? 0 : 2));
        hash[twin] = peri_world_hash(S.world);
        end();
    }
    CHECK(hash[0] == hash[1]);
}

static void cap_is_error(void) {
    int error;
    for (error = 0; error < 2; error++) {
        peri_world_def wd = good_world();
        peri_material m = good_material();
        peri_body_def d;
        peri_collider_def cd = peri_default_collider_def();
        memset(&S, 0, sizeof S);
        lattice(S.points, 3);
        wd.max_iterations = 1;
        wd.tolerance = R(1e-5);
        wd.cap_is_error = error;
        S.world = peri_world_create(&wd, NULL);
        S.soft = peri_material_create(S.world, &m);
        d = good_body();
        d.position.z = R(-0.02); /* pressed into the floor: no rigid motion solves this */
        CHECK(peri_body_create(S.world, &d).index1 && peri_collider_create(S.world, &cd).index1);
        if (error) {
            CALL(PERI_ERROR_CONVERGENCE, "max_iterations", peri_world_step(S.world, R(1.0 / 30)));
            CALL(PERI_ERROR_CONVERGENCE, "tolerance", peri_world_step(S.world, R(1.0 / 30)));
        } else {
            CHECK(peri_world_step(S.world, R(1.0 / 30)) == PERI_OK);
        }
        CHECK(peri_world_stats(S.world).converged == 0);
        CHECK(peri_world_stats(S.world).undone == 2 * error);
        CHECK(peri_world_stats(S.world).iterations == 1);
        peri_world_destroy(S.world);
    }
}

/* ---- memory ------------------------------------------------------------------------------------------------------ */

/* An allocator that fails at will. It remembers the size of every block in front of it, always moves, and fills what is
   new and what is given back with rubbish, so that stale pointers and forgotten fields show. */
typedef struct bank {
    long calls, fail_at;    /* the fail_at-th request is refused, counted from 1 */
    int lasting;            /* and all later ones too, until the call that met it has returned */
    size_t held;
    long wrong_sizes;
} bank;

#define HEAD 64

static void *bank_resize(void *ptr, size_t old_bytes, size_t new_bytes, void *user) {
    bank *b = (bank *)user;
    char *block = ptr ? (char *)ptr - HEAD : NULL, *now = NULL;
    size_t size = 0;
    if (block) {
        memcpy(&size, block, sizeof size);
        b->wrong_sizes += size != old_bytes;
    }
    if (new_bytes) {
        b->calls++;
        if (b->calls == b->fail_at || (b->lasting && b->fail_at && b->calls > b->fail_at)) return NULL;
        now = (char *)malloc(new_bytes + HEAD);
        if (!now) return NULL;
        memcpy(now, &new_bytes, sizeof new_bytes);
        memset(now + HEAD, 0xA5, new_bytes);
        if (block) memcpy(now + HEAD, ptr, size < new_bytes ? size : new_bytes);
        b->held += new_bytes;
    }
    if (block) {
        memset(block, 0x5A, HEAD + size);
        free(block);
        b->held -= size;
    }
    return now ? now + HEAD : NULL;
}

/* One run of the scenario below. */
typedef struct trial {
    bank bank;
    peri_world_def def;
    int walk;           /* 1: a step before a refused call is made again */
    int refusals;       /* calls that failed for want of memory */
    int fallbacks;      /* notes in the log that are no errors: Chebyshev for want of a factor */
    uint64_t hash;      /* at the end */
} trial;

static void count_fallbacks(const char *text, void *user) {
    if (strstr(text, "no room for a factor")) ((trial *)user)->fallbacks++;
}

/* After a refused call: the reason is memory, nothing has changed; then memory is back. */
static void refused_for_memory(trial *t, peri_world *w, uint64_t hash, const peri_stats *s) {
    peri_stats now = peri_world_stats(w);
    t->refusals++;
    CHECK(peri_last_error(w)->code == PERI_ERROR_MEMORY);
    CHECK(strlen(peri_last_error(w)->text) > 10);
    CHECK(peri_world_hash(w) == hash);
    CHECK(now.bodies == s->bodies && now.particles == s->particles && now.bonds == s->bonds);
    CHECK(now.colliders == s->colliders && now.skins == s->skins && now.contacts == s->contacts);
    t->bank.fail_at = 0;
    if (t->walk) CHECK(peri_world_step(w, R(1.0 / 60)) == PERI_OK);
}

/* Makes a call; if it is refused, once more. */
#define TRY(done) \
    do { \
        uint64_t hash_ = peri_world_hash(w); \
        peri_stats stats_ = peri_world_stats(w); \
        if (!(done)) { \
            refused_for_memory(t, w, hash_, &stats_); \
            CHECK(done); \
        } else if (t->bank.fail_at && t->bank.calls >= t->bank.fail_at) { \
            t->bank.fail_at = 0; \
        } \
    } while (0)

static void scenario(trial *t) {
    static peri_real points[3 * 64], forces[3 * 64], skin_out[9];
    static const unsigned char fixed[64] = {1};
    static const int triangle[3] = {0, 1, 2};
    peri_world_def wd = t->def;
    peri_material rubber = good_material(), cloth = projective();
    peri_material_id soft = {0, 0}, firm = {0, 0};
    peri_body_def bd = peri_default_body_def();
    peri_body_id one = {0, 0}, two = {0, 0}, three = {0, 0};
    peri_collider_def cd = peri_default_collider_def();
    peri_skin_id skin = {0, 0};
    peri_error err;
    peri_world *w;
    int k;
    lattice(points, 4);
    wd.memory.resize = bank_resize;
    wd.memory.user = &t->bank;
    wd.log = count_fallbacks;
    wd.user = t;
    memset(&err, 0, sizeof err);
    w = peri_world_create(&wd, &err);
    if (!w) {
        t->refusals++;
        CHECK(err.code == PERI_ERROR_MEMORY && t->bank.held == 0);
        t->bank.fail_at = 0;
        w = peri_world_create(&wd, &err);
        CHECK(w != NULL);
        if (!w) return;
    }
    TRY((soft = peri_material_create(w, &rubber)).index1);
    TRY((firm = peri_material_create(w, &cloth)).index1);
    bd.points = points;
    bd.count = 64;
    bd.spacing = R(SPACING);
    bd.material = soft;
    bd.position.z = R(0.06);
    TRY((one = peri_body_create(w, &bd)).index1);
    TRY(peri_collider_create(w, &cd).index1);
    TRY((skin = peri_skin_create(w, one, points, 3, triangle, 1)).index1);
    TRY(peri_world_step(w, R(1.0 / 60)) == PERI_OK);
    bd.position.x = 1;
    bd.fixed = fixed;
    TRY((two = peri_body_create(w, &bd)).index1);
    for (k = 0; k < 3 * 64; k++) forces[k] = R(0.1);
    TRY(peri_body_set_forces(w, two, 0, 64, forces) == PERI_OK);
    TRY(peri_body_move(w, two, 0, vec(1, 0, 0.07)) == PERI_OK);
    TRY(peri_world_step(w, R(1.0 / 60)) == PERI_OK);
    bd.material = firm; /* another model: wider rows */
    bd.position.x = 2;
    TRY((three = peri_body_create(w, &bd)).index1);
    TRY(peri_world_step(w, R(1.0 / 60)) == PERI_OK);
    CHECK(peri_skin_update(w, skin, skin_out, NULL) == PERI_OK);
    CHECK(peri_body_destroy(w, one) == PERI_OK);
    TRY(peri_world_step(w, R(1.0 / 60)) == PERI_OK);
    TRY(peri_world_step(w, R(1.0 / 20)) == PERI_OK); /* another step size: matrices anew */
    t->hash = peri_world_hash(w);
    CHECK(peri_body_count(w, three) == 64);
    peri_world_destroy(w);
    CHECK(t->bank.held == 0);
    CHECK(t->bank.wrong_sizes == 0);
}

/* The scenario with its n-th request refused, for every n. Where no detour is taken, the end must be the same to the
   bit as with plenty of memory. */
static void starve(peri_solver solver, peri_integrator integrator, int lasting, int walk) {
    trial t, plenty;
    long n;
    memset(&t, 0, sizeof t);
    t.def = peri_default_world_def();
    t.def.solver = solver;
    t.def.integrator = integrator;
    t.walk = walk;
    plenty = t;
    scenario(&plenty);
    CHECK(plenty.refusals == 0 && plenty.bank.calls > 20);
    for (n = 1; n <= plenty.bank.calls && test_bad == 0; n++) {
        trial now = t;
        now.bank.fail_at = n;
        now.bank.lasting = lasting;
        scenario(&now);
        CHECK(now.bank.fail_at == 0);
        CHECK(now.refusals + now.fallbacks >= 1);
        if (!walk && !now.fallbacks) CHECK(now.hash == plenty.hash);
        if (test_bad) printf("    request %ld of %ld, solver %d, lasting %d, walk %d\n", n, plenty.bank.calls,
                             (int)solver, lasting, walk);
    }
}

static void failing_memory_cholesky(void) { starve(PERI_SOLVER_CHOLESKY, PERI_BACKWARD_EULER, 0, 0); }
static void failing_memory_chebyshev(void) { starve(PERI_SOLVER_CHEBYSHEV, PERI_BDF2, 0, 0); }
static void failing_memory_auto(void) { starve(PERI_SOLVER_AUTO, PERI_BACKWARD_EULER, 0, 0); }
static void memory_gone_for_a_call(void) {
    starve(PERI_SOLVER_AUTO, PERI_BDF2, 1, 0);
    starve(PERI_SOLVER_JACOBI, PERI_BACKWARD_EULER, 1, 0);
}
static void steps_between_failures(void) {
    starve(PERI_SOLVER_CHOLESKY, PERI_BDF2, 0, 1);
    starve(PERI_SOLVER_AUTO, PERI_BACKWARD_EULER, 1, 1);
}

/* ---- a world in the caller's buffer ------------------------------------------------------------------------------ */

static long hook_calls;

static void *never(void *ptr, size_t old_bytes, size_t new_bytes, void *user) {
    (void)ptr;
    (void)old_bytes;
    (void)new_bytes;
    (void)user;
    hook_calls++;
    return NULL;
}

static peri_world_def small_world(size_t spare) {
    peri_world_def d = good_world();
    d.max_particles = 54;
    d.max_bonds = 632; /* of two lattices of 27 */
    d.max_bodies = 2;
    d.max_materials = 1;
    d.max_colliders = 1;
    d.max_skins = 1;
    d.spare_bytes = spare;
    d.memory.resize = never;
    return d;
}

static void buffer_errors(void) {
    peri_world_def d = small_world(0);
    size_t bytes = peri_world_size(&d);
    double *buffer = (double *)malloc(bytes + sizeof *buffer);
    peri_error err;
    memset(&err, 0, sizeof err);
    CHECK(bytes > 10000);
    refused_err(__LINE__, &err, !peri_world_create_in(&d, NULL, bytes, &err), ARGUMENT, "buffer");
    refused_err(__LINE__, &err, !peri_world_create_in(&d, (char *)buffer + 1, bytes, &err), ARGUMENT, "aligned");
    refused_err(__LINE__, &err, !peri_world_create_in(&d, buffer, bytes - 1, &err), LIMIT, "peri_world_size");
    refused_err(__LINE__, &err, !peri_world_create_in(&d, buffer, 0, &err), LIMIT, "0 bytes");
    refused_err(__LINE__, &err, !peri_world_create_in(NULL, buffer, bytes, &err), ARGUMENT, "definition");
    CHECK(!peri_world_create_in(&d, buffer, bytes - 1, NULL));
    d.sweeps = 0;
    refused_err(__LINE__, &err, !peri_world_create_in(&d, buffer, bytes, &err), VALUE, "sweeps");
    d = small_world(SIZE_MAX / 2); /* the sum would pass size_t */
    CHECK(peri_world_size(&d) == 0);
    refused_err(__LINE__, &err, !peri_world_create_in(&d, buffer, bytes, &err), LIMIT, "buffer");
    free(buffer);
}

/* To the limits, and beyond; with room for factors and without. */
static void buffer_works(void) {
    static const size_t spares[3] = {0, 60000, 1000000};
    int which, k;
    for (which = 0; which < 3; which++) {
        peri_world_def wd = small_world(spares[which]);
        size_t bytes = peri_world_size(&wd);
        void *buffer = malloc(bytes); /* no more: a sanitizer sees what goes beyond */
        peri_material m = good_material();
        peri_collider_def cd = peri_default_collider_def();
        peri_body_def d;
        peri_body_id one;
        peri_real forces[81];
        peri_error err;
        memset(&S, 0, sizeof S);
        lattice(S.points, 3);
        hook_calls = 0;
        S.world = peri_world_create_in(&wd, buffer, bytes, &err);
        CHECK(S.world != NULL);
        if (!S.world) {
            free(buffer);
            continue;
        }
        S.soft = peri_material_create(S.world, &m);
        CHECK(S.soft.index1 != 0);
        d = good_body();
        one = peri_body_create(S.world, &d);
        CHECK(one.index1 != 0);
        d.position.x = 1;
        S.body = peri_body_create(S.world, &d);
        CHECK(S.body.index1 != 0);
        CHECK(peri_collider_create(S.world, &cd).index1 != 0);
        CHECK(peri_material_create(S.world, &m).index1 == 0 && peri_last_error(S.world)->code == LIMIT);
        CHECK(peri_collider_create(S.world, &cd).index1 == 0 && peri_last_error(S.world)->code == LIMIT);
        BODY(LIMIT, "max_particles", d.count = 1);
        for (k = 0; k < 81; k++) forces[k] = R(0.01);
        CHECK(peri_body_set_forces(S.world, S.body, 0, 27, forces) == PERI_OK);
        CHECK(peri_body_set_fixed(S.world, S.body, 26, 1) == PERI_OK);
        CHECK(peri_body_move(S.world, S.body, 26, vec(1.2, 0.2, 0.3)) == PERI_OK);
        for (k = 0; k < 10; k++) CHECK(peri_world_step(S.world, R(1.0 / 30)) == PERI_OK);
        CHECK(peri_world_step(S.world, R(1.0 / 10)) == PERI_OK);
        CHECK(peri_world_stats(S.world).contacts > 0);
        CHECK(which < 2 || peri_world_stats(S.world).factors > 0); /* else Chebyshev will do */
        if (which == 2) {
            S.skin = peri_skin_create(S.world, S.body, S.points, 3, NULL, 0);
            CHECK(S.skin.index1 != 0);
        }
        /* bodies come and go: the places of the old ones must serve the new ones */
        for (k = 0; k < 40; k++) {
            int n = 2 + k % 2;
            CHECK(peri_body_destroy(S.world, one) == PERI_OK);
            lattice(S.points, n);
            d = good_body();
            d.count = n * n * n;
            one = peri_body_create(S.world, &d);
            CHECK(one.index1 != 0);
            CHECK(peri_world_step(S.world, R(1.0 / 30)) == PERI_OK);
        }
        CHECK(peri_world_stats(S.world).bytes <= bytes && peri_world_stats(S.world).bytes_peak <= bytes);
        CHECK(hook_calls == 0);
        peri_world_destroy(S.world);
        CHECK(hook_calls == 0);
        free(buffer);
    }
}

static void enough_rows(void) {
    if (!test_only) printf("    %d wrong calls\n", rows);
    CHECK(test_only || rows >= 60);
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(worlds);
    RUN(steps);
    RUN(no_world);
    RUN(materials);
    RUN(body_definitions);
    RUN(body_limit);
    RUN(bond_limit);
    RUN(body_ids);
    RUN(body_arguments);
    RUN(collider_definitions);
    RUN(colliders);
    RUN(sampling);
    RUN(skins);
    RUN(drawing);
    RUN(matrices);
    RUN(failing_law);
    RUN(cap_is_error);
    RUN(buffer_errors);
    RUN(buffer_works);
    RUN(failing_memory_cholesky);
    RUN(failing_memory_chebyshev);
    RUN(failing_memory_auto);
    RUN(memory_gone_for_a_call);
    RUN(steps_between_failures);
    RUN(enough_rows);
    return test_end();
}
