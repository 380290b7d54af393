/* Conforming subdivision of patches. See halve.h. */
#include "core/clod/halve.h"

#include <stdlib.h>
#include <string.h>

struct halving {
  const struct lod_patches *from;
  const bool *marks;
  const uint32_t *roots;
  struct lod_patches *to;
  uint32_t *new_roots;
  uint32_t *edge;   /* first new edge of each old one */
  uint32_t *middle; /* vertex in the middle of a marked edge */
  uint32_t
      *sector; /* of the middle, seen from the patch along; that of the patch against is the same or, where the edge is sharp, the next */
  uint32_t (*wedge)[2]; /* of the middle of a marked edge, seen from the patch along it, and from that against it; or NULL */
  uint32_t next_edge, next_patch;
};

static uint32_t wedge_of(const struct halving *h, uint32_t p, uint32_t c) {
  if (c < 3)
    return h->from->attributes.corners[p][c];
  uint32_t side = h->from->edges[p][c - 3];
  return h->wedge[side >> 1][side & 1];
}

/* Corners of a patch are 0, 1, 2; middles of its sides 3, 4, 5. */
static struct lod_barycentric place_of(uint32_t c) {
  static const struct lod_barycentric kPlaces[6] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}, {0.5, 0.5, 0}, {0, 0.5, 0.5}, {0.5, 0, 0.5}};
  return kPlaces[c];
}

static uint32_t vertex_of(const struct halving *h, uint32_t p, uint32_t c) {
  return c < 3 ? h->from->corners[p][c] : h->middle[h->from->edges[p][c - 3] >> 1];
}

static uint32_t sector_of(const struct halving *h, uint32_t p, uint32_t c) {
  if (c < 3)
    return h->from->sectors[p][c];
  uint32_t side = h->from->edges[p][c - 3], edge = side >> 1;
  return h->sector[edge] == LOD_NONE ? LOD_NONE : h->sector[edge] + (h->from->sharp[edge] ? side & 1 : 0);
}

/* Side of the new structure from a to b, which lie on one side of the old patch; LOD_NONE when they do not. */
static uint32_t outer_side(const struct halving *h, uint32_t p, uint32_t a, uint32_t b) {
  for (uint32_t k = 0; k < 3; k++) {
    uint32_t n = (k + 1) % 3, m = 3 + k, side = h->from->edges[p][k], against = side & 1, first = h->edge[side >> 1];
    if (a == k && b == n)
      return 2 * first + against;
    /* Halves in the edge's direction: first, first + 1. */
    if (a == k && b == m)
      return 2 * (first + against) + against;
    if (a == m && b == n)
      return 2 * (first + 1 - against) + against;
  }
  return LOD_NONE;
}

/* New edges inside of the patch that is being cut: it has at most three. */
struct inside {
  uint32_t count, from[3], to[3], edge[3];
};

static void add_patch(struct halving *h, uint32_t p, const struct lod_bezier *net, const uint32_t c[3], struct inside *inside) {
  struct lod_patches *to = h->to;
  uint32_t q = h->next_patch++;
  struct lod_bezier part = lod_bezier_restrict(net, place_of(c[0]), place_of(c[1]), place_of(c[2]));
  for (uint32_t k = 0; k < 3; k++) {
    uint32_t a = c[k], b = c[(k + 1) % 3], side = outer_side(h, p, a, b);
    to->corners[q][k] = vertex_of(h, p, a);
    to->sectors[q][k] = sector_of(h, p, a);
    if (to->attributes.corners != NULL)
      to->attributes.corners[q][k] = wedge_of(h, p, a);
    for (uint32_t i = 0; side == LOD_NONE && i < inside->count; i++)
      if (inside->from[i] == b && inside->to[i] == a)
        side = 2 * inside->edge[i] + 1;
    if (side == LOD_NONE) {
      uint32_t e = h->next_edge++;
      inside->from[inside->count] = a, inside->to[inside->count] = b, inside->edge[inside->count++] = e;
      to->ends[e][0] = to->corners[q][k];
      to->ends[e][1] = vertex_of(h, p, b);
      to->inner[e][0] = part.p[3 + 2 * k];
      to->inner[e][1] = part.p[4 + 2 * k];
      to->sharp[e] = false;
      side = 2 * e;
    }
    to->edges[q][k] = side;
  }
  to->centres[q] = part.p[LOD_BEZIER_CENTRE];
  if (to->materials != NULL)
    to->materials[q] = h->from->materials[p];
  if (to->parts != NULL)
    to->parts[q] = h->from->parts[p];
  h->new_roots[q] = h->roots == NULL ? p : h->roots[p];
}

