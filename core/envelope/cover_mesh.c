/* The mesh of a cover, and signs with fibers. */
#include <math.h>
#include <string.h>

#include "core/base/predicates.h"
#include "core/base/sets.h"
#include "core/envelope/cover_internal.h"

/* ---- signs ---- */

int cover_side(const struct lod_cover *c, uint32_t p, uint32_t q, uint32_t w) {
  int sign = lod_orient3d(c->at[p], c->at[q], c->low[w], c->high[w]);
  return sign != 0 ? sign : p < q ? 1 : -1;
}

bool cover_faces_out(const struct lod_cover *c, uint32_t a, uint32_t b, uint32_t d) {
  const uint32_t v[3] = {a, b, d};
  struct lod_vec3 p = cover_point(c, a),
                  n = lod_vec3_cross(lod_vec3_subtract(cover_point(c, b), p), lod_vec3_subtract(cover_point(c, d), p));
  double length = lod_vec3_length(n);
  if (!(length > 0))
    return false;
  for (int k = 0; k < 3; k++) {
    if (!(lod_vec3_dot(n, c->offset.direction[v[k]]) > 0.02 * length))
      return false;
    if (lod_orient3d(c->at[v[k]], c->at[v[(k + 1) % 3]], c->low[v[(k + 2) % 3]], c->high[v[(k + 2) % 3]]) <= 0)
      return false;
  }
  return true;
}

bool cover_covers(const struct lod_cover *c, const uint32_t v[3], uint32_t w) {
  for (int k = 0; k < 3; k++)
    if (cover_side(c, v[k], v[(k + 1) % 3], w) < 0)
      return false;
  return true;
}

/* ---- rings ---- */

static enum lod_status ring_add(struct lod_cover *c, uint32_t v, uint32_t f) {
  struct cover_ring *ring = &c->ring[v];
  if (ring->count == ring->capacity) {
    uint32_t capacity = ring->capacity < 4 ? 8 : 2 * ring->capacity;
    uint32_t *grown = LOD_NEW(c->arena, capacity, uint32_t);
    if (grown == NULL)
      return LOD_MEMORY;
    if (ring->count != 0)
      memcpy(grown, ring->faces, ring->count * sizeof *grown);
    ring->faces = grown;
    ring->capacity = capacity;
  }
  ring->faces[ring->count++] = f;
  return LOD_OK;
}

static void ring_remove(struct lod_cover *c, uint32_t v, uint32_t f) {
  struct cover_ring *ring = &c->ring[v];
  uint32_t kept = 0;
  for (uint32_t i = 0; i < ring->count; i++)
    if (ring->faces[i] != f)
      ring->faces[kept++] = ring->faces[i];
  ring->count = kept;
}

uint32_t cover_across(const struct lod_cover *c, uint32_t f, uint32_t u, uint32_t w) {
  const struct cover_ring *ring = &c->ring[u];
  for (uint32_t i = 0; i < ring->count; i++) {
    uint32_t g = ring->faces[i];
    if (g != f && (c->face[g][0] == w || c->face[g][1] == w || c->face[g][2] == w))
      return g;
  }
  return LOD_NONE;
}

static void set_box(struct lod_cover *c, uint32_t f) {
  for (int k = 0; k < 3; k++) {
    c->box[f][k] = INFINITY;
    c->box[f][k + 3] = -INFINITY;
    for (int i = 0; i < 3; i++) {
      c->box[f][k] = fminf(c->box[f][k], c->mesh->positions[c->face[f][i]][k]);
      c->box[f][k + 3] = fmaxf(c->box[f][k + 3], c->mesh->positions[c->face[f][i]][k]);
    }
  }
}

/* ---- set-up ---- */

static enum lod_status allocate(struct lod_cover *c) {
  struct lod_arena *arena = c->arena;
  uint32_t vertices = c->mesh->vertex_count, triangles = c->mesh->triangle_count;
  bool ok =
      (c->at = lod_arena_alloc(arena, vertices, sizeof *c->at)) != NULL &&
      (c->low = lod_arena_alloc(arena, vertices, sizeof *c->low)) != NULL &&
      (c->high = lod_arena_alloc(arena, vertices, sizeof *c->high)) != NULL && (c->kind = LOD_NEW_ZERO(arena, vertices, uint8_t)) != NULL &&
      (c->link = lod_arena_alloc(arena, vertices, sizeof *c->link)) != NULL && (c->near = LOD_NEW(arena, vertices, uint32_t)) != NULL &&
      (c->stamp = LOD_NEW_ZERO(arena, vertices, uint32_t)) != NULL && (c->replaced = LOD_NEW(arena, vertices, uint32_t)) != NULL &&
      (c->next = LOD_NEW(arena, vertices, uint32_t)) != NULL && (c->normal = LOD_NEW(arena, vertices, struct lod_vec3)) != NULL &&
      (c->ring = LOD_NEW_ZERO(arena, vertices, struct cover_ring)) != NULL;
  ok = ok && (c->face = lod_arena_alloc(arena, triangles, sizeof *c->face)) != NULL &&
       (c->opaque = LOD_NEW_ZERO(arena, triangles, uint8_t)) != NULL && (c->patch = lod_sets_create(arena, triangles)) != NULL &&
       (c->first = LOD_NEW(arena, triangles, uint32_t)) != NULL && (c->box = lod_arena_alloc(arena, triangles, sizeof *c->box)) != NULL &&
       (c->face_mark = LOD_NEW_ZERO(arena, triangles, uint32_t)) != NULL &&
       (c->vertex_mark = LOD_NEW_ZERO(arena, vertices, uint32_t)) != NULL && (c->vertex_slot = LOD_NEW(arena, vertices, uint32_t)) != NULL;
  return ok ? LOD_OK : LOD_MEMORY;
}

