/* drop.c - a soft figure falls onto a ball, rolls off and comes to rest on the floor.
 *
 * The whole way from a triangle mesh to a moving picture: read a mesh, fill it with particles, give them a
 * material, let them fall on colliders with friction, move the fine mesh along, draw.  The scene is that of
 * SH figure 5 (a figure falls on the ground); SH = Xu et al. 2018, "Reformulating Hyperelastic Materials with
 * Peridynamic Modeling".  The comparison of materials made there is in figure.c.
 *
 *     cc -O2 examples/drop.c -lm -o drop && ./drop [mesh.obj] [--show skin|stress|particles]
 *
 * Writes to --out: drop.gif, drop.png (four moments, below them the particles with their stress), each moment
 * alone, drop.csv and its plot.  Contents: options, scene, steps, pictures, table and plot, checks, main.
 */
#include "studio.h"

#define PERI_IMPLEMENTATION
#include "../peri.h"
#include "studio_peri.h"

static const float dt = 1.0f / 60, gravity = 9.81f;
enum { STEPS = 2, MOMENTS = 4 }; /* steps in a frame; moments on drop.png: flight, squash, rebound, rest */
enum { SKIN, STRESS, PARTICLES };

static const studio_app app = {
    "drop", "a mesh, filled with soft particles, falls onto a ball and a floor",
    "  --show WHAT    skin, stress or particles in the animation (skin)\n"
    "  --across N     particles along the longest side (24)\n"
    "  --young PA     Young's modulus (40000)\n"
    "  --poisson X    Poisson's ratio (0.35)\n"
    "  --density X    kg/m^3 (500)\n"
    "  --height X     of the fall, in sizes of the mesh (0.8)\n"
    "  --friction X   coefficient of floor and ball (0.6)\n"
    "  --bdf2         second order in time: bounces longer\n"
    "  --keep-size    do not scale the mesh to 1 m\n"
    "  --y-up         the file has y upwards; here it is z\n"
    "--model: neo_hookean linear stvk stvk_exact stable papers projective\n"
    "--solver: auto cholesky two-level jacobi chebyshev position\n", 100};

/* What one picture shows. */
typedef struct view {
    double time;
    float *skin, *normal;       /* vertices of the fine mesh */
    float *particle, *stress;   /* particles, Pa */
} view;

typedef struct drop {
    studio_options options;
    studio_mesh mesh;           /* as read, around the origin */
    float size, spacing;        /* m */
    float *point;               /* sampled from the mesh */
    int count, *near;           /* particles; of every vertex: the nearest one */
    float ball[3], radius;      /* the obstacle */
    float young;
    peri_world *world;
    peri_body_id body;
    peri_skin_id skin;
    view now, moment[MOMENTS];
    peri_measure measure, first;
    double squash, rise;        /* elastic energy and height of the moments remembered */
    int steps, flying, iterations, unconverged;
    double seconds, growth, depth, swollen, shrunk, slip;  /* wall time; worst figures of the run, see observe() */
} drop;

/* ---- options ---- */

/* The place of the default model: below the working folder, or near this program. */
static const char *default_model(const char *program, char *path, size_t room) {
    static const char *tail[] = {"../../examples/models/figure.obj", "examples/models/figure.obj",
                                 "models/figure.obj", "../examples/models/figure.obj"};
    const char *slash = strrchr(program, '/');
    int k, folder = slash ? (int)(slash - program) + 1 : 0;
    for (k = -1; k < 4; k++) {
        FILE *f;
        if (k < 0) snprintf(path, room, "%s", tail[1]);
        else snprintf(path, room, "%.*s%s", folder, program, tail[k]);
        f = fopen(path, "rb");
        if (f) return fclose(f), path;
    }
    return tail[1];
}

/* ---- scene ---- */

