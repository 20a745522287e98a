/* figure.c - builds the example figure: Pip, a small plush dinosaur, as a closed triangle mesh.
 *
 *     cc -O2 figure.c -o figure -lm && ./figure figure.obj
 *
 * The body is a signed distance function: balls and tapered capsules joined by a smooth minimum, so that
 * limbs grow out of the trunk without seams.  Surface nets turn it into a mesh: every grid cell that the
 * surface passes gets one vertex, every grid edge that it crosses gets a quad, and a few rounds of
 * smoothing with projection back onto the surface make the triangles even.  z is up, Pip looks along -y,
 * stands on z = 0 and is about 1 m tall; limbs are at least 0.12 m thick.
 *
 * Contents: distance function, surface nets, smoothing, checks, OBJ output.  License: MIT.
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define CELL 0.027 /* side of a grid cell in metres */
#define NX 44       /* grid points along x, y, z */
#define NY 60
#define NZ 48

static const double origin[3] = {-0.53, -0.62, -0.06};

/* A tapered capsule: from a with radius ra to b with radius rb; a ball when a = b. */
typedef struct part {
    double a[3], ra, b[3], rb, blend;
    int twin; /* also mirrored at x = 0 */
} part;

static const part parts[] = {
    {{0.00, 0.03, 0.33}, 0.210, {0.00, 0.01, 0.46}, 0.165, 0.05, 0},     /* trunk */
    {{0.00, -0.06, 0.31}, 0.180, {0.00, -0.06, 0.33}, 0.175, 0.06, 0},   /* belly */
    {{0.00, -0.02, 0.55}, 0.110, {0.00, -0.06, 0.70}, 0.105, 0.07, 0},   /* neck */
    {{0.00, -0.04, 0.805}, 0.165, {0.00, -0.08, 0.795}, 0.165, 0.05, 0}, /* head */
    {{0.04, -0.21, 0.735}, 0.098, {0.045, -0.27, 0.730}, 0.090, 0.06, 1}, /* snout */
    {{0.085, -0.175, 0.865}, 0.052, {0.087, -0.185, 0.867}, 0.050, 0.015, 1}, /* eyes */
    {{0.12, 0.02, 0.90}, 0.064, {0.215, 0.05, 0.970}, 0.062, 0.035, 1},  /* ears */
    {{0.13, -0.02, 0.52}, 0.072, {0.310, -0.13, 0.500}, 0.068, 0.08, 1}, /* arms */
    {{0.130, 0.00, 0.24}, 0.118, {0.155, -0.02, 0.095}, 0.098, 0.04, 1}, /* legs */
    {{0.160, -0.03, 0.078}, 0.090, {0.175, -0.14, 0.072}, 0.082, 0.03, 1}, /* feet */
    {{0.00, 0.16, 0.26}, 0.140, {0.00, 0.34, 0.16}, 0.105, 0.06, 0},     /* tail */
    {{0.00, 0.34, 0.16}, 0.105, {0.00, 0.50, 0.20}, 0.078, 0.05, 0},
    {{0.00, 0.50, 0.20}, 0.078, {0.00, 0.60, 0.33}, 0.062, 0.04, 0},
    {{0.00, 0.075, 0.945}, 0.058, {0.00, 0.085, 0.960}, 0.055, 0.02, 0}, /* crest: head, neck, back, tail */
    {{0.00, 0.125, 0.80}, 0.060, {0.00, 0.140, 0.805}, 0.056, 0.02, 0},
    {{0.00, 0.085, 0.640}, 0.060, {0.00, 0.105, 0.645}, 0.056, 0.02, 0},
    {{0.00, 0.185, 0.51}, 0.060, {0.00, 0.200, 0.52}, 0.056, 0.02, 0},
    {{0.00, 0.265, 0.365}, 0.060, {0.00, 0.280, 0.380}, 0.056, 0.02, 0}};

/* Smooth minimum: rounds the valley between two surfaces over a width of about k. */
static double join(double a, double b, double k) {
    double h = fmax(k - fabs(a - b), 0.0) / k;
    return fmin(a, b) - h * h * k * 0.25;
}

/* Distance from p to the part, negative inside. */
static double part_distance(const part *q, const double *p) {
    double ab[3], ap[3], t = 0.0, n = 0.0, d = 0.0;
    int k;
    for (k = 0; k < 3; ++k) {
        ab[k] = q->b[k] - q->a[k];
        ap[k] = p[k] - q->a[k];
        t += ab[k] * ap[k];
        n += ab[k] * ab[k];
    }
    t = n > 0.0 ? fmin(fmax(t / n, 0.0), 1.0) : 0.0;
    for (k = 0; k < 3; ++k) d += (ap[k] - t * ab[k]) * (ap[k] - t * ab[k]);
    return sqrt(d) - (q->ra + t * (q->rb - q->ra));
}

