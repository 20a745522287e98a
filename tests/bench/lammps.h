/* tests/bench/lammps.h - LAMMPS as a peer: how many bonds a second its peridynamic pair styles visit on one core, in
   the same run as ours. Needs the program `lmp` with the package PERI (Debian: apt-get install lammps). */
#ifndef PERI_BENCH_LAMMPS_H
#define PERI_BENCH_LAMMPS_H

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* 1 when lmp is there, with the pair style. */
static int lammps_found(void) {
#ifdef _WIN32
    return 0;
#else
    return system("lmp -h 2>/dev/null | grep -q peri/lps") == 0;
#endif
}

/* A free block of n^3 particles, shaken after the step at rest in which the bonds are made. */
static int lammps_write(const char *path, const char *style, int n, double horizon, int steps) {
    const double d = 1.0 / n;
    FILE *f = fopen(path, "w");
    if (!f) return 0;
    fprintf(f, "units si\nboundary s s s\natom_style peri\natom_modify map array\nlattice sc %.17g\n", d);
    fprintf(f, "region block block 0 %g 0 %g 0 %g units box\n", 1 - d / 2, 1 - d / 2, 1 - d / 2);
    fprintf(f, "create_box 1 block\ncreate_atoms 1 region block\npair_style peri/%s\n", style);
    if (strcmp(style, "pmb") == 0) fprintf(f, "pair_coeff * * 1e9 %.17g 1e30 0\n", horizon * d);
    else fprintf(f, "pair_coeff * * 1e5 4e4 %.17g 1e30 0\n", horizon * d);
    fprintf(f, "set group all density 1000\nset group all volume %.17g\n", d * d * d);
    fprintf(f, "neighbor %.17g bin\ntimestep 1e-9\nfix move all nve\nrun 1\n", 0.5 * d);
    fprintf(f, "displace_atoms all random %.17g %.17g %.17g 1\n", 0.05 * d, 0.05 * d, 0.05 * d);
    fprintf(f, "thermo %d\nrun %d\n", steps, steps);
    return fclose(f) == 0;
}

/* Reads what the last run of a log took: seconds of processor time in the pair style, and the bonds. */
static int lammps_read(const char *path, double *seconds, double *bonds, int *particles) {
    char line[256];
    double pair = 0, share = 100, least;
    FILE *f = fopen(path, "r");
    *bonds = 0;
    while (f && fgets(line, sizeof line, f)) {
        const char *count = strstr(line, "total # of bonds =");
        if (count) *bonds = atof(count + 18);
        if (strncmp(line, "Loop time", 9) == 0) sscanf(line, "%*[^w]with %d", particles);
        if (strstr(line, "% CPU use")) share = atof(line);
        if (strncmp(line, "Pair ", 5) == 0 && sscanf(line, "Pair | %lf | %lf", &least, &pair) != 2) pair = 0;
    }
    if (f) fclose(f);
    *seconds = pair * share / 100;
    return pair > 0 && *bonds > 0;
}

/* Million directed bonds a second: the best of three runs, as our loops' is the least of their repetitions. `stem`:
   where the script and the log go. 0 when it fails. */
static double lammps_bonds(const char *stem, const char *style, int n, double horizon, int steps,
                           double *milliseconds) {
    char script[600], log[600], command[1400];
    double best = 0, seconds, bonds;
    int run, particles = 0;
    snprintf(script, sizeof script, "%s.%s.in", stem, style);
    snprintf(log, sizeof log, "%s.%s.log", stem, style);
    snprintf(command, sizeof command, "lmp -in '%s' -log '%s' -screen none", script, log);
    if (strchr(stem, '\'') || !lammps_write(script, style, n, horizon, steps)) return 0;
    for (run = 0; run < 3; run++) {
        if (system(command) != 0 || !lammps_read(log, &seconds, &bonds, &particles)) return 0;
        if (particles != n * n * n) return printf("LAMMPS made %d particles of %d\n", particles, n * n * n), 0;
        if (1e-6 * bonds * steps / seconds <= best) continue;
        best = 1e-6 * bonds * steps / seconds;
        *milliseconds = 1e3 * seconds / steps;
    }
    return best;
}

#endif
