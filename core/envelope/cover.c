#include "core/envelope/cover.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/tolerance.h"
#include "core/envelope/cover_internal.h"
#include "core/envelope/prism.h"

struct lod_cover_settings lod_cover_defaults(void) {
  return (struct lod_cover_settings){.reach = 2, .rounds = 4, .budget = 60, .crease_degrees = LOD_TOLERANCE_CREASE_DEGREES};
}

/* ---- set-up ---- */

static enum lod_status check_settings(const struct lod_mesh *mesh, const struct lod_mesh *source, const struct lod_cover_settings *settings,
                                      struct lod_problem *problem) {
  if (settings->reach < 2 || settings->rounds == 0)
    return lod_fail(problem, LOD_BAD_INPUT, "bad-reach", "A cover needs a reach of 2 edges or more and a round or more.");
  for (uint32_t i = 0; i < settings->preserved_count; i++)
    if (settings->preserved[i][0] >= mesh->vertex_count || settings->preserved[i][1] >= mesh->vertex_count)
      return lod_fail(problem, LOD_BAD_INPUT, "bad-edge", "Preserved edge %u names vertex %u, but there are %u.", i,
                      settings->preserved[i][settings->preserved[i][0] >= mesh->vertex_count ? 0 : 1], mesh->vertex_count);
  for (uint32_t v = 0; settings->vertex_epsilon != NULL && v < source->vertex_count; v++)
    if (!(settings->vertex_epsilon[v] >= 0 && settings->vertex_epsilon[v] <= 1))
      return lod_fail(problem, LOD_BAD_INPUT, "bad-epsilon", "The share of epsilon at vertex %u must be in [0, 1], not %g.", v,
                      (double)settings->vertex_epsilon[v]);
  return LOD_OK;
}

/* What a cover begins with. */
struct beginning {
  const struct lod_mesh *mesh, *source;
  const struct lod_bvh *bvh;
  const struct lod_certificate *proof; /* NULL: the mesh is the source */
  const uint32_t *face_to;
};

/* A start that is not the source: what its faces answer for is known, which vertices of lines stand for which is not. */
static enum lod_status take_over(struct lod_cover *c, const struct beginning *from) {
  for (uint32_t v = 0; v < c->mesh->vertex_count; v++) {
    if (c->kind[v] == COVER_CURVE)
      c->kind[v] = COVER_FIXED;
    c->near[v] = lod_bvh_closest(c->bvh, cover_point(c, v), LOD_NONE, INFINITY).primitive;
  }
  return lod_certificate_adopt(c->certificate, from->proof, from->face_to);
}

static enum lod_status set_up(struct lod_cover *c, const struct beginning *from, struct lod_arena *scratch) {
  struct lod_adjacency adjacency;
  c->mesh = from->mesh;
  c->source = from->source;
  c->bvh = from->bvh;
  LOD_TRY(lod_adjacency_create(c->mesh, scratch, &adjacency));
  LOD_TRY(lod_offset_directions(c->mesh, &adjacency, c->settings.crease_degrees, c->arena, &c->offset));
  if (from->proof == NULL)
    LOD_TRY(lod_certificate_create(c->source, c->bvh, NULL, 0, c->arena, &c->certificate));
  else
    LOD_TRY(lod_certificate_create_bare(lod_certificate_source(from->proof), c->source->triangle_count, 0, c->arena, &c->certificate));
  c->margin = 2 * lod_tolerance_rounding(lod_mesh_magnitude(c->source));
  c->report.alpha = 1;
  if (c->settings.offsets != LOD_COVER_NO_OFFSETS && (c->vertex_epsilon = LOD_NEW(c->arena, c->mesh->vertex_count, double)) == NULL)
    return LOD_MEMORY;
  LOD_TRY(cover_mesh_create(c, &adjacency));
  return from->proof == NULL ? LOD_OK : take_over(c, from);
}

