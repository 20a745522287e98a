/* peri_material.h - v0.3.0 - physics of one particle and its bonds - MIT licence

   The second of peri's three floors: elastic models as pure functions of the bonds of a particle. No allocation, no
   state but what is passed in. It knows peri_solver.h; it does not know the world.

   USE
       #define PERI_IMPLEMENTATION      in ONE translation unit, before the include
       #include "peri_material.h"

   QUICK START (a neo-Hookean rubber under simple shear, at one material point)
       peri_material m = peri_material_neo_hookean(1e5f, 0.45f, 1000);
       double f[9] = {1, 0.5, 0,  0, 1, 0,  0, 0, 1}, p[9];
       double energy = peri_material_point(&m, f, p);       (J/m^3; p: nominal stress, Pa)

   WHICH MODEL DO I TAKE (E: Young's modulus, nu: Poisson's ratio)
       projective      PP: fastest, hardest to break; Poisson's ratio is 1/4; bending resistance set by hand
       stretch         SH: bond stretches and their mean; sums of basis functions; exact only at small strain
                       (and St. Venant-Kirchhoff at nu = 1/4); surfaces are a little stiff
       correspondence  exact for every affine deformation and every energy Psi(C), surfaces included; costs most

   SYMBOLS  bond from i to j: reference vector xi, r = |xi|, n = xi / r; current vector y, stretch tau = |y| / r,
       q = tau^2; omega: bond weight, of a particle summing to one; theta = sum omega tau (dilatation); C: right
       Cauchy-Green tensor; Psi: energy per reference volume, J/m^3; lambda, mu: Lame's parameters.
       Symmetric tensors are in Voigt order 00, 11, 22, 12, 02, 01. SI units throughout.

   ERRATA to the papers that this file follows (PP: projective peridynamics, He et al. 2017; SH: reformulated
   hyperelasticity, Xu et al. 2018)
       SH (26)        lambda forgets the bonds' own bulk stiffness. Here ls = 9/2 (lambda - mu), ms = 15/2 mu; the
                      printed one is peri_material_papers_mapping.
       SH (13), (22)  signs: forces are minus the gradient.
       SH (18)        G = |Sigma R^T n|, the columns of R being the material directions.
       SH (27)        A_1 / A_1 is neo-Hookean only near the rest shape (uniaxial, nu 0.4, stretch 2: stress 2.4 times
                      too high); the exact law is the correspondence model.
       PP (8)-(11)    Poisson's ratio is 1/4 for affine maps whatever the constants; T_dev drops a derivative, so
                      angular momentum drifts (peri.h, WORKING RANGE).
       all            bending comes from horizon and weights: here sheets have a plate's, by their thickness (plates).
       PP, SH         against inversion the smallest singular direction is flipped, not two fixed rows.

   OPTIONS  those of peri_solver.h.
   THREADS  every function is pure: call it from anywhere.

   CONTENTS
       1  materials
       2  presets
       3  a material point
       implementation: lanes, basis functions, presets, laws, bonds, the three models, the same in lanes, their table,
       plates, a material point

   HISTORY
       0.3.0  laws and forces of 16 particles side by side
       0.1.0  first version: elastic models
*/
#ifndef PERI_MATERIAL_H
#define PERI_MATERIAL_H

#include "peri_solver.h"

/* ---- 1  materials ------------------------------------------------------------------------------------------------ */

typedef enum peri_model {
    PERI_MODEL_PROJECTIVE,      /* PP section 4: Psi = sum omega [a (|Fbar n| - 1)^2 + b/2 (tau - 1)^2] */
    PERI_MODEL_STRETCH,         /* SH section 4: Psi = ls g(theta) + ms sum omega G(n) h(tau) */
    PERI_MODEL_CORRESPONDENCE   /* ours: Psi(C) with C the least squares fit of tau^2 = n.C n over the bonds */
} peri_model;

/* Energy Psi(C) of the correspondence model. */
typedef enum peri_law {
    PERI_LAW_NEO_HOOKEAN,       /* mu/2 (I1 - 3) - mu log J + lambda/2 log^2 J */
    PERI_LAW_STVK,              /* mu E:E + lambda/2 tr(E)^2, E = (C - 1)/2 */
    PERI_LAW_STABLE,            /* Smith et al. 2018: finite at J = 0, never softens under compression */
    PERI_LAW_USER
} peri_law;

#define PERI_BASIS_MAX 6

/* A one-dimensional energy f(s), s > 0, with f(1) = f'(1) = 0: a sum of SH's basis functions (SH (15)),
       A_n' = (s^n - s^-n) / n,   B_n' = 2 (s^n - 1) / n,   both with f''(1) = 2,
   and of (3 B_3 - B_1)/2 = ((s^2 - 1)/2)^2, plus a user's function. Coefficients are not negative. */
typedef struct peri_basis {
    peri_real a[PERI_BASIS_MAX];    /* of A_1 .. A_6 */
    peri_real b[PERI_BASIS_MAX];    /* of B_1 .. B_6 */
    peri_real svk;                  /* of (3 B_3 - B_1)/2 */
    double (*user)(double s, double *first, void *context); /* returns f, sets f'; NULL: none */
    void *context;
} peri_basis;

/* A user's energy: c is C in Voigt order; returns Psi (Pa) and sets dpsi, the symmetric tensor dPsi/dC (Pa, Voigt
   order, so that dPsi = dpsi : dC over all nine entries; the second Piola-Kirchhoff stress is 2 dpsi). Must be finite
   also for det C <= 0, which a trial step can meet. */
typedef double peri_law_function(const double c[6], double dpsi[6], void *context);

/* A material. Make one by a preset, then change fields. */
typedef struct peri_material {
    uint32_t cookie;            /* set by the presets, checked by peri_material_check */
    peri_model model;
    peri_real density;          /* kg/m^3, > 0 */
    peri_real young, poisson;   /* what the preset was asked for (Pa, -); the fields below are what acts */
    peri_real a, b;             /* projective model, Pa, >= 0, not both 0. E = (2a + b)/6, nu = 1/4 */
    peri_real ls, ms;           /* stretch model, Pa; ms > 0, ls + ms > 0 */
    peri_basis g, h;            /* stretch model: of theta, of tau */
    int anisotropic;            /* stretch model: 1 uses the two fields below (SH (18)) */
    peri_real strength[3];      /* Sigma: > 0, product 1 within 1e-3 */
    peri_real direction[9];     /* R by rows; its columns are the orthonormal material directions */
    peri_law law;               /* correspondence model */
    peri_real lambda, mu;       /* Lame's parameters, Pa; mu > 0, lambda > -2/3 mu */
    peri_law_function *psi;     /* PERI_LAW_USER; lambda and mu must still hold the small-strain values */
    void *context;
    peri_real stabiliser;       /* correspondence: resistance to non-affine bonds, in 15/2 mu; 0 to 10. Pressed
                                   matter gets more of it: see peri__brace */
    peri_real healthy_min;      /* a particle whose smallest singular value of Fbar (signed) is below this, ... */
    peri_real healthy_max;      /* ... or whose largest is above this, is pulled back to shape; 0.3 and 2.5 */
    peri_real restore;          /* stiffness of that pull, in 15/2 mu; 0 switches the recovery off */
} peri_material;

/* PERI_OK, or what is wrong with m, in a sentence. */
PERI_DEF peri_result peri_material_check(const peri_material *m, peri_error *err);

/* ---- 2  presets: Young's modulus (Pa), Poisson's ratio, density (kg/m^3) ----------------------------------------- */

/* Projective model. Poisson's ratio is 1/4. bending (0 to 1): share of the Young's modulus that resists through
   |Fbar n|, hence bending and non-affine motion of thin bodies; 0.5 is a good default. a = 3 E bending,
   b = 6 E (1 - bending). Exact: Young's modulus at small strain. */
PERI_DEF peri_material peri_material_projective(peri_real young, peri_real bending, peri_real density);

/* Stretch model B_1 / B_1 (SH's linear material): exact at small strain; bonds are linear springs beyond. */
PERI_DEF peri_material peri_material_linear(peri_real young, peri_real poisson, peri_real density);

/* Correspondence model, exact neo-Hookean under every affine deformation: the default for solids. */
PERI_DEF peri_material peri_material_neo_hookean(peri_real young, peri_real poisson, peri_real density);

/* Stretch model A_1 / A_1: SH's approximation of neo-Hookean; right near the rest shape only (ERRATA). */
PERI_DEF peri_material peri_material_neo_hookean_papers(peri_real young, peri_real poisson, peri_real density);

/* Stretch model with g = h = (3 B_3 - B_1)/2: St. Venant-Kirchhoff for every affine deformation at nu = 1/4 and an
   isotropic family; near the rest shape else. */
PERI_DEF peri_material peri_material_stvk(peri_real young, peri_real poisson, peri_real density);

/* Correspondence model, exact St. Venant-Kirchhoff. It softens under compression (that is the law's own flaw). */
PERI_DEF peri_material peri_material_stvk_exact(peri_real young, peri_real poisson, peri_real density);

/* Correspondence model, stable neo-Hookean (Smith, de Goes, Kim 2018): the softest to drive through collapse. */
PERI_DEF peri_material peri_material_stable_neo_hookean(peri_real young, peri_real poisson, peri_real density);

/* Correspondence model with a user's energy; young and poisson are its small-strain values (they scale the solver's
   matrix and the stabiliser). */
PERI_DEF peri_material peri_material_user(peri_law_function *psi, void *context, peri_real young, peri_real poisson,
                                          peri_real density);

/* Puts SH (26) as printed in place of the corrected ls, for reproducing that paper's figures. */
PERI_DEF void peri_material_papers_mapping(peri_material *m);

/* ---- 3  a material point ----------------------------------------------------------------------------------------- */

/* f(s) and, when first is not NULL, f'(s). Below s = 0.05 f is continued by its tangent parabola. */
PERI_DEF double peri_basis_value(const peri_basis *f, double s, double *first);

/* Psi(C) of the material's law, and dpsi = dPsi/dC (see peri_law_function). h = C - 1 in Voigt order: passed so, small
   strains keep their digits. log J is continued smoothly below J = 0.2 (det C = 0.04). */
PERI_DEF double peri_law_value(const peri_material *m, const double h[6], double dpsi[6]);

/* Energy density under the affine deformation gradient f (9, rows) and the nominal (first Piola-Kirchhoff) stress p
   (9, Pa; may be NULL), for an isotropic family (bonds integrated over the sphere to 1e-6). */
PERI_DEF double peri_material_point(const peri_material *m, const double f[9], double p[9]);

#endif /* PERI_MATERIAL_H */
/* Stop here if you only want the API. */

#ifdef PERI_IMPLEMENTATION
#ifndef PERI_MATERIAL_IMPLEMENTED
#define PERI_MATERIAL_IMPLEMENTED

#include <math.h>
#include <string.h>

#ifdef PERI_DOUBLE
#define PERI__SQRT(x) sqrt(x)
#else
#define PERI__SQRT(x) sqrtf(x)
#endif
#define PERI__COOKIE 0x70657269u
#define PERI__R(x) ((peri_real)(x))

/* ---- implementation 1: lanes -------------------------------------------------------------------------------------
   Hot loops run over 16 lanes in lockstep: short arrays and loops of 16 turns, which compilers make vectors of at -O2
   already. What a vector cannot hold back: sqrtf sets errno, so roots are taken by intrinsics (correctly rounded, the
   same bits as sqrtf); the logarithm is ours. */

#if defined(__SSE2__) || defined(_M_X64)
#define PERI__SSE2
#include <emmintrin.h>
#ifdef __AVX__
#include <immintrin.h>
#endif
#elif defined(__aarch64__) && defined(__ARM_NEON)
#define PERI__NEON
#include <arm_neon.h>
#endif

#if defined(__GNUC__) || defined(__clang__)
#define PERI__INLINE static inline __attribute__((always_inline, unused))
#elif defined(_MSC_VER)
#define PERI__INLINE static __forceinline
#else
#define PERI__INLINE static inline
#endif

/* a b + c. Rounded once only where the processor is known to do so: elsewhere fma is a slow call. */
#if !defined(PERI_DOUBLE) && defined(FP_FAST_FMAF)
#define PERI__MAD(a, b, c) fmaf(a, b, c)
#elif defined(PERI_DOUBLE) && defined(FP_FAST_FMA)
#define PERI__MAD(a, b, c) fma(a, b, c)
#else
#define PERI__MAD(a, b, c) ((a) * (b) + (c))
#endif

/* A loop over the lanes. Compilers would unroll it before they can make a vector of it. */
#define PERI__LANES 16
#if defined(__clang__)
#define PERI__EACH_OF(l, n) _Pragma("clang loop unroll(disable)") for (l = 0; l < (n); l++)
#elif defined(__GNUC__) && __GNUC__ >= 8
#define PERI__EACH_OF(l, n) _Pragma("GCC unroll 1") for (l = 0; l < (n); l++)
#else
#define PERI__EACH_OF(l, n) for (l = 0; l < (n); l++)
#endif
#define PERI__EACH(l) PERI__EACH_OF(l, PERI__LANES)
typedef peri_real peri__row[PERI__LANES];
typedef double peri__row2[PERI__LANES];

/* Roots of n (1 or PERI__LANES) numbers, in place. In pieces as wide as those that the compiler itself makes (clang
   stays at 256 bits): what was stored in two halves is slow to load as a whole. */
PERI__INLINE void peri__roots2(int n, double *v) {
    int l = 0;
#if defined(__AVX512F__) && !defined(__clang__)
    for (; l + 7 < n; l += 8) _mm512_storeu_pd(v + l, _mm512_sqrt_pd(_mm512_loadu_pd(v + l)));
#elif defined(__AVX__)
    for (; l + 3 < n; l += 4) _mm256_storeu_pd(v + l, _mm256_sqrt_pd(_mm256_loadu_pd(v + l)));
#elif defined(PERI__SSE2)
    for (; l + 1 < n; l += 2) _mm_storeu_pd(v + l, _mm_sqrt_pd(_mm_loadu_pd(v + l)));
#elif defined(PERI__NEON)
    for (; l + 1 < n; l += 2) vst1q_f64(v + l, vsqrtq_f64(vld1q_f64(v + l)));
#endif
    for (; l < n; l++) v[l] = sqrt(v[l]);
}

#ifdef PERI_DOUBLE
#define peri__roots(v) peri__roots2(PERI__LANES, v)
#else
PERI__INLINE void peri__roots(float *v) {
    int l = 0;
#if defined(__AVX512F__) && !defined(__clang__)
    for (; l < PERI__LANES; l += 16) _mm512_storeu_ps(v + l, _mm512_sqrt_ps(_mm512_loadu_ps(v + l)));
#elif defined(__AVX__)
    for (; l < PERI__LANES; l += 8) _mm256_storeu_ps(v + l, _mm256_sqrt_ps(_mm256_loadu_ps(v + l)));
#elif defined(PERI__SSE2)
    for (; l < PERI__LANES; l += 4) _mm_storeu_ps(v + l, _mm_sqrt_ps(_mm_loadu_ps(v + l)));
#elif defined(PERI__NEON)
    for (; l < PERI__LANES; l += 4) vst1q_f32(v + l, vsqrtq_f32(vld1q_f32(v + l)));
#endif
    for (; l < PERI__LANES; l++) v[l] = PERI__SQRT(v[l]);
}
#endif

/* log(1 + x) = k ln 2 + 2 z + tail, x > -1, of n numbers: 1 + x = 2^k m, m in [sqrt 1/2, sqrt 2), z = (m - 1)/(m + 1),
   tail = 2 z (z^2/3 + z^4/5 + ...). Where k is 0, m - 1 is x: no digit of a small x is lost. */
#define PERI__LOG_PARTS(name, real, word, bits, one, low, terms)                                                       \
    PERI__INLINE void name(int n, const real *x, real *k, real *z, real *tail) {                                       \
        static const double term[11] = {1.0 / 3,  1.0 / 5,  1.0 / 7,  1.0 / 9,  1.0 / 11, 1.0 / 13,                    \
                                        1.0 / 15, 1.0 / 17, 1.0 / 19, 1.0 / 21, 1.0 / 23};                             \
        real m[PERI__LANES];                                                                                           \
        word b[PERI__LANES];                                                                                           \
        int l, t;                                                                                                      \
        PERI__EACH_OF(l, n) m[l] = 1 + x[l];                                                                           \
        memcpy(b, m, (size_t)n * sizeof *b);                                                                           \
        PERI__EACH_OF(l, n) {                                                                                          \
            word up = (word)(b[l] + ((one) - (low)));                                                                  \
            k[l] = (real)((int32_t)(up >> (bits)) - (int32_t)((one) >> (bits)));                                       \
            b[l] = (word)((up & (((word)1 << (bits)) - 1)) + (low));                                                   \
        }                                                                                                              \
        memcpy(m, b, (size_t)n * sizeof *b);                                                                           \
        PERI__EACH_OF(l, n) {                                                                                          \
            real f = k[l] < 0 || k[l] > 0 ? m[l] - 1 : x[l];                                                           \
            z[l] = f / (2 + f);                                                                                        \
            tail[l] = 0;                                                                                               \
        }                                                                                                              \
        for (t = (terms) - 1; t >= 0; t--)                                                                             \
            PERI__EACH_OF(l, n) tail[l] = (tail[l] + (real)term[t]) * (z[l] * z[l]);                                   \
        PERI__EACH_OF(l, n) tail[l] *= 2 * z[l];                                                                       \
    }
