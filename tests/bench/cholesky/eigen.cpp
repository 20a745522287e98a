// tests/bench/cholesky/eigen.cpp - Eigen's SimplicialLLT for the Cholesky benchmark, as it comes: lower half, AMD.
#include "solver.h"
#include <eigen3/Eigen/SparseCholesky>

namespace {

typedef Eigen::SparseMatrix<double> sparse;

// To see the column counts and the arrays that Eigen keeps to itself.
struct llt : Eigen::SimplicialLLT<sparse> {
    double operations() const {
        Eigen::ArrayXd length = m_nonZerosPerCol.cast<double>().array() + 1;
        return length.square().sum();
    }
    double entries() const { return m_nonZerosPerCol.cast<double>().sum() + double(m_nonZerosPerCol.size()); }
    // L, its two permutations, the elimination tree and the column counts
    double bytes() const {
        double n = double(m_nonZerosPerCol.size());
        return entries() * (sizeof(double) + sizeof(int)) + (5 * n + 1) * sizeof(int);
    }
};

struct state {
    sparse a;
    llt solver;
    Eigen::MatrixXd b, x;
};

// Column i of the lower half is what stands right of the diagonal in row i of A.
void *start(int, const problem *p) {
    state *s = new state;
    Eigen::VectorXi count(p->n);
    for (int i = 0; i < p->n; i++) count[i] = p->row[i + 1] - p->row[i] + 1;
    s->a.resize(p->n, p->n);
    s->a.reserve(count);
    for (int i = 0; i < p->n; i++) {
        s->a.insert(i, i) = 0;
        for (int k = p->row[i]; k < p->row[i + 1]; k++)
            if (p->col[k] > i) s->a.insert(p->col[k], i) = 0;
    }
    s->a.makeCompressed();
    s->b.resize(p->n, 3);
    s->x.resize(p->n, 3);
    return s;
}

int analyse(void *of) {
    state *s = static_cast<state *>(of);
    s->solver.analyzePattern(s->a);
    return 1;
}

void load(void *of, const problem *p) {
    double *x = static_cast<state *>(of)->a.valuePtr();
    for (int i = 0; i < p->n; i++) {
        *x++ = p->diagonal[i];
        for (int k = p->row[i]; k < p->row[i + 1]; k++)
            if (p->col[k] > i) *x++ = p->value[k];
    }
}

int factor(void *of) {
    state *s = static_cast<state *>(of);
    s->solver.factorize(s->a);
    return s->solver.info() == Eigen::Success;
}

void set(void *of, const double *b) {
    state *s = static_cast<state *>(of);
    for (int i = 0; i < s->b.rows(); i++)
        for (int c = 0; c < 3; c++) s->b(i, c) = *b++;
}

void solve(void *of) {
    state *s = static_cast<state *>(of);
    s->x = s->solver.solve(s->b);
}

void get(const void *of, double *x) {
    const state *s = static_cast<const state *>(of);
    for (int i = 0; i < s->x.rows(); i++)
        for (int c = 0; c < 3; c++) *x++ = s->x(i, c);
}

facts ask(const void *of) {
    const llt &l = static_cast<const state *>(of)->solver;
    facts f = {l.entries(), l.operations(), l.bytes()};
    return f;
}

void stop(void *of) { delete static_cast<state *>(of); }

} // namespace

const solver bench_eigen_llt = {"Eigen LLT AMD", "double", 0, start, analyse, load, factor, set, solve, get, ask, stop};
