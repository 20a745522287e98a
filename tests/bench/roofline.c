/* tests/bench/roofline.c - how near to the memory's bandwidth the hot loops run, and what stops them: bytes moved, GB/s
   and their share of the STREAM triad (McCalpin; a = b + s c, 12 bytes a number, arrays of 64 MB), measured before and
   after each of them in the same run.

   Bytes are counted, not measured: every array once that a loop reads or writes, from memory (formulas at their
   functions below). What is gathered again and again comes from cache and counts once. To tell memory from the rest,
   every loop is also run on 512 particles, which stay in cache: `from cache` is how much faster a byte then goes. Near
   1, memory is not what stops the loop. Above 1.3 it stops it in part; loops whose arrays fit the last cache can pass
   the triad.

   Processor time of one thread, medians of samples of 5 ms and more, with the spread (between quartiles over the
   median). Particles: 46^3 = 97 336, `full` 80^3; 26 neighbours. Prints a table, writes CSV to the file named as the
   first argument. */
#define PERI_IMPLEMENTATION
#include "../../peri.h"
#include "bench.h"
#include "bonds.h"

enum { SAMPLES = 15, SMALL = 8, TRIAD = 16 << 20 };

typedef void loop_function(void *context);

/* Median time in ms of one run. */
static double measure(loop_function *loop, void *context, double *spread) {
    double time[SAMPLES], start = bench_thread();
    int k, r, repeats;
    loop(context);
    start = bench_thread();
    loop(context);
    repeats = (int)(5 / (bench_thread() - start + 1e-3)) + 1;
    for (k = 0; k < SAMPLES; k++) {
        start = bench_thread();
        for (r = 0; r < repeats; r++) loop(context);
        time[k] = (bench_thread() - start) / repeats;
    }
    return bench_median(time, SAMPLES, spread);
}

/* ---- the triad ---- */

static struct {
    float *a, *b, *c;
    double rate[512];       /* GB/s */
    int count;
} triad;

static void triad_run(void *context) {
    float *restrict a = triad.a;
    const float *b = triad.b, *c = triad.c, scale = *(const float *)context;
    int i;
    for (i = 0; i < TRIAD; i++) a[i] = b[i] + scale * c[i];
}

static void triad_begin(void) {
    int i;
    triad.a = (float *)bench_obtain(3 * sizeof(float) * TRIAD);
    triad.b = triad.a + TRIAD;
    triad.c = triad.b + TRIAD;
    for (i = 0; i < TRIAD; i++) triad.a[i] = 0, triad.b[i] = 1, triad.c[i] = 2;
}

/* Five samples more. */
static void triad_sample(void) {
    float scale = 3;
    int k;
    for (k = 0; k < 5 && triad.count < 512; k++) {
        double start = bench_thread();
        triad_run(&scale);
        triad.rate[triad.count++] = 12e-6 * TRIAD / (bench_thread() - start);
    }
}

/* ---- bond loops ---- */

typedef struct bond_loop {
    bonds_scene s;
    int kind;       /* 0 local, 2 force, as bonds_pass */
} bond_loop;

static void bond_run(void *context) {
    bond_loop *l = (bond_loop *)context;
    bonds_pass(&l->s, l->kind);
}

/* A slot of a lockstep bond: near, xi (3), 1/r^2, weight: 24 bytes; lattices have none, their stencil stays in cache.
   A lane or cell: position 12 and, where the pass reads or writes them, coefficients 4 * stride; a lattice's volume 4.
   A particle: who, share, volume 12; local of correspondence: moment 84; of projective: shape 24; force: its force 12.
   Written once, read once: what the processor fetches before it writes is not counted, as in the triad. */
static double bond_bytes(const bond_loop *l) {
    const peri__lanes *t = &l->s.b->lanes;
    peri_model model = l->s.b->matter.m.model;
    double n = l->s.b->count, slots = t->lattice ? 0 : t->start[t->blocks], own = 12;
    if (l->kind == 2) own += 12;
    else if (model == PERI_MODEL_CORRESPONDENCE) own += 84;
    else if (model == PERI_MODEL_PROJECTIVE) own += 24;
    return 24 * slots + (12 + 4.0 * l->s.p.row->stride + (t->lattice ? 4 : 0)) * t->length + own * n;
}

/* ---- matrix, preconditioners, vectors ---- */

/* An entry: value and column 8; a row: its end and diagonal 8, x and y of three sides 24. */
static double multiply_bytes(const matrix_scene *l) { return 8.0 * l->a.row[l->a.n] + 32.0 * l->a.n; }