PERI__LOG_PARTS(peri__log_parts2, double, uint64_t, 52, 0x3ff0000000000000ULL, 0x3fe6a09e667f3bcdULL, 11)
#ifdef PERI_DOUBLE
#define peri__log_parts peri__log_parts2
#else
PERI__LOG_PARTS(peri__log_parts, float, uint32_t, 23, 0x3f800000u, 0x3f3504f3u, 5)
#endif

/* log(1 + x). */
PERI__INLINE void peri__log1p(int n, const double *x, double *out) {
    peri__row2 k, z, tail;
    int l;
    peri__log_parts2(n, x, k, z, tail);
    PERI__EACH_OF(l, n) out[l] = k[l] * PERI__LN2_HIGH + (2 * z[l] + (tail[l] + k[l] * PERI__LN2_LOW));
}

/* x - log(1 + x), to the last digits of its own size. */
PERI__INLINE void peri__log_excess(int n, const peri_real *x, peri_real *out) {
    peri__row k, z, tail;
    int l;
    peri__log_parts(n, x, k, z, tail);
    PERI__EACH_OF(l, n) {
        peri_real far = x[l] - 2 * z[l] - k[l] * PERI__R(0.6931471805599453);
        out[l] = (k[l] < 0 || k[l] > 0 ? far : z[l] * x[l]) - tail[l];
    }
}

/* ---- implementation 2: basis functions ---------------------------------------------------------------------------
   f' of every sum of A_n and B_n is a Laurent polynomial sum c_k s^k, -N <= k <= N: one form for all of them. The three
   that presets use have a short form in the hot loops. */

typedef enum peri__form { PERI__FORM_B1, PERI__FORM_A1, PERI__FORM_SVK, PERI__FORM_GENERAL } peri__form;

#define PERI__S_MIN 0.05    /* below it, f is continued by its tangent parabola: A_n is infinite at 0 */

typedef struct peri__basis {
    peri__form form;
    peri_real scale;                            /* coefficient, for the short forms */
    double c[2 * PERI_BASIS_MAX + 1];           /* of s^(k - PERI_BASIS_MAX) in f' */
    double f_min, first_min, second_min;        /* at s = PERI__S_MIN */
    double (*user)(double s, double *first, void *context);
    void *context;
} peri__basis;

static double peri__laurent(const double *c, double s) {
    double up = 0, down = 0, inverse = 1 / s;
    int k;
    for (k = 2 * PERI_BASIS_MAX; k >= PERI_BASIS_MAX; k--) up = up * s + c[k];
    for (k = 0; k < PERI_BASIS_MAX; k++) down = (down + c[k]) * inverse;
    return up + down;
}

/* f by integrating f' from 1. */
static double peri__laurent_integral(const double *c, double s) {
    double sum = c[PERI_BASIS_MAX - 1] * peri_log(s), up = s, down = 1 / s, inverse = 1 / s;
    int k;
    for (k = 0; k <= PERI_BASIS_MAX; k++, up *= s) sum += c[PERI_BASIS_MAX + k] * (up - 1) / (k + 1);
    for (k = 1; k < PERI_BASIS_MAX; k++, down *= inverse) sum -= c[PERI_BASIS_MAX - 1 - k] * (down - 1) / k;
    return sum;
}

static double peri__basis_raw(const peri__basis *f, double s, double *first) {
    double value = peri__laurent_integral(f->c, s), slope = 0;
    *first = peri__laurent(f->c, s);
    if (f->user) {
        value += f->user(s, &slope, f->context);
        *first += slope;
    }
    return value;
}

static void peri__basis_compile(const peri_basis *source, peri__basis *f) {
    int n, kinds = 0;
    double low, high;
    memset(f, 0, sizeof *f);
    f->user = source->user;
    f->context = source->context;
    for (n = 1; n <= PERI_BASIS_MAX; n++) {
        double a = (double)source->a[n - 1] / n, b = 2 * (double)source->b[n - 1] / n;
        f->c[PERI_BASIS_MAX + n] += a + b;
        f->c[PERI_BASIS_MAX - n] -= a;
        f->c[PERI_BASIS_MAX] -= b;
        kinds += (n > 1) * ((a > 0) + (b > 0));
    }
    f->c[PERI_BASIS_MAX + 3] += (double)source->svk;
    f->c[PERI_BASIS_MAX + 1] -= (double)source->svk;
    f->form = PERI__FORM_GENERAL;
    if (!kinds && !source->user) {
        peri_real a = source->a[0], b = source->b[0], v = source->svk;
        if (!(a > 0) && !(v > 0)) { f->form = PERI__FORM_B1; f->scale = b; }
        if (!(b > 0) && !(v > 0) && a > 0) { f->form = PERI__FORM_A1; f->scale = a; }
        if (!(a > 0) && !(b > 0) && v > 0) { f->form = PERI__FORM_SVK; f->scale = v; }
    }
    f->f_min = peri__basis_raw(f, PERI__S_MIN, &f->first_min);
    peri__basis_raw(f, PERI__S_MIN * 0.999, &low);
    peri__basis_raw(f, PERI__S_MIN * 1.001, &high);
    f->second_min = (high - low) / (PERI__S_MIN * 0.002);
}

static double peri__basis_value(const peri__basis *f, double s, double *first) {
    double ds = s - PERI__S_MIN;
    if (ds >= 0) return peri__basis_raw(f, s, first);
    *first = f->first_min + f->second_min * ds;
    return f->f_min + ds * (f->first_min + ds * f->second_min / 2);
}

/* f''(1). */
static double peri__basis_second(const peri__basis *f) {
    double low, high, step = 1e-4;
    peri__basis_raw(f, 1 - step, &low);
    peri__basis_raw(f, 1 + step, &high);
    return (high - low) / (2 * step);
}

/* f'(tau) / tau from q - 1 and tau: what a bond force needs. The short forms keep the digits of a small q - 1. */
static peri_real peri__basis_pull(const peri__basis *f, peri_real dq, peri_real tau, peri_real inv_tau) {
    double first;
    switch (f->form) {
    case PERI__FORM_B1: return f->scale * 2 * dq / (1 + tau) * inv_tau;
    case PERI__FORM_SVK: return f->scale * dq;
    case PERI__FORM_A1:
        if (tau >= PERI__R(PERI__S_MIN)) return f->scale * dq * inv_tau * inv_tau;
        break;
    case PERI__FORM_GENERAL: break;
    }
    peri__basis_value(f, (double)tau, &first);
    return (peri_real)first * inv_tau;
}

/* f(tau) from q - 1 and tau: what a bond's energy needs; short forms as above. */
static double peri__basis_energy(const peri__basis *f, peri_real dq, peri_real tau) {
    double first, e = (double)dq / (1 + (double)tau), square = (double)dq, log_q;
    switch (f->form) {
    case PERI__FORM_B1: return (double)f->scale * e * e;
    case PERI__FORM_SVK: return (double)f->scale * (double)dq * (double)dq / 4;
    case PERI__FORM_A1:
        if (tau >= PERI__R(PERI__S_MIN)) {
            peri__log1p(1, &square, &log_q);
            return (double)f->scale / 2 * (square - log_q);
        }
        break;
    case PERI__FORM_GENERAL: break;
    }
    return peri__basis_value(f, (double)tau, &first);
}

double peri_basis_value(const peri_basis *f, double s, double *first) {
    peri__basis compiled;
    double slope, value;
    peri__basis_compile(f, &compiled);
    value = peri__basis_value(&compiled, s, &slope);
    if (first) *first = slope;
    return value;
}

/* ---- implementation 3: presets and checks ------------------------------------------------------------------------ */

static peri_material peri__material(peri_model model, peri_real young, peri_real poisson, peri_real density) {
    peri_material m;
    double e = (double)young, nu = (double)poisson, mu = e / (2 * (1 + nu)),
           lambda = e * nu / ((1 + nu) * (1 - 2 * nu));
    memset(&m, 0, sizeof m);
    m.cookie = PERI__COOKIE;
    m.model = model;
    m.density = density;
    m.young = young;
    m.poisson = poisson;
    m.lambda = (peri_real)lambda;
    m.mu = (peri_real)mu;
    m.ms = (peri_real)(7.5 * mu);
    m.ls = (peri_real)(4.5 * (lambda - mu));
    m.a = PERI__R(1.5) * young;
    m.b = 3 * young;
    m.g.b[0] = m.h.b[0] = 1;
    m.strength[0] = m.strength[1] = m.strength[2] = 1;
    m.direction[0] = m.direction[4] = m.direction[8] = 1;
    m.stabiliser = PERI__R(2.25);
    m.healthy_min = PERI__R(0.3);
    m.healthy_max = PERI__R(2.5);
    m.restore = 1;
    return m;
}

peri_material peri_material_projective(peri_real young, peri_real bending, peri_real density) {
    peri_material m = peri__material(PERI_MODEL_PROJECTIVE, young, PERI__R(0.25), density);
    m.a = 3 * young * bending;
    m.b = 6 * young * (1 - bending);
    return m;
}

peri_material peri_material_linear(peri_real young, peri_real poisson, peri_real density) {
    return peri__material(PERI_MODEL_STRETCH, young, poisson, density);
}

peri_material peri_material_neo_hookean_papers(peri_real young, peri_real poisson, peri_real density) {
    peri_material m = peri__material(PERI_MODEL_STRETCH, young, poisson, density);
    m.g.b[0] = m.h.b[0] = 0;
    m.g.a[0] = m.h.a[0] = 1;
    return m;
}

peri_material peri_material_stvk(peri_real young, peri_real poisson, peri_real density) {
    peri_material m = peri__material(PERI_MODEL_STRETCH, young, poisson, density);
    m.g.b[0] = m.h.b[0] = 0;
    m.g.svk = m.h.svk = 1;
    return m;
}

peri_material peri_material_neo_hookean(peri_real young, peri_real poisson, peri_real density) {
    return peri__material(PERI_MODEL_CORRESPONDENCE, young, poisson, density);
}

peri_material peri_material_stvk_exact(peri_real young, peri_real poisson, peri_real density) {
    peri_material m = peri__material(PERI_MODEL_CORRESPONDENCE, young, poisson, density);
    m.law = PERI_LAW_STVK;
    return m;
}

peri_material peri_material_stable_neo_hookean(peri_real young, peri_real poisson, peri_real density) {
    peri_material m = peri__material(PERI_MODEL_CORRESPONDENCE, young, poisson, density);
    m.law = PERI_LAW_STABLE;
    return m;
}

peri_material peri_material_user(peri_law_function *psi, void *context, peri_real young, peri_real poisson,
                                 peri_real density) {
    peri_material m = peri__material(PERI_MODEL_CORRESPONDENCE, young, poisson, density);
    m.law = PERI_LAW_USER;
    m.psi = psi;
    m.context = context;
    return m;
}

void peri_material_papers_mapping(peri_material *m) {
    double e = (double)m->young, nu = (double)m->poisson;
    m->ls = (peri_real)(9 * e * nu / (2 * (1 + nu) * (1 - 2 * nu)));
}

static peri_result peri__check_range(const char *name, double value, double low, double high, peri_error *err) {
    if (peri__finite(value) && value >= low && value <= high) return PERI_OK;
    return peri__fail(err, PERI_ERROR_VALUE, "%s is %g; it must lie between %g and %g", name, value, low, high);
}

static peri_result peri__check_basis(const char *name, const peri_basis *f, peri_error *err) {
    peri_result bad = PERI_OK;
    double sum = (double)f->svk, slope = 0, value;
    int n;
    for (n = 0; n < PERI_BASIS_MAX && !bad; n++) {
        bad = peri__check_range("a coefficient of A_n", (double)f->a[n], 0, 1e6, err);
        if (!bad) bad = peri__check_range("a coefficient of B_n", (double)f->b[n], 0, 1e6, err);
        sum += (double)f->a[n] + (double)f->b[n];
    }
    if (!bad) bad = peri__check_range("svk, the coefficient of (3 B_3 - B_1)/2,", (double)f->svk, 0, 1e6, err);
    if (bad) return bad;
    if (f->user) {
        value = f->user(1, &slope, f->context);
        if (!(fabs(value) < 1e-9) || !(fabs(slope) < 1e-9))
            return peri__fail(err, PERI_ERROR_VALUE, "%s.user has f(1) = %g and f'(1) = %g; both must be 0", name,
                              value, slope);
    } else if (!(sum > 0)) {
        return peri__fail(err, PERI_ERROR_VALUE, "%s has no basis function: set a coefficient of a, b or svk", name);
    }
    return PERI_OK;
}

static peri_result peri__check_directions(const peri_material *m, peri_error *err) {
    double product = 1;
    int i, j, k;
    for (i = 0; i < 3; i++) {
        peri_result bad = peri__check_range("strength", (double)m->strength[i], 1e-3, 1e3, err);
        if (bad) return bad;
        product *= (double)m->strength[i];
        for (j = 0; j < 3; j++) {
            double dot = i == j ? -1 : 0;
            for (k = 0; k < 3; k++) dot += (double)m->direction[3 * k + i] * (double)m->direction[3 * k + j];
            if (!(fabs(dot) < 1e-3))
                return peri__fail(err, PERI_ERROR_VALUE, "direction: columns %d and %d are not orthonormal (off by %g)",
                                  i, j, dot);
        }
    }
    if (!(fabs(product - 1) < 1e-3))
        return peri__fail(err, PERI_ERROR_VALUE, "strength: the product is %g; it must be 1", product);
    return PERI_OK;
}

static peri_result peri__check_model(const peri_material *m, peri_error *err) {
    peri_result bad;
    switch (m->model) {
    case PERI_MODEL_PROJECTIVE:
        bad = peri__check_range("a", (double)m->a, 0, 1e15, err);
        if (!bad) bad = peri__check_range("b", (double)m->b, 0, 1e15, err);
        if (!bad && !(m->a + m->b > 0)) bad = peri__fail(err, PERI_ERROR_VALUE, "a and b are both 0: no stiffness");
        return bad;
    case PERI_MODEL_STRETCH: break;
    case PERI_MODEL_CORRESPONDENCE:
        if ((int)m->law < 0 || (int)m->law > (int)PERI_LAW_USER)
            return peri__fail(err, PERI_ERROR_ARGUMENT, "law is %d, which is no peri_law", (int)m->law);
        if (m->law == PERI_LAW_USER && !m->psi)
            return peri__fail(err, PERI_ERROR_ARGUMENT, "psi is NULL, but the law is PERI_LAW_USER");
        bad = peri__check_range("stabiliser", (double)m->stabiliser, 0, 10, err);
        if (!bad) bad = peri__check_range("mu", (double)m->mu, 1e-30, 1e15, err);
        if (!bad) bad = peri__check_range("lambda", (double)m->lambda, -0.66 * (double)m->mu, 1e18, err);
        if (bad) return bad;
        break;
    default: return peri__fail(err, PERI_ERROR_ARGUMENT, "model is %d, which is no peri_model", (int)m->model);
    }
    /* a correspondence body needs the stretch model where a family cannot hold a tensor */
    bad = peri__check_range("ms", (double)m->ms, 1e-30, 1e18, err);
    if (!bad) bad = peri__check_range("ls", (double)m->ls, -0.999 * (double)m->ms, 1e18, err);
    if (!bad) bad = peri__check_basis("g", &m->g, err);
    if (!bad) bad = peri__check_basis("h", &m->h, err);
    if (!bad && m->anisotropic) bad = peri__check_directions(m, err);
    return bad;
}

peri_result peri_material_check(const peri_material *m, peri_error *err) {
    peri_result bad;
    if (!m) return peri__fail(err, PERI_ERROR_ARGUMENT, "material is NULL");
    if (m->cookie != PERI__COOKIE)
        return peri__fail(err, PERI_ERROR_ARGUMENT,
                          "material was not made by a preset such as peri_material_neo_hookean");
    bad = peri__check_range("density", (double)m->density, 1e-6, 1e9, err);
    if (!bad) bad = peri__check_range("young", (double)m->young, 1e-6, 1e15, err);
    if (!bad) bad = peri__check_range("poisson", (double)m->poisson, -0.999, 0.4999, err);
    if (!bad) bad = peri__check_model(m, err);
    if (!bad) bad = peri__check_range("healthy_min", (double)m->healthy_min, -1, 0.95, err);
    if (!bad) bad = peri__check_range("healthy_max", (double)m->healthy_max, 1.05, 1e6, err);
    if (!bad) bad = peri__check_range("restore", (double)m->restore, 0, 100, err);
    return bad;
}

/* ---- implementation 4: laws Psi(C) -------------------------------------------------------------------------------
   Of n particles side by side, C - 1 in h; a single one is the first lane. */

/* With h = C - 1: det C - 1 without losing digits, and the cofactors of C. */
PERI__INLINE void peri__cofactors(int n, peri__row2 *h, peri__row2 *cofactor, double *dm) {
    int l;
    PERI__EACH_OF(l, n) {
        double h0 = h[0][l], h1 = h[1][l], h2 = h[2][l], h3 = h[3][l], h4 = h[4][l], h5 = h[5][l];
        double c0 = 1 + h0, c1 = 1 + h1, c2 = 1 + h2;
        cofactor[0][l] = c1 * c2 - h3 * h3;
        cofactor[1][l] = c0 * c2 - h4 * h4;
        cofactor[2][l] = c0 * c1 - h5 * h5;
        cofactor[3][l] = h4 * h5 - c0 * h3;
        cofactor[4][l] = h3 * h5 - c1 * h4;
        cofactor[5][l] = h3 * h4 - c2 * h5;
        dm[l] = h0 + h1 + h2 + h0 * h1 + h1 * h2 + h0 * h2 - h3 * h3 - h4 * h4 - h5 * h5 + h0 * (h1 * h2 - h3 * h3) -
                h1 * h4 * h4 - h2 * h5 * h5 + 2 * h3 * h4 * h5;
    }
}

