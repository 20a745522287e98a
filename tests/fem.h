/* tests/fem.h - finite elements, the independent reference of the stability atlas: a box of quadratic bricks, 27 nodes
   each, total Lagrangian, backward Euler or static, Newton with a line search, banded LDL^T, double. It knows nothing
   of peri: no particle, no bond, no header of it.

   Laws: neo-Hookean mu/2 (I1 - 3) - mu log J + lambda/2 log^2 J, St. Venant-Kirchhoff mu E:E + lambda/2 tr(E)^2. The
   lambda part is integrated at 2 x 2 x 2 points, the rest at 3 x 3 x 3 (selective integration), so that nothing locks
   up to a Poisson's ratio of 0.499. How near a mesh is to a finer one is printed by the atlas ("elements").

       fem f;
       fem_begin(&f, elements, size, FEM_NEO_HOOKEAN, young, poisson);     the box [0, size]
       fem_mass(&f, density, density of the last quarter along x, gravity);
       f.held[node] = 1; f.x[...] = ...;                                   x of held nodes is the caller's
       bad = fem_step(&f, dt);                                             dt 0: static
       fem_at(f.x, &f, material_point, place);
       fem_end(&f); */
#ifndef PERI_TESTS_FEM_H
#define PERI_TESTS_FEM_H

#include <math.h>
#include <stdlib.h>
#include <string.h>

typedef enum fem_law { FEM_NEO_HOOKEAN, FEM_STVK } fem_law;

typedef struct fem {
    int elements[3], side[3], nodes, band; /* nodes along each axis; half bandwidth in nodes */
    double size[3];
    fem_law law;
    double lambda, mu, gravity[3];
    double *rest, *x, *v; /* 3 nodes */
    unsigned char *held;  /* nodes */
    double *mass;         /* nodes * (band + 1): row i, column i - band + k */
    double *k;            /* 3 nodes * (3 band + 3): the factor; lower rows likewise */
    double *f, *step, *aim, *old;
    int factored;         /* the factor is of a near state: tried first */
    double factored_dt;
} fem;

static int fem_node(const fem *f, int i, int j, int k) { return (i * f->side[1] + j) * f->side[2] + k; }

static double *fem_room(size_t n) {
    double *p = (double *)calloc(n, sizeof *p);
    if (!p) exit(2);
    return p;
}

static void fem_begin(fem *f, const int elements[3], const double size[3], fem_law law, double young, double poisson) {
    int i, j, k, c;
    memset(f, 0, sizeof *f);
    for (c = 0; c < 3; c++) {
        f->elements[c] = elements[c];
        f->side[c] = 2 * elements[c] + 1;
        f->size[c] = size[c];
    }
    f->nodes = f->side[0] * f->side[1] * f->side[2];
    f->band = 2 * f->side[1] * f->side[2] + 2 * f->side[2] + 2;
    f->law = law;
    f->mu = young / (2 * (1 + poisson));
    f->lambda = young * poisson / ((1 + poisson) * (1 - 2 * poisson));
    f->rest = fem_room(3 * (size_t)f->nodes);
    f->x = fem_room(3 * (size_t)f->nodes);
    f->v = fem_room(3 * (size_t)f->nodes);
    f->f = fem_room(3 * (size_t)f->nodes);
    f->step = fem_room(3 * (size_t)f->nodes);
    f->aim = fem_room(3 * (size_t)f->nodes);
    f->old = fem_room(3 * (size_t)f->nodes);
    f->mass = fem_room((size_t)f->nodes * (size_t)(f->band + 1));
    f->k = fem_room(3 * (size_t)f->nodes * (size_t)(3 * f->band + 3));
    f->held = (unsigned char *)calloc((size_t)f->nodes, 1);
    if (!f->held) exit(2);
    for (i = 0; i < f->side[0]; i++)
        for (j = 0; j < f->side[1]; j++)
            for (k = 0; k < f->side[2]; k++) {
                double *p = f->rest + 3 * fem_node(f, i, j, k);
                p[0] = size[0] * i / (f->side[0] - 1);
                p[1] = size[1] * j / (f->side[1] - 1);
                p[2] = size[2] * k / (f->side[2] - 1);
            }
    memcpy(f->x, f->rest, 3 * (size_t)f->nodes * sizeof *f->x);
}

