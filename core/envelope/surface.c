#include "core/envelope/surface.h"

#include <assert.h>
#include <string.h>

static void sort3(uint32_t v[3]) {
  for (int pass = 0; pass < 2; pass++)
    for (int k = 0; k < 2; k++)
      if (v[k] > v[k + 1]) {
        uint32_t t = v[k];
        v[k] = v[k + 1];
        v[k + 1] = t;
      }
}

/* Faces on edge (a, b); up to `most` of them are listed. */
static uint32_t edge_faces(const struct lod_surface *s, uint32_t a, uint32_t b, uint32_t *list, uint32_t most) {
  const uint32_t *ring = lod_surface_ring(s, a);
  uint32_t count = 0;
  for (uint32_t i = 0; i < s->ring_count[a]; i++) {
    const uint32_t *v = s->face[ring[i]];
    if (v[0] == b || v[1] == b || v[2] == b) {
      if (count < most)
        list[count] = ring[i];
      count++;
    }
  }
  return count;
}

static int edge_index(const struct lod_surface *s, uint32_t f, uint32_t a, uint32_t b) {
  const uint32_t *v = s->face[f];
  for (int k = 0; k < 3; k++)
    if ((v[k] == a && v[(k + 1) % 3] == b) || (v[k] == b && v[(k + 1) % 3] == a))
      return k;
  return -1;
}

static bool edge_is_feature(const struct lod_surface *s, uint32_t f, uint32_t a, uint32_t b) {
  int k = edge_index(s, f, a, b);
  return k >= 0 && (s->feature[f] >> k & 1) != 0;
}

bool lod_surface_smooth_neighbours(const struct lod_surface *s, uint32_t f, uint32_t g) {
  for (int k = 0; k < 3; k++)
    if (!(s->feature[f] >> k & 1) && edge_index(s, g, s->face[f][k], s->face[f][(k + 1) % 3]) >= 0)
      return true;
  return false;
}

/* The faces around an interior or curve vertex must form one fan: walk over the non-boundary edges. */
static bool is_one_fan(const struct lod_surface *s, uint32_t v) {
  const uint32_t *ring = lod_surface_ring(s, v);
  uint32_t count = s->ring_count[v];
  if (count == 0 || count > 64)
    return false;
  uint64_t reached = 1, grown = 0;
  while (reached != grown) {
    grown = reached;
    for (uint32_t i = 0; i < count; i++) {
      if (!(reached >> i & 1))
        continue;
      for (uint32_t j = 0; j < count; j++) {
        if (reached >> j & 1)
          continue;
        for (int k = 0; k < 3; k++) {
          uint32_t w = s->face[ring[i]][k];
          if (w != v && edge_index(s, ring[j], v, w) >= 0)
            reached |= (uint64_t)1 << j;
        }
      }
    }
  }
  return reached == (count == 64 ? ~(uint64_t)0 : ((uint64_t)1 << count) - 1);
}

uint32_t lod_surface_feature_ends(const struct lod_surface *s, uint32_t v, uint32_t ends[2]) {
  const uint32_t *ring = lod_surface_ring(s, v);
  uint32_t count = 0;
  for (uint32_t i = 0; i < s->ring_count[v] && count < 3; i++)
    for (int k = 0; k < 3 && count < 3; k++) {
      uint32_t w = s->face[ring[i]][k];
      if (w == v || !edge_is_feature(s, ring[i], v, w))
        continue;
      bool known = (count > 0 && ends[0] == w) || (count > 1 && ends[1] == w);
      if (!known && count < 2)
        ends[count] = w;
      count += !known;
    }
  return count;
}

