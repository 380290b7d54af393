#!/bin/bash
# Runs every test program that is built, one line each, and the whole output of those that fail. At the end, for a record that keeps no more
# than that, once again what failed in each (at most SUMMARY_LINES lines). The last line is the count.
#
#   tests/run.sh            all: unit, property and golden tests of build/release and build/sanitize, fuzz replays, lint, node tests
#   tests/run.sh sanitize   only what is built with sanitizers
#
# A program is one of
#   tests/{unit,property,golden}/**/x_test.c   built by make; cmocka counts its tests
#   tests/fuzz/x_fuzz.c                        replays tests/fuzz/corpus/x; one test
#   tests/**/x_test.sh                         prints a line "ok ..." or "not ok ..." for each test
#   tests/{http,web}/*.test.mjs                run by `node --test`
# A program that was not built, dies, or runs out of time is one failed test besides those it counted.
# LODESTREAM_TEST_SECONDS bounds each program (default 600). LODESTREAM_TEST_JOBS: C programs at a time (default 2).
set -u
export LC_ALL=C
cd "$(dirname "$0")/.." || exit 1
what=${1:-all}
case $what in all | sanitize) ;; *) echo "usage: tests/run.sh [sanitize]" >&2; exit 2 ;; esac
limit=${LODESTREAM_TEST_SECONDS:-600}
jobs=${LODESTREAM_TEST_JOBS:-2}
out=$(mktemp -d) || exit 1
trap 'rm -rf "$out"' EXIT
export ASAN_OPTIONS="${ASAN_OPTIONS:-detect_leaks=1}" UBSAN_OPTIONS="${UBSAN_OPTIONS:-print_stacktrace=1}"

count_lines() { # pattern file: how many lines match
  grep -aEc "$1" "$2"
}

sum_numbers() { # pattern whose group is a number, file: their sum
  sed -nE "s/$1/\\1/p" "$2" | awk '{ sum += $1 } END { print sum + 0 }'
}

# number kind label command...: runs one program; leaves $out/number.{log,result}
run_one() {
  local number=$1 kind=$2 label=$3 log=$out/$1.log status passed failed skipped=0 begin end
  shift 3
  begin=$(date +%s%N)
  if [ -e "$1" ] || command -v "$1" >/dev/null 2>&1; then
    timeout -k 10 "$limit" "$@" >"$log" 2>&1 </dev/null
    status=$?
  else
    echo "$1 is not there: build it first (make test does)." >"$log"
    status=127
  fi
  end=$(date +%s%N)
  [ $status -ne 124 ] || echo "Stopped: it ran longer than $limit seconds." >>"$log"
  case $kind in
  cmocka)
    passed=$(count_lines '^\[ +OK \]' "$log")
    failed=$(sum_numbers '^\[  FAILED  \] ([0-9]+) test\(s\).*' "$log")
    skipped=$(sum_numbers '^\[  SKIPPED \] ([0-9]+) test\(s\).*' "$log") ;;
  node)
    passed=$(sum_numbers '^[^ ]+ pass ([0-9]+)$' "$log")
    failed=$(($(sum_numbers '^[^ ]+ fail ([0-9]+)$' "$log") + $(sum_numbers '^[^ ]+ cancelled ([0-9]+)$' "$log")))
    skipped=$(sum_numbers '^[^ ]+ skipped ([0-9]+)$' "$log") ;;
  lines)
    passed=$(count_lines '^ok( |$)' "$log")
    failed=$(count_lines '^not ok( |$)' "$log") ;;
  whole)
    passed=$((status == 0))
    failed=$((status != 0)) ;;
  esac
  if [ $status -ne 0 ] && [ "$failed" -eq 0 ]; then failed=1; fi
  if [ $status -eq 0 ] && [ $((passed + failed + skipped)) -eq 0 ]; then
    echo "It ran no test." >>"$log"
    failed=1
  fi
  [ "$failed" -eq 0 ] || [ $status -ne 0 ] || status=1
  local verdict=ok more=""
  [ $status -eq 0 ] || verdict=FAIL
  [ "$failed" -eq 0 ] || more=", $failed failed"
  [ "$skipped" -eq 0 ] || more="$more, $skipped skipped"
  local hundredths=$(((end - begin) / 10000000))
  printf '%d %d %d %s %-4s %4d.%02d s  %s (%d passed%s)\n' "$passed" "$failed" $status "$kind" $verdict $((hundredths / 100)) $((hundredths % 100)) \
    "$label" "$passed" "$more" >"$out/$number.part"
  mv "$out/$number.part" "$out/$number.result"
}

