/* crowd.c - a hundred small rabbits of jelly are poured into a tray.
 *
 * Many bodies of one shape: they share one reference shape's matrix and factor, touch one another with friction, and
 * fall asleep together; then a step costs next to nothing until one of them is touched.  This example measures that:
 * how many factors were made, and what a step costs while they fall, while they sleep, and in an empty world.
 *
 *     cc -O2 examples/crowd.c -lm -o crowd && ./crowd
 *
 * Writes to --out: crowd.png (four moments), crowd.gif, crowd_step.png (cost of a step over time), crowd.csv.
 * Contents: options, scene, steps, pictures, checks, main.
 */
#include "studio.h"

#define PERI_IMPLEMENTATION
#include "../peri.h"
#include "studio_peri.h"
#include "shapes.h"

static const float dt = 1.0f / 60, gravity = 9.81f, size = 0.2f, inside = 0.46f, wall = 0.04f, high = 0.30f; /* m */
enum { STEPS = 2, MOMENTS = 4, WALLS = 4 };

static const studio_app app = {
    "crowd", "a hundred copies of one soft shape fall into a tray and fall asleep",
    "  --count N      bodies (100)\n"
    "  --across N     particles along a body (7)\n"
    "  --young PA     Young's modulus (50000)\n"
    "  --density X    kg/m^3 (1000)\n"
    "  --friction X   of all (0.4)\n"
    "--model: neo_hookean linear stvk stvk_exact stable papers projective\n"
    "--solver: auto cholesky jacobi chebyshev position\n", 150};

typedef struct crowd {
    studio_options options;
    int count, particles;       /* bodies; particles in one */
    float spacing, *points;
    studio_solid solid;
    studio_mesh mesh;
    studio_thing *thing;
    peri_world *world;
    studio_worst worst;
    int factors;                /* made when the first step was taken, nothing touching yet */
    int asleep_at;              /* step after which all slept; 0: not yet */
    double flying, sleeping, empty; /* median ms of a step: of all before they slept, asleep, of an empty world */
    double *cost;               /* of every step, ms */
    studio_image sheet;
} crowd;

/* ---- scene ---- */

static int make_tray(crowd *s) {
    peri_collider_def def = peri_default_collider_def();
    int k;
    def.friction = (float)studio_number("--friction", 0.4);
    if (!peri_collider_create(s->world, &def).index1) return studio_failed(s->world);
    for (k = 0; k < WALLS; k++) {
        const float out = inside + wall;
        const int along_x = k < 2;
        def.shape = along_x ? peri_shape_box(inside + 2 * wall, wall, 0.5f * high)
                            : peri_shape_box(wall, inside + 2 * wall, 0.5f * high);
        def.position.x = along_x ? 0 : k == 2 ? out : -out;
        def.position.y = !along_x ? 0 : k == 0 ? out : -out;
        def.position.z = 0.5f * high;
        if (!peri_collider_create(s->world, &def).index1) return studio_failed(s->world);
    }
    return 0;
}

/* A number in 0..1 that depends on k alone. */
static float chance(int k) {
    unsigned u = (unsigned)k * 2654435761u;
    u ^= u >> 15;
    u *= 2246822519u;
    u ^= u >> 13;
    return (float)(u >> 8 & 0xffff) / 65535.0f;
}

static int make_bodies(crowd *s) {
    peri_body_def def = peri_default_body_def();
    peri_material m;
    const int row = 3;
    int k;
    if (studio_material(s->options.model, studio_number("--young", 5e4), 0.35, studio_number("--density", 1000), &m))
        return -1;
    def.material = peri_material_create(s->world, &m);
    if (!def.material.index1) return studio_failed(s->world);
    def.points = s->points;
    def.count = s->particles;
    def.spacing = s->spacing;
    def.friction = (float)studio_number("--friction", 0.4);
    for (k = 0; k < s->count; k++) { /* layers of 3 x 3, each turned another way */
        float rgb[3];
        int layer = k / (row * row), place = k % (row * row);
        studio_distinct(k, rgb);
        def.position.x = 0.27f * (float)(place % row - 1) + 0.02f * (chance(3 * k) - 0.5f);
        def.position.y = 0.27f * (float)(place / row - 1) + 0.02f * (chance(3 * k + 1) - 0.5f);
        def.position.z = 0.35f + 0.27f * (float)layer;
        def.rotation = studio_turn(chance(7 * k) - 0.5f, chance(7 * k + 1) - 0.5f, chance(7 * k + 2) - 0.5f + 1e-3f,
                                   360 * chance(7 * k + 3));
        if (studio_thing_make(&s->thing[k], s->world, &def, &s->mesh, rgb)) return -1;
    }
    return 0;
}

