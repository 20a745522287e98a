/* test_layout.c - the layouts of the hot loops (particle by particle, lockstep, lattice) give the same forces and
 * energies to rounding, keep momentum, and do not depend on threads; who gets which; the way from lattice to
 * lockstep. */
#define PERI_IMPLEMENTATION
#include "../peri.h"

#include "test.h"

#include "scenes.h"

enum { BLOCK, BALL, RANDOM, SHUFFLED, SHAPES };
static const char *const shape_name[SHAPES] = {"block", "ball", "random", "shuffled"};

#define MOST 1400

typedef struct thing {
    peri_world *w;
    peri__body *b;
    peri_body_id id;
    int n;
} thing;

/* Points about 0.1 apart, most of them `count` in number: a block nearly as wide as high, a ball, random ones at least
   0.6 spacings apart, and the block's in a random order. */
static int points_of(int shape, int count, peri_real *x) {
    int side = 1, i, j, k, c, n = 0, tries;
    while (side * side * side < (shape == BALL ? 2 * count : count)) side++;
    random_seed(31);
    for (tries = 0; shape == RANDOM && n < count && tries < 200000; tries++) {
        peri_real p[3];
        double least = 1;
        for (c = 0; c < 3; c++) p[c] = (peri_real)between(0, 0.095 * side);
        for (i = 0; i < n; i++) {
            double away = 0;
            for (c = 0; c < 3; c++) away += (double)(x[3 * i + c] - p[c]) * (double)(x[3 * i + c] - p[c]);
            if (away < least) least = away;
        }
        if (least < 0.06 * 0.06) continue;
        for (c = 0; c < 3; c++) x[3 * n + c] = p[c];
        n++;
    }
    for (k = 0; k < side && shape != RANDOM; k++)
        for (j = 0; j < side; j++)
            for (i = 0; i < side && n < count; i++) {
                double r[3];
                r[0] = i - 0.5 * (side - 1);
                r[1] = j - 0.5 * (side - 1);
                r[2] = k - 0.5 * (side - 1);
                if (shape == BALL && norm(r, 3) > 0.5 * side) continue;
                for (c = 0; c < 3; c++) x[3 * n + c] = (peri_real)(0.1 * r[c]);
                n++;
            }
    for (i = n - 1; i > 0 && shape == SHUFFLED; i--) {
        j = (int)(random_bits() % (uint64_t)(i + 1));
        for (c = 0; c < 3; c++) {
            peri_real swap = x[3 * i + c];
            x[3 * i + c] = x[3 * j + c];
            x[3 * j + c] = swap;
        }
    }
    return n;
}

static int thing_make(thing *t, int shape, int count, double horizon, const peri_material *m, int turned,
                      const peri_parallel *par) {
    static peri_real x[3 * MOST];
    peri_world_def wd = peri_default_world_def();
    peri_body_def bd = peri_default_body_def();
    if (par) wd.parallel = *par;
    t->w = peri_world_create(&wd, NULL);
    t->n = points_of(shape, count, x);
    bd.points = x;
    bd.count = t->n;
    bd.spacing = (peri_real)0.1;
    bd.horizon = (peri_real)horizon;
    bd.position = vec3(3, -2, 1);
    random_seed(8);
    if (turned) bd.rotation = random_quat();
    bd.material = peri_material_create(t->w, m);
    t->id = peri_body_create(t->w, &bd);
    t->b = peri__body_find(t->w, t->id);
    CHECK(t->b != NULL);
    return t->b != NULL;
}

/* Every particle moved by up to `much` spacings along each axis; a few, `odd`, put on the other side of a neighbour. */
static void thing_shake(thing *t, double much, int odd) {
    int k;
    random_seed(77);
    for (k = 0; k < 3 * t->n; k++) t->w->x[k] += 0.1 * much * uniform();
    for (k = 0; k < odd && k < t->n; k++) t->w->x[3 * (size_t)(t->n / 2 + k / 2)] -= 0.2;
    memcpy(t->w->x0, t->w->x, 3 * (size_t)t->n * sizeof *t->w->x);
}