static int load(drop *s, const char *program) {
    static const float origin[3] = {0, 0, 0};
    char path[STUDIO_PATH];
    float lo[3], hi[3];
    int i;
    if (studio_mesh_load(s->options.input ? s->options.input : default_model(program, path, sizeof path), &s->mesh))
        return -1;
    for (i = 0; studio_extra("--y-up") && i < s->mesh.vertices; i++) {
        float *v = s->mesh.v + 3 * i, y = v[1];
        v[1] = -v[2];
        v[2] = y;
    }
    studio_bounds(s->mesh.v, s->mesh.vertices, lo, hi);
    s->size = studio_extra("--keep-size") ? fmaxf(hi[0] - lo[0], fmaxf(hi[1] - lo[1], hi[2] - lo[2])) : 1.0f;
    studio_mesh_fit(&s->mesh, origin, s->size);
    return studio_mesh_normals(&s->mesh);
}

/* Fills the mesh with particles. */
static int sample(drop *s) {
    peri_shape shape = peri_shape_mesh(s->mesh.v, s->mesh.vertices, s->mesh.t, s->mesh.triangles);
    peri_error err;
    s->spacing = s->size / (float)studio_number("--across", s->options.check ? 16 : 24);
    if (peri_sample(&shape, s->spacing, NULL, 0, &s->count, &err)) return studio_error("%s", err.text);
    if (s->count == 0) return studio_error("no particle fits into the mesh; raise --across");
    s->point = (float *)studio_alloc(3 * (size_t)s->count, sizeof(float));
    if (!s->point) return -1;
    if (peri_sample(&shape, s->spacing, s->point, s->count, &s->count, &err)) return studio_error("%s", err.text);
    return 0;
}

static peri_quat turned(float x, float y, float z, float degrees) {
    float half = degrees * (float)(STUDIO_PI / 360), l = sinf(half) / sqrtf(x * x + y * y + z * z);
    peri_quat q;
    q.x = l * x;
    q.y = l * y;
    q.z = l * z;
    q.w = cosf(half);
    return q;
}

static int create_world(drop *s) {
    peri_world_def def = peri_default_world_def();
    peri_error err;
    if (studio_solver(s->options.solver, &def.solver)) return -1;
    def.gravity.z = -gravity;
    def.tolerance = 0.01f; /* a hundredth of a spacing is below what a picture shows */
    def.parallel.threads = s->options.threads;
    if (studio_extra("--bdf2")) def.integrator = PERI_BDF2;
    s->world = peri_world_create(&def, &err);
    return s->world ? 0 : studio_error("%s", err.text);
}

/* The floor is the plane z = 0; a ball stands half sunk in it. */
static int create_colliders(drop *s) {
    peri_collider_def def = peri_default_collider_def();
    def.friction = (float)studio_number("--friction", 0.6);
    if (!peri_collider_create(s->world, &def).index1) return studio_failed(s->world);
    s->radius = 0.28f * s->size;
    studio_set(s->ball, 0.25f * s->size, 0, 0.06f * s->size);
    def.shape = peri_shape_ball(s->radius);
    def.position.x = s->ball[0];
    def.position.y = s->ball[1];
    def.position.z = s->ball[2];
    if (!peri_collider_create(s->world, &def).index1) return studio_failed(s->world);
    return 0;
}

static int create_body(drop *s) {
    peri_body_def def = peri_default_body_def();
    peri_material m;
    s->young = (float)studio_number("--young", 40000);
    if (studio_material(s->options.model, (double)s->young, studio_number("--poisson", 0.35),
                        studio_number("--density", 500), &m))
        return -1;
    def.material = peri_material_create(s->world, &m);
    if (!def.material.index1) return studio_failed(s->world);
    def.points = s->point;
    def.count = s->count;
    def.spacing = s->spacing;
    def.position.x = 0.2f * s->size;
    def.position.z = s->size * (0.5f + (float)studio_number("--height", 0.8));
    def.rotation = turned(1, 0.15f, 0, 75);
    s->body = peri_body_create(s->world, &def);
    if (!s->body.index1) return studio_failed(s->world);
    s->skin = peri_skin_create(s->world, s->body, s->mesh.v, s->mesh.vertices, s->mesh.t, s->mesh.triangles);
    return s->skin.index1 ? 0 : studio_failed(s->world);
}

