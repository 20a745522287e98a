/* test_touch.c - the odd corners of contact: buffers, failing steps and memory, removal, teleports, threads, coincident
 * and tiny bodies, who touches whom, who wakes whom. What contact is for is in test_contact.c. */
#define PERI_IMPLEMENTATION
#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#endif
#include "../peri.h"

#include "test.h"

#include "scenes.h"

#define DT ((peri_real)(1 / 60.0))

static peri_material rubber(double young) { return peri_material_neo_hookean((peri_real)young, (peri_real)0.3, 1000); }

static peri_world *world_of(const peri_world_def *d) {
    peri_error err;
    peri_world *w = peri_world_create(d, &err);
    if (!w) printf("    world: %s\n", err.text), test_bad++;
    return w;
}

/* A body of n * n * n points by the definition *d, its middle at x, y, z. */
static peri_body_id cube(peri_world *w, const peri_body_def *def, int n, double d, double x, double y, double z) {
    peri_body_def b = *def;
    peri_real *points = lattice(n, n, n, d);
    peri_body_id id;
    b.points = points;
    b.count = n * n * n;
    b.spacing = (peri_real)d;
    b.position = vec3(x, y, z);
    id = peri_body_create(w, &b);
    free(points);
    if (!peri_body_is_valid(w, id)) complain_of(w, "body");
    return id;
}

static peri_body_def body_of(peri_world *w, double young) {
    peri_material m = rubber(young);
    peri_body_def b = peri_default_body_def();
    b.material = peri_material_create(w, &m);
    return b;
}

static void ground(peri_world *w) {
    peri_collider_def c = peri_default_collider_def();
    peri_collider_create(w, &c);
}

static void run(peri_world *w, int steps) {
    int k;
    for (k = 0; k < steps; k++)
        if (peri_world_step(w, DT)) {
            complain_of(w, "step");
            return;
        }
}

static peri_measure measure(peri_world *w, peri_body_id id) {
    peri_measure m;
    memset(&m, 0, sizeof m);
    if (peri_body_measure(w, id, &m)) complain_of(w, "measure");
    return m;
}

/* ---- memory ------------------------------------------------------------------------------------------------------ */

static int hook_calls;
static void *never(void *ptr, size_t old_bytes, size_t new_bytes, void *user) {
    (void)ptr;
    (void)old_bytes;
    (void)new_bytes;
    (void)user;
    hook_calls++;
    return NULL;
}

/* Particles that are bodies of their own, packed closely, in a buffer: twelve neighbours each. */
static void grains_in_a_buffer(void) {
    peri_world_def d = peri_default_world_def();
    peri_world *w;
    peri_body_def b;
    peri_error err;
    void *buffer;
    size_t bytes;
    int i, j, k;
    d.max_particles = d.max_bodies = 64;
    d.max_bonds = 64;
    d.max_materials = d.max_colliders = d.max_skins = d.max_attachments = 1;
    d.spare_bytes = 1 << 20;
    d.memory.resize = never;
    bytes = peri_world_size(&d);
    buffer = malloc(bytes);
    hook_calls = 0;
    w = peri_world_create_in(&d, buffer, bytes, &err);
    CHECK(w != NULL);
    if (!w) return;
    ground(w);
    b = body_of(w, 1e6);
    for (i = 0; i < 4; i++)
        for (j = 0; j < 4; j++)
            for (k = 0; k < 4; k++)
                cube(w, &b, 1, 0.1, 0.1 * i + 0.05 * (k % 2), 0.1 * j + 0.05 * (k % 2), 0.05 + 0.071 * k);
    run(w, 60);
    CHECK(peri_world_stats(w).contacts > 0);
    CHECK(hook_calls == 0);
    free(buffer);
}

