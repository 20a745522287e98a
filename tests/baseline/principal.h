/* tests/baseline/principal.h - isotropic energies of a deformation gradient F = U diag(s) V^T, s signed (peri_svd3: the
   smallest carries the sign of det F), with stress and stiffness: what tetrahedra and the least-squares gradient share.
   Included by baseline.h.

   In the frame of U and V the stiffness falls apart (Irving et al. 2004, Stomakhin et al. 2012, Smith et al. 2019):
   3x3 between the stretches, and for each pair of axes (i, j) two numbers: flip = (psi_i - psi_j) / (s_i - s_j) for
   dF_ij = dF_ji, twist = (psi_i + psi_j) / (s_i + s_j) for dF_ij = -dF_ji. A law gives them without the quotients. */
#ifndef PERI_BASELINE_PRINCIPAL_H
#define PERI_BASELINE_PRINCIPAL_H

static void baseline__lame(const baseline_def *def, double *mu, double *lambda) {
    *mu = def->young / (2 * (1 + def->poisson));
    *lambda = def->young * def->poisson / ((1 + def->poisson) * (1 - 2 * def->poisson));
}

/* flip and twist of a pair stand at the index of the third axis. */
typedef struct baseline__principal {
    double energy, first[3], second[9], flip[3], twist[3];
} baseline__principal;

typedef void baseline__law(const double s[3], double mu, double lambda, baseline__principal *o);

/* St. Venant-Kirchhoff: mu E : E + lambda/2 (tr E)^2. */
static void baseline__stvk(const double s[3], double mu, double lambda, baseline__principal *o) {
    double e[3], t[3], trace = 0;
    int i, j, k;
    for (i = 0; i < 3; i++) trace += e[i] = 0.5 * (s[i] * s[i] - 1);
    for (o->energy = 0.5 * lambda * trace * trace, i = 0; i < 3; i++) {
        o->energy += mu * e[i] * e[i];
        t[i] = 2 * mu * e[i] + lambda * trace;
        o->first[i] = s[i] * t[i];
    }
    for (i = 0; i < 3; i++)
        for (j = 0; j < 3; j++) {
            o->second[3 * i + j] = lambda * s[i] * s[j] + (i == j ? t[i] + 2 * mu * s[i] * s[i] : 0);
            if ((k = 3 - i - j) < 0 || i >= j) continue;
            o->flip[k] = mu * s[i] * (s[i] + s[j]) + t[j];
            o->twist[k] = t[i] - mu * s[j] * (s[i] - s[j]);
        }
}

/* Corotated: mu |F - R|^2 + lambda/2 tr(R^T F - 1)^2. The stiffness is the linear one turned by R ("warped"), which
   leaves out how R turns: twist 0 instead of (psi_i + psi_j) / (s_i + s_j). Never indefinite. */
static void baseline__corotated(const double s[3], double mu, double lambda, baseline__principal *o) {
    double trace = s[0] + s[1] + s[2] - 3;
    int i, j;
    for (o->energy = 0.5 * lambda * trace * trace, i = 0; i < 3; i++) {
        o->energy += mu * (s[i] - 1) * (s[i] - 1);
        o->first[i] = 2 * mu * (s[i] - 1) + lambda * trace;
        o->flip[i] = 2 * mu;
        o->twist[i] = 0;
        for (j = 0; j < 3; j++) o->second[3 * i + j] = lambda + (i == j ? 2 * mu : 0);
    }
}

/* log s, continued below BASELINE_FLAT by its parabola: flat and inverted matter has a finite force outwards. */
#define BASELINE_FLAT 0.25
static double baseline__log(double s, double *first, double *second) {
    double q = s / BASELINE_FLAT - 1;
    *first = q >= 0 ? 1 / s : (1 - q) / BASELINE_FLAT;
    *second = q >= 0 ? -1 / (s * s) : -1 / (BASELINE_FLAT * BASELINE_FLAT);
    return q >= 0 ? log(s) : log(BASELINE_FLAT) + q - 0.5 * q * q;
}

