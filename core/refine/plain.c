#include "core/refine/plain.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/refine/stepwise.h"

struct flag {
  double value;
  uint32_t triangle;
};

static int compare_flags(const void *left, const void *right) {
  const struct flag *a = left, *b = right;
  if (a->value != b->value)
    return a->value > b->value ? -1 : 1;
  return a->triangle < b->triangle ? -1 : a->triangle > b->triangle;
}

/* ---- the plain rule ---- */

/* Splits the edges of the first `count` wanted triangles; returns how many triangles come out. */
static uint64_t mark_edges(const struct stepwise *s, const struct flag *flags, uint32_t count) {
  const struct refine_base *b = s->base;
  memset(s->split_edge, 0, b->edge_count * sizeof *s->split_edge);
  for (uint32_t i = 0; i < count; i++)
    for (uint32_t k = 0; k < 3; k++) {
      uint32_t e = b->edge_of[3 * flags[i].triangle + k], at = e;
      do
        s->split_edge[at] = true;
      while ((at = b->edge_sibling[at]) != e);
    }
  uint64_t triangles = 0;
  for (uint32_t t = 0; t < b->mesh.triangle_count; t++) {
    if (b->edge_of[3 * t] == LOD_NONE)
      continue;
    triangles++;
    for (uint32_t k = 0; k < 3; k++)
      triangles += s->split_edge[b->edge_of[3 * t + k]];
  }
  return triangles;
}

/* Which triangles are subdivided: those wanted, and those with three split edges (Fig. 1 c). */
static void mark_triangles(const struct stepwise *s) {
  const struct refine_base *b = s->base;
  for (uint32_t t = 0; t < b->mesh.triangle_count; t++) {
    s->chosen[t] = b->edge_of[3 * t] != LOD_NONE;
    for (uint32_t k = 0; k < 3 && s->chosen[t]; k++)
      s->chosen[t] = s->split_edge[b->edge_of[3 * t + k]];
  }
}

static bool place_plain(struct stepwise *s) {
  const struct refine_base *b = s->base;
  for (uint32_t t = 0; t < b->mesh.triangle_count; t++)
    for (uint32_t k = 0; k < 3 && s->chosen[t]; k++) {
      uint32_t v = b->mesh.triangles[t][k];
      stepwise_move(s, v, stepwise_loop_position(s, v));
    }
  for (uint32_t e = 0; e < b->edge_count; e++) {
    if (!s->split_edge[e] || s->middle[e] != LOD_NONE)
      continue;
    uint32_t m = stepwise_add_vertex(s, stepwise_loop_middle(s, e)), at = e;
    do
      s->middle[at] = m;
    while ((at = b->edge_sibling[at]) != e);
  }
  return !s->failed;
}

static bool connect_plain(struct stepwise *s) {
  const struct refine_base *b = s->base;
  for (uint32_t t = 0; t < b->mesh.triangle_count; t++) {
    struct stepwise_corner c[3], m[3];
    uint32_t count = 0, first = 0, idle = 0;
    if (b->edge_of[3 * t] == LOD_NONE)
      continue;
    for (uint32_t k = 0; k < 3; k++)
      c[k] = stepwise_old_corner(s, 3 * t + k);
    for (uint32_t k = 0; k < 3; k++) {
      bool split = s->split_edge[b->edge_of[3 * t + k]];
      count += split;
      first = split ? k : first;
      idle = split ? idle : k;
      if (split)
        m[k] = stepwise_middle_corner(s, 3 * t + k);
    }
    if (count == 0) {
      stepwise_put(s, t, c[0], c[1], c[2]);
    } else if (count == 1) {
      stepwise_put(s, t, c[first], m[first], c[(first + 2) % 3]);
      stepwise_put(s, t, m[first], c[(first + 1) % 3], c[(first + 2) % 3]);
    } else if (count == 2) {
      uint32_t i = (idle + 1) % 3, j = (idle + 2) % 3;
      stepwise_put(s, t, m[i], c[j], m[j]);
      stepwise_put(s, t, c[i], m[i], m[j]);
      stepwise_put(s, t, c[i], m[j], c[(j + 1) % 3]);
    } else {
      stepwise_put(s, t, c[0], m[0], m[2]);
      stepwise_put(s, t, m[0], c[1], m[1]);
      stepwise_put(s, t, m[2], m[1], c[2]);
      stepwise_put(s, t, m[1], m[2], m[0]);
    }
  }
  return !s->failed;
}

/* ---- sqrt(3) ---- */

/* The half-edge behind which triangle t waits, or LOD_NONE. */
static uint32_t waiting(const struct stepwise *s, uint32_t t) {
  return s->pending == NULL || s->pending[t] == 0 ? LOD_NONE : 3 * t + s->pending[t] - 1u;
}