static void classify(struct lod_surface *s, uint32_t v) {
  const uint32_t *ring = lod_surface_ring(s, v);
  uint32_t ends[2];
  uint32_t feature_count = lod_surface_feature_ends(s, v, ends);
  bool manifold = is_one_fan(s, v);
  for (uint32_t i = 0; i < s->ring_count[v] && manifold; i++)
    for (int k = 0; k < 3; k++) {
      uint32_t w = s->face[ring[i]][k];
      manifold = manifold && (w == v || edge_faces(s, v, w, NULL, 0) <= 2);
    }
  s->kind[v] = !manifold            ? LOD_VERTEX_CORNER
               : feature_count == 0 ? LOD_VERTEX_INTERIOR
               : feature_count == 2 ? LOD_VERTEX_CURVE
                                    : LOD_VERTEX_JUNCTION;
}

static void mark_boundaries(struct lod_surface *s) {
  for (uint32_t f = 0; f < s->face_count; f++) {
    if (s->face[f][0] == LOD_NONE)
      continue;
    for (int k = 0; k < 3; k++) {
      uint32_t list[2];
      uint32_t a = s->face[f][k], b = s->face[f][(k + 1) % 3];
      uint32_t count = edge_faces(s, a, b, list, 2);
      bool consistent = count == 2 && s->face[list[0]][edge_index(s, list[0], a, b)] != s->face[list[1]][edge_index(s, list[1], a, b)];
      if (!consistent) /* boundary, non-manifold, or sides that disagree about the orientation */
        s->feature[f] |= (uint8_t)(1 << k);
    }
  }
}

static enum lod_status build_rings(struct lod_surface *s) {
  size_t total = 0;
  for (uint32_t f = 0; f < s->face_count; f++)
    for (int k = 0; k < 3 && s->face[f][0] != LOD_NONE; k++) {
      s->ring_count[s->face[f][k]]++;
      total++;
    }
  s->pool_size = 2 * total + 1024;
  s->pool = LOD_NEW(s->arena, s->pool_size, uint32_t);
  if (s->pool == NULL)
    return LOD_MEMORY;
  for (uint32_t v = 0; v < s->vertex_count; v++) {
    s->ring[v] = (uint32_t)s->pool_used;
    s->pool_used += s->ring_count[v];
    s->ring_count[v] = 0;
  }
  for (uint32_t f = 0; f < s->face_count; f++)
    for (int k = 0; k < 3 && s->face[f][0] != LOD_NONE; k++) {
      uint32_t v = s->face[f][k];
      s->pool[s->ring[v] + s->ring_count[v]++] = f;
    }
  return LOD_OK;
}

enum lod_status lod_surface_create(const struct lod_mesh *mesh, const uint8_t *feature_edges, struct lod_arena *arena,
                                   struct lod_surface *s) {
  *s = (struct lod_surface){.vertex_count = mesh->vertex_count, .face_count = mesh->triangle_count, .arena = arena};
  s->position = LOD_NEW(arena, s->vertex_count, struct lod_vec3);
  s->face = lod_arena_alloc(arena, s->face_count, sizeof *s->face);
  s->feature = LOD_NEW_ZERO(arena, s->face_count, uint8_t);
  s->kind = LOD_NEW_ZERO(arena, s->vertex_count, uint8_t);
  s->ring = LOD_NEW_ZERO(arena, s->vertex_count, uint32_t);
  s->ring_count = LOD_NEW_ZERO(arena, s->vertex_count, uint32_t);
  if (s->position == NULL || s->face == NULL || s->feature == NULL || s->kind == NULL || s->ring == NULL || s->ring_count == NULL)
    return LOD_MEMORY;
  for (uint32_t v = 0; v < s->vertex_count; v++)
    s->position[v] = lod_vec3_from_float(mesh->positions[v]);
  for (uint32_t f = 0; f < s->face_count; f++) {
    const uint32_t *v = mesh->triangles[f];
    bool live = v[0] != v[1] && v[1] != v[2] && v[2] != v[0];
    for (int k = 0; k < 3; k++)
      s->face[f][k] = live ? v[k] : LOD_NONE;
    s->live_faces += live;
    s->feature[f] = feature_edges == NULL ? 0 : feature_edges[f];
  }
  LOD_TRY(build_rings(s));
  mark_boundaries(s);
  for (uint32_t v = 0; v < s->vertex_count; v++)
    if (s->ring_count[v] != 0)
      classify(s, v);
  return LOD_OK;
}