static void fem_end(fem *f) {
    free(f->rest); free(f->x); free(f->v); free(f->f); free(f->step); free(f->aim); free(f->old);
    free(f->mass); free(f->k); free(f->held);
    memset(f, 0, sizeof *f);
}

/* The three quadratic Lagrange functions of -1, 0, 1 at s, and their slopes. */
static void fem_line(double s, double n[3], double d[3]) {
    n[0] = s * (s - 1) / 2; n[1] = 1 - s * s; n[2] = s * (s + 1) / 2;
    d[0] = s - 0.5; d[1] = -2 * s; d[2] = s + 0.5;
}

/* Shape functions at the local point s in [-1, 1]^3 and gradients with respect to the material point. */
static void fem_shape(const fem *f, const double s[3], double n[27], double grad[27][3]) {
    double a[3][3], d[3][3];
    int i, j, k, c;
    for (c = 0; c < 3; c++) {
        fem_line(s[c], a[c], d[c]);
        for (i = 0; i < 3; i++) d[c][i] *= 2 * f->elements[c] / f->size[c];
    }
    for (i = 0; i < 3; i++)
        for (j = 0; j < 3; j++)
            for (k = 0; k < 3; k++) {
                int q = 9 * i + 3 * j + k;
                n[q] = a[0][i] * a[1][j] * a[2][k];
                grad[q][0] = d[0][i] * a[1][j] * a[2][k];
                grad[q][1] = a[0][i] * d[1][j] * a[2][k];
                grad[q][2] = a[0][i] * a[1][j] * d[2][k];
            }
}

static void fem_corners(const fem *f, int e, int node[27]) {
    int ez = e % f->elements[2], ey = e / f->elements[2] % f->elements[1], ex = e / f->elements[2] / f->elements[1];
    int q;
    for (q = 0; q < 27; q++) node[q] = fem_node(f, 2 * ex + q / 9, 2 * ey + q / 3 % 3, 2 * ez + q % 3);
}

/* Where the material point X is under the nodal positions x. */
static void fem_at(const double *x, const fem *f, const double X[3], double out[3]) {
    double s[3], n[27], grad[27][3];
    int cell[3], node[27], c, q;
    for (c = 0; c < 3; c++) {
        double t = X[c] / f->size[c] * f->elements[c];
        cell[c] = (int)floor(t);
        if (cell[c] < 0) cell[c] = 0;
        if (cell[c] >= f->elements[c]) cell[c] = f->elements[c] - 1;
        s[c] = 2 * (t - cell[c]) - 1;
    }
    fem_shape(f, s, n, grad);
    fem_corners(f, (cell[0] * f->elements[1] + cell[1]) * f->elements[2] + cell[2], node);
    for (c = 0; c < 3; c++)
        for (out[c] = 0, q = 0; q < 27; q++) out[c] += n[q] * x[3 * node[q] + c];
}

/* Gauss points of an element: the first 27 of order 3, then 8 of order 2. Weights sum to one each. */
static void fem_gauss(int g, double s[3], double *weight) {
    static const double place[3] = {-0.774596669241483377, 0, 0.774596669241483377}, w[3] = {5, 8, 5};
    int c;
    if (g < 27) {
        s[0] = place[g / 9]; s[1] = place[g / 3 % 3]; s[2] = place[g % 3];
        *weight = w[g / 9] * w[g / 3 % 3] * w[g % 3] / 5832;
        return;
    }
    for (c = 0; c < 3; c++) s[c] = (((g - 27) >> c) & 1) ? 0.577350269189625765 : -0.577350269189625765;
    *weight = 0.125;
}

