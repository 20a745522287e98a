/* tests/test_sampling.c - shapes: distances and gradients; lattices of points inside shapes and meshes */
#define PERI_IMPLEMENTATION
#include "../peri.h"
#include "test.h"

#define PI 3.14159265358979323846
#define MOST 60000

static peri_real points[3 * MOST], other[3 * MOST];

static peri_vec3 vec(double x, double y, double z) {
    peri_vec3 v;
    v.x = (peri_real)x;
    v.y = (peri_real)y;
    v.z = (peri_real)z;
    return v;
}

/* Counts, fills, and checks that both agree. */
static int sample(const peri_shape *s, double d, peri_real *to) {
    int counted = -1, filled = -1;
    peri_error err;
    peri_result r = peri_sample(s, (peri_real)d, NULL, 0, &counted, &err);
    if (r) {
        printf("    %s\n", err.text);
        return -1;
    }
    CHECK(counted <= MOST);
    CHECK(peri_sample(s, (peri_real)d, to, MOST, &filled, &err) == PERI_OK);
    CHECK(counted == filled);
    return filled;
}

/* The call is refused with this code and a text that holds `words`. */
static void refused(const peri_shape *s, double d, peri_result code, const char *words, int line) {
    peri_error err;
    int count = 7;
    err.text[0] = 0;
    if (peri_sample(s, (peri_real)d, points, MOST, &count, &err) != code || err.code != code || count != 0 ||
        !strstr(err.text, words)) {
        printf("    code %d, text \"%s\"\n", (int)err.code, err.text);
        test_complain(__FILE__, line, "not refused as it should be");
    }
}
#define REFUSED(shape, d, code, words) refused(shape, d, code, words, __LINE__)

/* ---- meshes ------------------------------------------------------------------------------------------------------ */

typedef struct mesh {
    int vertices, triangles;
    peri_real x[3 * 20000];
    int t[3 * 40000];
} mesh;

static mesh big;

static int add_vertex(mesh *m, double x, double y, double z) {
    m->x[3 * m->vertices] = (peri_real)x;
    m->x[3 * m->vertices + 1] = (peri_real)y;
    m->x[3 * m->vertices + 2] = (peri_real)z;
    return m->vertices++;
}

static void add_triangle(mesh *m, int a, int b, int c) {
    m->t[3 * m->triangles] = a;
    m->t[3 * m->triangles + 1] = b;
    m->t[3 * m->triangles + 2] = c;
    m->triangles++;
}

static peri_shape shape_of(const mesh *m) { return peri_shape_mesh(m->x, m->vertices, m->t, m->triangles); }

/* A box of half extents h about c. split: every triangle has vertices of its own. */
static void add_box(mesh *m, const double c[3], const double h[3], int split) {
    static const int face[6][4] = {{0, 4, 6, 2}, {1, 3, 7, 5}, {0, 1, 5, 4}, {2, 6, 7, 3}, {0, 2, 3, 1}, {4, 5, 7, 6}};
    int f, k, v[8];
    for (k = 0; k < 8 && !split; k++)
        v[k] = add_vertex(m, c[0] + (k & 1 ? h[0] : -h[0]), c[1] + (k & 2 ? h[1] : -h[1]),
                          c[2] + (k & 4 ? h[2] : -h[2]));
    for (f = 0; f < 6; f++) {
        static const int corner[6] = {0, 1, 2, 0, 2, 3};
        int id[6];
        for (k = 0; k < 6; k++) {
            int q = face[f][corner[k]];
            id[k] = split ? add_vertex(m, c[0] + (q & 1 ? h[0] : -h[0]), c[1] + (q & 2 ? h[1] : -h[1]),
                                       c[2] + (q & 4 ? h[2] : -h[2]))
                          : v[q];
        }
        add_triangle(m, id[0], id[1], id[2]);
        add_triangle(m, id[3], id[4], id[5]);
    }
}

static void cube(mesh *m, double x, double y, double z, double half, int split) {
    double c[3], h[3];
    c[0] = x;
    c[1] = y;
    c[2] = z;
    h[0] = h[1] = h[2] = half;
    add_box(m, c, h, split);
}

/* A torus grid or a ball: rings of `around` vertices; the ball has poles. */
static void ball(mesh *m, double radius, int rings, int around) {
    int i, j, south, north, base;
    south = add_vertex(m, 0, 0, -radius);
    base = m->vertices;
    for (i = 1; i < rings; i++)
        for (j = 0; j < around; j++) {
            double a = PI * i / rings - PI / 2, b = 2 * PI * j / around;
            add_vertex(m, radius * cos(a) * cos(b), radius * cos(a) * sin(b), radius * sin(a));
        }
    north = add_vertex(m, 0, 0, radius);
    for (j = 0; j < around; j++) {
        int k = (j + 1) % around, top = base + (rings - 2) * around;
        add_triangle(m, south, base + k, base + j);
        add_triangle(m, north, top + j, top + k);
        for (i = 0; i < rings - 2; i++) {
            int p = base + i * around;
            add_triangle(m, p + j, p + k, p + around + k);
            add_triangle(m, p + j, p + around + k, p + around + j);
        }
    }
}

static void turn(mesh *m) {
    int t;
    for (t = 0; t < m->triangles; t++) {
        int k = m->t[3 * t];
        m->t[3 * t] = m->t[3 * t + 1];
        m->t[3 * t + 1] = k;
    }
}

static void clear(mesh *m) { m->vertices = m->triangles = 0; }

/* ---- distances --------------------------------------------------------------------------------------------------- */

static peri_real torus(peri_vec3 p, peri_vec3 *gradient, void *context) {
    const double *r = (const double *)context;
    double x = (double)p.x, y = (double)p.y, z = (double)p.z, ring = sqrt(x * x + y * y) - r[0];
    double length = sqrt(ring * ring + z * z);
    if (gradient) *gradient = vec(0, 0, 1);
    return (peri_real)(length - r[1]);
}

static peri_real broken(peri_vec3 p, peri_vec3 *gradient, void *context) {
    (void)gradient;
    (void)context;
    return p.x > 0 ? (peri_real)HUGE_VAL : (peri_real)-1;
}

static double torus_size[2] = {1, 0.4};

static peri_shape torus_shape(void) {
    return peri_shape_distance(torus, torus_size, vec(-1.4, -1.4, -0.4), vec(1.4, 1.4, 0.4));
}

static unsigned seed;

static double next_random(void) {
    seed = seed * 1664525u + 1013904223u;
    return (double)(seed >> 8) / 16777216.0;
}

static void distances(void) {
    peri_shape box = peri_shape_box(1, 2, 3), round = peri_shape_ball(2), tube = peri_shape_cylinder(1, 2),
               pill = peri_shape_capsule(1, 2), plane = peri_shape_plane();
    double tiny = sizeof(peri_real) == 4 ? 1e-6 : 1e-14;
    NEAR(peri_shape_evaluate(&plane, vec(5, 6, -0.5), NULL), -0.5, tiny);
    NEAR(peri_shape_evaluate(&box, vec(4, 6, 3), NULL), 5, tiny);
    NEAR(peri_shape_evaluate(&box, vec(-4, 0, 7), NULL), 5, tiny);
    NEAR(peri_shape_evaluate(&box, vec(0.5, -1.75, 0), NULL), -0.25, tiny);
    NEAR(peri_shape_evaluate(&box, vec(1, 0, 0), NULL), 0, tiny);
    NEAR(peri_shape_evaluate(&round, vec(3, 4, 0), NULL), 3, tiny);
    NEAR(peri_shape_evaluate(&round, vec(0, 0, 0), NULL), -2, tiny);
    NEAR(peri_shape_evaluate(&tube, vec(2.4, 3.2, 0), NULL), 3, tiny);
    NEAR(peri_shape_evaluate(&tube, vec(0, 4, -6), NULL), 5, tiny);
    NEAR(peri_shape_evaluate(&tube, vec(0, 0, 1.75), NULL), -0.25, tiny);
    NEAR(peri_shape_evaluate(&pill, vec(3, 0, 6), NULL), 4, tiny);
    NEAR(peri_shape_evaluate(&pill, vec(0, 0.25, -1), NULL), -0.75, tiny);
    NEAR(peri_shape_evaluate(&pill, vec(0, 0, 0), NULL), -1, tiny);
}

