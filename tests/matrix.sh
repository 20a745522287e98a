#!/bin/sh
# tests/matrix.sh [FOLDER] - compiles the headers in every way they promise, all warnings being errors, and looks into
# the objects. The folder (build/matrix) takes sources and objects. A line per case; the last line is
# "N passed, N failed". JOBS cases run at once (2). ONLY=word runs the cases with that word in their name.

cd "$(dirname "$0")/.." || exit 2
here=$(pwd)
dir=${1:-build/matrix}
jobs=${JOBS:-2}
rm -rf "$dir"
mkdir -p "$dir" || exit 2
headers="peri_solver.h peri_material.h peri.h"
flags="-pedantic -Wall -Wextra -Wshadow -Wconversion -Wdouble-promotion -Werror"
# what an example may do and a library may not: set a variable only to show it, write 1.0f where a double is taken
example_flags="-Wno-unused-variable -Wno-unused-but-set-variable -Wno-double-promotion"
# An option, the words its symbols contain, and those of what must stay.
options="PERI_NO_CHOLESKY:cholesky:peri_world_step
PERI_NO_SAMPLING:peri_sample|peri__sample|peri__mesh|peri__lattice:peri_shape_evaluate
PERI_NO_SKINNING:skin:peri_world_step
PERI_NO_DRAW:draw:peri_world_stats"

# -- running ---------------------------------------------------------------------------------------------------------

# Whoever wants to run takes a line out of the pipe, and puts it back at its end.
started=0
mkfifo "$dir/turns"
exec 3<>"$dir/turns"
for turn in $(seq "$jobs"); do echo "$turn" >&3; done

# attempt NAME FUNCTION ARGS: a case; passes when the function does, else its output is shown.
attempt() {
    case $1 in *"$ONLY"*) ;; *) return ;; esac
    started=$((started + 1))
    read -r turn <&3
    (
        title=$1
        case=$dir/case.$started
        shift
        mkdir -p "$case"
        if "$@" >"$case/output" 2>&1; then echo "ok   $title"; else
            echo "FAIL $title"
            head -n 6 "$case/output" | sed 's/^/    /'
        fi >"$case/result"
        cat "$case/result"
        echo "$turn" >&3
    ) &
}

skip() {
    case "skip $1" in *"$ONLY"*) echo "skip $1" ;; esac
}

# unit LINES...: a source; "+HEADER" is an include, everything else a macro.
unit() {
    for line in "$@"; do
        case $line in
        +*) echo "#include \"${line#+}\"" ;;
        *) echo "#define $line" ;;
        esac
    done
}

# Standards by their compilers: g++ and clang++ take the C++ ones.
driver() {
    case $1:$2 in
    gcc:c++*) echo "g++ -x c++" ;;
    clang:c++*) echo "clang++ -x c++" ;;
    *) echo "$1" ;;
    esac
}

# object COMPILER STANDARD OUT SOURCE FLAGS...
object() {
    tool=$(driver "$1" "$2") std=$2 out=$3 source=$4
    shift 4
    # shellcheck disable=SC2086
    $tool -std=$std $flags -I"$here" "$@" -c -o "$out" "$source"
}

# -- cases -----------------------------------------------------------------------------------------------------------

compiles() { # COMPILER STANDARD FLAG LINES...: FLAG may be empty
    cc=$1 cstd=$2 extra=$3
    shift 3
    unit "$@" >"$case/unit.c"
    # shellcheck disable=SC2086
    object "$cc" "$cstd" "$case/unit.o" "$case/unit.c" $extra
}

# What a program calls, by header; the call forces the link.
caller() {
    case $1 in
    peri_solver.h) echo 'int main(void) { peri_cholesky *f; peri_error e; return peri_cholesky_create(NULL, NULL, NULL, &f, &e) == PERI_OK; }' ;;
    peri_material.h) echo 'int main(void) { peri_material m = peri_material_linear(1, 0, 1); return peri_material_check(&m, NULL) != PERI_OK; }' ;;
    peri.h) echo 'int main(void) { peri_world_def d = peri_default_world_def(); peri_world *w = peri_world_create(&d, NULL); peri_world_destroy(w); return !w; }' ;;
    esac
}

