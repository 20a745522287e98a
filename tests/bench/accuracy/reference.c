/* tests/bench/accuracy/reference.c - finite elements for the scenes `drop` and `pile`: prints the tables that
   ../accuracy.c compares with. It knows nothing of peri.

       cc -std=c99 -O3 -march=native -o build/reference tests/bench/accuracy/reference.c -lm
       build/reference drop 16 800 5e8; build/reference pile 12 600 2e8

   Arguments: scene, bricks over a side, steps a moment, bed (Pa/m); a minute or two each. The energy goes to stderr.

   Trilinear bricks of 2 x 2 x 2 points, neo-Hookean mu/2 (I1 - 3) - mu log J + lambda/2 log^2 J, lumped masses, central
   differences. Contact is a spring of `bed` Pa a metre of overlap on every node of a lower face, against the ground or
   the upper face of the cube below; friction a spring as stiff along the surface, whose foot slides as Coulomb's law
   says. Nothing else takes energy, so what is printed of it says whether the step is short enough. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "scene.h"

static const double young = 1e5, poisson = 0.25, density = 1000, gravity = 9.81;
static double bed = 2e8, friction; /* friction: of the scene */
static int n; /* bricks over a side */

typedef struct cube {
    double side, *rest, *x, *v, *f, *mass; /* 3 or 1 a node, x fastest */
    double *foot;                          /* 3 a node of the lower face: (0 or 1: touching), where friction holds it */
    double *under;                         /* 2 a node of the lower face: where it is over the face below, in bricks */
} cube;

static cube all[CUBES];
static int count;
static double potential;

static int at(int i, int j, int k) { return i + (n + 1) * (j + (n + 1) * k); }

static double *room(size_t size) {
    double *p = (double *)calloc(size, sizeof *p);
    if (!p) exit(2);
    return p;
}

static double share(int i, int j) { /* of a face's brick that a node on it has */
    return (i == 0 || i == n ? 0.5 : 1) * (j == 0 || j == n ? 0.5 : 1);
}

static void begin(int scene) {
    size_t nodes = (size_t)((n + 1) * (n + 1) * (n + 1)), face = (size_t)((n + 1) * (n + 1));
    int q, i, j, k;
    count = scene == PILE ? CUBES : 1;
    for (q = 0; q < count; q++) {
        cube *c = &all[q];
        double low = scene == PILE ? 0.02 : 0.05, d;
        c->side = scene == PILE ? 0.24 - 0.04 * q : 0.2;
        for (k = 0; k < q; k++) low += all[k].side + 0.02;
        d = c->side / n;
        c->rest = room(3 * nodes), c->x = room(3 * nodes), c->v = room(3 * nodes), c->f = room(3 * nodes);
        c->mass = room(nodes), c->foot = room(3 * face), c->under = room(2 * face);
        for (k = 0; k <= n; k++)
            for (j = 0; j <= n; j++)
                for (i = 0; i <= n; i++) {
                    double *x = c->rest + 3 * at(i, j, k);
                    x[0] = (i - 0.5 * n) * d;
                    x[1] = (j - 0.5 * n) * d;
                    x[2] = low + k * d;
                    c->v[3 * at(i, j, k) + 2] = scene == PILE ? 0 : -2;
                    c->mass[at(i, j, k)] = density * d * d * d * share(i, j) * (k == 0 || k == n ? 0.5 : 1);
                }
        memcpy(c->x, c->rest, 3 * nodes * sizeof *c->x);
        for (j = 0; j <= n && q; j++)
            for (i = 0; i <= n; i++)
                for (k = 0; k < 2; k++)
                    c->under[2 * (i + (n + 1) * j) + k] = c->rest[3 * at(i, j, 0) + k] / all[q - 1].side * n + 0.5 * n;
    }
}

/* P = mu (F - F^-T) + lambda log J F^-T at det F = J; returns the energy density. */
static double stress(double f[3][3], double p[3][3]) {
    double mu = young / (2 + 2 * poisson), lambda = young * poisson / ((1 + poisson) * (1 - 2 * poisson));
    double cof[3][3], j, trace = 0, log_j;
    int a, b;
    for (a = 0; a < 3; a++)
        for (b = 0; b < 3; b++) {
            int a1 = (a + 1) % 3, a2 = (a + 2) % 3, b1 = (b + 1) % 3, b2 = (b + 2) % 3;
            cof[a][b] = f[a1][b1] * f[a2][b2] - f[a1][b2] * f[a2][b1];
            trace += f[a][b] * f[a][b];
        }
    j = f[0][0] * cof[0][0] + f[0][1] * cof[0][1] + f[0][2] * cof[0][2];
    log_j = log(j);
    for (a = 0; a < 3; a++)
        for (b = 0; b < 3; b++) p[a][b] = mu * f[a][b] + (lambda * log_j - mu) / j * cof[a][b];
    return mu / 2 * (trace - 3) - mu * log_j + lambda / 2 * log_j * log_j;
}

