/* tests/test_skinning.c - skins: fine meshes that follow the particles of a body */
#define PERI_IMPLEMENTATION
#include "../peri.h"
#include "test.h"

#define PI 3.14159265358979323846
#define MOST 8000       /* particles and vertices */

static peri_real points[3 * MOST], moved[3 * MOST], vertices[3 * MOST], out[3 * MOST], again[3 * MOST],
    normals[3 * MOST];
static int triangles[3 * 2 * MOST];

static unsigned seed;

static double next_random(void) {
    seed = seed * 1664525u + 1013904223u;
    return (double)(seed >> 8) / 16777216.0;
}

static peri_world *world_new(void) {
    peri_world_def def = peri_default_world_def();
    peri_error err;
    peri_world *w;
    def.gravity.z = 0;
    w = peri_world_create(&def, &err);
    CHECK(w != NULL);
    return w;
}

/* A lattice of nx * ny * nz points about `middle` x; returns how many there are from `first` on. */
static int lattice(peri_real *to, int nx, int ny, int nz, double d, double middle) {
    int i, j, k, n = 0;
    for (k = 0; k < nz; k++)
        for (j = 0; j < ny; j++)
            for (i = 0; i < nx; i++, n++) {
                to[3 * n] = (peri_real)(middle + (i - 0.5 * (nx - 1)) * d);
                to[3 * n + 1] = (peri_real)((j - 0.5 * (ny - 1)) * d);
                to[3 * n + 2] = (peri_real)((k - 0.5 * (nz - 1)) * d);
            }
    return n;
}

static peri_body_def body_def(peri_world *w, int count, double d) {
    peri_material rubber = peri_material_neo_hookean((peri_real)1e5, (peri_real)0.3, 1000);
    peri_body_def def = peri_default_body_def();
    def.points = points;
    def.count = count;
    def.spacing = (peri_real)d;
    def.material = peri_material_create(w, &rubber);
    return def;
}

static peri_body_id body_new(peri_world *w, int count, double d) {
    peri_body_def def = body_def(w, count, d);
    peri_body_id body = peri_body_create(w, &def);
    CHECK(peri_body_is_valid(w, body));
    return body;
}

static void random_vertices(int n, double half) {
    int i;
    seed = 3;
    for (i = 0; i < 3 * n; i++) vertices[i] = (peri_real)(half * (2 * next_random() - 1));
}

static double distance(const peri_real *a, const peri_real *b) {
    double x = (double)a[0] - (double)b[0], y = (double)a[1] - (double)b[1], z = (double)a[2] - (double)b[2];
    return sqrt(x * x + y * y + z * z);
}

/* Rounding allowed for coordinates of about one metre. */
static double rounding(void) { return sizeof(peri_real) == 4 ? 6e-6 : 1e-13; }

/* ---- motion ------------------------------------------------------------------------------------------------------ */

static void affine(const peri_real *x, peri_real *y) {
    static const double a[12] = {1.2, 0.3, -0.4, 0.1, 0.7, 0.2, -0.3, 0.5, 1.1, 1, -2, 3};
    int i, k;
    for (i = 0; i < 3; i++) {
        double sum = a[9 + i];
        for (k = 0; k < 3; k++) sum += a[3 * i + k] * (double)x[k];
        y[i] = (peri_real)sum;
    }
}

/* Inside the body and up to three spacings outside of it: x_v = A X_v + b, whatever the weights. */
static void follows_affine_motion(void) {
    peri_world *w = world_new();
    int n = lattice(points, 7, 7, 7, 0.1, 0), i, m = 2000;
    peri_body_id body = body_new(w, n, 0.1);
    peri_skin_id skin;
    random_vertices(m, 0.5);
    skin = peri_skin_create(w, body, vertices, m, NULL, 0);
    CHECK(skin.index1 != 0);
    for (i = 0; i < n; i++) affine(points + 3 * i, moved + 3 * i);
    CHECK(peri_body_set_positions(w, body, 0, n, moved) == PERI_OK);
    CHECK(peri_skin_update(w, skin, out, NULL) == PERI_OK);
    for (i = 0; i < m; i++) {
        peri_real wanted[3];
        affine(vertices + 3 * i, wanted);
        NEAR(distance(out + 3 * i, wanted), 0, rounding());
    }
    peri_world_destroy(w);
}