/* Sweeps but the first: the matrix 8 an entry, 8 a row, step read 12, residual read and written 24; every sweep: step
   read and written 24, residual 12, x read and written 24; before them D^-1 b 28 and two arrays of zeros 24. */
static double chebyshev_bytes(const matrix_scene *l) {
    double n = l->a.n;
    return (BENCH_SWEEPS - 1) * (8.0 * l->a.row[l->a.n] + 44 * n) + BENCH_SWEEPS * 60 * n + 52 * n;
}

/* L as it lies, with the zeros that widen its columns, and the lists of its rows, once forward and once backward; a
   row: copied 24, permuted in and out 2 * 28, read and written by either pass 2 * 24. */
static double triangles_bytes(const peri_cholesky *f) {
    return 2 * (4.0 * (double)f->s->values + (double)f->s->bytes_rows) + 128.0 * f->s->n;
}

/* Down: member, alone and g of a row 17, end and sum of an aggregate 16; up: part, inverse, alone, g and p of a row 33,
   sum of an aggregate 12. */
static double transfer_bytes(const matrix_scene *l) {
    return 44.0 * l->levels->n + 16.0 * l->levels->up[l->levels->n] + 28.0 * l->levels->parts;
}

/* A number of the vectors: two copies and two dots 4 * 8; each pair of the memory, both ways: one vector read and
   written, one read, and, but for the last, a dot with the next. */
static double lbfgs_bytes(const matrix_scene *l) {
    return 3.0 * l->a.n * (32 + 2 * (12.0 * l->memory.used + 4.0 * (l->memory.used - 1)));
}

/* ---- table ---- */

typedef struct row {
    const char *name, *why;     /* what stops it where memory does not */
    double bytes, ms, spread, cached;   /* cached: GB/s of the small one */
    int particles;
} row;

static row table[64];
static int rows;

static void measured(int large, const char *name, const char *why, double bytes, loop_function *loop, void *context,
                     int particles) {
    row *r = &table[rows];
    double spread, ms;
    if (large) triad_sample();
    ms = measure(loop, context, &spread);
    if (!large) {
        table[rows].cached = 1e-6 * bytes / ms;
        return;
    }
    triad_sample();
    r->name = name;
    r->why = why;
    r->bytes = bytes;
    r->ms = ms;
    r->spread = spread;
    r->particles = particles;
    rows++;
}

static int measure_bonds(int large) {
    static const char *const name[3][2][2] = {
        {{"stretch B1, lockstep: local", "stretch B1, lockstep: force"},
         {"stretch B1, lattice: local", "stretch B1, lattice: force"}},
        {{"correspondence, lockstep: local", "correspondence, lockstep: force"},
         {"correspondence, lattice: local", "correspondence, lattice: force"}},
        {{"projective, lockstep: local", "projective, lockstep: force"},
         {"projective, lattice: local", "projective, lattice: force"}}};
    static const char *const gathers[3][2] = {
        {"gathers: 3 numbers a bond one by one", "gathers: 5 numbers a bond one by one"},
        {"gathers: 3 numbers a bond and 6 sums a bond", "gathers: 10 numbers a bond one by one"},
        {"gathers: 3 numbers a bond and 9 sums a bond", "gathers: 14 numbers a bond one by one; two roots"}};
    static const char *const lattice[3][2] = {
        {"arithmetic: a root and two divisions a bond", "arithmetic: a root and a division a bond"},
        {"arithmetic: 7 sums a bond and the law between", "loads from cache: 10 unaligned numbers a bond"},
        {"arithmetic: 9 sums a bond", "arithmetic: three roots a bond; loads of 14 numbers"}};
    int m, layout, pass;
    for (m = 0; m < 3; m++)
        for (layout = LOCKSTEP; layout < LAYOUTS; layout++) {
            peri_material material = m == 0   ? peri_material_linear(1e5f, 0.3f, 1000)
                                     : m == 1 ? peri_material_neo_hookean(1e5f, 0.3f, 1000)
                                              : peri_material_projective(1e5f, 0.5f, 1000);
            for (pass = 0; pass < 2; pass++) {
                int size;
                for (size = 0; size < 2; size++) {
                    bond_loop l;
                    memset(&l, 0, sizeof l);
                    l.kind = 2 * pass;
                    if (!bonds_make(&l.s, size ? large : SMALL, 1.75, &material, layout)) return 0;
                    measured(size, name[m][layout - LOCKSTEP][pass],
                             layout == LOCKSTEP ? gathers[m][pass] : lattice[m][pass], bond_bytes(&l), bond_run, &l,
                             l.s.b->count);
                    bonds_unmake(&l.s);
                }
            }
        }
    return 1;
}

