/* Tessellation that follows a view. See dynamic.h. */
#include "core/clod/dynamic.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/sets.h"
#include "core/clod/halve.h"

static const double kPi = 3.14159265358979323846;

/* Edges are cut a little finer than the tolerance asks for, so that the ring beside them can meet it with a grid of finite fineness. */
static const double kEdgeShare = 0.8;
/* What float coordinates and the points that a pixel's width moves take of the tolerance. */
static const double kMargin = 0.97;

enum { CLASSES = 128, ROUNDS = 24 };

/* A bump allocator of numbers with free lists, for vertices and for indices. */
struct slots {
  uint32_t next, room;
  uint32_t *free[CLASSES];
  uint32_t free_count[CLASSES], free_room[CLASSES];
};

struct patch_state {
  struct lod_vec3 centre, axis;
  double radius, sine;    /* sine 2: no cone, or not closed */
  double bend;            /* lod_bezier_deviation of one triangle */
  double tolerance;       /* of now, model units */
  double deviation;       /* of its triangles */
  uint32_t makes[3];      /* of its edges, when its triangles were made */
  uint32_t pattern, grid; /* grid 0: has no triangles */
  uint32_t inner, inner_room, first_index, index_count, index_room;
};

struct edge_state {
  double bend;
  uint32_t users[2]; /* 3 * patch + side, along and against */
  uint32_t factor;   /* 0: has no vertices */
  uint32_t finer;    /* its parts are so many times more than its own curve asks for, since the ring of a patch could not be met */
  uint32_t make;     /* counts how often it was made: its vertices may have moved */
  uint32_t first[2], room[2];
};

struct lod_dynamic {
  struct lod_arena *arena, *surface_arena; /* own; what belongs to the halved surface */
  const struct lod_patches *given;
  struct lod_patches surface;
  uint32_t *roots;
  bool halved, *shows_front_only; /* of given patches */
  struct patch_state *whole;      /* of given patches: their bounds */
  struct patch_state *patches;
  struct edge_state *edges;
  uint32_t (*corner_vertex)[3];
  bool *split;     /* of edges: two sets of vertices, since normals or attributes jump */
  uint32_t *order; /* patches, by material */
  uint8_t *visible;
  struct lod_pattern_cache cache; /* in `arena` */
  enum lod_smoothness smoothness;

  struct slots vertices, indices;
  float (*positions)[3], (*normals)[3];
  float *numbers; /* attributes, as many a vertex as the surface has */
  uint32_t width;
  struct lod_dynamic_group *groups;
  uint32_t group_count, group_room;
  uint32_t *vertex_roots, *index_pool, *drawn;
  uint32_t drawn_count, drawn_room;
  uint32_t (*changed)[2];
  uint32_t changed_count, changed_room;
  bool told; /* of the changes */
};

struct lod_dynamic_settings lod_dynamic_defaults(void) {
  return (struct lod_dynamic_settings){.pixels = 0.5, .cull_outside = true, .cull_back = true, .most_patches = 1u << 20};
}

/* ---- memory ---- */

static bool grow(struct lod_arena *arena, void **array, uint32_t *room, uint32_t needed, size_t size) {
  if (needed <= *room)
    return true;
  uint32_t larger = needed + needed / 2 + 1024;
  void *grown = larger < needed ? NULL : lod_arena_alloc(arena, larger, size);
  if (grown == NULL)
    return false;
  if (*room > 0)
    memcpy(grown, *array, *room * size);
  *array = grown;
  *room = larger;
  return true;
}

/* Sizes that are given out: 4, 5, 6, 7 times a power of two. */
static uint32_t class_of(uint32_t count, uint32_t *size) {
  uint32_t shift = 0, c = 0;
  while ((7u << shift) < count)
    shift++;
  for (c = 4; (c << shift) < count; c++)
    ;
  *size = c << shift;
  return 4 * shift + c - 4;
}

/* *room: what was asked for, rounded up. LOD_NONE: memory. */
static uint32_t take(struct lod_dynamic *d, struct slots *slots, uint32_t count, uint32_t *room) {
  uint32_t c = class_of(count, room);
  if (slots->free_count[c] > 0)
    return slots->free[c][--slots->free_count[c]];
  if (slots->next > UINT32_MAX / 2)
    return LOD_NONE;
  uint32_t needed = slots->next + *room;
  if (needed > slots->room) {
    uint32_t before = slots->room, rooms[4] = {before, before, before, before};
    if (slots == &d->indices) {
      if (!grow(d->arena, (void **)&d->index_pool, &rooms[0], needed, sizeof *d->index_pool))
        return LOD_NONE;
    } else if (!grow(d->arena, (void **)&d->positions, &rooms[0], needed, sizeof *d->positions) ||
               !grow(d->arena, (void **)&d->normals, &rooms[1], needed, sizeof *d->normals) ||
               !grow(d->arena, (void **)&d->vertex_roots, &rooms[2], needed, sizeof *d->vertex_roots) ||
               (d->width > 0 && !grow(d->arena, (void **)&d->numbers, &rooms[3], needed, d->width * sizeof *d->numbers))) {
      return LOD_NONE;
    }
    slots->room = rooms[0];
  }
  uint32_t first = slots->next;
  slots->next = needed;
  return first;
}

