/* twist.c - a bar is gripped at both ends; one end is turned a full turn and back.
 *
 * Answers SH figure 10 (the left end of a bar turned by 360 degrees, the right one held); SH = Xu et al. 2018,
 * "Reformulating Hyperelastic Materials with Peridynamic Modeling".  Shows script-driven particles
 * (peri_body_set_fixed, peri_body_move) and reaction forces (peri_body_forces).  To the picture it adds numbers:
 * torque over angle there and back, its slope against the exact torsion of a square bar, and the way home.
 *
 *     cc -O2 examples/twist.c -lm -o twist && ./twist
 *
 * Writes to --out: twist.png (six moments), twist.gif, twist_torque.png, twist.csv.
 * Contents: options, the bar, driving, pictures, checks, main.
 */
#include "studio.h"

#define PERI_IMPLEMENTATION
#include "../peri.h"
#include "studio_peri.h"

static const float dt = 1.0f / 60, side = 0.2f, length = 1.0f; /* s, m, m: the length between the grips */
enum { MOMENTS = 6, SETTLE = 90 }; /* steps after coming back */

static const studio_app app = {
    "twist", "a bar whose left end is turned by 360 degrees and back",
    "  --across N     particles over the side of the bar (8)\n"
    "  --turn DEG     largest angle (360)\n"
    "  --young PA     Young's modulus (1000000)\n"
    "  --poisson X    Poisson's ratio (0.3)\n"
    "  --density X    kg/m^3 (1000)\n"
    "--model: neo_hookean linear stvk stvk_exact stable papers projective\n"
    "--solver: auto cholesky jacobi chebyshev position\n"
    "--frames: steps there and back\n", 360};

typedef struct twist {
    studio_options options;
    int across, along, count;   /* particles over a side, along the bar, in all */
    float spacing, young, poisson, turn; /* turn in degrees */
    float *point, *force, *value;
    peri_material material;
    peri_world *world;
    peri_body_id body;
    int steps, iterations, unconverged, unhealthy_at_turn;
    double seconds;
    double angle, torque;       /* now: degrees, N m */
    double moment, turned;      /* sums of torque * angle and angle^2 while the angle is small */
    double home;                /* rms distance to the start at the end, spacings */
    double fastest;             /* speed of any particle, m/s */
    studio_image sheet;
    studio_plot plot;
    FILE *csv;
    studio_gif *gif;
} twist;

/* ---- options ---- */

static int choose_material(twist *s) {
    const char *name = s->options.model;
    s->young = (float)studio_number("--young", 1e6);
    s->poisson = name && !strcmp(name, "projective") ? 0.25f : (float)studio_number("--poisson", 0.3);
    return studio_material(name, (double)s->young, (double)s->poisson, studio_number("--density", 1000), &s->material);
}

/* ---- the bar ---- */

/* A lattice along x, centred on the x axis.  The grips are the first and the last two layers; the middle of the
 * innermost gripped layers are `length` apart. */
static int make_points(twist *s) {
    int i, j, k, n = 0, middle;
    s->across = (int)studio_number("--across", s->options.check ? 6 : 8);
    if (s->across < 3 || s->across > 64) return studio_error("--across wants 3 to 64, not %d", s->across);
    s->spacing = side / (float)s->across;
    s->along = (int)(length / s->spacing + 0.5f) + 3;
    s->count = s->along * s->across * s->across;
    s->point = (float *)studio_alloc(3 * (size_t)s->count, sizeof(float));
    s->force = (float *)studio_alloc(3 * (size_t)s->count, sizeof(float));
    s->value = (float *)studio_alloc((size_t)s->count, sizeof(float));
    if (!s->point || !s->force || !s->value) return -1;
    middle = s->across - 1;
    for (i = 0; i < s->along; i++)
        for (j = 0; j < s->across; j++)
            for (k = 0; k < s->across; k++, n++)
                studio_set(s->point + 3 * n, s->spacing * ((float)i - 0.5f * (float)(s->along - 1)),
                           s->spacing * 0.5f * (float)(2 * j - middle), s->spacing * 0.5f * (float)(2 * k - middle));
    return 0;
}

/* Particles of the left grip come first, those of the right grip last. */
static int gripped(const twist *s) { return 2 * s->across * s->across; }