/* Steps small enough for the second order, large enough for the reals. Points near edges of the medial axis, where the
   gradient jumps, are left out: there the two differences disagree. */
static void gradients(void) {
    peri_shape s[5];
    double h = sizeof(peri_real) == 4 ? 2e-3 : 1e-5, loose = sizeof(peri_real) == 4 ? 2e-3 : 1e-8;
    int i, k, used = 0;
    s[0] = peri_shape_plane();
    s[1] = peri_shape_box(1, (peri_real)1.2, (peri_real)0.7);
    s[2] = peri_shape_ball((peri_real)1.1);
    s[3] = peri_shape_cylinder(1, (peri_real)0.8);
    s[4] = peri_shape_capsule((peri_real)0.6, (peri_real)0.9);
    seed = 1;
    for (k = 0; k < 5; k++)
        for (i = 0; i < 500; i++) {
            double p[3], slope[3], kink = 0, d0, d1, d2;
            peri_vec3 g;
            int a;
            for (a = 0; a < 3; a++) p[a] = 4 * next_random() - 2;
            d0 = (double)peri_shape_evaluate(&s[k], vec(p[0], p[1], p[2]), &g);
            for (a = 0; a < 3; a++) {
                double q[3];
                memcpy(q, p, sizeof q);
                q[a] = p[a] + h;
                d2 = (double)peri_shape_evaluate(&s[k], vec(q[0], q[1], q[2]), NULL);
                q[a] = p[a] - h;
                d1 = (double)peri_shape_evaluate(&s[k], vec(q[0], q[1], q[2]), NULL);
                slope[a] = (d2 - d1) / (2 * h);
                kink += fabs(d2 + d1 - 2 * d0) / h;
            }
            NEAR((double)(g.x * g.x + g.y * g.y + g.z * g.z), 1, 1e-5);
            if (kink > 0.1) continue;
            used++;
            NEAR(g.x, slope[0], loose + kink * 0.02);
            NEAR(g.y, slope[1], loose + kink * 0.02);
            NEAR(g.z, slope[2], loose + kink * 0.02);
        }
    CHECK(used > 2300);
}

/* Where the gradient is not unique it is still a unit vector, and the same on every call. */
static void degenerate_points(void) {
    peri_shape s[4];
    int k, i;
    s[0] = peri_shape_box(1, 1, 1);
    s[1] = peri_shape_ball(1);
    s[2] = peri_shape_cylinder(1, 1);
    s[3] = peri_shape_capsule(1, 1);
    for (k = 0; k < 4; k++)
        for (i = 0; i < 3; i++) {
            peri_vec3 p = vec(0, 0, i == 0 ? 0 : i == 1 ? 0.5 : 1), a = vec(9, 9, 9), b = vec(7, 7, 7);
            (void)peri_shape_evaluate(&s[k], p, &a);
            (void)peri_shape_evaluate(&s[k], p, &b);
            NEAR((double)(a.x * a.x + a.y * a.y + a.z * a.z), 1, 1e-6);
            CHECK(memcmp(&a, &b, sizeof a) == 0);
        }
}

/* A user's distance that forgets the gradient still gives one; a mesh and NULL give 0. */
static void user_distance(void) {
    peri_shape s = peri_shape_distance(broken, NULL, vec(-1, -1, -1), vec(1, 1, 1)), m = shape_of(&big);
    peri_vec3 g = vec(5, 5, 5);
    NEAR(peri_shape_evaluate(&s, vec(-1, 0, 0), &g), -1, 0);
    NEAR(g.z, 1, 0);
    NEAR(peri_shape_evaluate(&m, vec(-1, 0, 0), &g), 0, 0);
    NEAR(peri_shape_evaluate(NULL, vec(-1, 0, 0), &g), 0, 0);
}

/* ---- lattices ---------------------------------------------------------------------------------------------------- */

/* n d wide boxes get exactly n points an axis, at cell centres, x fastest. */
static void box_counts(void) {
    int nx, ny, nz, count, i, j, k;
    for (nx = 1; nx <= 7; nx++)
        for (ny = 1; ny <= 7; ny += 3)
            for (nz = 2; nz <= 8; nz += 3) {
                double d = 0.07, half = d / 2;
                peri_shape s = peri_shape_box((peri_real)(nx * half), (peri_real)(ny * half), (peri_real)(nz * half));
                count = sample(&s, d, points);
                CHECK(count == nx * ny * nz);
                for (k = 0; k < nz; k++)
                    for (j = 0; j < ny; j++)
                        for (i = 0; i < nx; i++) {
                            const peri_real *p = points + 3 * ((k * ny + j) * nx + i);
                            NEAR(p[0], (i - 0.5 * (nx - 1)) * d, 1e-7);
                            NEAR(p[1], (j - 0.5 * (ny - 1)) * d, 1e-7);
                            NEAR(p[2], (k - 0.5 * (nz - 1)) * d, 1e-7);
                        }
            }
    {
        peri_shape s = peri_shape_box((peri_real)0.25, (peri_real)0.25, (peri_real)0.25); /* the quick start */
        CHECK(sample(&s, 0.05, points) == 1000);
        s = peri_shape_box((peri_real)0.1, (peri_real)0.1, (peri_real)0.1); /* thinner than the spacing */
        CHECK(sample(&s, 3, points) == 1);
        s = peri_shape_box((peri_real)1.74, (peri_real)1.76, (peri_real)1.26); /* rounds down, up, up */
        CHECK(sample(&s, 1, points) == 3 * 4 * 3);
    }
}

/* count d^3 tends to the volume: errors at three spacings, allowed like d (surface noise falls faster). */
static void volume_of(const peri_shape *s, double volume) {
    static const double spacing[3] = {0.2, 0.1, 0.06};
    int i;
    for (i = 0; i < 3; i++) {
        int count = sample(s, spacing[i], points);
        NEAR(count * pow(spacing[i], 3) / volume, 1, 0.5 * spacing[i]);
    }
}

static void volumes(void) {
    peri_shape s = peri_shape_ball(1);
    volume_of(&s, 4 * PI / 3);
    s = peri_shape_cylinder((peri_real)0.9, 1);
    volume_of(&s, PI * 0.81 * 2);
    s = peri_shape_capsule((peri_real)0.7, (peri_real)0.8);
    volume_of(&s, PI * 0.49 * 1.6 + 4 * PI / 3 * 0.343);
    s = torus_shape();
    volume_of(&s, 2 * PI * PI * 0.16);
    clear(&big);
    ball(&big, 1, 100, 100);
    s = shape_of(&big);
    volume_of(&s, 4 * PI / 3);
}

/* The k-th point and the k-th from behind are mirror images, exactly. */
static void symmetry(void) {
    peri_shape s[4];
    int i, k, n;
    s[0] = peri_shape_ball(1);
    s[1] = peri_shape_cylinder((peri_real)0.93, (peri_real)1.1);
    s[2] = peri_shape_capsule((peri_real)0.5, (peri_real)0.6);
    s[3] = torus_shape();
    for (k = 0; k < 4; k++) {
        n = sample(&s[k], 0.11, points);
        CHECK(n > 100);
        for (i = 0; i < 3 * n; i += 3) {
            const peri_real *p = points + i, *q = points + 3 * (n - 1) - i;
            CHECK(!(p[0] + q[0] > 0) && !(p[0] + q[0] < 0));
            CHECK(!(p[1] + q[1] > 0) && !(p[1] + q[1] < 0));
            CHECK(!(p[2] + q[2] > 0) && !(p[2] + q[2] < 0));
        }
    }
}

static int same(int n, const peri_real *a, int m, const peri_real *b) {
    int i;
    if (n != m || n <= 0) return 0;
    for (i = 0; i < 3 * n; i++)
        if (fabs((double)a[i] - (double)b[i]) > 1e-6) return 0;
    return 1;
}

/* A cube mesh gives the box's lattice, whether its triangles share vertices or not. At spacing 2/9 its diagonals and at
   2/8 + its edges are met exactly by lattice lines; shifted by a corner, vertices are. */
static void mesh_cube(void) {
    peri_shape box = peri_shape_box(1, 1, 1), s;
    int n, split;
    double d;
    for (split = 0; split < 2; split++) {
        clear(&big);
        cube(&big, 0, 0, 0, 1, split);
        s = shape_of(&big);
        for (n = 1; n <= 30; n++) {
            d = 2.0 / n;
            CHECK(same(sample(&box, d, points), points, sample(&s, d, other), other));
            d = 2.0 / (n + 0.37);
            CHECK(same(sample(&box, d, points), points, sample(&s, d, other), other));
        }
    }
}

