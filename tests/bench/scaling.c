/* tests/bench/scaling.c - cost against size: blocks of 1 k to 64 k particles (`full`: to 1 M), 26 neighbours,
   correspondence model, and for every phase the exponent e of a fit time ~ particles^e: creation with its neighbours,
   the local step (forces; lattice and lockstep), a Chebyshev sweep, the coarse transfer of the two-level
   preconditioner; wanted of these is at most 1.1. Beside them what factors cost, which grows faster by nature: two
   levels applied and made, and (up to 64 k particles) Cholesky's solve and factor. And bytes a particle.

   Then each phase with two threads over one, 64 k particles: a pool of our own behind peri_parallel, so that the hook
   is what is measured. The first row is a loop of arithmetic alone: what the machine gives, on which others may run as
   well. The least times are taken, with one and two threads turn by turn; the ratio of medians stands beside.

   Sizes: processor time of one thread, medians (small sizes fit caches, which bends the fit upwards). Threads: wall
   clock. Prints tables, writes CSV to the file named as the first argument. */
#define _POSIX_C_SOURCE 200809L
#define PERI_IMPLEMENTATION
#include "../../peri.h"
#include "bench.h"
#include "bonds.h"

#if defined(__linux__) && defined(__GLIBC__)
#if __GLIBC_PREREQ(2, 34)   /* pthreads without -pthread */
#define POOL
#include <pthread.h>
#include <sched.h>
#endif
#endif

enum { CREATE, LATTICE_STEP, LOCKSTEP_STEP, SWEEP, TRANSFER, WANTED, LEVELS = WANTED, LEVELS_FACTOR, SOLVE, FACTOR,
       ARITHMETIC, PHASES };
enum { SIZES = 6, CHOLESKY_MOST = 70000, RUNS = 41 };

static const char *const phase_name[PHASES] = {
    "creation and neighbours", "local step; lattice", "local step; lockstep", "Chebyshev sweep",
    "two levels: transfer", "two levels: apply", "two levels: factor", "Cholesky: solve", "Cholesky: factor",
    "arithmetic alone"};

/* Everything that is timed, on one block. */
typedef struct block {
    int side;
    bonds_scene lattice, lockstep;
    matrix_scene levels, cholesky;
    double bytes[3];        /* a particle: world on a lattice, in lockstep; two levels */
    double cholesky_bytes;
    const peri_parallel *parallel;
} block;

static int make(block *b, int side, int cholesky) {
    peri_material m = peri_material_neo_hookean(1e5f, 0.3f, 1000);
    double n = pow(side, 3);
    memset(b, 0, sizeof *b);
    b->side = side;
    if (!bonds_make(&b->lattice, side, 1.75, &m, LATTICE) || !bonds_make(&b->lockstep, side, 1.75, &m, LOCKSTEP) ||
        !matrix_make(&b->levels, side, PERI_SOLVER_TWO_LEVEL) ||
        (cholesky && !matrix_make(&b->cholesky, side, PERI_SOLVER_CHOLESKY)))
        return 0;
    b->bytes[0] = (double)peri_world_stats(b->lattice.w).bytes / n;
    b->bytes[1] = (double)peri_world_stats(b->lockstep.w).bytes / n;
    b->bytes[2] = (double)peri_two_level_bytes(b->levels.levels) / n;
    if (cholesky) b->cholesky_bytes = (double)peri_cholesky_bytes(b->cholesky.factor) / n;
    return 1;
}

static void unmake(block *b) {
    bonds_unmake(&b->lattice);
    bonds_unmake(&b->lockstep);
    matrix_unmake(&b->levels);
    if (b->cholesky.s.w) matrix_unmake(&b->cholesky);
}

static volatile double kept[64];

/* Takes about as long as a local step, and nothing but a core. */
static void arithmetic(int begin, int end, void *context) {
    double x = 1;
    int i, k;
    (void)context;
    for (i = begin; i < end; i++)
        for (k = 0; k < 40; k++) x = 1 / (1 + x);
    kept[begin / PERI__GRAIN % 64] = x;
}

/* One run of a phase other than creation; 0 when there is none. */
static int phase(block *b, int which) {
    matrix_scene *l = &b->levels, *f = &b->cholesky;
    switch (which) {
    case LATTICE_STEP: return bonds_pass(&b->lattice, 4), 1;
    case LOCKSTEP_STEP: return bonds_pass(&b->lockstep, 4), 1;
    case SWEEP: return peri_chebyshev3(&l->a, b->parallel, BENCH_SWEEPS, 0.1, 2, l->x, l->y, l->work), 1;
    case LEVELS: return levels_run(l), 1;
    case TRANSFER: return transfer_run(l), 1;
    case LEVELS_FACTOR: return peri_two_level_factor(l->levels, &l->a, NULL) == PERI_OK;
    case SOLVE: return f->factor ? triangles_run(f), 1 : 0;
    case FACTOR: return f->factor && peri_cholesky_factor(f->factor, &f->a, NULL) == PERI_OK;
    case ARITHMETIC: return peri_parallel_for(b->parallel, 64 * PERI__GRAIN, PERI__GRAIN, arithmetic, NULL), 1;
    default: return 0;
    }
}

