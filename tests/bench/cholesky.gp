# tests/bench/cholesky.gp - times of the solvers against the number of particles: cubes above, sheets below, horizon 2.
set datafile separator ","
set datafile missing NaN # so that lines run on over the rows of other solvers
set terminal pngcairo size 1500,900
set output png
set colorsequence podo
set logscale xy
set autoscale xfix
set grid
set key bottom right Left reverse samplen 1.5 font ",8"
set xlabel "particles"
at(shape, solver, precision, column) = strcol(1) eq shape && strcol(2) eq "2.00" && strcol(4) eq solver && \
    strcol(5) eq precision && strlen(strcol(column)) ? column(column) : NaN
peers = "'CHOLMOD supernodal METIS' 'CHOLMOD supernodal AMD' 'CHOLMOD simplicial AMD' 'Eigen LLT AMD'"
set multiplot layout 2,3
do for [shape in "cube sheet"] {
    do for [c = 8:10] {
        set title shape.", ".word("analyse refactor solve3", c - 7).", ms, one thread"
        plot for [p in "float double"] csv every ::1 using 3:(at(shape, "peri", p, c)) with linespoints lw 2 \
            title "peri ".p, for [s in peers] csv every ::1 using 3:(at(shape, s, "double", c)) with linespoints title s
        unset key # the first chart's is for all
    }
}
unset multiplot