# mixed COMPILER STANDARD_OF_CALLER STANDARD_OF_IMPLEMENTATION HEADER: one of the two is C++.
mixed() {
    { unit "+$4"; caller "$4"; } >"$case/caller.c"
    unit PERI_IMPLEMENTATION "+$4" >"$case/body.c"
    object "$1" "$2" "$case/caller.o" "$case/caller.c" || return 1
    object "$1" "$3" "$case/body.o" "$case/body.c" || return 1
    tool=$(driver "$1" c++11)
    ${tool%% *} -o "$case/program" "$case/caller.o" "$case/body.o" -lm && "$case/program"
}

# precisions COMPILER STANDARD HEADER: two units link and run where both are float or both double; else the linker misses
# the symbol that carries the precision.
precisions() {
    for p in "" PERI_DOUBLE; do
        { unit ${p:+"$p"} "+$3"; caller "$3"; } >"$case/caller$p.c"
        unit ${p:+"$p"} PERI_IMPLEMENTATION "+$3" >"$case/body$p.c"
        for part in caller body; do object "$1" "$2" "$case/$part$p.o" "$case/$part$p.c" || return 1; done
    done
    tool=$(driver "$1" "$2")
    for pair in : PERI_DOUBLE:PERI_DOUBLE PERI_DOUBLE: :PERI_DOUBLE; do
        p=${pair%:*} q=${pair#*:}
        if ${tool%% *} -o "$case/program" "$case/caller$p.o" "$case/body$q.o" -lm >"$case/log" 2>&1; then
            [ "$p" = "$q" ] || { echo "a ${p:-float} caller links with ${q:-float}"; return 1; }
            "$case/program" || { echo "the program with ${p:-float} fails"; return 1; }
        elif [ "$p" = "$q" ] || ! grep -qi "undefined" "$case/log"; then
            cat "$case/log"
            return 1
        fi
    done
}

# -fno-pie keeps constant tables of pointers in read-only sections, where nm can tell them from variables.
for_nm() { # COMPILER STANDARD LINES...
    cc=$1 cstd=$2
    shift 2
    unit "$@" >"$case/unit.c"
    object "$cc" "$cstd" "$case/unit.o" "$case/unit.c" -fno-pie
}

clean_symbols() { # COMPILER STANDARD LINES...: no variables, and nothing external but peri_*
    for_nm "$@" || return 1
    nm "$case/unit.o" | grep -q ' T peri_' || { echo "nm shows no function of peri: is the test right?"; return 1; }
    if nm "$case/unit.o" | grep -E ' [BbCcDdGgSsuVv] '; then echo "these are writable"; return 1; fi
    if nm -g "$case/unit.o" | grep -E ' [A-TV-Zi] ' | grep -vE ' [A-Zi] peri_[a-z0-9]'; then
        echo "these are external"
        return 1
    fi
}

# leaves_out COMPILER STANDARD HEADER ROWS...: with the macro of a row no symbol matches what goes, some match what stays.
leaves_out() {
    occ=$1 ostd=$2 header=$3
    shift 3
    for_nm "$occ" "$ostd" PERI_IMPLEMENTATION "+$header" || return 1
    mv "$case/unit.o" "$case/whole.o"
    for row in "$@"; do
        macro=${row%%:*} rest=${row#*:}
        gone=${rest%%:*} kept=${rest#*:}
        nm "$case/whole.o" | grep -qE "$gone" || { echo "without $macro there is no $gone either"; return 1; }
        for_nm "$occ" "$ostd" "$macro" PERI_IMPLEMENTATION "+$header" || return 1
        nm "$case/unit.o" | grep -qE "$kept" || { echo "$macro takes $kept away too"; return 1; }
        if nm "$case/unit.o" | grep -E "$gone"; then echo "$macro leaves these in"; return 1; fi
        [ "$(wc -c <"$case/unit.o")" -lt "$(wc -c <"$case/whole.o")" ] || { echo "$macro makes nothing smaller"; return 1; }
    done
}

private_symbols() { # COMPILER STANDARD HEADER: with PERI_STATIC nothing is external
    for_nm "$1" "$2" PERI_STATIC PERI_IMPLEMENTATION "+$3" || return 1
    if nm -g "$case/unit.o" | grep -E ' [A-TV-Z] '; then echo "these are external"; return 1; fi
}

# A compile test of a misspelt macro tests nothing: what is tested here, what the headers ask for and what their comments
# list must be the same.
options_agree() {
    echo "$options" | sed 's/:.*//' | sort >"$case/tested"
    grep -hE '^ *# *(if|ifdef|ifndef|elif) ' $headers | grep -o 'PERI_NO_[A-Z0-9_]*' | sort -u >"$case/asked"
    sed -n 's/^ *\(PERI_NO_[A-Z0-9_]*\)  .*/\1/p' $headers | sort -u >"$case/listed"
    diff "$case/tested" "$case/asked" && diff "$case/tested" "$case/listed"
}

macro_is_asked_for() { # MACRO
    grep -qE "^ *# *(if|ifdef|ifndef|elif)\b.*\b$1\b" $headers
}

plain_text() { # HEADER
    bad=0
    if LC_ALL=C grep -n '[^ -~]' "$1"; then echo "not printable ASCII (tab, carriage return, accents)"; bad=1; fi
    if LC_ALL=C awk 'length($0) > 120 { print FILENAME ":" FNR ": " length($0); bad = 1 } END { exit !bad }' "$1"; then
        echo "longer than 120"
        bad=1
    fi
    if grep -n ' $' "$1"; then echo "spaces at the end"; bad=1; fi
    [ -z "$(tail -c 1 "$1")" ] || { echo "no newline at the end"; bad=1; }
    return $bad
}

# The quick start of the header's comment, as a program: up to the first empty line, less the remarks in brackets that
# follow two spaces at the end of a line.
quick_start() { # COMPILER STANDARD HEADER PRECISION
    sed -n '/^ *QUICK START/,/^ *$/p' "$3" | sed '/^ *QUICK START/d; s/   *([^()]*) *$//' >"$case/lines"
    [ "$(grep -c ';' "$case/lines")" -ge 3 ] || { echo "no quick start in $3"; return 1; }
    {
        unit ${4:+"$4"} PERI_IMPLEMENTATION "+$3"
        echo 'int main(void) {'
        cat "$case/lines"
        echo 'return 0; }'
    } >"$case/unit.c"
    cat "$case/lines"
    # shellcheck disable=SC2086
    object "$1" "$2" "$case/unit.o" "$case/unit.c" -O1 $example_flags || return 1
    tool=$(driver "$1" "$2")
    ${tool%% *} -o "$case/program" "$case/unit.o" -lm && "$case/program"
}

# The README's program: its C blocks after the one that includes, inside a main.
readme_start() { # COMPILER STANDARD
    awk '/^```c$/ { in_block = 1; n++; next } /^```$/ { in_block = 0 } in_block && n > 1' README.md >"$case/lines"
    [ "$(grep -c ';' "$case/lines")" -ge 3 ] || { echo "no program in README.md"; return 1; }
    {
        unit PERI_IMPLEMENTATION +peri.h
        echo 'int main(void) {'
        cat "$case/lines"
        echo 'peri_world_destroy(world); return 0; }'
    } >"$case/unit.c"
    # shellcheck disable=SC2086
    object "$1" "$2" "$case/unit.o" "$case/unit.c" -O1 $example_flags || return 1
    tool=$(driver "$1" "$2")
    ${tool%% *} -o "$case/program" "$case/unit.o" -lm && "$case/program"
}

# -- the matrix ------------------------------------------------------------------------------------------------------

for header in $headers; do attempt "$header: ASCII, LF, at most 120 columns" plain_text "$header"; done
attempt "options: tested, asked for and listed are the same" options_agree
for macro in PERI_IMPLEMENTATION PERI_DOUBLE PERI_STATIC PERI_ASSERT; do
    attempt "options: $macro is asked for" macro_is_asked_for $macro
done

compilers=
for cc in gcc clang; do
    if command -v $cc >/dev/null 2>&1; then compilers="$compilers $cc"; else skip "$cc: not installed"; fi
done
[ -n "$compilers" ] || { echo "FAIL no compiler: gcc or clang"; echo "0 passed, 1 failed"; exit 1; }
echo 'int main(void) { return 0; }' >"$dir/empty.c"

for cc in $compilers; do
    standards="c99 c11 c17"
    if command -v "$(driver $cc c++11 | cut -d' ' -f1)" >/dev/null 2>&1; then standards="$standards c++11"; else
        skip "$cc: no C++ compiler beside it"
    fi
    if $cc -fopenmp -o "$dir/empty" "$dir/empty.c" 2>/dev/null; then openmp=-fopenmp; else
        openmp=
        skip "$cc -fopenmp: its library is missing"
    fi
    for std in $standards; do
        for precision in "" PERI_DOUBLE; do
            at="$cc $std${precision:+ $precision}"
            for header in $headers; do
                attempt "$at: $header" compiles $cc $std "" ${precision:+$precision} PERI_IMPLEMENTATION +$header
            done
            case $std in c11 | c17) continue ;; esac # c99 and c++11 stand for both languages from here on
            attempt "$at: all headers, twice, implementation last" compiles $cc $std "" ${precision:+$precision} \
                +peri.h +peri_solver.h +peri_material.h +peri.h PERI_IMPLEMENTATION +peri_solver.h +peri_material.h \
                +peri.h +peri.h +peri_solver.h
            if [ -n "$openmp" ]; then
                attempt "$at: peri.h -fopenmp" compiles $cc $std $openmp ${precision:+$precision} PERI_IMPLEMENTATION \
                    +peri.h
            fi
        done
        for header in $headers; do
            attempt "$cc $std: $header without implementation" compiles $cc $std "" +$header +$header
        done
        attempt "$cc $std: PERI_STATIC leaves nothing external" private_symbols $cc $std peri.h
        attempt "$cc $std: PERI_ASSERT(x) empty" compiles $cc $std "" "PERI_ASSERT(x)" PERI_IMPLEMENTATION +peri.h
    done

    for std in c99 c++11; do
        case " $standards " in *" $std "*) ;; *) continue ;; esac
        for header in $headers; do
            attempt "$cc $std: $header, two units link, of one precision only" precisions $cc $std $header
            attempt "$cc $std: $header with PERI_STATIC" compiles $cc $std "" PERI_STATIC PERI_IMPLEMENTATION +$header
            attempt "$cc $std: quick start of $header" quick_start $cc $std $header ""
            attempt "$cc $std: quick start of $header in double" quick_start $cc $std $header PERI_DOUBLE
        done
        attempt "$cc $std: the program in README.md" readme_start $cc $std
        for precision in "" PERI_DOUBLE; do
            attempt "$cc $std${precision:+ $precision}: no variables, only peri_ is external" \
                clean_symbols $cc $std ${precision:+$precision} PERI_IMPLEMENTATION +peri.h
        done
        attempt "$cc $std: every PERI_NO_ by itself" leaves_out $cc $std peri.h $options
        attempt "$cc $std: PERI_NO_CHOLESKY of peri_solver.h" \
            leaves_out $cc $std peri_solver.h PERI_NO_CHOLESKY:cholesky:peri_lbfgs_apply
        attempt "$cc $std: every PERI_NO_ at once" \
            compiles $cc $std "" $(echo "$options" | sed 's/:.*//') PERI_IMPLEMENTATION +peri.h
        attempt "$cc $std: every PERI_NO_ at once, PERI_STATIC, -O2" \
            compiles $cc $std -O2 $(echo "$options" | sed 's/:.*//') PERI_STATIC PERI_IMPLEMENTATION +peri.h
        attempt "$cc $std: -O2" compiles $cc $std -O2 PERI_IMPLEMENTATION +peri.h
    done
    case $standards in *++*)
        attempt "$cc: a C++11 caller of a C99 implementation" mixed $cc c++11 c99 peri.h
        attempt "$cc: a C99 caller of a C++11 implementation" mixed $cc c99 c++11 peri.h ;;
    esac
done
wait

passed=$(cat "$dir"/case.*/result 2>/dev/null | grep -c '^ok ')
failed=$((started - passed))
echo "$passed passed, $failed failed"
[ "$failed" -eq 0 ] && [ "$passed" -gt 0 ]