#define PERI__DET_MIN 0.04          /* J = 0.2 */
#define PERI__LOG_J_MIN (-1.6094379124341003)

/* log J of det C = 1 + dm, its derivative by det C; below PERI__DET_MIN the second-order Taylor polynomial. */
PERI__INLINE void peri__log_j(int n, const double *dm, double *value, double *slope) {
    const double d0 = PERI__DET_MIN;
    peri__row2 clamped;
    int l;
    PERI__EACH_OF(l, n) clamped[l] = dm[l] > d0 - 1 ? dm[l] : d0 - 1;
    peri__log1p(n, clamped, value);
    PERI__EACH_OF(l, n) {
        double x = 1 + dm[l] - d0, below = PERI__LOG_J_MIN + 0.5 * x / d0 - 0.25 * x * x / (d0 * d0);
        slope[l] = x >= 0 ? 0.5 / (1 + clamped[l]) : 0.5 / d0 - 0.5 * x / (d0 * d0);
        value[l] = x >= 0 ? 0.5 * value[l] : below;
    }
}

/* J - 1 of det C = 1 + dm, continued the same way. */
PERI__INLINE void peri__j_minus_one(int n, const double *dm, double *value, double *slope) {
    const double d0 = PERI__DET_MIN, j0 = 0.2;
    peri__row2 j;
    int l;
    PERI__EACH_OF(l, n) j[l] = dm[l] > d0 - 1 ? 1 + dm[l] : d0;
    peri__roots2(n, j);
    PERI__EACH_OF(l, n) {
        double x = 1 + dm[l] - d0, below = j0 - 1 + 0.5 * x / j0 - 0.125 * x * x / (j0 * j0 * j0);
        slope[l] = x >= 0 ? 0.5 / j[l] : 0.5 / j0 - 0.25 * x / (j0 * j0 * j0);
        value[l] = x >= 0 ? dm[l] / (1 + j[l]) : below;
    }
}

PERI__INLINE void peri__law_neo_hookean(int n, double lambda, double mu, peri__row2 *h, peri__row2 *dpsi,
                                        double *psi) {
    peri__row2 cofactor[6], dm, log_j, slope;
    int k, l;
    peri__cofactors(n, h, cofactor, dm);
    peri__log_j(n, dm, log_j, slope);
    PERI__EACH_OF(l, n) {
        psi[l] = mu / 2 * (h[0][l] + h[1][l] + h[2][l]) - mu * log_j[l] + lambda / 2 * log_j[l] * log_j[l];
        slope[l] *= lambda * log_j[l] - mu;
    }
    for (k = 0; k < 6; k++)
        PERI__EACH_OF(l, n) dpsi[k][l] = slope[l] * cofactor[k][l] + (k < 3 ? mu / 2 : 0);
}

PERI__INLINE void peri__law_stvk(int n, double lambda, double mu, peri__row2 *h, peri__row2 *dpsi, double *psi) {
    peri__row2 trace;
    int k, l;
    PERI__EACH_OF(l, n) {
        trace[l] = h[0][l] + h[1][l] + h[2][l];
        psi[l] = lambda / 8 * trace[l] * trace[l];
    }
    for (k = 0; k < 6; k++)
        PERI__EACH_OF(l, n) {
            psi[l] += (k < 3 ? mu / 4 : mu / 2) * h[k][l] * h[k][l];
            dpsi[k][l] = mu / 2 * h[k][l] + (k < 3 ? lambda / 4 * trace[l] : 0);
        }
}

/* Smith, de Goes, Kim 2018, equation 14 with their reparameterised constants (so that small strain is Hooke's). Where
   I1 falls below zero, as it can in a trial step, the tangent of the logarithm goes on. */
PERI__INLINE void peri__law_stable(int n, double lambda, double mu, peri__row2 *h, peri__row2 *dpsi, double *psi) {
    double m = 4 * mu / 3, l0 = lambda + 5 * mu / 6, beyond = 0.75 * m / l0;    /* alpha - 1 */
    peri__row2 cofactor[6], dm, slope, j, clamped, log_y, pull;
    int k, l;
    peri__cofactors(n, h, cofactor, dm);
    peri__j_minus_one(n, dm, j, slope);
    PERI__EACH_OF(l, n) {
        double y = (h[0][l] + h[1][l] + h[2][l]) / 4;
        clamped[l] = y > -0.9 ? y : -0.9;
    }
    peri__log1p(n, clamped, log_y);
    PERI__EACH_OF(l, n) {
        double trace = h[0][l] + h[1][l] + h[2][l];
        log_y[l] += (trace / 4 - clamped[l]) * 10;
        pull[l] = m / 2 * (1 - 1 / (1 + clamped[l]) / 4);
        psi[l] = m / 2 * (trace - log_y[l]) + l0 / 2 * j[l] * (j[l] - 2 * beyond);
        slope[l] *= l0 * (j[l] - beyond);
    }
    for (k = 0; k < 6; k++)
        PERI__EACH_OF(l, n) dpsi[k][l] = slope[l] * cofactor[k][l] + (k < 3 ? pull[l] : 0);
}

PERI__INLINE void peri__law(const peri_material *m, int n, peri__row2 *h, peri__row2 *dpsi, double *psi) {
    double lambda = (double)m->lambda, mu = (double)m->mu, c[6], d[6];
    int k, l;
    switch (m->law) {
    case PERI_LAW_NEO_HOOKEAN: peri__law_neo_hookean(n, lambda, mu, h, dpsi, psi); return;
    case PERI_LAW_STVK: peri__law_stvk(n, lambda, mu, h, dpsi, psi); return;
    case PERI_LAW_STABLE: peri__law_stable(n, lambda, mu, h, dpsi, psi); return;
    case PERI_LAW_USER: break;
    }
    PERI__EACH_OF(l, n) {
        for (k = 0; k < 6; k++) c[k] = h[k][l] + (k < 3);
        psi[l] = m->psi(c, d, m->context);
        for (k = 0; k < 6; k++) dpsi[k][l] = d[k];
    }
}

double peri_law_value(const peri_material *m, const double h[6], double dpsi[6]) {
    peri__row2 strain[6], stress[6], psi;
    int k;
    for (k = 0; k < 6; k++) strain[k][0] = h[k];
    peri__law(m, 1, strain, stress, psi);
    for (k = 0; k < 6; k++) dpsi[k] = stress[k][0];
    return psi[0];
}

/* ---- implementation 5: bonds -------------------------------------------------------------------------------------
   A body's bonds in compressed rows, one array per quantity. Bodies that are computed in lanes (implementation 9) keep
   xi, inv_r2 and weight by blocks of 16 particles, bond s of all 16 side by side. w v_i v_j is symmetric: the bond
   weight is omega_ij = s_ij c_i / v_i with s_ij = w(r) v_i v_j, c_i = 1 / sum_k w v_k and v = V / d^3, so a particle
   reads its neighbour's share of a bond from its own row and c_j. */

typedef struct peri__bonds {
    int n;
    const int *row;                 /* n + 1 */
    const int *col;                 /* particle at the other end, ascending in a row */
    const int *start;               /* NULL: the next three lie as col does; else by blocks, see peri__bond_at */
    const peri_real *xi[3];         /* reference vector */
    const peri_real *inv_r2;        /* 1 / |xi|^2 */
    const peri_real *weight;        /* s_ij */
    const peri_real *gain;          /* G(n) of an anisotropic body, or NULL: 1 */
    const peri_real *share;         /* c_i */
    const peri_real *volume;        /* v_i */
    const peri_real *shape;         /* 6 n: (sum omega n n)^-1, pseudo-inverse where that is singular */
    const peri_real *moment;        /* 21 n: M_i^-1 packed (correspondence); of all sheets the pseudo-inverse. Where
                                       start is not NULL by blocks, see peri__moment_at */
    const int *lane;                /* n: place of a particle's moment, NULL: its number */
    const peri_real *normal;        /* 3 n: reference normals of a sheet, or NULL */
    const peri_real *plate;         /* 2 plate_rows a bond: bending of a sheet, or NULL. What the bond gives to K_a and
                                       (curved sheets) t_a of its own particle, then of the particle at its other end */
    const peri_real *plate_rest;    /* PERI__PLATE_REST n: curved sheets' shape at rest, or NULL */
    int plate_rows;                 /* 3: flat, 5: curved */
    const unsigned char *mode;      /* n: a peri__mode each */
    peri_real *special;             /* 9 n: of particles whose mode is not PERI__MAIN (NULL: there are none) */
    const peri_real *brace;         /* n: factor on the stabiliser during this step, see peri__brace; or NULL: 1 */
    double unit;                    /* d^3 */
    const struct peri__matter *matters; /* of a body of several materials, else NULL: */
    const unsigned char *kind;          /* which of them a particle is made of */
    const peri_real *factor;        /* on a particle's stiffness, or NULL: 1 */
    const peri_real *far_gain;      /* G(n) of the bond's other end, where it may differ from gain; or NULL */
} peri__bonds;

typedef enum peri__mode {
    PERI__MAIN,         /* the material's own energy */
    PERI__RESTORED,     /* out of shape: quadratic energy towards special = Fhat */
    PERI__FALLBACK      /* family cannot hold a tensor: stretch model, special = its two coefficients */
} peri__mode;

/* A material made ready for the loops. */
typedef struct peri__matter {
    peri_material m;
    peri__basis g, h;
    peri_real stabiliser;   /* s (15/2) mu, Pa */
    peri_real restore;      /* k of the restoring energy, Pa */
    peri_real brace_shape, brace_volume;    /* of a correspondence solid, see peri__brace */
    double stiffness_g, stiffness_h;    /* bond stiffness of the constant matrix, Pa: g'' part, h'' part (times G) */
    double plane_mu, plane_lambda;      /* of a sheet: mu and lambda' in plane stress, Pa */
} peri__matter;

typedef struct peri__bond {
    peri_real y[3], xi[3];
    peri_real dq;       /* tau^2 - 1 */
    peri_real inv_r2, weight, gain;
} peri__bond;

/* Where in xi, inv_r2 and weight bond k of particle i is. */
static size_t peri__bond_at(const peri__bonds *b, int i, int k) {
    if (!b->start) return (size_t)k;
    return (size_t)b->start[i / PERI__LANES] + PERI__LANES * (size_t)(k - b->row[i]) + (size_t)(i % PERI__LANES);
}

/* Bond k of particle i at positions x. Differences are taken in double: float positions would have a noise floor of
   about 1e-2 of the weight of a soft body one metre across. */
static void peri__bond_load(const peri__bonds *b, int i, int k, const double *x, peri__bond *o) {
    const double *xi = x + 3 * (size_t)i, *xj = x + 3 * (size_t)b->col[k];
    size_t at = peri__bond_at(b, i, k);
    peri_real u[3];
    int c;
    for (c = 0; c < 3; c++) {
        o->xi[c] = b->xi[c][at];
        u[c] = (peri_real)(xj[c] - xi[c] - (double)o->xi[c]);
        o->y[c] = o->xi[c] + u[c];
    }
    o->inv_r2 = b->inv_r2[at];
    o->weight = b->weight[at];
    o->gain = b->gain ? b->gain[k] : 1;
    o->dq = ((2 * o->xi[0] + u[0]) * u[0] + (2 * o->xi[1] + u[1]) * u[1] + (2 * o->xi[2] + u[2]) * u[2]) * o->inv_r2;
}

static peri_real peri__tau(const peri__bond *o) {
    peri_real q = 1 + o->dq;
    return PERI__SQRT(q > PERI__R(1e-12) ? q : PERI__R(1e-12));
}

/* n n^T in Voigt order with the shear entries doubled: nn . C = n.C n. */
static void peri__bond_nn(const peri__bond *o, peri_real nn[6]) {
    peri_real a = o->xi[0] * o->inv_r2, b = o->xi[1] * o->inv_r2, c = o->xi[2] * o->inv_r2;
    nn[0] = a * o->xi[0];
    nn[1] = b * o->xi[1];
    nn[2] = c * o->xi[2];
    nn[3] = 2 * b * o->xi[2];
    nn[4] = 2 * a * o->xi[2];
    nn[5] = 2 * a * o->xi[1];
}

