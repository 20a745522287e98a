#!/bin/sh
# tests/run.sh - what `make test` and `make charts` do beyond compiling.
#
#   run.sh test LOG PROGRAM            runs a test program into LOG; its last line is "N passed, N failed"
#   run.sh example LOG PROGRAM ARGS    runs an example: one test, passed when it exits with 0
#   run.sh sum LOG...                  adds the logs up; one that is missing did not compile
#   run.sh charts FOLDER OUT           draws FOLDER/*.csv as OUT/*.png and OUT/*.svg

# A program's lines come out in one piece at its end, so that `make -j` does not mix them.
run() {
    kind=$1 log=$2
    shift 2
    mkdir -p "$(dirname "$log")"
    "$@" >"$log.part" 2>&1
    status=$?
    tally=$(grep -E '^[0-9]+ passed, [0-9]+ failed$' "$log.part" | tail -n 1)
    if [ "$kind" = example ]; then
        tally="1 passed, 0 failed"
        [ $status -eq 0 ] || tally="0 passed, 1 failed"
    elif [ -z "$tally" ]; then
        echo "FAIL $(basename "$log") ended early with exit code $status" >>"$log.part"
        tally="$(grep -c '^ok ' "$log.part") passed, $(grep -c '^FAIL ' "$log.part") failed"
    elif [ $status -ne 0 ] && [ "${tally#*, }" = "0 failed" ]; then
        echo "FAIL $(basename "$log") passed its tests but ended with exit code $status" >>"$log.part"
        tally="${tally%%,*}, 1 failed"
    fi
    echo "-- $(basename "$log")"
    grep -vE '^[0-9]+ passed, [0-9]+ failed$' "$log.part"
    echo "$tally" >>"$log.part"
    mv "$log.part" "$log"
}

sum() {
    passed=0 failed=0 names=
    for log in "$@"; do
        if [ -f "$log" ]; then
            tally=$(tail -n 1 "$log")
        else
            tally="0 passed, 1 failed"
            echo "FAIL $(basename "$log") does not compile"
        fi
        bad=${tally#* passed, }
        bad=${bad% failed}
        passed=$((passed + ${tally%% *}))
        failed=$((failed + bad))
        [ "$bad" -eq 0 ] || names="$names $(basename "$log")"
    done
    [ -z "$names" ] || echo "failures in:$names"
    echo "$passed passed, $failed failed"
    [ $failed -eq 0 ] && [ $passed -gt 0 ]
}

# draw SCRIPT CSV IMAGE: gnuplot warns of every series that has no point; that a table lacks some rows is no news.
draw() {
    gnuplot -e "csv='$2'; png='$3'" "$1" 2>"$3.said"
    status=$?
    grep -v 'warning: Skipping data file with no valid points' "$3.said" >&2
    rm -f "$3.said"
    return $status
}

# tests/bench/NAME.gp draws NAME.csv where it exists (it finds its files in csv and png); else every column but the
# first by row, which the first one names. Scripts draw with pngcairo; the same with another terminal makes the SVG.
charts() {
    if ! command -v gnuplot >/dev/null 2>&1; then
        echo "gnuplot not found: apt-get install gnuplot-nox"
        return 0
    fi
    mkdir -p "$2"
    for csv in "$1"/*.csv; do
        [ -f "$csv" ] || { echo "no tables in $1: make bench first"; return 1; }
        name=$(basename "$csv" .csv)
        script=tests/bench/$name.gp
        if [ ! -f "$script" ]; then
            script=$2/default.gp
            cat >"$script" <<'GNUPLOT'
set datafile separator ","
set terminal pngcairo size 900,600
set output png
stats csv using 0 skip 1 nooutput
set key autotitle columnhead outside
set xtics rotate
set logscale y
plot for [c = 2:STATS_columns] csv using 0:c:xticlabels(1) with linespoints
GNUPLOT
        fi
        draw "$script" "$csv" "$2/$name.png" || { echo "$csv: not drawn"; continue; }
        sed 's/set terminal pngcairo/set terminal svg background "#ffffff"/' "$script" >"$2/svg.gp"
        draw "$2/svg.gp" "$csv" "$2/$name.svg" || continue
        echo "wrote $2/$name.png $2/$name.svg"
    done
    rm -f "$2"/*.gp
}

command=$1
shift
case $command in
test | example) run "$command" "$@" ;;
sum) sum "$@" ;;
charts) charts "$@" ;;
*)
    echo "run.sh: test, example, sum or charts, not '$command'" >&2
    exit 2
    ;;
esac
