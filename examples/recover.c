/* recover - bodies put out of shape find back, whatever was done to them.
 *
 * Answers PP figures 3 and 4 (PP = "Projective Peridynamics for Modeling Versatile Elastoplastic Materials", He, Wang,
 * Wu 2017).  All particles of a body are flattened to a plane, to a line or into one point (exactly: no noise is
 * added), mirrored, or dealt out at random over each other's places.  Without gravity the library brings each back to
 * its shape.  Two usual methods do the same exercise beside it:
 *
 *   mass-spring     the same bonds as springs, backward Euler.  It knows lengths only: a plane stays a plane, a mirror
 *                   image is as good as the original, a point has no direction to leave in.
 *   shape matching  Mueller, Heidelberger, Teschner, Gross 2005, rotation only.  It always comes back, but there is no
 *                   material in it: a stretched bar does not become thinner.
 *
 * "misfit" is the rms distance of the particles to the best rigid fit of the rest shape, in particle spacings.
 *
 *   cc -O2 examples/recover.c -lm -o recover && ./recover         table, recover.png, recover.gif in build/out/recover
 *   ./recover --model projective --solver chebyshev               another material and solver
 *   ./recover --check                                             numbers only
 */
#include "studio.h"

#define PERI_IMPLEMENTATION
#include "../peri.h"
#include "studio_peri.h"

enum { PERIDYNAMICS, SPRINGS, MATCHING, METHODS };
enum { PLANE, LINE, POINT, MIRRORED, SHUFFLED, STARTS };

static const char *const method_name[METHODS] = {"peridynamics", "mass-spring", "shape matching"};
static const char *const start_name[STARTS] = {"plane", "line", "point", "mirrored", "shuffled"};
static const char *const all_models[] = {"neo_hookean", "linear", "projective", "papers",
                                         "stvk",        "stvk_exact", "stable"};

static const double young = 1e6, poisson = 0.25, density = 1000;
static const double recovered = 0.05; /* misfit, spacings */

static const studio_app app = {"recover",
                               "Bodies flattened, mirrored or shuffled find back to their shape (PP figures 3, 4);\n"
                               "mass-spring and shape matching do the same exercise.\n"
                               "models: neo_hookean linear projective papers stvk stvk_exact stable all\n"
                               "solvers: auto cholesky two-level jacobi chebyshev position\n",
                               NULL, 60};

/* ------------------------------------------------------------------------------------------------ shapes -------- */

typedef struct shape {
    int count;
    double spacing;
    peri_real *rest; /* 3 count */
} shape;

static int sample(shape *s, const peri_shape *solid, double spacing) {
    peri_error err;
    s->spacing = spacing;
    s->rest = NULL;
    if (peri_sample(solid, (peri_real)spacing, NULL, 0, &s->count, &err)) return studio_error("%s", err.text);
    s->rest = (peri_real *)studio_alloc(3 * (size_t)s->count, sizeof(peri_real));
    if (!s->rest) return -1;
    if (peri_sample(solid, (peri_real)spacing, s->rest, s->count, &s->count, &err))
        return studio_error("%s", err.text);
    return 0;
}

static int sample_box(shape *s, int nx, int ny, int nz, double spacing) {
    double half = spacing / 2;
    peri_shape box = peri_shape_box((peri_real)(nx * half), (peri_real)(ny * half), (peri_real)(nz * half));
    return sample(s, &box, spacing);
}

/* A closed triangle mesh, 1 m tall, filled with particles. */
static int sample_mesh(shape *s, const char *path, double spacing) {
    static const float origin[3] = {0, 0, 0};
    studio_mesh mesh;
    peri_shape solid;
    peri_real *vertices;
    int k, bad;
    memset(s, 0, sizeof *s);
    if (studio_mesh_load(path, &mesh)) return -1;
    studio_mesh_fit(&mesh, origin, 1);
    vertices = (peri_real *)studio_alloc(3 * (size_t)mesh.vertices, sizeof(peri_real));
    for (k = 0; vertices && k < 3 * mesh.vertices; k++) vertices[k] = (peri_real)mesh.v[k];
    solid = peri_shape_mesh(vertices, mesh.vertices, mesh.t, mesh.triangles);
    bad = vertices ? sample(s, &solid, spacing) : -1;
    free(vertices);
    studio_mesh_free(&mesh);
    return bad;
}