/* Vertices are given in the coordinates of the points: the body's own pose is applied to them too. */
static void starts_in_the_bodys_pose(void) {
    peri_world *w = world_new();
    int n = lattice(points, 5, 6, 4, 0.1, 0), i, m = 500;
    peri_body_def def = body_def(w, n, 0.1);
    peri_skin_id skin;
    random_vertices(m, 0.35);
    def.rotation.z = def.rotation.w = (peri_real)sqrt(0.5); /* a quarter turn: x to y */
    def.position.x = 5;
    def.position.y = -3;
    def.position.z = 1;
    skin = peri_skin_create(w, peri_body_create(w, &def), vertices, m, NULL, 0);
    CHECK(peri_skin_update(w, skin, out, NULL) == PERI_OK);
    for (i = 0; i < m; i++) {
        NEAR(out[3 * i], 5 - (double)vertices[3 * i + 1], 3 * rounding());
        NEAR(out[3 * i + 1], -3 + (double)vertices[3 * i], 3 * rounding());
        NEAR(out[3 * i + 2], 1 + (double)vertices[3 * i + 2], 3 * rounding());
    }
    peri_world_destroy(w);
}

static void bend(const peri_real *x, peri_real *y) {
    y[0] = (peri_real)(sin((double)x[0]) * (1 - (double)x[2]));
    y[1] = x[1];
    y[2] = (peri_real)(1 - cos((double)x[0]) * (1 - (double)x[2]));
}

/* Largest error of a bent bar's skin, at vertices inside and half a spacing outside. */
static double bent_error(int half_cells) {
    peri_world *w = world_new();
    double d = 0.5 / half_cells, worst = 0;
    int n = lattice(points, 4 * half_cells, 2 * half_cells, 2 * half_cells, d, 0), i, m = 3000;
    peri_body_id body = body_new(w, n, d);
    peri_skin_id skin;
    peri_real wanted[3];
    seed = 9;
    for (i = 0; i < 3 * m; i++) vertices[i] = (peri_real)((i % 3 ? 0.5 : 1) * (2 * next_random() - 1));
    skin = peri_skin_create(w, body, vertices, m, NULL, 0);
    for (i = 0; i < n; i++) bend(points + 3 * i, moved + 3 * i);
    CHECK(peri_body_set_positions(w, body, 0, n, moved) == PERI_OK);
    CHECK(peri_skin_update(w, skin, out, NULL) == PERI_OK);
    for (i = 0; i < m; i++) {
        bend(vertices + 3 * i, wanted);
        worst = fmax(worst, distance(out + 3 * i, wanted));
    }
    peri_world_destroy(w);
    return worst;
}

/* Bending is followed to second order: half the spacing, a quarter of the error. */
static void follows_bending(void) {
    double coarse = bent_error(3), fine = bent_error(6);
    CHECK(coarse < 0.5 * (1.0 / 6) * (1.0 / 6) * 2);
    CHECK(fine < 0.35 * coarse && fine > 0);
}

/* Longest way between the skin's positions of vertices a thousandth of a spacing apart, in units of that. */
static double longest_step(int noisy) {
    peri_world *w = world_new();
    double d = 0.125, step = 1e-3 * d, longest = 0;
    int n = lattice(points, 16, 8, 8, d, 0), i, m = 6000;
    peri_body_id body = body_new(w, n, d);
    peri_skin_id skin;
    for (i = 0; i < m; i++) {
        vertices[3 * i] = (peri_real)(-0.4 + 0.8 * step * i);
        vertices[3 * i + 1] = (peri_real)(0.1 + 0.3 * step * i);
        vertices[3 * i + 2] = (peri_real)(0.2 + 0.5196 * step * i);
    }
    skin = peri_skin_create(w, body, vertices, m, NULL, 0);
    CHECK(skin.index1 != 0);
    seed = 8;
    for (i = 0; i < n; i++) bend(points + 3 * i, moved + 3 * i);
    for (i = 0; i < 3 * n && noisy; i++) moved[i] = (peri_real)(2 * next_random() - 1);
    CHECK(peri_body_set_positions(w, body, 0, n, moved) == PERI_OK);
    CHECK(peri_skin_update(w, skin, out, NULL) == PERI_OK);
    for (i = 1; i < m; i++) longest = fmax(longest, distance(out + 3 * i, out + 3 * i - 3));
    peri_world_destroy(w);
    return longest / step;
}

/* No jumps where the set of particles changes: on a bent bar neighbours stay neighbours, and even particles thrown
   about at random (by 8 spacings) spread them by no more than such noise must over a spacing. */
static void no_jumps(void) {
    CHECK(longest_step(0) < 1.6);
    CHECK(longest_step(1) < 16);
}