/* Each loop on the small block, then on the large one. */
static int measure_matrix(int large) {
    matrix_scene l[2];
    int k;
    if (!matrix_make(&l[0], SMALL, PERI_SOLVER_CHOLESKY) || !matrix_make(&l[1], large, PERI_SOLVER_TWO_LEVEL)) return 0;
    for (k = 0; k < 2; k++)
        measured(k, "matrix times three vectors", "gathers of x and sums in double", multiply_bytes(&l[k]),
                 multiply_run, &l[k], l[k].a.n);
    for (k = 0; k < 2; k++)
        measured(k, "Chebyshev, 12 sweeps", "gathers of the step and sums in double", chebyshev_bytes(&l[k]),
                 chebyshev_run, &l[k], l[k].a.n);
    for (k = 0; k < 2; k++)
        measured(k, "L-BFGS, 5 steps remembered", "sums in double", lbfgs_bytes(&l[k]),
                 lbfgs_run, &l[k], l[k].a.n);
    matrix_unmake(&l[0]);
    if (!matrix_make(&l[0], SMALL, PERI_SOLVER_TWO_LEVEL)) return 0;
    for (k = 0; k < 2; k++)
        measured(k, "two levels: down and up", "rows of a node one by one by their lists",
                 transfer_bytes(&l[k]), transfer_run, &l[k], l[k].a.n);
    for (k = 0; k < 2; k++)
        measured(k, "two levels: the whole of it", "the factor of the nodes",
                 transfer_bytes(&l[k]) + triangles_bytes(l[k].levels->factor) - 24.0 * l[k].levels->parts, levels_run,
                 &l[k], l[k].a.n);
    matrix_unmake(&l[0]);
    matrix_unmake(&l[1]);
    return 1;
}

static int measure_triangles(int large) {
    matrix_scene l[2];
    int k;
    if (!matrix_make(&l[0], SMALL, PERI_SOLVER_CHOLESKY) || !matrix_make(&l[1], large, PERI_SOLVER_CHOLESKY)) return 0;
    for (k = 0; k < 2; k++)
        measured(k, "triangular solves of Cholesky", "panels one after another each with its list of rows",
                 triangles_bytes(l[k].factor), triangles_run, &l[k], l[k].a.n);
    matrix_unmake(&l[0]);
    matrix_unmake(&l[1]);
    return 1;
}

/* What stops a loop, from what was measured. */
static void verdict(const row *r, double rate, double of_triad, char text[200]) {
    double faster = r->cached / rate;
    if (of_triad >= 1.1) snprintf(text, 200, "the last cache's bandwidth: its arrays fit there");
    else if (of_triad >= 0.7) snprintf(text, 200, "memory's bandwidth");
    else if (faster >= 1.3 && of_triad >= 0.25) snprintf(text, 200, "memory in part; %s", r->why);
    else snprintf(text, 200, "%s", r->why);
}

static void print(FILE *csv) {
    double spread, best = bench_median(triad.rate, triad.count, &spread);
    int k;
    printf("STREAM triad, one thread: %.1f GB/s (median of %d, spread %.0f %%)\n", best, triad.count, 100 * spread);
    printf("%-33s %9s %7s %8s %7s %6s %9s %10s  %s\n", "", "particles", "MB", "ms", "spread", "GB/s", "of triad",
           "from cache", "what stops it");
    for (k = 0; k < rows; k++) {
        const row *r = &table[k];
        double rate = 1e-6 * r->bytes / r->ms;
        char text[200];
        verdict(r, rate, rate / best, text);
        printf("%-33s %9d %7.1f %8.3f %5.0f %% %6.1f %7.0f %% %10.2f  %s\n", r->name, r->particles, 1e-6 * r->bytes,
               r->ms, 100 * r->spread, rate, 100 * rate / best, r->cached / rate, text);
        if (csv)
            fprintf(csv, "\"%s\",%d,%g,%g,%g,%g,%g,%g,\"%s\"\n", r->name, r->particles, r->bytes, r->ms, r->spread,
                    rate, rate / best, r->cached / rate, text);
    }
}

int main(int argc, char **argv) {
    int full = bench_full(argc, argv), large = full ? 80 : 46;
    FILE *csv = bench_csv(argc, argv, "loop,particles,bytes,ms,spread,gb_per_s,of_triad,from_cache,what_stops_it");
    triad_begin();
    if (!measure_bonds(large) || !measure_matrix(large) || !measure_triangles(full ? 46 : 29))
        return printf("no memory for the blocks\n"), 1;
    print(csv);
    free(triad.a);
    if (csv) fclose(csv);
    return 0;
}