/* What a run counts for: one of the sweeps. */
static double share(int which) { return which == SWEEP ? 1.0 / BENCH_SWEEPS : 1; }

/* Median ms of a phase, processor time, over batches of a millisecond and more; of creation what peri_body_create
   itself takes. */
static double median(block *b, int which) {
    double time[15], start, all = bench_thread();
    int k, r, repeats = 1;
    if (which != CREATE && !phase(b, which)) return 0;
    start = bench_thread();
    if (which != CREATE) phase(b, which), repeats = (int)(1 / (bench_thread() - start + 1e-4)) + 1;
    for (k = 0; k < 15 && (k < 3 || bench_thread() - all < 2000); k++) {
        start = bench_thread();
        if (which == CREATE) {
            peri_material m = peri_material_neo_hookean(1e5f, 0.3f, 1000);
            bonds_scene again;
            if (!bonds_make(&again, b->side, 1.75, &m, LATTICE)) return 0;
            time[k] = again.create;
            bonds_unmake(&again);
        } else {
            for (r = 0; r < repeats; r++) phase(b, which);
            time[k] = (bench_thread() - start) / repeats;
        }
    }
    return bench_median(time, k, NULL) * share(which);
}

/* Exponent and constant of time = constant n^exponent, least squares in logarithms over what was measured. */
static double exponent(const double *n, const double *time, int count) {
    double s = 0, sx = 0, sy = 0, sxx = 0, sxy = 0;
    int k;
    for (k = 0; k < count; k++) {
        double x = log(n[k]), y;
        if (!(time[k] > 0)) continue;
        y = log(time[k]);
        s += 1, sx += x, sy += y, sxx += x * x, sxy += x * y;
    }
    return s > 1 ? (s * sxy - sx * sy) / (s * sxx - sx * sx) : 0;
}

static int sizes(FILE *csv, int full) {
    static const int side[SIZES] = {10, 16, 25, 40, 64, 100};
    int count = full ? SIZES : SIZES - 2, k, p, missed = 0;
    double n[SIZES], time[PHASES][SIZES], bytes[SIZES][4];
    for (k = 0; k < count; k++) {
        block b;
        n[k] = pow(side[k], 3);
        if (!make(&b, side[k], n[k] <= CHOLESKY_MOST)) return printf("no room for %g particles\n", n[k]), 1;
        for (p = 0; p < ARITHMETIC; p++) time[p][k] = median(&b, p);
        for (p = 0; p < 3; p++) bytes[k][p] = b.bytes[p];
        bytes[k][3] = b.cholesky_bytes;
        unmake(&b);
    }
    printf("us a particle (Chebyshev: one sweep of 12)\n%-24s", "particles");
    for (k = 0; k < count; k++) printf(" %9.0f", n[k]);
    printf("  exponent\n");
    for (p = 0; p < ARITHMETIC; p++) {
        double e = exponent(n, time[p], count);
        int wanted = p < WANTED, good = e <= 1.1;
        missed += wanted && !good;
        printf("%-24s", phase_name[p]);
        for (k = 0; k < count; k++)
            if (time[p][k] > 0) printf(" %9.4f", 1e3 * time[p][k] / n[k]);
            else printf(" %9s", "-");
        printf("  %8.2f%s\n", e, !wanted ? "" : good ? ", at most 1.10: reached" : ", at most 1.10: MISSED");
        for (k = 0; k < count && csv; k++)
            if (time[p][k] > 0)
                fprintf(csv, "size,\"%s\",%.0f,%g,%g,%g\n", phase_name[p], n[k], time[p][k],
                        1e3 * time[p][k] / n[k], e);
    }
    for (p = 0; p < 4; p++) {
        static const char *const name[4] = {"bytes: world; lattice", "bytes: world; lockstep", "bytes: two levels",
                                            "bytes: Cholesky"};
        printf("%-24s", name[p]);
        for (k = 0; k < count; k++) {
            if (bytes[k][p] > 0) printf(" %9.0f", bytes[k][p]);
            else printf(" %9s", "-");
            if (csv && bytes[k][p] > 0) fprintf(csv, "bytes,\"%s\",%.0f,,%g,\n", name[p], n[k], bytes[k][p]);
        }
        printf("\n");
    }
    return missed;
}

