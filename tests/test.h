/* tests/test.h - the harness: one program per subject, each test a function, run all or by name.

       static void rotates(void) { CHECK(1 + 1 == 2); NEAR(0.1 + 0.2, 0.3, 1e-15); }
       int main(int argc, char **argv) { test_begin(argc, argv); RUN(rotates); return test_end(); }

   `build/tests/NAME rotates` runs one test. The last line is `N passed, N failed`. */
#ifndef PERI_TEST_H
#define PERI_TEST_H

#include <math.h>
#include <stdio.h>
#include <string.h>

static const char *test_only = NULL;
static int test_passed = 0, test_failed = 0, test_bad = 0;

static void test_begin(int argc, char **argv) { test_only = argc > 1 ? argv[1] : NULL; }

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
        if (!test_only || strcmp(test_only, #test) == 0) { \
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