/* Bodies within the limits come, touch and go in a buffer; everything that has a limit is there from the start. */
static void cubes_in_a_buffer(void) {
    peri_world_def d = peri_default_world_def();
    peri_world *w;
    peri_body_def b;
    peri_body_id id[8];
    peri_error err;
    void *buffer;
    size_t bytes;
    int k;
    d.max_particles = 8 * 27;
    d.max_bodies = 8;
    d.max_bonds = 8 * 316;
    d.max_materials = d.max_colliders = 1;
    d.max_skins = 0;
    d.max_attachments = 2;
    d.spare_bytes = 1 << 20;
    d.memory.resize = never;
    bytes = peri_world_size(&d);
    buffer = malloc(bytes);
    hook_calls = 0;
    w = peri_world_create_in(&d, buffer, bytes, &err);
    CHECK(w != NULL);
    if (!w) return;
    ground(w);
    b = body_of(w, 1e5);
    b.self_contact = 1;
    for (k = 0; k < 8; k++) id[k] = cube(w, &b, 3, 0.1, 0.31 * (k % 2), 0.31 * (k / 2 % 2), 0.16 + 0.31 * (k / 4));
    run(w, 30);
    CHECK(peri_world_stats(w).contacts > 0);
    for (k = 0; k < 60; k++) {
        int at = k * 5 % 8;
        CHECK(peri_body_destroy(w, id[at]) == PERI_OK);
        run(w, 2);
        id[at] = cube(w, &b, k % 7 ? 3 : 2, 0.1, 0.31 * (at % 2), 0.31 * (at / 2 % 2), 0.16 + 0.31 * (at / 4) + 0.4);
        run(w, 4);
        if (test_bad) break;
    }
    CHECK(hook_calls == 0);
    free(buffer);
}

/* With limits exactly at what a scene needs, it runs: contacts that touch count, and what touched before does not. */
static void contact_limit(void) {
    peri_world_def d = peri_default_world_def();
    peri_world *w;
    peri_body_def b;
    int most = 0, k, tight;
    for (tight = 0; tight < 2; tight++) {
        if (tight) d.max_contacts = most;
        w = world_of(&d);
        if (!w) return;
        ground(w);
        b = body_of(w, 1e5);
        cube(w, &b, 3, 0.1, 0, 0, 0.151);
        for (k = 0; k < 60; k++) {
            run(w, 1);
            if (test_bad) break;
            if (w->contact_count > most) most = w->contact_count;
        }
        peri_world_destroy(w);
    }
}

/* Steps with contacts, attachments and sleep allocate nothing once all have met. */
static void settled_steps(void) {
    peri_world_def d = peri_default_world_def();
    peri_world *w;
    peri_body_def b;
    peri_attachment_def a = peri_default_attachment_def();
    peri_body_id id[6];
    size_t before;
    int k;
    d.sleep_speed = 0;
    w = world_of(&d);
    if (!w) return;
    ground(w);
    b = body_of(w, 1e5);
    for (k = 0; k < 6; k++) id[k] = cube(w, &b, 4, 0.05, 0.02 * k, 0.01 * k, 0.11 + 0.22 * k);
    a.body = id[0];
    a.other = id[5];
    a.rope = 1;
    CHECK(peri_attachment_create(w, &a).index1);
    run(w, 240);    /* until the stack stands and each cube has taken the factor that it keeps */
    before = peri_world_stats(w).allocations;
    run(w, 120);
    CHECK(peri_world_stats(w).allocations == before);
    CHECK(peri_world_stats(w).contacts > 0);
    peri_world_destroy(w);
}

typedef struct bank {
    long calls, fail_at;
    size_t held;
} bank;

/* Refuses the fail_at-th request; always moves; fills what is new and what is given back with rubbish. */
static void *bank_resize(void *ptr, size_t old_bytes, size_t new_bytes, void *user) {
    bank *k = (bank *)user;
    char *now = NULL;
    if (new_bytes) {
        if (++k->calls == k->fail_at) return NULL;
        now = (char *)malloc(new_bytes);
        if (!now) return NULL;
        memset(now, 0xA5, new_bytes);
        if (ptr) memcpy(now, ptr, old_bytes < new_bytes ? old_bytes : new_bytes);
        k->held += new_bytes;
    }
    if (ptr) {
        memset(ptr, 0x5A, old_bytes);
        free(ptr);
        k->held -= old_bytes;
    }
    return now;
}

