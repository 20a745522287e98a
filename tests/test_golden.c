/* test_golden.c - the same bits: from any order of the pieces of a parallel loop and any number of threads, and, for
 * the constants below, from every compiler and optimisation level on x86-64 in float without contraction.
 *
 * TO RENEW the constants after a change of the solver: run the program and paste the lines that begin with `golden:`
 * (without that word) over the table. Elsewhere (other processors, fma, contraction, fast-math, double) it prints them and
 * checks the threads only. */
#define PERI_IMPLEMENTATION
#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#endif
#include "../peri.h"

#include "test.h"

#include "scenes.h"

/* Is a * a - p fused, or held in more than a float? Then the constants do not apply. */
static int contracts(void) {
    volatile float kept = 1.000244140625f, product;
    float a = kept;
    product = a * a;
    return a * a - product != 0;
}

#if defined(__x86_64__) && !defined(PERI_DOUBLE) && !defined(__FAST_MATH__) && !defined(FP_FAST_FMAF)
#define GOLDEN (!contracts())
#else
#define GOLDEN (contracts() && 0)
#endif

enum { DROP, TWIST, BALL, HEAP, SCENES };
static const char *const scene_name[SCENES] = {"drop", "twist", "ball", "heap"};
static const uint64_t golden[SCENES] = {
    0x95f3d488977d7ecdull, /* drop */
    0x24976eb4409ef141ull, /* twist */
    0xce7d637476924d3cull, /* ball */
    0xc51ed92dd071b5dbull, /* heap */
};

/* ---- ways of running a loop ---------------------------------------------------------------------------------- */

#if defined(__linux__) && defined(__GLIBC__)
#if __GLIBC_PREREQ(2, 34)   /* pthreads without -pthread */
#define THREADS 1
#include <pthread.h>
#endif
#endif

typedef enum way { WAY_PLAIN, WAY_REVERSED, WAY_INTERLEAVED, WAY_WHOLE, WAY_TWO, WAY_FOUR, WAY_OPENMP } way;

typedef struct runner {
    way how;
    int pieces;     /* seen in all, and in the largest loop */
    int most;
} runner;

typedef struct share {
    int count, grain, first, step;
    peri_task *task;
    void *context;
} share;

/* Every step-th piece, from piece `first` on. */
static void *run_share(void *p) {
    const share *s = (const share *)p;
    int at;
    for (at = s->first * s->grain; at < s->count; at += s->step * s->grain)
        s->task(at, at + s->grain < s->count ? at + s->grain : s->count, s->context);
    return NULL;
}

static void run_threads(int threads, share s) {
    share shares[4];
    int k;
#ifdef THREADS
    pthread_t ids[4];
    int started[4] = {0, 0, 0, 0};
#endif
    for (k = 0; k < threads; k++) {
        shares[k] = s;
        shares[k].first = k;
        shares[k].step = threads;
    }
#ifdef THREADS
    for (k = 1; k < threads && k * s.grain < s.count; k++)
        started[k] = pthread_create(&ids[k], NULL, run_share, &shares[k]) == 0;
    run_share(&shares[0]);
    for (k = 1; k < threads; k++) {
        if (started[k]) pthread_join(ids[k], NULL);
        else run_share(&shares[k]);
    }
#else
    for (k = threads - 1; k >= 0; k--) run_share(&shares[k]);
#endif
}

static void run_loop(int count, int grain, peri_task *task, void *context, void *user) {
    runner *r = (runner *)user;
    int pieces = (count + grain - 1) / grain, k;
    share s;
    s.count = count;
    s.grain = grain;
    s.first = 0;
    s.step = 1;
    s.task = task;
    s.context = context;
    r->pieces += pieces;
    if (pieces > r->most) r->most = pieces;
    switch (r->how) {
    case WAY_REVERSED:
        for (k = pieces - 1; k >= 0; k--) task(k * grain, (k + 1) * grain < count ? (k + 1) * grain : count, context);
        break;
    case WAY_INTERLEAVED: /* the odd pieces, then the even ones */
        s.step = 2;
        s.first = 1;
        run_share(&s);
        s.first = 0;
        run_share(&s);
        break;
    case WAY_WHOLE: /* several grains in one piece: three, then the rest */
        if (pieces > 3) {
            task(0, 3 * grain, context);
            task(3 * grain, count, context);
        } else if (count > 0) {
            task(0, count, context);
        }
        break;
    case WAY_TWO: run_threads(2, s); break;
    case WAY_FOUR: run_threads(4, s); break;
    default: run_share(&s); break;
    }
}