/* Lines: boundaries, the caller's features, and the edges that the user preserves, whose ends stay. */
static void mark_lines(struct lod_cover *c, const struct lod_adjacency *adjacency) {
  const struct lod_mesh *mesh = c->mesh;
  for (uint32_t h = 0; h < 3 * mesh->triangle_count; h++) {
    uint32_t t = h / 3, twin = adjacency->twin[h];
    bool line = twin == LOD_NONE || (mesh->materials != NULL && mesh->materials[t] != mesh->materials[twin / 3]) ||
                (mesh->parts != NULL && mesh->parts[t] != mesh->parts[twin / 3]);
    if (c->settings.feature_edges != NULL)
      line = line || (c->settings.feature_edges[h / 3] >> h % 3 & 1);
    if (line) {
      c->opaque[t] |= (uint8_t)(1 << h % 3);
      if (twin != LOD_NONE)
        c->opaque[twin / 3] |= (uint8_t)(1 << twin % 3);
    }
  }
  for (uint32_t i = 0; i < c->settings.preserved_count; i++)
    for (int k = 0; k < 2; k++) {
      uint32_t u = c->settings.preserved[i][k], w = c->settings.preserved[i][1 - k];
      c->kind[u] = COVER_FIXED;
      for (uint32_t j = adjacency->vertex_begin[u]; j < adjacency->vertex_begin[u + 1]; j++)
        for (int n = 0; n < 3; n++) {
          uint32_t t = adjacency->vertex_corners[j] / 3, p = mesh->triangles[t][n], q = mesh->triangles[t][(n + 1) % 3];
          if ((p == u && q == w) || (p == w && q == u))
            c->opaque[t] |= (uint8_t)(1 << n);
        }
    }
}

/* A vertex's kind: by the lines that meet at it. */
static void find_kind(struct lod_cover *c, const struct lod_adjacency *adjacency, uint32_t v) {
  const uint32_t *corners = adjacency->vertex_corners + adjacency->vertex_begin[v];
  uint32_t count = adjacency->vertex_begin[v + 1] - adjacency->vertex_begin[v], lines = 0,
           fan = count == 0 ? 0 : adjacency->fan_of[corners[0]];
  for (uint32_t i = 0; i < count; i++) {
    uint32_t t = corners[i] / 3, k = corners[i] % 3, ends[2] = {c->mesh->triangles[t][(k + 1) % 3], c->mesh->triangles[t][(k + 2) % 3]};
    bool line[2] = {c->opaque[t] >> k & 1, c->opaque[t] >> (k + 2) % 3 & 1};
    for (int e = 0; e < 2; e++) {
      bool known = !line[e];
      for (uint32_t j = 0; j < lines && j < 2; j++)
        known = known || c->link[v][j] == ends[e];
      if (!known) {
        if (lines < 2)
          c->link[v][lines] = ends[e];
        lines++;
      }
    }
    if (adjacency->fan_of[corners[i]] != fan)
      c->kind[v] = COVER_FIXED; /* a bow tie */
  }
  bool hidden = !(lod_vec3_length_squared(c->offset.direction[v]) > 0);
  if (c->kind[v] != COVER_FIXED)
    c->kind[v] = hidden ? COVER_FIXED : lines == 0 ? COVER_INTERIOR : lines == 2 ? COVER_CURVE : COVER_FIXED;
  c->near[v] = count == 0 ? LOD_NONE : corners[0] / 3;
}

static void place_vertex(struct lod_cover *c, uint32_t v) {
  double reach = c->reach; /* any length will do: a fiber is a line */
  struct lod_vec3 p = lod_vec3_from_float(c->mesh->positions[v]), d = c->offset.direction[v];
  struct lod_vec3 low = lod_vec3_add_scaled(p, d, -reach), high = lod_vec3_add_scaled(p, d, reach);
  const double at[3] = {p.x, p.y, p.z}, under[3] = {low.x, low.y, low.z}, over[3] = {high.x, high.y, high.z};
  memcpy(c->at[v], at, sizeof at);
  memcpy(c->low[v], under, sizeof under);
  memcpy(c->high[v], over, sizeof over);
}