SUMMARY_LINES=60

# kind log: what in the output of a failed program says which tests failed and why.
failures() {
  local log=$2 picked=$out/picked
  case $1 in
  node) awk '/^ *not ok / { keep = 1 } keep || /Sanitizer|runtime error/ { print } /^ *\.\.\.$/ { keep = 0 }' "$log" >"$picked" ;;
  lines) awk '/^not ok/ { keep = 1 } /^ok/ { keep = 0 } keep' "$log" >"$picked" ;;
  *) grep -aE -B 1 -A 8 '^\[  (ERROR  |FAILED )|Sanitizer|runtime error|^Stopped:|[Aa]ssert|not ok' "$log" | grep -v '^--$' >"$picked" ;;
  esac
  [ -s "$picked" ] || tail -n 20 "$log" >"$picked"
  [ "$(wc -l <"$picked")" -le $SUMMARY_LINES ] || { head -n $SUMMARY_LINES "$picked"; echo "(and more, above)"; } >"$picked.head"
  [ ! -e "$picked.head" ] || mv "$picked.head" "$picked"
  tail -n 1 "$log" | grep -q '^Stopped:' && ! grep -q '^Stopped:' "$picked" && tail -n 1 "$log" >>"$picked"
  cut -c 1-240 "$picked"
}

total_passed=0
total_failed=0
next=0    # number of the next program
reported=0

# Prints what is done, in order, however the programs overlap.
report() {
  while [ $reported -lt $next ] && [ -e "$out/$reported.result" ]; do
    local passed failed status kind line
    read -r passed failed status kind line <"$out/$reported.result"
    printf '%s\n' "$line"
    if [ "$status" -ne 0 ]; then
      sed 's/^/    /' "$out/$reported.log"
      { printf '%s\n' "$line"; failures "$kind" "$out/$reported.log" | sed 's/^/    /'; } >>"$out/failures"
    fi
    total_passed=$((total_passed + passed))
    total_failed=$((total_failed + failed))
    rm -f "$out/$reported.log" "$out/$reported.result"
    reported=$((reported + 1))
  done
}

start() { # kind label command...: beside others
  while [ "$(jobs -rp | wc -l)" -ge "$jobs" ]; do wait -n 2>/dev/null; done
  run_one $next "$@" &
  next=$((next + 1))
  report
}

finish() {
  wait
  report
}

alone() { # kind label command...: with the machine to itself
  finish
  run_one $next "$@"
  next=$((next + 1))
  report
}

configs="release sanitize"
[ "$what" = all ] || configs=sanitize
for config in $configs; do
  for source in $(find tests/unit tests/property tests/golden -name '*_test.c' 2>/dev/null | sort); do
    program=build/$config/${source%.c}
    start cmocka "$config ${source%.c}" "$program"
  done
done
for source in $(find tests/fuzz -maxdepth 1 -name '*_fuzz.c' 2>/dev/null | sort); do
  name=$(basename "$source" _fuzz.c)
  if [ -n "$(ls -A "tests/fuzz/corpus/$name" 2>/dev/null)" ]; then
    start whole "sanitize replay of $name" "build/sanitize/${source%.c}" "tests/fuzz/corpus/$name"
  else
    start whole "sanitize replay of $name" sh -c "echo 'tests/fuzz/corpus/$name is empty: a fuzz target needs a corpus to replay.'; exit 1"
  fi
done
finish
if [ "$what" = all ]; then
  [ ! -e tests/lint/lint.sh ] || alone whole lint tests/lint/lint.sh
  for script in $(find tests -name '*_test.sh' | sort); do
    alone lines "${script%.sh}" "$script"
  done
  for script in $(find tests/http tests/web -maxdepth 1 -name '*.test.mjs' 2>/dev/null | sort); do
    alone node "$script" node --test "$script"
  done
fi
[ $next -gt 0 ] || echo "No test program was found."
if [ -e "$out/failures" ]; then
  echo "Once more, what failed:"
  cat "$out/failures"
fi
echo "$total_passed passed, $total_failed failed"
[ $total_failed -eq 0 ] && [ $total_passed -gt 0 ]