/* Forces and energy by the layout that the body has; scalar 1: particle by particle. */
static double evaluate(thing *t, int scalar, peri_real *f) {
    peri__pass p;
    int blocks = t->b->lanes.blocks;
    double sum;
    if (scalar) t->b->lanes.blocks = 0;
    peri__pass_begin(&p, t->w, t->b, f);
    p.energy = 1;
    sum = peri__pass_run(&p);
    CHECK((p.lanes != NULL) == (!scalar && blocks > 0));
    t->b->lanes.blocks = blocks;
    return sum;
}

static double largest(const peri_real *f, int n) {
    double most = 0;
    int k;
    for (k = 0; k < 3 * n; k++) most = fabs((double)f[k]) > most ? fabs((double)f[k]) : most;
    return most;
}

static double apart(const peri_real *f, const peri_real *g, int n) {
    double most = 0;
    int k;
    for (k = 0; k < 3 * n; k++) {
        double d = fabs((double)f[k] - (double)g[k]);
        if (!(d <= most)) most = d;
    }
    return most;
}

/* Sum of the forces over the sum of their sizes. */
static double drift(const peri_real *f, int n) {
    double sum[3] = {0, 0, 0}, all = 0;
    int k;
    for (k = 0; k < 3 * n; k++) {
        sum[k % 3] += (double)f[k];
        all += fabs((double)f[k]);
    }
    return norm(sum, 3) / (all > 0 ? all : 1);
}

/* 26 terms in another order differ by some roundings of the largest, and the lattice's bonds are those of the ideal
   lattice, from which points at up to 0.6 m in float are off by 3e-8 m, 3e-7 of the spacing: 5 EPS of the bond, which
   shakes of a tenth make 50 of the force. In double, positions at 4 m are themselves off by 4 EPS, 400 of a shake. */
#define AGREE ((IS_DOUBLE ? 1000 : 200) * EPS)

static int met_lattice, met_lockstep, met_scalar, met_special;

static void compare(int kind, int shape, int count, int turned, int odd) {
    static peri_real f[3][3 * MOST];
    peri_material m = material_of(kind, 1e5, kind == M_PROJECTIVE ? 0.25 : 0.3);
    double energy[3], size, worst = 0;
    thing t;
    int layouts = 1, k;
    if (!thing_make(&t, shape, count, 1.75, &m, turned, NULL)) return;
    thing_shake(&t, 0.1, odd);
    CHECK(peri__health_check(t.w, t.b) == PERI_OK);
    met_special += t.b->unhealthy + t.b->singular;
    met_scalar += t.b->lanes.blocks == 0;
    energy[0] = evaluate(&t, 1, f[0]);
    if (t.b->lanes.blocks && t.b->lanes.lattice) {
        met_lattice++;
        energy[layouts] = evaluate(&t, 0, f[layouts]);
        layouts++;
        CHECK(peri__lanes_leave(t.w, t.b) == PERI_OK && !t.b->lanes.lattice);
        evaluate(&t, 1, f[2]);      /* what the body keeps of its bonds is the same */
        CHECK(memcmp(f[0], f[2], 3 * (size_t)t.n * sizeof(peri_real)) == 0);
    }
    if (t.b->lanes.blocks) {
        met_lockstep++;
        energy[layouts] = evaluate(&t, 0, f[layouts]);
        layouts++;
    }
    size = largest(f[0], t.n);
    for (k = 1; k < layouts; k++) {
        double off = apart(f[0], f[k], t.n) / size, energy_off = fabs(energy[k] / energy[0] - 1);
        if (off > worst) worst = off;
        if (!(off <= AGREE) || !(energy_off <= AGREE))
            printf("    %s %s %d, layout %d: force %.3g energy %.3g\n", material_name[kind], shape_name[shape], t.n,
                   layouts - k, off, energy_off);
        NEAR(off, 0, AGREE);
        NEAR(energy_off, 0, AGREE);
        if (kind != M_PROJECTIVE) NEAR(drift(f[k], t.n), 0, 20 * EPS);
    }
    peri_world_destroy(t.w);
}

static const int every_kind[8] = {M_PROJECTIVE, M_LINEAR, M_PAPERS, M_STVK,
                                  M_NEO_HOOKEAN, M_STVK_EXACT, M_STABLE, M_USER};

