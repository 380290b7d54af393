/* Where a point touches the limit surface, by refining around the closest triangle. */
#include <math.h>

#include "core/mesh/bvh.h"
#include "core/refine/doi.h"
#include "core/refine/internal.h"

enum { MAX_RING = 512 }; /* faces around a triangle; of a vertex with more only as many are refined */

struct ring {
  uint32_t faces[MAX_RING];
  uint32_t count;
};

static void add(struct ring *ring, uint32_t f) {
  if (f == LOD_NONE || ring->count == MAX_RING)
    return;
  for (uint32_t i = 0; i < ring->count; i++)
    if (ring->faces[i] == f)
      return;
  ring->faces[ring->count++] = f;
}

/* Faces of level k at vertex v that are beside edge e, a spoke of v at its birth. */
static void add_beside(struct lod_refiner *r, struct ring *ring, uint32_t e, uint32_t v, uint32_t k) {
  while (r->edges[e].level < k) {
    if (!refine_split_edge(r, e))
      return;
    e = r->edges[e].child + (r->edges[e].v[0] == v ? 0 : 1);
  }
  for (int s = 0; s < 2; s++)
    add(ring, refine_side(r, e, s));
}

static void add_around(struct lod_refiner *r, struct ring *ring, uint32_t v, uint32_t k) {
  const struct vertex vertex = r->vertices[v];
  if (vertex.level == 0) {
    for (uint32_t i = r->base.spoke_begin[vertex.origin]; i < r->base.spoke_begin[vertex.origin + 1]; i++)
      add_beside(r, ring, r->base.spokes[i], v, k);
    return;
  }
  uint32_t e = vertex.origin, s = e;
  do {
    if (!refine_split_edge(r, s))
      return;
    for (uint32_t half = 0; half < 2; half++)
      add_beside(r, ring, r->edges[s].child + half, v, k);
    for (int side = 0; side < 2; side++) { /* the inner edges that meet in the middle: sides of the middle child */
      uint32_t f = refine_side(r, s, side);
      if (f == LOD_NONE || !refine_make_children(r, f))
        continue;
      const struct face middle = r->faces[r->faces[f].child + 3];
      for (int i = 0; i < 3; i++)
        if (r->edges[middle.e[i]].v[0] == v || r->edges[middle.e[i]].v[1] == v)
          add_beside(r, ring, middle.e[i], v, k);
    }
    s = refine_sibling(r, s);
  } while (s != e);
}

static double distance2(struct lod_refiner *r, uint32_t f, struct lod_vec3 q, struct lod_vec3 *point) {
  struct lod_vec3 p[3];
  for (int i = 0; i < 3; i++)
    p[i] = refine_limit_vec(r, r->faces[f].v[i]);
  *point = lod_closest_on_triangle(q, p[0], p[1], p[2]);
  return lod_vec3_distance_squared(q, *point);
}

struct nearest {
  double distance2;
  struct lod_vec3 point;
  uint32_t face;
  uint64_t key;
  uint32_t tested;
};

static void try_face(struct lod_refiner *r, uint32_t f, struct lod_vec3 q, struct nearest *best) {
  struct lod_vec3 point;
  double d = distance2(r, f, q, &point);
  uint64_t key = refine_key(r, f);
  best->tested++;
  if (d < best->distance2 || (d == best->distance2 && key < best->key)) {
    best->distance2 = d;
    best->point = point;
    best->face = f;
    best->key = key;
  }
}

static bool over(const struct lod_refiner *r, const struct lod_refine_limits *l) {
  if (l == NULL)
    return false;
  double bytes = l->bytes_per_vertex * r->drawn_vertices + l->bytes_per_triangle * r->drawn_triangles;
  return (l->max_triangles != 0 && r->drawn_triangles > l->max_triangles) || (l->max_bytes != 0 && bytes > (double)l->max_bytes);
}