static bool give(struct lod_dynamic *d, struct slots *slots, uint32_t first, uint32_t room) {
  uint32_t size, c = class_of(room, &size);
  if (!grow(d->arena, (void **)&slots->free[c], &slots->free_room[c], slots->free_count[c] + 1, sizeof **slots->free))
    return false;
  slots->free[c][slots->free_count[c]++] = first;
  return true;
}

/* At least `count` from *first on, *room of them; what was there before is given back when it is too small or far too large. */
static bool retake(struct lod_dynamic *d, struct slots *slots, uint32_t count, uint32_t *first, uint32_t *room) {
  if (count <= *room && *room <= 2 * count + 8)
    return true;
  if (*room > 0 && !give(d, slots, *first, *room))
    return false;
  *room = 0;
  if (count == 0)
    return true;
  *first = take(d, slots, count, room);
  return *first != LOD_NONE;
}

static bool mark_changed(struct lod_dynamic *d, uint32_t first, uint32_t count) {
  if (count == 0)
    return true;
  if (!grow(d->arena, (void **)&d->changed, &d->changed_room, d->changed_count + 1, sizeof *d->changed))
    return false;
  d->changed[d->changed_count][0] = first;
  d->changed[d->changed_count++][1] = count;
  return true;
}

/* ---- the surface ---- */

static void bound_patch(const struct lod_bezier *net, struct patch_state *state) {
  struct lod_vec3 sum = {0, 0, 0};
  for (int i = 0; i < LOD_BEZIER_POINTS; i++)
    sum = lod_vec3_add(sum, net->p[i]);
  state->centre = lod_vec3_scale(sum, 1.0 / LOD_BEZIER_POINTS);
  double square = 0;
  for (int i = 0; i < LOD_BEZIER_POINTS; i++)
    square = fmax(square, lod_vec3_distance_squared(net->p[i], state->centre));
  state->radius = sqrt(square) * (1 + 1e-12);
  state->bend = lod_bezier_deviation(net, 1);
  if (!lod_bezier_normal_cone(net, &state->axis, &state->sine))
    state->sine = 2;
}

/* Patches of components that have a border, or are not turned outwards, show their backs. */
static enum lod_status find_closed(struct lod_dynamic *d, struct lod_arena *scratch) {
  const struct lod_patches *patches = d->given;
  uint32_t *sets = LOD_NEW(scratch, patches->patch_count, uint32_t);
  double *volume = LOD_NEW_ZERO(scratch, patches->patch_count, double);
  if (sets == NULL || volume == NULL)
    return LOD_MEMORY;
  for (uint32_t p = 0; p < patches->patch_count; p++)
    sets[p] = p;
  for (uint32_t p = 0; p < patches->patch_count; p++)
    for (uint32_t k = 0; k < 3; k++)
      if (patches->partners[p][k] != LOD_NONE)
        lod_sets_join(sets, p, patches->partners[p][k] / 3);
  for (uint32_t p = 0; p < patches->patch_count; p++) {
    const uint32_t *c = patches->corners[p];
    double *sum = &volume[lod_sets_find(sets, p)];
    *sum += lod_vec3_dot(patches->positions[c[0]], lod_vec3_cross(patches->positions[c[1]], patches->positions[c[2]]));
    for (uint32_t k = 0; k < 3; k++)
      if (patches->partners[p][k] == LOD_NONE)
        *sum = -INFINITY;
  }
  for (uint32_t p = 0; p < patches->patch_count; p++)
    d->shows_front_only[p] = volume[lod_sets_find(sets, p)] > 0;
  return LOD_OK;
}

static uint32_t material_of(const struct lod_dynamic *d, uint32_t patch) {
  return d->surface.materials == NULL ? LOD_NONE : d->surface.materials[patch];
}

struct sorted {
  uint32_t material, patch;
};

static int by_material(const void *a, const void *b) {
  const struct sorted *x = a, *y = b;
  if (x->material != y->material)
    return x->material < y->material ? -1 : 1;
  return x->patch < y->patch ? -1 : x->patch > y->patch;
}