static void cut_patch(struct halving *h, uint32_t p) {
  struct lod_bezier net = lod_patches_net(h->from, p);
  struct inside inside = {0};
  uint32_t bits = 0, count = 0;
  for (uint32_t k = 0; k < 3; k++)
    if (h->marks[h->from->edges[p][k] >> 1]) {
      bits |= 1u << k;
      count++;
    }
  if (count == 0) {
    add_patch(h, p, &net, (const uint32_t[3]){0, 1, 2}, &inside);
  } else if (count == 1) {
    uint32_t k = bits == 1 ? 0 : bits == 2 ? 1 : 2, n = (k + 1) % 3, l = (k + 2) % 3;
    add_patch(h, p, &net, (const uint32_t[3]){k, 3 + k, l}, &inside);
    add_patch(h, p, &net, (const uint32_t[3]){3 + k, n, l}, &inside);
  } else if (count == 2) {
    uint32_t whole = (bits & 1) == 0 ? 0 : (bits & 2) == 0 ? 1 : 2, n = (whole + 1) % 3, l = (whole + 2) % 3;
    add_patch(h, p, &net, (const uint32_t[3]){l, 3 + l, 3 + n}, &inside);
    add_patch(h, p, &net, (const uint32_t[3]){whole, n, 3 + n}, &inside);
    add_patch(h, p, &net, (const uint32_t[3]){whole, 3 + n, 3 + l}, &inside);
  } else {
    for (uint32_t k = 0; k < 3; k++)
      add_patch(h, p, &net, (const uint32_t[3]){k, 3 + k, 3 + (k + 2) % 3}, &inside);
    add_patch(h, p, &net, (const uint32_t[3]){3, 4, 5}, &inside);
  }
}

static bool allocate(struct halving *h, uint64_t vertices, uint64_t edges, uint64_t patches, uint64_t normals, struct lod_arena *arena) {
  struct lod_patches *to = h->to;
  to->vertex_count = (uint32_t)vertices;
  to->edge_count = (uint32_t)edges;
  to->patch_count = (uint32_t)patches;
  to->normal_count = (uint32_t)normals;
  to->positions = LOD_NEW(arena, vertices, struct lod_vec3);
  to->normals = LOD_NEW(arena, normals, struct lod_vec3);
  to->corners = lod_arena_alloc(arena, patches, sizeof *to->corners);
  to->sectors = lod_arena_alloc(arena, patches, sizeof *to->sectors);
  to->edges = lod_arena_alloc(arena, patches, sizeof *to->edges);
  to->partners = lod_arena_alloc(arena, patches, sizeof *to->partners);
  to->ends = lod_arena_alloc(arena, edges, sizeof *to->ends);
  to->inner = lod_arena_alloc(arena, edges, sizeof *to->inner);
  to->sharp = LOD_NEW(arena, edges, bool);
  to->centres = LOD_NEW(arena, patches, struct lod_vec3);
  to->materials = h->from->materials == NULL ? NULL : LOD_NEW(arena, patches, uint32_t);
  to->parts = h->from->parts == NULL ? NULL : LOD_NEW(arena, patches, uint32_t);
  h->new_roots = LOD_NEW(arena, patches, uint32_t);
  return to->positions != NULL && to->normals != NULL && to->corners != NULL && to->sectors != NULL && to->edges != NULL &&
         to->partners != NULL && to->ends != NULL && to->inner != NULL && to->sharp != NULL && to->centres != NULL &&
         (h->from->materials == NULL || to->materials != NULL) && (h->from->parts == NULL || to->parts != NULL) && h->new_roots != NULL;
}