/* Mirror images of vertices, on a body that is moved symmetrically, are moved to mirror images. */
static void mirror_images_agree(void) {
    peri_world *w = world_new();
    int n = lattice(points, 8, 7, 6, 0.1, 0), i, m = 2000;
    peri_body_id body = body_new(w, n, 0.1);
    peri_skin_id skin;
    random_vertices(m, 0.45);
    for (i = 0; i < m; i += 2) {
        vertices[3 * i + 3] = vertices[3 * i];
        vertices[3 * i + 4] = -vertices[3 * i + 1];
        vertices[3 * i + 5] = vertices[3 * i + 2];
    }
    skin = peri_skin_create(w, body, vertices, m, NULL, 0);
    for (i = 0; i < n; i++) {
        bend(points + 3 * i, moved + 3 * i);
        moved[3 * i + 1] = points[3 * i + 1] * (1 + 8 * points[3 * i + 1] * points[3 * i + 1] + points[3 * i]);
    }
    CHECK(peri_body_set_positions(w, body, 0, n, moved) == PERI_OK);
    CHECK(peri_skin_update(w, skin, out, NULL) == PERI_OK);
    for (i = 0; i < m; i += 2) {
        out[3 * i + 4] = -out[3 * i + 4];
        NEAR(distance(out + 3 * i, out + 3 * i + 3), 0, rounding());
    }
    peri_world_destroy(w);
}

/* Two legs `gap` spacings apart; one is moved. How much of that the facing skin of the other follows, at most. */
static double limb_error(double gap) {
    peri_world *w = world_new();
    double d = 0.1, worst = 0, between = (2 + gap) * d; /* legs are three particles wide */
    int n = lattice(points, 3, 3, 10, d, -0.5 * between), i, m = 500;
    peri_body_id body;
    peri_skin_id skin;
    n += lattice(points + 3 * n, 3, 3, 10, d, 0.5 * between);
    body = body_new(w, n, d);
    seed = 11;
    for (i = 0; i < m; i++) { /* half a spacing before the facing particles of the left leg */
        vertices[3 * i] = (peri_real)(-0.5 * gap * d + 0.5 * d);
        vertices[3 * i + 1] = (peri_real)(0.15 * (2 * next_random() - 1));
        vertices[3 * i + 2] = (peri_real)(0.5 * (2 * next_random() - 1));
    }
    skin = peri_skin_create(w, body, vertices, m, NULL, 0);
    memcpy(moved, points, sizeof points);
    for (i = n / 2; i < n; i++) moved[3 * i + 1] += 1;
    CHECK(peri_body_set_positions(w, body, 0, n, moved) == PERI_OK);
    CHECK(peri_skin_update(w, skin, out, NULL) == PERI_OK);
    for (i = 0; i < m; i++) worst = fmax(worst, distance(out + 3 * i, vertices + 3 * i));
    peri_world_destroy(w);
    return worst;
}

static void keeps_to_its_own_limb(void) {
    NEAR(limb_error(3), 0, rounding());
    NEAR(limb_error(2), 0, 0.03);
}

/* Bodies of few particles and vertices far from them: what is there is followed. */
static void few_particles(void) {
    int n, i, m = 7;
    for (n = 1; n <= 4; n++) {
        peri_world *w = world_new();
        peri_body_id body;
        peri_skin_id skin;
        for (i = 0; i < n; i++) {
            points[3 * i] = (peri_real)(i == 1 ? 0.1 : 0);
            points[3 * i + 1] = (peri_real)(i == 2 ? 0.1 : 0);
            points[3 * i + 2] = (peri_real)(i == 3 ? 0.1 : 0);
        }
        body = body_new(w, n, 0.1);
        for (i = 0; i < m; i++) {
            vertices[3 * i] = vertices[3 * i + 1] = 0;
            vertices[3 * i + 2] = (peri_real)(-0.0665 * i); /* to 3.99 spacings */
        }
        skin = peri_skin_create(w, body, vertices, m, NULL, 0);
        CHECK(skin.index1 != 0);
        for (i = 0; i < 3 * n; i++) moved[i] = points[i] + 2;
        CHECK(peri_body_set_positions(w, body, 0, n, moved) == PERI_OK);
        CHECK(peri_skin_update(w, skin, out, NULL) == PERI_OK);
        for (i = 0; i < 3 * m; i++) NEAR(out[i], (double)vertices[i] + 2, 3 * rounding());
        peri_world_destroy(w);
    }
}