/* An octahedron has vertices, edges and faces on lattice lines and planes for every odd and even number of cells. */
static void lines_through_vertices(void) {
    static const int t[24] = {0, 2, 4, 2, 1, 4, 1, 3, 4, 3, 0, 4, 2, 0, 5, 1, 2, 5, 3, 1, 5, 0, 3, 5};
    int n, i, k, count;
    peri_shape s;
    clear(&big);
    for (i = 0; i < 6; i++)
        add_vertex(&big, i == 0 ? 1 : i == 1 ? -1 : 0, i == 2 ? 1 : i == 3 ? -1 : 0, i == 4 ? 1 : i == 5 ? -1 : 0);
    for (i = 0; i < 24; i += 3) add_triangle(&big, t[i], t[i + 1], t[i + 2]);
    s = shape_of(&big);
    for (n = 1; n <= 33; n += n == 1 ? 2 : 1) { /* two cells an axis have none inside */
        int inside = 0, edge = 0, half = n - 1, x, y, z; /* centres at (2 i - half) / n, in units of 1/n */
        count = sample(&s, 2.0 / n, points);
        for (k = 0; k < count; k++) {
            const peri_real *p = points + 3 * k;
            CHECK(fabs((double)p[0]) + fabs((double)p[1]) + fabs((double)p[2]) < 1 + 1e-6);
        }
        for (x = -half; x <= half; x += 2)
            for (y = -half; y <= half; y += 2)
                for (z = -half; z <= half; z += 2) {
                    int sum = abs(x) + abs(y) + abs(z);
                    inside += sum < n;
                    edge += sum == n; /* exactly on a face: may count or not */
                }
        CHECK(count >= inside && count <= inside + edge);
    }
}

/* Points of a ball's mesh: inside the ball; and of the ball, all that are not between facets and ball. */
static void mesh_ball(void) {
    peri_shape s, smaller;
    peri_real *p;
    int n, m, i, j, rings = 60;
    double d = 0.08, gap = 1 - cos(PI / rings) + 0.002;
    clear(&big);
    ball(&big, 1, rings, 2 * rings);
    s = shape_of(&big);
    n = sample(&s, d, points);
    for (i = 0; i < n; i++) {
        p = points + 3 * i;
        CHECK((double)(p[0] * p[0] + p[1] * p[1] + p[2] * p[2]) < 1);
    }
    smaller = peri_shape_distance(torus, torus_size, vec(-1, -1, -1), vec(1, 1, 1)); /* a torus of ring radius 0 */
    torus_size[0] = 0;
    torus_size[1] = 1 - gap;
    m = sample(&smaller, d, other);
    torus_size[0] = 1;
    torus_size[1] = 0.4;
    CHECK(n >= m && n < m * 1.02);
    for (i = j = 0; i < n && j < m; i++) /* both run in the same order */
        if (fabs((double)points[3 * i] - (double)other[3 * j]) < 1e-6 &&
            fabs((double)points[3 * i + 1] - (double)other[3 * j + 1]) < 1e-6 &&
            fabs((double)points[3 * i + 2] - (double)other[3 * j + 2]) < 1e-6) j++;
    CHECK(j == m);
}

/* Two cubes that overlap in a quarter: its points are taken once. A cavity (a cube turned inwards) stays empty. */
static void overlap_and_cavity(void) {
    peri_shape s;
    clear(&big);
    cube(&big, 0, 0, 0, 0.5, 0);
    cube(&big, 0.5, 0.3, 0, 0.5, 0);
    s = shape_of(&big);
    CHECK(sample(&s, 0.1, points) == 2 * 1000 - 5 * 7 * 10);
    clear(&big);
    cube(&big, 0, 0, 0, 0.25, 0);
    turn(&big);
    cube(&big, 0, 0, 0, 0.75, 0);
    s = shape_of(&big);
    CHECK(sample(&s, 0.1, points) == 15 * 15 * 15 - 5 * 5 * 5);
}

/* An inside-out mesh is sampled as if it were turned. */
static void inside_out(void) {
    peri_shape s;
    int n;
    clear(&big);
    ball(&big, 1, 40, 40);
    s = shape_of(&big);
    n = sample(&s, 0.1, points);
    turn(&big);
    CHECK(same(n, points, sample(&s, 0.1, other), other));
}

/* Any one triangle may be missing: the points stay the same. So may be several, and a slit. */
static void small_holes(void) {
    peri_shape s;
    int n, t, k, keep[3];
    clear(&big);
    ball(&big, 1, 40, 60);
    s = shape_of(&big);
    n = sample(&s, 0.11, points);
    for (t = 0; t < big.triangles; t += 37) {
        memcpy(keep, big.t + 3 * t, sizeof keep);
        for (k = 0; k < 3; k++) big.t[3 * t + k] = big.t[3 * big.triangles - 3 + k];
        s.triangle_count = big.triangles - 1;
        CHECK(same(n, points, sample(&s, 0.11, other), other));
        memcpy(big.t + 3 * t, keep, sizeof keep);
    }
    s.triangle_count = big.triangles;
    for (t = 20; t < big.triangles; t += 401) /* five or so degenerate ones: their edges open */
        big.t[3 * t + 1] = big.t[3 * t];
    CHECK(same(n, points, sample(&s, 0.11, other), other));
}

/* A T-junction: one side of a cube's edge has a vertex that the other lacks. Nothing is open, however long the edge. */
static void t_junction(void) {
    peri_shape box = peri_shape_box(1, 1, 1), s;
    int middle, a, b, c;
    clear(&big);
    cube(&big, 0, 0, 0, 1, 0);
    a = big.t[0];
    b = big.t[1];
    c = big.t[2];
    middle = add_vertex(&big, 0.4 * (double)big.x[3 * a] + 0.6 * (double)big.x[3 * b],
                        0.4 * (double)big.x[3 * a + 1] + 0.6 * (double)big.x[3 * b + 1],
                        0.4 * (double)big.x[3 * a + 2] + 0.6 * (double)big.x[3 * b + 2]);
    big.t[1] = middle;
    add_triangle(&big, middle, b, c);
    s = shape_of(&big);
    CHECK(same(sample(&box, 0.1, points), points, sample(&s, 0.1, other), other));
}

static void large_hole(void) {
    peri_shape s;
    peri_error err;
    int count, rings = 40, t, kept = 0;
    char *at;
    double width = 0, x = 0, y = 0, z = 0, ring = sin(PI * 10 / rings); /* cut at the 10th ring below the north pole */
    clear(&big);
    ball(&big, 1, rings, 64);
    for (t = 0; t < big.triangles; t++) {
        const int *c = big.t + 3 * t;
        double low = fmin((double)big.x[3 * c[0] + 2], fmin((double)big.x[3 * c[1] + 2], (double)big.x[3 * c[2] + 2]));
        if (low > cos(PI * 10 / rings) - 1e-5) continue;
        memmove(big.t + 3 * kept, c, 3 * sizeof(int));
        kept++;
    }
    CHECK(kept < big.triangles);
    big.triangles = kept;
    s = shape_of(&big);
    CHECK(peri_sample(&s, (peri_real)0.1, points, MOST, &count, &err) == PERI_ERROR_GEOMETRY);
    at = strstr(err.text, "a hole ");
    CHECK(at && sscanf(at, "a hole %lf m wide at (%lf, %lf, %lf)", &width, &x, &y, &z) == 4);
    NEAR(width, 2 * ring, 0.005);
    NEAR(x, 0, 1e-3);
    NEAR(y, 0, 1e-3);
    NEAR(z, cos(PI * 10 / rings), 0.005);
    CHECK(strstr(err.text, "close it") != NULL);
    clear(&big); /* the lid of a cube */
    cube(&big, 1, 2, 3, 0.5, 1);
    big.triangles -= 2;
    s = shape_of(&big);
    REFUSED(&s, 0.1, PERI_ERROR_GEOMETRY, "a hole 1.41 m wide at (1, 2, 3.5)");
    clear(&big); /* three holes: the widest is named */
    cube(&big, 0, 0, 0, 1, 0);
    big.triangles -= 2;
    cube(&big, 10, 0, 0, 2, 0);
    big.triangles -= 2;
    cube(&big, 20, 0, 0, 1, 0);
    big.triangles -= 2;
    s = shape_of(&big);
    REFUSED(&s, 0.5, PERI_ERROR_GEOMETRY, "a hole 5.66 m wide at (10, 0, 2)");
    clear(&big); /* one triangle that faces the wrong way */
    cube(&big, 0, 0, 0, 1, 0);
    t = big.t[0];
    big.t[0] = big.t[1];
    big.t[1] = t;
    s = shape_of(&big);
    REFUSED(&s, 0.1, PERI_ERROR_GEOMETRY, "wrong way");
}

