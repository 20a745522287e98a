/* rod.c - a rod is held at both ends and twisted until it gives way; then its ends come together.
 *
 * Answers PP figure 6 (a rod twisted with the help of ghost particles); PP = Peng et al., "Projective Peridynamics".
 * Shows peri_default_rod_def, peri_rod_turn, peri_rod_moment and contact of a body with itself.  To the picture it adds
 * the torque over the angle, with the slope G J / L of a round rod, and where the straight rod must give way
 * (Greenhill).  Let together it writhes, until a loop slips around an end and takes two turns away.
 *
 *     cc -O2 examples/rod.c -lm -o rod && ./rod
 *
 * Writes to --out: rod.png, rod_torque.png, rod.csv.
 */
#include "studio.h"

#define PERI_IMPLEMENTATION
#include "../peri.h"
#include "studio_peri.h"

static const float dt = 1.0f / 60;
static const double length = 1, diameter = 0.02, young = 1e7, poisson = 0.4;

static const studio_app app = {"rod", "a rod that is twisted until it gives way",
                               "  --turns N      turns of one end (4)\n", 900};

typedef struct rod {
    studio_options options;
    studio_stand stand;
    peri_body_id body;
    int n;
    double span;        /* between what is held at both ends, m */
    double angle, torque, slope_top, slope_bottom, largest, off, slack;
    studio_plot plot;
    FILE *csv;
} rod;

static double stiffness(const rod *s) {     /* G J / L, N m per rad */
    double j = STUDIO_PI / 32 * diameter * diameter * diameter * diameter;
    return young / (2 * (1 + poisson)) * j / s->span;
}

/* Angle at which a rod held at both ends gives way sideways (Greenhill): M = 2 pi E I 1.43 / L, clamped. */
static double buckling(const rod *s) {
    double i = STUDIO_PI / 64 * diameter * diameter * diameter * diameter;
    return 1.43 * 2 * STUDIO_PI * young * i / s->span / stiffness(s);
}

static int create(rod *s) {
    peri_world_def def = peri_default_world_def();
    peri_body_def d = peri_default_rod_def((peri_real)diameter);
    peri_material m = peri_material_neo_hookean((peri_real)young, (peri_real)poisson, 1100);
    peri_real points[3 * 200], ends[6] = {-0.5f, 0, 0, 0.5f, 0, 0}, step;
    peri_error err;
    peri_world *w;
    int i;
    def.tolerance = (peri_real)1e-4;    /* forces at the ends are wanted */
    def.max_iterations = 1000;
    def.gravity.z = (peri_real)-0.05;   /* enough to say which way it falls */
    w = peri_world_create(&def, &err);
    if (!w) return studio_error("%s", err.text);
    studio_stand_begin(&s->stand, w, 2);
    if (peri_sample_line(ends, 2, 0, (peri_real)(s->options.check ? 1 / 40.0 : 1 / 50.0), points, 200, &s->n, &step,
                         &err))
        return studio_error("%s", err.text);
    d.points = points;
    d.count = s->n;
    d.spacing = step;
    s->span = length - 2 * (double)step;    /* two points are held at each end */
    d.self_contact = 1;
    d.touches = 1;
    d.contact_radius = (peri_real)(0.5 * diameter / (double)step);
    d.material = peri_material_create(w, &m);
    s->body = peri_body_create(w, &d);
    if (!s->body.index1) return studio_failed(w);
    for (i = 0; i < 2; i++)
        if (peri_body_set_fixed(w, s->body, i, 1) || peri_body_set_fixed(w, s->body, s->n - 1 - i, 1))
            return studio_failed(w);
    studio_stand_add(&s->stand, s->body, 0, 0.9f, 0.5f, 0.2f)->rod = (float)diameter / 2;
    studio_set(s->stand.target, 0, 0, -0.05f);
    s->stand.distance = 2.3f;
    s->stand.turn = -70;
    s->stand.rise = 12;
    s->stand.floor = -0.35f;
    s->stand.stage = 0.7f;
    return 0;
}