/* A whole number in 0 .. below - 1; the same sequence everywhere. */
static int draw_number(uint32_t *seed, int below) {
    *seed = *seed * 1664525u + 1013904223u;
    return (int)((uint64_t)*seed * (uint64_t)below >> 32);
}

/* The start: the rest shape with something terrible done to it. */
static void spoil(const shape *s, int start, peri_real *x) {
    uint32_t seed = 2017;
    int i, k, j;
    memcpy(x, s->rest, 3 * (size_t)s->count * sizeof *x);
    for (i = s->count - 1; i >= 0; i--) {
        if (start == PLANE) x[3 * i + 1] = 0;
        if (start == LINE) x[3 * i] = x[3 * i + 1] = 0;
        if (start == POINT) x[3 * i] = x[3 * i + 1] = x[3 * i + 2] = 0;
        if (start == MIRRORED) x[3 * i] = -x[3 * i];
        if (start != SHUFFLED) continue;
        j = draw_number(&seed, i + 1);
        for (k = 0; k < 3; k++) {
            peri_real t = x[3 * i + k];
            x[3 * i + k] = x[3 * j + k];
            x[3 * j + k] = t;
        }
    }
}

/* Best rigid fit of the particles member[0 .. count-1] (NULL: the first `count`): x ~ to + r (rest - from). */
static void rigid_fit(const peri_real *rest, const peri_real *x, const int *member, int count, double from[3],
                      double to[3], double r[9]) {
    double a[9] = {0};
    int i, j, k;
    for (k = 0; k < 3; k++) from[k] = to[k] = 0;
    for (i = 0; i < 3 * count; i++) {
        int at = member ? 3 * member[i / 3] + i % 3 : i;
        from[i % 3] += (double)rest[at] / count;
        to[i % 3] += (double)x[at] / count;
    }
    for (i = 0; i < count; i++) {
        const peri_real *p = x + 3 * (member ? member[i] : i), *q = rest + 3 * (member ? member[i] : i);
        for (j = 0; j < 3; j++)
            for (k = 0; k < 3; k++) a[3 * j + k] += ((double)p[j] - to[j]) * ((double)q[k] - from[k]);
    }
    peri_polar3(a, r);
}

/* Where a rest position goes under a rigid fit. */
static double fitted(const peri_real *rest, int k, const double from[3], const double to[3], const double r[9]) {
    return to[k] + r[3 * k] * ((double)rest[0] - from[0]) + r[3 * k + 1] * ((double)rest[1] - from[1]) +
           r[3 * k + 2] * ((double)rest[2] - from[2]);
}

/* Rms distance to the best rigid fit, in spacings; `each` (may be NULL) gets the distance of every particle. */
static double misfit(const shape *s, const peri_real *x, double *each) {
    double from[3], to[3], r[9], sum = 0;
    int i, k;
    rigid_fit(s->rest, x, NULL, s->count, from, to, r);
    for (i = 0; i < s->count; i++) {
        double square = 0;
        for (k = 0; k < 3; k++) {
            double away = (double)x[3 * i + k] - fitted(s->rest + 3 * i, k, from, to, r);
            square += away * away;
        }
        sum += square;
        if (each) each[i] = sqrt(square) / s->spacing;
    }
    return sqrt(sum / s->count) / s->spacing;
}

/* ------------------------------------------------------------------------------------------ three methods -------- */

typedef struct spring {
    int i, j;
    double length, stiffness;
    double n[3], along, across; /* present direction; stiffness along and across it */
} spring;