static void peri__cross(const double *a, const double *b, double *out) {
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

/* Two unit tangents across the unit normal N, so that t0 x t1 = N. */
static void peri__plate_tangents(const double n[3], double t[6]) {
    double length;
    int c, least = 0;
    for (c = 1; c < 3; c++)
        if (fabs(n[c]) < fabs(n[least])) least = c;
    for (c = 0; c < 3; c++) t[c] = (c == least) - n[least] * n[c];
    length = sqrt(t[0] * t[0] + t[1] * t[1] + t[2] * t[2]);
    for (c = 0; c < 3; c++) t[c] /= length;
    peri__cross(n, t, t + 3);
}

/* Fbar of particle i: least squares over its bonds, weights omega / r^2. */
static void peri__gradient(const peri__bonds *b, const double *x, int i, double f[9]) {
    const peri_real *s = b->shape + 6 * (size_t)i;
    double k[9], g[9], scale = (double)(b->share[i] / b->volume[i]);
    peri_real sum[9] = {0, 0, 0, 0, 0, 0, 0, 0, 0};
    int bond, c;
    for (bond = b->row[i]; bond < b->row[i + 1]; bond++) {
        peri__bond o;
        peri__bond_load(b, i, bond, x, &o);
        for (c = 0; c < 3; c++) {
            peri_real t = o.weight * o.inv_r2 * o.y[c];
            sum[3 * c] += t * o.xi[0];
            sum[3 * c + 1] += t * o.xi[1];
            sum[3 * c + 2] += t * o.xi[2];
        }
    }
    for (c = 0; c < 9; c++) g[c] = scale * (double)sum[c];
    k[0] = (double)s[0]; k[4] = (double)s[1]; k[8] = (double)s[2];
    k[5] = k[7] = (double)s[3];
    k[2] = k[6] = (double)s[4];
    k[1] = k[3] = (double)s[5];
    peri_mul3(g, k, f);
}

/* What particle i is made of; m: the body's first material. */
static const peri__matter *peri__matter_of(const peri__bonds *b, const peri__matter *m, int i) {
    return b->matters ? b->matters + b->kind[i] : m;
}

static peri_real peri__firmness(const peri__bonds *b, int i) { return b->factor ? b->factor[i] : 1; }

/* Each model has three functions. `local` gathers what a particle passes to its neighbours (coef, `stride` reals each)
   and returns the energy (J) of particles begin .. end - 1; `pull` is d(V_i Psi_i)/dy of one bond; `force` gathers both
   ends' pulls into f (3 n, N; set, not added). m is the body's first material: what a particle's own material says of
   its energy goes through coef, so that `force` need not know what its neighbours are made of. */

typedef double peri__local(const peri__bonds *b, const peri__matter *m, const double *x, int begin, int end,
                           peri_real *coef, int energy);
typedef void peri__pull(const peri__matter *m, const peri_real *coef, const peri__bond *o, peri_real t[3]);
typedef void peri__force(const peri__bonds *b, const peri__matter *m, const double *x, int begin, int end,
                         const peri_real *coef, peri_real *f);

/* ---- implementation 6: the stretch model (SH (12), (13)) --------------------------------------------------------- */

/* coef: unit c ls g'(theta), unit c ms. */
static double peri__stretch_one(const peri__bonds *b, const peri__matter *m, const double *x, int i, peri_real *coef,
                                int energy) {
    peri_real sum = 0, theta_e, factor = peri__firmness(b, i), c = (peri_real)b->unit * b->share[i] * factor;
    double slope = 0, value, bonds = 0;
    int k;
    m = peri__matter_of(b, m, i);
    for (k = b->row[i]; k < b->row[i + 1]; k++) {
        peri__bond o;
        peri_real tau;
        peri__bond_load(b, i, k, x, &o);
        tau = peri__tau(&o);
        sum += o.weight * o.dq / (1 + tau);
        if (energy) bonds += (double)(o.weight * o.gain) * peri__basis_energy(&m->h, o.dq, tau);
    }
    theta_e = sum * b->share[i] / b->volume[i];
    if (m->g.form == PERI__FORM_B1) {
        slope = 2 * (double)(m->g.scale * theta_e);
        value = slope * (double)theta_e / 2;
    } else {
        value = peri__basis_value(&m->g, 1 + (double)theta_e, &slope);
    }
    coef[0] = c * m->m.ls * (peri_real)slope;
    coef[1] = c * m->m.ms;
    bonds *= (double)(b->share[i] / b->volume[i]) * (double)m->m.ms;
    return energy ? b->unit * (double)(b->volume[i] * factor) * (bonds + (double)m->m.ls * value) : 0;
}

static double peri__stretch_local(const peri__bonds *b, const peri__matter *m, const double *x, int begin, int end,
                                  peri_real *coef, int energy) {
    double sum = 0;
    int i;
    for (i = begin; i < end; i++) {
        if (b->mode[i] == PERI__MAIN) sum += peri__stretch_one(b, m, x, i, coef + 2 * (size_t)i, energy);
        else coef[2 * (size_t)i] = coef[2 * (size_t)i + 1] = 0;
    }
    return sum;
}

static void peri__stretch_pull(const peri__matter *m, const peri_real *coef, const peri__bond *o, peri_real t[3]) {
    peri_real tau = peri__tau(o), inv_tau = 1 / tau;
    peri_real p = o->weight * o->inv_r2 *
                  (coef[0] * inv_tau + coef[1] * o->gain * peri__basis_pull(&m->h, o->dq, tau, inv_tau));
    t[0] = p * o->y[0];
    t[1] = p * o->y[1];
    t[2] = p * o->y[2];
}

static void peri__stretch_force(const peri__bonds *b, const peri__matter *m, const double *x, int begin, int end,
                                const peri_real *coef, peri_real *f) {
    int i, k;
    for (i = begin; i < end; i++) {
        const peri_real *ci = coef + 2 * (size_t)i;
        peri_real sum[3] = {0, 0, 0}, t[3], both[2];
        for (k = b->row[i]; k < b->row[i + 1]; k++) {
            const peri_real *cj = coef + 2 * (size_t)b->col[k];
            peri__bond o;
            peri__bond_load(b, i, k, x, &o);
            both[0] = ci[0] + cj[0];
            both[1] = ci[1] + cj[1];
            if (b->far_gain) {
                both[1] = ci[1] * o.gain + cj[1] * b->far_gain[k];
                o.gain = 1;
            }
            peri__stretch_pull(m, both, &o, t);
            sum[0] += t[0];
            sum[1] += t[1];
            sum[2] += t[2];
        }
        f[3 * (size_t)i] = sum[0];
        f[3 * (size_t)i + 1] = sum[1];
        f[3 * (size_t)i + 2] = sum[2];
    }
}

/* ---- implementation 7: the correspondence model ------------------------------------------------------------------
   C_i - 1 = H_i = M_i^-1 sum omega (tau^2 - 1) nn, M_i = sum omega nn nn^T: least squares, exact for affine maps.
   Psi_i = Psi(C_i) + t/4 sum omega (tau^2 - n.C_i n)^2 with t = s (15/2) mu. The derivative of the second term through
   C_i vanishes (normal equations), so dPsi_i/d(tau^2) = omega [nn.(M_i^-1 dPsi/dC) + t/2 (tau^2 - n.C_i n)]. */

/* Where number k of particle i's moment is. */
static size_t peri__moment_at(const peri__bonds *b, int i, int k) {
    int lane = b->lane ? b->lane[i] : i;
    if (!b->start) return 21 * (size_t)i + (size_t)k;
    return PERI__LANES * (21 * (size_t)(lane / PERI__LANES) + (size_t)k) + (size_t)(lane % PERI__LANES);
}

/* out = M_i^-1 in. */
static void peri__packed6(const peri__bonds *b, int of, const double in[6], double out[6]) {
    int i, j, k = 0;
    for (i = 0; i < 6; i++) out[i] = 0;
    for (i = 0; i < 6; i++)
        for (j = 0; j <= i; j++, k++) {
            double a = (double)b->moment[peri__moment_at(b, of, k)];
            out[i] += a * in[j];
            if (j < i) out[j] += a * in[i];
        }
}

/* Thickness of a sheet takes what value frees it of normal stress: the component of H along the normal N, found such
   that N.dPsi/dC N = 0 (regula falsi, Illinois). Psi is least there: its other derivatives feel nothing of it. */
static double peri__law_plane(const peri_material *m, const peri_real *normal, double h[6], double dpsi[6]) {
    static const int row[6] = {0, 1, 2, 1, 0, 0}, col[6] = {0, 1, 2, 2, 2, 1};
    double flat[6], nn[6], low = -0.99, high = 3, at, g, g_low = 0, g_high = 0, psi = 0, nu = (double)m->poisson;
    int k, it, side = 0;
    for (k = 0; k < 6; k++) {
        flat[k] = h[k];
        nn[k] = (double)normal[row[k]] * (double)normal[col[k]];
    }
    at = -nu / (1 - nu) * (h[0] + h[1] + h[2]);
    if (!(at > -0.9)) at = -0.9;
    for (it = 0; it < 60; it++) {
        for (k = 0; k < 6; k++) h[k] = flat[k] + at * nn[k];
        psi = peri_law_value(m, h, dpsi);
        for (g = 0, k = 0; k < 6; k++) g += (k < 3 ? 1 : 2) * dpsi[k] * nn[k];
        if (!(fabs(g) > 1e-13 * (double)m->mu) || high - low < 1e-14) break;
        if (it == 0) {      /* the first step follows the small-strain slope, the second bracket is wide */
            double slope = ((double)m->lambda + 2 * (double)m->mu) / 4;
            if (g > 0) high = at, g_high = g;
            else low = at, g_low = g;
            at -= g / slope;
            if (at > low && at < high) continue;
        } else if (g > 0) {
            high = at;
            g_high = g;
            if (side == 1) g_low /= 2;
            side = 1;
        } else {
            low = at;
            g_low = g;
            if (side == -1) g_high /= 2;
            side = -1;
        }
        at = g_low < 0 && g_high > 0 ? (low * g_high - high * g_low) / (g_high - g_low) : (low + high) / 2;
    }
    return psi;
}

/* H_i; returns sum omega (tau^2 - 1)^2 - H_i.M_i H_i, the misfit of the fit. */
static double peri__strain(const peri__bonds *b, const double *x, int i, double h[6]) {
    peri_real a[6] = {0, 0, 0, 0, 0, 0}, squares = 0, nn[6];
    double right[6], scale = (double)(b->share[i] / b->volume[i]), misfit;
    int k, c;
    for (k = b->row[i]; k < b->row[i + 1]; k++) {
        peri__bond o;
        peri_real t;
        peri__bond_load(b, i, k, x, &o);
        peri__bond_nn(&o, nn);
        t = o.weight * o.dq;
        for (c = 0; c < 6; c++) a[c] += t * nn[c];
        squares += t * o.dq;
    }
    for (c = 0; c < 6; c++) right[c] = scale * (double)a[c];
    peri__packed6(b, i, right, h);
    misfit = scale * (double)squares;
    for (c = 0; c < 6; c++) misfit -= h[c] * right[c];
    return misfit;
}

#define PERI__CORRESPONDENCE_STRIDE 8   /* 6 + 1, padded to a power of two: one cache line holds two */

static double peri__correspondence_local(const peri__bonds *b, const peri__matter *m, const double *x, int begin,
                                         int end, peri_real *coef, int energy) {
    double sum = 0, h[6], fit[6], dpsi[6], l[6], misfit, psi;
    int i, c;
    for (i = begin; i < end; i++) {
        peri_real *out = coef + PERI__CORRESPONDENCE_STRIDE * (size_t)i;
        const peri__matter *own = peri__matter_of(b, m, i);
        double factor = (double)peri__firmness(b, i), scale = b->unit * (double)b->share[i] * factor;
        double t = (double)own->stabiliser * (b->brace ? (double)b->brace[i] : 1);
        if (b->mode[i] != PERI__MAIN) {
            for (c = 0; c < PERI__CORRESPONDENCE_STRIDE; c++) out[c] = 0;
            continue;
        }
        misfit = peri__strain(b, x, i, h);
        if (b->normal) {
            memcpy(fit, h, sizeof fit);
            psi = peri__law_plane(&own->m, b->normal + 3 * (size_t)i, h, dpsi);
            memcpy(h, fit, sizeof fit);
        } else {
            psi = peri_law_value(&own->m, h, dpsi);
        }
        for (c = 3; c < 6; c++) dpsi[c] *= 2;
        peri__packed6(b, i, dpsi, l);
        for (c = 0; c < 6; c++) out[c] = (peri_real)(scale * (l[c] - t / 2 * h[c]));
        out[6] = (peri_real)(scale * t / 2);
        if (energy) sum += b->unit * (double)b->volume[i] * factor * (psi + t / 4 * misfit);
    }
    return sum;
}

static void peri__correspondence_pull(const peri__matter *m, const peri_real *coef, const peri__bond *o,
                                      peri_real t[3]) {
    peri_real nn[6], p;
    (void)m;
    peri__bond_nn(o, nn);
    p = coef[0] * nn[0] + coef[1] * nn[1] + coef[2] * nn[2] + coef[3] * nn[3] + coef[4] * nn[4] + coef[5] * nn[5] +
        coef[6] * o->dq;
    p *= 2 * o->weight * o->inv_r2;
    t[0] = p * o->y[0];
    t[1] = p * o->y[1];
    t[2] = p * o->y[2];
}

static void peri__correspondence_force(const peri__bonds *b, const peri__matter *m, const double *x, int begin,
                                       int end, const peri_real *coef, peri_real *f) {
    int i, k, c;
    for (i = begin; i < end; i++) {
        const peri_real *ci = coef + PERI__CORRESPONDENCE_STRIDE * (size_t)i;
        peri_real sum[3] = {0, 0, 0}, t[3], both[7];
        for (k = b->row[i]; k < b->row[i + 1]; k++) {
            const peri_real *cj = coef + PERI__CORRESPONDENCE_STRIDE * (size_t)b->col[k];
            peri__bond o;
            peri__bond_load(b, i, k, x, &o);
            for (c = 0; c < 7; c++) both[c] = ci[c] + cj[c];
            peri__correspondence_pull(m, both, &o, t);
            sum[0] += t[0];
            sum[1] += t[1];
            sum[2] += t[2];
        }
        f[3 * (size_t)i] = sum[0];
        f[3 * (size_t)i + 1] = sum[1];
        f[3 * (size_t)i + 2] = sum[2];
    }
}

/* ---- implementation 8: the projective model (PP (8), (10), (11)) -------------------------------------------------
   The local step's targets are r dir(Fbar xi) and r dir(y). PP's force drops the derivative of Fbar; what is minimised
   at fixed targets is sum omega [a |y/r - dir(Fbar n)|^2 + b/2 (tau - 1)^2], which is the energy reported (equal to
   PP (8) for affine maps). */

#define PERI__PROJECTIVE_STRIDE 11  /* Fbar, unit c 2 a, unit c b */

/* F xi / |F n|: where the local step wants the bond's other end, r dir(F xi). */
static void peri__projective_target(const peri_real *f, const peri__bond *o, peri_real d[3]) {
    peri_real square = 0, inverse;
    int c;
    for (c = 0; c < 3; c++) {
        d[c] = f[3 * c] * o->xi[0] + f[3 * c + 1] * o->xi[1] + f[3 * c + 2] * o->xi[2];
        square += d[c] * d[c];
    }
    square *= o->inv_r2;
    inverse = square > PERI__R(1e-24) ? 1 / PERI__SQRT(square) : 0;
    for (c = 0; c < 3; c++) d[c] *= inverse;
}

/* f: the particle's coefficients. */
static double peri__projective_energy(const peri__bonds *b, const double *x, int i, const peri_real *f) {
    double sum = 0, a = (double)f[9] / 2, half_b = (double)f[10] / 2;
    int k, c;
    for (k = b->row[i]; k < b->row[i + 1]; k++) {
        peri__bond o;
        peri_real d[3], square = 0;
        double e;
        peri__bond_load(b, i, k, x, &o);
        peri__projective_target(f, &o, d);
        for (c = 0; c < 3; c++) square += (o.y[c] - d[c]) * (o.y[c] - d[c]);
        e = (double)(o.dq / (1 + peri__tau(&o)));
        sum += (double)o.weight * (a * (double)(square * o.inv_r2) + half_b * e * e);
    }
    return sum;
}

static double peri__projective_local(const peri__bonds *b, const peri__matter *m, const double *x, int begin, int end,
                                     peri_real *coef, int energy) {
    double sum = 0, f[9], scale;
    int i, c;
    for (i = begin; i < end; i++) {
        peri_real *out = coef + PERI__PROJECTIVE_STRIDE * (size_t)i;
        const peri__matter *own;
        if (b->mode[i] != PERI__MAIN) {
            for (c = 0; c < PERI__PROJECTIVE_STRIDE; c++) out[c] = 0;
            continue;
        }
        peri__gradient(b, x, i, f);
        for (c = 0; c < 9; c++) out[c] = (peri_real)f[c];
        own = peri__matter_of(b, m, i);
        scale = b->unit * (double)b->share[i] * (double)peri__firmness(b, i);
        out[9] = (peri_real)(scale * 2 * (double)own->m.a);
        out[10] = (peri_real)(scale * (double)own->m.b);
        if (energy) sum += peri__projective_energy(b, x, i, out);
    }
    return sum;
}

static void peri__projective_pull(const peri__matter *m, const peri_real *coef, const peri__bond *o, peri_real t[3]) {
    peri_real d[3], scale = o->weight * o->inv_r2, along = coef[9] + coef[10] - coef[10] / peri__tau(o);
    int c;
    (void)m;
    peri__projective_target(coef, o, d);
    for (c = 0; c < 3; c++) t[c] = scale * (along * o->y[c] - coef[9] * d[c]);
}

/* Both ends' pulls at once: the part along y is shared. */
static void peri__projective_force(const peri__bonds *b, const peri__matter *m, const double *x, int begin, int end,
                                   const peri_real *coef, peri_real *f) {
    int i, k, c;
    (void)m;
    for (i = begin; i < end; i++) {
        const peri_real *ci = coef + PERI__PROJECTIVE_STRIDE * (size_t)i;
        peri_real sum[3] = {0, 0, 0}, di[3], dj[3];
        for (k = b->row[i]; k < b->row[i + 1]; k++) {
            const peri_real *cj = coef + PERI__PROJECTIVE_STRIDE * (size_t)b->col[k];
            peri__bond o;
            peri_real scale, along, both;
            peri__bond_load(b, i, k, x, &o);
            peri__projective_target(ci, &o, di);
            peri__projective_target(cj, &o, dj);
            scale = o.weight * o.inv_r2;
            both = ci[10] + cj[10];
            along = ci[9] + cj[9] + both - both / peri__tau(&o);
            for (c = 0; c < 3; c++) sum[c] += scale * (along * o.y[c] - (ci[9] * di[c] + cj[9] * dj[c]));
        }
        for (c = 0; c < 3; c++) f[3 * (size_t)i + (size_t)c] = sum[c];
    }
}

/* ---- implementation 9: the models in lanes ----------------------------------------------------------------------
   What 16 particles gather from their bonds in lockstep: bond number s of each, lane beside lane. Two layouts, which
   differ only in how a bond is found:
       lockstep   the bonds' own arrays, which lie so that bond s of a block's particles is one piece of 16; lanes that
                  have fewer bonds than others are filled with bonds of no weight to the particle itself
       lattice    bodies whose points stand on a lattice: cells of a grid that ends in empty ones, 16 in a row to a
                  block (blocks without particles are left out); one stencil of bonds for all, no data per bond, and
                  what is at the other end is read in one piece. The weight of a bond is w(r) v_i v_j, 0 where a cell is
                  empty.
   Positions are displacements from the rest shape as it was put into the world: in float, 32-bit fixed point over the
   box that they fill, so that their differences are exact; else doubles. Sums over lanes go from the first to the last.
   Sheets, rods, anisotropic bodies, bodies of several materials or of general basis functions and those too small or
   too uneven for lanes (peri__lanes.blocks is 0) run the functions above. */

#ifdef PERI_DOUBLE
typedef double peri__spot;
#else
typedef int32_t peri__spot;
#endif

typedef struct peri__lanes {
    int blocks;             /* of PERI__LANES lanes; 0: the body has none */
    int lattice;            /* 1: lattice, 0: lockstep */
    int length;             /* of x and coef: lanes, or cells */
    int bonds;              /* of the stencil */
    int *who;               /* PERI__LANES blocks: the particle in a lane, or -1; ascending */
    int *lane;              /* n: where a particle's moment lies; lockstep: its own number */
    int *first;             /* blocks + 1: first particle of a block */
    int *base;              /* blocks: lattice: its first cell */
    int *offset;            /* bonds: lattice: from a cell to the other end's */
    const int *start;       /* blocks + 1: lockstep: first bond of a block, */
    const int *near;        /* and the particle at the other end of each */
    const peri_real *xi[3], *inv_r2, *weight;   /* of the bonds, or of the stencil */
    peri_real *stencil;     /* 11 bonds: where those and nn lie */
    const peri_real *nn;    /* 6 bonds: lattice: n n^T of each */
    peri_real *volume;      /* length: lattice: v of a cell, 0: empty */
    peri__spot *x[3];      /* length */
    peri_real *coef;        /* stride arrays of length */
    peri_real unit;         /* m, of x */
} peri__lanes;

/* The particles of a block themselves. */
typedef struct peri__own {
    peri__spot x[3][PERI__LANES];
    peri__row volume;       /* v, of a lattice, whose bonds leave it out; else 1 */
    peri__row scale, norm;  /* unit c and c/v times volume; 0 in lanes without a particle that counts */
    peri__row brace;        /* factor on the stabiliser */
    peri__row2 size;        /* unit v, in the same way */
} peri__own;

/* Bond s of each of them. */
typedef struct peri__bond16 {
    const int *near;        /* lockstep */
    size_t at, k;           /* lattice: first cell at the other end; place in the arrays of bonds */
    peri__row y[3], dq, weight;
} peri__bond16;

/* In a loop over lanes l: index of the other end from `at` on, of the bond's constants from k on. */
#define PERI__FAR(l) (lattice ? (l) : near[l])
#define PERI__SAME(l) (lattice ? 0 : (l))

PERI__INLINE int peri__lanes_bonds(const peri__lanes *t, int block, int lattice) {
    return lattice ? t->bonds : (t->start[block + 1] - t->start[block]) / PERI__LANES;
}

PERI__INLINE size_t peri__lanes_at(const peri__lanes *t, int block, int lattice) {
    return (size_t)(lattice ? t->base[block] : block * PERI__LANES);
}

/* mode: of the particles, NULL: all count. */
PERI__INLINE void peri__lanes_own(const peri__bonds *b, const peri__lanes *t, int block, int lattice,
                                  const unsigned char *mode, peri__own *o) {
    size_t at = peri__lanes_at(t, block, lattice);
    const int *who = t->who + PERI__LANES * (size_t)block;
    int l, c;
    for (c = 0; c < 3; c++) PERI__EACH(l) o->x[c][l] = t->x[c][at + (size_t)l];
    PERI__EACH(l) {
        int i = who[l] < 0 ? 0 : who[l], counts = who[l] >= 0 && (!mode || mode[i] == PERI__MAIN);
        peri_real factor = b->factor ? b->factor[i] : 1;
        o->volume[l] = lattice ? t->volume[at + (size_t)l] : 1;
        o->brace[l] = b->brace ? b->brace[i] : 1;
        o->scale[l] = counts ? (peri_real)b->unit * b->share[i] * factor : 0;
        o->norm[l] = counts ? b->share[i] / b->volume[i] * o->volume[l] : 0;
        o->size[l] = counts ? b->unit * (double)(b->volume[i] * factor) : 0;
    }
}

/* Loads bond s. */
PERI__INLINE void peri__lanes_load(const peri__lanes *t, const peri__own *own, int block, int s, int lattice,
                                   peri__bond16 *o) {
    size_t k = lattice ? (size_t)s : (size_t)t->start[block] + PERI__LANES * (size_t)s;
    size_t at = lattice ? (size_t)(t->base[block] + t->offset[s]) : 0;
    const int *near = lattice ? NULL : t->near + k;
    const peri__spot *x0 = t->x[0] + at, *x1 = t->x[1] + at, *x2 = t->x[2] + at;
    const peri_real *xi0 = t->xi[0] + k, *xi1 = t->xi[1] + k, *xi2 = t->xi[2] + k, *inv_r2 = t->inv_r2 + k;
    const peri_real *weight = t->weight + k, *volume = t->volume + at;
    peri_real unit = t->unit;
    int l;
    o->near = near;
    o->at = at;
    o->k = k;
    PERI__EACH(l) {
        int j = PERI__FAR(l), m = PERI__SAME(l);
        peri_real u0 = (peri_real)(x0[j] - own->x[0][l]) * unit, u1 = (peri_real)(x1[j] - own->x[1][l]) * unit;
        peri_real u2 = (peri_real)(x2[j] - own->x[2][l]) * unit;
        o->y[0][l] = xi0[m] + u0;
        o->y[1][l] = xi1[m] + u1;
        o->y[2][l] = xi2[m] + u2;
        u0 *= xi0[m] + o->y[0][l];
        u0 = PERI__MAD(u1, xi1[m] + o->y[1][l], u0);
        o->dq[l] = PERI__MAD(u2, xi2[m] + o->y[2][l], u0) * inv_r2[m];
        o->weight[l] = lattice ? weight[0] * volume[l] : weight[l];
    }
}

PERI__INLINE void peri__lanes_tau(const peri__bond16 *o, peri_real *tau) {
    int l;
    PERI__EACH(l) {
        const peri_real q = 1 + o->dq[l];
        tau[l] = q > PERI__R(1e-12) ? q : PERI__R(1e-12);
    }
    peri__roots(tau);
}

PERI__INLINE void peri__lanes_zero(int n, peri__row *v) {
    int k, l;
    for (k = 0; k < n; k++) PERI__EACH(l) v[k][l] = 0;
}

PERI__INLINE void peri__lanes_put(const peri__lanes *t, const peri__own *own, int block, peri__row *sum, peri_real *f) {
    const int *who = t->who + PERI__LANES * (size_t)block;
    int l, c;
    for (c = 0; c < 3; c++) PERI__EACH(l) sum[c][l] *= own->volume[l];
    for (l = 0; l < PERI__LANES; l++) {
        if (who[l] < 0) continue;
        for (c = 0; c < 3; c++) f[3 * (size_t)who[l] + (size_t)c] = sum[c][l];
    }
}

/* f'(tau) of one of the short forms. */
PERI__INLINE void peri__basis_slope16(const peri__basis *f, const peri_real *dq, const peri_real *tau,
                                      const peri_real *inverse, peri_real *out) {
    const peri_real scale = f->scale, least = PERI__R(PERI__S_MIN);
    const peri_real first = (peri_real)f->first_min, second = (peri_real)f->second_min;
    int l;
    if (f->form == PERI__FORM_B1) {
        PERI__EACH(l) out[l] = 2 * scale * dq[l] / (1 + tau[l]);
    } else if (f->form == PERI__FORM_SVK) {
        PERI__EACH(l) out[l] = scale * dq[l] * tau[l];
    } else {
        PERI__EACH(l) {
            peri_real low = first + second * (tau[l] - least), high = scale * dq[l] * inverse[l];
            out[l] = tau[l] < least ? low : high;
        }
    }
}

/* f(tau) of one of the short forms; e = tau - 1. */
PERI__INLINE void peri__basis_energy16(const peri__basis *f, const peri_real *dq, const peri_real *tau,
                                       const peri_real *e, peri_real *out) {
    const peri_real scale = f->scale, least = PERI__R(PERI__S_MIN), value = (peri_real)f->f_min;
    const peri_real first = (peri_real)f->first_min, second = (peri_real)f->second_min;
    peri__row clamped;
    int l;
    if (f->form == PERI__FORM_B1) {
        PERI__EACH(l) out[l] = scale * e[l] * e[l];
    } else if (f->form == PERI__FORM_SVK) {
        PERI__EACH(l) out[l] = scale / 4 * dq[l] * dq[l];
    } else {
        PERI__EACH(l) clamped[l] = dq[l] > least * least - 1 ? dq[l] : least * least - 1;
        peri__log_excess(PERI__LANES, clamped, out);
        PERI__EACH(l) {
            peri_real ds = tau[l] - least, low = value + ds * (first + ds * second / 2);
            out[l] = ds < 0 ? low : scale / 2 * out[l];
        }
    }
}

/* Stretch model: coef as of the scalar form. */
PERI__INLINE double peri__stretch_local_block(const peri__bonds *b, const peri__lanes *t, const peri__matter *m,
                                              int block, int lattice, int energy) {
    peri__own own;
    peri__row sum, bonds, tau, inverse, e, value, dq;
    size_t at = peri__lanes_at(t, block, lattice), length = (size_t)t->length;
    peri_real *c0 = t->coef + at, *c1 = c0 + length;
    const peri_real ls = m->m.ls, ms = m->m.ms;
    int s, l, n = peri__lanes_bonds(t, block, lattice);
    double total = 0;
    peri__lanes_own(b, t, block, lattice, b->mode, &own);
    peri__lanes_zero(1, &sum);
    peri__lanes_zero(1, &bonds);
    for (s = 0; s < n; s++) {
        peri__bond16 o;
        peri__lanes_load(t, &own, block, s, lattice, &o);
        peri__lanes_tau(&o, tau);
        PERI__EACH(l) e[l] = o.dq[l] / (1 + tau[l]);
        PERI__EACH(l) sum[l] = PERI__MAD(o.weight[l], e[l], sum[l]);
        if (!energy) continue;
        peri__basis_energy16(&m->h, o.dq, tau, e, value);
        PERI__EACH(l) bonds[l] += o.weight[l] * value[l];
    }
    PERI__EACH(l) {
        e[l] = sum[l] * own.norm[l];
        dq[l] = e[l] * (2 + e[l]);
        tau[l] = 1 + e[l] > PERI__R(1e-6) ? 1 + e[l] : PERI__R(1e-6);
        inverse[l] = 1 / tau[l];
    }
    peri__basis_slope16(&m->g, dq, tau, inverse, value);
    PERI__EACH(l) c0[l] = own.scale[l] * ls * value[l];
    PERI__EACH(l) c1[l] = own.scale[l] * ms;
    if (!energy) return 0;
    peri__basis_energy16(&m->g, dq, tau, e, value);
    PERI__EACH(l) total += own.size[l] * (double)(bonds[l] * own.norm[l] * ms + ls * value[l]);
    return total;
}

PERI__INLINE void peri__stretch_force_block(const peri__bonds *b, const peri__lanes *t, const peri__matter *m,
                                            int block, int lattice, peri_real *f) {
    peri__own own;
    peri__row sum[3], tau, inverse, slope, own0, own1;
    size_t at = peri__lanes_at(t, block, lattice), length = (size_t)t->length;
    int s, l, n = peri__lanes_bonds(t, block, lattice);
    peri__lanes_own(b, t, block, lattice, b->mode, &own);
    peri__lanes_zero(3, sum);
    PERI__EACH(l) own0[l] = t->coef[at + (size_t)l];
    PERI__EACH(l) own1[l] = t->coef[at + length + (size_t)l];
    for (s = 0; s < n; s++) {
        peri__bond16 o;
        const int *near;
        const peri_real *far0, *far1, *inv_r2;
        peri__lanes_load(t, &own, block, s, lattice, &o);
        peri__lanes_tau(&o, tau);
        PERI__EACH(l) inverse[l] = 1 / tau[l];
        peri__basis_slope16(&m->h, o.dq, tau, inverse, slope);
        near = o.near;
        far0 = t->coef + o.at;
        far1 = far0 + length;
        inv_r2 = t->inv_r2 + o.k;
        PERI__EACH(l) {
            int j = PERI__FAR(l);
            peri_real p = PERI__MAD(own1[l] + far1[j], slope[l], own0[l] + far0[j]);
            p *= o.weight[l] * inv_r2[PERI__SAME(l)] * inverse[l];
            sum[0][l] = PERI__MAD(p, o.y[0][l], sum[0][l]);
            sum[1][l] = PERI__MAD(p, o.y[1][l], sum[1][l]);
            sum[2][l] = PERI__MAD(p, o.y[2][l], sum[2][l]);
        }
    }
    peri__lanes_put(t, &own, block, sum, f);
}

/* nn of bond o (see peri__bond_nn) into nn: of each lane, or one for all. */
PERI__INLINE void peri__lanes_nn(const peri__lanes *t, const peri__bond16 *o, int lattice, peri__row *nn) {
    const peri_real *xi0 = t->xi[0] + o->k, *xi1 = t->xi[1] + o->k, *xi2 = t->xi[2] + o->k, *inv_r2 = t->inv_r2 + o->k;
    int l, c;
    for (c = 0; c < 6 && lattice; c++) nn[c][0] = t->nn[6 * o->k + (size_t)c];
    if (lattice) return;
    PERI__EACH(l) {
        const peri_real x = xi0[l], y = xi1[l], z = xi2[l], a = x * inv_r2[l], b = y * inv_r2[l];
        nn[0][l] = a * x;
        nn[1][l] = b * y;
        nn[2][l] = z * inv_r2[l] * z;
        nn[3][l] = 2 * b * z;
        nn[4][l] = 2 * a * z;
        nn[5][l] = 2 * a * y;
    }
}

/* out = M^-1 in of a block's particles; m: 21 rows. out may not be in. */
PERI__INLINE void peri__packed16(const peri_real *m, peri__row *in, peri__row *out) {
    static const int place[6][6] = {{0, 1, 3, 6, 10, 15},   {1, 2, 4, 7, 11, 16},   {3, 4, 5, 8, 12, 17},
                                    {6, 7, 8, 9, 13, 18},   {10, 11, 12, 13, 14, 19}, {15, 16, 17, 18, 19, 20}};
    int i, l;
    for (i = 0; i < 6; i++) {
        const peri_real *m0 = m + PERI__LANES * place[i][0], *m1 = m + PERI__LANES * place[i][1];
        const peri_real *m2 = m + PERI__LANES * place[i][2], *m3 = m + PERI__LANES * place[i][3];
        const peri_real *m4 = m + PERI__LANES * place[i][4], *m5 = m + PERI__LANES * place[i][5];
        peri__row sum;
        PERI__EACH(l) {
            peri_real a = PERI__MAD(m1[l], in[1][l], m0[l] * in[0][l]);
            peri_real c = PERI__MAD(m3[l], in[3][l], m2[l] * in[2][l]);
            sum[l] = (a + c) + PERI__MAD(m5[l], in[5][l], m4[l] * in[4][l]);
        }
        PERI__EACH(l) out[i][l] = sum[l];
    }
}

/* H of a block's particles; right: M H; squares: sum omega (tau^2 - 1)^2. */
PERI__INLINE void peri__strain_block(const peri__bonds *b, const peri__lanes *t, const peri__own *own, int block,
                                     int lattice, peri__row *h, peri__row *right, peri_real *squares) {
    int s, l, c, n = peri__lanes_bonds(t, block, lattice);
    peri__row a[7];
    peri__lanes_zero(7, a);
    for (s = 0; s < n; s++) {
        peri__bond16 o;
        peri__row nn[6];
        peri__lanes_load(t, own, block, s, lattice, &o);
        peri__lanes_nn(t, &o, lattice, nn);
        PERI__EACH(l) {
            const int k = PERI__SAME(l);
            const peri_real p = o.weight[l] * o.dq[l];
            a[0][l] = PERI__MAD(p, nn[0][k], a[0][l]);
            a[1][l] = PERI__MAD(p, nn[1][k], a[1][l]);
            a[2][l] = PERI__MAD(p, nn[2][k], a[2][l]);
            a[3][l] = PERI__MAD(p, nn[3][k], a[3][l]);
            a[4][l] = PERI__MAD(p, nn[4][k], a[4][l]);
            a[5][l] = PERI__MAD(p, nn[5][k], a[5][l]);
            a[6][l] = PERI__MAD(p, o.dq[l], a[6][l]);
        }
    }
    for (c = 0; c < 6; c++) PERI__EACH(l) right[c][l] = own->norm[l] * a[c][l];
    PERI__EACH(l) squares[l] = own->norm[l] * a[6][l];
    peri__packed16(b->moment + 21 * PERI__LANES * (size_t)block, right, h);
}

/* What follows of H, particle by particle: coefficients and energy. */
PERI__INLINE double peri__correspondence_point(const peri__bonds *b, const peri__lanes *t, const peri__matter *m,
                                               const peri__own *own, int block, size_t at, peri__row *h,
                                               peri__row *right, const peri_real *squares, int energy) {
    peri__row stress[6], l6[6], half;
    peri__row2 strain[6], dpsi[6], psi;
    double total = 0;
    int l, c;
    PERI__EACH(l) half[l] = m->stabiliser / 2 * own->brace[l];
    for (c = 0; c < 6; c++) PERI__EACH(l) strain[c][l] = (double)h[c][l];
    peri__law(&m->m, PERI__LANES, strain, dpsi, psi);
    for (c = 0; c < 6; c++) {
        const double twice = c < 3 ? 1 : 2;
        PERI__EACH(l) stress[c][l] = (peri_real)(twice * dpsi[c][l]);
    }
    peri__packed16(b->moment + 21 * PERI__LANES * (size_t)block, stress, l6);
    for (c = 0; c < 6; c++) {
        peri_real *out = t->coef + at + (size_t)c * (size_t)t->length;
        PERI__EACH(l) stress[c][l] = own->scale[l] * (l6[c][l] - half[l] * h[c][l]);
        PERI__EACH(l) out[l] = stress[c][l];
    }
    PERI__EACH(l) t->coef[at + 6 * (size_t)t->length + (size_t)l] = own->scale[l] * half[l];
    if (!energy) return 0;
    PERI__EACH(l) {
        double misfit = (double)squares[l];
        for (c = 0; c < 6; c++) misfit -= strain[c][l] * (double)right[c][l];
        total += own->size[l] * (psi[l] + (double)half[l] / 2 * misfit);
    }
    return total;
}

PERI__INLINE double peri__correspondence_local_block(const peri__bonds *b, const peri__lanes *t,
                                                     const peri__matter *m, int block, int lattice, int energy) {
    peri__own own;
    peri__row h[6], right[6], squares;
    peri__lanes_own(b, t, block, lattice, b->mode, &own);
    peri__strain_block(b, t, &own, block, lattice, h, right, squares);
    return peri__correspondence_point(b, t, m, &own, block, peri__lanes_at(t, block, lattice), h, right, squares,
                                      energy);
}

PERI__INLINE void peri__correspondence_force_block(const peri__bonds *b, const peri__lanes *t, const peri__matter *m,
                                                   int block, int lattice, peri_real *f) {
    peri__own own;
    peri__row sum[3], mine[7];
    size_t at = peri__lanes_at(t, block, lattice), length = (size_t)t->length;
    int s, l, c, n = peri__lanes_bonds(t, block, lattice);
    (void)m;
    peri__lanes_own(b, t, block, lattice, b->mode, &own);
    peri__lanes_zero(3, sum);
    for (c = 0; c < 7; c++) PERI__EACH(l) mine[c][l] = t->coef[at + (size_t)c * length + (size_t)l];
    for (s = 0; s < n; s++) {
        peri__bond16 o;
        const int *near;
        const peri_real *inv_r2, *far;
        peri__row nn[6];
        peri__lanes_load(t, &own, block, s, lattice, &o);
        peri__lanes_nn(t, &o, lattice, nn);
        near = o.near;
        inv_r2 = t->inv_r2 + o.k;
        far = t->coef + o.at;
        PERI__EACH(l) {
            const peri_real *fj = far + PERI__FAR(l);
            const int k = PERI__SAME(l);
            peri_real p = (mine[0][l] + fj[0]) * nn[0][k], p1 = (mine[1][l] + fj[length]) * nn[1][k];
            p = PERI__MAD(mine[2][l] + fj[2 * length], nn[2][k], p);
            p1 = PERI__MAD(mine[3][l] + fj[3 * length], nn[3][k], p1);
            p = PERI__MAD(mine[4][l] + fj[4 * length], nn[4][k], p);
            p1 = PERI__MAD(mine[5][l] + fj[5 * length], nn[5][k], p1);
            p = PERI__MAD(mine[6][l] + fj[6 * length], o.dq[l], p) + p1;
            p *= o.weight[l] * (2 * inv_r2[k]);
            sum[0][l] = PERI__MAD(p, o.y[0][l], sum[0][l]);
            sum[1][l] = PERI__MAD(p, o.y[1][l], sum[1][l]);
            sum[2][l] = PERI__MAD(p, o.y[2][l], sum[2][l]);
        }
    }
    peri__lanes_put(t, &own, block, sum, f);
}

/* Fbar of a block's particles. */
PERI__INLINE void peri__gradient_block(const peri__bonds *b, const peri__lanes *t, const peri__own *own, int block,
                                       int lattice, peri__row *f) {
    const int *who = t->who + PERI__LANES * (size_t)block;
    int s, l, c, n = peri__lanes_bonds(t, block, lattice);
    peri__row g[9], shape[6];
    peri__lanes_zero(9, g);
    for (s = 0; s < n; s++) {
        peri__bond16 o;
        const peri_real *xi0, *xi1, *xi2, *inv_r2;
        peri__lanes_load(t, own, block, s, lattice, &o);
        xi0 = t->xi[0] + o.k;
        xi1 = t->xi[1] + o.k;
        xi2 = t->xi[2] + o.k;
        inv_r2 = t->inv_r2 + o.k;
        PERI__EACH(l) {
            const int m = PERI__SAME(l);
            const peri_real p = o.weight[l] * inv_r2[m], a = p * xi0[m], d = p * xi1[m], e = p * xi2[m];
            g[0][l] = PERI__MAD(a, o.y[0][l], g[0][l]);
            g[1][l] = PERI__MAD(d, o.y[0][l], g[1][l]);
            g[2][l] = PERI__MAD(e, o.y[0][l], g[2][l]);
            g[3][l] = PERI__MAD(a, o.y[1][l], g[3][l]);
            g[4][l] = PERI__MAD(d, o.y[1][l], g[4][l]);
            g[5][l] = PERI__MAD(e, o.y[1][l], g[5][l]);
            g[6][l] = PERI__MAD(a, o.y[2][l], g[6][l]);
            g[7][l] = PERI__MAD(d, o.y[2][l], g[7][l]);
            g[8][l] = PERI__MAD(e, o.y[2][l], g[8][l]);
        }
    }
    PERI__EACH(l) {
        const peri_real *of = b->shape + 6 * (size_t)(who[l] < 0 ? 0 : who[l]);
        for (c = 0; c < 6; c++) shape[c][l] = own->norm[l] * of[c];
    }
    for (c = 0; c < 9; c += 3)
        PERI__EACH(l) {
            const peri_real a = g[c][l], d = g[c + 1][l], e = g[c + 2][l];
            f[c][l] = a * shape[0][l] + d * shape[5][l] + e * shape[4][l];
            f[c + 1][l] = a * shape[5][l] + d * shape[1][l] + e * shape[3][l];
            f[c + 2][l] = a * shape[4][l] + d * shape[3][l] + e * shape[2][l];
        }
}

/* F xi of 16 bonds with gradients f into d, |F n| into length (not below 1e-12): see peri__projective_target. */
PERI__INLINE void peri__target16(const peri__lanes *t, const peri__bond16 *o, int lattice, peri__row *f,
                                 peri__row *d, peri_real *length) {
    const peri_real *xi0 = t->xi[0] + o->k, *xi1 = t->xi[1] + o->k, *xi2 = t->xi[2] + o->k, *inv_r2 = t->inv_r2 + o->k;
    int l;
    PERI__EACH(l) {
        const int k = PERI__SAME(l);
        const peri_real x = xi0[k], y = xi1[k], z = xi2[k];
        const peri_real d0 = PERI__MAD(f[2][l], z, PERI__MAD(f[1][l], y, f[0][l] * x));
        const peri_real d1 = PERI__MAD(f[5][l], z, PERI__MAD(f[4][l], y, f[3][l] * x));
        const peri_real d2 = PERI__MAD(f[8][l], z, PERI__MAD(f[7][l], y, f[6][l] * x));
        const peri_real square = PERI__MAD(d2, d2, PERI__MAD(d1, d1, d0 * d0)) * inv_r2[k];
        d[0][l] = d0;
        d[1][l] = d1;
        d[2][l] = d2;
        length[l] = square > PERI__R(1e-24) ? square : PERI__R(1e-24);
    }
    peri__roots(length);
}

PERI__INLINE double peri__projective_local_block(const peri__bonds *b, const peri__lanes *t, const peri__matter *m,
                                                 int block, int lattice, int energy) {
    peri__own own;
    peri__row f[9], d[3], tau, length_d, sum;
    size_t at = peri__lanes_at(t, block, lattice), length = (size_t)t->length;
    const peri_real a = m->m.a, half_b = m->m.b / 2;
    int s, l, c, n = energy ? peri__lanes_bonds(t, block, lattice) : 0;
    double total = 0;
    peri__lanes_own(b, t, block, lattice, b->mode, &own);
    peri__gradient_block(b, t, &own, block, lattice, f);
    for (c = 0; c < 9; c++) {
        peri_real *out = t->coef + at + (size_t)c * length;
        PERI__EACH(l) out[l] = f[c][l];
    }
    PERI__EACH(l) t->coef[at + 9 * length + (size_t)l] = own.scale[l] * 2 * a;
    PERI__EACH(l) t->coef[at + 10 * length + (size_t)l] = own.scale[l] * 2 * half_b;
    peri__lanes_zero(1, &sum);
    for (s = 0; s < n; s++) {
        peri__bond16 o;
        const peri_real *inv_r2;
        peri__lanes_load(t, &own, block, s, lattice, &o);
        peri__lanes_tau(&o, tau);
        peri__target16(t, &o, lattice, f, d, length_d);
        inv_r2 = t->inv_r2 + o.k;
        PERI__EACH(l) {
            const peri_real inverse = 1 / length_d[l], e = o.dq[l] / (1 + tau[l]);
            const peri_real d0 = o.y[0][l] - inverse * d[0][l], d1 = o.y[1][l] - inverse * d[1][l];
            const peri_real d2 = o.y[2][l] - inverse * d[2][l];
            const peri_real square = (d0 * d0 + d1 * d1 + d2 * d2) * inv_r2[PERI__SAME(l)];
            sum[l] += o.weight[l] * (a * square + half_b * e * e);
        }
    }
    PERI__EACH(l) total += own.size[l] * (double)(own.norm[l] * sum[l]);
    return total;
}

PERI__INLINE void peri__projective_force_block(const peri__bonds *b, const peri__lanes *t, const peri__matter *m,
                                               int block, int lattice, peri_real *f) {
    peri__own own;
    peri__row sum[3], mine[11], far[11], di[3], dj[3], tau, length_i, length_j;
    size_t at = peri__lanes_at(t, block, lattice), length = (size_t)t->length;
    int s, l, c, n = peri__lanes_bonds(t, block, lattice);
    (void)m;
    peri__lanes_own(b, t, block, lattice, b->mode, &own);
    peri__lanes_zero(3, sum);
    for (c = 0; c < 11; c++) PERI__EACH(l) mine[c][l] = t->coef[at + (size_t)c * length + (size_t)l];
    for (s = 0; s < n; s++) {
        peri__bond16 o;
        const int *near;
        const peri_real *inv_r2;
        peri__lanes_load(t, &own, block, s, lattice, &o);
        near = o.near;
        inv_r2 = t->inv_r2 + o.k;
        for (c = 0; c < 11; c++) {
            const peri_real *from = t->coef + o.at + (size_t)c * length;
            PERI__EACH(l) far[c][l] = from[PERI__FAR(l)];
        }
        peri__lanes_tau(&o, tau);
        peri__target16(t, &o, lattice, mine, di, length_i);
        peri__target16(t, &o, lattice, far, dj, length_j);
        PERI__EACH(l) {
            const peri_real scale = o.weight[l] * inv_r2[PERI__SAME(l)], both = mine[10][l] + far[10][l];
            const peri_real ends = length_i[l] * length_j[l], inverse = 1 / (ends * tau[l]);    /* one division */
            const peri_real a = mine[9][l] * (inverse * tau[l] * length_j[l]);
            const peri_real d = far[9][l] * (inverse * tau[l] * length_i[l]);
            const peri_real along = PERI__MAD(-both, inverse * ends, mine[9][l] + far[9][l] + both);
            const peri_real p0 = PERI__MAD(along, o.y[0][l], PERI__MAD(-a, di[0][l], -d * dj[0][l]));
            const peri_real p1 = PERI__MAD(along, o.y[1][l], PERI__MAD(-a, di[1][l], -d * dj[1][l]));
            const peri_real p2 = PERI__MAD(along, o.y[2][l], PERI__MAD(-a, di[2][l], -d * dj[2][l]));
            sum[0][l] = PERI__MAD(scale, p0, sum[0][l]);
            sum[1][l] = PERI__MAD(scale, p1, sum[1][l]);
            sum[2][l] = PERI__MAD(scale, p2, sum[2][l]);
        }
    }
    peri__lanes_put(t, &own, block, sum, f);
}

/* Local and force of a model over blocks begin .. end - 1, for either layout. local returns their energy, J. */
typedef double peri__lanes_local(const peri__bonds *b, const peri__lanes *t, const peri__matter *m, int begin, int end,
                                 int energy);
typedef void peri__lanes_force(const peri__bonds *b, const peri__lanes *t, const peri__matter *m, int begin, int end,
                               peri_real *f);

#define PERI__LANES_MODEL(name)                                                                                        \
    static double peri__##name##_lanes_local(const peri__bonds *b, const peri__lanes *t, const peri__matter *m,        \
                                             int begin, int end, int energy) {                                         \
        double sum = 0;                                                                                                \
        int q;                                                                                                         \
        for (q = begin; q < end; q++)                                                                                  \
            sum += t->lattice ? peri__##name##_local_block(b, t, m, q, 1, energy)                                      \
                              : peri__##name##_local_block(b, t, m, q, 0, energy);                                     \
        return sum;                                                                                                    \
    }                                                                                                                  \
    static void peri__##name##_lanes_force(const peri__bonds *b, const peri__lanes *t, const peri__matter *m,          \
                                           int begin, int end, peri_real *f) {                                         \
        int q;                                                                                                         \
        for (q = begin; q < end; q++) {                                                                                \
            if (t->lattice) peri__##name##_force_block(b, t, m, q, 1, f);                                              \
            else peri__##name##_force_block(b, t, m, q, 0, f);                                                         \
        }                                                                                                              \
    }
