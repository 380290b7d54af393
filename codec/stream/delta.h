/* The step from a level to the next finer one of a nested family, in few bytes, and the first level in the same form.
 *
 * A delta holds the connectivity of the finer level, where in it the vertices of the coarser one are, and the rest of its positions as
 * differences from the smoothest surface through those (a least-squares mesh). The result is the finer level to the bit: the same
 * positions, triangles, parts and materials that its GLB decodes to, so its certified error is that level's error.
 *
 * Based on: Gumhold, Strasser. Real Time Compression of Triangle Mesh Connectivity. 1998, and Alliez, Desbrun. Valence-Driven Connectivity
 * Encoding for 3D Meshes. 2001 (connectivity); Sorkine, Cohen-Or. Least-squares Meshes. 2004 (prediction); Mahoney. Adaptive Weighing of
 * Context Models for Lossless Data Compression. 2005 (mixing of contexts). codec/FORMAT.md, section 6, describes every byte.
 *
 * A frame is one step of one unit of a model. Frames follow each other without padding and can be used as they arrive: the header says how
 * long a frame is.
 *
 * Decoding needs libc, core/base and core/mesh, one thread, and integers, + - * / and sqrt alone: natively and in WebAssembly it gives the
 * same bits. Every length is checked; what decoding takes is known from the header before anything is allocated. */
#ifndef LOD_CODEC_STREAM_DELTA_H
#define LOD_CODEC_STREAM_DELTA_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/arena.h"
#include "core/base/status.h"
#include "core/mesh/mesh.h"

#define LOD_DELTA_TYPE "application/vnd.lodestream.delta"

enum {
  LOD_DELTA_VERSION = 3,
  LOD_DELTA_MAX_HEADER_BYTES = 160, /* as many bytes as are there, up to this many, are enough for lod_delta_inspect */
};

/* Positions are origin + step * q per axis in float arithmetic, 0 <= q < 2^24: codec/export/draco.h's grid. */
struct lod_delta_grid {
  float origin[3];
  float step; /* > 0 */
};

struct lod_delta_header {
  uint32_t version;
  uint32_t from, to;         /* levels of the family; from is LOD_NONE where the frame needs no base: a first picture */
  uint32_t unit, unit_count; /* which of the model's units, of how many */
  uint32_t base_vertices;    /* of the coarser level's unit; 0 without base */
  uint32_t vertices, triangles, edges, points, wedges; /* of the finer one */
  struct lod_delta_grid grid;                          /* of the finer one */
  uint32_t base_checksum;                              /* lod_delta_checksum of the coarser one */
  uint32_t checksum;                                   /* and of the finer one */
  size_t header_bytes;                                 /* where the body begins */
  size_t size;                                         /* of the whole frame */
  uint64_t memory_bytes;                               /* at most, for decoding and the result; a function of the counts */
};

/* Reads a frame's header from the first `size` bytes of it, which may be fewer than the frame has. LOD_BAD_INPUT "truncated" where they do
 * not hold the whole header, "delta" where it is wrong; LOD_UNSUPPORTED "delta-version". */
LOD_WARN_UNUSED enum lod_status lod_delta_inspect(const uint8_t *bytes, size_t size, struct lod_delta_header *header,
                                                  struct lod_problem *problem);

/* Of positions, triangles, segments and points, not of their order, nor of parts, materials and attributes. Vertices must all be at
 * different positions. LOD_MEMORY only. */
LOD_WARN_UNUSED enum lod_status lod_delta_checksum(const struct lod_mesh *mesh, struct lod_arena *arena, uint32_t *checksum);

/* ---- decode ---- */

struct lod_delta_limits {
  uint64_t max_vertices, max_triangles; /* 0 = no limit */
  uint64_t max_memory_bytes;            /* 0 = no limit */
};

/* The finer level, in the arena given. */
struct lod_delta_level {
  /* Vertices in the order of the stream; parts and materials of the model; UVs and colours to the bit, normals within half a step of
   * normal_bits, or within normal_degrees where they are computed from the surface. */
  struct lod_mesh mesh;
  const uint32_t *kept; /* base_vertices: base vertex (in the order that the base was given in) -> the same vertex in mesh, or LOD_NONE;
                           NULL without base */
};

/* Decodes the frame that begins at `bytes`; `size` may be more than it has. base: the coarser level's unit as its GLB, or the delta before
 * it, decodes to, vertices and triangles in any order; of it only positions, triangles, segments and points are read, and their checksum
 * must be the header's ("wrong-base"). NULL when header.from is LOD_NONE. limits: NULL = none. Fails with LOD_BAD_INPUT, LOD_UNSUPPORTED,
 * LOD_LIMIT or LOD_MEMORY and leaves the base as it was. */
LOD_WARN_UNUSED enum lod_status lod_delta_decode(const uint8_t *bytes, size_t size, const struct lod_mesh *base,
                                                 const struct lod_delta_limits *limits, struct lod_arena *arena,
                                                 struct lod_delta_level *level, struct lod_problem *problem);

/* A frame of a stream of units (units.h), whose index has what its short header lacks: `header` comes in with from, to, unit, unit_count,
 * base_vertices, vertices, triangles and grid. primer: what the models of another frame had learnt, or NULL; memory: NULL, or where what
 * this one's had learnt goes, in the arena. Neither the base's checksum nor the result's is looked at. */
struct lod_coder_memory;
LOD_WARN_UNUSED enum lod_status lod_delta_decode_part(const uint8_t *bytes, size_t size, const struct lod_delta_header *header,
                                                      const struct lod_mesh *base, const struct lod_delta_limits *limits,
                                                      const struct lod_coder_memory *primer, struct lod_arena *arena,
                                                      struct lod_coder_memory **memory, struct lod_delta_level *level,
                                                      struct lod_problem *problem);

/* ---- encode ---- */

/* Bits by part of the stream, for benches. */
struct lod_delta_statistics {
  double connectivity, match, kept, geometry, groups, attributes, header; /* bits */
};

struct lod_delta_encode_request {
  const struct lod_mesh *base; /* as a client has it; NULL = none */
  const struct lod_mesh *fine; /* every position on `grid`, all different, no triangle with a vertex twice */
  const uint32_t *kept;        /* base vertex -> fine vertex, or LOD_NONE; each fine vertex at most once; NULL without base */
  struct lod_delta_grid grid;
  uint32_t from, to, unit, unit_count;
  double normal_degrees;                   /* normals are left out where all are within this of what a client computes; 3 */
  int normal_bits;                         /* octahedral, 2 to 16; 8 */
  struct lod_delta_statistics *statistics; /* NULL, or where bits are counted */
  bool part;                               /* a frame for lod_delta_decode_part, with these: */
  const struct lod_coder_memory *primer;
  struct lod_coder_memory **memory;
};
struct lod_delta_encode_request lod_delta_encode_defaults(void);

/* One frame, in `arena`. LOD_BAD_INPUT where the meshes are not what the request says; LOD_MEMORY; LOD_LIMIT. */
LOD_WARN_UNUSED enum lod_status lod_delta_encode(const struct lod_delta_encode_request *request, struct lod_arena *arena, uint8_t **bytes,
                                                 size_t *size, struct lod_problem *problem);

#endif