/* How far p is outside the convex mesh: its distance to the furthest facet plane. */
static double outside(const mesh *m, const double p[3]) {
    double worst = -1e300;
    int t, a;
    for (t = 0; t < m->triangles; t++) {
        double u[3], v[3], w[3], n[3], length;
        for (a = 0; a < 3; a++) {
            double x = (double)m->x[3 * m->t[3 * t] + a];
            u[a] = (double)m->x[3 * m->t[3 * t + 1] + a] - x;
            v[a] = (double)m->x[3 * m->t[3 * t + 2] + a] - x;
            w[a] = p[a] - x;
        }
        n[0] = u[1] * v[2] - u[2] * v[1];
        n[1] = u[2] * v[0] - u[0] * v[2];
        n[2] = u[0] * v[1] - u[1] * v[0];
        length = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
        worst = fmax(worst, (n[0] * w[0] + n[1] * w[1] + n[2] * w[2]) / length);
    }
    return worst;
}

/* Sheared balls of any size: their points are those inside all facets, no streak outside and no gap inside. */
static void watertight(void) {
    int trial, i, j, k, n, a;
    peri_shape s;
    seed = 5;
    for (trial = 0; trial < 20; trial++) {
        double map[12], scale = pow(10, 6 * next_random() - 3), d, p[3], loose = 1e-5 * scale;
        int inside = 0, edge = 0, reach = 4 + trial % 7;
        for (k = 0; k < 12; k++) map[k] = next_random() - 0.5 + (k % 4 == 0 && k < 9 ? 1.5 : 0);
        clear(&big);
        ball(&big, 1, 5 + trial % 7, 5 + trial % 5);
        for (i = 0; i < big.vertices; i++) {
            peri_real *x = big.x + 3 * i;
            for (a = 0; a < 3; a++)
                p[a] = map[9 + a] + map[3 * a] * (double)x[0] + map[3 * a + 1] * (double)x[1] +
                       map[3 * a + 2] * (double)x[2];
            for (a = 0; a < 3; a++) x[a] = (peri_real)(scale * p[a]);
        }
        s = shape_of(&big);
        d = scale * 2 / reach;
        n = sample(&s, d, points);
        CHECK(n > 0);
        for (i = 0; i < n; i++) {
            for (a = 0; a < 3; a++) p[a] = (double)points[3 * i + a];
            CHECK(outside(&big, p) < loose);
        }
        for (k = -4 * reach; k <= 4 * reach; k++) /* the lattice, carried on from one of its points */
            for (j = -4 * reach; j <= 4 * reach; j++)
                for (i = -4 * reach; i <= 4 * reach; i++) {
                    double far_off;
                    p[0] = (double)points[0] + i * d;
                    p[1] = (double)points[1] + j * d;
                    p[2] = (double)points[2] + k * d;
                    for (far_off = 0, a = 0; a < 3; a++)
                        far_off = fmax(far_off, fabs(p[a] / scale - map[9 + a]));
                    if (far_off > 2.6) continue;
                    far_off = outside(&big, p);
                    inside += far_off < -loose;
                    edge += far_off >= -loose && far_off < loose;
                }
        CHECK(n >= inside && n <= inside + edge);
        CHECK(edge < 9);
    }
}

/* No line leaks: around random tetrahedra with whole corners, whose edges and corners lie on lattice lines but are
   crossed at coordinates that round, the sum of signs along every line is exactly zero. This looks inside: the average
   over six directions would hide it. */
static void lines_never_leak(void) {
    static const int t[12] = {0, 2, 1, 0, 1, 3, 1, 2, 3, 2, 0, 3};
    static int32_t sum[19 * 19 * 19], mark[19 * 19 * 19];
    int trial, i, j, k;
    seed = 2;
    for (trial = 0; trial < 400; trial++) {
        peri_shape s;
        peri__mesh m;
        peri__lattice l;
        l.d = 1 + floor(1024 * next_random()) / 1024; /* so that whole multiples are exact, thirds of them are not */
        clear(&big);
        for (i = 0; i < 4; i++) {
            double x[3];
            for (k = 0; k < 3; k++) x[k] = l.d * (floor(17 * next_random()) - 8);
            add_vertex(&big, x[0], x[1], x[2]);
        }
        for (i = 0; i < 12; i += 3) add_triangle(&big, t[i], t[i + 1], t[i + 2]);
        s = shape_of(&big);
        memset(&m, 0, sizeof m);
        m.shape = &s;
        m.vertices = 4;
        m.edges = 12;
        if (peri__mesh_bounds(&m, NULL) || peri__mesh_allocate(&m, NULL, NULL)) continue;
        peri__mesh_weld(&m);
        l.middle[0] = l.middle[1] = l.middle[2] = 0;
        l.n[0] = l.n[1] = l.n[2] = 19;
        peri__mesh_wind(&m, &l, sum, mark);
        for (k = 0; k < 19; k++)
            for (j = 0; j < 19; j++)
                for (i = 0; i < 19; i++)
                    if (i % 18 == 0 || j % 18 == 0 || k % 18 == 0) CHECK(sum[(k * 19 + j) * 19 + i] == 0);
        peri__resize(NULL, m.block, m.bytes, 0);
    }
}

static void capacity(void) {
    peri_shape s = peri_shape_box(1, 1, 1), m;
    int count = 0, i;
    peri_error err;
    for (i = 0; i < 30; i++) points[i] = 77;
    CHECK(peri_sample(&s, 1, points, 7, &count, &err) == PERI_ERROR_LIMIT);
    CHECK(count == 8);
    CHECK(strstr(err.text, "7 points") && strstr(err.text, "8 are inside"));
    for (i = 21; i < 30; i++) NEAR(points[i], 77, 0);
    clear(&big);
    cube(&big, 0, 0, 0, 1, 0);
    m = shape_of(&big);
    for (i = 0; i < 30; i++) points[i] = 77;
    CHECK(peri_sample(&m, 1, points, 5, &count, &err) == PERI_ERROR_LIMIT);
    CHECK(count == 8);
    for (i = 15; i < 30; i++) NEAR(points[i], 77, 0);
    CHECK(peri_sample(&m, 1, points, 0, &count, &err) == PERI_ERROR_LIMIT);
    CHECK(peri_sample(&m, 1, points, 8, &count, &err) == PERI_OK);
    CHECK(peri_sample(&m, 1, points, -1, &count, &err) == PERI_ERROR_VALUE && strstr(err.text, "capacity is -1"));
}