/* ---- steps ---- */

static int view_make(const drop *s, view *v) {
    size_t vertices = 3 * (size_t)s->mesh.vertices, count = (size_t)s->count;
    v->skin = (float *)studio_alloc(vertices, sizeof(float));
    v->normal = (float *)studio_alloc(vertices, sizeof(float));
    v->particle = (float *)studio_alloc(3 * count, sizeof(float));
    v->stress = (float *)studio_alloc(count, sizeof(float));
    return v->skin && v->normal && v->particle && v->stress ? 0 : -1;
}

static void view_copy(const drop *s, const view *from, view *to) {
    size_t vertices = 3 * (size_t)s->mesh.vertices * sizeof(float), count = (size_t)s->count * sizeof(float);
    to->time = from->time;
    memcpy(to->skin, from->skin, vertices);
    memcpy(to->normal, from->normal, vertices);
    memcpy(to->particle, from->particle, 3 * count);
    memcpy(to->stress, from->stress, count);
}

static void view_free(view *v) {
    free(v->skin);
    free(v->normal);
    free(v->particle);
    free(v->stress);
}

/* Takes skin, particles and stress out of the world. */
static int look(drop *s) {
    view *v = &s->now;
    if (peri_skin_update(s->world, s->skin, v->skin, v->normal)) return studio_failed(s->world);
    if (peri_body_values(s->world, s->body, PERI_VALUE_STRESS, v->stress)) return studio_failed(s->world);
    memcpy(v->particle, peri_body_positions(s->world, s->body), 3 * (size_t)s->count * sizeof(float));
    return 0;
}

/* Volume over rest volume: the mean determinant of the particles' deformation gradients. */
static int volume(drop *s, double *ratio) {
    float *f = (float *)studio_alloc(9 * (size_t)s->count, sizeof(float));
    double sum = 0;
    int i, k, bad = !f || peri_body_gradient(s->world, s->body, f);
    for (i = 0; i < s->count && !bad; i++) {
        double a[9];
        for (k = 0; k < 9; k++) a[k] = (double)f[9 * i + k];
        sum += peri_det3(a);
    }
    free(f);
    *ratio = sum / s->count;
    return bad ? studio_failed(s->world) : 0;
}

static double total(const peri_measure *m) { return m->kinetic + m->elastic + m->potential; }

/* Keeps the worst of the run: energy above that of the start, depth of a particle in the floor, volume; while
 * nothing touches, the difference of the momentum from m g t. */
static int observe(drop *s) {
    peri_measure *m = &s->measure;
    double ratio, fallen = m->mass * (double)gravity * s->now.time;
    if (peri_body_measure(s->world, s->body, m) || volume(s, &ratio)) return studio_failed(s->world);
    if (s->steps == 0) s->first = *m;
    s->growth = fmax(s->growth, total(m) / total(&s->first) - 1);
    s->depth = fmax(s->depth, 0.5 - m->lower[2] / (double)s->spacing);
    s->shrunk = fmin(s->shrunk, ratio);
    s->swollen = fmax(s->swollen, ratio);
    s->flying = s->flying && peri_world_stats(s->world).contacts == 0;
    if (s->flying && s->steps) s->slip = fmax(s->slip, fabs(m->momentum[2] + fallen) / fallen);
    return 0;
}

static int step(drop *s) {
    double start = studio_seconds();
    peri_stats stats;
    if (peri_world_step(s->world, dt)) return studio_failed(s->world);
    stats = peri_world_stats(s->world);
    s->seconds += studio_seconds() - start;
    s->steps++;
    s->iterations += stats.iterations;
    s->unconverged += !stats.converged;
    s->now.time = s->steps * (double)dt;
    return observe(s);
}

