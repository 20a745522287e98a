# tests/bench/accuracy.gp - speed against accuracy, a panel a scene. NAME.png: the larger of the errors to the continuum
# and of the step; NAME.solver.png: what the solver leaves. Colour: model. Point: solver, filled under L-BFGS, open
# without. Grey crosses: other methods (tests/baseline); black pluses: Bullet. Black line: the front of all; coloured
# lines: the fronts of the models. Rows come sorted by time, so that lines run to the right. Errors above 500 % are not
# drawn.
set datafile separator ","
set datafile missing NaN
set terminal pngcairo size 2000,1420 font ",15"
set output png
set logscale xy
set format y "%g %%"
set format x "%g"
set grid back lt 1 lc rgb "#d8d8d8" lw 0.7
set xtics (1, 3, 10, 30, 100, 300, 1000, 3000, 10000, 100000)
set ytics add (0.2, 0.5, 2, 5, 20, 50, 200, 500)
set autoscale xfix
set autoscale yfix
set offsets graph 0.04, graph 0.04, graph 0.04, graph 0.04
scenes = system("tail -n +2 '".csv."' | cut -d, -f1 | uniq | tr '\\n' ' '")    # those that were run
models = "'correspondence' 'stretch B1/B1' 'stretch A1/A1' 'projective'"
solvers = "'Cholesky' 'two levels' 'Jacobi' 'Chebyshev' 'position-based'"
colours = "#1f6fb4 #2a9d4a #e08a00 #c0392b"
full = "7 5 9 11 13"
open = "6 4 8 10 12"
point(solver, lbfgs) = int(word(lbfgs eq "on" ? full : open, solver))
is(name, text) = name eq text
error(c) = strlen(strcol(c)) && column(c) <= 5 ? 100 * column(c) : NaN
of(scene, model, solver, lbfgs, c) = is(strcol(1), scene) && is(strcol(2), model) && is(strcol(3), solver) && \
    is(strcol(4), lbfgs) ? error(c) : NaN
other(scene, bullet, c) = is(strcol(1), scene) && is(strcol(3), "") && \
    (strstrt(strcol(2), "Bullet") == 1) == bullet ? error(c) : NaN
front(scene, model, which, c) = is(strcol(1), scene) && (model eq "" || is(strcol(2), model)) && \
    strstrt(strcol(16), which) ? error(c) : NaN
against(scene) = scene eq "fall" ? "a fine run" : "finite elements"

# The key stands under the last panel of a page.
key = "row(y) = 0.01 + 0.02 * y; \
    do for [m = 1:4] { \
        set label m at screen 0.05 + 0.11 * (m - 1), row(1.2) word(models, m) point pt 5 ps 2 \
            lc rgb word(colours, m) offset 1,0 \
    } ; \
    do for [s = 1:5] { \
        set label 4 + s at screen 0.05 + 0.11 * (s - 1), row(0.2) word(solvers, s) point pt point(s, 'on') ps 1.6 \
            offset 1,0 \
    } ; \
    set label 10 at screen 0.62, row(0.2) 'open: without L-BFGS' point pt 6 ps 1.6 offset 1,0; \
    set label 11 at screen 0.77, row(0.2) 'black line: front of all'"
key_of_others = "set label 12 at screen 0.5, row(1.2) 'other methods' point pt 2 ps 1.6 lc rgb '#777777' offset 1,0; \
    set label 13 at screen 0.62, row(1.2) 'Bullet' point pt 1 ps 1.6 lw 2 lc rgb 'black' offset 1,0; \
    set label 14 at screen 0.77, row(1.2) 'coloured lines: fronts of the models'"

set multiplot layout 2,3 margins 0.05,0.99,0.105,0.97 spacing 0.05,0.085
unset key
set xlabel "ms of processor time a simulated second" offset 0,0.6
do for [scene in scenes] {
    set title scene.": error to ".against(scene).", or of the step" offset 0,-0.6
    if (scene eq word(scenes, words(scenes))) { eval key; eval key_of_others }
    plot for [m = 1:4] csv every ::1 using 10:(front(scene, word(models, m), "model", 15)) with steps lw 1.5 \
             lc rgb word(colours, m), \
         for [m = 1:4] for [s = 1:5] for [l in "on off"] csv every ::1 \
             using 10:(of(scene, word(models, m), word(solvers, s), l, 15)) with points ps 1.1 \
             pt point(s, l) lc rgb word(colours, m), \
         csv every ::1 using 10:(other(scene, 0, 15)) with points ps 1.1 pt 2 lc rgb "#777777", \
         csv every ::1 using 10:(other(scene, 1, 15)) with points ps 1.3 pt 1 lw 2 lc rgb "black", \
         csv every ::1 using 10:(front(scene, "", "all", 15)) with steps lw 3 lc rgb "black"
}
unset multiplot
unset label

set ytics autofreq
set output png[1:strlen(png) - 4].".solver".png[strlen(png) - 3:]
set multiplot layout 2,3 margins 0.06,0.99,0.105,0.97 spacing 0.06,0.085
do for [scene in scenes] {
    set title scene.": solver's error (same particles, step)" offset 0,-0.6
    if (scene eq word(scenes, words(scenes))) { eval key }
    plot for [m = 1:4] for [s = 1:5] for [l in "on off"] csv every ::1 \
             using 10:(of(scene, word(models, m), word(solvers, s), l, 12)) with points ps 1.1 \
             pt point(s, l) lc rgb word(colours, m), \
         csv every ::1 using 10:(front(scene, "", "solver", 12)) with steps lw 3 lc rgb "black"
}
unset multiplot