static void errors(void) {
    peri_shape s;
    peri_real bad = (peri_real)HUGE_VAL, nan = bad - bad;
    int count;
    REFUSED(NULL, 1, PERI_ERROR_ARGUMENT, "shape is NULL");
    s = peri_shape_plane();
    REFUSED(&s, 1, PERI_ERROR_ARGUMENT, "no bounds");
    s.kind = (peri_shape_kind)8;
    REFUSED(&s, 1, PERI_ERROR_ARGUMENT, "shape.kind is 8");
    s = peri_shape_box(1, 0, 1);
    REFUSED(&s, 1, PERI_ERROR_VALUE, "shape.half.y is 0");
    s = peri_shape_box(1, 1, nan);
    REFUSED(&s, 1, PERI_ERROR_VALUE, "shape.half.z is ");
    s = peri_shape_ball(-2);
    REFUSED(&s, 1, PERI_ERROR_VALUE, "shape.radius is -2");
    s = peri_shape_ball(bad);
    REFUSED(&s, 1, PERI_ERROR_VALUE, "shape.radius is inf");
    s = peri_shape_cylinder(1, 0);
    REFUSED(&s, 1, PERI_ERROR_VALUE, "shape.half_length is 0");
    s = peri_shape_capsule(1, -1);
    REFUSED(&s, 1, PERI_ERROR_VALUE, "shape.half_length is -1");
    s = peri_shape_capsule(1, 0);
    CHECK(sample(&s, 1, points) == 8);
    s = peri_shape_distance(NULL, NULL, vec(0, 0, 0), vec(1, 1, 1));
    REFUSED(&s, 1, PERI_ERROR_ARGUMENT, "shape.distance is NULL");
    s = peri_shape_distance(torus, torus_size, vec(0, 0, 0), vec(1, 0, 1));
    REFUSED(&s, 1, PERI_ERROR_VALUE, "shape.upper.y is 0");
    s = peri_shape_distance(broken, NULL, vec(-1, -1, -1), vec(1, 1, 1));
    REFUSED(&s, 1, PERI_ERROR_VALUE, "the signed distance at (0.5, ");
    s = torus_shape();
    REFUSED(&s, 3, PERI_ERROR_GEOMETRY, "spacing 3 m is too coarse");
    s = peri_shape_ball(1);
    REFUSED(&s, 0, PERI_ERROR_VALUE, "spacing is 0");
    REFUSED(&s, -1, PERI_ERROR_VALUE, "spacing is -1");
    REFUSED(&s, (double)nan, PERI_ERROR_VALUE, "spacing is ");
    REFUSED(&s, 1e-6, PERI_ERROR_LIMIT, "2^40");
    REFUSED(&s, 1e-30, PERI_ERROR_LIMIT, "2^40");
    CHECK(peri_sample(&s, 1, NULL, 0, NULL, NULL) == PERI_ERROR_ARGUMENT);
    CHECK(peri_sample(&s, -1, NULL, 0, &count, NULL) == PERI_ERROR_VALUE);
}

static void mesh_errors(void) {
    peri_shape s;
    peri_real far_away = (peri_real)(sizeof(peri_real) == 4 ? 3e38 : 3e300), keep;
    clear(&big);
    cube(&big, 0, 0, 0, 1, 0);
    s = shape_of(&big);
    s.vertices = NULL;
    REFUSED(&s, 1, PERI_ERROR_ARGUMENT, "shape.vertices of a mesh is NULL");
    s = shape_of(&big);
    s.triangles = NULL;
    REFUSED(&s, 1, PERI_ERROR_ARGUMENT, "shape.triangles of a mesh is NULL");
    s = shape_of(&big);
    s.triangle_count = 0;
    REFUSED(&s, 1, PERI_ERROR_VALUE, "shape.triangle_count is 0");
    s.triangle_count = 2147483647;
    REFUSED(&s, 1, PERI_ERROR_LIMIT, "shape.triangle_count is 2147483647");
    s = shape_of(&big);
    s.vertex_count = -5;
    REFUSED(&s, 1, PERI_ERROR_VALUE, "shape.vertex_count is -5");
    s.vertex_count = 7;
    REFUSED(&s, 1, PERI_ERROR_INDEX, "uses vertex 7; there are 7");
    s = shape_of(&big);
    big.t[35] = 8;
    REFUSED(&s, 1, PERI_ERROR_INDEX, "triangle 11 of the mesh uses vertex 8");
    big.t[10] = -3;
    REFUSED(&s, 1, PERI_ERROR_INDEX, "triangle 3 of the mesh uses vertex -3");
    clear(&big);
    cube(&big, 0, 0, 0, 1, 0);
    keep = big.x[16];
    big.x[16] = (peri_real)HUGE_VAL;
    REFUSED(&s, 1, PERI_ERROR_VALUE, "vertex 5 of the mesh is (");
    big.x[16] = far_away;
    REFUSED(&s, 1, PERI_ERROR_VALUE, "1e-30 to 1e30");
    big.x[16] = keep;
    REFUSED(&s, 1e-6, PERI_ERROR_LIMIT, "2^40");
    memset(big.x, 0, sizeof big.x);
    REFUSED(&s, 1, PERI_ERROR_VALUE, "the mesh is 0 m in size");
    clear(&big); /* a ring whose lattice has one cell, in the hole */
    cube(&big, -1, 0, 0, 0.25, 0);
    cube(&big, 1, 0, 0, 0.25, 0);
    s = shape_of(&big);
    REFUSED(&s, 2.4, PERI_ERROR_GEOMETRY, "too coarse");
}

/* ---- surfaces ---------------------------------------------------------------------------------------------------- */

static peri_real areas[MOST];

/* A grid of columns by rows quads at at(u, v); across, along: whether its ends are joined. */
static void grid(mesh *m, int columns, int rows, int across, int along, void (*at)(double u, double v, double p[3])) {
    int base = m->vertices, w = columns + !across, h = rows + !along, i, j;
    for (j = 0; j < h; j++)
        for (i = 0; i < w; i++) {
            double p[3];
            at((double)i / columns, (double)j / rows, p);
            add_vertex(m, p[0], p[1], p[2]);
        }
    for (j = 0; j < rows; j++)
        for (i = 0; i < columns; i++) {
            int a = base + j * w + i, b = base + j * w + (i + 1) % w, up = (j + 1) % h;
            add_triangle(m, a, b, base + up * w + (i + 1) % w);
            add_triangle(m, a, base + up * w + (i + 1) % w, base + up * w + i);
        }
}

static void at_torus(double u, double v, double p[3]) {
    p[0] = (1 + 0.4 * cos(2 * PI * v)) * cos(2 * PI * u);
    p[1] = (1 + 0.4 * cos(2 * PI * v)) * sin(2 * PI * u);
    p[2] = 0.4 * sin(2 * PI * v);
}

static void at_tube(double u, double v, double p[3]) {
    p[0] = cos(2 * PI * u);
    p[1] = sin(2 * PI * u);
    p[2] = 2 * v - 1;
}

static void at_sheet(double u, double v, double p[3]) {
    p[0] = 2 * u;
    p[1] = 1.5 * v;
    p[2] = 0;
}

/* Gives every triangle vertices of its own, in reversed order of the triangles. */
static void split(const mesh *from, mesh *to) {
    int t, c;
    clear(to);
    to->triangles = from->triangles;
    for (t = from->triangles - 1; t >= 0; t--)
        for (c = 0; c < 3; c++) {
            const peri_real *p = from->x + 3 * (size_t)from->t[3 * t + c];
            to->t[3 * t + c] = add_vertex(to, (double)p[0], (double)p[1], (double)p[2]);
        }
}

/* Distance of p to the mesh: to the nearest of its triangles, by brute force (Ericson 2005, 5.1.5). */
static double off_surface(const mesh *m, const peri_real *x) {
    double best = 1e300;
    int t, c, k;
    for (t = 0; t < m->triangles; t++) {
        double q[3][3], p[3], e[3], f[3], w[3], ee = 0, ef = 0, ff = 0, we = 0, wf = 0, det, a, b, d = 0;
        for (k = 0; k < 3; k++)
            for (c = 0; c < 3; c++) q[k][c] = (double)m->x[3 * (size_t)m->t[3 * t + k] + (size_t)c];
        for (c = 0; c < 3; c++) {
            p[c] = (double)x[c];
            e[c] = q[1][c] - q[0][c];
            f[c] = q[2][c] - q[0][c];
            w[c] = p[c] - q[0][c];
            ee += e[c] * e[c];
            ef += e[c] * f[c];
            ff += f[c] * f[c];
            we += w[c] * e[c];
            wf += w[c] * f[c];
        }
        det = ee * ff - ef * ef;
        a = (ff * we - ef * wf) / det;
        b = (ee * wf - ef * we) / det;
        if (a >= 0 && b >= 0 && a + b <= 1) {
            for (c = 0; c < 3; c++) d += (w[c] - a * e[c] - b * f[c]) * (w[c] - a * e[c] - b * f[c]);
            if (d < best) best = d;
        }
        for (k = 0; k < 3; k++) {
            double along = 0, length = 0, s;
            const double *g = q[k], *h = q[(k + 1) % 3];
            for (c = 0; c < 3; c++) {
                along += (p[c] - g[c]) * (h[c] - g[c]);
                length += (h[c] - g[c]) * (h[c] - g[c]);
            }
            s = along / length;
            s = s < 0 ? 0 : s > 1 ? 1 : s;
            for (d = 0, c = 0; c < 3; c++)
                d += (p[c] - g[c] - s * (h[c] - g[c])) * (p[c] - g[c] - s * (h[c] - g[c]));
            if (d < best) best = d;
        }
    }
    return sqrt(best);
}