/* Remembers the moments of drop.png: before the first touch, the largest elastic energy, the highest centre after
 * it, and the end. */
static void remember(drop *s) {
    if (s->flying) view_copy(s, &s->now, &s->moment[0]);
    if (s->measure.elastic > s->squash) {
        s->squash = s->measure.elastic;
        s->rise = -HUGE_VAL;
        view_copy(s, &s->now, &s->moment[1]);
    }
    if (s->measure.centre[2] > s->rise) {
        s->rise = s->measure.centre[2];
        view_copy(s, &s->now, &s->moment[2]);
    }
    view_copy(s, &s->now, &s->moment[3]);
}

/* ---- pictures ---- */

/* The particle nearest to every vertex, in the rest shape: it lends the vertex its stress. */
static int find_nearest(drop *s) {
    int i, j;
    s->near = (int *)studio_alloc((size_t)s->mesh.vertices, sizeof(int));
    if (!s->near) return -1;
    for (i = 0; i < s->mesh.vertices; i++) {
        float best = FLT_MAX, away[3], d;
        for (j = 0; j < s->count; j++) {
            studio_along(s->mesh.v + 3 * i, -1, s->point + 3 * j, away);
            d = studio_dot(away, away);
            if (d < best) best = d, s->near[i] = j;
        }
    }
    return 0;
}

/* Stress at the upper end of the colours. */
static float full_scale(const drop *s) { return 0.4f * s->young; }

static int add_skin(const drop *s, studio_scene *scene, const view *v, int stressed) {
    static const float plush[3] = {0.24f, 0.62f, 0.50f};
    studio_mesh m = s->mesh;
    float *colour = NULL;
    int i, bad;
    m.v = v->skin;
    m.n = v->normal;
    if (stressed) colour = (float *)studio_alloc(3 * (size_t)m.vertices, sizeof(float));
    for (i = 0; colour && i < m.vertices; i++) studio_colormap(v->stress[s->near[i]] / full_scale(s), colour + 3 * i);
    bad = studio_scene_mesh(scene, &m, plush, colour);
    free(colour);
    return bad;
}

static int add_particles(const drop *s, studio_scene *scene, const view *v) {
    int i, bad = 0;
    for (i = 0; i < s->count && !bad; i++) {
        float rgb[3];
        studio_colormap(v->stress[i] / full_scale(s), rgb);
        bad = studio_scene_ball(scene, v->particle + 3 * i, 0.55f * s->spacing, rgb);
    }
    return bad;
}

static int draw(const drop *s, const view *v, int show, studio_image *im) {
    static const float red[3] = {0.80f, 0.33f, 0.27f};
    studio_scene scene;
    studio_camera camera;
    float target[3];
    int bad;
    studio_scene_begin(&scene);
    studio_set(scene.look.centre, 0, 0, 0.8f * s->size);
    scene.look.radius = 1.7f * s->size;
    scene.look.cell = 0.25f * s->size;
    bad = studio_scene_ball(&scene, s->ball, s->radius, red);
    if (show == PARTICLES) bad |= add_particles(s, &scene, v);
    else bad |= add_skin(s, &scene, v, show == STRESS);
    studio_set(target, -0.02f * s->size, 0, 0.74f * s->size);
    studio_orbit(&camera, target, 4.6f * s->size, 25, 14, 25);
    bad = bad || studio_render(&scene, &camera, im);
    studio_scene_end(&scene);
    return bad;
}

static void add_bar(const drop *s, studio_image *im) {
    studio_colorbar(im, im->width - 70, 50, 14, im->height / 3, 0, (double)full_scale(s) / 1000, "stress, kPa");
}

