/* In which order a level comes about: a draft, which bounds alone admit, and whose result stands in for the source; certificates against
 * that as far as it leaves of epsilon; certificates against the source itself for the rest; other places in the end. */
#include <math.h>
#include <string.h>

#include "core/base/tolerance.h"
#include "core/envelope/internal.h"

/* An edge whose quadric says that its place is farther than sqrt(GATE) epsilon from the planes around, in the mean, is not tried: it would
 * cost a trial and fail. 2.5 loses no triangles (bunny, fandisk); 1 loses 3 to 7 %. */
static const double GATE = 2.5;

/* The draft: the share of epsilon that it may use, its gate in shares of that, and how much larger than the last proxy's epsilon must be.
 */
static const double DRAFT_SHARE = 0.2, DRAFT_GATE = 0.1, DRAFT_STEP = 4, SECOND_SHARE = 0.5;

/* A proxy may take this share of epsilon to be what certificates are against, and must have so many times fewer triangles than the source.
 * Margin: what is left of epsilon for the charges against the source, which look at one triangle at a time. */
static const double PROXY_SHARE = 0.25, PROXY_GAIN = 3, PROXY_MARGIN = 0.02;

/* The surface as it stands, as a mesh that questions can be put to. */
struct snapshot {
  struct lod_mesh mesh;
  struct lod_forward forward;
  uint32_t *triangle_of, *face_of; /* face -> triangle and back */
};

static enum lod_status take_snapshot(const struct lod_collapser *c, struct lod_arena *arena, struct snapshot **out) {
  struct snapshot *s = *out = LOD_NEW_ZERO(arena, 1, struct snapshot);
  if (s == NULL || (s->triangle_of = LOD_NEW(arena, c->surface.face_count, uint32_t)) == NULL)
    return LOD_MEMORY;
  memset(s->triangle_of, 0xff, c->surface.face_count * sizeof *s->triangle_of);
  LOD_TRY(lod_collapser_extract_surface(c, arena, &s->mesh, s->triangle_of));
  s->face_of = LOD_NEW(arena, s->mesh.triangle_count, uint32_t);
  if (s->face_of == NULL)
    return LOD_MEMORY;
  for (uint32_t f = 0; f < c->surface.face_count; f++)
    if (s->triangle_of[f] != LOD_NONE)
      s->face_of[s->triangle_of[f]] = f;
  struct lod_bvh *bvh;
  LOD_TRY(lod_bvh_create(&s->mesh, 1, arena, &bvh));
  return lod_forward_init(&s->forward, &s->mesh, bvh, arena);
}

/* Over the snapshot, or over the source where it is NULL. */
static enum lod_status make_guard(struct lod_collapser *c, const struct snapshot *now) {
  if (c->has_guard)
    return LOD_OK;
  c->has_guard = true;
  if (c->settings.guarding == LOD_GUARD_NONE)
    return LOD_OK;
  return lod_guard_create(now == NULL ? c->mesh : &now->mesh, now == NULL ? NULL : now->face_of, &c->surface,
                          c->settings.guarding == LOD_GUARD_ALL, c->arena, &c->guard);
}

/* A face around the survivors of a source triangle's corners: one that all of them share, if there is one. */
static uint32_t hint_of(const struct lod_collapser *c, uint32_t t) {
  const struct lod_surface *s = &c->surface;
  uint32_t v[3], best = LOD_NONE, most = 0;
  for (int k = 0; k < 3; k++)
    v[k] = lod_survivor(c->merged, c->mesh->triangles[t][k]);
  const uint32_t *ring = lod_surface_ring(s, v[0]);
  for (uint32_t i = 0; i < s->ring_count[v[0]]; i++) {
    const uint32_t *w = s->face[ring[i]];
    uint32_t shared = 0;
    for (int k = 0; k < 3; k++)
      shared += 1 + (w[k] == v[1]) + (w[k] == v[2]);
    if (shared > most) {
      most = shared;
      best = ring[i];
    }
  }
  return best;
}