static double apart(const peri_real *a, const peri_real *b) {
    double x = (double)a[0] - (double)b[0], y = (double)a[1] - (double)b[1], z = (double)a[2] - (double)b[2];
    return sqrt(x * x + y * y + z * z);
}

/* Samples the mesh and checks what the documentation promises of every surface whose sides and creases are further
   apart than the spacing: number, evenness (its words), areas, points on the surface. border: length of its borders.
   Returns the number. */
static int surface(const mesh *m, double d, double area, double border) {
    peri_shape s = shape_of(m);
    peri_sample_report report, brute;
    peri_error err;
    int counted = -1, n = -1, i, j;
    double sum = 0, tiny = sizeof(peri_real) == 4 ? 1e-6 : 1e-12, worst = 0;
    CHECK(peri_sample_surface(&s, (peri_real)d, NULL, NULL, 0, &counted, NULL, &err) == PERI_OK);
    CHECK(peri_sample_surface(&s, (peri_real)d, points, areas, MOST, &n, &report, &err) == PERI_OK);
    CHECK(n > 1 && n == counted);
    brute.least = brute.most = brute.mean = 0;
    for (i = 0; i < n; i++) {
        double nearest = 1e300, off = off_surface(m, points + 3 * (size_t)i);
        for (j = 0; j < n; j++) {
            double r = apart(points + 3 * (size_t)i, points + 3 * (size_t)j);
            if (j != i && r < nearest) nearest = r;
        }
        if (i == 0 || nearest < brute.least) brute.least = nearest;
        if (nearest > brute.most) brute.most = nearest;
        brute.mean += nearest / n;
        if (off > worst) worst = off;
        CHECK(areas[i] > 0);
        sum += (double)areas[i];
    }
    NEAR(report.least, brute.least, 4 * tiny); /* a few roundings of coordinates of about 1 m */
    NEAR(report.mean, brute.mean, 4 * tiny);
    NEAR(report.most, brute.most, 4 * tiny);
    NEAR(worst, 0, 4 * tiny);
    CHECK(report.least >= 0.75 * d);
    CHECK(report.mean >= 0.9 * d && report.mean <= 1.05 * d);
    CHECK(report.most <= 1.35 * d);
    NEAR(report.measure, area, 1e-6 * area);
    NEAR(sum / report.measure, 1, 1e-6);
    NEAR(n / (area / (d * d) + 0.5 * border / d), 1, 0.03);
    return n;
}

static double area_of(const mesh *m) {
    double sum = 0;
    int t, c;
    for (t = 0; t < m->triangles; t++) {
        double u[3], v[3];
        for (c = 0; c < 3; c++) {
            u[c] = (double)m->x[3 * m->t[3 * t + 1] + c] - (double)m->x[3 * m->t[3 * t] + c];
            v[c] = (double)m->x[3 * m->t[3 * t + 2] + c] - (double)m->x[3 * m->t[3 * t] + c];
        }
        sum += 0.5 * sqrt((u[1] * v[2] - u[2] * v[1]) * (u[1] * v[2] - u[2] * v[1]) +
                          (u[2] * v[0] - u[0] * v[2]) * (u[2] * v[0] - u[0] * v[2]) +
                          (u[0] * v[1] - u[1] * v[0]) * (u[0] * v[1] - u[1] * v[0]));
    }
    return sum;
}

static void surface_even(void) {
    clear(&big);
    ball(&big, 1, 24, 48); /* triangles smaller than the spacing, slivers at the poles */
    surface(&big, 0.25, area_of(&big), 0);
    surface(&big, 0.1, area_of(&big), 0);
    clear(&big);
    grid(&big, 60, 24, 1, 1, at_torus);
    surface(&big, 0.2, area_of(&big), 0);
    clear(&big);
    grid(&big, 60, 20, 1, 0, at_tube);
    surface(&big, 0.15, area_of(&big), 2 * 120 * sin(PI / 60));
    surface(&big, 0.1, area_of(&big), 2 * 120 * sin(PI / 60)); /* evening out alone leaves neighbours at 0.736 */
    clear(&big);
    grid(&big, 1, 1, 0, 0, at_sheet); /* two triangles larger than the spacing */
    surface(&big, 0.05, 3, 7);
}

/* A box has 8 corners and 12 edges; each edge takes equal steps, each corner a point, and faces their share. */
static void surface_creases(void) {
    static const double c[3] = {0, 0, 0}, h[3] = {0.5, 0.4, 0.3};
    double d = 0.1;
    int n, i, a, on_edge = 0, corners = 0;
    clear(&big);
    add_box(&big, c, h, 0);
    n = surface(&big, d, 8 * (0.5 * 0.4 + 0.4 * 0.3 + 0.3 * 0.5), 0);
    for (i = 0; i < n; i++) {
        int sides = 0, lattice = 1;
        for (a = 0; a < 3; a++) {
            double x = (double)points[3 * i + a], k = (x + h[a]) / d;
            if (fabs(fabs(x) - h[a]) < 1e-6) sides++;
            else if (fabs(k - floor(k + 0.5)) > 1e-4) lattice = 0;
        }
        CHECK(sides >= 1);
        if (sides == 3) corners++;
        if (sides >= 2) {
            CHECK(lattice);
            on_edge++;
        }
    }
    CHECK(corners == 8);
    CHECK(on_edge == 8 + 4 * (9 + 7 + 5));
}

/* The borders of the tube: 42 equal steps (2 pi / 0.15 = 41.9) around each, so the chord between neighbours is the
   same to the difference of arc and chord on a polygon of 60 sides, (pi/60)^2/6 of it and less. */
static void surface_borders(void) {
    int n, i, j, side;
    clear(&big);
    grid(&big, 60, 20, 1, 0, at_tube);
    n = surface(&big, 0.15, area_of(&big), 2 * 120 * sin(PI / 60));
    for (side = -1; side <= 1; side += 2) {
        int ring[200], on = 0;
        for (i = 0; i < n; i++)
            if (fabs((double)points[3 * i + 2] - side) < 1e-6 && on < 200) ring[on++] = i;
        CHECK(on == 42);
        for (i = 0; i < on; i++) {
            double nearest = 9;
            for (j = 0; j < on; j++) {
                double r = apart(points + 3 * (size_t)ring[i], points + 3 * (size_t)ring[j]);
                if (i != j && r < nearest) nearest = r;
            }
            NEAR(nearest, 2 * sin(PI / 42), 0.004 * 0.15);
        }
    }
    clear(&big); /* the sheet's outline: corners kept, 40 and 30 steps */
    grid(&big, 3, 2, 0, 0, at_sheet);
    n = surface(&big, 0.05, 3, 7);
    for (i = 0, j = 0; i < n; i++) {
        double x = (double)points[3 * i], y = (double)points[3 * i + 1];
        if (fabs(x) < 1e-6 || fabs(x - 2) < 1e-6 || fabs(y) < 1e-6 || fabs(y - 1.5) < 1e-6) j++;
    }
    CHECK(j == 140);
}

/* Vertices that coincide are one: the same points come out, bit by bit. Orientation does not matter either. */
static void surface_seams(void) {
    static mesh parts;
    peri_shape s;
    peri_error err;
    int n, k, i;
    for (k = 0; k < 3; k++) {
        clear(&big);
        if (k == 0) ball(&big, 1, 12, 24);
        else if (k == 1) cube(&big, 0.1, 0.2, 0.3, 0.5, 0);
        else grid(&big, 30, 8, 1, 0, at_tube);
        s = shape_of(&big);
        CHECK(peri_sample_surface(&s, (peri_real)0.2, points, areas, MOST, &n, NULL, &err) == PERI_OK && n > 50);
        split(&big, &parts);
        s = shape_of(&parts);
        CHECK(peri_sample_surface(&s, (peri_real)0.2, other, NULL, MOST, &i, NULL, &err) == PERI_OK);
        CHECK(i == n && memcmp(points, other, 3 * (size_t)n * sizeof *points) == 0);
    }
    clear(&big); /* half the faces of the torus the other way: no creases in it, so still even */
    grid(&big, 40, 16, 1, 1, at_torus);
    for (k = 0; k < big.triangles; k += 2) {
        i = big.t[3 * k];
        big.t[3 * k] = big.t[3 * k + 1];
        big.t[3 * k + 1] = i;
    }
    surface(&big, 0.25, area_of(&big), 0);
}

