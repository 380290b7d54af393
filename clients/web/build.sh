#!/bin/sh
# Builds the viewer into DIR: one page, its scripts, style and decoders; nothing in it comes from another host. Nothing to do when DIR is
# newer than every source. The daemon serves DIR/index.html at / and DIR/NAME at /viewer/NAME. Also installs what tests/web
# needs, unless DEPENDENCIES=build.
#
#   clients/web/build.sh DIR
set -eu

[ $# -eq 1 ] || { echo "usage: $0 DIR" >&2; exit 2; }
mkdir -p "$1"
out=$(cd "$1" && pwd)
here=$(cd "$(dirname "$0")" && pwd)
tests=$(cd "$here/../../tests/web" && pwd)

# npm ci when the lock file is newer than what was installed from it.
install_packages() {
  if [ ! -e "$1/node_modules/.installed" ] || [ "$1/package-lock.json" -nt "$1/node_modules/.installed" ]; then
    (cd "$1" && npm ci --no-fund --no-audit --loglevel=error >&2)
    touch "$1/node_modules/.installed"
  fi
}
install_packages "$here"
[ "${DEPENDENCIES:-all}" = build ] || install_packages "$tests"

# The WebAssembly modules have sources of their own, which make knows.
make -s -C "$here/../.." wasm >&2
for module in "$here"/../../build/wasm/*.wasm; do
  cmp -s "$module" "$out/$(basename "$module")" || cp "$module" "$out/"
done

stamp="$out/.built"
if [ -e "$stamp" ] && [ -z "$(find "$here/src" "$here/build.sh" "$here/package-lock.json" -newer "$stamp" | head -n 1)" ]; then
  exit 0
fi

three="$here/node_modules/three/examples/jsm/libs"
mkdir -p "$out/draco"
"$here/node_modules/.bin/esbuild" "$here/src/viewer/app.js" "$here/src/three/normals-worker.js" \
  "$here/src/wasm/core-worker.js" "$here/src/viewer/refine-app.js" "$here/src/viewer/patches-app.js" \
  --bundle --format=esm --minify --sourcemap --target=es2022 --legal-comments=linked --log-level=warning \
  --entry-names='[name]' --outdir="$out"
cp "$three/draco/gltf/draco_wasm_wrapper.js" "$three/draco/gltf/draco_decoder.wasm" "$three/draco/gltf/draco_decoder.js" "$out/draco/"
cp "$here/src/viewer/style.css" "$here/src/viewer/icon.svg" "$out/"
cp "$here/src/viewer/index.html" "$here/src/viewer/refine.html" "$here/src/viewer/patches.html" "$out/"
touch "$stamp"