/* Two faces on the same three vertices would be left when c and d, the apexes on both sides, already share faces with a and with b. */
static bool would_double_face(const struct lod_surface *s, uint32_t a, uint32_t b) {
  const uint32_t *ring = lod_surface_ring(s, a);
  for (uint32_t i = 0; i < s->ring_count[a]; i++) {
    uint32_t v[3];
    memcpy(v, s->face[ring[i]], sizeof v);
    if (v[0] == b || v[1] == b || v[2] == b)
      continue;
    for (int k = 0; k < 3; k++)
      v[k] = v[k] == a ? b : v[k];
    sort3(v);
    const uint32_t *other = lod_surface_ring(s, b);
    for (uint32_t j = 0; j < s->ring_count[b]; j++) {
      uint32_t w[3];
      memcpy(w, s->face[other[j]], sizeof w);
      sort3(w);
      if (memcmp(v, w, sizeof v) == 0)
        return true;
    }
  }
  return false;
}

/* Link condition: a vertex next to both a and b must be the apex of a face on (a, b). */
static bool link_condition(const struct lod_surface *s, uint32_t a, uint32_t b, uint32_t faces_on_edge) {
  const uint32_t *ring = lod_surface_ring(s, a);
  uint32_t common[8], common_count = 0;
  for (uint32_t i = 0; i < s->ring_count[a]; i++)
    for (int k = 0; k < 3; k++) {
      uint32_t w = s->face[ring[i]][k];
      if (w == a || w == b || edge_faces(s, b, w, NULL, 0) == 0)
        continue;
      bool known = false;
      for (uint32_t j = 0; j < common_count; j++)
        known = known || common[j] == w;
      if (known)
        continue;
      if (common_count == faces_on_edge)
        return false;
      common[common_count++] = w;
    }
  return true;
}

static bool on_boundary(const struct lod_surface *s, uint32_t v) {
  const uint32_t *ring = lod_surface_ring(s, v);
  for (uint32_t i = 0; i < s->ring_count[v]; i++)
    for (int k = 0; k < 3; k++)
      if (s->face[ring[i]][k] != v && edge_faces(s, v, s->face[ring[i]][k], NULL, 0) == 1)
        return true;
  return false;
}

void lod_surface_fix_junctions(struct lod_surface *s) {
  for (uint32_t v = 0; v < s->vertex_count; v++)
    if (s->kind[v] == LOD_VERTEX_JUNCTION)
      s->kind[v] = LOD_VERTEX_CORNER;
}

bool lod_surface_can_collapse(const struct lod_surface *s, uint32_t a, uint32_t b, bool *b_stays) {
  /* Rows: kind of a (which vanishes); columns: kind of b. 0 never; 1 freely; 2 to b's place; 3 freely along a feature; 4 to b's place along
   * a feature. A vertex on a feature must not leave it, a corner must not move. */
  static const uint8_t kRule[4][4] = {{1, 2, 2, 2}, {0, 3, 4, 4}, {0, 0, 3, 4}, {0, 0, 0, 0}};
  uint8_t rule = kRule[s->kind[a]][s->kind[b]];
  if (rule == 0)
    return false;
  uint32_t list[2];
  uint32_t count = edge_faces(s, a, b, list, 2);
  if (count == 0 || count > 2 || s->ring_count[a] > 64 || s->ring_count[b] > 64)
    return false;
  if (rule >= 3 && !edge_is_feature(s, list[0], a, b))
    return false;
  /* A line from boundary to boundary keeps them apart. */
  if (s->kind[a] == LOD_VERTEX_JUNCTION && count == 2 && on_boundary(s, a) && on_boundary(s, b))
    return false;
  /* The two other edges of a face that dies become one: two features must not. */
  for (uint32_t i = 0; i < count; i++) {
    const uint32_t *v = s->face[list[i]];
    uint32_t apex = v[0] != a && v[0] != b ? v[0] : v[1] != a && v[1] != b ? v[1] : v[2];
    if (edge_is_feature(s, list[i], a, apex) && edge_is_feature(s, list[i], b, apex))
      return false;
  }
  *b_stays = rule == 2 || rule == 4;
  return link_condition(s, a, b, count) && !would_double_face(s, a, b);
}