static void layouts_agree(void) {
    static const int count[7] = {1, 15, 16, 17, 31, 64, 1000};
    int k, shape, c;
    for (k = 0; k < 8; k++)
        for (shape = 0; shape < SHAPES; shape++)
            for (c = 0; c < 7; c++) compare(every_kind[k], shape, count[c], 0, 0);
    printf("    met: lattice %d, lockstep %d, particle by particle %d\n", met_lattice, met_lockstep, met_scalar);
    CHECK(met_lattice >= 16 && met_lockstep >= 64 && met_scalar >= 32);
}

static void layouts_agree_turned(void) {
    int k;
    for (k = 0; k < 8; k++) compare(every_kind[k], BALL, 700, 1, 0);
}

/* Particles with another energy: out of shape, or unable to hold a tensor. */
static void layouts_agree_special(void) {
    int k;
    met_special = 0;
    for (k = 0; k < 8; k++) {
        compare(every_kind[k], BLOCK, 512, 0, 6);
        compare(every_kind[k], RANDOM, 512, 0, 6);
    }
    printf("    met: %d special particles\n", met_special);
    CHECK(met_special >= 16);
}

/* The laws far from rest, where continuations act: finite and the same. */
static void layouts_agree_far(void) {
    static peri_real f[2][3 * MOST];
    int kind, k;
    for (k = 0; k < 8; k++) {
        peri_material m;
        double e0, e1;
        thing t;
        kind = every_kind[k];
        m = material_of(kind, 1e5, kind == M_PROJECTIVE ? 0.25 : 0.3);
        if (!thing_make(&t, BLOCK, 512, 1.75, &m, 0, NULL)) return;
        thing_shake(&t, 2, 0);
        CHECK(t.b->lanes.lattice);
        e0 = evaluate(&t, 1, f[0]);
        e1 = evaluate(&t, 0, f[1]);
        CHECK(peri__finite(e1));
        /* least squares far from a metric amplify what rounding does to C by det C over its cofactors */
        NEAR(e1 / e0, 1, 2000 * EPS);
        NEAR(apart(f[0], f[1], t.n) / largest(f[0], t.n), 0, 2000 * EPS);
        memcpy(t.w->x + 30, t.w->x + 33, 3 * sizeof *t.w->x);   /* two particles in one place */
        CHECK(peri__finite(evaluate(&t, 0, f[1])) && largest(f[1], t.n) < 1e30);
        peri_world_destroy(t.w);
    }
}

/* A single bond pressed to a fiftieth of its length, where A_1 is continued, in a body nearly at rest. */
static void layouts_agree_pressed(void) {
    static peri_real f[2][3 * MOST];
    int k, c;
    for (k = 0; k < 4; k++) {
        peri_material m = material_of(every_kind[k], 1e5, k ? 0.3 : 0.25);
        double e0, e1;
        thing t;
        if (!thing_make(&t, BLOCK, 512, 1.75, &m, 0, NULL)) return;
        thing_shake(&t, 0.01, 0);
        for (c = 0; c < 3; c++) t.w->x[600 + c] = t.w->x[603 + c];
        t.w->x[600] -= 0.002;
        e0 = evaluate(&t, 1, f[0]);
        e1 = evaluate(&t, 0, f[1]);
        /* what rounds the ends of a bond weighs fifty times as much against a fiftieth of its length */
        NEAR(e1 / e0, 1, 50 * AGREE);
        NEAR(apart(f[0], f[1], t.n) / largest(f[0], t.n), 0, 50 * AGREE);
        peri_world_destroy(t.w);
    }
}

