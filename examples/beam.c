/* beam - beams that fall, hang, are pulled and get thinner.
 *
 * Answers PP figure 1 (one answer whatever the time step), SH figure 4 (basis functions under one load) and SH figure 8
 * (Poisson's ratios and kernels).  PP = "Projective Peridynamics for Modeling Versatile Elastoplastic Materials", He,
 * Wang, Wu 2017; SH = "Reformulating Hyperelastic Materials with Peridynamic Modeling", Xu et al. 2018.
 * Every beam is 1 x 0.2 x 0.2 m, E = 1e5 Pa, 1000 kg/m^3, clamped at x = 0:
 *
 *   falling     under full gravity with time steps of 1, 4 and 16 ms, by backward Euler and by BDF2.  The way down is
 *               the same for all.  Backward Euler takes energy out (BDF2 much less), so its beam swings back less high;
 *               from the second swing on the ripples of the impact set all of them apart.
 *   hanging     under 1/200 of gravity: tip deflection against finite elements.
 *   pulled      by a constant force: how far depends on the basis function of the stretch model.
 *   thinner     lateral contraction against the Poisson's ratio that was asked for, by model and kernel.
 *
 *   cc -O2 examples/beam.c -lm -o beam && ./beam       tables and four pictures in build/out/beam
 *   ./beam --model projective                          the falling beam of another material
 *   ./beam --check                                     numbers only
 */
#include "studio.h"

#define PERI_IMPLEMENTATION
#include "../peri.h"
#include "studio_peri.h"

static const double young = 1e5, density = 1000;
static const float ink[3] = {0.13f, 0.15f, 0.19f};

static const studio_app app = {"beam",
                               "Beams: one answer for three time steps, finite elements, basis functions, Poisson's\n"
                               "ratios (PP figure 1, SH figures 4 and 8).\n"
                               "models (falling beam): neo_hookean linear projective papers stvk stvk_exact stable\n"
                               "solvers: auto cholesky two-level jacobi chebyshev position\n"
                               "--frames is the time of the falling beams in steps of 16 ms\n",
                               NULL, 94};

/* ---------------------------------------------------------------------------------------------- the beam -------- */

enum { GRIP = 2 }; /* layers of held particles: x = 0 lies half way between the last held and the first free one */

typedef struct beam_def {
    int across;                 /* particles over the height */
    int both;                   /* 1: the far end is gripped too */
    peri_material material;
    peri_kernel kernel;
    peri_integrator integrator;
    double gravity;             /* m/s^2, downwards */
    double tolerance;           /* spacings */
} beam_def;

typedef struct beam {
    beam_def def;
    int along, layers, count;   /* free layers, all layers, particles */
    double spacing;
    peri_world *world;
    peri_body_id body;
    peri_real *rest, *x;        /* 3 count; x is for whoever needs it */
    unsigned char *held;
} beam;

static beam_def default_beam(void) {
    beam_def d;
    d.across = 6;
    d.both = 0;
    d.material = peri_material_neo_hookean((peri_real)young, (peri_real)0.25, (peri_real)density);
    d.kernel = PERI_KERNEL_POWER;
    d.integrator = PERI_BACKWARD_EULER;
    d.gravity = 0;
    d.tolerance = 1e-3;
    return d;
}

/* Lattice of the beam, layer by layer from the clamp to the tip. */
static int beam_sample(beam *b) {
    int n = b->def.across, i;
    b->along = 5 * n;
    b->layers = b->along + (b->def.both ? 2 : 1) * GRIP;
    b->count = b->layers * n * n;
    b->spacing = 0.2 / n;
    b->rest = (peri_real *)studio_alloc(3 * (size_t)b->count, sizeof(peri_real));
    b->x = (peri_real *)studio_alloc(3 * (size_t)b->count, sizeof(peri_real));
    b->held = (unsigned char *)studio_alloc((size_t)b->count, 1);
    if (!b->rest || !b->x || !b->held) return -1;
    for (i = 0; i < b->count; i++) {
        int layer = i / (n * n) - GRIP;
        b->rest[3 * i] = (peri_real)((layer + 0.5) * b->spacing);
        b->rest[3 * i + 1] = (peri_real)((i % n + 0.5) * b->spacing - 0.1);
        b->rest[3 * i + 2] = (peri_real)((i / n % n + 0.5) * b->spacing - 0.1);
        b->held[i] = layer < 0 || layer >= b->along;
    }
    return 0;
}

