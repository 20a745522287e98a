/* studio_peri.h - what the examples share between studio.h and the library: names of materials and solvers, errors.
 *
 * Static functions over the public interface of peri.h.  With PERI_DOUBLE what draws worlds is left out.  Include it
 * after both:
 *
 *     #include "studio.h"
 *     #define PERI_IMPLEMENTATION
 *     #include "../peri.h"
 *     #include "studio_peri.h"
 *
 * Conventions are those of studio.h: int is 0 for success or -1 after one clear line on stderr.
 *
 * Contents
 *    studio_choice      the index of a name in a table
 *    studio_material    a peri_material by name, as --model has it
 *    studio_solver      a peri_solver by name, as --solver has it
 *    studio_failed      the last error of a world as a studio_error
 *    studio_stand       a world on stage: bodies as balls, sheets, rods or skins, and a sheet of moments
 *    studio_body        the lattice of a shape as a body
 *    studio_fill_shape  samples a shape into fresh memory
 *    studio_solid       a solid by its signed distance: shape to sample, mesh to draw
 *    studio_step_world  a step, with the worst of the run
 *    studio_cloth       a sheet's lattice: hold, draw, which side of it a body is on
 *    studio_thing       a body with a skin in one colour: make, add to a scene, free
 *
 * License: MIT.
 */
#ifndef STUDIO_PERI_H
#define STUDIO_PERI_H

#include <stdio.h>
#include <string.h>

/* The index of `name` among the known ones, or -1 with an error that lists them.  NULL is the first. */
STUDIO_API int studio_choice(const char *option, const char *name, const char *const *known, int count) {
    char list[256] = "";
    size_t used = 0;
    int k;
    for (k = 0; k < count; k++)
        if (!name || !strcmp(name, known[k])) return k;
    for (k = 0; k < count && used < sizeof list; k++)
        used += (size_t)snprintf(list + used, sizeof list - used, " %s", known[k]);
    return studio_error("%s %s is unknown; known are:%s; see --help", option, name, list);
}

/* The material called `name` (NULL: neo_hookean).  "projective" does not ask for Poisson's ratio: its is 1/4. */
STUDIO_API int studio_material(const char *name, double young, double poisson, double density, peri_material *m) {
    static const char *const known[] = {"neo_hookean", "linear", "stvk", "stvk_exact", "stable", "papers",
                                        "projective"};
    const peri_real e = (peri_real)young, nu = (peri_real)poisson, rho = (peri_real)density;
    switch (studio_choice("--model", name, known, 7)) {
    case 0: *m = peri_material_neo_hookean(e, nu, rho); return 0;
    case 1: *m = peri_material_linear(e, nu, rho); return 0;
    case 2: *m = peri_material_stvk(e, nu, rho); return 0;
    case 3: *m = peri_material_stvk_exact(e, nu, rho); return 0;
    case 4: *m = peri_material_stable_neo_hookean(e, nu, rho); return 0;
    case 5: *m = peri_material_neo_hookean_papers(e, nu, rho); return 0;
    case 6: *m = peri_material_projective(e, (peri_real)0.5, rho); return 0;
    default: return -1;
    }
}

/* The solver called `name` (NULL: auto). */
STUDIO_API int studio_solver(const char *name, peri_solver *solver) {
    static const char *const known[] = {"auto", "cholesky", "two-level", "jacobi", "chebyshev",
                                        "position"}; /* as peri_solver */
    int k = studio_choice("--solver", name, known, 6);
    if (k < 0) return -1;
    *solver = (peri_solver)k;
    return 0;
}

/* Says what the last call on this world complained of; returns -1 so that callers can return it. */
STUDIO_API int studio_failed(const peri_world *world) { return studio_error("%s", peri_last_error(world)->text); }

/* ---- a world on stage ---- */
#ifndef PERI_DOUBLE /* what draws is in float */

enum { STUDIO_ACTORS = 256 };

