/* crowd.c - a hundred copies of one body fall into a tray and fall asleep.
 *
 * Shows what many bodies cost: factors shared by copies, islands, and sleep.
 *
 *     cc -O2 examples/crowd.c -lm -o crowd && ./crowd
 *
 * Writes to --out: crowd.png, crowd.csv.
 */
#include "studio.h"

#define PERI_IMPLEMENTATION
#include "../peri.h"
#include "studio_peri.h"

static const float dt = 1.0f / 60;

static const studio_app app = {"crowd", "a hundred soft bodies in a tray", "  --bodies N     how many (100)\n", 900};

typedef struct crowd {
    studio_options options;
    studio_stand stand;
    int bodies, held_in_flight, factors_in_flight, asleep_at;
    double outside;
    FILE *csv;
} crowd;

/* A rounded star with three arms: what is told apart when it lies. */
static peri_real star(peri_vec3 p, peri_vec3 *gradient, void *context) {
    double x = (double)p.x, y = (double)p.y, z = (double)p.z, r = sqrt(x * x + y * y + z * z) + 1e-9;
    double lobes = (x * x * x - 3 * x * y * y) / (r * r * r);
    (void)context;
    (void)gradient;
    return (peri_real)(r - 0.1 - 0.035 * lobes + 0.35 * fabs(z) * fabs(z) / (r + 0.05));
}

static int create(crowd *s) {
    peri_world_def def = peri_default_world_def();
    peri_body_def d = peri_default_body_def();
    peri_material m = peri_material_neo_hookean((peri_real)1.5e5, (peri_real)0.35, 1000);
    peri_collider_def wall = peri_default_collider_def();
    peri_vec3 low, high;
    peri_shape shape;
    peri_error err;
    peri_world *w;
    int k;
    def.parallel.threads = s->options.threads;
    w = peri_world_create(&def, &err);
    if (!w) return studio_error("%s", err.text);
    studio_stand_begin(&s->stand, w, 2);
    peri_collider_create(w, &wall);
    for (k = 0; k < 4; k++) {
        double side = k % 2 ? 0.85 : -0.85;
        wall.shape = peri_shape_box((peri_real)(k < 2 ? 0.05 : 0.9), (peri_real)(k < 2 ? 0.9 : 0.05), (peri_real)0.3);
        wall.position.x = (peri_real)(k < 2 ? side : 0);
        wall.position.y = (peri_real)(k < 2 ? 0 : side);
        wall.position.z = (peri_real)0.3;
        if (!peri_collider_create(w, &wall).index1) return studio_failed(w);
    }
    low.x = low.y = low.z = (peri_real)-0.2;
    high.x = high.y = high.z = (peri_real)0.2;
    shape = peri_shape_distance(star, NULL, low, high);
    d.material = peri_material_create(w, &m);
    d.spacing = (peri_real)0.04;
    for (k = 0; k < s->bodies; k++) {
        double a = 2.4 * k, q = 0.5 * a;     /* the golden angle: no two alike, no random numbers */
        peri_body_id id;
        d.position.x = (peri_real)(0.28 * (k % 5 - 2) + 0.02 * sin(a));
        d.position.y = (peri_real)(0.28 * (k / 5 % 5 - 2) + 0.02 * cos(a));
        d.position.z = (peri_real)(0.25 + 0.3 * (k / 25));
        d.rotation.x = (peri_real)(0.6 * sin(q));
        d.rotation.y = (peri_real)(0.8 * sin(q) * cos(3 * a));
        d.rotation.z = (peri_real)(0.8 * sin(q) * sin(3 * a));
        d.rotation.w = (peri_real)cos(q);
        id = studio_body(w, &shape, &d);
        if (!id.index1) return -1;
        if (!studio_stand_add(&s->stand, id, 0.024f, 0.45f + 0.45f * (float)sin(a) * (float)sin(a),
                              0.4f + 0.3f * (float)cos(1.7 * a), 0.75f - 0.35f * (float)sin(a))) return studio_error("too many");
    }
    studio_set(s->stand.target, 0, 0, 0.25f);
    s->stand.distance = 5.4f;
    s->stand.turn = 25;
    s->stand.rise = 32;
    s->stand.stage = 1.5f;
    return 0;
}