static enum lod_status create(const struct beginning *from, const struct lod_cover_settings *settings, struct lod_arena *arena,
                              struct lod_cover **cover, struct lod_problem *problem) {
  struct lod_cover_check check;
  struct lod_cover_settings all = settings == NULL ? lod_cover_defaults() : *settings;
  LOD_TRY(check_settings(from->mesh, from->source, &all, problem));
  LOD_TRY(lod_cover_validate(from->mesh, all.crease_degrees, arena, &check, problem));
  struct lod_cover *c = LOD_NEW_ZERO(arena, 1, struct lod_cover);
  struct lod_arena *scratch = lod_arena_create_child(arena);
  enum lod_status status = c == NULL || scratch == NULL ? LOD_MEMORY : LOD_OK;
  if (status == LOD_OK) {
    c->arena = arena;
    c->settings = all;
    status = set_up(c, from, scratch);
  }
  lod_arena_destroy(scratch);
  *cover = c;
  return status == LOD_OK ? LOD_OK : lod_fail_memory(problem);
}

enum lod_status lod_cover_create(const struct lod_mesh *mesh, const struct lod_bvh *bvh, const struct lod_cover_settings *settings,
                                 struct lod_arena *arena, struct lod_cover **cover, struct lod_problem *problem) {
  return create(&(struct beginning){.mesh = mesh, .source = mesh, .bvh = bvh}, settings, arena, cover, problem);
}

enum lod_status lod_cover_create_from(const struct lod_mesh *start, const struct lod_mesh *source, const struct lod_bvh *source_bvh,
                                      const struct lod_certificate *proof, const uint32_t *face_to,
                                      const struct lod_cover_settings *settings, struct lod_arena *arena, struct lod_cover **cover,
                                      struct lod_problem *problem) {
  assert(settings == NULL || settings->offsets == LOD_COVER_NO_OFFSETS); /* they are made over the source */
  return create(&(struct beginning){start, source, source_bvh, proof, face_to}, settings, arena, cover, problem);
}

/* ---- candidates, largest first ---- */

static bool out_of_budget(struct lod_cover *c) {
  c->report.tried++;
  return (c->vertices_to_go -= 1) < 0;
}

/* A heap of candidates whose counts may have fallen since: the top is counted again before it is believed (lazy greedy). */
struct queue {
  struct cover_candidate *items;
  size_t count;
};

static bool larger(const struct cover_candidate *a, const struct cover_candidate *b) {
  if (a->count != b->count)
    return a->count > b->count;
  if (a->height < b->height || a->height > b->height)
    return a->height < b->height;
  for (int k = 0; k < 3; k++)
    if (a->v[k] != b->v[k])
      return a->v[k] < b->v[k];
  return false;
}

static void sift_down(struct queue *queue, size_t i) {
  struct cover_candidate item = queue->items[i];
  for (;;) {
    size_t child = 2 * i + 1;
    if (child >= queue->count)
      break;
    if (child + 1 < queue->count && larger(&queue->items[child + 1], &queue->items[child]))
      child++;
    if (!larger(&queue->items[child], &item))
      break;
    queue->items[i] = queue->items[child];
    i = child;
  }
  queue->items[i] = item;
}

static void drop_top(struct queue *queue) {
  queue->items[0] = queue->items[--queue->count];
  if (queue->count > 0)
    sift_down(queue, 0);
}

/* The largest candidate that was tried in vain since the last that fitted, as it counts now: its ratio to the one that fitted is what
 * greedy lost to overlaps (6.4). */
static void note_step(struct lod_cover *c, uint32_t largest_refused, uint32_t count) {
  c->report.steps++;
  if (count > c->report.largest_set)
    c->report.largest_set = count;
  if (largest_refused > count)
    c->report.alpha = fmax(c->report.alpha, (double)largest_refused / count);
}

static enum lod_status choose(struct lod_cover *c, struct queue *queue, const struct lod_progress *progress, uint32_t *steps) {
  uint32_t refused = 0;
  for (uint64_t i = 0; queue->count > 0; i++) {
    if (i % 256 == 0 && lod_progress_cancelled(progress))
      return LOD_CANCELLED;
    struct cover_candidate *top = &queue->items[0];
    if (!cover_stands(c, top->v[0]) || !cover_stands(c, top->v[1]) || !cover_stands(c, top->v[2])) {
      drop_top(queue);
      continue;
    }
    uint32_t count = cover_count(c, top->v);
    if (count == 0) {
      drop_top(queue);
      continue;
    }
    if (count < top->count) {
      top->count = count;
      sift_down(queue, 0);
      continue;
    }
    if (out_of_budget(c))
      return LOD_OK;
    bool done;
    uint32_t v[3] = {top->v[0], top->v[1], top->v[2]};
    drop_top(queue);
    LOD_TRY(cover_try_triangle(c, v, &done));
    if (done) {
      note_step(c, refused, count);
      refused = 0;
      ++*steps;
    } else if (count > refused) {
      refused = count;
    }
  }
  return LOD_OK;
}