/* Consistent mass matrix; gravity acts by it. */
static void fem_mass(fem *f, double density, double tip_density, const double gravity[3]) {
    double volume = f->size[0] * f->size[1] * f->size[2] / (f->elements[0] * f->elements[1] * f->elements[2]);
    int e, g, a, b, node[27], count = f->elements[0] * f->elements[1] * f->elements[2];
    memcpy(f->gravity, gravity, sizeof f->gravity);
    for (e = 0; e < count; e++) {
        int last = 4 * (e / f->elements[1] / f->elements[2]) >= 3 * f->elements[0];
        fem_corners(f, e, node);
        for (g = 0; g < 27; g++) {
            double s[3], w, n[27], grad[27][3];
            fem_gauss(g, s, &w);
            fem_shape(f, s, n, grad);
            w *= volume * (last ? tip_density : density);
            for (a = 0; a < 27; a++)
                for (b = 0; b < 27; b++)
                    if (node[b] <= node[a])
                        f->mass[(size_t)node[a] * (size_t)(f->band + 1) + (size_t)(node[b] - node[a] + f->band)] +=
                            w * n[a] * n[b];
        }
    }
}

/* out = M in (3 nodes). */
static void fem_times_mass(const fem *f, const double *in, double *out) {
    int i, j, c;
    memset(out, 0, 3 * (size_t)f->nodes * sizeof *out);
    for (i = 0; i < f->nodes; i++)
        for (j = i > f->band ? i - f->band : 0; j <= i; j++) {
            double m = f->mass[(size_t)i * (size_t)(f->band + 1) + (size_t)(j - i + f->band)];
            for (c = 0; c < 3; c++) {
                out[3 * i + c] += m * in[3 * j + c];
                if (j != i) out[3 * j + c] += m * in[3 * i + c];
            }
        }
}

static double fem_inverse(const double a[9], double b[9]) {
    double det;
    int k;
    b[0] = a[4] * a[8] - a[5] * a[7]; b[1] = a[2] * a[7] - a[1] * a[8]; b[2] = a[1] * a[5] - a[2] * a[4];
    b[3] = a[5] * a[6] - a[3] * a[8]; b[4] = a[0] * a[8] - a[2] * a[6]; b[5] = a[2] * a[3] - a[0] * a[5];
    b[6] = a[3] * a[7] - a[4] * a[6]; b[7] = a[1] * a[6] - a[0] * a[7]; b[8] = a[0] * a[4] - a[1] * a[3];
    det = a[0] * b[0] + a[1] * b[3] + a[2] * b[6];
    for (k = 0; k < 9; k++) b[k] /= det;
    return det;
}

/* Energy of one part (0: mu, 1: lambda) at the gradient F, nominal stress P and, when A is not NULL, A = dP/dF. */
static double fem_neo_hookean(const fem *f, int part, const double F[9], double P[9], double A[9][9]) {
    double inv[9], det = fem_inverse(F, inv), l, p = part ? f->lambda : f->mu;
    int i, j, k, m;
    if (!(det > 0)) return HUGE_VAL;
    l = log(det);
    for (i = 0; i < 3; i++)
        for (j = 0; j < 3; j++) {
            double t = inv[3 * j + i];
            P[3 * i + j] = part ? p * l * t : p * (F[3 * i + j] - t);
            if (!A) continue;
            for (k = 0; k < 3; k++)
                for (m = 0; m < 3; m++) {
                    double turn = inv[3 * m + i] * inv[3 * j + k]; /* (F^-T dF^T F^-T) */
                    A[3 * i + j][3 * k + m] = part ? p * (t * inv[3 * m + k] - l * turn)
                                                   : p * ((i == k && j == m) + turn);
                }
        }
    if (part) return p / 2 * l * l;
    for (l = -3 - 2 * l, k = 0; k < 9; k++) l += F[k] * F[k];
    return p / 2 * l;
}