static int create(twist *s) {
    peri_world_def def = peri_default_world_def();
    peri_body_def body = peri_default_body_def();
    peri_error err;
    int i;
    if (studio_solver(s->options.solver, &def.solver)) return -1;
    def.gravity.z = 0;
    def.parallel.threads = s->options.threads;
    s->world = peri_world_create(&def, &err);
    if (!s->world) return studio_error("%s", err.text);
    body.material = peri_material_create(s->world, &s->material);
    if (!body.material.index1) return studio_failed(s->world);
    body.points = s->point;
    body.count = s->count;
    body.spacing = s->spacing;
    s->body = peri_body_create(s->world, &body);
    if (!s->body.index1) return studio_failed(s->world);
    for (i = 0; i < gripped(s); i++)
        if (peri_body_set_fixed(s->world, s->body, i, 1) ||
            peri_body_set_fixed(s->world, s->body, s->count - 1 - i, 1))
            return studio_failed(s->world);
    return 0;
}

/* ---- driving ---- */

/* The angle at a share of the way there and back: 0 at both ends, the full turn in the middle, without jerks. */
static double angle_at(const twist *s, double share) {
    double there = share < 0.5 ? 2 * share : 2 - 2 * share;
    return (double)s->turn * there * there * (3 - 2 * there);
}

/* Sends the left grip to `angle` degrees about the x axis. */
static int drive(twist *s, double angle) {
    const float a = (float)(angle * STUDIO_PI / 180), c = cosf(a), q = sinf(a);
    int i;
    for (i = 0; i < gripped(s); i++) {
        const float *p = s->point + 3 * i;
        peri_vec3 x;
        x.x = p[0];
        x.y = c * p[1] - q * p[2];
        x.z = q * p[1] + c * p[2];
        if (peri_body_move(s->world, s->body, i, x)) return studio_failed(s->world);
    }
    return 0;
}

/* The torque that turns the left grip: minus the moment of the internal forces on it. */
static int measure(twist *s) {
    const float *x = peri_body_positions(s->world, s->body);
    int i;
    if (peri_body_forces(s->world, s->body, s->force)) return studio_failed(s->world);
    s->torque = 0;
    for (i = 0; i < gripped(s); i++) {
        const float *p = x + 3 * i, *f = s->force + 3 * i;
        s->torque -= (double)p[1] * (double)f[2] - (double)p[2] * (double)f[1];
    }
    return 0;
}

static int step(twist *s, double angle) {
    const float *v;
    double start = studio_seconds();
    peri_stats stats;
    int i;
    s->angle = angle;
    if (drive(s, angle)) return -1;
    if (peri_world_step(s->world, dt)) return studio_failed(s->world);
    s->seconds += studio_seconds() - start;
    stats = peri_world_stats(s->world);
    s->steps++;
    s->iterations += stats.iterations;
    s->unconverged += !stats.converged;
    if (angle > 0.999 * (double)s->turn) s->unhealthy_at_turn = stats.unhealthy;
    v = peri_body_velocities(s->world, s->body);
    for (i = 0; i < s->count; i++) s->fastest = fmax(s->fastest, sqrt((double)studio_dot(v + 3 * i, v + 3 * i)));
    if (measure(s)) return -1;
    if (angle > 3 && angle < 15) { /* small: slope through the origin by least squares, there and back */
        s->moment += s->torque * angle;
        s->turned += angle * angle;
    }
    return 0;
}

/* Root mean square distance of the particles from where they started. */
static double away(const twist *s) {
    const float *x = peri_body_positions(s->world, s->body);
    double sum = 0;
    int i;
    for (i = 0; i < 3 * s->count; i++) sum += pow((double)(x[i] - s->point[i]), 2);
    return sqrt(sum / s->count) / (double)s->spacing;
}

/* ---- pictures ---- */

static const float ink[3] = {0.2f, 0.22f, 0.26f};

/* Stress at the upper end of the colours: a thin rod's shear at the middle of a side would reach about this. */
static float full_scale(const twist *s) { return 0.75f * s->young; }

/* One edge of the bar is red, to show how far it has turned. */
static int marked(const twist *s, int i) {
    int place = i % (s->across * s->across);
    return place == s->across - 1;
}