#define AGAIN(done) \
    do { \
        uint64_t hash_ = peri_world_hash(w); \
        if (!(done)) { \
            refusals++; \
            CHECK(peri_last_error(w)->code == PERI_ERROR_MEMORY); \
            CHECK(peri_world_hash(w) == hash_); \
            CHECK(done); \
        } \
    } while (0)

/* Bodies that meet, are joined and part, with one request for memory refused. Returns the hash of the end. */
static uint64_t starving(bank *k, int *met) {
    peri_world_def d = peri_default_world_def();
    peri_world *w;
    peri_body_def b;
    peri_material m = rubber(1e5);
    peri_attachment_def a = peri_default_attachment_def();
    peri_collider_def c = peri_default_collider_def();
    peri_body_id id[10];
    peri_attachment_id join[10];
    peri_real *points = lattice(2, 2, 2, 0.1);
    peri_error err;
    uint64_t hash;
    int n, refusals = 0;
    d.memory.resize = bank_resize;
    d.memory.user = k;
    w = peri_world_create(&d, &err);
    if (!w) {
        refusals++;
        w = peri_world_create(&d, &err);
    }
    memset(&b, 0, sizeof b);
    b = peri_default_body_def();
    b.points = points;
    b.count = 8;
    b.spacing = (peri_real)0.1;
    b.self_contact = 1;
    AGAIN((b.material = peri_material_create(w, &m)).index1);
    AGAIN(peri_collider_create(w, &c).index1);
    for (n = 0; n < 9; n++) {
        b.position = vec3(0.21 * (n % 3), 0.21 * (n / 3 % 3), 0.09);
        AGAIN((id[n] = peri_body_create(w, &b)).index1);
        a.body = id[n];
        a.other = id[0];
        if (n) AGAIN((join[n] = peri_attachment_create(w, &a)).index1);
    }
    for (n = 0; n < 3; n++) AGAIN(peri_world_step(w, DT) == PERI_OK);
    CHECK(peri_attachment_destroy(w, join[2]) == PERI_OK);
    CHECK(peri_body_destroy(w, id[4]) == PERI_OK);
    CHECK(!peri_attachment_is_valid(w, join[4]) && peri_attachment_is_valid(w, join[5]));
    for (n = 0; n < 3; n++) AGAIN(peri_world_step(w, DT) == PERI_OK);
    hash = peri_world_hash(w);
    *met = peri_world_stats(w).contacts;
    peri_world_destroy(w);
    CHECK(k->held == 0);
    free(points);
    if (k->fail_at) CHECK(refusals == 1 || hash != 0);
    return hash;
}

static void failing_memory(void) {
    bank plenty = {0, 0, 0}, k;
    int met, fallbacks = 0;
    uint64_t wanted = starving(&plenty, &met), hash;
    long n;
    CHECK(met > 0);
    for (n = 1; n <= plenty.calls && !test_bad; n++) {
        memset(&k, 0, sizeof k);
        k.fail_at = n;
        hash = starving(&k, &met);
        fallbacks += hash != wanted;    /* a factor that was refused: Chebyshev instead */
        if (test_bad) printf("    request %ld of %ld\n", n, plenty.calls);
    }
    printf("    %ld requests refused, %d ended in another way\n", plenty.calls, fallbacks);
}

/* ---- steps that fail --------------------------------------------------------------------------------------------- */

/* A step that fails leaves sleepers asleep: the world is as it was, hash and all. */
static void failed_step_wakes_nobody(void) {
    peri_world_def d = peri_default_world_def();
    peri_world *w;
    peri_body_def b;
    peri_body_id low, high;
    uint64_t hash;
    int k, failed = 0;
    d.cap_is_error = 1;
    w = world_of(&d);
    if (!w) return;
    ground(w);
    b = body_of(w, 1e5);
    low = cube(w, &b, 4, 0.05, 0, 0, 0.101);
    run(w, 200);
    CHECK(peri_body_is_asleep(w, low));
    b.velocity = vec3(0, 0, -3);
    high = cube(w, &b, 4, 0.05, 0.01, 0.02, 0.5);
    for (k = 0; k < 20 && peri_body_is_asleep(w, low); k++) {
        hash = peri_world_hash(w);
        w->def.max_iterations = 1;      /* not enough to land */
        w->def.tolerance = (peri_real)1e-5;
        if (peri_world_step(w, DT)) {
            failed++;
            CHECK(peri_world_hash(w) == hash);
            CHECK(peri_body_is_asleep(w, low));
            CHECK(peri_world_stats(w).asleep == 1);
        } else {
            continue;   /* it flies freely */
        }
        w->def.max_iterations = 200;
        w->def.tolerance = d.tolerance;
        run(w, 1);
    }
    CHECK(failed > 0);
    CHECK(!peri_body_is_asleep(w, low) && peri_body_is_valid(w, high));
    run(w, 300);
    CHECK(peri_world_stats(w).asleep == 2);
    peri_world_destroy(w);
}

