#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# run_c_tests.sh PROGRAM... - runs test programs, shows the output of those that fail, and ends with one line of counts.
# A program reports its tests as cmocka does; one that does not counts as one test. Exit code 77 is a skip.
# QUELL_TEST_RUNNER: a command put before each program (qemu, valgrind).
set -u

passed=0
failed=0
skipped=0
log=$(mktemp)
trap 'rm -f "$log"' EXIT

for program in "$@"; do
    name=${program##*/tests/}
    ${QUELL_TEST_RUNNER:-} "$program" >"$log" 2>&1
    code=$?
    good=$(sed -n 's/^\[  PASSED  \] \([0-9]*\) test.*/\1/p' "$log" | tail -n 1)
    bad=$(sed -n 's/^\[  FAILED  \] \([0-9]*\) test.*/\1/p' "$log" | tail -n 1)
    if [ $code -eq 77 ]; then
        skipped=$((skipped + 1))
        echo "SKIP $name: $(tail -n 1 "$log")"
        continue
    fi
    if [ $code -eq 0 ]; then
        passed=$((passed + ${good:-1}))
        echo "ok   $name (${good:-1})"
    else
        passed=$((passed + ${good:-0}))
        failed=$((failed + ${bad:-1}))
        echo "FAIL $name (exit $code)"
        sed 's/^/     | /' "$log"
    fi
done

echo "$passed passed, $failed failed, $skipped skipped"
[ "$failed" -eq 0 ]