/* A body under one of the methods. */
typedef struct run {
    const shape *s;
    int method;
    double h;                 /* time step, s */
    unsigned char *held;      /* 1: the particle stays where it is */
    peri_real *x;             /* present positions, 3 count */
    double *v, *work;         /* springs, matching: velocities; 3 vectors of conjugate gradients */
    peri_world *world;
    peri_body_id body;
    spring *springs;
    size_t spring_count, spring_cap;
    int *cluster, *member;    /* matching: cluster c holds member[cluster[c]] .. member[cluster[c + 1] - 1] */
    int clusters;
} run;

static int begin_peridynamics(run *r, const studio_options *o, const char *model) {
    peri_world_def wd = peri_default_world_def();
    peri_body_def bd = peri_default_body_def();
    peri_material m;
    peri_error err;
    wd.gravity.z = 0;
    wd.parallel.threads = o->threads;
    if (studio_solver(o->solver, &wd.solver) || studio_material(model, young, poisson, density, &m)) return -1;
    r->world = peri_world_create(&wd, &err);
    if (!r->world) return studio_error("%s", err.text);
    bd.points = r->s->rest;
    bd.count = r->s->count;
    bd.spacing = (peri_real)r->s->spacing;
    bd.fixed = r->held;
    bd.material = peri_material_create(r->world, &m);
    r->body = peri_body_create(r->world, &bd);
    return r->body.index1 ? 0 : studio_failed(r->world);
}

static int step_peridynamics(run *r) {
    const peri_real *x;
    if (peri_world_step(r->world, (peri_real)r->h)) return studio_failed(r->world);
    x = peri_body_positions(r->world, r->body);
    memcpy(r->x, x, 3 * (size_t)r->s->count * sizeof *x);
    return 0;
}

static double distance(const peri_real *p, const peri_real *q) {
    double x = (double)p[0] - (double)q[0], y = (double)p[1] - (double)q[1], z = (double)p[2] - (double)q[2];
    return sqrt(x * x + y * y + z * z);
}

/* Springs between all particles within the library's default horizon, weighted as its bonds are: energy per volume
 * 3 E sum omega (tau - 1)^2 gives Young's modulus E; omega = (length / spacing)^-0.7 / 20.86 on a lattice. */
static int begin_springs(run *r) {
    double volume = r->s->spacing * r->s->spacing * r->s->spacing;
    int i, j;
    for (i = 0; i < r->s->count; i++)
        for (j = i + 1; j < r->s->count; j++) {
            double length = distance(r->s->rest + 3 * i, r->s->rest + 3 * j);
            spring *p;
            if (length > 1.75 * r->s->spacing) continue;
            if (studio_reserve(&r->springs, &r->spring_cap, r->spring_count + 1, sizeof *p)) return -1;
            p = r->springs + r->spring_count++;
            p->i = i;
            p->j = j;
            p->length = length;
            p->stiffness = 12 * young * volume / (length * length) * pow(length / r->s->spacing, -0.7) / 20.86;
        }
    return 0;
}

/* out += scale * (spring stiffness matrix) in */
static void springs_multiply(const run *r, double scale, const double *in, double *out) {
    size_t b;
    int k;
    for (b = 0; b < r->spring_count; b++) {
        const spring *p = r->springs + b;
        const double *u = in + 3 * p->i, *w = in + 3 * p->j;
        double along = 0, f;
        for (k = 0; k < 3; k++) along += p->n[k] * (w[k] - u[k]);
        for (k = 0; k < 3; k++) {
            f = scale * (p->across * (w[k] - u[k]) + (p->along - p->across) * along * p->n[k]);
            out[3 * p->i + k] -= f;
            out[3 * p->j + k] += f;
        }
    }
}

