/* Features: the edges that a person sees as lines, and the lines they form.
 *
 * Based on: shared checklist 2.1.4 after Turk. Re-Tiling Polygonal Surfaces. 1992: an edge is a feature when the surface ends there, bends
 * by more than an angle, or changes material or texture chart. A feature vertex is a corner when its feature edges are not two, or are two
 * that turn sharply; lines run from corner to corner, or around. */
#ifndef LOD_CORE_MESH_FEATURE_H
#define LOD_CORE_MESH_FEATURE_H

#include "core/mesh/adjacency.h"

enum lod_feature_flag {
  LOD_FEATURE_BOUNDARY = 1,      /* of one triangle */
  LOD_FEATURE_CREASE = 2,        /* the two triangles' normals differ by more than the crease angle */
  LOD_FEATURE_MATERIAL = 4,      /* material or part differs across it */
  LOD_FEATURE_UV_SEAM = 8,       /* a UV set jumps across it, at either end */
  LOD_FEATURE_NON_MANIFOLD = 16, /* of more than two triangles */
};

struct lod_feature_settings {
  double crease_degrees; /* default LOD_TOLERANCE_CREASE_DEGREES; 180 = no creases */
  double corner_degrees; /* a line that turns by more than this has a corner there; default 45 */
  uint32_t flags;        /* which features are looked for; default all */
};
struct lod_feature_settings lod_feature_defaults(void);

struct lod_features {
  uint8_t *edges;        /* adjacency.edge_count; lod_feature_flag bits, 0 = no feature */
  uint32_t *degree;      /* vertex_count; feature edges at the vertex, 0 = inside a face */
  bool *corners;         /* vertex_count; the vertex must stay where it is: degree 1, 3 or more, or a sharp turn */
  uint32_t edge_count;   /* edges with any flag */
  uint32_t corner_count; /* vertices that are corners */

  uint32_t line_count;
  uint32_t *line_begin; /* line_count + 1 */
  uint32_t
      *line_vertices;  /* of line i: from line_begin[i] up to line_begin[i + 1]; a line that goes around ends in the vertex it began with */
  uint8_t *line_flags; /* line_count; bits that all its edges share */
};

/* Marks edges of `mesh` and strings them to lines: every feature edge is in exactly one. A triangle without area makes no crease: its
 * normal says nothing. settings: NULL = defaults. Results go to `arena`. Fails with LOD_MEMORY alone. */
LOD_WARN_UNUSED enum lod_status lod_feature_find(const struct lod_mesh *mesh, const struct lod_adjacency *adjacency,
                                                 const struct lod_feature_settings *settings, struct lod_arena *arena,
                                                 struct lod_features *features);

#endif
