# peri - header-only, so there is nothing to build but examples and tests. Everything lands in build/.
#
#   make            builds the examples: build/examples/NAME
#   make run        builds and runs the first example; pictures in build/out/drop/   (RUN=NAME: another)
#   make test       runs tests and examples in about 9 minutes (-j2); the last line is "N passed, N failed"
#   make gallery    runs every example; pictures in build/out/NAME/
#   make bench      measures; tables in build/bench/NAME.csv   (BENCH=NAME: one; SIZE=quick|full)
#   make charts     draws the tables that are there with gnuplot: build/charts/NAME.png, NAME.svg
#   make matrix     compiles the headers in every way that is promised
#   make clean      removes build/
#
# CC and CFLAGS are yours: make test CC=clang CFLAGS="-O3 -march=native" -j2. After a change of them: make clean.
# Add -fopenmp to CFLAGS for threads. `make run` and `make test` need make and a C compiler, nothing else.

CFLAGS = -O2
BUILD = build
RUN = drop
BENCH = $(notdir $(basename $(wildcard tests/bench/*.c)))
SIZE = quick

COMPILE = $(CC) -std=c99 -Wall -Wextra -pedantic $(CFLAGS)
HEADERS = $(wildcard *.h examples/*.h tests/*.h tests/bench/*.h tests/baseline/*.h)
EXAMPLES = $(notdir $(basename $(wildcard examples/*.c)))
TESTS = $(notdir $(basename $(wildcard tests/test_*.c)))
# tests that say the same, or nothing, when peri_real is double (test_accuracy and test_baseline are double already,
# test_studio has no peri_real, test_stability compares with baselines in double)
FLOAT_ONLY = test_golden test_accuracy test_baseline test_studio test_stability
# one log per thing that `make test` runs: a test, a test in double, an example
# (SKIP: patterns of those to leave out, as SKIP="%.double example.%")
LOGS = $(filter-out $(SKIP:%=$(BUILD)/log/%),$(TESTS:%=$(BUILD)/log/%) \
       $(patsubst %,$(BUILD)/log/%.double,$(filter-out $(FLOAT_ONLY),$(TESTS))) $(EXAMPLES:%=$(BUILD)/log/example.%))

.DELETE_ON_ERROR:
.SECONDARY:
.PHONY: all run test gallery bench charts matrix clean help FORCE

all: $(EXAMPLES:%=$(BUILD)/examples/%)
	@echo "the examples are in $(BUILD)/examples/; make help says what else there is"

run: $(BUILD)/examples/$(RUN)
	$(BUILD)/examples/$(RUN)

# -k and the second make: a test that does not compile is counted as failed, and the others still run.
test:
	@rm -rf $(BUILD)/log
	@$(MAKE) -k --no-print-directory $(LOGS) || true
	@sh tests/run.sh sum $(LOGS)

gallery: $(EXAMPLES:%=gallery-%)
gallery-%: $(BUILD)/examples/% FORCE
	$< --quiet

bench: $(BENCH:%=$(BUILD)/bench/%.csv)

charts:
	@sh tests/run.sh charts $(BUILD)/bench $(BUILD)/charts

matrix:
	@CFLAGS= sh tests/matrix.sh $(BUILD)/matrix

clean:
	rm -rf $(BUILD)

help:
	@sed -n '/^#/!q; s/^# \{0,1\}//p' Makefile

# Programs. The old one goes first, so that none is run in place of one that does not compile.

$(BUILD)/examples/%: examples/%.c $(HEADERS)
	@mkdir -p $(@D) && rm -f $@
	$(COMPILE) -o $@ $< -lm

$(BUILD)/tests/%: tests/%.c $(HEADERS)
	@mkdir -p $(@D) && rm -f $@
	$(COMPILE) -o $@ $(filter %.c,$^) -lm

$(BUILD)/tests/%.double: tests/%.c $(HEADERS)
	@mkdir -p $(@D) && rm -f $@
	$(COMPILE) -DPERI_DOUBLE -o $@ $(filter %.c,$^) -lm

$(BUILD)/tests/test_headers $(BUILD)/tests/test_headers.double: tests/unit2.c

$(BUILD)/bench/%: tests/bench/%.c $(HEADERS)
	@mkdir -p $(@D) && rm -f $@
	$(COMPILE) -o $@ $< -lm

# The Cholesky benchmark has peri in both precisions, and the peers that are installed.
installed = $(shell $(1) -E -include $(2) /dev/null >/dev/null 2>&1 && echo yes)
CHOLMOD = $(call installed,$(CC) -x c,suitesparse/cholmod.h)
EIGEN = $(call installed,$(CXX) -x c++,eigen3/Eigen/SparseCholesky)

$(BUILD)/bench/cholesky: tests/bench/cholesky.c $(wildcard tests/bench/cholesky/*) $(HEADERS)
	@mkdir -p $(@D) && rm -f $@ $@.*.o
	$(COMPILE) -c -o $@.float.o tests/bench/cholesky/peri.c
	$(COMPILE) -c -o $@.double.o -DPERI_DOUBLE tests/bench/cholesky/peri.c
	$(COMPILE) -c -o $@.problem.o tests/bench/cholesky/problem.c
	$(if $(CHOLMOD),$(COMPILE) -c -o $@.cholmod.o tests/bench/cholesky/cholmod.c)
	$(if $(EIGEN),$(CXX) $(CFLAGS) -DNDEBUG -c -o $@.eigen.o tests/bench/cholesky/eigen.cpp)
	$(COMPILE) -c -o $@.main.o $(CHOLMOD:yes=-DBENCH_CHOLMOD) $(EIGEN:yes=-DBENCH_EIGEN) $<
	$(if $(EIGEN),$(CXX),$(CC)) $(CFLAGS) -o $@ $@.*.o $(if $(CHOLMOD),-lcholmod -ldl) -lm

# The benchmark of speed against accuracy has peri in both precisions, other methods, and Bullet where it is installed.
BULLET_AT = /usr/include/bullet
BULLET = $(call installed,$(CXX) -x c++ -isystem $(BULLET_AT),BulletSoftBody/btDeformableMultiBodyDynamicsWorld.h)
$(BUILD)/bench/accuracy: tests/bench/accuracy.c $(wildcard tests/bench/accuracy/* tests/baseline/*) $(HEADERS)
	@mkdir -p $(@D) && rm -f $@ $@.*.o
	$(COMPILE) -c -o $@.float.o tests/bench/accuracy/peri.c
	$(COMPILE) -c -o $@.double.o -DPERI_DOUBLE tests/bench/accuracy/peri.c
	$(COMPILE) -c -o $@.baseline.o tests/bench/accuracy/baseline.c
	$(if $(BULLET),$(CXX) $(CFLAGS) -w -isystem $(BULLET_AT) -c -o $@.bullet.o tests/bench/accuracy/bullet.cpp)
	$(COMPILE) -c -o $@.main.o $(BULLET:yes=-DBENCH_BULLET) $<
	$(if $(BULLET),$(CXX),$(CC)) $(CFLAGS) -o $@ $@.*.o \
	    $(if $(BULLET),-lBulletSoftBody -lBulletDynamics -lBulletCollision -lLinearMath) -lm

# A benchmark is told where its table goes and how long it may take; it prints one for people.
$(BUILD)/bench/%.csv: $(BUILD)/bench/% FORCE
	$< $@ $(SIZE)

# Runs. They end well whatever the program says: the sum is made of the logs.

$(BUILD)/log/example.%: $(BUILD)/examples/%
	@sh tests/run.sh example $@ $< --check --quiet

$(BUILD)/log/%: $(BUILD)/tests/%
	@sh tests/run.sh test $@ $<
