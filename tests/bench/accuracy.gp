# tests/bench/accuracy.gp - speed against accuracy, a scene a column. Above: the larger of the errors to the continuum
# and of the step, below: what the solver leaves. Colour: model. Point: solver, filled under L-BFGS, open without. Grey
# crosses: other methods (tests/baseline). Black line: the front of all; coloured lines: the fronts of the models. Rows
# come sorted by time, so that lines run to the right.
set datafile separator ","
set datafile missing NaN
set terminal pngcairo size 2400,1300 font ",13"
set output png
set logscale xy
set format y "%g"
set format x "%g"
set grid back lt 1 lc rgb "#d8d8d8" lw 0.7
set xtics add (20, 50, 200, 500, 2000, 5000, 20000)
set autoscale xfix
set offsets graph 0.04, graph 0.04, 0, 0
models = "'correspondence' 'stretch B1/B1' 'stretch A1/A1' 'projective'"
solvers = "'Cholesky' 'two levels' 'Jacobi' 'Chebyshev' 'position-based'"
colours = "#1f6fb4 #2a9d4a #e08a00 #c0392b"
full = "7 5 9 11 13"
open = "6 4 8 10 12"
point(solver, lbfgs) = int(word(lbfgs eq "on" ? full : open, solver))
is(name, text) = name eq text
of(scene, model, solver, lbfgs, c) = is(strcol(1), scene) && is(strcol(2), model) && is(strcol(3), solver) && \
    is(strcol(4), lbfgs) && strlen(strcol(c)) ? column(c) : NaN
front(scene, model, which, c) = is(strcol(1), scene) && (model eq "" || is(strcol(2), model)) && \
    strstrt(strcol(16), which) ? column(c) : NaN
set multiplot layout 2,4 margins 0.035,0.99,0.095,0.97 spacing 0.035,0.075
unset key
do for [scene in "swing stretch twist fall"] {
    set title scene.": error to ".(scene eq "fall" ? "a fine run" : "finite elements").", or of the step" offset 0,-0.6
    plot for [m = 1:4] csv every ::1 using 10:(front(scene, word(models, m), "model", 15)) with steps lw 1.5 \
             lc rgb word(colours, m), \
         for [m = 1:4] for [s = 1:5] for [l in "on off"] csv every ::1 \
             using 10:(of(scene, word(models, m), word(solvers, s), l, 15)) with points ps 1.1 \
             pt point(s, l) lc rgb word(colours, m), \
         csv every ::1 using 10:(is(strcol(1), scene) && is(strcol(3), "") ? column(15) : NaN) with points ps 1 \
             pt 2 lc rgb "#777777", \
         csv every ::1 using 10:(front(scene, "", "all", 15)) with steps lw 3 lc rgb "black"
}
set xlabel "ms of processor time a simulated second" offset 0,0.5
do for [scene in "swing stretch twist fall"] {
    set title scene.": solver's error (same particles, step)" offset 0,-0.6
    if (scene eq "fall") { # the key of all panels
        do for [m = 1:4] {
            set label m at screen 0.04 + 0.09 * (m - 1), 0.025 word(models, m) point pt 5 ps 2 \
                lc rgb word(colours, m) offset 1,0
        }
        do for [s = 1:5] {
            set label 4 + s at screen 0.38 + 0.07 * (s - 1), 0.025 word(solvers, s) point pt point(s, "on") ps 1.6 \
                offset 1,0
        }
        set label 10 at screen 0.735,0.025 "open: without L-BFGS" point pt 6 ps 1.6 offset 1,0
        set label 11 at screen 0.835,0.025 "other methods" point pt 2 ps 1.6 lc rgb "#777777" offset 1,0
        set label 12 at screen 0.905,0.025 "black line: front of all"
    }
    plot for [m = 1:4] for [s = 1:5] for [l in "on off"] csv every ::1 \
             using 10:(of(scene, word(models, m), word(solvers, s), l, 12)) with points ps 1.1 \
             pt point(s, l) lc rgb word(colours, m), \
         csv every ::1 using 10:(front(scene, "", "solver", 12)) with steps lw 3 lc rgb "black"
}
unset multiplot
