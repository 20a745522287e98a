/* tests/test.h - the harness: one program per subject, each test a function, run all or by name.

       static void rotates(void) { CHECK(1 + 1 == 2); NEAR(0.1 + 0.2, 0.3, 1e-15); }
       int main(int argc, char **argv) { test_begin(argc, argv); RUN(rotates); return test_end(); }

   `build/tests/NAME rotates` runs one test. The last line is `N passed, N failed`. */
#ifndef PERI_TEST_H
#define PERI_TEST_H

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const char *test_only = NULL;
static int test_passed = 0, test_failed = 0, test_bad = 0;

static void test_begin(int argc, char **argv) { test_only = argc > 1 ? argv[1] : NULL; }

/* Is a test run: the one named on the command line, or all but those in TEST_SKIP, names between blanks. */
static int test_wanted(const char *name) {
    const char *skip = getenv("TEST_SKIP"), *at = skip;
    size_t n = strlen(name);
    if (test_only) return strcmp(test_only, name) == 0;
    while (at && (at = strstr(at, name)) != NULL) {
        if ((at == skip || at[-1] == ' ') && (at[n] == ' ' || !at[n])) return 0;
        at += n;
    }
    return 1;
}

static void test_complain(const char *file, int line, const char *what) {
    if (test_bad < 5) printf("    %s:%d: %s\n", file, line, what);
    test_bad++;
}

#define CHECK(condition) \
    do { \
        if (!(condition)) test_complain(__FILE__, __LINE__, #condition); \
    } while (0)

/* |value - wanted| <= tolerance, and neither is NaN. */
#define NEAR(value, wanted, tolerance) \
    do { \
        double v_ = (double)(value), w_ = (double)(wanted), t_ = (double)(tolerance); \
        if (!(fabs(v_ - w_) <= t_)) { \
            char text_[200]; \
            snprintf(text_, sizeof text_, "%.80s is %.9g, wanted %.9g +- %.3g", #value, v_, w_, t_); \
            test_complain(__FILE__, __LINE__, text_); \
        } \
    } while (0)

#define RUN(test) \
    do { \
        if (test_wanted(#test)) { \
            test_bad = 0; \
            test(); \
            if (test_bad) test_failed++; else test_passed++; \
            printf("%s %s\n", test_bad ? "FAIL" : "ok  ", #test); \
            fflush(stdout); \
        } \
    } while (0)

static int test_end(void) {
    printf("%d passed, %d failed\n", test_passed, test_failed);
    return test_failed != 0;
}

#endif