PERI__LANES_MODEL(projective)
PERI__LANES_MODEL(stretch)
PERI__LANES_MODEL(correspondence)

/* Fbar (9) of the particles of a block, and C - 1 (6) where h is not NULL. */
PERI__SHARED void peri__lanes_fit(const peri__bonds *b, const peri__lanes *t, int block, peri__row *f, peri__row *h) {
    peri__row right[6], squares;
    peri__own own;
    if (t->lattice) {
        peri__lanes_own(b, t, block, 1, NULL, &own);
        peri__gradient_block(b, t, &own, block, 1, f);
        if (h) peri__strain_block(b, t, &own, block, 1, h, right, squares);
    } else {
        peri__lanes_own(b, t, block, 0, NULL, &own);
        peri__gradient_block(b, t, &own, block, 0, f);
        if (h) peri__strain_block(b, t, &own, block, 0, h, right, squares);
    }
}

/* ---- implementation 10: the models' table, particles with another energy ------------------------------------------
   A new material is a row here and its functions above. */

typedef struct peri__model_row {
    const char *name;
    int stride;             /* reals that a particle passes to its neighbours */
    peri__local *local;
    peri__pull *pull;
    peri__force *force;
    peri__lanes_local *lanes_local;
    peri__lanes_force *lanes_force;
} peri__model_row;