/* ---- scenes -------------------------------------------------------------------------------------------------- */

/* Turns about z by angle, without sin or cos: their last bits belong to the libm. */
static void turned(double t, double *c, double *s) {
    *c = (1 - t * t) / (1 + t * t);
    *s = 2 * t / (1 + t * t);
}

/* Leaves a ball of the block's points. */
static void round_off(scene *s) {
    int i, k = 0;
    for (i = 0; i < s->n; i++) {
        const peri_real *x = s->points + 3 * i;
        double r2 = (double)x[0] * (double)x[0] + (double)x[1] * (double)x[1] + (double)x[2] * (double)x[2];
        if (r2 <= 0.6875 * 0.6875) memmove(s->points + 3 * k++, x, 3 * sizeof *x);
    }
    s->n = s->body_def.count = k;
}

/* A cloth of 24 x 24 points at z = 0 whose border is fixed. */
static peri_body_id add_cloth(scene *s) {
    enum { N = 24 };
    static peri_real points[3 * N * N];
    static unsigned char fixed[N * N];
    peri_body_def def = peri_default_sheet_def((peri_real)0.03125);
    peri_material m = peri_material_linear(200000, (peri_real)0.25, 500);
    int i;
    for (i = 0; i < N * N; i++) {
        points[3 * i] = (peri_real)(0.125 * (i % N - 0.5 * (N - 1)));
        points[3 * i + 1] = (peri_real)(0.125 * (i / N - 0.5 * (N - 1)));
        fixed[i] = i % N == 0 || i % N == N - 1 || i / N == 0 || i / N == N - 1;
    }
    def.points = points;
    def.fixed = fixed;
    def.count = N * N;
    def.spacing = (peri_real)0.125;
    def.material = peri_material_create(s->world, &m);
    return peri_body_create(s->world, &def);
}

/* A rod that lies across the cloth, a little above it. */
static peri_body_id add_rod(scene *s) {
    enum { N = 16 };
    static peri_real points[3 * N];
    peri_body_def def = peri_default_rod_def((peri_real)0.0625);
    peri_material m = peri_material_linear(1000000, (peri_real)0.25, 1000);
    int i;
    for (i = 0; i < N; i++) {
        points[3 * i] = (peri_real)(0.125 * (i - 0.5 * (N - 1)));
        points[3 * i + 1] = (peri_real)-1;
        points[3 * i + 2] = (peri_real)0.25;
    }
    def.points = points;
    def.count = N;
    def.spacing = (peri_real)0.125;
    def.material = peri_material_create(s->world, &m);
    return peri_body_create(s->world, &def);
}

