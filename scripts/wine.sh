#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# wine.sh PROGRAM.exe [ARGUMENT...] - runs a Windows program under Wine, with settings of its own under build/wine.
set -eu

root=$(cd "$(dirname "$0")/.." && pwd)
export WINEPREFIX="$root/build/wine" WINEARCH=win64 WINEDEBUG=-all WINEDLLOVERRIDES="winemenubuilder.exe,mscoree,mshtml="
unset DISPLAY

find_tool() { # find_tool NAME...: the first that there is, in PATH or in Debian's folder
    for tool in "$@"; do
        command -v "$tool" && return
        if [ -x "/usr/lib/wine/$tool" ]; then echo "/usr/lib/wine/$tool" && return; fi
    done
    echo "wine.sh: Wine is missing (Debian: apt-get install wine64)" >&2
    exit 127
}

wine=$(find_tool wine64 wine)
server=$(find_tool wineserver64 wineserver)
# A server that stays for a minute spares the next program its start. Where one runs already, this does nothing. It must
# not hold on to the output: whoever reads that would wait for the minute to pass.
mkdir -p "$WINEPREFIX"
"$server" -p60 </dev/null >/dev/null 2>&1 || true
exec "$wine" "$@"
