/* tests/bench/accuracy.c - speed against accuracy: what a simulated second costs, and how wrong it is, on six scenes
   (accuracy/scene.h), for every model, solver, tolerance, step, integrator, precision and number of particles.

       make bench BENCH=accuracy CFLAGS="-O3 -march=native" && make charts

   Processor time: SIZE=quick 3 minutes; SIZE=full 23, and the pile.

   Errors are rms over the moments of a scene, relative to the rms motion (or force):
     error_solver     positions of all particles, to the converged solution of the same particles, model, step and
                      integrator: double, Cholesky, tolerance 1e-10
     error_step       what is seen of the scene, to the same particles and model with time and solver converged
                      (double, BDF2, 1/480 s, drop 1/960 s, tolerance 1e-6): what solver, step and integrator leave
     error_continuum  what is seen, to the continuum: finite elements (FEniCS, quadratic tetrahedra, neo-Hookean) for
                      swing, stretch and twist; an explicit code of bricks (accuracy/reference.c) for drop and pile. For
                      fall there are none: a fine run of the correspondence model stands for it, which leaves that
                      model's own bias unseen
     error            the larger of these two (of fine lattices, whose error_step is too dear, the second): a step
                      that damps as much as a lattice is too soft, say, is not right
   Not every factor is varied with every other (that would be 10^5 runs). Slices, each about the base (BDF2, 1/60 s, the
   pulled and turned beams 1/30 s, float, Cholesky under L-BFGS at 1e-3):
     solvers      model x solver x L-BFGS x tolerance, at the base's particles, step and integrator
     precision    model x float, double x tolerance
     steps        model x step x integrator
     resolution   model x particles across x (tolerance, step, integrator), two levels
   ms: processor time of the steps over the time simulated, one thread, median of 3 runs (spread: their range over the
   median; 0 for runs of more than 3 s, quick: 0.3 s, made once); matrices and factors of the first step, paid once in a
   body's life, are not counted. A step ends at 200 iterations, the library's default: `capped` is the share of such
   steps. Runs too slow for the time at hand are left out, and counted.

   A run is on a front when no other is faster and at most as wrong: `all` by error of all runs of the scene, `model` of
   those of its model, `solver` by error_solver among the runs of the slice `solvers`. From them follow the last tables:
   what reaches an error soonest.

   On the swing the methods of tests/baseline stand beside peri (accuracy/baseline.c), with 2 to 8 cells across (quick:
   2 and 4) and steps of 1/30 to 1/240 s, their error_step being to the last; the ratio of times at equal error is
   printed. So do Bullet's soft bodies (accuracy/bullet.cpp) where it is installed (apt-get install libbullet-dev), on
   drop and pile, too, with steps down to 1/1920 s (quick: 1/960, 1/480), as they need them there. Runs that fall
   through the ground or burst are listed as lost.

   Prints tables; writes all runs as CSV to the file named as the first argument. Second argument: quick or full. More
   arguments: names of scenes, only these. Run it from the top of the checkout: the figure is read from examples/models.
   Ends with 1 when Cholesky and two levels do not converge to the same solution. */
#include "../../examples/studio.h"

#include "accuracy/scene.h"
#include "bench.h"

enum { MOST = 4000, REPEATS = 3, TARGETS = 5 };
enum { FRONT_ALL = 1, FRONT_MODEL = 2, FRONT_SOLVER = 4 };

static const char *const scene_name[SCENES] = {"swing", "stretch", "twist", "fall", "drop", "pile"};
static const char *const model_name[MODELS] = {"correspondence", "stretch B1/B1", "stretch A1/A1", "projective"};
static const char *const solver_name[SOLVERS] = {"Cholesky", "two levels", "Jacobi", "Chebyshev", "position-based"};
static const double target[TARGETS] = {0.2, 0.1, 0.05, 0.02, 0.01};
static const double exact = 1e-10;

/* Lists of other methods: their rows carry the method's name for a model. */
static const rival *const rivals[] = {
    bench_baselines,
#ifdef BENCH_BULLET
    bench_bullet,
#endif
};
enum { RIVALS = sizeof rivals / sizeof *rivals };

typedef struct row {
    setup s;
    const rival *by;        /* NULL: peri */
    int wide;               /* 1: double */
    double ms, spread;      /* a simulated second; share of the median */
    double solver, step, continuum, error;  /* below 0: there is none */
    double iterations, capped;      /* a step; share of the steps */
    int lost, sliced, front;        /* sliced: 1 for runs of the slice of solvers */
} row;

/* A converged solution that is kept. */
typedef struct solution {
    setup s;
    course c;
} solution;

typedef struct bench {
    int full, wanted[SCENES];
    studio_mesh studio;
    mesh figure;
    double fall[MOMENTS][SEEN];     /* the fine run */
    double fine_off;        /* how far the fine run of the fall is from the next coarser one */
    row rows[MOST];
    solution solutions[MOST];
    int count, kept, lost;
} bench;

static const double duration[SCENES] = {0.5, 1, 1, 0.4, 7.0 / 30, 1};
static const int moments_of[SCENES] = {15, 10, 10, 12, 7, 15};

