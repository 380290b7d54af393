/* Bounds the distance of pieces of triangles to a target mesh: the branch and bound under distance.h.
 *
 * A certifier is the state of one chunk of work. It knows a distance that is surely reached (`lower`), and drops a piece as soon as some
 * bound on the distance of all its points is at most `threshold`: then the piece cannot make the result worse than it may be. What is
 * left is cut: along the edge of the target's triangle that it hangs over, else in halves. */
#ifndef LOD_CORE_MESH_CERTIFY_H
#define LOD_CORE_MESH_CERTIFY_H

#include "core/mesh/bvh_tree.h"

enum { LOD_PIECE_CORNERS = 8 };

/* A convex polygon that is part of a triangle; a segment has two corners and a point one. */
struct lod_piece {
  struct lod_vec3 corners[LOD_PIECE_CORNERS];
  uint32_t near[LOD_PIECE_CORNERS]; /* primitive of the target nearest to a corner, or LOD_NONE = not known */
  double upper;                     /* all of it lies within this distance of the target */
  uint32_t hint;                    /* primitive of the target likely to be near, or LOD_NONE */
  uint16_t count;                   /* corners */
  uint16_t depth;                   /* cuts above it */
};

/* Nearest primitives of vertices met lately; an entry is overwritten by the next vertex of its hash. */
enum { LOD_VERTEX_CACHE = 1 << 12 };
struct lod_vertex_cache {
  uint32_t vertices[LOD_VERTEX_CACHE], nearest[LOD_VERTEX_CACHE];
};
void lod_vertex_cache_init(struct lod_vertex_cache *cache);

struct lod_certifier {
  const struct lod_bvh *items;  /* whose primitives are measured */
  const struct lod_bvh *target; /* not empty. Neither is owned */
  struct lod_vertex_cache *cache;
  double relative, absolute; /* as lod_distance_settings */
  double rounding;           /* bound on the rounding of a distance */
  double known_upper;        /* no point is farther than this; INFINITY = not known */
  double lower;              /* largest distance reached so far by a point of the pieces, or known to be reached elsewhere */
  double reached;            /* the same, of these pieces alone */
  double threshold;          /* what may be dropped: follows from the above; see lod_certifier_raise */
  double upper;              /* largest bound of what was dropped */
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

/* Decides a primitive of items, or a piece, with at most `splits` cuts. Pieces still undecided go, with their bounds, to `rest`: at most
 * LOD_CERTIFY_REST of them; both return how many. hint: primitive of the target likely to be near, or LOD_NONE. */
enum { LOD_CERTIFY_REST = 128 };
uint32_t lod_certify_primitive(struct lod_certifier *certifier, uint32_t primitive, uint32_t hint, uint32_t splits,
                               struct lod_piece rest[LOD_CERTIFY_REST]);
uint32_t lod_certify_piece(struct lod_certifier *certifier, const struct lod_piece *piece, uint32_t splits,
                           struct lod_piece rest[LOD_CERTIFY_REST]);

#endif