/* Directions, stiffnesses and forces at the present positions. */
static void springs_pull(run *r, double *force) {
    size_t b;
    int k;
    memset(force, 0, 3 * (size_t)r->s->count * sizeof *force);
    for (b = 0; b < r->spring_count; b++) {
        spring *p = r->springs + b;
        const peri_real *u = r->x + 3 * p->i, *w = r->x + 3 * p->j;
        double now = distance(u, w), part = now > 1e-12 ? 1 - p->length / now : 0;
        p->along = now > 1e-12 ? p->stiffness : 0;
        p->across = part > 0 ? part * p->stiffness : 0; /* compressed springs: kept positive, as usual */
        for (k = 0; k < 3; k++) {
            p->n[k] = now > 1e-12 ? ((double)w[k] - (double)u[k]) / now : 0;
            force[3 * p->i + k] += p->stiffness * (now - p->length) * p->n[k];
            force[3 * p->j + k] -= p->stiffness * (now - p->length) * p->n[k];
        }
    }
}

static double dot(const double *a, const double *b, int n) {
    double sum = 0;
    int i;
    for (i = 0; i < n; i++) sum += a[i] * b[i];
    return sum;
}

static void hold(const run *r, double *vector) {
    int i;
    for (i = 0; i < 3 * r->s->count; i++)
        if (r->held && r->held[i / 3]) vector[i] = 0;
}

/* One linearised step of backward Euler (Baraff, Witkin 1998): (m + h^2 K) dv = h (f - h K v), conjugate gradients. */
static int step_springs(run *r) {
    int n = 3 * r->s->count, i, turn;
    double *res = r->work, *p = res + n, *q = p + n, *dv = q + n, h = r->h, old, now, alpha, first;
    double mass = density * r->s->spacing * r->s->spacing * r->s->spacing;
    springs_pull(r, res);
    springs_multiply(r, -h, r->v, res);
    for (i = 0; i < n; i++) res[i] *= h;
    hold(r, res);
    memcpy(p, res, (size_t)n * sizeof *p);
    memset(dv, 0, (size_t)n * sizeof *dv);
    first = now = dot(res, res, n);
    for (turn = 0; turn < 400 && now > 1e-12 * first; turn++) {
        for (i = 0; i < n; i++) q[i] = mass * p[i];
        springs_multiply(r, h * h, p, q);
        hold(r, q);
        alpha = now / dot(p, q, n);
        for (i = 0; i < n; i++) {
            dv[i] += alpha * p[i];
            res[i] -= alpha * q[i];
        }
        old = now;
        now = dot(res, res, n);
        for (i = 0; i < n; i++) p[i] = res[i] + now / old * p[i];
    }
    for (i = 0; i < n; i++) {
        r->v[i] += dv[i];
        r->x[i] = (peri_real)((double)r->x[i] + h * r->v[i]);
    }
    return 0;
}

/* Clusters: the whole body as one, or every particle with its neighbours. */
static int begin_matching(run *r, int local) {
    int n = r->s->count, i, j, used = 0;
    r->clusters = local ? n : 1;
    r->cluster = (int *)studio_alloc((size_t)r->clusters + 1, sizeof(int));
    r->member = (int *)studio_alloc((size_t)(local ? 27 : 1) * (size_t)n, sizeof(int));
    if (!r->cluster || !r->member) return -1;
    for (i = 0; i < r->clusters; i++) {
        const peri_real *centre = r->s->rest + 3 * i;
        for (j = 0; j < n; j++)
            if (!local || distance(centre, r->s->rest + 3 * j) < 1.75 * r->s->spacing) r->member[used++] = j;
        r->cluster[i + 1] = used;
    }
    return 0;
}

