/* cloth.c - what sheets do: three bending stiffnesses, two horizons, and a trampoline that knows directions.
 *
 * Three scenes, each with its picture and its checks:
 *   bend        three square cloths fall over a ball and differ in the projective model's bending share alone (PP
 * figure               5).  That stiffness goes with the spacing squared; peri_body_def.bending, 0 here, is the
 * physical one   horizon     two cloths without any plate stiffness: horizon 2 d with weight 1 / (1 + r/delta),
 * and 4 d with               weight r/delta (SH figure 9): more neighbours alone resist a fold
 *   trampoline  a ball falls on a square sheet with a fixed border: isotropic, stiffer along one side, and stiffer
 *               along a diagonal (SH figure 6, Sigma = 4, 1/4, 1)
 * PP = He et al. 2017, "Projective Peridynamics for Modeling Versatile Elastoplastic Materials"; SH = Xu et al. 2018,
 * "Reformulating Hyperelastic Materials with Peridynamic Modeling".
 *
 *     cc -O2 examples/cloth.c -lm -o cloth && ./cloth
 *
 * Writes to --out: cloth.png (all three), cloth_bend.gif, cloth_horizon.gif, cloth_trampoline.gif.
 * Contents: options, a sheet, draping, the trampoline, pictures, checks, main.
 */
#include "studio.h"

#define PERI_IMPLEMENTATION
#include "../peri.h"
#include "studio_peri.h"

static const float dt = 1.0f / 60, gravity = 9.81f;
enum { BEND, HORIZON, TRAMPOLINE, SCENES };
enum { PANELS = 3, STEPS = 2, W = 520, H = 420 };   /* sheets of a scene at most; steps in a frame; size of a picture */

static const studio_app app = {
    "cloth", "sheets: bending stiffness, horizon, anisotropy",
    "  --scene NAME   bend, horizon, trampoline or all (all)\n"
    "  --across N     points along a sheet's side (41)\n"
    "--solver: auto cholesky jacobi chebyshev position\n"
    "--frames: of bend and horizon; the trampoline takes two thirds\n", 110};

/* One sheet and what it meets, alone in a world. */
typedef struct sheet {
    peri_world *world;
    studio_cloth cloth;
    studio_thing ball;          /* trampoline */
    studio_mesh skin;
    studio_worst worst;
    char label[64];
    double start, growth;       /* energy at the start, J; its largest rise, share */
    double above;               /* least distance of the ball above the sheet, spacings of the sheet */
    double inside;              /* deepest particle in the collider, spacings */
    double deepest, before;     /* of the trampoline, m; that of the frame before */
    int touched, taken;         /* the ball has touched; the picture of the deepest moment is made */
    double dent[2];             /* its deflection half way to the rails: along x over along y, along one diagonal over
                                   the other */
} sheet;

typedef struct cloth {
    studio_options options;
    int across;
    float side, spacing;
    sheet at[SCENES][PANELS];
    studio_image sheet;
} cloth;

static const int panels[SCENES] = {3, 2, 3};
static const float pole_radius = 0.22f;     /* of the ball under the cloths, m */

/* ---- options ---- */

static int wanted(int scene) {
    static const char *const names[SCENES] = {"bend", "horizon", "trampoline"};
    const char *name = studio_extra("--scene");
    return !name || !strcmp(name, "all") || !strcmp(name, names[scene]);
}

static int read_options(cloth *c) {
    static const char *const known[] = {"all", "bend", "horizon", "trampoline"};
    if (studio_choice("--scene", studio_extra("--scene"), known, 4) < 0) return -1;
    c->across = (int)studio_number("--across", c->options.check ? 25 : 41);
    if (c->across < 9 || c->across > 400) return studio_error("--across wants 9 to 400, not %d", c->across);
    c->side = 1.2f;
    c->spacing = c->side / (float)c->across;
    return 0;
}

/* ---- a sheet ---- */

static int world_of(const cloth *c, sheet *s) {
    peri_world_def def = peri_default_world_def();
    peri_error err;
    if (studio_solver(c->options.solver, &def.solver)) return -1;
    def.gravity.z = -gravity;
    def.tolerance = 0.005f;
    def.max_iterations = 500; /* sheets without plate stiffness are hard */
    def.parallel.threads = c->options.threads;
    s->world = peri_world_create(&def, &err);
    return s->world ? 0 : studio_error("%s", err.text);
}