static int beam_begin(beam *b, const beam_def *def, const studio_options *o) {
    peri_world_def wd = peri_default_world_def();
    peri_body_def bd = peri_default_body_def();
    peri_error err;
    memset(b, 0, sizeof *b);
    b->def = *def;
    if (beam_sample(b)) return -1;
    wd.gravity.z = (peri_real)-def->gravity;
    wd.integrator = def->integrator;
    wd.tolerance = (peri_real)def->tolerance;
    wd.max_iterations = 1000;
    wd.parallel.threads = o->threads;
    if (studio_solver(o->solver, &wd.solver)) return -1;
    b->world = peri_world_create(&wd, &err);
    if (!b->world) return studio_error("%s", err.text);
    bd.points = b->rest;
    bd.count = b->count;
    bd.spacing = (peri_real)b->spacing;
    bd.kernel = def->kernel;
    bd.fixed = b->held;
    bd.material = peri_material_create(b->world, &def->material);
    b->body = peri_body_create(b->world, &bd);
    return b->body.index1 ? 0 : studio_failed(b->world);
}

static void beam_end(beam *b) {
    peri_world_destroy(b->world);
    free(b->rest);
    free(b->x);
    free(b->held);
    memset(b, 0, sizeof *b);
}

static int beam_step(beam *b, double dt) {
    return peri_world_step(b->world, (peri_real)dt) ? studio_failed(b->world) : 0;
}

/* Rest under constant loads: steps of 1000 s have no inertia. */
static int beam_settle(beam *b) {
    int k, bad = 0;
    for (k = 0; k < 6 && !bad; k++) bad = beam_step(b, 1000);
    return bad;
}

/* Mean displacement of a layer along axis k. */
static double layer_moved(const beam *b, int layer, int k) {
    const peri_real *x = peri_body_positions(b->world, b->body);
    int n = b->def.across * b->def.across, i;
    double sum = 0;
    for (i = layer * n; i < (layer + 1) * n; i++) sum += (double)x[3 * i + k] - (double)b->rest[3 * i + k];
    return sum / n;
}

/* Displacement of the end face x = 1, half a spacing beyond the last layer. */
static double tip_moved(const beam *b, int k) {
    int last = GRIP + b->along - 1;
    return 1.5 * layer_moved(b, last, k) - 0.5 * layer_moved(b, last - 1, k);
}

/* ----------------------------------------------------------------------------------------------- falling -------- */

enum { STEPS = 3, WAYS = 2, LONGEST = 1000 };
static const double step_ms[STEPS] = {1, 4, 16};
static const char *const way_name[WAYS] = {"backward Euler", "BDF2"};

typedef struct fall {
    beam b[WAYS][STEPS];
    double tip[WAYS][STEPS][LONGEST]; /* height of the tip, m, every 16 ms */
    int frames;
} fall;

static int fall_begin(fall *f, int across, const studio_options *o) {
    beam_def d = default_beam();
    int way, k, bad = 0;
    memset(f, 0, sizeof *f);
    d.across = across;
    d.gravity = 9.81;
    d.tolerance = 1e-5; /* BDF2 with steps of 1 ms wants more than the 1e-3 of the defaults */
    if (studio_material(o->model, young, 0.25, density, &d.material)) return -1;
    for (way = 0; way < WAYS; way++)
        for (k = 0; k < STEPS && !bad; k++) {
            d.integrator = way ? PERI_BDF2 : PERI_BACKWARD_EULER;
            bad = beam_begin(&f->b[way][k], &d, o);
        }
    return bad;
}

/* 16 ms more for all of them. */
static int fall_frame(fall *f) {
    int way, k, n, bad = 0;
    for (way = 0; way < WAYS; way++)
        for (k = 0; k < STEPS; k++) {
            for (n = 0; n < (int)(16 / step_ms[k]) && !bad; n++) bad = beam_step(&f->b[way][k], 1e-3 * step_ms[k]);
            f->tip[way][k][f->frames] = tip_moved(&f->b[way][k], 2);
        }
    f->frames++;
    return bad;
}