double scene_duration(int scene) { return duration[scene]; }
int scene_moments(int scene) { return moments_of[scene]; }

int scene_cubes(int scene) { return scene == PILE ? CUBES : 1; }
double scene_side(int scene, int cube) { return scene == PILE ? 0.24 - 0.04 * cube : 0.2; }
double scene_speed(int scene) { return scene == PILE ? 0 : 2; }
double scene_friction(int scene) { return scene == DROP ? 0 : 0.5; }

double scene_height(int scene, int cube) {
    double floor = scene == PILE ? 0.02 : 0.05;
    while (cube-- > 0) floor += scene_side(scene, cube) + 0.02;
    return floor;
}

/* The others are pulled and turned, and inertia has no part in them. */
static int moving(int scene) { return scene != STRETCH && scene != TWIST; }
static int cubic(int scene) { return scene == DROP || scene == PILE; }

/* ---- the continuum --------------------------------------------------------------------------------------------- */

/* Finite elements (FEniCS), quadratic tetrahedra, neo-Hookean mu/2 (I1 - 3) - mu log J + lambda/2 log^2 J, nu 1/4.
   swing: Newmark's average acceleration at 1/480 s, half model, 4 boxes over the height: 0.05 % from 6 boxes over the
   first 0.2 s, 0.5 % from 2 boxes at the end; 1/240 s is 0.02 % off.
   stretch: nominal Pa at stretches 1.05 to 1.5, quarter model, 3 boxes over the half height.
   twist: at rest at 18, 36, ... 180 degrees, 6 boxes over the side; 4 boxes are 0.4 % off.
   drop, pile: accuracy/reference.c. Drop: 16 bricks over the side; 12 are 2.0 % off, a bed 2.5 times as soft with twice
   the step 1.4 %. Pile: 12 bricks; 8 are 5.1 % off, since after the second landing each bounce decides the next. */
static const double swing_reference[15][SEEN] = {
    {-0.0000001, -0.0054499}, {-0.0000991, -0.0217752}, {-0.0011106, -0.0603351}, {-0.0058275, -0.1189191},
    {-0.0174575, -0.1882599}, {-0.0362457, -0.2591570}, {-0.0574137, -0.3251376}, {-0.0841595, -0.3937308},
    {-0.1184915, -0.4606051}, {-0.1624554, -0.5212787}, {-0.2034211, -0.5684403}, {-0.2333000, -0.6027930},
    {-0.2486891, -0.6237264}, {-0.2516939, -0.6304971}, {-0.2488564, -0.6265484}};
static const double stretch_reference[10] = {4869.6868, 9427.7221, 13719.073, 17780.727, 21643.35,
                                             25332.554, 28869.879, 32273.55,  35559.084, 38739.764};
static const double twist_reference[10] = {
    2.848744, 5.697606, 8.54662, 11.39565, 14.24434, 17.09203, 19.93773, 22.78011, 25.6175, 28.44786};
static const double drop_reference[7][SEEN] = {
    {-0.065751, -0.022393}, {-0.042107, 0.005732}, {0.007801, -0.014022}, {0.046809, -0.008446},
    {0.074917, 0.015399},   {0.092126, 0.010398},  {0.098434, -0.009335}};
static const double pile_reference[15][SEEN] = {
    {-0.021730, -0.021800}, {-0.046993, -0.087042}, {-0.041219, -0.071978}, {-0.020371, -0.036566},
    {-0.031844, -0.043066}, {-0.044274, -0.082471}, {-0.039782, -0.071511}, {-0.029681, -0.050286},
    {-0.039479, -0.062790}, {-0.044824, -0.081624}, {-0.032637, -0.062776}, {-0.037732, -0.057516},
    {-0.041137, -0.080373}, {-0.036758, -0.066379}, {-0.037246, -0.060730}};

/* Errors below this say nothing: how far the references themselves can be wrong. */
static double trusted(const bench *b, int scene) {
    return scene == FALL ? b->fine_off : scene == DROP ? 0.02 : scene == PILE ? 0.051 : 0.005;
}

static double reference(const bench *b, int scene, int moment, int c) {
    if (scene == SWING) return swing_reference[moment][c];
    if (scene == FALL) return b->fall[moment][c];
    if (scene == DROP) return drop_reference[moment][c];
    if (scene == PILE) return pile_reference[moment][c];
    if (c) return 0;
    return scene == STRETCH ? stretch_reference[moment] : twist_reference[moment];
}

/* rms distance of what c saw from what `to` saw, or from the continuum (NULL), over the rms of that. */
static double seen_error(const bench *b, int scene, const course *c, const course *to) {
    double off = 0, all = 0;
    int k, q;
    for (k = 0; k < scene_moments(scene); k++)
        for (q = 0; q < SEEN; q++) {
            double r = to ? to->seen[k][q] : reference(b, scene, k, q);
            off += (c->seen[k][q] - r) * (c->seen[k][q] - r);
            all += r * r;
        }
    return sqrt(off / all);
}

/* ---- runs ------------------------------------------------------------------------------------------------------ */

