# The stability atlas: a sheet of all maps, ours under AUTO beside the baselines (png), and one picture a map with every
# method and solver (png without its ending, -MAP.png). A cell's number is its error in percent. csv and png are given.
set datafile separator ","
lists(what, from) = system("awk -F, 'NR > 1 && ".from." {v = ".what."; gsub(/ /, \"_\", v); if (!(v in s)) {s[v] = 1; \
    print v}}' ".csv)
sorted(what, from) = system("awk -F, 'NR > 1 && ".from." {print ".what."}' ".csv." | sort -g -u")
of(m) = "$1 == \"".m."\""
rank(v, list) = sum [i = 1:words(list)] (v eq word(list, i) ? i : 0)
plain(s) = system("echo '".s."' | tr '_' ' '")
both(s) = system("echo '".s."' | sed 's/,own$//; s/_/ /g; s/,/, /'")
first(s) = system("echo '".s."' | sed 's/,.*//; s/_/ /g'")
seconds(v) = real(v) < 1 ? sprintf("1/%.0f", 1 / real(v)) : v
start = "plane line point mirrored shuffled"
power(v) = real(v) >= 1000 ? sprintf("1e%.0f", log10(real(v))) : v
xlabels(m, v) = m eq "collapse" ? word(start, int(v)) : m eq "modulus" || m eq "mass" ? power(v) : v
ylabels(m, v) = m eq "stretch" || m eq "section" || m eq "removed" ? v : seconds(v)
xname(m) = m eq "modulus" ? "Young's modulus, Pa" : m eq "poisson" ? "Poisson's ratio" : \
    m eq "stretch" ? "ratio along x" : m eq "mass" ? "density of the tip over the rest's" : \
    m eq "contact" ? "upper cube's density over the lower's" : m eq "collapse" ? "start" : \
    m eq "section" ? "rows" : "share removed"
yname(m) = m eq "stretch" ? "ratio along y" : m eq "section" ? "layers" : m eq "removed" ? "horizon, d" : "time step, s"
says(m) = m eq "modulus" ? "a cantilever let go" : m eq "poisson" ? "a gripped bar under its weight" : \
    m eq "stretch" ? "a cube whose surface is pulled and pressed" : m eq "mass" ? "a bar carries a denser tip" : \
    m eq "contact" ? "a cube carries a denser cube" : m eq "collapse" ? "a cube out of shape" : \
    m eq "section" ? "thin bars pulled: few neighbours" : "a cube without some of its particles"
set palette defined (0 "#58b368", 1 "#f6d860", 2 "#c9463d")
set cbrange [0:2]
unset colorbox
unset key
set border lw 0.5
set tics scale 0
set style fill solid noborder
colour(s) = s eq "green" ? 0 : s eq "yellow" ? 1 : 2

# One panel: map m, key_ "method,solver" (blanks as _), of the lists xs and ys.
xtics(i) = sprintf("'%s' %d", xlabels(m, word(xs, i)), i).(i < words(xs) ? ", ".xtics(i + 1) : "")
ytics(i) = sprintf("'%s' %d", ylabels(m, word(ys, i)), i).(i < words(ys) ? ", ".ytics(i + 1) : "")
panel = 'set title title offset 0,-0.6; set xrange [0.5:words(xs) + 0.5]; set yrange [0.5:words(ys) + 0.5]; \
    eval "set xtics rotate by 40 right offset 0.3,0.1 (".xtics(1).")"; eval "set ytics (".ytics(1).")"; \
    want = plain(key_); \
    plot csv using (strcol(1) eq m && strcol(2).",".strcol(3) eq want ? rank(strcol(4), xs) : NaN):\
        (rank(strcol(5), ys)):(0.48):(0.46):(colour(strcol(6))) with boxxyerror lc palette, \
        csv using (strcol(1) eq m && strcol(2).",".strcol(3) eq want && strcol(7) ne "inf" && column(7) < 9.99 ? \
        rank(strcol(4), xs) : NaN):(rank(strcol(5), ys)):(sprintf("%.0f", 100 * column(7))) with labels font ",".small'

maps = lists("$1", "$1 != \"elements\"")
do for [m in maps] {
    keys = lists("$2 \",\" $3", of(m))
    xs = sorted("$4", of(m))
    ys = sorted("$5", of(m))
    rows = (words(keys) + 4) / 5
    set terminal pngcairo size 1700,120 + 260 * rows font ",10"
    set output png[1:strlen(png) - 4]."-".m.png[strlen(png) - 3:]
    small = 7
    set multiplot layout rows,5 margins 0.05,0.985,0.11 / (0.4 * rows),1 - 0.25 / rows spacing 0.045,0.36 / rows \
        title m.": ".says(m).". ".xname(m)." (x), ".yname(m)." (y); error in %; green right, yellow wrong by more \
than 10 %, red lost" font ",13"
    do for [key_ in keys] {
        title = both(key_)
        eval panel
    }
    unset multiplot
}

# The sheet.
ours = "correspondence_neo-Hookean,auto stretch_linear,auto projective,auto ".lists("$2 \",\" $3", "$3 == \"own\" && \
$1 == \"modulus\"")
shown = ""
do for [m in "modulus poisson stretch mass collapse section"] { if (strstrt(maps, m)) { shown = shown." ".m } }
set terminal pngcairo size 260 * words(ours),90 + 245 * words(shown) font ",9"
set output png
small = 6
n = words(shown)
set multiplot layout n,words(ours) margins 0.045,0.99,0.05,1 - 0.33 / n spacing 0.028,0.38 / n \
    title "The stability atlas: green right, yellow wrong by more than 10 % (the number), red lost" font ",14"
do for [m in shown] {
    xs = sorted("$4", of(m))
    ys = sorted("$5", of(m))
    do for [key_ in ours] {
        title = first(key_)
        set ylabel key_ eq word(ours, 1) ? m.": ".yname(m) : ""
        set xlabel key_ eq word(ours, 1) ? xname(m) : "" offset 0,0.6
        eval panel
    }
}
unset multiplot