/* Signed distance of the whole figure (near the surface). */
static double figure(const double *p) {
    double d = 1e3, mirrored[3];
    size_t i;
    for (i = 0; i < sizeof parts / sizeof parts[0]; ++i) {
        mirrored[0] = parts[i].twin ? fabs(p[0]) : p[0];
        mirrored[1] = p[1];
        mirrored[2] = p[2];
        d = join(d, part_distance(parts + i, mirrored), parts[i].blend);
    }
    return -join(-d, p[2], 0.02); /* cut flat at z = 0, where it stands */
}

static void gradient(const double *p, double *g) {
    double q[3], h = 1e-4;
    int k;
    for (k = 0; k < 3; ++k) {
        memcpy(q, p, sizeof q);
        q[k] += h;
        g[k] = figure(q);
        q[k] -= 2.0 * h;
        g[k] = (g[k] - figure(q)) / (2.0 * h);
    }
}

static double value[NX * NY * NZ];
static int vertex_of[NX * NY * NZ]; /* of the cell whose lowest corner is this grid point; -1 none */
static double v[NX * NY * NZ][3];
static int t[2 * NX * NY * NZ][3];
static int vertices, triangles;

static int at(int x, int y, int z) { return (z * NY + y) * NX + x; }

/* One vertex per cell that the surface passes: the mean of the crossings of its edges. */
static void place_vertices(void) {
    int x, y, z, c, k;
    for (c = 0; c < NX * NY * NZ; ++c) {
        double p[3];
        p[0] = origin[0] + CELL * (c % NX);
        p[1] = origin[1] + CELL * (c / NX % NY);
        p[2] = origin[2] + CELL * (c / (NX * NY));
        value[c] = figure(p);
        vertex_of[c] = -1;
    }
    for (z = 0; z + 1 < NZ; ++z)
        for (y = 0; y + 1 < NY; ++y)
            for (x = 0; x + 1 < NX; ++x) {
                double sum[3] = {0.0, 0.0, 0.0};
                int count = 0;
                for (c = 0; c < 8; ++c)
                    for (k = 0; k < 3; ++k) {
                        double a, b, s;
                        int o = c | 1 << k;
                        if (c >> k & 1) continue;
                        a = value[at(x + (c & 1), y + (c >> 1 & 1), z + (c >> 2))];
                        b = value[at(x + (o & 1), y + (o >> 1 & 1), z + (o >> 2))];
                        if ((a < 0.0) == (b < 0.0)) continue;
                        s = a / (a - b);
                        sum[0] += (c & 1) + (k == 0 ? s : 0.0);
                        sum[1] += (c >> 1 & 1) + (k == 1 ? s : 0.0);
                        sum[2] += (c >> 2) + (k == 2 ? s : 0.0);
                        ++count;
                    }
                if (!count) continue;
                v[vertices][0] = origin[0] + CELL * (x + sum[0] / count);
                v[vertices][1] = origin[1] + CELL * (y + sum[1] / count);
                v[vertices][2] = origin[2] + CELL * (z + sum[2] / count);
                vertex_of[at(x, y, z)] = vertices++;
            }
}

static double apart(int a, int b) {
    double d = 0.0;
    int k;
    for (k = 0; k < 3; ++k) d += (v[a][k] - v[b][k]) * (v[a][k] - v[b][k]);
    return d;
}

static void add_triangle(int a, int b, int c) {
    t[triangles][0] = a;
    t[triangles][1] = b;
    t[triangles++][2] = c;
}

/* A quad around every grid edge that the surface crosses, split along its shorter diagonal. */
static void connect(void) {
    int p[3], k, q[4], i;
    for (k = 0; k < 3; ++k)
        for (p[2] = 1; p[2] + 1 < NZ; ++p[2])
            for (p[1] = 1; p[1] + 1 < NY; ++p[1])
                for (p[0] = 1; p[0] + 1 < NX; ++p[0]) {
                    int step[3] = {0, 0, 0}, u = (k + 1) % 3, w = (k + 2) % 3, inside;
                    step[k] = 1;
                    inside = value[at(p[0], p[1], p[2])] < 0.0;
                    if (inside == (value[at(p[0] + step[0], p[1] + step[1], p[2] + step[2])] < 0.0)) continue;
                    for (i = 0; i < 4; ++i) {
                        int c[3];
                        memcpy(c, p, sizeof c);
                        c[u] -= i == 0 || i == 3;
                        c[w] -= i < 2;
                        q[inside ? i : 3 - i] = vertex_of[at(c[0], c[1], c[2])];
                    }
                    if (apart(q[0], q[2]) <= apart(q[1], q[3])) {
                        add_triangle(q[0], q[1], q[2]);
                        add_triangle(q[0], q[2], q[3]);
                    } else {
                        add_triangle(q[1], q[2], q[3]);
                        add_triangle(q[1], q[3], q[0]);
                    }
                }
}