/* A body and how it is drawn: as balls, as a sheet of nx by ny points (nx > 0), as a rod (rod > 0: its radius, m), or
 * by the vertices of a skin. */
typedef struct studio_actor {
    peri_body_id body;
    int nx, ny;
    float rod, ball, rgb[3];
    peri_skin_id skin;
    const studio_mesh *mesh;    /* of the skin */
} studio_actor;

/* A world, who is on stage, where the camera is, and the sheet of moments that is filled on the way. */
typedef struct studio_stand {
    peri_world *world;
    studio_actor actor[STUDIO_ACTORS];
    int actors, columns, moments;
    float target[3], distance, turn, rise, fov, floor, stage;  /* fov in degrees; floor: height; stage: radius lit, m */
    studio_image sheet;
    studio_gif *gif;
    double seconds;                 /* spent in steps */
    int steps, iterations, unconverged;
    double overlap;                 /* largest met, spacings */
} studio_stand;

STUDIO_API void studio_stand_begin(studio_stand *s, peri_world *world, int columns) {
    memset(s, 0, sizeof *s);
    s->world = world;
    s->columns = columns;
    s->fov = 25;
    s->distance = 3;
    s->stage = 1;
}

/* Adds a body; NULL when there are too many. */
STUDIO_API studio_actor *studio_stand_add(studio_stand *s, peri_body_id body, float ball, float r, float g, float b) {
    studio_actor *a = &s->actor[s->actors];
    if (s->actors == STUDIO_ACTORS) return NULL;
    s->actors++;
    memset(a, 0, sizeof *a);
    a->body = body;
    a->ball = ball;
    studio_set(a->rgb, r, g, b);
    return a;
}

/* The lattice of a sheet as triangles, its border half a cell wider than its points. */
STUDIO_API int studio_draw_sheet(const studio_actor *a, const float *x, studio_scene *scene) {
    studio_mesh m;
    float *colour;
    int i, j, k, n = a->nx * a->ny, bad;
    memset(&m, 0, sizeof m);
    m.vertices = n;
    m.triangles = 2 * (a->nx - 1) * (a->ny - 1);
    m.v = (float *)studio_alloc(3 * (size_t)n, sizeof(float));
    m.t = (int *)studio_alloc(3 * (size_t)m.triangles, sizeof(int));
    colour = (float *)studio_alloc(3 * (size_t)n, sizeof(float));
    bad = !m.v || !m.t || !colour;
    for (j = 0; j < a->ny && !bad; j++)
        for (i = 0; i < a->nx; i++) {
            int at = j * a->nx + i, in_x = i == 0 ? 1 : i == a->nx - 1 ? -1 : 0, in_y = j == 0 ? 1 : j == a->ny - 1 ? -1 : 0;
            for (k = 0; k < 3; k++) {
                m.v[3 * at + k] = x[3 * at + k];
                if (in_x) m.v[3 * at + k] += 0.5f * (x[3 * at + k] - x[3 * (at + in_x) + k]);
                if (in_y) m.v[3 * at + k] += 0.5f * (x[3 * at + k] - x[3 * (at + in_y * a->nx) + k]);
                colour[3 * at + k] = a->rgb[k] * ((i / 2 + j / 2) % 2 ? 1.0f : 0.86f);
            }
        }
    for (j = 0, k = 0; j < a->ny - 1 && !bad; j++)
        for (i = 0; i < a->nx - 1; i++, k += 6) {
            int p = j * a->nx + i;
            m.t[k] = p, m.t[k + 1] = p + 1, m.t[k + 2] = p + a->nx + 1;
            m.t[k + 3] = p, m.t[k + 4] = p + a->nx + 1, m.t[k + 5] = p + a->nx;
        }
    bad = bad || studio_mesh_normals(&m) || studio_scene_mesh(scene, &m, a->rgb, colour);
    studio_mesh_free(&m);
    free(colour);
    return bad;
}