static enum lod_status reserve(struct lod_surface *s, size_t count) {
  if (s->pool_used + count <= s->pool_size)
    return LOD_OK;
  size_t live = 0;
  for (uint32_t v = 0; v < s->vertex_count; v++)
    live += s->ring_count[v];
  size_t size = 2 * (live + count) + 1024;
  uint32_t *pool = size <= s->pool_size ? NULL : LOD_NEW(s->arena, size, uint32_t);
  struct lod_arena *scratch = pool == NULL ? lod_arena_create_child(s->arena) : NULL;
  if (pool == NULL) { /* compact through a copy: lists are not in the order of their vertices */
    pool = scratch == NULL ? NULL : LOD_NEW(scratch, live, uint32_t);
    if (pool == NULL) {
      lod_arena_destroy(scratch);
      return LOD_MEMORY;
    }
    size = s->pool_size;
  }
  size_t used = 0;
  for (uint32_t v = 0; v < s->vertex_count; v++) {
    memcpy(pool + used, s->pool + s->ring[v], s->ring_count[v] * sizeof *pool);
    s->ring[v] = (uint32_t)used;
    used += s->ring_count[v];
  }
  if (scratch != NULL)
    memcpy(s->pool, pool, used * sizeof *pool);
  else
    s->pool = pool;
  s->pool_size = size;
  s->pool_used = used;
  lod_arena_destroy(scratch);
  return LOD_OK;
}

static void remove_from_ring(struct lod_surface *s, uint32_t v, uint32_t f) {
  uint32_t *ring = s->pool + s->ring[v];
  for (uint32_t i = 0; i < s->ring_count[v]; i++)
    if (ring[i] == f) {
      ring[i] = ring[--s->ring_count[v]];
      return;
    }
}

enum lod_status lod_surface_collapse(struct lod_surface *s, uint32_t a, uint32_t b, struct lod_vec3 to) {
  LOD_TRY(reserve(s, (size_t)s->ring_count[a] + s->ring_count[b]));
  uint32_t dying[2], apex[2];
  uint32_t dying_count = edge_faces(s, a, b, dying, 2);
  for (uint32_t i = 0; i < dying_count; i++) {
    const uint32_t *v = s->face[dying[i]];
    apex[i] = v[0] != a && v[0] != b ? v[0] : v[1] != a && v[1] != b ? v[1] : v[2];
    if (edge_is_feature(s, dying[i], a, apex[i]) || edge_is_feature(s, dying[i], b, apex[i])) {
      /* The merged edge is a feature for the faces on both of its sides. */
      for (int side = 0; side < 2; side++) {
        uint32_t end = side == 0 ? a : b;
        const uint32_t *ring = lod_surface_ring(s, end);
        for (uint32_t j = 0; j < s->ring_count[end]; j++) {
          int k = edge_index(s, ring[j], end, apex[i]);
          if (k >= 0)
            s->feature[ring[j]] |= (uint8_t)(1 << k);
        }
      }
    }
  }
  for (uint32_t i = 0; i < dying_count; i++) {
    remove_from_ring(s, a, dying[i]);
    remove_from_ring(s, b, dying[i]);
    remove_from_ring(s, apex[i], dying[i]);
    s->face[dying[i]][0] = s->face[dying[i]][1] = s->face[dying[i]][2] = LOD_NONE;
    s->live_faces--;
  }
  uint32_t *merged = s->pool + s->pool_used;
  uint32_t count = 0;
  memcpy(merged, s->pool + s->ring[b], s->ring_count[b] * sizeof *merged);
  count = s->ring_count[b];
  for (uint32_t i = 0; i < s->ring_count[a]; i++) {
    uint32_t f = s->pool[s->ring[a] + i];
    s->face[f][lod_surface_corner(s, f, a)] = b;
    merged[count++] = f;
  }
  s->ring[b] = (uint32_t)s->pool_used;
  s->ring_count[b] = count;
  s->pool_used += count;
  s->ring_count[a] = 0;
  s->position[b] = to;
  return LOD_OK;
}

