#!/bin/sh
# Run a command of the image with its own copy of the code that was compiled when the image was built: numba and
# matplotlib write beside it. The image may be read-only, its user without a home, and /tmp that of the host (Apptainer).
set -eu
if grep -qs avx2 /proc/cpuinfo; then # code for any such processor, not only for the one that built the image
    export NUMBA_CPU_NAME=x86-64-v3 NUMBA_CPU_FEATURES=
fi
own=$(mktemp -d) || exec "$@" # then everything is compiled each time
(trap '' INT TERM HUP; tail --pid=$$ -f /dev/null; rm -rf "$own") > /dev/null 2>&1 &
cp -r /opt/morphofold/. "$own" || true
export NUMBA_CACHE_DIR="$own/compiled" MPLCONFIGDIR="$own/matplotlib"
exec "$@"