/* Every cluster pulls its members to its rest shape, rotated and moved to fit; a particle follows the mean. */
static int step_matching(run *r) {
    int n = 3 * r->s->count, c, i, k;
    double *goal = r->work, *votes = goal + n, from[3], to[3], rotation[9], pull = 0.3;
    memset(goal, 0, 2 * (size_t)n * sizeof *goal);
    for (i = 0; i < n; i++)
        if (!(r->held && r->held[i / 3])) r->x[i] = (peri_real)((double)r->x[i] + r->h * r->v[i]);
    for (c = 0; c < r->clusters; c++) {
        const int *member = r->member + r->cluster[c];
        int count = r->cluster[c + 1] - r->cluster[c];
        rigid_fit(r->s->rest, r->x, member, count, from, to, rotation);
        for (i = 0; i < count; i++)
            for (k = 0; k < 3; k++) {
                goal[3 * member[i] + k] += fitted(r->s->rest + 3 * member[i], k, from, to, rotation);
                votes[3 * member[i] + k] += 1;
            }
    }
    for (i = 0; i < n; i++) {
        double to_goal = pull * (goal[i] / votes[i] - (double)r->x[i]);
        if (r->held && r->held[i / 3]) continue;
        r->x[i] = (peri_real)((double)r->x[i] + to_goal);
        r->v[i] = (1 - pull) * (r->v[i] + to_goal / r->h); /* some damping, so that it comes to rest */
    }
    return 0;
}

static int run_begin(run *r, const shape *s, int method, double h, unsigned char *held, const studio_options *o,
                     const char *model) {
    size_t n = 3 * (size_t)s->count;
    memset(r, 0, sizeof *r);
    r->s = s;
    r->method = method;
    r->h = h;
    r->held = held;
    r->x = (peri_real *)studio_alloc(n, sizeof(peri_real));
    r->v = (double *)studio_alloc(n, sizeof(double));
    r->work = (double *)studio_alloc(4 * n, sizeof(double));
    if (!r->x || !r->v || !r->work) return -1;
    if (method == SPRINGS) return begin_springs(r);
    if (method == MATCHING) return begin_matching(r, held != NULL);
    return begin_peridynamics(r, o, model);
}

static int run_put(run *r, const peri_real *x) {
    memcpy(r->x, x, 3 * (size_t)r->s->count * sizeof *x);
    if (r->world && peri_body_set_positions(r->world, r->body, 0, r->s->count, x)) return studio_failed(r->world);
    return 0;
}

static int run_step(run *r) {
    if (r->method == SPRINGS) return step_springs(r);
    if (r->method == MATCHING) return step_matching(r);
    return step_peridynamics(r);
}

static void run_end(run *r) {
    peri_world_destroy(r->world);
    free(r->springs);
    free(r->cluster);
    free(r->member);
    free(r->x);
    free(r->v);
    free(r->work);
    memset(r, 0, sizeof *r);
}

/* ------------------------------------------------------------------------------------------- measurements -------- */

typedef struct outcome {
    int steps;     /* until the misfit was below `recovered`; -1: never */
    double misfit; /* at the end */
} outcome;

/* Spoils a shape and lets a method work until it is recovered, at most `limit` steps. */
static int recover(const shape *s, int method, int start, double h, int limit, const studio_options *o,
                   const char *model, outcome *out) {
    run r;
    peri_real *x = (peri_real *)studio_alloc(3 * (size_t)s->count, sizeof(peri_real));
    int bad = !x || run_begin(&r, s, method, h, NULL, o, model), step;
    out->steps = -1;
    out->misfit = HUGE_VAL;
    if (!bad) {
        spoil(s, start, x);
        bad = run_put(&r, x);
    }
    for (step = 1; !bad && step <= limit && out->steps < 0; step++) {
        bad = run_step(&r);
        out->misfit = misfit(s, r.x, NULL);
        if (!bad && out->misfit < recovered) out->steps = step;
    }
    if (x) run_end(&r);
    free(x);
    return bad;
}

