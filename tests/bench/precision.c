/* tests/bench/precision.c - what float leaves of a step: a beam of 57 x 21 x 21 particles (0.98 x 0.36 x 0.36 m), one
   end held, after six steps of 1/30 s under gravity, E 1e5 and 1e6 Pa.

   "floor": the force of the same positions, by the layouts of the library (lattice and lockstep take fixed-point
   positions in a float step, particle by particle takes differences in double) and from positions rounded to float,
   which is what a solver with float positions knows of them: rms distance from particle by particle, over a
   particle's weight. No residual can be seen below that.
   "correction": steps at a tolerance of 1e-4 of the step's rms motion: the last correction of any particle over that
   motion, at worst of six steps, with the iterations and ms of the median one.
   Writes CSV to the first argument and prints a table; quick: 29 x 11 x 11. Ratios hold elsewhere, ms do not. */
#define PERI_IMPLEMENTATION
#include "../../peri.h"
#include "bench.h"

enum { STEPS = 6 };

typedef struct beam {
    peri_world *world;
    peri_body_id id;
    int count;
    double weight;      /* of a particle, N */
    double spacing;
} beam;

static const char *const model_name[4] = {"correspondence", "stretch B1/B1", "stretch A1/A1", "projective"};

static peri_material material(int model, double young) {
    peri_real e = (peri_real)young;
    if (model == 0) return peri_material_neo_hookean(e, (peri_real)0.3, 1000);
    if (model == 1) return peri_material_linear(e, (peri_real)0.3, 1000);
    if (model == 2) return peri_material_neo_hookean_papers(e, (peri_real)0.3, 1000);
    return peri_material_projective(e, (peri_real)0.5, 1000);
}

static void begin(beam *b, int full, int model, double young, double tolerance) {
    peri_world_def wd = peri_default_world_def();
    peri_body_def bd = peri_default_body_def();
    peri_error err;
    peri_material m = material(model, young);
    int along = full ? 57 : 29, across = full ? 21 : 11, i, n = along * across * across;
    peri_real *points = (peri_real *)bench_obtain(3 * (size_t)n * sizeof *points);
    unsigned char *fixed = (unsigned char *)bench_zeros((size_t)n, 1);
    wd.parallel.threads = 1;
    wd.tolerance = (peri_real)tolerance;
    wd.max_iterations = 3000;
    wd.keep_momentum = 0;
    b->world = peri_world_create(&wd, &err);
    if (!b->world) printf("%s\n", err.text), exit(1);
    b->spacing = 0.98 / along;
    b->weight = 9.81 * 1000 * pow(b->spacing, 3);
    b->count = n;
    for (i = 0; i < n; i++) {
        points[3 * i] = (peri_real)((i % along + 0.5) * b->spacing);
        points[3 * i + 1] = (peri_real)((i / along % across + 0.5) * b->spacing);
        points[3 * i + 2] = (peri_real)((i / along / across + 0.5) * b->spacing);
        fixed[i] = i % along == 0;
    }
    bd.points = points;
    bd.fixed = fixed;
    bd.count = n;
    bd.spacing = (peri_real)b->spacing;
    bd.material = peri_material_create(b->world, &m);
    b->id = peri_body_create(b->world, &bd);
    free(points);
    free(fixed);
    if (!b->id.index1) printf("%s\n", peri_last_error(b->world)->text), exit(1);
}

static void step(beam *b) {
    if (peri_world_step(b->world, (peri_real)(1.0 / 30))) printf("%s\n", peri_last_error(b->world)->text), exit(1);
}

/* Forces particle by particle, or by the layout that the body has. */
static void forces(beam *b, int scalar, peri_real *f) {
    peri__body *body = peri__body_find(b->world, b->id);
    int blocks = body->lanes.blocks;
    if (scalar) body->lanes.blocks = 0;
    if (peri_body_forces(b->world, b->id, f)) exit(1);
    body->lanes.blocks = blocks;
}

/* rms distance over a particle's weight, free particles. */
static double apart(const beam *b, const peri_real *f, const peri_real *g) {
    double sum = 0;
    int i;
    for (i = 0; i < 3 * b->count; i++)
        if (!(b->world->flags[i / 3] & PERI__FIXED)) sum += pow((double)f[i] - (double)g[i], 2);
    return sqrt(sum / b->count) / b->weight;
}

