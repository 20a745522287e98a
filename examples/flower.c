/* flower.c - a potted flower whose stem is stiffer than its leaves: gravity, a push on the stem, a push on a leaf.
 *
 * Answers SH figure 1 (a nonlinear, heterogeneous flower under gravity, a force on the stem, a force on a leaf; SH
 * section 6 calls its law St. Venant-Kirchhoff); SH = Xu et al. 2018, "Reformulating Hyperelastic Materials with
 * Peridynamic Modeling".  One body, one material, and a factor on every particle's stiffness
 * (peri_body_def.stiffness), which the part of the flower that it belongs to decides.
 * A second flower, its stem a tenth as stiff, shows what the map does.
 *
 *     cc -O2 examples/flower.c -lm -o flower && ./flower
 *
 * Writes to --out: flower.png (stiffness map, gravity, two pushes), flower.gif, flower.csv.
 * Contents: options, the flower, forces, steps, pictures, checks, main.
 */
#include "studio.h"

#define PERI_IMPLEMENTATION
#include "../peri.h"
#include "studio_peri.h"
#include "shapes.h"

static const float dt = 1.0f / 30, gravity = 9.81f; /* long steps: it is to come to rest */
enum { STEPS = 2, PHASES = 4, MAPPED = 0, PLAIN = 1, FLOWERS = 2 };

static const studio_app app = {
    "flower", "a flower of stiff and soft parts under gravity and two pushes",
    "  --spacing M    of the particles (0.024)\n"
    "  --young PA     Young's modulus of leaves and petals (40000)\n"
    "  --stem X       how many times as stiff the stem is (100)\n"
    "  --push N       force on the stem; a tenth of it on the leaf (10)\n"
    "  --density X    kg/m^3 (40)\n"
    "--model: stvk neo_hookean linear stvk_exact stable papers\n"
    "--solver: auto cholesky two-level jacobi chebyshev position\n"
    "--frames: of all four phases: gravity, stem, leaf, let go\n", 300};

typedef struct flower {
    studio_options options;
    studio_solid solid;
    studio_mesh mesh;
    float spacing, *points, *stiffness, *weak, *force, *colour;
    unsigned char *fixed, *part;
    int count;
    peri_world *world;
    studio_thing thing[FLOWERS];        /* as above; its stem a tenth as stiff */
    studio_worst worst;
    float *rest;                        /* positions under gravity, of the mapped one */
    peri_measure measure[FLOWERS];
    double head[PHASES][FLOWERS], leaf[PHASES]; /* ways of blossom and leaf tip from the rest shape, m */
    double balance[PHASES];             /* of the mapped one: unbalanced part of weight + push + reaction, share */
    double home;                        /* rms distance to the shape under gravity in the end, spacings */
    studio_image sheet;
} flower;

static const float apart[FLOWERS] = {0, 1.2f};      /* where they stand, m */

/* ---- the flower ---- */

/* The part that p belongs to. */
static int part_at(const flower *s, const float *p) {
    float q[3], d[SHAPES_PARTS];
    int k, best = 0;
    studio_set(q, p[0] / s->solid.size, p[1] / s->solid.size, p[2] / s->solid.size);
    shapes_flower_parts(q, d);
    for (k = 1; k < SHAPES_PARTS; k++)
        if (d[k] < d[best]) best = k;
    return best;
}