static enum lod_status candidate_round(struct lod_cover *c, const struct lod_progress *progress, uint32_t *steps) {
  struct lod_arena *scratch = lod_arena_create_child(c->arena);
  struct queue queue = {0};
  enum lod_status status = scratch == NULL ? LOD_MEMORY : cover_candidates(c, scratch, &queue.items, &queue.count);
  c->report.candidates += queue.count;
  if (status == LOD_OK) /* sorted, and so a heap already */
    status = choose(c, &queue, progress, steps);
  lod_arena_destroy(scratch);
  return status;
}

/* ---- vertices, one by one ---- */

struct removal {
  double cost;
  uint32_t vertex, stamp;
};

static int compare_removals(const void *x, const void *y) {
  const struct removal *a = x, *b = y;
  if (a->cost < b->cost || a->cost > b->cost)
    return a->cost < b->cost ? -1 : 1;
  return a->vertex < b->vertex ? -1 : a->vertex > b->vertex;
}

/* How far a vertex stands from the plane through the middle of its neighbours; on a line, from the chord. */
static double removal_cost(const struct lod_cover *c, uint32_t v) {
  struct lod_vec3 p = cover_point(c, v), sum = {0, 0, 0}, normal = {0, 0, 0};
  const struct cover_ring *ring = &c->ring[v];
  for (uint32_t i = 0; i < ring->count; i++) {
    const uint32_t *w = c->face[ring->faces[i]];
    struct lod_vec3 a = cover_point(c, w[0]), b = cover_point(c, w[1]), d = cover_point(c, w[2]);
    normal = lod_vec3_add(normal, lod_vec3_cross(lod_vec3_subtract(b, a), lod_vec3_subtract(d, a)));
    sum = lod_vec3_add(sum, lod_vec3_scale(lod_vec3_subtract(lod_vec3_add(a, lod_vec3_add(b, d)), p), 0.5 / ring->count));
  }
  return fabs(lod_vec3_dot(lod_vec3_normalize(normal), lod_vec3_subtract(p, sum)));
}

/* Tries all vertices of some kinds, those nearest to their neighbours' plane first, until a pass finds none. */
static enum lod_status remove_vertices(struct lod_cover *c, enum cover_kind most, struct lod_arena *scratch,
                                       const struct lod_progress *progress, uint32_t *removed) {
  struct removal *order = LOD_NEW(scratch, c->mesh->vertex_count, struct removal);
  uint32_t *tried = LOD_NEW(scratch, c->mesh->vertex_count, uint32_t); /* stamp at the last try */
  if (order == NULL || tried == NULL)
    return LOD_MEMORY;
  memset(tried, 0xff, c->mesh->vertex_count * sizeof *tried);
  for (bool any = true; any;) {
    uint32_t count = 0;
    any = false;
    for (uint32_t v = 0; v < c->mesh->vertex_count; v++)
      if (cover_stands(c, v) && c->kind[v] <= most && (most == COVER_INTERIOR || c->kind[v] == most) && tried[v] != c->stamp[v])
        order[count++] = (struct removal){removal_cost(c, v), v, c->stamp[v]};
    qsort(order, count, sizeof *order, compare_removals);
    for (uint32_t i = 0; i < count; i++) {
      uint32_t v = order[i].vertex;
      bool done;
      if (c->stamp[v] != order[i].stamp)
        continue; /* in the next pass */
      if (out_of_budget(c))
        return LOD_OK;
      if (i % 256 == 0 && lod_progress_cancelled(progress))
        return LOD_CANCELLED;
      tried[v] = c->stamp[v];
      LOD_TRY(cover_try_vertex(c, v, &done));
      any = any || done;
      *removed += done;
    }
  }
  return LOD_OK;
}

