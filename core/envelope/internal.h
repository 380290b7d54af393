/* What the files of the certified collapse share. */
#ifndef LOD_CORE_ENVELOPE_INTERNAL_H
#define LOD_CORE_ENVELOPE_INTERNAL_H

#include "core/envelope/certificate.h"
#include "core/envelope/collapse.h"
#include "core/envelope/curves.h"
#include "core/envelope/guard.h"
#include "core/envelope/surface.h"
#include "core/envelope/wedges.h"

struct lod_quadric;
struct witness;

struct lod_queue_entry {
  double cost;
  uint32_t a, b, stamp_a, stamp_b; /* stale when either vertex has another stamp now */
};

struct lod_collapser {
  const struct lod_mesh *mesh;
  const struct lod_bvh *bvh;
  const uint8_t *feature_edges;
  struct lod_arena *arena;
  uint32_t *patch; /* per source triangle: region between features; a face keeps to the patch of the triangle it began as */
  struct lod_collapse_settings settings;
  struct lod_surface surface;
  struct lod_certificate *certificate;
  struct lod_curves curves;
  struct lod_wedges wedges;
  struct lod_guard *guard;     /* NULL: crossings are nobody's concern, or not yet */
  bool has_guard;              /* it was made, if there is to be one */
  int drafts;                  /* that crossed themselves; the next asks the guard where they did, the last one everywhere */
  bool *suspect;               /* per vertex: faces around it have crossed in a draft; NULL = all are */
  double epsilon;              /* of the current stage */
  double *bound;               /* per vertex, of drafts (draft.c) since the last stage with certificates; or NULL */
  double reached;              /* how far the surface as it stands may be from the source: that of the last stage; 0 = it is the source */
  double spent;                /* part of epsilon that lies between the source and what the certificate is against */
  struct lod_quadric *quadric; /* per vertex */
  uint32_t *near;              /* per vertex: a source triangle near it */
  uint32_t *stamp;             /* per vertex: changes with it */
  uint32_t *face_mark, mark;
  struct lod_queue_entry *heap;
  size_t heap_count, heap_capacity;
  struct witness *witnesses;  /* direct-mapped by edge */
  uint32_t *kept, kept_count; /* degenerate source triangles that no face answers for */
  double least_normal_dot;
  double gate;          /* mean squared distance to the planes around, above which an edge is not tried */
  uint32_t proxy_faces; /* of the last proxy */
  double proxy_epsilon; /* proven of it */
  uint32_t *origin;     /* per vertex: the source vertex at whose place it stands, as long as none was placed freely */
  uint32_t *merged;     /* per vertex, where it went; itself while it stands */
};

/* A collapse that is looked at. */
struct lod_attempt {
  struct lod_collapser *collapser;
  struct lod_change change;
  uint32_t changing[160];
  struct lod_candidate faces[LOD_CERTIFICATE_MAX_FACES];
};

/* Faces around (a, b) as they would be after its collapse to `to`, and those that they come from; false when the shapes forbid it or there
 * are too many to certify with. a LOD_NONE: b alone moves. */
bool lod_attempt_gather(struct lod_collapser *c, uint32_t a, uint32_t b, struct lod_vec3 to, struct lod_attempt *attempt);

/* b takes over a's origin where (a, b) is about to collapse to a's place. */
static inline void lod_collapser_note_origin(struct lod_collapser *c, uint32_t a, uint32_t b, struct lod_vec3 to) {
  struct lod_vec3 at = c->surface.position[a];
  if (to.x == at.x && to.y == at.y && to.z == at.z)
    c->origin[b] = c->origin[a];
}

/* Where v went, with shorter ways for the next who asks. */
static inline uint32_t lod_survivor(uint32_t *merged, uint32_t v) {
  while (merged[v] != v)
    v = merged[v] = merged[merged[v]];
  return v;
}

void lod_attempt_init(struct lod_collapser *c, struct lod_attempt *attempt);

/* Collapses (a, b), which the topology must allow, to `to` if line, certificate and guard do. attempt->change.witness as there. */
LOD_WARN_UNUSED enum lod_status lod_attempt_collapse(struct lod_collapser *c, uint32_t a, uint32_t b, struct lod_vec3 to,
                                                     struct lod_attempt *attempt, bool *done);

/* After b has moved: what is near it, and its edges into the queue. */
LOD_WARN_UNUSED enum lod_status lod_collapser_update_after(struct lod_collapser *c, uint32_t b);

/* polish.c: after the collapses have come to an end, where few faces are left. */
LOD_WARN_UNUSED enum lod_status lod_polish_run(struct lod_collapser *c, const struct lod_progress *progress);

/* draft.c: collapses as many edges as bounds on the displacement of a map from the surface to what it becomes allow, without a certificate.
 * *proven: how far the surface may be from the source, both ways, at most `limit`. */
LOD_WARN_UNUSED enum lod_status lod_draft_run(struct lod_collapser *c, double limit, const struct lod_progress *progress, double *proven);

/* collapse.c. Of the stage to come; gate: in epsilons squared. */
void lod_collapser_set_epsilon(struct lod_collapser *c, double epsilon, double gate);

/* The source as the surface, each triangle charged to itself. */
LOD_WARN_UNUSED enum lod_status lod_collapser_start(struct lod_collapser *c);

/* Tries every edge, cheapest first, at up to `places` places each; neighbours of what collapses again. */
LOD_WARN_UNUSED enum lod_status lod_collapser_pass(struct lod_collapser *c, int places, const struct lod_progress *progress,
                                                   uint32_t *collapsed);

/* The surface is within `epsilon` of the source by certificates: drafts start from there. */
void lod_collapser_reach(struct lod_collapser *c, double epsilon);

/* Forgets what is known of edges that failed. */
void lod_collapser_forget(struct lod_collapser *c);

/* queue.c. push_edge puts the end that may vanish first; push_all starts afresh. */
LOD_WARN_UNUSED enum lod_status lod_queue_push_edge(struct lod_collapser *c, uint32_t a, uint32_t b);
LOD_WARN_UNUSED enum lod_status lod_queue_push_all(struct lod_collapser *c);
struct lod_queue_entry lod_queue_pop(struct lod_collapser *c);

/* Where the result of collapsing (a, b) may stand, and its quadric error there, best first; returns how many. */
int lod_collapser_placements(const struct lod_collapser *c, uint32_t a, uint32_t b, bool b_stays, struct lod_vec3 place[4], double cost[4]);

/* extract.c: positions and triangles of the live faces, then the degenerate triangles that stay; face_to: face -> triangle. */
LOD_WARN_UNUSED enum lod_status lod_collapser_extract_surface(const struct lod_collapser *c, struct lod_arena *arena, struct lod_mesh *mesh,
                                                              uint32_t *face_to);

#endif