/* Charges the source's triangles to the surface as it stands; *charged false: some could not. */
static enum lod_status charge(struct lod_collapser *c, const struct snapshot *now, bool *charged) {
  struct lod_arena *scratch = lod_arena_create_child(c->arena);
  uint32_t *hints = scratch == NULL ? NULL : LOD_NEW(scratch, c->mesh->triangle_count, uint32_t);
  if (hints == NULL) {
    lod_arena_destroy(scratch);
    return LOD_MEMORY;
  }
  for (uint32_t t = 0; t < c->mesh->triangle_count; t++) {
    uint32_t f = c->surface.face[t][0] != LOD_NONE ? t : hint_of(c, t);
    hints[t] = now->triangle_of[f == LOD_NONE ? t : f];
  }
  enum lod_status status = lod_certificate_recharge(c->certificate, &now->forward, now->face_of, hints, charged);
  lod_arena_destroy(scratch);
  return status;
}

static void find_near(struct lod_collapser *c) {
  for (uint32_t v = 0; v < c->surface.vertex_count; v++)
    if (c->surface.ring_count[v] != 0)
      c->near[v] = lod_certificate_nearest(c->certificate, c->surface.position[v], LOD_NONE);
}

/* Of coplanar regions in floats the planes' rounding says more than their distance. */
static bool is_coplanar(const struct lod_collapser *c, double epsilon) {
  return epsilon <= 2 * LOD_TOLERANCE_COPLANAR * lod_mesh_magnitude(c->mesh);
}

/* Proxies know of no limits, attributes or means. */
static bool takes_proxies(const struct lod_collapser *c) {
  return c->settings.limits == NULL && !c->wedges.bounded && c->settings.rms == 0;
}

/* From the source again; draft and guard as they are set by now. */
static enum lod_status start_afresh(struct lod_collapser *c, bool *afresh) {
  *afresh = true;
  return lod_collapser_start(c);
}

/* Takes up what crosses in a draft where the guard was not asked. To look once afterwards is cheaper than at every collapse, and few drafts
 * cross where their source does not. */
static enum lod_status suspect(struct lod_collapser *c, const bool *crossed, struct lod_arena *scratch, bool *crosses) {
  const struct lod_surface *s = &c->surface;
  bool *around = LOD_NEW_ZERO(scratch, s->vertex_count, bool);
  if (around == NULL || (c->suspect == NULL && (c->suspect = LOD_NEW_ZERO(c->arena, s->vertex_count, bool)) == NULL))
    return LOD_MEMORY;
  for (uint32_t f = 0; f < s->face_count; f++) {
    const uint32_t *v = s->face[f];
    if (!crossed[f] || c->suspect[v[0]] || c->suspect[v[1]] || c->suspect[v[2]])
      continue;
    *crosses = true;
    for (int k = 0; k < 3; k++)
      around[v[k]] = true;
  }
  for (uint32_t v = 0; v < s->vertex_count && *crosses; v++)
    c->suspect[v] = c->suspect[lod_survivor(c->merged, v)] || around[lod_survivor(c->merged, v)] || c->suspect[v];
  return LOD_OK;
}

static enum lod_status look_for_crossings(struct lod_collapser *c, const struct snapshot *now, bool *crosses) {
  enum { MOST_DRAFTS = 3 };
  if (c->settings.guarding == LOD_GUARD_NONE || (c->has_guard && c->suspect == NULL)) /* it was asked everywhere */
    return LOD_OK;
  struct lod_arena *scratch = lod_arena_create_child(c->arena);
  bool *crossed = scratch == NULL ? NULL : LOD_NEW_ZERO(scratch, c->surface.face_count, bool);
  enum lod_status status = crossed == NULL ? LOD_MEMORY : LOD_OK;
  struct lod_guard *guard = NULL;
  if (status == LOD_OK && !c->has_guard) {
    status = make_guard(c, now);
    guard = c->guard;
  } else if (status == LOD_OK && c->guard != NULL)
    status = lod_guard_create(&now->mesh, now->face_of, &c->surface, c->settings.guarding == LOD_GUARD_ALL, scratch, &guard);
  if (status == LOD_OK && guard != NULL)
    status = lod_guard_check(guard, scratch, crossed);
  if (status == LOD_OK)
    status = suspect(c, crossed, scratch, crosses);
  if (*crosses && ++c->drafts == MOST_DRAFTS)
    c->suspect = NULL;
  lod_arena_destroy(scratch);
  return status;
}