/* Splits the ring; LOD_LIMIT, with the split that went over taken back, when the budget ends. */
static enum lod_status split_ring(struct lod_refiner *r, const struct ring *ring, const struct lod_refine_limits *limits) {
  for (uint32_t i = 0; i < ring->count; i++) {
    uint32_t f = ring->faces[i], chain[LOD_REFINE_MAX_LEVEL + 1], length = 0;
    for (uint32_t g = f; g != LOD_NONE && !r->faces[g].split; g = r->lineages[g].up)
      chain[length++] = g; /* f itself, then what has to be split for it to be drawn */
    while (length-- > 0) {
      if (r->faces[chain[length]].split)
        continue;
      if (!lod_refiner_split(r, chain[length]))
        return LOD_MEMORY;
      if (over(r, limits)) {
        refine_undo(r);
        return LOD_LIMIT;
      }
    }
  }
  return LOD_OK;
}

static void finish(struct lod_refiner *r, const struct nearest *best, struct lod_contact *contact) {
  struct lod_vec3 p[3], n[3], sum = {0, 0, 0};
  uint32_t f = best->face;
  for (int i = 0; i < 3; i++) {
    float normal[3];
    p[i] = refine_limit_vec(r, r->faces[f].v[i]);
    refine_normal(r, r->faces[f].v[i], r->lineages[f].base, normal);
    n[i] = lod_vec3_from_float(normal);
  }
  struct lod_vec3 flat = lod_vec3_cross(lod_vec3_subtract(p[1], p[0]), lod_vec3_subtract(p[2], p[0]));
  for (int i = 0; i < 3; i++) { /* weights by areas of the opposite triangles */
    struct lod_vec3 a = lod_vec3_subtract(p[(i + 1) % 3], best->point), b = lod_vec3_subtract(p[(i + 2) % 3], best->point);
    sum = lod_vec3_add_scaled(sum, n[i], lod_vec3_dot(lod_vec3_cross(a, b), flat));
  }
  if (!(lod_vec3_length_squared(sum) > 0))
    sum = flat;
  sum = lod_vec3_normalize(sum);
  *contact = (struct lod_contact){.point = {best->point.x, best->point.y, best->point.z},
                                  .normal = {sum.x, sum.y, sum.z},
                                  .distance = sqrt(best->distance2),
                                  .face = f,
                                  .base = r->lineages[f].base,
                                  .tested = best->tested};
}

enum lod_status refine_contact_within(struct lod_refiner *r, const double point[3], uint32_t steps, const struct lod_refine_limits *limits,
                                      struct lod_contact *contact) {
  struct lod_vec3 q = {point[0], point[1], point[2]};
  struct nearest best = {.distance2 = INFINITY, .face = 0};
  enum lod_status status = LOD_OK;
  for (uint32_t f = 0; f < r->base_faces && !r->failed; f++)
    try_face(r, f, q, &best);
  for (uint32_t k = 0; k < steps && status == LOD_OK && !r->failed; k++) {
    struct ring ring = {.count = 0};
    add(&ring, best.face);
    for (int i = 0; i < 3; i++)
      add_around(r, &ring, r->faces[best.face].v[i], k);
    status = split_ring(r, &ring, limits);
    best.distance2 = INFINITY; /* the finer triangles say it better, even when they are farther */
    uint32_t before = best.face;
    for (uint32_t i = 0; i < ring.count && status == LOD_OK && !r->failed; i++)
      for (uint32_t c = 0; c < 4; c++)
        try_face(r, r->faces[ring.faces[i]].child + c, q, &best);
    if (best.distance2 == INFINITY) { /* the budget ended before */
      best.face = before;
      best.distance2 = distance2(r, before, q, &best.point);
    }
  }
  if (r->failed)
    return LOD_MEMORY;
  finish(r, &best, contact);
  return status;
}

enum lod_status lod_refine_contact(struct lod_refiner *r, const double point[3], uint32_t steps, struct lod_contact *contact,
                                   struct lod_problem *problem) {
  *contact = (struct lod_contact){.face = LOD_NONE, .base = LOD_NONE};
  if (r->failed)
    return lod_fail_memory(problem);
  if (r->base_faces == 0)
    return lod_fail(problem, LOD_BAD_INPUT, "no-triangles", "There is no surface to touch: the base has no triangle.");
  enum lod_status status = refine_contact_within(r, point, steps < LOD_REFINE_MAX_LEVEL ? steps : LOD_REFINE_MAX_LEVEL, NULL, contact);
  return status == LOD_OK ? LOD_OK : lod_fail_memory(problem);
}
