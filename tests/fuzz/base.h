/* The level that fuzzed deltas and units start from. */
#ifndef LOD_TESTS_FUZZ_BASE_H
#define LOD_TESTS_FUZZ_BASE_H

#include "tests/data/shapes.h"

/* A small sphere, made once: a run is short, and decoders only read it. */
static const struct lod_mesh *lod_fuzz_base(void) {
  static struct lod_mesh sphere;
  static struct lod_arena *kept;
  if (kept == NULL) {
    kept = lod_arena_create((size_t)64 << 20);
    sphere = lod_shape_sphere(kept, 1, 1);
  }
  return &sphere;
}

#endif