static int draw(const twist *s, studio_image *im) {
    static const float steel[3] = {0.55f, 0.57f, 0.61f}, red[3] = {0.85f, 0.25f, 0.2f}, target[3] = {0, 0, 0};
    const float *x = peri_body_positions(s->world, s->body);
    studio_camera camera;
    studio_scene scene;
    int i, bad = 0;
    studio_scene_begin(&scene);
    scene.look.height = -0.75f * side;
    studio_set(scene.look.centre, 0, 0, 0);
    scene.look.radius = 0.75f * length;
    scene.look.cell = side;
    for (i = 0; i < s->count && !bad; i++) {
        float rgb[3];
        int grip = i < gripped(s) || i >= s->count - gripped(s);
        studio_colormap(s->value[i] / full_scale(s), rgb);
        bad = studio_scene_ball(&scene, x + 3 * i, 0.58f * s->spacing, marked(s, i) ? red : grip ? steel : rgb);
    }
    studio_orbit(&camera, target, 3.0f * length, -22, 24, 16);
    bad = bad || studio_render(&scene, &camera, im);
    studio_scene_end(&scene);
    return bad;
}

static void add_bar(const twist *s, studio_image *im) {
    studio_colorbar(im, im->width - 76, 44, 13, im->height / 3, 0, (double)full_scale(s) / 1000, "stress, kPa");
}

/* Puts the present state on the sheet of six. */
static int draw_moment(twist *s, int k) {
    enum { W = 640, H = 380, COLUMNS = 2 };
    studio_image panel = {0, 0, NULL};
    char text[64];
    int bad = studio_image_make(&panel, W, H) ||
              (!s->sheet.rgb && studio_image_make(&s->sheet, COLUMNS * W, MOMENTS / COLUMNS * H));
    if (!bad) bad = draw(s, &panel);
    if (!bad) {
        if (k == MOMENTS - 1) snprintf(text, sizeof text, "back: %.1e spacings from the start", away(s));
        else snprintf(text, sizeof text, "%.0f degrees, %.1f N m", s->angle, s->torque);
        studio_text(&panel, 20, 36, 15, ink, text);
        if (k == 1) add_bar(s, &panel);
        studio_image_paste(&s->sheet, &panel, k % COLUMNS * W, k / COLUMNS * H);
    }
    studio_image_free(&panel);
    return bad;
}

/* Table, plot and animation after a step. */
static int show(twist *s, int back, studio_image *im) {
    char text[32];
    fprintf(s->csv, "%.5f,%.4f,%.6g,%d\n", s->steps * (double)dt, s->angle, s->torque,
            peri_world_stats(s->world).iterations);
    if (s->angle > 0) studio_plot_point(&s->plot, back, s->angle, s->torque);
    if (s->steps % 6 || s->steps > s->options.frames) return 0;
    if (peri_body_values(s->world, s->body, PERI_VALUE_STRESS, s->value)) return studio_failed(s->world);
    if (draw(s, im)) return -1;
    snprintf(text, sizeof text, "%.0f degrees", s->angle);
    studio_text(im, 18, 32, 13, ink, text);
    add_bar(s, im);
    return studio_gif_frame(s->gif, im);
}

/* ---- checks ---- */

/* Exact at small angle: torque = mu J angle / length with J = 0.140577 side^4 (Saint-Venant, square). */
static double exact_slope(const twist *s) {
    double mu = (double)s->young / (2 + 2 * (double)s->poisson), a = (double)side;
    return mu * 0.140577 * a * a * a * a / (double)((float)(s->along - 3) * s->spacing) * STUDIO_PI / 180;
}

static void check(const twist *s) {
    peri_measure m;
    memset(&m, 0, sizeof m);
    if (peri_body_measure(s->world, s->body, &m)) m.momentum[0] = HUGE_VAL, studio_failed(s->world);
    printf("%d particles across, %d in all\n", s->across, s->count);
    studio_check("torque at small angle over the exact one", s->moment / s->turned / exact_slope(s), "", 0.85, 1.15);
    studio_check("particles out of shape at the full turn", s->unhealthy_at_turn, "", 0, 0);
    studio_check("rms distance to the start after coming back", s->home, "spacings", 0, 1e-3);
    studio_check("kinetic energy at the end", m.kinetic, "J", 0, 1e-6);
    studio_check("momentum at the end", sqrt(pow(m.momentum[0], 2) + pow(m.momentum[1], 2) + pow(m.momentum[2], 2)),
                 "N s", 0, 1e-3);
    studio_check("fastest particle of the run", s->fastest, "m/s", 0, 10);
    studio_check("steps not converged", s->unconverged, "", 0, 0);
}