static int run(const bench *b, const setup *s, int wide, const rival *by, course *c) {
    if (by) return by->run(by, s, c);
    return (wide ? bench_accuracy_double : bench_accuracy_float)(s, &b->figure, c);
}

/* The pile's is not 6: on that lattice its steps of 1/60 s have two solutions, between which roundings choose. */
static int base_across(const bench *b, int scene) {
    static const int quick[SCENES] = {4, 4, 4, 16, 6, 5}, full[SCENES] = {5, 5, 5, 20, 8, 8};
    return (b->full ? full : quick)[scene];
}

static setup base(const bench *b, int scene, int model) {
    setup s;
    memset(&s, 0, sizeof s);
    s.scene = scene;
    s.model = model;
    s.solver = CHOLESKY;
    s.lbfgs = 1;
    s.tolerance = 1e-3;
    s.step = moving(scene) ? 1.0 / 60 : 1.0 / 30;
    s.across = base_across(b, scene);
    s.bdf2 = 1;
    s.max_iterations = 200;
    s.patience = b->full ? cubic(scene) ? 10000 : 20000 : cubic(scene) ? 4000 : 1000;
    return s;
}

static int same(const setup *a, const setup *b) {
    return a->scene == b->scene && a->model == b->model && a->solver == b->solver && a->lbfgs == b->lbfgs &&
           a->across == b->across && a->bdf2 == b->bdf2 && fabs(a->tolerance / b->tolerance - 1) < 1e-6 &&
           fabs(a->step / b->step - 1) < 1e-6;
}

/* The run of `want` in double, made once; NULL when it was lost. */
static const course *kept(bench *b, setup want) {
    solution *it = b->solutions;
    want.max_iterations = 5000;
    want.patience = 1e9;
    while (it < b->solutions + b->kept && !same(&it->s, &want)) it++;
    if (it < b->solutions + b->kept) return it->c.lost ? NULL : &it->c;
    if (b->kept++ == MOST) exit(2);
    it->s = want;
    if (!run(b, &want, 1, NULL, &it->c) || it->c.capped)
        printf("    %s of %s, %d across at 1/%.0f s to %g %s\n", scene_name[want.scene], model_name[want.model],
               want.across, 1 / want.step, want.tolerance, it->c.lost ? "was lost" : "met the cap of 5000 iterations");
    return it->c.lost ? NULL : &it->c;
}

/* The converged solution of what s discretises. */
static const course *converged(bench *b, const setup *s) {
    setup want = *s;
    want.solver = CHOLESKY;
    want.lbfgs = 1;
    want.tolerance = exact;
    return kept(b, want);
}

/* The same particles with time converged, too; NULL where that is too dear. */
static const course *timeless(bench *b, const setup *s) {
    setup want = *s;
    if (s->across > (s->scene == FALL ? 20 : b->full ? 8 : 6)) return NULL;
    if (s->scene == PILE && !b->full && s->across != base_across(b, PILE)) return NULL;
    want.solver = TWO_LEVEL;
    want.lbfgs = 1;
    want.tolerance = 1e-6;
    want.step = s->scene == DROP || (s->scene == PILE && b->full) ? 1.0 / 960 : moving(s->scene) ? 1.0 / 480 : 1.0 / 60;
    want.bdf2 = 1;
    return kept(b, want);
}

/* rms distance over the moments over the rms motion of `to`. */
static double distance(const course *c, const course *to, int moments) {
    double off = 0, all = 0;
    size_t n = 3 * (size_t)c->count, k;
    if (!to) return -1;
    for (k = 0; k < n * (size_t)moments; k++) {
        double away = to->x[k] - to->start[k % n];
        off += (c->x[k] - to->x[k]) * (c->x[k] - to->x[k]);
        all += away * away;
    }
    return sqrt(off / all);
}

static row *find(bench *b, const setup *s, int wide) {
    int k;
    for (k = 0; k < b->count; k++)
        if (!b->rows[k].by && b->rows[k].wide == wide && same(&b->rows[k].s, s)) return &b->rows[k];
    return NULL;
}

static row *append(bench *b, const setup *s, int wide, const rival *by) {
    row *r = &b->rows[b->count++];
    if (b->count > MOST) exit(2);
    memset(r, 0, sizeof *r);
    r->s = *s;
    r->wide = wide;
    r->by = by;
    r->solver = r->step = r->continuum = r->error = -1;
    return r;
}

/* Makes the runs of a row; c is the last one's. */
static void repeat(const bench *b, row *r, course *c) {
    double ms[REPEATS];
    int k;
    for (k = 0; k < REPEATS && !r->lost && (!k || c->ms < (b->full ? 3000 : 300)); k++) {
        if (k) free(c->x);
        r->lost = !run(b, &r->s, r->wide, r->by, c);
        ms[k] = c->ms / scene_duration(r->s.scene);
    }
    if (r->lost) return;
    r->ms = bench_median(ms, k, &r->spread);
    r->iterations = (double)c->iterations / c->steps;
    r->capped = (double)c->capped / c->steps;
    r->continuum = r->error = seen_error(b, r->s.scene, c, NULL);
}