static int run(crowd *s) {
    int k, bad = 0, steps = s->options.frames;
    char text[64];
    for (k = 1; k <= steps && !bad; k++) {
        peri_stats stats;
        bad = studio_stand_step(&s->stand, dt);
        stats = peri_world_stats(s->stand.world);
        if (k == 2) s->held_in_flight = stats.factors_held, s->factors_in_flight = stats.factors;
        if (!s->asleep_at && stats.asleep == s->bodies) s->asleep_at = k;
        studio_progress(&s->options, k, steps, "falling");
        if (s->csv)
            fprintf(s->csv, "%d,%d,%d,%d,%d,%.3f\n", k, stats.islands, stats.asleep, stats.contacts, stats.iterations,
                    stats.profile.total);
        if (s->options.check || bad || (k != 20 && k != 60 && k != 200 && k != steps)) continue;
        snprintf(text, sizeof text, "%.1f s, %d asleep", k * (double)dt, stats.asleep);
        bad = studio_stand_moment(&s->stand, 4, text);
    }
    return bad;
}

/* Milliseconds of a step: median of many. */
static double step_time(peri_world *w) {
    enum { N = 2001 };
    static double t[N];
    int i, k;
    for (i = 0; i < N; i++) {
        double start = studio_seconds(), v;
        if (peri_world_step(w, dt)) return -1;
        v = 1e3 * (studio_seconds() - start);
        for (k = i; k > 0 && t[k - 1] > v; k--) t[k] = t[k - 1];
        t[k] = v;
    }
    return t[N / 2];
}

int main(int argc, char **argv) {
    static crowd s;
    peri_world_def def = peri_default_world_def();
    peri_world *empty = peri_world_create(&def, NULL);
    peri_body_id all = {0, 0};
    peri_measure m;
    int bad;
    if (studio_begin(&app, argc, argv, &s.options)) return studio_exit_code();
    s.bodies = (int)studio_number("--bodies", s.options.check ? 25 : 100);
    if (!s.options.check) s.csv = studio_csv(s.options.out, "crowd.csv", "step,islands,asleep,contacts,iterations,ms");
    bad = create(&s) || run(&s);
    if (s.csv) fclose(s.csv);
    bad |= studio_stand_end(&s.stand, &s.options, "crowd.png");
    memset(&m, 0, sizeof m);
    if (!bad && !peri_body_measure(s.stand.world, all, &m)) {
        peri_stats stats = peri_world_stats(s.stand.world);
        printf("%d bodies, %d particles; in flight %d factorisations, %d factors held; asleep after %.1f s\n", s.bodies,
               stats.particles, s.factors_in_flight, s.held_in_flight, s.asleep_at * (double)dt);
        printf("a step took %.1f ms on average; all asleep %.4f ms, an empty world %.4f ms\n",
               1e3 * s.stand.seconds / s.stand.steps, step_time(s.stand.world), step_time(empty));
        studio_check("factors held in flight", s.held_in_flight, "", 1, 1);
        studio_check("bodies asleep at the end", stats.asleep, "", s.bodies, s.bodies);
        studio_check("largest overlap", s.stand.overlap, "spacings", 0, 0.5);
        studio_check("lowest particle", m.lower[2], "m", 0, 0.1);
        studio_check("farthest particle", fmax(fmax(m.upper[0], -m.lower[0]), fmax(m.upper[1], -m.lower[1])), "m", 0, 0.82);
    }
    peri_world_destroy(s.stand.world);
    peri_world_destroy(empty);
    return bad ? 1 : studio_end(&s.options);
}