static enum lod_status sort_patches(struct lod_dynamic *d) {
  uint32_t count = d->surface.patch_count;
  struct sorted *list = LOD_NEW(d->surface_arena, count, struct sorted);
  d->order = LOD_NEW(d->surface_arena, count, uint32_t);
  if (list == NULL || d->order == NULL)
    return LOD_MEMORY;
  for (uint32_t p = 0; p < count; p++)
    list[p] = (struct sorted){material_of(d, p), p};
  if (count > 1 && d->surface.materials != NULL)
    qsort(list, count, sizeof *list, by_material);
  for (uint32_t p = 0; p < count; p++)
    d->order[p] = list[p].patch;
  return LOD_OK;
}

static enum lod_status prepare(struct lod_dynamic *d) {
  const struct lod_patches *s = &d->surface;
  struct lod_arena *arena = d->surface_arena;
  d->patches = LOD_NEW_ZERO(arena, s->patch_count, struct patch_state);
  d->edges = LOD_NEW_ZERO(arena, s->edge_count, struct edge_state);
  d->corner_vertex = lod_arena_alloc(arena, s->patch_count, sizeof *d->corner_vertex);
  d->visible = LOD_NEW_ZERO(arena, s->patch_count, uint8_t);
  d->split = LOD_NEW(arena, s->edge_count, bool);
  if (d->patches == NULL || d->edges == NULL || d->corner_vertex == NULL || d->visible == NULL || d->split == NULL)
    return LOD_MEMORY;
  for (uint32_t e = 0; e < s->edge_count; e++) {
    struct lod_bezier_curve curve = lod_patches_edge(s, e);
    d->edges[e].bend = lod_bezier_curve_deviation(&curve, 1);
    d->edges[e].users[0] = d->edges[e].users[1] = LOD_NONE;
    d->edges[e].finer = 1;
  }
  for (uint32_t p = 0; p < s->patch_count; p++) {
    struct lod_bezier net = lod_patches_net(s, p);
    bound_patch(&net, &d->patches[p]);
    for (uint32_t k = 0; k < 3; k++)
      d->edges[s->edges[p][k] >> 1].users[s->edges[p][k] & 1] = 3 * p + k;
    if (!d->shows_front_only[d->roots == NULL ? p : d->roots[p]])
      d->patches[p].sine = 2;
  }
  for (uint32_t e = 0; e < s->edge_count; e++)
    d->split[e] = lod_patches_are_split(s, e, d->edges[e].users);
  return sort_patches(d);
}

/* Numbers of vertex `vertex`, which lies at these barycentric coordinates of a patch. */
static void set_numbers(struct lod_dynamic *d, uint32_t vertex, uint32_t patch, const double at[3]) {
  if (d->width > 0)
    lod_patch_attributes_mix(&d->surface.attributes, patch, at, d->numbers + (size_t)d->width * vertex);
}

/* Numbers the vertices of corners: one for each sector and wedge, one for each patch where there is no sector. Returns how many. */
static uint32_t number_corners(struct lod_dynamic *d, uint32_t *of_sector) {
  const struct lod_patches *s = &d->surface;
  const struct lod_patch_attributes *a = &s->attributes;
  uint32_t count = 0;
  memset(of_sector, 0xff, s->normal_count * sizeof *of_sector);
  for (uint32_t h = 0; h < 3 * s->patch_count; h++) {
    uint32_t p = h / 3, k = h % 3, sector = s->sectors[p][k], user = sector == LOD_NONE ? LOD_NONE : of_sector[sector];
    if (user != LOD_NONE && (d->width == 0 || !lod_patch_attributes_differ(a, a->corners[p][k], a->corners[user / 3][user % 3]))) {
      d->corner_vertex[p][k] = d->corner_vertex[user / 3][user % 3];
      continue;
    }
    d->corner_vertex[p][k] = count++;
    if (sector != LOD_NONE)
      of_sector[sector] = h;
  }
  return count;
}

static enum lod_status make_corners(struct lod_dynamic *d) {
  const struct lod_patches *s = &d->surface;
  uint32_t *of_sector = LOD_NEW(d->surface_arena, s->normal_count, uint32_t), room;
  if (of_sector == NULL)
    return LOD_MEMORY;
  uint32_t count = number_corners(d, of_sector), first = count == 0 ? 0 : take(d, &d->vertices, count, &room), made = 0;
  if (first == LOD_NONE)
    return LOD_MEMORY;
  for (uint32_t p = 0; p < s->patch_count; p++)
    for (uint32_t k = 0; k < 3; k++) {
      uint32_t vertex = d->corner_vertex[p][k] += first;
      if (vertex != first + made)
        continue; /* another patch's */
      made++;
      lod_vec3_to_float(s->positions[s->corners[p][k]], d->positions[vertex]);
      lod_vec3_to_float(lod_evaluate_corner_normal(s, p, k), d->normals[vertex]);
      set_numbers(d, vertex, p, (const double[3]){k == 0, k == 1, k == 2});
      d->vertex_roots[vertex] = d->roots == NULL ? p : d->roots[p];
    }
  return mark_changed(d, first, count) ? LOD_OK : LOD_MEMORY;
}

