/* Draco 1.5 behind a C interface: one triangle mesh in, one buffer out, and back. No exception and no C++ type crosses it.
 *
 * Positions are integers on a grid whose every point is exactly a float: origin and step are whole multiples of one power of two U, and
 * nothing that Draco or a client computes needs more than 24 bits of U. Quantising and dequantising are then free of rounding, with or
 * without fused multiply-add, natively and in WebAssembly: the decoded position is lod_draco_grid_point() to the bit. */
#ifndef LOD_CODEC_EXPORT_DRACO_H
#define LOD_CODEC_EXPORT_DRACO_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/arena.h"
#include "core/base/status.h"

#ifdef __cplusplus
extern "C" {
#endif

/* ---- the grid ---- */

/* Points origin[i] + step * q, 0 <= q < 2^bits, of at most three axes. */
struct lod_draco_grid {
  float origin[3];
  float step;
  int bits; /* 1 to 24 */
};

/* The coarsest grid over the box whose step is at most `step` (> 0), or the finest that floats of this size can hold exactly: about
 * 2^23 steps across the larger of twice the box's longest side and its largest absolute coordinate. min, max: `axes` (1 to 3) finite
 * floats each. */
struct lod_draco_grid lod_draco_grid_make(const float *min, const float *max, int axes, double step);

/* The grid point nearest to value on an axis, clamped to the grid. */
int32_t lod_draco_grid_index(const struct lod_draco_grid *grid, int axis, float value);

/* What every decoder makes of index q. */
float lod_draco_grid_point(const struct lod_draco_grid *grid, int axis, int32_t q);

/* ---- attributes ---- */

/* Draco's own numbering. */
enum lod_draco_kind { LOD_DRACO_POSITION = 0, LOD_DRACO_NORMAL, LOD_DRACO_COLOR, LOD_DRACO_TEXCOORD, LOD_DRACO_GENERIC };

/* glTF 2.0 componentType; 5124 is not in glTF but in Draco. */
enum lod_draco_component {
  LOD_DRACO_INT8 = 5120,
  LOD_DRACO_UINT8 = 5121,
  LOD_DRACO_INT16 = 5122,
  LOD_DRACO_UINT16 = 5123,
  LOD_DRACO_INT32 = 5124,
  LOD_DRACO_UINT32 = 5125,
  LOD_DRACO_FLOAT = 5126,
};
size_t lod_draco_component_size(enum lod_draco_component component);

/* ---- encode ---- */

/* An attribute besides positions: value_count values, and which of them each point has. NORMAL: 3 floats of unit length, coded
 * octahedrally with `bits` (2 to 30). TEXCOORD and GENERIC: floats on `grid` (1 to 3 components), or integers as they are. COLOR: UINT8
 * or UINT16, normalised, 3 or 4 components. Two points of one vertex that share a value index have no seam between them. */
struct lod_draco_input {
  enum lod_draco_kind kind;
  enum lod_draco_component component;
  int components;
  uint32_t unique_id; /* what KHR_draco_mesh_compression calls it; positions have 0 */
  const void *values; /* value_count * components, packed */
  uint32_t value_count;
  const uint32_t *point_values; /* point_count value indices */
  int bits;                     /* NORMAL only */
  struct lod_draco_grid grid;   /* float TEXCOORD and GENERIC only */
};

enum { LOD_DRACO_MAX_INPUTS = 8 };

struct lod_draco_encode_request {
  uint32_t vertex_count;
  const int32_t (*positions)[3]; /* vertex_count grid indices */
  struct lod_draco_grid grid;
  uint32_t point_count;           /* a point is a vertex with one set of attributes; no two points may be equal in all of them */
  const uint32_t *point_vertices; /* point_count; NULL: point i is vertex i */
  uint32_t triangle_count;        /* at least 1; triangles with two equal vertices are lost */
  const uint32_t (*triangles)[3]; /* point indices */
  uint32_t input_count;
  const struct lod_draco_input *inputs;
  int speed;       /* 0 = smallest ... 10 = fastest */
  bool sequential; /* plain index coding in place of Edgebreaker: fewer bytes for a few unconnected triangles */
};

/* *points, *triangles: what a decoder will report (accessor counts). *bytes in `arena`. Fails with LOD_MEMORY or LOD_LIMIT (more than
 * Draco can take). */
LOD_WARN_UNUSED enum lod_status lod_draco_encode(const struct lod_draco_encode_request *request, struct lod_arena *arena, uint8_t **bytes,
                                                 size_t *size, uint32_t *points, uint32_t *triangles, struct lod_problem *problem);

/* ---- decode ---- */

struct lod_draco_limits {
  uint64_t max_vertices;  /* points of one buffer; 0 = no limit */
  uint64_t max_triangles; /* 0 = no limit */
};

struct lod_draco_attribute {
  enum lod_draco_kind kind;
  uint32_t unique_id;
  enum lod_draco_component component;
  int components; /* 1 to 16 */
  bool normalized;
  void *values; /* point_count * components, packed, in their own type; quantised floats come as floats */
};

struct lod_draco_mesh {
  uint32_t point_count, triangle_count, attribute_count;
  uint32_t (*triangles)[3];
  struct lod_draco_attribute *attributes;
};

/* Counts as the buffer's header declares them, without decoding. */
struct lod_draco_header {
  bool mesh; /* false: a point cloud */
  uint32_t declared_vertices, declared_triangles;
};
LOD_WARN_UNUSED enum lod_status lod_draco_inspect(const uint8_t *bytes, size_t size, struct lod_draco_header *header,
                                                  struct lod_problem *problem);

/* Decodes any Draco mesh. Declared counts are checked against `limits` (NULL: none) and against what `size` bytes can hold before
 * anything is allocated for them. Every index is in range afterwards; floats may be non-finite where the file says so. Fails with
 * LOD_BAD_INPUT, LOD_LIMIT ("limit-vertices", "limit-triangles"), LOD_UNSUPPORTED (a point cloud, 64-bit integers) or LOD_MEMORY. */
LOD_WARN_UNUSED enum lod_status lod_draco_decode(const uint8_t *bytes, size_t size, const struct lod_draco_limits *limits,
                                                 struct lod_arena *arena, struct lod_draco_mesh *mesh, struct lod_problem *problem);

/* By KHR_draco_mesh_compression id; NULL when there is none. */
const struct lod_draco_attribute *lod_draco_find(const struct lod_draco_mesh *mesh, uint32_t unique_id);

/* The values as floats, integers scaled by glTF's rule where normalised; NULL on memory. */
float *lod_draco_floats(const struct lod_draco_mesh *mesh, const struct lod_draco_attribute *attribute, struct lod_arena *arena);

#ifdef __cplusplus
}
#endif

#endif