/* ---- main ---- */

/* The number of the picture on twist.png to be taken after step k, or -1: the steps nearest to the quarters of the
 * turn on the way there, and the last one. */
static int moment_of(const twist *s, int k, int total) {
    int m;
    if (s->options.check) return -1;
    if (k == total + SETTLE) return MOMENTS - 1;
    for (m = 0; m < MOMENTS - 1 && 2 * k <= total; m++) {
        double at = (double)s->turn * m / (MOMENTS - 2), off = fabs(angle_at(s, (double)k / total) - at);
        double after = fabs(angle_at(s, (k + 1.0) / total) - at), before = fabs(angle_at(s, (k - 1.0) / total) - at);
        if (off <= after && (k == 1 || off < before)) return m;
    }
    return -1;
}

static int run(twist *s, studio_image *im) {
    const studio_options *o = &s->options;
    int k, m, bad = 0, end = o->frames + SETTLE;
    char note[64];
    for (k = 1; k <= end && !bad; k++) {
        snprintf(note, sizeof note, "%.0f degrees", s->angle);
        studio_progress(o, k - 1, end, note);
        bad = step(s, k < o->frames ? angle_at(s, (double)k / o->frames) : 0);
        if (bad || o->check) continue;
        bad = show(s, 2 * k > o->frames, im);
        m = moment_of(s, k, o->frames);
        if (bad || m < 0) continue;
        bad = peri_body_values(s->world, s->body, PERI_VALUE_STRESS, s->value) ? studio_failed(s->world)
                                                                               : draw_moment(s, m);
    }
    studio_progress(o, end, end, NULL);
    s->home = away(s);
    return bad;
}

static int open_outputs(twist *s, studio_image *im) {
    const studio_options *o = &s->options;
    char path[STUDIO_PATH];
    studio_plot_begin(&s->plot, "Torque of the twisted bar", "angle, degrees", "torque, N m");
    s->plot.legend_left = 1;
    studio_plot_series(&s->plot, "there", STUDIO_LINE, NULL);
    studio_plot_series(&s->plot, "back", STUDIO_DASHED, NULL);
    studio_plot_series(&s->plot, "exact at small angle", STUDIO_DASHED, ink);
    studio_plot_point(&s->plot, 2, 0, 0);
    studio_plot_point(&s->plot, 2, (double)s->turn, exact_slope(s) * (double)s->turn);
    if (o->check) return 0;
    snprintf(path, sizeof path, "%s/twist.gif", o->out);
    s->gif = studio_gif_begin(path, o->width, o->height, 8);
    s->csv = studio_csv(o->out, "twist.csv", "time,angle,torque,iterations");
    return !s->gif || !s->csv || studio_image_make(im, o->width, o->height);
}

static int close_outputs(twist *s, int bad) {
    char path[STUDIO_PATH];
    if (s->csv) fclose(s->csv);
    bad |= s->gif && studio_gif_end(s->gif);
    snprintf(path, sizeof path, "%s/twist.png", s->options.out);
    if (!bad && !s->options.check) bad = studio_png(path, &s->sheet);
    snprintf(path, sizeof path, "%s/twist_torque.png", s->options.out);
    if (!bad && !s->options.check) bad = studio_plot_write(&s->plot, path, 720, 460);
    studio_plot_end(&s->plot);
    studio_image_free(&s->sheet);
    return bad;
}

int main(int argc, char **argv) {
    static twist s;
    studio_image im = {0, 0, NULL};
    int bad;
    if (studio_begin(&app, argc, argv, &s.options)) return studio_exit_code();
    s.turn = (float)studio_number("--turn", 360);
    bad = choose_material(&s) || make_points(&s) || create(&s) || open_outputs(&s, &im);
    bad = bad || run(&s, &im);
    bad = close_outputs(&s, bad);
    if (!bad) check(&s);
    if (!bad && !s.options.check)
        printf("%d particles; a step of 1/60 s took %.1f ms and %.1f iterations on average\n", s.count,
               1000 * s.seconds / s.steps, (double)s.iterations / s.steps);
    studio_image_free(&im);
    free(s.point);
    free(s.force);
    free(s.value);
    peri_world_destroy(s.world);
    return bad ? 1 : studio_end(&s.options);
}