/* Slopes of a brick's eight functions at its eight points, times the brick's edge. */
static double slope[8][8][3];

static void slopes(void) {
    double g = 0.5 / sqrt(3);
    int q, a, c, o;
    for (q = 0; q < 8; q++)
        for (a = 0; a < 8; a++)
            for (c = 0; c < 3; c++) {
                double s = (a >> c & 1) ? 1 : -1;
                for (o = 0; o < 3; o++)
                    if (o != c) s *= 0.5 + ((a >> o & 1) ? 1 : -1) * ((q >> o & 1) ? g : -g);
                slope[q][a][c] = s;
            }
}

static void elastic(cube *c) {
    double d = c->side / n, weight = d * d * d / 8;
    int i, j, k, q, a, r, s;
    for (k = 0; k < n; k++)
        for (j = 0; j < n; j++)
            for (i = 0; i < n; i++) {
                double x[8][3], force[8][3] = {{0}};
                int node[8];
                for (a = 0; a < 8; a++) {
                    node[a] = 3 * at(i + (a & 1), j + (a >> 1 & 1), k + (a >> 2));
                    memcpy(x[a], c->x + node[a], sizeof x[a]);
                }
                for (q = 0; q < 8; q++) {
                    double f[3][3] = {{0}}, p[3][3];
                    for (a = 0; a < 8; a++)
                        for (r = 0; r < 3; r++)
                            for (s = 0; s < 3; s++) f[r][s] += x[a][r] * slope[q][a][s] / d;
                    potential += weight * stress(f, p);
                    for (a = 0; a < 8; a++)
                        for (r = 0; r < 3; r++)
                            for (s = 0; s < 3; s++) force[a][r] -= weight * p[r][s] * slope[q][a][s] / d;
                }
                for (a = 0; a < 8; a++)
                    for (r = 0; r < 3; r++) c->f[node[a] + r] += force[a][r];
            }
}

/* The upper face of c at u, v (bricks): the place, its slopes along u and v, the nodes and their shares. */
static void surface(const cube *c, const double uv[2], double x[3], double t[2][3], int node[4], double own[4]) {
    int i = (int)uv[0], j = (int)uv[1], a, r;
    double u, v;
    i = i < 0 ? 0 : i > n - 1 ? n - 1 : i;
    j = j < 0 ? 0 : j > n - 1 ? n - 1 : j;
    u = uv[0] - i, v = uv[1] - j;
    memset(x, 0, 3 * sizeof *x);
    memset(t, 0, 6 * sizeof **t);
    for (a = 0; a < 4; a++) {
        double wu = a & 1 ? u : 1 - u, wv = a >> 1 ? v : 1 - v;
        node[a] = 3 * at(i + (a & 1), j + (a >> 1), n);
        own[a] = wu * wv;
        for (r = 0; r < 3; r++) {
            x[r] += own[a] * c->x[node[a] + r];
            t[0][r] += (a & 1 ? 1 : -1) * wv * c->x[node[a] + r];
            t[1][r] += (a >> 1 ? 1 : -1) * wu * c->x[node[a] + r];
        }
    }
}