/* Table of steps and misfits of one method or model; with --check every line is a check. */
static void tabulate(const shape *s, int method, const char *model, const studio_options *o) {
    static const double rates[] = {60, 30};
    int start, k;
    for (k = 0; k < 2; k++) {
        if (!o->check) printf("%-14s %-11s 1/%.0f s ", method_name[method], method ? "" : model, rates[k]);
        for (start = 0; start < STARTS; start++) {
            outcome out;
            char name[120];
            int failed = recover(s, method, start, 1 / rates[k], (int)(2.5 * rates[k]), o, model, &out);
            if (!o->check && out.steps > 0) printf("  %8d steps", out.steps);
            if (!o->check && out.steps < 0) printf("  %8.2f away ", out.misfit);
            if (!o->check) continue;
            snprintf(name, sizeof name, "%s%s%s, %s, step 1/%.0f s", method_name[method], method ? "" : " ",
                     method ? "" : model, start_name[start], rates[k]);
            if (method == SPRINGS) studio_check(name, out.misfit, "spacings left", 0.5, HUGE_VAL);
            else studio_check(name, failed || out.steps < 0 ? HUGE_VAL : out.steps, "steps", 1, 2.5 * rates[k]);
        }
        if (!o->check) printf("\n");
    }
}

/* Stretches a bar by 4 percent, lets it come to rest and measures (lateral contraction) / (stretch) in its middle. */
static int contraction(int method, const studio_options *o, const char *model, double *ratio) {
    const double strain = 0.04;
    double sums[4] = {0};
    shape s;
    run r;
    unsigned char *held;
    peri_real *x;
    int i, step, bad;
    if (sample_box(&s, 20, 6, 6, 0.05)) return -1;
    held = (unsigned char *)studio_alloc((size_t)s.count, 1);
    x = (peri_real *)studio_alloc(3 * (size_t)s.count, sizeof(peri_real));
    bad = !held || !x;
    for (i = 0; !bad && i < 3 * s.count; i++) {
        held[i / 3] = fabs((double)s.rest[3 * (i / 3)]) > 0.4; /* two layers at each end */
        x[i] = (peri_real)((double)s.rest[i] * (i % 3 == 0 ? 1 + strain : 1));
    }
    memset(&r, 0, sizeof r);
    bad = bad || run_begin(&r, &s, method, method == MATCHING ? 1.0 / 60 : 100, held, o, model) || run_put(&r, x);
    for (step = 0; !bad && step < (method == MATCHING ? 200 : 10); step++) bad = run_step(&r);
    for (i = 0; !bad && i < s.count; i++) {
        const peri_real *p = s.rest + 3 * i, *q = r.x + 3 * i;
        if (fabs((double)p[0]) > 0.2) continue;
        sums[0] += (double)p[0] * (double)p[0];
        sums[1] += (double)p[0] * (double)q[0];
        sums[2] += (double)p[1] * (double)p[1] + (double)p[2] * (double)p[2];
        sums[3] += (double)p[1] * (double)q[1] + (double)p[2] * (double)q[2];
    }
    *ratio = (1 - sums[3] / sums[2]) / (sums[1] / sums[0] - 1);
    run_end(&r);
    free(held);
    free(x);
    free(s.rest);
    return bad;
}

static void tabulate_contraction(const studio_options *o, const char *model) {
    static const double want[METHODS] = {0.25, 0.25, 0};
    double ratio;
    char name[80];
    int k;
    if (!o->check) printf("\nlateral contraction / stretch of a bar pulled by 4 %%, Poisson's ratio 0.25 asked for\n");
    for (k = 0; k < METHODS; k++) {
        int bad = contraction(k, o, model, &ratio);
        snprintf(name, sizeof name, "lateral contraction, %s", method_name[k]);
        if (o->check) studio_check(name, bad ? HUGE_VAL : ratio, "", want[k] - 0.02, want[k] + 0.02);
        else if (!bad) printf("  %-15s %6.3f\n", method_name[k], ratio);
    }
}

/* ----------------------------------------------------------------------------------------------- pictures -------- */

enum { SHOWN = 3, COLUMNS = 6, PANEL_W = 210, PANEL_H = 240, LEFT = 34, TOP = 30 };
static const int shown[SHOWN] = {PLANE, MIRRORED, SHUFFLED};
static const float ink[3] = {0.13f, 0.15f, 0.19f};
static const double colour_range = 8; /* spacings */

typedef struct gallery {
    run r[SHOWN][METHODS];
    studio_scene scene;
    studio_image panel;
    double *away;
} gallery;

