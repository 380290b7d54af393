#!/bin/bash
# Claims about tests/run.sh, on a made-up tree with programs that pass, fail, die, hang and run nothing.
set -u
here=$(cd "$(dirname "$0")" && pwd)
tree=$(mktemp -d) || exit 1
trap 'rm -rf "$tree"' EXIT
status=0
claim() { # sentence command...
  local sentence=$1
  shift
  if "$@"; then echo "ok $sentence"; else echo "not ok $sentence"; status=1; sed 's/^/# /' "$tree/log"; fi
}

program() { # config name body: a built test program and its source
  mkdir -p "$tree/tests/unit" "$tree/build/$1/tests/unit"
  touch "$tree/tests/unit/$2_test.c"
  printf '#!/bin/sh\n%s\n' "$3" >"$tree/build/$1/tests/unit/$2_test"
  chmod +x "$tree/build/$1/tests/unit/$2_test"
}

limit=300 # seconds that a program has; no matter how slow the machine is, those below need less
run() { # arguments...: keeps output and exit status
  LODESTREAM_TEST_SECONDS=$limit "$tree/tests/run.sh" "$@" >"$tree/log" 2>&1
  code=$?
}

last_line_is() { [ "$(tail -n 1 "$tree/log")" = "$1" ] && [ $code -eq "$2" ]; }
says() { grep -qF -- "$1" "$tree/log"; }
is_silent_about() { ! says "$1"; }
ends_with() { sed '1,/^Once more/d' "$tree/log" | grep -qF -- "$1"; } # the summary of failures says it
ends_without() { ! ends_with "$1"; }

two_good='echo "[ RUN      ] a"; echo "[       OK ] a"; echo "[       OK ] b"; echo "[  PASSED  ] 2 test(s)."; echo detail-good'
one_bad='echo "[       OK ] a"; echo "[  FAILED  ] b"; echo "[  FAILED  ] 1 test(s), listed below:"; echo "[  FAILED  ] b"; echo detail-bad; exit 1'

mkdir -p "$tree/tests"
cp "$here/run.sh" "$tree/tests/run.sh"
run
claim "no program at all is a failure" last_line_is "0 passed, 0 failed" 1

program release good "$two_good"
program sanitize good "$two_good"
run
claim "two tests in two configurations are four" last_line_is "4 passed, 0 failed" 0
claim "the output of what passes is not shown" is_silent_about detail-good
run sanitize
claim "sanitize runs the sanitized half" last_line_is "2 passed, 0 failed" 0

program sanitize bad "$one_bad"
run sanitize
claim "a failed test is counted once and fails the run" last_line_is "3 passed, 1 failed" 1
claim "the output of what fails is shown" says detail-bad
claim "the end says again which test failed" ends_with "[  FAILED  ] b"
claim "and in which program" ends_with "sanitize tests/unit/bad_test"
claim "but nothing of what passed" ends_without good_test

program sanitize bad 'for i in $(seq 500); do echo "[  FAILED  ] line $i"; done; exit 1'
run sanitize
claim "the summary is short" ends_without "line 61"
claim "and says that there is more" ends_with "(and more, above)"

program sanitize bad 'echo "[       OK ] a"; kill -SEGV $$'
run sanitize
claim "a program that dies is one failure" last_line_is "3 passed, 1 failed" 1

program sanitize bad 'echo "[       OK ] a"; exec sleep 300'
limit=8
run sanitize
limit=300
claim "a program that hangs is stopped and is one failure" last_line_is "3 passed, 1 failed" 1
claim "and the log says so" says "ran longer than 8 seconds"
claim "and its end too" ends_with "ran longer than 8 seconds"

program sanitize bad 'exit 0'
run sanitize
claim "a program that runs no test is one failure" last_line_is "2 passed, 1 failed" 1

rm "$tree/build/sanitize/tests/unit/bad_test"
run sanitize
claim "a program that is not built is one failure" last_line_is "2 passed, 1 failed" 1
rm "$tree/tests/unit/bad_test.c"

mkdir -p "$tree/tests/fuzz" "$tree/build/sanitize/tests/fuzz"
touch "$tree/tests/fuzz/ply_fuzz.c"
printf '#!/bin/sh\ntest -e "$1/seed"\n' >"$tree/build/sanitize/tests/fuzz/ply_fuzz"
chmod +x "$tree/build/sanitize/tests/fuzz/ply_fuzz"
run sanitize
claim "a fuzz target without a corpus is one failure" last_line_is "2 passed, 1 failed" 1
mkdir -p "$tree/tests/fuzz/corpus/ply"
touch "$tree/tests/fuzz/corpus/ply/seed"
run sanitize
claim "a replay over its corpus is one test" last_line_is "3 passed, 0 failed" 0

if command -v node >/dev/null 2>&1; then
  mkdir -p "$tree/tests/web"
  printf "import test from 'node:test';\ntest('a', () => {});\ntest('b', () => { throw new Error('detail-node'); });\n" >"$tree/tests/web/x.test.mjs"
  run
  claim "node tests are counted one by one" last_line_is "6 passed, 1 failed" 1
  claim "and their failures shown" says detail-node
  claim "at the end too" ends_with detail-node
  claim "where the tests that passed are left out" ends_without "ok 1 - a"
fi
exit $status
