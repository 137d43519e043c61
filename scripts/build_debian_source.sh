#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# build_debian_source.sh PACKAGE DEST - cross builds a small CMake project, static, from Debian's source package.
#
# For the C libraries that Debian ships for its own machines alone: cJSON, which the tool writes its reports with, and
# cmocka, which the tests stand on. CMAKE_TOOLCHAIN_FILE says for which machine. Makes DEST/include, DEST/lib and DEST/LICENSE. The
# system's package sources and lists stay as they are: apt-get gets some of its own under DEST.
# Environment, optional: JOBS, parallel compile jobs (default: number of cores).
set -eu

die() {
    echo "build_debian_source.sh: $*" >&2
    exit 1
}

[ $# -eq 2 ] || die "usage: build_debian_source.sh PACKAGE DEST"
[ -n "${CMAKE_TOOLCHAIN_FILE:-}" ] || die "set CMAKE_TOOLCHAIN_FILE; for this machine there is the Debian package"
command -v apt-get >/dev/null 2>&1 || die "apt-get is missing: install $1 for the target into $2 by hand"
package=$1
mkdir -p "$2"
dest=$(cd "$2" && pwd)
work=$dest/work
log=$dest/build.log
rm -rf "$work"
mkdir -p "$work/sources" "$work/lists/partial" "$work/cache/archives/partial"
: >"$log"
trap 'rm -rf "$work"' EXIT
trap 'exit 1' HUP INT TERM

step() { # step DESCRIPTION COMMAND...: runs it into the log, and shows the log's end when it fails
    what=$1
    shift
    "$@" >>"$log" 2>&1 || {
        tail -n 25 "$log" >&2
        die "$what failed; the whole log is in $log"
    }
}

# The machine's own package sources, asked for source packages.
for list in /etc/apt/sources.list /etc/apt/sources.list.d/*.list; do
    if [ -f "$list" ]; then sed -n 's/^deb /deb-src /p' "$list" >>"$work/sources/machine.list"; fi
done
for list in /etc/apt/sources.list.d/*.sources; do
    if [ -f "$list" ]; then sed 's/^Types:.*/Types: deb-src/' "$list" >"$work/sources/$(basename "$list")"; fi
done

apt() {
    apt-get -qq -o Dir::Etc::sourcelist=/dev/null -o Dir::Etc::sourceparts="$work/sources" \
        -o Dir::State::lists="$work/lists" -o Dir::Cache="$work/cache" -o APT::Sandbox::User= "$@"
}

fetch() { (cd "$work" && apt update && apt source --download-only "$package" && dpkg-source --no-check -x ./*.dsc source); }

echo "building $package for $(basename "$CMAKE_TOOLCHAIN_FILE" .cmake)" >&2
step "fetching the sources with apt-get (is there a network?)" fetch
step "configuring $package with cmake" cmake -S "$work/source" -B "$work/build" \
    -DCMAKE_TOOLCHAIN_FILE="$CMAKE_TOOLCHAIN_FILE" -DCMAKE_INSTALL_PREFIX="$dest" -DCMAKE_INSTALL_LIBDIR=lib \
    -DCMAKE_BUILD_TYPE=Release -DBUILD_SHARED_LIBS=OFF -DCMAKE_POSITION_INDEPENDENT_CODE=ON \
    -DENABLE_CJSON_TEST=OFF -DENABLE_CUSTOM_COMPILER_FLAGS=OFF -DENABLE_HIDDEN_SYMBOLS=ON -DWITH_STATIC_LIB=ON -DWITH_EXAMPLES=OFF -DUNIT_TESTING=OFF
step "compiling $package" cmake --build "$work/build" -j "${JOBS:-$(getconf _NPROCESSORS_ONLN 2>/dev/null || echo 2)}"
rm -rf "$dest/include" "$dest/lib"
step "installing $package" cmake --install "$work/build"
cp "$work"/source/LICENSE "$dest/LICENSE" 2>/dev/null || cp "$work"/source/COPYING "$dest/LICENSE"
