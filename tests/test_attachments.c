/* test_attachments.c - springs, ropes and rigid joints: forces, momenta, breaking, what they wake. A first look at each
 * is in test_contact.c; wrong definitions too. */
#define PERI_IMPLEMENTATION
#include "../peri.h"

#include "test.h"

#include "scenes.h"

#define H (1 / 60.0)
#define DT ((peri_real)H)

static peri_world *world_of(double gravity, double sleep) {
    peri_world_def d = peri_default_world_def();
    d.gravity = vec3(0, 0, -gravity);
    d.sleep_speed = (peri_real)sleep;
    return peri_world_create(&d, NULL);
}

/* A block of nx * ny * nz points, E 1e6 Pa, moving at vx. */
static peri_body_id block(peri_world *w, int nx, int ny, int nz, double d, peri_vec3 at, peri_vec3 velocity) {
    peri_material m = peri_material_neo_hookean((peri_real)1e6, (peri_real)0.3, 1000);
    peri_body_def b = peri_default_body_def();
    peri_real *points = lattice(nx, ny, nz, d);
    peri_body_id id;
    b.points = points;
    b.count = nx * ny * nz;
    b.spacing = (peri_real)d;
    b.material = peri_material_create(w, &m);
    b.position = at;
    b.velocity = velocity;
    id = peri_body_create(w, &b);
    free(points);
    if (!peri_body_is_valid(w, id)) complain_of(w, "body");
    return id;
}

static peri_measure measure(peri_world *w, peri_body_id id) {
    peri_measure m;
    memset(&m, 0, sizeof m);
    if (peri_body_measure(w, id, &m)) complain_of(w, "measure");
    return m;
}

static void run(peri_world *w, int steps) {
    int k;
    for (k = 0; k < steps; k++)
        if (peri_world_step(w, DT)) {
            complain_of(w, "step");
            return;
        }
}

/* One particle of 1 kg: springs of 100 to 1e6 N/m give F = k x; the rigid one is ten times its m/h^2 and gives by
   g h^2 / 10. At rest the unbalanced force is what the last correction, at most 1e-3 d / 4 of tolerance against a
   matrix of m/h^2 + k, leaves of it: x errs by no more than that correction. */
static void spring_constants(void) {
    static const double stiffness[4] = {100, 1e4, 1e6, 0};
    int k;
    for (k = 0; k < 4; k++) {
        peri_world *w = world_of(9.81, 0);
        peri_attachment_def d = peri_default_attachment_def();
        peri_attachment_id id;
        peri_vec3 force = vec3(0, 0, 0);
        double real = k < 3 ? stiffness[k] : 10 * 3600, x;
        d.body = block(w, 1, 1, 1, 0.1, vec3(0, 0, 1), vec3(0, 0, 0));
        d.stiffness = (peri_real)stiffness[k];
        id = peri_attachment_create(w, &d);
        run(w, 2400);
        x = 1 - measure(w, d.body).centre[2];
        peri_attachment_force(w, id, &force);
        printf("    stiffness %g: gives %.6g m, of m g / k = %.6g; force %.6g N\n", stiffness[k], x, 9.81 / real,
               (double)force.z);
        NEAR(x, 9.81 / real, 1e-4);
        NEAR(force.z, real * x, 1e-5 * real * x + real * 4 * EPS);
        peri_world_destroy(w);
    }
}

/* A particle of 1 kg, 0.5 m from the axis of a frame that turns at 2 rad/s: held rigidly it lags by less than the load
   m w^2 r over 10 m / h^2, and the tolerance. The frame feels m w^2 r outwards (1 %), and the drag of
   backward Euler, whose acceleration points to where the centre was seen from a step ago: m w^2 r times r w h. */
static void turning_frame(void) {
    peri_world *w = world_of(0, 0.05);
    peri_collider_def c = peri_default_collider_def();
    peri_collider_id frame;
    peri_attachment_def d = peri_default_attachment_def();
    peri_vec3 push = vec3(0, 0, 0), moment = push, at = push;
    peri_quat q = axis_quat(2, 0);
    double r[9], arm[3] = {0.5, 0, 0}, place[3], load = 4 * 0.5, worst = 0, off[3], centre[3];
    int k, i, asleep = 0;
    c.shape = peri_shape_none();
    c.position = vec3(1, 2, 3);
    c.velocity = vec3(0.3, 0, 0);
    c.spin = vec3(0, 0, 2);
    frame = peri_collider_create(w, &c);
    d.body = block(w, 1, 1, 1, 0.1, vec3(1.5, 2, 3), vec3(0.3, 1, 0));
    d.collider = frame;
    peri_attachment_create(w, &d);
    for (k = 0; k < 300; k++) {
        run(w, 1);
        peri_collider_pose(w, frame, &at, &q);
        quat_matrix(q, r);
        apply(r, arm, place);
        place[0] += (double)at.x;
        place[1] += (double)at.y;
        place[2] += (double)at.z;
        for (i = 0; i < 3; i++) centre[i] = measure(w, d.body).centre[i];
        for (i = 0; i < 3; i++) off[i] = centre[i] - place[i];
        if (k > 60 && norm(off, 3) > worst) worst = norm(off, 3);
        asleep |= peri_body_is_asleep(w, d.body);
    }
    FIGURE("turning frame: particle off by, m", worst);
    CHECK(worst < 1.1 * load / (10 * 3600) + 1e-4);
    CHECK(!asleep);
    peri_collider_impulse(w, frame, &push, &moment);
    off[0] = ((double)push.x * (place[0] - (double)at.x) + (double)push.y * (place[1] - (double)at.y)) / 0.5;
    FIGURE("turning frame: outward force over m w^2 r", off[0] / H / load);
    NEAR(off[0] / H, load, 0.01 * load);
    NEAR(moment.z / H, -load * 0.5 * 2 * H, 0.01 * load * 0.5);
    peri_world_destroy(w);
}