static enum lod_status vertex_round(struct lod_cover *c, enum cover_kind kind, const struct lod_progress *progress, uint32_t *removed) {
  struct lod_arena *scratch = lod_arena_create_child(c->arena);
  enum lod_status status = scratch == NULL ? LOD_MEMORY : remove_vertices(c, kind, scratch, progress, removed);
  lod_arena_destroy(scratch);
  return status;
}

/* ---- a run ---- */

static enum lod_status make_offsets(struct lod_cover *c) {
  if (c->settings.offsets == LOD_COVER_NO_OFFSETS)
    return LOD_OK;
  for (uint32_t v = 0; v < c->mesh->vertex_count; v++)
    c->vertex_epsilon[v] = (c->epsilon - c->margin) * (c->settings.vertex_epsilon == NULL ? 1 : (double)c->settings.vertex_epsilon[v]);
  enum lod_offset_rule rule = c->settings.offsets == LOD_COVER_PAPER_OFFSETS ? LOD_OFFSET_PAPER : LOD_OFFSET_APART;
  LOD_TRY(lod_offset_thicken(c->mesh, c->bvh, rule, c->vertex_epsilon, c->arena, &c->offset));
  c->report.thinnest = INFINITY;
  c->report.thickest = 0;
  for (uint32_t t = 0; t < c->mesh->triangle_count; t++)
    for (int k = 0; k < 3; k++) {
      uint32_t v = c->mesh->triangles[t][k];
      c->report.thinnest = fmin(c->report.thinnest, fmin(c->offset.outer[v], c->offset.inner[v]));
      c->report.thickest = fmax(c->report.thickest, fmax(c->offset.outer[v], c->offset.inner[v]));
    }
  return LOD_OK;
}

enum lod_status lod_cover_run(struct lod_cover *c, double epsilon, const struct lod_progress *progress) {
  c->epsilon = epsilon;
  c->vertices_to_go = c->settings.budget * (double)c->live;
  LOD_TRY(make_offsets(c));
  for (uint32_t round = 0; round < c->settings.rounds; round++) {
    uint32_t before = c->live, removed = 0, steps = 0;
    if (c->settings.offsets == LOD_COVER_NO_OFFSETS && round > 0)
      cover_renew_fibers(c);
    LOD_TRY(vertex_round(c, COVER_CURVE, progress, &removed));
    if (!c->settings.vertices_only)
      LOD_TRY(candidate_round(c, progress, &steps));
    LOD_TRY(vertex_round(c, COVER_INTERIOR, progress, &removed));
    c->report.removed_singly += removed;
    if (c->vertices_to_go < 0 || (before - c->live) * 100 < before)
      break;
  }
  return LOD_OK;
}

uint32_t lod_cover_triangle_count(const struct lod_cover *c) {
  return c->live;
}

struct lod_cover_report lod_cover_report(const struct lod_cover *c) {
  struct lod_cover_report report = c->report;
  double d = report.largest_set > 1 ? report.largest_set : 1;
  report.optimum_at_least = c->live / (report.alpha * (1 + log2(d)));
  return report;
}

/* ---- result ---- */

/* The wedge of source vertex v for a face there: of the source triangles at v on the face's side of all lines, the one that lies most in
 * the face's direction. */
static uint32_t wedge_of(const struct lod_cover *c, const struct lod_adjacency *adjacency, uint32_t f, uint32_t v) {
  const struct lod_mesh *mesh = c->mesh;
  struct lod_vec3 p = cover_point(c, v), middle = {0, 0, 0};
  for (int k = 0; k < 3; k++)
    middle = lod_vec3_add(middle, lod_vec3_subtract(cover_point(c, c->face[f][k]), p));
  middle = lod_vec3_normalize(middle);
  uint32_t best = LOD_NONE;
  double best_cosine = -INFINITY;
  for (uint32_t i = adjacency->vertex_begin[v]; i < adjacency->vertex_begin[v + 1]; i++) {
    uint32_t corner = adjacency->vertex_corners[i], t = corner / 3;
    struct lod_vec3 direction = {0, 0, 0};
    for (int k = 0; k < 3; k++)
      direction = lod_vec3_add(direction, lod_vec3_subtract(cover_point(c, mesh->triangles[t][k]), p));
    double cosine = lod_vec3_dot(lod_vec3_normalize(direction), middle) + (c->patch[t] == c->patch[f] ? 4 : 0);
    if (cosine > best_cosine) {
      best_cosine = cosine;
      best = mesh->corners[t][corner % 3];
    }
  }
  return best;
}