static int make_shape(flower *s) {
    static const float paint[SHAPES_PARTS][3] = {{0.36f, 0.52f, 0.24f}, {0.42f, 0.64f, 0.26f}, {0.93f, 0.55f, 0.62f},
                                                 {0.93f, 0.74f, 0.25f}};
    const float stem = (float)studio_number("--stem", 100);
    peri_shape shape;
    int i;
    s->solid.field = shapes_flower;
    s->solid.size = 1;
    studio_set(s->solid.lo, -0.45f, -0.40f, -0.06f);
    studio_set(s->solid.hi, 0.45f, 0.20f, 1.20f);
    s->spacing = (float)studio_number("--spacing", s->options.check ? 0.03 : 0.024);
    shape = studio_solid_shape(&s->solid);
    if (studio_solid_mesh(&s->solid, s->options.check ? 0.03f : 0.0125f, &s->mesh)) return -1;
    if (studio_fill_shape(&shape, s->spacing, &s->points, &s->count)) return -1;
    s->stiffness = (float *)studio_alloc((size_t)s->count, sizeof(float));
    s->weak = (float *)studio_alloc((size_t)s->count, sizeof(float));
    s->force = (float *)studio_alloc(3 * (size_t)s->count, sizeof(float));
    s->rest = (float *)studio_alloc(3 * (size_t)s->count, sizeof(float));
    s->fixed = (unsigned char *)studio_alloc((size_t)s->count, 1);
    s->part = (unsigned char *)studio_alloc((size_t)s->count, 1);
    s->colour = (float *)studio_alloc(3 * (size_t)s->mesh.vertices, sizeof(float));
    if (!s->stiffness || !s->weak || !s->force || !s->rest || !s->fixed || !s->part || !s->colour) return -1;
    for (i = 0; i < s->count; i++) {
        s->part[i] = (unsigned char)part_at(s, s->points + 3 * i);
        s->stiffness[i] = s->part[i] == SHAPES_STEM || s->part[i] == SHAPES_HEART ? stem : 1;
        s->weak[i] = s->stiffness[i] > 1 ? 0.1f * stem : 1;
        s->fixed[i] = s->points[3 * i + 2] < 0.04f;
    }
    for (i = 0; i < s->mesh.vertices; i++)
        memcpy(s->colour + 3 * i, paint[part_at(s, s->mesh.v + 3 * i)], 3 * sizeof(float));
    return 0;
}

static int create(flower *s) {
    static const float white[3] = {1, 1, 1};
    peri_world_def def = peri_default_world_def();
    peri_error err;
    peri_material m;
    int k;
    if (studio_solver(s->options.solver, &def.solver) || make_shape(s)) return -1;
    def.gravity.z = -gravity;
    def.tolerance = 1e-4f;  /* a thousandth of a spacing is newtons in the stem */
    def.max_iterations = 500;
    def.sleep_speed = 0;    /* forces are read at rest: let it rest by itself */
    def.parallel.threads = s->options.threads;
    s->world = peri_world_create(&def, &err);
    if (!s->world) return studio_error("%s", err.text);
    if (studio_material(s->options.model ? s->options.model : "stvk", studio_number("--young", 4e4), 0.3,
                        studio_number("--density", 40), &m))
        return -1;
    for (k = 0; k < FLOWERS; k++) {
        peri_body_def body = peri_default_body_def();
        body.material = peri_material_create(s->world, &m);
        if (!body.material.index1) return studio_failed(s->world);
        body.points = s->points;
        body.count = s->count;
        body.spacing = s->spacing;
        body.fixed = s->fixed;
        body.stiffness = k == MAPPED ? s->stiffness : s->weak;
        body.position.x = apart[k];
        if (studio_thing_make(&s->thing[k], s->world, &body, &s->mesh, white)) return -1;
    }
    return 0;
}

/* ---- forces ---- */

/* Shares a force out over the particles of a part around a place of the rest shape. */
static int push(flower *s, int part, const float *place, float radius, const float *force) {
    int i, n = 0;
    memset(s->force, 0, 3 * (size_t)s->count * sizeof(float));
    for (i = 0; i < s->count && part >= 0; i++) {
        float d[3];
        studio_along(s->points + 3 * i, -1, place, d);
        if (s->part[i] != part || studio_dot(d, d) > radius * radius) continue;
        memcpy(s->force + 3 * i, force, 3 * sizeof(float));
        n++;
    }
    if (part >= 0 && !n) return studio_error("no particle to push: take a smaller spacing");
    for (i = 0; i < 3 * s->count && n; i++) s->force[i] /= (float)n;
    return peri_body_set_forces(s->world, s->thing[MAPPED].body, 0, s->count, s->force) ? studio_failed(s->world) : 0;
}