/* The row of s, made unless it is there; with its error to the converged solution when that is wanted. */
static row *measure(bench *b, const setup *s, int wide, int solver) {
    row *r = find(b, s, wide);
    const course *fine;
    course c;
    if (r && (r->lost || !solver || r->solver >= 0)) return r;
    if (!r) r = append(b, s, wide, NULL);
    repeat(b, r, &c);
    fine = r->lost ? NULL : timeless(b, s);
    if (fine) r->step = seen_error(b, s->scene, &c, fine);
    if (r->step > r->error) r->error = r->step;
    if (!r->lost && solver) r->solver = distance(&c, converged(b, s), scene_moments(s->scene));
    b->lost += r->lost;
    free(c.x);
    return r;
}

/* Is the converged solution one? Another solver must come to the same. */
static int confirmed(bench *b, int scene) {
    setup s = base(b, scene, CORRESPONDENCE);
    const course *c = converged(b, &s);
    course other;
    double off;
    s.solver = TWO_LEVEL;
    s.tolerance = exact;
    s.max_iterations = 5000;
    s.patience = 1e9;
    off = run(b, &s, 1, NULL, &other) ? distance(&other, c, scene_moments(scene)) : -1;
    free(other.x);
    printf("%s: converged by Cholesky and by two levels: %.1e apart, wanted below 1e-6: %s\n", scene_name[scene], off,
           off >= 0 && off < 1e-6 ? "reached" : "MISSED");
    return off >= 0 && off < 1e-6;
}

/* ---- slices ---------------------------------------------------------------------------------------------------- */

static const double tolerances[5] = {1e-1, 1e-2, 1e-3, 1e-4, 1e-5};

/* The slow ways only where they show most. */
static int worth(const bench *b, const setup *s) {
    int direct = s->solver <= TWO_LEVEL, middle = s->tolerance > 5e-4 && s->tolerance < 5e-2;
    if (b->full) return (s->lbfgs && direct) || (s->lbfgs && s->tolerance > 5e-5 && s->tolerance < 5e-2) || middle;
    if (s->model == LINEAR || s->model == PAPERS) return s->lbfgs && direct && middle;
    if (s->lbfgs && direct) return s->tolerance > 5e-5 && s->tolerance < 5e-2;
    if (!s->lbfgs) return s->scene == SWING && middle && s->tolerance < 5e-3;
    return middle && (s->scene == SWING || s->tolerance < 5e-3);
}

static void slice_solvers(bench *b, int scene) {
    int model, solver, lbfgs, k;
    for (model = 0; model < MODELS; model++)
        for (solver = 0; solver < SOLVERS; solver++)
            for (lbfgs = 1; lbfgs >= 0; lbfgs--)
                for (k = 0; k < 5; k++) {
                    setup s = base(b, scene, model);
                    s.solver = solver;
                    s.lbfgs = lbfgs;
                    s.tolerance = tolerances[k];
                    if (worth(b, &s)) measure(b, &s, 0, 1)->sliced = 1;
                }
}

static void slice_precision(bench *b, int scene) {
    static const double to[3] = {1e-3, 1e-5, 1e-7};
    int model, wide, k;
    for (model = 0; model < MODELS; model++)
        for (wide = 0; wide < 2; wide++)
            for (k = 0; k < 3; k++) {
                setup s = base(b, scene, model);
                s.tolerance = to[k];
                if (b->full || (model == CORRESPONDENCE && scene != PILE)) measure(b, &s, wide, 1)->sliced = 1;
            }
}

static void slice_steps(bench *b, int scene) {
    static const int per_second[5] = {30, 60, 120, 240, 480};
    int model, bdf2, k;
    for (model = 0; model < MODELS; model++)
        for (bdf2 = 0; bdf2 < 2; bdf2++)
            for (k = 0; k < (b->full ? 4 : 3) + cubic(scene); k++) {
                setup s = base(b, scene, model);
                s.bdf2 = bdf2;
                s.step = 1.0 / per_second[k];
                if (scene >= FALL && !b->full && model != CORRESPONDENCE && model != PROJECTIVE) continue;
                if (moving(scene) || bdf2) measure(b, &s, 0, b->full);
            }
}

/* Tolerance, steps a second, BDF2. The scenes that are pulled and turned take half as many steps, as in their base;
   cubes bounce in 1/15 s, so theirs are shorter. */
typedef struct recipe {
    double tolerance;
    int per_second, bdf2;
} recipe;
static const recipe recipes[2][7] = {{{1e-2, 30, 1}, {1e-2, 60, 1}, {1e-3, 60, 1}, {1e-3, 120, 1},
                                      {1e-2, 60, 0}, {1e-1, 30, 1}, {1e-3, 240, 1}},
                                     {{1e-2, 60, 1}, {1e-2, 240, 1}, {1e-3, 960, 1}, {1e-2, 480, 1},
                                      {1e-2, 960, 1}, {1e-2, 120, 1}, {1e-3, 1920, 1}}};
