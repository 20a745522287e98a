/* tests/bench/accuracy/baseline.c - the methods of tests/baseline on the swing, beside peri: tetrahedra, springs, a
   least-squares gradient, position-based dynamics. All are in double and implicit Euler, small and honest, but not
   tuned as peri's loops are: of a small factor the tuning may be the reason. */
#define PERI_STATIC
#define PERI_IMPLEMENTATION
#include "../../../peri_solver.h"
#include "../../baseline/baseline.h"
#include "../bench.h"
#include "scene.h"

enum { LAYERS = 2 };    /* particles held beyond the clamp plane; nodes of tetrahedra are on it */

typedef struct stage {
    baseline *b;
    int across;
    double spacing, from, to;   /* the clamp plane and the end, in the block's coordinates */
} stage;

/* In order of `kind`: what the rivals below are. A textbook's corotated step is one linear solve. */
static const struct {
    baseline_method method;
    int plain, max_iterations, substeps;
} kinds[] = {
    {BASELINE_COROTATED, 0, 200, 1}, {BASELINE_COROTATED, 1, 1, 1}, {BASELINE_STVK, 0, 200, 1},
    {BASELINE_SPRINGS, 0, 200, 1},   {BASELINE_MLS, 0, 200, 1},     {BASELINE_XPBD, 0, 1, 20},
};

static int begin(stage *t, const rival *by, const setup *s) {
    int elements = kinds[by->kind].method == BASELINE_STVK || kinds[by->kind].method == BASELINE_COROTATED, k;
    baseline_def def;
    memset(&def, 0, sizeof def);
    t->across = s->across;
    t->spacing = 0.2 / s->across;
    t->from = elements ? 0 : LAYERS * t->spacing;
    t->to = t->from + 1;
    def.method = kinds[by->kind].method;
    def.plain = kinds[by->kind].plain;
    def.substeps = kinds[by->kind].substeps;
    def.max_iterations = kinds[by->kind].max_iterations;
    def.size[0] = t->to;
    def.size[1] = def.size[2] = 0.2;
    def.spacing = t->spacing;
    def.young = 1e6;
    def.poisson = 0.25;
    def.density = 1000;
    def.gravity[2] = -9.81;
    def.tolerance = s->tolerance;
    t->b = baseline_create(&def);
    for (k = 0; t->b && k < t->b->count; k++) t->b->fixed[k] = t->b->rest[3 * k] < t->from + 1e-9;
    return t->b != NULL;
}

/* Mean displacement of the layer at x, weighed by the share of the face that each of its points has. */
static void layer(const stage *t, double x, double u[SEEN]) {
    const baseline *b = t->b;
    double all = 0;
    int k;
    u[0] = u[1] = 0;
    for (k = 0; k < b->count; k++) {
        const double *rest = b->rest + 3 * k;
        int edges = (rest[1] < 1e-9) + (rest[1] > 0.2 - 1e-9) + (rest[2] < 1e-9) + (rest[2] > 0.2 - 1e-9);
        double share = edges == 2 ? 0.25 : edges ? 0.5 : 1;
        if (fabs(rest[0] - x) > 1e-6) continue;
        u[0] += share * (b->x[3 * k] - rest[0]);
        u[1] += share * (b->x[3 * k + 2] - rest[2]);
        all += share;
    }
    u[0] /= all;
    u[1] /= all;
}

/* Nodes are on the end face; particles' last layer is carried half a spacing on by the slope, as peri's is. */
static void see(const stage *t, double seen[SEEN]) {
    double before[SEEN];
    int c;
    if (t->from > 0) {
        layer(t, t->to - 0.5 * t->spacing, seen);
        layer(t, t->to - 1.5 * t->spacing, before);
        for (c = 0; c < SEEN; c++) seen[c] += (seen[c] - before[c]) / 2;
    } else layer(t, t->to, seen);
}

static int swing(const rival *by, const setup *s, course *out) {
    int moments = scene_moments(s->scene), moment, k;
    int per_moment = (int)(scene_duration(s->scene) / moments / s->step + 0.5);
    stage t;
    memset(out, 0, sizeof *out);
    out->lost = !begin(&t, by, s);
    for (moment = 0; moment < moments && !out->lost; moment++) {
        for (k = 0; k < per_moment && !out->lost; k++) {
            double start = bench_cpu();
            int result = baseline_step(t.b, s->step);
            out->ms += bench_cpu() - start;
            out->iterations += t.b->iterations;
            out->steps++;
            out->capped += result > 0;
            out->lost = result < 0 || out->ms > s->patience;
        }
        if (!out->lost) see(&t, out->seen[moment]);
    }
    baseline_destroy(t.b);
    return !out->lost;
}

const rival bench_baselines[] = {
    {"corotated tetrahedra", SWING, 0, swing},
    {"corotated, one linear step", SWING, 1, swing},
    {"StVK tetrahedra", SWING, 2, swing},
    {"mass-spring", SWING, 3, swing},
    {"least-squares gradient", SWING, 4, swing},
    {"XPBD, 20 substeps", SWING, 5, swing},
    {NULL, 0, 0, NULL},
};