static void forget_slots(struct slots *slots) {
  slots->next = 0;
  memset(slots->free_count, 0, sizeof slots->free_count);
}

static enum lod_status install(struct lod_dynamic *d) {
  forget_slots(&d->vertices);
  forget_slots(&d->indices);
  LOD_TRY(prepare(d));
  return make_corners(d);
}

static enum lod_status install_given(struct lod_dynamic *d) {
  lod_arena_destroy(d->surface_arena);
  d->surface_arena = lod_arena_create_child(d->arena);
  if (d->surface_arena == NULL)
    return LOD_MEMORY;
  d->surface = *d->given;
  d->roots = NULL;
  d->halved = false;
  return install(d);
}

/* ---- views ---- */

struct frame {
  struct lod_vec3 eye, forward;
  struct lod_vec3 normals[4]; /* of the planes through the eye, unit, inwards */
  double near, focal;         /* pixels at distance 1 */
  double tangent;             /* of the farthest corner of the window */
};

static void make_frame(const struct lod_dynamic_view *view, struct frame *frame) {
  double half = tan(view->fov_degrees * kPi / 360), wide = half * view->aspect;
  struct lod_vec3 right = lod_vec3_cross(view->forward, view->up);
  *frame = (struct frame){.eye = view->eye,
                          .forward = view->forward,
                          .near = view->near,
                          .focal = view->height_px / (2 * half),
                          .tangent = sqrt(half * half + wide * wide)};
  for (int i = 0; i < 4; i++) {
    double s = i % 2 == 0 ? 1 : -1;
    struct lod_vec3 n = i < 2 ? lod_vec3_add_scaled(lod_vec3_scale(view->forward, wide), right, s)
                              : lod_vec3_add_scaled(lod_vec3_scale(view->forward, half), view->up, s);
    frame->normals[i] = lod_vec3_normalize(n);
  }
}

/* Points p and q, delta apart, with depths of at least z: the pictures are at most focal * delta * sqrt(1 + tan^2) / z apart, tan of the
 * angle between the view's axis and one of them. */
static double tolerance_of(const struct frame *frame, const struct patch_state *state, double pixels) {
  struct lod_vec3 to = lod_vec3_subtract(state->centre, frame->eye);
  double depth = lod_vec3_dot(to, frame->forward), z = fmax(frame->near, depth - state->radius);
  double beside = sqrt(fmax(0, lod_vec3_length_squared(to) - depth * depth)) + state->radius;
  double tangent = fmin(frame->tangent, beside / z);
  return kMargin * pixels * z / (frame->focal * sqrt(1 + tangent * tangent));
}

enum { SEEN = 1, OUTSIDE = 2, BACK = 3 };

static uint8_t see(const struct frame *frame, const struct patch_state *state, const struct lod_dynamic_settings *settings) {
  struct lod_vec3 to = lod_vec3_subtract(state->centre, frame->eye);
  if (settings->cull_outside) {
    if (lod_vec3_dot(to, frame->forward) + state->radius < frame->near)
      return OUTSIDE;
    for (int i = 0; i < 4; i++)
      if (lod_vec3_dot(to, frame->normals[i]) < -state->radius)
        return OUTSIDE;
  }
  if (settings->cull_back && state->sine < 1) {
    /* All normals n of the cone and all points p of the ball: n . (p - eye) >= distance * cos(angle between + half angle) - radius. */
    double distance = lod_vec3_length(to), along = lod_vec3_dot(to, state->axis);
    double across = sqrt(fmax(0, distance * distance - along * along)), cosine = sqrt(1 - state->sine * state->sine);
    if (along > 0 && along * cosine - across * state->sine > state->radius * (1 + 1e-9))
      return BACK;
  }
  return SEEN;
}

static double parts_of(double bend, double tolerance) {
  return fmax(1, ceil(sqrt(bend / tolerance) * (1 - 1e-12)));
}

/* ---- halving where the tolerance asks for more than a grid has ---- */

/* The ring at the edges may need a grid somewhat finer than the bend alone. */
static bool needs_halving(double bend, double tolerance) {
  return parts_of(bend, tolerance) > 0.7 * LOD_TESSELLATE_MOST;
}