static int body_of(const cloth *c, sheet *s, peri_body_def *def, const peri_material *m) {
    def->points = s->cloth.points;
    def->fixed = s->cloth.fixed;
    def->count = c->across * c->across;
    def->spacing = c->spacing;
    def->material = peri_material_create(s->world, m);
    if (!def->material.index1) return studio_failed(s->world);
    s->cloth.body = peri_body_create(s->world, def);
    return s->cloth.body.index1 ? 0 : studio_failed(s->world);
}

/* ---- draping ---- */

/* A cloth of 1.2 m over a ball on a post.  k: which of the scene's. */
static int make_drape(const cloth *c, int scene, int k, sheet *s) {
    static const float share[PANELS] = {0.05f, 0.3f, 1};
    peri_body_def def = peri_default_sheet_def(0.006f);
    peri_collider_def post = peri_default_collider_def();
    peri_material m;
    if (world_of(c, s) || studio_cloth_points(&s->cloth, c->across, c->across, c->spacing)) return -1;
    if (scene == BEND) {
        m = peri_material_projective(1e5f, share[k], 100);
        snprintf(s->label, sizeof s->label, "bending share %g", (double)share[k]);
    } else {
        m = peri_material_linear(1e6f, 0.25f, 100);
        def.horizon = k ? 4.01f : 2.01f;
        def.kernel = k ? PERI_KERNEL_POWER : PERI_KERNEL_SHIFTED;
        def.kernel_power = -1;
        snprintf(s->label, sizeof s->label, k ? "horizon 4 d, weight r/delta" : "horizon 2 d, weight 1/(1 + r/delta)");
    }
    def.bending = 0;
    def.position.z = 0.72f + 0.02f;
    def.rotation = studio_turn(0, 0, 1, 20);
    post.shape = peri_shape_ball(pole_radius);
    post.position.z = 0.72f - pole_radius - 0.5f * c->spacing;
    post.friction = 0.4f;
    if (!peri_collider_create(s->world, &post).index1) return studio_failed(s->world);
    return body_of(c, s, &def, &m);
}

/* ---- the trampoline ---- */

static int make_trampoline(const cloth *c, int k, sheet *s) {
    static const float pink[3] = {0.86f, 0.45f, 0.42f}, half = 0.70710678f;
    static const char *const label[PANELS] = {"isotropic", "4 : 1/4, along the sides", "4 : 1/4, along a diagonal"};
    peri_body_def def = peri_default_sheet_def(0.004f), ball = peri_default_body_def();
    peri_material m = peri_material_linear(1e6f, 0.25f, 300), rubber = peri_material_neo_hookean(3e5f, 0.3f, 500);
    peri_shape shape = peri_shape_ball(0.13f);
    studio_solid solid;
    float *points = NULL;
    int bad;
    snprintf(s->label, sizeof s->label, "%s", label[k]);
    if (world_of(c, s) || studio_cloth_points(&s->cloth, c->across, c->across, c->spacing)) return -1;
    studio_cloth_hold(&s->cloth, 1);
    if (k) {
        m.anisotropic = 1;
        m.strength[0] = 4;
        m.strength[1] = 0.25f;
        m.strength[2] = 1;
    }
    if (k == 2) { /* columns: (1, 1, 0) and (-1, 1, 0) over root 2 */
        m.direction[0] = m.direction[3] = m.direction[4] = half;
        m.direction[1] = -half;
    }
    def.position.z = 0.5f;
    if (body_of(c, s, &def, &m)) return -1;
    solid.field = studio_ball_field;
    solid.context = NULL;
    solid.size = 0.13f;
    studio_set(solid.lo, -1.1f, -1.1f, -1.1f);
    studio_set(solid.hi, 1.1f, 1.1f, 1.1f);
    ball.spacing = 0.13f / 4;
    ball.position.z = 0.5f + 0.13f + 0.5f;
    ball.material = peri_material_create(s->world, &rubber);
    if (!ball.material.index1) return studio_failed(s->world);
    if (studio_solid_mesh(&solid, 0.02f, &s->skin)) return -1;
    if (studio_fill_shape(&shape, ball.spacing, &points, &ball.count)) return -1;
    ball.points = points;
    bad = studio_thing_make(&s->ball, s->world, &ball, &s->skin, pink);
    free(points);
    return bad;
}

/* Deflection of the point i, j steps from the middle, m. */
static double depth_at(const cloth *c, const float *x, int i, int j) {
    const int middle = c->across / 2;
    return 0.5 - (double)x[3 * ((middle + j) * c->across + middle + i) + 2];
}

