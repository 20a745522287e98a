/* tests/bench/loops.c - the hot loops by themselves: million directed bonds a second and core, for every kernel and
   layout, and the pointwise part of the correspondence model in ns a particle. A block of 29^3 = 24 389 particles of 26
   neighbours, and with horizon 3.01 of 122, shaken. Processor time of one thread, minimum over repetitions of 25 ms and
   more. scalar: particle by particle; lockstep, lattice: see peri_material.h. Where LAMMPS is installed (apt-get
   install lammps) its peri/pmb (bond-based, one pass) and peri/lps (the solid of stretch B1, two passes) run on the
   same block at horizon 3.01, and ours are given over its: the force loop and the whole evaluation. Targets are for -O3
   -march=native with AVX-512. Prints a table, writes CSV to the file named as the first argument. */
#define PERI_IMPLEMENTATION
#include "../../peri.h"
#include "bench.h"
#include "bonds.h"
#include "lammps.h"

static double now(void) { return 1e-3 * bench_thread(); }

/* Seconds of one pass. */
static double measure(bonds_scene *s, int kind) {
    double best = 1e9, start = now(), at, spent;
    int repeats, k;
    bonds_pass(s, kind);
    at = now() - start;
    repeats = (int)(0.025 / (at > 1e-6 ? at : 1e-6)) + 1;
    start = now();
    do {
        at = now();
        for (k = 0; k < repeats; k++) bonds_pass(s, kind);
        spent = (now() - at) / repeats;
        if (spent < best) best = spent;
    } while (now() - start < 0.3);
    return best;
}

/* ns a particle of what the correspondence model does between its two gathers. */
static double pointwise(bonds_scene *s) {
    const peri__bonds *b = s->p.bonds;
    peri__lanes *t = &s->b->lanes;
    peri__row h[6], right[6], squares;
    double best = 1e9, at, start = now();
    int q, l, c, k;
    for (c = 0; c < 6; c++)
        for (l = 0; l < PERI__LANES; l++) right[c][l] = PERI__R(1e-3) * (peri_real)(c + l % 3), squares[l] = 0;
    do {
        at = now();
        for (k = 0; k < 20; k++)
            for (q = 0; q < t->blocks; q++) {
                peri__own own;
                peri__lanes_own(b, t, q, 0, b->mode, &own);
                peri__packed16(b->moment + 21 * PERI__LANES * (size_t)q, right, h);
                peri__correspondence_point(b, t, &s->b->matter, &own, q, (size_t)q * PERI__LANES, h, right, squares, 0);
            }
        at = 1e9 * (now() - at) / 20 / s->b->count;
        if (at < best) best = at;
    } while (now() - start < 0.3);
    return best;
}

static int missed;

static void target(FILE *csv, const char *name, double value, double wanted, int less) {
    int good = less ? value <= wanted : value >= wanted;
    missed += !good;
    printf("target %-34s %8.1f, wanted %s %6.0f: %s\n", name, value, less ? "<=" : ">=", wanted,
           good ? "reached" : "MISSED");
    if (csv) fprintf(csv, "target %s,,,%g,%g,%s\n", name, value, wanted, good ? "reached" : "MISSED");
}

static const char *const model[4] = {"stretch B1", "stretch A1", "correspondence", "projective"};

