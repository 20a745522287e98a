/* peri.h - v0.3.0 - meshless peridynamic particles: elastic bodies that stay stable at game time steps - MIT licence

   The third of peri's three floors, and the one that a user includes: a world of bodies made of particles, colliders,
   time stepping, sampling and skinning. It includes peri_material.h and peri_solver.h.

   USE
       #define PERI_IMPLEMENTATION      in ONE translation unit, before the include
       #include "peri.h"

   QUICK START (a rubber cube falls on a floor)
       peri_world_def wd = peri_default_world_def();
       peri_world *world = peri_world_create(&wd, NULL);
       peri_material rubber = peri_material_neo_hookean(1e5f, 0.3f, 1000);
       peri_collider_def floor_def = peri_default_collider_def();        (a plane: z = 0, facing up)
       peri_body_def bd = peri_default_body_def();
       peri_shape cube = peri_shape_box(0.25f, 0.25f, 0.25f);
       peri_real points[3 * 1000];
       int count = 0, frame;
       bd.spacing = 0.05f;
       peri_sample(&cube, bd.spacing, points, 1000, &count, NULL);
       bd.points = points;
       bd.count = count;
       bd.position.z = 1;
       bd.material = peri_material_create(world, &rubber);
       peri_body_create(world, &bd);
       peri_collider_create(world, &floor_def);
       for (frame = 0; frame < 60; frame++) peri_world_step(world, 1.0f / 30);
       peri_world_destroy(world);

   DOES       elastic solids, sheets and rods of any shape: linear, neo-Hookean, St. Venant-Kirchhoff, user's laws,
              a material, stiffness and directions for each particle; recovery from collapse and inversion; contact with
              friction between bodies, of a body with itself and with colliders, which get their impulses back; ropes,
              springs and joints; sleep; backward Euler and BDF2 at any step; fixed and script-driven particles; fine
              meshes moved by coarse particles.
   DOES NOT   (yet) flow, yield and break.

   UNITS AND CONVENTIONS
       SI: m, kg, s, N, Pa, J. Right-handed; z is up in the defaults. Arrays of vectors are x0 y0 z0 x1 y1 z1 ...
       Quaternions are x, y, z, w. d is the spacing of a body's points, the horizon is given in units of d.
       Particles of a body are numbered as they were given, from 0.

   OPTIONS (define before including, the same in every translation unit); see also peri_solver.h
       PERI_NO_SAMPLING    leaves out peri_sample
       PERI_NO_SKINNING    leaves out skins
       PERI_NO_DRAW        leaves out debug drawing

   MEMORY     one hook (peri_allocator), or one buffer of the caller: peri_world_size(&def) bytes, from which all
              is taken. Nothing is allocated in a settled step; peri_stats counts. Pointers to particle arrays hold
              until the next body is created or destroyed. Solids of one material are computed 16 particles at once:
              4 bytes more a bond, and 25 to 60 a particle; where the points stand on a lattice and come in its order,
              as peri_sample makes them, nothing a bond, 45 to 90 a particle, and two to four times faster still.
   THREADS    one thread at a time may use a world; different worlds are independent. A step uses the threads of the
              world's peri_parallel.
   DETERMINISM  the same build, calls and input give the same bits, whatever the number of threads; with
              -ffp-contract=off from every compiler and optimisation level of one architecture (one that multiplies
              and adds at once, as -march=native often is, being another than one that does not).
   ERRORS     functions return peri_result or a null id; peri_last_error(world) has the sentence. Bad input is refused
              before anything changes. A step that fails leaves the world as it was before the step.

   WORKING RANGE (measured by the tests and examples)
       time step      any that is finite; tuned for 1/240 to 1/30 s. Backward Euler loses motion, BDF2 less: of a
                      vibration with 20 steps a period 0.06 and 57 % of the energy are left after three periods.
       stretch        0.3 to 2.5 (healthy_min, healthy_max of the material): beyond, a particle is pulled back to shape.
                      Correspondence holds from 0.35 to 2.4, along two axes too (a cube of 6^3 by its surface), but not
                      at 0.35 along both or at 2.4 with 0.5, where particles pass those limits. St. Venant-Kirchhoff
                      softens when pressed by its own law. Under more load than they can bear the stretch models fold
                      through themselves at a clamp, and such a step takes hundreds of iterations; A1/A1 is lost in
                      some pressed cells from 0.7 down.
       nu             correspondence and stretch: -0.99 to 0.49; projective: 1/4 whatever is asked. Of a gripped bar 4
                      across correspondence is within 10 % to 0.4, 12 % at 0.49, 16 to 31 % too stiff at 0.499, and
                      above 10 % at -0.5; St. Venant-Kirchhoff 13 to 18 % from 0 to 0.45, up to 21 % at 0.499; stretch
                      8 to 12 % from 0 to 0.25, 16 % at 0.4, 33 to 45 % at 0.49 and more; projective 23 % at 0.25, 31 %
                      at 0.4, 50 % at 0 and 0.49.
       accuracy       correspondence: within 5 % of finite elements with 8 particles across, 8 to 9 % with 4
                      (cantilever tip); stretch 11 to 17 % and projective 21 % too stiff with 8 across, by their
                      surfaces (4 across 9 to 16 and 27 to 39 %); projective torsion 36 % too stiff with 8 across.
                      Stress off neo-Hookean at stretches of 0.7, 1.5, 2: 30, 60, 109 % linear, projective; 68 % A1/A1
                      at 2. The outermost gap under a load through a face is 1.5 times too stiff: 5 layers shorten 0.8
                      of the exact value.
       thin solids    one row or layer of 4 is 13 % off across (correspondence, stretch), of 3 10 %: take sheets.
       missing        the answer stays within 10 % while of a lattice's inner particles at most so many are taken out:
                      none with 6 neighbours, 20 % with 18 (horizon 1.45), 60 % with 26, 80 % with 122; St. Venant-
                      Kirchhoff and stretch 20 % with 26.
       solvers        AUTO, Cholesky and two levels: no capped steps for E 1e3 to 1e9 at steps of 1 ms to 10 s.
                      Chebyshev meets the cap for stiff bodies at long steps, Jacobi and position-based averaging from
                      1e6 Pa at 1/30 s on (E h^2 above 1000 at d 25 mm), mostly a few per cent, up to 26 % off there;
                      and where nu is 0.49 or particles are taken out.
       sheets         within 1 % of plate theory with 16 points along (clamped, under its weight; lowest vibrations of a
                      free plate 12 x 12), a pinched tube 3 % with 24 around and 1 % with 48; scattered points 4 %.
                      Where `bending` makes a sheet as rigid as one 6 spacings thick, the default tolerance leaves 2 %
                      of a deflection undone, at 20 spacings 7 %. Folds and mirror images are not out of shape for a
                      sheet.
       recovery       from plane, line, point, mirror image and shuffle; in thin limbs a knot of a few particles can
                      stay. Stretch linear may stay for good in a wrong shape (line, shuffle at 1/30 s, mirror image at
                      0.1 s and 1 ms), A1/A1 and projective 0.1 d off it.
       momentum       kept to rounding by the forces of stretch and correspondence; the projective model's have a torque
                      (0.012 E d^3 at forces of 0.4 E d^2): free bodies are corrected (keep_momentum), held ones not.
       contact        particles sink into what they touch by their weight over the stiffness of their bonds: 0.01 to
                      0.02 spacings at rest, up to 0.25 at a hard landing. Nothing passes a sheet of one layer or a
                      collider at up to 30 contact distances a step (90 m/s at 60 steps a second and 5 cm). Energy
                      does not grow in 999 of 1000 collisions (one gained 2.6 % in float, one 20 % in double under
                      BDF2); 4 meet the cap and are stopped without a bounce. Capped steps may gain up to 1.8 times.
                      Heavy bodies on light sheets take hundreds of iterations: raise max_iterations, or take shorter
                      steps. A particle that goes in and out of repair can keep a heap awake, and so can a surface that
                      leaps where a limb ends (a hundred bodies in a heap do not fall asleep).
       rods           twist linear to 1 % at 180 degrees over 20 spacings, 5 % too soft at 360; up to a spacing thick.
       script         move fixed particles by less than half a spacing a step against their free neighbours.

   CONTENTS
       1  world and step
       2  bodies
       3  colliders
       4  contacts and attachments
       5  shapes and sampling
       6  skins
       7  looking: values, statistics, debug drawing
       implementation: the world's parts, memory, shapes and sampling, creating a world, neighbours, bonds (lattices and
       lanes, too), bodies, colliders, contacts, finding contacts, attachments, forces, health, the constant matrix, the
       solve, islands and sleep, the step, looking, skins

   HISTORY
       0.3.0  two-level solver, AUTO by counted cost; forces of 16 particles at once, lattices with one stencil; pressed
              matter no longer buckles between its bonds; measures tell the pull back to shape apart
       0.2.0  bodies touch each other and themselves; sheets, rods, attachments, materials per particle, sleep
       0.1.0  first version: elastic bodies, colliders, sampling, skins
*/
#ifndef PERI_H
#define PERI_H

#include "peri_material.h"

/* ---- 1  world and step ------------------------------------------------------------------------------------------- */

typedef struct peri_world peri_world;

/* Ids: zero is null; a removed object's id is never valid again. */
typedef struct peri_body_id { uint32_t index1, generation; } peri_body_id;
typedef struct peri_material_id { uint32_t index1, generation; } peri_material_id;
typedef struct peri_collider_id { uint32_t index1, generation; } peri_collider_id;
typedef struct peri_skin_id { uint32_t index1, generation; } peri_skin_id;
typedef struct peri_attachment_id { uint32_t index1, generation; } peri_attachment_id;

typedef struct peri_quat { peri_real x, y, z, w; } peri_quat;

typedef enum peri_integrator {
    PERI_BACKWARD_EULER,    /* the papers': stable, damps motion faster than about 20 steps a period */
    PERI_BDF2               /* second order: damps far less for the same cost; starts with one Euler step */
} peri_integrator;

/* The global step of the solver: how the constant matrix is (approximately) inverted (PP section 4.2). */
typedef enum peri_solver {
    PERI_SOLVER_AUTO,       /* Cholesky or two levels, whichever costs less by counts: see peri_body_solver */
    PERI_SOLVER_CHOLESKY,   /* factorised once per body and step size */
    PERI_SOLVER_TWO_LEVEL,  /* Jacobi + a factor of a coarse grid: a quarter more iterations, far cheaper in solids */
    PERI_SOLVER_JACOBI,     /* one Jacobi sweep */
    PERI_SOLVER_CHEBYSHEV,  /* Jacobi + Chebyshev, `sweeps` sweeps */
    PERI_SOLVER_POSITION    /* position-based averaging: each bond moves both its ends half way */
} peri_solver;

typedef struct peri_world_def {
    uint32_t cookie;            /* set by peri_default_world_def */
    peri_vec3 gravity;          /* m/s^2; (0, 0, -9.81) */
    peri_integrator integrator; /* PERI_BACKWARD_EULER */
    peri_solver solver;         /* PERI_SOLVER_AUTO */
    int sweeps;                 /* of Chebyshev, 2 to 64; 12 */
    int lbfgs; /* steps remembered by L-BFGS over the matrix, 0 to 8; 5. 0: the papers' plain iteration */
    peri_real tolerance;        /* iterations end when no particle is corrected by more, in spacings, or (short steps)
                                   in tenfold of what forces move it in the step; 1e-3. A quarter of that near a
                                   collider. Below 1e-6 a float build stalls */
    int max_iterations;         /* of a step; 200 */
    int cap_is_error;           /* 1: a step that meets max_iterations fails and is undone; 0: it is reported only */
    peri_real matrix_scale;     /* of the elastic part of the matrix, 0.05 to 4; 0.4. Changes speed, not the answer */
    int keep_momentum;          /* 1: bodies that touch nothing keep linear and angular momentum to rounding, where
                                   backward Euler alone damps rotation; 0: the bare integrator */
    peri_real sleep_speed;      /* bodies whose particles all move slower (spacings a second) for sleep_time fall
                                   asleep with all that they touch, and cost nothing until they are touched; 0.05.
                                   0: none sleeps */
    peri_real sleep_time;       /* s, and at least 15 steps; 0.5 */
    int max_particles;          /* limits; growth beyond them is refused. 2^24 */
    int max_bonds;              /* directed, so twice the number of pairs. 2^30 */
    int max_bodies;             /* 65535 */
    int max_materials;          /* 1024 */
    int max_colliders;          /* 1024 */
    int max_skins;              /* 1024 */
    int max_attachments;        /* 65535 */
    int max_contacts;           /* particles that touch at the same time, colliders and bodies together; 2^24 */
    size_t spare_bytes;         /* with a buffer: what is left for factors, skins and bending sheets; 0 */
    peri_allocator memory;      /* resize NULL: realloc and free */
    peri_parallel parallel;     /* run NULL: OpenMP if compiled in; threads 1 */
    double (*clock)(void *user);    /* seconds, for the profile; NULL: the C library's processor time */
    void (*log)(const char *text, void *user);  /* told of every error and notable event; NULL: silent */
    void *user;                 /* for clock and log */
} peri_world_def;

/* Defaults as written above. */
PERI_DEF peri_world_def peri_default_world_def(void);

/* A world, or NULL with the reason in err (may be NULL). */
PERI_DEF peri_world *peri_world_create(const peri_world_def *def, peri_error *err);

/* Bytes that a world with the limits of def takes in a buffer, spare_bytes included; 0 when def is wrong or the
   product is beyond size_t. Set the limits: the defaults ask for a very large world. */
PERI_DEF size_t peri_world_size(const peri_world_def *def);

/* A world inside buffer (aligned as malloc's), which never allocates. Destroying it does not free the buffer. */
PERI_DEF peri_world *peri_world_create_in(const peri_world_def *def, void *buffer, size_t bytes, peri_error *err);

/* Frees all; NULL is fine. */
PERI_DEF void peri_world_destroy(peri_world *world);

/* One step of dt seconds (> 0). On error the world is as before the step. */
PERI_DEF peri_result peri_world_step(peri_world *world, peri_real dt);

/* Gravity, m/s^2. */
PERI_DEF peri_result peri_world_set_gravity(peri_world *world, peri_vec3 gravity);

/* The last error of this world; its text stays until the next error. */
PERI_DEF const peri_error *peri_last_error(const peri_world *world);

/* A hash of the state that the next step starts from (FNV-1a over positions, velocities, history, forces, aims,
   gravity, colliders, contacts, attachments, rest): equal states, equal hashes. */
PERI_DEF uint64_t peri_world_hash(const peri_world *world);

/* ---- 2  bodies --------------------------------------------------------------------------------------------------- */

/* Weight w(r) of a bond of length r, normalised to sum to one over a particle's bonds. delta: horizon. The
   correspondence model has the same moduli with each; the stretch and projective models do not: with 26 neighbours the
   linear and the cubic kernel leave them far from isotropic (measured Poisson's ratio 0.15 and 0.04 for 0.25). */
typedef enum peri_kernel {
    PERI_KERNEL_POWER,      /* (r/d)^-kernel_power: 0.7 with horizon 1.75, 1 with 3.01 are isotropic on a lattice */
    PERI_KERNEL_CONSTANT,   /* 1 */
    PERI_KERNEL_LINEAR,     /* 1 - r/delta (0 at the horizon) */
    PERI_KERNEL_CUBIC,      /* cubic spline of support delta */
    PERI_KERNEL_INVERSE,    /* delta/r (SH) */
    PERI_KERNEL_SHIFTED     /* 1 / (1 + r/delta) (SH figure 9) */
} peri_kernel;

/* What the points of a body are. */
typedef enum peri_form {
    PERI_FORM_SOLID,        /* points fill a volume: spacing^3 each */
    PERI_FORM_SHEET,        /* one layer of points on a surface, flat or curved: a membrane in plane stress, a plate's
                               bending, of the given thickness. spacing^2 thickness each */
    PERI_FORM_ROD           /* points in order along a line: a round rod of the given thickness (its diameter). Ghost
                               particles around the line carry bending and twist; they are in no array of the user's
                               and touch nothing. spacing pi/4 thickness^2 each */
} peri_form;

typedef struct peri_body_def {
    uint32_t cookie;
    const peri_real *points;        /* 3 count: reference positions, m; no two closer than 1e-3 spacing */
    const peri_real *volumes;       /* count, m^3; NULL: spacing^3 each */
    const unsigned char *fixed;     /* count, 1: fixed; NULL: none */
    int count;                      /* >= 1 */
    peri_real spacing;              /* d, m, > 0. Wrong by a factor 2 the families are too small or too large */
    peri_real horizon;              /* in spacings, 1 to 6; 1.75 (26 neighbours on a cubic lattice) */
    peri_kernel kernel;             /* PERI_KERNEL_POWER */
    peri_real kernel_power;         /* -4 to 4; 0.7 */
    int partial_volume;             /* 1: bonds within half a spacing of the horizon count linearly less (1 at
                                       delta - d/2, 1/2 at delta); 0 */
    peri_form form;                 /* PERI_FORM_SOLID */
    peri_real thickness;            /* of a sheet, diameter of a rod, m, > 0; of solids without meaning */
    peri_real bending;              /* sheets and rods: factor on the flexural rigidity, that of the thickness being 1;
                                       0 to 1e6; 1. Sheets: 0 leaves the projective model the bending of its share (PP
                                       figure 5), which goes with the spacing, and the others almost none, but at folds
                                       narrower than the horizon (SH figure 9). Rods: what bears the twist bends as
                                       1.01/(1 + nu) by itself, and less is not possible; above 10 sections shear (1.3
                                       times too soft at 100), and rods nearly as thick as a spacing become too stiff
                                       along themselves */
    int closed;                     /* rods: 1 joins the last point to the first; 0 */
    peri_material_id material;
    const peri_material_id *materials;  /* material_count more materials, of the same model, for material_of */
    int material_count;
    const unsigned char *material_of;   /* count: 0 is `material`, k is materials[k - 1]; NULL: all 0 */
    const peri_real *stiffness;     /* count, 1e-6 to 1e6: factor on each particle's stiffness; NULL: 1 */
    const peri_real *directions;    /* 9 count: material directions of each particle of an anisotropic material, as
                                       peri_material.direction, in the frame of the points; NULL: the material's */
    peri_vec3 position;             /* the points are rotated, then moved by this, m */
    peri_quat rotation;             /* unit within 1e-3; identity */
    peri_vec3 velocity;             /* m/s */
    peri_vec3 spin;                 /* rad/s, about the centre of mass */
    peri_real contact_radius;       /* distance at which a particle touches a collider, in spacings, 0 to 2; 0.5. Two
                                       bodies touch at the sum of their distances */
    peri_real friction;             /* against bodies, 0 to 10: two take the geometric mean; 0.5. Against a collider
                                       the collider's counts */
    int self_contact;               /* 1: the body touches itself where it was not close to itself at rest; 0 */
    uint32_t group, touches;        /* bits. Two bodies touch when each one's group meets the other's touches; 1, all */
} peri_body_def;

/* Defaults as written above; points, count, spacing and material must be set. */
PERI_DEF peri_body_def peri_default_body_def(void);
/* The same for a sheet of this thickness (m): PERI_KERNEL_CONSTANT, with which 8 neighbours in a plane are isotropic.
   The correspondence model is in plane stress exactly, under any stretch; the stretch model has the material's moduli
   in plane stress at small strain; the projective model Young's modulus and Poisson's ratio 1/3 (its bending share is
   not used). Flexural rigidity E t^3/(12 (1 - nu^2)) times `bending`, by which alone a sheet bends; exact for every
   quadratic deflection, and no moment acts across a free edge. A clamp takes two rows of fixed particles and acts
   half way between them; one row is a hinge. */
PERI_DEF peri_body_def peri_default_sheet_def(peri_real thickness);
/* The same for a round rod of this diameter (m, at most one spacing). Its points must be about a spacing apart, as
   peri_sample_line makes them. Of the material a rod takes E, nu and the density; horizon and kernel are its own. A
   fixed particle of a rod is a clamp: its section is held. */
PERI_DEF peri_body_def peri_default_rod_def(peri_real diameter);

/* A material that bodies refer to; a copy is kept. Null id on error. */
PERI_DEF peri_material_id peri_material_create(peri_world *world, const peri_material *material);

/* A body, or a null id. The arrays of def are copied. Cost: O(count) plus the factorisation at the next step. */
PERI_DEF peri_body_id peri_body_create(peri_world *world, const peri_body_def *def);

/* Removes a body and its skins. */
PERI_DEF peri_result peri_body_destroy(peri_world *world, peri_body_id body);

/* 1 while the body exists. */
PERI_DEF int peri_body_is_valid(const peri_world *world, peri_body_id body);

/* Number of particles; 0 for a wrong id. */
PERI_DEF int peri_body_count(const peri_world *world, peri_body_id body);

/* Present positions, m: 3 count, read only, renewed by every step, valid until the next body is created or destroyed;
   NULL for a wrong id. */
PERI_DEF const peri_real *peri_body_positions(const peri_world *world, peri_body_id body);
/* Present velocities, m/s, in the same way. */
PERI_DEF const peri_real *peri_body_velocities(const peri_world *world, peri_body_id body);

/* Puts particles first .. first + count - 1 at x (3 count, m). The rest shape stays: a body put out of shape pulls
   itself back. Errors: ID, INDEX, VALUE. */
PERI_DEF peri_result peri_body_set_positions(peri_world *world, peri_body_id body, int first, int count,
                                             const peri_real *x);
/* Gives those particles velocities v (3 count, m/s); fixed ones keep theirs. Errors: ID, INDEX, VALUE. */
PERI_DEF peri_result peri_body_set_velocities(peri_world *world, peri_body_id body, int first, int count,
                                              const peri_real *v);

/* External forces (3 count, N) that act until they are set again. f NULL: none. */
PERI_DEF peri_result peri_body_set_forces(peri_world *world, peri_body_id body, int first, int count,
                                          const peri_real *f);

/* Fixes (1) or frees (0) a particle. A fixed one stays where it is, or goes where peri_body_move sends it. */
PERI_DEF peri_result peri_body_set_fixed(peri_world *world, peri_body_id body, int particle, int fixed);

/* Script-driven particles: the fixed particle is at x (m) at the end of the next step and stays there. Move it by less
   than half a spacing a step against its free neighbours: in one leap past them it would mirror their bonds. */
PERI_DEF peri_result peri_body_move(peri_world *world, peri_body_id body, int particle, peri_vec3 x);

/* Rods: turns the fixed particle's section to `rotation` (from its rest orientation in the world) by the end of the
   next step, about the particle. Errors: ID, INDEX, VALUE, ARGUMENT (free particle, no rod). */
PERI_DEF peri_result peri_rod_turn(peri_world *world, peri_body_id body, int particle, peri_quat rotation);
/* Rods: moment of the inner forces on a particle's section about the particle, N m. */
PERI_DEF peri_result peri_rod_moment(peri_world *world, peri_body_id body, int particle, peri_vec3 *moment);

/* 1 while the body sleeps. */
PERI_DEF int peri_body_is_asleep(const peri_world *world, peri_body_id body);
/* Wakes a body and all that it rests with. Every change of a body, of a collider that it touches or of gravity does the
   same. */
PERI_DEF peri_result peri_body_wake(peri_world *world, peri_body_id body);

/* What a body is and does. Energies in J; potential of gravity about the origin; momenta about the origin. */
typedef struct peri_measure {
    double mass;                        /* kg */
    double centre[3];                   /* m */
    double momentum[3];                 /* kg m/s */
    double angular_momentum[3];         /* kg m^2/s, about the origin */
    double kinetic, elastic, potential; /* J */
    double restoring;                   /* J, of elastic: what the last step's pull on particles out of shape, an energy
                                           that comes and goes with the step, adds to what the matter stores itself */
    double lower[3], upper[3];          /* bounds of the particle centres, m */
} peri_measure;

/* Measures a body (or, with a null id, the whole world). Evaluates the elastic energy: costs about one iteration. */
PERI_DEF peri_result peri_body_measure(peri_world *world, peri_body_id body, peri_measure *out);

/* Internal elastic forces at the present positions (3 count, N), fixed particles included: their sum over a fixed face
   is minus its reaction. */
PERI_DEF peri_result peri_body_forces(peri_world *world, peri_body_id body, peri_real *f);

/* ---- 3  colliders ------------------------------------------------------------------------------------------------ */

typedef enum peri_friction {
    PERI_FRICTION_SLIP,     /* none */
    PERI_FRICTION_COULOMB,  /* static and sliding, coefficient `friction` */
    PERI_FRICTION_STICK     /* no slip while touching */
} peri_friction;

typedef enum peri_shape_kind {
    PERI_SHAPE_PLANE,       /* z <= 0 is solid (colliders only) */
    PERI_SHAPE_BOX,         /* half extents `half` */
    PERI_SHAPE_BALL,        /* radius */
    PERI_SHAPE_CYLINDER,    /* radius, half_length along z */
    PERI_SHAPE_CAPSULE,     /* radius, half_length of its straight part along z */
    PERI_SHAPE_MESH,        /* closed triangle mesh (sampling only) */
    PERI_SHAPE_DISTANCE,    /* user's signed distance */
    PERI_SHAPE_NONE         /* touches nothing: a moving frame to attach to (colliders only) */
} peri_shape_kind;

/* Signed distance (m, negative inside) at p and, when gradient is not NULL, its unit gradient. Outside it may be a
   lower bound of the distance. */
typedef peri_real peri_distance(peri_vec3 p, peri_vec3 *gradient, void *context);

/* A solid about its own origin. Make one by the functions of section 4. */
typedef struct peri_shape {
    peri_shape_kind kind;
    peri_vec3 half;
    peri_real radius, half_length;
    const peri_real *vertices;      /* mesh: 3 vertex_count, m */
    const int *triangles;           /* mesh: 3 triangle_count, outward counter-clockwise */
    int vertex_count, triangle_count;
    peri_distance *distance;
    void *context;
    peri_vec3 lower, upper;         /* user's distance: bounds of the solid */
} peri_shape;

typedef struct peri_collider_def {
    uint32_t cookie;
    peri_shape shape;               /* a plane by default; any but a mesh */
    peri_vec3 position;             /* m */
    peri_quat rotation;             /* unit; identity */
    peri_vec3 velocity, spin;       /* m/s, rad/s: the pose moves by these during every step */
    peri_friction type;             /* PERI_FRICTION_COULOMB */
    peri_real friction;             /* 0 to 10; 0.5 */
} peri_collider_def;

/* Defaults as written above: the plane z = 0, solid below. */
PERI_DEF peri_collider_def peri_default_collider_def(void);
/* A collider, or a null id. A copy of the definition is kept; what a user's distance reads must outlive it. */
PERI_DEF peri_collider_id peri_collider_create(peri_world *world, const peri_collider_def *def);
/* Removes a collider; what rested on it falls at the next step. */
PERI_DEF peri_result peri_collider_destroy(peri_world *world, peri_collider_id collider);

/* Puts a collider somewhere (teleports) and sets how it moves from there. For a rigid body of a game: call it every
   frame with that body's pose and velocity; what sleeps on it wakes only when the pose is another. */
PERI_DEF peri_result peri_collider_set_pose(peri_world *world, peri_collider_id collider, peri_vec3 position,
                                            peri_quat rotation);
/* How the collider moves during the steps to come: m/s, and rad/s about its position. */
PERI_DEF peri_result peri_collider_set_velocity(peri_world *world, peri_collider_id collider, peri_vec3 velocity,
                                                peri_vec3 spin);
/* Pose at the end of the last step (either pointer may be NULL). */
PERI_DEF peri_result peri_collider_pose(const peri_world *world, peri_collider_id collider, peri_vec3 *position,
                                        peri_quat *rotation);

/* Impulse (N s) that the particles gave to the collider in the last step, by contact and by attachments, and its moment
   about the collider's position (N m s): apply both to the game's rigid body. */
PERI_DEF peri_result peri_collider_impulse(const peri_world *world, peri_collider_id collider, peri_vec3 *linear,
                                           peri_vec3 *angular);

/* ---- 4  contacts and attachments --------------------------------------------------------------------------------- */

/* A particle that touches. */
typedef struct peri_contact {
    peri_body_id body;
    int particle;
    peri_body_id other;             /* the body that it touches, or null */
    peri_collider_id collider;      /* the collider that it touches, or null */
    int nearest;                    /* particle of `other` that is nearest */
    peri_vec3 point, normal;        /* of the particle, m; unit, towards it */
    peri_vec3 force;                /* on the particle, N */
    peri_real overlap;              /* how much closer than its distance it is, m */
} peri_contact;

/* Contacts of the last step, those of sleeping bodies included: at most capacity into out, all counted in *count. out
   NULL: counts only. Errors: ARGUMENT. */
PERI_DEF peri_result peri_world_contacts(const peri_world *world, peri_contact *out, int capacity, int *count);

/* A spring between a particle and a point: of the world, of a collider's frame (then its impulse is handed back by
   peri_collider_impulse), or another particle. It acts inside the solve, like every other force. */
typedef struct peri_attachment_def {
    uint32_t cookie;
    peri_body_id body;
    int particle;
    peri_body_id other;             /* null: no body */
    int other_particle;
    peri_collider_id collider;      /* null: no collider; neither: the world */
    int here;                       /* 1: the spring is at rest as the particles are now: `point` becomes the particle's
                                       position, or `length` the present distance of two particles; 1 */
    peri_vec3 point;                /* here 0: in the collider's frame or the world's, m */
    peri_real length;               /* rest length, m, >= 0; 0 */
    int rope;                       /* 1: pulls only; 0 */
    peri_real stiffness;            /* N/m; 0: rigid, as far as the solver can (10 times the particle's own) */
    peri_real break_force;          /* N, > 0; the attachment is gone after a step that ends above it; 1e30 */
} peri_attachment_def;

/* Defaults as written above; body and particle must be set. */
PERI_DEF peri_attachment_def peri_default_attachment_def(void);
/* An attachment, or a null id. It goes with its bodies and its collider. */
PERI_DEF peri_attachment_id peri_attachment_create(peri_world *world, const peri_attachment_def *def);
/* Removes an attachment. */
PERI_DEF peri_result peri_attachment_destroy(peri_world *world, peri_attachment_id attachment);
/* 1 while the attachment holds. */
PERI_DEF int peri_attachment_is_valid(const peri_world *world, peri_attachment_id attachment);
/* Moves the point (collider's frame or world's, m): to drag a particle by a mouse, or to reel in. */
PERI_DEF peri_result peri_attachment_set_point(peri_world *world, peri_attachment_id attachment, peri_vec3 point);
/* Force on the particle at the end of the last step, N. */
PERI_DEF peri_result peri_attachment_force(const peri_world *world, peri_attachment_id attachment, peri_vec3 *force);

/* ---- 5  shapes and sampling -------------------------------------------------------------------------------------- */

/* No solid at all: a collider of this shape is a moving frame for attachments. */
PERI_DEF peri_shape peri_shape_none(void);

/* Half space z <= 0. */
PERI_DEF peri_shape peri_shape_plane(void);
/* Box of these half extents, m. */
PERI_DEF peri_shape peri_shape_box(peri_real half_x, peri_real half_y, peri_real half_z);
/* Ball, m. */
PERI_DEF peri_shape peri_shape_ball(peri_real radius);
/* Cylinder along z, 2 half_length high, m. */
PERI_DEF peri_shape peri_shape_cylinder(peri_real radius, peri_real half_length);
/* Capsule along z: a cylinder of 2 half_length with half balls on both ends, m. */
PERI_DEF peri_shape peri_shape_capsule(peri_real radius, peri_real half_length);
/* Closed triangle mesh; the arrays are not copied and must outlive the shape. */
PERI_DEF peri_shape peri_shape_mesh(const peri_real *vertices, int vertex_count, const int *triangles,
                                    int triangle_count);
/* Solid where the user's signed distance is negative, within the bounds lower .. upper. */
PERI_DEF peri_shape peri_shape_distance(peri_distance *distance, void *context, peri_vec3 lower, peri_vec3 upper);

/* Signed distance of a point to a shape and its unit gradient (may be NULL). Not for meshes. */
PERI_DEF peri_real peri_shape_evaluate(const peri_shape *shape, peri_vec3 p, peri_vec3 *gradient);

#ifndef PERI_NO_SAMPLING
/* Cubic lattice of the given spacing inside a shape: cell centres, symmetric about the middle of its bounds, x running
   fastest. Call twice: points NULL counts into *count; then points (3 capacity reals) is filled. A mesh counts as
   inside where its winding number, averaged over six directions, is above one half: self-overlaps and small holes do no
   harm; a hole wider than a tenth of the mesh is refused with its place and size (PERI_ERROR_GEOMETRY). memory (NULL:
   realloc and free) is used for meshes only. */
PERI_DEF peri_result peri_sample_with(const peri_shape *shape, peri_real spacing, peri_real *points, int capacity,
                                      int *count, const peri_allocator *memory, peri_error *err);
/* The same with realloc and free. */
PERI_DEF peri_result peri_sample(const peri_shape *shape, peri_real spacing, peri_real *points, int capacity,
                                 int *count, peri_error *err);

/* Square lattice for a sheet: the rectangle width (x) by height (y) in the plane z = 0 about the origin, cell centres
   as above, x running fastest. Called twice as above. */
PERI_DEF peri_result peri_sample_rectangle(peri_real width, peri_real height, peri_real spacing, peri_real *points,
                                           int capacity, int *count, peri_error *err);

/* How even a sampled surface came out: distance of a point to its nearest neighbour, in m. */
typedef struct peri_sample_report {
    double least, mean, most;
    double measure;             /* area of the surface, m^2 */
} peri_sample_report;

/* One layer of points on the surface of a triangle mesh, open or closed, coincident vertices welded, evenly `spacing`
   apart: nearest neighbours at 0.75 to 1.35 spacings, 0.9 to 1.05 in the mean, where sides, borders and creases are
   further apart than a spacing (closer ones get fewer points, and a thin solid one layer for both sides). Borders and
   (above 40 degrees) creases are kept: points on corners first, then at equal steps along the curves between. The
   number is area/spacing^2 plus half of the borders' length/spacing, within 3 % from some hundred points on. areas
   (capacity, m^2; may be NULL): each point's share of the surface, the area in all; times the thickness it is the
   point's volume. The same triangles give the same points however their vertices are shared. report may be NULL. Called
   twice as above; both calls do the whole work (about a second for 3000 points, 2 kB for each), so that a capacity that
   is surely enough saves half. Errors: LIMIT where the spacing is too fine (about three million points),
   GEOMETRY for a mesh without area. */
PERI_DEF peri_result peri_sample_surface_with(const peri_shape *mesh, peri_real spacing, peri_real *points,
                                              peri_real *areas, int capacity, int *count, peri_sample_report *report,
                                              const peri_allocator *memory, peri_error *err);
/* The same with realloc and free. */
PERI_DEF peri_result peri_sample_surface(const peri_shape *mesh, peri_real spacing, peri_real *points,
                                         peri_real *areas, int capacity, int *count, peri_sample_report *report,
                                         peri_error *err);

/* Points along a polyline of vertex_count vertices (3 each, m) for a rod: round(length/spacing) equal steps, both ends
   included; closed: back to the first, which is not repeated. *step (m; may be NULL): their distance along the line, to
   be given as the body's spacing. Called twice as above. */
PERI_DEF peri_result peri_sample_line(const peri_real *vertices, int vertex_count, int closed, peri_real spacing,
                                      peri_real *points, int capacity, int *count, peri_real *step, peri_error *err);
#endif

/* ---- 6  skins ---------------------------------------------------------------------------------------------------- */
#ifndef PERI_NO_SKINNING

/* Binds the vertices of a fine mesh, given in the coordinates of the body's points (peri_body_def.points), to the
   particles around them; triangles (3 triangle_count; may be NULL) are for the normals. Vertices further than 4
   spacings from every particle are refused. Follows affine motion exactly, to rounding. */
PERI_DEF peri_skin_id peri_skin_create(peri_world *world, peri_body_id body, const peri_real *vertices,
                                       int vertex_count, const int *triangles, int triangle_count);
/* Removes a skin. */
PERI_DEF peri_result peri_skin_destroy(peri_world *world, peri_skin_id skin);

/* Present positions (3 vertex_count, m) and, when normals is not NULL, unit normals of the skin. */
PERI_DEF peri_result peri_skin_update(peri_world *world, peri_skin_id skin, peri_real *positions, peri_real *normals);

#endif

/* ---- 7  looking: values, statistics, debug drawing --------------------------------------------------------------- */

typedef enum peri_value {
    PERI_VALUE_STRETCH,     /* largest |tau - 1| of a particle's bonds */
    PERI_VALUE_STRESS,      /* von Mises equivalent of the Cauchy stress, Pa */
    PERI_VALUE_ENERGY,      /* energy density, J/m^3 */
    PERI_VALUE_DAMAGE,      /* share of broken bonds, 0 to 1 */
    PERI_VALUE_SPEED        /* m/s */
} peri_value;

/* One value per particle (count reals, out). */
PERI_DEF peri_result peri_body_values(peri_world *world, peri_body_id body, peri_value value, peri_real *out);

/* Cauchy stress of every particle (6 count, Voigt order, Pa, out): the virial of the particle's own energy, exact under
   affine deformation in the correspondence model. */
PERI_DEF peri_result peri_body_stress(peri_world *world, peri_body_id body, peri_real *out);

/* Least squares deformation gradient Fbar of every particle (9 count, rows, out). Of a sheet the normal becomes the
   present normal, shorter by what the thickness lost in the correspondence model. */
PERI_DEF peri_result peri_body_gradient(peri_world *world, peri_body_id body, peri_real *out);

typedef struct peri_profile {       /* milliseconds of the last step */
    double begin, families, solve, constrain, flow, commit, total;
    double local, global, search;   /* parts of solve: forces, matrix, the rest */
    double factor;                  /* part of begin: matrices and factors made anew */
} peri_profile;

typedef struct peri_stats {
    int bodies, particles, bonds, colliders, contacts, skins, attachments;
    int islands;                /* sets of bodies that were solved together in the last step */
    int asleep;                 /* bodies that sleep */
    int broken;                 /* attachments that broke, since creation */
    double overlap;             /* largest of any contact at the end of the last step, in spacings of what touches */
    int iterations;             /* of the last step: most of any body */
    int evaluations;            /* force evaluations of the last step: most of any body */
    int converged;              /* 0 when a body of the last step met max_iterations */
    double correction;          /* last correction of the last step, m: largest of any body */
    double residual;            /* rms unbalanced force per particle at the end of the last step, N: largest */
    int singular;               /* particles whose bonds cannot hold a tensor: they use the stretch model */
    int unhealthy;              /* particles being pulled back to shape in the last step */
    int factors;                /* matrices factorised since creation */
    int factors_held;           /* factors that exist now: copies of one body share theirs while nothing touches them */
    int undone;                 /* steps that failed and were undone */
    size_t bytes, bytes_peak;   /* held now, and at most */
    size_t allocations;         /* calls of the memory hook that asked for bytes, since creation */
    size_t factor_bytes;        /* held by factors */
    peri_profile profile;
} peri_stats;

/* Counts, sizes and times; all zero for NULL. */
PERI_DEF peri_stats peri_world_stats(const peri_world *world);

/* What solves a body's global step, and why. */
typedef struct peri_choice {
    peri_solver solver;     /* PERI_SOLVER_AUTO: not chosen yet; the first step does that */
    double cost[2];         /* ms a step, as counted for Cholesky and for two levels; 0: not counted */
    double entries;         /* of the Cholesky factor; 0: not counted */
    char why[160];          /* a sentence */
} peri_choice;

/* Counted from bonds and fill when the body's first step is made, not clocked: the same on every machine. All zero for
   a wrong id. */
PERI_DEF peri_choice peri_body_solver(const peri_world *world, peri_body_id body);

#ifndef PERI_NO_DRAW
/* Debug drawing: called for every particle and every bond (each pair once), with t the chosen value mapped to 0 .. 1
   over [low, high]. Either callback may be NULL. */
typedef struct peri_draw {
    void (*point)(peri_vec3 p, peri_real radius, peri_real t, void *user);
    void (*line)(peri_vec3 a, peri_vec3 b, peri_real t, void *user);
    peri_value value;
    peri_real low, high;
    void *user;
} peri_draw;

/* Draws all bodies through the callbacks. Costs about one iteration. Errors: ARGUMENT, VALUE. */
PERI_DEF peri_result peri_world_draw(peri_world *world, const peri_draw *draw);
#endif

#endif /* PERI_H */
/* Stop here if you only want the API. */

#ifdef PERI_IMPLEMENTATION
#ifndef PERI_IMPLEMENTED
#define PERI_IMPLEMENTED

#include <math.h>
#include <string.h>
#include <time.h>
#ifdef _OPENMP
#include <omp.h>
#endif

/* ---- implementation 1: the world's parts ------------------------------------------------------------------------- */

#define PERI__GRAIN 256 /* particles in a piece of a parallel loop; fixed, so that results do not depend on it */
#define PERI__HORIZON_MAX 6
#define PERI__GHOSTS 4  /* around every point of a rod */

/* Things with ids live in slots; every one begins with this. */
typedef struct peri__slot {
    uint32_t generation;
    int used;
} peri__slot;

typedef struct peri__slots {
    char *data;
    size_t element;     /* bytes of one */
    int capacity, limit, count;
    const char *name;
} peri__slots;

/* flags of a particle */
enum { PERI__FIXED = 1, PERI__MOVED = 2, PERI__SINGULAR = 4, PERI__FLAT = 8, PERI__SURFACE = 16, PERI__ORIENTED = 32 };

/* Points sorted into cubic cells by counting: cell c holds order[start[c]] .. order[start[c + 1] - 1], in ascending
   order of index. */
typedef struct peri__grid {
    int cells[3];
    double lower[3], upper[3], inv_size;
    int *start, *order, most;   /* most: cells that there is room for */
    int stations, closed;       /* of a rod: only particles of neighbouring stations are near; else 0 */
    size_t start_bytes, order_bytes;
} peri__grid;

typedef enum peri__why {
    PERI__WHY_NOT_YET, PERI__WHY_ASKED, PERI__WHY_SMALL, PERI__WHY_COST, PERI__WHY_ROOM, PERI__WHY_LEFT_OUT
} peri__why;

typedef struct peri__body {
    peri__slot slot;
    int first, count;           /* its range in the world's particle arrays */
    peri__matter matter;
    peri__bonds bonds;          /* points into block; mode and special are set by peri__view */
    peri__lanes lanes;          /* likewise: the body in the layout of the hot loops */
    int *start, *near;          /* of its blocks: see peri__lanes */
    size_t near_bytes;          /* of near, where it is a block of its own */
    void *block;
    size_t block_bytes;
    int *row, *col;             /* the same arrays, writable while they are made */
    peri_real *xi[3], *inv_r2, *weight, *gain, *share, *volume, *shape, *moment, *normal;
    peri_form form;
    double fibre[2];            /* of a rod: what ghosts' and points' fibres add to the cage, N */
    double ghost_part;          /* of a rod's outer forces that each ghost takes: its part of the stretch */
    int stations, closed;       /* points of a rod, before its ghosts in the particle range; else 0 */
    double rigidity;            /* of a sheet: bending t^2/12, m^2; times E/(1 - nu^2) it is D/t */
    peri_real *plate, *plate_rest;  /* of a sheet that bends: see peri__bonds */
    peri_real *plate_stiffness;     /* sum of a particle's L^2, N/m */
    size_t plate_bytes;
    int plate_rows;
    peri__matter *matters;      /* body of several materials: all of them, */
    unsigned char *kind;        /* and which a particle is made of; else NULL */
    peri_real *firmness, *far_gain; /* factor on a particle's stiffness, or NULL; see peri__bonds */
    peri_real *points;          /* reference positions as they were given */
    peri_real *value, *diagonal;    /* of the matrix */
    peri_real *stiffness, *pinned;  /* sum of a row's bonds; stiffness of contacts in the diagonal, N/m */
    int *surface, surface_count;    /* particles that can touch other bodies */
    peri_quat rotation;         /* of the definition: turns points as given, for skins */
    double spacing, horizon, radius, mass, friction;
    int self_contact;
    uint32_t group, touches;
    int fixed, singular, unhealthy, braced; /* particles; the last two: during this step */
    int steps;                  /* since the last break of its history: BDF2 needs one */
    double step_before;         /* dt of the last step, for BDF2 with changing steps */
    double matrix_h;            /* the step that the matrix was made for; 0: must be made */
    int stale;                  /* particles whose contact the factor does not know, or knows without need */
    double wasted;              /* operations that stale particles have cost since the last factorisation */
    int usual;                  /* iterations of the last step with a fresh factor */
    double h, tolerance;        /* of the step under way: its effective length, what ends the iterations, m */
    peri__grid grid;            /* over the surface, made when something comes near */
    int grid_made;
    double lower[3], upper[3];  /* box of the surface's path in this step */
    double drift[3], stray;     /* mean displacement of the guess, largest departure from it */
    double retreat;             /* share of the guess that is kept */
    int parent, island, next, at;   /* union of touching bodies; its island, the next body there, its place */
    int near_contact;           /* there are contacts to be looked at */
    int touching, held;         /* after the step: it touches something; that does not move freely */
    int restless;               /* what it touches moves by itself */
    int begun;                  /* this step: x* and the first guess are made */
    int strayed;                /* it ended further from the guess than contacts were sought for */
    int unsolved;               /* its contacts met the cap on iterations: it may touch what it seems to miss */
    int asleep;                 /* number of the group that it sleeps with, or 0 */
    int asleep0, still_steps0;  /* the same before the step, to go back to */
    double still0;
    int still_steps, tired, calm;   /* calm: nearly as slow, so solved more exactly */
    double still;               /* s that it has been slow */
#ifndef PERI_NO_CHOLESKY
    struct peri__factor *factor;    /* may be shared */
#endif
    peri_solver solver;         /* what AUTO became */
    peri__why why;              /* and why */
    size_t fill;                /* entries that L has or would have; costs counted for Cholesky and two levels */
    double cost[2];
    double chebyshev_low;
} peri__body;

#ifndef PERI_NO_CHOLESKY
/* A factor of all bodies whose matrices have the same bits: copies of one body share it. */
typedef struct peri__factor {
    peri_cholesky *l;           /* one of the two */
    peri_two_level *levels;
    uint64_t hash;              /* of the matrix */
    int users;
} peri__factor;
#endif

typedef struct peri__collider {
    peri__slot slot;
    peri_collider_def def;
    double position[3], rotation[9];        /* at the start of the step */
    double position1[3], rotation1[9];      /* at its end */
    peri_quat quat, quat1;
    double linear[3], angular[3];           /* impulse of the last step */
    double weight[3], lean[3];              /* force and moment of what sleeps on it */
    double turned;                          /* angle of this step, rad */
    int moved;                              /* it was put elsewhere since the last step */
} peri__collider;

typedef struct peri__attachment {
    peri__slot slot;
    peri_attachment_def def;
    int body, other, collider;              /* slots; -1: none */
    int next;                               /* in the island */
    double point[3], length, stiffness;
    double force[3], energy;                /* on the particle, N */
    double committed[3];                    /* of the last finished step */
} peri__attachment;

#define PERI__PATCH 12          /* particles that a foot on a surface hangs between, at most */
#define PERI__TARGET_BODY 65536 /* targets from here on are bodies, below colliders */

/* A particle near a collider or near another body, in the step under way. */
typedef struct peri__contact {
    int body, target, particle;
    int touching;
    int known;              /* touched in the step before */
    int side;               /* of a sheet: 1 where its normal points to, -1; 0: no sheet */
    int loose;              /* slid off the patch sideways */
    int count;              /* of the patch */
    int patch[PERI__PATCH]; /* particles of the other body that the foot hangs between */
    double share[PERI__PATCH];  /* their weights, sum 1 */
    double distance, reach2;    /* at which it touches; squared support of the weights */
    double anchor[3];       /* see peri__hold */
    double normal[3];       /* towards the particle, on the side where it is */
    double entry[4], grade; /* see peri__hold */
    double friction, stiffness;
    double held;            /* the pressure that limits friction: fixed during a line search */
    double depth, pressure, energy, force[3];
    double stored;          /* energy at the end of the last step, J */
} peri__contact;

/* A contact kept from step to step while it touches: friction remembers where it holds, and which side it is. */
typedef struct peri__hold {
    int body, target, particle, nearest, side;
    double anchor[3];       /* collider: where friction holds, in its frame; body: the spring's extension, m */
    double normal[3];       /* collider: in its frame */
    double entry[4];        /* collider: the last place with the right normal, in its frame, and its distance */
    double grade;           /* by how much the push was stiffened */
    double force[3], overlap;
} peri__hold;

typedef struct peri__edge {
    double lower;
    int body;
} peri__edge;

/* Bodies that are solved together. */
typedef struct peri__island {
    int first, last;        /* bodies, chained by `next` */
    int at, count;          /* particles in the solve arrays */
    int contacts, contacts_end; /* range of contact_order */
    int attachment;         /* first of a chain, or -1 */
} peri__island;

/* Particle arrays, all in the table of peri__particle_rows below; which ones exist depends on what the world uses. */
enum {
    PERI__WANT_STATE = 1, PERI__WANT_SOLVE = 2, PERI__WANT_LBFGS = 4, PERI__WANT_HISTORY = 8, PERI__WANT_FORCE = 16,
    PERI__WANT_AIM = 32, PERI__WANT_SPECIAL = 64, PERI__WANT_PLATE = 128, PERI__WANT_BRACE = 256
};
#define PERI__ROWS 24

struct peri_world {
    peri_world_def def;
    peri_error error;
    void *buffer;               /* the caller's, or NULL */
    struct peri__free *heap, *spare;    /* free blocks of the buffer: for what has limits; for factors and skins */
    peri__slots bodies, materials, colliders, skins, attachments;
    int particles, capacity;    /* of the particle arrays */
    int bonds;
    unsigned wants;
    size_t row_bytes[PERI__ROWS];   /* held by each array */
    int stride;                 /* reals of coef per particle */
    double *x, *x0, *star, *base, *back, *aim, *partial;
    peri_real *v, *v0, *out, *mass, *force, *g, *g1, *p, *change, *coef, *plate, *history, *work, *special, *brace;
    unsigned char *flags, *mode;
    peri__contact *contacts;    /* of the step under way, in order of body, target, particle */
    int *contact_order;         /* the same, by island */
    peri__hold *holds, *holds_next;  /* what touched at the end of the last step, in the same order */
    int contact_count, contact_capacity, hold_count, held_rows[4];  /* rows of the four arrays */
    peri__edge *sweep;          /* one for each place of a body, like islands */
    peri__island *islands;
    uint64_t *pairs;            /* of bodies that are near each other */
    int body_rows[2], pair_count, pair_capacity;
    int self_contacts;          /* bodies that may touch themselves */
    int asleep, woken;          /* bodies that sleep; one was woken while contacts were sought */
    int checking, missed;       /* contacts are sought again, after the solve; one was missed */
    int unsettled;              /* bodies fell asleep or woke since colliders were told what rests on them */
    double overlap;             /* largest of the last step, in spacings */
    peri_stats stats;
};

/* The table of particle arrays: where, bytes per particle, who wants it. */
static int peri__particle_rows(peri_world *w, void ***array, size_t *bytes, unsigned *want) {
    size_t d3 = 3 * sizeof(double), r3 = 3 * sizeof(peri_real), r = sizeof(peri_real);
    int n = 0;
#define PERI__ROW(field, size, who) \
    (array[n] = (void **)(void *)&w->field, bytes[n] = (size), want[n] = (unsigned)(who), n++)
    PERI__ROW(x, d3, PERI__WANT_STATE);
    PERI__ROW(x0, d3, PERI__WANT_STATE);
    PERI__ROW(v, r3, PERI__WANT_STATE);
    PERI__ROW(v0, r3, PERI__WANT_STATE);
    PERI__ROW(out, r3, PERI__WANT_STATE);
    PERI__ROW(mass, r, PERI__WANT_STATE);
    PERI__ROW(flags, 1, PERI__WANT_STATE);
    PERI__ROW(mode, 1, PERI__WANT_STATE);
    PERI__ROW(back, d3, PERI__WANT_HISTORY);
    PERI__ROW(aim, d3, PERI__WANT_AIM);
    PERI__ROW(force, r3, PERI__WANT_FORCE);
    PERI__ROW(special, 9 * r, PERI__WANT_SPECIAL);
    PERI__ROW(brace, r, PERI__WANT_BRACE);
    PERI__ROW(star, d3, PERI__WANT_SOLVE);
    PERI__ROW(base, d3, PERI__WANT_SOLVE);
    PERI__ROW(g, r3, PERI__WANT_SOLVE);
    PERI__ROW(g1, r3, PERI__WANT_SOLVE);
    PERI__ROW(p, r3, PERI__WANT_SOLVE);
    PERI__ROW(change, r3, PERI__WANT_SOLVE);
    PERI__ROW(coef, (size_t)w->stride * r, PERI__WANT_SOLVE);
    PERI__ROW(plate, PERI__PLATE_STRIDE * r, PERI__WANT_PLATE);
    PERI__ROW(partial, sizeof(double), PERI__WANT_SOLVE);
    PERI__ROW(work, 6 * r, PERI__WANT_SOLVE);
    PERI__ROW(history, 2 * (size_t)w->def.lbfgs * r3, PERI__WANT_LBFGS);
#undef PERI__ROW
    return n;
}

static peri_result peri__report(peri_world *w, peri_result result) {
    if (result && w->def.log) w->def.log(w->error.text, w->def.user);
    return result;
}

static double peri__clock(const peri_world *w) {
    if (w->def.clock) return w->def.clock(w->def.user);
#ifdef _OPENMP
    return omp_get_wtime();
#else
    return (double)clock() / CLOCKS_PER_SEC;
#endif
}

/* ---- implementation 2: memory ------------------------------------------------------------------------------------ */

/* Free blocks of a caller's buffer, in order of address; neighbours are merged. First fit. */
typedef struct peri__free {
    size_t bytes;
    struct peri__free *next;
} peri__free;

#define PERI__UNIT ((size_t)32)

static size_t peri__round_up(size_t bytes) { return (bytes + PERI__UNIT - 1) / PERI__UNIT * PERI__UNIT; }

static void peri__heap_release(peri__free **at, void *ptr, size_t bytes) {
    peri__free *block = (peri__free *)ptr;
    peri__free *before = NULL;
    while (*at && (char *)*at < (char *)ptr) {
        before = *at;
        at = &(*at)->next;
    }
    block->bytes = peri__round_up(bytes);
    block->next = *at;
    *at = block;
    if (block->next && (char *)block + block->bytes == (char *)block->next) {
        block->bytes += block->next->bytes;
        block->next = block->next->next;
    }
    if (before && (char *)before + before->bytes == (char *)block) {
        before->bytes += block->bytes;
        before->next = block->next;
    }
}

/* One free block; NULL when there is no room for any. */
static peri__free *peri__heap_begin(char *at, size_t bytes) {
    peri__free *block = (peri__free *)(void *)at;
    if (bytes < PERI__UNIT) return NULL;
    block->bytes = bytes;
    block->next = NULL;
    return block;
}

static void *peri__heap_take(peri__free **at, size_t bytes) {
    bytes = peri__round_up(bytes);
    for (; *at; at = &(*at)->next) {
        peri__free *block = *at, *rest;
        if (block->bytes < bytes) continue;
        if (block->bytes == bytes) {
            *at = block->next;
            return block;
        }
        rest = (peri__free *)(void *)((char *)block + bytes);
        rest->bytes = block->bytes - bytes;
        rest->next = block->next;
        *at = rest;
        return block;
    }
    return NULL;
}

/* All memory of a world goes through here: a heap of its buffer or the hook, counted. Contract of peri_allocator. */
static void *peri__take(peri_world *w, peri__free **heap, void *ptr, size_t old_bytes, size_t new_bytes) {
    void *result;
    if (!ptr) old_bytes = 0;
    if (w->buffer) {
        result = new_bytes ? peri__heap_take(heap, new_bytes) : NULL;
        if (new_bytes && !result) return NULL;
        if (result && ptr) memcpy(result, ptr, old_bytes < new_bytes ? old_bytes : new_bytes);
        if (ptr) peri__heap_release(heap, ptr, old_bytes);
    } else {
        result = peri__resize(&w->def.memory, ptr, old_bytes, new_bytes);
        if (new_bytes && !result) return NULL;
    }
    w->stats.allocations += new_bytes > 0;
    w->stats.bytes += new_bytes;
    w->stats.bytes -= old_bytes;
    if (w->stats.bytes > w->stats.bytes_peak) w->stats.bytes_peak = w->stats.bytes;
    return result;
}

static void *peri__world_resize(void *ptr, size_t old_bytes, size_t new_bytes, void *user) {
    peri_world *w = (peri_world *)user;
    return peri__take(w, &w->heap, ptr, old_bytes, new_bytes);
}

/* Factors and skins have no limit in the definition: in a buffer they get spare_bytes and no more, so that they never
   take what a body within the limits was promised. */
static void *peri__spare_resize(void *ptr, size_t old_bytes, size_t new_bytes, void *user) {
    peri_world *w = (peri_world *)user;
    return peri__take(w, &w->spare, ptr, old_bytes, new_bytes);
}

PERI__SHARED peri_allocator peri__spare(peri_world *w) {
    peri_allocator a;
    a.resize = peri__spare_resize;
    a.user = w;
    return a;
}

static peri_result peri__no_memory(peri_world *w, size_t bytes) {
    return peri__fail(&w->error, PERI_ERROR_MEMORY, "%zu bytes were refused by the %s: %s", bytes,
                      w->buffer ? "buffer" : "allocator",
                      w->buffer ? "raise the limits or spare_bytes of the world's definition" : "memory is full");
}

/* Grows *array, of `old` things of `size` bytes, to `now` things; new ones are zero. */
static peri_result peri__grow(peri_world *w, void **array, size_t old, size_t now, size_t size) {
    size_t bytes;
    void *p;
    if (!peri__mul_size(now, size, &bytes)) return peri__fail(&w->error, PERI_ERROR_LIMIT, "an array passes size_t");
    p = peri__world_resize(*array, old * size, bytes, w);
    if (!p && bytes) return peri__no_memory(w, bytes);
    if (now > old) memset((char *)p + old * size, 0, (now - old) * size);
    *array = p;
    return PERI_OK;
}

/* Makes the wanted particle arrays hold `particles`. What exists is kept; on failure nothing is lost. */
static peri_result peri__reserve(peri_world *w, int particles, unsigned wants, int stride) {
    void **array[PERI__ROWS + 1];
    size_t bytes[PERI__ROWS + 1];
    unsigned want[PERI__ROWS + 1];
    int n, k, capacity = w->capacity, stride_before = w->stride;
    unsigned wants_before = w->wants;
    if (particles > capacity) {
        capacity += capacity / 2;
        if (capacity < particles) capacity = particles;
        if (capacity > w->def.max_particles) capacity = w->def.max_particles;
    }
    w->wants |= wants;
    if (stride > w->stride) w->stride = stride;
    n = peri__particle_rows(w, array, bytes, want);
    for (k = 0; k < n; k++) {
        size_t held = w->row_bytes[k], need;
        peri_result bad;
        if (!(want[k] & w->wants)) continue;
        if (!peri__mul_size((size_t)capacity, bytes[k], &need))
            return peri__fail(&w->error, PERI_ERROR_LIMIT, "%d particles pass size_t", capacity);
        if (need <= held) continue;
        bad = peri__grow(w, array[k], held, need, 1);
        if (bad) {
            w->wants = wants_before;
            w->stride = stride_before;
            return bad;
        }
        w->row_bytes[k] = need;
    }
    w->capacity = capacity;
    return PERI_OK;
}

/* A free slot (zeroed but for its generation), or NULL with the error set. */
static peri__slot *peri__slot_take(peri_world *w, peri__slots *s) {
    peri__slot *slot;
    int k;
    for (k = 0; k < s->capacity; k++)
        if (!((peri__slot *)(void *)(s->data + (size_t)k * s->element))->used) break;
    if (k >= s->limit) {
        peri__fail(&w->error, PERI_ERROR_LIMIT, "the world already has %d %s: raise max_%s of its definition", s->limit,
                   s->name, s->name);
        return NULL;
    }
    if (k == s->capacity) {
        int now = s->capacity ? 2 * s->capacity : 8;
        void *data = s->data;
        if (now > s->limit) now = s->limit;
        if (peri__grow(w, &data, (size_t)s->capacity, (size_t)now, s->element)) return NULL;
        s->data = (char *)data;
        s->capacity = now;
    }
    slot = (peri__slot *)(void *)(s->data + (size_t)k * s->element);
    return slot;
}

static uint32_t peri__slot_use(peri__slots *s, peri__slot *slot) {
    slot->used = 1;
    slot->generation++;
    s->count++;
    return (uint32_t)(((char *)slot - s->data) / (ptrdiff_t)s->element) + 1;
}

static void peri__slot_free(peri__slots *s, peri__slot *slot) {
    uint32_t generation = slot->generation;
    memset(slot, 0, s->element);
    slot->generation = generation;
    s->count--;
}

static peri__slot *peri__slot_at(const peri__slots *s, int k) {
    peri__slot *slot;
    if (k < 0 || k >= s->capacity) return NULL;
    slot = (peri__slot *)(void *)(s->data + (size_t)k * s->element);
    return slot->used ? slot : NULL;
}

static peri__slot *peri__slot_find(const peri__slots *s, uint32_t index1, uint32_t generation) {
    peri__slot *slot = index1 ? peri__slot_at(s, (int)(index1 - 1)) : NULL;
    return slot && slot->generation == generation ? slot : NULL;
}

static peri__body *peri__body_at(const peri_world *w, int k) {
    return (peri__body *)(void *)peri__slot_at(&w->bodies, k);
}

static peri__body *peri__body_find(const peri_world *w, peri_body_id id) {
    return w ? (peri__body *)(void *)peri__slot_find(&w->bodies, id.index1, id.generation) : NULL;
}

/* Particles that the user knows of. */
static int peri__real_count(const peri__body *b) { return b->stations ? b->stations : b->count; }

static peri_result peri__no_body(peri_world *w, peri_body_id id) {
    if (!w) return PERI_ERROR_ARGUMENT;
    return peri__report(w, peri__fail(&w->error, PERI_ERROR_ID, "body (%u, %u) does not exist in this world",
                                      (unsigned)id.index1, (unsigned)id.generation));
}

/* ---- shapes ------------------------------------------------------------------------------------------------------ */

#define PERI__MESH_TRIANGLES (1 << 28)  /* most triangles of a mesh: three edges each must be counted in an int */

static peri_shape peri__shape_of(peri_shape_kind kind) {
    peri_shape s;
    memset(&s, 0, sizeof s);
    s.kind = kind;
    return s;
}

peri_shape peri_shape_none(void) { return peri__shape_of(PERI_SHAPE_NONE); }

peri_shape peri_shape_plane(void) { return peri__shape_of(PERI_SHAPE_PLANE); }

peri_shape peri_shape_box(peri_real half_x, peri_real half_y, peri_real half_z) {
    peri_shape s = peri__shape_of(PERI_SHAPE_BOX);
    s.half.x = half_x;
    s.half.y = half_y;
    s.half.z = half_z;
    return s;
}

peri_shape peri_shape_ball(peri_real radius) {
    peri_shape s = peri__shape_of(PERI_SHAPE_BALL);
    s.radius = radius;
    return s;
}

peri_shape peri_shape_cylinder(peri_real radius, peri_real half_length) {
    peri_shape s = peri__shape_of(PERI_SHAPE_CYLINDER);
    s.radius = radius;
    s.half_length = half_length;
    return s;
}

peri_shape peri_shape_capsule(peri_real radius, peri_real half_length) {
    peri_shape s = peri__shape_of(PERI_SHAPE_CAPSULE);
    s.radius = radius;
    s.half_length = half_length;
    return s;
}

peri_shape peri_shape_mesh(const peri_real *vertices, int vertex_count, const int *triangles,
                           int triangle_count) {
    peri_shape s = peri__shape_of(PERI_SHAPE_MESH);
    s.vertices = vertices;
    s.vertex_count = vertex_count;
    s.triangles = triangles;
    s.triangle_count = triangle_count;
    return s;
}

peri_shape peri_shape_distance(peri_distance *distance, void *context, peri_vec3 lower, peri_vec3 upper) {
    peri_shape s = peri__shape_of(PERI_SHAPE_DISTANCE);
    s.distance = distance;
    s.context = context;
    s.lower = lower;
    s.upper = upper;
    return s;
}

/* Writes the gradient when it is asked for and passes the distance on. */
static peri_real peri__shape_answer(double distance, double x, double y, double z, peri_vec3 *gradient) {
    if (gradient) {
        gradient->x = (peri_real)x;
        gradient->y = (peri_real)y;
        gradient->z = (peri_real)z;
    }
    return (peri_real)distance;
}

/* Distance of p to the box |p[i]| <= half[i] in `dims` dimensions, and its unit gradient g. Inside, the nearest face
   decides (the first of equally near ones); on a middle plane the positive face does, so g is always definite. */
static double peri__shape_corner(int dims, const double *p, const double *half, double *g) {
    double q, length, sum = 0, nearest = 0;
    int i, axis = 0;
    for (i = 0; i < dims; i++) {
        q = fabs(p[i]) - half[i];
        if (i == 0 || q > nearest) {
            nearest = q;
            axis = i;
        }
        g[i] = q > 0 ? q : 0;
        sum += g[i] * g[i];
    }
    if (sum > 0) {
        length = sqrt(sum);
        for (i = 0; i < dims; i++) g[i] = (p[i] < 0 ? -g[i] : g[i]) / length;
        return length;
    }
    for (i = 0; i < dims; i++) g[i] = 0;
    g[axis] = p[axis] < 0 ? -1 : 1;
    return nearest;
}

/* Distance to the ball of `radius` about the origin; at the centre the gradient is (gx, 0, gz) as given. */
static peri_real peri__shape_round(const double p[3], double radius, double gx, double gz, peri_vec3 *gradient) {
    double length = sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2]);
    if (!(length > 1e-140)) return peri__shape_answer(-radius, gx, 0, gz, gradient); /* squares lose bits below */
    return peri__shape_answer(length - radius, p[0] / length, p[1] / length, p[2] / length, gradient);
}

peri_real peri_shape_evaluate(const peri_shape *shape, peri_vec3 point, peri_vec3 *gradient) {
    double p[3], half[3], g[3], r, along, distance;
    if (gradient) (void)peri__shape_answer(0, 0, 0, 1, gradient);
    if (!shape) return 0;
    p[0] = (double)point.x;
    p[1] = (double)point.y;
    p[2] = (double)point.z;
    half[0] = (double)shape->half.x;
    half[1] = (double)shape->half.y;
    half[2] = (double)shape->half.z;
    switch (shape->kind) {
    case PERI_SHAPE_NONE: return (peri_real)1e30;
    case PERI_SHAPE_PLANE: return point.z;
    case PERI_SHAPE_BOX:
        distance = peri__shape_corner(3, p, half, g);
        return peri__shape_answer(distance, g[0], g[1], g[2], gradient);
    case PERI_SHAPE_BALL: return peri__shape_round(p, (double)shape->radius, 0, 1, gradient);
    case PERI_SHAPE_CYLINDER: /* a rectangle in the half plane through the axis and the point */
        r = sqrt(p[0] * p[0] + p[1] * p[1]);
        along = r > 1e-140 ? p[0] / r : 1;
        half[2] = r > 1e-140 ? p[1] / r : 0;
        p[0] = r;
        p[1] = p[2];
        half[0] = (double)shape->radius;
        half[1] = (double)shape->half_length;
        distance = peri__shape_corner(2, p, half, g);
        return peri__shape_answer(distance, g[0] * along, g[0] * half[2], g[1], gradient);
    case PERI_SHAPE_CAPSULE: /* a ball about the nearest point of the axis */
        along = (double)shape->half_length;
        p[2] -= p[2] > along ? along : p[2] < -along ? -along : p[2];
        return peri__shape_round(p, (double)shape->radius, 1, 0, gradient);
    case PERI_SHAPE_DISTANCE: return shape->distance ? shape->distance(point, gradient, shape->context) : 0;
    default: return 0;
    }
}

/* One length of a shape: finite and above zero (zero_ok: or zero). */
static peri_result peri__shape_length(const char *name, peri_real value, int zero_ok, peri_error *err) {
    double x = (double)value;
    if (peri__finite(x) && (x > 0 || (zero_ok && x >= 0))) return PERI_OK;
    return peri__fail(err, PERI_ERROR_VALUE, "shape.%s is %g m; it must be finite and %s 0", name, x,
                      zero_ok ? "at least" : "above");
}

static peri_result peri__shape_check_mesh(const peri_shape *s, peri_error *err) {
    int i;
    if (!s->vertices || !s->triangles)
        return peri__fail(err, PERI_ERROR_ARGUMENT, "shape.%s of a mesh is NULL",
                          s->vertices ? "triangles" : "vertices");
    if (s->vertex_count < 3)
        return peri__fail(err, PERI_ERROR_VALUE, "shape.vertex_count is %d; a mesh has at least 3", s->vertex_count);
    if (s->triangle_count < 1)
        return peri__fail(err, PERI_ERROR_VALUE, "shape.triangle_count is %d; a mesh has at least 1",
                          s->triangle_count);
    if (s->triangle_count > PERI__MESH_TRIANGLES)
        return peri__fail(err, PERI_ERROR_LIMIT, "shape.triangle_count is %d; at most %d are handled",
                          s->triangle_count, PERI__MESH_TRIANGLES);
    for (i = 0; i < s->vertex_count; i++) {
        const peri_real *p = s->vertices + 3 * (size_t)i;
        if (!peri__finite((double)p[0]) || !peri__finite((double)p[1]) || !peri__finite((double)p[2]))
            return peri__fail(err, PERI_ERROR_VALUE, "vertex %d of the mesh is (%g, %g, %g); it must be finite", i,
                              (double)p[0], (double)p[1], (double)p[2]);
    }
    for (i = 0; i < 3 * s->triangle_count; i++)
        if (s->triangles[i] < 0 || s->triangles[i] >= s->vertex_count)
            return peri__fail(err, PERI_ERROR_INDEX, "triangle %d of the mesh uses vertex %d; there are %d", i / 3,
                              s->triangles[i], s->vertex_count);
    return PERI_OK;
}

static peri_result peri__shape_check_distance(const peri_shape *s, int as_collider, peri_error *err) {
    double low[3], high[3];
    int i;
    if (!s->distance) return peri__fail(err, PERI_ERROR_ARGUMENT, "shape.distance is NULL");
    if (as_collider) return PERI_OK; /* the bounds are for sampling only */
    low[0] = (double)s->lower.x;
    low[1] = (double)s->lower.y;
    low[2] = (double)s->lower.z;
    high[0] = (double)s->upper.x;
    high[1] = (double)s->upper.y;
    high[2] = (double)s->upper.z;
    for (i = 0; i < 3; i++)
        if (!peri__finite(low[i]) || !peri__finite(high[i]) || !(low[i] < high[i]))
            return peri__fail(err, PERI_ERROR_VALUE,
                              "shape.lower.%c is %g and shape.upper.%c is %g; both must be finite, lower below upper",
                              'x' + i, low[i], 'x' + i, high[i]);
    return PERI_OK;
}

/* Refuses what cannot be a collider (as_collider 1) or be sampled (0). */
static peri_result peri__shape_check(const peri_shape *s, int as_collider, peri_error *err) {
    peri_result r = PERI_OK;
    if (!s) return peri__fail(err, PERI_ERROR_ARGUMENT, "shape is NULL");
    switch (s->kind) {
    case PERI_SHAPE_NONE:
        if (as_collider) return PERI_OK;
        return peri__fail(err, PERI_ERROR_ARGUMENT, "shape is none: there is nothing to sample");
    case PERI_SHAPE_PLANE:
        if (as_collider) return PERI_OK;
        return peri__fail(err, PERI_ERROR_ARGUMENT, "shape is a plane, which has no bounds to sample; take a box");
    case PERI_SHAPE_BOX:
        r = peri__shape_length("half.x", s->half.x, 0, err);
        if (!r) r = peri__shape_length("half.y", s->half.y, 0, err);
        if (!r) r = peri__shape_length("half.z", s->half.z, 0, err);
        return r;
    case PERI_SHAPE_BALL: return peri__shape_length("radius", s->radius, 0, err);
    case PERI_SHAPE_CYLINDER: /* a capsule of half_length 0 is a ball, a cylinder would be flat */
    case PERI_SHAPE_CAPSULE:
        r = peri__shape_length("radius", s->radius, 0, err);
        if (!r) r = peri__shape_length("half_length", s->half_length, s->kind == PERI_SHAPE_CAPSULE, err);
        return r;
    case PERI_SHAPE_MESH:
        if (!as_collider) return peri__shape_check_mesh(s, err);
        return peri__fail(err, PERI_ERROR_ARGUMENT,
                          "shape is a mesh, which cannot be a collider; give its signed distance by "
                          "peri_shape_distance instead");
    case PERI_SHAPE_DISTANCE: return peri__shape_check_distance(s, as_collider, err);
    default: return peri__fail(err, PERI_ERROR_ARGUMENT, "shape.kind is %d, which is no shape", (int)s->kind);
    }
}

/* ---- sampling ---------------------------------------------------------------------------------------------------- */
#ifndef PERI_NO_SAMPLING

/* Cell centres: n[a] of them along axis a, d apart, symmetric about middle[a]. */
typedef struct peri__lattice {
    double middle[3], d;
    int n[3];
} peri__lattice;

static double peri__lattice_at(const peri__lattice *l, int axis, int i) {
    return l->middle[axis] + (i - 0.5 * (l->n[axis] - 1)) * l->d;
}

/* Number of centres below x along an axis. The guess may be one off by rounding; the comparisons make it exact. */
static int peri__lattice_below(const peri__lattice *l, int axis, double x) {
    double guess = floor((x - l->middle[axis]) / l->d + 0.5 * (l->n[axis] - 1));
    int n = l->n[axis], i = 0;
    if (guess >= n) i = n;
    else if (guess > 0) i = (int)guess;
    while (i > 0 && peri__lattice_at(l, axis, i - 1) >= x) i--;
    while (i < n && peri__lattice_at(l, axis, i) < x) i++;
    return i;
}

/* round(L/d) cells along each axis. No margin is needed: the next centre beyond either end would be at least d/4
   outside the bounds, since (n + 1) d / 2 >= L/2 + d/4; and no centre is outside, since (n - 1) d / 2 <= L/2 - d/4. */
static peri_result peri__lattice_make(const double lower[3], const double upper[3], double d, peri__lattice *l,
                                      peri_error *err) {
    double n, cells = 1;
    int a, fits = 1;
    l->d = d;
    for (a = 0; a < 3; a++) {
        l->middle[a] = 0.5 * lower[a] + 0.5 * upper[a];
        n = floor((upper[a] - lower[a]) / d + 0.5);
        if (!(n > 1)) n = 1;
        cells *= n;
        if (n <= 2147483647.0) l->n[a] = (int)n;
        else fits = 0;
    }
    if (fits && cells <= 1099511627776.0) return PERI_OK;
    return peri__fail(err, PERI_ERROR_LIMIT, "spacing %g m asks for a lattice of %.3g cells, the limit is 2^40; "
                      "take a larger one", d, cells);
}

/* What was found so far. Everything is counted, what fits is written. */
typedef struct peri__sample {
    peri_real *points;
    int capacity, count;
} peri__sample;

/* Takes one point; 0 when int cannot count it. */
static int peri__sample_take(peri__sample *out, peri_vec3 p) {
    if (out->count == 2147483647) return 0;
    if (out->points && out->count < out->capacity) {
        peri_real *to = out->points + 3 * (size_t)out->count;
        to[0] = p.x;
        to[1] = p.y;
        to[2] = p.z;
    }
    out->count++;
    return 1;
}

static peri_result peri__sample_full(double d, peri_error *err) {
    return peri__fail(err, PERI_ERROR_LIMIT, "spacing %g m gives 2^31 points or more; take a larger one", d);
}

static peri_vec3 peri__lattice_point(const peri__lattice *l, int i, int j, int k) {
    peri_vec3 p;
    p.x = (peri_real)peri__lattice_at(l, 0, i);
    p.y = (peri_real)peri__lattice_at(l, 1, j);
    p.z = (peri_real)peri__lattice_at(l, 2, k);
    return p;
}

static void peri__shape_bounds(const peri_shape *s, double lower[3], double upper[3]) {
    double r = (double)s->radius, h = (double)s->half_length;
    int a;
    upper[0] = upper[1] = upper[2] = r;
    if (s->kind == PERI_SHAPE_CYLINDER) upper[2] = h;
    if (s->kind == PERI_SHAPE_CAPSULE) upper[2] = h + r;
    if (s->kind == PERI_SHAPE_BOX) {
        upper[0] = (double)s->half.x;
        upper[1] = (double)s->half.y;
        upper[2] = (double)s->half.z;
    }
    for (a = 0; a < 3; a++) lower[a] = -upper[a];
    if (s->kind != PERI_SHAPE_DISTANCE) return;
    lower[0] = (double)s->lower.x;
    lower[1] = (double)s->lower.y;
    lower[2] = (double)s->lower.z;
    upper[0] = (double)s->upper.x;
    upper[1] = (double)s->upper.y;
    upper[2] = (double)s->upper.z;
}

/* Cells of every shape that has a signed distance. */
static peri_result peri__sample_distance(const peri_shape *s, const peri__lattice *l, peri__sample *out,
                                         peri_error *err) {
    int i, j, k;
    for (k = 0; k < l->n[2]; k++)
        for (j = 0; j < l->n[1]; j++)
            for (i = 0; i < l->n[0]; i++) {
                peri_vec3 p = peri__lattice_point(l, i, j, k);
                peri_real distance = peri_shape_evaluate(s, p, NULL);
                if (!peri__finite((double)distance))
                    return peri__fail(err, PERI_ERROR_VALUE, "the signed distance at (%g, %g, %g) is %g", (double)p.x,
                                      (double)p.y, (double)p.z, (double)distance);
                if (distance < 0 && !peri__sample_take(out, p)) return peri__sample_full(l->d, err);
            }
    return PERI_OK;
}

/* A mesh being sampled. Its int arrays lie in one block. */
typedef struct peri__mesh {
    const peri_shape *shape;
    double lower[3], upper[3], diagonal;    /* of the vertices that triangles use */
    int vertices, edges;                    /* directed edges: e = 3 t + c runs from corner c of triangle t */
    int turned;                             /* 1, or -1 for an inside-out mesh: its volume comes out negative */
    int *weld;                              /* [vertices] the vertex that stands for all at the same place, or -1 */
    int *link;                              /* [vertices] chains of `table`, then the parents of groups */
    int *list;                              /* [vertices] vertices on holes, sorted by group */
    int *count;                             /* [vertices + 1] for counting sort */
    int *order[2];                          /* [edges] edges in sorted order */
    int *table;                             /* [table_mask + 1] first vertices of the weld's hash cells, or -1 */
    unsigned table_mask;
    void *block;
    size_t bytes;
} peri__mesh;

/* Corner c (0, 1, 2) of triangle t: the welded vertex, and its place in p. */
static int peri__mesh_corner(const peri__mesh *m, int t, int c, double p[3]) {
    int v = m->weld[m->shape->triangles[3 * (size_t)t + (size_t)c]];
    const peri_real *from = m->shape->vertices + 3 * (size_t)v;
    p[0] = (double)from[0];
    p[1] = (double)from[1];
    p[2] = (double)from[2];
    return v;
}

static void peri__mesh_place(const peri__mesh *m, int vertex, double p[3]) {
    const peri_real *from = m->shape->vertices + 3 * (size_t)vertex;
    p[0] = (double)from[0];
    p[1] = (double)from[1];
    p[2] = (double)from[2];
}

static peri_result peri__mesh_bounds(peri__mesh *m, peri_error *err) {
    double p[3], sum = 0;
    int a, e;
    for (e = 0; e < m->edges; e++) {
        peri__mesh_place(m, m->shape->triangles[e], p);
        for (a = 0; a < 3; a++) {
            if (e == 0 || p[a] < m->lower[a]) m->lower[a] = p[a];
            if (e == 0 || p[a] > m->upper[a]) m->upper[a] = p[a];
        }
    }
    for (a = 0; a < 3; a++) sum += (m->upper[a] - m->lower[a]) * (m->upper[a] - m->lower[a]);
    m->diagonal = sqrt(sum);
    if (m->diagonal >= 1e-30 && m->diagonal <= 1e30) return PERI_OK; /* squares and cubes stay in range */
    return peri__fail(err, PERI_ERROR_VALUE, "the mesh is %g m in size; 1e-30 to 1e30 are handled", m->diagonal);
}

/* The block: five arrays by vertex (one is longer by one), two by edge, the hash table. */
static peri_result peri__mesh_allocate(peri__mesh *m, const peri_allocator *memory, peri_error *err) {
    size_t v = (size_t)m->vertices, e = (size_t)m->edges, table = 16, ints;
    int *at;
    while (table < v && table < ((size_t)1 << 30)) table *= 2;
    m->table_mask = (unsigned)(table - 1);
    ints = 4 * v + 1 + 2 * e + table;
    if (4.0 * (double)v + 2.0 * (double)e + (double)table + 1 > (double)(SIZE_MAX / 8) ||
        !peri__mul_size(ints, sizeof(int), &m->bytes))
        return peri__fail(err, PERI_ERROR_LIMIT, "a mesh of %d vertices and %d triangles is beyond the address space",
                          m->vertices, m->edges / 3);
    m->block = peri__resize(memory, NULL, 0, m->bytes);
    if (!m->block)
        return peri__fail(err, PERI_ERROR_MEMORY, "no memory for sampling a mesh of %d triangles (%.0f bytes)",
                          m->edges / 3, (double)m->bytes);
    at = (int *)m->block;
    m->weld = at;
    m->link = m->weld + v;
    m->list = m->link + v;
    m->count = m->list + v;
    m->order[0] = m->count + v + 1;
    m->order[1] = m->order[0] + e;
    m->table = m->order[1] + e;
    return PERI_OK;
}

static unsigned peri__mesh_hash(const peri__mesh *m, int i, int j, int k) {
    uint64_t h = (uint64_t)i * 0x9E3779B97F4A7C15u + (uint64_t)j * 0xC2B2AE3D27D4EB4Fu +
                 (uint64_t)k * 0x165667B19E3779F9u;
    h ^= h >> 29;
    h *= 0xBF58476D1CE4E5B9u; /* finaliser of splitmix64 (Steele, Lea and Flood 2014) */
    return (unsigned)(h >> 32) & m->table_mask;
}

/* The vertex within `reach` that stands for vertex v, or v itself, which is then entered into its hash cell. Cells are
   four reaches wide: one cell holds only so many standing vertices, which bounds the cost whatever the mesh. */
static int peri__mesh_weld_vertex(peri__mesh *m, int v, double reach) {
    double p[3], q[3], cell = 4 * reach;
    int low[3], high[3], a, i, j, k, w;
    unsigned h;
    peri__mesh_place(m, v, p);
    for (a = 0; a < 3; a++) {
        low[a] = (int)floor((p[a] - m->lower[a] - reach) / cell);
        high[a] = (int)floor((p[a] - m->lower[a] + reach) / cell);
    }
    for (k = low[2]; k <= high[2]; k++)
        for (j = low[1]; j <= high[1]; j++)
            for (i = low[0]; i <= high[0]; i++)
                for (w = m->table[peri__mesh_hash(m, i, j, k)]; w >= 0; w = m->link[w]) {
                    peri__mesh_place(m, w, q);
                    for (a = 0; a < 3; a++) q[a] -= p[a];
                    if (q[0] * q[0] + q[1] * q[1] + q[2] * q[2] <= reach * reach) return w;
                }
    for (a = 0; a < 3; a++) low[a] = (int)floor((p[a] - m->lower[a]) / cell);
    h = peri__mesh_hash(m, low[0], low[1], low[2]);
    m->link[v] = m->table[h];
    m->table[h] = v;
    return v;
}

/* Joins coincident vertices (within 1e-6 of the diagonal), as exporters split them along seams, and finds out by the
   sign of the volume whether the mesh is inside out. */
static void peri__mesh_weld(peri__mesh *m) {
    double p[3][3], middle[3], volume = 0;
    size_t i;
    int e, t, c, a;
    for (i = 0; i <= m->table_mask; i++) m->table[i] = -1;
    for (e = 0; e < m->vertices; e++) m->weld[e] = -1;
    for (e = 0; e < m->edges; e++) {
        int v = m->shape->triangles[e];
        if (m->weld[v] < 0) m->weld[v] = peri__mesh_weld_vertex(m, v, 1e-6 * m->diagonal);
    }
    for (a = 0; a < 3; a++) middle[a] = 0.5 * m->lower[a] + 0.5 * m->upper[a];
    for (t = 0; t < m->edges / 3; t++) {
        for (c = 0; c < 3; c++) {
            (void)peri__mesh_corner(m, t, c, p[c]);
            for (a = 0; a < 3; a++) p[c][a] -= middle[a];
        }
        volume += p[0][0] * (p[1][1] * p[2][2] - p[1][2] * p[2][1]) +
                  p[0][1] * (p[1][2] * p[2][0] - p[1][0] * p[2][2]) +
                  p[0][2] * (p[1][0] * p[2][1] - p[1][1] * p[2][0]);
    }
    m->turned = volume < 0 ? -1 : 1;
}

/* Ends of directed edge e, the smaller first; 1 when it runs from the smaller, -1 from the larger, 0 for a point. */
static int peri__mesh_edge(const peri__mesh *m, int e, int *low, int *high) {
    int a = m->weld[m->shape->triangles[e]];
    int b = m->weld[m->shape->triangles[e % 3 == 2 ? e - 2 : e + 1]];
    *low = a < b ? a : b;
    *high = a < b ? b : a;
    return (a < b) - (a > b);
}

/* Stable counting sort of the edges by one of their ends. from NULL: edges as they are numbered. */
static void peri__mesh_sort(peri__mesh *m, const int *from, int *to, int by_high) {
    int pass, i, e, v, end[2];
    for (v = 0; v <= m->vertices; v++) m->count[v] = 0;
    for (pass = 0; pass < 2; pass++) {
        for (i = 0; i < m->edges; i++) {
            e = from ? from[i] : i;
            (void)peri__mesh_edge(m, e, &end[0], &end[1]);
            v = end[by_high];
            if (pass) to[m->count[v]++] = e;
            else m->count[v + 1]++;
        }
        if (pass == 0)
            for (v = 0; v < m->vertices; v++) m->count[v + 1] += m->count[v];
    }
}

/* Representative of the group of v, halving the path on the way. */
static int peri__mesh_root(int *parent, int v) {
    while (parent[v] != v) {
        parent[v] = parent[parent[v]];
        v = parent[v];
    }
    return v;
}

/* Groups the vertices of all edges that are not used equally often in both directions (link: parents, or -1 for a
   vertex on no such edge), and lists them by group, in the order of their roots: that of root g ends before
   list[count[g]]. */
static void peri__mesh_open_edges(peri__mesh *m) {
    int i, next, e, low, high, l, h, net, v;
    for (v = 0; v < m->vertices; v++) m->link[v] = -1;
    peri__mesh_sort(m, NULL, m->order[0], 1);
    peri__mesh_sort(m, m->order[0], m->order[1], 0);
    for (i = 0; i < m->edges; i = next) {
        e = m->order[1][i];
        net = peri__mesh_edge(m, e, &low, &high);
        for (next = i + 1; next < m->edges; next++) {
            int sign = peri__mesh_edge(m, m->order[1][next], &l, &h);
            if (l != low || h != high) break;
            net += sign;
        }
        if (net == 0) continue;
        if (m->link[low] < 0) m->link[low] = low;
        if (m->link[high] < 0) m->link[high] = high;
        low = peri__mesh_root(m->link, low);
        high = peri__mesh_root(m->link, high);
        if (low < high) m->link[high] = low;
        else m->link[low] = high;
    }
    for (v = 0; v <= m->vertices; v++) m->count[v] = 0;
    for (v = 0; v < m->vertices; v++)
        if (m->link[v] >= 0) m->count[peri__mesh_root(m->link, v) + 1]++;
    for (v = 0; v < m->vertices; v++) m->count[v + 1] += m->count[v];
    for (v = 0; v < m->vertices; v++)
        if (m->link[v] >= 0) m->list[m->count[peri__mesh_root(m->link, v)]++] = v;
}

/* The vertex of list[0 .. n) furthest from p (axis NULL) or from the line through p along the unit vector axis; delta:
   its difference from p, or from the nearest point of the line. Returns the distance. */
static double peri__mesh_furthest(const peri__mesh *m, const int *list, int n, const double p[3], const double *axis,
                                  double delta[3]) {
    double q[3], along, square, best = -1;
    int i, a;
    for (i = 0; i < n; i++) {
        peri__mesh_place(m, list[i], q);
        for (a = 0; a < 3; a++) q[a] -= p[a];
        along = axis ? q[0] * axis[0] + q[1] * axis[1] + q[2] * axis[2] : 0;
        for (a = 0; a < 3; a++) q[a] -= axis ? along * axis[a] : 0;
        square = q[0] * q[0] + q[1] * q[1] + q[2] * q[2];
        if (square <= best) continue;
        best = square;
        for (a = 0; a < 3; a++) delta[a] = q[a];
    }
    return sqrt(best);
}

/* Width and middle of a hole with the given vertices: its extent across its longest chord. A long slit (a T-junction,
   a missing strip) is thus as narrow as it is: it spoils few of the lines through it. */
static double peri__mesh_width(const peri__mesh *m, const int *list, int n, double middle[3]) {
    double p[3], q[3], chord[3], across[3] = {0, 0, 0}, length, side, low = 0, high = 0;
    double lower[3] = {0, 0, 0}, upper[3] = {0, 0, 0};
    int i, a;
    for (i = 0; i < n; i++) {
        peri__mesh_place(m, list[i], q);
        for (a = 0; a < 3; a++) {
            if (i == 0 || q[a] < lower[a]) lower[a] = q[a];
            if (i == 0 || q[a] > upper[a]) upper[a] = q[a];
        }
    }
    for (a = 0; a < 3; a++) middle[a] = 0.5 * lower[a] + 0.5 * upper[a];
    peri__mesh_place(m, list[0], p);
    (void)peri__mesh_furthest(m, list, n, p, NULL, chord); /* one end of (nearly) the longest chord ... */
    for (a = 0; a < 3; a++) p[a] += chord[a];
    length = peri__mesh_furthest(m, list, n, p, NULL, chord); /* ... and the chord itself */
    if (!(length > 0)) return 0;
    for (a = 0; a < 3; a++) chord[a] /= length;
    side = peri__mesh_furthest(m, list, n, p, chord, across);
    if (!(side > 0)) return 0;
    for (i = 0; i < n; i++) {
        peri__mesh_place(m, list[i], q);
        for (length = 0, a = 0; a < 3; a++) length += (q[a] - p[a]) * across[a] / side;
        if (length < low) low = length;
        if (length > high) high = length;
    }
    return high - low;
}

/* Refuses a mesh whose widest hole is wider than a tenth of its diagonal. */
static peri_result peri__mesh_holes(peri__mesh *m, peri_error *err) {
    double middle[3], place[3] = {0, 0, 0}, width, widest = 0;
    int g, a, n, begin = 0;
    peri__mesh_open_edges(m);
    for (g = 0; g < m->vertices; g++) {
        n = m->count[g] - begin;
        if (n == 0) continue;
        width = peri__mesh_width(m, m->list + begin, n, middle);
        begin += n;
        if (width <= widest) continue;
        widest = width;
        for (a = 0; a < 3; a++) place[a] = middle[a];
    }
    if (widest <= 0.1 * m->diagonal) return PERI_OK;
    return peri__fail(err, PERI_ERROR_GEOMETRY,
                      "the mesh has a hole %.3g m wide at (%.3g, %.3g, %.3g), more than a tenth of its size: close it, "
                      "or turn round the triangles that face the wrong way there", widest, place[0], place[1],
                      place[2]);
}

/* Where the edge between welded vertices a and b crosses the row at height y of axis v: coordinates along u and along
   the line's own axis. Always computed from the vertex with the smaller number, so that both triangles of an edge get
   the same bits: a row then leaves one triangle exactly where it enters the next. */
static void peri__mesh_cross(int a, int b, const double *pa, const double *pb, int u, int v, int axis, double y,
                             double out[2]) {
    const double *p = a < b ? pa : pb, *q = a < b ? pb : pa;
    double s = (y - p[v]) / (q[v] - p[v]);
    out[0] = p[u] + s * (q[u] - p[u]);
    out[1] = p[axis] + s * (q[axis] - p[axis]);
}

/* Marks the crossings of triangle t with the lattice lines along an axis. Lines are found row by row, half open: a line
   at u belongs to a triangle when one edge crosses its row at or below u and the other above. As every edge adds to one
   triangle what it takes from its neighbour, the signs along any line of a closed mesh sum to zero whatever the
   rounding. A crossing of sign s counts s for the cells before it (seen from the far end) and -s for those after it
   (seen from the near end): mark holds the differences along the line. */
static void peri__mesh_trace(const peri__mesh *m, const peri__lattice *l, int axis, int t, int32_t *mark) {
    double p[3][3], edge[2][2], y, s, height;
    int id[3], u = (axis + 1) % 3, v = (axis + 2) % 3, c, i, j, k, from, to, end, sign, low = 0, high = 0;
    size_t stride[3], at;
    stride[0] = 1;
    stride[1] = (size_t)l->n[0];
    stride[2] = (size_t)l->n[0] * (size_t)l->n[1];
    for (c = 0; c < 3; c++) {
        id[c] = peri__mesh_corner(m, t, c, p[c]);
        if (p[c][v] < p[low][v]) low = c;
        if (p[c][v] > p[high][v]) high = c;
    }
    end = peri__lattice_below(l, v, p[high][v]);
    for (j = peri__lattice_below(l, v, p[low][v]); j < end; j++) {
        y = peri__lattice_at(l, v, j);
        edge[0][0] = edge[0][1] = edge[1][0] = edge[1][1] = 0;
        for (c = 0; c < 3; c++) { /* of three edges one rises through the row and one falls */
            int b = c == 2 ? 0 : c + 1, rises = p[b][v] > y;
            if ((p[c][v] > y) != rises) peri__mesh_cross(id[c], id[b], p[c], p[b], u, v, axis, y, edge[rises]);
        }
        from = peri__lattice_below(l, u, edge[0][0]);
        to = peri__lattice_below(l, u, edge[1][0]);
        sign = 1;
        if (from > to) { /* seen from behind */
            i = from;
            from = to;
            to = i;
            sign = -1;
        }
        for (i = from; i < to; i++) {
            s = (peri__lattice_at(l, u, i) - edge[0][0]) / (edge[1][0] - edge[0][0]);
            s = s > 0 ? (s < 1 ? s : 1) : 0;
            height = edge[0][1] + s * (edge[1][1] - edge[0][1]);
            k = peri__lattice_below(l, axis, height);
            at = (size_t)i * stride[u] + (size_t)j * stride[v];
            mark[at] += sign;
            if (k < l->n[axis]) mark[at + (size_t)k * stride[axis]] -= 2 * sign;
        }
    }
}

/* sum[cell] = six times the winding number, seen along both directions of the three axes. mark: scratch. */
static void peri__mesh_wind(const peri__mesh *m, const peri__lattice *l, int32_t *sum, int32_t *mark) {
    size_t cells = (size_t)l->n[0] * (size_t)l->n[1] * (size_t)l->n[2], stride = 1, i;
    int axis, t;
    memset(sum, 0, cells * sizeof *sum);
    for (axis = 0; axis < 3; axis++) {
        size_t length = stride * (size_t)l->n[axis]; /* cells between the beginnings of neighbouring planes of lines */
        size_t place = 0;
        memset(mark, 0, cells * sizeof *mark);
        for (t = 0; t < m->edges / 3; t++) peri__mesh_trace(m, l, axis, t, mark);
        for (i = 0; i < cells; i++) {
            if (place >= stride) mark[i] += mark[i - stride];
            sum[i] += mark[i];
            if (++place == length) place = 0;
        }
        stride = length;
    }
}

/* Takes the cells where the winding number is above one half: sum > 3. */
static peri_result peri__mesh_fill(const peri__mesh *m, const peri__lattice *l, peri__sample *out,
                                   const peri_allocator *memory, peri_error *err) {
    size_t cells, bytes, at = 0;
    int32_t *sum;
    int i, j, k;
    peri_result r = PERI_OK;
    if (!peri__mul_size((size_t)l->n[0], (size_t)l->n[1], &cells) || !peri__mul_size(cells, (size_t)l->n[2], &cells) ||
        !peri__mul_size(cells, 2 * sizeof(int32_t), &bytes))
        return peri__fail(err, PERI_ERROR_LIMIT, "spacing %g m asks for a lattice of %d x %d x %d cells, beyond the "
                          "address space; take a larger one", l->d, l->n[0], l->n[1], l->n[2]);
    sum = (int32_t *)peri__resize(memory, NULL, 0, bytes);
    if (!sum)
        return peri__fail(err, PERI_ERROR_MEMORY, "no memory for a lattice of %d x %d x %d cells (%.0f bytes)",
                          l->n[0], l->n[1], l->n[2], (double)bytes);
    peri__mesh_wind(m, l, sum, sum + cells);
    for (k = 0; k < l->n[2]; k++)
        for (j = 0; j < l->n[1]; j++)
            for (i = 0; i < l->n[0]; i++, at++)
                if (!r && sum[at] * m->turned > 3 && !peri__sample_take(out, peri__lattice_point(l, i, j, k)))
                    r = peri__sample_full(l->d, err);
    (void)peri__resize(memory, sum, bytes, 0);
    return r;
}

static peri_result peri__sample_mesh(const peri_shape *s, double d, peri__lattice *l, peri__sample *out,
                                     const peri_allocator *memory, peri_error *err) {
    peri__mesh m;
    peri_result r;
    memset(&m, 0, sizeof m);
    m.shape = s;
    m.vertices = s->vertex_count;
    m.edges = 3 * s->triangle_count;
    r = peri__mesh_bounds(&m, err);
    if (!r) r = peri__lattice_make(m.lower, m.upper, d, l, err);
    if (!r) r = peri__mesh_allocate(&m, memory, err);
    if (r) return r;
    peri__mesh_weld(&m);
    r = peri__mesh_holes(&m, err);
    if (!r) r = peri__mesh_fill(&m, l, out, memory, err);
    (void)peri__resize(memory, m.block, m.bytes, 0);
    return r;
}

peri_result peri_sample_with(const peri_shape *shape, peri_real spacing, peri_real *points, int capacity,
                             int *count, const peri_allocator *memory, peri_error *err) {
    double lower[3], upper[3], d = (double)spacing;
    peri__lattice l;
    peri__sample out;
    peri_result r;
    if (!count) return peri__fail(err, PERI_ERROR_ARGUMENT, "count is NULL");
    *count = 0;
    r = peri__shape_check(shape, 0, err);
    if (r) return r;
    if (!peri__finite(d) || !(d > 0))
        return peri__fail(err, PERI_ERROR_VALUE, "spacing is %g m; it must be finite and above 0", d);
    if (points && capacity < 0)
        return peri__fail(err, PERI_ERROR_VALUE, "capacity is %d points; it must be at least 0", capacity);
    memset(&l, 0, sizeof l);
    out.points = points;
    out.capacity = capacity;
    out.count = 0;
    if (shape->kind == PERI_SHAPE_MESH) {
        r = peri__sample_mesh(shape, d, &l, &out, memory, err);
    } else {
        peri__shape_bounds(shape, lower, upper);
        r = peri__lattice_make(lower, upper, d, &l, err);
        if (!r) r = peri__sample_distance(shape, &l, &out, err);
    }
    if (r) return r;
    if (out.count == 0)
        return peri__fail(err, PERI_ERROR_GEOMETRY,
                          "spacing %g m is too coarse for the shape: none of %d x %d x %d lattice points is inside", d,
                          l.n[0], l.n[1], l.n[2]);
    *count = out.count;
    if (points && out.count > capacity)
        return peri__fail(err, PERI_ERROR_LIMIT, "capacity is %d points and %d are inside; count them first with "
                          "points NULL", capacity, out.count);
    return PERI_OK;
}

peri_result peri_sample(const peri_shape *shape, peri_real spacing, peri_real *points, int capacity,
                        int *count, peri_error *err) {
    return peri_sample_with(shape, spacing, points, capacity, count, NULL, err);
}

static peri_result peri__sample_length(const char *name, peri_real value, peri_error *err) {
    if (peri__finite((double)value) && value > 0) return PERI_OK;
    return peri__fail(err, PERI_ERROR_VALUE, "%s is %g m; it must be finite and above 0", name, (double)value);
}

peri_result peri_sample_rectangle(peri_real width, peri_real height, peri_real spacing, peri_real *points,
                                  int capacity, int *count, peri_error *err) {
    peri_shape slab;
    peri_result r;
    if (!count) return peri__fail(err, PERI_ERROR_ARGUMENT, "count is NULL");
    *count = 0;
    r = peri__sample_length("width", width, err);
    if (!r) r = peri__sample_length("height", height, err);
    if (!r) r = peri__sample_length("spacing", spacing, err);
    if (r) return r;
    slab = peri_shape_box(width / 2, height / 2, spacing / 2); /* one cell thick */
    return peri_sample(&slab, spacing, points, capacity, count, err);
}

/* Piece k of a polyline: from vertex k to the next, the first again after the last. Returns its length. */
static double peri__line_piece(const peri_real *vertices, int n, int k, double from[3], double to[3]) {
    size_t next = k + 1 < n ? (size_t)k + 1 : 0;
    double square = 0;
    int c;
    for (c = 0; c < 3; c++) {
        from[c] = (double)vertices[3 * (size_t)k + (size_t)c];
        to[c] = (double)vertices[3 * next + (size_t)c];
        square += (to[c] - from[c]) * (to[c] - from[c]);
    }
    return sqrt(square);
}

static peri_result peri__line_check(const peri_real *vertices, int vertex_count, int closed, peri_real spacing,
                                    double *total, peri_error *err) {
    double a[3], b[3];
    int k, least = closed ? 3 : 2;
    *total = 0;
    if (!vertices) return peri__fail(err, PERI_ERROR_ARGUMENT, "vertices is NULL");
    if (vertex_count < least)
        return peri__fail(err, PERI_ERROR_VALUE, "vertex_count is %d; %s line has at least %d", vertex_count,
                          closed ? "a closed" : "an open", least);
    for (k = 0; k < vertex_count; k++) {
        const peri_real *p = vertices + 3 * (size_t)k;
        if (!peri__finite((double)p[0]) || !peri__finite((double)p[1]) || !peri__finite((double)p[2]))
            return peri__fail(err, PERI_ERROR_VALUE, "vertex %d of the line is (%g, %g, %g); it must be finite", k,
                              (double)p[0], (double)p[1], (double)p[2]);
    }
    for (k = 0; k < vertex_count - !closed; k++) *total += peri__line_piece(vertices, vertex_count, k, a, b);
    if (!(*total > 0) || !(*total <= 1e30)) /* 1e-30 to 1e30, as for meshes, but squares lose all below 1e-160 */
        return peri__fail(err, PERI_ERROR_VALUE, "the line is %g m long; it must be above 0 and at most 1e30", *total);
    return peri__sample_length("spacing", spacing, err);
}

peri_result peri_sample_line(const peri_real *vertices, int vertex_count, int closed, peri_real spacing,
                             peri_real *points, int capacity, int *count, peri_real *step, peri_error *err) {
    double total, a[3], b[3], passed = 0, length, steps, along, share;
    int k, c, n, piece = 0, last = vertex_count - 1 - !closed;
    peri_result r;
    if (!count) return peri__fail(err, PERI_ERROR_ARGUMENT, "count is NULL");
    *count = 0;
    r = peri__line_check(vertices, vertex_count, closed, spacing, &total, err);
    if (r) return r;
    steps = floor(total / (double)spacing + 0.5);
    if (!(steps >= (closed ? 3 : 1)))
        return peri__fail(err, PERI_ERROR_GEOMETRY, "spacing %g m is too coarse for the line: its %g m take fewer than "
                          "%d steps", (double)spacing, total, closed ? 3 : 1);
    if (!(steps < 2147483647.0)) return peri__sample_full((double)spacing, err);
    if (points && capacity < 0)
        return peri__fail(err, PERI_ERROR_VALUE, "capacity is %d points; it must be at least 0", capacity);
    n = (int)steps + !closed;
    *count = n;
    if (points && n > capacity)
        return peri__fail(err, PERI_ERROR_LIMIT, "capacity is %d points and the line takes %d; count them first with "
                          "points NULL", capacity, n);
    if (step) *step = (peri_real)(total / steps);
    length = peri__line_piece(vertices, vertex_count, 0, a, b);
    for (k = 0; points && k < n; k++) {
        along = total * (k / steps);
        while (piece < last && along > passed + length) {
            passed += length;
            length = peri__line_piece(vertices, vertex_count, ++piece, a, b);
        }
        share = length > 0 ? (along - passed) / length : 0;
        if (k == n - 1 && !closed) share = 1; /* the end itself, whatever the rounding */
        share = share > 0 ? (share < 1 ? share : 1) : 0;
        for (c = 0; c < 3; c++) points[3 * (size_t)k + (size_t)c] = (peri_real)(a[c] + share * (b[c] - a[c]));
    }
    return PERI_OK;
}

/* ---- sampling of surfaces: points along the curves that must stay (borders, creases), then as many more as the area
   asks for, nowhere nearer than one radius (found by bisection: Poisson-disk sampling), then evened out by moving each
   to the middle of its share of the surface (Lloyd 1982). The surface is a dense set of pieces of triangles. All orders
   follow the triangles as given, never the numbers of vertices, so that seams change nothing. ---- */

#define PERI__SURFACE_FINE 4        /* pieces per spacing along the longest edge of a triangle */
#define PERI__SURFACE_ROUNDS 30     /* of evening out */
#define PERI__SURFACE_APART 0.85    /* spacings: nearer points push each other apart */
#define PERI__SURFACE_PIECES 1e8    /* most pieces: 4 GB, about three million points */
#define PERI__SURFACE_CLEAR 0.7     /* spacings: points on curves are not nearer to each other, if curves are */

typedef struct peri__scrap {
    double at[3], area;
    int triangle, owner;            /* owner: the nearest point */
} peri__scrap;

typedef struct peri__surface {
    peri__mesh *mesh;
    const peri_allocator *memory;
    peri__scrap *pieces;
    double *points, *sum;           /* [3 room]; [5 room]: area times place, area; after all: half ways */
    int *cell, *next;               /* [mask + 1] heads of the hash table, [room] chains of points */
    int piece_count, kept, count, room, held;   /* kept: edges; held: points on curves, which stay */
    double spacing, area, border;   /* border: length of the open borders */
    size_t bytes[5];                /* of the five arrays */
    unsigned mask;
} peri__surface;

static int peri__surface_cell(const peri__surface *s, int axis, double x) {
    double c = floor((x - s->mesh->lower[axis]) / s->spacing);
    return c < -1e9 ? -1000000000 : c > 1e9 ? 1000000000 : (int)c;
}

static unsigned peri__surface_hash(const peri__surface *s, int i, int j, int k) {
    uint64_t h = (uint64_t)i * 0x9E3779B97F4A7C15u + (uint64_t)j * 0xC2B2AE3D27D4EB4Fu +
                 (uint64_t)k * 0x165667B19E3779F9u;
    h ^= h >> 29;
    h *= 0xBF58476D1CE4E5B9u;
    return (unsigned)(h >> 32) & s->mask;
}

static void peri__surface_enter(peri__surface *s, int k) {
    const double *p = s->points + 3 * (size_t)k;
    unsigned h = peri__surface_hash(s, peri__surface_cell(s, 0, p[0]), peri__surface_cell(s, 1, p[1]),
                                    peri__surface_cell(s, 2, p[2]));
    s->next[k] = s->cell[h];
    s->cell[h] = k;
}

/* Only the first `count` points, all of them in the table. */
static void peri__surface_refill(peri__surface *s, int count) {
    unsigned h;
    int k;
    for (h = 0; h <= s->mask; h++) s->cell[h] = -1;
    for (k = 0; k < count; k++) peri__surface_enter(s, k);
    s->count = count;
}

static double peri__surface_square(const double *a, const double *b) {
    double x = a[0] - b[0], y = a[1] - b[1], z = a[2] - b[2];
    return x * x + y * y + z * z;
}

/* Looks through the cells within `radius` of p for a point (not `skip`) nearer than *square, or as near with a smaller
   number; best is the one to beat or -1. first: any will do. */
static int peri__surface_scan(const peri__surface *s, const double *p, double radius, int skip, int first, int best,
                              double *square) {
    int low[3], high[3], c, x, y, z, k;
    for (c = 0; c < 3; c++) {
        low[c] = peri__surface_cell(s, c, p[c] - radius);
        high[c] = peri__surface_cell(s, c, p[c] + radius);
    }
    for (z = low[2]; z <= high[2]; z++)
        for (y = low[1]; y <= high[1]; y++)
            for (x = low[0]; x <= high[0]; x++)
                for (k = s->cell[peri__surface_hash(s, x, y, z)]; k >= 0; k = s->next[k]) {
                    double d = peri__surface_square(s->points + 3 * (size_t)k, p);
                    if (k == skip || d > *square || (d >= *square && (best < 0 || k > best))) continue;
                    *square = d;
                    best = k;
                    if (first) return best;
                }
    return best;
}

/* The nearest point but `skip`, or -1 if there is none; ties go to the smaller number. guess: a point that may be near,
   or -1. */
static int peri__surface_nearest(const peri__surface *s, const double *p, int skip, int guess, double *distance) {
    double square = 1e300, radius = 0.75 * s->spacing;
    int best = -1, k;
    if (guess >= 0) {
        double d = peri__surface_square(s->points + 3 * (size_t)guess, p);
        if (d < 4 * s->spacing * s->spacing) {
            square = d;
            best = guess;
            radius = sqrt(d) * (1 + 1e-9);
        }
    }
    for (; radius <= 4 * s->spacing; radius *= 1.5) {
        best = peri__surface_scan(s, p, radius, skip, 0, best, &square);
        if (best >= 0 && square <= radius * radius) break;
    }
    if (radius > 4 * s->spacing) /* a speck far from everything */
        for (k = 0; k < s->count; k++) {
            double d = peri__surface_square(s->points + 3 * (size_t)k, p);
            if (k == skip || d >= square) continue;
            square = d;
            best = k;
        }
    *distance = best < 0 ? 0 : sqrt(square);
    return best;
}

/* Adds a point unless another one is nearer than `apart`. */
static void peri__surface_add(peri__surface *s, const double *p, double apart) {
    double square = apart * apart;
    if (s->count >= s->room || peri__surface_scan(s, p, apart, -1, 1, -1, &square) >= 0) return;
    memcpy(s->points + 3 * (size_t)s->count, p, 3 * sizeof *p);
    peri__surface_enter(s, s->count++);
}

/* Corners of triangle t and its normal n, twice its area long. Returns that length. */
static double peri__surface_normal(const peri__mesh *m, int t, double p[3][3], double n[3]) {
    double u[3], v[3];
    int c;
    for (c = 0; c < 3; c++) (void)peri__mesh_corner(m, t, c, p[c]);
    for (c = 0; c < 3; c++) {
        u[c] = p[1][c] - p[0][c];
        v[c] = p[2][c] - p[0][c];
    }
    n[0] = u[1] * v[2] - u[2] * v[1];
    n[1] = u[2] * v[0] - u[0] * v[2];
    n[2] = u[0] * v[1] - u[1] * v[0];
    return sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
}

/* Cuts triangle t into fine^2 pieces of its own shape. */
static void peri__surface_cut(peri__surface *s, int t, int fine) {
    double p[3][3], n[3], area = peri__surface_normal(s->mesh, t, p, n) / 2 / ((double)fine * fine);
    int i, j, c, up;
    for (i = 0; i < fine; i++)
        for (j = 0; j < fine - i; j++)
            for (up = 0; up < (j < fine - i - 1 ? 2 : 1); up++) {
                peri__scrap *piece = &s->pieces[s->piece_count++];
                double a = (i + (up ? 2 : 1) / 3.0) / fine, b = (j + (up ? 2 : 1) / 3.0) / fine;
                for (c = 0; c < 3; c++)
                    piece->at[c] = p[0][c] + a * (p[1][c] - p[0][c]) + b * (p[2][c] - p[0][c]);
                piece->area = area;
                piece->triangle = t;
                piece->owner = -1;
            }
}

/* Cuts all triangles; with pieces NULL only counts the pieces and sums the area. */
static peri_result peri__surface_pieces(peri__surface *s, peri_error *err) {
    double p[3][3], n[3], total = 0, fine, area, longest, edge;
    int t, c, triangles = s->mesh->edges / 3;
    s->piece_count = 0;
    s->area = 0;
    for (t = 0; t < triangles; t++) {
        area = peri__surface_normal(s->mesh, t, p, n) / 2;
        if (!(area > 0)) continue;
        longest = 0;
        for (c = 0; c < 3; c++) {
            edge = sqrt(peri__surface_square(p[c], p[c == 2 ? 0 : c + 1]));
            if (edge > longest) longest = edge;
        }
        fine = floor(longest / s->spacing * PERI__SURFACE_FINE) + 1;
        total += fine * fine;
        if (!(total <= PERI__SURFACE_PIECES))
            return peri__fail(err, PERI_ERROR_LIMIT, "spacing %g m is too fine for this mesh: up to triangle %d of %d "
                              "there are more than %g pieces of a %dth of it; take a larger one", s->spacing, t,
                              triangles, PERI__SURFACE_PIECES, PERI__SURFACE_FINE);
        s->area += area;
        if (s->pieces) peri__surface_cut(s, t, (int)fine);
    }
    if (!s->pieces) s->piece_count = (int)total;
    if (s->area > 0) return PERI_OK;
    return peri__fail(err, PERI_ERROR_GEOMETRY, "all %d triangles of the mesh are without area: there is no surface to "
                      "sample", triangles);
}

/* Nearest place of triangle t to p: in its plane, or on one of its edges. */
static void peri__surface_project(const peri__mesh *m, int t, double p[3]) {
    double q[3][3], n[3], e[3], w[3], at[3], best[3], least = -1, square, along, length, side;
    int c, k, inside = 1;
    length = peri__surface_normal(m, t, q, n);
    for (c = 0; c < 3; c++) n[c] /= length; /* no piece is of a triangle without area */
    along = (p[0] - q[0][0]) * n[0] + (p[1] - q[0][1]) * n[1] + (p[2] - q[0][2]) * n[2];
    for (c = 0; c < 3; c++) p[c] -= along * n[c];
    best[0] = best[1] = best[2] = 0;
    for (k = 0; k < 3; k++) {
        for (c = 0; c < 3; c++) {
            e[c] = q[k == 2 ? 0 : k + 1][c] - q[k][c];
            w[c] = p[c] - q[k][c];
        }
        side = n[0] * (e[1] * w[2] - e[2] * w[1]) + n[1] * (e[2] * w[0] - e[0] * w[2]) +
               n[2] * (e[0] * w[1] - e[1] * w[0]);
        if (side < 0) inside = 0;
        along = (e[0] * w[0] + e[1] * w[1] + e[2] * w[2]) / (e[0] * e[0] + e[1] * e[1] + e[2] * e[2]);
        along = along > 0 ? (along < 1 ? along : 1) : 0;
        for (c = 0; c < 3; c++) at[c] = q[k][c] + along * e[c];
        square = peri__surface_square(at, p);
        if (least >= 0 && square >= least) continue;
        least = square;
        memcpy(best, at, sizeof best);
    }
    if (!inside) memcpy(p, best, sizeof best);
}

/* Ends of directed edge e, in its own direction. */
static void peri__surface_ends(const peri__mesh *m, int e, int end[2]) {
    end[0] = m->weld[m->shape->triangles[e]];
    end[1] = m->weld[m->shape->triangles[e % 3 == 2 ? e - 2 : e + 1]];
}

/* 0 where the surface goes on across the edge that the `uses` directed edges at `edge` share; 1 a crease, where it
   turns by more than 40 degrees or more than two triangles meet; 2 a border. A triangle without area has no direction:
   it joins. *lowest: the smallest of those edges. */
static int peri__surface_kind(const peri__mesh *m, const int *edge, int uses, int *lowest) {
    double p[3][3], a[3], b[3], la, lb, cosine;
    int i, end[2], n = 0, found[2] = {0, 0}, low, high, same;
    for (i = 0; i < uses; i++) {
        int t = 3 * (edge[i] / 3), v[3], c;
        for (c = 0; c < 3; c++) v[c] = m->weld[m->shape->triangles[t + c]];
        if (v[0] == v[1] || v[1] == v[2] || v[2] == v[0]) continue; /* welded to a line: it was never there */
        if (n < 2) found[n] = edge[i];
        n++;
    }
    if (n == 0) return 0;
    *lowest = found[0];
    peri__surface_ends(m, found[0], end);
    if (end[0] == end[1]) return 0;
    if (n != 2) return n == 1 ? 2 : 1;
    la = peri__surface_normal(m, found[0] / 3, p, a);
    lb = peri__surface_normal(m, found[1] / 3, p, b);
    if (!(la > 0) || !(lb > 0)) return 0;
    cosine = (a[0] / la) * (b[0] / lb) + (a[1] / la) * (b[1] / lb) + (a[2] / la) * (b[2] / lb);
    same = peri__mesh_edge(m, found[0], &low, &high) == peri__mesh_edge(m, found[1], &low, &high);
    if (same) cosine = -cosine; /* one of them faces the other way */
    return cosine < 0.76604444311897804; /* of 40 degrees */
}

/* Kept edges, once each and ascending, into order[0]; the length of borders. order[1] is scratch. */
static void peri__surface_edges(peri__surface *s) {
    peri__mesh *m = s->mesh;
    double p[3], q[3];
    int i, next, low, high, l, h, kind, lowest, end[2];
    peri__mesh_sort(m, NULL, m->order[0], 1);
    peri__mesh_sort(m, m->order[0], m->order[1], 0);
    for (i = 0; i < m->edges; i++) m->order[0][i] = 0;
    for (i = 0; i < m->edges; i = next) {
        (void)peri__mesh_edge(m, m->order[1][i], &low, &high);
        for (next = i + 1; next < m->edges; next++) {
            (void)peri__mesh_edge(m, m->order[1][next], &l, &h);
            if (l != low || h != high) break;
        }
        lowest = m->order[1][i];
        kind = peri__surface_kind(m, m->order[1] + i, next - i, &lowest);
        m->order[0][lowest] = kind;
    }
    s->kept = 0;
    s->border = 0;
    for (i = 0; i < m->edges; i++) {
        kind = m->order[0][i];
        if (!kind) continue;
        m->order[0][s->kept++] = i; /* never ahead of i */
        peri__surface_ends(m, i, end);
        peri__mesh_place(m, end[0], p);
        peri__mesh_place(m, end[1], q);
        if (kind == 2) s->border += sqrt(peri__surface_square(p, q));
    }
}

/* The vertex at the other end of kept edge k. */
static int peri__surface_across(const peri__mesh *m, int k, int v) {
    int end[2];
    peri__surface_ends(m, m->order[0][k], end);
    return end[end[0] == v];
}

/* Finds the kept edges that meet at each vertex: link[v] is their number, list[v] and count[v] the first two. Corners,
   where not two meet or the curve turns by more than 40 degrees, get link[v] -1. */
static void peri__surface_corners(peri__surface *s) {
    peri__mesh *m = s->mesh;
    double p[3], a[3], b[3], la, lb, cosine;
    int k, c, v, side, end[2];
    for (v = 0; v < m->vertices; v++) m->link[v] = 0;
    for (k = 0; k < s->kept; k++) {
        peri__surface_ends(m, m->order[0][k], end);
        for (side = 0; side < 2; side++) {
            v = end[side];
            if (m->link[v] == 0) m->list[v] = k;
            else if (m->link[v] == 1) m->count[v] = k;
            m->link[v]++;
        }
    }
    for (v = 0; v < m->vertices; v++) {
        if (m->link[v] == 2) {
            peri__mesh_place(m, v, p);
            peri__mesh_place(m, peri__surface_across(m, m->list[v], v), a);
            peri__mesh_place(m, peri__surface_across(m, m->count[v], v), b);
            la = sqrt(peri__surface_square(a, p));
            lb = sqrt(peri__surface_square(b, p));
            for (cosine = 0, c = 0; c < 3; c++) cosine -= ((a[c] - p[c]) / la) * ((b[c] - p[c]) / lb);
            if (cosine >= 0.76604444311897804) continue;
        }
        if (m->link[v]) m->link[v] = -1;
    }
}

/* Walks the curve that begins with kept edge k at vertex v, up to a corner or back to v; marks its edges in order[1].
   Returns its length. step above 0: adds points at every multiple of it but the last, closed: from 0 on. */
static double peri__surface_walk(peri__surface *s, int k, int v, double step, int steps, int *closed) {
    peri__mesh *m = s->mesh;
    double p[3], q[3], at[3], length, passed = 0;
    int start = v, i = *closed ? 0 : 1, c;
    peri__mesh_place(m, v, p);
    for (;;) {
        m->order[1][k] = 1;
        v = peri__surface_across(m, k, v);
        peri__mesh_place(m, v, q);
        length = sqrt(peri__surface_square(p, q));
        for (; step > 0 && i < steps && i * step <= passed + length; i++) {
            double share = length > 0 ? (i * step - passed) / length : 0;
            for (c = 0; c < 3; c++) at[c] = p[c] + (share > 0 ? share : 0) * (q[c] - p[c]);
            peri__surface_add(s, at, PERI__SURFACE_CLEAR * s->spacing);
        }
        passed += length;
        if (v == start || m->link[v] < 0) break;
        k = m->list[v] == k ? m->count[v] : m->list[v];
        memcpy(p, q, sizeof p);
    }
    *closed = v == start && m->link[v] >= 0;
    return passed;
}

/* Points at the corners, then at equal steps along the curves between them, then along those without a corner. */
static void peri__surface_curves(peri__surface *s) {
    peri__mesh *m = s->mesh;
    double p[3], length, steps;
    int k, round, side, closed, end[2];
    peri__surface_corners(s);
    for (round = 0; round < 3; round++)
        for (k = 0; k < s->kept; k++) {
            if (round == 0) m->order[1][k] = 0;
            peri__surface_ends(m, m->order[0][k], end);
            for (side = 0; side < (round == 2 ? 1 : 2); side++) {
                if (round < 2 && m->link[end[side]] >= 0) continue;
                if (round == 0) {
                    peri__mesh_place(m, end[side], p);
                    peri__surface_add(s, p, PERI__SURFACE_CLEAR * s->spacing);
                    continue;
                }
                if (m->order[1][k]) continue;
                closed = 0;
                length = peri__surface_walk(s, k, end[side], 0, 0, &closed);
                steps = floor(length / s->spacing + 0.5);
                if (!(steps > 1)) steps = 1;
                (void)peri__surface_walk(s, k, end[side], length / steps, (int)steps, &closed);
            }
        }
    s->held = s->count;
}

/* Takes pieces where no point is nearer than `apart`, in an order that scatters them: every piece comes once, as the
   stride, about the golden section of their number, has no divisor in common with it. */
static void peri__surface_scatter(peri__surface *s, double apart) {
    uint64_t n = (uint64_t)s->piece_count, stride = (uint64_t)(0.6180339887498949 * (double)n), at = 0, k, a, b, r;
    for (a = 0; a != 1; stride++) /* Euclid */
        for (a = n, b = stride + 1; b; a = b, b = r) r = a % b;
    peri__surface_refill(s, s->held);
    for (k = 0; k < n && s->count < s->room; k++, at = (at + stride) % n)
        peri__surface_add(s, s->pieces[at].at, apart);
}

/* Gives every piece to its nearest point: that is the point it had, if it is nearer to it than half the way to that
   one's nearest neighbour. */
static void peri__surface_share(peri__surface *s) {
    double *half = s->sum + 4 * (size_t)s->room, d;
    int k, c, guess = -1;
    for (k = 0; k < s->count; k++)
        half[k] = peri__surface_nearest(s, s->points + 3 * (size_t)k, k, -1, &d) < 0 ? 1e150 : 0.499 * d;
    memset(s->sum, 0, 4 * (size_t)s->count * sizeof *s->sum);
    for (k = 0; k < s->piece_count; k++) {
        peri__scrap *piece = &s->pieces[k];
        double *sum;
        if (piece->owner >= 0) guess = piece->owner; /* of the last round */
        if (guess < 0 || peri__surface_square(piece->at, s->points + 3 * (size_t)guess) > half[guess] * half[guess])
            guess = peri__surface_nearest(s, piece->at, -1, guess, &d);
        piece->owner = guess;
        sum = s->sum + 4 * (size_t)guess;
        for (c = 0; c < 3; c++) sum[c] += piece->area * piece->at[c];
        sum[3] += piece->area;
    }
}

/* Moves `to`, where point k is to go, away from the points that k is too near to: half of what is missing, all of it
   where the other stays. The middle of a share knows nothing of the distance to the nearest neighbour. */
static void peri__surface_part(const peri__surface *s, int k, double to[3]) {
    const double *p = s->points + 3 * (size_t)k, reach = PERI__SURFACE_APART * s->spacing;
    int low[3], high[3], c, x, y, z, other;
    for (c = 0; c < 3; c++) {
        low[c] = peri__surface_cell(s, c, p[c] - reach);
        high[c] = peri__surface_cell(s, c, p[c] + reach);
    }
    for (z = low[2]; z <= high[2]; z++)
        for (y = low[1]; y <= high[1]; y++)
            for (x = low[0]; x <= high[0]; x++)
                for (other = s->cell[peri__surface_hash(s, x, y, z)]; other >= 0; other = s->next[other]) {
                    const double *q = s->points + 3 * (size_t)other;
                    double r = sqrt(peri__surface_square(p, q)), push = (reach - r) / (other < s->held ? 1 : 2);
                    if (other == k || !(push > 0) || !(r > 0) || peri__surface_cell(s, 0, q[0]) != x ||
                        peri__surface_cell(s, 1, q[1]) != y || peri__surface_cell(s, 2, q[2]) != z)
                        continue;
                    for (c = 0; c < 3; c++) to[c] += push * (p[c] - q[c]) / r;
                }
}

/* Moves every point that may move to the middle of its share, and apart from others, on the triangle of the piece that
   is nearest to it. `next` is scratch for that piece. */
static void peri__surface_even(peri__surface *s) {
    int k, c;
    peri__surface_share(s);
    for (k = 0; k < s->count; k++) {
        double *sum = s->sum + 4 * (size_t)k;
        for (c = 0; c < 3 && sum[3] > 0; c++) sum[c] /= sum[3];
        if (k >= s->held && sum[3] > 0) peri__surface_part(s, k, sum);
    }
    for (k = 0; k < s->count; k++) s->next[k] = -1;
    for (k = 0; k < s->piece_count; k++) {
        int owner = s->pieces[k].owner;
        const double *middle = s->sum + 4 * (size_t)owner;
        if (owner < s->held) continue;
        if (s->next[owner] < 0 || peri__surface_square(s->pieces[k].at, middle) <
                                      peri__surface_square(s->pieces[s->next[owner]].at, middle))
            s->next[owner] = k;
    }
    for (k = s->held; k < s->count; k++) {
        if (s->next[k] < 0) continue;
        memcpy(s->points + 3 * (size_t)k, s->sum + 4 * (size_t)k, 3 * sizeof(double));
        peri__surface_project(s->mesh, s->pieces[s->next[k]].triangle, s->points + 3 * (size_t)k);
    }
    peri__surface_refill(s, s->count);
}

/* count times size bytes, remembered as array number `which`; NULL if there are none. */
static void *peri__surface_take(peri__surface *s, int which, size_t count, size_t size) {
    void *p;
    if (!peri__mul_size(count, size, &s->bytes[which])) return NULL;
    p = peri__resize(s->memory, NULL, 0, s->bytes[which]);
    return p;
}

static void peri__surface_free(peri__surface *s) {
    if (s->pieces) (void)peri__resize(s->memory, s->pieces, s->bytes[0], 0);
    if (s->points) (void)peri__resize(s->memory, s->points, s->bytes[1], 0);
    if (s->sum) (void)peri__resize(s->memory, s->sum, s->bytes[2], 0);
    if (s->cell) (void)peri__resize(s->memory, s->cell, s->bytes[3], 0);
    if (s->next) (void)peri__resize(s->memory, s->next, s->bytes[4], 0);
}

/* Room for the points: no two in the interior are nearer than 0.4 spacings, and those on curves are at most two for
   each kept edge and one for each spacing. */
static peri_result peri__surface_allocate(peri__surface *s, double wanted, peri_error *err) {
    const peri__mesh *m = s->mesh;
    double p[3], q[3], room = 64 + 4 * wanted + 2.0 * s->kept;
    size_t cells = 64;
    int k, end[2];
    for (k = 0; k < s->kept; k++) {
        peri__surface_ends(m, m->order[0][k], end);
        peri__mesh_place(m, end[0], p);
        peri__mesh_place(m, end[1], q);
        room += sqrt(peri__surface_square(p, q)) / s->spacing;
    }
    if (room > 1e9) return peri__sample_full(s->spacing, err);
    s->room = (int)room;
    while (cells < (size_t)s->room) cells *= 2;
    s->mask = (unsigned)(cells - 1);
    s->pieces = (peri__scrap *)peri__surface_take(s, 0, (size_t)s->piece_count, sizeof *s->pieces);
    if (s->pieces) s->points = (double *)peri__surface_take(s, 1, (size_t)s->room, 3 * sizeof(double));
    if (s->points) s->sum = (double *)peri__surface_take(s, 2, (size_t)s->room, 5 * sizeof(double));
    if (s->sum) s->cell = (int *)peri__surface_take(s, 3, cells, sizeof(int));
    if (s->cell) s->next = (int *)peri__surface_take(s, 4, (size_t)s->room, sizeof(int));
    if (s->next) return PERI_OK;
    return peri__fail(err, PERI_ERROR_MEMORY, "no memory for sampling a surface of %d pieces (%.0f bytes)",
                      s->piece_count, (double)s->piece_count * (double)sizeof *s->pieces + 76.0 * s->room);
}

/* All points of the surface. A point inside stands for spacing^2, one on an open border for half of that. */
static peri_result peri__surface_make(peri__surface *s, peri_error *err) {
    double wanted, low = 0.4, high = 1, middle = 0;
    int round;
    peri_result bad = peri__surface_pieces(s, err);
    if (bad) return bad;
    peri__surface_edges(s);
    wanted = s->area / (s->spacing * s->spacing) + 0.5 * s->border / s->spacing;
    bad = peri__surface_allocate(s, wanted, err);
    if (bad) return bad;
    (void)peri__surface_pieces(s, err);
    peri__surface_refill(s, 0);
    peri__surface_curves(s);
    for (round = 0; round < 8; round++) { /* the radius that gives the wanted number */
        middle = 0.5 * (low + high);
        peri__surface_scatter(s, middle * s->spacing);
        if (s->count > wanted) low = middle;
        else high = middle;
    }
    for (round = 0; round < PERI__SURFACE_ROUNDS; round++) peri__surface_even(s);
    peri__surface_share(s);
    return PERI_OK;
}

static void peri__surface_report(const peri__surface *s, peri_sample_report *report) {
    int k;
    double d;
    memset(report, 0, sizeof *report);
    report->measure = s->area;
    for (k = 0; k < s->count && s->count > 1; k++) {
        (void)peri__surface_nearest(s, s->points + 3 * (size_t)k, k, -1, &d);
        if (k == 0 || d < report->least) report->least = d;
        if (d > report->most) report->most = d;
        report->mean += d / s->count;
    }
}

peri_result peri_sample_surface_with(const peri_shape *mesh, peri_real spacing, peri_real *points, peri_real *areas,
                                     int capacity, int *count, peri_sample_report *report,
                                     const peri_allocator *memory, peri_error *err) {
    peri__mesh m;
    peri__surface s;
    peri_result r;
    size_t k;
    if (!count) return peri__fail(err, PERI_ERROR_ARGUMENT, "count is NULL");
    *count = 0;
    if (mesh && mesh->kind != PERI_SHAPE_MESH)
        return peri__fail(err, PERI_ERROR_ARGUMENT, "the shape is no mesh (kind %d); make one by peri_shape_mesh",
                          (int)mesh->kind);
    r = peri__shape_check(mesh, 0, err);
    if (!r) r = peri__sample_length("spacing", spacing, err);
    if (r) return r;
    if (points && capacity < 0)
        return peri__fail(err, PERI_ERROR_VALUE, "capacity is %d points; it must be at least 0", capacity);
    memset(&m, 0, sizeof m);
    memset(&s, 0, sizeof s);
    m.shape = mesh;
    m.vertices = mesh->vertex_count;
    m.edges = 3 * mesh->triangle_count;
    r = peri__mesh_bounds(&m, err);
    if (!r) r = peri__mesh_allocate(&m, memory, err);
    if (r) return r;
    peri__mesh_weld(&m);
    s.mesh = &m;
    s.memory = memory;
    s.spacing = (double)spacing;
    r = peri__surface_make(&s, err);
    if (!r) *count = s.count;
    if (!r && points && s.count > capacity)
        r = peri__fail(err, PERI_ERROR_LIMIT, "capacity is %d points and the surface takes %d; count them first with "
                       "points NULL", capacity, s.count);
    if (!r && report) peri__surface_report(&s, report);
    for (k = 0; k < 3 * (size_t)s.count && points && !r; k++) points[k] = (peri_real)s.points[k];
    for (k = 0; k < (size_t)s.count && points && areas && !r; k++) areas[k] = (peri_real)s.sum[4 * k + 3];
    peri__surface_free(&s);
    (void)peri__resize(memory, m.block, m.bytes, 0);
    return r;
}

peri_result peri_sample_surface(const peri_shape *mesh, peri_real spacing, peri_real *points, peri_real *areas,
                                int capacity, int *count, peri_sample_report *report, peri_error *err) {
    return peri_sample_surface_with(mesh, spacing, points, areas, capacity, count, report, NULL, err);
}

#endif /* PERI_NO_SAMPLING */
/* ---- skins ------------------------------------------------------------------------------------------------------- */
#ifndef PERI_NO_SKINNING

#define PERI__SKIN_NEAR 12              /* particles that a vertex follows, at most */
#define PERI__SKIN_TRIANGLES (1 << 29)  /* most triangles: three corners each must be counted in an int */

/* A mesh bound to particles: x_v = sum_k w_k (x_k + F_k (X_v - X_k)), the particles' own affine motions blended. With
   sum w_k = 1 it is exact for affine motion. All arrays lie in one block. */
typedef struct peri__skin_data {
    int n, m, triangle_count;       /* particles, vertices */
    peri_real *blend;               /* [4 NEAR m] of each vertex and particle: w_k, w_k (X_v - X_k) */
    int *bound;                     /* [NEAR m] the particles, nearest first; unused places repeat it with weight 0 */
    int *triangles;                 /* [3 triangle_count] */
    int *first, *around;            /* [m + 1], [3 triangle_count]: triangles around each vertex, ascending */
    peri_real *area;                /* [3 triangle_count] scratch of the update: twice the area times the normal */
    void *block;
    size_t bytes;
} peri__skin_data;

/* Particles sorted by the hash of the grid cell they are in. Hashing keeps it O(n) for any layout. */
typedef struct peri__skin_grid {
    const peri_real *ref;
    double lower[3], d;
    unsigned mask;
    int *cell;                      /* [3 n] by particle */
    int *begin;                     /* [mask + 2] */
    int *sorted;                    /* [n] */
    void *block;
    size_t bytes;
} peri__skin_grid;

/* The nearest particles of a vertex, nearest first (ties: by number), one more than are used. */
typedef struct peri__skin_list {
    int n, id[PERI__SKIN_NEAR + 1];
    double r[PERI__SKIN_NEAR + 1];  /* first squared distances, then distances, in spacings */
} peri__skin_list;

/* Cell number along an axis: monotonic also where it is cut off, so that a range of cells misses nothing. */
static int peri__skin_cell(const peri__skin_grid *g, int axis, double x) {
    double c = floor((x - g->lower[axis]) / g->d);
    return c < -1e9 ? -1000000000 : c > 1e9 ? 1000000000 : (int)c;
}

static unsigned peri__skin_hash(const peri__skin_grid *g, int i, int j, int k) {
    uint64_t h = (uint64_t)i * 0x9E3779B97F4A7C15u + (uint64_t)j * 0xC2B2AE3D27D4EB4Fu +
                 (uint64_t)k * 0x165667B19E3779F9u;
    h ^= h >> 29;
    h *= 0xBF58476D1CE4E5B9u; /* finaliser of splitmix64 (Steele, Lea and Flood 2014) */
    return (unsigned)(h >> 32) & g->mask;
}

static peri_result peri__skin_grid_make(peri__skin_grid *g, const peri_real *ref, int n, double spacing,
                                        const peri_allocator *memory, peri_error *err) {
    size_t table = 16, count = (size_t)n;
    unsigned h;
    int i, a, pass;
    while (table < count && table < ((size_t)1 << 30)) table *= 2;
    if (4.0 * n + (double)table + 1 > (double)(SIZE_MAX / 8))
        return peri__fail(err, PERI_ERROR_LIMIT, "a grid of %d particles is beyond the address space", n);
    g->ref = ref;
    g->d = spacing;
    g->mask = (unsigned)(table - 1);
    g->bytes = (4 * count + table + 1) * sizeof(int);
    g->block = peri__resize(memory, NULL, 0, g->bytes);
    if (!g->block) return peri__fail(err, PERI_ERROR_MEMORY, "no memory for a grid of %d particles", n);
    g->cell = (int *)g->block;
    g->sorted = g->cell + 3 * count;
    g->begin = g->sorted + count;
    for (a = 0; a < 3; a++)
        for (i = 0; i < n; i++)
            if (i == 0 || (double)ref[3 * (size_t)i + (size_t)a] < g->lower[a])
                g->lower[a] = (double)ref[3 * (size_t)i + (size_t)a];
    memset(g->begin, 0, (table + 1) * sizeof(int));
    for (pass = 0; pass < 2; pass++) { /* counting sort; placing from behind leaves begin[h] at the cell's begin */
        for (i = pass ? n - 1 : 0; i >= 0 && i < n; i += pass ? -1 : 1) {
            int *c = g->cell + 3 * (size_t)i;
            if (!pass)
                for (a = 0; a < 3; a++) c[a] = peri__skin_cell(g, a, (double)ref[3 * (size_t)i + (size_t)a]);
            h = peri__skin_hash(g, c[0], c[1], c[2]);
            if (pass) g->sorted[--g->begin[h]] = i;
            else g->begin[h]++;
        }
        if (!pass)
            for (h = 0; h <= g->mask; h++) g->begin[h + 1] += g->begin[h];
    }
    return PERI_OK;
}

/* Squared distance in spacings. */
static double peri__skin_square(const peri_real *a, const peri_real *b, double spacing) {
    double x = ((double)a[0] - (double)b[0]) / spacing, y = ((double)a[1] - (double)b[1]) / spacing,
           z = ((double)a[2] - (double)b[2]) / spacing;
    return x * x + y * y + z * z;
}

static void peri__skin_insert(peri__skin_list *l, int id, double square) {
    int i = l->n;
    if (i > PERI__SKIN_NEAR) {
        i = PERI__SKIN_NEAR;
        if (square > l->r[i] || (square >= l->r[i] && id > l->id[i])) return;
    } else l->n++;
    for (; i > 0 && (square < l->r[i - 1] || (square <= l->r[i - 1] && id < l->id[i - 1])); i--) {
        l->r[i] = l->r[i - 1];
        l->id[i] = l->id[i - 1];
    }
    l->r[i] = square;
    l->id[i] = id;
}

/* The nearest particles within reach (in spacings) of the point x. */
static void peri__skin_search(const peri__skin_grid *g, const peri_real *x, double reach, peri__skin_list *l) {
    int low[3], high[3], a, i, j, k, s;
    l->n = 0;
    for (a = 0; a < 3; a++) {
        low[a] = peri__skin_cell(g, a, (double)x[a] - reach * g->d);
        high[a] = peri__skin_cell(g, a, (double)x[a] + reach * g->d);
    }
    for (k = low[2]; k <= high[2]; k++)
        for (j = low[1]; j <= high[1]; j++)
            for (i = low[0]; i <= high[0]; i++) {
                unsigned h = peri__skin_hash(g, i, j, k);
                for (s = g->begin[h]; s < g->begin[h + 1]; s++) {
                    int id = g->sorted[s];
                    const int *c = g->cell + 3 * (size_t)id;
                    double square;
                    if (c[0] != i || c[1] != j || c[2] != k) continue; /* another cell with the same hash */
                    square = peri__skin_square(x, g->ref + 3 * (size_t)id, g->d);
                    if (square <= reach * reach) peri__skin_insert(l, id, square);
                }
            }
    for (i = 0; i < l->n; i++) l->r[i] = sqrt(l->r[i]);
}

/* The radius at which weights vanish, in spacings. Not beyond the first particle that is left out, so that weights
   change smoothly from vertex to vertex; not a spacing beyond the nearest particle, so that a vertex follows its own
   limb and not the one opposite; but enough for four particles, if there are. */
static double peri__skin_radius(const peri__skin_list *l) {
    double radius = l->r[0] + 1, four = 1.05 * l->r[l->n > 4 ? 3 : l->n - 1];
    if (l->n > PERI__SKIN_NEAR && l->r[PERI__SKIN_NEAR] < radius) radius = l->r[PERI__SKIN_NEAR];
    return radius > four ? radius : four;
}

/* Binds vertex x: bound[k] and blend[4k] for all k < PERI__SKIN_NEAR. Returns 0 when no particle is within 4 spacings.
   The weight (1 - (r/radius)^2)^3 falls off quickly and smoothly. */
static int peri__skin_vertex(const peri__skin_grid *g, const peri_real *x, int *bound, peri_real *blend) {
    peri__skin_list l;
    double reach, radius = 0, weight[PERI__SKIN_NEAR], sum = 0, share;
    int k, a;
    for (reach = 2; reach < 7; reach += 2) { /* at most 6: all that a vertex 4 spacings away may need */
        peri__skin_search(g, x, reach, &l);
        radius = l.n > 0 ? peri__skin_radius(&l) : 6;
        if (l.n >= 4 && radius <= reach) break;
    }
    if (l.n == 0 || l.r[0] > 4) return 0;
    if (radius > 6) radius = 6;
    for (k = 0; k < PERI__SKIN_NEAR; k++) {
        share = k < l.n ? 1 - (l.r[k] / radius) * (l.r[k] / radius) : 0;
        weight[k] = share > 0 ? share * share * share : 0;
        sum += weight[k];
    }
    if (!(sum > 0)) weight[0] = sum = 1;
    for (k = 0; k < PERI__SKIN_NEAR; k++) {
        double w = weight[k] / sum;
        bound[k] = l.id[w > 0 ? k : 0];
        blend[4 * k] = (peri_real)w;
        for (a = 0; a < 3; a++)
            blend[4 * k + 1 + a] = (peri_real)(w * ((double)x[a] - (double)g->ref[3 * (size_t)bound[k] + (size_t)a]));
    }
    return 1;
}

static peri_result peri__skin_far(const peri__skin_grid *g, int n, const peri_real *x, int vertex, peri_error *err) {
    double square, best = -1;
    int i;
    for (i = 0; i < n; i++) {
        square = peri__skin_square(x, g->ref + 3 * (size_t)i, g->d);
        if (best < 0 || square < best) best = square;
    }
    return peri__fail(err, PERI_ERROR_GEOMETRY, "vertex %d at (%g, %g, %g) is %.3g m from the nearest particle; 4 "
                      "spacings (%.3g m) is the limit: give the mesh in the coordinates of the body's points", vertex,
                      (double)x[0], (double)x[1], (double)x[2], sqrt(best) * g->d, 4 * g->d);
}

static peri_result peri__skin_check(const peri_real *vertices, int m, const int *triangles, int count,
                                    peri_error *err) {
    int i;
    if (!vertices) return peri__fail(err, PERI_ERROR_ARGUMENT, "vertices is NULL");
    if (m < 1) return peri__fail(err, PERI_ERROR_VALUE, "vertex_count is %d; a skin has at least 1", m);
    if (count < 0) return peri__fail(err, PERI_ERROR_VALUE, "triangle_count is %d; it must be at least 0", count);
    if (count > PERI__SKIN_TRIANGLES)
        return peri__fail(err, PERI_ERROR_LIMIT, "triangle_count is %d; at most %d are handled", count,
                          PERI__SKIN_TRIANGLES);
    if (count > 0 && !triangles)
        return peri__fail(err, PERI_ERROR_ARGUMENT, "triangles is NULL and triangle_count is %d", count);
    for (i = 0; i < m; i++) {
        const peri_real *x = vertices + 3 * (size_t)i;
        if (!peri__finite((double)x[0]) || !peri__finite((double)x[1]) || !peri__finite((double)x[2]))
            return peri__fail(err, PERI_ERROR_VALUE, "vertex %d of the skin is (%g, %g, %g); it must be finite", i,
                              (double)x[0], (double)x[1], (double)x[2]);
    }
    for (i = 0; i < 3 * count; i++)
        if (triangles[i] < 0 || triangles[i] >= m)
            return peri__fail(err, PERI_ERROR_INDEX, "triangle %d of the skin uses vertex %d; there are %d", i / 3,
                              triangles[i], m);
    return PERI_OK;
}

static peri_result peri__skin_allocate(peri__skin_data *s, const peri_allocator *memory, peri_error *err) {
    size_t m = (size_t)s->m, corners = 3 * (size_t)s->triangle_count, reals, ints;
    double need = (double)s->m * PERI__SKIN_NEAR * (4 * sizeof(peri_real) + sizeof(int)) + (double)s->m * sizeof(int) +
                  (double)corners * (sizeof(peri_real) + 2 * sizeof(int));
    if (need > (double)(SIZE_MAX / 4))
        return peri__fail(err, PERI_ERROR_LIMIT, "a skin of %d vertices and %d triangles is beyond the address space",
                          s->m, s->triangle_count);
    reals = 4 * PERI__SKIN_NEAR * m + corners;
    ints = PERI__SKIN_NEAR * m + (m + 1) + 2 * corners;
    s->bytes = reals * sizeof(peri_real) + ints * sizeof(int);
    s->block = peri__resize(memory, NULL, 0, s->bytes);
    if (!s->block)
        return peri__fail(err, PERI_ERROR_MEMORY, "no memory for a skin of %d vertices (%.0f bytes)", s->m,
                          (double)s->bytes);
    s->blend = (peri_real *)s->block;
    s->area = s->blend + 4 * PERI__SKIN_NEAR * m;
    s->bound = (int *)(void *)(s->area + corners);
    s->triangles = s->bound + PERI__SKIN_NEAR * m;
    s->around = s->triangles + corners;
    s->first = s->around + corners;
    return PERI_OK;
}

static void peri__skin_free(peri__skin_data *s, const peri_allocator *memory) {
    if (s->block) (void)peri__resize(memory, s->block, s->bytes, 0);
    memset(s, 0, sizeof *s);
}

/* Copies the triangles and lists those around every vertex, ascending: the order in which normals are summed. */
static void peri__skin_around(peri__skin_data *s, const int *triangles) {
    int i, corners = 3 * s->triangle_count;
    memset(s->first, 0, ((size_t)s->m + 1) * sizeof(int));
    for (i = 0; i < corners; i++) {
        s->triangles[i] = triangles[i];
        s->first[triangles[i]]++;
    }
    for (i = 0; i < s->m; i++) s->first[i + 1] += s->first[i];
    for (i = corners - 1; i >= 0; i--) s->around[--s->first[triangles[i]]] = i / 3;
}

/* Binds a mesh to n particles at ref (3 n). On error nothing is held and *out is zero. */
static peri_result peri__skin_bind(const peri_real *ref, int n, peri_real spacing, const peri_real *vertices, int m,
                                   const int *triangles, int triangle_count, peri__skin_data *out,
                                   const peri_allocator *memory, peri_error *err) {
    peri__skin_grid grid;
    peri_result r;
    int v;
    memset(out, 0, sizeof *out);
    memset(&grid, 0, sizeof grid);
    r = peri__skin_check(vertices, m, triangles, triangle_count, err);
    if (r) return r;
    out->n = n;
    out->m = m;
    out->triangle_count = triangle_count;
    r = peri__skin_allocate(out, memory, err);
    if (!r) r = peri__skin_grid_make(&grid, ref, n, (double)spacing, memory, err);
    for (v = 0; v < m && !r; v++) {
        size_t at = PERI__SKIN_NEAR * (size_t)v;
        if (!peri__skin_vertex(&grid, vertices + 3 * (size_t)v, out->bound + at, out->blend + 4 * at))
            r = peri__skin_far(&grid, n, vertices + 3 * (size_t)v, v, err);
    }
    if (!r) peri__skin_around(out, triangles);
    if (grid.block) (void)peri__resize(memory, grid.block, grid.bytes, 0);
    if (r) peri__skin_free(out, memory);
    return r;
}

/* What the tasks of one update share. */
typedef struct peri__skin_job {
    const peri__skin_data *s;
    const peri_real *x, *F;
    peri_real *positions, *normals;
} peri__skin_job;

static void peri__skin_move_task(int begin, int end, void *context) {
    const peri__skin_job *job = (const peri__skin_job *)context;
    int v, k;
    for (v = begin; v < end; v++) {
        const int *bound = job->s->bound + PERI__SKIN_NEAR * (size_t)v;
        const peri_real *b = job->s->blend + 4 * PERI__SKIN_NEAR * (size_t)v;
        peri_real *to = job->positions + 3 * (size_t)v, p0 = 0, p1 = 0, p2 = 0;
        for (k = 0; k < PERI__SKIN_NEAR && b[0] > 0; k++, b += 4) {
            const peri_real *x = job->x + 3 * (size_t)bound[k], *f = job->F + 9 * (size_t)bound[k];
            p0 += b[0] * x[0] + (f[0] * b[1] + f[1] * b[2] + f[2] * b[3]);
            p1 += b[0] * x[1] + (f[3] * b[1] + f[4] * b[2] + f[5] * b[3]);
            p2 += b[0] * x[2] + (f[6] * b[1] + f[7] * b[2] + f[8] * b[3]);
        }
        to[0] = p0;
        to[1] = p1;
        to[2] = p2;
    }
}

static void peri__skin_area_task(int begin, int end, void *context) {
    const peri__skin_job *job = (const peri__skin_job *)context;
    int t;
    for (t = begin; t < end; t++) {
        const int *c = job->s->triangles + 3 * (size_t)t;
        const peri_real *a = job->positions + 3 * (size_t)c[0], *b = job->positions + 3 * (size_t)c[1],
                        *d = job->positions + 3 * (size_t)c[2];
        peri_real u0 = b[0] - a[0], u1 = b[1] - a[1], u2 = b[2] - a[2];
        peri_real v0 = d[0] - a[0], v1 = d[1] - a[1], v2 = d[2] - a[2];
        peri_real *to = job->s->area + 3 * (size_t)t;
        to[0] = u1 * v2 - u2 * v1;
        to[1] = u2 * v0 - u0 * v2;
        to[2] = u0 * v1 - u1 * v0;
    }
}

/* Sums the areas around each vertex: the area-weighted normal. Without any area it is (0, 0, 1). */
static void peri__skin_normal_task(int begin, int end, void *context) {
    const peri__skin_job *job = (const peri__skin_job *)context;
    const peri__skin_data *s = job->s;
    int v, k;
    for (v = begin; v < end; v++) {
        double n0 = 0, n1 = 0, n2 = 0, length;
        peri_real *to = job->normals + 3 * (size_t)v;
        for (k = s->first[v]; k < s->first[v + 1]; k++) {
            const peri_real *a = s->area + 3 * (size_t)s->around[k];
            n0 += (double)a[0];
            n1 += (double)a[1];
            n2 += (double)a[2];
        }
        length = sqrt(n0 * n0 + n1 * n1 + n2 * n2);
        if (!(length > 1e-140)) { /* none at all, or so small that its square lost bits; also not a number */
            n0 = n1 = 0;
            n2 = length = 1;
        }
        to[0] = (peri_real)(n0 / length);
        to[1] = (peri_real)(n1 / length);
        to[2] = (peri_real)(n2 / length);
    }
}

/* Moves the skin: x (3 n) present positions, F (9 n, rows) deformation gradients of the particles with respect to the
   ref of the binding; positions (3 m) out, normals (3 m) out unless NULL. One update of a skin at a time: area is
   scratch. */
static void peri__skin_move(const peri__skin_data *s, const peri_parallel *par, const peri_real *x, const peri_real *F,
                            peri_real *positions, peri_real *normals) {
    peri__skin_job job;
    job.s = s;
    job.x = x;
    job.F = F;
    job.positions = positions;
    job.normals = normals;
    peri_parallel_for(par, s->m, 256, peri__skin_move_task, &job);
    if (!normals) return;
    peri_parallel_for(par, s->triangle_count, 1024, peri__skin_area_task, &job);
    peri_parallel_for(par, s->m, 512, peri__skin_normal_task, &job);
}

#endif /* PERI_NO_SKINNING */

#ifndef PERI_NO_SKINNING
typedef struct peri__skin {
    peri__slot slot;
    uint32_t body, generation;  /* of the body it follows */
    peri__skin_data data;
    peri_real *gradient;        /* 9 per particle: scratch of an update */
    size_t gradient_bytes;
} peri__skin;
#define PERI__SKIN_BYTES sizeof(peri__skin)
#else
#define PERI__SKIN_BYTES sizeof(peri__slot)
#endif

#ifndef PERI_NO_SKINNING
static void peri__skins_drop(peri_world *w, const peri__body *b);
#endif

/* ---- implementation 3: creating and destroying a world ----------------------------------------------------------- */

peri_world_def peri_default_world_def(void) {
    peri_world_def d;
    memset(&d, 0, sizeof d);
    d.cookie = PERI__COOKIE + 1;
    d.gravity.z = PERI__R(-9.81);
    d.integrator = PERI_BACKWARD_EULER;
    d.solver = PERI_SOLVER_AUTO;
    d.sweeps = 12;
    d.lbfgs = 5;
    d.tolerance = PERI__R(1e-3);
    d.max_iterations = 200;
    d.matrix_scale = PERI__R(0.4);
    d.keep_momentum = 1;
    d.max_particles = 1 << 24;
    d.max_bonds = 1 << 30;
    d.max_bodies = 65535;
    d.max_materials = d.max_colliders = d.max_skins = 1024;
    d.max_attachments = 65535;
    d.max_contacts = 1 << 24;
    d.sleep_speed = PERI__R(0.05);
    d.sleep_time = PERI__R(0.5);
    d.parallel.threads = 1;
    return d;
}

static peri_result peri__finite3(const char *name, const peri_real *v, int count, peri_error *err) {
    int k;
    for (k = 0; k < 3 * count; k++)
        if (!peri__finite((double)v[k]) || fabs((double)v[k]) > 1e15)
            return peri__fail(err, PERI_ERROR_VALUE,
                              "%s: component %d of entry %d is %g; it must be finite and below 1e15", name, k % 3,
                              k / 3, (double)v[k]);
    return PERI_OK;
}

static peri_result peri__finite_vec(const char *name, peri_vec3 v, peri_error *err) {
    peri_real a[3];
    a[0] = v.x; a[1] = v.y; a[2] = v.z;
    return peri__finite3(name, a, 1, err);
}

static peri_result peri__check_int(const char *name, int value, int low, int high, peri_error *err) {
    if (value >= low && value <= high) return PERI_OK;
    return peri__fail(err, PERI_ERROR_VALUE, "%s is %d; it must lie between %d and %d", name, value, low, high);
}

static peri_result peri__check_enum(const char *name, int value, int most, peri_error *err) {
    if (value >= 0 && value <= most) return PERI_OK;
    return peri__fail(err, PERI_ERROR_ARGUMENT, "%s is %d, which names nothing", name, value);
}

static peri_result peri__check_world_def(const peri_world_def *d, peri_error *err) {
    peri_result bad;
    if (!d) return peri__fail(err, PERI_ERROR_ARGUMENT, "the world's definition is NULL");
    if (d->cookie != PERI__COOKIE + 1)
        return peri__fail(err, PERI_ERROR_ARGUMENT, "the world's definition was not made by peri_default_world_def");
    bad = peri__finite_vec("gravity", d->gravity, err);
    if (!bad) bad = peri__check_enum("integrator", (int)d->integrator, (int)PERI_BDF2, err);
    if (!bad) bad = peri__check_enum("solver", (int)d->solver, (int)PERI_SOLVER_POSITION, err);
    if (!bad) bad = peri__check_int("sweeps", d->sweeps, 2, 64, err);
    if (!bad) bad = peri__check_int("lbfgs", d->lbfgs, 0, PERI_LBFGS_MAX, err);
    if (!bad) bad = peri__check_range("tolerance", (double)d->tolerance, 1e-14, 1, err);
    if (!bad) bad = peri__check_int("max_iterations", d->max_iterations, 1, 1000000, err);
    if (!bad) bad = peri__check_range("matrix_scale", (double)d->matrix_scale, 0.05, 4, err);
    if (!bad) bad = peri__check_int("max_particles", d->max_particles, 1, 1 << 28, err);
    if (!bad) bad = peri__check_int("max_bonds", d->max_bonds, 0, 0x7ffffff0, err);
    if (!bad) bad = peri__check_int("max_bodies", d->max_bodies, 1, 65535, err);
    if (!bad) bad = peri__check_int("max_materials", d->max_materials, 1, 65535, err);
    if (!bad) bad = peri__check_int("max_colliders", d->max_colliders, 0, 65535, err);
    if (!bad) bad = peri__check_int("max_skins", d->max_skins, 0, 65535, err);
    if (!bad) bad = peri__check_int("max_attachments", d->max_attachments, 0, 1 << 24, err);
    if (!bad) bad = peri__check_int("max_contacts", d->max_contacts, 0, 1 << 27, err);
    if (!bad) bad = peri__check_range("sleep_speed", (double)d->sleep_speed, 0, 1e9, err);
    if (!bad) bad = peri__check_range("sleep_time", (double)d->sleep_time, 0, 1e9, err);
    if (!bad) bad = peri__check_int("parallel.threads", d->parallel.threads, 0, 1024, err);
    return bad;
}

static void peri__slots_begin(peri__slots *s, const char *name, size_t element, int limit) {
    s->name = name;
    s->element = element;
    s->limit = limit;
}

typedef struct peri__stored_material {
    peri__slot slot;
    peri_material m;
} peri__stored_material;

/* Bytes that bodies take at most, apart from the particle arrays: see peri__block_layout and peri__neighbours. In lanes
   the slots of bonds are 1.5 times the bonds at most, a lattice has 3 cells and 2 lanes a particle. */
static size_t peri__body_bytes(const peri_world_def *d, size_t particles, size_t bonds, size_t bodies) {
    size_t r = sizeof(peri_real), i = sizeof(int), lanes = 3 * (3 * sizeof(peri__spot) + r) + (3 * 8 + 42 + 11) * r;
    return particles * (7 * i + 1 + (6 + 3 + 6 + 3) * r) + particles * (lanes + 6 * i) + bonds * (3 * i + 9 * r) +
           bodies * (48 * PERI__UNIT + 72 * i) + (size_t)d->max_materials * sizeof(peri__matter) +
           particles * (3 * i + 3 * sizeof(double)) + 8 * particles * i + 64 * i;
}

/* In a buffer there is room for two contacts a particle, which is more than large bodies have, and 24 a body, for those
   of a few particles, each of which may have neighbours all around. */
static int peri__most_contacts(const peri_world_def *d) {
    int room = 2 * d->max_particles + 24 * d->max_bodies;
    return d->max_contacts < room ? d->max_contacts : room;
}

typedef struct peri__layout_total {
    size_t slots, rows, contacts, bodies, all;
} peri__layout_total;

/* One place says how much a world in a buffer takes: peri_world_size and peri_world_create_in both ask here. */
static int peri__world_layout(const peri_world_def *d, peri__layout_total *t) {
    peri_world probe;
    void **array[PERI__ROWS + 1];
    size_t bytes[PERI__ROWS + 1], per_particle = 0, particles = (size_t)d->max_particles;
    unsigned want[PERI__ROWS + 1];
    double guess;
    int n, k;
    memset(&probe, 0, sizeof probe);
    probe.def = *d;
    probe.stride = PERI__PROJECTIVE_STRIDE;
    probe.wants = ~0u;
    n = peri__particle_rows(&probe, array, bytes, want);
    for (k = 0; k < n; k++) per_particle += bytes[k];
    guess = (double)particles * ((double)per_particle + 800) + 64.0 * (double)d->max_bonds + (double)d->spare_bytes;
    if (guess > (double)(SIZE_MAX / 4)) return 0;
    t->slots = (size_t)d->max_bodies * sizeof(peri__body) + (size_t)d->max_materials * sizeof(peri__stored_material) +
               (size_t)d->max_colliders * sizeof(peri__collider) + (size_t)d->max_skins * PERI__SKIN_BYTES +
               (size_t)d->max_attachments * sizeof(peri__attachment);
    t->rows = particles * per_particle;
    t->contacts = (size_t)peri__most_contacts(d) *
                      (sizeof(peri__contact) + sizeof(int) + 2 * sizeof(peri__hold)) +
                  (size_t)d->max_bodies * (sizeof(peri__edge) + sizeof(peri__island) + 64 * sizeof(uint64_t));
    t->bodies = peri__body_bytes(d, particles, (size_t)d->max_bonds, (size_t)d->max_bodies);
    t->all = peri__round_up(sizeof(peri_world)) + peri__round_up(t->slots + t->rows + t->contacts + t->bodies) +
             peri__round_up(d->spare_bytes) + (size_t)(PERI__ROWS + 16) * PERI__UNIT;
    return 1;
}

size_t peri_world_size(const peri_world_def *def) {
    peri__layout_total t;
    if (peri__check_world_def(def, NULL) || !peri__world_layout(def, &t)) return 0;
    return t.all;
}

static void peri__world_begin(peri_world *w, const peri_world_def *def) {
    memset(w, 0, sizeof *w);
    w->def = *def;
    w->stride = 2;
    peri__slots_begin(&w->bodies, "bodies", sizeof(peri__body), def->max_bodies);
    peri__slots_begin(&w->materials, "materials", sizeof(peri__stored_material), def->max_materials);
    peri__slots_begin(&w->colliders, "colliders", sizeof(peri__collider), def->max_colliders);
    peri__slots_begin(&w->skins, "skins", PERI__SKIN_BYTES, def->max_skins);
    peri__slots_begin(&w->attachments, "attachments", sizeof(peri__attachment), def->max_attachments);
}

peri_world *peri_world_create(const peri_world_def *def, peri_error *err) {
    peri_world *w;
    if (peri__check_world_def(def, err)) return NULL;
    w = (peri_world *)peri__resize(&def->memory, NULL, 0, sizeof *w);
    if (!w) {
        peri__fail(err, PERI_ERROR_MEMORY, "%zu bytes for a world were refused by the allocator", sizeof *w);
        return NULL;
    }
    peri__world_begin(w, def);
    w->stats.bytes = w->stats.bytes_peak = sizeof *w;
    w->stats.allocations = 1;
    return w;
}

/* Room for n contacts, and as many holds. */
static peri_result peri__contacts_reserve(peri_world *w, int n) {
    void *array[4];
    size_t size[4];
    int now = 2 * w->contact_capacity, most = w->buffer ? peri__most_contacts(&w->def) : w->def.max_contacts, k;
    if (n <= w->contact_capacity) return PERI_OK;
    if (n > most)
        return peri__fail(&w->error, PERI_ERROR_LIMIT, "more than %d contacts: raise %s of the world's definition",
                          most, most < w->def.max_contacts ? "max_particles or max_bodies" : "max_contacts");
    now = now < 256 ? 256 : now;
    now = now < n ? n : now > most ? most : now;
    array[0] = w->contacts, size[0] = sizeof *w->contacts;
    array[1] = w->contact_order, size[1] = sizeof *w->contact_order;
    array[2] = w->holds, size[2] = sizeof *w->holds;
    array[3] = w->holds_next, size[3] = sizeof *w->holds_next;
    for (k = 0; k < 4; k++) {
        peri_result bad = peri__grow(w, &array[k], (size_t)w->held_rows[k], (size_t)now, size[k]);
        if (bad) return bad;
        w->held_rows[k] = now;
        w->contacts = (peri__contact *)array[0];
        w->contact_order = (int *)array[1];
        w->holds = (peri__hold *)array[2];
        w->holds_next = (peri__hold *)array[3];
    }
    w->contact_capacity = now;
    return PERI_OK;
}

/* Room for the order of bodies and for islands, one for each slot of a body. */
static peri_result peri__bodies_reserve(peri_world *w) {
    void *sweep = w->sweep, *islands = w->islands;
    int n = w->bodies.capacity;
    peri_result bad = PERI_OK;
    if (n > w->body_rows[0]) bad = peri__grow(w, &sweep, (size_t)w->body_rows[0], (size_t)n, sizeof *w->sweep);
    if (bad) return bad;
    w->sweep = (peri__edge *)sweep;
    w->body_rows[0] = n;
    if (n > w->body_rows[1]) bad = peri__grow(w, &islands, (size_t)w->body_rows[1], (size_t)n, sizeof *w->islands);
    if (bad) return bad;
    w->islands = (peri__island *)islands;
    w->body_rows[1] = n;
    return PERI_OK;
}

/* In a buffer, everything that has a limit is taken now, so that no later call finds the buffer too small. */
static peri_result peri__reserve_all(peri_world *w) {
    peri__slots *kinds[5];
    peri_result bad = PERI_OK;
    void *pairs = NULL;
    int k;
    kinds[0] = &w->bodies;
    kinds[1] = &w->materials;
    kinds[2] = &w->colliders;
    kinds[3] = &w->skins;
    kinds[4] = &w->attachments;
    for (k = 0; k < 5 && !bad; k++) {
        void *data = NULL;
        if (kinds[k]->limit) bad = peri__grow(w, &data, 0, (size_t)kinds[k]->limit, kinds[k]->element);
        kinds[k]->data = (char *)data;
        kinds[k]->capacity = kinds[k]->limit;
    }
    if (!bad) bad = peri__contacts_reserve(w, peri__most_contacts(&w->def));
    if (!bad) bad = peri__bodies_reserve(w);
    if (!bad) bad = peri__grow(w, &pairs, 0, 64 * (size_t)w->def.max_bodies, sizeof *w->pairs);
    w->pairs = (uint64_t *)pairs;
    w->pair_capacity = 64 * w->def.max_bodies;
    return bad ? bad : peri__reserve(w, w->def.max_particles, ~0u, PERI__PROJECTIVE_STRIDE);
}

peri_world *peri_world_create_in(const peri_world_def *def, void *buffer, size_t bytes, peri_error *err) {
    peri__layout_total t;
    peri_world *w = (peri_world *)buffer;
    size_t head = peri__round_up(sizeof *w), own;
    if (peri__check_world_def(def, err)) return NULL;
    if (!buffer || ((uintptr_t)buffer & (sizeof(double) - 1))) {
        peri__fail(err, PERI_ERROR_ARGUMENT, "buffer is NULL or not aligned as malloc's");
        return NULL;
    }
    if (!peri__world_layout(def, &t) || bytes < t.all) {
        peri__fail(err, PERI_ERROR_LIMIT, "the buffer has %zu bytes; this definition takes %zu (peri_world_size)",
                   bytes, peri_world_size(def));
        return NULL;
    }
    peri__world_begin(w, def);
    w->buffer = buffer;
    own = t.all - head - peri__round_up(def->spare_bytes);
    w->heap = peri__heap_begin((char *)buffer + head, own);
    w->spare = peri__heap_begin((char *)buffer + head + own, (bytes - head - own) / PERI__UNIT * PERI__UNIT);
    w->stats.bytes = head;
    if (peri__reserve_all(w)) {
        if (err) *err = w->error;
        return NULL;
    }
    return w;
}

static void peri__drop(peri_world *w, void *ptr, size_t bytes) {
    if (ptr) peri__world_resize(ptr, bytes, 0, w);
}

static void peri__grid_free(peri_world *w, peri__grid *g);

#ifndef PERI_NO_CHOLESKY
/* A body gives up its factor; the last one frees it. */
static void peri__factor_leave(peri_world *w, peri__body *b) {
    peri__factor *f = b->factor;
    b->factor = NULL;
    if (!f || --f->users > 0) return;
    w->stats.factor_bytes -= peri_cholesky_bytes(f->l) + peri_two_level_bytes(f->levels);
    peri_cholesky_destroy(f->l);
    peri_two_level_destroy(f->levels);
    peri__spare_resize(f, sizeof *f, 0, w);
    w->stats.factors_held--;
}
#endif

static void peri__body_drop(peri_world *w, peri__body *body) {
#ifndef PERI_NO_CHOLESKY
    peri__factor_leave(w, body);
#endif
    peri__grid_free(w, &body->grid);
    peri__drop(w, body->block, body->block_bytes);
    if (body->near_bytes) peri__drop(w, body->near, body->near_bytes);
    if (body->plate) peri__spare_resize(body->plate, body->plate_bytes, 0, w);
    body->block = NULL;
    body->plate = NULL;
}

void peri_world_destroy(peri_world *w) {
    void **array[PERI__ROWS + 1];
    size_t bytes[PERI__ROWS + 1];
    unsigned want[PERI__ROWS + 1];
    int n, k;
    if (!w || w->buffer) return;
#ifndef PERI_NO_SKINNING
    peri__skins_drop(w, NULL);
#endif
    for (k = 0; k < w->bodies.capacity; k++) {
        peri__body *body = peri__body_at(w, k);
        if (body) peri__body_drop(w, body);
    }
    n = peri__particle_rows(w, array, bytes, want);
    for (k = 0; k < n; k++) peri__drop(w, *array[k], w->row_bytes[k]);
    peri__drop(w, w->bodies.data, (size_t)w->bodies.capacity * w->bodies.element);
    peri__drop(w, w->materials.data, (size_t)w->materials.capacity * w->materials.element);
    peri__drop(w, w->colliders.data, (size_t)w->colliders.capacity * w->colliders.element);
    peri__drop(w, w->skins.data, (size_t)w->skins.capacity * w->skins.element);
    peri__drop(w, w->attachments.data, (size_t)w->attachments.capacity * w->attachments.element);
    peri__drop(w, w->contacts, (size_t)w->held_rows[0] * sizeof *w->contacts);
    peri__drop(w, w->contact_order, (size_t)w->held_rows[1] * sizeof *w->contact_order);
    peri__drop(w, w->holds, (size_t)w->held_rows[2] * sizeof *w->holds);
    peri__drop(w, w->holds_next, (size_t)w->held_rows[3] * sizeof *w->holds_next);
    peri__drop(w, w->sweep, (size_t)w->body_rows[0] * sizeof *w->sweep);
    peri__drop(w, w->islands, (size_t)w->body_rows[1] * sizeof *w->islands);
    peri__drop(w, w->pairs, (size_t)w->pair_capacity * sizeof *w->pairs);
    peri__resize(&w->def.memory, w, sizeof *w, 0);
}

static void peri__wake(peri_world *w, peri__body *b);

peri_result peri_world_set_gravity(peri_world *w, peri_vec3 gravity) {
    peri_result bad;
    int k;
    if (!w) return PERI_ERROR_ARGUMENT;
    bad = peri__finite_vec("gravity", gravity, &w->error);
    if (bad) return peri__report(w, bad);
    w->def.gravity = gravity;
    for (k = 0; k < w->bodies.capacity; k++)
        if (peri__body_at(w, k)) peri__wake(w, peri__body_at(w, k));
    return PERI_OK;
}

const peri_error *peri_last_error(const peri_world *w) { return w ? &w->error : NULL; }

/* ---- implementation 4: neighbours -------------------------------------------------------------------------------- */

static int peri__grid_axis(const peri__grid *g, int axis, double x) {
    int c = (int)((x - g->lower[axis]) * g->inv_size);
    return c < 0 ? 0 : c >= g->cells[axis] ? g->cells[axis] - 1 : c;
}

static int peri__grid_cell(const peri__grid *g, const double *x) {
    return peri__grid_axis(g, 0, x[0]) +
           g->cells[0] * (peri__grid_axis(g, 1, x[1]) + g->cells[1] * peri__grid_axis(g, 2, x[2]));
}

static void peri__grid_free(peri_world *w, peri__grid *g) {
    peri__drop(w, g->start, g->start_bytes);
    peri__drop(w, g->order, g->order_bytes);
    g->start = g->order = NULL;
}

/* Room for n points. */
static peri_result peri__grid_reserve(peri_world *w, peri__grid *g, int n) {
    memset(g, 0, sizeof *g);
    g->most = 4 * n + 64;
    g->start_bytes = ((size_t)g->most + 1) * sizeof(int);
    g->order_bytes = (size_t)n * sizeof(int);
    g->start = (int *)peri__world_resize(NULL, 0, g->start_bytes, w);
    g->order = (int *)peri__world_resize(NULL, 0, g->order_bytes, w);
    if (g->start && g->order) return PERI_OK;
    peri__grid_free(w, g);
    return peri__no_memory(w, g->start_bytes + g->order_bytes);
}

/* Sorts n points (of list; NULL: the first n of x) into cells at least `size` wide. */
static void peri__grid_fill(peri__grid *g, const double *x, const int *list, int n, double size) {
    double total;
    int i, c, count;
    for (c = 0; c < 3; c++) g->lower[c] = g->upper[c] = x[3 * (size_t)(list ? list[0] : 0) + (size_t)c];
    for (i = 0; i < n; i++)
        for (c = 0; c < 3; c++) {
            double v = x[3 * (size_t)(list ? list[i] : i) + (size_t)c];
            if (v < g->lower[c]) g->lower[c] = v;
            if (v > g->upper[c]) g->upper[c] = v;
        }
    for (;; size *= 1.3) {
        for (total = 1, c = 0; c < 3; c++) total *= floor((g->upper[c] - g->lower[c]) / size) + 1;
        if (total <= g->most) break;
    }
    g->inv_size = 1 / size;
    for (c = 0; c < 3; c++) g->cells[c] = (int)((g->upper[c] - g->lower[c]) / size) + 1;
    count = g->cells[0] * g->cells[1] * g->cells[2];
    if (count > g->most) count = g->most;
    memset(g->start, 0, ((size_t)count + 1) * sizeof *g->start);
    for (i = 0; i < n; i++) g->start[peri__grid_cell(g, x + 3 * (size_t)(list ? list[i] : i)) + 1]++;
    for (c = 0; c < count; c++) g->start[c + 1] += g->start[c];
    for (i = 0; i < n; i++) {
        int k = list ? list[i] : i;
        g->order[g->start[peri__grid_cell(g, x + 3 * (size_t)k)]++] = k;
    }
    for (c = count; c > 0; c--) g->start[c] = g->start[c - 1];
    g->start[0] = 0;
}

/* Particle i of a rod of n stations: the points first, then the ghosts of each. */
static int peri__station(int n, int i) { return i < n ? i : (i - n) / PERI__GHOSTS; }

static int peri__stations_apart(const peri__grid *g, int i, int j) {
    int away = peri__station(g->stations, i) - peri__station(g->stations, j);
    if (away < 0) away = -away;
    return away > 1 && !(g->closed && away == g->stations - 1);
}

/* Neighbours of point i closer than reach, ascending, into out (NULL: counted only). Returns their number; *closest is
   the nearest one and its squared distance. */
static int peri__grid_near(const peri__grid *g, const double *x, int i, double reach, int *out, int *closest,
                           double *square) {
    const double *p = x + 3 * (size_t)i;
    int at[3], c, k, count = 0, a[3];
    for (c = 0; c < 3; c++) at[c] = peri__grid_axis(g, c, p[c]);
    *square = reach * reach;
    *closest = -1;
    for (a[2] = at[2] - 1; a[2] <= at[2] + 1; a[2]++)
        for (a[1] = at[1] - 1; a[1] <= at[1] + 1; a[1]++)
            for (a[0] = at[0] - 1; a[0] <= at[0] + 1; a[0]++) {
                int cell = a[0] + g->cells[0] * (a[1] + g->cells[1] * a[2]);
                if (a[0] < 0 || a[1] < 0 || a[2] < 0 || a[0] >= g->cells[0] || a[1] >= g->cells[1] ||
                    a[2] >= g->cells[2])
                    continue;
                for (k = g->start[cell]; k < g->start[cell + 1]; k++) {
                    int j = g->order[k], m;
                    const double *q = x + 3 * (size_t)j;
                    double dx = q[0] - p[0], dy = q[1] - p[1], dz = q[2] - p[2], r2 = dx * dx + dy * dy + dz * dz;
                    if (j == i || r2 >= reach * reach) continue;
                    if (g->stations && peri__stations_apart(g, i, j)) continue;
                    if (r2 < *square) *square = r2, *closest = j;
                    if (out) {
                        for (m = count; m > 0 && out[m - 1] > j; m--) out[m] = out[m - 1];
                        out[m] = j;
                    }
                    count++;
                }
            }
    return count;
}

/* ---- implementation 5: bonds ------------------------------------------------------------------------------------- */

/* Rotation matrix (rows) of a quaternion, normalised. */
static void peri__quat_matrix(peri_quat q, double r[9]) {
    double x = (double)q.x, y = (double)q.y, z = (double)q.z, w = (double)q.w, s = 2 / (x * x + y * y + z * z + w * w);
    r[0] = 1 - s * (y * y + z * z); r[1] = s * (x * y - w * z); r[2] = s * (x * z + w * y);
    r[3] = s * (x * y + w * z); r[4] = 1 - s * (x * x + z * z); r[5] = s * (y * z - w * x);
    r[6] = s * (x * z - w * y); r[7] = s * (y * z + w * x); r[8] = 1 - s * (x * x + y * y);
}

static void peri__apply(const double r[9], const double *v, double *out) {
    int c;
    for (c = 0; c < 3; c++) out[c] = r[3 * c] * v[0] + r[3 * c + 1] * v[1] + r[3 * c + 2] * v[2];
}

static void peri__apply_back(const double r[9], const double *v, double *out) {
    int c;
    for (c = 0; c < 3; c++) out[c] = r[c] * v[0] + r[3 + c] * v[1] + r[6 + c] * v[2];
}

static double peri__dot3(const double *a, const double *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

/* Unnormalised weight of a bond of length r (in spacings) for horizon delta (in spacings). */
static double peri__kernel(const peri_body_def *d, double r, double delta) {
    double q = r / delta, w = 1;
    switch (d->kernel) {
    case PERI_KERNEL_POWER: w = peri_exp(-(double)d->kernel_power * peri_log(r)); break;
    case PERI_KERNEL_CONSTANT: break;
    case PERI_KERNEL_LINEAR: w = 1 - q; break;
    case PERI_KERNEL_CUBIC: w = q < 0.5 ? 1 - 6 * q * q + 6 * q * q * q : 2 * (1 - q) * (1 - q) * (1 - q); break;
    case PERI_KERNEL_INVERSE: w = 1 / q; break;
    case PERI_KERNEL_SHIFTED: w = 1 / (1 + q); break;
    }
    if (d->partial_volume && r > delta - 0.5) w *= delta + 0.5 - r;
    return w;
}

/* How the points of a body stand on a lattice, and the grid of cells made of it: rows along axis[0], the fastest, end
   in `margin` empty cells, after which the next row begins; layers end in empty rows. */
typedef struct peri__comb {
    int axis[3], count[3], step[3];     /* of each axis: which, fastest first; points along it; cells from one on */
    double lower[3], pitch[3], away;    /* by x, y, z, m; largest departure of a point */
    int margin, lead, cells, blocks;    /* lead: empty cells at either end. blocks 0: the points stand on none */
    int bonds;
} peri__comb;

/* What making a body needs besides the body itself. */
typedef struct peri__making {
    const peri_body_def *def;
    double *x;              /* reference positions in the world's frame */
    size_t x_bytes;
    peri__grid grid;
    double delta;           /* horizon, m */
    double turn[9];         /* points as given to the world's frame */
    int bonds, slots;       /* slots: of the bonds in lanes, empty ones too; 0: the body is not computed in lanes */
    peri__comb comb;
    int anisotropic;        /* a material of the body is: bonds have a gain */
    const peri_body_def *given; /* the user's definition; def may be a rod's with its ghosts */
    void *rod;
    size_t rod_bytes;
} peri__making;

/* A body's constant arrays lie in one block; called with base NULL it only counts. */
static size_t peri__block_layout(peri__body *b, char *base, const peri__making *make) {
    size_t r = sizeof(peri_real), n = (size_t)b->count, m = (size_t)make->bonds, at = 0;
    size_t slots = make->slots ? (size_t)make->slots : m, moments = n;
    const peri_body_def *d = make->def;
    int c;
#define PERI__PART(field, type, bytes) \
    (b->field = base ? (type *)(void *)(base + at) : NULL, at += peri__round_up(bytes))
    PERI__PART(row, int, (n + 1) * sizeof(int));
    PERI__PART(col, int, m * sizeof(int));
    for (c = 0; c < 3; c++) PERI__PART(xi[c], peri_real, slots * r);
    PERI__PART(inv_r2, peri_real, slots * r);
    PERI__PART(weight, peri_real, slots * r);
    PERI__PART(value, peri_real, m * r);
    PERI__PART(diagonal, peri_real, n * r);
    PERI__PART(stiffness, peri_real, n * r);
    PERI__PART(pinned, peri_real, n * r);
    PERI__PART(share, peri_real, n * r);
    PERI__PART(volume, peri_real, n * r);
    PERI__PART(points, peri_real, 3 * n * r);
    PERI__PART(surface, int, n * sizeof(int));
    PERI__PART(shape, peri_real, 6 * n * r);
    if (make->slots) {
        const peri__comb *g = &make->comb;
        size_t blocks = g->blocks ? (size_t)g->blocks : (n + PERI__LANES - 1) / PERI__LANES;
        size_t length = g->blocks ? (size_t)g->cells : PERI__LANES * blocks;
        moments = PERI__LANES * blocks;
        b->lanes.blocks = (int)blocks;
        b->lanes.length = (int)length;
        b->lanes.lattice = g->blocks > 0;
        b->lanes.bonds = g->blocks ? g->bonds : 0;
        PERI__PART(start, int, ((n + PERI__LANES - 1) / PERI__LANES + 1) * sizeof(int));
        PERI__PART(lanes.who, int, moments * sizeof(int));
        PERI__PART(lanes.first, int, (blocks + 1) * sizeof(int));
        for (c = 0; c < 3; c++) PERI__PART(lanes.x[c], peri__spot, length * sizeof(peri__spot));
        PERI__PART(lanes.coef, peri_real, length * (size_t)peri__model(b->matter.m.model)->stride * r);
        if (!g->blocks) PERI__PART(near, int, slots * sizeof(int));
        if (g->blocks) PERI__PART(lanes.lane, int, n * sizeof(int));
        if (g->blocks) PERI__PART(lanes.base, int, blocks * sizeof(int));
        if (g->blocks) PERI__PART(lanes.volume, peri_real, length * r);
        if (g->blocks) PERI__PART(lanes.offset, int, (size_t)g->bonds * sizeof(int));
        if (g->blocks) PERI__PART(lanes.stencil, peri_real, 11 * (size_t)g->bonds * r);
    }
    if (b->form == PERI_FORM_SHEET) PERI__PART(normal, peri_real, 3 * n * r);
    if (b->matter.m.model == PERI_MODEL_CORRESPONDENCE || b->form == PERI_FORM_SHEET)
        PERI__PART(moment, peri_real, 21 * moments * r);
    if (make->anisotropic) PERI__PART(gain, peri_real, m * r);
    if (make->anisotropic && (d->directions || d->material_of)) PERI__PART(far_gain, peri_real, m * r);
    if (d->material_of) PERI__PART(matters, peri__matter, ((size_t)d->material_count + 1) * sizeof(peri__matter));
    if (d->material_of) PERI__PART(kind, unsigned char, n);
    if (d->stiffness) PERI__PART(firmness, peri_real, n * r);
#undef PERI__PART
    return at;
}

/* G(n) of particle i for the direction of xi (SH (18)). Directions of its own turn with the points. */
static double peri__bond_gain(const peri__body *b, const peri__making *make, int i, const double xi[3], double r2) {
    const peri_material *m = &(b->matters ? b->matters + b->kind[i] : &b->matter)->m;
    const peri_real *direction = m->direction;
    double along[3], sum = 0;
    int a, c;
    if (!m->anisotropic) return 1;
    memcpy(along, xi, sizeof along);
    if (make->def->directions) {
        direction = make->def->directions + 9 * (size_t)i;
        peri__apply_back(make->turn, xi, along);
    }
    for (a = 0; a < 3; a++) {
        double d = 0;
        for (c = 0; c < 3; c++) d += (double)direction[3 * c + a] * along[c];
        sum += d * d * (double)m->strength[a] * (double)m->strength[a];
    }
    return sqrt(sum / r2);
}

static void peri__bond_make(peri__body *b, const peri__making *make, int i, int k) {
    const double *xi = make->x + 3 * (size_t)i, *xj = make->x + 3 * (size_t)b->col[k];
    const peri_real *pi = make->def->points + 3 * (size_t)i, *pj = make->def->points + 3 * (size_t)b->col[k];
    double r2 = 0, w, along[3];
    size_t at = peri__bond_at(&b->bonds, i, k);
    int c;
    if (b->near) b->near[at] = b->col[k];
    for (c = 0; c < 3; c++) {
        double d = (double)pj[c] - (double)pi[c];
        b->xi[c][at] = (peri_real)(xj[c] - xi[c]);
        r2 += d * d;        /* of the points as given: copies that are turned have the same matrix */
    }
    b->inv_r2[at] = (peri_real)(1 / r2);
    w = peri__kernel(make->def, sqrt(r2) / b->spacing, b->horizon);
    b->weight[at] = (peri_real)(w * (double)b->volume[i] * (double)b->volume[b->col[k]]);
    for (c = 0; c < 3; c++) along[c] = (double)b->xi[c][at];
    if (b->gain) b->gain[k] = (peri_real)peri__bond_gain(b, make, i, along, r2);
    if (b->far_gain) b->far_gain[k] = (peri_real)peri__bond_gain(b, make, b->col[k], along, r2);
}

/* Pseudo-inverse of the shape tensor k (Voigt) of at most `most` dimensions; returns its rank. normal: the direction of
   the smallest eigenvalue (NULL: not wanted). */
static int peri__pseudo_inverse(const double k[6], int most, peri_real *out, peri_real *normal) {
    static const int row[6] = {0, 1, 2, 1, 0, 0}, col[6] = {0, 1, 2, 2, 2, 1};
    double value[3], v[9], sum[6] = {0, 0, 0, 0, 0, 0};
    int a, c, rank = 0;
    peri_eigen3(k, value, v);
    for (a = 0; a < 3 && normal; a++) normal[a] = (peri_real)v[3 * a];
    for (a = 3 - most; a < 3; a++) {
        if (!(value[a] > 1e-3 * value[2]) || !(value[2] > 0)) continue;
        rank++;
        for (c = 0; c < 6; c++) sum[c] += v[3 * row[c] + a] * v[3 * col[c] + a] / value[a];
    }
    for (c = 0; c < 6; c++) out[c] = (peri_real)sum[c];
    return rank;
}

/* The moment of bonds in a plane has rank 3: its pseudo-inverse there, which leaves C along the normal alone. Returns 0
   where the bonds do not even tell the strains of the plane. */
static int peri__flat_inverse(double m[21], const peri_real *normal) {
    double n[3], t[6], b[18], whole[36], flat[9], inverse[9], det, trace;
    static const int row[6] = {0, 1, 2, 1, 0, 0}, col[6] = {0, 1, 2, 2, 2, 1};
    int c, d, k, e;
    for (c = 0; c < 3; c++) n[c] = (double)normal[c];
    peri__plate_tangents(n, t);
    for (c = 0; c < 6; c++) {       /* strains of the plane as strains of space: h = b h2 */
        b[3 * c] = t[row[c]] * t[col[c]];
        b[3 * c + 1] = t[3 + row[c]] * t[3 + col[c]];
        b[3 * c + 2] = t[row[c]] * t[3 + col[c]] + t[3 + row[c]] * t[col[c]];
    }
    for (k = 0, c = 0; c < 6; c++)
        for (d = 0; d <= c; d++, k++) whole[6 * c + d] = whole[6 * d + c] = m[k];
    for (c = 0; c < 9; c++)
        for (flat[c] = 0, k = 0; k < 6; k++)
            for (e = 0; e < 6; e++) flat[c] += b[3 * k + c / 3] * whole[6 * k + e] * b[3 * e + c % 3];
    trace = flat[0] + flat[4] + flat[8];
    det = peri_det3(flat);
    if (!(det > 1e-4 * trace * trace * trace)) return 0;
    peri_adjugate3(flat, inverse);
    for (k = 0, c = 0; c < 6; c++)
        for (d = 0; d <= c; d++, k++)
            for (m[k] = 0, e = 0; e < 9; e++) m[k] += b[3 * c + e / 3] * inverse[e] / det * b[3 * d + e % 3];
    return 1;
}

/* Normalisation, shape tensor and 6x6 moment of particle i. Returns its flags. */
static int peri__family_make(peri__body *b, int i) {
    double sum = 0, tensor[6] = {0, 0, 0, 0, 0, 0}, m[21], lean[3] = {0, 0, 0}, arm = 0;
    peri_real nn[6];
    int k, c, d, flags = 0;
    memset(m, 0, sizeof m);
    for (k = b->row[i]; k < b->row[i + 1]; k++)
        sum += (double)(b->weight[peri__bond_at(&b->bonds, i, k)] / b->volume[i]);
    b->share[i] = sum > 0 ? (peri_real)(1 / sum) : 0;
    for (k = b->row[i]; k < b->row[i + 1]; k++) {
        peri__bond o;
        size_t from = peri__bond_at(&b->bonds, i, k);
        double omega = (double)(b->weight[from] * b->share[i] / b->volume[i]);
        int at = 0;
        for (c = 0; c < 3; c++) {
            o.xi[c] = b->xi[c][from];
            lean[c] += omega * (double)o.xi[c];
        }
        o.inv_r2 = b->inv_r2[from];
        arm += omega / sqrt((double)o.inv_r2);
        peri__bond_nn(&o, nn);
        for (c = 0; c < 6; c++) {
            tensor[c] += omega * (double)nn[c] / (c < 3 ? 1 : 2);
            for (d = 0; d <= c; d++) m[at++] += omega * (double)nn[c] * (double)nn[d];
        }
    }
    if (peri__pseudo_inverse(tensor, b->normal ? 2 : 3, b->shape + 6 * (size_t)i,
                             b->normal ? b->normal + 3 * (size_t)i : NULL) < 3)
        flags |= PERI__FLAT | PERI__SURFACE;
    /* bonds to one side only: on a face of a lattice 0.5, inside of scattered points below 0.1 */
    if (!(lean[0] * lean[0] + lean[1] * lean[1] + lean[2] * lean[2] < 0.15 * 0.15 * arm * arm)) flags |= PERI__SURFACE;
    if (!b->moment) return flags;
    if (b->normal ? !peri__flat_inverse(m, b->normal + 3 * (size_t)i) : !peri_invert6(m, 1e-3)) {
        memset(m, 0, sizeof m);
        if (b->matter.m.model == PERI_MODEL_CORRESPONDENCE) flags |= PERI__SINGULAR;
    }
    for (c = 0; c < 21; c++) b->moment[peri__moment_at(&b->bonds, i, c)] = (peri_real)m[c];
    return flags;
}

static void peri__bonds_view(peri__body *b) {
    peri__bonds *v = &b->bonds;
    int c;
    v->n = b->count;
    v->row = b->row;
    v->col = b->col;
    v->start = b->start;
    v->lane = b->lanes.lane;
    for (c = 0; c < 3; c++) v->xi[c] = b->xi[c];
    v->inv_r2 = b->inv_r2;
    v->weight = b->weight;
    v->gain = b->gain;
    v->share = b->share;
    v->volume = b->volume;
    v->shape = b->shape;
    v->moment = b->moment;
    v->normal = b->normal;
    v->plate = b->plate;
    v->plate_rest = b->plate_rest;
    v->plate_rows = b->plate_rows;
    v->matters = b->matters;
    v->kind = b->kind;
    v->factor = b->firmness;
    v->far_gain = b->far_gain;
    v->unit = b->spacing * b->spacing * b->spacing;
}

/* Can the body's kernels run in lanes at all? */
static int peri__lanes_fit_for(const peri__body *b, const peri__making *make) {
    const peri__matter *m = &b->matter;
    if (b->form != PERI_FORM_SOLID || make->anisotropic || make->def->material_of) return 0;
    return m->m.model != PERI_MODEL_STRETCH ||
           (m->g.form != PERI__FORM_GENERAL && m->h.form != PERI__FORM_GENERAL);
}

/* Whole steps of point p from the lower end, along an axis. */
static int peri__comb_at(const peri__comb *g, int axis, double p) {
    return (int)floor((p - g->lower[axis]) / g->pitch[axis] + 0.5);
}

static int peri__comb_cell(const peri__comb *g, const peri_real *p) {
    int c, cell = g->lead;
    for (c = 0; c < 3; c++) cell += g->step[c] * peri__comb_at(g, g->axis[c], (double)p[g->axis[c]]);
    return cell;
}

/* Walks over the stencil's bonds: o (-margin - 1 in o[0] and -margin in the others to begin with) becomes the offset of
   the next, in steps of axis[0] .. axis[2]. Returns 1, 0 after the last, -1 where rounding decides whether a bond is
   inside the horizon. */
static int peri__comb_next(const peri__comb *g, double delta, int o[3]) {
    for (;;) {
        double r = 0;
        int c;
        for (c = 0; c < 3 && ++o[c] > g->margin; c++) o[c] = -g->margin;
        if (c == 3) return 0;
        for (c = 0; c < 3; c++) r += (o[c] * g->pitch[g->axis[c]]) * (o[c] * g->pitch[g->axis[c]]);
        r = sqrt(r);
        if (!(fabs(r - delta) > 4 * g->away + 1e-9 * delta)) return -1;
        if (r < delta && r > 0) return 1;
    }
}

/* The grid with the axes in a given order, or 0: too many cells, or particles do not ascend with them. */
static int peri__comb_order(const peri_body_def *d, int a0, int a1, const int count[3], peri__comb *g) {
    double cells;
    int i, c, cell, last = -1, end = -1;
    g->axis[0] = a0;
    g->axis[1] = a1;
    g->axis[2] = 3 - a0 - a1;
    for (c = 0; c < 3; c++) g->count[c] = count[g->axis[c]];
    cells = ((double)g->count[0] + g->margin) * ((double)g->count[1] + g->margin) * (g->count[2] + 2.0 * g->margin + 2);
    if (cells > 4.0 * d->count + 4096) return 0;
    g->step[0] = 1;
    g->step[1] = g->count[0] + g->margin;
    g->step[2] = g->step[1] * (g->count[1] + g->margin);
    g->lead = g->margin * (1 + g->step[1] + g->step[2]);
    g->cells = 2 * g->lead + PERI__LANES;
    for (c = 0; c < 3; c++) g->cells += (g->count[c] - 1) * g->step[c];
    if (g->cells > 3 * (d->count - 1)) return 0;
    for (g->blocks = 0, i = 0; i < d->count; i++) {
        cell = peri__comb_cell(g, d->points + 3 * (size_t)i);
        if (cell <= last) return g->blocks = 0;
        if (cell >= end) end = cell + PERI__LANES, g->blocks++;
        last = cell;
    }
    if (PERI__LANES * g->blocks > 2 * d->count) g->blocks = 0;
    return g->blocks;
}

/* Finds the lattice that the points stand on, to rounding; else g->blocks stays 0. */
static void peri__comb_find(const peri_body_def *d, double delta, peri__comb *g) {
    double spacing = (double)d->spacing, upper[3], tolerance = (sizeof(peri_real) > 4 ? 1e-11 : 2e-5) * spacing;
    int count[3], o[3], i, c, a0, a1;
    for (c = 0; c < 3; c++) {
        g->lower[c] = upper[c] = (double)d->points[c];
        for (i = 1; i < d->count; i++) {
            double p = (double)d->points[3 * (size_t)i + (size_t)c];
            if (p < g->lower[c]) g->lower[c] = p;
            if (p > upper[c]) upper[c] = p;
        }
        if ((upper[c] - g->lower[c]) / spacing > d->count) return;
        count[c] = (int)floor((upper[c] - g->lower[c]) / spacing + 0.5) + 1;
        g->pitch[c] = count[c] > 1 ? (upper[c] - g->lower[c]) / (count[c] - 1) : spacing;
        if (!(fabs(g->pitch[c] - spacing) < 1e-3 * spacing)) return;
    }
    for (i = 0; i < d->count; i++)
        for (c = 0; c < 3; c++) {
            double p = (double)d->points[3 * (size_t)i + (size_t)c];
            double away = fabs(p - g->lower[c] - peri__comb_at(g, c, p) * g->pitch[c]);
            if (away > tolerance) return;
            if (away > g->away) g->away = away;
        }
    g->margin = (int)(delta / (0.999 * spacing));
    for (c = 0; c < 3; c++) g->axis[c] = c;
    o[0] = -g->margin - 1;
    o[1] = o[2] = -g->margin;
    while ((c = peri__comb_next(g, delta, o)) > 0) g->bonds++;
    if (c < 0 || g->bonds > d->count) return;
    for (a0 = 0; a0 < 3; a0++)
        for (a1 = 0; a1 < 3; a1++)
            if (a0 != a1 && peri__comb_order(d, a0, a1, count, g)) return;
}

/* Bond k of the stencil, at offset o. Its opposite is its exact negative. */
static void peri__stencil_bond(peri__body *b, const peri__making *make, int k, const int o[3]) {
    const peri__comb *g = &make->comb;
    peri__lanes *t = &b->lanes;
    size_t n = (size_t)t->bonds, at = (size_t)k;
    double xi[3], out[3], r2;
    peri__bond bond;
    int c;
    for (t->offset[k] = 0, c = 0; c < 3; c++) {
        xi[g->axis[c]] = o[c] * g->pitch[g->axis[c]];
        t->offset[k] += o[c] * g->step[c];
    }
    r2 = peri__dot3(xi, xi);
    peri__apply(make->turn, xi, out);
    for (c = 0; c < 3; c++) t->stencil[(size_t)c * n + at] = bond.xi[c] = (peri_real)out[c];
    t->stencil[3 * n + at] = bond.inv_r2 = (peri_real)(1 / r2);
    peri__bond_nn(&bond, t->stencil + 5 * n + 6 * at);
    t->stencil[4 * n + at] = (peri_real)peri__kernel(make->def, sqrt(r2) / b->spacing, b->horizon);
}

static void peri__stencil_make(peri__body *b, const peri__making *make) {
    int o[3], k = 0;
    o[0] = -make->comb.margin - 1;
    o[1] = o[2] = -make->comb.margin;
    while (peri__comb_next(&make->comb, make->delta, o) > 0) peri__stencil_bond(b, make, k++, o);
}

/* Which particle is in which lane: of a lattice, blocks begin at a particle each. */
static void peri__lanes_fill(peri__body *b, const peri__making *make) {
    peri__lanes *t = &b->lanes;
    int i, q = -1, l;
    for (i = 0; i < PERI__LANES * t->blocks; i++) t->who[i] = -1;
    for (i = 0; i < b->count; i++) {
        int cell = t->lattice ? peri__comb_cell(&make->comb, make->def->points + 3 * (size_t)i) : i;
        if (t->lattice ? q < 0 || cell >= t->base[q] + PERI__LANES : i % PERI__LANES == 0) {
            t->first[++q] = i;
            if (t->lattice) t->base[q] = cell;
        }
        l = PERI__LANES * q + cell - (t->lattice ? t->base[q] : PERI__LANES * q);
        t->who[l] = i;
        if (t->lattice) t->lane[i] = l;
        if (t->lattice) t->volume[cell] = b->volume[i];
    }
    t->first[t->blocks] = b->count;
}

/* Everything of the lanes but what their bonds are; those must be counted. */
static void peri__lanes_make(peri__body *b, const peri__making *make) {
    peri__lanes *t = &b->lanes;
    size_t k, n = (size_t)t->bonds, stride = (size_t)peri__model(b->matter.m.model)->stride;
    int i, q, c, most = 0;
    for (b->start[0] = 0, i = 0; i < b->count; i++) {
        int own = b->row[i + 1] - b->row[i];
        most = i % PERI__LANES && most > own ? most : own;
        b->start[i / PERI__LANES + 1] = b->start[i / PERI__LANES] + PERI__LANES * most;
    }
    for (c = 0; c < 3; c++) memset(b->xi[c], 0, (size_t)make->slots * sizeof(peri_real));
    memset(b->inv_r2, 0, (size_t)make->slots * sizeof(peri_real));
    memset(b->weight, 0, (size_t)make->slots * sizeof(peri_real));
    if (b->moment) memset(b->moment, 0, 21 * PERI__LANES * (size_t)t->blocks * sizeof(peri_real));
    for (c = 0; c < 3; c++) memset(t->x[c], 0, (size_t)t->length * sizeof(peri__spot));
    memset(t->coef, 0, stride * (size_t)t->length * sizeof(peri_real));
    if (t->lattice) memset(t->volume, 0, (size_t)t->length * sizeof(peri_real));
    for (q = 0; q < t->blocks && b->near; q++)
        for (k = (size_t)b->start[q]; k < (size_t)b->start[q + 1]; k++)
            b->near[k] = q * PERI__LANES + (int)(k % PERI__LANES);
    for (c = 0; c < 3; c++) t->xi[c] = t->lattice ? t->stencil + (size_t)c * n : b->xi[c];
    t->inv_r2 = t->lattice ? t->stencil + 3 * n : b->inv_r2;
    t->weight = t->lattice ? t->stencil + 4 * n : b->weight;
    t->nn = t->lattice ? t->stencil + 5 * n : NULL;
    t->start = b->start;
    t->near = b->near;
    peri__lanes_fill(b, make);
    if (t->lattice) peri__stencil_make(b, make);
}

/* A body leaves its lattice for good, as it must when its bonds are no longer all alike; from then on it is computed in
   lockstep. */
PERI__SHARED peri_result peri__lanes_leave(peri_world *w, peri__body *b) {
    peri__lanes *t = &b->lanes;
    size_t bytes = (size_t)b->start[(b->count + PERI__LANES - 1) / PERI__LANES] * sizeof *b->near;
    int i, k, q, c;
    if (!t->blocks || !t->lattice) return PERI_OK;
    b->near = (int *)peri__world_resize(NULL, 0, bytes, w);
    if (!b->near) return peri__no_memory(w, bytes);
    b->near_bytes = bytes;
    t->blocks = (b->count + PERI__LANES - 1) / PERI__LANES;
    t->lattice = 0;
    t->length = PERI__LANES * t->blocks;
    for (q = 0; q < t->blocks; q++)
        for (k = b->start[q]; k < b->start[q + 1]; k++) b->near[k] = q * PERI__LANES + k % PERI__LANES;
    for (i = 0; i < b->count; i++)
        for (k = b->row[i]; k < b->row[i + 1]; k++) b->near[peri__bond_at(&b->bonds, i, k)] = b->col[k];
    for (q = 0; q < t->blocks && b->moment; q++) {      /* no lane lies before its particle's: nothing is lost */
        peri_real block[21 * PERI__LANES];
        memset(block, 0, sizeof block);
        for (i = 0; i < PERI__LANES && q * PERI__LANES + i < b->count; i++)
            for (k = 0; k < 21; k++)
                block[PERI__LANES * k + i] = b->moment[peri__moment_at(&b->bonds, q * PERI__LANES + i, k)];
        memcpy(b->moment + 21 * PERI__LANES * (size_t)q, block, sizeof block);
    }
    for (c = 0; c < 3; c++) {
        memset(t->x[c], 0, (size_t)t->length * sizeof(peri__spot));
        t->xi[c] = b->xi[c];
    }
    memset(t->coef, 0, (size_t)peri__model(b->matter.m.model)->stride * (size_t)t->length * sizeof *t->coef);
    t->inv_r2 = b->inv_r2;
    t->weight = b->weight;
    t->near = b->near;
    t->lane = NULL;
    for (i = 0; i < t->length; i++) t->who[i] = i < b->count ? i : -1;
    for (q = 0; q < t->blocks; q++) t->first[q] = PERI__LANES * q;
    t->first[t->blocks] = b->count;
    peri__bonds_view(b);
    return PERI_OK;
}

/* Counts the bonds; refuses points that coincide. */
static peri_result peri__bonds_count(peri_world *w, peri__body *b, peri__making *make) {
    double total = 0, square, slots = 0;
    int i, closest, own, most = 0;
    for (i = 0; i < b->count; i++) {
        own = peri__grid_near(&make->grid, make->x, i, make->delta, NULL, &closest, &square);
        total += own;
        most = i % PERI__LANES && most > own ? most : own;
        if (i % PERI__LANES == PERI__LANES - 1 || i == b->count - 1) slots += PERI__LANES * most;
        if (closest >= 0 && square < 1e-6 * b->spacing * b->spacing)
            return peri__fail(&w->error, PERI_ERROR_GEOMETRY,
                              "points %d and %d coincide (%g m apart, spacing %g m): remove one", i, closest,
                              sqrt(square), b->spacing);
        if (total + w->bonds > (double)w->def.max_bonds)
            return peri__fail(
                &w->error, PERI_ERROR_LIMIT,
                "more than %d bonds: raise max_bonds of the world, or lower the horizon or check the spacing",
                w->def.max_bonds);
    }
    make->bonds = (int)total;
    if (peri__lanes_fit_for(b, make) && slots <= 1.5 * total && slots < 0x7fffffff) make->slots = (int)slots;
    if (make->slots) peri__comb_find(make->def, make->delta, &make->comb);
    return PERI_OK;
}

typedef struct peri__fill {
    peri__body *b;
    const peri__making *make;
    unsigned char *flags;
    int phase;
} peri__fill;

static void peri__fill_task(int begin, int end, void *context) {
    peri__fill *f = (peri__fill *)context;
    double square;
    int i, k, closest;
    for (i = begin; i < end; i++) {
        if (f->phase == 0) {
            peri__grid_near(&f->make->grid, f->make->x, i, f->make->delta, f->b->col + f->b->row[i], &closest, &square);
            for (k = f->b->row[i]; k < f->b->row[i + 1]; k++) peri__bond_make(f->b, f->make, i, k);
        } else {
            f->flags[i] = (unsigned char)peri__family_make(f->b, i);
        }
    }
}

typedef struct peri__bending {
    peri__body *b;
    int phase;
} peri__bending;

/* What particle i's own bonds give, then (second phase) what they give to the particles at their other ends. */
static void peri__bending_task(int begin, int end, void *context) {
    peri__bending *p = (peri__bending *)context;
    peri__body *b = p->b;
    size_t rows = (size_t)b->plate_rows;
    int i, k;
    for (i = begin; i < end; i++) {
        if (p->phase == 0) {
            const peri__matter *m = peri__matter_of(&b->bonds, &b->matter, i);
            double scale = b->rigidity * b->bonds.unit * (double)(b->volume[i] * peri__firmness(&b->bonds, i));
            b->plate_stiffness[i] = (peri_real)peri__plate_make(
                &b->bonds, i, b->spacing, scale * m->plane_mu, scale * m->plane_lambda, b->plate,
                b->plate_rest ? b->plate_rest + PERI__PLATE_REST * (size_t)i : NULL);
            continue;
        }
        for (k = b->row[i]; k < b->row[i + 1]; k++) {
            int low = b->row[b->col[k]], high = b->row[b->col[k] + 1] - 1;
            while (low < high) {    /* the same bond in the row of its other end */
                int middle = low + (high - low) / 2;
                if (b->col[middle] < i) low = middle + 1;
                else high = middle;
            }
            memcpy(b->plate + (2 * (size_t)k + 1) * rows, b->plate + 2 * (size_t)low * rows, rows * sizeof *b->plate);
        }
    }
}

/* Bending of a sheet: three numbers a bond at each end, five where the sheet is curved at rest. */
static peri_result peri__bending_make(peri_world *w, peri__body *b) {
    peri__bending task;
    size_t n = (size_t)b->count, bonds = (size_t)b->row[b->count], rows = 3, all;
    int i, k;
    for (i = 0; i < b->count; i++)
        for (k = b->row[i]; k < b->row[i + 1]; k++) {
            const peri_real *at = b->normal + 3 * (size_t)i;
            peri_real height = at[0] * b->xi[0][k] + at[1] * b->xi[1][k] + at[2] * b->xi[2][k];
            if (!(fabs((double)height) < 1e-4 * b->spacing)) rows = 5;
        }
    all = 2 * rows * bonds + n + (rows == 5 ? PERI__PLATE_REST * n : 0);
    b->plate_bytes = all * sizeof *b->plate;
    b->plate = (peri_real *)peri__spare_resize(NULL, 0, b->plate_bytes, w);
    if (!b->plate) return peri__no_memory(w, b->plate_bytes);
    b->plate_stiffness = b->plate + 2 * rows * bonds;
    b->plate_rest = rows == 5 ? b->plate_stiffness + n : NULL;
    b->plate_rows = (int)rows;
    peri__bonds_view(b);
    task.b = b;
    for (task.phase = 0; task.phase < 2; task.phase++)
        peri_parallel_for(&w->def.parallel, b->count, PERI__GRAIN, peri__bending_task, &task);
    return PERI_OK;
}

/* Volume of a particle that is given none, m^3. */
static double peri__default_volume(const peri_body_def *d) {
    double spacing = (double)d->spacing;
    if (d->form == PERI_FORM_SHEET) return spacing * spacing * (double)d->thickness;
    return spacing * spacing * spacing;
}

/* ---- rods: a cage of four ghosts around every point, half a spacing away, with bonds of the linear stretch model
   between neighbouring stations, of different gain. Diagonals bear the twist; the fibres along the rod, through the
   ghosts and through the points, are as stiff as bending and stretch still need. Whatever the material's model, a rod
   is elastic in these three: E A, E I, G J = 2 G I of a round section. What the cage without fibres bears of them was
   measured by static solutions, in S d^2, S d^4, S d^4 for ms = S (test_rods checks the whole): */

#define PERI__ROD_STRETCH 1.0795
#define PERI__ROD_BEND 0.06441
#define PERI__ROD_TWIST 0.063492

/* What a rod is made of: the stretch model with ms such that the cage's twist is right. */
static void peri__rod_material(const peri_body_def *d, peri_material *m) {
    double t = (double)d->thickness, spacing = (double)d->spacing, inertia = 3.14159265358979324 / 64 * t * t * t * t;
    double shear = (double)m->young / (2 * (1 + (double)m->poisson)), d4 = spacing * spacing * spacing * spacing;
    double s = 2 * shear * inertia / (PERI__ROD_TWIST * d4);
    peri_real restore = m->restore, density = m->density, low = m->healthy_min, high = m->healthy_max;
    *m = peri_material_linear(m->young, m->poisson, density);
    m->restore = restore;
    m->healthy_min = low;
    m->healthy_max = high;
    m->ls = 0;
    m->ms = (peri_real)s;
    m->mu = (peri_real)(s / 7.5);
}

/* Force per strain that the ghosts' and the points' fibres must add to the cage's, N. */
static void peri__rod_fibres(const peri__body *b, const peri_body_def *d, double fibre[2]) {
    double t = (double)d->thickness, pi = 3.14159265358979324, spacing = b->spacing, arm = spacing / 2;
    double young = (double)b->matter.m.young, s = (double)b->matter.m.ms, area = pi / 4 * t * t;
    double bend = (double)d->bending * young * pi / 64 * t * t * t * t;
    fibre[0] = (bend - PERI__ROD_BEND * s * spacing * spacing * spacing * spacing) / (2 * arm * arm);
    if (fibre[0] < 0) fibre[0] = 0;
    fibre[1] = young * area - PERI__ROD_STRETCH * s * spacing * spacing - PERI__GHOSTS * fibre[0];
    if (fibre[1] < 0) fibre[1] = 0;
}

/* Part of a section's stretching that each ghost bears: outer forces are dealt out so, for only weak bonds would carry
   along the rod what acts on its points alone. */
static double peri__ghost_part(const peri__body *b) {
    double cage = PERI__ROD_STRETCH * (double)b->matter.m.ms * b->spacing * b->spacing;
    cage += PERI__GHOSTS * b->fibre[0];
    return cage / (cage + b->fibre[1]) / PERI__GHOSTS;
}

/* Gain of the bond from particle i to j: fibres by what they must bear; the diagonals between neighbouring ghosts'
   lines bear the twist; stiff bonds keep a section in shape; weak ones tie it to the line. */
static double peri__rod_gain(const peri__body *b, int i, int j, double even, double fibre_gain) {
    int n = b->stations, a = (i - n) % PERI__GHOSTS, c = (j - n) % PERI__GHOSTS;
    if (peri__station(n, i) == peri__station(n, j)) return 10;
    if (i < n && j < n) return fibre_gain;
    if (i < n || j < n) return 0.05 * even;
    return a == c ? fibre_gain : (a - c) % 2 ? even : 0;
}

/* Bonds of the last gaps would be stiffer, for their families are smaller: they are given what the others have. */
static void peri__rod_gains(peri__body *b) {
    double cube = b->spacing * b->spacing * b->spacing, inside = 2.0 / (3 * PERI__GHOSTS + 2);
    int i, k;
    for (i = 0; i < b->count; i++)
        for (k = b->row[i]; k < b->row[i + 1]; k++) {
            double bond = (double)b->matter.m.ms * cube *
                          (double)(b->weight[k] * (b->share[i] + b->share[b->col[k]]));
            double fibre = b->fibre[i < b->stations] / (2 * bond * sqrt((double)b->inv_r2[k]));
            double even = inside / (double)(b->share[i] + b->share[b->col[k]]);
            b->gain[k] = (peri_real)peri__rod_gain(b, i, b->col[k], even, fibre);
        }
}

/* A unit vector across the unit vector t, as near to v as can be. */
static void peri__frame_across(const double t[3], const double v[3], double out[3]) {
    double along = peri__dot3(t, v), length;
    int c, least = 0;
    for (c = 0; c < 3; c++) out[c] = v[c] - along * t[c];
    length = sqrt(peri__dot3(out, out));
    if (!(length > 1e-3)) {
        for (c = 1; c < 3; c++)
            if (fabs(t[c]) < fabs(t[least])) least = c;
        for (c = 0; c < 3; c++) out[c] = (c == least) - t[least] * t[c];
        length = sqrt(peri__dot3(out, out));
    }
    for (c = 0; c < 3; c++) out[c] /= length;
}

/* Direction of a line of n points at point i; 0 where it turns back on itself. */
static int peri__line_tangent(const double *x, int n, int closed, int i, double t[3]) {
    int before = i > 0 ? i - 1 : closed ? n - 1 : 0, after = i < n - 1 ? i + 1 : closed ? 0 : n - 1, c;
    double length;
    for (c = 0; c < 3; c++) t[c] = x[3 * (size_t)after + (size_t)c] - x[3 * (size_t)before + (size_t)c];
    length = sqrt(peri__dot3(t, t));
    for (c = 0; c < 3 && length > 0; c++) t[c] /= length;
    return length > 0;
}

/* Ghosts of a line of n points, PERI__GHOSTS each, at `arm` from it: frames carried along with the least rotation,
   the first ghost of the first point as near to `first` as can be. */
static int peri__ghosts_place(const double *x, int n, int closed, const double first[3], double arm, double *ghosts) {
    double t[3], across[3], other[3];
    int i, c;
    memcpy(across, first, sizeof across);
    for (i = 0; i < n; i++, ghosts += 3 * PERI__GHOSTS) {
        if (!peri__line_tangent(x, n, closed, i, t)) return 0;
        peri__frame_across(t, across, across);
        peri__cross(t, across, other);
        for (c = 0; c < 3; c++) {
            double centre = x[3 * (size_t)i + (size_t)c];
            ghosts[c] = centre + arm * across[c];
            ghosts[3 + c] = centre + arm * other[c];
            ghosts[6 + c] = centre - arm * across[c];
            ghosts[9 + c] = centre - arm * other[c];
        }
    }
    return 1;
}

/* The definition of a rod with its ghosts: a body of 5 n points in memory that is left to the caller. */
static peri_result peri__rod_expand(peri_world *w, const peri_body_def *d, peri_body_def *rod, peri__making *make) {
    size_t n = (size_t)d->count, all = n * (1 + PERI__GHOSTS), k;
    peri_real *points;
    unsigned char *fixed;
    double *x, up[3] = {0, 0, 1};
    *rod = *d;
    make->rod_bytes = all * (3 * sizeof(peri_real) + 1) + 3 * all * sizeof(double);
    make->rod = peri__world_resize(NULL, 0, make->rod_bytes, w);
    if (!make->rod) return peri__no_memory(w, make->rod_bytes);
    x = (double *)make->rod;
    points = (peri_real *)(void *)(x + 3 * all);
    fixed = (unsigned char *)(points + 3 * all);
    for (k = 0; k < 3 * n; k++) x[k] = (double)d->points[k];
    if (!peri__ghosts_place(x, d->count, d->closed, up, (double)d->spacing / 2, x + 3 * n))
        return peri__fail(&w->error, PERI_ERROR_GEOMETRY, "the points of the rod turn back on themselves");
    for (k = 0; k < 3 * all; k++) points[k] = (peri_real)x[k];
    for (k = 0; k < all; k++) fixed[k] = d->fixed ? d->fixed[peri__station(d->count, (int)k)] : 0;
    rod->points = points;
    rod->fixed = fixed;
    rod->count = (int)all;
    rod->volumes = NULL;
    rod->horizon = PERI__R(1.75);
    rod->kernel = PERI_KERNEL_CONSTANT;
    rod->partial_volume = 0;
    return PERI_OK;
}

/* Mass of particle i of a rod: ghosts have what gives the section its moment of inertia, points the rest, kg. */
static double peri__rod_mass(const peri__body *b, const peri__making *make, int i) {
    const peri_body_def *d = make->given;
    double t = (double)d->thickness, pi = 3.14159265358979324, arm = b->spacing / 2;
    double usual = pi / 4 * t * t * b->spacing, station;
    int at = peri__station(b->stations, i);
    double share = t * t / 8 / (PERI__GHOSTS * arm * arm);      /* rho J / (rho A), J = 2 I, over the ghosts' arms */
    station = (double)b->matter.m.density * (d->volumes ? (double)d->volumes[at] : usual);
    return station * (i < b->stations ? 1 - PERI__GHOSTS * share : share);
}

/* What peri__matter_make must know of the form: 0 no sheet, 1 a sheet, 2 one without a plate's bending. */
static int peri__sheet_kind(const peri_body_def *d) {
    return d->form != PERI_FORM_SHEET ? 0 : (double)d->bending > 0 ? 1 : 2;
}

/* Materials and stiffness of every particle, where they differ. */
static void peri__maps_make(peri_world *w, peri__body *b, const peri_body_def *d) {
    int k;
    if (b->matters) b->matters[0] = b->matter;
    for (k = 0; b->matters && k < d->material_count; k++)
        peri__matter_make(&((peri__stored_material *)(void *)peri__slot_at(&w->materials,
                                                                          (int)d->materials[k].index1 - 1))->m,
                          peri__sheet_kind(d), &b->matters[k + 1]);
    if (b->kind) memcpy(b->kind, d->material_of, (size_t)b->count);
    if (b->firmness) memcpy(b->firmness, d->stiffness, (size_t)b->count * sizeof *b->firmness);
}

/* Turns the normals of a sheet to one side, from bond to bond, so that contacts can tell its sides apart. b->surface is
   the queue: it is not filled yet. */
static void peri__sheet_orient(peri__body *b, unsigned char *flags) {
    int seed, k, c, head = 0, tail = 0;
    for (seed = 0; seed < b->count; seed++) {
        if (flags[seed] & PERI__ORIENTED) continue;
        flags[seed] |= PERI__ORIENTED;
        for (b->surface[tail++] = seed; head < tail; head++) {
            const peri_real *n = b->normal + 3 * (size_t)b->surface[head];
            for (k = b->row[b->surface[head]]; k < b->row[b->surface[head] + 1]; k++) {
                peri_real *next = b->normal + 3 * (size_t)b->col[k];
                if (flags[b->col[k]] & PERI__ORIENTED) continue;
                flags[b->col[k]] |= PERI__ORIENTED;
                if (n[0] * next[0] + n[1] * next[1] + n[2] * next[2] < 0)
                    for (c = 0; c < 3; c++) next[c] = -next[c];
                b->surface[tail++] = b->col[k];
            }
        }
    }
}

/* Fills the block of a body: rows, bonds, families. flags: of its particles, out. */
static peri_result peri__bonds_make(peri_world *w, peri__body *b, peri__making *make, unsigned char *flags) {
    peri__fill fill;
    double square;
    int i, c, closest;
    b->block_bytes = peri__block_layout(b, NULL, make);
    b->block = peri__world_resize(NULL, 0, b->block_bytes, w);
    if (!b->block) return peri__no_memory(w, b->block_bytes);
    peri__block_layout(b, (char *)b->block, make);
    peri__maps_make(w, b, make->def);
    b->row[0] = 0;
    for (i = 0; i < b->count; i++) {
        double own = peri__default_volume(make->def), cube = b->spacing * b->spacing * b->spacing;
        b->volume[i] = (peri_real)((make->def->volumes ? (double)make->def->volumes[i] : own) / cube);
        for (c = 0; c < 3; c++) b->points[3 * (size_t)i + (size_t)c] = make->def->points[3 * (size_t)i + (size_t)c];
        b->row[i + 1] = b->row[i] + peri__grid_near(&make->grid, make->x, i, make->delta, NULL, &closest, &square);
    }
    peri__bonds_view(b);
    if (make->slots) peri__lanes_make(b, make);
    fill.b = b;
    fill.make = make;
    fill.flags = flags;
    for (fill.phase = 0; fill.phase < 2; fill.phase++)
        peri_parallel_for(&w->def.parallel, b->count, PERI__GRAIN, peri__fill_task, &fill);
    if (b->stations) peri__rod_gains(b);
    if (b->normal) peri__sheet_orient(b, flags);
    return PERI_OK;
}

/* ---- implementation 6: bodies ------------------------------------------------------------------------------------ */

peri_body_def peri_default_body_def(void) {
    peri_body_def d;
    memset(&d, 0, sizeof d);
    d.cookie = PERI__COOKIE + 2;
    d.horizon = PERI__R(1.75);
    d.kernel = PERI_KERNEL_POWER;
    d.kernel_power = PERI__R(0.7);
    d.rotation.w = 1;
    d.contact_radius = PERI__R(0.5);
    d.friction = PERI__R(0.5);
    d.bending = 1;
    d.group = 1;
    d.touches = ~(uint32_t)0;
    return d;
}

peri_body_def peri_default_sheet_def(peri_real thickness) {
    peri_body_def d = peri_default_body_def();
    d.form = PERI_FORM_SHEET;
    d.thickness = thickness;
    d.kernel = PERI_KERNEL_CONSTANT;
    return d;
}

peri_body_def peri_default_rod_def(peri_real diameter) {
    peri_body_def d = peri_default_body_def();
    d.form = PERI_FORM_ROD;
    d.thickness = diameter;
    return d;
}

static peri_result peri__check_quat(const char *name, peri_quat q, peri_error *err) {
    double n2 = (double)q.x * (double)q.x + (double)q.y * (double)q.y + (double)q.z * (double)q.z +
                (double)q.w * (double)q.w;
    if (fabs(n2 - 1) < 2e-3) return PERI_OK;
    return peri__fail(err, PERI_ERROR_VALUE, "%s is (%g, %g, %g, %g), of length %g; it must be a unit quaternion", name,
                      (double)q.x, (double)q.y, (double)q.z, (double)q.w, sqrt(n2));
}

static void peri__vec(peri_vec3 v, double out[3]) {
    out[0] = (double)v.x;
    out[1] = (double)v.y;
    out[2] = (double)v.z;
}

static peri_result peri__check_body_arrays(const peri_body_def *d, peri_error *err) {
    double t = (double)d->thickness,
           usual = d->form == PERI_FORM_ROD ? 0.785 * t * t * (double)d->spacing : peri__default_volume(d),
           most = 1e3 * usual, least = 1e-3 * usual;
    peri_result bad = peri__finite3("points", d->points, d->count, err);
    int i;
    for (i = 0; i < d->count && d->volumes && !bad; i++)
        if (!((double)d->volumes[i] > least && (double)d->volumes[i] < most))
            bad = peri__fail(err, PERI_ERROR_VALUE,
                             "volumes[%d] is %g m^3; it must lie between %g and %g (usual here: %g)", i,
                             (double)d->volumes[i], least, most, least * 1e3);
    return bad;
}

/* Do two bases have the same value everywhere, for the same reason? */
static int peri__basis_same(const peri_basis *a, const peri_basis *b) {
    int k, same = a->user == b->user && a->context == b->context && !(a->svk < b->svk) && !(a->svk > b->svk);
    for (k = 0; k < PERI_BASIS_MAX; k++)
        same = same && !(a->a[k] < b->a[k]) && !(a->a[k] > b->a[k]) && !(a->b[k] < b->b[k]) && !(a->b[k] > b->b[k]);
    return same;
}

static const peri_material *peri__material_find(const peri_world *w, peri_material_id id) {
    peri__slot *slot = peri__slot_find(&w->materials, id.index1, id.generation);
    return slot ? &((peri__stored_material *)(void *)slot)->m : NULL;
}

/* The further materials of a body and who is made of them. */
static peri_result peri__check_materials(const peri_world *w, const peri_body_def *d, peri_error *err) {
    const peri_material *first = peri__material_find(w, d->material), *m;
    int k;
    if (d->material_count < 0 || d->material_count > 255)
        return peri__fail(err, PERI_ERROR_VALUE, "material_count is %d; it must lie between 0 and 255",
                          d->material_count);
    if (d->material_count && !d->materials)
        return peri__fail(err, PERI_ERROR_ARGUMENT, "materials is NULL, but material_count is %d", d->material_count);
    for (k = 0; k < d->material_count; k++) {
        m = peri__material_find(w, d->materials[k]);
        if (!m)
            return peri__fail(err, PERI_ERROR_ID, "materials[%d], (%u, %u), does not exist in this world", k,
                              (unsigned)d->materials[k].index1, (unsigned)d->materials[k].generation);
        if (m->model != first->model)
            return peri__fail(err, PERI_ERROR_ARGUMENT,
                              "materials[%d] is of the %s model and material of the %s model: a body has one model", k,
                              peri__model(m->model)->name, peri__model(first->model)->name);
        if (m->model == PERI_MODEL_STRETCH && !peri__basis_same(&m->h, &first->h))
            return peri__fail(err, PERI_ERROR_ARGUMENT,
                              "materials[%d] has another h than material: in the stretch model g, ls and ms may differ "
                              "within a body, h may not (the correspondence model takes any)", k);
    }
    for (k = 0; k < d->count && d->material_of; k++)
        if (d->material_of[k] > d->material_count)
            return peri__fail(err, PERI_ERROR_INDEX, "material_of[%d] is %d, but material_count is %d", k,
                              d->material_of[k], d->material_count);
    return PERI_OK;
}

/* Is a material of the body anisotropic? */
static int peri__any_anisotropic(const peri_world *w, const peri_body_def *d) {
    const peri_material *m = peri__material_find(w, d->material);
    int k, any = m->anisotropic;
    for (k = 0; k < d->material_count && d->material_of; k++)
        any = any || peri__material_find(w, d->materials[k])->anisotropic;
    return any && m->model == PERI_MODEL_STRETCH;
}

/* What differs from particle to particle. */
static peri_result peri__check_maps(const peri_world *w, const peri_body_def *d, peri_error *err) {
    int i, a, b, c;
    peri_result bad = peri__check_materials(w, d, err);
    for (i = 0; i < d->count && d->stiffness && !bad; i++)
        if (!((double)d->stiffness[i] >= 0.99e-6 && (double)d->stiffness[i] <= 1.01e6))
            bad = peri__fail(err, PERI_ERROR_VALUE, "stiffness[%d] is %g; it must lie between 1e-6 and 1e6", i,
                             (double)d->stiffness[i]);
    if (!bad && d->directions && !peri__any_anisotropic(w, d))
        bad = peri__fail(err, PERI_ERROR_ARGUMENT,
                         "directions are given, but no material of the body is anisotropic (stretch model, "
                         "anisotropic = 1)");
    for (i = 0; i < d->count && d->directions && !bad; i++)
        for (a = 0; a < 3 && !bad; a++)
            for (b = a; b < 3 && !bad; b++) {
                const peri_real *r = d->directions + 9 * (size_t)i;
                double dot = a == b ? -1 : 0;
                for (c = 0; c < 3; c++) dot += (double)r[3 * c + a] * (double)r[3 * c + b];
                if (!(fabs(dot) < 1e-3))
                    bad = peri__fail(err, PERI_ERROR_VALUE,
                                     "directions of particle %d: columns %d and %d are not orthonormal (off by %g)", i,
                                     a, b, dot);
            }
    return bad;
}

static peri_result peri__check_rod(const peri_body_def *d, peri_error *err) {
    if (d->material_of || d->stiffness || d->directions)
        return peri__fail(err, PERI_ERROR_ARGUMENT,
                          "material_of, stiffness and directions are for solids and sheets: a rod has one material");
    if (!((double)d->thickness <= 1.001 * (double)d->spacing))
        return peri__fail(err, PERI_ERROR_VALUE, "thickness is %g m, more than a spacing (%g m): sample a thick rod "
                          "as a solid", (double)d->thickness, (double)d->spacing);
    return PERI_OK;
}

static peri_result peri__check_body_def(const peri_world *w, const peri_body_def *d, peri_error *err) {
    peri_result bad;
    if (!d) return peri__fail(err, PERI_ERROR_ARGUMENT, "the body's definition is NULL");
    if (d->cookie != PERI__COOKIE + 2)
        return peri__fail(err, PERI_ERROR_ARGUMENT, "the body's definition was not made by peri_default_body_def");
    if (!d->points) return peri__fail(err, PERI_ERROR_ARGUMENT, "points is NULL");
    if (d->count < 1) return peri__fail(err, PERI_ERROR_VALUE, "count is %d; a body has at least one point", d->count);
    if (d->form == PERI_FORM_ROD && d->count < 2)
        return peri__fail(err, PERI_ERROR_VALUE, "count is %d; a rod has at least two points", d->count);
    if (d->count > (w->def.max_particles - w->particles) / (d->form == PERI_FORM_ROD ? 1 + PERI__GHOSTS : 1))
        return peri__fail(err, PERI_ERROR_LIMIT, "%d particles and %d more pass max_particles = %d of the world",
                          w->particles, d->count, w->def.max_particles);
    if (!peri__material_find(w, d->material))
        return peri__fail(err, PERI_ERROR_ID, "material (%u, %u) does not exist in this world",
                          (unsigned)d->material.index1, (unsigned)d->material.generation);
    bad = peri__check_range("spacing", (double)d->spacing, 1e-9, 1e9, err);
    if (!bad) bad = peri__check_range("horizon", (double)d->horizon, 1, PERI__HORIZON_MAX, err);
    if (!bad) bad = peri__check_enum("form", (int)d->form, (int)PERI_FORM_ROD, err);
    if (!bad && d->form != PERI_FORM_SOLID) {
        bad = peri__check_range("thickness of a sheet or rod", (double)d->thickness, 1e-12, 1e9, err);
        if (!bad && d->form == PERI_FORM_ROD) bad = peri__check_rod(d, err);
        if (!bad) bad = peri__check_range("bending", (double)d->bending, 0, 1e6, err);
    }
    if (!bad) bad = peri__check_enum("kernel", (int)d->kernel, (int)PERI_KERNEL_SHIFTED, err);
    if (!bad) bad = peri__check_range("kernel_power", (double)d->kernel_power, -4, 4, err);
    if (!bad) bad = peri__check_range("contact_radius", (double)d->contact_radius, 0, 2, err);
    if (!bad) bad = peri__check_range("friction of the body", (double)d->friction, 0, 10, err);
    if (!bad) bad = peri__finite_vec("position", d->position, err);
    if (!bad) bad = peri__finite_vec("velocity", d->velocity, err);
    if (!bad) bad = peri__finite_vec("spin", d->spin, err);
    if (!bad) bad = peri__check_quat("rotation", d->rotation, err);
    if (!bad) bad = peri__check_body_arrays(d, err);
    return bad ? bad : peri__check_maps(w, d, err);
}

/* What particle i gives to the stiffness of a bond of the given gain, Pa. */
static double peri__end_stiffness(const peri__body *b, int i, double gain) {
    const peri__matter *m = b->matters ? b->matters + b->kind[i] : &b->matter;
    return (m->stiffness_g + gain * m->stiffness_h) * (b->firmness ? (double)b->firmness[i] : 1);
}

/* What bending adds to a bond's stiffness, N/m: |sum L u|^2 <= sum L^2 sum |u|^2, a bound that is never met. 0.3 of
   it takes the fewest evaluations (sheets as thick as their spacing and 10 times thicker: half of those with 1; 0.1
   no fewer). */
static double peri__bend_stiffness(const peri__body *b, int i, int k) {
    return b->plate ? 0.3 * ((double)b->plate_stiffness[i] + (double)b->plate_stiffness[b->col[k]]) : 0;
}

/* Stiffness of bond k of particle i in the constant matrix (PP section 4.1, SH (23)), N/m. */
static double peri__bond_stiffness(const peri__body *b, int i, int k) {
    double gain = b->gain ? (double)b->gain[k] : 1, cube = b->spacing * b->spacing * b->spacing, both;
    size_t at = peri__bond_at(&b->bonds, i, k);
    int j = b->col[k];
    if (!b->matters && !b->firmness && !b->far_gain)
        return cube * (double)(b->weight[at] * b->inv_r2[at] * (b->share[i] + b->share[j])) *
                   (b->matter.stiffness_g + gain * b->matter.stiffness_h) +
               peri__bend_stiffness(b, i, k);
    both = (double)b->share[i] * peri__end_stiffness(b, i, gain) +
           (double)b->share[j] * peri__end_stiffness(b, j, b->far_gain ? (double)b->far_gain[k] : gain);
    return cube * (double)(b->weight[at] * b->inv_r2[at]) * both + peri__bend_stiffness(b, i, k);
}

/* State of the new particles: called when nothing can fail any more. */
static void peri__body_state(peri_world *w, peri__body *b, const peri__making *make, const unsigned char *flags) {
    const peri_body_def *d = make->def;
    double centre[3] = {0, 0, 0}, spin[3], velocity[3], arm[3], turn[3];
    size_t i, at;
    int c;
    peri__vec(d->spin, spin);
    peri__vec(d->velocity, velocity);
    b->mass = 0;
    for (i = 0; i < (size_t)b->count; i++) {
        const peri__matter *matter = b->matters ? b->matters + b->kind[i] : &b->matter;
        double m = (double)matter->m.density * b->bonds.unit * (double)b->volume[i];
        if (b->stations) m = peri__rod_mass(b, make, (int)i);
        w->mass[(size_t)b->first + i] = (peri_real)m;
        b->mass += m;
        for (c = 0; c < 3; c++) centre[c] += m * make->x[3 * i + (size_t)c];
    }
    for (i = 0; i < (size_t)b->count; i++) {
        double stiffness = 0;
        for (c = b->row[i]; c < b->row[i + 1]; c++) stiffness += peri__bond_stiffness(b, (int)i, c);
        b->stiffness[i] = (peri_real)stiffness;
        b->pinned[i] = 0;
        at = (size_t)b->first + i;
        w->flags[at] = flags[i];
        if ((flags[i] & PERI__SURFACE || b->stations) && (int)i < peri__real_count(b))
            b->surface[b->surface_count++] = (int)i;
        if (d->fixed && d->fixed[i]) w->flags[at] |= PERI__FIXED, b->fixed++;
        b->singular += (flags[i] & PERI__SINGULAR) != 0;
        w->mode[at] = flags[i] & PERI__SINGULAR ? PERI__FALLBACK : PERI__MAIN;
        for (c = 0; c < 3; c++) arm[c] = make->x[3 * i + (size_t)c] - centre[c] / b->mass;
        peri__cross(spin, arm, turn);
        for (c = 0; c < 3; c++) {
            size_t k = 3 * at + (size_t)c;
            w->x[k] = w->x0[k] = make->x[3 * i + (size_t)c];
            w->out[k] = (peri_real)w->x[k];
            w->v[k] = w->v0[k] = w->flags[at] & PERI__FIXED ? 0 : (peri_real)(velocity[c] + turn[c]);
            if (w->wants & PERI__WANT_FORCE) w->force[k] = 0;
        }
    }
}

/* Everything of a new body that can fail, into *b; on failure nothing is left behind. */
static peri_result peri__body_build(peri_world *w, peri__body *b, peri__making *make, unsigned char **flags) {
    const peri_body_def *d = make->def;
    double move[3], p[3];
    unsigned wants = PERI__WANT_STATE | PERI__WANT_SOLVE | PERI__WANT_LBFGS;
    peri_result bad;
    int i, c;
    make->x_bytes = 3 * (size_t)d->count * sizeof(double);
    make->x = (double *)peri__world_resize(NULL, 0, make->x_bytes, w);
    if (!make->x) return peri__no_memory(w, make->x_bytes);
    *flags = (unsigned char *)peri__world_resize(NULL, 0, (size_t)d->count, w);
    if (!*flags) return peri__no_memory(w, (size_t)d->count);
    peri__quat_matrix(d->rotation, make->turn);
    peri__vec(d->position, move);
    for (i = 0; i < d->count; i++) {
        for (c = 0; c < 3; c++) p[c] = (double)d->points[3 * (size_t)i + (size_t)c];
        peri__apply(make->turn, p, make->x + 3 * (size_t)i);
        for (c = 0; c < 3; c++) make->x[3 * (size_t)i + (size_t)c] += move[c];
    }
    /* strictly inside the horizon, and clear of rounding where a lattice distance equals it */
    make->delta = (double)d->horizon * (double)d->spacing * (1 - 1e-5);
    bad = peri__grid_reserve(w, &make->grid, d->count);
    if (bad) return bad;
    make->grid.stations = b->stations;
    make->grid.closed = b->closed;
    peri__grid_fill(&make->grid, make->x, NULL, d->count, (double)d->horizon * (double)d->spacing);
    bad = peri__bonds_count(w, b, make);
    if (!bad) bad = peri__bonds_make(w, b, make, *flags);
    if (!bad && b->rigidity > 0) bad = peri__bending_make(w, b);
    if (bad) return bad;
    if (w->def.integrator == PERI_BDF2) wants |= PERI__WANT_HISTORY;
    if (b->plate) wants |= PERI__WANT_PLATE;
    if (b->moment && !b->normal) wants |= PERI__WANT_BRACE;
    for (i = 0; i < d->count; i++)
        if ((*flags)[i] & PERI__SINGULAR) wants |= PERI__WANT_SPECIAL;
    return peri__reserve(w, w->particles + d->count, wants, peri__model(b->matter.m.model)->stride);
}

/* The bonds with the pointers that follow the particle arrays. */
static const peri__bonds *peri__view(const peri_world *w, peri__body *b) {
    b->bonds.mode = w->mode + b->first;
    b->bonds.special = w->special ? w->special + 9 * (size_t)b->first : NULL;
    b->bonds.brace = b->braced ? w->brace + b->first : NULL;
    return &b->bonds;
}

peri_material_id peri_material_create(peri_world *w, const peri_material *material) {
    peri_material_id id = {0, 0};
    peri__stored_material *slot;
    if (!w) return id;
    if (peri_material_check(material, &w->error)) {
        peri__report(w, w->error.code);
        return id;
    }
    slot = (peri__stored_material *)(void *)peri__slot_take(w, &w->materials);
    if (!slot) {
        peri__report(w, w->error.code);
        return id;
    }
    slot->m = *material;
    id.index1 = peri__slot_use(&w->materials, &slot->slot);
    id.generation = slot->slot.generation;
    return id;
}

peri_body_id peri_body_create(peri_world *w, const peri_body_def *d) {
    peri_body_id id = {0, 0};
    peri__body b, *slot = NULL;
    peri__making make;
    peri_body_def rod;
    unsigned char *flags = NULL;
    peri_result bad;
    if (!w) return id;
    memset(&b, 0, sizeof b);
    memset(&make, 0, sizeof make);
    make.given = d;
    bad = peri__check_body_def(w, d, &w->error);
    if (!bad) {
        slot = (peri__body *)(void *)peri__slot_take(w, &w->bodies);
        if (!slot) bad = w->error.code;
    }
    if (!bad) {
        if (d->form == PERI_FORM_ROD) {
            b.stations = d->count;
            b.closed = d->closed != 0;
            bad = peri__rod_expand(w, d, &rod, &make);
            d = &rod;
        }
    }
    if (!bad) {
        peri_material matter = *peri__material_find(w, d->material);
        make.def = d;
        b.first = w->particles;
        b.count = d->count;
        b.form = d->form;
        b.spacing = (double)d->spacing;
        if (b.stations) peri__rod_material(d, &matter);
        peri__matter_make(&matter, peri__sheet_kind(d), &b.matter);
        if (b.stations) peri__rod_fibres(&b, d, b.fibre);
        if (b.stations) b.ghost_part = peri__ghost_part(&b);
        make.anisotropic = b.stations || peri__any_anisotropic(w, d);
        if (d->form == PERI_FORM_SHEET)
            b.rigidity = (double)d->bending * (double)d->thickness * (double)d->thickness / 12;
        b.horizon = (double)d->horizon;
        b.radius = (double)d->contact_radius * b.spacing;
        b.rotation = d->rotation;
        b.friction = (double)d->friction;
        b.self_contact = d->self_contact != 0;
        b.group = d->group;
        b.touches = d->touches;
        bad = peri__bodies_reserve(w);
        if (!bad) bad = peri__body_build(w, &b, &make, &flags);
    }
    if (!bad) {
        b.slot = slot->slot;
        *slot = b;
        peri__bonds_view(slot);
        peri__body_state(w, slot, &make, flags);
        w->particles += b.count;
        w->bonds += make.bonds;
        w->self_contacts += b.self_contact;
        id.index1 = peri__slot_use(&w->bodies, &slot->slot);
        id.generation = slot->slot.generation;
    } else {
        peri__drop(w, b.block, b.block_bytes);
        if (b.plate) peri__spare_resize(b.plate, b.plate_bytes, 0, w);
        peri__report(w, bad);
    }
    if (make.grid.start) peri__grid_free(w, &make.grid);
    peri__drop(w, make.x, make.x_bytes);
    if (flags) peri__drop(w, flags, (size_t)d->count);
    peri__drop(w, make.rod, make.rod_bytes);
    return id;
}

/* Moves the particle arrays behind a removed range down. */
static void peri__compact(peri_world *w, int first, int count) {
    void **array[PERI__ROWS + 1];
    size_t bytes[PERI__ROWS + 1];
    unsigned want[PERI__ROWS + 1];
    int n = peri__particle_rows(w, array, bytes, want), k;
    size_t from = (size_t)first + (size_t)count, rest = (size_t)w->particles - from;
    for (k = 0; k < n; k++)
        if (w->row_bytes[k])
            memmove((char *)*array[k] + (size_t)first * bytes[k], (char *)*array[k] + from * bytes[k], rest * bytes[k]);
    w->particles -= count;
    for (k = 0; k < w->bodies.capacity; k++) {
        peri__body *b = peri__body_at(w, k);
        if (b && b->first > first) b->first -= count;
    }
}

static void peri__attachments_drop(peri_world *w, int body, int collider);

/* Forgets what touches particles first .. first + count - 1 of body k (count < 0: all), or target `target` (-1: none).
   Bodies that had to do with it wake. */
static void peri__holds_forget(peri_world *w, int k, int first, int count, int target) {
    int i, kept = 0;
    for (i = 0; i < w->hold_count; i++) {
        const peri__hold *t = &w->holds[i];
        int own = t->body == k && (count < 0 || (t->particle >= first && t->particle < first + count));
        if (!own && t->target != target && t->target != PERI__TARGET_BODY + k) {
            w->holds[kept++] = *t;
            continue;
        }
        peri__wake(w, peri__body_at(w, t->body));
        if (t->target >= PERI__TARGET_BODY) peri__wake(w, peri__body_at(w, t->target - PERI__TARGET_BODY));
    }
    w->hold_count = kept;
}

peri_result peri_body_destroy(peri_world *w, peri_body_id id) {
    peri__body *b = peri__body_find(w, id);
    int first, count, bonds;
    if (!b) return peri__no_body(w, id);
#ifndef PERI_NO_SKINNING
    peri__skins_drop(w, b);
#endif
    peri__wake(w, b);
    peri__attachments_drop(w, (int)id.index1 - 1, -1);
    peri__holds_forget(w, (int)id.index1 - 1, 0, -1, -1);
    w->self_contacts -= b->self_contact;
    first = b->first;
    count = b->count;
    bonds = b->row[b->count];
    peri__body_drop(w, b);
    peri__slot_free(&w->bodies, &b->slot);
    peri__compact(w, first, count);
    w->bonds -= bonds;
    return PERI_OK;
}

int peri_body_is_valid(const peri_world *w, peri_body_id id) { return peri__body_find(w, id) != NULL; }

int peri_body_count(const peri_world *w, peri_body_id id) {
    peri__body *b = peri__body_find(w, id);
    return b ? peri__real_count(b) : 0;
}

const peri_real *peri_body_positions(const peri_world *w, peri_body_id id) {
    peri__body *b = peri__body_find(w, id);
    return b ? w->out + 3 * (size_t)b->first : NULL;
}

const peri_real *peri_body_velocities(const peri_world *w, peri_body_id id) {
    peri__body *b = peri__body_find(w, id);
    return b ? w->v + 3 * (size_t)b->first : NULL;
}

/* First ghost of a rod's point, in the world's arrays. */
static size_t peri__ghost(const peri__body *b, int point) {
    return (size_t)(b->first + b->stations + PERI__GHOSTS * point);
}

/* The ghosts of a rod whose points were put elsewhere: frames made anew, with the least rotation along the rod, from
   the rest's first frame turned as the points are on the whole: a rod that is only put elsewhere is at rest there. */
static void peri__rod_follow(peri_world *w, peri__body *b) {
    size_t k, at = 3 * peri__ghost(b, 0), end = at + 3 * PERI__GHOSTS * (size_t)b->stations;
    const double *x = w->x + 3 * (size_t)b->first;
    const peri_real *rest = b->points;
    double a[9] = {0, 0, 0, 0, 0, 0, 0, 0, 0}, u[9], sigma[3], v[9], arm[3], first[3];
    int i, c, d, n = b->stations;
    for (i = 1; i < n; i++)     /* gaps, so that where the rod is does not matter */
        for (c = 0; c < 3; c++)
            for (d = 0; d < 3; d++)
                a[3 * c + d] += (x[3 * i + c] - x[3 * i - 3 + c]) * (double)(rest[3 * i + d] - rest[3 * i - 3 + d]);
    peri_svd3(a, u, sigma, v);
    for (c = 0; c < 3; c++) arm[c] = (double)(rest[3 * n + c] - rest[c]);
    peri__apply_back(v, arm, first);
    peri__apply(u, first, arm);
    peri__ghosts_place(x, n, b->closed, arm, b->spacing / 2, w->x + at);
    for (k = at; k < end; k++) {
        w->x0[k] = w->x[k];
        w->out[k] = (peri_real)w->x[k];
    }
}

/* Checks what the setters below share; on success *out is the body. */
static peri_result peri__range(peri_world *w, peri_body_id id, int first, int count, const char *name,
                               const peri_real *values, peri__body **out) {
    peri__body *b = peri__body_find(w, id);
    peri_result bad = PERI_OK;
    if (!b) return peri__no_body(w, id);
    if (first < 0 || count < 0 || first > peri__real_count(b) - count)
        bad = peri__fail(&w->error, PERI_ERROR_INDEX, "particles: %d from %d on; the body has 0 to %d", count, first,
                         peri__real_count(b) - 1);
    else if (values) bad = peri__finite3(name, values, count, &w->error);
    *out = b;
    return peri__report(w, bad);
}

peri_result peri_body_set_positions(peri_world *w, peri_body_id id, int first, int count, const peri_real *x) {
    peri__body *b;
    peri_result bad = peri__range(w, id, first, count, "x", x, &b);
    size_t k, at;
    if (bad) return bad;
    if (!x) return peri__report(w, peri__fail(&w->error, PERI_ERROR_ARGUMENT, "x is NULL"));
    at = 3 * (size_t)(b->first + first);
    for (k = 0; k < 3 * (size_t)count; k++) {
        w->x[at + k] = w->x0[at + k] = (double)x[k];
        w->out[at + k] = x[k];
    }
    if (b->stations) peri__rod_follow(w, b);
    peri__wake(w, b);
    peri__holds_forget(w, (int)id.index1 - 1, first, count, -1);
    b->steps = 0;
    return PERI_OK;
}

peri_result peri_body_set_velocities(peri_world *w, peri_body_id id, int first, int count, const peri_real *v) {
    peri__body *b;
    peri_result bad = peri__range(w, id, first, count, "v", v, &b);
    size_t k, at;
    if (bad) return bad;
    if (!v) return peri__report(w, peri__fail(&w->error, PERI_ERROR_ARGUMENT, "v is NULL"));
    at = 3 * (size_t)(b->first + first);
    for (k = 0; k < 3 * (size_t)count; k++)
        if (!(w->flags[at / 3 + k / 3] & PERI__FIXED)) w->v[at + k] = w->v0[at + k] = v[k];
    for (k = 0; b->stations && k < 3 * PERI__GHOSTS * (size_t)count; k++) {
        size_t ghost = peri__ghost(b, first) + k / 3;
        if (!(w->flags[ghost] & PERI__FIXED))
            w->v[3 * ghost + k % 3] = w->v0[3 * ghost + k % 3] = v[3 * (k / (3 * PERI__GHOSTS)) + k % 3];
    }
    peri__wake(w, b);
    b->steps = 0;
    return PERI_OK;
}

peri_result peri_body_set_forces(peri_world *w, peri_body_id id, int first, int count, const peri_real *f) {
    peri__body *b;
    peri_result bad = peri__range(w, id, first, count, "f", f, &b);
    peri_real part;
    size_t k, at;
    if (bad) return bad;
    part = b->stations ? (peri_real)b->ghost_part : 0;
    if (!f && !(w->wants & PERI__WANT_FORCE)) return PERI_OK;
    bad = peri__reserve(w, w->particles, PERI__WANT_FORCE, 0);
    if (bad) return peri__report(w, bad);
    at = 3 * (size_t)(b->first + first);
    for (k = 0; k < 3 * (size_t)count; k++) w->force[at + k] = f ? f[k] * (1 - PERI__GHOSTS * part) : 0;
    for (k = 0; b->stations && k < 3 * PERI__GHOSTS * (size_t)count; k++)
        w->force[3 * peri__ghost(b, first) + k] = f ? f[3 * (k / (3 * PERI__GHOSTS)) + k % 3] * part : 0;
    peri__wake(w, b);
    return PERI_OK;
}

peri_result peri_body_set_fixed(peri_world *w, peri_body_id id, int particle, int fixed) {
    peri__body *b = NULL;
    peri_result bad = peri__range(w, id, particle, 1, "", NULL, &b);
    unsigned char *flags;
    int c;
    if (bad) return bad;
    flags = w->flags + b->first + particle;
    if (!fixed == !(*flags & PERI__FIXED)) return PERI_OK;
    *flags = (unsigned char)(fixed ? *flags | PERI__FIXED : *flags & ~(PERI__FIXED | PERI__MOVED));
    b->fixed += fixed ? 1 : -1;
    for (c = 0; c < 3 && fixed; c++) {
        size_t k = 3 * (size_t)(b->first + particle) + (size_t)c;
        w->v[k] = w->v0[k] = 0;
    }
    for (c = 0; b->stations && c < PERI__GHOSTS; c++) {
        size_t ghost = peri__ghost(b, particle) + (size_t)c;
        w->flags[ghost] =
            (unsigned char)(fixed ? w->flags[ghost] | PERI__FIXED : w->flags[ghost] & ~(PERI__FIXED | PERI__MOVED));
        if (fixed) memset(w->v + 3 * ghost, 0, 3 * sizeof *w->v);
        if (fixed) memset(w->v0 + 3 * ghost, 0, 3 * sizeof *w->v0);
    }
    b->matrix_h = 0;
    peri__wake(w, b);
    return PERI_OK;
}

peri_result peri_body_move(peri_world *w, peri_body_id id, int particle, peri_vec3 x) {
    peri__body *b;
    peri_result bad = peri__range(w, id, particle, 1, "", NULL, &b);
    size_t at;
    int k, c;
    if (bad) return bad;
    bad = peri__finite_vec("x", x, &w->error);
    at = (size_t)(b->first + particle);
    if (!bad && !(w->flags[at] & PERI__FIXED))
        bad = peri__fail(&w->error, PERI_ERROR_ARGUMENT, "particle %d is free: fix it first with peri_body_set_fixed",
                         particle);
    if (!bad) bad = peri__reserve(w, w->particles, PERI__WANT_AIM, 0);
    if (bad) return peri__report(w, bad);
    for (k = 0; b->stations && k < PERI__GHOSTS; k++) {     /* the section goes along */
        size_t ghost = peri__ghost(b, particle) + (size_t)k;
        double to[3];
        peri__vec(x, to);
        for (c = 0; c < 3; c++) {
            double from = w->flags[ghost] & PERI__MOVED ? w->aim[3 * ghost + (size_t)c] : w->x0[3 * ghost + (size_t)c];
            double was = w->flags[at] & PERI__MOVED ? w->aim[3 * at + (size_t)c] : w->x0[3 * at + (size_t)c];
            w->aim[3 * ghost + (size_t)c] = from + to[c] - was;
        }
        w->flags[ghost] |= PERI__MOVED;
    }
    peri__vec(x, w->aim + 3 * at);
    w->flags[at] |= PERI__MOVED;
    peri__wake(w, b);
    return PERI_OK;
}

/* The body of a rod and its point, checked. */
static peri_result peri__rod_point(peri_world *w, peri_body_id id, int particle, peri__body **out) {
    peri_result bad = peri__range(w, id, particle, 1, "", NULL, out);
    if (bad || (*out)->stations) return bad;
    return peri__report(w, peri__fail(&w->error, PERI_ERROR_ARGUMENT, "body (%u, %u) is no rod", (unsigned)id.index1,
                                      (unsigned)id.generation));
}

peri_result peri_rod_turn(peri_world *w, peri_body_id id, int particle, peri_quat rotation) {
    peri__body *b;
    peri_result bad = peri__rod_point(w, id, particle, &b);
    double body[9], turn[9], arm[3], turned[3];
    size_t at;
    int k, c;
    if (bad) return bad;
    at = (size_t)(b->first + particle);
    bad = peri__check_quat("rotation", rotation, &w->error);
    if (!bad && !(w->flags[at] & PERI__FIXED))
        bad = peri__fail(&w->error, PERI_ERROR_ARGUMENT, "particle %d is free: fix it first with peri_body_set_fixed",
                         particle);
    if (!bad) bad = peri__reserve(w, w->particles, PERI__WANT_AIM, 0);
    if (bad) return peri__report(w, bad);
    peri__quat_matrix(b->rotation, body);
    peri__quat_matrix(rotation, turn);
    for (k = 0; k < PERI__GHOSTS; k++) {
        size_t ghost = peri__ghost(b, particle) + (size_t)k;
        const peri_real *centre = b->points + 3 * (size_t)particle, *rest = b->points + 3 * (ghost - (size_t)b->first);
        for (c = 0; c < 3; c++) arm[c] = (double)rest[c] - (double)centre[c];
        peri__apply(body, arm, turned);
        peri__apply(turn, turned, arm);
        for (c = 0; c < 3; c++)
            w->aim[3 * ghost + (size_t)c] =
                arm[c] + (w->flags[at] & PERI__MOVED ? w->aim[3 * at + (size_t)c] : w->x0[3 * at + (size_t)c]);
        w->flags[ghost] |= PERI__MOVED;
    }
    peri__wake(w, b);
    return PERI_OK;
}

int peri_body_is_asleep(const peri_world *w, peri_body_id id) {
    peri__body *b = peri__body_find(w, id);
    return b && b->asleep;
}

peri_result peri_body_wake(peri_world *w, peri_body_id id) {
    peri__body *b = peri__body_find(w, id);
    if (!b) return peri__no_body(w, id);
    peri__wake(w, b);
    return PERI_OK;
}

/* ---- implementation 7: colliders --------------------------------------------------------------------------------- */

peri_collider_def peri_default_collider_def(void) {
    peri_collider_def d;
    memset(&d, 0, sizeof d);
    d.cookie = PERI__COOKIE + 3;
    d.shape = peri_shape_plane();
    d.rotation.w = 1;
    d.type = PERI_FRICTION_COULOMB;
    d.friction = PERI__R(0.5);
    return d;
}

static peri_result peri__no_collider(peri_world *w, peri_collider_id id) {
    if (!w) return PERI_ERROR_ARGUMENT;
    return peri__report(w, peri__fail(&w->error, PERI_ERROR_ID, "collider (%u, %u) does not exist in this world",
                                      (unsigned)id.index1, (unsigned)id.generation));
}

static peri__collider *peri__collider_find(const peri_world *w, peri_collider_id id) {
    return w ? (peri__collider *)(void *)peri__slot_find(&w->colliders, id.index1, id.generation) : NULL;
}

static void peri__collider_place(peri__collider *c, peri_vec3 position, peri_quat q) {
    double length = sqrt((double)q.x * (double)q.x + (double)q.y * (double)q.y + (double)q.z * (double)q.z +
                         (double)q.w * (double)q.w);
    c->quat.x = (peri_real)((double)q.x / length);
    c->quat.y = (peri_real)((double)q.y / length);
    c->quat.z = (peri_real)((double)q.z / length);
    c->quat.w = (peri_real)((double)q.w / length);
    peri__vec(position, c->position);
    peri__quat_matrix(c->quat, c->rotation);
}

static peri_result peri__check_collider(const peri_collider_def *d, peri_error *err) {
    peri_result bad;
    if (!d) return peri__fail(err, PERI_ERROR_ARGUMENT, "the collider's definition is NULL");
    if (d->cookie != PERI__COOKIE + 3)
        return peri__fail(err, PERI_ERROR_ARGUMENT,
                          "the collider's definition was not made by peri_default_collider_def");
    bad = peri__shape_check(&d->shape, 1, err);
    if (!bad) bad = peri__finite_vec("position", d->position, err);
    if (!bad) bad = peri__check_quat("rotation", d->rotation, err);
    if (!bad) bad = peri__finite_vec("velocity", d->velocity, err);
    if (!bad) bad = peri__finite_vec("spin", d->spin, err);
    if (!bad) bad = peri__check_enum("type", (int)d->type, (int)PERI_FRICTION_STICK, err);
    if (!bad) bad = peri__check_range("friction", (double)d->friction, 0, 10, err);
    return bad;
}

peri_collider_id peri_collider_create(peri_world *w, const peri_collider_def *d) {
    peri_collider_id id = {0, 0};
    peri__collider *c;
    if (!w) return id;
    c = peri__check_collider(d, &w->error) ? NULL : (peri__collider *)(void *)peri__slot_take(w, &w->colliders);
    if (!c) {
        peri__report(w, w->error.code);
        return id;
    }
    c->def = *d;
    peri__collider_place(c, d->position, d->rotation);
    c->moved = 1;
    id.index1 = peri__slot_use(&w->colliders, &c->slot);
    id.generation = c->slot.generation;
    return id;
}

peri_result peri_collider_destroy(peri_world *w, peri_collider_id id) {
    peri__collider *c = peri__collider_find(w, id);
    if (!c) return peri__no_collider(w, id);
    peri__attachments_drop(w, -1, (int)id.index1 - 1);
    peri__holds_forget(w, -1, 0, 0, (int)id.index1 - 1);
    peri__slot_free(&w->colliders, &c->slot);
    return PERI_OK;
}

peri_result peri_collider_set_pose(peri_world *w, peri_collider_id id, peri_vec3 position, peri_quat rotation) {
    peri__collider *c = peri__collider_find(w, id);
    double before[3];
    peri_quat was;
    peri_result bad;
    int k;
    if (!c) return peri__no_collider(w, id);
    bad = peri__finite_vec("position", position, &w->error);
    if (!bad) bad = peri__check_quat("rotation", rotation, &w->error);
    if (bad) return peri__report(w, bad);
    memcpy(before, c->position, sizeof before);
    was = c->quat;
    peri__collider_place(c, position, rotation);
    for (k = 0; k < 3; k++) c->moved |= before[k] < c->position[k] || before[k] > c->position[k];
    c->moved |= memcmp(&was, &c->quat, sizeof was) != 0;
    return PERI_OK;
}

peri_result peri_collider_set_velocity(peri_world *w, peri_collider_id id, peri_vec3 velocity, peri_vec3 spin) {
    peri__collider *c = peri__collider_find(w, id);
    peri_result bad;
    if (!c) return peri__no_collider(w, id);
    bad = peri__finite_vec("velocity", velocity, &w->error);
    if (!bad) bad = peri__finite_vec("spin", spin, &w->error);
    if (bad) return peri__report(w, bad);
    c->def.velocity = velocity;
    c->def.spin = spin;
    return PERI_OK;
}

static peri_vec3 peri__to_vec(const double v[3]) {
    peri_vec3 out;
    out.x = (peri_real)v[0];
    out.y = (peri_real)v[1];
    out.z = (peri_real)v[2];
    return out;
}

peri_result peri_collider_pose(const peri_world *w, peri_collider_id id, peri_vec3 *position, peri_quat *rotation) {
    peri__collider *c = peri__collider_find(w, id);
    if (!c) return w ? PERI_ERROR_ID : PERI_ERROR_ARGUMENT;
    if (position) *position = peri__to_vec(c->position);
    if (rotation) *rotation = c->quat;
    return PERI_OK;
}

peri_result peri_collider_impulse(const peri_world *w, peri_collider_id id, peri_vec3 *linear, peri_vec3 *angular) {
    peri__collider *c = peri__collider_find(w, id);
    if (!c) return w ? PERI_ERROR_ID : PERI_ERROR_ARGUMENT;
    if (linear) *linear = peri__to_vec(c->linear);
    if (angular) *angular = peri__to_vec(c->angular);
    return PERI_OK;
}

/* Pose at the end of a step of h: tan(theta/2) by its (2, 2) Pade approximant, right to 1e-3 at 2 rad a step. */
static void peri__collider_advance(peri__collider *c, double h) {
    double spin[3], velocity[3], x2, t, q[4], r[4], length = 0;
    int k;
    peri__vec(c->def.velocity, velocity);
    peri__vec(c->def.spin, spin);
    x2 = (spin[0] * spin[0] + spin[1] * spin[1] + spin[2] * spin[2]) * h * h / 4;
    t = x2 < 2 ? h / 2 * (15 - x2) / (15 - 6 * x2) : h;
    q[0] = (double)c->quat.x; q[1] = (double)c->quat.y; q[2] = (double)c->quat.z; q[3] = (double)c->quat.w;
    peri__cross(spin, q, r);
    for (k = 0; k < 3; k++) r[k] = q[k] + t * (spin[k] * q[3] + r[k]);
    r[3] = q[3] - t * (spin[0] * q[0] + spin[1] * q[1] + spin[2] * q[2]);
    for (k = 0; k < 4; k++) length += r[k] * r[k];
    length = sqrt(length);
    c->quat1.x = (peri_real)(r[0] / length);
    c->quat1.y = (peri_real)(r[1] / length);
    c->quat1.z = (peri_real)(r[2] / length);
    c->quat1.w = (peri_real)(r[3] / length);
    peri__quat_matrix(c->quat1, c->rotation1);
    c->turned = 2 * sqrt(x2);
    for (k = 0; k < 3; k++) c->position1[k] = c->position[k] + h * velocity[k];
}

/* Signed distance of a point of a collider's frame, and its gradient there. */
static double peri__collider_local(const peri__collider *c, const double local[3], double *gradient) {
    peri_vec3 g;
    peri_real distance = peri_shape_evaluate(&c->def.shape, peri__to_vec(local), gradient ? &g : NULL);
    if (gradient) peri__vec(g, gradient);
    return (double)distance;
}

/* Signed distance of a world point to a collider at its pose of the end (1) or the start (0) of the step; normal in the
   world's frame (may be NULL). */
static double peri__collider_distance(const peri__collider *c, int end, const double *x, double *normal) {
    const double *position = end ? c->position1 : c->position, *rotation = end ? c->rotation1 : c->rotation;
    double arm[3], local[3], gradient[3], distance;
    int k;
    for (k = 0; k < 3; k++) arm[k] = x[k] - position[k];
    peri__apply_back(rotation, arm, local);
    distance = peri__collider_local(c, local, normal ? gradient : NULL);
    if (normal) peri__apply(rotation, gradient, normal);
    return distance;
}

static peri__collider *peri__collider_at(const peri_world *w, int k) {
    return (peri__collider *)(void *)peri__slot_at(&w->colliders, k);
}

/* How far a collider's surface moves at most in this step, within `size` of a point. */
static double peri__collider_travel(const peri__collider *c, const double point[3], double size) {
    double way = 0, arm = 0;
    int k;
    for (k = 0; k < 3; k++) {
        way += (c->position1[k] - c->position[k]) * (c->position1[k] - c->position[k]);
        arm += (point[k] - c->position1[k]) * (point[k] - c->position1[k]);
    }
    return sqrt(way) + c->turned * (sqrt(arm) + size);
}

static int peri__collider_moves(const peri__collider *c) {
    const peri_vec3 *v = &c->def.velocity, *s = &c->def.spin;
    return c->moved || v->x * v->x + v->y * v->y + v->z * v->z > 0 || s->x * s->x + s->y * s->y + s->z * s->z > 0;
}

/* An impulse (N s) on a collider at a point of the world. */
static void peri__collider_push(peri__collider *c, const double point[3], const double impulse[3]) {
    double arm[3], turn[3];
    int k;
    for (k = 0; k < 3; k++) arm[k] = point[k] - c->position1[k];
    peri__cross(arm, impulse, turn);
    for (k = 0; k < 3; k++) {
        c->linear[k] += impulse[k];
        c->angular[k] += turn[k];
    }
}

/* The reaction to a force on what sleeps at a point of the world. */
static void peri__collider_load(peri__collider *c, const double point[3], const double force[3]) {
    double arm[3], turn[3];
    int k;
    for (k = 0; k < 3; k++) arm[k] = point[k] - c->position[k];
    peri__cross(arm, force, turn);
    for (k = 0; k < 3; k++) {
        c->weight[k] -= force[k];
        c->lean[k] -= turn[k];
    }
}

static double peri__friction(const peri__collider *c) {
    if (c->def.type == PERI_FRICTION_SLIP) return 0;
    return c->def.type == PERI_FRICTION_STICK ? 1e30 : (double)c->def.friction;
}

static peri__attachment *peri__attachment_at(const peri_world *w, int k) {
    return (peri__attachment *)(void *)peri__slot_at(&w->attachments, k);
}

/* ---- implementation 8: contacts -----------------------------------------------------------------------------------
   A particle that is closer to a solid than its distance is pushed out by a stiff spring, as stiff as its own row of
   the matrix, and held along the surface by another, from the point where it first touched, up to the friction times
   the push. Both act inside the solve, so contact and elasticity agree at the end of the step.
   The solid is a collider, by its signed distance, or another body: then the surface is where the particles around are,
   their weighted mean (the foot), with weights that reproduce flat lattices, so that what slides feels no bumps. The
   push acts between the particle and its foot, along the line that joined them when the foot was last found: linear
   momentum is kept, angular momentum to the tolerance of the solve. A contact knows on which side it is (of a sheet, by
   the sheet's own normal): its normal turns with the surface and does not flip when a particle is pressed or shot
   through. After the solve, what the way to the answer met and the solve did not see is sought once more. */

#define PERI__CELLS 4       /* cells of a body's grid per particle of its surface */
#define PERI__MARCH 64      /* most places of a step's path that are looked at */
#define PERI__SUPPORT 1.5   /* width of the foot's weights, in spacings: no bump above 0.1 degrees on lattices */

static const peri__collider *peri__contact_collider(const peri_world *w, const peri__contact *t) {
    return (const peri__collider *)(void *)peri__slot_at(&w->colliders, t->target);
}

static peri__body *peri__contact_other(const peri_world *w, const peri__contact *t) {
    return t->target < PERI__TARGET_BODY ? NULL : peri__body_at(w, t->target - PERI__TARGET_BODY);
}

/* Where particle `at` of the world is at share s of the step, from x0 to x. */
static void peri__place(const peri_world *w, size_t at, double s, double p[3]) {
    int c;
    for (c = 0; c < 3; c++) {
        double from = w->x0[3 * at + (size_t)c], to = w->x[3 * at + (size_t)c];
        p[c] = s < 1 ? from + s * (to - from) : to;
    }
}

/* Weights of the patch for a particle at x, patch particles at place[]: (1 - r^2/R^2)^3, then tilted so that the foot
   comes below the particle along the surface, and cut at zero so that it stays on it. Returns 0, and leaves the
   weights, when no particle is within R. */
static int peri__foot_weights(peri__contact *t, const double x[3], double place[][3]) {
    double share[PERI__PATCH], sum = 0, mean[3] = {0, 0, 0}, a[9], inverse[9], lean[3], off[3], det, trace;
    int k, c, d;
    for (k = 0; k < t->count; k++) {
        double r2 = 0, q;
        for (c = 0; c < 3; c++) r2 += (x[c] - place[k][c]) * (x[c] - place[k][c]);
        q = 1 - r2 / t->reach2;
        share[k] = q > 0 ? q * q * q : 0;
        sum += share[k];
        for (c = 0; c < 3; c++) mean[c] += share[k] * place[k][c];
    }
    if (!(sum > 1e-12)) return 0;
    for (c = 0; c < 3; c++) mean[c] /= sum;
    memset(a, 0, sizeof a);
    for (k = 0; k < t->count; k++) {
        for (c = 0; c < 3; c++) off[c] = place[k][c] - mean[c];
        for (c = 0; c < 9; c++) a[c] += share[k] / sum * off[c / 3] * off[c % 3];
    }
    trace = a[0] + a[4] + a[8];
    for (c = 0; c < 9; c += 4) a[c] += 0.1 * trace;
    det = peri_det3(a);
    for (c = 0; c < 3; c++) off[c] = x[c] - mean[c];
    lean[0] = lean[1] = lean[2] = 0;
    if (det > 0) {
        peri_adjugate3(a, inverse);
        peri__apply(inverse, off, lean);
    }
    for (k = 0, trace = sum, sum = 0; k < t->count; k++) {
        double tilt = 1;
        for (d = 0; d < 3 && det > 0; d++) tilt += lean[d] / det * (place[k][d] - mean[d]);
        share[k] *= tilt > 0 ? tilt : 0;
        sum += share[k];
    }
    if (!(sum > 1e-3 * trace)) return 0;
    for (k = 0; k < t->count; k++) t->share[k] = share[k] / sum;
    return 1;
}

/* Renews the weights at share s of the step; away: from the foot to the particle. Returns 0 when the patch is out of
   reach: the weights stay. */
static int peri__foot(const peri_world *w, peri__contact *t, double s, double away[3]) {
    const peri__body *a = peri__body_at(w, t->body), *b = peri__contact_other(w, t);
    double x[3], place[PERI__PATCH][3];
    int k, c, found;
    peri__place(w, (size_t)(a->first + t->particle), s, x);
    for (k = 0; k < t->count; k++) peri__place(w, (size_t)(b->first + t->patch[k]), s, place[k]);
    found = peri__foot_weights(t, x, place);
    for (c = 0; c < 3; c++) {
        away[c] = x[c];
        for (k = 0; k < t->count; k++) away[c] -= t->share[k] * place[k][c];
    }
    return found;
}

/* Unit normal of the sheet under the foot at share s of the step: that of its reference, carried along by the patch.
   With T the tangents there, sum of share (x - mean) T.(X - mean) is the tangents' image times a positive matrix, so
   its cross product does not flip. Returns 0 when the other body is no sheet, or has no plane there. */
static int peri__sheet_normal(const peri_world *w, const peri__contact *t, double s, double normal[3]) {
    const peri__body *b = peri__contact_other(w, t);
    double turn[9], n[3], tangent[6], image[6], rest[3], place[3], mean[3] = {0, 0, 0}, size = 0, length;
    int k, c;
    if (!b->normal) return 0;
    peri__quat_matrix(b->rotation, turn);
    for (c = 0; c < 3; c++) n[c] = (double)b->normal[3 * (size_t)t->patch[0] + (size_t)c];
    peri__apply_back(turn, n, normal);
    peri__plate_tangents(normal, tangent);
    memset(image, 0, sizeof image);
    for (k = 0; k < t->count; k++)
        for (c = 0; c < 3; c++) mean[c] += t->share[k] * (double)b->points[3 * (size_t)t->patch[k] + (size_t)c];
    for (k = 0; k < t->count; k++) {
        peri__place(w, (size_t)(b->first + t->patch[k]), s, place);
        for (c = 0; c < 3; c++) rest[c] = (double)b->points[3 * (size_t)t->patch[k] + (size_t)c] - mean[c];
        size += t->share[k] * peri__dot3(rest, rest);
        for (c = 0; c < 6; c++) image[c] += t->share[k] * place[c % 3] * peri__dot3(rest, tangent + 3 * (c / 3));
    }
    peri__cross(image, image + 3, normal);
    length = sqrt(peri__dot3(normal, normal));
    if (!(length > 1e-3 * size * size)) return 0;
    for (c = 0; c < 3; c++) normal[c] /= length;
    return 1;
}

#define PERI__LEAN 0.25     /* a normal leans from a sheet's by no more than its cotangent */

/* Turns the contact's normal to where its foot is now (share s of the step), on the side where it is. Which side of a
   sheet that is, is known for good; of a solid it is where the normal was. */
static void peri__contact_turn(const peri_world *w, peri__contact *t, double s, const double away[3]) {
    double along = peri__dot3(away, t->normal), lift, length, normal[3], v[3];
    int c;
    if (peri__sheet_normal(w, t, s, normal)) {
        if (!t->side) t->side = peri__dot3(normal, t->normal) < 0 ? -1 : 1;
        along = t->side * peri__dot3(away, normal);
        lift = along < PERI__LEAN * t->distance ? PERI__LEAN * t->distance - along : 0;
        for (c = 0; c < 3; c++) v[c] = away[c] + t->side * lift * normal[c];
    } else {
        for (c = 0; c < 3; c++) v[c] = along < 0 ? -away[c] : away[c];
    }
    length = sqrt(peri__dot3(v, v));
    if (!(length > 0.05 * t->distance)) return;
    for (c = 0; c < 3; c++) t->normal[c] = v[c] / length;
}

/* Distance of a contact's particle to its solid with all particles at xs, and the normal there. Through the surface it
   goes on below zero. */
static double peri__contact_distance(const peri_world *w, const peri__contact *t, const double *xs, double normal[3]) {
    const peri__body *a = peri__body_at(w, t->body), *b = peri__contact_other(w, t);
    const double *x = xs + 3 * (size_t)(a->first + t->particle);
    double away[3];
    int k, c;
    if (!b) {
        const peri__collider *solid = peri__contact_collider(w, t);
        double distance = peri__collider_distance(solid, 1, x, normal);
        if (peri__dot3(normal, t->normal) > -0.5) return distance;
        peri__apply(solid->rotation1, t->entry, away);      /* it is on its way out of the other side */
        for (c = 0; c < 3; c++) away[c] = x[c] - away[c] - solid->position1[c];
        memcpy(normal, t->normal, sizeof away);
        return t->entry[3] + peri__dot3(away, normal);
    }
    for (c = 0; c < 3; c++) {
        away[c] = x[c];
        for (k = 0; k < t->count; k++)
            away[c] -= t->share[k] * xs[3 * (size_t)(b->first + t->patch[k]) + (size_t)c];
    }
    memcpy(normal, t->normal, sizeof away);
    return peri__dot3(away, normal);    /* of a plane that turns with the foot: straight, so that energies are convex */
}

/* How far the particle has gone along the surface from where friction holds it, with the largest part of that which
   holds: what is beyond slips. Along the surface means across the contact's normal, which a line search does not turn:
   so that this force is the slope of its energy, also when the particle comes in fast. */
static void peri__contact_slip(const peri_world *w, const peri__contact *t, double tangent[3], double *length,
                               double *limit) {
    const peri__body *a = peri__body_at(w, t->body), *b = peri__contact_other(w, t);
    size_t at = 3 * (size_t)(a->first + t->particle);
    double along;
    int k, c;
    if (!b) {
        const peri__collider *solid = peri__contact_collider(w, t);
        peri__apply(solid->rotation1, t->anchor, tangent);
        for (c = 0; c < 3; c++) tangent[c] = w->x[at + (size_t)c] - tangent[c] - solid->position1[c];
    } else {
        for (c = 0; c < 3; c++) {
            tangent[c] = t->anchor[c] + w->x[at + (size_t)c] - w->x0[at + (size_t)c];
            for (k = 0; k < t->count; k++) {
                size_t j = 3 * (size_t)(b->first + t->patch[k]) + (size_t)c;
                tangent[c] -= t->share[k] * (w->x[j] - w->x0[j]);
            }
        }
    }
    along = peri__dot3(tangent, t->normal);
    for (c = 0; c < 3; c++) tangent[c] -= along * t->normal[c];
    *length = sqrt(peri__dot3(tangent, tangent));
    *limit = t->friction * t->held / t->stiffness;
}

/* Push and hold of one contact at the present positions, left in the contact. */
static void peri__contact_force(const peri_world *w, peri__contact *t) {
    double normal[3], tangent[3], length, limit, hold;
    int c;
    t->depth = t->loose ? -t->distance : t->distance - peri__contact_distance(w, t, w->x, normal);
    t->touching = t->depth > 0;
    t->pressure = t->touching ? t->stiffness * t->depth : 0;
    for (c = 0; c < 3; c++) t->force[c] = t->touching ? t->pressure * normal[c] : 0;
    t->energy = t->touching ? t->pressure * t->depth / 2 : 0;
    /* also while a trial lifts it: energies must not leap */
    if (!(t->held > 0) || !(t->friction > 0) || t->loose) return;
    peri__contact_slip(w, t, tangent, &length, &limit);
    hold = length > limit ? limit / length : 1;
    for (c = 0; c < 3; c++) t->force[c] -= t->stiffness * hold * tangent[c];
    t->energy += t->stiffness * length * length * hold * (1 - hold / 2);
}

/* Adds sign times the contact's force to a gradient that begins with particle `origin` of the island order. */
static void peri__contact_scatter(const peri_world *w, const peri__contact *t, int origin, double sign, peri_real *g) {
    const peri__body *a = peri__body_at(w, t->body), *b = peri__contact_other(w, t);
    peri_real *at = g + 3 * (size_t)(a->at - origin + t->particle);
    int k, c;
    if (!(w->flags[a->first + t->particle] & PERI__FIXED))
        for (c = 0; c < 3; c++) at[c] += (peri_real)(sign * t->force[c]);
    for (k = 0; b && !b->asleep && k < t->count; k++) {
        if (w->flags[b->first + t->patch[k]] & PERI__FIXED) continue;
        at = g + 3 * (size_t)(b->at - origin + t->patch[k]);
        for (c = 0; c < 3; c++) at[c] -= (peri_real)(sign * t->share[k] * t->force[c]);
    }
}

/* Weights, normal and (by the share `relax`) the pressure that limits friction follow the particles. Between these
   calls they stay, so that there is an energy to go down. */
static void peri__contact_refresh(peri_world *w, peri__contact *t, double relax) {
    const peri__collider *solid;
    double away[3], normal[3];
    t->held += relax * (t->pressure - t->held);
    if (t->target >= PERI__TARGET_BODY) {
        int found = peri__foot(w, t, 1, away);
        double along = peri__dot3(away, t->normal);
        if (found) peri__contact_turn(w, t, 1, away);
        t->loose = !found && 2 * along * along < peri__dot3(away, away);
    } else {
        solid = peri__contact_collider(w, t);
        peri__collider_distance(solid, 1, w->x + 3 * (size_t)(peri__body_at(w, t->body)->first + t->particle), normal);
        if (peri__dot3(normal, t->normal) > -0.5) memcpy(t->normal, normal, sizeof normal);
    }
    peri__contact_force(w, t);
}

/* Order of contacts and holds: body, target, particle. */
static int peri__key_before(int body, int target, int particle, int body2, int target2, int particle2) {
    if (body != body2) return body < body2;
    if (target != target2) return target < target2;
    return particle < particle2;
}

/* The contact of the step under way that has this body, target and particle, or NULL. */
static const peri__contact *peri__contact_like(const peri_world *w, const peri__contact *t) {
    int low = 0, high = w->contact_count;
    while (low < high) {
        int middle = low + (high - low) / 2;
        const peri__contact *m = &w->contacts[middle];
        if (peri__key_before(m->body, m->target, m->particle, t->body, t->target, t->particle)) low = middle + 1;
        else high = middle;
    }
    if (low == w->contact_count) return NULL;
    return w->contacts[low].body == t->body && w->contacts[low].target == t->target &&
                   w->contacts[low].particle == t->particle ? &w->contacts[low] : NULL;
}

/* One more contact; or, after the solve, a look whether the solve saw it: what sank by a quarter unseen was missed. */
static peri_result peri__contact_add(peri_world *w, const peri__contact *t) {
    peri_result bad;
    if (w->checking) {
        const peri__contact *seen = peri__contact_like(w, t);
        if (t->depth > 0.25 * t->distance && !(seen && seen->touching)) w->missed = 1;
        return PERI_OK;
    }
    bad = peri__contacts_reserve(w, w->contact_count + 1);
    if (!bad) w->contacts[w->contact_count++] = *t;
    return bad;
}

/* ---- implementation 9: finding contacts --------------------------------------------------------------------------
   Boxes around the paths of bodies, swept along x, give the pairs that may meet; a grid over the surface of each body,
   made when a pair needs it, gives the particles. */

/* What was held of this contact after the last step, or NULL. */
static const peri__hold *peri__hold_find(const peri_world *w, int body, int target, int particle) {
    int low = 0, high = w->hold_count;
    while (low < high) {
        int middle = low + (high - low) / 2;
        const peri__hold *h = &w->holds[middle];
        if (peri__key_before(h->body, h->target, h->particle, body, target, particle)) low = middle + 1;
        else high = middle;
    }
    if (low == w->hold_count) return NULL;
    return w->holds[low].body == body && w->holds[low].target == target && w->holds[low].particle == particle
               ? &w->holds[low] : NULL;
}

/* Stiffness that a particle offers to what it touches, N/m. */
static double peri__contact_stiffness(const peri_world *w, const peri__body *b, int particle) {
    return 0.5 * (double)b->stiffness[particle] + (double)w->mass[b->first + particle] / (b->h * b->h);
}

static void peri__contact_begin(peri__contact *t, int body, int target, int particle, const peri__hold *hold) {
    memset(t, 0, sizeof *t);
    t->body = body;
    t->target = target;
    t->particle = particle;
    t->grade = 1;
    if (!hold) return;
    t->known = 1;
    t->side = hold->side;
    t->stored = hold->overlap * sqrt(peri__dot3(hold->force, hold->force)) / 2;
    t->grade = hold->grade > 2 ? hold->grade / 2 : 1;
    memcpy(t->anchor, hold->anchor, sizeof t->anchor);
    memcpy(t->entry, hold->entry, sizeof t->entry);
}

/* Box of the path of a body's surface in this step, wide enough for what touches it; how its guess moves as a whole,
   and by how much single particles depart from that. */
static void peri__body_sweep(const peri_world *w, peri__body *b) {
    double reach = 2 * b->radius;
    int i, c;
    for (c = 0; c < 3; c++) {
        b->lower[c] = 1e300;
        b->upper[c] = -1e300;
        b->drift[c] = 0;
    }
    b->stray = 0;
    for (i = 0; i < b->surface_count; i++) {
        size_t at = 3 * (size_t)(b->first + b->surface[i]);
        for (c = 0; c < 3; c++) {
            double x0 = w->x0[at + (size_t)c], x = w->x[at + (size_t)c], low = x < x0 ? x : x0, high = x < x0 ? x0 : x;
            if (low - reach < b->lower[c]) b->lower[c] = low - reach;
            if (high + reach > b->upper[c]) b->upper[c] = high + reach;
            b->drift[c] += (x - x0) / b->surface_count;
        }
    }
    for (i = 0; i < b->surface_count; i++) {
        size_t at = 3 * (size_t)(b->first + b->surface[i]);
        double square = 0;
        for (c = 0; c < 3; c++) {
            double off = w->x[at + (size_t)c] - w->x0[at + (size_t)c] - b->drift[c];
            square += off * off;
        }
        if (square > b->stray * b->stray) b->stray = sqrt(square);
    }
}

/* Squared distance of two particles of a body at rest. */
static double peri__rest_square(const peri__body *b, int i, int j) {
    double square = 0;
    int c;
    for (c = 0; c < 3; c++) {
        double d = (double)b->points[3 * (size_t)i + (size_t)c] - (double)b->points[3 * (size_t)j + (size_t)c];
        square += d * d;
    }
    return square;
}

/* A grid over the surface at the guess; kept while the body sleeps. */
static peri_result peri__body_grid(peri_world *w, peri__body *b) {
    double cell = sqrt(4 * b->radius * b->radius + PERI__SUPPORT * PERI__SUPPORT * b->spacing * b->spacing);
    if (b->grid_made) return PERI_OK;
    if (!b->grid.start) {
        peri_result bad = peri__grid_reserve(w, &b->grid, b->surface_count);
        if (bad) return bad;
    }
    peri__grid_fill(&b->grid, w->x + 3 * (size_t)b->first, b->surface, b->surface_count, cell);
    b->grid_made = 1;
    return PERI_OK;
}

/* The particles of b's surface that are nearest at share `at` of the step, within the support of the weights and at
   most PERI__PATCH, into the contact's patch; a body's own particles that were near at rest are left out. The grid is
   looked through within `reach` of q, as it lies at the end of the step. */
static void peri__patch_find(const peri_world *w, peri__contact *t, double at, const double q[3], double reach) {
    const peri__body *b = peri__contact_other(w, t);
    const peri__grid *g = &b->grid;
    double square[PERI__PATCH], apart = t->distance + PERI__SUPPORT * b->spacing;
    double x[3], p[3];
    int low[3], high[3], a[3], c, k, m;
    peri__place(w, (size_t)(peri__body_at(w, t->body)->first + t->particle), at, x);
    t->count = 0;
    for (c = 0; c < 3; c++) {
        low[c] = peri__grid_axis(g, c, q[c] - reach);
        high[c] = peri__grid_axis(g, c, q[c] + reach);
        if (q[c] + reach < g->lower[c] || q[c] - reach > g->upper[c]) return;
    }
    for (a[2] = low[2]; a[2] <= high[2]; a[2]++)
        for (a[1] = low[1]; a[1] <= high[1]; a[1]++)
            for (a[0] = low[0]; a[0] <= high[0]; a[0]++) {
                int cell = a[0] + g->cells[0] * (a[1] + g->cells[1] * a[2]);
                for (k = g->start[cell]; k < g->start[cell + 1]; k++) {
                    int j = g->order[k];
                    double r2 = 0;
                    peri__place(w, (size_t)(b->first + j), at, p);
                    for (c = 0; c < 3; c++) r2 += (p[c] - x[c]) * (p[c] - x[c]);
                    if (r2 >= t->reach2) continue;
                    if (t->body == t->target - PERI__TARGET_BODY &&
                        peri__rest_square(b, t->particle, j) < apart * apart)
                        continue;
                    if (t->count == PERI__PATCH && r2 >= square[PERI__PATCH - 1]) continue;
                    m = t->count < PERI__PATCH ? t->count++ : PERI__PATCH - 1;
                    for (; m > 0 && (square[m - 1] > r2 || (square[m - 1] >= r2 && t->patch[m - 1] > j)); m--) {
                        square[m] = square[m - 1];
                        t->patch[m] = t->patch[m - 1];
                    }
                    square[m] = r2;
                    t->patch[m] = j;
                }
            }
}

/* Looks at share s of the step: the patch there, the vector from its foot to the particle. Returns the distance, or -1
   when nothing is in reach. path: of the particle against the body's drift, from its end. */
static double peri__contact_look(const peri_world *w, peri__contact *t, const double path[3], double s,
                                 double away[3]) {
    const peri__body *a = peri__body_at(w, t->body), *b = peri__contact_other(w, t);
    double q[3], reach = sqrt(t->reach2), pad = (1 - s) * b->stray;
    const double *x = w->x + 3 * (size_t)(a->first + t->particle);
    int c;
    for (c = 0; c < 3; c++) q[c] = x[c] - (1 - s) * path[c];
    peri__patch_find(w, t, s, q, reach + pad);
    if (!t->count || !peri__foot(w, t, s, away)) return -1;
    return sqrt(peri__dot3(away, away));
}

/* Turns the contact's normal to the foot at share s; returns 1 when the particle is behind the surface there. */
static int peri__contact_behind(const peri_world *w, peri__contact *t, double s, const double away[3]) {
    int behind = peri__dot3(away, t->normal) < 0;       /* of a solid: against where the normal was */
    peri__contact_turn(w, t, s, away);
    return t->side ? peri__dot3(away, t->normal) < 0 : behind;
}

/* Follows the particle through the step. Returns 1 when it touches the body's surface or comes near: then patch,
   weights and normal are those of the end of the path, or, when it has gone through, of the place where it came in.
   What touches on its way and leaves on the same side, past a corner, does not count. */
static int peri__contact_march(const peri_world *w, peri__contact *t, const double path[3], double length) {
    double away[3], at = -1, margin = 1.25 * t->distance + length, steps = ceil(length / (0.5 * t->distance));
    double side = t->body < t->target - PERI__TARGET_BODY ? -1 : 1;     /* in the same place: one goes down, one up */
    peri__contact found;
    int k, c, pieces = steps < 1 ? 1 : steps > PERI__MARCH ? PERI__MARCH : (int)steps, came = 0, behind = 0;
    if (margin > 2 * t->distance) margin = 2 * t->distance;
    for (k = length < 0.25 * t->distance ? pieces : 0; k <= pieces; k++) {
        at = peri__contact_look(w, t, path, (double)k / pieces, away);
        if (at < 0 && came) return 0;
        if (at < 0) continue;
        if (!came && !t->known) {
            for (c = 0; c < 3; c++) t->normal[c] = at > 0 ? away[c] / at : c == 2 ? side : 0;
            t->side = 0;
        }
        behind = peri__contact_behind(w, t, (double)k / pieces, away);
        if (behind && came) {
            *t = found;
            return 1;
        }
        if (came || k == pieces || (at > t->distance && !behind)) continue;
        came = 1;           /* the first place where it touches */
        found = *t;
    }
    return came || (at >= 0 && (at < margin || behind));
}

/* The contact of particle i of body k with body m, if there may be one. */
static peri_result peri__contact_try(peri_world *w, int k, int m, int i) {
    peri__body *a = peri__body_at(w, k), *b = peri__body_at(w, m);
    const peri__hold *hold = peri__hold_find(w, k, PERI__TARGET_BODY + m, i);
    size_t at = 3 * (size_t)(a->first + i);
    peri__contact t;
    double path[3], length, other;
    int c;
    for (c = 0; c < 3; c++) {
        double x0 = w->x0[at + (size_t)c], x = w->x[at + (size_t)c], reach = 2 * a->radius;
        if ((x < x0 ? x0 : x) + reach < b->lower[c] || (x < x0 ? x : x0) - reach > b->upper[c]) return PERI_OK;
        path[c] = x - x0 - b->drift[c];
    }
    length = sqrt(peri__dot3(path, path)) + b->stray;
    peri__contact_begin(&t, k, PERI__TARGET_BODY + m, i, hold);
    if (hold) memcpy(t.normal, hold->normal, sizeof t.normal);
    t.distance = a->radius + b->radius;
    t.reach2 = t.distance * t.distance + PERI__SUPPORT * PERI__SUPPORT * b->spacing * b->spacing;
    t.friction = sqrt(a->friction * b->friction);
    if (!peri__contact_march(w, &t, path, length)) return PERI_OK;
    t.stiffness = peri__contact_stiffness(w, a, i);
    other = peri__contact_stiffness(w, b, t.patch[0]);
    t.stiffness = 0.5 * t.grade * (t.stiffness > other ? t.stiffness : other);
    peri__contact_force(w, &t);
    if (t.touching && b->asleep && !w->checking) {
        peri__wake(w, b);
        w->woken = 1;
    }
    return peri__contact_add(w, &t);
}

/* Follows a particle to a collider; returns 1 when it touches it or is near. */
static int peri__contact_trace(const peri_world *w, const peri__body *b, const peri__collider *solid, peri__contact *t,
                               double margin) {
    size_t at = 3 * (size_t)(b->first + t->particle);
    double arm[3], from[3], to[3], p[3], normal[3], length, s = 0, distance;
    int c, k;
    distance = peri__collider_distance(solid, 1, w->x + at, t->normal);
    for (c = 0; c < 3; c++) arm[c] = w->x0[at + (size_t)c] - solid->position[c];
    peri__apply_back(solid->rotation, arm, from);
    for (c = 0; c < 3; c++) arm[c] = w->x[at + (size_t)c] - solid->position1[c];
    peri__apply_back(solid->rotation1, arm, to);
    for (c = 0; c < 3; c++) arm[c] = to[c] - from[c];
    length = sqrt(peri__dot3(arm, arm));
    memcpy(t->entry, to, sizeof to);
    t->entry[3] = distance;
    if (length < 0.5 * t->distance) return distance < margin;
    for (k = 0; k < PERI__MARCH && s <= 1; k++) {       /* distances are lower bounds: no step can leap over a wall */
        double d;
        for (c = 0; c < 3; c++) p[c] = from[c] + s * arm[c];
        d = peri__collider_local(solid, p, normal) - t->distance;
        if (d <= 1e-3 * t->distance + 1e-9 * length) break;
        s += d / length;
    }
    if (s > 1 || k == PERI__MARCH) return distance < margin;
    memcpy(t->entry, p, sizeof p);
    t->entry[3] = (double)peri__collider_local(solid, p, normal);
    peri__apply(solid->rotation1, normal, t->normal);
    return 1;
}

/* The contacts of body k with colliders. */
static peri_result peri__contacts_colliders(peri_world *w, int k) {
    peri__body *b = peri__body_at(w, k);
    const double *x = w->x + 3 * (size_t)b->first, *x0 = w->x0 + 3 * (size_t)b->first;
    double lower[3], upper[3], centre[3], reach = 0, size = 0;
    int i, c, at, n = 3 * peri__real_count(b);
    for (c = 0; c < 3; c++) lower[c] = upper[c] = x[c];
    for (i = 0; i < n; i++) {
        double move = fabs(x[i] - x0[i]);
        if (x[i] < lower[i % 3]) lower[i % 3] = x[i];
        if (x[i] > upper[i % 3]) upper[i % 3] = x[i];
        if (move > reach) reach = move;
    }
    for (c = 0; c < 3; c++) {
        centre[c] = (lower[c] + upper[c]) / 2;
        size += (upper[c] - lower[c]) * (upper[c] - lower[c]) / 4;
    }
    for (at = 0; at < w->colliders.capacity; at++) {
        peri__collider *solid = (peri__collider *)(void *)peri__slot_at(&w->colliders, at);
        double moved, margin;
        if (!solid || solid->def.shape.kind == PERI_SHAPE_NONE) continue;
        moved = 2 * reach + peri__collider_travel(solid, centre, sqrt(size) + reach);
        margin = b->radius + b->spacing + moved;
        if (peri__collider_distance(solid, 1, centre, NULL) > sqrt(size) + margin) continue;
        for (i = 0; 3 * i < n; i++) {
            peri__contact t;
            const peri__hold *hold;
            peri_result bad;
            if (w->flags[b->first + i] & PERI__FIXED) continue;
            if (peri__collider_distance(solid, 1, x + 3 * (size_t)i, NULL) > margin) continue;
            hold = peri__hold_find(w, k, at, i);
            peri__contact_begin(&t, k, at, i, hold);
            t.distance = b->radius;
            if (hold) peri__apply(solid->rotation1, hold->normal, t.normal);
            else if (!peri__contact_trace(w, b, solid, &t, b->radius + b->spacing + reach)) continue;
            if (!hold) {
                double away[3];
                for (c = 0; c < 3; c++) away[c] = x0[3 * (size_t)i + (size_t)c] - solid->position[c];
                peri__apply_back(solid->rotation, away, t.anchor);
            }
            t.friction = peri__friction(solid);
            t.stiffness = t.grade * peri__contact_stiffness(w, b, i);
            peri__contact_force(w, &t);
            bad = peri__contact_add(w, &t);
            if (bad) return bad;
        }
    }
    return PERI_OK;
}

static int peri__bodies_meet(const peri__body *a, const peri__body *b) {
    int c;
    if (a == b) return a->self_contact && a->radius > 0;
    if (!(a->group & b->touches) || !(b->group & a->touches) || !(a->radius + b->radius > 0)) return 0;
    for (c = 0; c < 3; c++)
        if (a->upper[c] < b->lower[c] || b->upper[c] < a->lower[c]) return 0;
    return 1;
}

static int peri__edge_before(const void *a, const void *b) {
    const peri__edge *x = (const peri__edge *)a, *y = (const peri__edge *)b;
    return x->lower < y->lower || (!(x->lower > y->lower) && x->body < y->body);
}

static int peri__pair_before(const void *a, const void *b) { return *(const uint64_t *)a < *(const uint64_t *)b; }

/* Heap sort of n things of `size` bytes, at most 16: the C library's qsort may allocate. */
static void peri__sort(void *data, size_t n, size_t size, int (*before)(const void *a, const void *b)) {
    char *at = (char *)data, held[16];
    size_t begin = n / 2, end = n, k, child;
    if (n < 2) return;
    while (end > 1) {
        if (begin > 0) {
            memcpy(held, at + --begin * size, size);
        } else {
            memcpy(held, at + --end * size, size);
            memcpy(at + end * size, at, size);
        }
        for (k = begin; (child = 2 * k + 1) < end; k = child) {
            if (child + 1 < end && before(at + child * size, at + (child + 1) * size)) child++;
            if (!before(held, at + child * size)) break;
            memcpy(at + k * size, at + child * size, size);
        }
        memcpy(at + k * size, held, size);
    }
}

static peri_result peri__pair_add(peri_world *w, int a, int b) {
    if (w->pair_count == w->pair_capacity) {
        int now = w->pair_capacity ? 2 * w->pair_capacity : 64;
        void *data = w->pairs;
        peri_result bad;
        if (w->buffer) return peri__fail(&w->error, PERI_ERROR_LIMIT, "more than %d pairs of bodies are near each "
                                         "other: raise max_bodies of the world's definition", w->pair_capacity);
        bad = peri__grow(w, &data, (size_t)w->pair_capacity, (size_t)now, sizeof *w->pairs);
        if (bad) return bad;
        w->pairs = (uint64_t *)data;
        w->pair_capacity = now;
    }
    w->pairs[w->pair_count++] = (uint64_t)(uint32_t)a << 32 | (uint32_t)b;
    return PERI_OK;
}

/* Pairs (a, b) of bodies whose boxes meet, a awake, both ways, in order. */
static peri_result peri__pairs_find(peri_world *w) {
    int n = 0, i, j, k;
    peri_result bad = PERI_OK;
    w->pair_count = 0;
    for (k = 0; k < w->bodies.capacity; k++) {
        const peri__body *b = peri__body_at(w, k);
        if (!b) continue;
        w->sweep[n].lower = b->lower[0];
        w->sweep[n++].body = k;
    }
    peri__sort(w->sweep, (size_t)n, sizeof *w->sweep, peri__edge_before);
    for (i = 0; i < n && !bad; i++) {
        const peri__body *a = peri__body_at(w, w->sweep[i].body);
        for (j = i; j < n && !bad; j++) {
            const peri__body *b = peri__body_at(w, w->sweep[j].body);
            if (b->lower[0] > a->upper[0]) break;
            if ((a->asleep && b->asleep) || !peri__bodies_meet(a, b)) continue;
            if (!a->asleep) bad = peri__pair_add(w, w->sweep[i].body, w->sweep[j].body);
            if (!bad && !b->asleep && i != j) bad = peri__pair_add(w, w->sweep[j].body, w->sweep[i].body);
        }
    }
    peri__sort(w->pairs, (size_t)w->pair_count, sizeof *w->pairs, peri__pair_before);
    return bad;
}

/* All contacts that this step may have, in order of body, target, particle; when checking, those of bodies that strayed
   are only looked at. */
static peri_result peri__contacts_find(peri_world *w) {
    int k, i, pair = 0;
    peri_result bad = PERI_OK;
    if (!w->checking) w->contact_count = 0;
    w->pair_count = 0;
    if (w->bodies.count > 1 || w->self_contacts) bad = peri__pairs_find(w);
    for (k = 0; k < w->bodies.capacity && !bad; k++) {
        peri__body *a = peri__body_at(w, k);
        if (!a || a->asleep) continue;
        if (w->colliders.count && (a->strayed || !w->checking)) bad = peri__contacts_colliders(w, k);
        for (; !bad && pair < w->pair_count && (int)(w->pairs[pair] >> 32) == k; pair++) {
            int m = (int)(w->pairs[pair] & 0xffffffffu);
            if (w->checking && !a->strayed && !peri__body_at(w, m)->strayed) continue;
            bad = peri__body_grid(w, peri__body_at(w, m));
            for (i = 0; i < a->surface_count && !bad; i++) bad = peri__contact_try(w, k, m, a->surface[i]);
        }
    }
    return bad;
}

/* A guess deep inside a solid would start the solve from layers pushed through each other. The guess of the bodies that
   meet is drawn back towards where they were until no particle is deeper than a quarter of its distance. */
static void peri__contacts_retreat(peri_world *w) {
    double normal[3];
    int i, k;
    for (k = 0; k < w->bodies.capacity; k++) {
        peri__body *b = peri__body_at(w, k);
        if (b) b->retreat = 1;
    }
    for (i = 0; i < w->contact_count; i++) {
        peri__contact *t = &w->contacts[i];
        peri__body *a = peri__body_at(w, t->body), *b = peri__contact_other(w, t);
        double deepest = t->distance / 2, depth = t->depth, depth0, part;
        if (depth <= deepest) continue;
        depth0 = t->distance - peri__contact_distance(w, t, w->x0, normal);
        part = depth0 < deepest ? (deepest - depth0) / (depth - depth0) : 0;
        if (part < a->retreat) a->retreat = part;
        if (b && part < b->retreat) b->retreat = part;
    }
    for (k = 0; k < w->bodies.capacity; k++) {
        peri__body *b = peri__body_at(w, k);
        size_t at, end;
        if (!b || b->asleep || !(b->retreat < 1)) continue;
        end = 3 * (size_t)(b->first + b->count);
        for (at = 3 * (size_t)b->first; at < end; at++)
            if (!(w->flags[at / 3] & PERI__FIXED)) w->x[at] = w->x0[at] + b->retreat * (w->x[at] - w->x0[at]);
    }
    for (i = 0; i < w->contact_count; i++) peri__contact_force(w, &w->contacts[i]);
}

/* What holds a sleeping body stays. */
static int peri__hold_sleeps(const peri_world *w, const peri__hold *hold) {
    return peri__body_at(w, hold->body)->asleep != 0;
}

/* Room for what this step may have to remember: its contacts, and what sleeps. */
static peri_result peri__holds_reserve(peri_world *w) {
    int k, n = w->contact_count;
    for (k = 0; k < w->hold_count && w->asleep; k++) n += peri__hold_sleeps(w, &w->holds[k]);
    return peri__contacts_reserve(w, n);
}

/* What is to be remembered of a contact. */
static void peri__hold_take(const peri_world *w, const peri__contact *t, peri__hold *hold) {
    const peri__collider *solid = t->target < PERI__TARGET_BODY ? peri__contact_collider(w, t) : NULL;
    const double *x = w->x + 3 * (size_t)(peri__body_at(w, t->body)->first + t->particle);
    double tangent[3], arm[3], length, limit, share, distance;
    int c;
    hold->body = t->body;
    hold->target = t->target;
    hold->particle = t->particle;
    hold->side = t->side;
    hold->nearest = solid ? -1 : t->patch[0];
    hold->grade = t->grade;
    hold->overlap = t->depth;
    memcpy(hold->force, t->force, sizeof hold->force);
    memcpy(hold->normal, t->normal, sizeof hold->normal);
    memcpy(hold->entry, t->entry, sizeof hold->entry);
    peri__contact_slip(w, t, tangent, &length, &limit);
    share = length > limit ? limit / length : 1;
    for (c = 0; c < 3; c++) hold->anchor[c] = share * tangent[c];
    if (!solid) return;
    for (c = 0; c < 3; c++) arm[c] = x[c] - solid->position1[c] - share * tangent[c];
    peri__apply_back(solid->rotation1, arm, hold->anchor);
    peri__apply_back(solid->rotation1, t->normal, hold->normal);
    distance = peri__collider_distance(solid, 1, x, arm);
    if (!(peri__dot3(arm, t->normal) > -0.5)) return;
    for (c = 0; c < 3; c++) arm[c] = x[c] - solid->position1[c];
    peri__apply_back(solid->rotation1, arm, hold->entry);
    hold->entry[3] = distance;
}

/* Keeps the touching contacts of the finished step, moves the hold of those that slipped, sums the impulses. */
static void peri__contacts_commit(peri_world *w, double dt) {
    int k, c, n = 0, old = 0;
    peri__hold *swap;
    w->overlap = 0;
    for (k = 0; k < w->contact_count; k++) {
        peri__contact *t = &w->contacts[k];
        peri__body *a = peri__body_at(w, t->body), *b = peri__contact_other(w, t);
        peri__hold *hold;
        if (a->unsolved && (!b || b->asleep)) a->held = 1;
        if (!t->touching) continue;
        for (; old < w->hold_count && w->holds[old].body < t->body; old++)
            if (peri__hold_sleeps(w, &w->holds[old])) w->holds_next[n++] = w->holds[old];
        hold = &w->holds_next[n++];
        peri__hold_take(w, t, hold);
        a->touching = 1;
        if (t->depth > w->overlap * a->spacing) w->overlap = t->depth / a->spacing;
        if (b) {
            b->touching = 1;
            a->held |= b->asleep != 0;  /* a sleeper is a wall: it gives momentum to what meets it */
        } else {
            peri__collider *solid = (peri__collider *)(void *)peri__slot_at(&w->colliders, t->target);
            size_t at = 3 * (size_t)(a->first + t->particle);
            double push[3];
            for (c = 0; c < 3; c++) push[c] = -dt * t->force[c];
            peri__collider_push(solid, w->x + at, push);
            a->held = 1;
            if (peri__collider_moves(solid)) a->restless = 1;
        }
    }
    for (; old < w->hold_count; old++)
        if (peri__hold_sleeps(w, &w->holds[old])) w->holds_next[n++] = w->holds[old];
    swap = w->holds;
    w->holds = w->holds_next;
    w->holds_next = swap;
    k = w->held_rows[2];
    w->held_rows[2] = w->held_rows[3];
    w->held_rows[3] = k;
    w->hold_count = n;
}

/* ---- implementation 10: attachments ------------------------------------------------------------------------------ */

peri_attachment_def peri_default_attachment_def(void) {
    peri_attachment_def d;
    memset(&d, 0, sizeof d);
    d.cookie = PERI__COOKIE + 4;
    d.here = 1;
    d.break_force = PERI__R(1e30);
    return d;
}

static peri__attachment *peri__attachment_find(const peri_world *w, peri_attachment_id id) {
    return w ? (peri__attachment *)(void *)peri__slot_find(&w->attachments, id.index1, id.generation) : NULL;
}

static peri_result peri__no_attachment(peri_world *w, peri_attachment_id id) {
    if (!w) return PERI_ERROR_ARGUMENT;
    return peri__report(w, peri__fail(&w->error, PERI_ERROR_ID, "attachment (%u, %u) does not exist in this world (it "
                                      "may have broken)", (unsigned)id.index1, (unsigned)id.generation));
}

static peri_result peri__check_particle(const char *name, const peri__body *b, int particle, peri_error *err) {
    if (particle >= 0 && particle < peri__real_count(b)) return PERI_OK;
    return peri__fail(err, PERI_ERROR_INDEX, "%s is %d; the body has 0 to %d", name, particle, peri__real_count(b) - 1);
}

static peri_result peri__check_attachment(peri_world *w, const peri_attachment_def *d) {
    peri_error *err = &w->error;
    peri__body *a, *b;
    peri_result bad;
    if (!d) return peri__fail(err, PERI_ERROR_ARGUMENT, "the attachment's definition is NULL");
    if (d->cookie != PERI__COOKIE + 4)
        return peri__fail(err, PERI_ERROR_ARGUMENT,
                          "the attachment's definition was not made by peri_default_attachment_def");
    a = peri__body_find(w, d->body);
    b = peri__body_find(w, d->other);
    if (!a || (!b && (d->other.index1 || d->other.generation)))
        return peri__fail(err, PERI_ERROR_ID, "%s of the attachment does not exist in this world",
                          a ? "other" : "body");
    if ((d->collider.index1 || d->collider.generation) && !peri__collider_find(w, d->collider))
        return peri__fail(err, PERI_ERROR_ID, "the attachment's collider does not exist in this world");
    if (b && d->collider.index1)
        return peri__fail(err, PERI_ERROR_ARGUMENT, "the attachment has both other and collider; take one");
    bad = peri__check_particle("particle", a, d->particle, err);
    if (!bad && b) bad = peri__check_particle("other_particle", b, d->other_particle, err);
    if (!bad && a == b && d->particle == d->other_particle)
        bad = peri__fail(err, PERI_ERROR_ARGUMENT, "the attachment joins particle %d to itself", d->particle);
    if (!bad) bad = peri__finite_vec("point", d->point, err);
    if (!bad) bad = peri__check_range("length", (double)d->length, 0, 1e15, err);
    if (!bad) bad = peri__check_range("stiffness", (double)d->stiffness, 0, 1e18, err);
    if (!bad) bad = peri__check_range("break_force", (double)d->break_force, 1e-30, 1e31, err);
    return bad;
}

/* The end that is no particle of `body`, in the world, at the end (1) or the start (0) of the step. */
static void peri__attachment_end(const peri_world *w, const peri__attachment *t, int end, double out[3]) {
    const peri__collider *solid;
    int c;
    if (t->other >= 0) {
        const peri__body *b = peri__body_at(w, t->other);
        memcpy(out, (end ? w->x : w->x0) + 3 * (size_t)(b->first + t->def.other_particle), 3 * sizeof *out);
        return;
    }
    if (t->collider < 0) {
        memcpy(out, t->point, 3 * sizeof *out);
        return;
    }
    solid = peri__collider_at(w, t->collider);
    peri__apply(end ? solid->rotation1 : solid->rotation, t->point, out);
    for (c = 0; c < 3; c++) out[c] += end ? solid->position1[c] : solid->position[c];
}

/* Both ends of an attachment, and their colliders' users, feel its changes. */
static void peri__attachment_changed(peri_world *w, const peri__attachment *t) {
    peri__body *a = peri__body_at(w, t->body), *b = t->other >= 0 ? peri__body_at(w, t->other) : NULL;
    peri__wake(w, a);
    if (b) peri__wake(w, b);
}

peri_attachment_id peri_attachment_create(peri_world *w, const peri_attachment_def *d) {
    peri_attachment_id id = {0, 0};
    peri__attachment *t;
    const double *x;
    double far_end[3], away[3];
    int c;
    if (!w) return id;
    t = peri__check_attachment(w, d) ? NULL : (peri__attachment *)(void *)peri__slot_take(w, &w->attachments);
    if (!t) {
        peri__report(w, w->error.code);
        return id;
    }
    t->def = *d;
    t->body = (int)d->body.index1 - 1;
    t->other = (int)d->other.index1 - 1;
    t->collider = (int)d->collider.index1 - 1;
    t->length = (double)d->length;
    peri__vec(d->point, t->point);
    x = w->x0 + 3 * (size_t)(peri__body_at(w, t->body)->first + d->particle);
    if (d->here && t->other >= 0) {
        peri__attachment_end(w, t, 0, far_end);
        for (c = 0; c < 3; c++) away[c] = x[c] - far_end[c];
        t->length = sqrt(peri__dot3(away, away));
    } else if (d->here && t->collider >= 0) {
        const peri__collider *solid = peri__collider_at(w, t->collider);
        for (c = 0; c < 3; c++) away[c] = x[c] - solid->position[c];
        peri__apply_back(solid->rotation, away, t->point);
    } else if (d->here) {
        memcpy(t->point, x, sizeof t->point);
    }
    id.index1 = peri__slot_use(&w->attachments, &t->slot);
    id.generation = t->slot.generation;
    peri__attachment_changed(w, t);
    return id;
}

peri_result peri_attachment_destroy(peri_world *w, peri_attachment_id id) {
    peri__attachment *t = peri__attachment_find(w, id);
    if (!t) return peri__no_attachment(w, id);
    peri__attachment_changed(w, t);
    peri__slot_free(&w->attachments, &t->slot);
    return PERI_OK;
}

int peri_attachment_is_valid(const peri_world *w, peri_attachment_id id) {
    return peri__attachment_find(w, id) != NULL;
}

peri_result peri_attachment_set_point(peri_world *w, peri_attachment_id id, peri_vec3 point) {
    peri__attachment *t = peri__attachment_find(w, id);
    peri_result bad;
    if (!t) return peri__no_attachment(w, id);
    bad = peri__finite_vec("point", point, &w->error);
    if (!bad && t->other >= 0)
        bad = peri__fail(&w->error, PERI_ERROR_ARGUMENT, "the attachment joins two particles and has no point");
    if (bad) return peri__report(w, bad);
    peri__vec(point, t->point);
    peri__attachment_changed(w, t);
    return PERI_OK;
}

peri_result peri_attachment_force(const peri_world *w, peri_attachment_id id, peri_vec3 *force) {
    peri__attachment *t = peri__attachment_find(w, id);
    if (!t) return w ? PERI_ERROR_ID : PERI_ERROR_ARGUMENT;
    if (!force) return PERI_ERROR_ARGUMENT;
    *force = peri__to_vec(t->committed);
    return PERI_OK;
}

/* Forgets the attachments of body `body` or of collider `collider` (-1: none). */
static void peri__attachments_drop(peri_world *w, int body, int collider) {
    int k;
    for (k = 0; k < w->attachments.capacity; k++) {
        peri__attachment *t = peri__attachment_at(w, k);
        if (!t || !((body >= 0 && (t->body == body || t->other == body)) || (collider >= 0 && t->collider == collider)))
            continue;
        peri__attachment_changed(w, t);
        peri__slot_free(&w->attachments, &t->slot);
    }
}

/* Before a step: how stiff the rigid ones are. */
static void peri__attachments_begin(peri_world *w) {
    int k;
    for (k = 0; k < w->attachments.capacity; k++) {
        peri__attachment *t = peri__attachment_at(w, k);
        const peri__body *a, *b;
        double other;
        if (!t) continue;
        a = peri__body_at(w, t->body);
        b = t->other >= 0 ? peri__body_at(w, t->other) : NULL;
        t->stiffness = (double)t->def.stiffness;
        if (a->asleep || t->stiffness > 0) continue;
        t->stiffness = peri__contact_stiffness(w, a, t->def.particle);
        other = b ? peri__contact_stiffness(w, b, t->def.other_particle) : 0;
        t->stiffness = 10 * (t->stiffness > other ? t->stiffness : other);
    }
}

/* Force on the particle and energy at the present positions. */
static void peri__attachment_force_now(const peri_world *w, peri__attachment *t) {
    const double *x = w->x + 3 * (size_t)(peri__body_at(w, t->body)->first + t->def.particle);
    double away[3], length, over;
    int c;
    peri__attachment_end(w, t, 1, away);
    for (c = 0; c < 3; c++) away[c] = x[c] - away[c];
    length = sqrt(peri__dot3(away, away));
    over = length - t->length;
    if (t->def.rope && over < 0) over = 0;
    for (c = 0; c < 3; c++) {
        t->force[c] = length > 0 ? -t->stiffness * over / length * away[c] : 0;
        if (!(t->length > 0)) t->force[c] = -t->stiffness * away[c];
    }
    t->energy = t->stiffness * over * over / 2;
}

/* Takes the force from a gradient that begins with particle `origin` of the island order. */
static void peri__attachment_scatter(const peri_world *w, const peri__attachment *t, int origin, peri_real *g) {
    const peri__body *a = peri__body_at(w, t->body), *b = t->other >= 0 ? peri__body_at(w, t->other) : NULL;
    peri_real *at = g + 3 * (size_t)(a->at - origin + t->def.particle);
    int c;
    if (!(w->flags[a->first + t->def.particle] & PERI__FIXED))
        for (c = 0; c < 3; c++) at[c] -= (peri_real)t->force[c];
    if (!b || w->flags[b->first + t->def.other_particle] & PERI__FIXED) return;
    at = g + 3 * (size_t)(b->at - origin + t->def.other_particle);
    for (c = 0; c < 3; c++) at[c] += (peri_real)t->force[c];
}

/* After a step: impulses to colliders, who is held. */
static void peri__attachments_commit(peri_world *w, double dt) {
    int k, c;
    for (k = 0; k < w->attachments.capacity; k++) {
        peri__attachment *t = peri__attachment_at(w, k);
        peri__body *a;
        double push[3], end[3];
        if (!t || peri__body_at(w, t->body)->asleep) continue;
        a = peri__body_at(w, t->body);
        peri__attachment_force_now(w, t);
        memcpy(t->committed, t->force, sizeof t->force);
        if (t->collider >= 0) {
            peri__collider *solid = peri__collider_at(w, t->collider);
            for (c = 0; c < 3; c++) push[c] = -dt * t->force[c];
            peri__attachment_end(w, t, 1, end);
            peri__collider_push(solid, end, push);
            if (peri__collider_moves(solid)) a->restless = 1;
        }
        if (t->other < 0) a->held = 1;
    }
}

/* What pulled too hard breaks: after the momenta of the step, of which its pull was a part. */
static void peri__attachments_break(peri_world *w) {
    int k;
    for (k = 0; k < w->attachments.capacity; k++) {
        peri__attachment *t = peri__attachment_at(w, k);
        double limit = t ? (double)t->def.break_force : 0;
        if (!t || peri__body_at(w, t->body)->asleep || !(peri__dot3(t->force, t->force) > limit * limit)) continue;
        peri__attachment_changed(w, t);
        peri__slot_free(&w->attachments, &t->slot);
        w->stats.broken++;
    }
}

/* ---- implementation 11: forces -----------------------------------------------------------------------------------
   Of bodies in lanes (peri_material.h, implementation 9), or particle by particle. In lanes every pass begins by
   putting a body's positions where the hot loops read them: displacements from the rest shape, in float builds as
   32-bit integers over the box that they fill, in units of a power of two. The corner is a multiple of the unit, so
   that two passes round alike. Measured: forces of a hanging beam of 25 000 particles are off by 1.5e-5 of a particle's
   weight at E = 1e5 Pa and by 6e-5 at 1e6; by differences in double 1e-5 and 3e-5, by float positions 1.3e-3 and
   1.3e-2. */

#define PERI__LANES_GRAIN (PERI__GRAIN / PERI__LANES)

typedef struct peri__placing {
    peri_world *w;
    peri__body *b;
    const double *x;        /* of the body */
    double turn[9];
    int turned;
    double corner[3], scale;
} peri__placing;

/* Displacements of particles first .. first + count - 1 (at most PERI__LANES) from the rest shape. */
static void peri__departures(const peri__placing *p, int first, int count, double *d) {
    const double *x = p->x + 3 * (size_t)first;
    const peri_real *rest = p->b->points + 3 * (size_t)first;
    double home[3 * PERI__LANES], v[3];
    int k, c;
    for (k = 0; k < 3 * count; k++) home[k] = (double)rest[k];
    for (k = 0; k < count && p->turned; k++) {
        for (c = 0; c < 3; c++) v[c] = home[3 * k + c];
        peri__apply(p->turn, v, home + 3 * k);
    }
    for (k = 0; k < 3 * count; k++) d[k] = x[k] - home[k];
}

/* The box of each grain into w->partial, six numbers; NaN where a position is not finite. */
static void peri__box_task(int begin, int end, void *context) {
    const peri__placing *p = (const peri__placing *)context;
    const peri__lanes *t = &p->b->lanes;
    double d[3 * PERI__LANES], low[3 * PERI__LANES], high[3 * PERI__LANES], odd[3 * PERI__LANES];
    int next, q, k;
    for (; begin < end; begin = next) {
        double *box = p->w->partial + p->b->first + 6 * (begin / PERI__LANES_GRAIN);
        next = begin / PERI__LANES_GRAIN * PERI__LANES_GRAIN + PERI__LANES_GRAIN;
        if (next > end) next = end;
        for (k = 0; k < 3 * PERI__LANES; k++) low[k] = 1e300, high[k] = -1e300, odd[k] = 0;
        for (q = begin; q < next; q++) {
            int count = t->first[q + 1] - t->first[q];
            if (count < 1) continue; /* there is no such block */
            peri__departures(p, t->first[q], count, d);
            for (k = 3 * count; k < 3 * PERI__LANES; k++) d[k] = d[k - 3];
            for (k = 0; k < 3 * PERI__LANES; k++) {
                low[k] = d[k] < low[k] ? d[k] : low[k];
                high[k] = d[k] > high[k] ? d[k] : high[k];
                odd[k] += 0 * d[k];
            }
        }
        for (k = 0; k < 3; k++) box[k] = 1e300, box[3 + k] = -1e300;
        for (k = 0; k < 3 * PERI__LANES; k++) {
            if (low[k] < box[k % 3]) box[k % 3] = low[k];
            if (high[k] > box[3 + k % 3]) box[3 + k % 3] = high[k];
        }
        for (k = 0; k < 3 * PERI__LANES; k++) box[k % 3] += odd[k];
    }
}

static void peri__place_task(int begin, int end, void *context) {
    const peri__placing *p = (const peri__placing *)context;
    const peri__lanes *t = &p->b->lanes;
    double d[3 * PERI__LANES], corner[3 * PERI__LANES];
    peri__spot at[3 * PERI__LANES];
    int q, k, l, c;
    for (k = 0; k < 3 * PERI__LANES; k++) corner[k] = p->corner[k % 3], d[k] = 0;
    for (q = begin; q < end; q++) {
        const int *who = t->who + PERI__LANES * (size_t)q;
        size_t cell = (size_t)(t->lattice ? t->base[q] : PERI__LANES * q);
        int first = t->first[q], count = t->first[q + 1] - first;
        peri__departures(p, first, count, d);
#ifdef PERI_DOUBLE
        memcpy(at, d, sizeof at);
        (void)corner;
#else
        for (k = 3 * count; k < 3 * PERI__LANES; k++) d[k] = corner[k];
        for (k = 0; k < 3 * PERI__LANES; k++) at[k] = (peri__spot)((d[k] - corner[k]) * p->scale + 0.5);
#endif
        if (count == PERI__LANES) {
            for (c = 0; c < 3; c++)
                for (l = 0; l < PERI__LANES; l++) t->x[c][cell + (size_t)l] = at[3 * l + c];
            continue;
        }
        for (l = 0; l < PERI__LANES; l++)
            for (c = 0; c < 3 && who[l] >= 0; c++) t->x[c][cell + (size_t)l] = at[3 * (who[l] - first) + c];
    }
}

/* Positions x (3 n) into the body's lanes. Returns 0 where there are none, or 32 bits would be too coarse (1e-6 of the
   spacing), or a position is not finite: then the particles are computed one by one. */
static int peri__lanes_place(peri_world *w, peri__body *b, const double *x) {
    peri__placing p;
    peri__lanes *t = &b->lanes;
    double size = 0, low, high, unit = 1;
    int c;
    if (!t->blocks) return 0;
    memset(&p, 0, sizeof p);
    p.w = w;
    p.b = b;
    p.x = x;
    peri__quat_matrix(b->rotation, p.turn);
    for (c = 0; c < 9; c++) p.turned |= fabs(p.turn[c] - (c % 4 == 0)) > 0;
    if (sizeof(peri__spot) == sizeof(int32_t)) {
        const double *box = w->partial + b->first;
        int k, grains = (t->blocks + PERI__LANES_GRAIN - 1) / PERI__LANES_GRAIN, power;
        peri_parallel_for(&w->def.parallel, t->blocks, PERI__LANES_GRAIN, peri__box_task, &p);
        for (c = 0; c < 3; c++) {
            for (low = box[c], high = box[3 + c], k = 1; k < grains; k++) {
                low = box[6 * k + c] < low || !peri__finite(box[6 * k + c]) ? box[6 * k + c] : low;
                high = box[6 * k + 3 + c] > high ? box[6 * k + 3 + c] : high;
                if (!peri__finite(low)) break;
            }
            if (!peri__finite(low) || !peri__finite(high - low)) return 0;
            p.corner[c] = low;
            if (high - low > size) size = high - low;
        }
        frexp(size / 2147483600.0 > 1e-10 * b->spacing ? size / 2147483600.0 : 1e-10 * b->spacing, &power);
        unit = ldexp(1.0, power);
        if (unit > 1e-6 * b->spacing) return 0;
        for (c = 0; c < 3; c++) p.corner[c] = floor(p.corner[c] / unit) * unit;
        p.scale = 1 / unit;
    }
    t->unit = (peri_real)unit;
    peri_parallel_for(&w->def.parallel, t->blocks, PERI__LANES_GRAIN, peri__place_task, &p);
    return 1;
}

typedef struct peri__pass {
    peri_world *w;
    peri__body *b;
    const peri__bonds *bonds;
    const peri__model_row *row;
    const double *x, *star;     /* of the body; star NULL: forces only */
    peri_real *f;               /* in: where to put them; out: forces, or the gradient of the step's energy */
    double inv_h2;
    const peri__lanes *lanes;   /* NULL: particle by particle */
    int energy;                 /* 1: energies too, a partial sum for every PERI__GRAIN particles in w->partial */
} peri__pass;

static peri_real *peri__coef(const peri_world *w, const peri__body *b) {
    return w->coef + (size_t)w->stride * (size_t)b->first;
}

static peri_real *peri__plate_coef(const peri_world *w, const peri__body *b) {
    return w->plate + PERI__PLATE_STRIDE * (size_t)b->first;
}

static void peri__local_task(int begin, int end, void *context) {
    peri__pass *p = (peri__pass *)context;
    int special = p->b->unhealthy || p->b->singular, next;
    double bend = 0;
    for (; begin < end; begin = next) {     /* a piece may hold several grains; the sums must not */
        double *sum = p->w->partial + p->b->first + begin / PERI__GRAIN;
        next = begin / PERI__GRAIN * PERI__GRAIN + PERI__GRAIN;
        if (next > end) next = end;
        *sum = p->row->local(p->bonds, &p->b->matter, p->x, begin, next, peri__coef(p->w, p->b), p->energy);
        if (special) *sum += peri__special_local(p->bonds, &p->b->matter, p->x, begin, next, p->energy);
        if (p->b->plate) bend = peri__plate_local(p->bonds, p->x, begin, next, peri__plate_coef(p->w, p->b));
        if (p->energy) *sum += bend;
    }
}

/* What comes on top of the model's own forces on particles begin .. end - 1. */
static void peri__force_rest(peri__pass *p, int begin, int end) {
    int special = p->b->unhealthy || p->b->singular, c;
    size_t i;
    if (special) peri__special_force(p->bonds, &p->b->matter, p->x, begin, end, p->f);
    if (p->b->plate) peri__plate_force(p->bonds, begin, end, peri__plate_coef(p->w, p->b), p->f);
    if (!p->star) return;
    for (i = (size_t)begin; i < (size_t)end; i++) {
        double mass = (double)p->w->mass[(size_t)p->b->first + i] * p->inv_h2;
        int fixed = p->w->flags[(size_t)p->b->first + i] & PERI__FIXED;
        for (c = 0; c < 3; c++) {
            size_t k = 3 * i + (size_t)c;
            p->f[k] = fixed ? 0 : (peri_real)(mass * (p->x[k] - p->star[k]) - (double)p->f[k]);
        }
    }
}

static void peri__force_task(int begin, int end, void *context) {
    peri__pass *p = (peri__pass *)context;
    p->row->force(p->bonds, &p->b->matter, p->x, begin, end, peri__coef(p->w, p->b), p->f);
    peri__force_rest(p, begin, end);
}

/* The same two tasks over blocks of lanes. */
static void peri__lanes_local_task(int begin, int end, void *context) {
    peri__pass *p = (peri__pass *)context;
    const peri__lanes *t = p->lanes;
    int special = p->b->unhealthy || p->b->singular, next;
    for (; begin < end; begin = next) {
        double *sum = p->w->partial + p->b->first + begin / PERI__LANES_GRAIN;
        next = begin / PERI__LANES_GRAIN * PERI__LANES_GRAIN + PERI__LANES_GRAIN;
        if (next > end) next = end;
        *sum = p->row->lanes_local(p->bonds, t, &p->b->matter, begin, next, p->energy);
        if (special)
            *sum += peri__special_local(p->bonds, &p->b->matter, p->x, t->first[begin], t->first[next], p->energy);
    }
}

static void peri__lanes_force_task(int begin, int end, void *context) {
    peri__pass *p = (peri__pass *)context;
    p->row->lanes_force(p->bonds, p->lanes, &p->b->matter, begin, end, p->f);
    peri__force_rest(p, p->lanes->first[begin], p->lanes->first[end]);
}

static void peri__pass_begin(peri__pass *p, peri_world *w, peri__body *b, peri_real *f) {
    memset(p, 0, sizeof *p);
    p->w = w;
    p->b = b;
    p->bonds = peri__view(w, b);
    p->row = peri__model(b->matter.m.model);
    p->x = w->x + 3 * (size_t)b->first;
    p->f = f;
}

/* Elastic forces, or the gradient of the step's energy when star is set; returns the elastic energy if asked for. */
static double peri__pass_run(peri__pass *p) {
    const peri_parallel *par = &p->w->def.parallel;
    double sum = 0;
    int k, count = p->b->count, grain = PERI__GRAIN;
    if (peri__lanes_place(p->w, p->b, p->x)) {
        p->lanes = &p->b->lanes;
        count = p->lanes->blocks;
        grain = PERI__LANES_GRAIN;
    }
    peri_parallel_for(par, count, grain, p->lanes ? peri__lanes_local_task : peri__local_task, p);
    peri_parallel_for(par, count, grain, p->lanes ? peri__lanes_force_task : peri__force_task, p);
    for (k = 0; k < count && p->energy; k += grain) sum += p->w->partial[p->b->first + k / grain];
    return sum;
}

/* Elastic energy of particles begin .. end - 1 of a body at its present positions, J. */
static double peri__elastic(peri_world *w, peri__body *b, int begin, int end) {
    peri__pass p;
    double sum;
    peri__pass_begin(&p, w, b, NULL);
    sum = p.row->local(p.bonds, &b->matter, p.x, begin, end, peri__coef(w, b), 1);
    if (b->unhealthy || b->singular) sum += peri__special_local(p.bonds, &b->matter, p.x, begin, end, 1);
    if (b->plate) sum += peri__plate_local(p.bonds, p.x, begin, end, peri__plate_coef(w, b));
    return sum;
}

/* ---- implementation 12: health ----------------------------------------------------------------------------------- */

typedef struct peri__health {
    peri_world *w;
    peri__body *b;
    const peri__bonds *bonds;
    peri_real *brace;   /* of a correspondence solid's particles, or NULL */
    peri_real share;    /* of the braces: under BDF2, which loses less, what they add step by step would be seen */
    int fill;           /* second pass: shapes of the unhealthy into special */
} peri__health;

/* 1 where a particle is out of shape. */
static peri_real peri__brace_one(const peri__health *p, const peri__matter *m, const double f[9], int bad) {
    peri__row wide[9];
    peri_real brace[PERI__LANES];
    int k;
    for (k = 0; k < 9; k++) wide[k][0] = (peri_real)f[k];
    peri__brace(m, 1, wide, p->share, brace);
    return bad ? 1 : brace[0];
}

static void peri__health_one(const peri__health *p, int i) {
    const double *x = p->w->x0 + 3 * (size_t)p->b->first;
    unsigned char *mode = p->w->mode + p->b->first, flags = p->w->flags[p->b->first + i];
    const peri__matter *m = peri__matter_of(p->bonds, &p->b->matter, i);
    double f[9], h[6];
    peri_real fhat[9];
    int bad, k, sheet = p->bonds->normal != NULL, strain = p->b->moment != NULL;
    unsigned char skip = (unsigned char)(sheet ? PERI__SINGULAR : PERI__FLAT | PERI__SINGULAR);
    if (p->fill ? mode[i] != PERI__RESTORED : (flags & skip) != 0) {
        if (!p->fill) mode[i] = flags & PERI__SINGULAR ? PERI__FALLBACK : PERI__MAIN;
        if (!p->fill && p->brace) p->brace[i] = 1;
        return;
    }
    peri__gradient(p->bonds, x, i, f);
    if (strain) peri__strain(p->bonds, x, i, h);
    if (sheet) bad = peri__unhealthy_sheet(m, f, h, p->bonds->normal + 3 * (size_t)i, fhat);
    else bad = peri__unhealthy(m, f, strain ? h : NULL, fhat);
    mode[i] = bad ? PERI__RESTORED : PERI__MAIN;
    if (p->brace) p->brace[i] = peri__brace_one(p, m, f, bad);
    for (k = 0; k < 9 && p->fill; k++) p->w->special[9 * (size_t)(p->b->first + i) + (size_t)k] = fhat[k];
}

static void peri__health_task(int begin, int end, void *context) {
    int i;
    for (i = begin; i < end; i++) peri__health_one((const peri__health *)context, i);
}

/* The same by blocks of lanes: only where these see anything is looked at closely. */
static void peri__health_lanes_task(int begin, int end, void *context) {
    const peri__health *p = (const peri__health *)context;
    const peri__lanes *t = &p->b->lanes;
    const peri_material *m = &p->b->matter.m;
    unsigned char *mode = p->w->mode + p->b->first;
    const unsigned char *flags = p->w->flags + p->b->first;
    int q, l, plain = (double)m->healthy_min < 0.7 && (double)m->healthy_max > 1.23;
    peri__row away, brace;
    memset(brace, 0, sizeof brace);
    for (q = begin; q < end; q++) {
        peri__lanes_away(p->bonds, t, &p->b->matter, q, p->b->moment != NULL, away, p->share,
                        p->brace ? brace : NULL);
        for (l = 0; l < PERI__LANES; l++) {
            int i = t->who[PERI__LANES * q + l];
            if (i < 0) continue;
            if (plain && away[l] < PERI__R(0.2499) && !(flags[i] & (PERI__FLAT | PERI__SINGULAR))) {
                mode[i] = PERI__MAIN;
                if (p->brace) p->brace[i] = brace[l];
            } else {
                peri__health_one(p, i);
            }
        }
    }
}

/* Which particles are out of shape at the start of the step, and which are pressed so much that they need a brace. */
static peri_result peri__health_check(peri_world *w, peri__body *b) {
    const peri_parallel *par = &w->def.parallel;
    peri__health p;
    peri_result bad = PERI_OK;
    int i;
    p.w = w;
    p.b = b;
    p.bonds = peri__view(w, b);
    p.brace = b->moment && !b->normal ? w->brace + b->first : NULL;
    p.share = w->def.integrator == PERI_BDF2 ? PERI__R(0.5) : 1;
    p.fill = 0;
    if (b->matter.restore > 0 && peri__lanes_place(w, b, w->x0 + 3 * (size_t)b->first))
        peri_parallel_for(par, b->lanes.blocks, PERI__LANES_GRAIN, peri__health_lanes_task, &p);
    else peri_parallel_for(par, b->count, PERI__GRAIN, peri__health_task, &p);
    for (b->unhealthy = 0, i = 0; i < b->count; i++) b->unhealthy += w->mode[b->first + i] == PERI__RESTORED;
    for (b->braced = 0, i = 0; p.brace && i < b->count; i++) b->braced += p.brace[i] > 1;
    if (!b->unhealthy) return PERI_OK;
    bad = peri__reserve(w, w->particles, PERI__WANT_SPECIAL, 0);
    p.fill = 1;
    if (!bad) peri_parallel_for(par, b->count, PERI__GRAIN, peri__health_task, &p);
    return bad;
}

/* ---- implementation 13: the constant matrix (PP section 4.1, SH (23)) --------------------------------------------
   M/h^2 + scale * the weighted Laplacian of the bonds. It only steers the iteration: the answer is that of the forces,
   so a matrix made for a slightly different step, or without the newest contact, still serves. */

static void peri__matrix_values(peri_world *w, peri__body *b) {
    const unsigned char *flags = w->flags + b->first;
    double scale = (double)w->def.matrix_scale, ratio;
    int i, k;
    b->chebyshev_low = 1;
    for (i = 0; i < b->count; i++) {
        double mass = (double)w->mass[b->first + i] / (b->h * b->h) + (double)b->pinned[i];
        for (k = b->row[i]; k < b->row[i + 1]; k++)
            b->value[k] = flags[i] & PERI__FIXED || flags[b->col[k]] & PERI__FIXED
                              ? 0 : (peri_real)(-scale * peri__bond_stiffness(b, i, k));
        b->diagonal[i] = (peri_real)(mass + scale * (double)b->stiffness[i]);
        ratio = mass / (mass + scale * (double)b->stiffness[i]);
        if (ratio < b->chebyshev_low) b->chebyshev_low = ratio;
    }
    b->matrix_h = b->h;
    b->stale = 0;
    b->wasted = 0;
}

static size_t peri__pin_at(const peri__body *b, int i) { return 3 * (size_t)b->at + (size_t)i; }

/* What contacts and joints want to see in the diagonals of an island's matrices, N/m, into p, which is scratch here:
   contacts where they touch, or (guessing, before a solve) where they did and have hardly left. */
static void peri__island_pin(peri_world *w, const peri__island *island, int guessing) {
    const peri__body *b;
    int i, k;
    memset(w->p + 3 * (size_t)island->at, 0, 3 * (size_t)island->count * sizeof *w->p);
    for (i = island->contacts; i < island->contacts_end; i++) {
        const peri__contact *t = &w->contacts[w->contact_order[i]];
        if (!(t->depth > 0) && !(guessing && t->known && t->depth > -0.1 * t->distance)) continue;
        b = peri__body_at(w, t->body);
        w->p[peri__pin_at(b, t->particle)] += (peri_real)t->stiffness;
        b = peri__contact_other(w, t);
        for (k = 0; b && !b->asleep && k < t->count; k++)
            w->p[peri__pin_at(b, t->patch[k])] += (peri_real)(t->share[k] * t->stiffness);
    }
    for (i = island->attachment; i >= 0; i = peri__attachment_at(w, i)->next) {
        const peri__attachment *t = peri__attachment_at(w, i);
        if (t->length > 0) continue;    /* stiff along itself only: pinned, a pendulum's corrections would seem small */
        b = peri__body_at(w, t->body);
        w->p[peri__pin_at(b, t->def.particle)] += (peri_real)t->stiffness;
        b = t->other >= 0 ? peri__body_at(w, t->other) : NULL;
        if (b) w->p[peri__pin_at(b, t->def.other_particle)] += (peri_real)t->stiffness;
    }
}

/* Number of particles whose pin differs from what the matrix knows. */
static int peri__matrix_stale(const peri_world *w, const peri__body *b) {
    int i, differ = 0;
    for (i = 0; i < b->count; i++)
        differ += (w->p[peri__pin_at(b, i)] > 0) != (b->pinned[i] > 0);
    return differ;
}

static peri_matrix peri__matrix(const peri__body *b) {
    peri_matrix a;
    a.n = b->count;
    a.row = b->row;
    a.col = b->col;
    a.value = b->value;
    a.diagonal = b->diagonal;
    return a;
}

/* What parts of an iteration take, in nanoseconds on one core of 2023 (AVX-512); only their ratios count, and they hold
   within a factor of two elsewhere. tests/bench/step.c prints what they come from. */
#define PERI__COST_LATTICE 2.3      /* forces: a directed bond of a lattice, in lockstep, and one by one */
#define PERI__COST_LOCKSTEP 6.3
#define PERI__COST_BOND 20.0
#define PERI__COST_ROW 30.0         /* vectors of L-BFGS and the search: a particle */
#define PERI__COST_ENTRY 0.65       /* a full solve: an entry of L */
#define PERI__COST_LEVELS 11.0      /* a solve on two levels: a particle */
#define PERI__COST_OPERATION 0.02   /* a factorisation: a multiplication and addition */
#define PERI__LEVELS_MORE 1.25      /* iterations with two levels over those with a factor */
#define PERI__ITERATIONS 10.0       /* of a step, with a factor */
#define PERI__STEPS 60.0            /* that a factor serves */
#define PERI__SMALL 1000            /* particles up to which there is nothing to gain */

static double peri__evaluation_cost(const peri__body *b) {
    double bond = !b->lanes.blocks ? PERI__COST_BOND : b->lanes.lattice ? PERI__COST_LATTICE : PERI__COST_LOCKSTEP;
    return bond * b->row[b->count] + PERI__COST_ROW * b->count;
}

#ifndef PERI_NO_CHOLESKY
static uint64_t peri__hash_words(uint64_t hash, const void *data, size_t bytes) {
    const char *p = (const char *)data;
    uint32_t word;
    for (; bytes >= sizeof word; bytes -= sizeof word, p += sizeof word) {
        memcpy(&word, p, sizeof word);
        hash = (hash ^ word) * 0x9e3779b97f4a7c15u;
        hash ^= hash >> 29;
    }
    return hash;
}

static uint64_t peri__matrix_hash(const peri__body *b) {
    size_t bonds = (size_t)b->row[b->count];
    uint64_t hash = peri__hash_words((uint64_t)(uint32_t)b->count, b->col, bonds * sizeof *b->col);
    hash = peri__hash_words(hash, b->value, bonds * sizeof *b->value);
    return peri__hash_words(hash, b->diagonal, (size_t)b->count * sizeof *b->diagonal);
}

static int peri__matrix_equal(const peri__body *a, const peri__body *b) {
    size_t n = (size_t)a->count, bonds = (size_t)a->row[a->count];
    return a->count == b->count && a->row[a->count] == b->row[b->count] &&
           !memcmp(a->row, b->row, (n + 1) * sizeof *a->row) && !memcmp(a->col, b->col, bonds * sizeof *a->col) &&
           !memcmp(a->value, b->value, bonds * sizeof *a->value) &&
           !memcmp(a->diagonal, b->diagonal, n * sizeof *a->diagonal);
}

/* Joins the factor of another body whose matrix has the same bits; returns 0 when there is none. */
static int peri__factor_join(peri_world *w, peri__body *b, uint64_t hash) {
    int k;
    for (k = 0; k < w->bodies.capacity; k++) {
        peri__body *other = peri__body_at(w, k);
        if (!other || other == b || !other->factor || other->factor->hash != hash || !(other->matrix_h > 0) ||
            other->factor == b->factor || other->solver != b->solver || !peri__matrix_equal(other, b))
            continue;
        peri__factor_leave(w, b);
        b->factor = other->factor;
        b->factor->users++;
        return 1;
    }
    return 0;
}

/* A factor of its own for a body that has none, or shares one. */
static peri_result peri__factor_own(peri_world *w, peri__body *b, const peri_matrix *a, peri_error *err) {
    peri_allocator memory = peri__spare(w);
    peri__factor *f;
    peri_result bad;
    if (b->factor && b->factor->users == 1) return PERI_OK;
    f = (peri__factor *)peri__spare_resize(NULL, 0, sizeof *f, w);
    if (!f) return peri__fail(err, PERI_ERROR_MEMORY, "%zu bytes for a factor were refused", sizeof *f);
    memset(f, 0, sizeof *f);
    if (b->solver == PERI_SOLVER_CHOLESKY) /* a copy that goes its own way keeps what was found out of the pattern */
        bad = b->factor && b->factor->l ? peri_cholesky_create_like(b->factor->l, &memory, &f->l, err)
                                        : peri_cholesky_create(a, b->points, &memory, &f->l, err);
    else bad = peri_two_level_create(a, b->points, 3 * (double)b->spacing, 3, &memory, &f->levels, err);
    if (bad) {
        peri__spare_resize(f, sizeof *f, 0, w);
        return bad;
    }
    if (f->l) peri_cholesky_threads(f->l, &w->def.parallel);
    else peri_two_level_threads(f->levels, &w->def.parallel);
    w->stats.factor_bytes += peri_cholesky_bytes(f->l) + peri_two_level_bytes(f->levels);
    w->stats.factors_held++;
    peri__factor_leave(w, b);
    f->users = 1;
    b->factor = f;
    return PERI_OK;
}

/* Factorises; where that is impossible AUTO falls back on Chebyshev. */
static peri_result peri__matrix_factor(peri_world *w, peri__body *b) {
    peri_matrix a = peri__matrix(b);
    uint64_t hash = peri__matrix_hash(b);
    peri_error err;
    peri_result bad = PERI_OK;
    if (peri__factor_join(w, b, hash)) return PERI_OK;
    bad = peri__factor_own(w, b, &a, &err);
    if (!bad)
        bad = b->factor->l ? peri_cholesky_factor(b->factor->l, &a, &err)
                           : peri_two_level_factor(b->factor->levels, &a, &err);
    if (!bad) {
        b->factor->hash = hash;
        w->stats.factors++;
        return PERI_OK;
    }
    if (b->factor && b->factor->users == 1) b->factor->hash = 0;
    if (w->def.solver == PERI_SOLVER_AUTO && (bad == PERI_ERROR_MEMORY || bad == PERI_ERROR_LIMIT)) {
        b->solver = PERI_SOLVER_CHEBYSHEV;
        b->why = PERI__WHY_ROOM;
        if (w->def.log) w->def.log("no room for a factor: Chebyshev is used instead", w->def.user);
        return PERI_OK;
    }
    w->error = err;
    return bad;
}

/* Counts, not clocks: the same choice on every run. */
static peri_solver peri__solver_cheapest(peri_world *w, peri__body *b) {
    peri_allocator memory = peri__spare(w);
    peri_matrix a = peri__matrix(b);
    double evaluation = peri__evaluation_cost(b);
    b->why = PERI__WHY_SMALL;
    b->cost[0] = b->cost[1] = 0;
    if (b->count <= PERI__SMALL) return PERI_SOLVER_CHOLESKY;
    b->why = PERI__WHY_ROOM;
    if (peri_cholesky_estimate(&a, b->points, &memory, &b->fill, &b->cost[0], NULL)) return PERI_SOLVER_TWO_LEVEL;
    b->why = PERI__WHY_COST;
    b->cost[0] = PERI__ITERATIONS * (evaluation + PERI__COST_ENTRY * (double)b->fill) +
                 PERI__COST_OPERATION * b->cost[0] / PERI__STEPS;
    b->cost[1] = PERI__LEVELS_MORE * PERI__ITERATIONS * (evaluation + PERI__COST_LEVELS * b->count);
    return b->cost[0] <= b->cost[1] ? PERI_SOLVER_CHOLESKY : PERI_SOLVER_TWO_LEVEL;
}
#endif

static void peri__solver_choose(peri_world *w, peri__body *b) {
    if (b->solver != PERI_SOLVER_AUTO) return;
    b->solver = w->def.solver;
    b->why = PERI__WHY_ASKED;
#ifndef PERI_NO_CHOLESKY
    if (b->solver == PERI_SOLVER_AUTO) b->solver = peri__solver_cheapest(w, b);
#else
    if (b->solver == PERI_SOLVER_AUTO || b->solver == PERI_SOLVER_CHOLESKY || b->solver == PERI_SOLVER_TWO_LEVEL) {
        b->solver = PERI_SOLVER_CHEBYSHEV;
        b->why = PERI__WHY_LEFT_OUT;
    }
#endif
}

/* What making a matrix costs, and an iteration, in the same units. */
static double peri__factor_cost(const peri__body *b) {
#ifndef PERI_NO_CHOLESKY
    if (b->factor && b->factor->l) return PERI__COST_OPERATION * peri_cholesky_operations(b->factor->l);
    if (b->factor)
        return PERI__COST_OPERATION * peri_two_level_operations(b->factor->levels) + 15.0 * b->row[b->count];
#endif
    return 5.0 * b->row[b->count];
}

static double peri__iteration_cost(const peri__body *b) {
#ifndef PERI_NO_CHOLESKY
    if (b->factor && b->factor->l)
        return peri__evaluation_cost(b) + PERI__COST_ENTRY * (double)peri_cholesky_entries(b->factor->l);
#endif
    return peri__evaluation_cost(b);
}

/* Makes the matrix for the present step, with the pins that peri__island_pin left. */
static peri_result peri__matrix_make(peri_world *w, peri__body *b) {
    double start = peri__clock(w);
    peri_result bad = PERI_OK;
    int i;
    for (i = 0; i < b->count; i++) b->pinned[i] = w->p[peri__pin_at(b, i)];
    peri__matrix_values(w, b);
#ifndef PERI_NO_CHOLESKY
    if (b->solver == PERI_SOLVER_CHOLESKY || b->solver == PERI_SOLVER_TWO_LEVEL) bad = peri__matrix_factor(w, b);
#endif
    if (bad) b->matrix_h = 0;
    w->stats.profile.factor += 1e3 * (peri__clock(w) - start);
    return bad;
}

/* Before a step: a matrix is made anew when the step has changed much, or when contacts that it does not know have
   cost as much as that takes. */
static peri_result peri__matrices_prepare(peri_world *w, const peri__island *island) {
    peri__body *b;
    peri_result bad = PERI_OK;
    peri__island_pin(w, island, 1);
    for (b = peri__body_at(w, island->first); b && !bad; b = peri__body_at(w, b->next)) {
        int near = b->matrix_h > 0 && b->h < 1.25 * b->matrix_h && b->h > 0.8 * b->matrix_h;
        peri__solver_choose(w, b);
        b->stale = peri__matrix_stale(w, b);
        if (!near || (b->stale && !(b->wasted < peri__factor_cost(b)))) bad = peri__matrix_make(w, b);
    }
    return bad;
}

/* p = P^-1 g of one body: the global step. */
static void peri__global_body(peri_world *w, const peri__body *b, const peri_real *g, peri_real *p) {
    peri_matrix a = peri__matrix(b);
    size_t k, n = 3 * (size_t)b->count;
    peri_real *work = w->work + 6 * (size_t)b->at;
    double low, scale = (double)w->def.matrix_scale;
    switch (b->solver) {
    case PERI_SOLVER_JACOBI: peri_jacobi3(&a, &w->def.parallel, g, p); break;
    case PERI_SOLVER_POSITION:
        /* every bond offers both its ends half of the way: twice the stiffness in the average's denominator */
        for (k = 0; k < n; k++) p[k] = g[k] / (b->diagonal[k / 3] + (peri_real)scale * b->stiffness[k / 3]);
        break;
    case PERI_SOLVER_CHEBYSHEV:
        /* degree s resolves a condition number of about s^2: asking for more wastes it on the few smoothest modes */
        low = 2.0 / (w->def.sweeps * w->def.sweeps);
        if (low < b->chebyshev_low) low = b->chebyshev_low;
        if (low > 1.8) low = 1.8;
        peri_chebyshev3(&a, &w->def.parallel, w->def.sweeps, low, 2, g, p, work);
        break;
    case PERI_SOLVER_AUTO:
    case PERI_SOLVER_CHOLESKY:
    case PERI_SOLVER_TWO_LEVEL:
#ifndef PERI_NO_CHOLESKY
        if (b->factor->levels) {
            peri_two_level_apply(g, p, b->factor->levels);
        } else {
            memcpy(p, g, n * sizeof *p);
            peri_cholesky_solve(b->factor->l, 3, p, work);
        }
#endif
        break;
    }
}

/* ---- implementation 14: the solve --------------------------------------------------------------------------------
   Minimises (1/2h^2) |x - x*|_M^2 + E(x) + contacts + attachments of an island, the bodies that touch or are attached
   to each other: quasi-Newton on the constant matrices of its bodies (SH section 5.2; for the projective model this is
   PP's local/global iteration), L-BFGS over them, a line search on the slope and, down to its rounding, the energy. */

typedef struct peri__solve {
    peri_world *w;
    peri__island island;
    peri_lbfgs lbfgs;
    peri_real *g, *g1, *p, *change;     /* 3 n/3 each, bodies of the island one behind the other */
    double *base;
    int n;                      /* 3 particles */
    int energetic;              /* the search looks at the energy too: where contacts, attachments or inversion make
                                   it rough. Not with a projective body: its force is not quite its energy's slope */
    int evaluations;
    int refreshed;              /* how often the contacts followed */
    double energy, energy1;     /* at x, at the trial */
    double floors;              /* the last correction in PERI__FLOOR; huge where not all bodies are pressed */
} peri__solve;

static peri__body *peri__first(const peri__solve *s) { return peri__body_at(s->w, s->island.first); }
static peri__body *peri__next(const peri__solve *s, const peri__body *b) { return peri__body_at(s->w, b->next); }

/* Do bodies of the island touch something, or hang on something? */
static int peri__touches(const peri__solve *s) {
    return s->island.contacts_end > s->island.contacts || s->island.attachment >= 0;
}

/* x of the island's bodies into the island's order; back; and back with a share of p added. */
static void peri__positions_get(const peri__solve *s, double *to) {
    const peri__body *b;
    for (b = peri__first(s); b; b = peri__next(s, b))
        memcpy(to + 3 * (size_t)(b->at - s->island.at), s->w->x + 3 * (size_t)b->first,
               3 * (size_t)b->count * sizeof *to);
}

static void peri__positions_put(const peri__solve *s, const double *from) {
    const peri__body *b;
    for (b = peri__first(s); b; b = peri__next(s, b))
        memcpy(s->w->x + 3 * (size_t)b->first, from + 3 * (size_t)(b->at - s->island.at),
               3 * (size_t)b->count * sizeof *from);
}

static void peri__positions_set(const peri__solve *s, const double *from, double alpha) {
    const peri__body *b;
    for (b = peri__first(s); b; b = peri__next(s, b)) {
        size_t at = 3 * (size_t)(b->at - s->island.at), k;
        double *x = s->w->x + 3 * (size_t)b->first;
        for (k = 0; k < 3 * (size_t)b->count; k++) x[k] = from[at + k] + alpha * (double)s->p[at + k];
    }
}

/* The rigid motions of a body, in the metric D = mass/h^2 + pins that stands for the stiffness against them: the bonds
   have none. With the centre of D, moves and turns do not mix. */
typedef struct peri__coarse {
    double weight, centre[3], inverse[9];
} peri__coarse;

static double peri__coarse_weight(const peri_world *w, const peri__body *b, int i) {
    return (double)w->mass[b->first + i] / (b->h * b->h) + (double)b->pinned[i];
}

static void peri__coarse_make(const peri_world *w, const peri__body *b, peri__coarse *r) {
    const double *x = w->x + 3 * (size_t)b->first;
    double a[9], d, det, scale = 0;
    int i, c;
    memset(r, 0, sizeof *r);
    memset(a, 0, sizeof a);
    for (i = 0; i < b->count; i++) {
        d = peri__coarse_weight(w, b, i);
        r->weight += d;
        for (c = 0; c < 3; c++) r->centre[c] += d * x[3 * i + c];
    }
    for (c = 0; c < 3; c++) r->centre[c] /= r->weight;
    for (i = 0; i < b->count; i++) {
        double arm[3], square;
        d = peri__coarse_weight(w, b, i);
        for (c = 0; c < 3; c++) arm[c] = x[3 * i + c] - r->centre[c];
        square = peri__dot3(arm, arm);
        for (c = 0; c < 9; c++) a[c] += d * ((c % 4 == 0 ? square : 0) - arm[c / 3] * arm[c % 3]);
    }
    for (c = 0; c < 9; c += 4) scale += a[c] / 3;
    det = peri_det3(a);
    if (!(det > 1e-9 * scale * scale * scale)) return;     /* a point or a line: moves only */
    peri_adjugate3(a, r->inverse);
    for (c = 0; c < 9; c++) r->inverse[c] /= det;
}

/* The rigid motion that v does work on, v being forces, or (weighted) motions, which D makes forces of. */
static void peri__coarse_project(const peri_world *w, const peri__body *b, const peri__coarse *r, const peri_real *v,
                                 int weighted, double move[3], double turn[3]) {
    const double *x = w->x + 3 * (size_t)b->first;
    double moment[3] = {0, 0, 0};
    int i, c;
    move[0] = move[1] = move[2] = 0;
    for (i = 0; i < b->count; i++) {
        double d = weighted ? peri__coarse_weight(w, b, i) : 1, arm[3], force[3], part[3];
        for (c = 0; c < 3; c++) {
            arm[c] = x[3 * i + c] - r->centre[c];
            force[c] = d * (double)v[3 * i + c];
            move[c] += force[c];
        }
        peri__cross(arm, force, part);
        for (c = 0; c < 3; c++) moment[c] += part[c];
    }
    for (c = 0; c < 3; c++) move[c] /= r->weight;
    peri__apply(r->inverse, moment, turn);
}

/* out = v + factor * the rigid motion, times D where weighted. */
static void peri__coarse_add(const peri_world *w, const peri__body *b, const peri__coarse *r, const double move[3],
                             const double turn[3], int weighted, double factor, const peri_real *v, peri_real *out) {
    const double *x = w->x + 3 * (size_t)b->first;
    int i, c;
    for (i = 0; i < b->count; i++) {
        double d = weighted ? factor * peri__coarse_weight(w, b, i) : factor, arm[3], way[3];
        for (c = 0; c < 3; c++) arm[c] = x[3 * i + c] - r->centre[c];
        peri__cross(turn, arm, way);
        for (c = 0; c < 3; c++) out[3 * i + c] = (peri_real)((double)v[3 * i + c] + d * (move[c] + way[c]));
    }
}

/* The global step of a body that hangs, on two levels. The matrix, which sees every coordinate by itself, takes a turn
   for a shear, and would answer a torque on a stiff body with hundreds of small steps, each below the tolerance. So the
   rigid motion is solved for by itself, and the matrix has the rest: Z A^-1 Z' + (1 - D Z A^-1 Z')' P^-1 (1 - D Z A^-1
   Z'), symmetric and positive (Z: rigid motions, A = Z' D Z). */
static void peri__global_free(peri_world *w, const peri__body *b, const peri_real *g, peri_real *rest, peri_real *p) {
    peri__coarse r;
    double move[3], turn[3], back[3], turn_back[3];
    int c;
    peri__coarse_make(w, b, &r);
    peri__coarse_project(w, b, &r, g, 0, move, turn);
    peri__coarse_add(w, b, &r, move, turn, 1, -1, g, rest);
    peri__global_body(w, b, rest, p);
    peri__coarse_project(w, b, &r, p, 1, back, turn_back);
    for (c = 0; c < 3; c++) {
        move[c] -= back[c];
        turn[c] -= turn_back[c];
    }
    peri__coarse_add(w, b, &r, move, turn, 0, 1, p, p);
}

/* p = P^-1 g, body by body (peri_precondition). */
static void peri__global_step(const peri_real *g, peri_real *p, void *context) {
    const peri__solve *s = (const peri__solve *)context;
    double start = peri__clock(s->w);
    const peri__body *b;
    for (b = peri__first(s); b; b = peri__next(s, b)) {
        size_t at = 3 * (size_t)(b->at - s->island.at);
        if (b->fixed || s->island.attachment < 0) peri__global_body(s->w, b, g + at, p + at);
        else peri__global_free(s->w, b, g + at, s->g1 + at, p + at);
    }
    s->w->stats.profile.global += 1e3 * (peri__clock(s->w) - start);
}

/* Gradient of one body without its contacts, and its energy with inertia. */
static double peri__evaluate_body(peri__solve *s, peri__body *b, peri_real *out, int energy) {
    peri__pass pass;
    double sum, inertia = 0;
    int k;
    peri__pass_begin(&pass, s->w, b, out);
    pass.star = s->w->star + 3 * (size_t)b->first;
    pass.inv_h2 = 1 / (b->h * b->h);
    pass.energy = energy;
    sum = peri__pass_run(&pass);
    for (k = 0; k < 3 * b->count && energy; k++) {
        double away = pass.x[k] - pass.star[k];
        inertia += (double)s->w->mass[b->first + k / 3] * away * away;
    }
    return sum + inertia * pass.inv_h2 / 2;
}

/* Gradient at x into out, energy into *energy (NULL: not needed), gradient times `along` into *slope; returns 0 when
   they are not finite (a number that is not makes the slope so, whatever it is multiplied with). */
static int peri__evaluate_along(peri__solve *s, peri_real *out, double *energy, const peri_real *along,
                                double *slope) {
    peri_world *w = s->w;
    double start = peri__clock(w), sum = 0;
    peri__body *b;
    int k;
    for (b = peri__first(s); b; b = peri__next(s, b))
        sum += peri__evaluate_body(s, b, out + 3 * (size_t)(b->at - s->island.at), energy != NULL);
    for (k = s->island.contacts; k < s->island.contacts_end; k++) {
        peri__contact *t = &w->contacts[w->contact_order[k]];
        peri__contact_force(w, t);
        peri__contact_scatter(w, t, s->island.at, -1, out);
        sum += t->energy;
    }
    for (k = s->island.attachment; k >= 0; k = peri__attachment_at(w, k)->next) {
        peri__attachment *t = peri__attachment_at(w, k);
        peri__attachment_force_now(w, t);
        peri__attachment_scatter(w, t, s->island.at, out);
        sum += t->energy;
    }
    if (energy) *energy = sum;
    s->evaluations++;
    w->stats.profile.local += 1e3 * (peri__clock(w) - start);
    *slope = peri_dot(&w->def.parallel, s->n, out, along);
    return peri__finite(sum) && peri__finite(*slope);
}

static int peri__evaluate(peri__solve *s, peri_real *out, double *energy) {
    double square;
    return peri__evaluate_along(s, out, energy, out, &square);
}

/* Lets the contacts follow what was reached; gradient and energy with them. Each pushes as the others let it: from the
   twentieth time on the pressures that limit friction follow more and more slowly, or they would chase each other. */
static void peri__refresh_contacts(peri__solve *s) {
    double relax = s->refreshed < 20 ? 1 : 20.0 / s->refreshed;
    int k;
    s->refreshed++;
    for (k = s->island.contacts; k < s->island.contacts_end; k++) {
        peri__contact *t = &s->w->contacts[s->w->contact_order[k]];
        if (!t->touching && t->depth < -0.5 * t->distance && t->target < PERI__TARGET_BODY) continue;
        s->energy -= t->energy;
        peri__contact_scatter(s->w, t, s->island.at, 1, s->g);
        peri__contact_refresh(s->w, t, relax);
        peri__contact_scatter(s->w, t, s->island.at, -1, s->g);
        s->energy += t->energy;
    }
}

/* What was evaluated on trial becomes the present gradient and energy. */
static void peri__take_trial(peri__solve *s) {
    peri_real *swap = s->g;
    s->g = s->g1;
    s->g1 = swap;
    s->energy = s->energy1;
}

static double peri__largest(const peri_real *p, int n) {
    double largest[4] = {0, 0, 0, 0};      /* four at a time: each waits for the one before it only */
    int k, l;
    for (k = 0; k < n; k += 12)
        for (l = 0; l < 4 && k + 3 * l < n; l++) {
            const peri_real *v = p + k + 3 * l;
            double square = (double)v[0] * (double)v[0] + (double)v[1] * (double)v[1] + (double)v[2] * (double)v[2];
            largest[l] = square > largest[l] ? square : largest[l];
        }
    for (l = 1; l < 4; l++)
        if (largest[l] > largest[0]) largest[0] = largest[l];
    return sqrt(largest[0]);
}

#define PERI__FLOOR (sizeof(peri_real) > 4 ? 1e-15 : 2e-7)      /* of a bond: what pressed matter can tell */

/* Largest correction of any body, in its tolerance; *length: in m. */
static double peri__corrections(peri__solve *s, double *length) {
    const peri__body *b;
    double worst = 0;
    *length = s->floors = 0;
    for (b = peri__first(s); b; b = peri__next(s, b)) {
        double largest = peri__largest(s->p + 3 * (size_t)(b->at - s->island.at), 3 * b->count);
        if (largest > *length) *length = largest;
        if (largest > worst * b->tolerance) worst = largest / b->tolerance;
        if (!b->braced) s->floors = HUGE_VAL;
        else if (largest > s->floors * PERI__FLOOR * b->spacing) s->floors = largest / (PERI__FLOOR * b->spacing);
    }
    return worst;
}

#define PERI__NOISE (sizeof(peri_real) > 4 ? 1e-12 : 1e-6)      /* of an energy, relative */

/* The slope and the energy at a share of p, and the gradient there in g1 (peri_trial). */
static int peri__search_trial(double share, double *slope, double *energy, void *context) {
    peri__solve *s = (peri__solve *)context;
    peri__positions_set(s, s->base, share);
    if (!peri__evaluate_along(s, s->g1, energy ? &s->energy1 : NULL, s->p, slope)) return 0;
    if (energy) *energy = s->energy1;
    return 1;
}

/* Goes along p, g times p being `slope`, from where x is, as far as slope and energy allow; leaves the gradient there
   in g1. Returns the share of p that was gone, 0 when no share would do. */
static double peri__search(peri__solve *s, double slope) {
    peri_search o = peri_default_search();
    peri_line line;
    double share;
    o.energetic = s->energetic;
    o.noise = PERI__NOISE * fabs(s->energy);
    line.trial = peri__search_trial;
    line.context = s;
    line.slope = slope;
    line.energy = s->energy;
    peri__positions_get(s, s->base);
    if (peri_line_search(&line, &share, &o, NULL, NULL)) peri__positions_put(s, s->base);
    return share;
}

/* One quasi-Newton step from the gradient in g: direction, search, memory. *length: the correction, m; *worst: in
   tolerances. Returns 0 when it is below the tolerance or nothing better was found. */
static int peri__iterate(peri__solve *s, double *length, double *worst) {
    const peri_parallel *par = &s->w->def.parallel;
    double alpha, slope;
    peri_lbfgs_apply(&s->lbfgs, par, s->g, s->p, s->change, peri__global_step, s);
    slope = peri_dot(par, s->n, s->g, s->p);
    if (!(slope < 0)) {
        peri_lbfgs_begin(&s->lbfgs, s->n, s->lbfgs.m, s->lbfgs.s);
        peri_lbfgs_apply(&s->lbfgs, par, s->g, s->p, s->change, peri__global_step, s);
        slope = peri_dot(par, s->n, s->g, s->p);
    }
    *worst = peri__corrections(s, length);
    if (*worst <= 1) {      /* the last correction is made, not checked: a body at rest must not creep by it */
        peri__positions_get(s, s->base);
        peri__positions_set(s, s->base, 1);
        return 0;
    }
    alpha = peri__search(s, slope);
    if (!(alpha > 0)) {
        if (!s->lbfgs.used) return 0;
        peri_lbfgs_begin(&s->lbfgs, s->n, s->lbfgs.m, s->lbfgs.s);
        return 1;
    }
    peri__lbfgs_take(&s->lbfgs, par, alpha, s->p, s->g, s->g1);
    peri__take_trial(s);
    peri__refresh_contacts(s);
    return 1;
}

static void peri__solve_begin(peri__solve *s, peri_world *w, const peri__island *island) {
    size_t at = 3 * (size_t)island->at;
    const peri__body *b;
    int projective = 0, wild;
    memset(s, 0, sizeof *s);
    s->w = w;
    s->island = *island;
    s->n = 3 * island->count;
    wild = peri__touches(s);
    for (b = peri__first(s); b; b = peri__next(s, b)) {
        projective |= b->matter.m.model == PERI_MODEL_PROJECTIVE;
        wild |= b->unhealthy > 0;
    }
    s->energetic = wild && !projective;
    s->base = w->base + at;
    s->g = w->g + at;
    s->g1 = w->g1 + at;
    s->p = w->p + at;
    s->change = w->change + at;
    peri_lbfgs_begin(&s->lbfgs, s->n, w->def.lbfgs, w->history ? w->history + 2 * (size_t)w->def.lbfgs * at : NULL);
}

/* Within a solve that takes longer than usual: counts what contacts unknown to a matrix cost, and makes it anew when
   that has become as much as making it (which bounds the loss at a factor of two). */
static peri_result peri__matrices_renew(peri__solve *s, int iterations, int evaluations) {
    peri__body *b;
    peri_result bad = PERI_OK;
    int late = 0;
    for (b = peri__first(s); b; b = peri__next(s, b)) late |= iterations > b->usual + 3;
    if (!late) return PERI_OK;
    peri__island_pin(s->w, &s->island, 0);
    for (b = peri__first(s); b && !bad; b = peri__next(s, b)) {
        b->stale = peri__matrix_stale(s->w, b);
        if (!b->stale) continue;
        b->wasted += evaluations * peri__iteration_cost(b);
        if (!(b->wasted < peri__factor_cost(b))) bad = peri__matrix_make(s->w, b);
    }
    return bad;
}

/* Puts the free particles where they were before the step; leaves the gradient and energy there in g1 and energy1.
   Returns 0 when these are not finite. */
static int peri__restart(peri__solve *s) {
    const peri__body *b;
    size_t k;
    peri__positions_get(s, s->base);
    for (b = peri__first(s); b; b = peri__next(s, b))
        for (k = 3 * (size_t)b->first; k < 3 * (size_t)(b->first + b->count); k++)
            if (!(s->w->flags[k / 3] & PERI__FIXED)) s->w->x[k] = s->w->x0[k];
    return peri__evaluate(s, s->g1, &s->energy1);
}

/* Is the guess, whose gradient is in g, a step that a line search would take from x0? Then the slope along the way to
   it has fallen below 0.9 of what it was there; the forces there are what changed the velocity in the last step. */
static int peri__guess_fits(const peri__solve *s) {
    const peri_world *w = s->w;
    const peri__body *b;
    double slope = 0, before = 0, gravity[3];
    peri__vec(w->def.gravity, gravity);
    for (b = peri__first(s); b; b = peri__next(s, b)) {
        const peri_real *g = s->g + 3 * (size_t)(b->at - s->island.at);
        size_t k, at = 3 * (size_t)b->first;
        if (b->steps < 1 || !(b->step_before > 0) || w->def.integrator != PERI_BACKWARD_EULER) return 0;
        for (k = 0; k < 3 * (size_t)b->count; k++) {
            double way = w->x[at + k] - w->x0[at + k], m = (double)w->mass[(at + k) / 3];
            double push = (((double)w->v[at + k] - (double)w->v0[at + k]) / b->step_before - gravity[k % 3]) * m;
            if (w->wants & PERI__WANT_FORCE) push -= (double)w->force[at + k];
            if (w->flags[(at + k) / 3] & PERI__FIXED) continue;
            slope += (double)g[k] * way;
            before += (m / (b->h * b->h) * (w->x0[at + k] - w->star[at + k]) - push) * way;
        }
    }
    return before < 0 && fabs(slope) <= 0.9 * -before;
}

/* The guess extrapolates the motion; where particles are held and the step is long, or where the body is out of shape,
   that may be absurd. Then the positions before the step are tried too, and the better start is kept. Returns 0 when
   neither is finite. */
static int peri__start(peri__solve *s) {
    const peri__body *b;
    int finite, far = 0, sick = 0, wild, doubtful;
    for (b = peri__first(s); b; b = peri__next(s, b)) {
        double reach = 0;
        size_t k;
        for (k = 3 * (size_t)b->first; k < 3 * (size_t)(b->first + b->count); k++)
            if (fabs(s->w->x[k] - s->w->x0[k]) > reach) reach = fabs(s->w->x[k] - s->w->x0[k]);
        far |= b->fixed && reach >= b->spacing;
        sick |= b->unhealthy > 0;
    }
    wild = sick || s->energetic || peri__touches(s);
    finite = peri__evaluate(s, s->g, far || wild ? &s->energy : NULL);
    doubtful = !finite || far || sick;
    if (!doubtful || (!wild && finite && peri__guess_fits(s))) return 1;
    if (peri__restart(s) && (!finite || s->energy1 < s->energy)) {
        peri__take_trial(s);
        return 1;
    }
    peri__positions_put(s, s->base);
    if (!peri__touches(s)) return finite;   /* g is still that of the guess; contacts and joints are not */
    return finite && peri__evaluate(s, s->g, &s->energy);
}

/* Share of the error that a preconditioner's correction shows at least: the smoothest modes, whose eigenvalue is `low`,
   come out of Jacobi and of too few Chebyshev sweeps that much too small. */
static double peri__trust(const peri_world *w, const peri__body *b) {
    double low = b->chebyshev_low, seen = 2.0 / (w->def.sweeps * w->def.sweeps);
    if (b->solver == PERI_SOLVER_JACOBI || b->solver == PERI_SOLVER_POSITION) return low;
    return b->solver == PERI_SOLVER_CHEBYSHEV && low < seen ? low / seen : 1;
}

/* How small a correction ends the iterations, m. In short steps what forces move in one step, x - x*, is far less than
   a spacing: then that is the measure (times ten, so that game steps keep the spacing), or the step would end with its
   guess. */
static double peri__tolerance(const peri_world *w, const peri__body *b) {
    double away = 0, scale = b->spacing;
    size_t k;
    for (k = 3 * (size_t)b->first; k < 3 * (size_t)(b->first + b->count); k++)
        if (fabs(w->x[k] - w->star[k]) > away) away = fabs(w->x[k] - w->star[k]);
    if (10 * away < scale) scale = 10 * away > 1e-3 * scale ? 10 * away : 1e-3 * scale;
    /* a push that is right to 10 % only lets single particles slip for good: measured, blocks creep down slopes */
    if (b->near_contact) scale /= 4;
    /* what is about to sleep must not be kept awake by what the solver leaves, nor sleep with it */
    if (b->calm) scale /= 30;
    scale *= (double)w->def.tolerance * peri__trust(w, b);
    return b->braced && scale < PERI__FLOOR * b->spacing ? PERI__FLOOR * b->spacing : scale;
}

/* Iterates to the tolerance. *worst: the last correction, in tolerances. */
static peri_result peri__descend(peri__solve *s, int *iterations, double *length, double *worst) {
    peri_result bad = PERI_OK;
    double least = 0;
    int going = 1, idle = 0, before;
    while (going && !bad && *iterations < s->w->def.max_iterations) {
        before = s->evaluations;
        going = peri__iterate(s, length, worst);
        /* corrections near the rounding of forces that shrink no more are rounding */
        idle = going && least > 0 && *length > 0.9 * least && s->floors < 50 ? idle + 1 : 0;
        if (!(least > 0) || *length < least) least = *length;
        if (idle == 6) going = 0, *worst = 1;
        /* no way down from the guess: it was absurd, start from where the bodies were */
        if (!going && !*iterations && *worst > 1 && peri__restart(s)) {
            peri__take_trial(s);
            going = 1;
        }
        *iterations += going;
        if (going) bad = peri__matrices_renew(s, *iterations, s->evaluations - before);
    }
    return bad;
}

/* Puts the contacts of bodies that stay where they were before the step back to what they were there. */
static void peri__contacts_stop(peri__solve *s) {
    double away[3];
    int k;
    for (k = s->island.contacts; k < s->island.contacts_end; k++) {
        peri__contact *t = &s->w->contacts[s->w->contact_order[k]];
        const peri__hold *hold = peri__hold_find(s->w, t->body, t->target, t->particle);
        t->loose = !hold;
        if (hold && t->target >= PERI__TARGET_BODY) {
            peri__foot(s->w, t, 1, away);
            memcpy(t->normal, hold->normal, sizeof t->normal);
        }
        peri__contact_force(s->w, t);
    }
}

/* Sums over the island's free particles: m v.(x - x0)/h, which turns the energy that a step goes down into that of its
   motion and deformation, m v^2 / 2 before the step, and m (x* - x0)^2 / 2 h^2. */
static void peri__motion(const peri__solve *s, double *gone, double *kinetic, double *aimed) {
    const peri_world *w = s->w;
    const peri__body *b;
    size_t k;
    *gone = *kinetic = *aimed = 0;
    for (b = peri__first(s); b; b = peri__next(s, b))
        for (k = 3 * (size_t)b->first; k < 3 * (size_t)(b->first + b->count); k++) {
            double m = (double)w->mass[k / 3], v = (double)w->v[k], aim = (w->star[k] - w->x0[k]) / b->h;
            if (w->flags[k / 3] & PERI__FIXED) continue;
            *gone += m * v * (w->x[k] - w->x0[k]) / b->h;
            *kinetic += m * v * v / 2;
            *aimed += m * aim * aim / 2;
        }
}

/* A guess may be absurd, and contacts turn while a solve goes on: so one that met the cap may end with (by more than a
   tenth) more energy than the bodies had. Then it is begun anew from where they were; and ended there, at a stop, where
   that does not help. */
static peri_result peri__bound(peri__solve *s, int *iterations, double *length, double *worst) {
    peri_result bad = PERI_OK;
    int tries, k;
    for (tries = 0; tries < 2 && !bad && *worst > 1; tries++) {
        double ended = 0, begun, gone, kinetic, aimed;
        int finite = peri__evaluate(s, s->g, &ended);
        peri__motion(s, &gone, &kinetic, &aimed);
        if (!peri__restart(s)) break;
        peri__take_trial(s);
        for (begun = s->energy, k = s->island.contacts; k < s->island.contacts_end; k++) {
            const peri__contact *t = &s->w->contacts[s->w->contact_order[k]];
            begun += t->stored - t->energy;     /* as it was, not as its present foot makes it */
        }
        if (finite && ended + gone - begun - kinetic <= 0.1 * (begun - aimed + kinetic)) {
            peri__positions_put(s, s->base);
            peri__evaluate(s, s->g, &s->energy);
            break;
        }
        if (tries == 1) {
            peri__contacts_stop(s);
            break;
        }
        peri_lbfgs_begin(&s->lbfgs, s->n, s->lbfgs.m, s->lbfgs.s);
        *iterations = 0;
        bad = peri__descend(s, iterations, length, worst);
    }
    return bad;
}

/* Contacts that sank deeper than three tenths of their distance become four times as stiff. Returns their number. */
static int peri__stiffen(peri__solve *s) {
    int k, found = 0;
    for (k = s->island.contacts; k < s->island.contacts_end; k++) {
        peri__contact *t = &s->w->contacts[s->w->contact_order[k]];
        peri__contact_force(s->w, t);
        if (!(t->depth > 0.3 * t->distance) || t->grade > 1e4) continue;
        t->grade *= 4;
        t->stiffness *= 4;
        found++;
    }
    return found;
}

/* Did the last correction, which is made without a look at what it does, throw particles away? */
static int peri__far(const peri__solve *s) {
    const peri__body *b;
    for (b = peri__first(s); b; b = peri__next(s, b)) {
        double size = b->spacing * (10 + (double)b->count), reach = 0;
        size_t k;
        for (k = 3 * (size_t)b->first; k < 3 * (size_t)(b->first + b->count); k++) {
            double off = fabs(s->w->x[k] - s->w->star[k]), way = fabs(s->w->x[k] - s->w->x0[k]);
            if (way < off) off = way;       /* held particles leave x* in long steps, free ones x0 */
            if (!(off <= reach)) reach = off;
        }
        if (!(reach < 1e3 * size)) return 1;
    }
    return 0;
}

/* Solves an island; x holds the first guess and then the answer. */
static peri_result peri__solve_island(peri_world *w, const peri__island *island) {
    peri__solve s;
    peri__body *b;
    double length = 0, worst = 0, residual;
    int iterations = 0, rounds;
    peri_result bad = PERI_OK;
    peri__solve_begin(&s, w, island);
    if (!peri__start(&s))
        return peri__fail(&w->error, PERI_ERROR_NUMERIC,
                          "the forces of body %d are not finite: check its forces, its law and the time step",
                          s.island.first);
    for (b = peri__first(&s); b; b = peri__next(&s, b)) b->tolerance = peri__tolerance(w, b);
    peri__refresh_contacts(&s);
    for (rounds = 0; !bad; rounds++) {
        bad = peri__descend(&s, &iterations, &length, &worst);
        if (bad || rounds == 4 || iterations >= w->def.max_iterations || !peri__stiffen(&s)) break;
        peri_lbfgs_begin(&s.lbfgs, s.n, s.lbfgs.m, s.lbfgs.s);
        peri__evaluate(&s, s.g, &s.energy);
        peri__refresh_contacts(&s);
    }
    if (!bad) bad = peri__bound(&s, &iterations, &length, &worst);
    if (bad) return bad;
    for (b = peri__first(&s); b; b = peri__next(&s, b)) {
        if (!b->stale) b->usual = iterations;
        b->unsolved = worst > 1 && island->contacts_end > island->contacts;
    }
    if (peri__far(&s))
        return peri__fail(&w->error, PERI_ERROR_CONVERGENCE,
                          "body %d or what it touches went a thousand times its size in one step: take a smaller step",
                          s.island.first);
    residual = sqrt(peri_dot(&w->def.parallel, s.n, s.g, s.g) / island->count);
    if (iterations > w->stats.iterations) w->stats.iterations = iterations;
    if (s.evaluations > w->stats.evaluations) w->stats.evaluations = s.evaluations;
    if (length > w->stats.correction) w->stats.correction = length;
    if (residual > w->stats.residual) w->stats.residual = residual;
    if (worst <= 1) return PERI_OK;
    w->stats.converged = 0;
    if (!w->def.cap_is_error) return PERI_OK;
    return peri__fail(&w->error, PERI_ERROR_CONVERGENCE,
                      "after %d iterations particles still move by %g m, %g times the tolerance: raise max_iterations "
                      "or tolerance, or take a smaller step", iterations, length, worst);
}

/* ---- implementation 15: islands and sleep ------------------------------------------------------------------------
   Bodies that touch, or may touch in this step, or are attached to each other, are solved together: an island. Solve
   arrays are in the order of islands (b->at), so that one is a vector. Bodies that have been slow for long fall asleep
   with all that they touch; a sleeping body is a wall for what comes near, and wakes when it is touched. */

static int peri__root(const peri_world *w, int k) {
    peri__body *b = peri__body_at(w, k), *up;
    while (b->parent != k) {
        up = peri__body_at(w, b->parent);
        b->parent = up->parent;
        k = b->parent;
        b = peri__body_at(w, k);
    }
    return k;
}

static void peri__join(const peri_world *w, int a, int b) {
    a = peri__root(w, a);
    b = peri__root(w, b);
    if (a < b) peri__body_at(w, b)->parent = a;
    else peri__body_at(w, a)->parent = b;
}

/* Joins bodies by their contacts (touching: only those that do, or may: where the solve did not end) and attachments;
   sleeping ones stay apart. */
static void peri__join_all(peri_world *w, int touching) {
    int k;
    for (k = 0; k < w->bodies.capacity; k++) {
        peri__body *b = peri__body_at(w, k);
        if (b) b->parent = k;
    }
    for (k = 0; k < w->contact_count; k++) {
        const peri__contact *t = &w->contacts[k];
        const peri__body *b = peri__contact_other(w, t);
        if (b && !b->asleep && (t->touching || !touching || b->unsolved))
            peri__join(w, t->body, t->target - PERI__TARGET_BODY);
    }
    for (k = 0; k < w->attachments.capacity; k++) {
        const peri__attachment *t = peri__attachment_at(w, k);
        if (t && t->other >= 0 && !peri__body_at(w, t->body)->asleep) peri__join(w, t->body, t->other);
    }
}

/* Chains of joined bodies that are awake, in order of their first one, into islands. Returns their number. */
static int peri__chains_make(peri_world *w, int touching) {
    int k, n = 0;
    peri__join_all(w, touching);
    for (k = 0; k < w->bodies.capacity; k++) {
        peri__body *b = peri__body_at(w, k);
        peri__island *island;
        if (!b || b->asleep) continue;
        b->next = -1;
        b->island = b->parent == k ? n : peri__body_at(w, peri__root(w, k))->island;
        island = &w->islands[b->island];
        if (b->island == n) {
            memset(island, 0, sizeof *island);
            island->first = k;
            island->attachment = -1;
            n++;
        } else {
            peri__body_at(w, island->last)->next = k;
        }
        island->last = k;
        island->count += b->count;
    }
    return n;
}

/* Islands of the step: places of their bodies in the solve arrays, contacts by island in contact_order, attachments
   chained. */
static void peri__islands_make(peri_world *w) {
    int k, at = 0, n = peri__chains_make(w, 0);
    peri__body *b;
    w->stats.islands = n;
    for (k = 0; k < n; k++) {
        w->islands[k].at = at;
        for (b = peri__body_at(w, w->islands[k].first); b; b = peri__body_at(w, b->next)) {
            b->at = at;
            b->near_contact = 0;
            at += b->count;
        }
    }
    for (k = 0; k < w->contact_count; k++) {
        peri__body *other = peri__contact_other(w, &w->contacts[k]);
        b = peri__body_at(w, w->contacts[k].body);
        b->near_contact = 1;
        if (other) other->near_contact = 1;
        w->islands[b->island].contacts_end++;
    }
    for (k = 0, at = 0; k < n; k++) {
        int count = w->islands[k].contacts_end;
        w->islands[k].contacts = w->islands[k].contacts_end = at;
        at += count;
    }
    for (k = 0; k < w->contact_count; k++)
        w->contact_order[w->islands[peri__body_at(w, w->contacts[k].body)->island].contacts_end++] = k;
    for (k = w->attachments.capacity - 1; k >= 0; k--) {
        peri__attachment *t = peri__attachment_at(w, k);
        peri__island *island;
        if (!t || peri__body_at(w, t->body)->asleep) continue;
        island = &w->islands[peri__body_at(w, t->body)->island];
        t->next = island->attachment;
        island->attachment = k;
    }
}

/* Wakes a body and all that sleeps with it. */
static void peri__wake(peri_world *w, peri__body *b) {
    int k, group = b->asleep;
    b->still = 0;
    b->still_steps = 0;
    for (k = 0; group && k < w->bodies.capacity; k++) {
        peri__body *other = peri__body_at(w, k);
        if (!other || other->asleep != group) continue;
        other->asleep = 0;
        other->calm = 0;
        other->still = 0;
        other->still_steps = 0;
        w->asleep--;
        w->unsettled = 1;
    }
}

/* Sleeping bodies near colliders that move, or were put elsewhere, wake. */
static void peri__wake_by_colliders(peri_world *w) {
    int at, k, c;
    for (at = 0; at < w->colliders.capacity && w->asleep; at++) {
        peri__collider *solid = (peri__collider *)(void *)peri__slot_at(&w->colliders, at);
        if (!solid || !peri__collider_moves(solid)) continue;
        for (k = 0; k < w->bodies.capacity; k++) {
            peri__body *b = peri__body_at(w, k);
            double centre[3], size = 0, travel;
            if (!b || !b->asleep) continue;
            for (c = 0; c < 3; c++) {
                centre[c] = (b->lower[c] + b->upper[c]) / 2;
                size += (b->upper[c] - b->lower[c]) * (b->upper[c] - b->lower[c]) / 4;
            }
            travel = peri__collider_travel(solid, centre, sqrt(size)) + sqrt(size) + b->spacing;
            if (peri__collider_distance(solid, 1, centre, NULL) <= travel) peri__wake(w, b);
        }
    }
    for (k = 0; k < w->attachments.capacity && w->asleep; k++) {
        const peri__attachment *t = peri__attachment_at(w, k);
        const peri__collider *solid = t && t->collider >= 0 ? peri__collider_at(w, t->collider) : NULL;
        if (solid && peri__collider_moves(solid)) peri__wake(w, peri__body_at(w, t->body));
    }
}

/* Is every particle slower than `factor` times the speed that counts as rest? In long steps what counts is the way, as
   if they took 1/30 s. */
static int peri__body_slow(const peri_world *w, const peri__body *b, double factor, double dt) {
    double most = factor * (double)w->def.sleep_speed * b->spacing;
    size_t i, end = (size_t)b->first + (size_t)b->count;
    if (dt > 1 / 30.0) most /= 30 * dt;
    for (i = (size_t)b->first; i < end; i++) {
        const peri_real *v = w->v + 3 * i;
        if (!((double)(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]) < most * most)) return 0;
    }
    return 1;
}

/* After a step: who has been slow for long, with all that it touches, falls asleep. */
static void peri__sleep_check(peri_world *w, double dt) {
    int k, c;
    if (!(w->def.sleep_speed > 0)) return;
    for (k = 0; k < w->bodies.capacity; k++) {
        peri__body *b = peri__body_at(w, k);
        if (!b || b->asleep) continue;
        b->tired = 1;
        b->calm = !b->restless && peri__body_slow(w, b, 20, dt);
        if (!b->calm || !peri__body_slow(w, b, 1, dt)) {
            b->still = 0;
            b->still_steps = 0;
            continue;
        }
        b->still += dt;
        b->still_steps++;
    }
    for (k = 0; k < w->bodies.capacity; k++) {
        peri__body *b = peri__body_at(w, k);
        if (b && !b->asleep && (b->still_steps < 15 || b->still < (double)w->def.sleep_time))
            peri__body_at(w, peri__root(w, k))->tired = 0;
    }
    for (k = 0; k < w->bodies.capacity; k++) {
        peri__body *b = peri__body_at(w, k);
        size_t i;
        if (!b || b->asleep || !peri__body_at(w, peri__root(w, k))->tired) continue;
        b->asleep = peri__root(w, k) + 1;
        b->steps = 0;
        w->asleep++;
        w->unsettled = 1;
        for (i = (size_t)b->first; i < (size_t)(b->first + b->count); i++)
            for (c = 0; c < 3; c++) w->v[3 * i + (size_t)c] = w->v0[3 * i + (size_t)c] = 0;
        peri__body_sweep(w, b);
        b->grid_made = 0;
    }
}

/* ---- implementation 16: the step --------------------------------------------------------------------------------- */

/* Coefficients of the integrator for body b: x* = c1 x - c2 x_before + ..., effective step beta dt. */
typedef struct peri__scheme {
    double c1, c2, beta;
} peri__scheme;

static peri__scheme peri__scheme_of(const peri_world *w, const peri__body *b, double dt) {
    peri__scheme s = {1, 0, 1};
    if (w->def.integrator == PERI_BDF2 && b->steps > 0 && b->step_before > 0) {
        double r = dt / b->step_before;
        if (r > 4 || r < 0.25) return s;     /* variable-step BDF2 is stable below 1 + sqrt 2; beyond, start anew */
        if (r > 2.4) r = 2.4;
        s.c1 = (1 + r) * (1 + r) / (1 + 2 * r);
        s.c2 = r * r / (1 + 2 * r);
        s.beta = (1 + r) / (1 + 2 * r);
    }
    return s;
}

/* The first guess of a coordinate: x + h v + the last change of velocity times h; first, gravity's. */
static double peri__guess(const peri_world *w, const peri__body *b, size_t k, const double gravity[3], double dt) {
    double v = (double)w->v[k], a = gravity[k % 3];
    if (w->wants & PERI__WANT_FORCE) a += (double)w->force[k] / (double)w->mass[k / 3];
    return w->x0[k] + dt * (v + (b->steps > 0 ? v - (double)w->v0[k] : dt * a));
}

/* x* of the step, and the first guess, in x. */
static void peri__predict(peri_world *w, peri__body *b, double dt) {
    peri__scheme s = peri__scheme_of(w, b, dt);
    double h = s.beta * dt, gravity[3];
    size_t i, k, end = (size_t)b->first + (size_t)b->count;
    int c;
    peri__vec(w->def.gravity, gravity);
    for (i = (size_t)b->first; i < end; i++)
        for (c = 0; c < 3; c++) {
            double x, v, v0, a = gravity[c], before;
            k = 3 * i + (size_t)c;
            if (w->flags[i] & PERI__FIXED) {
                w->star[k] = w->x[k] = w->flags[i] & PERI__MOVED ? w->aim[k] : w->x0[k];
                continue;
            }
            x = w->x0[k];
            v = (double)w->v[k];
            v0 = (double)w->v0[k];
            before = s.c2 > 0 ? w->back[k] : 0;
            if (w->wants & PERI__WANT_FORCE) a += (double)w->force[k] / (double)w->mass[i];
            w->star[k] = s.c1 * x - s.c2 * before + h * (s.c1 * v - s.c2 * v0) + h * h * a;
            w->x[k] = peri__guess(w, b, k, gravity, dt);
        }
}

/* New velocities from the solved positions; history moves on. */
static void peri__body_commit(peri_world *w, peri__body *b, double dt) {
    peri__scheme s = peri__scheme_of(w, b, dt);
    size_t i, k, end = (size_t)b->first + (size_t)b->count;
    int c;
    for (i = (size_t)b->first; i < end; i++) {
        for (c = 0; c < 3; c++) {
            double v;
            k = 3 * i + (size_t)c;
            v = (w->x[k] - w->x0[k]) / dt;
            if (s.c2 > 0 && !(w->flags[i] & PERI__FIXED))
                v = (w->x[k] - s.c1 * w->x0[k] + s.c2 * w->back[k]) / (s.beta * dt);
            w->v0[k] = w->v[k];
            w->v[k] = (peri_real)v;
            w->out[k] = (peri_real)w->x[k];
        }
        w->flags[i] = (unsigned char)(w->flags[i] & ~PERI__MOVED);
    }
    b->steps++;
    b->step_before = dt;
}

/* The rigid part of a group of bodies (chained by `next`, first to begin with) at positions x with velocities v. */
typedef struct peri__rigid {
    double mass, centre[3], momentum[3], spin[3];   /* angular momentum about the centre */
    double inertia[9];                              /* about the centre */
} peri__rigid;

static void peri__rigid_add(const peri_world *w, const peri__body *b, const double *x, const peri_real *v,
                            peri__rigid *r) {
    size_t i, end = (size_t)b->first + (size_t)b->count;
    int c, d;
    for (i = (size_t)b->first; i < end; i++) {
        double m = (double)w->mass[i], arm[3], speed[3], turn[3], square = 0;
        for (c = 0; c < 3; c++) {
            arm[c] = x[3 * i + (size_t)c] - r->centre[c];
            speed[c] = (double)v[3 * i + (size_t)c];
            square += arm[c] * arm[c];
        }
        peri__cross(arm, speed, turn);
        for (c = 0; c < 3; c++) {
            r->momentum[c] += m * speed[c];
            r->spin[c] += m * turn[c];
            for (d = 0; d < 3; d++) r->inertia[3 * c + d] += m * ((c == d ? square : 0) - arm[c] * arm[d]);
        }
    }
}

static void peri__rigid_make(const peri_world *w, int first, const double *x, const peri_real *v, peri__rigid *r) {
    const peri__body *b;
    size_t i;
    int c;
    memset(r, 0, sizeof *r);
    for (b = peri__body_at(w, first); b; b = peri__body_at(w, b->next)) {
        r->mass += b->mass;
        for (i = (size_t)b->first; i < (size_t)b->first + (size_t)b->count; i++)
            for (c = 0; c < 3; c++) r->centre[c] += (double)w->mass[i] * x[3 * i + (size_t)c];
    }
    for (c = 0; c < 3; c++) r->centre[c] /= r->mass;
    for (b = peri__body_at(w, first); b; b = peri__body_at(w, b->next)) peri__rigid_add(w, b, x, v, r);
}

/* What the momenta of a free group must be after the step: those before it plus the impulses of the outer forces. */
static void peri__momenta_due(const peri_world *w, int first, double dt, double p[3], double l[3]) {
    peri__rigid before, after;
    const peri__body *b;
    double gravity[3];
    size_t i;
    int c;
    peri__rigid_make(w, first, w->x0, w->v, &before);
    peri__vec(w->def.gravity, gravity);
    for (c = 0; c < 3; c++) {
        p[c] = before.momentum[c] + dt * before.mass * gravity[c];
        l[c] = before.spin[c];
    }
    if (!(w->wants & PERI__WANT_FORCE)) return;
    peri__rigid_make(w, first, w->x, w->v, &after);
    for (b = peri__body_at(w, first); b; b = peri__body_at(w, b->next))
        for (i = (size_t)b->first; i < (size_t)b->first + (size_t)b->count; i++) {
            double force[3], arm[3], turn[3];
            for (c = 0; c < 3; c++) {
                arm[c] = w->x[3 * i + (size_t)c] - after.centre[c];
                force[c] = (double)w->force[3 * i + (size_t)c];
                p[c] += dt * force[c];
            }
            peri__cross(arm, force, turn);
            for (c = 0; c < 3; c++) l[c] += dt * turn[c];
        }
}

/* Backward Euler loses rotation at a rate of dt (spin)^2, and an iteration that stops at a tolerance leaves a little of
   everything. A group of bodies that touches nothing else is given the rigid velocity that sets both momenta right, and
   goes where its momentum takes it. */
static void peri__keep_momenta(peri_world *w, int first, const double p_due[3], const double l_due[3]) {
    peri__rigid r;
    const peri__body *b;
    double inverse[9], spin[3] = {0, 0, 0}, lost[3], det, scale = 0;
    size_t i;
    int c;
    peri__rigid_make(w, first, w->x, w->v, &r);
    det = peri_det3(r.inertia);
    for (c = 0; c < 9; c += 4) scale += r.inertia[c] / 3;
    for (c = 0; c < 3; c++) lost[c] = l_due[c] - r.spin[c];
    if (det > 1e-9 * scale * scale * scale) {       /* a rod along an axis has none about it: leave that alone */
        peri_adjugate3(r.inertia, inverse);
        peri__apply(inverse, lost, spin);
        for (c = 0; c < 3; c++) spin[c] /= det;
    }
    for (b = peri__body_at(w, first); b; b = peri__body_at(w, b->next))
        for (i = (size_t)b->first; i < (size_t)b->first + (size_t)b->count; i++) {
            double arm[3], turn[3];
            for (c = 0; c < 3; c++) arm[c] = w->x[3 * i + (size_t)c] - r.centre[c];
            peri__cross(spin, arm, turn);
            for (c = 0; c < 3; c++) {
                size_t k = 3 * i + (size_t)c;
                double lacks = (p_due[c] - r.momentum[c]) / r.mass;
                w->v[k] = (peri_real)((double)w->v[k] + turn[c] + lacks);
                w->x[k] += b->h * lacks;
                w->out[k] = (peri_real)w->x[k];
            }
        }
}

/* Moves the awake bodies that are not there yet to their first guess and looks at their shape. */
static peri_result peri__bodies_begin(peri_world *w, double dt) {
    peri_result bad = PERI_OK;
    int k;
    for (k = 0; k < w->bodies.capacity && !bad; k++) {
        peri__body *b = peri__body_at(w, k);
        if (!b || b->asleep || b->begun) continue;
        b->begun = 1;
        b->h = peri__scheme_of(w, b, dt).beta * dt;
        peri__predict(w, b, dt);
        bad = peri__health_check(w, b);
    }
    return bad;
}

/* Boxes of the paths from x0 to x of the bodies that are awake. */
static void peri__bodies_sweep(peri_world *w) {
    int k;
    for (k = 0; k < w->bodies.capacity; k++) {
        peri__body *b = peri__body_at(w, k);
        if (!b || b->asleep) continue;
        b->grid_made = 0;
        peri__body_sweep(w, b);
    }
}

/* Contacts along the paths from x0 to x (which may wake bodies: then once more), and what follows from them: islands,
   matrices. */
static peri_result peri__contacts_begin(peri_world *w, double dt) {
    peri_result bad = PERI_OK;
    int k;
    do {
        w->woken = 0;
        bad = peri__bodies_begin(w, dt);
        peri__bodies_sweep(w);
        if (!bad) bad = peri__contacts_find(w);
    } while (!bad && w->woken);
    if (!bad) bad = peri__holds_reserve(w);
    if (bad) return bad;
    peri__contacts_retreat(w);
    peri__attachments_begin(w);
    peri__islands_make(w);
    for (k = 0; k < w->stats.islands && !bad; k++) bad = peri__matrices_prepare(w, &w->islands[k]);
    return bad;
}

/* begin: what is needed to go back is in x0. */
static peri_result peri__step_begin(peri_world *w, double dt) {
    int k;
    for (k = 0; k < w->colliders.capacity; k++) {
        peri__collider *c = peri__collider_at(w, k);
        if (c) peri__collider_advance(c, dt);
    }
    for (k = 0; k < w->bodies.capacity; k++) {
        peri__body *b = peri__body_at(w, k);
        if (!b) continue;
        b->asleep0 = b->asleep;
        b->still0 = b->still;
        b->still_steps0 = b->still_steps;
        b->begun = 0;
    }
    if (w->asleep) peri__wake_by_colliders(w);
    w->contact_count = 0;
    w->stats.islands = 0;
    return w->asleep == w->bodies.count ? PERI_OK : peri__contacts_begin(w, dt);
}

/* Did a body end further from its guess than contacts were sought for? */
static int peri__bodies_stray(peri_world *w, double dt) {
    double gravity[3];
    int i, k, c, any = 0;
    peri__vec(w->def.gravity, gravity);
    for (k = 0; k < w->bodies.capacity; k++) {
        peri__body *b = peri__body_at(w, k);
        if (!b) continue;
        b->strayed = 0;
        if (b->asleep) continue;
        for (i = 0; i < b->surface_count && !b->strayed && b->radius > 0; i++) {
            size_t at = (size_t)(b->first + b->surface[i]);
            for (c = 0; c < 3 && !(w->flags[at] & PERI__FIXED); c++)
                b->strayed |= !(fabs(w->x[3 * at + (size_t)c] - peri__guess(w, b, 3 * at + (size_t)c, gravity, dt)) <
                                0.25 * b->radius);
        }
        any |= b->strayed;
    }
    return any;
}

#define PERI__ROUNDS 4          /* most solves of a step, each with the contacts that the one before missed */

/* Is there something on the way to where the solve ended that the solve did not know of? Contacts are sought along the
   way to the guess, and after an impact the guess may be far off. */
static peri_result peri__contacts_check(peri_world *w, double dt) {
    peri_result bad = PERI_OK;
    w->missed = 0;
    if (!peri__bodies_stray(w, dt)) return PERI_OK;
    peri__bodies_sweep(w);
    w->checking = 1;
    bad = peri__contacts_find(w);
    w->checking = 0;
    return bad;
}

/* solve: the elastic energies, contacts and attachments to the tolerance, island by island. */
static peri_result peri__step_solve(peri_world *w, double dt) {
    int k, round;
    peri_result bad = PERI_OK;
    for (round = 1; !bad; round++) {
        for (k = 0; k < w->stats.islands && !bad; k++) bad = peri__solve_island(w, &w->islands[k]);
        if (!bad) bad = peri__contacts_check(w, dt);
        if (bad || !w->missed || round == PERI__ROUNDS) break;
        bad = peri__contacts_begin(w, dt);
    }
    if (!bad && w->missed) w->stats.converged = 0;
    return bad;
}

/* New velocities of a group of bodies that touch each other (first, and chained by `next`). */
static void peri__group_commit(peri_world *w, int first, double dt) {
    int keep = w->def.keep_momentum;
    double p[3], l[3];
    peri__body *b;
    for (b = peri__body_at(w, first); b; b = peri__body_at(w, b->next)) keep &= !b->fixed && !b->held;
    if (keep) peri__momenta_due(w, first, dt, p, l);
    for (b = peri__body_at(w, first); b; b = peri__body_at(w, b->next)) peri__body_commit(w, b, dt);
    if (keep) peri__keep_momenta(w, first, p, l);
    for (b = peri__body_at(w, first); b; b = peri__body_at(w, b->next)) {
        size_t at = 3 * (size_t)b->first, n = 3 * (size_t)b->count * sizeof *w->x;
        if (w->def.integrator == PERI_BDF2) memcpy(w->back + at, w->x0 + at, n);
        memcpy(w->x0 + at, w->x + at, n);
        w->stats.unhealthy += b->unhealthy;
    }
}

/* What sleeping bodies do to colliders: the forces of the last step that they were awake. */
static void peri__colliders_settle(peri_world *w) {
    int k, c;
    for (k = 0; k < w->colliders.capacity; k++) {
        peri__collider *solid = peri__collider_at(w, k);
        for (c = 0; c < 3 && solid; c++) solid->weight[c] = solid->lean[c] = 0;
    }
    for (k = 0; k < w->hold_count; k++) {
        const peri__hold *hold = &w->holds[k];
        const peri__body *b = peri__body_at(w, hold->body);
        if (b->asleep && hold->target < PERI__TARGET_BODY)
            peri__collider_load(peri__collider_at(w, hold->target),
                                w->x0 + 3 * (size_t)(b->first + hold->particle), hold->force);
    }
    for (k = 0; k < w->attachments.capacity; k++) {
        const peri__attachment *t = peri__attachment_at(w, k);
        double end[3];
        if (!t || t->collider < 0 || !peri__body_at(w, t->body)->asleep) continue;
        peri__attachment_end(w, t, 0, end);
        peri__collider_load(peri__collider_at(w, t->collider), end, t->committed);
    }
    w->unsettled = 0;
}

/* commit: contacts, velocities, sleep, colliders. */
static void peri__step_commit(peri_world *w, double dt) {
    int k, c, groups;
    if (w->unsettled) peri__colliders_settle(w);
    for (k = 0; k < w->colliders.capacity; k++) {
        peri__collider *solid = peri__collider_at(w, k);
        for (c = 0; c < 3 && solid; c++) {
            solid->linear[c] = dt * solid->weight[c];
            solid->angular[c] = dt * solid->lean[c];
        }
    }
    if (w->asleep < w->bodies.count) {
        for (k = 0; k < w->bodies.capacity; k++) {
            peri__body *b = peri__body_at(w, k);
            if (b) b->touching = b->held = b->restless = 0;
        }
        peri__contacts_commit(w, dt);
        peri__attachments_commit(w, dt);
        groups = peri__chains_make(w, 1);
        for (k = 0; k < groups; k++) peri__group_commit(w, w->islands[k].first, dt);
        peri__attachments_break(w);
        peri__sleep_check(w, dt);
    }
    for (k = 0; k < w->colliders.capacity; k++) {
        peri__collider *solid = peri__collider_at(w, k);
        if (!solid) continue;
        memcpy(solid->position, solid->position1, sizeof solid->position);
        memcpy(solid->rotation, solid->rotation1, sizeof solid->rotation);
        solid->quat = solid->quat1;
        solid->moved = 0;
    }
}

static void peri__step_undo(peri_world *w) {
    int k;
    if (w->particles) memcpy(w->x, w->x0, 3 * (size_t)w->particles * sizeof *w->x);
    w->contact_count = 0;
    w->asleep = 0;
    for (k = 0; k < w->bodies.capacity; k++) {
        peri__body *b = peri__body_at(w, k);
        if (!b) continue;
        if (b->asleep0) b->grid_made = 0;
        b->asleep = b->asleep0;
        b->still = b->still0;
        b->still_steps = b->still_steps0;
        w->asleep += b->asleep != 0;
    }
    w->stats.undone++;
}

/* The way through a step: begin, solve, commit. Elastic bodies keep their families and do not flow, and contacts act
   within the solve: those phases of the profile are zero. */
peri_result peri_world_step(peri_world *w, peri_real dt) {
    double start, mark;
    peri_result bad;
    if (!w) return PERI_ERROR_ARGUMENT;
    bad = peri__check_range("dt", (double)dt, 1e-12, 1e12, &w->error);
    if (bad) return peri__report(w, bad);
    memset(&w->stats.profile, 0, sizeof w->stats.profile);
    w->stats.iterations = w->stats.evaluations = w->stats.unhealthy = 0;
    w->stats.correction = w->stats.residual = 0;
    w->stats.converged = 1;
    start = mark = peri__clock(w);
    bad = peri__step_begin(w, (double)dt);
    w->stats.profile.begin = 1e3 * (peri__clock(w) - mark);
    mark = peri__clock(w);
    if (!bad) bad = peri__step_solve(w, (double)dt);
    w->stats.profile.solve = 1e3 * (peri__clock(w) - mark);
    w->stats.profile.search = w->stats.profile.solve - w->stats.profile.local - w->stats.profile.global;
    mark = peri__clock(w);
    if (bad) peri__step_undo(w);
    else peri__step_commit(w, (double)dt);
    w->stats.profile.commit = 1e3 * (peri__clock(w) - mark);
    w->stats.profile.total = 1e3 * (peri__clock(w) - start);
    return peri__report(w, bad);
}

static uint64_t peri__hash_bytes(uint64_t hash, const void *data, size_t bytes) {
    const unsigned char *p = (const unsigned char *)data;
    size_t k;
    for (k = 0; k < bytes; k++) hash = (hash ^ p[k]) * 1099511628211ull;
    return hash;
}

uint64_t peri_world_hash(const peri_world *w) {
    uint64_t hash = 14695981039346656037ull;
    size_t n;
    int k;
    if (!w) return 0;
    n = 3 * (size_t)w->particles;
    hash = peri__hash_bytes(hash, w->x, n * sizeof *w->x);
    hash = peri__hash_bytes(hash, w->v, n * sizeof *w->v);
    hash = peri__hash_bytes(hash, w->v0, n * sizeof *w->v0);
    hash = peri__hash_bytes(hash, w->flags, (size_t)w->particles);
    hash = peri__hash_bytes(hash, &w->def.gravity, sizeof w->def.gravity);
    if (w->wants & PERI__WANT_FORCE) hash = peri__hash_bytes(hash, w->force, n * sizeof *w->force);
    if (w->wants & PERI__WANT_AIM) hash = peri__hash_bytes(hash, w->aim, n * sizeof *w->aim);
    if (w->def.integrator == PERI_BDF2) hash = peri__hash_bytes(hash, w->back, n * sizeof *w->back);
    for (k = 0; k < w->colliders.capacity; k++) {
        const peri__collider *c = (const peri__collider *)(void *)peri__slot_at(&w->colliders, k);
        if (!c) continue;
        hash = peri__hash_bytes(hash, c->position, sizeof c->position);
        hash = peri__hash_bytes(hash, &c->quat, sizeof c->quat);
    }
    for (k = 0; k < w->hold_count; k++)
        hash = peri__hash_bytes(hash, w->holds[k].anchor, sizeof w->holds[k].anchor);
    for (k = 0; k < w->bodies.capacity; k++) {
        const peri__body *b = peri__body_at(w, k);
        if (b) hash = peri__hash_bytes(hash, &b->still, sizeof b->still);
    }
    for (k = 0; k < w->attachments.capacity; k++) {
        const peri__attachment *t = peri__attachment_at(w, k);
        if (t) hash = peri__hash_bytes(hash, t->point, sizeof t->point);
    }
    return hash;
}

peri_result peri_world_contacts(const peri_world *w, peri_contact *out, int capacity, int *count) {
    int k;
    if (!w || !count || (out && capacity < 0)) return PERI_ERROR_ARGUMENT;
    *count = w->hold_count;
    for (k = 0; out && k < w->hold_count && k < capacity; k++) {
        const peri__hold *hold = &w->holds[k];
        peri_contact *c = &out[k];
        const peri__body *a = peri__body_at(w, hold->body);
        double normal[3];
        memset(c, 0, sizeof *c);
        c->body.index1 = (uint32_t)hold->body + 1;
        c->body.generation = a->slot.generation;
        c->particle = hold->particle;
        c->nearest = hold->nearest;
        memcpy(normal, hold->normal, sizeof normal);
        if (hold->target >= PERI__TARGET_BODY) {
            c->other.index1 = (uint32_t)(hold->target - PERI__TARGET_BODY) + 1;
            c->other.generation = peri__body_at(w, hold->target - PERI__TARGET_BODY)->slot.generation;
        } else {
            const peri__collider *solid = peri__collider_at(w, hold->target);
            c->collider.index1 = (uint32_t)hold->target + 1;
            c->collider.generation = solid->slot.generation;
            peri__apply(solid->rotation, hold->normal, normal);
        }
        c->point = peri__to_vec(w->x0 + 3 * (size_t)(a->first + hold->particle));
        c->normal = peri__to_vec(normal);
        c->force = peri__to_vec(hold->force);
        c->overlap = (peri_real)hold->overlap;
    }
    return PERI_OK;
}

/* ---- implementation 17: looking ---------------------------------------------------------------------------------- */

static void peri__measure_elastic(peri_world *w, peri__body *b, peri_measure *out) {
    unsigned char *mode = w->mode + b->first;
    int i;
    for (i = 0; i < b->count; i += PERI__GRAIN)
        out->elastic += peri__elastic(w, b, i, b->count < i + PERI__GRAIN ? b->count : i + PERI__GRAIN);
    for (i = 0; i < b->count && b->unhealthy; i++) {
        if (mode[i] != PERI__RESTORED) continue;
        out->restoring += peri__elastic(w, b, i, i + 1);
        mode[i] = PERI__MAIN;
        out->restoring -= peri__elastic(w, b, i, i + 1);
        mode[i] = PERI__RESTORED;
    }
}

static void peri__measure_body(peri_world *w, peri__body *b, peri_measure *out) {
    size_t i, end = (size_t)b->first + (size_t)b->count;
    double gravity[3];
    int c;
    peri__vec(w->def.gravity, gravity);
    for (i = (size_t)b->first; i < end; i++) {
        double m = (double)w->mass[i], turn[3], v[3];
        const double *x = w->x + 3 * i;
        for (c = 0; c < 3; c++) v[c] = (double)w->v[3 * i + (size_t)c];
        peri__cross(x, v, turn);
        for (c = 0; c < 3; c++) {
            out->centre[c] += m * x[c];
            out->momentum[c] += m * v[c];
            out->angular_momentum[c] += m * turn[c];
            out->kinetic += m * v[c] * v[c] / 2;
            out->potential -= m * gravity[c] * x[c];
            if (x[c] < out->lower[c]) out->lower[c] = x[c];
            if (x[c] > out->upper[c]) out->upper[c] = x[c];
        }
        out->mass += m;
    }
    peri__measure_elastic(w, b, out);
}

peri_result peri_body_measure(peri_world *w, peri_body_id id, peri_measure *out) {
    int k, c, all = !id.index1 && !id.generation;
    if (!w) return PERI_ERROR_ARGUMENT;
    if (!out) return peri__report(w, peri__fail(&w->error, PERI_ERROR_ARGUMENT, "out is NULL"));
    if (!all && !peri__body_find(w, id)) return peri__no_body(w, id);
    memset(out, 0, sizeof *out);
    for (c = 0; c < 3; c++) out->lower[c] = 1e300, out->upper[c] = -1e300;
    for (k = 0; k < w->bodies.capacity; k++) {
        peri__body *b = peri__body_at(w, k);
        if (b && (all || k == (int)id.index1 - 1)) peri__measure_body(w, b, out);
    }
    for (c = 0; c < 3; c++) {
        if (out->mass > 0) out->centre[c] /= out->mass;
        else out->lower[c] = out->upper[c] = 0;
    }
    return PERI_OK;
}

peri_result peri_body_forces(peri_world *w, peri_body_id id, peri_real *f) {
    peri__body *b = peri__body_find(w, id);
    peri__pass p;
    int i, k, c;
    if (!b) return peri__no_body(w, id);
    if (!f) return peri__report(w, peri__fail(&w->error, PERI_ERROR_ARGUMENT, "f is NULL"));
    peri__pass_begin(&p, w, b, b->stations ? w->g1 + 3 * (size_t)b->first : f);
    peri__pass_run(&p);
    for (i = 0; i < b->stations; i++)       /* of a rod: those on its sections */
        for (c = 0; c < 3; c++) {
            f[3 * i + c] = p.f[3 * i + c];
            for (k = 0; k < PERI__GHOSTS; k++) f[3 * i + c] += p.f[3 * (b->stations + PERI__GHOSTS * i + k) + c];
        }
    return PERI_OK;
}

peri_result peri_rod_moment(peri_world *w, peri_body_id id, int particle, peri_vec3 *moment) {
    peri__body *b;
    peri__pass p;
    peri_result bad = peri__rod_point(w, id, particle, &b);
    double sum[3] = {0, 0, 0}, arm[3], force[3], turn[3];
    int k, c;
    if (bad) return bad;
    if (!moment) return peri__report(w, peri__fail(&w->error, PERI_ERROR_ARGUMENT, "moment is NULL"));
    peri__pass_begin(&p, w, b, w->g1 + 3 * (size_t)b->first);
    peri__pass_run(&p);
    for (k = 0; k < PERI__GHOSTS; k++) {
        size_t ghost = peri__ghost(b, particle) - (size_t)b->first + (size_t)k;
        for (c = 0; c < 3; c++) {
            arm[c] = p.x[3 * ghost + (size_t)c] - p.x[3 * (size_t)particle + (size_t)c];
            force[c] = (double)p.f[3 * ghost + (size_t)c];
        }
        peri__cross(arm, force, turn);
        for (c = 0; c < 3; c++) sum[c] += turn[c];
    }
    *moment = peri__to_vec(sum);
    return PERI_OK;
}

/* Kirchhoff stress J sigma of particle i: the virial of its own energy, sum of pull (x) y over its bonds, per volume.
   The coefficients of the last local pass are used. */
static void peri__virial(peri__pass *p, int i, double tau[6]) {
    static const int row[6] = {0, 1, 2, 1, 0, 0}, col[6] = {0, 1, 2, 2, 2, 1};
    const peri_real *coef = peri__coef(p->w, p->b) + (size_t)p->row->stride * (size_t)i;
    double volume = p->bonds->unit * (double)p->bonds->volume[i];
    int k, c;
    for (c = 0; c < 6; c++) tau[c] = 0;
    for (k = p->bonds->row[i]; k < p->bonds->row[i + 1]; k++) {
        peri__bond o;
        peri_real t[3];
        peri__bond_load(p->bonds, i, k, p->x, &o);
        if (p->bonds->mode[i] == PERI__MAIN) p->row->pull(&p->b->matter, coef, &o, t);
        else peri__special_pull(p->bonds, &p->b->matter, i, &o, t);
        for (c = 0; c < 6; c++)
            tau[c] += (double)(t[row[c]] * o.y[col[c]] + t[col[c]] * o.y[row[c]]) / (2 * volume);
    }
}

/* What has become of a sheet's thickness: known of the correspondence model, whose law says it; of others 1. */
static double peri__thinning(const peri__pass *p, int i) {
    const peri_real *n = p->bonds->normal + 3 * (size_t)i;
    double h[6], dpsi[6], square = 1;
    int c;
    static const int row[6] = {0, 1, 2, 1, 0, 0}, col[6] = {0, 1, 2, 2, 2, 1};
    if (p->b->matter.m.model != PERI_MODEL_CORRESPONDENCE || p->bonds->mode[i] != PERI__MAIN) return 1;
    peri__strain(p->bonds, p->x, i, h);
    peri__law_plane(&peri__matter_of(p->bonds, &p->b->matter, i)->m, n, h, dpsi);
    for (c = 0; c < 6; c++) square += (c < 3 ? 1 : 2) * h[c] * (double)(n[row[c]] * n[col[c]]);
    return square > 0 ? sqrt(square) : 0;
}

/* Fbar; where the bonds lie in a plane, the missing direction is its normal. */
static void peri__gradient_whole(peri__pass *p, int i, double f[9]) {
    const peri_real *s = p->bonds->shape + 6 * (size_t)i;
    double k[6], value[3], v[9], normal[3], a[3], b[3], fa[3], fb[3], length;
    int c, d;
    peri__gradient(p->bonds, p->x, i, f);
    if (p->bonds->normal) {
        peri__gradient_complete(p->bonds->normal + 3 * (size_t)i, peri__thinning(p, i), f);
        return;
    }
    if (!(p->w->flags[p->b->first + i] & PERI__FLAT)) return;
    for (c = 0; c < 6; c++) k[c] = (double)s[c];
    peri_eigen3(k, value, v);
    if (!(value[1] > 0)) {      /* a line, or nothing: no more can be said than to move along */
        for (c = 0; c < 9; c++) f[c] = c % 4 == 0;
        return;
    }
    for (c = 0; c < 3; c++) a[c] = v[3 * c + 1], b[c] = v[3 * c + 2];
    peri__apply(f, a, fa);
    peri__apply(f, b, fb);
    peri__cross(fa, fb, normal);
    length = sqrt(normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2]);
    peri__cross(a, b, fa);
    for (c = 0; c < 3; c++)
        for (d = 0; d < 3; d++) f[3 * c + d] += length > 0 ? normal[c] / length * fa[d] : 0;
}

static double peri__largest_stretch(const peri__pass *p, int i) {
    double largest = 0;
    int k;
    for (k = p->bonds->row[i]; k < p->bonds->row[i + 1]; k++) {
        peri__bond o;
        double e;
        peri__bond_load(p->bonds, i, k, p->x, &o);
        e = fabs((double)peri__tau(&o) - 1);
        if (e > largest) largest = e;
    }
    return largest;
}

/* Cauchy stress of particle i. */
static void peri__cauchy(peri__pass *p, int i, double s[6]) {
    double f[9], j;
    int c;
    peri__virial(p, i, s);
    peri__gradient_whole(p, i, f);
    j = fabs(peri_det3(f));
    for (c = 0; c < 6; c++) s[c] /= j > 1e-3 ? j : 1e-3;
}

static double peri__von_mises(const double s[6]) {
    double a = s[0] - s[1], b = s[1] - s[2], c = s[2] - s[0];
    return sqrt((a * a + b * b + c * c) / 2 + 3 * (s[3] * s[3] + s[4] * s[4] + s[5] * s[5]));
}

static double peri__value(peri_world *w, peri__pass *p, int i, peri_value value) {
    const peri_real *v = w->v + 3 * (size_t)(p->b->first + i);
    double s[6];
    switch (value) {
    case PERI_VALUE_STRETCH: return peri__largest_stretch(p, i);
    case PERI_VALUE_STRESS: peri__cauchy(p, i, s); return peri__von_mises(s);
    case PERI_VALUE_ENERGY:
        return peri__elastic(w, p->b, i, i + 1) / (p->bonds->unit * (double)p->bonds->volume[i]);
    case PERI_VALUE_SPEED:
        return sqrt((double)v[0] * (double)v[0] + (double)v[1] * (double)v[1] + (double)v[2] * (double)v[2]);
    case PERI_VALUE_DAMAGE: break;      /* no bond breaks yet */
    }
    return 0;
}

/* Starts a look at a body: the coefficients of its present positions. */
static peri_result peri__look(peri_world *w, peri_body_id id, const void *out, peri__pass *p) {
    peri__body *b = peri__body_find(w, id);
    memset(p, 0, sizeof *p);
    if (!b) return peri__no_body(w, id);
    if (!out) return peri__report(w, peri__fail(&w->error, PERI_ERROR_ARGUMENT, "out is NULL"));
    peri__pass_begin(p, w, b, NULL);
    peri__elastic(w, b, 0, b->count);
    return PERI_OK;
}

peri_result peri_body_values(peri_world *w, peri_body_id id, peri_value value, peri_real *out) {
    peri__pass p;
    peri_result bad;
    int i;
    if (!w) return PERI_ERROR_ARGUMENT;
    bad = peri__check_enum("value", (int)value, (int)PERI_VALUE_SPEED, &w->error);
    if (bad) return peri__report(w, bad);
    bad = peri__look(w, id, out, &p);
    for (i = 0; !bad && i < peri__real_count(p.b); i++) out[i] = (peri_real)peri__value(w, &p, i, value);
    return bad;
}

peri_result peri_body_stress(peri_world *w, peri_body_id id, peri_real *out) {
    peri__pass p;
    peri_result bad = peri__look(w, id, out, &p);
    double s[6];
    int i, c;
    for (i = 0; !bad && i < peri__real_count(p.b); i++) {
        peri__cauchy(&p, i, s);
        for (c = 0; c < 6; c++) out[6 * (size_t)i + (size_t)c] = (peri_real)s[c];
    }
    return bad;
}

peri_result peri_body_gradient(peri_world *w, peri_body_id id, peri_real *out) {
    peri__pass p;
    peri_result bad = peri__look(w, id, out, &p);
    double f[9];
    int i, c;
    for (i = 0; !bad && i < peri__real_count(p.b); i++) {
        peri__gradient_whole(&p, i, f);
        for (c = 0; c < 9; c++) out[9 * (size_t)i + (size_t)c] = (peri_real)f[c];
    }
    return bad;
}

peri_choice peri_body_solver(const peri_world *w, peri_body_id id) {
    peri_choice c;
    const peri__body *b = w ? peri__body_find(w, id) : NULL;
    memset(&c, 0, sizeof c);
    if (!b) return c;
    c.solver = b->solver;
    c.cost[0] = 1e-6 * b->cost[0];
    c.cost[1] = 1e-6 * b->cost[1];
    c.entries = (double)b->fill;
    switch (b->why) {
    case PERI__WHY_NOT_YET: snprintf(c.why, sizeof c.why, "not chosen yet: the first step does that"); break;
    case PERI__WHY_ASKED: snprintf(c.why, sizeof c.why, "the world's definition asks for it"); break;
    case PERI__WHY_SMALL: snprintf(c.why, sizeof c.why, "%d particles: a factor is cheap", b->count); break;
    case PERI__WHY_COST:
        snprintf(c.why, sizeof c.why, "%d particles, %d bonds, %.3g entries of L: %.3g ms a step with Cholesky, "
                 "%.3g with two levels", b->count, b->row[b->count], c.entries, c.cost[0], c.cost[1]);
        break;
    case PERI__WHY_ROOM: snprintf(c.why, sizeof c.why, "no room for the factor of %d particles", b->count); break;
    case PERI__WHY_LEFT_OUT: snprintf(c.why, sizeof c.why, "PERI_NO_CHOLESKY leaves factors out"); break;
    }
    return c;
}

peri_stats peri_world_stats(const peri_world *w) {
    peri_stats s;
    int k;
    memset(&s, 0, sizeof s);
    if (!w) return s;
    s = w->stats;
    s.bodies = w->bodies.count;
    s.particles = w->particles;
    s.bonds = w->bonds;
    s.colliders = w->colliders.count;
    s.skins = w->skins.count;
    s.attachments = w->attachments.count;
    s.contacts = w->hold_count;
    s.asleep = w->asleep;
    s.overlap = w->overlap;
    for (k = 0; k < w->bodies.capacity; k++) {
        const peri__body *b = peri__body_at(w, k);
        if (b) s.singular += b->singular;
    }
    return s;
}

#ifndef PERI_NO_DRAW
static void peri__draw_body(peri_world *w, peri__body *b, const peri_draw *draw) {
    peri__pass p;
    double span = (double)draw->high - (double)draw->low, t, t1;
    int i, k;
    peri__pass_begin(&p, w, b, NULL);
    peri__elastic(w, b, 0, b->count);
    for (i = 0; i < peri__real_count(b); i++) {
        peri_vec3 x = peri__to_vec(p.x + 3 * (size_t)i);
        t = (peri__value(w, &p, i, draw->value) - (double)draw->low) / span;
        t = t < 0 ? 0 : t > 1 ? 1 : t;
        if (draw->point) draw->point(x, (peri_real)(b->spacing / 2), (peri_real)t, draw->user);
        for (k = b->row[i]; k < b->row[i + 1] && draw->line; k++) {
            peri__bond o;
            if (b->col[k] < i || b->col[k] >= peri__real_count(b)) continue;
            peri__bond_load(p.bonds, i, k, p.x, &o);
            t1 = draw->value == PERI_VALUE_STRETCH
                     ? (fabs((double)peri__tau(&o) - 1) - (double)draw->low) / span
                     : t;
            t1 = t1 < 0 ? 0 : t1 > 1 ? 1 : t1;
            draw->line(x, peri__to_vec(p.x + 3 * (size_t)b->col[k]), (peri_real)t1, draw->user);
        }
    }
}

peri_result peri_world_draw(peri_world *w, const peri_draw *draw) {
    peri_result bad;
    int k;
    if (!w) return PERI_ERROR_ARGUMENT;
    if (!draw) return peri__report(w, peri__fail(&w->error, PERI_ERROR_ARGUMENT, "draw is NULL"));
    bad = peri__check_enum("value", (int)draw->value, (int)PERI_VALUE_SPEED, &w->error);
    if (!bad && (!(draw->high > draw->low) || !peri__finite((double)draw->high - (double)draw->low)))
        bad = peri__fail(&w->error, PERI_ERROR_VALUE, "high is %g and low %g: high must be above low",
                         (double)draw->high, (double)draw->low);
    for (k = 0; !bad && k < w->bodies.capacity; k++) {
        peri__body *b = peri__body_at(w, k);
        if (b) peri__draw_body(w, b, draw);
    }
    return peri__report(w, bad);
}
#endif

/* ---- implementation 18: skins of the world ----------------------------------------------------------------------- */
#ifndef PERI_NO_SKINNING

static void peri__skin_drop(peri_world *w, peri__skin *s) {
    peri_allocator memory = peri__spare(w);
    peri__skin_free(&s->data, &memory);
    if (s->gradient) peri__spare_resize(s->gradient, s->gradient_bytes, 0, w);
    peri__slot_free(&w->skins, &s->slot);
}

/* Drops the skins of a body, or (NULL) all. */
static void peri__skins_drop(peri_world *w, const peri__body *b) {
    int k;
    for (k = 0; k < w->skins.capacity; k++) {
        peri__skin *s = (peri__skin *)(void *)peri__slot_at(&w->skins, k);
        if (s && (!b || (s->generation == b->slot.generation && peri__body_at(w, (int)s->body - 1) == b)))
            peri__skin_drop(w, s);
    }
}

static peri__skin *peri__skin_find(const peri_world *w, peri_skin_id id) {
    return w ? (peri__skin *)(void *)peri__slot_find(&w->skins, id.index1, id.generation) : NULL;
}

static peri_result peri__no_skin(peri_world *w, peri_skin_id id) {
    if (!w) return PERI_ERROR_ARGUMENT;
    return peri__report(w, peri__fail(&w->error, PERI_ERROR_ID, "skin (%u, %u) does not exist in this world",
                                      (unsigned)id.index1, (unsigned)id.generation));
}

peri_skin_id peri_skin_create(peri_world *w, peri_body_id body, const peri_real *vertices, int vertex_count,
                              const int *triangles, int triangle_count) {
    peri_skin_id id = {0, 0};
    peri__body *b = peri__body_find(w, body);
    peri__skin *s, made;
    peri_allocator memory;
    peri_result bad;
    if (!b) {
        peri__no_body(w, body);
        return id;
    }
    s = (peri__skin *)(void *)peri__slot_take(w, &w->skins);
    if (!s) {
        peri__report(w, w->error.code);
        return id;
    }
    memory = peri__spare(w);
    made = *s;
    bad = peri__skin_bind(b->points, b->count, (peri_real)b->spacing, vertices, vertex_count, triangles, triangle_count,
                          &made.data, &memory, &w->error);
    if (!bad) {
        made.gradient_bytes = 9 * (size_t)b->count * sizeof(peri_real);
        made.gradient = (peri_real *)peri__spare_resize(NULL, 0, made.gradient_bytes, w);
        if (!made.gradient) {
            peri__skin_free(&made.data, &memory);
            bad = peri__no_memory(w, made.gradient_bytes);
        }
    }
    if (bad) {
        peri__report(w, bad);
        return id;
    }
    made.body = body.index1;
    made.generation = body.generation;
    *s = made;
    id.index1 = peri__slot_use(&w->skins, &s->slot);
    id.generation = s->slot.generation;
    return id;
}

peri_result peri_skin_destroy(peri_world *w, peri_skin_id id) {
    peri__skin *s = peri__skin_find(w, id);
    if (!s) return peri__no_skin(w, id);
    peri__skin_drop(w, s);
    return PERI_OK;
}

typedef struct peri__skin_pass {
    peri__pass pass;
    peri_real *gradient;
    double turn[9];
} peri__skin_pass;

/* Deformation gradients with respect to the points as they were given. */
static void peri__skin_task(int begin, int end, void *context) {
    peri__skin_pass *s = (peri__skin_pass *)context;
    double f[9], g[9];
    int i, c;
    for (i = begin; i < end; i++) {
        peri__gradient_whole(&s->pass, i, f);
        peri_mul3(f, s->turn, g);
        for (c = 0; c < 9; c++) s->gradient[9 * (size_t)i + (size_t)c] = (peri_real)g[c];
    }
}

peri_result peri_skin_update(peri_world *w, peri_skin_id id, peri_real *positions, peri_real *normals) {
    peri__skin *s = peri__skin_find(w, id);
    peri__skin_pass p;
    peri__body *b;
    if (!s) return peri__no_skin(w, id);
    if (!positions) return peri__report(w, peri__fail(&w->error, PERI_ERROR_ARGUMENT, "positions is NULL"));
    b = peri__body_at(w, (int)s->body - 1);
    peri__pass_begin(&p.pass, w, b, NULL);
    p.gradient = s->gradient;
    peri__quat_matrix(b->rotation, p.turn);
    peri_parallel_for(&w->def.parallel, b->count, PERI__GRAIN, peri__skin_task, &p);
    peri__skin_move(&s->data, &w->def.parallel, w->out + 3 * (size_t)b->first, s->gradient, positions, normals);
    return PERI_OK;
}
#endif

#endif /* PERI_IMPLEMENTED */
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