static void copy_edges(struct halving *h, uint32_t *next_vertex, uint32_t *next_normal) {
  const struct lod_patches *from = h->from;
  struct lod_patches *to = h->to;
  for (uint32_t e = 0; e < from->edge_count; e++) {
    uint32_t first = h->edge[e] = h->next_edge;
    h->next_edge += h->marks[e] ? 2 : 1;
    if (!h->marks[e]) {
      memcpy(to->ends[first], from->ends[e], sizeof to->ends[first]);
      memcpy(to->inner[first], from->inner[e], sizeof to->inner[first]);
      to->sharp[first] = from->sharp[e];
      continue;
    }
    struct lod_bezier_curve whole = lod_patches_edge(from, e), parts[2];
    lod_bezier_split_curve(&whole, 0.5, &parts[0], &parts[1]);
    uint32_t middle = h->middle[e] = (*next_vertex)++;
    to->positions[middle] = parts[1].p[0];
    for (uint32_t i = 0; i < 2; i++) {
      to->ends[first + i][0] = i == 0 ? from->ends[e][0] : middle;
      to->ends[first + i][1] = i == 0 ? middle : from->ends[e][1];
      to->inner[first + i][0] = parts[i].p[1];
      to->inner[first + i][1] = parts[i].p[2];
      to->sharp[first + i] = from->sharp[e];
    }
    h->sector[e] = *next_normal;
    *next_normal += from->sharp[e] ? 2 : 1;
    for (uint32_t n = h->sector[e]; n < *next_normal; n++)
      to->normals[n] = (struct lod_vec3){0, 0, 0};
  }
}

/* Normals in the middles of marked edges: each patch adds its own. */
static void add_normals(struct halving *h) {
  for (uint32_t p = 0; p < h->from->patch_count; p++)
    for (uint32_t k = 0; k < 3; k++) {
      uint32_t side = h->from->edges[p][k];
      if (!h->marks[side >> 1])
        continue;
      struct lod_vec3 *sum = &h->to->normals[sector_of(h, p, 3 + k)];
      *sum = lod_vec3_add(*sum, lod_edge_normal(h->from, 3 * p + k, side & 1, 0.5, LOD_SMOOTH_SHADED));
    }
  for (uint32_t n = h->from->normal_count; n < h->to->normal_count; n++) {
    struct lod_vec3 normal = lod_vec3_normalize(h->to->normals[n]);
    h->to->normals[n] = lod_vec3_length_squared(normal) > 0.5 ? normal : (struct lod_vec3){0, 0, 1};
  }
}

/* Numbers in the middles of marked edges, twice where they jump. */
static enum lod_status halve_attributes(struct halving *h, struct lod_arena *arena, struct lod_arena *scratch) {
  const struct lod_patches *from = h->from;
  const struct lod_patch_attributes *a = &from->attributes;
  struct lod_patch_attributes *to = &h->to->attributes;
  *to = *a;
  if (a->corners == NULL)
    return LOD_OK;
  size_t room = a->count;
  for (uint32_t e = 0; e < from->edge_count; e++)
    room += h->marks[e] ? 2 : 0;
  to->corners = lod_arena_alloc(arena, h->to->patch_count, sizeof *to->corners);
  to->values = LOD_NEW(arena, room * a->width, float);
  h->wedge = lod_arena_alloc(scratch, from->edge_count, sizeof *h->wedge);
  if (to->corners == NULL || to->values == NULL || h->wedge == NULL)
    return LOD_MEMORY;
  memcpy(to->values, a->values, (size_t)a->count * a->width * sizeof *a->values);
  for (uint32_t p = 0; p < from->patch_count; p++)
    for (uint32_t k = 0; k < 3; k++) {
      uint32_t side = from->edges[p][k], other = from->partners[p][k], *mine = &h->wedge[side >> 1][side & 1];
      double at[3] = {0, 0, 0};
      if (!h->marks[side >> 1])
        continue;
      if (other != LOD_NONE && other < 3 * p + k && !lod_patch_attributes_jump(a, p, k, other)) {
        *mine = h->wedge[side >> 1][1 - (side & 1)];
        continue;
      }
      at[k] = at[(k + 1) % 3] = 0.5;
      *mine = to->count++;
      lod_patch_attributes_mix(a, p, at, to->values + (size_t)a->width * *mine);
    }
  return LOD_OK;
}

