/* manifest.json of a bake (described in codec/FORMAT.md). */
#ifndef LOD_SERVER_WORKER_MANIFEST_H
#define LOD_SERVER_WORKER_MANIFEST_H

#include "server/worker/bake.h"
#include "server/worker/levels.h"

struct lod_baked_family {
  const struct lod_family *family;
  struct lod_baked_level *levels; /* coarsest first */
  uint32_t level_count;
  bool nested; /* as it was made: coarse vertices are fine vertices */
};

struct lod_source_facts {
  char sha256[LOD_HASH_HEX + 1];
  uint64_t bytes;
  struct lod_bounds bounds;
  struct lod_sphere sphere;
  uint64_t components, boundary_loops, non_manifold_edges, degenerate_triangles;
  bool closed;
};

struct lod_manifest_facts {
  const struct lod_bake_request *request;
  const struct lod_model *model;
  const struct lod_source_facts *source;
  const struct lod_baked_family *families;
  uint32_t family_count;
  const char (*image_objects)[LOD_HASH_HEX + 1]; /* image_count */
  double seconds;
  uint64_t peak_bytes;
};

/* Numbers are written with 9 digits, of which the last may be rounded down or up: a bound is first moved out of reach of that. */
double lod_manifest_raise(double upper);
double lod_manifest_lower(double lower);

/* JSON text, malloc'd: the caller frees. Writes the documents over the levels (codec/export/interop.h) as objects of the bake, of which all
 * levels must be written already. */
LOD_WARN_UNUSED enum lod_status lod_manifest_text(const struct lod_manifest_facts *facts, char **text_out, struct lod_problem *problem);

#endif
