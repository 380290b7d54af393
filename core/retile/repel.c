/* Points push one another away over the triangles (Turk 1992, 3.2; Turk 1991): a force that falls linearly to zero at a radius, and a walk
 * that unfolds its way across each edge. Every step moves all points at once, so that the order of points and threads does not matter. */
#include <math.h>
#include <string.h>

#include "core/retile/internal.h"

/* Integer weights of a place strictly inside a face. */
static void snap(double b[3], struct lod_retile_point *at) {
  uint32_t sum = 0, largest = 0;
  for (uint32_t k = 0; k < 3; k++) {
    double w = b[k] * LOD_RETILE_ONE;
    at->weights[k] = w < 1 ? 1 : w > LOD_RETILE_ONE - 2 ? LOD_RETILE_ONE - 2 : (uint32_t)w;
    sum += at->weights[k];
    largest = at->weights[k] > at->weights[largest] ? k : largest;
  }
  at->weights[largest] += LOD_RETILE_ONE - sum;
}

void repel_walk(const struct sheet *sheet, struct cloud_point *point, struct lod_vec3 d) {
  enum { MOST_FACES = 200, NOT_BLOCKED = 3 };
  uint32_t f = point->at.face, blocked = NOT_BLOCKED;
  double b[3];
  for (int k = 0; k < 3; k++)
    b[k] = point->at.weights[k] * (1.0 / LOD_RETILE_ONE);
  for (int step = 0; step < MOST_FACES; step++) {
    struct lod_vec3 p[3], n = sheet->normals[f];
    for (int k = 0; k < 3; k++)
      p[k] = sheet->positions[sheet->faces[f][k]];
    d = lod_vec3_add_scaled(d, n, -lod_vec3_dot(n, d));
    double change[3], t = 1;
    uint32_t out = NOT_BLOCKED;
    for (uint32_t k = 0; k < 3; k++) {
      struct lod_vec3 edge = lod_vec3_subtract(p[(k + 2) % 3], p[(k + 1) % 3]);
      change[k] = k == blocked ? 0 : lod_vec3_dot(lod_vec3_cross(n, edge), d) / (2 * sheet->areas[f]);
      if (change[k] < 0 && b[k] + t * change[k] < 0) {
        t = b[k] / -change[k];
        out = k;
      }
    }
    for (int k = 0; k < 3; k++)
      b[k] = fmax(0, b[k] + t * change[k]);
    if (out == NOT_BLOCKED)
      break;
    b[out] = 0;
    d = lod_vec3_scale(d, 1 - t);
    uint32_t h = 3 * f + (out + 1) % 3, twin = sheet->twin[h];
    struct lod_vec3 along = lod_vec3_normalize(lod_vec3_subtract(p[(out + 2) % 3], p[(out + 1) % 3]));
    if (twin == LOD_NONE || sheet->marks[h] != 0 || !(sheet->areas[twin / 3] > 0)) {
      if (blocked != NOT_BLOCKED)
        break; /* in a corner */
      d = lod_vec3_scale(along, lod_vec3_dot(along, d));
      blocked = out;
      continue;
    }
    double side = lod_vec3_dot(d, lod_vec3_cross(n, along)), forward = lod_vec3_dot(d, along);
    double first = b[(out + 1) % 3], second = b[(out + 2) % 3];
    f = twin / 3;
    b[twin % 3] = second;
    b[(twin + 1) % 3] = first;
    b[(twin + 2) % 3] = 0;
    d = lod_vec3_add_scaled(lod_vec3_scale(along, forward), lod_vec3_cross(sheet->normals[f], along), side);
    blocked = NOT_BLOCKED;
  }
  double sum = b[0] + b[1] + b[2];
  for (int k = 0; k < 3; k++)
    b[k] /= sum;
  struct lod_retile_point at = {.face = f};
  snap(b, &at);
  cloud_place(sheet, &at, point);
}

struct repulsion {
  const struct sheet *sheet;
  struct cloud_point *points;
  struct lod_vec3 *moves;
  struct cloud_grid grid;
  uint32_t fixed;
  double radius, damping, bend; /* bend: as cloud_distance_squared */
  double widest;                /* of the points' spacings */
};

static void push_chunk(void *context, size_t begin, size_t end, size_t chunk) {
  struct repulsion *r = context;
  (void)chunk;
  for (size_t i = begin; i < end; i++) {
    const struct cloud_point *a = &r->points[r->fixed + i];
    struct lod_vec3 sum = {0, 0, 0};
    uint32_t buckets[27];
    int count = cloud_grid_buckets(&r->grid, a->position, buckets);
    float from[3], far = cloud_far_from(&r->grid, a->position, r->radius * 0.5 * (a->spacing + r->widest), from);
    for (int b = 0; b < count; b++)
      for (uint32_t m = r->grid.begin[buckets[b]]; m < r->grid.begin[buckets[b] + 1]; m++) {
        if (cloud_is_far(&r->grid.members[m], from, far))
          continue;
        const struct cloud_point *other = &r->points[r->grid.members[m].point];
        struct lod_vec3 away = lod_vec3_subtract(a->position, other->position);
        double d2 = cloud_distance_squared(a, other, r->bend), reach = r->radius * 0.5 * (a->spacing + other->spacing);
        if (other == a || d2 >= reach * reach || !(d2 > 0) || !cloud_neighbours(a, other, lod_vec3_length_squared(away)))
          continue;
        double d = sqrt(d2), length = lod_vec3_length(away);
        if (length > 0)
          sum = lod_vec3_add_scaled(sum, away, (1 - d / reach) / length); /* the walk projects it onto the surface */
      }
    double length = lod_vec3_length(sum) * r->damping;
    r->moves[i] = lod_vec3_scale(sum, r->radius * a->spacing * r->damping * (length > 0.25 ? 0.25 / length : 1));
  }
}

static void walk_chunk(void *context, size_t begin, size_t end, size_t chunk) {
  struct repulsion *r = context;
  (void)chunk;
  for (size_t i = begin; i < end; i++)
    repel_walk(r->sheet, &r->points[r->fixed + i], r->moves[i]);
}

enum lod_status repel_points(const struct sheet *sheet, struct cloud_point *points, uint32_t fixed, uint32_t count, double radius,
                             double damping, double bend, uint32_t steps, uint32_t threads, struct lod_arena *arena) {
  enum { GRAIN = 1024 };
  struct repulsion r = {.sheet = sheet, .points = points, .fixed = fixed, .radius = radius, .damping = damping, .bend = bend};
  enum lod_status status = LOD_OK;
  for (uint32_t i = 0; i < count; i++)
    r.widest = fmax(r.widest, points[i].spacing);
  for (uint32_t step = 0; step < steps && status == LOD_OK && count > fixed && radius > 0; step++) {
    struct lod_arena *scratch = lod_arena_create_child(arena);
    r.moves = scratch == NULL ? NULL : LOD_NEW(scratch, count - fixed, struct lod_vec3);
    status = r.moves == NULL ? LOD_MEMORY : cloud_grid_create(points, count, radius * r.widest, scratch, &r.grid);
    if (status == LOD_OK) {
      r.widest = 0; /* walking changes spacings */
      for (uint32_t i = 0; i < count; i++)
        r.widest = fmax(r.widest, points[i].spacing);
      lod_parallel_for(threads, count - fixed, GRAIN, push_chunk, &r);
      lod_parallel_for(threads, count - fixed, GRAIN, walk_chunk, &r);
    }
    lod_arena_destroy(scratch);
  }
  return status;
}