static enum lod_status halve(struct halving *h, struct lod_arena *arena, struct lod_arena *scratch) {
  const struct lod_patches *from = h->from;
  uint64_t vertices = from->vertex_count, edges = from->edge_count, patches = from->patch_count, normals = from->normal_count;
  for (uint32_t e = 0; e < from->edge_count; e++)
    if (h->marks[e]) {
      vertices++;
      edges++;
      normals += from->sharp[e] ? 2 : 1;
    }
  for (uint32_t p = 0; p < from->patch_count; p++)
    for (uint32_t k = 0; k < 3; k++)
      if (h->marks[from->edges[p][k] >> 1]) {
        patches++;
        edges++;
      }
  if (vertices >= UINT32_MAX / 8 || edges >= UINT32_MAX / 8 || patches >= UINT32_MAX / 8)
    return LOD_LIMIT;
  h->edge = LOD_NEW(scratch, from->edge_count, uint32_t);
  h->middle = LOD_NEW(scratch, from->edge_count, uint32_t);
  h->sector = LOD_NEW(scratch, from->edge_count, uint32_t);
  if (h->edge == NULL || h->middle == NULL || h->sector == NULL || !allocate(h, vertices, edges, patches, normals, arena))
    return LOD_MEMORY;
  memcpy(h->to->positions, from->positions, from->vertex_count * sizeof *from->positions);
  memcpy(h->to->normals, from->normals, from->normal_count * sizeof *from->normals);
  uint32_t next_vertex = from->vertex_count, next_normal = from->normal_count;
  copy_edges(h, &next_vertex, &next_normal);
  add_normals(h);
  LOD_TRY(halve_attributes(h, arena, scratch));
  for (uint32_t p = 0; p < from->patch_count; p++)
    cut_patch(h, p);
  return lod_patches_find_partners(h->to, scratch);
}

enum lod_status lod_patches_halve(const struct lod_patches *patches, const bool *marks, const uint32_t *roots, struct lod_arena *arena,
                                  struct lod_patches *result, uint32_t **new_roots) {
  struct lod_arena *scratch = lod_arena_create_child(arena);
  struct halving h = {.from = patches, .marks = marks, .roots = roots, .to = result};
  *result = (struct lod_patches){0};
  enum lod_status status = scratch == NULL ? LOD_MEMORY : halve(&h, arena, scratch);
  lod_arena_destroy(scratch);
  *new_roots = h.new_roots;
  return status;
}

struct ends {
  uint32_t low, high, edge;
};

static int by_ends(const void *a, const void *b) {
  const struct ends *x = a, *y = b;
  if (x->low != y->low)
    return x->low < y->low ? -1 : 1;
  if (x->high != y->high)
    return x->high < y->high ? -1 : 1;
  return x->edge < y->edge ? -1 : 1;
}

static enum lod_status mark_same(const struct lod_patches *patches, bool *marks, struct lod_arena *scratch, bool *any) {
  struct ends *list = LOD_NEW(scratch, patches->edge_count, struct ends);
  if (list == NULL)
    return LOD_MEMORY;
  for (uint32_t e = 0; e < patches->edge_count; e++) {
    uint32_t a = patches->ends[e][0], b = patches->ends[e][1];
    list[e] = (struct ends){a < b ? a : b, a < b ? b : a, e};
    marks[e] = a == b;
  }
  qsort(list, patches->edge_count, sizeof *list, by_ends);
  for (uint32_t i = 1; i < patches->edge_count; i++)
    if (list[i].low == list[i - 1].low && list[i].high == list[i - 1].high)
      marks[list[i].edge] = marks[list[i - 1].edge] = true;
  *any = false;
  for (uint32_t e = 0; e < patches->edge_count; e++)
    *any = *any || marks[e];
  return LOD_OK;
}

enum lod_status lod_patches_separate(const struct lod_patches *patches, struct lod_arena *arena, struct lod_patches *result) {
  enum { ROUNDS = 4 };
  *result = *patches;
  for (int round = 0; round < ROUNDS; round++) {
    struct lod_arena *scratch = lod_arena_create_child(arena);
    bool *marks = scratch == NULL ? NULL : LOD_NEW(scratch, result->edge_count, bool), any = false;
    struct lod_patches next = *result;
    uint32_t *roots;
    enum lod_status status = marks == NULL ? LOD_MEMORY : mark_same(result, marks, scratch, &any);
    if (status == LOD_OK && any)
      status = lod_patches_halve(result, marks, NULL, arena, &next, &roots);
    lod_arena_destroy(scratch);
    if (status != LOD_OK || !any)
      return status;
    *result = next;
  }
  return LOD_OK;
}
