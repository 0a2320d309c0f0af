#!/usr/bin/env bash
# Makes sure that this machine can build and run bevy_skyline.
#
#   scripts/setup.sh [--window | --test]    check, and install what is missing
#   . scripts/setup.sh                      only define `skyline_setup`, with the same arguments, as demo.sh
#                                           and test.sh do
#
# Needed, and why:
#   Rust             never installed from here: which toolchain to use is yours to choose
#   C++ compiler     Rust links through `cc`; the FLIP image comparison (feature `cli`) is C++
#   Vulkan loader    opened at run time; a build does not need it
#   Vulkan driver    a GPU's own, or Mesa's software driver where there is none
#   X11 libraries    with --window and --test: winit opens them at run time
#   Xvfb             with --test: a display in memory, for the test that opens a real window
# Nothing else: no pkg-config, no ALSA, no udev, no Wayland. The crate turns those parts of Bevy
# off, and x11-dl, which asks pkg-config for folders, builds without an answer.
#
# When nothing is missing it installs nothing, prints nothing and needs no network.

SETUP_ROOT=$(cd -- "$(dirname -- "${BASH_SOURCE[0]}")/.." && pwd)
setup_packages=() # Debian package names
setup_reasons=()  # one for each of them
setup_ldconfig=   # what the dynamic linker knows

setup_say() { printf 'setup: %s\n' "$*" >&2; }
setup_die() {
    setup_say "$*"
    exit 1
}
setup_need() {
    setup_packages+=("$1")
    setup_reasons+=("$2")
}

# ---- Rust ---------------------------------------------------------------------------------------

setup_rust() {
    local need have
    need=$(sed -n 's/^rust-version *= *"\(.*\)"/\1/p' "$SETUP_ROOT/Cargo.toml")
    # rustup adds this folder to new login shells only.
    if ! command -v cargo >/dev/null && [ -x "${CARGO_HOME:-${HOME-}/.cargo}/bin/cargo" ]; then
        export PATH="${CARGO_HOME:-$HOME/.cargo}/bin:$PATH"
    fi
    if ! command -v cargo >/dev/null || ! command -v rustc >/dev/null; then
        setup_die "Rust is missing: install Rust $need or newer (https://rustup.rs) and run this again"
    fi
    # From the root, so that a toolchain override of this folder counts.
    if ! have=$(cd "$SETUP_ROOT" && rustc --version 2>/dev/null); then
        setup_die "rustc does not run: choose a toolchain with 'rustup default stable' and run this again"
    fi
    have=${have#rustc }
    have=${have%%[ -]*}
    if [ "$(printf '%s\n' "$need" "$have" | sort -V | head -n 1)" != "$need" ]; then
        setup_die "Rust $have is too old: update to $need or newer ('rustup update stable') and run this again"
    fi
}

# ---- What programs look for at run time ---------------------------------------------------------

# Mesa complains on every start without one. A variable that names a folder that is not there
# (containers, su) is as good as none.
setup_runtime_dir() {
    local dir
    if [ -n "${XDG_RUNTIME_DIR-}" ] && [ -d "$XDG_RUNTIME_DIR" ] && [ -w "$XDG_RUNTIME_DIR" ]; then
        return 0
    fi
    dir=${TMPDIR:-/tmp}/bevy_skyline-runtime-$(id -u)
    mkdir -m 700 "$dir" 2>/dev/null || true
    # Only a real folder of our own will do: in a shared /tmp anybody could have made this name.
    if [ -L "$dir" ] || [ ! -d "$dir" ] || [ ! -O "$dir" ]; then
        dir=$(mktemp -d) || setup_die "cannot make a folder in ${TMPDIR:-/tmp}"
    fi
    chmod 700 "$dir"
    export XDG_RUNTIME_DIR=$dir
}

setup_has_library() {
    local dir
    local -a dirs
    case $setup_ldconfig in *$'\t'"$1 ("*) return 0 ;; esac
    IFS=: read -r -a dirs <<<"${LD_LIBRARY_PATH-}"
    for dir in "${dirs[@]}"; do
        if [ -n "$dir" ] && [ -e "$dir/$1" ]; then return 0; fi
    done
    return 1
}

# A compiler without headers or C library (gcc without libc6-dev) is common: only building tells.
setup_cxx_works() {
    local out status=0
    command -v cc >/dev/null || return 1
    out=$(mktemp) || setup_die "cannot write to ${TMPDIR:-/tmp}"
    # shellcheck disable=SC2086 # CXX may hold arguments
    printf '#include <cmath>\n#include <optional>\nint main() { return 0; }\n' |
        ${CXX:-c++} -std=c++17 -x c++ -o "$out" - >/dev/null 2>&1 || status=1
    rm -f "$out"
    return "$status"
}

# ---- Vulkan drivers -----------------------------------------------------------------------------

setup_has_gpu() {
    local node
    for node in /dev/dri/renderD* /dev/nvidiactl /dev/dxg; do
        if [ -r "$node" ] && [ -w "$node" ]; then return 0; fi
    done
    return 1
}

# Does this manifest lead to a driver that can work here: its library is there, and so is a GPU,
# unless it needs none? Mesa installs the manifests of all its drivers on every machine.
setup_manifest_works() {
    local library
    if [ ! -r "$1" ]; then return 1; fi
    library=$(sed -n 's/.*"library_path"[[:space:]]*:[[:space:]]*"\([^"]*\)".*/\1/p' "$1")
    case $library in
        '') return 1 ;;
        /*) [ -e "$library" ] || return 1 ;;
        */*) [ -e "$(dirname -- "$1")/$library" ] || return 1 ;; # relative to the manifest
        *) setup_has_library "$library" || return 1 ;;
    esac
    case ${1##*/} in
        *lvp* | *swiftshader*) return 0 ;;
        *) setup_has_gpu ;;
    esac
}