static int begin_phase(flower *s, int phase) {
    static const float stem[3] = {0.01f, 0, 0.62f}, leaf[3] = {0.31f, 0, 0.475f};
    const float newton = (float)studio_number("--push", 10);
    float f[3];
    if (phase == 1) {
        studio_set(f, -newton, 0.2f * newton, 0);
        return push(s, SHAPES_STEM, stem, 0.07f, f);
    }
    if (phase == 2) {
        studio_set(f, 0, 0, -0.1f * newton);
        return push(s, SHAPES_LEAF, leaf, 0.08f, f);
    }
    return push(s, -1, NULL, 0, NULL);
}

/* Weight, push and what the pot bears must cancel in a flower at rest: what is left of them, in weights. */
static int weigh(flower *s, double *share) {
    float *f = (float *)studio_alloc(3 * (size_t)s->count, sizeof(float));
    double sum[3] = {0, 0, 0}, weight = s->measure[MAPPED].mass * (double)gravity, fixed = 0;
    int i, k, bad = !f || peri_body_forces(s->world, s->thing[MAPPED].body, f);
    for (i = 0; i < s->count && !bad; i++) {
        fixed += s->fixed[i];
        for (k = 0; k < 3; k++) sum[k] += (double)s->force[3 * i + k] + (s->fixed[i] ? -(double)f[3 * i + k] : 0);
    }
    free(f);
    sum[2] -= weight * (1 - fixed / s->count);
    *share = sqrt(sum[0] * sum[0] + sum[1] * sum[1] + sum[2] * sum[2]) / weight;
    return bad ? studio_failed(s->world) : 0;
}

/* Mean distance of a part's particles from the rest shape; of the leaf's only those near the tip that is pushed. */
static double moved(const flower *s, int k, int part) {
    const float *x = peri_body_positions(s->world, s->thing[k].body);
    double sum = 0;
    int i, n = 0;
    for (i = 0; i < s->count; i++) {
        float d[3];
        if (s->part[i] != part || (part == SHAPES_LEAF && s->points[3 * i] < 0.24f)) continue;
        studio_along(x + 3 * i, -1, s->points + 3 * i, d);
        d[0] -= apart[k];
        sum += sqrt((double)studio_dot(d, d));
        n++;
    }
    return n ? sum / n : 0;
}

static int end_phase(flower *s, int phase) {
    const float *x = peri_body_positions(s->world, s->thing[MAPPED].body);
    double sum = 0;
    int i, k;
    for (k = 0; k < FLOWERS; k++) {
        if (peri_body_measure(s->world, s->thing[k].body, &s->measure[k])) return studio_failed(s->world);
        s->head[phase][k] = moved(s, k, SHAPES_HEART);
    }
    s->leaf[phase] = moved(s, MAPPED, SHAPES_LEAF);
    if (phase == 0) memcpy(s->rest, x, 3 * (size_t)s->count * sizeof(float));
    for (i = 0; i < 3 * s->count; i++) sum += pow((double)(x[i] - s->rest[i]), 2);
    s->home = sqrt(sum / s->count) / (double)s->spacing;
    return weigh(s, &s->balance[phase]);
}

/* ---- pictures ---- */

static int add_pot(studio_scene *scene, float x) {
    static const float clay[3] = {0.72f, 0.42f, 0.30f}, soil[3] = {0.30f, 0.22f, 0.17f};
    float a[6], rim[6], earth[6];
    studio_set(a, x, 0, -0.26f);
    studio_set(a + 3, x, 0, 0);
    studio_set(rim, x, 0, -0.05f);
    studio_set(rim + 3, x, 0, 0.02f);
    studio_set(earth, x, 0, 0);
    studio_set(earth + 3, x, 0, 0.025f);
    return studio_scene_tube(scene, a, 2, 0.15f, NULL, clay, clay) ||
           studio_scene_tube(scene, rim, 2, 0.175f, NULL, clay, clay) ||
           studio_scene_tube(scene, earth, 2, 0.155f, NULL, soil, soil);
}