static double fem_stvk(const fem *f, int part, const double F[9], double P[9], double A[9][9]) {
    double E[9], S[9], trace = 0, energy = 0;
    int i, j, k, m, q;
    for (i = 0; i < 3; i++)
        for (j = 0; j < 3; j++) {
            E[3 * i + j] = -0.5 * (i == j);
            for (k = 0; k < 3; k++) E[3 * i + j] += 0.5 * F[3 * k + i] * F[3 * k + j];
        }
    trace = E[0] + E[4] + E[8];
    for (k = 0; k < 9; k++) {
        S[k] = part ? (k % 4 == 0) * f->lambda * trace : 2 * f->mu * E[k];
        energy += part ? 0 : f->mu * E[k] * E[k];
    }
    for (i = 0; i < 3; i++)
        for (j = 0; j < 3; j++) {
            for (P[3 * i + j] = 0, k = 0; k < 3; k++) P[3 * i + j] += F[3 * i + k] * S[3 * k + j];
            if (!A) continue;
            for (k = 0; k < 3; k++)
                for (m = 0; m < 3; m++) { /* dF = e_k e_m: dS = lambda tr(dE) 1 or 2 mu dE, dE = sym(F^T dF) */
                    double a = (i == k) * S[3 * m + j];
                    if (part) a += F[3 * i + j] * f->lambda * F[3 * k + m];
                    else for (q = 0; q < 3; q++)
                        a += F[3 * i + q] * f->mu * (F[3 * k + q] * (m == j) + (q == m) * F[3 * k + j]);
                    A[3 * i + j][3 * k + m] = a;
                }
        }
    return part ? f->lambda / 2 * trace * trace : energy;
}

/* K of one Gauss point into the band: rows and columns a, b with node[b] <= node[a]. */
static void fem_stiffness(fem *f, const int node[27], double grad[27][3], double A[9][9], double w) {
    size_t wide = 3 * (size_t)f->band + 3;
    int a, b, i, k, j, m;
    for (a = 0; a < 27; a++) {
        double G[3][9]; /* G[i] = sum_j grad_a[j] A[ij][..] */
        for (i = 0; i < 3; i++)
            for (m = 0; m < 9; m++)
                for (G[i][m] = 0, j = 0; j < 3; j++) G[i][m] += w * grad[a][j] * A[3 * i + j][m];
        for (b = 0; b < 27; b++) {
            if (node[b] > node[a]) continue;
            for (i = 0; i < 3; i++)
                for (k = 0; k < 3; k++) {
                    int row = 3 * node[a] + i, col = 3 * node[b] + k;
                    if (col > row) continue;
                    f->k[(size_t)row * wide + (size_t)(col - row) + wide - 1] +=
                        G[i][3 * k] * grad[b][0] + G[i][3 * k + 1] * grad[b][1] + G[i][3 * k + 2] * grad[b][2];
                }
        }
    }
}

