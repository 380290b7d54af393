# Include rules of the house (design section 2). Reads C and C++ files named by their path from the root; prints
# "file:line: what is wrong. What to do." for each breach. -v root=DIR finds included files.

function area(path) {
  if (path ~ /^core\/(base|mesh|level)\//) { split(path, part, "/"); return part[2] }
  if (path ~ /^core\//) { split(path, part, "/"); return "family " part[2] }
  if (path ~ /^codec\/import\//) return "import"
  if (path ~ /^codec\//) return "codec"
  if (path ~ /^server\/worker\//) return "worker"
  if (path ~ /^server\//) return "daemon"
  if (path ~ /^clients\//) return "clients"
  if (path ~ /^tests\//) return "tests"
  return "other"
}

function complain(sentence) { printf "%s:%d: %s\n", FILENAME, FNR, sentence }

# What a format's importer is called; files in codec/import that start with another word are shared by all of them.
function importer(path,   name) {
  if (path !~ /^codec\/import\//) return ""
  name = path
  sub(/^codec\/import\//, "", name)
  sub(/[._].*/, "", name)
  return name ~ /^(gltf|drc|assimp|ply|stl|obj|off|hoppe|bezier|patches)$/ ? name : ""
}

function check_ours(to,   from, target, path) {
  path = root "/" to
  if ((getline ignored < path) < 0) {
    # Generated files aside, every include of ours is written from the root.
    complain("includes \"" to "\", which is not there. Write the path from the repository's root.")
    return
  }
  close(path)
  from = area(FILENAME)
  target = area(to)
  if (from ~ /^(base|mesh|level|family)/) {
    if (target !~ /^(base|mesh|level|family)/) complain("core includes \"" to "\". core knows nothing outside core: pass data in, or move the code up.")
    else if (from == "base" && target != "base") complain("core/base includes \"" to "\". core/base is the lowest layer: move what it needs down into core/base.")
    else if (from == "mesh" && target != "base" && target != "mesh") complain("core/mesh includes \"" to "\". core/mesh may use core/base alone: move what it needs down.")
    else if (from == "level" && target ~ /^family/) complain("core/level includes \"" to "\". Families use core/level, not the other way: go through the interface in hierarchy.h.")
    else if (from ~ /^family/ && target ~ /^family/ && from != target) complain("a family includes another, \"" to "\". Families do not know one another: move what both need down to core/mesh.")
    if (FILENAME ~ /^core\/level\/screen\./ && target != "base" && to != "core/level/screen.h") complain("includes \"" to "\". lodestreamd links core/level/screen, so it must not need geometry.")
  } else if (from == "import" || from == "codec") {
    if (target !~ /^(base|mesh|level|family|import|codec)/) complain("codec includes \"" to "\". codec may use core and codec alone: pass data in, or move the code to server/worker.")
    if (from == "import" && to ~ /^codec\/export\// && to != "codec/export/draco.h") complain("an importer includes \"" to "\". Of codec/export only draco.h is shared, for decoding.")
    if (importer(FILENAME) != "" && importer(to) != "" && importer(FILENAME) != importer(to)) complain("an importer includes another, \"" to "\". Importers do not know one another: move what both need to a shared header of codec/import.")
  } else if (from == "daemon") {
    if (target ~ /^(import|codec)$/) complain("lodestreamd includes \"" to "\". The daemon never touches a codec: ask a worker through server/jobs.")
    else if (target ~ /^family|^mesh$/ || (target == "level" && to != "core/level/screen.h")) complain("lodestreamd includes \"" to "\". Of core the daemon may use core/base and core/level/screen.h alone: ask a worker through server/jobs.")
    else if (target == "worker") complain("lodestreamd includes \"" to "\". The daemon does not link the worker: what both need belongs to server/jobs.")
  } else if (from == "worker") {
    if (to ~ /^server\/(http|store)\//) complain("the worker includes \"" to "\". A worker has neither network nor database: send it a frame.")
  }
  if (to == "server/http/loop.h" && FILENAME != "server/http/http.c" && FILENAME != "server/http/loop.c") complain("includes server/http/loop.h, which is for http.c and loop.c alone.")
  if (from !~ /^(tests|clients)$/ && target == "tests") complain("includes \"" to "\". Only tests include tests.")
  if (from != "clients" && from != "tests" && target == "clients") complain("includes \"" to "\". Nothing below a client may know it.")
}

function check_foreign(to,   from) {
  from = area(FILENAME)
  if (to == "microhttpd.h" && FILENAME != "server/http/loop.h") complain("includes <microhttpd.h>. server/http/loop.h alone does, for http.c and loop.c: use server/http/http.h, or forward-declare the struct.")
  if (to ~ /^sqlite3/ && FILENAME != "server/store/catalog.c" && FILENAME !~ /^tests\/unit\/server\/store\//) complain("includes <" to ">. server/store/catalog.c alone does: use server/store/catalog.h.")
  if (to ~ /^draco\// && FILENAME !~ /^codec\/.*\.cc$/) complain("includes <" to ">. The .cc shims of codec alone do: use codec/export/draco.h.")
  if (to ~ /tiny_gltf\.h$/ && FILENAME !~ /^codec\/import\/gltf[a-z_]*\.cc$/) complain("includes <" to ">. codec/import/gltf*.cc alone do: use codec/import/import.h.")
  if (from ~ /^(base|mesh|level|family)/ && to !~ /^(assert|complex|ctype|errno|fenv|float|inttypes|iso646|limits|locale|math|setjmp|signal|stdalign|stdarg|stdatomic|stdbool|stddef|stdint|stdio|stdlib|stdnoreturn|string|tgmath|threads|time|uchar|wchar|wctype)\.h$/ \
      && !(FILENAME == "core/base/parallel.c" && (to == "pthread.h" || to == "unistd.h")))
    complain("core includes <" to ">. core is C17 and libm (pthread.h and unistd.h in core/base/parallel.c): move what needs it up to codec or server.")
}

/^[ \t]*#[ \t]*include[ \t]*["<]/ {
  to = $0
  sub(/^[^"<]*["<]/, "", to)
  sub(/[">].*/, "", to)
  if ($0 ~ /include[ \t]*"/ && to !~ /^(microhttpd|sqlite3|draco\/|.*tiny_gltf)/) check_ours(to)
  else check_foreign(to)
}
