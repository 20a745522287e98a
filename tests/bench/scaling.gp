# Time a particle of every phase against the number of particles, and bytes a particle. csv and png are given.
set datafile separator ","
set terminal pngcairo size 1300,620
set output png
set colorsequence podo
set logscale xy
set autoscale xfix
set grid
set xlabel "particles"
set key outside bottom center horizontal maxcols 3 samplen 2
row(what, phase, c) = strcol(1) eq what && strcol(2) eq phase ? column(c) : NaN
solid = "'creation and neighbours' 'local step; lattice' 'local step; lockstep' 'Chebyshev sweep' 'two levels: transfer'"
factors = "'two levels: apply' 'two levels: factor' 'Cholesky: solve' 'Cholesky: factor'"
bytes = "'bytes: world; lattice' 'bytes: world; lockstep' 'bytes: two levels' 'bytes: Cholesky'"
set multiplot layout 1,2
set title "us a particle, one thread: flat is linear"
plot for [p in solid] csv every ::1 using 3:(row("size", p, 5)) with linespoints lw 2 title p, \
     for [p in factors] csv every ::1 using 3:(row("size", p, 5)) with linespoints dt 2 title p
set title "bytes a particle, 26 neighbours, float"
set yrange [100:*]
plot for [p in bytes] csv every ::1 using 3:(row("bytes", p, 5)) with linespoints lw 2 title p
unset multiplot