/* A force is the slope of the energy also where both come from lanes. */
static void lanes_derivative(void) {
    static peri_real f[3 * MOST];
    static double way[3 * MOST], x[3 * MOST];
    static const double step = 1e-4;
    int k, i, lattice;
    for (k = 1; k < 8; k++)
        for (lattice = 0; lattice < 2; lattice++) {
            peri_material m = material_of(every_kind[k], 1e5, 0.3);
            double plus, minus, slope = 0;
            thing t;
            if (!thing_make(&t, BLOCK, 512, 1.75, &m, 0, NULL)) return;
            if (!lattice) CHECK(peri__lanes_leave(t.w, t.b) == PERI_OK);
            thing_shake(&t, 0.2, 0);
            evaluate(&t, 0, f);
            memcpy(x, t.w->x, 3 * (size_t)t.n * sizeof *x);
            for (i = 0; i < 3 * t.n; i++) {
                way[i] = 0.1 * step * uniform() + 0.1 * step * (double)f[i] / largest(f, t.n);
                slope -= way[i] * (double)f[i];
            }
            for (i = 0; i < 3 * t.n; i++) t.w->x[i] = x[i] + way[i];
            plus = evaluate(&t, 0, f);
            for (i = 0; i < 3 * t.n; i++) t.w->x[i] = x[i] - way[i];
            minus = evaluate(&t, 0, f);
            /* energies are sums of numbers in peri_real: each loses up to EPS, and the slope is 1e-4 of them */
            NEAR((plus - minus) / 2 / slope, 1, IS_DOUBLE ? 1e-6 : 3e-3);
            peri_world_destroy(t.w);
        }
}

/* ---- order of the pieces ------------------------------------------------------------------------------------- */

/* Pieces of three grains, last one first. */
static void backwards(int count, int grain, peri_task *task, void *context, void *user) {
    int pieces = (count + 3 * grain - 1) / (3 * grain), k;
    (void)user;
    for (k = pieces - 1; k >= 0; k--)
        task(3 * grain * k, 3 * grain * (k + 1) < count ? 3 * grain * (k + 1) : count, context);
}

static void pieces_do_not_matter(void) {
    static peri_real f[2][3 * MOST];
    peri_parallel odd;
    int k, lattice, way;
    memset(&odd, 0, sizeof odd);
    odd.run = backwards;
    for (k = 0; k < 8; k += 3)
        for (lattice = 0; lattice < 2; lattice++) {
            peri_material m = material_of(every_kind[k], 1e5, k ? 0.3 : 0.25);
            double energy[2];
            for (way = 0; way < 2; way++) {
                thing t;
                if (!thing_make(&t, BALL, 1300, 1.75, &m, 0, way ? &odd : NULL)) return;
                if (!lattice) CHECK(peri__lanes_leave(t.w, t.b) == PERI_OK);
                thing_shake(&t, 0.1, 3);
                CHECK(peri__health_check(t.w, t.b) == PERI_OK);
                energy[way] = evaluate(&t, 0, f[way]);
                peri_world_destroy(t.w);
            }
            CHECK(memcmp(f[0], f[1], sizeof f[0]) == 0);
            CHECK(memcmp(&energy[0], &energy[1], sizeof *energy) == 0);
        }
}

/* ---- who gets what ------------------------------------------------------------------------------------------- */

static int layout_of(int shape, int count, double horizon, int kind) {
    peri_material m = material_of(kind, 1e5, 0.25);
    thing t;
    int layout;
    if (!thing_make(&t, shape, count, horizon, &m, 0, NULL)) return -1;
    layout = !t.b->lanes.blocks ? 0 : t.b->lanes.lattice ? 2 : 1;
    peri_world_destroy(t.w);
    return layout;
}

static void layouts_are_chosen(void) {
    CHECK(layout_of(BLOCK, 1000, 1.75, M_LINEAR) == 2);
    CHECK(layout_of(BALL, 1000, 1.75, M_NEO_HOOKEAN) == 2);
    CHECK(layout_of(BLOCK, 1000, 3.01, M_PROJECTIVE) == 2);
    CHECK(layout_of(BLOCK, 216, 3.01, M_PROJECTIVE) == 1);     /* more cells around than inside */
    CHECK(layout_of(SHUFFLED, 1000, 1.75, M_LINEAR) == 1);
    CHECK(layout_of(RANDOM, 1000, 1.75, M_LINEAR) == 1);
    CHECK(layout_of(BLOCK, 8, 1.75, M_LINEAR) == 0);
    CHECK(layout_of(BLOCK, 1000, 1.75, M_ANISOTROPIC) == 0);
    CHECK(layout_of(BLOCK, 1000, 1.75, M_MIXED) == 0);
}

