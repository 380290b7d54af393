/* Which finer triangles lie over which patch of the coarser level, and the stream made of them. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "codec/stream/bytes.h"
#include "codec/stream/connectivity.h"
#include "codec/stream/units.h"
#include "core/mesh/triangle_distance.h"

enum {
  MOST_STRAYS = 20,
  FAN = 48,
  SWEEPS = 4
}; /* of 100 finer triangles, those that hang together with no vertex of the base; triangles looked at */

struct division {
  const struct lod_delta_encode_request *request;
  uint32_t *base_patch, patch_count; /* of the base's triangles */
  uint32_t *around_first, *around;   /* base vertex -> its triangles */
  uint32_t *nearest;                 /* finer vertex -> base vertex, by edges between; LOD_NONE: none is connected with it */
  uint32_t *patch;                   /* finer triangle -> patch */
  struct lod_arena *scratch;
};

static enum lod_status list_around(struct division *d) {
  const struct lod_mesh *base = d->request->base;
  d->around_first = LOD_NEW_ZERO(d->scratch, (size_t)base->vertex_count + 2, uint32_t);
  d->around = LOD_NEW(d->scratch, 3 * (size_t)base->triangle_count, uint32_t);
  if (d->around_first == NULL || d->around == NULL)
    return LOD_MEMORY;
  for (uint32_t h = 0; h < 3 * base->triangle_count; h++)
    d->around_first[base->triangles[h / 3][h % 3] + 2]++;
  for (uint32_t v = 0; v < base->vertex_count; v++)
    d->around_first[v + 2] += d->around_first[v + 1];
  for (uint32_t h = 0; h < 3 * base->triangle_count; h++)
    d->around[d->around_first[base->triangles[h / 3][h % 3] + 1]++] = h / 3;
  return LOD_OK;
}

/* Breadth first over the finer level from all kept vertices at once. */
static enum lod_status find_nearest(struct division *d) {
  const struct lod_mesh *fine = d->request->fine, *base = d->request->base;
  const size_t entries = 6 * (size_t)fine->triangle_count;
  uint32_t *first = LOD_NEW_ZERO(d->scratch, (size_t)fine->vertex_count + 2, uint32_t), *list = LOD_NEW(d->scratch, entries, uint32_t);
  uint32_t *queue = LOD_NEW(d->scratch, fine->vertex_count, uint32_t), count = 0;
  d->nearest = LOD_NEW(d->scratch, fine->vertex_count, uint32_t);
  if (first == NULL || list == NULL || queue == NULL || d->nearest == NULL)
    return LOD_MEMORY;
  for (uint32_t h = 0; h < 3 * fine->triangle_count; h++)
    first[fine->triangles[h / 3][h % 3] + 2] += 2;
  for (uint32_t v = 0; v < fine->vertex_count; v++)
    first[v + 2] += first[v + 1];
  for (uint32_t h = 0; h < 3 * fine->triangle_count; h++)
    for (uint32_t i = 1; i < 3; i++)
      list[first[fine->triangles[h / 3][h % 3] + 1]++] = fine->triangles[h / 3][(h % 3 + i) % 3];
  memset(d->nearest, 0xff, (size_t)fine->vertex_count * sizeof *d->nearest);
  for (uint32_t b = 0; b < base->vertex_count; b++)
    if (d->request->kept[b] != LOD_NONE && d->around_first[b] < d->around_first[b + 1] && d->nearest[d->request->kept[b]] == LOD_NONE) {
      d->nearest[d->request->kept[b]] = b;
      queue[count++] = d->request->kept[b];
    }
  for (uint32_t i = 0; i < count; i++)
    for (uint32_t k = first[queue[i]]; k < first[queue[i] + 1]; k++)
      if (d->nearest[list[k]] == LOD_NONE) {
        d->nearest[list[k]] = d->nearest[queue[i]];
        queue[count++] = list[k];
      }
  return LOD_OK;
}

/* The patch of the coarse triangle that the middle of finer triangle t lies nearest to, of those around the base's vertices nearest to its
 * corners. */
