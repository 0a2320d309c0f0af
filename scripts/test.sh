#!/usr/bin/env bash
# Runs the whole test suite: see `scripts/test.sh --help`.
set -euo pipefail
root=$(cd -- "$(dirname -- "${BASH_SOURCE[0]}")/.." && pwd)

case ${1-} in
    -h | --help)
        cat <<'END'
Runs every test, on a GPU or on Mesa's software driver.

usage: scripts/test.sh [ARG...]

  ARG...  handed to `cargo test --all-features` as they are, for instance
          a part of a test's name, or `-- --nocapture`

What is missing to build and run is installed first (Debian and Ubuntu), and said before.
The first build compiles Bevy, which takes minutes.
END
        exit 0
        ;;
esac

# shellcheck source=scripts/setup.sh
. "$root/scripts/setup.sh"
skyline_setup --test
cd "$root"
exec cargo test --all-features "$@"