/* One column of drop.png, and the moment alone. */
static int draw_moment(const drop *s, int k, studio_image *sheet, studio_image *panel) {
    static const char *name[MOMENTS] = {"flight", "squash", "rebound", "rest"};
    static const float ink[3] = {0.2f, 0.22f, 0.26f};
    char text[STUDIO_PATH];
    if (draw(s, &s->moment[k], SKIN, panel)) return -1;
    snprintf(text, sizeof text, "%s/drop_%s.png", s->options.out, name[k]);
    if (studio_png(text, panel)) return -1;
    snprintf(text, sizeof text, "%s, %.2f s", name[k], s->moment[k].time);
    studio_text(panel, 20, 36, 15, ink, text);
    studio_image_paste(sheet, panel, k * panel->width, 0);
    if (draw(s, &s->moment[k], PARTICLES, panel)) return -1;
    if (k == MOMENTS - 1) add_bar(s, panel);
    studio_image_paste(sheet, panel, k * panel->width, panel->height);
    return 0;
}

static int draw_sheet(const drop *s) {
    studio_image sheet = {0, 0, NULL}, panel = {0, 0, NULL};
    char path[STUDIO_PATH];
    int k, bad = studio_image_make(&panel, 480, 480) || studio_image_make(&sheet, MOMENTS * 480, 2 * 480);
    for (k = 0; k < MOMENTS && !bad; k++) bad = draw_moment(s, k, &sheet, &panel);
    snprintf(path, sizeof path, "%s/drop.png", s->options.out);
    bad = bad || studio_png(path, &sheet);
    studio_image_free(&panel);
    studio_image_free(&sheet);
    return bad;
}

static int what_to_show(void) {
    const char *show = studio_extra("--show");
    if (!show || strcmp(show, "skin") == 0) return SKIN;
    if (strcmp(show, "stress") == 0) return STRESS;
    if (strcmp(show, "particles") == 0) return PARTICLES;
    return studio_error("--show wants skin, stress or particles, not %s", show);
}

/* ---- table and plot ---- */

static void add_row(const drop *s, FILE *csv, studio_plot *plot) {
    const peri_measure *m = &s->measure;
    double value[4];
    int k;
    value[0] = m->kinetic;
    value[1] = m->elastic;
    value[2] = m->potential;
    value[3] = total(m);
    fprintf(csv, "%.5f", s->now.time);
    for (k = 0; k < 4; k++) fprintf(csv, ",%.6g", value[k]);
    fprintf(csv, ",%.6g,%d\n", m->centre[2], peri_world_stats(s->world).iterations);
    for (k = 0; k < 4; k++) studio_plot_point(plot, k, s->now.time, value[k]);
}

static void plot_begin(studio_plot *plot) {
    static const char *name[] = {"kinetic", "elastic", "gravity", "total"};
    int k;
    studio_plot_begin(plot, "Energy of the falling figure", "time, s", "energy, J");
    for (k = 0; k < 4; k++) studio_plot_series(plot, name[k], k < 3 ? STUDIO_LINE : STUDIO_DASHED, NULL);
}

/* ---- checks ---- */

/* Bounds: the integrator is exact in flight but for rounding; contact is a stiff spring, so a hard landing may press
 * a particle in by a part of its radius, half a spacing; neo-Hookean matter at nu 0.35 may lose a tenth of its volume
 * while 200 J squeeze it, the other laws more. */
static void check(const drop *s) {
    double worst = 0, weight = s->first.mass * (double)(gravity * s->size);
    int i;
    for (i = 0; i < 3 * s->mesh.vertices; i++)
        if (!(fabs((double)s->now.skin[i]) <= worst)) worst = fabs((double)s->now.skin[i]);
    studio_check("momentum in flight, off m g t", s->slip, "", 0, 1e-5);
    studio_check("energy above that of the start", s->growth, "", 0, 1e-3);
    studio_check("deepest in the floor", s->depth, "spacings", -HUGE_VAL, 0.25);
    studio_check("smallest volume", s->shrunk, "of rest", s->options.model ? 0.6 : 0.85, 1);
    studio_check("largest volume", s->swollen, "of rest", 1, 1.05);
    studio_check("kinetic energy at the end", s->measure.kinetic / weight, "m g size", 0, 2e-3);
    studio_check("height of the centre at the end", s->measure.centre[2] / (double)s->size, "sizes", 0.05, 0.6);
    studio_check("farthest coordinate of the skin", worst / (double)s->size, "sizes", 0, 4);
    studio_check("steps not converged", s->unconverged, "", 0, 0);
}