static uint32_t patch_of(const struct division *d, uint32_t t) {
  const struct lod_mesh *fine = d->request->fine, *base = d->request->base;
  const uint32_t *v = fine->triangles[t];
  struct lod_vec3 middle = {0};
  uint32_t best = LOD_NONE;
  double least = INFINITY;
  for (int i = 0; i < 3; i++)
    middle = lod_vec3_add_scaled(middle, lod_vec3_from_float(fine->positions[v[i]]), 1.0 / 3);
  for (int i = 0; i < 3; i++) {
    const uint32_t b = d->nearest[v[i]];
    if (b == LOD_NONE || (i > 0 && b == d->nearest[v[0]]) || (i > 1 && b == d->nearest[v[1]]))
      continue;
    for (uint32_t k = d->around_first[b]; k < d->around_first[b + 1] && k < d->around_first[b] + FAN; k++) {
      const uint32_t *c = base->triangles[d->around[k]];
      const struct lod_triangle_probe probe =
          lod_triangle_prepare(lod_vec3_from_float(base->positions[c[0]]), lod_vec3_from_float(base->positions[c[1]]),
                               lod_vec3_from_float(base->positions[c[2]]));
      const double distance = lod_triangle_distance_squared(&probe, middle);
      if (distance < least) {
        least = distance;
        best = d->base_patch[d->around[k]];
      }
    }
  }
  return best;
}

/* Takes teeth off the borders: a triangle of which two neighbours are over one other patch goes there, since each vertex on a border is
 * coded twice. */
static enum lod_status smooth_borders(struct division *d) {
  const struct lod_mesh *fine = d->request->fine;
  struct lod_cut cut;
  LOD_TRY(lod_cut_create((const uint32_t(*)[3])fine->triangles, fine->triangle_count, fine->vertex_count, d->scratch, &cut));
  for (int sweep = 0; sweep < SWEEPS; sweep++)
    for (uint32_t t = 0; t < fine->triangle_count; t++) {
      uint32_t beside[3];
      for (uint32_t i = 0; i < 3; i++)
        beside[i] = cut.opposite[3 * t + i] == LOD_NONE ? d->patch[t] : d->patch[cut.opposite[3 * t + i] / 3];
      for (int i = 0; i < 3; i++)
        if (beside[i] != d->patch[t] && beside[i] == beside[(i + 1) % 3]) {
          d->patch[t] = beside[i];
          break;
        }
    }
  return LOD_OK;
}

static enum lod_status divide(struct division *d, bool *sensible) {
  const struct lod_delta_encode_request *r = d->request;
  const uint32_t triangles = r->fine->triangle_count;
  uint64_t strays = 0;
  LOD_TRY(list_around(d));
  LOD_TRY(find_nearest(d));
  d->patch = LOD_NEW(d->scratch, triangles, uint32_t);
  if (d->patch == NULL)
    return LOD_MEMORY;
  for (uint32_t t = 0, last = 0; t < triangles; t++) {
    d->patch[t] = patch_of(d, t);
    if (d->patch[t] == LOD_NONE) {
      d->patch[t] = last;
      strays++;
    }
    last = d->patch[t];
  }
  LOD_TRY(smooth_borders(d));
  *sensible = strays * 100 <= (uint64_t)MOST_STRAYS * triangles;
  return LOD_OK;
}

/* Whether all normals are within `degrees` of the surface's and wedges are told apart by more than their normals, so that a client can
 * compute them once patches are joined. */
static enum lod_status judge_normals(const struct lod_mesh *mesh, double degrees, struct lod_arena *arena, bool *smooth) {
  float(*normals)[3];
  *smooth = false;
  if (mesh->normals == NULL || mesh->wedge_count == 0)
    return LOD_OK;
  LOD_TRY(lod_units_normals(mesh, arena, &normals));
  const double least = cos(degrees * 0.017453292519943295);
  for (uint32_t w = 0; w < mesh->wedge_count; w++) {
    const float *n = mesh->normals[w], *m = normals[w];
    if (!((double)n[0] * (double)m[0] + (double)n[1] * (double)m[1] + (double)n[2] * (double)m[2] >= least))
      return LOD_OK;
  }
  struct lod_mesh bare = *mesh, welded;
  bare.normals = NULL;
  LOD_TRY(lod_mesh_weld(&bare, arena, &welded, NULL));
  *smooth = welded.wedge_count == mesh->wedge_count;
  return LOD_OK;
}

