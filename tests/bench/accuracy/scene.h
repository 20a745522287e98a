/* tests/bench/accuracy/scene.h - the scenes of the benchmark of speed against accuracy, and what it asks of everything
   that can run them: peri in float, peri in double, other methods. Include it in C and in C++.

   A beam is 1 x 0.2 x 0.2 m, from x = 0 to 1, held at x = 0; Poisson's ratio is 1/4 everywhere, the only one that all
   models have.

     swing    E = 1e6 Pa, 1000 kg/m^3, gravity 9.81 m/s^2 downwards (z) from t = 0 on; 0.5 s, half a period.
              Seen: displacement of the end face's centroid, x and z, m.
     stretch  E = 1e5 Pa, 10 kg/m^3, so light that inertia has no part, no gravity; the end at x = 1 is gripped and
              pulled along x to a stretch of 1.5 in 1 s. Seen: nominal stress at that end, Pa.
     twist    the same beam; the gripped end turns about x by 180 degrees in 1 s. Seen: torque, N m.
     fall     a figure 1 m tall, E = 2e5 Pa, 500 kg/m^3, 0.05 m above the ground, comes down at 2 m/s, friction 0.5;
              0.4 s. Seen: by how much the height of the centre of mass, and the rms distance of the matter from it
              along z, have changed, m.
     drop     a cube of 0.2 m, E = 1e5 Pa, 1000 kg/m^3, 0.05 m above the ground, comes down flat at 2 m/s, no
              friction; 7/30 s: it is pressed by a fifth, bounces, and is highest then. Seen: by how much the height of
              the centre of mass, and the mean height of its upper face over its lower one, have changed, m.
     pile     three such cubes, of 0.24, 0.2 and 0.16 m, each 0.02 m above the one below, let go 0.02 m above the
              ground, friction 0.5; 1 s. Seen: by how much the height of the centre of mass of all, and of that of the
              uppermost, has changed, m. */
#ifndef BENCH_ACCURACY_SCENE_H
#define BENCH_ACCURACY_SCENE_H

#ifdef __cplusplus
extern "C" {
#endif

enum { SWING, STRETCH, TWIST, FALL, DROP, PILE, SCENES };
enum { CORRESPONDENCE, LINEAR, PAPERS, PROJECTIVE, MODELS };    /* A1/A1 is the papers' neo-Hookean */
enum { CHOLESKY, TWO_LEVEL, JACOBI, CHEBYSHEV, POSITION, SOLVERS };

#define SEEN 2          /* numbers seen at a moment; those that a scene does not have are 0 */
#define CUBES 3         /* of the pile */
#define MOMENTS 15      /* at most; one every duration / moments seconds */

/* A run to be made. `across`: particles over 0.2 m of a beam, over the metre of the figure, over the side of every
   cube. */
typedef struct setup {
    int scene, model, solver, lbfgs;    /* lbfgs: 1, or 0 for the papers' plain iteration */
    double tolerance, step;             /* in spacings; s, a fraction of the time between moments */
    int across, bdf2;
    int max_iterations;
    double patience;                    /* ms of processor time after which the run is given up */
} setup;

/* What comes of it. Positions are kept for comparisons of runs on the same particles. */
typedef struct course {
    int count;              /* particles */
    double *x, *start;      /* at each moment, and before the first step: 3 count; one malloc, x's */
    double seen[MOMENTS][SEEN];
    double ms;              /* processor time of the steps; the first one's matrices and factors are not counted */
    int steps, iterations, capped;      /* capped: steps that met max_iterations */
    int lost;               /* 1: given up, or a step failed; the rest has no meaning */
} course;

typedef struct mesh {
    const float *vertices;
    const int *triangles;
    int vertex_count, triangle_count;
} mesh;

/* Another method on one of the scenes. It reads of the setup what it knows - tolerance, step, across (its cells over
   the beam's side), patience - and leaves `seen`, ms, steps and iterations; x stays NULL. Returns 0 when lost. */
typedef struct rival {
    const char *name;
    int scene, kind;        /* kind: for run */
    int (*run)(const struct rival *by, const setup *s, course *out);
} rival;

extern const rival bench_baselines[], bench_bullet[];    /* end with a NULL name */

/* Duration in s, and number of moments. */
double scene_duration(int scene);
int scene_moments(int scene);

/* Cubes of drop and pile: how many, the side of each, the height of its lower face at first (m), velocity downwards. */
int scene_cubes(int scene);
double scene_side(int scene, int cube);
double scene_height(int scene, int cube);
double scene_speed(int scene);
double scene_friction(int scene);

/* Runs s; the figure is for `fall` only. Returns 0 when the run was lost. */
int bench_accuracy_float(const setup *s, const mesh *figure, course *out);
int bench_accuracy_double(const setup *s, const mesh *figure, course *out);

#ifdef __cplusplus
}
#endif
#endif
