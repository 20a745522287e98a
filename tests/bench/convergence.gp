# Residual over time: the whole step on the left, one global step on the right. csv and png are given.
set datafile separator ","
set terminal pngcairo size 1400,600
set output png
set logscale xy
set format y "10^{%L}"
set xlabel "ms, one thread"
set key bottom left
set multiplot layout 1,2
set title "step: local/global, residual over a particle's weight"
plot for [s in "direct jacobi jacobi+chebyshev position-based direct+l-bfgs"] csv \
    using (strcol(1) eq "step" && strcol(2) eq s ? column(4) : NaN):(column(5)) with linespoints title s
set title "linear: one global step, |b - A x| / |b|"
plot for [s in "direct jacobi jacobi+chebyshev cg+jacobi cg+ic(0) l-bfgs+jacobi"] csv \
    using (strcol(1) eq "linear" && strcol(2) eq s ? column(4) : NaN):(column(5)) with linespoints title s
unset multiplot