/* Neo-Hookean: mu/2 (I1 - 3) - mu log J + lambda/2 log^2 J, log J as the sum of the logarithms above. */
static void baseline__neo_hookean(const double s[3], double mu, double lambda, baseline__principal *o) {
    double first[3], second[3], sum = 0, g;
    int i, j, k;
    for (o->energy = 0, i = 0; i < 3; i++) {
        sum += baseline__log(s[i], first + i, second + i);
        o->energy += 0.5 * mu * (s[i] * s[i] - 1);
    }
    o->energy += (0.5 * lambda * sum - mu) * sum;
    g = lambda * sum - mu;
    for (i = 0; i < 3; i++) {
        o->first[i] = mu * s[i] + g * first[i];
        for (j = 0; j < 3; j++)
            o->second[3 * i + j] = lambda * first[i] * first[j] + (i == j ? mu + g * second[i] : 0);
        for (j = i + 1; j < 3; j++) {
            double apart = s[i] - s[j], together = s[i] + s[j];
            k = 3 - i - j;
            o->flip[k] = mu + g * (apart > 1e-6 ? (first[i] - first[j]) / apart : 0.5 * (second[i] + second[j]));
            o->twist[k] = mu + g * (first[i] + first[j]) / fmax(together, 1e-3); /* no rotation at s_i = -s_j */
        }
    }
}

/* P = U diag(first) V^T. */
static void baseline__stress(const double u[9], const double v[9], const double first[3], double p[9]) {
    int i, j;
    for (i = 0; i < 3; i++)
        for (j = 0; j < 3; j++)
            p[3 * i + j] = u[3 * i] * first[0] * v[3 * j] + u[3 * i + 1] * first[1] * v[3 * j + 1] +
                           u[3 * i + 2] * first[2] * v[3 * j + 2];
}

/* The nearest positive semidefinite: eigenvalues cut at 0 (Teran et al. 2005). */
static void baseline__make_definite(baseline__principal *o) {
    const double *a = o->second;
    double s[6], value[3], v[9];
    int i, j, k;
    s[0] = a[0];
    s[1] = a[4];
    s[2] = a[8];
    s[3] = a[5];
    s[4] = a[2];
    s[5] = a[1];
    peri_eigen3(s, value, v);
    for (i = 0; i < 3; i++) {
        o->flip[i] = fmax(o->flip[i], 0);
        o->twist[i] = fmax(o->twist[i], 0);
        for (j = 0; j < 3; j++)
            for (o->second[3 * i + j] = 0, k = 0; k < 3; k++)
                o->second[3 * i + j] += fmax(value[k], 0) * v[3 * i + k] * v[3 * j + k];
    }
}

/* h[9 (3 i + j) + 3 k + l] = dP_ij / dF_kl. */
static void baseline__tangent(const double u[9], const double v[9], const baseline__principal *o, double h[81]) {
    double vt[9], df[9], dp[9], half[9];
    int i, j, k, l, c;
    for (i = 0; i < 3; i++)
        for (j = 0; j < 3; j++) vt[3 * i + j] = v[3 * j + i];
    for (k = 0; k < 3; k++)
        for (l = 0; l < 3; l++) {
            for (i = 0; i < 3; i++)
                for (j = 0; j < 3; j++) df[3 * i + j] = u[3 * k + i] * v[3 * l + j];
            for (i = 0; i < 3; i++) {
                dp[4 * i] = o->second[3 * i] * df[0] + o->second[3 * i + 1] * df[4] + o->second[3 * i + 2] * df[8];
                for (j = i + 1; j < 3; j++) {
                    double even = 0.5 * (df[3 * i + j] + df[3 * j + i]) * o->flip[3 - i - j];
                    double odd = 0.5 * (df[3 * i + j] - df[3 * j + i]) * o->twist[3 - i - j];
                    dp[3 * i + j] = even + odd;
                    dp[3 * j + i] = even - odd;
                }
            }
            peri_mul3(u, dp, half);
            peri_mul3(half, vt, df);
            for (c = 0; c < 9; c++) h[9 * c + 3 * k + l] = df[c];
        }
}

/* block_ik = volume sum_jl h_ijkl ga_j gb_l. */
static void baseline__sandwich(const double h[81], double volume, const double *ga, const double *gb, double *block) {
    int i, j, k;
    for (i = 0; i < 3; i++)
        for (k = 0; k < 3; k++) {
            double sum = 0;
            for (j = 0; j < 3; j++) {
                const double *row = h + 9 * (3 * i + j) + 3 * k;
                sum += ga[j] * (row[0] * gb[0] + row[1] * gb[1] + row[2] * gb[2]);
            }
            block[3 * i + k] = volume * sum;
        }
}

#endif