/* Draws one body into the panel whose corner is (x, y). */
static void draw_panel(gallery *g, const run *r, studio_image *im, int x, int y) {
    float middle[3] = {0, 0, 0}, radius = 0.56f * (float)r->s->spacing, rgb[3], p[3];
    studio_camera camera;
    double best = misfit(r->s, r->x, g->away);
    char text[40];
    int i, k, row;
    studio_scene_clear(&g->scene);
    for (i = 0; i < r->s->count; i++) {
        for (k = 0; k < 3; k++) {
            p[k] = (float)r->x[3 * i + k];
            middle[k] += p[k] / (float)r->s->count;
        }
        studio_colormap((float)(1 - g->away[i] / colour_range), rgb);
        studio_scene_ball(&g->scene, p, radius, rgb);
    }
    studio_orbit(&camera, middle, 3.7f, 24, 12, 20);
    if (studio_render(&g->scene, &camera, &g->panel)) return;
    for (row = 0; row < g->panel.height; row++)
        memcpy(im->rgb + 3 * ((size_t)(y + row) * (size_t)im->width + (size_t)x),
               g->panel.rgb + 3 * (size_t)row * (size_t)g->panel.width, 3 * (size_t)g->panel.width);
    snprintf(text, sizeof text, best < 0.005 ? "0" : best < 1 ? "%.2f" : "%.1f", best);
    studio_text_at(im, (float)(x + PANEL_W - 10), (float)(y + PANEL_H - 12), 11, ink, 1, 0, text);
}

/* Names of rows and columns. */
static void draw_frame(studio_image *im, int columns, const char *const *names) {
    int k;
    studio_image_fill(im, 1, 1, 1);
    for (k = 0; k < columns; k++)
        studio_text_at(im, (float)(LEFT + PANEL_W * k + PANEL_W / 2), TOP - 10, 11, ink, 0.5f, 0, names[k]);
    for (k = 0; k < SHOWN; k++)
        studio_text_at(im, 22, (float)(TOP + PANEL_H * k + PANEL_H / 2), 11, ink, 0.5f, 1, start_name[shown[k]]);
}

static int gallery_begin(gallery *g, const shape *s, const studio_options *o, const char *model) {
    peri_real *x = (peri_real *)studio_alloc(3 * (size_t)s->count, sizeof(peri_real));
    int k, m, bad = !x;
    memset(g, 0, sizeof *g);
    studio_scene_begin(&g->scene);
    g->scene.look.ground = 0;
    g->scene.look.radius = 0.8f;
    g->away = (double *)studio_alloc((size_t)s->count, sizeof(double));
    bad = bad || !g->away || studio_image_make(&g->panel, PANEL_W - 4, PANEL_H - 4);
    for (k = 0; !bad && k < SHOWN; k++)
        for (m = 0; !bad && m < METHODS; m++) {
            spoil(s, shown[k], x);
            bad = run_begin(&g->r[k][m], s, m, 1.0 / 60, NULL, o, model) || run_put(&g->r[k][m], x);
        }
    free(x);
    return bad;
}

static void gallery_end(gallery *g) {
    int k;
    for (k = 0; k < SHOWN * METHODS; k++) run_end(&g->r[k / METHODS][k % METHODS]);
    studio_scene_end(&g->scene);
    studio_image_free(&g->panel);
    free(g->away);
}

/* Columns of the still picture at frame f: the start; the library after 3 and 12 steps; all methods at the end. */
static void draw_still(gallery *g, studio_image *im, int f, int last) {
    static const int frame[4] = {0, 3, 12, INT_MAX};
    int k, c;
    for (k = 0; k < SHOWN; k++) {
        for (c = 0; c < 4; c++)
            if (f == (frame[c] < last ? frame[c] : last))
                draw_panel(g, &g->r[k][PERIDYNAMICS], im, LEFT + c * PANEL_W, TOP + k * PANEL_H);
        for (c = 4; c < COLUMNS && f == last; c++)
            draw_panel(g, &g->r[k][c - 3], im, LEFT + c * PANEL_W, TOP + k * PANEL_H);
    }
}