static int across(int scene, int k) {
    static const int beam[6] = {3, 4, 6, 8, 12, 16}, figure[6] = {12, 16, 20, 24, 28, 32};
    return scene == FALL ? figure[k] : beam[k];
}

static void slice_resolution(bench *b, int scene) {
    int model, a, k;
    for (model = 0; model < MODELS; model++)
        for (a = 0; a < (b->full ? 6 : 4); a++)
            for (k = 0; k < (b->full ? 7 : scene == PILE ? 2 : 3); k++) {
                const recipe *how = &recipes[cubic(scene)][k];
                setup s = base(b, scene, model);
                s.solver = TWO_LEVEL;
                s.across = across(scene, a);
                s.tolerance = how->tolerance;
                s.step = 1.0 / (moving(scene) || how->per_second == 30 ? how->per_second : how->per_second / 2);
                s.bdf2 = how->bdf2;
                if (a >= (b->full ? 4 : 3) && k != 2) continue;
                if (a == 5 && !moving(scene)) continue;
                measure(b, &s, 0, 0);
            }
}

/* One other method with so many cells across, the shortest step first: what it sees stands for time converged. */
static void ask_rival(bench *b, const rival *by, int cells) {
    static const int per_second[7] = {1920, 960, 480, 240, 120, 60, 30};
    course c, finest;
    int first = !cubic(by->scene) ? 3 : b->full ? 0 : by->scene == PILE ? 2 : 1, k, good = 0;
    for (k = first; k < 7; k++) {
        setup s = base(b, by->scene, MODELS);
        row *r;
        s.across = cells;
        s.bdf2 = 0;
        s.step = 1.0 / per_second[k];
        s.tolerance = k > first ? 1e-2 : 1e-4;
        r = append(b, &s, 1, by);
        repeat(b, r, &c);
        b->lost += r->lost;
        if (!r->lost && good) r->step = seen_error(b, by->scene, &c, &finest);
        if (r->step > r->error) r->error = r->step;
        free(c.x);
        if (!r->lost && !good) finest = c, good = 1;
    }
}

static void slice_rivals(bench *b, int scene) {
    static const int cells[4] = {2, 4, 6, 8};
    const rival *by;
    int i, a;
    for (i = 0; i < RIVALS; i++)
        for (by = rivals[i]; by->name; by++)
            for (a = 0; a < (b->full ? 4 : 2) && by->scene == scene; a++) ask_rival(b, by, cells[a]);
}

/* ---- fronts ---------------------------------------------------------------------------------------------------- */

/* Marks the rows that no other beats: `of` says which rows count (below 0: this one does not). */
static void mark(bench *b, int scene, int front, double (*of)(const row *r, int model), int model) {
    int i, k;
    for (i = 0; i < b->count; i++) {
        row *r = &b->rows[i];
        double error = of(r, model);
        int beaten = r->s.scene != scene || r->lost || error < 0;
        for (k = 0; k < b->count && !beaten; k++) {
            const row *other = &b->rows[k];
            double its = of(other, model);
            beaten = other != r && other->s.scene == scene && !other->lost && its >= 0 && its <= error &&
                     other->ms <= r->ms && (its < error || other->ms < r->ms || k < i);
        }
        if (!beaten) r->front |= front;
    }
}

/* model -1: every row, other methods' too; -2: peri's. */
static double by_error(const row *r, int model) {
    return model == -1 || (model == -2 && !r->by) || r->s.model == model ? r->error : -1;
}

static double by_solver(const row *r, int model) { return (void)model, r->sliced ? r->solver : -1; }

static void mark_all(bench *b) {
    int scene, model;
    for (scene = 0; scene < SCENES; scene++) {
        mark(b, scene, FRONT_ALL, by_error, -1);
        mark(b, scene, FRONT_SOLVER, by_solver, -1);
        for (model = 0; model < MODELS; model++) mark(b, scene, FRONT_MODEL, by_error, model);
    }
}

/* The fastest run whose error is at most `most`. */
static const row *soonest(const bench *b, int scene, double (*of)(const row *r, int model), int model, double most) {
    const row *best = NULL;
    int k;
    for (k = 0; k < b->count; k++) {
        const row *r = &b->rows[k];
        double error = of(r, model);
        if (r->s.scene != scene || r->lost || error < 0 || error > most) continue;
        if (!best || r->ms < best->ms) best = r;
    }
    return best;
}

/* ---- tables ---------------------------------------------------------------------------------------------------- */

static void write_error(FILE *csv, double error) {
    if (error < 0) fprintf(csv, ",");
    else fprintf(csv, ",%.5g", error);
}

static const char *name_of(const row *r) { return r->by ? r->by->name : model_name[r->s.model]; }