static void floor_of(FILE *csv, int full, int model, double young) {
    beam b;
    peri_real *exact, *f;
    double found[3];
    int k;
    begin(&b, full, model, young, 1e-3);
    exact = (peri_real *)bench_obtain(3 * (size_t)b.count * sizeof *exact);
    f = (peri_real *)bench_obtain(3 * (size_t)b.count * sizeof *f);
    for (k = 0; k < STEPS; k++) step(&b);
    forces(&b, 1, exact);
    forces(&b, 0, f);
    found[0] = apart(&b, f, exact);
    if (peri__lanes_leave(b.world, peri__body_find(b.world, b.id))) exit(1);
    forces(&b, 0, f);
    found[1] = apart(&b, f, exact);
    for (k = 0; k < 3 * b.count; k++) b.world->x[k] = (double)(float)b.world->x[k];
    forces(&b, 1, f);
    found[2] = apart(&b, f, exact);
    printf("%-15s %.0e %12.1e %12.1e %16.1e %10.0f\n", model_name[model], young, found[0], found[1], found[2],
           found[2] / (found[0] > found[1] ? found[0] : found[1]));
    if (csv) fprintf(csv, "floor,%s,%g,%g,%g,%g,,\n", model_name[model], young, found[0], found[1], found[2]);
    peri_world_destroy(b.world);
    free(exact);
    free(f);
}

static void correction_of(FILE *csv, int full, int model, double young) {
    beam b;
    double motion[STEPS], ms[STEPS], its[STEPS], worst = 0, least = 1e300;
    int k, i, capped = 0, pass;
    for (pass = 0; pass < 2; pass++) {      /* the first to know the motion, which sets the tolerance */
        double *before;
        begin(&b, full, model, young, pass ? 1e-4 * least / 1.001 / b.spacing : 1e-3);
        before = (double *)bench_obtain(3 * (size_t)b.count * sizeof *before);
        for (k = 0; k < STEPS; k++) {
            peri_stats s;
            double sum = 0;
            memcpy(before, b.world->x, 3 * (size_t)b.count * sizeof *before);
            step(&b);
            s = peri_world_stats(b.world);
            for (i = 0; i < 3 * b.count; i++) sum += pow(b.world->x[i] - before[i], 2);
            motion[k] = sqrt(sum / b.count);
            if (!pass && motion[k] < least) least = motion[k];
            ms[k] = s.profile.total;
            its[k] = s.iterations;
            capped += pass && !s.converged;
            if (pass && s.correction / motion[k] > worst) worst = s.correction / motion[k];
        }
        peri_world_destroy(b.world);
        free(before);
    }
    printf("%-15s %.0e %12.1e %12.0f %10.1f   %s\n", model_name[model], young, worst, bench_median(its, STEPS, NULL),
           bench_median(ms, STEPS, NULL), worst <= 1e-4 ? "reached" : "MISSED");
    if (capped)
        printf("    %d of %d steps stopped above the tolerance, which is that of the least motion\n", capped, STEPS);
    if (csv)
        fprintf(csv, "correction,%s,%g,,,,%g,%g\n", model_name[model], young, worst, bench_median(its, STEPS, NULL));
}

int main(int argc, char **argv) {
    FILE *csv = bench_csv(argc, argv, "part,model,young,lattice,lockstep,float_positions,correction,iterations");
    int full = bench_full(argc, argv), model, e;
    printf("floor of the force, rms over a particle's weight\n");
    printf("%-15s %-5s %12s %12s %16s %10s\n", "model", "E", "lattice", "lockstep", "float positions", "ratio");
    for (model = 0; model < 4; model++)
        for (e = 0; e < 2; e++) floor_of(csv, full, model, e ? 1e6 : 1e5);
    printf("\nsteps to a correction of 1e-4 of the motion\n%-15s %-5s %12s %12s %10s\n", "model", "E", "correction",
           "iterations", "ms");
    for (model = 0; model < 4; model++)
        for (e = 0; e < 2; e++) correction_of(csv, full, model, e ? 1e6 : 1e5);
    if (csv) fclose(csv);
    return 0;
}