enum lod_status cover_mesh_create(struct lod_cover *c, const struct lod_adjacency *adjacency) {
  const struct lod_mesh *mesh = c->mesh;
  LOD_TRY(allocate(c));
  struct lod_bounds bounds = lod_mesh_bounds(mesh);
  c->reach = 0.05 * lod_bounds_diagonal(&bounds);
  mark_lines(c, adjacency);
  for (uint32_t v = 0; v < mesh->vertex_count; v++) {
    place_vertex(c, v);
    find_kind(c, adjacency, v);
    c->normal[v] = c->offset.direction[v];
    c->replaced[v] = c->next[v] = LOD_NONE;
  }
  for (uint32_t h = 0; h < 3 * mesh->triangle_count; h++)
    if (!(c->opaque[h / 3] >> h % 3 & 1))
      lod_sets_join(c->patch, h / 3, adjacency->twin[h] / 3);
  for (uint32_t t = 0; t < mesh->triangle_count; t++) {
    c->patch[t] = lod_sets_find(c->patch, t);
    c->first[t] = LOD_NONE;
    memcpy(c->face[t], mesh->triangles[t], sizeof c->face[t]);
    set_box(c, t);
    for (int k = 0; k < 3; k++)
      LOD_TRY(ring_add(c, c->face[t][k], t));
  }
  c->live = mesh->triangle_count;
  return LOD_OK;
}

static struct lod_vec3 face_normal(const struct lod_cover *c, uint32_t f) {
  struct lod_vec3 a = cover_point(c, c->face[f][0]);
  return lod_vec3_normalize(
      lod_vec3_cross(lod_vec3_subtract(cover_point(c, c->face[f][1]), a), lod_vec3_subtract(cover_point(c, c->face[f][2]), a)));
}

void cover_renew_fibers(struct lod_cover *c) {
  enum { MOST = 64 };
  for (uint32_t v = 0; v < c->mesh->vertex_count; v++) {
    const struct cover_ring *ring = &c->ring[v];
    struct lod_vec3 faces[MOST];
    double cosine = 1;
    if (ring->count > MOST || (ring->count == 0 && c->replaced[v] == LOD_NONE))
      continue;
    for (uint32_t i = 0; i < ring->count; i++)
      faces[i] = face_normal(c, ring->faces[i]);
    struct lod_vec3 n = ring->count == 0 ? face_normal(c, c->replaced[v]) : lod_offset_central(faces, ring->count, &cosine);
    if (!(cosine > 0.02) || !(lod_vec3_length_squared(n) > 0))
      continue;
    c->offset.direction[v] = n;
    place_vertex(c, v);
  }
}

/* ---- change ---- */

/* Opaque edges of the faces that go, as pairs of vertices. */
struct border {
  uint32_t ends[3 * COVER_HOLE][2], count;
};

static bool is_border(const struct border *border, uint32_t u, uint32_t w) {
  for (uint32_t i = 0; i < border->count; i++)
    if ((border->ends[i][0] == u && border->ends[i][1] == w) || (border->ends[i][0] == w && border->ends[i][1] == u))
      return true;
  return false;
}

static void mark_chord(struct lod_cover *c, const uint32_t chord[2]) {
  const struct cover_ring *ring = &c->ring[chord[0]];
  for (uint32_t i = 0; i < ring->count; i++)
    for (int k = 0; k < 3; k++) {
      uint32_t u = c->face[ring->faces[i]][k], w = c->face[ring->faces[i]][(k + 1) % 3];
      if ((u == chord[0] && w == chord[1]) || (u == chord[1] && w == chord[0]))
        c->opaque[ring->faces[i]] |= (uint8_t)(1 << k);
    }
}

enum lod_status cover_replace(struct lod_cover *c, const struct cover_hole *hole, const uint32_t *ids) {
  struct border border;
  border.count = 0;
  for (uint32_t i = 0; i < hole->face_count; i++) {
    uint32_t f = hole->faces[i];
    for (int k = 0; k < 3; k++) {
      if (c->opaque[f] >> k & 1) {
        border.ends[border.count][0] = c->face[f][k];
        border.ends[border.count++][1] = c->face[f][(k + 1) % 3];
      }
      ring_remove(c, c->face[f][k], f);
      c->stamp[c->face[f][k]]++;
    }
  }
  for (uint32_t i = 0; i < hole->face_count; i++) {
    c->face[hole->faces[i]][0] = LOD_NONE;
    c->opaque[hole->faces[i]] = 0;
  }
  for (uint32_t i = 0; i < hole->fill_count; i++) {
    uint32_t f = ids[i];
    memcpy(c->face[f], hole->fill[i], sizeof c->face[f]);
    set_box(c, f);
    for (int k = 0; k < 3; k++) {
      LOD_TRY(ring_add(c, c->face[f][k], f));
      if (is_border(&border, c->face[f][k], c->face[f][(k + 1) % 3]))
        c->opaque[f] |= (uint8_t)(1 << k);
    }
  }
  if (hole->chord[0] != LOD_NONE)
    mark_chord(c, hole->chord);
  c->live -= hole->face_count - hole->fill_count;
  return LOD_OK;
}