/* What is flat in floats is drained from inside by a draft, and leaves triangles from line to line: none there. *bare: nothing is charged.
 */
static enum lod_status draft_stage(struct lod_collapser *c, double epsilon, const struct lod_progress *progress, bool *bare, bool *afresh) {
  uint32_t live = c->surface.live_faces;
  double proven;
  if (!c->settings.draft || !takes_proxies(c) || is_coplanar(c, epsilon) || !(epsilon > DRAFT_STEP * c->proxy_epsilon))
    return LOD_OK;
  if (c->drafts > 0)
    LOD_TRY(make_guard(c, NULL));
  lod_collapser_set_epsilon(c, epsilon, DRAFT_GATE * DRAFT_SHARE * DRAFT_SHARE);
  LOD_TRY(lod_draft_run(c, epsilon * DRAFT_SHARE, progress, &proven));
  if (c->surface.live_faces == live)
    return LOD_OK;
  struct snapshot *now;
  bool crosses = false;
  LOD_TRY(take_snapshot(c, c->arena, &now));
  LOD_TRY(look_for_crossings(c, now, &crosses));
  if (crosses)
    return start_afresh(c, afresh);
  c->suspect = NULL;
  c->proxy_faces = c->surface.live_faces;
  c->proxy_epsilon = proven;
  lod_certificate_add_proxy(c->certificate, &now->forward, proven, now->triangle_of);
  *bare = true;
  /* Certificates against this proxy come next: what they would do first a draft does sooner. */
  lod_collapser_set_epsilon(c, epsilon, DRAFT_GATE * SECOND_SHARE * SECOND_SHARE);
  return lod_draft_run(c, epsilon * SECOND_SHARE, progress, &proven);
}

static enum lod_status passes(struct lod_collapser *c, uint32_t first, const struct lod_progress *progress) {
  uint32_t collapsed;
  for (uint32_t pass = first; pass < c->settings.passes; pass++) {
    uint32_t live = c->surface.live_faces;
    LOD_TRY(lod_collapser_pass(c, pass == 0 ? 1 : 4, progress, &collapsed));
    if (collapsed * 200 < live)
      break;
  }
  return LOD_OK;
}

/* Faces of the surface as it stands that began as triangles of a proxy, where there still are such. */
static uint32_t *proxy_hints(const struct lod_collapser *c, const struct lod_proxy *proxy, const struct snapshot *now,
                             struct lod_arena *arena) {
  uint32_t *hints = LOD_NEW(arena, proxy->forward.source->triangle_count, uint32_t);
  for (uint32_t f = 0; hints != NULL && f < c->surface.face_count; f++)
    if (proxy->triangle_of[f] != LOD_NONE)
      hints[proxy->triangle_of[f]] = now->triangle_of[f];
  return hints;
}

/* Collapses that are certified against a proxy. *ran false: its triangles could not be charged. */
static enum lod_status run_against(struct lod_collapser *c, const struct lod_proxy *proxy, double epsilon, struct lod_arena *scratch,
                                   const struct lod_progress *progress, bool *ran) {
  struct snapshot *now;
  struct lod_certificate *coarse, *exact = c->certificate;
  LOD_TRY(take_snapshot(c, scratch, &now));
  double spent = proxy->proven + PROXY_MARGIN * epsilon;
  uint32_t *hints = proxy_hints(c, proxy, now, scratch);
  if (hints == NULL)
    return LOD_MEMORY;
  LOD_TRY(lod_certificate_create_bare(&proxy->forward, c->surface.face_count, epsilon - spent, scratch, &coarse));
  LOD_TRY(lod_certificate_recharge(coarse, &now->forward, now->face_of, hints, ran));
  if (!*ran)
    return LOD_OK;
  c->certificate = coarse;
  c->spent = spent;
  lod_collapser_set_epsilon(c, epsilon, GATE);
  lod_collapser_forget(c);
  find_near(c);
  enum lod_status status = passes(c, 0, progress);
  c->certificate = exact;
  c->spent = 0;
  lod_collapser_forget(c);
  lod_collapser_set_epsilon(c, epsilon, GATE);
  return status;
}

