/* Proof that a triangle lies within a distance of a source mesh. */
#ifndef LOD_CORE_ENVELOPE_FORWARD_H
#define LOD_CORE_ENVELOPE_FORWARD_H

#include "core/mesh/bvh.h"

struct lod_forward {
  const struct lod_mesh *source; /* not owned, nor the tree over it */
  const struct lod_bvh *bvh;
  uint32_t (*neighbour)[3];        /* per source triangle and edge: the triangle across it, LOD_NONE at the boundary */
  double epsilon, epsilon_squared; /* already narrowed by what rounding may take */
  const double *limits;            /* per source vertex, as lod_backward_create: a triangle proves what its least corner allows; or NULL */
};

LOD_WARN_UNUSED enum lod_status lod_forward_init(struct lod_forward *forward, const struct lod_mesh *source, const struct lod_bvh *bvh,
                                                 struct lod_arena *arena);

enum lod_forward_answer {
  LOD_FORWARD_PROVEN,  /* all of the triangle lies within epsilon of the source */
  LOD_FORWARD_REFUTED, /* *refuter is a point of it that does not */
  LOD_FORWARD_OPEN,    /* `budget` pieces did not decide it */
};

/* Which source triangles proved it, each once in a row: an array for `capacity`, of which `count` were found, perhaps more. */
struct lod_forward_used {
  uint32_t *triangles, capacity, count;
};

/* hint: a source triangle near the centre, LOD_NONE = search. used: NULL = not asked for. */
enum lod_forward_answer lod_forward_test(const struct lod_forward *forward, const struct lod_vec3 corner[3], uint32_t hint, uint32_t budget,
                                         struct lod_vec3 *refuter, struct lod_forward_used *used);

/* The same, true where it is proven, by halves of the triangle against whatever is nearest to them: slow near epsilon, sure well within. */
bool lod_forward_test_by_halves(const struct lod_forward *forward, const struct lod_vec3 corner[3], uint32_t budget,
                                struct lod_forward_used *used);

#endif
