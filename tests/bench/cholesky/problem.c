/* tests/bench/cholesky/problem.c - the matrices of the Cholesky benchmark: lattices and their neighbours. */
#include "../bench.h"
#include "solver.h"
#include <math.h>
#include <stdint.h>

typedef struct lattice {
    int size[3];
    int *index; /* of each node: which point it is, or -1 */
    int count;
} lattice;

static int node(const lattice *l, int i, int j, int k) { return i + l->size[0] * (j + l->size[1] * k); }

static void lattice_size(lattice *l, int shape, int count) {
    double pi = 3.14159265358979323846, side = shape == SHEET ? sqrt(count) : cbrt(shape == BEAM ? count / 8.0 : count);
    l->size[0] = l->size[1] = l->size[2] = (int)(side + 0.5);
    if (shape == BALL) l->size[0] = l->size[1] = l->size[2] = 2 * (int)cbrt(0.75 * count / pi) + 1;
    if (shape == BEAM) l->size[0] = (int)(count / (double)(l->size[1] * l->size[2]) + 0.5);
    if (shape == SHEET) l->size[2] = 1;
}

/* Numbers the nodes that belong to the shape. */
static void lattice_create(lattice *l, int shape, int count) {
    int i, j, k, half;
    double radius = cbrt(0.75 * count / 3.14159265358979323846);
    lattice_size(l, shape, count);
    half = l->size[0] / 2;
    l->index = (int *)bench_obtain(sizeof(int) * (size_t)l->size[0] * (size_t)l->size[1] * (size_t)l->size[2]);
    l->count = 0;
    for (k = 0; k < l->size[2]; k++)
        for (j = 0; j < l->size[1]; j++)
            for (i = 0; i < l->size[0]; i++) {
                int x = i - half, y = j - half, z = k - half;
                int inside = shape != BALL || x * x + y * y + z * z <= radius * radius;
                l->index[node(l, i, j, k)] = inside ? l->count++ : -1;
            }
}

/* Lists the points nearer than the horizon in ascending order; returns how many. */
static int neighbours(const lattice *l, const double *at, double horizon, int *list) {
    int reach = (int)horizon, count = 0, x, y, z;
    for (z = -reach; z <= reach; z++)
        for (y = -reach; y <= reach; y++)
            for (x = -reach; x <= reach; x++) {
                int i = (int)at[0] + x, j = (int)at[1] + y, k = (int)at[2] + z, near = x * x + y * y + z * z;
                if (near == 0 || near > horizon * horizon - 1e-6) continue;
                if (i < 0 || j < 0 || k < 0 || i >= l->size[0] || j >= l->size[1] || k >= l->size[2]) continue;
                if (l->index[node(l, i, j, k)] >= 0) list[count++] = l->index[node(l, i, j, k)];
            }
    return count;
}

void problem_create(problem *p, int shape, int count, double horizon) {
    lattice l;
    int i, j, k, most = 2 * (int)horizon + 1, list[512];
    lattice_create(&l, shape, count);
    p->n = l.count;
    p->xyz = (double *)bench_obtain(3 * sizeof(double) * (size_t)p->n);
    p->diagonal = (double *)bench_obtain(sizeof(double) * (size_t)p->n);
    p->row = (int *)bench_obtain(sizeof(int) * ((size_t)p->n + 1));
    p->col = (int *)bench_obtain(sizeof(int) * (size_t)p->n * (size_t)(most * most * most));
    for (k = 0; k < l.size[2]; k++)
        for (j = 0; j < l.size[1]; j++)
            for (i = 0; i < l.size[0]; i++) {
                double *x = p->xyz + 3 * (size_t)l.index[node(&l, i, j, k)];
                if (l.index[node(&l, i, j, k)] < 0) continue;
                x[0] = i;
                x[1] = j;
                x[2] = k;
            }
    p->row[0] = 0;
    for (i = 0; i < p->n; i++) {
        int near = neighbours(&l, p->xyz + 3 * (size_t)i, horizon, list);
        memcpy(p->col + p->row[i], list, sizeof *list * (size_t)near);
        p->row[i + 1] = p->row[i] + near;
    }
    p->value = (double *)bench_obtain(sizeof(double) * (size_t)p->row[p->n]);
    free(l.index);
}

/* In [0.9, 1.1), the same for (i, j) and (j, i). */
static double weight(int i, int j) {
    uint64_t h = ((uint64_t)(i < j ? i : j) << 32 | (uint32_t)(i < j ? j : i)) * 0x9e3779b97f4a7c15ULL;
    h = (h ^ h >> 29) * 0xbf58476d1ce4e5b9ULL;
    return 0.9 + 0.2 * ldexp((double)(h >> 11), -53);
}

void problem_set(problem *p, double kappa) {
    double sum = 0, scale;
    int i, k;
    for (i = 0; i < p->n; i++)
        for (k = p->row[i]; k < p->row[i + 1]; k++) sum += p->value[k] = weight(i, p->col[k]);
    scale = kappa * p->n / sum;
    for (i = 0; i < p->n; i++) {
        p->diagonal[i] = 1;
        for (k = p->row[i]; k < p->row[i + 1]; k++) {
            p->diagonal[i] += p->value[k] * scale;
            p->value[k] *= -scale;
        }
    }
}

double problem_residual(const problem *p, const double *b, const double *x, double *r) {
    double of_r[3] = {0, 0, 0}, of_b[3] = {0, 0, 0}, worst = 0;
    int i, k, c;
    for (i = 0; i < p->n; i++)
        for (c = 0; c < 3; c++) {
            size_t at = 3 * (size_t)i + (size_t)c;
            double sum = b[at] - p->diagonal[i] * x[at];
            for (k = p->row[i]; k < p->row[i + 1]; k++) sum -= p->value[k] * x[3 * (size_t)p->col[k] + (size_t)c];
            r[at] = sum;
            of_r[c] += sum * sum;
            of_b[c] += b[at] * b[at];
        }
    for (c = 0; c < 3; c++) {
        double relative = sqrt(of_r[c] / of_b[c]);
        if (!(relative < 1e30)) return 1e30;
        if (relative > worst) worst = relative;
    }
    return worst;
}

void problem_destroy(problem *p) {
    free(p->row);
    free(p->col);
    free(p->value);
    free(p->diagonal);
    free(p->xyz);
}
