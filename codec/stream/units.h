/* A step in units: patches of the coarser level, the finer triangles over each a frame by itself, so that a client can ask for the part
 * that it looks at first.
 *
 * A stream of units is an index and, behind it, a frame (delta.h) for each patch, all at known places: it is one object that a cache
 * keeps once and clients take parts of (HTTP ranges). The patches are not sent: both sides halve the coarser level's triangles, by the
 * middles of their corners along the longest axis, until none has more than `most_triangles`; integers and the vertices' places alone
 * decide, so whatever order a client has the level in, its patches are the same.
 *
 * The rule for borders: each finer triangle belongs to exactly one patch; a finer vertex between two patches is in both frames, at the same
 * grid indices, so no frame needs its neighbours, and what was decoded is joined by position. All together are the finer level to the bit.
 * The first frame stands right behind the index and comes with it; the models of all others begin with what it has learnt, so that small
 * patches cost little, and they can come in any order. What is drawn of some of them, without cracks: core/mesh/overlay.h,
 * lod_overlay_part. codec/FORMAT.md, section 6.3. */
#ifndef LOD_CODEC_STREAM_UNITS_H
#define LOD_CODEC_STREAM_UNITS_H

#include "codec/stream/delta.h"

#define LOD_UNITS_TYPE "application/vnd.lodestream.units"

enum {
  LOD_UNITS_VERSION = 2,
  LOD_UNITS_INDEX_HEAD = 10,     /* as many bytes tell how long the index is: lod_units_index_bytes */
  LOD_UNITS_TRIANGLES = 2048,    /* default for most_triangles */
  LOD_UNITS_INDEX_MOST = 1 << 24 /* bytes: the longest index that is read */
};

struct lod_units_header {
  uint32_t version;
  uint32_t from, to, unit, unit_count; /* as struct lod_delta_header's */
  bool smooth;                         /* normals are those of the joined surface */
  uint32_t base_vertices, base_checksum;
  uint32_t vertices, triangles, checksum; /* of the whole finer level's unit */
  struct lod_delta_grid grid;
  uint32_t most_triangles, patch_count;
  uint32_t primer_patch;    /* the first one that has a frame (one has): all others begin with what its models have learnt */
  size_t index_bytes, size; /* of the index, of index and frames */
};

/* One patch's part of the stream. size 0: no finer triangle lies there. */
struct lod_units_patch {
  size_t offset, size; /* of its frame, from the index's first byte */
  uint32_t vertices, triangles;
  const uint32_t *coarse; /* of the coarser level's triangles: coarse_count numbers in the order of the mesh that was given, rising */
  uint32_t coarse_count;
  double center[3], radius; /* a ball around those triangles */
  double normal[3];         /* mean of their normals; its length is 1 where all face the same way, less elsewhere */
};

/* An index with the patches that belong to it. Arrays in the arena given to lod_units_open. */
struct lod_units {
  struct lod_units_header header;
  const struct lod_mesh *base;
  struct lod_units_patch *patches; /* header.patch_count */
  struct lod_coder_memory
      *primer; /* NULL until header.primer_patch has been decoded; in that call's arena, which must outlive the others */
};

/* Bytes of the index that begins at `bytes`; 0 with LOD_BAD_INPUT "truncated" where there are fewer than LOD_UNITS_INDEX_HEAD. */
LOD_WARN_UNUSED enum lod_status lod_units_index_bytes(const uint8_t *bytes, size_t size, size_t *index_bytes, struct lod_problem *problem);

/* Reads an index and finds the base's patches. base: the coarser level's unit, as lod_delta_decode wants it; it must outlive the result.
 * LOD_BAD_INPUT "truncated", "units", "wrong-base"; LOD_UNSUPPORTED "units-version"; LOD_LIMIT; LOD_MEMORY. */
LOD_WARN_UNUSED enum lod_status lod_units_open(const uint8_t *bytes, size_t size, const struct lod_mesh *base,
                                               const struct lod_delta_limits *limits, struct lod_arena *arena, struct lod_units *units,
                                               struct lod_problem *problem);

/* Decodes a patch from its frame's bytes: header.primer_patch first ("wrong-primer"). level->kept has an entry for each corner of the
 * patch's coarse triangles, three a triangle. */
LOD_WARN_UNUSED enum lod_status lod_units_decode(struct lod_units *units, uint32_t patch, const uint8_t *bytes, size_t size,
                                                 const struct lod_delta_limits *limits, struct lod_arena *arena,
                                                 struct lod_delta_level *level, struct lod_problem *problem);

/* The patches at hand as one mesh. levels: patch_count; NULL where a patch has not come. With all of them (those of size 0 count as here)
 * the result is the finer level, which is checked. */
LOD_WARN_UNUSED enum lod_status lod_units_join(const struct lod_units *units, const struct lod_delta_level *const *levels,
                                               struct lod_arena *arena, struct lod_delta_level *joined, struct lod_problem *problem);

/* Which of the base's vertices can be drawn at their finer places: those of which all patches around are at hand. Others are set to
 * LOD_NONE in kept (base vertex_count), as lod_overlay_create wants them. */
void lod_units_settle(const struct lod_units *units, const struct lod_delta_level *const *levels, uint32_t *kept);

/* Index and frames, in `arena`. *size 0 and LOD_OK where units make no sense: fewer than two patches, no finer triangle, segments or
 * points, or too many finer triangles that hang together with no vertex of the base. */
LOD_WARN_UNUSED enum lod_status lod_units_encode(const struct lod_delta_encode_request *request, uint32_t most_triangles,
                                                 struct lod_arena *arena, uint8_t **bytes, size_t *size, struct lod_problem *problem);

/* ---- between the files ---- */

/* The patches of a base. patch: a number a triangle; *count: how many. */
LOD_WARN_UNUSED enum lod_status lod_units_partition(const struct lod_mesh *base, const struct lod_delta_grid *grid, uint32_t most_triangles,
                                                    struct lod_arena *arena, uint32_t **patch, uint32_t *count);

/* The triangles of `mesh` that are listed, with what belongs to them, vertices and wedges in rising order. vertices, of the part: its
 * number in `mesh`. */
LOD_WARN_UNUSED enum lod_status lod_units_part(const struct lod_mesh *mesh, const uint32_t *triangles, uint32_t count,
                                               struct lod_arena *arena, struct lod_mesh *part, uint32_t **vertices);

/* Normals of a wedge's own triangles, by area; of unit length or 0. */
LOD_WARN_UNUSED enum lod_status lod_units_normals(const struct lod_mesh *mesh, struct lod_arena *arena, float (**normals)[3]);

#endif