/* ---- the stream ---- */

struct piece {
  uint8_t *bytes;
  size_t size;
  uint32_t vertices, triangles;
};

static int compare_numbers(const void *a, const void *b) {
  const uint32_t x = *(const uint32_t *)a, y = *(const uint32_t *)b;
  return (x > y) - (x < y);
}

/* Finer triangles `list` over the base's triangles `coarse`, as a frame. */
static enum lod_status encode_patch(const struct division *d, const uint32_t *coarse, uint32_t coarse_count, const uint32_t *list,
                                    uint32_t count, bool smooth, struct lod_coder_memory **primer, struct lod_arena *arena,
                                    struct lod_arena *scratch, struct piece *piece, struct lod_problem *problem) {
  struct lod_delta_encode_request request = *d->request;
  struct lod_mesh base, fine;
  uint32_t *base_vertices, *vertices;
  request.part = true;
  request.primer = *primer;
  request.memory = *primer == NULL ? primer : NULL; /* of the first one */
  LOD_TRY(lod_units_part(d->request->base, coarse, coarse_count, scratch, &base, &base_vertices));
  LOD_TRY(lod_units_part(d->request->fine, list, count, scratch, &fine, &vertices));
  uint32_t *kept = LOD_NEW(scratch, base.vertex_count, uint32_t);
  if (kept == NULL)
    return LOD_MEMORY;
  for (uint32_t b = 0; b < base.vertex_count; b++) {
    const uint32_t *found = fine.vertex_count == 0 ? NULL
                                                   : bsearch(&d->request->kept[base_vertices[b]], vertices, fine.vertex_count,
                                                             sizeof *vertices, compare_numbers);
    kept[b] = found == NULL ? LOD_NONE : (uint32_t)(found - vertices);
  }
  request.base = &base;
  request.fine = &fine;
  request.kept = kept;
  request.normal_degrees = smooth ? 180 : 0;
  *piece = (struct piece){.vertices = fine.vertex_count, .triangles = count};
  return lod_delta_encode(&request, arena, &piece->bytes, &piece->size, problem);
}

/* Numbers 0 to count - 1 by their group: those of group g are list[first[g]] to list[first[g + 1] - 1], rising. */
static enum lod_status list_groups(const uint32_t *group, uint32_t count, uint32_t groups, struct lod_arena *arena, uint32_t **first,
                                   uint32_t **list) {
  *first = LOD_NEW_ZERO(arena, (size_t)groups + 2, uint32_t);
  *list = LOD_NEW(arena, count, uint32_t);
  if (*first == NULL || *list == NULL)
    return LOD_MEMORY;
  for (uint32_t i = 0; i < count; i++)
    (*first)[group[i] + 2]++;
  for (uint32_t g = 0; g < groups; g++)
    (*first)[g + 2] += (*first)[g + 1];
  for (uint32_t i = 0; i < count; i++)
    (*list)[(*first)[group[i] + 1]++] = i;
  return LOD_OK;
}