static void fall_end(fall *f) {
    int k;
    for (k = 0; k < WAYS * STEPS; k++) beam_end(&f->b[k / STEPS][k % STEPS]);
}

/* Largest difference of a step size to 1 ms BDF2 over the first `frames`, in parts of the deepest tip. */
static double fall_apart(const fall *f, int way, int k, int frames) {
    double worst = 0, deepest = 0;
    int i;
    for (i = 0; i < frames; i++) {
        worst = fmax(worst, fabs(f->tip[way][k][i] - f->tip[1][0][i]));
        deepest = fmax(deepest, -f->tip[1][0][i]);
    }
    return worst / deepest;
}

static int fall_plot(const fall *f, const studio_options *o) {
    studio_plot plot;
    char name[64];
    int way, k, i, series, bad;
    FILE *csv = studio_csv(o->out, "tip.csv", "integrator,step_ms,time_s,tip_m");
    if (!csv) return -1;
    studio_plot_begin(&plot, "Tip of a beam falling under gravity, three time steps", "time, s",
                      "height of the tip, m");
    for (way = 0; way < WAYS; way++)
        for (k = 0; k < STEPS; k++) {
            snprintf(name, sizeof name, "%s, %.0f ms", way_name[way], step_ms[k]);
            series = studio_plot_series(&plot, name, way ? STUDIO_DASHED : STUDIO_LINE, NULL);
            studio_plot_point(&plot, series, 0, 0);
            for (i = 0; i < f->frames; i++) {
                studio_plot_point(&plot, series, 0.016 * (i + 1), f->tip[way][k][i]);
                fprintf(csv, "%s,%.0f,%.3f,%.6f\n", way_name[way], step_ms[k], 0.016 * (i + 1), f->tip[way][k][i]);
            }
        }
    bad = fclose(csv) || studio_plot_write(&plot, studio_path(o->out, "tip.png"), 960, 600);
    studio_plot_end(&plot);
    return bad;
}

/* Adds the particles of a beam moved by (0, dy, dz), coloured by t = value / range, or in one colour. */
static int draw_beam(studio_scene *s, beam *b, double dy, double dz, int value, double range, const float *flat) {
    const peri_real *x = peri_body_positions(b->world, b->body);
    float p[3], rgb[3];
    int i;
    if (!flat && peri_body_values(b->world, b->body, (peri_value)value, b->x)) return studio_failed(b->world);
    for (i = 0; i < b->count; i++) {
        studio_set(p, (float)x[3 * i], (float)((double)x[3 * i + 1] + dy), (float)((double)x[3 * i + 2] + dz));
        if (flat) memcpy(rgb, flat, sizeof rgb);
        else studio_colormap((float)((double)b->x[i] / range), rgb);
        if (b->held[i]) studio_set(rgb, 0.45f, 0.46f, 0.50f);
        if (studio_scene_ball(s, p, (float)((flat ? 0.56 : 0.72) * b->spacing), rgb)) return -1;
    }
    return 0;
}