static void write_row(FILE *csv, const row *r) {
    static const char *const fronts[8] = {"", "all", "model", "all+model", "solver", "all+solver", "model+solver",
                                          "all+model+solver"};
    const char *lbfgs = r->by ? "" : r->s.lbfgs ? "on" : "off";
    if (r->lost) return;
    fprintf(csv, "%s,\"%s\",%s,%s,%g,%.8g,%d,%s,%s,%.5g,%.3g", scene_name[r->s.scene], name_of(r),
            r->by ? "" : solver_name[r->s.solver], lbfgs, r->s.tolerance, r->s.step, r->s.across,
            r->s.bdf2 ? "BDF2" : "backward Euler", r->wide ? "double" : "float", r->ms, r->spread);
    write_error(csv, r->solver);
    write_error(csv, r->step);
    write_error(csv, r->continuum);
    write_error(csv, r->error);
    fprintf(csv, ",%s,%.1f,%.3g\n", fronts[r->front], r->iterations, r->capped);
}

static int by_scene_and_time(const void *a, const void *b) {
    const row *x = (const row *)a, *y = (const row *)b;
    return x->s.scene != y->s.scene ? x->s.scene - y->s.scene : (x->ms > y->ms) - (x->ms < y->ms);
}

static void describe(char *text, size_t size, const row *r) {
    if (r->by) snprintf(text, size, "%d across, 1/%.0f s, %.0e", r->s.across, 1 / r->s.step, r->s.tolerance);
    else
        snprintf(text, size, "%d across, 1/%.0f s, %s, %s%s, %.0e, %s", r->s.across, 1 / r->s.step,
                 r->s.bdf2 ? "BDF2" : "backward Euler", solver_name[r->s.solver],
                 r->s.lbfgs ? "" : " without L-BFGS", r->s.tolerance, r->wide ? "double" : "float");
}

/* ms and error of one run in a table. */
static void cell(const row *r, double error) {
    if (!r || r->lost || error < 0) printf("  %18s", "-");
    else printf("  %8.1f %7.2g%%%s", r->ms, 100 * error, r->capped > 0 ? "*" : " ");
}

static void head(const char *what) {
    int model;
    printf("\n%-34s", what);
    for (model = 0; model < MODELS; model++) printf("  %18s", model_name[model]);
    printf("\n");
}

static void table_solvers(bench *b, int scene) {
    int solver, lbfgs, model, k, any;
    head("solvers: ms, error_solver");
    for (k = 1; k < 3; k++)
        for (solver = 0; solver < SOLVERS; solver++)
            for (lbfgs = 1; lbfgs >= 0; lbfgs--) {
                const row *r[MODELS];
                for (any = model = 0; model < MODELS; model++) {
                    setup s = base(b, scene, model);
                    s.solver = solver;
                    s.lbfgs = lbfgs;
                    s.tolerance = tolerances[k];
                    r[model] = find(b, &s, 0);
                    any |= r[model] != NULL;
                }
                if (!any) continue;
                printf("  %.0e %-15s %-11s", tolerances[k], solver_name[solver], lbfgs ? "L-BFGS" : "without");
                for (model = 0; model < MODELS; model++) cell(r[model], r[model] ? r[model]->solver : -1);
                printf("\n");
            }
}

static void table_precision(bench *b, int scene) {
    static const double to[3] = {1e-3, 1e-5, 1e-7};
    int k, wide, model;
    printf("\n%-34s\n", "precision: ms, error_solver in 1e-6");
    for (k = 0; k < 3; k++)
        for (wide = 0; wide < 2; wide++) {
            printf("  %.0e %-26s ", to[k], wide ? "double" : "float");
            for (model = 0; model < MODELS; model++) {
                setup s = base(b, scene, model);
                const row *r;
                s.tolerance = to[k];
                r = find(b, &s, wide);
                if (r && !r->lost) printf("  %8.1f %8.2f%s", r->ms, 1e6 * r->solver, r->capped > 0 ? "*" : " ");
                else printf("  %18s", "-");
            }
            printf("\n");
        }
}

static void table_steps(bench *b, int scene) {
    int bdf2, model, k;
    if (!moving(scene)) return;
    head("steps: ms, error_step");
    for (bdf2 = 0; bdf2 < 2; bdf2++)
        for (k = 30; k <= (b->full ? 240 : 120) << cubic(scene); k *= 2) {
            printf("  1/%-3d s, %-23s", k, bdf2 ? "BDF2" : "backward Euler");
            for (model = 0; model < MODELS; model++) {
                setup s = base(b, scene, model);
                const row *r;
                s.bdf2 = bdf2;
                s.step = 1.0 / k;
                r = find(b, &s, 0);
                cell(r, r ? r->step : -1);
            }
            printf("\n");
        }
}

static void table_resolution(bench *b, int scene) {
    char title[40] = "particles: ms, error_continuum";
    int a, model, fine = scene == PILE && !b->full ? 240 : 960;
    if (cubic(scene)) snprintf(title, sizeof title, "particles, 1/%d s: ms, continuum", fine);
    head(title);
    for (a = 0; a < 6; a++) {
        printf("  %2d across                       ", across(scene, a));
        for (model = 0; model < MODELS; model++) {
            setup s = base(b, scene, model);
            const row *r;
            s.solver = TWO_LEVEL;
            s.across = across(scene, a);
            if (scene == PILE && !b->full) s.tolerance = 1e-2;
            if (cubic(scene)) s.step = 1.0 / fine;
            r = find(b, &s, 0);
            cell(r, r ? r->continuum : -1);
        }
        printf("\n");
    }
}

