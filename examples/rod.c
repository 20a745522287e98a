/* rod.c - a rubber cord is wound up between two clamps until it coils upon itself.
 *
 * Answers PP figure 6 (a rod twists only with ghost particles around its line); PP = He et al. 2017, "Projective
 * Peridynamics for Modeling Versatile Elastoplastic Materials".  Shows rods (peri_sample_line, PERI_FORM_ROD),
 * sections turned by a script (peri_rod_turn), their moments (peri_rod_moment) and a body that touches itself. 
 * First the clamps stay apart: the cord stays straight below Greenhill's angle and its torque is that of a round
 * shaft.  Then it is wound on while the clamps come together: it leaves the line, loops, and winds around itself. 
 * The linking number is the proof that no strand passed another: twist + writhe = turns of the clamp
 * (Calugareanu, White, Fuller).
 *
 *     cc -O2 examples/rod.c -lm -o rod && ./rod
 *
 * Writes to --out: rod.png (six moments), rod.gif, rod_torque.png, rod.csv.
 * Contents: options, the cord, driving, twist and writhe, pictures, checks, main.
 */
#include "studio.h"

#define PERI_IMPLEMENTATION
#include "../peri.h"
#include "studio_peri.h"

static const float dt = 1.0f / 60, length = 1, poisson = 0.3f; /* s, m */
enum { MOMENTS = 6 };

static const studio_app app = {
    "rod", "a cord between two clamps is wound up until it coils",
    "  --points N     points along the cord (121)\n"
    "  --turn DEG     angle of the clamp at the end (2520)\n"
    "  --close X      share of its length by which the clamps come together (0.45)\n"
    "  --young PA     Young's modulus (1000000)\n"
    "  --density X    kg/m^3 (1000)\n"
    "--solver: auto cholesky jacobi chebyshev position\n"
    "--frames: steps\n", 720};

typedef struct rod {
    studio_options options;
    int count;
    float step, diameter, young;    /* m, m, Pa */
    float *points, *mark, *gradient;
    peri_world *world;
    peri_body_id body;
    studio_worst worst;
    double angle, torque;           /* now: degrees, N m */
    double moment, turned;          /* sums of torque angle and angle^2 while it is straight */
    double straight, bent;          /* largest distance from the axis below Greenhill's angle, and at all, diameters */
    double nearest;                 /* least distance of points that are more than three diameters apart on the line */
    double twist, writhe, slip;     /* turns; largest of |twist + writhe - turns| of the run */
    studio_image sheet;
    studio_plot plot;
    FILE *csv;
    studio_gif *gif;
} rod;

/* ---- the cord ---- */

/* Along x, bent by a thousandth of its length, so that it has a side to buckle to. */
static int make_points(rod *s) {
    enum { VERTICES = 65 };
    float line[3 * VERTICES];
    peri_error err;
    int i, wanted = (int)studio_number("--points", s->options.check ? 81 : 121);
    if (wanted < 11 || wanted > 1000) return studio_error("--points wants 11 to 1000, not %d", wanted);
    for (i = 0; i < VERTICES; i++) {
        float t = (float)i / (VERTICES - 1), c = cosf(2 * (float)STUDIO_PI * t);
        studio_set(line + 3 * i, length * (t - 0.5f), 0, 0.5e-3f * length * (1 - c));
    }
    s->points = (float *)studio_alloc(3 * (size_t)(wanted + 2), sizeof(float));
    s->mark = (float *)studio_alloc(3 * (size_t)(wanted + 2), sizeof(float));
    s->gradient = (float *)studio_alloc(9 * (size_t)(wanted + 2), sizeof(float));
    if (!s->points || !s->mark || !s->gradient) return -1;
    if (peri_sample_line(line, VERTICES, 0, length / (float)(wanted - 1), s->points, wanted + 2, &s->count, &s->step,
                         &err))
        return studio_error("%s", err.text);
    s->diameter = 0.99f * s->step;
    return 0;
}