/* ---- odd bodies -------------------------------------------------------------------------------------------------- */

/* Two bodies in the same place, point upon point: numbers stay finite, momentum is kept, and they come apart. */
static void coincident(void) {
    peri_world_def d = peri_default_world_def();
    int n;
    for (n = 1; n <= 3; n += 2) {
        peri_world *w;
        peri_body_def b;
        peri_body_id one, two, all = {0, 0};
        peri_measure p, q, s;
        double apart[3];
        int k;
        d.gravity = vec3(0, 0, 0);
        w = world_of(&d);
        if (!w) return;
        b = body_of(w, 1e5);
        one = cube(w, &b, n, 0.1, 0, 0, 0);
        two = cube(w, &b, n, 0.1, 0, 0, 0);
        run(w, 60);
        p = measure(w, one);
        q = measure(w, two);
        s = measure(w, all);
        for (k = 0; k < 3; k++) apart[k] = p.centre[k] - q.centre[k];
        printf("    %d points on as many: after 1 s centres %.3g d apart, momentum %.2g of %.2g\n", n * n * n,
               norm(apart, 3) / 0.1, norm(s.momentum, 3), sqrt(2 * s.mass * s.kinetic));
        CHECK(norm(s.momentum, 3) <= 100 * EPS * (sqrt(2 * s.mass * s.kinetic) + s.mass * 1e-6));
        if (n == 1) CHECK(norm(apart, 3) > 0.09);   /* single particles: until they no longer touch */
        peri_world_destroy(w);
    }
}

/* A single particle on a single particle on the floor, and one in the air. */
static void single_particles(void) {
    peri_world_def d = peri_default_world_def();
    peri_world *w = world_of(&d);
    peri_body_def b;
    peri_body_id low, high;
    int k;
    if (!w) return;
    ground(w);
    b = body_of(w, 1e6);
    low = cube(w, &b, 1, 0.1, 0, 0, 0.051);
    high = cube(w, &b, 1, 0.1, 0, 0, 0.152);
    for (k = 0; k < 30; k++) run(w, 1);
    /* its stiffness is m/h^2 alone: it sinks by g h^2 a weight, twice that where half of it counts */
    NEAR(measure(w, low).centre[2], 0.05, 3 * 9.81 / 3600 + 0.001);
    NEAR(measure(w, high).centre[2] - measure(w, low).centre[2], 0.1, 2 * 9.81 / 3600 + 0.001);
    peri_world_destroy(w);
}

/* contact_radius 0: such a body touches those that have one, at theirs; two such do not touch, nor does one itself. */
static void no_radius(void) {
    peri_world_def d = peri_default_world_def();
    int both;
    for (both = 0; both < 2; both++) {
        peri_world *w = world_of(&d);
        peri_body_def b;
        peri_body_id low, high;
        unsigned char fixed[27];
        if (!w) return;
        memset(fixed, 1, sizeof fixed);
        b = body_of(w, 1e5);
        b.fixed = fixed;
        b.contact_radius = both ? 0 : (peri_real)0.5;
        b.self_contact = 1;
        low = cube(w, &b, 3, 0.1, 0, 0, 0);
        b.fixed = NULL;
        b.contact_radius = 0;
        high = cube(w, &b, 3, 0.1, 0.02, 0.03, 0.3);
        run(w, 60);
        if (both) CHECK(measure(w, high).centre[2] < -1);
        else NEAR(measure(w, high).lower[2] - measure(w, low).upper[2], 0.05, 0.01);
        CHECK(both ? peri_world_stats(w).contacts == 0 : peri_world_stats(w).contacts > 0);
        peri_world_destroy(w);
    }
}