/* Energy of step and matter at f->x; the gradient into f->f; the matrix into f->k when asked. HUGE_VAL: inverted. */
static double fem_energy(fem *f, double dt, int matrix) {
    int count = f->elements[0] * f->elements[1] * f->elements[2], e, g, q, i, j, c, node[27];
    double volume = f->size[0] * f->size[1] * f->size[2] / count, energy = 0;
    size_t wide = 3 * (size_t)f->band + 3;
    memset(f->f, 0, 3 * (size_t)f->nodes * sizeof *f->f);
    if (matrix) memset(f->k, 0, 3 * (size_t)f->nodes * wide * sizeof *f->k);
    for (e = 0; e < count; e++) {
        fem_corners(f, e, node);
        for (g = 0; g < 35; g++) {
            double s[3], w, n[27], grad[27][3], F[9], P[9], A[9][9], psi;
            fem_gauss(g, s, &w);
            fem_shape(f, s, n, grad);
            w *= volume;
            memset(F, 0, sizeof F);
            for (q = 0; q < 27; q++)
                for (i = 0; i < 3; i++)
                    for (j = 0; j < 3; j++) F[3 * i + j] += f->x[3 * node[q] + i] * grad[q][j];
            psi = (f->law == FEM_STVK ? fem_stvk : fem_neo_hookean)(f, g >= 27, F, P, matrix ? A : NULL);
            if (!(psi < HUGE_VAL)) return HUGE_VAL;
            energy += w * psi;
            for (q = 0; q < 27; q++)
                for (i = 0; i < 3; i++)
                    f->f[3 * node[q] + i] +=
                        w * (P[3 * i] * grad[q][0] + P[3 * i + 1] * grad[q][1] + P[3 * i + 2] * grad[q][2]);
            if (matrix) fem_stiffness(f, node, grad, A, w);
        }
    }
    /* inertia: (x - aim) M (x - aim) / 2 dt^2, gravity being in the aim; static: -g M x */
    {
        double *away = f->step, *pull = fem_room(3 * (size_t)f->nodes), scale = dt > 0 ? 1 / (dt * dt) : 1;
        for (i = 0; i < 3 * f->nodes; i++) away[i] = dt > 0 ? f->x[i] - f->aim[i] : f->gravity[i % 3];
        fem_times_mass(f, away, pull);
        for (i = 0; i < 3 * f->nodes; i++) {
            energy += dt > 0 ? 0.5 * scale * away[i] * pull[i] : -pull[i] * (f->x[i] - f->rest[i]);
            f->f[i] += dt > 0 ? scale * pull[i] : -pull[i];
        }
        free(pull);
        for (i = 0; matrix && dt > 0 && i < f->nodes; i++)
            for (j = i > f->band ? i - f->band : 0; j <= i; j++)
                for (c = 0; c < 3; c++)
                    f->k[(size_t)(3 * i + c) * wide + (size_t)(3 * (j - i)) + wide - 1] +=
                        scale * f->mass[(size_t)i * (size_t)(f->band + 1) + (size_t)(j - i + f->band)];
    }
    for (i = 0; i < f->nodes; i++)
        if (f->held[i]) f->f[3 * i] = f->f[3 * i + 1] = f->f[3 * i + 2] = 0;
    return energy;
}

/* LDL^T in place: row r holds L of columns r - wide + 1 .. r - 1, D last. */
static int fem_factor(fem *f) {
    int n = 3 * f->nodes, wide = 3 * f->band + 3, r, c, k, low, positive = 1;
    for (r = 0; r < n; r++) {
        double *row = f->k + (size_t)r * (size_t)wide + wide - 1 - r; /* row[c] is entry (r, c) */
        double d;
        low = r - wide + 1 > 0 ? r - wide + 1 : 0;
        if (f->held[r / 3]) {
            for (c = low; c < r; c++) row[c] = 0;
            row[r] = 1;
            continue;
        }
        for (c = low; c < r; c++) { /* row[c] becomes L D */
            const double *other = f->k + (size_t)c * (size_t)wide + wide - 1 - c;
            int from = c - wide + 1 > low ? c - wide + 1 : low;
            double sum = f->held[c / 3] ? 0 : row[c];
            if (!f->held[c / 3]) for (k = from; k < c; k++) sum -= row[k] * other[k];
            row[c] = sum;
        }
        for (d = row[r], c = low; c < r; c++) {
            double l = row[c] / f->k[(size_t)c * (size_t)wide + (size_t)wide - 1];
            d -= l * row[c];
            row[c] = l;
        }
        if (d == 0) return -1;
        if (d < 0) positive = 0;
        row[r] = d;
    }
    return positive ? 0 : 1;
}

static void fem_solve(const fem *f, double *b) {
    int n = 3 * f->nodes, wide = 3 * f->band + 3, r, c, low;
    for (r = 0; r < n; r++) {
        const double *row = f->k + (size_t)r * (size_t)wide + wide - 1 - r;
        low = r - wide + 1 > 0 ? r - wide + 1 : 0;
        for (c = low; c < r; c++) b[r] -= row[c] * b[c];
    }
    for (r = 0; r < n; r++) b[r] /= f->k[(size_t)r * (size_t)wide + (size_t)wide - 1];
    for (r = n - 1; r >= 0; r--) {
        const double *row = f->k + (size_t)r * (size_t)wide + wide - 1 - r;
        low = r - wide + 1 > 0 ? r - wide + 1 : 0;
        for (c = low; c < r; c++) b[c] -= row[c] * b[r];
    }
}