/* A rod as balls close together. */
STUDIO_API int studio_draw_rod(const studio_actor *a, const float *x, int n, studio_scene *scene) {
    int i, k, c, bad = 0;
    for (i = 0; i < n - 1 && !bad; i++)
        for (k = 0; k < 6 && !bad; k++) {
            float p[3], shade = i % 4 < 2 ? 1 : 0.75f, rgb[3];
            for (c = 0; c < 3; c++) {
                p[c] = x[3 * i + c] + (float)k / 6 * (x[3 * i + 3 + c] - x[3 * i + c]);
                rgb[c] = a->rgb[c] * shade;
            }
            bad = studio_scene_ball(scene, p, a->rod, rgb);
        }
    return bad;
}

STUDIO_API int studio_draw_actor(const studio_stand *s, const studio_actor *a, studio_scene *scene) {
    const float *x = (const float *)(const void *)peri_body_positions(s->world, a->body);
    int i, n = peri_body_count(s->world, a->body), bad = 0;
    if (a->nx) return studio_draw_sheet(a, x, scene);
    if (a->rod > 0) return studio_draw_rod(a, x, n, scene);
    if (a->mesh) {
        studio_mesh m = *a->mesh;
        m.v = (float *)studio_alloc(3 * (size_t)m.vertices, sizeof(float));
        m.n = (float *)studio_alloc(3 * (size_t)m.vertices, sizeof(float));
        bad = !m.v || !m.n || peri_skin_update(s->world, a->skin, (peri_real *)(void *)m.v, (peri_real *)(void *)m.n) ||
              studio_scene_mesh(scene, &m, a->rgb, NULL);
        free(m.v);
        free(m.n);
        return bad;
    }
    for (i = 0; i < n && !bad; i++) bad = studio_scene_ball(scene, x + 3 * i, a->ball, a->rgb);
    return bad;
}

STUDIO_API int studio_stand_draw(const studio_stand *s, studio_image *im) {
    studio_scene scene;
    studio_camera camera;
    int i, bad = 0;
    studio_scene_begin(&scene);
    scene.look.height = s->floor;
    studio_set(scene.look.centre, s->target[0], s->target[1], s->target[2]);
    scene.look.radius = s->stage;
    for (i = 0; i < s->actors && !bad; i++) bad = studio_draw_actor(s, &s->actor[i], &scene);
    studio_orbit(&camera, s->target, s->distance, s->turn, s->rise, s->fov);
    bad = bad || studio_render(&scene, &camera, im);
    studio_scene_end(&scene);
    return bad;
}

/* Draws the present state as the next panel of the sheet (`all` of them in the end), with a line of text. */
STUDIO_API int studio_stand_moment(studio_stand *s, int all, const char *text) {
    static const float ink[3] = {0.2f, 0.22f, 0.26f};
    enum { W = 560, H = 460 };
    studio_image panel = {0, 0, NULL};
    int rows = (all + s->columns - 1) / s->columns, bad;
    bad = studio_image_make(&panel, W, H) || (!s->sheet.rgb && studio_image_make(&s->sheet, s->columns * W, rows * H));
    bad = bad || studio_stand_draw(s, &panel);
    if (!bad) {
        studio_text(&panel, 18, 34, 14, ink, text);
        studio_image_paste(&s->sheet, &panel, s->moments % s->columns * W, s->moments / s->columns * H);
        s->moments++;
    }
    studio_image_free(&panel);
    return bad;
}

/* One step, counted. */
STUDIO_API int studio_stand_step(studio_stand *s, float dt) {
    double start = studio_seconds();
    peri_stats stats;
    if (peri_world_step(s->world, (peri_real)dt)) return studio_failed(s->world);
    s->seconds += studio_seconds() - start;
    stats = peri_world_stats(s->world);
    s->steps++;
    s->iterations += stats.iterations;
    s->unconverged += !stats.converged;
    if (stats.overlap > s->overlap) s->overlap = stats.overlap;
    return 0;
}