/* An arrow along the push, from where it comes to the place that it acts on. */
static int add_arrow(const flower *s, studio_scene *scene, int phase) {
    static const float red[3] = {0.85f, 0.20f, 0.16f};
    const float *x = peri_body_positions(s->world, s->thing[MAPPED].body);
    float tip[3] = {0, 0, 0}, f[3] = {0, 0, 0}, line[6], head[6], weight = 0;
    int i, k, bad = 0;
    if (phase != 1 && phase != 2) return 0;
    for (i = 0; i < s->count; i++) {
        float w = sqrtf(studio_dot(s->force + 3 * i, s->force + 3 * i));
        studio_along(tip, w, x + 3 * i, tip);
        studio_along(f, 1, s->force + 3 * i, f);
        weight += w;
    }
    if (!(weight > 0)) return 0;
    studio_unit(f);
    studio_set(tip, tip[0] / weight, tip[1] / weight, tip[2] / weight);
    studio_along(tip, -0.06f, f, tip);
    studio_along(tip, -0.26f, f, line);
    studio_along(tip, -0.08f, f, line + 3);
    bad = studio_scene_tube(scene, line, 2, 0.012f, NULL, red, red);
    for (k = 0; k < 8 && !bad; k++) { /* a cone of discs */
        studio_along(tip, -0.01f * (float)(8 - k), f, head);
        studio_along(tip, -0.01f * (float)(7 - k), f, head + 3);
        bad = studio_scene_tube(scene, head, 2, 0.004f * (float)(8 - k), NULL, red, red);
    }
    return bad;
}

static void look_at(studio_camera *camera, studio_scene *scene, int both) {
    float target[3];
    studio_set(target, both ? 0.46f * apart[PLAIN] : 0, 0, 0.50f);
    scene->look.height = -0.26f;
    studio_set(scene->look.centre, target[0], 0, 0.3f);
    scene->look.radius = 1.3f;
    scene->look.cell = 0.25f;
    studio_orbit(camera, target, 5.5f, both ? 10 : 20, 12, 19);
}

static int draw(flower *s, int phase, studio_image *im) {
    studio_scene scene;
    studio_camera camera;
    int k, bad = 0;
    studio_scene_begin(&scene);
    look_at(&camera, &scene, 1);
    for (k = 0; k < FLOWERS && !bad; k++)
        bad = studio_thing_draw(&s->thing[k], s->world, &scene, s->colour) || add_pot(&scene, apart[k]);
    bad = bad || add_arrow(s, &scene, phase) || studio_render(&scene, &camera, im);
    studio_scene_end(&scene);
    return bad;
}

static int draw_moment(flower *s, int phase) {
    static const char *const caption[PHASES] = {"gravity; right: a stem a tenth as stiff", "a push on the stem",
                                                "a push on a leaf", "let go"};
    enum { PW = 560, PH = 520, COLUMNS = 2 };
    studio_image panel = {0, 0, NULL};
    int bad = studio_image_make(&panel, PW, PH) ||
              (!s->sheet.rgb && studio_image_make(&s->sheet, COLUMNS * PW, PHASES / COLUMNS * PH)) ||
              draw(s, phase, &panel);
    if (!bad) studio_panel(&s->sheet, &panel, phase % COLUMNS, phase / COLUMNS, caption[phase]);
    studio_image_free(&panel);
    return bad;
}

/* ---- checks ---- */

/* Bounds.  Balance: statics, to a hundredth of the weight, which is where the solve's tolerance and the rest of
 * the motion end.  Stem: a beam
 * ten times as stiff bends a tenth as far while bending is small; the weak one's is not small, and the blossom's own
 * bending is the same in both, so an eighth is asked.  Leaf: the push bends it on at least as far as a spacing and
 * leaves the blossom where it was, to a tenth of that.  Home: an elastic body goes back to where it was, to a
 * tenth of a spacing. */
