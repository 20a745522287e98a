/* curves - nominal stress against stretch of every material, beside the exact curve.
 *
 * Answers SH figure 12 (SH = "Reformulating Hyperelastic Materials with Peridynamic Modeling", Xu et al. 2018).
 *
 *   material point   peri_material_point pulled along x, its sides free: the lateral stretch is found by bisection.
 *                    Neo-Hookean and St. Venant-Kirchhoff have closed forms to compare with.
 *   bar              1 x 0.2 x 0.2 m of particles, 8 x 8 over the section, both ends gripped (held sideways too) and
 *                    drawn apart without inertia; the force is that on the grip.  Beside it finite elements.
 *
 * The projective model has Poisson's ratio 1/4, whatever is asked, so all are compared there; a second plot has 0.4.
 *
 *   cc -O2 examples/curves.c -lm -o curves && ./curves      three plots and tables in build/out/curves
 *   ./curves --model linear                                 the bar of that model only; all: of every model
 *   ./curves --check                                        numbers only
 */
#include "studio.h"

#define PERI_IMPLEMENTATION
#include "../peri.h"
#include "studio_peri.h"

enum { NEO_HOOKEAN, STVK_EXACT, STABLE, LINEAR, PAPERS, STVK, PROJECTIVE, MODELS };
static const char *const model_name[MODELS] = {"neo_hookean", "stvk_exact", "stable", "linear",
                                               "papers",      "stvk",       "projective"};
static const char *const model_says[MODELS] = {"neo-Hookean",  "St. Venant-Kirchhoff", "stable neo-Hookean",
                                               "linear B1/B1", "papers' A1/A1",        "svk/svk",
                                               "projective"};

static const double young = 1e5, density = 1000;

static const studio_app app = {"curves",
                               "Nominal stress against stretch of every material and of a gripped bar (SH figure 12).\n"
                               "models (of the bar): neo_hookean stvk_exact stable linear papers stvk projective all\n"
                               "solvers: auto cholesky two-level jacobi chebyshev position\n",
                               NULL, 20};

/* Finite elements: quadratic tetrahedra, 3 boxes of 6 over the quarter section, neo-Hookean, E = 1e5 Pa, Poisson's
 * ratio 0.25, bar 1 x 0.2 x 0.2 m, both ends gripped.  Stretch, force / 0.04 m^2 in Pa. */
static const double elements[][2] = {{0.85, -17099.83}, {0.90, -10907.99}, {0.95, -5236.477}, {1.00, 0},
                                     {1.05, 4869.687},  {1.10, 9427.722},  {1.15, 13719.07},  {1.20, 17780.73},
                                     {1.25, 21643.35},  {1.30, 25332.55},  {1.40, 32273.55},  {1.50, 38739.76},
                                     {1.60, 44830.73},  {1.75, 53421.08},  {2.00, 66688.79}};
enum { ELEMENTS = sizeof elements / sizeof elements[0], REST = 3 };

static peri_material make_material(int model, double poisson) {
    peri_material m;
    if (studio_material(model_name[model], young, poisson, density, &m)) exit(2); /* a name that is none */
    return m;
}

/* ----------------------------------------------------------------------------------------- material point -------- */

/* Nominal stress along x and sideways at the stretches a along x and b sideways. */
static double pull_point(const peri_material *m, double a, double b, double *sideways) {
    double f[9] = {0}, p[9];
    f[0] = a;
    f[4] = f[8] = b;
    peri_material_point(m, f, p);
    *sideways = p[4];
    return p[0];
}

/* Nominal stress in uniaxial stress at stretch a, or NaN when the sides find no rest between 0.3 and 2. */
static double point_stress(const peri_material *m, double a) {
    double low = 0.3, high = 2, sideways, stress = 0;
    int k;
    pull_point(m, a, low, &sideways);
    if (sideways > 0) return sqrt(-1.0);
    for (k = 0; k < 60; k++) {
        double b = (low + high) / 2;
        stress = pull_point(m, a, b, &sideways);
        if (sideways < 0) low = b;
        else high = b;
    }
    return stress;
}

/* Neo-Hookean, exactly: mu (b - 1/b) + lambda log(a b^2) / b = 0 gives b, the stress follows. */
static double exact_neo_hookean(double a, double nu) {
    double mu = young / (2 * (1 + nu)), lambda = young * nu / ((1 + nu) * (1 - 2 * nu)), low = 0.1, high = 10;
    int k;
    for (k = 0; k < 100; k++) {
        double b = (low + high) / 2;
        if (mu * (b * b - 1) + lambda * log(a * b * b) < 0) low = b;
        else high = b;
    }
    return mu * (a - 1 / a) + lambda * log(a * low * low) / a;
}