/* ---- main ---- */

static int frame(drop *s, studio_plot *plot, FILE *csv, studio_gif *gif, studio_image *im) {
    int k, bad = 0;
    for (k = 0; k < STEPS && !bad; k++) {
        bad = step(s);
        if (csv && !bad) add_row(s, csv, plot);
    }
    if (bad || look(s)) return -1;
    remember(s);
    if (s->options.check) return 0;
    if (draw(s, &s->now, what_to_show(), im)) return -1;
    if (what_to_show() != SKIN) add_bar(s, im);
    return studio_gif_frame(gif, im);
}

static int run(drop *s) {
    studio_options *o = &s->options;
    studio_image im = {0, 0, NULL};
    studio_plot plot;
    studio_gif *gif = NULL;
    FILE *csv = NULL;
    char path[STUDIO_PATH], note[64];
    int k, bad = observe(s) || look(s);
    plot_begin(&plot);
    if (!o->check && !bad) {
        snprintf(path, sizeof path, "%s/drop.gif", o->out);
        gif = studio_gif_begin(path, o->width, o->height, 3);
        csv = studio_csv(o->out, "drop.csv", "time,kinetic,elastic,potential,total,centre_z,iterations");
        bad = !gif || !csv || studio_image_make(&im, o->width, o->height);
    }
    for (k = 0; k < o->frames && !bad; k++) {
        snprintf(note, sizeof note, "%.2f s, %d iterations", s->now.time, peri_world_stats(s->world).iterations);
        studio_progress(o, k, o->frames, note);
        bad = frame(s, &plot, csv, gif, &im);
    }
    studio_progress(o, k, o->frames, NULL);
    if (csv) fclose(csv);
    bad |= gif && studio_gif_end(gif);
    snprintf(path, sizeof path, "%s/drop_energy.png", o->out);
    bad = bad || (!o->check && (draw_sheet(s) || studio_plot_write(&plot, path, 720, 420)));
    studio_plot_end(&plot);
    studio_image_free(&im);
    return bad;
}

static int prepare(drop *s, const char *program) {
    int k, bad = what_to_show() < 0 || load(s, program) || sample(s) || view_make(s, &s->now);
    for (k = 0; k < MOMENTS && !bad; k++) bad = view_make(s, &s->moment[k]);
    return bad || create_world(s) || create_colliders(s) || create_body(s) || find_nearest(s);
}

static void release(drop *s) {
    int k;
    for (k = 0; k < MOMENTS; k++) view_free(&s->moment[k]);
    view_free(&s->now);
    free(s->near);
    free(s->point);
    studio_mesh_free(&s->mesh);
    peri_world_destroy(s->world);
}

int main(int argc, char **argv) {
    static drop s;
    int bad;
    if (studio_begin(&app, argc, argv, &s.options)) return studio_exit_code();
    s.flying = 1;
    s.shrunk = 1;
    bad = prepare(&s, argv[0]) || run(&s);
    if (!bad) check(&s);
    if (!bad && !s.options.check)
        printf("%d particles, %d triangles; a step of 1/60 s took %.1f ms and %.1f iterations on average\n", s.count,
               s.mesh.triangles, 1000 * s.seconds / s.steps, (double)s.iterations / s.steps);
    release(&s);
    return bad ? 1 : studio_end(&s.options);
}