static void check(const flower *s) {
    double weight = s->measure[MAPPED].mass * (double)gravity;
    printf("%d particles in each of %d flowers, mass %.2f kg\n", s->count, (int)FLOWERS, s->measure[MAPPED].mass);
    studio_check("forces left at rest under gravity", s->balance[0], "weights", 0, 0.01);
    studio_check("forces left at rest, pushed on the stem", s->balance[1], "weights", 0, 0.01);
    studio_check("forces left at rest, pushed on the leaf", s->balance[2], "weights", 0, 0.01);
    studio_check("way of the blossom under gravity over that of the weak stem",
                 s->head[0][MAPPED] / s->head[0][PLAIN], "", 0, 0.125);
    studio_check("way of the blossom under the stem's push", s->head[1][MAPPED], "m", 0.05, 0.8);
    studio_check("way of the leaf's tip under its push", (s->leaf[2] - s->leaf[0]) / (double)s->spacing, "spacings", 1,
                 HUGE_VAL);
    studio_check("way of the blossom then over that of the leaf",
                 fabs(s->head[2][MAPPED] - s->head[0][MAPPED]) / (s->leaf[2] - s->leaf[0]), "", 0, 0.1);
    studio_check("rms distance to the shape under gravity in the end", s->home, "spacings", 0, 0.1);
    studio_check("kinetic energy in the end", s->measure[MAPPED].kinetic / weight, "weight m", 0, 1e-4);
    studio_check("steps not converged", s->worst.unconverged, "", 0, 0);
}

/* ---- main ---- */

static int run(flower *s) {
    studio_options *o = &s->options;
    studio_image im = {0, 0, NULL};
    studio_gif *gif = NULL;
    FILE *csv = NULL;
    int k, j, phase = -1, bad = 0;
    if (!o->check) {
        gif = studio_gif_begin(studio_path(o->out, "flower.gif"), o->width, o->height, 3);
        csv = studio_csv(o->out, "flower.csv", "time,blossom,blossom_plain,leaf,iterations");
        bad = !gif || !csv || studio_image_make(&im, o->width, o->height);
    }
    for (k = 0; k < o->frames && !bad; k++) {
        studio_progress(o, k, o->frames, NULL);
        if (k * PHASES / o->frames != phase) bad = begin_phase(s, phase = k * PHASES / o->frames);
        for (j = 0; j < STEPS && !bad; j++) bad = studio_step_world(s->world, dt, &s->worst);
        if (!bad && (k + 1) * PHASES / o->frames != phase) {
            bad = end_phase(s, phase);
            if (!bad && !o->check) bad = draw_moment(s, phase);
        }
        if (o->check || bad) continue;
        fprintf(csv, "%.4f,%.5f,%.5f,%.5f,%d\n", s->worst.steps * (double)dt, moved(s, MAPPED, SHAPES_HEART),
                moved(s, PLAIN, SHAPES_HEART), moved(s, MAPPED, SHAPES_LEAF), peri_world_stats(s->world).iterations);
        bad = draw(s, phase, &im) || studio_gif_frame(gif, &im);
    }
    studio_progress(o, k, o->frames, NULL);
    if (csv) fclose(csv);
    bad |= gif && studio_gif_end(gif);
    if (!bad && !o->check) bad = studio_png(studio_path(o->out, "flower.png"), &s->sheet);
    studio_image_free(&im);
    return bad;
}

int main(int argc, char **argv) {
    static flower s;
    int k, bad;
    if (studio_begin(&app, argc, argv, &s.options)) return studio_exit_code();
    bad = create(&s) || run(&s);
    if (!bad) check(&s);
    if (!bad && !s.options.check)
        printf("a step of 1/30 s took %.1f ms and %.1f iterations on average\n", 1000 * s.worst.seconds / s.worst.steps,
               (double)s.worst.iterations / s.worst.steps);
    for (k = 0; k < FLOWERS; k++) studio_thing_free(&s.thing[k]);
    studio_mesh_free(&s.mesh);
    studio_image_free(&s.sheet);
    free(s.points);
    free(s.stiffness);
    free(s.weak);
    free(s.force);
    free(s.rest);
    free(s.fixed);
    free(s.part);
    free(s.colour);
    peri_world_destroy(s.world);
    return bad ? 1 : studio_end(&s.options);
}
