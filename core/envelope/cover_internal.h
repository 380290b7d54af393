/* What the files of the cover share. */
#ifndef LOD_CORE_ENVELOPE_COVER_INTERNAL_H
#define LOD_CORE_ENVELOPE_COVER_INTERNAL_H

#include "core/envelope/certificate.h"
#include "core/envelope/cover.h"

enum { COVER_NEAR = 64, COVER_HOLE = 96, COVER_FILL = 56 }; /* vertices around one; triangles of a hole; of its filling */

enum cover_kind {
  COVER_INTERIOR, /* may vanish */
  COVER_CURVE,    /* may vanish along its line */
  COVER_FIXED,
};

struct cover_ring {
  uint32_t *faces;
  uint32_t count, capacity;
};

struct lod_cover {
  const struct lod_mesh *mesh; /* that it began with; vertices and faces below are of it */
  const struct lod_mesh *source;
  const struct lod_bvh *bvh; /* over the source */
  struct lod_arena *arena;
  struct lod_cover_settings settings;
  struct lod_offset offset;      /* directions are those of the fibers; without offset surfaces they are renewed as the mesh changes */
  struct lod_vec3 *normal;       /* directions at the start */
  double epsilon, margin, reach; /* of this run; of rounding; half a fiber */
  double *vertex_epsilon;        /* with offsets: per vertex, of this run */
  struct lod_certificate *certificate;

  /* Per vertex. */
  double (*at)[3], (*low)[3], (*high)[3]; /* position; two points of the fiber */
  uint8_t *kind;
  uint32_t (*link)[2]; /* of a curve vertex: its neighbours on the line at the start */
  uint32_t *near;      /* a source triangle at it */
  uint32_t *stamp;     /* changes with the faces around it */
  uint32_t *replaced;  /* the face that replaces it, LOD_NONE while it stands */
  uint32_t *next;      /* in the list of those that its face replaces */
  struct cover_ring *ring;

  /* Faces: as many as triangles at the start, face[f][0] == LOD_NONE: gone. */
  uint32_t (*face)[3];
  uint8_t *opaque; /* bit k: edge from corner k */
  uint32_t *patch; /* region between lines, as a first face of it */
  uint32_t *first; /* of the list of vertices that it replaces */
  float (*box)[6];
  uint32_t live;

  uint32_t *face_mark, *vertex_mark, *vertex_slot, mark;
  struct lod_cover_report report;
  double vertices_to_go; /* tries left */
};

/* ---- cover_mesh.c ---- */

enum lod_status cover_mesh_create(struct lod_cover *c, const struct lod_adjacency *adjacency);

/* Takes fibers from the mesh as it stands; of a vertex that has vanished, from the face that replaces it. */
void cover_renew_fibers(struct lod_cover *c);

/* +1 when the fiber of w passes left of the way from p to q seen from outside, else -1; never 0. */
int cover_side(const struct lod_cover *c, uint32_t p, uint32_t q, uint32_t w);

/* Whether a, b, c looks outwards at the fibers of its corners, and turns left. */
bool cover_faces_out(const struct lod_cover *c, uint32_t a, uint32_t b, uint32_t d);

/* Whether the fiber of w passes through the triangle. */
bool cover_covers(const struct lod_cover *c, const uint32_t v[3], uint32_t w);

/* The face on the other side of the edge from u to w of face f, or LOD_NONE. */
uint32_t cover_across(const struct lod_cover *c, uint32_t f, uint32_t u, uint32_t w);

static inline struct lod_vec3 cover_point(const struct lod_cover *c, uint32_t v) {
  return lod_vec3_make(c->at[v][0], c->at[v][1], c->at[v][2]);
}
static inline bool cover_stands(const struct lod_cover *c, uint32_t v) {
  return c->ring[v].count != 0;
}

/* A hole and what fills it. */
struct cover_hole {
  uint32_t faces[COVER_HOLE], face_count;
  uint32_t inside[COVER_HOLE], inside_count; /* vertices that vanish */
  uint32_t fill[COVER_FILL][3], fill_count;
  uint32_t chord[2]; /* the edge that becomes part of a line, or LOD_NONE */
};

/* Replaces the hole's faces by its filling, under ids (fill_count) that are some of theirs. Lines on the border stay lines. */
enum lod_status cover_replace(struct lod_cover *c, const struct cover_hole *hole, const uint32_t *ids);

/* ---- cover_hole.c ---- */

/* Tries to put triangle v in, or to remove vertex v; *done when it was possible and has been done. */
enum lod_status cover_try_triangle(struct lod_cover *c, const uint32_t v[3], bool *done);
enum lod_status cover_try_vertex(struct lod_cover *c, uint32_t v, bool *done);

/* ---- cover_candidates.c ---- */

struct cover_candidate {
  uint32_t v[3];
  uint32_t count; /* vertices that it covers */
  float height;   /* of the farthest of them over it */
};

/* Candidates of the mesh as it stands, that cover a vertex at least, largest first. */
enum lod_status cover_candidates(struct lod_cover *c, struct lod_arena *arena, struct cover_candidate **candidates, size_t *count);

/* Vertices within `reach` edges of v, v first, not across lines; at most COVER_NEAR. */
uint32_t cover_around(struct lod_cover *c, uint32_t v, uint32_t reach, uint32_t around[COVER_NEAR]);

/* How many vertices that stand a triangle covers, of those within reach of its corners. */
uint32_t cover_count(struct lod_cover *c, const uint32_t v[3]);

#endif