/* Whether a given patch that is seen would have to be halved. */
static bool view_is_deep(const struct lod_dynamic *d, const struct frame *frame, const struct lod_dynamic_settings *settings, double ease) {
  for (uint32_t p = 0; p < d->given->patch_count; p++) {
    const struct patch_state *state = &d->whole[p];
    if (needs_halving(state->bend / kEdgeShare, ease * tolerance_of(frame, state, settings->pixels)) && see(frame, state, settings) == SEEN)
      return true;
  }
  return false;
}

/* Marks edges of what is seen and needs more. */
static bool mark_deep(const struct lod_dynamic *d, const struct frame *frame, const struct lod_dynamic_settings *settings, bool *marks) {
  const struct lod_patches *s = &d->surface;
  bool any = false;
  memset(marks, 0, s->edge_count * sizeof *marks);
  for (uint32_t p = 0; p < s->patch_count; p++) {
    const struct patch_state *state = &d->patches[p];
    /* Twice as fine, so that a view that comes nearer does not ask for more at once. */
    double tolerance = 0.25 * tolerance_of(frame, state, settings->pixels);
    if (!needs_halving(state->bend / kEdgeShare, tolerance) || see(frame, state, settings) != SEEN)
      continue;
    for (uint32_t k = 0; k < 3; k++)
      marks[s->edges[p][k] >> 1] = any = true;
  }
  return any;
}

static enum lod_status halve(struct lod_dynamic *d, const struct frame *frame, const struct lod_dynamic_settings *settings) {
  LOD_TRY(install_given(d));
  for (int round = 0; round < ROUNDS && d->surface.patch_count < settings->most_patches; round++) {
    struct lod_arena *next = lod_arena_create_child(d->arena);
    bool *marks = next == NULL ? NULL : LOD_NEW(next, d->surface.edge_count, bool);
    struct lod_patches halved;
    uint32_t *roots;
    enum lod_status status = marks == NULL ? LOD_MEMORY : LOD_OK;
    if (status == LOD_OK && !mark_deep(d, frame, settings, marks)) {
      lod_arena_destroy(next);
      return LOD_OK;
    }
    if (status == LOD_OK)
      status = lod_patches_halve(&d->surface, marks, d->roots, next, &halved, &roots);
    if (status != LOD_OK) {
      lod_arena_destroy(next);
      return status == LOD_LIMIT ? LOD_OK : status;
    }
    lod_arena_destroy(d->surface_arena);
    d->surface_arena = next;
    d->surface = halved;
    d->roots = roots;
    d->halved = true;
    d->changed_count = 0;
    LOD_TRY(install(d));
  }
  return LOD_OK;
}

/* ---- making triangles ---- */

/* A point inside edge e for the patch on its side `user`: positions are there. */
static void finish_edge_point(struct lod_dynamic *d, uint32_t user, bool against, double t, uint32_t vertex) {
  double at[3] = {0, 0, 0};
  at[user % 3] = against ? t : 1 - t;
  at[(user % 3 + 1) % 3] = against ? 1 - t : t;
  set_numbers(d, vertex, user / 3, at);
  d->vertex_roots[vertex] = d->roots == NULL ? user / 3 : d->roots[user / 3];
}

static enum lod_status make_edge(struct lod_dynamic *d, uint32_t e, uint32_t factor, struct lod_dynamic_stats *stats) {
  struct edge_state *edge = &d->edges[e];
  const struct lod_patches *s = &d->surface;
  uint32_t count = factor - 1, sides = d->split[e] ? 2 : 1;
  float(*normals[2])[3] = {NULL, NULL};
  edge->factor = factor;
  edge->make++;
  for (uint32_t side = 0; side < sides; side++)
    if (!retake(d, &d->vertices, count, &edge->first[side], &edge->room[side]))
      return LOD_MEMORY;
  for (uint32_t side = 0; side < sides && count > 0; side++) {
    uint32_t first = edge->first[side], against = edge->users[side] == LOD_NONE ? 1 - side : side;
    lod_evaluate_edge(s, e, factor, d->positions + first);
    for (uint32_t i = 0; i < count; i++)
      finish_edge_point(d, edge->users[against], against, (i + 1.0) / factor, first + i);
    normals[side] = d->normals + first;
    if (!mark_changed(d, first, count))
      return LOD_MEMORY;
    stats->vertices_made += count;
  }
  if (count > 0) {
    normals[1] = sides == 1 ? normals[0] : normals[1];
    lod_evaluate_edge_normals(s, e, edge->users, factor, d->smoothness, normals);
    if (sides == 2 && !s->sharp[e])
      memcpy(normals[1], normals[0], count * sizeof *normals[0]);
  }
  stats->edges_made++;
  return LOD_OK;
}