/* Turns both stations of the left end to `angle`, and brings the right end nearer by `slack`. */
static int drive(rod *s, double angle, double slack) {
    peri_quat q;
    peri_vec3 x;
    int i;
    q.x = (peri_real)sin(angle / 2);
    q.y = q.z = 0;
    q.w = (peri_real)cos(angle / 2);
    x.y = x.z = 0;
    for (i = 0; i < 2; i++) {
        x.x = (peri_real)(0.5 - slack - i / (double)(s->n - 1));
        if (peri_rod_turn(s->stand.world, s->body, i, q) ||
            peri_body_move(s->stand.world, s->body, s->n - 1 - i, x)) return studio_failed(s->stand.world);
    }
    return 0;
}

/* Twist first, then let the ends come together: the twist goes into bending. */
static int run(rod *s) {
    int k, c, steps = s->options.frames, bad = 0;
    double turns = studio_number("--turns", 4) * 2 * STUDIO_PI;
    for (k = 1; k <= steps && !bad; k++) {
        double share = (double)k / steps, part = share < 0.5 ? 2 * share : 1;
        peri_vec3 moment[2];
        const peri_real *x;
        char text[64];
        s->angle = turns * part;
        s->slack = share < 0.5 ? 0 : 0.35 * (2 * share - 1);
        bad = drive(s, s->angle, s->slack) || studio_stand_step(&s->stand, dt);
        for (c = 0; c < 2 && !bad; c++)
            bad = peri_rod_moment(s->stand.world, s->body, c, &moment[c]) ? studio_failed(s->stand.world) : 0;
        if (bad) break;
        s->torque = -(double)(moment[0].x + moment[1].x);
        if (s->angle < 0.5 * buckling(s)) {
            s->slope_top += s->torque * s->angle;
            s->slope_bottom += s->angle * s->angle;
        }
        x = peri_body_positions(s->stand.world, s->body);
        for (c = 0; c < s->n; c++)
            s->off = fmax(s->off, sqrt(pow((double)x[3 * c + 1], 2) + pow((double)x[3 * c + 2], 2)));
        s->largest = fmax(s->largest, s->torque);
        studio_progress(&s->options, k, steps, "twisting");
        if (s->options.check) continue;
        fprintf(s->csv, "%.4f,%.5f,%.5f,%.6g\n", k * (double)dt, s->angle, s->slack, s->torque);
        if (share <= 0.5) studio_plot_point(&s->plot, 0, s->angle, s->torque);
        if (k != steps / 4 && k != steps / 2 && k != steps * 3 / 4 && k != steps) continue;
        snprintf(text, sizeof text, "%.1f turns, ends nearer by %.0f mm", s->angle / (2 * STUDIO_PI), 1000 * s->slack);
        bad = studio_stand_moment(&s->stand, 4, text);
    }
    return bad;
}

int main(int argc, char **argv) {
    static rod s;
    char path[STUDIO_PATH];
    int bad;
    if (studio_begin(&app, argc, argv, &s.options)) return studio_exit_code();
    if (s.options.check) s.options.frames = 600;
    studio_plot_begin(&s.plot, "Torque of the twisted rod", "angle, rad", "torque, N m");
    studio_plot_series(&s.plot, "rod", STUDIO_LINE, NULL);
    studio_plot_series(&s.plot, "G J / L", STUDIO_DASHED, NULL);
    if (!s.options.check) s.csv = studio_csv(s.options.out, "rod.csv", "time_s,angle,slack_m,torque_Nm");
    bad = create(&s);
    studio_plot_point(&s.plot, 1, 0, 0);
    studio_plot_point(&s.plot, 1, 12, 12 * stiffness(&s));
    bad = bad || run(&s);
    if (s.csv) fclose(s.csv);
    bad |= studio_stand_end(&s.stand, &s.options, "rod.png");
    snprintf(path, sizeof path, "%s/rod_torque.png", s.options.out);
    if (!bad && !s.options.check) bad = studio_plot_write(&s.plot, path, 640, 420);
    studio_plot_end(&s.plot);
    if (!bad) {
        printf("twisted by more than %.1f rad a straight rod must give way\n", buckling(&s));
        studio_check("slope of torque over G J / L", s.slope_top / s.slope_bottom / stiffness(&s), "", 0.97, 1.03);
        studio_check("the rod leaves its line by", s.off, "m", 0.05, 0.5);
        studio_check("particles out of shape", peri_world_stats(s.stand.world).unhealthy, "", 0, 4);
        studio_check("largest overlap", s.stand.overlap, "spacings", 0, 0.5);
    }
    peri_world_destroy(s.stand.world);
    return bad ? 1 : studio_end(&s.options);
}