/* Bodies touch when each one's group meets the other's touches: both ways. */
static void groups(void) {
    static const uint32_t bits[5][4] = {    /* group, touches of the lower; of the upper */
        {1, ~0u, 1, ~0u}, {1, 2, 2, 1}, {1, 2, 2, 4}, {1, 4, 2, 1}, {1, 0, 1, ~0u}};
    static const int meet[5] = {1, 1, 0, 0, 0};
    int k;
    for (k = 0; k < 5; k++) {
        peri_world_def d = peri_default_world_def();
        peri_world *w = world_of(&d);
        peri_body_def b;
        peri_body_id high;
        unsigned char fixed[27];
        if (!w) return;
        memset(fixed, 1, sizeof fixed);
        b = body_of(w, 1e5);
        b.fixed = fixed;
        b.group = bits[k][0];
        b.touches = bits[k][1];
        cube(w, &b, 3, 0.1, 0, 0, 0);
        b.fixed = NULL;
        b.group = bits[k][2];
        b.touches = bits[k][3];
        high = cube(w, &b, 3, 0.1, 0.02, 0.03, 0.31);
        run(w, 30);
        CHECK((measure(w, high).centre[2] > 0.25) == meet[k]);
        peri_world_destroy(w);
    }
}

/* A fine plate under a coarse body: more particles in reach of a foot than a patch holds; it rests all the same. */
static void crowded_patch(void) {
    peri_world_def d = peri_default_world_def();
    peri_world *w = world_of(&d);
    peri_body_def b, slab;
    peri_body_id high;
    peri_real *points = lattice(40, 40, 1, 0.02);
    unsigned char fixed[1600];
    peri_contact *touch = (peri_contact *)malloc(4000 * sizeof *touch);
    double carried = 0;
    int k, count;
    if (!w) return;
    memset(fixed, 1, sizeof fixed);
    b = body_of(w, 1e6);
    slab = b;
    slab.points = points;
    slab.fixed = fixed;
    slab.count = 1600;
    slab.spacing = (peri_real)0.02;
    CHECK(peri_body_create(w, &slab).index1);
    high = cube(w, &b, 3, 0.15, 0.003, 0.007, 0.24);
    run(w, 240);
    peri_world_contacts(w, touch, 4000, &count);
    for (k = 0; k < count; k++)
        carried += (touch[k].body.index1 == high.index1 ? 1 : -1) * (double)touch[k].force.z;
    /* at rest the contacts bear the weight; 1 %: what 1e-3 d leaves for the softest contact */
    NEAR(carried / (measure(w, high).mass * 9.81), 1, 0.01);
    NEAR(measure(w, high).lower[2], 0.085, 0.01 * 0.15);
    free(points);
    free(touch);
    peri_world_destroy(w);
}

/* ---- who sleeps, who wakes --------------------------------------------------------------------------------------- */

/* A pile of two and one apart, asleep. */
static peri_world *sleepers(peri_body_id id[3], peri_collider_id *solid, double sleep_speed) {
    peri_world_def d = peri_default_world_def();
    peri_collider_def c = peri_default_collider_def();
    peri_world *w;
    peri_body_def b;
    int k;
    d.sleep_speed = (peri_real)sleep_speed;
    w = world_of(&d);
    c.shape = peri_shape_box(2, 2, (peri_real)0.5);
    c.position = vec3(0, 0, -0.5);
    *solid = peri_collider_create(w, &c);
    b = body_of(w, 1e6);
    for (k = 0; k < 3; k++) id[k] = cube(w, &b, 4, 0.05, k == 2, 0, k == 1 ? 0.303 : 0.101);
    for (k = 0; k < 240; k++) {
        run(w, 1);
        /* games put a collider where their body is, every frame: that must not keep awake what rests on it */
        peri_collider_set_pose(w, *solid, vec3(0, 0, -0.5), axis_quat(2, 0));
    }
    return w;
}