/* The shape of the dent at the deepest moment: a direction that bears more is longer. */
static void shape_of_dent(const cloth *c, sheet *s) {
    const float *x = peri_body_positions(s->world, s->cloth.body);
    const int q = c->across / 4, d = (int)(0.7071 * c->across / 4 + 0.5);
    double deepest = depth_at(c, x, 0, 0);
    s->touched |= peri_world_stats(s->world).contacts > 0;
    if (!s->touched || deepest <= s->deepest) return;
    s->deepest = deepest;
    s->dent[0] = (depth_at(c, x, q, 0) + depth_at(c, x, -q, 0)) / (depth_at(c, x, 0, q) + depth_at(c, x, 0, -q));
    s->dent[1] = (depth_at(c, x, d, d) + depth_at(c, x, -d, -d)) / (depth_at(c, x, d, -d) + depth_at(c, x, -d, d));
}

/* ---- steps ---- */

static double total(const peri_measure *m) { return m->kinetic + m->elastic + m->potential; }

static int observe(const cloth *c, int scene, sheet *s) {
    const float *x = peri_body_positions(s->world, s->cloth.body);
    peri_body_id all = {0, 0};
    peri_measure m;
    int i;
    if (peri_body_measure(s->world, all, &m)) return studio_failed(s->world);
    if (s->worst.steps == 0) {
        s->start = total(&m);
        s->above = HUGE_VAL;
    }
    s->growth = fmax(s->growth, (total(&m) - s->start) / fabs(s->start));
    if (scene == TRAMPOLINE) {
        shape_of_dent(c, s);
        s->above = fmin(s->above, studio_cloth_above(&s->cloth, s->world, s->ball.body, 3 * c->spacing) /
                                      (double)c->spacing);
        return 0;
    }
    for (i = 0; i < c->across * c->across; i++) {
        float d[3], centre[3];
        studio_set(centre, 0, 0, 0.72f - pole_radius - 0.5f * c->spacing);
        studio_along(x + 3 * i, -1, centre, d);
        s->inside = fmax(s->inside, 0.5 + (double)((pole_radius - sqrtf(studio_dot(d, d))) / c->spacing));
    }
    return 0;
}

static int step(const cloth *c, int scene, sheet *s) {
    return studio_step_world(s->world, dt, &s->worst) || observe(c, scene, s);
}

/* How far the corners hang below the top of the ball, on average, m. */
static double droop(const cloth *c, const sheet *s) {
    const float *x = peri_body_positions(s->world, s->cloth.body);
    int n = c->across;
    return 0.72 - 0.25 * (double)(x[2] + x[3 * (n - 1) + 2] + x[3 * n * (n - 1) + 2] + x[3 * (n * n - 1) + 2]);
}

/* ---- pictures ---- */

/* Colours of the trampoline by depth. */
static float *depths(const cloth *c, const float *x) {
    const int n = c->across * c->across;
    float *rgb = (float *)studio_alloc(3 * (size_t)n, sizeof(float));
    int i;
    for (i = 0; i < n && rgb; i++) {
        float depth = (0.5f - x[3 * i + 2]) / 0.27f;
        studio_colormap(1 - studio_clamp(depth, 0, 1), rgb + 3 * i);
    }
    return rgb;
}

static int add_stand(const cloth *c, studio_scene *scene) {
    static const float grey[3] = {0.55f, 0.57f, 0.60f};
    float post[6], centre[3];
    studio_set(centre, 0, 0, 0.72f - pole_radius - 0.5f * c->spacing);
    studio_set(post, 0, 0, 0);
    studio_set(post + 3, 0, 0, centre[2]);
    return studio_scene_ball(scene, centre, pole_radius, grey) ||
           studio_scene_tube(scene, post, 2, 0.04f, NULL, grey, grey);
}

static int add_rails(const cloth *c, studio_scene *scene) {
    static const float wood[3] = {0.62f, 0.48f, 0.34f};
    const float h = 0.5f * (c->side - c->spacing), corner[5][2] = {{-h, -h}, {h, -h}, {h, h}, {-h, h}, {-h, -h}};
    int k, bad = 0;
    for (k = 0; k < 4 && !bad; k++) {
        float rail[6], post[6];
        studio_set(rail, corner[k][0], corner[k][1], 0.5f);
        studio_set(rail + 3, corner[k + 1][0], corner[k + 1][1], 0.5f);
        studio_set(post, corner[k][0], corner[k][1], 0);
        studio_set(post + 3, corner[k][0], corner[k][1], 0.5f);
        bad = studio_scene_tube(scene, rail, 2, 0.02f, NULL, wood, wood) ||
              studio_scene_tube(scene, post, 2, 0.02f, NULL, wood, wood) ||
              studio_scene_ball(scene, post + 3, 0.026f, wood);
    }
    return bad;
}

