#!/bin/bash
# Checks the rules of the house that a compiler does not: who may include whom, what is linked where, format, a README in every
# folder, nothing left for later. Prints "file:line: what is wrong. What to do." and fails when there is any such line.
#
#   tests/lint/lint.sh [ROOT [CHECK...]]    ROOT: another tree than this one, CHECK: these alone (for the lint's own tests)
set -u
export LC_ALL=C
helpers=$(cd "$(dirname "$0")" && pwd)
cd "${1:-$helpers/../..}" || exit 1
found=$(mktemp) || exit 1
trap 'rm -f "$found"' EXIT

# Files that belong to the tree: tracked or about to be.
if [ "$(git rev-parse --show-toplevel 2>/dev/null)" = "$PWD" ]; then
  list() { git ls-files -co --exclude-standard -- "$@" | while read -r file; do [ ! -e "$file" ] || echo "$file"; done; }
else
  list() { for pattern in "$@"; do find . -path "./${pattern/#\*/*}" -type f | grep -v '^\./build/' | cut -c3-; done; }
fi
sources=$(list '*.c' '*.h' '*.cc' | sort)

check_includes() {
  [ -z "$sources" ] || awk -v root=. -f "$helpers/includes.awk" $sources
}

# File size: a file that outgrows about 800 lines is split by concept.
check_sizes() {
  for file in $sources; do
    lines=$(wc -l <"$file")
    [ "$lines" -le 900 ] || echo "$file:$lines: has $lines lines, over about 800. Split it by concept."
  done
}

# The word is put together so that this file does not hold it.
check_leftovers() {
  local words='TO''DO|FIX''ME|X''XX|HA''CK'
  list '*.c' '*.h' '*.cc' '*.sh' '*.awk' '*.js' '*.mjs' '*.ts' '*.html' '*.css' '*.md' Makefile | sort -u | while read -r file; do
    grep -nE "(^|[^A-Za-z0-9_])($words)([^A-Za-z0-9_]|$)" "$file" | sed -E "s|^([0-9]+):.*|$file:\1: leaves work for later. Do it now, or file an issue and say in the comment what holds today.|"
  done
}

check_readmes() {
  for folder in $(echo "$sources" | grep -E '^(core|codec|server)/' | sed 's|/[^/]*$||' | sort -u) core codec server; do
    [ -d "$folder" ] || continue
    [ -e "$folder/README.md" ] || echo "$folder: has sources but no README.md. Say in ten lines what lives there and in which order to read it."
  done | sort -u
}

check_format() {
  command -v clang-format >/dev/null 2>&1 || return 0
  [ -e .clang-format ] && [ -n "$sources" ] || return 0
  echo "$sources" | xargs clang-format --dry-run -Werror 2>&1 | sed -nE 's/^([^: ]+):([0-9]+):[0-9]+: error: code should be clang-formatted.*/\1 \2/p' |
    awk '!seen[$1]++ { printf "%s:%d: is not formatted. Run `make format`.\n", $1, $2 }'
}

# Link rules, on what has been built. core: no I/O, no clock, no randomness, no mutable globals. lodestreamd: no geometry, no codec.
check_objects() {
  local io='f?open(64|at|at64|dir)?|fdopen|freopen(64)?|tmpfile(64)?|fread|fwrite|f?putc|f?puts|f?getc|f?gets|getchar|putchar|v?f?printf|v?f?scanf|_?_?v?f?printf_chk|perror|std(in|out|err)|read|write|pread(64)?|pwrite(64)?|close|lseek(64)?|mmap(64)?|unlink|rename|stat(64)?|socket|connect|send|recv|getenv|secure_getenv|setenv|system|fork|exec[vl]p?e?|time|clock|clock_gettime|gettimeofday|s?rand(om)?|rand_r|drand48|arc4random|getrandom|exit|_exit'
  # One nm for all of them: a process for each file would take minutes.
  local objects
  objects=$(for source in $(echo "$sources" | grep -E '^core/.*\.c$'); do
    [ ! -e "build/release/${source%.c}.o" ] || echo "build/release/${source%.c}.o"
  done)
  [ -n "$objects" ] || return 0
  nm -A -u $objects | sed -nE "s/^build\/release\/(.*)\.o: *U ($io)(@.*)?$/\1.c: calls \2. core does no I\/O, asks no clock and draws no chance: take it as a parameter or move it up./p"
  nm -A -f sysv $objects | awk -F'|' '{ gsub(/ /, "") } $7 ~ /^\.(data|bss|tdata|tbss)(\.[^r].*)?$/ && $4 ~ /OBJECT|TLS/ {
    split($1, at, ".o:"); sub(/^build\/release\//, "", at[1])
    printf "%s.c: has the global variable %s. core keeps its state in arguments: make it const or pass it in.\n", at[1], at[2] }'
}

check_daemon() {
  local daemon=build/release/lodestreamd
  [ -x "$daemon" ] || return 0
  ldd "$daemon" 2>/dev/null | grep -oE 'lib(draco|assimp|tinygltf)[^ ]*' | sort -u | while read -r library; do
    echo "$daemon: links $library. The daemon has no codec: see LIBS_daemon in the Makefile."
  done
  for library in core codec worker; do
    [ -e build/release/lib$library.a ] || continue
    { nm --defined-only build/release/lib$library.a 2>/dev/null | awk '$2 ~ /^[TDBR]$/ { print $3 }' | sort -u
      [ $library != worker ] || nm --defined-only build/release/server/jobs/{frame,refine_query}.o 2>/dev/null | awk 'NF == 3 { print $3, "shared" }'
    } | awk 'NF == 2 { shared[$1] = 1; next } { name[$1] = 1 } END { for (n in name) if (!(n in shared)) print n }' | sort >"$found.library"
    nm --defined-only "$daemon" | awk '$2 ~ /^[TDBR]$/ { print $3 }' | sort -u >"$found.daemon"
    comm -12 "$found.library" "$found.daemon" | grep -E '^lod_' | head -n 3 | while read -r symbol; do
      echo "$daemon: holds $symbol of lib$library. The daemon links core/base and core/level/screen alone."
    done
    rm -f "$found.library" "$found.daemon"
  done
}

checks="includes sizes leftovers readmes format objects daemon"
[ $# -lt 2 ] || checks=${*:2}
for check in $checks; do
  "check_$check"
done >"$found"
if [ -s "$found" ]; then
  cat "$found"
  echo "lint: $(wc -l <"$found") to mend"
  exit 1
fi
echo "lint: $(echo "$sources" | grep -c .) files keep the rules$([ -x build/release/lodestreamd ] || echo '; link rules of lodestreamd wait until it is built')"
