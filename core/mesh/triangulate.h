/* Polygons with corners in space, concave, with holes, not quite planar, or plainly wrong, to triangles.
 *
 * The polygon is seen along one axis: the one that leaves the largest area, so coordinates stay the file's own and every decision is an
 * exact predicate. A polygon that is simple in that view (or, failing that, in another one) gets triangles that cover it without
 * overlap and are then flipped until opposite angles are small (Delaunay). One that winds the wrong way round some place in every view,
 * as a figure of eight does, still gets a complete set of triangles, those of least area in space, and a flag. (What a polygon winds
 * around twice, as a pentagram its middle, is covered twice.) */
#ifndef LOD_CORE_MESH_TRIANGULATE_H
#define LOD_CORE_MESH_TRIANGULATE_H

#include <stddef.h>

#include "core/mesh/mesh.h"

enum lod_triangulate_flag {
  LOD_TRIANGULATE_CROSSED = 1,    /* a figure of eight in every view, or too intricate for bounded time: triangles overlap */
  LOD_TRIANGULATE_DEGENERATE = 2, /* all corners lie on one line: triangles have no area */
};

/* Triangles that corner_count corners in loop_count loops make: corners + 2 * holes - 2; 0 when the outer loop has less than 3 corners. */
static inline size_t lod_triangulate_count(const uint32_t *loop_sizes, uint32_t loop_count) {
  size_t corners = 0;
  for (uint32_t i = 0; i < loop_count; i++)
    corners += loop_sizes[i];
  return loop_count == 0 || loop_sizes[0] < 3 ? 0 : corners + 2 * ((size_t)loop_count - 1) - 2;
}

/* Fails with LOD_MEMORY alone; a bad polygon is flagged, not refused. Triangles look the way the outer loop does (Newell's normal).
 *
 * positions: finite; at least as many as the largest vertex index + 1
 * loops: vertex indices of all loops, one behind the other: the outer loop first, then holes, which may turn either way
 * loop_sizes: corners of each loop, at least 1; the same vertex may appear in several corners
 * loop_count: 1 + number of holes
 * arena: for scratch, which is freed before the return; triangles and quads need none
 * triangles: room for lod_triangulate_count; filled with *corner numbers*: indices into `loops`, so that per-corner attributes follow
 * flags: lod_triangulate_flag bits; may be NULL */
LOD_WARN_UNUSED enum lod_status lod_triangulate_polygon(const float (*positions)[3], const uint32_t *loops, const uint32_t *loop_sizes,
                                                        uint32_t loop_count, struct lod_arena *arena, uint32_t (*triangles)[3],
                                                        uint32_t *flags);

#endif