/* Ours over LAMMPS', both at horizon 3.01: force loop and whole evaluation. */
static void beside_lammps(FILE *csv, const char *path, int n, double force[4][LAYOUTS], double whole[4][LAYOUTS]) {
    double pmb, lps, ms[2] = {0, 0};
    char name[64];
    int k, layout;
    if (!lammps_found()) {
        printf("LAMMPS: no program lmp with the package PERI, so nothing beside it: apt-get install lammps\n");
        return;
    }
    pmb = lammps_bonds(path, "pmb", n, 3.01, 20, ms);
    lps = lammps_bonds(path, "lps", n, 3.01, 10, ms + 1);
    if (!(pmb > 0 && lps > 0)) {
        printf("LAMMPS: it did not run\n");
        return;
    }
    printf("LAMMPS, horizon 3.01: peri/pmb %.1f, peri/lps %.1f M bonds/s\n", pmb, lps);
    printf("%-25s %12s %16s %16s\n", "ours over LAMMPS'", "force/pmb", "evaluation/pmb", "evaluation/lps");
    if (csv) fprintf(csv, "LAMMPS pmb,lammps,3.01,evaluation,%g,%g\nLAMMPS lps,lammps,3.01,evaluation,%g,%g\n", pmb,
                     ms[0], lps, ms[1]);
    for (k = 0; k < 4; k++)
        for (layout = 0; layout < LAYOUTS; layout++)
            printf("%-15s %-9s %12.1f %16.1f %16.1f\n", model[k], layout_name[layout], force[k][layout] / pmb,
                   whole[k][layout] / pmb, whole[k][layout] / lps);
    for (k = 0; k < 4; k++)
        for (layout = LOCKSTEP; layout < LAYOUTS; layout++) {
            snprintf(name, sizeof name, "%s %s over pmb", layout_name[layout], model[k]);
            target(csv, name, force[k][layout] / pmb, layout == LOCKSTEP ? 5 : 25, 0);
        }
}

int main(int argc, char **argv) {
    static const char *const kind_name[5] = {"local", "local+energy", "force", "place", "evaluation"};
    int h, k, layout, kind, size = 29;
    FILE *csv = bench_csv(argc, argv, "model,layout,horizon,kernel,mbonds_per_s,ms");
    double force[2][4][LAYOUTS], whole[2][4][LAYOUTS], point = 0;
    peri_material m[4];
    m[0] = peri_material_linear(1e5f, 0.3f, 1000);
    m[1] = peri_material_neo_hookean_papers(1e5f, 0.3f, 1000);
    m[2] = peri_material_neo_hookean(1e5f, 0.3f, 1000);
    m[3] = peri_material_projective(1e5f, 0.5f, 1000);
    printf("M bonds/s (place: ns a particle)\n%-15s %-9s %7s", "model", "layout", "horizon");
    for (kind = 0; kind < 5; kind++) printf(" %12s", kind_name[kind]);
    printf("\n");
    for (h = 0; h < 2; h++)
        for (k = 0; k < 4; k++)
            for (layout = 0; layout < LAYOUTS; layout++) {
                bonds_scene s;
                memset(&s, 0, sizeof s);
                if (!bonds_make(&s, size, h ? 3.01 : 1.75, &m[k], layout)) {
                    printf("no %s layout\n", layout_name[layout]);
                    return 1;
                }
                s.p.energy = 0;
                printf("%-15s %-9s %7.2f", model[k], layout_name[layout], h ? 3.01 : 1.75);
                for (kind = 0; kind < 5; kind++) {
                    double time = kind == 3 && layout == SCALAR ? 0 : measure(&s, kind), bonds = s.w->bonds;
                    double value = kind == 3 ? 1e9 * time / s.b->count : 1e-6 * bonds / time;
                    printf(" %12.1f", value);
                    fflush(stdout);
                    if (kind == 2) force[h][k][layout] = value;
                    if (kind == 4) whole[h][k][layout] = value;
                    if (csv)
                        fprintf(csv, "%s,%s,%g,%s,%g,%g\n", model[k], layout_name[layout], h ? 3.01 : 1.75,
                                kind_name[kind], value, 1e3 * time);
                }
                printf("\n");
                if (k == 2 && layout == LOCKSTEP && !h) point = pointwise(&s);
                bonds_unmake(&s);
            }
    target(csv, "lockstep stretch A1 force, M/s", force[0][1][LOCKSTEP], 530, 0);
    target(csv, "lockstep correspondence force", force[0][2][LOCKSTEP], 400, 0);
    target(csv, "lockstep projective force", force[0][3][LOCKSTEP], 260, 0);
    target(csv, "lattice stretch A1 force", force[0][1][LATTICE], 3300, 0);
    target(csv, "lattice correspondence force", force[0][2][LATTICE], 2700, 0);
    target(csv, "lattice projective force", force[0][3][LATTICE], 1000, 0);
    target(csv, "pointwise, ns a particle", point, 12, 1);
    /* its scripts and logs go beside the table, or, without one, beside the program */
    beside_lammps(csv, argv[argc > 1], size, force[1], whole[1]);
    printf("%d targets missed\n", missed);
    if (csv) fclose(csv);
    return 0;
}