PERI__SHARED const peri__model_row *peri__model(peri_model model) {
    static const peri__model_row table[3] = {
        {"projective", PERI__PROJECTIVE_STRIDE, peri__projective_local, peri__projective_pull, peri__projective_force,
         peri__projective_lanes_local, peri__projective_lanes_force},
        {"stretch", 2, peri__stretch_local, peri__stretch_pull, peri__stretch_force, peri__stretch_lanes_local,
         peri__stretch_lanes_force},
        {"correspondence", PERI__CORRESPONDENCE_STRIDE, peri__correspondence_local, peri__correspondence_pull,
         peri__correspondence_force, peri__correspondence_lanes_local, peri__correspondence_lanes_force}};
    return &table[(int)model];
}

/* k sum omega |y - Fhat xi|^2 / r^2 with Fhat fixed during the step (PP, SH (24), in energy form). */
static void peri__restored_pull(const peri__matter *m, const peri_real *fhat, peri_real c, const peri__bond *o,
                                peri_real t[3]) {
    peri_real scale = 2 * m->restore * c * o->weight * o->inv_r2;
    int a;
    for (a = 0; a < 3; a++)
        t[a] = scale * (o->y[a] - fhat[3 * a] * o->xi[0] - fhat[3 * a + 1] * o->xi[1] - fhat[3 * a + 2] * o->xi[2]);
}

/* The pull of a particle of whatever mode. */
static void peri__special_pull(const peri__bonds *b, const peri__matter *m, int i, const peri__bond *o,
                               peri_real t[3]) {
    const peri_real *special = b->special + 9 * (size_t)i;
    m = peri__matter_of(b, m, i);
    if (b->mode[i] == PERI__RESTORED)
        peri__restored_pull(m, special, (peri_real)b->unit * b->share[i] * peri__firmness(b, i), o, t);
    else peri__stretch_pull(m, special, o, t);
}

/* Coefficients and energy of the particles whose mode is not PERI__MAIN. */
PERI__SHARED double peri__special_local(const peri__bonds *b, const peri__matter *m, const double *x, int begin,
                                        int end, int energy) {
    double sum = 0;
    int i, k;
    for (i = begin; i < end; i++) {
        if (b->mode[i] == PERI__FALLBACK) sum += peri__stretch_one(b, m, x, i, b->special + 9 * (size_t)i, energy);
        if (b->mode[i] != PERI__RESTORED || !energy) continue;
        for (k = b->row[i]; k < b->row[i + 1]; k++) {
            peri__bond o;
            peri_real t[3];
            peri__bond_load(b, i, k, x, &o);
            peri__special_pull(b, m, i, &o, t);
            if (!(o.weight > 0)) continue;
            /* |t|^2 / (4 k c s / r^2) is this bond's energy */
            sum += (double)(t[0] * t[0] + t[1] * t[1] + t[2] * t[2]) /
                   (4 * (double)(peri__matter_of(b, m, i)->restore * peri__firmness(b, i)) * b->unit *
                    (double)(b->share[i] * o.weight * o.inv_r2));
        }
    }
    return sum;
}

/* Adds their forces on particles begin .. end - 1, at both ends of their bonds. */
PERI__SHARED void peri__special_force(const peri__bonds *b, const peri__matter *m, const double *x, int begin, int end,
                                peri_real *f) {
    int i, k, c;
    for (i = begin; i < end; i++) {
        for (k = b->row[i]; k < b->row[i + 1]; k++) {
            int j = b->col[k];
            peri__bond o;
            peri_real t[3];
            if (b->mode[i] == PERI__MAIN && b->mode[j] == PERI__MAIN) continue;
            peri__bond_load(b, i, k, x, &o);
            if (b->mode[i] != PERI__MAIN) {
                peri__special_pull(b, m, i, &o, t);
                for (c = 0; c < 3; c++) f[3 * (size_t)i + (size_t)c] += t[c];
            }
            if (b->mode[j] != PERI__MAIN) {
                peri__special_pull(b, m, j, &o, t);
                for (c = 0; c < 3; c++) f[3 * (size_t)i + (size_t)c] += t[c];
            }
        }
    }
}

/* Constants for one layer of points in plane stress. There bonds average over a circle, <n n n n> = (dd + dd + dd)/8
   in place of the sphere's 15: ms = 4 mu, ls = 2 (lambda' - mu), lambda' = 2 lambda mu/(lambda + 2 mu); the projective
   model has E = 2 (a + b/2)/3 and Poisson's ratio 1/3. Its term in a would resist bending by the spacing, not by the
   thickness (measured: a sheet 18 times too stiff): in a sheet all its stiffness is b's, unless the paper's own bending
   is asked for (sheet 2: peri_body_def.bending is 0). */
