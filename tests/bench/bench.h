/* tests/bench/bench.h - what the benchmarks share: clocks, medians, a table that goes to people and to a CSV file. */
#ifndef PERI_BENCH_H
#define PERI_BENCH_H

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

/* A program uses what it needs of these. */
#if defined(__GNUC__) || defined(__clang__)
#define BENCH_MAY static __attribute__((unused))
#else
#define BENCH_MAY static
#endif

/* Processor time of this process in ms: all its threads together. */
BENCH_MAY double bench_cpu(void) { return 1e3 * (double)clock() / CLOCKS_PER_SEC; }

/* Of this thread only, where POSIX is asked for and has it. */
BENCH_MAY double bench_thread(void) {
#ifdef CLOCK_THREAD_CPUTIME_ID
    struct timespec t;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return 1e3 * (double)t.tv_sec + 1e-6 * (double)t.tv_nsec;
#else
    return bench_cpu();
#endif
}

/* malloc that ends the program instead of failing: a benchmark has nothing else to do then. */
BENCH_MAY void *bench_obtain(size_t bytes) {
    void *memory = malloc(bytes ? bytes : 1);
    if (memory) return memory;
    fprintf(stderr, "no memory for %.0f bytes\n", (double)bytes);
    exit(1);
}

/* The same, all zero. */
BENCH_MAY void *bench_zeros(size_t count, size_t bytes) {
    return memset(bench_obtain(count * bytes), 0, count * bytes);
}

BENCH_MAY int bench_less(const void *a, const void *b) {
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Sorts v[0 .. n - 1] and returns the median. *spread, when not NULL: (third quartile - first) / median. */
BENCH_MAY double bench_median(double *v, int n, double *spread) {
    double middle;
    qsort(v, (size_t)n, sizeof *v, bench_less);
    middle = n % 2 ? v[n / 2] : 0.5 * (v[n / 2 - 1] + v[n / 2]);
    if (spread) *spread = middle > 0 ? (v[(3 * (n - 1) + 2) / 4] - v[(n - 1) / 4]) / middle : 0;
    return middle;
}

/* `full` as the second argument of a benchmark; anything else is quick. */
BENCH_MAY int bench_full(int argc, char **argv) { return argc > 2 && strcmp(argv[2], "full") == 0; }

/* The CSV file that the first argument names, with its head line; NULL without one. */
BENCH_MAY FILE *bench_csv(int argc, char **argv, const char *head) {
    FILE *csv = argc > 1 ? fopen(argv[1], "w") : NULL;
    if (argc > 1 && !csv) printf("cannot write %s: the table is printed only\n", argv[1]);
    if (csv) fprintf(csv, "%s\n", head);
    return csv;
}

#endif