/* Pool numbers of all vertices of the pattern that are not inside. */
static void gather_outer(const struct lod_dynamic *d, uint32_t p, const struct lod_tessellation_pattern *pattern, uint32_t *numbers) {
  for (uint32_t k = 0; k < 3; k++) {
    uint32_t side = d->surface.edges[p][k], e = side >> 1, against = side & 1, factor = d->edges[e].factor;
    uint32_t first = d->edges[e].first[d->split[e] ? against : 0], *out = numbers + pattern->edge_vertices[k];
    numbers[k] = d->corner_vertex[p][k];
    for (uint32_t i = 0; i + 1 < factor; i++)
      out[i] = first + (against ? factor - 2 - i : i);
  }
}

static enum lod_status make_patch(struct lod_dynamic *d, uint32_t p, struct lod_dynamic_stats *stats) {
  struct patch_state *state = &d->patches[p];
  struct lod_bezier net = lod_patches_net(&d->surface, p);
  uint32_t factors[3];
  for (uint32_t k = 0; k < 3; k++) {
    const struct edge_state *edge = &d->edges[d->surface.edges[p][k] >> 1];
    factors[k] = edge->factor;
    state->makes[k] = edge->make;
  }
  uint32_t before = state->inner_room == 0 ? 0 : state->grid;
  LOD_TRY(lod_pattern_choose(&d->cache, &net, factors, state->tolerance, &state->grid, &state->pattern, &state->deviation));
  const struct lod_tessellation_pattern *pattern = &d->cache.entries[state->pattern].pattern;
  uint32_t inside = pattern->vertex_count - pattern->inner_vertices;
  if (state->grid != before) {
    if (!retake(d, &d->vertices, inside, &state->inner, &state->inner_room) || !mark_changed(d, state->inner, inside))
      return LOD_MEMORY;
    lod_evaluate_inside(&d->surface, p, &net, pattern, &d->cache.grids[state->grid], d->smoothness, d->positions + state->inner,
                        d->normals + state->inner);
    for (uint32_t i = 0; i < inside; i++) {
      const struct lod_barycentric *at = &pattern->domain[pattern->inner_vertices + i];
      set_numbers(d, state->inner + i, p, (const double[3]){at->u, at->v, at->w});
      d->vertex_roots[state->inner + i] = d->roots == NULL ? p : d->roots[p];
    }
    stats->vertices_made += inside;
  }
  if (!retake(d, &d->indices, 3 * pattern->triangle_count, &state->first_index, &state->index_room))
    return LOD_MEMORY;
  state->index_count = 3 * pattern->triangle_count;
  uint32_t outer[3 * LOD_TESSELLATE_MOST], *out = d->index_pool + state->first_index;
  const uint32_t *in = pattern->triangles[0];
  gather_outer(d, p, pattern, outer);
  uint32_t grid = state->grid < 3 ? 0 : 3 * (state->grid - 3) * (state->grid - 3), inner = state->inner - pattern->inner_vertices;
  for (uint32_t i = 0; i < grid; i++)
    out[i] = in[i] + inner;
  for (uint32_t i = grid; i < state->index_count; i++)
    out[i] = in[i] < pattern->inner_vertices ? outer[in[i]] : in[i] + inner;
  stats->patches_made++;
  return LOD_OK;
}

/* An edge's own curve within the lesser of what its two patches may be off: one factor, whoever asks. */
static enum lod_status update_edge(struct lod_dynamic *d, uint32_t e, struct lod_dynamic_stats *stats) {
  struct edge_state *edge = &d->edges[e];
  double tolerance = INFINITY;
  bool seen = false;
  for (int i = 0; i < 2; i++)
    if (edge->users[i] != LOD_NONE) {
      tolerance = fmin(tolerance, d->patches[edge->users[i] / 3].tolerance);
      seen = seen || d->visible[edge->users[i] / 3] == SEEN;
    }
  if (!seen)
    return LOD_OK;
  uint32_t least = lod_pattern_step(edge->finer * parts_of(edge->bend, kEdgeShare * tolerance));
  if (edge->factor >= least && edge->factor <= 2 * least)
    return LOD_OK;
  return make_edge(d, e, least, stats);
}

static bool patch_is_good(const struct lod_dynamic *d, uint32_t p) {
  const struct patch_state *state = &d->patches[p];
  if (state->grid == 0)
    return false;
  for (uint32_t k = 0; k < 3; k++)
    if (state->makes[k] != d->edges[d->surface.edges[p][k] >> 1].make)
      return false;
  if (state->deviation > state->tolerance && state->grid < LOD_TESSELLATE_MOST)
    return false;
  return state->grid <= 3 || state->grid <= 2 * parts_of(state->bend, state->tolerance) + 2;
}

