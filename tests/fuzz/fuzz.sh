#!/bin/bash
# Fuzzes every target of build/fuzz for SECONDS each, from its corpus. What it finds stays in build/fuzz/found/NAME; the inputs that reach
# new code, smallest first, in build/fuzz/corpus/NAME. Words of a format are in tests/fuzz/dict/NAME. Inputs are short (LENGTH bytes, default
# 1024) so that there are many of them; the number that ran is printed for each target.
#
#   tests/fuzz/fuzz.sh SECONDS [NAME...]
set -eu
cd "$(dirname "$0")/../.."
seconds=${1:-60}
shift || true
[ $# -gt 0 ] || set -- $(cd tests/fuzz && ls ./*_fuzz.c | sed -E 's|^\./(.*)_fuzz\.c$|\1|')

# A failing allocation is an answer that importers must take, not a finding.
# Freed memory is kept back for less than usual and pages are not given back to the kernel: most of the time of short runs went there.
export ASAN_OPTIONS="allocator_may_return_null=1:malloc_context_size=4:quarantine_size_mb=4:thread_local_quarantine_size_kb=64:max_malloc_fill_size=0:allocator_release_to_os_interval_ms=-1:${ASAN_OPTIONS:-}"
failed=""
# After each run that seems to leak libFuzzer looks through all memory, and names what it found by another program, to learn each time that
# it was libassimp. Leaks of ours show when the corpus is replayed.
leaks() { [ "$1" = assimp ] && echo 0 || echo 1; }
for name in "$@"; do
  mkdir -p "build/fuzz/corpus/$name" "build/fuzz/found/$name"
  echo "== $name, $seconds s"
  dictionary=""
  [ ! -e "tests/fuzz/dict/$name" ] || dictionary="-dict=tests/fuzz/dict/$name"
  "build/fuzz/tests/fuzz/${name}_fuzz" -max_total_time="$seconds" -timeout=20 -rss_limit_mb=4096 -malloc_limit_mb=2048 -print_final_stats=1 -verbosity=0 \
    -detect_leaks="$(leaks "$name")" -max_len="${LENGTH:-1024}" $dictionary \
    -artifact_prefix="build/fuzz/found/$name/" "build/fuzz/corpus/$name" "tests/fuzz/corpus/$name" || failed="$failed $name"
done
[ -z "$failed" ] || { echo "found something in:$failed (see build/fuzz/found)" >&2; exit 1; }