/* The three beams of one integrator in one place: the side of each as an outline, the one with 1 ms in full. */
static int draw_fall(fall *f, int way, studio_image *im) {
    static const float colour[STEPS][3] = {{0.10f, 0.30f, 0.62f}, {0.90f, 0.45f, 0.10f}, {0.80f, 0.10f, 0.35f}};
    static const float body[3] = {0.72f, 0.80f, 0.90f}, middle[3] = {0.43f, 0, -0.30f};
    studio_scene scene;
    studio_camera camera;
    char text[80];
    int k, side, layer, bad, n = f->b[way][0].def.across;
    studio_scene_begin(&scene);
    scene.look.ground = 0;
    bad = draw_beam(&scene, &f->b[way][0], 0, 0, 0, 1, body);
    for (k = STEPS - 1; k >= 0; k--) {
        const beam *b = &f->b[way][k];
        const peri_real *x = peri_body_positions(b->world, b->body);
        for (side = 0; side < 2; side++)
            for (layer = GRIP; layer < b->layers; layer++) {
                const peri_real *p = x + 3 * ((layer - 1) * n * n + side * n * (n - 1)), *q = p + 3 * n * n;
                float from[3], to[3];
                studio_set(from, (float)p[0], -0.115f - 0.002f * (float)k, (float)p[2]);
                studio_set(to, (float)q[0], -0.115f - 0.002f * (float)k, (float)q[2]);
                bad |= studio_scene_line(&scene, from, to, 3.2f, colour[k]);
            }
    }
    studio_orbit(&camera, middle, 9.0f, 0, 4, 7.5f);
    bad |= studio_render(&scene, &camera, im);
    studio_scene_end(&scene);
    studio_text(im, 18, 32, 14, ink, way_name[way]);
    for (k = 0; k < STEPS; k++) {
        snprintf(text, sizeof text, "%.0f ms", step_ms[k]);
        studio_line(im, 20, (float)(374 + 24 * k), 50, (float)(374 + 24 * k), 3.5f, colour[k], 1);
        studio_text(im, 58, (float)(379 + 24 * k), 11, ink, text);
    }
    return bad;
}

static int fall_pictures(const studio_options *o) {
    fall *f = (fall *)studio_alloc(1, sizeof *f);
    studio_image all, part;
    const int moment = 18; /* 0.288 s, half way down */
    char text[80];
    int k, way, bad;
    if (!f) return -1;
    bad = studio_image_make(&all, 1000, 520) || studio_image_make(&part, 498, 480) || fall_begin(f, 5, o);
    studio_progress(o, 0, o->frames, NULL);
    for (k = 1; k <= o->frames && k <= LONGEST && !bad; k++) {
        bad = fall_frame(f);
        if (k == (moment < o->frames ? moment : o->frames))
            for (way = 0; way < WAYS; way++) {
                bad |= draw_fall(f, way, &part);
                studio_image_paste(&all, &part, 502 * way, 40);
            }
        studio_progress(o, k, o->frames, "falling");
    }
    snprintf(text, sizeof text, "The same moment (%.2f s) with three time steps", 0.016 * fmin(moment, o->frames));
    studio_text_at(&all, 500, 27, 13, ink, 0.5f, 0, text);
    printf("falling: largest difference of the tip to 1 ms BDF2 in the first 0.5 s / in all %.1f s, %% of the drop\n",
           0.016 * f->frames);
    for (k = 0; k < WAYS * STEPS && !bad; k++)
        printf("  %-15s %4.0f ms  %6.2f  %6.2f\n", way_name[k / STEPS], step_ms[k % STEPS],
               100 * fall_apart(f, k / STEPS, k % STEPS, f->frames < 31 ? f->frames : 31),
               100 * fall_apart(f, k / STEPS, k % STEPS, f->frames));
    bad |= fall_plot(f, o) | studio_png(studio_path(o->out, "falling.png"), &all);
    fall_end(f);
    free(f);
    studio_image_free(&all);
    studio_image_free(&part);
    return bad;
}

static void check_fall(const studio_options *o) {
    fall *f = (fall *)studio_alloc(1, sizeof *f);
    char name[80];
    int k, bad = !f || fall_begin(f, 4, o);
    while (!bad && f->frames < 31) bad = fall_frame(f); /* 0.496 s */
    for (k = 0; k < WAYS * STEPS && f; k++) {
        double limit = k / STEPS ? 0.02 : 0.06;
        if (k == STEPS) continue; /* the reference */
        snprintf(name, sizeof name, "falling, %s, %.0f ms: apart from 1 ms BDF2", way_name[k / STEPS],
                 step_ms[k % STEPS]);
        studio_check(name, bad ? HUGE_VAL : fall_apart(f, k / STEPS, k % STEPS, f->frames), "of the drop", 0, limit);
    }
    if (f) fall_end(f);
    free(f);
}

/* ----------------------------------------------------------------------------------------------- hanging -------- */

/* Linear static finite elements, quadratic bricks with full integration, 8 over the height: tip of the clamped beam at
 * g = 0.05 m/s^2, m. */
static const double hang_nu[3] = {0, 0.25, 0.4}, hang_tip[3] = {-0.01934576, -0.01925266, -0.01891869};