static int draw(const cloth *c, int scene_of, sheet *s, studio_image *im) {
    static const float red[3] = {0.78f, 0.28f, 0.24f}, blue[3] = {0.25f, 0.42f, 0.66f}, white[3] = {1, 1, 1};
    static const float faded[3] = {1, 0.86f, 0.80f}, dark[3] = {0.8f, 0.8f, 0.8f};
    studio_scene scene;
    studio_camera camera;
    float target[3], *colour = NULL;
    int bad;
    studio_scene_begin(&scene);
    studio_set(scene.look.centre, 0, 0, 0.4f);
    scene.look.radius = 1.2f;
    scene.look.cell = 0.25f;
    scene.look.gloss = 0.15f;
    if (scene_of == TRAMPOLINE) {
        colour = depths(c, peri_body_positions(s->world, s->cloth.body));
        bad = !colour || studio_cloth_draw(&s->cloth, s->world, &scene, white, colour, dark) ||
              add_rails(c, &scene) || studio_thing_draw(&s->ball, s->world, &scene, NULL);
    } else
        bad = studio_cloth_draw(&s->cloth, s->world, &scene, scene_of == BEND ? red : blue, NULL, faded) ||
              add_stand(c, &scene);
    free(colour);
    studio_set(target, 0, 0, scene_of == TRAMPOLINE ? 0.40f : 0.42f);
    studio_orbit(&camera, target, 5.2f, 24, scene_of == TRAMPOLINE ? 50 : 14, scene_of == TRAMPOLINE ? 19 : 17);
    bad = bad || studio_render(&scene, &camera, im);
    studio_scene_end(&scene);
    return bad;
}

/* All sheets of a scene side by side. */
static int draw_row(cloth *c, int scene, studio_image *row, studio_image *panel) {
    int k, bad = 0;
    for (k = 0; k < panels[scene] && !bad; k++) {
        sheet *s = &c->at[scene][k];
        bad = draw(c, scene, s, panel);
        if (!bad) studio_panel(row, panel, k, 0, s->label);
    }
    return bad;
}

/* ---- checks ---- */

/* Bounds.  Contact: half a contact distance, half a spacing, is where a point of the sheet would come to the other's
 * surface; the ball under the cloths is a collider, which a hard landing may enter by a quarter (peri.h).  Energy:
 * as in drop.c.  Order: a stiffer sheet droops less; by the papers, no number.  Dents, half
 * way to the rails: by symmetry equal in both directions of a pair, to a hundredth (the solve stops at a
 * two-hundredth of a spacing, the dent is spacings deep); the direction that is 16 times as stiff bears more and
 * is longer, by at least five times that hundredth. */
static void check(cloth *c) {
    static const char *const scene_name[SCENES] = {"bend", "horizon", "trampoline"};
    char name[96];
    int scene, k;
    for (scene = 0; scene < SCENES; scene++)
        for (k = 0; k < panels[scene] && wanted(scene); k++) {
            const sheet *s = &c->at[scene][k];
            printf("%s, %s:\n", scene_name[scene], s->label);
            studio_check("  steps not converged", s->worst.unconverged, "", 0, 0);
            studio_check("  energy above that of the start", s->growth, "", 0, 1e-3);
            if (scene == TRAMPOLINE) {
                studio_check("  largest overlap", s->worst.overlap, "spacings", 0, 0.5);
                studio_check("  least height of a particle above the sheet", s->above, "spacings", 0, HUGE_VAL);
            } else studio_check("  deepest in the ball", s->inside, "spacings", 0, 0.25);
        }
    for (scene = 0; scene <= HORIZON; scene++)
        for (k = 1; k < panels[scene] && wanted(scene); k++) {
            snprintf(name, sizeof name, "droop of %s over that of %s", c->at[scene][k].label,
                     c->at[scene][k - 1].label);
            studio_check(name, droop(c, &c->at[scene][k]) / droop(c, &c->at[scene][k - 1]), "", 0, 0.98);
        }
    if (!wanted(TRAMPOLINE)) return;
    for (k = 0; k < PANELS; k++) {
        const double *dent = c->at[TRAMPOLINE][k].dent;
        printf("dent, %s, %.1f spacings deep:\n", c->at[TRAMPOLINE][k].label,
               c->at[TRAMPOLINE][k].deepest / (double)c->spacing);
        studio_check("  along x over along y", dent[0], "", k == 1 ? 1.05 : 0.99, k == 1 ? HUGE_VAL : 1.01);
        studio_check("  along one diagonal over the other", dent[1], "", k == 2 ? 1.05 : 0.99,
                     k == 2 ? HUGE_VAL : 1.01);
    }
}