/* ---- normals ----------------------------------------------------------------------------------------------------- */

static void normals_of_a_ball(void) {
    peri_world *w = world_new();
    int n = lattice(points, 8, 8, 8, 0.1, 0), i, j, m = 0, t = 0, rings = 30, around = 60;
    peri_body_id body = body_new(w, n, 0.1);
    peri_skin_id skin;
    for (i = 0; i < rings; i++)
        for (j = 0; j < around; j++, m++) {
            double a = PI * (i + 0.5) / rings - PI / 2, b = 2 * PI * j / around;
            vertices[3 * m] = (peri_real)(0.4 * cos(a) * cos(b));
            vertices[3 * m + 1] = (peri_real)(0.4 * cos(a) * sin(b));
            vertices[3 * m + 2] = (peri_real)(0.4 * sin(a));
        }
    for (i = 0; i + 1 < rings; i++)
        for (j = 0; j < around; j++, t += 2) {
            int a = i * around + j, b = i * around + (j + 1) % around;
            triangles[3 * t] = a;
            triangles[3 * t + 1] = triangles[3 * t + 3] = b;
            triangles[3 * t + 2] = triangles[3 * t + 5] = a + around;
            triangles[3 * t + 4] = b + around;
        }
    skin = peri_skin_create(w, body, vertices, m, triangles, t);
    CHECK(peri_skin_update(w, skin, out, normals) == PERI_OK);
    for (i = 2 * around; i < m - 2 * around; i++) {
        peri_real radial[3];
        for (j = 0; j < 3; j++) radial[j] = vertices[3 * i + j] / (peri_real)0.4;
        NEAR(distance(normals + 3 * i, radial), 0, 0.03);
    }
    for (i = 0; i < n; i++) { /* a quarter turn about x: y to z */
        moved[3 * i] = points[3 * i];
        moved[3 * i + 1] = -points[3 * i + 2];
        moved[3 * i + 2] = points[3 * i + 1];
    }
    CHECK(peri_body_set_positions(w, body, 0, n, moved) == PERI_OK);
    CHECK(peri_skin_update(w, skin, out, again) == PERI_OK);
    for (i = 0; i < m; i++) {
        peri_real turned[3];
        turned[0] = normals[3 * i];
        turned[1] = -normals[3 * i + 2];
        turned[2] = normals[3 * i + 1];
        NEAR(distance(again + 3 * i, turned), 0, sizeof(peri_real) == 4 ? 2e-4 : 1e-11);
        NEAR((double)(turned[0] * turned[0] + turned[1] * turned[1] + turned[2] * turned[2]), 1, 1e-6);
    }
    peri_world_destroy(w);
}

/* Two triangles at a right angle, one three times as large: their common vertices lean towards it. A vertex of a flat
   triangle and one of none point up. */
static void normals_are_weighted_by_area(void) {
    static const double x[8][3] = {{0, 0, 0}, {0, 0.1, 0}, {0.3, 0, 0}, {0, 0, 0.1}, {-0.1, 0, 0}, {-0.2, 0, 0},
                                   {-0.15, 0, 0}, {0.2, 0.2, 0.2}};
    static const int t[9] = {0, 2, 1, 0, 1, 3, 4, 5, 6};
    peri_world *w = world_new();
    int n = lattice(points, 6, 6, 6, 0.1, 0), i;
    peri_body_id body = body_new(w, n, 0.1);
    peri_skin_id skin;
    double loose = sizeof(peri_real) == 4 ? 1e-5 : 1e-12;
    for (i = 0; i < 24; i++) vertices[i] = (peri_real)x[i / 3][i % 3];
    skin = peri_skin_create(w, body, vertices, 8, t, 2);
    CHECK(peri_skin_update(w, skin, out, normals) == PERI_OK);
    for (i = 0; i < 2; i++) {
        NEAR(normals[3 * i], 1 / sqrt(10.0), loose);
        NEAR(normals[3 * i + 1], 0, loose);
        NEAR(normals[3 * i + 2], 3 / sqrt(10.0), loose);
    }
    NEAR(normals[8], 1, loose);
    NEAR(normals[9], 1, loose);
    for (i = 4; i < 8; i++) CHECK(normals[3 * i + 2] > 0 && !(normals[3 * i] > 0) && !(normals[3 * i] < 0));
    memcpy(triangles, t, sizeof t);
    triangles[6] = triangles[7] = triangles[8] = 7; /* three times one vertex: no area at all */
    skin = peri_skin_create(w, body, vertices, 8, triangles, 3);
    CHECK(peri_skin_update(w, skin, out, normals) == PERI_OK);
    for (i = 4; i < 8; i++) {
        NEAR(normals[3 * i], 0, 0);
        NEAR(normals[3 * i + 1], 0, 0);
        NEAR(normals[3 * i + 2], 1, 0);
    }
    peri_world_destroy(w);
}

