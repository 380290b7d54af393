/* Triangles with attributes, and the segments and points that clustering leaves behind.
 *
 * Geometry and attributes have separate indices, as in OBJ: `triangles` index positions (welded, so that neighbours share vertices),
 * `corners` index wedges, a wedge being one vertex with one set of attributes. A vertex on a UV seam or crease has several wedges; a
 * wedge belongs to exactly one vertex. A mesh without attributes has wedge_count 0 and corners NULL.
 *
 * Arrays are transparent and belong to the arena they came from; "NULL" below means that the mesh does not have that attribute. All
 * coordinates are finite. Triangles may be degenerate, duplicated, non-manifold: this is a soup until an algorithm asks for more. */
#ifndef LOD_CORE_MESH_MESH_H
#define LOD_CORE_MESH_MESH_H

#include <stdbool.h>
#include <stdint.h>

#include "core/base/arena.h"
#include "core/base/status.h"
#include "core/base/vec.h"

#define LOD_NONE UINT32_MAX /* "no index" */

enum { LOD_UV_SETS = 2 };

struct lod_mesh {
  uint32_t vertex_count;
  uint32_t triangle_count;
  uint32_t edge_count;  /* free-standing segments */
  uint32_t point_count; /* free-standing points */
  uint32_t wedge_count;

  float (*positions)[3];    /* vertex_count; model units */
  uint32_t (*triangles)[3]; /* triangle_count; vertex indices, counter-clockwise seen from outside */
  uint32_t (*corners)[3];   /* triangle_count; wedge indices; NULL when wedge_count is 0 */
  uint32_t *wedge_vertex;   /* wedge_count; the vertex that a wedge belongs to; NULL when wedge_count is 0 */

  /* vertex_count; how far a level may be from the source here, in units of `positions` (0 = not at all, INFINITY = as far as anywhere),
   * linear in between: what a file's vertices say for themselves (Varshney 1995, epsilon by region); or NULL. Levels have none. */
  float *limits;

  float (*normals)[3];          /* wedge_count, unit length; or NULL */
  float (*uvs[LOD_UV_SETS])[2]; /* wedge_count; or NULL each */
  float (*colors)[4];           /* wedge_count, linear RGBA in [0, 1]; or NULL */

  uint32_t *materials; /* triangle_count; index into lod_model.materials, LOD_NONE = default material; or NULL = all default */
  uint32_t *parts;     /* triangle_count; index into lod_model.parts; or NULL = all belong to one part */

  uint32_t (*edges)[2];     /* edge_count; vertex indices */
  float *edge_thickness;    /* edge_count; diameter in model units (Low & Tan 1997, 3.3.1); or NULL = 0 */
  uint32_t *edge_materials; /* edge_count; as materials; or NULL */
  uint32_t *edge_parts;     /* edge_count; as parts; or NULL */

  uint32_t *points;          /* point_count; vertex indices */
  float *point_thickness;    /* point_count; diameter in model units; or NULL = 0 */
  uint32_t *point_materials; /* point_count; or NULL */
  uint32_t *point_parts;     /* point_count; or NULL */
};

/* Axis-aligned box of the positions and half of what a viewer needs. An empty mesh gives min = max = 0. */
struct lod_bounds {
  double min[3], max[3];
};
struct lod_bounds lod_mesh_bounds(const struct lod_mesh *mesh);
double lod_bounds_diagonal(const struct lod_bounds *bounds);

/* Largest absolute coordinate: the magnitude of lod_tolerance_rounding. */
double lod_mesh_magnitude(const struct lod_mesh *mesh);

/* Every index in range, every coordinate finite, every wedge with one vertex, corners agreeing with triangles. On false `problem`
 * (may be NULL) says what is wrong. For assertions around mutators and for input that claims to be a mesh. */
bool lod_mesh_check(const struct lod_mesh *mesh, struct lod_problem *problem);

/* Welds vertices of equal position (bitwise after -0 becomes +0). Wedges with equal vertex and equal attributes become one. Triangles
 * keep their number and order, degenerate ones included. `vertex_map` (may be NULL): old vertex -> new, allocated from arena.
 * Vertices that no triangle, edge or point uses disappear; vertex_map then says LOD_NONE. */
LOD_WARN_UNUSED enum lod_status lod_mesh_weld(const struct lod_mesh *mesh, struct lod_arena *arena, struct lod_mesh *welded,
                                              uint32_t **vertex_map);

#endif
