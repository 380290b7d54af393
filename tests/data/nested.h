/* Levels as a client decodes them, for tests and benches of deltas: rounded to a grid and welded. */
#ifndef LOD_TESTS_DATA_NESTED_H
#define LOD_TESTS_DATA_NESTED_H

#include "codec/stream/delta.h"

struct lod_rounded {
  struct lod_mesh mesh;
  struct lod_delta_grid grid;
  uint32_t *map; /* vertex before rounding -> vertex of mesh, or LOD_NONE */
};

/* Rounds to a grid of about this step; equal vertices become one, triangles that collapse go. Aborts when memory is out. */
struct lod_rounded lod_round_mesh(const struct lod_mesh *mesh, double step, struct lod_arena *arena);

/* kept for lod_delta_encode: parents: vertex of the coarser mesh before rounding -> vertex of the finer one before rounding, LOD_NONE =
 * none.
 */
uint32_t *lod_round_kept(const struct lod_rounded *coarse, const struct lod_rounded *fine, const uint32_t *parents, uint32_t parent_count,
                         struct lod_arena *arena);

#endif