/* ---- threads ---- */
#ifdef POOL

/* A second thread that waits for pieces of loops, spinning, and for the end. */
static struct {
    pthread_t thread;
    peri_task *task;
    void *context;
    int count, piece, next, round, done, quit;
} pool;

static void pool_work(void) {
    int at;
    while ((at = __atomic_fetch_add(&pool.next, pool.piece, __ATOMIC_RELAXED)) < pool.count)
        pool.task(at, at + pool.piece < pool.count ? at + pool.piece : pool.count, pool.context);
}

static void *pool_wait(void *unused) {
    int round = 0;
    (void)unused;
    for (;;) {
        while (__atomic_load_n(&pool.round, __ATOMIC_ACQUIRE) == round) sched_yield();
        if (pool.quit) return NULL;
        round++;
        pool_work();
        __atomic_store_n(&pool.done, round, __ATOMIC_RELEASE);
    }
}

/* The hook: eight pieces a thread, each taken by who comes first. */
static void pool_run(int count, int grain, peri_task *task, void *context, void *user) {
    int pieces = (count - 1) / grain / 16 + 1;
    (void)user;
    if (count <= grain) {
        task(0, count, context);
        return;
    }
    pool.task = task;
    pool.context = context;
    pool.count = count;
    pool.piece = pieces * grain;
    pool.next = 0;
    __atomic_store_n(&pool.round, pool.round + 1, __ATOMIC_RELEASE);
    pool_work();
    while (__atomic_load_n(&pool.done, __ATOMIC_ACQUIRE) != pool.round) sched_yield();
}

static double wall(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return 1e3 * (double)t.tv_sec + 1e-6 * (double)t.tv_nsec;
}

static void thread_count(block *b, peri_parallel *par, int threads) {
    memset(par, 0, sizeof *par);
    par->threads = 1;
    if (threads == 2) par->run = pool_run;
    b->parallel = par;
    b->lattice.w->def.parallel = *par;
    b->lockstep.w->def.parallel = *par;
    peri_two_level_threads(b->levels.levels, par);
    peri_cholesky_threads(b->cholesky.factor, par);
}

/* Turn by turn with one thread and with two, so that what disturbs disturbs both. */
static void threads(FILE *csv, int side) {
    block b;
    peri_parallel par;
    int q, k, t;
    if (!make(&b, side, 1)) return;
    if (pthread_create(&pool.thread, NULL, pool_wait, NULL)) return;
    printf("\n%d particles, wall clock%31s %9s %18s %18s\n", side * side * side, "ms", "two", "speed-up (least)",
           "of the medians");
    for (q = 0; q < PHASES; q++) {
        double time[2][RUNS], fewest[2] = {1e30, 1e30}, middle[2];
        int p = (q + ARITHMETIC) % PHASES, runs = p == FACTOR ? 7 : RUNS;
        if (p == TRANSFER || p == CREATE) continue;     /* a part of another; without threads */
        for (k = 0; k < runs; k++)
            for (t = 0; t < 2; t++) {
                double start;
                int r, repeats = p == FACTOR || p == SOLVE ? 1 : 3;
                thread_count(&b, &par, t + 1);
                start = wall();
                for (r = 0; r < repeats; r++) phase(&b, p);
                time[t][k] = (wall() - start) / repeats * share(p);
                if (time[t][k] < fewest[t]) fewest[t] = time[t][k];
            }
        for (t = 0; t < 2; t++) middle[t] = bench_median(time[t], runs, NULL);
        printf("%-40s %14.3f %9.3f %18.2f %18.2f\n", phase_name[p], fewest[0], fewest[1], fewest[0] / fewest[1],
               middle[0] / middle[1]);
        if (csv)
            fprintf(csv, "threads,\"%s\",%d,%g,%g,%g\n", phase_name[p], side * side * side, fewest[0], fewest[1],
                    fewest[0] / fewest[1]);
    }
    pool.quit = 1;
    __atomic_store_n(&pool.round, pool.round + 1, __ATOMIC_RELEASE);
    pthread_join(pool.thread, NULL);
    unmake(&b);
}

#else
static void threads(FILE *csv, int side) {
    (void)csv;
    (void)side;
    printf("threads: no pthreads in this C library, so not measured\n");
}
#endif

int main(int argc, char **argv) {
    int full = bench_full(argc, argv), missed;
    FILE *csv = bench_csv(argc, argv, "what,phase,particles,ms,value,exponent_or_speedup");
    missed = sizes(csv, full);
    printf("%d targets missed\n", missed);
    threads(csv, 40);
    if (csv) fclose(csv);
    return 0;
}