static uint64_t run_scene(int which, way how, int threads, runner *r) {
    peri_material m;
    peri_collider_def box = peri_default_collider_def();
    unsigned char *fixed = NULL;
    uint64_t hash;
    scene s;
    int i, k;
    memset(r, 0, sizeof *r);
    r->how = how;
    if (which == DROP) scene_begin(&s, 8, 8, 9, 0.125);
    else if (which == TWIST) scene_begin(&s, 6, 6, 18, 0.125);
    else scene_begin(&s, 11, 11, 11, 0.125);
    if (how != WAY_OPENMP) {
        s.world_def.parallel.run = run_loop;
        s.world_def.parallel.user = r;
    }
    s.world_def.parallel.threads = threads;
    s.world_def.gravity = vec3(0, 0, -9.81);
    if (which == DROP) {
        m = peri_material_neo_hookean(100000, (peri_real)0.375, 1000);
        s.body_def.position = vec3(0.0625, 0.03125, 1.25);
        s.body_def.velocity = vec3(0.5, 0.25, -2);
        scene_make(&s, &m);
        scene_floor(&s, PERI_FRICTION_COULOMB, 0.5);
        box.shape = peri_shape_box((peri_real)0.25, (peri_real)0.375, (peri_real)0.25);
        box.rotation.x = (peri_real)0.48;
        box.rotation.y = (peri_real)0.36;
        box.rotation.w = (peri_real)0.8;
        box.position = vec3(0.25, 0, 0.125);
        box.spin = vec3(0, 0, 0.5);
        box.friction = (peri_real)0.25;
        peri_collider_create(s.world, &box);
        scene_run(&s, 24, 1 / 64.0);
    } else if (which == TWIST) {
        m = peri_material_stvk(200000, (peri_real)0.25, 1000);
        fixed = (unsigned char *)calloc((size_t)s.n, 1);
        for (i = 0; i < 36; i++) fixed[i] = fixed[s.n - 36 + i] = 1;
        s.body_def.fixed = fixed;
        s.world_def.integrator = PERI_BDF2;
        scene_make(&s, &m);
        for (k = 1; k <= 24; k++) {
            double c, n;
            turned(k / 64.0, &c, &n);
            for (i = s.n - 36; i < s.n; i++) {
                const peri_real *x = s.points + 3 * i;
                double px = (double)x[0], py = (double)x[1];
                peri_vec3 aim = vec3(c * px - n * py, n * px + c * py, (double)x[2]);
                peri_body_move(s.world, s.body, i, aim);
            }
            scene_run(&s, 1, 1 / 64.0);
        }
    } else if (which == HEAP) {
        m = peri_material_neo_hookean(100000, (peri_real)0.375, 1000);
        round_off(&s);
        s.body_def.position = vec3(0.03125, 0.0625, 0.8125);
        s.body_def.velocity = vec3(0.5, 0, -4);
        scene_make(&s, &m);
        CHECK(add_cloth(&s).index1 && add_rod(&s).index1);
        scene_run(&s, 24, 1 / 64.0);
        CHECK(peri_world_stats(s.world).contacts > 10);
    } else {
        m = peri_material_projective(50000, (peri_real)0.5, 1000);
        round_off(&s);
        s.world_def.solver = PERI_SOLVER_CHEBYSHEV;
        s.body_def.position = vec3(0, 0, 0.8125);
        s.body_def.velocity = vec3(1, 0, -3);
        s.body_def.spin = vec3(0, 4, 0);
        scene_make(&s, &m);
        scene_floor(&s, PERI_FRICTION_COULOMB, 0.75);
        scene_run(&s, 24, 1 / 64.0);
    }
    hash = peri_world_hash(s.world);
    for (i = 0, k = 0; i < 3 * s.n; i++) k += !(fabs((double)peri_body_positions(s.world, s.body)[i]) < 10);
    CHECK(k == 0);      /* a hash of NaN is a hash too */
    CHECK(scene_measure(&s).elastic > 0.5);
    scene_end(&s);
    free(fixed);
    return hash;
}

static int plain_only = 0;      /* `test_golden plain`: each scene once, for the bits of this build alone */

static void bits(int which) {
    static const char *const names[7] = {"plain", "reversed", "interleaved", "large pieces", "2 threads", "4 threads",
                                         "OpenMP or serial"};
    uint64_t first, hash;
    runner r;
    int how;
    first = run_scene(which, WAY_PLAIN, 1, &r);
    CHECK(r.most >= 2);     /* else order and threads are not tested */
    for (how = WAY_REVERSED; how <= WAY_FOUR && !plain_only; how++) {
        hash = run_scene(which, (way)how, 1, &r);
        if (hash != first) printf("    %s, %s: other bits\n", scene_name[which], names[how]);
        CHECK(hash == first);
    }
    for (how = 1; how <= 4 && !plain_only; how *= 2) {
        hash = run_scene(which, WAY_OPENMP, how, &r);
        if (hash != first) printf("    %s, OpenMP or serial, %d threads: other bits\n", scene_name[which], how);
        CHECK(hash == first);
    }
    printf("golden:     0x%08lx%08lxull, /* %s */\n", (unsigned long)(first >> 32),
           (unsigned long)(first & 0xffffffffu), scene_name[which]);
    if (!GOLDEN) return;
    if (first != golden[which]) printf("    %s: not the kept bits; see the top of this file\n", scene_name[which]);
    CHECK(first == golden[which]);
}

static void drop(void) { bits(DROP); }
static void twist(void) { bits(TWIST); }
static void ball(void) { bits(BALL); }
static void heap(void) { bits(HEAP); }

int main(int argc, char **argv) {
    plain_only = argc > 1 && strcmp(argv[1], "plain") == 0;
    test_begin(plain_only ? 1 : argc, argv);
    RUN(drop);
    RUN(twist);
    RUN(ball);
    RUN(heap);
    return test_end();
}
