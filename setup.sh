#!/usr/bin/env bash
# Installs what Penumbra needs and this machine lacks: system packages by apt, Python ones in .venv.
#
# usage: ./setup.sh [run | course | test]
#   run     what the renderer, the comparison and the report need (default)
#   course  also what puts the renderer in a page: clang for WebAssembly
#   test    also what the tests drive: browsers, clang with its OpenMP checker, valgrind
# environment:
#   PENUMBRA_PYTHON   the interpreter that .venv is made with
# exit: 0 all is there, 2 usage, 3 something is missing and could not be installed
#
# Make calls it; there is no need to. A second run takes about a second and no network.

set -euo pipefail
cd "$(dirname "$0")"

level=${1:-run}
log=build/setup.log
missing=()
python=

say() { echo "setup: $*" >&2; }

stop() {
    say "$@"
    exit 3
}

# logged COMMAND...: output to the log; on failure its last lines are shown.
logged() {
    echo "+ $*" >>"$log"
    if ! "$@" >>"$log" 2>&1 </dev/null; then
        tail -n 12 "$log" | sed 's/^/    /' >&2
        return 1
    fi
}

# need PACKAGE WHY PROBE...: PACKAGE is missing unless the command PROBE works.
need() {
    local package=$1 why=$2
    shift 2
    if ! "$@" >/dev/null 2>&1; then
        missing+=("$package")
        say "missing: $package ($why)"
    fi
}

# ---------------------------------------------------------------- probes, by use

# compiles COMPILER OPTION...: it makes a program of standard input, and the program runs.
compiles() {
    "$1" -x c - -o "$probes/program" "${@:2}" && "$probes/program"
}