static enum lod_status write_stream(const struct division *d, uint32_t most_triangles, const struct piece *pieces, bool smooth,
                                    struct lod_arena *arena, uint8_t **bytes, size_t *size) {
  const struct lod_delta_encode_request *r = d->request;
  uint32_t base_checksum, checksum;
  size_t frames = 0;
  LOD_TRY(lod_delta_checksum(r->base, d->scratch, &base_checksum));
  LOD_TRY(lod_delta_checksum(r->fine, d->scratch, &checksum));
  for (uint32_t p = 0; p < d->patch_count; p++)
    frames += pieces[p].size;
  uint8_t *all = LOD_NEW(arena, 128 + 15 * (size_t)d->patch_count + frames, uint8_t);
  if (all == NULL)
    return LOD_MEMORY;
  struct lod_writer w = {.at = all};
  memcpy(w.at, "LODU", 4);
  w.at += 4;
  lod_write_fixed(&w, LOD_UNITS_VERSION, 1);
  lod_write_fixed(&w, smooth, 1);
  w.at += 4;
  const uint32_t counts[] = {
      r->from,        r->to,         r->unit, r->unit_count, r->base->vertex_count, r->fine->vertex_count, r->fine->triangle_count,
      most_triangles, d->patch_count};
  for (size_t i = 0; i < sizeof counts / sizeof *counts; i++)
    lod_write_varint(&w, counts[i]);
  lod_write_fixed(&w, base_checksum, 4);
  lod_write_fixed(&w, checksum, 4);
  for (int i = 0; i < 3; i++)
    lod_write_float(&w, r->grid.origin[i]);
  lod_write_float(&w, r->grid.step);
  for (uint32_t p = 0; p < d->patch_count; p++) {
    lod_write_varint(&w, (uint32_t)pieces[p].size);
    lod_write_varint(&w, pieces[p].vertices);
    lod_write_varint(&w, pieces[p].triangles);
  }
  struct lod_writer length = {.at = all + 6};
  lod_write_fixed(&length, (uint32_t)(w.at - all) + 4, 4);
  lod_write_fixed(&w, lod_crc32(all, (size_t)(w.at - all)), 4);
  for (uint32_t p = 0; p < d->patch_count; p++)
    if (pieces[p].size != 0) {
      memcpy(w.at, pieces[p].bytes, pieces[p].size);
      w.at += pieces[p].size;
    }
  *bytes = all;
  *size = (size_t)(w.at - all);
  return LOD_OK;
}

static enum lod_status encode(struct division *d, uint32_t most_triangles, struct lod_arena *arena, uint8_t **bytes, size_t *size,
                              struct lod_problem *problem) {
  const struct lod_delta_encode_request *r = d->request;
  uint32_t *coarse_first, *coarse, *first, *list;
  bool sensible, smooth;
  LOD_TRY(lod_units_partition(r->base, &r->grid, most_triangles, d->scratch, &d->base_patch, &d->patch_count));
  if (d->patch_count < 2)
    return LOD_OK;
  LOD_TRY(divide(d, &sensible));
  if (!sensible)
    return LOD_OK;
  LOD_TRY(judge_normals(r->fine, r->normal_degrees, d->scratch, &smooth));
  LOD_TRY(list_groups(d->base_patch, r->base->triangle_count, d->patch_count, d->scratch, &coarse_first, &coarse));
  LOD_TRY(list_groups(d->patch, r->fine->triangle_count, d->patch_count, d->scratch, &first, &list));
  struct piece *pieces = LOD_NEW_ZERO(d->scratch, d->patch_count, struct piece);
  enum lod_status status = pieces == NULL ? LOD_MEMORY : LOD_OK;
  struct lod_coder_memory *primer = NULL;
  for (uint32_t p = 0; p < d->patch_count && status == LOD_OK; p++) {
    if (first[p] == first[p + 1])
      continue;
    struct lod_arena *scratch = lod_arena_create_child(d->scratch);
    status = scratch == NULL ? LOD_MEMORY
                             : encode_patch(d, coarse + coarse_first[p], coarse_first[p + 1] - coarse_first[p], list + first[p],
                                            first[p + 1] - first[p], smooth, &primer, d->scratch, scratch, &pieces[p], problem);
    lod_arena_destroy(scratch);
  }
  return status == LOD_OK ? write_stream(d, most_triangles, pieces, smooth, arena, bytes, size) : status;
}

enum lod_status lod_units_encode(const struct lod_delta_encode_request *request, uint32_t most_triangles, struct lod_arena *arena,
                                 uint8_t **bytes, size_t *size, struct lod_problem *problem) {
  struct division d = {.request = request, .scratch = lod_arena_create_child(arena)};
  *bytes = NULL;
  *size = 0;
  const struct lod_mesh *base = request->base, *fine = request->fine;
  enum lod_status status = d.scratch == NULL ? LOD_MEMORY : LOD_OK;
  if (status == LOD_OK && base != NULL && fine->triangle_count != 0 &&
      base->edge_count + base->point_count + fine->edge_count + fine->point_count == 0)
    status = encode(&d, most_triangles, arena, bytes, size, problem);
  lod_arena_destroy(d.scratch);
  return status == LOD_MEMORY ? lod_fail_memory(problem) : status;
}