/* Edges and patches that are not good any more. *again: edges were made finer because a patch could not be met with any grid. */
static enum lod_status make_seen(struct lod_dynamic *d, struct lod_dynamic_stats *stats, bool *again) {
  *again = false;
  for (uint32_t e = 0; e < d->surface.edge_count; e++)
    LOD_TRY(update_edge(d, e, stats));
  for (uint32_t p = 0; p < d->surface.patch_count; p++) {
    struct patch_state *state = &d->patches[p];
    if (d->visible[p] != SEEN || patch_is_good(d, p))
      continue;
    LOD_TRY(make_patch(d, p, stats));
    for (uint32_t k = 0; k < 3 && state->deviation > state->tolerance; k++) {
      struct edge_state *edge = &d->edges[d->surface.edges[p][k] >> 1];
      if (edge->factor < LOD_TESSELLATE_MOST) {
        edge->finer *= 2;
        *again = true;
      }
    }
  }
  return LOD_OK;
}

/* Indices of what is seen, material after material. */
static enum lod_status gather_drawn(struct lod_dynamic *d) {
  d->drawn_count = d->group_count = 0;
  for (uint32_t i = 0; i < d->surface.patch_count; i++) {
    uint32_t p = d->order[i], material = material_of(d, p), count = d->patches[p].index_count;
    if (d->visible[p] != SEEN)
      continue;
    if (d->group_count == 0 || d->groups[d->group_count - 1].material != material) {
      if (!grow(d->arena, (void **)&d->groups, &d->group_room, d->group_count + 1, sizeof *d->groups))
        return LOD_MEMORY;
      d->groups[d->group_count++] = (struct lod_dynamic_group){.material = material, .first = d->drawn_count};
    }
    memcpy(d->drawn + d->drawn_count, d->index_pool + d->patches[p].first_index, count * sizeof *d->drawn);
    d->groups[d->group_count - 1].count += count;
    d->drawn_count += count;
  }
  return LOD_OK;
}

static enum lod_status make_triangles(struct lod_dynamic *d, struct lod_dynamic_stats *stats) {
  enum { PASSES = 7 };
  bool again = true;
  for (int pass = 0; pass < PASSES && again; pass++)
    LOD_TRY(make_seen(d, stats, &again));
  uint64_t count = 0;
  for (uint32_t p = 0; p < d->surface.patch_count; p++)
    count += d->visible[p] == SEEN ? d->patches[p].index_count : 0;
  if (count >= UINT32_MAX / 2 || !grow(d->arena, (void **)&d->drawn, &d->drawn_room, (uint32_t)count, sizeof *d->drawn))
    return LOD_MEMORY;
  return gather_drawn(d);
}

static int by_first(const void *a, const void *b) {
  const uint32_t *x = a, *y = b;
  return x[0] < y[0] ? -1 : x[0] > y[0];
}

/* Ranges that touch, or nearly, become one. */
static void join_changes(struct lod_dynamic *d) {
  enum { NEAR = 64 };
  uint32_t kept = 0;
  if (d->changed_count > 1)
    qsort(d->changed, d->changed_count, sizeof *d->changed, by_first);
  for (uint32_t i = 0; i < d->changed_count; i++) {
    uint32_t *last = kept == 0 ? NULL : d->changed[kept - 1], end = d->changed[i][0] + d->changed[i][1];
    if (last != NULL && d->changed[i][0] <= last[0] + last[1] + NEAR) {
      if (end > last[0] + last[1])
        last[1] = end - last[0];
    } else {
      memmove(d->changed[kept++], d->changed[i], sizeof *d->changed);
    }
  }
  d->changed_count = kept;
}

static void look(struct lod_dynamic *d, const struct frame *frame, const struct lod_dynamic_settings *settings,
                 struct lod_dynamic_stats *stats) {
  for (uint32_t p = 0; p < d->surface.patch_count; p++) {
    struct patch_state *state = &d->patches[p];
    state->tolerance = tolerance_of(frame, state, settings->pixels);
    d->visible[p] = see(frame, state, settings);
    stats->visible += d->visible[p] == SEEN;
    stats->outside += d->visible[p] == OUTSIDE;
    stats->back += d->visible[p] == BACK;
  }
  stats->patches = d->surface.patch_count;
}