static int hang(const char *model, double nu, int across, const studio_options *o, double *tip) {
    beam_def d = default_beam();
    beam b;
    int bad;
    d.across = across;
    d.gravity = 0.05;
    d.tolerance = 1e-5;
    if (studio_material(model, young, nu, density, &d.material)) return -1;
    bad = beam_begin(&b, &d, o) || beam_settle(&b);
    if (!bad) *tip = tip_moved(&b, 2);
    beam_end(&b);
    return bad;
}

static int table_hanging(const studio_options *o) {
    static const char *const models[] = {"neo_hookean", "linear", "projective"};
    double tip;
    int m, k;
    printf("hanging: tip / finite elements, 8 particles over the height\n  Poisson's ratio ");
    for (k = 0; k < 3; k++) printf("%8.2f", hang_nu[k]);
    printf("\n");
    for (m = 0; m < 3; m++) {
        printf("  %-15s ", models[m]);
        for (k = 0; k < 3; k++) {
            if (m == 2 && k != 1) {
                printf("       -");
                continue;
            }
            if (hang(models[m], hang_nu[k], 8, o, &tip)) return -1;
            printf("%8.3f", tip / hang_tip[k]);
        }
        printf("\n");
    }
    return 0;
}

static void check_hanging(const studio_options *o) {
    char name[80];
    int k;
    for (k = 0; k < 3; k++) {
        double tip = 0;
        int bad = hang("neo_hookean", hang_nu[k], 8, o, &tip);
        snprintf(name, sizeof name, "hanging, tip / finite elements, nu %g", hang_nu[k]);
        studio_check(name, bad ? HUGE_VAL : tip / hang_tip[k], "", 0.95, 1.05);
    }
}

/* ------------------------------------------------------------------------------------------------ pulled -------- */

enum { BASES = 4 };
static const char *const basis_name[BASES] = {"A4", "svk", "B1", "A1"};
static const double pull_stress = 0.8e5; /* Pa of the rest section */

/* Stretch model at Poisson's ratio 1/4 with the same basis function of theta and tau. */
static peri_material basis_material(int basis) {
    peri_real e = (peri_real)young, nu = (peri_real)0.25, rho = (peri_real)density;
    peri_material m = peri_material_linear(e, nu, rho);
    if (basis == 1) return peri_material_stvk(e, nu, rho);
    if (basis == 3) return peri_material_neo_hookean_papers(e, nu, rho);
    if (basis == 2) return m;
    m.g.b[0] = m.h.b[0] = 0;
    m.g.a[3] = m.h.a[3] = 1;
    return m;
}

/* Pulls the far end with pull_stress, spread over the last layer. */
static int pull(beam *b, int basis, int across, const studio_options *o) {
    beam_def d = default_beam();
    int n = across * across, i, k, bad;
    d.across = across;
    d.tolerance = 1e-4;
    d.material = basis_material(basis);
    bad = beam_begin(b, &d, o);
    for (k = 1; k <= 8 && !bad; k++) {
        for (i = 0; i < n; i++) b->x[3 * i] = (peri_real)(k / 8.0 * pull_stress * 0.04 / n);
        if (peri_body_set_forces(b->world, b->body, b->count - n, n, b->x)) return studio_failed(b->world);
        bad = beam_step(b, 1000);
    }
    return bad || beam_settle(b);
}

/* Stretch at which a material point carries pull_stress. */
static double point_stretch(const peri_material *m) {
    double low = 1, high = 4;
    int k, j;
    for (k = 0; k < 40; k++) {
        double a = (low + high) / 2, thin = 0.2, thick = 1.2, f[9] = {0}, p[9];
        for (j = 0; j < 40; j++) {
            double side = (thin + thick) / 2;
            f[0] = a;
            f[4] = f[8] = side;
            peri_material_point(m, f, p);
            if (p[4] < 0) thin = side;
            else thick = side;
        }
        if (p[0] < pull_stress) low = a;
        else high = a;
    }
    return low;
}

