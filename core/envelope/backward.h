/* Proof that triangles of the source lie within a distance of the faces around a change.
 *
 * By the convexity lemma a convex part of a source triangle is proven by one face that all its corners are near to. A triangle that lies
 * over several faces is cut along their borders. Which faces a corner is near to is found out as far as it is asked for. */
#ifndef LOD_CORE_ENVELOPE_BACKWARD_H
#define LOD_CORE_ENVELOPE_BACKWARD_H

#include "core/envelope/wedges.h"
#include "core/mesh/mesh.h"

enum { LOD_CERTIFICATE_MAX_FACES = 64 };

struct lod_candidate {
  struct lod_vec3 corner[3];
  uint32_t face;      /* the face that it will be, or is */
  uint32_t vertex[3]; /* of the surface, as they are now */
  uint32_t wedge[3];  /* as they will be; where attributes are bounded */
};

/* A change: faces `changing` will be gone or altered, `faces` (at most LOD_CERTIFICATE_MAX_FACES) are those that stand around it
 * afterwards: first the fresh_count new shapes, then unchanged neighbours, which certify too (without them the method jams at small
 * epsilon). */
struct lod_change {
  /* Adds the unchanged neighbours; called only when the new shapes alone do not certify. */
  void (*gather)(void *context, struct lod_change *change);
  void *context;
  const uint32_t *changing;
  uint32_t changing_count;
  const struct lod_candidate *faces;
  uint32_t face_count, fresh_count;
  uint32_t hints[LOD_CERTIFICATE_MAX_FACES][3];    /* per fresh face and corner: a source triangle near it, or LOD_NONE */
  struct lod_placed_wedge placed[LOD_MOST_PLACED]; /* wedges that change, placed_count of them */
  uint32_t placed_count;
  uint32_t witness; /* in: a source triangle likely to fail, or LOD_NONE; out on failure: the one that did */
};

struct lod_backward;

/* limits: per source vertex, how far the surface may be there at most, epsilon or not, linear in between; or NULL. Not owned. */
LOD_WARN_UNUSED enum lod_status lod_backward_create(const struct lod_mesh *source, const double *limits, struct lod_arena *arena,
                                                    struct lod_backward **backward);

/* From now on a face stands for a point of the source only where its attributes are within their bounds as well, and only on the same
 * patch: the lemma holds in the space of positions and attributes alike. wedges: bounded; patch: per source triangle, and per face that
 * began as it. Not owned. */
LOD_WARN_UNUSED enum lod_status lod_backward_bound_attributes(struct lod_backward *backward, const struct lod_wedges *wedges,
                                                              const uint32_t *patch, struct lod_arena *arena);

/* Of the questions to come; already narrowed by what rounding may take. */
void lod_backward_set_epsilon(struct lod_backward *backward, double epsilon);

/* Starts on another change, which must live until the next. */
void lod_backward_begin(struct lod_backward *backward, struct lod_change *change);

/* Whether source triangle t lies within epsilon of the faces of the change; *used: bits of those that show it. */
bool lod_backward_test(struct lod_backward *backward, uint32_t t, uint64_t *used);

/* Where attributes are bounded: whether p, with attributes `value`, lies within epsilon of source triangle t and within the bounds of its
 * attributes there. */
bool lod_backward_shows(const struct lod_backward *backward, uint32_t t, struct lod_vec3 p, const double *value);

/* And what a corner of face k of the change has. */
const double *lod_backward_value(const struct lod_backward *backward, uint32_t k, int corner);

#endif