/* Marks what has to be split in three for the first `count` wanted; returns how many triangles come out. */
static uint64_t mark_thirds(const struct stepwise *s, const struct flag *flags, uint32_t count) {
  enum { CHAIN = 32 };
  const struct refine_base *b = s->base;
  uint64_t triangles = b->triangles;
  memset(s->chosen, 0, b->mesh.triangle_count * sizeof *s->chosen);
  for (uint32_t i = 0; i < count; i++) {
    uint32_t t = flags[i].triangle, h;
    for (int hops = 0; hops < CHAIN && (h = waiting(s, t)) != LOD_NONE; hops++) {
      uint32_t twin = b->adjacency.twin[h];
      if (twin == LOD_NONE || b->edge_split[b->edge_of[h]]) /* will never be turned: split as it is */
        break;
      t = twin / 3;
      if (waiting(s, t) == twin) /* both wait for each other: cannot be, they would have been turned */
        break;
    }
    triangles += s->chosen[t] ? 0 : 2;
    s->chosen[t] = true;
  }
  return triangles;
}

static bool place_thirds(struct stepwise *s) {
  const struct refine_base *b = s->base;
  for (uint32_t v = 0; v < b->mesh.vertex_count; v++) {
    uint32_t begin = b->adjacency.vertex_begin[v], end = b->adjacency.vertex_begin[v + 1];
    bool all = b->rule[v] == REFINE_SMOOTH && !b->dart[v] && end > begin;
    for (uint32_t i = begin; i < end && all; i++)
      all = s->chosen[b->adjacency.vertex_corners[i] / 3];
    if (all)
      stepwise_move(s, v, stepwise_sqrt3_position(s, v));
  }
  for (uint32_t t = 0; t < b->mesh.triangle_count; t++) {
    if (!s->chosen[t])
      continue;
    struct lod_vec3 sum = {0, 0, 0};
    for (int k = 0; k < 3; k++)
      sum = lod_vec3_add(sum, stepwise_point(s, b->mesh.triangles[t][k]));
    s->centre[t] = stepwise_add_vertex(s, refine_snap(b->grid, lod_vec3_scale(sum, 1.0 / 3)));
  }
  return !s->failed;
}

/* What stands opposite half-edge h if its triangle offers it for turning. */
static bool apex(struct stepwise *s, uint32_t h, struct stepwise_corner *corner) {
  uint32_t t = h / 3;
  if (s->chosen[t]) {
    *corner = stepwise_centre_corner(s, t);
    return true;
  }
  if (waiting(s, t) != h)
    return false;
  *corner = stepwise_old_corner(s, 3 * t + (h % 3 + 2) % 3);
  return true;
}

static bool connect_thirds(struct stepwise *s) {
  const struct refine_base *b = s->base;
  for (uint32_t t = 0; t < b->mesh.triangle_count; t++) {
    if (b->edge_of[3 * t] == LOD_NONE)
      continue;
    bool turned = false;
    for (uint32_t k = 0; k < 3; k++) {
      uint32_t h = 3 * t + k, twin = b->adjacency.twin[h];
      struct stepwise_corner a, c, v0 = stepwise_old_corner(s, h), v1 = stepwise_old_corner(s, 3 * t + (k + 1) % 3);
      if (!apex(s, h, &a))
        continue;
      if (twin != LOD_NONE && !b->edge_split[b->edge_of[h]] && apex(s, twin, &c)) {
        turned |= !s->chosen[t];
        if (h < twin) {
          stepwise_put(s, t, v0, c, a);
          stepwise_put(s, t, v1, a, c);
        }
      } else if (s->chosen[t]) {
        stepwise_put(s, t, v0, v1, a);
        stepwise_pend(s, 1);
      }
    }
    if (!s->chosen[t] && !turned) {
      stepwise_put(s, t, stepwise_old_corner(s, 3 * t), stepwise_old_corner(s, 3 * t + 1), stepwise_old_corner(s, 3 * t + 2));
      stepwise_pend(s, s->pending == NULL ? 0 : s->pending[t]);
    }
  }
  return !s->failed;
}

/* ---- steps ---- */

static bool fits(const struct lod_refine_limits *l, uint64_t triangles) {
  double bytes = (l->bytes_per_vertex / 2 + l->bytes_per_triangle) * (double)triangles; /* a vertex for two triangles, about */
  return (l->max_triangles == 0 || triangles <= l->max_triangles) && (l->max_bytes == 0 || bytes <= (double)l->max_bytes) &&
         triangles < UINT32_C(1) << 28;
}

static uint64_t mark(const struct stepwise *s, enum lod_stepwise scheme, const struct flag *flags, uint32_t count) {
  return scheme == LOD_STEPWISE_PLAIN ? mark_edges(s, flags, count) : mark_thirds(s, flags, count);
}