static void peri__matter_flatten(peri__matter *matter, int sheet) {
    peri_material *m = &matter->m;
    double g2 = peri__basis_second(&matter->g) / 2, h2 = peri__basis_second(&matter->h) / 2;    /* 1 for the presets */
    double mu = (double)m->ms * h2 / 7.5, lambda = (double)m->ls * g2 / 4.5 + mu, plane;
    if (!(lambda > -0.66 * mu)) lambda = -0.66 * mu;
    plane = 2 * lambda * mu / (lambda + 2 * mu);
    m->ms = (peri_real)((double)m->ms * 4 / 7.5);
    if (g2 > 0) m->ls = (peri_real)(2 * (plane - mu) / g2);
    mu = m->model == PERI_MODEL_PROJECTIVE ? (double)(m->a + m->b / 2) / 8 : mu;
    m->b = sheet == 2 ? m->b / 2 : m->a + m->b / 2;
    m->a = sheet == 2 ? m->a / 2 : 0;
    if (m->model == PERI_MODEL_PROJECTIVE) {
        plane = mu;
    } else if (m->model == PERI_MODEL_CORRESPONDENCE) {
        mu = (double)m->mu;
        plane = 2 * (double)m->lambda * mu / ((double)m->lambda + 2 * mu);
    }
    matter->plane_mu = mu;
    matter->plane_lambda = plane;
}

/* Fills everything that the loops need of a material. */
static void peri__matter_make(const peri_material *source, int sheet, peri__matter *m) {
    double shear = (sheet ? 4 : 7.5) * (double)source->mu, bulk, g2, h2;
    memset(m, 0, sizeof *m);
    m->m = *source;
    peri__basis_compile(&source->g, &m->g);
    peri__basis_compile(&source->h, &m->h);
    if (sheet) peri__matter_flatten(m, sheet);
    source = &m->m;
    /* in a plane s 4 mu: of Timoshenko's beam 4 and 8 across, nu 0: 0.99 0.99; nu 0.3: 1.07 1.02; s 1: 1.18 1.06 */
    m->stabiliser = (peri_real)(shear * (double)source->stabiliser);
    g2 = peri__basis_second(&m->g);
    h2 = peri__basis_second(&m->h);
    bulk = (double)source->ls * g2;
    m->stiffness_g = bulk > 0 ? bulk : 0;
    m->stiffness_h = (double)source->ms * h2;
    if (source->model == PERI_MODEL_PROJECTIVE) {
        shear = (double)source->a + (double)source->b / 2;
        m->stiffness_g = 0;
        m->stiffness_h = 2 * (double)source->a + (double)source->b;
    } else if (source->model == PERI_MODEL_STRETCH) {
        shear = (double)source->ms;
    } else {
        m->stiffness_h = 2 * shear * ((double)source->stabiliser > 1 ? (double)source->stabiliser : 1);
    }
    m->restore = (peri_real)(shear * (double)source->restore);
    if (source->model == PERI_MODEL_CORRESPONDENCE && (double)source->stabiliser > 0) {
        m->brace_shape = (peri_real)(3 * 2.25 / (double)source->stabiliser);
        bulk = (double)source->lambda / (double)source->mu;
        m->brace_volume = bulk > 0 ? (peri_real)(0.3 * 2.25 * bulk / (double)source->stabiliser) : 0;
    }
}

/* Completes the gradient of a plane's map by what becomes of the plane's normal: the normal of the image, `stretch`
   long. Where the image is a line or a point, any direction across it. */
static void peri__gradient_complete(const peri_real *normal, double stretch, double f[9]) {
    double n[3], t[6], a[6], image[3], length, along;
    int c, d, least = 0;
    for (c = 0; c < 3; c++) n[c] = (double)normal[c];
    peri__plate_tangents(n, t);
    for (c = 0; c < 3; c++)
        for (d = 0; d < 2; d++)
            a[3 * d + c] = f[3 * c] * t[3 * d] + f[3 * c + 1] * t[3 * d + 1] + f[3 * c + 2] * t[3 * d + 2];
    peri__cross(a, a + 3, image);
    length = image[0] * image[0] + image[1] * image[1] + image[2] * image[2];
    if (!(length > 1e-24)) {
        double aa = a[0] * a[0] + a[1] * a[1] + a[2] * a[2], bb = a[3] * a[3] + a[4] * a[4] + a[5] * a[5];
        const double *line = aa > bb ? a : a + 3;
        along = aa > bb ? aa : bb;
        for (c = 1; c < 3; c++)
            if (fabs(line[c]) < fabs(line[least])) least = c;
        for (c = 0; c < 3; c++) image[c] = (c == least) - (along > 1e-24 ? line[least] * line[c] / along : 0);
        length = image[0] * image[0] + image[1] * image[1] + image[2] * image[2];
    }
    length = stretch / sqrt(length);
    for (c = 0; c < 3; c++)
        for (d = 0; d < 3; d++) f[3 * c + d] += length * image[c] * n[d];
}

/* The shape to restore: singular values made positive and clamped to [0.5, 1.5]. */
static void peri__shape_wanted(const double u[9], const double sigma[3], const double v[9], peri_real *fhat) {
    double t[9];
    int i, j, k;
    for (k = 0; k < 3; k++) {
        double s = fabs(sigma[k]) < 0.5 ? 0.5 : fabs(sigma[k]) > 1.5 ? 1.5 : fabs(sigma[k]);
        for (i = 0; i < 3; i++) t[3 * i + k] = u[3 * i + k] * s;
    }
    for (i = 0; i < 3; i++)
        for (j = 0; j < 3; j++)
            fhat[3 * i + j] =
                (peri_real)(t[3 * i] * v[3 * j] + t[3 * i + 1] * v[3 * j + 1] + t[3 * i + 2] * v[3 * j + 2]);
}

/* Is a particle out of shape? f: its Fbar; h: its C - 1, or NULL. Then fhat (9) is the shape to restore: singular
   values of Fbar made positive (the smallest one flips) and clamped to [0.5, 1.5]. */
PERI__SHARED int peri__unhealthy(const peri__matter *m, const double f[9], const double *h, peri_real *fhat) {
    double low = (double)m->m.healthy_min, high = (double)m->m.healthy_max, c[6], u[9], sigma[3], v[9], t[9], away = 0;
    int i, j, k, bad;
    if (!(m->restore > 0)) return 0;
    for (i = 0, k = 0; i < 3; i++)
        for (j = i; j < 3; j++, k++) {
            c[k] = f[i] * f[j] + f[3 + i] * f[3 + j] + f[6 + i] * f[6 + j] - (i == j);
            away += (i == j ? 1 : 2) * c[k] * c[k];
        }
    if (h)
        for (k = 0; k < 6; k++) away += (k < 3 ? 1 : 2) * h[k] * h[k];
    /* |C - 1| below 1/2: every eigenvalue of C lies in [1/2, 3/2], only the sign of det Fbar is open */
    if (away < 0.25 && peri_det3(f) > 0 && low < 0.7 && high > 1.23) return 0;
    peri_svd3(f, u, sigma, v);
    bad = sigma[2] < low || sigma[0] > high;
    if (h && !bad) {
        for (k = 0; k < 6; k++) c[k] = h[k] + (k < 3);
        peri_eigen3(c, t, v);
        bad = t[0] < (low > 0 ? low * low : 0) || t[2] > high * high;
        if (bad) peri_svd3(f, u, sigma, v);
    }
    if (bad) peri__shape_wanted(u, sigma, v, fhat);
    return bad;
}

#define PERI__BRACE_MOST 64

/* The stabiliser is a spring in squares of stretches: where bonds are short it yields to neighbours that move against
   each other, and pressure drives just that, so that pressed matter would buckle between its bonds. So pressed
   particles have it B times as stiff for the step, with S = tr C^-1 - (tr C)/2 - 3/2 above 0 and D = det C below 1
       B = 3/4 + 3 S^2 + 0.3 lambda/mu (1 - D)^2/D tr^2 C^-1,   at least 1, at most 64
   at a stabiliser of 2.25 (t B is what counts). The energy of every wave on an affinely pressed lattice of 26
   neighbours is positive from a fifth of this on (one, two, three axes pressed to 0.4, nu 0 to 0.45; 122 neighbours
   need less); the rest is for one-sided families and for what a single step adds: with less, a beam that hangs by its
   clamp still folds there. C is that of Fbar, which sees through what has buckled already; B stays for a step, as its
   derivative would press on matter that is merely bent. share: of what B is above 1. f: Fbar. */
PERI__INLINE void peri__brace(const peri__matter *m, int n, peri__row *f, peri_real share, peri_real *brace) {
    int l;
    PERI__EACH_OF(l, n) {
        const peri_real a = f[0][l], d = f[1][l], e = f[2][l], g = f[3][l], i = f[4][l], j = f[5][l];
        const peri_real o = f[6][l], p = f[7][l], q = f[8][l];
        const peri_real k0 = i * q - j * p, k1 = j * o - g * q, k2 = g * p - i * o, k3 = e * p - d * q;
        const peri_real k4 = a * q - e * o, k5 = d * o - a * p, k6 = d * j - e * i, k7 = e * g - a * j;
        const peri_real k8 = a * i - d * g, det = a * k0 + d * k1 + e * k2, square = det * det;
        const peri_real volume = square > PERI__R(PERI__DET_MIN) ? square : PERI__R(PERI__DET_MIN);
        const peri_real t = (k0 * k0 + k1 * k1 + k2 * k2 + k3 * k3 + k4 * k4 + k5 * k5 + k6 * k6 + k7 * k7 + k8 * k8) /
                            volume;
        const peri_real c = a * a + d * d + e * e + g * g + i * i + j * j + o * o + p * p + q * q;
        const peri_real above = t - c / 2 - PERI__R(1.5), shape = above > 0 ? above : 0;
        const peri_real lost = volume < 1 ? 1 - volume : 0;
        const peri_real b = (PERI__R(0.25) + shape * shape) * m->brace_shape +
                            m->brace_volume * lost * lost / volume * t * t;
        brace[l] = 1 + share * (!(b > 1) ? 0 : b < PERI__BRACE_MOST ? b - 1 : PERI__BRACE_MOST - 1);
    }
}

/* |C - 1|^2 of a block's particles as peri__unhealthy sums it, huge where det Fbar is not positive: below 1/4 a
   particle is in shape, and nobody need look closer. strain: the correspondence model's C - 1 counts too. share, brace:
   as of peri__brace; brace may be NULL. */
PERI__SHARED void peri__lanes_away(const peri__bonds *b, const peri__lanes *t, const peri__matter *m, int block,
                                   int strain, peri_real *away, peri_real share, peri_real *brace) {
    peri__row f[9], h[6];
    int l, c;
    peri__lanes_fit(b, t, block, f, strain ? h : NULL);
    if (brace) peri__brace(m, PERI__LANES, f, share, brace);
    PERI__EACH(l) {
        const peri_real a = f[0][l], d = f[1][l], e = f[2][l], g = f[3][l], i = f[4][l], j = f[5][l];
        const peri_real o = f[6][l], p = f[7][l], q = f[8][l], det = a * (i * q - j * p) + d * (j * o - g * q) +
                                                                     e * (g * p - i * o);
        const peri_real c0 = a * a + g * g + o * o - 1, c1 = d * d + i * i + p * p - 1, c2 = e * e + j * j + q * q - 1;
        const peri_real c3 = d * e + i * j + p * q, c4 = a * e + g * j + o * q, c5 = a * d + g * i + o * p;
        away[l] = c0 * c0 + c1 * c1 + c2 * c2 + 2 * (c3 * c3 + c4 * c4 + c5 * c5) + (det > 0 ? 0 : PERI__R(1e9));
    }
    for (c = 0; c < 6 && strain; c++) {
        const peri_real twice = c < 3 ? 1 : 2;
        PERI__EACH(l) away[l] += twice * h[c][l] * h[c][l];
    }
}

/* The same for a sheet, whose metric h alone can be out of shape: folds and mirror images are none. normal: of the
   plane of its bonds at rest; f is completed by it. */
PERI__SHARED int peri__unhealthy_sheet(const peri__matter *m, const double f[9], const double h[6],
                                       const peri_real *normal, peri_real *fhat) {
    double low = (double)m->m.healthy_min, high = (double)m->m.healthy_max, c[6], value[3], away = 0;
    double whole[9], u[9], sigma[3], v[9];
    int k;
    if (!(m->restore > 0)) return 0;
    for (k = 0; k < 6; k++) {
        c[k] = h[k] + (k < 3);
        away += (k < 3 ? 1 : 2) * h[k] * h[k];
    }
    if (away < 0.25 && low < 0.7 && high > 1.23) return 0;
    peri_eigen3(c, value, v);       /* along the normal it is 1 */
    if (value[0] >= (low > 0 ? low * low : 0) && value[2] <= high * high) return 0;
    memcpy(whole, f, sizeof whole);
    peri__gradient_complete(normal, 1, whole);
    peri_svd3(whole, u, sigma, v);
    peri__shape_wanted(u, sigma, v, fhat);
    return 1;
}

/* ---- implementation 11: plates -----------------------------------------------------------------------------------
   Bending of one layer of points. From its bonds alone a particle knows how the surface through it is curved:
   y = G p + K q is fitted by least squares (weights omega/r^4) over its tangent plane, p = (xi0, xi1),
   q = (xi0^2/2, xi1^2/2, xi0 xi1/sqrt 2), so that K = (K00, K11, sqrt 2 K01), a vector each, is linear in y and exact
   for every quadratic map, whatever the family. A plate has
       Psi = t^2/24 (2 mu K:K + lambda' tr^2 K) = D/(2t) ((1 - nu) K:K + nu tr^2 K),   D = E t^3/(12 (1 - nu^2)),
   lambda' = 2 lambda mu/(lambda + 2 mu): a positive form, whose root is folded into the fit with the volume:
       E_i = 1/2 sum_a |K_a|^2,   K_a = sum_j L_aj y_ij,   three numbers L_aj a bond.
   At an edge bonds are one-sided and cannot tell some curvatures from a slope: the energy is least over those, which is
   the edge's own condition, that no moment acts across it. Where the sheet is curved at rest, K_a = s_a N, it is
   1/2 sum_a |K_a - s_a n|^2 with n the present unit normal, along t_0 x t_1, and t_a = sum_j T_aj y_ij the tangents G
   of the same fit (two numbers more a bond). Forces are exact, and have no torque, as E_i is the same in every frame.
   Ours; no paper has it. (Measured against it: beta sum omega |z|^2/r^4 + gamma |sum omega z/r^2|^2, z = y - G xi,
   calibrated per particle, is 20 to 27 % soft on scattered points, 14 % at horizon 2.5, and costs 4 times as much.) */

#define PERI__PLATE_STRIDE 15   /* dE_i/dK_a (9), curved: dE_i/dt_a (6) */
#define PERI__PLATE_REST 9      /* s_a (3), t_a at rest (6) */
#define PERI__PLATE_SEEN 0.01   /* of a curvature's square: what the bonds feel of it (1/16 to 1/8 within a sheet) */

/* Unit normal n along c = t_0 x t_1, phi = |n|/|c|, and slope = 2 dphi/d|c|^2, continued below |c| = 1/5: n then
   fades. */
static void peri__plate_normal(const double *t, double c[3], double n[3], double *phi, double *slope) {
    const double least = 0.04;
    double q, x;
    int k;
    peri__cross(t, t + 3, c);
    q = c[0] * c[0] + c[1] * c[1] + c[2] * c[2];
    if (q > least) {
        *phi = 1 / sqrt(q);
        *slope = -*phi / q;
    } else {
        x = q / least - 1;
        *phi = (1 + x * (-0.5 + x * 0.375)) / sqrt(least);
        *slope = 2 * (-0.5 + x * 0.75) / (least * sqrt(least));
    }
    for (k = 0; k < 3; k++) n[k] = *phi * c[k];
}

/* Coefficients of a particle that is curved at rest; k: its K_a and t_a less those at rest, in; out their pulls. */
static double peri__plate_curved(const peri_real *rest, const peri_real *k, peri_real *out) {
    double t0[6], t[6], c[3], n0[3], n[3], pull[3] = {0, 0, 0}, g[3], turn[6], phi, slope, energy = 0, along = 0;
    int a, d;
    for (a = 0; a < 6; a++) {
        t0[a] = (double)rest[3 + a];
        t[a] = t0[a] + (double)k[9 + a];
    }
    peri__plate_normal(t0, c, n0, &phi, &slope);
    peri__plate_normal(t, c, n, &phi, &slope);
    for (a = 0; a < 3; a++)
        for (d = 0; d < 3; d++) {
            double s = (double)rest[a], m = (double)k[3 * a + d] + s * (n0[d] - n[d]);
            energy += m * m / 2;
            pull[d] -= s * m;       /* dE/dn */
            out[3 * a + d] = (peri_real)m;
        }
    for (d = 0; d < 3; d++) along += pull[d] * c[d];
    for (d = 0; d < 3; d++) g[d] = phi * pull[d] + slope * along * c[d];    /* dE/dc */
    peri__cross(t + 3, g, turn);
    peri__cross(g, t, turn + 3);
    for (a = 0; a < 6; a++) out[9 + a] = (peri_real)turn[a];
    return energy;
}