/* Writes the sheet to out/name and gives back all; the world stays. */
STUDIO_API int studio_stand_end(studio_stand *s, const studio_options *o, const char *name) {
    char path[STUDIO_PATH];
    int bad = 0;
    snprintf(path, sizeof path, "%s/%s", o->out, name);
    if (!o->check && s->sheet.rgb) bad = studio_png(path, &s->sheet);
    studio_image_free(&s->sheet);
    return bad;
}

#endif /* PERI_DOUBLE */

/* The lattice of a shape as a body; a null id and an error when that fails. */
STUDIO_API peri_body_id studio_body(peri_world *w, const peri_shape *shape, peri_body_def *d) {
    peri_body_id none = {0, 0}, id;
    peri_error err;
    peri_real *points;
    int n = 0;
    if (peri_sample(shape, d->spacing, NULL, 0, &n, &err)) return studio_error("%s", err.text), none;
    points = (peri_real *)studio_alloc(3 * (size_t)n, sizeof *points);
    if (!points || peri_sample(shape, d->spacing, points, n, &n, &err)) return free(points), none;
    d->points = points;
    d->count = n;
    id = peri_body_create(w, d);
    free(points);
    d->points = NULL;
    if (!id.index1) studio_failed(w);
    return id;
}

/* ---- bodies with skins ---- */

/* Samples a shape: *points is fresh memory of 3 *count numbers, to be freed. */
STUDIO_API int studio_fill_shape(const peri_shape *shape, peri_real spacing, peri_real **points, int *count) {
    peri_error err;
    *points = NULL;
    if (peri_sample(shape, spacing, NULL, 0, count, &err)) return studio_error("%s", err.text);
    if (*count == 0) return studio_error("no particle fits into the shape: take a smaller spacing");
    *points = (peri_real *)studio_alloc(3 * (size_t)*count, sizeof(peri_real));
    if (!*points) return -1;
    if (peri_sample(shape, spacing, *points, *count, count, &err)) return studio_error("%s", err.text);
    return 0;
}

/* A solid in units of its own, and its size in the world. */
typedef struct studio_solid {
    studio_field *field;
    void *context;
    float lo[3], hi[3];
    float size;         /* metres of one unit */
} studio_solid;

STUDIO_API float studio_solid_field(const float p[3], void *context) {
    const studio_solid *s = (const studio_solid *)context;
    float q[3];
    studio_set(q, p[0] / s->size, p[1] / s->size, p[2] / s->size);
    return s->size * s->field(q, s->context);
}

STUDIO_API peri_real studio_solid_distance(peri_vec3 p, peri_vec3 *gradient, void *context) {
    float x[3], g[3];
    const float e = 1e-3f * ((const studio_solid *)context)->size;
    int k;
    studio_set(x, (float)p.x, (float)p.y, (float)p.z);
    for (k = 0; k < 3 && gradient; k++) {
        float q[3];
        memcpy(q, x, sizeof q);
        q[k] += e;
        g[k] = studio_solid_field(q, context);
        q[k] -= 2 * e;
        g[k] -= studio_solid_field(q, context);
    }
    if (gradient) {
        studio_unit(g);
        gradient->x = (peri_real)g[0];
        gradient->y = (peri_real)g[1];
        gradient->z = (peri_real)g[2];
    }
    return (peri_real)studio_solid_field(x, context);
}

/* The shape of a solid, which must outlive it. */
STUDIO_API peri_shape studio_solid_shape(studio_solid *s) {
    peri_vec3 lo, hi;
    lo.x = (peri_real)(s->lo[0] * s->size);
    lo.y = (peri_real)(s->lo[1] * s->size);
    lo.z = (peri_real)(s->lo[2] * s->size);
    hi.x = (peri_real)(s->hi[0] * s->size);
    hi.y = (peri_real)(s->hi[1] * s->size);
    hi.z = (peri_real)(s->hi[2] * s->size);
    return peri_shape_distance(studio_solid_distance, s, lo, hi);
}

/* The unit ball. */
STUDIO_API float studio_ball_field(const float p[3], void *context) {
    (void)context;
    return sqrtf(studio_dot(p, p)) - 1;
}

