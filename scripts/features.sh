#!/usr/bin/env bash
# Lints the library and the examples with many sets of the crate's features, so that a game can build any of
# them. Every set is looked at, whatever the one before it gave; the exit status is 0 only if all passed.
#
#   scripts/features.sh          none, each effect alone, all but each, all; the panel where it differs; cli
#   scripts/features.sh --all    every set of the effects, with the panel and without; cli
#   scripts/features.sh --run    none and each effect alone: not lints, but a headless app with all that is built
#
# One check of Bevy serves all. What would start another is named by hand: features that `window` and `panel`
# switch on in crates under Bevy. (Those that the effects' own dependencies switch on are dev-dependencies, too:
# examples are looked at in each set.)
set -euo pipefail
cd "$(dirname -- "${BASH_SOURCE[0]}")/.."
export CARGO_TARGET_DIR="${CARGO_TARGET_DIR:-${XDG_CACHE_HOME:-$HOME/.cache}/bevy_skyline-target}"
# Each set is looked at once.
export CARGO_INCREMENTAL=0

effects=(terrain culling budget interior spherical)

bevy_features=$(sed -n '/^\[features\]/,/^\[dependencies\]/p' Cargo.toml |
    grep -o 'bevy/[a-z0-9_]*' | sort -u | paste -sd,) || true
: "${bevy_features:?scripts/features.sh found no bevy/... features in [features] of Cargo.toml}"
by_hand="$bevy_features,bevy_egui/render"

# join ITEM...: with commas between
join() { (IFS=,; printf '%s' "$*"); }

# Effects without one.
without() {
    local effect rest=()
    for effect in "${effects[@]}"; do
        if [ "$effect" != "$1" ]; then rest+=("$effect"); fi
    done
    join "${rest[@]}"
}

defaults=$(join "${effects[@]}")
run=no
if [ "${1:-}" = --run ]; then run=yes; fi
sets=()
case "${1:-}" in
--all)
    for ((mask = 0; mask < 1 << ${#effects[@]}; mask++)); do
        chosen=()
        for i in "${!effects[@]}"; do
            if ((mask >> i & 1)); then chosen+=("${effects[i]}"); fi
        done
        sets+=("$(join "${chosen[@]}")" "$(join "${chosen[@]}" panel)")
    done
    ;;
'')
    sets+=("" "${effects[@]}")
    for effect in "${effects[@]}"; do sets+=("$(without "$effect")"); done
    sets+=("$defaults")
    # The panel asks only the budget and the cullings for anything of their own.
    sets+=(panel budget,panel culling,panel)
    ;;
--run)
    for effect in "" "${effects[@]}"; do sets+=("window${effect:+,$effect}"); done
    ;;
*)
    printf 'usage: %s [--all | --run]\n' "$0" >&2
    exit 2
    ;;
esac
if [ "${1:-}" != --run ]; then sets+=("$defaults,window" "$defaults,panel,window" cli); fi

# look SET: lints it, or runs it.
look() {
    local features="$by_hand${1:+,$1}" targets=(--lib --examples)
    if [ "$run" = yes ]; then
        # Examples bring what dev-dependencies switch on.
        cargo test --locked --lib --examples --no-default-features --features "$features" \
            plugin:: -- --nocapture
        return
    fi
    # What `cargo test` builds without a word about features: the tests of modules.
    if [ "$1" = "$defaults" ]; then targets=(--all-targets); fi
    cargo clippy --locked "${targets[@]}" --no-default-features --features "$features" -- -D warnings
}

log=$(mktemp)
trap 'rm -f "$log"' EXIT
failed=0
for set in "${sets[@]}"; do
    start=$SECONDS
    verdict=ok
    look "$set" >"$log" 2>&1 || verdict=FAILED
    if [ "$verdict" = FAILED ]; then
        failed=1
        cat "$log"
    fi
    printf '%-6s  %4d s  %s\n' "$verdict" "$((SECONDS - start))" "${set:-none}"
done
printf '%d sets of features looked at in %d s\n' "${#sets[@]}" "$SECONDS"
exit "$failed"