/* As many of the most wanted as fit. */
static uint32_t choose(struct stepwise *s, enum lod_stepwise scheme, struct flag *flags, uint32_t count,
                       const struct lod_refine_limits *limits, bool *budget) {
  qsort(flags, count, sizeof *flags, compare_flags);
  if (fits(limits, mark(s, scheme, flags, count)))
    return count;
  *budget = true;
  uint32_t low = 0, high = count; /* low fits, high does not */
  while (high - low > 1) {
    uint32_t middle = low + (high - low) / 2;
    if (fits(limits, mark(s, scheme, flags, middle)))
      low = middle;
    else
      high = middle;
  }
  if (low != 0)
    (void)mark(s, scheme, flags, low);
  return low;
}

/* One step over `from`; *count says how many triangles were wanted and could be had. */
static enum lod_status step(const struct lod_mesh *from, const uint8_t *pending, const struct lod_refine_settings *settings,
                            enum lod_stepwise scheme, const struct lod_doi *doi, const struct lod_refine_limits *limits, uint32_t number,
                            struct lod_arena *arena, struct lod_mesh *mesh, uint8_t **pends, uint32_t *count, bool *budget,
                            struct lod_problem *problem) {
  struct lod_refiner *r;
  LOD_TRY(lod_refiner_create(from, settings, arena, &r, problem));
  struct flag *flags = LOD_NEW(r->arena, from->triangle_count, struct flag);
  r->level_bias = number;
  *count = 0;
  for (uint32_t f = 0; f < r->base_faces && flags != NULL; f++) {
    double value = lod_doi_value(r, doi, limits, f);
    if (value > 1)
      flags[(*count)++] = (struct flag){value, r->lineages[f].base};
  }
  struct stepwise s;
  enum lod_status status = flags == NULL || r->failed || !stepwise_init(&s, &r->base, pending, arena, r->arena, mesh) ? LOD_MEMORY : LOD_OK;
  if (status == LOD_OK && (*count = choose(&s, scheme, flags, *count, limits, budget)) != 0) {
    bool made;
    if (scheme == LOD_STEPWISE_PLAIN) {
      mark_triangles(&s);
      made = place_plain(&s) && connect_plain(&s);
    } else {
      made = place_thirds(&s) && connect_thirds(&s);
    }
    status = made && stepwise_finish(&s, pends) ? LOD_OK : LOD_MEMORY;
  }
  lod_refiner_destroy(r);
  return status == LOD_OK ? LOD_OK : lod_fail_memory(problem);
}

/* The mesh as it stands, with limit normals and wedges. */
static enum lod_status dress(const struct lod_mesh *from, const struct lod_refine_settings *settings, struct lod_arena *arena,
                             struct lod_mesh *mesh, struct lod_problem *problem) {
  struct lod_refiner *r;
  struct lod_refine_output output;
  LOD_TRY(lod_refiner_create(from, settings, arena, &r, problem));
  enum lod_status status = lod_refiner_mesh(r, arena, &output);
  lod_refiner_destroy(r);
  *mesh = output.mesh;
  return status == LOD_OK ? LOD_OK : lod_fail_memory(problem);
}

enum lod_status lod_refine_stepwise(const struct lod_mesh *base, const struct lod_refine_settings *asked, enum lod_stepwise scheme,
                                    const struct lod_doi *doi, const struct lod_refine_limits *limits, const struct lod_progress *progress,
                                    struct lod_arena *arena, struct lod_mesh *mesh, bool *budget, struct lod_problem *problem) {
  struct lod_refine_settings settings = asked == NULL ? lod_refine_defaults() : *asked;
  struct lod_arena *arenas[2] = {NULL, NULL}; /* of the mesh before and the one after */
  struct lod_mesh now = *base, next;
  uint8_t *pending = NULL;
  bool unwanted;
  budget = budget == NULL ? &unwanted : budget;
  *budget = false;
  settings.positions = LOD_REFINE_LEVEL;
  for (uint32_t i = 0; i < doi->term_count; i++)
    if (doi->terms[i].kind == LOD_DOI_CONTACT || doi->terms[i].kind == LOD_DOI_ATTRIBUTE)
      return lod_fail(problem, LOD_UNSUPPORTED, "stepwise-interest", "Touch and attributes refine by the exact scheme alone.");
  enum lod_status status = LOD_OK;
  for (uint32_t k = 0; k < limits->steps && status == LOD_OK; k++) {
    uint32_t count = 0;
    uint8_t *pends = NULL;
    if (lod_progress_cancelled(progress)) {
      status = lod_fail(problem, LOD_CANCELLED, "cancelled", "The refinement was cancelled.");
      break;
    }
    lod_arena_destroy(arenas[0]);
    arenas[0] = arenas[1];
    arenas[1] = lod_arena_create_child(arena);
    status = arenas[1] == NULL ? lod_fail_memory(problem)
                               : step(&now, pending, &settings, scheme, doi, limits, k, arenas[1], &next, &pends, &count, budget, problem);
    if (status != LOD_OK || count == 0)
      break;
    now = next;
    pending = pends;
  }
  if (status == LOD_OK)
    status = dress(&now, &settings, arena, mesh, problem);
  lod_arena_destroy(arenas[0]);
  lod_arena_destroy(arenas[1]);
  return status;
}