static void table_front(const bench *b, int scene) {
    double above = -1, shown = 1e30;
    int k;
    printf("\nfront: what is fastest for each error\n");
    for (;;) {
        const row *next = NULL;
        char text[160];
        for (k = 0; k < b->count; k++) {
            const row *r = &b->rows[k];
            if (r->s.scene == scene && r->front & FRONT_ALL && r->ms > above && (!next || r->ms < next->ms))
                next = r;
        }
        if (!next) break;
        above = next->ms;
        if (next->error > 0.98 * shown) continue;   /* not worth a line */
        shown = next->error;
        describe(text, sizeof text, next);
        printf("  %8.2f ms +- %2.0f %%  %7.3f %%  %-15s %s\n", next->ms, 50 * next->spread, 100 * next->error,
               name_of(next), text);
    }
}

/* For the README: ms of the fastest run within each error, per model; the fastest of all in bold. Nothing is said below
   what a scene's reference is good for. */
static void table_models(const bench *b) {
    int scene, model, k;
    printf("\nWhich model do I take: ms a simulated second of the fastest run within an error\n\n");
    printf("| scene | model |");
    for (k = 0; k < TARGETS; k++) printf(" %g %% |", 100 * target[k]);
    printf(" best error |\n|---|---|");
    for (k = 0; k <= TARGETS; k++) printf("---|");
    printf("\n");
    for (scene = 0; scene < SCENES; scene++)
        for (model = 0; model < MODELS && b->wanted[scene]; model++) {
            double least = 1e30;
            printf("| %s | %s |", model ? "" : scene_name[scene], model_name[model]);
            for (k = 0; k < TARGETS; k++) {
                const row *r = soonest(b, scene, by_error, model, target[k]);
                const row *best = soonest(b, scene, by_error, -2, target[k]);
                if (!r || target[k] < trusted(b, scene)) printf(" - |");
                else printf(r == best ? " **%.3g** |" : " %.3g |", r->ms);
            }
            for (k = 0; k < b->count; k++)
                if (b->rows[k].s.scene == scene && b->rows[k].s.model == model && b->rows[k].error >= 0 &&
                    b->rows[k].error < least)
                    least = b->rows[k].error;
            printf(" %.2g %% |\n", 100 * least);
        }
}

/* At each error that another method reaches soonest: its time over that of peri's fastest run of no larger error. */
static void table_rival(const bench *b, const rival *by) {
    double least = 1e30;
    int k, cells, any, per_second = !cubic(by->scene) ? 30 : b->full ? 1920 : 480;
    printf("\n%s: its error and ms, peri's ms at no larger error, ratio\n", by->name);
    for (k = 0; k < b->count; k++) {    /* rows are sorted by time */
        const row *r = &b->rows[k], *ours = soonest(b, by->scene, by_error, -2, r->error);
        char text[160];
        if (r->by != by || r->lost || r->error >= least) continue;
        least = r->error;
        describe(text, sizeof text, r);
        if (!ours) printf("  %7.3f %%  %9.2f  %9s  %6s  %s\n", 100 * least, r->ms, "-", "-", text);
        else printf("  %7.3f %%  %9.2f  %9.2f  %6.2f  %s\n", 100 * least, r->ms, ours->ms, r->ms / ours->ms, text);
    }
    if (least > 1e29) printf("  no run is left\n");
    /* an error that grows under refinement was small by luck */
    printf("  to finite elements under refinement, 1/%d s:", per_second);
    for (cells = 2; cells <= 8; cells += 2)
        for (k = 0; k < b->count; k++) {
            const row *r = &b->rows[k];
            if (r->by == by && !r->lost && r->s.across == cells && fabs(per_second * r->s.step - 1) < 1e-6)
                printf("  %d across %.1f %%", cells, 100 * r->continuum);
        }
    for (cells = 2, any = 0; cells <= 8; cells += 2)
        for (k = 0; k < b->count; k++) {
            const row *r = &b->rows[k];
            if (r->by != by || !r->lost || r->s.across != cells) continue;
            printf("%s %d across 1/%.0f s", any++ ? "," : "\n  lost:", cells, 1 / r->s.step);
        }
    printf("\n");
}

static void table_rivals(const bench *b, int scene) {
    const rival *by;
    int i;
    for (i = 0; i < RIVALS; i++)
        for (by = rivals[i]; by->name; by++)
            if (by->scene == scene) table_rival(b, by);
}

