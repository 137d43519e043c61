#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# install_blenders.sh FOLDER VERSION... - Blender as a Python module, each version in an environment of its own:
# FOLDER/4.2/bin/python. A version is 4.2 or 4.2.23; the first of its line that is there stays. About 1 GB each.
#
# 3.4 is Debian's own package and no module: scripts/install_deps.sh blender installs it. A version whose Python is not
# on this machine is left out with a line that says so.
set -eu

folder=$1
shift
for version in "$@"; do
    line=$(echo "$version" | cut -d. -f1,2)
    case $line in
    5.1 | 5.2) python=python3.13 ;;
    *) python=python3.11 ;;
    esac
    home=$folder/$line
    [ -e "$home/complete" ] && continue
    if ! "$python" -c '' 2>/dev/null; then
        # pyenv has versions that it does not put on the PATH.
        python=$(ls "${PYENV_ROOT:-$HOME/.pyenv}"/versions/"${python#python}".*/bin/"$python" 2>/dev/null | tail -n 1)
    fi
    if [ -z "$python" ]; then
        echo "Blender $line needs a newer Python than there is here: left out"
        continue
    fi
    echo "Installing Blender $line into $home"
    rm -rf "$home"
    "$python" -m venv "$home"
    "$home/bin/python" -m pip install --quiet --disable-pip-version-check "bpy==$version.*" ||
        "$home/bin/python" -m pip install --quiet --disable-pip-version-check "bpy==$version"
    touch "$home/complete"
done