static double fem_most(const double *v, int n) {
    double most = 0;
    int i;
    for (i = 0; i < n; i++)
        if (!(fabs(v[i]) <= most)) most = fabs(v[i]);
    return most;
}

/* Newton to a correction of 1e-7 of the size: 0, or -1 when there is none (as the law itself may have none). The
   factor of the last step is used as long as it shrinks the correction fivefold. */
static int fem_newton(fem *f, double dt) {
    int n = 3 * f->nodes, turn, i, fresh, indefinite;
    double last = HUGE_VAL, *from = fem_room(2 * (size_t)n), *p = from + n, bound = 1e-7 * f->size[0];
    for (turn = 0; turn < 40; turn++) {
        double energy, slope = 0, t = 1, correction;
        fresh = !f->factored || f->factored_dt != dt;
        energy = fem_energy(f, dt, fresh);
        if (!(energy < HUGE_VAL)) break;
        if (fresh) {
            indefinite = fem_factor(f);
            if (indefinite < 0) break;
            f->factored = 1;
            f->factored_dt = dt;
        }
        for (i = 0; i < n; i++) p[i] = -f->f[i];
        fem_solve(f, p);
        for (i = 0; i < n; i++) slope += p[i] * f->f[i];
        correction = fem_most(p, n);
        if (!(correction < HUGE_VAL)) break;
        if (slope > 0 && correction > bound) { /* uphill: the matrix is indefinite; the other way is down */
            for (i = 0; i < n; i++) p[i] = -p[i];
            slope = -slope;
        }
        memcpy(from, f->x, (size_t)n * sizeof *from);
        for (; t > 1e-6; t /= 2) {
            double e;
            for (i = 0; i < n; i++) f->x[i] = from[i] + t * p[i];
            e = fem_energy(f, dt, 0);
            if (e <= energy + 1e-4 * t * slope + 1e-13 * fabs(energy)) break;
            if (correction < 1e-4 * f->size[0] && e < HUGE_VAL) break; /* differences of energies are rounding here */
        }
        if (correction * t < bound) {
            free(from);
            return 0;
        }
        if (!(t > 1e-6)) break;
        if (!(correction < 0.2 * last) || t < 1) f->factored = 0;
        last = correction;
    }
    f->factored = 0;
    free(from);
    return -1;
}

/* Where Newton's method loses its way from f->old, as from a start whose volume is far off near Poisson's ratio 1/2:
   the same step by solutions of softer volumes, the softest first. */
static int fem_approach(fem *f, double dt) {
    double lambda = f->lambda;
    int k, bad = 0;
    memcpy(f->x, f->old, 3 * (size_t)f->nodes * sizeof *f->x);
    for (k = 4; k >= 0 && !bad; k--) {
        f->lambda = ldexp(lambda, -2 * k);
        f->factored = 0;
        bad = fem_newton(f, dt);
    }
    f->lambda = lambda;
    return bad;
}

/* One step of backward Euler, or (dt 0) to rest. Held nodes are where the caller put them. */
static int fem_step(fem *f, double dt) {
    int i, bad;
    memcpy(f->old, f->x, 3 * (size_t)f->nodes * sizeof *f->old);
    if (!(dt > 0)) return fem_newton(f, 0) && fem_approach(f, 0) ? -1 : 0;
    for (i = 0; i < 3 * f->nodes; i++) {
        f->aim[i] = f->x[i] + dt * f->v[i] + dt * dt * f->gravity[i % 3];
        if (f->held[i / 3]) f->aim[i] = f->x[i];
    }
    bad = fem_newton(f, dt) && fem_approach(f, dt) ? -1 : 0;
    for (i = 0; i < 3 * f->nodes; i++) f->v[i] = (f->x[i] - f->old[i]) / dt;
    return bad;
}

#endif
