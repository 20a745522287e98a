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
seconds(v) = real(v) < 1 ? sprintf("1/%.0f", 1 / real(v)) : v
start = "plane line point mirror shuffle"
power(v) = real(v) >= 1000 || real(v) < 0.001 ? sprintf("1e%.0f", log10(real(v))) : v
xlabels(m, v) = m eq "collapse" ? word(start, int(v)) : m eq "modulus" || m eq "mass" || m eq "contact" ? power(v) : v
ylabels(m, v) = m eq "stretch" || m eq "section" || m eq "removed" ? v : seconds(v)
xname(m) = m eq "modulus" ? "Young's modulus, Pa" : m eq "poisson" ? "Poisson's ratio" : \
    m eq "stretch" ? "ratio along x" : m eq "mass" ? "density, tip / rest" : \
    m eq "contact" ? "density, upper / lower" : m eq "collapse" ? "begun as" : \
    m eq "section" ? "rows" : "share removed"
yname(m) = m eq "stretch" ? "ratio along y" : m eq "section" ? "layers" : m eq "removed" ? "horizon, d" : "time step, s"
says(m) = m eq "modulus" ? "a cantilever let go" : m eq "poisson" ? "a bar gripped at 1.1 times its length" : \
    m eq "stretch" ? "a cube whose surface is pulled and pressed" : m eq "mass" ? "a cantilever with a denser tip" : \
    m eq "contact" ? "a cube carries a denser cube (no baseline has contact)" : \
    m eq "collapse" ? "a cube out of shape" : m eq "section" ? "thin bars pulled" : \
    "a cube without some of its particles (baselines have 6, 18 or 26 neighbours, tetrahedra want another mesh)"
measure(m) = m eq "stretch" ? "% of a spacing, of ours also of the stress" : \
    m eq "collapse" || m eq "removed" ? "% of a spacing" : "%"
legend = "green right    yellow wrong by more than 10 %    red lost: 100 % or more; x: failed or flew off    \
* most steps ran out of iterations (red, if wrong as well)    grey has no part in it"
set palette defined (0 "#6cc47c", 1 "#f6d860", 2 "#e8776b", 3 "#d9d9d9")
set cbrange [0:3]
unset colorbox
unset key
set border lw 0.5
set tics scale 0 nomirror
set style fill solid border lc rgb "#ffffff"
colour(s) = s eq "green" ? 0 : s eq "yellow" ? 1 : s eq "red" ? 2 : 3

# The number in a cell: with a decimal where rounding would hide on which side of 10 % it is, with a star where the
# error alone would be another colour.
percent(e) = abs(e - 0.1) < 0.005 ? sprintf("%.1f", 100 * e) : sprintf("%.0f", 100 * e)
star(s, e) = (s eq "yellow" && e <= 0.1) || (s eq "red" && e < 1 && starred) ? "*" : ""
text(s, error, e) = s eq "none" ? "" : error eq "inf" || e >= 9.99 ? "x" : percent(e).star(s, e)

# One panel: map m, key_ "method,solver" (blanks as _), of the lists xs and ys.
xtics(i) = sprintf("'%s' %d", xlabels(m, word(xs, i)), i).(i < words(xs) ? ", ".xtics(i + 1) : "")
ytics(i) = sprintf("'%s' %d", ylabels(m, word(ys, i)), i).(i < words(ys) ? ", ".ytics(i + 1) : "")
panel = 'set xrange [0.5:words(xs) + 0.5]; set yrange [0.5:words(ys) + 0.5]; starred = m ne "collapse"; \
    if (ticked) { eval "set xtics offset 0,".lift." (".xtics(1).")" } else { set format x ""; set xtics () }; \
    eval "set ytics offset 0.6,0 (".ytics(1).")"; want = plain(key_); \
    plot csv using (strcol(1) eq m && strcol(2).",".strcol(3) eq want ? rank(strcol(4), xs) : NaN):\
        (rank(strcol(5), ys)):(0.5):(0.5):(colour(strcol(6))) with boxxyerror lc palette, \
        csv using (strcol(1) eq m && strcol(2).",".strcol(3) eq want ? rank(strcol(4), xs) : NaN):\
        (rank(strcol(5), ys)):(text(strcol(6), strcol(7), column(7))) with labels font ",".small'

maps = lists("$1", "$1 != \"elements\"")
ticked = 1
lift = "0.4"
do for [m in maps] {
    keys = lists("$2 \",\" $3", of(m))
    xs = sorted("$4", of(m))
    ys = sorted("$5", of(m))
    rows = (words(keys) + 4) / 5
    tall = 95 + rows * (70 + 26 * (words(ys) < 3 ? 3 : words(ys)))
    set terminal pngcairo size 1750,tall font ",11"
    set output png[1:strlen(png) - 4]."-".m.png[strlen(png) - 3:]
    small = words(xs) > 7 ? 8 : 9
    set multiplot layout rows,5 margins 0.035,0.99,45.0 / tall,1 - 95.0 / tall spacing 0.032,65.0 / tall \
        title m.": ".says(m).". Across: ".xname(m)."; up: ".yname(m)."; number: error in ".measure(m)."\n".legend \
        font ",12"
    do for [key_ in keys] {
        set title both(key_) offset 0,-0.7
        eval panel
    }
    unset multiplot
}

# The sheet: a row for each method, a column for each map.
ours = "correspondence_neo-Hookean,auto stretch_linear,auto projective,auto"
theirs = lists("$2 \",\" $3", "$3 == \"own\" && $1 == \"modulus\"")
who = ours." ".theirs
broken(s) = system("echo '".s."' | sed 's/,.*//' | tr '_ ' '\\n\\n'")
shown = ""
do for [m in "modulus poisson stretch mass collapse section removed"] { if (strstrt(maps, m)) { shown = shown." ".m } }
n = words(shown)
wide = 175 + 200 * n
tall = 200 + 118 * words(who)
set terminal pngcairo size wide,tall font ",11"
set output png
set tics font ",9"
set xtics rotate by 45 right
lift = "0"
set multiplot layout words(who),n margins 175.0 / wide,1 - 12.0 / wide,80.0 / tall,1 - 105.0 / tall \
    spacing 52.0 / wide,14.0 / tall title "The stability atlas: ours (first three), and what one would take instead; \
number: error in %\n".legend font ",12"
do for [key_ in who] {
    ticked = key_ eq word(who, words(who))
    do for [m in shown] {
        xs = sorted("$4", of(m))
        ys = sorted("$5", of(m))
        set title key_ eq word(who, 1) ? "{/:Bold ".m."}\n".yname(m)." (up)" : "" offset 0,-0.5
        set xlabel ticked ? xname(m) : "" offset 0,0
        small = words(xs) > 6 || words(ys) > 5 ? 6 : 9
        unset label
        if (m eq word(shown, 1)) {
            set label 1 broken(key_) at graph -0.34,0.55 right
        }
        eval panel
    }
}
unset multiplot
