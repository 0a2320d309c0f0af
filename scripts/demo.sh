#!/usr/bin/env bash
# Builds and runs the demo: see `scripts/demo.sh --help`.
set -euo pipefail
root=$(cd -- "$(dirname -- "${BASH_SOURCE[0]}")/.." && pwd)

usage() {
    cat <<'END'
Flies over a city on a mountain coast, with all effects: on the ground of FILE, or on an island made by code.

usage: scripts/demo.sh [--headless] [FILE] [-- ARG...]

  FILE        an elevation file: 16-bit PNG, 16-bit or float TIFF, SRTM .hgt
  --headless  make pictures even where there is a display
  ARG...      handed to the demo as they are; `-- --help` lists what it takes

Where there is an X11 display the demo opens a window. Elsewhere it flies without one: it writes the frames of
the flight, a contact sheet, the same picture with culling and without it side by side, a tower cut open, and
a plot of frame times into the folder out/ of the repository, and prints what the frames took. On a software
device that takes minutes; `-- --frames 12 --size 640x360` is quicker.

What is missing to build and run is installed first (Debian and Ubuntu), and said before.
The first build compiles Bevy, which takes minutes.
END
}
die() {
    printf 'demo: %s\n' "$*" >&2
    exit 2
}

# Is there an X server behind DISPLAY? The demo's window is an X11 one: under Wayland that is
# Xwayland, which sets DISPLAY too.
has_display() {
    local display=${DISPLAY-} host number
    host=${display%:*}
    number=${display##*:}
    number=${number%%.*}
    case $number in '' | *[!0-9]*) return 1 ;; esac
    case $host in
        '' | unix)
            [ -S "/tmp/.X11-unix/X$number" ] ||
                grep -q "@/tmp/.X11-unix/X$number\$" /proc/net/unix 2>/dev/null
            ;;
        *)
            # shellcheck disable=SC2016 # expanded by the inner shell
            timeout 3 bash -c ': <"/dev/tcp/$0/$1"' "$host" "$((6000 + number))" 2>/dev/null
            ;;
    esac
}

file=
headless=no
while [ $# -gt 0 ]; do
    case $1 in
        -h | --help)
            usage
            exit 0
            ;;
        --headless) headless=yes ;;
        --)
            shift
            break
            ;;
        -*) die "unknown option $1 (see --help; the demo's own options go after --)" ;;
        *)
            [ -z "$file" ] || die "one FILE at a time: '$file' or '$1'?"
            [ -n "$1" ] || die "FILE is empty"
            file=$1
            ;;
    esac
    shift
done

# Bad input ends here, before minutes of building.
if [ -n "$file" ]; then
    [ -e "$file" ] || die "no such file: $file"
    [ -f "$file" ] || die "not a file: $file"
    [ -r "$file" ] || die "cannot be read: $file"
    # Absolute, so that neither cargo nor Bevy's asset folder has a say in what it means.
    case $file in /*) ;; *) file=$PWD/$file ;; esac
fi

own_out=no
own_frames=no
for argument in "$@"; do
    case $argument in
        --headless) headless=given ;;
        --out | --out=*) own_out=yes ;;
        --frames | --frames=* | --at | --at=*) own_frames=yes ;;
    esac
done
if [ "$headless" = no ] && ! has_display; then
    headless=yes
    if [ -n "${DISPLAY-}" ]; then
        printf 'demo: no X server answers at DISPLAY=%s: drawing without a window\n' "$DISPLAY" >&2
    elif [ -n "${WAYLAND_DISPLAY-}" ]; then
        printf 'demo: this Wayland session has no Xwayland (DISPLAY is not set): drawing without a window\n' >&2
    else
        printf 'demo: no display: drawing without a window\n' >&2
    fi
fi

# shellcheck source=scripts/setup.sh
. "$root/scripts/setup.sh"
arguments=()
if [ -n "$file" ]; then arguments+=("$file"); fi
if [ "$headless" = no ]; then
    skyline_setup --window
else
    skyline_setup
    if [ "$headless" = yes ]; then arguments+=(--headless); fi
    if [ "$own_out" = no ]; then
        arguments+=(--out "$root/out")
    fi
    if [ "$own_frames" = no ]; then arguments+=(--frames 48); fi
fi

# --manifest-path rather than cd: relative paths among ARG... stay relative to the caller.
exec cargo run --manifest-path "$root/Cargo.toml" --all-features --example flyover -- \
    "${arguments[@]}" "$@"