/* The points are put around the origin, so that a body turns about its middle. */
static int make_shape(crowd *s) {
    peri_shape shape;
    float lo[3], hi[3];
    int i;
    s->solid.field = shapes_rabbit;
    s->solid.size = size;
    studio_set(s->solid.lo, -0.4f, -0.45f, -0.05f);
    studio_set(s->solid.hi, 0.4f, 0.5f, 1.05f);
    s->spacing = size / (float)studio_number("--across", 7);
    shape = studio_solid_shape(&s->solid);
    if (studio_solid_mesh(&s->solid, (s->options.check ? 0.10f : 0.045f) * size, &s->mesh)) return -1;
    if (studio_fill_shape(&shape, s->spacing, &s->points, &s->particles)) return -1;
    studio_bounds(s->points, s->particles, lo, hi);
    for (i = 0; i < s->particles; i++) s->points[3 * i + 2] -= 0.5f * size;
    for (i = 0; i < s->mesh.vertices; i++) s->mesh.v[3 * i + 2] -= 0.5f * size;
    return 0;
}

static int create(crowd *s) {
    peri_world_def def = peri_default_world_def();
    peri_error err;
    if (studio_solver(s->options.solver, &def.solver)) return -1;
    s->count = (int)studio_number("--count", s->options.check ? 18 : 100);
    if (s->count < 1 || s->count > 10000) return studio_error("--count wants 1 to 10000, not %d", s->count);
    def.gravity.z = -gravity;
    def.parallel.threads = s->options.threads;
    s->world = peri_world_create(&def, &err);
    if (!s->world) return studio_error("%s", err.text);
    s->thing = (studio_thing *)studio_alloc((size_t)s->count, sizeof *s->thing);
    s->cost = (double *)studio_alloc((size_t)(s->options.frames * STEPS), sizeof(double));
    return !s->thing || !s->cost || make_shape(s) || make_tray(s) || make_bodies(s);
}

/* ---- steps ---- */

static int step(crowd *s) {
    double before = s->worst.seconds;
    if (studio_step_world(s->world, dt, &s->worst)) return -1;
    s->cost[s->worst.steps - 1] = 1000 * (s->worst.seconds - before);
    if (s->worst.steps == 1) s->factors = peri_world_stats(s->world).factors;
    if (peri_world_stats(s->world).asleep < s->count) s->asleep_at = 0;
    else if (!s->asleep_at) s->asleep_at = s->worst.steps;
    return 0;
}