static int create(rod *s) {
    peri_world_def def = peri_default_world_def();
    peri_body_def body;
    peri_material m;
    peri_error err;
    if (studio_solver(s->options.solver, &def.solver) || make_points(s)) return -1;
    s->young = (float)studio_number("--young", 1e6);
    def.gravity.z = 0;
    def.tolerance = 1e-4f; /* at 1e-3 the torque of a step is off by a few mN m */
    def.max_iterations = 1000;
    def.parallel.threads = s->options.threads;
    s->world = peri_world_create(&def, &err);
    if (!s->world) return studio_error("%s", err.text);
    m = peri_material_linear(s->young, poisson, (float)studio_number("--density", 1000));
    body = peri_default_rod_def(s->diameter);
    body.material = peri_material_create(s->world, &m);
    if (!body.material.index1) return studio_failed(s->world);
    body.points = s->points;
    body.count = s->count;
    body.spacing = s->step;
    body.self_contact = 1;
    body.friction = 0.1f;
    s->body = peri_body_create(s->world, &body);
    if (!s->body.index1) return studio_failed(s->world);
    if (peri_body_set_fixed(s->world, s->body, 0, 1) || peri_body_set_fixed(s->world, s->body, s->count - 1, 1))
        return studio_failed(s->world);
    return 0;
}

/* ---- driving ---- */

/* Greenhill's angle: a shaft between clamps buckles at M = 8.98682 E I / L, so at that times 1 + nu, radians. */
static double greenhill(void) { return 8.98682 * (1 + (double)poisson) * 180 / STUDIO_PI; }

/* Torque per degree of a round shaft, N m. */
static double exact_slope(const rod *s) {
    double d = (double)s->diameter, inertia = STUDIO_PI / 64 * d * d * d * d;
    return (double)s->young / (1 + (double)poisson) * inertia / (double)length * STUDIO_PI / 180;
}

/* Angle and closing at a share of the way: up to 0.8 of Greenhill's angle with the clamps apart, then on while
 * they close, then a rest. */
static double angle_at(double share) {
    double straight = 0.8 * greenhill(), turn = studio_number("--turn", 2520);
    if (share < 0.3) return straight * share / 0.3;
    return share < 0.9 ? straight + (turn - straight) * (share - 0.3) / 0.6 : turn;
}

static double closed_at(double share) {
    double close = studio_number("--close", 0.45), t = (share - 0.3) / 0.6;
    t = t < 0 ? 0 : t > 1 ? 1 : t;
    return close * t * t * (3 - 2 * t);
}

static int drive(rod *s, double share) {
    peri_vec3 end;
    s->angle = angle_at(share);
    end.x = s->points[3 * (s->count - 1)] - (float)closed_at(share) * length;
    end.y = s->points[3 * (s->count - 1) + 1];
    end.z = s->points[3 * (s->count - 1) + 2];
    if (peri_body_move(s->world, s->body, s->count - 1, end)) return studio_failed(s->world);
    if (peri_rod_turn(s->world, s->body, 0, studio_turn(1, 0, 0, (float)s->angle))) return studio_failed(s->world);
    return 0;
}

/* ---- twist and writhe ---- */

/* Where the sections point: the deformation gradient of every point takes y along. */
static int find_marks(rod *s) {
    int i;
    if (peri_body_gradient(s->world, s->body, s->gradient)) return studio_failed(s->world);
    for (i = 0; i < s->count; i++) {
        const float *f = s->gradient + 9 * i;
        studio_set(s->mark + 3 * i, f[1], f[4], f[7]);
        studio_unit(s->mark + 3 * i);
    }
    return 0;
}

/* Takes away what of v is along the unit vector a. */
static void across(const float *a, float *v) {
    studio_along(v, -studio_dot(a, v), a, v);
    studio_unit(v);
}

/* Turns of the marks about the line: each piece of the line carries the mean of its ends' marks to the next one
 * without twist; beyond the clamps the line goes on along x. */