# links HEADER [LIBRARY]: the header is there and so is the library, by its pkg-config name.
links() {
    local flags=()
    [ $# -eq 1 ] || read -ra flags <<<"$(pkg-config --cflags --libs "$2")"
    compiles gcc "${flags[@]}" <<<"#include <$1>
int main(void) { return 0; }"
}

loads() { "${python:-python3}" -c 'import ctypes, sys; ctypes.CDLL(sys.argv[1])' "$1"; }

trusts_certificates() {
    "${python:-python3}" -c '
import os, ssl, sys
paths = ssl.get_default_verify_paths()
sys.exit(not (paths.cafile or (paths.capath and os.listdir(paths.capath))))'
}

# Prints the interpreter's own file: a name on the PATH may be a slow or fickle wrapper.
makes_venvs() {
    "$1" -c '
import sys, venv, ensurepip
print(sys.executable)
sys.exit(sys.version_info < (3, 11))'
}

# Python 3.11 and 3.13 come first because they have Cycles. `python` stays empty if there is none.
find_python() {
    local candidate
    for candidate in "${PENUMBRA_PYTHON:-python3.11}" python3.13 python3; do
        python=$(makes_venvs "$candidate" 2>/dev/null) && return
        python=
        [ -z "${PENUMBRA_PYTHON:-}" ] ||
            stop "PENUMBRA_PYTHON=$PENUMBRA_PYTHON: not a Python 3.11 or newer that can make a venv"
    done
}

checks_threads() { compiles clang -fsanitize=thread <<<'int main(void) { return 0; }'; }

# Without libomp's own tool, Archer, clang's thread checker sees races in any OpenMP.
checks_openmp_threads() {
    OMP_TOOL_LIBRARIES=$(clang --print-resource-dir)/../../libarcher.so \
        TSAN_OPTIONS=ignore_noninstrumented_modules=1 \
        compiles clang -fsanitize=thread -fopenmp <<<'
int main(void) {
    int n = 0;
#pragma omp parallel for reduction(+ : n)
    for (int i = 0; i < 9; i++) n += i;
    return n != 36;
}'
}

# What links a module for a page, as the Makefile does.
compiles_for_pages() {
    clang --target=wasm32-wasi -x c -c - -o "$probes/module.o" <<<'#include <math.h>
double f(double x) { return sin(x); }' &&
        wasm-ld --no-entry --export=f "$probes/module.o" -L/usr/lib/wasm32-wasi -lc \
            "$(find "$(clang --print-resource-dir)/lib/" -path '*wasm32*' \
                -name 'libclang_rt.builtins*.a' -print -quit)" -o "$probes/module.wasm"
}

has_firefox() { command -v firefox || command -v firefox-esr; }

has_browser() { command -v chromium || command -v chromium-browser || command -v google-chrome; }

probe_system() {
    missing=()
    need make "runs the experiment" make --version
    need gcc "compiles the renderer" gcc --version
    need libc6-dev "the C library's headers" links stdio.h
    need pkg-config "finds libraries" pkg-config --version
    need libjansson-dev "the renderer reads scenes with it" links jansson.h jansson
    need libopenexr-dev "the renderer writes images with it" links openexr.h OpenEXR
    # Where namespaces are forbidden it does not work, and Landlock takes its place: no fault here.
    need bubblewrap "runs students' programs in a cage" bwrap --version
    find_python
    if [ -z "$python" ]; then
        need python3 "comparison and report" python3 --version
        need python3-venv "Python 3.11 or newer, with a folder of its own for packages" \
            makes_venvs python3
    fi
    need ca-certificates "secure downloads" trusts_certificates
    if [ "$(uname -m)" = x86_64 ]; then # the only Linux that Cycles has wheels for
        need libx11-6 "Cycles" loads libX11.so.6
        need libxrender1 "Cycles" loads libXrender.so.1
        need libxfixes3 "Cycles" loads libXfixes.so.3
        need libxi6 "Cycles" loads libXi.so.6
        need libxkbcommon0 "Cycles" loads libxkbcommon.so.0
        need libsm6 "Cycles" loads libSM.so.6
        need libgl1 "Cycles" loads libGL.so.1
    fi
    if [ "$level" != run ]; then
        need clang "compiles the renderer for a page; second compiler" clang --version
        need lld "links it" wasm-ld --version
        need wasi-libc "its C library" test -f /usr/lib/wasm32-wasi/libc.a
        need libclang-rt-dev-wasm32 "what clang needs beside it" compiles_for_pages
    fi
    if [ "$level" = test ]; then
        need chromium "tests the pages" has_browser
        need firefox-esr "tests the lesson" has_firefox
        need libclang-rt-dev "clang's thread checker" checks_threads
        need libomp-dev "the same for OpenMP" checks_openmp_threads
        need valgrind "checks memory" valgrind --quiet true
    fi
}

# ---------------------------------------------------------------- system packages

install_missing() {
    command -v apt-get >/dev/null ||
        stop "this system has no apt-get; install what Debian calls: ${missing[*]}"
    local install=(apt-get install --yes --no-install-recommends "${missing[@]}")
    local as_root=()
    if [ "$(id -u)" != 0 ]; then
        if command -v sudo >/dev/null && sudo -n true 2>/dev/null; then
            as_root=(sudo -n)
        elif command -v sudo >/dev/null && [ -t 0 ] && sudo -v; then # asks for the password
            as_root=(sudo -n)
        else
            say "not root, and sudo does not let me in; please run, then try again:"
            echo "    sudo apt-get update && sudo ${install[*]}" >&2
            exit 3
        fi
    fi
    as_root+=(env DEBIAN_FRONTEND=noninteractive)
    local options=(--option DPkg::Lock::Timeout=120 --quiet)
    say "installing with apt: ${missing[*]} (log: $log)"
    # Only if that fails, what may help: finish an interrupted installation, fetch package lists.
    if ! logged "${as_root[@]}" "${install[@]}" "${options[@]}" 2>/dev/null; then
        logged "${as_root[@]}" dpkg --configure -a || true
        logged "${as_root[@]}" apt-get update "${options[@]}" || true
        logged "${as_root[@]}" "${install[@]}" "${options[@]}" ||
            stop "apt could not install: ${missing[*]} (see $log; is there a network?)"
    fi
}

setup_system() {
    probe_system
    [ ${#missing[@]} -gt 0 ] || return 0
    install_missing
    say "checking again"
    probe_system
    [ ${#missing[@]} -eq 0 ] || stop "installed, yet still not usable: ${missing[*]} (see $log)"
}

# ---------------------------------------------------------------- Python packages

# What .venv was made of. It is written into .venv when that is complete, so an interrupted one is
# never taken for done; the folder is part of it because a venv cannot be moved.
venv_key() {
    pwd
    cat requirements.txt
}

python_version() { "$1" -c 'import platform; print(platform.python_version())'; }

venv_is_complete() {
    cmp -s <(venv_key) .venv/penumbra-key && .venv/bin/python -c '' 2>/dev/null &&
        { [ -z "${PENUMBRA_PYTHON:-}" ] ||
            [ "$(python_version .venv/bin/python)" = "$(python_version "$PENUMBRA_PYTHON")" ]; }
}

has_cycles() {
    .venv/bin/python -c 'import sys, importlib.util; sys.exit(not importlib.util.find_spec("bpy"))'
}

pip_install() {
    logged .venv/bin/python -m pip install --disable-pip-version-check --progress-bar off "$@"
}

setup_venv() {
    if ! venv_is_complete; then
        local version
        version=$(python_version "$python")
        say "installing Python packages for Python $version in .venv," \
            "a download of up to 600 MB (log: $log)"
        rm -f .venv/penumbra-key
        logged "$python" -m venv --clear .venv || stop "cannot make .venv (see $log)"
        # Python compiles what it imports: compiling all of Blender's modules here takes 25 s.
        pip_install --no-compile --require-hashes --requirement requirements.txt ||
            stop "pip could not install requirements.txt (see $log; is there a network?)"
        has_cycles ||
            say "no Cycles for Python $version on $(uname -sm) (Python 3.11 and 3.13 on x86-64 have" \
                "it): the reference images that Penumbra brings along are used instead"
        venv_key >.venv/penumbra-key
    fi
    # The package itself: editable, so only its metadata and the `penumbra` command are installed.
    if ! cmp -s pyproject.toml .venv/penumbra-pyproject; then
        pip_install --no-index --no-deps --no-build-isolation --editable . ||
            stop "cannot install penumbra in .venv (see $log)"
        cp pyproject.toml .venv/penumbra-pyproject
    fi
}

# ---------------------------------------------------------------- main

case $level in
run | course | test) ;;
-h | --help)
    sed -n '2,/^$/s/^# \{0,1\}//p' "$0"
    exit 0
    ;;
*)
    say "unknown level '$level'; usage: ./setup.sh [run | course | test]"
    exit 2
    ;;
esac

mkdir -p build
# Two set-ups at once would undo each other's .venv.
if command -v flock >/dev/null; then
    exec 9>build/setup.lock
    flock --nonblock 9 || { say "waiting for another set-up to end" && flock 9; }
fi
: >"$log"
probes=$(mktemp -d)
trap 'rm -rf "$probes"' EXIT

setup_system
setup_venv