/* St. Venant-Kirchhoff, exactly: Hooke's law between Green's strain and the second Piola-Kirchhoff stress. */
static double exact_stvk(double a, double nu) {
    (void)nu; /* only the sides know it; they find rest while nu (a^2 - 1) < 1 */
    return a * young * (a * a - 1) / 2;
}

typedef double exact_law(double a, double nu);

/* Largest relative difference of a material point to the closed form over stretches 0.6 to 2. */
static double point_error(int model, double nu, exact_law *exact) {
    peri_material m = make_material(model, nu);
    double worst = 0, a;
    for (a = 0.6; a < 2.01; a += 0.05) {
        double want = exact(a, nu), error = fabs(point_stress(&m, a) - want) / (fabs(want) + 1e-3 * young);
        if (exact == exact_stvk && nu * (a * a - 1) > 0.8) break; /* beyond, the sides collapse */
        if (!(error <= worst)) worst = error;
    }
    return worst;
}

static void check_points(void) {
    static const double ratios[] = {0, 0.25, 0.4};
    char name[100];
    int k, model;
    for (k = 0; k < 3; k++) {
        snprintf(name, sizeof name, "neo_hookean point to closed form, nu %g", ratios[k]);
        studio_check(name, point_error(NEO_HOOKEAN, ratios[k], exact_neo_hookean), "", 0, 1e-6);
        snprintf(name, sizeof name, "stvk_exact point to closed form, nu %g", ratios[k]);
        studio_check(name, point_error(STVK_EXACT, ratios[k], exact_stvk), "", 0, 1e-6);
    }
    studio_check("stvk point to closed form, nu 0.25", point_error(STVK, 0.25, exact_stvk), "", 0, 1e-6);
    for (model = 0; model < MODELS; model++) {
        peri_material m = make_material(model, 0.25);
        double slope = (point_stress(&m, 1.001) - point_stress(&m, 0.999)) / 0.002;
        snprintf(name, sizeof name, "%s point, slope at rest / E", model_name[model]);
        studio_check(name, slope / young, "", 0.9999, 1.0001);
    }
}

/* Exact curves as dots, the library's as lines, dashed where one covers another; stress in units of E. */
static int plot_points(const studio_options *o, double nu, const char *file) {
    studio_plot plot;
    char title[96];
    double a, stress;
    int model, series, bad;
    snprintf(title, sizeof title, "Material points under uniaxial stress, Poisson's ratio %g", nu);
    studio_plot_begin(&plot, title, "stretch", "nominal stress / E");
    plot.legend_left = 1;
    plot.y_lo = -1;
    plot.y_hi = 1.5;
    for (model = 0; model < MODELS; model++) {
        peri_material m = make_material(model, nu);
        if (model == PROJECTIVE && fabs(nu - 0.25) > 1e-6) continue;
        series = studio_plot_series(&plot, model_says[model], model < STVK ? STUDIO_LINE : STUDIO_DASHED, NULL);
        for (a = 0.5; a < 2.001; a += 0.02) studio_plot_point(&plot, series, a, point_stress(&m, a) / young);
    }
    series = studio_plot_series(&plot, "closed forms", STUDIO_POINTS, NULL);
    for (a = 0.5; a < 2.001; a += 0.1) {
        studio_plot_point(&plot, series, a, exact_neo_hookean(a, nu) / young);
        stress = exact_stvk(a, nu) / young;
        if (stress < 1.5 && nu * (a * a - 1) < 0.95) studio_plot_point(&plot, series, a, stress);
    }
    bad = studio_plot_write(&plot, studio_path(o->out, file), 900, 640);
    studio_plot_end(&plot);
    return bad;
}

static int table_points(const studio_options *o) {
    FILE *f = studio_csv(o->out, "points.csv",
                         "poisson,stretch,exact_neo_hookean_Pa,exact_stvk_Pa,neo_hookean,stvk_exact,stable,linear,"
                         "papers,stvk,projective");
    static const double ratios[] = {0.25, 0.4};
    int k, step, model;
    if (!f) return -1;
    for (k = 0; k < 2; k++)
        for (step = 10; step <= 40; step++) {
            double a = 0.05 * step;
            fprintf(f, "%g,%.2f,%.3f,%.3f", ratios[k], a, exact_neo_hookean(a, ratios[k]), exact_stvk(a, ratios[k]));
            for (model = 0; model < MODELS; model++) {
                peri_material m = make_material(model, ratios[k]);
                fprintf(f, ",%.3f", point_stress(&m, a));
            }
            fprintf(f, "\n");
        }
    return fclose(f);
}

