/* A refinement from request to GLB: a base that is decoded once, its forest kept from one request to the next. */
#ifndef LOD_SERVER_WORKER_REFINE_H
#define LOD_SERVER_WORKER_REFINE_H

#include "core/base/parallel.h"
#include "core/mesh/model.h"
#include "core/refine/doi.h"
#include "server/jobs/refine_query.h"

struct lod_refine_base;

/* Decodes a level (or any other model without files beside it; textures that it names stay named). Memory of everything that is ever done
 * with the base counts against max_memory_bytes (0 = no limit). */
LOD_WARN_UNUSED enum lod_status lod_refine_base_create(const char *name, const uint8_t *bytes, size_t size, uint64_t max_memory_bytes,
                                                       struct lod_refine_base **base, struct lod_problem *problem);
void lod_refine_base_destroy(struct lod_refine_base *base); /* NULL is allowed */

/* Makes later requests faster, if that is worth while: sooner when nobody waits. */
void lod_refine_base_tidy(struct lod_refine_base *base, bool idle);

struct lod_refine_request {
  const struct lod_refine_query *query;
  const float *values; /* in [0, 1]; one for each triangle of the base, corner, vertex or position, as query->per says; or NULL */
  size_t value_count;
  uint64_t max_triangles;              /* whatever the query says: never more */
  const struct lod_progress *progress; /* may be NULL */
};

struct lod_refine_answer {
  uint8_t *bytes; /* GLB; valid until the base's next request */
  size_t size;
  uint32_t triangles, vertices, base_triangles, deepest;
  bool budget; /* a limit kept something interesting from being refined */
};

/* LOD_BAD_INPUT: parameter names what is wrong with the query for this base. */
LOD_WARN_UNUSED enum lod_status lod_refine_answer(struct lod_refine_base *base, const struct lod_refine_request *request,
                                                  struct lod_refine_answer *answer, char parameter[LOD_REFINE_QUERY_PARAMETER + 1],
                                                  struct lod_problem *problem);

/* The surface contact point of query->points[0]. */
LOD_WARN_UNUSED enum lod_status lod_refine_touch(struct lod_refine_base *base, const struct lod_refine_query *query,
                                                 struct lod_contact *contact, struct lod_problem *problem);

/* The warm worker: refinements over the socket until it ends (server/jobs/pool.h says what is spoken). first: the job frame, JSON text.
 * Returns the process's exit status. */
int lod_refine_serve(const char *first);

#endif