/* What repairs leave behind makes no creases: a triangle with two corners in one place, and one without area that
   closes a T-junction. */
static void surface_degenerate(void) {
    int a, b, c, d, e, i, n, inside = 0;
    peri_shape s;
    peri_error err;
    clear(&big);
    a = add_vertex(&big, 0, 0, 0);
    b = add_vertex(&big, 2, 0, 0);
    c = add_vertex(&big, 2, 1, 0);
    d = add_vertex(&big, 0, 1, 0);
    e = add_vertex(&big, 1, 0.5, 0); /* on the diagonal a c, whose other side has it whole */
    add_triangle(&big, a, b, e);
    add_triangle(&big, b, c, e);
    add_triangle(&big, a, c, d);
    add_triangle(&big, a, e, c);
    add_triangle(&big, a, a, b);
    n = surface(&big, 0.1, 2, 6);
    for (i = 0; i < n; i++) {
        double x = (double)points[3 * i], y = (double)points[3 * i + 1];
        if (x > 0.15 && x < 1.85 && fabs(y - 0.5 * x) < 1e-6) inside++;
    }
    CHECK(inside < 5); /* a kept diagonal would hold about 20 */
    big.triangles = 1; /* coarser than the shape: still something */
    s = shape_of(&big);
    CHECK(peri_sample_surface(&s, 100, points, areas, MOST, &n, NULL, &err) == PERI_OK && n == 1);
    NEAR(areas[0], 0.5, 1e-6);
}

static void refused_surface(const peri_shape *s, double d, peri_result code, const char *words, int line) {
    peri_error err;
    int count = 7;
    err.text[0] = 0;
    if (peri_sample_surface(s, (peri_real)d, points, areas, MOST, &count, NULL, &err) != code || err.code != code ||
        count != 0 || !strstr(err.text, words)) {
        printf("    code %d, text \"%s\"\n", (int)err.code, err.text);
        test_complain(__FILE__, line, "not refused as it should be");
    }
}
#define REFUSED_SURFACE(shape, d, code, words) refused_surface(shape, d, code, words, __LINE__)

static void surface_errors(void) {
    peri_shape s = peri_shape_ball(1), none = peri_shape_none();
    peri_collider_def collider = peri_default_collider_def();
    peri_sample_report report;
    peri_vec3 g;
    peri_error err;
    double nearest;
    int n = 7, counted, k, speck = -1;
    REFUSED_SURFACE(NULL, 1, PERI_ERROR_ARGUMENT, "shape is NULL");
    REFUSED_SURFACE(&s, 1, PERI_ERROR_ARGUMENT, "no mesh (kind 2)");
    REFUSED(&none, 1, PERI_ERROR_ARGUMENT, "nothing to sample");
    NEAR(peri_shape_evaluate(&none, vec(1, 2, 3), &g), 1e30, 1e24);
    CHECK(g.x == 0 && g.y == 0 && g.z == 1);
    collider.shape = none;
    CHECK(peri__shape_check(&collider.shape, 1, &err) == PERI_OK);
    clear(&big);
    cube(&big, 0, 0, 0, 1, 0);
    s = shape_of(&big);
    CHECK(peri_sample_surface(&s, 1, NULL, NULL, 0, NULL, NULL, &err) == PERI_ERROR_ARGUMENT);
    REFUSED_SURFACE(&s, 0, PERI_ERROR_VALUE, "spacing is 0 m");
    REFUSED_SURFACE(&s, HUGE_VAL, PERI_ERROR_VALUE, "spacing is inf m");
    REFUSED_SURFACE(&s, 1e-5, PERI_ERROR_LIMIT, "too fine");
    REFUSED_SURFACE(&s, 1e-30, PERI_ERROR_LIMIT, "too fine");
    CHECK(peri_sample_surface(&s, 0.5, NULL, NULL, 0, &counted, NULL, &err) == PERI_OK);
    points[0] = 77;
    CHECK(peri_sample_surface(&s, 0.5, points, NULL, counted - 1, &n, NULL, &err) == PERI_ERROR_LIMIT);
    CHECK(n == counted && strstr(err.text, "count them first") && points[0] == 77);
    CHECK(peri_sample_surface(&s, 0.5, points, NULL, -1, &n, NULL, &err) == PERI_ERROR_VALUE);
    CHECK(peri_sample_surface(&s, 0.5, points, NULL, counted, &n, NULL, &err) == PERI_OK && n == counted);
    big.x[16] = (peri_real)HUGE_VAL;
    REFUSED_SURFACE(&s, 1, PERI_ERROR_VALUE, "vertex 5 of the mesh is (");
    clear(&big);
    add_vertex(&big, 0, 0, 0);
    add_vertex(&big, 1, 0, 0);
    add_vertex(&big, 2, 0, 0);
    add_triangle(&big, 0, 1, 2);
    s = shape_of(&big);
    REFUSED_SURFACE(&s, 0.1, PERI_ERROR_GEOMETRY, "without area");
    clear(&big); /* specks far apart: cells beyond int, distances beyond the cells */
    cube(&big, 0, 0, 0, 10, 0);
    cube(&big, 1e6, 1e6, 1e6, 1000, 0); /* a corner is nearest by far */
    s = shape_of(&big);
    CHECK(peri_sample_surface(&s, 100, points, areas, MOST, &n, &report, &err) == PERI_OK && n > 1000);
    for (k = 0; k < n; k++) /* the speck's only point; the nearest of the others is found in no cell nearby */
        if ((double)points[3 * k] < 100) speck = k;
    CHECK(speck >= 0);
    for (k = 0, nearest = 1e300; k < n && speck >= 0; k++)
        if (k != speck && apart(points + 3 * k, points + 3 * speck) < nearest)
            nearest = apart(points + 3 * k, points + 3 * speck);
    NEAR(report.most, nearest, 1); /* coordinates of 1e6 m round to 0.06 m in float */
}

/* ---- rectangles and lines ---------------------------------------------------------------------------------------- */

static void rectangle(void) {
    double w = 1.03, h = 0.48, d = 0.1;
    int n, counted, i, j;
    peri_error err;
    peri_shape box = peri_shape_box((peri_real)(w / 2), (peri_real)(h / 2), (peri_real)(d / 2));
    CHECK(peri_sample_rectangle((peri_real)w, (peri_real)h, (peri_real)d, NULL, 0, &counted, &err) == PERI_OK);
    CHECK(peri_sample_rectangle((peri_real)w, (peri_real)h, (peri_real)d, points, MOST, &n, &err) == PERI_OK);
    CHECK(n == counted && n == 10 * 5);
    for (j = 0; j < 5; j++)
        for (i = 0; i < 10; i++) {
            NEAR(points[3 * (10 * j + i)], (i - 4.5) * d, 1e-6);
            NEAR(points[3 * (10 * j + i) + 1], (j - 2) * d, 1e-6);
            CHECK(points[3 * (10 * j + i) + 2] == 0);
        }
    CHECK(sample(&box, d, other) == n && memcmp(points, other, 3 * (size_t)n * sizeof *points) == 0);
    n = 7;
    CHECK(peri_sample_rectangle(0, 1, 1, points, MOST, &n, &err) == PERI_ERROR_VALUE && n == 0);
    CHECK(strstr(err.text, "width is 0 m"));
    CHECK(peri_sample_rectangle(1, -1, 1, points, MOST, &n, &err) == PERI_ERROR_VALUE);
    CHECK(strstr(err.text, "height is -1 m"));
    CHECK(peri_sample_rectangle(1, 1, (peri_real)HUGE_VAL, points, MOST, &n, &err) == PERI_ERROR_VALUE);
    CHECK(strstr(err.text, "spacing is inf m"));
    CHECK(peri_sample_rectangle(1, 1, 1, points, MOST, NULL, &err) == PERI_ERROR_ARGUMENT);
    CHECK(peri_sample_rectangle(1, 1, (peri_real)0.1, points, 99, &n, &err) == PERI_ERROR_LIMIT && n == 100);
}