/* ---- main ---- */

/* Copies panel k of a row to the sheet of pictures: a trampoline's at the deepest moment after the touch, which is
 * known when it has passed, a cloth's in the end. */
static void take(cloth *c, int scene, int k, int last, const studio_image *row) {
    sheet *s = &c->at[scene][k];
    int y, x = (c->sheet.width - row->width) / 2 + k * W;
    const int now = s->touched && s->deepest <= s->before;
    s->before = s->deepest;
    if (s->taken || !(last || (scene == TRAMPOLINE && now))) return;
    s->taken = 1;
    for (y = 0; y < H; y++)
        memcpy(c->sheet.rgb + 3 * ((size_t)(scene * H + y) * (size_t)c->sheet.width + (size_t)x),
               row->rgb + 3 * ((size_t)y * (size_t)row->width + (size_t)(k * W)), 3 * (size_t)W);
}

static int run(cloth *c, int scene) {
    static const char *const file[SCENES] = {"cloth_bend.gif", "cloth_horizon.gif", "cloth_trampoline.gif"};
    const int frames = scene == TRAMPOLINE ? 2 * c->options.frames / 3 : c->options.frames, still = frames - 1;
    int k, j, f, bad = 0;
    studio_image row = {0, 0, NULL}, panel = {0, 0, NULL};
    studio_gif *gif = NULL;
    for (k = 0; k < panels[scene] && !bad; k++)
        bad = (scene == TRAMPOLINE ? make_trampoline(c, k, &c->at[scene][k])
                                   : make_drape(c, scene, k, &c->at[scene][k])) ||
              observe(c, scene, &c->at[scene][k]);
    if (!c->options.check && !bad) {
        bad = studio_image_make(&panel, W, H) || studio_image_make(&row, panels[scene] * W, H);
        gif = bad ? NULL : studio_gif_begin(studio_path(c->options.out, file[scene]), row.width, row.height, 3);
        bad = !gif;
    }
    for (f = 0; f < frames && !bad; f++) {
        studio_progress(&c->options, f, frames, file[scene]);
        for (k = 0; k < panels[scene]; k++)
            for (j = 0; j < STEPS && !bad; j++) bad = step(c, scene, &c->at[scene][k]);
        if (bad || c->options.check) continue;
        bad = draw_row(c, scene, &row, &panel) || studio_gif_frame(gif, &row);
        for (k = 0; k < panels[scene]; k++) take(c, scene, k, f == still, &row);
    }
    studio_progress(&c->options, frames, frames, NULL);
    bad |= gif && studio_gif_end(gif);
    studio_image_free(&row);
    studio_image_free(&panel);
    return bad;
}

static void release(cloth *c) {
    int scene, k;
    for (scene = 0; scene < SCENES; scene++)
        for (k = 0; k < PANELS; k++) {
            sheet *s = &c->at[scene][k];
            studio_cloth_free(&s->cloth);
            studio_thing_free(&s->ball);
            studio_mesh_free(&s->skin);
            peri_world_destroy(s->world);
        }
    studio_image_free(&c->sheet);
}

int main(int argc, char **argv) {
    static cloth c;
    int scene, k, bad;
    if (studio_begin(&app, argc, argv, &c.options)) return studio_exit_code();
    bad = read_options(&c) || (!c.options.check && studio_image_make(&c.sheet, PANELS * W, SCENES * H));
    for (scene = 0; scene < SCENES && !bad; scene++)
        if (wanted(scene)) bad = run(&c, scene);
    if (!bad) check(&c);
    if (!bad && !c.options.check) bad = studio_png(studio_path(c.options.out, "cloth.png"), &c.sheet);
    for (scene = 0; scene < SCENES && !bad; scene++)
        for (k = 0; k < panels[scene] && wanted(scene); k++) {
            const studio_worst *w = &c.at[scene][k].worst;
            printf("%-38s %5.1f ms and %5.1f iterations a step\n", c.at[scene][k].label,
                   1000 * w->seconds / w->steps, (double)w->iterations / w->steps);
        }
    release(&c);
    return bad ? 1 : studio_end(&c.options);
}
