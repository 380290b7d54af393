/* The interface of a family: source units in, levels out, finest first. */
#ifndef LOD_CORE_LEVEL_HIERARCHY_H
#define LOD_CORE_LEVEL_HIERARCHY_H

#include "core/base/parallel.h"
#include "core/mesh/model.h"

/* A level as curved patches, beside the triangles that a client makes of them. */
struct lod_level_patches {
  const uint8_t *bytes; /* codec/stream/patches.h: a frame a unit */
  size_t size;
  uint64_t count;     /* patches */
  double deviation;   /* bound of the distance between the patches and the level's meshes before these were rounded to float, model units */
  double color_bound; /* how far colours are from the source's at corresponding points, largest component, coding included; 0 = none */
};

/* One approximation of all units. Owned by the family; valid until the sink returns. */
struct lod_level {
  struct lod_mesh *meshes; /* unit_count */
  /* Per unit: source vertex -> level vertex that stands for it, or LOD_NONE; NULL when the family has no such map. When a unit has it,
   * every source triangle's image (triangle, segment or point) is part of the level, so max |v - image(v)| bounds both directions. */
  uint32_t *const *images;
  /* Per unit: source triangle -> level primitive (bvh.h numbering) it became or lies near, or LOD_NONE; or NULL. Hints for certification.
   */
  uint32_t *const *nearby;
  /* Per unit: level vertex -> vertex of the next finer level emitted before, of the source for the first (nested families); or NULL. */
  uint32_t *const *parents;
  /* Per unit: source vertex -> level triangle that replaces it, near it, so that the vertex can move there (Varshney 1995, 6.5), LOD_NONE
   * where it names no triangle; or NULL. */
  uint32_t *const *replacements;
  /* How far attributes drift from the source's where the family tells it: sampled, a figure and no bound. */
  bool has_drift;
  double uv_drift;     /* the most in any set, units of UV */
  double normal_drift; /* degrees */
  /* Where the family proves it: every point of the source has a point of the level within `bound` whose UV and interpolated normals differ
   * by no more, before quantisation. INFINITY = not proven; 0 = there are none. */
  double uv_bound, normal_bound;
  double bound; /* proven bound of the two-sided distance before quantisation, model units; INFINITY = none */
  /* With a bound, the error that the level was asked for: quantisation may use whatever keeps the decoded level within it, and faces must
   * not cross because of it. 0 = nobody asked. Model units. */
  double target;
  double precision; /* with a target, the most that quantisation may take; 0 = what the target leaves */
  double expected; /* without a bound: about the distance, by a measure that proves nothing; 0 = not known. Leads the choice of precision */
  /* Of families that can be asked for a number of vertices: how many were asked for (0: none), and how many the level has that were placed
   * (candidates) or are the source's and could not be removed (retained). counted: the two are told. */
  bool apart; /* vertices that lie apart must not be merged by quantisation: the level's topology is promised */
  bool counted;
  uint64_t asked, candidates, retained;
  double cell;                             /* width of the clustering cell; 0 = none */
  const struct lod_level_patches *patches; /* or NULL */
};

/* Receives levels finest first. A status other than LOD_OK stops the family and is returned by it. */
typedef enum lod_status lod_level_sink(void *context, const struct lod_level *level);

struct lod_family {
  const char *name;     /* "cluster" */
  const char *sentence; /* what it is, for --help and the manifest */
  bool nested;          /* coarse vertices are fine vertices */
  /* settings: the family's own settings struct, NULL = defaults. progress may be NULL. Deterministic for any number of threads. */
  enum lod_status (*build)(const struct lod_unit *units, uint32_t unit_count, const void *settings, const struct lod_progress *progress,
                           struct lod_arena *arena, lod_level_sink *sink, void *sink_context, struct lod_problem *problem);
};

#endif
