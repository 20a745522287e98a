/* tests/bench/step.c - what a whole step costs: a beam of 57 x 21 x 21 = 25 137 particles (0.98 x 0.36 x 0.36 m), one
   end held, gravity switched on at rest, 26 neighbours, h = 1/30 s, E = 1e5 Pa, nu 0.3 (projective 1/4), tolerance 1e-3
   spacings; every model, 1 and 2 threads where OpenMP is compiled in. Prints a table and writes CSV to the file named
   as the first argument. Step time and iterations are medians over the steps after the first, which factorises; the
   rest are means (wall clock with OpenMP, else processor time). The ratio is to the correspondence model, one thread,
   of the same run. Second argument quick: a beam of 29 x 11 x 11. */
#ifdef _OPENMP
#include <omp.h>
#endif
#define PERI_IMPLEMENTATION
#include "../../peri.h"
#include <stdio.h>
#include <stdlib.h>

enum { STEPS = 12 };

static int ascending(const void *a, const void *b) {
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

typedef struct result {
    int particles, bonds;
    double step, local, global, factor, iterations, evaluations;
} result;

static peri_body_id beam(peri_world *world, int along, int across, const peri_material *m) {
    peri_body_def bd = peri_default_body_def();
    int n = along * across * across, i, j, k, c = 0;
    peri_real *points = (peri_real *)malloc(3 * sizeof *points * (size_t)n);
    unsigned char *fixed = (unsigned char *)calloc((size_t)n, 1);
    peri_body_id id;
    bd.spacing = (peri_real)(0.98 / along);
    for (k = 0; k < across; k++)
        for (j = 0; j < across; j++)
            for (i = 0; i < along; i++, c++) {
                points[3 * c] = (peri_real)(i + 0.5) * bd.spacing;
                points[3 * c + 1] = (peri_real)(j + 0.5) * bd.spacing;
                points[3 * c + 2] = (peri_real)(k + 0.5) * bd.spacing;
                fixed[c] = i == 0;
            }
    bd.points = points;
    bd.fixed = fixed;
    bd.count = n;
    bd.material = peri_material_create(world, m);
    id = peri_body_create(world, &bd);
    free(points);
    free(fixed);
    return id;
}

static int run(int along, int across, const peri_material *m, int threads, result *r) {
    peri_world_def wd = peri_default_world_def();
    peri_world *world;
    double ms[STEPS], iterations[STEPS];
    int s;
    wd.parallel.threads = threads;
    world = peri_world_create(&wd, NULL);
    memset(r, 0, sizeof *r);
    if (!world || !beam(world, along, across, m).index1) return 0;
    for (s = 0; s < STEPS; s++) {
        peri_stats q;
        if (peri_world_step(world, (peri_real)(1.0 / 30))) {
            printf("%s\n", peri_last_error(world)->text);
            return 0;
        }
        q = peri_world_stats(world);
        if (s == 0) r->factor = q.profile.factor;
        ms[s] = q.profile.total;
        iterations[s] = q.iterations;
        if (s == 0) continue;
        r->evaluations += (double)q.evaluations / (STEPS - 1);
        r->local += q.profile.local / (STEPS - 1);
        r->global += q.profile.global / (STEPS - 1);
        r->particles = q.particles;
        r->bonds = q.bonds;
    }
    qsort(ms + 1, STEPS - 1, sizeof *ms, ascending);
    qsort(iterations + 1, STEPS - 1, sizeof *iterations, ascending);
    r->step = ms[1 + (STEPS - 1) / 2];
    r->iterations = iterations[1 + (STEPS - 1) / 2];
    peri_world_destroy(world);
    return 1;
}

int main(int argc, char **argv) {
    int quick = argc > 2 && strcmp(argv[2], "quick") == 0, along = quick ? 29 : 57, across = quick ? 11 : 21, k, t;
    int most = 1;
    double unit = 0;
    FILE *csv = argc > 1 ? fopen(argv[1], "w") : NULL;
    peri_material m[4];
    static const char *name[4] = {"correspondence", "stretch", "stretch A1/A1", "projective"};
    m[0] = peri_material_neo_hookean(1e5f, 0.3f, 1000);
    m[1] = peri_material_linear(1e5f, 0.3f, 1000);
    m[2] = peri_material_neo_hookean_papers(1e5f, 0.3f, 1000);
    m[3] = peri_material_projective(1e5f, 0.5f, 1000);
#ifdef _OPENMP
    most = 2;
#endif
    if (csv) fprintf(csv, "model,threads,particles,bonds,step_ms,ratio,iterations,evaluations,local_ms,global_ms,factor_ms\n");
    printf("%-15s %7s %9s %8s %8s %6s %6s %6s %9s %9s %9s %10s\n", "model", "threads", "particles", "bonds", "step ms",
           "ratio", "iter", "eval", "local ms", "global ms", "factor ms", "Mbonds/s");
    for (k = 0; k < 4; k++)
        for (t = 1; t <= most; t++) {
            result r;
            if (!run(along, across, &m[k], t, &r)) return 1;
            if (!(unit > 0)) unit = r.step;
            printf("%-15s %7d %9d %8d %8.1f %6.2f %6.1f %6.1f %9.1f %9.1f %9.1f %10.1f\n", name[k], t, r.particles,
                   r.bonds, r.step, r.step / unit, r.iterations, r.evaluations, r.local, r.global, r.factor,
                   1e-3 * r.bonds * r.evaluations / r.local);
            fflush(stdout);
            if (csv)
                fprintf(csv, "%s,%d,%d,%d,%g,%g,%g,%g,%g,%g,%g\n", name[k], t, r.particles, r.bonds, r.step,
                        r.step / unit, r.iterations, r.evaluations, r.local, r.global, r.factor);
        }
    if (csv) fclose(csv);
    return 0;
}