/* A scene of `count` beams one above the other with a note at each; the colour bar counts in `unit`. */
static int picture_stack(beam *b, int count, int value, double range, double unit, const char *const *note,
                         const char *title, const char *bar, const char *file, const studio_options *o) {
    const double gap = 0.34;
    studio_scene scene;
    studio_image im;
    studio_camera camera;
    float middle[3] = {0.95f, 0, 0}, p[3], x, y;
    int k, bad;
    if (studio_image_make(&im, 1080, 150 + 115 * count)) return -1;
    studio_scene_begin(&scene);
    scene.look.ground = 0;
    for (k = 0, bad = 0; k < count && !bad; k++) {
        float lo[3] = {0, -0.1f, 0}, hi[3] = {1, 0.1f, 0};
        double z = gap * ((count - 1) / 2.0 - k);
        lo[2] = (float)z - 0.1f;
        hi[2] = (float)z + 0.1f;
        bad = draw_beam(&scene, &b[k], 0, z, value, range, NULL) || studio_scene_box(&scene, lo, hi, 1.5f, ink);
    }
    studio_orbit(&camera, middle, 11.0f, 0, 6, (float)(1.7 * (1.2 + count)));
    bad = bad || studio_render(&scene, &camera, &im);
    for (k = 0; k < count && !bad; k++) {
        studio_set(p, -0.12f, 0, (float)(gap * ((count - 1) / 2.0 - k)) - 0.02f);
        if (studio_where(&scene, p, &x, &y)) studio_text_at(&im, x, y, 11, ink, 1, 0, note[k]);
    }
    studio_text_at(&im, (float)im.width / 2, 30, 14, ink, 0.5f, 0, title);
    studio_colorbar(&im, 985, 110, 16, im.height - 170, 0, range / unit, bar);
    bad = bad || studio_png(studio_path(o->out, file), &im);
    studio_scene_end(&scene);
    studio_image_free(&im);
    return bad;
}

static int run_pulled(const studio_options *o) {
    static beam b[BASES];
    static char note[BASES][32];
    const char *notes[BASES];
    char name[80];
    double length, want;
    int k, bad = 0;
    if (!o->check) printf("pulled: length under %.0f Pa (m), and that of a material point\n", pull_stress);
    for (k = 0; k < BASES && !bad; k++) {
        peri_material m = basis_material(k);
        bad = pull(&b[k], k, o->check ? 5 : 6, o);
        length = bad ? HUGE_VAL : 1 + tip_moved(&b[k], 0);
        want = point_stretch(&m);
        snprintf(note[k], sizeof note[k], "%s  %.2f m", basis_name[k], length);
        notes[k] = note[k];
        snprintf(name, sizeof name, "pulled, %s: extension / material point", basis_name[k]);
        if (o->check) studio_check(name, (length - 1) / (want - 1), "", 0.8, 1.05);
        else printf("  %-4s %.4f  %.4f\n", basis_name[k], length, want);
    }
    if (!o->check && !bad)
        bad = picture_stack(b, BASES, PERI_VALUE_STRETCH, 0.9, 1, notes,
                            "One force, four basis functions (frame: rest shape)", "stretch - 1", "basis.png", o);
    for (k = 0; k < BASES; k++) beam_end(&b[k]);
    return bad;
}

/* ----------------------------------------------------------------------------------------------- thinner -------- */

enum { KERNELS = 6, RATIOS = 3 };
static const char *const kernel_name[KERNELS] = {"power", "constant", "linear", "cubic", "inverse", "shifted"};
static const double ratio[RATIOS] = {0, 0.25, 0.45};

/* Both grips drawn apart by `strain`, in steps. */
static int stretch(beam *b, const beam_def *d, double strain, const studio_options *o) {
    int i, k, pieces = 1 + (int)(strain / 0.05), bad = beam_begin(b, d, o);
    for (k = 1; k <= pieces && !bad; k++) {
        const peri_real *x = peri_body_positions(b->world, b->body);
        memcpy(b->x, x, 3 * (size_t)b->count * sizeof *x);
        for (i = 0; i < b->count; i++) {
            double at = (double)b->rest[3 * i];
            b->x[3 * i] = (peri_real)((double)x[3 * i] + strain / pieces * fmin(fmax(at, 0), 1));
        }
        if (peri_body_set_positions(b->world, b->body, 0, b->count, b->x)) return studio_failed(b->world);
        bad = beam_step(b, 1000);
    }
    return bad || beam_settle(b);
}