static double twist_of(const rod *s) {
    const float *x = peri_body_positions(s->world, s->body);
    float last[3] = {1, 0, 0}, mark[3], carried[3], side[3], along[3], next[3];
    double sum = 0;
    int i;
    memcpy(mark, s->mark, sizeof mark);
    across(last, mark);
    for (i = 0; i < s->count; i++) {
        if (i < s->count - 1) {
            studio_along(x + 3 * (i + 1), -1, x + 3 * i, along);
            studio_unit(along);
            studio_along(s->mark + 3 * i, 1, s->mark + 3 * (i + 1), next);
        } else {
            studio_set(along, 1, 0, 0);
            memcpy(next, s->mark + 3 * i, sizeof next);
        }
        across(along, next);
        memcpy(carried, mark, sizeof carried);
        studio_carry(last, along, carried);
        studio_cross(along, carried, side);
        sum += atan2((double)studio_dot(next, side), (double)studio_dot(next, carried));
        memcpy(last, along, sizeof last);
        memcpy(mark, next, sizeof mark);
    }
    return sum / (2 * STUDIO_PI);
}

static void line_point(const rod *s, int i, double *p) {
    const float *x = peri_body_positions(s->world, s->body);
    int k, at = i < 1 ? 0 : i > s->count ? s->count - 1 : i - 1;
    for (k = 0; k < 3; k++) p[k] = (double)x[3 * at + k];
    if (i < 1) p[0] -= 100; /* the line goes on */
    if (i > s->count) p[0] += 100;
}

static void cross(const double *a, const double *b, double *o) {
    double x = a[1] * b[2] - a[2] * b[1], y = a[2] * b[0] - a[0] * b[2], z = a[0] * b[1] - a[1] * b[0];
    o[0] = x;
    o[1] = y;
    o[2] = z;
}