/* Two free boxes on a spring between corners, flying past each other: both momenta are kept, to the rounding of
   velocities (EPS of each, 300 steps: 100 EPS) in backward Euler, where positions follow velocities exactly. In
   double the sums, over 91 particles in every step, are rounded no finer than what they add: at worst
   300 * 91^1/2 EPS. */
static void momenta(void) {
    peri_world *w = world_of(0, 0.05);
    peri_attachment_def d = peri_default_attachment_def();
    peri_body_id all = {0, 0};
    peri_measure before, after;
    double dp[3], dl[3], size;
    int k;
    d.body = block(w, 4, 4, 4, 0.05, vec3(0, 0, 0), vec3(0, 0, 0));
    d.other = block(w, 3, 3, 3, 0.05, vec3(0.4, 0.1, 0.3), vec3(-0.5, 1, 0));
    d.particle = 63;
    d.other_particle = 0;
    d.stiffness = 200;
    CHECK(peri_attachment_create(w, &d).index1);
    before = measure(w, all);
    run(w, 300);
    after = measure(w, all);
    for (k = 0; k < 3; k++) dp[k] = after.momentum[k] - before.momentum[k];
    for (k = 0; k < 3; k++) dl[k] = after.angular_momentum[k] - before.angular_momentum[k];
    size = sqrt(2 * before.mass * before.kinetic);
    FIGURE("spring between two bodies: momentum changed, of the whole", norm(dp, 3) / size);
    FIGURE("spring between two bodies: angular momentum changed, of p times 0.4 m", norm(dl, 3) / size / 0.4);
    CHECK(norm(dp, 3) < (IS_DOUBLE ? 2900 : 100) * EPS * size);
    CHECK(norm(dl, 3) < (IS_DOUBLE ? 2900 : 100) * EPS * size * 0.4);
    CHECK(after.kinetic < before.kinetic);
    peri_world_destroy(w);
}

/* It breaks in the step that ends above its force, not earlier; and that step is the same as that of a twin that
   cannot break, momenta included. Then both fly on by themselves. */
static void breaking(void) {
    peri_world *w[2];
    peri_body_id one[2], two[2];
    peri_attachment_id id[2];
    peri_vec3 force = vec3(0, 0, 0);
    double limit = 60, p[2][3], pulled[3];
    int k, n, broke = -1;
    for (k = 0; k < 2; k++) {
        peri_attachment_def d = peri_default_attachment_def();
        w[k] = world_of(0, 0.05);
        one[k] = d.body = block(w[k], 4, 4, 4, 0.05, vec3(0, 0, 0), vec3(0, 0, 0));
        two[k] = d.other = block(w[k], 4, 4, 4, 0.05, vec3(0.5, 0, 0), vec3(2, 0, 0));
        d.particle = 21;
        d.other_particle = 21;
        d.stiffness = 1000;
        if (!k) d.break_force = (peri_real)limit;
        id[k] = peri_attachment_create(w[k], &d);
    }
    for (n = 0; n < 20 && broke < 0; n++) {
        peri_vec3 now = vec3(0, 0, 0);
        int c;
        run(w[0], 1);
        run(w[1], 1);
        CHECK(!peri_attachment_force(w[1], id[1], &now));
        pulled[0] = (double)now.x;
        if (!peri_attachment_is_valid(w[0], id[0])) broke = n;
        CHECK((fabs(pulled[0]) > limit) == (broke == n));
        for (k = 0; k < 2; k++)
            for (c = 0; c < 3; c++) p[k][c] = measure(w[k], one[k]).momentum[c];
        CHECK(peri_world_stats(w[0]).broken == (broke == n));
        for (c = 0; c < 3; c++) NEAR(p[0][c], p[1][c], 100 * EPS * 16);     /* 16 kg m/s in the world */
    }
    printf("    broke in step %d at %.4g N, limit %g N\n", broke, fabs(pulled[0]), limit);
    CHECK(broke > 1);
    CHECK(peri_attachment_force(w[0], id[0], &force) == PERI_ERROR_ID);
    CHECK(peri_attachment_destroy(w[0], id[0]) == PERI_ERROR_ID);
    run(w[0], 30);
    NEAR(measure(w[0], one[0]).momentum[0], p[0][0], 100 * EPS * 16);
    CHECK(peri_body_is_valid(w[0], two[0]));
    peri_world_destroy(w[0]);
    peri_world_destroy(w[1]);
}