/* *bare as draft_stage's; it becomes true when the charges against the source are no longer those of the surface. */
static enum lod_status coarse_stage(struct lod_collapser *c, double epsilon, const struct lod_progress *progress, bool *bare, bool *ran) {
  const struct lod_proxy *proxy = takes_proxies(c) ? lod_certificate_proxy(c->certificate, PROXY_SHARE * epsilon) : NULL;
  if (proxy == NULL || PROXY_GAIN * proxy->forward.source->triangle_count > c->mesh->triangle_count)
    return LOD_OK;
  struct lod_proxy copy = *proxy;
  struct lod_arena *scratch = lod_arena_create_child(c->arena);
  enum lod_status status = scratch == NULL ? LOD_MEMORY : run_against(c, &copy, epsilon, scratch, progress, ran);
  lod_arena_destroy(scratch);
  *bare = *bare || *ran;
  return status;
}

/* Back to certificates against the source. Within epsilon by what was proven, but perhaps not shown face by face within the pieces allowed:
 * then from the source again, without a draft. */
static enum lod_status charge_stage(struct lod_collapser *c, bool *afresh) {
  struct lod_arena *scratch = lod_arena_create_child(c->arena);
  struct snapshot *now;
  bool charged = false;
  enum lod_status status = scratch == NULL ? LOD_MEMORY : take_snapshot(c, scratch, &now);
  if (status == LOD_OK)
    status = charge(c, now, &charged);
  lod_arena_destroy(scratch);
  if (status == LOD_OK && charged)
    find_near(c);
  if (status != LOD_OK || charged)
    return status;
  c->settings.draft = false;
  return start_afresh(c, afresh);
}

/* The surface as it stands, proven within `epsilon`, becomes a proxy for larger epsilons once it is much smaller than the last one. */
static enum lod_status offer_proxy(struct lod_collapser *c, double epsilon) {
  if (2 * c->surface.live_faces > c->proxy_faces)
    return LOD_OK;
  struct snapshot *now;
  LOD_TRY(take_snapshot(c, c->arena, &now));
  c->proxy_faces = c->surface.live_faces;
  c->proxy_epsilon = epsilon;
  lod_certificate_add_proxy(c->certificate, &now->forward, epsilon, now->triangle_of);
  return LOD_OK;
}

enum lod_status lod_collapser_run(struct lod_collapser *c, double epsilon, const struct lod_progress *progress) {
  bool afresh = true, ran = false;
  while (afresh) {
    bool bare = false;
    afresh = ran = false;
    LOD_TRY(draft_stage(c, epsilon, progress, &bare, &afresh));
    if (afresh)
      continue;
    LOD_TRY(make_guard(c, NULL));
    LOD_TRY(coarse_stage(c, epsilon, progress, &bare, &ran));
    lod_collapser_set_epsilon(c, epsilon, is_coplanar(c, epsilon) ? INFINITY : GATE);
    if (bare)
      LOD_TRY(charge_stage(c, &afresh));
  }
  lod_collapser_set_epsilon(c, epsilon, is_coplanar(c, epsilon) ? INFINITY : GATE);
  LOD_TRY(passes(c, ran ? 1 : 0, progress));
  LOD_TRY(lod_polish_run(c, progress));
  lod_collapser_reach(c, epsilon);
  return offer_proxy(c, epsilon);
}