/* ---------------------------------------------------------------------------------------------------- bar -------- */

/* Lattice of ACROSS x ACROSS over the section.  GRIP layers more at each end are held, so that the clamped planes
 * x = 0 and x = 1 lie half way between the last held and the first free layer. */
enum { ACROSS = 8, ALONG = 5 * ACROSS, GRIP = 2, LAYERS = ALONG + 2 * GRIP, COUNT = LAYERS * ACROSS * ACROSS };
static const double section = 0.2 * 0.2; /* m^2 */

typedef struct bar {
    peri_world *world;
    peri_body_id body;
    double stretch;
    peri_real rest[3 * COUNT], x[3 * COUNT];
    unsigned char held[COUNT];
} bar;

static int bar_begin(bar *b, int model, const studio_options *o) {
    const double d = 0.2 / ACROSS;
    peri_world_def wd = peri_default_world_def();
    peri_body_def bd = peri_default_body_def();
    peri_material m = make_material(model, 0.25);
    peri_error err;
    int i;
    if (studio_solver(o->solver, &wd.solver)) return -1;
    for (i = 0; i < COUNT; i++) {
        int layer = i / (ACROSS * ACROSS) - GRIP;
        b->rest[3 * i] = (peri_real)((layer + 0.5) * d);
        b->rest[3 * i + 1] = (peri_real)((i % ACROSS + 0.5) * d - 0.1);
        b->rest[3 * i + 2] = (peri_real)((i / ACROSS % ACROSS + 0.5) * d - 0.1);
        b->held[i] = layer < 0 || layer >= ALONG;
    }
    wd.gravity.z = 0;
    wd.parallel.threads = o->threads;
    wd.max_iterations = 1000;
    wd.tolerance = (peri_real)2e-4;
    b->stretch = 1;
    b->world = peri_world_create(&wd, &err);
    if (!b->world) return studio_error("%s", err.text);
    bd.points = b->rest;
    bd.count = COUNT;
    bd.spacing = (peri_real)d;
    bd.fixed = b->held;
    bd.material = peri_material_create(b->world, &m);
    b->body = peri_body_create(b->world, &bd);
    return b->body.index1 ? 0 : studio_failed(b->world);
}

/* Draws the grips to a new stretch and finds the rest: a time step of 1000 s leaves no inertia.  The bar is put
 * stretched evenly from where it was, which is a good first guess. */
static int bar_draw(bar *b, double stretch) {
    const peri_real *now = peri_body_positions(b->world, b->body);
    int i;
    for (i = 0; i < COUNT; i++) {
        double x = (double)b->rest[3 * i], more = stretch - b->stretch;
        memcpy(b->x + 3 * i, now + 3 * i, 3 * sizeof *now);
        b->x[3 * i] = (peri_real)((double)now[3 * i] + more * (x < 0 ? 0 : x > 1 ? 1 : x));
    }
    b->stretch = stretch;
    if (peri_body_set_positions(b->world, b->body, 0, COUNT, b->x)) return studio_failed(b->world);
    if (peri_world_step(b->world, 1000)) return studio_failed(b->world);
    return 0;
}

/* Force on the right grip over the rest section, Pa. */
static int bar_stress(bar *b, double *stress) {
    static peri_real force[3 * COUNT];
    int i;
    if (peri_body_forces(b->world, b->body, force)) return studio_failed(b->world);
    for (*stress = 0, i = COUNT - GRIP * ACROSS * ACROSS; i < COUNT; i++) *stress -= (double)force[3 * i] / section;
    return 0;
}

/* Calls for each stretch of the table of finite elements between lo and hi, away from 1 in both directions, with
 * steps of at most 0.05; stress[k] belongs to elements[k]. */