/* A pendulum is still at its turning points, but not for half a second: it does not sleep while it swings. 30 degrees,
   and one: there it is accelerated by 0.17 m/s^2, so slower than 0.05 * 0.05 m/s for 0.03 s. When backward Euler has
   damped it, it sleeps: below. */
static void pendulum(void) {
    static const double angle[2] = {30, 1};
    int k, n;
    for (k = 0; k < 2; k++) {
        peri_world *w = world_of(9.81, 0.05);
        peri_attachment_def d = peri_default_attachment_def();
        double turn = angle[k] * 3.14159265358979 / 180, slept = -1, off = 0, largest = 0, length;
        d.body = block(w, 3, 3, 3, 0.05, vec3(sin(turn), 0, -cos(turn)), vec3(0, 0, 0));
        d.particle = 13;
        d.here = 0;
        d.length = 1;
        d.rope = 1;
        CHECK(peri_attachment_create(w, &d).index1);
        for (n = 0; n < 3000 && slept < 0; n++) {
            peri_measure m;
            run(w, 1);
            m = measure(w, d.body);
            off = fabs(m.centre[0]);
            if (n >= 180 && n < 480 && off > largest) largest = off;
            length = norm(m.centre, 3);
            CHECK(length < 1.02);
            if (peri_body_is_asleep(w, d.body)) slept = n * H;
        }
        printf("    pendulum from %g degrees: amplitude after 3 to 8 s %.3f of the first; asleep after %.3g s, "
               "%.2g degrees off\n", angle[k], largest / sin(turn), slept, off * 180 / 3.14159265358979);
        /* slow for half a second, quarter of a period: at most 0.05 d/s / (omega = 3.1/s) of way */
        if (slept >= 0) CHECK(off < 0.05 * 0.05 / 3.1 * 2);
        CHECK(slept < 0 || slept > 3);
        /* small swings die by exp(-omega^2 h t / 2) in backward Euler: 0.78 after 3 s; the first peak comes within half
           a period, 1 s, in which they lose 8 %. Above all they do not grow */
        NEAR(largest / sin(turn), exp(-9.81 * H * 3 / 2), 0.08 * exp(-9.81 * H * 3 / 2));
        peri_world_destroy(w);
    }
}

/* What is done to an attachment wakes those at both ends: making, moving, removing it, and the collider that it hangs
   on. */
static void changes_wake(void) {
    peri_world *w = world_of(9.81, 0.05);
    peri_collider_def c = peri_default_collider_def();
    peri_collider_id frame;
    peri_attachment_def d = peri_default_attachment_def();
    peri_attachment_id id, tie;
    peri_body_id low, apart;
    double weight;
    peri_vec3 push;
    peri_collider_create(w, &c);
    c.shape = peri_shape_none();
    c.position = vec3(0, 0, 1);
    frame = peri_collider_create(w, &c);
    low = block(w, 4, 4, 4, 0.05, vec3(0, 0, 0.101), vec3(0, 0, 0));
    apart = block(w, 4, 4, 4, 0.05, vec3(1, 0, 0.101), vec3(0, 0, 0));
    run(w, 240);
    CHECK(peri_world_stats(w).asleep == 2);
    d.body = low;
    d.particle = 21;
    d.collider = frame;
    d.stiffness = 2000;
    id = peri_attachment_create(w, &d);
    CHECK(!peri_body_is_asleep(w, low) && peri_body_is_asleep(w, apart));
    run(w, 240);
    CHECK(peri_world_stats(w).asleep == 2);
    CHECK(!peri_attachment_set_point(w, id, vec3(0, 0, 0)));    /* of the frame: 1 m high */
    CHECK(!peri_body_is_asleep(w, low) && peri_body_is_asleep(w, apart));
    run(w, 1200);
    weight = measure(w, low).mass * 9.81;
    NEAR(measure(w, low).centre[2], 1 - weight / 2000, 0.05);  /* hangs by an inner particle: by its stretch too */
    CHECK(peri_body_is_asleep(w, low));
    peri_collider_impulse(w, frame, &push, NULL);
    NEAR(-(double)push.z / H, weight, 0.01 * weight);           /* the sleeper's weight is still borne */
    peri_collider_set_velocity(w, frame, vec3(0, 0, 0.1), vec3(0, 0, 0));
    run(w, 2);
    CHECK(!peri_body_is_asleep(w, low));
    peri_collider_set_velocity(w, frame, vec3(0, 0, 0), vec3(0, 0, 0));
    run(w, 1200);
    CHECK(peri_body_is_asleep(w, low));
    d = peri_default_attachment_def();
    d.body = apart;
    d.other = low;
    d.rope = 1;
    tie = peri_attachment_create(w, &d);
    CHECK(!peri_body_is_asleep(w, low) && !peri_body_is_asleep(w, apart));
    run(w, 600);
    CHECK(peri_world_stats(w).asleep == 2);
    peri_body_wake(w, apart);                                   /* joined: they sleep and wake together */
    CHECK(peri_world_stats(w).asleep == 0);
    run(w, 600);
    CHECK(peri_world_stats(w).asleep == 2);
    CHECK(!peri_attachment_destroy(w, tie));
    CHECK(peri_world_stats(w).asleep == 0);
    run(w, 600);
    CHECK(!peri_collider_destroy(w, frame));
    CHECK(!peri_attachment_is_valid(w, id) && !peri_body_is_asleep(w, low) && peri_body_is_asleep(w, apart));
    run(w, 120);
    CHECK(measure(w, low).centre[2] < 0.2);
    peri_world_destroy(w);
}