/* ---- threads, errors, memory ------------------------------------------------------------------------------------- */

/* Pieces in reverse, as another thread's would come. */
static void backwards(int count, int grain, peri_task *task, void *context, void *user) {
    int begin = count > 0 ? (count - 1) / grain * grain : -1;
    (void)user;
    for (; begin >= 0; begin -= grain) task(begin, begin + grain < count ? begin + grain : count, context);
}

static void same_bits_in_any_order(void) {
    int pass, n = lattice(points, 8, 8, 8, 0.1, 0), i, m = 3000, t = 5000;
    random_vertices(m, 0.4);
    for (i = 0; i < 3 * t; i++) triangles[i] = (int)(next_random() * m);
    for (i = 0; i < n; i++) bend(points + 3 * i, moved + 3 * i);
    for (pass = 0; pass < 2; pass++) {
        peri_world_def def = peri_default_world_def();
        peri_world *w;
        peri_body_id body;
        peri_skin_id skin;
        if (pass) def.parallel.run = backwards;
        w = peri_world_create(&def, NULL);
        body = body_new(w, n, 0.1);
        skin = peri_skin_create(w, body, vertices, m, triangles, t);
        CHECK(peri_body_set_positions(w, body, 0, n, moved) == PERI_OK);
        CHECK(peri_skin_update(w, skin, pass ? again : out, pass ? points : normals) == PERI_OK);
        peri_world_destroy(w);
    }
    CHECK(memcmp(out, again, 3 * (size_t)m * sizeof *out) == 0);
    CHECK(memcmp(normals, points, 3 * (size_t)m * sizeof *out) == 0);
    for (i = 0; i < m; i++) CHECK(normals[3 * i] >= -1 && normals[3 * i] <= 1);
}

static void refused(peri_world *w, peri_skin_id skin, peri_result code, const char *words, int line) {
    const peri_error *err = peri_last_error(w);
    if (skin.index1 != 0 || err->code != code || !strstr(err->text, words)) {
        printf("    code %d, text \"%s\"\n", (int)err->code, err->text);
        test_complain(__FILE__, line, "not refused as it should be");
    }
}
#define REFUSED(skin, code, words) refused(w, skin, code, words, __LINE__)

static void errors(void) {
    peri_world *w = world_new();
    int n = lattice(points, 4, 4, 4, 0.1, 0);
    peri_body_id body = body_new(w, n, 0.1), none = {0, 0};
    peri_skin_id skin;
    triangles[0] = 0;
    triangles[1] = 1;
    triangles[2] = 2;
    random_vertices(10, 0.2);
    REFUSED(peri_skin_create(w, none, vertices, 10, NULL, 0), PERI_ERROR_ID, "body");
    REFUSED(peri_skin_create(w, body, NULL, 10, NULL, 0), PERI_ERROR_ARGUMENT, "vertices is NULL");
    REFUSED(peri_skin_create(w, body, vertices, 0, NULL, 0), PERI_ERROR_VALUE, "vertex_count is 0");
    REFUSED(peri_skin_create(w, body, vertices, 10, NULL, 1), PERI_ERROR_ARGUMENT, "triangles is NULL");
    REFUSED(peri_skin_create(w, body, vertices, 10, triangles, -1), PERI_ERROR_VALUE, "triangle_count is -1");
    REFUSED(peri_skin_create(w, body, vertices, 10, triangles, 2147483647), PERI_ERROR_LIMIT, "triangle_count is 2147");
    triangles[1] = 10;
    REFUSED(peri_skin_create(w, body, vertices, 10, triangles, 1), PERI_ERROR_INDEX,
            "triangle 0 of the skin uses vertex 10");
    triangles[1] = -1;
    REFUSED(peri_skin_create(w, body, vertices, 10, triangles, 1), PERI_ERROR_INDEX, "uses vertex -1");
    vertices[3 * 7] = (peri_real)HUGE_VAL;
    REFUSED(peri_skin_create(w, body, vertices, 10, NULL, 0), PERI_ERROR_VALUE, "vertex 7 of the skin is (");
    vertices[3 * 7] = (peri_real)(0.15 + 0.41); /* a little more than four spacings beyond the last particle ... */
    vertices[3 * 7 + 1] = vertices[3 * 7 + 2] = (peri_real)0.05;
    REFUSED(peri_skin_create(w, body, vertices, 10, NULL, 0), PERI_ERROR_GEOMETRY,
            "vertex 7 at (0.56, 0.05, 0.05) is 0.41 m");
    vertices[3 * 7] = (peri_real)1e20;
    REFUSED(peri_skin_create(w, body, vertices, 10, NULL, 0), PERI_ERROR_GEOMETRY, "vertex 7 at (1e+20, ");
    vertices[3 * 7] = (peri_real)(0.15 + 0.39); /* ... and a little less */
    skin = peri_skin_create(w, body, vertices, 10, NULL, 0);
    CHECK(skin.index1 != 0);
    CHECK(peri_skin_update(w, skin, NULL, NULL) == PERI_ERROR_ARGUMENT);
    CHECK(peri_world_stats(w).skins == 1);
    CHECK(peri_skin_destroy(w, skin) == PERI_OK);
    CHECK(peri_skin_destroy(w, skin) == PERI_ERROR_ID);
    CHECK(peri_skin_update(w, skin, out, NULL) == PERI_ERROR_ID);
    skin = peri_skin_create(w, body, vertices, 10, NULL, 0);
    CHECK(peri_body_destroy(w, body) == PERI_OK); /* takes its skins along */
    CHECK(peri_skin_update(w, skin, out, NULL) == PERI_ERROR_ID);
    CHECK(peri_world_stats(w).skins == 0);
    peri_world_destroy(w);
}