/* (lateral contraction) / (stretch - 1) by least squares over the middle of the beam. */
static double contraction(const beam *b) {
    const peri_real *x = peri_body_positions(b->world, b->body);
    double xx = 0, ux = 0, ss = 0, us = 0;
    int i, k;
    for (i = 0; i < b->count; i++) {
        const peri_real *p = b->rest + 3 * i, *q = x + 3 * i;
        double at = (double)p[0] - 0.5, centre = 0.5 * (double)(x[3 * (b->count - 1)] + x[0]);
        if (fabs(at) > 0.2) continue;
        xx += at * at;
        ux += at * ((double)q[0] - centre - at);
        for (k = 1; k < 3; k++) {
            ss += (double)p[k] * (double)p[k];
            us += (double)p[k] * ((double)q[k] - (double)p[k]);
        }
    }
    return -(us / ss) / (ux / xx);
}

static int measure_contraction(const char *model, double nu, int kernel, const studio_options *o, double *out) {
    beam_def d = default_beam();
    beam b;
    int bad;
    d.both = 1;
    d.kernel = (peri_kernel)kernel;
    d.tolerance = 1e-5;
    if (studio_material(model, young, nu, density, &d.material)) return -1;
    bad = stretch(&b, &d, 0.01, o);
    if (!bad) *out = contraction(&b);
    beam_end(&b);
    return bad;
}

static int table_thinner(const studio_options *o) {
    static const char *const models[] = {"neo_hookean", "linear"};
    double got;
    int m, kernel, k;
    printf("thinner: measured Poisson's ratio, asked for 0, 0.25, 0.45\n");
    for (kernel = 0; kernel < KERNELS; kernel++)
        for (m = 0; m < 2; m++) {
            printf("  %-9s %-12s", kernel_name[kernel], models[m]);
            for (k = 0; k < RATIOS; k++) {
                if (measure_contraction(models[m], ratio[k], kernel, o, &got)) return -1;
                printf("%8.3f", got);
            }
            printf("\n");
        }
    return 0;
}

static void check_thinner(const studio_options *o) {
    char name[80];
    int kernel, k;
    for (kernel = 0; kernel < KERNELS; kernel += 3)
        for (k = 0; k < RATIOS; k++) {
            double got = 0;
            int bad = measure_contraction("neo_hookean", ratio[k], kernel, o, &got);
            snprintf(name, sizeof name, "Poisson's ratio, neo_hookean, %s kernel, asked %g", kernel_name[kernel],
                     ratio[k]);
            studio_check(name, bad ? HUGE_VAL : got, "", ratio[k] - 0.02, ratio[k] + 0.02);
        }
}

static int picture_thinner(const studio_options *o) {
    static beam b[RATIOS];
    static const char *const note[RATIOS] = {"nu = 0", "nu = 0.25", "nu = 0.45"};
    beam_def d = default_beam();
    int k, bad = 0;
    d.both = 1;
    for (k = 0; k < RATIOS && !bad; k++) {
        bad = studio_material("neo_hookean", young, ratio[k], density, &d.material) || stretch(&b[k], &d, 0.6, o);
    }
    bad = bad || picture_stack(b, RATIOS, PERI_VALUE_STRESS, 8e4, 1000, note,
                               "Stretched to 1.6 with three Poisson's ratios", "Mises, kPa", "poisson.png", o);
    for (k = 0; k < RATIOS; k++) beam_end(&b[k]);
    return bad;
}

/* --------------------------------------------------------------------------------------------------- main -------- */

int main(int argc, char **argv) {
    studio_options o;
    int bad = 0;
    if (studio_begin(&app, argc, argv, &o)) return studio_exit_code();
    if (o.check) {
        check_fall(&o);
        check_hanging(&o);
        run_pulled(&o);
        check_thinner(&o);
        return studio_end(&o);
    }
    bad = fall_pictures(&o) | table_hanging(&o) | run_pulled(&o) | table_thinner(&o) | picture_thinner(&o);
    return studio_end(&o) || bad;
}