/* The surface of a solid, with cells of side `cell` m. */
STUDIO_API int studio_solid_mesh(studio_solid *s, float cell, studio_mesh *m) {
    float lo[3], hi[3];
    studio_set(lo, s->lo[0] * s->size, s->lo[1] * s->size, s->lo[2] * s->size);
    studio_set(hi, s->hi[0] * s->size, s->hi[1] * s->size, s->hi[2] * s->size);
    return studio_mesh_surface(m, studio_solid_field, s, lo, hi, cell);
}

#ifndef PERI_DOUBLE
/* A body, drawn as its skin. */
typedef struct studio_thing {
    peri_body_id body;
    peri_skin_id skin;
    studio_mesh now;    /* the skin as it was last seen; its triangles belong to the mesh that it was made of */
    float rgb[3];
} studio_thing;

/* Makes the body that def describes, and its skin of a mesh in the coordinates of def's points. */
STUDIO_API int studio_thing_make(studio_thing *t, peri_world *world, const peri_body_def *def, const studio_mesh *mesh,
                                 const float rgb[3]) {
    memset(t, 0, sizeof *t);
    memcpy(t->rgb, rgb, sizeof t->rgb);
    t->body = peri_body_create(world, def);
    if (!t->body.index1) return studio_failed(world);
    t->skin = peri_skin_create(world, t->body, mesh->v, mesh->vertices, mesh->t, mesh->triangles);
    if (!t->skin.index1) return studio_failed(world);
    t->now = *mesh;
    t->now.v = (float *)studio_alloc(3 * (size_t)mesh->vertices, sizeof(float));
    t->now.n = (float *)studio_alloc(3 * (size_t)mesh->vertices, sizeof(float));
    return t->now.v && t->now.n ? 0 : -1;
}

/* Adds the skin as it is now to a scene; colours: one per vertex, or NULL. */
STUDIO_API int studio_thing_draw(studio_thing *t, peri_world *world, studio_scene *scene, const float *colours) {
    if (peri_skin_update(world, t->skin, t->now.v, t->now.n)) return studio_failed(world);
    return studio_scene_mesh(scene, &t->now, t->rgb, colours);
}

STUDIO_API void studio_thing_free(studio_thing *t) {
    free(t->now.v);
    free(t->now.n);
    memset(t, 0, sizeof *t);
}

/* What the checks of several examples keep of every step. */
typedef struct studio_worst {
    int steps, iterations, unconverged;
    double seconds, overlap;    /* in the steps; largest overlap of any contact, spacings */
} studio_worst;

/* One step, and what it says of itself. */
STUDIO_API int studio_step_world(peri_world *world, peri_real dt, studio_worst *worst) {
    double start = studio_seconds();
    peri_stats stats;
    if (peri_world_step(world, dt)) return studio_failed(world);
    worst->seconds += studio_seconds() - start;
    stats = peri_world_stats(world);
    worst->steps++;
    worst->iterations += stats.iterations;
    worst->unconverged += !stats.converged;
    worst->overlap = fmax(worst->overlap, stats.overlap);
    return 0;
}

/* A sheet's lattice, nx * ny points with x running fastest. */
typedef struct studio_cloth {
    peri_body_id body;
    int nx, ny;
    float *points;
    unsigned char *fixed;   /* of the points; all 0 to begin with */
} studio_cloth;

STUDIO_API int studio_cloth_points(studio_cloth *c, int nx, int ny, float spacing) {
    peri_error err;
    int count = 0;
    memset(c, 0, sizeof *c);
    c->nx = nx;
    c->ny = ny;
    c->points = (float *)studio_alloc(3 * (size_t)(nx * ny), sizeof(float));
    c->fixed = (unsigned char *)studio_alloc((size_t)(nx * ny), 1);
    if (!c->points || !c->fixed) return -1;
    if (peri_sample_rectangle((peri_real)((float)nx * spacing), (peri_real)((float)ny * spacing), (peri_real)spacing,
                              c->points, nx * ny, &count, &err))
        return studio_error("%s", err.text);
    return count == nx * ny ? 0 : studio_error("the lattice has %d points, not %d x %d", count, nx, ny);
}