static int bar_curve(int model, double lo, double hi, const studio_options *o, double stress[ELEMENTS]) {
    int way, k, bad = 0;
    bar *b = (bar *)studio_alloc(1, sizeof *b);
    if (!b) return -1;
    for (k = 0; k < ELEMENTS; k++) stress[k] = sqrt(-1.0);
    for (way = -1; way <= 1 && !bad; way += 2) {
        int begin = REST, end = way < 0 ? -1 : (int)ELEMENTS;
        bad = bar_begin(b, model, o);
        for (k = begin; k != end && !bad; k += way) {
            double to = elements[k][0];
            if (to < lo || to > hi) break;
            while (!bad && fabs(to - b->stretch) > 0.0501) bad = bar_draw(b, b->stretch + 0.05 * way);
            bad = bad || bar_draw(b, to) || bar_stress(b, &stress[k]);
            if (!o->check) studio_progress(o, way < 0 ? REST - k : k, (int)ELEMENTS, model_name[model]);
        }
        peri_world_destroy(b->world);
    }
    free(b);
    return bad;
}

static void check_bar(const studio_options *o) {
    static const double at[] = {0.9, 1.1, 1.25, 1.5, 2.0};
    double stress[ELEMENTS];
    char name[80];
    int bad = bar_curve(NEO_HOOKEAN, 0.89, 2.01, o, stress), k, n;
    for (n = 0; n < 5; n++)
        for (k = 0; k < ELEMENTS; k++) {
            if (fabs(elements[k][0] - at[n]) > 1e-9) continue;
            snprintf(name, sizeof name, "gripped bar, force / finite elements at stretch %g", at[n]);
            studio_check(name, bad ? HUGE_VAL : stress[k] / elements[k][1], "", 0.97, 1.03);
        }
}

/* The chosen bars into bars.csv and bars.png. */
static int plot_bars(const studio_options *o, const int *chosen, int count) {
    static double stress[MODELS][ELEMENTS];
    FILE *f = studio_csv(o->out, "bars.csv", "model,stretch,nominal_Pa,neo_hookean_finite_elements_Pa");
    studio_plot plot;
    int c, k, series, bad = 0;
    if (!f) return -1;
    studio_plot_begin(&plot, "Gripped bar 1 x 0.2 x 0.2 m, Poisson's ratio 0.25, 8 particles across", "stretch",
                      "force / (section E)");
    plot.legend_left = 1;
    printf("gripped bar: nominal stress / that of neo-Hookean finite elements\n%14s", "stretch");
    for (k = 0; k < ELEMENTS; k++)
        if (k != REST) printf(" %5.2f", elements[k][0]);
    printf("\n");
    for (c = 0; c < count && !bad; c++) {
        bad = bar_curve(chosen[c], 0.84, 2.01, o, stress[c]);
        series = studio_plot_series(&plot, model_says[chosen[c]], chosen[c] < STVK ? STUDIO_LINE : STUDIO_DASHED, NULL);
        printf("%14s", model_name[chosen[c]]);
        for (k = 0; k < ELEMENTS; k++) {
            studio_plot_point(&plot, series, elements[k][0], stress[c][k] / young);
            fprintf(f, "%s,%.2f,%.2f,%.2f\n", model_name[chosen[c]], elements[k][0], stress[c][k], elements[k][1]);
            if (k != REST) printf(" %5.2f", stress[c][k] / elements[k][1]);
        }
        printf("\n");
    }
    series = studio_plot_series(&plot, "finite elements, neo-Hookean", STUDIO_POINTS, NULL);
    for (k = 0; k < ELEMENTS; k++) studio_plot_point(&plot, series, elements[k][0], elements[k][1] / young);
    bad |= fclose(f) || studio_plot_write(&plot, studio_path(o->out, "bars.png"), 900, 640);
    studio_plot_end(&plot);
    return bad;
}

/* --------------------------------------------------------------------------------------------------- main -------- */

int main(int argc, char **argv) {
    studio_options o;
    int chosen[MODELS] = {NEO_HOOKEAN, LINEAR, PAPERS, PROJECTIVE}, count = 4, k, bad;
    if (studio_begin(&app, argc, argv, &o)) return studio_exit_code();
    if (o.model && !strcmp(o.model, "all")) {
        for (count = 0; count < MODELS; count++) chosen[count] = count;
    } else if (o.model) {
        chosen[0] = k = studio_choice("--model", o.model, model_name, MODELS);
        count = 1;
        if (k < 0) return 2;
    }
    if (o.check) {
        check_points();
        check_bar(&o);
        return studio_end(&o);
    }
    bad = plot_points(&o, 0.25, "points_025.png") | plot_points(&o, 0.4, "points_040.png") | table_points(&o);
    bad |= plot_bars(&o, chosen, count);
    return studio_end(&o) || bad;
}