# The Vulkan loader's own search, on Linux.
setup_has_driver() {
    local forced path file installable=no
    local -a paths extra
    forced=${VK_DRIVER_FILES:-${VK_ICD_FILENAMES-}} # the new name and the old
    if [ -n "$forced" ]; then
        IFS=: read -r -a paths <<<"$forced"
    else
        IFS=: read -r -a paths <<<"${XDG_CONFIG_HOME:-${HOME-}/.config}:${XDG_CONFIG_DIRS:-/etc/xdg}:/etc:${XDG_DATA_HOME:-${HOME-}/.local/share}:${XDG_DATA_DIRS:-/usr/local/share:/usr/share}"
        paths=("${paths[@]/%//vulkan/icd.d}")
        IFS=: read -r -a extra <<<"${VK_ADD_DRIVER_FILES-}"
        paths+=("${extra[@]}")
    fi
    for path in "${paths[@]}"; do
        case $path in /usr/share/vulkan/icd.d/*lvp*) installable=yes ;; esac
        if [ -d "$path" ]; then
            for file in "$path"/*.json; do
                if setup_manifest_works "$file"; then return 0; fi
            done
        elif setup_manifest_works "$path"; then
            return 0
        fi
    done
    # With the variable set the loader looks nowhere else: no package could help.
    if [ -n "$forced" ] && [ "$installable" = no ]; then
        setup_die "VK_DRIVER_FILES or VK_ICD_FILENAMES names no Vulkan driver that works here ($forced): unset it"
    fi
    return 1
}

# ---- Putting it together ------------------------------------------------------------------------

setup_find_missing() {
    setup_packages=()
    setup_reasons=()
    # /sbin is not on every user's PATH.
    setup_ldconfig=$(PATH=$PATH:/usr/sbin:/sbin ldconfig -p 2>/dev/null) || setup_ldconfig=

    setup_cxx_works ||
        setup_need g++ "C++ compiler and linker, to build with"
    setup_has_library libvulkan.so.1 ||
        setup_need libvulkan1 "Vulkan loader, through which programs find a GPU's driver"
    setup_has_driver ||
        setup_need mesa-vulkan-drivers "Mesa's Vulkan drivers, among them one in software: no driver that works was found"
    if [ "$1" != headless ]; then
        local pair
        for pair in libX11.so.6=libx11-6 libX11-xcb.so.1=libx11-xcb1 libXcursor.so.1=libxcursor1 \
            libXi.so.6=libxi6 libxkbcommon.so.0=libxkbcommon0 libxkbcommon-x11.so.0=libxkbcommon-x11-0; do
            setup_has_library "${pair%=*}" || setup_need "${pair#*=}" "to open a window (${pair%=*})"
        done
    fi
    if [ "$1" = test ]; then
        command -v Xvfb >/dev/null || setup_need xvfb "a display in memory, to test a window on"
    fi
}

setup_install() {
    local i log error list="${setup_packages[*]}"
    local -a as_root=()
    if ! command -v apt-get >/dev/null; then
        setup_die "this is not Debian or Ubuntu: install what your system calls these Debian packages, and run this again: $list"
    fi
    if [ "$(id -u)" != 0 ]; then
        if ! command -v sudo >/dev/null; then
            setup_die "cannot install without root or sudo: as root, run 'apt-get install $list', then run this again"
        fi
        if [ ! -t 0 ] && ! sudo -n true 2>/dev/null; then
            setup_die "sudo cannot ask for a password here: run 'sudo apt-get install $list', then run this again"
        fi
        as_root=(sudo)
    fi

    setup_say "missing on this machine, to be installed with ${as_root[*]:+sudo }apt-get:"
    for i in "${!setup_packages[@]}"; do
        printf '    %-20s %s\n' "${setup_packages[i]}" "${setup_reasons[i]}" >&2
    done

    log=$(mktemp)
    as_root+=(env DEBIAN_FRONTEND=noninteractive apt-get -y
        -o DPkg::Lock::Timeout=300 -o Acquire::Retries=2 -o Acquire::http::Timeout=30)
    # A fresh machine has no package lists. Old ones may still do, so only the install decides.
    "${as_root[@]}" update </dev/null >"$log" 2>&1 || true
    if ! "${as_root[@]}" install --no-install-recommends "${setup_packages[@]}" </dev/null >>"$log" 2>&1; then
        error=$(sed -n 's/^E: //p' "$log" | tail -n 1)
        rm -f "$log"
        setup_die "apt-get could not install $list${error:+ ($error)}"
    fi
    rm -f "$log"
    setup_say "installed"
}

# Checks everything, and installs what is missing. Ends the calling script where it cannot.
skyline_setup() {
    local mode=headless
    case ${1-} in
        --window) mode=window ;;
        --test) mode=test ;;
    esac
    if [ "$(uname -s)" != Linux ]; then
        setup_die "these scripts are for Linux: elsewhere, use cargo directly, with --all-features"
    fi
    setup_rust
    setup_runtime_dir
    setup_find_missing "$mode"
    if [ "${#setup_packages[@]}" -eq 0 ]; then return 0; fi
    setup_install
    setup_find_missing "$mode"
    if [ "${#setup_packages[@]}" -ne 0 ]; then
        setup_die "still not usable after installing: ${setup_packages[*]}"
    fi
}

if [ "${BASH_SOURCE[0]}" = "$0" ]; then
    set -euo pipefail
    case $#-${1-} in
        0- | 1---window | 1---test) skyline_setup "$@" ;;
        *) printf 'usage: scripts/setup.sh [--window | --test]\n' >&2 && exit 2 ;;
    esac
fi
