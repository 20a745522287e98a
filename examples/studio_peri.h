/* studio_peri.h - what the examples share between studio.h and the library: names of materials and solvers, errors.
 *
 * Static functions over the public interface of peri.h.  Include it after both:
 *
 *     #include "studio.h"
 *     #define PERI_IMPLEMENTATION
 *     #include "../peri.h"
 *     #include "studio_peri.h"
 *
 * Conventions are those of studio.h: int is 0 for success or -1 after one clear line on stderr.
 *
 * Contents
 *    studio_choice      the index of a name in a table
 *    studio_material    a peri_material by name, as --model has it
 *    studio_solver      a peri_solver by name, as --solver has it
 *    studio_failed      the last error of a world as a studio_error
 *
 * License: MIT.
 */
#ifndef STUDIO_PERI_H
#define STUDIO_PERI_H

#include <stdio.h>
#include <string.h>

/* The index of `name` among the known ones, or -1 with an error that lists them.  NULL is the first. */
STUDIO_API int studio_choice(const char *option, const char *name, const char *const *known, int count) {
    char list[256] = "";
    size_t used = 0;
    int k;
    for (k = 0; k < count; k++)
        if (!name || !strcmp(name, known[k])) return k;
    for (k = 0; k < count && used < sizeof list; k++)
        used += (size_t)snprintf(list + used, sizeof list - used, " %s", known[k]);
    return studio_error("%s %s is unknown; known are:%s; see --help", option, name, list);
}

/* The material called `name` (NULL: neo_hookean).  "projective" does not ask for Poisson's ratio: its is 1/4. */
STUDIO_API int studio_material(const char *name, double young, double poisson, double density, peri_material *m) {
    static const char *const known[] = {"neo_hookean", "linear", "stvk", "stvk_exact", "stable", "papers",
                                        "projective"};
    const peri_real e = (peri_real)young, nu = (peri_real)poisson, rho = (peri_real)density;
    switch (studio_choice("--model", name, known, 7)) {
    case 0: *m = peri_material_neo_hookean(e, nu, rho); return 0;
    case 1: *m = peri_material_linear(e, nu, rho); return 0;
    case 2: *m = peri_material_stvk(e, nu, rho); return 0;
    case 3: *m = peri_material_stvk_exact(e, nu, rho); return 0;
    case 4: *m = peri_material_stable_neo_hookean(e, nu, rho); return 0;
    case 5: *m = peri_material_neo_hookean_papers(e, nu, rho); return 0;
    case 6: *m = peri_material_projective(e, (peri_real)0.5, rho); return 0;
    default: return -1;
    }
}

/* The solver called `name` (NULL: auto). */
STUDIO_API int studio_solver(const char *name, peri_solver *solver) {
    static const char *const known[] = {"auto", "cholesky", "jacobi", "chebyshev", "position"}; /* as peri_solver */
    int k = studio_choice("--solver", name, known, 5);
    if (k < 0) return -1;
    *solver = (peri_solver)k;
    return 0;
}

/* Says what the last call on this world complained of; returns -1 so that callers can return it. */
STUDIO_API int studio_failed(const peri_world *world) { return studio_error("%s", peri_last_error(world)->text); }

#endif /* STUDIO_PERI_H */