/* Of every solver and model: how much longer than the fastest it takes to 1 % of error_solver. */
static void table_choice(const bench *b) {
    int scene, solver, lbfgs, model, k;
    printf("\nWhich solver: time to an error_solver of 1 %%, over that of the fastest (base's particles and step)\n\n");
    printf("| solver |");
    for (scene = 0; scene < SCENES; scene++)
        if (b->wanted[scene]) printf(" %s, correspondence | %s, projective |", scene_name[scene], scene_name[scene]);
    printf("\n|---|");
    for (scene = 0; scene < SCENES; scene++)
        if (b->wanted[scene]) printf("---|---|");
    printf("\n");
    for (solver = 0; solver < SOLVERS; solver++)
        for (lbfgs = 1; lbfgs >= 0; lbfgs--) {
            printf("| %s%s |", solver_name[solver], lbfgs ? "" : " without L-BFGS");
            for (scene = 0; scene < SCENES; scene++)
                for (model = CORRESPONDENCE; model < MODELS && b->wanted[scene]; model += PROJECTIVE) {
                    double best = 1e30, own = 1e30;
                    for (k = 0; k < b->count; k++) {
                        const row *r = &b->rows[k];
                        if (r->lost || r->s.scene != scene || r->s.model != model || !r->sliced || r->wide) continue;
                        if (r->solver < 0 || r->solver > 0.01) continue;
                        if (r->ms < best) best = r->ms;
                        if (r->s.solver == solver && r->s.lbfgs == lbfgs && r->ms < own) own = r->ms;
                    }
                    if (own < 1e29) printf(" %.1f |", own / best);
                    else printf(" - |");
                }
            printf("\n");
        }
}

/* ---- main ------------------------------------------------------------------------------------------------------- */

static void load(bench *b) {
    static const float centre[3] = {0, 0, 0.5f};
    float low[3], high[3];
    int k;
    if (studio_mesh_load("examples/models/figure.obj", &b->studio)) exit(2);
    studio_mesh_fit(&b->studio, centre, 1);
    studio_bounds(b->studio.v, b->studio.vertices, low, high);
    for (k = 0; k < b->studio.vertices; k++) b->studio.v[3 * k + 2] -= low[2];
    b->figure.vertices = b->studio.v;
    b->figure.vertex_count = b->studio.vertices;
    b->figure.triangles = b->studio.t;
    b->figure.triangle_count = b->studio.triangles;
}

/* The fine run of the fall; how far the next coarser one is off says how far it can be trusted. */
static void fall_reference(bench *b) {
    setup s = base(b, FALL, CORRESPONDENCE);
    course c, coarse;
    s.solver = TWO_LEVEL;
    s.step = 1.0 / 240;
    s.tolerance = 1e-4;
    s.patience = 1e9;
    s.across = b->full ? 40 : 32;
    if (!run(b, &s, 1, NULL, &c)) exit(2);
    memcpy(b->fall, c.seen, sizeof b->fall);
    s.across = s.across * 3 / 4;
    if (!run(b, &s, 1, NULL, &coarse)) exit(2);
    b->fine_off = seen_error(b, FALL, &coarse, NULL);
    printf("fall: the fine run has %d particles; one of %d is %.1f %% off it\n", c.count, coarse.count,
           100 * b->fine_off);
    free(c.x);
    free(coarse.x);
}

int main(int argc, char **argv) {
    static bench b;
    FILE *csv = bench_csv(argc, argv, "scene,model,solver,lbfgs,tolerance,step_s,across,integrator,precision,"
                                      "ms_per_simulated_s,spread,error_solver,error_step,error_continuum,error,pareto,"
                                      "iterations,capped");
    int scene, k, good = 1;
    b.full = bench_full(argc, argv);
    load(&b);
    for (scene = 0; scene < SCENES; scene++)
        for (b.wanted[scene] = argc < 4, k = 3; k < argc; k++)
            if (strcmp(argv[k], scene_name[scene]) == 0) b.wanted[scene] = 1;
    for (scene = 0; scene < SCENES; scene++) {
        double start = bench_cpu();
        int before = b.count;
        if (!b.wanted[scene]) continue;
        if (scene == FALL) fall_reference(&b);
        good &= confirmed(&b, scene);
        slice_solvers(&b, scene);
        slice_precision(&b, scene);
        slice_steps(&b, scene);
        slice_resolution(&b, scene);
        slice_rivals(&b, scene);
#ifndef BENCH_BULLET
        if (scene == SWING || cubic(scene)) printf("no Bullet beside it: apt-get install libbullet-dev\n");
#endif
        printf("%s: %d different runs, %.0f s of processor time\n", scene_name[scene], b.count - before,
               1e-3 * (bench_cpu() - start));
        fflush(stdout);
    }
    printf("%d runs were given up; * marks runs in which steps met the cap of 200 iterations\n", b.lost);
    mark_all(&b);
    qsort(b.rows, (size_t)b.count, sizeof *b.rows, by_scene_and_time);  /* for lines in charts */
    for (k = 0; k < b.count && csv; k++) write_row(csv, &b.rows[k]);
    for (scene = 0; scene < SCENES; scene++) {
        if (!b.wanted[scene]) continue;
        printf("\n==== %s: %d across, 1/%.0f s, BDF2, float, where nothing else is said; ms a simulated second ====\n",
               scene_name[scene], base_across(&b, scene), 1 / base(&b, scene, 0).step);
        table_solvers(&b, scene);
        table_precision(&b, scene);
        table_steps(&b, scene);
        table_resolution(&b, scene);
        table_front(&b, scene);
        table_rivals(&b, scene);
    }
    table_choice(&b);
    table_models(&b);
    if (csv) fclose(csv);
    return good ? 0 : 1;
}