/* Fixes the points of the border, `rows` of them. */
STUDIO_API void studio_cloth_hold(studio_cloth *c, int rows) {
    int i, j;
    for (j = 0; j < c->ny; j++)
        for (i = 0; i < c->nx; i++)
            if (i < rows || j < rows || i >= c->nx - rows || j >= c->ny - rows) c->fixed[j * c->nx + i] = 1;
}

/* Adds the cloth as it is now; colours: 3 per point, or NULL. */
STUDIO_API int studio_cloth_draw(const studio_cloth *c, const peri_world *world, studio_scene *scene,
                                 const float rgb[3], const float *colours, const float back[3]) {
    enum { FINE = 2 };
    studio_mesh m;
    float *fine = NULL;
    int bad = studio_mesh_grid(&m, peri_body_positions(world, c->body), c->nx, c->ny, FINE);
    if (bad) return bad;
    if (colours) fine = (float *)studio_alloc(3 * (size_t)m.vertices, sizeof(float));
    if (colours) bad = !fine || studio_grid_values(colours, 3, c->nx, c->ny, FINE, fine);
    bad = bad || studio_scene_sheet(scene, &m, rgb, fine, back);
    free(fine);
    studio_mesh_free(&m);
    return bad ? -1 : 0;
}

/* The unit normal of the cloth at point i, from its neighbours. */
STUDIO_API void studio_cloth_normal(const studio_cloth *c, const float *x, int i, float *n) {
    int a = i % c->nx, b = i / c->nx, a0 = a > 0, a1 = a < c->nx - 1, b0 = b > 0, b1 = b < c->ny - 1;
    float u[3], v[3];
    studio_along(x + 3 * (i + a1), -1, x + 3 * (i - a0), u);
    studio_along(x + 3 * (i + b1 * c->nx), -1, x + 3 * (i - b0 * c->nx), v);
    studio_cross(u, v, n);
    studio_unit(n);
}

/* How far the particles of a body are above the cloth, along the normal of the nearest of its points: the least, m.
 * Points further away than `reach` do not count. */
STUDIO_API double studio_cloth_above(const studio_cloth *c, const peri_world *world, peri_body_id body, float reach) {
    const float *x = peri_body_positions(world, c->body), *y = peri_body_positions(world, body);
    int i, j, count = peri_body_count(world, body);
    double least = HUGE_VAL;
    for (i = 0; i < count; i++) {
        float best = reach * reach, away[3], n[3];
        int nearest = -1;
        for (j = 0; j < c->nx * c->ny; j++) {
            studio_along(y + 3 * i, -1, x + 3 * j, away);
            if (studio_dot(away, away) < best) best = studio_dot(away, away), nearest = j;
        }
        if (nearest < 0) continue;
        studio_along(y + 3 * i, -1, x + 3 * nearest, away);
        studio_cloth_normal(c, x, nearest, n);
        least = fmin(least, (double)studio_dot(away, n));
    }
    return least;
}

STUDIO_API void studio_cloth_free(studio_cloth *c) {
    free(c->points);
    free(c->fixed);
    memset(c, 0, sizeof *c);
}

#endif /* PERI_DOUBLE */

/* Unit quaternion of a turn by `degrees` about an axis. */
STUDIO_API peri_quat studio_turn(float x, float y, float z, float degrees) {
    float half = degrees * (float)(STUDIO_PI / 360), l = sinf(half) / sqrtf(x * x + y * y + z * z);
    peri_quat q;
    q.x = (peri_real)(l * x);
    q.y = (peri_real)(l * y);
    q.z = (peri_real)(l * z);
    q.w = (peri_real)cosf(half);
    return q;
}

#endif /* STUDIO_PERI_H */
