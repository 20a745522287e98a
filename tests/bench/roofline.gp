# Share of the STREAM triad that each loop reaches, and what stops it. csv and png are given.
set datafile separator ","
set terminal pngcairo size 1300,760
set output png
set style fill solid 0.8 noborder
set boxwidth 0.7
set yrange [] reverse
set xrange [0:1.35]
set xtics 0.25
set grid x
set xlabel "bytes a second over those of the STREAM triad in the same run"
set arrow from 1, graph 0 to 1, graph 1 nohead lw 2 lc rgb "#999999"
set lmargin 32
plot csv every ::1 using (0.5 * ($7 > 1.3 ? 1.3 : $7)):0:(0.5 * ($7 > 1.3 ? 1.3 : $7)):(0.35):yticlabels(1) \
         with boxxyerror lc rgb "#3b7ea1" notitle, \
     csv every ::1 using ($7 > 0.45 ? 0.01 : $7 + 0.01):0:(sprintf("%.0f %%: %s", 100 * $7, strcol(9))) \
         with labels left font ",9" notitle
