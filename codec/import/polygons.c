#include "codec/import/polygons.h"

#include <math.h>
#include <string.h>

#include "core/mesh/triangulate.h"

enum lod_status lod_polygons_init(struct lod_polygons *polygons, struct lod_reader *reader, uint64_t expected) {
  *polygons = (struct lod_polygons){0};
  if (expected > UINT32_MAX / 4)
    return lod_reader_fail(reader, LOD_LIMIT, "limit-triangles", "more than %u faces", UINT32_MAX / 4);
  polygons->polygon_capacity = (uint32_t)expected;
  polygons->corner_capacity = (uint32_t)expected * 3 + 3;
  polygons->corners = LOD_NEW(reader->scratch, polygons->corner_capacity, uint32_t);
  return polygons->corners ? LOD_OK : lod_reader_memory(reader);
}

/* A bigger copy of `old`, of which `used` entries matter. */
static uint32_t *grow(struct lod_reader *reader, const uint32_t *old, uint64_t used, uint64_t wanted, uint32_t *capacity) {
  uint64_t next = wanted + wanted / 2 + 16;
  if (next >= UINT32_MAX) {
    lod_reader_fail(reader, LOD_LIMIT, "limit-triangles", "the faces have more corners than 32 bits count");
    return NULL;
  }
  uint32_t *items = LOD_NEW(reader->scratch, next, uint32_t);
  if (!items) {
    lod_reader_memory(reader);
    return NULL;
  }
  if (used > 0)
    memcpy(items, old, used * sizeof *items);
  *capacity = (uint32_t)next;
  return items;
}

uint32_t *lod_polygons_begin(struct lod_polygons *polygons, struct lod_reader *reader, uint32_t count) {
  uint64_t wanted = (uint64_t)polygons->corner_count + count;
  if (wanted > polygons->corner_capacity) {
    uint32_t *corners = grow(reader, polygons->corners, polygons->corner_count, wanted, &polygons->corner_capacity);
    if (!corners)
      return NULL;
    polygons->corners = corners;
  }
  return polygons->corners + polygons->corner_count;
}

/* The first polygon that is no triangle: from here on every polygon's first corner is written down. */
static bool start_starts(struct lod_polygons *polygons, struct lod_reader *reader) {
  polygons->starts = grow(reader, NULL, 0, (uint64_t)polygons->polygon_capacity + 1, &polygons->polygon_capacity);
  if (!polygons->starts)
    return false;
  for (uint32_t i = 0; i <= polygons->polygon_count; i++)
    polygons->starts[i] = i * 3;
  return true;
}

enum lod_status lod_polygons_end(struct lod_polygons *polygons, struct lod_reader *reader, uint32_t count) {
  if (count < 3) {
    polygons->dropped++;
    return LOD_OK;
  }
  if (count != 3 && !polygons->starts && !start_starts(polygons, reader))
    return LOD_LIMIT;
  polygons->corner_count += count;
  polygons->polygon_count++;
  if (polygons->starts) {
    if ((uint64_t)polygons->polygon_count + 1 > polygons->polygon_capacity) {
      uint32_t *starts =
          grow(reader, polygons->starts, polygons->polygon_count, (uint64_t)polygons->polygon_count + 1, &polygons->polygon_capacity);
      if (!starts)
        return LOD_LIMIT;
      polygons->starts = starts;
    }
    polygons->starts[polygons->polygon_count] = polygons->corner_count;
  }
  return LOD_OK;
}

static enum lod_status check_indices(const struct lod_polygons *polygons, struct lod_reader *reader, uint32_t vertex_count) {
  for (uint32_t i = 0; i < polygons->corner_count; i++)
    if (polygons->corners[i] >= vertex_count)
      return lod_reader_bad(reader, "index-out-of-range", "a face uses vertex %u, but there are %u vertices", polygons->corners[i],
                            vertex_count);
  return LOD_OK;
}

/* A polygon's corners as the triangulation wants them; false when a coordinate is not finite. */
static bool corners_are_finite(float (*positions)[3], const uint32_t *corners, uint32_t count) {
  for (uint32_t i = 0; i < count; i++)
    for (int axis = 0; axis < 3; axis++)
      if (!isfinite(positions[corners[i]][axis]))
        return false;
  return true;
}

/* All polygons of one mesh; `result` has room. */
static enum lod_status triangulate_all(const struct lod_polygons *polygons, struct lod_reader *reader, float (*positions)[3],
                                       struct lod_polygon_triangles *result) {
  uint32_t crossed = 0, done = 0;
  for (uint32_t p = 0; p < polygons->polygon_count; p++) {
    uint32_t first = polygons->starts[p], count = polygons->starts[p + 1] - first, flags = 0;
    const uint32_t *corners = polygons->corners + first;
    if (!corners_are_finite(positions, corners, count))
      return lod_reader_bad(reader, "non-finite", "a vertex of face %u is not a finite number", p);
    if (lod_triangulate_polygon((const float(*)[3])positions, corners, &count, 1, reader->scratch, result->corners + done, &flags) !=
        LOD_OK)
      return lod_reader_memory(reader);
    crossed += (flags & LOD_TRIANGULATE_CROSSED) != 0;
    for (uint32_t t = done; t < done + count - 2; t++) {
      for (int k = 0; k < 3; k++) {
        result->corners[t][k] += first;
        result->triangles[t][k] = polygons->corners[result->corners[t][k]];
      }
      result->polygon[t] = p;
    }
    done += count - 2;
    if ((p & 0xFFFF) == 0xFFFF)
      LOD_TRY(lod_reader_progress(reader, 0.4));
  }
  if (crossed > 0)
    lod_scene_warn(reader->scene, "%u faces cross themselves; their triangles may overlap.", crossed);
  return LOD_OK;
}

enum lod_status lod_polygons_triangulate(struct lod_polygons *polygons, struct lod_reader *reader, float (*positions)[3],
                                         uint32_t vertex_count, bool want_corners, struct lod_polygon_triangles *result) {
  *result = (struct lod_polygon_triangles){0};
  LOD_TRY(check_indices(polygons, reader, vertex_count));
  uint32_t count = polygons->corner_count - 2 * polygons->polygon_count;
  LOD_TRY(lod_reader_add_triangles(reader, count));
  result->count = count;
  if (!polygons->starts) {
    result->triangles = (uint32_t(*)[3])(void *)polygons->corners;
    if (!want_corners)
      return LOD_OK;
    result->corners = lod_arena_alloc(reader->scratch, count, sizeof *result->corners);
    if (!result->corners)
      return lod_reader_memory(reader);
    for (uint32_t t = 0; t < count; t++)
      for (uint32_t k = 0; k < 3; k++)
        result->corners[t][k] = 3 * t + k;
    return LOD_OK;
  }
  result->triangles = lod_arena_alloc(reader->scratch, count, sizeof *result->triangles);
  result->corners = lod_arena_alloc(reader->scratch, count, sizeof *result->corners);
  result->polygon = LOD_NEW(reader->scratch, count, uint32_t);
  if (!result->triangles || !result->corners || !result->polygon)
    return lod_reader_memory(reader);
  return triangulate_all(polygons, reader, positions, result);
}