enum lod_status lod_dynamic_update(struct lod_dynamic *d, const struct lod_dynamic_view *view, const struct lod_dynamic_settings *settings,
                                   struct lod_dynamic_stats *stats) {
  struct frame frame;
  make_frame(view, &frame);
  *stats = (struct lod_dynamic_stats){0};
  if (d->told)
    d->changed_count = 0;
  d->told = true;
  if (d->smoothness != settings->smoothness) {
    d->smoothness = settings->smoothness;
    LOD_TRY(install_given(d));
  }
  if (d->halved && !view_is_deep(d, &frame, settings, 0.6))
    LOD_TRY(install_given(d));
  look(d, &frame, settings, stats);
  bool deep = false;
  for (uint32_t p = 0; p < d->surface.patch_count && !deep && d->surface.patch_count < settings->most_patches; p++)
    deep = d->visible[p] == SEEN && needs_halving(d->patches[p].bend / kEdgeShare, d->patches[p].tolerance);
  if (deep) {
    LOD_TRY(halve(d, &frame, settings));
    *stats = (struct lod_dynamic_stats){.halved = true};
    look(d, &frame, settings, stats);
  }
  LOD_TRY(make_triangles(d, stats));
  join_changes(d);
  stats->triangles = d->drawn_count / 3;
  for (uint32_t p = 0; p < d->surface.patch_count; p++)
    if (d->visible[p] == SEEN)
      stats->pixels = fmax(stats->pixels, d->patches[p].deviation / d->patches[p].tolerance * settings->pixels);
  return LOD_OK;
}

/* ---- the rest ---- */

enum lod_status lod_dynamic_create(const struct lod_patches *patches, struct lod_arena *arena, struct lod_dynamic **dynamic) {
  *dynamic = NULL;
  struct lod_arena *own = lod_arena_create_child(arena);
  struct lod_dynamic *d = own == NULL ? NULL : LOD_NEW_ZERO(own, 1, struct lod_dynamic);
  enum lod_status status = LOD_MEMORY;
  if (d != NULL) {
    d->arena = own;
    d->given = patches;
    d->width = patches->attributes.corners == NULL ? 0 : patches->attributes.width;
    d->shows_front_only = LOD_NEW_ZERO(own, patches->patch_count, bool);
    d->whole = LOD_NEW_ZERO(own, patches->patch_count, struct patch_state);
    if (d->shows_front_only != NULL && d->whole != NULL)
      status = lod_pattern_cache_init(&d->cache, own);
  }
  if (status == LOD_OK)
    status = find_closed(d, own);
  if (status == LOD_OK)
    status = install_given(d);
  if (status != LOD_OK) {
    lod_arena_destroy(d == NULL ? NULL : d->surface_arena);
    lod_arena_destroy(own);
    return status;
  }
  memcpy(d->whole, d->patches, patches->patch_count * sizeof *d->whole);
  *dynamic = d;
  return LOD_OK;
}

void lod_dynamic_destroy(struct lod_dynamic *d) {
  if (d == NULL)
    return;
  lod_arena_destroy(d->surface_arena);
  lod_arena_destroy(d->arena);
}

void lod_dynamic_mesh(const struct lod_dynamic *d, struct lod_dynamic_mesh *mesh) {
  *mesh = (struct lod_dynamic_mesh){.vertex_room = d->vertices.next,
                                    .positions = (const float(*)[3])d->positions,
                                    .normals = (const float(*)[3])d->normals,
                                    .numbers = d->width == 0 ? NULL : d->numbers,
                                    .width = d->width,
                                    .groups = d->groups,
                                    .group_count = d->group_count,
                                    .roots = d->vertex_roots,
                                    .indices = d->drawn,
                                    .index_count = d->drawn_count,
                                    .changed = (const uint32_t(*)[2])d->changed,
                                    .changed_count = d->changed_count};
}

const struct lod_patches *lod_dynamic_surface(const struct lod_dynamic *d, const uint8_t **visible, const uint32_t **roots) {
  if (visible != NULL)
    *visible = d->visible;
  if (roots != NULL)
    *roots = d->roots;
  return &d->surface;
}

void lod_dynamic_triangle_patches(const struct lod_dynamic *d, uint32_t *triangle_patches) {
  for (uint32_t i = 0; i < d->surface.patch_count; i++)
    for (uint32_t t = 0; d->visible[d->order[i]] == SEEN && t < d->patches[d->order[i]].index_count / 3; t++)
      *triangle_patches++ = d->order[i];
}

uint32_t lod_dynamic_domain(const struct lod_dynamic *d, uint32_t patch, const uint32_t (**triangles)[3],
                            const struct lod_barycentric **domain) {
  if (d->visible[patch] != SEEN)
    return 0;
  const struct lod_tessellation_pattern *pattern = &d->cache.entries[d->patches[patch].pattern].pattern;
  *triangles = (const uint32_t(*)[3])pattern->triangles;
  *domain = pattern->domain;
  return pattern->triangle_count;
}
