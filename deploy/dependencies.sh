#!/bin/sh
# Installs the Debian packages that building, running and testing need, if any is missing. Debian 12; root or sudo.
set -eu

packages="gcc g++ clang llvm make pkg-config ca-certificates curl openssl xz-utils
 libmicrohttpd-dev libgnutls28-dev libsqlite3-dev libjansson-dev nettle-dev zlib1g-dev libpng-dev
 libdraco-dev libtinygltf-dev nlohmann-json3-dev libassimp-dev libcurl4-gnutls-dev libseccomp-dev
 nginx-light libcmocka-dev libmeshoptimizer-dev libclang-rt-14-dev clang-format
 lld wasi-libc libclang-rt-14-dev-wasm32
 chromium fonts-dejavu-core libgl1-mesa-dri libegl1"
# What an image is built from needs no tests.
if [ "${DEPENDENCIES:-all}" = build ]; then
  packages="gcc g++ clang lld wasi-libc libclang-rt-14-dev-wasm32 make pkg-config ca-certificates libmicrohttpd-dev libgnutls28-dev libsqlite3-dev libjansson-dev nettle-dev zlib1g-dev
 libpng-dev libdraco-dev libtinygltf-dev nlohmann-json3-dev libassimp-dev libcurl4-gnutls-dev libseccomp-dev"
fi
# The web client and its tests need node 18 or newer; a node that is already there is fine.
if ! command -v node >/dev/null 2>&1 || ! command -v npm >/dev/null 2>&1; then
  packages="$packages nodejs npm"
fi

missing=""
for package in $packages; do
  if ! dpkg-query -W -f='${Status}' "$package" 2>/dev/null | grep -q 'install ok installed'; then
    missing="$missing $package"
  fi
done
[ -n "$missing" ] || exit 0

echo "Installing missing Debian packages:$missing" >&2
as_root=""
if [ "$(id -u)" -ne 0 ]; then
  command -v sudo >/dev/null 2>&1 || { echo "These packages are missing and there is no sudo; as root run: apt-get install$missing" >&2; exit 1; }
  as_root="sudo"
fi
export DEBIAN_FRONTEND=noninteractive
$as_root apt-get update -q >&2
# shellcheck disable=SC2086
$as_root apt-get install -y -q --no-install-recommends $missing >&2