static uint32_t apex_of(const struct lod_surface *s, uint32_t f, uint32_t a, uint32_t b) {
  const uint32_t *v = s->face[f];
  return v[0] != a && v[0] != b ? v[0] : v[1] != a && v[1] != b ? v[1] : v[2];
}

bool lod_surface_can_flip(const struct lod_surface *s, uint32_t f, int k, uint32_t *g) {
  uint32_t a = s->face[f][k], b = s->face[f][(k + 1) % 3], list[2];
  if ((s->feature[f] >> k & 1) || edge_faces(s, a, b, list, 2) != 2 || s->ring_count[a] <= 3 || s->ring_count[b] <= 3)
    return false;
  *g = list[0] == f ? list[1] : list[0];
  uint32_t c = apex_of(s, f, a, b), d = apex_of(s, *g, a, b);
  return c != d && edge_faces(s, c, d, NULL, 0) == 0;
}

static void add_to_ring(struct lod_surface *s, uint32_t v, uint32_t f) {
  uint32_t *grown = s->pool + s->pool_used, count = s->ring_count[v];
  memcpy(grown, s->pool + s->ring[v], count * sizeof *grown);
  grown[count] = f;
  s->ring[v] = (uint32_t)s->pool_used;
  s->ring_count[v] = count + 1;
  s->pool_used += count + 1;
}

enum lod_status lod_surface_flip(struct lod_surface *s, uint32_t f, int k, uint32_t g) {
  uint32_t a = s->face[f][k], b = s->face[f][(k + 1) % 3];
  uint32_t c = apex_of(s, f, a, b), d = apex_of(s, g, a, b);
  LOD_TRY(reserve(s, (size_t)s->ring_count[c] + s->ring_count[d] + 2));
  bool ad = edge_is_feature(s, g, a, d), db = edge_is_feature(s, g, d, b), bc = edge_is_feature(s, f, b, c),
       ca = edge_is_feature(s, f, c, a);
  remove_from_ring(s, b, f);
  remove_from_ring(s, a, g);
  add_to_ring(s, d, f);
  add_to_ring(s, c, g);
  memcpy(s->face[f], (const uint32_t[3]){a, d, c}, sizeof s->face[f]);
  memcpy(s->face[g], (const uint32_t[3]){d, b, c}, sizeof s->face[g]);
  s->feature[f] = (uint8_t)(ad | ca << 2);
  s->feature[g] = (uint8_t)(db | bc << 1);
  return LOD_OK;
}

bool lod_surface_check(const struct lod_surface *s) {
  uint32_t live = 0;
  size_t listed = 0;
  for (uint32_t v = 0; v < s->vertex_count; v++) {
    listed += s->ring_count[v];
    for (uint32_t i = 0; i < s->ring_count[v]; i++) {
      uint32_t f = s->pool[s->ring[v] + i];
      if (f >= s->face_count || (s->face[f][0] != v && s->face[f][1] != v && s->face[f][2] != v))
        return false;
    }
  }
  for (uint32_t f = 0; f < s->face_count; f++) {
    const uint32_t *v = s->face[f];
    if (v[0] == LOD_NONE)
      continue;
    live++;
    if (v[0] == v[1] || v[1] == v[2] || v[2] == v[0])
      return false;
  }
  return live == s->live_faces && listed == 3 * (size_t)live;
}