/* Each change wakes the pile that it concerns, both bodies of it, and not the other; then they sleep again where they
   were: an awake step at rest moves nothing by more than its tolerance, 1e-3 d, 300 times. */
static void changes_wake(void) {
    peri_body_id id[3];
    peri_collider_id solid;
    peri_world *w = sleepers(id, &solid, 0.05);
    peri_real zero[3] = {0, 0, 0};
    peri_vec3 push = vec3(0, 0, 0);
    double weight = 3 * 0.008 * 1000 * 9.81, before = measure(w, id[1]).centre[2];
    int k, count, again;
    uint64_t frozen;
    CHECK(peri_world_stats(w).asleep == 3);
    frozen = peri_world_hash(w);
    run(w, 60);
    CHECK(peri_world_hash(w) == frozen && peri_world_stats(w).iterations == 0 && peri_world_stats(w).islands == 0);
    peri_world_contacts(w, NULL, 0, &count);
    CHECK(count > 0);
    peri_collider_impulse(w, solid, &push, NULL);
    NEAR(-(double)push.z * 60, weight, 0.01 * weight);
    peri_world_step(w, DT / 2);
    peri_collider_impulse(w, solid, &push, NULL);
    NEAR(-(double)push.z * 120, weight, 0.01 * weight);
    for (k = 0; k < 4; k++) {
        switch (k) {
        case 0: peri_body_set_velocities(w, id[0], 0, 1, zero); break;
        case 1: peri_body_wake(w, id[1]); break;
        case 2: peri_body_set_positions(w, id[1], 5, 1, peri_body_positions(w, id[1]) + 15); break;
        default: peri_body_set_fixed(w, id[0], 3, 1); break;
        }
        CHECK(!peri_body_is_asleep(w, id[0]) && !peri_body_is_asleep(w, id[1]) && peri_body_is_asleep(w, id[2]));
        for (again = 0; again < 300 && peri_world_stats(w).asleep < 3; again++) run(w, 1);
        CHECK(peri_world_stats(w).asleep == 3);
        NEAR(measure(w, id[1]).centre[2], before, 300 * 1e-3 * 0.05);
    }
    peri_collider_set_pose(w, solid, vec3(0, 0, -0.501), axis_quat(2, 0));     /* 1 mm lower: all fall after it */
    run(w, 1);
    CHECK(peri_world_stats(w).asleep == 0);
    run(w, 300);
    CHECK(peri_world_stats(w).asleep == 3);
    CHECK(!peri_collider_destroy(w, solid));
    CHECK(peri_world_stats(w).asleep == 0);
    run(w, 60);
    CHECK(measure(w, id[2]).centre[2] < -1);
    peri_world_destroy(w);
    w = sleepers(id, &solid, 0);
    CHECK(peri_world_stats(w).asleep == 0);
    peri_world_destroy(w);
}

/* ---- the same bits ----------------------------------------------------------------------------------------------- */

/* Pieces from the last to the first. */
static void backwards(int count, int grain, peri_task *task, void *context, void *user) {
    int k;
    (void)user;
    for (k = (count - 1) / grain; k >= 0; k--)
        task(k * grain, (k + 1) * grain < count ? (k + 1) * grain : count, context);
}

/* What a game does, at random: bodies come, go, leap, are joined and pushed while they touch or sleep. Whatever it is,
   steps succeed or say why, numbers stay finite, and the same calls give the same bits: with pieces of loops in another
   order, and in a buffer. */