static int by_size(const void *a, const void *b) {
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static double median(double *v, int n) {
    if (n < 1) return 0;
    qsort(v, (size_t)n, sizeof *v, by_size);
    return v[n / 2];
}

/* Median cost of a step of a world with nothing in it, ms. */
static double empty_step(void) {
    enum { TRIES = 1001 };
    static double cost[TRIES];
    peri_world_def def = peri_default_world_def();
    peri_world *w = peri_world_create(&def, NULL);
    int k;
    for (k = 0; w && k < TRIES; k++) {
        double start = studio_seconds();
        if (peri_world_step(w, dt)) break;
        cost[k] = 1000 * (studio_seconds() - start);
    }
    peri_world_destroy(w);
    return median(cost, TRIES);
}

/* Takes the figures of the run, and a thousand steps more of the sleeping world. */
static int measure(crowd *s) {
    enum { TRIES = 1001 };
    static double cost[TRIES];
    int k, bad = 0, awake = s->asleep_at ? s->asleep_at : s->worst.steps;
    for (k = 0; k < TRIES && s->asleep_at && !bad; k++) {
        double start = studio_seconds();
        bad = peri_world_step(s->world, dt) ? studio_failed(s->world) : 0;
        cost[k] = 1000 * (studio_seconds() - start);
    }
    s->sleeping = s->asleep_at ? median(cost, TRIES) : HUGE_VAL;
    s->empty = empty_step();
    s->flying = median(s->cost, awake);
    return bad;
}

/* ---- pictures ---- */

static int draw(crowd *s, studio_image *im) {
    static const float glass[3] = {0.45f, 0.47f, 0.50f};
    studio_scene scene;
    studio_camera camera;
    float target[3];
    int k, bad = 0;
    studio_scene_begin(&scene);
    studio_set(scene.look.centre, 0, 0, 0.4f);
    scene.look.radius = 1.3f;
    scene.look.cell = 0.25f;
    scene.look.gloss = 0.6f;
    for (k = 0; k < WALLS && !bad; k++) {
        const float o = inside + 2 * wall;
        float lo[3], hi[3];
        studio_set(lo, k == 2 ? inside : -o, k == 0 ? inside : -o, 0);
        studio_set(hi, k == 3 ? -inside : o, k == 1 ? -inside : o, high);
        bad = studio_scene_block(&scene, lo, hi, glass);
    }
    for (k = 0; k < s->count && !bad; k++) bad = studio_thing_draw(&s->thing[k], s->world, &scene, NULL);
    studio_set(target, 0, 0, 0.34f);
    studio_orbit(&camera, target, 4.6f, 32, 30, 20);
    bad = bad || studio_render(&scene, &camera, im);
    studio_scene_end(&scene);
    return bad;
}

static int draw_moment(crowd *s, int k) {
    enum { W = 640, H = 520, COLUMNS = 2 };
    studio_image panel = {0, 0, NULL};
    char text[64];
    int bad = studio_image_make(&panel, W, H) ||
              (!s->sheet.rgb && studio_image_make(&s->sheet, COLUMNS * W, MOMENTS / COLUMNS * H)) || draw(s, &panel);
    snprintf(text, sizeof text, "%.2f s, %d asleep", s->worst.steps * (double)dt, peri_world_stats(s->world).asleep);
    if (!bad) studio_panel(&s->sheet, &panel, k % COLUMNS, k / COLUMNS, text);
    studio_image_free(&panel);
    return bad;
}

/* ---- checks ---- */

/* Particles that are under the floor or outside the tray by more than half their contact distance, a quarter of a
 * spacing: the bound of a hard landing. */
static int escaped(const crowd *s) {
    const float slack = 0.25f * s->spacing;
    int i, k, out = 0;
    for (k = 0; k < s->count; k++) {
        const float *x = peri_body_positions(s->world, s->thing[k].body);
        for (i = 0; i < s->particles; i++)
            out += x[3 * i + 2] < 0.5f * s->spacing - slack - 0.5f * s->spacing ||
                   (x[3 * i + 2] < high && (fabsf(x[3 * i]) > inside + slack || fabsf(x[3 * i + 1]) > inside + slack));
    }
    return out;
}

/* Bounds.  Overlap: half a spacing is where a particle's centre comes to the other's surface.  One shape, one material,
 * one step size: one factor.  Asleep, a step is to cost like an empty world's; what it may cost more is the look at
 * every sleeping body, stated beforehand as a thousandth of what it costs awake plus a microsecond a body. */
static void check(const crowd *s) {
    const peri_stats stats = peri_world_stats(s->world);
    printf("%d bodies of %d particles\n", s->count, s->particles);
    studio_check("largest overlap", s->worst.overlap, "spacings", 0, 0.5);
    studio_check("particles out of the tray", escaped(s), "", 0, 0);
    studio_check("factors made for all while they fall", s->factors, "", 1, 1);
    studio_check("bodies asleep at the end", stats.asleep, "", s->count, s->count);
    studio_check("all asleep after", s->asleep_at ? s->asleep_at * (double)dt : -1, "s", 0, HUGE_VAL);
    studio_check("step asleep", s->sleeping, "ms", 0, s->empty + 1e-3 * s->flying + 1e-3 * s->count);
    studio_check("steps not converged", s->worst.unconverged, "", 0, 0);
    printf("%d factors made, contacts included; %d held at the end\n", stats.factors, stats.factors_held);
    printf("median step: %.3f ms awake, %.5f ms asleep, %.5f ms in an empty world\n", s->flying, s->sleeping, s->empty);
}

/* ---- main ---- */

static int frame(crowd *s, int k, FILE *csv, studio_plot *plot, studio_gif *gif, studio_image *im) {
    static const double at[MOMENTS] = {0.08, 0.22, 0.42, 1};
    int j, bad = 0;
    for (j = 0; j < STEPS && !bad; j++) {
        peri_stats stats;
        bad = step(s);
        stats = peri_world_stats(s->world);
        if (s->options.check || bad) continue;
        fprintf(csv, "%.4f,%.5f,%d,%d,%d,%.4f\n", s->worst.steps * (double)dt, s->cost[s->worst.steps - 1],
                stats.iterations, stats.contacts, stats.asleep, stats.overlap);
        studio_plot_point(plot, 0, s->worst.steps * (double)dt, fmax(s->cost[s->worst.steps - 1], 1e-4));
    }
    if (s->options.check || bad) return bad;
    for (j = 0; j < MOMENTS && !bad; j++)
        if (k == (int)(at[j] * (s->options.frames - 1) + 0.5)) bad = draw_moment(s, j);
    return bad || draw(s, im) || studio_gif_frame(gif, im);
}

static int run(crowd *s) {
    studio_options *o = &s->options;
    studio_image im = {0, 0, NULL};
    studio_plot plot;
    studio_gif *gif = NULL;
    FILE *csv = NULL;
    char note[64];
    int k, bad = 0;
    studio_plot_begin(&plot, "Cost of a step of the crowd", "time, s", "step, ms");
    plot.log_y = 1;
    studio_plot_series(&plot, NULL, STUDIO_LINE, NULL);
    if (!o->check) {
        gif = studio_gif_begin(studio_path(o->out, "crowd.gif"), o->width, o->height, 3);
        csv = studio_csv(o->out, "crowd.csv", "time,step_ms,iterations,contacts,asleep,overlap");
        bad = !gif || !csv || studio_image_make(&im, o->width, o->height);
    }
    for (k = 0; k < o->frames && !bad; k++) {
        snprintf(note, sizeof note, "%.2f s, %d asleep", s->worst.steps * (double)dt,
                 peri_world_stats(s->world).asleep);
        studio_progress(o, k, o->frames, note);
        bad = frame(s, k, csv, &plot, gif, &im);
    }
    studio_progress(o, k, o->frames, NULL);
    if (csv) fclose(csv);
    bad |= gif && studio_gif_end(gif);
    if (!bad && !o->check)
        bad = studio_png(studio_path(o->out, "crowd.png"), &s->sheet) ||
              studio_plot_write(&plot, studio_path(o->out, "crowd_step.png"), 720, 420);
    studio_plot_end(&plot);
    studio_image_free(&im);
    studio_image_free(&s->sheet);
    return bad || measure(s);
}

int main(int argc, char **argv) {
    static crowd s;
    int k, bad;
    if (studio_begin(&app, argc, argv, &s.options)) return studio_exit_code();
    bad = create(&s) || run(&s);
    if (!bad) check(&s);
    for (k = 0; k < s.count && s.thing; k++) studio_thing_free(&s.thing[k]);
    free(s.thing);
    free(s.cost);
    free(s.points);
    studio_mesh_free(&s.mesh);
    peri_world_destroy(s.world);
    return bad ? 1 : studio_end(&s.options);
}
