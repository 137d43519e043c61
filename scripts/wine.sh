#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# wine.sh PROGRAM.exe [ARGUMENT...] - runs a Windows program under Wine, with settings of its own under build/wine.
#
# Wine's server stays for a while after the last program, which spares the next one its start.
set -eu

root=$(cd "$(dirname "$0")/.." && pwd)
export WINEPREFIX="$root/build/wine" WINEDEBUG=-all WINEARCH=win64 WINEDLLOVERRIDES="mscoree,mshtml=" WINESERVERTIMEOUT=60
unset DISPLAY

for wine in wine64 /usr/lib/wine/wine64 wine; do
    if command -v "$wine" >/dev/null 2>&1; then exec "$wine" "$@"; fi
done
echo "wine.sh: Wine is missing (Debian: apt-get install wine64)" >&2
exit 127