static enum lod_status copy_attributes(const struct lod_cover *c, struct lod_arena *arena, struct lod_arena *scratch, struct lod_mesh *to) {
  const struct lod_mesh *from = c->mesh;
  struct lod_adjacency adjacency;
  LOD_TRY(lod_adjacency_create(from, scratch, &adjacency));
  uint32_t *wedge_to = LOD_NEW(scratch, from->wedge_count, uint32_t), *wedge_from = LOD_NEW(scratch, from->wedge_count, uint32_t);
  to->corners = lod_arena_alloc(arena, to->triangle_count, sizeof *to->corners);
  if (wedge_to == NULL || wedge_from == NULL || to->corners == NULL)
    return LOD_MEMORY;
  memset(wedge_to, 0xff, from->wedge_count * sizeof *wedge_to);
  for (uint32_t f = 0, out = 0; f < from->triangle_count; f++) {
    if (c->face[f][0] == LOD_NONE)
      continue;
    for (int k = 0; k < 3; k++) {
      uint32_t wedge = wedge_of(c, &adjacency, f, c->face[f][k]);
      if (wedge_to[wedge] == LOD_NONE) {
        wedge_from[to->wedge_count] = wedge;
        wedge_to[wedge] = to->wedge_count++;
      }
      to->corners[out][k] = wedge_to[wedge];
    }
    out++;
  }
  to->wedge_vertex = LOD_NEW(arena, to->wedge_count, uint32_t);
  bool ok = to->wedge_vertex != NULL;
  ok = ok && (from->normals == NULL || (to->normals = lod_arena_alloc(arena, to->wedge_count, sizeof *to->normals)) != NULL);
  ok = ok && (from->colors == NULL || (to->colors = lod_arena_alloc(arena, to->wedge_count, sizeof *to->colors)) != NULL);
  for (int set = 0; set < LOD_UV_SETS; set++)
    ok = ok && (from->uvs[set] == NULL || (to->uvs[set] = lod_arena_alloc(arena, to->wedge_count, sizeof *to->uvs[set])) != NULL);
  if (!ok)
    return LOD_MEMORY;
  for (uint32_t t = 0; t < to->triangle_count; t++)
    for (int k = 0; k < 3; k++)
      to->wedge_vertex[to->corners[t][k]] = to->triangles[t][k];
  for (uint32_t w = 0; w < to->wedge_count; w++) {
    if (to->normals != NULL)
      memcpy(to->normals[w], from->normals[wedge_from[w]], sizeof to->normals[w]);
    if (to->colors != NULL)
      memcpy(to->colors[w], from->colors[wedge_from[w]], sizeof to->colors[w]);
    for (int set = 0; set < LOD_UV_SETS; set++)
      if (to->uvs[set] != NULL)
        memcpy(to->uvs[set][w], from->uvs[set][wedge_from[w]], sizeof to->uvs[set][w]);
  }
  return LOD_OK;
}

