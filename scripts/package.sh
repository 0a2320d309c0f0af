#!/usr/bin/env bash
# Makes the package that would be published, looks whether it is whole, and builds with it what the README tells a
# newcomer to write: its code, in an empty project.
#
#   scripts/package.sh             with the features of Bevy that the tests are built with, so that Bevy is not
#                                  built again
#   scripts/package.sh --newcomer  with the README's own Cargo.toml, that is with all default features of Bevy: in
#                                  a folder of its own, with what they need (ALSA, udev), for half an hour
#
# The project is left in package/newcomer of the target folder. Needs no network beyond what a build needs.
set -euo pipefail
cd "$(dirname -- "${BASH_SOURCE[0]}")/.."
root=$PWD
export CARGO_TARGET_DIR="${CARGO_TARGET_DIR:-${XDG_CACHE_HOME:-$HOME/.cache}/bevy_skyline-target}"

die() {
    printf 'package: %s\n' "$*" >&2
    exit 1
}

case "${1:-}" in
'' | --newcomer) mode=${1:-} ;;
*)
    printf 'usage: %s [--newcomer]\n' "$0" >&2
    exit 2
    ;;
esac

# 1. The package, without a warning. It is built below, from outside.
log=$(mktemp)
trap 'rm -f "$log"' EXIT
cargo fetch --locked --target "$(rustc -vV | sed -n 's/^host: //p')"
cargo package --locked --offline --allow-dirty --no-verify --color never 2>&1 | tee "$log"
if grep -q '^warning' "$log"; then die "cargo warns of the package, see above"; fi
version=$(sed -n 's/^version = "\(.*\)"$/\1/p' Cargo.toml | head -n 1)
name="bevy_skyline-$version"
work=$CARGO_TARGET_DIR/package/newcomer
rm -rf "$work"
mkdir -p "$work/src"
tar -xzf "$CARGO_TARGET_DIR/package/$name.crate" -C "$work"
package=$work/$name

# 2. It is whole: every file of these folders, and whatever the README and what it leads to link to.
missing=0
while IFS= read -r file; do
    if [ ! -e "$package/$file" ]; then
        printf 'package: %s is not in it\n' "$file" >&2
        missing=1
    fi
done < <(git ls-files src assets examples tests scripts 'LICENSE-*' README.md CHANGELOG.md)
links=0
while IFS= read -r page; do
    while IFS= read -r link; do
        links=$((links + 1))
        if [ ! -e "$package/$(dirname -- "$page")/$link" ]; then
            printf 'package: %s links to %s, which is not in it\n' "$page" "$link" >&2
            missing=1
        fi
    done < <(grep -o '](\([^)]*\))' "$package/$page" | sed 's/^](//; s/)$//; s/#.*//' | grep -v '^[a-z]*:' | grep . || true)
done < <(cd "$package" && find README.md CHANGELOG.md docs -name '*.md')
if [ "$missing" -ne 0 ] || [ "$links" -eq 0 ]; then die "it is not whole ($links links looked at)"; fi

count() { find "$package/$1" -type f | wc -l; }
size() { du -sb "$package/$1" | cut -f 1; }
printf '\n%-12s %6s %10s\n' where files bytes
for part in src assets examples tests scripts docs; do
    printf '%-12s %6d %10d\n' "$part" "$(count $part)" "$(size $part)"
done
printf '%-12s %6d %10d\n' all "$(find "$package" -type f | wc -l)" "$(du -sb "$package" | cut -f 1)"
printf '%-12s %6s %10d\n' compressed '' "$(stat -c %s "$CARGO_TARGET_DIR/package/$name.crate")"
printf '%d links lead to what is there\n\n' "$links"

# 3. An empty project with the README's code.
# block LANGUAGE: the README's first block of that language.
block() { awk -v fence="^\`\`\`$1" '$0 ~ fence { on = 1; next } /^```/ { if (on) exit } on' "$package/README.md"; }
block rust >"$work/src/main.rs"
grep -q 'fn main()' "$work/src/main.rs" || die "the README's first block of Rust is no program"
block toml >"$log"
grep -q 'path = "../bevy_skyline"' "$log" || die "the README's first block of TOML names no path to the crate"
{
    printf '[package]\nname = "newcomer"\nversion = "0.0.0"\nedition = "2024"\n\n'
    sed "s#path = \"../bevy_skyline\"#path = \"$name\"#" "$log"
    if [ "$mode" != --newcomer ]; then
        # What the crate's tests switch on in crates that Bevy has, too; see .ci/run.
        printf '\n# So that Bevy is the one that is built.\n'
        sed -n '/^bevy_egui = /p' "$root/Cargo.toml" | sed 's/, optional = true//'
        sed -n '/^\[dev-dependencies\]$/,/^$/p' "$root/Cargo.toml" | sed '1d; /^#/d; /^bevy = /d'
        sed -n '/^\[profile/,$p' "$root/Cargo.toml"
    fi
} >"$work/Cargo.toml"
# With the versions that the tests are built with.
cp Cargo.lock "$work/Cargo.lock"
if [ "$mode" = --newcomer ]; then
    export CARGO_TARGET_DIR=$work/target
else
    # The features of Bevy that the crate has by itself, with those of `window` and of its tests.
    features=$(
        {
            sed -n '/^bevy = {/,/^\] }/p' Cargo.toml | grep -o '^ *"[a-z0-9_]*"' | tr -d ' '
            sed -n '/^\[features\]/,/^\[dependencies\]/p' Cargo.toml | grep -o '"bevy/[a-z0-9_]*"' | sed 's#bevy/##'
            sed -n '/^\[dev-dependencies\]/,/^$/p' Cargo.toml | sed -n 's/^bevy = .*features = \[\(.*\)\].*/\1/p'
        } | paste -sd,
    )
    sed -i "s#^bevy = .*#bevy = { version = \"0.19\", default-features = false, features = [$features] }#" "$work/Cargo.toml"
fi
cat "$work/Cargo.toml"
cd "$work"
if [ "$mode" != --newcomer ]; then export CARGO_NET_OFFLINE=true; fi
cargo build
cargo tree --depth 1 --edges normal
printf '\nthe README'"'"'s program is built: %s\n' "$CARGO_TARGET_DIR/debug/newcomer"