/* Coefficients of particles begin .. end - 1 into coef, and their bending energy, J. */
PERI__SHARED double peri__plate_local(const peri__bonds *b, const double *x, int begin, int end, peri_real *coef) {
    int i, k, c, a, rows = b->plate_rows;
    double sum = 0;
    for (i = begin; i < end; i++) {
        const double *xi = x + 3 * (size_t)i;
        peri_real all[PERI__PLATE_STRIDE], *out = coef + PERI__PLATE_STRIDE * (size_t)i;
        for (a = 0; a < 3 * rows; a++) all[a] = 0;
        for (k = b->row[i]; k < b->row[i + 1]; k++) {
            const double *xj = x + 3 * (size_t)b->col[k];
            const peri_real *l = b->plate + 2 * (size_t)rows * (size_t)k;
            peri_real u[3];
            for (c = 0; c < 3; c++) u[c] = (peri_real)(xj[c] - xi[c] - (double)b->xi[c][k]);
            for (a = 0; a < rows; a++)
                for (c = 0; c < 3; c++) all[3 * a + c] += l[a] * u[c];
        }
        if (rows == 5) {
            sum += peri__plate_curved(b->plate_rest + PERI__PLATE_REST * (size_t)i, all, out);
            continue;
        }
        for (a = 0; a < 9; a++) {
            sum += (double)all[a] * (double)all[a] / 2;
            out[a] = all[a];
        }
    }
    return sum;
}

/* Adds the bending forces on particles begin .. end - 1 to f. */
PERI__SHARED void peri__plate_force(const peri__bonds *b, int begin, int end, const peri_real *coef, peri_real *f) {
    int i, k, c, a, rows = b->plate_rows;
    for (i = begin; i < end; i++) {
        const peri_real *own = coef + PERI__PLATE_STRIDE * (size_t)i;
        peri_real sum[3] = {0, 0, 0};
        for (k = b->row[i]; k < b->row[i + 1]; k++) {
            const peri_real *l = b->plate + 2 * (size_t)rows * (size_t)k;
            const peri_real *far = coef + PERI__PLATE_STRIDE * (size_t)b->col[k];
            for (a = 0; a < rows; a++)
                for (c = 0; c < 3; c++) sum[c] += l[a] * own[3 * a + c] - l[rows + a] * far[3 * a + c];
        }
        for (c = 0; c < 3; c++) f[3 * (size_t)i + (size_t)c] += sum[c];
    }
}

/* The fit of one particle. Lengths are in spacings. */
typedef struct peri__plate_fit {
    double t[9];        /* tangents, normal */
    double slope[4];    /* (sum W p p)^-1 */
    double carry[6];    /* what a slope takes of q: q - carry p is left */
    double curve[9];    /* K = curve sum W (q - carry p) y */
    double root[9];     /* of the plate's form, times curve */
} peri__plate_fit;

/* p, and q - carry p, of bond k; height over the tangent plane. Returns W. */
static double peri__plate_bond(const peri__bonds *b, int i, int k, double d, const peri__plate_fit *fit, double p[2],
                               double q[3], double *height) {
    double xi[3], r2 = d * d * (double)b->inv_r2[k];
    int c;
    for (c = 0; c < 3; c++) xi[c] = (double)b->xi[c][k] / d;
    p[0] = fit->t[0] * xi[0] + fit->t[1] * xi[1] + fit->t[2] * xi[2];
    p[1] = fit->t[3] * xi[0] + fit->t[4] * xi[1] + fit->t[5] * xi[2];
    *height = fit->t[6] * xi[0] + fit->t[7] * xi[1] + fit->t[8] * xi[2];
    q[0] = p[0] * p[0] / 2;
    q[1] = p[1] * p[1] / 2;
    q[2] = p[0] * p[1] * sqrt(0.5);
    for (c = 0; c < 3; c++) q[c] -= fit->carry[c] * p[0] + fit->carry[3 + c] * p[1];
    return (double)(b->weight[k] * b->share[i] / b->volume[i]) * r2 * r2;
}

/* Pseudo-inverse of a symmetric 2x2 (00, 01, 10, 11). */
static void peri__invert2(const double a[4], double out[4]) {
    double trace = a[0] + a[3], det = a[0] * a[3] - a[1] * a[2];
    int k;
    for (k = 0; k < 4; k++) out[k] = trace > 0 ? a[k] / (trace * trace) : 0;      /* all bonds along one line */
    if (!(det > 1e-3 * trace * trace)) return;
    out[0] = a[3] / det;
    out[1] = out[2] = -a[1] / det;
    out[3] = a[0] / det;
}

/* curve and root from Q = sum W q~ q~ (Voigt): curvatures that the bonds do not feel are left to take what value costs
   least. Form: 2 mu 1 + lambda t t^T with t = (1, 1, 0). */
static void peri__plate_root(const double q[6], double mu, double lambda, peri__plate_fit *fit) {
    double value[3], v[9], form[9], root[9];
    int a, c, m;
    peri_eigen3(q, value, v);
    for (a = 0; a < 3; a++)
        for (c = 0; c < 3; c++)
            form[3 * a + c] = (a == c) * 2 * mu + lambda * (v[a] + v[3 + a]) * (v[c] + v[3 + c]);
    for (m = 0; m < 3; m++) {
        if (value[m] > PERI__PLATE_SEEN) continue;
        for (a = 0; a < 3; a++)
            for (c = 0; c < 3; c++)
                if (a != m && c != m) form[3 * a + c] -= form[3 * a + m] * form[3 * m + c] / form[4 * m];
        for (a = 0; a < 3; a++) form[3 * a + m] = form[3 * m + a] = 0;
    }
    memset(root, 0, sizeof root);
    for (m = 0; m < 3; m++) {       /* Cholesky; pivots of curvatures that are not felt are 0 */
        if (!(form[4 * m] > 0)) continue;
        for (a = m; a < 3; a++) root[3 * a + m] = form[3 * a + m] / sqrt(form[4 * m]);
        for (a = m + 1; a < 3; a++)
            for (c = m + 1; c < 3; c++) form[3 * a + c] -= root[3 * a + m] * root[3 * c + m];
    }
    memset(fit->curve, 0, sizeof fit->curve);
    memset(fit->root, 0, sizeof fit->root);
    for (m = 0; m < 3; m++)
        for (a = 0; a < 9 && value[m] > PERI__PLATE_SEEN; a++) {
            fit->curve[a] += v[a / 3 * 3 + m] * v[a % 3 * 3 + m] / value[m];
            fit->root[a] += root[3 * m + a / 3] * v[a % 3 * 3 + m] / value[m];
        }
}

/* Fits over the plane of fit->t. tilt: slopes of the rest shape over that plane. */
static void peri__plate_over(const peri__bonds *b, int i, double d, double mu, double lambda, peri__plate_fit *fit,
                             double tilt[2]) {
    double pp[4] = {0, 0, 0, 0}, pq[6] = {0, 0, 0, 0, 0, 0}, qq[6] = {0, 0, 0, 0, 0, 0}, ph[2] = {0, 0};
    double qh[3] = {0, 0, 0}, p[2], q[3], height, w;
    static const int row[6] = {0, 1, 2, 1, 0, 0}, col[6] = {0, 1, 2, 2, 2, 1};
    int k, c, a;
    memset(fit->carry, 0, sizeof fit->carry);
    for (k = b->row[i]; k < b->row[i + 1]; k++) {
        w = peri__plate_bond(b, i, k, d, fit, p, q, &height);
        for (c = 0; c < 4; c++) pp[c] += w * p[c / 2] * p[c % 2];
        for (c = 0; c < 6; c++) pq[c] += w * p[c / 3] * q[c % 3];
        for (c = 0; c < 2; c++) ph[c] += w * p[c] * height;
    }
    peri__invert2(pp, fit->slope);
    for (c = 0; c < 6; c++)
        fit->carry[c] = fit->slope[c / 3 * 2] * pq[c % 3] + fit->slope[c / 3 * 2 + 1] * pq[3 + c % 3];
    for (k = b->row[i]; k < b->row[i + 1]; k++) {
        w = peri__plate_bond(b, i, k, d, fit, p, q, &height);
        for (c = 0; c < 6; c++) qq[c] += w * q[row[c]] * q[col[c]];
        for (c = 0; c < 3; c++) qh[c] += w * q[c] * height;
    }
    peri__plate_root(qq, mu, lambda, fit);
    for (a = 0; a < 2; a++) {
        tilt[a] = fit->slope[2 * a] * ph[0] + fit->slope[2 * a + 1] * ph[1];
        for (c = 0; c < 9; c++) tilt[a] -= fit->carry[3 * a + c / 3] * fit->curve[c] * qh[c % 3];
    }
}

/* The fit of particle i; a curved sheet's plane is turned until the surface has no slope over it. */
static void peri__plate_find(const peri__bonds *b, int i, double d, double mu, double lambda, peri__plate_fit *fit) {
    double tilt[2], length;
    int c, turns;
    for (c = 0; c < 3; c++) fit->t[6 + c] = (double)b->normal[3 * (size_t)i + (size_t)c];
    for (turns = 0; turns < 20; turns++) {
        peri__plate_tangents(fit->t + 6, fit->t);
        peri__plate_over(b, i, d, mu, lambda, fit, tilt);
        if (b->plate_rows == 3 || tilt[0] * tilt[0] + tilt[1] * tilt[1] < 1e-24) return;
        for (c = 0; c < 3; c++) fit->t[6 + c] -= tilt[0] * fit->t[c] + tilt[1] * fit->t[3 + c];
        length = sqrt(fit->t[6] * fit->t[6] + fit->t[7] * fit->t[7] + fit->t[8] * fit->t[8]);
        for (c = 0; c < 3; c++) fit->t[6 + c] /= length;
    }
}

/* L, T of particle i's bonds into plate, its shape at rest into rest (NULL: flat). d: spacing, m; mu, lambda: Lame's
   constants in plane stress times volume and t^2/12, J m^2. Returns the sum of L^2 over the bonds, N/m. */
PERI__SHARED double peri__plate_make(const peri__bonds *b, int i, double d, double mu, double lambda, peri_real *plate,
                                     peri_real *rest) {
    peri__plate_fit fit;
    double sum = 0, p[2], q[3], height, curve[3] = {0, 0, 0}, t[6] = {0, 0, 0, 0, 0, 0}, l;
    int k, c, a, rows = b->plate_rows;
    peri__plate_find(b, i, d, mu, lambda, &fit);
    for (k = b->row[i]; k < b->row[i + 1]; k++) {
        double w = peri__plate_bond(b, i, k, d, &fit, p, q, &height);
        peri_real *out = plate + 2 * (size_t)rows * (size_t)k;
        for (a = 0; a < 3; a++) {
            l = w * (fit.root[3 * a] * q[0] + fit.root[3 * a + 1] * q[1] + fit.root[3 * a + 2] * q[2]) / (d * d);
            out[a] = (peri_real)l;
            sum += l * l;
            curve[a] += l * height * d;
        }
        for (a = 0; a < 2 && rows == 5; a++) {
            l = fit.slope[2 * a] * p[0] + fit.slope[2 * a + 1] * p[1];
            for (c = 0; c < 9; c++) l -= fit.carry[3 * a + c / 3] * fit.curve[c] * q[c % 3];
            l *= w / d;
            out[3 + a] = (peri_real)l;
            for (c = 0; c < 3; c++) t[3 * a + c] += l * (double)b->xi[c][k];
        }
    }
    for (a = 0; a < 3 && rest; a++) rest[a] = (peri_real)curve[a];
    for (a = 0; a < 6 && rest; a++) rest[3 + a] = (peri_real)t[a];
    return sum;
}

/* ---- implementation 12: a material point ------------------------------------------------------------------------- */

/* Adds what one direction n, of weight w, gives to theta, or to the energy and stress once theta is known. */
static double peri__point_direction(const peri__matter *m, const double f[9], const double n[3], double w, double slope,
                                    double *theta, double *p) {
    double y[3], tau, first, value, gain = 1, pull;
    int i, j;
    for (i = 0; i < 3; i++) y[i] = f[3 * i] * n[0] + f[3 * i + 1] * n[1] + f[3 * i + 2] * n[2];
    tau = sqrt(y[0] * y[0] + y[1] * y[1] + y[2] * y[2]);
    if (theta) {
        *theta += w * tau;
        return 0;
    }
    if (m->m.model == PERI_MODEL_PROJECTIVE) {
        double k = (double)m->m.a + (double)m->m.b / 2;
        value = k * (tau - 1) * (tau - 1);
        pull = 2 * k * (tau - 1);
    } else {
        if (m->m.anisotropic) {
            gain = 0;
            for (j = 0; j < 3; j++) {
                double d = 0;
                for (i = 0; i < 3; i++) d += (double)m->m.direction[3 * i + j] * n[i];
                gain += d * d * (double)m->m.strength[j] * (double)m->m.strength[j];
            }
            gain = sqrt(gain);
        }
        value = (double)m->m.ms * gain * peri__basis_value(&m->h, tau, &first);
        pull = (double)m->m.ms * gain * first + slope;
    }
    for (i = 0; i < 3 && p && tau > 0; i++)
        for (j = 0; j < 3; j++) p[3 * i + j] += w * pull / tau * y[i] * n[j];
    return w * value;
}

/* Sum over the sphere: Gauss-Legendre in the height, equal angles around. */
static double peri__point_sphere(const peri__matter *m, const double f[9], double slope, double *theta, double *p) {
    const int heights = 16, angles = 32;
    const double pi = 3.14159265358979323846;
    double sum = 0, n[3];
    int i, k, it;
    for (i = 0; i < heights; i++) {
        double z = cos(pi * (i + 0.75) / (heights + 0.5)), p0 = 1, p1 = z, dp = 1, radius;
        for (it = 0; it < 6; it++) {
            for (p0 = 1, p1 = z, k = 2; k <= heights; k++) {
                double p2 = ((2 * k - 1) * z * p1 - (k - 1) * p0) / k;
                p0 = p1;
                p1 = p2;
            }
            dp = heights * (z * p1 - p0) / (z * z - 1);
            z -= p1 / dp;
        }
        radius = sqrt(1 - z * z);
        for (k = 0; k < angles; k++) {
            n[0] = radius * cos(2 * pi * k / angles);
            n[1] = radius * sin(2 * pi * k / angles);
            n[2] = z;
            sum += peri__point_direction(m, f, n, 1 / ((1 - z * z) * dp * dp * angles), slope, theta, p);
        }
    }
    return sum;
}

/* Psi(C) and P = 2 F dPsi/dC. */
static double peri__point_law(const peri_material *m, const double f[9], double *p) {
    static const int place[9] = {0, 5, 4, 5, 1, 3, 4, 3, 2};
    double h[6], dpsi[6], value;
    int i, j, k;
    for (i = 0; i < 3; i++)
        for (j = 0; j < 3; j++)
            h[place[3 * i + j]] = f[i] * f[j] + f[3 + i] * f[3 + j] + f[6 + i] * f[6 + j] - (i == j);
    value = peri_law_value(m, h, dpsi);
    for (i = 0; i < 3 && p; i++)
        for (j = 0; j < 3; j++)
            for (p[3 * i + j] = 0, k = 0; k < 3; k++) p[3 * i + j] += 2 * f[3 * i + k] * dpsi[place[3 * k + j]];
    return value;
}

double peri_material_point(const peri_material *m, const double f[9], double p[9]) {
    peri__matter matter;
    double theta = 0, slope, energy;
    int k;
    if (m->model == PERI_MODEL_CORRESPONDENCE) return peri__point_law(m, f, p);
    peri__matter_make(m, 0, &matter);
    for (k = 0; k < 9 && p; k++) p[k] = 0;
    if (m->model == PERI_MODEL_PROJECTIVE) return peri__point_sphere(&matter, f, 0, NULL, p);
    peri__point_sphere(&matter, f, 0, &theta, NULL);
    energy = (double)m->ls * peri__basis_value(&matter.g, theta, &slope);
    return energy + peri__point_sphere(&matter, f, (double)m->ls * slope, NULL, p);
}

#endif /* PERI_MATERIAL_IMPLEMENTED */
#endif /* PERI_IMPLEMENTATION */

/*
MIT License

Copyright (c) 2026 the peri authors

Permission is hereby granted, free of charge, to any person obtaining a copy of this software and associated
documentation files (the "Software"), to deal in the Software without restriction, including without limitation the
rights to use, copy, modify, merge, publish, distribute, sublicense, and/or sell copies of the Software, and to permit
persons to whom the Software is furnished to do so, subject to the following conditions:

The above copyright notice and this permission notice shall be included in all copies or substantial portions of the
Software.

THE SOFTWARE IS PROVIDED "AS IS", WITHOUT WARRANTY OF ANY KIND, EXPRESS OR IMPLIED, INCLUDING BUT NOT LIMITED TO THE
WARRANTIES OF MERCHANTABILITY, FITNESS FOR A PARTICULAR PURPOSE AND NONINFRINGEMENT. IN NO EVENT SHALL THE AUTHORS OR
COPYRIGHT HOLDERS BE LIABLE FOR ANY CLAIM, DAMAGES OR OTHER LIABILITY, WHETHER IN AN ACTION OF CONTRACT, TORT OR
OTHERWISE, ARISING FROM, OUT OF OR IN CONNECTION WITH THE SOFTWARE OR THE USE OR OTHER DEALINGS IN THE SOFTWARE.
*/