static enum lod_status extract(const struct lod_cover *c, struct lod_arena *arena, struct lod_arena *scratch, struct lod_mesh *to,
                               uint32_t *vertex_of, uint32_t *nearby) {
  const struct lod_mesh *from = c->mesh;
  uint32_t *vertex_to = vertex_of != NULL ? vertex_of : LOD_NEW(scratch, from->vertex_count, uint32_t);
  uint32_t *face_to = LOD_NEW(scratch, c->source->triangle_count, uint32_t);
  *to = (struct lod_mesh){0};
  to->positions = lod_arena_alloc(arena, from->vertex_count, sizeof *to->positions);
  to->triangles = lod_arena_alloc(arena, c->live, sizeof *to->triangles);
  to->materials = from->materials == NULL ? NULL : LOD_NEW(arena, c->live, uint32_t);
  to->parts = from->parts == NULL ? NULL : LOD_NEW(arena, c->live, uint32_t);
  if (vertex_to == NULL || face_to == NULL || to->positions == NULL || to->triangles == NULL ||
      (from->materials != NULL && to->materials == NULL) || (from->parts != NULL && to->parts == NULL))
    return LOD_MEMORY;
  memset(face_to, 0xff, c->source->triangle_count * sizeof *face_to);
  for (uint32_t v = 0; v < from->vertex_count; v++) {
    vertex_to[v] = cover_stands(c, v) ? to->vertex_count : LOD_NONE;
    if (vertex_to[v] != LOD_NONE)
      memcpy(to->positions[to->vertex_count++], from->positions[v], sizeof *to->positions);
  }
  for (uint32_t f = 0; f < from->triangle_count; f++) {
    face_to[f] = c->face[f][0] == LOD_NONE ? LOD_NONE : to->triangle_count++;
    if (face_to[f] == LOD_NONE)
      continue;
    for (int k = 0; k < 3; k++)
      to->triangles[face_to[f]][k] = vertex_to[c->face[f][k]];
    if (to->materials != NULL)
      to->materials[face_to[f]] = from->materials[f];
    if (to->parts != NULL)
      to->parts[face_to[f]] = from->parts[f];
  }
  if (nearby != NULL)
    lod_certificate_charged(c->certificate, face_to, nearby);
  return from->wedge_count == 0 ? LOD_OK : copy_attributes(c, arena, scratch, to);
}

enum lod_status lod_cover_extract(const struct lod_cover *c, struct lod_arena *arena, struct lod_mesh *mesh, uint32_t *vertex_of,
                                  uint32_t *nearby) {
  struct lod_arena *scratch = lod_arena_create_child(arena);
  enum lod_status status = scratch == NULL ? LOD_MEMORY : extract(c, arena, scratch, mesh, vertex_of, nearby);
  lod_arena_destroy(scratch);
  return status;
}

/* Where the fiber of v meets the plane of a face, when that is in the face. */
static bool along_normal(const struct lod_cover *c, uint32_t v, const struct lod_vec3 q[3], struct lod_vec3 *target) {
  struct lod_vec3 p = cover_point(c, v), d = c->normal[v];
  struct lod_vec3 n = lod_vec3_cross(lod_vec3_subtract(q[1], q[0]), lod_vec3_subtract(q[2], q[0]));
  double slope = lod_vec3_dot(n, d);
  if (!(fabs(slope) > 1e-6 * lod_vec3_length(n)))
    return false;
  *target = lod_vec3_add_scaled(p, d, lod_vec3_dot(n, lod_vec3_subtract(q[0], p)) / slope);
  for (int k = 0; k < 3; k++)
    if (lod_vec3_dot(n, lod_vec3_cross(lod_vec3_subtract(q[(k + 1) % 3], q[k]), lod_vec3_subtract(*target, q[k]))) < 0)
      return false;
  return true;
}

void lod_cover_replacements(const struct lod_cover *c, uint32_t *triangle, struct lod_vec3 *target) {
  uint32_t out = 0;
  for (uint32_t v = 0; v < c->mesh->vertex_count; v++) {
    triangle[v] = LOD_NONE;
    target[v] = cover_point(c, v);
  }
  for (uint32_t f = 0; f < c->mesh->triangle_count; f++) {
    if (c->face[f][0] == LOD_NONE)
      continue;
    struct lod_vec3 q[3];
    for (int k = 0; k < 3; k++)
      q[k] = cover_point(c, c->face[f][k]);
    for (uint32_t v = c->first[f]; v != LOD_NONE; v = c->next[v]) {
      triangle[v] = out;
      if (!along_normal(c, v, q, &target[v]) || lod_vec3_distance(target[v], cover_point(c, v)) > c->epsilon)
        target[v] = lod_closest_on_triangle(cover_point(c, v), q[0], q[1], q[2]);
    }
    out++;
  }
}
