#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# install_deps.sh [build|demo|test|bench|blender|windows|arm64|train] - installs the Debian packages that a target needs.
#
# Does nothing when all are there. As root, or where sudo asks for no password, it runs apt-get; otherwise it prints the
# command and exits with 1. Python packages do not come from here: the Makefile puts them into build/venv.
set -eu

what=${1:-build}
packages="build-essential cmake pkg-config python3-pip python3-venv libimath-dev libopenimageio-dev libcjson-dev"
# What Blender as a Python module links with.
module="libgl1 libice6 libsm6 libx11-6 libxfixes3 libxi6 libxkbcommon0 libxrender1"
case $what in
build) ;;
demo | bench) packages="$packages openimageio-tools" ;;
test)
    packages="$packages openimageio-tools libcmocka-dev valgrind gcc-aarch64-linux-gnu libc6-dev-arm64-cross qemu-user"
    packages="$packages $module"
    ;;
# The window tests draw in software on a screen that is not there; Debian's OpenEXR is the other one in the process; a
# Slurm of one node and a JavaScript engine try the farm samples.
blender)
    packages="$packages blender python3-numpy libopenexr-3-1-30 xvfb libgl1-mesa-dri xdotool"
    packages="$packages munge slurmctld slurmd slurm-client nodejs"
    ;;
windows) packages="$packages g++-mingw-w64-x86-64-posix wine64" ;;
arm64) packages="$packages g++-aarch64-linux-gnu libc6-dev-arm64-cross qemu-user" ;;
train) packages="$packages $module" ;;
*)
    echo "usage: install_deps.sh [build|demo|test|bench|blender|windows|arm64|train]" >&2
    exit 2
    ;;
esac

if ! command -v dpkg-query >/dev/null 2>&1 || ! command -v apt-get >/dev/null 2>&1; then
    echo "This is no Debian: please make sure that the equivalents of these packages are installed:" >&2
    echo "  $packages" >&2
    exit 0
fi

missing=
for package in $packages; do
    case $(dpkg-query -W -f '${Status}' "$package" 2>/dev/null || true) in
    "install ok installed") ;;
    *) missing="$missing $package" ;;
    esac
done
[ -n "$missing" ] || exit 0

install="apt-get install -y --no-install-recommends$missing"
echo "Debian packages needed for '$what' that are not installed:$missing"
if [ "$(id -u)" -eq 0 ]; then
    sudo=
elif command -v sudo >/dev/null 2>&1 && sudo -n true 2>/dev/null; then
    sudo="sudo -n"
else
    echo "Installing them needs root. Please run this, then try again:" >&2
    echo "  sudo apt-get update && sudo $install" >&2
    exit 1
fi

echo "Running: ${sudo:+$sudo }$install"
$sudo env DEBIAN_FRONTEND=noninteractive apt-get update -qq
$sudo env DEBIAN_FRONTEND=noninteractive $install
