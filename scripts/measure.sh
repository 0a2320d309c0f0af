#!/usr/bin/env bash
# Measures everything on the adapter of this machine: see `scripts/measure.sh --help`.
set -euo pipefail
root=$(cd -- "$(dirname -- "${BASH_SOURCE[0]}")/.." && pwd)

usage() {
    cat <<'END'
Measures what accuracy costs, and runs the hard cases, on the adapter of this machine.

usage: scripts/measure.sh --pack DIR
       scripts/measure.sh [--quick] [--bin DIR] [--work DIR] [--out DIR]

  --pack DIR  build, and put the stripped programs `skyline` and `tests` into DIR, to be carried to
              a machine that has the adapter and neither a network nor Rust; nothing is measured
  --quick     minutes rather than hours
  --bin DIR   the programs from there; else they are built first
  --work DIR  where the report is made; a run that was cut off goes on there [default: out/measure]
  --out DIR   where tables go, in a directory with the adapter's name [default: docs/benchmarks]

Needs a Vulkan driver. Writes OUT/<adapter>/: README.md, a table for each effect, results.csv,
hard_cases.txt. The page with everything is WORK/index.html.
END
}
die() {
    printf 'measure: %s\n' "$*" >&2
    exit 2
}

quick=()
pack=
bin=
work=$root/out/measure
out=$root/docs/benchmarks
while [ $# -gt 0 ]; do
    case $1 in
        -h | --help)
            usage
            exit 0
            ;;
        --quick) quick=(--quick) ;;
        --pack | --bin | --work | --out)
            if [ -z "${2-}" ]; then die "$1 needs a directory"; fi
            case $1 in
                --pack) pack=$2 ;;
                --bin) bin=$2 ;;
                --work) work=$2 ;;
                --out) out=$2 ;;
            esac
            shift
            ;;
        *) die "unknown argument $1 (see --help)" ;;
    esac
    shift
done

# build DIR: the programs, stripped, into DIR.
build() {
    local tests
    # shellcheck source=scripts/setup.sh
    . "$root/scripts/setup.sh"
    skyline_setup
    mkdir -p "$1"
    # Cargo says on stderr where each test program is, and builds the command beside it.
    tests=$(cd "$root" && cargo test --locked --all-features --no-run 2>&1 | tee /dev/stderr |
        sed -n 's/.*Executable tests\/main.rs (\(.*\))$/\1/p')
    [ -n "$tests" ] || die "cargo built no tests"
    case $tests in /*) ;; *) tests=$root/$tests ;; esac
    strip -o "$1/tests" "$tests"
    strip -o "$1/skyline" "$(dirname -- "$tests")/../skyline"
}

if [ -n "$pack" ]; then
    build "$pack"
    printf 'measure: programs are in %s\n' "$pack" >&2
    exit 0
fi
if [ -z "$bin" ]; then
    bin=$root/out/bin
    build "$bin"
fi
for program in skyline tests; do
    [ -x "$bin/$program" ] || die "$bin/$program is not there: make it with --pack"
done
if [ -z "${XDG_RUNTIME_DIR-}" ]; then
    XDG_RUNTIME_DIR=$(mktemp -d)
    export XDG_RUNTIME_DIR
fi

mkdir -p "$work"
"$bin/skyline" accuracy all "${quick[@]}" --out "$work" >"$work/summary.json"

# The adapter's name as that of a directory.
adapter=$(sed -n 's/^  "adapter": "\(.*\)",$/\1/p' "$work/summary.json" | head -n 1)
adapter=${adapter%%;*}
[ -n "$adapter" ] || die "no adapter in $work/summary.json"
name=$(printf '%s' "$adapter" | tr '[:upper:]' '[:lower:]' | sed 's/[^a-z0-9]\{1,\}/_/g; s/^_//; s/_$//')
place=$out/$name
mkdir -p "$place"

for part in "$work"/*/; do
    part=${part%/}
    [ -r "$part/table.md" ] || continue
    { printf '# %s\n\n' "$(basename -- "$part")" && cat "$part/table.md"; } >"$place/$(basename -- "$part").md"
done
cp "$work/results.csv" "$place/results.csv"

verdict=passed
"$bin/tests" hard_cases --nocapture >"$place/hard_cases.txt" 2>&1 || verdict=FAILED
cases=$(grep '^test result:' "$place/hard_cases.txt" | tail -n 1) || cases='no result'

{
    printf '# %s\n\n' "$adapter"
    # shellcheck disable=SC2016 # the backquotes are Markdown
    printf 'Made on %s with `scripts/measure.sh%s`.\n' "$(date -u +%F)" "${quick[0]:+ ${quick[0]}}"
    # shellcheck disable=SC2016
    printf 'Hard cases %s: `%s`.\n\n' "$verdict" "$cases"
    for table in "$place"/*.md; do
        [ "$(basename -- "$table")" = README.md ] || printf -- '- [%s](%s)\n' "$(basename -- "$table" .md)" "$(basename -- "$table")"
    done
    printf -- '- [every figure](results.csv)\n'
} >"$place/README.md"
printf 'measure: %s\nmeasure: the page is %s\n' "$place" "$work/index.html" >&2
[ "$verdict" = passed ]
