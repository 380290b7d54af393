/* Bounds the distance of pieces of triangles to a target mesh: the branch and bound under distance.h.
 *
 * A certifier is the state of one chunk of work. It knows a distance that is surely reached (`lower`), and drops a piece as soon as some
 * bound on the distance of all its points is at most `threshold`: then the piece cannot make the result worse than it may be. What is
 * left is split. */
#ifndef LOD_CORE_MESH_CERTIFY_H
#define LOD_CORE_MESH_CERTIFY_H

#include "core/mesh/bvh_tree.h"

/* Part of a triangle, or of a segment or point (equal corners). */
struct lod_piece {
  struct lod_vec3 corners[3];
  double upper;   /* all of it lies within this distance of the target */
  uint32_t hint;  /* primitive of the target likely to be near, or LOD_NONE */
  uint32_t depth; /* splits above it */
};

struct lod_certifier {
  const struct lod_bvh *target; /* not owned, not empty */
  double relative, absolute;    /* as lod_distance_settings */
  double rounding;              /* bound on the rounding of a distance */
  double known_upper;           /* no point is farther than this; INFINITY = not known */
  double lower;                 /* largest distance reached so far by a point of the pieces, or known to be reached elsewhere */
  double reached;               /* the same, of these pieces alone */
  double threshold;             /* what may be dropped: follows from the above; see lod_certifier_raise */
  double upper;                 /* largest bound of what was dropped */
  uint64_t splits;
  uint32_t last;                   /* primitive that decided the last piece */
  struct lod_triangle_probe probe; /* of probe_primitive */
  uint32_t probe_primitive;
};

/* `lower` is the starting lower bound. */
void lod_certifier_init(struct lod_certifier *certifier, double lower);

/* A point of the pieces lies exactly `distance` from the target. */
void lod_certifier_raise(struct lod_certifier *certifier, double distance);

/* Is the whole ball around `centre` near enough to be dropped? */
bool lod_certify_ball(struct lod_certifier *certifier, struct lod_vec3 centre, double radius);

/* Decides a piece with at most `splits` splits. Pieces still undecided go, with their bounds, to `rest`: at most LOD_CERTIFY_REST of them;
 * returns how many. */
enum { LOD_CERTIFY_REST = 128 };
uint32_t lod_certify_piece(struct lod_certifier *certifier, const struct lod_piece *piece, uint32_t splits,
                           struct lod_piece rest[LOD_CERTIFY_REST]);

#endif