/* Pulls every vertex towards the mean of its neighbours, then back onto the surface. */
static void smooth(int rounds) {
    static double sum[NX * NY * NZ][4];
    int i, k, step;
    while (rounds-- > 0) {
        memset(sum, 0, sizeof sum);
        for (i = 0; i < triangles; ++i)
            for (k = 0; k < 3; ++k) {
                const double *b = v[t[i][(k + 1) % 3]];
                double *s = sum[t[i][k]];
                s[0] += b[0];
                s[1] += b[1];
                s[2] += b[2];
                s[3] += 1.0;
            }
        for (i = 0; i < vertices; ++i) {
            for (k = 0; k < 3; ++k) v[i][k] += 0.6 * (sum[i][k] / sum[i][3] - v[i][k]);
            for (step = 0; step < 2; ++step) {
                double g[3], d = figure(v[i]), n;
                gradient(v[i], g);
                n = g[0] * g[0] + g[1] * g[1] + g[2] * g[2];
                for (k = 0; k < 3; ++k) v[i][k] -= d * g[k] / fmax(n, 0.2);
            }
        }
    }
}

/* Scales to a height of 1 m with the feet at z = 0. */
static void fit(void) {
    double lo = 1e9, hi = -1e9;
    int i, k;
    for (i = 0; i < vertices; ++i) {
        lo = fmin(lo, v[i][2]);
        hi = fmax(hi, v[i][2]);
    }
    for (i = 0; i < vertices; ++i)
        for (k = 0; k < 3; ++k) v[i][k] = (v[i][k] - (k == 2 ? lo : 0.0)) / (hi - lo);
}

static int edge_order(const void *a, const void *b) {
    const int *p = (const int *)a, *q = (const int *)b;
    return p[0] != q[0] ? (p[0] < q[0] ? -1 : 1) : p[1] != q[1] ? (p[1] < q[1] ? -1 : 1) : 0;
}

/* 1 when every edge occurs once in each direction; prints volume, worst angle and longest edge. */
static int verify(void) {
    int (*e)[2] = (int (*)[2])malloc(sizeof(int[2]) * 3 * (size_t)triangles), i, k, good = e != NULL;
    double volume = 0.0, worst = 180.0, longest = 0.0;
    for (i = 0; i < triangles && good; ++i) {
        const double *a = v[t[i][0]], *b = v[t[i][1]], *c = v[t[i][2]];
        volume += (a[0] * (b[1] * c[2] - b[2] * c[1]) + a[1] * (b[2] * c[0] - b[0] * c[2]) +
                   a[2] * (b[0] * c[1] - b[1] * c[0])) / 6.0;
        for (k = 0; k < 3; ++k) {
            double x = apart(t[i][k], t[i][(k + 1) % 3]), y = apart(t[i][k], t[i][(k + 2) % 3]);
            double z = apart(t[i][(k + 1) % 3], t[i][(k + 2) % 3]);
            worst = fmin(worst, acos((x + y - z) / (2.0 * sqrt(x * y))) * 57.29578);
            longest = fmax(longest, sqrt(x));
            e[3 * i + k][0] = t[i][k];
            e[3 * i + k][1] = t[i][(k + 1) % 3];
        }
    }
    if (good) qsort(e, 3 * (size_t)triangles, sizeof *e, edge_order);
    for (i = 0; i < 3 * triangles && good; ++i) {
        int back[2];
        back[0] = e[i][1];
        back[1] = e[i][0];
        if (!bsearch(back, e, 3 * (size_t)triangles, sizeof *e, edge_order)) good = 0;
        if (i > 0 && edge_order(e[i], e[i - 1]) == 0) good = 0;
    }
    free(e);
    printf("%d vertices, %d triangles, Euler number %d, %s\n", vertices, triangles, vertices - triangles / 2,
           good ? "closed" : "NOT CLOSED");
    printf("volume %.4f m3, smallest angle %.1f degrees, longest edge %.4f m\n", volume, worst, longest);
    return good && volume > 0.0;
}

static int write_obj(const char *path) {
    FILE *f = fopen(path, "w");
    int i, bad;
    if (!f) return perror(path), 1;
    fprintf(f, "# figure.obj - Pip, a small plush dinosaur; %d vertices, %d triangles, closed\n", vertices, triangles);
    fprintf(f, "# z up, facing -y, 1 m tall, standing on z = 0\n");
    fprintf(f, "# made by examples/models/figure.c from a smooth union of capsules; license MIT\n");
    for (i = 0; i < vertices; ++i) fprintf(f, "v %.5f %.5f %.5f\n", v[i][0], v[i][1], v[i][2]);
    for (i = 0; i < triangles; ++i) fprintf(f, "f %d %d %d\n", t[i][0] + 1, t[i][1] + 1, t[i][2] + 1);
    bad = ferror(f) != 0;
    return fclose(f) != 0 || bad;
}

int main(int argc, char **argv) {
    place_vertices();
    connect();
    smooth(12);
    fit();
    if (!verify()) return 1;
    return write_obj(argc > 1 ? argv[1] : "figure.obj");
}