/* An attachment goes with either of its bodies; the other end falls. Ids of the dead stay dead when their places are
   taken again. */
static void bodies_go(void) {
    int which;
    for (which = 0; which < 2; which++) {
        peri_world *w = world_of(9.81, 0.05);
        peri_attachment_def d = peri_default_attachment_def(), hang = peri_default_attachment_def();
        peri_attachment_id id, hook, later;
        peri_body_id one, two;
        one = block(w, 3, 3, 3, 0.05, vec3(0, 0, 0), vec3(0, 0, 0));
        two = block(w, 3, 3, 3, 0.05, vec3(0, 0, -0.5), vec3(0, 0, 0));
        d.body = which ? two : one;
        d.other = which ? one : two;
        d.rope = 1;
        id = peri_attachment_create(w, &d);
        hang.body = one;
        hang.particle = 22;
        hook = peri_attachment_create(w, &hang);
        run(w, 30);
        CHECK(measure(w, two).centre[2] > -0.5 - 0.13 - 0.09);    /* both turn about their particles; free: -1.7 */
        CHECK(peri_world_stats(w).attachments == 2);
        CHECK(!peri_body_destroy(w, one));
        CHECK(!peri_attachment_is_valid(w, id) && !peri_attachment_is_valid(w, hook));
        CHECK(peri_world_stats(w).attachments == 0 && peri_world_stats(w).broken == 0);
        run(w, 30);
        CHECK(measure(w, two).centre[2] < -1);
        hang.body = two;
        later = peri_attachment_create(w, &hang);
        CHECK(peri_attachment_is_valid(w, later) && !peri_attachment_is_valid(w, id));
        CHECK(!peri_attachment_is_valid(w, hook));
        CHECK(peri_attachment_set_point(w, id, vec3(0, 0, 0)) == PERI_ERROR_ID);
        peri_world_destroy(w);
    }
}

/* Fixed particles hold what is attached to them, and a fixed particle may itself be attached: it stays. */
static void fixed_ends(void) {
    peri_world *w = world_of(9.81, 0.05);
    peri_attachment_def d = peri_default_attachment_def();
    peri_body_id one = block(w, 3, 3, 3, 0.05, vec3(0, 0, 0), vec3(0, 0, 0));
    peri_body_id two = block(w, 1, 1, 1, 0.05, vec3(0, 0, -0.5), vec3(0, 0, 0));
    peri_vec3 force = vec3(0, 0, 0);
    peri_attachment_id id;
    double weight = 0.000125 * 1000 * 9.81;
    int k;
    for (k = 0; k < 27; k++) peri_body_set_fixed(w, one, k, 1);
    d.body = one;
    d.other = two;
    d.stiffness = 50;
    id = peri_attachment_create(w, &d);
    run(w, 1200);
    NEAR(measure(w, one).centre[2], 0, 1e-7);
    peri_attachment_force(w, id, &force);
    /* the spring leans from particle 0 at (-0.05, -0.05, -0.05): its vertical part bears the weight */
    NEAR(-(double)force.z, weight, 0.01 * weight);
    peri_world_destroy(w);
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(spring_constants);
    RUN(turning_frame);
    RUN(momenta);
    RUN(breaking);
    RUN(pendulum);
    RUN(changes_wake);
    RUN(bodies_go);
    RUN(fixed_ends);
    return test_end();
}
