#!/bin/sh
# `make run`: serves generated sample models from build/run and prints the viewer's address. Ctrl-C stops it.
# LISTEN=address:port (default 127.0.0.1:8080; the next free port when it is taken)
set -eu
built=${1:-build/release}
store=build/run/store
samples=build/run/models
mkdir -p "$store" "$samples"
for name in knot tree; do
  [ -f "$samples/$name.ply" ] || { "$built/tests/sample/sample" "$name" "$samples/$name.ply.part" && mv "$samples/$name.ply.part" "$samples/$name.ply"; }
done

listen=${LISTEN:-127.0.0.1:8080}
port=${listen##*:}
if [ -z "${LISTEN:-}" ] && command -v curl >/dev/null 2>&1; then
  while curl -s -o /dev/null --max-time 1 "http://127.0.0.1:$port/healthz"; do
    port=$((port + 1))
  done
  listen=127.0.0.1:$port
fi
echo "Lodestream: open http://$listen/ (Ctrl-C stops it). Models put into $samples are baked and served; or:"
echo "  curl -T model.glb http://$listen/v1/models/my-model"
exec "$built/lodestreamd" --store "$store" --models "$samples" --viewer build/web --listen "$listen"