static double dot(const double *a, const double *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

/* The place uv of the face of `below` that is nearest to p, from the one known; its normal. */
static void project(const cube *below, const double *p, double *uv, double *x, double *normal, int *node, double *own) {
    double t[2][3], length;
    int k, r;
    for (k = 0; k < 3; k++) {
        double away[3], a, b, d, det, to[2];
        surface(below, uv, x, t, node, own);
        for (r = 0; r < 3; r++) away[r] = p[r] - x[r];
        a = dot(t[0], t[0]), b = dot(t[0], t[1]), d = dot(t[1], t[1]);
        to[0] = dot(t[0], away), to[1] = dot(t[1], away);
        det = a * d - b * b;
        uv[0] += (d * to[0] - b * to[1]) / det;
        uv[1] += (a * to[1] - b * to[0]) / det;
    }
    surface(below, uv, x, t, node, own);
    for (r = 0; r < 3; r++)
        normal[r] = t[0][(r + 1) % 3] * t[1][(r + 2) % 3] - t[0][(r + 2) % 3] * t[1][(r + 1) % 3];
    length = sqrt(dot(normal, normal));
    for (r = 0; r < 3; r++) normal[r] /= length;
}

/* Springs between the lower face of c and what is below it: the ground, or another cube. */
static void contact(cube *c, cube *below) {
    int i, j, r, a;
    for (j = 0; j <= n; j++)
        for (i = 0; i <= n; i++) {
            int node = 3 * at(i, j, 0), under[4] = {0}, face = i + (n + 1) * j;
            double k = bed * share(i, j) * c->side * c->side / n / n, *p = c->x + node, *foot = c->foot + 3 * face;
            double normal[3] = {0, 0, 1}, x[3] = {p[0], p[1], 0}, own[4] = {0}, hold[3] = {p[0], p[1], 0}, away[3];
            double *uv = c->under + 2 * face, t[2][3], push, along, force[3];
            if (below) project(below, p, uv, x, normal, under, own);
            for (r = 0; r < 3; r++) away[r] = p[r] - x[r];
            push = -k * dot(away, normal);
            if (push <= 0 || (below && (uv[0] < 0 || uv[1] < 0 || uv[0] > n || uv[1] > n))) {
                foot[0] = 0;
                continue;
            }
            /* the foot: a place of the ground, or of the face below in bricks */
            if (!foot[0]) foot[0] = 1, foot[1] = below ? uv[0] : p[0], foot[2] = below ? uv[1] : p[1];
            if (below) surface(below, foot + 1, hold, t, (int[4]){0}, (double[4]){0});
            else hold[0] = foot[1], hold[1] = foot[2], hold[2] = 0;
            for (r = 0; r < 3; r++) away[r] = hold[r] - p[r];
            for (along = dot(away, normal), r = 0; r < 3; r++) away[r] -= along * normal[r];
            along = k * sqrt(dot(away, away));
            potential += push * push / k / 2;
            if (along > friction * push) {
                double keep = friction * push / along;
                if (below) foot[1] = uv[0] + keep * (foot[1] - uv[0]), foot[2] = uv[1] + keep * (foot[2] - uv[1]);
                else foot[1] = p[0] + keep * (foot[1] - p[0]), foot[2] = p[1] + keep * (foot[2] - p[1]);
                for (r = 0; r < 3; r++) away[r] *= keep;
                along = friction * push;
            }
            potential += along * along / k / 2;
            for (r = 0; r < 3; r++) force[r] = push * normal[r] + k * away[r];
            for (r = 0; r < 3; r++) c->f[node + r] += force[r];
            for (a = 0; a < 4 && below; a++)
                for (r = 0; r < 3; r++) below->f[under[a] + r] -= own[a] * force[r];
        }
}

static double step(double dt) {
    size_t nodes = (size_t)((n + 1) * (n + 1) * (n + 1)), i;
    double moving = 0;
    int q, r;
    potential = 0;
    for (q = 0; q < count; q++) memset(all[q].f, 0, 3 * nodes * sizeof *all[q].f);
    for (q = 0; q < count; q++) {
        elastic(&all[q]);
        contact(&all[q], q ? &all[q - 1] : NULL);
    }
    for (q = 0; q < count; q++)
        for (i = 0; i < nodes; i++) {
            cube *c = &all[q];
            potential += c->mass[i] * gravity * c->x[3 * i + 2];
            for (r = 0; r < 3; r++) {
                double *v = c->v + 3 * i + r, was = *v;
                *v += dt * (c->f[3 * i + r] / c->mass[i] - (r == 2 ? gravity : 0));
                moving += c->mass[i] * was * *v / 2;
                c->x[3 * i + r] += dt * *v;
            }
        }
    return moving + potential;
}

static double centre(const cube *c, const double *x) {
    double sum = 0, mass = 0;
    int i;
    for (i = 0; i < (n + 1) * (n + 1) * (n + 1); i++) sum += c->mass[i] * x[3 * i + 2], mass += c->mass[i];
    return sum / mass;
}

static double height(const double *x) {
    double sum = 0;
    int i, j;
    for (j = 0; j <= n; j++)
        for (i = 0; i <= n; i++) sum += share(i, j) * (x[3 * at(i, j, n) + 2] - x[3 * at(i, j, 0) + 2]);
    return sum / n / n;
}

int main(int argc, char **argv) {
    int scene = argc > 1 && strcmp(argv[1], "pile") == 0 ? PILE : DROP, m, k, q;
    int moments = scene == PILE ? 15 : 7, steps = argc > 3 ? atoi(argv[3]) : 400;
    double duration = scene == PILE ? 1 : 7.0 / 30, dt = duration / moments / steps, energy = 0;
    n = argc > 2 ? atoi(argv[2]) : 8;
    if (argc > 4) bed = atof(argv[4]);
    friction = scene == PILE ? 0.5 : 0;
    slopes();
    begin(scene);
    for (q = 0; q < count; q++) /* velocities are half a step behind */
        for (k = 2; k < 3 * (n + 1) * (n + 1) * (n + 1); k += 3) all[q].v[k] += dt / 2 * gravity;
    for (m = 0; m < moments; m++) {
        double seen[2] = {0, 0}, mass = 0;
        for (k = 0; k < steps; k++) energy = step(dt);
        for (q = 0; q < count; q++) {
            double own = pow(all[q].side, 3);
            seen[1] = centre(&all[q], all[q].x) - centre(&all[q], all[q].rest);
            seen[0] += own * seen[1], mass += own;
        }
        seen[0] /= mass;
        if (scene == DROP) seen[1] = height(all[0].x) - height(all[0].rest);
        printf("{%.6f, %.6f},%s", seen[0], seen[1], m % 4 == 3 || m == moments - 1 ? "\n" : " ");
        fprintf(stderr, "%d: energy %.4f J\n", m, energy);
    }
    return 0;
}
