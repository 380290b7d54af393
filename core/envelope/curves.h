/* Feature lines (boundaries, seams, creases, borders of materials) stay within epsilon of the source's lines, both ways, proven.
 *
 * A chain is a line of the source from corner to corner, or a loop. Every current vertex on it stands for one of its source vertices, no
 * farther than epsilon away, and every current edge for the part of the chain between those of its ends: no part of a line is lost, and
 * lines do not change places. */
#ifndef LOD_CORE_ENVELOPE_CURVES_H
#define LOD_CORE_ENVELOPE_CURVES_H

#include "core/envelope/surface.h"

struct lod_curves {
  const struct lod_mesh *source; /* not owned */
  uint32_t *chain, *place; /* per vertex of kind LOD_VERTEX_CURVE: its chain, and the place in it of the source vertex it stands for */
  uint32_t *order;         /* the chains' source vertices, one chain after another */
  uint32_t *first, *count; /* per chain: its part of order; a chain that is no loop begins and ends with its corners */
  bool *loop;              /* per chain */
  const uint32_t *merged;  /* per vertex: where it went, itself while it stands; not owned */
  double margin;           /* of rounding */
};

/* From a surface that has not changed yet. */
LOD_WARN_UNUSED enum lod_status lod_curves_create(const struct lod_mesh *source, const struct lod_surface *surface, struct lod_arena *arena,
                                                  struct lod_curves *curves);

/* Whether collapsing feature edge (a, b), a on a chain, to `to` keeps the line within epsilon. *place: what b stands for afterwards; give
 * it to lod_curves_collapse once it is done. */
bool lod_curves_allow(const struct lod_curves *curves, const struct lod_surface *surface, uint32_t a, uint32_t b, struct lod_vec3 to,
                      double epsilon, uint32_t *place);
void lod_curves_collapse(struct lod_curves *curves, const struct lod_surface *surface, uint32_t b, uint32_t place);

/* Whether junctions a and b may become one at `to`: the first edges of the lines that end there still stand for their parts of them. Lines
 * that run from junction to junction in one edge are not looked at: patches on both sides, whose points must all be near the same patch
 * (certificate.h, where attributes are bounded), keep them. */
bool lod_curves_allow_junction(const struct lod_curves *curves, const struct lod_surface *surface, uint32_t a, uint32_t b,
                               struct lod_vec3 to, double epsilon);

#endif