static void draw_key(studio_image *im, int verbose) {
    float rgb[3];
    int k, x0 = LEFT, y = TOP + SHOWN * PANEL_H + 12;
    for (k = 0; k < 240; k++) {
        studio_colormap((float)(1 - k / 240.0), rgb);
        studio_rectangle(im, x0 + k, y, 1, 12, rgb, 1);
    }
    studio_text(im, (float)x0 + 250, (float)y + 11, 11, ink,
                verbose ? "0 .. 8 spacings away from the rest shape (best rigid fit); in each panel the rms"
                        : "0 .. 8 spacings from the rest shape");
}

static int pictures(const shape *s, const studio_options *o, const char *model) {
    static const char *const still[COLUMNS] = {"start",          "peri, 0.05 s",      "peri, 0.2 s",
                                               "peri, at last", "mass-spring, at last", "shape matching, at last"};
    gallery *g = (gallery *)studio_alloc(1, sizeof *g);
    studio_image big, film;
    studio_gif *gif;
    int f, k, m, bad;
    if (!g) return -1;
    bad = gallery_begin(g, s, o, model) ||
          studio_image_make(&big, LEFT + COLUMNS * PANEL_W, TOP + SHOWN * PANEL_H + 36) ||
          studio_image_make(&film, LEFT + METHODS * PANEL_W, TOP + SHOWN * PANEL_H + 36);
    if (bad) return -1;
    gif = studio_gif_begin(studio_path(o->out, "recover.gif"), film.width, film.height, 5);
    draw_frame(&big, COLUMNS, still);
    draw_frame(&film, METHODS, method_name);
    draw_key(&big, 1);
    draw_key(&film, 0);
    studio_progress(o, 0, o->frames, NULL);
    for (f = 0; f <= o->frames && !bad; f++) {
        draw_still(g, &big, f, o->frames);
        for (k = 0; k < SHOWN; k++)
            for (m = 0; m < METHODS; m++) {
                if (f % 2 == 0) draw_panel(g, &g->r[k][m], &film, LEFT + m * PANEL_W, TOP + k * PANEL_H);
                bad |= run_step(&g->r[k][m]);
            }
        if (f % 2 == 0) bad |= studio_gif_frame(gif, &film);
        studio_progress(o, f, o->frames, "pictures");
    }
    bad |= studio_gif_end(gif) | studio_png(studio_path(o->out, "recover.png"), &big);
    studio_image_free(&big);
    studio_image_free(&film);
    gallery_end(g);
    free(g);
    return bad;
}

/* --------------------------------------------------------------------------------------------------- main -------- */

int main(int argc, char **argv) {
    studio_options o;
    shape block, figure;
    const char *model;
    int k, models = 3, bad;
    if (studio_begin(&app, argc, argv, &o)) return studio_exit_code();
    model = o.model && strcmp(o.model, "all") ? o.model : NULL;
    if (o.model && !model) models = 7;
    if (sample_box(&block, 7, 7, 7, 0.14)) return 1;
    if (!o.check) {
        printf("steps until the misfit is below %.2f spacings, or the misfit after 2.5 s\n%31s", recovered, "");
        for (k = 0; k < STARTS; k++) printf("  %14s", start_name[k]);
        printf("\n");
    }
    for (k = 0; k < (model ? 1 : models); k++) tabulate(&block, PERIDYNAMICS, model ? model : all_models[k], &o);
    for (k = SPRINGS; k < METHODS; k++) tabulate(&block, k, "", &o);
    tabulate_contraction(&o, model ? model : all_models[0]);
    free(block.rest);
    if (o.check) return studio_end(&o);
    bad = sample_mesh(&figure, o.input ? o.input : "examples/models/figure.obj", 0.04);
    bad = bad || pictures(&figure, &o, model ? model : all_models[0]);
    free(figure.rest);
    return studio_end(&o) || bad;
}