/* How far along the line through (0,0,0), (1,0,0), (1,1,0), (0,1,0) a point on it is; -1: it is not on it. */
static double along_square(const peri_real *p) {
    double x = (double)p[0], y = (double)p[1], near = 1e-6;
    if (fabs((double)p[2]) > near) return -1;
    if (fabs(y) <= near) return x;
    if (fabs(x - 1) <= near) return 1 + y;
    if (fabs(y - 1) <= near) return 3 - x;
    return fabs(x) <= near ? 4 - y : -1;
}

static void line(void) {
    static const peri_real square[12] = {0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 0};
    static const peri_real twice[12] = {0, 0, 0, 0, 0, 0, 2, 0, 0, 2, 0, 0};
    static peri_real circle[3 * 1000];
    peri_real step = 0;
    peri_error err;
    int n, k;
    CHECK(peri_sample_line(square, 4, 0, (peri_real)0.17, NULL, 0, &n, &step, &err) == PERI_OK);
    CHECK(n == 19); /* 3 / 0.17 = 17.6: 18 steps */
    NEAR(step, 3.0 / 18, 1e-7);
    CHECK(peri_sample_line(square, 4, 0, (peri_real)0.17, points, MOST, &n, NULL, &err) == PERI_OK && n == 19);
    for (k = 0; k < n; k++) NEAR(along_square(points + 3 * (size_t)k), k * (3.0 / 18), 1e-6);
    CHECK(memcmp(points, square, 3 * sizeof *points) == 0 && memcmp(points + 54, square + 9, 3 * sizeof *points) == 0);
    CHECK(peri_sample_line(square, 4, 1, (peri_real)0.17, points, MOST, &n, &step, &err) == PERI_OK);
    CHECK(n == 24); /* 4 / 0.17 = 23.5; the first is not repeated */
    for (k = 0; k < n; k++) NEAR(along_square(points + 3 * (size_t)k), k * (4.0 / 24), 1e-6);
    NEAR(step, 4.0 / 24, 1e-7);
    CHECK(peri_sample_line(twice, 4, 0, (peri_real)0.5, points, MOST, &n, &step, &err) == PERI_OK && n == 5);
    for (k = 0; k < n; k++) NEAR(points[3 * k], 0.5 * k, 1e-6); /* vertices in one place do no harm */
    for (k = 0; k < 1000; k++) { /* much finer than the spacing: chords of equal arcs are equal */
        circle[3 * k] = (peri_real)cos(2 * PI * k / 1000);
        circle[3 * k + 1] = (peri_real)sin(2 * PI * k / 1000);
    }
    CHECK(peri_sample_line(circle, 1000, 1, (peri_real)0.1, points, MOST, &n, NULL, &err) == PERI_OK && n == 63);
    for (k = 0; k < n; k++)
        NEAR(apart(points + 3 * (size_t)k, points + 3 * (size_t)((k + 1) % n)), 2 * sin(PI / 63), 1e-5);
}

static void line_errors(void) {
    peri_real bad[9] = {0, 0, 0, 1, 0, 0, 1, 1, 0}, same[6] = {1, 2, 3, 1, 2, 3};
    peri_error err;
    int n = 7;
#define REFUSED_LINE(vertices, count, closed, d, wanted, words) \
    CHECK(peri_sample_line(vertices, count, closed, (peri_real)(d), points, MOST, &n, NULL, &err) == wanted); \
    CHECK(n == 0 && strstr(err.text, words)); \
    n = 7
    REFUSED_LINE(NULL, 3, 0, 1, PERI_ERROR_ARGUMENT, "vertices is NULL");
    REFUSED_LINE(bad, 1, 0, 1, PERI_ERROR_VALUE, "an open line has at least 2");
    REFUSED_LINE(bad, 2, 1, 1, PERI_ERROR_VALUE, "a closed line has at least 3");
    REFUSED_LINE(bad, 3, 0, 0, PERI_ERROR_VALUE, "spacing is 0 m");
    REFUSED_LINE(bad, 3, 0, 5, PERI_ERROR_GEOMETRY, "too coarse");
    REFUSED_LINE(bad, 3, 0, 1e-12, PERI_ERROR_LIMIT, "2^31");
    REFUSED_LINE(same, 2, 0, 1, PERI_ERROR_VALUE, "the line is 0 m long");
    CHECK(peri_sample_line(bad, 3, 0, 1, points, MOST, NULL, NULL, &err) == PERI_ERROR_ARGUMENT);
    CHECK(peri_sample_line(bad, 3, 0, 1, points, 2, &n, NULL, &err) == PERI_ERROR_LIMIT && n == 3);
    bad[4] = (peri_real)HUGE_VAL;
    REFUSED_LINE(bad, 3, 0, 1, PERI_ERROR_VALUE, "vertex 1 of the line is (1, inf, 0)");
}

/* ---- memory ------------------------------------------------------------------------------------------------------ */

typedef struct budget {
    int allowed, calls;
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
    if (b->calls++ >= b->allowed) return NULL;
    p = realloc(ptr, new_bytes);
    b->held += new_bytes - old_bytes;
    return p;
}

static void failing_memory(void) {
    peri_allocator memory;
    budget b;
    peri_shape s;
    peri_error err;
    int count, n, refusals = 0;
    memory.resize = limited;
    memory.user = &b;
    clear(&big);
    cube(&big, 0, 0, 0, 1, 0);
    s = shape_of(&big);
    for (n = 0; n < 20; n++) {
        peri_result r;
        memset(&b, 0, sizeof b);
        b.allowed = n;
        r = peri_sample_with(&s, (peri_real)0.5, points, MOST, &count, &memory, &err);
        CHECK(b.held == 0);
        if (!r) break;
        CHECK(r == PERI_ERROR_MEMORY && err.code == r && count == 0 && strstr(err.text, "no memory"));
        refusals++;
    }
    CHECK(count == 64 && refusals == n && n > 0 && n < 20);
    s.triangle_count -= 2; /* refused after an allocation: nothing stays */
    memset(&b, 0, sizeof b);
    b.allowed = 20;
    CHECK(peri_sample_with(&s, (peri_real)0.5, points, MOST, &count, &memory, &err) == PERI_ERROR_GEOMETRY);
    CHECK(b.calls > 0 && b.held == 0);
    s = peri_shape_ball(1); /* no memory at all for other shapes */
    memset(&b, 0, sizeof b);
    CHECK(peri_sample_with(&s, (peri_real)0.5, points, MOST, &count, &memory, &err) == PERI_OK && b.calls == 0);
}

static void surface_memory(void) {
    peri_allocator memory;
    budget b;
    peri_shape s;
    peri_error err;
    int count, n;
    memory.resize = limited;
    memory.user = &b;
    clear(&big);
    cube(&big, 0, 0, 0, 1, 0);
    s = shape_of(&big);
    for (n = 0; n < 20; n++) {
        peri_result r;
        memset(&b, 0, sizeof b);
        b.allowed = n;
        r = peri_sample_surface_with(&s, (peri_real)0.5, points, areas, MOST, &count, NULL, &memory, &err);
        CHECK(b.held == 0);
        if (!r) break;
        CHECK(r == PERI_ERROR_MEMORY && err.code == r && count == 0 && strstr(err.text, "no memory"));
    }
    CHECK(n == 6 && count > 50); /* the mesh's block and five arrays */
    b.allowed = 1000; /* refused after all allocations: nothing stays */
    CHECK(peri_sample_surface_with(&s, (peri_real)0.5, points, areas, 5, &count, NULL, &memory, &err) ==
          PERI_ERROR_LIMIT);
    CHECK(b.held == 0);
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(distances);
    RUN(gradients);
    RUN(degenerate_points);
    RUN(user_distance);
    RUN(box_counts);
    RUN(volumes);
    RUN(symmetry);
    RUN(mesh_cube);
    RUN(lines_through_vertices);
    RUN(mesh_ball);
    RUN(overlap_and_cavity);
    RUN(inside_out);
    RUN(small_holes);
    RUN(t_junction);
    RUN(large_hole);
    RUN(watertight);
    RUN(lines_never_leak);
    RUN(capacity);
    RUN(errors);
    RUN(mesh_errors);
    RUN(surface_even);
    RUN(surface_creases);
    RUN(surface_borders);
    RUN(surface_seams);
    RUN(surface_degenerate);
    RUN(surface_errors);
    RUN(rectangle);
    RUN(line);
    RUN(line_errors);
    RUN(failing_memory);
    RUN(surface_memory);
    return test_end();
}