/* At rest, wherever it was put, a body on a lattice feels nothing at all; in double what a position of 4 m is rounded
   to, 4 EPS m of the spacing 0.1 m, at 26 bonds. */
static void rest_is_exact(void) {
    static peri_real f[3 * MOST];
    peri_material m = material_of(M_NEO_HOOKEAN, 1e6, 0.3);
    thing t;
    if (!thing_make(&t, BLOCK, 1000, 1.75, &m, 0, NULL)) return;
    CHECK(t.b->lanes.lattice);
    NEAR(evaluate(&t, 0, f), 0, IS_DOUBLE ? 1e-20 : 0);
    NEAR(largest(f, t.n), 0, IS_DOUBLE ? 26 * 1e6 * 0.1 * 0.1 * 40 * EPS : 0);
    peri_world_destroy(t.w);
}

/* Where 32 bits cannot tell positions finely enough, or one is not a number, particles are computed one by one. */
static void coarse_positions_fall_back(void) {
    static peri_real f[3 * MOST];
    peri_material m = material_of(M_LINEAR, 1e5, 0.3);
    peri__pass p;
    thing t;
    int k;
    if (!thing_make(&t, BLOCK, 512, 1.75, &m, 0, NULL)) return;
    for (k = 0; k < 3; k++) t.w->x[k] += 1e3;
    peri__pass_begin(&p, t.w, t.b, f);
    peri__pass_run(&p);
    CHECK((p.lanes == NULL) == !IS_DOUBLE);
    CHECK(largest(f, t.n) > 0 && largest(f, t.n) < 1e30);
    t.w->x[4] = peri__from_bits(PERI__NAN);
    peri__pass_begin(&p, t.w, t.b, f);
    peri__pass_run(&p);
    CHECK(!(fabs((double)f[4]) < 1e30));
    peri_world_destroy(t.w);
}

/* In a caller's buffer every layout finds its room, the way to lockstep too. */
static void buffer_holds_lanes(void) {
    static peri_real x[3 * MOST], f[2][3 * MOST];
    peri_world_def wd = peri_default_world_def();
    peri_body_def bd = peri_default_body_def();
    peri_material m = material_of(M_NEO_HOOKEAN, 1e5, 0.3);
    size_t bytes;
    void *buffer;
    thing t;
    t.n = points_of(BALL, 1000, x);
    wd.max_particles = t.n;
    wd.max_bonds = 26 * t.n;
    wd.max_bodies = wd.max_materials = 1;
    wd.max_colliders = wd.max_skins = wd.max_attachments = 0;
    bytes = peri_world_size(&wd);
    buffer = malloc(bytes);
    t.w = peri_world_create_in(&wd, buffer, bytes, NULL);
    bd.points = x;
    bd.count = t.n;
    bd.spacing = (peri_real)0.1;
    bd.material = peri_material_create(t.w, &m);
    t.id = peri_body_create(t.w, &bd);
    t.b = peri__body_find(t.w, t.id);
    CHECK(t.b && t.b->lanes.lattice);
    if (t.b) {
        thing_shake(&t, 0.1, 0);
        evaluate(&t, 0, f[0]);
        CHECK(peri__lanes_leave(t.w, t.b) == PERI_OK);
        evaluate(&t, 0, f[1]);
        NEAR(apart(f[0], f[1], t.n) / largest(f[0], t.n), 0, AGREE);
        CHECK(peri_body_destroy(t.w, t.id) == PERI_OK);
        t.id = peri_body_create(t.w, &bd);      /* all that it held is free again */
        t.b = peri__body_find(t.w, t.id);
        CHECK(t.b && t.b->lanes.lattice && peri__lanes_leave(t.w, t.b) == PERI_OK);
    }
    free(buffer);
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(layouts_agree);
    RUN(layouts_agree_turned);
    RUN(layouts_agree_special);
    RUN(layouts_agree_far);
    RUN(layouts_agree_pressed);
    RUN(lanes_derivative);
    RUN(pieces_do_not_matter);
    RUN(layouts_are_chosen);
    RUN(rest_is_exact);
    RUN(coarse_positions_fall_back);
    RUN(buffer_holds_lanes);
    return test_end();
}