static double dot(const double *a, const double *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

/* Solid angle of the directions in which piece i of the line is seen crossing piece j, with its sign, over 4 pi. */
static double crossing(const rod *s, int i, int j) {
    double p[4][3], r[4][3], n[4][3], along[2][3], sum = 0, sign;
    static const int pair[4][2] = {{0, 2}, {0, 3}, {1, 3}, {1, 2}};
    int k, c;
    line_point(s, i, p[0]);
    line_point(s, i + 1, p[1]);
    line_point(s, j, p[2]);
    line_point(s, j + 1, p[3]);
    for (k = 0; k < 4; k++)
        for (c = 0; c < 3; c++) r[k][c] = p[pair[k][1]][c] - p[pair[k][0]][c];
    for (c = 0; c < 3; c++) {
        along[0][c] = p[1][c] - p[0][c];
        along[1][c] = p[3][c] - p[2][c];
    }
    for (k = 0; k < 4; k++) {
        double l;
        cross(r[k], r[(k + 1) % 4], n[k]);
        l = sqrt(dot(n[k], n[k]));
        if (!(l > 1e-14)) return 0; /* in one plane */
        for (c = 0; c < 3; c++) n[k][c] /= l;
    }
    for (k = 0; k < 4; k++) sum += asin(fmax(-1, fmin(1, dot(n[k], n[(k + 1) % 4]))));
    cross(along[1], along[0], n[0]);
    sign = dot(n[0], r[0]);
    return (sign > 0 ? sum : sign < 0 ? -sum : 0) / (4 * STUDIO_PI);
}

static double writhe_of(const rod *s) {
    double sum = 0;
    int i, j;
    for (i = 0; i <= s->count; i++)
        for (j = i + 2; j <= s->count; j++) sum += 2 * crossing(s, i, j);
    return sum;
}

static int observe(rod *s) {
    const float *x = peri_body_positions(s->world, s->body);
    peri_vec3 m;
    int i, j;
    if (peri_rod_moment(s->world, s->body, 0, &m)) return studio_failed(s->world);
    s->torque = -(double)m.x;
    if (s->angle > 0 && s->angle < 0.5 * greenhill()) {
        s->moment += s->torque * s->angle;
        s->turned += s->angle * s->angle;
    }
    for (i = 0; i < s->count; i++) {
        double away = sqrt((double)(x[3 * i + 1] * x[3 * i + 1] + x[3 * i + 2] * x[3 * i + 2])) / (double)s->diameter;
        s->bent = fmax(s->bent, away);
        if (s->angle < 0.8 * greenhill()) s->straight = fmax(s->straight, away);
        for (j = i + 4; j < s->count; j++) {
            float d[3];
            studio_along(x + 3 * j, -1, x + 3 * i, d);
            s->nearest = fmin(s->nearest, sqrt((double)studio_dot(d, d)) / (double)s->diameter);
        }
    }
    if (find_marks(s)) return -1;
    s->twist = twist_of(s);
    s->writhe = writhe_of(s);
    return 0;
}

/* ---- pictures ---- */

static int draw(rod *s, studio_image *im) {
    static const float cord[3] = {0.25f, 0.42f, 0.66f}, stripe[3] = {0.95f, 0.78f, 0.35f};
    static const float steel[3] = {0.5f, 0.5f, 0.53f};
    enum { FINE = 6 };
    const float *x = peri_body_positions(s->world, s->body);
    const int n = studio_grid_side(s->count, FINE);
    const float target[3] = {-0.08f, 0, -0.02f};
    float *fine = (float *)studio_alloc(6 * (size_t)n * (FINE + 1), sizeof(float));
    float *mark = fine ? fine + 3 * (size_t)n * (FINE + 1) : NULL;
    studio_camera camera;
    studio_scene scene;
    int k, bad = !fine || studio_grid_values(x, 3, s->count, 1, FINE, fine) ||
                 studio_grid_values(s->mark, 3, s->count, 1, FINE, mark);
    studio_scene_begin(&scene);
    scene.look.height = -0.28f;
    studio_set(scene.look.centre, 0, 0, 0);
    scene.look.radius = 0.8f;
    scene.look.cell = 0.2f;
    bad = bad || studio_scene_tube(&scene, fine, n, 0.5f * s->diameter, mark, cord, stripe);
    for (k = 0; k < 2 && !bad; k++) {
        const float *end = x + 3 * (k ? s->count - 1 : 0);
        float lo[3], hi[3], out = k ? 0.06f : -0.06f;
        studio_set(lo, fminf(end[0], end[0] + out), -0.03f, -0.03f);
        studio_set(hi, fmaxf(end[0], end[0] + out), 0.03f, 0.03f);
        bad = studio_scene_block(&scene, lo, hi, steel);
    }
    studio_orbit(&camera, target, 4, -14, 16, 15);
    bad = bad || studio_render(&scene, &camera, im);
    studio_scene_end(&scene);
    free(fine);
    return bad;
}

static int draw_moment(rod *s, int k) {
    enum { PW = 640, PH = 380, COLUMNS = 2 };
    studio_image panel = {0, 0, NULL};
    char text[80];
    int bad = studio_image_make(&panel, PW, PH) ||
              (!s->sheet.rgb && studio_image_make(&s->sheet, COLUMNS * PW, MOMENTS / COLUMNS * PH)) || draw(s, &panel);
    snprintf(text, sizeof text, "%.1f turns: twist %.2f, writhe %.2f", s->angle / 360, s->twist, s->writhe);
    if (!bad) studio_panel(&s->sheet, &panel, k % COLUMNS, k / COLUMNS, text);
    studio_image_free(&panel);
    return bad;
}

/* ---- checks ---- */

/* Bounds.  The shaft: what a section may miss of its stiffness, a twentieth.  Straight: at 0.8 of
 * Greenhill's moment the bend of a thousandth of the length has grown by less than 1/(1 - 0.8) = 5.
 * Overlap: half a spacing is where a strand's line comes to the other's surface.  Linking: a strand that passes
 * another changes it by 2 turns; marks that are means over a piece, and a line that goes on for 100 m, cost
 * hundredths. */
static void check(const rod *s) {
    printf("%d points, diameter %.4f m; Greenhill's angle %.0f degrees\n", s->count, (double)s->diameter, greenhill());
    studio_check("torque of the straight cord over the exact one", s->moment / s->turned / exact_slope(s), "", 0.95,
                 1.05);
    studio_check("farthest from the line below Greenhill's angle", s->straight * (double)s->diameter, "m", 0,
                 5e-3 * (double)length);
    studio_check("farthest from the line in the end", s->bent, "diameters", 3, HUGE_VAL);
    studio_check("largest overlap", s->worst.overlap, "spacings", 0, 0.5);
    studio_check("nearest strands", s->nearest, "diameters", 0.5, HUGE_VAL);
    studio_check("twist + writhe off the turns of the clamp", s->slip, "turns", 0, 0.1);
    studio_check("writhe in the end", s->writhe, "turns", 1, HUGE_VAL);
    studio_check("steps not converged", s->worst.unconverged, "", 0, 0);
}

/* ---- main ---- */

static int show(rod *s, int k, studio_image *im) {
    static const double at[MOMENTS] = {0.30, 0.42, 0.55, 0.68, 0.80, 1};
    char text[48];
    int j, bad = 0;
    fprintf(s->csv, "%.5f,%.3f,%.6g,%.5f,%.5f,%.4f,%d\n", s->worst.steps * (double)dt, s->angle, s->torque, s->twist,
            s->writhe, peri_world_stats(s->world).overlap, peri_world_stats(s->world).iterations);
    studio_plot_point(&s->plot, 0, s->angle / 360, 1000 * s->torque);
    for (j = 0; j < MOMENTS && !bad; j++)
        if (k == (int)(at[j] * s->options.frames + 0.5)) bad = draw_moment(s, j);
    if (k % 4 || bad) return bad;
    if (draw(s, im)) return -1;
    snprintf(text, sizeof text, "%.1f turns", s->angle / 360);
    studio_panel(im, im, 0, 0, text);
    return studio_gif_frame(s->gif, im);
}

static int run(rod *s) {
    studio_options *o = &s->options;
    studio_image im = {0, 0, NULL};
    static const float ink[3] = {0.2f, 0.22f, 0.26f};
    char note[48];
    int k, bad = 0;
    studio_plot_begin(&s->plot, "Torque of the cord", "turns of the clamp", "torque, mN m");
    studio_plot_series(&s->plot, "cord", STUDIO_LINE, NULL);
    studio_plot_series(&s->plot, "round shaft, to Greenhill's angle", STUDIO_DASHED, ink);
    studio_plot_point(&s->plot, 1, 0, 0);
    studio_plot_point(&s->plot, 1, greenhill() / 360, 1000 * exact_slope(s) * greenhill());
    if (!o->check) {
        s->gif = studio_gif_begin(studio_path(o->out, "rod.gif"), o->width, o->height, 6);
        s->csv = studio_csv(o->out, "rod.csv", "time,angle,torque,twist,writhe,overlap,iterations");
        bad = !s->gif || !s->csv || studio_image_make(&im, o->width, o->height);
    }
    s->nearest = HUGE_VAL;
    for (k = 1; k <= o->frames && !bad; k++) {
        snprintf(note, sizeof note, "%.1f turns, %d contacts", s->angle / 360, peri_world_stats(s->world).contacts);
        studio_progress(o, k - 1, o->frames, note);
        bad = drive(s, (double)k / o->frames) || studio_step_world(s->world, dt, &s->worst) || observe(s);
        s->slip = fmax(s->slip, fabs(fabs(s->twist + s->writhe) - s->angle / 360));
        if (!bad && !o->check) bad = show(s, k, &im);
    }
    studio_progress(o, o->frames, o->frames, NULL);
    if (s->csv) fclose(s->csv);
    bad |= s->gif && studio_gif_end(s->gif);
    if (!bad && !o->check)
        bad = studio_png(studio_path(o->out, "rod.png"), &s->sheet) ||
              studio_plot_write(&s->plot, studio_path(o->out, "rod_torque.png"), 720, 460);
    studio_image_free(&im);
    return bad;
}

int main(int argc, char **argv) {
    static rod s;
    int bad;
    if (studio_begin(&app, argc, argv, &s.options)) return studio_exit_code();
    bad = create(&s) || run(&s);
    if (!bad) check(&s);
    if (!bad && !s.options.check)
        printf("a step of 1/60 s took %.2f ms and %.1f iterations on average\n", 1000 * s.worst.seconds / s.worst.steps,
               (double)s.worst.iterations / s.worst.steps);
    studio_plot_end(&s.plot);
    studio_image_free(&s.sheet);
    free(s.points);
    free(s.mark);
    free(s.gradient);
    peri_world_destroy(s.world);
    return bad ? 1 : studio_end(&s.options);
}
