/* studio_peri.h - what the examples share between studio.h and the library: names of materials and solvers, errors.
 *
 * Static functions over the public interface of peri.h.  Include it after both:
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
    static const char *const known[] = {"auto", "cholesky", "jacobi", "chebyshev", "position"}; /* as peri_solver */
    int k = studio_choice("--solver", name, known, 5);
    if (k < 0) return -1;
    *solver = (peri_solver)k;
    return 0;
}

/* Says what the last call on this world complained of; returns -1 so that callers can return it. */
STUDIO_API int studio_failed(const peri_world *world) { return studio_error("%s", peri_last_error(world)->text); }

/* ---- a world on stage ---- */

enum { STUDIO_ACTORS = 256 };

/* A body and how it is drawn: as balls, as a sheet of nx by ny points (nx > 0), as a rod (rod > 0: its radius, m), or by
 * the vertices of a skin. */
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

#endif /* STUDIO_PERI_H */