typedef struct budget {
    int allowed;
    size_t held;
} budget;

static void *limited(void *ptr, size_t old_bytes, size_t new_bytes, void *user) {
    budget *b = (budget *)user;
    void *p;
    if (new_bytes == 0) {
        b->held -= old_bytes;
        free(ptr);
        return NULL;
    }
    if (b->allowed-- <= 0) return NULL;
    p = realloc(ptr, new_bytes);
    b->held += new_bytes - old_bytes;
    return p;
}

/* Every allocation fails once: the skin is refused, the world holds what it held, and then it succeeds. */
static void failing_memory(void) {
    peri_world_def def = peri_default_world_def();
    budget b = {1000000, 0};
    peri_world *w;
    peri_body_id body;
    peri_skin_id skin = {0, 0};
    size_t before;
    int fail, n = lattice(points, 4, 4, 4, 0.1, 0);
    def.memory.resize = limited;
    def.memory.user = &b;
    w = peri_world_create(&def, NULL);
    body = body_new(w, n, 0.1);
    random_vertices(10, 0.2);
    for (fail = 0; fail < 9; fail++) triangles[fail] = fail;
    skin = peri_skin_create(w, body, vertices, 10, triangles, 3); /* lets the world's own tables grow */
    CHECK(peri_skin_destroy(w, skin) == PERI_OK);
    before = b.held;
    for (fail = 0; fail < 20; fail++) {
        b.allowed = fail;
        skin = peri_skin_create(w, body, vertices, 10, triangles, 3);
        if (skin.index1) break;
        CHECK(peri_last_error(w)->code == PERI_ERROR_MEMORY);
        CHECK(b.held == before);
        CHECK(peri_world_stats(w).skins == 0);
    }
    CHECK(fail >= 2 && fail < 20);
    before = b.held;
    b.allowed = 20;
    vertices[0] = 99; /* too far away: refused after allocations */
    CHECK(peri_skin_create(w, body, vertices, 10, triangles, 3).index1 == 0);
    CHECK(peri_last_error(w)->code == PERI_ERROR_GEOMETRY && b.held == before);
    CHECK(peri_skin_update(w, skin, out, normals) == PERI_OK);
    CHECK(peri_skin_destroy(w, skin) == PERI_OK);
    CHECK(b.held < before);
    peri_world_destroy(w);
    CHECK(b.held == 0);
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(follows_affine_motion);
    RUN(starts_in_the_bodys_pose);
    RUN(follows_bending);
    RUN(no_jumps);
    RUN(mirror_images_agree);
    RUN(keeps_to_its_own_limb);
    RUN(few_particles);
    RUN(normals_of_a_ball);
    RUN(normals_are_weighted_by_area);
    RUN(same_bits_in_any_order);
    RUN(errors);
    RUN(failing_memory);
    return test_end();
}