static uint64_t turmoil(int how, uint64_t seed, int steps) {
    peri_world_def d = peri_default_world_def();
    peri_collider_def c = peri_default_collider_def();
    peri_world *w;
    peri_body_def b;
    peri_body_id id[6];
    peri_attachment_id tie[4];
    void *buffer = NULL;
    uint64_t hash;
    int k, n, at;
    memset(id, 0, sizeof id);
    memset(tie, 0, sizeof tie);
    d.max_particles = 6 * 64;
    d.max_bodies = 6;
    d.max_bonds = 6 * 1500;
    d.max_materials = d.max_colliders = d.max_skins = 2;
    d.max_attachments = 4;
    d.spare_bytes = 4 << 20;
    if (how == 1) d.parallel.run = backwards, d.parallel.threads = 2;
    if (how == 2) buffer = malloc(peri_world_size(&d));
    w = how == 2 ? peri_world_create_in(&d, buffer, peri_world_size(&d), NULL) : world_of(&d);
    CHECK(w != NULL);
    if (!w) return 0;
    peri_collider_create(w, &c);
    b = body_of(w, 2e5);
    random_seed(seed);
    for (n = 0; n < steps; n++) {
        int act = (int)between(0, 60);
        peri_real v[3] = {(peri_real)uniform(), (peri_real)uniform(), (peri_real)uniform()};
        at = (int)between(0, 6);
        k = (int)between(0, 4);
        if (act == 0 || !peri_body_is_valid(w, id[at])) {
            if (peri_body_is_valid(w, id[at])) peri_body_destroy(w, id[at]);
            b.self_contact = k == 0;
            b.velocity = vec3(uniform(), uniform(), -1);
            id[at] = cube(w, &b, 1 + k, 0.06, 0.2 * uniform(), 0.2 * uniform(), between(0.2, 1));
        }
        if (act == 1) peri_body_set_positions(w, id[at], 0, 1, v);
        if (act == 2) peri_body_set_velocities(w, id[at], 0, 1, v);
        if (act == 3) peri_body_set_fixed(w, id[at], 0, k & 1);
        if (act == 4) {
            peri_attachment_def a = peri_default_attachment_def();
            a.body = id[at];
            a.other = id[(at + 1 + k) % 6];
            a.rope = k & 1;
            a.break_force = 300;
            if (peri_attachment_is_valid(w, tie[k])) peri_attachment_destroy(w, tie[k]);
            tie[k] = peri_attachment_create(w, &a);
        }
        if (act == 5) peri_body_wake(w, id[at]);
        if (peri_world_step(w, act == 6 ? DT / 3 : DT)) complain_of(w, "step");
        if (test_bad) break;
    }
    /* not the world's hash: it takes in what arrays there are, and a buffer has all */
    hash = peri__hash_bytes(0, w->x, 3 * (size_t)w->particles * sizeof *w->x);
    hash = peri__hash_bytes(hash, w->v, 3 * (size_t)w->particles * sizeof *w->v);
    peri_world_destroy(w);
    free(buffer);
    return hash;
}

/* Two bodies of more than one piece of a loop fall on each other. */
static uint64_t large(int how) {
    peri_world_def d = peri_default_world_def();
    peri_world *w;
    peri_body_def b;
    uint64_t hash;
    if (how == 1) d.parallel.run = backwards, d.parallel.threads = 2;
    w = world_of(&d);
    if (!w) return 0;
    ground(w);
    b = body_of(w, 1e5);
    cube(w, &b, 7, 0.05, 0, 0, 0.18);
    cube(w, &b, 7, 0.05, 0.03, 0.02, 0.54);
    run(w, 20);
    CHECK(peri_world_stats(w).contacts > 0);
    hash = peri_world_hash(w);
    peri_world_destroy(w);
    return hash;
}

static void same_bits(void) {
    int k;
    CHECK(large(0) == large(1));
    for (k = 0; k < 4; k++) {
        uint64_t plain = turmoil(0, (uint64_t)k, 150);
        CHECK(turmoil(0, (uint64_t)k, 150) == plain);
        CHECK(turmoil(1, (uint64_t)k, 150) == plain);
        CHECK(turmoil(2, (uint64_t)k, 150) == plain);
    }
}

/* ---- main -------------------------------------------------------------------------------------------------------- */

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(grains_in_a_buffer);
    RUN(cubes_in_a_buffer);
    RUN(contact_limit);
    RUN(settled_steps);
    RUN(failing_memory);
    RUN(failed_step_wakes_nobody);
    RUN(coincident);
    RUN(single_particles);
    RUN(no_radius);
    RUN(groups);
    RUN(crowded_patch);
    RUN(changes_wake);
    RUN(same_bits);
    return test_end();
}
